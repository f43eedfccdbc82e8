"""What a map over two parameters shows of one kept value or code: a slice of a grid, or scattered samples.

`_map_figure` draws it, `_map_page` writes it for a browser. The other parameters of a grid are held where the
caller says, or in the middle of their axis.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from .._integration import flag_words
from .._printing import code_name, code_of, is_code, number_of
from .._results import check_instance, shown
from .._sweep import Parameters

# Steps of an axis are even if none differs from the mean by more than this share.
_EVEN = 1e-6


class Side(NamedTuple):
    """One parameter along a side of the map.

    Attributes:
        values: Shape (k,), rising, along a grid; else one for each sample.
        label: Name and unit.
        log: Whether its steps are even on a scale of logarithms.
    """

    values: np.ndarray
    label: str
    log: bool


class MapData(NamedTuple):
    """Numbers of a map.

    Attributes:
        x: Along the lower side.
        y: Along the left side.
        z: Shape (len(y), len(x)) on a grid, (n,) of samples; codes as numbers from 0 up, values as they are.
        codes: Names of the codes, by these numbers; none for values.
        gridded: Whether it is a grid.
        held: In words, where other parameters are held, or that they change among samples; empty if none do.
    """

    x: Side
    y: Side
    z: np.ndarray
    codes: tuple[str, ...]
    gridded: bool
    held: str


def map_data(
    parameters: Parameters,
    values: Any,
    *,
    x: str | None = None,
    y: str | None = None,
    at: Mapping[str, float] | None = None,
) -> MapData:
    """The slice to be shown, or the samples; see `plotting.parameter_map`."""
    check_instance("parameters", parameters, Parameters, "Parameters")
    if at is not None and not isinstance(at, Mapping):
        raise ValueError(f"argument at must say by name where parameters are held, but was {shown(at)}")
    x, y = _sides(parameters, x, y)
    numbers, codes = _numbered(parameters, values)
    along = {name: k for k, names in enumerate(parameters.axes) for name in names}
    if along[x] == along[y]:
        if at:
            raise ValueError(f"argument at must be left out where samples are shown, but was {shown(at)}")
        right, up = (_axis(parameters, name, parameters[name], gridded=False) for name in (x, y))
        return MapData(right, up, numbers.ravel(), codes, gridded=False, held=_spread(parameters, (x, y)))
    place, held = _place(parameters, (along[x], along[y]), at or {})
    seen = numbers[place]
    grid = seen.T if along[x] < along[y] else seen
    right, up = (_axis(parameters, name, parameters.axis(name), gridded=True) for name in (x, y))
    across, along_y = (np.argsort(side.values, kind="stable") for side in (right, up))
    right, up = (
        right._replace(values=right.values[across]),
        up._replace(values=up.values[along_y]),
    )
    return MapData(right, up, grid[np.ix_(along_y, across)], codes, gridded=True, held=held)


def _sides(parameters: Parameters, x: Any, y: Any) -> tuple[str, str]:
    """Names of both sides: those that are asked for, or the first two that change."""
    simple = [name for name in parameters.names if np.ndim(parameters[name]) == 1]
    free = [name for name in simple if np.ptp(parameters[name].astype(float)) > 0.0]
    for which, name in (("x", x), ("y", y)):
        if name is not None and not (isinstance(name, str) and name in free):
            raise ValueError(
                f"argument {which} must be a parameter of one number that changes, of {shown(free)}, "
                f"but was {shown(name)}"
            )
    if x is not None and x == y:
        raise ValueError(f"argument y must be another parameter than x, but was {shown(y)}")
    left = [name for name in free if name not in (x, y)]
    if len(left) + (x is not None) + (y is not None) < 2:
        raise ValueError(
            f"argument parameters must have two parameters of one number each that change, "
            f"but those were {shown(free)}"
        )
    x = _another(parameters, left, y) if x is None else x
    return x, _another(parameters, [name for name in left if name != x], x) if y is None else y


def _another(parameters: Parameters, names: list[str], side: str | None) -> str:
    """The first name that changes along another axis of the grid than the other side does, else the first."""
    along = {name: k for k, axis in enumerate(parameters.axes) for name in axis}
    return next((name for name in names if side is None or along[name] != along[side]), names[0])


def _numbered(parameters: Parameters, values: Any) -> tuple[np.ndarray, tuple[str, ...]]:
    """Values in the shape of the grid, codes and truth values as numbers from 0 up with their names."""
    kind, array = number_of(values) if is_code(values) else (None, values)
    words, rows = flag_words(values), math.prod(parameters.shape)
    try:
        array = np.asarray(array)
    except (TypeError, ValueError):  # ragged, or keys of random numbers
        array = np.asarray(None)
    if array.shape not in ((rows,), parameters.shape) or array.dtype.kind not in "fiub":
        raise ValueError(
            f"argument values must be one number or code for each of the {rows} rows, but was {shown(values)}"
        )
    array = array.reshape(parameters.shape)
    if kind is None and not words and array.dtype.kind != "b":
        return array.astype(float), ()
    present, numbers = np.unique(array, return_inverse=True)
    named = lambda code: str(code) if kind is None else code_name(code_of(kind, code))  # noqa: E731
    names = [words.get(int(code)) or named(code) for code in present]
    return numbers.reshape(array.shape), tuple(name.lower().replace("_", " ") for name in names)


def _place(parameters: Parameters, sides: tuple[int, int], at: Mapping[str, float]) -> tuple[Any, str]:
    """Where the grid is cut, and in words."""
    place: list[Any] = [slice(None) if k in sides else n // 2 for k, n in enumerate(parameters.shape)]
    for name, value in at.items():
        along = [k for k, names in enumerate(parameters.axes) if name in names and k not in sides]
        number = _is_number(value)
        if not along or not number or np.ndim(parameters[name]) != 1:
            raise ValueError(
                f"argument at must hold parameters that are no side of the map at a number each, but had "
                f"{shown(name)}: {shown(value)}"
            )
        place[along[0]] = int(np.argmin(np.abs(parameters.axis(name) - float(value))))
    told = [
        f"{name} = {_few_digits(parameters.axis(name)[k])} {parameters.units[name]}".strip()
        for names, k, n in zip(parameters.axes, place, parameters.shape, strict=True)
        for name in names
        if not isinstance(k, slice) and n > 1
    ]
    return tuple(place), ", ".join(told)


def _few_digits(value: np.ndarray) -> str:
    """A number, or several in parentheses."""
    if np.ndim(value) == 0:
        return f"{value:.4g}"
    return f"({', '.join(f'{each:.4g}' for each in np.ravel(value).tolist())})"


def _is_number(value: Any) -> bool:
    """Whether this is one finite number, of any library."""
    if isinstance(value, str) or not (isinstance(value, int | float) or hasattr(value, "dtype")):
        return False
    array = np.asarray(value)
    return array.ndim == 0 and array.dtype.kind in "fiu" and bool(np.isfinite(array))


def _spread(parameters: Parameters, sides: tuple[str, str]) -> str:
    """Which other parameters change among samples, in words."""
    others = [name for name in parameters.names if name not in sides]
    changing = [name for name in others if np.ptp(parameters[name].astype(float)) > 0.0]
    return (
        f"{', '.join(changing)} between {'its' if len(changing) == 1 else 'their'} bounds" if changing else ""
    )


def _axis(parameters: Parameters, name: str, values: np.ndarray, *, gridded: bool) -> Side:
    unit = parameters.units[name]
    told = name.replace("_", " ")
    return Side(
        np.asarray(values, float), f"{told} [{unit}]" if unit else told, _logarithmic(values, gridded=gridded)
    )


def _logarithmic(values: np.ndarray, *, gridded: bool) -> bool:
    """Whether three or more values are even steps of a logarithm, or samples that are even there."""
    every = np.unique(np.asarray(values, float))
    if len(every) < 3 or every[0] <= 0.0:
        return False
    if gridded:
        steps, ratios = np.diff(every), np.diff(np.log(every))
        even = lambda x: np.ptp(x) <= _EVEN * abs(x.mean()) * len(x)  # noqa: E731
        return bool(even(ratios) and not even(steps))
    # Even samples have their median in the middle of their range.
    aside = lambda x: abs(np.median(x) - 0.5 * (x[0] + x[-1])) / (x[-1] - x[0])  # noqa: E731
    return bool(aside(np.log(every)) < aside(every) and every[-1] > 2.0 * every[0])
