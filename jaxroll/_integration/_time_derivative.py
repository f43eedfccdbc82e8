r"""Derivatives of a run with respect to its save times and its end.

The plan of a run is not differentiated: which steps it takes is decided with times frozen. But what is saved
at $t_i$ is $x(t_i)$, whose derivative in $t_i$ is the slope that the flow vector carries, $x'$. So the
functions here return what they are given, and have that derivative: forwards they cost nothing.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._results import RESULTS


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def moving_in_time(width: int, ys: Float[Array, "... flow"], ts: Float[Array, "..."]) -> Array:
    """Flow vectors at times, as they are; x, of length `width`, moves with its time at the rate x'."""
    del width, ts
    return ys


@moving_in_time.defjvp
def _moving_in_time(width: int, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    ys, (dot, ts_dot) = primals[0], tangents
    rates = ys[..., width : 2 * width]
    # Rows that a run did not reach are not finite, and do not move.
    moved = jnp.where(jnp.isfinite(rates), rates, 0.0) * ts_dot[..., None]
    rest = jnp.zeros((*moved.shape[:-1], ys.shape[-1] - width), ys.dtype)
    return ys, dot + jnp.concatenate([moved, rest], axis=-1)


@jax.custom_jvp
def moving_as(value: Array, other: Array) -> Array:
    """A value that moves as another one does besides, such as a time that a run was told."""
    del other
    return value


@moving_as.defjvp
def _moving_as(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    return primals[0], tangents[0] + tangents[1]


@jax.custom_jvp
def moving_if_successful(value: Array, code: Array) -> Array:
    """A value that has a derivative only where a result's code is that of success."""
    del code
    return value


@moving_if_successful.defjvp
def _moving_if_successful(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    value, code = primals
    return value, jnp.where(code == RESULTS.successful._value, tangents[0], 0.0)
