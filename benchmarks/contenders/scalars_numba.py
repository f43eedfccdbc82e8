"""Scalar pieces for hand-written Numba scenes: sine with cosine, small solves by cofactors."""

from math import floor

from numba import njit

inlined = njit(inline="always", error_model="numpy", fastmath=True)
compiled = njit(error_model="numpy", fastmath=True)

# Minimax polynomials on [-pi/4, pi/4], after fdlibm.
S1, S2, S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
S4, S5, S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
C1, C2, C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
C4, C5, C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11


@inlined
def sincos(x):
    """Both at once for an angle of a few turns: faster than the two calls of the C library."""
    k = floor(x * 0.6366197723675814 + 0.5)
    r = (x - k * 1.5707963267948966) - k * 6.123233995736766e-17
    z = r * r
    s = r + r * z * (S1 + z * (S2 + z * (S3 + z * (S4 + z * (S5 + z * S6)))))
    c = 1.0 - 0.5 * z + z * z * (C1 + z * (C2 + z * (C3 + z * (C4 + z * (C5 + z * C6)))))
    n = int(k)
    u, v = (c, s) if (n & 1) != 0 else (s, c)
    return -u if (n & 2) != 0 else u, -v if ((n + 1) & 2) != 0 else v


@inlined
def dot2(a, b):
    return a[0] * b[0] + a[1] * b[1]


@inlined
def dot3(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def solved2(diagonal, h, a, b, c):
    """Three right-hand sides through a symmetric 2x2 matrix; `h` is off its diagonal."""
    h11, h22 = diagonal
    det = 1.0 / (h11 * h22 - h * h)
    one, two = (h22 * det, -h * det), (-h * det, h11 * det)
    return (
        (dot2(one, a), dot2(two, a)),
        (dot2(one, b), dot2(two, b)),
        (dot2(one, c), dot2(two, c)),
    )


@inlined
def solved3(diagonal, h, a, b, c):
    """Three right-hand sides through a symmetric 3x3 matrix; `h` has its entries 12, 13 and 23."""
    h11, h22, h33 = diagonal
    h12, h13, h23 = h
    i11, i12, i13 = h22 * h33 - h23 * h23, h13 * h23 - h12 * h33, h12 * h23 - h13 * h22
    i22, i23, i33 = h11 * h33 - h13 * h13, h12 * h13 - h23 * h11, h11 * h22 - h12 * h12
    det = 1.0 / (h11 * i11 + h12 * i12 + h13 * i13)
    one, two = (i11 * det, i12 * det, i13 * det), (i12 * det, i22 * det, i23 * det)
    three = (i13 * det, i23 * det, i33 * det)
    return (
        (dot3(one, a), dot3(two, a), dot3(three, a)),
        (dot3(one, b), dot3(two, b), dot3(three, b)),
        (dot3(one, c), dot3(two, c), dot3(three, c)),
    )
