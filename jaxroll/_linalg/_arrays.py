"""Arrays where a run or its caller wants some: rows of arrays in loops, scalars stacked, sums of rows.

Inside the equations of motion all numbers are scalars (`_plane`); arrays carry them from step to step.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from .._types import Scalar
from ._plane import Pose2, total


def row(rows: jax.Array, i: Scalar) -> jax.Array:
    """Row i >= 0 of an array; support for negative indices would cost three operations."""
    return jax.lax.dynamic_index_in_dim(rows, i, keepdims=False, allow_negative_indices=False)


def with_row(rows: jax.Array, new: jax.Array, i: Scalar) -> jax.Array:
    """The array with row i >= 0 replaced."""
    return jax.lax.dynamic_update_index_in_dim(rows, new, i, 0, allow_negative_indices=False)


def with_row_selected(rows: jax.Array, new: jax.Array, i: Scalar) -> jax.Array:
    """The same by a mask: under `vmap` JAX makes a scatter of an update in place, which no kernel holds."""
    chosen = jnp.arange(rows.shape[0]) == i
    return jnp.where(chosen[(slice(None), *(None,) * new.ndim)], new, rows)


def largest(values: jax.Array) -> jax.Array:
    """The largest of all numbers of an array; its derivative is that of the first one that is as large.

    To differentiate `jnp.max` JAX compares all numbers with the largest. A program may have computed them
    twice, with different rounding: then none equals the largest, and the derivative is NaN. An index is safe.
    """
    flat = jnp.ravel(values)
    return row(flat, jnp.argmax(flat))


def larger(left: Any, right: Any) -> jax.Array:
    """The larger of two numbers, or NaN if one is; differentiated as what was chosen (see `largest`).

    The derivative of `jnp.maximum` is silently zero where neither number equals the result.
    """
    return jnp.where((left > right) | (left != left), left, right)


def smaller(left: Any, right: Any) -> jax.Array:
    """The smaller of two numbers, or NaN if one is; differentiated as what was chosen (see `largest`)."""
    return jnp.where((left < right) | (left != left), left, right)


def stacked(values: Sequence[Scalar]) -> jax.Array:
    """Scalars as one vector, which may be empty."""
    return jnp.stack(tuple(values)) if len(values) else jnp.zeros(0)


def value_and_jacobian(
    function: Callable[[jax.Array], jax.Array], at: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """A vector function's value, shape (m,), and its Jacobian, shape (m, n).

    `jax.linearize` goes over all of it once more: with it `close` in space took 1.2 s to trace, not 0.8 s.
    """
    along = lambda way: jax.jvp(function, (at,), (way,))  # noqa: E731
    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(at.shape[0], dtype=at.dtype))


def three(frame: Pose2) -> jax.Array:
    """A pose as numbers: position [m], then angle [rad]."""
    return jnp.stack([frame.origin.x, frame.origin.y, jnp.arctan2(frame.sin, frame.cos)])


def weighted_sum(weights: Any, rows: jax.Array) -> jax.Array:
    """Sum of the rows of an array, each times its weight: a number, or numbers as many as a row has."""
    # Not a reduction: XLA hands larger ones to a library, which breaks up the kernel of a run. The squeeze is
    # last, since XLA moves a reshape past one operation each time that it simplifies the whole program.
    parts = jax.lax.split(rows, (1,) * rows.shape[0])
    each = [w if jnp.ndim(w) == 0 else w[None] for w in weights]
    return total([w * part for w, part in zip(each, parts, strict=True)])[0]
