"""The accuracy table of the main README: each row measured, beside what was asked of it (about a minute).

`python -m benchmarks.accuracy --write` rewrites its section of README.md; `--quick` leaves out the observed
orders. Needs the `test` extra.
"""

import time

import diffrax
import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from scipy.integrate import solve_ivp  # noqa: E402

import jaxroll as jxr  # noqa: E402
from benchmarks._common import checked, command  # noqa: E402
from tests.measures import observed_order  # noqa: E402
from tests.oracles.chapter_part2 import Part2  # noqa: E402

ELBOW = 1


def peak(*arrays):
    """Largest absolute value."""
    return max(float(np.abs(np.asarray(a)).max()) for a in arrays)


def rows_of(run):
    """Largest constraint residual of a run, metres and radians together."""
    left = run.residuals
    return peak(left.normal, left.tangential, left.tangency)


def gap_of(run):
    """Largest gap of a run, in metres."""
    return peak(run.residuals.normal, run.residuals.tangential)


def imbalance(run):
    """Largest energy residual relative to the energy at the start."""
    return peak(run.energy.residual) / float(run.energy.kinetic[0] + run.energy.potential[0])


def independent(grasp, state):
    """Difference from the minimal-coordinate motion by SciPy's DOP853 at 1e-13, over 31 times."""
    chapter, ts = Part2(), np.linspace(0.0, 3.0, 31)
    field = chapter.acceleration(ELBOW)
    rates = lambda t, y: [y[1], float(field(y[0], y[1]))]  # noqa: E731
    exact = solve_ivp(rates, (0, 3), [0.003, 0.0], method="DOP853", rtol=1e-13, atol=1e-15, t_eval=ts)
    poses = jax.vmap(lambda s: chapter.pose(s, ELBOW))(jnp.asarray(exact.y[0]))
    at = lambda rtol: peak(jxr.simulate(grasp, state, 3.0, ts=ts, rtol=rtol).states.q - poses)  # noqa: E731
    return at(1e-8), at(1e-11)


def order(grasp, state, solver, t1, ladder):
    """Observed order of a solver in equal projected steps, without damping."""
    free, ts = grasp.with_(damping=0.0), np.linspace(0.0, t1, 5)[1:]

    def end(method, steps):
        equal = diffrax.ConstantStepSize()
        options = {"solver": method, "stepsize_controller": equal, "dt0": t1 / steps}
        run = jxr.simulate(free, state, t1, ts=ts, **options)
        return np.concatenate([run.states.q, run.states.v / 10.0], axis=1)

    exact = end(diffrax.Dopri8(), 800)
    errors = [np.sqrt(np.mean((end(solver, n) - exact) ** 2)) for n in ladder]
    return -observed_order(np.array(ladder), errors)


def report(quick: bool = False) -> str:
    """Measure all rows."""
    grasp, state = jxr.scenes.pivoted()
    start = time.perf_counter()
    run = jax.block_until_ready(jxr.simulate(grasp, state, 3.0))
    first = time.perf_counter() - start
    tight = jxr.simulate(grasp, state, 3.0, rtol=1e-9, record=("energy",))
    free = grasp.with_(damping=0.0)
    long = jxr.simulate(free, state, 100.0, rtol=1e-9, record=("energy",), max_steps=200_000)
    endless = jxr.simulate(free, state, 1000.0, rtol=1e-9, ts=1001, record=("energy",), max_steps=200_000)
    at_default, at_tight = independent(grasp, state)
    csm = jxr.simulate(grasp, state, 3.0, ts=31, rtol=1e-9, formulation=jxr.CSM(), max_steps=50_000)
    projected = jxr.simulate(grasp, state, 3.0, ts=31, rtol=1e-11)
    table = [
        ("constraint rows, 3 s, default settings", "<= 1e-12 m, rad", f"{rows_of(run):.1e}"),
        ("constraint rows, undamped, 100 s", "<= 1e-12 m, rad", f"{rows_of(long):.1e}"),
        ("gap, undamped, 1000 s, rtol 1e-9", "<= 1e-14 m", f"{gap_of(endless):.1e}"),
        ("energy identity, 3 s, rtol 1e-9", "<= 1e-9", f"{imbalance(tight):.1e}"),
        ("energy identity, undamped, 100 s, rtol 1e-9", "<= 1e-6", f"{imbalance(long):.1e}"),
        ("energy identity, undamped, 1000 s, rtol 1e-9", "<= 1e-7", f"{imbalance(endless):.1e}"),
        ("angles against minimal coordinates, default", "", f"{at_default:.1e} rad"),
        ("angles against minimal coordinates, rtol 1e-11", "<= 1e-9 rad", f"{at_tight:.1e} rad"),
        ("csm against index1, rtol 1e-9, angles", "integration error",
         f"{peak(csm.states.q - projected.states.q):.1e} rad, gap {gap_of(csm):.0e} m"),
        ("first call of simulate, compilation included", "<= 3 s", f"{first:.1f} s"),
    ]  # fmt: skip
    if not quick:
        table += orders(grasp, state)
    about = f"Runs stay within {rows_of(long):.1e} m and rad of the contact over 100 s;"
    return checked(table, "jax", "diffrax", "scipy", about=about)


def orders(grasp, state):
    """Rows of the observed orders."""
    low = order(grasp, state, diffrax.Tsit5(), 0.2, (64, 96, 128, 160))
    high = order(grasp, state, diffrax.Dopri8(), 0.3, (24, 28, 32, 40))
    return [
        ("observed order, Tsit5 with projection", "5 +- 0.3", f"{low:.2f}"),
        ("observed order, Dopri8 with projection", "8 +- 0.5", f"{high:.2f}"),
    ]


if __name__ == "__main__":
    command("accuracy", report)
