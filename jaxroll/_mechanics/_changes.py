"""`Grasp.with_`: a copy of a grasp in which fields of it, of its controller or of its object are others.

What is given goes through the same converters as in the constructors, and what depends on several fields is
looked at again.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx

from .._fields import converter_of, taken
from .._results import as_floats

# What a contact's start lies on: with one of these changed it is looked at again.
_PARTS = frozenset(("object", "fingers", "contacts", "contours", "surfaces"))


def changed(grasp: Any, changes: Mapping[str, Any]) -> Any:
    """A copy of a grasp with other values of some fields, by name."""
    copy = grasp
    for name, value in changes.items():
        owner = _owner(copy, name)
        value = _taken_by(owner(copy), name, value, copy._axes)
        copy = eqx.tree_at(
            lambda g, o=owner, n=name: getattr(o(g), n),
            copy,
            value,
            is_leaf=lambda x: x is None,
        )
        _check_again(owner(copy))
    if _PARTS & set(changes):
        copy._check_parts()
    if {"controller", "fingers", "contacts"} & set(changes):
        copy._check_controller()
    return copy


def _owner(grasp: Any, name: str) -> Any:
    """From a grasp to that part of it which has the field; raise unless it is just one."""
    places = {
        "grasp": lambda g: g,
        "controller": lambda g: g.controller,
        "object": lambda g: g.object,
    }
    found = [place for place in places.values() if _has_field(place(grasp), name)]
    if len(found) != 1:
        raise ValueError(
            f"argument {name} must name one field of the grasp, its controller or its object, "
            f"but {len(found)} have it"
        )
    return found[0]


def _taken_by(owner: Any, name: str, value: Any, axes: int) -> Any:
    """What is given for a field of a grasp, its object or its controller, as the constructor takes it."""
    old = getattr(owner, name)
    shape = old.shape if eqx.is_array(old) else None
    if name == "gravity" and shape is None:
        shape = (axes,)
    if converter_of(owner, name) is not None:
        return taken(owner, name, value, shape=shape)
    # A caller's own class: an array stays an array of its shape.
    return value if shape is None else as_floats(name, value, shape)


def _check_again(owner: Any) -> None:
    """The checks of a caller's own class, which equinox runs after its constructor alone."""
    for kind in type(owner).__mro__:
        if "__check_init__" in vars(kind):
            vars(kind)["__check_init__"](owner)


def _has_field(owner: Any, name: str) -> bool:
    return name in getattr(type(owner), "__dataclass_fields__", {})
