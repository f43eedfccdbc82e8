"""The state of a grasp: arrays at the public door, blocks of scalars inside."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._results import as_array, check_instance
from .._types import Scalars

Blocks = tuple[Scalars, ...]


class State(eqx.Module):
    r"""Configuration, velocity and contact coordinates of a grasp.

    Attributes:
        q: Shape (n,), positions: the object's ($\theta$, or $x, y, \theta$; in space position and
            quaternion), then those of every finger; radians and metres.
        v: Shape (n,), velocities: in the plane the rates of q; in space a `FreeObject3` has the velocity
            of its centre and its spin in body axes, so that q is longer than v.
        s: Shape (c,), contact coordinates. In the plane the rolling coordinate $\sigma$ of each contact
            [m], zero at the starting contact: $s_A = s_{A0} + \sigma$ on the fingertip,
            $s_B = s_{B0} - \sigma$ on the object. In space, of each contact, its place on the fingertip's
            surface, then on the object's.
    """

    q: Float[Array, " n"]
    v: Float[Array, " nv"]
    s: Float[Array, " c"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Leaves:
    """A `State` with every number its own leaf; block 0 is the object, then the fingers.

    `s` holds the place of each contact: a number in the plane, two tuples of numbers in space.
    """

    q: Blocks
    v: Blocks
    s: tuple[Any, ...]


class Form(NamedTuple):
    """How many numbers a state has, and where they go; static."""

    positions: tuple[int, ...]
    sizes: tuple[int, ...]
    places: Any  # structure of the contacts' places

    @property
    def counts(self) -> tuple[int, int, int]:
        """Lengths of q, v and s."""
        return sum(self.positions), sum(self.sizes), self.places.num_leaves


def as_state(name: str, value: Any, form: Form, *, axes: int = 0) -> State:
    """A state as arrays of the sizes that its grasp wants, or one sentence; unchanged where it is that.

    The one place that notices a state of another grasp, from sizes: where two grasps have the same ones,
    only `residuals` can tell. `axes` is how many leading axes it may have.
    """
    check_instance(name, value, State, "a jaxroll.State")
    given = {part: getattr(value, part) for part in "qvs"}
    parts = {part: _as_part(f"{name}.{part}", array) for part, array in given.items()}
    q, v, s = (jnp.shape(array) for array in parts.values())
    lead = q[:-1]
    for part, shape, size in zip("qvs", (q, v, s), form.counts, strict=True):
        if shape != (*lead, size) or len(lead) > axes:
            wanted = f"({size},)" if not axes else f"({size},) or (t, {size})"
            raise ValueError(f"argument {name}.{part} must have shape {wanted}, but had {shape}")
    if len({array.dtype for array in parts.values()}) > 1:
        kinds = [str(array.dtype) for array in parts.values()]
        raise ValueError(f"argument {name} must have q, v and s of one precision, but had {', '.join(kinds)}")
    if all(parts[part] is array for part, array in given.items()):
        return value
    return State(**parts)


def _as_part(name: str, value: Any) -> Array:
    """An array of single or double precision."""
    array = value
    if not (isinstance(value, jax.Array) and value.dtype.kind == "f"):
        array = as_array(name, value)
    if array.dtype.itemsize < 4:
        raise ValueError(f"argument {name} must be of single or double precision, but was {array.dtype}")
    return array


def to_leaves(state: State, form: Form) -> Leaves:
    """Arrays to scalars, on entry."""
    return Leaves(split(state.q, form.positions), split(state.v, form.sizes), to_places(state.s, form))


def to_places(s: Array, form: Form) -> tuple[Any, ...]:
    """Contact coordinates as the places of the contacts."""
    return jax.tree.unflatten(form.places, [s[i] for i in range(form.places.num_leaves)])


def to_state(leaves: Leaves) -> State:
    """Scalars to arrays, on exit; also for leaves with a leading time axis."""
    return State(join(leaves.q), join(leaves.v), jnp.stack(jax.tree.leaves(leaves.s), axis=-1))


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
