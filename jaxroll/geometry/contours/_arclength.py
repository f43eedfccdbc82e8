"""Arclength of a regular curve by a differentiable table."""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._types import Scalar
from ..._xla import filled

# Rate of the arclength at places of a curve's cells: `speed(shape, cell, x)`, x in [0, 1] along each.
Speed = Callable[[Any, Any, Any], Array]
RisingFunction = Callable[[Any, Array], tuple[Array, Array]]
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
        return width * rate(shape, width * (cell + x))

    cell, x, arcs = spaced(speed, shape, cells, cells)
    nodes, step = width * (cell + x), arcs[-1] / cells
    value, slope = jax.jvp(lambda u: rate(shape, u), (nodes,), (jnp.ones_like(nodes),))
    rows = hermite(nodes, step / value, -slope * step**2 / value**3)
    return ArclengthTable(rows, arcs[-1], period)


def spaced(speed: Speed, shape: Any, parts: int, cells: int) -> tuple[Array, Array, Array]:
    r"""Where a curve in `parts` cells has reached `cells` + 1 uniform arclengths.

    Returns the cells, the places in them, and the arclength at the beginning of every cell and at the
    end. Arclength is integrated by five-point Gauss-Legendre over each cell.
    """
    lengths = speed(shape, np.arange(parts)[:, None], _PLACES[None, :]) @ _SHARES
    arcs = rising_sums(lengths)
    targets = arcs[-1] * np.linspace(0.0, 1.0, cells + 1)
    fixed, sought = jax.lax.stop_gradient((arcs, targets))
    cell = jnp.clip(jnp.searchsorted(fixed, sought) - 1, 0, parts - 1)
    start = (sought - fixed[cell]) / jax.lax.stop_gradient(lengths)[cell]

    def progress(shape: tuple[Any, Array], x: Array) -> tuple[Array, Array]:
        shape, cell = shape
        speeds = speed(shape, cell[:, None], x[:, None] * np.append(_PLACES, 1.0)[None, :])
        return x * (speeds[:, :-1] @ _SHARES), speeds[:, -1]

    return cell, parameters_reaching(progress, (shape, cell), start, targets - arcs[cell]), arcs


def rising_sums(values: Array) -> Array:
    """Zero, then the sums of the first one, two, ... values: by blocks, two small products of matrices."""
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
        start: A first guess.
        targets: What to reach.

    Derivatives, in both modes and of any order, are those of the implicit function theorem; the iteration
    is not differentiated.
    """
    return _placed((shape, targets), start, progress)


@eqx.filter_custom_jvp
def _placed(given: tuple[Any, Array], start: Array, progress: RisingFunction) -> Array:
    shape, targets = given

    def newton(_: int, x: Array) -> Array:
        reached, rate = progress(shape, x)
        return x - (reached - targets) / rate

    return jax.lax.fori_loop(0, 4, newton, start)


@_placed.def_jvp
def _(primals: Any, tangents: Any) -> tuple[Array, Array]:
    given, start, progress = primals
    x = _placed(given, start, progress)
    moving, still = eqx.partition(given, eqx.is_inexact_array)

    def excess(moving: Any, x: Array) -> Array:
        shape, targets = eqx.combine(moving, still)
        return progress(shape, x)[0] - targets

    # By the derivative of what was integrated, not by the rate, which differs by the rule's error.
    _, rate = jax.jvp(lambda x: excess(moving, x), (x,), (jnp.ones_like(x),))
    dots = filled(moving, tangents[0])
    _, change = jax.jvp(lambda moving: excess(moving, x), (moving,), (dots,))
    return x, -change / rate


def hermite(value: Array, first: Array, second: Array) -> Array:
    """Quintic coefficients from nodal values and derivatives in cell units: (n + 1, ...) to (n, ..., 6)."""
    p0, v0, a0 = value[:-1], first[:-1], second[:-1]
    rise, v1, a1 = value[1:] - p0, first[1:], second[1:]
    c3 = 10.0 * rise - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15.0 * rise + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
    c5 = 6.0 * rise - 3.0 * (v0 + v1) - 0.5 * (a0 - a1)
    return jnp.stack([p0, v0, 0.5 * a0, c3, c4, c5], axis=-1)


def _interpolate(table: ArclengthTable, s: Scalar) -> Scalar:
    cells = table.coefficients.shape[0]
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

    @parameter.defjvp
    def _(primals: Any, tangents: Any) -> tuple[Scalar, Scalar]:
        shape, table, s = primals
        _, table_dot, s_dot = tangents
        u = parameter(shape, table, s)
        _, moved = jax.jvp(lambda tab: _interpolate(tab, s), (table,), (table_dot,))
        return u, moved + s_dot / rate(shape, u)

    return parameter(shape, table, s)
