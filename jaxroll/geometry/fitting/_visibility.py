"""Which side of a surface is out: the one from which the surroundings can be seen. NumPy, SciPy.

The cloud is put into cells; from each cell 26 straight ways lead out of the box, and more of them are free
outside the body than within. Normals that agree along a tree of links turn round together, patch by patch,
to the side from which more ways are free: a tree alone goes wrong at rims. `_surface_normals` uses it.
"""

import itertools

import numpy as np

_CELLS = 80  # cells along the largest extent, at most
_WIDTH = 2.0  # width of a cell in distances of neighbours, at least: the cloud must stop the view
_BEND = 0.2  # links with a larger 1 - |n . n'| divide patches
_LINKS = 10  # nearest neighbours with which a point may share a patch
_OWN = 0.5  # weight of a free way against that of a neighbour
_ROUNDS = 20  # in which neighbours are heard
_AWAY = 2.5  # how far [cells] from the surface its sides are looked at
_ROOM = 4  # empty cells around the cloud


def turned_outward(
    points: np.ndarray, normals: np.ndarray, neighbours: np.ndarray, areas: np.ndarray
) -> np.ndarray:
    """Normals that agree along a tree, turned outward patch by patch, shape (n, 3)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    width = max(_WIDTH * float(np.median(np.sqrt(areas))), float(np.ptp(points, axis=0).max()) / _CELLS)
    origin = points.min(axis=0) - _ROOM * width
    free = _free_ways(np.floor((points - origin) / width).astype(int))
    above, below = (_at(free, (points + side * _AWAY * width * normals - origin) / width) for side in (1, -1))
    links = neighbours[:, 1 : _LINKS + 1]
    cosines = np.einsum("ni,nki->nk", normals, normals[links])
    left, k = np.nonzero(cosines > 1.0 - _BEND)
    shape = (len(points), len(points))
    graph = coo_matrix((np.ones(len(left)), (left, links[left, k])), shape=shape)
    count, patches = connected_components(graph, directed=False)
    votes = np.bincount(patches, areas * (above - below), count)
    signs = np.where(votes[patches] < 0.0, -1.0, 1.0)
    # A patch may still hold parts that face opposite ways, joined by the planes across a sharp rim: each
    # point listens to its own sight and to its neighbours.
    for _ in range(_ROUNDS):
        signs = np.where(_OWN * (above - below) + np.sum(cosines * signs[links], axis=1) < 0.0, -1.0, 1.0)
    return signs[:, None] * normals


def _at(free: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Numbers of free ways at places, in cells."""
    cell = np.clip(np.floor(place).astype(int), 0, np.array(free.shape) - 1)
    return free[tuple(cell.T)].astype(float)


def _free_ways(cells: np.ndarray) -> np.ndarray:
    """How many of the 26 ways from each cell of the box meet no occupied cell."""
    filled = np.zeros(cells.max(axis=0) + 1 + _ROOM, bool)
    filled[tuple(cells.T)] = True
    found = np.zeros(filled.shape, int)
    for way in itertools.product((-1, 0, 1), repeat=3):
        if way != (0, 0, 0):
            found += _free_way(filled, way)
    return found


def _free_way(filled: np.ndarray, way: tuple[int, ...]) -> np.ndarray:
    """From which cells one way is free."""
    axis = next(k for k in range(3) if way[k])
    # Layer by layer along the first axis along which the way leads, from where it leaves the box.
    layers = np.moveaxis(filled, axis, 0)
    aside = [step for k, step in enumerate(way) if k != axis]
    free = np.ones(layers.shape, bool)
    last = len(layers) - 1
    ahead = range(last - 1, -1, -1) if way[axis] > 0 else range(1, last + 1)
    for i in ahead:
        before = i + way[axis]
        free[i] = _shifted(free[before] & ~layers[before], aside)
    return np.moveaxis(free, 0, axis)


def _shifted(layer: np.ndarray, steps: list[int]) -> np.ndarray:
    """The layer's entries `steps` further on; true beyond its edges."""
    padded = np.pad(layer, 1, constant_values=True)
    first, second = (slice(1 + step, n + 1 + step) for step, n in zip(steps, layer.shape, strict=True))
    return padded[first, second]
