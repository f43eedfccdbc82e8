r"""The return to the constraints: positions and velocities carried off them by a step.

A step leaves gaps $g$ and gap rates $A v$ of the size of its error. The nearest state without them, in the
mass metric $\delta^T M \delta$ and to first order, is

$$ q - M^{-1} A^T (A M^{-1} A^T)^{-1} g, \qquad v - M^{-1} A^T (A M^{-1} A^T)^{-1} A v. $$

$A$ and the factorised $A M^{-1} A^T$ are those of the step's last evaluation of the equations of motion
(`Anchor`), so that nothing is factorised again. `_integration._step` calls `settle`, then `compatible`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from .._linalg import unknown_factor, unknown_loop_factor
from .._mechanics import Blocks, Grasp, Leaves
from .._xla import once
from ..contact import Rows
from ._equations import Instant, touches
from ._linearisation import balance, closing, combine, Linearisation, negative, respond, WRITTEN_OUT


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Residual:
    """How far a state is off the constraints: per contact its gap, row by row [m], and its tangency."""

    gaps: Rows
    tangencies: tuple[Any, ...]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Anchor:
    """What the projection keeps of one evaluation of the equations of motion.

    Attributes:
        line: Constraint Jacobian and factorised Schur complement.
        bends: For each contact what its return to tangency needs of the curvatures: in the plane their sum
            [1/m], in space the inverse of the summed shape operators [m].
    """

    line: Linearisation
    bends: tuple[Any, ...]


def anchor_of(instant: Instant) -> Anchor:
    """The anchor of an evaluation: what the return to the constraints reads of it."""
    return Anchor(instant.line, instant.bends)


def unknown_anchor(grasp: Grasp) -> Anchor:
    """An anchor of the right structure, full of zeros: the carry of a loop before its first turn."""
    zero = jnp.zeros(())
    pairs, drift = [], []
    for c in grasp.contacts:
        pairs.append(tuple(((zero,) * k,) * c.rows for k in (grasp.sizes[1 + c.finger], grasp.sizes[0])))
        drift.append((zero,) * c.rows if grasp.fingers[c.finger].prescribed else None)
    m = sum(c.rows for c in grasp.contacts)
    schur = unknown_loop_factor(m) if m > WRITTEN_OUT else unknown_factor(m)
    line = Linearisation(tuple(pairs), tuple(pairs), schur, tuple(drift))
    return Anchor(line, tuple(c.unknown_bend() for c in grasp.contacts))


def settle(grasp: Grasp, leaves: Leaves, anchor: Anchor) -> Leaves:
    """One Newton step for gap and tangency: positions and places change, velocities stay.

    The Jacobian is the one at `anchor` and stays the same (simplified Newton), with an error of the order of
    the distance from there: a gap g falls to order g^2 with the first call, to g^3 with the second.
    """
    line = anchor.line
    # In space a quaternion can be off unit length, and a place off its surface (an implicit one has three
    # coordinates): they return first. At the end their return would change gaps and normals to first order.
    q = tuple(body.onto(block) for body, block in zip(grasp.bodies, leaves.q, strict=True))
    shapes = [grasp.shapes(c) for c in grasp.contacts]
    places = [c.onto(*pair) for c, *pair in zip(grasp.contacts, shapes, leaves.s, strict=True)]
    placed = [body.placed(block) for body, block in zip(grasp.bodies, q, strict=True)]
    frames = [pose for pose, _ in placed]
    left = once(residual(grasp, frames, touches(grasp, places)))
    # The displacement -M^-1 A^T (A M^-1 A^T)^-1 g, given as velocities are.
    back = once(negative(respond(grasp, line, balance(line, left.gaps))))
    # Tangency is restored by the place of each contact alone, which changes the gap to second order only when
    # it moves over both shapes. It makes up for the tangency that is left, and for the turn in `back`.
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
    return Leaves(displaced(grasp, q, back), leaves.v, tuple(s), leaves.memory)


def compatible(grasp: Grasp, leaves: Leaves, line: Linearisation) -> Leaves:
    """The nearest velocities in the mass metric at which no gap changes: $A v = 0$, or minus the drift."""
    pull = respond(grasp, line, once(balance(line, closing(grasp, line, leaves.v))))
    return once(Leaves(leaves.q, combine(leaves.v, pull, -1.0), leaves.s, leaves.memory))


def residual(grasp: Grasp, frames: Sequence[Any], touching: Sequence[Any]) -> Residual:
    """Gap and tangency of every contact, from the world poses of all bodies and the contact frames."""
    each = [(c, (frames[1 + c.finger], frames[0]), t) for c, t in zip(grasp.contacts, touching, strict=True)]
    return Residual(
        tuple(c.gap(pair, t) for c, pair, t in each),
        tuple(c.tangency(pair, t) for c, pair, t in each),
    )


def displaced(grasp: Grasp, q: Blocks, step: Blocks) -> Blocks:
    """Positions after a small displacement in the coordinates of the velocities, body by body."""
    return tuple(body.displaced(*pair) for body, *pair in zip(grasp.bodies, q, step, strict=True))
