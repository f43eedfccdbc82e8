"""`simulate`: the entry point of the package.

It checks its arguments (`_arguments`) and calls the compiled `_run`, which lays the state out as a
vector (`_state_vector`), integrates it (`_derivative.march`, which is differentiable) and forms the
`Trajectory`: states, residuals, and contact forces and energies if they were asked for.
"""

import contextlib
import functools
from collections.abc import Collection
from dataclasses import replace
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import total
from .._mechanics import check_states, Grasp, State, tabled_and_judged
from .._motion import (
    as_formulation,
    begun,
    check_due,
    check_rolling,
    check_tasks,
    closed_within,
    CSM,
    energies_at,
    Energy,
    Formulation,
    Multipliers,
    multipliers_at,
    not_rolling,
    of_reached,
    Residuals,
    residuals_at,
    worst,
)
from .._results import check_flag, concrete, RESULTS, traced
from .._types import Given, Scalar
from .._xla import in_turn, once, remembered, sharing, SOON, takes_options, uncollected, without_derivative
from ..geometry import as_it_is_resolved
from ..loads import impulses
from ._arguments import (
    as_numbers,
    check_choices,
    check_control,
    check_meter,
    check_solver,
    Numbers,
    ordered_times,
    RECORDS,
    RTOL,
    step_limit,
    sweeps,
    unclosed,
)
from ._bundle import bundle
from ._contact_impulses import blow_times, contact_impulses, merged, times_before
from ._dense import Dense
from ._derivative import march, moving_as, moving_if_successful, moving_in_time
from ._events import check_overlaps, decode_joints, EVENTS, whose
from ._jumps import beside, jumps_at, lateness, ordered, with_blows
from ._methods import check_method, Seeing, Steady, with_tolerances
from ._report import complaint
from ._run import Path, Plan
from ._state_vector import Layout, layout, states_of, vector_of
from ._step import RollingStep
from ._trajectory import Stats, Trajectory


def simulate(
    grasp: Grasp,
    state: State,
    t1: Given,
    *,
    t0: Given = 0.0,
    ts: Given | int = 301,
    formulation: Formulation | None = None,
    solver: diffrax.AbstractSolver[Any] | None = None,
    rtol: Given = RTOL,
    atol: Given | None = None,
    dt0: Given = 1e-4,
    max_steps: int = 4096,
    events: Collection[str] = ("lift", "friction"),
    stepsize_controller: diffrax.AbstractStepSizeController[Any, Any] | None = None,
    progress_meter: diffrax.AbstractProgressMeter[Any] | None = None,
    record: Collection[str] = (),
    throw: bool = True,
) -> Trajectory:
    r"""Simulate a grasp with rolling contacts from a consistent state.

    Solves $M \dot v + h = u + A^T \mu$ with $A v = 0$, (1)-(7), (73)-(74), and the rolling rates
    (7), (68), in time. By default the index-1 equations are projected back onto positions, tangency and
    velocities after every accepted step, so that drift does not add up, whatever the time span.

    Args (daily use):
        grasp: The grasp; every array in it is differentiable.
        state: A state on the constraints, as `close` returns it.
        t1: Final time [s].
        ts: Times to save at, shape (t,), rising, within [t0, t1]; or how many, evenly spaced. Steps
            end at them, so a saved state is as accurate as the solver.
        rtol: Relative tolerance of the local error of q, v and a memory that is integrated.
        record: Any of 'multipliers' and 'energy', worked out at the saved times, and 'dense', which keeps
            every step, so that `run(t)` is the state at any time (`Trajectory`). Default: none.
        throw: If True, raise when the run ends early; if False, or under `vmap`, read `result`.
    Args (rarely changed):
        t0: Initial time [s].
        formulation: `Index1()` (default) or `CSM(...)`, the chapter's stabilisation.
        solver: An explicit or implicit Runge-Kutta method of diffrax, or `diffrax.HalfSolver` of one.
            Default: `diffrax.Dopri8()`. For long runs `jaxroll.Rosenbrock()`. A method without an error
            estimate, as `diffrax.Euler()`, takes constant steps only; methods that remember earlier steps,
            split the equations or integrate noise are refused.
        atol: Absolute tolerance of the same [m, rad, and these per second]. Default: rtol.
        dt0: Length of the first step [s], before error control has its say.
        max_steps: Steps to attempt at most. A derivative records that many states.
        events: What ends a run besides contour ends, singular contacts and limits that fingers were given:
            any of 'lift' (a normal force falls below zero), 'friction' (a contact with a coefficient leaves
            its friction cone), both by default, and 'penetration' (a fingertip overlaps the object elsewhere:
            64 points of each contour or surface, from the lowest of which it goes down; a corner, where faces
            end, is seen only once such a point is inside of all of them).
        stepsize_controller: A `diffrax.PIDController` without `dtmin`, one of your own that adapts, or
            `diffrax.ConstantStepSize()`, whose steps have the length `dt0` but where a save time cuts them.
            Default: `diffrax.PIDController` with `rtol` and `atol`.
        progress_meter: As in `diffrax.diffeqsolve`. Default: none.

    Returns:
        A `Trajectory`.

    Raises:
        ValueError: If an argument does not fit, or `state` is off the constraints.
        RuntimeError: If `throw` and the run ended early; with `throw=False` all that was computed is
            returned with its code.

    Batching: `vmap` over any array; each lane has its own code, and no lane changes another. Of times that
    JAX traces and that do not rise from `t0` to `t1` the code is `unordered_times`, and every row NaN; shapes
    and contacts of your own that break their contract have `inconsistent_shape` and `not_rolling`.
    Events: a run ends where its model does, at the root of the force, distance or angle that runs out, to
    rounding in time; `stats.t_end` and `last` carry the derivative of that time. A limit that is crossed and
    recrossed within one step is seen from the step's stages, as far as the solver sees it: a push of your own
    controller that is shorter than a step and falls between its stages is no part of the run. Limits of the
    geometry come before those of the forces, which have a pole where a sum of curvatures is zero.
    Gradients: forward and reverse mode, of the discrete solution at frozen step sizes, with respect to
    `grasp` and `state`; in `t1` and `ts` with the slope of the motion there. In `t0`, tolerances and gains of
    the formulation, and twice, they are refused. A derivative records `max_steps` states.
    Accuracy: with default settings about 1e-10 rad and m over the chapter's scenes; constraint rows below
    1e-15 m there, and below 1e-13 m in all of `scenes`.
    Recording energy puts the work into error control, and so can change the steps.
    Single precision: allowed from rtol 1e-5 up.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=3.0)
        >>> f"{run.states.q[-1, 0] - run.states.q[0, 0]:.3f} rad"  # the object turned by
        '0.772 rad'
    """
    check_states(grasp, state)
    check_flag("throw", throw)
    way = as_formulation(grasp, formulation)
    control, dtype = check_control(stepsize_controller), np.dtype(state.q.dtype)
    numbers = as_numbers(t0, t1, ts, dt0=dt0, rtol=rtol, atol=atol, control=control, dtype=dtype)
    setup = Setup(
        check_solver(solver),
        control,
        check_meter(progress_meter),
        step_limit(max_steps),
        check_choices("record", record, RECORDS),
        check_choices("events", events, EVENTS),
        sweeps(numbers, own_control=control is not None),
    )
    # Asked for here, so that nothing is entered for what a grasp does not have.
    if grasp.own_contacts:
        check_rolling(grasp, state)
    if grasp.form.memory:
        check_tasks(grasp, state)
        check_due(grasp, state, numbers.t0)
    if "penetration" in setup.events:
        check_overlaps(grasp)
    ordered, begin = ordered_times(numbers), numbers.t0
    if ordered is not None:
        # From a start that is not a number a run ends at once, whatever its other times are.
        state = jax.tree.map(lambda x: jnp.where(ordered, x, jnp.nan), state)
        numbers = numbers._replace(t0=jnp.where(ordered, begin, 0.0))
    whole = _is_known(grasp) and takes_options((state, numbers))
    run = _RUNS[_is_plain(grasp, setup), whole]
    with uncollected():
        ready, shapes_hold = tabled_and_judged(grasp)
        trajectory, off = run(ready, state, way, numbers, setup)
    if shapes_hold is not None:
        trajectory = _coded(trajectory, ~shapes_hold, RESULTS.inconsistent_shape)
    if ordered is not None:
        code = RESULTS.where(ordered, trajectory.result, RESULTS.unordered_times)
        end = jnp.where(ordered, trajectory.stats.t_end, begin)
        trajectory = eqx.tree_at(lambda run: (run.result, run.stats.t_end), trajectory, (code, end))
    return _checked(trajectory, off) if throw else trajectory


class Setup(NamedTuple):
    """The arguments that decide which program is compiled."""

    solver: diffrax.AbstractSolver[Any]
    controller: diffrax.AbstractStepSizeController | None
    progress: diffrax.AbstractProgressMeter[Any] | None
    max_steps: int
    record: tuple[str, ...]
    events: tuple[str, ...]
    sweeps: int


def _is_plain(grasp: Grasp, setup: Setup) -> bool:
    """Whether all leaves of the arguments are arrays: `jax.jit` then serves, with half the time per call."""
    if setup.controller is not None or setup.progress is not None:
        return False
    return not jax.tree.leaves(setup.solver) and _holds_arrays_alone(grasp)


@remembered
def _holds_arrays_alone(grasp: Grasp) -> bool:
    return all(map(eqx.is_array, jax.tree.leaves(grasp)))


@remembered
def _is_known(grasp: Grasp) -> bool:
    """Whether JAX is tracing none of a grasp's numbers: going over them is a twentieth of a public call."""
    return not traced(grasp)


def _run(
    grasp: Grasp, state: State, formulation: Formulation, numbers: Numbers, setup: Setup
) -> tuple[Trajectory, Array]:
    """The program of a run: its trajectory, and how far the start is off the constraints [m or rad]."""
    check_precision(grasp, state)
    ready, unresolved = as_it_is_resolved(grasp.prepared())
    lay = layout(grasp, "energy" in setup.record)
    if lay.form.memory:
        begin = jnp.asarray(numbers.t0)
        waits = jumps_at(ready, begin) if lay.form.sampled and ready.jumps else None
        state = begun(ready, state, begin, waits=waits)
    y0 = vector_of(lay, state)
    stepper = RollingStep(setup.solver, formulation, lay, setup.events, setup.sweeps)
    given = Numbers(*map(jnp.asarray, numbers))
    jumps, begin, end, saves = None, given.t0, given.t1, given.ts
    if ready.jumps:
        jumps = jax.lax.stop_gradient(ordered(ready, given.t0, given.t1))
        if impulses(ready.load):
            ready = with_blows(ready, jumps, *jax.lax.stop_gradient((given.t0, given.t1)))
        # A run begins before a jump at its start; a state saved at a jump is the one after it.
        begin, (end, saves) = beside(jumps, begin, -1.0), (beside(jumps, t, 1.0) for t in (end, saves))
    end, saves = jax.lax.stop_gradient((end, saves))
    wanted = None
    if "multipliers" in setup.record and impulses(ready.load):
        assert jumps is not None
        saves, *wanted = merged(saves, times_before(ready, jumps, begin, end))
    plan = _plan(stepper, y0, given._replace(t0=begin, t1=end, ts=saves), setup, jumps=jumps)
    # `march` does not differentiate the plan. A derivative in a gain or in the start would be zero without a
    # word: refuse it instead.
    told = "a run has no derivatives in the start's time, tolerances and gains of the formulation"
    plan = without_derivative(plan, told)
    path = march(ready, y0, plan)
    if wanted is not None:
        before = path.saved[wanted[1]]
        path = eqx.tree_at(lambda p: p.saved, path, path.saved[wanted[0]])
        plan = eqx.tree_at(lambda p: p.ts, plan, plan.ts[wanted[0]])
    path = _moving_with(path, lay, given)
    # Without jumps the plan has the caller's own save times.
    ts = moving_as(plan.ts if jumps is None else jax.lax.stop_gradient(given.ts), given.ts)
    trajectory, off = _trajectory(ready, state, path, plan, setup.record, ts)
    if wanted is not None:
        states = states_of(lay, moving_in_time(lay.width, before, blow_times(ready)))
        told = contact_impulses(ready, states, (plan.t0, trajectory.stats.t_end))
        trajectory = eqx.tree_at(lambda run: run.impulses, trajectory, told, is_leaf=lambda x: x is None)
    if jumps is not None:
        # A run with a jump at its start or end goes from just before the one to just after the other.
        t_end = trajectory.stats.t_end
        # In this order a run whose times do not rise ends at t0.
        within = jnp.maximum(jnp.minimum(t_end, given.t1), given.t0)
        off_by = jax.lax.stop_gradient(within - t_end)
        trajectory = eqx.tree_at(lambda run: run.stats.t_end, trajectory, t_end + off_by)
    if path.record is not None:
        dense = Dense(
            bundle(ready), replace(plan.stepper, reverse=True), path.record.ts, path.record.ys, path.steps[1]
        )
        trajectory = eqx.tree_at(lambda run: run.dense, trajectory, dense, is_leaf=lambda x: x is None)
    # CSM lets contacts drift off the constraints, where it cannot be said whether they roll.
    if ready.own_contacts and not isinstance(formulation, CSM):
        trajectory = _judged_rolling(ready, state, trajectory)
    return (trajectory if unresolved is None else _coded(trajectory, unresolved, RESULTS.unresolved)), off


def _coded(run: Trajectory, wrong: Array, code: Any) -> Trajectory:
    """A run with another code where something is wrong with it."""
    return eqx.tree_at(lambda run: run.result, run, RESULTS.where(wrong, code, run.result))


def _judged_rolling(grasp: Grasp, start: State, run: Trajectory) -> Trajectory:
    """A run with the code `not_rolling` if a contact of a caller's own does not roll at a state of it."""
    parts = start, run.states, run.last
    rows = jax.tree.map(lambda a, b, c: jnp.concatenate([a[None], b, c[None]]), *parts)
    contact = not_rolling(grasp, rows)
    wrong = (contact >= 0) & (run.result != RESULTS.unreachable)
    which = jnp.where(wrong, contact, run.stats.contact)
    margin = jnp.where(wrong, jnp.inf, run.stats.margin)
    told = eqx.tree_at(lambda run: (run.stats.contact, run.stats.margin), run, (which, margin))
    return _coded(told, wrong, RESULTS.not_rolling)


def _moving_with(path: Path, lay: Layout, given: Numbers) -> Path:
    """A path with derivatives in the save times, and in the end if it got there."""
    saved = moving_in_time(lay.width, path.saved, given.ts)
    there = moving_if_successful(given.t1, path.result._value)
    last = moving_in_time(lay.width, path.last, there)
    t_last = moving_as(path.t_last, there)
    return eqx.tree_at(lambda p: (p.saved, p.last, p.t_last), path, (saved, last, t_last))


# By whether all leaves of the arguments are arrays, and whether the run is the whole of a program.
_RUNS = {
    (True, False): jax.jit(_run, static_argnames="setup"),
    (True, True): jax.jit(_run, static_argnames="setup", compiler_options=SOON),
    (False, False): eqx.filter_jit(_run),
    (False, True): eqx.filter_jit(_run, compiler_options=SOON),  # pyright: ignore
}


def _plan(stepper: RollingStep, y0: Array, numbers: Numbers, setup: Setup, *, jumps: Array | None) -> Plan:
    """Method, step-size control and times of a run; raise for a method that does not suit the control."""
    t0, t1, ts, dt0, rtol, atol = numbers
    lay, given = stepper.lay, setup.controller
    controller: diffrax.AbstractStepSizeController = Steady()
    if given is None:
        # No `dtmin`, at which diffrax takes a step whatever its error: `StopAt` ends a run that comes to it.
        controller = diffrax.PIDController(rtol=rtol, atol=atol, norm=_Norm(lay))
    elif not isinstance(given, diffrax.ConstantStepSize):
        controller = Seeing(given, lay).wrap(1)
        # A control may change the length of the first step.
        first, _ = controller.init(None, t0, t1, y0, dt0, None, None, stepper.error_order)
        dt0 = first - t0
    method = with_tolerances(setup.solver, rtol, atol)
    check_method(method, controller, y0[: lay.width])
    stepper = RollingStep(method, stepper.formulation, lay, stepper.events, stepper.sweeps)
    meter = setup.progress or diffrax.NoProgressMeter()
    dense = "dense" in setup.record
    return Plan(stepper, controller, t0, t1, ts, dt0, jumps, meter, setup.max_steps, dense)


class _Norm(eqx.Module):
    """Root mean square of the scaled error over what error control looks at (`Layout.controlled`)."""

    lay: Layout = eqx.field(static=True)

    def __call__(self, error: Array) -> Array:
        # Not a reduction: XLA hands those of a batch to a library, which breaks up the kernel of its loop.
        seen = self.lay.controlled(error)
        parts = jax.lax.split(seen, (1,) * seen.shape[0])
        return jnp.sqrt(total([e * e for e in parts]) * (1.0 / len(parts)))[0]


def check_precision(grasp: Grasp, state: State) -> None:
    """Raise for a state of less precision than its grasp: the equations would give slopes of the grasp's."""
    has = state.q.dtype
    with jax.numpy_dtype_promotion("standard"):  # a caller may have it refuse to compare
        wanted = jnp.result_type(*filter(eqx.is_inexact_array, jax.tree.leaves(grasp)))
        less = jnp.promote_types(wanted, has) != has
    if less:
        raise ValueError(f"argument state must be of its grasp's {wanted}, but was of {has}")


def _trajectory(
    grasp: Grasp, state: State, path: Path, plan: Plan, record: tuple[str, ...], ts: Array
) -> tuple[Trajectory, Array]:
    """The public result of a path, with the caller's own save times, and the worst residual of the start."""
    lay, way = plan.stepper.lay, plan.stepper.formulation
    # Rows of `saved` that the run did not reach are NaN: `of_reached` keeps them so, and derivatives finite.
    states = states_of(lay, path.saved)
    # The start goes through the same evaluation as the saved states, which is then compiled once.
    both = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), state, states)
    observe, times = functools.partial(_observed_at, record=record), ()
    if "multipliers" in record:
        times = (jnp.concatenate([jnp.asarray(plan.t0)[None], moving_as(plan.ts, ts)]),)
    found = of_reached(lambda rows: in_turn(observe, (grasp, way), rows, *times), both, state)
    off = worst(jax.tree.map(lambda a: a[0], found[0]))
    on_constraints = isinstance(way, CSM) | (off <= closed_within(state.q.dtype))
    energy = None if found[2] is None else _balance(found[2], path.saved[:, lay.width - 1])
    left, forces = jax.tree.map(lambda a: a[1:], found[:2])
    attempted, accepted, rejected = path.steps
    # The number of the limit that ended the run is positive; without one the margin is told as infinite.
    number = jax.lax.stop_gradient(path.last[-1])
    margin = jnp.where(number > 0, path.last[lay.margin], jnp.inf)
    trajectory = Trajectory(
        ts,
        states,
        states_of(lay, path.last),
        left,
        RESULTS.where(on_constraints, decode_joints(grasp, number, path.result), RESULTS.unreachable),
        Stats(attempted, accepted, rejected, _ended_at(grasp, path, plan), whose(number), margin),
        forces,
        energy,
        labels=grasp.labels,
    )
    return trajectory, off


def _ended_at(grasp: Grasp, path: Path, plan: Plan) -> Scalar:
    """When a run ended [s]; where a jump ended it, the time moves with that of the jump."""
    return path.t_last if plan.jumps is None else path.t_last + lateness(grasp, path.t_last)


def _observed_at(
    given: tuple[Grasp, Formulation], state: State, t: Array | None = None, *, record: tuple[str, ...]
) -> tuple[Residuals, Multipliers | None, tuple[Array, Array] | None]:
    """What one saved state shows: its residuals, and of forces and energies [J] what is to be recorded."""
    grasp, way = given
    # Residuals alone are too little for values that are computed once to pay.
    with sharing() if record else contextlib.nullcontext():
        # A row is taken out of the saved ones once, and not for each of its numbers.
        state = once(state)
        forces = multipliers_at(grasp, t, state, way) if "multipliers" in record else None
        energies = energies_at(grasp, state) if "energy" in record else None
        return residuals_at(grasp, state), forces, jax.tree.map(jnp.asarray, energies)


def _balance(energies: tuple[Array, Array], work: Array) -> Energy:
    """Energy balance (20) at the saved states, from energies of the start and of these [J].

    `work` is what the run has integrated from the start up to each saved state [J].
    """
    start = energies[0][0] + energies[1][0]
    kinetic, potential = (each[1:] for each in energies)
    return Energy(kinetic, potential, work, kinetic + potential - work - start)


def _checked(trajectory: Trajectory, off: Array) -> Trajectory:
    """Raise for a run that failed; while JAX traces, its code says so instead."""
    codes = concrete(trajectory.result._value)
    if codes is None or not codes.any():
        return trajectory
    # In a derivative outside of `jit` the code is known, and so are the values of what is differentiated.
    off, stats = jax.lax.stop_gradient((off, trajectory.stats))
    if codes == RESULTS.unreachable._value:
        raise ValueError(unclosed(off))
    raise RuntimeError(complaint(eqx.tree_at(lambda run: run.stats, trajectory, stats)))
