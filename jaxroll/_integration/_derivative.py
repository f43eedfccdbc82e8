r"""Run a grasp, alone or among many, and differentiate the run through its recorded steps.

Forwards, the run is the adaptive loop of `_run`, or of `_batch` for many. For a derivative every accepted
step is recorded, $y_{k+1} = \Phi_k(y_k; m)$ with $m$ the grasp's numbers, and the derivative follows the
steps one by one, each by the derivative of a single one:

$$ \dot y_{k+1} = \partial_y \Phi_k \, \dot y_k + \partial_m \Phi_k \, \dot m, \qquad
   \bar y_k = \partial_y \Phi_k^T \, \bar y_{k+1}, \quad
   \bar m = \sum_k \partial_m \Phi_k^T \, \bar y_{k+1}. $$

Both modes work from the same public call, since the map from one end to the other is a linear one whose
transpose is given (`_xla.linear_map`). No step-size control is differentiated: the derivative is that of the
discrete solution at frozen step sizes. What is compiled holds one step and its derivative, not a loop with
checkpoints. `_backward_step` has the cotangents of a step of the usual methods; `simulate` calls `march`.
Of many runs the ends come from `_batch`, without records; for the derivative each is then run once more,
recording, and followed, one after the other (`_along_runs`).

With respect to times: which steps a run takes is decided with times frozen, but what is saved at $t_i$ is
$x(t_i)$, whose derivative in $t_i$ is the slope that the flow vector carries, $x'$. The functions at the end
(`moving_in_time` and its like) return what they are given and have that derivative: forwards they cost
nothing.
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import diffrax
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._linalg import row, with_row
from .._mechanics import Grasp
from .._results import RESULTS
from .._types import Scalar
from .._xla import (
    differentiable_once,
    in_turn,
    linear_map,
    one_kernel,
    perturbed,
    pulled,
    pushed,
    repeated,
    side_by_side,
    with_lanes,
)
from ._backward_step import pulled_back
from ._batch import Ensemble
from ._bundle import Bundle, bundle, bundled_apart
from ._jumps import is_at
from ._methods import is_rosenbrock, on_tableau, without_checkpoints
from ._run import empty_record, Path, Plan, Record, recorded, solo
from ._state_vector import Flow


@eqx.filter_custom_jvp
def march(grasp: Grasp, y0: Flow, plan: Plan) -> Path:
    """Integrate the flow vector `y0` of a prepared grasp; differentiable in both modes, once."""
    # Under `vmap` many runs are not one run with wider arrays: they take slots in turn (`_batch`).
    arrays, still = eqx.partition((bundle(grasp), y0, plan), eqx.is_array)

    def alone(arrays: Any) -> Path:
        return one_kernel(solo, *eqx.combine(arrays, still))

    def lanes(size: int, batched: Any, arrays: Any) -> Path:
        return _together(size, batched, arrays, still)

    return with_lanes(alone, lanes, arrays)


def _together(size: int, batched: Any, arrays: Any, still: Any) -> Path:
    """Many runs: as an ensemble; side by side or one after the other where the method does not allow that.

    Args:
        size: How many.
        batched: Of every array of (grasp, start, plan), whether each run has its own.
        arrays: These arrays.
        still: All else of (grasp, start, plan).
    """

    def found(arrays: Any) -> Path:
        plan = eqx.combine(arrays, still)[2]
        takes_lanes = on_tableau(plan.stepper.method) or is_rosenbrock(plan.stepper.method)
        if takes_lanes and not plan.dense and isinstance(plan.progress, diffrax.NoProgressMeter):
            return one_kernel(lambda found: Ensemble(size, batched, found, still).run(), arrays)
        one = lambda arrays: solo(*eqx.combine(arrays, still))  # noqa: E731
        # With records: 64 runs of `scenes.pivoted` over a second take twenty times as long side by side.
        if plan.dense and _on_processor():
            return _one_by_one(one, batched, arrays)
        return side_by_side(one, size, batched)(arrays)

    def lanes(more: int, apart: Any, arrays: Any) -> Path:
        # Under another `vmap` all runs become one ensemble. Side by side the loops of several ensembles would
        # wait for each other in every turn: 36 ms a run for 16 times 32 of them, where 512 take 0.3 ms each.
        def laid_out(x: Array, inner: bool, outer: bool) -> Array:
            if not (inner or outer):
                return x
            x = x if outer else x[None]
            x = x if inner else x[:, None]
            return jnp.broadcast_to(x, (more, size, *x.shape[2:])).reshape(more * size, *x.shape[2:])

        either = jax.tree.map(lambda inner, outer: inner or outer, batched, apart)
        flat = jax.tree.map(laid_out, arrays, batched, apart)
        paths = _together(more * size, either, flat, still)
        return jax.tree.map(lambda x: x.reshape(more, size, *x.shape[1:]), paths)

    return with_lanes(found, lanes, arrays)


@march.def_jvp
def _march_jvp(primals: Any, tangents: Any) -> tuple[Path, Path]:
    grasp, y0, plan = primals
    grasp_dot, y0_dot, _ = tangents
    # Numbers of the grasp in which no derivative is asked come apart from the others: with cotangents of all
    # of them the program of the pinch's gradient in one gain had 12 762 lines instead of 11 779.
    moving, still, moving_dot = bundled_apart(grasp, *perturbed(grasp, grasp_dot)[::2])
    # Before the run: its loop has no derivative in reverse mode, and JAX's own words do not say why.
    moving, still, y0, plan = differentiable_once((moving, still, y0, plan), "a run")
    # With tangents asked for, the run is made once, recording; without, `march` itself runs.
    path, record = _recorded(eqx.combine(moving, still), y0, plan)
    steps = _Steps(moving, still, plan, y0, record, _led(path, record))
    start_dot = moving_dot, jnp.zeros_like(y0) if y0_dot is None else y0_dot
    ends: tuple[Array, ...] = (path.saved, path.last, path.t_last)
    where = lambda p: (p.saved, p.last, p.t_last)  # noqa: E731
    if plan.dense:
        path = eqx.tree_at(lambda p: p.record, path, record, is_leaf=lambda x: x is None)
        ends, where = (*ends, record.ys), lambda p: (p.saved, p.last, p.t_last, p.record.ys)  # noqa: E731
    # Saved vectors, the last one and the time of the end move; counts and codes do not.
    dots = linear_map(_Steps.tangents, _Steps.cotangents, steps, start_dot, like=ends)
    no_tangents = jax.tree.map(lambda _: None, path)
    return path, eqx.tree_at(where, no_tangents, dots, is_leaf=lambda x: x is None)


def _recorded(grasp: Bundle, y0: Flow, plan: Plan) -> tuple[Path, Record]:
    """A run and its record; of many runs on a processor the paths alone, with records that hold nothing.

    Records of all would not fit into memory: that of one pinch takes 2 MB. `_along_runs` makes each anew.
    """
    arrays, still = eqx.partition((grasp, y0, plan), eqx.is_array)
    one = lambda arrays: recorded(*eqx.combine(arrays, still))  # noqa: E731
    # What the lanes need to know of the plan: a program keeps them, and traced arrays with them.
    dense, empty = plan.dense, eqx.filter_eval_shape(empty_record, plan, y0)

    def lanes(size: int, batched: Any, arrays: Any) -> tuple[Path, Record]:
        if not _on_processor():
            return side_by_side(one, size, batched)(arrays)
        if dense:
            return _one_by_one(one, batched, arrays)
        # Infinite, so that it would show if a derivative followed such a record.
        none = jax.tree.map(lambda x: jnp.full((size, *x.shape), jnp.inf, x.dtype), empty)
        return _together(size, batched, arrays, still), none

    return with_lanes(lambda arrays: one_kernel(one, arrays), lanes, arrays)


def _along_runs(function: Callable[["_Steps", Any], Any], steps: "_Steps", x: Any) -> Any:
    """`function(steps, x)` in one kernel; of many runs on a processor one after the other, recorded anew.

    Side by side all lanes would select between whole records in every turn: 109 ms a lane of 512 pinches,
    where this takes 6 (`python -m benchmarks.gradients`). Many derivatives of one run go side by side.
    """
    arrays, still = eqx.partition((steps, x), eqx.is_array)
    one = lambda arrays: function(*eqx.combine(arrays, still))  # noqa: E731
    dense = steps.plan.dense

    def anew(arrays: Any) -> Any:
        steps, x = eqx.combine(arrays, still)
        return function(steps if dense else steps.recorded_anew(), x)

    def lanes(size: int, batched: Any, arrays: Any) -> Any:
        if not _on_processor():
            return side_by_side(one, size, batched)(arrays)
        if any(jax.tree.leaves(batched[0])):
            # What a kernel is handed it holds, read or not: the empty records stay behind.
            less = (lambda x: x) if dense else lambda x: eqx.tree_at(_record_of, x, (None, None))
            return _one_by_one(anew, less(batched), less(arrays))
        many = lambda steps, x: side_by_side(lambda x: function(steps, x), size, batched[1])(x)  # noqa: E731
        return _along_runs(many, *eqx.combine(arrays, still))

    return with_lanes(lambda arrays: one_kernel(one, arrays), lanes, arrays)


def _record_of(arrays: tuple["_Steps", Any]) -> tuple[Array, Array]:
    return arrays[0].record.ts, arrays[0].record.ys


def _one_by_one(function: Callable[[Any], Any], batched: Any, arrays: Any) -> Any:
    """`function(arrays)` for all lanes, in turn and in one kernel; lanes of lanes likewise."""

    def turns(parts: tuple[Any, Any]) -> Any:
        own, shared = parts
        return in_turn(lambda shared, own: function(eqx.combine(own, shared)), shared, own)

    def lanes(size: int, batched: Any, parts: Any) -> Any:
        del size
        return _one_by_one(turns, batched, parts)

    return with_lanes(turns, lanes, eqx.partition(arrays, batched))


def _on_processor() -> bool:
    return jax.default_backend() == "cpu"


def _led(path: Path, record: Record) -> Int[Array, ""]:
    """How many of the recorded steps led to the last state.

    A last step to where something is not finite is not among them: it leaves the state as it was, and its
    derivative is not finite.
    """
    count = path.steps[1]
    # `+ -n`: a constant that is subtracted becomes a negation, which XLA moves about (`_xla._loops`).
    before, end = (row(record.ys, jnp.maximum(count + -n, 0)) for n in (1, 0))
    stayed = (count > 0) & (end[-1] > 0) & jnp.all(end[:-1] == before[:-1])
    return jnp.where(stayed, count + -1, count)


class _Steps(eqx.Module):
    """The recorded steps of a run, as a linear map between perturbations of its ends.

    The end of a run that an event ended moves: its time by minus the change of the margin at fixed time over
    the margin's rate, and with the time the flow vector, by its time derivative. That derivative comes from a
    step of no length, so that no second program for derivatives has to be compiled.
    """

    moving: Bundle
    still: Bundle
    plan: Plan
    start: Flow
    record: Record
    count: Int[Array, ""]

    def recorded_anew(self) -> "_Steps":
        """The same, from a run made once more: of many, none has kept its record."""
        path, record = recorded(eqx.combine(self.moving, self.still), self.start, self.plan)
        return replace(self, record=record, count=_led(path, record))

    @property
    def ts(self) -> Float[Array, " steps"]:
        """When every step begins."""
        return self.record.ts

    @property
    def ys(self) -> Float[Array, "steps flow"]:
        """The flow vector where every step begins."""
        return self.record.ys

    def span(self, k: Scalar) -> tuple[Scalar, Scalar]:
        """Start and end of step k; the one after the last has no length."""
        t0 = row(self.ts, k)
        return t0, jnp.where(k < self.count, row(self.ts, k + 1), t0)

    def begun(self, k: Scalar) -> Flow:
        """The flow vector with which step k begins.

        A step that begins with a code is one whose blow was refused, and keeps the margin as it is
        (`_step.advance_lanes`). The one of no length after the last must not begin with the code that ended
        the run: that margin would not drift, and the end's time have no derivative.
        """
        y = row(self.ys, k)
        return y if self.plan.jumps is None else y.at[-1].set(0.0)

    def step(
        self, k: Scalar, over: Callable, *, forwards: bool = False
    ) -> Callable[[Bundle, Flow, Scalar], Flow]:
        """Step k as a function of (moving, y, shift), `shift` later; `forwards` if for tangents."""
        (t0, t1), stepper = self.span(k), self.plan.stepper
        if forwards:
            stepper = replace(stepper, method=without_checkpoints(stepper.method))

        def advance(moving: Bundle, y: Flow, shift: Scalar) -> Flow:
            grasp = eqx.combine(moving, self.still)
            return stepper.advance(grasp, t0 + shift, t1 + shift, y, over=over)[0]

        return advance

    def cotangents_of_step(self, k: Scalar, bar: Flow) -> tuple[Bundle, Flow, Scalar]:
        """Cotangents of (moving, y, shift) from those of where step k ends."""
        stepper, y = self.plan.stepper, self.begun(k)
        if on_tableau(stepper.method):
            return pulled_back(stepper, (self.moving, self.still), self.span(k), y, bar=bar)
        return jax.vjp(self.step(k, pulled), self.moving, y, jnp.zeros((), y.dtype))[1](bar)

    @property
    def passing(self) -> Flow:
        """How the end moves with time, at the entry of a step: x' for x."""
        width, last = self.plan.stepper.lay.width, row(self.ys, self.count)
        return jnp.concatenate([last[width : 2 * width], jnp.zeros_like(last[width:])])

    def postponed(self, drift: Scalar, change: Array) -> Array:
        """-`change` / `drift`: the delay of an event's time, from a change of the margin and its rate.

        Zero for a run that no event ended, and for one that ended where it began, whose time stays.
        """
        ended = (row(self.ys, self.count)[self.margin + 1] > 0) & jnp.isfinite(drift) & (drift != 0)
        ended &= row(self.ts, self.count) > row(self.ts, 0)
        if self.plan.jumps is not None:  # a run that a jump ended moves with the jump alone (`_simulate`)
            ended &= ~is_at(self.plan.jumps, row(self.ts, self.count - 1), row(self.ts, self.count))
        if self.plan.stepper.lay.form.sampled:  # and one that a sample ended with the sample alone
            ended &= ~self.by_sample
        return jnp.where(ended, -change / jnp.where(ended, drift, 1.0), 0.0)

    @property
    def by_sample(self) -> Scalar:
        """Whether a sample's torques ended the run: its last step, of some rounding units, begins there.

        The time that it was planned for is part of the state two steps before the end.
        """
        lay = self.plan.stepper.lay
        planned, following = (row(self.ys, jnp.maximum(self.count - n, 0))[lay.due] for n in (2, 1))
        return (following != planned) & (row(self.ys, self.count)[lay.margin + 1] > 0)

    @property
    def margin(self) -> int:
        """Where the margin is in the flow vector."""
        return self.plan.stepper.lay.margin

    def saved_at(self) -> tuple[Array, Array]:
        """Which step each save time ends, and whether it was reached."""
        index = jnp.searchsorted(self.ts, self.plan.ts).astype(self.count.dtype)
        return jnp.minimum(index, self.count), index <= self.count

    def tangents(self, start: tuple[Bundle, Flow]) -> tuple[Array, ...]:
        """Tangents of (saved, last, t_last), from those of the grasp's numbers and of the start.

        With dense output those of all steps come last.
        """
        return _along_runs(_pushed, self, start)

    def cotangents(self, ends: tuple[Array, ...]) -> tuple[Bundle, Flow]:
        """Cotangents of the grasp's numbers and of the start, from those that `tangents` gives."""
        return _along_runs(_pulled, self, ends)


def _pushed(steps: _Steps, start: tuple[Bundle, Flow]) -> tuple[Array, ...]:
    """Tangents of the ends of a run, as `_Steps.tangents` has them."""
    (moving_dot, y_dot), dense, saves = start, steps.plan.dense, steps.plan.ts

    lay, count = steps.plan.stepper.lay, steps.count

    def step(k: Scalar, carry: tuple[Array, ...]) -> tuple[Array, ...]:
        saved, here, drift, *planned = carry
        planned = [jnp.where(k == count - 2, here[lay.due], dot) for dot in planned]
        within = k < count
        along = (
            jax.tree.map(lambda dot: jnp.where(within, dot, 0.0), moving_dot),
            jnp.where(within, here, steps.passing),
            jnp.where(within, 0.0, 1.0).astype(here.dtype),
        )
        here_now = (steps.moving, steps.begun(k), jnp.zeros((), here.dtype))
        _, ahead = jax.jvp(steps.step(k, pushed, forwards=True), here_now, along)
        drift = jnp.where(k == count, ahead, drift)
        ahead = jnp.where(within, ahead, here)
        if dense:
            return with_row(saved, ahead, k + 1), ahead, drift, *planned
        t0, t1 = steps.span(k)
        return jnp.where(((t0 < saves) & (saves <= t1))[:, None], ahead, saved), ahead, drift, *planned

    # With dense output the tangents of all recorded states, else of those at the save times.
    if dense:
        first = with_row(jnp.zeros_like(steps.ys), y_dot, 0)
    else:
        first = jnp.where((saves <= steps.ts[0])[:, None], y_dot, jnp.zeros_like(y_dot))
    longest = eqxi.unvmap_max(count)
    start_at = first, y_dot, jnp.zeros_like(y_dot)
    if lay.form.sampled:  # and the tangent of the time of the sample with which the last step begins
        start_at = *start_at, y_dot[lay.due]
    rows, last, drift, *planned = jax.lax.fori_loop(0, longest + 1, step, start_at)
    saved = rows[steps.saved_at()[0]] if dense else rows
    later = steps.postponed(drift[steps.margin], last[steps.margin])
    moved = steps.postponed(drift[steps.margin], last[steps.margin] * drift)
    for dot in planned:
        later += jnp.where(steps.by_sample, dot, 0.0)
        moved += jnp.where(steps.by_sample, dot * drift, 0.0)
    reached = saves <= row(steps.ts, count)
    ends = jnp.where(reached[:, None], saved, 0.0), last + moved, later
    return (*ends, rows) if dense else ends


def _pulled(steps: _Steps, ends: tuple[Array, ...]) -> tuple[Bundle, Flow]:
    """Cotangents of grasp and start, backwards from those of the ends of a run.

    Two steps of no length come first: for the rate of the margin, and for that of what the cotangent weighs.
    """
    saved_bar, last_bar, later_bar, *rows_bar = ends
    longest, end = eqxi.unvmap_max(steps.count), steps.count
    zero, unit = jnp.zeros((), last_bar.dtype), jnp.arange(last_bar.shape[0]) == steps.margin
    # Where the cotangent of a delay goes: to the margin of the end, or to the time of the sample that was it.
    delayed, entry = end, unit
    if (lay := steps.plan.stepper.lay).form.sampled:
        delayed = jnp.where(steps.by_sample, end - 2, end)
        entry = jnp.arange(last_bar.shape[0]) == jnp.where(steps.by_sample, lay.due, lay.margin)
    # Each recorded vector gets the cotangents of all save times that it serves.
    index, reached = steps.saved_at()
    saved_bar = jnp.where(reached[:, None], saved_bar, 0.0)
    add = lambda i, track: with_row(track, row(track, row(index, i)) + row(saved_bar, i), row(index, i))  # noqa: E731
    track = jax.lax.fori_loop(0, index.shape[0], add, sum(rows_bar, jnp.zeros_like(steps.ys)))

    def step(carry: tuple, held: tuple[_Steps, Array]) -> tuple:
        (i, moving_bar, ahead, drift, late), (steps, track) = carry, held
        # Turns 0 and 1 are steps of no length from the end; then come the steps themselves, the last first.
        # In a batch all lanes take as many turns as the longest run: `used` leaves out those past an end.
        k = jnp.where(i < 2, end, longest + 1 - i)
        more, back, shift = steps.cotangents_of_step(k, ahead)
        # How fast time alone moves what `ahead` weighs: turn 0 weighs the margin, turn 1 the end's cotangent.
        along = jnp.sum(back * steps.passing) + shift
        drift = jnp.where(i == 0, along, drift)
        delay = steps.postponed(drift, later_bar + along)
        if lay.form.sampled:
            delay = jnp.where(steps.by_sample, later_bar + along, delay)
        late = jnp.where(i == 1, delay, late)
        used, here = (i > 1) & (k < end), jnp.where(i == 1, longest, k)
        ahead = row(track, here) + jnp.where(used, back, 0.0)
        ahead += jnp.where(here == end, last_bar, 0.0) + jnp.where((here == delayed) & entry, late, 0.0)
        moving_bar = jax.tree.map(lambda total, part: total + jnp.where(used, part, 0.0), moving_bar, more)
        return i + 1, moving_bar, jnp.where(i == 0, last_bar, ahead), drift, late

    nothing = jax.tree.map(jnp.zeros_like, steps.moving)
    start = (jnp.asarray(0), nothing, unit.astype(last_bar.dtype), zero, zero)
    return repeated(lambda carry: carry[0] < longest + 2, step, start, (steps, track))[1:3]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def moving_in_time(width: int, ys: Float[Array, "... flow"], ts: Float[Array, "..."]) -> Array:
    """Flow vectors at times, as they are; x, of length `width`, moves with its time at the rate x'."""
    del width, ts
    return ys


@moving_in_time.defjvp
def _moving_in_time(width: int, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    dot, ts_dot = tangents
    # The slope that comes next is not among the numbers of a run: its place would be taken by zero.
    ys, _ = differentiable_once(primals, "a run at the times given")
    rates = ys[..., width : 2 * width]
    # Rows that a run did not reach are not finite, and do not move.
    moved = jnp.where(jnp.isfinite(rates), rates, 0.0) * ts_dot[..., None]
    rest = jnp.zeros((*moved.shape[:-1], ys.shape[-1] - width), ys.dtype)
    return ys, dot + jnp.concatenate([moved, rest], axis=-1)


@jax.custom_jvp
def moving_as(value: Array, other: Array) -> Array:
    """A value with the derivative of another one added to its own, such as that of a time given to a run."""
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
