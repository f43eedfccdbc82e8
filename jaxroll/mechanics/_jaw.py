"""A jaw: a body that only translates, on prismatic joints, or is fixed."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra import Pose2, sincos, total, Twist2, unstack, Vec2
from .._results import as_floats, check_positive
from .._types import Given, Scalar, Scalars
from ..contact import Motion
from ..geometry import AbstractContour
from ._body import Inertia
from ._finger import AbstractFinger, check_tip

# Nothing in a jaw says how large it is, and only scaling and drawing ask: a gripper's order of magnitude [m].
_SIZE = 0.05


class Jaw(AbstractFinger):
    r"""A body on $k$ = 0, 1 or 2 prismatic joints: a plate, the jaw of a parallel gripper, or a fixed wall.

    Its coordinates are the displacements [m] along its directions, and the controller's "torques" the forces
    [N] along them.

    Args:
        contour: The contour in the jaw's frame.
        mass: In kilograms; of no effect when fixed.
        directions: Shape (k,), angle of each joint's axis in the world [rad]; none for a fixed wall.
        base: Shape (2,), the frame's origin at zero displacement [m].
        angle: Constant angle of the frame [rad].

    Raises:
        ValueError: If there are more than two directions, or the mass is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> plate = jxr.Jaw(jxr.Line(), mass=0.1, directions=[0.0, 1.5707963])
        >>> plate.joints
        2
    """

    tip: AbstractContour
    mass: Float[Array, ""]
    directions: Float[Array, " k"]
    base: Float[Array, "2"]
    angle: Float[Array, ""]
    axes: tuple[Vec2, ...] | None

    def __init__(
        self,
        contour: AbstractContour,
        mass: Given = 1.0,
        directions: Given = (),
        *,
        base: Given = (0.0, 0.0),
        angle: Given = 0.0,
    ) -> None:
        self.tip = check_tip("contour", contour)
        self.mass = check_positive("mass", as_floats("mass", mass, ()))
        self.directions = as_floats("directions", directions, (None,))
        if self.directions.shape[0] > 2:
            raise ValueError(
                f"argument directions must be at most 2 angles, but were {self.directions.shape[0]}"
            )
        self.base = as_floats("base", base, (2,))
        self.angle = as_floats("angle", angle, ())
        self.axes = None

    @property
    def joints(self) -> int:
        return len(self.directions)

    @property
    def size(self) -> Scalar:
        return jnp.full_like(self.mass, _SIZE)

    @property
    def turns(self) -> bool:
        return False

    def prepared(self) -> "Jaw":
        fields = lambda j: (j.directions, j.base, j.tip, j.axes)  # noqa: E731
        ready = (unstack(self.directions), unstack(self.base), self.tip.prepared(), self._axes())
        return eqx.tree_at(fields, self, ready, is_leaf=lambda x: x is None)

    def pose(self, q: Scalars) -> Pose2:
        heading, *along = self._axes()
        moves = [direction * x for direction, x in zip(along, q, strict=True)]
        return Pose2(total([Vec2(self.base[0], self.base[1]), *moves]), heading.x, heading.y)

    def skeleton(self, q: Scalars) -> tuple[Vec2, ...]:
        return (self.pose(q).origin,)

    def spin(self, q: Scalars, v: Scalars) -> Scalar:
        return jnp.zeros_like(self.angle)

    def motion(self, q: Scalars, v: Scalars, gravity: Vec2 | None) -> tuple[Motion, Inertia]:
        zero = jnp.zeros_like(self.angle)
        still = Twist2(Vec2(zero, zero), zero)
        _, *along = self._axes()
        units = tuple(Twist2(direction, zero) for direction in along)
        twist = total([still, *(unit * rate for unit, rate in zip(units, v, strict=True))])
        mass = tuple(tuple(self.mass * a.dot(b) for b in along[: i + 1]) for i, a in enumerate(along))
        force = tuple(zero if gravity is None else -self.mass * gravity.dot(a) for a in along)
        return Motion(self.pose(q), units, twist, still), Inertia(mass, force)

    def gravity_potential(self, q: Scalars, gravity: Vec2) -> Scalar:
        return -self.mass * gravity.dot(self.pose(q).origin)

    def _axes(self) -> tuple[Vec2, ...]:
        """Heading of the frame, then of every joint."""
        if self.axes is not None:
            return self.axes
        pairs = [sincos(angle) for angle in (self.angle, *unstack(self.directions))]
        return tuple(Vec2(cos, sin) for sin, cos in pairs)
