"""Many runs: in chunks, on every device, with progress, resumed where they were cut off.

All chunks have the same shape, so that one compiled program (`_program`) serves them all. Worker threads call
it, and each waits for its own result; Python's lock is free while XLA computes. With a folder (`_folder`) or
a store (`_store`) finished chunks are not computed again, once it is known to be of the same sweep
(`_identity`). With a client others compute (`_dispatch`).
"""

import contextlib
import os
import sys
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from .._integration import RTOL, RunOptions, save_times
from .._motion import Formulation
from .._results import (
    as_array,
    as_count,
    check_callable,
    check_flag,
    check_known,
    is_array_like,
    shown,
    traced,
)
from ._dispatch import addressed, dispatched, met, Party, party_of
from ._folder import Folder
from ._identity import Identity, identity, Mark
from ._program import calls_back, factorises, Job, of_keep, of_make, Program, program
from ._sending import Parcel, Receipt
from ._store import Store

# Runs in a chunk by default.
_CHUNK = 2048


def sweep(
    make: Callable[[Any], tuple[Any, Any]],
    parameters: Any,
    t1: Any,
    *,
    keep: Callable[[Any], Any] | None = None,
    chunk: int = _CHUNK,
    progress: bool = False,
    resume: str | os.PathLike[str] | None = None,
    store: str | os.PathLike[str] | None = None,
    client: Any = None,
    t0: Any = 0.0,
    ts: Any = 1,
    formulation: Formulation | None = None,
    solver: diffrax.AbstractSolver[Any] | None = None,
    rtol: Any = RTOL,
    atol: Any = None,
    dt0: Any = 1e-4,
    max_steps: int = 4096,
    events: Collection[str] = ("lift", "friction"),
    stepsize_controller: diffrax.AbstractStepSizeController[Any, Any] | None = None,
    progress_meter: diffrax.AbstractProgressMeter[Any] | None = None,
    record: Collection[str] = (),
) -> Any:
    """Simulate `make(p)` for every row p of `parameters`, as many as there are.

    Runs go in chunks of fixed size through one compiled program, on every device that JAX has and on every
    core of a CPU; inside a chunk each takes its own steps (see `simulate`), so that runs of unlike cost waste
    little. Memory is bounded by the chunks under way and by what is kept.

    Args (daily use):
        make: From one row of parameters to a grasp and a state on its constraints, by JAX operations;
            `close` may be inside. Every sweep traces it anew, in milliseconds, and so sees the present values
            of variables that it, or a law or load of its grasp, closes over; a compiled program is used again
            where the traced one is the same.
        parameters: A pytree of arrays with a leading axis n.
        t1: Final time [s].
        keep: What to keep of every `Trajectory`, as a pytree of arrays. Default: all of it.
    Args (rarely changed):
        chunk: Runs per program call.
        progress: Whether to report chunks, speed and time left on standard error.
        resume: A folder where finished chunks are written, and looked for first (see below).
        store: A folder that becomes a table of all runs, in the format of Zarr, chunk by chunk. It stands in
            the place of `resume`, and is resumed in the same way. Needs the extra `data`.
        client: Who computes instead of this process: a `dask.distributed.Client`, or any
            `concurrent.futures.Executor` whose processes start afresh. Needs the extra `cluster` for
            functions that no module names. The page jaxroll/_sweep/README.md has recipes.
        ts: As for `simulate`. Default: 1, the final state alone.
        t0, formulation, solver, rtol, atol, dt0, max_steps, events, stepsize_controller, progress_meter,
            record: As for `simulate`, and with its defaults.

    Returns:
        What is kept, as NumPy arrays with the leading axis n: by default a `Trajectory` of n lanes. With
        `store` it stays on disk, whatever its size: an `xarray.Dataset` whose arrays are read when asked for.

    Raises:
        ValueError: If an argument does not fit, the arrays of `parameters` have no common leading axis,
            `resume` or `store` hold a different sweep, something cannot be sent to the processes of `client`,
            or these differ from this one in versions or precision, or from each other.
        OSError: If `store` cannot be written, after several tries.
        ImportError: Without the extras.

    Runs that fail carry their code (`result`); the others are untouched.
    Resuming: the folder's `sweep.json` says which sweep it is of: lowered programs and constants of `make`
    and `keep`, options, `t1`, parameters, size of chunks, versions, precision and processor. If any of these
    differs, the sweep is refused, and the error names it. A chunk that is damaged or not of this sweep
    is worked out again, with a warning that names the file. A process may be killed at any moment; several
    processes with one folder share the work. With a folder, store or client the program is lowered once more
    for its fingerprint, before anything is compiled, which takes some tenths of a second.
    Stores: named arrays with the dimension `run`, one for each array that is kept. Its name is the one that
    its record gives it (`Trajectory.to_xarray`), the key of a dict, or `kept`. Then the parameters by name;
    `stored`, whether a run is there; and `sweep`, whose attributes are versions, options and processor.
    `xarray.open_zarr(path, chunks=None)` opens it at any time. Longer `parameters` that begin with those
    that are stored append their runs.
    Clients: a chunk is a task; where a folder or a store is given, workers write there and only a receipt
    comes back. Of a worker that dies dask sends the chunk to another one. The numbers are those of a sweep in
    this process, to the last bit, if the processors have the same instructions.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> grasp, state = jxr.scenes.pivoted()
        >>> dampings, forces = np.linspace(0.004, 0.008, 8), np.linspace(0.4, 0.5, 8)
        >>> some = jxr.Parameters.grid(damping=dampings, force=forces)
        >>> keep = lambda run: run.last.q  # where each comes to
        >>> ends = jxr.sweep(lambda p: (grasp.with_(**p), state), some, t1=0.1, keep=keep)
        >>> ends.shape, some.shaped(ends).shape
        ((64, 3), (8, 8, 3))
    """
    check_callable("make", make, "a function of one row of parameters", takes=1)
    if keep is not None:
        check_callable("keep", keep, "a function of a trajectory", takes=1)
    check_flag("progress", progress)
    rows, t1 = _rows_of(parameters), _time(t1)
    count = len(jax.tree.leaves(rows)[0])
    extent = Extent(count, min(as_count("chunk", chunk, most=sys.maxsize), count))
    options = {
        "t0": t0,
        "ts": ts,
        "formulation": formulation,
        "solver": solver,
        "rtol": rtol,
        "atol": atol,
        "dt0": dt0,
        "max_steps": max_steps,
        "events": events,
        "stepsize_controller": stepsize_controller,
        "progress_meter": progress_meter,
        "record": record,
        "throw": False,  # the runs carry their codes
    }
    _check_options(options, t1)
    job = Job(make, keep, t1, options)
    keeper = _keeper(resume, store, rows, extent, (t0, t1, ts))
    party = None if client is None else party_of(client)
    parcel = None if party is None else met(party, job, extent.size)
    if keeper is None:
        run = program(job, extent.chunk(rows, 0))
    else:
        run = _resumed(keeper, job, rows, extent, {} if parcel is None else parcel.there or {})
    pieces = _pieces(run, rows, extent, keeper, progress=progress, helpers=(party, parcel))
    if isinstance(keeper, Store):
        return keeper.dataset()
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *pieces)


def _check_options(options: dict[str, Any], t1: Any) -> None:
    """Raise unless `simulate` would take the options, and arrays among them hold numbers.

    Arrays are arguments of the sweep's program: `simulate` itself cannot see their values.
    """
    told = {name: value for name, value in options.items() if name not in ("ts", "throw")}
    RunOptions(**told).checked(t1, options["ts"])
    for name, value in options.items():
        for leaf in filter(is_array_like, jax.tree.leaves(value)):
            as_array(name, leaf)


class Extent(NamedTuple):
    """How many runs there are, and how many a chunk has."""

    count: int
    size: int

    @property
    def starts(self) -> range:
        """The first run of every chunk."""
        return range(0, self.count, self.size)

    def rows(self, rows: Any, start: int) -> Any:
        """One chunk of the parameters; the last one is filled up with copies of the last row."""
        index = np.minimum(np.arange(start, start + self.size), self.count - 1)
        return jax.tree.map(lambda x: x[index], rows)

    def chunk(self, rows: Any, start: int) -> Any:
        """One chunk of the parameters as arrays of JAX."""
        return jax.tree.map(jnp.asarray, self.rows(rows, start))


def _keeper(
    resume: Any, store: Any, rows: Any, extent: Extent, span: tuple[Any, Any, Any]
) -> Folder | Store | None:
    """What keeps finished chunks, if anything does; `span` are start, end and save times of a run."""
    if store is None:
        return None if resume is None else Folder(resume)
    if resume is not None:
        raise ValueError(
            "argument resume must be left out where store is given, since a store is resumed by itself, but "
            f"was {shown(resume)}"
        )
    return Store(store, rows, extent, save_times(*span, np.dtype(jnp.result_type(float)))[2])


def _resumed(keeper: Folder | Store, job: Job, rows: Any, extent: Extent, there: Identity) -> Program:
    """The program, after folder or store is checked and claimed for this sweep; nothing is compiled.

    The cheapest comparisons come first: values and versions, then the lowered program of `make`, and last the
    program of the runs. `there` are marks of the workers, where others than this process compute.
    """
    here = identity(rows, job.t1, extent.size, job.options) | there
    row = jax.tree.map(lambda x: jnp.asarray(x[0]), rows)
    here["make"] = Mark(of_make(job.make, row), "make")
    keeper.check(here)
    run = program(job, extent.chunk(rows, 0))
    if job.options["progress_meter"] is None and calls_back(run.traced.jaxpr):
        raise ValueError(
            "argument make must not take numbers from Python while it runs (jax.pure_callback) where resume "
            "or store is given, since a folder cannot tell what is called; nor must keep or options"
        )
    here["keep"] = Mark(of_keep(job.keep, run.trajectory), "keep")
    here["program"] = Mark(run.fingerprint(), "program")
    if isinstance(keeper, Store):
        keeper.open(here, run)
    else:
        keeper.open(here)
    return run


def _pieces(
    run: Program,
    rows: Any,
    extent: Extent,
    keeper: Folder | Store | None,
    *,
    progress: bool,
    helpers: tuple[Party | None, Parcel | None] = (None, None),
) -> list[Any]:
    """Results of all chunks, in their order; several are computed at a time.

    Args:
        run: The program.
        rows: The parameters of all runs.
        extent: How they are cut into chunks.
        keeper: Where finished chunks are; None if the sweep is not to be resumed. Of chunks in a store there
            is an empty list each: their results stay there.
        progress: Whether to report on standard error.
        helpers: The processes that compute instead of this one, and what they are sent; None for none.
    """
    forms, tree = jax.tree.leaves(run.results), jax.tree.structure(run.results)
    found: dict[int, Any] = {}

    def runs_found() -> int:
        # The last chunk may hold fewer runs than the others.
        return min(len(found) * extent.size, extent.count)

    def whole(leaves: list[Any]) -> Any:
        return leaves if isinstance(keeper, Store) else jax.tree.unflatten(tree, leaves)

    def note(start: int, leaves: Any) -> bool:
        """Keep a chunk's results and report them; whether there were any."""
        if leaves is not None:
            found[start] = whole(leaves)
            report(runs_found())
        return leaves is not None

    def settle(start: int, receipt: Receipt) -> bool:
        """Note the results of a chunk, sent back or written by the worker; whether they were found."""
        if receipt.failure and isinstance(keeper, Folder):
            keeper.warn_of_failure(start, receipt.failure)
        if receipt.leaves is not None or keeper is None:
            return note(start, receipt.leaves)
        return note(start, [] if isinstance(keeper, Store) else keeper.load(start, forms, quiet=True))

    for start in extent.starts:
        leaves = None if keeper is None else keeper.load(start, forms)
        if leaves is not None:
            found[start] = whole(leaves)
    party, parcel = helpers
    with _meter(runs_found(), extent.count, on=progress) as report:
        if party is None or parcel is None:
            _work_here(run, rows, extent, keeper, found=found, note=note)
        else:
            left = [start for start in extent.starts if start not in found]
            sent = addressed(parcel, run, keeper)
            dispatched(party, sent, {s: partial(extent.rows, rows, s) for s in left}, settle)
    return [found[start] for start in extent.starts]


def _work_here(
    run: Program,
    rows: Any,
    extent: Extent,
    keeper: Folder | Store | None,
    *,
    found: dict[int, Any],
    note: Callable[[int, Any], bool],
) -> None:
    """Compute the missing chunks in threads of this process, on all of its devices."""
    devices, forms = jax.local_devices(), jax.tree.leaves(run.results)

    def computed(start: int) -> list[np.ndarray]:
        device = devices[start // extent.size % len(devices)]
        return jax.tree.leaves(run(jax.device_put(extent.chunk(rows, start), device)))

    def piece_at(start: int, *, wait: bool) -> list[np.ndarray] | None:
        """Results of a chunk; None if another process is computing it and this one is not to wait."""
        if keeper is None:
            return computed(start)
        with keeper.work_on(start, wait=wait) as mine:
            if not mine:
                return None
            # Another process may have written it since it was looked for, or while this one waited.
            piece = keeper.load(start, forms, quiet=True)
            if piece is None:
                piece = computed(start)
                keeper.store(start, piece)
        return [] if isinstance(keeper, Store) else piece

    def work(*, wait: bool) -> None:
        """Find or compute the chunks still missing; without `wait` only those that nobody is computing."""
        left = [start for start in extent.starts if start not in found]
        todo = iter(left)
        # The first chunk that this process computes compiles the program, and the others wait for that.
        # `any` stops at the first chunk found, and leaves those after it in the iterator.
        any(note(start, piece_at(start, wait=wait)) for start in todo)
        rest = list(todo)
        for start, piece in zip(rest, pool.map(partial(piece_at, wait=wait), rest), strict=True):
            note(start, piece)

    # Two programs that call LAPACK on large batches at once have waited for each other for ever (jaxlib 0.10,
    # on two cores): they go one after another.
    alone = devices[0].platform == "cpu" and factorises(run.traced.jaxpr)
    with ThreadPoolExecutor(1 if alone else _workers(devices)) as pool:
        # Twice: chunks that other processes are computing are passed over, and waited for at the end. Should
        # such a process be killed, its lock is released, and its chunk is computed here.
        work(wait=False)
        work(wait=True)


def _workers(devices: list[Any]) -> int:
    """One thread per device; on a CPU one per core, because a chunk is one kernel on one core."""
    cores = os.cpu_count() or 1
    return max(cores, len(devices)) if devices[0].platform == "cpu" else len(devices)


def _rows_of(parameters: Any) -> Any:
    """The parameters as NumPy arrays with one common leading axis."""
    rows = jax.tree.map(_row_array, parameters)
    lengths = {x.shape[:1] for x in jax.tree.leaves(rows)}
    if len(lengths) != 1 or lengths == {()} or lengths == {(0,)}:
        raise ValueError(
            f"argument parameters must hold arrays with one common leading axis, but their leading axes were "
            f"{shown(sorted(lengths))}"
        )
    return rows


def _row_array(leaf: Any) -> np.ndarray:
    """One leaf of the parameters as a NumPy array of numbers."""
    wanted = f"argument parameters must hold arrays of numbers, but one of them was {shown(leaf)}"
    if traced(leaf):
        raise ValueError(f"{wanted}: a sweep is no part of what JAX traces")
    try:
        array = np.asarray(leaf)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(wanted) from None
    # NumPy would drop the mask of a masked array, and take the numbers under it for parameters.
    masked = isinstance(leaf, np.ma.MaskedArray)
    if masked or not (jnp.issubdtype(array.dtype, np.number) or array.dtype == bool):
        raise ValueError(wanted)
    return array


def _time(t1: Any) -> Any:
    """The final time as it was given, if it is one number."""
    seen = as_array("t1", t1)
    if seen.shape != ():
        raise ValueError(f"argument t1 must be one number, but had shape {seen.shape}")
    check_known("t1", t1)
    return t1


@contextlib.contextmanager
def _meter(found: int, count: int, *, on: bool) -> Iterator[Callable[[int], Any]]:
    """A function that shows on standard error how many runs are done, their speed and the time left.

    Args:
        found: How many were done before.
        count: How many there are.
        on: Whether to show anything.
    """
    if not on:
        yield lambda done: None
        return
    shown_as = "{n} of {total} runs |{bar}| {rate_noinv_fmt}, {remaining} left"
    # Every report is shown, since chunks are few; `smoothing` 0 shows the mean speed of the whole sweep.
    pace = {"unit": " runs", "smoothing": 0, "mininterval": 0, "miniters": 1}
    with tqdm(initial=found, total=count, bar_format=shown_as, **pace) as bar:
        yield lambda done: bar.update(done - bar.n)
