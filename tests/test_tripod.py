"""A hand that hangs above an object, holds it and carries it where commands say."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxroll as jxr
from jaxroll._linalg import Twist3, Vec3
from jaxroll.control import Carry, Sensed
from tests.measures import both_ways
from tests.recorded import runs

WEIGHT = 0.05 * 9.81  # of the object [N]


def vectors(rows):
    return [Vec3(*row) for row in rows]


@jax.jit
def told(control, fingers, tips, angles):
    """Torques at t = 0, and the potential's gradient in the tips: one program for all numbers."""
    stored = lambda rows: control.potential([Vec3(*row) for row in rows], angles)  # noqa: E731
    return control.torques(0.0, fingers), jax.grad(stored)(tips)


@pytest.mark.parametrize("angle", [0.0, 1e-5, 0.7])
def test_the_law_is_opposition_springs_and_a_share_of_the_load(angle):
    """Torques by NumPy and scipy's rotations; but for damping they are the potential's gradient."""
    rng = np.random.default_rng(3)
    tips, home, jacobians = rng.normal(size=(3, 3)), rng.normal(size=(3, 3)), rng.normal(size=(3, 2, 3))
    rates, angles = rng.normal(size=(2, 3, 2))
    beta, damping, stiffness, position, force = 3.0, np.array([0.1, 0.2, 0.3]), 7.0, *rng.normal(size=(2, 3))
    turn = angle * np.array([0.6, 0.0, 0.8])
    control = Carry(beta, damping, stiffness, home=home, position=position, turn=turn, force=force)
    places = position + Rotation.from_rotvec(turn).apply(home)
    pulls = beta * (3 * tips - tips.sum(axis=0)) + stiffness * (tips - places) - force / 3
    wanted = -damping[:, None] * rates - np.einsum("ijk,ik->ij", jacobians, pulls)
    found, slopes = told(control, sensed(angles, rates, tips, jacobians), tips, angles)
    np.testing.assert_allclose(found, wanted, rtol=1e-13)
    np.testing.assert_allclose(slopes, pulls, rtol=1e-13)


def sensed(angles, rates, tips, jacobians):
    """What three fingers of two joints say."""
    return [
        Sensed(tuple(a), tuple(w), tip, tuple(Twist3(column, column) for column in vectors(j)))
        for a, w, tip, j in zip(angles, rates, vectors(tips), jacobians, strict=True)
    ]


def test_functions_of_time_are_numbers_at_each_time_and_have_no_potential():
    rng = np.random.default_rng(3)
    tips, home, jacobians = rng.normal(size=(3, 3)), rng.normal(size=(3, 3)), rng.normal(size=(3, 2, 3))
    rates, angles = rng.normal(size=(2, 3, 2))
    beta, stiffness, position, force = 3.0, 7.0, *rng.normal(size=(2, 3))
    fingers = sensed(angles, rates, tips, jacobians)
    moving = Carry(beta, lambda t: t, stiffness, home=home, position=lambda t: t * position, force=force)
    held = Carry(beta, 2.0, stiffness, home=home, position=2.0 * position, force=force)
    at = jax.jit(lambda t: [c.torques(t, fingers) for c in (moving, held)])
    np.testing.assert_allclose(*map(np.array, at(2.0)), rtol=1e-15)
    assert float(moving.potential(vectors(tips), angles)) == 0.0


def test_the_potential_has_a_slope_where_nothing_is_turned():
    r"""That of $\frac k2 \sum |r - R(\varphi) h|^2$ at no turn: $-k \sum h \times r$."""
    rng = np.random.default_rng(1)
    tips, home = rng.normal(size=(2, 2, 3))
    stored = lambda turn: Carry(0.0, 0.0, 5.0, home=home, turn=turn).potential(vectors(tips), ())  # noqa: E731
    wanted = -5.0 * np.cross(home, tips).sum(axis=0)
    np.testing.assert_allclose(jax.jit(jax.grad(stored))(np.zeros(3)), wanted, rtol=1e-13)


def test_what_does_not_fit_the_grasp_is_refused():
    home = [(0.03, 0.0, 0.0), (-0.03, 0.0, 0.0)]
    finger = jxr.Finger3([(1, 0, 0)], [(0, 0.06, 0)], [0.04], jxr.Sphere(0.01))
    body = jxr.scenes.spheroid()
    control = Carry(1.0, 0.1, 10.0, home=home)
    with pytest.raises(ValueError, match="argument home must have a place for each of 1 fingers"):
        jxr.Grasp(body, finger, jxr.Contact3(), controller=control)
    planar, _ = runs.scene("pivoted")
    with pytest.raises(ValueError, match="argument controller must be one for the plane"):
        planar.with_(controller=control)
    with pytest.raises(ValueError, match="argument object must have one surface"):
        jxr.scenes.tripod(object=jxr.scenes.cuboid())
    with pytest.raises(ValueError, match="argument fingers must be"):
        jxr.scenes.tripod(fingers=1)


def test_the_spheroid_is_the_ellipsoid_of_its_edges():
    """Moments of a solid of points, drawn from the ball."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200_000, 3))
    points *= (rng.uniform(size=200_000) ** (1 / 3) / np.linalg.norm(points, axis=1))[:, None]
    points *= (0.03, 0.03, 0.02)
    second = points.T @ points / len(points)
    wanted = 0.1 * (np.trace(second) * np.eye(3) - second)
    body = jxr.scenes.spheroid(radius=0.03, height=0.04, mass=0.1)
    np.testing.assert_allclose(np.diag(body.inertia), np.diag(wanted), rtol=0.01)


@pytest.mark.parametrize("fingers", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_the_scene_is_closed_and_its_frames_begin_at_the_contacts(fingers):
    grasp, state = jxr.scenes.tripod(fingers=fingers)
    left = jxr.residuals(grasp, state)
    for part in (left.normal, left.tangential, left.tangency):
        assert np.abs(part).max() <= 1e-13
    placed = jax.jit(lambda finger, q: finger.pose(tuple(q)).origin.array())
    for i, finger in enumerate(grasp.fingers):
        origin = np.asarray(placed(finger, np.asarray(state.q)[7 + 3 * i : 10 + 3 * i]))
        way = 2 * np.pi * i / fingers
        np.testing.assert_allclose(origin, (0.02 * np.cos(way), 0.02 * np.sin(way), -0.115), atol=1e-13)
        np.testing.assert_allclose(grasp.controller.home[i] + grasp.controller.position, origin, atol=1e-15)


def smoothly(t, start=0.2, end=2.4):
    """From zero to one, with no jump in its first two derivatives."""
    x = jnp.clip((t - start) / (end - start), 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


@pytest.fixture(scope="module")
def tripod():
    return jxr.scenes.tripod()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["smooth", "ramps"])
def test_it_lifts_and_turns_the_object(tripod, command):
    """50 g by 20 mm and 20 degrees within 3 s: held, with little friction, and no energy from nowhere."""
    grasp, state = tripod
    start, rise, turn = grasp.controller.position, jnp.array([0, 0, 0.02]), jnp.array([0, 0, np.deg2rad(20)])
    if command == "smooth":
        position, turning = (lambda t: start + rise * smoothly(t)), (lambda t: turn * smoothly(t))
    else:
        ends = [0.2, 2.4]
        position = jxr.commands.Ramps(ends, [start, start + rise])
        turning = jxr.commands.Ramps(ends, [0.0 * turn, turn])
    run = jxr.simulate(
        *(grasp.with_(position=position, turn=turning), state),
        t1=3.0,
        ts=np.linspace(0.0, 3.0, 61),
        record=("multipliers", "energy"),
        events=("lift",),
    )
    assert run.result == jxr.RESULTS.successful
    # It begins in equilibrium: nothing moves before 0.2 s, each tip carries a third of the weight and presses
    # as the opposition says.
    assert np.abs(run.states.q[4] - state.q).max() <= 1e-9
    np.testing.assert_allclose(run.multipliers.f[0], 3 * 16.0 * 0.02, rtol=1e-10)
    shares = np.tile([0.0, 0.0, WEIGHT / 3], (3, 1))
    np.testing.assert_allclose(run.multipliers.lam[0], shares, atol=1e-10)
    q = np.asarray(run.last.q)
    np.testing.assert_allclose(q[:3] - np.asarray(state.q[:3]), rise, atol=4e-4)
    np.testing.assert_allclose(np.rad2deg(2 * np.arctan2(q[6], q[3])), 20.0, atol=0.8)
    assert np.abs(run.last.v).max() <= 1e-2  # at rest again
    aside = np.linalg.norm(run.multipliers.lam, axis=-1)
    assert (aside / np.asarray(run.multipliers.f)).max() < 0.2
    size = np.abs(run.energy.kinetic + run.energy.potential).max()
    assert np.abs(run.energy.residual).max() <= 1e-9 * size
    left = run.residuals
    assert max(np.abs(part).max() for part in (left.normal, left.tangential, left.tangency)) <= 1e-12


@pytest.mark.slow
def test_the_scene_has_a_derivative_in_the_radius_of_its_tips():
    def made(radius):
        grasp, state = jxr.scenes.tripod(fingers=2, tips=jxr.Sphere(radius))
        held = grasp.controller
        return jnp.concatenate([state.q, state.s, held.home.ravel(), held.position])

    at, step = 0.011, 1e-6
    weights = np.linspace(1.0, 2.0, jax.eval_shape(made, at).size)
    both = both_ways(made)
    wanted = (both(at + step, 1.0, weights)[0] - both(at - step, 1.0, weights)[0]) / (2.0 * step)
    _, slope, back = both(at, 1.0, weights)
    np.testing.assert_allclose(slope, wanted, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(back, slope @ weights, rtol=1e-12)
