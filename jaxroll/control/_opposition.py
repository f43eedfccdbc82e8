r"""The chapter's control of two fingers, (16)-(17): joint damping, and tips that attract each other.

The torques besides damping are the negative gradient of a potential of tips and joint angles, which
`_motion/_quantities` counts among the energies and needs to find the dissipation. `_press` has the chapter's
law for one finger.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .._fields import changes_in_time, Command, command, Commanded, held, shape_of, taken
from .._linalg import total
from .._mechanics import AbstractController, Torques
from .._types import Given, Scalar, Scalars
from ._sensing import Sensed


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

    beta: Commanded = command()
    damping: Commanded = command(each_finger=True)
    alpha: Commanded = command(each_finger=True)
    start: Commanded = command(None, check=_as_start)

    def __init__(self, beta: Command, damping: Command, alpha: Command = 0.0, *, start: Command) -> None:
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
