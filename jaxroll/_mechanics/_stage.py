r"""A surface that is fixed in the world, or moves as a given function of time, for an object to roll on.

It takes the place of a finger but has no velocities. Time is a position of its own, the clock, which runs at
$\dot q = 1$, because a body's pose depends on its positions alone. Twist and acceleration of the surface are
derivatives of the motion; `_motion._linearisation` keeps the rate that the twist gives a gap as `drift`.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._closures import as_tree
from .._fields import real, taken, through
from .._linalg import (
    conjugate,
    normalised,
    Pose3,
    pose_at,
    Quaternion,
    quaternion_product,
    sincos,
    Twist3,
    unstack,
    Vec3,
)
from .._printing import listed
from .._results import as_array, check_callable, check_direction, shown, traceable
from .._types import Given, Scalar, Scalars
from ..contact import Motion
from ..geometry import AbstractSurface
from ._body import AbstractFinger, Coordinate, Inertia, Spin
from ._finger3 import as_surface

# A stage has no length of its own. Only scaling and drawing need one: a gripper's order of magnitude [m].
_SIZE = 0.05


class Turning(eqx.Module):
    r"""A motion for `Stage`: steady rotation about an axis through a point, $\Omega t$ at time t.

    Args:
        rate: $\Omega$ [rad/s].
        axis: Shape (3,), of any length. Default: z.
        centre: Shape (3,), a point of the axis [m].

    Raises:
        ValueError: If an argument is not finite or of another shape, or `axis` is zero.

    Example:
        >>> import jaxroll as jxr
        >>> jxr.Turning(2.0).axis.tolist()
        [0.0, 0.0, 1.0]
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"rate": "rad/s", "centre": "m"}

    rate: Float[Array, ""] = real()
    axis: Float[Array, "3"] = real(3, check=check_direction)
    centre: Float[Array, "3"] = real(3)

    def __init__(
        self, rate: Given, *, axis: Given = (0.0, 0.0, 1.0), centre: Given = (0.0, 0.0, 0.0)
    ) -> None:
        self.rate = taken(self, "rate", rate)
        self.axis = taken(self, "axis", axis)
        self.centre = taken(self, "centre", centre)

    def __call__(self, t: Scalar) -> tuple[Vec3, Quaternion]:
        # The quaternion of a turn by Omega t about the axis. The centre c stays: the origin is c - R c.
        sin, cos = sincos(0.5 * self.rate * t)
        axis, centre = Vec3(*unstack(self.axis)), Vec3(*unstack(self.centre))
        axis = axis * (1.0 / axis.norm())
        turn = (cos, axis.x * sin, axis.y * sin, axis.z * sin)
        return centre - pose_at(centre, turn).turn(centre), turn


def _as_motion(name: str, motion: Any) -> Any:
    """A function of time as a pytree, or None; a plain function, which would be a leaf, is wrapped."""
    if motion is None:
        return None
    check_callable(name, motion, "a function of time", takes=1)
    with traceable(name):
        jax.eval_shape(lambda t: _given_by(motion, t), jnp.zeros(()))
    return as_tree(name, motion)


class Stage(AbstractFinger):
    r"""A surface that is fixed, or moves as prescribed: a table, a turntable, a tube.

    A moving one has one position, its clock [s], and no velocity; start it at the run's `t0`. It takes the
    place of a finger in a `Grasp`, and does work on the object, which the energy balance counts.

    Args:
        surface: In the stage's frame.
        motion: `motion(t)` gives the frame's position [m], three numbers, and its quaternion (scalar first),
            four numbers, relative to `base` and `rotation`, twice differentiable in t [s]; any callable
            pytree, `Turning` for one. Default: none, the stage is fixed.
        base: Shape (3,), position of the frame [m].
        rotation: Quaternion (scalar first) of the frame's axes; scaled to unit length.

    Raises:
        ValueError: If `surface` is not a surface, `motion` cannot be called with a time, or `rotation` has no
            length.

    Example:
        >>> import jaxroll as jxr
        >>> table = jxr.Stage(jxr.Plane(), jxr.Turning(2.0))
        >>> table.positions, table.freedoms
        (1, 0)
    """

    tip: AbstractSurface = through(as_surface)
    motion_of: Callable[[Any], Any] | None = through(_as_motion)
    base: Float[Array, "3"] = real(3)
    rotation: Float[Array, "4"] = real(4, check=check_direction)

    def __init__(
        self,
        surface: AbstractSurface,
        motion: Callable[[Any], Any] | None = None,
        *,
        base: Given = (0.0, 0.0, 0.0),
        rotation: Given = (1.0, 0.0, 0.0, 0.0),
    ) -> None:
        self.tip = taken(self, "tip", surface, name="surface")
        self.motion_of = taken(self, "motion_of", motion, name="motion")
        self.base = taken(self, "base", base)
        self.rotation = taken(self, "rotation", rotation)

    @property
    def joints(self) -> int:
        return 0

    @property
    def positions(self) -> int:
        return 0 if self.motion_of is None else 1

    @property
    def labels(self) -> tuple[Coordinate, ...]:
        return (Coordinate("clock", "s"),) * self.positions

    @property
    def prescribed(self) -> bool:
        return self.motion_of is not None

    @property
    def size(self) -> Scalar:
        return jnp.full((), _SIZE)

    @property
    def turns(self) -> bool:
        return False

    def prepared(self) -> "Stage":
        ready = (unstack(self.base), unstack(self.rotation), self.tip.prepared())
        return eqx.tree_at(lambda s: (s.base, s.rotation, s.tip), self, ready)

    def _prescribed_pose(self, t: Scalar) -> tuple[Vec3, Quaternion]:
        """Position and unit quaternion of the frame in the world at time t."""
        base, turn = Vec3(*unstack(self.base)), normalised(unstack(self.rotation))
        if self.motion_of is None:
            return base, turn
        point, own = _given_by(self.motion_of, t)
        return pose_at(base, turn).place(Vec3(*point)), quaternion_product(turn, normalised(own))

    def _twist(self, t: Scalar) -> Twist3:
        r"""Twist at time t. Its spin is $2 \dot q \bar q$, from $\dot q = \frac12 (0, \omega)\,q$."""
        # The derivative in time: a jvp with the tangent one. `motion` differentiates this once more.
        (_, turn), (velocity, rate) = jax.jvp(self._prescribed_pose, (t,), (jnp.ones_like(t),))
        spin = quaternion_product(rate, conjugate(turn))
        return Twist3(velocity, Vec3(*spin[1:]) * 2.0)

    def placed(self, q: Scalars) -> tuple[Pose3, Spin]:
        return pose_at(*self._prescribed_pose(q[0] if q else jnp.zeros(()))), lambda v: Vec3(0.0, 0.0, 0.0)

    def skeleton(self, q: Scalars) -> tuple[Vec3, ...]:
        return (self.pose(q).origin,)

    def rates(self, q: Scalars, v: Scalars) -> Scalars:
        # The clock runs whatever the velocities are; there are none.
        return tuple(jnp.ones_like(clock) for clock in q)

    def displaced(self, q: Scalars, step: Scalars) -> Scalars:
        return q

    def motion(self, q: Scalars, v: Scalars, gravity: Vec3 | None) -> tuple[Motion, Inertia]:
        # No velocities: neither mass matrix nor unit twists. A moving stage's bias is its whole acceleration.
        nothing = Inertia((), ())
        if not q:
            still = Twist3(Vec3(0.0, 0.0, 0.0), Vec3(0.0, 0.0, 0.0))
            return Motion(self.pose(q), (), still, still), nothing
        twist, bias = jax.jvp(self._twist, (q[0],), (jnp.ones_like(q[0]),))
        return Motion(self.pose(q), (), twist, bias), nothing

    def gravity_potential(self, q: Scalars, gravity: Vec3) -> Scalar:
        return 0.0


def _given_by(motion: Callable[[Any], Any], t: Scalar) -> tuple[Any, Any]:
    """The position and the quaternion that a motion returns at time t, checked."""
    given = motion(t)
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise ValueError(
            f"argument motion must return a position and a quaternion, but returned {shown(given)}"
        )
    return _numbers(given[0], 3), _numbers(given[1], 4)


def _numbers(values: Any, count: int) -> Any:
    """A vector that a motion returned, an array or a sequence, as a tuple of `count` scalars."""
    if isinstance(values, tuple | list | Vec3):
        found = tuple(map(_number, values))
        fits = all(jnp.ndim(number) == 0 for number in found)
    else:
        array = jnp.asarray(_number(values))
        found, fits = unstack(array), array.ndim == 1
    if not fits or len(found) != count:
        raise ValueError(
            f"argument motion must return 3 coordinates and 4 of a quaternion, but returned {shown(values)}"
        )
    return found


def _number(value: Any) -> Any:
    """A number or array that a motion returned, checked to be real; Python's own floats stay as they are."""
    return value if isinstance(value, float) else as_array("motion, in what it returns,", value)
