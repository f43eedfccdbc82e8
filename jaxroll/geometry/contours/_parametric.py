r"""A contour from any regular curve $p(u)$, given by its points alone.

Arclength $s$, unit tangent $b$ and curvature $\kappa$ of a contour follow from the points,

$$ s(u) = \int |p'| \, \mathrm{d}u, \quad b = p' / |p'|, \quad \kappa = p' \times p'' / |p'|^3, $$

by automatic differentiation, and are kept in a table over arclength (`_table`). Its counterpart in space is
`surfaces.Chart`.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._closures import as_tree
from ..._linalg import Vec2
from ..._results import (
    as_count,
    as_floats,
    as_order,
    check_callable,
    check_flag,
    concrete,
    shown,
    told_apart,
    traceable,
)
from ..._types import ByPrecision, Given
from ..._xla import quickly
from ._arclength import arclength_at, in_cells
from ._given_points import polygon_area
from ._table import AbstractTabulated, FEWEST_CELLS, Table, tabulated

# How far apart the ends of a closed curve may be, relative to its size, in double and in single precision.
_CLOSED = ByPrecision(1e-9, 1e-5)
# The angle [rad] by which the tangent may turn from one end to the other.
_SMOOTH = ByPrecision(1e-6, 1e-3)
# Places at which a curve is looked at when it is made.
_LOOKED_AT = 257


class Parametric(AbstractTabulated):
    r"""A contour from a curve of your own, $p(u)$, counter-clockwise round its body.

    Args:
        function: From a number u to a point, shape (2,), in metres, by JAX operations. Arrays that it is to
            be differentiated in go in as a pytree: `jax.tree_util.Partial(f, arrays)` or an
            `equinox.Module`; those that it closes over work too, but each new function is compiled anew.
        domain: First and last u.
        closed: Whether the curve ends where it began, as smoothly as it goes on elsewhere.
        origin: The u at which $s = 0$. Default: the first.
        smoothness: Continuous derivatives of $p$, two or more.
        cells: Cells of the table. Default: 1024. Static.

    Raises:
        ValueError: If the function gives no point, one that is not finite, runs clockwise where it is
            closed, does not close or has a corner there, or another argument does not fit. A curve that
            stops, or bends more sharply than the cells resolve, is refused where it is first used; one that
            crosses itself where it is to bound an object.

    Accuracy: the table's error falls as cells$^{-6}$ (`table_error`); with 1024 cells an ellipse with
    half axes of 20 and 14 mm is met to 1e-16 m in the point and 3e-8 1/m in the curvature.

    Example:
        >>> import jax.numpy as jnp
        >>> import jaxroll as jxr
        >>> egg = jxr.Parametric(
        ...     lambda u: 0.01 * jnp.array([(1.2 + 0.2 * jnp.cos(u)) * jnp.cos(u), jnp.sin(u)]),
        ...     (0.0, 2.0 * jnp.pi),
        ...     closed=True,
        ... )
        >>> f"{egg.domain()[1]:.4f} m round, {egg.curvature(0.0):.0f} 1/m in front"
        '0.0695 m round, 160 1/m in front'
    """

    function: Callable[[Any], Any]
    span: Float[Array, "2"]
    origin: Float[Array, ""] | None
    loop: bool = eqx.field(static=True)
    order: float = eqx.field(static=True)
    cells: int = eqx.field(static=True)
    table: Table | None

    def __init__(
        self,
        function: Callable[[Any], Any],
        domain: Given,
        *,
        closed: bool = False,
        origin: Given | None = None,
        smoothness: float = float("inf"),
        cells: int = 1024,
    ) -> None:
        check_callable("function", function, "a function from a number to a point", takes=1)
        self.function = as_tree("function", function)
        self.span = as_floats("domain", domain, (2,))
        self.origin = None if origin is None else as_floats("origin", origin, ())
        self.loop = check_flag("closed", closed)
        self.order = as_order(smoothness, least=2)
        self.cells = as_count("cells", cells, least=FEWEST_CELLS)
        self.table = None
        _check(self)

    @property
    def closed(self) -> bool:
        return self.loop

    @property
    def smoothness(self) -> float:
        return self.order

    def free_numbers(self) -> list[Any]:
        """The arrays of the function: its domain and origin stay."""
        return [leaf for leaf in jax.tree.leaves(self.function) if eqx.is_inexact_array(leaf)]

    def tabulate(self, cells: int) -> Table:
        given = (self.function, self.span)
        table, arcs = tabulated(_jet(cells), given, cells, closed=self.loop, cells=cells)
        if self.origin is None:
            return table
        # The arclength from the first parameter to the origin is subtracted, so that s = 0 lies there.
        # Which cell that is has no derivative.
        place = (self.origin - self.span[0]) / (self.span[1] - self.span[0]) * cells
        before = jnp.clip(jnp.floor(jax.lax.stop_gradient(place)), 0, cells - 1)

        def speed(given: Any, cell: Array, x: Array) -> Array:
            _, rate, _ = _jet(cells)(given, cell, x)
            return jnp.sqrt(rate.dot(rate))

        begin = arclength_at(speed, given, arcs, cell=before.astype(int), x=place - before)
        return eqx.tree_at(lambda t: t.start, table, -begin)


def _jet(parts: int) -> Callable[[Any, Any, Any], tuple[Vec2, Vec2, Vec2]]:
    """A function for points and two derivatives in x at places x in [0, 1] of `parts` equal cells of u."""

    def jet(given: Any, cell: Any, x: Any) -> tuple[Vec2, Vec2, Vec2]:
        function, span = given
        # u = u_0 + width (cell + x), so that every derivative in x brings a factor of `width`. Forward over
        # forward gives point, p' and p'' in one pass.
        width = (span[1] - span[0]) / parts
        u = jnp.asarray(span[0] + width * in_cells(cell, x))
        point = lambda u: jnp.asarray(function(u))  # noqa: E731
        rate = lambda u: jax.jvp(point, (u,), (jnp.ones_like(u),))  # noqa: E731
        (at, first), (_, second) = jax.vmap(lambda u: jax.jvp(rate, (u,), (jnp.ones_like(u),)))(u.ravel())

        def vector(a: Array) -> Vec2:
            return Vec2(a[:, 0].reshape(u.shape), a[:, 1].reshape(u.shape))

        return vector(at), vector(width * first), vector(width**2 * second)

    return jet


def _point(given: Any) -> Array:
    """What a function returned, as an array."""
    try:
        return jnp.asarray(given)
    except (TypeError, ValueError) as error:
        if isinstance(error, jax.errors.JAXTypeError):
            raise
        raise ValueError(
            f"argument function must give a point of shape (2,), but gave {shown(given)}"
        ) from None


@quickly
def _along(function: Callable[[Any], Any], places: Array) -> tuple[Array, Array]:
    """Points of a curve at places, and their derivatives there."""
    at = lambda u: jax.jvp(lambda u: jnp.asarray(function(u)), (u,), (jnp.ones_like(u),))  # noqa: E731
    return jax.vmap(at)(places)


def _check(contour: Parametric) -> None:
    """Raise unless the function gives finite points, closes if it should, and runs counter-clockwise.

    What depends on numbers that JAX is tracing is not checked.
    """
    span, origin = concrete(contour.span), None if contour.origin is None else concrete(contour.origin)
    # By shape alone, without evaluating the function.
    u = jax.ShapeDtypeStruct((), contour.span.dtype)
    with traceable("function"):
        found = eqx.filter_eval_shape(lambda f, u: _point(f(u)), contour.function, u)
    if found.shape != (2,) or not jnp.issubdtype(found.dtype, jnp.floating):
        raise ValueError(
            "argument function must give a point of shape (2,), but gave "
            f"{found.dtype} of shape {found.shape}"
        )
    if span is None:
        return
    if not span[1] > span[0]:
        raise ValueError(f"argument domain must be two numbers that rise, but was {shown(span)}")
    if origin is not None and not span[0] <= origin <= span[1]:
        low, high, was = told_apart(*span, origin)
        raise ValueError(f"argument origin must lie within [{low}, {high}], but was {was}")
    places = jnp.linspace(span[0], span[1], _LOOKED_AT)
    points, rates = map(concrete, _along(contour.function, places))
    if points is None or rates is None:
        return
    if not np.all(np.isfinite(points)):
        raise ValueError("argument function must give finite points all over its domain, but did not")
    if not contour.loop:
        return
    apart, size = np.linalg.norm(points[-1] - points[0]), np.ptp(points, axis=0).max()
    if apart > _CLOSED.of(points) * size:
        raise ValueError(f"argument function must end where it began if closed, but ends {apart:.3g} m away")
    if not size > 0 or polygon_area(points[:-1]) <= 0:
        raise ValueError("argument function must run counter-clockwise round its body, but runs clockwise")
    # A table with a corner would have one tangent at each side. Zero of a curve that stops there, which its
    # table refuses.
    first, last = rates[0], rates[-1]
    turn = np.arctan2(last[0] * first[1] - last[1] * first[0], last @ first)
    if abs(turn) > _SMOOTH.of(rates):
        raise ValueError(
            "argument function must go on smoothly where it closes, but its direction turns there by "
            f"{turn:.3g} rad"
        )
