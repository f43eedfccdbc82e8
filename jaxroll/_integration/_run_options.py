"""What a run is told besides its grasp, its state and its times, kept until there are runs to tell it to.

`design.ClosedLoop` is made once and runs many times inside compiled programs. What its runs are told must
thus be hashable. It is checked when the goal is made, as far as that goes without a grasp; `simulate` checks
the rest. `why` checks what it is told even where it comes to no run.
"""

from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np

from .._motion import check_formulation, Formulation
from .._results import traced
from .._types import Given
from ._arguments import (
    as_number,
    as_numbers,
    check_choices,
    check_control,
    check_meter,
    check_solver,
    ProgressMeter,
    RECORDS,
    Solver,
    step_limit,
    StepSizeControl,
)
from ._events import EVENTS


class RunOptions(NamedTuple):
    """Arguments of `simulate`, by the same names; `record` may be None where its owner chooses it later."""

    t0: Given
    formulation: Formulation | None
    solver: Solver | None
    rtol: Given
    atol: Given | None
    dt0: Given
    max_steps: int
    events: Collection[str]
    stepsize_controller: StepSizeControl | None
    progress_meter: ProgressMeter | None
    record: Collection[str] | None

    def checked(self, t1: Any, ts: Any) -> "RunOptions":
        """The same with numbers of Python's and tuples of names, checked for a run with these times.

        Raises:
            ValueError: If one of them is not what it must be, or a number is being traced.
        """
        control, dtype = check_control(self.stepsize_controller), np.dtype(float)
        given = {"dt0": self.dt0, "rtol": self.rtol, "atol": self.atol}
        as_numbers(self.t0, t1, ts, **given, control=control, dtype=dtype)
        check_formulation(self.formulation)
        check_solver(self.solver)
        check_meter(self.progress_meter)
        return self._replace(
            t0=_known("t0", self.t0),
            rtol=_known("rtol", self.rtol),
            atol=None if self.atol is None else _known("atol", self.atol),
            dt0=_known("dt0", self.dt0),
            max_steps=step_limit(self.max_steps),
            events=check_choices("events", self.events, EVENTS),
            record=None if self.record is None else check_choices("record", self.record, RECORDS),
        )


def _known(name: str, value: Any) -> float:
    """One number as Python's own; raise for one without a value."""
    if traced(value):
        raise ValueError(f"argument {name} must be a known number here, but was being traced")
    return as_number(name, value, np.dtype(float)).item()
