"""The chapter's controls: `Press` is (75), `Opposition` (16)-(17).

Both are joint damping and the negative gradient of a potential of the tips and joint angles, which
`_motion/_quantities` counts among the energies, and with which it finds the dissipation.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .._fields import command, held, is_command, shape_returned, taken
from .._linalg import total, unstack
from .._mechanics import AbstractController, Torques
from .._results import check_positive
from .._types import Given, Scalar, Scalars
from ._sensing import Sensed

# What a field holds: an array, or a function of time that returns one. `held` leaves arrays alone, so that
# the arithmetic below has no others.
_Number = Any
# What a constructor takes for it.
_Command = Given | Callable[[Any], Any]


def shape_of(given: Any) -> tuple[int, ...]:
    """Shape of numbers, or of what a function of time returns."""
    return shape_returned(given) if is_command(given) else given.shape


def changes_in_time(controller: AbstractController, *names: str) -> bool:
    """Whether one of these numbers is a function of time.

    A potential of numbers that change is none: the whole power of the torques counts as work then.
    """
    return any(is_command(getattr(controller, name)) for name in names)


def _check_held(controller: AbstractController, *names: str) -> None:
    """Raise where one of these is a function of time and a number is asked for."""
    if changes_in_time(controller, *names):
        raise ValueError(
            f"argument controller must have numbers as {' and '.join(names)}, as those of `at(t)` are, "
            f"but one is a function of time"
        )


class Passive(AbstractController):
    """No torques at all."""

    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        return tuple(tuple(jnp.zeros_like(a) for a in f.angles) for f in fingers)

    def potential(self, tips: Sequence[Any], angles: Sequence[Scalars]) -> Scalar:
        return jnp.zeros_like(tips[0].x)


def _as_point(name: str, point: Array) -> Array:
    """The point, if it has two or three coordinates; `Press.check` compares their number with the grasp's."""
    if point.shape[0] not in (2, 3):
        raise ValueError(f"argument {name} must have shape (2) or (3), but had shape {point.shape}")
    return point


class Press(AbstractController):
    r"""Press the fingertip towards a fixed point: control (75) with joint damping.

    $u = -c\,\dot q - (f_d/r)\, J_{01}^T (r_{01} - r_m)$, from the potential
    $U = \frac{f_d}{2r} \|r_{01} - r_m\|^2$, for every finger.

    Args:
        force: Internal force $f_d$, in newtons; a negative one pushes the fingertip away.
        radius: The constant $r$, in metres, positive.
        damping: Joint damping $c$, in N m s; a negative one feeds energy in.
        target: Shape (2,), in space (3,): the fixed point $r_m$ in the world (the object's pivot), in metres.

    Raises:
        ValueError: If a number is not finite, a shape does not fit, or the radius is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> control = jxr.control.Press(0.5, 0.010, 0.006, target=(0.0, 0.1))
        >>> f"{control.stiffness:.0f} N/m"
        '50 N/m'
    """

    force: _Number = command()
    radius: _Number = command(check=check_positive)
    damping: _Number = command()
    target: _Number = command(None, check=_as_point)

    def __init__(self, force: _Command, radius: _Command, damping: _Command, *, target: _Command) -> None:
        self.force = taken(self, "force", force)
        self.radius = taken(self, "radius", radius)
        self.damping = taken(self, "damping", damping)
        self.target = taken(self, "target", target)

    def check(self, fingers: int, axes: int) -> None:
        del fingers
        if (shape := shape_of(self.target)) and shape[-1] != axes:
            raise ValueError(
                f"argument target must have shape ({axes}), as the grasp's points have, but had shape {shape}"
            )

    def at(self, t: Given) -> "Press":
        """This controller at one time [s], with numbers in the place of functions of time."""
        return held(self, t)

    @property
    def stiffness(self) -> Scalar:
        """$f_d / r$ [N/m]; of a force or radius that changes in time, that of `at(t)`."""
        _check_held(self, "force", "radius")
        return self.force / self.radius

    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        now = self.at(t)
        return tuple(now._finger(finger) for finger in fingers)

    def _finger(self, finger: Sensed) -> Scalars:
        # -c q' - J^T (f_d/r) (r_01 - r_m), joint by joint: the dot product with one column of J at a time.
        pull = self._arm(finger.tip) * self.stiffness
        return tuple(
            -self.damping * rate - unit.velocity.dot(pull)
            for rate, unit in zip(finger.rates, finger.unit_twists, strict=True)
        )

    def potential(self, tips: Sequence[Any], angles: Sequence[Scalars]) -> Scalar:
        if changes_in_time(self, "force", "radius", "target"):
            return jnp.zeros_like(tips[0].x)
        arms = [self._arm(tip) for tip in tips]
        return 0.5 * self.stiffness * total([arm.dot(arm) for arm in arms])

    def _arm(self, tip: Any) -> Any:
        """From the target to a tip."""
        return tip - type(tip)(*unstack(self.target))


def _as_start(name: str, start: Array) -> Array:
    """The angles, if there are at least two: one finger has none to oppose."""
    if start.shape[0] < 2:
        raise ValueError(
            f"argument {name} must have one angle for each of two fingers or more, but had {start.shape[0]}"
        )
    return start


class Opposition(AbstractController):
    r"""Fingers-thumb opposition with joint damping: control (16)-(17).

    $u_i = -c_i \dot q_i + (-1)^i \beta J_i^T (r_1 - r_2) - \alpha_i \hat N_i e_i$ with
    $\hat N_i = p_i - p_i(0)$, $p_i = e_i^T q_i$: tips attract each other, and each last link keeps its
    orientation. For more than two fingers every pair attracts. It derives from the potential (22),
    $P = \frac\beta2 \sum_{i<j} \|r_i - r_j\|^2 + \sum_i \frac{\alpha_i}{2} \hat N_i^2$.

    Args:
        beta: $\beta$ [N/m].
        damping: $c_i$ [N m s], one for all or shape (fingers,).
        alpha: $\alpha_i$ [N m/rad], one for all or shape (fingers,). With zero the grasp comes to
            rest where $O_1, P_1, P_2, O_2$ are collinear; otherwise a little off.
        start: $p_i(0)$ [rad], shape (fingers,): sums of each finger's joint angles (`orientations`).

    Gains may have any sign: negative ones push the tips apart, feed energy in, or turn the last link away.

    Raises:
        ValueError: If a number is not finite, there are fewer than two fingers, or a count does not fit.

    Example:
        >>> import jaxroll as jxr
        >>> control = jxr.control.Opposition(20.0, 0.006, 0.001, start=(1.5, 1.7))
        >>> control.damping.tolist()
        [0.006, 0.006]
    """

    beta: _Number = command()
    damping: _Number = command(each_finger=True)
    alpha: _Number = command(each_finger=True)
    start: _Number = command(None, check=_as_start)

    def __init__(self, beta: _Command, damping: _Command, alpha: _Command = 0.0, *, start: _Command) -> None:
        self.beta = taken(self, "beta", beta)
        self.start = taken(self, "start", start)
        self.damping = taken(self, "damping", damping, shape=shape_of(self.start))
        self.alpha = taken(self, "alpha", alpha, shape=shape_of(self.start))

    def at(self, t: Given) -> "Opposition":
        """This controller at one time [s], with numbers in the place of functions of time."""
        if (now := held(self, t)) is self:
            return self
        # A function may return one number for all fingers.
        gains = [jnp.broadcast_to(gain, now.start.shape) for gain in (now.damping, now.alpha)]
        return eqx.tree_at(lambda c: [c.damping, c.alpha], now, gains)

    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        tips, now = [finger.tip for finger in fingers], self.at(t)
        return tuple(now._finger(i, finger, now._pull(i, tips)) for i, finger in enumerate(fingers))

    def _pull(self, i: int, tips: Sequence[Any]) -> Any:
        r"""Gradient of the first term of P with respect to tip i: $\beta \sum_{j \ne i} (r_i - r_j)$ [N].

        For two fingers $-J_i^T$ times it is the second term of (16), $(-1)^i \beta J_i^T (r_1 - r_2)$.
        """
        return total([tips[i] - tip for j, tip in enumerate(tips) if j != i]) * self.beta

    def _finger(self, i: int, finger: Sensed, pull: Any) -> Scalars:
        # alpha_i (p_i - p_i(0)), the same for every joint, since p_i is the sum of their angles.
        turn = self.alpha[i] * (total(finger.angles) - self.start[i])
        return tuple(
            -self.damping[i] * rate - unit.velocity.dot(pull) - turn
            for rate, unit in zip(finger.rates, finger.unit_twists, strict=True)
        )

    def potential(self, tips: Sequence[Any], angles: Sequence[Scalars]) -> Scalar:
        if changes_in_time(self, "beta", "alpha", "start"):
            return jnp.zeros_like(tips[0].x)
        pairs = [b - a for i, a in enumerate(tips) for b in tips[i + 1 :]]
        turns = [total(q) - self.start[i] for i, q in enumerate(angles)]
        kept = total([0.5 * self.alpha[i] * turn * turn for i, turn in enumerate(turns)])
        return 0.5 * self.beta * total([arm.dot(arm) for arm in pairs]) + kept

    def check(self, fingers: int, axes: int) -> None:
        del axes
        count = shape_of(self.start)[-1]
        if not 2 <= fingers == count:
            raise ValueError(
                f"argument start must have one angle for each of two fingers or more, but had "
                f"{count} for {fingers}"
            )
