"""Sine, cosine and inverse hyperbolic sine by polynomials, without branches: what a batch takes of them.

The reductions and the coefficients are fdlibm's. `_trigonometry` has the functions that the package calls.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._types import Scalar

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
# log(2) in two parts, and the minimax polynomial of (log(1+f) - 2z)/z in z^2, z = f/(2+f) (fdlibm).
_LOG_2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
_LOG = (
    6.666666666666735130e-01,
    3.999999999940941908e-01,
    2.857142874366239149e-01,
    2.222219843214978396e-01,
    1.818357216161805012e-01,
    1.531383769920937332e-01,
    1.479819860511658591e-01,
)


def branch_free(angle: Scalar) -> tuple[Scalar, Scalar]:
    """Sine and cosine in double precision by range reduction and polynomials."""
    turns = jnp.floor(angle * (2.0 / np.pi) + 0.5)
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


def branch_free_inverse_sinh(x: Scalar) -> Scalar:
    """Inverse hyperbolic sine in double precision: log(1 + t) with t = |x| + x^2/(1 + sqrt(1 + x^2))."""
    size, square = jnp.abs(x), x * x
    t = size + square / (1.0 + jnp.sqrt(1.0 + square))
    # Of a plain sum XLA would take u - 1 for t, and with it the digits that t has below those of u. It does
    # not see that t is never negative. (A kernel of a GPU may have no `barrier`.)
    u = jnp.where(t >= 0.0, 1.0 + t, t)
    lost = jnp.where(t < 1.0, t - (u - 1.0), 1.0 - (u - t))
    bits = jax.lax.bitcast_convert_type(u, jnp.int64)
    exponent = jnp.right_shift(bits, 52) - 1023
    mantissa = jax.lax.bitcast_convert_type(bits - jnp.left_shift(exponent, 52), jnp.float64)
    large = mantissa > np.sqrt(2.0)
    f = jnp.where(large, 0.5 * mantissa, mantissa) - 1.0
    k = exponent.astype(jnp.float64) + jnp.where(large, 1.0, 0.0)
    z = f / (2.0 + f)
    half = 0.5 * f * f
    tail = z * (half + z * z * _polynomial(_LOG, z * z))
    value = k * _LOG_2[0] - ((half - (tail + (k * _LOG_2[1] + lost / u))) - f)
    return jnp.where(x < 0, -value, value)


def _polynomial(coefficients: tuple[float, ...], x: Scalar) -> Scalar:
    total: Any = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total
