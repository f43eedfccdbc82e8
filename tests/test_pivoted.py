"""The chapter's Part 2: what it reports, and how exactly we compute it."""

import re

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxroll as jxr
from tests.measures import gradients_with_and_without_an_end, observed_order
from tests.oracles.chapter_part2 import Part2

ELBOW = 1  # branch of the law of cosines that the scene starts on


@pytest.fixture(scope="module")
def reference():
    """Minimal-coordinate motion by SciPy: times, s and (theta, q1, q2)."""
    chapter = Part2()
    field = chapter.acceleration(ELBOW)
    ts = np.linspace(0.0, 3.0, 31)
    answer = solve_ivp(
        lambda t, y: [y[1], float(field(y[0], y[1]))],
        (0.0, 3.0),
        [0.003, 0.0],
        method="DOP853",
        rtol=1e-13,
        atol=1e-15,
        t_eval=ts,
    )
    poses = jax.jit(jax.vmap(lambda s: chapter.pose(s, ELBOW)))(answer.y[0])
    return ts, answer.y[0], np.asarray(poses)


def test_trajectory_against_minimal_coordinates(scene, reference):
    """(73)-(75) under (64)-(65), in one coordinate that satisfies them by itself."""
    ts, s, poses = reference
    run = jxr.simulate(*scene, t1=3.0, ts=ts, rtol=1e-11)
    np.testing.assert_allclose(run.states.q, poses, atol=1e-11)
    np.testing.assert_allclose(0.003 - run.states.s[:, 0], s, atol=1e-13)


def test_default_settings_meet_the_stated_accuracy(run, reference):
    np.testing.assert_allclose(run.states.q[::10], reference[2], atol=1e-9)


def test_rolls_far_enough(run):
    turned = np.ptp(np.asarray(run.states.q[:, 0]))
    rolled = np.ptp(np.asarray(run.states.q @ np.array([-1.0, 1.0, 1.0])))
    assert turned >= 0.3 and rolled >= 0.3


def test_constraints_stay_at_rounding_level(run):
    left = run.residuals
    assert np.abs(left.normal).max() <= 1e-12
    assert np.abs(left.tangential).max() <= 1e-12
    assert np.abs(left.tangency).max() <= 1e-12


def test_velocities_stay_on_the_constraints(scene, run):
    grasp, _ = scene
    for i in (30, 100, 300):
        state = jax.tree.map(lambda x, i=i: x[i], run.states)
        terms = jxr.equation_terms(grasp, state)
        assert abs(float(terms.normal[0] @ state.v)) <= 1e-12
        assert abs(float(terms.tangential[0] @ state.v)) <= 1e-12


def test_energy_identity(scene):
    """K + potential + dissipated work, constant to 1e-9 of its size at rtol 1e-9."""
    run = jxr.simulate(*scene, t1=3.0, rtol=1e-9, record=("multipliers", "energy"))
    size = float(run.energy.kinetic[0] + run.energy.potential[0])
    assert np.abs(run.energy.residual).max() <= 1e-9 * size
    assert float(run.energy.work[-1]) < -0.01 * size  # it does dissipate


@pytest.fixture(scope="module")
def upright(scene):
    """The same scene in a vertical plane."""
    grasp, state = scene
    return grasp.with_(gravity=(0.0, -9.81)), state


def test_the_balance_counts_from_the_start_whatever_is_saved(upright):
    """Of a run that saved its end alone it was zero."""
    ts = np.linspace(0.1, 0.5, 11)
    later = jxr.simulate(*upright, 0.5, ts=ts, record=("energy",)).energy
    start, size = sum(map(float, jxr.energies(*upright))), float(later.potential[0])
    wanted = later.kinetic + later.potential - later.work - start
    np.testing.assert_allclose(later.residual, wanted, rtol=0, atol=1e-15 * size)
    assert abs(float(later.residual[0])) > 1e-13 * size


def test_recorded_energy_is_the_chapters(scene, run):
    """(71) and U below (83), from the chapter's formulas at every tenth state."""
    chapter = Part2()
    states = jax.tree.map(lambda x: x[::10], run.states)
    kinetic = jax.jit(jax.vmap(chapter.kinetic))(states.q, states.v)
    np.testing.assert_allclose(run.energy.kinetic[::10], kinetic, rtol=1e-12, atol=1e-20)
    potential = jax.jit(jax.vmap(chapter.potential))(0.003 - states.s[:, 0])
    np.testing.assert_allclose(run.energy.potential[::10], potential, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.optimised
def test_undamped_for_100_s(scene):
    grasp, state = scene
    run = jxr.simulate(
        grasp.with_(damping=0.0), state, 100.0, rtol=1e-9, record=("energy",), max_steps=200_000
    )
    left = run.residuals
    assert max(np.abs(x).max() for x in (left.normal, left.tangential, left.tangency)) <= 1e-12
    size = float(run.energy.kinetic[0] + run.energy.potential[0])
    assert np.abs(run.energy.residual).max() <= 1e-6 * size
    assert np.abs(run.states.v).max() > 1.0  # it keeps moving


def test_what_the_chapter_reports(scene, run):
    """Figs. 9-11 and 18: Delta f, Delta lambda and N_1 tend to zero, U falls to its minimum."""
    grasp, _ = scene
    balance = jxr.press_balance(grasp, run.ts, run.states)
    for series in (balance.delta_f, balance.delta_lam, balance.moment):
        series = np.abs(np.asarray(series[:, 0]))
        assert series[0] > 1e-4
        assert series[-1] <= 2e-4 * series.max()
    potential = np.asarray(balance.potential[:, 0])
    above = potential[50:] - potential.min()
    falling = above[:-1] > 1e-13 * potential.min()
    assert falling.sum() > 50 and np.all(np.diff(potential[50:])[falling] < 0)
    chapter = Part2()
    last, first = map(jax.jit(jax.grad(chapter.potential)), (float(balance.s[-1, 0]), 0.003))
    assert abs(last) < 1e-4 * abs(first)  # U is stationary at the end


def test_responses_are_figs_9_to_18(scene, run):
    """Figs. 9-18: every one is drawn, with the numbers of the run in the units of its axis."""
    grasp, _ = scene
    balance, left, v = jxr.press_balance(grasp, run.ts, run.states), run.residuals, run.states.v
    wanted = {
        r"$\Delta f$ [N]": balance.delta_f[:, 0],
        r"$\Delta\lambda$ [N]": balance.delta_lam[:, 0],
        r"$(f_d/r)\,N_1$ [mN m]": 1e3 * balance.moment[:, 0],
        "$s$ [mm]": 1e3 * balance.s[:, 0],
        r"$\dot{q}_{1}$ [rad/s]": v[:, 1],
        r"$\dot{q}_{2}$ [rad/s]": v[:, 2],
        r"$\dot{\theta}$ [rad/s]": v[:, 0],
        "$R$": left.tangential[:, 0],
        "$Q$": left.normal[:, 0],
        "$U$ [mJ]": 1e3 * balance.potential[:, 0],
    }
    axes = jxr.plotting.responses(grasp, run).axes
    for ax, (label, values) in zip(axes, wanted.items(), strict=False):
        told = ax.get_ylabel()
        assert told.startswith(label)
        # Residuals are drawn in a power of ten that fits them.
        power = re.search(r"10\^\{(-?\d+)\}", told)
        unit = 10.0 ** int(power[1]) if power else 1.0
        np.testing.assert_allclose(unit * ax.lines[0].get_ydata(), values, rtol=1e-12, atol=1e-30)


def test_balance_is_the_chapters_own_quantities(scene, run):
    """(76)-(79) with (60)-(63) from the printed contours."""
    grasp, _ = scene
    balance = jxr.press_balance(grasp, run.ts, run.states)
    forces, lengths, at = run.multipliers, jax.jit(jax.vmap(Part2().lengths)), np.array([0, 10, 40])
    s, n1, delta_f, delta_lam, f, lam = (
        np.asarray(series)[at, 0]
        for series in (balance.s, balance.n1, balance.delta_f, balance.delta_lam, forces.f, forces.lam)
    )
    l_b0, l_b1, l_n0, l_n1 = map(np.asarray, lengths(s))
    np.testing.assert_allclose(n1, -l_b0 * l_n1 + l_n0 * l_b1, rtol=1e-10)
    np.testing.assert_allclose(delta_f, f - 50.0 * (l_n0 + l_n1), rtol=0, atol=1e-12)
    np.testing.assert_allclose(delta_lam, lam - 50.0 * (l_b0 + l_b1), rtol=0, atol=1e-12)


def test_n1_falls_at_the_slowest_rate(scene):
    """-4.16 1/s, as the site says, of the loop linearised at rest and of the run itself."""
    grasp, state = scene
    rates = np.asarray(jxr.stability.assess(grasp, state).rates)
    np.testing.assert_allclose(rates, [-77.8, -4.16], rtol=2e-3)
    run = jxr.simulate(grasp, state, 3.0, rtol=1e-10, record=("multipliers", "energy"))
    n1 = np.asarray(jxr.press_balance(grasp, run.ts, run.states).n1)[[250, 300], 0]
    np.testing.assert_allclose(run.ts[jnp.array([250, 300])], [2.5, 3.0], rtol=1e-14)
    assert float(np.log(n1[1] / n1[0]) / 0.5) == pytest.approx(rates[1].real, rel=1e-3)


def test_n1_is_the_moment_of_the_pull_about_the_contact(scene):
    """Zero for a target on the line from the tip frame through the contact, not on that of the origins."""
    grasp, state = scene
    at = jxr.contact_geometry(grasp, state)
    centre, arm = np.asarray(at.centre_0[0]), np.asarray(at.gamma_0[0])
    across = np.array([-arm[1], arm[0]]) / np.hypot(*arm)
    for beyond, aside in ((2.3, 0.0), (0.4, 0.0), (2.3, 0.005), (1.0, -0.002)):
        target = jnp.asarray(centre + beyond * arm + aside * across)
        aimed = eqx.tree_at(lambda g: g.controller.target, grasp, target)
        found = float(jxr.press_balance(aimed, 0.0, state).n1[0])
        assert abs(found) == pytest.approx(np.hypot(*arm) * abs(aside), rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("aside", [0.0, 0.004])
def test_closed_loop_equations_76_and_77_hold_along_the_run(scene, run, aside):
    """Residuals of the printed form with accelerations by differences of the velocities.

    With a target beside the pivot (77) holds as it stands; in (76) the pull has another arm.
    """
    grasp, _ = scene
    grasp = eqx.tree_at(lambda g: g.controller.target, grasp, replace_fn=lambda at: at + aside)
    i = 20
    state = jax.tree.map(lambda x: x[i], run.states)
    h = 1e-4
    fine = jxr.simulate(grasp, state, h, rtol=1e-12, record=("multipliers", "energy"))
    v_rate = (fine.states.v[300] - fine.states.v[0]) / h
    middle = jax.tree.map(lambda x: x[150], fine.states)
    terms = jxr.equation_terms(grasp, middle)
    balance = jxr.press_balance(grasp, 0.0, middle)
    e = np.array([-1.0, 1.0, 1.0])
    damping = 0.006 * np.array([0.0, 1.0, 1.0]) * np.asarray(middle.v)
    left = np.asarray(terms.mass @ v_rate + terms.bias) + damping
    left += np.asarray(balance.delta_f[0] * terms.normal[0] + balance.delta_lam[0] * terms.tangential[0])
    left -= np.asarray(balance.moment[0]) * e
    left = left[1:] if aside else left
    assert np.abs(left).max() <= 1e-5 * float(np.abs(terms.mass @ v_rate).max())


def fixed_steps(scene, solver, steps, t1):
    """Positions and velocities at four times of the undamped scene, in equal steps, each projected."""
    grasp, state = scene
    run = jxr.simulate(
        grasp.with_(damping=0.0),
        state,
        t1,
        ts=np.linspace(0.0, t1, 5)[1:],
        solver=solver,
        stepsize_controller=diffrax.ConstantStepSize(),
        dt0=t1 / steps,
    )
    assert int(run.stats.accepted) == steps + 1  # the first has no length
    return np.concatenate([run.states.q, run.states.v / 10.0], axis=1)


@pytest.mark.parametrize(
    ("solver", "order", "band", "t1", "ladder"),
    [
        (diffrax.Tsit5(), 5, 0.3, 0.2, (64, 96, 128, 160)),
        (diffrax.Dopri8(), 8, 0.5, 0.3, (24, 28, 32, 40)),
    ],
    ids=["Tsit5", "Dopri8"],
)
def test_observed_order_with_projection(scene, solver, order, band, t1, ladder):
    """Without damping: with it both look better than their order, up to rounding."""
    exact = fixed_steps(scene, diffrax.Dopri8(), 800, t1)
    error = lambda n: np.sqrt(np.mean((fixed_steps(scene, solver, n, t1) - exact) ** 2))  # noqa: E731
    observed = -observed_order(np.array(ladder), [error(n) for n in ladder])
    assert abs(observed - order) <= band


def by_csm(grasp, state, t1, gains=None, **options):
    """A run by the chapter's own method, one program for all of them."""
    gains = gains or jxr.CSM()
    return jxr.simulate(grasp, state, t1, ts=31, formulation=gains, max_steps=50_000, **options)


@pytest.fixture(scope="module")
def stabilised(scene):
    """The chapter's own method at tight tolerance."""
    return by_csm(*scene, 3.0, rtol=1e-9)


def test_csm_agrees_with_index1(stabilised, reference):
    """From a consistent start CSM differs from the exact motion by integration error alone."""
    np.testing.assert_allclose(stabilised.states.q, reference[2], atol=2e-8)
    left = stabilised.residuals
    assert np.abs(left.normal).max() <= 1e-10 and np.abs(left.tangential).max() <= 1e-10


def test_csm_takes_ten_times_the_steps(scene, stabilised):
    projected = jxr.simulate(*scene, t1=3.0, ts=31, rtol=1e-9)
    assert int(stabilised.stats.accepted) >= 10 * int(projected.stats.accepted)


def test_csm_pulls_a_violated_constraint_back(scene):
    grasp, state = scene
    off = jxr.State(state.q + jnp.array([1e-5, 0.0, 0.0]), state.v, state.s)
    run = by_csm(grasp, off, 0.05, throw=False)
    before, after = np.hypot(run.residuals.normal, run.residuals.tangential)[[0, -1], 0]
    assert before > 1e-8 and after < 1e-3 * before
    tangency = np.asarray(run.residuals.tangency[:, 0])
    assert np.abs(tangency / tangency[0] - 1.0).max() < 1e-3  # integrated by (68), never stabilised


@pytest.mark.parametrize("which", [0, 1])
def test_csm_closes_either_gap_at_its_own_rate(scene, which):
    """A small gap dies out as its gains say, critically damped: g(t) = g(0) (1 + w t) exp(-w t)."""
    grasp, state = scene
    rates = np.array([900.0, 1400.0])  # of the normal and of the tangential gap [1/s]
    gains = jxr.CSM(*map(float, (2 * rates[0], rates[0] ** 2, 2 * rates[1], rates[1] ** 2)))
    # The finger moves off by 1 nm along the normal or the tangent; its velocity is zero.
    face = grasp.object.contours[0]
    angle = float(state.q[0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    along = turn @ np.asarray((face.normal, face.tangent)[which](0.003))
    base = grasp.fingers[0].base + 1e-9 * along
    moved = eqx.tree_at(lambda g: g.fingers[0].base, grasp, base)
    run = by_csm(moved, state, 2e-3, gains, throw=False, rtol=1e-10)
    left = np.stack([run.residuals.normal[:, 0], run.residuals.tangential[:, 0]])
    decay = np.exp(-np.outer(rates, run.ts)) * (1.0 + np.outer(rates, run.ts))
    np.testing.assert_allclose(np.abs(left[which]), 1e-9 * decay[which], rtol=1e-3, atol=1e-14)
    assert np.abs(left[1 - which]).max() <= 2e-11


def test_gravity_holds_energy(upright):
    """The optional field: energy identity again."""
    run = jxr.simulate(*upright, 0.5, ts=11, rtol=1e-10, record=("energy",))
    size = np.abs(np.asarray(run.energy.potential)).max()
    assert np.abs(run.energy.residual).max() <= 1e-9 * size
    assert np.ptp(np.asarray(run.energy.potential)) > 1e-3 * size


def test_gradients_of_a_run_that_ended_early_are_those_of_what_it_reached(scene):
    """The rows that were not reached are NaN, and leave the derivatives of the others alone."""
    wanted, found = gradients_with_and_without_an_end(jxr.press_balance, *scene)
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
