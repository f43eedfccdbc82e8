"""Files and folders as arguments: one that cannot be read or written is refused before any work is done."""

import os
from pathlib import Path
from typing import Any

from .._results import shown, told


def as_path(path: Any, kinds: tuple[str, ...]) -> Path:
    """An argument as a path whose ending is one of these."""
    if not isinstance(path, str | os.PathLike) or "\0" in str(path):
        raise ValueError(f"argument path must be the name of a file, but was {shown(path)}")
    found = Path(path)
    if found.suffix.lower() not in kinds:
        raise ValueError(f"argument path must end in {', '.join(kinds)}, but was {shown(str(found))}")
    return found


def readable(path: Path, holding: str = "points") -> Path:
    """The path, if it is a file that can be read and is not empty."""
    if not os.path.isfile(path):  # of a name that is too long `path.is_file` raises
        what = "is a folder" if os.path.isdir(path) else "is not there"
        raise ValueError(f"argument path must name a file, but {shown(str(path))} {what}")
    try:
        with path.open("rb") as file:
            empty = not file.read(1)
    except OSError as error:
        raise ValueError(
            f"argument path must name a file that can be read, but {told(path, error)}"
        ) from None
    if empty:
        raise ValueError(f"argument path must name a file with {holding}, but {shown(str(path))} is empty")
    return path


def writable(path: Path) -> Path:
    """The path, if a file can be written there; its folder is made if need be.

    Opening for appending is the test, which leaves an existing file as it is; an empty one that it created is
    removed again.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        there = path.exists()
        with path.open("ab"):
            pass
        if not there:
            path.unlink()
    except OSError as error:
        raise ValueError(
            f"argument path must name a file that can be written, but {told(path, error)}"
        ) from None
    return path
