r"""The grasped object in space: Newton's and Euler's equations of a free rigid body.

Without contact forces $m \ddot x = m g$ in world axes and $I \dot\omega + \omega \times I \omega = 0$ in body
axes, where the inertia tensor $I$ is constant. The quaternion follows by $\dot q = \frac12 q\,(0, \omega)$.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._linalg import normalised, Pose3, pose_at, quaternion_product, Sym3, Twist3, UNIT_AXES, unstack, Vec3
from .._results import as_array, as_floats, as_several, check_instance, check_positive, concrete, shown
from .._types import ByPrecision, Given, Scalar, Scalars
from .._xla import at_once, once
from ..contact import Motion
from ..geometry import AbstractSurface, mass_properties
from ._body import AbstractBody, Coordinate, Inertia, Spin

Surfaces = tuple[AbstractSurface, ...]
# Names of the four numbers of an orientation in space, scalar first.
QUATERNION = ("qw", "qx", "qy", "qz")
# Of a symmetric tensor that was turned, rounding leaves this difference, relative to its largest entry.
_SYMMETRIC = ByPrecision(1e-9, 1e-5)


def _as_surfaces(name: str, surfaces: Any) -> Surfaces:
    return as_several(name, surfaces, AbstractSurface, "surfaces")


def _as_inertia(name: str, inertia: Any) -> Array:
    """An inertia given as one number, three or a matrix, as a matrix."""
    array = as_array(name, inertia)
    if array.ndim < 2:
        # One number is a ball's moment about any axis.
        array = _on_diagonal(array if array.ndim == 0 else as_floats(name, array, (3,)))
    return check_inertia(name, as_floats(name, array, (3, 3)))


@at_once
def _on_diagonal(xp: Any, moments: Array) -> Array:
    """A matrix with these moments, or with one three times, on its diagonal."""
    return xp.broadcast_to(moments, (3,))[:, None] * xp.eye(3, dtype=moments.dtype)


def check_inertia(name: str, tensors: Array) -> Array:
    """Raise if concrete inertia tensors, shape (..., 3, 3), are not symmetric positive definite."""
    seen = concrete(tensors)
    if seen is None:
        return tensors
    gaps = abs(seen - seen.swapaxes(-1, -2)).max(initial=0.0)
    most = _SYMMETRIC.of(tensors) * abs(seen).max(initial=0.0)
    if gaps > most or not np.all(np.linalg.eigvalsh(seen) > 0):
        raise ValueError(f"argument {name} must be symmetric and positive definite, but was {shown(seen)}")
    return tensors


class FreeObject3(AbstractBody):
    r"""An object free in space; its frame sits at the centre of mass.

    Positions: $(x, y, z)$ of the centre of mass and the unit quaternion (scalar first) that turns body axes
    into world axes. Velocities: $\dot x, \dot y, \dot z$ in world axes and the spin $\omega$ in **body**
    axes, $\dot q = \frac12 q\,(0, \omega)$.

    Args:
        surfaces: One surface or several, in the body frame.
        mass: In kilograms.
        inertia: About the centre of mass, in body axes [kg m^2]: one number (a ball), shape (3,) along the
            axes, or shape (3, 3). It must be symmetric and positive definite; that no principal moment of a
            real body exceeds the sum of the other two is not checked, since the equations do not need it.
        outline: Shape (3,), edge lengths of a cuboid about the centre [m], for drawing alone.

    Raises:
        ValueError: If a shape does not fit, the mass is not positive, or the inertia not positive definite.

    Example:
        >>> import jaxroll as jxr
        >>> ball = jxr.FreeObject3(jxr.Sphere(0.02), mass=0.05, inertia=8e-6)
        >>> ball.positions, ball.freedoms
        (7, 6)
    """

    surfaces: Surfaces = through(_as_surfaces)
    mass: Float[Array, ""] = real(check=check_positive)
    inertia: Float[Array, "3 3"] = through(_as_inertia)
    outline: Float[Array, "3"] | None = real(3, check=check_positive, optional=True)

    def __init__(
        self,
        surfaces: AbstractSurface | Sequence[AbstractSurface],
        mass: Given,
        inertia: Given,
        *,
        outline: Given | None = None,
    ) -> None:
        self.surfaces = taken(self, "surfaces", surfaces)
        self.mass = taken(self, "mass", mass)
        self.inertia = taken(self, "inertia", inertia)
        self.outline = taken(self, "outline", outline)

    @classmethod
    def uniform(cls, surface: AbstractSurface, density: Given) -> "FreeObject3":
        """The body of constant density within a closed surface.

        The surface is shifted so that the centre of mass lies at the origin of the object's frame, whose axes
        remain the surface's.

        Args:
            surface: Closed, with its normal outward.
            density: In kg/m^3.

        Raises:
            ValueError: If the surface is not closed, or the density not positive.

        Example:
            >>> import jaxroll as jxr
            >>> ring = jxr.FreeObject3.uniform(jxr.Torus(0.03, 0.01), density=1000.0)
            >>> f"{1e3 * ring.mass:.2f} g"
            '59.22 g'
        """
        check_instance("surface", surface, AbstractSurface, "a surface")
        found = mass_properties(surface, density)
        return cls(surface.moved(-found.centre), found.mass, found.inertia)

    @property
    def shapes(self) -> Surfaces:
        return self.surfaces

    @property
    def freedoms(self) -> int:
        return 6

    @property
    def positions(self) -> int:
        return 7

    @property
    def labels(self) -> tuple[Coordinate, ...]:
        return *(Coordinate(axis, "m") for axis in "xyz"), *(Coordinate(part, "") for part in QUATERNION)

    @property
    def velocity_labels(self) -> tuple[Coordinate, ...]:
        spin = (Coordinate(f"spin {axis}", "rad/s") for axis in "xyz")
        return *(Coordinate(axis, "m/s") for axis in "xyz"), *spin

    def prepared(self) -> "FreeObject3":
        ready = (unstack(self.inertia), tuple(s.prepared() for s in self.surfaces))
        return eqx.tree_at(lambda o: (o.inertia, o.surfaces), self, ready)

    def placed(self, q: Scalars) -> tuple[Pose3, Spin]:
        pose = once(pose_at(Vec3(*q[:3]), (q[3], q[4], q[5], q[6])))
        return pose, lambda v: pose.turn(Vec3(*v[3:]))

    def rates(self, q: Scalars, v: Scalars) -> Scalars:
        # The spin is in body axes, hence on the right of q.
        turned = quaternion_product((q[3], q[4], q[5], q[6]), (0.0, v[3], v[4], v[5]))
        return (*v[:3], *(0.5 * x for x in turned))

    def onto(self, q: Scalars) -> Scalars:
        return (*q[:3], *normalised((q[3], q[4], q[5], q[6])))

    def displaced(self, q: Scalars, step: Scalars) -> Scalars:
        # A turn by the small vector d in body axes is the quaternion (1, d/2), normalised, to first order.
        moved = (a + b for a, b in zip(q[:3], step[:3], strict=True))
        turn = (1.0, *(0.5 * x for x in step[3:]))
        return (*moved, *normalised(quaternion_product((q[3], q[4], q[5], q[6]), turn)))

    def motion(self, q: Scalars, v: Scalars, gravity: Vec3 | None) -> tuple[Motion, Inertia]:
        here, still, spin = self.pose(q), Vec3(0.0, 0.0, 0.0), Vec3(*v[3:])
        units = tuple(Twist3(axis, still) for axis in UNIT_AXES)
        turns = tuple(Twist3(still, axis) for axis in (here.x, here.y, here.z))
        twist = once(Twist3(Vec3(*v[:3]), here.turn(spin)))
        # h = (-m g, w x I w): the gyroscopic torque in body axes.
        matrix, m = self._tensor(), self.mass
        torque = spin.cross(matrix.apply(spin))
        weight = still if gravity is None else gravity * -m
        mass = (
            *((m,), (0.0, m), (0.0, 0.0, m)),
            (0.0, 0.0, 0.0, matrix.xx),
            (0.0, 0.0, 0.0, matrix.xy, matrix.yy),
            (0.0, 0.0, 0.0, matrix.xz, matrix.yz, matrix.zz),
        )
        # Bias: of the spin R w it is (d/dt R) w = R (w x w) = 0 at constant w.
        motion = Motion(here, (*units, *turns), twist, Twist3(still, still))
        return motion, Inertia(mass, (*weight, *torque))

    def gravity_potential(self, q: Scalars, gravity: Vec3) -> Scalar:
        return -self.mass * gravity.dot(Vec3(*q[:3]))

    def _tensor(self) -> Sym3:
        """The inertia tensor in body axes, from its upper triangle."""
        m = self.inertia
        return Sym3(m[0][0], m[0][1], m[0][2], m[1][1], m[1][2], m[2][2])
