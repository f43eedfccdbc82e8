"""Checks that public functions make of a grasp and its states, before anything is traced.

The constructors check what they are given, but `equinox.tree_at` and `jax.tree.map` put other values into a
grasp without them. `compiled` wraps a function of a grasp with these checks, and has it compiled.
"""

import functools
import inspect
from collections.abc import Callable
from typing import Any, cast, TypeVar

import equinox as eqx
import jax
import numpy as np

from .._fields import check_module
from .._results import as_array, check_finite, check_instance, concrete, shown
from .._xla import quickly, remembered, uncollected
from ..contact import Contact, Contact3
from ._grasp import Grasp, tabled_grasp
from ._object3 import FreeObject3
from ._state import check_shapes, State

_Function = TypeVar("_Function", bound=Callable[..., Any])
# Names of the arguments that are states, and how many leading axes each may have (one: time).
_STATES = {"state": 0, "guess": 0, "states": 1}
# States and times with at most this many numbers count as few.
_FEW = 256
# By how much the length of a quaternion may differ from one: four decimals, or a step of differences.
_UNIT = 1e-4


def check_grasp(grasp: Any) -> None:
    """Raise unless a grasp is given, and one whose fields its constructors would have taken."""
    check_instance("grasp", grasp, Grasp, "a Grasp")
    _check_fields(grasp)


@remembered  # a grasp never changes: one that passed is not looked at again
def _check_fields(grasp: Grasp) -> None:
    check_module("grasp", grasp)
    grasp._check_actions()


def check_planar(grasp: Grasp) -> None:
    """Raise for a grasp in space or with contacts of one's own, where only contours have an answer."""
    check_grasp(grasp)
    if grasp.spatial:
        raise ValueError("argument grasp must live in the plane, but its contacts are those of space")
    _check_kind(grasp, Contact)


def check_spatial(grasp: Grasp) -> None:
    """Raise for a grasp in the plane or with contacts of one's own, where only surfaces have an answer."""
    check_grasp(grasp)
    if not grasp.spatial:
        raise ValueError("argument grasp must live in space, but its contacts are those of the plane")
    _check_kind(grasp, Contact3)


def as_grasp_and_state(given: Any) -> tuple[Grasp, State]:
    """The grasp and the state that a caller's `make` returned; raise if it returned anything else."""
    pair = given if isinstance(given, tuple | list) else ()
    if len(pair) != 2 or not isinstance(pair[0], Grasp) or not isinstance(pair[1], State):
        raise ValueError(f"argument make must return a Grasp and a State, but returned {shown(given)}")
    return pair[0], pair[1]


def _check_kind(grasp: Grasp, kind: type) -> None:
    for i, contact in enumerate(grasp.contacts):
        if not isinstance(contact, kind):
            raise ValueError(
                f"argument grasp must have contacts of class {kind.__name__}, "
                f"but contacts[{i}] was a {type(contact).__name__}"
            )


def check_states(grasp: Any, states: Any, name: str = "state", *, axes: int = 0, unit: bool = True) -> None:
    """Raise unless a grasp is given, and a finite state, or several along leading axes, that fit it.

    With `unit`, quaternions must have unit length; what closes a guess scales them by itself.
    """
    check_grasp(grasp)
    check_instance(name, states, State, "a State")
    check_shapes(states, grasp.form, name, axes)
    if not axes:  # of several, some may be times that a run did not reach
        for part in "qvs":
            check_finite(f"{name}.{part}", getattr(states, part))
    if unit and isinstance(grasp.object, FreeObject3):
        _check_turned(f"{name}.q", states.q)


def _check_turned(name: str, q: Any) -> None:
    """Raise for quaternions that are not of unit length: by them an object would be bent, not turned."""
    known = concrete(q)
    if known is None:
        return
    length = np.linalg.norm(known[..., 3:7], axis=-1)
    if (np.abs(length - 1.0) > _UNIT).any():  # false for NaN, of times that were not reached
        worst = float(length.flat[np.nanargmax(np.abs(length - 1.0))])
        raise ValueError(
            f"argument {name} must hold a unit quaternion in q[3:7], but its length was {worst:.6g}"
        )


def _finite_times(name: str, value: Any) -> Any:
    """Argument `ts` as an array, checked to be finite; any other argument unchanged."""
    return check_finite("ts", as_array("ts", value)) if name == "ts" else value


def compiled(function: _Function) -> _Function:
    """`quickly` for a function whose first argument is a grasp.

    Before anything is traced it refuses what is no grasp, states that are not of this grasp, and times `ts`
    that are not finite numbers. It also builds the grasp's tables (`tabled_grasp`), which are then kept for
    all functions that are called with this grasp.
    """
    return _guarded(function, quickly(function))


def compiled_for_many(function: _Function) -> _Function:
    """`compiled` for a function of one state or of many; for many it is fully optimised."""
    few, many = quickly(function), eqx.filter_jit(function)

    def called(grasp: Grasp, *args: Any, **options: Any) -> Any:
        given = sum(np.size(leaf) for leaf in jax.tree.leaves((args, options)) if eqx.is_array_like(leaf))
        return (few if given <= _FEW else many)(grasp, *args, **options)

    return _guarded(function, called)


def _guarded(function: _Function, jitted: Callable[..., Any]) -> _Function:
    """A function of a grasp as `compiled` says, given its compiled form."""
    names = tuple(inspect.signature(function).parameters)
    # Less one, for the grasp itself is not among `args`.
    places = [(names.index(name) - 1, name) for name in _STATES if name in names]

    @functools.wraps(function)
    def door(grasp: Grasp, *args: Any, **options: Any) -> Any:
        check_grasp(grasp)
        for at, name in places:
            if at < len(args) or name in options:
                given = options[name] if name in options else args[at]
                check_states(grasp, given, name, axes=_STATES[name], unit=name != "guess")
        # Arguments beyond the function's own are passed on: `jitted` refuses them.
        known = [_finite_times(name, x) for name, x in zip(names[1:], args, strict=False)]
        args = (*known, *args[len(known) :])
        options = {name: _finite_times(name, x) for name, x in options.items()}
        with uncollected():
            return jitted(tabled_grasp(grasp), *args, **options)

    return cast(_Function, door)
