r"""Carrying an object: the opposition of (16) about a frame that commands move.

The tips are drawn together as by `Opposition`, which presses them on the object, and each is held by a spring
to its place in a frame that is commanded: moving and turning the frame moves and turns what the tips hold.
That is impedance control of the tips, blind to the object as the chapter's laws are: the frame that commands
move is not the object's, as the object also rolls on the tips.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .._fields import changes_in_time, Command, command, Commanded, held, shape_of, taken
from .._linalg import root, sincos, total, unstack, Vec3
from .._mechanics import AbstractController, Torques
from .._results import check_positive
from .._types import Given, Scalar, Scalars
from .._xla import once
from ._sensing import Sensed

# Squared angle [rad^2] below which `_turned` takes series, which are exact there in double precision.
_SMALL = 1e-8


def _as_home(name: str, home: Array) -> Array:
    """Raise unless two tips or more have a place."""
    if home.shape[0] < 2:
        raise ValueError(
            f"argument {name} must have a place for each of two fingers or more, but had {home.shape[0]}"
        )
    return home


class Carry(AbstractController):
    r"""Tips that grip one another, carried by a frame that commands move, in space.

    $$ u_i = -c_i \dot q_i - J_i^T \Bigl( \beta \sum_j (r_i - r_j) + k\,(r_i - p - R(\varphi)\,h_i)
    - \tfrac1n F \Bigr) $$

    from the potential
    $P = \frac\beta2 \sum_{i<j} |r_i - r_j|^2 + \frac k2 \sum_i |r_i - p - R h_i|^2 - F \cdot \bar r$, with
    the mean $\bar r$ of the tips. If one of its numbers but the damping changes in time there is no
    potential, and the whole power of the joint torques counts as work.

    Args:
        beta: $\beta$ [N/m]: as in `Opposition`, every pair of tips attracts.
        damping: $c_i$ [N m s], one for all or shape (fingers,).
        stiffness: $k$ [N/m], positive.
        home: $h_i$, shape (fingers, 3): place of each tip in the frame [m].
        position: $p$, shape (3,): origin of the frame in the world [m].
        turn: $\varphi$, shape (3,): axis times angle by which the frame is turned [rad].
        force: $F$, shape (3,): what the tips carry together [N], such as an object's weight, upwards.

    Raises:
        ValueError: If a number is not finite, the stiffness is not positive, or a shape does not fit.

    Example:
        >>> import jaxroll as jxr
        >>> home = [(0.03, 0.0, 0.0), (-0.03, 0.0, 0.0)]
        >>> rise = jxr.commands.Ramps([0.0, 1.0], [(0.0, 0.0, 0.1), (0.0, 0.0, 0.12)])
        >>> control = jxr.control.Carry(12.0, 0.02, 200.0, home=home, position=rise)
        >>> control.at(0.5).position.tolist()
        [0.0, 0.0, 0.11]
    """

    beta: Commanded = command()
    damping: Commanded = command(each_finger=True)
    stiffness: Commanded = command(check=check_positive)
    home: Commanded = command(None, 3, check=_as_home)
    position: Commanded = command(3)
    turn: Commanded = command(3)
    force: Commanded = command(3)

    def __init__(
        self,
        beta: Command,
        damping: Command,
        stiffness: Command,
        *,
        home: Command,
        position: Command = (0.0, 0.0, 0.0),
        turn: Command = (0.0, 0.0, 0.0),
        force: Command = (0.0, 0.0, 0.0),
    ) -> None:
        self.beta = taken(self, "beta", beta)
        self.home = taken(self, "home", home)
        self.damping = taken(self, "damping", damping, shape=shape_of(self.home)[:1])
        self.stiffness = taken(self, "stiffness", stiffness)
        self.position = taken(self, "position", position)
        self.turn = taken(self, "turn", turn)
        self.force = taken(self, "force", force)

    def check(self, fingers: int, axes: int) -> None:
        if axes != 3:
            raise ValueError(
                "argument controller must be one for the plane, as the grasp is of the plane, but was a Carry"
            )
        if (count := shape_of(self.home)[0]) != fingers:
            raise ValueError(
                f"argument home must have a place for each of {fingers} fingers, but had {count}"
            )

    def at(self, t: Given) -> "Carry":
        """This controller at one time [s], with numbers in the place of functions of time."""
        if (now := held(self, t)) is self:
            return self
        # A function may return one number for all fingers.
        return eqx.tree_at(lambda c: c.damping, now, jnp.broadcast_to(now.damping, now.home.shape[:1]))

    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        now, tips = self.at(t), [finger.tip for finger in fingers]
        pulls = [once(pull) for pull in now._pulls(tips)]
        return tuple(
            tuple(
                -now.damping[i] * rate - unit.velocity.dot(pulls[i])
                for rate, unit in zip(finger.rates, finger.unit_twists, strict=True)
            )
            for i, finger in enumerate(fingers)
        )

    def potential(self, tips: Sequence[Any], angles: Sequence[Scalars]) -> Scalar:
        del angles
        if changes_in_time(self, "beta", "stiffness", "home", "position", "turn", "force"):
            return jnp.zeros_like(tips[0].x)
        pairs = [b - a for i, a in enumerate(tips) for b in tips[i + 1 :]]
        drawn = 0.5 * self.beta * total([arm.dot(arm) for arm in pairs])
        away = self._away(tips)
        held_back = 0.5 * self.stiffness * total([arm.dot(arm) for arm in away])
        return drawn + held_back - self._share(tips).dot(total(tips))

    def _pulls(self, tips: Sequence[Any]) -> list[Any]:
        """Gradient of the potential with respect to every tip [N]; of numbers alone."""
        middle, share = total(tips), self._share(tips)
        return [
            (tip * float(len(tips)) - middle) * self.beta + away * self.stiffness - share
            for tip, away in zip(tips, self._away(tips), strict=True)
        ]

    def _away(self, tips: Sequence[Any]) -> list[Any]:
        """From every tip's place in the world, $p + R h_i$, to the tip [m]."""
        turn, origin = Vec3(*unstack(self.turn)), Vec3(*unstack(self.position))
        places = [origin + _turned(Vec3(*place), turn) for place in unstack(self.home)]
        return [tip - place for tip, place in zip(tips, places, strict=True)]

    def _share(self, tips: Sequence[Any]) -> Any:
        """What one tip carries [N]."""
        return Vec3(*unstack(self.force)) * (1.0 / len(tips))


def _turned(vector: Vec3, turn: Vec3) -> Vec3:
    r"""A vector turned by axis times angle, Rodrigues: $v + a\,w \times v + b\,w \times (w \times v)$."""
    square = turn.dot(turn)
    # a = sin(x)/x and b = (1 - cos x)/x^2 = (sin(x/2)/(x/2))^2 / 2, by their series where x is small.
    small = square < _SMALL
    angle = root(jnp.where(small, 1.0, square))
    (sine, _), (half, _) = sincos(angle), sincos(0.5 * angle)
    a = jnp.where(small, 1.0 - square / 6.0, sine / angle)
    b = jnp.where(small, 0.5 - square / 24.0, 2.0 * half * half / (angle * angle))
    across = turn.cross(vector)
    return vector + across * a + turn.cross(across) * b
