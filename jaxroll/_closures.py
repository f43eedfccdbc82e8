"""A caller's function, with what it closes over as leaves where JAX is tracing that.

To JAX a plain function is structure, and arrays that it closes over are constants of a program. But a gain
or a radius in which a derivative is taken, or which a batch varies, is no constant. A law such as
`lambda t, angles, rates, tips: tuple(-gain * rate for rate in rates)` then hides a traced number from runs
and tables, which are compiled as programs of their own. `opened` makes the law a pytree that shows the
number. Functions that hide nothing stay as they are. Fields that take functions, and the check of
controllers, call this.

The number may stand in a function inside, in bound arguments, or in an attribute of an object: one with a
method `__call__`, one whose method is the function, or one that the function closes over. When such a pytree
is called, all of these are made again, as the functions and objects they were, with the numbers of that call.
"""

import abc
import functools
import types
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ._results import shown, traced

_JITTED = type(jax.jit(abs))
# At most so many objects and functions are looked into for one function: what refers to more is no mere law.
_MOST = 256
# What callers' functions hold, as fingerprints (`_sweep.as_now`): JAX traces a function anew where this is
# another. It is made here, in a module that everything loads: once there is one more such context, JAX finds
# none of the programs again that it compiled before.
HELD: Any = jax.make_user_context(default_value=None)


def as_tree(name: str, function: Any) -> Callable[..., Any]:
    """A callable as a pytree: itself if it is one, a plain function as structure."""
    if not callable(function):
        raise ValueError(f"argument {name} must be a function, but was {shown(function)}")
    function = opened(function)
    return jax.tree_util.Partial(function) if jax.tree_util.all_leaves([function]) else function


def opened(function: Any) -> Any:
    """The function; a pytree in its place if it hides traced arrays: in closure, defaults or attributes.

    The same is done to the functions and objects that it closes over, to the bound arguments of a
    `functools.partial`, to the object of a method, and to what `jax.jit` wraps.
    """
    return _opened(function, {})


def _opened(value: Any, seen: dict[int, Any]) -> Any:
    """The same for any pytree, whose leaves may be functions or objects; `seen` has those already opened."""
    try:
        return jax.tree.map(lambda leaf: _opened_leaf(leaf, seen), value, is_leaf=_is_function)
    except (TypeError, ValueError):  # JAX cannot flatten it, such as a dictionary whose keys have no order
        return value


def _is_function(value: Any) -> bool:
    return isinstance(value, types.FunctionType | functools.partial)


def _opened_leaf(leaf: Any, seen: dict[int, Any]) -> Any:
    if id(leaf) in seen:
        return seen[id(leaf)][1]
    kind = _opener(leaf)
    if kind is None or len(seen) >= _MOST:
        return leaf
    # Where it is met within itself it stays as it is. `seen` holds it, so that no other object gets its `id`.
    seen[id(leaf)] = (leaf, leaf)
    found = kind(leaf, seen)
    seen[id(leaf)] = (leaf, found)
    return found


def _opener(leaf: Any) -> Callable[[Any, dict[int, Any]], Any] | None:
    """What opens a leaf of this kind; None for numbers, text, classes, modules and what has no attributes."""
    if isinstance(leaf, types.FunctionType):
        return _opened_function
    if isinstance(leaf, functools.partial | types.MethodType):
        return _opened_bound
    if isinstance(leaf, type | types.ModuleType | np.ndarray | jax.Array):
        return None
    if isinstance(leaf, _JITTED):
        return _opened_jitted
    return _opened_object if hasattr(leaf, "__dict__") else None


def _opened_bound(leaf: Any, seen: dict[int, Any]) -> Any:
    """A `functools.partial`, or a method of an object."""
    method = isinstance(leaf, types.MethodType)
    whole = (leaf.__func__, (leaf.__self__,), {}) if method else (leaf.func, leaf.args, leaf.keywords)
    inner, args, named = _opened(whole, seen)
    return _Bound(inner, args, named) if traced((inner, args, named)) else leaf


def _opened_jitted(leaf: Any, seen: dict[int, Any]) -> Any:
    """What `jax.jit` made of a function: the function itself, where that hides anything."""
    inner = _opened(leaf.__wrapped__, seen)
    return inner if traced(inner) else leaf


def _opened_function(leaf: Any, seen: dict[int, Any]) -> Any:
    closure = leaf.__closure__ or ()
    parts = {i: _opened(cell.cell_contents, seen) for i, cell in enumerate(closure) if _full(cell)}
    found = {i: part for i, part in parts.items() if traced(part)}
    defaults = _opened((leaf.__defaults__, leaf.__kwdefaults__), seen)
    if not found and not traced(defaults):
        return leaf
    cells = [None if i in found else cell for i, cell in enumerate(closure)]
    kept = defaults if traced(defaults) else None
    return _Opened(found, kept, _Frame(leaf, tuple(cells), kept is not None))


def _opened_object(leaf: Any, seen: dict[int, Any]) -> Any:
    parts = {name: _opened(part, seen) for name, part in vars(leaf).items()}
    found = {name: part for name, part in parts.items() if traced(part)}
    others = {name: part for name, part in vars(leaf).items() if name not in found}
    return _Object(found, _Rest(type(leaf), others)) if found else leaf


def _full(cell: Any) -> bool:
    """Whether a variable of a closure has a value yet, and one other than None."""
    try:
        return cell.cell_contents is not None
    except ValueError:
        return False


def _closed(value: Any) -> Any:
    """A pytree in which everything that was opened is made again."""
    made = lambda part: part.made() if isinstance(part, AbstractOpened) else part  # noqa: E731
    return jax.tree.map(made, value, is_leaf=lambda part: isinstance(part, AbstractOpened))


def _same(mine: list[Any], theirs: list[Any]) -> bool:
    """Whether these are the same objects one by one."""
    return len(mine) == len(theirs) and all(a is b for a, b in zip(mine, theirs, strict=True))


class _Frame:
    """All of a function but what is traced; equal if code, module and the other variables are the same."""

    def __init__(self, function: types.FunctionType, cells: tuple[Any, ...], without_defaults: bool) -> None:
        self.code, self.space, self.name = function.__code__, function.__globals__, function.__name__
        self.cells = cells
        self.defaults = None if without_defaults else (function.__defaults__, function.__kwdefaults__)

    def function(self, found: dict[int, Any], defaults: Any) -> Callable[..., Any]:
        """The function with these values of the variables that were left out."""
        cells = tuple(types.CellType(found[i]) if cell is None else cell for i, cell in enumerate(self.cells))
        by_place, by_name = defaults if self.defaults is None else self.defaults
        made = types.FunctionType(self.code, self.space, self.name, by_place, cells)
        made.__kwdefaults__ = by_name
        return made

    @property
    def __wrapped__(self) -> Callable[..., Any]:
        """The function without what is traced: what a fingerprint takes this for.

        Of the module it then reads what the code does, not all that a notebook has defined by now.
        """
        return self.function(dict.fromkeys(range(len(self.cells))), (None, None))

    def _others(self) -> list[Any]:
        held = [cell.cell_contents if _full(cell) else None for cell in self.cells if cell is not None]
        by_place, by_name = self.defaults or ((), {})
        return [self.space, *held, *(by_place or ()), *(by_name or {}).values()]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Frame) or self.code != other.code or len(self.cells) != len(other.cells):
            return False
        return _same(self._others(), other._others())

    def __hash__(self) -> int:
        return hash(self.code)


class _Rest:
    """All of an object but what is traced; equal if class and the other attributes are the same."""

    def __init__(self, kind: type, others: dict[str, Any]) -> None:
        self.kind, self.others = kind, others

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Rest) or self.kind is not other.kind:
            return False
        return self.others.keys() == other.others.keys() and _same(
            list(self.others.values()), [other.others[name] for name in self.others]
        )

    def __hash__(self) -> int:
        return hash(self.kind)


class AbstractOpened(eqx.Module):
    """What stands for a function or an object, as a pytree."""

    @abc.abstractmethod
    def made(self) -> Any:
        """The function or object, with the arrays that the pytree holds now."""

    def __call__(self, *args: Any, **named: Any) -> Any:
        return self.made()(*args, **named)


class _Opened(AbstractOpened):
    """A plain function as a pytree.

    Attributes:
        found: Values of the variables that hold traced arrays, by their places in the closure.
        defaults: Its arguments' defaults, if traced arrays are among them; else None.
        frame: All else.
    """

    found: dict[int, Any]
    defaults: Any
    frame: _Frame = eqx.field(static=True)

    def made(self) -> Callable[..., Any]:
        return self.frame.function(_closed(self.found), _closed(self.defaults))


class _Bound(AbstractOpened):
    """A `functools.partial`, or a method of an object, as a pytree."""

    function: Any
    args: tuple[Any, ...]
    named: dict[str, Any]

    def made(self) -> Callable[..., Any]:
        function, args, named = _closed((self.function, self.args, self.named))
        return functools.partial(function, *args, **named)


class _Object(AbstractOpened):
    """An object as a pytree.

    Attributes:
        found: Its attributes that hold traced arrays.
        rest: All else.
    """

    found: dict[str, Any]
    rest: _Rest = eqx.field(static=True)

    def made(self) -> Any:
        kind: Any = self.rest.kind
        try:
            made = object.__new__(kind)
        except TypeError:  # a class that is not written in Python has its own way
            made = kind.__new__(kind)
        vars(made).update(self.rest.others | _closed(self.found))
        return made
