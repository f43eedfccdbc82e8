"""A check of a caller's own contact that needs a closed state: does its place move without slipping?

Its rows are the gap's derivative at a frozen place (`contact._from_gap`). That is the whole derivative only
if the gap does not change as the place alone moves; a contact that breaks this would be held to other motions
than its gap says. `simulate` and `vector_field` ask before a run of a grasp that has some.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._mechanics import compiled, Grasp, State, to_leaves
from .._results import computed_at_once, traced
from ._equations import world_poses
from ._quantities import closed_within, residuals_at, worst

# Largest share of its terms by which a gap may change, in double precision; a wrong sign gives 1.
_ROLLS = 1e-6
_ROLLS_SINGLE = 1e-3


def check_rolling(grasp: Grasp, state: State) -> None:
    """Raise for a contact of a caller's own whose gap changes as its place alone moves, at a closed state."""
    if traced((grasp, state)):
        return
    with computed_at_once():
        shares, off = map(np.asarray, _slips(grasp, state))
    if not off <= closed_within(off.dtype):
        return  # the state is off the constraints, for which the run has its own message
    allowed = _ROLLS if shares.dtype == np.float64 else _ROLLS_SINGLE
    for i in grasp.own_contacts:
        if not shares[i] <= allowed:
            raise ValueError(
                f"argument grasp.contacts[{i}] must have a gap that rests as its place alone moves, "
                f"but it changes by {shares[i]:.2g} of its terms"
            )


@compiled
def _slips(grasp: Grasp, state: State) -> tuple[Array, Array]:
    """`slip` of every contact, and how far the state is off the constraints."""
    ready = grasp.prepared()
    leaves = to_leaves(state, ready.form)
    body, *tips = world_poses(ready, leaves.q)
    each = zip(ready.contacts, leaves.s, strict=True)
    found = [c.slip(ready.shapes(c), place, (tips[c.finger], body)) for c, place in each]
    return jnp.stack([jnp.asarray(share) for share in found]), worst(residuals_at(ready, state))
