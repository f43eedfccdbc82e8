"""Small vectors, planar poses and unrolled small solves whose every component is its own leaf.

XLA fuses a program of scalars into a few loops, and batches it with `vmap` into unit-stride vector code;
arrays of shape (2,) or (3,) break both. So the dynamics works on these records, public functions on arrays.

Matrices are symmetric positive definite and given by their lower triangle as nested tuples.
"""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .._types import Scalar, Scalars
from .._xla import as_it_is, once, sine_cosine

Triangle = Sequence[Sequence[Scalar]]


def times(left: Scalar, right: Scalar) -> Scalar:
    """Product; nothing is traced where a factor is Python's own 0.0 or 1.0, as constant entries are.

    For -1.0 it is a negation: XLA would join products with constants, and then move the constants about.
    """
    for a, b in ((left, right), (right, left)):
        if isinstance(a, float) and a in (0.0, 1.0, -1.0):
            return 0.0 if a == 0.0 else b if a == 1.0 else -b
    return left * right


def plus(left: Scalar, right: Scalar) -> Scalar:
    """Sum; nothing is traced where a term is Python's own 0.0."""
    if isinstance(left, float) and left == 0.0:
        return right
    return left if isinstance(right, float) and right == 0.0 else left + right


def minus(left: Scalar, right: Scalar) -> Scalar:
    """Difference; where a term is Python's own 0.0, at most a negation is traced."""
    if isinstance(right, float) and right == 0.0:
        return left
    return opposite(right) if isinstance(left, float) and left == 0.0 else left - right


def opposite(value: Scalar) -> Scalar:
    """The number with its sign changed; Python's own 0.0 stays as it is."""
    return value if isinstance(value, float) and value == 0.0 else -value


def root(square: Any) -> Any:
    """Square root, with a derivative of zero at zero.

    The true one is infinite there, and zero times it is NaN in reverse mode. Take this for a length that does
    not count where it vanishes, or whose zero a `where` does not select.
    """
    # `where` inside as well: a NaN of the branch that is not taken would be kept.
    zero = square == 0.0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, square)))


def inner(left: Sequence[Scalar], right: Sequence[Scalar]) -> Scalar:
    """Sum of products, number by number."""
    return functools.reduce(plus, [times(a, b) for a, b in zip(left, right, strict=True)], 0.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Vec2:
    """A vector of the plane."""

    x: Scalar
    y: Scalar

    def __add__(self, other: "Vec2") -> "Vec2":
        return Vec2(plus(self.x, other.x), plus(self.y, other.y))

    def __sub__(self, other: "Vec2") -> "Vec2":
        return Vec2(minus(self.x, other.x), minus(self.y, other.y))

    def __neg__(self) -> "Vec2":
        return Vec2(opposite(self.x), opposite(self.y))

    def __mul__(self, factor: Scalar) -> "Vec2":
        return Vec2(times(self.x, factor), times(self.y, factor))

    def __iter__(self) -> Iterator[Scalar]:
        yield self.x
        yield self.y

    def dot(self, other: "Vec2") -> Scalar:
        """Inner product."""
        return plus(times(self.x, other.x), times(self.y, other.y))

    def cross(self, other: "Vec2") -> Scalar:
        """The out-of-plane component of the cross product."""
        return minus(times(self.x, other.y), times(self.y, other.x))

    def left(self) -> "Vec2":
        """This vector turned by +90 degrees."""
        return Vec2(opposite(self.y), self.x)

    def right(self) -> "Vec2":
        """This vector turned by -90 degrees."""
        return Vec2(self.y, opposite(self.x))

    def array(self) -> jax.Array:
        """An array of shape (..., 2), for callers."""
        # Constant entries are Python's own numbers, without the axes of a batch.
        return jnp.stack(jnp.broadcast_arrays(self.x, self.y), axis=-1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Twist2:
    """Velocity of a body: of its frame's origin in world axes [m/s], and of its angle [rad/s]."""

    velocity: Vec2
    spin: Scalar

    def __add__(self, other: "Twist2") -> "Twist2":
        return Twist2(self.velocity + other.velocity, plus(self.spin, other.spin))

    def __mul__(self, factor: Scalar) -> "Twist2":
        return Twist2(self.velocity * factor, times(self.spin, factor))

    def at(self, arm: Vec2) -> Vec2:
        """Velocity of the body's point at the end of an arm from the frame's origin, in world axes."""
        return self.velocity + arm.left() * self.spin


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Pose2:
    """A body frame in the world: its origin, and the cosine and sine of its angle."""

    origin: Vec2
    cos: Scalar
    sin: Scalar

    def turn(self, vector: Vec2) -> Vec2:
        """A body-frame direction in world axes."""
        return Vec2(self.cos * vector.x - self.sin * vector.y, self.sin * vector.x + self.cos * vector.y)

    def back(self, vector: Vec2) -> Vec2:
        """A world direction in the body's axes."""
        return Vec2(self.cos * vector.x + self.sin * vector.y, self.cos * vector.y - self.sin * vector.x)

    def place(self, point: Vec2) -> Vec2:
        """A body-frame point in world coordinates."""
        return self.origin + self.turn(point)

    def rate(self, twist: Twist2) -> "Pose2":
        """Time derivative of this pose under a twist, as a tangent for autodiff."""
        return Pose2(twist.velocity, -self.sin * twist.spin, self.cos * twist.spin)

    def turning(self, spin: Scalar) -> "Pose2":
        """The same under a spin about the frame's origin."""
        return self.rate(Twist2(Vec2(0.0, 0.0), spin))


def sincos(angle: Scalar) -> tuple[Scalar, Scalar]:
    """Sine and cosine, computed once; the equations of motion take no others."""
    return once(sine_cosine(angle))


def unstack(array: Any) -> Any:
    """An array as nested tuples of its scalars; a tuple is returned as it is."""
    # A tuple has been taken apart before: `prepared` may be called twice. A scalar is a leaf already.
    if isinstance(array, tuple) or array is None or jnp.ndim(array) == 0:
        return array
    rest = iter(_entries(array))

    def nested(shape: tuple[int, ...]) -> Any:
        return tuple(nested(shape[1:]) for _ in range(shape[0])) if shape else next(rest)

    return nested(jnp.shape(array))


@functools.partial(jax.jit, inline=True)  # where nothing is traced, one program instead of three
def _entries(array: jax.Array) -> list[jax.Array]:
    return scalars(array.ravel())


def scalars(vector: jax.Array) -> list[jax.Array]:
    """The entries of a vector, in one operation: the transpose of many slices would be as many sums."""
    if not vector.shape[0]:
        return []
    parts = jax.lax.split(vector, (1,) * vector.shape[0])
    return [jax.lax.squeeze(part, (0,)) for part in parts]


def total(terms: Sequence[Any]) -> Any:
    """Sum of scalars or vectors without a zero to start from; 0.0 where there are none."""
    if not terms:
        return 0.0
    # From the first term on: terms may be numbers, vectors of the plane or of space, or twists.
    result = terms[0]
    for term in terms[1:]:
        result = result + term
    return result


class Factor(NamedTuple):
    """LDL^T factorisation of a small symmetric positive definite matrix."""

    lower: tuple[Scalars, ...]  # strictly lower part of the unit triangle
    inverse_pivots: Scalars
    smallest_pivot: Scalar  # relative to the largest diagonal entry; not positive when singular


def factorise(matrix: Triangle) -> Factor:
    r"""Unrolled LDL^T; no square roots, and no library call that would break fusion.

    In $A = L D L^T$ row i of $L D$ is $s_j = a_{ij} - \sum_{k<j} s_k l_{jk}$, with which $l_{ij} = s_j / d_j$
    and $d_i = a_{ii} - \sum_k s_k l_{ik}$. A pivot $d_i$ that is not positive raises no error, because a
    batch cannot stop for one lane: `smallest_pivot` reports it.
    """
    if not matrix:
        return Factor((), (), jnp.ones(()))
    lower: list[Scalars] = []
    pivots: list[Scalar] = []
    inverse: list[Scalar] = []
    for i, row in enumerate(matrix):
        # The sum over k of s_k l_jk runs over k < j: as long as row j of the strict triangle is.
        scaled: list[Scalar] = []  # s_j
        for j in range(i):
            scaled.append(minus(row[j], inner(scaled, lower[j])))
        unit = once(tuple(times(s, d) for s, d in zip(scaled, inverse, strict=True)))
        pivot = minus(row[i], inner(scaled, unit))
        lower.append(unit)
        pivots.append(pivot)
        inverse.append(1.0 / pivot)
    # By the largest diagonal entry, so that the measure does not depend on units.
    largest = functools.reduce(jnp.maximum, [row[i] for i, row in enumerate(matrix)])
    return Factor(tuple(lower), tuple(inverse), functools.reduce(jnp.minimum, pivots) / largest)


def unknown_factor(size: int) -> Factor:
    """A factor of the right structure, full of zeros: the carry of a loop before its first turn."""
    zero = jnp.zeros(())
    return Factor(tuple((zero,) * i for i in range(size)), (zero,) * size, zero)


def solve(factor: Factor, right: Sequence[Scalar]) -> Scalars:
    """Solve A x = b with a factorised matrix: L y = b, D z = y, L^T x = z."""
    # Every number of a triangular solve goes into all that follow. With more than three of them, XLA would
    # make too many copies.
    kept = once if len(factor.lower) > 3 else as_it_is
    forward: list[Scalar] = []
    for row, value in zip(factor.lower, right, strict=True):
        forward.append(kept(minus(value, inner(row, forward))))
    backward = [times(value, d) for value, d in zip(forward, factor.inverse_pivots, strict=True)]
    for i in reversed(range(len(backward))):
        # Row i of L^T is column i of L, below the diagonal.
        below = range(i + 1, len(backward))
        for j in below:
            backward[i] = minus(backward[i], times(factor.lower[j][i], backward[j]))
        backward[i] = kept(backward[i])
    return tuple(backward)
