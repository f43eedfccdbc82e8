"""Feet, normals and curvatures of a surface of splines near many points, a batch at a time."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._linalg import unstack, Vec3
from ..._xla import briskly
from ..surfaces import principal, SplineSurface, with_room
from ._field_fit import Grid
from ._field_solve import values_matrix

_BATCH = 4096
_MOST = 200_000  # most points that are measured one by one


def evenly(count: int) -> slice:
    """Every k-th of so many points, k as small as leaves no more than 200 000."""
    return slice(None, None, -(-count // _MOST))


def angles(normals: np.ndarray, given: np.ndarray) -> tuple[float, float]:
    """Root mean square and largest angle between two arrays of unit vectors [rad]."""
    turned = np.arccos(np.clip(np.sum(normals * given, axis=1), -1.0, 1.0))
    return float(np.sqrt(np.mean(turned**2))), float(turned.max())


def measured(surface: SplineSurface, points: Array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Feet [m], unit normals and both principal curvatures [1/m] of the surface near the points."""
    roomy = with_room(surface)
    parts = [_batch(roomy, part) for part in _batches(points)]
    found = [np.concatenate([np.asarray(part[k]) for part in parts])[: len(points)] for k in range(3)]
    return found[0], found[1], found[2]


def levels_at(surface: SplineSurface, points: np.ndarray) -> np.ndarray:
    """The surface's field at points [m].

    In NumPy: a fit asks for it on a dozen grids, and JAX would compile for each of them.
    """
    shape = surface.coefficients.shape
    grid = Grid(np.asarray(surface.origin), float(surface.step), (shape[0], shape[1], shape[2]))
    numbers = np.asarray(surface.coefficients).ravel()
    starts = range(0, len(points), _BATCH)
    parts = [values_matrix(grid, points[start : start + _BATCH]) @ numbers for start in starts]
    return np.concatenate([np.zeros(0), *parts])


def _batches(points: Array) -> Array:
    """The points in whole batches, so that one program does for any number of them."""
    padded = jnp.concatenate([points, jnp.broadcast_to(points[:1], (-len(points) % _BATCH, 3))])
    return padded.reshape(-1, _BATCH, 3)


@briskly
def _batch(surface: SplineSurface, points: Array) -> tuple[Array, Array, Array]:
    """What `measured` says of one batch; what brings points to the surface is compiled once, in a loop."""

    def one(point: Array) -> tuple[Array, Array, Array]:
        at = jax.lax.fori_loop(0, 2, lambda _, at: surface.settled(at), unstack(point))
        frame = surface.frame(at)
        found = principal(frame)
        return Vec3(*at).array(), frame.normal.array(), jnp.stack([found.low, found.high])

    return jax.vmap(one)(points)
