"""What a grasp asks of a controller.

`jaxroll.control` implements it, and adapts a caller's own function to it; `_motion` calls `driven` in every
evaluation of the equations of motion, and `potential` for energies. A controller may have a memory: numbers
that a run integrates with the state, or that samples change (`control.Sampled`, `_motion/_sampling`).
"""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
from jaxtyping import Array, Float

from .._closures import opened
from .._printing import listed
from .._results import as_array, check_callable, check_finite, shown
from .._types import Scalar, Scalars

# Joint torques [N m] of every finger, joint by joint.
Torques = tuple[Scalars, ...]


class AbstractController(eqx.Module):
    """A built-in controller: torques on scalars, and the potential they derive from."""

    __repr__ = listed
    # Whether its memory changes at samples only, as that of `control.Sampled`, and is not integrated.
    sampled: ClassVar[bool] = False

    @abc.abstractmethod
    def torques(self, t: Scalar, fingers: Sequence[Any]) -> Torques:
        """Joint torques [N m] of every finger at a time [s], from what is sensed of each.

        A controller with a memory gives those that belong to the memory that it begins with.
        """

    @abc.abstractmethod
    def potential(self, tips: Sequence[Any], angles: Sequence[Scalars]) -> Scalar:
        """Artificial potential energy [J], whose negative gradient is part of the torques: (22)."""

    def initial_memory(self, joints: tuple[int, ...]) -> Float[Array, " k"] | None:
        """What its memory begins with, given how many joints each finger has; None without a memory."""
        del joints

    def driven(self, t: Scalar, fingers: Sequence[Any], memory: Scalars) -> tuple[Torques, Scalars]:
        """Joint torques, and the time derivative of the memory; an empty one stands for the initial one."""
        del memory
        return self.torques(t, fingers), ()

    def stepped(
        self, t: Scalar, fingers: Sequence[Any], memory: Scalars, period: Scalar
    ) -> tuple[Torques, Scalars]:
        """Joint torques of a sample, and the memory for the next one, a period [s] later: Euler's step."""
        torques, rates = self.driven(t, fingers, memory)
        return torques, tuple(m + period * rate for m, rate in zip(memory, rates, strict=True))

    def check(self, fingers: int, axes: int) -> None:
        """Raise unless it can drive this many fingers, in the plane (2 axes) or in space (3 axes)."""
        del fingers, axes

    def check_freedoms(self, free: int) -> None:
        """Raise unless it suits a grasp whose contacts leave so many directions of motion free."""
        del free


def as_drive(name: str, controller: Any) -> Any:
    """Raise unless an argument is a built-in controller, a function that can stand for one, or None."""
    if controller is None or isinstance(controller, AbstractController):
        return controller
    plain = not isinstance(controller, eqx.Module | type)
    if plain and getattr(controller, "memory", None) is not None:
        raise ValueError(
            f"argument {name} must be an equinox.Module where it has a memory, but was {shown(controller)}"
        )
    if own_memory(name, controller) is None:
        what = "a controller, or callable as f(t, angles, rates, tips)"
        drive = opened(check_callable(name, controller, what, takes=4))
        # JAX compares leaves that are no arrays by their hash. A function without one, such as a dataclass
        # compared by its fields, becomes structure of the pytree.
        return drive if getattr(type(drive), "__hash__", None) else jax.tree_util.Partial(drive)
    what = "a controller, or with a memory callable as f(t, angles, rates, tips, memory)"
    return check_callable(name, controller, what, takes=5)


def own_memory(name: str, controller: Any) -> Float[Array, " k"] | None:
    """The attribute `memory` of a caller's own controller, an `equinox.Module`; None where it has none."""
    given = getattr(controller, "memory", None) if isinstance(controller, eqx.Module) else None
    if given is None:
        return None
    memory = check_finite(f"{name}.memory", as_array(f"{name}.memory", given))
    if memory.ndim != 1 or not memory.size:
        raise ValueError(f"argument {name}.memory must have shape (k,), k above 0, but was {shown(given)}")
    return memory


def memory_of(controller: Any, joints: tuple[int, ...]) -> Float[Array, " k"] | None:
    """What the memory of a grasp's controller begins with; None where it has none."""
    if isinstance(controller, AbstractController):
        return controller.initial_memory(joints)
    return own_memory("controller", controller)
