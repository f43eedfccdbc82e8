r"""Joint torques from joint data and finger kinematics alone ("blind" control).

A controller sees the time, its own fingers' joint angles and rates, and the tip frames they imply; it
never sees the object. Built-in controllers work on scalars and know their potential energy; any other
callable pytree `f(t, angles, rates, tips)` works too (see `Grasp`).
"""

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._algebra import total, Twist2, Vec2
from ._results import as_floats, check_finite
from ._types import Given, Scalar, Scalars
from .mechanics import Motion

Torques = tuple[Scalars, ...]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Sensed:
    """What one finger knows of itself, as scalars."""

    angles: Scalars
    rates: Scalars
    tip: Vec2
    unit_twists: tuple[Twist2, ...]


class Tip(eqx.Module):
    """A finger's tip frame as a user's controller sees it.

    Attributes:
        position: Shape (2,), origin of the tip frame in the world, in metres.
        jacobian: Shape (2, k), its derivative with respect to the joint angles, in metres.
    """

    position: Float[Array, "2"]
    jacobian: Float[Array, "2 k"]


def sense(motion: Motion, angles: Scalars, rates: Scalars) -> Sensed:
    """Reduce a finger's motion to what its controller may know."""
    return Sensed(angles, rates, motion.pose.origin, motion.unit_twists)


class AbstractController(eqx.Module):
    """A built-in controller: torques on scalars, and the potential they derive from."""

    @abc.abstractmethod
    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        """Joint torques [N m] of every finger."""

    @abc.abstractmethod
    def potential(self, tips: Sequence[Vec2], angles: Sequence[Scalars]) -> Scalar:
        """Artificial potential energy [J] whose negative gradient is part of the torques."""


class Passive(AbstractController):
    """No torques at all."""

    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        return tuple(tuple(jnp.zeros_like(a) for a in f.angles) for f in fingers)

    def potential(self, tips: Sequence[Vec2], angles: Sequence[Scalars]) -> Scalar:
        return jnp.zeros_like(tips[0].x)


class Press(AbstractController):
    r"""Press the fingertip towards a fixed point: control (75) with joint damping.

    $u = -c\,\dot q - (f_d/r)\, J_{01}^T (r_{01} - r_m)$, from the potential
    $U = \frac{f_d}{2r} \|r_{01} - r_m\|^2$, for every finger.

    Args:
        force: Internal force $f_d$, in newtons.
        radius: The constant $r$, in metres, positive.
        damping: Joint damping $c$, in N m s.
        target: Shape (2,), the fixed point $r_m$ in the world (the object's pivot), in metres.

    Example:
        >>> import jaxroll as jxr
        >>> control = jxr.control.Press(0.5, 0.010, 0.006, target=(0.0, 0.1))
        >>> f"{control.stiffness:.0f} N/m"
        '50 N/m'
    """

    force: Float[Array, ""]
    radius: Float[Array, ""]
    damping: Float[Array, ""]
    target: Float[Array, "2"]

    def __init__(self, force: Given, radius: Given, damping: Given, *, target: Given) -> None:
        self.force = check_finite("force", as_floats("force", force, ()))
        self.radius = as_floats("radius", radius, ())
        self.damping = as_floats("damping", damping, ())
        self.target = as_floats("target", target, (2,))

    @property
    def stiffness(self) -> Scalar:
        """$f_d / r$ [N/m]."""
        return self.force / self.radius

    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        return tuple(self._finger(finger) for finger in fingers)

    def _finger(self, finger: Sensed) -> Scalars:
        pull = (finger.tip - Vec2(self.target[0], self.target[1])) * self.stiffness
        return tuple(
            -self.damping * rate - unit.velocity.dot(pull)
            for rate, unit in zip(finger.rates, finger.unit_twists, strict=True)
        )

    def potential(self, tips: Sequence[Vec2], angles: Sequence[Scalars]) -> Scalar:
        arms = [tip - Vec2(self.target[0], self.target[1]) for tip in tips]
        return 0.5 * self.stiffness * total([arm.dot(arm) for arm in arms])


class UserController(AbstractController):
    """Adapter that calls a user's `f(t, angles, rates, tips)` with ordinary arrays."""

    function: Any

    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        angles = tuple(jnp.stack(f.angles) for f in fingers)
        rates = tuple(jnp.stack(f.rates) for f in fingers)
        given = self.function(t, angles, rates, tuple(_tip(f) for f in fingers))
        wanted = [a.shape for a in angles]
        if not isinstance(given, tuple | list) or [jnp.shape(g) for g in given] != wanted:
            raise ValueError(
                f"argument controller must return one torque array per finger, of shapes {wanted}, "
                f"but returned {jax.tree.map(jnp.shape, given)}"
            )
        return tuple(tuple(torque[i] for i in range(torque.shape[0])) for torque in given)

    def potential(self, tips: Sequence[Vec2], angles: Sequence[Scalars]) -> Scalar:
        return jnp.zeros_like(tips[0].x)


def _tip(finger: Sensed) -> Tip:
    jacobian = jnp.stack([unit.velocity.array() for unit in finger.unit_twists], axis=-1)
    return Tip(finger.tip.array(), jacobian)


def as_controller(controller: Any) -> AbstractController:
    """Wrap a callable; pass a built-in controller through; None means no torques."""
    if controller is None:
        return Passive()
    if isinstance(controller, AbstractController):
        return controller
    if not callable(controller):
        raise ValueError(f"argument controller must be callable, but was {controller!r}")
    return UserController(controller)
