"""What every figure of a grasp asks of its arguments: a run, or states, that could be of this grasp."""

import functools
import inspect
from collections.abc import Callable
from typing import Any, cast, TypeVar

from ..integration import check_run
from ..mechanics import check_states

Door = TypeVar("Door", bound=Callable[..., Any])


def of_grasp(figure: Door) -> Door:
    """Check a figure's `grasp`, and its `trajectory`, `state` and `rest` against it, before it is drawn."""
    names = tuple(inspect.signature(figure).parameters)

    @functools.wraps(figure)
    def door(*args: Any, **options: Any) -> Any:
        given = dict(zip(names, args, strict=False)) | options
        grasp: Any = given.get("grasp")
        if "trajectory" in given:
            check_run(grasp, given["trajectory"])
        if "state" in given:
            check_states(grasp, given["state"], axes=1)
        if given.get("rest") is not None:
            check_states(grasp, given["rest"], "rest")
        return figure(*args, **options)

    return cast(Door, door)
