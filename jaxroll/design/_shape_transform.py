"""Contours of one kind as one batch, and their sizes."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..geometry import AbstractContour, ArclengthTable, Table, tabled


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
        places = ends[0] + (ends[1] - ends[0]) * jnp.linspace(0.0, 1.0, 257)
        point = jax.vmap(lambda s: ready.frame(s).point)(places)
        squared = point.dot(point)
        return jnp.sqrt(jnp.mean(squared)), jnp.sqrt(jnp.max(squared))

    return jax.vmap(one)(arrays)


def varied(contours: Sequence[AbstractContour], count: int, seed: int) -> list[AbstractContour]:
    """The contours given, and perturbed ones until there are `count`."""
    rng = np.random.default_rng(seed)
    more = [contours[i % len(contours)].perturbed(rng) for i in range(count - len(contours))]
    return [*contours, *more]
