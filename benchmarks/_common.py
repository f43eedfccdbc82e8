"""What every benchmark needs: versions, interleaved timing, tables in a README."""

import importlib.metadata
import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path

README = Path(__file__).parent / "README.md"


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
    """Median seconds of each call, all of them once per round; slow ones sit out after five rounds."""
    times: list[list[float]] = [[] for _ in calls]
    for turn in range(rounds):
        # Every other round runs backwards, so that no call always follows the same neighbour.
        order = range(len(calls)) if turn % 2 == 0 else reversed(range(len(calls)))
        for i in order:
            if turn >= 5 and statistics.median(times[i]) > 0.1:
                continue
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
