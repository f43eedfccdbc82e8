r"""The return to the constraints: positions and velocities carried off them by a step.

Of all states without gap the one nearest in the mass metric is $q - M^{-1} A^T (A M^{-1} A^T)^{-1} g$ to
first order, and likewise the velocities. The linearisation is that of the step's last evaluation (`Anchor`),
so that nothing is factorised again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax

from .._mechanics import Blocks, Grasp, Leaves
from .._xla import once
from ..contact import Rows
from ._equations import Instant, touches
from ._linearisation import balance, closing, combine, Linearisation, negative, respond, unknown_line


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Residual:
    """What the rolling constraints leave over, per contact: the rows' gaps, and tangencies."""

    gaps: Rows
    tangencies: tuple[Any, ...]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Anchor:
    """What one evaluation leaves behind for the return to the constraints.

    Attributes:
        line: Constraint Jacobian and factorised Schur complement.
        bends: What each contact's return to tangency needs of its curvatures.
    """

    line: Linearisation
    bends: tuple[Any, ...]


def anchor_of(grasp: Grasp, instant: Instant) -> Anchor:
    """Keep what the projection needs."""
    frames = [motion.pose for motion in instant.motions]
    each = zip(grasp.contacts, instant.touching, strict=True)
    bends = tuple(c.bend((frames[1 + c.finger], frames[0]), t) for c, t in each)
    return Anchor(instant.line, bends)


def unknown_anchor(grasp: Grasp) -> Anchor:
    """An anchor full of zeros, as the state of a loop that will fill it."""
    return Anchor(unknown_line(grasp), tuple(c.unknown_bend() for c in grasp.contacts))


def settle(grasp: Grasp, leaves: Leaves, anchor: Anchor) -> Leaves:
    """One sweep back onto gap and tangency, nearest in the mass metric.

    Simplified Newton with the linearisation of `anchor`: a gap g falls to order g^2, then g^3.
    """
    line = anchor.line
    shapes = [grasp.shapes(c) for c in grasp.contacts]
    places = [c.onto(*pair) for c, *pair in zip(grasp.contacts, shapes, leaves.s, strict=True)]
    placed = [body.placed(block) for body, block in zip(grasp.bodies, leaves.q, strict=True)]
    frames = [pose for pose, _ in placed]
    left = once(residual(grasp, frames, touches(grasp, places)))
    # The gap as if it were an impulse's doing: the step -M^-1 A^T (A M^-1 A^T)^-1 g undoes it.
    back = once(negative(respond(grasp, line, balance(line, left.gaps))))
    # Tangency is a contact's own: its place moves until the normals meet, also for what that step turns.
    body, *tips = [spin(step) for (_, spin), step in zip(placed, back, strict=True)]
    s = []
    for i, c in enumerate(grasp.contacts):
        place = c.settled(
            shapes[i],
            places[i],
            tips[c.finger] - body,
            poses=(frames[1 + c.finger], frames[0]),
            tangency=left.tangencies[i],
            bend=anchor.bends[i],
        )
        s.append(place)
    return Leaves(displaced(grasp, leaves.q, back), leaves.v, tuple(s))


def compatible(grasp: Grasp, leaves: Leaves, line: Linearisation) -> Leaves:
    """Velocities back onto $A v = 0$, nearest in the mass metric."""
    pull = respond(grasp, line, once(balance(line, closing(grasp, line, leaves.v))))
    return once(Leaves(leaves.q, combine(leaves.v, pull, -1.0), leaves.s))


def residual(grasp: Grasp, frames: Sequence[Any], touching: Sequence[Any]) -> Residual:
    """Gap and tangency of every contact."""
    each = [(c, (frames[1 + c.finger], frames[0]), t) for c, t in zip(grasp.contacts, touching, strict=True)]
    return Residual(
        tuple(c.opening(pair, t) for c, pair, t in each),
        tuple(c.tangency(pair, t) for c, pair, t in each),
    )


def displaced(grasp: Grasp, q: Blocks, step: Blocks) -> Blocks:
    """Positions after a small displacement, given as velocities are."""
    return tuple(body.displaced(*pair) for body, *pair in zip(grasp.bodies, q, step, strict=True))
