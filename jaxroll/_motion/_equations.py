"""The closed loop: the equations of motion under the grasp's controller, and the projection."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
from jaxtyping import Array

from .._linalg import inner, total
from .._mechanics import (
    accelerate,
    balance,
    bodies,
    closing,
    combine,
    displaced,
    Grasp,
    Instant,
    join,
    Leaves,
    Linearisation,
    negative,
    net_force,
    residual,
    respond,
    spins,
    State,
    to_leaves,
    touches,
    unknown_line,
    world_poses,
)
from .._types import Scalar, Scalars
from .._xla import once
from ..contact import Motion
from ..control import as_controller, joint_angles, sense, Sensed
from ._formulation import Formulation


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


def evaluate(grasp: Grasp, t: Scalar, leaves: Leaves, formulation: Formulation) -> Instant:
    """Accelerations and contact forces at one instant, under the grasp's controller."""

    def torques(motions: Sequence[Motion]) -> tuple[Scalars, ...]:
        return as_controller(grasp.controller).torques(t, sensed(grasp, leaves, motions))

    return accelerate(grasp, leaves, torques, formulation.stabiliser(grasp))


def sensed(grasp: Grasp, leaves: Leaves, motions: Sequence[Motion]) -> list[Sensed]:
    """What every finger's controller may know."""
    each = zip(motions[1:], joint_angles(grasp, leaves.q), leaves.v[1:], strict=True)
    return [sense(motion, angles, rates) for motion, angles, rates in each]


def generalised_force(grasp: Grasp, t: Scalar, state: State) -> Array:
    """Torques and gravity less velocity terms: shape (n,), all that is not inertia or contact."""
    leaves = to_leaves(state, grasp.form)
    motions, inertias = bodies(grasp, leaves)
    drives = (None, *as_controller(grasp.controller).torques(t, sensed(grasp, leaves, motions)))
    return join(tuple(net_force(i, u) for i, u in zip(inertias, drives, strict=True)))


def control_potential(grasp: Grasp, leaves: Leaves, tips: Sequence[Any]) -> Scalar:
    """The controller's artificial potential energy at a configuration."""
    angles = joint_angles(grasp, leaves.q)
    return as_controller(grasp.controller).potential([tip.origin for tip in tips], angles)


def power(grasp: Grasp, t: Scalar, leaves: Leaves, instant: Instant) -> Scalar:
    r"""Power [W] that changes $K + P$: $\sum u \cdot \dot q + \dot P$, (18) and (20).

    With the built-in controllers it is minus the dissipation; with a user's controller, whose
    potential is unknown, it is the whole power of the joint torques. Bodies that move as prescribed do
    work too: $-\mu \cdot b$ at a contact whose gap they close at the rate b.
    """
    motions = instant.motions
    controller = as_controller(grasp.controller)
    torques = controller.torques(t, sensed(grasp, leaves, motions))
    drive = total(
        [u * w for us, ws in zip(torques, leaves.v[1:], strict=True) for u, w in zip(us, ws, strict=True)]
    )
    tips = [m.pose.origin for m in motions[1:]]
    moves = [m.twist.velocity for m in motions[1:]]
    _, stored = jax.jvp(
        lambda points, angles: controller.potential(points, angles),
        (tips, joint_angles(grasp, leaves.q)),
        (moves, leaves.v[1:]),
    )
    pushed = [
        inner(force, given)
        for force, given in zip(instant.forces, instant.line.drift, strict=True)
        if given is not None
    ]
    return drive + stored - total(pushed)


def settle(grasp: Grasp, leaves: Leaves, anchor: Anchor) -> Leaves:
    """One sweep back onto gap and tangency, nearest in the mass metric.

    Simplified Newton with the linearisation of `anchor`: a gap g falls to order g^2, then g^3.
    """
    line = anchor.line
    shapes = [grasp.shapes(c) for c in grasp.contacts]
    places = [c.onto(*pair) for c, *pair in zip(grasp.contacts, shapes, leaves.s, strict=True)]
    frames = world_poses(grasp, leaves.q)
    left = once(residual(grasp, frames, touches(grasp, places)))
    back = once(negative(respond(grasp, line, balance(line, left.gaps))))
    body, *tips = spins(grasp, leaves.q, back)
    s = []
    for i, c in enumerate(grasp.contacts):
        misfit = ((frames[1 + c.finger], frames[0]), left.tangencies[i], anchor.bends[i])
        s.append(c.settled(shapes[i], places[i], tips[c.finger] - body, misfit))
    return Leaves(displaced(grasp, leaves.q, back), leaves.v, tuple(s))


def compatible(grasp: Grasp, leaves: Leaves, line: Linearisation) -> Leaves:
    """Velocities back onto $A v = 0$, nearest in the mass metric."""
    pull = respond(grasp, line, once(balance(line, closing(grasp, line, leaves.v))))
    return once(Leaves(leaves.q, combine(leaves.v, pull, -1.0), leaves.s))
