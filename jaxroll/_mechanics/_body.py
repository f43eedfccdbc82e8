"""What the dynamics needs to know of a body, whichever body it is."""

import abc
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax

from .._linalg import Triangle
from .._printing import listed
from .._types import Scalar, Scalars
from ..contact import Motion


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Inertia:
    r"""Mass matrix (lower triangle) and bias force of one body's own coordinates.

    `force` is $(\dot G/2 + S) v$ of (3) less the generalised force of gravity.
    """

    mass: Triangle
    force: Scalars


class Coordinate(NamedTuple):
    """What one position of a body is called, and its unit: 'm', 'rad', 's', or '' where it has none."""

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
    @abc.abstractmethod
    def shapes(self) -> tuple[Any, ...]:
        """Contours or surfaces in the body's frame, which contacts touch."""

    @abc.abstractmethod
    def prepared(self) -> "AbstractBody":
        """This body with scalar leaves and shapes ready for evaluation."""

    @abc.abstractmethod
    def pose(self, q: Scalars) -> Any:
        """The frame in the world."""

    @abc.abstractmethod
    def spin(self, q: Scalars, v: Scalars) -> Any:
        """Angular velocity of the frame at these velocities, less what is prescribed."""

    @abc.abstractmethod
    def motion(self, q: Scalars, v: Scalars, gravity: Any) -> tuple[Motion, Inertia]:
        """Kinematics of the frame, mass matrix and bias force at one state."""

    @abc.abstractmethod
    def gravity_potential(self, q: Scalars, gravity: Any) -> Scalar:
        """Potential energy in a uniform field."""

    def rates(self, q: Scalars, v: Scalars) -> Scalars:
        r"""$\dot q$ at these velocities."""
        return v

    def displaced(self, q: Scalars, step: Scalars) -> Scalars:
        """Positions after a small displacement, given as velocities are."""
        return tuple(a + b for a, b in zip(q, step, strict=True))
