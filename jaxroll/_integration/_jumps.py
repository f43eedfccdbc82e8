r"""Declared jumps: a run ends a step just before each, and begins anew just after it.

A right-hand side $f$ that jumps at $t_j$ costs a method its order in the step that has the jump inside. So
three steps end there, one `grain` $\epsilon$ of time after each other, which is some rounding units:

$$ \ldots \to t_j - \epsilon, \qquad t_j - \epsilon \to t_j, \qquad t_j \to t_j + \epsilon, \qquad
   t_j + \epsilon \to \ldots $$

The first ends with $f$ as it is before the jump, the second evaluates it anew. They also carry the
derivative in $t_j$. If the jump comes $\delta$ later, the state there is $x + \delta f_-$. The motion after
it, continued back to $t_j$, begins at $x + \delta f_- - \delta f_+$. The second step adds $\delta f_-$, the
third subtracts $\delta f_+$: each takes the slope with which its flow vector begins (`moved`). $\delta$ is a
zero with a derivative.

Jumps at one time count as one. The derivative in their time is shared out equally among them, which is right
where they move together. `_run` and `_step` call this module in a run, `_simulate` before and after; a run
without declared jumps has none of it.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._linalg import row
from .._mechanics import Grasp
from .._types import Scalar
from ..loads import Impulse


def grain(t: Scalar) -> Scalar:
    """Length of the short steps at a jump [s]: four rounding units of t, or of 1 ms if t is less."""
    return 4.0 * jnp.finfo(jnp.result_type(t)).eps * jnp.maximum(jnp.abs(t), 1e-3)


def ordered(grasp: Grasp, t0: Scalar, t1: Scalar) -> Array:
    """The jumps from t0 to t1 that a grasp declares, in order, each once, filled up with infinity."""
    t0, t1 = jnp.asarray(t0), jnp.asarray(t1)
    times = jnp.concatenate([jnp.ravel(jumps).astype(t0.dtype) for jumps in grasp.jumps])
    inside = (times >= t0 - grain(t0)) & (times <= t1 + grain(t1))
    times = jnp.sort(jnp.where(inside, times, jnp.inf))
    # The difference of two infinities is NaN, which is not above anything.
    apart = jnp.diff(times) > 4.0 * grain(times[1:])
    return jnp.sort(jnp.where(jnp.concatenate([jnp.array([True]), apart]), times, jnp.inf))


def with_blows(grasp: Grasp, jumps: Array, t0: Scalar, t1: Scalar) -> Grasp:
    """A grasp whose blows from t0 to t1 have the time of the jump that each counts as one with."""

    def at_jump(load: Any) -> Any:
        if not isinstance(load, Impulse):
            return load
        time = jax.lax.stop_gradient(load.time).astype(jumps.dtype)
        inside = (time >= t0 - grain(t0)) & (time <= t1 + grain(t1))
        at = jnp.max(jnp.where(jumps <= time, jumps, -jnp.inf))
        apart = jnp.where(inside & jnp.isfinite(at), at - time, 0.0)
        return eqx.tree_at(lambda blow: blow.time, load, load.time + jax.lax.stop_gradient(apart))

    return eqx.tree_at(lambda g: g.load, grasp, tuple(map(at_jump, grasp.load)))


def beside(jumps: Array, t: Array, way: float) -> Array:
    """The times, those at a jump replaced by one just after it (`way` is 1) or just before it (-1)."""
    at = jnp.where(jnp.isfinite(jumps), jumps, 0.0)

    def one(t: Scalar) -> Scalar:
        near = (jnp.abs(t - at) <= grain(at)) & jnp.isfinite(jumps)
        return jnp.where(jnp.any(near), jnp.max(jnp.where(near, at + way * grain(at), -jnp.inf)), t)

    return jnp.vectorize(one)(t)


def stop(jumps: Array, passed: Scalar, t: Scalar) -> Scalar:
    """Where a step must end for the next jump; `passed` counts two for every jump that is over."""
    at = _next(jumps, passed)
    ahead = jnp.where(t < at - grain(at), at - grain(at), at)
    return jnp.where(jnp.isfinite(at), jnp.where(passed % 2 == 1, at + grain(at), ahead), jnp.inf)


def passed_at(jumps: Array, passed: Scalar, t: Scalar) -> Scalar:
    """Whether a step that ends at t is one of the two short ones of the next jump."""
    at = _next(jumps, passed)
    return t == jnp.where(passed % 2 == 1, at + grain(at), at)


def _next(jumps: Array, passed: Scalar) -> Scalar:
    """The next jump, infinity after the last."""
    count = jumps.shape[0]
    ahead = row(jumps, jnp.minimum(passed // 2, count - 1))
    return jnp.where(passed // 2 < count, ahead, jnp.inf)


def pending(grasp: Grasp, t: Scalar) -> Scalar:
    """Whether a step that ends at t is the first or the second of the three at a jump: it is not over yet.

    A sample that is due there is taken after the third, when commands have jumped and blows were dealt.
    """
    return _is_one(grasp, t, lambda ahead: (ahead > -0.5) & (ahead < 1.5))


def jumps_at(grasp: Grasp, t: Scalar) -> Scalar:
    """Whether something jumps at a time, but for rounding."""
    return _is_one(grasp, t, lambda ahead: jnp.abs(ahead) <= 1.0)


def _is_one(grasp: Grasp, t: Scalar, right: Callable[[Array], Array]) -> Scalar:
    """Whether a declared jump is the right number of grains ahead of a time."""
    found = jnp.asarray(False)
    for jumps in grasp.jumps:
        times = jax.lax.stop_gradient(jnp.ravel(jumps)).astype(t.dtype)
        found |= jnp.any(right((times - t) / grain(times)))
    return found


def lateness(grasp: Grasp, t: Scalar) -> Scalar:
    """A zero whose derivative is that of the time of the jump at t; no derivative elsewhere."""
    late, count = jnp.zeros_like(t), jnp.zeros_like(t)
    for jumps in grasp.jumps:
        times = jnp.ravel(jumps).astype(t.dtype)
        fixed = jax.lax.stop_gradient(times)
        here = jnp.abs(t - fixed) <= 0.5 * grain(fixed)
        late = late + jnp.sum(jnp.where(here, times - fixed, 0.0))
        count = count + jnp.sum(here, dtype=t.dtype)
    return late / jnp.maximum(count, 1.0)


def is_short(t0: Scalar, t1: Scalar) -> Scalar:
    """Whether a step is one of the two short ones at a jump."""
    return (t1 > t0) & (t1 - t0 <= 2.0 * grain(t1))


def is_at(jumps: Array, t0: Scalar, t1: Scalar) -> Scalar:
    """Whether a step is one of the two short ones at one of these jumps; an event's last step is as short."""
    at = jnp.where(jnp.isfinite(jumps), jumps, 0.0)
    ends = (t1 == at) | (t1 == at + grain(at))
    return is_short(t0, t1) & jnp.any(ends & jnp.isfinite(jumps))


def hits(t0: Scalar, t1: Scalar, time: Scalar) -> Scalar:
    """Whether a step is the second of the three at a time: the one in which a blow at that time acts."""
    t0, t1, time = jax.lax.stop_gradient((t0, t1, time))
    near = 0.5 * grain(time)
    return is_short(t0, t1) & (jnp.abs(t1 - time) <= near) & (time - t0 > near)


def moved(grasp: Grasp, t0: Scalar, t1: Scalar, x: Array, *, rates: Array) -> Array:
    """The vector x at the start of a step, moved with the time of a jump if the step is one of the two there.

    `rates` is its time derivative as the flow vector carries it: before the jump for the second of the three
    steps (see above), after it for the third.
    """
    t0, t1 = jax.lax.stop_gradient((t0, t1))
    late = lateness(grasp, t1) - lateness(grasp, t0)
    return x + jnp.where(is_short(t0, t1), late, 0.0) * rates
