r"""The contract of a contour: a plane curve $c(s)$ by its arclength $s$, so that $|c'(s)| = 1$.

Unit tangent $b = c'$ and curvature $\kappa = b \times b'$ follow from the point alone, (8)-(10), by
`_frenet`. Every contour of the package is an `AbstractContour`: `_closed_forms` and `_catenary` write point
and frame out, `_table` reads them from a table. `contact` takes a `Frenet2` of each of two contours, and
`design` changes a contour's free numbers (`_free_numbers`).
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import Pose2, sincos, unstack, Vec2
from ..._results import as_array, as_floats, concrete, shown
from ..._types import ByPrecision, Given, Points, Scalar
from .._tabled import tabled
from ._free_numbers import AbstractDesigned
from ._frenet import frenet, Frenet2


class AbstractContour(AbstractDesigned):
    r"""A smooth planar contour, parametrised by arclength, counter-clockwise round its body.

    With tangent $b = c'(s)$, the outward normal is $b$ turned by -90 degrees and the curvature
    $\kappa$ is positive where the body is convex. Lengths are in metres, in the body's frame.

    To add a contour, subclass this and give `curve`, `domain`, `closed` and `smoothness`; no other
    module of the package needs a change. Everything else has a default, which a class overrides where it
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
        """How many continuous derivatives the point has; fewer than a solver's order plus one lower it."""

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
        return _frame_arrays(tabled(self), as_array("s", s))[2]

    def curvature(self, s: Given) -> Float[Array, "..."]:
        """Curvatures [1/m] at arclengths `s` [m] of shape (...); positive where convex."""
        return _frame_arrays(tabled(self), as_array("s", s))[3]

    def moved(self, offset: Given = (0.0, 0.0), angle: Given = 0.0, *, origin: Given = 0.0) -> "Moved":
        """This contour turned by `angle` [rad], shifted by `offset` [m], its s = 0 put at `origin`."""
        return Moved(self, offset, angle, origin=origin)


@eqx.filter_jit  # not `quickly`, whose calls take 0.5 ms longer: here they are many, and compiling is short
def _frame_arrays(contour: AbstractContour, s: Array) -> tuple[Array, Array, Array, Array]:
    """Points, tangents, normals (..., 2) and curvatures (...) at arclengths of any shape, compiled.

    The public methods of a contour call this. `curve` and `frame` themselves see one scalar at a time.
    """
    ready = contour.prepared()

    def one(s: Array) -> tuple[Array, Array, Array, Array]:
        frame = ready.frame(s)
        point, tangent, normal = frame.point, frame.tangent, frame.tangent.right()
        return point.array(), tangent.array(), normal.array(), jnp.asarray(frame.curvature)

    found = jax.vmap(one)(s.ravel())
    return jax.tree.map(lambda leaf: leaf.reshape(s.shape + leaf.shape[1:]), found)


# Angle [rad] between two axes, or of an offset against one, that counts as zero; and a length [m] that does.
_LEVEL = ByPrecision(1e-12, 1e-6)
_NEARBY = 1e-12


class Moved(AbstractContour):
    """A contour placed in its body's frame: turned by `angle`, then shifted by `offset`.

    Args:
        contour: The contour to place.
        offset: Where its body's origin goes, shape (2,), in metres.
        angle: Counter-clockwise turn in radians.
        origin: Arclength [m] at which the placed contour has the point that `contour` has at zero.

    Raises:
        ValueError: If `contour` is not a contour, or another argument is not finite or of another shape.

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
        # The placed contour becomes its mirror image about its own x axis, which must lie on the body's.
        angle, offset = concrete(self.angle), concrete(self.offset)
        none = _LEVEL.of(self.angle, self.offset)
        turned = angle is not None and abs(np.sin(angle)) > none
        if turned or offset is not None and abs(offset[1]) > none * abs(offset[0]) + _NEARBY:
            raise ValueError(
                f"argument symmetric must be False unless a contour is placed with its x axis on that of "
                f"the fingertip, but this {type(self.contour).__name__} was turned by "
                f"{shown(self.angle)} rad and moved by {shown(self.offset)} m"
            )
        return eqx.tree_at(lambda m: m.contour, self, self.contour.symmetrised())

    def perturbed(self, rng: np.random.Generator) -> "Moved":
        return eqx.tree_at(lambda m: m.contour, self, self.contour.perturbed(rng))
