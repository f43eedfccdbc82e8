"""Places spread evenly over a surface: low-discrepancy seeds, thinned to those farthest apart."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._linalg import Vec3

# Seeds for every place that is kept.
SEEDS = 4


def directions(count: int) -> Float[np.ndarray, "count 3"]:
    """Unit vectors spread evenly over the sphere: Fibonacci's lattice."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn, out = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count), np.sqrt(1.0 - z * z)
    return np.stack([out * np.cos(turn), out * np.sin(turn), z], axis=-1)


def lattice(count: int, axes: int) -> Float[np.ndarray, "count axes"]:
    """Points spread evenly over the unit square or cube: multiples of the generalised golden ratio."""
    ratio = 1.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (axes + 1.0))
    return (0.5 + np.outer(np.arange(count), ratio ** -np.arange(1.0, axes + 1.0))) % 1.0


def thinned(points: Vec3, fair: Bool[Array, " seeds"], count: int) -> Int[Array, " count"]:
    """Indices of fair points, each the farthest from those before; they repeat where there are too few."""

    def away(i: Array) -> Array:
        arm = points - Vec3(points.x[i], points.y[i], points.z[i])
        return arm.dot(arm)

    def take(left: Array, _: None) -> tuple[Array, Array]:
        i = jnp.argmax(left)
        return jnp.minimum(left, away(i)), i

    start = jnp.where(fair, jnp.inf, -1.0).astype(points.x.dtype)
    return jax.lax.scan(take, start, None, length=count)[1]
