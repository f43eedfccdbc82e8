"""`simulate`: the entry point of the package, and with `_march` the only door to diffrax's loop."""

from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from .._results import RESULTS, concrete, raise_on_failure
from ..mechanics import Grasp, State
from ._close import REACHED, check_state
from ._flow import Layout, layout, states_of, vector_of
from ._formulation import CSM, Formulation, Index1
from ._march import Path, Plan, march
from ._observe import Energy, energies_at, multipliers_at, residuals_at, worst
from ._stepper import RollingStep
from ._trajectory import Stats, Trajectory

_RECORDS = ("multipliers", "energy")
_OPTIONS = ("atol", "dt0", "max_steps", "stepsize_controller", "progress_meter")
# Below this relative tolerance single precision cannot deliver: steps collapse.
_FLOAT32_FLOOR = 1e-5


def simulate(
    grasp: Grasp,
    state: State,
    t1: ArrayLike,
    *,
    t0: ArrayLike = 0.0,
    ts: ArrayLike | int = 301,
    formulation: Formulation | None = None,
    solver: diffrax.AbstractSolver | None = None,
    rtol: float = 1e-8,
    record: tuple[str, ...] = (),
    throw: bool = True,
    **options: Any,
) -> Trajectory:
    r"""Simulate a grasp with rolling contacts from a consistent state.

    Solves $M \dot v + h = u + A^T \mu$ with $A v = 0$, (1)-(7), (73)-(74), and the rolling rates
    (7), (68), in time. By default the index-1 equations are projected back onto positions, tangency and
    velocities after every accepted step, so that drift stays at rounding level on any time span.

    Args (daily use):
        grasp: The grasp; every array in it is differentiable.
        state: A state on the constraints, as `close` returns it.
        t1: Final time [s].
        ts: Times to save at, shape (t,), rising, within [t0, t1]; or how many, evenly spaced. Steps
            end at them, so a saved state is as accurate as the solver.
        rtol: Relative tolerance of the local error of q and v.
        record: Any of 'multipliers' and 'energy', worked out at the saved times. Default: neither.
        throw: If True, raise when the run ends early; if False, or under `vmap`, read `result`.
    Args (rarely changed):
        t0: Initial time [s].
        formulation: `Index1()` (default) or `CSM(...)`, the chapter's stabilisation.
        solver: Any diffrax ODE solver. Default: `diffrax.Dopri8()`.
        **options: `atol` (default: rtol), `dt0` [s], `max_steps` (default 4096),
            `stepsize_controller` and `progress_meter`, as in `diffrax.diffeqsolve`.

    Returns:
        A `Trajectory`.

    Raises:
        ValueError: If an argument does not fit, or `state` is off the constraints.
        RuntimeError: If `throw` and the run ended early; with `throw=False` all that was computed is
            returned with its code.

    Batching: `vmap` over any array; each lane has its own code, and no lane changes another.
    Gradients: forward and reverse mode, of the discrete solution at frozen step sizes, with respect to
    `grasp` and `state`; not to times, and not twice. A derivative records `max_steps` states.
    Accuracy: with default settings about 1e-8 rad over the chapter's 3 s; constraint rows below 1e-14 m.
    Single precision: allowed from rtol 1e-5 up.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=3.0)
        >>> f"{run.states.q[-1, 0] - run.states.q[0, 0]:.3f} rad"
        '0.000 rad'
    """
    check_state(grasp, state)
    plan, lay = _plan(grasp, state, (t0, t1, ts), formulation, solver, rtol, record, options)
    trajectory, off = _run(grasp, state, plan, lay, tuple(record))
    return _checked(trajectory, off, throw)


def _plan(
    grasp: Grasp,
    state: State,
    times: tuple[Any, Any, Any],
    formulation: Formulation | None,
    solver: diffrax.AbstractSolver | None,
    rtol: float,
    record: tuple[str, ...],
    options: dict[str, Any],
) -> tuple[Plan, Layout]:
    _check_choices("record", record, _RECORDS)
    _check_choices("options", tuple(options), _OPTIONS)
    dtype = state.q.dtype
    _check_precision(dtype, rtol)
    t0, t1, ts = _times(*times, dtype)
    lay = layout(grasp, "energy" in record)
    atol = options.get("atol", rtol)
    method = _with_tolerances(solver or diffrax.Dopri8(), rtol, atol)
    stepper = RollingStep(method, formulation or Index1(), lay)
    controller = options.get("stepsize_controller")
    if controller is None:
        controller = diffrax.PIDController(rtol, atol, norm=_Norm(lay), dtmin=1e-12)
    dt0 = jnp.asarray(options.get("dt0", 1e-4), dtype)
    meter = options.get("progress_meter", diffrax.NoProgressMeter())
    return Plan(stepper, controller, t0, t1, ts, dt0, meter, options.get("max_steps", 4096)), lay


def _with_tolerances(method: Any, rtol: Any, atol: Any) -> diffrax.AbstractSolver:
    """Give an implicit method's root finder the tolerances of the run, unless it has its own."""
    if not isinstance(method, diffrax.AbstractSolver):
        raise ValueError(f"argument solver must be a diffrax solver, but was {method!r}")
    finder = getattr(method, "root_finder", None)
    if finder is None or isinstance(finder.rtol, float | jax.Array):
        return method
    return eqx.tree_at(lambda m: m.root_finder, method, diffrax.VeryChord(rtol, atol))


class _Norm(eqx.Module):
    """Root mean square of the scaled error over what error control looks at."""

    lay: Layout = eqx.field(static=True)

    def __call__(self, error: Array) -> Array:
        seen = self.lay.controlled(error)
        return jnp.sqrt(jnp.mean(seen * seen))


def _times(t0: Any, t1: Any, ts: Any, dtype: Any) -> tuple[Array, Array, Array]:
    start_, end = jnp.asarray(t0, dtype), jnp.asarray(t1, dtype)
    if isinstance(ts, int):
        if ts < 1:
            raise ValueError(f"argument ts must be at least 1 time, but was {ts}")
        count = np.linspace(0.0, 1.0, ts) if ts > 1 else np.ones(1)
        saved = start_ + (end - start_) * jnp.asarray(count, dtype)
        saved = saved.at[-1].set(end)
    else:
        saved = jnp.asarray(ts, dtype)
    seen, bounds = concrete(saved), concrete((start_, end))
    if bounds is not None and not bounds[1] > bounds[0]:
        raise ValueError(f"argument t1 must be above t0 = {bounds[0]:g}, but was {bounds[1]:g}")
    if saved.ndim != 1:
        raise ValueError(f"argument ts must have shape (t,), but had shape {saved.shape}")
    if seen is not None and not (np.all(np.diff(seen) > 0) and np.all(np.isfinite(seen))):
        raise ValueError(f"argument ts must rise strictly, but was {seen.tolist()}")
    if seen is not None and bounds is not None and (seen[0] < bounds[0] or seen[-1] > bounds[1]):
        raise ValueError(
            f"argument ts must lie within [{bounds[0]:g}, {bounds[1]:g}], "
            f"but ran from {seen[0]:g} to {seen[-1]:g}"
        )
    return start_, end, saved


def _check_choices(name: str, given: tuple[str, ...], known: tuple[str, ...]) -> None:
    unknown = [item for item in given if item not in known]
    if isinstance(given, str) or unknown:
        raise ValueError(f"argument {name} must be among {known}, but was {given!r}")


def _check_precision(dtype: Any, rtol: float) -> None:
    seen = concrete(rtol)
    if seen is not None and not seen > 0:
        raise ValueError(f"argument rtol must be positive, but was {seen:g}")
    if dtype == jnp.float32 and seen is not None and seen < _FLOAT32_FLOOR:
        raise ValueError(
            f"argument rtol must be at least {_FLOAT32_FLOOR:g} in single precision, but was {seen:g}; "
            "for double precision put jax.config.update('jax_enable_x64', True) first"
        )


@eqx.filter_jit
def _run(
    grasp: Grasp, state: State, plan: Plan, lay: Layout, record: tuple[str, ...]
) -> tuple[Trajectory, Array]:
    ready = grasp.prepared()
    x0 = vector_of(state, lay.audited)
    y0 = jnp.concatenate([x0, jnp.zeros(lay.width + 1, x0.dtype)])
    path = march(ready, y0, plan)
    return _trajectory(ready, state, path, plan, record)


def _trajectory(
    grasp: Grasp, state: State, path: Path, plan: Plan, record: tuple[str, ...]
) -> tuple[Trajectory, Array]:
    lay, way = plan.stepper.lay, plan.stepper.formulation
    saved = jnp.where(jnp.isfinite(path.saved[:, :1]), path.saved, jnp.nan)
    states = states_of(lay, saved)
    both = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), state, states)
    left = jax.vmap(lambda s: residuals_at(grasp, s))(both)
    off = worst(jax.tree.map(lambda a: a[0], left))
    on_constraints = isinstance(way, CSM) | (off <= REACHED)
    forces = energy = None
    if "multipliers" in record:
        forces = jax.vmap(lambda t, s: multipliers_at(grasp, t, s, way))(plan.ts, states)
    if "energy" in record:
        energy = _energy(grasp, states, saved[:, lay.width - 1])
    attempted, accepted, rejected = path.steps
    trajectory = Trajectory(
        plan.ts,
        states,
        states_of(lay, path.last),
        jax.tree.map(lambda a: a[1:], left),
        RESULTS.where(on_constraints, path.result, RESULTS.unreachable),
        Stats(attempted, accepted, rejected, path.t_last),
        forces,
        energy,
    )
    return trajectory, off


def _energy(grasp: Grasp, states: State, work: Array) -> Energy:
    kinetic, potential = jax.vmap(lambda s: energies_at(grasp, s))(states)
    balance = kinetic + potential - work
    return Energy(kinetic, potential, work, balance - balance[0])


def _checked(trajectory: Trajectory, off: Array, throw: bool) -> Trajectory:
    seen = concrete(off)
    if throw and seen is not None and seen.ndim == 0 and _is(trajectory.result, "unreachable"):
        raise ValueError(
            f"argument state must be on the constraints to {REACHED:g}, but its worst row is "
            f"{seen:.3g} m or rad off; jaxroll.close makes it consistent"
        )
    if not throw or concrete(trajectory.result._value) is None:
        return trajectory
    return raise_on_failure(trajectory.result, trajectory)


def _is(result: RESULTS, name: str) -> bool:
    return bool(np.all(np.asarray(result._value) == np.asarray(getattr(RESULTS, name)._value)))
