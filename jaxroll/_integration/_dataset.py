"""Runs as tables with names: every array under a name, with named dimensions, units and labels.

`named_arrays` walks through a run, or through whatever was kept of one, by what each record says of itself:
`AXES` names the dimensions of its fields, `UNITS` their units, `PARTS` what the fields of a field are called.
`label_arrays` has what stands along these dimensions: coordinates of the bodies with their units, contacts,
times. `as_dataset` makes an `xarray.Dataset` of both, and `_sweep._store` writes them to a store chunk by
chunk. This is the only door to xarray, which is imported with its first use.
"""

import importlib
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from .._mechanics import Coordinate, Labels
from .._printing import is_code, names_of, number_of
from .._results import missing_library, traced

# What fields are, in words, for those who have the table without this package.
_WORDS = {
    "q": "position",
    "v": "velocity",
    "s": "contact coordinate",
    "memory": "memory of the controller",
    "normal": "gap along the normal of the object",
    "tangential": "gap along the tangent of the object",
    "tangency": "sine of the angle between the tangents, in space between the normals",
    "steps": "attempted steps",
    "accepted": "accepted steps",
    "rejected": "rejected steps",
    "t_end": "time that the run reached",
    "ended_by": "which contact, finger or joint ended the run, as its result says; -1 where none did",
    "margin": "what ran out at the end; infinite where nothing did",
    "f": "normal contact force",
    "lam": "tangential contact force",
    "kinetic": "kinetic energy",
    "potential": "potential energy",
    "work": "work of all that is not potential",
    "residual": "energy less what it was, less the work",
}
# Fields under another name: a dimension has theirs.
_RENAMED = {"contact": "ended_by"}
# Names of dimensions, of what stands along them, and of what a store says of its runs.
_TAKEN = {"time", "position", "velocity", "place", "contact", "axis", "number", "blow"}
_TAKEN |= {"position_unit", "velocity_unit", "place_unit", "contact_name", "sweep", "stored", "zarr.json"}
# The code of a run that is not in a store yet, by name; codes themselves are zero or more.
ABSENT = -1
_ABSENT_WORD = "not_stored"


class Named(NamedTuple):
    """One array of a table.

    Attributes:
        name: Its name.
        dims: Names of its dimensions.
        values: The array, or its shape and dtype alone.
        attrs: `units`, `long_name`; of codes `flag_values` and `flag_meanings`, as in the CF conventions.
    """

    name: str
    dims: tuple[str, ...]
    values: Any
    attrs: dict[str, Any]


def named_arrays(
    value: Any,
    lead: Sequence[str],
    labels: Labels | None = None,
    times: int | None = None,
    *,
    base: str = "kept",
) -> list[Named]:
    """The arrays in a value under names, in the order of their fields.

    Args:
        value: A run, some of its records, or any pytree of arrays; shapes and dtypes do as well.
        lead: Names of the dimensions that all arrays begin with.
        labels: Of the grasp, if it is known.
        times: How many times a run saves, if that is known.
        base: What an array is called that has no name of its own.
    """
    sizes = {"axis": 3} | ({} if times is None else {"time": times})
    if labels is not None:
        counts = {"position": len(labels.coordinates), "velocity": len(_joined(labels.velocities))}
        sizes |= counts | {"place": len(labels.places), "contact": len(labels.contacts)}
    walk = _Walk(tuple(lead), sizes, base)
    walk.enter(value, "", "time")
    return walk.found


def label_arrays(labels: Labels | None, used: set[str], times: Any = None) -> list[Named]:
    """What stands along the dimensions that are used: names and units of coordinates, contacts, times."""
    found = []
    if times is not None and "time" in used:
        found.append(Named("time", ("time",), np.asarray(times), {"units": "s", "long_name": "time"}))
    if "axis" in used:
        found.append(_texts("axis", "axis", "xyz"))
    if labels is None:
        return found
    kinds = {"position": labels.bodies, "velocity": labels.velocities}
    for dim, each in {**{k: _joined(v) for k, v in kinds.items()}, "place": labels.places}.items():
        if dim in used and each:
            found += [_texts(dim, dim, [c.name for c in each])]
            found += [_texts(f"{dim}_unit", dim, [c.unit for c in each])]
    if "contact" in used:
        found.append(Named("contact", ("contact",), np.arange(len(labels.contacts)), {}))
        found.append(_texts("contact_name", "contact", labels.contacts))
    return found


def dataset_of(run: Any) -> Any:
    """One run, or a batch of runs, as a dataset; `Trajectory.to_xarray`."""
    if traced(run):
        raise ValueError("argument run must be known to be a table, but JAX is tracing it")
    run = jax.tree.map(np.asarray, run)
    lanes = np.ndim(run.stats.steps)
    lead = ("lane",) if lanes == 1 else tuple(f"lane_{i}" for i in range(lanes))
    arrays = named_arrays(run, lead, run.labels, run.ts.shape[-1])
    rows = run.ts.reshape(-1, run.ts.shape[-1])
    # The times of lanes are one row unless they differ from lane to lane.
    times = rows[0] if len(rows) and np.array_equal(rows, np.broadcast_to(rows[0], rows.shape)) else None
    if times is not None:
        arrays = [each for each in arrays if each.name != "ts"]
    used = {dim for each in arrays for dim in each.dims}
    return as_dataset(arrays, label_arrays(run.labels, used, times), about(run.ts.dtype))


def about(dtype: Any) -> dict[str, str]:
    """What a table says of itself: versions, and the precision of its numbers."""
    kind = "double" if np.dtype(dtype) == np.float64 else "single"
    version = importlib.import_module("jaxroll").__version__
    return {
        "source": f"jaxroll {version}",
        "jaxroll_version": version,
        "jax_version": jax.__version__,
        "precision": kind,
    }


def as_dataset(arrays: Sequence[Named], labels: Sequence[Named], attrs: Mapping[str, Any]) -> Any:
    """An `xarray.Dataset` of named arrays, and of what stands along their dimensions."""
    xarray = xarray_module()
    held, along = ({x.name: (x.dims, x.values, x.attrs) for x in part} for part in (arrays, labels))
    return xarray.Dataset(held, coords=along, attrs=dict(attrs))


def open_table(path: Any) -> Any:
    """The dataset in a store of Zarr: its arrays are read when they are asked for, those asked for alone."""
    xarray = xarray_module()
    with warnings.catch_warnings():
        # Stores that hold files besides arrays, where their list of arrays is not found.
        warnings.filterwarnings("ignore", message="Object at ")
        return xarray.open_zarr(path, chunks=None)


def xarray_module() -> Any:
    """The library xarray, imported with the first call."""
    try:
        import xarray
    except ImportError:
        raise missing_library("xarray", "data") from None
    return xarray


class _Walk:
    """A walk through a value, which gathers its arrays."""

    def __init__(self, lead: tuple[str, ...], sizes: dict[str, int], base: str) -> None:
        self.lead, self.sizes, self.base = lead, sizes, base
        self.found: list[Named] = []
        self.names: set[str] = set()

    def enter(self, value: Any, prefix: str, extra: str) -> None:
        """Gather what is in a value; names begin with `prefix`, and `extra` is a dimension before its own."""
        if value is None:
            return
        if is_code(value):
            codes, number = number_of(value)
            return self.add(prefix.rstrip("_") or "result", number, (), _flags(names_of(codes)))
        if hasattr(type(value), "AXES"):
            return self.record(value, prefix, extra)
        if hasattr(value, "shape") and hasattr(value, "dtype"):
            return self.add(prefix.rstrip("_") or self.base, value, (), {})
        if hasattr(type(value), "PARTS"):
            self.add(f"{prefix}ts", value.ts, ("time",), {"units": "s", "long_name": "time"})
        for name, part in self.parts(value):
            first = f"{self.base}_" if isinstance(name, int) and not prefix else prefix
            self.enter(part, f"{first}{name}", "blow" if name == "impulse_" else extra)

    def parts(self, value: Any) -> list[tuple[Any, Any]]:
        """What a value consists of, each with what its names begin with; a number for what has none."""
        kind = type(value)
        if hasattr(kind, "PARTS"):
            return [(name, getattr(value, field)) for field, name in kind.PARTS.items()]
        if isinstance(value, Mapping):
            return [(f"{key}_", part) for key, part in value.items()]
        if isinstance(value, tuple | list):
            names = getattr(kind, "_fields", None)
            return [(f"{names[i]}_" if names else i, part) for i, part in enumerate(value)]
        found = jax.tree_util.tree_leaves_with_path(value)
        return [("_".join(str(_step(key)) for key in path) + "_", leaf) for path, leaf in found]

    def record(self, value: Any, prefix: str, extra: str) -> None:
        """Gather the fields of a record that says what its axes are.

        An axis that the first field has before those in `AXES` belongs to all fields: of times, or of blows.
        """
        axes: dict[str, tuple[str, ...]] = type(value).AXES
        units: dict[str, str] = getattr(type(value), "UNITS", {})
        first = next(iter(axes))
        before = (extra,) * (len(getattr(value, first).shape) - len(self.lead) - len(axes[first]))
        for field, own in axes.items():
            part = getattr(value, field)
            if part is not None:
                name = _RENAMED.get(field, field)
                unit, word = units.get(field, ""), _WORDS.get(name, name)
                if extra == "blow":  # forces that act for no time
                    unit, word = f"{unit} s", word.replace("force", "impulse")
                told = {"long_name": word} | ({"units": unit} if unit else {})
                self.add(prefix + name, part, (*before, *own), told)

    def add(self, name: str, values: Any, dims: tuple[str, ...], attrs: dict[str, Any]) -> None:
        """Gather one array; a dimension of another size than the run's gets a name of its own."""
        # Neither spaces nor slashes of either kind: lists of names are divided at the former, paths at the
        # latter, so that Zarr looks for what one divides in another folder. No path has a null character.
        name = re.sub(r"[\s/\\\0]+", "_", name)
        # Points alone name folders that every folder has.
        taken = name in _TAKEN | set(self.lead) or not name.strip(".")
        name = f"{name}_{self.base}" if taken else name
        name = next(n for n in _numbered(name) if n not in self.names)
        self.names.add(name)
        own = values.shape[len(self.lead) :]
        fits = [dims[k] if k < len(dims) and self._fits(dims[k], n) else "" for k, n in enumerate(own)]
        # A dimension may stand once in an array.
        last = (fit if fit and fit not in fits[:k] else f"{name}_{k}" for k, fit in enumerate(fits))
        self.found.append(Named(name, (*self.lead, *last), values, attrs))

    def _fits(self, dim: str, size: int) -> bool:
        """Whether a dimension has this size; one not met before takes it."""
        return self.sizes.setdefault(dim, size) == size


def _step(key: Any) -> Any:
    """The field, key or index of one step into a pytree."""
    return next((getattr(key, name) for name in ("name", "key", "idx") if hasattr(key, name)), key)


def _numbered(name: str) -> Iterator[str]:
    """A name, and then the same with numbers."""
    yield name
    number = 2
    while True:
        yield f"{name}_{number}"
        number += 1


def _flags(names: Mapping[int, str]) -> dict[str, Any]:
    """Codes and their names, as the CF conventions write them."""
    values, words = [*names, ABSENT], [*names.values(), _ABSENT_WORD]
    about = {"flag_values": values, "flag_meanings": " ".join(words)}
    return about | {"long_name": "how the run ended"}


def flag_words(values: Any) -> dict[int, str]:
    """The codes of an array of a table, by number; none where it holds numbers."""
    told = getattr(values, "attrs", None) or {}
    numbers, words = told.get("flag_values"), str(told.get("flag_meanings", "")).split()
    return {} if numbers is None else {int(n): word for n, word in zip(numbers, words, strict=False)}


def _texts(name: str, dim: str, texts: Sequence[str]) -> Named:
    # As objects: strings of a fixed length have no place in the third format of Zarr.
    return Named(name, (dim,), np.array(list(texts), object), {})


def _joined(bodies: Sequence[tuple[str, Sequence[Coordinate]]]) -> list[Coordinate]:
    """Coordinates of all bodies, each with its body's name."""
    return [Coordinate(f"{body} {each.name}", each.unit) for body, labels in bodies for each in labels]
