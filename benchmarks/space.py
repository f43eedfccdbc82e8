"""Accuracy and cost of Part 3: each row beside what was asked of it (about three minutes).

`python -m benchmarks.space --write` rewrites its section of README.md; `--quick` takes the closed forms of
single bodies alone. Gradients are tested by `pytest --slow tests/test_pinch3d.py -k gradient`, surfaces
fitted to clouds by `pytest --slow tests/test_surface_fit.py`. Needs the `test` extra.
"""

import statistics
import time

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxroll as jxr  # noqa: E402
from benchmarks._common import checked, command  # noqa: E402
from benchmarks.accuracy import imbalance, peak  # noqa: E402
from tests.oracles import closed_forms_space as closed, reference_space as reference  # noqa: E402
from tests.subjects.pinches_in_space import PINCHES, same_in_reference  # noqa: E402


def run_of(scene, t1, *, ts=101, rtol=1e-12, **options):
    """A run of a scene at a tight tolerance."""
    return jxr.simulate(*scene, t1=t1, ts=ts, rtol=rtol, max_steps=65536, **options)


def relative(found, known):
    """Largest difference over the largest value."""
    return peak(np.asarray(found) - known) / np.abs(known).max()


def turntable():
    """Ten turns of 2/7 Omega: centre and velocity."""
    run = run_of(jxr.scenes.turntable(), 10 * 2 * np.pi / (2 / 7 * 2.0))
    start = (np.array([0.3, 0.1, 0.0]), np.array([0.2, -0.4, 0.0]))
    known = [closed.ball_on_turntable(t, *start, 0.7, Omega=2.0, r=0.05) for t in np.asarray(run.ts)]
    x, v = (np.array([k[i][:2] for k in known]) for i in (0, 1))
    return max(relative(run.states.q[:, :2], x), relative(run.states.v[:, :2], v))


def tube():
    """Height and place round the axis for 10 s."""
    run = run_of(jxr.scenes.tube(), 10.0)
    angle, z, _, _ = closed.ball_in_cylinder(np.asarray(run.ts), 0.0, 0.3, 6.0, 4.0, R=0.2, r=0.05, g=9.81)
    return max(relative(run.states.q[:, 2], z), relative(run.states.q[:, 0], 0.15 * np.cos(angle)))


def incline():
    """Way down a slope, 3 s."""
    run = run_of(jxr.scenes.incline(), 3.0)
    way = 0.5 * closed.incline_acceleration(0.3, 9.81) * np.asarray(run.ts) ** 2
    return relative(run.states.q[:, 0], 0.05 * np.sin(0.3) + way * np.cos(0.3))


def wheel_error(run):
    """Largest error of the centre's path [m]."""
    rim = closed.Wheel(mass=0.5, A=0.25 * 0.5 * 0.01, C=0.5 * 0.5 * 0.01, a=0.1, rho=0.01, gravity=9.81)
    centre, t = rim.steady(1.2, 3.0)[1], np.asarray(run.ts)
    known = np.stack([-centre * np.sin(3 * t), centre * np.cos(3 * t)], axis=-1)
    return peak(np.asarray(run.states.q[:, :2]) - known)


def holonomy():
    """Angle of the rotation that a circle leaves behind [rad]."""
    path = lambda t: (-0.07 * jnp.sin(t), 0.07 * jnp.cos(t), 0.0)  # noqa: E731
    at = {"at_tip": (0.0, 0.0, -0.1), "at_object": (0.07, 0.0, 0.0)}
    rolled = jxr.roll(jxr.Sphere(0.1), jxr.Plane(), path, jnp.linspace(0, 2 * np.pi, 2), **at)
    known = closed.rotation_along_arc(np.array([0.0, 1.0, 0.0]), 0.07, 2 * np.pi, 0.1)
    found = closed.quaternion_matrix(np.asarray(rolled.pose[-1, 3:]))
    return abs(closed.rotation_angle(found) - closed.rotation_angle(known))


def arclengths():
    """Largest difference of the arclengths of both loci, ball on a turntable and a pinch of ellipsoids."""
    worst = 0.0
    for scene, t1 in (
        (jxr.scenes.turntable(), 3.0),
        (jxr.scenes.pinch3d(**PINCHES["ellipsoids"]), 1.0),
    ):
        found = jxr.loci(scene[0], run_of(scene, t1, ts=301, rtol=1e-10))
        worst = max(worst, peak(found.tip.arclength - found.object.arclength))
    return worst


def warm(scene, t1, rtol):
    """Median time of a run [ms]."""
    spent = []
    for _ in range(31):
        start = time.perf_counter()
        run = jax.block_until_ready(run_of(scene, t1, ts=61, rtol=rtol))
        spent.append(time.perf_counter() - start)
    return 1e3 * statistics.median(spent[1:]), run


def bodies():
    """Rows of single bodies that roll, against closed forms."""
    steady, centre = run_of(jxr.scenes.wheel(), 3.0), 0.2660352503865851
    cost, disc = warm(jxr.scenes.wheel(), 3.0, 1e-9)
    at = f"{cost:.1f} ms at {wheel_error(disc):.1e} m"
    return [
        ("ball on a turntable, 10 turns at 2/7 Omega", "<= 1e-9", f"{turntable():.1e}"),
        ("ball in a vertical tube, sqrt(2/7), 10 s", "<= 1e-9", f"{tube():.1e}"),
        ("steady precession of a wheel, 3 s", "<= 1e-9", f"{wheel_error(steady) / centre:.1e}"),
        ("ball on an incline, 5/7, 3 s", "<= 1e-9", f"{incline():.1e}"),
        ("holonomy of a circle", "<= 1e-10 rad", f"{holonomy():.1e}"),
        ("rolling disc, 3 s: time at its error", "<= 30 ms at 1e-8 m", at),
    ]


def rattleback():
    """Rows of the scene that reverses its spin."""
    back = run_of(jxr.scenes.rattleback(), 20.0, rtol=1e-11, record=("energy",))
    spin = np.asarray(back.states.v[:, 5])
    return [
        ("rattleback: spin at 0, 3 s", "reverses", f"{spin[0]:+.2f}, {spin[15]:+.2f} rad/s"),
        ("rattleback, 20 s: energy", "<= 1e-9", f"{imbalance(back):.1e}"),
    ]


def pinched():
    """Rows of the pinch between two fingertips, at default settings for 1 s."""
    scene, start = jxr.scenes.pinch3d(), time.perf_counter()
    run = jxr.simulate(*scene, t1=1.0, ts=11, rtol=1e-8, record=("energy",))
    first, left, judge = time.perf_counter() - start, run.residuals, same_in_reference(scene[0])
    q, _ = reference.simulate(judge, np.asarray(scene[1].q), np.asarray(scene[1].v), np.asarray(run.ts))
    gap = max(peak(x) for x in (left.normal, left.tangential, left.tangency))
    cost, _ = warm(scene, 1.0, 1e-8)
    return [
        ("pinch3d, 1 s, default: gap and tangency", "<= 1e-12 m", f"{gap:.1e}"),
        ("pinch3d, 1 s, default: energy", "<= 1e-9", f"{imbalance(run):.1e}"),
        ("pinch3d, 1 s, default: second formulation", "<= 1e-8", f"{peak(np.asarray(run.states.q) - q):.1e}"),
        ("pinch3d, 1 s: a warm run", "", f"{cost:.1f} ms"),
        ("pinch3d: first call of simulate", "", f"{first:.0f} s"),
        ("A-2: arclengths of both loci", "<= 1e-12 m", f"{arclengths():.1e}"),
    ]


def report(quick: bool = False) -> str:
    """Measure all rows."""
    # First the pinch, whose first call is timed.
    rest = [] if quick else [*pinched(), *rattleback()]
    about = "Rolling in space agrees with closed forms and a second formulation;"
    return checked([*bodies(), *rest], "jax", "diffrax", "scipy", about=about)


if __name__ == "__main__":
    command("space", report)
