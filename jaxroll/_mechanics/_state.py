"""The state of a grasp: `State` holds arrays for callers, `Leaves` the same numbers as scalars, body by body.

The dynamics works on scalars because XLA fuses them (`_linalg`). `Form` says how many of them each body has,
`to_leaves` goes from one to the other; `_integration._state_vector` goes both ways for a run.
"""

import itertools
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._linalg import scalars
from .._printing import listed
from .._results import as_array, shown, traced
from .._types import Given, Scalars

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
        memory: Shape (k,), of a controller with a memory; None otherwise, and at a start that is to begin
            with the controller's own.

    Lists and whole numbers become floating arrays, all of one precision. Leading axes are those of a batch or
    of time. Numbers need not be finite, as those of saved states that a run did not reach are not.

    Raises:
        ValueError: If one of them is not an array of real numbers with at least one axis.

    Example:
        >>> import jaxroll as jxr
        >>> jxr.State([0, 1, 2], [0, 0, 0], [0]).q.dtype.kind
        'f'
    """

    AXES: ClassVar[dict[str, tuple[str, ...]]] = {
        "q": ("position",),
        "v": ("velocity",),
        "s": ("place",),
        "memory": ("number",),
    }

    q: Float[Array, " n"]
    v: Float[Array, " nv"]
    s: Float[Array, " c"]
    memory: Float[Array, " k"] | None = None

    def __init__(self, q: Given, v: Given, s: Given, memory: Given | None = None) -> None:
        named = [("q", q), ("v", v), ("s", s)] + ([] if memory is None else [("memory", memory)])
        parts = [_as_row(name, value) for name, value in named]
        if len({part.dtype for part in parts}) > 1:
            parts = [part.astype(jnp.result_type(*parts)) for part in parts]
        self.q, self.v, self.s = parts[:3]
        self.memory = None if memory is None else parts[3]

    def __repr__(self) -> str:
        # Most states have no memory.
        return listed(self).replace(", memory=None", "")


def reached(states: State) -> Bool[Array, "..."]:
    """Which of some saved states a run reached: those of other times are NaN. NumPy's where it is known."""
    xp: Any = jnp if traced(states.q) else np
    return xp.isfinite(states.q).all(axis=-1)


def _as_row(name: str, value: Any) -> Array:
    # States are made inside traced programs too: a floating array passes without any operation.
    # The dtype of keys of `jax.random` has no kind.
    ready = isinstance(value, jax.Array) and getattr(value.dtype, "kind", "") == "f"
    row = value if ready else as_array(name, value)
    if not row.ndim:
        raise ValueError(f"argument {name} must have one axis or more, but was {shown(value)}")
    return row


_DOUBLE = np.dtype("float64")
_PRECISIONS = {np.dtype("float32"), _DOUBLE}


def check_shapes(states: State, form: "Form", name: str, axes: int) -> None:
    """Raise unless states have the lengths of a grasp's, one precision, and at most `axes` leading axes.

    A state of another grasp is noticed only here, and only by these lengths. If both grasps have the same
    lengths, only large residuals show it.
    """
    # Attributes of arrays instead of functions of JAX, each call of which takes 10 us.
    parts = (states.q, states.v, states.s)
    shapes = [getattr(value, "shape", ()) for value in parts]
    kinds, lead = {getattr(value, "dtype", None) for value in parts}, shapes[0][:-1]
    for part, shape, size in zip("qvs", shapes, form.counts, strict=True):
        if shape != (*lead, size) or len(lead) > axes:
            wanted = f"({size},) or (t, {size})" if axes else f"({size},)"
            raise ValueError(f"argument {name}.{part} must have shape {wanted}, but had {shape}")
    if states.memory is not None:
        _check_memory(states, form, f"{name}.memory")
        kinds |= {getattr(states.memory, "dtype", None)}
    check_not_cut(name, kinds)
    if len(kinds) > 1 or not kinds <= _PRECISIONS:
        raise ValueError(
            f"argument {name} must be of single or double precision throughout, "
            f"but was of {', '.join(sorted(map(str, kinds)))}"
        )


def check_not_cut(name: str, kinds: Collection[Any]) -> None:
    """Raise for numbers of double precision where JAX knows single precision only."""
    if _DOUBLE in kinds and not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise ValueError(
            f"argument {name} must be of single precision, as all is to JAX without x64, but was of double: "
            "put jax.config.update('jax_enable_x64', True) first"
        )


def _check_memory(states: State, form: "Form", name: str) -> None:
    """Raise unless the memory in states is one of the grasp's controller."""
    shape, wanted = getattr(states.memory, "shape", ()), (*states.q.shape[:-1], form.memory)
    if not form.memory:
        raise ValueError(f"argument {name} must be None for a controller without memory, but had {shape}")
    if shape != wanted:
        raise ValueError(f"argument {name} must have shape {wanted} or be None, but had {shape}")


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Leaves:
    """A `State` in which every number is a leaf of its own; block 0 is the object's, the others the fingers'.

    `s` holds the place of each contact: a number in the plane, two tuples of numbers in space. `memory` is
    empty where the controller has none, or where it is to begin with the controller's own.
    """

    q: Blocks
    v: Blocks
    s: tuple[Any, ...]
    memory: Scalars = ()


class Form(NamedTuple):
    """How many positions and velocities each body has, and the structure of all places; hashable.

    `memory` is how many numbers the controller's memory has. If the controller is `sampled`, the last of them
    is the time of the next sample.
    """

    positions: tuple[int, ...]
    sizes: tuple[int, ...]
    places: Any  # structure of the contacts' places
    memory: int = 0
    sampled: bool = False

    @property
    def counts(self) -> tuple[int, int, int]:
        """Lengths of q, v and s."""
        return sum(self.positions), sum(self.sizes), self.places.num_leaves


def to_leaves(state: State, form: Form) -> Leaves:
    """The arrays of a state as scalars."""
    blocks = split(state.q, form.positions), split(state.v, form.sizes)
    memory = () if state.memory is None else split(state.memory, (form.memory,))[0]
    return Leaves(*blocks, to_places(state.s, form), memory)


def to_places(s: Array, form: Form) -> tuple[Any, ...]:
    """Contact coordinates, shape (c,), as the places of the contacts."""
    return jax.tree.unflatten(form.places, scalars(s))


def split(array: Array, sizes: tuple[int, ...]) -> Blocks:
    """One array of shape (n,) as blocks of scalars."""
    rest = iter(scalars(array))
    return tuple(tuple(itertools.islice(rest, size)) for size in sizes)


def join(blocks: Blocks) -> Array:
    """Blocks of scalars as one array, stacked on the last axis."""
    # The last axis, because leaves of a batch or of a run have axes of their own in front.
    return jnp.stack([leaf for block in blocks for leaf in block], axis=-1)
