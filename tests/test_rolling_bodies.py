"""Single bodies that roll in space, against the closed forms of the textbooks."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import jaxroll as jxr
from jaxroll._analysis._loci import _Jet, _loci, _locus
from jaxroll._analysis._rolling_kinematics import _Rolling
from tests.helpers import in_single
from tests.oracles import closed_forms_space as closed


def run_of(scene, t1, *, ts=61, rtol=1e-12, **options):
    return jxr.simulate(*scene, t1=t1, ts=ts, rtol=rtol, max_steps=65536, **options)


def off(run):
    """Largest gap and tangency [m, rad]."""
    left = run.residuals
    return max(float(jnp.abs(x).max()) for x in (left.normal, left.tangential, left.tangency))


@pytest.fixture(scope="module")
def turning():
    scene = jxr.scenes.turntable()
    return scene, run_of(scene, 10 * 2 * np.pi / (2 / 7 * 2.0), ts=201, record=("energy",))


def test_ball_on_a_turntable_for_ten_turns(turning):
    _, run = turning
    start = (np.array([0.3, 0.1, 0.0]), np.array([0.2, -0.4, 0.0]))
    known = [closed.ball_on_turntable(t, *start, 0.7, Omega=2.0, r=0.05) for t in np.asarray(run.ts)]
    x, v = np.array([k[0] for k in known]), np.array([k[1] for k in known])
    assert np.abs(run.states.q[:, :2] - x[:, :2]).max() <= 1e-9 * np.abs(x).max()
    assert np.abs(run.states.v[:, :2] - v[:, :2]).max() <= 1e-9 * np.abs(v).max()
    spins = [
        closed.quaternion_matrix(q[3:7]) @ w[3:]
        for q, w in zip(np.asarray(run.states.q), np.asarray(run.states.v), strict=True)
    ]
    assert np.abs(np.array(spins) - np.array([k[2] for k in known])).max() <= 1e-9 * 10.0
    assert off(run) <= 1e-14


def test_the_turntable_does_the_work_that_the_ball_gains(turning):
    run = turning[1]
    gained = np.ptp(run.energy.kinetic)
    assert gained > 0.1  # or there would be nothing to see
    assert np.abs(run.energy.residual).max() <= 1e-9 * gained


def test_clock_of_a_moving_stage(turning):
    run = turning[1]
    np.testing.assert_allclose(run.states.q[:, 7], run.ts, rtol=1e-13, atol=1e-13)


def test_ball_in_a_vertical_tube():
    run = run_of(jxr.scenes.tube(), 10.0)
    angle, z, vz, _ = closed.ball_in_cylinder(np.asarray(run.ts), 0.0, 0.3, 6.0, 4.0, R=0.2, r=0.05, g=9.81)
    scale = np.abs(z).max()
    assert np.abs(run.states.q[:, 2] - z).max() <= 1e-9 * scale
    assert np.abs(run.states.v[:, 2] - vz).max() <= 1e-9 * np.abs(vz).max()
    assert np.abs(run.states.q[:, 0] - 0.15 * np.cos(angle)).max() <= 1e-9 * 0.15


def test_ball_on_an_incline():
    run = run_of(jxr.scenes.incline(slope=0.3), 3.0, record=("multipliers",))
    way = 0.5 * closed.incline_acceleration(0.3, 9.81) * np.asarray(run.ts) ** 2
    x = 0.05 * np.sin(0.3) + way * np.cos(0.3)
    assert np.abs(run.states.q[:, 0] - x).max() <= 1e-9 * way.max()
    weight = 0.3 * 9.81
    np.testing.assert_allclose(run.multipliers.f, weight * np.cos(0.3), rtol=1e-12)
    rubbing = np.linalg.norm(run.multipliers.lam[:, 0], axis=-1)
    np.testing.assert_allclose(rubbing, 2 / 7 * weight * np.sin(0.3), rtol=1e-11)


def test_the_contact_moves_by_the_normal_of_the_object():
    """(L_A + L_B) s = (omega_A - omega_B) x n with the object's outward n: a ball on a slope that rests."""
    scene = jxr.scenes.incline()
    last, radius = run_of(scene, 0.2, record=("multipliers",)).last, float(scene[0].object.shapes[0].radius)
    velocity, spin = np.asarray(last.v[:3]), closed.quaternion_matrix(last.q[3:7]) @ last.v[3:6]
    # The contact goes over the slope as the ball's centre does. The ball's normal points into the slope.
    normal = -np.asarray(scene[1].q[:3]) / radius
    assert np.linalg.norm(velocity) > 0.1
    np.testing.assert_allclose(velocity / radius, np.cross(-spin, normal), atol=1e-9)


@pytest.mark.parametrize("tube", [0.01, 0.03])
def test_steady_precession_of_a_wheel(tube):
    run = run_of(jxr.scenes.wheel(tube=tube), 3.0)
    rim = closed.Wheel(mass=0.5, A=0.25 * 0.5 * 0.01, C=0.5 * 0.5 * 0.01, a=0.1, rho=tube, gravity=9.81)
    spin, centre, _ = rim.steady(1.2, 3.0)
    t = np.asarray(run.ts)
    path = np.stack([-centre * np.sin(3 * t), centre * np.cos(3 * t), 0.1 * np.sin(1.2) + tube + 0 * t], -1)
    assert np.abs(run.states.q[:, :3] - path).max() <= 1e-9 * abs(centre)
    assert np.abs(run.states.v[:, 5] - spin).max() <= 1e-9 * abs(spin)


def test_rolling_disc_at_default_settings_is_within_ten_nanometres():
    run = run_of(jxr.scenes.wheel(), 3.0, rtol=1e-9)
    centre = closed.Wheel(0.5, 0.25 * 0.5 * 0.01, 0.5 * 0.5 * 0.01, 0.1, 0.01, 9.81).steady(1.2, 3.0)[1]
    t = np.asarray(run.ts)
    assert (
        np.hypot(
            run.states.q[:, 0] + centre * np.sin(3 * t), run.states.q[:, 1] - centre * np.cos(3 * t)
        ).max()
        < 1e-8
    )


def test_rattleback_reverses_its_spin_and_keeps_its_energy():
    run = run_of(jxr.scenes.rattleback(), 20.0, ts=201, rtol=1e-11, record=("energy",))
    spin = np.asarray(run.states.v[:, 5])
    assert spin[0] == -5.0 and spin[30] > 4.5  # 3 s later it goes round the other way
    assert np.abs(run.energy.residual).max() <= 1e-9 * np.abs(run.energy.kinetic + run.energy.potential).max()
    assert off(run) <= 1e-13
    right_way = run_of(jxr.scenes.rattleback(spin=5.0), 4.0, ts=201, rtol=1e-9, record=("energy",))
    assert np.asarray(right_way.states.v[:, 5]).min() > 4.5


def test_rattleback_against_an_independent_formulation():
    body, quaternion, spin = closed.rattleback()
    run = run_of(jxr.scenes.rattleback(), 2.0, ts=201, record=("energy",))
    np.testing.assert_allclose(run.states.q[0, 3:7], quaternion, atol=1e-12)
    _, centres, spins = body.simulate(quaternion, spin, np.asarray(run.ts))
    assert np.abs(run.states.v[:, 3:] - spins).max() <= 1e-8
    x = np.asarray(run.states.q[:, :3])
    assert np.abs(x - x[0] - (centres - centres[0])).max() <= 1e-9


def moving(numbers, t):
    """A table that is shaken to and fro, falls, and tilts to and fro: from rest, so its turning changes."""
    shake, fall, tilt = numbers
    half = tilt * (1.0 - jnp.cos(3 * t))
    place = jnp.stack([shake * jnp.sin(3 * t), 0 * t, -fall * t**3])
    return place, jnp.stack([jnp.cos(half), jnp.sin(half), 0 * t, 0 * t])


def on_a_table(shake=0.0, fall=0.0, tilt=0.0):
    """A ball on it, and where it rests on a level plane; one program serves all motions."""
    grasp, state = jxr.scenes.incline(slope=0.0)
    table = jxr.Stage(jxr.Plane(), jax.tree_util.Partial(moving, jnp.array([shake, fall, tilt])))
    return jxr.Grasp(grasp.object, table, grasp.contacts, gravity=grasp.gravity), state


def test_ball_on_a_shaken_table_follows_two_sevenths_of_it():
    shaken, state = on_a_table(shake=0.02)
    # At t = 0 the table moves at 0.06 m/s: a ball that is to stay where it is turns below it.
    v = state.v.at[4].set(-0.06 / 0.05)
    start = jxr.State(jnp.append(state.q, 0.0), v, state.s)
    run = run_of((shaken, start), 3.0)
    t = np.asarray(run.ts)
    # x'' = 2/7 of the table's, from rest.
    expected = 2 / 7 * (0.02 * np.sin(3 * t) - 0.06 * t)
    assert np.abs(run.states.q[:, 0] - expected).max() <= 1e-9


def loop(sizes, t):
    waves = sizes * jnp.stack([-jnp.sin(t), jnp.cos(t), jnp.cos(2 * t), -jnp.sin(3 * t)])
    return waves[0] + waves[2], waves[1] + waves[3], 0.0


circle = jax.tree_util.Partial(loop, jnp.array([0.07, 0.07, 0.0, 0.0]))
smooth = jax.tree_util.Partial(loop, jnp.array([0.03, 0.02, 0.012, 0.009]))


@pytest.mark.parametrize("path", [circle, smooth], ids=["circle", "smooth"])
def test_holonomy_of_a_closed_path(path):
    at = (0.07, 0.0, 0.0) if path is circle else (0.0, 0.0, 0.0)
    options = {"at_tip": (0.0, 0.0, -0.1), "at_object": at}
    rolled = jxr.roll(jxr.Sphere(0.1), jxr.Plane(), path, jnp.linspace(0, 2 * np.pi, 3), **options)
    turned = closed.quaternion_matrix(np.asarray(rolled.pose[-1, 3:]))
    if path is circle:
        known = closed.rotation_along_arc(np.array([0.0, 1.0, 0.0]), 0.07, 2 * np.pi, 0.1)
    else:
        known = closed.rotation_along_curve(closed.smooth_loop_velocity, (0, 2 * np.pi), 0.1)
    assert abs(closed.rotation_angle(turned) - closed.rotation_angle(known)) <= 1e-10
    assert np.abs(turned - known).max() <= 1e-10
    np.testing.assert_allclose(rolled.at_object[-1], at, atol=1e-13)


def test_loci_of_a_rolling_ball_agree_in_length_but_not_in_curvature():
    r"""Before A-1 stands "the same curvature and torsion"; both loci share the geodesic curvature alone.

    A ball of radius $\rho$ led round a circle of radius $R$ on a table, without spin: its own locus is a
    circle of curvature $\sqrt{1/R^2 + 1/\rho^2}$, of which $1/R$ is geodesic; its arcs are as long
    as the table's.
    """
    R, rho, ts = 0.07, 0.1, np.array([0.0, 0.4, 0.8])
    options = {"at_tip": (0.0, 0.0, -rho), "at_object": (R, 0.0, 0.0)}
    rolled = jxr.roll(jxr.Sphere(rho), jxr.Plane(), circle, jnp.asarray(ts), **options)
    a, b, c = np.asarray(rolled.at_tip)
    sides = [np.linalg.norm(x - y) for x, y in ((a, b), (b, c), (c, a))]
    bent = 2.0 * np.linalg.norm(np.cross(b - a, c - a)) / np.prod(sides)
    np.testing.assert_allclose(bent, np.hypot(1.0 / R, 1.0 / rho), rtol=1e-9)
    np.testing.assert_allclose(sides[0], 2.0 / bent * np.sin(0.5 * bent * R * ts[1]), rtol=1e-9)


def test_loci_on_a_rocking_table_have_the_curvature_of_their_points():
    """What the table's acceleration adds to that of the loci, by a spline through the points of a run."""
    rocked, state = on_a_table(tilt=0.1)
    v = jnp.array([0.1, 0.05, 0.0, -1.0, 2.0, 0.0])  # it rolls on a table that does not move yet
    run = run_of((rocked, jxr.State(jnp.append(state.q, 0.0), v, state.s)), 1.0)
    found = jxr.loci(rocked, run)
    middle = slice(8, -8)
    for locus in (found.tip, found.object):
        curve = make_interp_spline(run.ts, np.asarray(locus.point[0]), k=9)
        d1, d2 = (curve(run.ts, k)[middle] for k in (1, 2))
        speed = np.linalg.norm(d1, axis=-1)
        bent = np.linalg.norm(np.cross(d1, d2), axis=-1) / speed**3
        np.testing.assert_allclose(locus.speed[0, middle], speed, rtol=1e-6)
        np.testing.assert_allclose(locus.curvature[0, middle], bent, rtol=1e-6)


def test_loci_that_begin_at_rest_have_derivatives_in_both_modes():
    """A ball on an incline sets off with a constant acceleration; at rest nothing curves."""
    grasp, state = jxr.scenes.incline()
    run = run_of((grasp, state), 0.3, rtol=1e-10, record=("multipliers",))

    def length(late):
        """Way and speed where all takes so many times as long, along which velocities grow as times do."""
        states = jxr.State(run.states.q, late * run.states.v, run.states.s)
        found = jxr.loci(grasp, dataclasses.replace(run, ts=late * run.ts, states=states))
        return found.tip.arclength[0, -1], found.tip.speed[0, -1]

    # Of programs as a whole: what the rest of the loci takes falls away.
    pair, slopes = jax.jit(lambda late: jax.jvp(length, (late,), (1.0,)))(1.0)
    np.testing.assert_allclose(pair[0], 0.5 * pair[1] * 0.3, rtol=1e-9)
    np.testing.assert_allclose(slopes, [2.0 * pair[0], pair[1]], rtol=1e-8)
    np.testing.assert_allclose(jax.jit(jax.grad(lambda late: length(late)[0]))(1.0), 2.0 * pair[0], rtol=1e-8)


class SetIn(eqx.Module):
    """A push that sets in at a time."""

    at: jax.Array

    @property
    def jumps(self):
        return self.at[None]

    def __call__(self, t, pose, twist):
        return jnp.array([0.3, 0.2, 0.0]) * jnp.where(t >= self.at, 1.0, 0.0), jnp.zeros(3)


def test_torsion_beside_a_jump_is_that_of_its_own_side():
    ball, state = jxr.scenes.turntable()
    states = jax.tree.map(lambda x: x[None], state)
    pushed = lambda at: ball.with_(load=SetIn(jnp.array(at)))  # noqa: E731
    torsion = lambda at: np.asarray(_loci(pushed(at), jnp.array([0.1]), states).object.torsion)[0, 0]  # noqa: E731
    after, before = torsion(-1.0), torsion(9.0)
    assert abs(after - before) > 0.1 * abs(after)
    np.testing.assert_allclose([torsion(0.1), torsion(0.0999)], after, rtol=1e-6)
    np.testing.assert_allclose([torsion(0.10001), torsion(0.10015)], before, rtol=1e-6)
    single = lambda x: jax.ShapeDtypeStruct(x.shape, np.float32)  # noqa: E731
    told = jax.eval_shape(_loci, *jax.tree.map(single, (pushed(0.1), jnp.array([0.1]), states)))
    assert {x.dtype for x in jax.tree.leaves(told)} == {np.dtype(np.float32)}


def test_a_straight_locus_has_no_torsion_and_hinders_no_derivative():
    """Along x over a plane at 0.1 m/s: nothing turns, and nothing that is not finite gets into a gradient."""
    ts, zero = np.linspace(0.0, 1.0, 5), np.zeros((5, 1, 3))
    ahead, up = zero + np.array([0.1, 0.0, 0.0]), zero + np.array([0.0, 0.0, 1.0])

    def length(velocity, point):
        locus = _locus(ts, _Jet(point, velocity, zero, zero, up, zero))
        bent = jnp.where(jnp.isfinite(locus.torsion), locus.torsion, 0.0)
        return locus.arclength[0, -1] + bent.sum(), locus

    differentiated = jax.jit(jax.value_and_grad(length, has_aux=True))
    (found, locus), slope = differentiated(ahead, ahead * ts[:, None, None])
    assert found == pytest.approx(0.1) and np.isnan(locus.torsion).all()
    np.testing.assert_allclose(np.asarray(slope)[:, 0, 0], [0.125, 0.25, 0.25, 0.25, 0.125], atol=1e-12)
    np.testing.assert_allclose(locus.curvature, 0.0)


@pytest.fixture(scope="module")
def rocking_rattleback():
    """A rattleback of three unlike axes that starts leant over, and its run with 201 times."""
    scene = jxr.scenes.rattleback(spin=2.0, tilt=0.3, axes=(0.05, 0.03, 0.04))
    return scene, run_of(scene, 0.25, ts=201, rtol=1e-11, record=("energy",))


def test_torsion_is_geodesic_torsion_and_the_turning_of_the_normal(rocking_rattleback):
    r"""$\tau = \tau_g + d\alpha/ds$, with the angle of the principal normal in the Darboux frame."""
    scene, run = rocking_rattleback
    locus = jxr.loci(scene[0], run).object
    angle = np.unwrap(np.arctan2(-locus.normal_curvature[0], locus.geodesic_curvature[0]))
    rate = make_interp_spline(run.ts, angle, k=7)(run.ts, 1) / np.asarray(locus.speed[0])
    middle = slice(40, -40)
    twist = np.asarray(locus.geodesic_torsion[0] + rate)[middle]
    assert np.abs(locus.geodesic_torsion[0]).max() > 1.0  # or its sign would not matter
    np.testing.assert_allclose(np.asarray(locus.torsion[0])[middle], twist, rtol=1e-4, atol=1e-3)


def test_a_locus_on_a_table_has_no_torsion_in_single_precision(rocking_rattleback):
    scene, run = rocking_rattleback
    ts, states = jax.tree.map(lambda x: x[::25], (run.ts, run.states))
    locus = in_single(jxr.loci, scene[0], dataclasses.replace(run, ts=ts, states=states)).tip
    assert locus.torsion.dtype == np.float32
    assert np.abs(locus.curvature).max() > 300.0
    np.testing.assert_allclose(locus.torsion, 0.0, atol=0.01)


def test_rolled_body_touches_where_it_says():
    """A-1: both points coincide, and the normals are opposite."""
    egg, bump = jxr.Ellipsoid(0.03, 0.02, 0.015), jxr.Sphere(0.05)
    rolled = jxr.roll(
        egg,
        bump,
        lambda t: (0.03 * jnp.cos(t), 0.02 * jnp.sin(2 * t), 0.01),
        jnp.linspace(0, 2, 9),
        at_tip=(0.0, 0.0, -0.015),
        at_object=(0.0, 0.0, 0.05),
        spin=lambda t: 0.5 * jnp.sin(t),
    )
    at = (egg, rolled.at_tip), (bump, rolled.at_object)
    found = [np.asarray(ask) for body, where in at for ask in (body.point(where), body.normal(where))]
    for pose, point, normal, there, outward in zip(np.asarray(rolled.pose), *found, strict=True):
        R = closed.quaternion_matrix(pose[3:])
        np.testing.assert_allclose(pose[:3] + R @ point, there, atol=1e-14)
        np.testing.assert_allclose(R @ normal, -outward, atol=1e-11)


@pytest.mark.slow
def test_loci_share_their_arclength_and_fit_their_points(turning):
    """A-2, and the curvatures of the loci of Fig. 20 from their points alone."""
    scene, _ = turning
    run = run_of(scene, 3.0, ts=601, rtol=1e-11)
    found = jxr.loci(scene[0], run)
    assert np.abs(found.tip.arclength - found.object.arclength).max() <= 1e-12
    # From the points alone, by a spline through them.
    for locus in (found.tip, found.object):
        curve = make_interp_spline(run.ts, np.asarray(locus.point[0]), k=9)
        speed = make_interp_spline(run.ts, np.linalg.norm(curve(run.ts, 1), axis=-1), k=9)
        assert abs(speed.antiderivative()(3.0) - float(locus.arclength[0, -1])) <= 1e-9
        middle = slice(50, -50)
        d1, d2, d3 = (curve(run.ts, k)[middle] for k in (1, 2, 3))
        cross = np.cross(d1, d2)
        bent = np.linalg.norm(cross, axis=-1) / np.linalg.norm(d1, axis=-1) ** 3
        np.testing.assert_allclose(locus.curvature[0, middle], bent, rtol=1e-6)
        twisted = np.sum(cross * d3, axis=-1) / np.sum(cross * cross, axis=-1)
        np.testing.assert_allclose(locus.torsion[0, middle], twisted, atol=1e-3)
    np.testing.assert_allclose(found.object.normal_curvature, 20.0, rtol=1e-12)  # the ball's
    np.testing.assert_allclose(found.tip.normal_curvature, 0.0, atol=1e-12)  # the table's


class Swinging(jxr.Stage):
    """A turntable on a joint: what it adds to a gap cannot be told from what the joint does."""

    @property
    def joints(self):
        return 1


def test_a_finger_has_joints_or_a_prescribed_motion():
    grasp, _ = jxr.scenes.incline()
    swinging = Swinging(jxr.Plane(), jxr.Turning(2.0))
    told = (
        r"argument fingers\[0\] must have no joints where its motion is prescribed, but was a Swinging with 1"
    )
    for made in (
        lambda: jxr.Grasp(grasp.object, swinging, grasp.contacts),
        lambda: grasp.with_(fingers=(swinging,)),
    ):
        with pytest.raises(ValueError, match=told):
            made()
    jxr.Grasp(grasp.object, Swinging(jxr.Plane()), grasp.contacts)  # it does not move by itself


def test_bad_input_is_told_in_one_sentence(scene):
    grasp, state = jxr.scenes.incline()
    with pytest.raises(ValueError, match="argument spin must be 'free' or 'prevented', but was 'fixed'"):
        jxr.Contact3(spin="fixed")
    with pytest.raises(ValueError, match="argument motion must be a function of time, but was 3.0"):
        jxr.Stage(jxr.Plane(), 3.0)
    with pytest.raises(ValueError, match="argument surfaces must be one or more surfaces"):
        jxr.FreeObject3(jxr.Circle(0.1), 1.0, 1.0)
    with pytest.raises(ValueError, match="argument inertia must be symmetric and positive definite"):
        jxr.FreeObject3(jxr.Sphere(0.1), 1.0, (1.0, -1.0, 1.0))
    with pytest.raises(ValueError, match="argument contacts.* must be between surfaces"):
        jxr.Grasp(grasp.object, jxr.Jaw(jxr.Line()), jxr.Contact3())
    with pytest.raises(ValueError, match="argument contacts must be all of the plane or all of space"):
        jxr.Grasp(grasp.object, grasp.fingers, (jxr.Contact(), jxr.Contact3()))
    with pytest.raises(ValueError, match="argument grasp must live in the plane"):
        jxr.simulate(grasp, state, t1=1.0, formulation=jxr.CSM())
    with pytest.raises(ValueError, match="argument grasp must live in the plane"):
        jxr.stability.equilibrium(grasp, state)
    with pytest.raises(ValueError, match=r"argument state.q must have shape \(7,\)"):
        jxr.simulate(grasp, jxr.State(state.q[:6], state.v, state.s), t1=1.0)
    with pytest.raises(ValueError, match="argument grasp must live in space"):
        jxr.loci(scene[0], None)


def ahead(way, t):
    return 0.0, way, 0.0


def flat(half):
    """A strip of the plane x = 0 so far to both sides along y [m], without ends along z."""
    return jxr.geometry.Extruded(jxr.Line((-half, half)))


@pytest.mark.parametrize("on_tip", [False, True])
def test_rolling_past_an_end_is_told(on_tip):
    """Of a strip of 0.1 m, from its middle on, over a longer one: nothing is known of it beyond.

    Of two planes the contact moves all the same.
    """
    pair = (flat(0.05), flat(0.5)) if on_tip else (flat(0.5), flat(0.05))

    def ended(way):
        # An array, since a number of Python's is a constant of the program.
        led, middle = jax.tree_util.Partial(ahead, jnp.asarray(way)), (0.0, 0.0)
        found = jxr.roll(*pair, led, np.linspace(0.0, 1.0, 3), at_tip=middle, at_object=middle)
        assert found.arclength[-1] == pytest.approx(way)
        return found.result

    assert ended(0.0499) == ended(0.05) == jxr.RESULTS.successful
    assert ended(0.0501) == ended(0.2) == jxr.RESULTS.contour_end


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"velocity": lambda: (0.1, 0.0, 0.0)}, "argument velocity must be a function of t, but was"),
        ({"spin": lambda t, y: 0.0}, "argument spin must be a function of t, but was"),
        (
            {"velocity": lambda t: (0.1, 0.0, 0.0) if t > 0 else (0.0, 0.0, 0.0)},
            "argument velocity must compute",
        ),
        ({"spin": lambda t: 1.0 if t > 0 else 0.0}, "argument spin must compute with jax.numpy"),
    ],
)
def test_functions_that_do_not_lead_a_rolling_body_are_refused_in_a_sentence(given, words):
    places = {"at_tip": (0.0, 0.0, -0.1), "at_object": (0.0, 0.0, 0.0)}
    asked = {"velocity": lambda t: (0.1, 0.0, 0.0), "ts": jnp.array([0.0, 1.0])} | places | given
    with pytest.raises(ValueError, match=words):
        jxr.roll(jxr.Sphere(0.1), jxr.Plane(), **asked)


def test_ball_leaves_a_table_that_falls_away():
    """The normal force runs out, and the run says when: the table drops faster than the ball may."""
    lowered, state = on_a_table(fall=2.0)
    start = jxr.State(jnp.append(state.q, 0.0), state.v, state.s)
    run = run_of((lowered, start), 2.0, throw=False)
    assert run.result == jxr.RESULTS.contact_lost
    assert float(run.stats.t_end) == pytest.approx(9.81 / 12, abs=1e-9)


def test_slipping_on_a_slope_that_is_too_steep():
    grasp, state = jxr.scenes.incline(slope=0.3)
    needed = 2 / 7 * np.tan(0.3)
    for share, code in ((1.01, jxr.RESULTS.successful), (0.99, jxr.RESULTS.slipping)):
        rubbing = grasp.with_contacts(jxr.Contact3(friction=share * needed))
        assert jxr.simulate(rubbing, state, t1=0.5, throw=False).result == code


def test_a_batch_of_balls_is_the_balls():
    grasp, state = jxr.scenes.incline()
    masses = jnp.array([0.1, 0.3, 0.5])

    def end(mass, **options):
        return run_of((grasp.with_(mass=mass), state), 0.5, rtol=1e-8, **options).last.q

    alone = [end(mass, record=("multipliers",)) for mass in masses]
    np.testing.assert_allclose(jax.vmap(end)(masses), alone, atol=1e-12)


def test_single_precision_turns_a_ball_that_faces_the_wrong_way():
    """Its normal is that of the table, but for an angle around the one that counts as none."""
    top, below = np.array([0.0, 0.0, 0.1]), np.zeros(3)
    angles = np.array([0.0, 1e-4, 5e-4, 1.3e-3, 2e-3, 0.1])
    turns = np.stack([np.cos(angles / 2), np.sin(angles / 2), 0 * angles, 0 * angles], axis=-1)

    def started(ball, table, turns, top, below):
        rolling = _Rolling(ball.prepared(), table.prepared(), None, None)
        return jax.vmap(lambda turn: rolling.start(turn, top, below))(turns)

    found = in_single(jax.jit(started), jxr.Sphere(0.1), jxr.Plane(), turns, top, below)
    assert found.dtype == jnp.float32
    w, x, y, z = np.moveaxis(np.asarray(found[:, :4], float), -1, 0)
    # The ball's normal there, up in its own axes, must point down.
    np.testing.assert_allclose(np.stack([2 * (x * z + w * y), 2 * (y * z - w * x)]), 0.0, atol=2e-6)
    np.testing.assert_allclose(w * w - x * x - y * y + z * z, -1.0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-8, 1e-4])
@pytest.mark.parametrize("scene", ["rattleback", "turntable", "incline"])
def test_returns_to_the_constraints_leave_rounding(scene, rtol):
    """Up to the default tolerance a step returns once, else twice; balls on planes take the longest steps."""
    assert off(run_of(getattr(jxr.scenes, scene)(), 2.0, ts=300, rtol=rtol)) <= 1e-14


def rolled(x, fixed):
    """Pose, place and arclength of an ellipsoid at the end of a path, in 11 numbers.

    It is led and spun by functions that close over `x`: a half axis, where it starts, and how its velocity
    rises, begins, and how fast it spins.
    """
    (half, start, hastening, begins, rate), (halves, sway, t1) = x, fixed
    still = jnp.zeros(2)
    led = lambda t: (begins + hastening * t, sway * jnp.sin(5.0 * t), 0.0)  # noqa: E731
    places = {"at_tip": jnp.append(still, -halves[1]), "at_object": jnp.append(start, still)}
    ball = jxr.Ellipsoid(half, halves[0], halves[1])
    path = jxr.roll(ball, jxr.Plane(), led, jnp.stack([0.0 * t1, t1]), spin=lambda t: rate, **places)
    return jnp.concatenate([path.pose[-1], path.at_tip[-1], path.arclength[-1:]])


# One program each for all paths: of all numbers along one way, and of a sum of the numbers with weights.
along = jax.jit(lambda x, way, fixed: jax.jvp(lambda x: rolled(x, fixed), (x,), (way,)))
backwards = jax.jit(jax.grad(lambda x, weights, fixed: weights @ rolled(x, fixed)))


def forwards(x, way, fixed):
    """The numbers of `rolled`, and their derivatives."""
    return map(np.asarray, along(x, way, fixed))


def test_a_path_has_derivatives_in_both_modes():
    """In a half axis of the rolling ellipsoid and in where it starts: both modes, and differences."""
    weights = np.array([1.0] * 7 + [10.0] * 3 + [3.0])
    fixed = (jnp.array([0.02, 0.015]), 0.05, 0.3)
    x, h = np.array([0.02, 0.001, 0.02, 0.1, 0.4]), 1e-5
    for way, found in zip(np.eye(5)[:2], np.asarray(backwards(x, weights, fixed))[:2], strict=True):
        _, slopes = forwards(x, way, fixed)
        assert weights @ slopes == pytest.approx(found, rel=1e-10)
        ends = [next(forwards(x + k * h * way, way, fixed)) for k in (-2, -1, 1, 2)]
        near = np.stack(ends) @ weights
        wanted = np.dot(near, [1.0, -8.0, 8.0, -1.0]) / (12.0 * h)
        assert found == pytest.approx(wanted, rel=1e-8)


def test_gradients_of_a_path_that_begins_at_rest():
    """A ball led by k t from rest is k / 2 away at t = 1, and so is its path long."""
    x, fixed = np.array([0.1, 0.0, 0.3, 0.0, 0.0]), (jnp.array([0.1, 0.1]), 0.0, 1.0)
    _, ahead = forwards(x, np.eye(5)[2], fixed)
    for row in (0, -1):
        slopes = ahead[row], backwards(x, np.eye(11)[row], fixed)[2]
        np.testing.assert_allclose(slopes, 0.5, atol=1e-9)


def test_spin_about_the_normal_is_counter_clockwise():
    x, fixed = np.array([0.1, 0.0, 0.0, 0.0, 0.7]), (jnp.array([0.1, 0.1]), 0.0, 1.0)
    half = np.array([np.cos(0.35), 0.0, 0.0, np.sin(0.35)])
    end, _ = forwards(x, np.eye(5)[4], fixed)
    np.testing.assert_allclose(end[3:7], half, atol=1e-12)


def test_numbers_that_a_velocity_or_a_spin_closes_over_have_their_derivatives():
    """A ball led straight while it spins turns about one axis at one rate, as far as both say."""
    radius, t1 = 0.1, 0.8

    def known(given):
        """Rolling by x turns the ball by x / r about y, spinning by its rate about z: a constant vector."""
        speed, rate = given
        spin = jnp.array([0.0, speed / radius, rate])
        size = jnp.linalg.norm(spin)
        half = 0.5 * t1 * size
        turn = jnp.concatenate([jnp.cos(half)[None], jnp.sin(half) * spin / size])
        return jnp.concatenate([jnp.array([speed * t1, 0.0, radius]), turn, speed[None] * t1])

    there = [*range(7), 10]  # all but the place on the ball
    x, fixed = np.array([radius, 0.0, 0.0, 0.1, 0.7]), (jnp.array([radius, radius]), 0.0, t1)
    ends, wanted = map(np.asarray, jax.jit(lambda given: (known(given), jax.jacfwd(known)(given)))(x[3:]))
    for way, column in zip(np.eye(5)[3:], wanted.T, strict=True):
        end, slopes = forwards(x, way, fixed)
        np.testing.assert_allclose(end[there], ends, rtol=0, atol=1e-8)
        np.testing.assert_allclose(slopes[there], column, rtol=0, atol=1e-8)
    slopes = np.stack([backwards(x, weights, fixed) for weights in np.eye(11)[there]])
    np.testing.assert_allclose(slopes[:, 3:], wanted, rtol=0, atol=1e-8)


locus_of = jax.jit(_locus)
PHASE, RATE, CHANGE = 0.3, 2.0, 1.5  # of an angle that does not rise evenly


def jets(curve, normal, bend):
    """Jets of a locus given over an angle by its point and three derivatives, normal and shape operator."""
    ts = np.linspace(0.0, 0.6, 4)
    angle, rate = PHASE + RATE * ts + 0.5 * CHANGE * ts**2, RATE + CHANGE * ts
    point, first, second, third = (np.array(x).T for x in curve(angle))
    rate = rate[:, None]
    velocity = first * rate
    acceleration = second * rate**2 + first * CHANGE
    jerk = third * rate**3 + 3.0 * second * rate * CHANGE
    parts = (point, velocity, acceleration, jerk, np.array(normal(angle)).T, bend(velocity))
    return ts, angle, rate[:, 0], _Jet(*(jnp.asarray(part)[:, None] for part in parts))


def test_a_helix_on_a_cylinder_has_its_known_curvatures_and_torsions():
    """A geodesic: all that it bends it bends with the surface; both torsions are one."""
    radius, climb = 0.03, 0.01

    def curve(u):
        c, s, one = np.cos(u), np.sin(u), np.ones_like(u)
        yield radius * c, radius * s, climb * u
        yield -radius * s, radius * c, climb * one
        yield -radius * c, -radius * s, 0.0 * one
        yield radius * s, -radius * c, 0.0 * one

    ts, angle, rate, jet = jets(
        curve, lambda u: (np.cos(u), np.sin(u), 0.0 * u), lambda v: v * [1.0, 1.0, 0.0] / radius
    )
    found, squared = locus_of(jnp.asarray(ts), jet), radius**2 + climb**2
    np.testing.assert_allclose(found.speed[0], rate * np.sqrt(squared), rtol=1e-12)
    np.testing.assert_allclose(found.arclength[0], (angle - angle[0]) * np.sqrt(squared), rtol=1e-12)
    np.testing.assert_allclose(found.normal_curvature[0], radius / squared, rtol=1e-12)
    np.testing.assert_allclose(found.geodesic_curvature[0], 0.0, atol=1e-10)
    np.testing.assert_allclose(found.curvature[0], radius / squared, rtol=1e-12)
    np.testing.assert_allclose(found.geodesic_torsion[0], climb / squared, rtol=1e-12)
    np.testing.assert_allclose(found.torsion[0], climb / squared, rtol=1e-12)


def test_a_circle_of_latitude_has_its_known_curvatures():
    """On a sphere, 0.7 rad from the pole, passed eastwards: it turns to the left of its way."""
    radius, polar = 0.05, 0.7
    across, up = radius * np.sin(polar), radius * np.cos(polar)

    def curve(u):
        c, s, none = np.cos(u), np.sin(u), np.zeros_like(u)
        yield across * c, across * s, up + none
        yield -across * s, across * c, none
        yield -across * c, -across * s, none
        yield across * s, -across * c, none

    normal = lambda u: (  # noqa: E731
        np.sin(polar) * np.cos(u),
        np.sin(polar) * np.sin(u),
        np.cos(polar) + 0.0 * u,
    )
    ts, angle, rate, jet = jets(curve, normal, lambda v: v / radius)
    found = locus_of(jnp.asarray(ts), jet)
    np.testing.assert_allclose(found.normal_curvature[0], 1.0 / radius, rtol=1e-12)
    np.testing.assert_allclose(found.geodesic_curvature[0], 1.0 / (radius * np.tan(polar)), rtol=1e-12)
    np.testing.assert_allclose(found.curvature[0], 1.0 / across, rtol=1e-12)
    for none in (found.geodesic_torsion, found.torsion):
        np.testing.assert_allclose(none[0], 0.0, atol=1e-10)
    np.testing.assert_allclose(found.arclength[0], across * (angle - angle[0]), rtol=1e-12)
