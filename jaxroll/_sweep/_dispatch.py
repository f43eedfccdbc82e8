"""Chunks as tasks of somebody else's processes: a cluster of dask, or any `concurrent.futures.Executor`.

A client of dask offers itself as an executor, so that there is one way for all: submit chunks, a few more
than there are workers, and see what comes back. A worker writes its results to the folder or the store
(`_sending`) and sends back a receipt; without either, the receipt holds the results. A worker that is killed
loses only the chunk that it was computing: dask gives that chunk to another worker; any other executor says
that it is broken, and then the same call of `sweep` with a new one goes on where this one stopped.
"""

import concurrent.futures as futures
import pickle
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax

from .._results import shown
from ._folder import Folder
from ._identity import differences, machine
from ._program import Job, Program
from ._sending import chunk_done, greeting, Parcel, parcel_of, Receipt
from ._store import Store

# How often a chunk is sent at most. Each time dask by itself tries up to four workers, if each dies with it.
_TRIES = 6
# How many chunks are under way: with dask `_AHEAD` for each thread, but at least `_LEAST`; with any other
# executor, which does not say how many workers it has, `_USUAL`.
_AHEAD, _LEAST, _USUAL = 3, 8, 256
# What dask raises where every worker that was given a chunk has died.
_KILLED = "KilledWorker"
# Beginnings of the names of marks in which workers must agree with this process, since they decide what the
# program is. Processors may differ from this one's, but must be alike among the workers (`_sending`).
_ALIKE = ("version", "precision")


class Party(NamedTuple):
    """The processes that compute.

    Attributes:
        executor: Takes the tasks.
        room: Gives how many tasks to have under way now.
    """

    executor: futures.Executor
    room: Callable[[], int]


def party_of(client: Any) -> Party:
    """The argument `client`, checked."""
    # A client of dask can only have been made where its library has been imported.
    dask = sys.modules.get("distributed")
    if dask is not None and isinstance(client, dask.Client):
        if client.asynchronous:
            raise ValueError(
                "argument client must not be asynchronous, since sweep waits for it, but was Client("
                "asynchronous=True)"
            )
        threads = lambda: sum(client.nthreads().values())  # noqa: E731
        return Party(client.get_executor(pure=False), lambda: max(_LEAST, _AHEAD * threads()))
    if not isinstance(client, futures.Executor):
        raise ValueError(
            f"argument client must be a dask.distributed Client or a concurrent.futures Executor, but was "
            f"{shown(client)}"
        )
    return Party(client, lambda: _USUAL)


def met(party: Party, job: Job, size: int) -> Parcel:
    """A parcel for the job, with the marks of the worker that has unpacked it, which all others must share.

    Raises:
        ValueError: If the job cannot be sent, or the worker has other versions or another precision.
    """
    parcel = parcel_of(job, size)
    there = _result(party.executor.submit(greeting, parcel))
    decisive = lambda marks: {n: m for n, m in marks.items() if n.startswith(_ALIKE)}  # noqa: E731
    found = differences(decisive(there), decisive(machine()))
    if found:
        raise ValueError(f"argument client must have workers like this process, but they differ in {found}")
    return parcel._replace(there=there)


def addressed(parcel: Parcel, run: Program, keeper: Folder | Store | None) -> Parcel:
    """The parcel, which now says where results go and which program it must be."""
    kept = pickle.dumps(keeper) if keeper is not None else b""
    lowered = (run.fingerprint(), jax.local_devices()[0].platform)
    return parcel._replace(keeper=kept, key=run.key(), lowered=lowered)


def dispatched(
    party: Party,
    parcel: Parcel,
    wanted: Mapping[int, Callable[[], Any]],
    settle: Callable[[int, Receipt], bool],
) -> None:
    """Have chunks computed.

    Args:
        party: The processes that compute.
        parcel: What they need to know.
        wanted: By the first run of every chunk that is wanted, a function that gives the chunk's parameters.
        settle: Takes the first run and the receipt of a chunk, and says whether the chunk is done; if not, it
            is sent again.
    """
    flight = _Flight(party, parcel, wanted, settle)
    try:
        while flight.todo or flight.under_way:
            flight.fill()
            done, _ = futures.wait(flight.under_way, return_when=futures.FIRST_COMPLETED)
            for future in done:
                flight.take(future)
    finally:
        for future in flight.under_way:
            future.cancel()


class _Flight:
    """Chunks that are still to be sent, and those under way.

    Args:
        party, parcel, wanted, settle: As for `dispatched`.
    """

    def __init__(self, party: Party, parcel: Parcel, wanted: Mapping[int, Any], settle: Any) -> None:
        self.party, self.parcel, self.wanted, self.settle = party, parcel, wanted, settle
        self.todo, self.under_way = deque(wanted), dict[futures.Future, int]()
        self.tries: Counter[int] = Counter()
        # With a cache of compiled programs one chunk is sent alone: it compiles for all who share the cache.
        self.alone = parcel.settings["jax_compilation_cache_dir"] is not None

    def fill(self) -> None:
        """Send as many chunks as there is room for."""
        room = 1 if self.alone else self.party.room()
        while self.todo and len(self.under_way) < room:
            start = self.todo.popleft()
            self.tries[start] += 1
            try:
                sent = self.party.executor.submit(chunk_done, self.parcel, start, self.wanted[start]())
            except futures.BrokenExecutor as error:
                raise _broken(error) from error
            self.under_way[sent] = start

    def take(self, future: futures.Future) -> None:
        """Settle a chunk, or put it back to be sent again; after the last try raise the error of that try."""
        start = self.under_way.pop(future)
        lost = self._lost(future, start)
        if lost is None:
            self.alone = False
            return
        if self.tries[start] >= _TRIES:
            raise lost
        time.sleep(min(0.1 * 2 ** self.tries[start], 2.0))
        self.todo.append(start)

    def _lost(self, future: futures.Future, start: int) -> Exception | None:
        """The error of a chunk that is worth another try (a full disk, a dead worker); None if it is done."""
        try:
            settled = self.settle(start, _result(future))
        except (OSError, futures.CancelledError) as error:
            return error
        except Exception as error:
            if type(error).__name__ != _KILLED:
                raise
            return error
        text = f"the chunk of a sweep from run {start} on was written, but cannot be read here"
        return None if settled else RuntimeError(text)


def _result(future: futures.Future) -> Any:
    """What a task returned; raises the error that it raised."""
    try:
        return future.result()
    except futures.BrokenExecutor as error:
        raise _broken(error) from error


def _broken(error: Exception) -> RuntimeError:
    return RuntimeError(
        "a process of the client's executor ended, and with it the executor; chunks that were written stay: "
        f"the same call with another one goes on ({type(error).__name__})"
    )
