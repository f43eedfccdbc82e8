"""Places spread evenly over a surface: low-discrepancy seeds, thinned to those farthest apart.

Surfaces make their `spread` of these, and the search for contacts (`contact.locating`) samples both bodies by
it. Even seeds in parameters or in a box are uneven on the surface: thinning some four times as many makes up
for that.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._linalg import Vec3

# Seeds for every place that is kept.
SEEDS = 4


def directions(count: int) -> Float[np.ndarray, "count 3"]:
    """Unit vectors spread evenly over the sphere: Fibonacci's lattice."""
    # Equal steps of z are equal areas; each turns by the golden ratio (up to whole turns).
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn, out = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count), np.sqrt(1.0 - z * z)
    return np.stack([out * np.cos(turn), out * np.sin(turn), z], axis=-1)


def lattice(count: int, axes: int) -> Float[np.ndarray, "count axes"]:
    """Points spread evenly over the unit square or cube: multiples of the generalised golden ratio."""
    # Fixed point of ratio^(axes + 1) = ratio + 1: the golden ratio for one axis. Axis k steps by ratio^-k.
    ratio = 1.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (axes + 1.0))
    return (0.5 + np.outer(np.arange(count), ratio ** -np.arange(1.0, axes + 1.0))) % 1.0


def thinned(points: Vec3, fair: Bool[Array, " seeds"], count: int) -> Int[Array, " count"]:
    """Indices of `count` points, each the farthest from all before; they repeat where too few are fair.

    `fair` says which points may be taken. If none is, the first one is taken again and again.
    """
    return _thinned(points, fair, count)


@eqx.filter_jit  # compiled once for as many points and as many kept, whatever the points
def _thinned(points: Vec3, fair: Array, count: int) -> Array:
    """`thinned`, as a program."""

    def away(i: Array) -> Array:
        arm = points - Vec3(points.x[i], points.y[i], points.z[i])
        return arm.dot(arm)

    def take(left: Array, _: None) -> tuple[Array, Array]:
        i = jnp.argmax(left)
        return jnp.minimum(left, away(i)), i

    # `left` holds each point's squared distance from the nearest taken one: infinite at first, and -1, below
    # any distance, for those that are not fair.
    start = jnp.where(fair, jnp.inf, -1.0).astype(points.x.dtype)
    return jax.lax.scan(take, start, None, length=count)[1]
