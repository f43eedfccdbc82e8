"""Points as text (CSV) and as NumPy files; units are the caller's.

Python's `csv` reads and writes the fields. Which character separates them is decided here line by line,
because `csv.Sniffer` takes the decimal comma of "1,5;2,5" for the separator, and finds none in columns
aligned by blanks.
"""

import contextlib
import csv
import re
from pathlib import Path

import numpy as np

from .._results import shown

# Tables of fewer lines are read line by line.
_LONG = 1000
# The unit of a column, behind its name at the head of a table, and how many bytes of a file may be its head.
_UNIT, _HEAD = re.compile(r".*\w\s*\[(m|cm|mm|um|in)\]"), 4096
# What begins like a number: a digit, perhaps after signs of any typography, brackets and a decimal mark.
_LIKE = re.compile(r"""[\s("'+\-\u00b1\u2010-\u2015\u2212\ufe63\uff0b\uff0d]*[.,]?\d""")


def read_csv(path: Path, columns: tuple[int, ...]) -> np.ndarray:
    """These columns of a text table, shape (n, k); text after '#' and lines of words at the head are skipped.

    Fields are parted by commas, semicolons (then a comma may be the decimal point), tabs or blanks; between
    commas or semicolons they may stand in double quotes.

    Raises:
        ValueError: If a line is not finite numbers, or has too few; its number is named. A line of words is
            one of whose fields none is a number, a NaN or an infinity; and where a field in these columns
            begins like one, the line is not parted as the rows below it are. Or if commas part some rows into
            more numbers than others: then they may be decimal ones.
    """
    lines = _text(path).splitlines()
    table = _regular(lines, columns)
    if table is not None:
        return _table(table, path)
    rows: list[list[float]] = []
    doubtful: dict[tuple[str, int], tuple[int, str]] = {}  # by what parts a line, and into how many fields
    widths: dict[int, int] = {}  # of lines that commas part into numbers alone, the first of each width
    for number, line in enumerate(lines, start=1):
        text = line.split("#")[0]
        fields = _fields(text)
        if not fields:
            continue
        row, parted = _numbers(fields, columns), (_mark(text), len(fields))
        if row is None and (rows or any(_number(field) is not None for field in fields)):
            raise _no_numbers(number, line, path)
        if row is not None:
            # A number that is not understood, as with a unit or a typographic minus, is no word: with the
            # head a row of the table would be left out. A title such as "3D scan" is parted otherwise.
            if parted in doubtful:
                raise _no_numbers(*doubtful[parted], path)
            rows.append(row)
            if parted[0] == "," and None not in map(_number, fields):
                widths.setdefault(len(fields), number)
        elif any(_LIKE.match(fields[i]) for i in columns if i < len(fields)):
            doubtful.setdefault(parted, (number, line))
    if not rows and doubtful:
        raise _no_numbers(*list(doubtful.values())[-1], path)
    _check_widths(widths, path)
    return _table(np.array(rows).reshape(-1, len(columns)), path)


def _check_widths(widths: dict[int, int], path: Path) -> None:
    """Refuse a table whose commas part its rows into several numbers of numbers, given one line of each."""
    if len(widths) > 1:
        (width, line), (other, later) = list(widths.items())[:2]
        raise ValueError(
            f"argument path must name a table of finite numbers, but line {line} of {path.name} has {width} "
            f"between its commas, and line {later} has {other}; if commas are decimal marks, part columns "
            f"by semicolons or blanks"
        )


def _no_numbers(number: int, line: str, path: Path) -> ValueError:
    return ValueError(
        f"argument path must name a table of finite numbers, but line {number} of {path.name} "
        f"was {shown(line)}"
    )


def check_unit(path: Path, columns: tuple[int, ...], unit: str) -> None:
    """Raise where the head of a table states another unit for these columns, as in "# x [mm], y [mm]"."""
    if path.suffix.lower() == ".npy":
        return
    with path.open("rb") as file:
        head = file.read(_HEAD).decode("latin-1").splitlines()
    for line in head:
        fields = _fields(line.strip().lstrip("#"))
        if _numbers(fields, columns) is not None:
            return
        found = [_UNIT.fullmatch(fields[i]) for i in columns if i < len(fields)]
        other = [each[1] for each in found if each is not None and each[1] != unit]
        if other:
            raise ValueError(
                f"argument unit must agree with {path.name}, whose head states {other[0]!r}, but was {unit!r}"
            )


def table_width(path: Path) -> int:
    """How many columns a table has, CSV or NPY: those of the first line with a number; 0 without one."""
    if path.suffix.lower() == ".npy":
        with contextlib.suppress(ValueError, EOFError, OSError):
            shape = getattr(np.load(path, allow_pickle=False, mmap_mode="r"), "shape", ())
            return shape[1] if len(shape) == 2 else 0
        return 0
    return len(_fields(first_numbers(path)))


def first_numbers(path: Path) -> str:
    """The first line of a text table with a number, without its remark; empty where there is none."""
    for line in _text(path).splitlines():
        text = line.split("#")[0]
        if any(_number(field) is not None for field in _fields(text)):
            return text.strip()
    return ""


def _regular(lines: list[str], columns: tuple[int, ...]) -> np.ndarray | None:
    """A long table without words, by NumPy's reader, which is ten times as fast; None if it has others."""
    first = lines[0] if lines else ""
    marks = [mark for mark in ',;#"' if mark in first]
    if len(lines) < _LONG or marks not in ([], [","]) or None in map(_number, _fields(first)):
        return None
    if marks and len({line.count(",") for line in lines if line}) > 1:
        return None
    try:
        table = np.loadtxt(lines, delimiter="," if marks else None, usecols=columns, ndmin=2)
    except ValueError:
        return None
    return table if np.isfinite(table).all() else None


def _text(path: Path) -> str:
    """A file's text, decoded as UTF-16 if it begins with that mark, else as UTF-8, else as Latin-1."""
    content = path.read_bytes()
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", errors="replace")
    if b"\0" in content:
        raise ValueError(f"argument path must name a table of numbers, but {path.name} is no text")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _fields(line: str) -> list[str]:
    """The fields of a line, with decimal points; an empty field between two separators is kept as one."""
    line = line.strip()
    if not line:
        return []
    if ";" in line:
        return [field.replace(",", ".") for field in _parted(line, ";")]
    if "," in line and re.fullmatch(r"[^,\s]*,[^,\s]*(\s+[^,\s]*,[^,\s]*)+", line):
        # Fields separated by blanks, with one comma in each ("1,5 2,5"): these are decimal commas, since no
        # table has two separators.
        return [field.replace(",", ".") for field in line.split()]
    return _parted(line, ",") if "," in line else line.split()


def _mark(line: str) -> str:
    """What parts a line's fields: semicolons, commas or, as an empty text, blanks."""
    return next((mark for mark in ";," if mark in line), "")


def _parted(line: str, mark: str) -> list[str]:
    """The fields of a line that a character separates; a separator within quotes does not count."""
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=mark, skipinitialspace=True))]
    except csv.Error:  # a field of more than 131 072 characters, which is no number
        return [line]


def _number(field: str) -> float | None:
    # Python takes 1_0 for 10.
    if "_" in field:
        return None
    try:
        return float(field)
    except ValueError:
        return None


def _numbers(fields: list[str], columns: tuple[int, ...]) -> list[float] | None:
    """The finite numbers in these columns; None unless all are there."""
    row = [_number(fields[i]) for i in columns if i < len(fields)]
    found = [x for x in row if x is not None and np.isfinite(x)]
    return found if len(found) == len(columns) else None


def read_npy(path: Path, columns: tuple[int, ...]) -> np.ndarray:
    """These columns of an array of shape (n, any) in an NPY file, shape (n, k)."""
    try:
        # A pickle in a file from elsewhere could run any code.
        array = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise ValueError(
            f"argument path must name an array of numbers, but {path.name} was none: {shown(str(error))}"
        ) from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf":
        what = array.dtype if isinstance(array, np.ndarray) else "several arrays"
        raise ValueError(f"argument path must name an array of real numbers, but {path.name} has {what}")
    if array.ndim != 2 or array.shape[1] <= max(columns):
        raise ValueError(
            f"argument path must name an array with columns {columns}, but {path.name} has "
            f"shape {array.shape}"
        )
    return _table(array[:, list(columns)].astype(float), path)


def _table(points: np.ndarray, path: Path) -> np.ndarray:
    """The points, if there are any and all are finite."""
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(points) == 0 or len(bad):
        what = f"row {bad[0]} was {points[bad[0]].tolist()}" if len(bad) else "there was none"
        raise ValueError(f"argument path must name a table of finite numbers, but in {path.name} {what}")
    return points


def write_csv(path: Path, points: np.ndarray, unit: str) -> None:
    """Write a header with the unit, then a line per point with x and y, in digits that read back exactly."""
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(f"# x [{unit}], y [{unit}]\n")
        csv.writer(file, lineterminator="\n").writerows(points.tolist())
