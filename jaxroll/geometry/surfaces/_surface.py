r"""The contract of a surface, smooth and oriented: point, outward normal $n$ and shape operator $L = dn$.

An `AbstractSurface` gives its frame (`_gauss.Gauss3`) at a place, how the place moves with a tangent
velocity, and how a place that has drifted off is put back. `contact` reads these as scalars inside the
equations of motion; `contact.locating` searches with them. The methods for users take arrays.
`_surface_implicit` and `_surface_chart` are the two kinds of place: a point of space, or two parameters.

A surface placed elsewhere (`MovedSurface`), or seen from inside (`Hollow`), is a surface again, with the
coordinates of the one it is made of.
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import normalised, Pose3, pose_at, tangents, UNIT_AXES, unstack, Vec3
from ..._results import as_array, as_floats, concrete, shown
from ..._types import Given, Scalars
from ..._xla import once, perturbed, quickly, traced_once
from .._tabled import AbstractShape, tabled
from ._gauss import approach, Gauss3, principal

# Steps of Newton's method in `closest`: this many, because starts may be far and surfaces far from round.
_SEARCH = 32
# A search that ends farther off than this has not arrived; relative to the distances of the point.
_NEAR = 1e-6


class AbstractSurface(AbstractShape):
    r"""A smooth surface of a body, in the body's frame, with its normal $n$ outward.

    The shape operator $L = \mathrm{d}n$ maps a tangent displacement of the contact point to the change of
    the normal. It is symmetric, $L n = 0$, and the second form $v \cdot L v$ is positive where the body is
    convex, so that a ball of radius $r$ has $L = 1/r$. Lengths are in metres.

    A place on the surface is a tuple `at` of `coordinates` scalars: of an implicit surface the point itself,
    which has no poles; of a chart its two parameters.

    To add a surface, subclass `AbstractImplicit` or `AbstractChart`. The methods that take and return
    scalars (`Vec3`) run inside the equations of motion; those that take arrays, of shape
    (..., `coordinates`), are for use outside.
    """

    @property
    @abc.abstractmethod
    def coordinates(self) -> int:
        """How many numbers give a place on the surface: 3 if implicit, 2 in a chart."""

    @property
    @abc.abstractmethod
    def smoothness(self) -> float:
        """Continuous derivatives of the surface; the shape operator has two fewer."""

    @abc.abstractmethod
    def frame(self, at: Scalars) -> Gauss3:
        """Point, outward normal and shape operator, as scalars."""

    @abc.abstractmethod
    def rate(self, at: Scalars, velocity: Vec3) -> Scalars:
        """Rates of the coordinates when the place moves over the surface with this tangent velocity."""

    @abc.abstractmethod
    def settled(self, at: Scalars) -> Scalars:
        """Coordinates put back onto the surface, from which integration errors carry them off."""

    @abc.abstractmethod
    def basis(self, at: Scalars) -> tuple[Vec3, Vec3]:
        """Tangent vectors in which `forms` gives the forms: the chart's own, or else `tangents`."""

    @abc.abstractmethod
    def start(self, point: Vec3) -> Scalars:
        """Where the search for the surface's point closest to a point begins."""

    def spread(self, count: int) -> Scalars | None:
        """Coordinates of `count` places spread evenly over the whole surface, shape (count,) each.

        None where the surface has no bounds, or none are known. Places may repeat.
        """
        return None

    def margins(self, at: Scalars) -> Scalars:
        """Distances [m] of a place from the ends of the surface, positive inside; none where it has no ends.

        To first order in the distance.
        """
        return ()

    def within(self, at: Scalars) -> Scalars:
        """Coordinates brought into the domain: round its periods, and back to its ends."""
        return at

    def closest(self, point: Vec3, at: Scalars) -> Scalars:
        r"""Coordinates of the surface's point closest to `point`, from a guess: Newton's method, as scalars.

        With $r = p - P$ and $h = r \cdot n$, the tangent step solves $(1 + h L)\,\delta = r - h n$, cut to
        half the smallest radius of curvature. The minimum is a local one.
        """
        return _closest(self, point, at)

    def near(self, point: Given, guess: Given | None = None) -> Float[Array, "... coordinates"]:
        """Coordinates of the surface's points closest to points of shape (..., 3), in metres.

        Args:
            point: Shape (..., 3) [m], nearer to the surface than its centres of curvature.
            guess: Coordinates to begin with, shape (..., coordinates); None: from a start of its own.

        Returns:
            Shape (..., coordinates); NaN where the search does not arrive at a point of the surface whose
            normal goes through the point, as it may not for surfaces far from round.
        """
        points = _last("point", point, 3)
        if guess is None:
            return _near(tabled(self), points, None)
        begin = _last("guess", guess, self.coordinates)
        return _near(tabled(self), *_broadcast(point=points, guess=begin))

    def point(self, at: Given) -> Float[Array, "... 3"]:
        """Points [m] at coordinates `at` of shape (..., coordinates)."""
        return self._frames(at).point.array()

    def normal(self, at: Given) -> Float[Array, "... 3"]:
        """Outward unit normals."""
        return self._frames(at).normal.array()

    def tangents(self, at: Given) -> Float[Array, "... 2 3"]:
        r"""Orthonormal tangents, $t_1 \times t_2 = n$; they jump where $n_z = -1/2$ and nowhere else."""
        return _tangents(self._frames(at))

    def shape_operator(self, at: Given) -> Float[Array, "... 3 3"]:
        """The shape operator [1/m] as a symmetric matrix in the body's axes, zero along the normal."""
        return self._frames(at).shape.array()

    def principal_curvatures(self, at: Given) -> tuple[Float[Array, "... 2"], Float[Array, "... 2 3"]]:
        """Principal curvatures [1/m], the smaller first, and their directions; positive where convex.

        Where both are the same the directions are any two, and the derivatives those of the mean.
        """
        return _principal(self._frames(at))

    def normal_curvature(self, at: Given, direction: Given) -> Float[Array, "..."]:
        r"""Curvature [1/m] of the normal section along `direction`, shape (..., 3): $v \cdot L v / |v|^2$.

        What `direction` has along the normal is left out.
        """
        places, along = _broadcast(at=self._at(at), direction=_last("direction", direction, 3))
        return _normal_curvature(self._frames(places), along)

    def forms(self, at: Given) -> tuple[Float[Array, "... 2 2"], Float[Array, "... 2 2"]]:
        """First and second fundamental form, in the chart's own tangents or else in `tangents`.

        Units follow the tangents: none and 1/m where these are unit vectors.
        """
        return _forms(self._frames(at), _bases(tabled(self), self._at(at)))

    def moved(self, offset: Given = (0.0, 0.0, 0.0), rotation: Given | None = None) -> "AbstractSurface":
        """This surface turned by a quaternion (scalar first), if one is given, then shifted [m]."""
        return MovedSurface(self, offset, rotation)

    def _frames(self, at: Given) -> Gauss3:
        return _frames(tabled(self), self._at(at))

    def _at(self, at: Given) -> Array:
        return _last("at", at, self.coordinates)


def _sum(left: Scalars, right: Scalars) -> Scalars:
    return tuple(a + b for a, b in zip(left, right, strict=True))


@jax.jit
def _tangents(frame: Gauss3) -> Array:
    first, second = tangents(frame.normal)
    return jnp.stack([first.array(), second.array()], axis=-2)


@jax.jit
def _principal(frame: Gauss3) -> tuple[Array, Array]:
    found = principal(frame)
    values = jnp.stack([found.low, found.high], axis=-1)
    return values, jnp.stack([found.along_low.array(), found.along_high.array()], axis=-2)


@jax.jit
def _normal_curvature(frame: Gauss3, direction: Array) -> Array:
    # Only the tangent part of the direction counts.
    v = Vec3(*(direction[..., i] for i in range(3)))
    v = v - frame.normal * v.dot(frame.normal)
    return frame.shape.form(v, v) / v.dot(v)


@jax.jit
def _forms(frame: Gauss3, basis: tuple[Vec3, Vec3]) -> tuple[Array, Array]:
    (u, v), form = basis, frame.shape.form
    first = _square(u.dot(u), u.dot(v), v.dot(v))
    return first, _square(form(u, u), form(u, v), form(v, v))


def _square(a: Array, b: Array, c: Array) -> Array:
    """Symmetric matrices ((a, b), (b, c)) of shape (..., 2, 2)."""
    return jnp.stack([jnp.stack([a, b], axis=-1), jnp.stack([b, c], axis=-1)], axis=-2)


def _last(name: str, value: Given, size: int) -> Array:
    """An array of the default floating type whose last axis has this length."""
    array = as_array(name, value)
    if array.ndim == 0 or array.shape[-1] != size:
        raise ValueError(f"argument {name} must have shape (..., {size}), but had shape {array.shape}")
    return as_floats(name, array, (None,) * array.ndim)


def _broadcast(**given: Array) -> list[Array]:
    """Arguments by name, broadcast along all axes but the last."""
    shapes = [array.shape for array in given.values()]
    try:
        leading = np.broadcast_shapes(*(shape[:-1] for shape in shapes))
    except ValueError:
        raise ValueError(
            f"arguments {' and '.join(given)} must have shapes that fit but for the last axis, "
            f"but had shapes {' and '.join(map(str, shapes))}"
        ) from None
    return [jnp.broadcast_to(array, (*leading, array.shape[-1])) for array in given.values()]


def _mapped(function: Callable[..., Any], *arrays: Array) -> Any:
    """A function of tuples of scalars, mapped over the leading axes of arrays, which are broadcast.

    The last axis of each array is a tuple's. Inside `vmap` the function sees scalars, as in a run.
    """
    shape = jnp.broadcast_shapes(*(a.shape[:-1] for a in arrays))
    flat = [jnp.broadcast_to(a, (*shape, a.shape[-1])).reshape(-1, a.shape[-1]) for a in arrays]
    out = jax.vmap(lambda *rows: function(*(unstack(row) for row in rows)))(*flat)
    return jax.tree.map(lambda leaf: leaf.reshape(shape + leaf.shape[1:]), out)


@eqx.filter_jit
def _frames(surface: AbstractSurface, at: Array) -> Gauss3:
    ready = surface.prepared()
    return _mapped(lambda one: jax.tree.map(jnp.asarray, ready.frame(one)), at)


@eqx.filter_jit
def _bases(surface: AbstractSurface, at: Array) -> tuple[Vec3, Vec3]:
    ready = surface.prepared()
    return _mapped(lambda one: jax.tree.map(jnp.asarray, ready.basis(one)), at)


@eqx.filter_custom_jvp
def _closest(surface: AbstractSurface, point: Vec3, start: Scalars) -> Scalars:
    """The search of `AbstractSurface.closest`, whose derivative rule is below."""
    return _searched(surface, point, start)


@traced_once
def _searched(surface: AbstractSurface, point: Vec3, start: Scalars) -> Scalars:
    # The number of steps is fixed: all searches of a batch are equally long.
    def step(at: Scalars, _: None) -> tuple[Scalars, None]:
        return _stepped(surface, point, at, careful=True), None

    # The scan's carry must keep its type from the first step on.
    first = tuple(jnp.asarray(x, jnp.result_type(point.x)) for x in surface.settled(start))
    return jax.lax.scan(step, first, None, length=_SEARCH)[0]


@_closest.def_jvp
def _closest_jvp(primals: Any, tangents: Any) -> tuple[Scalars, Scalars]:
    """The derivative of one more Newton step from the closest point.

    It is that of the closest point, since at a root the step does not depend on where it begins, to first
    order. The derivative of all steps, backwards, is a program ten times as long.
    """
    surface, point, start = primals
    at = _closest(surface, point, start)
    moving, still, dots = perturbed((surface, point), tuple(tangents[:2]))

    def further(moving: Any) -> Scalars:
        # First onto the surface that has changed: Newton's step is that of the level set on which it begins.
        surface, point = eqx.combine(moving, still)
        return _stepped(surface, point, surface.settled(at), careful=False)

    return at, jax.jvp(further, (moving,), (dots,))[1]


def _stepped(surface: AbstractSurface, point: Vec3, at: Scalars, *, careful: bool) -> Scalars:
    """One step of the search: in the tangent plane, in coordinates, and back onto the surface."""
    tangent = approach(surface.frame(at), point, careful=careful)
    return surface.settled(_sum(at, surface.rate(at, tangent)))


@quickly
def _near(surface: AbstractSurface, points: Array, guess: Array | None) -> Array:
    ready = surface.prepared()

    def search(point: Scalars, *given: Scalars) -> Array:
        target = Vec3(*point)
        at = ready.closest(target, *(given or (ready.start(target),)))
        return jnp.where(_arrived(ready, target, at), jnp.stack(at), jnp.nan)

    return _mapped(search, points) if guess is None else _mapped(search, points, guess)


def _arrived(surface: AbstractSurface, target: Vec3, at: Scalars) -> Array:
    """Whether a search has arrived: the place is on the surface, and the target on the normal through it.

    Both are judged by a distance [m] relative to the size of the problem: how far the target lies beside the
    normal, and how far `settled` would still move the place.
    """
    # `aside` is the arm less its part along the normal.
    frame, back = surface.frame(at), surface.frame(surface.settled(at))
    arm = target - frame.point
    aside = arm - frame.normal * arm.dot(frame.normal)
    size = jnp.sqrt(frame.point.dot(frame.point) + arm.dot(arm))
    off = jnp.sqrt(jnp.maximum(aside.dot(aside), (back.point - frame.point).dot(back.point - frame.point)))
    return jax.lax.stop_gradient(off <= _NEAR * size)


class AbstractSurfaceOf(AbstractSurface):
    """A surface made of another one, with that one's coordinates."""

    surface: eqx.AbstractVar[AbstractSurface]

    @property
    def coordinates(self) -> int:
        return self.surface.coordinates

    @property
    def smoothness(self) -> float:
        return self.surface.smoothness

    def settled(self, at: Scalars) -> Scalars:
        return self.surface.settled(at)

    def spread(self, count: int) -> Scalars | None:
        return self.surface.spread(count)

    def margins(self, at: Scalars) -> Scalars:
        return self.surface.margins(at)

    def within(self, at: Scalars) -> Scalars:
        return self.surface.within(at)


class MovedSurface(AbstractSurfaceOf):
    """A surface placed in its body's frame: turned by a rotation, then shifted by `offset`.

    Its coordinates are those of the surface it places: of an implicit one the point before the move. `near`
    finds them.

    Args:
        surface: The surface to place.
        offset: Where its body's origin goes, shape (3,), in metres.
        rotation: Quaternion, scalar first, shape (4,); it is scaled to unit length. Default: None, a shift
            alone, whose program has no turn.

    Raises:
        ValueError: If `surface` is not a surface, `rotation` is zero, or an argument is not finite or of
            another shape.

    Example:
        >>> import jaxroll as jxr
        >>> tip = jxr.geometry.Sphere(0.01).moved(offset=(0.02, 0.0, 0.0))
        >>> tip.point(tip.near((0.05, 0.0, 0.0))).round(12).tolist()
        [0.03, 0.0, 0.0]
    """

    surface: AbstractSurface
    offset: Float[Array, "3"]
    rotation: Float[Array, "4"] | None
    pose: Pose3 | None

    def __init__(
        self,
        surface: AbstractSurface,
        offset: Given = (0.0, 0.0, 0.0),
        rotation: Given | None = None,
    ) -> None:
        if not isinstance(surface, AbstractSurface):
            raise ValueError(f"argument surface must be a surface, but was {shown(surface)}")
        self.surface = surface
        self.offset = as_floats("offset", offset, (3,))
        self.rotation = None if rotation is None else as_floats("rotation", rotation, (4,))
        seen = None if self.rotation is None else concrete(self.rotation)
        if seen is not None and not seen.any():
            raise ValueError(f"argument rotation must be a quaternion, but was {seen.tolist()}")
        self.pose = None

    def placed(self) -> Pose3:
        """The placement as a pose; `prepared` keeps it, so that it is computed once."""
        if self.pose is not None:
            return self.pose
        origin = Vec3(*unstack(self.offset))
        if self.rotation is None:
            return Pose3(origin, *UNIT_AXES)
        return pose_at(origin, normalised(unstack(self.rotation)))

    def frame(self, at: Scalars) -> Gauss3:
        # `once`, because XLA would place the frame again for each number that is computed from it.
        return once(self.surface.frame(at).placed(self.placed()))

    def rate(self, at: Scalars, velocity: Vec3) -> Scalars:
        return self.surface.rate(at, self.placed().back(velocity))

    def basis(self, at: Scalars) -> tuple[Vec3, Vec3]:
        first, second = self.surface.basis(at)
        place = self.placed()
        return place.turn(first), place.turn(second)

    def start(self, point: Vec3) -> Scalars:
        return self.surface.start(self.placed().local(point))

    def prepared(self) -> "MovedSurface":
        ready = (self.surface.prepared(), self.placed())
        return eqx.tree_at(lambda m: (m.surface, m.pose), self, ready, is_leaf=lambda x: x is None)


class Hollow(AbstractSurfaceOf):
    """A surface seen from inside: the body is all round it, as the wall of a tube or of a bowl.

    Args:
        surface: The surface of the hole.

    Raises:
        ValueError: If `surface` is not a surface.

    Example:
        >>> import jaxroll as jxr
        >>> bowl = jxr.geometry.Hollow(jxr.Sphere(0.1))
        >>> bowl.principal_curvatures((0.0, 0.0, -0.1))[0].round(9).tolist()
        [-10.0, -10.0]
    """

    surface: AbstractSurface

    def __init__(self, surface: AbstractSurface) -> None:
        if not isinstance(surface, AbstractSurface):
            raise ValueError(f"argument surface must be a surface, but was {shown(surface)}")
        self.surface = surface

    def frame(self, at: Scalars) -> Gauss3:
        inner = self.surface.frame(at)
        return Gauss3(inner.point, -inner.normal, inner.shape * -1.0)

    def rate(self, at: Scalars, velocity: Vec3) -> Scalars:
        return self.surface.rate(at, velocity)

    def basis(self, at: Scalars) -> tuple[Vec3, Vec3]:
        # In the other order, so that the cross product of both points along the turned normal.
        first, second = self.surface.basis(at)
        return second, first

    def start(self, point: Vec3) -> Scalars:
        return self.surface.start(point)
