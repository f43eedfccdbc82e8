r"""Volume, centre and second moments of the body within a triangle mesh: exact sums over its triangles.

With the corners $a$, $b$, $c$ of a triangle, from one point, the cone over it has the volume
$V = a \cdot (b \times c) / 6$, the centre $(a + b + c) / 4$ and the second moment
$\frac{V}{20} ((a + b + c)(a + b + c)^T + a a^T + b b^T + c c^T)$.
"""

import numpy as np

from ..._results import shown
from ._moments import centred, Moments

# At how many triangles, spread over the area, and of how many parts at most, it is checked what lies on both
# sides; how far from the triangle, in roots of its area; and how many triangles are summed up at a time.
_ASKED, _ASIDE, _TOGETHER = 12, 1e-3, 1024


def mesh_moments(vertices: np.ndarray, faces: np.ndarray) -> Moments:
    """Moments of the body within a watertight mesh, its faces counter-clockwise seen from outside.

    Args:
        vertices: Shape (n, 3) [m]. Those at the same place count as one.
        faces: Shape (m, 3), indices of the corners.
    """
    _, first, which = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    joined = first[which.reshape(-1)][faces]
    # Triangles without area, which exported meshes have, enclose nothing.
    real = (joined != np.roll(joined, 1, axis=1)).all(axis=1)
    _check_watertight(joined[real], len(vertices))
    about = vertices[faces].reshape(-1, 3).mean(axis=0)
    a, b, c = np.moveaxis(vertices[faces[real]] - about, 1, 0)
    cones = np.einsum("ni,ni->n", a, np.cross(b, c)) / 6.0
    total = a + b + c
    outer = lambda x: (x.T * cones) @ x  # noqa: E731
    second = (outer(total) + outer(a) + outer(b) + outer(c)) / 20.0
    size = cones.sum()
    if not size > 0:
        raise ValueError(
            f"argument shape must have faces that are counter-clockwise from outside, but the volume within "
            f"them was {size:.3g} m^3"
        )
    _check_counted_once(np.stack([a, b, c], axis=1), _parts(joined[real], len(vertices)))
    return centred(size, cones @ total / 4.0, second, about)


def _check_watertight(faces: np.ndarray, count: int) -> None:
    """Raise unless every edge of the triangles is passed as often in one direction as in the other."""
    begin, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    edges, which = np.unique(low * count + high, return_inverse=True)
    balance = np.bincount(which.reshape(-1), np.where(begin < end, 1.0, -1.0), len(edges))
    uneven = np.flatnonzero(balance)
    if len(uneven) or not len(faces):
        first = divmod(int(edges[uneven[0]]), count) if len(uneven) else "no triangle"
        raise ValueError(
            f"argument shape must be a watertight mesh, but {len(uneven)} of its {len(edges)} edges have "
            f"faces on one side alone or faces that disagree, the first between vertices {shown(first)}"
        )


def _parts(faces: np.ndarray, count: int) -> np.ndarray:
    """The number of the part to which each triangle belongs: those that share a corner are of one."""
    from scipy.sparse import coo_array  # imported with the first use
    from scipy.sparse.csgraph import connected_components

    begin, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    links = coo_array((np.ones(len(begin), np.int8), (begin, end)), shape=(count, count))
    return connected_components(links, directed=False)[1][faces[:, 0]]


def _check_counted_once(triangles: np.ndarray, parts: np.ndarray) -> None:
    """Raise where a body is not there once or not at all, beside some of its triangles.

    What parts have in common counts twice, and a part that is turned inside out beside others counts less
    than nothing: sums over triangles do not see that. A small overlap may lie between those asked.

    Args:
        triangles: Shape (m, 3, 3), corners [m].
        parts: Shape (m,), the part of each.
    """
    a, b, c = np.moveaxis(triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    areas = np.linalg.norm(normals, axis=1)
    along = np.cumsum(areas)
    spread = np.searchsorted(along, along[-1] * (np.arange(_ASKED) + 0.5) / _ASKED)
    # The largest triangle of each part, of the parts with the most triangles.
    order = np.lexsort([-areas, parts])
    largest = order[np.unique(parts[order], return_index=True)[1]]
    largest = largest[np.argsort(-np.bincount(parts)[parts[largest]], kind="stable")][:_ASKED]
    asked = np.unique([*spread, *largest])
    asked = asked[areas[asked] > 0.0]
    away = _ASIDE * normals[asked] / np.sqrt(areas[asked])[:, None]
    middles = triangles[asked].mean(axis=1)
    times = times_enclosed(np.stack([middles - away, middles + away], axis=1).reshape(-1, 3), triangles)
    wrong = times[(times < 0) | (times > 1)]
    if len(wrong):
        raise ValueError(
            "argument shape must be a mesh that encloses its body once, but there are places which it "
            f"encloses {wrong[0]} times: parts of it overlap, are there twice, or are inside out"
        )


def times_enclosed(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """How often a closed mesh runs round each point: the solid angle of its triangles over a sphere's."""
    total = np.zeros(len(points))
    dot = lambda x, y: x[0] * y[0] + x[1] * y[1] + x[2] * y[2]  # noqa: E731
    for start in range(0, len(triangles), _TOGETHER):
        # Corners as seen from each point, coordinate by coordinate: shape (points, triangles).
        some = triangles[start : start + _TOGETHER]
        a, b, c = ([some[:, i, k] - points[:, k, None] for k in range(3)] for i in range(3))
        la, lb, lc = (np.sqrt(dot(x, x)) for x in (a, b, c))
        across = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]]
        cosine = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
        total += np.arctan2(dot(a, across), cosine).sum(axis=1) / (2.0 * np.pi)
    return np.round(total).astype(int)
