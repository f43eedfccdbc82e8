"""A caller's function, with what it closes over as leaves where JAX is tracing that.

To JAX a plain function is structure, and arrays that it closes over are constants of a program. A gain or a
radius that a derivative is taken in, or that a batch varies, is none: a law such as
`lambda t, angles, rates, tips: tuple(-gain * rate for rate in rates)` then hides a number of the program
around from the runs and tables that are compiled apart from it. `opened` makes it a pytree that shows the
number. Functions that hide nothing stay as they are. Fields that take functions, and the controllers' check,
call this.
"""

import functools
import types
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax

from ._results import shown, traced


def as_tree(name: str, function: Any) -> Callable[..., Any]:
    """A callable as a pytree: itself if it is one, a plain function as structure."""
    if not callable(function):
        raise ValueError(f"argument {name} must be a function, but was {shown(function)}")
    function = opened(function)
    return jax.tree_util.Partial(function) if jax.tree_util.all_leaves([function]) else function


def opened(function: Any) -> Any:
    """The function; a pytree in its place if it hides traced arrays in its closure or its defaults.

    So are functions that it closes over in their turn, and the bound arguments of a `functools.partial`.
    """
    return _opened(function, ())


def _opened(value: Any, around: tuple[Any, ...]) -> Any:
    """The same for any pytree, whose leaves may be functions; those in `around` are being looked at."""
    try:
        return jax.tree.map(lambda leaf: _opened_leaf(leaf, around), value, is_leaf=_is_function)
    except (TypeError, ValueError):  # no pytree, such as a dictionary with keys that have no order
        return value


def _is_function(value: Any) -> bool:
    return isinstance(value, types.FunctionType | functools.partial)


def _opened_leaf(leaf: Any, around: tuple[Any, ...]) -> Any:
    if not _is_function(leaf) or any(leaf is one for one in around):
        return leaf
    around = (*around, leaf)
    if isinstance(leaf, functools.partial):
        inner, args, named = _opened((leaf.func, leaf.args, leaf.keywords), around)
        return _Bound(inner, args, named) if _hides((inner, args, named)) else leaf
    closure = leaf.__closure__ or ()
    parts = {i: _opened(cell.cell_contents, around) for i, cell in enumerate(closure) if _full(cell)}
    found = {i: part for i, part in parts.items() if _hides(part)}
    defaults = _opened((leaf.__defaults__, leaf.__kwdefaults__), around)
    if not found and not _hides(defaults):
        return leaf
    cells = [None if i in found else cell for i, cell in enumerate(closure)]
    kept = defaults if _hides(defaults) else None
    return _Opened(found, kept, _Frame(leaf, tuple(cells), kept is not None))


def _hides(value: Any) -> bool:
    """Whether JAX is tracing anything in a value that has been opened."""
    try:
        return traced(value)
    except (TypeError, ValueError):
        return False


def _full(cell: Any) -> bool:
    """Whether a variable of a closure has been given a value yet."""
    try:
        return cell.cell_contents is not None
    except ValueError:
        return False


class _Frame:
    """All of a function but what is traced; equal if code, module and other variables are the same ones."""

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

    def _others(self) -> list[Any]:
        held = [cell.cell_contents if _full(cell) else None for cell in self.cells if cell is not None]
        by_place, by_name = self.defaults or ((), {})
        return [self.space, *held, *(by_place or ()), *(by_name or {}).values()]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Frame) or self.code != other.code or len(self.cells) != len(other.cells):
            return False
        mine, theirs = self._others(), other._others()
        return len(mine) == len(theirs) and all(a is b for a, b in zip(mine, theirs, strict=True))

    def __hash__(self) -> int:
        return hash(self.code)


class _Opened(eqx.Module):
    """A plain function as a pytree.

    Attributes:
        found: Values of the variables that hold traced arrays, by their places in the closure.
        defaults: Its arguments' defaults, if there are such among them.
        frame: All else.
    """

    found: dict[int, Any]
    defaults: Any
    frame: _Frame = eqx.field(static=True)

    def __call__(self, *args: Any, **named: Any) -> Any:
        return self.frame.function(self.found, self.defaults)(*args, **named)


class _Bound(eqx.Module):
    """A `functools.partial` as a pytree."""

    function: Any
    args: tuple[Any, ...]
    named: dict[str, Any]

    def __call__(self, *args: Any, **named: Any) -> Any:
        return self.function(*self.args, *args, **{**self.named, **named})
