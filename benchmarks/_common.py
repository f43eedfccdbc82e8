"""What every benchmark needs: its command, contenders, versions, interleaved timing, tables in a README."""

import argparse
import dataclasses
import importlib.metadata
import json
import os
import platform
import re
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import readme

README = Path(__file__).parent / "README.md"
_SLOW = 0.05
# The error at which contenders are compared [rad, or m where lengths are judged].
TARGET = 1e-8
_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"


@dataclasses.dataclass(frozen=True)
class Run:
    """One contender at one tolerance and one set of saved times, ready to be timed.

    `call` is timed; `read` turns what it returned into an array with a row per time; `count` gives steps
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
    """What one contender did at one tolerance: seconds and largest errors, of each ladder."""

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


def interleaved(
    calls: Sequence[Callable[[], object]], *, rounds: int, clock: Callable[[], float] | None = None
) -> list[float]:
    """Median seconds of each call, all of them once per round; slow ones sit out after round 5.

    A quick call is repeated once before it is timed, so that what its neighbour left in the caches
    does not count; every other round runs backwards. Without a `clock` it is wall time, where nothing else
    took the processor away; `time.process_time` counts the processor of all threads.
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
            times[i].append(_least(calls[i]) if clock is None else _by(clock, calls[i]))
    return [statistics.median(t) for t in times]


def _by(clock: Callable[[], float], call: Callable[[], object]) -> float:
    start = clock()
    call()
    return clock() - start


def _least(call: Callable[[], object]) -> float:
    """Wall time; or CPU time, if shorter, where another program took the processor away meanwhile."""
    before, cpu, start = _interruptions(), time.process_time(), time.perf_counter()
    call()
    wall, cpu = time.perf_counter() - start, time.process_time() - cpu
    return wall if _interruptions() == before else min(wall, cpu)


def _interruptions() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw


def uncached() -> dict[str, str]:
    """This process' environment without a cache of compiled programs, but with one of Python's bytecode.

    Users have the latter; some containers switch it off, and then each process compiles all of jaxroll again.
    """
    left_out = ("JAX_COMPILATION_CACHE", "PYTHONDONTWRITEBYTECODE")
    return {key: value for key, value in os.environ.items() if not key.startswith(left_out)}


def clocked(
    call: Sequence[str], env: dict[str, str], *, folder: str | None = None
) -> tuple[subprocess.CompletedProcess[str], list[float]]:
    """A process that has ended, and its seconds of wall and processor; time in the system is included."""
    used, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(call, cwd=folder, env=env, capture_output=True, text=True, check=False)
    wall, now = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return done, [wall, now.ru_utime - used.ru_utime + now.ru_stime - used.ru_stime]


def yardstick() -> float:
    """Processor seconds of a loop of ten million additions."""
    start, total = time.process_time(), 0
    for i in range(10_000_000):
        total += i
    return time.process_time() - start


def fresh(module: str, *words: str, cache: str | None = None) -> Any:
    """What a module prints as JSON when it runs in a new process; compiled programs are kept in `cache`."""
    call = [sys.executable, "-m", module, *words]
    env = uncached()
    if cache is not None:
        env |= {"JAX_COMPILATION_CACHE_DIR": cache, "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    done = subprocess.run(call, env=env, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(call)} failed:\n{done.stderr}")
    return json.loads(done.stdout)


def command(section: str, report: Callable[..., str], **flags: str) -> None:
    """Print a report, or write it into its section of the README with `--write`.

    `report(quick, ...)` takes further yes-or-no options by the names of `flags`, whose values are their help;
    one that is called `drawn` is no option: it says that the section's plot is wanted, as with `--write`.
    """
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{section}")
    parser.add_argument("--quick", action="store_true", help="a short form")
    parser.add_argument("--write", action="store_true", help=f"rewrite the section of {README.name}")
    for name in flags.keys() - {"drawn"}:
        parser.add_argument(f"--{name}", action="store_true", help=flags[name])
    options = parser.parse_args()
    given = {name: getattr(options, name, options.write) for name in flags}
    text = report(options.quick, **given)
    print(text)
    if options.write:
        write_section(section, text)


def checked(rows: Sequence[Sequence[str]], *packages: str, about: str = "") -> str:
    """Table of what, asked and measured, led by a sentence that counts which limits are met.

    `about` says what it means that all are, and is left out otherwise.
    """
    limits = [(row[0], *pair) for row in rows for pair in _limits(row[1], row[2])]
    missed = [
        f"{what.split(':')[0]}: {found} (asked: {asked})" for what, asked, found, good in limits if not good
    ]
    said = f"{len(limits) - len(missed)} of {len(limits)} limits are met"
    said += f"; missed: {'; '.join(missed)}." if missed else "."
    grid = table(["what", "asked", "measured"], rows)
    about = f"{about} " if about and not missed else ""
    return f"**Conclusion.** {about}{said}\n\n{grid}\n\n{device()}; {versions(*packages)}."


def _limits(asked: str, measured: str) -> list[tuple[str, str, bool]]:
    """Each "<= a" or "a +- b" with the first number beside it, and whether it is met."""
    found = []
    for limit, value in zip(asked.split(";"), measured.split(";"), strict=False):
        limit, number = limit.strip(), re.search(_NUMBER, value)
        bounds = [float(x) for x in re.findall(_NUMBER, limit.replace("+-", " "))]
        if number is None or not bounds or not (limit.startswith("<=") or "+-" in limit):
            continue
        x = float(number[0])
        good = x <= bounds[0] if limit.startswith("<=") else abs(x - bounds[0]) <= bounds[1]
        found.append((limit, value.strip(), good))
    return found


def judged(value: float, asked: float | None) -> str:
    """What was asked, and whether it was missed."""
    return "" if asked is None else f"{'**missed** ' * (value > asked)}{asked:g}"


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def write_section(name: str, text: str) -> None:
    """Replace what stands between this section's markers on the benchmark page, or append it."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    block = f"{begin}\n{text.strip()}\n{end}"
    page = README.read_text() if README.exists() else "# Benchmarks\n"
    if begin in page and end in page:
        head, rest = page.split(begin, 1)
        page = head + block + rest.split(end, 1)[1]
    else:
        page = f"{page.rstrip()}\n\n{block}\n"
    README.write_text(page)
    readme.main()  # which quotes it


def warmed(result: Result, runs: dict[str, Run], judge: Callable[[str, np.ndarray], float]) -> dict[str, Run]:
    """Warm up and judge one contender; what fails is recorded and not timed."""
    try:
        for ladder, run in runs.items():
            result.errors[ladder] = judge(ladder, run.read(run.call()))
            if run.bare is not None:
                run.bare()
            result.steps[ladder], result.evaluations[ladder] = run.count()
    except Exception as error:
        result.outcome = str(error).splitlines()[0][:60] or type(error).__name__
        result.errors.clear()
        return {}
    return runs


def timed(
    prepared: Sequence[tuple[Result, dict[str, Run]]],
    *,
    rounds: int,
    clock: Callable[[], float] | None = None,
) -> list[Result]:
    """Time all runs, interleaved, and put the medians into their results."""
    calls, slots = [], []
    for result, runs in prepared:
        for ladder, run in runs.items():
            calls.append(run.call)
            slots.append((result.times, ladder))
            if run.bare is not None:
                calls.append(run.bare)
                slots.append((result.bare_times, ladder))
    seconds = interleaved(calls, rounds=rounds, clock=clock)
    for (where, ladder), value in zip(slots, seconds, strict=True):
        where[ladder] = value
    return [result for result, _ in prepared]


def ranked(
    results: Sequence[Result], ladder: str, target: float = TARGET
) -> list[tuple[float, bool, Result]]:
    """Seconds, whether jitted, and the fastest point of every contender that meets the target."""
    found = []
    for group in by_contender(results).values():
        for bare in (False, True):
            best = fastest(group, ladder, bare, target)
            if best is not None:
                found.append((best.seconds(bare)[ladder], bare, best))
    return sorted(found, key=lambda item: item[0])


def ranking(found: Sequence[tuple[float, bool, Result]], ladder: str, unit: str) -> str:
    """Table of what `ranked` found, fastest first."""
    lines = [
        [r.contender.family, r.contender.formulation, r.contender.solver + ", jitted" * bare]
        + [f"{r.tolerance:.0e}", str(r.steps[ladder]), str(r.evaluations[ladder])]
        + [ms(time), f"{time / found[0][0]:.2f}", f"{r.errors[ladder]:.1e}", r.outcome]
        for time, bare, r in found
    ]
    header = ["family", "formulation", "solver", "tolerance", "steps", "evaluations", "time [ms]"]
    return table([*header, "over the fastest", f"error [{unit}]", "result"], lines)


def limit_of_code(found: Sequence[tuple[float, bool, Result]], time: float) -> str:
    """How a time of jaxroll compares with the whole loop written by hand and compiled."""
    loop = next(((t, r) for t, _, r in found if r.contender.family == "Numba"), None)
    if loop is None:
        return ""
    return (
        "The limit of explicit compiled code, a loop written by hand for this scene alone "
        f"({loop[1].contender.solver}, compiled by Numba), takes {ms(loop[0])} ms: jaxroll takes "
        f"{time / loop[0]:.2f} times as long."
    )


def fastest(
    results: Sequence[Result], ladder: str, bare: bool = False, target: float = TARGET
) -> Result | None:
    """The fastest ladder point whose error meets the target."""
    timed = [r for r in results if meets(r, ladder, target) and ladder in r.seconds(bare)]
    return min(timed, key=lambda r: r.seconds(bare)[ladder], default=None)


def meets(result: Result, ladder: str, target: float = TARGET) -> bool:
    return result.errors.get(ladder, np.inf) <= target


def by_contender(results: Sequence[Result]) -> dict[tuple[str, str], list[Result]]:
    groups: dict[tuple[str, str], list[Result]] = {}
    for r in results:
        groups.setdefault((r.contender.formulation, r.contender.solver), []).append(r)
    return groups


def ms(seconds: float | None) -> str:
    return "" if seconds is None else f"{float(f'{1e3 * seconds:.3g}'):g}"


def size(value: float | None) -> str:
    return "" if value is None or np.isnan(value) else f"{value:.1e}"
