"""A grasp as users make it: fingers, object and contacts, with their controller and gravity.

What the equations of motion read of it is in `_assembly`; constructor, checks, copies and reports are here.
Before a run two kinds of work are done once: `tabled_grasp` builds the tables of contours that read one, in a
program that is kept, and `Grasp.prepared`, inside the program of a run, works out what no state changes.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._fields import taken, through
from .._printing import shown_value, so_many
from .._results import as_array, as_count, as_several, check_finite, computed_at_once, shown, traced
from .._types import Given
from .._xla import remembered
from ..contact import AbstractContact, Contact, Contact3
from ..geometry import (
    AbstractContour,
    AbstractSurface,
    check_once_round,
    check_shape,
    keeps_contract,
    tabled,
    unchecked,
)
from ._assembly import AbstractGrasp
from ._body import AbstractBody, AbstractFinger, Coordinate
from ._changes import changed
from ._controller import AbstractController, as_drive
from ._load import AbstractLoad, as_loads


class Labels(NamedTuple):
    """Names of the parts of a grasp for reports; hashable, so that a `Trajectory` holds it as static data.

    Attributes:
        bodies: The object, then every finger: what it is called, and name and unit of its positions.
        contacts: What each contact is called, by the numbers that a `Contact` is made with.
        presses: Of each contact, whether it can only press.
        velocities: As `bodies`, of the velocities.
        places: Name and unit of every contact coordinate.
    """

    bodies: tuple[tuple[str, tuple[Coordinate, ...]], ...]
    contacts: tuple[str, ...]
    presses: tuple[bool, ...] = ()
    velocities: tuple[tuple[str, tuple[Coordinate, ...]], ...] = ()
    places: tuple[Coordinate, ...] = ()

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Name of every position, with its body's."""
        return tuple(f"{body} {each.name}" for body, labels in self.bodies for each in labels)


def _as_object(name: str, value: Any) -> AbstractBody:
    if not isinstance(value, AbstractBody) or isinstance(value, AbstractFinger):
        raise ValueError(f"argument {name} must be an object, such as a FreeObject, but was {shown(value)}")
    return value


def _as_fingers(name: str, value: Any) -> tuple[AbstractFinger, ...]:
    return as_several(name, value, AbstractFinger, "fingers")


def _as_contacts(name: str, value: Any) -> tuple[Any, ...]:
    contacts = as_several(name, value, AbstractContact, "contacts")
    if len({contact.axes for contact in contacts}) > 1:
        raise ValueError(f"argument {name} must be all of the plane or all of space, but were of both")
    return contacts


def _as_gravity(name: str, value: Any) -> Any:
    """None, or a finite array; `_check_actions` checks its shape, which depends on the whole grasp."""
    if value is None:
        return None
    array = as_array(name, value)
    return check_finite(name, array)


class Grasp(AbstractGrasp):
    r"""Fingers holding an object by rolling contacts, and what drives the fingers.

    Every array inside is a differentiable leaf, and any of them may carry a batch axis under `vmap`.

    Args:
        object: A `FreeObject` or a `PivotedObject`; in space a `FreeObject3`.
        fingers: One `Finger` (or `Jaw`) or several; in space a `Finger3` (or `Stage`).
        contacts: One `Contact` or several: which finger touches which contour, and where at the start;
            in space `Contact3`; or a caller's own `AbstractContact`.
        controller: Joint torques: a controller of `jaxroll.control`, or any callable pytree
            `f(t, angles, rates, tips)` that returns one array of torques [N m] per finger; `angles`
            and `rates` hold one array of shape (k,) per finger, `tips` its tip's `position` and
            `jacobian`. An `equinox.Module` with an array `memory`, shape (k,), has a memory that begins with
            it: it is called as `f(t, angles, rates, tips, memory)` and returns torques and the memory's time
            derivative, which the run integrates. Default: no torques. As under `jax.jit`, numbers that a
            plain function takes from outside itself are those of its first run; numbers that change are
            fields of an `equinox.Module`.
        gravity: Shape (2,), in space (3,), in m/s^2; or one row for each body, the object's first: fingers
            whose own weight is compensated have rows of zeros. Default: none, and then it costs nothing.
        load: Wrench on the object: one of `jaxroll.loads`, or any callable pytree `f(t, pose, twist)` that
            returns a force [N] and a torque [N m] about the object's origin, both in world axes; or several
            of these, which add up. `pose` has `position` and `orientation` of the object, `twist` its
            `velocity` and `spin`. Default: none, and then it costs nothing.

    Raises:
        ValueError: If a part is not what it must be, parts of the plane and of space are mixed, a contact
            names a finger or contour that is not there or starts past the end of an open contour, a finger
            has both joints and a prescribed motion, or the controller is for another number of fingers.

    Example:
        >>> import jaxroll as jxr
        >>> finger = jxr.Finger([0.065, 0.065], [0.045, 0.040], tip=jxr.Circle(0.01))
        >>> disc = jxr.PivotedObject(jxr.Circle(0.02), inertia=1e-5, pivot=(0.03, 0.09))
        >>> grasp = jxr.Grasp(disc, finger, jxr.Contact())
        >>> grasp.coordinates
        3
    """

    object: Any = through(_as_object)  # an `AbstractBody`; `Any`, since readers know which class it is
    fingers: tuple[AbstractFinger, ...] = through(_as_fingers)
    contacts: tuple[Any, ...] = through(_as_contacts)  # `Contact`, `Contact3`, or a caller's own
    controller: Any = through(as_drive)
    gravity: Float[Array, "*bodies d"] | None = through(_as_gravity)
    load: tuple[Any, ...] = through(as_loads)

    def __init__(
        self,
        object: AbstractBody,
        fingers: AbstractFinger | Sequence[AbstractFinger],
        contacts: AbstractContact | Sequence[AbstractContact],
        *,
        controller: Any = None,
        gravity: Given | None = None,
        load: Any = None,
    ) -> None:
        self.object = taken(self, "object", object)
        self.fingers = taken(self, "fingers", fingers)
        self.contacts = taken(self, "contacts", contacts)
        self.controller = taken(self, "controller", controller)
        self.gravity = taken(self, "gravity", gravity)
        self.load = taken(self, "load", load)
        self._check_parts()
        self._check_actions()

    def _check_parts(self) -> None:
        """Raise unless contacts find their shapes, no finger moves in two ways, and all live in one space."""
        for i, contact in enumerate(self.contacts):
            counts = ("finger", contact.finger, len(self.fingers))
            for kind, index, count in (counts, (contact.kind, contact.touched, len(self.object.shapes))):
                if not as_count(f"contacts[{i}].{kind}", index, least=0) < count:
                    raise ValueError(f"argument contacts[{i}].{kind} must be below {count}, but was {index}")
            contact.check(f"contacts[{i}]", self.shapes(contact))
        for i, finger in enumerate(self.fingers):
            if finger.prescribed and finger.freedoms:
                raise ValueError(
                    f"argument fingers[{i}] must have no joints where its motion is prescribed, "
                    f"but was a {type(finger).__name__} with {finger.freedoms}"
                )
        wanted, words = (AbstractSurface, "space") if self.spatial else (AbstractContour, "the plane")
        for i, body in enumerate(self.bodies):
            name = f"fingers[{i - 1}]" if i else "object"
            if not all(isinstance(shape, wanted) for shape in body.shapes):
                raise ValueError(
                    f"argument {name} must live in {words}, as contacts do, but was a {type(body).__name__}"
                )

    def _check_actions(self) -> None:
        """Raise unless controller, gravity and loads fit the bodies and contacts."""
        if isinstance(self.controller, AbstractController):
            self.controller.check(len(self.fingers), self._axes)
            self.controller.check_freedoms(self.coordinates - sum(c.rows for c in self.contacts))
        wanted = (self._axes,), (len(self.bodies), self._axes)
        if self.gravity is not None and self.gravity.shape not in wanted:
            raise ValueError(
                f"argument gravity must have shape ({self._axes}) or {wanted[1]}, "
                f"but had shape {self.gravity.shape}"
            )
        for load in self.load:
            if isinstance(load, AbstractLoad):
                load.check("load", self._axes)
        for times in self.jumps:  # those of a caller's own part have passed no check
            check_finite("jumps", times)

    @property
    def labels(self) -> Labels:
        """What reports and tables call its bodies, their positions and velocities, and its contacts."""
        names = ("object", *(f"finger {i}" for i in range(len(self.fingers))))
        bodies = tuple((name, body.labels) for name, body in zip(names, self.bodies, strict=True))
        contacts = (
            f"contact {i} (finger {c.finger} on {c.kind} {c.touched})" for i, c in enumerate(self.contacts)
        )
        rates = tuple((name, body.velocity_labels) for name, body in zip(names, self.bodies, strict=True))
        presses = tuple(c.presses for c in self.contacts)
        return Labels(bodies, tuple(contacts), presses, rates, self._places())

    def _places(self) -> tuple[Coordinate, ...]:
        """Name and unit of every contact coordinate: one of a contact has its name, several are numbered."""
        found: list[Coordinate] = []
        for i, (contact, part) in enumerate(zip(self.contacts, self.form.places.children(), strict=True)):
            unit, count = "m" if isinstance(contact, Contact) else "", part.num_leaves
            tails = [""] if count == 1 else [f" s[{k}]" for k in range(count)]
            found += [Coordinate(f"contact {i}{tail}", unit) for tail in tails]
        return tuple(found)

    def __repr__(self) -> str:
        kinds = ", ".join(type(body).__name__ for body in self.bodies)
        control = "no controller" if self.controller is None else type(self.controller).__name__
        return f"Grasp({kinds}; {so_many(len(self.contacts), 'contact')}; {control})"

    def __str__(self) -> str:
        try:
            labels = self.labels
        except TypeError:  # something else in the places of its numbers, as in a tree of `in_axes`
            return repr(self)
        lines = [f"Grasp {'in space' if self.spatial else 'in the plane'}"]
        for (name, parts), body in zip(labels.bodies, self.bodies, strict=True):
            moves = ", ".join(f"{each.name} [{each.unit}]" if each.unit else each.name for each in parts)
            lines.append(f"  {name:<10}{type(body).__name__}: {moves or 'fixed'}")
        lines += [f"  contact {i} {contact}" for i, contact in enumerate(self.contacts)]
        lines.append(f"  control   {shown_value(self.controller)}")
        lines.append(f"  gravity   {shown_value(self.gravity, 'm/s^2')}")
        lines += [f"  load      {shown_value(load)}" for load in self.load]
        return "\n".join(lines)

    @property
    def own_contacts(self) -> tuple[int, ...]:
        """Which contacts are of a caller's own class; their derivatives are those of their gaps."""
        return tuple(i for i, c in enumerate(self.contacts) if not isinstance(c, Contact | Contact3))

    def with_(self, **changes: Any) -> "Grasp":
        """A copy with fields replaced, by name.

        A name may belong to the grasp (`controller`, `gravity`, `load`), to its controller (`damping`,
        `force`, ...) or the one inside it (of `control.Sampled` and `control.Integral`), or to its object
        (`inertia`, `pivot`, ...); it must belong to just one of them.

        Raises:
            ValueError: For a name that there is not, and for whatever the constructors refuse.

        Example:
            >>> import jaxroll as jxr
            >>> grasp, _ = jxr.scenes.pivoted()
            >>> float(grasp.with_(damping=0.01).controller.damping)
            0.01
        """
        return changed(self, changes)

    def with_tip(self, finger: int, tip: AbstractContour | AbstractSurface) -> "Grasp":
        """A copy in which one finger carries another tip, a contour or in space a surface.

        Raises:
            ValueError: If there is no such finger, or the tip is not what the finger's constructor takes, or
                ends before the place where a contact starts.
        """
        index = as_count("finger", finger, least=0)
        if index >= len(self.fingers):
            raise ValueError(f"argument finger must be below {len(self.fingers)}, but was {index}")
        tip = taken(self.fingers[index], "tip", tip)
        # `tree_at` does not run the constructor, and so none of its checks.
        changed = eqx.tree_at(lambda g: g.fingers[index].tip, self, tip)
        changed._check_parts()
        return changed

    def with_contacts(self, *contacts: AbstractContact) -> "Grasp":
        """A copy with other starting contacts.

        Raises:
            ValueError: If one is not a contact, or does not fit the grasp.
        """
        return self.with_(contacts=contacts)


def tabled_grasp(grasp: Grasp) -> Grasp:
    """A grasp, its shapes checked, with the tables of its contours built by a program of their own.

    A function, because equinox makes a pytree of a method with each use, which takes 0.08 ms of every call.
    """
    return tabled_and_judged(grasp)[0]


def tabled_and_judged(grasp: Grasp) -> tuple[Grasp, Array | None]:
    """`tabled_grasp`, and whether the shapes are what a caller's own must be; None where all are known.

    Shapes that are known to fail raise. Those that nobody could check become NaN if they fail, so that
    whatever is computed of them is a number only if it is right; a run has a code for it.
    """
    _check_shapes(grasp)
    ready = _with_tables(grasp)
    if not has_unchecked_shapes(ready):
        return ready, None
    hold = keeps_contract([shape.prepared() for shape in _all_shapes(ready)])
    held = lambda x: jnp.where(hold, x, jnp.nan) if eqx.is_inexact_array(x) else x  # noqa: E731
    return eqx.tree_at(_all_shapes, ready, jax.tree.map(held, _all_shapes(ready))), hold


def _all_shapes(grasp: Grasp) -> list[Any]:
    return [shape for body in grasp.bodies for shape in body.shapes]


@remembered
def has_unchecked_shapes(grasp: Grasp) -> bool:
    """Whether a caller's own shape has numbers that JAX traces, which `_check_shapes` lets pass."""
    return unchecked(_all_shapes(grasp))


@remembered
def _check_shapes(grasp: Grasp) -> None:
    """Raise unless a caller's own contours and surfaces keep their contract, however they came in."""
    for i, contact in enumerate(grasp.contacts):
        contact.check_shapes(f"contacts[{i}]", grasp.shapes(contact))
    for shape in _all_shapes(grasp):
        check_shape("grasp", shape)


@remembered
def _with_tables(grasp: Grasp) -> Grasp:
    """A copy with the missing tables, or the grasp itself; kept, because other caches go by identity.

    The object's contours are checked to have an inside. A fingertip may cross itself on its far side, as the
    last one of a search may: runs with it are still valid.
    """
    grasp = _strongly_typed(grasp)
    new = [i for i, shape in enumerate(_all_shapes(grasp)) if tabled(shape) is not shape]
    if new:
        where = lambda g: [_all_shapes(g)[i] for i in new]  # noqa: E731
        grasp = eqx.tree_at(where, grasp, [tabled(shape) for shape in where(grasp)])
    for shape in grasp.object.shapes:
        check_once_round("grasp.object", shape)
    return grasp


def _strongly_typed(grasp: Grasp) -> Grasp:
    """A copy in which numbers that came as Python's own have JAX types that are not weak.

    JAX compiles once more for a number of a weak type: for `with_(damping=0.006)` after an array was there.
    A weak number stays weak where no other array of the grasp has its type: a state may be of less precision,
    which it then takes.
    """
    leaves, structure = jax.tree.flatten(grasp)
    kinds = {leaf.dtype for leaf in leaves if isinstance(leaf, jax.Array) and not _is_weak(leaf)}
    weak = [_is_weak(leaf) and leaf.dtype in kinds and not traced(leaf) for leaf in leaves]
    if not any(weak):
        return grasp
    each = zip(leaves, weak, strict=True)
    with computed_at_once():
        return structure.unflatten([_typed(leaf) if is_weak else leaf for leaf, is_weak in each])


# Compiled, a conversion takes a quarter of the time; one for each number, since each list would be a program.
@jax.jit
def _typed(leaf: Array) -> Array:
    return jnp.asarray(leaf, leaf.dtype)


def _is_weak(leaf: Any) -> bool:
    """Whether a leaf is an array of a weak type; random keys are arrays without the attribute."""
    return isinstance(leaf, jax.Array) and getattr(leaf, "weak_type", False)
