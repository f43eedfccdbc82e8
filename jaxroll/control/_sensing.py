"""What controllers sense: joint data of the grasp's fingers, and the tip frames that these imply."""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._linalg import total
from .._mechanics import Blocks, check_states, Grasp, split, State
from .._printing import listed
from .._types import Scalars
from .._xla import quickly
from ..contact import Motion


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Sensed:
    """What one finger knows of itself, as scalars.

    Attributes:
        angles: Joint angles [rad], of a jaw its joints' positions [m].
        rates: Their rates.
        tip: Origin of the tip frame in the world [m].
        unit_twists: Twist of the tip frame per unit rate of each joint; its velocity is a column of $J_i$.
    """

    angles: Scalars
    rates: Scalars
    tip: Any  # `Vec2`, or `Vec3` in space
    unit_twists: tuple[Any, ...]


class Tip(eqx.Module):
    """A finger's tip frame as a user's controller sees it.

    Attributes:
        position: Shape (2,), in space (3,): origin of the tip frame in the world, in metres.
        jacobian: Shape (2, k), in space (3, k): its derivative with respect to the joint angles, in metres.
    """

    __repr__ = listed

    position: Float[Array, "d"]
    jacobian: Float[Array, "d k"]


def sense(motion: Motion, angles: Scalars, rates: Scalars) -> Sensed:
    """Reduce a finger's motion to what its controller may know."""
    return Sensed(angles, rates, motion.pose.origin, motion.unit_twists)


def orientations(grasp: Grasp, state: State) -> Float[Array, " f"]:
    r"""Orientation $p_i = e_i^T q_i$ [rad] of each finger's last link: $p_i(0)$ of (17) at the start.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch()
        >>> same = jxr.control.orientations(grasp, state) == grasp.controller.start
        >>> bool(same.all())
        True
    """
    check_states(grasp, state)
    return _orientations(grasp, state.q)


@quickly
def _orientations(grasp: Grasp, q: Array) -> Array:
    angles = joint_angles(grasp, split(q, grasp.form.positions))
    return jnp.stack([jnp.asarray(total(block)) for block in angles])


def joint_angles(grasp: Grasp, q: Blocks) -> tuple[Scalars, ...]:
    """Positions of every finger's joints, without what else a body has as a coordinate (a stage's clock).

    `q` has one block of scalars per body, the object's first.
    """
    return tuple(block[: finger.joints] for finger, block in zip(grasp.fingers, q[1:], strict=True))


def tip_of(finger: Sensed) -> Tip:
    """The tip frame as arrays; a finger without joints has a Jacobian of no columns."""
    position = finger.tip.array()
    columns = [unit.velocity.array() for unit in finger.unit_twists]
    return Tip(position, jnp.stack(columns, axis=-1) if columns else jnp.zeros((*position.shape, 0)))
