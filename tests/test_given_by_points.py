"""Contours given as points alone, all the way through a run: the chapter's scenes, a roller, gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from tests.oracles.known_curves import circle_points
from tests.recorded import runs
from tests.subjects.pivoted_by_points import catenary_points, HALF, pivoted_by_points


def test_part_2_from_128_points():
    """Within 1e-9 rad of the analytic trajectory, with nothing but 128 points per contour."""
    points = [catenary_points(a)[:-1] for a in (1 / 40, 1 / 100)]
    assert all(len(p) == 128 for p in points)
    ts = np.linspace(0.0, 3.0, 31)
    exact = jxr.simulate(*jxr.scenes.pivoted(), t1=3.0, ts=ts, rtol=1e-10)
    run = jxr.simulate(*jxr.close(*pivoted_by_points(*points)), t1=3.0, ts=ts, rtol=1e-10)
    apart = np.abs(np.asarray(run.states.q - exact.states.q)).max()
    print(f"Part 2 from 128 points: {apart:.3g} rad from the analytic trajectory")
    assert apart <= 1e-9
    left = run.residuals
    assert max(np.abs(x).max() for x in (left.normal, left.tangential, left.tangency)) <= 1e-12


@pytest.mark.slow
def test_part_1_from_points():
    """The pinch with fingertips given by 128 points each."""
    ts = np.linspace(0.0, 1.0, 11)
    tip = jxr.Spline(catenary_points(1 / 40)[:-1], closed=False, origin=HALF, cells=512).moved((0.01, 0.0))
    exact = jxr.simulate(*jxr.scenes.pinch(), t1=1.0, ts=ts, rtol=1e-9)
    run = jxr.simulate(*jxr.scenes.pinch(tips=tip), t1=1.0, ts=ts, rtol=1e-9)
    apart = np.abs(np.asarray(run.states.q - exact.states.q)).max()
    print(f"Part 1 from 128 points: {apart:.3g} from the analytic trajectory")
    assert apart <= 1e-8


def test_roller_between_plates():
    """A roller of 128 points: half the upper plate's travel to 1e-8 m, and no ripple of its spacing."""
    with runs.not_closed():  # it begins where it touches
        scene = jxr.scenes.roller(jxr.Spline(circle_points(128)))
    run = jxr.simulate(*scene, t1=3.0, ts=np.linspace(0.0, 3.0, 1501), rtol=1e-9)
    x, y, _, u, _ = np.asarray(run.states.q).T
    prescribed = 0.015 * (1.0 - np.cos(2 * np.pi * np.asarray(run.ts) / 3.0))
    error, height = np.abs(x - 0.5 * prescribed).max(), np.abs(y - 0.01).max()
    rolled = np.abs(x - 0.5 * u).max()
    print(
        f"roller of 128 points: travel {error:.3g} m (half the plate's {rolled:.3g}), height {height:.3g} m"
    )
    assert error <= 1e-8 and height <= 1e-10
    assert np.ptp(u) > 0.0299


def test_roller_circle_is_exact():
    with runs.not_closed():  # it begins where it touches
        scene = jxr.scenes.roller()
    options = {"ts": np.linspace(0.0, 3.0, 31), "rtol": 1e-11, "record": ("multipliers",)}
    run = jxr.simulate(*scene, t1=3.0, **options)
    x, u = np.asarray(run.states.q[:, 0]), np.asarray(run.states.q[:, 3])
    np.testing.assert_allclose(x, 0.5 * u, atol=1e-15)
    np.testing.assert_allclose(u, 0.015 * (1.0 - np.cos(2 * np.pi * run.ts / 3.0)), atol=1e-12)
    np.testing.assert_allclose(run.multipliers.f, 5.0, rtol=1e-9)  # both plates press with what is put on


@pytest.mark.slow
def test_gradient_of_the_whole_chain():
    """Points to field to pose to run to cost: reverse mode against central differences."""
    points = [jnp.asarray(catenary_points(a, count=32)) for a in (1 / 40, 1 / 100)]
    ts = jnp.array([0.0, 0.15, 0.3])

    @jax.jit
    def cost(tip, face):
        grasp, state = jxr.close(*pivoted_by_points(tip, face))
        run = jxr.simulate(grasp, state, t1=0.3, ts=ts, rtol=1e-9, max_steps=256)
        return jnp.sum(run.states.q[-1] ** 2) + jnp.sum(run.states.q[1] * run.states.v[1])

    gradient = jax.jit(jax.grad(cost, argnums=(0, 1)))(*points)
    rng = np.random.default_rng(0)
    direction = [jnp.asarray(1e-3 * rng.normal(size=p.shape)) for p in points]
    slope = sum(float(jnp.sum(g * d)) for g, d in zip(gradient, direction, strict=True))
    h = 1e-4
    at = {
        k: float(cost(*[p + k * h * d for p, d in zip(points, direction, strict=True)]))
        for k in (-2, -1, 0, 1, 2)
    }
    central = (at[-2] - 8 * at[-1] + 8 * at[1] - at[2]) / (12 * h)
    print(f"gradient of the chain: {slope:.10g}, central differences {central:.10g}")
    np.testing.assert_allclose(slope, central, rtol=1e-6)
