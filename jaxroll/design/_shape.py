"""The free numbers of a contour, and its mirror image."""

import functools
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..geometry import (
    AbstractContour,
    ArclengthTable,
    Moved,
    NeuralSupport,
    Spline,
    SupportFunction,
    Table,
)


@functools.singledispatch
def free_numbers(contour: AbstractContour) -> list[Any]:
    """The arrays of a contour that a design may change: all of them, unless its class says otherwise."""
    return [leaf for leaf in jax.tree.leaves(contour) if eqx.is_inexact_array(leaf)]


@free_numbers.register
def _(contour: Spline) -> list[Any]:
    return [contour.points]


@free_numbers.register
def _(contour: SupportFunction) -> list[Any]:
    return [contour.radius, contour.cosines, contour.sines]


@free_numbers.register
def _(contour: NeuralSupport) -> list[Any]:
    leaves = jax.tree.leaves(contour.network)
    return [contour.radius, *(leaf for leaf in leaves if eqx.is_inexact_array(leaf))]


@free_numbers.register
def _(contour: Moved) -> list[Any]:
    return free_numbers(contour.contour)


def divided(contour: AbstractContour) -> tuple[Any, Any]:
    """The free numbers of a contour, and the rest of it: two trees for `equinox.combine`."""
    free = {id(leaf) for leaf in free_numbers(contour)}
    return eqx.partition(contour, jax.tree.map(lambda leaf: id(leaf) in free, contour))


@functools.singledispatch
def mirrored(contour: AbstractContour) -> AbstractContour:
    """The contour made symmetric about its x axis, on which it faces the object."""
    raise ValueError(f"argument symmetric must be False for a {type(contour).__name__}, but was True")


@mirrored.register
def _(contour: Spline) -> Spline:
    count, middle = contour.points.shape[0], contour.origin
    if not contour.closed and 2 * middle != count - 1:
        raise ValueError(
            f"argument symmetric must be False unless an open spline's origin is its middle point, "
            f"but that is {middle} of {count}"
        )
    partner = (2 * middle - jnp.arange(count)) % count
    flipped = contour.points[partner] * jnp.array([1.0, -1.0])[None, :]
    return eqx.tree_at(lambda c: c.points, contour, 0.5 * (contour.points + flipped))


@mirrored.register
def _(contour: SupportFunction) -> SupportFunction:
    return eqx.tree_at(lambda c: c.sines, contour, jnp.zeros_like(contour.sines))


@mirrored.register
def _(contour: Moved) -> Moved:
    return eqx.tree_at(lambda c: c.contour, contour, mirrored(contour.contour))


def check_unprepared(contour: AbstractContour) -> None:
    """Raise for a contour whose table is built: it would stay while the free numbers move."""
    table = lambda node: isinstance(node, Table | ArclengthTable)  # noqa: E731
    if any(map(table, jax.tree.leaves(contour, is_leaf=table))):
        kind = type(contour).__name__
        raise ValueError(
            f"argument tip must not be prepared, as its table would stay, but was a ready {kind}"
        )


def stacked(contours: Sequence[AbstractContour]) -> tuple[Any, Any]:
    """Contours of one kind with a leading axis on every array, and what they share besides."""
    parts = [eqx.partition(contour, eqx.is_inexact_array) for contour in contours]
    first = jax.tree.structure(parts[0])
    if any(jax.tree.structure(part) != first for part in parts):
        kinds = ", ".join(type(contour).__name__ for contour in contours)
        raise ValueError(f"argument tip must be contours of one kind and size, but was {kinds}")
    arrays = [part[0] for part in parts]
    shapes = [[jnp.shape(leaf) for leaf in jax.tree.leaves(part)] for part in arrays]
    if any(shape != shapes[0] for shape in shapes):
        raise ValueError(f"argument tip must be contours of one size, but had arrays of shapes {shapes}")
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *arrays), parts[0][1]


def extent(contour: AbstractContour) -> Array:
    """Root mean square distance of a contour from its body's origin [m]: the unit of its free numbers."""
    ready = contour.prepared()
    ends = ready.domain()
    assert ends is not None  # checked where the contour came in
    point = ready.frame(ends[0] + (ends[1] - ends[0]) * jnp.linspace(0.0, 1.0, 65)).point
    return jnp.sqrt(jnp.mean(point.dot(point)))
