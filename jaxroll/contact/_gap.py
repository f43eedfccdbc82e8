r"""The gap between two contact points and its derivatives: the same lines in the plane and in space.

The contact points move over both bodies with one velocity, so that the terms in it cancel in the time
derivative of the gap. Its Jacobian is therefore the derivative of `gap` with respect to the poses **at frozen
contact coordinates**: the difference of the material velocities, which a twist gives at the end of an arm
(`Twist2.at`, `Twist3.at`). The arms in world axes are worked out once; the bias is autodiff of these lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import jax

from .._linalg import Pose2, Pose3, Twist2, Twist3, Vec2, Vec3
from .._types import Scalars
from .._xla import once

Rows = tuple[Scalars, ...]
Vec = TypeVar("Vec", Vec2, Vec3)
Pose = TypeVar("Pose", Pose2, Pose3)
Twist = TypeVar("Twist", Twist2, Twist3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Motion:
    r"""Motion of one body frame, in the plane or in space.

    Attributes:
        pose: The frame in the world.
        unit_twists: Twist per unit rate of each coordinate: the columns of its Jacobian $J$.
        twist: $J v$, and what is prescribed.
        bias: $\dot J v$, the part of the acceleration that the velocities alone cause.
    """

    pose: Any
    unit_twists: tuple[Any, ...]
    twist: Any
    bias: Any

    def resting(self) -> "Motion":
        """The same pose at zero velocity."""
        return replace(self, twist=jax.tree.map(lambda _: 0.0, self.twist))


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


def arms_of(bodies: tuple[Motion, Motion], points: tuple[Any, Any]) -> tuple[Any, Any]:
    """From the frames' origins to points of the bodies, in world axes."""
    return once((bodies[0].pose.turn(points[0]), bodies[1].pose.turn(points[1])))


def row_wise(columns: Sequence[Any], rows: int) -> Rows:
    """Columns of a Jacobian, each a vector, as its rows."""
    entries = [tuple(column) for column in columns]
    return tuple(tuple(entry[i] for entry in entries) for i in range(rows))
