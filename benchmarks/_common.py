"""What every benchmark needs: contenders, versions, interleaved timing, tables in a README."""

import dataclasses
import importlib.metadata
import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

README = Path(__file__).parent / "README.md"
_SLOW = 0.05
# The error at which contenders are compared [rad].
TARGET = 1e-8


@dataclasses.dataclass(frozen=True)
class Run:
    """One contender at one tolerance and one set of saved times, ready to be timed.

    `call` is timed; `read` turns what it returned into states of shape (t, 7); `count` gives steps
    and evaluations of the equations of motion, untimed; `bare` is the same run under `jax.jit`.
    """

    call: Callable[[], Any]
    read: Callable[[Any], np.ndarray]
    count: Callable[[], tuple[int, int]]
    bare: Callable[[], Any] | None = None


@dataclasses.dataclass(frozen=True)
class Contender:
    """A formulation and a solver; `make(tolerance, times)` prepares a run."""

    family: str
    formulation: str
    solver: str
    make: Callable[[float, np.ndarray], Run]
    tightest: float = 1e-12


@dataclasses.dataclass
class Result:
    """What one contender did at one tolerance: seconds and largest errors [rad], both ladders."""

    contender: Contender
    tolerance: float
    steps: dict[str, int] = dataclasses.field(default_factory=dict)
    evaluations: dict[str, int] = dataclasses.field(default_factory=dict)
    gap: float = float("nan")
    outcome: str = "ok"
    errors: dict[str, float] = dataclasses.field(default_factory=dict)
    times: dict[str, float] = dataclasses.field(default_factory=dict)
    bare_times: dict[str, float] = dataclasses.field(default_factory=dict)

    def seconds(self, bare: bool) -> dict[str, float]:
        """Times by public call, or under `jax.jit`."""
        return self.bare_times if bare else self.times


def device() -> str:
    """Processor model and number of cores."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [x for x in cpuinfo.read_text().splitlines() if x.startswith("model name")]
        model = names[0].split(":", 1)[1].strip() if names else model
    return f"{model}, {os.cpu_count()} cores, {platform.machine()}"


def versions(*packages: str) -> str:
    """Python's version and those of the packages."""
    listed = [f"{name} {importlib.metadata.version(name)}" for name in packages]
    return ", ".join([f"Python {platform.python_version()}", *listed])


def interleaved(calls: Sequence[Callable[[], object]], *, rounds: int) -> list[float]:
    """Median seconds of each call, all of them once per round; slow ones sit out after round 5.

    A quick call is repeated once before it is timed, so that what its neighbour left in the caches
    does not count; every other round runs backwards.
    """
    times: list[list[float]] = [[] for _ in calls]
    for turn in range(rounds):
        order = range(len(calls)) if turn % 2 == 0 else reversed(range(len(calls)))
        for i in order:
            usual = statistics.median(times[i]) if times[i] else 0.0
            if turn >= 5 and usual > _SLOW:
                continue
            if usual < _SLOW:
                calls[i]()
            start = time.perf_counter()
            calls[i]()
            times[i].append(time.perf_counter() - start)
    return [statistics.median(t) for t in times]


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def write_section(name: str, text: str) -> None:
    """Replace what stands between this section's markers in the README, or append it."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    block = f"{begin}\n{text.strip()}\n{end}"
    page = README.read_text() if README.exists() else "# Benchmarks\n"
    if begin in page and end in page:
        head, rest = page.split(begin, 1)
        page = head + block + rest.split(end, 1)[1]
    else:
        page = f"{page.rstrip()}\n\n{block}\n"
    README.write_text(page)


def fastest(results: Sequence[Result], ladder: str, bare: bool = False) -> Result | None:
    """The fastest ladder point whose error meets the target."""
    timed = [r for r in results if meets(r, ladder) and ladder in r.seconds(bare)]
    return min(timed, key=lambda r: r.seconds(bare)[ladder], default=None)


def meets(result: Result, ladder: str) -> bool:
    return result.errors.get(ladder, np.inf) <= TARGET


def by_contender(results: Sequence[Result]) -> dict[tuple[str, str], list[Result]]:
    groups: dict[tuple[str, str], list[Result]] = {}
    for r in results:
        groups.setdefault((r.contender.formulation, r.contender.solver), []).append(r)
    return groups


def ms(seconds: float | None) -> str:
    return "" if seconds is None else f"{1e3 * seconds:.3g}"


def size(value: float | None) -> str:
    return "" if value is None or np.isnan(value) else f"{value:.1e}"
