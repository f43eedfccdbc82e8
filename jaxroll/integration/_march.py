"""Run a grasp, alone or among many, and differentiate the run through its recorded steps.

Forwards, the run is a plain adaptive loop. For a derivative the accepted steps are recorded and the
derivative follows them one by one: forwards for tangents, backwards for cotangents, each with the
derivative of a single step. Both modes work from the same public call, no step-size controller is
differentiated, and the program that is compiled holds one step, not a checkpointed loop. The derivative
is that of the discrete solution at frozen step sizes.
"""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from .._backend import filled, one_kernel
from .._types import Scalar
from ._ensemble import Ensemble
from ._flow import Bundle, Flow
from ._loop import recorded, solo
from ._plan import Path, Plan


@eqx.filter_custom_jvp
def march(grasp: Bundle, y0: Flow, plan: Plan) -> Path:
    """Integrate the flow vector `y0` of a bundled grasp; differentiable in both modes, once."""
    arrays, still = eqx.partition((grasp, y0, plan), eqx.is_array)

    @jax.custom_batching.custom_vmap
    def alone(arrays: Any) -> Path:
        return one_kernel(solo, *eqx.combine(arrays, still))

    @alone.def_vmap
    def _(size: int, batched: list[Any], arrays: Any) -> tuple[Path, Any]:
        paths = _together(size, batched[0], arrays, still)
        return paths, jax.tree.map(lambda _: True, paths)

    return alone(arrays)


def _together(size: int, batched: Any, arrays: Any, still: Any) -> Path:
    """Many runs: as an ensemble, or one beside the other where the method does not allow it."""
    plan = eqx.combine(arrays, still)[2]
    explicit = isinstance(plan.stepper.method, diffrax.AbstractERK)
    if explicit and isinstance(plan.progress, diffrax.NoProgressMeter):
        return one_kernel(lambda found: Ensemble(size, batched, found, still).run(), arrays)
    axes = jax.tree.map(lambda b: 0 if b else None, batched)
    return jax.vmap(lambda found: solo(*eqx.combine(found, still)), in_axes=(axes,))(arrays)


@march.def_jvp
def _march_jvp(primals: Any, tangents: Any) -> tuple[Path, Path]:
    grasp, y0, plan = primals
    grasp_dot, y0_dot, _ = tangents
    path, (step_ts, step_ys) = one_kernel(recorded, grasp, y0, plan)
    moving, still = eqx.partition(grasp, eqx.is_inexact_array)
    numbers, plan, step_ts, step_ys = eqxi.nondifferentiable(
        (moving, plan, step_ts, step_ys), name="the state of a run (second derivatives)"
    )
    steps = _steps(numbers, plan, (step_ts, step_ys, path.steps[1]), still)
    start_dot = filled((moving, y0), (grasp_dot, y0_dot))
    ends = (path.saved, path.last, path.t_last)
    dots = linear_map(steps.tangents, steps.cotangents, start_dot, ends)
    no_tangents = jax.tree.map(lambda _: None, path)
    return path, eqx.tree_at(
        lambda p: (p.saved, p.last, p.t_last), no_tangents, dots, is_leaf=lambda x: x is None
    )


def _steps(moving: Bundle, plan: Plan, record: tuple[Array, Array, Array], still: Bundle) -> "_Steps":
    ts, ys, count = record
    margin, last = plan.stepper.lay.margin, ys[count]
    drift = plan.stepper.drift(eqx.combine(moving, still), ts[count], last)
    ended = (last[margin + 1] != 0) & jnp.isfinite(drift[margin]) & (drift[margin] != 0)
    delay = jnp.where(ended, -1.0 / jnp.where(ended, drift[margin], 1.0), 0.0)
    return _Steps(moving, plan, ts, ys, count, still, jnp.where(ended, drift, 0.0), delay)


class _Steps(eqx.Module):
    """The recorded steps of a run, as a linear map between perturbations of its ends.

    A run that an event ended moves its end: time by `delay` per change of the margin at fixed time, and the
    flow vector with it by `drift`.
    """

    moving: Bundle
    plan: Plan
    ts: Float[Array, " steps"]
    ys: Float[Array, "steps flow"]
    count: Int[Array, ""]
    still: Bundle
    drift: Flow
    delay: Float[Array, ""]

    def advance(self, moving: Bundle, y: Flow, k: Scalar) -> Flow:
        grasp = eqx.combine(moving, self.still)
        t1 = jnp.where(k < self.count, self.ts[k + 1], self.ts[k])
        return self.plan.stepper.advance(grasp, self.ts[k], t1, y)[0]

    def _saved_at(self) -> tuple[Array, Array]:
        """Which step each save time ends, and whether it was reached."""
        index = jnp.searchsorted(self.ts, self.plan.ts)
        return jnp.minimum(index, self.count), index <= self.count

    def tangents(self, start: tuple[Bundle, Flow]) -> tuple[Array, Array, Array]:
        index, reached = self._saved_at()
        saved, last = one_kernel(_pushed, self, index, start)
        later = self.delay * last[self._margin]
        return jnp.where(reached[:, None], saved, 0.0), last + self.drift * later, later

    @property
    def _margin(self) -> int:
        return self.plan.stepper.lay.margin

    def cotangents(self, ends: tuple[Array, Array, Array]) -> tuple[Bundle, Flow]:
        saved_bar, last_bar, later_bar = ends
        later_bar = later_bar + jnp.sum(self.drift * last_bar)
        last_bar = last_bar.at[self._margin].add(self.delay * later_bar)
        index, reached = self._saved_at()
        track = jnp.zeros_like(self.ys)
        track = track.at[index].add(jnp.where(reached[:, None], saved_bar, 0.0))
        track = track.at[self.count].add(last_bar)
        return one_kernel(_pulled, self, track)


def _pushed(steps: _Steps, index: Array, start: tuple[Bundle, Flow]) -> tuple[Array, Array]:
    """Tangents of the recorded states at some steps and at the last one, forwards from a start's."""
    moving_dot, y_dot = start

    def step(k: Scalar, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        saved, here = carry
        _, ahead = jax.jvp(
            lambda m, y: steps.advance(m, y, k), (steps.moving, steps.ys[k]), (moving_dot, here)
        )
        ahead = jnp.where(k < steps.count, ahead, here)
        return jnp.where((index == k + 1)[:, None], ahead, saved), ahead

    first = jnp.where((index == 0)[:, None], y_dot, jnp.zeros((index.shape[0], y_dot.shape[0])))
    return jax.lax.fori_loop(0, eqxi.unvmap_max(steps.count), step, (first, y_dot))


def _pulled(steps: _Steps, track: Array) -> tuple[Bundle, Array]:
    """Cotangents of grasp and start, backwards from those of the recorded states."""
    longest = eqxi.unvmap_max(steps.count)

    def step(i: Scalar, carry: tuple[Bundle, Array]) -> tuple[Bundle, Array]:
        moving_bar, ahead = carry
        k = longest - 1 - i
        _, pull = jax.vjp(lambda m, y: steps.advance(m, y, k), steps.moving, steps.ys[k])
        more, back = pull(ahead)
        used = k < steps.count
        keep = lambda total, part: total + jnp.where(used, part, 0.0)  # noqa: E731
        return jax.tree.map(keep, moving_bar, more), keep(track[k], back)

    zeros = jax.tree.map(jnp.zeros_like, steps.moving)
    return jax.lax.fori_loop(0, longest, step, (zeros, track[longest]))


def linear_map(apply: Callable, transpose: Callable, x: Any, like: Any) -> Any:
    """Apply a linear map whose transpose is given, so that both modes of autodiff can use it.

    `like` has the shapes and kinds of what comes out.

    JAX has no other primitive that takes a transpose from the caller and also survives `vmap`: a
    linear solve with the identity, whose "solver" takes (x, b) to (x, apply(x) + b). Everything
    travels as one vector, since JAX wants all of a right-hand side perturbed or none of it.
    """
    flat, unravel = ravel_pytree(x)
    zeros, unravel_out = ravel_pytree(jax.tree.map(jnp.zeros_like, like))
    n = flat.shape[0]

    def solve(_: Callable, b: Array) -> Array:
        image, _ = ravel_pytree(apply(unravel(b[:n])))
        return jnp.concatenate([b[:n], image + b[n:]])

    def transpose_solve(_: Callable, c: Array) -> Array:
        image, _ = ravel_pytree(transpose(unravel_out(c[n:])))
        return jnp.concatenate([c[:n] + image, c[n:]])

    padded = jnp.pad(flat, (0, zeros.shape[0]))
    return unravel_out(jax.lax.custom_linear_solve(lambda z: z, padded, solve, transpose_solve)[n:])
