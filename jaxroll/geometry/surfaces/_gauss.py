r"""The Gauss frame of a surface at one place, and what follows from it alone.

The shape operator $L = dn$ maps a tangent displacement to the change of the outward normal $n$. Its
eigenvalues are the principal curvatures, positive where the body is convex: `principal` finds them.
`approach` is the step of searches for a closest point (`AbstractSurface.closest`, `contact.locating`).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from ..._linalg import Pose3, root, Sym3, tangents, Vec3
from ..._types import Scalar


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Gauss3:
    """Point, outward unit normal and shape operator of a surface at one place, in its body's frame."""

    point: Vec3
    normal: Vec3
    shape: Sym3

    def placed(self, pose: Pose3) -> "Gauss3":
        """The same in another frame."""
        return Gauss3(pose.place(self.point), pose.turn(self.normal), self.shape.turned(pose))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Principal:
    """Principal curvatures, the smaller first, and their unit directions."""

    low: Scalar
    high: Scalar
    along_low: Vec3
    along_high: Vec3


def principal(frame: Gauss3) -> Principal:
    """Principal curvatures and directions; at an umbilic, any two, and derivatives of the mean."""
    # L in a tangent frame: ((a, b), (b, c)), with eigenvalues mean +- sqrt(half^2 + b^2).
    first, second = tangents(frame.normal)
    a, b, c = (frame.shape.form(*pair) for pair in ((first, first), (first, second), (second, second)))
    mean, half = 0.5 * (a + c), 0.5 * (a - c)
    square = half * half + b * b
    # At an umbilic neither the root nor the angle has a derivative.
    round_, spread = square == 0.0, root(square)
    # The larger curvature's direction: tan(2 angle) = b / half.
    angle = 0.5 * jnp.arctan2(jnp.where(round_, 0.0, b), jnp.where(round_, 1.0, half))
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    along_high = first * cos + second * sin
    along_low = first * sin - second * cos
    return Principal(mean - spread, mean + spread, along_low, along_high)


def approach(frame: Gauss3, point: Vec3, *, careful: bool = True) -> Vec3:
    r"""Newton's tangent step towards the point of the surface closest to `point`, as a vector [m].

    With $r$ from the frame's point to `point` and $h = r \cdot n$, the step $\delta$ solves
    $(1 + h L)\,\delta = r - h n$. A careful one is cut to half the smallest radius of curvature.
    """
    first, second = tangents(frame.normal)
    away, form = point - frame.point, frame.shape.form
    height, x, y = away.dot(frame.normal), away.dot(first), away.dot(second)
    a, b, c = form(first, first), form(first, second), form(second, second)
    size = root(a * a + 2.0 * b * b + c * c)
    a, b, c = 1.0 + height * a, height * b, 1.0 + height * c
    if careful:
        # 1 + h L is half the second derivative of the squared distance. Beyond a centre of curvature it is
        # not positive, and Newton's step may increase the distance; there the step is a shortened gradient.
        convex = (a + c > 0.2) & (a * c - b * b > 0.01)
        damped = 1.0 + jnp.abs(height) * size
        a, b, c = jnp.where(convex, a, damped), jnp.where(convex, b, 0.0), jnp.where(convex, c, damped)
    det = a * c - b * b
    x, y = (c * x - b * y) / det, (a * y - b * x) / det
    if careful:
        # `size` is at least the largest curvature.
        shorter = 0.5 / jnp.maximum(0.5, size * root(x * x + y * y))
        x, y = x * shorter, y * shorter
    return first * x + second * y
