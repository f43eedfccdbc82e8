"""Run diffrax over a grasp, and differentiate the run through its recorded steps.

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

from .._results import RESULTS
from .._types import Scalar, Times
from ..mechanics import Grasp
from ._flow import Flow
from ._regime import decode
from ._stepper import RollingStep


class Plan(eqx.Module):
    """How to run: solver, step sizes, times."""

    stepper: RollingStep
    controller: diffrax.AbstractStepSizeController
    t0: Float[Array, ""]
    t1: Float[Array, ""]
    ts: Times
    dt0: Float[Array, ""]
    progress: diffrax.AbstractProgressMeter
    max_steps: int = eqx.field(static=True)


class Path(eqx.Module):
    """What a run left behind.

    Attributes:
        saved: Flow vectors at `ts`; not finite where the run did not get there.
        last: Flow vector where the run ended.
        t_last: When it ended.
        steps: Attempted, accepted and rejected steps.
        result: Result code.
    """

    saved: Float[Array, "t flow"]
    last: Flow
    t_last: Float[Array, ""]
    steps: Int[Array, "3"]
    result: RESULTS


class StopAt(diffrax.AbstractStepSizeController):
    """A step-size controller that ends steps at the save times, where a step is most accurate.

    The first step has no length: it works out the derivative that the flow vector carries, and so
    spares the program a copy of the equations of motion.
    """

    inner: diffrax.AbstractStepSizeController
    ts: Times
    dt0: Float[Array, ""]

    def wrap(self, direction: Scalar) -> "StopAt":
        return StopAt(self.inner.wrap(direction), self.ts * direction, self.dt0)

    def init(self, terms: Any, t0: Scalar, t1: Scalar, *rest: Any) -> tuple[Scalar, Any]:
        _, memory = self.inner.init(terms, t0, t1, *rest)
        return t0, memory

    def adapt_step_size(self, t0: Scalar, t1: Scalar, *rest: Any) -> tuple:
        keep, start, end, jumped, memory, code = self.inner.adapt_step_size(t0, t1, *rest)
        first = t0 == t1
        old = rest[-1]
        memory = jax.tree.map(lambda new, was: jnp.where(first, was, new), memory, old)
        end = self._clip(start, jnp.where(first, start + self.dt0, end))
        return keep | first, jnp.where(first, t1, start), end, jumped, memory, code

    def _clip(self, t0: Scalar, t1: Scalar) -> Scalar:
        return jnp.minimum(t1, jnp.min(jnp.where(self.ts > t0, self.ts, jnp.inf)))


def _solve(grasp: Grasp, y0: Flow, plan: Plan, record: bool) -> tuple[Path, Any]:
    subs = {
        "saved": diffrax.SubSaveAt(ts=plan.ts),
        "last": diffrax.SubSaveAt(t1=True),
    }
    if record:
        subs["steps"] = diffrax.SubSaveAt(t0=True, steps=True)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: jnp.zeros_like(y)),  # the stepper knows the field
        plan.stepper,
        plan.t0,
        plan.t1,
        plan.dt0,
        y0,
        args=grasp,
        saveat=diffrax.SaveAt(subs=subs),
        stepsize_controller=StopAt(plan.controller, plan.ts, plan.dt0),
        adjoint=diffrax.ForwardMode(),
        progress_meter=plan.progress,
        max_steps=plan.max_steps,
        throw=False,
    )
    times, values, stats = solution.ts, solution.ys, solution.stats
    assert times is not None and values is not None
    counts = [stats[k] for k in ("num_steps", "num_accepted_steps", "num_rejected_steps")]
    path = Path(
        values["saved"],
        values["last"][0],
        times["last"][0],
        jnp.stack([jnp.asarray(c) for c in counts]),
        decode(values["last"][0, -1], solution.result),
    )
    return path, (times["steps"], values["steps"]) if record else None


@eqx.filter_custom_jvp
def march(grasp: Grasp, y0: Flow, plan: Plan) -> Path:
    """Integrate the flow vector `y0` of a prepared grasp; differentiable in both modes, once."""
    return _solve(grasp, y0, plan, record=False)[0]


@march.def_jvp
def _march_jvp(primals: Any, tangents: Any) -> tuple[Path, Path]:
    grasp, y0, plan = primals
    grasp_dot, y0_dot, _ = tangents
    path, (step_ts, step_ys) = _solve(grasp, y0, plan, record=True)
    moving, still = eqx.partition(grasp, eqx.is_inexact_array)
    fixed = eqxi.nondifferentiable(
        (moving, plan, step_ts, step_ys), name="the state of a run (second derivatives)"
    )
    steps = _Steps(*fixed, path.steps[1], still)
    moving_dot = jax.tree.map(_fill, moving, grasp_dot)
    saved_dot, last_dot = linear_map(
        steps.tangents, steps.cotangents, (moving_dot, _fill(y0, y0_dot))
    )
    no_tangents = jax.tree.map(lambda _: None, path)
    return path, eqx.tree_at(
        lambda p: (p.saved, p.last), no_tangents, (saved_dot, last_dot), is_leaf=lambda x: x is None
    )


class _Steps(eqx.Module):
    """The recorded steps of a run, as a linear map between perturbations of its ends."""

    moving: Grasp
    plan: Plan
    ts: Float[Array, " steps"]
    ys: Float[Array, "steps flow"]
    count: Int[Array, ""]
    still: Grasp

    def _advance(self, moving: Grasp, y: Flow, k: Scalar) -> Flow:
        grasp = eqx.combine(moving, self.still)
        t1 = jnp.where(k < self.count, self.ts[k + 1], self.ts[k])
        return self.plan.stepper.advance(grasp, self.ts[k], t1, y)[0]

    def _saved_at(self) -> tuple[Array, Array]:
        """Which step each save time ends, and whether it was reached."""
        index = jnp.searchsorted(self.ts, self.plan.ts)
        return jnp.minimum(index, self.count), index <= self.count

    def tangents(self, start: tuple[Grasp, Flow]) -> tuple[Array, Array]:
        moving_dot, y_dot = start
        track = jnp.zeros_like(self.ys).at[0].set(y_dot)

        def step(k: Scalar, track: Array) -> Array:
            _, ahead = jax.jvp(
                lambda m, y: self._advance(m, y, k),
                (self.moving, self.ys[k]),
                (moving_dot, track[k]),
            )
            return track.at[k + 1].set(jnp.where(k < self.count, ahead, 0.0))

        track = jax.lax.fori_loop(0, eqxi.unvmap_max(self.count), step, track)
        index, reached = self._saved_at()
        return jnp.where(reached[:, None], track[index], 0.0), track[self.count]

    def cotangents(self, ends: tuple[Array, Array]) -> tuple[Grasp, Flow]:
        saved_bar, last_bar = ends
        index, reached = self._saved_at()
        track = jnp.zeros_like(self.ys)
        track = track.at[index].add(jnp.where(reached[:, None], saved_bar, 0.0))
        track = track.at[self.count].add(last_bar)
        longest = eqxi.unvmap_max(self.count)

        def step(i: Scalar, carry: tuple[Grasp, Array]) -> tuple[Grasp, Array]:
            moving_bar, track = carry
            k = longest - 1 - i
            _, pull = jax.vjp(lambda m, y: self._advance(m, y, k), self.moving, self.ys[k])
            more, back = pull(track[k + 1])
            used = k < self.count
            keep = lambda total, part: total + jnp.where(used, part, 0.0)  # noqa: E731
            track = track.at[k].add(jnp.where(used, back, 0.0))
            return jax.tree.map(keep, moving_bar, more), track

        zeros = jax.tree.map(jnp.zeros_like, self.moving)
        moving_bar, track = jax.lax.fori_loop(0, longest, step, (zeros, track))
        return moving_bar, track[0]


def linear_map(apply: Callable, transpose: Callable, x: Any) -> Any:
    """Apply a linear map whose transpose is given, so that both modes of autodiff can use it.

    JAX has no other primitive that takes a transpose from the caller and also survives `vmap`: a
    linear solve with the identity, whose "solver" takes (x, b) to (x, apply(x) + b). Everything
    travels as one vector, since JAX wants all of a right-hand side perturbed or none of it.
    """
    flat, unravel = ravel_pytree(x)
    shape = jax.eval_shape(apply, x)
    zeros, unravel_out = ravel_pytree(jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shape))
    n = flat.shape[0]

    def solve(_: Callable, b: Array) -> Array:
        image, _ = ravel_pytree(apply(unravel(b[:n])))
        return jnp.concatenate([b[:n], image + b[n:]])

    def transpose_solve(_: Callable, c: Array) -> Array:
        image, _ = ravel_pytree(transpose(unravel_out(c[n:])))
        return jnp.concatenate([c[:n] + image, c[n:]])

    padded = jnp.pad(flat, (0, zeros.shape[0]))
    return unravel_out(
        jax.lax.custom_linear_solve(lambda z: z, padded, solve, transpose_solve)[n:]
    )


def _fill(value: Array, tangent: Array | None) -> Array:
    return jnp.zeros_like(value) if tangent is None else tangent
