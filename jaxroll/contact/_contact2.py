r"""Two contours rolling on each other: tangency, rolling rate, and the contact that has them.

A fingertip A and an object B share one rolling coordinate $\sigma$, the place of the contact:
$s_A = s_{A0} + \sigma$ and $s_B = s_{B0} - \sigma$. Both contours run counter-clockwise, so that at the
contact their tangents oppose each other, $b_A = -b_B$ in the world, and the contact point moves over both
bodies with one velocity $b_A \dot\sigma$ (see `_gap`). Outward normals are `right()` of the tangents.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._linalg import Pose2, Twist2, Vec2
from .._results import check_between, check_positive, shown
from .._types import Given, Scalar, Scalars
from .._xla import once
from ..geometry import AbstractContour, check_contour, Frenet2
from ._contact import AbstractContact, as_index
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


def _as_sense(name: str, sense: Any) -> int:
    whole = isinstance(sense, int | np.integer) and not isinstance(sense, bool)
    if not whole or sense not in (1, -1):
        raise ValueError(f"argument {name} must be 1 or -1, but was {shown(sense)}")
    return int(sense)


class Contact(AbstractContact):
    r"""Where a fingertip starts touching the object.

    Args:
        s_tip: Arclength on the fingertip's contour at the start, in metres.
        s_object: Arclength on the object's contour at the start, in metres.
        finger: Which finger touches. Static.
        contour: Which of the object's contours is touched. Static.
        sense: +1 where the chapter's $s_i$ and $b_{0i}$ run along the object's contour, -1 where
            they run against it (its second finger). It decides only the signs in which the chapter's
            quantities are reported, of `multipliers`, `residuals`, `press_balance` and the like: a grasp and
            its mirror image with the other `sense` have the same. Static.
        friction: Coefficient $\mu$: a run ends where $|\lambda| > \mu f$. Default: no limit, no cost.

    Raises:
        ValueError: If an arclength is not one finite number, `finger` or `contour` is not a whole number from
            0 up, `sense` is neither, or `friction` is not positive.
    """

    s_tip: Float[Array, ""] = real()
    s_object: Float[Array, ""] = real()
    finger: int = through(as_index, static=True)
    contour: int = through(as_index, static=True)
    sense: int = through(_as_sense, static=True)
    friction: Float[Array, ""] | None = real(check=check_positive, optional=True)

    def __init__(
        self,
        s_tip: Given = 0.0,
        s_object: Given = 0.0,
        *,
        finger: int = 0,
        contour: int = 0,
        sense: int = 1,
        friction: Given | None = None,
    ) -> None:
        self.s_tip = taken(self, "s_tip", s_tip)
        self.s_object = taken(self, "s_object", s_object)
        self.finger = taken(self, "finger", finger)
        self.contour = taken(self, "contour", contour)
        self.sense = taken(self, "sense", sense)
        self.friction = taken(self, "friction", friction)

    @property
    def touched(self) -> int:
        return self.contour

    @property
    def rows(self) -> int:
        return 2

    def check(self, name: str, shapes: ContourPair) -> None:
        for shape in shapes:
            if not isinstance(shape, AbstractContour):
                raise ValueError(f"argument {name} must be between contours, but one was {shown(shape)}")
        self.check_shapes(name, shapes)
        for shape, (kind, s) in zip(shapes, self._starts(), strict=True):
            domain = None if shape.closed else shape.domain()
            if domain is not None:
                check_between(f"{name}.{kind}", s, *domain, unit=" m")

    def check_shapes(self, name: str, shapes: ContourPair) -> None:
        for shape, (kind, s) in zip(shapes, self._starts(), strict=True):
            check_contour(f"{name}.{kind}", shape, start=s)

    def _starts(self) -> tuple[tuple[str, Array], ...]:
        return ("s_tip", self.s_tip), ("s_object", self.s_object)

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
        drift = (tip.pose.turn(touch.tip.tangent) * rolling, body.pose.turn(touch.object.tangent) * -rolling)
        return tuple(gap_bias(bodies, arms_of((tip.pose, body.pose), touch.points), drift))

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
        # Rolling by sigma turns b_A against -b_B by (kappa_A + kappa_B) sigma. That is to cancel the angle
        # which is left, `tangency`, and the one by which the bodies turn.
        return place - (turned + tangency) / bend

    def equations(self, poses: tuple[Pose2, Pose2], touch: Touch) -> Scalars:
        # The whole angle, not its sine, which vanishes too where the shapes overlap with tangents alike.
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
        # The object pushes the fingertip along its outward normal with f, and along -b_0 with lambda.
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

    `bend` is $\kappa_A + \kappa_B$.
    """
    return (object_spin - tip_spin) / bend
