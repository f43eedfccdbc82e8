"""The result of a run: `_simulate` makes a `Trajectory`, `_report` prints it, `check_one_run` checks one."""

from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from .._mechanics import Labels, State
from .._motion import Energy, Multipliers, Residuals
from .._printing import code_name, listed
from .._results import check_instance, concrete, is_array_like, RESULTS, shown
from .._types import Times
from ._report import batch_report, report


class Stats(eqx.Module):
    """How the run went.

    Attributes:
        steps: Attempted steps.
        accepted: Accepted steps.
        rejected: Rejected steps.
        t_end: Time that the run reached [s].
        contact: Which contact ended it, or in case of 'penetration' which finger; -1 where none did.
        margin: What ran out there, at the end: normal force or distance to the friction cone [N], distance to
            the end of a contour or to the object [m], or what the relative sum of curvatures has beyond 1e-4;
            NaN where nothing did.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"t_end": "s"}

    steps: Int[Array, ""]
    accepted: Int[Array, ""]
    rejected: Int[Array, ""]
    t_end: Float[Array, ""]
    contact: Int[Array, ""]
    margin: Float[Array, ""]


class Trajectory(eqx.Module):
    """States at the saved times, with what is needed to judge them.

    Under `vmap` every leaf gains a leading axis, `result` included: one code per lane. Rows after
    the end of a failed run hold NaN; `last` is the final state it reached in any case. Printed, it says how
    the run went: where it ended early which contact ended it, when, by how much, and what helps.

    Attributes:
        ts: Shape (t,), saved times [s].
        states: `State` with leading axis t.
        last: `State` where the run ended.
        residuals: Constraint residuals at the saved times.
        result: Result code of `jaxroll.RESULTS`.
        stats: Steps taken, how far, and what ended it.
        multipliers: Contact forces at the saved times, if recorded.
        energy: Energy balance at the saved times, if recorded.
        labels: What its bodies, coordinates (with units) and contacts are called. Static.
    """

    ts: Times
    states: State
    last: State
    residuals: Residuals
    result: RESULTS
    stats: Stats
    multipliers: Multipliers | None = None
    energy: Energy | None = None
    labels: Labels | None = eqx.field(static=True, default=None)

    def __str__(self) -> str:
        if concrete(self.stats.steps) is None:
            return "Trajectory (being traced)"
        return batch_report(self) if np.ndim(self.stats.steps) else report(self)

    def __repr__(self) -> str:
        shape = getattr(getattr(self.states, "q", None), "shape", ())
        return f"Trajectory({code_name(self.result)}; {' x '.join(map(str, shape[:-1])) or 'no'} states)"


def check_one_run(name: str, run: Any) -> None:
    """Raise unless an argument is one run and not a batch, with a state for each of its times, one or more.

    It need not be what `simulate` returned: `jax.tree.map` and `equinox.tree_at` put anything into a pytree.
    """
    check_instance(name, run, Trajectory, "a Trajectory")
    parts: dict[str, Any] = {"ts": run.ts} | {
        f"states.{part}": getattr(run.states, part, None) for part in "qvs"
    }
    for part, value in parts.items():
        if not is_array_like(value) or value.dtype.kind != "f":
            raise ValueError(f"argument {name} must hold real numbers as {part}, but had {shown(value)}")
    shape, count = run.states.q.shape, np.size(run.ts)
    if run.ts.ndim != 1 or len(shape) != 2:
        raise ValueError(
            f"argument {name} must be one run, but its states have shape {shape}; "
            f"take one lane with jax.tree.map(lambda x: x[i], {name})"
        )
    if not count or any(value.shape[:1] != (count,) for value in parts.values()):
        raise ValueError(
            f"argument {name} must hold a state for each of its times, one or more, but was of shapes "
            f"{shown([value.shape for value in parts.values()])}"
        )
