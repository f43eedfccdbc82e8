"""Plain descriptions of values, and what differs between two of them.

A description holds dictionaries, lists, text, numbers and None alone. Numbers of one list are compared at the
scale of its largest, `RTOL` of it unless a tolerance is asked for: processors round differently. A key that
ends in "±0.1" says that all below it may differ by so much.
"""

import base64
import collections
import dataclasses
import enum
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

RECORDS = Path(__file__).parent / "records"
# Of the largest number of a list; states on different processors differ by far less.
RTOL = 1e-5
# What is smaller is rounding: millimetres of a picture.
ATOL = 1e-7
# Lists with no more numbers are kept whole.
_WHOLE = 12
_NUMBER = re.compile(r"[-+\N{MINUS SIGN}]?\d+\.\d*(?:e[-+]?\d+)?|[-+]?\d+e[-+]?\d+")
_MOST_TOLD = 12
# Levels of a record that have lines of their own.
_DEPTH = 2


def described(value: Any) -> Any:
    """A value in plain words: arrays by `of_array`, records by their fields, functions by their names."""
    if value is None or isinstance(value, bool | str | int) and not isinstance(value, enum.Enum):
        return value
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, dict) and set(value) >= {"bdata", "dtype"}:  # an array as plotly keeps it
        flat = np.frombuffer(base64.b64decode(value["bdata"]), value["dtype"])
        return of_array(flat)
    if isinstance(value, dict):
        return {str(key): described(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return _of_list(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return of_fields(value)
    if hasattr(value, "__array__") or isinstance(value, np.generic):
        return of_array(np.asarray(value))
    return getattr(value, "__qualname__", type(value).__qualname__)


def of_fields(value: Any) -> dict[str, Any]:
    """A record by its fields."""
    found = {field.name: described(getattr(value, field.name, None)) for field in dataclasses.fields(value)}
    return {"class": type(value).__name__} | found


def _of_list(value: Any) -> Any:
    if value and all(isinstance(each, str) for each in value) and len(value) > _WHOLE:
        return {"count": len(value), "each": dict(sorted(collections.Counter(value).items()))}
    if value and all(isinstance(each, int | float) and not isinstance(each, bool) for each in value):
        return of_array(np.asarray(value, float))
    return [described(each) for each in value]


def of_array(array: np.ndarray) -> Any:
    """Numbers: all of them if there are few, or else some rows and two averages."""
    if array.dtype == object or array.dtype.kind in "US":
        return _of_list([str(each) for each in array.ravel()])
    if array.dtype.kind == "b" or array.ndim == 0:
        return described(array.tolist())
    array = np.asarray(array, float)
    if array.size <= _WHOLE:
        return {"shape": list(array.shape), "values": _numbers(array)}
    rows = array.reshape(len(array), -1)
    finite = np.isfinite(rows)
    picks = sorted({0, 1, len(rows) // 3, len(rows) // 2, len(rows) - 2, len(rows) - 1})
    wave = np.cos(1.0 + np.arange(rows.size)).reshape(rows.shape)
    plain = np.where(finite, rows, 0.0)
    # Sums tell of any one of the numbers, the weighted one also of their order.
    sums = [float(plain.sum()), float((wave * plain).sum())]
    ends = [float(plain.min()), float(plain.max())]
    return {
        "shape": list(array.shape),
        "missing": int((~finite).sum()),
        "least and most": _numbers(np.array(ends)),
        f"rows {', '.join(map(str, picks))}": _numbers(rows[picks][:, :_WHOLE]),
        "mean and weighted mean": _numbers(np.array([*sums, float(np.abs(plain).sum())]) / rows.size),
    }


def _numbers(array: np.ndarray) -> list[float | None]:
    return [_number(float(x)) for x in np.ravel(array)]


def _number(x: float) -> float | None | str:
    if math.isnan(x):
        return None
    if math.isinf(x):
        return "infinite" if x > 0.0 else "-infinite"
    return x


def differences(found: Any, record: Any, rtol: float = RTOL, atol: float = ATOL) -> list[str]:
    """One sentence for each thing that is not as recorded."""
    return list(_differing(found, record, "", rtol, atol))


def _differing(found: Any, record: Any, place: str, rtol: float, atol: float) -> Iterator[str]:
    if isinstance(found, dict) and isinstance(record, dict):
        for key in [*record, *(key for key in found if key not in record)]:
            below = f"{place} > {key}" if place else key
            if key not in found:
                yield f"{below}: is gone, was {_short(record[key])}"
            elif key not in record:
                yield f"{below}: is new, {_short(found[key])}"
            else:
                wide = float(key.split("±")[1]) if "±" in key else atol
                yield from _differing(found[key], record[key], below, rtol, wide)
    elif isinstance(found, list) and isinstance(record, list) and len(found) == len(record):
        if all(_is_number(x) for x in (*found, *record)):
            scale = max((abs(x) for x in record if x is not None), default=0.0)
            for i, (x, y) in enumerate(zip(found, record, strict=True)):
                if not _close(x, y, atol + rtol * scale):
                    yield f"{place}: number {i} is {x}, was {y}"
            return
        for i, (x, y) in enumerate(zip(found, record, strict=True)):
            yield from _differing(x, y, f"{place} > {i}", rtol, atol)
    elif not _same(found, record, rtol, atol):
        yield f"{place}: is {_short(found)}, was {_short(record)}"


def _is_number(x: Any) -> bool:
    return x is None or isinstance(x, int | float) and not isinstance(x, bool)


def _close(x: float | None, y: float | None, within: float) -> bool:
    if x is None or y is None:
        return x is y
    return abs(x - y) <= within


def _same(found: Any, record: Any, rtol: float, atol: float) -> bool:
    if isinstance(found, str) and isinstance(record, str):
        return _same_text(found, record)
    if isinstance(found, bool) or isinstance(record, bool) or not (_is_number(found) and _is_number(record)):
        return found is record or found == record and type(found) is type(record)
    if isinstance(found, int) and isinstance(record, int) and atol < 1e-3:
        return found == record
    return _close(found, record, atol + rtol * abs(record or 0.0))


def _same_text(found: str, record: str) -> bool:
    """Texts that differ by no more than one unit of the last digit of a fraction."""
    if found == record:
        return True
    if _NUMBER.split(found) != _NUMBER.split(record):
        return False
    pairs = zip(_NUMBER.findall(found), _NUMBER.findall(record), strict=True)
    return all(abs(_read(x) - _read(y)) <= 1.01 * _last(y) for x, y in pairs)


def _read(text: str) -> float:
    return float(text.replace("\N{MINUS SIGN}", "-"))


def _last(text: str) -> float:
    """One unit of the last digit of a number as written."""
    digits, _, power = text.partition("e")
    return 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 160 else f"{text[:150]} ..."


def path_of(name: str) -> Path:
    """The file of a record."""
    return RECORDS / f"{name}.json"


def write(name: str, found: Any, digits: int = 7) -> None:
    """Take what is as the record, with so many digits."""
    RECORDS.mkdir(exist_ok=True)
    path_of(name).write_text(_laid_out(_rounded(found, digits)) + "\n")


def _rounded(value: Any, digits: int) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(each, digits) for key, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each, digits) for each in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def _laid_out(value: Any, depth: int = 0) -> str:
    """JSON with one line for each artist or the like, so that a change of a record can be read."""
    flat = json.dumps(value, ensure_ascii=False)
    if not isinstance(value, dict) or depth >= _DEPTH or len(flat) + depth <= 110:
        return flat
    inside = " " * (depth + 1)
    rows = [
        f"{inside}{json.dumps(key, ensure_ascii=False)}: {_laid_out(x, depth + 1)}"
        for key, x in value.items()
    ]
    return "{\n" + ",\n".join(rows) + "\n" + " " * depth + "}"


def check(name: str, found: Any, rtol: float = RTOL, atol: float = ATOL) -> None:
    """Raise where something is not as recorded."""
    told = differences(found, json.loads(path_of(name).read_text()), rtol, atol)
    more = [f"... and {len(told) - _MOST_TOLD} more"] if len(told) > _MOST_TOLD else []
    assert not told, "\n".join(
        [f"{name} is not as recorded (`python -m tests.recorded --write {name}` takes it as it is):"]
        + told[:_MOST_TOLD]
        + more
    )
