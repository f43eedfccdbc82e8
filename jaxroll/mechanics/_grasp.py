"""A grasp: fingers, object and contacts, with their controller and gravity."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, cast, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra import unstack, Vec2
from .._once import remembered
from .._results import as_floats, check_between, traced
from .._types import Given
from ..contact import Contact
from ..geometry import AbstractContour, frenet, tabled
from ._finger import AbstractFinger
from ._object import AbstractObject

Door = TypeVar("Door", bound=Callable[..., Any])


class Grasp(eqx.Module):
    r"""Fingers holding an object by rolling contacts, and what drives the fingers.

    Every array inside is a differentiable leaf, and any of them may carry a batch axis under `vmap`.

    Args:
        object: A `FreeObject` or a `PivotedObject`.
        fingers: One `Finger` (or `Jaw`) or several.
        contacts: One `Contact` or several: which finger touches which contour, and where at the start.
        controller: Joint torques: a controller of `jaxroll.control`, or any callable pytree
            `f(t, angles, rates, tips)` that returns one array of torques [N m] per finger; `angles`
            and `rates` hold one array of shape (k,) per finger, `tips` its tip's `position` and
            `jacobian`. Default: no torques.
        gravity: Shape (2,), in m/s^2. Default: none, and then it costs nothing.

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

    object: AbstractObject
    fingers: tuple[AbstractFinger, ...]
    contacts: tuple[Contact, ...]
    controller: Any
    gravity: Float[Array, "2"] | None

    def __init__(
        self,
        object: AbstractObject,
        fingers: AbstractFinger | Sequence[AbstractFinger],
        contacts: Contact | Sequence[Contact],
        *,
        controller: Any = None,
        gravity: Given | None = None,
    ) -> None:
        self.object = object
        self.fingers = (fingers,) if isinstance(fingers, AbstractFinger) else tuple(fingers)
        self.contacts = (contacts,) if isinstance(contacts, Contact) else tuple(contacts)
        self.controller = controller
        self.gravity = None if gravity is None else as_floats("gravity", gravity, (2,))
        self._check()

    def _check(self) -> None:
        if not self.fingers or not self.contacts:
            raise ValueError("argument fingers and contacts must not be empty")
        for i, contact in enumerate(self.contacts):
            if not 0 <= contact.finger < len(self.fingers):
                raise ValueError(
                    f"argument contacts[{i}].finger must be below {len(self.fingers)}, "
                    f"but was {contact.finger}"
                )
            if not 0 <= contact.contour < len(self.object.contours):
                raise ValueError(
                    f"argument contacts[{i}].contour must be below {len(self.object.contours)}, "
                    f"but was {contact.contour}"
                )
            tip, face = self.contours(contact)
            _check_start(f"contacts[{i}].s_tip", contact.s_tip, tip)
            _check_start(f"contacts[{i}].s_object", contact.s_object, face)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of coordinates of the object, then of each finger."""
        return (self.object.freedoms, *(finger.joints for finger in self.fingers))

    @property
    def coordinates(self) -> int:
        """Number of generalised coordinates, n."""
        return sum(self.sizes)

    def contours(self, contact: Contact) -> tuple[AbstractContour, AbstractContour]:
        """The fingertip's and the object's contour that meet at a contact."""
        return self.fingers[contact.finger].tip, self.object.contours[contact.contour]

    def field(self) -> Vec2 | None:
        """Gravity as scalars."""
        return None if self.gravity is None else Vec2(*unstack(self.gravity))

    def prepared(self) -> "Grasp":
        """This grasp with scalar leaves and contours ready for evaluation, once per solve."""
        ready = (self.object.prepared(), tuple(finger.prepared() for finger in self.fingers))
        return eqx.tree_at(lambda g: (g.object, g.fingers), self, ready)

    def tabled(self) -> "Grasp":
        """This grasp with the tables of its contours built, by a program of their own."""
        return self if all(tabled(c) is c for c in _all_contours(self)) else _with_tables(self)

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

    def with_tip(self, finger: int, tip: AbstractContour) -> "Grasp":
        """A copy in which one finger carries another tip contour."""
        return eqx.tree_at(lambda g: g.fingers[finger].tip, self, tip)

    def with_contacts(self, *contacts: Contact) -> "Grasp":
        """A copy with other starting contacts."""
        return Grasp(
            self.object,
            self.fingers,
            contacts,
            controller=self.controller,
            gravity=self.gravity,
        )


def check_unit_speed(name: str, s: jax.Array, contour: AbstractContour) -> None:
    """Raise if a caller's own contour does not advance by its arclength where the contact starts."""
    if traced((s, contour)):
        return
    tangent = frenet(contour.prepared().curve, s).tangent
    speed = float(jnp.hypot(tangent.x, tangent.y))
    if not abs(speed - 1.0) <= 1e-9:
        raise ValueError(
            f"argument {name} must lie on a contour given by arclength (unit speed), "
            f"but the speed of {type(contour).__name__} there was {speed:g}"
        )


def _has_field(owner: Any, name: str) -> bool:
    return name in getattr(type(owner), "__dataclass_fields__", {})


def _check_start(name: str, s: jax.Array, contour: AbstractContour) -> None:
    if not type(contour).__module__.startswith("jaxroll."):
        check_unit_speed(name, s, contour)
    if contour.closed:
        return
    domain = contour.domain()
    if domain is not None:
        check_between(name, s, *domain, unit=" m")


def _all_contours(grasp: Grasp) -> list[AbstractContour]:
    return [*grasp.object.contours, *(finger.tip for finger in grasp.fingers)]


@remembered
def _with_tables(grasp: Grasp) -> Grasp:
    return eqx.tree_at(_all_contours, grasp, [tabled(c) for c in _all_contours(grasp)])


def compiled(function: Door) -> Door:
    """`equinox.filter_jit` for functions of a grasp, whose tables are built before, once for all of them."""
    jitted = eqx.filter_jit(function)

    @functools.wraps(function)
    def door(grasp: Grasp, *args: Any, **options: Any) -> Any:
        return jitted(grasp.tabled(), *args, **options)

    return cast(Door, door)
