"""The table of a sweep as files: what the parameters were, and what was kept of each run.

Here alone `jaxroll sweep` writes a table and `jaxroll map` reads it: `table.npz` by `jaxroll.save` has every
number as it was, and `table.csv` is for other programs, with the names of codes. A store, which the function
`sweep` fills, is read here too.
"""

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from .._integration import flag_words, open_table
from .._printing import code_name, code_of, is_code, number_of
from .._saving import load, save
from .._sweep import Parameters

_FILE, _TEXT = "table.npz", "table.csv"


class SweepTable(NamedTuple):
    """What a sweep gives.

    Attributes:
        parameters: A row for each run.
        values: By name what was kept, with a leading axis of rows.
        scene: What was swept.
    """

    parameters: Parameters
    values: dict[str, Any]
    scene: str


def write_table(folder: Path, table: SweepTable) -> list[str]:
    """Write a table; returns the names of the files."""
    save(folder / _FILE, table._asdict())
    columns = dict(flat_columns(table))
    with (folder / _TEXT).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*(entries_of(column) for column in columns.values()), strict=True))
    return [_FILE, _TEXT]


def read_table(folder: Path) -> SweepTable:
    """Read what `write_table` wrote.

    Raises:
        ValueError: If there is none, or it is damaged.
    """
    if (folder / "zarr.json").is_file():
        return _stored(folder)
    if not (folder / _FILE).is_file():
        raise ValueError(
            f"argument STORE must be the folder of a sweep that is done, but {folder} has no {_FILE}"
        )
    try:
        return SweepTable(**load(folder / _FILE))
    except TypeError:
        raise ValueError(
            f"argument STORE must be the folder of a sweep, but {folder / _FILE} is of none"
        ) from None


def _stored(folder: Path) -> SweepTable:
    """The table in a store, whole or still filling."""
    table = open_table(folder)
    parameters = Parameters.of_table(table)
    beside = {*table.attrs["parameters"], "stored", "sweep"}
    values = {
        str(name): each
        for name, each in table.data_vars.items()
        if name not in beside and each.dims[:1] == ("run",) and each.dtype.kind in "fiub"
    }
    return SweepTable(parameters, values, folder.name)


def flat_columns(table: SweepTable) -> Iterator[tuple[str, Any]]:
    """Columns of one number or code for each row, by name: NAME.PART of a record, NAME[0] of an array."""
    for name, column in zip(table.parameters.names, table.parameters.columns, strict=True):
        yield from _flat(name, column)
    yield from flat_values(table.values)


def flat_values(values: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """The columns of what was kept, named as by `flat_columns`."""
    for path, leaf in jax.tree.leaves_with_path(values, is_leaf=is_code):
        yield from _flat(jax.tree_util.keystr(path, simple=True, separator="."), leaf)


def _flat(name: str, column: Any) -> Iterator[tuple[str, Any]]:
    if is_code(column) or np.ndim(column) == 1:
        yield name, column
        return
    for index in np.ndindex(*np.shape(column)[1:]):
        yield f"{name}[{', '.join(map(str, index))}]", np.asarray(column)[:, *index]


def entries_of(column: Any) -> list[Any]:
    """The entries of a column, as they are written."""
    if words := flag_words(column):
        return [words[number] for number in np.asarray(column).tolist()]
    if not is_code(column):
        return np.asarray(column).tolist()
    kind, numbers = number_of(column)
    present, which = np.unique(np.asarray(numbers), return_inverse=True)
    names = [code_name(code_of(kind, number)) for number in present]
    return [names[k] for k in which.ravel()]
