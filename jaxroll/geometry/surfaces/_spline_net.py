"""Triangles of a surface of splines at its own resolution: a net on the nodes of its grid, put onto it.

The field at the nodes is a product of matrices along the axes; `_net` makes triangles of it, and Newton's
method brings their corners to the surface. `fitting` looks at a whole surface by it, `plotting` draws it.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._linalg import unstack
from ..._xla import briskly
from ._net import net
from ._surface_spline import SplineSurface, with_room
from ._tensor_bspline import ORDER, UNIFORM

_BATCH = 4096
# Nodes whose field is this small beside the largest coefficient are on the surface: by rounding some would be
# inside and their neighbours outside, and the net would have slivers there that face anywhere.
_ON = 1e-14


def surface_values(surface: SplineSurface, fine: int) -> np.ndarray:
    """Values of the field at nodes, `fine` of them per cell along each axis."""
    found = np.asarray(surface.coefficients)
    for axis, count in enumerate(found.shape):
        cells = count - ORDER + 1
        place = np.arange(cells * fine + 1) / fine
        cell = np.minimum(np.floor(place).astype(int), cells - 1)
        matrix = np.zeros((len(place), count))
        weights = (place - cell)[:, None] ** np.arange(ORDER) @ (UNIFORM / 120.0).T
        np.put_along_axis(matrix, cell[:, None] + np.arange(ORDER), weights, axis=1)
        found = np.moveaxis(np.tensordot(matrix, found, axes=(1, axis)), 0, axis)
    return np.where(np.abs(found) <= _ON * np.abs(surface.coefficients).max(), 0.0, found)


def surface_net(surface: SplineSurface, fine: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices on the surface [m], shape (n, 3), and triangles, shape (m, 3), counter-clockwise from outside.

    Args:
        surface: A field; its zero set is met wherever it lies within the grid.
        fine: Nodes per cell of the field along each axis.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> from jaxroll.geometry.surfaces import surface_net
        >>> x = 0.01 * (np.arange(8) - 3.0)
        >>> slope = np.broadcast_to(x[:, None, None], (8, 8, 8))
        >>> wall = jxr.geometry.SplineSurface(slope - 0.005, (-0.01, -0.01, -0.01), 0.01)
        >>> vertices, triangles = surface_net(wall, 2)
        >>> bool(np.allclose(vertices[:, 0], 0.005))
        True
    """
    vertices, triangles = net(surface_values(surface, fine))
    if not len(vertices):
        return vertices, triangles
    places = np.asarray(surface.origin) + float(surface.step) / fine * vertices
    # Whole batches, so that one program does for any number of vertices; the first one is repeated.
    padded = np.concatenate([places, np.repeat(places[:1], -len(places) % _BATCH, axis=0)])
    roomy = with_room(surface)
    feet = [_feet(roomy, jnp.asarray(part)) for part in padded.reshape(-1, _BATCH, 3)]
    return np.concatenate([np.asarray(part) for part in feet])[: len(places)], triangles


@briskly
def _feet(surface: SplineSurface, points: Array) -> Array:
    """Points brought to the surface; twice by one loop, so that what brings them is compiled once."""

    def foot(point: Array) -> Array:
        return jnp.stack(jax.lax.fori_loop(0, 2, lambda _, at: surface.settled(at), unstack(point)))

    return jax.vmap(foot)(points)
