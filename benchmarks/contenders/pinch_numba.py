r"""The pinch of Part 1 written by hand, in scalars for Numba, as fast as its author could make it.

Shares no code with jaxroll: equations (1)-(17) with the errata, in the chapter's signs, with state
$x = [X, \dot X, s_1, s_2]$ and $X = (x, y, \theta, q_1, q_2)$. Links carry their absolute angles, in
which the inertia of a finger holds cosines of differences only. Both contacts share the axes
$e = (\cos\theta, \sin\theta)$ and $d = \bar b = (\sin\theta, -\cos\theta)$; normal forces count along e
inside. Sines of the last links come from tangency, $p_i = \theta + \pi/2 \mp \arctan(s_i/a)$, so that
four sines and cosines serve the whole scene.
"""

from math import log, sqrt

import numpy as np

from benchmarks.contenders.pinch_geometry import (
    A,
    AHEAD,
    ALPHA,
    APART,
    BETA,
    CONTROLLED,
    COORDINATES,
    D11,
    D12,
    D22,
    DAMPING,
    G11,
    G12,
    G13,
    G22,
    G23,
    G33,
    HALF,
    INERTIA,
    K1,
    K2,
    L1,
    L2,
    L3,
    links_of,
    MASS,
    onto_constraints,
    SCALES,
    SIZE,
    start,
)
from benchmarks.contenders.scalars_numba import compiled, dot2, dot3, inlined, sincos, solved2, solved3

__all__ = [
    "accelerations",
    "CONTROLLED",
    "COORDINATES",
    "fill_rates",
    "fill_residual_index1",
    "onto_constraints",
    "rates",
    "SCALES",
    "SIZE",
    "start",
    "with_multipliers",
]

# p_i(0) of (17).
START = tuple(float(angles[-1]) for angles in links_of(start()))


@inlined
def _tip(s, sin_t, cos_t, sign):
    """b.gamma, n.gamma, 1/kappa; the last link's sine and cosine from tangency, and those seen from e."""
    root = sqrt(A * A + s * s)
    over = 1.0 / root
    sin_s, cos_s = s * over, A * over
    x, y = AHEAD + A - root, A * log((s + root) * (1.0 / A))
    b, n = cos_s * y - sin_s * x, -cos_s * x - sin_s * y
    sin_p, cos_p = cos_t * cos_s + sign * sin_t * sin_s, sign * cos_t * sin_s - sin_t * cos_s
    return b, n, root * root * (1.0 / A), (sin_p, cos_p, cos_s, sign * sin_s)


@inlined
def _link(angle, sin_t, cos_t):
    """Sine and cosine of a link's angle, and of the angle less theta."""
    s, c = sincos(angle)
    return s, c, s * cos_t - c * sin_t, c * cos_t + s * sin_t


@inlined
def _between(one, two):
    """Sine and cosine of the angle from link `two` to link `one`."""
    return one[0] * two[1] - one[1] * two[0], one[1] * two[1] + one[0] * two[0]


@inlined
def _bias(tip, p, turn, going_e, going_d, pull_e, pull_d, sign):
    """What the second derivative of (6) and (5) holds besides accelerations; ds/dt of (7).

    `going` is the velocity of O_i less the object's, `pull` the centripetal acceleration of O_i.
    """
    b, n, radius, _ = tip
    apart = sign * (turn - p)
    rate = apart * radius
    bias_e = pull_e - turn * (going_d + rate) + (radius + n) * apart * p
    bias_d = pull_d + turn * going_e + sign * apart * b * p
    return bias_e, bias_d, rate


@inlined
def _long(links, rows, spins, force, last):
    """Inertia, loads and constraint rows of the three-joint finger, per absolute angle."""
    one, two, three = links
    w1, w2, w3 = spins
    s12, c12 = _between(one, two)
    s13, c13 = _between(one, three)
    s23, c23 = _between(two, three)
    h12, h13, h23 = G12 * c12, G13 * c13, G23 * c23
    k12, k13, k23 = G12 * s12, G13 * s13, G23 * s23
    fx, fy = force
    load1 = L1 * (one[1] * fy - one[0] * fx) - DAMPING * (2.0 * w1 - w2) - k12 * w2 * w2 - k13 * w3 * w3
    load2 = L2 * (two[1] * fy - two[0] * fx) - DAMPING * (2.0 * w2 - w1 - w3)
    load2 += k12 * w1 * w1 - k23 * w3 * w3
    load3 = L3 * (three[1] * fy - three[0] * fx) - DAMPING * (w3 - w2) - ALPHA * last
    load3 += k13 * w1 * w1 + k23 * w2 * w2
    row_e = (-L1 * one[2], -L2 * two[2], rows[0] - L3 * three[2])
    row_d = (-L1 * one[3], -L2 * two[3], -L3 * three[3] - rows[1])
    return (h12, h13, h23), (load1, load2, load3), row_e, row_d


@inlined
def _short(links, rows, spins, force, last):
    """The same of the two-joint finger."""
    one, two = links
    w1, w2 = spins
    s12, c12 = _between(one, two)
    fx, fy = force
    k12 = D12 * s12
    load1 = K1 * (one[1] * fy - one[0] * fx) - DAMPING * (2.0 * w1 - w2) - k12 * w2 * w2
    load2 = K2 * (two[1] * fy - two[0] * fx) - DAMPING * (w2 - w1) - ALPHA * last + k12 * w1 * w1
    row_e = (-K1 * one[2], rows[0] - K2 * two[2])
    row_d = (-K1 * one[3], -K2 * two[3] - rows[1])
    return D12 * c12, (load1, load2), row_e, row_d


@inlined
def _terms(theta, a1, a2, a3, c1, c2, vx, vy, turn, w1, w2, w3, z1, z2, s1, s2):
    """Both fingers and contacts: what multiplies accelerations and forces, and what does not."""
    sin_t, cos_t = sincos(theta)
    tip1, tip2 = _tip(s1, sin_t, cos_t, -1.0), _tip(s2, sin_t, cos_t, 1.0)
    one, two, three = _link(a1, sin_t, cos_t), _link(a2, sin_t, cos_t), tip1[3]
    four, five = _link(c1, sin_t, cos_t), tip2[3]
    # O_1 - O_2, and the pull along it.
    apart_x = L1 * one[1] + L2 * two[1] + L3 * three[1] - K1 * four[1] - K2 * five[1] - APART
    apart_y = L1 * one[0] + L2 * two[0] + L3 * three[0] - K1 * four[0] - K2 * five[0]
    fx, fy = -BETA * apart_x, -BETA * apart_y
    long = _long((one, two, three), (tip1[0], -tip1[1]), (w1, w2, w3), (fx, fy), a3 - START[0])
    short = _short((four, five), (tip2[0], tip2[1]), (z1, z2), (-fx, -fy), c2 - START[1])
    object_e, object_d = cos_t * vx + sin_t * vy, sin_t * vx - cos_t * vy
    left = _bias(
        tip1,
        w3,
        turn,
        -L1 * w1 * one[2] - L2 * w2 * two[2] - L3 * w3 * three[2] - object_e,
        -L1 * w1 * one[3] - L2 * w2 * two[3] - L3 * w3 * three[3] - object_d,
        -L1 * w1 * w1 * one[3] - L2 * w2 * w2 * two[3] - L3 * w3 * w3 * three[3],
        L1 * w1 * w1 * one[2] + L2 * w2 * w2 * two[2] + L3 * w3 * w3 * three[2],
        -1.0,
    )
    right = _bias(
        tip2,
        z2,
        turn,
        -K1 * z1 * four[2] - K2 * z2 * five[2] - object_e,
        -K1 * z1 * four[3] - K2 * z2 * five[3] - object_d,
        -K1 * z1 * z1 * four[3] - K2 * z2 * z2 * five[3],
        K1 * z1 * z1 * four[2] + K2 * z2 * z2 * five[2],
        1.0,
    )
    return sin_t, cos_t, long, short, left, right


@inlined
def _forces(first, second, needs, s1, s2):
    """Normal (along e) and tangential forces: the 4x4 system in blocks of 2, one contact each."""
    mass, spin = 1.0 / MASS, 1.0 / INERTIA
    p11, p12, p22 = (
        first[0] + mass + s1 * s1 * spin,
        first[1] + HALF * s1 * spin,
        first[2] + mass + HALF * HALF * spin,
    )
    q11, q12, q22 = (
        second[0] + mass + s2 * s2 * spin,
        second[1] - HALF * s2 * spin,
        second[2] + mass + HALF * HALF * spin,
    )
    c11, c12 = mass + s1 * s2 * spin, -HALF * s1 * spin
    c21, c22 = HALF * s2 * spin, mass - HALF * HALF * spin
    det = 1.0 / (p11 * p22 - p12 * p12)
    t11, t12 = (p22 * c11 - p12 * c21) * det, (p22 * c12 - p12 * c22) * det
    t21, t22 = (p11 * c21 - p12 * c11) * det, (p11 * c22 - p12 * c12) * det
    q11 -= c11 * t11 + c21 * t21
    q12 -= c11 * t12 + c21 * t22
    q22 -= c12 * t12 + c22 * t22
    n1, n2, n3, n4 = needs
    n3 -= t11 * n1 + t21 * n2
    n4 -= t12 * n1 + t22 * n2
    over = 1.0 / (q11 * q22 - q12 * q12)
    e2, d2 = (q22 * n3 - q12 * n4) * over, (q11 * n4 - q12 * n3) * over
    e1 = (p22 * n1 - p12 * n2) * det - t11 * e2 - t12 * d2
    d1 = (p11 * n2 - p12 * n1) * det - t21 * e2 - t22 * d2
    return e1, d1, e2, d2


@compiled
def accelerations(x):
    """Accelerations of X (8), ds/dt (2) and f_1, f_2, lambda_1, lambda_2 of the index-1 equations."""
    a1, c1, w1, z1 = x[3], x[6], x[11], x[14]
    a2, w2, c2, z2 = a1 + x[4], w1 + x[12], c1 + x[7], z1 + x[15]
    s1, s2 = x[16], x[17]
    sin_t, cos_t, long, short, left, right = _terms(
        x[2], a1, a2, a2 + x[5], c1, c2, x[8], x[9], x[10], w1, w2, w2 + x[13], z1, z2, s1, s2
    )
    h, load, row_e, row_d = long
    free, by_e, by_d = solved3((G11, G22, G33), h, load, row_e, row_d)
    g, push, line_e, line_d = short
    loose, on_e, on_d = solved2((D11, D22), g, push, line_e, line_d)
    e1, d1, e2, d2 = _forces(
        (dot3(row_e, by_e), dot3(row_e, by_d), dot3(row_d, by_d)),
        (dot2(line_e, on_e), dot2(line_e, on_d), dot2(line_d, on_d)),
        (
            dot3(row_e, free) + left[0],
            dot3(row_d, free) + left[1],
            dot2(line_e, loose) + right[0],
            dot2(line_d, loose) + right[1],
        ),
        s1,
        s2,
    )
    along_e, along_d = (e1 + e2) / MASS, (d1 + d2) / MASS
    at = (s1 * e1 + s2 * e2 + HALF * (d1 - d2)) / INERTIA
    r1 = free[0] - by_e[0] * e1 - by_d[0] * d1
    r2 = free[1] - by_e[1] * e1 - by_d[1] * d1
    r3 = free[2] - by_e[2] * e1 - by_d[2] * d1
    u1 = loose[0] - on_e[0] * e2 - on_d[0] * d2
    u2 = loose[1] - on_e[1] * e2 - on_d[1] * d2
    ax, ay = cos_t * along_e + sin_t * along_d, sin_t * along_e - cos_t * along_d
    return ax, ay, at, r1, r2 - r1, r3 - r2, u1, u2 - u1, left[2], right[2], e1, -e2, d1, d2


@compiled
def fill_rates(t, x, out):
    """Index-1 right-hand side into `out`."""
    ax, ay, at, r1, r2, r3, u1, u2, rate1, rate2, _, _, _, _ = accelerations(x)
    for i in range(8):
        out[i] = x[8 + i]
    out[8], out[9], out[10], out[11], out[12], out[13] = ax, ay, at, r1, r2, r3
    out[14], out[15], out[16], out[17] = u1, u2, rate1, rate2


@compiled
def rates(t, x):
    """Index-1 right-hand side as a new array."""
    out = np.empty(SIZE)
    fill_rates(t, x, out)
    return out


@compiled
def fill_residual_index1(t, y, yp, out):
    """Index-1 equations left implicit: x, then f_1, f_2, lambda_1, lambda_2, fixed by the accelerations."""
    a1, c1, w1, z1 = y[3], y[6], y[11], y[14]
    a2, w2, c2, z2 = a1 + y[4], w1 + y[12], c1 + y[7], z1 + y[15]
    s1, s2, e1, d1, e2, d2 = y[16], y[17], y[18], y[20], -y[19], y[21]
    sin_t, cos_t, long, short, left, right = _terms(
        y[2], a1, a2, a2 + y[5], c1, c2, y[8], y[9], y[10], w1, w2, w2 + y[13], z1, z2, s1, s2
    )
    for i in range(8):
        out[i] = yp[i] - y[8 + i]
    h, load, row_e, row_d = long
    r1 = yp[11]
    r2 = r1 + yp[12]
    r3 = r2 + yp[13]
    u1, u2 = yp[14], yp[14] + yp[15]
    along_e, along_d = cos_t * yp[8] + sin_t * yp[9], sin_t * yp[8] - cos_t * yp[9]
    out[8], out[9] = MASS * along_e - e1 - e2, MASS * along_d - d1 - d2
    out[10] = INERTIA * yp[10] - s1 * e1 - s2 * e2 - HALF * (d1 - d2)
    out[11] = G11 * r1 + h[0] * r2 + h[1] * r3 - load[0] + row_e[0] * e1 + row_d[0] * d1
    out[12] = h[0] * r1 + G22 * r2 + h[2] * r3 - load[1] + row_e[1] * e1 + row_d[1] * d1
    out[13] = h[1] * r1 + h[2] * r2 + G33 * r3 - load[2] + row_e[2] * e1 + row_d[2] * d1
    g, push, line_e, line_d = short
    out[14] = D11 * u1 + g * u2 - push[0] + line_e[0] * e2 + line_d[0] * d2
    out[15] = g * u1 + D22 * u2 - push[1] + line_e[1] * e2 + line_d[1] * d2
    out[16], out[17] = yp[16] - left[2], yp[17] - right[2]
    turn = yp[10]
    out[18] = -along_e - s1 * turn + dot3(row_e, (r1, r2, r3)) + left[0]
    out[19] = -along_e - s2 * turn + dot2(line_e, (u1, u2)) + right[0]
    out[20] = -along_d - HALF * turn + dot3(row_d, (r1, r2, r3)) + left[1]
    out[21] = -along_d + HALF * turn + dot2(line_d, (u1, u2)) + right[1]


def with_multipliers(x):
    """State with consistent forces, and its rates, for an implicit solver."""
    return np.array([*x, *accelerations(x)[10:]]), np.array([*rates(0.0, x), 0.0, 0.0, 0.0, 0.0])
