"""Contours given as points alone, all the way through a run: the chapter's scenes, a roller, gradients."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.scenes import OBJECT_SHIFT

HALF = 64  # intervals on either side of the vertex


def bow(a, reach=0.02, count=2 * HALF):
    """Points of the chapter's catenary (80)-(83), the vertex among them."""
    s = np.linspace(-reach, reach, count + 1)
    return np.asarray(jxr.Catenary(a).point(s))


def pivoted_from(tip_points, face_points):
    """Part 2 with the contours of `scenes.pivoted` given by points; their middle one is the vertex."""
    grasp, state = jxr.scenes.pivoted()
    spline = functools.partial(jxr.Spline, closed=False, cells=512)
    tip = spline(tip_points, origin=len(tip_points) // 2).moved((0.01, 0.0)).moved(angle=-np.pi / 2)
    face = spline(face_points, origin=len(face_points) // 2).moved((-0.02, 0.0), np.pi, origin=OBJECT_SHIFT)
    grasp = eqx.tree_at(lambda g: (g.fingers[0].tip, g.object.contours), grasp, (tip, (face,)))
    return grasp, state


def test_part_2_from_128_points():
    """Within 1e-9 rad of the analytic trajectory, with nothing but 128 points per contour."""
    points = [bow(a)[:-1] for a in (1 / 40, 1 / 100)]
    assert all(len(p) == 128 for p in points)
    ts = np.linspace(0.0, 3.0, 31)
    exact = jxr.simulate(*jxr.scenes.pivoted(), t1=3.0, ts=ts, rtol=1e-10)
    run = jxr.simulate(*jxr.close(*pivoted_from(*points)), t1=3.0, ts=ts, rtol=1e-10)
    apart = np.abs(np.asarray(run.states.q - exact.states.q)).max()
    print(f"Part 2 from 128 points: {apart:.3g} rad from the analytic trajectory")
    assert apart <= 1e-9
    left = run.residuals
    assert max(np.abs(x).max() for x in (left.normal, left.tangential, left.tangency)) <= 1e-12


def test_part_1_from_points():
    """The pinch with fingertips given by 128 points each."""
    ts = np.linspace(0.0, 1.0, 11)
    tip = jxr.Spline(bow(1 / 40)[:-1], closed=False, origin=HALF, cells=512).moved((0.01, 0.0))
    exact = jxr.simulate(*jxr.scenes.pinch(), t1=1.0, ts=ts, rtol=1e-9)
    run = jxr.simulate(*jxr.scenes.pinch(tips=tip), t1=1.0, ts=ts, rtol=1e-9)
    apart = np.abs(np.asarray(run.states.q - exact.states.q)).max()
    print(f"Part 1 from 128 points: {apart:.3g} from the analytic trajectory")
    assert apart <= 1e-8


def circle(count, radius=0.01):
    u = 2 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(u), np.sin(u)], -1)


def test_roller_between_plates():
    """A roller of 128 points: half the upper plate's travel to 1e-8 m, and no ripple of its spacing."""
    run = jxr.simulate(
        *jxr.scenes.roller(jxr.Spline(circle(128))), t1=3.0, ts=np.linspace(0.0, 3.0, 1501), rtol=1e-9
    )
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
    run = jxr.simulate(*jxr.scenes.roller(), t1=3.0, ts=np.linspace(0.0, 3.0, 31), rtol=1e-11)
    x, u = np.asarray(run.states.q[:, 0]), np.asarray(run.states.q[:, 3])
    np.testing.assert_allclose(x, 0.5 * u, atol=1e-15)
    np.testing.assert_allclose(u, 0.015 * (1.0 - np.cos(2 * np.pi * run.ts / 3.0)), atol=1e-12)
    forces = jxr.multipliers(jxr.scenes.roller()[0], run.ts, run.states)
    np.testing.assert_allclose(forces.f, 5.0, rtol=1e-9)  # both plates press with what is put on


@pytest.mark.slow
def test_gradient_of_the_whole_chain():
    """Points to field to pose to run to cost: reverse mode against central differences."""
    points = [jnp.asarray(bow(a, count=32)) for a in (1 / 40, 1 / 100)]
    ts = jnp.array([0.0, 0.15, 0.3])

    @jax.jit
    def cost(tip, face):
        grasp, state = jxr.close(*pivoted_from(tip, face))
        run = jxr.simulate(grasp, state, t1=0.3, ts=ts, rtol=1e-9, max_steps=256)
        return jnp.sum(run.states.q[-1] ** 2) + jnp.sum(run.states.q[1] * run.states.v[1])

    gradient = jax.jit(jax.grad(cost, argnums=(0, 1)))(*points)
    rng = np.random.default_rng(0)
    direction = [jnp.asarray(1e-3 * rng.normal(size=p.shape)) for p in points]
    slope = sum(float(jnp.sum(g * d)) for g, d in zip(gradient, direction, strict=True))
    h = 3e-3
    at = {
        k: float(cost(*[p + k * h * d for p, d in zip(points, direction, strict=True)]))
        for k in (-2, -1, 0, 1, 2)
    }
    central = (at[-2] - 8 * at[-1] + 8 * at[1] - at[2]) / (12 * h)
    print(f"gradient of the chain: {slope:.10g}, central differences {central:.10g}")
    np.testing.assert_allclose(slope, central, rtol=1e-6)
