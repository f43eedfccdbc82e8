"""The spatial oracle against what it shares nothing with: the chapter's plane, closed forms, energy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from tests.oracles import closed_forms_space as cf, reference_space as ref
from tests.oracles.chapter_part1 import Links, Part1, planar_rotation, SIGNS

G = 9.81
SPREAD = np.random.default_rng(0).normal(size=(4000, 3))  # directions
GRASPS = {"cuboid": ref.pinch3d, "ellipsoids": ref.pinch3d_ellipsoids, "tripod": ref.tripod3d}
PINCHES = {name: GRASPS[name] for name in ("cuboid", "ellipsoids")}
pinches = pytest.mark.parametrize("pinch", PINCHES.values(), ids=PINCHES)


def moving(scene, q, seed=0):
    """A rolling velocity with every direction in it, about 0.1 m/s and 1 rad/s."""
    v = np.random.default_rng(seed).normal(size=len(q) - 1)
    return ref.rolling_velocity(scene, q, v * np.concatenate([np.full(3, 0.1), np.ones(len(q) - 4)]))


def turned(pinch, **changes):
    """Scene and closed q with the object turned by 20 degrees, so that no frame is another one."""
    scene, q = pinch(**changes)
    step = np.concatenate([[1e-3, -2e-3, 1e-3, 0.2, -0.15, 0.25], np.zeros(6)])
    return scene, ref.closed_coordinates(
        scene, ref.displaced(q, step), np.concatenate([np.zeros(6), np.ones(6)])
    )


def table(tip, base=(0.0, 0.0, 0.0)):
    """A fixed shape: a finger without joints."""
    none = np.zeros((0, 3))
    return ref.Chain(np.array(base), none, none, np.zeros(0), none, np.zeros((0, 3, 3)), tip)


def on_table(body, finger):
    """A body under gravity on one shape."""
    return ref.Scene((finger,), body, ((0, 0),), gravity=(0.0, 0.0, -G))


# --- contact


@pytest.mark.parametrize("seed", range(5))
def test_located_points_are_the_closest(seed):
    rng = np.random.default_rng(seed)
    Q = cf.exponential(rng.normal(size=3))
    tip = ref.Ellipsoid((0.010, 0.008, 0.009), (0.001, 0.002, -0.001), Q)
    body = ref.Ellipsoid((0.015, 0.025, 0.020))
    tip_pose = 0.05 * (n := rng.normal(size=3)) / np.linalg.norm(n), cf.exponential(rng.normal(size=3))
    pose = np.zeros(3), cf.exponential(rng.normal(size=3))
    P, P0, n, gap = (a.real for a in ref.contact_points(tip, tip_pose, body, pose))

    def apart(a):
        a = a / np.array([0.010, 0.008, 0.009, 0.015, 0.025, 0.020])
        near = tip_pose[0] + tip_pose[1] @ (tip.centre + Q @ (tip.semi_axes * a[:3] / np.linalg.norm(a[:3])))
        return near - pose[1] @ (body.semi_axes * a[3:] / np.linalg.norm(a[3:]))

    starts = np.concatenate([Q.T @ tip_pose[1].T @ -n * 0.01, pose[1].T @ n * 0.02])
    best = minimize(lambda a: 1e4 * apart(a) @ apart(a), starts, tol=1e-14)
    assert gap > 0
    assert np.linalg.norm(apart(best.x)) == pytest.approx(gap, rel=1e-8)
    assert np.abs(P - P0 - gap * n).max() < 1e-16
    assert np.abs(apart(best.x) - gap * n).max() < 1e-6


@pinches
def test_scenes_are_closed_and_tangent(pinch):
    scene, q = pinch()
    for state in (q, turned(pinch)[1]):
        assert np.abs(ref.located_contacts(scene, state)[3]).max() < 1e-16
        assert ref.normal_mismatch(scene, state).max() < 1e-14
        assert ref.forces(scene, state, np.zeros(12))[0].min() > 0.5


@pytest.mark.parametrize("flat_tip", [False, True])
def test_points_on_a_plane_and_over_it(flat_tip):
    egg, plane = ref.Ellipsoid((0.010, 0.008, 0.009)), ref.Plane((0.01, 0.02, -0.03), (0.6, 0.0, 0.8))
    poses = [(a, cf.exponential(10 * a)) for a in np.array([[0.1, 0.05, 0.02], [-0.03, 0.01, 0.07]])]
    shapes, order = (egg, plane), slice(None, None, -1 if flat_tip else 1)
    (shape, pose), (shape0, pose0) = zip(shapes[order], poses[order], strict=True)
    P, P0, n, gap = ref.contact_points(shape, pose, shape0, pose0)
    on_egg, on_plane = (P, P0)[order]
    (r, Q), (x, R) = poses
    assert np.abs(P - P0 - gap * n).max() < 1e-16
    assert (R.T @ (on_plane - x) - plane.point) @ plane.normal == pytest.approx(0, abs=1e-16)
    assert np.sum(np.square(Q.T @ (on_egg - r) / egg.semi_axes)) == pytest.approx(1, rel=1e-13)
    heights = [(R.T @ (r + Q @ egg.support(m)[0] - x) - plane.point) @ plane.normal for m in SPREAD]
    assert gap <= min(heights) < gap + 2e-4


@pinches
def test_rows_are_material_velocities(pinch):
    """A v against the motion, by differences, of the points of both bodies that are in contact."""
    scene, q = turned(pinch, no_spin=True)
    v, d = np.random.default_rng(4).normal(size=12), 1e-3
    P, P0, n, _ = ref.located_contacts(scene, q)
    here = ref.configuration(scene, q.astype(complex))
    poses = [(c[0][-1].real, c[1][-1].real) for c in here.chains] + [(q[:3], here.turned.real)]

    def after(t):
        there = q + t * ref.coordinate_rates(q, v)
        found = ref.configuration(scene, there.astype(complex))
        return [(c[0][-1].real, c[1][-1].real) for c in found.chains] + [(there[:3], found.turned.real)]

    moved = [after(k * d) for k in (-2, -1, 1, 2)]
    weights, expected = np.array([1, -8, 8, -1]) / 12 / d, []
    for c in (0, 1):
        speeds, spins = [], []
        for body, point in ((c, P[c]), (2, P0[c])):
            r, Q = poses[body]
            fixed = Q.T @ (point - r)
            speeds.append(weights @ [m[body][0] + m[body][1] @ fixed for m in moved])
            spin = np.einsum("k,kij->ij", weights, [m[body][1] for m in moved]) @ Q.T
            spins.append(np.array([spin[2, 1], spin[0, 2], spin[1, 0]]))
        expected += [*(speeds[0] - speeds[1]), n[c] @ (spins[0] - spins[1])]
    assert np.abs(here.rows.real @ v - expected).max() < 1e-9
    assert np.abs(expected).min() > 1e-3


@pinches
@pytest.mark.parametrize("no_spin", [False, True])
def test_rows_are_followed_along_the_motion(pinch, no_spin):
    """A' v by complex step against fourth-order differences, gap rates against the normal rows."""
    scene, q = turned(pinch, no_spin=no_spin)
    v = moving(scene, q)
    d, ways, weights = 2e-4, (-2, -1, 1, 2), np.array([1, -8, 8, -1]) / 12
    here = [ref.configuration(scene, (q + k * d * ref.coordinate_rates(q, v)).astype(complex)) for k in ways]
    rows = np.einsum("k,kij->ij", weights, [p.rows.real for p in here]) / d
    assert np.abs(rows @ v - ref.equations(scene, q, v)[4]).max() < 2e-11
    away = np.random.default_rng(2).normal(size=12) * 0.1
    gaps = [ref.located_contacts(scene, q + k * d * ref.coordinate_rates(q, away))[3] for k in ways]
    A, n = ref.equations(scene, q, v)[3], ref.located_contacts(scene, q)[2]
    per = len(A) // 2
    rates = [n[c] @ A[per * c : per * c + 3] @ away for c in (0, 1)]
    assert np.abs(weights @ gaps / d - rates).max() < 1e-9


# --- dynamics


def test_velocity_terms_follow_from_lagrange():
    """h = M' v - d(v M v / 2)/dq of the joints, by fourth-order differences of M."""
    scene, q = ref.pinch3d()
    v, d = np.random.default_rng(3).normal(size=12), 1e-3
    at, weights = slice(6, 12), {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}

    def mass(step):
        return ref.equations(scene, ref.displaced(q, step), v)[0][at, at]

    slopes = [sum(w * mass(k * d * e) for k, w in weights.items()) / d for e in np.eye(12)[at]]
    u = v[at]
    expected = np.einsum("kij,k,j->i", slopes, u, u) - np.einsum("kij,i,j->k", slopes, u, u) / 2
    assert np.abs(ref.equations(scene, q, v)[1][at] - expected).max() < 1e-12
    assert np.abs(expected).max() > 1e-5


def energy_and_drift(pinch, no_spin, ts):
    scene, q = pinch(no_spin=no_spin, gravity=(0.3, -2.0, 1.0))
    v = moving(scene, q)
    qs, vs, lost = ref.simulate(scene, q, v, ts, audit=True)
    energy = [ref.energy(scene, *state) for state in zip(qs, vs, strict=True)]
    assert np.abs(energy + lost - energy[0]).max() < 1e-13
    assert lost[-1] > 3e-4
    assert max(np.abs(ref.located_contacts(scene, a)[3]).max() for a in qs) < 1e-14
    assert max(np.abs(ref.equations(scene, a, b)[3] @ b).max() for a, b in zip(qs, vs, strict=True)) < 1e-13
    assert np.abs(np.linalg.norm(qs[:, 3:7], axis=1) - 1).max() < 1e-13


@pytest.mark.parametrize("grasp", GRASPS.values(), ids=GRASPS)
def test_energy_and_drift(grasp):
    energy_and_drift(grasp, grasp is ref.pinch3d_ellipsoids, np.linspace(0, 0.1, 3))


@pytest.mark.slow
@pytest.mark.parametrize("no_spin", [False, True])
@pytest.mark.parametrize("grasp", GRASPS.values(), ids=GRASPS)
def test_energy_and_drift_over_a_second(grasp, no_spin):
    energy_and_drift(grasp, no_spin, np.linspace(0, 1, 6))


@pinches
@pytest.mark.parametrize("no_spin", [False, True])
def test_forces_move_the_object(pinch, no_spin):
    scene, q = turned(pinch, no_spin=no_spin, gravity=(0.3, -2.0, 1.0))
    v = moving(scene, q)
    normal, tangential, moment = ref.forces(scene, q, v)
    _, P0, n, _ = ref.located_contacts(scene, q)
    push = -(normal[:, None] * n + tangential)
    up, body = ref.accelerations(scene, q, v), scene.body
    assert np.abs(push.sum(0) + body.mass * np.array(scene.gravity) - body.mass * up[:3]).max() < 1e-13
    R, w = ref.quaternion_matrix(q[3:7]), v[3:6]
    about = np.cross(P0 - q[:3], push).sum(0) - moment @ n
    turning = body.inertia @ up[3:6] + np.cross(w, body.inertia @ w)
    assert np.abs(R.T @ about - turning).max() < 1e-15
    assert np.abs(np.sum(tangential * n, axis=1)).max() < 1e-15
    assert (np.abs(moment).max() > 1e-6) == no_spin


@pinches
def test_no_direction_is_special(pinch):
    """Everything turned as one moves turned."""
    scene, q = pinch()
    v, T, ts = moving(scene, q), cf.exponential(np.array([0.3, -0.5, 0.8])), np.array([0.0, 0.04])
    other = replace(scene, fingers=tuple(ref.turned_finger(f, T) for f in scene.fingers))
    half = np.array([0.3, -0.5, 0.8]) / 2
    angle = np.linalg.norm(half)
    p = np.concatenate([[np.cos(angle)], np.sin(angle) / angle * half])
    start = np.concatenate([T @ q[:3], p, q[7:]])
    ends = ref.simulate(scene, q, v, ts), ref.simulate(other, start, np.append(T @ v[:3], v[3:]), ts)
    (q1, v1), (q2, v2) = [(a[-1], b[-1]) for a, b in ends]
    assert np.abs(T @ q1[:3] - q2[:3]).max() < 1e-12
    assert np.abs(T @ ref.quaternion_matrix(q1[3:7]) - ref.quaternion_matrix(q2[3:7])).max() < 1e-11
    assert np.abs(q1[7:] - q2[7:]).max() < 1e-11
    assert np.abs(v1[3:] - v2[3:]).max() < 1e-10


# --- the plane


class Round(Part1):
    """The chapter's Part 1 with round fingertips of 10 mm about O_i, without the torques of alpha."""

    alpha, r = 0.0, 0.01

    def tip(self, i, s):
        angle, side = s / self.r, SIGNS[i]
        b = np.array([-np.sin(angle), side * np.cos(angle)])
        out = np.array([np.cos(angle), side * np.sin(angle)])
        return self.r * out, b, -out, 1 / self.r


def flat_finger(links, lengths, masses):
    """The chapter's finger in space."""
    k = len(lengths)
    offsets = np.array([(a, 0, 0) for a in lengths])
    inertias = [m * a**2 / 12 * np.diag([0, 1, 1]) for m, a in zip(masses, lengths, strict=True)]
    base, up = np.append(links.base, 0.0), np.tile([0.0, 0.0, 1.0], (k, 1))
    return ref.Chain(base, up, offsets, np.array(masses), offsets / 2, np.array(inertias), ref.sphere(0.01))


def test_the_chapters_pinch_with_round_tips():
    """Two oracles, one in the plane with arclengths as states, one in space without."""
    sizes = ((0.065, 0.039, 0.026), (0.045, 0.025, 0.015)), ((0.065, 0.065), (0.045, 0.040))
    assert isinstance(Part1.fingers[0], Links)
    fingers = tuple(flat_finger(f, *size) for f, size in zip(Part1.fingers, sizes, strict=True))
    faces = ref.Plane((-0.015, 0, 0), (-1.0, 0, 0)), ref.Plane((0.015, 0, 0), (1.0, 0, 0))
    inertia = 0.02 / 12 * np.diag([0.05**2 + 0.05**2, 0.03**2 + 0.05**2, 0.03**2 + 0.05**2])
    scene = ref.Scene(fingers, ref.Body(0.02, inertia, faces), ((0, 0), (1, 1)), beta=20.0, damping=0.006)
    theta = 0.05
    first = ref.joints_reaching(fingers[0], np.array([0.0025, 0.104, 0]), np.array([2.0, -0.5, -1.0]))
    second = ref.joints_reaching(fingers[1], np.array([0.0525, 0.098, 0]), np.array([0.9, 1.2]))
    start = [[0.0275, 0.10, 0, np.cos(theta / 2), 0, 0, np.sin(theta / 2)], first, second]
    q = ref.closed_coordinates(scene, np.concatenate(start), np.concatenate([np.zeros(6), np.ones(5)]))
    ts = np.linspace(0, 0.1, 3)
    qs, vs = ref.simulate(scene, q, np.zeros(11), ts)

    def arclengths(q):
        return np.array(
            [-(ref.quaternion_matrix(q[3:7]).T @ (p - q[:3]))[1] for p in ref.located_contacts(scene, q)[1]]
        )

    X, V, s, forces = Round(np.zeros(2)).simulate(np.append([0.0275, 0.10, theta], q[7:]), arclengths(q), ts)
    angles = 2 * np.arctan2(qs[:, 6], qs[:, 3])
    assert np.abs(np.column_stack([qs[:, :2], angles, qs[:, 7:]]) - X).max() < 1e-11
    assert np.abs(vs[:, [0, 1, 5, 6, 7, 8, 9, 10]] - V).max() < 1e-10
    assert np.abs([arclengths(a) for a in qs] - s).max() < 1e-12
    for a, b, x, pull in zip(qs, vs, X, forces, strict=True):
        normal, tangential, _ = ref.forces(scene, a, b)
        assert np.abs(normal - pull[:2]).max() < 1e-9
        b_bar = np.append(planar_rotation(x[2]) @ [0.0, -1.0], 0)
        assert np.abs(tangential + pull[2:, None] * b_bar).max() < 1e-9
    assert np.ptp(X, axis=0).max() > 0.05


# --- closed forms


def test_ball_on_a_turntable():
    """The table is a finger of one joint with an inertia beyond all others."""
    none, r, Omega = np.zeros((1, 3)), 0.02, 3.0
    up = np.array([[0, 0, 1.0]])
    plane = ref.Plane((0, 0, 0), (0, 0, 1.0))
    chain = ref.Chain(np.zeros(3), up, none, np.ones(1), none, 1e8 * np.eye(3)[None], plane)
    ball = ref.Body(0.1, 0.4 * 0.1 * r**2 * np.eye(3), (ref.sphere(r),))
    scene, ts = on_table(ball, chain), np.linspace(0, 2, 6)
    x0, v0 = np.array([0.1, -0.05, r]), np.array([0.07, 0.2, 0.0])
    expected = [cf.ball_on_turntable(t, x0, v0, 1.5, Omega=Omega, r=r) for t in ts]
    q0 = np.concatenate([x0, [1, 0, 0, 0], [0]])
    qs, vs = ref.simulate(scene, q0, np.concatenate([v0, expected[0][2], [Omega]]), ts)
    for q, v, (x, speed, spin) in zip(qs, vs, expected, strict=True):
        assert np.abs(q[:3] - x).max() < 1e-11
        assert np.abs(v[:3] - speed).max() < 1e-11
        assert np.abs(ref.quaternion_matrix(q[3:7]) @ v[3:6] - spin).max() < 1e-9


def test_ball_on_an_incline_and_on_a_ball():
    r, alpha = 0.02, 0.4
    ball = ref.Body(0.1, 0.4 * 0.1 * r**2 * np.eye(3), (ref.sphere(r),))
    tilted = on_table(ball, table(ref.Plane((0, 0, 0), (np.sin(alpha), 0, np.cos(alpha)))))
    q = np.array([r * np.sin(alpha), 0, r * np.cos(alpha), 1, 0, 0, 0])
    up = ref.accelerations(tilted, q, np.zeros(6))
    assert np.linalg.norm(up[:3]) == pytest.approx(cf.incline_acceleration(alpha, G), rel=1e-14)
    R, ts = 0.1, np.linspace(0, 0.3, 4)
    start = np.array([0.2, 1.0])
    y = cf.integrated(lambda _, y: cf.ball_on_sphere_rates(y, R=R, r=r, g=G), start, ts)
    s, c = np.sin(start[0]), np.cos(start[0])
    q0 = np.array([(R + r) * s, 0, (R + r) * c, 1, 0, 0, 0])
    v0 = start[1] * np.array([(R + r) * c, 0, -(R + r) * s, 0, (R + r) / r, 0])
    qs, _ = ref.simulate(on_table(ball, table(ref.sphere(R))), q0, v0, ts)
    assert np.abs(np.arctan2(qs[:, 0], qs[:, 2]) - y[:, 0]).max() < 1e-11
    assert y[-1, 0] > 0.6


def test_rattleback():
    body, p, w = cf.rattleback()
    ts = np.linspace(0, 0.25, 3)
    P, x, W = body.simulate(p, w, ts)
    shape = ref.Ellipsoid((0.20, 0.03, 0.02), (0, 0, 0.01))
    plane = table(ref.Plane((0, 0, 0), (0, 0, 1.0)))
    scene = on_table(ref.Body(body.mass, body.inertia, (shape,)), plane)
    speed = cf.quaternion_matrix(p) @ np.cross(body.parts(p, w)[1], w)
    qs, vs = ref.simulate(scene, np.concatenate([x[0], p]), np.concatenate([speed, w]), ts)
    assert np.abs(qs - np.column_stack([x, P])).max() < 1e-11
    assert np.abs(vs[:, 3:] - W).max() < 1e-9
    for q, v, a, b in zip(qs, vs, P, W, strict=True):
        normal, tangential, _ = ref.forces(scene, q, v)
        pull = body.force(a, b)
        assert np.abs(pull - [*-tangential[0, :2], normal[0]]).max() < 1e-8
