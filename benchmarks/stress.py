"""10^5 random scenes, judged by code that shares nothing with the engine (three quarters of an hour).

`python -m benchmarks.stress --write` rewrites its section of README.md; `--quick`: one batch of each of a few
structures. `--structure NAME ...` runs those structures alone; with `--seed N --lane K` too it runs the batch
of one lane again, and prints all that was measured of that lane. Each structure runs in a process of its own.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._common import device, table, uncached, versions, write_section

_SHOWN = ("gap", "tangency", "creep", "force", "energy", "defect", "agreement")
# Structures of the short form, one batch of each.
_QUICK = ("pivot-catenary", "graze-lift", "cancel-free")


def outcome(name: str, seed: int, chunks: int | None) -> dict[str, Any]:
    """What became of the lanes of one structure: codes, worst measures and their lanes, what is wrong."""
    from benchmarks.stress_test.one_batch import Batches
    from benchmarks.stress_test.structures import STRUCTURES

    structure = STRUCTURES[name]
    batches, codes, start = Batches(structure), Counter(), time.perf_counter()
    worst: dict[str, tuple[float, int]] = {}
    wrong: list[tuple[int, str, list[str]]] = []
    first = 0.0
    for chunk in range(structure.chunks if chunks is None else min(chunks, structure.chunks)):
        found = batches(seed, chunk)
        first = first or time.perf_counter() - start
        codes.update(found.code.tolist())
        for measure in _SHOWN:
            values = np.where(np.isfinite(found.measures[measure]), found.measures[measure], -np.inf)
            i = int(np.argmax(values))
            here = (float(values[i]), chunk * structure.lanes + i)
            worst[measure] = max(worst.get(measure, (-np.inf, 0)), here)
        for i, words in enumerate(found.wrong):
            if words:
                wrong.append((chunk * structure.lanes + i, str(found.code[i]), words))
    seconds = time.perf_counter() - start
    return {"name": name, "codes": codes, "worst": worst, "wrong": wrong, "seconds": seconds, "first": first}


def one_lane(name: str, seed: int, lane: int) -> str:
    """All that was measured of one lane."""
    from benchmarks.stress_test.one_batch import Batches
    from benchmarks.stress_test.structures import STRUCTURES

    structure = STRUCTURES[name]
    chunk, i = divmod(lane, structure.lanes)
    found = Batches(structure)(seed, chunk)
    lines = [
        f"{name}, seed {seed}, lane {lane}: {found.code[i]}; wrong: {'; '.join(found.wrong[i]) or 'nothing'}"
    ]
    lines += [f"  {what:14} {values[i]}" for what, values in found.measures.items()]
    return "\n".join(lines)


def _fresh(name: str, seed: int, quick: bool) -> dict[str, Any]:
    """The outcome of a structure, worked out in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "outcome.json"
        call = [sys.executable, "-m", "benchmarks.stress", "--structure", name, "--seed", str(seed)]
        call += ["--json", str(file), *(["--quick"] if quick else [])]
        done = subprocess.run(call, env=uncached() | _CACHE, capture_output=True, text=True, check=False)
        if done.returncode:
            last = done.stderr.strip().splitlines()[-1:]
            return {"name": name, "codes": {}, "worst": {}, "wrong": [(-1, "none", last)], "seconds": 0.0}
        return json.loads(file.read_text())


# Programs are kept between the processes of one machine where the caller says where.
_CACHE = {k: v for k, v in os.environ.items() if k.startswith("JAX_COMPILATION_CACHE")}


def report(names: list[str], seed: int, quick: bool, workers: int) -> str:
    """Run structures, some at a time, and say what came of them."""
    start = time.perf_counter()
    with ThreadPoolExecutor(workers) as pool:
        found = []
        for result in pool.map(lambda name: _fresh(name, seed, quick), names):
            codes = ", ".join(f"{code} {count}" for code, count in Counter(result["codes"]).most_common())
            said = f"{result['name']}: {result['seconds']:.0f} s; {codes}; {len(result['wrong'])} wrong"
            print("\n".join([said, *_offences([result])]), file=sys.stderr, flush=True)
            found.append(result)
    rows = [_row(result) for result in found]
    lanes = sum(sum(result["codes"].values()) for result in found)
    wrong = sum(len(result["wrong"]) for result in found)
    clean = sum(not result["wrong"] for result in found)
    codes = Counter()
    for result in found:
        codes.update(result["codes"])
    said = ", ".join(f"{count} {code}" for code, count in codes.most_common())
    head = f"**Conclusion.** Of {lanes} scenes of {len(found)} structures {wrong} are wrong"
    head += f"; {clean} structures have none." if wrong else "."
    header = ["structure", "scenes", "ends", *_SHOWN, "wrong"]
    parts = [head, f"Ends: {said}.", table(header, rows), *_offences(found)]
    took = f"{(time.perf_counter() - start) / 60:.0f} minutes, {workers} processes"
    return "\n\n".join(
        [*parts, f"Seed {seed}; {took}; {device()}; {versions('jax', 'jaxlib', 'diffrax', 'numpy')}."]
    )


def _row(result: dict[str, Any]) -> list[str]:
    codes, worst = Counter(result["codes"]), result["worst"]
    ends = ", ".join(f"{code} {count}" for code, count in codes.most_common())
    cells = [
        f"{worst[m][0]:.0e} ({worst[m][1]})" if m in worst and np.isfinite(worst[m][0]) else ""
        for m in _SHOWN
    ]
    return [f"`{result['name']}`", str(sum(codes.values())), ends, *cells, str(len(result["wrong"]))]


def _offences(found: list[dict[str, Any]]) -> list[str]:
    """The first wrong lanes of every structure, in words."""
    lines = [
        f"- `--structure {result['name']} --lane {lane}`: {code}; {'; '.join(words)}"
        for result in found
        for lane, code, words in result["wrong"][:5]
    ]
    return ["\n".join(lines)] if lines else []


def main() -> None:
    parser = argparse.ArgumentParser("python -m benchmarks.stress", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one batch of each of a few structures")
    parser.add_argument("--write", action="store_true", help="rewrite the section of README.md")
    parser.add_argument("--structure", nargs="+", metavar="NAME", help="these structures alone")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lane", type=int, help="one lane of one structure, in detail")
    parser.add_argument("--workers", type=int, default=2, help="structures at a time")
    parser.add_argument("--json", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.json is None and options.lane is None:
        from benchmarks.stress_test.structures import STRUCTURES

        names = options.structure or (_QUICK if options.quick else STRUCTURES)
        text = report(list(names), options.seed, options.quick, options.workers)
        print(text)
        if options.write:
            write_section("stress", text)
        return
    import jax

    name = options.structure[0]
    # Single precision is a process without the other one.
    jax.config.update("jax_enable_x64", name != "single")
    if options.lane is not None:
        print(one_lane(name, options.seed, options.lane))
        return
    found = outcome(name, options.seed, 1 if options.quick else None)
    Path(options.json).write_text(json.dumps(found))


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
