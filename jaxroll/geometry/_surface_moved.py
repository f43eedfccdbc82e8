"""Surfaces made of others: placed elsewhere, or seen from inside."""

import equinox as eqx
from jaxtyping import Array, Float

from .._algebra import unstack
from .._once import remembered
from .._results import as_floats, concrete, shown
from .._spatial import normalised, pose, Pose3, Vec3
from .._types import Given, Scalars
from ._contour import tabled
from ._gauss import Gauss3
from ._surface import AbstractSurface


class AbstractSurfaceOf(AbstractSurface):
    """A surface made of another one, with that one's coordinates."""

    surface: eqx.AbstractVar[AbstractSurface]

    @property
    def coordinates(self) -> int:
        return self.surface.coordinates

    @property
    def smoothness(self) -> float:
        return self.surface.smoothness

    def settled(self, at: Scalars) -> Scalars:
        return self.surface.settled(at)

    def spread(self, count: int) -> Scalars | None:
        return self.surface.spread(count)

    def margins(self, at: Scalars) -> Scalars:
        return self.surface.margins(at)

    def within(self, at: Scalars) -> Scalars:
        return self.surface.within(at)


class MovedSurface(AbstractSurfaceOf):
    """A surface placed in its body's frame: turned by a rotation, then shifted by `offset`.

    Its coordinates are those of the surface it places: of an implicit one the point before the move. `near`
    finds them.

    Args:
        surface: The surface to place.
        offset: Where its body's origin goes, shape (3,), in metres.
        rotation: Quaternion, scalar first, shape (4,); it is scaled to unit length.

    Example:
        >>> import jaxroll as jxr
        >>> tip = jxr.geometry.Sphere(0.01).moved(offset=(0.02, 0.0, 0.0))
        >>> tip.point(tip.near((0.05, 0.0, 0.0))).round(12).tolist()
        [0.03, 0.0, 0.0]
    """

    surface: AbstractSurface
    offset: Float[Array, "3"]
    rotation: Float[Array, "4"]
    pose: Pose3 | None

    def __init__(
        self,
        surface: AbstractSurface,
        offset: Given = (0.0, 0.0, 0.0),
        rotation: Given = (1.0, 0.0, 0.0, 0.0),
    ) -> None:
        if not isinstance(surface, AbstractSurface):
            raise ValueError(f"argument surface must be a surface, but was {shown(surface)}")
        self.surface = surface
        self.offset = as_floats("offset", offset, (3,))
        self.rotation = as_floats("rotation", rotation, (4,))
        seen = concrete(self.rotation)
        if seen is not None and not seen.any():
            raise ValueError(f"argument rotation must be a quaternion, but was {seen.tolist()}")
        self.pose = None

    def placed(self) -> Pose3:
        """The placement as a pose."""
        if self.pose is not None:
            return self.pose
        return pose(Vec3(*unstack(self.offset)), normalised(unstack(self.rotation)))

    def frame(self, at: Scalars) -> Gauss3:
        return self.surface.frame(at).placed(self.placed())

    def rate(self, at: Scalars, velocity: Vec3) -> Scalars:
        return self.surface.rate(at, self.placed().back(velocity))

    def basis(self, at: Scalars) -> tuple[Vec3, Vec3]:
        first, second = self.surface.basis(at)
        place = self.placed()
        return place.turn(first), place.turn(second)

    def start(self, point: Vec3) -> Scalars:
        return self.surface.start(self.placed().local(point))

    def prepared(self) -> "MovedSurface":
        ready = (self.surface.prepared(), self.placed())
        return eqx.tree_at(lambda m: (m.surface, m.pose), self, ready, is_leaf=lambda x: x is None)


class Hollow(AbstractSurfaceOf):
    """A surface seen from inside: the body is all round it, as the wall of a tube or of a bowl.

    Args:
        surface: The surface of the hole.

    Example:
        >>> import jaxroll as jxr
        >>> bowl = jxr.geometry.Hollow(jxr.Sphere(0.1))
        >>> bowl.principal_curvatures((0.0, 0.0, -0.1))[0].round(9).tolist()
        [-10.0, -10.0]
    """

    surface: AbstractSurface

    def __init__(self, surface: AbstractSurface) -> None:
        if not isinstance(surface, AbstractSurface):
            raise ValueError(f"argument surface must be a surface, but was {shown(surface)}")
        self.surface = surface

    def frame(self, at: Scalars) -> Gauss3:
        inner = self.surface.frame(at)
        return Gauss3(inner.point, -inner.normal, inner.shape * -1.0)

    def rate(self, at: Scalars, velocity: Vec3) -> Scalars:
        return self.surface.rate(at, velocity)

    def basis(self, at: Scalars) -> tuple[Vec3, Vec3]:
        first, second = self.surface.basis(at)
        return second, first

    def start(self, point: Vec3) -> Scalars:
        return self.surface.start(point)

    def prepared(self) -> "Hollow":
        return Hollow(self.surface.prepared())


@tabled.register
def _(surface: AbstractSurfaceOf) -> AbstractSurfaceOf:
    return surface if tabled(surface.surface) is surface.surface else _with_table(surface)


@remembered
def _with_table(surface: AbstractSurfaceOf) -> AbstractSurfaceOf:
    return eqx.tree_at(lambda m: m.surface, surface, tabled(surface.surface))
