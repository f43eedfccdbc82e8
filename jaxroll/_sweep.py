"""Many runs: in chunks, on every device, with progress, resumed where they were cut off."""

import hashlib
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ._backend import WIDE
from .integration import simulate

_CHUNK = 2048


def sweep(
    make: Callable[[Any], tuple[Any, Any]],
    parameters: Any,
    t1: Any,
    *,
    keep: Callable[[Any], Any] | None = None,
    chunk: int = _CHUNK,
    progress: bool = False,
    resume: str | os.PathLike | None = None,
    **options: Any,
) -> Any:
    """Simulate `make(p)` for every row p of `parameters`, as many as there are.

    Runs go in chunks of fixed size through one compiled program, on every device that JAX has and on every
    core of a CPU; inside a chunk each takes its own steps (see `simulate`), so that runs of unlike cost waste
    little. Memory is bounded by the chunks under way and by what is kept.

    Args (daily use):
        make: From one row of parameters to a grasp and a state on its constraints, by JAX operations;
            `close` may be inside. Pass the same function again to reuse its program.
        parameters: A pytree of arrays with a leading axis n.
        t1: Final time [s].
        keep: What to keep of every `Trajectory`, as a pytree of arrays. Default: all of it.
    Args (rarely changed):
        chunk: Runs per program call.
        progress: Whether to report chunks, speed and time left on standard error.
        resume: A folder where finished chunks are written, and looked for first.
        **options: Those of `simulate`; `ts` is 1 by default, the final state alone.

    Returns:
        What is kept, as NumPy arrays with the leading axis n: by default a `Trajectory` of n lanes.

    Raises:
        ValueError: If the arrays of `parameters` have no common leading axis, or `resume` holds a
            different sweep.

    Runs that fail carry their code (`result`); the others are untouched.

    Example:
        >>> import jax.numpy as jnp
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> table = jxr.sweep(lambda c: (grasp.with_(damping=c), state), jnp.array([0.004, 0.006]), t1=0.1)
        >>> table.last.q.shape
        (2, 3)
    """
    count = _count(parameters)
    if chunk < 1:
        raise ValueError(f"argument chunk must be at least 1 run, but was {chunk}")
    options = {"ts": 1, **options, "throw": False}
    rows = jax.tree.map(np.asarray, parameters)
    size = min(chunk, count)
    folder = None if resume is None else _folder(Path(resume), rows, (count, size, t1, sorted(options)))
    pieces = _pieces(_Job(make, keep, options), rows, t1, (count, size, folder), progress)
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *pieces)


class _Job(eqx.Module):
    """What is compiled: the runs of one chunk."""

    make: Callable
    keep: Callable | None
    options: dict[str, Any]

    @eqx.filter_jit(compiler_options=WIDE)  # pyright: ignore[reportCallIssue]
    def __call__(self, rows: Any, t1: Any) -> Any:
        return self.runs(rows, t1)

    def runs(self, rows: Any, t1: Any) -> Any:
        """The runs of these parameters."""

        def one(row: Any) -> Any:
            grasp, state = self.make(row)
            run = simulate(grasp, state, t1, **self.options)
            return run if self.keep is None else self.keep(run)

        return jax.vmap(one)(rows)


def _pieces(job: _Job, rows: Any, t1: Any, extent: tuple[int, int, Path | None], progress: bool) -> list[Any]:
    """Results chunk by chunk, several under way at a time."""
    count, size, folder = extent
    devices, meter = jax.local_devices(), _Meter(count, progress)
    forms: list[Any] = []

    def piece_at(start: int) -> Any:
        if folder is not None and (folder / _name(start)).exists():
            return _load(folder / _name(start), forms[0])
        device = devices[start // size % len(devices)]
        piece = jax.tree.map(np.asarray, job(jax.device_put(_rows(rows, start, size, count), device), t1))
        _store(folder, start, piece)
        return piece

    if folder is not None:
        forms.append(jax.eval_shape(job.runs, _rows(rows, 0, size, count), t1))
    starts = range(0, count, size)
    pieces = [piece_at(starts[0])]  # alone, since it compiles
    meter(min(size, count))
    with ThreadPoolExecutor(_workers(devices)) as pool:
        for start, piece in zip(starts[1:], pool.map(piece_at, starts[1:]), strict=True):
            pieces.append(piece)
            meter(min(start + size, count))
    return pieces


def _workers(devices: list[Any]) -> int:
    """One thread per device; on a CPU one per core, because a chunk is one kernel on one core."""
    cores = os.cpu_count() or 1
    return max(cores, len(devices)) if devices[0].platform == "cpu" else len(devices)


def _rows(rows: Any, start: int, size: int, count: int) -> Any:
    """One chunk of the parameters; the last one is filled up with its last row."""
    index = np.minimum(np.arange(start, start + size), count - 1)
    return jax.tree.map(lambda x: jnp.asarray(x[index]), rows)


def _count(parameters: Any) -> int:
    lengths = {np.shape(x)[:1] for x in jax.tree.leaves(parameters)}
    if len(lengths) != 1 or lengths == {()} or lengths == {(0,)}:
        raise ValueError(
            f"argument parameters must hold arrays with one common leading axis, but their leading axes were "
            f"{sorted(lengths)}"
        )
    return lengths.pop()[0]


def _folder(folder: Path, rows: Any, rest: tuple) -> Path:
    """The folder of a sweep that can be resumed; it must hold no other sweep."""
    digest = hashlib.sha256(repr(rest).encode())
    for leaf in jax.tree.leaves(rows):
        digest.update(np.ascontiguousarray(leaf).tobytes())
    folder.mkdir(parents=True, exist_ok=True)
    mark = folder / "sweep.txt"
    if mark.exists() and mark.read_text() != digest.hexdigest():
        raise ValueError(
            f"argument resume must be a folder of the same sweep, but {folder} was of other parameters"
        )
    mark.write_text(digest.hexdigest())
    return folder


def _name(start: int) -> str:
    return f"runs_{start:010d}.npz"


def _store(folder: Path | None, start: int, piece: Any) -> None:
    if folder is None or (folder / _name(start)).exists():
        return
    part = folder / f"{_name(start)}.part"
    with part.open("wb") as file:
        np.savez(file, *jax.tree.leaves(piece))
    part.rename(folder / _name(start))


def _load(path: Path, form: Any) -> Any:
    with np.load(path) as file:
        leaves = [file[f"arr_{i}"] for i in range(len(file.files))]
    return jax.tree.unflatten(jax.tree.structure(form), leaves)


class _Meter:
    """Progress on standard error."""

    def __init__(self, count: int, on: bool) -> None:
        self.count, self.on, self.start = count, on, time.perf_counter()

    def __call__(self, done: int) -> None:
        if not self.on:
            return
        spent = time.perf_counter() - self.start
        left = spent * (self.count - done) / done
        print(
            f"{done} of {self.count} runs, {done / spent:.3g} runs/s, {left:.0f} s left",
            file=sys.stderr,
            flush=True,
        )
