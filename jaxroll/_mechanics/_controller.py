"""What a grasp asks of a controller.

`jaxroll.control` implements it, and adapts a caller's own function to it; `_motion` calls `torques` in every
evaluation of the equations of motion, and `potential` for energies.
"""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx

from .._printing import listed
from .._results import check_callable
from .._types import Scalar, Scalars

# Joint torques [N m] of every finger, joint by joint.
Torques = tuple[Scalars, ...]


class AbstractController(eqx.Module):
    """A built-in controller: torques on scalars, and the potential they derive from."""

    __repr__ = listed

    @abc.abstractmethod
    def torques(self, t: Scalar, fingers: Sequence[Any]) -> Torques:
        """Joint torques [N m] of every finger at a time [s], from what is sensed of each."""

    @abc.abstractmethod
    def potential(self, tips: Sequence[Any], angles: Sequence[Scalars]) -> Scalar:
        """Artificial potential energy [J], whose negative gradient is part of the torques: (22)."""

    def check(self, fingers: int, axes: int) -> None:
        """Raise unless it can drive this many fingers, in the plane (2 axes) or in space (3)."""
        del fingers, axes


def as_drive(name: str, controller: Any) -> Any:
    """Raise unless an argument is a built-in controller, a function that can stand for one, or None."""
    if controller is None or isinstance(controller, AbstractController):
        return controller
    what = "a controller, or callable as f(t, angles, rates, tips)"
    return check_callable(name, controller, what, takes=4)
