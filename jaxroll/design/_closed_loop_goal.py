"""Goals of the closed loop: what runs of the grasp are like, in the worst of several cases.

For every case the caller's `make` gives a grasp with the fingertip and a state, `simulate` runs it, and the
measures of `_measures`, times weights, add up to one cost. `_goals` has what goals share: the contract, the
loop over the cases, the smooth maximum. The gradient goes through the run.
"""

from collections.abc import Callable, Collection, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._integration import (
    ProgressMeter,
    RunOptions,
    simulate,
    Solver,
    StepSizeControl,
    Trajectory,
)
from .._motion import Formulation
from .._results import as_count, as_floats, as_positive, check_callable, check_known, RESULTS, shown
from .._types import Given, Scalar
from ..geometry import AbstractContour
from ._goals import (
    AbstractGoal,
    check_cases,
    check_make,
    each_case,
    Make,
    soft_worst,
    WORST_MARGIN,
    worst_margin,
)
from ._limits import ContourSamples
from ._measures import FORCED, MEASURES, PARTIAL, SETTLED

Objective = Mapping[str, float] | Callable[[Any, Trajectory], Scalar]
# Cost of a run that ends at once, besides its measures: more than that of a run that lasts, whose weighted
# measures are of order one.
_LOST = 10.0
_COST, _EARLY = "worst cost", "runs that end early"


class ClosedLoop(AbstractGoal):
    r"""Runs of the grasp as they should be: settled soon, without overshoot, with little force or friction.

    Every case is simulated, all in one program, and the worst one counts: a smooth upper bound of the
    largest cost, within $\log n / 50$ of it. A run that ends early costs $10\,(t_1 - t_{end})/(t_1 - t_0)$
    more, so that fingertips which lose the grasp are changed to hold it for longer; its measures are those of
    the part that was reached, and an objective of your own counts as zero for a run for which it is NaN. A
    figure that is reported (`Design.figures`) is NaN if one of the cases does not have it.

    Args:
        make: From a fingertip, and a case if there are any, to a grasp and a state on its constraints, by JAX
            operations; a scene or `close` may be inside.
        objective: Weights by name: 'settling_time', 'overshoot', 'tracking_error', 'peak_force',
            'friction_demand', each in one over the measure's unit, so that the sum is of order one. Or a
            function of the grasp and its run that returns such a cost.
        cases: A pytree of arrays with a leading axis: objects, poses, gains. Default: one case.
        t1: Final time of the runs [s]; positive.
        ts: How many states are saved, evenly spaced; at least two.
        rtol: Relative tolerance of the runs, looser than `simulate`'s own.
        record: What is worked out at the saved times, as for `simulate`. Default: the contact forces, if a
            measure needs them or the objective is a function of your own.
        t0, formulation, solver, atol, dt0, max_steps, events, stepsize_controller, progress_meter: As for
            `simulate`, and with its defaults; numbers must be known when the goal is made.

    Raises:
        ValueError: If `make` cannot be called so, `objective` is neither a function nor finite weights of
            these names, `cases` have no common leading axis, `t1` is not positive, `ts` is not a whole number
            from 2 up, or another argument is not what `simulate` takes.

    Example:
        >>> import jaxroll as jxr, jax.numpy as jnp
        >>> goal = jxr.design.ClosedLoop(
        ...     lambda tip, a: jxr.scenes.pinch_ellipse(a, 0.02, tips=tip),
        ...     {"settling_time": 1.0, "friction_demand": 0.5},
        ...     cases=jnp.linspace(0.012, 0.018, 4),
        ...     t1=1.0,
        ... )
    """

    make: Make = eqx.field(static=True)
    objective: tuple[tuple[str, float], ...] | Callable = eqx.field(static=True)
    cases: Any
    t1: Float[Array, ""]
    ts: int = eqx.field(static=True)
    options: RunOptions = eqx.field(static=True)

    def __init__(
        self,
        make: Make,
        objective: Objective,
        *,
        cases: Any = None,
        t1: Given = 1.0,
        ts: int = 101,
        t0: Given = 0.0,
        formulation: Formulation | None = None,
        solver: Solver | None = None,
        rtol: Given = 1e-6,
        atol: Given | None = None,
        dt0: Given = 1e-4,
        max_steps: int = 4096,
        events: Collection[str] = ("lift", "friction"),
        stepsize_controller: StepSizeControl | None = None,
        progress_meter: ProgressMeter | None = None,
        record: Collection[str] | None = None,
    ) -> None:
        self.make = check_make(make, cases)
        self.objective = _as_objective(objective)
        self.cases = check_cases(cases)
        self.t1 = as_positive("t1", t1)
        self.ts = as_count("ts", ts, least=2)
        options = RunOptions(
            t0=t0,
            formulation=formulation,
            solver=solver,
            rtol=rtol,
            atol=atol,
            dt0=dt0,
            max_steps=max_steps,
            events=events,
            stepsize_controller=stepsize_controller,
            progress_meter=progress_meter,
            record=record,
        )
        self.options = options.checked(self.t1, self.ts)

    @property
    def in_turn(self) -> bool:
        """True: runs that are differentiated side by side gain nothing, as `each_case` says."""
        return True

    def run(self, tip: AbstractContour, names: tuple[str, ...]) -> tuple[Array, Array, Array]:
        """Of every case: the named measures, shape (n, m), a caller's objective, the share of time lost."""

        def found(grasp: Any, state: Any) -> tuple[Array, Array, Array]:
            # Contact forces cost time to record: only if a measure needs them, or the caller's objective may.
            forced = ("multipliers",) if FORCED & set(names) or callable(self.objective) else ()
            asked = self.options.record
            told = self.options._replace(record=forced if asked is None else asked)
            run = simulate(grasp, state, self.t1, ts=self.ts, throw=False, **told._asdict())
            measured = [PARTIAL[name](run) for name in names]
            closed = run.result != RESULTS.unreachable
            # A difference, which is exactly zero of a whole run: XLA divides by a constant with its inverse,
            # and the quotient of two equal times is then one to rounding alone.
            whole = self.t1 - jnp.asarray(self.options.t0)
            lost = jnp.where(closed, (self.t1 - run.stats.t_end) / whole, 1.0)
            own = _own(self.objective, grasp, run, lost > 0.0)
            return jnp.stack(measured) if measured else jnp.zeros(0), own, lost

        return each_case(self.make, self.cases, tip, found, in_turn=True)

    def cost(self, tip: AbstractContour, seen: ContourSamples, unit: Scalar, sharpness: Scalar) -> Scalar:
        return soft_worst(self._costs(tip), sharpness)

    def _costs(self, tip: AbstractContour) -> Array:
        """The cost of every case."""
        weights = () if callable(self.objective) else self.objective
        measured, own, lost = self.run(tip, tuple(name for name, _ in weights))
        return measured @ jnp.asarray([weight for _, weight in weights]) + own + _LOST * lost

    @property
    def merit(self) -> str:
        return _COST

    def figures(self, tip: AbstractContour, seen: ContourSamples) -> dict[str, Array]:
        # All measures are reported, those without a weight too.
        names = tuple(MEASURES)
        measured, own, lost = self.run(tip, names)
        weights = {} if callable(self.objective) else dict(self.objective)
        costs = measured @ jnp.asarray([weights.get(name, 0.0) for name in names]) + own + _LOST * lost
        found = {_COST: jnp.max(costs), _EARLY: jnp.sum(lost > 0.0)}
        # Of a run that ended where it began no state was saved.
        never = lost >= 1.0 - 2.0 * jnp.finfo(lost.dtype).eps
        for i, name in enumerate(names):
            # The largest value of all cases; NaN where one has none, as `jnp.max` passes NaN on.
            lacking = (lost > 0.0) if name in SETTLED else never
            found[MEASURES[name][1]] = jnp.max(jnp.where(lacking, jnp.nan, measured[:, i]))
        return found | {WORST_MARGIN: worst_margin(seen)}

    def reached(self, figures: dict[str, Array]) -> Bool[Array, "..."]:
        return figures[_EARLY] == 0


def _own(objective: Any, grasp: Any, run: Trajectory, early: Array) -> Array:
    """The caller's objective, if there is one; zero where it is NaN for a run that ended early.

    It need not know of such runs, and a NaN must not hide their cost, nor its gradient.
    """
    if isinstance(objective, tuple):  # measures
        return jnp.zeros((), run.ts.dtype)
    moving, still = eqx.partition((grasp, run), eqx.is_inexact_array)

    def asked(moving: Any) -> Array:
        return objective(*eqx.combine(moving, still))

    fixed = jax.lax.stop_gradient(moving)
    lacking = early & jnp.isnan(asked(fixed))
    # A derivative of NaN times the zero of a branch that is not chosen is NaN: backwards it ends here.
    held = jax.tree.map(lambda still, moves: jnp.where(lacking, still, moves), fixed, moving)
    return jnp.where(lacking, 0.0, asked(held))


def _as_objective(objective: Any) -> tuple[tuple[str, float], ...] | Callable:
    """The objective, checked: a function of a grasp and its run, or pairs of a measure and its weight."""
    if callable(objective):
        return check_callable("objective", objective, "a function of a grasp and its run", takes=2)
    if not isinstance(objective, Mapping) or not objective or set(objective) - set(MEASURES):
        raise ValueError(
            f"argument objective must be a function, or weights of {', '.join(MEASURES)}, "
            f"but was {shown(objective)}"
        )
    check_known("objective", dict(objective))
    weights = {name: as_floats(f"objective['{name}']", weight, ()) for name, weight in objective.items()}
    return tuple((name, float(weight)) for name, weight in weights.items())
