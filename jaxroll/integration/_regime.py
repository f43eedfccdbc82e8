"""Checks after every accepted step that end a run with a code instead of a wrong answer."""

import diffrax
import jax.numpy as jnp
from jaxtyping import Array

from .._results import RESULTS
from .._types import Scalar
from ..mechanics import Grasp, Instant, Leaves

# Relative size below which a pivot, or a sum of curvatures, counts as zero.
_SINGULAR = 1e-9

# Codes by number, as the flow vector carries them: diffrax's loop takes none but its own.
_CODES = (
    RESULTS.successful,
    RESULTS.contour_end,
    RESULTS.singular_contact,
    RESULTS.not_finite,
)


def regime(grasp: Grasp, leaves: Leaves, instant: Instant, x: Array) -> Scalar:
    """Number of the code at one step's end: 0, or why the model no longer holds there."""
    code = jnp.where(_ended(grasp, leaves), 1, 0)
    code = jnp.where(_singular(grasp, instant), 2, code)
    return jnp.where(jnp.isfinite(jnp.sum(x)), code, 3)


def decode(number: Scalar, loop: diffrax.RESULTS) -> RESULTS:
    """The result code of a run: from the flow vector's number, else from diffrax's loop."""
    result = RESULTS.where(loop == diffrax.RESULTS.successful, RESULTS.successful, RESULTS.solver_failed)
    steps = loop == diffrax.RESULTS.max_steps_reached
    result = RESULTS.where(steps, RESULTS.max_steps_reached, result)
    collapsed = loop == diffrax.RESULTS.dt_min_reached
    result = RESULTS.where(collapsed, RESULTS.step_collapsed, result)
    for i, code in enumerate(_CODES[1:], start=1):
        result = RESULTS.where(number == i, code, result)
    return result


def _ended(grasp: Grasp, leaves: Leaves) -> Scalar:
    """Whether a contact point left an open contour; nothing is computed where no contour has ends."""
    ended: Scalar = jnp.array(False)
    for contact, sigma in zip(grasp.contacts, leaves.s, strict=True):
        tip, face = grasp.contours(contact)
        for contour, s in ((tip, contact.s_tip + sigma), (face, contact.s_object - sigma)):
            ends = None if contour.closed else contour.domain()
            if ends is not None:
                ended = ended | (s < ends[0]) | (s > ends[1])
    return ended


def _singular(grasp: Grasp, instant: Instant) -> Scalar:
    singular = instant.line.schur.smallest_pivot < _SINGULAR
    for touching in instant.touching:
        singular = singular | ~_rolls(touching.tip.curvature, touching.object.curvature)
    return singular


def _rolls(tip: Scalar, face: Scalar) -> Scalar:
    return tip + face > _SINGULAR * (jnp.abs(tip) + jnp.abs(face))
