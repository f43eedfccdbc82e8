r"""A pair of places on two surfaces, and Newton's step towards their closest points.

With the normals $n_a, n_b$, the arm $d = P_a - P_b$ and the gap $g = d \cdot n_b$, the pair is closest where
$n_a + n_b = 0$ and $d = g n_b$: four equations along the tangents. To first order the foot on `b` follows
$(1 + g L_b)\,y = d + x$ (tangential parts) when the point of `a` steps by $x$, with the shape operators
$L_a, L_b$. This leaves $H x = -s$ on `a`, with the slope $s$ of the distance and its second derivative
$H = L_a + L_b (1 + g L_b)^{-1}$.

`linear` makes these equations at a pair, `stepped` moves a pair, and `polished` gives derivatives.
`_location3` goes down the distance with them from the pairs that `_samples3` proposes. Vectors in a tangent
plane are two components in an orthonormal basis of it: small enough to be solved by hand, which compiles and
batches better than a solver.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..._linalg import Pose3, tangents, Vec3
from ..._types import ByPrecision, Scalar, Scalars
from ...geometry import AbstractSurface, Gauss3

# Coordinates on `a` and on `b`.
Places = tuple[Scalars, Scalars]
# Components of a tangent vector in an orthonormal basis.
Plane2 = tuple[Scalar, Scalar]
# Least eigenvalue of 1 + g L_b in a step: the factor by which lengths change from `b` to the surface parallel
# to it through the point of `a`. It is zero at a centre of curvature.
_BEND = 0.05
# Determinant, relative to the squared size of a form, below which the form counts as singular.
_SINGULAR = ByPrecision(1e-14, 1e-6)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Pair3:
    """Both surfaces, prepared, the pose of `a` in the frame of `b`, and a length to compare with [m]."""

    a: AbstractSurface
    b: AbstractSurface
    pose: Pose3
    scale: Scalar

    def frames(self, at: Places) -> tuple[Gauss3, Gauss3]:
        """Gauss frames of both places, in the frame of `b`."""
        return self.a.frame(at[0]).placed(self.pose), self.b.frame(at[1])

    def reversed(self) -> "Pair3":
        """The same with `a` and `b` exchanged."""
        p = self.pose
        rows = [Vec3(*axes) for axes in zip(p.x, p.y, p.z, strict=True)]
        return Pair3(self.b, self.a, Pose3(-p.back(p.origin), *rows), self.scale)


class TangentForm(NamedTuple):
    """A symmetric form on a tangent plane, in an orthonormal basis."""

    xx: Scalar
    xy: Scalar
    yy: Scalar

    def apply(self, v: Plane2) -> Plane2:
        """The form times a vector."""
        return self.xx * v[0] + self.xy * v[1], self.xy * v[0] + self.yy * v[1]

    def times(self, size: Scalar) -> "TangentForm":
        """The form scaled."""
        return TangentForm(size * self.xx, size * self.xy, size * self.yy)

    def plus(self, size: Scalar) -> "TangentForm":
        """The form with a multiple of the identity added."""
        return TangentForm(self.xx + size, self.xy, self.yy + size)

    def determinant(self) -> Scalar:
        """Product of the eigenvalues."""
        return self.xx * self.yy - self.xy * self.xy

    def eigenvalues(self) -> Plane2:
        """The smaller one, and the larger one."""
        mean, half = 0.5 * (self.xx + self.yy), 0.5 * (self.xx - self.yy)
        away = jnp.sqrt(half * half + self.xy * self.xy)
        return mean - away, mean + away

    def solve(self, v: Plane2) -> Plane2:
        """The vector x for which the form times x is v; zero where the form is singular."""
        size, det = jnp.abs(self.xx) + jnp.abs(self.xy) + jnp.abs(self.yy), self.determinant()
        firm = jnp.abs(det) > _SINGULAR.of(det) * size * size
        inverse = jnp.where(firm, 1.0 / jnp.where(firm, det, 1.0), 0.0)
        return (self.yy * v[0] - self.xy * v[1]) * inverse, (self.xx * v[1] - self.xy * v[0]) * inverse


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Linear3:
    r"""Newton's linear equations at a pair, in orthonormal bases of both tangent planes.

    Attributes:
        basis: Tangents of `a`, and of `b`, in the frame of `b`.
        facing: Inner products of the tangents of `b` (rows) with those of `a` (columns).
        bend: $1 + g L_b$, kept positive.
        outside: $L_b (1 + g L_b)^{-1}$, the shape operator of the surface parallel to `b` through the point
            of `a`.
        rise: $H$, the second derivative of the distance.
        centred: Whether $1 + g L_b$ was positive by itself: no centre of curvature of `b` lies between the
            points.
    """

    basis: tuple[tuple[Vec3, Vec3], tuple[Vec3, Vec3]]
    facing: tuple[Plane2, Plane2]
    bend: TangentForm
    outside: TangentForm
    rise: TangentForm
    centred: Scalar

    def conditions(self, a: Gauss3, b: Gauss3) -> tuple[Plane2, Plane2]:
        """What Newton's method makes zero: the distance's slope along `a`, the arm's part tangent to `b`."""
        both = a.normal + b.normal
        aside = _across(self.basis[1], b, a.point)
        # The slope is n . u along a tangent u of `a`, with the normal n at the foot: n_b turned on the way
        # there by `outside` times `aside`. As n_a . u = 0, it is computed from n_a + n_b, which loses no
        # digits near a root.
        pulled, ((p, q), (r, s)) = self.outside.apply(aside), self.facing
        x, y = _along(self.basis[0], both)
        return (x + p * pulled[0] + r * pulled[1], y + q * pulled[0] + s * pulled[1]), aside

    def follow(self, aside: Plane2, x: Plane2) -> Plane2:
        """The step on `b` to the foot of the point of `a`, when this one steps by `x`."""
        (p, q), (r, s) = self.facing
        return self.bend.solve((aside[0] + p * x[0] + q * x[1], aside[1] + r * x[0] + s * x[1]))


def constant(tree: Any) -> Any:
    """The same numbers without derivatives."""
    return jax.tree.map(lambda x: jax.lax.stop_gradient(x) if eqx.is_inexact_array(x) else x, tree)


def linear(a: Gauss3, b: Gauss3) -> Linear3:
    """The linear equations at a pair, from both Gauss frames in the frame of `b`."""
    basis = tangents(a.normal), tangents(b.normal)
    facing = (_along(basis[0], basis[1][0]), _along(basis[0], basis[1][1]))
    gap, shape = (a.point - b.point).dot(b.normal), _form(b, basis[1])
    bend = shape.times(gap).plus(1.0)
    least = bend.eigenvalues()[0]
    # Beyond a centre of curvature the foot is no nearest point, and Newton's step would lead away: the form
    # is shifted until its least eigenvalue is _BEND.
    bend = bend.plus(jnp.maximum(0.0, _BEND - least))
    # L (1 + g L)^-1 = (L + g det(L) 1) / det(1 + g L) for 2 x 2 forms, by the theorem of Cayley and Hamilton.
    det, inner = bend.determinant(), gap * shape.determinant()
    outside = TangentForm((shape.xx + inner) / det, shape.xy / det, (shape.yy + inner) / det)
    # H: the form of `a`, plus `outside` taken to the tangents of `a`.
    (p, q), (r, s) = facing
    first, second, own = outside.apply((p, r)), outside.apply((q, s)), _form(a, basis[0])
    rise = TangentForm(
        own.xx + p * first[0] + r * first[1],
        own.xy + p * second[0] + r * second[1],
        own.yy + q * second[0] + s * second[1],
    )
    return Linear3(basis, facing, bend, outside, rise, least > 0.0)


def stepped(pair: Pair3, at: Places, basis: Any, steps: tuple[Plane2, Plane2]) -> Places:
    """Coordinates after steps [m] along tangents given in the frame of `b`, put back onto the surfaces."""
    vectors = [u * x + v * y for (u, v), (x, y) in zip(basis, steps, strict=True)]
    on_a = pair.a.settled(summed(at[0], pair.a.rate(at[0], pair.pose.back(vectors[0]))))
    return on_a, pair.b.settled(summed(at[1], pair.b.rate(at[1], vectors[1])))


def summed(left: Scalars, right: Scalars) -> Scalars:
    """The sum of two tuples of coordinates, one by one."""
    return tuple(a + b for a, b in zip(left, right, strict=True))


def polished(pair: Pair3, at: Places, root: Scalar, of_b: Scalar, *, steps: int) -> Places:
    """A pair after some Newton steps from a root, with the derivatives of the implicit function theorem.

    The conditions F are zero at a root, and their Jacobian J there is kept constant. A step x - J^-1 F then
    has the derivative -J^-1 dF of the implicit function theorem, and each further step makes one more order
    of derivatives right. Of a pair that is no root (`root` is false) one place stays, that on `b` if `of_b`;
    the other one is its foot, within the ends of the surface.
    """
    fixed, at = constant(pair), constant(at)
    still_a, still_b = fixed.frames(at)
    equations = constant(linear(still_a, still_b))
    # 1 + h L_a of the step on `a` to the foot of the point of `b`, at the height h above it.
    height = (still_b.point - still_a.point).dot(still_a.normal)
    bend = constant(_form(still_a, equations.basis[0]).times(height).plus(1.0))

    def step(at: Places, _: None) -> tuple[Places, None]:
        a, b = pair.frames(at)
        slope, aside = equations.conditions(a, b)
        down = equations.rise.solve((-slope[0], -slope[1]))
        back = bend.solve(_across(equations.basis[0], a, b.point))
        x = tuple(jnp.where(root, u, jnp.where(of_b, v, 0.0)) for u, v in zip(down, back, strict=True))
        y = tuple(jnp.where(of_b & ~root, 0.0, v) for v in equations.follow(aside, (x[0], x[1])))
        on_a, on_b = stepped(pair, at, equations.basis, ((x[0], x[1]), (y[0], y[1])))
        ends = pair.a.within(on_a), pair.b.within(on_b)
        return jax.tree.map(lambda free, cut: jnp.where(root, free, cut), (on_a, on_b), ends), None

    # Coordinates on an implicit surface first follow it along its normal as its numbers change: the steps,
    # which are tangent, could not do that.
    at = pair.a.settled(at[0]), pair.b.settled(at[1])
    return jax.lax.scan(step, at, None, length=steps)[0]


def _form(frame: Gauss3, basis: tuple[Vec3, Vec3]) -> TangentForm:
    """The shape operator of a frame in a basis of its tangent plane."""
    u, v = basis
    first, second = frame.shape.apply(u), frame.shape.apply(v)
    return TangentForm(u.dot(first), u.dot(second), v.dot(second))


def _across(basis: tuple[Vec3, Vec3], frame: Gauss3, point: Vec3) -> Plane2:
    """The tangent part of the arm from a frame to a point, along two tangents that stay as it turns."""
    arm = point - frame.point
    return _along(basis, arm - frame.normal * arm.dot(frame.normal))


def _along(basis: tuple[Vec3, Vec3], vector: Vec3) -> Plane2:
    """Components of a vector along two tangents."""
    return basis[0].dot(vector), basis[1].dot(vector)
