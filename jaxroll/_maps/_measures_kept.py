r"""Named reductions: what to keep of every run of a sweep, worked out inside the compiled program.

`measures("settling_time", "result")` is a function of a trajectory for the `keep` of `sweep`: states that
nobody asked for never leave the program. Most measures of motion and force are those of `jaxroll.design`;
here are those of a run's end, its least force and its energy, and the table of all measures, which says what
a run must record for each.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .._integration import check_one_run, Trajectory
from .._results import check_callable, RESULTS, shown
from .._types import Scalar
from ..design import friction_demand, overshoot, peak_force, settling_time, tracking_error

# The fewest saved states for a measure over time. By default `sweep` saves one, which is too few.
_LEAST_TIMES = 3


class Reduction(NamedTuple):
    """A measure of a run that can be kept by name.

    Attributes:
        function: From a trajectory to arrays.
        label: What it is, with its unit, for axes and colour bars.
        record: What the run must have recorded.
        timed: Whether it looks at the saved states along the run.
    """

    function: Callable[[Trajectory], Any]
    label: str
    record: str = ""
    timed: bool = False


def measures(*names: str, **own: Callable[[Trajectory], Any]) -> "Measures":
    r"""What to keep of every run, by name: a function for `keep` of `sweep`.

    | name | what it is |
    |---|---|
    | `result` | the code of `jaxroll.RESULTS` with which the run ended |
    | `t_end` | the time that it reached [s] |
    | `steps` | attempted steps |
    | `first_event` | `result`, `time` [s] and `contact` (finger or joint) of an early end; else NaN, -1 |
    | `margin` | the margin that ended it (`stats.margin`): zero, to rounding; infinite where none did |
    | `final_state` | the last `State` |
    | `final_pose` | its coordinates q: of the object, then of the fingers [m, rad] |
    | `settling_time` | of the contact coordinates [s], as `design.settling_time`: needs `ts` |
    | `overshoot` | of the contact coordinates, as `design.overshoot`: needs `ts` |
    | `tracking_error` | mean time to the end [s], as `design.tracking_error`: needs `ts` |
    | `peak_force` | largest normal force [N]: needs `ts`, and "multipliers" in `record` |
    | `least_force` | smallest normal force [N], the distance from lifting off: needs the same |
    | `friction_demand` | largest friction coefficient that rolling needs: needs the same |
    | `energy_lost` | energy at the first saved state less that at the last [J]: needs `ts`, and "energy" |
    | `energy_residual` | largest error of the energy balance [J]: needs the same |

    Measures that need `ts` look at the saved states, which should be some tens; extremes between two of these
    are not seen. `Measures.record` is the `record` that the names need. A run that ended early has not come
    to rest: its settling time, overshoot and tracking error are NaN, and its forces and energies are those of
    the part that was reached.

    Args:
        *names: From the table.
        **own: By name, a function of a `Trajectory` that returns a pytree of arrays.

    Returns:
        A function from a trajectory to a dict, in the order given.

    Raises:
        ValueError: If a name is not in the table, a function has the name of a measure that is asked for too,
            or a run has not recorded what a measure needs.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> keep = jxr.measures("result", "final_pose", turned=lambda run: run.last.q[0])
        >>> table = keep(jxr.simulate(grasp, state, t1=0.1, record=keep.record))  # as `sweep` does
        >>> table["result"], table["final_pose"].shape, table["turned"].shape
        (successful, (3,), ())
    """
    known = ", ".join(MEASURES_KEPT)
    for name in names:
        if not isinstance(name, str):
            raise ValueError(f"argument names must be names of measures, but one was {shown(name)}")
        if name not in MEASURES_KEPT:
            raise ValueError(f"argument names must be among {known}, but one was {shown(name)[:40]}")
    for name, function in own.items():
        check_callable(name, function, "a function of a trajectory", takes=1)
        if name in names:
            raise ValueError(
                f"argument {name} must have another name, but a measure {name!r} was asked for too"
            )
    if not names and not own:
        raise ValueError(f"argument names must be one or more of {known}, but there was none")
    return Measures(tuple(dict.fromkeys(names)), own)


class Measures(eqx.Module):
    """What `measures` returns: a function from one trajectory to a dict.

    Attributes:
        names: Names of the measures.
        own: The caller's own, by name.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    own: dict[str, Callable[[Trajectory], Any]]

    @property
    def record(self) -> tuple[str, ...]:
        """What a run must record for these measures: for `record` of `sweep`."""
        needed = dict.fromkeys(MEASURES_KEPT[name].record for name in self.names)
        return tuple(part for part in needed if part)

    @property
    def timed(self) -> bool:
        """Whether some of these measures need saved states along the run: `ts` of some tens."""
        return any(MEASURES_KEPT[name].timed for name in self.names)

    def __call__(self, run: Trajectory) -> dict[str, Any]:
        check_one_run("run", run)
        found = {name: _kept(name, run) for name in self.names}
        return found | {name: function(run) for name, function in self.own.items()}


def _kept(name: str, run: Trajectory) -> Any:
    """One measure, if the run has what it needs."""
    asked = MEASURES_KEPT[name]
    part = asked.record
    if part and getattr(run, part) is None:
        raise ValueError(
            f"argument record must hold {part!r} for the measure {name!r}, but the run has none: "
            f"record=({part!r},), or that of `measures(...).record`"
        )
    if asked.timed and run.ts.shape[0] < _LEAST_TIMES:
        raise ValueError(
            f"argument ts must ask for some tens of times for the measure {name!r}, but the run saved "
            f"{run.ts.shape[0]}"
        )
    return asked.function(run)


def _first_event(run: Trajectory) -> dict[str, Any]:
    """What ended a run, when, and at which contact."""
    early = run.result != RESULTS.successful
    time = jnp.where(early, run.stats.t_end, jnp.nan)
    return {"result": run.result, "time": time, "contact": run.stats.contact}


def _least_force(run: Trajectory) -> Scalar:
    """Smallest normal force [N] of any contact at the saved times that were reached."""
    forces = run.multipliers.f  # pyright: ignore[reportOptionalMemberAccess]
    return _extreme(jnp.min, forces)


def _energy_lost(run: Trajectory) -> Scalar:
    """Energy at the first saved state less that at the last one reached [J]."""
    energy = run.energy.kinetic + run.energy.potential  # pyright: ignore[reportOptionalMemberAccess]
    count = jnp.sum(jnp.isfinite(energy))
    return energy[0] - energy[jnp.maximum(count - 1, 0)]


def _energy_residual(run: Trajectory) -> Scalar:
    """Largest error of the energy balance [J] at the saved times that were reached."""
    return _extreme(jnp.max, jnp.abs(run.energy.residual))  # pyright: ignore[reportOptionalMemberAccess]


def _extreme(choose: Callable, values: Array) -> Scalar:
    """The largest or smallest finite number; NaN where there is none."""
    seen = jnp.isfinite(values)
    beyond = jnp.inf if choose is jnp.min else -jnp.inf
    return jnp.where(jnp.any(seen), choose(jnp.where(seen, values, beyond)), jnp.nan)


MEASURES_KEPT = {
    "result": Reduction(lambda run: run.result, "result"),
    "t_end": Reduction(lambda run: run.stats.t_end, "time reached [s]"),
    "steps": Reduction(lambda run: run.stats.steps, "steps"),
    "first_event": Reduction(_first_event, "first event"),
    "margin": Reduction(lambda run: run.stats.margin, "margin at the end"),
    "final_state": Reduction(lambda run: run.last, "final state"),
    "final_pose": Reduction(lambda run: run.last.q, "final pose [m, rad]"),
    "settling_time": Reduction(settling_time, "settling time [s]", timed=True),
    "overshoot": Reduction(overshoot, "overshoot", timed=True),
    "tracking_error": Reduction(tracking_error, "tracking error [s]", timed=True),
    "peak_force": Reduction(peak_force, "peak force [N]", "multipliers", timed=True),
    "least_force": Reduction(_least_force, "least force [N]", "multipliers", timed=True),
    "friction_demand": Reduction(friction_demand, "friction demand", "multipliers", timed=True),
    "energy_lost": Reduction(_energy_lost, "energy lost [J]", "energy", timed=True),
    "energy_residual": Reduction(_energy_residual, "energy residual [J]", "energy", timed=True),
}
