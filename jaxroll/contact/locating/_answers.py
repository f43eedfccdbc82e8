"""What `contact.locate` and `contact.locate_surfaces` return: the closest points, and further local minima.

Arrays have fixed shapes under `jit`, so that minima that were not found are masked (`there`), not left out.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..._printing import listed
from ..._results import RESULTS


class LocalMinima(eqx.Module):
    """Local minima of the signed distance besides the lowest, lowest first.

    Attributes:
        gap: Signed distances [m]; infinite where there are no more.
        s: Arclengths on both contours [m]; zero where there are no more.
        there: Which entries hold a minimum.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"gap": "m", "s": "m"}

    gap: Float[Array, " candidates"]
    s: Float[Array, "candidates 2"]
    there: Bool[Array, " candidates"]

    @property
    def count(self) -> Int[Array, ""]:
        """How many there are."""
        return jnp.sum(self.there, axis=-1)


class Location(eqx.Module):
    """The closest points of two contours.

    Attributes:
        gap: Signed distance [m], negative where the contours overlap.
        s: Arclengths of the closest points on `a` and on `b` [m].
        points: Both points in the world [m], one row each.
        normal: Outward normal of `b` at its point, in the world.
        residual: How far the conditions of stationarity are from zero [m].
        unique: Whether no other local minimum has this gap.
        others: Further local minima: second contacts.
        result: Code of `jaxroll.RESULTS`.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"gap": "m", "s": "m", "points": "m", "residual": "m"}

    gap: Float[Array, ""]
    s: Float[Array, "2"]
    points: Float[Array, "2 2"]
    normal: Float[Array, "2"]
    residual: Float[Array, ""]
    unique: Bool[Array, ""]
    others: LocalMinima
    result: RESULTS

    @property
    def penetrating(self) -> Bool[Array, ""]:
        """Whether the contours overlap."""
        return self.gap < 0.0


class SurfaceMinima(eqx.Module):
    """Local minima of the signed distance of two surfaces besides the lowest, lowest first.

    Attributes:
        gap: Signed distances [m]; infinite where there are no more.
        at_a: Coordinates on `a`.
        at_b: Coordinates on `b`.
        there: Which entries hold a minimum.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"gap": "m"}

    gap: Float[Array, " candidates"]
    at_a: Float[Array, "candidates coordinates_a"]
    at_b: Float[Array, "candidates coordinates_b"]
    there: Bool[Array, " candidates"]

    @property
    def count(self) -> Int[Array, ""]:
        """How many there are."""
        return jnp.sum(self.there, axis=-1)


class SurfaceLocation(eqx.Module):
    """The closest points of two surfaces.

    Attributes:
        gap: Signed distance [m], negative where the surfaces overlap.
        at_a: Coordinates of the closest point on `a`.
        at_b: Coordinates of the closest point on `b`.
        points: Both points in the world [m], one row each.
        normal: Outward normal of `b` at its point, in the world.
        residual: How far the conditions are from zero: the length of the sum of both normals, or that of the
            arm's part across the normal, divided by the surfaces' size plus the gap, whichever is larger.
        unique: Whether no other local minimum has this gap.
        others: Further local minima: second contacts.
        result: Code of `jaxroll.RESULTS`.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"gap": "m", "points": "m"}

    gap: Float[Array, ""]
    at_a: Float[Array, " coordinates_a"]
    at_b: Float[Array, " coordinates_b"]
    points: Float[Array, "2 3"]
    normal: Float[Array, "3"]
    residual: Float[Array, ""]
    unique: Bool[Array, ""]
    others: SurfaceMinima
    result: RESULTS

    @property
    def penetrating(self) -> Bool[Array, ""]:
        """Whether the surfaces overlap."""
        return self.gap < 0.0
