"""Contours from points: each row measured, beside what was asked of it (about three minutes).

`python -m benchmarks.contours --write` rewrites its section of README.md; `--quick` leaves out run times.
Needs the `test` extra.
"""

import time

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

import jaxroll as jxr  # noqa: E402
from benchmarks._common import checked, command  # noqa: E402
from jaxroll.geometry import smoothing_for  # noqa: E402
from tests.measures import observed_order  # noqa: E402
from tests.oracles.known_curves import circle_points, ellipse_errors, ellipse_points, RADIUS  # noqa: E402
from tests.subjects.pivoted_by_points import catenary_points, HALF, pivoted_by_points  # noqa: E402

ROUNDS = 200


def accuracy():
    """64 exact points of an ellipse, and the observed order from 48 to 96."""
    counts = (48, 64, 96)
    errors = np.array([ellipse_errors(jxr.Spline(ellipse_points(n))) for n in counts])
    orders = [-observed_order(np.array(counts), e) for e in errors.T]
    yield "ellipse, 64 points: point, relative", "<= 1e-9", f"{errors[1, 0]:.1e} (order {orders[0]:.1f})"
    yield "tangent [rad]", "<= 1e-8", f"{errors[1, 1]:.1e} (order {orders[1]:.1f})"
    yield "curvature, relative", "<= 1e-6", f"{errors[1, 2]:.1e} (order {orders[2]:.1f})"


def noise():
    """200 points of a 10 mm circle with 1 um noise, twenty times."""
    worst = {"noise level known": 0.0, "cross-validation": 0.0}
    for seed in range(20):
        dots = circle_points() + 1e-6 * np.random.default_rng(seed).normal(size=(200, 2))
        for how, level in zip(worst, (1e-6, None), strict=True):
            disc = jxr.Spline(dots, smoothing=smoothing_for(dots, noise=level)).prepared()
            s = np.linspace(0, float(disc.domain()[1]), 1000)
            worst[how] = max(worst[how], np.abs(np.asarray(disc.curvature(s)) * RADIUS - 1).max())
    for how, error in worst.items():
        yield f"1 um noise on a 10 mm circle: curvature, {how}", "<= 1 %", f"{100 * error:.2f} %"


def chapter():
    """Part 2 with 128 points per contour, against the closed forms."""
    ts = np.linspace(0.0, 3.0, 31)
    exact = jxr.simulate(*jxr.scenes.pivoted(), t1=3.0, ts=ts, rtol=1e-10)
    given = pivoted_by_points(*[catenary_points(a)[: 2 * HALF] for a in (1 / 40, 1 / 100)])
    run = jxr.simulate(*jxr.close(*given), t1=3.0, ts=ts, rtol=1e-10)
    apart = np.abs(np.asarray(run.states.q - exact.states.q)).max()
    yield "Part 2, 128 points per contour", "<= 1e-9 rad", f"{apart:.1e} rad"


def roller():
    """A roller of 128 points between plates, top plate 0-30-0 mm in 3 s: error of its travel."""
    scene = jxr.scenes.roller(jxr.Spline(circle_points(128)))
    run = jxr.simulate(*scene, t1=3.0, ts=np.linspace(0.0, 3.0, 1501), rtol=1e-9)
    x, y, *_ = np.asarray(run.states.q).T
    half = 0.0075 * (1.0 - np.cos(2 * np.pi * np.asarray(run.ts) / 3.0))
    error = np.abs(x - half)
    yield "roller of 128 points: rolling error", "<= 1e-8 m", f"{error.max():.1e} m"
    yield "its ripple (height of the centre)", "none", f"{np.abs(y - RADIUS).max():.1e} m"


def run_time():
    """Warm runs with fields beside their closed forms, interleaved: ratio of medians."""
    shape = jxr.Ellipse(0.015, 0.02)
    dots = shape.point(float(shape.domain()[1]) * np.arange(128) / 128)
    network = jxr.NeuralSupport.through(dots, key=jax.random.key(0))
    fields = {"closed form": shape, "a spline": jxr.Spline(dots), "a network": network}
    pinches = {name: jxr.scenes.pinch(object=_body(field)) for name, field in fields.items()}
    for name, ratio in _ratios(pinches, 1.0).items():
        yield f"run time of a pinched ellipse, {name} over closed form", "<= 1.3", f"{ratio:.2f}"
    catenaries = pivoted_by_points(*[catenary_points(a)[: 2 * HALF] for a in (1 / 40, 1 / 100)])
    chapter = {"closed form": jxr.scenes.pivoted(), "splines": jxr.close(*catenaries)}
    for name, ratio in _ratios(chapter, 3.0).items():
        yield f"run time of Part 2, {name} over catenaries", "<= 1.3", f"{ratio:.2f}"


def _ratios(scenes, t1):
    taken = {name: [] for name in scenes}
    for i in range(ROUNDS):
        for name, scene in scenes.items():
            start = time.perf_counter()
            jax.block_until_ready(jxr.simulate(*scene, t1=t1, ts=11).states.q)
            taken[name] += [time.perf_counter() - start] if i else []
    base = np.median(taken.pop("closed form"))
    return {name: np.median(times) / base for name, times in taken.items()}


def _body(contour):
    return jxr.FreeObject(contour, 0.02, 0.25 * 0.02 * (0.015**2 + 0.02**2))


def report(quick: bool = False) -> str:
    """Measure all rows."""
    parts = (accuracy, noise, chapter, roller) if quick else (accuracy, noise, chapter, roller, run_time)
    rows = [row for part in parts for row in part()]
    return checked(rows, "jax", "diffrax", about="Contours through points behave like closed forms;")


if __name__ == "__main__":
    command("contours", report)
