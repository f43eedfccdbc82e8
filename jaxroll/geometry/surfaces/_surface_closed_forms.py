"""Surfaces in closed form: plane, sphere, cylinder, torus, ellipsoid, superellipsoid.

All are implicit (`_surface_implicit`): a place is the point itself. Plane, sphere, cylinder and torus use the
signed distance for their field, whose gradient is the normal and whose second derivatives are the shape
operator; frames are written out. The field of an ellipsoid or superellipsoid is no distance, and its frame is
that of the level set.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import square, Sym3, Vec3
from ..._results import as_length, concrete, shown, told_apart, traced
from ..._types import Given, Scalar, Scalars
from ..._xla import once
from ._gauss import Gauss3
from ._spread import directions, lattice, SEEDS, thinned
from ._surface_implicit import AbstractImplicit, Level, level_frame

# Largest exponent of a superellipsoid: above it, the search for its points does not arrive from afar.
_SHARPEST = 32.0


class Plane(AbstractImplicit):
    """A flat face through the body's origin, facing +z.

    Example:
        >>> import jaxroll as jxr
        >>> jxr.geometry.Plane().normal((0.3, 0.2, 0.0)).tolist()
        [0.0, 0.0, 1.0]
    """

    @property
    def smoothness(self) -> float:
        return float("inf")

    def derivatives(self, point: Vec3) -> Level:
        frame = self.frame(tuple(point))
        return Level(point.z, frame.normal, frame.shape)

    def frame(self, at: Scalars) -> Gauss3:
        return Gauss3(Vec3(*at), Vec3(0.0, 0.0, 1.0), Sym3(*(6 * (0.0,))))


class Sphere(AbstractImplicit):
    """A sphere about the body's origin.

    Args:
        radius: In metres, positive.

    Raises:
        ValueError: If the radius is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> jxr.geometry.Sphere(0.01).principal_curvatures((0.0, 0.0, 0.01))[0].tolist()
        [100.0, 100.0]
    """

    radius: Float[Array, ""]

    def __init__(self, radius: Given) -> None:
        self.radius = as_length("radius", radius)

    @property
    def smoothness(self) -> float:
        return float("inf")

    def derivatives(self, point: Vec3) -> Level:
        distance, frame = _round(point)
        return Level(distance - self.radius, frame.normal, frame.shape)

    def frame(self, at: Scalars) -> Gauss3:
        return _round(Vec3(*at))[1]

    def spread(self, count: int) -> Scalars:
        return _outwards(directions(count), (self.radius, self.radius, self.radius))


class Cylinder(AbstractImplicit):
    """A round cylinder without ends, its axis the body's z axis.

    Args:
        radius: In metres, positive.

    Raises:
        ValueError: If the radius is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> jxr.geometry.Cylinder(0.01).principal_curvatures((0.01, 0.0, 0.5))[0].tolist()
        [0.0, 100.0]
    """

    radius: Float[Array, ""]

    def __init__(self, radius: Given) -> None:
        self.radius = as_length("radius", radius)

    @property
    def smoothness(self) -> float:
        return float("inf")

    def derivatives(self, point: Vec3) -> Level:
        distance, frame = _about_axis(point)
        return Level(distance - self.radius, frame.normal, frame.shape)

    def frame(self, at: Scalars) -> Gauss3:
        return _about_axis(Vec3(*at))[1]


class Torus(AbstractImplicit):
    r"""A ring about the body's z axis: a circle of radius `minor` whose centre runs round one of `major`.

    Its principal curvatures are $1/r$ and $\cos\theta / (R + r \cos\theta)$, negative on the inner side.

    Args:
        major: In metres, larger than `minor`.
        minor: In metres, positive.

    Raises:
        ValueError: If a radius is not positive, or `minor` not the smaller one.

    Example:
        >>> import jaxroll as jxr
        >>> jxr.geometry.Torus(0.03, 0.01).principal_curvatures((0.02, 0.0, 0.0))[0].round(9).tolist()
        [-50.0, 100.0]
    """

    major: Float[Array, ""]
    minor: Float[Array, ""]

    def __init__(self, major: Given, minor: Given) -> None:
        self.major, self.minor = as_length("major", major), as_length("minor", minor)
        seen = concrete(self.major), concrete(self.minor)
        if seen[0] is not None and seen[1] is not None and not seen[0] > seen[1]:
            was, minor = told_apart(*seen)
            raise ValueError(f"argument major must be larger than minor, {minor}, but was {was}")

    @property
    def smoothness(self) -> float:
        return float("inf")

    def derivatives(self, point: Vec3) -> Level:
        distance, frame = self._around(point)
        return Level(distance - self.minor, frame.normal, frame.shape)

    def frame(self, at: Scalars) -> Gauss3:
        return self._around(Vec3(*at))[1]

    def spread(self, count: int) -> Scalars:
        # Even in both angles, and so denser on the inner side, which thinning evens out.
        turn, roll = 2.0 * np.pi * lattice(SEEDS * count, 2).T
        out = self.major + self.minor * np.cos(roll)
        points = (out * np.cos(turn), out * np.sin(turn), self.minor * np.sin(roll))
        return _thinned(points, count)

    def _around(self, point: Vec3) -> tuple[Scalar, Gauss3]:
        """Distance from the circle of the tube's centres, and the frame of the torus through the point."""
        # With theta in the meridian plane: cos(theta) = out, sin(theta) = up.
        radial = jnp.sqrt(point.x * point.x + point.y * point.y)
        inverse = once(1.0 / radial)
        cos, sin = point.x * inverse, point.y * inverse
        beyond = radial - self.major
        distance = jnp.sqrt(beyond * beyond + point.z * point.z)
        near = once(1.0 / distance)
        out, up = beyond * near, point.z * near
        # Curvatures: 1 / distance along the meridian, cos(theta) / radial along the parallel.
        normal = Vec3(cos * out, sin * out, up)
        meridian = Vec3(-cos * up, -sin * up, out)
        parallel = Vec3(-sin, cos, jnp.zeros_like(cos))
        shape = square(meridian) * near + square(parallel) * (out * inverse)
        return distance, Gauss3(point, normal, shape)


class Ellipsoid(AbstractImplicit):
    r"""The ellipsoid $x^2/a^2 + y^2/b^2 + z^2/c^2 = 1$ about the body's origin.

    Args:
        a: Half axis along x, in metres, positive.
        b: Half axis along y.
        c: Half axis along z.

    Raises:
        ValueError: If a half axis is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> tip = jxr.geometry.Ellipsoid(0.03, 0.02, 0.01)  # at the end of c: c / a**2 and c / b**2
        >>> tip.principal_curvatures((0.0, 0.0, 0.01))[0].round(6).tolist()
        [11.111111, 25.0]
    """

    a: Float[Array, ""]
    b: Float[Array, ""]
    c: Float[Array, ""]

    def __init__(self, a: Given, b: Given, c: Given) -> None:
        self.a, self.b, self.c = as_length("a", a), as_length("b", b), as_length("c", c)

    @property
    def smoothness(self) -> float:
        return float("inf")

    def derivatives(self, point: Vec3) -> Level:
        # F = (x^2/a^2 + y^2/b^2 + z^2/c^2 - 1) / 2, so that the gradient is (x/a^2, y/b^2, z/c^2).
        weights = Vec3(*(once(1.0 / (axis * axis)) for axis in (self.a, self.b, self.c)))
        half = Vec3(*(w * x for w, x in zip(weights, point, strict=True)))
        zero = jnp.zeros_like(weights.x)
        hessian = Sym3(weights.x, zero, zero, weights.y, zero, weights.z)
        return Level(0.5 * (half.dot(point) - 1.0), half, hessian)

    def frame(self, at: Scalars) -> Gauss3:
        point = Vec3(*at)
        return level_frame(point, self.derivatives(point))

    def spread(self, count: int) -> Scalars:
        return _thinned(_outwards(directions(SEEDS * count), (self.a, self.b, self.c)), count)


class Superellipsoid(AbstractImplicit):
    r"""The box with rounded edges $|x/a|^p + |y/b|^p + |z/c|^p = 1$ about the body's origin.

    For $p > 2$ it is flat where it crosses an axis: its curvatures vanish there.

    Args:
        a: Half axis along x, in metres, positive.
        b: Half axis along y.
        c: Half axis along z.
        exponent: $p$, 2 to 32. An even number gives an analytic surface; others a surface with
            $\lceil p \rceil - 1$ continuous derivatives, on the planes of symmetry. Static.

    Raises:
        ValueError: If a length is not positive, or `exponent` is no known number from 2 to 32.

    Example:
        >>> import jaxroll as jxr
        >>> block = jxr.geometry.Superellipsoid(0.03, 0.02, 0.01, exponent=4)
        >>> block.principal_curvatures((0.0, 0.0, 0.01))[0].tolist()
        [0.0, 0.0]
    """

    a: Float[Array, ""]
    b: Float[Array, ""]
    c: Float[Array, ""]
    exponent: float = eqx.field(static=True)

    def __init__(self, a: Given, b: Given, c: Given, exponent: float = 4.0) -> None:
        self.a, self.b, self.c = as_length("a", a), as_length("b", b), as_length("c", c)
        if traced(exponent):
            raise ValueError(
                "argument exponent must be a number that is known before tracing, for it is static, but was "
                f"{shown(exponent)}"
            )
        real = isinstance(exponent, int | float | np.integer | np.floating) and not isinstance(exponent, bool)
        if not real or not 2.0 <= exponent <= _SHARPEST:
            raise ValueError(
                f"argument exponent must be at least 2 and at most {_SHARPEST:g}, but was {shown(exponent)}"
            )
        self.exponent = float(exponent)

    @property
    def smoothness(self) -> float:
        even = self.exponent % 2.0 == 0.0
        return math.inf if even else float(math.ceil(self.exponent) - 1)

    def derivatives(self, point: Vec3) -> Level:
        # F = (|x/a|^p + |y/b|^p + |z/c|^p - 1) / p.
        p = self.exponent
        terms = [_power(x / axis, p) for x, axis in zip(point, (self.a, self.b, self.c), strict=True)]
        value = terms[0][0] + terms[1][0] + terms[2][0] - 1.0
        slopes = Vec3(terms[0][1] / self.a, terms[1][1] / self.b, terms[2][1] / self.c)
        bends = [
            bend / (axis * axis) for (_, _, bend), axis in zip(terms, (self.a, self.b, self.c), strict=True)
        ]
        zero = jnp.zeros_like(value)
        return Level(value / p, slopes, Sym3(bends[0], zero, zero, bends[1], zero, bends[2]))

    def frame(self, at: Scalars) -> Gauss3:
        point = Vec3(*at)
        return level_frame(point, self.derivatives(point))

    def spread(self, count: int) -> Scalars:
        # Directions scaled to the unit superellipsoid, then stretched by the axes.
        rays, p = directions(SEEDS * count), self.exponent
        rays = rays / np.sum(np.abs(rays) ** p, axis=-1, keepdims=True) ** (1.0 / p)
        return _thinned(_outwards(rays, (self.a, self.b, self.c)), count)


def _outwards(rays: np.ndarray, axes: Scalars) -> Scalars:
    """Points along rays of the unit body, stretched by the axes."""
    return tuple(axis * rays[:, i] for i, axis in enumerate(axes))


def _thinned(points: Scalars, count: int) -> Scalars:
    """`count` of these points, spread as far apart as they can be taken one by one."""
    kept = thinned(Vec3(*points), jnp.ones(points[0].shape, bool), count)
    return tuple(x[kept] for x in points)


def _round(point: Vec3) -> tuple[Scalar, Gauss3]:
    """Distance from the origin, and the frame of the sphere through the point."""
    distance = point.norm()
    inverse = once(1.0 / distance)
    normal = once(point * inverse)
    one, zero = jnp.ones_like(inverse), jnp.zeros_like(inverse)
    # L = (1 - n n^T) / distance.
    flat = Sym3(one, zero, zero, one, zero, one) - square(normal)
    return distance, Gauss3(point, normal, flat * inverse)


def _about_axis(point: Vec3) -> tuple[Scalar, Gauss3]:
    """Distance from the z axis, and the frame of the cylinder through the point."""
    distance = jnp.sqrt(point.x * point.x + point.y * point.y)
    inverse = once(1.0 / distance)
    # L = t t^T / distance with the tangent t = (-y, x, 0) round the axis.
    x, y, zero = point.x * inverse, point.y * inverse, jnp.zeros_like(inverse)
    shape = Sym3(y * y * inverse, -x * y * inverse, zero, x * x * inverse, zero, zero)
    return distance, Gauss3(point, Vec3(x, y, zero), shape)


def _power(x: Scalar, p: float) -> tuple[Scalar, Scalar, Scalar]:
    """Value of |x|^p and, over p, its first two derivatives: closed forms, since autodiff fails at zero."""
    # An even p is an integer power of x itself, which has all derivatives at zero; |x| has a kink there.
    whole = int(p) if p % 2.0 == 0.0 else None
    if whole:
        bend = x ** (whole - 2)
    else:
        # Below p = 3 the power has an infinite derivative at zero, which the factors below would make NaN of.
        zero = x == 0.0
        bend = jnp.where(zero, 0.0, jnp.where(zero, 1.0, jnp.abs(x)) ** (p - 2.0))
    return bend * x * x, bend * x, (p - 1.0) * bend
