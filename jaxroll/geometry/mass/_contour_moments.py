r"""Area, centre and second moments of the body within a closed contour, by Green's theorem.

$r \cdot n\,\mathrm{d}s = r \times \mathrm{d}c$ is integrated piece by piece with Gauss-Legendre's rule.
$\mathrm{d}c$ is the derivative of the contour's point and not its unit tangent, so that the integral is that
of the closed curve as it is evaluated, whatever the error of its table. Circles and ellipses have closed
forms.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._results import concrete
from ..._xla import at_once, quickly
from .._tabled import tabled
from ..contours import AbstractContour, Circle, Ellipse, Moved
from ._moments import from_cones, Moments

# Pieces of a contour without a table, and fewest of any.
_PIECES = 1024
# Points on each piece: a table's quintics are integrated exactly for the area, the second moments to the
# twelfth power of a cell's share of the length.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)


def contour_moments(contour: AbstractContour) -> Moments:
    """Moments of the body within a closed contour; differentiable in all of its numbers."""
    if not contour.closed:
        kind = type(contour).__name__
        raise ValueError(f"argument shape must be closed to have an inside, but was an open {kind}")
    # Only the outermost placement is taken off: what is inside may be of a caller's own class.
    if isinstance(contour, Moved):
        pose = contour.placed()
        turn = jnp.stack([jnp.stack([pose.cos, -pose.sin]), jnp.stack([pose.sin, pose.cos])])
        return contour_moments(contour.contour).placed(turn, contour.offset)
    if isinstance(contour, Circle):
        return _ellipse(contour.radius, contour.radius)
    if isinstance(contour, Ellipse):
        return _ellipse(contour.a, contour.b)
    cells = int(getattr(contour, "cells", _PIECES))
    found = _integrated(tabled(contour), cells * max(1, -(-_PIECES // cells)))
    size = concrete(found.size)
    if size is not None and not size > 0:
        kind = type(contour).__name__
        raise ValueError(
            f"argument shape must run counter-clockwise round its body, but the area in this {kind} was "
            f"{size:.3g} m^2"
        )
    return found


def _ellipse(a: Array, b: Array) -> Moments:
    return Moments(*_of_ellipse(a, b))


@at_once
def _of_ellipse(xp: Any, a: Array, b: Array) -> tuple[Array, Array, Array]:
    """Size, centre and spread."""
    size = math.pi * a * b
    return size, xp.zeros(2, size.dtype), xp.diag(size * 0.25 * xp.stack([a * a, b * b]))


@quickly
def _integrated(contour: AbstractContour, pieces: int) -> Moments:
    ready = contour.prepared()
    ends = ready.domain()
    assert ends is not None  # it is closed
    step = (ends[1] - ends[0]) / pieces
    # Places in units of a piece, and what each of them weighs.
    places = (np.arange(pieces)[:, None] + 0.5 * (1.0 + _NODES)[None, :]).ravel()
    weights = np.tile(0.5 * _WEIGHTS, pieces)

    def walked(place: Array) -> Any:
        curve = lambda x: ready.curve(ends[0] + step * x).array()  # noqa: E731
        return jax.jvp(curve, (place,), (jnp.ones_like(place),))

    points, rates = jax.vmap(walked)(jnp.asarray(places, jnp.result_type(step)))
    about = jax.lax.stop_gradient(jnp.mean(points, axis=0))
    arms = points - about[None, :]
    cones = weights * (arms[:, 0] * rates[:, 1] - arms[:, 1] * rates[:, 0])
    return from_cones(arms, cones, about)
