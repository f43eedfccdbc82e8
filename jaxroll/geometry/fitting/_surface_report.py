"""What `fit_surface` gives back: the surface, its points, and the report."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from ..._results import as_floats, concrete
from ..._types import Given
from ..surfaces import SplineSurface

_AROUND = 5  # points by whose median distance a place is judged: noise alone must not condemn it


class Region(NamedTuple):
    """A part of a fitted surface not to be touched.

    Attributes:
        centre: Its middle [m].
        radius: Of a ball about the middle that holds it [m].
        area: [m^2].
        reason: "no data", or "rounded off" where the data are farther away than the report's tolerance.
    """

    centre: tuple[float, float, float]
    radius: float
    area: float
    reason: str


@dataclass(frozen=True)
class SurfaceReport:
    """How a surface was made of points; prints as a table.

    Attributes:
        points: Number of points used.
        area: Of the surface, as the points cover it [m^2].
        smoothing: Wavelength [m] of the wiggles that were halved.
        cells: Numbers of cells of the grid.
        step: Width of a cell [m].
        rms: Root mean square distance of the points from the surface [m].
        largest: Largest such distance [m].
        normals: Root mean square and largest angle to the given normals [rad]; None without.
        curvature: Smallest and largest principal curvature [1/m]: at the points, or with `smallest_radius`
            all over the surface.
        smoothness: Continuous derivatives of the surface.
        verdict: In a sentence, whether the surface can be trusted, and where not.
        doubts: What speaks against the surface, in clauses; empty of one to be trusted. With
            `smallest_radius` such a surface is refused instead.
        smallest_radius: The radius of curvature that was asked for [m]; None if none was.
        rejected: Number of points left out, because they lay apart from all others.
        kept: Root mean square and largest distance [m] from the surface of those points that balls of the
            smallest radius can touch from inside and outside: the data's own radius is as large. None
            without such points, or without `smallest_radius`.
        rounded: The same of all other points.
        rounded_share: Their share of the points.
        uncovered: Share of the surface's area that is farther than `reach` from any point.
        reversed: Share of the points whose normals are more than 90 degrees from the surface's, where a ball
            of the smallest radius fits.
        regions: Parts not to be touched, the largest first, at most eight.
        reach: How far [m] a place may be from the points.
        tolerance: How far [m] a point may be from the surface for a place beside it to be trusted.
    """

    points: int
    area: float
    smoothing: float
    cells: tuple[int, int, int]
    step: float
    rms: float
    largest: float
    normals: tuple[float, float] | None
    curvature: tuple[float, float]
    smoothness: float
    verdict: str = ""
    doubts: tuple[str, ...] = ()
    smallest_radius: float | None = None
    rejected: int = 0
    kept: tuple[float, float] | None = None
    rounded: tuple[float, float] | None = None
    rounded_share: float = 0.0
    uncovered: float = 0.0
    reversed: float = 0.0
    regions: tuple[Region, ...] = ()
    reach: float = math.inf
    tolerance: float = math.inf

    def __str__(self) -> str:
        rows = {
            "points": f"{self.points} on {1e4 * self.area:.4g} cm^2, {self.rejected} rejected",
            "smoothing": f"wavelength {1e3 * self.smoothing:.4g} mm",
            "grid": f"{' x '.join(map(str, self.cells))} cells of {1e3 * self.step:.3g} mm",
            "distance of points": _distances((self.rms, self.largest)),
            "principal curvature": f"{self.curvature[0]:.4g} to {self.curvature[1]:.4g} 1/m",
            "smoothness": f"{self.smoothness:g} continuous derivatives",
        }
        if self.normals is not None:
            mean, most = (math.degrees(x) for x in self.normals)
            rows["angle to normals"] = f"{mean:.3g} deg rms, {most:.3g} deg at most"
        if self.kept is not None:
            rows["where a ball fits"] = _distances(self.kept)
        if self.rounded is not None:
            share = 100.0 * self.rounded_share
            rows["where none fits"] = f"{_distances(self.rounded)}; {share:.3g} % of the points"
        if self.smallest_radius is not None:
            rows["without data"] = f"{100.0 * self.uncovered:.3g} % of the surface"
        for region in self.regions:
            middle = ", ".join(f"{1e3 * x:.4g}" for x in region.centre)
            rows[f"not to touch {len(rows)}"] = (
                f"{region.reason}: {1e4 * region.area:.3g} cm^2 within {1e3 * region.radius:.3g} mm of "
                f"({middle}) mm"
            )
        rows["verdict"] = self.verdict
        names = (name if "touch" not in name else "not to touch" for name in rows)
        return "\n".join(f"{name:<20}{value}" for name, value in zip(names, rows.values(), strict=True))


def _distances(pair: tuple[float, float]) -> str:
    """Root mean square and largest distance as text."""
    return f"{1e6 * pair[0]:.3g} um rms, {1e6 * pair[1]:.3g} um at most"


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SurfaceFit:
    """A surface made of points.

    Attributes:
        surface: The surface, differentiable in its own arrays.
        points: Shape (n, 3), the points used [m]; of more than 200 000 some, evenly chosen.
        feet: Shape (n, 3), places of the surface close to them; coordinates for its methods.
        report: `SurfaceReport`.
    """

    surface: SplineSurface
    points: Array
    feet: Array
    report: SurfaceReport = eqx.field(static=True)

    def trusted(self, places: Given) -> np.ndarray:
        """Whether the surface near places is known from data, and close to them.

        True where the nearest point is within the report's `reach`, and the median distance of the five
        nearest points from the surface within the report's `tolerance`.

        Places are in the frame of the points that were fitted. A body has its own, with the origin in its
        centre of mass: `FreeObject3.uniform(fit.surface, density)` moves the surface there, and the places
        that `grasp_points` finds on it want
        `mass_properties(fit.surface, density).centre` added before they are asked about.

        Args:
            places: Shape (n, 3), on the surface, in the frame of the points [m].

        Returns:
            Shape (n,).

        Raises:
            ValueError: If the places are not finite numbers of that shape, or traced.
        """
        seen = concrete(as_floats("places", places, (None, 3)))
        if seen is None:
            raise ValueError("argument places must be concrete numbers, but was traced")
        points, feet = np.asarray(self.points), np.asarray(self.feet)
        limits = {"reach": self.report.reach, "tolerance": self.report.tolerance}
        return trusted_places(points, feet, np.asarray(seen, float), **limits)


def trusted_places(
    points: np.ndarray, feet: np.ndarray, places: np.ndarray, *, reach: float, tolerance: float
) -> np.ndarray:
    """Whether the nearest point is within `reach`, and the median of five within `tolerance` of feet."""
    from scipy.spatial import KDTree

    distances, near = KDTree(points).query(places, k=_AROUND, workers=-1)
    off = np.median(np.linalg.norm(feet - points, axis=1)[near], axis=1)
    return (distances[:, 0] <= reach) & (off <= tolerance)


def regions_of(places: np.ndarray, areas: np.ndarray, link: float, reason: str) -> list[Region]:
    """Connected groups of places [m] not to be touched, where neighbours are within `link` [m]."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    if not len(places):
        return []
    pairs = KDTree(places).query_pairs(link, output_type="ndarray")
    shape = (len(places), len(places))
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=shape)
    count, groups = connected_components(graph, directed=False)
    found = []
    for group in range(count):
        inside = groups == group
        middle = places[inside].mean(axis=0)
        radius = float(np.linalg.norm(places[inside] - middle, axis=1).max())
        centre = (float(middle[0]), float(middle[1]), float(middle[2]))
        found.append(Region(centre, radius, float(areas[inside].sum()), reason))
    return found
