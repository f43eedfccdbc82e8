"""Accuracy and cost of Part 1's pinch: each row beside what was asked of it (about three minutes).

`python -m benchmarks.pinch --write` rewrites its section of README.md; `--quick` leaves out a step's cost.
Needs the `test` extra.
"""

import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr
from benchmarks._common import checked, command
from benchmarks.accuracy import imbalance, peak, rows_of
from jaxroll.stability import assess, pinch_statics, rectangle_hessian, VERDICTS
from tests.oracles.chapter_part1 import Part1

jax.config.update("jax_enable_x64", True)

SENSE, START = np.array([1.0, -1.0]), np.array([0.004, -0.003])


def coefficients(grasp, state):
    """Largest difference of the gap's autodiff rows from the printed (1)-(3), eight tangent states."""
    chapter, rng, worst = Part1(np.zeros(2)), np.random.default_rng(0), 0.0
    for _ in range(8):
        s = rng.uniform(-0.01, 0.01, 2)
        guess = np.concatenate([rng.uniform(-0.1, 0.1, 2), rng.uniform(-2.0, 2.0, 6)])
        x = chapter.tangent(guess, s)
        terms = jxr.equation_terms(
            grasp, jxr.State(jnp.asarray(x), state.v, jnp.asarray(SENSE * (START - s)))
        )
        rows = chapter.rows(x, s, chapter.places(x))
        worst = max(worst, peak(terms.normal - rows[:2], terms.tangential - rows[2:]))
    return worst


def independent(grasp, state, rtol):
    """Difference of q from the chapter's full-coordinate equations by SciPy's DOP853, 21 times to 2 s."""
    chapter, ts = Part1(np.zeros(2)), np.linspace(0.0, 2.0, 21)
    chapter.start = chapter.orientations(np.asarray(state.q))
    exact = chapter.simulate(np.asarray(state.q), START, ts)
    return peak(jxr.simulate(grasp, state, 2.0, ts=ts, rtol=rtol).states.q - exact[0])


def hessians(grasp):
    """Hessian of U: autodiff against the corrected (39)-(40), and against central differences."""
    rest, point, h = jnp.zeros(2), jnp.array([0.004, -0.002]), 2e-5
    closed = rectangle_hessian(grasp, rest)
    exact = peak(pinch_statics(grasp, rest).hessian - closed) / peak(closed)
    gradient = lambda s: pinch_statics(grasp, s).gradient  # noqa: E731
    unit = h * jnp.eye(2)
    second = jnp.stack([(gradient(point + e) - gradient(point - e)) / (2 * h) for e in unit])
    here = pinch_statics(grasp, point).hessian
    return exact, peak(here - second) / peak(here)


def lean(grasp, state, t1):
    """Largest angle between O_i P_i and O_1 O_2 where a run ends, and how it ended."""
    run = jxr.simulate(grasp, state, t1, ts=1, throw=False)
    found = jxr.pinch_balance(grasp, run.stats.t_end, run.last)
    return peak(found.lean), str(run).splitlines()[0].removeprefix("Trajectory: "), float(run.stats.t_end)


def step_cost():
    """Time of one accepted step, pinch over pivoted, interleaved: 2 s, default solver, one saved state."""
    scenes = {"pivoted": jxr.scenes.pivoted(), "pinch": jxr.scenes.pinch()}
    run = jax.jit(lambda g, s: jxr.simulate(g, s, 2.0, ts=1, throw=False))
    spent, steps = {name: [] for name in scenes}, {}
    for _ in range(31):
        for name, scene in scenes.items():
            start = time.perf_counter()
            done = jax.block_until_ready(run(*scene))
            spent[name].append(time.perf_counter() - start)
            steps[name] = int(done.stats.accepted)
    each = {name: 1e6 * statistics.median(spent[name][1:]) / steps[name] for name in scenes}
    return each["pinch"] / each["pivoted"], each


def report(quick: bool = False) -> str:
    """Measure all rows."""
    grasp, state = jxr.scenes.pinch()
    start = time.perf_counter()
    jax.block_until_ready(jxr.simulate(grasp, state, 2.0))
    first = time.perf_counter() - start
    run = jxr.simulate(grasp, state, 10.0)
    tight = jxr.simulate(grasp, state, 10.0, rtol=1e-9, record=("energy",))
    free = jxr.scenes.pinch(alpha=0.0)
    violating = jxr.scenes.pinch(tips=jxr.Circle(0.005).moved((0.005, 0.0)), alpha=0.0, s=(0.0003, -0.0003))
    verdicts = [VERDICTS[assess(*scene).verdict] for scene in (free, violating)]
    settled, left = lean(*free, 12.0), lean(*violating, 12.0)
    exact, differences = hessians(grasp)
    table = [
        ("rows of (5)-(6), 10 s, default settings", "<= 1e-12 m", f"{rows_of(run):.1e}"),
        ("(20), 10 s, rtol 1e-9", "<= 1e-9", f"{imbalance(tight):.1e}"),
        ("coefficients of (1)-(3)", "<= 1e-12", f"{coefficients(grasp, state):.1e}"),
        ("q at 2 s, full coordinates, default", "<= 1e-9", f"{independent(grasp, state, 1e-8):.1e}"),
        ("q at 2 s, full coordinates, rtol 1e-11", "<= 1e-9", f"{independent(grasp, state, 1e-11):.1e}"),
        ("(41) holds: angle to the common line at 12 s", "<= 1e-6 rad", f"{settled[0]:.1e} ({verdicts[0]})"),
        ("(41) violated: the same", "leaves", f"{left[0]:.2f} at {left[2]:.2f} s, {left[1]} ({verdicts[1]})"),
        ("Hessian of U against corrected (39)-(40)", "<= 1e-12", f"{exact:.1e}"),
        ("Hessian of U against central differences", "<= 1e-6", f"{differences:.1e}"),
        ("first call of simulate, compilation included", "<= 5 s", f"{first:.1f} s"),
    ]  # fmt: skip
    if not quick:
        ratio, each = step_cost()
        told = f"{ratio:.1f} ({each['pinch']:.1f} us, {each['pivoted']:.1f} us)"
        table.append(("cost of a step, pinch over pivoted", "<= 4", told))
    return checked(table, "jax", "diffrax", "scipy", about="Part 1 agrees with the chapter's equations;")


if __name__ == "__main__":
    command("pinch", report)
