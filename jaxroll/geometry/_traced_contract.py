"""The contract of a caller's own shapes, asked of numbers that JAX traces.

`_contract` refuses a shape that is not what the equations of motion take for granted, by a sentence that
names what is wrong. Inside `jax.jit`, `jax.vmap` and a derivative its numbers have no values yet: what is
measured is the same, at fewer places, and the answer is an array: `_mechanics` puts NaN into a grasp whose
shapes fail, whatever is computed of it, and a run has a code for it.
"""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._results import is_foreign
from ._contract import (
    ALLOWED,
    APART,
    frames_at,
    inconsistency,
    measured_along,
    members,
    NEAREST,
    RANGE,
    SURFACE,
    tables,
    TURNS,
)
from .contours import AbstractContour, unevenness
from .surfaces import AbstractSurface

_PLACES = 128  # along a contour


def keeps_contract(shapes: Any) -> Array:
    """Whether all shapes of a caller's own class, prepared, are what contours and surfaces must be."""
    held = [jnp.array(True)]
    for part in filter(is_foreign, members(shapes)):
        still = jax.tree.map(lambda x: jax.lax.stop_gradient(x) if eqx.is_inexact_array(x) else x, part)
        held.append(_contour_holds(still) if isinstance(part, AbstractContour) else _surface_holds(still))
    return jnp.all(jnp.stack(held))


def _contour_holds(contour: AbstractContour) -> Array:
    """Speed one, the frame of the curve, and ends that meet where it claims to be closed."""
    domain = contour.domain()
    if domain is None:
        # An endless contour is looked at within a finger's length, on either side of its zero.
        places = jnp.asarray(RANGE * (2.0 * (np.arange(_PLACES) + 0.5) / _PLACES - 1.0))
        return _follows(contour, places)
    low, high = (jnp.asarray(end, float) for end in domain)
    holds = _follows(contour, low + (high - low) * (np.arange(_PLACES) + 0.5) / _PLACES)
    return holds & _comes_back(contour, low, high - low) if contour.closed else holds


def _follows(contour: AbstractContour, places: Array) -> Array:
    """Whether speed and frame at these places are those of the curve by arclength (`_contract._along`)."""
    point, tangent, own, place, rate, curvature = measured_along(contour, places)
    slack = 4.0 * functools.reduce(jnp.maximum, map(unevenness, tables(contour)), 0.0)
    first, second = (allowed + slack for allowed in ALLOWED[np.dtype(point.dtype)])
    apart = jnp.max(jnp.abs(point - place), axis=1) / (jnp.max(jnp.abs(place), axis=1) + NEAREST)
    extent = jnp.maximum(places[-1] - places[0], NEAREST)
    scale = jnp.maximum(jnp.maximum(jnp.max(jnp.abs(curvature)), jnp.max(jnp.abs(own))), 1.0 / extent)
    # What is not finite compares as false.
    return (
        jnp.all(apart <= APART)
        & jnp.all(jnp.abs(jnp.hypot(rate[:, 0], rate[:, 1]) - 1.0) <= first)
        & jnp.all(jnp.abs(tangent - rate) <= 10.0 * first)
        & jnp.all(jnp.abs(own - curvature) <= 10.0 * second * scale)
    )


def _comes_back(contour: AbstractContour, low: Array, length: Array) -> Array:
    """Whether frames a length later and earlier are the same (`_contract._open`)."""
    places = low + length * ((np.arange(TURNS) * 0.6180339887498949) % 1.0)
    here, later, before = (frames_at(contour, places + k * length) for k in (0.0, 1.0, -1.0))
    first, second = ALLOWED[np.dtype(here.dtype)]
    size = jnp.max(jnp.abs(here[:2])) + length
    bend = 10.0 * second / first * (jnp.max(jnp.abs(here[4])) + 1.0 / length)
    allowed = 100.0 * first * jnp.stack([size, size, jnp.ones_like(size), jnp.ones_like(size), bend])
    off = jnp.maximum(jnp.abs(later - here), jnp.abs(before - here))
    return jnp.all(off <= allowed[:, None])


def _surface_holds(surface: AbstractSurface) -> Array:
    """A unit normal, its derivative as shape operator, periods that close (`_contract._surface_fault`)."""
    off = inconsistency(surface)
    allowed, seam, there = SURFACE[np.dtype(off["there"].dtype)], off["seam"], off["there"] > 0
    errors = jnp.stack([values for name, values in off.items() if name not in ("seam", "there")])
    seen = there & jnp.all(jnp.isfinite(errors), axis=0)
    return jnp.any(seen) & (seam <= 10.0 * allowed) & jnp.all(jnp.where(seen, errors, 0.0) <= allowed)
