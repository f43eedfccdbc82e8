"""Losses of runs that end early, and of shapes that their tables do not resolve: finite, with derivatives."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import jaxroll as jxr
from tests.measures import both_slopes
from tests.subjects.disc_on_a_hill import disc_on_a_hill
from tests.subjects.driven_plate import driven_plate
from tests.subjects.pivoted_by_points import catenary_points


@pytest.fixture(scope="module")
def ended():
    """A run that ends early, with rows that it did not reach; forces and energy recorded."""
    grasp, state = driven_plate()
    soft = grasp.with_(force=jxr.commands.Steps([0.11], [0.5, -0.5]))
    run = jxr.simulate(soft, state, 0.3, ts=4, throw=False, record=("multipliers", "energy"))
    assert bool(run.result == jxr.RESULTS.contact_lost) and float(run.stats.t_end) < 0.2
    return soft, state, run


def test_rows_that_a_run_did_not_reach_stand_still(ended):
    _, _, run = ended
    full = run.filled()
    np.testing.assert_array_equal(full.states.q[:2], run.states.q[:2])
    for i in (2, 3):
        jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[i], b), full.states, run.last)  # noqa: B023
        np.testing.assert_array_equal(full.multipliers.f[i], run.multipliers.f[1])
        np.testing.assert_array_equal(full.energy.kinetic[i], run.energy.kinetic[1])
        np.testing.assert_array_equal(full.residuals.normal[i], run.residuals.normal[1])
    assert bool(full.result == run.result) and full.ts is run.ts


def test_lanes_are_filled_each_by_itself(ended):
    _, _, run = ended
    whole = jax.tree.map(lambda x: jnp.nan_to_num(x, nan=7.0) if x.dtype.kind == "f" else x, run)
    lanes = jax.tree.map(lambda a, b: jnp.stack([a, b]), run, whole)
    full = lanes.filled()
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[0], b), full.states, run.filled().states)
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[1], b), full.states, whole.states)
    np.testing.assert_array_equal(full.multipliers.f[0], run.filled().multipliers.f)


def test_a_run_that_saved_nothing_is_filled_too(ended):
    grasp, state, _ = ended
    late = [0.25, 0.27, 0.29, 0.3]  # as many as above: the same program
    run = jxr.simulate(grasp, state, 0.3, ts=late, throw=False, record=("multipliers", "energy"))
    full = run.filled()
    np.testing.assert_array_equal(full.states.q, np.stack([run.last.q] * 4))
    assert not np.any(full.multipliers.f) and not np.any(full.energy.kinetic)


class Lifted(eqx.Module):
    """A load that lifts the object from a moment on, which it declares."""

    force: jxr.commands.Steps

    def __call__(self, t, pose, twist):
        return jnp.stack([jnp.zeros(()), self.force(t)]), -1e-5 * twist.spin


def test_the_derivative_of_filled_rows_is_that_of_the_end():
    """Through rows, `last` and `t_end` together, in both modes, against differences."""

    def loss(late):
        lift = Lifted(jxr.commands.Steps(jnp.array([0.11]) + late, [0.0, 1.0]))
        scene = disc_on_a_hill(mass=0.05 + late, load=lift)
        run = jxr.simulate(*scene, 0.3, ts=4, rtol=1e-11, throw=False)
        return jnp.mean(run.filled().states.q ** 2) + (0.3 - run.stats.t_end) ** 2

    step, both = 1e-6, both_slopes(loss)
    wanted = (both(step)[0] - both(-step)[0]) / (2 * step)
    np.testing.assert_allclose(both(0.0)[1:], wanted, rtol=1e-7)


def _smooth_points(seed):
    """15 points of the chapter's catenary, with a few long waves of 0.3 mm."""
    rng, u = np.random.default_rng(seed), np.linspace(-1.0, 1.0, 15)
    waves = [
        rng.normal(size=(1, 2)) * np.cos(k * np.pi * u + rng.uniform(0, 6))[:, None] / k**3 for k in (1, 2, 3)
    ]
    return catenary_points(1 / 40, count=14) + 3e-4 * sum(waves)


@pytest.fixture(scope="module")
def goal():
    """Value and gradient: a disc on a hill of these points is to turn by 1 rad soon, and the run to last."""
    grasp, state = disc_on_a_hill(gravity=(0.3, -9.8))

    def loss(points):
        hill = jxr.Spline(points, closed=False, cells=256, origin=7)
        closed, start = jxr.close(grasp.with_tip(0, hill), state)
        run = jxr.simulate(closed, start, 0.1, ts=11, rtol=1e-6, throw=False, max_steps=512)
        turned = run.filled().states.q[:, 2]
        return jnp.mean((turned - turned[0] + 1.0) ** 2) + 5.0 * (0.1 - run.stats.t_end), run.result

    return eqx.filter_jit(jax.value_and_grad(loss, has_aux=True))


def test_a_shape_that_its_table_does_not_resolve_says_so_and_stays_finite(goal):
    """One point 2 mm off, where they are 3 mm apart: told by the code, not by NaN."""
    points = _smooth_points(0)
    points[1, 0] += 2e-3
    with pytest.raises(ValueError, match="argument cells must be more than 256"):
        jxr.Spline(points, closed=False, cells=256, origin=7).curvature(0.0)
    (value, code), slope = goal(points)
    assert bool(code == jxr.RESULTS.unresolved)
    assert np.isfinite(value) and np.isfinite(slope).all()
    (_, code), _ = goal(_smooth_points(0))
    assert bool(code == jxr.RESULTS.successful)


def _descended(goal, seed, steps, *, rate):
    points, optimiser = _smooth_points(seed), optax.adam(rate)
    memory, values = optimiser.init(points), []
    for _ in range(steps):
        (value, _), slope = goal(points)
        assert np.isfinite(slope).all()
        values.append(float(value))
        change, memory = optimiser.update(slope, memory)
        points = optax.apply_updates(points, change)
    return values


def test_an_optimiser_over_points_goes_on_where_shapes_fail(goal):
    """Plain Adam on 15 points of a spline: after some steps the contour is too wavy for its table."""
    values = _descended(goal, 0, 40, rate=5e-6)
    assert np.isfinite(values).all() and values[-1] < 0.8 * values[0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_an_optimiser_over_points_from_ten_starts(goal, seed):
    values = _descended(goal, seed, 100, rate=1e-6)
    assert np.isfinite(values).all() and values[-1] < 0.9 * values[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "asked"), [(None, 1e-8), (jxr.Rosenbrock(), 1e-7)], ids=["dopri8", "rosenbrock"]
)
def test_gradients_of_settling_time_and_peak_force_in_spline_points(solver, asked):
    """Through `close` and a run of steps of equal length, against differences along a random direction."""
    grasp, state = jxr.scenes.pivoted()
    points = catenary_points(1 / 40, 0.02, 14)

    def values(x):
        tip = jxr.Spline(points + 1e-4 * x, closed=False, cells=256, origin=7)
        tip = tip.moved((0.01, 0.0)).moved(angle=-np.pi / 2)
        run = jxr.simulate(
            *jxr.close(grasp.with_tip(0, tip), state),
            1.5,
            ts=76,
            solver=solver,
            stepsize_controller=diffrax.ConstantStepSize(),
            dt0=5e-3,
            record=("multipliers",),
        )
        # After its start, where it is largest but does not depend on the run.
        peak = jnp.max(jnp.abs(run.multipliers.lam[1:]))
        return jnp.stack([jxr.design.settling_time(run), peak, jnp.max(run.multipliers.f[20:])])

    @jax.jit
    def both(x, bar):
        seen, pull = jax.vjp(values, x)
        return seen, pull(bar)[0]

    along, bars = np.random.default_rng(0).normal(size=points.shape), np.eye(3)
    # Of eighth order, so that steps may be long: `Rosenbrock` has a noise of its own, of its Jacobian.
    size, weights = 1.5e-2, (4 / 5, -1 / 5, 4 / 105, -1 / 280)
    slopes = 0.0
    for k, weight in enumerate(weights, start=1):
        ends = [np.asarray(both(side * k * size * along, bars[0])[0]) for side in (-1, 1)]
        slopes += weight * (ends[1] - ends[0]) / size
    found = [np.sum(np.asarray(both(jnp.zeros(points.shape), bar)[1]) * along) for bar in bars]
    np.testing.assert_allclose(found, slopes, rtol=asked)
