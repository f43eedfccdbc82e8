"""`reach` from 200 random hands and objects, plane and space: closed starts, and why the others are not.

`python -m benchmarks.reaching --write` rewrites its section of README.md; `--quick` takes 10 hands of each.
A start counts as closed if `residuals` finds all gaps within 1e-12 m and all tangencies within 1e-12.
"""

import collections
import time

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

import jaxroll as jxr  # noqa: E402
from benchmarks._common import command, device, table, versions  # noqa: E402
from tests.subjects.random_hands import random_case  # noqa: E402

HANDS, WANTED, CLOSED = 100, 195, 1e-12


def tried(seed: int, spatial: bool) -> tuple[str, str, float, float, float]:
    """Code, reason, worst residual, seconds and least distance of links of one hand."""
    grasp, points, pose = random_case(seed, spatial=spatial)
    start = time.perf_counter()
    found = jxr.reach(grasp, points, pose=pose)
    took = time.perf_counter() - start
    if found.result != jxr.RESULTS.successful:
        return repr(found.result), found.reason, np.nan, took, found.links
    left = jxr.residuals(*found.start)
    worst = max(float(np.abs(part).max()) for part in (left.normal, left.tangential, left.tangency))
    return repr(found.result), found.reason, worst, took, found.links


def report(quick: bool = False) -> str:
    """How many starts are closed, and why the others are not."""
    count = 10 if quick else HANDS
    rows, lines, closed, coded = [], [], 0, True
    for spatial in (False, True):
        found = [tried(seed, spatial) for seed in range(count)]
        good = [row for row in found if row[0] == "successful" and row[2] <= CLOSED]
        closed += len(good)
        others = [(seed, *row) for seed, row in enumerate(found) if row not in good]
        coded &= all(row[1] != "successful" and row[2] for row in others)
        codes = collections.Counter(row[1] for row in others)
        where = "space" if spatial else "the plane"
        lines += [[where, str(row[0]), row[1], row[2]] for row in others]
        rows.append(
            [
                where,
                f"{len(good)} of {count}",
                ", ".join(f"{n} {code}" for code, n in codes.items()) or "none",
            ]
            + [
                f"{max((row[2] for row in good), default=np.nan):.1e}",
                f"{np.median([x[3] for x in found]):.2f}",
            ]
            + [f"{sum(row[4] < 0 for row in good)}"]
        )
        print(rows[-1], flush=True)
    wanted = WANTED * 2 * count // (2 * HANDS)
    said = (
        f"**Conclusion.** {closed} of {2 * count} starts are closed (asked: {wanted}), "
        f"{'each of the others has its code and reason' if coded else 'and some have no reason'}."
    )
    heads = ["where", "closed", "others", "worst residual [m or rad]", "median [s]", "links meet the object"]
    parts = [said, table(heads, rows)]
    if lines:
        parts.append(table(["where", "hand", "code", "reason"], lines))
    return "\n\n".join([*parts, f"{device()}; {versions('jax', 'numpy')}."])


if __name__ == "__main__":
    command("reaching", report)
