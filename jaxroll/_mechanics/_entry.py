"""What every public function of a grasp lets in: a grasp whose fields are sound, and states of it."""

import functools
import inspect
from collections.abc import Callable
from typing import Any, cast, TypeVar

import equinox as eqx

from .._fields import check_module, taken
from .._results import as_array, check_finite, check_instance
from .._xla import remembered
from ._grasp import Grasp
from ._state import check_shapes, State

_Function = TypeVar("_Function", bound=Callable[..., Any])
# Names under which functions of a grasp take its states, and how many axes may lead: that of time.
_STATES = {"state": 0, "guess": 0, "states": 1}


def check_grasp(grasp: Any) -> None:
    """Raise unless a grasp is given, and one whose fields its constructors would have taken."""
    check_instance("grasp", grasp, Grasp, "a Grasp")
    _check_fields(grasp)


@remembered
def _check_fields(grasp: Grasp) -> None:
    check_module("grasp", grasp)
    taken(grasp, "gravity", grasp.gravity, shape=(grasp._axes,), name="grasp.gravity")


def check_planar(grasp: Grasp) -> None:
    """Raise for a grasp in space, where only the plane has an answer."""
    check_grasp(grasp)
    if grasp.spatial:
        raise ValueError("argument grasp must live in the plane, but its contacts are those of space")


def check_spatial(grasp: Grasp) -> None:
    """Raise for a grasp in the plane, where only space has an answer."""
    check_grasp(grasp)
    if not grasp.spatial:
        raise ValueError("argument grasp must live in space, but its contacts are those of the plane")


def check_states(grasp: Any, states: Any, name: str = "state", *, axes: int = 0) -> None:
    """Raise unless a grasp is given, and a finite state, or several along leading axes, that fit it."""
    check_grasp(grasp)
    check_instance(name, states, State, "a State")
    check_shapes(states, grasp.form, name, axes)
    if not axes:  # of several, some may be times that a run did not reach
        for part in "qvs":
            check_finite(f"{name}.{part}", getattr(states, part))


def _finite_times(name: str, value: Any) -> Any:
    """Argument `ts` as an array of finite times; another argument as it is."""
    return check_finite("ts", as_array("ts", value)) if name == "ts" else value


def compiled(function: _Function) -> _Function:
    """`equinox.filter_jit` for functions of a grasp, whose tables are built before, once for all of them.

    Before anything is traced it refuses what is no grasp, states that are not of this grasp, and times `ts`
    that are not finite numbers.
    """
    jitted = eqx.filter_jit(function)
    names = tuple(inspect.signature(function).parameters)
    places = [(names.index(name) - 1, name) for name in _STATES if name in names]

    @functools.wraps(function)
    def door(grasp: Grasp, *args: Any, **options: Any) -> Any:
        check_grasp(grasp)
        for at, name in places:
            if at < len(args) or name in options:
                given = options[name] if name in options else args[at]
                check_states(grasp, given, name, axes=_STATES[name])
        args = tuple(_finite_times(name, x) for name, x in zip(names[1:], args, strict=False))
        options = {name: _finite_times(name, x) for name, x in options.items()}
        return jitted(grasp.tabled(), *args, **options)

    return cast(_Function, door)
