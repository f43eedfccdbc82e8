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
from ._flow import Bundle, Flow
from ._pace import at_rest, Pace, StopAt
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


def _at_rest(plan: Plan, grasp: Bundle, y0: Flow) -> Pace:
    """The pace before the first step."""
    order = plan.stepper.error_order(None)
    _, inner = plan.controller.init(None, plan.t0, plan.t1, y0, plan.dt0, grasp, plan.stepper.func, order)
    return at_rest(jax.tree.map(jnp.asarray, inner), plan.t0)


def _control(plan: Plan, pace: Pace, stops: Times | None) -> StopAt:
    return StopAt(plan.controller, pace, plan.dt0, stops, plan.max_steps, plan.stepper.lay.margin)


def _integrate(
    grasp: Bundle, y0: Flow, span: tuple[Scalar, Scalar], control: StopAt, **options: Any
) -> diffrax.Solution:
    return diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: jnp.zeros_like(y)),  # the stepper knows the field
        options.pop("stepper"),
        *span,
        None,
        y0,
        args=grasp,
        stepsize_controller=control,
        adjoint=diffrax.ForwardMode(),
        throw=False,
        **options,
    )


def _legs(grasp: Bundle, y0: Flow, plan: Plan) -> Path:
    """Leg by leg from one save time to the next: nothing that grows with them is in the inner loop."""
    fine = jax.tree.map(jnp.asarray, diffrax.RESULTS.successful)

    def leg(carry: tuple, stop: Scalar) -> tuple[tuple, Flow]:
        y, pace, loop, meter = carry
        alive = (loop == diffrax.RESULTS.successful) & (y[-1] == 0)
        solution = _integrate(
            grasp,
            y,
            (pace.t, jnp.where(alive, stop, pace.t)),
            _control(plan, pace, None),
            stepper=plan.stepper,
            saveat=diffrax.SaveAt(t1=True, controller_state=True),
            max_steps=None,
        )
        assert solution.ys is not None and solution.controller_state is not None
        y, pace = solution.ys[-1], solution.controller_state
        loop = diffrax.RESULTS.where(alive, solution.result, loop)
        meter = plan.progress.step(meter, (pace.t - plan.t0) / (plan.t1 - plan.t0))
        reached = alive & (y[-1] == 0) & (pace.t == stop)
        return (y, pace, loop, meter), jnp.where(reached, y, jnp.nan)

    stops = jnp.concatenate([plan.ts, plan.t1[None]])
    start = (y0, _at_rest(plan, grasp, y0), fine, plan.progress.init())
    (y, pace, loop, meter), saved = jax.lax.scan(leg, start, stops)
    plan.progress.close(meter)
    return _path(saved[:-1], y, pace, loop)


def _recorded(grasp: Bundle, y0: Flow, plan: Plan) -> tuple[Path, Times, Array]:
    """The same run in one piece, with every accepted step recorded."""
    pace = _at_rest(plan, grasp, y0)
    solution = _integrate(
        grasp,
        y0,
        (plan.t0, plan.t1),
        _control(plan, pace, plan.ts),
        stepper=plan.stepper,
        saveat=diffrax.SaveAt(t0=True, steps=True, controller_state=True),
        max_steps=plan.max_steps,
    )
    ts, ys, pace = solution.ts, solution.ys, solution.controller_state
    assert ts is not None and ys is not None and pace is not None
    index = jnp.minimum(jnp.searchsorted(ts, plan.ts), pace.accepted)
    reached = (ts[index] == plan.ts) & (ys[index, -1] == 0)
    saved = jnp.where(reached[:, None], ys[index], jnp.nan)
    return _path(saved, ys[pace.accepted], pace, solution.result), ts, ys


def _path(saved: Array, last: Flow, pace: Pace, loop: diffrax.RESULTS) -> Path:
    steps = jnp.stack([pace.attempted, pace.accepted, pace.attempted - pace.accepted])
    return Path(saved, last, pace.t, steps, decode(last[-1], loop))


@eqx.filter_custom_jvp
def march(grasp: Bundle, y0: Flow, plan: Plan) -> Path:
    """Integrate the flow vector `y0` of a bundled grasp; differentiable in both modes, once."""
    return _legs(grasp, y0, plan)


@march.def_jvp
def _march_jvp(primals: Any, tangents: Any) -> tuple[Path, Path]:
    grasp, y0, plan = primals
    grasp_dot, y0_dot, _ = tangents
    path, step_ts, step_ys = _recorded(grasp, y0, plan)
    moving, still = eqx.partition(grasp, eqx.is_inexact_array)
    numbers, plan, step_ts, step_ys = eqxi.nondifferentiable(
        (moving, plan, step_ts, step_ys), name="the state of a run (second derivatives)"
    )
    steps = _steps(numbers, plan, (step_ts, step_ys, path.steps[1]), still)
    moving_dot = jax.tree.map(_fill, moving, grasp_dot)
    dots = linear_map(steps.tangents, steps.cotangents, (moving_dot, _fill(y0, y0_dot)))
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

    def _advance(self, moving: Bundle, y: Flow, k: Scalar) -> Flow:
        grasp = eqx.combine(moving, self.still)
        t1 = jnp.where(k < self.count, self.ts[k + 1], self.ts[k])
        return self.plan.stepper.advance(grasp, self.ts[k], t1, y)[0]

    def _saved_at(self) -> tuple[Array, Array]:
        """Which step each save time ends, and whether it was reached."""
        index = jnp.searchsorted(self.ts, self.plan.ts)
        return jnp.minimum(index, self.count), index <= self.count

    def tangents(self, start: tuple[Bundle, Flow]) -> tuple[Array, Array, Array]:
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
        last = track[self.count]
        later = self.delay * last[self._margin]
        moved = last + self.drift * later
        return jnp.where(reached[:, None], track[index], 0.0), moved, later

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
        longest = eqxi.unvmap_max(self.count)

        def step(i: Scalar, carry: tuple[Bundle, Array]) -> tuple[Bundle, Array]:
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
    return unravel_out(jax.lax.custom_linear_solve(lambda z: z, padded, solve, transpose_solve)[n:])


def _fill(value: Array, tangent: Array | None) -> Array:
    return jnp.zeros_like(value) if tangent is None else tangent
