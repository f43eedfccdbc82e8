"""What a run integrates: one vector that holds the state and its own derivative.

`y = [x, x', margin, code]`, with `x = [q, v, s]`, then a controller's memory, if it has one, and where energy
is recorded the work done; `margin` says how far the model still holds and `code` is positive once it does not
(`_events`). `slope` computes `x'` with `_motion`. Since the derivative is carried along, a step is a pure map
from `y` to `y` even for methods whose first stage is the last one of the step before; `_derivative` needs
that. One vector, not a tuple of scalars, because every leaf of a loop's state costs XLA a kernel per step
(measured: 34 against 9 us a step); for the same reason the grasp's numbers are a `_bundle`.
"""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._linalg import scalars
from .._mechanics import Blocks, Form, Grasp, Leaves, State
from .._motion import evaluate, Formulation, Instant, power
from .._types import Scalar

Flow = Float[Array, " flow"]


class Layout(NamedTuple):
    """Where everything is in the vector; hashable. `audited`: whether the work done is a part of `x`."""

    form: Form
    audited: bool
    width: int  # length of `x`

    @property
    def margin(self) -> int:
        """Where the margin is in `y`."""
        return 2 * self.width

    @property
    def due(self) -> int:
        """Where the time of the next sample is in `x`, of a sampled controller."""
        return sum(self.form.counts) + self.form.memory - 1

    def controlled(self, error: Array) -> Array:
        """The part of `x` that error control looks at: q, v, a memory that is integrated, and work.

        Contact coordinates follow from q by tangency, and the derivative is not integrated.
        """
        positions, velocities, places = self.form.counts
        moving = positions + velocities
        # What samples change is at rest between them.
        idle = places + (self.form.memory if self.form.sampled else 0)
        parts = [error[:moving], error[moving + idle : self.width]]
        return jnp.concatenate(parts) if self.width > moving + idle else parts[0]


def layout(grasp: Grasp, audited: bool) -> Layout:
    """The layout of a grasp's flow vector."""
    form = grasp.form
    return Layout(form, audited, sum(form.counts) + form.memory + int(audited))


def pack(leaves: Leaves, work: Scalar | None) -> Array:
    """The vector x of a state in scalars, and of the work done [J] where that is audited."""
    flat = [leaf for blocks in (leaves.q, leaves.v) for block in blocks for leaf in block]
    flat += [*jax.tree.leaves(leaves.s), *leaves.memory]
    if work is not None:
        flat.append(work)
    return jnp.stack(flat)


def unpack(lay: Layout, x: Array) -> tuple[Leaves, Scalar | None]:
    """State and work of a vector x, or of a y, which begins with x."""
    rest = iter(scalars(x[: lay.width]))

    def blocks(sizes: tuple[int, ...]) -> Blocks:
        return tuple(tuple(itertools.islice(rest, size)) for size in sizes)

    form = lay.form
    q, v = blocks(form.positions), blocks(form.sizes)
    s = jax.tree.unflatten(form.places, tuple(itertools.islice(rest, form.places.num_leaves)))
    memory = tuple(itertools.islice(rest, form.memory))
    return Leaves(q, v, s, memory), next(rest) if lay.audited else None


def slope(
    lay: Layout, grasp: Grasp, t: Scalar, x: Array, *, formulation: Formulation
) -> tuple[Array, Instant]:
    """Time derivative of x, which is the right-hand side of a run, and the whole `Instant` it comes from."""
    leaves, _ = unpack(lay, x)
    instant = evaluate(grasp, t, leaves, formulation)
    gained = power(grasp, t, leaves, instant) if lay.audited else None
    return pack(instant.rates, gained), instant


def states_of(lay: Layout, y: Array) -> State:
    """The state in a vector x or y, or in a stack of them along leading axes."""
    positions, velocities, places = lay.form.counts
    moving = positions + velocities
    end = moving + places
    memory = y[..., end : end + lay.form.memory] if lay.form.memory else None
    return State(y[..., :positions], y[..., positions:moving], y[..., moving:end], memory)


def vector_of(lay: Layout, state: State) -> Array:
    """The vector y of a state at the start: no work done yet, derivative, margin and code not yet known."""
    unknown = int(lay.audited) + lay.width + 2
    memory = [] if state.memory is None else [state.memory]
    return jnp.concatenate([state.q, state.v, state.s, *memory, jnp.zeros(unknown, state.q.dtype)])
