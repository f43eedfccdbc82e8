"""Contenders of `stiffness` that are not in the package: a stabilised explicit method."""

from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

_MOST = 200
_DAMPING = 2.0 / 13.0


class RKC(diffrax.AbstractAdaptiveSolver):
    r"""Runge-Kutta-Chebyshev of order 2: real rates to about $0.65 s^2 / h$ are stable with s stages.

    The number of stages follows the step: $s = 1 + \lfloor \sqrt{1 + 1.54 h \rho} \rfloor$. Steps that want
    more than 200 are refused.

    Attributes:
        rate: Bound $\rho$ on the fastest rate [1/s]; None: six power iterations a step, and 10 % more.

    Source: B. P. Sommeijer, L. F. Shampine, J. G. Verwer, "RKC: an explicit solver for parabolic PDEs",
    Journal of Computational and Applied Mathematics 88 (1998) 315-326.
    """

    rate: float | None = eqx.field(static=True, default=None)

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar = diffrax.LocalLinearInterpolation

    def order(self, terms: Any) -> int:
        """Order of the method."""
        return 2

    def error_order(self, terms: Any) -> int:
        """Order of the error estimate."""
        return 3

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> None:
        """Nothing is kept between steps."""
        return None

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """The vector field."""
        return terms.vf(t0, y0, args)

    def step(self, terms: Any, t0: Any, t1: Any, y0: Array, args: Any, solver_state: None, made_jump: Any):
        """One step; the state is one vector."""
        h, field = t1 - t0, lambda t, y: terms.vf(t, y, args)
        k0 = field(t0, y0)
        wanted = 1.0 + jnp.floor(jnp.sqrt(1.0 + 1.54 * h * self._rate(field, t0, y0)))
        count = jnp.clip(wanted, 2.0, _MOST).astype(int)
        w0, w1 = 1.0 + _DAMPING / count**2, jnp.asarray(_SCALES)[count]

        def stage(i: Any, carry: tuple) -> tuple:
            (y, before), (now, last), (b1, b2), c, _ = carry
            k = field(t0 + c * h, y)
            t, d, e = (2.0 * w0 * a - b for a, b in zip(now, last, strict=True))
            d, e = d + 2.0 * now[0], e + 4.0 * now[1]
            b = e / d**2
            mu, nu, scale = 2.0 * b * w0 / b1, -b / b2, 2.0 * b * w1 / b1
            ahead = (1.0 - mu - nu) * y0 + mu * y + nu * before
            ahead = ahead + h * scale * (k - (1.0 - b1 * now[0]) * k0)
            done = i + 1 == count
            pair = (jnp.where(done, y, ahead), jnp.where(done, before, y))
            return pair, ((t, d, e), now), (b, b1), w1 * e / d, k

        one, zero = jnp.ones_like(h), jnp.zeros_like(h)
        # T, T', T'' of degrees 1 and 0; the first two weights are by definition that of degree 2.
        polynomials = ((w0 * one, one, zero), (one, zero, zero))
        weight = one / (4.0 * w0**2)
        carry = ((y0 + h * weight * w1 * k0, y0), polynomials, (weight, weight), one * w1 / (4.0 * w0**2), k0)
        carry = jax.lax.fori_loop(0, count, stage, carry)
        y1, k1 = carry[0][0], carry[4]
        error = 0.8 * (y0 - y1) + 0.4 * h * (k0 + k1)
        error = jnp.where(wanted > _MOST, jnp.inf, error)
        return y1, error, {"y0": y0, "y1": y1}, None, diffrax.RESULTS.successful

    def _rate(self, field: Any, t0: Any, y0: Array) -> Any:
        if self.rate is not None:
            return self.rate
        length = lambda z: jnp.sqrt(jnp.sum(z * z))  # noqa: E731

        def iterate(_: Any, z: Array) -> Array:
            return jax.jvp(lambda y: field(t0, y), (y0,), (z / length(z),))[1]

        start = jnp.asarray(np.random.default_rng(0).standard_normal(y0.shape[0]))
        return 1.1 * length(jax.lax.fori_loop(0, 6, iterate, start))


def _scales() -> np.ndarray:
    """T'(w0) / T''(w0) of degree s, for every s."""
    s = np.arange(2, _MOST + 1)
    angle = 2.0 * np.arcsinh(np.sqrt(0.5 * _DAMPING) / s)
    slope = s * np.sinh(s * angle) / np.sinh(angle)
    bend = s * np.cosh(s * angle) * np.sinh(angle) - np.sinh(s * angle) * np.cosh(angle)
    return np.concatenate([np.ones(2), slope / (s * bend / np.sinh(angle) ** 3)])


_SCALES = _scales()
