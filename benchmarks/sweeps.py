"""Sweeps on worker processes and into a store: speed, memory, and time that is not spent on computing.

`python -m benchmarks.sweeps --write` rewrites its section of README.md; `--quick` takes 10^5 runs instead of
10^6. Needs the extras `cluster` and `data`. Workers are processes of dask with one thread each; runs are
those of the pivoted scene with 2048 in a chunk, and what is kept of each is its end, its code and its
statistics.
"""

import os
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from dask.distributed import Client, LocalCluster

import jaxroll as jxr
from benchmarks._common import checked, command
from jaxroll._sweep import _sending

jax.config.update("jax_enable_x64", True)

CHUNK = 2048


def prepared() -> None:
    """Let this process, a worker, count chunks and the processor time [s] that goes into them."""
    # Beside the class, since dask sends functions of this file with globals of their own.
    ready: Any = _sending._Ready
    computed, ready.spent = ready.computed, {"computing": 0.0, "chunks": 0}

    def counted(self: Any, start: int, rows: Any) -> Any:
        before = time.process_time()
        found = computed(self, start, rows)
        ready.spent["computing"] += time.process_time() - before
        ready.spent["chunks"] += 1
        return found

    ready.computed = counted


def state() -> dict[str, float]:
    """What this process, a worker, has spent and holds: processor time [s], peak of memory [MB]."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    ready: Any = _sending._Ready
    return ready.spent | {"processor": time.process_time(), "memory": most}


def swept(count: int, share: float = 1.0, **options: Any) -> Any:
    """A sweep of a share of so many runs, which differ in their damping."""
    grasp, start = jxr.scenes.pivoted()
    rows = {"damping": np.linspace(0.004, 0.008, count)[: int(share * count)]}
    keep = lambda run: {"end": run.last, "result": run.result, "stats": run.stats}  # noqa: E731
    make = lambda p: (grasp.with_(damping=p["damping"]), start)  # noqa: E731
    return jxr.sweep(make, rows, 3.0, rtol=1e-6, keep=keep, chunk=CHUNK, **options)


def on_workers(workers: int, count: int, folder: Path) -> dict[str, float]:
    """What a sweep takes on so many workers that have compiled before."""
    cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
    with cluster, Client(cluster) as client:
        client.run(prepared)
        swept(4 * CHUNK * workers, client=client, store=folder / f"first{workers}.zarr")
        before, start = client.run(state), time.perf_counter()
        table = swept(count, 0.5, client=client, store=folder / f"table{workers}.zarr")
        middle = client.run(state)
        table = swept(count, client=client, store=folder / f"table{workers}.zarr")
        wall, after = time.perf_counter() - start, client.run(state)
        assert bool(table.stored.all()) and set(np.unique(table.result)) == {0}
    total = lambda seen, name: sum(worker[name] for worker in seen.values())  # noqa: E731
    spent = {name: total(after, name) - total(before, name) for name in ("processor", "computing", "chunks")}
    grown = max(after[name]["memory"] / middle[name]["memory"] for name in after)
    memory = max(worker["memory"] for worker in after.values())
    return spent | {"wall": wall, "grown": grown, "memory": memory, "runs": CHUNK * spent["chunks"]}


def in_process(count: int) -> float:
    """Processor time of a run in this process [s], without a store, as of a mapped program."""
    swept(CHUNK)
    before = time.process_time()
    swept(count)
    return (time.process_time() - before) / count


def report(quick: bool = False) -> str:
    """Markdown: what is asked and what was measured."""
    count = 10**5 if quick else 10**6
    with tempfile.TemporaryDirectory() as folder:
        one, two = (on_workers(n, count, Path(folder)) for n in (1, 2))
    alone = in_process(min(count, 2**14))
    walls = f"{one['wall']:.0f} and {two['wall']:.0f} s"
    ratio = two["wall"] / one["wall"]
    rest = 1.0 - two["computing"] / two["processor"]
    each = two["computing"] / two["runs"] / alone
    grown = f"{two['grown']:.3f} ({two['memory']:.0f} MB)"
    rows = [
        [f"{count} runs: wall time, two workers over one", "<= 0.556", f"{ratio:.3f} ({walls})"],
        ["peak of a worker's memory: after all runs over after half", "<= 1.1", grown],
        ["processor time per run, worker over this process", "<= 1.1", f"{each:.3f}"],
        ["scheduling and storing: share of the workers' processor time", "<= 0.05", f"{rest:.3f}"],
    ]
    load = os.getloadavg()[0]
    about = f"The load of the machine was {load:.1f} when it was over."
    return f"{checked(rows, 'jax', 'distributed', 'zarr', 'xarray')}\n\n{about}"


if __name__ == "__main__":
    command("sweeps", report)
