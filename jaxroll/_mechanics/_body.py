r"""What the equations of motion ask of a body: of the object, and of a finger, which has joints besides.

A body gives its pose, its kinematics (`Motion`), mass matrix $M$ and bias force $h$ at one state. Those of
the plane do it in `_plane_bodies`, those of space in `_object3`, `_chain3` and `_stage`. `_motion` puts the
$M$ and $h$ of all bodies into $M \dot v + h = u + A^T \mu$, where $M$ is block-diagonal.
"""

import abc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax

from .._linalg import Triangle, unstack
from .._printing import listed
from .._types import Scalar, Scalars
from ..contact import Motion
from ..geometry import AbstractContour

Contours = tuple[AbstractContour, ...]
# Maps a body's velocities to its frame's angular velocity [rad/s]: a number in the plane, a vector in space.
Spin = Callable[[Scalars], Any]
FingerType = TypeVar("FingerType", bound="AbstractFinger")


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


class AbstractObject(AbstractBody):
    """A rigid object with one or more contours (faces) in its body frame."""

    contours: eqx.AbstractVar[Contours]

    @property
    def shapes(self) -> Contours:
        return self.contours


class AbstractFinger(AbstractBody):
    """A driven mechanism that carries one shape in its tip frame.

    A class with fields `limits`, `torque_limits` or `link_radius`, None where there are none, has limits that
    runs watch.
    """

    tip: eqx.AbstractVar[Any]

    def __repr__(self) -> str:
        # Most fingers have no limits.
        text = listed(self)
        for name in ("limits", "torque_limits", "link_radius"):
            text = text.replace(f", {name}=None", "")
        return text

    @property
    @abc.abstractmethod
    def joints(self) -> int:
        """Number of joints."""

    @property
    @abc.abstractmethod
    def size(self) -> Scalar:
        """A typical length [m], for scaling and drawing."""

    @property
    @abc.abstractmethod
    def turns(self) -> bool:
        """Whether its coordinates are angles; else displacements."""

    @abc.abstractmethod
    def skeleton(self, q: Scalars) -> tuple[Any, ...]:
        """Points from the base to the tip frame, for drawing."""

    @property
    def prescribed(self) -> bool:
        """Whether its frame moves as a given function of time; then it has no joints (`Grasp` checks it).

        With both, the rate of a gap that is due to the given motion could not be found: it needs the twist of
        that motion alone, and a `Motion` holds only the sum.
        """
        return False

    @property
    def freedoms(self) -> int:
        return self.joints

    @property
    def labels(self) -> tuple[Coordinate, ...]:
        unit = "" if self.positions != self.joints else "rad" if self.turns else "m"
        return tuple(Coordinate(f"q[{i}]", unit) for i in range(self.positions))

    @property
    def shapes(self) -> tuple[Any, ...]:
        return (self.tip,)


def with_scalar_limits(finger: FingerType) -> FingerType:
    """A finger whose limits, if it has some, are tuples of scalars."""
    fields = lambda f: [x for x in (f.limits, f.torque_limits) if x is not None]  # noqa: E731
    given = fields(finger)
    return eqx.tree_at(fields, finger, list(map(unstack, given))) if given else finger
