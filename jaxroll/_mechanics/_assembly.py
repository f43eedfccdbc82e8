r"""Object, fingers and contacts put together, as the equations of motion read them.

`AbstractGrasp` has what a run asks of a grasp: which bodies there are, which shapes a contact holds together,
gravity on every body, the lengths of a state (`Form`), declared jumps, and the grasp made ready (`prepared`).
Users make a `Grasp` (`_grasp`), which adds the constructor, its checks and what reports say.
"""

from typing import Any, TypeVar

import equinox as eqx
import jax
from jaxtyping import Array, Float

from .._linalg import unstack, Vec2, Vec3
from .._results import as_array
from .._xla import remembered
from ..contact import AbstractContact
from ._body import AbstractBody, AbstractFinger
from ._controller import AbstractController, memory_of
from ._state import Form

GraspType = TypeVar("GraspType", bound="AbstractGrasp")


class AbstractGrasp(eqx.Module):
    """What a run reads of a `Grasp`, which documents the fields."""

    object: eqx.AbstractVar[Any]
    fingers: eqx.AbstractVar[tuple[AbstractFinger, ...]]
    contacts: eqx.AbstractVar[tuple[Any, ...]]
    controller: eqx.AbstractVar[Any]
    gravity: eqx.AbstractVar[Float[Array, "*bodies d"] | None]
    load: eqx.AbstractVar[tuple[Any, ...]]

    @property
    def bodies(self) -> tuple[AbstractBody, ...]:
        """The object, then every finger."""
        return (self.object, *self.fingers)

    @property
    def spatial(self) -> bool:
        """Whether the grasp lives in space; else in the plane."""
        return self.contacts[0].axes == 3

    @property
    def _axes(self) -> int:
        """Number of axes of the world: 2 or 3."""
        return self.contacts[0].axes

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of velocities of the object, then of each finger."""
        return tuple(body.freedoms for body in self.bodies)

    @property
    def coordinates(self) -> int:
        """Number n of all velocities; in the plane also that of positions."""
        return sum(self.sizes)

    @property
    def form(self) -> Form:
        """How many positions, velocities and places a state has, body by body."""
        return _form(self)

    def shapes(self, contact: AbstractContact) -> tuple[Any, Any]:
        """The fingertip's and the object's contour (surface) that meet at a contact."""
        return self.fingers[contact.finger].tip, self.object.shapes[contact.touched]

    def fields(self) -> tuple[Vec2 | Vec3 | None, ...]:
        """Gravity on the object, then on every finger, as vectors [m/s^2]; None where there is none."""
        if self.gravity is None:
            return (None,) * len(self.bodies)
        vector = Vec3 if self.spatial else Vec2
        if self.gravity.ndim == 1:
            return (vector(*unstack(self.gravity)),) * len(self.bodies)
        return tuple(vector(*unstack(row)) for row in self.gravity)

    @property
    def jumps(self) -> tuple[Any, ...]:
        """Times [s] that its controller and loads declare as jumps; arrays of one axis, none empty."""
        parts = jax.tree.leaves((self.controller, self.load), is_leaf=_jumps)
        declared = [as_array("jumps", part.jumps) for part in parts if _jumps(part)]
        return tuple(times.ravel() for times in declared if times.size)

    @property
    def memory(self) -> Float[Array, " k"] | None:
        """What its controller's memory begins with; None where it has none."""
        return memory_of(self.controller, tuple(finger.joints for finger in self.fingers))

    def prepared(self: GraspType) -> GraspType:
        """This grasp with bodies and shapes ready for evaluation, their arrays split into scalars."""
        ready = (self.object.prepared(), tuple(finger.prepared() for finger in self.fingers))
        return eqx.tree_at(lambda g: (g.object, g.fingers), self, ready)


def _jumps(part: Any) -> bool:
    """Whether a part of a controller or load declares jumps: its own, and those of all parts inside it."""
    return isinstance(part, eqx.Module) and getattr(part, "jumps", None) is not None


@remembered
def _form(grasp: AbstractGrasp) -> Form:
    """The layout of a grasp's states; kept, because every check of a state asks for it."""
    places = tuple(c.form(grasp.shapes(c)) for c in grasp.contacts)
    positions = tuple(body.positions for body in grasp.bodies)
    sampled = isinstance(grasp.controller, AbstractController) and grasp.controller.sampled
    count = 0 if (memory := grasp.memory) is None else memory.shape[0]
    return Form(positions, grasp.sizes, jax.tree.structure(places), count, sampled)
