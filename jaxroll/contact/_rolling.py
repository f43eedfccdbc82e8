r"""Two contours rolling on each other: gap, tangency, Pfaffian rows and the rolling rate.

A fingertip A and an object B share one rolling coordinate $\sigma$: $s_A = s_{A0} + \sigma$ and
$s_B = s_{B0} - \sigma$. Both contours run counter-clockwise, so their tangents oppose each other at the
contact and the terms in $\dot\sigma$ cancel in the time derivative of the gap: its Jacobian is
autodiff of `gap` with respect to the poses **at frozen contact coordinates**.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
from jaxtyping import Array, Float

from .._algebra import Pose2, Twist2, Vec2
from .._results import as_floats, check_positive
from .._types import Given, Scalar
from ..geometry import AbstractContour, Frenet2


class Contact(eqx.Module):
    r"""Where a fingertip starts touching the object.

    Args:
        s_tip: Arclength on the fingertip's contour at the start, in metres.
        s_object: Arclength on the object's contour at the start, in metres.
        finger: Which finger touches. Static.
        contour: Which of the object's contours is touched. Static.
        sense: +1 where the chapter's $s_i$ and $b_{0i}$ run along the object's contour, -1 where
            they run against it (its second finger). It decides only the sign in which `s` and the
            tangential multiplier are reported. Static.
        friction: Coefficient $\mu$: a run ends where $|\lambda| > \mu f$. Default: no limit, no cost.
    """

    s_tip: Float[Array, ""]
    s_object: Float[Array, ""]
    finger: int = eqx.field(static=True)
    contour: int = eqx.field(static=True)
    sense: int = eqx.field(static=True)
    friction: Float[Array, ""] | None

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
        if sense not in (1, -1):
            raise ValueError(f"argument sense must be 1 or -1, but was {sense}")
        self.s_tip = as_floats("s_tip", s_tip, ())
        self.s_object = as_floats("s_object", s_object, ())
        self.finger, self.contour, self.sense = finger, contour, sense
        self.friction = None
        if friction is not None:
            self.friction = check_positive("friction", as_floats("friction", friction, ()))


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


def touch(contact: Contact, tip: AbstractContour, object_: AbstractContour, sigma: Scalar) -> Touch:
    """Evaluate both contours at the rolling coordinate `sigma`."""
    return Touch(tip.frame(contact.s_tip + sigma), object_.frame(contact.s_object - sigma))


def gap(tip: Pose2, object_: Pose2, points: tuple[Vec2, Vec2]) -> Vec2:
    """World-frame vector from the object's contact point to the fingertip's; (5)-(6), (64)-(65)."""
    return tip.place(points[0]) - object_.place(points[1])


def gap_rate(poses: tuple[Pose2, Pose2], twists: tuple[Twist2, Twist2], points: tuple[Vec2, Vec2]) -> Vec2:
    """Rate of the gap under the twists of both bodies, at frozen contact coordinates."""
    rates = (poses[0].rate(twists[0]), poses[1].rate(twists[1]))
    return jax.jvp(lambda a, b: gap(a, b, points), poses, rates)[1]


def pfaffian(
    poses: tuple[Pose2, Pose2],
    unit_twists: tuple[Sequence[Twist2], Sequence[Twist2]],
    points: tuple[Vec2, Vec2],
) -> tuple[tuple[Vec2, ...], tuple[Vec2, ...]]:
    """Columns of the gap's Jacobian: for the fingertip's and for the object's unit rates."""
    tip, object_ = poses

    def along(vary: Callable[[Pose2], Vec2], pose: Pose2, twist: Twist2) -> Vec2:
        return jax.jvp(vary, (pose,), (pose.rate(twist),))[1]

    return (
        tuple(along(lambda p: gap(p, object_, points), tip, u) for u in unit_twists[0]),
        tuple(along(lambda p: gap(tip, p, points), object_, u) for u in unit_twists[1]),
    )


def gap_bias(
    poses: tuple[Pose2, Pose2],
    twists: tuple[Twist2, Twist2],
    biases: tuple[Twist2, Twist2],
    *,
    touch: Touch,
    sigma_rate: Scalar,
) -> Vec2:
    """Second derivative of the gap at zero coordinate accelerations: one jvp of `gap_rate`."""
    rates = (poses[0].rate(twists[0]), poses[1].rate(twists[1]))
    drift = (touch.tip.tangent * sigma_rate, touch.object.tangent * -sigma_rate)
    return jax.jvp(gap_rate, (poses, twists, touch.points), (rates, biases, drift))[1]


def tangency(tip: Pose2, object_: Pose2, touch: Touch) -> Scalar:
    """Sine of the angle by which the fingertip's tangent leads the reversed object tangent."""
    return tip.turn(touch.tip.tangent).cross(object_.turn(touch.object.tangent))


def rolling_rate(touch: Touch, tip_spin: Scalar, object_spin: Scalar) -> Scalar:
    r"""Rolling rate (7), (68): $(\kappa_A + \kappa_B)\,\dot\sigma = \dot\varphi_B - \dot\varphi_A$."""
    return (object_spin - tip_spin) / (touch.tip.curvature + touch.object.curvature)
