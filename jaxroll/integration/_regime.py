"""Where the model ends: margins after every step, and the code of the one that ran out.

A margin is positive while the model holds and passes through zero where it ends, so that the step-size
control can find the time of the event (see `_march`), and autodiff its derivative.
"""

from typing import Any

import diffrax
import jax.numpy as jnp
from jaxtyping import Array

from .._results import RESULTS
from .._types import Scalar
from ..contact import AbstractContact, clearance, TOLERANCE
from ..mechanics import Grasp, Instant, Leaves, poses

# Relative size below which a pivot, or a sum of curvatures, counts as zero.
_SINGULAR = 1e-9
# Points on each contour in the audit of penetration.
_SAMPLES = 64

# Codes by number, as the flow vector carries them: diffrax's loop takes none but its own.
_CODES = (
    RESULTS.successful,
    RESULTS.not_finite,
    RESULTS.singular_contact,
    RESULTS.contour_end,
    RESULTS.contact_lost,
    RESULTS.slipping,
    RESULTS.penetration,
)
_NOT_FINITE, _SINGULAR_CONTACT, _CONTOUR_END, _LOST, _SLIPPING, _PENETRATION = range(1, 7)
EVENTS = ("lift", "friction", "penetration")


def regime(grasp: Grasp, leaves: Leaves, instant: Instant, events: tuple[str, ...]) -> tuple[Scalar, Scalar]:
    """Smallest margin at one state, and the number of its code: 0 while it is not negative.

    Contour ends and singular contacts are always watched, what `events` names besides; a friction
    cone only where its contact has a coefficient.
    """
    places = zip(grasp.contacts, leaves.s, strict=True)
    margins = [(m, _CONTOUR_END) for c, place in places for m in c.ends(grasp.shapes(c), place)]
    margins += [(m - _SINGULAR, _SINGULAR_CONTACT) for m in _curvature_sums(grasp, instant)]
    margins.append((instant.line.schur.smallest_pivot - _SINGULAR, _SINGULAR_CONTACT))
    margins += _forces(grasp, instant, events)
    least, number = margins[0][0], jnp.asarray(margins[0][1])
    for margin, code in margins[1:]:
        number = jnp.where(margin < least, code, number)
        least = jnp.minimum(margin, least)
    return least, jnp.where(least < 0, number, 0)


def with_clearance(
    grasp: Grasp, leaves: Leaves, end: tuple[Scalar, Scalar], events: tuple[str, ...]
) -> tuple[Scalar, Scalar]:
    """Margin and code with the audit of penetration, where `events` asks for it: once a step."""
    least, number = end
    if "penetration" not in events:
        return end
    for margin in _clearances(grasp, leaves):
        number = jnp.where((margin < least) & (margin < 0), _PENETRATION, number)
        least = jnp.minimum(margin, least)
    return least, number


def coded(x: Array, margin: Scalar, number: Scalar) -> Array:
    """Margin and code as the flow vector carries them; values that are not finite come first."""
    number = jnp.where(jnp.all(jnp.isfinite(x)), number, _NOT_FINITE)
    return jnp.stack([margin, number.astype(x.dtype)])


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


def _each_contact(grasp: Grasp, instant: Instant) -> list[tuple[AbstractContact, tuple[Any, Any], Any]]:
    """Every contact with the poses of its fingertip and of the object, and its frames."""
    body, *tips = (motion.pose for motion in instant.motions)
    each = zip(grasp.contacts, instant.touching, strict=True)
    return [(c, (tips[c.finger], body), touching) for c, touching in each]


def _curvature_sums(grasp: Grasp, instant: Instant) -> list[Scalar]:
    """Relative sums of curvatures: a contact rolls while its own is positive."""
    return [c.curvature_margin(pair, t) for c, pair, t in _each_contact(grasp, instant)]


def _forces(grasp: Grasp, instant: Instant, events: tuple[str, ...]) -> list[tuple[Scalar, int]]:
    """Normal forces, and distances to the sides of the friction cones [N]."""
    margins = []
    for (contact, pair, touching), force in zip(_each_contact(grasp, instant), instant.forces, strict=True):
        lift, rubs = "lift" in events, "friction" in events and contact.friction is not None
        if not lift and not rubs:
            continue
        f, tangential = contact.split_force(pair, touching, force)
        if lift:
            margins.append((f, _LOST))
        if rubs:
            cone = contact.friction * f
            margins += [(cone - rubbing, _SLIPPING) for rubbing in contact.rubbing(tangential)]
    return margins


def _clearances(grasp: Grasp, leaves: Leaves) -> list[Scalar]:
    """How far every fingertip stays clear of the object [m]."""
    body, *tips = poses(grasp, leaves.q)
    faces = grasp.object.contours
    return [
        clearance((pose, body), finger.tip, faces, samples=_SAMPLES) + TOLERANCE
        for pose, finger in zip(tips, grasp.fingers, strict=True)
    ]
