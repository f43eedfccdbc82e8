r"""Contours and surfaces alike, in batches and as NumPy's arrays: for searches whose numbers of steps vary.

A `Sheet` has k = 1 (contour) or 2 (surface) directions in d = 2 or 3 axes. With the unit tangents $t_a$ at a
place, a small step $\delta$ leads to the point $p + \sum_a \delta_a t_a - \frac12 (\delta \cdot K \delta)\,n$
and to the normal $n + \sum_{ab} K_{ab} \delta_b t_a$: what `grasp_points` and `reach` solve with Newton's
method is the same in the plane and in space.
"""

import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import tangents, unstack
from .._results import traced
from .._xla import briskly, quickly, remembered
from ..geometry import AbstractContour, AbstractSurface, tabled
from ..geometry.surfaces import lattice

# Rows that one call of a compiled program takes.
_BATCH = 512
# A surface that holds more numbers reads a table of them for every place.
_TABLE = 1000
# How often a place returns to an implicit surface after a step.
_RETURNS = 2
# So many of the last sheets are kept, each with the arrays and the structure of its shape.
_KEPT = 16
_KNOWN: list[tuple[list[Any], Any, "Sheet"]] = []


class Frames(NamedTuple):
    """A sheet at n places.

    Attributes:
        points: Shape (n, d) [m].
        normals: Outward, shape (n, d).
        tangents: Unit and orthogonal, shape (n, k, d).
        bends: The shape operator in these tangents, shape (n, k, k) [1/m]; positive where convex.
    """

    points: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    bends: np.ndarray

    def taken(self, which: Any) -> "Frames":
        """The frames at some of the places."""
        return Frames(*(x[which] for x in self))


class Sheet(NamedTuple):
    """A contour or a surface, prepared. Places are rows of an array, shape (n, coordinates)."""

    shape: Any

    @property
    def spatial(self) -> bool:
        """Whether it is a surface."""
        return isinstance(self.shape, AbstractSurface)

    @property
    def coordinates(self) -> int:
        """How many numbers give a place."""
        return self.shape.coordinates if self.spatial else 1

    def frames(self, at: np.ndarray) -> Frames:
        """Points, normals, tangents and bends at places."""
        if not self.spatial:
            return Frames(*_in_batches(_contour_frames, self.shape, at))
        program = _table_frames if _reads_table(self.shape) else _surface_frames
        return Frames(*_in_batches(program, self.shape, at))

    def moved(self, at: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Places after small tangent steps, shape (n, k) [m]; put back between ends and onto the surface."""
        if not self.spatial:
            return self.within(at + steps)
        program = _table_moved if _reads_table(self.shape) else _surface_moved
        return _in_batches(program, self.shape, np.concatenate([at, steps], axis=1))[0]

    def within(self, at: np.ndarray) -> np.ndarray:
        """Arclengths within the domain of a contour: round a closed one, to the nearer end of an open one."""
        ends = self.shape.domain()
        if ends is None:
            return at
        low, high = (float(end) for end in ends)
        if self.shape.closed:
            # A place at the seam, to rounding, is at its beginning.
            length = high - low
            along = (at - low) % length
            return low + np.where(along < (1.0 - 1e-14) * length, along, 0.0)
        return np.clip(at, low, high)

    def sampled(self, count: int, extent: float) -> np.ndarray:
        """Places spread evenly; of a shape without bounds those within `extent` of its body's origin [m]."""
        if self.spatial:
            found = self.spread(count)
            if found is not None:
                return found
            near = np.asarray(self.shape.near(extent * (2.0 * lattice(count, 3) - 1.0)))
            return near[np.isfinite(near).all(axis=1)]
        share = (np.arange(count) + 0.5) / count
        ends = self.shape.domain()
        if ends is not None:
            return (float(ends[0]) + (float(ends[1]) - float(ends[0])) * share)[:, None]
        middle = self.feet(np.zeros((1, 2)), np.zeros((1, 1)))
        return middle + extent * (2.0 * share[:, None] - 1.0)

    def spread(self, count: int) -> np.ndarray | None:
        """Places spread evenly over a whole surface; None where it has no bounds."""
        kept = _spreads(self.shape)
        if count not in kept:
            found = self.shape.spread(count)
            kept[count] = (
                None
                if found is None
                else np.stack([np.broadcast_to(np.asarray(x, float), count) for x in found], axis=-1)
            )
        return kept[count]

    def feet(self, points: np.ndarray, at: np.ndarray, steps: int = 12) -> np.ndarray:
        r"""Places nearest to points, from guesses, by Newton's method.

        $(1 + h K)\,\delta$ is the tangent part of the arm, h the point's height over the tangent plane. Where
        that matrix is not positive, beyond a centre of curvature, the step is the tangent part, shortened.
        """
        for _ in range(steps):
            here = self.frames(at)
            arm = points - here.points
            height = np.einsum("nd,nd->n", arm, here.normals)
            aside = np.einsum("nkd,nd->nk", here.tangents, arm)
            firm = np.eye(aside.shape[1]) + height[:, None, None] * here.bends
            low = np.linalg.eigvalsh(firm)[:, 0] > 0.1
            size = 1.0 + np.abs(height) * np.linalg.norm(here.bends, axis=(1, 2))
            firm[~low] = np.eye(aside.shape[1]) * size[~low, None, None]
            step = np.linalg.solve(firm, aside[..., None])[..., 0]
            at = self.moved(at, shortened(step, here.bends))
            if np.abs(step).max(initial=0.0) < 1e-15 * (np.abs(points).max() + 1e-3):
                break
        return at


def shortened(steps: np.ndarray, bends: np.ndarray) -> np.ndarray:
    """Steps cut to half the smallest radius of curvature."""
    lengths = np.linalg.norm(steps, axis=1) * np.linalg.norm(bends, axis=(1, 2))
    return steps / np.maximum(1.0, 2.0 * lengths)[:, None]


def sheet_of(shape: AbstractContour | AbstractSurface) -> Sheet:
    """A contour or surface as a sheet, with all worked out that does not depend on the place.

    Kept by the shape's arrays: a grasp with another tip or pose is made of new objects, but holds the arrays
    that it was given, and what is known of a face stays known. What JAX is tracing is made anew.
    """
    leaves, form = jax.tree.flatten(shape)
    for i, (known, alike, sheet) in enumerate(_KNOWN):
        same = len(known) == len(leaves) and all(map(operator.is_, known, leaves))
        if same and alike == form:
            # Put last: an object stays known, however many tips are made beside it.
            _KNOWN.append(_KNOWN.pop(i))
            return sheet
    sheet = Sheet(_prepared(tabled(shape)))
    if not traced(leaves):
        _KNOWN.append((leaves, form, sheet))
        del _KNOWN[:-_KEPT]
    return sheet


@remembered
def _spreads(shape: Any) -> dict[int, np.ndarray | None]:
    """Places spread over a surface, by their count; empty at first, `Sheet.spread` adds what it finds."""
    return {}


@quickly
def _prepared(shape: Any) -> Any:
    return shape.prepared()


def _in_batches(program: Any, shape: Any, rows: np.ndarray) -> tuple[np.ndarray, ...]:
    """A compiled function of a shape and rows, called with batches of one length: so it is compiled once."""
    count = max(1, -(-len(rows) // _BATCH))
    padded = np.resize(rows, (count * _BATCH, rows.shape[1])).reshape(count, _BATCH, -1)
    found = [program(shape, jnp.asarray(batch)) for batch in padded]
    return tuple(
        np.concatenate([np.array(x) for x in part])[: len(rows)] for part in zip(*found, strict=True)
    )


@quickly
def _contour_frames(contour: AbstractContour, at: Array) -> tuple[Array, ...]:
    def one(row: Array) -> tuple[Array, ...]:
        here = contour.frame(row[0])
        tangent = here.tangent.array()
        bend = jnp.asarray(here.curvature, row.dtype)
        return here.point.array(), here.tangent.right().array(), tangent[None], bend[None, None]

    return jax.vmap(one)(at)


def _frames_of(surface: AbstractSurface, at: Array) -> tuple[Array, ...]:
    """Points, normals, tangents and bends of a surface at places."""

    def one(row: Array) -> tuple[Array, ...]:
        here = jax.tree.map(jnp.asarray, surface.frame(unstack(row)))
        first, second = tangents(here.normal)
        form = here.shape.form
        bends = [[form(first, first), form(first, second)], [form(first, second), form(second, second)]]
        basis = jnp.stack([first.array(), second.array()])
        return here.point.array(), here.normal.array(), basis, jnp.stack([jnp.stack(row) for row in bends])

    return jax.vmap(one)(at)


def _reads_table(surface: AbstractSurface) -> bool:
    """Whether a surface is a field of many numbers, of which each place takes long enough to compile well."""
    return sum(np.size(leaf) for leaf in jax.tree.leaves(surface)) > _TABLE


def _moved_places(surface: AbstractSurface, rows: Array) -> tuple[Array]:
    """Places, the first columns of the rows, after the tangent steps in the last two."""
    count = surface.coordinates

    def one(row: Array) -> Array:
        numbers = unstack(row)
        at, (along, across) = numbers[:count], numbers[count:]
        first, second = tangents(surface.frame(at).normal)
        rates = surface.rate(at, first * along + second * across)
        at = tuple(a + b for a, b in zip(at, rates, strict=True))
        # Back onto an implicit surface, and into a chart's domain. As a loop, so that it is compiled once.
        at = _typed(at, row.dtype)
        at = jax.lax.fori_loop(0, _RETURNS, lambda _, at: _typed(surface.settled(at), row.dtype), at)
        return jnp.stack(_typed(surface.within(at), row.dtype))

    return (jax.vmap(one)(rows),)


def _typed(numbers: Sequence[Any], dtype: Any) -> tuple[Array, ...]:
    return tuple(jnp.asarray(x, dtype) for x in numbers)


_surface_frames, _table_frames = quickly(_frames_of), briskly(_frames_of)
_surface_moved, _table_moved = quickly(_moved_places), briskly(_moved_places)
