"""Where a closed contour reaches farthest in a direction: there a finger or a plate faces it."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import Vec2
from .._results import shown
from .._xla import quickly
from ..geometry import AbstractContour, check_contour, tabled

# It is sought first among so many places, then between the neighbours of the best one.
_PLACES, _HALVINGS = 256, 60
# Heights over the length of the contour, and slopes, that count as rounding, in machine epsilons.
_ROUNDING = 64.0


def facing_place(name: str, contour: AbstractContour, angle: float) -> Any:
    """Arclength at which a closed contour reaches farthest in a direction [rad]."""
    if not contour.closed:
        what = "have two faces or one closed contour" if name == "object" else "be a closed contour"
        raise ValueError(f"argument {name} must {what}, but had {shown(contour)}")
    check_contour(name, contour)
    return _farthest(tabled(contour), jnp.array([np.cos(angle), np.sin(angle)]))


@quickly
def _farthest(contour: AbstractContour, along: Array) -> Array:
    r"""Arclength [m] at which a closed contour reaches farthest along a unit vector d.

    On a straight side that is its middle. The search is not differentiated: with the last step, one of
    Newton's method, the arclength moves as the contour does.
    """
    ready, still = contour.prepared(), jax.lax.stop_gradient(contour).prepared()
    ends = still.domain()
    assert ends is not None  # a closed contour has a length
    start, length = ends[0], ends[1] - ends[0]
    share = jnp.arange(_PLACES, dtype=along.dtype) / _PLACES
    heights = still.frame(start + length * share).point.array() @ along
    rounding = _ROUNDING * jnp.finfo(heights.dtype).eps
    # Places as high as the best one lie on a straight side: counted from there, the shorter way round.
    best = share[jnp.argmax(heights)]
    level = heights >= jnp.max(heights) - rounding * length
    apart = (share - best + 0.5) % 1.0 - 0.5
    best = best + jnp.sum(jnp.where(level, apart, 0.0)) / jnp.sum(level)
    s, cell = start + length * best, length / _PLACES
    slope = functools.partial(_slope, way=Vec2(along[0], along[1]), length=length)

    def nearer(_: Any, at: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        s, low, high = at
        rise, step = slope(still, s)
        low, high = jnp.where(rise >= -rounding, s, low), jnp.where(rise <= rounding, s, high)
        inside = (low < s + step) & (s + step < high) & (step != 0.0)
        return jnp.where(inside, s + step, 0.5 * (low + high)), low, high

    s = jax.lax.fori_loop(0, _HALVINGS, nearer, (s, s - cell, s + cell))[0]
    return s + slope(ready, s)[1]


def _slope(contour: AbstractContour, s: Array, *, way: Vec2, length: Array) -> tuple[Array, Array]:
    r"""$t(s) \cdot d$, and Newton's step [m] to where it is zero; none where that would be a whole round.

    Its derivative is $\kappa\, n \cdot d$ with n to the left: zero where the contour is straight.
    """
    frame = contour.frame(s)
    rise, bend = frame.tangent.dot(way), frame.curvature * frame.tangent.right().dot(way)
    curved = jnp.abs(rise) < length * bend
    return rise, jnp.where(curved, rise / jnp.where(curved, bend, 1.0), 0.0)
