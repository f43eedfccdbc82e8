"""The contract of a caller's own shapes, asked of numbers that JAX traces.

`_contract` refuses a shape that is not what the equations of motion take for granted, by a sentence that
names what is wrong. Inside `jax.jit`, `jax.vmap` and a derivative its numbers have no values yet: the errors
are the same (`_contract_errors`), at fewer places, and the answer is an array: `_mechanics` puts NaN into a
grasp whose shapes fail, whatever is computed of it, and a run has a code for it.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._results import is_foreign
from ._contract import members
from ._contract_errors import contour_a_turn_later, contour_along, RANGE, surface_off
from .contours import AbstractContour

_PLACES = 128  # along a contour


def keeps_contract(shapes: Any) -> Array:
    """Whether all shapes of a caller's own class, prepared, are what contours and surfaces must be."""
    held = [jnp.array(True)]
    for part in filter(is_foreign, members(shapes)):
        still = jax.tree.map(lambda x: jax.lax.stop_gradient(x) if eqx.is_inexact_array(x) else x, part)
        errors = _contour_errors(still) if isinstance(part, AbstractContour) else surface_off(still)
        # What is not finite compares as false.
        held += [jnp.all(off <= 1.0) for off in jax.tree.leaves(errors)]
    return jnp.all(jnp.stack(held))


def _contour_errors(contour: AbstractContour) -> list[Any]:
    """Errors of speed, of the frame, and of ends that meet where it claims to be closed."""
    domain = contour.domain()
    if domain is None:
        # An endless contour is looked at within a finger's length, on either side of its zero.
        places = jnp.asarray(RANGE * (2.0 * (np.arange(_PLACES) + 0.5) / _PLACES - 1.0))
        return [contour_along(contour, places).off]
    low, high = (jnp.asarray(end, float) for end in domain)
    off = contour_along(contour, low + (high - low) * (np.arange(_PLACES) + 0.5) / _PLACES).off
    return [off, contour_a_turn_later(contour, low, high - low).off] if contour.closed else [off]
