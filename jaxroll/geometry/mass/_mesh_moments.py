r"""Volume, centre and second moments of the body within a triangle mesh: exact sums over its triangles.

With the corners $a$, $b$, $c$ of a triangle, from one point, the cone over it has the volume
$V = a \cdot (b \times c) / 6$, the centre $(a + b + c) / 4$ and the second moment
$\frac{V}{20} ((a + b + c)(a + b + c)^T + a a^T + b b^T + c c^T)$.
"""

import numpy as np

from ..._results import shown
from ._moments import centred, Moments


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
