r"""A jaw: a body that only translates, on prismatic joints, or is fixed.

With unit vectors $a_i$ along its joints its frame is at $r = r_0 + \sum_i a_i q_i$, and
$M_{ij} = m\, a_i \cdot a_j$. Axes never turn, so that there are no velocity terms.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._linalg import Pose2, sincos, total, Twist2, unstack, Vec2
from .._results import check_positive, concrete, shown
from .._types import Given, Scalar, Scalars
from ..contact import Motion
from ..geometry import AbstractContour
from ._body import AbstractFinger, Inertia, Spin, with_scalar_limits
from ._finger import as_tip, check_limits

# A jaw has no length of its own. Only scaling and drawing need one: a gripper's order of magnitude [m].
_SIZE = 0.05


# Axes that make a smaller angle than this [rad] count as parallel: the mass matrix would be singular.
_APART = 1e-6


def _as_directions(name: str, angles: Array) -> Array:
    """Raise for more than two axes, or for two along one line."""
    if angles.shape[0] > 2:
        raise ValueError(f"argument {name} must be at most 2 angles, but were {angles.shape[0]}")
    seen = concrete(angles)
    if seen is not None and len(seen) == 2 and abs(np.sin(seen[1] - seen[0])) < _APART:
        raise ValueError(f"argument {name} must not be parallel, but was {shown(seen)}")
    return angles


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
        limits: Shape (k, 2), least and largest displacement along every direction [m]: a run ends there with
            the code `joint_limit`. Default: none.
        torque_limits: Shape (k,), largest force along every direction [N]: a run ends with `torque_limit`
            where the controller asks for more. Default: none.

    Raises:
        ValueError: If there are more than two directions or they are parallel, the mass or a limit of forces
            is not positive, or limits do not rise.

    Example:
        >>> import jaxroll as jxr
        >>> plate = jxr.Jaw(jxr.Line(), mass=0.1, directions=[0.0, 1.5707963])
        >>> plate.joints
        2
    """

    tip: AbstractContour = through(as_tip)
    mass: Float[Array, ""] = real(check=check_positive)
    directions: Float[Array, " k"] = real(None, check=_as_directions)
    base: Float[Array, "2"] = real(2)
    angle: Float[Array, ""] = real()
    limits: Float[Array, "k 2"] | None = real(None, 2, check=check_limits, optional=True)
    torque_limits: Float[Array, " k"] | None = real(None, check=check_positive, optional=True)
    axes: tuple[Vec2, ...] | None = None

    def __init__(
        self,
        contour: AbstractContour,
        mass: Given = 1.0,
        directions: Given = (),
        *,
        base: Given = (0.0, 0.0),
        angle: Given = 0.0,
        limits: Given | None = None,
        torque_limits: Given | None = None,
    ) -> None:
        self.tip = taken(self, "tip", contour, name="contour")
        self.mass = taken(self, "mass", mass)
        self.directions = taken(self, "directions", directions)
        self.base = taken(self, "base", base)
        self.angle = taken(self, "angle", angle)
        self.limits = taken(self, "limits", limits, shape=(self.joints, 2))
        self.torque_limits = taken(self, "torque_limits", torque_limits, shape=(self.joints,))
        self.axes = None  # set by `prepared`; assigned here since `tree_at` does not see a class's default

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
        return with_scalar_limits(eqx.tree_at(fields, self, ready, is_leaf=lambda x: x is None))

    def placed(self, q: Scalars) -> tuple[Pose2, Spin]:
        heading, *along = self._axes()
        moves = [direction * x for direction, x in zip(along, q, strict=True)]
        origin = total([Vec2(self.base[0], self.base[1]), *moves])
        return Pose2(origin, heading.x, heading.y), lambda v: 0.0

    def skeleton(self, q: Scalars) -> tuple[Vec2, ...]:
        return (self.pose(q).origin,)

    def motion(self, q: Scalars, v: Scalars, gravity: Vec2 | None) -> tuple[Motion, Inertia]:
        still = Twist2(Vec2(0.0, 0.0), 0.0)
        _, *along = self._axes()
        units = tuple(Twist2(direction, 0.0) for direction in along)
        # `still` comes first for a fixed wall: without joints there would be nothing to add up.
        twist = total([still, *(unit * rate for unit, rate in zip(units, v, strict=True))])
        mass = tuple(tuple(self.mass * a.dot(b) for b in along[: i + 1]) for i, a in enumerate(along))
        force = tuple(0.0 if gravity is None else -self.mass * gravity.dot(a) for a in along)
        return Motion(self.pose(q), units, twist, still), Inertia(mass, force)

    def gravity_potential(self, q: Scalars, gravity: Vec2) -> Scalar:
        return -self.mass * gravity.dot(self.pose(q).origin)

    def _axes(self) -> tuple[Vec2, ...]:
        """Unit vectors along the frame's x axis, then along every joint's; kept by `prepared`."""
        if self.axes is not None:
            return self.axes
        pairs = [sincos(angle) for angle in (self.angle, *unstack(self.directions))]
        return tuple(Vec2(cos, sin) for sin, cos in pairs)
