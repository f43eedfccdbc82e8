r"""The gap between two contact points and its derivatives: the same lines in the plane and in space.

The contact points move over both bodies with one velocity, so that the terms in it cancel in the time
derivative of the gap. Its Jacobian is therefore the derivative of `gap` with respect to the poses **at frozen
contact coordinates**: the difference of the material velocities, which a twist gives at the end of an arm
(`Twist2.at`, `Twist3.at`). The arms in world axes are worked out once; the bias is autodiff of these lines.
"""

from collections.abc import Sequence
from typing import TypeVar

import jax

from .._linalg import Pose2, Pose3, Twist2, Twist3, Vec2, Vec3
from ._contact import Motion

Vec = TypeVar("Vec", Vec2, Vec3)
Pose = TypeVar("Pose", Pose2, Pose3)
Twist = TypeVar("Twist", Twist2, Twist3)


def gap(tip: Pose, object_: Pose, points: tuple[Vec, Vec]) -> Vec:
    """World-frame vector from the object's contact point to the fingertip's; (5)-(6), (64)-(65)."""
    return tip.place(points[0]) - object_.place(points[1])  # pyright: ignore


def gap_rate(twists: tuple[Twist, Twist], arms: tuple[Vec, Vec]) -> Vec:
    """Rate of the gap under the twists of both bodies, at frozen contact coordinates."""
    return twists[0].at(arms[0]) - twists[1].at(arms[1])  # pyright: ignore


def pfaffian(
    unit_twists: tuple[Sequence[Twist], Sequence[Twist]], arms: tuple[Vec, Vec]
) -> tuple[tuple[Vec, ...], tuple[Vec, ...]]:
    """Columns of the gap's Jacobian: for the fingertip's and for the object's unit rates."""
    tip, object_ = unit_twists
    return tuple(unit.at(arms[0]) for unit in tip), tuple(-unit.at(arms[1]) for unit in object_)  # pyright: ignore


def gap_bias(bodies: tuple[Motion, Motion], arms: tuple[Vec, Vec], drift: tuple[Vec, Vec]) -> Vec:
    """Second derivative of the gap at zero coordinate accelerations: one jvp of `gap_rate`.

    Args:
        bodies: Motions of fingertip and object.
        arms: From the frames' origins to the contact points, in world axes.
        drift: Velocities of these points over their bodies, in world axes.
    """
    twists, biases = (bodies[0].twist, bodies[1].twist), (bodies[0].bias, bodies[1].bias)
    still = bodies[0].resting().twist.velocity
    moves = tuple(
        type(motion.twist)(still, motion.twist.spin).at(arm) + over
        for motion, arm, over in zip(bodies, arms, drift, strict=True)
    )
    return jax.jvp(gap_rate, (twists, arms), (biases, moves))[1]
