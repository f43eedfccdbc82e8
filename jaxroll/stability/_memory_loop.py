r"""The linearised closed loop of a controller with a memory.

With a memory $m$ that is integrated, the loop at rest is

$$ \ddot\xi + D \dot\xi + H \xi = B m, \qquad \dot m = C_q \xi + C_v \dot\xi + C_m m, $$

and its rates are the eigenvalues of the first-order system. With a sampled controller the torques $u$ are
part of $m$ and held: over a period T the motion is that of a constant input, exactly

$$ x_{k+1} = e^{\mathcal{A} T} x_k + \int_0^T e^{\mathcal{A} \tau} \mathcal{B}\, d\tau\; m_k, \qquad
   m_{k+1} = S_x x_{k+1} + S_m m_k, \qquad x = (\xi, \dot\xi), $$

where $H$ and $D$ are those without the law. Its eigenvalues z decide: the loop is stable if all lie inside
the unit circle; $\log z / T$ are its rates. `_verdict` has the loop without a memory, and judges the rates.
"""

import inspect
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._mechanics import Grasp, State
from .._motion import generalised_force, memory_after_sample, memory_rates
from .._types import Given

# The option of `eig` that lets eigenvectors be differentiated, if JAX has it; `eigenvalues` says what for.
_TWICE: dict[str, Any] = {"enable_eigvec_derivs": True}
if not _TWICE.keys() <= inspect.signature(jax.lax.linalg.eig).parameters.keys():
    _TWICE = {}
# A mode that a sample brings to rest has z = 0 and a rate of minus infinity: this z stands for zero.
_AT_ONCE = 1e-12


def rates_with_memory(
    grasp: Grasp, at: State, t: Given, *, hessian: Array, damping: Array, tangent: Array, rolling: Array
) -> Array:
    """Rates [1/s] of a prepared grasp with a memory at rest: eigenvalues, of a sampled one log z / T.

    Args:
        grasp: The grasp.
        at: Its state at rest, with its memory.
        t: The time [s].
        hessian: $H$ with the memory held, shape (m, m).
        damping: $D$ with the memory held.
        tangent: Directions N of rolling motion.
        rolling: How contacts roll along them.
    """
    time, count = jnp.asarray(t, at.q.dtype), tangent.shape[1]
    zero, one = jnp.zeros_like(hessian), jnp.eye(count, dtype=hessian.dtype)
    motion = jnp.block([[zero, one], [-hessian, -damping]])

    def force(memory: Array) -> Array:
        return tangent.T @ generalised_force(grasp, time, State(at.q, at.v, at.s, memory))

    pushed = jax.jacfwd(force)(at.memory)
    entry = jnp.concatenate([jnp.zeros_like(pushed), pushed])
    follow = memory_after_sample if grasp.form.sampled else memory_rates

    def moved(x: Array, memory: Array) -> Array:
        q, s = at.q + tangent @ x[:count], at.s + rolling @ x[:count]
        return follow(grasp, time, State(q, tangent @ x[count:], s, memory))

    sensed, kept = jax.jacfwd(moved, argnums=(0, 1))(jnp.zeros(2 * count, at.q.dtype), at.memory)
    if not grasp.form.sampled:
        return _sorted(eigenvalues(jnp.block([[motion, entry], [sensed, kept]])))
    # The time of the next sample is no part of the loop.
    entry, sensed, kept = entry[:, :-1], sensed[:-1], kept[:-1, :-1]
    period, held = grasp.controller.period, entry.shape[1]
    both = jnp.block([[motion, entry], [jnp.zeros((held, 2 * count + held), motion.dtype)]])
    over = jax.scipy.linalg.expm(both * period)[: 2 * count]
    z = eigenvalues(jnp.block([[over], [sensed @ over + jnp.pad(kept, ((0, 0), (2 * count, 0)))]]))
    # The loop has fewer states than there are z, as the torques follow from the others: those z are zero.
    z = z[jnp.argsort(-jnp.abs(z))][: 2 * count + held - sum(f.joints for f in grasp.fingers)]
    rates = jnp.log(jnp.where(jnp.abs(z) > _AT_ONCE, z, _AT_ONCE))
    return _sorted(rates / jnp.asarray(period, rates.dtype))


def eigenvalues(matrix: Array) -> Array:
    """Eigenvalues of a square real matrix, in no order; derivatives of any order where they are distinct.

    A first derivative reads eigenvectors, and a second one differentiates them, which JAX does only where it
    is told to: their lengths and signs are arbitrary, but do not matter here. The first versions of JAX 0.10
    cannot be told, and then there are first derivatives alone.
    """
    return jax.lax.linalg.eig(
        matrix, compute_left_eigenvectors=False, compute_right_eigenvectors=False, **_TWICE
    )[0]


def _sorted(rates: Array) -> Array:
    """The rates by rising real part."""
    return rates[jnp.argsort(rates.real)]
