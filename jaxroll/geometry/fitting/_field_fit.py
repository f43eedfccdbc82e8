"""Least squares for a field of B-splines on a grid of space. Set-up: NumPy, and SciPy's banded Cholesky."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from ..surfaces import ORDER, UNIFORM

_POLYNOMIALS = UNIFORM / 120.0
_MEMORY = 5e8  # bytes of the band
AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


@dataclass(frozen=True)
class Grid:
    """Cells of a box: corner [m], width [m], numbers of functions; the slowest axis is the longest."""

    origin: np.ndarray
    step: float
    counts: tuple[int, int, int]

    @property
    def strides(self) -> tuple[int, int, int]:
        """Distance of neighbours along each axis in the vector of unknowns."""
        order = np.argsort(self.counts)
        strides, stride = [0, 0, 0], 1
        for k in order:
            strides[k], stride = stride, stride * self.counts[k]
        return (strides[0], strides[1], strides[2])

    @property
    def band(self) -> int:
        """Largest distance of two functions that overlap."""
        return (ORDER - 1) * sum(self.strides)


def grid_around(points: np.ndarray, step: float, margin: float) -> Grid:
    """A grid that holds the points with some room.

    Raises:
        ValueError: If the system would not fit into memory.
    """
    low, high = points.min(axis=0) - margin * step, points.max(axis=0) + margin * step
    cells = np.maximum(np.ceil((high - low) / step).astype(int), 1)
    origin = 0.5 * (low + high) - 0.5 * step * cells
    counts = tuple(int(n) + ORDER - 1 for n in cells)
    grid = Grid(origin, step, (counts[0], counts[1], counts[2]))
    size = 8.0 * math.prod(grid.counts) * (grid.band + 1)
    if size > _MEMORY:
        raise ValueError(
            f"argument smoothing must be larger for a grid of {' x '.join(map(str, cells))} cells: "
            f"its system would take {size / 1e9:.1f} GB"
        )
    return grid


@dataclass(frozen=True)
class DataRows:
    """What the data ask of the field: per point its cell's first unknown, and six functions an axis."""

    base: np.ndarray
    weights: np.ndarray  # (axis, point, derivative, function)

    def field(self, order: tuple[int, int, int], part: slice | np.ndarray = slice(None)) -> np.ndarray:
        """Values or derivatives of the 216 functions at some of the points."""
        x, y, z = (self.weights[k, part, order[k]] for k in range(3))
        return np.einsum("ni,nj,nk->nijk", x, y, z).reshape(len(x), ORDER**3)


def rows(grid: Grid, points: np.ndarray) -> DataRows:
    """The functions at points, with lengths in cells."""
    place = (points - grid.origin) / grid.step
    cell = np.clip(np.floor(place).astype(int), 0, np.array(grid.counts) - ORDER)
    powers = (place - cell)[..., None] ** np.arange(ORDER)
    slopes = np.zeros_like(powers)
    slopes[..., 1:] = powers[..., :-1] * np.arange(1, ORDER)
    values = np.stack([powers @ _POLYNOMIALS.T, slopes @ _POLYNOMIALS.T], axis=2)
    return DataRows(cell @ np.array(grid.strides), np.moveaxis(values, 1, 0))


def offsets(grid: Grid) -> np.ndarray:
    """Unknowns of a cell's 216 functions from its first."""
    six, strides = np.arange(ORDER), grid.strides
    x, y, z = (six * stride for stride in strides)
    return (x[:, None, None] + y[None, :, None] + z[None, None, :]).ravel()


def normal_band(grid: Grid, data: DataRows, value: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    r"""Lower band of $\sum_i a_i B_i B_i^T + |G_i \nabla B_i|^2$, functions cell by cell.

    Args:
        grid: The functions.
        data: The points.
        value: $a_i$, shape (n,).
        slopes: The matrices $G_i$, shape (n, 3, 3).
    """
    unknowns, apart = math.prod(grid.counts), offsets(grid)
    band = np.zeros((grid.band + 1, unknowns))
    flat = band.ravel()
    left, right = np.nonzero(apart[:, None] >= apart[None, :])
    places = (apart[left] - apart[right]) * unknowns + apart[right]
    order = np.argsort(data.base, kind="stable")
    bases, first = np.unique(data.base[order], return_index=True)
    for base, part in zip(bases, np.split(order, first[1:]), strict=True):
        functions = data.field((0, 0, 0), part) * np.sqrt(value[part])[:, None]
        gradients = np.stack([data.field(axis, part) for axis in AXES], axis=1)
        both = np.concatenate([functions, (slopes[part] @ gradients).reshape(-1, functions.shape[1])])
        block = both.T @ both
        flat[places + base] += block[left, right]
    return band


def roughness_band(grid: Grid) -> np.ndarray:
    r"""Lower band of $\int |\mathrm{D}^3 F|^2 dV$ over the grid, exact, with lengths in cells."""
    grams = [_grams(count) for count in grid.counts]
    strides, unknowns = grid.strides, math.prod(grid.counts)
    band = np.zeros((grid.band + 1, unknowns))
    order = sorted(range(3), key=lambda k: -strides[k])  # slowest axis first
    reach = range(1 - ORDER, ORDER)
    for shift in itertools.product(reach, reach):
        slow, middle = (grams[k][:, s + ORDER - 1] for k, s in zip(order, shift, strict=False))
        planes = [_planes(slow, middle, 3 - c) for c in range(4)]
        stacked = np.stack([p.ravel() * math.comb(3, c) for c, p in enumerate(planes)], axis=1)
        for s in reach:
            offset = shift[0] * strides[order[0]] + shift[1] * strides[order[1]] + s * strides[order[2]]
            if offset >= 0:
                band[offset] += (stacked @ grams[order[2]][:, s + ORDER - 1]).ravel()
    return band


def _planes(slow: np.ndarray, middle: np.ndarray, total: int) -> np.ndarray:
    """Sum over the ways to share this many derivatives between two axes."""
    shares = [math.comb(total, a) * np.outer(slow[a], middle[total - a]) for a in range(total + 1)]
    return np.sum(shares, axis=0)


def _grams(count: int) -> np.ndarray:
    """Integrals of products of derivatives 0 to 3 of B-splines: derivative, shift + 5, function."""
    found, powers = np.zeros((4, 2 * ORDER - 1, count)), np.arange(ORDER)
    polynomials = _POLYNOMIALS
    gram = 1.0 / (powers[:, None] + powers[None, :] + 1.0)
    for r in range(4):
        local = polynomials @ gram @ polynomials.T
        for a, b in itertools.product(range(ORDER), repeat=2):
            found[r, a - b + ORDER - 1, b : count - ORDER + 1 + b] += local[a, b]
        polynomials = np.pad(polynomials[:, 1:] * powers[1:], ((0, 0), (0, 1)))
    return found
