"""How a grasp bears at one state: the margins that a run watches, contact by contact, and the contact forces.

A run (`_integration/_events`) keeps only the smallest margin and its number. Here all of them are evaluated
at one state, from one evaluation of the equations of motion, so that `why` can name the contact at fault.
"""

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
        curvature: Shape (c,), sum of both curvatures at each contact over the sum of their sizes; in space
            the determinant of the sum of both shape operators, relative to their squares.
        pivot: Smallest pivot of the Schur complement $A M^{-1} A^T$ over its largest diagonal entry; zero
            where contacts are redundant or an arm is straight.
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
    """How a grasp bears at one time [s] and state."""
    ready = grasp.prepared()
    leaves = to_leaves(state, ready.form)
    instant = evaluate(ready, t, leaves, Index1())
    # Poses: first the object, then the fingers.
    frames = [motion.pose for motion in instant.motions]
    curvature, ends = [], []
    for contact, touching, place in zip(ready.contacts, instant.touching, leaves.s, strict=True):
        shapes, poses = ready.shapes(contact), (frames[1 + contact.finger], frames[0])
        curvature.append(contact.curvature_margin(shapes, place, poses, touching))
        # Empty for contours without ends: closed or endless ones.
        margins = contact.ends(shapes, place)
        ends.append(jnp.min(jnp.stack([jnp.asarray(m) for m in margins])) if margins else jnp.inf)
    forces = split_forces(ready, frames, instant.touching, instant.forces)
    pivot = jnp.asarray(instant.line.schur.smallest_pivot)
    return Bearing(jnp.stack(curvature), pivot, jnp.stack([jnp.asarray(x) for x in ends]), forces)
