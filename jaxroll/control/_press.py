r"""The chapter's control of one finger, (75): joint damping, and a pull of the fingertip to a fixed point.

The pull is the negative gradient of a potential of the tips, which `_motion/_quantities` counts among the
energies and needs to find the dissipation. `_opposition` has the chapter's law for two fingers.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from .._fields import changes_in_time, Command, command, Commanded, held, shape_of, taken
from .._linalg import total, unstack
from .._mechanics import AbstractController, Torques
from .._results import check_positive
from .._types import Given, Scalar, Scalars
from ._sensing import Sensed


def _check_held(controller: AbstractController, *names: str) -> None:
    """Raise where one of these is a function of time and a number is asked for."""
    if changes_in_time(controller, *names):
        raise ValueError(
            f"argument controller must have numbers as {' and '.join(names)}, as those of `at(t)` are, "
            f"but one is a function of time"
        )


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

    force: Commanded = command()
    radius: Commanded = command(check=check_positive)
    damping: Commanded = command()
    target: Commanded = command(None, check=_as_point)

    def __init__(self, force: Command, radius: Command, damping: Command, *, target: Command) -> None:
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
        return held(self, t) if self._commanded else self

    @property
    def _commanded(self) -> bool:
        """Whether any of its numbers is a function of time."""
        return any(map(callable, (self.force, self.radius, self.damping, self.target)))

    @property
    def stiffness(self) -> Scalar:
        """$f_d / r$ [N/m]; of a force or radius that changes in time, that of `at(t)`."""
        if self._commanded:
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
