r"""The gap between two contact points and its derivatives: the same lines in the plane and in space.

With a body's origin $r$, rotation $R$ and contact point $c$ in its own frame, the gap (5)-(6), (64)-(65) is
$g = (r_A + R_A c_A) - (r_B + R_B c_B)$, from the object B to the fingertip A. Rolling moves the contact
points over both bodies with one velocity, $R_A \dot c_A = R_B \dot c_B$, which cancels in

$$ \dot g = (v_A + \omega_A \times R_A c_A) - (v_B + \omega_B \times R_B c_B) = A v. $$

The Pfaffian rows $A$ are thus the derivative of the gap **at frozen contact coordinates**: velocities that
a twist gives at the end of an arm $R c$ (`Twist2.at`, `Twist3.at`). `gap_bias` is the bias $\dot A v$.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import jax

from .._linalg import Pose2, Pose3, Twist2, Twist3, Vec2, Vec3
from .._types import Scalars
from .._xla import once

Rows = tuple[Scalars, ...]
_Vec = TypeVar("_Vec", Vec2, Vec3)
_Pose = TypeVar("_Pose", Pose2, Pose3)
_Twist = TypeVar("_Twist", Twist2, Twist3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Motion:
    r"""Motion of one body frame, in the plane or in space.

    Attributes:
        pose: The frame in the world.
        unit_twists: Twist per unit rate of each coordinate: the columns of its Jacobian $J$.
        twist: $J v$, plus that of a prescribed motion.
        bias: $\dot J v$, the acceleration at $\dot v = 0$, plus that of a prescribed motion.
    """

    pose: Any
    unit_twists: tuple[Any, ...]
    twist: Any
    bias: Any

    def resting(self) -> "Motion":
        """The same pose at zero velocity."""
        return replace(self, twist=jax.tree.map(lambda _: 0.0, self.twist))


def gap(tip: _Pose, object_: _Pose, points: tuple[_Vec, _Vec]) -> _Vec:
    """World-frame vector from the object's contact point to the fingertip's; (5)-(6), (64)-(65)."""
    return tip.place(points[0]) - object_.place(points[1])  # pyright: ignore


def gap_rate(twists: tuple[_Twist, _Twist], arms: tuple[_Vec, _Vec]) -> _Vec:
    """Rate of the gap under the twists of both bodies, at frozen contact coordinates."""
    return twists[0].at(arms[0]) - twists[1].at(arms[1])  # pyright: ignore


def pfaffian(
    unit_twists: tuple[Sequence[_Twist], Sequence[_Twist]], arms: tuple[_Vec, _Vec]
) -> tuple[tuple[_Vec, ...], tuple[_Vec, ...]]:
    """Columns of $A$, vectors in world axes, for the fingertip's and for the object's unit rates."""
    tip, object_ = unit_twists
    return tuple(unit.at(arms[0]) for unit in tip), tuple(-unit.at(arms[1]) for unit in object_)  # pyright: ignore


def gap_bias(bodies: tuple[Motion, Motion], arms: tuple[_Vec, _Vec], rolling: tuple[_Vec, _Vec]) -> _Vec:
    r"""Second derivative of the gap at $\dot v = 0$, which is $\dot A v$: the product rule on `gap_rate`.

    With $\dot g = v + \omega \times r$ at both points: $\dot v + \dot\omega \times r + \omega \times \dot r$.

    Args:
        bodies: Motions of fingertip and object.
        arms: From the frames' origins to the contact points, in world axes.
        rolling: Velocities of these points over their bodies, in world axes.
    """
    # An arm R c changes by omega x R c, which a twist without velocity gives at its end, and by R c'.
    still = bodies[0].resting().twist.velocity
    first, second = (type(motion.twist)(still, motion.twist.spin) for motion in bodies)
    moves = first.at(arms[0]) + rolling[0], second.at(arms[1]) + rolling[1]
    return gap_rate((bodies[0].bias, bodies[1].bias), arms) + gap_rate((first, second), moves)


def arms_of(poses: tuple[Any, Any], points: tuple[Any, Any]) -> tuple[Any, Any]:
    """Vectors from the frames' origins to the contact points, $R c$, in world axes."""
    return once((poses[0].turn(points[0]), poses[1].turn(points[1])))


def row_wise(columns: Sequence[Any], rows: int) -> Rows:
    """Columns of a Jacobian, each a vector, as its rows."""
    entries = [tuple(column) for column in columns]
    return tuple(tuple(entry[i] for entry in entries) for i in range(rows))
