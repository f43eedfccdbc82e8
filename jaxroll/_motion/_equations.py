r"""The equations of motion of a grasp under its controller, at one instant.

(1)-(3) and (73)-(74), with the constraints differentiated twice in time:

$$ M \dot v + h = u + A^T \mu, \qquad A \dot v + \dot A v = 0. $$

Without $\dot v$ these are $(A M^{-1} A^T)\,\mu = -(A M^{-1} (u - h) + \dot A v)$, whose matrix
`_linearisation` factorises; $\mu$ of a contact is the force on its fingertip in world axes. `_state_vector`
calls `evaluate` for the slope of a run; `_projection` removes the drift that integration leaves in the gaps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax

from .._linalg import factorise, plus, solve, times, Vec3
from .._mechanics import Blocks, Grasp, Inertia, Leaves, Moving, Wrench
from .._types import Scalar, Scalars
from .._xla import once
from ..contact import Motion, Rows
from ..control import AbstractController, as_controller, Sensed
from ..loads import total_wrench
from ._formulation import CSM, Formulation
from ._linearisation import add, apply_jacobian, balance, combine, Linearisation, linearise, negative, respond


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Instant:
    r"""All that one evaluation of the equations of motion works out.

    Attributes:
        rates: Time derivative of the state.
        forces: $\mu$ of each contact, one number per constraint row: the force on the fingertip [N] in world
            axes, then, where spin is prevented, the torque [N m] about the normal over `_contact3._ARM`.
        motions: Kinematics of the object and of every fingertip.
        touching: Contact frames.
        bends: For each contact what places move by: in the plane the sum of curvatures [1/m], in space the
            inverse of the summed shape operators [m].
        line: Constraint Jacobian and factorised Schur complement.
        torques: Joint torques of every finger [N m]; empty where no finger limits them.
    """

    rates: Leaves
    forces: Rows
    motions: tuple[Motion, ...]
    touching: tuple[Any, ...]
    bends: tuple[Any, ...]
    line: Linearisation
    torques: tuple[Scalars, ...] = ()


def evaluate(grasp: Grasp, t: Scalar, leaves: Leaves, formulation: Formulation) -> Instant:
    """Accelerations and contact forces of a prepared grasp at one instant."""
    motions, inertias = bodies(grasp, leaves)
    touching = touches(grasp, leaves.s)
    masses = [factorise(inertia.mass) for inertia in inertias]
    line = linearise(grasp, motions, masses, touching)
    acting, memory_rates = drives(grasp, t, leaves, motions)
    # Accelerations without contact: M^-1 (u - h), body by body.
    free = tuple(
        solve(mass, net_force(inertia, drive))
        for mass, inertia, drive in zip(masses, inertias, acting, strict=True)
    )
    # Acceleration of every gap without contact forces, A M^-1 (u - h) + A' v, which the forces undo. Contacts
    # take their two bodies as a pair: the fingertip's motion, then the object's.
    pairs = [(motions[1 + c.finger], motions[0]) for c in grasp.contacts]
    shapes = [grasp.shapes(c) for c in grasp.contacts]
    each = list(zip(grasp.contacts, shapes, leaves.s, pairs, touching, strict=True))
    bends = tuple(c.bend(both, place, (tip.pose, body.pose), t) for c, both, place, (tip, body), t in each)
    bends = once(bends)
    rollings = once(
        tuple(
            c.rolling(both, place, pair, touch=t, bend=bend)
            for (c, both, place, pair, t), bend in zip(each, bends, strict=True)
        )
    )
    biases = [
        c.bias(both, place, pair, touch=t, rolling=r)
        for (c, both, place, pair, t), r in zip(each, rollings, strict=True)
    ]
    gained = tuple(add(*both) for both in zip(apply_jacobian(grasp, line, free), biases, strict=True))
    if isinstance(formulation, CSM):
        # Wanted is g'' = -gamma g' - omega g instead of g'' = 0.
        pulled = formulation.restoring(grasp, motions, touching, apply_jacobian(grasp, line, leaves.v))
        gained = tuple(add(*both) for both in zip(gained, pulled, strict=True))
    # mu = -(A M^-1 A^T)^-1 (A M^-1 (u - h) + A' v), and v' = M^-1 (u - h) + M^-1 A^T mu.
    forces = once(balance(line, once(negative(gained))))
    accelerations = once(combine(free, respond(grasp, line, forces)))
    # Contact coordinates roll: (7), (68).
    s_rates = tuple(
        c.place_rate(both, place, (tip.pose, body.pose), rolling)
        for (c, both, place, (tip, body), _), rolling in zip(each, rollings, strict=True)
    )
    moving = zip(grasp.bodies, leaves.q, leaves.v, strict=True)
    turning = tuple(body.rates(q, v) for body, q, v in moving)
    rates = Leaves(turning, accelerations, s_rates, memory_rates)
    limited = any(getattr(finger, "torque_limits", None) is not None for finger in grasp.fingers)
    torques = tuple(drive or () for drive in acting[1:]) if limited else ()
    return Instant(rates, forces, motions, touching, bends, line, torques)


def bodies(grasp: Grasp, leaves: Leaves) -> tuple[tuple[Motion, ...], tuple[Inertia, ...]]:
    """Kinematics (`Motion`) and inertia ($M$, $h$) of the object, then of every finger."""
    each = zip(grasp.bodies, leaves.q, leaves.v, grasp.fields(), strict=True)
    pairs = [body.motion(q, v, field) for body, q, v, field in each]
    return tuple(m for m, _ in pairs), tuple(i for _, i in pairs)


def touches(grasp: Grasp, s: Sequence[Any]) -> tuple[Any, ...]:
    """Contact frames at the given places."""
    return tuple(c.touch(grasp.shapes(c), place) for c, place in zip(grasp.contacts, s, strict=True))


def world_poses(grasp: Grasp, q: Blocks) -> tuple[Any, ...]:
    """World poses of the object and of every fingertip."""
    return tuple(body.pose(block) for body, block in zip(grasp.bodies, q, strict=True))


def sensed(grasp: Grasp, leaves: Leaves, motions: Sequence[Motion]) -> list[Sensed]:
    """What the controller is given of every finger: joint angles, rates, and its tip's kinematics."""
    # Only the joint angles among the positions: that of a moving stage is its clock.
    each = zip(grasp.fingers, leaves.q[1:], leaves.v[1:], motions[1:], strict=True)
    return [Sensed(q[: f.joints], v, m.pose.origin, m.unit_twists) for f, q, v, m in each]


Drives = tuple[Scalars | None, ...]


def drives(grasp: Grasp, t: Scalar, leaves: Leaves, motions: Sequence[Motion]) -> tuple[Drives, Scalars]:
    """$u$ of every body, and the time derivative of the memory of a state that has one.

    That of the object is the generalised force of its loads, that of the fingers are the joint torques.
    """
    law, seen = grasp.controller, sensed(grasp, leaves, motions)
    if not isinstance(law, AbstractController):  # a caller's own function, or none at all
        law = as_controller(law)
    # The torques of a state without a memory are those with the memory that the law begins with.
    torques, rates = law.driven(t, seen, leaves.memory) if leaves.memory else (law.torques(t, seen), ())
    return (loaded(grasp, t, leaves.q[0], motions[0]), *torques), rates


def loaded(grasp: Grasp, t: Scalar, q: Scalars, motion: Motion) -> Scalars | None:
    """Generalised force $J^T w$ of all loads on the object; None where there are none."""
    if not grasp.load:
        return None
    wrench = wrench_on(grasp, t, q, motion)
    return None if wrench is None else object_force(motion, wrench)


def wrench_on(grasp: Grasp, t: Scalar, q: Scalars, motion: Motion) -> Wrench | None:
    """Force [N] and torque [N m] of all loads about the object's origin, in world axes; None without any."""
    # The orientation is the last of an object's positions: an angle, or a quaternion.
    orientation = q[3:] if grasp.spatial else q[-1:]
    return total_wrench(grasp.load, t, Moving(motion.pose, orientation, motion.twist))


def object_force(motion: Motion, wrench: Wrench) -> Scalars:
    """Generalised force of a wrench on the object: its power along each unit twist."""
    force, torque = wrench
    along = [unit.velocity.dot(force) for unit in motion.unit_twists]
    if torque is None:
        return tuple(along)
    spins = [unit.spin for unit in motion.unit_twists]
    # In the plane spin and torque are numbers.
    turns = [w.dot(torque) if isinstance(w, Vec3) else times(w, torque) for w in spins]
    return tuple(map(plus, along, turns))


def net_force(inertia: Inertia, drive: Scalars | None) -> Scalars:
    """$u - h$ of one body's coordinates; `drive` is $u$, None for an object without loads."""
    if drive is None:
        return tuple(-h for h in inertia.force)
    return tuple(u - h for u, h in zip(drive, inertia.force, strict=True))
