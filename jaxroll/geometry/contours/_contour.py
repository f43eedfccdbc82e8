"""Contours as fields of arclength, and their Frenet frame by automatic differentiation."""

import abc
import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._linalg import Pose2, sincos, unstack, Vec2
from ..._results import as_array, as_floats, shown
from ..._types import Given, Points, Scalar
from ..._xla import remembered


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Frenet2:
    """Point, unit tangent and curvature of a contour at one arclength."""

    point: Vec2
    tangent: Vec2
    curvature: Scalar


def frenet(curve: Callable[[Scalar], Vec2], s: Scalar) -> Frenet2:
    r"""Frenet frame (8)-(10) of a unit-speed curve, by differentiating its point twice.

    $b = c'$, $\kappa = b \times b'$. The chapter prints $n = \kappa b'$ in (9) and $b = -\kappa n'$
    in (10); the right forms are $b' = \kappa n$ and $n' = -\kappa b$ ($n$ inward).
    """
    one = jnp.ones_like(s)

    def derivative(u: Scalar) -> tuple[Vec2, Vec2]:
        return jax.jvp(curve, (u,), (one,))

    (point, tangent), (_, second) = jax.jvp(derivative, (s,), (one,))
    return Frenet2(point, tangent, tangent.cross(second))


class AbstractContour(eqx.Module):
    r"""A smooth planar contour, parametrised by arclength, counter-clockwise round its body.

    With tangent $b = c'(s)$, the outward normal is $b$ turned by -90 degrees and the curvature
    $\kappa$ is positive where the body is convex. Lengths are in metres, in the body's frame.

    To add a contour, subclass this and give `curve` and `frame` (where no closed form is at hand,
    `frame` is `frenet(self.curve, s)`), `prepared`, `domain`, `closed` and `smoothness`. Both
    take and return scalars (`Vec2`), since they run inside the equations of motion.
    """

    @property
    @abc.abstractmethod
    def closed(self) -> bool:
        """Whether the contour closes on itself."""

    @property
    @abc.abstractmethod
    def smoothness(self) -> float:
        """Continuous derivatives of the point; fewer than the solver's order plus one lower it."""

    @abc.abstractmethod
    def curve(self, s: Scalar) -> Vec2:
        """The point at arclength `s`, as scalars."""

    @abc.abstractmethod
    def frame(self, s: Scalar) -> Frenet2:
        """Point, tangent and curvature at arclength `s`, as scalars."""

    @abc.abstractmethod
    def prepared(self) -> "AbstractContour":
        """This contour with all that does not depend on `s` worked out, once per solve."""

    @abc.abstractmethod
    def domain(self) -> tuple[Scalar, Scalar] | None:
        """First and last arclength; None for an open contour without ends."""

    def point(self, s: Given) -> Points:
        """Points at arclengths `s` [m] of shape (...): shape (..., 2), in metres."""
        return _frame_arrays(tabled(self), as_array("s", s))[0]

    def tangent(self, s: Given) -> Points:
        """Unit tangents at arclengths `s` [m] of shape (...): shape (..., 2)."""
        return _frame_arrays(tabled(self), as_array("s", s))[1]

    def normal(self, s: Given) -> Points:
        """Outward unit normals at arclengths `s` [m] of shape (...): shape (..., 2)."""
        tangent = _frame_arrays(tabled(self), as_array("s", s))[1]
        return jnp.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)

    def curvature(self, s: Given) -> Float[Array, "..."]:
        """Curvatures [1/m] at arclengths `s` [m] of shape (...); positive where convex."""
        return _frame_arrays(tabled(self), as_array("s", s))[2]

    def moved(self, offset: Given = (0.0, 0.0), angle: Given = 0.0, *, origin: Given = 0.0) -> "Moved":
        """This contour turned by `angle` [rad], shifted by `offset` [m], its s = 0 put at `origin`."""
        return Moved(self, offset, angle, origin=origin)


@functools.singledispatch
def tabled(shape: Any) -> Any:
    """A contour or surface with its table built, if it reads one: by a program that all others share."""
    return shape


@eqx.filter_jit
def _frame_arrays(contour: AbstractContour, s: Array) -> tuple[Array, Array, Array]:
    """Points, tangents and curvatures as arrays: the public door."""
    frame = contour.prepared().frame(s)
    return frame.point.array(), frame.tangent.array(), jnp.broadcast_to(frame.curvature, s.shape)


class Moved(AbstractContour):
    """A contour placed in its body's frame: turned by `angle`, then shifted by `offset`.

    Args:
        contour: The contour to place.
        offset: Where its body's origin goes, shape (2,), in metres.
        angle: Counter-clockwise turn in radians.
        origin: Arclength [m] at which the placed contour has the point that `contour` has at zero.

    Example:
        >>> import jaxroll as jxr
        >>> tip = jxr.Circle(0.01).moved(offset=(0.02, 0.0))
        >>> tip.point(0.0).tolist()
        [0.03, 0.0]
    """

    contour: AbstractContour
    offset: Float[Array, "2"]
    angle: Float[Array, ""]
    origin: Float[Array, ""]
    pose: Pose2 | None

    def __init__(
        self,
        contour: AbstractContour,
        offset: Given = (0.0, 0.0),
        angle: Given = 0.0,
        *,
        origin: Given = 0.0,
    ) -> None:
        if not isinstance(contour, AbstractContour):
            raise ValueError(f"argument contour must be a contour, but was {shown(contour)}")
        self.contour = contour
        self.offset = as_floats("offset", offset, (2,))
        self.angle = as_floats("angle", angle, ())
        self.origin = as_floats("origin", origin, ())
        self.pose = None

    @property
    def closed(self) -> bool:
        return self.contour.closed

    @property
    def smoothness(self) -> float:
        return self.contour.smoothness

    def placed(self) -> Pose2:
        """The placement as a pose with its sine and cosine."""
        if self.pose is not None:
            return self.pose
        sin, cos = sincos(self.angle)
        return Pose2(Vec2(*unstack(self.offset)), cos, sin)

    def curve(self, s: Scalar) -> Vec2:
        return self.placed().place(self.contour.curve(s - self.origin))

    def frame(self, s: Scalar) -> Frenet2:
        pose, local = self.placed(), self.contour.frame(s - self.origin)
        return Frenet2(pose.place(local.point), pose.turn(local.tangent), local.curvature)

    def prepared(self) -> "Moved":
        ready = (self.contour.prepared(), self.placed())
        return eqx.tree_at(lambda m: (m.contour, m.pose), self, ready, is_leaf=lambda x: x is None)

    def domain(self) -> tuple[Scalar, Scalar] | None:
        ends = self.contour.domain()
        return None if ends is None else (ends[0] + self.origin, ends[1] + self.origin)


@tabled.register
def _(contour: Moved) -> Moved:
    return contour if tabled(contour.contour) is contour.contour else _moved_table(contour)


@remembered
def _moved_table(contour: Moved) -> Moved:
    return eqx.tree_at(lambda m: m.contour, contour, tabled(contour.contour))
