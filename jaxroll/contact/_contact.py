"""What the dynamics asks of a contact, in the plane or in space."""

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
    """Which of several: a whole number from 0 up."""
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
        """How many constraint rows: components of a contact force."""

    @property
    @abc.abstractmethod
    def slack(self) -> int:
        """How many ways the place may move while a start is sought: the length of `shift`'s step."""

    @abc.abstractmethod
    def check(self, name: str, shapes: Shapes) -> None:
        """Raise unless it fits these shapes; `name` is the contact's for the message."""

    @abc.abstractmethod
    def check_shapes(self, name: str, shapes: Shapes) -> None:
        """Raise unless a caller's own shapes keep the contract of a contour or surface."""

    @abc.abstractmethod
    def form(self, shapes: Shapes) -> Any:
        """A place of the right structure."""

    @abc.abstractmethod
    def touch(self, shapes: Shapes, place: Any) -> Any:
        """The frames of both shapes at a place, each in its own body."""

    @abc.abstractmethod
    def pfaffian(self, bodies: tuple[Motion, Motion], touch: Any) -> tuple[Rows, Rows]:
        """Constraint rows, each over the fingertip's and over the object's coordinates."""

    @abc.abstractmethod
    def closing(self, bodies: tuple[Motion, Motion], touch: Any) -> Scalars:
        """What the rows are the rate of: components of the gap's velocity."""

    @abc.abstractmethod
    def bias(self, bodies: tuple[Motion, Motion], touch: Any, rolling: Any) -> Scalars:
        """Second derivatives of the rows' quantities at zero coordinate accelerations."""

    @abc.abstractmethod
    def rolling(self, bodies: tuple[Motion, Motion], touch: Any) -> Any:
        """How the contact moves over the shapes."""

    @abc.abstractmethod
    def place_rate(self, shapes: Shapes, place: Any, poses: tuple[Any, Any], rolling: Any) -> Any:
        """Rates of the place under a rolling."""

    @abc.abstractmethod
    def bend(self, poses: tuple[Any, Any], touch: Any) -> Any:
        """What of the curvatures the return to tangency needs."""

    @abc.abstractmethod
    def unknown_bend(self) -> Any:
        """Zeros of that structure."""

    @abc.abstractmethod
    def opening(self, poses: tuple[Any, Any], touch: Any) -> Scalars:
        """The gap as the rows see it; zero where a row has no position of its own."""

    @abc.abstractmethod
    def tangency(self, poses: tuple[Any, Any], touch: Any) -> Any:
        """By how much the tangents (planes) differ: zero when they coincide."""

    @abc.abstractmethod
    def onto(self, shapes: Shapes, place: Any) -> Any:
        """The place put back onto both shapes, off which integration errors carry it."""

    @abc.abstractmethod
    def settled(
        self, shapes: Shapes, place: Any, turned: Any, *, poses: tuple[Any, Any], tangency: Any, bend: Any
    ) -> Any:
        """The place at which tangency holds, to first order.

        Args:
            shapes: The two shapes.
            place: Where it is.
            turned: By how much the fingertip turns against the object.
            poses: Of both bodies.
            tangency: What is left of it, as `tangency` says.
            bend: What `bend` said of the curvatures.
        """

    @abc.abstractmethod
    def shift(self, shapes: Shapes, place: Any, step: Scalars) -> Any:
        """A place moved by a step of `slack` lengths."""

    @abc.abstractmethod
    def equations(self, poses: tuple[Any, Any], touch: Any) -> Scalars:
        """Gap [m] and tangency [rad] as independent equations of a start."""

    @abc.abstractmethod
    def equation_names(self) -> Sequence[str]:
        """Their names, for messages."""

    @abc.abstractmethod
    def ends(self, shapes: Shapes, place: Any) -> list[Scalar]:
        """Distances [m] of the contact from the ends of both shapes; none where there are none."""

    @abc.abstractmethod
    def curvature_margin(self, poses: tuple[Any, Any], touch: Any) -> Scalar:
        """Relative sum of the curvatures: the contact rolls while it is positive."""

    @abc.abstractmethod
    def split_force(self, poses: tuple[Any, Any], touch: Any, force: Scalars) -> tuple[Scalar, Any]:
        """Normal force [N], positive when pressing, and tangential force, of the force on the fingertip."""

    @abc.abstractmethod
    def split_gap(self, poses: tuple[Any, Any], touch: Any, opening: Scalars) -> tuple[Scalar, Any]:
        """Chapter's $Q$ and $R$ [m]: the gap along the object's inward normal, and along its tangent."""

    @abc.abstractmethod
    def rubbing(self, tangential: Any) -> list[Scalar]:
        """What must not exceed friction times the normal force [N]."""
