"""What is said of a surface through a scan: how far it can be trusted, where not, and when there is none.

`_scan_fit` makes the surface; here its distances from the data, the parts without data and the curvature are
looked at, and the fit is refused where it would not be the body that was scanned.
"""

import jax.numpy as jnp
import numpy as np

from ._scan import sampled_mesh
from ._scan_fit import Closed, closed_through
from ._surface_measured import angles, evenly, measured
from ._surface_report import Region, regions_of, SurfaceFit, SurfaceReport, trusted_places

_MESH = 0.25  # distance of samples on a mesh, in smallest radii
_FEW = 20  # samples to a vertex, below which distances are taken at a mesh's vertices, else at the samples
_THIN = 0.2  # largest share of the scan in parts thinner than two radii
_MOVED = 0.3  # largest share of the area that may be moved by more than half a radius
_BARE = 0.6  # largest share of the surface without data
_TURNED = 0.02  # largest share of points whose normals contradict the surface's
_NEAR = 0.06  # a surface this near to the data, in smallest radii, is as good as the data
_REGIONS = 8


def fit_scan(
    cloud: np.ndarray, normals: np.ndarray | None, faces: np.ndarray | None, radius: float
) -> SurfaceFit:
    """The surface of a scan with radii of curvature from `radius` [m] up, and its report.

    Args:
        cloud: Points or vertices [m], shape (n, 3).
        normals: Outward unit normals of the same shape, or None.
        faces: Triangles of a mesh, shape (m, 3), or None.
        radius: Smallest radius of curvature [m].

    Raises:
        ValueError: If the scan is not one that a smooth closed surface of such a curvature could be.
    """
    points, directions = cloud, normals
    if faces is not None:
        points, directions = sampled_mesh(cloud, faces, _MESH * radius)
        used = np.unique(faces)
        cloud, normals = (cloud[used], None) if _FEW * len(used) > len(points) else (points, None)
    found = closed_through(points, directions, radius)
    apart = found.apart if len(found.apart) == len(cloud) else np.zeros(len(cloud), bool)
    report, used, feet = _report(found, cloud[~apart], None if normals is None else normals[~apart], radius)
    return SurfaceFit(found.surface, jnp.asarray(used), jnp.asarray(feet), report)


def _report(
    found: Closed, points: np.ndarray, normals: np.ndarray | None, radius: float
) -> tuple[SurfaceReport, np.ndarray, np.ndarray]:
    """The report, the points that were looked at, and their feet [m]."""
    from scipy.spatial import KDTree

    each = evenly(len(points))
    count, points = len(points), points[each]
    feet, facing, _ = measured(found.surface, jnp.asarray(points))
    distances = np.linalg.norm(feet - points, axis=1)
    near = KDTree(found.scan.points).query(points, workers=-1)[1]
    free = found.rolled.free[near]
    given = found.scan.normals[near] if normals is None else normals[each]
    # What is rounded off may well face another way.
    sure = free & (found.scan.sure[near] > 0.5)
    turned = float(np.mean((np.sum(facing * given, axis=1) < 0.0) & sure))
    kept, rounded = _pair(distances[free]), _pair(distances[~free])
    tolerance = max(_NEAR * radius, 3.0 * kept[0] if kept else 0.0)
    data = found.scan.points[: len(found.scan.points) - found.filled]
    covered = KDTree(data).query(found.vertices, workers=-1)[0] <= found.reach
    uncovered = float(found.areas[~covered].sum() / found.areas.sum())
    _refused(found, points, distances, uncovered, turned, radius)
    cells = tuple(n - 5 for n in found.surface.coefficients.shape)
    report = SurfaceReport(
        points=count,
        area=float(found.areas.sum()),
        smoothing=found.wavelength,
        cells=(cells[0], cells[1], cells[2]),
        step=float(found.surface.step),
        rms=float(np.sqrt(np.mean(distances**2))),
        largest=float(distances.max()),
        normals=None if normals is None else angles(facing, given),
        curvature=found.curvatures,
        smoothness=found.surface.smoothness,
        verdict=_verdict(kept, rounded, float(np.mean(~free)), uncovered, radius),
        smallest_radius=radius,
        rejected=int(found.apart.sum()),
        kept=kept,
        rounded=rounded,
        rounded_share=float(np.mean(~free)),
        uncovered=uncovered,
        reversed=turned,
        regions=_regions(found, points, feet, covered, tolerance),
        reach=found.reach,
        tolerance=tolerance,
    )
    return report, points, feet


def _pair(distances: np.ndarray) -> tuple[float, float] | None:
    """Root mean square and largest of distances; None of none."""
    return (float(np.sqrt(np.mean(distances**2))), float(distances.max())) if len(distances) else None


def _regions(
    found: Closed, points: np.ndarray, feet: np.ndarray, covered: np.ndarray, tolerance: float
) -> tuple[Region, ...]:
    """The largest parts of the surface without data, or away from them."""
    link = 2.0 * float(np.sqrt(np.median(found.areas)))
    near = trusted_places(points, feet, found.vertices, reach=np.inf, tolerance=tolerance)
    regions = regions_of(found.vertices[~covered], found.areas[~covered], link, "no data")
    regions += regions_of(found.vertices[covered & ~near], found.areas[covered & ~near], link, "rounded off")
    regions.sort(key=lambda region: -region.area)
    return tuple(region for region in regions[:_REGIONS] if region.area > link**2)


def _refused(
    found: Closed, points: np.ndarray, distances: np.ndarray, uncovered: float, turned: float, radius: float
) -> None:
    """Raise where the surface is not the body that was scanned."""
    from scipy.spatial import KDTree

    sharpest = float(np.abs(found.curvatures).max())
    thin = float(np.mean(found.rolled.thin))
    near = KDTree(points).query(found.vertices, workers=-1)[1]
    moved = float(found.areas[distances[near] > 0.5 * radius].sum() / found.areas.sum())
    if thin > _THIN:
        raise ValueError(
            f"argument smallest_radius must be smaller for a body of which {100.0 * thin:.0f} % is thinner "
            f"than twice that, but was {radius:.4g} m"
        )
    if moved > _MOVED:
        raise ValueError(
            f"argument smallest_radius must be smaller for these points, of which {100.0 * moved:.0f} % by "
            f"area would be more than half of it off the surface, but was {radius:.4g} m"
        )
    if found.parts != (1, 1) or not np.isfinite(sharpest):
        raise ValueError(
            f"argument points must determine one closed surface, but the fit to them has "
            f"{sum(found.parts) - 1}"
        )
    if sharpest * radius > 1.0:
        raise ValueError(
            f"argument smallest_radius must be smaller for these points: the smoothest surface through them "
            f"still bends with {1.0 / sharpest:.3g} m, but was {radius:.4g} m"
        )
    if uncovered > _BARE:
        raise ValueError(
            f"argument points must cover most of a closed surface, but {100.0 * uncovered:.0f} % of it "
            "has none"
        )
    if turned > _TURNED:
        raise ValueError(
            f"argument normals must point outward, but {100.0 * turned:.1f} % of them point into the body"
        )


def _verdict(
    kept: tuple[float, float] | None,
    rounded: tuple[float, float] | None,
    share: float,
    uncovered: float,
    radius: float,
) -> str:
    """The report in a sentence."""
    said = [f"one smooth surface with radii of curvature from {1e3 * radius:.4g} mm up"]
    if kept:
        said.append(f"{1e3 * kept[0]:.2g} mm rms from {100.0 * (1.0 - share):.3g} % of the points")
    if rounded:
        said.append(f"the other {100.0 * share:.3g} % rounded off by up to {1e3 * rounded[1]:.2g} mm")
    if uncovered > 0.001:
        said.append(f"{100.0 * uncovered:.2g} % of it closed without data")
    return ", ".join(said)
