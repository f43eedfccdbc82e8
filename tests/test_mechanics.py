"""Equations of motion against independent forms: Lagrangian autodiff, dense KKT, the chapter."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxroll as jxr
from jaxroll._linalg import Vec3
from jaxroll._linalg._space import Pose3, quaternion_of, Sym3
from jaxroll._mechanics import join, to_leaves
from jaxroll._motion import bodies, Index1
from jaxroll._motion._equations import evaluate
from jaxroll.contact._contact3 import compliance, Touch3
from jaxroll.geometry import Gauss3
from tests.helpers import broadcasting
from tests.oracles.chapter_part2 import Part2

GRAVITY = (0.3, -9.81)
RNG = np.random.default_rng(7)


def two_fingers(gravity=None):
    """A free object between a 3-joint and a 2-joint finger; states need not touch."""
    left = jxr.Finger([0.05, 0.04, 0.03], [0.05, 0.04, 0.03], tip=jxr.Circle(0.008), base=(-0.05, 0.0))
    right = jxr.Finger(
        [0.06, 0.05],
        [0.05, 0.04],
        tip=jxr.Catenary(0.02).moved((0.004, 0.0), 0.3),
        base=(0.06, 0.01),
        centres=[0.02, 0.03],
        inertias=[2e-5, 1e-5],
    )
    body = jxr.FreeObject((jxr.Circle(0.03), jxr.Catenary(0.05)), mass=0.04, inertia=1.2e-5)
    contacts = (
        jxr.Contact(0.001, 0.05, finger=0),
        jxr.Contact(-0.002, 0.002, finger=1, contour=1, sense=-1),
    )
    return jxr.Grasp(body, (left, right), contacts, gravity=gravity)


def one_finger(gravity=None):
    finger = jxr.Finger([0.065, 0.065], [0.045, 0.040], tip=jxr.Catenary(0.025))
    body = jxr.PivotedObject(jxr.Catenary(0.01), 6e-6, pivot=(0.05, 0.08), mass=0.02, centre=(0.004, -0.002))
    return jxr.Grasp(body, finger, jxr.Contact(), gravity=gravity)


def random_state(grasp, seed):
    rng = np.random.default_rng(seed)
    n, c = grasp.coordinates, len(grasp.contacts)
    draw = lambda k, size: jnp.asarray(rng.uniform(-size, size, k))  # noqa: E731
    return jxr.State(draw(n, 1.5), draw(n, 3.0), draw(c, 0.004))


@broadcasting
def finger_energy(finger, q, v, gravity):
    """Kinetic and potential energy, written from positions of the links alone."""

    def centres(q):
        angles = jnp.cumsum(q)
        along = jnp.stack([jnp.cos(angles), jnp.sin(angles)], -1)
        ends = finger.base + jnp.cumsum(along * finger.lengths[:, None], axis=0)
        return jnp.concatenate([finger.base[None], ends[:-1]]) + along * finger.centres[:, None]

    points, rates = jax.jvp(centres, (q,), (v,))
    spins = jnp.cumsum(v)
    kinetic = 0.5 * jnp.sum(finger.masses * jnp.sum(rates**2, -1) + finger.inertias * spins**2)
    return kinetic, -jnp.sum(finger.masses[:, None] * points * jnp.asarray(gravity))


def lagrangian(grasp, q, v, gravity):
    """L = K - P of the whole grasp without constraints."""
    free = grasp.object.freedoms == 3
    if free:
        body = grasp.object
        kinetic = 0.5 * (body.mass * (v[0] ** 2 + v[1] ** 2) + body.inertia * v[2] ** 2)
        potential = -body.mass * (q[:2] @ jnp.asarray(gravity))
    else:
        body = grasp.object
        w = body.weight_moment
        turned = jnp.array(
            [
                jnp.cos(q[0]) * w[0] - jnp.sin(q[0]) * w[1],
                jnp.sin(q[0]) * w[0] + jnp.cos(q[0]) * w[1],
            ]
        )
        kinetic, potential = 0.5 * body.inertia * v[0] ** 2, -turned @ jnp.asarray(gravity)
    at = grasp.object.freedoms
    for finger in grasp.fingers:
        k = finger.joints
        more, fall = finger_energy(finger, q[at : at + k], v[at : at + k], gravity)
        kinetic, potential, at = kinetic + more, potential + fall, at + k
    return kinetic - potential


@jax.jit
def lagrange_terms(grasp, state, gravity):
    """M and h of M v' + h = u, by autodiff of the Lagrangian."""
    L = lambda q, v: lagrangian(grasp, q, v, gravity)  # noqa: E731
    mass = jax.jacfwd(jax.grad(L, 1), 1)(state.q, state.v)
    mixed = jax.jacfwd(jax.grad(L, 1), 0)(state.q, state.v)
    return mass, mixed @ state.v - jax.grad(L, 0)(state.q, state.v)


@pytest.mark.parametrize("make", [two_fingers, one_finger])
@pytest.mark.parametrize("gravity", [None, GRAVITY])
def test_mass_matrix_and_bias_against_the_lagrangian(make, gravity):
    grasp = make(gravity)
    for seed in range(4):
        state = random_state(grasp, seed)
        terms = jxr.equation_terms(grasp, state)
        mass, bias = lagrange_terms(grasp, state, gravity or (0.0, 0.0))
        np.testing.assert_allclose(terms.mass, mass, rtol=1e-12, atol=1e-18)
        np.testing.assert_allclose(terms.bias, bias, rtol=1e-11, atol=1e-16)


@broadcasting
def world_gaps(grasp, q, s):
    """Gap vectors from arrays alone; frozen contact coordinates."""
    at, tips = grasp.object.freedoms, []
    for finger in grasp.fingers:
        angles = jnp.cumsum(q[at : at + finger.joints])
        along = jnp.stack([jnp.cos(angles), jnp.sin(angles)], -1)
        tips.append((finger.base + jnp.sum(along * finger.lengths[:, None], 0), angles[-1]))
        at += finger.joints
    origin, angle = (q[:2], q[2]) if grasp.object.freedoms == 3 else (grasp.object.pivot, q[0])
    turn = lambda a: jnp.array([[jnp.cos(a), -jnp.sin(a)], [jnp.sin(a), jnp.cos(a)]])  # noqa: E731
    gaps = []
    for i, contact in enumerate(grasp.contacts):
        tip, face = grasp.shapes(contact)
        r, phi = tips[contact.finger]
        on_tip = r + turn(phi) @ tip.point(contact.s_tip + s[i])
        gaps.append(on_tip - origin - turn(angle) @ face.point(contact.s_object - s[i]))
    return jnp.stack(gaps)


def test_accelerations_against_a_dense_kkt_solve():
    """Rows and bias by autodiff of the gap in q, the saddle-point system by NumPy."""
    grasp = two_fingers(GRAVITY)
    ready = grasp.prepared()

    @jax.jit
    def ours(state):
        instant = evaluate(ready, 0.0, to_leaves(state, grasp.form), Index1())
        return join(instant.rates.v), jnp.stack(instant.rates.s), instant.forces

    @jax.jit
    def parts(state, s_rate):
        gap_rate = lambda q, s: jax.jacfwd(lambda p: world_gaps(grasp, p, s))(q) @ state.v  # noqa: E731
        rows = jax.jacfwd(lambda p: world_gaps(grasp, p, state.s))(state.q)
        _, bias = jax.jvp(gap_rate, (state.q, state.s), (state.v, s_rate))
        return rows.reshape(-1, grasp.coordinates), bias.reshape(-1)

    for seed in range(3):
        state = random_state(grasp, seed)
        v_rate, s_rate, forces = ours(state)
        rows, bias = parts(state, s_rate)
        mass, h = lagrange_terms(grasp, state, GRAVITY)
        m = rows.shape[0]
        kkt = np.block([[np.asarray(mass), -np.asarray(rows).T], [rows, np.zeros((m, m))]])
        answer = np.linalg.solve(kkt, np.concatenate([-h, -bias]))
        scale = np.abs(answer[: grasp.coordinates]).max()
        np.testing.assert_allclose(v_rate / scale, answer[: grasp.coordinates] / scale, atol=1e-11)
        flat = np.concatenate([np.asarray(f) for f in forces])
        size = np.abs(flat).max()
        np.testing.assert_allclose(flat / size, answer[grasp.coordinates :] / size, atol=1e-11)


def test_constraint_gradients_are_the_coefficients_of_73_and_74():
    """Random tangent states, to 1e-12; the chapter's quantities from its own formulas."""
    grasp, _ = jxr.scenes.pivoted()
    chapter = Part2()
    printed = jax.jit(lambda s: (chapter.angles(s), chapter.lengths(s)))
    for seed in range(8):
        rng = np.random.default_rng(seed)
        s, theta, q1 = rng.uniform(-0.01, 0.01), rng.uniform(-2, 2), rng.uniform(-2, 2)
        (theta1, psi0), (l_b0, l_b1, l_n0, l_n1) = jax.tree.map(float, printed(s))
        phi = float(theta1 - psi0 + np.pi / 2)  # tangency, nothing else
        q = np.array([theta, q1, phi + theta - q1])
        start = float(grasp.contacts[0].s_object)
        state = jxr.State(jnp.asarray(q), jnp.zeros(3), jnp.array([start - s]))
        terms = jxr.equation_terms(grasp, state)
        angle = theta + theta1
        n1, b1 = np.array([np.cos(angle), -np.sin(angle)]), np.array([np.sin(angle), np.cos(angle)])
        p = q[1] + q[2]
        link = lambda a: np.array([-np.sin(a), -np.cos(a)]) * 0.065  # noqa: E731
        jacobian = np.stack([link(q[1]) + link(p), link(p)], -1)  # clockwise angles
        normal = np.concatenate([[l_b1], jacobian.T @ n1 + l_b0])
        tangential = np.concatenate([[-l_n1], jacobian.T @ b1 - l_n0])
        np.testing.assert_allclose(terms.normal[0], normal, rtol=0, atol=1e-12)
        np.testing.assert_allclose(terms.tangential[0], tangential, rtol=0, atol=1e-12)


def test_object_mass_follows_newton_where_nothing_holds_it():
    """Equation (1): M x'' = f n0 + lambda b0 + M g, on the free object."""
    grasp = two_fingers(GRAVITY)
    state = random_state(grasp, 3)
    ready = grasp.prepared()
    instant = evaluate(ready, 0.0, to_leaves(state, grasp.form), Index1())
    force = -sum(np.asarray(f) for f in instant.forces)
    rates = np.asarray(jnp.stack(instant.rates.v[0][:2]))
    expected = force / 0.04 + np.asarray(GRAVITY)
    np.testing.assert_allclose(rates, expected, rtol=1e-9)


def links_one_by_one(finger, q, v):
    """Tip pose, its twist and acceleration, and of every link m, I, centre, w, w', a, and both Jacobians."""
    at, turn = np.asarray(finger.base), Rotation.from_quat(np.array(finger.rotation)[[1, 2, 3, 0]])
    joints, axes, links = [], [], []
    spin, bend, rate, pull = (np.zeros(3) for _ in range(4))
    given = map(np.array, (finger.axes, finger.offsets, finger.centres, finger.inertias, finger.masses))
    for i, (axis, offset, centre, inertia, mass) in enumerate(zip(*given, strict=True)):
        joints.append(at)
        axes.append(turn.apply(axis))
        turn = turn * Rotation.from_rotvec(axis * q[i])
        bend = bend + np.cross(spin, axes[-1] * v[i])
        spin = spin + axes[-1] * v[i]

        def moved(arm, spin=spin, bend=bend):
            return np.cross(bend, arm) + np.cross(spin, np.cross(spin, arm))

        arm, reach = turn.apply(centre), turn.apply(offset)
        turning = np.array([*axes, *np.zeros((len(q) - i - 1, 3))])
        moving = np.array([np.cross(a, at + arm - p) for a, p in zip(axes, joints, strict=True)])
        moving = np.concatenate([moving, np.zeros((len(q) - i - 1, 3))])
        tensor = turn.as_matrix() @ inertia @ turn.as_matrix().T
        links.append((mass, tensor, at + arm, spin, bend, pull + moved(arm), turning, moving))
        rate, pull, at = rate + np.cross(spin, reach), pull + moved(reach), at + reach
    return (at, turn.as_matrix()), (rate, spin), (pull, bend), links


@pytest.mark.parametrize("gravity", [None, (1.0, -2.0, -9.0)])
def test_a_finger_in_space_is_its_links_one_by_one(gravity):
    r"""Pose, twist, acceleration, M and h by Kane's equations of single links, about their own centres."""
    rng = np.random.default_rng(5)
    turns = np.linalg.qr(rng.normal(size=(3, 3, 3)))[0]
    finger = jxr.Finger3(
        axes=rng.normal(size=(3, 3)),
        offsets=0.05 * rng.normal(size=(3, 3)),
        masses=[0.05, 0.03, 0.02],
        centres=0.03 * rng.normal(size=(3, 3)),
        inertias=np.einsum("kij,j,klj->kil", turns, [1e-5, 4e-5, 6e-5], turns),
        tip=jxr.Sphere(0.01),
        base=rng.normal(size=3),
        rotation=rng.normal(size=4),
    )
    q, v = rng.normal(size=3), rng.normal(size=3)
    field = None if gravity is None else Vec3(*map(jnp.asarray, gravity))
    motion, inertia = finger.motion(tuple(map(jnp.asarray, q)), tuple(map(jnp.asarray, v)), field)
    (at, turn), twist, bias, links = links_one_by_one(finger, q, v)
    pose = motion.pose
    near = lambda found, wanted: np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-15)  # noqa: E731
    near(pose.origin.array(), at)
    near(np.stack([pose.x.array(), pose.y.array(), pose.z.array()], axis=-1), turn)
    near([motion.twist.velocity.array(), motion.twist.spin.array()], twist)
    near([motion.bias.velocity.array(), motion.bias.spin.array()], bias)
    units = np.array([[u.velocity.array(), u.spin.array()] for u in motion.unit_twists])
    near(np.einsum("i,ijk->jk", v, units), twist)
    pulled = np.zeros(3) if gravity is None else np.array(gravity)
    mass, force = np.zeros((3, 3)), np.zeros(3)
    for m, tensor, _, spin, bend, pull, turning, moving in links:
        mass += m * moving @ moving.T + turning @ tensor @ turning.T
        force += m * moving @ (pull - pulled) + turning @ (tensor @ bend + np.cross(spin, tensor @ spin))
    near([x for row in inertia.mass for x in row], mass[np.tril_indices(3)])
    near(inertia.force, force)
    if field is not None:
        potential = -sum(m * centre @ pulled for m, _, centre, *_ in links)
        near(finger.gravity_potential(tuple(map(jnp.asarray, q)), field), potential)
    near(finger.prepared().size, np.linalg.norm(finger.offsets, axis=1).mean())
    # A step along a gradient may have changed lengths that are one.
    longer = (2.0 * finger.axes, 3.0 * finger.rotation)
    scaled = eqx.tree_at(lambda f: (f.axes, f.rotation), finger, longer)
    again, _ = scaled.motion(tuple(map(jnp.asarray, q)), tuple(map(jnp.asarray, v)), field)
    near([again.twist.velocity.array(), again.twist.spin.array()], twist)


def test_equation_terms_in_space_are_rates_of_the_contact_and_balance():
    """Gradients against twists of single links; and with forces, torques and accelerations the equations."""

    @jax.jit
    def asked(grasp, state):
        """In one program, in which XLA sees that the equations are the same."""
        given = grasp, 0.0, state
        return (
            jxr.equation_terms(grasp, state),
            jxr.multipliers(*given),
            jxr.accelerations(*given),
            jxr.torques(*given),
        )

    rng = np.random.default_rng(6)
    finger = jxr.Finger3(
        rng.normal(size=(2, 3)), 0.05 * rng.normal(size=(2, 3)), [0.05, 0.03], jxr.Sphere(0.01)
    )
    grasp = jxr.Grasp(
        jxr.FreeObject3(jxr.Sphere(0.02), mass=0.05, inertia=[1e-5, 2e-5, 3e-5]),
        [finger, jxr.Stage(jxr.Plane())],
        [jxr.Contact3(0, 0, spin="prevented"), jxr.Contact3(1, 0)],
        controller=jxr.control.Press(0.5, 0.01, 0.006, target=(0.0, 0.1, 0.2)),
        gravity=(1.0, -2.0, -9.0),
    )
    ways = rng.normal(size=(3, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    q = np.concatenate([rng.normal(size=3), turn := rng.normal(size=4), rng.normal(size=2)])
    q[3:7] = turn / np.linalg.norm(turn)
    places = [0.01 * ways[0], 0.02 * ways[1], grasp.fingers[1].tip.near(ways[0]), 0.02 * ways[2]]
    v = rng.normal(size=8)
    state = jxr.State(jnp.asarray(q), jnp.asarray(v), jnp.asarray(np.concatenate(places)))
    terms, forces, change, drive = asked(grasp, state)
    # The rate of the gap of the first contact, from the twists of both bodies.
    (at, axes), (rate, spin), _, _ = links_one_by_one(finger, q[7:], v[6:])
    body = Rotation.from_quat(q[[4, 5, 6, 3]])
    turning, n = body.apply(v[3:6]), body.apply(ways[1])
    closing = rate + np.cross(spin, axes @ places[0]) - v[:3] - np.cross(turning, 0.02 * n)
    near = lambda found, wanted: np.testing.assert_allclose(found, wanted, rtol=1e-11, atol=1e-13)  # noqa: E731
    near(terms.normal[0] @ v, -n @ closing)
    near(terms.tangential[0] @ v, closing - n * (n @ closing))
    near(terms.spin[0] @ v, n @ (spin - turning))
    near(terms.spin[1], 0.0)
    # M v' + h + f Q + lambda R + tau S = u.
    assert float(abs(forces.spin[0])) > 1e-4 and float(forces.spin[1]) == 0.0
    pushed = forces.f @ terms.normal + np.einsum("ci,cin->n", forces.lam, terms.tangential)
    left = terms.mass @ change + terms.bias + pushed
    left += forces.spin @ terms.spin
    driven = np.concatenate([np.zeros(6), drive[0]])
    np.testing.assert_allclose(left, driven, atol=1e-10 * np.abs(np.asarray(pushed)).max())


def test_bias_of_a_finger_in_space_is_that_of_its_mass_matrix():
    r"""Lagrange's: $h = \dot M v - \frac12 \partial_q (v^T M v)$, links with three unlike moments."""
    rng = np.random.default_rng(4)
    turns = np.linalg.qr(rng.normal(size=(3, 3, 3)))[0]
    inertias = np.einsum("kij,j,klj->kil", turns, [1e-5, 4e-5, 6e-5], turns)
    finger = jxr.Finger3(
        axes=rng.normal(size=(3, 3)),
        offsets=0.05 * rng.normal(size=(3, 3)),
        masses=[0.05, 0.03, 0.02],
        centres=0.03 * rng.normal(size=(3, 3)),
        inertias=inertias,
        tip=jxr.Sphere(0.01),
    )
    body = jxr.FreeObject3(jxr.Sphere(0.02), mass=0.05, inertia=1e-5)
    grasp = jxr.Grasp(body, finger, jxr.Contact3(0, 0))
    at, rates = jnp.asarray(rng.normal(size=3)), jnp.asarray(rng.normal(size=3))

    def terms(q, v):
        whole = jnp.concatenate([jnp.zeros(3), jnp.array([1.0, 0, 0, 0]), q])
        state = jxr.State(whole, jnp.concatenate([jnp.zeros(6), v]), jnp.array([0, 0, -0.01, 0, 0, 0.02]))
        inertia = bodies(grasp, to_leaves(state, grasp.form))[1][1]
        lower = [[jnp.asarray(x) for x in row] for row in inertia.mass]
        mass = jnp.stack([jnp.stack([lower[max(i, j)][min(i, j)] for j in range(3)]) for i in range(3)])
        return mass, -jnp.stack(inertia.force)

    # The derivative of the mass matrix, and the bias beside it.
    both = jax.jit(jax.jacfwd(terms, has_aux=True))
    (slope, bias), (_, at_rest) = both(at, rates), both(at, 0 * rates)
    bias = bias - at_rest
    wanted = np.einsum("ijk,k,j->i", slope, rates, rates)
    wanted -= 0.5 * np.einsum("ijk,i,j->k", slope, rates, rates)
    np.testing.assert_allclose(np.abs(bias), np.abs(wanted), rtol=1e-10)
    assert np.abs(wanted).min() > 1e-6


def test_a_finger_in_space_begins_at_the_origin_unless_told_otherwise():
    """At zero angles its joints lie at the sums of its offsets, in the world's axes."""
    offsets = np.array([[0.01, 0.06, -0.02], [0.03, -0.01, 0.05]])
    for base in (np.zeros(3), np.array([0.02, -0.03, 0.04])):
        given = {"base": base} if base.any() else {}
        finger = jxr.Finger3([(1, 0, 0), (0, 0, 1)], offsets, [0.04, 0.03], jxr.Sphere(0.01), **given)
        points = [[float(x) for x in point] for point in finger.skeleton((jnp.zeros(()), jnp.zeros(())))]
        wanted = base + np.concatenate([np.zeros((1, 3)), np.cumsum(offsets, axis=0)])
        np.testing.assert_allclose(points, wanted, atol=1e-16)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, -0.48, 0.64)])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 2.0, 3.1, np.pi])
def test_the_quaternion_of_every_turn_against_scipy(axis, angle):
    turn = Rotation.from_rotvec(angle * np.array(axis))
    frame = Pose3(*(Vec3(*column) for column in ([0.0, 0.0, 0.0], *turn.as_matrix().T)))
    found, expected = np.array(quaternion_of(frame)), turn.as_quat(scalar_first=True)
    assert found[0] >= 0.0
    if angle == np.pi:  # the two quaternions of half a turn differ in sign alone, which rounding decides
        expected = expected * np.sign(expected @ found)
    np.testing.assert_allclose(found, expected, atol=1e-15)


def test_a_common_generator_has_its_curvature_across_alone():
    """A roll of 20 mm along the world's x on another of 30 mm, which lies along its own z, turned about y.

    The normals meet along z. Across, along y, the curvatures 1/R add up; the tilt there is all that counts.
    """
    zero, one = jnp.zeros(()), jnp.ones(())
    up, down = Vec3(zero, zero, one), Vec3(zero, zero, -one)
    still = Pose3(Vec3(zero, zero, zero), Vec3(one, zero, zero), Vec3(zero, one, zero), up)
    bent = lambda k: Sym3(zero, zero, zero, k * one, zero, zero)  # noqa: E731
    point = Vec3(zero, zero, zero)
    lower = Gauss3(point, up, bent(1.0 / 0.03))
    # The upper roll in its own axes, which are the world's turned by a quarter about y: x is the world's -z.
    quarter = Pose3(point, down, Vec3(zero, one, zero), Vec3(one, zero, zero))
    upper = Gauss3(point, Vec3(one, zero, zero), bent(1.0 / 0.02))
    touch, poses = Touch3(upper, lower), (quarter, still)
    found = compliance(poses, touch, True)
    wanted = 1.0 / (1.0 / 0.02 + 1.0 / 0.03)
    parts = [float(x) for x in (found.xx, found.xy, found.xz, found.yy, found.yz, found.zz)]
    np.testing.assert_allclose(parts, [0, 0, 0, wanted, 0, 0], atol=1e-12)
    contact = jxr.Contact3(line=True)
    assert contact.equation_names()[-1] == "tangency [rad]" and len(contact.equation_names()) == 4
    np.testing.assert_allclose(contact.equations(poses, touch), np.zeros(4), atol=1e-15)
    for angle in (0.1, -0.4):
        c, s = np.cos(angle), np.sin(angle)
        tilted = Vec3(one * 0.0, one * s, -one * c)  # the upper normal turned about x
        leant = Pose3(point, tilted, Vec3(zero, one * c, one * s), Vec3(one, zero, zero))
        *_, tilt = contact.equations((leant, still), touch)
        # The sum of the normals, along the image of L_A + L_B, where the upper L is turned about x.
        across = np.array([50.0 * c * c + 1e3 / 30.0, 50.0 * c * s])
        both = 2.0 / (1.0 + c) * np.array([s, 1.0 - c])
        assert float(tilt) == pytest.approx(both @ across / np.linalg.norm(across))
        assert abs(float(tilt)) == pytest.approx(2.0 * np.tan(abs(angle) / 2.0), rel=0.03)
        ahead, out = Vec3(one * c, zero, one * s), Vec3(one * s, zero, -one * c)
        rocked = Pose3(point, out, Vec3(zero, one, zero), ahead)
        *_, tilt = contact.equations((rocked, still), touch)  # about y: along the generator nothing counts
        assert abs(float(tilt)) < 1e-12
    margin = contact.curvature_margin(None, None, poses, touch)
    assert float(margin) == pytest.approx((50.0 + 1e3 / 30.0) / np.hypot(50.0, 1e3 / 30.0))
