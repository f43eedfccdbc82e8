"""The state of a grasp: arrays at the public door, blocks of scalars inside."""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Scalars

Blocks = tuple[Scalars, ...]


class State(eqx.Module):
    r"""Configuration, velocity and contact coordinates of a grasp.

    Attributes:
        q: Shape (n,), generalised coordinates: the object's ($\theta$, or $x, y, \theta$), then the
            joint angles of every finger; radians and metres.
        v: Shape (n,), their rates.
        s: Shape (c,), rolling coordinate $\sigma$ of each contact [m], zero at the starting contact:
            $s_A = s_{A0} + \sigma$ on the fingertip, $s_B = s_{B0} - \sigma$ on the object.
    """

    q: Float[Array, " n"]
    v: Float[Array, " n"]
    s: Float[Array, " c"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Leaves:
    """A `State` with every number its own leaf; block 0 is the object, then the fingers."""

    q: Blocks
    v: Blocks
    s: Scalars


def to_leaves(state: State, sizes: tuple[int, ...]) -> Leaves:
    """Arrays to scalars, on entry."""
    contacts = state.s.shape[0]
    return Leaves(split(state.q, sizes), split(state.v, sizes), tuple(state.s[i] for i in range(contacts)))


def to_state(leaves: Leaves) -> State:
    """Scalars to arrays, on exit; also for leaves with a leading time axis."""
    return State(join(leaves.q), join(leaves.v), jnp.stack(leaves.s, axis=-1))


def split(array: Array, sizes: tuple[int, ...]) -> Blocks:
    """One array of shape (n,) as blocks of scalars."""
    blocks, start = [], 0
    for size in sizes:
        blocks.append(tuple(array[start + i] for i in range(size)))
        start += size
    return tuple(blocks)


def join(blocks: Blocks) -> Array:
    """Blocks of scalars as one array, stacked on the last axis."""
    return jnp.stack([leaf for block in blocks for leaf in block], axis=-1)
