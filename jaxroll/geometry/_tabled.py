"""What contours and surfaces have in common: work that is done once for a shape, not in every evaluation.

There are two kinds. `tabled` builds tables over arclength by a program of its own, kept by the shape's
identity, so that all runs with the shape share it. `prepared` works out the rest that does not depend on the
place (sines of an angle, coefficients) inside the program of a solve. Both have defaults that pass on to the
shapes within a shape.
"""

import abc
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax

from .._printing import listed_without_none
from .._results import check_instance
from .._xla import remembered

ShapeType = TypeVar("ShapeType", bound="AbstractShape")


class AbstractShape(eqx.Module):
    """A contour or a surface. By default, the shapes in its fields are what is prepared and tabled."""

    __repr__ = listed_without_none

    @property
    @abc.abstractmethod
    def smoothness(self) -> float:
        """Continuous derivatives of the point."""

    def prepared(self: ShapeType) -> ShapeType:
        """This shape with all that does not depend on the place worked out, once per solve.

        By default with the shapes that it holds prepared; otherwise itself.
        """
        return _with_inner(self, lambda part: part.prepared())

    def tabled(self: ShapeType) -> ShapeType:
        """This shape with the table that its frame is read from, built by a program that all runs share.

        By default with the tables of the shapes that it holds; itself where there is none to build. A class
        of your own whose frame takes long to find builds one by subclassing `AbstractTabulated`.
        """
        parts = _inner(self)
        return self if all(part.tabled() is part for part in parts) else _with_inner_tables(self)


def tabled(shape: ShapeType) -> ShapeType:
    """A contour or surface with its table built, if it reads one: by a program that all others share."""
    check_instance("shape", shape, AbstractShape, "a contour or a surface")
    return shape.tabled()


def _inner(shape: AbstractShape) -> list[AbstractShape]:
    """The shapes among a shape's fields, at any depth of what holds them, but not those in them."""
    # Shapes are pytrees themselves: `is_leaf` stops at the first one below this.
    parts = jax.tree.leaves(shape, is_leaf=_held_by(shape))
    return [part for part in parts if isinstance(part, AbstractShape)]


def _held_by(shape: AbstractShape) -> Callable[[Any], bool]:
    """Whether a node of a shape's tree is another shape."""
    return lambda node: node is not shape and isinstance(node, AbstractShape)


def _with_inner(shape: ShapeType, change: Callable[[AbstractShape], AbstractShape]) -> ShapeType:
    """A shape with the shapes that it holds changed."""
    if not _inner(shape):
        return shape
    each = lambda part: change(part) if isinstance(part, AbstractShape) else part  # noqa: E731
    return jax.tree.map(each, shape, is_leaf=_held_by(shape))


@remembered
def _with_inner_tables(shape: Any) -> Any:
    """A shape with the tables of the shapes that it holds; kept, so that a shape always gives one object."""
    return _with_inner(shape, lambda part: part.tabled())
