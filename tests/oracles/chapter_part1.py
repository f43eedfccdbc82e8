"""The chapter's Part 1 in plain NumPy, as printed but for the errata: two fingers pinch a rectangle.

An oracle: nothing is shared with jaxroll. SI units, counter-clockwise angles, full coordinates
X = (x, y, theta, q1 (3), q2 (2)) and the chapter's arclengths s = (s1, s2). Everything is analytic in
X and s, so a complex step gives time derivatives to rounding.
"""

import numpy as np
from scipy.integrate import solve_ivp

STEP = 1e-30  # of the complex step
SIGNS = np.array([-1.0, 1.0])  # (-1)^i
JOINTS = slice(3, 6), slice(6, 8)  # where q1 and q2 stand in X


def planar_rotation(angle):
    """Rotation by an angle [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def turned_left(a):
    """A vector turned by +90 degrees."""
    return np.array([-a[1], a[0]])


class Links:
    """One finger of uniform slender links: positions and Jacobians of link centres and of O_i."""

    def __init__(self, lengths, masses, base):
        k = len(lengths)
        self.base = np.array(base)
        # arms[point, joint, link] [m]: a joint moves a point by the links between them, turned left.
        self.arms = np.zeros((k + 1, k, k))
        for point in range(k + 1):  # the centre of every link, then O_i
            along = np.where(np.arange(k) < point, lengths, 0.0)
            if point < k:
                along[point] = lengths[point] / 2
            for joint in range(k):
                self.arms[point, joint, joint:] = along[joint:]
        self.root = np.sqrt(masses)[:, None, None]
        turns = np.tril(np.ones((k, k)))  # spin of link m: sum of the first m joint rates
        self.spin = turns.T @ np.diag(np.multiply(masses, np.square(lengths)) / 12) @ turns

    def place(self, q):
        """O_i (2,), J_i (2, k), and the centres' Jacobians (2k, k), each times the root of its mass."""
        angles = np.cumsum(q)
        c, s = np.cos(angles), np.sin(angles)
        centre = self.base + np.stack([c, s]) @ self.arms[-1, 0]
        jacobians = self.arms @ np.stack([-s, c], axis=-1)  # point, joint, xy
        k = len(q)
        weighted = (self.root * jacobians[:-1]).transpose(0, 2, 1).reshape(2 * k, k)
        return centre, jacobians[-1].T, weighted


# How SciPy integrates it.
CLOSELY = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}


class Part1:
    """Equations (1)-(22) for the rectangle of Fig. 3 and the fingertips (82)-(83).

    Finger 1 is left of the object, finger 2 right; the n_0i point into the object, and the b_0i point
    down at theta = 0, so that n_01 is +90 degrees from b_01 and n_02 is -90 degrees from b_02.
    """

    fingers = (
        Links((0.065, 0.039, 0.026), (0.045, 0.025, 0.015), (0.0, 0.0)),
        Links((0.065, 0.065), (0.045, 0.040), (0.055, 0.0)),
    )
    width, height, mass = 0.03, 0.05, 0.02
    inertia = mass * (width**2 + height**2) / 12
    a = 1 / 40  # of the catenary [m]
    beta, alpha, c = 20.0, 1e-3, 0.006

    def __init__(self, start, wrench=None):
        """`start` is p_i(0) of (17) [rad].

        `wrench` of (t, X, v) acts on the object besides: force (2,) [N] in world axes, and torque [N m]
        about its centre of mass.
        """
        self.start, self.wrench = np.asarray(start), wrench

    def tip(self, i, s):
        """gamma_i [m], b_i, n_i and kappa_i [1/m]; X_i points 10 mm ahead to the vertex of (82)-(83)."""
        root = np.sqrt(self.a**2 + s**2)
        gamma = np.array([0.01 + self.a - root, SIGNS[i] * self.a * np.arcsinh(s / self.a)])
        b = np.array([-s / root, SIGNS[i] * self.a / root])
        return gamma, b, SIGNS[i] * turned_left(b), self.a / root**2

    def face(self, i, s):
        """gamma_0i [m], b_0i, n_0i and kappa_0i [1/m]."""
        b = np.array([0.0, -1.0])
        return np.array([SIGNS[i] * self.width / 2, -s]), b, -SIGNS[i] * turned_left(b), 0.0

    def orientations(self, X):
        """p_i = e_i . q_i [rad]."""
        return np.array([X[at].sum() for at in JOINTS])

    def tangent(self, X, s):
        """X with last joint angles that make the tangents coincide: Pi_i b_i = Pi_0 b_0i."""
        X = np.array(X)
        for i, at in enumerate(JOINTS):
            X[at.stop - 1] += X[2] + np.pi / 2 - SIGNS[i] * np.arctan(s[i] / self.a) - X[at].sum()
        return X

    def mismatch(self, X, s):
        """Pi_i b_i - Pi_0 b_0i for both contacts, zero under assumption 2)."""
        apart = []
        for i, p in enumerate(self.orientations(X)):
            b, b0 = self.tip(i, s[i])[1], self.face(i, s[i])[1]
            apart.append(planar_rotation(p + SIGNS[i] * np.pi / 2) @ b - planar_rotation(X[2]) @ b0)
        return np.array(apart)

    def rows(self, X, s, places):
        """Coefficients of f_1, f_2, lambda_1, lambda_2 in (1)-(3), shape (4, 8)."""
        rows = np.zeros((4, 8), dtype=np.result_type(X, s))
        turned = planar_rotation(X[2])
        for i, at in enumerate(JOINTS):
            gamma, b, n, _ = self.tip(i, s[i])
            gamma0, b0, n0, _ = self.face(i, s[i])
            jacobian, n_bar, b_bar = places[i][1], turned @ n0, turned @ b0  # (4)
            rows[i, :2], rows[2 + i, :2] = -n_bar, -b_bar  # (1)
            rows[i, 2], rows[2 + i, 2] = SIGNS[i] * (b0 @ gamma0), -SIGNS[i] * (n0 @ gamma0)  # (2)
            rows[i, at] = jacobian.T @ n_bar - SIGNS[i] * (b @ gamma)  # (3)
            rows[2 + i, at] = jacobian.T @ b_bar - SIGNS[i] * (n @ gamma)
        return rows

    def places(self, X):
        """`Links.place` of both fingers."""
        return [finger.place(X[at]) for finger, at in zip(self.fingers, JOINTS, strict=True)]

    def constraints(self, X, s):
        """Q_n1, Q_n2, Q_b1, Q_b2 [m]: (6) and (5)."""
        Q = np.zeros(4, dtype=np.result_type(X, s))
        for i, (r, _, _) in enumerate(self.places(X)):
            gamma, b, n, _ = self.tip(i, s[i])
            gamma0, b0, n0, _ = self.face(i, s[i])
            arm = planar_rotation(X[2]).T @ (r - X[:2])
            Q[i] = arm @ n0 - n @ gamma - n0 @ gamma0
            Q[2 + i] = arm @ b0 + b @ gamma - b0 @ gamma0
        return Q

    def rolling(self, v, s):
        """ds_i/dt [m/s]: (7)."""
        kappa = np.array([self.face(i, s[i])[3] + self.tip(i, s[i])[3] for i in (0, 1)])
        return SIGNS * (v[2] - self.orientations(v)) / kappa

    def mass_matrix(self, places):
        """G(X) of (15), shape (8, 8): sum of the links' Jacobians, m J^T J and m l^2/12 of the spins."""
        G = np.diag([self.mass, self.mass, self.inertia, 0, 0, 0, 0, 0]).astype(float)
        for finger, at, (_, _, weighted) in zip(self.fingers, JOINTS, places, strict=True):
            G[at, at] = weighted.T @ weighted + finger.spin
        return G

    def kinetic(self, X, v):
        """K [J]: (13)."""
        return 0.5 * v @ self.mass_matrix(self.places(X)) @ v

    def potential(self, X):
        """P [J]: (22)."""
        (r1, _, _), (r2, _, _) = self.places(X)
        turned = self.orientations(X) - self.start
        return self.beta / 2 * (r1 - r2) @ (r1 - r2) + self.alpha / 2 * turned @ turned

    def potential_rate(self, X, v):
        """dP/dt [W] along v."""
        return self.potential(X + 1j * STEP * v).imag / STEP

    def torques(self, X, v, places=None):
        """u_1, u_2 [N m] one after the other, shape (5,): (16)-(17)."""
        (r1, J1, _), (r2, J2, _) = self.places(X) if places is None else places
        N = self.orientations(X) - self.start
        u1 = -self.c * v[JOINTS[0]] - self.beta * J1.T @ (r1 - r2) - self.alpha * N[0]
        u2 = -self.c * v[JOINTS[1]] + self.beta * J2.T @ (r1 - r2) - self.alpha * N[1]
        return np.concatenate([u1, u2])

    def terms(self, X, v, s):
        """G, (G'/2 + S) v, rows of (1)-(3) and their time derivative, and what `Links.place` gives."""
        rate = self.rolling(v, s)
        Z, z = X + 1j * STEP * v, s + 1j * STEP * rate
        moving = self.places(Z)
        rows = self.rows(Z, z, moving)
        places = [tuple(part.real for part in place) for place in moving]
        bias = np.zeros(8)
        for at, (_, _, weighted) in zip(JOINTS, moving, strict=True):
            bias[at] = weighted.real.T @ (weighted.imag @ v[at]) / STEP  # m J^T (dJ/dt) v
        return self.mass_matrix(places), bias, rows.real, rows.imag / STEP, places

    def accelerations(self, X, v, s, t=0.0, u=None):
        """X'' (8,) and the multipliers (f_1, f_2, lambda_1, lambda_2) [N]: (1)-(3) with A X' = 0.

        `u` are joint torques in the place of (16)-(17) [N m].
        """
        G, bias, rows, rows_rate, places = self.terms(X, v, s)
        push = -bias
        push[3:] += self.torques(X, v, places) if u is None else u
        if self.wrench is not None:
            push[:3] += np.append(*self.wrench(t, X, v))
        saddle = np.block([[G, rows.T], [rows, np.zeros((4, 4))]])
        answer = np.linalg.solve(saddle, np.concatenate([push, -rows_rate @ v]))
        return answer[:8], answer[8:]

    def simulate(self, X, s, ts):
        """X, v, s and multipliers at the times `ts` [s], starting at rest; nothing is projected."""

        def rates(t, y):
            X, v, s = y[:8], y[8:16], y[16:]
            return np.concatenate([v, self.accelerations(X, v, s, t)[0], self.rolling(v, s)])

        y0 = np.concatenate([X, np.zeros(8), s])
        answer = solve_ivp(rates, (0.0, ts[-1]), y0, t_eval=ts, **CLOSELY)
        X, v, s = np.split(answer.y.T, [8, 16], axis=1)
        forces = np.array([self.accelerations(*state)[1] for state in zip(X, v, s, ts, strict=True)])
        return X, v, s, forces

    def simulate_integral(self, X, s, ts, *, law, memory):
        """X, v and memory at the times `ts` [s], starting at rest: the system augmented by the memory.

        `law` of (t, X, v, memory) gives the joint torques and the time derivative of the memory.
        """

        def rates(t, y):
            X, v, s = y[:8], y[8:16], y[16:18]
            u, change = law(t, X, v, y[18:])
            return np.concatenate([v, self.accelerations(X, v, s, t, u)[0], self.rolling(v, s), change])

        y0 = np.concatenate([X, np.zeros(8), s, memory])
        answer = solve_ivp(rates, (0.0, ts[-1]), y0, t_eval=ts, **CLOSELY)
        X, v, _, memory = np.split(answer.y.T, [8, 16, 18], axis=1)
        return X, v, memory

    def simulate_sampled(self, X, s, *, law, memory, period, count):
        """X, v, memory and held torques just after each of the samples 0, 1, ..., `count`: a loop over them.

        `law` of (t, X, v, memory) gives the joint torques and the memory of the next sample.
        """
        y, found = np.concatenate([X, np.zeros(8), s]), []
        for k in range(count + 1):
            if k:

                def held(t, y, u=u):
                    X, v, s = y[:8], y[8:16], y[16:]
                    return np.concatenate([v, self.accelerations(X, v, s, t, u)[0], self.rolling(v, s)])

                y = solve_ivp(held, ((k - 1) * period, k * period), y, **CLOSELY).y[:, -1]
            u, memory = law(k * period, y[:8], y[8:16], memory)
            found.append((y[:8], y[8:16], memory, u))
        return tuple(np.array(each) for each in zip(*found, strict=True))
