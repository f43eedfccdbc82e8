"""Jaws: prismatic joints by hand, energy, and a parallel gripper that squeezes a roller."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._linalg import unstack
from tests.measures import both_ways
from tests.recorded import runs


def gripper(gravity=None):
    """A disc between a fixed wall and a jaw on two oblique joints."""
    wall = jxr.Jaw(jxr.Line(), angle=0.5 * np.pi)
    jaw = jxr.Jaw(
        jxr.Line(), 0.3, jnp.array([0.2, 1.3]), base=jnp.array([0.01, 0.02]), angle=jnp.asarray(-0.5 * np.pi)
    )
    disc = jxr.FreeObject(jxr.Circle(0.01), 0.05, 2.5e-6)
    quarter = 0.005 * np.pi
    # The jaw touches the disc 10 mm along its line, above the wall.
    contacts = (jxr.Contact(-0.01, quarter, finger=0), jxr.Contact(0.0, -quarter, finger=1))
    grasp = jxr.Grasp(disc, (jaw, wall), contacts, gravity=gravity)
    state = jxr.State(jnp.array([0.0, 0.01, 0.0, 0.0, 0.0]), jnp.zeros(5), jnp.zeros(2))
    return grasp, state


def test_mass_and_weight_of_oblique_joints():
    gravity = np.array([0.3, -9.81])
    terms = jxr.equation_terms(*gripper(gravity))
    axes = np.stack([np.cos([0.2, 1.3]), np.sin([0.2, 1.3])])
    np.testing.assert_allclose(terms.mass[3:, 3:], 0.3 * axes.T @ axes, rtol=1e-14)
    np.testing.assert_allclose(terms.bias[3:], -0.3 * gravity @ axes, rtol=1e-14)
    assert terms.mass.shape == (5, 5)  # the wall has no coordinate


def test_a_jaw_moves_as_its_frame_does():
    """Its twist is the derivative of its pose along the rates of both joints."""
    jaw = jxr.Jaw(jxr.Line(), directions=[0.2, 1.3], base=(0.01, 0.02), angle=-0.5)
    q, v = jnp.array([0.03, -0.01]), jnp.array([0.7, 0.4])
    _, moved = jax.jvp(lambda q: jaw.pose(unstack(q)), (q,), (v,))
    twist = jaw.motion(unstack(q), unstack(v), None)[0].twist
    np.testing.assert_allclose(twist.velocity.array(), moved.origin.array(), rtol=1e-14)
    assert float(twist.spin) == 0.0 < np.abs(moved.origin.array()).min()


def test_a_jaw_is_not_longer_for_being_heavier():
    """Its size is a length: equilibria and figures are scaled with it."""
    light, heavy = (jxr.Jaw(jxr.Line(), mass, [0.0]).size for mass in (0.1, 10.0))
    assert float(light) == float(heavy) and light.shape == ()


def test_energy_of_a_rolling_plate():
    """Under its weight the plate presses; a sideways pull of gravity sets the roller going."""
    grasp, state = gripper(np.array([0.5, -9.81]))
    run = jxr.simulate(grasp, state, 0.2, ts=21, rtol=1e-10, record=("energy", "multipliers"))
    size = float(np.abs(run.energy.kinetic).max())
    assert size > 1e-5 and np.abs(run.energy.residual).max() < 1e-9 * size
    x, plate = np.asarray(run.states.q[:, 0]), np.asarray(run.states.q[:, 3:])
    travel = plate @ np.cos([0.2, 1.3])
    np.testing.assert_allclose(x - x[0], 0.5 * (travel - travel[0]), atol=1e-14)
    # By hand: the roller's m/4 + I/(4 r^2) rides on the plate's mass; half of its own weight pulls along.
    moved = 0.3 + 0.25 * 0.05 + 0.25 * 2.5e-6 / 0.01**2
    pull = 0.5 * (0.3 + 0.5 * 0.05)
    np.testing.assert_allclose(travel - travel[0], 0.5 * pull / moved * np.asarray(run.ts) ** 2, atol=1e-9)
    np.testing.assert_allclose(run.multipliers.f[:, 0], 0.3 * 9.81, rtol=1e-6)
    np.testing.assert_allclose(run.multipliers.f[:, 1], 0.35 * 9.81, rtol=1e-6)


def test_disc_on_an_incline():
    """Nothing but a fixed wall: a disc rolls down with two thirds of the pull."""
    slope, g = 0.3, 9.81
    wall = jxr.Jaw(jxr.Line(), angle=0.5 * np.pi)
    disc = jxr.FreeObject(jxr.Circle(0.01), 0.05, 2.5e-6)
    down = np.array([g * np.sin(slope), -g * np.cos(slope)])
    grasp = jxr.Grasp(disc, wall, jxr.Contact(0.0, -0.005 * np.pi), gravity=down)
    start = jxr.State(jnp.array([0.0, 0.01, 0.0]), jnp.zeros(3), jnp.zeros(1))
    run = jxr.simulate(grasp, start, 1.0, ts=11, rtol=1e-10, record=("energy",))
    exact = 0.5 * (2.0 / 3.0) * g * np.sin(slope) * np.asarray(run.ts) ** 2
    np.testing.assert_allclose(run.states.q[:, 0], exact, rtol=1e-12, atol=1e-15)
    assert np.abs(run.energy.residual).max() < 1e-12 * float(run.energy.kinetic[-1])


def test_jaws_are_drawn():
    grasp, run = runs.scene("roller")[0], runs.run("roller", times=31, t1=1.0)
    figure = jxr.plotting.poses(grasp, run, times=(0.0, 0.5, 1.0))
    assert len(figure.axes) >= 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((jxr.Line(), 0.0), "mass must be positive"),
        ((jxr.Line(), 1.0, [0.0, 1.0, 2.0]), "at most 2 angles"),
        (("line",), "contour must be a contour"),
    ],
)
def test_bad_jaws(arguments, message):
    with pytest.raises(ValueError, match=message):
        jxr.Jaw(*arguments)


def roller_between_plates(p):
    """Where a roller lies on a fixed plate and below another one that are turned by an angle.

    In the other numbers, the roller's radius and where the upper plate's joints begin.
    """
    angle, radius, base, quarter = p[0], p[1], p[2:], 0.5 * np.pi
    across = jnp.stack([-jnp.sin(angle), jnp.cos(angle)])
    directions = jnp.stack([angle, angle + quarter])
    upper = jxr.Jaw(jxr.Line(), 0.2, directions, base=0.02 * across + base, angle=angle - quarter)
    plates = (upper, jxr.Jaw(jxr.Line(), angle=angle + quarter))
    contacts = [jxr.Contact(0.0, radius * (angle + way * quarter), finger=i) for i, way in enumerate((1, -1))]
    grasp = jxr.Grasp(jxr.FreeObject(jxr.Circle(radius), 0.02, 1e-6), plates, contacts)
    guess = jxr.State(jnp.zeros(5).at[:2].set(0.01 * across), jnp.zeros(5), jnp.zeros(2))
    return jxr.close(grasp, guess)[1].q


lies = both_ways(roller_between_plates)


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0])
def test_held_contacts_of_parallel_plates_have_derivatives(angle):
    """Both tangencies ask the same of the roller's angle: their multipliers are open, the pose is not."""
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    given = np.array([angle, 0.01, 0.0, 0.0])
    # The lower plate stays, the roller's centre is a radius above it, the upper plate two.
    wanted = np.zeros((5, 3))
    wanted[:2, 0], wanted[4, 0], wanted[3, 1:], wanted[4, 1:] = across, 2.0, -along, -across
    forwards = np.stack([lies(given, way, np.zeros(5))[1] for way in np.eye(4)[1:]], axis=1)
    backwards = np.stack([lies(given, np.zeros(4), bar)[2] for bar in np.eye(5)])[:, 1:]
    for found in (forwards, backwards):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-10)
