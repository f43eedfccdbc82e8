r"""Symmetric positive definite matrices of many rows: the factorisation of `_plane` as a loop over an array.

Written out number by number, $L D L^T$ of m rows is $m^3/6$ operations, each of which is compiled: the
program of a run with sixteen planar fingers, which have 32 rows, takes half a minute, and one with more
fingers soon longer than anybody waits. A loop is as long a program for any number of rows, but it goes over
whole rows and columns: with it runs of nine and twelve fingers took one and a half times as long, and batches
of them two and a half to four times.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Scalar
from ._arrays import row
from ._plane import scalars


class LoopFactor(NamedTuple):
    """$L D L^T$ of a symmetric positive definite matrix of many rows."""

    matrix: Float[Array, "m m"]  # symmetric: the pivots D on its diagonal, below it L D, above it D L^T
    smallest_pivot: Scalar  # relative to the largest diagonal entry; not positive when singular


def factorise_in_loop(matrix: Float[Array, "m m"]) -> LoopFactor:
    r"""Column by column: $a_{ik} \to a_{ik} - a_{ij} a_{jk} / d_j$ for all i, k > j; by then $d_j = a_{jj}$.

    No later column changes row j: what stands there in the end are the factors.
    """
    index = jnp.arange(matrix.shape[0])

    def eliminated(j: Scalar, left: Array) -> Array:
        own = row(left, j)
        beyond = jnp.where(index > j, own, 0.0)
        return left - (beyond / row(own, j))[:, None] * beyond[None, :]

    left = jax.lax.fori_loop(0, matrix.shape[0], eliminated, matrix)
    # Not reductions: with many lanes XLA hands them to a library, which breaks up the kernel of a run.
    smallest = functools.reduce(jnp.minimum, scalars(_diagonal(left)))
    largest = functools.reduce(jnp.maximum, scalars(_diagonal(matrix)))
    return LoopFactor(left, smallest / largest)


def solve_in_loop(factor: LoopFactor, right: Float[Array, " m"]) -> Float[Array, " m"]:
    """Solve A x = b with a factorised matrix: L y = b, D z = y, L^T x = z."""
    left, inverse = factor.matrix, 1.0 / _diagonal(factor.matrix)
    last, index = left.shape[0] - 1, jnp.arange(left.shape[0])

    # Each number that is known goes into all that wait for it: y_i -= l_ij y_j, x_i -= l_ji x_j.
    def forward(j: Scalar, y: Array) -> Array:
        return y - jnp.where(index > j, row(left, j) * (row(inverse, j) * row(y, j)), 0.0)

    def backward(i: Scalar, x: Array) -> Array:
        j = last - i
        return x - jnp.where(index < j, row(left, j) * inverse * row(x, j), 0.0)

    y = jax.lax.fori_loop(0, last, forward, right)
    return jax.lax.fori_loop(0, last, backward, y * inverse)


def unknown_loop_factor(size: int) -> LoopFactor:
    """A factor of the right structure, full of zeros: the carry of a loop before its first turn."""
    return LoopFactor(jnp.zeros((size, size)), jnp.zeros(()))


def _diagonal(matrix: Array) -> Array:
    count = matrix.shape[0]
    return jax.lax.slice(jnp.ravel(matrix), (0,), (count * count,), (count + 1,))
