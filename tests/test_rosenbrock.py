"""Rosenbrock's method: its order, stiff problems with a closed form, and runs of the pinch in every mode."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._integration._rosenbrock import _GAMMA, inverted
from tests.measures import observed_order

STIFF = jxr.Rosenbrock()


def solved(field, y0, t1, steps):
    """End of a diffrax run in equal steps."""
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
        end = solved(turning, {"x": jnp.array([1.0, 0.0]), "z": jnp.exp(1.0)}, 2.0, int(steps))
        exact = np.array([np.cos(4.0), np.sin(4.0), np.exp(np.cos(2.0))])
        found = np.append(end["x"], end["z"])
        errors.append(np.abs(found - exact).max())
    assert errors[0] < 1e-4
    assert abs(-observed_order(sizes, errors) - 5.0) < 0.3


@pytest.mark.parametrize("rate", [1e3, 1e6, 1e9])
def test_fast_rates_do_not_set_the_step(rate):
    """Prothero and Robinson: y' = -rate (y - cos t) - sin t, whose solution from 1 is cos t."""
    end = solved(lambda t, y: -rate * (y - jnp.cos(t)) - jnp.sin(t), jnp.ones(1), 2.0, 40)
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


def test_a_singular_matrix_shortens_the_step():
    """y' = y in a step of length 1 / gamma: no such matrix has an inverse."""
    terms = diffrax.ODETerm(lambda t, y, _: y)
    step = lambda h: STIFF.step(terms, 0.0, h, jnp.ones(1), None, None, False)  # noqa: E731
    assert not np.any(np.abs(step(1.0 / _GAMMA)[1]) < 1e3)
    assert np.all(np.abs(step(0.1 / _GAMMA)[1]) < 1e-3)


@pytest.fixture(scope="module")
def pinch():
    return jxr.scenes.pinch()


def test_a_long_run_of_the_pinch(pinch):
    ts = np.linspace(2.0, 20.0, 10)
    exact = jxr.simulate(*pinch, 20.0, ts=ts, rtol=1e-11, max_steps=10**5)
    run = jxr.simulate(*pinch, 20.0, ts=ts, rtol=1e-7, solver=STIFF)
    assert float(jnp.abs(run.states.q - exact.states.q).max()) < 2e-7
    assert 20 * int(run.stats.steps) < int(exact.stats.steps)
    rows = [jnp.abs(x).max() for x in jax.tree.leaves(run.residuals)]
    assert float(max(rows)) < 1e-12


def test_a_run_is_one_kernel(scene):
    grasp, state = scene
    run = jax.jit(lambda c: jxr.simulate(grasp.with_(damping=c), state, 0.1, ts=2, solver=STIFF).states.q)
    assert run.lower(0.006).as_text().count('xla_cpu_small_call = "true"') == 1


def test_lanes_are_single_runs_with_codes_of_their_own(scene):
    grasp, state = scene

    def run(damping):
        moved = grasp.with_(damping=damping)
        return jxr.simulate(moved, state, 1.0, ts=1, solver=STIFF, throw=False, max_steps=150)

    rates = jnp.array([0.006, 0.004, 1e-5])
    lanes = jax.jit(jax.vmap(run))(rates)
    codes = [jxr.RESULTS.successful, jxr.RESULTS.successful, jxr.RESULTS.max_steps_reached]
    assert lanes.result._value.tolist() == [int(code._value) for code in codes]
    for i in range(2):
        alone = run(rates[i])
        np.testing.assert_allclose(lanes.last.q[i], alone.last.q, rtol=0, atol=1e-8)


def test_events_are_found_as_by_the_explicit_default(scene):
    grasp, state = scene
    contact = grasp.contacts[0]
    rubbing = grasp.with_contacts(jxr.Contact(contact.s_tip, contact.s_object, friction=0.12))
    ends = [
        jxr.simulate(rubbing, state, 0.6, ts=1, rtol=1e-9, throw=False, solver=solver)
        for solver in (None, STIFF)
    ]
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
