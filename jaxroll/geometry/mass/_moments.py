r"""Size, centre and second moments of a body, and what its mass and inertia are at a density.

Of a body $D$ with $d$ = 2 or 3 axes and outward normal $n$, the divergence theorem takes the integral of a
function $f$, homogeneous of degree $k$ about a point from which $r$ counts, to the boundary:

$$ \int_D f = \frac{1}{d + k} \oint f\, (r \cdot n), \qquad f = 1,\; r,\; r r^T. $$

It is the sum of the cones from that point to the pieces of the boundary. `_contour_moments`,
`_surface_moments`, `_level_moments` and `_mesh_moments` differ only in how they walk over the boundary.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array

from ..._xla import at_once

# A surface whose moments still change by more than this share at the last refinement is refused.
_ACCURATE = 1e-6


class Moments(NamedTuple):
    """Moments of a body of density one.

    Attributes:
        size: Area [m^2] or volume [m^3].
        centre: Of mass, shape (d,) [m].
        spread: Second moments about the centre, shape (d, d) [m^4 or m^5].
        error: Estimated relative error; zero where only rounding is left.
    """

    size: Array
    centre: Array
    spread: Array
    error: float = 0.0

    def placed(self, turn: Array, offset: Array) -> "Moments":
        """The moments of the body turned by a rotation matrix, then shifted."""
        return Moments(self.size, *_placed(self.centre, self.spread, turn, offset), self.error)


@at_once
def _placed(xp: Any, centre: Array, spread: Array, turn: Array, offset: Array) -> tuple[Array, Array]:
    return turn @ centre + offset, turn @ spread @ turn.T


def from_cones(arms: Any, cones: Any, about: Any) -> Moments:
    r"""Moments from a quadrature over the boundary; of NumPy's arrays or JAX's.

    Args:
        arms: Shape (n, d), points of the boundary from `about` [m].
        cones: Shape (n,), weight of each point times its $r \cdot n$ [m^2 or m^3].
        about: Shape (d,) [m].
    """
    axes = arms.shape[1]
    size = cones.sum() / axes
    first = (cones[:, None] * arms).sum(axis=0) / (axes + 1)
    second = (arms.T * cones[None, :]) @ arms / (axes + 2)
    return centred(size, first, second, about)


def centred(size: Any, first: Any, second: Any, about: Any) -> Moments:
    """Moments about the centre, from those about another point."""
    shift = first / size
    return Moments(size, about + shift, second - shift[:, None] * first[None, :])


@at_once
def inertia_of(xp: Any, spread: Any, density: Any) -> Any:
    """Inertia about the centre: in the plane a number [kg m^2], in space a matrix in the body's axes."""
    if spread.shape[0] == 2:
        return density * xp.trace(spread)
    return density * (xp.trace(spread) * xp.eye(3, dtype=spread.dtype) - spread)


def difference(one: Moments, other: Moments) -> float:
    """Largest difference of two bodies' moments, relative to their sizes."""
    volume = abs(float(one.size)) + abs(float(other.size)) + 1e-300
    extent = math.sqrt(abs(float(np.trace(one.spread))) / volume) + 1e-100
    parts = (
        abs(float(one.size) - float(other.size)) / volume,
        np.abs(np.asarray(one.centre) - np.asarray(other.centre)).max() / extent,
        np.abs(np.asarray(one.spread) - np.asarray(other.spread)).max() / (volume * extent**2),
    )
    return float(max(parts))


def checked(found: Moments | None, change: float, surface: Any) -> Moments:
    """Moments of a surface, with `change` as their estimated error; raise if they are not those of a body."""
    kind = type(surface).__name__
    if found is None or not change <= _ACCURATE:
        raise ValueError(
            f"argument shape must be smooth and without parts too fine to integrate, but the moments of this "
            f"{kind} still change by {change:.1e} of themselves"
        )
    if not float(found.size) > 0.0:
        raise ValueError(
            f"argument shape must have its normal outward, but the volume in this {kind} was "
            f"{float(found.size):.3g} m^3"
        )
    return found._replace(error=change)
