"""What the dynamics needs to know of a body, whichever body it is."""

from dataclasses import dataclass

import jax

from .._algebra import Pose2, Triangle, Twist2
from .._types import Scalars


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Motion:
    r"""Kinematics of one body frame: the object's, or a fingertip's.

    Attributes:
        pose: The frame in the world.
        unit_twists: Twist per unit rate of each coordinate: the columns of its Jacobian $J$.
        twist: $J v$.
        bias: $\dot J v$, the part of the acceleration that the velocities alone cause.
    """

    pose: Pose2
    unit_twists: tuple[Twist2, ...]
    twist: Twist2
    bias: Twist2


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Inertia:
    r"""Mass matrix (lower triangle) and bias force of one body's own coordinates.

    `force` is $(\dot G/2 + S) v$ of (3) less the generalised force of gravity.
    """

    mass: Triangle
    force: Scalars
