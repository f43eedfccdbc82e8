"""A run: what it is told, one turn of it, and all turns of one run in a loop.

A turn aims (`aim`: from where to where the next step goes), steps (`_step`) and judges (`judge`: whether the
step is taken, and whether the run is over). These are functions of one run's `Course` without branches, masks
in their place, so that `_batch` can map them over lanes; here `solo` loops over them for one run, and
`recorded` keeps every accepted step for the derivative (`_derivative`). `_step_size` decides how long steps
are.
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._linalg import row, with_row
from .._results import RESULTS
from .._types import resolution, Scalar, Times
from .._xla import repeated
from . import _jumps
from ._bundle import Bundle
from ._events import decode
from ._state_vector import Flow
from ._step import RollingStep
from ._step_size import at_rest, Pace, StopAt

# Save times closer than this are the same [s].
_SAME_TIME = 1e-10


class Plan(eqx.Module):
    """How to run: solver, step sizes, times."""

    stepper: RollingStep
    controller: diffrax.AbstractStepSizeController
    t0: Float[Array, ""]
    t1: Float[Array, ""]
    ts: Times
    dt0: Float[Array, ""]
    jumps: Float[Array, " j"] | None
    progress: diffrax.AbstractProgressMeter
    max_steps: int = eqx.field(static=True)
    dense: bool = eqx.field(static=True)

    def at_rest(self, y0: Flow) -> Pace:
        """The pace before the first step."""
        start = (None, self.t0, self.t1, y0, self.dt0, None, None, self.stepper.error_order)
        _, inner = self.controller.init(*start)  # pyright: ignore
        return at_rest(jax.tree.map(jnp.asarray, inner), self.t0)

    def control(self, pace: Pace, dip: Scalar = jnp.inf, at_jump: Scalar | None = None) -> StopAt:
        """Step-size control that goes on at a pace; `dip` is where the margin of the last step dips."""
        return StopAt(self.controller, pace, self.dt0, dip, at_jump, self.max_steps, self.stepper.lay.margin)


class Path(eqx.Module):
    """What a run left behind.

    Attributes:
        saved: Flow vectors at `ts`; not finite where the run did not get there.
        last: Flow vector where the run ended.
        t_last: When it ended.
        steps: Attempted, accepted and rejected steps.
        result: Result code.
        record: All accepted steps, if the plan asks for them.
    """

    saved: Float[Array, "t flow"]
    last: Flow
    t_last: Float[Array, ""]
    steps: Int[Array, "3"]
    result: RESULTS
    record: "Record | None" = None


def path_of(saved: Array, last: Flow, t_last: Scalar, counts: tuple[Array, Array, Array]) -> Path:
    """What a loop left; `counts` are attempted and accepted steps, and the number of diffrax's code."""
    attempted, accepted, number = (x.astype(int) for x in counts)
    steps = jnp.stack([attempted, accepted, attempted - accepted])
    code = eqx.tree_at(lambda r: r._value, diffrax.RESULTS.successful, number.astype(jnp.int32))
    return Path(saved, last, t_last, steps, decode(last[-1], code))


class Course(NamedTuple):
    """A run in progress.

    Attributes:
        y: Flow vector.
        pace: Step-size control.
        loop: diffrax's code of the run, as a number.
        saved: How many save times were reached.
        hit: Whether one was reached in the last step.
        busy: Whether the run goes on.
        passed: How many short steps at declared jumps were taken (`_jumps`); None where none are declared.
    """

    y: Array
    pace: Pace
    loop: Array
    saved: Array
    hit: Array
    busy: Array
    passed: Array | None


def embark(plan: Plan, y0: Flow) -> Course:
    """Before the first step."""
    fine, none = jnp.asarray(diffrax.RESULTS.successful._value), jnp.asarray(0)
    passed = None if plan.jumps is None else jnp.asarray(0)
    return Course(y0, plan.at_rest(y0), fine, none, jnp.asarray(False), jnp.asarray(True), passed)


def aim(plan: Plan, course: Course) -> tuple[Scalar, Scalar]:
    """Start and end of the next step; a run that is over stays where it is."""
    # Steps end at save times, where a state is most accurate, at t1, at samples, and beside declared jumps.
    pace, stop = course.pace, _stop(plan, course.saved)
    lay = plan.stepper.lay
    if lay.form.sampled:
        # A save time that is a sample, but for rounding, stays: `judge` looks for it exactly.
        due = course.y[lay.due]
        if plan.jumps is not None:
            # After a jump at its time; one that had to wait for another jump comes soon (`_jumps.pending`).
            after = _jumps.beside(plan.jumps, due, 1.0)
            due = jnp.maximum(after, pace.t + 2.0 * _jumps.grain(pace.t))
        stop = jnp.where(due < stop - resolution(stop), due, stop)
    if plan.jumps is not None:
        stop = jnp.minimum(stop, _jumps.stop(plan.jumps, course.passed, pace.t))
    ahead = plan.control(pace).ahead(pace.t)
    # The first step has no length, however near the first stop is. A search for an event goes on up to the
    # stop: drawn to it, all tries would be the one that passed the event.
    near = jnp.where(pace.hunt.on, 0.0, _SAME_TIME)
    t1 = jnp.where((ahead > stop - near) & (pace.length > 0), stop, ahead)
    return pace.t, jnp.where(course.busy, t1, pace.t)


def judge(
    plan: Plan, course: Course, times: tuple[Scalar, Scalar], step: tuple[Flow, Flow, Scalar]
) -> Course:
    """Take a step, given as its end, its error estimate and where its margin dips, or leave it."""
    y1, error, dip = step
    at_jump = None
    if plan.jumps is not None:
        at_jump = _jumps.passed_at(plan.jumps, course.passed, times[1])
    keep, _, _, _, pace, code = plan.control(course.pace, dip, at_jump).adapt_step_size(
        *times, course.y, y1, None, error, plan.stepper.error_order, course.pace
    )
    # A loop's state cannot hold diffrax's codes, which are enumerations; it holds their numbers.
    loop = code._value
    # A run that ends where something is not finite keeps the state before that; its code is the new one.
    whole = ~jnp.isnan(y1[-2]) | (jnp.arange(y1.shape[0]) == y1.shape[0] - 1)
    y = jnp.where(keep & whole, y1, course.y)
    holds, count = y[-1] <= 0, plan.ts.shape[0]
    # `aim` ends a step at a save time exactly, so that equality is the test for having reached it.
    hit = course.busy & keep & holds & (course.saved < count) & (pace.t == _stop(plan, course.saved))
    saved = course.saved + jnp.where(hit, 1, 0)
    over = (saved == count) & (pace.t == plan.t1)
    # A run that arrives with the last step that it may take has not failed.
    spent = loop == diffrax.RESULTS.max_steps_reached._value
    loop = jnp.where(over & spent, jnp.asarray(diffrax.RESULTS.successful._value, loop.dtype), loop)
    busy = course.busy & holds & (loop == diffrax.RESULTS.successful._value) & ~over
    pick = lambda new, old: jnp.where(course.busy, new, old)  # noqa: E731
    y, pace, loop = jax.tree.map(pick, (y, pace, loop), (course.y, course.pace, course.loop))
    passed = course.passed
    if passed is not None:
        passed = passed + jnp.where(course.busy & keep & at_jump, 1, 0)
    return Course(y, pace, loop, saved, hit, busy, passed)


def _stop(plan: Plan, saved: Scalar) -> Scalar:
    """The next time where a step has to end."""
    last = plan.ts.shape[0] - 1
    ahead = row(plan.ts, jnp.minimum(saved, last))
    return jnp.where(saved <= last, ahead, plan.t1)


class Record(NamedTuple):
    """Times and flow vectors of all accepted steps, the start first."""

    ts: Array
    ys: Array


def solo(grasp: Bundle, y0: Flow, plan: Plan) -> Path:
    """One run."""
    if not plan.dense:
        return _solo(grasp, y0, plan, None)[0]
    path, record = recorded(grasp, y0, plan)
    return eqx.tree_at(lambda p: p.record, path, record, is_leaf=lambda x: x is None)


def recorded(grasp: Bundle, y0: Flow, plan: Plan) -> tuple[Path, Record]:
    """The same run, with every accepted step recorded."""
    record = empty_record(plan, y0)
    return _solo(grasp, y0, plan, Record(with_row(record.ts, plan.t0, 0), with_row(record.ys, y0, 0)))


def empty_record(plan: Plan, y0: Flow) -> Record:
    """A record with room for as many steps as a run may take; times that it does not reach are infinite."""
    rows = plan.max_steps + 2
    return Record(jnp.full(rows, jnp.inf, y0.dtype), jnp.zeros((rows, y0.shape[0]), y0.dtype))


def _solo(grasp: Bundle, y0: Flow, plan: Plan, record: Record | None) -> tuple[Path, Any]:
    def turn(carry: tuple, held: tuple[Bundle, Plan]) -> tuple:
        (course, saved, record, meter), (grasp, plan) = carry, held
        times = aim(plan, course)
        step = plan.stepper.advance(grasp, *times, course.y)
        course = judge(plan, course, times, step)
        # The row after those of the save times takes states that are not saved: a write without a branch.
        # `+ -1`: a constant that is subtracted becomes a negation, which XLA moves about (`_xla._loops`).
        place = jnp.where(course.hit, course.saved + -1, plan.ts.shape[0])
        saved = with_row(saved, course.y, place)
        if record is not None:
            # After a step that was not taken, the state before it is written once more, to its own row.
            count = course.pace.accepted
            record = Record(with_row(record.ts, course.pace.t, count), with_row(record.ys, course.y, count))
        meter = plan.progress.step(meter, (course.pace.t - plan.t0) / (plan.t1 - plan.t0))
        return course, saved, record, meter

    nothing = jnp.full((plan.ts.shape[0] + 1, y0.shape[0]), jnp.nan, y0.dtype)
    start = (embark(plan, y0), nothing, record, plan.progress.init())
    course, saved, record, meter = repeated(lambda c: c[0].busy, turn, start, (grasp, plan))
    plan.progress.close(meter)
    pace = course.pace
    counts = (pace.attempted, pace.accepted, course.loop)
    return path_of(saved[:-1], course.y, pace.t, counts), record
