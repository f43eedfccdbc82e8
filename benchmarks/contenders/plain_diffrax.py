"""The pivoted scene as a JAX user would write it: arrays of shape (3,), `@`, `solve`, `diffeqsolve`.

The same index-1 equations (56)-(75) as `pivoted_numba`, in the same clockwise angles; no code shared
with jaxroll.
"""

import diffrax
import jax
import jax.numpy as jnp

from benchmarks.contenders.pivoted_numba import (
    A_OBJECT,
    A_TIP,
    DAMPING,
    INERTIA,
    L1,
    L2,
    M1,
    M2,
    PIVOT_X,
    PIVOT_Y,
    SHIFT,
    STIFFNESS,
    X_OBJECT,
    X_TIP,
)
from jaxroll._xla._one_kernel import WIDE


def _tangent(s, a):
    """Unit tangent of a catenary and its curvature, at arclength s from its vertex."""
    root = jnp.sqrt(a**2 + s**2)
    return jnp.array([s, a]) / root, a / root**2


def _turned(a):
    return jnp.array([a[1], -a[0]])


def _lengths(s):
    """(60)-(63) as pairs (l_b, l_n) of fingertip and object, curvatures, the object's tangent."""
    u = s - SHIFT
    (sin1, cos1), kappa1 = _tangent(u, A_OBJECT)
    (sin0, cos0), kappa0 = _tangent(-s, A_TIP)
    point = jnp.array([X_OBJECT + jnp.sqrt(A_OBJECT**2 + u**2), A_OBJECT * jnp.arcsinh(u / A_OBJECT)])
    tip = jnp.array([X_TIP - jnp.sqrt(A_TIP**2 + s**2), A_TIP * jnp.arcsinh(s / A_TIP)])
    l_tip = jnp.array([[sin0, cos0], [cos0, -sin0]]) @ tip
    l_object = -jnp.array([[sin1, cos1], [cos1, -sin1]]) @ point
    return l_tip, l_object, kappa0, kappa1, jnp.array([sin1, cos1])


def _mass_matrix(q):
    near = M1 * L1**2 / 3 + M2 * L1**2 + M2 * L2**2 / 3 + M2 * L1 * L2 * jnp.cos(q[2])
    cross, far = M2 * L2**2 / 3 + M2 * L1 * L2 / 2 * jnp.cos(q[2]), M2 * L2**2 / 3
    return jnp.array([[INERTIA, 0.0, 0.0], [0.0, near, cross], [0.0, cross, far]])


def _loads(q, v, jacobian, position):
    """Torques of (75) less the velocity terms of (74)."""
    pull = STIFFNESS * jacobian.T @ (position - jnp.array([PIVOT_X, PIVOT_Y]))
    swing = M2 * L1 * L2 / 2 * jnp.sin(q[2]) * jnp.array([(2 * v[1] + v[2]) * v[2], -(v[1] ** 2)])
    return jnp.concatenate([jnp.zeros(1), -DAMPING * v[1:] - pull + swing])


def rates(t, y, args):
    """Right-hand side of y = (theta, q1, q2, their rates, s), shape (7,)."""
    q, v, s = y[:3], y[3:6], y[6]
    (l_b0, l_n0), (l_b1, l_n1), kappa0, kappa1, (sin1, cos1) = _lengths(s)
    angles = jnp.cumsum(q[1:])
    links = jnp.array([[L1], [L2]]) * jnp.stack([jnp.cos(angles), -jnp.sin(angles)], axis=1)
    turn = jnp.array([[jnp.sin(q[0]), jnp.cos(q[0])], [jnp.cos(q[0]), -jnp.sin(q[0])]])
    b = turn @ jnp.array([cos1, sin1])
    n = _turned(b)
    jacobian = jnp.stack([_turned(links[0] + links[1]), _turned(links[1])], axis=1)
    spins = jnp.cumsum(v[1:])
    rate = (spins[1] - v[0]) / (kappa0 + kappa1)
    tilt = v[0] + kappa1 * rate
    velocity, pull = jacobian @ v[1:], -(spins**2) @ links
    rows = jnp.stack([jnp.append(l_b1, n @ jacobian + l_b0), jnp.append(-l_n1, b @ jacobian - l_n0)])
    along = v[0] * (kappa1 * l_n1 - 1) + spins[1] * (1 - kappa0 * l_n0)
    across = v[0] * kappa1 * l_b1 - spins[1] * kappa0 * l_b0
    bias = jnp.array([along, across]) * rate
    bias += jnp.array([pull @ n - tilt * velocity @ b, pull @ b + tilt * velocity @ n])
    loads = _loads(q, v, jacobian, links.sum(axis=0))
    solved = jnp.linalg.solve(_mass_matrix(q), jnp.column_stack([loads, rows.T]))
    free, by_forces = solved[:, 0], solved[:, 1:]
    forces = jnp.linalg.solve(rows @ by_forces, rows @ free + bias)
    return jnp.concatenate([v, free - by_forces @ forces, rate[None]])


def run(y0, t1, tolerance, solver):
    """State at t1 [s]; vmap over `y0`."""
    control = diffrax.PIDController(rtol=tolerance, atol=tolerance)
    term = diffrax.ODETerm(rates)
    return diffrax.diffeqsolve(term, solver, 0.0, t1, 1e-4, y0, stepsize_controller=control).ys[0]


lanes = jax.jit(jax.vmap(run, in_axes=(0, None, None, None)), static_argnames="solver", compiler_options=WIDE)
