"""What a grasp asks of a load: a wrench on the object.

`jaxroll.loads` implements it, and adapts a caller's own function to it; `_motion/_equations` calls `wrench`
in every evaluation of the equations of motion.
"""

import abc
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax

from .._closures import as_tree
from .._printing import listed
from .._results import check_callable
from .._types import Scalar, Scalars


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Moving:
    """What loads are told of the object, in scalars.

    Attributes:
        pose: Its frame in the world.
        orientation: Its angle [rad], unwound; in space its unit quaternion, scalar first.
        twist: Velocity of its origin and its spin, both in world axes.
    """

    pose: Any
    orientation: Scalars
    twist: Any


# Force [N] as a vector and torque [N m] about the object's origin, a number or in space a vector; world axes.
Wrench = tuple[Any, Any]


class AbstractLoad(eqx.Module):
    """A built-in load: a wrench on the object, worked out on scalars."""

    __repr__ = listed

    @abc.abstractmethod
    def wrench(self, t: Scalar, object_: Moving) -> Wrench:
        """Force [N] and torque [N m] about the object's origin, in world axes, at a time [s]."""

    def check(self, name: str, axes: int) -> None:
        """Raise unless it can act in the plane (2 axes) or in space (3 axes)."""
        del name, axes


def as_loads(name: str, value: Any) -> tuple[Any, ...]:
    """One load or several as a tuple; a plain function, which would be a leaf, becomes a pytree."""
    if value is None:
        return ()
    return tuple(_as_load(name, load) for load in (value if isinstance(value, list | tuple) else (value,)))


def _as_load(name: str, value: Any) -> Any:
    if isinstance(value, AbstractLoad):
        return value
    what = "a load, or callable as f(t, pose, twist), or several of these"
    return as_tree(name, check_callable(name, value, what, takes=3))
