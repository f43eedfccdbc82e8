"""The folder of a sweep: a manifest that says which sweep it is, and chunks that identify themselves.

Every file is written under a name of its own and put in its place in one move, so that a process that is
killed leaves nothing half done. Processes on one folder share the chunks: whoever works on one holds a lock
that ends with the process.
"""

import contextlib
import hashlib
import io
import json
import os
import secrets
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from .._results import shown
from ._identity import combined, differences, Identity, Mark

try:
    import fcntl
except ImportError:  # on Windows, where two processes work out the same chunks
    fcntl = None

_FORMAT = 1
_MANIFEST = "sweep.json"


class Folder:
    """A folder where finished chunks are written, and looked for first."""

    def __init__(self, given: Any) -> None:
        """Args: the path; it is made, and refused unless it can be written."""
        if not isinstance(given, str | os.PathLike) or not os.fspath(given):
            raise ValueError(f"argument resume must be the path of a folder, but was {shown(given)}")
        self.path, self.sweep = Path(os.fsdecode(given)), ""
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            _written(self.path / "probe", b"", lambda part, _: None)
        except (OSError, ValueError) as error:  # a name with a null character is the latter
            raise self._unwritable(error) from None

    def check(self, here: Identity) -> None:
        """Raise if the folder is of another sweep, as far as this one is known."""
        there = self._manifest()
        if there is not None:
            self._compare(there, here)

    def open(self, here: Identity) -> None:
        """Make the folder this sweep's, if it is not yet; raise if it is another's."""
        self.sweep, there = combined(here), self._manifest()
        if there is not None:
            self._compare(there, here)
            return
        self._warn_of_loss()
        try:
            self._claim_folder(here)
        except OSError as error:
            raise self._unwritable(error) from None

    def load(self, start: int, forms: Sequence[Any], *, quiet: bool = False) -> list[np.ndarray] | None:
        """The chunk that begins with a run, if it is there, whole, and of this sweep; else None.

        Args:
            start: Index of the first run.
            forms: Shapes and kinds of its arrays.
            quiet: Whether to say nothing of a file that is passed over.
        """
        path = self._chunk(start)
        try:
            leaves = self._read(path, start, forms)
            path.with_suffix(".lock").unlink(missing_ok=True)  # of a process that was killed just afterwards
            return leaves
        except FileNotFoundError:
            return None
        except Exception as error:  # a damaged file may raise anything
            if not quiet:
                why = str(error) if isinstance(error, _Refused) else "it cannot be read"
                _warn(f"the chunk {path} of a sweep is worked out again, because {why}")
            return None

    def store(self, start: int, leaves: Sequence[np.ndarray]) -> None:
        """Write a chunk; where that fails the sweep goes on, with a warning."""
        path, held = self._chunk(start), io.BytesIO()
        marks = {"index": start, "sweep": self.sweep, "checksum": self._checksum(start, leaves)}
        np.savez(held, **{f"arr_{i}": _plain(leaf) for i, leaf in enumerate(leaves)}, **marks)
        try:
            _written(path, held.getbuffer(), os.replace)
        except OSError as error:
            _warn(
                f"the chunk {path} of a sweep could not be written ({error.strerror}), but its runs are used"
            )

    @contextlib.contextmanager
    def work_on(self, start: int, *, wait: bool) -> Iterator[bool]:
        """Whether a chunk is for this thread alone to work out; if told to, wait until no other is at it."""
        path = self._chunk(start)
        lock = path.with_suffix(".lock")
        try:
            file = _locked(lock, wait)
        except BlockingIOError:
            yield False
            return
        if file is None:
            yield True
            return
        with file:
            # Nobody else writes this chunk: what else bears its name is of processes that were killed.
            for part in self.path.glob(f"{path.name}.*.part"):
                part.unlink(missing_ok=True)
            try:
                yield True
            finally:
                # Whoever waits for a lock that is gone finds the chunk finished.
                lock.unlink(missing_ok=True)

    def _chunk(self, start: int) -> Path:
        return self.path / f"runs_{start:010d}.npz"

    def _manifest(self) -> Identity | None:
        """The sweep that the folder is of; None where it does not say so, with a warning if it should."""
        path = self.path / _MANIFEST
        try:
            held = json.loads(path.read_bytes())
            marks = {name: Mark(*mark) for name, mark in held["identity"].items()}
            if held["sweep"] == combined(marks) and held["format"] == _FORMAT:
                return marks
        except Exception:  # it is not there, or damaged, which may raise anything
            return None
        return None

    def _unwritable(self, error: Exception) -> ValueError:
        why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        return ValueError(
            f"argument resume must be a folder that can be written, but {shown(str(self.path))} "
            f"cannot ({why.lower()})"
        )

    def _compare(self, there: Identity, here: Identity) -> None:
        found = differences(there, here)
        if found:
            raise ValueError(
                f"argument resume must be a folder of the same sweep, but {self.path} is of one that "
                f"differs in {found}"
            )

    def _warn_of_loss(self) -> None:
        path = self.path / _MANIFEST
        if path.exists():
            _warn(f"the manifest {path} of a sweep is written again, because it is damaged")
        elif any(self.path.glob("runs_*.npz")):
            _warn(f"the manifest {path} of a sweep is written again, because it is missing")

    def _claim_folder(self, here: Identity) -> None:
        """Write the manifest; of several processes that do so at once the first decides."""
        path = self.path / _MANIFEST
        held = {"format": _FORMAT, "sweep": self.sweep, "identity": here}
        data = json.dumps(held, indent=1).encode()
        try:
            _written(path, data, os.link)
        except FileExistsError:
            there = self._manifest()
            if there is not None:
                self._compare(there, here)
                return
            _written(path, data, os.replace)
        except OSError:  # a file system without links
            _written(path, data, os.replace)

    def _checksum(self, start: int, leaves: Sequence[np.ndarray]) -> str:
        digest = hashlib.sha256(f"{self.sweep} {start}".encode())
        for leaf in leaves:
            digest.update(f"{leaf.dtype} {leaf.shape}".encode())
            digest.update(np.ascontiguousarray(leaf).tobytes())
        return digest.hexdigest()

    def _read(self, path: Path, start: int, forms: Sequence[Any]) -> list[np.ndarray]:
        with path.open("rb") as raw, np.load(raw) as file:
            held = {name: file[name] for name in file.files}
        if set(held) != {"index", "sweep", "checksum", *(f"arr_{i}" for i in range(len(forms)))}:
            _refuse("it does not say of which sweep it is")
        if str(held["sweep"]) != self.sweep:
            _refuse("it is of another sweep")
        if int(held["index"]) != start:
            _refuse("it holds other runs")
        found = [(held[f"arr_{i}"], form.dtype) for i, form in enumerate(forms)]
        leaves = [x.view(dtype) if dtype.kind == "V" else x for x, dtype in found]
        if self._checksum(start, leaves) != str(held["checksum"]):
            _refuse("its checksum is not that of what it holds")
        if any(x.shape != form.shape for x, form in zip(leaves, forms, strict=True)):
            _refuse("its arrays have other shapes")
        return leaves


class _Refused(Exception):
    """A chunk that is not what it should be."""


def _refuse(why: str) -> NoReturn:
    raise _Refused(why)


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=2)


def _plain(leaf: np.ndarray) -> np.ndarray:
    """An array that NumPy can write: numbers of 16 bits that it does not know become whole numbers."""
    return leaf.view(f"u{leaf.dtype.itemsize}") if leaf.dtype.kind == "V" else leaf


def _written(path: Path, data: Any, put: Any) -> None:
    """Write a file under a name that nobody else has; then `put(that, path)`."""
    part = path.with_name(f"{path.name}.{os.getpid()}.{secrets.token_hex(4)}.part")
    try:
        with part.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        put(part, path)
    finally:
        part.unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # a folder cannot be opened everywhere
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _locked(path: Path, wait: bool) -> Any:
    """An open file that this thread has locked, until it is closed or the process ends.

    None where files cannot be locked: then processes may work out the same chunk, each for itself.

    Raises:
        BlockingIOError: If another has it and this one is not to wait.
    """
    if fcntl is None:
        return None
    try:
        file = path.open("ab")
    except OSError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        file.close()
        if isinstance(error, BlockingIOError):
            raise
        return None
    return file
