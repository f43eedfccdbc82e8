r"""Arclength of a regular curve $c(u)$ that is not given by it, and its inverse.

A curve of speed $v(u) = |c'(u)|$ has the arclength $s(u) = \int v\,du$, integrated here by Gauss-Legendre
over short cells of $u$. The inverse $u(s)$ is found by Newton's method at uniform arclengths and
differentiated as an implicit function. `_closed_forms.Ellipse` keeps $u(s)$ as an `ArclengthTable`
(`tabulate`, `invert`); `_table` wants only the places of the uniform arclengths (`spaced`), and `_support`,
which has $s$ in closed form, only the inversion (`parameters_reaching`).
"""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import Scalar
from ..._xla import perturbed, traced_once

# ds/dx at places of a curve's cells: `speed(shape, cell, x)`, with x in [0, 1] along each cell.
Speed = Callable[[Any, Any, Any], Array]
# `progress(shape, x)`: the value of a rising function at x, and its derivative there.
RisingFunction = Callable[[Any, Array], tuple[Array, Array]]
# Five-point Gauss-Legendre, moved from [-1, 1] to [0, 1].
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
_PLACES, _SHARES = 0.5 * (1.0 + _NODES), 0.5 * _WEIGHTS


class ArclengthTable(eqx.Module):
    """The parameter u of a closed curve as a function of arclength: quintic Hermite, periodic.

    Attributes:
        coefficients: Shape (cells, 6), rising powers of the position inside the cell.
        length: Total arclength [m].
        period: Range of u once round the curve.
    """

    coefficients: Float[Array, "cells 6"]
    length: Float[Array, ""]
    period: float = eqx.field(static=True)


def tabulate(rate: Callable[[Any, Array], Array], shape: Any, *, period: float, cells: int) -> ArclengthTable:
    r"""Table of $u(s)$ for a closed curve with speed $|c'(u)|$ = `rate(shape, u)`, uniform in s."""
    width = period / cells

    def speed(shape: Any, cell: Array, x: Array) -> Array:
        return width * rate(shape, width * in_cells(cell, x))

    cell, x, arcs = spaced(speed, shape, cells, cells)
    # With speed v(u): du/ds = 1 / v and d2u/ds2 = -(dv/du) / v^3. `hermite` wants both per cell, of length
    # step.
    nodes, step = width * in_cells(cell, x), arcs[-1] / cells
    value, slope = jax.jvp(lambda u: rate(shape, u), (nodes,), (jnp.ones_like(nodes),))
    rows = hermite(nodes, step / value, -slope * step**2 / value**3)
    return ArclengthTable(rows, arcs[-1], period)


def in_cells(cell: Any, x: Any) -> Array:
    """Places x in cells as numbers of cells from the beginning of the first, with the dtype of x."""
    return jnp.asarray(cell, jnp.result_type(x)) + x


def spaced(speed: Speed, shape: Any, parts: int, cells: int) -> tuple[Array, Array, Array]:
    r"""Where a curve in `parts` cells has reached `cells` + 1 uniform arclengths.

    Returns, for each of these arclengths, the cell and the place x in [0, 1] in it; and the arclength at the
    beginning of every cell and at the end of the last, shape (parts + 1,) [m]. Arclength is integrated by
    five-point Gauss-Legendre over each cell.
    """
    # Behind the barrier XLA does not work out, while it compiles, what depends on the grid alone: of an
    # ellipse of 262 144 cells that takes 5 s, and the rest of its program 0.6 s.
    begins = jax.lax.optimization_barrier(jnp.arange(parts)[:, None])
    lengths = speed(shape, begins, _PLACES[None, :]) @ _SHARES
    arcs = rising_sums(lengths)
    targets = arcs[-1] * np.linspace(0.0, 1.0, cells + 1)
    # In which cell a target lies is not differentiable; where in the cell, is. The first guess of x assumes
    # constant speed in the cell.
    fixed, sought = jax.lax.stop_gradient((arcs, targets))
    cell = jnp.clip(jnp.searchsorted(fixed, sought) - 1, 0, parts - 1)
    start = (sought - fixed[cell]) / jax.lax.stop_gradient(lengths)[cell]

    def progress(shape: tuple[Any, Array], x: Array) -> tuple[Array, Array]:
        # Arclength from the cell's beginning to x: the same rule, shrunk to [0, x]. The last node, 1, gives
        # the speed at x itself.
        shape, cell = shape
        speeds = speed(shape, cell[:, None], x[:, None] * np.append(_PLACES, 1.0)[None, :])
        return x * (speeds[:, :-1] @ _SHARES), speeds[:, -1]

    return cell, parameters_reaching(progress, (shape, cell), start, targets - arcs[cell]), arcs


def arclength_at(speed: Speed, shape: Any, arcs: Array, *, cell: Array, x: Array) -> Array:
    """Arclength [m] at the place x in [0, 1] of one cell, by the rule of `spaced`, which gives `arcs`.

    `speed` is called with five places in a row, shape (5,), and with the cell of each. Differentiable in x.
    """
    places = x * _PLACES
    return arcs[cell] + x * (speed(shape, jnp.full(places.shape, cell), places) @ _SHARES)


def rising_sums(values: Array) -> Array:
    """Zero, then the sums of the first one, two, ... values: shape (n,) to (n + 1,).

    The values are laid out in a square, row by row. Sums within rows, and of the rows before, are then
    products with triangular matrices of ones: about $n^{3/2}$ operations, without a loop or a scan.
    """
    count = values.shape[0]
    side = math.isqrt(count - 1) + 1
    blocks = jnp.pad(values, (0, side * side - count)).reshape(side, side)
    within = blocks @ np.triu(np.ones((side, side)))
    before = np.tri(side, k=-1) @ within[:, -1:]
    return jnp.pad((before + within).ravel()[:count], (1, 0))


def parameters_reaching(progress: RisingFunction, shape: Any, start: Array, targets: Array) -> Array:
    r"""Parameters x at which rising functions reach `targets`: four steps of Newton's method.

    Args:
        progress: `progress(shape, x)` gives what is reached, and its rate in x.
        shape: Whatever the functions depend on.
        start: A first guess, so close that four steps arrive: each about squares the relative error.
        targets: What to reach.

    Derivatives, in both modes and of any order, are those of the implicit function theorem; the iteration
    is not differentiated, and `start` has no derivative.
    """
    return _placed((shape, targets), start, progress)


@eqx.filter_custom_jvp
def _placed(given: tuple[Any, Array], start: Array, progress: RisingFunction) -> Array:
    """The iteration of `parameters_reaching`, whose derivative rule is below."""
    return _iterated(given, start, progress)


@traced_once
def _iterated(given: tuple[Any, Array], start: Array, progress: RisingFunction) -> Array:
    shape, targets = given

    def newton(_: int, x: Array) -> Array:
        reached, rate = progress(shape, x)
        return x - (reached - targets) / rate

    return jax.lax.fori_loop(0, 4, newton, start)


@_placed.def_jvp
def _(primals: Any, tangents: Any) -> tuple[Array, Array]:
    given, start, progress = primals
    x = _placed(given, start, progress)
    # With g(given, x) = reached - target = 0, dx = -(dg/dgiven dgiven) / (dg/dx).
    moving, still, dots = perturbed(given, tangents[0])

    def excess(moving: Any, x: Array) -> Array:
        shape, targets = eqx.combine(moving, still)
        return progress(shape, x)[0] - targets

    # The derivative of `progress` itself, not the rate that it returns: that is the exact integrand, and
    # differs from the derivative of the quadrature by the quadrature's error.
    _, rate = jax.jvp(lambda x: excess(moving, x), (x,), (jnp.ones_like(x),))
    _, change = jax.jvp(lambda moving: excess(moving, x), (moving,), (dots,))
    return x, -change / rate


def hermite(value: Array, first: Array, second: Array) -> Array:
    """Coefficients of quintic Hermite polynomials, in rising powers of x in [0, 1] in each cell.

    From values and two derivatives in x at the cells' ends: shape (n + 1, ...) to (n, ..., 6).
    """
    # The first three coefficients are Taylor's at x = 0; the others meet value, slope and bend at x = 1.
    p0, v0, a0 = value[:-1], first[:-1], second[:-1]
    rise, v1, a1 = value[1:] - p0, first[1:], second[1:]
    c3 = 10.0 * rise - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
    c5 = 6.0 * rise - 3.0 * (v0 + v1) - 0.5 * (a0 - a1)
    return jnp.stack([p0, v0, 0.5 * a0, c3, c4, c5], axis=-1)


def quartics(value: Array, first: Array, second: Array, *, closed: bool) -> Array:
    r"""`hermite` from what a cell begins with, and bends alone: quartics, whose sixth coefficient is zero.

    With bends $a_0, a_1$ at a cell's ends and $a_{-1}, a_2$ beside it, the bend is
    $a_0 + (a_1 - a_0) x + 6 e\,(x - x^2)$, where $e = -(a_{-1} - a_0 - a_1 + a_2) / 24$ is what the slope
    rises by beyond $(a_0 + a_1) / 2$. Nothing is a small difference of large numbers, as rises of values and
    slopes are; the slope at the end is met to 11/720 of the fourth difference of bends.
    """
    if closed:
        beside = [second[-2], second[1]]
    else:  # quadratically beyond the ends
        beside = [3.0 * (z - y) + x for z, y, x in (second[:3], second[-1:-4:-1])]
    bends = jnp.concatenate([beside[0][None], second, beside[1][None]])
    a0, a1 = second[:-1], second[1:]
    e = (a0 + a1 - bends[:-3] - bends[3:]) / 24.0
    return jnp.stack(
        [value[:-1], first[:-1], 0.5 * a0, (a1 - a0) / 6.0 + e, -0.5 * e, jnp.zeros_like(e)], axis=-1
    )


def _interpolate(table: ArclengthTable, s: Scalar) -> Scalar:
    """The table's u at any arclength s [m], with u(s + length) = u(s) + period."""
    cells = table.coefficients.shape[0]
    # The cell is chosen without derivative; `local` is the position in it, in [0, 1).
    position = s * (cells / table.length)
    whole = jnp.floor(jax.lax.stop_gradient(position))
    local = position - whole
    turns = jnp.floor(whole / cells)
    index = (whole - turns * cells).astype(int)
    row = table.coefficients[index]
    value = row[..., 5]
    for power in (4, 3, 2, 1, 0):
        value = value * local + row[..., power]
    return value + turns * table.period


def invert(rate: Callable[[Any, Scalar], Scalar], shape: Any, table: ArclengthTable, s: Scalar) -> Scalar:
    r"""The curve's parameter at arclength `s`.

    The value is the table's; its derivative in `s` is the exact $1/|c'(u)|$, so that tangent and
    curvature by automatic differentiation are exact at the point that is returned.
    """

    @jax.custom_jvp
    def parameter(shape: Any, table: ArclengthTable, s: Scalar) -> Scalar:
        return _interpolate(table, s)

    # What the curve's shape changes at fixed s comes in by the table, which was made of it; its own tangent
    # is therefore left out.
    @parameter.defjvp
    def _(primals: Any, tangents: Any) -> tuple[Scalar, Scalar]:
        shape, table, s = primals
        _, table_dot, s_dot = tangents
        u = parameter(shape, table, s)
        _, moved = jax.jvp(lambda tab: _interpolate(tab, s), (table,), (table_dot,))
        return u, moved + s_dot / rate(shape, u)

    return parameter(shape, table, s)
