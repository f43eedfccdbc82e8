"""What is sent to other processes to have chunks computed there, and what is done with it on arrival.

A `Parcel` holds the job as bytes (`packed`), so that whatever carries it, a scheduler of dask or a pipe, need
know nothing of JAX. A worker unpacks and traces a job once, and compiles it with its first chunk. For every
chunk it takes parameters, writes the results to the folder or the store, and sends back a `Receipt`.
`_dispatch` is the other end.

Two processes compute the same numbers if they have the same versions, processor, flags and precision, and
trace the same program. All of it is compared before a worker computes anything. So if a function is another
one there, because a module of the caller's is out of date on that machine, that is an error.
"""

import contextlib
import hashlib
import os
import pickle
import threading
from collections import OrderedDict
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .._results import missing_library, shown
from ._folder import Folder
from ._identity import differences, Identity, machine
from ._program import Job, Program, program
from ._store import Store

# Settings of JAX that bear on numbers or on what is refused, and the context in which each holds; outside of
# it the process, which may have other work, is left as it is.
_CONTEXTS = {
    "jax_enable_x64": jax.enable_x64,
    "jax_numpy_dtype_promotion": jax.numpy_dtype_promotion,
    "jax_numpy_rank_promotion": jax.numpy_rank_promotion,
    "jax_default_matmul_precision": jax.default_matmul_precision,
    "jax_default_prng_impl": jax.default_prng_impl,
    "jax_threefry_partitionable": jax.threefry_partitionable,
}
# Where compiled programs are kept for other processes, if the caller's are; no context is needed.
_CACHE = (
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)
# The process in which this module was imported.
_HOME = os.getpid()
# Jobs that this process has unpacked, by digest; the one used last comes last.
_AT_HAND: OrderedDict[str, "_Ready"] = OrderedDict()
_MOST = 4
_UNPACKING = threading.Lock()
# How deep to look for what cannot be pickled.
_DEPTH = 4


class Parcel(NamedTuple):
    """All that a process needs to compute chunks of a sweep.

    Attributes:
        job: The pickled `Job`.
        settings: Settings of JAX.
        size: Runs in a chunk.
        keeper: The pickled `Folder` or `Store`; empty where results are sent back.
        there: Marks of the processes that compute; None as long as they are not known.
        key: Fingerprint of the traced program.
        lowered: Fingerprint of the lowered program, and the kind of device that it was lowered for.
    """

    job: bytes
    settings: dict[str, Any]
    size: int
    keeper: bytes = b""
    there: Identity | None = None
    key: str = ""
    lowered: tuple[str, str] = ("", "")

    @property
    def digest(self) -> str:
        """What tells this parcel from others."""
        return hashlib.sha256(pickle.dumps(tuple(self))).hexdigest()


class Receipt(NamedTuple):
    """What comes back for a chunk.

    Attributes:
        leaves: Its results, where they were not written by the worker.
        failure: Why the worker could not write them, if it was to; else empty.
    """

    leaves: list[Any] | None = None
    failure: str = ""


def parcel_of(job: Job, size: int) -> Parcel:
    """A job, packed, with the settings of JAX in this process."""
    settings = {name: getattr(jax.config, name) for name in (*_CONTEXTS, *_CACHE)}
    return Parcel(packed(job), settings, size)


def packed(job: Job) -> bytes:
    """A job as bytes; raises one sentence that names what cannot be pickled."""
    dumps = _dumps()
    try:
        return dumps(job)
    except ImportError:
        raise
    except Exception as error:  # whatever is pickled may raise anything
        for name, value in {"make": job.make, "keep": job.keep, **job.options}.items():
            found = _stubborn(value, dumps, _DEPTH)
            if found is not None:
                raise ValueError(
                    f"argument {name} must be what can be sent to another process where client is given, but "
                    f"{' of '.join(found[-2::-1]) or 'it'} cannot be pickled: {found[-1]}"
                ) from error
        raise


def _dumps() -> Any:
    """The function that pickles: cloudpickle's takes functions that no module names, too."""
    try:
        import cloudpickle
    except ImportError:
        return _dumps_by_name
    return cloudpickle.dumps


def _dumps_by_name(job: Any) -> bytes:
    try:
        return pickle.dumps(job)
    except Exception as error:
        # Mostly these are functions that were defined within others, or at the prompt.
        raise missing_library("cloudpickle", "cluster") from error


def _stubborn(value: Any, dumps: Any, depth: int) -> list[str] | None:
    """Where in a value is what cannot be pickled, from outside to inside, and what it is; None if all can."""
    try:
        dumps(value)
        return None
    except Exception:  # whatever is pickled may raise anything
        inner = _parts_of(value) if depth else {}
    for name, part in inner.items():
        found = _stubborn(part, dumps, depth - 1)
        if found is not None:
            return [name, *found]
    return [shown(value)]


def _parts_of(value: Any) -> dict[str, Any]:
    """What a function reads, a container holds or an object is made of, by name."""
    if isinstance(value, dict):
        return {f"[{key!r}]": part for key, part in value.items()}
    if isinstance(value, list | tuple):
        return {f"[{i}]": part for i, part in enumerate(value)}
    code = getattr(value, "__code__", None)
    if code is None:
        inner = {"function": value.func} if hasattr(value, "func") else {}
        return inner | (vars(value) if hasattr(value, "__dict__") else {})
    cells = zip(code.co_freevars, value.__closure__ or (), strict=False)
    closed = {}
    for name, cell in cells:
        with contextlib.suppress(ValueError):  # a variable without a value
            closed[name] = cell.cell_contents
    read = {name: value.__globals__[name] for name in code.co_names if name in value.__globals__}
    return {f"variable {name!r}": part for name, part in (closed | read).items()}


def greeting(parcel: Parcel) -> Identity:
    """Marks of the worker that runs this; raises if it cannot unpack the job."""
    _check_fresh()
    with _set_as(parcel.settings):
        _unpickled(parcel.job)
        return machine()


def chunk_done(parcel: Parcel, start: int, rows: Any) -> Receipt:
    """Compute the chunk that begins at a run and write it or send it back, unless it is written already."""
    _check_fresh()
    with _set_as(parcel.settings):
        return _ready(parcel, rows).chunk(start, rows)


def _check_fresh() -> None:
    if os.getpid() != _HOME:
        raise ValueError(
            "argument client must start its processes afresh, as with "
            "mp_context=multiprocessing.get_context('spawn'), but they were forked, in which JAX cannot run"
        )


@contextlib.contextmanager
def _set_as(settings: dict[str, Any]) -> Iterator[None]:
    """Context in which JAX is set as in the process that sent the settings."""
    if getattr(jax.config, _CACHE[0]) is None and settings[_CACHE[0]] is not None:
        for name in _CACHE:
            jax.config.update(name, settings[name])
    with contextlib.ExitStack() as stack:
        for name, context in _CONTEXTS.items():
            stack.enter_context(context(settings[name]))
        yield


def _unpickled(job: bytes) -> Job:
    try:
        return pickle.loads(job)
    except Exception as error:  # what is unpickled may raise anything
        raise ValueError(
            "argument make must be known where client computes, as keep and options must, but there it could "
            f"not be read: {shown(str(error))}"
        ) from None


def _ready(parcel: Parcel, rows: Any) -> "_Ready":
    """The job of a parcel, unpacked and traced once in this process."""
    key = parcel.digest
    with _UNPACKING:
        if key not in _AT_HAND:
            _AT_HAND[key] = _Ready(parcel, rows)
        _AT_HAND.move_to_end(key)
        while len(_AT_HAND) > _MOST:
            _AT_HAND.popitem(last=False)
        return _AT_HAND[key]


class _Ready:
    """A job in a worker: its program, and where results go."""

    def __init__(self, parcel: Parcel, rows: Any) -> None:
        here = machine()
        if parcel.there is not None and (found := differences(parcel.there, here)):
            raise ValueError(
                f"argument client must have workers that are alike, but one differs in {found}: to the last "
                "bit its numbers would be others"
            )
        self.run = program(_unpickled(parcel.job), jax.tree.map(jnp.asarray, rows))
        _check_program(self.run, parcel)
        self.size, self.forms = parcel.size, jax.tree.leaves(self.run.results)
        self.keeper: Folder | Store | None = pickle.loads(parcel.keeper) if parcel.keeper else None
        if isinstance(self.keeper, Store):
            self.keeper.fit(self.run)
        self.compiling, self.compiled = threading.Lock(), False

    def chunk(self, start: int, rows: Any) -> Receipt:
        """Compute a chunk and have it written, or send it back where nothing keeps it."""
        if self.keeper is None:
            return Receipt(self.computed(start, rows))
        with self.keeper.work_on(start, wait=True):
            # Somebody else may have written it since it was sent for.
            if self.keeper.load(start, self.forms, quiet=True) is None:
                return self._kept(start, self.computed(start, rows))
        return Receipt()

    def _kept(self, start: int, leaves: list[Any]) -> Receipt:
        if isinstance(self.keeper, Store):
            self.keeper.store(start, leaves)
            return Receipt()
        assert self.keeper is not None
        try:
            self.keeper.write(start, leaves)
        except OSError as error:
            return Receipt(leaves, str(error.strerror))
        return Receipt()

    def computed(self, start: int, rows: Any) -> list[Any]:
        """Results of a chunk; threads of one process wait for the first of them to compile."""
        devices = jax.local_devices()
        device = devices[start // self.size % len(devices)]
        rows = jax.device_put(jax.tree.map(jnp.asarray, rows), device)
        if self.compiled:
            return jax.tree.leaves(self.run(rows))
        with self.compiling:
            leaves = jax.tree.leaves(self.run(rows))
            self.compiled = True
        return leaves


def _check_program(run: Program, parcel: Parcel) -> None:
    """Raise unless the program is the one that was traced where the sweep was called."""
    if run.key() == parcel.key:
        return
    platform = jax.local_devices()[0].platform
    # For another kind of device another program is right.
    if parcel.lowered[1] == platform and run.fingerprint() != parcel.lowered[0]:
        raise ValueError(
            "argument make must be the same wherever it is computed, but a worker's is another program: is a "
            "module there of another version?"
        )
