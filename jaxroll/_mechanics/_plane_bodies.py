r"""The bodies of the plane as a run evaluates them: a serial chain, an object on a pivot, a free object.

The classes here hold formulas alone; users make `Finger` (`_finger`), `PivotedObject` and `FreeObject`
(`_object2`), which add constructors and checks. For a chain, mass matrix $G(q)$ and bias
$(\dot G/2 + S)\,\dot q$ of (3) and (74) come from one pass over the links, from the tip to the base; the bias
is the torque that the motion needs at zero joint accelerations. `_body` says what is asked of a body,
`_chain3` and `_object3` are the same in space.
"""

import itertools

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._linalg import Pose2, sincos, total, Twist2, unstack, Vec2
from .._types import Scalar, Scalars
from .._xla import once
from ..contact import Motion
from ..geometry import AbstractContour
from ._body import AbstractFinger, AbstractObject, Coordinate, Inertia, Spin, with_scalar_limits

_STILL = Vec2(0.0, 0.0)


class AbstractChain(AbstractFinger):
    """The formulas of a planar serial chain of revolute joints; `Finger` documents the fields."""

    tip: eqx.AbstractVar[AbstractContour]
    lengths: eqx.AbstractVar[Float[Array, " k"]]
    masses: eqx.AbstractVar[Float[Array, " k"]]
    base: eqx.AbstractVar[Float[Array, "2"]]
    centres: eqx.AbstractVar[Float[Array, " k"]]
    inertias: eqx.AbstractVar[Float[Array, " k"]]

    @property
    def joints(self) -> int:
        return len(self.lengths)

    @property
    def size(self) -> Scalar:
        return total(unstack(self.lengths)) / self.joints

    @property
    def turns(self) -> bool:
        return True

    def prepared(self) -> "AbstractChain":
        fields = lambda f: (f.lengths, f.masses, f.base, f.centres, f.inertias, f.tip)  # noqa: E731
        *arrays, tip = fields(self)
        return with_scalar_limits(eqx.tree_at(fields, self, (*map(unstack, arrays), tip.prepared())))

    def directions(self, q: Scalars) -> tuple[Vec2, ...]:
        """Unit vectors along the links, in the world: the only sines and cosines of a finger."""
        along = []
        for angle in itertools.accumulate(q):
            sin, cos = sincos(angle)
            along.append(Vec2(cos, sin))
        return tuple(along)

    def joint_positions(self, along: tuple[Vec2, ...]) -> tuple[Vec2, ...]:
        """Positions of the joints and, last, of the tip frame: k + 1 points."""
        points = [Vec2(self.base[0], self.base[1])]
        for length, direction in zip(self.lengths, along, strict=True):
            points.append(points[-1] + direction * length)
        return once(tuple(points))

    def skeleton(self, q: Scalars) -> tuple[Vec2, ...]:
        return self.joint_positions(self.directions(q))

    def placed(self, q: Scalars) -> tuple[Pose2, Spin]:
        along = self.directions(q)
        # Every joint turns all links beyond it: the tip's spin is the sum of all rates.
        return Pose2(self.joint_positions(along)[-1], along[-1].x, along[-1].y), total

    def motion(self, q: Scalars, v: Scalars, gravity: Vec2 | None) -> tuple[Motion, Inertia]:
        along = self.directions(q)
        points = self.joint_positions(along)
        # Link i has the spin w_i = v_0 + ... + v_i. Without joint accelerations joint i + 1 has the
        # acceleration of joint i, plus -w_i^2 l_i along the link; the base rests, and adds nothing.
        spins = list(itertools.accumulate(v))
        centripetal = [-(w * w) for w in spins]
        joint_pull = [_STILL]
        for i, length in enumerate(self.lengths):
            step = along[i] * (centripetal[i] * length)
            joint_pull.append(step if i == 0 else joint_pull[i] + step)
        # Likewise the centre of mass of every link; gravity acts like an acceleration -g of the whole.
        centres = [p + d * c for p, d, c in zip(points, along, self.centres, strict=False)]
        pulls = []
        for i, centre in enumerate(self.centres):
            pull = along[i] * (centripetal[i] * centre)
            pull = pull if i == 0 else joint_pull[i] + pull
            pulls.append(pull if gravity is None else pull - gravity)
        motion = self._tip_motion(points, along[-1], v, spins[-1], joint_pull[-1])
        return motion, self._inertia(points, centres, pulls)

    def _tip_motion(
        self, points: tuple[Vec2, ...], heading: Vec2, v: Scalars, spin: Scalar, pull: Vec2
    ) -> Motion:
        """Motion of the tip frame; `pull` is its acceleration at zero joint accelerations."""
        tip = points[-1]
        # A unit rate of the joint at p moves the tip by tip - p, turned left a quarter.
        units = tuple(Twist2((tip - p).left(), 1.0) for p in points[:-1])
        velocity = total([u.velocity * rate for u, rate in zip(units, v, strict=True)])
        pose = Pose2(tip, heading.x, heading.y)
        velocity, pull = once((velocity, pull))
        return Motion(pose, units, Twist2(velocity, spin), Twist2(pull, 0.0))

    def _inertia(self, points: tuple[Vec2, ...], centres: list[Vec2], pulls: list[Vec2]) -> Inertia:
        """Mass matrix and bias: for each joint all links beyond it as one body, from the tip inwards.

        With mass m, first moment c = sum m (r - p_i) and second moment J about joint i of that body,
        M_ij = J + c . (p_i - p_j) for j <= i, and h_i is the torque of m (a - g) about joint i.
        """
        rows: list[Scalars] = []
        forces: list[Scalar] = []
        outer: tuple[Scalar, Vec2, Scalar, Vec2, Scalar] | None = None
        # `outer` is the body of all links from joint i + 1 on, about that joint. To be taken about joint i, a
        # link d further back, its c grows by m d, its J by 2 d . c + m d . d, and its torque by d x F.
        for i in reversed(range(self.joints)):
            arm = centres[i] - points[i]
            mass, moment = self.masses[i], arm * self.masses[i]
            second = self.masses[i] * arm.dot(arm) + self.inertias[i]
            force = pulls[i] * self.masses[i]
            torque = arm.cross(force)
            if outer is not None:  # moved from joint i + 1 to joint i, and added
                link = points[i + 1] - points[i]
                m, first, inner, push, twist = outer
                second = second + inner + 2.0 * link.dot(first) + m * link.dot(link)
                mass, moment = mass + m, moment + first + link * m
                torque, force = torque + twist + link.cross(push), force + push
            outer = (mass, moment, second, force, torque)
            row = [second + moment.dot(points[i] - points[j]) for j in range(i)]
            rows.append((*row, second))
            forces.append(torque)
        return once(Inertia(tuple(reversed(rows)), tuple(reversed(forces))))

    def gravity_potential(self, q: Scalars, gravity: Vec2) -> Scalar:
        along = self.directions(q)
        points = self.joint_positions(along)
        centres = [p + d * c for p, d, c in zip(points, along, self.centres, strict=False)]
        return total([-gravity.dot(c) * m for c, m in zip(centres, self.masses, strict=True)])


class AbstractPivoted(AbstractObject):
    """The formulas of an object that turns about a fixed point; `PivotedObject` documents the fields."""

    inertia: eqx.AbstractVar[Float[Array, ""]]
    pivot: eqx.AbstractVar[Float[Array, "2"]]
    weight_moment: eqx.AbstractVar[Float[Array, "2"] | None]

    @property
    def freedoms(self) -> int:
        return 1

    @property
    def labels(self) -> tuple[Coordinate, ...]:
        return (Coordinate("theta", "rad"),)

    def prepared(self) -> "AbstractPivoted":
        fields = lambda o: (o.pivot, o.weight_moment, o.contours)  # noqa: E731
        contours = tuple(c.prepared() for c in self.contours)
        ready = (unstack(self.pivot), unstack(self.weight_moment), contours)
        return eqx.tree_at(fields, self, ready, is_leaf=lambda x: x is None)

    def placed(self, q: Scalars) -> tuple[Pose2, Spin]:
        sin, cos = sincos(q[0])
        return Pose2(Vec2(self.pivot[0], self.pivot[1]), cos, sin), lambda v: v[0]

    def motion(self, q: Scalars, v: Scalars, gravity: Vec2 | None) -> tuple[Motion, Inertia]:
        pose, unit = self.pose(q), Twist2(_STILL, 1.0)
        motion = Motion(pose, (unit,), Twist2(_STILL, v[0]), Twist2(_STILL, 0.0))
        force = 0.0
        if gravity is not None and self.weight_moment is not None:
            # h is minus the torque of the weight, -(c x m g) = g x (m c), with the moment m c in world axes.
            force = gravity.cross(pose.turn(Vec2(*self.weight_moment)))
        return motion, Inertia(((self.inertia,),), (force,))

    def gravity_potential(self, q: Scalars, gravity: Vec2) -> Scalar:
        if self.weight_moment is None:
            return jnp.zeros_like(q[0])
        pose = self.pose(q)
        return -gravity.dot(pose.turn(Vec2(*self.weight_moment)))


class AbstractFree(AbstractObject):
    """The formulas of an object free in the plane; `FreeObject` documents the fields."""

    mass: eqx.AbstractVar[Float[Array, ""]]
    inertia: eqx.AbstractVar[Float[Array, ""]]

    @property
    def freedoms(self) -> int:
        return 3

    @property
    def labels(self) -> tuple[Coordinate, ...]:
        return Coordinate("x", "m"), Coordinate("y", "m"), Coordinate("theta", "rad")

    def prepared(self) -> "AbstractFree":
        return eqx.tree_at(lambda o: o.contours, self, tuple(c.prepared() for c in self.contours))

    def placed(self, q: Scalars) -> tuple[Pose2, Spin]:
        sin, cos = sincos(q[2])
        return Pose2(Vec2(q[0], q[1]), cos, sin), lambda v: v[2]

    def motion(self, q: Scalars, v: Scalars, gravity: Vec2 | None) -> tuple[Motion, Inertia]:
        units = (Twist2(Vec2(1.0, 0.0), 0.0), Twist2(Vec2(0.0, 1.0), 0.0), Twist2(_STILL, 1.0))
        twist = Twist2(Vec2(v[0], v[1]), v[2])
        motion = Motion(self.pose(q), units, twist, Twist2(_STILL, 0.0))
        # A lower triangle, row by row. The frame sits at the centre of mass: there are no velocity terms.
        mass = ((self.mass,), (0.0, self.mass), (0.0, 0.0, self.inertia))
        if gravity is None:
            return motion, Inertia(mass, (0.0, 0.0, 0.0))
        return motion, Inertia(mass, (-self.mass * gravity.x, -self.mass * gravity.y, 0.0))

    def gravity_potential(self, q: Scalars, gravity: Vec2) -> Scalar:
        return -self.mass * gravity.dot(Vec2(q[0], q[1]))
