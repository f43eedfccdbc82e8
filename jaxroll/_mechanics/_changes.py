"""`Grasp.with_`: a copy of a grasp with other values in fields of its own, its controller's or its object's.

A new value goes through the same converter as in the constructor, and checks that depend on several fields
are repeated. `equinox.tree_at`, which makes the copy, would run neither.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx

from .._fields import converter_of, taken
from .._results import as_floats

# Fields on which the check of the contacts depends: it is repeated when one of them changes.
_PARTS = frozenset(("object", "fingers", "contacts", "contours", "surfaces"))
# The same for the check of what acts on the bodies.
_ACTED = frozenset(("controller", "fingers", "contacts", "gravity", "load", "target", "start"))


def changed(grasp: Any, changes: Mapping[str, Any]) -> Any:
    """A copy of a grasp with other values of some fields, by name; later names see the earlier changes."""
    copy = grasp
    for name, value in changes.items():
        owner = _owner(copy, name)
        value = _taken_by(owner(copy), name, value)
        copy = eqx.tree_at(
            lambda g, o=owner, n=name: getattr(o(g), n),
            copy,
            value,
            is_leaf=lambda x: x is None,
        )
        _check_again(owner(copy))
    if _PARTS & set(changes):
        copy._check_parts()
    if _ACTED & set(changes):
        copy._check_actions()
    return copy


def _owner(grasp: Any, name: str) -> Any:
    """A function from a grasp to the one part of it that has the field; raise unless there is just one."""
    places = [lambda g: g, lambda g: g.controller, lambda g: g.object]
    # A law inside another controller, as inside `control.Sampled`, is asked too.
    inside = places[1]
    while isinstance(getattr(inside(grasp), "law", None), eqx.Module):
        inside = lambda g, outer=inside: outer(g).law  # noqa: E731
        places.append(inside)
    found = [place for place in places if _has_field(place(grasp), name)]
    if len(found) != 1:
        owners = f"{len(found)} have it" if found else "none has it"
        raise ValueError(
            f"argument {name} must name one field of the grasp, its controller or its object, but {owners}"
        )
    return found[0]


def _taken_by(owner: Any, name: str, value: Any) -> Any:
    """A new value for a field of a grasp, its object or its controller, converted as by the constructor."""
    # The shape to ask for is the old array's.
    old = getattr(owner, name)
    shape = old.shape if eqx.is_array(old) else None
    if converter_of(owner, name) is not None:
        return taken(owner, name, value, shape=shape)
    # A caller's own class: an array stays an array of its shape.
    return value if shape is None else as_floats(name, value, shape)


def _check_again(owner: Any) -> None:
    """Run `__check_init__` of all classes of a module, which equinox calls only after a constructor."""
    for kind in type(owner).__mro__:
        if "__check_init__" in vars(kind):
            vars(kind)["__check_init__"](owner)


def _has_field(owner: Any, name: str) -> bool:
    return name in getattr(type(owner), "__dataclass_fields__", {})
