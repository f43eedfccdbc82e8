"""Rolling bodies with known answers, in plain NumPy and SciPy: closed forms and textbook equations.

Nothing is shared with jaxroll nor with `reference_space`. World z is up, SI units, rotations body to world,
quaternions scalar first. A ball has inertia k m r^2 (k = 2/5 when solid). Sources: Neimark and Fufaev,
Dynamics of Nonholonomic Systems (1972), and Routh, Advanced Rigid Dynamics (1905) (turntable, cylinder,
disc; derived here again); Garcia and Hubbard, Proc. R. Soc. A 418 (1988), 165 (rattleback);
Kane and Levinson, Int. J. Non-Linear Mech. 17 (1982), 175 (rattleback, its figures).
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

UP = np.array([0.0, 0.0, 1.0])
SOLID = 2 / 5
STEP = 1e-30  # of the complex step
IDENTITY = np.eye(3)


def cross_matrix(a):
    """The matrix of a x."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def quaternion_matrix(p):
    """Rotation of a unit quaternion."""
    u = cross_matrix(p[1:])
    return IDENTITY + 2 * (p[0] * u + u @ u)


def exponential(a):
    """exp(hat(a)), hat(a) the matrix of a x: the rotation about a by |a| [rad]."""
    return Rotation.from_rotvec(a).as_matrix()


def rotation_angle(R):
    """Rotation angle in [0, pi] [rad], exact near 0 as well as near pi."""
    return Rotation.from_matrix(R).magnitude()


def rotation_about_vertical(angle):
    """Rotation about the vertical by an angle [rad]."""
    return exponential(angle * UP)


def integrated(rates, y0, ts, rtol=1e-12):
    """Solution at `ts`, rows."""
    answer = solve_ivp(rates, (ts[0], ts[-1]), y0, method="DOP853", rtol=rtol, atol=1e-13, t_eval=ts)
    return answer.y.T


# --- (a) ball on a turntable


def ball_on_turntable(t, x0, v0, spin, *, Omega, r, k=SOLID):
    """Centre (3,) about the axis, its velocity and the angular velocity (world) at time t.

    No slip: V - r w x z = Omega z x X. Newton m V' = F and Euler k m r^2 w' = -r z x F, F horizontal,
    give w' x z = -F / (k m r), and the derivative of no slip V' (1 + 1/k) = Omega z x V. So the velocity
    turns at the rate c = k/(1 + k) Omega, 2/7 Omega for a solid ball: the centre goes round
    X_c = X_0 + z x V_0 / c on a circle. The horizontal spin follows from no slip,
    w = (z x V + Omega X) / r, and w.z = `spin` stays. `x0` and `v0` are horizontal, in the world.
    """
    c = k / (1 + k) * Omega
    centre = x0 + np.cross(UP, v0) / c
    x, v = centre + rotation_about_vertical(c * t) @ (x0 - centre), rotation_about_vertical(c * t) @ v0
    return x, v, (np.cross(UP, v) + Omega * (x - x @ UP * UP)) / r + spin * UP


def ball_on_turntable_rates(y, *, Omega, r, k=SOLID):
    """Newton and Euler with the force as an unknown: y = (X, V, w), mass 1."""
    v, w = y[3:6], y[6:9]
    # Unknowns V', w', F (horizontal): V' = F, k r^2 w' = -r z x F, (V - r w x z - Omega z x X)' = 0.
    E, Z = np.eye(3), np.zeros((3, 3))
    system = np.block([[E, Z, -E], [Z, k * r**2 * E, r * cross_matrix(UP)], [E, r * cross_matrix(UP), Z]])
    answer = np.linalg.solve(system, np.concatenate([np.zeros(6), Omega * np.cross(UP, v)]))
    return np.concatenate([v, answer[:6]]), w


# --- (b) ball in a vertical cylinder


def ball_in_cylinder(t, z0, vz0, rate, spin, *, R, r, g, k=SOLID):
    """Centre's angle, height, z', and spin (radial, azimuthal, vertical) of a ball inside a cylinder.

    The centre is at R - r from the axis, the contact at r e_r from it: V + w x r e_r = 0 gives
    w_z = -(R - r) phi'/r and w_phi = z'/r. Euler about the vertical with Newton along e_phi gives
    phi'' = 0, so phi' = `rate` = n for good. Euler along e_r: w_r' = n w_phi, so r w_r = n (z - z*) with
    z* = z_0 - r w_r(0)/n; along e_phi with Newton along z: (1 + k) z'' = -k n^2 (z - z*) - g. The height
    is harmonic at sqrt(k/(1 + k)) n about z* - g/(k n^2), 2/7 under the root for a solid ball. `spin` is
    w_r(0), the spin about the normal.
    """
    n, p = rate, np.sqrt(k / (1 + k)) * abs(rate)
    highest = z0 - r * spin / n
    middle = highest - g / (k * n**2)
    z = middle + (z0 - middle) * np.cos(p * t) + vz0 / p * np.sin(p * t)
    vz = -(z0 - middle) * p * np.sin(p * t) + vz0 * np.cos(p * t)
    return n * t, z, vz, np.array([n * (z - highest) / r, vz / r, -(R - r) * n / r + 0 * t])


def ball_in_cylinder_rates(y, *, r, g, k=SOLID):
    """Newton and Euler with the force as an unknown, world axes: y = (X, V, w), mass 1."""
    x, v, w = np.split(y, 3)
    rho = np.hypot(x[0], x[1])
    e = np.array([x[0], x[1], 0]) / rho
    turning = (v - v @ UP * UP - v @ e * e) / rho  # e'
    E, Z = np.eye(3), np.zeros((3, 3))
    system = np.block([[E, Z, -E], [Z, k * r**2 * E, -r * cross_matrix(e)], [E, -r * cross_matrix(e), Z]])
    right = np.concatenate([-g * UP, np.zeros(3), -r * np.cross(w, turning)])
    answer = np.linalg.solve(system, right)
    return np.concatenate([v, answer[:6]])


# --- (d) ball on an incline


def incline_acceleration(alpha, g, k=SOLID):
    """Acceleration down a slope [m/s^2]: m a = m g sin(alpha) - F, k m r^2 (a/r) = r F; 5/7 g sin(alpha)."""
    return g * np.sin(alpha) / (1 + k)


def ball_on_sphere_rates(y, *, R, r, g, k=SOLID):
    """Ball of radius r rolling down the outside of a fixed ball of radius R in a vertical plane.

    y = (phi, phi'), phi the angle of the line of centres from the vertical:
    (1 + k)(R + r) phi'' = g sin(phi), by energy m (1 + k) (R + r)^2 phi'^2 / 2 + m g (R + r) cos(phi).
    """
    return np.array([y[1], g * np.sin(y[0]) / ((1 + k) * (R + r))])


# --- (e) holonomy of a ball rolled without spin about the normal


def rotation_along_line(way, r):
    """Rotation of a ball rolled along a straight `way` (3,) [m]: w = z x V / r."""
    return exponential(np.cross(UP, way) / r)


def rotation_along_arc(heading, radius, angle, r):
    """Rotation of a ball rolled along a circular arc that turns left by `angle`, from a unit `heading`.

    w = z x V / r = -(radius/r) phi' e_r. In the frame that turns with e_r this is constant, less the
    frame's own z: R = R_z(phi) exp(-phi ((radius/r) e_r + z)), e_r = heading x z at the start. Once round,
    the net rotation is by 2 pi sqrt(1 + (radius/r)^2), about an axis inclined to the vertical by
    arctan(radius/r); for radius << r it is -pi (radius/r)^2 about z: less the area over r^2.
    """
    outward = np.cross(heading, UP)
    return rotation_about_vertical(angle) @ exponential(-angle * (radius / r * outward + UP))


def rotation_along_rounded_square(side, radius, r):
    """Net rotation after a square with straight sides `side` and corners of `radius`, to the left."""
    R, heading = np.eye(3), np.array([1.0, 0.0, 0.0])
    for _ in range(4):
        R = rotation_along_arc(heading, radius, np.pi / 2, r) @ rotation_along_line(side * heading, r) @ R
        heading = rotation_about_vertical(np.pi / 2) @ heading
    return R


def rotation_along_curve(velocity, ends, r):
    """Net rotation by integrating R' = hat(z x V / r) R; `velocity` (3,) of time, smooth on `ends`."""

    def rates(t, y):
        return (cross_matrix(np.cross(UP, velocity(t)) / r) @ y.reshape(3, 3)).ravel()

    return integrated(rates, np.eye(3).ravel(), np.array(ends, dtype=float))[-1].reshape(3, 3)


def smooth_loop_velocity(t):
    """Velocity along a smooth closed path of period 2 pi, no circle: used with `rotation_along_curve`."""
    return np.array([-0.03 * np.sin(t) + 0.012 * np.cos(2 * t), 0.02 * np.cos(t) - 0.009 * np.sin(3 * t), 0])


# --- (c) and (f) any convex body on a plane


@dataclass(frozen=True)
class Roller:
    """A body that rolls on the plane z = 0, free to spin about the normal.

    In body axes, with G the upward vertical, d(G) from the centre of mass to the contact and w the
    angular velocity: V = d x w, G' = G x w, m (V' + w x V - (-g G)) = F, I w' + w x I w = d x F. Hence
    (I - m hat(d)^2) w' = -w x I w + m d x (d' x w + w x (d x w) + g G), d' = (dd/dG) G' by complex step.
    """

    mass: float
    inertia: np.ndarray
    gravity: float
    contact: object  # d(G), analytic

    def parts(self, p, w):
        """G, d and d'."""
        G = quaternion_matrix(p)[2]
        moving = self.contact(G + 1j * STEP * (cross_matrix(G) @ w))
        return G, moving.real, moving.imag / STEP

    def spin_up(self, p, w, parts=None):
        """W' in body axes, and V' + w x V + g G; `parts` where they are known already."""
        G, d, rate = self.parts(p, w) if parts is None else parts
        D, turning = cross_matrix(d), cross_matrix(w)
        known = cross_matrix(rate) @ w + turning @ (D @ w) + self.gravity * G
        right = self.mass * D @ known - turning @ (self.inertia @ w)
        up = np.linalg.solve(self.inertia - self.mass * D @ D, right)
        return up, D @ up + known

    def rates(self, y):
        """Of y = (quaternion, centre of mass, w)."""
        p, w = y[:4] / np.linalg.norm(y[:4]), y[7:]
        parts = self.parts(p, w)
        turning = np.concatenate([[-p[1:] @ w], p[0] * w + cross_matrix(p[1:]) @ w]) / 2
        velocity = quaternion_matrix(p) @ (cross_matrix(parts[1]) @ w)
        return np.concatenate([turning, velocity, self.spin_up(p, w, parts)[0]])

    def simulate(self, p, w, ts, place=(0.0, 0.0), rtol=1e-12):
        """Quaternions, centres of mass and w (body axes) at `ts`, from a quaternion and w."""
        G, d, _ = self.parts(p, w)
        y0 = np.concatenate([p, place, [-d @ G], w])
        y = integrated(lambda _, y: self.rates(y), y0, ts, rtol)
        return y[:, :4], y[:, 4:7], y[:, 7:]

    def energy(self, p, w):
        """Kinetic and potential [J]."""
        G, d, _ = self.parts(p, w)
        v = np.cross(d, w)
        return (self.mass * v @ v + w @ self.inertia @ w) / 2 - self.mass * self.gravity * d @ G

    def upward(self, p, w):
        """Spin about the vertical [rad/s]."""
        return self.parts(p, w)[0] @ w

    def history(self, ps, ws):
        """Spin about the vertical [rad/s] and energy [J] of the rows that `simulate` returns."""
        states = list(zip(ps, ws, strict=True))
        return np.array([self.upward(*a) for a in states]), np.array([self.energy(*a) for a in states])

    def force(self, p, w):
        """Contact force on the body, in the world [N]."""
        return self.mass * quaternion_matrix(p) @ self.spin_up(p, w)[1]


def ellipsoid_contact(semi_axes, lowered=0.0):
    """d(G) of an ellipsoid whose centre of mass is `lowered` below its centre along -e_3."""
    squares = np.square(semi_axes)

    def contact(G):
        return np.array([0, 0, lowered]) - squares * G / np.sqrt(G @ (squares * G))

    return contact


def torus_contact(a, rho):
    """d(G) of a torus about e_3, its outer rim: -a G_12/|G_12| - rho G."""

    def contact(G):
        flat = np.array([G[0], G[1], 0 * G[2]])
        return -a * flat / np.sqrt(flat @ flat) - rho * G

    return contact


@dataclass(frozen=True)
class Wheel:
    """A wheel with a torus for a rim, circle of centres `a`, tube `rho` (0: a thin disc), on a plane.

    A and C are its inertias across and about its axis e. Axes: z = cos(theta) e + sin(theta) u with u in
    the wheel's plane, h = u x e horizontal, outward g = z x h. In steady motion (h, u, e) turns at
    Omega z, and w = Omega sin(theta) u + w3 e. The contact is at d = -a u - rho z. No slip, V = d x w,
    is along h, and V = Omega z x X puts the centre at X = P g from the axis of the path:

        Omega P = w3 (a + rho sin) - Omega rho sin cos.

    Force: m g z - m Omega^2 P g. Moment: d x F = -(m g a cos + m Omega^2 P (a sin + rho)) h. Angular
    momentum turns with the frame: L' = Omega sin (C w3 - A Omega cos) h. Equal:

        w3 Omega (C sin + m (a + rho sin)(a sin + rho))
            = A Omega^2 sin cos - m g a cos + m Omega^2 rho sin cos (a sin + rho).

    With rho = 0, the thin disc: (C + m a^2) w3 Omega sin = A Omega^2 sin cos - m g a cos.
    """

    mass: float
    A: float
    C: float
    a: float
    rho: float
    gravity: float

    def steady(self, theta, Omega):
        """Spin w3 about the axis, radii of the centre's and of the contact's path along g [m]."""
        s, c, m, a, rho = np.sin(theta), np.cos(theta), self.mass, self.a, self.rho
        left = Omega * (self.C * s + m * (a + rho * s) * (a * s + rho))
        lever = self.A * s * c + m * rho * s * c * (a * s + rho)
        w3 = (Omega**2 * lever - m * self.gravity * a * c) / left
        centre = (w3 * (a + rho * s) - Omega * rho * s * c) / Omega
        return w3, centre, centre - a * c

    def start(self, theta, Omega):
        """Quaternion, w in body axes and centre's place (2,) of the steady motion round the origin."""
        w3, centre, _ = self.steady(theta, Omega)
        p = np.array([np.cos(theta / 2), np.sin(theta / 2), 0.0, 0.0])
        return p, np.array([0.0, Omega * np.sin(theta), w3]), np.array([0.0, centre])

    def roller(self):
        """The wheel as any other body on a plane."""
        inertia = np.diag([self.A, self.A, self.C])
        return Roller(self.mass, inertia, self.gravity, torus_contact(self.a, self.rho))


def example_wheel(rho):
    """0.5 kg, 0.1 m from the centre to the circle of centres."""
    return Wheel(mass=0.5, A=0.5 * 0.1**2 / 4, C=0.5 * 0.1**2 / 2, a=0.1, rho=rho, gravity=9.81)


def turned_inertia(principal, delta):
    """Inertia whose principal axes are turned by delta [rad] about e_3 from the shape's."""
    R = rotation_about_vertical(delta)
    return R @ np.diag(principal) @ R.T


def rattleback(delta=2.0):
    """A rattleback that reverses: semi-axes 20, 3, 2 cm, 1 kg, centre of mass 1 cm below the ellipsoid's.

    Kane and Levinson's body but for `delta` [degrees], by which the axes of the principal inertias, 2e-4,
    1.6e-3 and 1.7e-3 kg m^2, are turned from the shape's: their product of inertia makes it 0.82. Returns
    the body, the quaternion of a tilt of 0.5 degrees about e_1, and w = (0, 0, -5) rad/s: clockwise, the
    wrong way for delta > 0. The spin is +4.9 rad/s 3 s later (+5 after 8 s with 0.8 degrees); started the
    right way it stays above 4.8 rad/s for 4 s (for 11 s). Without losses both turn round again later.
    Through the first reversal the normal force stays above 1.8 N, and the friction coefficient needed is
    0.67.
    """
    inertia = turned_inertia((2e-4, 1.6e-3, 1.7e-3), np.deg2rad(delta))
    body = Roller(1.0, inertia, 9.81, ellipsoid_contact((0.20, 0.03, 0.02), 0.01))
    tilt = np.deg2rad(0.5)
    return body, np.array([np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0]), np.array([0.0, 0.0, -5.0])
