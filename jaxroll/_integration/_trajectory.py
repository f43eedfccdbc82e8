"""The result of a run. `_simulate` makes a `Trajectory`, `_report` prints it."""

from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from .._mechanics import Labels, State
from .._motion import Energy, Multipliers, Residuals
from .._printing import code_name, listed
from .._results import concrete, RESULTS
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
