"""The folder of a sweep: a manifest that says which sweep it is of, and one file for each finished chunk.

`sweep.json` holds the `Identity` of the sweep, `runs_NNN.npz` the results of the chunk whose first run is NNN
together with the sweep's fingerprint and a checksum. So a chunk that was copied from elsewhere, cut short or
altered is recognised, and computed again.

Every file is first written under a temporary name and then renamed in one step, so that a process that is
killed leaves no half-written file under a final name. Several processes may work on one folder: whoever
computes a chunk holds a lock on a file beside it (`flock`), which the operating system releases when the
process ends, however it ends. `_sweep` calls `check` and `open` once, and `work_on`, `load` and `store` for
every chunk; workers (`_sending`) call `write`, and report its failures. A `Store` has a `Folder` too, for its
manifest, its locks and the checksums of its chunks.
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
except ImportError:  # on Windows; there two processes on one folder may compute the same chunk twice
    fcntl = None

_FORMAT = 1
_MANIFEST = "sweep.json"


class Folder:
    """A folder where finished chunks are written, and looked for first.

    Args:
        given: Its path.
        name: The name of the argument that gave it, for errors.
        suffix: The ending of the files that say which chunks there are.
        inner: A folder within the given one, where these files are; "" for the given one itself.
    """

    def __init__(self, given: Any, name: str = "resume", suffix: str = ".npz", inner: str = "") -> None:
        """Make the folder if need be; raise a ValueError unless it can be written."""
        self.name, self.suffix = name, suffix
        if not isinstance(given, str | os.PathLike) or not os.fspath(given):
            raise ValueError(f"argument {name} must be the path of a folder, but was {shown(given)}")
        # In full, since other processes that are sent the folder may have another working directory.
        self.given, self.sweep = Path(os.path.abspath(os.fsdecode(given))), ""
        self.path = self.given / inner
        # A temporary file is written and removed, since permissions alone do not tell (a read-only mount).
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            _written(self.path / "probe", b"", lambda part, _: None)
        except (OSError, ValueError) as error:  # a name with a null character is the latter
            raise self._unwritable(error) from None

    def check(self, here: Identity) -> None:
        """Raise if the folder is of another sweep, judged by what is known of this one so far.

        Called before the program is traced, so that a wrong folder is refused at once.
        """
        there = self._manifest()
        if there is not None:
            self._compare(there, here)

    def open(self, here: Identity) -> None:
        """Write the manifest of this sweep, if there is none; raise if it is of another sweep."""
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
        """Arrays of the chunk that begins at a run; None unless its file is there, whole and of this sweep.

        Args:
            start: Index of the first run.
            forms: Shapes and dtypes that the arrays must have.
            quiet: Whether to give no warning where a file is there but cannot be used.
        """
        path = self.chunk(start)
        try:
            leaves = self._read(path, start, forms)
            # Left by a process that was killed between writing the chunk and removing its lock.
            path.with_suffix(".lock").unlink(missing_ok=True)
            return leaves
        except FileNotFoundError:
            return None
        except Exception as error:  # a damaged file may raise anything
            if not quiet:
                why = str(error) if isinstance(error, _Refused) else "it cannot be read"
                _warn(f"the chunk {path} of a sweep is worked out again, because {why}")
            return None

    def store(self, start: int, leaves: Sequence[np.ndarray]) -> None:
        """Write the file of a chunk; where that fails there is a warning, and the sweep goes on."""
        try:
            self.write(start, leaves)
        except OSError as error:
            self.warn_of_failure(start, str(error.strerror))

    def write(self, start: int, leaves: Sequence[np.ndarray]) -> None:
        """Write the file of a chunk."""
        held = io.BytesIO()
        marks = {"index": start, "sweep": self.sweep, "checksum": self._checksum(start, leaves)}
        np.savez(held, **{f"arr_{i}": _plain(leaf) for i, leaf in enumerate(leaves)}, **marks)
        self.put(start, held.getbuffer())

    def put(self, start: int, data: Any) -> None:
        """Write bytes as the file of a chunk."""
        _written(self.chunk(start), data, os.replace)

    def warn_of_failure(self, start: int, why: str) -> None:
        """Warn that the file of a chunk could not be written."""
        path = self.chunk(start)
        _warn(f"the chunk {path} of a sweep could not be written ({why}), but its runs are used")

    @contextlib.contextmanager
    def work_on(self, start: int, *, wait: bool) -> Iterator[bool]:
        """Context in which this thread alone may compute a chunk; it gives False where another is doing so.

        With `wait` it blocks until the other has finished and then gives True; the chunk's file may be there
        by then, so that it must be looked for first. Where files cannot be locked it always gives True.
        """
        path = self.chunk(start)
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
            # With the lock held nobody else writes this chunk, so that temporary files for it are left from
            # processes that were killed.
            for part in self.path.glob(f"{path.name}.*.part"):
                part.unlink(missing_ok=True)
            try:
                yield True
            finally:
                # The file may be removed while others wait for it: when they get their lock, on a file that
                # has no name any more, they find the chunk finished.
                lock.unlink(missing_ok=True)

    def chunk(self, start: int) -> Path:
        """The path of the file of the chunk that begins at a run."""
        return self.path / f"runs_{start:010d}{self.suffix}"

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Context in which no other process changes the folder as a whole; the manifest must be there."""
        with _locked(self.path / _MANIFEST, wait=True) or contextlib.nullcontext():
            yield

    def _manifest(self) -> Identity | None:
        """What the manifest says of its sweep; None where it is missing, damaged or of another format."""
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
        """The error that says why the folder cannot be written."""
        why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        return ValueError(
            f"argument {self.name} must be a folder that can be written, but {shown(str(self.given))} "
            f"cannot ({why.lower()})"
        )

    def _compare(self, there: Identity, here: Identity) -> None:
        """Raise with what differs, if the folder is of another sweep."""
        found = differences(there, here)
        if found:
            raise ValueError(
                f"argument {self.name} must be a folder of the same sweep, but {self.given} is of one that "
                f"differs in {found}: give another"
            )

    def _warn_of_loss(self) -> None:
        """Warn where there should be a readable manifest: it is damaged, or there are chunks without one."""
        path = self.path / _MANIFEST
        if path.exists():
            _warn(f"the manifest {path} of a sweep is written again, because it is damaged")
        elif any(self.path.glob(f"runs_*{self.suffix}")):
            _warn(f"the manifest {path} of a sweep is written again, because it is missing")

    def _claim_folder(self, here: Identity) -> None:
        """Write the manifest; of several processes that do so at once the first decides.

        `os.link` checks and links in one step, and fails where the name exists; by `os.replace` the last
        process would win.
        """
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
            # What has the name is damaged.
            _written(path, data, os.replace)
        except OSError:  # a file system without links
            _written(path, data, os.replace)

    def _checksum(self, start: int, leaves: Sequence[np.ndarray]) -> str:
        """Digest of a chunk's arrays, of its first run and of the sweep."""
        digest = hashlib.sha256(f"{self.sweep} {start}".encode())
        for leaf in leaves:
            digest.update(f"{leaf.dtype} {leaf.shape}".encode())
            digest.update(np.ascontiguousarray(leaf).tobytes())
        return digest.hexdigest()

    def _read(self, path: Path, start: int, forms: Sequence[Any]) -> list[np.ndarray]:
        """Arrays of a chunk's file; raises `_Refused` with the reason where it is not what it should be."""
        with path.open("rb") as raw, np.load(raw) as file:
            held = {name: file[name] for name in file.files}
        if set(held) != {"index", "sweep", "checksum", *(f"arr_{i}" for i in range(len(forms)))}:
            _refuse("it does not say of which sweep it is")
        if str(held["sweep"]) != self.sweep:
            _refuse("it is of another sweep")
        if int(held["index"]) != start:
            _refuse("it holds other runs")
        # Kind "V": dtypes of `ml_dtypes` such as bfloat16, which `_plain` stored as whole numbers.
        found = [(held[f"arr_{i}"], form.dtype) for i, form in enumerate(forms)]
        leaves = [x.view(dtype) if dtype.kind == "V" else x for x, dtype in found]
        if self._checksum(start, leaves) != str(held["checksum"]):
            _refuse("its checksum is not that of what it holds")
        if any(x.shape != form.shape for x, form in zip(leaves, forms, strict=True)):
            _refuse("its arrays have other shapes")
        return leaves


class _Refused(Exception):
    """The file of a chunk is readable, but not the chunk that was looked for; the text says why."""


def _refuse(why: str) -> NoReturn:
    raise _Refused(why)


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=2)


def _plain(leaf: np.ndarray) -> np.ndarray:
    """An array that `np.savez` can write: dtypes that NumPy lacks (bfloat16) are viewed as whole numbers."""
    return leaf.view(f"u{leaf.dtype.itemsize}") if leaf.dtype.kind == "V" else leaf


def _written(path: Path, data: Any, put: Any) -> None:
    """Write data to a temporary file, then call `put(temporary, path)`; the temporary file is removed.

    The file is flushed to the disk before it gets its name, and the folder after that: else a power cut
    could leave the name on a file without contents.
    """
    part = path.with_name(f"{path.name}.{os.getpid()}.{secrets.token_hex(4)}.part")
    try:
        with part.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        put(part, path)
    finally:
        part.unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # not every system lets a folder be opened
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _locked(path: Path, wait: bool) -> Any:
    """An open file on which this thread holds a lock, until the file is closed or the process ends.

    None where files cannot be locked: then several processes may compute the same chunk, each for itself.

    Raises:
        BlockingIOError: If another thread or process holds the lock, and `wait` is False.
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
