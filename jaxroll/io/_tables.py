"""Points as text (CSV) and as NumPy files; units are the caller's."""

import re
from pathlib import Path

import numpy as np


def read_csv(path: Path, columns: tuple[int, int]) -> np.ndarray:
    """Two columns of a text table; lines above the first numbers and after '#' are passed over.

    Fields are parted by commas, semicolons (then a comma may be the decimal point), tabs or blanks.

    Raises:
        ValueError: If a line is not numbers, or has too few; its number is named.
    """
    rows = []
    for number, line in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), start=1):
        fields = _fields(line.split("#")[0])
        if not fields:
            continue
        row = _numbers(fields, columns)
        if row is None and rows:
            raise ValueError(
                f"argument path must name a table of finite numbers, but line {number} of {path.name} "
                f"was {line!r:.60}"
            )
        if row is not None:
            rows.append(row)
    return _table(np.array(rows).reshape(-1, 2), path)


def _fields(line: str) -> list[str]:
    line = line.strip()
    if ";" in line:
        return [field.strip().replace(",", ".") for field in line.split(";")]
    return [field for field in re.split(r"\s*,\s*|\s+", line) if field] if line else []


def _numbers(fields: list[str], columns: tuple[int, int]) -> list[float] | None:
    try:
        row = [float(fields[i]) for i in columns]
    except (ValueError, IndexError):
        return None
    return row if np.all(np.isfinite(row)) else None


def read_npy(path: Path, columns: tuple[int, int]) -> np.ndarray:
    """Two columns of an array of shape (n, 2 or more)."""
    array = np.load(path, allow_pickle=False)
    if array.ndim != 2 or array.shape[1] <= max(columns):
        raise ValueError(
            f"argument path must name an array with columns {columns}, but {path.name} has "
            f"shape {array.shape}"
        )
    return _table(array[:, list(columns)].astype(float), path)


def _table(points: np.ndarray, path: Path) -> np.ndarray:
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(points) == 0 or len(bad):
        what = f"row {bad[0]} was {points[bad[0]].tolist()}" if len(bad) else "there was none"
        raise ValueError(f"argument path must name a table of finite numbers, but in {path.name} {what}")
    return points


def write_csv(path: Path, points: np.ndarray, unit: str) -> None:
    """A header with the unit, then x and y, to the last digit."""
    lines = [f"# x [{unit}], y [{unit}]", *(f"{x!r},{y!r}" for x, y in points.tolist())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
