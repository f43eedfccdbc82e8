r"""The contract of a contour: a plane curve $c(s)$ by its arclength $s$, so that $|c'(s)| = 1$.

Unit tangent $b = c'$ and curvature $\kappa = b \times b'$ follow from the point alone, (8)-(10), which
`frenet` differentiates automatically. Every contour of the package is an `AbstractContour`: `_closed_forms`
and `_catenary` write point and frame out, `_table` reads them from a table. `contact` takes a `Frenet2` of
each of two contours, and design its free numbers (`_free_numbers`).
"""

import abc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import Pose2, sincos, unstack, Vec2
from ..._results import as_array, as_floats, shown
from ..._types import Given, Points, Scalar
from .._tabled import AbstractShape, tabled
from ._free_numbers import each_perturbed, own_sizes


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

    # Forward over forward: one pass gives c, c' and c''. Reverse mode would need a pass per component.
    def derivative(u: Scalar) -> tuple[Vec2, Vec2]:
        return jax.jvp(curve, (u,), (one,))

    (point, tangent), (_, second) = jax.jvp(derivative, (s,), (one,))
    return Frenet2(point, tangent, tangent.cross(second))


class AbstractContour(AbstractShape):
    r"""A smooth planar contour, parametrised by arclength, counter-clockwise round its body.

    With tangent $b = c'(s)$, the outward normal is $b$ turned by -90 degrees and the curvature
    $\kappa$ is positive where the body is convex. Lengths are in metres, in the body's frame.

    To add a contour, subclass this and give `curve`, `domain`, `closed` and `smoothness`; nothing
    else in the package has to be told of it. Everything else has a default, which a class overrides where it
    knows better:

    - `frame`, where there is a closed form. `curve` and `frame` take and return scalars (`Vec2`), since they
      run inside the equations of motion.
    - `prepared` and `tabled`, where there is work to be done once.
    - `free_numbers`, `preconditioner`, `symmetrised` and `perturbed`: what `design.optimise_fingertip` and
      `design.ShapeTransform` ask of a contour.
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

    def frame(self, s: Scalar) -> Frenet2:
        """Point, tangent and curvature at arclength `s`, as scalars; by default `frenet` of the curve."""
        return frenet(self.curve, s)

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

    def free_numbers(self) -> list[Any]:
        """The arrays of this contour that a design may change: by default all of its floating arrays.

        They are found in the contour by identity: give the arrays themselves, not what is worked out of them.
        """
        return [leaf for leaf in jax.tree.leaves(self) if eqx.is_inexact_array(leaf)]

    def preconditioner(self, size: float) -> np.ndarray:
        r"""Matrix $W$ (n, n) from unknowns to free numbers, $p = \ell\,W x$, with $\ell$ = `size` / 20 [m].

        The free numbers stand in $p$ in the order of the contour's fields, each array row by row. `size` is
        the root mean square distance of the contour's points from its body's origin [m]. Choose $W$ so that
        all unknowns of one size change the curvature alike: points and terms of series are divided by about
        the square of their wave's order. By default it is diagonal: each array is measured against its own
        root mean square, so that numbers which are no lengths need no unit.
        """
        return own_sizes(self, size)

    def symmetrised(self) -> "AbstractContour":
        """This contour made its own mirror image about its x axis: the mean of both; of the same class.

        It runs inside compiled programs, differentiated in the free numbers. By default a class has none.

        Raises:
            ValueError: If the class, or this contour, has no mirror image of its kind.
        """
        raise ValueError(f"argument symmetric must be False for a {type(self).__name__}, but was True")

    def perturbed(self, rng: np.random.Generator) -> "AbstractContour":
        """A contour like this one, of the same class: another start for a search.

        By default every free number is changed by some 15 %.
        """
        return each_perturbed(self, rng)


@eqx.filter_jit
def _frame_arrays(contour: AbstractContour, s: Array) -> tuple[Array, Array, Array]:
    """Points (..., 2), tangents (..., 2) and curvatures (...) at arclengths of any shape, compiled.

    The public methods of a contour call this. `curve` and `frame` themselves see one scalar at a time.
    """
    ready = contour.prepared()

    def one(s: Array) -> tuple[Array, Array, Array]:
        frame = ready.frame(s)
        return frame.point.array(), frame.tangent.array(), jnp.asarray(frame.curvature)

    found = jax.vmap(one)(s.ravel())
    return jax.tree.map(lambda leaf: leaf.reshape(s.shape + leaf.shape[1:]), found)


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
        """The placement as a pose; `prepared` keeps it, so that its sine and cosine are computed once."""
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

    def free_numbers(self) -> list[Any]:
        return self.contour.free_numbers()

    def preconditioner(self, size: float) -> np.ndarray:
        return self.contour.preconditioner(size)

    def symmetrised(self) -> "Moved":
        return eqx.tree_at(lambda m: m.contour, self, self.contour.symmetrised())

    def perturbed(self, rng: np.random.Generator) -> "Moved":
        return eqx.tree_at(lambda m: m.contour, self, self.contour.perturbed(rng))
