"""Arclength of a regular curve by a differentiable table."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import Scalar

Speed = Callable[[Any, Scalar], Scalar]
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


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


def tabulate(speed: Speed, shape: Any, *, period: float, cells: int) -> ArclengthTable:
    r"""Table of $u(s)$ for a closed curve with speed $|c'(u)|$ = `speed(shape, u)`, uniform in s."""
    nodes, arcs = spaced(speed, shape, jnp.linspace(0.0, period, cells + 1), cells)
    return ArclengthTable(_hermite(speed, shape, nodes, arcs[-1] / cells), arcs[-1], period)


def spaced(speed: Speed, shape: Any, grid: Array, cells: int) -> tuple[Array, Array]:
    r"""Parameters at `cells` + 1 uniform arclengths, and the arclength at every point of `grid`.

    Arclength is integrated by five-point Gauss-Legendre between the grid's points; the nodes are found
    by three steps of Newton's method. Derivatives with respect to `shape` are those of the converged
    nodes: the last two steps, which start at a root, carry first and second order.
    """

    def arc(low: Array, high: Array) -> Array:
        half = 0.5 * (high - low)
        u = low[:, None] + half[:, None] * (1.0 + _NODES)[None, :]
        return half * (speed(shape, u) @ _WEIGHTS)

    arcs = jnp.concatenate([jnp.zeros(1), jnp.cumsum(arc(grid[:-1], grid[1:]))])
    targets = jnp.linspace(0.0, 1.0, cells + 1) * arcs[-1]

    def newton(u: Array, _: None) -> tuple[Array, None]:
        cell = jnp.clip(jnp.searchsorted(arcs, targets) - 1, 0, grid.shape[0] - 2)
        reached = arcs[cell] + arc(grid[cell], u)
        return u - (reached - targets) / speed(shape, u), None

    start = jax.lax.stop_gradient(jnp.interp(targets, arcs, grid))
    return jax.lax.scan(newton, start, length=3)[0], arcs


def _hermite(speed: Speed, shape: Any, nodes: Array, step: Array) -> Array:
    value, slope = jax.jvp(lambda u: speed(shape, u), (nodes,), (jnp.ones_like(nodes),))
    first = step / value
    second = -slope * step**2 / value**3
    return hermite(nodes, first, second)


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


def invert(speed: Speed, shape: Any, table: ArclengthTable, s: Scalar) -> Scalar:
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
        return u, moved + s_dot / speed(shape, u)

    return parameter(shape, table, s)
