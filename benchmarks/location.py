"""Location of contacts: pairs per second, and gaps against polygons by brute force (about two minutes).

`python -m benchmarks.location --write` rewrites its section of README.md; `--quick` takes two kinds of pairs,
`--full` compares 10^5 pairs instead of 10^3 (a quarter of an hour and more). Polygons have 10^4 vertices.
Contours are prepared before the clock starts; batches are handed out by as many threads as there are cores.
"spline" is the polar shape by 96 of its points: what a run reads of any field. Needs the `test` extra.
"""

import os
import time
from concurrent.futures import ThreadPoolExecutor

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxroll as jxr  # noqa: E402
from benchmarks._common import command, device, table, versions  # noqa: E402
from jaxroll.contact import locate  # noqa: E402
from tests.oracles.outlines import gap_by_brute_force, KINDS, placed_points, points_of  # noqa: E402
from tests.subjects.polar_contours import compiled_location, compiled_placement, contour_of, random_pairs  # noqa: E402

LANES, VERTICES = 1024, 10_000
# Pairs in one batch of the timing: its samples stay in the cache; 1024 at once take half as long again.
BATCH = 128
# Two polygons of so many vertices may be off by this much [m].
POLYGON = 2e-7


def throughput(kinds: tuple[str, str]) -> tuple[float, float]:
    """Pairs per second of wall time on all cores, and per second of processor time."""
    exact = tuple(kind.replace("spline", "polar") for kind in kinds)
    shapes, pose_a, pose_b = random_pairs(np.random.default_rng(0), exact, LANES, compiled_placement(exact))
    prepare = jax.vmap(lambda s: tuple(contour_of(k, x).prepared() for k, x in zip(kinds, s, strict=True)))
    contours = jax.block_until_ready(jax.jit(prepare)(jax.tree.map(jnp.asarray, shapes)))
    find = jax.jit(jax.vmap(lambda pair, p, q: locate(*pair, pose_a=p, pose_b=q)))

    def cut(start: int) -> tuple:
        rows = slice(start, start + BATCH)
        return jax.tree.map(lambda x: jnp.asarray(x[rows]), (contours, pose_a, pose_b))

    batches = [cut(start) for start in range(0, LANES, BATCH)]

    def batch(i: int) -> None:
        jax.block_until_ready(find(*batches[i % len(batches)]))

    batch(0)
    wall = busy = np.inf
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        for _ in range(5):
            start, used = time.perf_counter(), time.process_time()
            list(threads.map(batch, range(4 * len(batches))))
            wall = min(wall, time.perf_counter() - start)
            busy = min(busy, time.process_time() - used)
    return 4 * LANES / wall, 4 * LANES / busy


def accuracy(kinds: tuple[str, str], count: int) -> tuple[int, int, float, float]:
    """Pairs missed, pairs whose code is not 'successful', worst gap error and residual [m]."""
    place, find, rng = compiled_placement(kinds), compiled_location(kinds), np.random.default_rng(1)
    missed = refused = 0
    worst = residual = 0.0
    for start in range(0, count, LANES):
        shapes, pose_a, pose_b = random_pairs(rng, kinds, LANES, place)
        found = find(shapes, pose_a, pose_b)
        gaps, good = np.asarray(found.gap), np.asarray(found.result == jxr.RESULTS.successful)
        residual = max(residual, float(found.residual.max()))
        for i in range(min(LANES, count - start)):
            outlines = [
                placed_points(points_of(kind, [x[i] for x in shape], VERTICES), pose[i])
                for kind, shape, pose in zip(kinds, shapes, (pose_a, pose_b), strict=True)
            ]
            error = abs(gaps[i] - gap_by_brute_force(*outlines)[0])
            missed, refused = missed + bool(error > POLYGON), refused + bool(not good[i])
            worst = max(worst, error)
    return missed, refused, worst, residual


def report(quick: bool = False, *, full: bool = False) -> str:
    """Both tables, and what they say."""
    chosen = KINDS[:2] if quick else KINDS
    count = (100_000 if full else 1_000) // len(KINDS)
    rates, lines, found = [], [], []
    for kinds in chosen if quick else (*chosen, ("spline", "spline")):
        rates.append(throughput(kinds))
        lines.append([" and ".join(kinds), *(f"{x:.0f}" for x in rates[-1])])
        print(lines[-1], flush=True)
    for kinds in chosen:
        found.append(accuracy(kinds, count))
        print(kinds, found[-1], flush=True)
    compared = [
        [" and ".join(kinds), str(count), str(missed), str(refused), f"{worst:.1e}", f"{residual:.1e}"]
        for kinds, (missed, refused, worst, residual) in zip(chosen, found, strict=True)
    ]
    said = (
        f"**Conclusion.** {sum(f[0] for f in found)} of {count * len(chosen)} pairs are missed (by more than "
        f"{POLYGON:.0e} m), at {min(core for _, core in rates):.0f} pairs a second and core or more."
    )
    speed = table(["shapes", "pairs/s, all cores", "pairs/s of processor time"], lines)
    heads = ["shapes", "compared", "missed", "refused", "worst gap error [m]", "residual [m]"]
    return "\n\n".join([said, speed, table(heads, compared), f"{device()}; {versions('jax', 'jaxlib')}."])


if __name__ == "__main__":
    command("location", report, full="compare 10^5 pairs")
