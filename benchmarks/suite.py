"""How long the default tests take, and what with (ten minutes).

`python -m benchmarks.suite --write` rewrites its section of README.md; `--quick`: the tests of one file.
Two processes run `pytest` as README has it, with an empty cache of compiled programs.
"""

import json
import os
import pathlib
import re
import sys
import tempfile
from typing import Any

from benchmarks._common import clocked, command, device, judged, table, uncached, versions, yardstick
from benchmarks._compilations import LONG

# What is asked of the default tests [s], on as many cores as they have processes.
ASKED, PROCESSES = 420.0, 2


def measure(*words: str) -> dict[str, Any]:
    """Wall and processor seconds of `pytest` with these words, its summary, and phases of its processes."""
    with tempfile.TemporaryDirectory() as folder:
        cache = str(pathlib.Path(folder, "cache"))
        env = uncached() | {"JAXROLL_TEST_CACHE": cache, "JAXROLL_COMPILATIONS": folder}
        call = [sys.executable, "-m", "pytest", "-q", "-p", "benchmarks._compilations", *words]
        done, (wall, spent) = clocked(call, env | {"PYTHONPATH": os.getcwd()})
        each = [json.loads(path.read_text()) for path in pathlib.Path(folder).glob("*.json")]
    phases = {name: [sum(found[name][i] for found in each) for i in (0, 1)] for name in each[0]}
    return {"wall": wall, "processor": spent, "said": summary(done.stdout), "phases": phases}


def summary(text: str) -> str:
    """Pytest's last line without its time: how many passed, failed and were left out."""
    found = re.findall(r"^=*\s*(\d+ .*?) in [\d.]+s", text, flags=re.M)
    return found[-1] if found else "no summary"


def report(quick: bool = False) -> str:
    before = yardstick()
    found = measure(*(["tests/test_signs.py"] if quick else []))
    after = yardstick()
    phases = found["phases"]
    long_spent, long_count = phases.pop("long")
    rest = PROCESSES * found["wall"] - sum(seconds for seconds, _ in phases.values())
    rows = [[name, f"{seconds:.0f}", str(count)] for name, (seconds, count) in phases.items()]
    rows += [[f"of that, programs that take {LONG} s and more", f"{long_spent:.0f}", str(long_count)]]
    rows += [["all else: runs, pictures, files, imports, collecting", f"{rest:.0f}", ""]]
    said = f"{found['wall']:.0f} s in {PROCESSES} processes (asked: {judged(found['wall'], ASKED)})"
    text = [
        f"**Conclusion.** The default tests take {said}, {found['processor']:.0f} s of processor time: "
        f"{found['said']}. To take what is asked they might use {PROCESSES * ASKED:.0f} s.",
        table(["part", "seconds, both processes", "how many"], rows),
        f"The loop of ten million additions took {before:.2f} s before and {after:.2f} s after.",
    ]
    return "\n\n".join([*text, f"{device()}  \n{versions('jax', 'jaxlib', 'pytest')}"])


if __name__ == "__main__":
    command("suite", report)
