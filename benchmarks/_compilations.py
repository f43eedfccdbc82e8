"""A plug-in of pytest that writes down what a test process spent on compiling.

`benchmarks.suite` runs `pytest -p benchmarks._compilations`. JAX reports every trace, lowering and
compilation with its duration when it ends. A trace within another one is reported too, so that durations are
not added up: what counts is the time that their intervals cover. Programs that take long to compile are
counted apart.
"""

import json
import os
import pathlib
import time
from typing import Any

import jax
import jax.monitoring

# What JAX calls the phases, and what they are called on the benchmark page.
_PHASES = {
    "jaxpr_trace_duration": "tracing",
    "jaxpr_to_mlir_module_duration": "lowering",
    "backend_compile_duration": "compiling",
}
# A program that takes at least as much to compile is a long one [s].
LONG = 0.2
_intervals: dict[str, list[tuple[float, float]]] = {name: [] for name in _PHASES.values()}


def _noted(event: str, duration: float, **_: Any) -> None:
    phase = _PHASES.get(event.rsplit("/", 1)[-1])
    if phase is not None:
        end = time.perf_counter()
        _intervals[phase].append((end - duration, end))


jax.monitoring.register_event_duration_secs_listener(_noted)


def covered(intervals: list[tuple[float, float]]) -> float:
    """Length of the union of intervals."""
    total, reached = 0.0, float("-inf")
    for start, end in sorted(intervals):
        total += max(0.0, end - max(start, reached))
        reached = max(reached, end)
    return total


def pytest_sessionfinish() -> None:
    """Leave a file of this process in the folder that `benchmarks.suite` reads."""
    folder = os.environ.get("JAXROLL_COMPILATIONS")
    if folder is not None:
        found = {phase: [covered(each), len(each)] for phase, each in _intervals.items()}
        long = [(start, end) for start, end in _intervals["compiling"] if end - start >= LONG]
        found["long"] = [covered(long), len(long)]
        pathlib.Path(folder, f"{os.getpid()}.json").write_text(json.dumps(found))
