"""Fingertip design: each row measured, beside what was asked of it (about five minutes).

`python -m benchmarks.design --write` rewrites its section of README.md; `--quick` leaves out gradients and
robust searches. Needs the `test` extra.
"""

import logging
import os
import statistics
import subprocess
import sys
import tempfile
import time

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipe

import jaxroll as jxr
from benchmarks._common import checked, command
from jaxroll.design import ClosedLoop, Firmness, Limits, optimise_fingertip, value_and_grad
from tests.subjects.fingertips import ellipse_pinched_by, INTERVAL, pivoted_with_tip, violating_points

jax.config.update("jax_enable_x64", True)


def seeds():
    """Twenty violating splines in one batch: how many hold, in how many steps, least margin [mm]."""
    tips = [jxr.Spline(violating_points(seed), cells=128) for seed in range(20)]
    limits = Limits(size=0.02, radius=0.001, flat=0.1)
    design = optimise_fingertip(tips, INTERVAL, steps=200, limits=limits)
    start = time.perf_counter()
    optimise_fingertip(tips, INTERVAL, steps=200, limits=limits)
    worst = 1e3 * float(jnp.min(design.after))
    return int(design.holds.sum()), design.history.shape[1], worst, time.perf_counter() - start


def ellipse():
    """Largest relative error of both half axes against the closed form."""
    length, radius = 0.1, 0.004
    limits = Limits(length=length, radius=radius, flat=None)
    design = optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, limits=limits, steps=300)
    b = brentq(lambda b: 4 * b * ellipe(1 - radius / b) - length, 0.01, 0.03)
    known = np.array([np.sqrt(radius * b), b])
    return float(np.max(np.abs(np.array([design.tip.a, design.tip.b]) / known - 1)))


def infeasible():
    """Result code, and by how much the best point found passes its limits."""
    limits = Limits(length=0.04, radius=0.008, flat=None)
    design = optimise_fingertip(jxr.Ellipse(0.01, 0.01), INTERVAL, limits=limits, steps=60)
    return design.result == jxr.RESULTS.infeasible, float(design.violation[0])


def command_line():
    """Seconds of `jaxroll design` once its programs are compiled: the second of two processes."""
    with tempfile.TemporaryDirectory() as folder:
        env = os.environ | {"JAXROLL_CACHE": f"{folder}/cache"}
        call = [sys.executable, "-m", "jaxroll", "design", "--out", f"{folder}/out"]
        for _ in range(2):
            start = time.perf_counter()
            told = subprocess.run(call, env=env, capture_output=True, text=True, check=True)
            spent = time.perf_counter() - start
        inside = sum(float(line.split()[-2]) for line in told.stderr.splitlines() if line.endswith(" s"))
    return spent, inside


def timed(function, x):
    """Seconds to trace and to compile a function, and the program."""
    start = time.perf_counter()
    lowered = jax.jit(function).lower(x)
    traced = time.perf_counter()
    program = lowered.compile()
    return (traced - start, time.perf_counter() - traced), program


def ratio(primal, derived, x):
    """Median seconds of the primal, and how many times as long the derivative takes; interleaved."""
    spent = [], []
    for _ in range(25):
        for program, times in zip((primal, derived), spent, strict=True):
            start = time.perf_counter()
            jax.block_until_ready(program(x))
            times.append(time.perf_counter() - start)
    first, second = (statistics.median(times) for times in spent)
    return first, second / first


def gradients(make, objective, x):
    """Error against differences, compile times and run times over the primal, in both modes."""
    goal = ClosedLoop(make, objective, t1=0.5, ts=51, rtol=1e-10)  # differences see every step that changes
    cost = lambda x: goal.cost(jxr.Ellipse(x[0], x[1]), None, 1.0, 1.0)  # noqa: E731
    _, primal = timed(cost, x)
    way, h = jnp.array([0.6, -0.8]), 1e-5
    ends = [float(primal(x + k * h * way)) for k in (-2, -1, 1, 2)]
    expected = (ends[0] - 8.0 * ends[1] + 8.0 * ends[2] - ends[3]) / (12.0 * h)
    found = {}
    for mode in ("forward", "reverse"):
        compiling, program = timed(value_and_grad(cost, mode), x)
        error = abs(float(program(x)[1] @ way) / expected - 1.0)
        found[mode] = (error, compiling, *ratio(primal, program, x))
    return found


class Messages(logging.Handler):
    """What was logged."""

    def __init__(self):
        super().__init__()
        self.texts = []

    def emit(self, record):
        self.texts.append(record.getMessage())


def robust():
    """64 objects: programs of the search compiled in 80 steps after the first ten, seconds, figures."""
    goal = Firmness(ellipse_pinched_by, cases=jnp.linspace(0.012, 0.018, 64))
    limits = Limits(size=0.02, radius=0.004, ahead=0.006)
    start = jxr.Ellipse(0.012, 0.012)
    optimise_fingertip(start, INTERVAL, goal=goal, limits=limits, steps=10)
    seen = Messages()
    logging.getLogger("jax").addHandler(seen)
    begun = time.perf_counter()
    with jax.log_compiles():
        design = optimise_fingertip(start, INTERVAL, goal=goal, limits=limits, steps=80)
    spent = time.perf_counter() - begun
    logging.getLogger("jax").removeHandler(seen)
    names = ("_advance", "_outcomes", "_first")
    again = sum(f"Compiling jit({name})" in text for text in seen.texts for name in names)
    return again, spent, design.figures


LIGHT = {"settling_time": 1.0, "tracking_error": 1.0}
FULL = LIGHT | {"peak_force": 0.2, "friction_demand": 0.5}


def searches():
    """Rows of searches on the shape alone, and of the command."""
    holds, steps, margin, warm = seeds()
    code, passed = infeasible()
    whole, inside = command_line()
    start = "violating starts, 20 seeds, that reach a positive margin"
    return [
        (start, "20 in <= 200 steps", f"{holds} in {steps}"),
        ("their least margin; a second search", "", f"{margin:.1f} mm; {warm:.2g} s"),
        (
            "default `jaxroll design` compiled before",
            "<= 10 s",
            f"{inside:.1f} s ({whole:.1f} s with Python)",
        ),
        ("two-parameter ellipse against its closed form", "<= 1e-6", f"{ellipse():.1e}"),
        ("limits that exclude (41)", "a code, the best point", f"infeasible: {code}, passed by {passed:.0%}"),
    ]


def robust_rows():
    """Rows of a search over 64 objects."""
    again, spent, figures = robust()
    stiff = figures["least stiffness [N m/rad]"]
    return [
        ("64 objects: programs compiled after the first steps; 80 steps", "none", f"{again}; {spent:.2g} s"),
        ("their least stiffness", "", f"{stiff[0]:.4f} to {stiff[1]:.4f} N m/rad"),
    ]


def gradient_rows():
    """Rows of gradients through runs, in both modes."""
    pinching, x, rows = lambda tip: ellipse_pinched_by(tip), jnp.array([0.012, 0.02]), []
    for name, make, objective in (
        ("Part 2, settling", pivoted_with_tip, LIGHT),
        ("Part 2, settling and forces", pivoted_with_tip, FULL),
        ("Part 1, way to rest", pinching, {"tracking_error": 1.0}),
    ):
        for mode, (error, compiling, primal, times) in gradients(make, objective, x).items():
            cost = f"{compiling[1]:.1f} s + {compiling[0]:.1f} s traced"
            told = f"{error:.1e}; {times:.1f} x {1e3 * primal:.2g} ms; {cost}"
            asked = "<= 1e-6; <= 5 x; <= 8 s"
            rows.append((f"{name}, {mode}: error; run; value and gradient compiled", asked, told))
    return rows


def report(quick: bool = False) -> str:
    """Measure all rows."""
    rows = searches() if quick else [*searches(), *robust_rows(), *gradient_rows()]
    about = "Searches end at closed-form optima and gradients are those of differences;"
    return checked(rows, "jax", "diffrax", "optax", about=about)


if __name__ == "__main__":
    command("design", report)
