"""Triangles of the zero set of a field that is sampled on a grid: a surface net (Gibson, 1998). NumPy.

Every cell of the grid whose corners differ in sign has one vertex, the mean of the points where the field
vanishes along the cell's edges; every edge of the grid whose ends differ in sign gives a quadrangle of the
four cells around it. The net is closed wherever the zero set does not leave the grid, whatever its genus.

Written here because pictures and fits need no extra: scikit-image, of the extra `cad`, has marching cubes.
`fitting` checks fields by it, and `plotting` draws implicit surfaces.
"""

import numpy as np

# The four cells around an edge along an axis, counter-clockwise seen against it: shifts along the two others.
_AROUND = ((0, 0), (-1, 0), (-1, -1), (0, -1))


def net(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, shape (n, 3), and triangles, shape (m, 3), of the zero set of values at the nodes of a grid.

    Vertices are in cells, counted from the first node. Triangles run counter-clockwise seen from where the
    values are positive.

    Example:
        >>> import numpy as np
        >>> from jaxroll.geometry.surfaces import net
        >>> x, y, z = np.indices((9, 9, 9)) - 4.0
        >>> vertices, triangles = net(np.sqrt(x**2 + y**2 + z**2) - 2.5)
        >>> bool(np.ptp(np.linalg.norm(vertices - 4.0, axis=1)) < 0.3), len(triangles) % 2
        (True, 0)
    """
    shape, inside = np.array(values.shape), values < 0.0
    sums, hits, quads = np.zeros((values.size, 3)), np.zeros(values.size), []
    for axis in range(3):
        edge, points, outward = _crossings(values, inside, axis)
        others = [(axis + 1) % 3, (axis + 2) % 3]
        cells = []
        for shifts in _AROUND:
            cell = edge.copy()
            cell[:, others] += shifts
            # A cell is numbered by its first node; one beyond the grid takes -1.
            within = np.all((cell >= 0) & (cell < shape - 1), axis=1)
            number = np.where(within, np.ravel_multi_index(tuple(np.maximum(cell, 0).T), values.shape), -1)
            np.add.at(hits, number[within], 1.0)
            np.add.at(sums, number[within], points[within])
            cells.append(number)
        quad = np.stack(cells, axis=1)
        quad[~outward] = quad[~outward, ::-1]
        quads.append(quad[np.all(quad >= 0, axis=1)])
    used = np.nonzero(hits)[0]
    vertices = sums[used] / hits[used, None]
    places = np.zeros(values.size, int)
    places[used] = np.arange(len(used))
    return vertices, _halved(vertices, places[np.concatenate(quads)])


def _crossings(
    values: np.ndarray, inside: np.ndarray, axis: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges along an axis whose ends differ in sign: first node, where the zero is, whether it leads out."""
    low = tuple(slice(None, -1) if k == axis else slice(None) for k in range(3))
    high = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
    edge = np.argwhere(inside[low] != inside[high])
    first, last = values[low][tuple(edge.T)], values[high][tuple(edge.T)]
    points = edge.astype(float)
    points[:, axis] += first / (first - last)
    return edge, points, first < 0.0


def _halved(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Quadrangles cut along their shorter diagonals, shape (2 k, 3)."""
    a, b, c, d = (vertices[quads[:, k]] for k in range(4))
    turn = np.sum((a - c) ** 2, axis=1) > np.sum((b - d) ** 2, axis=1)
    quads = np.where(turn[:, None], np.roll(quads, -1, axis=1), quads)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
