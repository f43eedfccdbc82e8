"""Vectors, poses, twists, quaternions and symmetric forms of space, every component its own leaf.

The counterpart of `_plane`, for surfaces, `Contact3` and the bodies of space. Constant entries, such as
those of a unit vector, are Python's own 0.0 and 1.0, which `times` and `plus` leave out of the program.
Quaternions are tuples of four scalars, the scalar part first; as rotations they must have unit length.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from .._types import Scalar
from ._plane import inner, minus, opposite, plus, times, total

Quaternion = tuple[Scalar, Scalar, Scalar, Scalar]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Vec3:
    """A vector of space."""

    x: Scalar
    y: Scalar
    z: Scalar

    def __add__(self, other: "Vec3") -> "Vec3":
        return Vec3(plus(self.x, other.x), plus(self.y, other.y), plus(self.z, other.z))

    def __sub__(self, other: "Vec3") -> "Vec3":
        return Vec3(minus(self.x, other.x), minus(self.y, other.y), minus(self.z, other.z))

    def __neg__(self) -> "Vec3":
        return Vec3(*map(opposite, self))

    def __mul__(self, factor: Scalar) -> "Vec3":
        return Vec3(times(self.x, factor), times(self.y, factor), times(self.z, factor))

    def __iter__(self) -> Iterator[Scalar]:
        yield self.x
        yield self.y
        yield self.z

    def dot(self, other: "Vec3") -> Scalar:
        """Inner product."""
        return inner(tuple(self), tuple(other))

    def cross(self, other: "Vec3") -> "Vec3":
        """Cross product."""
        return Vec3(
            minus(times(self.y, other.z), times(self.z, other.y)),
            minus(times(self.z, other.x), times(self.x, other.z)),
            minus(times(self.x, other.y), times(self.y, other.x)),
        )

    def norm(self) -> Scalar:
        """Length; its derivative is not defined at zero."""
        return jnp.sqrt(self.dot(self))

    def array(self) -> jax.Array:
        """An array of shape (..., 3), for callers."""
        # Constant entries are Python's own numbers, without the axes of a batch.
        return jnp.stack(jnp.broadcast_arrays(self.x, self.y, self.z), axis=-1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Twist3:
    """Velocity of a body in world axes: of its frame's origin [m/s], and its spin [rad/s]."""

    velocity: Vec3
    spin: Vec3

    def __add__(self, other: "Twist3") -> "Twist3":
        return Twist3(self.velocity + other.velocity, self.spin + other.spin)

    def __sub__(self, other: "Twist3") -> "Twist3":
        return Twist3(self.velocity - other.velocity, self.spin - other.spin)

    def __mul__(self, factor: Scalar) -> "Twist3":
        return Twist3(self.velocity * factor, self.spin * factor)

    def at(self, arm: Vec3) -> Vec3:
        """Velocity of the body's point at the end of an arm from the frame's origin, in world axes."""
        return self.velocity + self.spin.cross(arm)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Pose3:
    """A body frame in the world: its origin, and its three axes (the columns of the rotation)."""

    origin: Vec3
    x: Vec3
    y: Vec3
    z: Vec3

    def turn(self, vector: Vec3) -> Vec3:
        """A body-frame direction in world axes."""
        return self.x * vector.x + self.y * vector.y + self.z * vector.z

    def back(self, vector: Vec3) -> Vec3:
        """A world direction in the body's axes."""
        return Vec3(self.x.dot(vector), self.y.dot(vector), self.z.dot(vector))

    def place(self, point: Vec3) -> Vec3:
        """A body-frame point in world coordinates."""
        return self.origin + self.turn(point)

    def local(self, point: Vec3) -> Vec3:
        """A world point in the body's frame."""
        return self.back(point - self.origin)

    def rate(self, twist: Twist3) -> "Pose3":
        """Time derivative of this pose under a twist, as a tangent for autodiff."""
        spin = twist.spin
        return Pose3(twist.velocity, spin.cross(self.x), spin.cross(self.y), spin.cross(self.z))

    def turning(self, spin: Vec3) -> "Pose3":
        """The same under a spin about the frame's origin."""
        return self.rate(Twist3(Vec3(0.0, 0.0, 0.0), spin))


def rotation(q: Quaternion) -> tuple[Vec3, Vec3, Vec3]:
    """The columns of the rotation of a unit quaternion: the body's axes in the world."""
    # 1 + 2 w [v]_x + 2 [v]_x^2 with the vector part v, column by column.
    w, x, y, z = q
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    return (
        Vec3(1.0 - 2.0 * (yy + zz), 2.0 * (xy + wz), 2.0 * (xz - wy)),
        Vec3(2.0 * (xy - wz), 1.0 - 2.0 * (xx + zz), 2.0 * (yz + wx)),
        Vec3(2.0 * (xz + wy), 2.0 * (yz - wx), 1.0 - 2.0 * (xx + yy)),
    )


def pose_at(origin: Vec3, q: Quaternion) -> Pose3:
    """The pose of a frame with this origin and this unit quaternion."""
    return Pose3(origin, *rotation(q))


def quaternion_of(frame: Pose3) -> Quaternion:
    """The unit quaternion, scalar first, of a frame's axes; its scalar part is not negative.

    Sums and differences of the rotation's entries give the products 4 q_i q_j. Row i of their table is a
    multiple of the quaternion, well-conditioned where q_i is large: the row with the largest 4 q_i^2 is used.
    """
    # `sums` are 4 q_i^2, `turned` 4 w times x, y, z, and `mixed` 4 x y, 4 x z, 4 y z. `x.y` is the entry
    # in row y of column x.
    x, y, z = frame.x, frame.y, frame.z
    sums = (
        1.0 + x.x + y.y + z.z,
        1.0 + x.x - y.y - z.z,
        1.0 - x.x + y.y - z.z,
        1.0 - x.x - y.y + z.z,
    )
    turned, mixed = (y.z - z.y, z.x - x.z, x.y - y.x), (x.y + y.x, z.x + x.z, y.z + z.y)
    rows = (
        (sums[0], *turned),
        (turned[0], sums[1], mixed[0], mixed[1]),
        (turned[1], mixed[0], sums[2], mixed[2]),
        (turned[2], mixed[1], mixed[2], sums[3]),
    )
    table, largest = jnp.stack([jnp.stack(row) for row in rows]), jnp.argmax(jnp.stack(sums))
    # q and -q are the same rotation: of the two, the one with w >= 0.
    found = jnp.where(table[largest, 0] < 0, -1.0, 1.0) * table[largest]
    return normalised((found[0], found[1], found[2], found[3]))


def seven(frame: Pose3) -> jax.Array:
    """A pose as an array for callers: position and unit quaternion, shape (7,)."""
    return jnp.stack([*frame.origin, *quaternion_of(frame)])


def quaternion_product(left: Quaternion, right: Quaternion) -> Quaternion:
    """Hamilton's product: the rotation of `left` after that of `right`."""
    # (a, u)(b, v) = (a b - u . v, a v + b u + u x v).
    a, u = left[0], Vec3(*left[1:])
    b, v = right[0], Vec3(*right[1:])
    return (minus(times(a, b), u.dot(v)), *(v * a + u * b + u.cross(v)))


def conjugate(q: Quaternion) -> Quaternion:
    """The inverse of a unit quaternion."""
    return (q[0], -q[1], -q[2], -q[3])


def normalised(q: Quaternion) -> Quaternion:
    """A quaternion scaled to unit length."""
    scale = 1.0 / jnp.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale)


def quaternion_rate(q: Quaternion, spin: Vec3) -> Quaternion:
    r"""$\dot q = \frac12 (0, \omega)\,q$ with the spin $\omega$ in world axes."""
    half = spin * 0.5
    vector = Vec3(q[1], q[2], q[3])
    return (-half.dot(vector), *(half * q[0] + half.cross(vector)))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Sym3:
    """A symmetric 3x3 matrix."""

    xx: Scalar
    xy: Scalar
    xz: Scalar
    yy: Scalar
    yz: Scalar
    zz: Scalar

    def __add__(self, other: "Sym3") -> "Sym3":
        return Sym3(*map(plus, self, other))

    def __sub__(self, other: "Sym3") -> "Sym3":
        return Sym3(*map(minus, self, other))

    def __mul__(self, factor: Scalar) -> "Sym3":
        return Sym3(*(times(a, factor) for a in self))

    def __iter__(self) -> Iterator[Scalar]:
        yield from (self.xx, self.xy, self.xz, self.yy, self.yz, self.zz)

    def trace(self) -> Scalar:
        """Sum of the eigenvalues."""
        return plus(plus(self.xx, self.yy), self.zz)

    def minors(self) -> Scalar:
        """Sum of the products of two eigenvalues: the determinant within a plane, if its normal maps to 0."""
        pairs = ((self.xx, self.yy), (self.xx, self.zz), (self.yy, self.zz))
        mixed = (self.xy, self.xz, self.yz)
        return minus(total([times(*pair) for pair in pairs]), inner(mixed, mixed))

    def squares(self) -> Scalar:
        """Sum of all nine squared entries, which is that of the squared eigenvalues."""
        # Each entry off the diagonal stands in the matrix twice.
        main, mixed = (self.xx, self.yy, self.zz), (self.xy, self.xz, self.yz)
        return plus(inner(main, main), times(2.0, inner(mixed, mixed)))

    def apply(self, vector: Vec3) -> Vec3:
        """The matrix times a vector."""
        rows = ((self.xx, self.xy, self.xz), (self.xy, self.yy, self.yz), (self.xz, self.yz, self.zz))
        return Vec3(*(inner(row, tuple(vector)) for row in rows))

    def form(self, left: Vec3, right: Vec3) -> Scalar:
        """The bilinear form of two vectors."""
        return left.dot(self.apply(right))

    def turned(self, frame: Pose3) -> "Sym3":
        """A matrix given in a body's axes, in world axes: R A R^T."""
        # The frame's axes are the columns of R; its rows are the world's axes in the body.
        rows = (Vec3(*axes) for axes in zip(frame.x, frame.y, frame.z, strict=True))
        x, y, z = rows
        ax, ay, az = self.apply(x), self.apply(y), self.apply(z)
        return Sym3(x.dot(ax), x.dot(ay), x.dot(az), y.dot(ay), y.dot(az), z.dot(az))

    def array(self) -> jax.Array:
        """An array of shape (..., 3, 3), for callers."""
        rows = ((self.xx, self.xy, self.xz), (self.xy, self.yy, self.yz), (self.xz, self.yz, self.zz))
        return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def outer(left: Vec3, right: Vec3) -> Sym3:
    """The symmetric part of the product of a column and a row, (a b^T + b a^T) / 2."""
    a, b = left, right
    return Sym3(
        a.x * b.x,
        0.5 * (a.x * b.y + a.y * b.x),
        0.5 * (a.x * b.z + a.z * b.x),
        a.y * b.y,
        0.5 * (a.y * b.z + a.z * b.y),
        a.z * b.z,
    )


def square(vector: Vec3) -> Sym3:
    """The product of a column with itself as a row, a a^T."""
    x, y, z = vector
    return Sym3(x * x, x * y, x * z, y * y, y * z, z * z)


# The axes of a frame that is not turned, in Python's own numbers: nothing is traced of products with them.
UNIT_AXES = (Vec3(1.0, 0.0, 0.0), Vec3(0.0, 1.0, 0.0), Vec3(0.0, 0.0, 1.0))


def tangents(normal: Vec3) -> tuple[Vec3, Vec3]:
    r"""Two unit tangents $t_1, t_2$ with $t_1 \times t_2 = n$.

    Smooth in the normal, and well-conditioned, but for the circle $n_z = -1/2$, where the frame jumps: no
    smooth one exists on the whole sphere.
    """
    # The basis of Duff et al. (2017), which divides by sign + z: with the sign changed at z = -1/2 that is at
    # least 1/2 in size.
    x, y, z = normal
    sign = jnp.where(z < -0.5, -1.0, 1.0).astype(jnp.result_type(z))
    share = -1.0 / (sign + z)
    mixed = x * y * share
    first = Vec3(1.0 + sign * x * x * share, sign * mixed, -sign * x)
    return first, Vec3(mixed, sign + y * y * share, -y)
