"""How a grasp bears at one state: what a run watches while it goes, contact by contact."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._mechanics import compiled, Grasp, State, to_leaves
from .._motion import evaluate, Index1, Multipliers, split_forces
from .._printing import listed
from .._types import Scalar


class Bearing(eqx.Module):
    """What must stay positive for the model to hold, at one state.

    Attributes:
        curvature: Shape (c,), relative sum of the curvatures at each contact.
        pivot: Smallest pivot of the Schur complement, relative; zero where contacts are redundant or
            an arm is straight.
        ends: Shape (c,), distance of each contact from the nearest end of an open contour [m]; infinite
            where there is none.
        multipliers: Contact forces.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"ends": "m"}

    curvature: Float[Array, " c"]
    pivot: Float[Array, ""]
    ends: Float[Array, " c"]
    multipliers: Multipliers


@compiled
def bearing(grasp: Grasp, t: Scalar, state: State) -> Bearing:
    """How a grasp bears at one time and state."""
    ready = grasp.prepared()
    leaves = to_leaves(state, ready.form)
    instant = evaluate(ready, t, leaves, Index1())
    frames = [motion.pose for motion in instant.motions]
    curvature, ends = [], []
    for contact, touching, place in zip(ready.contacts, instant.touching, leaves.s, strict=True):
        curvature.append(contact.curvature_margin((frames[1 + contact.finger], frames[0]), touching))
        margins = contact.ends(ready.shapes(contact), place)
        ends.append(jnp.min(jnp.stack([jnp.asarray(m) for m in margins])) if margins else jnp.inf)
    forces = split_forces(ready, frames, instant.touching, instant.forces)
    pivot = jnp.asarray(instant.line.schur.smallest_pivot)
    return Bearing(jnp.stack(curvature), pivot, jnp.stack([jnp.asarray(x) for x in ends]), forces)
