"""Spatial grasping under rolling contact in plain NumPy and SciPy: the judge of the library's own.

An oracle: nothing is shared with jaxroll. SI units, world axes unless said otherwise, coordinates

    q = (x (3), quaternion (4, scalar first, body to world), joints of finger 1, of finger 2, ...)
    v = (x' (3), angular velocity of the object in BODY axes (3), joint rates ...).

Contact coordinates are no part of the state: the contact points are found from the poses at every
evaluation, by the common normal n. With S(m) the point of a shape where its outward normal is m (the
gradient of its support function), the object's point is P_o = x + R S_o(R^T n), the tip's point is
P_t = r + R_t S_t(-R_t^T n), and (n, g) solve P_t - P_o = g n, n.n = 1, by Newton's method. Everything is
analytic in q, so one complex step along the motion gives the time derivatives of Jacobians and of
constraint rows, the contact points moving along, to rounding. Rolling is A v = 0, the rows of A being the
material velocity of the tip at P_t less the object's at P_o. Accelerations are a particular solution of
A v' = -A' v plus Z z, Z spanning the null space of A (SVD), with Z^T (M v' + h - F) = 0; no multiplier
is needed for the motion, and `forces` solves for them afterwards.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

STEP = 1e-30  # of the complex step


def cross_matrix(a):
    """The matrix of a x."""
    x, y, z = a
    return np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]])


def rotation(axis, angle):
    """Rotation about a unit axis by an angle [rad]."""
    K = cross_matrix(axis)
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)


def quaternion_matrix(p):
    """Rotation of a quaternion; of any length, so that rounding of the length does no harm."""
    w, u = p[0], p[1:]
    return np.eye(3) + 2 / (p @ p) * (w * cross_matrix(u) + cross_matrix(u) @ cross_matrix(u))


def cylinder_inertia(mass, offset, radius):
    """Inertia of a solid cylinder along `offset`, about its centre [kg m^2]."""
    length = np.linalg.norm(offset)
    along = np.outer(offset, offset) / length**2
    return mass * (radius**2 / 2 * along + (radius**2 / 4 + length**2 / 12) * (np.eye(3) - along))


@dataclass(frozen=True)
class Plane:
    """A plane through `point` with outward unit `normal`, in its body's frame."""

    point: tuple
    normal: tuple


@dataclass(frozen=True)
class Ellipsoid:
    """Semi-axes [m] along the columns of `turn`, about `centre`, in its body's frame."""

    semi_axes: tuple
    centre: tuple = (0.0, 0.0, 0.0)
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))

    def support(self, m):
        """S(m) where the outward normal is along m, and dS/dm: S = D^2 w / |D w|, w = turn^T m."""
        squares = np.square(self.semi_axes)
        w = self.turn.T @ m
        root, s = np.sqrt(w @ (squares * w)), squares * w
        slope = np.diag(squares) / root - np.outer(s, s) / root**3
        return self.centre + self.turn @ s / root, self.turn @ slope @ self.turn.T


def sphere(radius):
    """A sphere about the origin of its body's frame."""
    return Ellipsoid((radius, radius, radius))


@dataclass(frozen=True)
class Chain:
    """A finger: serial revolute joints from `base` on, and the shape of its tip about the tip's origin."""

    base: np.ndarray
    axes: np.ndarray  # (k, 3) in the link frames
    offsets: np.ndarray  # (k, 3) from joint i to joint i + 1, in link i; the last one to the tip
    masses: np.ndarray  # (k,)
    centres: np.ndarray  # (k, 3) from joint i to the centre of mass, in link i
    inertias: np.ndarray  # (k, 3, 3) about the centre of mass, in link i
    tip: Plane | Ellipsoid

    def place(self, q):
        """Joints and tip p (k + 1, 3), link rotations (k, 3, 3), axes and centres of mass in the world."""
        p, turned, axes, centres = [np.asarray(self.base)], [], [], []
        R = np.eye(3)
        for angle, axis, offset, centre in zip(q, self.axes, self.offsets, self.centres, strict=True):
            axes.append(R @ axis)
            R = R @ rotation(axis, angle)
            turned.append(R)
            centres.append(p[-1] + R @ centre)
            p.append(p[-1] + R @ offset)
        return p, turned, axes, centres

    @staticmethod
    def jacobians(placed, point, link, k):
        """Velocity and angular velocity by the joint rates, (3, k) each, of a point of link `link`."""
        p, _, axes, _ = placed
        J = np.zeros((2, 3, k), dtype=complex)
        for j in range(link + 1):
            J[0, :, j] = cross_matrix(axes[j]) @ (point - p[j])
            J[1, :, j] = axes[j]
        return J


@dataclass(frozen=True)
class Body:
    """The free object: its surfaces and its inertia about the centre of mass, in body axes."""

    mass: float
    inertia: np.ndarray
    surfaces: tuple


@dataclass(frozen=True)
class Scene:
    """Fingers, object, contacts (finger, surface), and the control u_i = -c q_i' + beta J_i^T pulls."""

    fingers: tuple
    body: Body
    contacts: tuple
    beta: float = 0.0
    damping: float = 0.0
    gravity: tuple = (0.0, 0.0, 0.0)
    no_spin: bool = False

    @property
    def joints(self):
        """Where each finger's joints stand in v; one further on in q."""
        ends = 6 + np.cumsum([0] + [len(f.masses) for f in self.fingers])
        return [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]

    def angles(self, q):
        """Joint angles of each finger."""
        return [q[at.start + 1 : at.stop + 1] for at in self.joints]


def coordinate_rates(q, v):
    """Time derivative of q."""
    w, u = q[3], q[4:7]
    turning = np.concatenate([[-u @ v[3:6]], w * v[3:6] + cross_matrix(u) @ v[3:6]]) / 2
    return np.concatenate([v[:3], turning, v[6:]])


def contact_points(tip, tip_pose, surface, body_pose, n=None):
    """Contact point on the tip, on the object, common normal (out of the object) and gap.

    A plane gives the normal, and the other's contact point is in closed form; else Newton from `n`.
    """
    (r, Q), (x, R) = tip_pose, body_pose
    if isinstance(surface, Plane):
        n = R @ surface.normal
        P = r + Q @ tip.support(-Q.T @ n)[0]
        gap = n @ (P - x - R @ surface.point)
        return P, P - gap * n, n, gap
    if isinstance(tip, Plane):
        n = -Q @ tip.normal
        P = x + R @ surface.support(R.T @ n)[0]
        gap = n @ (r + Q @ tip.point - P)
        return P + gap * n, P, n, gap
    if n is None:
        way = R.T @ (r + Q @ tip.centre - x) - surface.centre
        n = R @ surface.turn @ ((surface.turn.T @ way) / np.square(surface.semi_axes))
        n = n / np.sqrt(n @ n)
    return _newton(tip, tip_pose, surface, body_pose, n)


def _newton(tip, tip_pose, surface, body_pose, n):
    """Newton's method for (n, g); three more steps after convergence carry the imaginary parts over."""
    n, gap = n.real.astype(complex), 0.0
    for _ in range(60):
        n, gap, size, points = _newton_step(tip, tip_pose, surface, body_pose, n, gap)
        if size < 1e-12:
            break
    else:
        raise RuntimeError("no common normal found")
    for _ in range(3):
        n, gap, _, points = _newton_step(tip, tip_pose, surface, body_pose, n, gap)
    return *points, n, gap


def _newton_step(tip, tip_pose, surface, body_pose, n, gap):
    """One step, turning n by at most half a radian; its size, and the points before it."""
    (r, Q), (x, R) = tip_pose, body_pose
    S, slope = tip.support(-Q.T @ n)
    S0, slope0 = surface.support(R.T @ n)
    P, P0 = r + Q @ S, x + R @ S0
    K = np.zeros((4, 4), dtype=complex)
    K[:3, :3] = -(Q @ slope @ Q.T) - R @ slope0 @ R.T - gap * np.eye(3)
    K[:3, 3], K[3, :3] = -n, 0.1 * n
    wrong = np.append(P - P0 - gap * n, 0.05 * (n @ n - 1))
    move = np.linalg.solve(K, -wrong)
    size = np.abs(move[:3].real).max()
    return n + min(1.0, 0.5 / max(size, 0.5)) * move[:3], gap + move[3], size, (P, P0)


@dataclass
class Configuration:
    """Everything that q alone decides; complex when q is."""

    chains: list  # Chain.place of each finger
    turned: np.ndarray  # R of the object
    touches: list  # P_t, P_o, n, gap of each contact
    rows: np.ndarray  # A


def configuration(scene, q, normals=None):
    """Poses, contacts and constraint rows at q; `normals` start Newton's method."""
    x, R = q[:3], quaternion_matrix(q[3:7])
    chains = [f.place(a) for f, a in zip(scene.fingers, scene.angles(q), strict=True)]
    touches, rows = [], []
    for c, (i, j) in enumerate(scene.contacts):
        p, turned, _, _ = chains[i]
        finger, at = scene.fingers[i], scene.joints[i]
        pose = p[-1], turned[-1] if turned else np.eye(3)
        start = None if normals is None else normals[c]
        P, P0, n, gap = contact_points(finger.tip, pose, scene.body.surfaces[j], (x, R), start)
        k = len(finger.masses)
        J = Chain.jacobians(chains[i], P, k - 1, k)
        block = np.zeros((4 if scene.no_spin else 3, scene.joints[-1].stop), dtype=complex)
        block[:3, :3], block[:3, 3:6] = -np.eye(3), cross_matrix(P0 - x) @ R
        block[:3, at] = J[0]
        if scene.no_spin:
            block[3, 3:6], block[3, at] = -n @ R, n @ J[1]
        touches.append((P, P0, n, gap))
        rows.append(block)
    return Configuration(chains, R, touches, np.concatenate(rows))


def located_contacts(scene, q, normals=None):
    """Contact points on the tips and on the object, normals out of the object and gaps, stacked."""
    found = configuration(scene, np.asarray(q, dtype=complex), normals).touches
    return tuple(np.array([t[k] for t in found]).real for k in range(4))


def normal_mismatch(scene, q):
    """How far the normals of the two shapes at the contact points are from opposite, per contact.

    Found from the points alone, by the gradients of the shapes' implicit equations.
    """
    P, P0, _, _ = located_contacts(scene, q)
    here = configuration(scene, np.asarray(q, dtype=complex))
    wrong = []
    for (i, j), point, point0 in zip(scene.contacts, P, P0, strict=True):
        p, turned, _, _ = here.chains[i]
        Q = turned[-1].real if turned else np.eye(3)
        outward = _outward(scene.fingers[i].tip, Q, Q.T @ (point - p[-1].real))
        R = here.turned.real
        wrong.append(outward + _outward(scene.body.surfaces[j], R, R.T @ (point0 - q[:3])))
    return np.linalg.norm(wrong, axis=1)


def _outward(shape, turned, at):
    """Outward unit normal in the world at a point given in body axes."""
    if isinstance(shape, Plane):
        return turned @ shape.normal
    slope = shape.turn @ ((shape.turn.T @ (at - shape.centre)) / np.square(shape.semi_axes))
    return turned @ slope / np.linalg.norm(slope)


def equations(scene, q, v, normals=None):
    """M, h, F, A, A' v and `Configuration` (complex): M v' + h = F + A^T multipliers, A v' = -A' v."""
    here = configuration(scene, q + 1j * STEP * coordinate_rates(q, v), normals)
    size, body, g = len(v), scene.body, np.asarray(scene.gravity)
    M, h, F = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    M[:3, :3], M[3:6, 3:6] = body.mass * np.eye(3), body.inertia
    h[3:6] = cross_matrix(v[3:6]) @ (body.inertia @ v[3:6])
    F[:3] = body.mass * g
    tips = [placed[0][-1].real for placed in here.chains]
    for i, (finger, placed, at) in enumerate(zip(scene.fingers, here.chains, scene.joints, strict=True)):
        k = len(finger.masses)
        for link in range(k):
            J = Chain.jacobians(placed, placed[3][link], link, k)
            bias, (Jv, Jw) = (J @ v[at]).imag / STEP, J.real
            m, R = finger.masses[link], placed[1][link].real
            turned = R @ finger.inertias[link] @ R.T
            w = Jw @ v[at]
            M[at, at] += m * Jv.T @ Jv + Jw.T @ turned @ Jw
            h[at] += m * Jv.T @ bias[0] + Jw.T @ (turned @ bias[1] + cross_matrix(w) @ (turned @ w))
            F[at] += m * Jv.T @ g
        J = Chain.jacobians(placed, placed[0][-1], k - 1, k)[0].real
        F[at] += scene.beta * J.T @ (sum(tips) - len(tips) * tips[i]) - scene.damping * v[at]
    moving = (here.rows @ v).imag / STEP
    return M, h, F, here.rows.real, moving, here


def _accelerations(M, h, F, A, moving):
    """v' by the null space of A, in coordinates scaled by the roots of M's diagonal."""
    scale = 1 / np.sqrt(np.diag(M))
    U, s, Vt = np.linalg.svd(A * scale)
    rank = int((s > 1e-10 * s[0]).sum())
    particular = scale * (Vt[:rank].T @ ((U[:, :rank].T @ -moving) / s[:rank]))
    Z = scale[:, None] * Vt[rank:].T
    return particular + Z @ np.linalg.solve(Z.T @ M @ Z, Z.T @ (F - h - M @ particular))


def accelerations(scene, q, v):
    """Time derivative of v."""
    return _accelerations(*equations(scene, q, v)[:5])


def forces(scene, q, v):
    """Normal force (positive when pressing), tangential force on the tip (3,), and spin moment [N m].

    Per contact; the force on the object is the opposite one. The moment on the tip about n is zero
    unless spin is prevented.
    """
    M, h, F, A, moving, here = equations(scene, q, v)
    scale = 1 / np.sqrt(np.diag(M))
    push = M @ _accelerations(M, h, F, A, moving) + h - F
    pulls = np.linalg.lstsq((A * scale).T, scale * push, rcond=1e-10)[0]
    pulls = pulls.reshape(len(scene.contacts), -1)
    n = np.array([t[2].real for t in here.touches])
    normal = np.sum(pulls[:, :3] * n, axis=1)
    moment = pulls[:, 3] if scene.no_spin else 0 * normal
    return normal, pulls[:, :3] - normal[:, None] * n, moment


def energy(scene, q, v):
    """Kinetic and potential (the control's and gravity's) [J]."""
    M, *_, here = equations(scene, q, v)
    tips = np.array([placed[0][-1].real for placed in here.chains])
    g = np.asarray(scene.gravity)
    apart = tips[:, None] - tips[None]
    potential = scene.beta / 4 * np.sum(apart**2) - scene.body.mass * g @ q[:3]
    for finger, placed in zip(scene.fingers, here.chains, strict=True):
        potential -= sum(m * g @ p.real for m, p in zip(finger.masses, placed[3], strict=True))
    return v @ M @ v / 2 + potential


def simulate(scene, q0, v0, ts, *, audit=False, rtol=1e-12, wrench=None, law=None, memory=()):
    """q and v at the times `ts` [s], rows; nothing is projected. With `audit` also the energy lost [J].

    `wrench` of (t, q, v) acts on the object besides: force [N] and torque [N m] about its centre of mass,
    both in world axes. `law` of (t, v, placed, memory) adds joint torques, and gives the rate of a memory,
    which begins with `memory` and is returned last; `placed` are origins and Jacobians of all tips.
    """
    size, joints, kept = len(q0), slice(6, None), len(memory)
    normals = list(located_contacts(scene, q0)[2])

    def rates(t, y):
        q, v, held = y[:size], y[size : len(y) - 1 - kept], y[len(y) - kept :]
        *terms, here = equations(scene, q, v, normals)
        change = np.zeros(0)
        if law is not None:
            u, change = law(t, v, tips_of(scene, here), held)
            terms[2][joints] += u
        if wrench is not None:
            force, torque = wrench(t, q, v)
            terms[2][:6] += np.concatenate([force, here.turned.real.T @ torque])
        normals[:] = [t[2].real for t in here.touches]
        lost = scene.damping * v[joints] @ v[joints]
        return np.concatenate([coordinate_rates(q, v), _accelerations(*terms), [lost], change])

    y0 = np.concatenate([q0, v0, [0.0], memory])
    answer = solve_ivp(rates, (ts[0], ts[-1]), y0, method="DOP853", rtol=rtol, atol=1e-13, t_eval=ts)
    if not answer.success:
        raise RuntimeError(answer.message)
    q, v, lost, held = np.split(answer.y.T, [size, size + len(v0), size + len(v0) + 1], axis=1)
    return (q, v) + ((lost[:, 0],) if audit else ()) + ((held,) if kept else ())


def tips_of(scene, here):
    """Origin (3,) and Jacobian (3, k) of every finger's tip frame, of a `Configuration`."""
    ends = [(placed, len(finger.masses)) for finger, placed in zip(scene.fingers, here.chains, strict=True)]
    return [
        (placed[0][-1].real, Chain.jacobians(placed, placed[0][-1], k - 1, k)[0].real) for placed, k in ends
    ]


def displaced(q, step):
    """Q after the small displacement `step`, in the coordinates of v."""
    angle = np.linalg.norm(step[3:6])
    w, u = np.cos(angle / 2), np.sinc(angle / 2 / np.pi) / 2 * step[3:6]
    turned = np.concatenate([[q[3] * w - q[4:7] @ u], q[3] * u + w * q[4:7] + cross_matrix(q[4:7]) @ u])
    return np.concatenate([q[:3] + step[:3], turned / np.linalg.norm(turned), q[7:] + step[6:]])


def closed_coordinates(scene, q, weights=None):
    """The nearest q with all gaps closed: Gauss-Newton; `weights` (size of v) say what may move."""
    weights = np.ones(len(q) - 1) if weights is None else weights
    for _ in range(30):
        here = configuration(scene, np.asarray(q, dtype=complex))
        gaps = np.array([t[3].real for t in here.touches])
        per = len(here.rows) // len(gaps)
        rows = [t[2].real @ here.rows.real[per * c : per * c + 3] for c, t in enumerate(here.touches)]
        q = displaced(q, weights * (np.linalg.pinv(np.array(rows) * weights) @ -gaps))
        if np.abs(gaps).max() < 1e-16:
            break
    return q


def rolling_velocity(scene, q, v):
    """The nearest v, by kinetic energy, that rolls: A v = 0."""
    M, _, _, A, _, _ = equations(scene, q, v)
    inverse = np.linalg.inv(np.linalg.cholesky(M))
    B = A @ inverse.T
    return v - inverse.T @ (np.linalg.pinv(B, rcond=1e-10) @ (A @ v))


def joints_reaching(finger, target, start):
    """Joint angles near `start` that bring the tip's origin to `target`."""
    return least_squares(lambda q: finger.place(q)[0][-1] - target, start, xtol=1e-15, gtol=1e-15).x


def three_joint_finger(base, tip):
    """The three-joint finger of `pinch3d`."""
    offsets = np.array([(0, 0.010, 0), (0, 0.065, 0), (0, 0.065, 0)])
    masses = np.array([0.015, 0.045, 0.040])
    inertias = [cylinder_inertia(m, o, 0.0065) for m, o in zip(masses, offsets, strict=True)]
    axes = np.array([(1.0, 0, 0), (0, 0, 1.0), (0, 0, 1.0)])
    return Chain(np.array(base), axes, offsets, masses, offsets / 2, np.array(inertias), tip)


def pinch3d(**changes):
    """Scene and consistent q: two fingers pinch a cuboid 30 x 50 x 50 mm of 20 g, the object at rest.

    The fingertips are spheres of 10 mm; z differs by 8 mm between them, so the motion is truly spatial.
    """
    fingers = (
        three_joint_finger((-0.0275, 0.0, 0.0), sphere(0.010)),
        three_joint_finger((0.0275, 0.0, 0.0), sphere(0.010)),
    )
    mass, sides = 0.020, np.array([0.030, 0.050, 0.050])
    inertia = mass / 12 * np.diag(np.sum(sides**2) - sides**2)
    faces = Plane((-0.015, 0, 0), (-1.0, 0, 0)), Plane((0.015, 0, 0), (1.0, 0, 0))
    scene = Scene(fingers, Body(mass, inertia, faces), ((0, 0), (1, 1)), beta=20.0, damping=0.006)
    scene = replace(scene, **changes)
    return scene, _closed(scene)


def pinch3d_ellipsoids(**changes):
    """As `pinch3d`, object an ellipsoid of semi-axes 15, 25, 20 mm, fingertips of 10, 8, 9 mm."""
    tip, axes = Ellipsoid((0.010, 0.008, 0.009)), np.array([0.015, 0.025, 0.020])
    fingers = three_joint_finger((-0.0275, 0.0, 0.0), tip), three_joint_finger((0.0275, 0.0, 0.0), tip)
    mass = 0.020
    inertia = mass / 5 * np.diag(np.sum(axes**2) - axes**2)
    body = Body(mass, inertia, (Ellipsoid(tuple(axes)),))
    scene = Scene(fingers, body, ((0, 0), (1, 0)), beta=20.0, damping=0.006)
    scene = replace(scene, **changes)
    return scene, _closed(scene)


def tripod3d(**changes):
    """Three such fingers round the y axis, 120 degrees apart, hold the ellipsoid of `pinch3d_ellipsoids`."""
    pair, _ = pinch3d_ellipsoids()
    first = pair.fingers[0]
    q = joints_reaching(first, np.array([-0.025, 0.113, 0.004]), np.array([0.0, 0.5, -1.0]))
    fingers = [turned_finger(first, rotation((0, 1, 0), turn)) for turn in (0, 2 * np.pi / 3, 4 * np.pi / 3)]
    scene = replace(pair, fingers=tuple(fingers), contacts=((0, 0), (1, 0), (2, 0)), **changes)
    weights = np.concatenate([np.zeros(6), np.ones(9)])
    return scene, closed_coordinates(scene, np.concatenate([[0, 0.115, 0, 1, 0, 0, 0], q, q, q]), weights)


def turned_finger(finger, R):
    """The finger turned as a whole about the world's origin."""
    moved = {name: getattr(finger, name) @ R.T for name in ("base", "axes", "offsets", "centres")}
    tip = replace(finger.tip, centre=R @ finger.tip.centre, turn=R @ finger.tip.turn)
    return replace(finger, inertias=R @ finger.inertias @ R.T, tip=tip, **moved)


def _closed(scene):
    """Q near the rough guess, the object left where it is: (0, 0.115, 0), not turned."""
    q = [np.array([0.0, 0.115, 0.0, 1.0, 0.0, 0.0, 0.0])]
    for finger, side in zip(scene.fingers, (-1.0, 1.0), strict=True):
        target = np.array([side * 0.025, 0.113, -side * 0.004])
        q.append(joints_reaching(finger, target, np.array([0.0, -side * 0.5, side * 1.0])))
    weights = np.concatenate([np.zeros(6), np.ones(6)])
    return closed_coordinates(scene, np.concatenate(q), weights)
