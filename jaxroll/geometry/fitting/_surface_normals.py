"""Outward normals of a cloud of points, from their neighbours. Set-up: NumPy and SciPy.

The normal at a point is that of the plane through its neighbours, whose sign is open. Signs are made to agree
along a tree that connects all points, and then turned together so that the enclosed volume is positive (Hoppe
et al., 1992). `_surface_fit` uses the result where the caller has no normals, and the areas always. `_scan`
uses `parted_normals`, which are turned patch by patch (`_visibility`).
"""

import numpy as np

from ._visibility import turned_outward

_PLANE = 24  # points of a local plane, the one in the middle included
_UNSURE = 0.1  # share of the scatter along a plane, across it, at which its normal means nothing
_LINKS = 10  # nearest neighbours to which a point may be linked in the tree


def neighbourhoods(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each point's neighbours, itself first, shape (n, 24), and the area it stands for [m^2], shape (n,).

    The area of a disc that reaches to the farthest neighbour, divided by the number of neighbours.
    """
    from scipy.spatial import KDTree

    distances, neighbours = KDTree(points).query(points, k=min(_PLANE, len(points)))
    within = distances.shape[1] - 1
    return np.asarray(neighbours), np.pi * distances[:, -1] ** 2 / within


def estimated(points: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """Unit normals of the planes through neighbours, all to one side, shape (n, 3).

    Neighbours agree along a tree whose links turn the least; which side is out is left to `outward`.

    Raises:
        ValueError: If the cloud falls into parts.
    """
    normals, joined = _agreeing(points, neighbours)
    if not np.all(joined):
        raise ValueError(
            f"argument points must cover one connected surface, but {int(np.sum(~joined))} were apart"
        )
    return normals


def parted_normals(
    points: np.ndarray, neighbours: np.ndarray, areas: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outward unit normals, which points are joined with most of the others, and how sure each normal is.

    Sure is 1 where the neighbours lie in a plane, and 0 where they scatter across it by a tenth of their
    least variance along it, as at rims and in edges.
    """
    normals, joined = _agreeing(points, neighbours)
    near = points[neighbours] - points[neighbours].mean(axis=1, keepdims=True)
    scatter = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", near, near))
    sure = np.clip(1.0 - (scatter[:, 0] / np.maximum(scatter[:, 1], 1e-300)) / _UNSURE, 0.0, 1.0)
    return turned_outward(points, normals, neighbours, areas), joined, sure


def outward(points: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Normals turned round together if they point into the closed body."""
    return normals if volume_within(points, normals, areas) > 0.0 else -normals


def volume_within(points: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> float:
    """The volume within the points [m^3]; below zero if their normals point into the body.

    By Gauss's theorem three times the volume is the sum of area times (p - centre) . n over the points.
    """
    return float(np.sum(areas[:, None] * (points - points.mean(axis=0)) * normals)) / 3.0


def _agreeing(points: np.ndarray, neighbours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals of the planes through neighbours, all to one side, and which of them a tree joins."""
    # The direction in which the neighbours scatter least: eigenvalues come in rising order.
    near = points[neighbours] - points[neighbours].mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))
    normals = axes[:, :, 0]
    order, before = _tree(normals, neighbours)
    # The order is breadth first, so that each point comes after its predecessor, whose sign is settled.
    for i in order[1:]:
        if normals[i] @ normals[before[i]] < 0.0:
            normals[i] = -normals[i]
    joined = np.zeros(len(points), bool)
    joined[order] = True
    return normals, joined


def _tree(normals: np.ndarray, neighbours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points in the order in which a tree reaches them from one of the most, and the predecessor of each.

    It is the spanning tree of least total cost, where a link costs 1 - |n . n'|: it avoids links across an
    edge or to the other side of a thin part, where the sign would be a guess. Points that no link joins with
    most of the others are left out.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

    count, links = len(normals), neighbours[:, 1 : _LINKS + 1]
    left = np.repeat(np.arange(count), links.shape[1])
    turn = 1.0 - np.abs(np.sum(normals[left] * normals[links.ravel()], axis=1))
    # A cost of zero would count as no link in a sparse matrix.
    graph = coo_matrix((turn + 1e-9, (left, links.ravel())), shape=(count, count)).tocsr()
    tree = minimum_spanning_tree(graph.maximum(graph.T))
    _, parts = connected_components(tree, directed=False)
    start = int(np.argmax(parts == np.argmax(np.bincount(parts))))
    return breadth_first_order(tree, start, directed=False)
