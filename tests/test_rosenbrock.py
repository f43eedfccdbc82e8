"""Rosenbrock's method: its order, stiff problems with a closed form, and runs of the pinch in every mode."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._integration import _rosenbrock
from jaxroll._integration._rosenbrock import (
    _ERROR,
    _GAMMA,
    _LAGS,
    _ROWS,
    _SLOPES,
    advance,
    inverted,
    STAGE_TIMES,
)
from tests.measures import observed_order
from tests.subjects.disc_on_a_hill import disc_on_a_hill

STIFF = jxr.Rosenbrock()


@eqx.filter_jit
def solved(field, y0, t1, steps):
    """End of a diffrax run in equal steps, whose number is an array: one program for all."""
    equal = diffrax.ConstantStepSize()
    terms = diffrax.ODETerm(lambda t, y, _: field(t, y))
    done = diffrax.diffeqsolve(terms, STIFF, 0.0, t1, t1 / steps, y0, stepsize_controller=equal)
    return jax.tree.map(lambda y: y[-1], done.ys)


def turning(t, y):
    """Its solution from (1, 0) is the unit circle at the angle t^2, after z = r exp(cos t) for both."""
    x, z = y["x"], y["z"]
    angle = jnp.stack([-x[1], x[0]])
    return {"x": 2.0 * t * angle, "z": -jnp.sin(t) * z - (z * z - jnp.exp(2.0 * jnp.cos(t)))}


def test_observed_order_on_a_closed_form():
    sizes, errors = np.array([20, 28, 40, 56]), []
    for steps in sizes:
        end = solved(turning, {"x": jnp.array([1.0, 0.0]), "z": jnp.exp(1.0)}, 2.0, jnp.array(steps))
        exact = np.array([np.cos(4.0), np.sin(4.0), np.exp(np.cos(2.0))])
        found = np.append(end["x"], end["z"])
        errors.append(np.abs(found - exact).max())
    assert errors[0] < 1e-4
    assert abs(-observed_order(sizes, errors) - 5.0) < 0.3


def test_between_its_steps_is_a_cubic_in_a_run_of_diffrax():
    """Its error is at most h^4/384 of the fourth derivative; on straight lines it would be h^2/8."""
    equal, ts, h = diffrax.ConstantStepSize(), jnp.linspace(0.0, 3.0, 101), 0.15
    falling = lambda t, y, _: jax.tree.map(jnp.negative, y)  # noqa: E731
    terms, saved = diffrax.ODETerm(falling), diffrax.SaveAt(ts=ts)
    start = {"x": jnp.ones(1), "y": jnp.array(2.0)}
    done = diffrax.diffeqsolve(
        terms, STIFF, 0.0, 3.0, h, start, stepsize_controller=equal, saveat=saved, max_steps=20
    )
    for found, size in ((done.ys["x"][:, 0], 1.0), (done.ys["y"], 2.0)):
        assert np.abs(found - size * np.exp(-ts)).max() <= size * h**4 / 384.0


def drawn(rate, t, y):
    """Towards cos(t), at a rate."""
    return -rate * (y - jnp.cos(t)) - jnp.sin(t)


@pytest.mark.parametrize("rate", [1e3, 1e6, 1e9])
def test_fast_rates_do_not_set_the_step(rate):
    """Prothero and Robinson: y' = -rate (y - cos t) - sin t, whose solution from 1 is cos t."""
    end = solved(jax.tree_util.Partial(drawn, jnp.array(rate)), jnp.ones(1), 2.0, jnp.array(40))
    assert abs(float(end[0]) - np.cos(2.0)) < 1e-7


def test_the_inverse_and_its_derivative():
    rng = np.random.default_rng(0)
    matrix = rng.standard_normal((7, 7)) + 4.0 * np.eye(7)
    np.testing.assert_allclose(inverted(matrix), np.linalg.inv(matrix), rtol=1e-11, atol=1e-12)
    lanes = np.stack([matrix, 2.0 * matrix + np.eye(7)], axis=-1)
    known = np.moveaxis(np.linalg.inv(np.moveaxis(lanes, -1, 0)), 0, -1)
    np.testing.assert_allclose(inverted(lanes), known, rtol=1e-11, atol=1e-12)
    moved, h = jnp.asarray(rng.standard_normal((7, 7, 2))), 1e-6
    _, slope = jax.jvp(inverted, (jnp.asarray(lanes),), (moved,))
    difference = (inverted(lanes + h * moved) - inverted(lanes - h * moved)) / (2 * h)
    np.testing.assert_allclose(slope, difference, rtol=1e-6, atol=1e-8)


def test_its_numbers_meet_the_conditions_of_order_four_and_its_times_are_their_sums():
    """Each row by its sum, as the u are mixed from the slopes k by gamma: u = gamma k."""
    lower = np.linalg.inv(np.eye(8) / _GAMMA - _SLOPES)  # the gamma_ij
    alpha, b = _ROWS[:8] @ lower, _ROWS[8] @ lower
    beta = alpha + lower
    late, sums = alpha.sum(axis=1), beta.sum(axis=1)
    close = {"rtol": 0, "atol": 1e-12}
    np.testing.assert_allclose(STAGE_TIMES, [*late, 1.0], **close)
    np.testing.assert_allclose(_LAGS, lower.sum(axis=1), **close)
    np.testing.assert_array_equal(np.triu(_ROWS[:8]) + np.triu(_SLOPES), 0.0)
    # By trees, up to four nodes; the weights less those of the error's estimate have order four too.
    conditions = [
        (np.ones(8), 1.0),
        (sums, 1.0 / 2.0),
        (late**2, 1.0 / 3.0),
        (beta @ sums, 1.0 / 6.0),
        (late**3, 1.0 / 4.0),
        (late * (alpha @ sums), 1.0 / 8.0),
        (beta @ late**2, 1.0 / 12.0),
        (beta @ beta @ sums, 1.0 / 24.0),
    ]
    for weights in (b, b - np.array(_ERROR) @ lower):
        np.testing.assert_allclose([weights @ x for x, _ in conditions], [y for _, y in conditions], **close)
    np.testing.assert_allclose(b @ late**4, 1.0 / 5.0, **close)
    assert STIFF.order(None) == STIFF.error_order(None) == 5
    # The end is the last stage but for its own u, so that what is stiff ends where it settles.
    np.testing.assert_array_equal(_ROWS[8] - _ROWS[7], np.eye(8)[7])


def crooked(t, x):
    """A field without symmetry that depends on time, as NumPy or JAX has it, and two numbers besides."""
    at = [x[1] * x[2] - 0.3 * t * x[0], t * t - x[0] * x[0] + 0.2 * x[2], -2.0 * x[2] + x[0] * x[1] + 0.7 * t]
    return at, [x[0] + 10.0 * t, x[1] - x[2] + 3.0 * t]


def one_step(t0, t1, x0):
    """A step from t0 to t1 by the formula in `Rosenbrock`, in plain NumPy."""
    field, beside = (lambda t, x: np.array(crooked(t, x)[0])), (lambda t, x: np.array(crooked(t, x)[1]))
    h, n, here = t1 - t0, len(x0), field(t0, x0)
    size = np.sqrt(np.finfo(float).eps) * np.maximum(np.abs([*x0, t0]), 0.1)
    jacobian = np.stack([(field(t0, x0 + size[i] * np.eye(n)[i]) - here) / size[i] for i in range(n)], axis=1)
    drift = (field(t0 + size[n], x0) - here) / size[n]
    u, kept = np.zeros((8, n)), []
    for k in range(8):
        t, x = t0 + STAGE_TIMES[k] * h, x0 + _ROWS[k] @ u
        kept.append(beside(t, x))
        right = field(t, x) + _SLOPES[k] @ u / h + h * _LAGS[k] * drift
        u[k] = np.linalg.solve(np.eye(n) / (h * _GAMMA) - jacobian, right)
    end = x0 + _ROWS[8] @ u
    return end, field(t1, end), u[7], beside(t1, end), np.array([*kept[1:], beside(t1, end)])


def test_a_step_is_that_of_the_formula_alone_and_in_lanes(monkeypatch):
    starts = [(0.4, 0.7, [0.3, -1.2, 0.02]), (2.0, 2.15, [-0.7, 0.4, 1.9]), (0.01, 0.11, [1.1, 0.6, -0.5])]
    known = [one_step(t0, t1, np.array(x0)) for t0, t1, x0 in starts]
    field = lambda t, x: tuple(jnp.stack(part) for part in crooked(t, x))  # noqa: E731
    step = jax.jit(lambda t0, t1, x0, nothing: advance(field, (t0, t1), x0, nothing, kept=slice(2)))
    t0, t1, x0 = (jnp.asarray(x) for x in zip(*starts, strict=True))
    # What the differences lose to rounding depends on the order of operations: 1e-8 of the slopes.
    close = {"rtol": 3e-8, "atol": 3e-9}
    together = step(t0, t1, x0.T, jnp.zeros((2, 3)))
    for found, *exact in zip(together, *known, strict=True):
        np.testing.assert_allclose(found, np.stack(exact, axis=-1), **close)
    for few in (3, 2):  # samples side by side, and in one loop with the stages
        monkeypatch.setattr(_rosenbrock, "_FEW", few)
        alone = jax.jit(lambda *given: advance(field, given[:2], *given[2:], kept=slice(2)))
        for i, lane in enumerate(known):
            for found, exact in zip(alone(t0[i], t1[i], x0[i], jnp.zeros(2)), lane, strict=True):
                np.testing.assert_allclose(found, exact, **close)
    resting = step(t0, t0, x0.T, jnp.zeros((2, 3)))
    np.testing.assert_array_equal(resting[0], x0.T)
    np.testing.assert_array_equal(resting[2], 0.0)


def test_a_singular_matrix_shortens_the_step():
    """y' = y in a step of length 1 / gamma: no such matrix has an inverse."""
    terms = diffrax.ODETerm(lambda t, y, _: y)
    step = jax.jit(lambda h: STIFF.step(terms, 0.0, h, jnp.ones(1), None, None, False)[:2])
    assert not np.any(np.abs(step(1.0 / _GAMMA)[1]) < 1e3)
    assert np.all(np.abs(step(0.1 / _GAMMA)[1]) < 1e-3)


def test_a_long_run_that_is_damped_much(scene):
    """At 1370 and at 0.24 1/s: the former sets the steps of an explicit method, the latter those of this."""
    grasp, state = scene
    slow, ts = (grasp.with_(damping=0.1), state), np.linspace(2.0, 20.0, 10)
    exact = jxr.simulate(*slow, 20.0, ts=ts, rtol=1e-11, max_steps=10**5)
    run = jxr.simulate(*slow, 20.0, ts=ts, rtol=1e-7, solver=STIFF)
    assert np.ptp(exact.states.q, axis=0).min() > 0.01
    assert float(jnp.abs(run.states.q - exact.states.q).max()) < 2e-7
    assert 20 * int(run.stats.steps) < int(exact.stats.steps)
    rows = [jnp.abs(x).max() for x in jax.tree.leaves(run.residuals)]
    assert float(max(rows)) < 1e-12


def test_a_run_is_one_kernel(scene):
    grasp, state = scene
    run = jax.jit(lambda c: jxr.simulate(grasp.with_(damping=c), state, 0.1, ts=2, solver=STIFF).states.q)
    assert run.lower(0.006).as_text().count('xla_cpu_small_call = "true"') == 1


def shaking(pull, t, pose, twist):
    """A torque that changes its sign so often that steps are short."""
    return jnp.zeros(2), pull * jnp.sin(5000.0 * t)


def rolled(numbers, t1, **options):
    """A run down a hill by its speed, its friction and the torque that shakes it."""
    speed, friction, pull = jnp.asarray(numbers)
    load = jax.tree_util.Partial(shaking, pull)
    scene = disc_on_a_hill(speed=speed, friction=friction, load=load)
    return jxr.simulate(*scene, t1, ts=1, rtol=1e-9, throw=False, **options)


# One program for all single runs.
BY_STEPS = {"solver": STIFF, "max_steps": 60}


def test_lanes_are_single_runs_with_codes_of_their_own():
    """Of discs on a hill: two that roll on, one whose hill ends, and one that takes too many steps."""
    rows = np.array([[0.02, 10.0, 0.0], [0.01, 10.0, 0.0], [0.5, 10.0, 0.0], [0.02, 10.0, 1e-3]])
    lanes = jax.jit(jax.vmap(lambda row: rolled(row, 0.12, **BY_STEPS)))(rows)
    codes = [jxr.RESULTS.successful, jxr.RESULTS.successful]
    codes += [jxr.RESULTS.contour_end, jxr.RESULTS.max_steps_reached]
    assert lanes.result._value.tolist() == [int(code._value) for code in codes]
    for i in range(2):
        alone = rolled(rows[i], 0.12, **BY_STEPS)
        np.testing.assert_allclose(lanes.last.q[i], alone.last.q, rtol=0, atol=1e-8)


def test_events_are_found_as_by_the_explicit_default():
    numbers = np.array([0.02, 0.12, 0.0])
    ends = [rolled(numbers, 0.2, **options) for options in ({}, BY_STEPS)]
    assert ends[0].result == ends[1].result == jxr.RESULTS.slipping
    assert abs(float(ends[1].stats.t_end - ends[0].stats.t_end)) < 1e-7


@pytest.mark.slow
@pytest.mark.optimised
def test_gradients_in_both_modes_are_those_of_the_explicit_default(scene):
    grasp, state = scene

    def end(damping, solver, rtol):
        run = jxr.simulate(
            grasp.with_(damping=damping), state, 0.5, ts=1, solver=solver, rtol=rtol, max_steps=400
        )
        return run.states.q[-1] @ jnp.array([1.0, -0.7, 0.4])

    exact = jax.jacfwd(lambda c: end(c, None, 1e-11))(0.006)
    forward = jax.jacfwd(lambda c: end(c, STIFF, 1e-8))(0.006)
    reverse = jax.grad(lambda c: end(c, STIFF, 1e-8))(0.006)
    back = jax.jit(jax.grad(lambda c: end(c, STIFF, 1e-8))).lower(0.006).as_text()
    assert back.count('xla_cpu_small_call = "true"') == 2
    np.testing.assert_allclose(forward, exact, rtol=1e-5)
    np.testing.assert_allclose(reverse, forward, rtol=1e-8)
