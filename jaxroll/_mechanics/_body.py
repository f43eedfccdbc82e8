r"""What the equations of motion ask of a body, and the two objects of the plane: pivoted, and free.

A body gives its pose, its kinematics (`Motion`), mass matrix $M$ and bias force $h$ at one state. Fingers are
bodies too (`_finger`, `_jaw`), and so are those of space (`_object3`, `_finger3`, `_stage`). `_motion` puts
the $M$ and $h$ of all bodies into $M \dot v + h = u + A^T \mu$, where $M$ is block-diagonal.
"""

import abc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._linalg import Pose2, sincos, Triangle, Twist2, unstack, Vec2
from .._printing import listed
from .._results import as_floats, as_several, check_instance, check_positive
from .._types import Given, Scalar, Scalars
from ..contact import Motion
from ..geometry import AbstractContour, mass_properties

Contours = tuple[AbstractContour, ...]
# Maps a body's velocities to its frame's angular velocity [rad/s]: a number in the plane, a vector in space.
Spin = Callable[[Scalars], Any]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Inertia:
    r"""Mass matrix $M$ (lower triangle) and bias force $h$ of one body, in the coordinates of its velocities.

    `force` is $h = (\dot G/2 + S) v$ of (3) less the generalised force of gravity.
    """

    mass: Triangle
    force: Scalars


class Coordinate(NamedTuple):
    """Name and unit of one position of a body; the unit is 'm', 'rad', 's', or '' where it has none."""

    name: str
    unit: str


# Names of the four numbers of an orientation in space, scalar first.
QUATERNION = ("qw", "qx", "qy", "qz")


class AbstractBody(eqx.Module):
    r"""The object, or a driven mechanism with a fingertip: a frame that its own coordinates place.

    Its velocities $v$ need not be rates of its positions $q$: $\dot q = N(q) v$ (plus what is prescribed).
    Poses, twists, gravity and spins are those of the plane (`Pose2`, `Twist2`, `Vec2`, a number) or of
    space (`Pose3`, `Twist3`, `Vec3`, `Vec3`).
    """

    __repr__ = listed

    @property
    @abc.abstractmethod
    def freedoms(self) -> int:
        """Number of velocities."""

    @property
    def positions(self) -> int:
        """Number of positions."""
        return self.freedoms

    @property
    def labels(self) -> tuple[Coordinate, ...]:
        """Name and unit of each position, in order: what reports call them. By default without units."""
        return tuple(Coordinate(f"q[{i}]", "") for i in range(self.positions))

    @property
    def velocity_labels(self) -> tuple[Coordinate, ...]:
        """Name and unit of each velocity. By default those of the positions, per second, if as many."""
        if self.freedoms != self.positions:
            return tuple(Coordinate(f"v[{i}]", "") for i in range(self.freedoms))
        return tuple(Coordinate(each.name, each.unit and f"{each.unit}/s") for each in self.labels)

    @property
    @abc.abstractmethod
    def shapes(self) -> tuple[Any, ...]:
        """Contours or surfaces in the body's frame, which contacts touch."""

    @abc.abstractmethod
    def prepared(self) -> "AbstractBody":
        """This body with its arrays split into scalars, and its shapes ready for evaluation."""

    @abc.abstractmethod
    def placed(self, q: Scalars) -> tuple[Any, Spin]:
        """The frame in the world, and the map from velocities to its spin, without prescribed motion.

        Both at once, because a chain of links has to be followed for either.
        """

    def pose(self, q: Scalars) -> Any:
        """The frame in the world."""
        return self.placed(q)[0]

    def onto(self, q: Scalars) -> Scalars:
        """Positions that a step has carried off their manifold, such as a quaternion, back onto it."""
        return q

    @abc.abstractmethod
    def motion(self, q: Scalars, v: Scalars, gravity: Any) -> tuple[Motion, Inertia]:
        """Kinematics of the frame, mass matrix and bias force at one state."""

    @abc.abstractmethod
    def gravity_potential(self, q: Scalars, gravity: Any) -> Scalar:
        """Potential energy [J] in the uniform field `gravity` [m/s^2]."""

    def rates(self, q: Scalars, v: Scalars) -> Scalars:
        r"""$\dot q$ at these velocities."""
        return v

    def displaced(self, q: Scalars, step: Scalars) -> Scalars:
        """Positions after a small displacement in the coordinates of the velocities."""
        return tuple(a + b for a, b in zip(q, step, strict=True))


def _as_contours(name: str, contours: Any) -> Contours:
    return as_several(name, contours, AbstractContour, "contours")


class AbstractObject(AbstractBody):
    """A rigid object with one or more contours (faces) in its body frame."""

    contours: eqx.AbstractVar[Contours]

    @property
    def shapes(self) -> Contours:
        return self.contours


class PivotedObject(AbstractObject):
    r"""An object that turns about a fixed point $O_m$, the origin of its frame (Part 2, Fig. 4).

    Its one coordinate is the angle $\theta$.

    Args:
        contours: One contour or several, in the body frame.
        inertia: Moment about the pivot, in kg m^2.
        pivot: Shape (2,), position of the pivot in the world, in metres.
        mass: In kilograms; used by gravity alone, with `centre`. Default: no weight.
        centre: Shape (2,), centre of mass in the body frame, in metres.
    """

    contours: Contours = through(_as_contours)
    inertia: Float[Array, ""] = real(check=check_positive)
    pivot: Float[Array, "2"] = real(2)
    weight_moment: Float[Array, "2"] | None = real(2, optional=True)

    def __init__(
        self,
        contours: AbstractContour | Sequence[AbstractContour],
        inertia: Given,
        *,
        pivot: Given = (0.0, 0.0),
        mass: Given | None = None,
        centre: Given = (0.0, 0.0),
    ) -> None:
        self.contours = taken(self, "contours", contours)
        self.inertia = taken(self, "inertia", inertia)
        self.pivot = taken(self, "pivot", pivot)
        middle = as_floats("centre", centre, (2,))
        self.weight_moment = None
        if mass is not None:
            # Of mass and centre the weight needs the product alone: their first moment about the pivot.
            self.weight_moment = check_positive("mass", as_floats("mass", mass, ())) * middle

    @property
    def freedoms(self) -> int:
        return 1

    @property
    def labels(self) -> tuple[Coordinate, ...]:
        return (Coordinate("theta", "rad"),)

    def prepared(self) -> "PivotedObject":
        fields = lambda o: (o.pivot, o.weight_moment, o.contours)  # noqa: E731
        contours = tuple(c.prepared() for c in self.contours)
        ready = (unstack(self.pivot), unstack(self.weight_moment), contours)
        return eqx.tree_at(fields, self, ready, is_leaf=lambda x: x is None)

    def placed(self, q: Scalars) -> tuple[Pose2, Spin]:
        sin, cos = sincos(q[0])
        return Pose2(Vec2(self.pivot[0], self.pivot[1]), cos, sin), lambda v: v[0]

    def motion(self, q: Scalars, v: Scalars, gravity: Vec2 | None) -> tuple[Motion, Inertia]:
        pose, still = self.pose(q), Vec2(0.0, 0.0)
        unit = Twist2(still, 1.0)
        motion = Motion(pose, (unit,), Twist2(still, v[0]), Twist2(still, 0.0))
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


class FreeObject(AbstractObject):
    r"""An object free in the plane; its frame sits at the centre of mass $O_m$ (Part 1, Fig. 1).

    Its coordinates are $(x, y, \theta)$, as in (12).

    Args:
        contours: One contour or several, in the body frame.
        mass: In kilograms.
        inertia: Moment about the centre of mass, in kg m^2.
    """

    contours: Contours = through(_as_contours)
    mass: Float[Array, ""] = real(check=check_positive)
    inertia: Float[Array, ""] = real(check=check_positive)

    def __init__(
        self,
        contours: AbstractContour | Sequence[AbstractContour],
        mass: Given,
        inertia: Given,
    ) -> None:
        self.contours = taken(self, "contours", contours)
        self.mass = taken(self, "mass", mass)
        self.inertia = taken(self, "inertia", inertia)

    @classmethod
    def uniform(
        cls, contour: AbstractContour, density: Given, *, thickness: Given | None = None
    ) -> "FreeObject":
        """The plate of constant density that a closed contour outlines.

        The contour is shifted so that the centre of mass lies at the origin of the object's frame.

        Args:
            contour: Closed.
            density: Mass per area [kg/m^2]; with `thickness` [kg/m^3].
            thickness: Of the plate [m].

        Raises:
            ValueError: If the contour is not closed, or a number is not positive.

        Example:
            >>> import jaxroll as jxr
            >>> disc = jxr.FreeObject.uniform(jxr.Circle(0.02), density=1000.0, thickness=0.01)
            >>> f"{1e3 * disc.mass:.2f} g"
            '12.57 g'
        """
        check_instance("contour", contour, AbstractContour, "a contour")
        found = mass_properties(contour, density, thickness=thickness)
        return cls(contour.moved(-found.centre), found.mass, found.inertia)

    @property
    def freedoms(self) -> int:
        return 3

    @property
    def labels(self) -> tuple[Coordinate, ...]:
        return Coordinate("x", "m"), Coordinate("y", "m"), Coordinate("theta", "rad")

    def prepared(self) -> "FreeObject":
        return eqx.tree_at(lambda o: o.contours, self, tuple(c.prepared() for c in self.contours))

    def placed(self, q: Scalars) -> tuple[Pose2, Spin]:
        sin, cos = sincos(q[2])
        return Pose2(Vec2(q[0], q[1]), cos, sin), lambda v: v[2]

    def motion(self, q: Scalars, v: Scalars, gravity: Vec2 | None) -> tuple[Motion, Inertia]:
        still = Vec2(0.0, 0.0)
        units = (Twist2(Vec2(1.0, 0.0), 0.0), Twist2(Vec2(0.0, 1.0), 0.0), Twist2(still, 1.0))
        twist = Twist2(Vec2(v[0], v[1]), v[2])
        motion = Motion(self.pose(q), units, twist, Twist2(still, 0.0))
        # A lower triangle, row by row. The frame sits at the centre of mass: there are no velocity terms.
        mass = ((self.mass,), (0.0, self.mass), (0.0, 0.0, self.inertia))
        if gravity is None:
            return motion, Inertia(mass, (0.0, 0.0, 0.0))
        return motion, Inertia(mass, (-self.mass * gravity.x, -self.mass * gravity.y, 0.0))

    def gravity_potential(self, q: Scalars, gravity: Vec2) -> Scalar:
        return -self.mass * gravity.dot(Vec2(q[0], q[1]))
