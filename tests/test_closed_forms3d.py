"""The closed forms for bodies rolling in space, against the textbook equations integrated directly."""

import numpy as np
import pytest

from tests.oracles import closed_forms_space as cf


@pytest.mark.parametrize("k", [2 / 5, 2 / 3])
def test_turntable(k):
    given = dict(Omega=3.0, r=0.02, k=k)
    x0, v0, ts = np.array([0.1, -0.05, 0.02]), np.array([0.07, 0.2, 0.0]), np.linspace(0, 5, 26)
    expected = [np.concatenate(cf.ball_on_turntable(t, x0, v0, 1.5, **given)) for t in ts]
    found = cf.integrated(lambda _, y: cf.ball_on_turntable_rates(y, **given)[0], expected[0], ts)
    assert np.abs(found - expected).max() < 1e-9  # spin of 20 rad/s
    again = cf.ball_on_turntable(2 * np.pi / (k / (1 + k) * 3.0), x0, v0, 1.5, **given)
    assert np.allclose(again[0], x0, atol=1e-15) and np.allclose(again[1], v0, atol=1e-15)


@pytest.mark.parametrize("rate", [7.0, -7.0])
def test_ball_in_a_cylinder(rate):
    R, r, g, ts = 0.1, 0.02, 9.81, np.linspace(0, 3, 31)
    phi, z, vz, spin = cf.ball_in_cylinder(ts, 0.3, 0.4, rate, 5.0, R=R, r=r, g=g)
    e, f = np.array([np.cos(phi), np.sin(phi), 0 * phi]).T, np.array([-np.sin(phi), np.cos(phi), 0 * phi]).T
    up = np.array([[0, 0, 1.0]])
    x = (R - r) * e + z[:, None] * up
    v = (R - r) * rate * f + vz[:, None] * up
    w = spin[0][:, None] * e + spin[1][:, None] * f + spin[2][:, None] * up
    expected = np.concatenate([x, v, w], axis=1)
    found = cf.integrated(lambda _, y: cf.ball_in_cylinder_rates(y, r=r, g=g), expected[0], ts, rtol=3e-14)
    assert np.abs(found - expected).max() < 1e-9  # spin up to 200 rad/s
    assert np.ptp(z) > 0.3


def test_incline_and_sphere():
    assert cf.incline_acceleration(np.pi / 2, 7.0) == pytest.approx(5.0, rel=1e-15)
    start, ts = np.array([0.1, 0.3]), np.linspace(0, 0.5, 6)
    y = cf.integrated(lambda _, y: cf.ball_on_sphere_rates(y, R=0.2, r=0.05, g=9.81), start, ts)
    energy = 0.7 * 0.25**2 * y[:, 1] ** 2 + 9.81 * 0.25 * np.cos(y[:, 0])
    assert np.ptp(energy) < 1e-11
    assert y[-1, 0] > 0.5


def rolled(path, angles, r):
    """Net rotation along pieces of a path given by velocities."""
    R = np.eye(3)
    for velocity, end in zip(path, angles, strict=True):
        R = cf.rotation_along_curve(velocity, (0, end), r) @ R
    return R


def test_holonomy_of_a_circle():
    r, radius = 0.02, 0.03
    heading = np.array([0, 1.0, 0])
    closed = cf.rotation_along_arc(heading, radius, 2 * np.pi, r)
    found = cf.rotation_along_curve(
        lambda t: radius * np.array([-np.sin(t), np.cos(t), 0]), (0, 2 * np.pi), r
    )
    assert np.abs(found - closed).max() < 1e-11
    total = 2 * np.pi * np.sqrt(1 + (radius / r) ** 2)
    assert cf.rotation_angle(closed) == pytest.approx(abs(total - 4 * np.pi), rel=1e-14)


def test_holonomy_of_a_small_circle_is_less_the_area():
    r, radius = 0.02, 1e-4
    R = cf.rotation_along_arc(np.array([0, 1.0, 0]), radius, 2 * np.pi, r)
    assert R[1, 0] == pytest.approx(-np.pi * (radius / r) ** 2, rel=1e-4)


def test_holonomy_of_a_rounded_square():
    r, radius, side = 0.02, 0.01, 0.05
    path, ends = [], []
    for corner in range(4):
        T = cf.rotation_about_vertical(corner * np.pi / 2)
        path.append(lambda t, T=T: T @ [1, 0, 0])
        path.append(lambda t, T=T: radius * T @ [np.cos(t), np.sin(t), 0])
        ends += [side, np.pi / 2]
    closed = cf.rotation_along_rounded_square(side, radius, r)
    assert np.abs(rolled(path, ends, r) - closed).max() < 1e-11
    assert cf.rotation_angle(closed) > 0.1


def test_holonomy_of_a_smooth_path_forth_and_back():
    there = cf.rotation_along_curve(cf.smooth_loop_velocity, (0, 2 * np.pi), 0.02)
    back = cf.rotation_along_curve(lambda t: -cf.smooth_loop_velocity(-t), (0, 2 * np.pi), 0.02)
    assert np.abs(there @ back - np.eye(3)).max() < 1e-11
    assert cf.rotation_angle(there) > 0.1


@pytest.mark.parametrize("rho", [0.0, 0.01, 0.03])
@pytest.mark.parametrize(("theta", "Omega"), [(1.2, 1.5), (1.9, -2.0), (0.7, 6.0)])
def test_steady_wheel(rho, theta, Omega):
    wheel = cf.example_wheel(rho)
    p, w, place = wheel.start(theta, Omega)
    roller = wheel.roller()
    # In body axes the steady w turns backwards with the spin about the axis, w3 - Omega cos(theta).
    spin = w[2] - Omega * np.cos(theta)
    up, _ = roller.spin_up(p, w)
    assert np.abs(up + np.cross([0, 0, spin], w)).max() < 1e-12 * np.abs(w).max() ** 2
    _, centre, contact = wheel.steady(theta, Omega)
    ts = np.linspace(0, 0.5, 6)
    P, x, _ = roller.simulate(p, w, ts, place)
    heights = [cf.quaternion_matrix(a)[2, 2] for a in P]
    assert np.abs(np.cos(theta) - heights).max() < 1e-9
    circle = centre * np.array([-np.sin(Omega * ts), np.cos(Omega * ts)]).T
    assert np.abs(x[:, :2] - circle).max() < 1e-9
    touched = [y + cf.quaternion_matrix(a) @ roller.parts(a, w)[1] for a, y in zip(P, x, strict=True)]
    assert np.abs(np.hypot(*np.array(touched).T[:2]) - abs(contact)).max() < 1e-9


def test_wheel_by_newton_euler():
    """The relation for a torus from momenta at two instants of the steady motion, by complex step."""
    theta, Omega, wheel = 1.1, 2.3, cf.example_wheel(0.02)
    w3, centre, _ = wheel.steady(theta, Omega)
    t = 1e-30j
    c, s = np.cos(Omega * t), np.sin(Omega * t)
    g, h = np.array([-s, c, 0 * t]), np.array([c, s, 0 * t])
    e, u = np.cos(theta) * cf.UP - np.sin(theta) * g, np.sin(theta) * cf.UP + np.cos(theta) * g
    L = wheel.A * Omega * np.sin(theta) * u + wheel.C * w3 * e
    V = -Omega * centre * h
    force = wheel.mass * (V.imag / 1e-30 + wheel.gravity * cf.UP)
    d = (-wheel.a * u - wheel.rho * cf.UP).real
    w = (w3 * e + Omega * np.sin(theta) * u).real
    assert np.abs(V.real + np.cross(w, d)).max() < 1e-15
    assert np.abs(L.imag / 1e-30 - np.cross(d, force)).max() < 1e-15


def test_rattleback_reverses():
    body, p, w = cf.rattleback()
    ts = np.linspace(0, 3, 13)
    P, x, W = body.simulate(p, w, ts)
    spin, energy = body.history(P, W)
    assert spin[0] < -4.9 and spin[-1] > 4.9
    assert np.ptp(energy) < 1e-11 * energy[0]
    lowest = [y[2] + body.parts(a, b)[1] @ body.parts(a, b)[0] for a, y, b in zip(P, x, W, strict=True)]
    assert np.abs(lowest).max() < 1e-13
    assert min(body.force(*state)[2] for state in zip(P, W, strict=True)) > 1.0


def test_rattleback_keeps_the_right_way():
    body, p, w = cf.rattleback()
    P, _, W = body.simulate(p, -w, np.linspace(0, 3, 7), rtol=1e-8)  # it is stable: nothing grows
    assert body.history(P, W)[0].min() > 4.8
