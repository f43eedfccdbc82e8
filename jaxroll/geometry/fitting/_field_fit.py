r"""Least squares for a scalar field of B-splines on a grid in space: the matrices. Set-up, in NumPy.

The field is $F(x) = \sum_j c_j B_j(x)$, where each $B_j$ is a product of three uniform quintic B-splines on
cubic cells. At any point $6^3 = 216$ of them are not zero. Unknowns are numbered along the grid's shortest
axis first, so that two functions that overlap have numbers that differ by at most `Grid.band`: the normal
equations are a banded matrix, of which only the lower band is stored, as SciPy's `cholesky_banded` wants it:
`band[i - j, j]` is the entry in row i and column j, for i >= j.

Points are in metres; derivatives and integrals count lengths in cells. `_surface_fit` adds up the two bands
that are made here, and solves. `_field_solve` uses `rows` and `gram_tables` alone.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from ..surfaces import ORDER, UNIFORM

# The six quintic B-splines on one cell as polynomials in the place within it, from 0 to 1: function, power.
_POLYNOMIALS = UNIFORM / 120.0
_MEMORY = 5e8  # most bytes of the band
# Orders of differentiation along the three axes that make the components of the gradient.
AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


@dataclass(frozen=True)
class Grid:
    """A box of cubic cells.

    Attributes:
        origin: Corner of the box [m], shape (3,).
        step: Width of a cell [m].
        counts: Number of functions along each axis: that of the cells, and five more.
    """

    origin: np.ndarray
    step: float
    counts: tuple[int, int, int]

    @property
    def strides(self) -> tuple[int, int, int]:
        """By how much the numbers of unknowns that are neighbours along each axis differ."""
        # The shortest axis runs fastest, which makes the band as narrow as it can be.
        order = np.argsort(self.counts)
        strides, stride = [0, 0, 0], 1
        for k in order:
            strides[k], stride = stride, stride * self.counts[k]
        return (strides[0], strides[1], strides[2])

    @property
    def band(self) -> int:
        """Largest difference of the numbers of two functions that overlap."""
        return (ORDER - 1) * sum(self.strides)


def grid_around(points: np.ndarray, step: float, margin: float) -> Grid:
    """The smallest grid of cells of width `step` [m] that extends beyond the points by `margin` cells.

    Raises:
        ValueError: If the band of the normal equations would take more than 0.5 GB.
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
    """The functions that are not zero at each point.

    Attributes:
        base: Shape (n,), number of the first of the point's 216 unknowns; `offsets` has the others.
        weights: Shape (3, n, 2, 6): axis, point, order of differentiation, function along that axis.
    """

    base: np.ndarray
    weights: np.ndarray

    def field(self, order: tuple[int, int, int], part: slice | np.ndarray = slice(None)) -> np.ndarray:
        """Values or first derivatives of the 216 functions at some of the points, shape (points, 216).

        Args:
            order: Order of differentiation along each axis, 0 or 1.
            part: Which points; by default all.
        """
        x, y, z = (self.weights[k, part, order[k]] for k in range(3))
        return np.einsum("ni,nj,nk->nijk", x, y, z).reshape(len(x), ORDER**3)


def rows(grid: Grid, points: np.ndarray) -> DataRows:
    """Values and derivatives of the functions along each axis at points [m]."""
    place = (points - grid.origin) / grid.step
    cell = np.clip(np.floor(place).astype(int), 0, np.array(grid.counts) - ORDER)
    powers = (place - cell)[..., None] ** np.arange(ORDER)
    slopes = np.zeros_like(powers)
    slopes[..., 1:] = powers[..., :-1] * np.arange(1, ORDER)
    values = np.stack([powers @ _POLYNOMIALS.T, slopes @ _POLYNOMIALS.T], axis=2)
    return DataRows(cell @ np.array(grid.strides), np.moveaxis(values, 1, 0))


def offsets(grid: Grid) -> np.ndarray:
    """Numbers of a cell's 216 unknowns, counted from the first of them."""
    six, strides = np.arange(ORDER), grid.strides
    x, y, z = (six * stride for stride in strides)
    return (x[:, None, None] + y[None, :, None] + z[None, None, :]).ravel()


def normal_band(grid: Grid, data: DataRows, value: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    r"""Lower band of $\sum_i a_i B_i B_i^T + (G_i \nabla B_i)^T (G_i \nabla B_i)$.

    $B_i$ are the values of all functions at point i, $\nabla B_i$ their gradients: three rows. All points of
    one cell share their 216 unknowns, so that their contributions are summed by one product of matrices.

    Args:
        grid: The functions.
        data: The points.
        value: $a_i$, shape (n,).
        slopes: The matrices $G_i$, shape (n, 3, 3).
    """
    unknowns, apart = math.prod(grid.counts), offsets(grid)
    band = np.zeros((grid.band + 1, unknowns))
    flat = band.ravel()
    # Pairs of a cell's unknowns in the lower triangle, and where their products lie in the flattened band if
    # the cell's first unknown is 0. Otherwise the column, and so the place, is larger by that unknown.
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
    r"""Lower band of $\int |\mathrm{D}^3 F|^2 dV$ over the grid, exact, with lengths in cells.

    $|\mathrm{D}^3 F|^2$ is the sum of $\frac{3!}{a!\,b!\,c!} (\partial_x^a \partial_y^b \partial_z^c F)^2$
    over $a + b + c = 3$. Since the functions are products, so are the integrals of products of their
    derivatives: of three one-dimensional ones, which `gram_tables` has.
    """
    grams = [gram_tables(count) for count in grid.counts]
    strides, unknowns = grid.strides, math.prod(grid.counts)
    band = np.zeros((grid.band + 1, unknowns))
    order = sorted(range(3), key=lambda k: -strides[k])  # slowest axis first
    reach = range(1 - ORDER, ORDER)
    # `shift` and `s`: by how many places the second function is shifted along the slow, the middle and the
    # fast axis; 3!/(a! b! c!) is the product of binomials C(3, c) C(3 - c, a). Shifts that leave the grid
    # have integrals of zero: it does no harm that their offset may be that of other shifts on a narrow grid.
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
    """Sum over all ways to share `total` derivatives between two axes, for all pairs of functions."""
    shares = [math.comb(total, a) * np.outer(slow[a], middle[total - a]) for a in range(total + 1)]
    return np.sum(shares, axis=0)


def gram_tables(count: int) -> np.ndarray:
    r"""Integrals $\int B_j^{(r)} B_{j+m}^{(r)} du$ of `count` B-splines along one axis.

    Returns:
        Shape (4, 11, count): order of differentiation r, shift m + 5, function j. Zero where $j + m$ is no
        function; those at the ends are integrated over the cells within the grid alone.
    """
    found, powers = np.zeros((4, 2 * ORDER - 1, count)), np.arange(ORDER)
    polynomials = _POLYNOMIALS
    gram = 1.0 / (powers[:, None] + powers[None, :] + 1.0)  # integrals of u^p u^q from 0 to 1
    for r in range(4):
        local = polynomials @ gram @ polynomials.T
        for a, b in itertools.product(range(ORDER), repeat=2):
            # In every cell the b-th function meets the a-th, which is shifted by a - b against it.
            found[r, a - b + ORDER - 1, b : count - ORDER + 1 + b] += local[a, b]
        # The derivative of sum_p c_p u^p has the coefficients p c_p, one place to the left.
        polynomials = np.pad(polynomials[:, 1:] * powers[1:], ((0, 0), (0, 1)))
    return found
