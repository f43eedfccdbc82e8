"""A grasp: fingers, object and contacts, with their controller and gravity."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, cast, TypeVar

import equinox as eqx
import jax
from jaxtyping import Array, Float

from .._algebra import unstack, Vec2
from .._once import remembered
from .._results import as_floats
from .._spatial import Vec3
from .._types import Given
from ..contact import AbstractContact, Contact3
from ..geometry import AbstractContour, AbstractSurface, check_shape, tabled
from ._body import AbstractBody
from ._finger import AbstractFinger
from ._state import Form

Door = TypeVar("Door", bound=Callable[..., Any])


class Grasp(eqx.Module):
    r"""Fingers holding an object by rolling contacts, and what drives the fingers.

    Every array inside is a differentiable leaf, and any of them may carry a batch axis under `vmap`.

    Args:
        object: A `FreeObject` or a `PivotedObject`; in space a `FreeObject3`.
        fingers: One `Finger` (or `Jaw`) or several; in space a `Finger3` (or `Stage`).
        contacts: One `Contact` or several: which finger touches which contour, and where at the start;
            in space `Contact3`.
        controller: Joint torques: a controller of `jaxroll.control`, or any callable pytree
            `f(t, angles, rates, tips)` that returns one array of torques [N m] per finger; `angles`
            and `rates` hold one array of shape (k,) per finger, `tips` its tip's `position` and
            `jacobian`. Default: no torques.
        gravity: Shape (2,), in space (3,), in m/s^2. Default: none, and then it costs nothing.

    Raises:
        ValueError: If a contact names a finger or contour that is not there, or starts past the end
            of an open contour.

    Example:
        >>> import jaxroll as jxr
        >>> finger = jxr.Finger([0.065, 0.065], [0.045, 0.040], tip=jxr.Circle(0.01))
        >>> disc = jxr.PivotedObject(jxr.Circle(0.02), inertia=1e-5, pivot=(0.03, 0.09))
        >>> grasp = jxr.Grasp(disc, finger, jxr.Contact())
        >>> grasp.coordinates
        3
    """

    object: Any  # an `AbstractBody`; which one, whoever reads its fields knows
    fingers: tuple[AbstractFinger, ...]
    contacts: tuple[Any, ...]  # `Contact` in the plane, `Contact3` in space
    controller: Any
    gravity: Float[Array, "d"] | None

    def __init__(
        self,
        object: AbstractBody,
        fingers: AbstractFinger | Sequence[AbstractFinger],
        contacts: AbstractContact | Sequence[AbstractContact],
        *,
        controller: Any = None,
        gravity: Given | None = None,
    ) -> None:
        self.object = object
        self.fingers = (fingers,) if isinstance(fingers, AbstractFinger) else tuple(fingers)
        self.contacts = (contacts,) if isinstance(contacts, AbstractContact) else tuple(contacts)
        self.controller = controller
        self._check()
        axes = 3 if self.spatial else 2
        self.gravity = None if gravity is None else as_floats("gravity", gravity, (axes,))

    def _check(self) -> None:
        if not self.fingers or not self.contacts:
            raise ValueError("argument fingers and contacts must not be empty")
        if len({isinstance(contact, Contact3) for contact in self.contacts}) > 1:
            raise ValueError("argument contacts must be all of the plane or all of space, but were of both")
        for i, contact in enumerate(self.contacts):
            if not 0 <= contact.finger < len(self.fingers):
                raise ValueError(
                    f"argument contacts[{i}].finger must be below {len(self.fingers)}, "
                    f"but was {contact.finger}"
                )
            if not 0 <= contact.touched < len(self.object.shapes):
                raise ValueError(
                    f"argument contacts[{i}].{contact.kind} must be below {len(self.object.shapes)}, "
                    f"but was {contact.touched}"
                )
            contact.check(f"contacts[{i}]", self.shapes(contact))

    @property
    def bodies(self) -> tuple[AbstractBody, ...]:
        """The object, then every finger."""
        return (self.object, *self.fingers)

    @property
    def spatial(self) -> bool:
        """Whether it lives in space; else in the plane."""
        return isinstance(self.contacts[0], Contact3)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of velocities of the object, then of each finger."""
        return tuple(body.freedoms for body in self.bodies)

    @property
    def coordinates(self) -> int:
        """Number of velocities in all; in the plane that of generalised coordinates, n."""
        return sum(self.sizes)

    @property
    def form(self) -> Form:
        """How many numbers a state has, and where they go."""
        places = tuple(c.form(self.shapes(c)) for c in self.contacts)
        return Form(tuple(body.positions for body in self.bodies), self.sizes, jax.tree.structure(places))

    def shapes(self, contact: AbstractContact) -> tuple[Any, Any]:
        """The fingertip's and the object's contour (surface) that meet at a contact."""
        return self.fingers[contact.finger].tip, self.object.shapes[contact.touched]

    def field(self) -> Vec2 | Vec3 | None:
        """Gravity as scalars."""
        if self.gravity is None:
            return None
        parts = unstack(self.gravity)
        return Vec3(*parts) if self.spatial else Vec2(*parts)

    def prepared(self) -> "Grasp":
        """This grasp with scalar leaves and contours ready for evaluation, once per solve."""
        ready = (self.object.prepared(), tuple(finger.prepared() for finger in self.fingers))
        return eqx.tree_at(lambda g: (g.object, g.fingers), self, ready)

    def tabled(self) -> "Grasp":
        """This grasp, its shapes checked, with the tables of its contours built by a program of their own."""
        _check_shapes(self)
        return self if all(tabled(shape) is shape for shape in _all_shapes(self)) else _with_tables(self)

    def with_(self, **changes: Any) -> "Grasp":
        """A copy with fields replaced, by name.

        A name may belong to the grasp (`controller`, `gravity`), to its controller (`damping`,
        `force`, ...) or to its object (`inertia`, `pivot`, ...); it must belong to just one of them.

        Example:
            >>> import jaxroll as jxr
            >>> grasp, _ = jxr.scenes.pivoted()
            >>> float(grasp.with_(damping=0.01).controller.damping)
            0.01
        """
        grasp = self
        for name, value in changes.items():
            owner = grasp._owner(name)
            old = getattr(owner(grasp), name)
            if eqx.is_array(old):
                value = as_floats(name, value, old.shape)
            grasp = eqx.tree_at(
                lambda g, o=owner, n=name: getattr(o(g), n),
                grasp,
                value,
                is_leaf=lambda x: x is None,
            )
        return grasp

    def _owner(self, name: str) -> Any:
        places = {
            "grasp": lambda g: g,
            "controller": lambda g: g.controller,
            "object": lambda g: g.object,
        }
        found = [place for place in places.values() if _has_field(place(self), name)]
        if len(found) != 1:
            raise ValueError(
                f"argument {name} must name one field of the grasp, its controller or its object, "
                f"but {len(found)} have it"
            )
        return found[0]

    def with_tip(self, finger: int, tip: AbstractContour | AbstractSurface) -> "Grasp":
        """A copy in which one finger carries another tip contour."""
        return eqx.tree_at(lambda g: g.fingers[finger].tip, self, tip)

    def with_contacts(self, *contacts: AbstractContact) -> "Grasp":
        """A copy with other starting contacts."""
        return Grasp(
            self.object,
            self.fingers,
            contacts,
            controller=self.controller,
            gravity=self.gravity,
        )


def _has_field(owner: Any, name: str) -> bool:
    return name in getattr(type(owner), "__dataclass_fields__", {})


def _all_shapes(grasp: Grasp) -> list[Any]:
    return [shape for body in grasp.bodies for shape in body.shapes]


@remembered
def _check_shapes(grasp: Grasp) -> None:
    """Raise unless a caller's own contours and surfaces keep their contract, however they came in."""
    for i, contact in enumerate(grasp.contacts):
        contact.check_shapes(f"contacts[{i}]", grasp.shapes(contact))
    for shape in _all_shapes(grasp):
        check_shape("grasp", shape)


@remembered
def _with_tables(grasp: Grasp) -> Grasp:
    new = [i for i, shape in enumerate(_all_shapes(grasp)) if tabled(shape) is not shape]
    where = lambda g: [_all_shapes(g)[i] for i in new]  # noqa: E731
    return eqx.tree_at(where, grasp, [tabled(shape) for shape in where(grasp)])


def check_planar(grasp: Grasp) -> None:
    """Raise for a grasp in space, where only the plane has an answer."""
    if grasp.spatial:
        raise ValueError("argument grasp must live in the plane, but its contacts are those of space")


def check_spatial(grasp: Grasp) -> None:
    """Raise for a grasp in the plane, where only space has an answer."""
    if not grasp.spatial:
        raise ValueError("argument grasp must live in space, but its contacts are those of the plane")


def compiled(function: Door) -> Door:
    """`equinox.filter_jit` for functions of a grasp, whose tables are built before, once for all of them."""
    jitted = eqx.filter_jit(function)

    @functools.wraps(function)
    def door(grasp: Grasp, *args: Any, **options: Any) -> Any:
        return jitted(grasp.tabled(), *args, **options)

    return cast(Door, door)
