r"""What a ball can touch: surfaces rolled by a ball inside and outside. NumPy, SciPy.

The surface on which a ball of radius r rolls inside a body bounds the union of all such balls in it, the
body's opening; its curvature is at most 1/r. Rolled outside it gives the closing, with curvature at least
-1/r. Opening and then closing rounds edges and fills notches, and leaves every point where both balls touch.

With E the centres of the balls inside and D those of the balls outside the opening, the distance from the
opening is $|x - E| - r$ and from its closing $r - |x - D|$. Both sets are points here: E those
$p - r n$ of the surface's points that are no nearer to any point than r, D alike of the opening's.
`_scan_fit` rolls scans by it.
"""

from typing import NamedTuple

import numpy as np

from ._scan import Scan

_SURE = 0.3  # normals less sure than this give no ball a place
_WHOLE = 0.98  # balls this much smaller fit nearly
_SHRINKS = 12  # rounds in which largest balls are found
_OPPOSITE = -0.7  # cosine of the angle between the normals at both ends of a thin part
_THIN = 0.5  # a part thinner than this share of the balls' diameter is not thickened
_NEAR = 6  # centres whose mean direction is the normal of a place that was moved


class RolledBody(NamedTuple):
    """Points of a surface moved to where balls inside and outside roll.

    Attributes:
        points: Shape (n, 3) [m].
        normals: Outward, shape (n, 3).
        free: Shape (n,): whether both balls touch the surface at the point itself.
        thin: Shape (n,): whether the other side is nearer than the balls' diameter.
    """

    points: np.ndarray
    normals: np.ndarray
    free: np.ndarray
    thin: np.ndarray


def rolled(scan: Scan, radius: float, tolerance: float) -> RolledBody | None:
    """The points of a closed surface, rolled by balls; None where no ball fits into it.

    Args:
        scan: All over the surface; balls touch it where normals are sure.
        radius: Of the balls [m].
        tolerance: How far [m] points may reach into a ball that touches another one: their noise.
    """
    points, normals, sure = scan.points, scan.normals, scan.sure > _SURE
    inner = sure & centres(points, points - radius * normals, radius - tolerance)
    outer = sure & centres(points, points + radius * normals, radius - tolerance)
    if not inner.any():
        return None
    cores, thin = _cores(points, normals, sure & ~inner, radius)
    within = np.concatenate([(points - radius * normals)[inner], cores])
    opened, upward = _drawn(points, normals, within, radius, tolerance)
    # Outer balls of the opening: no nearer than 2 r to any centre of an inner one.
    place = opened + radius * upward
    kept = centres(within, place, 2.0 * radius - 2.0 * tolerance)
    if not kept.any():
        return None
    closed, down = _drawn(opened, -upward, place[kept], radius, tolerance)
    return RolledBody(closed, -down, inner & outer, thin)


def centres(points: np.ndarray, places: np.ndarray, radius: float) -> np.ndarray:
    """Which places are at least `radius` [m] from all points."""
    from scipy.spatial import KDTree

    distances, _ = KDTree(points).query(places, distance_upper_bound=radius, workers=-1)
    return ~np.isfinite(distances)


def _cores(
    points: np.ndarray, normals: np.ndarray, chosen: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Centres of the largest balls inside thin parts, where they are at least half as large as `radius`.

    Which points are of thin parts at all is given too, shape (n,).

    The ball that touches at p and at q has the radius |p - q|^2 / (2 n . (p - q)); it shrinks to the nearest
    point within it until there is none (Ma, Bae and Choi, 2012). Only balls that touch at opposite sides
    count: those in an edge do not.
    """
    from scipy.spatial import KDTree

    tree, start, outward = KDTree(points), points[chosen], normals[chosen]
    size, other = np.full(len(start), radius), np.zeros(len(start), int)
    for _ in range(_SHRINKS):
        _, near = tree.query(start - size[:, None] * outward, workers=-1)
        arms = start - points[near]
        along = np.sum(arms * outward, axis=1)
        found = np.sum(arms**2, axis=1) / np.maximum(2.0 * along, 1e-300)
        smaller = (along > 0.0) & (found < 0.999 * size)
        size, other = np.where(smaller, found, size), np.where(smaller, near, other)
    opposite = np.sum(outward * normals[other], axis=1) < _OPPOSITE
    opposite &= size < _WHOLE * radius
    thin = np.zeros(len(points), bool)
    thin[np.nonzero(chosen)[0][opposite]] = True
    return (start - size[:, None] * outward)[opposite & (size > _THIN * radius)], thin


def _drawn(
    points: np.ndarray, normals: np.ndarray, middles: np.ndarray, radius: float, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points moved onto the nearest ball about `middles`, unless nearly there, and the normals at them."""
    from scipy.spatial import KDTree

    distances, near = KDTree(middles).query(points, k=min(_NEAR, len(middles)), workers=-1)
    distances, near = distances.reshape(len(points), -1), near.reshape(len(points), -1)
    arms = (points - middles[near[:, 0]]) / np.maximum(distances[:, :1], 1e-300)
    moved = np.abs(distances[:, 0] - radius) > 2.0 * tolerance
    place = np.where(moved[:, None], middles[near[:, 0]] + radius * arms, points)
    mean = points - middles[near].mean(axis=1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
    return place, np.where(moved[:, None], mean, normals)
