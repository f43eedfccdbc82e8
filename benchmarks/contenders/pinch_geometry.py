r"""The pinch's numbers, its closure and its start, in plain NumPy for `pinch_numba`.

Shares no code with jaxroll. State $x = [X, \dot X, s_1, s_2]$, $X = (x, y, \theta, q_1, q_2)$, in the
chapter's signs; its $s_i$ are $s_{0i} \mp \sigma_i$ of jaxroll.
"""

import numpy as np
from scipy.optimize import root

# Fig. 3 and (82)-(83), with what the chapter leaves open as `jxr.scenes.pinch` chooses it.
L1, L2, L3, K1, K2 = 0.065, 0.039, 0.026, 0.065, 0.065
M1, M2, M3, N1, N2 = 0.045, 0.025, 0.015, 0.045, 0.040
APART, WIDTH, HEIGHT, MASS = 0.055, 0.03, 0.05, 0.02
BETA, ALPHA, DAMPING = 20.0, 1e-3, 0.006
A, AHEAD = 1.0 / 40.0, 0.01
S_START = (0.004, -0.003)
NEAR_START = (0.0275, 0.115, 0.0, 2.2, -0.9, 0.3, 0.95, 0.85)
# Of the state: all of it, its coordinates, what jaxroll's error control looks at.
SIZE, COORDINATES, CONTROLLED = 18, 8, 16
# Peers control s [m] a hundred times tighter than angles [rad].
SCALES = np.array([1.0] * 16 + [0.01] * 2)

HALF, INERTIA = 0.5 * WIDTH, MASS * (WIDTH**2 + HEIGHT**2) / 12.0
# Uniform slender rods: the inertia of a finger is G_jk cos(phi_j - phi_k), of the second one D_jk.
G11, G22, G33 = (M1 / 3.0 + M2 + M3) * L1**2, (M2 / 3.0 + M3) * L2**2, M3 / 3.0 * L3**2
G12, G13, G23 = (0.5 * M2 + M3) * L1 * L2, 0.5 * M3 * L1 * L3, 0.5 * M3 * L2 * L3
D11, D22, D12 = (N1 / 3.0 + N2) * K1**2, N2 / 3.0 * K2**2, 0.5 * N2 * K1 * K2

LENGTHS, SIGNS = (np.array([L1, L2, L3]), np.array([K1, K2])), (-1.0, 1.0)


def links_of(x):
    """Absolute angles of both fingers' links."""
    return np.cumsum(x[3:6]), np.cumsum(x[6:8])


def _tip(s):
    """b.gamma and n.gamma of (82)-(83)."""
    far = np.sqrt(A**2 + s**2)
    x, y = AHEAD + A - far, A * np.arcsinh(s / A)
    return (A * y - s * x) / far, -(A * x + s * y) / far


def closure(x, s):
    """Q_n1, Q_n2, Q_b1, Q_b2 of (5)-(6) [m] and both tangency errors [rad]."""
    e, d = np.array([np.cos(x[2]), np.sin(x[2])]), np.array([np.sin(x[2]), -np.cos(x[2])])
    gaps = np.empty(6)
    for i, (angles, sign) in enumerate(zip(links_of(x), SIGNS, strict=True)):
        b, n = _tip(s[i])
        end = np.array([LENGTHS[i] @ np.cos(angles) + i * APART, LENGTHS[i] @ np.sin(angles)])
        gaps[i] = -sign * (end - x[:2]) @ e - n + HALF
        gaps[2 + i] = (end - x[:2]) @ d + b - s[i]
        gaps[4 + i] = angles[-1] - x[2] - 0.5 * np.pi + sign * np.arctan(s[i] / A)
    return gaps


def coefficients(x, s):
    """Coefficients of f_1, f_2, lambda_1, lambda_2 in (1)-(3)."""
    rows, joints = np.zeros((4, 8)), (slice(3, 6), slice(6, 8))
    sin_t, cos_t = np.sin(x[2]), np.cos(x[2])
    for i, (angles, sign) in enumerate(zip(links_of(x), SIGNS, strict=True)):
        b, n = _tip(s[i])
        along = sign * LENGTHS[i] * np.sin(angles - x[2])
        across = -LENGTHS[i] * np.cos(angles - x[2])
        along[-1] -= sign * b
        across[-1] -= sign * n
        rows[i, :3] = sign * cos_t, sign * sin_t, sign * s[i]
        rows[2 + i, :3] = -sin_t, cos_t, sign * HALF
        rows[i, joints[i]] = np.cumsum(along[::-1])[::-1]
        rows[2 + i, joints[i]] = np.cumsum(across[::-1])[::-1]
    return rows


def _inertia(x):
    """G(X) of (15)."""
    (a, b, c), (u, v) = links_of(x)
    h12, h13, h23, k = G12 * np.cos(a - b), G13 * np.cos(a - c), G23 * np.cos(b - c), D12 * np.cos(u - v)
    sums = np.tril(np.ones((3, 3)))
    inertia = np.diag([MASS, MASS, INERTIA, *np.zeros(5)])
    inertia[3:6, 3:6] = sums.T @ np.array([[G11, h12, h13], [h12, G22, h23], [h13, h23, G33]]) @ sums
    inertia[6:, 6:] = sums[:2, :2].T @ np.array([[D11, k], [k, D22]]) @ sums[:2, :2]
    return inertia


def start():
    """The pose at rest, nearest to NEAR_START in its inertia, that closes both contacts at S_START."""
    near, lean = np.array(NEAR_START), np.array([[0, 0, -1, 1, 1, 1, 0, 0], [0, 0, -1, 0, 0, 0, 1, 1]])
    inertia = 1e3 * _inertia(near)

    def optimality(unknown):
        x, forces = unknown[:8], unknown[8:]
        rows = np.vstack([coefficients(x, S_START), lean])
        return np.concatenate([inertia @ (x - near) + rows.T @ forces, closure(x, S_START)])

    found = root(optimality, np.concatenate([near, np.zeros(6)]), tol=1e-15)
    return np.concatenate([found.x[:8], np.zeros(8), S_START])


def onto_constraints(x):
    """The nearest state that satisfies closure, tangency and all velocity constraints."""
    position, velocity = x[[*range(8), 16, 17]], x[8:16]
    for _ in range(3):
        gaps = closure(position[:8], position[8:])
        position = position - np.linalg.lstsq(_slopes(position), gaps)[0]
    rows = coefficients(position[:8], position[8:])
    velocity = velocity - np.linalg.lstsq(rows, rows @ velocity)[0]
    return np.concatenate([position[:8], velocity, position[8:]])


def _slopes(position):
    """Central differences of the closure with respect to X and s."""
    steps = 1e-6 * np.eye(10)
    ends = [[closure(p[:8], p[8:]) for p in (position + h, position - h)] for h in steps]
    return np.array([(after - before) / 2e-6 for after, before in ends]).T
