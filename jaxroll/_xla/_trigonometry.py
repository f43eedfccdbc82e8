"""Sine, cosine and inverse hyperbolic sine: of one number libm's, of a batch polynomials without branches.

XLA vectorises the polynomials (`_polynomials`), but calls libm lane by lane for its own functions.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Scalar
from ._polynomials import branch_free, branch_free_inverse_sinh


@jax.custom_jvp
def sine_cosine(angle: Scalar) -> tuple[Scalar, Scalar]:
    """Sine and cosine of an angle [rad], within 3 units in the last place below 10^6 rad.

    One angle goes to libm, which is quickest to compile; a batch to polynomials without branches. Single
    precision uses JAX's own, which vectorise.
    """
    if jnp.result_type(angle) != np.float64:
        return jnp.sin(angle), jnp.cos(angle)
    return _double(angle) if jnp.ndim(angle) == 0 else branch_free(angle)


@jax.custom_batching.custom_vmap
def _double(angle: Scalar) -> tuple[Scalar, Scalar]:
    return jnp.sin(angle), jnp.cos(angle)


@_double.def_vmap
def _batched(
    size: int, batched: list[bool], angles: Scalar
) -> tuple[tuple[Scalar, Scalar], tuple[bool, bool]]:
    return branch_free(angles), (True, True)


@sine_cosine.defjvp
def _sine_cosine_jvp(primals: Any, tangents: Any) -> Any:
    sine, cosine = sine_cosine(*primals)
    (change,) = tangents
    return (sine, cosine), (cosine * change, -sine * change)


@jax.custom_jvp
def inverse_sinh(x: Scalar) -> Scalar:
    """Inverse hyperbolic sine, within 2 units in the last place below 10^150; a batch without branches."""
    if jnp.result_type(x) != np.float64:
        return jnp.arcsinh(x)
    return _inverse_sinh(x) if jnp.ndim(x) == 0 else branch_free_inverse_sinh(x)


@jax.custom_batching.custom_vmap
def _inverse_sinh(x: Scalar) -> Scalar:
    return jnp.arcsinh(x)


@_inverse_sinh.def_vmap
def _inverse_sinh_batched(size: int, batched: list[bool], x: Scalar) -> tuple[Scalar, bool]:
    return branch_free_inverse_sinh(x), True


@inverse_sinh.defjvp
def _inverse_sinh_jvp(primals: Any, tangents: Any) -> Any:
    (x,), (change,) = primals, tangents
    return inverse_sinh(x), change / jnp.sqrt(1.0 + x * x)
