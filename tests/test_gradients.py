"""Taylor tests of both modes, through close and simulate, for every kind of parameter."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial

import jaxroll as jxr
from tests.measures import both_slopes, taylor_remainders
from tests.subjects.disc_on_a_hill import disc_on_a_hill

# Steps are fixed by the recorded times, so that a perturbed run takes the steps of the base run.
TS = jnp.linspace(0.0, 0.05, 26)


def final(grasp, state):
    """A scalar of the whole motion: positions, velocities and rolling at two times."""
    run = jxr.simulate(grasp, state, TS[-1], ts=TS, rtol=1e-7, dt0=2e-3)
    weights = jnp.array([1.0, -0.7, 0.4])
    ends = run.states.q[-1] + 0.1 * run.states.v[-1] + 0.5 * run.states.q[12]
    return ends @ weights + 100.0 * run.states.s[-1, 0]


def with_leaf(where):
    """Scale one array of the closed scene by 1 + x; it is to be closed again, as all of these are."""

    def changed(scene, x):
        grasp, state = scene
        return eqx.tree_at(where, grasp, replace_fn=lambda a: a * (1.0 + x)), state

    return changed


def moved_start(scene, x):
    """Start 1 mm x further along both contours."""
    grasp, state = scene
    contact = grasp.contacts[0]
    grasp = eqx.tree_at(
        lambda g: (g.contacts[0].s_tip, g.contacts[0].s_object),
        grasp,
        (contact.s_tip - 1e-3 * x, contact.s_object + 1e-3 * x),
    )
    return grasp, state


def pushed(scene, x):
    """Start with a velocity, which close makes compatible."""
    grasp, state = scene
    return grasp, jxr.State(state.q, state.v + x, state.s)


CASES = {
    "damping": with_leaf(lambda g: g.controller.damping),
    "force": with_leaf(lambda g: g.controller.force),
    "masses": with_leaf(lambda g: g.fingers[0].masses),
    "link inertias": with_leaf(lambda g: g.fingers[0].inertias),
    "object inertia": with_leaf(lambda g: g.object.inertia),
    "tip contour": with_leaf(lambda g: g.fingers[0].tip.contour.contour.a),
    "object contour": with_leaf(lambda g: g.object.contours[0].contour.a),
    "pad angle": with_leaf(lambda g: g.fingers[0].tip.angle),
    "initial contact": moved_start,
    "initial velocity": pushed,
}


def evaluator():
    """The same compiled programs for every case: the pair is the argument, and all of it may move."""

    def linearised(function, pair):
        dynamic, static = eqx.partition(pair, eqx.is_inexact_array)
        arrays = lambda p: eqx.filter(function(*eqx.combine(p, static)), eqx.is_inexact_array)  # noqa: E731
        return dynamic, *jax.linearize(arrays, dynamic)

    @eqx.filter_jit
    def closed(pair, pair_dot):
        return linearised(jxr.close, pair)[2](pair_dot)

    @eqx.filter_jit
    def both(pair, pair_dot):
        """The value, its derivative along one direction, and that in every number: of one linearisation."""
        dynamic, value, push = linearised(final, pair)
        return value, push(pair_dot), jax.linear_transpose(push, dynamic)(1.0)[0]

    return closed, both


CLOSED, BOTH = evaluator()


def typed(tree):
    """With no array whose type is weak, as that of a Python number: JAX compiles once more for such ones."""
    return jax.tree.map(lambda x: jnp.asarray(x, x.dtype) if eqx.is_inexact_array(x) else x, tree)


@pytest.mark.parametrize("case", CASES)
def test_taylor_remainder_in_both_modes(scene, case):
    """Falls 100 times for each 10 times smaller step, with the slope of either mode."""

    def given(x):
        return typed(CASES[case](scene, x))

    dynamic = lambda x: eqx.filter(CASES[case](scene, x), eqx.is_inexact_array)  # noqa: E731
    pair_dot = CLOSED(given(0.0), typed(jax.jvp(dynamic, (0.0,), (1.0,))[1]))
    _, forward, bars = BOTH(jxr.close(*given(0.0)), pair_dot)
    forward = float(forward)
    products = jax.tree.map(lambda a, b: jnp.sum(a * b), bars, pair_dot)
    reverse = float(sum(jax.tree.leaves(products)))
    assert reverse == pytest.approx(forward, rel=1e-9, abs=1e-12)

    steps = np.array([1e-1, 1e-2, 1e-3]) * (0.1 if case == "pad angle" else 1.0)
    values = lambda x: BOTH(jxr.close(*given(x)), pair_dot)[0]  # noqa: E731
    left = taylor_remainders(values, 0.0, 1.0, forward, steps)
    if left[0] < 1e-9:
        pytest.skip("linear to rounding: a remainder says nothing")
    ratios = left[:-1] / left[1:]
    assert np.all((ratios > 70.0) & (ratios < 140.0)), (forward, left)


@pytest.mark.slow
def test_leaving_out_the_closing_is_wrong(scene):
    """Gradients flow through the consistent initial state: without it they are another number."""
    grasp, state = scene
    where = lambda g: g.fingers[0].tip.contour.contour.a  # noqa: E731

    def through(x, closed):
        moved = eqx.tree_at(where, grasp, replace_fn=lambda a: a * (1.0 + x))
        return final(*jxr.close(moved, state)) if closed else final(moved, state)

    full = jax.jit(jax.grad(through), static_argnums=1)
    assert abs(full(0.0, True) - full(0.0, False)) > 0.1 * abs(full(0.0, True))


@pytest.mark.slow
@pytest.mark.optimised
def test_jit_and_transforms_in_any_order(scene):
    grasp, state = scene

    def f(c):
        return final(grasp.with_(damping=c), state)

    c = jnp.asarray(0.006)
    slope = jax.jit(jax.grad(f))(c)
    for other in (jax.grad(jax.jit(f)), jax.jit(jax.jacfwd(f)), jax.jacfwd(jax.jit(f))):
        np.testing.assert_allclose(other(c), slope, rtol=1e-9)
    batch = jnp.array([0.005, 0.006])
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.grad(f)))(batch)[1], slope, rtol=1e-9)


@pytest.mark.slow
def test_runs_and_derivatives_work_where_jax_stops_at_every_nan(scene):
    """With `jax_debug_nans` no program may return a NaN, if only in a place that nobody reads."""
    grasp, start = scene

    def end(damping):
        run = jxr.simulate(grasp.with_(damping=damping), start, t1=0.02, record=("multipliers", "energy"))
        return run.last.q[0] + run.energy.residual[-1]

    with jax.debug_nans(True):
        assert np.isposinf(jxr.simulate(grasp, start, t1=0.02).stats.margin)
        assert np.isfinite(jax.jit(jax.vmap(jax.value_and_grad(end)))(jnp.array([0.006, 0.007]))).all()


def test_second_derivatives_are_refused_not_wrong(scene):
    grasp, state = scene
    end = lambda c: final(grasp.with_(damping=c), state)  # noqa: E731
    for twice in (jax.hessian, lambda f: jax.grad(jax.grad(f)), lambda f: jax.jacfwd(jax.jacfwd(f))):
        with pytest.raises(RuntimeError, match="first derivatives only: for second ones take differences"):
            jax.eval_shape(twice(end), 0.006)


def test_second_derivatives_in_times_are_refused_not_zero():
    def end(mass, t1):
        return jxr.simulate(*disc_on_a_hill(mass=mass), t1, ts=1, throw=False).states.q[-1, 0]

    along = lambda t: jxr.simulate(*disc_on_a_hill(), 0.02, ts=1, record=("dense",))(t).q[0]  # noqa: E731
    for twice in (jax.grad(jax.grad(end, 0), 1), jax.grad(jax.grad(end, 1), 0), jax.hessian(end, 1)):
        with pytest.raises(RuntimeError, match="first derivatives only: for second ones take differences"):
            jax.eval_shape(twice, 0.05, 0.02)
    with pytest.raises(RuntimeError, match="first derivatives only: for second ones take differences"):
        jax.eval_shape(lambda t: jax.jvp(lambda t: jax.jvp(along, (t,), (1.0,))[1], (t,), (1.0,)), 0.01)


def test_derivatives_in_the_start_are_refused_not_zero(scene):
    with pytest.raises(RuntimeError, match="start's time, tolerances and gains"):
        jax.grad(lambda t0: jxr.simulate(*scene, 0.05, t0=t0, ts=1).states.q[-1, 0])(0.01)


def braking(t, pose, twist):
    """A torque that grows with the spin: there is work to record besides that of gravity."""
    return jnp.zeros(2), -3e-5 * twist.spin


def test_derivatives_in_save_times_and_end():
    """Against differences: of states, forces, energies, the end; rows that were not reached do not move."""

    def seen(times, down):
        scene = disc_on_a_hill(gravity=jnp.stack([jnp.asarray(2.0), down]), load=braking)
        options = {"rtol": 1e-11, "record": ("multipliers", "energy"), "throw": False}
        run = jxr.simulate(*scene, times[0], ts=times[1:], **options)
        forces, work = run.multipliers.f[:, 0], 10.0 * run.energy.work
        parts = [run.states.q[:, 0], run.states.v[:, 1], run.states.s[:, 0], forces, work, run.ts]
        return jnp.concatenate([*parts, run.last.q, run.stats.t_end[None]])

    @jax.jit
    def all_of(times, down):
        """The values, and their derivatives forwards and backwards: of one linearisation."""
        values, push = jax.linearize(lambda times: seen(times, down), times)
        pull = jax.linear_transpose(push, times)
        forwards = jax.vmap(push, out_axes=1)(jnp.eye(3))
        return values, forwards, jax.vmap(lambda bar: pull(bar)[0])(jnp.eye(values.size))

    times, size, down = np.array([0.15, 0.05, 0.1]), 1e-4, jnp.asarray(-9.6)
    ends = [[all_of(times + k * size * e, down)[0] for e in np.eye(3)] for k in (-2, -1, 1, 2)]
    slopes = (8 * (np.array(ends[2]) - ends[1]) - (np.array(ends[3]) - ends[0])) / (12 * size)
    assert (abs(slopes).max(axis=0) > 0.01).all()
    for found in all_of(times, down)[1:]:
        np.testing.assert_allclose(found, slopes.T, rtol=0, atol=2e-7)
    # Gravity that lifts the disc at once.
    values, _, reverse = all_of(times, jnp.asarray(9.6))
    assert np.isnan(values[:2]).all() and np.isfinite(reverse).all()


def test_close_is_differentiated_by_the_implicit_function_theorem():
    """Against central differences, in both modes, held and rolling; also an under-determined pose."""
    grasp, state = disc_on_a_hill(speed=0.0)
    grasp = grasp.with_contacts(jxr.Contact(0.006, -0.005 * np.pi))  # beside the hill's vertex
    guess = jxr.State(state.q + jnp.array([0.002, -0.001, 0.03]), state.v, state.s)

    def pose(x, hold):
        moved = eqx.tree_at(lambda g: g.fingers[0].tip.a, grasp, replace_fn=lambda a: a * (1 + x))
        closed = jxr.close(moved, guess, hold_contacts=hold)[1]
        return jnp.concatenate([closed.q, closed.s]) @ jnp.array([1.0, -0.7, 0.4, 30.0])

    for hold in (True, False):
        both, h = both_slopes(lambda x: pose(x, hold)), 1e-5  # noqa: B023
        slope = (both(h)[0] - both(-h)[0]) / (2 * h)
        _, forward, reverse = both(0.0)
        assert abs(slope) > 1e-3
        np.testing.assert_allclose(forward, slope, atol=1e-8)
        np.testing.assert_allclose(reverse, forward, atol=1e-12)


def diverging(numbers, t, pose, twist):
    """A torque that has no value from a moment on."""
    size, moment = numbers
    return jnp.zeros(2), 1e-4 * size * jnp.log(moment - t)


def test_a_run_that_ends_where_nothing_is_finite_has_the_derivative_of_what_it_reached():
    """Its last step leaves the state as it was; a loss that leaves such a lane out has a gradient."""
    h = 1e-4

    def told(size, moment):
        scene = disc_on_a_hill(load=Partial(diverging, (size, moment)))
        run = jxr.simulate(*scene, 0.1, ts=4, rtol=1e-10, throw=False)
        return run.last.q[0] + run.states.v[1, 1], run.result._value

    @jax.jit
    def both(size, moment, weight):
        """The value, its code, its derivative forwards, and backwards that of a weighted value."""
        end, push, code = jax.linearize(lambda x: told(x, moment), size, has_aux=True)
        return end, code, push(1.0), jax.linear_transpose(push, size)(weight)[0]

    given = lambda *numbers: both(*map(jnp.asarray, numbers))  # noqa: E731
    for moment, wanted in ((0.05, jxr.RESULTS.not_finite), (0.3, jxr.RESULTS.successful)):
        _, code, forwards, backwards = given(0.5, moment, 1.0)
        assert int(code) == int(wanted._value)
        near = [given(0.5 + k * h, moment, 1.0)[0] for k in (-2, -1, 1, 2)]
        np.testing.assert_allclose(forwards, np.array([1.0, -8.0, 8.0, -1.0]) @ near / (12 * h), rtol=1e-6)
        np.testing.assert_allclose(backwards, forwards, rtol=1e-9)
        # By a weight of zero a loss leaves out a lane.
        assert given(0.5, moment, 0.0)[3] == 0.0


def rocked(tables, t, pose, twist):
    """A torque with numbers of a caller's tables."""
    real, whole = tables
    return jnp.zeros(2), 5e-5 * (real[1] + whole[1]) * jnp.cos(40.0 * t)


def test_runs_with_gains_or_whole_numbers_beside_the_grasp_have_both_derivatives():
    """The gains of `CSM` and numbers of a caller's table are arrays without a derivative, in every loop."""

    tables = np.arange(1.0, 4.0), np.arange(1, 4)

    def rolled(mass, method, rtol):
        scene = disc_on_a_hill(mass=mass, load=Partial(rocked, tables))
        options = {"solver": method, "formulation": jxr.CSM(), "rtol": rtol}
        return jxr.simulate(*scene, 0.03, ts=1, **options).last.q[0]

    def end(mass):
        """What is to be differentiated, and the same beside its derivative."""
        found = rolled(mass, None, 1e-12)
        return found, found

    both = jax.jit(jax.jacfwd(end, has_aux=True))
    near = [float(both(0.05 + k * 1e-4)[1]) for k in (-2, -1, 1, 2)]
    exact = (near[0] - 8 * near[1] + 8 * near[2] - near[3]) / 12e-4
    backwards = jax.jit(jax.grad(lambda m: rolled(m, jxr.Rosenbrock(), 1e-8)))
    for slope in (both(0.05)[0], backwards(0.05)):
        assert float(slope) == pytest.approx(exact, rel=1e-6)
