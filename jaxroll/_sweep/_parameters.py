r"""Parameters of many runs, by name: columns, grids, products, and samples that fill a box evenly.

`Parameters` holds one array for each name, with a common leading axis of rows, as `sweep` takes them: it is a
pytree, so that the `make` of a sweep gets one row of the same class, and reads `p.damping`. A grid is the
product of its axes, the last of which changes fastest, and remembers their lengths: `shaped` turns an axis of
rows into the axes of the grid. Samples are SciPy's (`scipy.stats.qmc`).
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .._printing import is_code, shown_value
from .._results import as_array, as_count, shown, traced

# The most rows: more would not fit into a machine's memory.
_MOST = 10**9


class Parameters(eqx.Module):
    r"""Named arrays with a common leading axis: one row for each run of a sweep.

    `Parameters(damping=..., tip_radius=...)` takes columns of one length as they are; a single number stands
    for a column that does not change. `grid` makes all combinations of axes, `sobol` and `latin_hypercube` n
    points of a box, and `a * b` pairs each row of one with each row of the other.

    One name is an attribute (`p.damping`) and an item (`p["damping"]`); `p[7]` is a row, `p[10:20]` are ten,
    and a function of named arguments takes a row as `**p`. Rows are floating, whole or truth values, of one
    number or of an array each, and stay NumPy's: `sweep` sends them to the device chunk by chunk.

    Args:
        **columns: By name, shape (n, ...).

    Attributes:
        names: In the order in which they were given.
        columns: One array for each name.
        shape: Lengths of the axes along which rows are laid out: (n,), or of a grid one for each of its axes.
        axes: For each of these axes, the names that change along it.
        units: By name, "" where none was given; pictures and tables write them.

    Raises:
        ValueError: If a column holds anything but finite numbers, lengths differ, or a name is taken.

    Example:
        >>> import jaxroll as jxr
        >>> some = jxr.Parameters.grid(damping=[0.004, 0.006], force=[0.4, 0.5, 0.6])
        >>> some = some.with_units(damping="N m s", force="N")
        >>> some.rows, some.shape
        (6, (2, 3))
        >>> some.shaped(some.damping * some.force).shape  # as of what a sweep returns, row by row
        (2, 3)
    """

    names: tuple[str, ...] = eqx.field(static=True)
    columns: tuple[Any, ...]
    shape: tuple[int, ...] = eqx.field(static=True)
    axes: tuple[tuple[str, ...], ...] = eqx.field(static=True)
    _units: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, **columns: Any) -> None:
        found = {name: _column(name, value) for name, value in _named(columns).items()}
        lengths = {len(x) for x in found.values() if x.ndim} or {1}
        if len(lengths) != 1:
            told = ", ".join(f"{name} {len(x)}" for name, x in found.items() if x.ndim)
            raise ValueError(
                f"argument {list(found)[-1]} must be as long as the other columns, but lengths were {told}"
            )
        (count,) = lengths
        self.names = tuple(found)
        self.columns = tuple(x if x.ndim else np.full(count, x) for x in found.values())
        self.shape, self.axes = (count,), (self.names,)
        self._units = ("",) * len(found)

    @classmethod
    def grid(cls, **axes: Any) -> "Parameters":
        """All combinations of the values along some axes; the last axis changes fastest.

        Args:
            **axes: By name, shape (k, ...): the values along it. `numpy.linspace` and `numpy.geomspace` make
                even ones.

        Example:
            >>> import jaxroll as jxr
            >>> jxr.Parameters.grid(beta=[10.0, 20.0], alpha=[0.0, 0.001, 0.002]).beta
            array([10., 10., 10., 20., 20., 20.])
        """
        found = [cls(**{name: _axis(name, values)}) for name, values in _named(axes).items()]
        return math.prod(found[1:], start=found[0])

    @classmethod
    def sobol(cls, count: int, /, *, seed: int = 0, **ranges: Any) -> "Parameters":
        r"""Points of a scrambled Sobol sequence: they fill a box more evenly than random ones.

        The mean of a smooth function over n of them is off by about $n^{-3/2}$, as against $n^{-1/2}$ at
        random, where n is a power of two. More points with the same seed begin with the same ones.

        Args:
            count: How many points.
            seed: Seeds the scrambling.
            **ranges: By name (low, high), or (low, high, "log") for numbers whose logarithm is even.

        Raises:
            ValueError: If a range is none, or one with "log" begins at zero or below.

        Example:
            >>> import jaxroll as jxr
            >>> some = jxr.Parameters.sobol(64, damping=(0.002, 0.02, "log"), beta=(10.0, 30.0))
            >>> some.rows, bool((some.damping >= 0.002).all())
            (64, True)
        """
        from scipy.stats import qmc

        if len(ranges) > qmc.Sobol.MAXDIM:
            raise ValueError(f"argument ranges must be at most {qmc.Sobol.MAXDIM}, but were {len(ranges)}")

        def points(count: int, axes: int, seed: int) -> np.ndarray:
            # A power of two and a part of it: SciPy warns of other counts, for which these are the same.
            return qmc.Sobol(axes, rng=seed).random_base2(max(count - 1, 0).bit_length())[:count]

        return cls(**_sampled(points, count, seed, ranges))

    @classmethod
    def latin_hypercube(cls, count: int, /, *, seed: int = 0, **ranges: Any) -> "Parameters":
        """Points of a Latin hypercube: each of n equal parts of each name's range holds one of the n points.

        Args:
            count: How many points.
            seed: Seeds the order in which the parts are taken, and the places within them.
            **ranges: By name (low, high), or (low, high, "log") for numbers whose logarithm is even.

        Raises:
            ValueError: If a range is none, or one with "log" begins at zero or below.

        Example:
            >>> import jaxroll as jxr
            >>> sorted((10 * jxr.Parameters.latin_hypercube(10, beta=(0.0, 1.0)).beta).astype(int).tolist())
            [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]
        """
        from scipy.stats import qmc

        def points(count: int, axes: int, seed: int) -> np.ndarray:
            return qmc.LatinHypercube(axes, rng=seed).random(count)

        return cls(**_sampled(points, count, seed, ranges))

    @classmethod
    def of_table(cls, table: Any) -> "Parameters":
        """The parameters of a table that `sweep` stored, with their units and as the grid that they were.

        Args:
            table: The `xarray.Dataset` that `sweep(store=)` returns, or that `xarray.open_zarr` opens.

        Raises:
            ValueError: If it is no such table, or one whose parameters have no names.

        Example:
            >>> import tempfile
            >>> import jaxroll as jxr, numpy as np
            >>> grasp, state = jxr.scenes.pivoted()
            >>> force = np.linspace(0.4, 0.5, 8)
            >>> some = jxr.Parameters.grid(damping=np.linspace(0.004, 0.008, 8), force=force)
            >>> path = tempfile.mkdtemp() + "/some.zarr"
            >>> keep = lambda run: run.last.q
            >>> table = jxr.sweep(lambda p: (grasp.with_(**p), state), some, t1=0.1, keep=keep, store=path)
            >>> jxr.Parameters.of_table(table).shape
            (8, 8)
        """
        told = getattr(table, "attrs", {})
        names = told.get("parameters")
        if not names or not all(name in table for name in names):
            raise ValueError(
                f"argument table must be an xarray.Dataset of a stored sweep, but was {shown(table)}"
            )
        own = told.get("parameter_names", names)
        found = cls(**{name: table[stored].values for name, stored in zip(own, names, strict=True)})
        units = {name: table[stored].attrs.get("units", "") for name, stored in zip(own, names, strict=True)}
        shape = tuple(told.get("grid_shape", found.shape))
        if math.prod(shape) == len(found):
            axes = tuple(tuple(each) for each in told.get("grid_axes", found.axes))
            found = _changed(found, shape=shape, axes=axes)
        return found.with_units(**units)

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return len(self)

    @property
    def units(self) -> dict[str, str]:
        """Units by name."""
        return dict(zip(self.names, self._units, strict=True))

    def with_units(self, **units: str) -> "Parameters":
        """A copy with units for some of its names.

        Raises:
            ValueError: If there is no such name, or a unit is not text.
        """
        for name, unit in units.items():
            if name not in self.names or not isinstance(unit, str):
                known = ", ".join(self.names)
                raise ValueError(
                    f"argument {name} must be a unit, as text, of one of {known}, but was {shown(unit)}"
                )
        return _changed(self, _units=tuple((self.units | units).values()))

    def shaped(self, values: Any) -> Any:
        """Arrays with one entry for each row, with the axes of the grid in the place of the axis of rows.

        Args:
            values: A pytree of arrays with leading axis n, such as what `sweep` returns.

        Raises:
            ValueError: If an array has another leading axis.
        """

        def one(leaf: Any) -> Any:
            if np.shape(leaf)[:1] != (math.prod(self.shape),):
                raise ValueError(
                    f"argument values must hold arrays of leading axis {math.prod(self.shape)}, but one had "
                    f"shape {np.shape(leaf)}"
                )
            return leaf.reshape(*self.shape, *leaf.shape[1:])

        return jax.tree.map(one, values)

    def axis(self, name: str) -> np.ndarray:
        """The values of a name along its axis of the grid, shape (k, ...); of samples its column."""
        if not isinstance(name, str) or name not in self.names:
            raise ValueError(f"argument name must be one of {', '.join(self.names)}, but was {shown(name)}")
        along = next(k for k, names in enumerate(self.axes) if name in names)
        every = self.shaped(self[name])
        return every[tuple(slice(None) if k == along else 0 for k in range(len(self.shape)))]

    def keys(self) -> tuple[str, ...]:
        """The names, so that `**p` gives them to a function."""
        return self.names

    def __mul__(self, other: Any) -> "Parameters":
        if not isinstance(other, Parameters):
            return NotImplemented
        twice = sorted(set(self.names) & set(other.names))
        if twice:
            raise ValueError(f"argument {twice[0]} must be a name in one factor, but was in both")
        count = _few_enough(self.names[0], len(self) * len(other))
        ours, theirs = np.divmod(np.arange(count), len(other))
        columns = [x[ours] for x in self.columns] + [x[theirs] for x in other.columns]
        return _changed(
            self,
            names=self.names + other.names,
            columns=tuple(columns),
            shape=self.shape + other.shape,
            axes=self.axes + other.axes,
            _units=self._units + other._units,
        )

    def __getattr__(self, name: str) -> Any:
        # Looked up past the class: while a copy is being made it has no names yet.
        held = vars(self)
        if name in held.get("names", ()):
            return held["columns"][held["names"].index(name)]
        raise AttributeError(f"Parameters has no column {name!r}")

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            if key not in self.names:
                raise KeyError(f"there is no {key!r} among {', '.join(self.names)}")
            return getattr(self, key)
        key = _as_rows(key, np.shape(self.columns[0])[:1])
        columns = tuple(x[key] for x in self.columns)
        if not np.ndim(columns[0]) or np.ndim(key) == 0 and not isinstance(key, slice):
            return _changed(self, columns=columns)
        return _changed(self, columns=columns, shape=(len(columns[0]),), axes=(self.names,))

    def __len__(self) -> int:
        if not np.ndim(self.columns[0]):
            raise TypeError("one row of Parameters has no rows itself")
        return len(self.columns[0])

    def __bool__(self) -> bool:
        return True

    def __iter__(self) -> Iterator["Parameters"]:
        return (self[i] for i in range(len(self)))

    def __contains__(self, name: Any) -> bool:
        return name in self.names

    def __repr__(self) -> str:
        parts = [
            f"{name}={shown_value(x, self.units[name])}"
            for name, x in zip(self.names, self.columns, strict=True)
        ]
        laid = "" if len(self.shape) == 1 else f" as {' x '.join(map(str, self.shape))}"
        head = f"{len(self)} rows{laid}" if np.ndim(self.columns[0]) else "one row"
        return f"Parameters({head}: {', '.join(parts)})"


def laid_out(parameters: Parameters) -> dict[str, list[Any]]:
    """How rows are laid out, for `Parameters.of_table`, in lists as JSON has them."""
    axes = [list(names) for names in parameters.axes]
    return {
        "parameter_names": list(parameters.names),
        "grid_shape": list(parameters.shape),
        "grid_axes": axes,
    }


def _changed(parameters: Parameters, **fields: Any) -> Parameters:
    """A copy with other fields; the constructor would check columns again, and forget the grid."""
    copy = object.__new__(Parameters)
    for name in ("names", "columns", "shape", "axes", "_units"):
        object.__setattr__(copy, name, fields.get(name, getattr(parameters, name)))
    return copy


def _named(given: dict[str, Any]) -> dict[str, Any]:
    """What was given by name; raises if that is nothing, or a name is an attribute of the class."""
    if not given:
        raise ValueError("argument columns must be one or more arrays by name, but there was none")
    own = {*Parameters.__dataclass_fields__, *vars(Parameters)}
    for name in given:
        if not name.isidentifier() or name in own:
            raise ValueError(
                f"argument {shown(name)} must be called otherwise: it is no name that Parameters can have as "
                "an attribute of its own"
            )
    return given


def _column(name: str, value: Any) -> np.ndarray:
    """A column as a NumPy array of finite numbers or truth values; without axes if it is a single number."""
    wanted = f"argument {name} must be a number or an array of numbers, but was {shown(value)}"
    if traced(value):
        raise ValueError(f"{wanted}: parameters are known before anything is traced")
    try:
        array = np.array(value)  # a copy, which the caller cannot change later
    except (TypeError, ValueError, OverflowError):
        raise ValueError(wanted) from None
    # NumPy would take the numbers under the mask of a masked array for parameters, and those of codes too.
    if array.dtype.kind not in "fiub" or isinstance(value, np.ma.MaskedArray) or is_code(value):
        raise ValueError(wanted)
    if array.ndim and not array.size:
        raise ValueError(f"argument {name} must hold one number or more, but had shape {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"argument {name} must be finite, but was {shown(array)}")
    return array


def _axis(name: str, values: Any) -> np.ndarray:
    array = _column(name, values)
    if not array.ndim:
        raise ValueError(f"argument {name} must be the values along an axis, but was {shown(values)}")
    return array


def _as_rows(key: Any, count: tuple[int, ...]) -> Any:
    """A key that chooses rows, checked: one number, a slice, or a list of numbers or of truth values.

    Args:
        key: What was asked for.
        count: The number of rows, as a shape (n,); () for a single row, which has none.
    """
    if not count:
        raise IndexError(f"argument key must be a name, of one row, but was {shown(key)}")
    if isinstance(key, slice) or traced(key):
        return key
    wanted = f"argument key must be a name, a row, a slice or a list of rows, but was {shown(key)}"
    try:
        rows = np.asarray(key) if np.size(key) else np.zeros(np.shape(key), int)
    except ValueError:
        raise ValueError(wanted) from None
    masked = rows.dtype.kind == "b" and rows.ndim == 1 and rows.shape == count
    if isinstance(key, tuple) or not masked and (rows.dtype.kind not in "iu" or rows.ndim > 1):
        raise ValueError(wanted)
    if not masked and rows.size and not (-count[0] <= rows.min() and rows.max() < count[0]):
        raise IndexError(f"argument key must be one of {count[0]} rows, but was {shown(key)}")
    return rows if rows.ndim else int(rows)


def _few_enough(name: str, count: int) -> int:
    if count > _MOST:
        raise ValueError(f"argument {name} must leave at most {_MOST} rows, but {count} were asked for")
    return count


def _sampled(points: Callable, count: Any, seed: Any, ranges: dict[str, Any]) -> dict[str, np.ndarray]:
    """Columns from points of the unit cube, each stretched to its range."""
    count, seed = as_count("count", count, most=_MOST), as_count("seed", seed, least=0, most=2**63)
    stretched = {name: _stretch(name, ends) for name, ends in _named(ranges).items()}
    unit = points(count, len(stretched), seed)
    return {name: stretch(u) for (name, stretch), u in zip(stretched.items(), unit.T, strict=True)}


def _stretch(name: str, ends: Any) -> Callable[[np.ndarray], np.ndarray]:
    """A function from [0, 1] to a range."""
    log = isinstance(ends, list | tuple) and len(ends) == 3 and ends[2] == "log"
    wanted = f"argument {name} must be (low, high) or (low, high, 'log'), but was {shown(ends)}"
    try:
        low, high = (float(as_array(name, x)) for x in (ends[:2] if log else ends[:]))
    except (TypeError, ValueError, OverflowError, IndexError):
        raise ValueError(wanted) from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ValueError(f"argument {name} must go up between finite numbers, but was {shown(ends)}")
    if not log:
        return lambda u: low + (high - low) * u
    if low <= 0.0:
        raise ValueError(
            f"argument {name} must begin above zero on a scale of logarithms, but was {shown(ends)}"
        )
    # Clipped, for rounding must not lead past the ends; by powers, for the quotient high / low may overflow.
    return lambda u: np.clip(low ** (1.0 - u) * high**u, low, high)
