"""The closed loop: the equations of motion under the grasp's controller, and the projection."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
from jaxtyping import Array

from .._algebra import once, total
from .._types import Scalar, Scalars
from ..control import AbstractController, as_controller, sense, Sensed
from ..mechanics import (
    accelerate,
    apply_jacobian,
    balance,
    bodies,
    combine,
    Grasp,
    Instant,
    join,
    Leaves,
    Linearisation,
    Motion,
    net_force,
    poses,
    residual,
    respond,
    spins,
    State,
    to_leaves,
    touches,
)
from ._formulation import Formulation


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Anchor:
    """What one evaluation leaves behind for the return to the constraints.

    Attributes:
        line: Constraint Jacobian and factorised Schur complement.
        bends: Sum of the two curvatures of each contact.
    """

    line: Linearisation
    bends: Scalars


def anchor_of(instant: Instant) -> Anchor:
    """Keep what the projection needs."""
    return Anchor(instant.line, tuple(t.tip.curvature + t.object.curvature for t in instant.touching))


def evaluate(grasp: Grasp, t: Scalar, leaves: Leaves, formulation: Formulation) -> Instant:
    """Accelerations and contact forces at one instant, under the grasp's controller."""

    def torques(motions: Sequence[Motion]) -> tuple[Scalars, ...]:
        return as_controller(grasp.controller).torques(t, sensed(leaves, motions))

    return accelerate(grasp, leaves, torques, formulation.stabiliser(grasp))


def sensed(leaves: Leaves, motions: Sequence[Motion]) -> list[Sensed]:
    """What every finger's controller may know."""
    return [sense(m, q, v) for m, q, v in zip(motions[1:], leaves.q[1:], leaves.v[1:], strict=True)]


def generalised_force(grasp: Grasp, t: Scalar, state: State) -> Array:
    """Torques and gravity less velocity terms: shape (n,), all that is not inertia or contact."""
    leaves = to_leaves(state, grasp.sizes)
    motions, inertias = bodies(grasp, leaves)
    drives = (None, *as_controller(grasp.controller).torques(t, sensed(leaves, motions)))
    return join(tuple(net_force(i, u) for i, u in zip(inertias, drives, strict=True)))


def control_potential(controller: AbstractController, leaves: Leaves, tips: Sequence) -> Scalar:
    """The controller's artificial potential energy at a configuration."""
    return controller.potential([tip.origin for tip in tips], leaves.q[1:])


def power(grasp: Grasp, t: Scalar, leaves: Leaves, motions: Sequence[Motion]) -> Scalar:
    r"""Power [W] that changes $K + P$: $\sum u \cdot \dot q + \dot P$, (18) and (20).

    With the built-in controllers it is minus the dissipation; with a user's controller, whose
    potential is unknown, it is the whole power of the joint torques.
    """
    controller = as_controller(grasp.controller)
    torques = controller.torques(t, sensed(leaves, motions))
    drive = total(
        [u * w for us, ws in zip(torques, leaves.v[1:], strict=True) for u, w in zip(us, ws, strict=True)]
    )
    tips = [m.pose.origin for m in motions[1:]]
    moves = [m.twist.velocity for m in motions[1:]]
    _, stored = jax.jvp(
        lambda points, angles: controller.potential(points, angles),
        (tips, leaves.q[1:]),
        (moves, leaves.v[1:]),
    )
    return drive + stored


def settle(grasp: Grasp, leaves: Leaves, anchor: Anchor) -> Leaves:
    """One sweep back onto gap and tangency, nearest in the mass metric.

    Simplified Newton with the linearisation of `anchor`: a gap g falls to order g^2, then g^3.
    """
    line = anchor.line
    left = once(residual(grasp, poses(grasp, leaves.q), touches(grasp, leaves.s)))
    moved = once(respond(grasp, line, balance(line, left.gaps)))
    body, *tips = spins(grasp, moved)
    # Tangency is kept when both bodies turn back.
    s = tuple(
        sigma + (tips[c.finger] - body - sine) / bend
        for c, bend, sine, sigma in zip(grasp.contacts, anchor.bends, left.tangencies, leaves.s, strict=True)
    )
    return Leaves(combine(leaves.q, moved, -1.0), leaves.v, s)


def compatible(grasp: Grasp, leaves: Leaves, line: Linearisation) -> Leaves:
    """Velocities back onto $A v = 0$, nearest in the mass metric."""
    pull = respond(grasp, line, once(balance(line, apply_jacobian(grasp, line, leaves.v))))
    return once(Leaves(leaves.q, combine(leaves.v, pull, -1.0), leaves.s))
