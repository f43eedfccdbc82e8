"""Oracles and measures shared by the tests; nothing here uses jaxroll's equations."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.geometry import Moved


def observed_order(sizes, errors):
    """Slope of log error over log size."""
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


def taylor_remainders(function, point, direction, slope, steps):
    """|f(x + h d) - f(x) - h f'(x) d| for each step h."""
    base = function(point)
    move = lambda h: jax.tree.map(lambda a, b: a + h * b, point, direction)  # noqa: E731
    return np.array([float(abs(function(move(h)) - base - h * slope)) for h in steps])


def broadcasting(function):
    """Let an oracle broadcast as NumPy does; the package itself is tested without."""

    @functools.wraps(function)
    def allowed(*args):
        with jax.numpy_rank_promotion("allow"):
            return function(*args)

    return allowed


def slow_among(names, *slow):
    """Names as parameters of a test, some of them marked slow."""
    assert set(slow) <= set(names)
    return [pytest.param(name, marks=[pytest.mark.slow] * (name in slow)) for name in names]


MIRROR = np.array([1.0, -1.0])


def mirrored_contour(contour):
    """The image under y -> -y, run through the other way; plain contours here are their own images."""
    if not isinstance(contour, Moved):
        return contour
    inner = mirrored_contour(contour.contour)
    return Moved(inner, MIRROR * contour.offset, -contour.angle, origin=-contour.origin)


def mirrored(grasp, states):
    """Grasp and states under y -> -y, with the other `sense` at every contact."""
    body = grasp.object
    contours = tuple(mirrored_contour(c) for c in body.contours)
    if isinstance(body, jxr.PivotedObject):
        body, signs = jxr.PivotedObject(contours, body.inertia, pivot=MIRROR * body.pivot), [-1.0]
    else:
        body, signs = jxr.FreeObject(contours, body.mass, body.inertia), [1.0, -1.0, -1.0]
    fingers = [
        jxr.Finger(f.lengths, f.masses, mirrored_contour(f.tip), base=MIRROR * f.base) for f in grasp.fingers
    ]
    contacts = [
        jxr.Contact(-c.s_tip, -c.s_object, finger=c.finger, contour=c.contour, sense=-c.sense)
        for c in grasp.contacts
    ]
    control = grasp.controller
    if isinstance(control, jxr.control.Press):
        control = eqx.tree_at(lambda c: c.target, control, MIRROR * control.target)
    else:
        control = eqx.tree_at(lambda c: c.start, control, -control.start)
    image = jxr.Grasp(body, fingers, contacts, controller=control)
    flip = np.array([*signs, *[-1.0] * (image.coordinates - len(signs))])
    return image, jxr.State(flip * states.q, flip * states.v, -states.s)


class Chapter:
    """The chapter's Part 2 in its own frame: clockwise angles, one coordinate s, (56)-(83).

    Nothing is shared with jaxroll: the loop of links, object and finger is closed by the law of
    cosines, the motion is that of one Lagrangian coordinate, and derivatives are JAX's of these
    closed forms. Misprints are corrected as the errata say.
    """

    def __init__(self, base=(0.0, 0.0), pivot=(0.03, 0.105)):
        # The mirror y -> -y takes the package's frame to the chapter's.
        self.base = jnp.array([base[0], -base[1]])
        self.pivot = jnp.array([pivot[0], -pivot[1]])
        self.l1, self.l2, self.m1, self.m2 = 0.065, 0.065, 0.045, 0.040
        self.inertia, self.stiffness, self.c = 6.6178e-6, 0.500 / 0.010, 0.006

    @staticmethod
    def object_contour(s):
        """(80)-(81)."""
        u = s - 3.363e-3
        return jnp.array(
            [-0.03 + jnp.sqrt(1 + 4 * 50**2 * u**2) / (2 * 50), jnp.arcsinh(2 * 50 * u) / (2 * 50)]
        )

    @staticmethod
    def tip_contour(s):
        """(82)-(83)."""
        return jnp.array(
            [0.035 - jnp.sqrt(1 + 4 * 20**2 * s**2) / (2 * 20), jnp.arcsinh(2 * 20 * s) / (2 * 20)]
        )

    def angles(self, s):
        """theta_1(s) and psi_0(s): (56)-(57)."""
        dx, dy = jax.jacfwd(self.object_contour)(s)
        dx0, dy0 = jax.jacfwd(self.tip_contour)(s)
        return jnp.arctan2(dx, dy), jnp.arctan2(dx0, dy0)

    def lengths(self, s):
        """l_b0, l_b1, l_n0, l_n1: (60)-(63)."""
        (x, y), (x0, y0) = self.object_contour(s), self.tip_contour(s)
        theta1, psi0 = self.angles(s)
        return (
            x0 * jnp.sin(psi0) + y0 * jnp.cos(psi0),
            -x * jnp.sin(theta1) - y * jnp.cos(theta1),
            x0 * jnp.cos(psi0) - y0 * jnp.sin(psi0),
            -x * jnp.cos(theta1) + y * jnp.sin(theta1),
        )

    def configuration(self, s):
        """(theta, q1, q2) at contact s, elbow on the scene's side."""
        theta1, psi0 = self.angles(s)
        # b_0 = b_1 of (58): (-cos(p + psi0), sin(p + psi0)) = (sin(th + th1), cos(th + th1)).
        phi = theta1 - psi0 + jnp.pi / 2  # p - theta
        e = lambda a: jnp.array([jnp.cos(a), -jnp.sin(a)])  # noqa: E731
        ex = jnp.array([jnp.sin(phi), jnp.cos(phi)])
        ey = jnp.array([-jnp.cos(phi), jnp.sin(phi)])
        x0, y0 = self.tip_contour(s)
        # Everything at theta = 0, then turned: pivot to the end of the first link.
        elbow = self.object_contour(s) - x0 * ex - y0 * ey - self.l2 * e(phi)
        span = self.pivot - self.base
        cosine = (self.l1**2 - span @ span - elbow @ elbow) / (
            2 * jnp.linalg.norm(span) * jnp.linalg.norm(elbow)
        )
        lead = jnp.arctan2(-elbow[1], elbow[0]) - jnp.arctan2(-span[1], span[0])
        return phi, lead, jnp.arccos(cosine), elbow, span

    def pose(self, s, branch):
        """(theta, q1, q2), with the branch of the law of cosines chosen by `branch` = +-1."""
        phi, lead, turn, elbow, span = self.configuration(s)
        theta = branch * turn - lead
        turned = jnp.array(
            [
                jnp.cos(theta) * elbow[0] + jnp.sin(theta) * elbow[1],
                -jnp.sin(theta) * elbow[0] + jnp.cos(theta) * elbow[1],
            ]
        )
        first = span + turned
        q1 = jnp.arctan2(-first[1], first[0])
        whole = lambda a: a - 2 * jnp.pi * jnp.round(a / (2 * jnp.pi))  # noqa: E731
        return jnp.array([whole(theta), q1, whole(phi + theta - q1)])

    def potential(self, s):
        """U(s), below (83)."""
        l_b0, l_b1, l_n0, l_n1 = self.lengths(s)
        return 0.5 * self.stiffness * ((l_b1 + l_b0) ** 2 + (l_n0 + l_n1) ** 2)

    def kinetic(self, q, v):
        """K: (71), uniform slender links."""
        i1, i2 = self.m1 * self.l1**2 / 12, self.m2 * self.l2**2 / 12
        r2 = self.l2 / 2
        g22 = self.m2 * r2**2 + i2
        g12 = g22 + self.m2 * self.l1 * r2 * jnp.cos(q[2])
        g11 = self.m1 * (self.l1 / 2) ** 2 + i1 + self.m2 * self.l1**2 + 2 * g12 - g22
        return 0.5 * (g11 * v[1] ** 2 + g22 * v[2] ** 2) + g12 * v[1] * v[2] + 0.5 * self.inertia * v[0] ** 2

    def acceleration(self, branch):
        """s'' = f(s, s') of the closed loop, as a compiled function."""

        def inertia(s):
            pose, rate = jax.jvp(lambda u: self.pose(u, branch), (s,), (jnp.ones_like(s),))
            return 2 * self.kinetic(pose, rate), rate

        def f(s, w):
            (m, rate), (dm, _) = jax.jvp(inertia, (s,), (jnp.ones_like(s),))
            damping = self.c * (rate[1] ** 2 + rate[2] ** 2)
            return (-jax.grad(self.potential)(s) - damping * w - 0.5 * dm * w**2) / m

        return jax.jit(f)
