"""What the dynamics asks of a contact, in the plane (`_contact2`) or in space (`_contact3`).

`_motion` uses the rows, the bias, the rolling and the return to tangency, `_closing` the equations and steps
of a place, `_integration._events` the margins. Wherever two bodies, poses or shapes are given as a pair, the
fingertip's comes first and the object's second. The gap runs from the object's contact point to the
fingertip's, in world axes; forces are those on the fingertip.
"""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
from jaxtyping import Array, Float

from .._printing import listed
from .._results import as_count
from .._types import Scalar, Scalars
from ._gap import Motion, Rows

Shapes = tuple[Any, Any]


def as_index(name: str, value: Any) -> int:
    """The index of a finger, contour or surface: a whole number from 0 up."""
    return as_count(name, value, least=0)


class AbstractContact(eqx.Module):
    r"""Two shapes that roll on each other: a fingertip's, and one of the object's.

    A contact has a *place*, its contact coordinates: whatever pytree of scalars says where on both shapes
    it is. Everything here works on scalars; poses and twists are those of the plane or of space.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"s_tip": "m", "s_object": "m"}

    finger: eqx.AbstractVar[int]
    friction: eqx.AbstractVar[Float[Array, ""] | None]

    @property
    @abc.abstractmethod
    def kind(self) -> str:
        """Name of the field that says which shape is touched, for messages."""

    @property
    @abc.abstractmethod
    def touched(self) -> int:
        """Which of the object's shapes is touched."""

    @property
    @abc.abstractmethod
    def rows(self) -> int:
        """How many constraint rows it has, which is also the number of components of its contact force."""

    @property
    @abc.abstractmethod
    def slack(self) -> int:
        """Length of `shift`'s step: in how many directions `close` may move the place."""

    @abc.abstractmethod
    def check(self, name: str, shapes: Shapes) -> None:
        """Raise unless the contact fits these shapes; `name` is what the message calls the contact."""

    @abc.abstractmethod
    def check_shapes(self, name: str, shapes: Shapes) -> None:
        """Raise unless a caller's own shapes keep the contract of a contour or surface."""

    @abc.abstractmethod
    def form(self, shapes: Shapes) -> Any:
        """A place with the right structure for these shapes; its numbers mean nothing."""

    @abc.abstractmethod
    def touch(self, shapes: Shapes, place: Any) -> Any:
        """The frames of both shapes at a place, each in its own body."""

    @abc.abstractmethod
    def pfaffian(self, bodies: tuple[Motion, Motion], touch: Any) -> tuple[Rows, Rows]:
        """Constraint rows, the contact's part of $A$: over the fingertip's velocities, and the object's."""

    @abc.abstractmethod
    def closing(self, bodies: tuple[Motion, Motion], touch: Any) -> Scalars:
        """The rate [m/s] that each row gives, from the twists of both bodies: $A v$ and prescribed motion."""

    @abc.abstractmethod
    def bias(self, bodies: tuple[Motion, Motion], touch: Any, rolling: Any) -> Scalars:
        r"""The acceleration [m/s^2] of each row at $\dot v = 0$: $\dot A v$ and prescribed motion."""

    @abc.abstractmethod
    def rolling(self, bodies: tuple[Motion, Motion], touch: Any) -> Any:
        r"""How fast the contact moves over the shapes [m/s]: $\dot\sigma$, in space a world vector."""

    @abc.abstractmethod
    def place_rate(self, shapes: Shapes, place: Any, poses: tuple[Any, Any], rolling: Any) -> Any:
        """Time derivative of the place, from what `rolling` returned."""

    @abc.abstractmethod
    def bend(self, poses: tuple[Any, Any], touch: Any) -> Any:
        """What `settled` needs of the curvatures: their sum, in space the inverse of their sum."""

    @abc.abstractmethod
    def unknown_bend(self) -> Any:
        """Zeros in the structure of what `bend` returns, for the carry of a loop."""

    @abc.abstractmethod
    def opening(self, poses: tuple[Any, Any], touch: Any) -> Scalars:
        """The gap [m] of each row; zero for a row that constrains a rate only."""

    @abc.abstractmethod
    def tangency(self, poses: tuple[Any, Any], touch: Any) -> Any:
        """By how much the tangents (planes) differ: zero when they coincide."""

    @abc.abstractmethod
    def onto(self, shapes: Shapes, place: Any) -> Any:
        """The place put back onto both shapes, from which integration errors carry it off."""

    @abc.abstractmethod
    def settled(
        self, shapes: Shapes, place: Any, turned: Any, *, poses: tuple[Any, Any], tangency: Any, bend: Any
    ) -> Any:
        """The place at which tangency holds, to first order, after a small turn of the bodies.

        Args:
            shapes: The two shapes.
            place: Where the contact is.
            turned: By how much the fingertip turns against the object [rad], in space in world axes.
            poses: Of both bodies, before they turn.
            tangency: What `tangency` returned there.
            bend: What `bend` returned, there or nearby.
        """

    @abc.abstractmethod
    def shift(self, shapes: Shapes, place: Any, step: Scalars) -> Any:
        """A place moved over both shapes by a step, `slack` lengths [m]."""

    @abc.abstractmethod
    def equations(self, poses: tuple[Any, Any], touch: Any) -> Scalars:
        """Gap [m] and tangency [rad] as independent equations, which `close` brings to zero."""

    @abc.abstractmethod
    def equation_names(self) -> Sequence[str]:
        """Their names, for messages."""

    @abc.abstractmethod
    def ends(self, shapes: Shapes, place: Any) -> list[Scalar]:
        """Distances [m] of the contact from the ends of both shapes; empty where they have none."""

    @abc.abstractmethod
    def curvature_margin(self, poses: tuple[Any, Any], touch: Any) -> Scalar:
        """Sum of the curvatures over their size: positive while the rolling rate is defined."""

    @abc.abstractmethod
    def split_force(self, poses: tuple[Any, Any], touch: Any, force: Scalars) -> tuple[Scalar, Any]:
        """Normal force [N], positive when pressing, and tangential force, of the force on the fingertip."""

    @abc.abstractmethod
    def split_gap(self, poses: tuple[Any, Any], touch: Any, opening: Scalars) -> tuple[Scalar, Any]:
        """Chapter's $Q$ and $R$ [m]: the gap along the object's inward normal, and along its tangent."""

    @abc.abstractmethod
    def rubbing(self, tangential: Any) -> list[Scalar]:
        """Numbers [N] of which none may exceed the coefficient of friction times the normal force."""
