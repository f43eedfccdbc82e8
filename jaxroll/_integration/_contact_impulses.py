r"""Contact impulses of the blows of a run (`loads.Impulse`), for runs that record contact forces.

A run has states just before its blows saved besides those that the caller asked for, and the contact
impulses are worked out from these once it is over: the loop of a run has no part of it.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._mechanics import Grasp, State, to_leaves
from .._motion import Multipliers, of_reached, split_forces, struck
from .._types import Scalar, Times
from ..loads import Impulse, impulses
from ._jumps import beside, grain


def times_before(grasp: Grasp, jumps: Array, begin: Scalar, end: Scalar) -> Float[Array, " blows"]:
    """Times just before each blow [s], kept within the run."""
    return jnp.clip(beside(jumps, jax.lax.stop_gradient(blow_times(grasp)), -1.0), begin, end)


def blow_times(grasp: Grasp) -> Float[Array, " blows"]:
    """When each blow on a grasp acts [s]."""
    return jnp.stack([blow.time for blow in impulses(grasp.load)])


def merged(saves: Times, more: Times) -> tuple[Times, Array, Array]:
    """Save times and others together, rising; and where each of both is among them."""
    order = jnp.argsort(jnp.concatenate([saves, more]))
    places = jnp.argsort(order)
    return jnp.concatenate([saves, more])[order], places[: saves.shape[0]], places[saves.shape[0] :]


def contact_impulses(grasp: Grasp, states: State, spans: tuple[Scalar, Scalar]) -> Multipliers:
    """Contact impulses [N s] of every blow from the states before them; NaN for one outside the run.

    `spans` are the times from which and up to which the run went.
    """
    blows, times = impulses(grasp.load), blow_times(grasp)
    near = 2.0 * grain(times)
    begin, end = spans
    # A run that the blow itself ended stands just before it.
    there = (times >= begin - near) & (times <= end + near)
    start = jax.tree.map(lambda rows: rows[0], states)
    missing = jax.tree.map(lambda rows: jnp.where(there[:, None], rows, jnp.nan), states)
    finite = jax.tree.map(lambda row: jnp.where(jnp.isfinite(row), row, 0.0), start)
    return of_reached(lambda rows: _each(grasp, blows, rows), missing, finite)


def _each(grasp: Grasp, blows: Sequence[Impulse], rows: State) -> Multipliers:
    """Contact impulses of each blow, with all others at the same time."""
    found = []
    for i, blow in enumerate(blows):
        same = [jnp.abs(other.time - blow.time) <= 2.0 * grain(blow.time) for other in blows]
        acting = [(other, jnp.where(at, 1.0, 0.0)) for other, at in zip(blows, same, strict=True)]
        state = jax.tree.map(lambda x, i=i: x[i], rows)
        done = struck(grasp, to_leaves(state, grasp.form), acting)
        poses = [motion.pose for motion in done.motions]
        found.append(split_forces(grasp, poses, done.touching, done.forces))
    return jax.tree.map(lambda *parts: jnp.stack(parts), *found)
