"""The chapter's Part 1: the pinch between two fingers against the printed equations."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._mechanics import to_leaves
from jaxroll._motion import bodies, Index1
from jaxroll._motion._equations import evaluate, sensed
from jaxroll._motion._quantities import power
from jaxroll.control import Sensed
from jaxroll.scenes._facing_place import facing_place
from tests.oracles.chapter_part1 import Part1, STEP

SENSE = np.array([1.0, -1.0])
START = np.array([0.004, -0.003])  # the chapter's s_i at the start


@pytest.fixture(scope="module")
def pinch():
    """The scene: grasp and closed state."""
    return jxr.scenes.pinch(s=START)


@pytest.fixture(scope="module")
def chapter(pinch):
    """The oracle, with p_i(0) of the scene's starting pose."""
    chapter = Part1(np.zeros(2))
    chapter.start = chapter.orientations(np.asarray(pinch[1].q))
    return chapter


def simulated(pinch, t1, rtol=1e-8):
    """A run with everything recorded; one compiled program serves all."""
    return jxr.simulate(*pinch, t1, rtol=rtol, record=("multipliers", "energy"))


@pytest.fixture(scope="module")
def settled(pinch):
    """10 s at default settings."""
    return simulated(pinch, 10.0)


def random_state(chapter, seed):
    """X, v, and the chapter's s: tangents coincide, gaps are open."""
    rng = np.random.default_rng(seed)
    s = rng.uniform(-0.01, 0.01, 2)
    X = np.concatenate([rng.uniform(-0.1, 0.1, 2), rng.uniform(-2.0, 2.0, 6)])
    return chapter.tangent(X, s), rng.uniform(-3.0, 3.0, 8), s


def as_state(X, v, s):
    """The package's state; its sigma is zero at START."""
    return jxr.State(jnp.asarray(X), jnp.asarray(v), jnp.asarray(SENSE * (START - s)))


def torques(grasp, state):
    """Joint torques of the grasp's controller, shape (5,)."""
    ready = grasp.prepared()
    leaves = to_leaves(state, ready.form)
    blocks = ready.controller.torques(0.0, sensed(ready, leaves, bodies(ready, leaves)[0]))
    return jnp.stack([u for block in blocks for u in block])


@pytest.mark.parametrize("seed", range(8))
def test_coefficients_of_1_to_3(pinch, chapter, seed):
    """Those of f_i and lambda_i in (1)-(3), with the unit vectors of (4)."""
    X, v, s = random_state(chapter, seed)
    assert np.abs(chapter.mismatch(X, s)).max() < 1e-15
    terms = jxr.equation_terms(pinch[0], as_state(X, v, s))
    rows = chapter.rows(X, s, chapter.places(X))
    np.testing.assert_allclose(terms.normal, rows[:2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(terms.tangential, rows[2:], rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_mass_matrix_and_bias_of_15(pinch, chapter, seed):
    """G(X) and (G'/2 + S) X' of (15), in the coordinates (12)."""
    X, v, s = random_state(chapter, seed)
    terms = jxr.equation_terms(pinch[0], as_state(X, v, s))
    mass, bias, *_ = chapter.terms(X, v, s)
    np.testing.assert_allclose(terms.mass, mass, rtol=1e-12, atol=1e-12 * mass[3:, 3:].max())
    np.testing.assert_allclose(terms.bias, bias, rtol=1e-12, atol=1e-12 * np.abs(bias).max())


def test_bias_of_the_oracle_is_christoffels(chapter):
    """(14) makes (15) of (13): (G'/2 + S) v = G' v - grad(v G v)/2, from the oracle's mass matrix alone."""
    X, v, s = random_state(chapter, 0)
    step = 1e-5
    slope = [
        (chapter.kinetic(X + step * e, v) - chapter.kinetic(X - step * e, v)) / (2 * step) for e in np.eye(8)
    ]
    ahead, behind = (chapter.mass_matrix(chapter.places(X + h * v)) for h in (step, -step))
    expected = (ahead - behind) / (2 * step) @ v - slope
    np.testing.assert_allclose(chapter.terms(X, v, s)[1], expected, atol=1e-8 * np.abs(expected).max())


def test_gradients_of_the_constraints_are_total(pinch, chapter):
    """(11), (15), (23): Q_ni and Q_bi along any motion that rolls by (7); not so at fixed s."""
    X, s = np.asarray(pinch[1].q), START
    for seed in range(4):
        v = np.random.default_rng(seed).uniform(-3.0, 3.0, 8)
        terms = jxr.equation_terms(pinch[0], as_state(X, v, s))
        rates = np.concatenate([terms.normal @ v, terms.tangential @ v])
        moved, rolled = X + 1j * STEP * v, s + 1j * STEP * chapter.rolling(v, s)
        np.testing.assert_allclose(chapter.constraints(moved, rolled).imag / STEP, rates, atol=1e-13)
        partial = chapter.constraints(moved, s).imag / STEP
        assert np.abs(partial - rates).max() > 1e-2 * np.abs(rates).max()


def test_closed_loop_23_and_24(pinch, chapter):
    """(23), which (24) has as its equations: accelerations and forces with dP/dX of (22), in motion."""
    grasp, _ = pinch
    run = simulated(pinch, 0.05)
    state = run.last
    X, v = np.asarray(state.q), np.asarray(state.v)
    assert np.abs(v).max() > 0.1
    terms = jxr.equation_terms(grasp, state)
    forces = jxr.multipliers(grasp, 0.05, state)
    slope = np.array([chapter.potential_rate(X, e) for e in np.eye(8)])
    damped = chapter.c * np.concatenate([np.zeros(3), v[3:]])
    pushed = forces.f @ terms.normal + forces.lam @ terms.tangential
    inertial = terms.mass @ jxr.accelerations(grasp, 0.05, state) + terms.bias
    np.testing.assert_allclose(inertial + damped + slope + pushed, np.zeros(8), atol=1e-14)


def test_kinetic_and_potential_energy_13_22(pinch, chapter):
    """(13) and (22), whose sum is (21)."""
    X, v, s = random_state(chapter, 3)
    kinetic, potential = jxr.energies(pinch[0], as_state(X, v, s))
    assert float(kinetic) == pytest.approx(chapter.kinetic(X, v), rel=1e-13)
    assert float(potential) == pytest.approx(chapter.potential(X), rel=1e-13)


def test_control_16_17(pinch, chapter):
    """(16)-(17), from the printed Jacobians."""
    for seed in range(4):
        X, v, s = random_state(chapter, seed)
        expected = chapter.torques(X, v)
        np.testing.assert_allclose(torques(pinch[0], as_state(X, v, s)), expected, rtol=0, atol=1e-13)


def test_power_identity_18(pinch, chapter):
    """(18): u . q' = -dP/dt - sum c_i |q_i'|^2, with the package's u and the oracle's P."""
    grasp, _ = pinch
    X, v, s = random_state(chapter, 5)
    state = as_state(X, v, s)
    spent = chapter.c * v[3:] @ v[3:]
    drive = float(torques(grasp, state) @ v[3:])
    assert drive == pytest.approx(-chapter.potential_rate(X, v) - spent, rel=1e-13)
    ready = grasp.prepared()
    leaves = to_leaves(state, ready.form)
    assert float(power(ready, 0.0, leaves, evaluate(ready, 0.0, leaves, Index1()))) == pytest.approx(
        -spent, rel=1e-13
    )


def test_control_is_blind(pinch, chapter):
    """No derivative of the torques in anything of the object, and no way to see it."""
    grasp, _ = pinch
    X, v, s = random_state(chapter, 6)
    state = as_state(X, v, s)
    shapes, rest = eqx.partition(grasp.object, eqx.is_inexact_array)
    assert len(jax.tree.leaves(shapes)) >= 4

    def of_object(shapes):
        seen = eqx.tree_at(lambda g: g.object, grasp, eqx.combine(shapes, rest))
        return torques(seen, state)

    for slope in jax.tree.leaves(jax.jit(jax.jacfwd(of_object))(shapes)):
        assert not np.asarray(slope).any()
    slopes = jax.jit(jax.jacfwd(lambda x: torques(grasp, x)))(state)
    assert not np.asarray(slopes.q[:, :3]).any() and not np.asarray(slopes.v[:, :3]).any()
    assert not np.asarray(slopes.s).any()
    assert np.asarray(slopes.q[:, 3:]).any(axis=0).all() and np.asarray(slopes.v[:, 3:]).any(axis=0).all()
    assert {field.name for field in dataclasses.fields(Sensed)} == {"angles", "rates", "tip", "unit_twists"}


def test_constraints_stay_at_rounding_level_for_10_s(settled):
    """Tighter than the promised 1e-12: even without projection this scene drifts by 5e-13 m alone."""
    left = settled.residuals
    assert np.abs(left.normal).max() <= 1e-15
    assert np.abs(left.tangential).max() <= 1e-15
    assert np.abs(left.tangency).max() <= 2e-15


def test_constraints_5_6_in_the_chapters_form(settled, chapter):
    """The package's states satisfy the printed (5)-(6) and assumption 2)."""
    for i in range(0, 301, 10):
        X, s = np.asarray(settled.states.q[i]), START - SENSE * np.asarray(settled.states.s[i])
        assert np.abs(chapter.constraints(X, s)).max() <= 1e-12
        assert np.abs(chapter.mismatch(X, s)).max() <= 1e-12


def test_energy_balance_20(pinch):
    """(20): the energy (21) falls by what the damping takes."""
    energy = simulated(pinch, 10.0, rtol=1e-9).energy
    size = np.abs(energy.kinetic + energy.potential).max()
    assert np.abs(energy.residual).max() <= 1e-9 * size
    assert float(energy.work[-1]) < -0.01 * size  # it does dissipate


def test_trajectory_against_the_chapters_equations(pinch, chapter):
    """(1)-(7) with (16)-(17), integrated by SciPy in full coordinates without projection."""
    run = simulated(pinch, 2.0, rtol=1e-11)
    X, v, s, forces = chapter.simulate(np.asarray(pinch[1].q), START, np.asarray(run.ts))
    assert np.ptp(s, axis=0).min() > 1e-3 and np.ptp(X[:, 2]) > 0.05  # it does roll
    assert max(np.abs(chapter.constraints(*at)).max() for at in zip(X, s, strict=True)) < 1e-13
    np.testing.assert_allclose(run.states.q, X, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.v, v, rtol=0, atol=1e-8)
    np.testing.assert_allclose(START - SENSE * np.asarray(run.states.s), s, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.multipliers.f, forces[:, :2], rtol=0, atol=1e-7)
    np.testing.assert_allclose(run.multipliers.lam, forces[:, 2:], rtol=0, atol=1e-7)


def superellipse(u):
    """Half axes of 10 and 25 mm, of the eighth degree: without curvature where it faces along an axis."""
    x, y = jnp.cos(u), jnp.sin(u)
    return jnp.stack([0.01 * x, 0.025 * y]) * (x**8 + y**8) ** -0.125


def stadium(s):
    """By arclength from the middle of the right side, 30 mm long and straight; half circles of 10 mm."""
    radius, half = 0.01, 0.015
    rest = s % (2 * half + np.pi * radius)
    t = jnp.clip((rest - half) / radius, 0.0, np.pi)
    y = jnp.where(rest < half, rest, jnp.where(t < np.pi, half, 2 * half + np.pi * radius - rest))
    point = jnp.stack([radius * jnp.cos(t), y + radius * jnp.sin(t)])
    return jnp.where((s % STADIUM) < 0.5 * STADIUM, point, -point)


STADIUM = 0.06 + 0.02 * np.pi


def rounded_rectangle():
    """Points of a rectangle with corners of 1 mm radius; a spline bends its sides by noise alone."""
    turns = np.pi / 2 * np.arange(4)[:, None] + np.pi / 2 * np.linspace(0.0, 1.0, 13)
    middles = np.array([[0.014, 0.024], [-0.014, 0.024], [-0.014, -0.024], [0.014, -0.024]])
    corners = middles[:, None] + 1e-3 * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    ring = corners.reshape(-1, 2)
    pairs = zip(ring, np.roll(ring, -1, axis=0), strict=True)
    return np.concatenate(
        [
            a + (b - a) * np.arange(n)[:, None] / n
            for a, b in pairs
            for n in [max(1, int(np.hypot(*(b - a)) / 3e-4))]
        ]
    )


@pytest.mark.parametrize(
    ("contour", "left"),
    [
        (jxr.Parametric(superellipse, (0.0, 2 * np.pi), closed=True), None),
        (jxr.Parametric(stadium, (0.0, STADIUM), closed=True), 0.5 * STADIUM),
        (jxr.Spline(rounded_rectangle()), None),
    ],
    ids=["superellipse", "stadium", "corners"],
)
@pytest.mark.parametrize("angle", [np.pi, 0.0, 3.124062163134476, 0.5])
def test_a_closed_contour_faces_a_finger_where_it_reaches_farthest_though_it_is_straight(
    contour, left, angle
):
    low, high = contour.domain()
    place = facing_place("object", contour, angle)
    assert low - 0.01 <= place <= high + 0.01
    along = np.array([np.cos(angle), np.sin(angle)])
    every = np.asarray(jax.vmap(contour.point)(jnp.linspace(low, high, 20001))) @ along
    assert every.max() - contour.point(place) @ along <= 1e-6
    if left is not None and angle == np.pi:
        assert abs(place - left) <= 1e-12


def test_the_place_that_faces_a_finger_moves_with_the_contour():
    turned = jax.jit(jax.value_and_grad(lambda b: facing_place("object", jxr.Ellipse(0.02, b), 0.7)))
    h = 1e-5
    slope = (turned(0.013 + h)[0] - turned(0.013 - h)[0]) / (2 * h)
    assert abs(turned(0.013)[1] / slope - 1.0) <= 1e-6
