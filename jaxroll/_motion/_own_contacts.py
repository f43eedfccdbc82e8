"""A check of a caller's own contact that needs a closed state: does its place move without slipping?

Its rows are the gap's derivative at a frozen place (`contact._from_gap`). That is the whole derivative only
if the gap does not change as the place alone moves; a contact that breaks this would be held to other motions
than its gap says. `simulate` and `vector_field` ask before a run of a grasp that has some; `simulate` asks
again along the run, as shapes may fit each other at the start alone.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._mechanics import compiled, Grasp, State, to_leaves
from .._results import computed_at_once, traced
from .._types import ByPrecision
from ._equations import world_poses
from ._quantities import closed_within, residuals_at, worst

# Largest share of its terms by which a gap may change; a wrong sign gives 1.
_ROLLS = ByPrecision(1e-6, 1e-3)


def check_rolling(grasp: Grasp, state: State) -> None:
    """Raise for a contact of a caller's own whose gap changes as its place alone moves, at a closed state."""
    if traced((grasp, state)):
        return
    with computed_at_once():
        shares, off = map(np.asarray, _slips(grasp, state))
    if not off <= closed_within(off.dtype):
        return  # the state is off the constraints, for which the run has its own message
    for i in grasp.own_contacts:
        if not shares[i] <= _ROLLS.of(shares):
            raise ValueError(
                f"argument grasp.contacts[{i}] must have a gap that rests as its place alone moves, "
                f"but it changes by {shares[i]:.2g} of its terms"
            )


def not_rolling(grasp: Grasp, states: State) -> Array:
    """Which contact of a caller's own does not roll at some of these states, which lie on the constraints.

    -1 if all do. The grasp is prepared. States that a run did not reach are NaN, and tell nothing.
    """
    own = np.array(grasp.own_contacts)
    shares = jax.vmap(lambda state: _slips_at(grasp, state))(states)[:, own]
    slips = jnp.any(shares > _ROLLS.of(shares), axis=0)
    return jnp.where(jnp.any(slips), jnp.asarray(own)[jnp.argmax(slips)], -1)


@compiled
def _slips(grasp: Grasp, state: State) -> tuple[Array, Array]:
    """`slip` of every contact, and how far the state is off the constraints."""
    ready = grasp.prepared()
    return _slips_at(ready, state), worst(residuals_at(ready, state))


def _slips_at(grasp: Grasp, state: State) -> Array:
    """`slip` of every contact of a prepared grasp."""
    leaves = to_leaves(state, grasp.form)
    body, *tips = world_poses(grasp, leaves.q)
    each = zip(grasp.contacts, leaves.s, strict=True)
    found = [c.slip(grasp.shapes(c), place, (tips[c.finger], body)) for c, place in each]
    return jnp.stack([jnp.asarray(share) for share in found])
