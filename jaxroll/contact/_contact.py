r"""What makes a contact: its place, its gap and its tangency, from which the dynamics has all else.

A contact holds a fingertip A and an object B together. Its *place* is whatever numbers say where on both
shapes it is. Its *gap* [m] is zero while the contact is closed, and its *tangency* is zero where the place is
the right one for the poses of both bodies. Everything that a run needs follows by differentiation
(`_from_gap`): the Pfaffian rows from the gap at a frozen place, their bias, the rate of the place from the
tangency, the return to both, the search for a closed start.

Of a caller's own contact these four are given: `rows`, `touch`, `gap`, `tangency`. `Contact` (two contours)
and `Contact3` (two surfaces) give the derivatives in closed form as well, because that makes a smaller
program (`benchmarks.machinery` has the figures); a test compares both to rounding.

Wherever two bodies, poses or shapes are given as a pair, the fingertip's comes first and the object's second.
"""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._linalg import root, total, unknown_factor, Vec3
from .._printing import listed
from .._results import as_count, as_positive
from .._types import Scalar, Scalars
from ..geometry import check_shape
from . import _from_gap as from_gap
from ._gap import Motion, Rows

Shapes = tuple[Any, Any]


def as_index(name: str, value: Any) -> int:
    """The index of a finger, contour or surface: a whole number from 0 up."""
    return as_count(name, value, least=0)


class AbstractContact(eqx.Module):
    r"""A fingertip's shape held to one of the object's: `Contact`, `Contact3`, or a caller's own.

    A class of one's own gives `finger`, `friction` (None where there is no limit) and four members:

    - `rows`: how many gaps it has, each held by one component of the contact force;
    - `touch(shapes, place)`: what gap and tangency read of both shapes, such as their frames at a place;
    - `gap(poses, touch)`: a tuple of `rows` lengths [m], zero while the contact is closed;
    - `tangency(poses, touch)`: numbers without unit, zero where the place fits the poses; as many as the
      place has, which is one unless `form` says otherwise, or fewer where the gap determines the rest of the
      place (`equation_names` is then given too).

    Where its shapes end, as a rack does, a fifth one, `ends(shapes, place)`: the distances [m] of the place
    from these ends. Without it a run goes past them.

    A place moves without slipping if, at vanishing tangency, the gap does not change to first order as the
    place alone moves: so one coordinate that runs along both contours at the same rate is a rolling contact.
    All arithmetic is on scalars (`Vec2`, `Vec3`, and `Pose2` or `Pose3` with `place` and `turn`), so that it
    costs in a run and in a batch what the package's own does. Residuals and forces of such a contact are
    reported row by row: the first is called normal, the others tangential.

    Example:
        Two wheels with teeth. They mesh where their pitch circles touch, and the teeth hold the one
        direction along the tangent; their bearings do the rest.

        >>> import jaxroll as jxr
        >>> class Teeth(jxr.AbstractContact):
        ...     finger: int = 0
        ...     friction: None = None
        ...     rows = 1
        ...
        ...     def touch(self, shapes, place):
        ...         pinion, wheel = shapes
        ...         return pinion.frame(place), wheel.frame(-place)
        ...
        ...     def gap(self, poses, touch):
        ...         (pinion, wheel), (tip, face) = poses, touch
        ...         apart = pinion.place(tip.point) - wheel.place(face.point)
        ...         return (apart.dot(wheel.turn(face.tangent)),)
        ...
        ...     def tangency(self, poses, touch):
        ...         (pinion, wheel), (tip, face) = poses, touch
        ...         return pinion.turn(tip.tangent).cross(wheel.turn(face.tangent))
        >>> Teeth().slack
        1
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"s_tip": "m", "s_object": "m"}

    finger: eqx.AbstractVar[int]
    friction: eqx.AbstractVar[Float[Array, ""] | None]

    # Where it belongs.

    @property
    def axes(self) -> int:
        """Axes of the world in which it lives: 2 in the plane, 3 in space."""
        return 2

    @property
    def kind(self) -> str:
        """Name of the field that says which shape is touched, for messages."""
        return "contour" if self.axes == 2 else "surface"

    @property
    def touched(self) -> int:
        """Which of the object's shapes is touched; by default the first."""
        return 0

    def check(self, name: str, shapes: Shapes) -> None:
        """Raise unless the contact fits these shapes; `name` is what the message calls the contact."""
        self.check_shapes(name, shapes)
        as_count(f"{name}.rows", self.rows)
        as_count(f"{name}.slack", self.slack, least=0)
        if self.friction is not None:
            as_positive(f"{name}.friction", self.friction)
        from_gap.check_numbers(self, name, shapes)

    def check_shapes(self, name: str, shapes: Shapes) -> None:
        """Raise unless a caller's own shapes keep the contract of a contour or surface."""
        for kind, shape in zip(("tip", "object"), shapes, strict=True):
            check_shape(f"{name}'s {self.kind} of the {kind}", shape)

    # Kinematics: eight members, of which four have defaults.

    @property
    @abc.abstractmethod
    def rows(self) -> int:
        """How many gaps it has, which is also the number of components of its contact force."""

    @abc.abstractmethod
    def touch(self, shapes: Shapes, place: Any) -> Any:
        """What the gap and the tangency read of both shapes at a place, each in its own body."""

    @abc.abstractmethod
    def gap(self, poses: tuple[Any, Any], touch: Any) -> Scalars:
        """The gap [m] of each row; zero for a row that constrains a rate only (then `gap_rate` has it)."""

    @abc.abstractmethod
    def tangency(self, poses: tuple[Any, Any], touch: Any) -> Any:
        """By how much the place misses the one that fits the poses, such as the sine between two tangents."""

    def form(self, shapes: Shapes) -> Any:
        """A place with the right structure for these shapes; its numbers mean nothing. By default one."""
        return 0.0

    @property
    def slack(self) -> int:
        """Length of `shift`'s step: in how many directions the place moves over both shapes."""
        return 1

    def shift(self, shapes: Shapes, place: Any, step: Scalars) -> Any:
        """A place moved over both shapes by a step, `slack` lengths [m]; by default number by number."""
        parts, structure = jax.tree.flatten(place)
        if len(parts) != len(step):
            kind = type(self).__name__
            raise ValueError(
                f"argument contacts must hold contacts whose `slack` is the count of numbers in `form`, "
                f"but of a {kind} they were {len(step)} and {len(parts)}"
            )
        return jax.tree.unflatten(structure, [a + b for a, b in zip(parts, step, strict=True)])

    def onto(self, shapes: Shapes, place: Any) -> Any:
        """The place put back onto both shapes, from which integration errors may carry it off."""
        return place

    # Derivatives of these, in closed form where a class knows better.

    def gap_rate(self, poses: tuple[Any, Any], twists: tuple[Any, Any], touch: Any) -> Scalars:
        """The rate [m/s] of each gap under the twists of both bodies, at a frozen place."""
        return from_gap.derived_gap_rate(self, poses, twists, touch)

    def pfaffian(self, bodies: tuple[Motion, Motion], touch: Any) -> tuple[Rows, Rows]:
        """Constraint rows, the contact's part of $A$: over the fingertip's velocities, and the object's."""
        return from_gap.derived_pfaffian(self, bodies, touch)

    def rolling(
        self, shapes: Shapes, place: Any, bodies: tuple[Motion, Motion], *, touch: Any, bend: Any
    ) -> Any:
        """How fast the contact moves over the shapes [m/s], in the directions of `shift`.

        The argument `bend` is what the method `bend` returned at this place.
        """
        return from_gap.derived_rolling(self, shapes, place, bodies, touch=touch, bend=bend)

    def place_rate(self, shapes: Shapes, place: Any, poses: tuple[Any, Any], rolling: Any) -> Any:
        """Time derivative of the place, from what `rolling` returned."""
        return from_gap.derived_place_rate(self, shapes, place, rolling)

    def bias(
        self, shapes: Shapes, place: Any, bodies: tuple[Motion, Motion], *, touch: Any, rolling: Any
    ) -> Scalars:
        r"""The acceleration [m/s^2] of each gap at $\dot v = 0$: $\dot A v$ and prescribed motion."""
        return from_gap.derived_bias(self, shapes, place, bodies, touch=touch, rolling=rolling)

    def bend(self, shapes: Shapes, place: Any, poses: tuple[Any, Any], touch: Any) -> Any:
        """What `rolling` and `settled` need of the derivative of the tangency along the place."""
        return from_gap.derived_bend(self, shapes, place, poses)

    def unknown_bend(self) -> Any:
        """Zeros in the structure of what `bend` returns, for the carry of a loop."""
        return unknown_factor(self.slack)

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
        return from_gap.derived_settled(
            self, shapes, place, turned, poses=poses, tangency=tangency, bend=bend
        )

    def equations(self, poses: tuple[Any, Any], touch: Any) -> Scalars:
        """Gap [m] and tangency as independent equations, which `close` brings to zero."""
        return (*self.gap(poses, touch), *jax.tree.leaves(self.tangency(poses, touch)))

    def equation_names(self) -> Sequence[str]:
        """Their names, for messages."""
        return (*("gap [m]",) * self.rows, *("tangency",) * self.slack)

    # Limits, and reports.

    def ends(self, shapes: Shapes, place: Any) -> list[Scalar]:
        """Distances [m] of the contact from the ends of both shapes; empty, as by default, for none."""
        return []

    def curvature_margin(self, shapes: Shapes, place: Any, poses: tuple[Any, Any], touch: Any) -> Scalar:
        """Positive while tangency determines the place, relative to the parts that cancel where not."""
        return from_gap.derived_margin(self, shapes, place, poses)

    def slip(self, shapes: Shapes, place: Any, poses: tuple[Any, Any]) -> Scalar:
        """How much the gap changes as the place alone moves, relative to the terms of that: 0 if it rolls."""
        return from_gap.derived_slip(self, shapes, place, poses)

    @property
    def presses(self) -> bool:
        """Whether it can only press: a run then ends `contact_lost` where its normal force would pull."""
        return False

    def split_force(self, poses: tuple[Any, Any], touch: Any, force: Scalars) -> tuple[Scalar, Any]:
        """Normal force [N], positive when pressing, and tangential force: the first row, and the rest."""
        return force[0], self._beside(force[1:])

    def spin_torque(self, force: Scalars) -> Scalar | None:
        """Torque [N m] on the object about its outward normal that prevents spin; None without such a row."""
        return None

    def split_gap(self, poses: tuple[Any, Any], touch: Any, gap: Scalars) -> tuple[Scalar, Any]:
        """Chapter's $Q$ and $R$ [m]. By default the gap of the first row, and of the rest."""
        return gap[0], self._beside(gap[1:])

    def reported(self, tangency: Any) -> Any:
        """A tangency as residuals hold it: one number in the plane, a vector in space."""
        return self._beside(tuple(jax.tree.leaves(tangency)))

    def _beside(self, parts: Scalars) -> Any:
        """Several numbers as the one number (in space, the vector) that a report has room for.

        Where they fit they are filled up with zeros; more are replaced by the root of their sum of squares.
        """
        room = 1 if self.axes == 2 else 3
        if len(parts) > room:
            parts = (root(total([part * part for part in parts])),)
        padded = (*parts, *(jnp.zeros(()),) * (room - len(parts)))
        return padded[0] if self.axes == 2 else Vec3(*padded)

    def rubbing(self, tangential: Any) -> list[Scalar]:
        """Numbers [N] of which none may exceed the coefficient of friction times the normal force."""
        return [tangential, -tangential] if self.axes == 2 else [root(tangential.dot(tangential))]
