"""Checks of arguments that several scenes share."""

from typing import Any

from jaxtyping import Array

from .._results import check_instance, concrete, shown, told_apart


def as_pair(name: str, value: Any, kind: type, what: str) -> tuple[Any, Any]:
    """Two shapes, or one that serves twice."""
    pair = tuple(value) if isinstance(value, tuple | list) else (value, value)
    if len(pair) != 2:
        raise ValueError(f"argument {name} must be {what}, but was {shown(value)}")
    for one in pair:
        check_instance(name, one, kind, what)
    return pair[0], pair[1]


def check_below(name: str, value: Array, other: str, bound: Array) -> None:
    """Raise unless a concrete value is smaller than another argument."""
    seen, most = concrete(value), concrete(bound)
    if seen is not None and most is not None and not seen < most:
        limit, was = told_apart(most, seen)
        raise ValueError(f"argument {name} must be smaller than {other}, {limit}, but was {was}")
