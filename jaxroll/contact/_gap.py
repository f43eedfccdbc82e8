r"""The gap between two contact points and its derivatives: the same lines in the plane and in space.

The contact points move over both bodies with one velocity, so that the terms in it cancel in the time
derivative of the gap: its Jacobian is autodiff of `gap` with respect to the poses **at frozen contact
coordinates**, and so the difference of the material velocities.
"""

from collections.abc import Callable, Sequence
from typing import TypeVar

import jax

from .._algebra import Pose2, Twist2, Vec2
from .._spatial import Pose3, Twist3, Vec3
from ._contact import Motion

Vec = TypeVar("Vec", Vec2, Vec3)
Pose = TypeVar("Pose", Pose2, Pose3)
Twist = TypeVar("Twist", Twist2, Twist3)


def gap(tip: Pose, object_: Pose, points: tuple[Vec, Vec]) -> Vec:
    """World-frame vector from the object's contact point to the fingertip's; (5)-(6), (64)-(65)."""
    return tip.place(points[0]) - object_.place(points[1])  # pyright: ignore


def gap_rate(poses: tuple[Pose, Pose], twists: tuple[Twist, Twist], points: tuple[Vec, Vec]) -> Vec:
    """Rate of the gap under the twists of both bodies, at frozen contact coordinates."""
    rates = (poses[0].rate(twists[0]), poses[1].rate(twists[1]))  # pyright: ignore
    return jax.jvp(lambda a, b: gap(a, b, points), poses, rates)[1]


def pfaffian(
    poses: tuple[Pose, Pose],
    unit_twists: tuple[Sequence[Twist], Sequence[Twist]],
    points: tuple[Vec, Vec],
) -> tuple[tuple[Vec, ...], tuple[Vec, ...]]:
    """Columns of the gap's Jacobian: for the fingertip's and for the object's unit rates."""
    tip, object_ = poses

    def along(vary: Callable[[Pose], Vec], pose: Pose, twist: Twist) -> Vec:
        return jax.jvp(vary, (pose,), (pose.rate(twist),))[1]  # pyright: ignore

    return (
        tuple(along(lambda p: gap(p, object_, points), tip, u) for u in unit_twists[0]),
        tuple(along(lambda p: gap(tip, p, points), object_, u) for u in unit_twists[1]),
    )


def gap_bias(bodies: tuple[Motion, Motion], points: tuple[Vec, Vec], drift: tuple[Vec, Vec]) -> Vec:
    """Second derivative of the gap at zero coordinate accelerations: one jvp of `gap_rate`.

    Args:
        bodies: Motions of fingertip and object.
        points: Contact points, each in its own body frame.
        drift: Velocities of these points over their bodies, each in its own body frame.
    """
    tip, body = bodies
    poses, twists = (tip.pose, body.pose), (tip.twist, body.twist)
    rates = (tip.pose.rate(tip.twist), body.pose.rate(body.twist))
    return jax.jvp(gap_rate, (poses, twists, points), (rates, (tip.bias, body.bias), drift))[1]
