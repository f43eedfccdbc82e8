"""Fields with a converter: what is given for one is converted and checked in one place.

A class says at its fields what may be there; its constructor and `Grasp.with_` both take values through
`taken`, so that neither lets in what the other refuses.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ._closures import as_tree
from ._results import as_array, as_floats, check_callable, is_array_like, is_foreign, shown, traceable, traced
from ._types import Given
from ._xla import in_arithmetic

Check = Callable[[str, jax.Array], jax.Array]
Shape = tuple[int | None, ...]
# From the argument's name, the value and the shape wanted to what is kept.
Converter = Callable[[str, Any, Shape | None], Any]

# What a field of `command` holds: an array, or a function of time that returns one. Laws compute with what
# `held` returns, in which there are arrays alone.
Commanded = Any
# What a constructor takes for such a field.
Command = Given | Callable[[Any], Any]

# Equinox keeps "converter" for its own, which knows no names of arguments.
_CONVERTER = "named converter"


def real(*shape: int | None, check: Check | None = None, optional: bool = False) -> Any:
    """A field for finite real numbers of a shape, where None matches any length.

    Args:
        *shape: Lengths of the axes; none for one number.
        check: What must hold besides, such as `check_positive`.
        optional: Whether None may stand for an array.
    """

    def converted(name: str, value: Any, wanted: Shape | None) -> Any:
        if value is None and optional:
            return None
        array = as_floats(name, value, shape if wanted is None else wanted)
        return array if check is None else check(name, array)

    return eqx.field(metadata={_CONVERTER: converted})


def command(*shape: int | None, check: Check | None = None, each_finger: bool = False) -> Any:
    """A field for what `real` or `each` takes, or for a function of time that returns it.

    `held` puts numbers in the place of functions. Of what these return only the shape is checked.
    """
    numbers = (each(check) if each_finger else real(*shape, check=check)).metadata[_CONVERTER]

    def converted(name: str, value: Any, wanted: Shape | None) -> Any:
        if not is_command(value):
            return numbers(name, value, wanted)
        function = as_tree(name, check_callable(name, value, "numbers or a function of time", takes=1))
        own = shape if wanted is None or each_finger else wanted
        given = f"{name}, in what it returns,"
        found = shape_returned(function, given)
        if each_finger and not found:  # one number for all fingers
            return function
        own = (None,) if each_finger else own
        if len(found) != len(own) or any(n not in (None, m) for n, m in zip(own, found, strict=True)):
            shown_shape = str(own).replace("None", "any")
            raise ValueError(f"argument {given} must have shape {shown_shape}, but had shape {found}")
        return function

    return eqx.field(metadata={_CONVERTER: converted})


def is_command(value: Any) -> bool:
    """Whether a value is a function of time in the place of numbers."""
    return callable(value) and not isinstance(value, type) and not is_array_like(value)


def shape_returned(function: Callable[[Any], Any], name: str = "t") -> tuple[int, ...]:
    """Shape of what a function of time returns; raise unless that is real numbers."""
    with traceable(name):
        return jax.eval_shape(lambda t: as_array(name, function(t)), jnp.zeros(())).shape


def shape_of(given: Any) -> tuple[int, ...]:
    """Shape of numbers, or of what a function of time returns."""
    return shape_returned(given) if is_command(given) else given.shape


def changes_in_time(owner: Any, *names: str) -> bool:
    """Whether one of these numbers is a function of time.

    A controller whose numbers change has no potential: the whole power of its torques counts as work.
    """
    return any(is_command(getattr(owner, name)) for name in names)


def held(owner: Any, t: Any) -> Any:
    """A module with its commands at one time: numbers where it has functions; itself if it has none."""
    names = [f.name for f in dataclasses.fields(owner) if is_command(getattr(owner, f.name))]
    if not names:
        return owner
    values = [as_array(name, in_arithmetic(name, getattr(owner, name), t)) for name in names]
    return eqx.tree_at(lambda o: [getattr(o, name) for name in names], owner, values)


def each(check: Check | None = None) -> Any:
    """A field for one finite real number per finger, or one number that stands for all."""

    def converted(name: str, value: Any, wanted: Shape | None) -> Any:
        array = as_array(name, value)
        if array.ndim == 0 and wanted is not None:
            array = jnp.full(wanted, array)
        array = as_floats(name, array, (None,) if wanted is None else wanted)
        return array if check is None else check(name, array)

    return eqx.field(metadata={_CONVERTER: converted})


def through(convert: Callable[[str, Any], Any], *, static: bool = False) -> Any:
    """A field whose values a function of name and value converts, or refuses."""
    return eqx.field(static=static, metadata={_CONVERTER: lambda name, value, wanted: convert(name, value)})


def converter_of(owner: Any, name: str) -> Converter | None:
    """The converter of a field; None if its class, perhaps a caller's own, has not given it one."""
    return type(owner).__dataclass_fields__[name].metadata.get(_CONVERTER)


def taken(owner: Any, field: str, value: Any, *, shape: Shape | None = None, name: str | None = None) -> Any:
    """What a caller gave for a field of a module, converted and checked.

    Args:
        owner: The module, finished or not.
        field: The field's name.
        value: What the caller gave.
        shape: Shape wanted, where the field's own leaves it open.
        name: What the caller calls the argument. Default: as the field.
    """
    converter = converter_of(owner, field)
    assert converter is not None, f"{type(owner).__name__}.{field} has no converter"
    return converter(name or field, value, shape)


def check_module(name: str, module: eqx.Module) -> None:
    """Raise for what went past the converters into a module, as `equinox.tree_at` lets it.

    Fields with a converter are converted once more. In the others of jaxroll's own classes, such as contours,
    arrays must be real, without NaN, and of the shape declared; of a caller's own classes nothing is known.
    """
    own = not is_foreign(module)
    for field in dataclasses.fields(module):
        value, place = getattr(module, field.name), f"{name}.{field.name}"
        if converter_of(module, field.name) is not None:
            taken(module, field.name, value, name=place)
        elif own and not field.metadata.get("static"):
            _check_leaves(place, value)
            _check_shape(place, value, field.type)
        several = isinstance(value, tuple)
        for i, part in enumerate(value if several else (value,)):
            if isinstance(part, eqx.Module):
                check_module(f"{place}[{i}]" if several else place, part)


def _check_leaves(name: str, tree: Any) -> None:
    """Raise for arrays that are not real or hold NaN; modules inside answer for themselves."""
    for leaf in jax.tree.leaves(tree, is_leaf=lambda x: isinstance(x, eqx.Module)):
        odd = isinstance(leaf, str | bytes | complex)
        if is_array_like(leaf):
            odd = leaf.dtype.kind not in "iufV" or leaf.dtype.kind == "f" and _has_nan(leaf)
        if odd:
            raise ValueError(f"argument {name} must be real numbers, but was {shown(leaf)}")


def _has_nan(array: Any) -> bool:
    return not traced(array) and bool(np.isnan(np.asarray(array)).any())


def _check_shape(name: str, value: Any, wanted: Any) -> None:
    """Raise unless a value is of the class and shape that its field is annotated with, or a plain number."""
    kinds = get_args(wanted) or (wanted,)
    if isinstance(value, np.ndarray | np.generic):
        value = jnp.asarray(value)  # as `jax.device_get` leaves them
    # `Any` is a class, of which nothing is an instance.
    plain = Any in kinds or isinstance(value, int | float) and not isinstance(value, bool)
    if not plain and all(isinstance(kind, type) for kind in kinds) and not isinstance(value, kinds):
        raise ValueError(
            f"argument {name} must be of the shape its class declares, but was {shown(value)}: one of "
            "many grasps, which run by `jax.vmap` of a function of one of them?"
        )
