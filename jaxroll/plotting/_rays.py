"""Where rays from inside a body leave it: for implicit surfaces without a closed form."""

import jax
import jax.numpy as jnp
import numpy as np

from .._linalg import Vec3
from .._results import shown
from .._types import Scalar
from .._xla import quickly
from ..geometry import AbstractImplicit, SplineSurface

# Along a ray, the first sign change is looked for at distances from 10 um to 10 m, 5 % apart.
_NEAREST, _STEP, _COUNT = 1e-5, 1.05, 284
_HALVINGS = 60
# How many more coefficients than cells a field of splines has along each axis.
OVERHANG = 5
_SEEDS = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], float)
_SCALES = (1e-3, 1e-2, 1e-1)
_DEPTHS = np.linspace(0.02, 0.5, 25)


def inside(surface: AbstractImplicit) -> np.ndarray:
    """A point where the field is negative, shape (3,) [m], far from the surface if one is found.

    Raises:
        ValueError: If the field is negative nowhere near the origin, or nowhere on its grid.
    """
    tried = _lattice(surface) if isinstance(surface, SplineSurface) else _seeded(surface)
    values = np.asarray(_values(surface, jnp.asarray(tried)))
    within = np.flatnonzero(values < 0.0)
    if not len(within):
        raise ValueError(f"argument surface must have an inside to be drawn, but was {shown(surface)}")
    # The first two points tried are middles: rays from there meet the surface most evenly.
    return tried[within[0] if within[0] < 2 else within[np.argmin(values[within])]]


def _lattice(surface: SplineSurface) -> np.ndarray:
    """Points of the grid of a field, which means nothing beyond it; first the middle of those inside."""
    low, cells = np.asarray(surface.origin), np.array(surface.coefficients.shape) - OVERHANG
    shares = np.stack(np.meshgrid(*3 * [np.linspace(0.0, 1.0, 17)], indexing="ij"), axis=-1).reshape(-1, 3)
    points = low + float(surface.step) * cells * shares
    values = np.asarray(_values(surface, jnp.asarray(points)))
    middle = points[values < 0.0].mean(axis=0) if (values < 0.0).any() else points[0]
    return np.concatenate([middle[None], middle[None], points])


def _seeded(surface: AbstractImplicit) -> np.ndarray:
    """The origin, the middle of some points of the surface, and points below these."""
    # From these seeds `near` leads to surfaces between a millimetre and some tenths of a metre in size; from
    # some seeds it finds nothing.
    on = np.asarray(surface.near(np.concatenate([scale * _SEEDS for scale in _SCALES])))
    on = on[np.isfinite(on).all(axis=1)]
    if not len(on):
        return np.zeros((1, 3))
    inwards = -np.asarray(surface.normal(on))
    depths = float(np.ptp(on, axis=0).max()) * _DEPTHS[:, None]
    below = (on[:, None] + depths * inwards[:, None]).reshape(-1, 3)
    return np.concatenate([np.zeros((1, 3)), on.mean(axis=0, keepdims=True), below])


def radii(surface: AbstractImplicit, centre: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Distances [m] from a point inside to the surface along directions of shape (n, 3).

    Raises:
        ValueError: If a ray does not leave the body.
    """
    found = np.asarray(_first(surface, jnp.asarray(centre), jnp.asarray(directions)))
    if not np.isfinite(found).all():
        raise ValueError(
            "argument surface must be closed to be drawn, but some rays from inside do not meet it"
        )
    return found


def _ready(surface: AbstractImplicit) -> AbstractImplicit:
    ready = surface.prepared()
    assert isinstance(ready, AbstractImplicit)
    return ready


@quickly
def _values(surface: AbstractImplicit, points: jax.Array) -> jax.Array:
    ready = _ready(surface)
    return jax.vmap(lambda p: jnp.asarray(ready.derivatives(Vec3(p[0], p[1], p[2])).value))(points)


@quickly
def _first(surface: AbstractImplicit, centre: jax.Array, directions: jax.Array) -> jax.Array:
    ready = _ready(surface)

    def outside(distance: Scalar, direction: jax.Array) -> jax.Array:
        point = centre + distance * direction
        return ready.derivatives(Vec3(point[0], point[1], point[2])).value > 0.0

    def along(direction: jax.Array) -> jax.Array:
        def step(k: int, high: jax.Array) -> jax.Array:
            # The first distance that is outside is kept; `high` is infinite until then.
            distance = _NEAREST * _STEP**k
            return jnp.where(jnp.isinf(high) & outside(distance, direction), distance, high)

        def halve(_: int, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            low, high = ends
            middle = 0.5 * (low + high)
            out = outside(middle, direction)
            return jnp.where(out, low, middle), jnp.where(out, middle, high)

        high = jax.lax.fori_loop(0, _COUNT, step, jnp.asarray(jnp.inf, direction.dtype))
        # One step before, the ray was inside, or at its start. Sixty halvings leave nothing but rounding.
        low = jnp.where(high > _NEAREST, high / _STEP, 0.0)
        low, high = jax.lax.fori_loop(0, _HALVINGS, halve, (low, high))
        return 0.5 * (low + high)

    return jax.vmap(along)(directions)
