"""The closed loop: the equations of motion under the grasp's controller, and the projection."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jaxtyping import Array

from .._algebra import total
from .._types import Scalar, Scalars
from ..contact import Touch
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
    Motion,
    net_force,
    poses,
    residual,
    respond,
    State,
    to_leaves,
    touches,
)
from ._formulation import Formulation

Hold = Callable[[Any], Any]


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


def project(grasp: Grasp, leaves: Leaves, instant: Instant, hold: Hold, *, sweeps: int = 2) -> Leaves:
    """Return to the constraints, nearest in the mass metric: positions, contacts, velocities.

    Simplified Newton with the factorisation of `instant`, which must belong to `leaves`: the gap g
    falls to order g^2, then g^3. `hold` keeps XLA from recomputing one sweep inside the next.
    """
    motions, touching, line = instant.motions, instant.touching, instant.line
    q, s = leaves.q, leaves.s
    left = residual(grasp, [m.pose for m in motions], touching)
    for sweep in range(sweeps):
        if sweep:
            left = hold(residual(grasp, poses(grasp, q), touches(grasp, s)))
        moved = hold(respond(grasp, line, balance(line, left.gaps)))
        q = combine(q, moved, -1.0)
        turns = [
            total([u.spin * d for u, d in zip(m.unit_twists, block, strict=True)])
            for m, block in zip(motions, moved, strict=True)
        ]
        s = tuple(
            sigma + _roll(t, sine, turns[1 + c.finger], turns[0])
            for c, t, sine, sigma in zip(grasp.contacts, touching, left.tangencies, s, strict=True)
        )
        q, s = hold((q, s))
    pull = respond(grasp, line, balance(line, apply_jacobian(grasp, line, leaves.v)))
    return Leaves(q, combine(leaves.v, pull, -1.0), s)


def _roll(touching: Touch, sine: Scalar, tip_turn: Scalar, object_turn: Scalar) -> Scalar:
    """Change of the rolling coordinate that keeps tangency when both bodies turn back."""
    return (tip_turn - object_turn - sine) / (touching.tip.curvature + touching.object.curvature)
