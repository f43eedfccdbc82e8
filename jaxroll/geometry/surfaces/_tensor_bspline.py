"""Tensor products of quintic B-splines: at a place, six functions of each axis, with two derivatives.

A quintic spline of one axis is at any place a sum of six functions, so that one of several axes is the sum of
a small block of coefficients (`block`) times the functions' values (`contracted`). `_surface_patch` uses
knots at a grid's points with not-a-knot ends or a period (`Axis`), `_surface_spline` knots at all integers
(`uniform`).
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import total
from ..._results import computed_at_once
from ..._types import Scalar
from ..._xla import once
from ..contours import basis

# Functions that are not zero at a place, and coefficients of each polynomial: the degree, five, plus one.
ORDER = 6
# Polynomials of the uniform quintic B-splines on one cell, times 120: function, power.
UNIFORM = np.array(
    [
        [1.0, -5.0, 10.0, -10.0, 5.0, -1.0],
        [26.0, -50.0, 20.0, 20.0, -20.0, 5.0],
        [66.0, 0.0, -60.0, 0.0, 30.0, -10.0],
        [26.0, 50.0, 20.0, -20.0, -20.0, 10.0],
        [1.0, 5.0, 10.0, 10.0, 5.0, -5.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
    ]
)


def _by_power() -> np.ndarray:
    """Coefficients of the functions and their first two derivatives: power, 1, derivative, function."""
    tables = [UNIFORM / 120.0]
    for _ in range(2):
        slopes = tables[-1][:, 1:] * np.arange(1, ORDER)
        tables.append(np.pad(slopes, ((0, 0), (0, 1))))
    return np.moveaxis(np.stack(tables), 2, 0)[:, None]


_BY_POWER = _by_power()


class Local(NamedTuple):
    """The six functions at a parameter: number of the first, and their values and two derivatives."""

    first: Array
    weights: Float[Array, "3 6"]


class Axis(NamedTuple):
    """B-splines with knots at the integers, for data there; periodic or open."""

    breaks: np.ndarray  # (pieces + 1,)
    polynomials: np.ndarray  # (pieces, 6, 6): function, power

    def local(self, u: Scalar, *, closed: bool) -> Local:
        """The functions at one parameter; beyond the ends, those of the last piece."""
        pieces = self.breaks.shape[0] - 1
        if closed:
            u = u - pieces * jnp.floor(u / pieces)
        # Open: the knots next to either end are left out, so that the first piece is three nodes long.
        cell = jnp.floor(u) - (0.0 if closed else 2.0)
        piece = jnp.clip(cell, 0.0, pieces - 1.0).astype(int)
        # The polynomials are in the piece's own coordinate, in [0, 1], whose derivative in u is 1 / width.
        breaks = jnp.asarray(self.breaks, u.dtype)
        low = breaks[piece]
        width = breaks[piece + 1] - low
        polynomials = jnp.asarray(self.polynomials, u.dtype)[piece]
        return Local(piece, quintics(polynomials, (u - low) / width, 1.0 / width))


def axis(nodes: int, *, closed: bool) -> tuple[Axis, np.ndarray]:
    """Functions for data at 0, 1, ..., nodes - 1, and the matrix from data to coefficients.

    Closed: the first datum comes again at `nodes`. Constants, worked out once even while JAX traces.
    """
    return _axis(nodes, closed, jnp.result_type(float).name)


@functools.cache
def _axis(nodes: int, closed: bool, dtype: str) -> tuple[Axis, np.ndarray]:
    """`axis` for one floating type, cached, as constants of NumPy even where a caller is being traced."""
    with computed_at_once():
        at = jnp.arange(nodes + int(closed), dtype=dtype)
        breaks, polynomials, values = (np.asarray(x) for x in _tables(at, closed))
    return Axis(breaks, polynomials), np.linalg.inv(values)


@functools.partial(jax.jit, static_argnums=1)
def _tables(at: Array, closed: bool) -> tuple[Array, Array, Array]:
    """Breaks and polynomials of the functions with knots at `at`, and the matrix of their values there."""
    # The nodes are an argument: made in here they would be constants, and XLA would fold for ten seconds.
    found = basis(at, ORDER - 1, closed=closed)
    return found.breaks, found.polynomials, found.matrix(at[: found.count])


def uniform(u: Float[Array, "3"], functions: tuple[int, ...], step: Scalar) -> list[Local]:
    """The functions of three axes at u; knots at all integers, function i is not zero on cells i - 5 to i.

    Derivatives are with respect to `step` times u. Beyond the grid the polynomials of the first or last cell
    are continued.

    All axes and derivatives go through one Horner's scheme: axis by axis, as `quintics` has it, a run on a
    fitted surface took a sixth longer to compile.
    """
    cells = jnp.clip(jnp.floor(u), 0.0, np.array(functions) - float(ORDER))
    x = (u - cells)[:, None, None]
    found = jnp.asarray(_BY_POWER[-1], u.dtype)
    for table in _BY_POWER[-2::-1]:
        found = found * x + table.astype(u.dtype)
    scale = jnp.stack([jnp.ones_like(step), 1.0 / step, 1.0 / (step * step)])
    weights = found * scale[None, :, None]
    return [Local(cells[k].astype(int), weights[k]) for k in range(3)]


def quintics(polynomials: Float[Array, "6 6"], x: Scalar, rate: Scalar) -> Float[Array, "3 6"]:
    """Six quintics at x with two derivatives; `rate` is the derivative of x."""
    c = [polynomials[:, i] for i in range(ORDER)]
    value = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5]))))
    first = c[1] + x * (2.0 * c[2] + x * (3.0 * c[3] + x * (4.0 * c[4] + x * (5.0 * c[5]))))
    second = 2.0 * c[2] + x * (6.0 * c[3] + x * (12.0 * c[4] + x * (20.0 * c[5])))
    return jnp.stack([value, first * rate, second * rate * rate])


def contracted(block: Array, weights: tuple[Float[Array, "3 6"], ...]) -> Array:
    """A block of coefficients summed over its leading axes with these weights.

    Each axis of six coefficients becomes one of three: the value and two derivatives along it.

    Products added one by one, neither `dot` nor a reduction: a batch of any size stays in one kernel.
    """
    # Axis k has six slices and becomes three numbers wide: slice i times the three weights of function i.
    for k, table in enumerate(weights):
        wide = (1,) * k + (3,) + (1,) * (block.ndim - k - 1)
        slices = (jax.lax.slice_in_dim(block, i, i + 1, axis=k) for i in range(ORDER))
        block = once(total([x * table[:, i].reshape(wide) for i, x in enumerate(slices)]))
    return block


def block(coefficients: Array, first: tuple[Array, ...]) -> Array:
    """The coefficients of the functions at a place, six along every axis that `first` names."""
    rest = coefficients.shape[len(first) :]
    start = (*first, *(jnp.zeros((), int) for _ in rest))
    return jax.lax.dynamic_slice(coefficients, start, (ORDER,) * len(first) + rest)
