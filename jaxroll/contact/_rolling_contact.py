r"""Two contours rolling on each other, as a run evaluates them: frames, tangency, rolling rate, gap and rows.

A fingertip A and an object B share one rolling coordinate $\sigma$, the place of the contact:
$s_A = s_{A0} + \sigma$ and $s_B = s_{B0} - \sigma$. Both contours run counter-clockwise, so that at the
contact their tangents oppose each other, $b_A = -b_B$ in the world, and the contact point moves over both
bodies with one velocity $b_A \dot\sigma$ (see `_gap`). Outward normals are `right()` of the tangents.

Users make a `Contact` (`_contact2`), which adds the constructor and its checks; `_contact3` is the same for
surfaces in space.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._linalg import Pose2, Twist2, Vec2
from .._types import Scalar, Scalars
from .._xla import once
from ..geometry import AbstractContour, Frenet2
from ._contact import AbstractContact
from ._gap import arms_of, gap, gap_bias, gap_rate, Motion, pfaffian, row_wise, Rows

ContourPair = tuple[AbstractContour, AbstractContour]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Touch:
    """The frames of both contours at one contact, each in its own body."""

    tip: Frenet2
    object: Frenet2

    @property
    def points(self) -> tuple[Vec2, Vec2]:
        """Both contact points, each in its own body frame."""
        return self.tip.point, self.object.point


class AbstractRolling(AbstractContact):
    """What a run reads of a `Contact`, which documents the fields."""

    s_tip: eqx.AbstractVar[Float[Array, ""]]
    s_object: eqx.AbstractVar[Float[Array, ""]]
    contour: eqx.AbstractVar[int]
    sense: eqx.AbstractVar[int]

    @property
    def touched(self) -> int:
        return self.contour

    @property
    def rows(self) -> int:
        return 2

    def touch(self, shapes: ContourPair, place: Scalar) -> Touch:
        tip, face = shapes
        return Touch(tip.frame(self.s_tip + place), face.frame(self.s_object - place))

    def pfaffian(self, bodies: tuple[Motion, Motion], touch: Touch) -> tuple[Rows, Rows]:
        units = (bodies[0].unit_twists, bodies[1].unit_twists)
        # Two rows per contact: the world components x and y of the gap's rate.
        poses = bodies[0].pose, bodies[1].pose
        tip, face = once(pfaffian(units, arms_of(poses, touch.points)))
        return row_wise(tip, 2), row_wise(face, 2)

    def gap_rate(
        self, poses: tuple[Pose2, Pose2], twists: tuple[Twist2, Twist2], touch: Touch
    ) -> tuple[Scalar, Scalar]:
        rate = gap_rate(twists, arms_of(poses, touch.points))
        return rate.x, rate.y

    def bias(
        self,
        shapes: ContourPair,
        place: Scalar,
        bodies: tuple[Motion, Motion],
        *,
        touch: Touch,
        rolling: Scalar,
    ) -> Scalars:
        # Velocities of the contact points over their bodies: b_A sigma' and -b_B sigma'.
        tip, body = bodies
        over = (tip.pose.turn(touch.tip.tangent) * rolling, body.pose.turn(touch.object.tangent) * -rolling)
        return tuple(gap_bias(bodies, arms_of((tip.pose, body.pose), touch.points), over))

    def rolling(
        self,
        shapes: ContourPair,
        place: Scalar,
        bodies: tuple[Motion, Motion],
        *,
        touch: Touch,
        bend: Scalar,
    ) -> Scalar:
        return rolling_rate(bend, bodies[0].twist.spin, bodies[1].twist.spin)

    def place_rate(self, shapes: ContourPair, place: Scalar, poses: Any, rolling: Scalar) -> Scalar:
        return rolling

    def bend(self, shapes: ContourPair, place: Scalar, poses: tuple[Pose2, Pose2], touch: Touch) -> Scalar:
        return touch.tip.curvature + touch.object.curvature

    def unknown_bend(self) -> Scalar:
        return 0.0

    def gap(self, poses: tuple[Pose2, Pose2], touch: Touch) -> Scalars:
        return tuple(gap(*poses, touch.points))

    def tangency(self, poses: tuple[Pose2, Pose2], touch: Touch) -> Scalar:
        return tangency(*poses, touch)

    def settled(
        self,
        shapes: ContourPair,
        place: Scalar,
        turned: Scalar,
        *,
        poses: tuple[Pose2, Pose2],
        tangency: Scalar,
        bend: Scalar,
    ) -> Scalar:
        # Rolling by sigma turns b_A against -b_B by (kappa_A + kappa_B) sigma. This must cancel the angle
        # that is left, `tangency`, and the angle `turned` by which the bodies turn.
        return place - (turned + tangency) / bend

    def equations(self, poses: tuple[Pose2, Pose2], touch: Touch) -> Scalars:
        # The angle, not its sine, which is zero also for equal tangents, where the shapes overlap.
        tip, face = poses
        cosine = -tip.turn(touch.tip.tangent).dot(face.turn(touch.object.tangent))
        return (*self.gap(poses, touch), jnp.arctan2(self.tangency(poses, touch), cosine))

    def equation_names(self) -> tuple[str, ...]:
        return "x gap [m]", "y gap [m]", "tangency [rad]"

    def ends(self, shapes: ContourPair, place: Scalar) -> list[Scalar]:
        margins = []
        for contour, s in zip(shapes, (self.s_tip + place, self.s_object - place), strict=True):
            ends = None if contour.closed else contour.domain()
            if ends is not None:
                margins += [s - ends[0], ends[1] - s]
        return margins

    def curvature_margin(
        self, shapes: ContourPair, place: Scalar, poses: tuple[Pose2, Pose2], touch: Touch
    ) -> Scalar:
        tip, face = touch.tip.curvature, touch.object.curvature
        # Relative, so that one threshold serves all sizes: 1 for two convex shapes, 0 if both are straight.
        size = jnp.abs(tip) + jnp.abs(face)
        return (tip + face) / jnp.where(size > 0, size, 1.0)

    @property
    def presses(self) -> bool:
        return True

    def split_force(self, poses: tuple[Pose2, Pose2], touch: Touch, force: Scalars) -> tuple[Scalar, Scalar]:
        # On the fingertip f acts along the object's outward normal, and lambda along -b_0.
        tangent, push = poses[1].turn(touch.object.tangent), Vec2(*force)
        return push.dot(tangent.right()), -self.sense * push.dot(tangent)

    def split_gap(self, poses: tuple[Pose2, Pose2], touch: Touch, gap: Scalars) -> tuple[Scalar, Scalar]:
        tangent, open_ = poses[1].turn(touch.object.tangent), Vec2(*gap)
        return open_.dot(tangent.left()), self.sense * open_.dot(tangent)


def tangency(tip: Pose2, object_: Pose2, touch: Touch) -> Scalar:
    """Sine of the angle from the object's reversed tangent $-b_B$ to the fingertip's $b_A$."""
    return tip.turn(touch.tip.tangent).cross(object_.turn(touch.object.tangent))


def rolling_rate(bend: Scalar, tip_spin: Scalar, object_spin: Scalar) -> Scalar:
    r"""Rolling rate (7), (68): $(\kappa_A + \kappa_B)\,\dot\sigma = \dot\varphi_B - \dot\varphi_A$.

    `bend` is $\kappa_A + \kappa_B$. $\sigma$ grows along the fingertip's contour. The chapter's $s$ counts on
    the object along $b_{0i}$ or $b_1$: $\dot s = -\dot\sigma$ where the contact's `sense` is 1, and
    $\dot s = \dot\sigma$ where it is -1. Hence the two signs of (7).
    """
    return (object_spin - tip_spin) / bend
