"""Outward normals of a cloud of points, from their neighbours. Set-up: NumPy and SciPy."""

import numpy as np

_PLANE = 24  # neighbours of a local plane
_LINKS = 10  # neighbours along which orientation spreads


def neighbourhoods(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each point's neighbours, itself first, shape (n, 24), and the area it stands for [m^2]."""
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
    near = points[neighbours] - points[neighbours].mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", near, near))
    normals = axes[:, :, 0]
    order, before = _tree(normals, neighbours)
    for i in order[1:]:
        if normals[i] @ normals[before[i]] < 0.0:
            normals[i] = -normals[i]
    return normals


def outward(points: np.ndarray, normals: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """Normals turned round together if they point into the closed body: its volume must be positive."""
    flux = np.sum(areas[:, None] * (points - points.mean(axis=0)) * normals)
    return normals if flux > 0.0 else -normals


def _tree(normals: np.ndarray, neighbours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points from the first along the tree of least turning, and each one's predecessor."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

    count, links = len(normals), neighbours[:, 1 : _LINKS + 1]
    left = np.repeat(np.arange(count), links.shape[1])
    turn = 1.0 - np.abs(np.sum(normals[left] * normals[links.ravel()], axis=1))
    graph = coo_matrix((turn + 1e-9, (left, links.ravel())), shape=(count, count)).tocsr()
    tree = minimum_spanning_tree(graph.maximum(graph.T))
    order, before = breadth_first_order(tree, 0, directed=False)
    if len(order) < count:
        raise ValueError(
            f"argument points must cover one connected surface, but {count - len(order)} were apart"
        )
    return order, before
