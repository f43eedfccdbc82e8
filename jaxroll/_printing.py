"""How results print: codes by their short names, records as one line of names and values."""

import dataclasses
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any, cast, TypeVar

import equinox as eqx
import jax
import jax.core
import numpy as np

Codes = TypeVar("Codes", bound=type[eqx.Enumeration])
# Arrays with more numbers than this print as their shape and range.
_FEW = 12


# The class of an enumeration's codes is not public in equinox: a code of this one has it.
class _Probe(eqx.Enumeration):
    one = ""


class _Code(type(_Probe.one)):  # pyright: ignore
    """A code, or an array of codes, that prints as its short name; `CODES[code]` has its sentence.

    NumPy takes it for an array of whole numbers. Numbers of codes never change, so they may be stored.
    """

    def __repr__(self) -> str:
        return code_name(self)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self._value, dtype=dtype, copy=copy)

    def __int__(self) -> int:
        return int(self._value)

    def __bool__(self) -> bool:
        raise TypeError(
            "a code is neither true nor false: compare it, as in `run.result == RESULTS.successful`"
        )

    def __len__(self) -> int:
        return len(self._value)

    def __getitem__(self, index: Any) -> Any:
        # NumPy raises beyond the end, where JAX takes the last one.
        values = np.asarray(self._value) if _known(self._value) else self._value
        return cast(Any, _Code)(values[index], self._enumeration)

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(len(self)))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of an array of codes, () of a single one."""
        return np.shape(self._value)

    @property
    def names(self) -> np.ndarray:
        """The names of all codes, as an array of strings."""
        known = names_of(self._enumeration)
        return np.vectorize(known.__getitem__, otypes=[str])(np.asarray(self._value))


def entry(title: str, lines: Sequence[str], *, width: int = 100) -> list[str]:
    """An entry of a report: a title, and beside it lines that are broken where they are too long."""
    broken = [part for line in lines for part in textwrap.wrap(line, width - 12) or [""]]
    return [f"  {title if i == 0 else '':<10}{line}" for i, line in enumerate(broken)]


def so_many(count: Any, noun: str) -> str:
    """A count and what is counted, in the plural unless there is one."""
    return f"{int(count)} {noun}{'s' * (int(count) != 1)}"


def named(codes: Codes) -> Codes:
    """Let the codes of an enumeration, and what `where` makes of them, print as their names."""
    items, make = codes._name_to_item, cast(Any, _Code)  # pyright: ignore
    for name, item in tuple(items.items()):
        items[name] = make(item._value, codes)

    def where(cls: Any, pred: Any, a: Any, b: Any) -> Any:
        found = eqx.Enumeration.where.__func__(cls, pred, a, b)  # pyright: ignore
        return found if isinstance(found, _Code) else make(found._value, cls)

    codes.where = classmethod(where)  # pyright: ignore
    return codes


def is_code(value: Any) -> bool:
    """Whether a value is a code of some enumeration, or an array of codes."""
    return isinstance(value, type(_Probe.one))


def number_of(code: Any) -> tuple[type[eqx.Enumeration], Any]:
    """The enumeration that a code belongs to, and its number."""
    return code._enumeration, code._value


def names_of(codes: type[eqx.Enumeration]) -> dict[int, str]:
    """The names of all codes of an enumeration, by number."""
    items = codes._name_to_item  # pyright: ignore
    return dict(sorted((int(item._value), name) for name, item in items.items()))


def code_of(codes: type[eqx.Enumeration], value: Any) -> Any:
    """The code that belongs to a number, or the codes that belong to an array of numbers."""
    make = cast(Any, type(next(iter(codes._name_to_item.values()))))  # pyright: ignore
    return make(value, codes)


def code_name(code: Any) -> str:
    """Short name of a code; of many codes each, or how often each occurs."""
    kind = code._enumeration
    if not _known(code._value):
        return f"{kind.__name__} ({shown_value(code._value)})"
    names, found = names_of(kind), np.asarray(code._value)
    if found.ndim == 0:
        return names[int(found)]
    if found.size <= _FEW:
        return f"[{', '.join(names[int(i)] for i in found.ravel())}]"
    return ", ".join(f"{int(np.sum(found == i))} {names[int(i)]}" for i in np.unique(found))


def listed(self: Any) -> str:
    """A record as one line: its class, and its fields with their values and units.

    Units are those of the class variable `UNITS`, by field. Fields may be traced or batched, and may be
    missing, as in a structure without numbers.
    """
    return _line(self, {f.name: getattr(self, f.name, None) for f in dataclasses.fields(self)})


def listed_without_none(self: Any) -> str:
    """As `listed`, but without the fields that are None, such as arguments of a shape that were not given."""
    values = {f.name: getattr(self, f.name, None) for f in dataclasses.fields(self)}
    return _line(self, {name: value for name, value in values.items() if value is not None})


def _line(record: Any, values: dict[str, Any]) -> str:
    units = getattr(type(record), "UNITS", {})
    parts = [f"{name}={shown_value(value, units.get(name, ''))}" for name, value in values.items()]
    return f"{type(record).__name__}({', '.join(parts)})"


def shown_value(value: Any, unit: str = "") -> str:
    """A value, short: numbers to six digits, larger arrays by shape and range."""
    if value is None or isinstance(value, str | bool | int):
        return f"{value}"
    if isinstance(value, tuple | list):
        return f"({', '.join(shown_value(part) for part in value)})"
    if isinstance(value, float):
        return f"{value:.6g} {unit}" if unit else f"{value:.6g}"
    if not hasattr(value, "shape") or not hasattr(value, "dtype"):
        plain = isinstance(value, eqx.Module) and type(value).__repr__ is eqx.Module.__repr__
        return type(value).__name__ if plain else repr(value)
    if not _known(value):
        kind = "traced" if isinstance(value, jax.core.Tracer) else "unknown"
        return f"{kind} {np.dtype(value.dtype).name}{list(value.shape)}"
    text = _numbers(np.asarray(value))
    return f"{text} {unit}" if unit else text


def _known(value: Any) -> bool:
    return isinstance(value, np.ndarray | np.generic | int) or (
        isinstance(value, jax.Array) and not isinstance(value, jax.core.Tracer)
    )


def _numbers(array: np.ndarray) -> str:
    if array.size <= _FEW:
        return _nested(array)
    seen = array[np.isfinite(array)] if array.dtype.kind in "fc" else array
    shape = " x ".join(map(str, array.shape))
    if array.dtype.kind == "b":
        return f"{shape}, {int(array.sum())} true"
    if not seen.size:
        return f"{shape}, none finite"
    holes = array.size - seen.size
    spread = f"up to {np.abs(seen).max():.6g}" if array.dtype.kind == "c" else _range(seen)
    return f"{shape}, {spread}" + (f", {holes} not finite" if holes else "")


def _range(array: np.ndarray) -> str:
    return f"{array.min():.6g} to {array.max():.6g}"


def _nested(array: np.ndarray) -> str:
    if array.ndim:
        return f"[{', '.join(_nested(part) for part in array)}]"
    return f"{array}" if array.dtype.kind == "b" else f"{array[()]:.6g}"


def lowered(sentence: str) -> str:
    """A sentence as part of another: without its capital and its full stop."""
    return f"{sentence[0].lower()}{sentence[1:].rstrip('.')}"
