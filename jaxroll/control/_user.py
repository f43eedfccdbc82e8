"""A caller's own function as a controller, and what stands for any controller of a grasp."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._linalg import stacked, unstack
from .._mechanics import AbstractController, as_drive, own_memory, Torques
from .._results import as_array, shown
from .._types import Scalar, Scalars
from .._xla import in_arithmetic
from ._sensing import Sensed, tip_of


class Passive(AbstractController):
    """No torques at all."""

    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        return tuple(tuple(jnp.zeros_like(a) for a in f.angles) for f in fingers)

    def potential(self, tips: Sequence[Any], angles: Sequence[Scalars]) -> Scalar:
        return jnp.zeros_like(tips[0].x)


class UserController(AbstractController):
    """Adapter that calls a user's `f(t, angles, rates, tips)` with ordinary arrays.

    With an attribute `memory` it is `f(t, angles, rates, tips, memory)`, and returns torques and the time
    derivative of the memory; inside `Sampled`, in place of the derivative, the memory of the next sample.
    """

    function: Any

    def torques(self, t: Scalar, fingers: Sequence[Sensed]) -> Torques:
        return self._asked(t, fingers, ())[0]

    def initial_memory(self, joints: tuple[int, ...]) -> Float[Array, " k"] | None:
        del joints
        return own_memory("controller", self.function)

    def driven(self, t: Scalar, fingers: Sequence[Sensed], memory: Scalars) -> tuple[Torques, Scalars]:
        return self._asked(t, fingers, memory)

    def stepped(
        self, t: Scalar, fingers: Sequence[Sensed], memory: Scalars, period: Scalar
    ) -> tuple[Torques, Scalars]:
        del period
        return self._asked(t, fingers, memory)

    def _asked(self, t: Scalar, fingers: Sequence[Sensed], memory: Scalars) -> tuple[Torques, Scalars]:
        """What the function returns, as scalars."""
        angles = tuple(stacked(f.angles) for f in fingers)
        given = (t, angles, tuple(stacked(f.rates) for f in fingers), tuple(tip_of(f) for f in fingers))
        begins = own_memory("controller", self.function)
        if begins is None:
            return _as_torques(in_arithmetic("controller", self.function, *given), angles), ()
        held = stacked(memory) if memory else begins
        found = in_arithmetic("controller", self.function, *given, held)
        if not isinstance(found, tuple | list) or len(found) != 2:
            raise ValueError(
                f"argument controller must return torques and the rate of its memory, but returned "
                f"{shown(found)}"
            )
        name = "controller, in what it returns second,"
        rate = as_array(name, found[1]).astype(held.dtype)
        if rate.shape != held.shape:
            raise ValueError(
                f"argument {name} must have shape {held.shape}, as its memory has, but had {rate.shape}"
            )
        return _as_torques(found[0], angles), unstack(rate)

    def potential(self, tips: Sequence[Any], angles: Sequence[Scalars]) -> Scalar:
        return jnp.zeros_like(tips[0].x)


def _as_torques(given: Any, angles: tuple[jax.Array, ...]) -> Torques:
    """Arrays of torques as scalars."""
    # Checked here, while it is traced: a shape that would broadcast is a mistake too.
    wanted = [a.shape for a in angles]
    what = f"argument controller must return one torque array per finger, of shapes {wanted}, but {{}}"
    if not isinstance(given, tuple | list) or len(given) != len(wanted):
        raise ValueError(what.format(f"returned {shown(given)}"))
    name = "controller, in what it returns,"
    torques = [as_array(name, torque).astype(a.dtype) for torque, a in zip(given, angles, strict=True)]
    if (shapes := [torque.shape for torque in torques]) != wanted:
        raise ValueError(what.format(f"returned {shapes}"))
    return tuple(tuple(torque[i] for i in range(torque.shape[0])) for torque in torques)


def as_controller(controller: Any) -> AbstractController:
    """Wrap a callable; pass a built-in controller through; None means no torques."""
    if controller is None:
        return Passive()
    if isinstance(controller, AbstractController):
        return controller
    return UserController(as_drive("controller", controller))


def law_of(controller: Any) -> Any:
    """The law inside what wraps one (`Sampled`, `Integral`); any other controller itself."""
    return laws_of(controller)[-1]


def laws_of(controller: Any) -> list[Any]:
    """A controller, the law inside it, the law inside that, and so on."""
    found = [controller]
    while isinstance(found[-1], AbstractController) and hasattr(found[-1], "law"):
        found.append(getattr(found[-1], "law"))  # noqa: B009, which classes have it pyright cannot know
    return found


def as_law(name: str, value: Any) -> Any:
    """What may stand inside another controller: anything that a grasp takes, but nothing sampled."""
    law = as_drive(name, value)
    if isinstance(law, AbstractController) and law.sampled:
        raise ValueError(f"argument {name} must not be sampled itself, but was a {type(law).__name__}")
    return law
