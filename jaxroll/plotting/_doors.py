"""What every figure asks of its arguments: a run, or states, of its grasp, and a sensible look."""

import functools
import inspect
import os
from collections.abc import Callable
from typing import Any, cast, TypeVar

from matplotlib.axes import Axes

from .._analysis import check_run
from .._mechanics import check_states
from .._results import (
    as_count,
    as_floats,
    as_positive,
    check_callable,
    check_flag,
    check_instance,
    on_host,
    shown,
)
from ..design import Design
from ..geometry import Fit, SurfaceFit
from ._views3 import View

_Function = TypeVar("_Function", bound=Callable[..., Any])
# Largest side of a drawing [inch]: ten thousand pixels are beyond any screen.
_LARGEST = 100.0
_MOST = 5000


def guarded(figure: _Function) -> _Function:
    """Check a figure's arguments, by their names, before it is drawn; None only where it is the default.

    The figure gets numbers as Python's own, whatever library made them.
    """
    parameters = inspect.signature(figure).parameters
    names = tuple(parameters)
    optional = {name for name, parameter in parameters.items() if parameter.default is None}

    @functools.wraps(figure)
    def door(*args: Any, **options: Any) -> Any:
        # By name, however they were given; of an argument too many the call of `figure` complains itself.
        given = dict(zip(names, args, strict=False)) | options
        grasp: Any = given.get("grasp")
        if "trajectory" in given:
            check_run(grasp, given["trajectory"])
        if "state" in given:
            check_states(grasp, given["state"])
        left_out = {name for name in optional if given.get(name) is None}
        if "rest" in given and "rest" not in left_out:
            check_states(grasp, given["rest"], "rest")
        for name, taken in _TAKEN.items():
            if name in given and name not in left_out:
                given[name] = taken(name, given[name])
        placed = [given[name] for name in names[: len(args)]]
        return figure(*placed, *args[len(names) :], **{name: given[name] for name in options})

    return cast(_Function, on_host(door))


def _number(name: str, value: Any) -> float:
    return float(as_floats(name, value, ()))


def _positive(name: str, value: Any) -> float:
    return float(as_positive(name, value))


def _size(name: str, value: Any) -> float:
    size = _number(name, value)
    if not 0.0 < size <= _LARGEST:
        raise ValueError(f"argument {name} must be positive and at most {_LARGEST:g}, but was {shown(size)}")
    return size


def _times(name: str, value: Any) -> list[float]:
    times = as_floats(name, value, (None,)).tolist()
    if not times:
        raise ValueError(f"argument {name} must be one time or more, but there was none")
    return times


def _text(name: str, value: Any) -> str:
    return check_instance(name, value, str, "text")


def _place(name: str, value: Any) -> Any:
    if not isinstance(value, str | os.PathLike) or not str(value) or "\0" in str(value):
        raise ValueError(f"argument {name} must be the name of a file or folder, but was {shown(value)}")
    return value


# For each name of an argument a function that takes the name and the value, and returns the value that the
# figure gets or raises.
_TAKEN: dict[str, Callable[[str, Any], Any]] = {
    "design": lambda name, value: check_instance(name, value, Design, "a Design"),
    "fit": lambda name, value: check_instance(name, value, (Fit, SurfaceFit), "a Fit or a SurfaceFit"),
    "ax": lambda name, value: check_instance(name, value, Axes, "an axes of matplotlib"),
    "view": lambda name, value: check_instance(name, value, View, "a View"),
    "forces": check_flag,
    "fps": _positive,
    "speed": _positive,
    "until": _number,
    "size": _size,
    "times": _times,
    "title": _text,
    "label": _text,
    "frames": as_count,
    "progress": lambda name, value: check_callable(name, value, takes=2),
    "path": _place,
    "folder": _place,
}


def check_frames(name: str, count: float) -> None:
    """Raise where an argument asks for more frames than anyone looks at."""
    if not count <= _MOST:
        raise ValueError(f"argument {name} must leave at most {_MOST} frames, but asks for {count:.3g}")
