"""Scans of bodies: clouds and meshes of up to millions of points, thinned to what a fit needs. NumPy, SciPy.

All points in one cubic cell whose normals share their largest component are one `Scan` point, their mean: a
million points become some ten thousand, whose noise is smaller by the square root of what was averaged. Which
points lie apart from all others is decided here too. `_scan_fit` uses it, and `_surface_fit` of large clouds.
"""

from dataclasses import dataclass, replace

import numpy as np

from ._surface_normals import neighbourhoods, parted_normals

_LARGEST = 50_000  # most points of a thinned scan
_APART = 6.0  # a point is apart if its neighbours are this many times farther than is usual
_FOURTH = 3.0  # or if its fourth neighbour is
_BESIDE = 24  # neighbours among which a second sheet is looked for
_ALIKE = 0.8  # cosine of the angle between the normals of two sheets, at least
_DOUBLE = 0.25  # a larger spread of heights beside a point, in spacings, is that of two sheets
_LOST = 0.05  # largest share of points that may lie apart
_WOUND = 0.02  # largest share of a mesh's edges that two faces may run along in the same sense


@dataclass(frozen=True)
class Scan:
    """Points of a surface with outward unit normals and the areas they stand for.

    Attributes:
        points: Shape (n, 3) [m].
        normals: Shape (n, 3).
        areas: Shape (n,) [m^2].
        sure: Shape (n,), from 0 to 1: how far the normals can be trusted.
        spacing: Typical distance of neighbours [m].
    """

    points: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    sure: np.ndarray
    spacing: float

    def part(self, chosen: np.ndarray) -> "Scan":
        """Some of the points."""
        found = (self.points[chosen], self.normals[chosen], self.areas[chosen], self.sure[chosen])
        return Scan(*found, self.spacing)

    def with_others(self, others: "Scan") -> "Scan":
        """The points of both."""
        both = lambda mine, theirs: np.concatenate([mine, theirs])  # noqa: E731
        points, normals = both(self.points, others.points), both(self.normals, others.normals)
        return Scan(
            points, normals, both(self.areas, others.areas), both(self.sure, others.sure), self.spacing
        )

    def without(self, left_out: np.ndarray, numbers: np.ndarray) -> tuple["Scan", np.ndarray]:
        """The scan without some points, and the `numbers` of `thinned_scan` counted anew."""
        kept = ~left_out
        after = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)  # what was -1 remains so
        return self.part(kept), after[numbers]

    def joined(self, reach: float) -> "Scan":
        """The scan with double sheets put together, at the mean height of the points beside each.

        Args:
            reach: Largest distance of two sheets [m].
        """
        from scipy.spatial import KDTree

        _, near = KDTree(self.points).query(self.points, k=min(_BESIDE, len(self.points)), workers=-1)
        arms = self.points[near] - self.points[:, None]
        heights = np.einsum("nki,ni->nk", arms, self.normals)
        aside = np.sum(arms**2, axis=2) - heights**2
        alike = np.einsum("nki,ni->nk", self.normals[near], self.normals) > _ALIKE
        beside = alike & (np.abs(heights) < reach) & (aside < self.spacing**2)
        weights = np.where(beside, self.areas[near], 0.0)
        total = weights.sum(axis=1)
        mean = np.sum(weights * heights, axis=1) / total
        spread = np.sqrt(np.sum(weights * (heights - mean[:, None]) ** 2, axis=1) / total)
        double = (spread > _DOUBLE * self.spacing) & (self.sure > 0.5)
        return replace(self, points=self.points + np.where(double, mean, 0.0)[:, None] * self.normals)

    def averaged(self, width: float, levels: np.ndarray) -> tuple["Scan", np.ndarray]:
        """One mean of all points in a cell of this width [m], with the sum of their areas.

        Beside it come the means over each cell of `levels`, numbers of the points, weighted by area.
        """
        count, inverse = _cells(self.points, self.normals, width)
        areas = np.bincount(inverse, self.areas, count)
        if not areas.min() > 0.0:
            raise ValueError("argument points must cover a surface, but some of them lie along a line")
        turned = self.areas * self.sure
        places = np.stack([np.bincount(inverse, self.areas * x, count) for x in self.points.T], axis=1)
        directions = np.stack([np.bincount(inverse, turned * x, count) for x in self.normals.T], axis=1)
        lengths = np.linalg.norm(directions, axis=1)
        unit = directions / np.maximum(lengths, 1e-300)[:, None]
        found = Scan(places / areas[:, None], unit, areas, lengths / areas, self.spacing)
        return found, np.bincount(inverse, self.areas * levels, count) / areas


def thinned_scan(points: np.ndarray, normals: np.ndarray | None, width: float) -> tuple[Scan, np.ndarray]:
    """A scan of points [m], and the number of each point's mean in it, -1 if it lies apart, shape (n,).

    Args:
        points: Shape (n, 3).
        normals: Unit vectors, shape (n, 3); None: from planes through neighbours, turned alike.
        width: Of the cells [m]; wider ones are taken where these would be too many.

    Raises:
        ValueError: If the points fall into parts.
    """
    while True:
        cells, inverse = _cells(points, normals, width)
        if cells <= _LARGEST:
            break
        width *= 1.25 * np.sqrt(cells / _LARGEST) if cells > 2 * _LARGEST else 1.1
    counts = np.bincount(inverse, minlength=cells)
    means = np.stack([np.bincount(inverse, x, cells) for x in points.T], axis=1) / counts[:, None]
    near, areas = neighbourhoods(means)
    reach = np.sqrt(areas)
    # A cell that the surface grazes holds the tail of its points' noise alone: it counts by what it holds.
    areas = counts * areas[near].sum(axis=1) / counts[near].sum(axis=1)
    fourth = np.linalg.norm(means[near[:, min(4, near.shape[1] - 1)]] - means, axis=1)
    close = (reach < _APART * np.median(reach)) & (fourth < _FOURTH * np.median(fourth))
    if normals is None:
        directions, joined, sure = parted_normals(means, near, areas)
        close &= joined
    else:
        directions = np.stack([np.bincount(inverse, x, cells) for x in normals.T], axis=1)
        lengths = np.linalg.norm(directions, axis=1)
        sure = np.clip(2.0 * lengths / counts - 1.0, 0.0, 1.0)  # 0: normals contradict each other
        directions = directions / np.maximum(lengths, 1e-300)[:, None]
    apart = ~close[inverse]
    if apart.mean() > _LOST:
        raise ValueError(
            f"argument points must cover one connected surface, but {int(apart.sum())} of {len(apart)} "
            "were apart"
        )
    spacing = float(np.median(reach[close]))
    numbers = np.where(close, np.cumsum(close) - 1, -1)[inverse]
    return Scan(means[close], directions[close], areas[close], sure[close], spacing), numbers


def normals_of_net(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals at the vertices, means by area, and a third of the area around each [m^2]."""
    corners = vertices[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    around, count = triangles.ravel(), len(vertices)
    normals = np.stack([np.bincount(around, np.repeat(x, 3), count) for x in across.T], axis=1)
    areas = np.bincount(around, np.repeat(np.linalg.norm(across, axis=1) / 6.0, 3), count)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.maximum(lengths, 1e-300), areas


def _cells(points: np.ndarray, normals: np.ndarray | None, width: float) -> tuple[int, np.ndarray]:
    """How many cells hold points, and the number of each point's own."""
    keys = np.floor((points - points.min(axis=0)) / width).astype(np.int64)
    side = np.zeros(len(points), np.int64)
    if normals is not None:
        axis = np.argmax(np.abs(normals), axis=1)
        side = 2 * axis + (np.take_along_axis(normals, axis[:, None], 1)[:, 0] > 0.0)
    sizes = keys.max(axis=0) + 1
    flat = ((keys[:, 0] * sizes[1] + keys[:, 1]) * sizes[2] + keys[:, 2]) * 6 + side
    seen, inverse = np.unique(flat, return_inverse=True)
    return len(seen), inverse


def sampled_mesh(
    vertices: np.ndarray, faces: np.ndarray, width: float
) -> tuple[np.ndarray, np.ndarray | None]:
    """Points over the triangles of a mesh, at most about `width` [m] apart, and their unit normals.

    Triangles are cut alike into $k^2$ parts, each of which gives its middle. Normals are None if neighbouring
    faces run round in opposite senses.
    """
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(across, axis=1)
    fair = twice > 1e-12 * twice.max()
    corners, across, twice = corners[fair], across[fair], twice[fair]
    width = max(width, float(np.sqrt(0.5 * twice.sum() / 1e6)))
    longest = np.max(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
    parts = np.maximum(np.ceil(longest / width), 1).astype(int)
    points, normals = [], []
    for k in np.unique(parts):
        chosen = parts == k
        middles = _middles(int(k))
        points.append(np.einsum("mk,nkd->nmd", middles, corners[chosen]).reshape(-1, 3))
        unit = across[chosen] / twice[chosen, None]
        normals.append(np.repeat(unit, len(middles), axis=0))
    if not _alike(faces):
        return np.concatenate(points), None
    cloud, directions = np.concatenate(points), np.concatenate(normals)
    # Gauss's theorem: three times the volume, from the triangles themselves.
    volume = np.sum((corners.mean(axis=1) - vertices.mean(axis=0)) * across)
    return cloud, directions if volume > 0.0 else -directions


def _middles(parts: int) -> np.ndarray:
    """Barycentric coordinates of the middles of the parts^2 triangles into which a triangle is cut."""
    i, j = np.indices((parts, parts)).reshape(2, -1)
    up, down = i + j < parts, i + j < parts - 1
    u = np.concatenate([i[up] + 1 / 3, i[down] + 2 / 3]) / parts
    v = np.concatenate([j[up] + 1 / 3, j[down] + 2 / 3]) / parts
    return np.stack([1.0 - u - v, u, v], axis=1)


def _alike(faces: np.ndarray) -> bool:
    """Whether faces that share an edge run along it in opposite senses, but for a few."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    directed = edges[:, 0] * (faces.max() + 1) + edges[:, 1]
    return len(directed) - len(np.unique(directed)) <= _WOUND * len(directed)
