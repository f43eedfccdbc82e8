"""Sine and cosine without branches: XLA vectorises them, but calls libm lane by lane for its own."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ._types import Scalar

# pi/2 in three parts; products of the first two with an integer below 2^20 are exact.
_HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
# Minimax polynomials on [-pi/4, pi/4] (the kernels of fdlibm) in r^2, lowest power first: what follows r, and
# what follows 1 - r^2/2.
_SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)


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


def branch_free(angle: Scalar) -> tuple[Scalar, Scalar]:
    """Sine and cosine in double precision by range reduction and polynomials."""
    turns = jnp.round(angle * (2.0 / np.pi))
    r = ((angle - turns * _HALF_PI[0]) - turns * _HALF_PI[1]) - turns * _HALF_PI[2]
    square = r * r
    sine = r + r * square * _polynomial(_SINE, square)
    half = 0.5 * square
    whole = 1.0 - half
    # What 1 - r^2/2 loses to rounding is put back with the small terms.
    cosine = whole + ((1.0 - whole) - half + square * square * _polynomial(_COSINE, square))
    quadrant = turns - 4.0 * jnp.floor(0.25 * turns)
    swapped = (quadrant == 1.0) | (quadrant == 3.0)
    s, c = jnp.where(swapped, cosine, sine), jnp.where(swapped, sine, cosine)
    return jnp.where(quadrant >= 2.0, -s, s), jnp.where((quadrant == 1.0) | (quadrant == 2.0), -c, c)


@sine_cosine.defjvp
def _sine_cosine_jvp(primals: Any, tangents: Any) -> Any:
    sine, cosine = sine_cosine(*primals)
    (change,) = tangents
    return (sine, cosine), (cosine * change, -sine * change)


def _polynomial(coefficients: tuple[float, ...], x: Scalar) -> Scalar:
    total: Any = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total
