r"""Surfaces as zero sets of a field of space, $F(x, y, z) = 0$: the contact coordinate is the point itself.

The normal is $\nabla F / |\nabla F|$ and the shape operator its derivative along the surface (`level_frame`).
Three coordinates for two degrees of freedom need no chart and have no poles, but drift off the surface:
Newton steps along the gradient put them back (`settled`). `_surface_closed_forms`, `_surface_spline` and
`Implicit`, for any function, subclass `AbstractImplicit`.
"""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._closures import as_tree
from ..._linalg import outer, square, Sym3, tangents, Vec3
from ..._results import as_array, as_length, as_order, check_callable, traceable
from ..._types import Given, Scalar, Scalars
from ..._xla import briskly, once
from ._spread import lattice, SEEDS, thinned
from ._surface import AbstractSurface, Gauss3

# Newton steps from a point anywhere to the surface, in `start`.
_STEPS = 8
# A seed whose distance from the surface is below this, relative to the box, has come to it.
_ARRIVED = 1e-6


class Level(NamedTuple):
    """A field at one point: value, gradient, second derivatives."""

    value: Scalar
    gradient: Vec3
    hessian: Sym3


def level_frame(point: Vec3, level: Level) -> Gauss3:
    r"""Gauss frame of a level set: $n = \nabla F / |\nabla F|$, $L = P H P / |\nabla F|$, $P = 1 - n n^T$."""
    # P H P written out: H - (n (H n)^T + (H n) n^T) + (n . H n) n n^T. `outer` is half the bracket.
    inverse = once(1.0 / level.gradient.norm())
    normal = once(level.gradient * inverse)
    hessian = level.hessian * inverse
    along = once(hessian.apply(normal))
    bent = hessian - outer(normal, along) * 2.0 + square(normal) * normal.dot(along)
    return Gauss3(point, normal, bent)


def differentiated(field: Callable[[Scalar, Scalar, Scalar], Scalar], point: Vec3) -> Level:
    """Value, gradient and second derivatives of a field, forward over forward: six passes."""
    place = tuple(jnp.asarray(x) for x in point)
    zero, one = jnp.zeros_like(place[0]), jnp.ones_like(place[0])
    axes = ((one, zero, zero), (zero, one, zero), (zero, zero, one))

    def slope(axis: int) -> Callable[..., tuple[Scalar, Scalar]]:
        return lambda *p: jax.jvp(lambda *p: _value("field", field, p), p, axes[axis])

    def second(i: int, j: int) -> tuple[Scalar, Scalar, Scalar]:
        (value, first), (_, bend) = jax.jvp(slope(i), place, axes[j])
        return value, first, bend

    value, x, xx = second(0, 0)
    (_, y, yy), (_, z, zz) = second(1, 1), second(2, 2)
    return Level(value, Vec3(x, y, z), Sym3(xx, second(0, 1)[2], second(0, 2)[2], yy, second(1, 2)[2], zz))


def _value(name: str, field: Callable[..., Any], place: tuple[Any, ...]) -> Array:
    """What a field returns at a place, if that is one real number."""
    with traceable(name):
        value = as_array(f"{name}, in what it returns,", field(*place))
    if value.ndim:
        raise ValueError(f"argument {name} must return one number, but returned shape {value.shape}")
    return value


class AbstractImplicit(AbstractSurface):
    r"""The surface $F(x, y, z) = 0$ of a body where $F < 0$; `at` is the point itself, in the body's frame.

    To add one, subclass this and give `derivatives` (`differentiated` where no closed form is at hand),
    `frame` (`level_frame` of them, or a closed form) and `smoothness`; `spread` (`spread_in_box` where no
    closed form is at hand) if it is bounded, and `prepared` where there is work to be done once.
    """

    @abc.abstractmethod
    def derivatives(self, point: Vec3) -> Level:
        """The field, its gradient and its second derivatives, as scalars."""

    @property
    def coordinates(self) -> int:
        return 3

    def rate(self, at: Scalars, velocity: Vec3) -> Scalars:
        return tuple(velocity)

    def settled(self, at: Scalars) -> Scalars:
        # Two steps: a place is off by an integration error, and each step about squares what is left.
        return tuple(self._stepped(self._stepped(Vec3(*at))))

    def basis(self, at: Scalars) -> tuple[Vec3, Vec3]:
        return tangents(self.frame(at).normal)

    def start(self, point: Vec3) -> Scalars:
        def step(p: Vec3, _: None) -> tuple[Vec3, None]:
            return self._stepped(p), None

        return tuple(jax.lax.scan(step, jax.tree.map(jnp.asarray, point), None, length=_STEPS)[0])

    def _stepped(self, point: Vec3) -> Vec3:
        r"""One step of Newton's method along the gradient: $p - F \nabla F / |\nabla F|^2$."""
        level = self.derivatives(point)
        return point - level.gradient * (level.value / level.gradient.dot(level.gradient))


def spread_in_box(surface: AbstractImplicit, low: Vec3, high: Vec3, count: int) -> Scalars:
    """Places spread evenly over the part of a surface in a box, from its low to its high corner [m].

    Points spread over the box are brought to the surface by Newton's method; those that do not arrive, or
    leave the box, are dropped. Shape (count,) for each coordinate; all the origin if no point arrives.
    """
    return _spread(surface, low, high, jnp.asarray(lattice(2 * SEEDS * count, 3)))


@briskly  # compiled once for all calls with surfaces and counts alike
def _spread(surface: AbstractImplicit, low: Vec3, high: Vec3, share: Array) -> Scalars:
    """Places from seeds at shares of the box, some for each."""
    size, count = high - low, len(share) // (2 * SEEDS)
    seeds = Vec3(*(x + width * share[:, i] for i, (x, width) in enumerate(zip(low, size, strict=True))))

    def fall(seed: Vec3) -> tuple[Vec3, Array]:
        point = Vec3(*surface.start(Vec3(*surface.start(seed))))
        # |F| / |grad F| is the distance from the surface, to first order.
        level = surface.derivatives(point)
        arrived = jnp.abs(level.value) <= _ARRIVED * size.norm() * level.gradient.norm()
        # NaN, of a seed that went astray, compares false and is zeroed below, or it would spoil distances.
        for x, least, most in zip(point, low, high, strict=True):
            arrived = arrived & (x >= least) & (x <= most)
        return Vec3(*(jnp.where(arrived, x, 0.0) for x in point)), arrived

    points, fair = jax.vmap(fall)(seeds)
    kept = thinned(points, fair, count)
    return tuple(x[kept] for x in points)


class Implicit(AbstractImplicit):
    r"""The surface $F(x, y, z) = 0$ of any smooth function, negative inside the body.

    The frame is automatic differentiation of the function, which may be a closed form or a network; it is
    called with three scalars and gives one. Arrays in it (those of an `equinox.Module`, or the bound
    arguments of a `jax.tree_util.Partial`) are differentiable.

    Args:
        function: `function(x, y, z)` [m], of nonzero gradient on the surface. Best about as long as the
            distance near it: `settled` and `near` take Newton steps on it.
        radius: Of a ball about the body's origin that holds the whole surface [m]; None: the surface counts
            as unbounded, and locating contacts samples the other one.
        smoothness: Its continuous derivatives.

    Raises:
        ValueError: If `function` gives no number where it is called with three, or `radius` is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> ball = jxr.geometry.Implicit(lambda x, y, z: x**2 + y**2 + z**2 - 0.01**2)
        >>> ball.principal_curvatures((0.0, 0.0, 0.01))[0].round(9).tolist()
        [100.0, 100.0]
    """

    function: Callable[[Scalar, Scalar, Scalar], Scalar]
    radius: Float[Array, ""] | None
    order: float = eqx.field(static=True)

    def __init__(
        self,
        function: Callable[..., Any],
        *,
        radius: Given | None = None,
        smoothness: float = float("inf"),
    ) -> None:
        self.function = as_tree("function", check_callable("function", function, takes=3))
        jax.eval_shape(lambda *place: _value("function", self.function, place), *(jnp.zeros(()),) * 3)
        self.radius = None if radius is None else as_length("radius", radius)
        self.order = as_order(smoothness)

    @property
    def smoothness(self) -> float:
        return self.order

    def derivatives(self, point: Vec3) -> Level:
        return differentiated(self.function, point)

    def frame(self, at: Scalars) -> Gauss3:
        point = Vec3(*at)
        return level_frame(point, self.derivatives(point))

    def spread(self, count: int) -> Scalars | None:
        if self.radius is None:
            return None
        corner = Vec3(self.radius, self.radius, self.radius)
        return spread_in_box(self, -corner, corner, count)

    def prepared(self) -> "Implicit":
        return self
