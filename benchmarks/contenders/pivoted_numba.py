r"""The pivoted scene written by hand from the chapter's closed coefficients, in scalars for Numba.

Shares no code with jaxroll: equations (56)-(75) in the chapter's own mirror image (clockwise
angles), the errata applied, with state $x = [\theta, q_1, q_2, \dot\theta, \dot q_1, \dot q_2, s]$.
Angles and rates are those of jaxroll; the chapter's $s$ is jaxroll's $s_0 - \sigma$.
"""

from math import cos, log, sin, sqrt

import numpy as np

from benchmarks.contenders.scalars_numba import compiled, inlined, sincos

# Tables 1 and 2; uniform slender rods.
L1 = L2 = 0.065
M1, M2 = 0.045, 0.040
INERTIA = 6.6178e-6
STIFFNESS, DAMPING = 0.500 / 0.010, 0.006
# (80)-(83): catenaries of these vertex radii; the object's vertex sits at s = SHIFT.
A_OBJECT, A_TIP, SHIFT = 0.01, 0.025, 3.363e-3
X_OBJECT, X_TIP = -0.03, 0.035
# What the chapter leaves open, as `jxr.scenes.pivoted` chooses it: first joint at the origin, pivot
# (mirrored), starting contact, and a pose near the start.
PIVOT_X, PIVOT_Y = 0.03, -0.105
S_START = 0.003
NEAR_START = (-0.5, 1.9, -0.7)
# Of the state: all of it, its coordinates, and what error control looks at.
SIZE, COORDINATES, CONTROLLED = 7, 3, 6
# Peers control s [m] a hundred times tighter than angles [rad]: the curvatures add to 140 1/m.
SCALES = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.01])

_G_11 = M1 * L1**2 / 3.0 + M2 * L1**2 + M2 * L2**2 / 3.0
_G_22 = M2 * L2**2 / 3.0
_G_COS = M2 * L1 * L2 / 2.0


@inlined
def _lengths(s):
    """(56)-(57) as sines and cosines, (60)-(63), (69)-(70)."""
    u = s - SHIFT
    root, root0 = sqrt(A_OBJECT**2 + u * u), sqrt(A_TIP**2 + s * s)
    sin1, cos1 = u / root, A_OBJECT / root
    sin0, cos0 = -s / root0, A_TIP / root0
    x, y = X_OBJECT + root, A_OBJECT * log((u + root) / A_OBJECT)
    x0, y0 = X_TIP - root0, A_TIP * log((s + root0) / A_TIP)
    l_b0, l_n0 = x0 * sin0 + y0 * cos0, x0 * cos0 - y0 * sin0
    l_b1, l_n1 = -x * sin1 - y * cos1, -x * cos1 + y * sin1
    kappa0, kappa1 = A_TIP / (root0 * root0), A_OBJECT / (root * root)
    return l_b0, l_n0, l_b1, l_n1, kappa0, kappa1, sin1, cos1


@inlined
def _rows(theta, q1, q2, s):
    """Tip vector r01 - r, link ends, contact frame and the coefficients of (73)-(74)."""
    l_b0, l_n0, l_b1, l_n1, kappa0, kappa1, sin1, cos1 = _lengths(s)
    sin_t, cos_t = sincos(theta)
    b_x, b_y = sin_t * cos1 + cos_t * sin1, cos_t * cos1 - sin_t * sin1
    sin_1, cos_1 = sincos(q1)
    sin_2, cos_2 = sincos(q1 + q2)
    ax, ay = L1 * cos_1, -L1 * sin_1
    bx, by = L2 * cos_2, -L2 * sin_2
    # Columns of J01 are the link ends turned by -90 degrees; n1 is (b_y, -b_x).
    n_far, b_far = by * b_y + bx * b_x, by * b_x - bx * b_y
    n_all, b_all = n_far + ay * b_y + ax * b_x, b_far + ay * b_x - ax * b_y
    row_q = (l_b1, n_all + l_b0, n_far + l_b0)
    row_r = (-l_n1, b_all - l_n0, b_far - l_n0)
    return row_q, row_r, (ax, ay), (bx, by), (b_x, b_y), (l_b0, l_n0, l_b1, l_n1, kappa0, kappa1)


@inlined
def _loads(q2, v1, v2, link1, link2):
    """Torques of (75) less the velocity terms of (74), and the entries of G(q)."""
    sin2, cos2 = sincos(q2)
    rx, ry = link1[0] + link2[0] - PIVOT_X, link1[1] + link2[1] - PIVOT_Y
    pull_far = link2[1] * rx - link2[0] * ry
    pull_all = pull_far + link1[1] * rx - link1[0] * ry
    load1 = -DAMPING * v1 - STIFFNESS * pull_all + _G_COS * sin2 * (2.0 * v1 + v2) * v2
    load2 = -DAMPING * v2 - STIFFNESS * pull_far - _G_COS * sin2 * v1 * v1
    return load1, load2, _G_11 + 2.0 * _G_COS * cos2, _G_22 + _G_COS * cos2


@inlined
def _biases(vt, v1, v2, link1, link2, frame, lengths):
    """What (64)-(65), differentiated twice, hold besides accelerations; ds/dt from (68)."""
    l_b0, l_n0, l_b1, l_n1, kappa0, kappa1 = lengths
    b_x, b_y = frame
    w = v1 + v2
    rate = (w - vt) / (kappa0 + kappa1)
    turn = vt + kappa1 * rate
    vx, vy = link1[1] * v1 + link2[1] * w, -link1[0] * v1 - link2[0] * w
    ax, ay = -link1[0] * v1 * v1 - link2[0] * w * w, -link1[1] * v1 * v1 - link2[1] * w * w
    bias_q = (
        vt * (kappa1 * l_n1 - 1.0) * rate
        + w * (1.0 - kappa0 * l_n0) * rate
        + (ax * b_y - ay * b_x)
        - turn * (vx * b_x + vy * b_y)
    )
    bias_r = (
        vt * kappa1 * l_b1 * rate
        - w * kappa0 * l_b0 * rate
        + (ax * b_x + ay * b_y)
        + turn * (vx * b_y - vy * b_x)
    )
    return bias_q, bias_r, rate


@compiled
def accelerations(theta, q1, q2, vt, v1, v2, s):
    """Accelerations, ds/dt and the multipliers f, lambda of the index-1 equations."""
    cq, cr, link1, link2, frame, lengths = _rows(theta, q1, q2, s)
    load1, load2, g11, g12 = _loads(q2, v1, v2, link1, link2)
    bias_q, bias_r, rate = _biases(vt, v1, v2, link1, link2, frame, lengths)
    det = 1.0 / (g11 * _G_22 - g12 * g12)
    free1, free2 = (_G_22 * load1 - g12 * load2) * det, (g11 * load2 - g12 * load1) * det
    wq0, wr0 = cq[0] / INERTIA, cr[0] / INERTIA
    wq1, wq2 = (_G_22 * cq[1] - g12 * cq[2]) * det, (g11 * cq[2] - g12 * cq[1]) * det
    wr1, wr2 = (_G_22 * cr[1] - g12 * cr[2]) * det, (g11 * cr[2] - g12 * cr[1]) * det
    s_qq = cq[0] * wq0 + cq[1] * wq1 + cq[2] * wq2
    s_qr = cq[0] * wr0 + cq[1] * wr1 + cq[2] * wr2
    s_rr = cr[0] * wr0 + cr[1] * wr1 + cr[2] * wr2
    need_q = cq[1] * free1 + cq[2] * free2 + bias_q
    need_r = cr[1] * free1 + cr[2] * free2 + bias_r
    schur = 1.0 / (s_qq * s_rr - s_qr * s_qr)
    f, lam = (s_rr * need_q - s_qr * need_r) * schur, (s_qq * need_r - s_qr * need_q) * schur
    at = -wq0 * f - wr0 * lam
    a1, a2 = free1 - wq1 * f - wr1 * lam, free2 - wq2 * f - wr2 * lam
    return at, a1, a2, rate, f, lam


@compiled
def fill_rates(t, x, out):
    """Index-1 right-hand side into `out`."""
    at, a1, a2, rate, _, _ = accelerations(x[0], x[1], x[2], x[3], x[4], x[5], x[6])
    out[0], out[1], out[2] = x[3], x[4], x[5]
    out[3], out[4], out[5], out[6] = at, a1, a2, rate


@compiled
def rates(t, x):
    """Index-1 right-hand side as a new array."""
    out = np.empty(7)
    fill_rates(t, x, out)
    return out


@compiled
def closure(theta, q1, q2, s):
    """Q and R of (64)-(65) [m], and the sine of the tangency error."""
    l_b0, l_n0, l_b1, l_n1, _, _, sin1, cos1 = _lengths(s)
    sin_a, cos_a = sin(theta) * cos1 + cos(theta) * sin1, cos(theta) * cos1 - sin(theta) * sin1
    x = L1 * cos(q1) + L2 * cos(q1 + q2) - PIVOT_X
    y = -L1 * sin(q1) - L2 * sin(q1 + q2) - PIVOT_Y
    root0 = sqrt(A_TIP**2 + s * s)
    cos_p, sin_p = cos(q1 + q2), sin(q1 + q2)
    cos_0 = (cos_p * A_TIP + sin_p * s) / root0
    sin_0 = (sin_p * A_TIP - cos_p * s) / root0
    gap_q = x * cos_a - y * sin_a + l_n0 + l_n1
    gap_r = x * sin_a + y * cos_a + l_b0 + l_b1
    return gap_q, gap_r, -(cos_0 * cos_a + sin_0 * sin_a)


@compiled
def fill_residual_index1(t, y, yp, out):
    """Index-1 equations left implicit: x, then f and lambda, fixed by the accelerations."""
    cq, cr, link1, link2, frame, lengths = _rows(y[0], y[1], y[2], y[6])
    load1, load2, g11, g12 = _loads(y[2], y[4], y[5], link1, link2)
    bias_q, bias_r, rate = _biases(y[3], y[4], y[5], link1, link2, frame, lengths)
    out[0], out[1], out[2] = yp[0] - y[3], yp[1] - y[4], yp[2] - y[5]
    out[3] = INERTIA * yp[3] + cq[0] * y[7] + cr[0] * y[8]
    out[4] = g11 * yp[4] + g12 * yp[5] - load1 + cq[1] * y[7] + cr[1] * y[8]
    out[5] = g12 * yp[4] + _G_22 * yp[5] - load2 + cq[2] * y[7] + cr[2] * y[8]
    out[6] = yp[6] - rate
    out[7] = cq[0] * yp[3] + cq[1] * yp[4] + cq[2] * yp[5] + bias_q
    out[8] = cr[0] * yp[3] + cr[1] * yp[4] + cr[2] * yp[5] + bias_r


@compiled
def fill_residual_index2(t, y, yp, out):
    """Stabilised index-2 equations (Gear, Gupta, Leimkuhler): x, f, lambda and two more."""
    cq, cr, link1, link2, _, lengths = _rows(y[0], y[1], y[2], y[6])
    load1, load2, g11, g12 = _loads(y[2], y[4], y[5], link1, link2)
    for i in range(3):
        out[i] = yp[i] - y[3 + i] + cq[i] * y[9] + cr[i] * y[10]
    out[3] = INERTIA * yp[3] + cq[0] * y[7] + cr[0] * y[8]
    out[4] = g11 * yp[4] + g12 * yp[5] - load1 + cq[1] * y[7] + cr[1] * y[8]
    out[5] = g12 * yp[4] + _G_22 * yp[5] - load2 + cq[2] * y[7] + cr[2] * y[8]
    out[6] = (lengths[4] + lengths[5]) * yp[6] - (yp[1] + yp[2] - yp[0])
    out[7] = cq[0] * y[3] + cq[1] * y[4] + cq[2] * y[5]
    out[8] = cr[0] * y[3] + cr[1] * y[4] + cr[2] * y[5]
    out[9], out[10], _ = closure(y[0], y[1], y[2], y[6])


@compiled
def coefficients(theta, q1, q2, s):
    """Coefficients of f and lambda in (73)-(74): the two constraint rows."""
    row_q, row_r, _, _, _, _ = _rows(theta, q1, q2, s)
    return row_q, row_r


def _closure_slopes(position):
    """Central differences of the closure with respect to theta, q1, q2 and s."""
    steps = 1e-7 * np.eye(4)
    columns = [
        (np.array(closure(*(position + h))) - np.array(closure(*(position - h)))) / 2e-7 for h in steps
    ]
    return np.stack(columns, axis=1)


def start():
    """The pose at rest that closes (64)-(65) and tangency at s = S_START, by Newton's method."""
    position = np.array([*NEAR_START, S_START])
    for _ in range(50):
        slopes = _closure_slopes(position)[:, :3]
        position[:3] -= np.linalg.solve(slopes, np.array(closure(*position)))
    return np.concatenate([position[:3], np.zeros(3), [S_START]])


def onto_constraints(x):
    """The nearest state that satisfies closure, tangency and both velocity constraints."""
    position, velocity = x[[0, 1, 2, 6]], x[3:6]
    for _ in range(3):
        slopes = _closure_slopes(position)
        position = position - np.linalg.lstsq(slopes, np.array(closure(*position)))[0]
    rows = np.array(coefficients(*position))
    velocity = velocity - np.linalg.lstsq(rows, rows @ velocity)[0]
    return np.concatenate([position[:3], velocity, position[3:]])


def with_multipliers(x):
    """State with consistent f and lambda, and its rates, for an implicit solver."""
    at, a1, a2, rate, f, lam = accelerations(*x)
    return np.array([*x, f, lam]), np.array([*x[3:6], at, a1, a2, rate, 0.0, 0.0])
