"""The store of a sweep: a Zarr group that xarray opens, filled chunk by chunk by whoever computed the chunk.

Every array has the runs as its first dimension and one Zarr chunk for each chunk of the sweep, so that
writers never meet in a file. All arrays are laid out before the first run, with names, units, parameters and
what the sweep is, so that the store can be opened while it fills: runs that are not there yet have `stored`
False, NaN for floating numbers, and -1 for whole numbers and codes.

One array, `sweep`, has no numbers: its attributes say what the sweep is. In its folder, where Zarr looks for
nothing else, lie the manifest and the locks of a `Folder`, and for each finished chunk a file with the
checksum of its parameters and results, written last. A chunk without this file, or whose contents do not have
that checksum, is worked out again. The manifest says which sweep the store is of, all but the values of its
parameters: these stand in the store, and more of them may follow. This is the only door to zarr, which is
imported with its first use.
"""

import contextlib
import hashlib
import json
import os
import secrets
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from .._fingerprint import fingerprint
from .._integration import about, as_dataset, label_arrays, Named, named_arrays, open_table, xarray_module
from .._results import missing_library
from ._folder import Folder
from ._identity import Identity, Mark
from ._parameters import laid_out, Parameters

_RUN = "run"
# Names of arrays: whether the store has a run yet, and the one whose attributes say what the sweep is.
_STORED, _SWEEP = "stored", "sweep"
# Name and dimensions of the saved times among results.
_TIMES = ("ts", (_RUN, "time"))
# Marks that are not written as attributes: their words say nothing, or what the arrays say themselves.
_EFFECTS = ("make", "keep", "program", "parameters")
# Seconds after which writing a chunk is tried again: what was full for a moment, or a server that did not
# answer, may be there again.
_PAUSES = (0.2, 1.0, 5.0)
# What runs that are not stored yet have, by the kind of their dtype; zero for all other kinds.
_BLANKS = {"f": np.nan, "c": np.nan, "i": -1}


class Store:
    """The table of a sweep on disk.

    Args:
        given: Its path.
        rows: The parameters.
        extent: How they are cut into chunks.
        times: The times that runs save [s].
    """

    def __init__(self, given: Any, rows: Any, extent: Any, times: np.ndarray) -> None:
        """Make the folder if need be; raise a ValueError unless it can be written and is no other table."""
        _zarr()
        xarray_module()
        self.folder = Folder(given, "store", ".sum", _SWEEP)
        self.rows, self.extent, self.times = rows, extent, times
        self.parameters: list[str] = []
        self.results: Any = None
        self.labels: Any = None
        self._arrays: dict[str, Any] = {}
        self.path = self.folder.given
        known = any(self.folder.path.iterdir())
        if not known and any((self.path / name).exists() for name in ("zarr.json", ".zgroup", ".zarray")):
            raise ValueError(
                f"argument store must be a new folder or of a sweep, but {self.path} is another table"
            )

    def __getstate__(self) -> dict[str, Any]:
        """All but the rows, the open arrays, and what `fit` takes from the program of another process."""
        return vars(self) | {"results": None, "labels": None, "_arrays": {}, "rows": None}

    def check(self, here: Identity) -> None:
        """Raise if the store is of another sweep, judged by what is known of this one so far."""
        self.folder.check(self._own(here))
        self._compare_rows()

    def open(self, here: Identity, run: Any) -> None:
        """Write the manifest and lay the arrays out, as far as they are not there.

        Args:
            here: All marks of this sweep.
            run: Its `Program`.
        """
        self.folder.open(self._own(here))
        self.fit(run)
        try:
            with self.folder.alone(), warnings.catch_warnings():
                # Of lists of all arrays in one file, which the third format of Zarr does not describe yet.
                warnings.filterwarnings("ignore", message="Consolidated metadata")
                self._compare_rows()
                self._lay_out(here)
        except OSError as error:
            raise self._failure(error) from error

    def fit(self, run: Any) -> None:
        """Take from a program the structure of its results and their names."""
        if getattr(run.results, "dense", None) is not None:
            raise ValueError(
                "argument record must not hold 'dense' where store is given, since steps make no table; keep "
                "says what to store of them"
            )
        self.results, self.labels = run.results, run.trajectory.labels

    def work_on(self, start: int, *, wait: bool) -> Any:
        """`Folder.work_on`."""
        return self.folder.work_on(start, wait=wait)

    def load(self, start: int, forms: Sequence[Any], *, quiet: bool = False) -> list[np.ndarray] | None:
        """An empty list if the chunk that begins at a run is there, whole, of these parameters; else None.

        What it holds stays where it is: `dataset` reads it.
        """
        path = self.folder.chunk(start)
        try:
            told = json.loads(path.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, ValueError):
            told = {}
        try:
            arrays = self._named([np.zeros(form.shape, form.dtype) for form in forms])
            held = [self._array(x.name)[self._span(start)] for x in arrays]
            whole = told.get("checksum") == self._checksum(start, [x.name for x in arrays], held)
            whole = whole and bool(np.all(self._array(_STORED)[self._span(start)]))
        except Exception:  # a damaged file may raise anything
            whole = False
        if whole:
            path.with_suffix(".lock").unlink(missing_ok=True)
            return []
        # If parameters were appended, the last chunk has fewer runs than it is to have: that is no damage.
        missing = self._span(start).stop - start - told.get("runs", 0)
        grown = missing > 0 and told.get("sweep") == self.folder.sweep
        if not quiet and not grown:
            text = f"the chunk of a sweep from run {start} on in {self.path} is worked out again"
            warnings.warn(f"{text}, because it is damaged or of other parameters", stacklevel=2)
        return None

    def store(self, start: int, leaves: Sequence[np.ndarray]) -> None:
        """Write a chunk; where that fails it is tried again, and then raises an OSError."""
        for pause in _PAUSES:
            try:
                return self._write(start, leaves)
            except OSError:
                time.sleep(pause)
        try:
            self._write(start, leaves)
        except OSError as error:
            raise self._failure(error) from error

    def dataset(self) -> Any:
        """The table, opened: its arrays are read when they are asked for."""
        return open_table(self.path)

    def _write(self, start: int, leaves: Sequence[np.ndarray]) -> None:
        span = self._span(start)
        arrays = self._named(leaves)
        for each in arrays:
            self._put(each.name, start, each.values[: span.stop - start])
        self._put(_STORED, start, np.ones(span.stop - start, bool))
        held = [each.values[: span.stop - start] for each in arrays]
        checksum = self._checksum(start, [each.name for each in arrays], held)
        told = {"sweep": self.folder.sweep, "start": start, "runs": span.stop - start, "checksum": checksum}
        self.folder.put(start, json.dumps(told).encode())

    def _put(self, name: str, start: int, values: np.ndarray) -> None:
        """Write one chunk of one array: its numbers as they are, which is what Zarr's bytes codec reads.

        By the library, which does all else here, it takes 1.2 ms; a chunk of short runs is computed in 140 ms
        and may have a dozen arrays.
        """
        blank = _BLANKS.get(values.dtype.kind, 0)
        whole = np.full((self.extent.size, *values.shape[1:]), blank, values.dtype)
        whole[: len(values)] = values
        path = self.path.joinpath(name, "c", str(start // self.extent.size), *["0"] * (values.ndim - 1))
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f"{path.name}.{os.getpid()}.{secrets.token_hex(4)}.part")
        try:
            part.write_bytes(whole.astype(whole.dtype.newbyteorder("<"), copy=False).tobytes())
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)

    def _failure(self, error: OSError) -> OSError:
        text = f"the store {self.path} could not be written ({error.strerror or error})"
        return OSError(error.errno, f"{text}; what it holds stays, and the same call goes on")

    def _span(self, start: int) -> slice:
        """The runs of a chunk."""
        return slice(start, min(start + self.extent.size, self.extent.count))

    def _own(self, here: Identity) -> Identity:
        """Marks in which the parameters count by their form alone, since more of them may follow."""
        form = [(x.name, str(x.values.dtype), x.values.shape[1:]) for x in self._parameters()]
        words = ", ".join(f"{name} {dtype}{list(shape)}" for name, dtype, shape in form)
        return here | {"parameters": Mark(fingerprint(form), words[:60])}

    def _parameters(self) -> list[Named]:
        """The parameters under names."""
        if not isinstance(self.rows, Parameters):
            return named_arrays(self.rows, (_RUN,), base="parameter")
        units = self.rows.units
        found = named_arrays({name: self.rows[name] for name in self.rows.names}, (_RUN,), base="parameter")
        told = lambda name: {"long_name": name} | ({"units": units[name]} if units[name] else {})  # noqa: E731
        return [x._replace(attrs=told(name)) for name, x in zip(self.rows.names, found, strict=True)]

    def _compare_rows(self) -> None:
        """Raise unless the parameters in the store are those of this sweep, or their beginning."""
        group, count = self._group(), self.extent.count
        if group is None:
            return
        names, known = group.attrs.get("parameters", []), int(group.attrs.get("runs", 0))
        differ = f"{known} runs there, {count} here" if known > count else ""
        for name, each in zip(names, self._parameters(), strict=False):
            try:
                there, here = np.asarray(group[name][:known]), each.values[:known]
            except Exception:  # damaged, or gone: it is written again
                continue
            if not differ and there.tobytes() != _plain(here).tobytes():
                differ = f"those of the first {known} runs"
        if differ:
            raise ValueError(
                f"argument store must be a folder of the same sweep, or of its first runs, but "
                f"{self.path} is of one that differs in parameters ({differ})"
            )

    def _named(self, leaves: Sequence[Any]) -> list[Named]:
        """Results under names."""
        tree = jax.tree.unflatten(jax.tree.structure(self.results), leaves)
        found = named_arrays(tree, (_RUN,), self.labels, len(self.times))
        # The times that are saved are the same for every run, and stand along their dimension.
        return [x._replace(values=_plain(x.values)) for x in found if (x.name, x.dims) != _TIMES]

    def _checksum(self, start: int, names: Sequence[str], held: Sequence[np.ndarray]) -> str:
        """Digest of a chunk: of the sweep, the runs, their parameters and their results."""
        digest = hashlib.sha256(f"{self.folder.sweep} {self._span(start)}".encode())
        known = [(name, self._array(name)[self._span(start)]) for name in self.parameters]
        for name, array in [*known, *zip(names, held, strict=True)]:
            digest.update(f"{name} {array.dtype} {array.shape}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()

    def _group(self) -> Any:
        """The group of all arrays; None where it cannot be opened."""
        try:
            return _zarr().open_group(self.path, mode="r+", use_consolidated=False)
        except Exception:  # it is not there, or damaged, which may raise anything
            return None

    def _array(self, name: str) -> Any:
        """An array of the store, opened once."""
        if name not in self._arrays:
            self._arrays[name] = _zarr().open_array(self.path / name, mode="r+")
        return self._arrays[name]

    def _lay_out(self, here: Identity) -> None:
        """Make the arrays that are not there, lengthen those that are, and say what they are."""
        forms = [np.broadcast_to(np.zeros((), x.dtype), x.shape) for x in jax.tree.leaves(self.results)]
        arrays = self._named(forms)
        taken, count = {x.name for x in arrays} | {_STORED}, self.extent.count
        given = [x._replace(values=_plain(x.values)) for x in _apart(self._parameters(), taken)]
        self.parameters = [x.name for x in given]
        told = {"long_name": "whether the run is in the store"}
        all_of_them = [*arrays, *given, Named(_STORED, (_RUN,), np.zeros(count, bool), told)]
        if self._is_laid_out([x.name for x in all_of_them], given):
            return
        self._arrays.clear()
        group = self._group()
        if group is None:
            _unmade(self.path)
            group = _zarr().open_group(self.path, mode="a", zarr_format=3)
        for each in (Named(_SWEEP, (), np.zeros((), np.int8), {}), *all_of_them):
            self._make(group, each)
        words = {name: mark.words for name, mark in here.items() if name not in _EFFECTS}
        group[_SWEEP].attrs.put({"fingerprint": self.folder.sweep} | words)
        for each in given:
            group[each.name][:] = each.values  # those that are there are the same, or damaged
        labels = label_arrays(self.labels, {dim for x in arrays for dim in x.dims}, self.times)
        if not all(x.name in group for x in labels):
            as_dataset([], labels, {}).to_zarr(self.path, mode="a", zarr_format=3, consolidated=False)
        note: dict[str, Any] = dict(about(self.times.dtype))
        # What stands along dimensions under another name than theirs; xarray reads it here.
        beside = " ".join(x.name for x in [*given, *labels] if (x.name,) != x.dims)
        note |= {"parameters": self.parameters, "coordinates": beside, "runs": count}
        if isinstance(self.rows, Parameters):
            note |= laid_out(self.rows)
        # Opened with the list of all arrays, if there is one, so that it stays beside the attributes.
        _zarr().open_group(self.path, mode="r+").attrs.update(note)
        # Last: readers go by that list, and see the shorter arrays until it is written anew.
        _zarr().consolidate_metadata(self.path)

    def _is_laid_out(self, names: Sequence[str], given: Sequence[Named]) -> bool:
        """Whether all arrays are there, of this sweep's length and parameters, and readers know it."""
        try:
            listed = _zarr().open_group(self.path, mode="r", use_consolidated=True)
            lengths = {x.shape[0] for name in names for x in (listed[name], self._array(name))}
            grid = laid_out(self.rows) if isinstance(self.rows, Parameters) else {}
            same = all(listed.attrs.get(name) == value for name, value in grid.items())
            same = same and all(self._array(x.name)[:].tobytes() == x.values.tobytes() for x in given)
            return same and lengths == {self.extent.count} == {listed.attrs["runs"]}
        except Exception:  # not there, or damaged, which may raise anything
            return False

    def _make(self, group: Any, each: Named) -> None:
        """Make one array, or lengthen the one that is there if it is like it."""
        rest = each.values.shape[1:]
        along = each.dims[:1] == (_RUN,)
        shape = (self.extent.count, *rest) if along else ()
        chunks = (self.extent.size, *(max(n, 1) for n in rest)) if along else ()
        with contextlib.suppress(Exception):  # not there, or damaged, which may raise anything
            there = group[each.name]
            alike = (there.dtype, there.chunks, there.shape[1:], there.metadata.dimension_names or ())
            if alike == (each.values.dtype, chunks, rest, each.dims) and there.shape <= shape:
                return there.resize(shape)
        _unmade(self.path / each.name)
        blank = _BLANKS.get(each.values.dtype.kind, 0)
        options = {"dimension_names": each.dims, "fill_value": blank, "attributes": each.attrs}
        # The folder of `sweep` holds the manifest, which an array that overwrites another would remove.
        options |= {"chunks": chunks, "overwrite": along, "compressors": None, "filters": None}
        group.create_array(each.name, shape=shape, dtype=each.values.dtype, **options)


def _unmade(path: Path) -> None:
    """Remove what says what a folder holds, where that is damaged: Zarr reads it before it writes it anew."""
    with contextlib.suppress(OSError):
        (path / "zarr.json").unlink(missing_ok=True)


def _apart(parameters: Sequence[Named], taken: set[str]) -> list[Named]:
    """Parameters under names that no result has, nor another parameter."""
    found, known = [], taken | {each.name for each in parameters}
    for each in parameters:
        name = each.name
        if name in taken:
            while name in known:
                name = f"parameter_{name}"
        known.add(name)
        found.append(each._replace(name=name))
    return found


def _plain(values: Any) -> np.ndarray:
    """An array of a dtype that Zarr knows: those that NumPy lacks (bfloat16) fit into single precision."""
    array = np.asarray(values)
    return array.astype(np.float32) if array.dtype.kind == "V" else array


def _zarr() -> Any:
    """The library zarr, imported with the first call."""
    try:
        import zarr
    except ImportError:
        raise missing_library("zarr", "data") from None
    return zarr
