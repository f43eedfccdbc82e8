r"""Surfaces given by a chart $P(u, v)$: the contact coordinates are its two parameters.

Point, normal $n = P_u \times P_v / |P_u \times P_v|$ and shape operator follow from the chart's first and
second derivatives, a `Jet`. A place never leaves such a surface, but a chart may have ends, periods and
poles. `_surface_patch` and `Chart`, for any function, subclass `AbstractChart`. An implicit surface
(`_surface_implicit`) needs no chart.
"""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._closures import as_tree
from ..._linalg import outer, square, Vec3
from ..._results import as_floats, as_order, check_callable, concrete, shown, traceable
from ..._types import Given, Scalar, Scalars
from ..._xla import once
from ._gauss import Gauss3
from ._spread import lattice, SEEDS, thinned
from ._surface import AbstractSurface

# Places along each parameter at which a search for the closest point may begin.
_SEEDS = 16


class Jet(NamedTuple):
    """A chart at one place: point, first and second derivatives."""

    point: Vec3
    u: Vec3
    v: Vec3
    uu: Vec3
    uv: Vec3
    vv: Vec3


def jet(chart: Callable[[Scalar, Scalar], Vec3], at: Scalars) -> Jet:
    """Derivatives of a chart, forward over forward: three passes for both first and three second ones."""
    place = tuple(jnp.asarray(x) for x in at)
    zero, one = jnp.zeros_like(place[0]), jnp.ones_like(place[0])
    along_u, along_v = (one, zero), (zero, one)

    def slope(axis: Scalars) -> Callable[..., tuple[Vec3, Vec3]]:
        return lambda *p: jax.jvp(chart, p, axis)

    (point, u), (v, uv) = jax.jvp(slope(along_u), place, along_v)
    _, (_, uu) = jax.jvp(slope(along_u), place, along_u)
    _, (_, vv) = jax.jvp(slope(along_v), place, along_v)
    return Jet(point, u, v, uu, uv, vv)


class AbstractChart(AbstractSurface):
    r"""A surface as the image of a chart $P(u, v)$ with $P_u \times P_v$ outward; `at` is $(u, v)$.

    With the dual tangents $e^i \cdot P_j = \delta^i_j$, the shape operator is
    $L = -\sum_{ij} (P_{ij} \cdot n)\, e^i e^j$: it needs no orthogonal chart, but breaks down where
    $P_u \times P_v = 0$, as at the poles of a sphere.

    To add one, subclass this and give `derivatives` (`jet` where no closed form is at hand), `domain`,
    `periodic` (of u and of v) and `smoothness`; `prepared` where there is work to be done once.
    """

    periodic: eqx.AbstractVar[tuple[bool, bool]]

    @abc.abstractmethod
    def derivatives(self, at: Scalars) -> Jet:
        """Point, first and second derivatives of the chart, as scalars."""

    @abc.abstractmethod
    def domain(self) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
        """Ends of u and of v; of a periodic one, the ends of a period."""

    @property
    def coordinates(self) -> int:
        return 2

    def frame(self, at: Scalars) -> Gauss3:
        here = self.derivatives(at)
        area = here.u.cross(here.v)
        inverse = once(1.0 / area.norm())
        normal = once(area * inverse)
        # Dual tangents: e^u = P_v x n / |P_u x P_v| and e^v = n x P_u / |P_u x P_v|. `outer` is the symmetric
        # part, so that the mixed term counts twice.
        first, second = here.v.cross(normal) * inverse, normal.cross(here.u) * inverse
        bends = (-here.uu.dot(normal), -here.uv.dot(normal), -here.vv.dot(normal))
        shape = square(first) * bends[0] + outer(first, second) * (2.0 * bends[1]) + square(second) * bends[2]
        return Gauss3(here.point, normal, shape)

    def rate(self, at: Scalars, velocity: Vec3) -> Scalars:
        # velocity = u' P_u + v' P_v: its products with both tangents are two linear equations for u' and v'.
        u, v = self.basis(at)
        a, b, c = u.dot(u), u.dot(v), v.dot(v)
        x, y = u.dot(velocity), v.dot(velocity)
        inverse = once(1.0 / (a * c - b * b))
        return (c * x - b * y) * inverse, (a * y - b * x) * inverse

    def settled(self, at: Scalars) -> Scalars:
        return at

    def basis(self, at: Scalars) -> tuple[Vec3, Vec3]:
        here = self.derivatives(at)
        return here.u, here.v

    def spread(self, count: int) -> Scalars:
        # Seeds are even in the parameters, not on the surface; thinning takes the farthest points in space.
        share = lattice(SEEDS * count, 2)
        u, v = (low + (high - low) * share[:, i] for i, (low, high) in enumerate(self.domain()))
        points = jax.vmap(lambda *at: self.derivatives(at).point)(jnp.asarray(u), jnp.asarray(v))
        kept = thinned(points, jnp.ones(points.x.shape, bool), count)
        return jnp.asarray(u)[kept], jnp.asarray(v)[kept]

    def margins(self, at: Scalars) -> Scalars:
        found: list[Scalar] = []
        for x, along, (low, high), loop in zip(at, self.basis(at), self.domain(), self.periodic, strict=True):
            if not loop:
                # A metre along P_u is 1 / |P_u| of the parameter.
                speed = along.norm()
                found += [(x - low) * speed, (high - x) * speed]
        return tuple(found)

    def within(self, at: Scalars) -> Scalars:
        ends = zip(at, self.domain(), self.periodic, strict=True)
        return tuple(bounded(x, end, loop) for x, end, loop in ends)

    def start(self, point: Vec3) -> Scalars:
        (u0, u1), (v0, v1) = self.domain()
        share = (np.arange(_SEEDS) + 0.5) / _SEEDS
        u = jnp.repeat(u0 + (u1 - u0) * share, _SEEDS)
        v = jnp.tile(v0 + (v1 - v0) * share, _SEEDS)
        away = jax.vmap(lambda *at: self.derivatives(at).point - point)(u, v)
        best = jnp.argmin(away.dot(away))
        return u[best], v[best]


def as_flags(periodic: Any) -> tuple[bool, bool]:
    """Which of both parameters are periodic."""
    pair = isinstance(periodic, tuple | list) and len(periodic) == 2
    if not pair or not all(isinstance(flag, bool | np.bool_) for flag in periodic):
        raise ValueError(f"argument periodic must be two of True and False, but was {shown(periodic)}")
    return bool(periodic[0]), bool(periodic[1])


def bounded(x: Scalar, ends: tuple[Scalar, Scalar], periodic: bool) -> Scalar:
    """A parameter brought into its domain: by whole periods, or cut to the nearer end."""
    low, high = ends
    if not periodic:
        return jnp.clip(x, low, high)
    turns = jnp.floor(jax.lax.stop_gradient((x - low) / (high - low)))
    return x - turns * (high - low)


Ends = tuple[tuple[float, float], tuple[float, float]]


def _check_point(function: Callable[..., Any], kind: Any) -> None:
    """Raise unless a function of two numbers gives three."""
    place = jax.ShapeDtypeStruct((), kind)
    with traceable("function"):
        found = jax.tree.leaves(eqx.filter_eval_shape(function, place, place))
    shapes = [getattr(x, "shape", ()) for x in found]
    if shapes not in ([(3,)], [(), (), ()]):
        raise ValueError(
            "argument function must give a point, three numbers or one array of shape (3,), but gave shapes "
            f"{shown(shapes)}"
        )


class Chart(AbstractChart):
    r"""The surface $P(u, v)$ of any smooth function of your own; $P_u \times P_v$ points out of the body.

    Its counterpart in the plane is `Parametric`. A place on the surface is $(u, v)$, in whatever unit the
    function takes. Point, normal and shape operator are automatic differentiation of the function, whose
    arrays (those of an `equinox.Module`, or the bound arguments of a `jax.tree_util.Partial`) are
    differentiable; those that it closes over work too, but each new function is compiled anew.

    Args:
        function: `function(u, v)`, from two numbers, gives the three coordinates of the point [m], as a tuple
            or of shape (3,), by JAX operations.
        domain: Ends of u and of v, shape (2, 2); of a periodic one, the ends of a period. `near` begins its
            search within, but is not bound to it.
        periodic: Whether u and v are periodic: then they have no ends. Static.
        smoothness: Its continuous derivatives.

    Raises:
        ValueError: If `function` cannot be called with two numbers or gives anything else than three, or
            another argument is not what it must be. Where the surface is first used, if the ends of a period
            are apart.

    Accuracy: exact to rounding, but for places where $P_u \times P_v = 0$ (a pole): keep contacts off these.

    Example:
        >>> import jax.numpy as jnp, jaxroll as jxr
        >>> bowl = jxr.geometry.Chart(lambda u, v: (u, v, 5 * (u**2 + v**2)), domain=((-1, 1), (-1, 1)))
        >>> bowl.principal_curvatures((0.0, 0.0))[0].tolist()  # the body is below, hollow
        [-10.0, -10.0]
    """

    function: Callable[[Scalar, Scalar], Any]
    ends: Float[Array, "2 2"]
    periodic: tuple[bool, bool] = eqx.field(static=True)
    order: float = eqx.field(static=True)

    def __init__(
        self,
        function: Callable[..., Any],
        *,
        domain: Given | Ends,
        periodic: tuple[bool, bool] = (False, False),
        smoothness: float = float("inf"),
    ) -> None:
        check_callable("function", function, "a function from two numbers to a point", takes=2)
        self.function = as_tree("function", function)
        self.ends = as_floats("domain", domain, (2, 2))
        seen = concrete(self.ends)
        if seen is not None and not np.all(seen[:, 0] < seen[:, 1]):
            raise ValueError(f"argument domain must rise along u and along v, but was {shown(seen)}")
        self.periodic = as_flags(periodic)
        self.order = as_order(smoothness)
        _check_point(self.function, self.ends.dtype)

    @property
    def smoothness(self) -> float:
        return self.order

    def domain(self) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
        ends = self.ends
        return (ends[0, 0], ends[0, 1]), (ends[1, 0], ends[1, 1])

    def derivatives(self, at: Scalars) -> Jet:
        return jet(lambda u, v: Vec3(*self.function(u, v)), at)

    def prepared(self) -> "Chart":
        return self
