r"""Any contour as a table over arclength, which the equations of motion read whatever made it.

A `Table` holds one quintic polynomial in $s$ per cell and coordinate, through exact points with exact first
and second derivatives $c' = b$, $c'' = \kappa n$ at uniform arclengths; in single precision, whose points are
too coarse for that, through bends where these suffice (`_by_bends`). Looking a frame up costs the same for a
spline as for a network. Fields (`_spline`, `_support`, `_parametric`, `_neural_*`) subclass
`AbstractTabulated` and give `tabulate`, by `tabulated` (from a curve of any parameter) or `from_frames` (from
frames by arclength).

The polynomials' speed is one only up to the table's error. A table whose speed is too far from one gets a
length of NaN, which works while JAX traces it too; where it is concrete, `tabled` raises. `simulate` and
`close` read such a table all the same, and the run's code says so (`as_it_is_resolved`): an optimiser that
went too far gets finite numbers, with which it can turn back.
"""

import abc
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import Vec2
from ..._results import concrete
from ..._types import ByPrecision, Points, Scalar
from ..._xla import quickly, remembered
from ._arclength import hermite, quartics, spaced
from ._contour import AbstractContour
from ._frenet import Frenet2

JetFunction = Callable[[Any, Array, Array], tuple[Vec2, Vec2, Vec2]]
# By how much the speed of a table may differ from one; a run that reads it errs by about that much.
_UNEVEN = 1e-3
FEWEST_CELLS = 8
# Whether polynomials are quartics made of bends where that is as good (`quartics`). A quintic's bend has the
# rounding of a point over the square of a step: in single precision, with 1024 cells, a hundredth of the
# curvature, and all of its derivatives in the shape.
_BY_BENDS = ByPrecision(0, 1)
# At its ends a cell has the exact speed; the quarters are where it is compared with one.
_BETWEEN = np.array([0.25, 0.5, 0.75])


class Table(eqx.Module):
    """A contour as one quintic polynomial per cell, the cells uniform in arclength.

    Attributes:
        coefficients: Shape (cells, 12): of x, then of y [m], rising powers of the position in the cell.
        length: Total arclength [m]; NaN where the cells do not resolve the contour.
        span: The total arclength [m], also where `length` is NaN.
        start: Arclength at the first cell's beginning [m].
        closed: Whether the last cell joins the first.
    """

    coefficients: Float[Array, "cells 12"]
    length: Float[Array, ""]
    span: Float[Array, ""]
    start: Float[Array, ""]
    closed: bool = eqx.field(static=True)

    def frame(self, s: Scalar) -> Frenet2:
        """Point, unit tangent and curvature: one gather, then arithmetic.

        The tangent is normalised, so that the frame is orthonormal to rounding on the coarsest table.
        """
        x, y, local = self._cell(s)
        point, first, second = zip(_horner(x, local), _horner(y, local), strict=True)
        direction, bend = Vec2(*first), Vec2(*second)
        inverse = 1.0 / jnp.sqrt(direction.dot(direction))
        curvature = direction.cross(bend) * inverse**3
        return Frenet2(Vec2(*point), direction * inverse, curvature)

    def point(self, s: Scalar) -> Vec2:
        """The point alone."""
        x, y, local = self._cell(s)
        return Vec2(_value(x, local), _value(y, local))

    def _cell(self, s: Scalar) -> tuple[list[Scalar], list[Scalar], Scalar]:
        """Coefficients of x and y in the cell of s, and the place in it: in [0, 1) unless beyond an end."""
        cells = self.coefficients.shape[0]
        position = (s - self.start) * (cells / self.length)
        # floor is constant between cells; stop_gradient keeps JAX from tracing its derivative, zero.
        whole = jnp.floor(jax.lax.stop_gradient(position))
        if self.closed:
            # The index goes round; `whole` does not, so that the position in the cell stays in [0, 1).
            index = whole - jnp.floor(whole / cells) * cells
        else:
            # Beyond an end the last polynomial is continued.
            index = whole = jnp.clip(whole, 0.0, cells - 1.0)
        row = self.coefficients[index.astype(int)]
        each = [row[..., i] for i in range(12)]
        return each[:6], each[6:], position - whole


def _value(c: list[Scalar], x: Scalar) -> Scalar:
    """The quintic with coefficients c in rising powers, by Horner's rule."""
    return c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5]))))


def _horner(c: list[Scalar], x: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """A quintic and its first two derivatives in the cell's own coordinate."""
    first = c[1] + x * (2.0 * c[2] + x * (3.0 * c[3] + x * (4.0 * c[4] + x * 5.0 * c[5])))
    second = 2.0 * c[2] + x * (6.0 * c[3] + x * (12.0 * c[4] + x * 20.0 * c[5]))
    return _value(c, x), first, second


def from_frames(
    points: Points, tangents: Points, curvatures: Float[Array, " nodes"], length: Array, *, closed: bool
) -> Table:
    r"""Quintic Hermite table through exact frames at uniform arclengths, $c'' = \kappa\,n$.

    In single precision cells are quartics where these are as good (`_by_bends`).

    Args:
        points: Shape (cells + 1, 2) [m], both ends included.
        tangents: Shape (cells + 1, 2), unit.
        curvatures: Shape (cells + 1,) [1/m].
        length: Total arclength [m].
        closed: Whether the last point is the first.

    A contour that the cells do not resolve, or whose frames contradict each other, gets a length of NaN: then
    no run that reads the table succeeds. `tabled` says so in words.
    """
    step = length / (points.shape[0] - 1)
    # Derivatives in a cell's own coordinate: step b and step^2 kappa n, with n the tangent turned left.
    inward = jnp.stack([-tangents[:, 1], tangents[:, 0]], axis=-1)
    slopes, bends = tangents * step, inward * (curvatures * step**2)[:, None]
    rows = hermite(points, slopes, bends)
    if _BY_BENDS.of(points):
        rows = _by_bends(rows, points, slopes, bends, closed=closed)
    coefficients = jnp.concatenate([rows[:, 0], rows[:, 1]], axis=-1)
    # The check is a mask and not a branch, since `from_frames` is traced; it must not enter derivatives.
    seen, size = jax.lax.stop_gradient((coefficients, length))
    told = jnp.where(_unevenness(seen, size) <= _UNEVEN, length, jnp.nan)
    return Table(coefficients, told, length, jnp.zeros_like(length), closed)


def _by_bends(quintics: Array, points: Array, slopes: Array, bends: Array, *, closed: bool) -> Array:
    """Quartics for those cells in which they end as the next begins, to rounding; the quintics for others.

    Others are cells in which the curvature jumps, or changes too much for a quartic. Rounding of points, of
    their sums over the contour and of tangents leaves some ten units of the last digit; through points that
    are close together, as those of a spline may be, tangents have more of it. A quartic whose end is off by
    the rounding of the points is still better than the quintic: that bends by so much over a step's square.
    """
    rows = quartics(points, slopes, bends, closed=closed)
    eps = jnp.finfo(points.dtype).eps
    apart = jnp.abs(rows.sum(axis=-1) - points[1:]).max(axis=-1)
    turned = jnp.abs(rows @ np.arange(6, dtype=rows.dtype) - slopes[1:]).max(axis=-1)
    size, pace = jnp.abs(points).max(), jnp.abs(slopes).max()
    meet = (apart <= 16.0 * eps * size) & (turned <= eps * jnp.maximum(32.0 * pace, 2.0 * size))
    return jnp.where(meet[:, None, None], rows, quintics)


def as_it_is_resolved(tree: Any) -> tuple[Any, Array | None]:
    """A pytree whose tables can all be read, and whether one of them does not resolve its contour.

    A table that does not is given its span for its length. What is then read from it is as inaccurate as its
    speed is off one, but finite, with finite derivatives; the run says so by its code. None without tables.
    """
    is_table = lambda x: isinstance(x, Table)  # noqa: E731
    tables = [leaf for leaf in jax.tree.leaves(tree, is_leaf=is_table) if is_table(leaf)]
    if not tables:
        return tree, None
    unresolved = functools.reduce(jnp.logical_or, [jnp.isnan(table.length) for table in tables])

    def readable(leaf: Any) -> Any:
        if not is_table(leaf):
            return leaf
        return eqx.tree_at(
            lambda t: t.length, leaf, jnp.where(jnp.isnan(leaf.length), leaf.span, leaf.length)
        )

    return jax.tree.map(readable, tree, is_leaf=is_table), unresolved


def _unevenness(coefficients: Any, length: Any) -> Any:
    """Largest difference of a table's speed from one at the quarters of its cells; for NumPy and for JAX."""
    # dx/ds = (cells / length) sum_p p c_p q^(p - 1) at the quarters q: one product of matrices for all cells.
    power = np.arange(1.0, 6.0)
    weights = (power[:, None] * _BETWEEN[None, :] ** (power[:, None] - 1.0)).astype(coefficients.dtype)
    x, y = coefficients[:, 1:6] @ weights, coefficients[:, 7:12] @ weights
    return abs((x * x + y * y) ** 0.5 * (coefficients.shape[0] / length) - 1.0).max()


def unevenness(table: Table) -> Any:
    """Largest difference of a table's speed from one: a float, or an array while JAX traces the table."""
    seen = concrete(table.coefficients), concrete(table.length)
    if seen[0] is None or seen[1] is None:
        return _unevenness(table.coefficients, table.length)
    return float(_unevenness(*seen))


def tabulated(jet: JetFunction, shape: Any, parts: int, *, closed: bool, cells: int) -> tuple[Table, Array]:
    """Table of a regular curve in cells of any parameter, and the arclengths where the cells begin and end.

    Differentiable with respect to `shape`.

    Args:
        jet: `jet(shape, cell, x)` gives points and two derivatives in x at places x in [0, 1] of cells.
        shape: Whatever numbers the curve depends on.
        parts: How many cells the curve has, so short that five-point Gauss-Legendre integrates the speed
            over each; the curve may be less smooth where they meet.
        closed: Whether the curve ends where it began.
        cells: Cells of the table.
    """

    def speed(shape: Any, cell: Array, x: Array) -> Array:
        _, rate, _ = jet(shape, cell, x)
        return jnp.sqrt(rate.dot(rate))

    cell, x, arcs = spaced(speed, shape, parts, cells)
    # In any parameter: b = c' / |c'|, kappa = c' x c'' / |c'|^3.
    point, rate, bend = jet(shape, cell, x)
    inverse = 1.0 / jnp.sqrt(rate.dot(rate))
    curvature = rate.cross(bend) * inverse**3
    table = from_frames(point.array(), (rate * inverse).array(), curvature, arcs[-1], closed=closed)
    return table, arcs


class TableError(NamedTuple):
    """Largest errors of a table: point [m], tangent [rad], curvature [1/m]."""

    point: float
    tangent: float
    curvature: float


class AbstractTabulated(AbstractContour):
    """A contour whose frame is read from a table, built once per solve and differentiated through.

    To add one, subclass this with fields `cells: int` (static) and `table: Table | None`, None to begin
    with, and give `tabulate`, `closed` and `smoothness`.
    """

    cells: eqx.AbstractVar[int]
    table: eqx.AbstractVar[Table | None]

    @abc.abstractmethod
    def tabulate(self, cells: int) -> Table:
        """Build a table: pure JAX, differentiable in every array of the field."""

    def _why_not_finite(self) -> str:
        """What is said of a table whose points are not finite numbers."""
        kind = type(self).__name__
        return f"argument contour must have finite points, but the table of this {kind} was not"

    def read(self) -> Table:
        """The table that `prepared` stored, or a new one."""
        return _built(self) if self.table is None else self.table

    def curve(self, s: Scalar) -> Vec2:
        return self.read().point(s)

    def frame(self, s: Scalar) -> Frenet2:
        return self.read().frame(s)

    def prepared(self) -> "AbstractTabulated":
        return eqx.tree_at(lambda c: c.table, self, self.read(), is_leaf=lambda x: x is None)

    def tabled(self) -> "AbstractTabulated":
        return self if self.table is not None else _prepared(self)

    def domain(self) -> tuple[Scalar, Scalar]:
        # Of a table that is checked: one that cannot be built has NaN for its length.
        table = self.tabled().read()
        return table.start, table.start + table.length

    def table_error(self) -> TableError:
        r"""Error bound of the table: its largest difference from one with twice the cells.

        At the middle and the quarters of every cell. The error falls as cells$^{-6}$ (point), $^{-5}$
        (tangent) and $^{-4}$ (curvature) where the field has that many derivatives, so the difference
        bounds it to a few per cent.
        """
        worst = _difference(self, self.cells)
        return TableError(*(float(x) for x in worst))


@remembered
def _prepared(contour: AbstractTabulated) -> AbstractTabulated:
    """The contour with its table, checked; kept by the contour's identity, so that runs share the table."""
    ready = contour.prepared()
    _check_table(contour, ready.read())
    return ready


def _check_table(contour: AbstractTabulated, table: Table) -> None:
    """Raise if a table that is not traced has NaN for its length, and say which of two faults it has."""
    length, coefficients = concrete(table.length), concrete(table.coefficients)
    if length is None or coefficients is None or np.isfinite(length):
        return
    if not np.all(np.isfinite(coefficients)):
        raise ValueError(contour._why_not_finite())
    kind = type(contour).__name__
    raise ValueError(
        f"argument cells must be more than {contour.cells} for a contour that bends so sharply (or folds), "
        f"since the speed along the table of this {kind} is more than {_UNEVEN:g} off one"
    )


@quickly
def _built(contour: AbstractTabulated) -> Table:
    return contour.tabulate(contour.cells)


@quickly
def _difference(contour: AbstractTabulated, cells: int) -> tuple[Array, Array, Array]:
    """Largest differences of point [m], tangent [rad] and curvature [1/m] from a table of twice the cells."""
    coarse, fine = contour.tabulate(cells), contour.tabulate(2 * cells)
    middles = (np.arange(cells)[:, None] + _BETWEEN[None, :]).ravel() / cells
    s = coarse.start + coarse.length * middles
    a, b = coarse.frame(s), fine.frame(s)
    # The cross product of two unit tangents is the sine of the angle between them, here as good as the angle.
    gap, turn = a.point - b.point, a.tangent.cross(b.tangent)
    worst = (jnp.sqrt(gap.dot(gap)), jnp.abs(turn), jnp.abs(a.curvature - b.curvature))
    return jnp.max(worst[0]), jnp.max(worst[1]), jnp.max(worst[2])
