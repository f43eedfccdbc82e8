"""The free numbers of a contour, and its mirror image."""

import functools
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..geometry import (
    AbstractContour,
    ArclengthTable,
    Moved,
    NeuralSupport,
    Spline,
    SupportFunction,
    Table,
    tabled,
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
    return [contour.radius, contour.centre, *(leaf for leaf in leaves if eqx.is_inexact_array(leaf))]


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


def as_batch(contours: Sequence[AbstractContour]) -> tuple[Any, Any]:
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


@eqx.filter_jit
def body_radii(arrays: Any, rest: Any) -> tuple[Array, Array]:
    """Of every contour of a batch, root mean square and largest distance from its body's origin [m].

    The first is the unit of its free numbers.
    """

    def one(arrays: Any) -> tuple[Array, Array]:
        ready = tabled(eqx.combine(arrays, rest)).prepared()
        ends = ready.domain()
        assert ends is not None  # checked where the contour came in
        point = ready.frame(ends[0] + (ends[1] - ends[0]) * jnp.linspace(0.0, 1.0, 257)).point
        squared = point.dot(point)
        return jnp.sqrt(jnp.mean(squared)), jnp.sqrt(jnp.max(squared))

    return jax.vmap(one)(arrays)


@functools.singledispatch
def smoothing(contour: AbstractContour, unit: float) -> np.ndarray:
    """Matrix from unknowns to free numbers in a unit [m], under which all unknowns change a contour alike.

    The k-th wave along a contour bends it as k squared: searched point by point, curvature is stiff. What is
    no length, such as a network's weights, is measured against its own size.
    """
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(divided(contour)[0])]
    sizes = [float(np.sqrt(np.mean(leaf**2))) for leaf in leaves]
    each = [
        np.full(leaf.size, size / unit if size > 0.0 else 1.0)
        for leaf, size in zip(leaves, sizes, strict=True)
    ]
    return np.diag(np.concatenate(each))


@smoothing.register
def _(contour: Spline, unit: float) -> np.ndarray:
    points, ends = contour.points.shape[0], 0 if contour.closed else contour.points.shape[0] - 1
    # An open contour is seen as there and back again, so that its ends are not joined.
    whole = points + max(ends - 1, 0)
    wave = np.abs(np.fft.fftfreq(whole) * whole) / (2.0 if ends else 1.0)
    kernel = np.real(np.fft.ifft(2.0 / (1.0 + wave**2)))
    near = np.arange(points)[:, None] - np.arange(points)[None, :]
    matrix = kernel[near % whole]
    if ends:
        matrix = matrix + kernel[(np.arange(points)[:, None] + np.arange(points)[None, :]) % whole]
    return np.kron(matrix, np.eye(2))


@smoothing.register
def _(contour: SupportFunction, unit: float) -> np.ndarray:
    terms = np.arange(1, 1 + contour.cosines.shape[0])
    each = 2.0 / (1.0 + terms**2)
    return np.diag(np.concatenate([[1.0], each, each]))


@smoothing.register
def _(contour: Moved, unit: float) -> np.ndarray:
    return smoothing(contour.contour, unit)


# Size of a variation, as a share of the contour's own numbers.
_VARIED = 0.15


def varied(contours: Sequence[AbstractContour], count: int, seed: int) -> list[AbstractContour]:
    """The contours given, and smooth variations of them until there are `count`."""
    rng = np.random.default_rng(seed)
    more = [variation(contours[i % len(contours)], rng) for i in range(count - len(contours))]
    return [*contours, *more]


@functools.singledispatch
def variation(contour: AbstractContour, rng: np.random.Generator) -> AbstractContour:
    """A contour like a given one: every free number changed by some 15 %."""
    free, fixed = divided(contour)
    spread = lambda x: x * (1.0 + _VARIED * rng.standard_normal(np.shape(x)))  # noqa: E731
    return eqx.combine(jax.tree.map(spread, free), fixed)


@variation.register
def _(contour: Spline, rng: np.random.Generator) -> Spline:
    """Points moved by the first few waves along the contour."""
    points = np.asarray(contour.points)
    u = 2.0 * np.pi * np.arange(len(points)) / len(points)
    waves = [np.ones_like(u), *(f(k * u) / k for k in (1, 2, 3) for f in (np.cos, np.sin))]
    size = 0.5 * _VARIED * np.sqrt(np.mean(np.sum(points**2, axis=1)))
    shift = size * np.stack(waves, axis=1) @ rng.standard_normal((len(waves), 2))
    return eqx.tree_at(lambda c: c.points, contour, jnp.asarray(points + shift))


@variation.register
def _(contour: SupportFunction, rng: np.random.Generator) -> SupportFunction:
    """Terms of the series changed by less and less, so that it stays convex."""
    order = np.arange(1, 1 + contour.cosines.shape[0])
    size = _VARIED * float(contour.radius) / order**3
    wave = lambda: jnp.asarray(size * rng.standard_normal(len(order)))  # noqa: E731
    where = lambda c: (c.cosines, c.sines)  # noqa: E731
    return eqx.tree_at(where, contour, (contour.cosines + wave(), contour.sines + wave()))


@variation.register
def _(contour: Moved, rng: np.random.Generator) -> Moved:
    return eqx.tree_at(lambda c: c.contour, contour, variation(contour.contour, rng))
