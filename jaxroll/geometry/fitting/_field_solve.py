r"""Least squares for a scalar field of B-splines on a grid of any size: conjugate gradients. NumPy, SciPy.

The quadratic form is that of `fit_surface`'s docstring, as in `_field_fit`, whose banded matrix grows with
the square of the grid's cross-section. Here nothing is assembled but the rows of the data; roughness is
applied axis by axis, since its matrix is a sum of Kronecker products. The preconditioner adds up the
corrections of grids each twice as coarse as the one before, scaled by their diagonals, and the exact one of
the coarsest (Bramble, Pasciak and Xu, 1990): a quintic B-spline is a sum of seven of half its width, with
weights $\binom{6}{k}/32$.
"""

import math
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from ..surfaces import ORDER
from ._field_fit import AXES, gram_tables, Grid, rows

_COARSEST = 6  # a grid with no more cells along its longest axis is the coarsest
_FEW = 1500  # points by which the preconditioner knows the data
_ENOUGH = 1e-4  # residual relative to the right-hand side at which the iteration stops
_MOST = 30  # iterations
_TWO_SCALES = np.array([math.comb(ORDER, k) / 2.0 ** (ORDER - 1) for k in range(ORDER + 1)])
# 3! / (a! b! c!) for the orders of differentiation along the axes of |D^3 F|^2.
_SHARES = [
    ((a, b, 3 - a - b), 6.0 / (math.factorial(a) * math.factorial(b) * math.factorial(3 - a - b)))
    for a in range(4)
    for b in range(4 - a)
]


@dataclass(frozen=True)
class FieldTargets:
    """What a field shall be at points.

    Attributes:
        points: Shape (n, 3) [m].
        heights: Values of the field there [m], shape (n,).
        weights: Areas by which their squares count [m^2], shape (n,).
        normals: Gradients, shape (n, 3); not looked at where `slopes` is zero.
        slopes: Areas by which the squares of the gradients' errors count, shape (n,) [m^2].
        length: Factor of the gradient's error along the normal.
    """

    points: np.ndarray
    heights: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    slopes: np.ndarray
    length: float

    def sparser(self, count: int) -> "FieldTargets":
        """Every k-th point, k as large as leaves `count`, with k times the weight."""
        k = max(len(self.points) // count, 1)
        each = slice(None, None, k)
        weights, slopes = k * self.weights[each], k * self.slopes[each]
        return FieldTargets(
            self.points[each], self.heights[each], weights, self.normals[each], slopes, self.length
        )


def solved(grid: Grid, targets: FieldTargets, roughness: float, start: np.ndarray) -> np.ndarray:
    """Coefficients of the field of least squares, in the shape of the grid's counts [m].

    Args:
        grid: The functions.
        targets: Data; weights are areas.
        roughness: Factor of the integral of the squared third derivatives, lengths counted in cells.
        start: Coefficients to start from [m].
    """
    from scipy.sparse import linalg

    # By name: its stubs do not know the keywords.
    operator: Any = linalg.LinearOperator
    matrix, right = _data(grid, targets)
    levels = _levels(grid, targets.sparser(_FEW), roughness)
    finest, shape, size = levels[0], grid.counts, math.prod(grid.counts)

    def form(x: np.ndarray) -> np.ndarray:
        return matrix.T @ (matrix @ x) + roughness * finest.rough(x.reshape(shape)).ravel()

    def precondition(residual: np.ndarray) -> np.ndarray:
        return _corrected(levels, residual.reshape(shape)).ravel()

    found, _ = linalg.cg(
        operator((size, size), matvec=form, dtype=float),
        matrix.T @ right,
        x0=start.ravel() / grid.step,
        rtol=_ENOUGH,
        maxiter=_MOST,
        M=operator((size, size), matvec=precondition, dtype=float),
    )
    return found.reshape(shape) * grid.step


def values_matrix(grid: Grid, points: np.ndarray) -> Any:
    """The matrix from coefficients to values of the field at points [m]."""
    functions = rows(grid, points).field((0, 0, 0))
    return _sparse(_places(grid, points), functions, math.prod(grid.counts))


def _places(grid: Grid, points: np.ndarray) -> np.ndarray:
    """Numbers of the 216 functions that are not zero at each point, the last axis running fastest."""
    cell = np.floor((points - grid.origin) / grid.step).astype(int)
    cell = np.clip(cell, 0, np.array(grid.counts) - ORDER)
    near = [np.arange(ORDER).reshape([-1 if i == k else 1 for i in range(3)]) for k in range(3)]
    _, middle, fast = grid.counts
    around = ((near[0] * middle + near[1]) * fast + near[2]).ravel()
    return ((cell[:, 0] * middle + cell[:, 1]) * fast + cell[:, 2])[:, None] + around[None, :]


def _sparse(places: np.ndarray, values: np.ndarray, unknowns: int) -> Any:
    """Rows of values, shape (n, 216), at the places of their unknowns."""
    from scipy.sparse import csr_matrix

    starts = np.arange(0, values.size + 1, values.shape[1])
    return csr_matrix((values.ravel(), places.astype(np.int32).ravel(), starts), (len(values), unknowns))


def _data(grid: Grid, targets: FieldTargets) -> tuple[Any, np.ndarray]:
    """Rows of the data, scaled by the roots of their weights, and what they shall be; lengths in cells."""
    from scipy.sparse import vstack

    data, places = rows(grid, targets.points), _places(grid, targets.points)
    root = np.sqrt(targets.weights) / grid.step
    values = data.field((0, 0, 0)) * root[:, None]
    part = np.nonzero(targets.slopes > 0.0)[0]
    normals = targets.normals[part]
    gradients = np.stack([data.field(axis, part) for axis in AXES], axis=1)
    # G = (1 - (1 - length) n n^T) times the root of the weight, which takes n to `length` n.
    along = np.einsum("nk,nkj->nj", normals, gradients)
    gradients -= (1.0 - targets.length) * normals[:, :, None] * along[:, None, :]
    slope = np.sqrt(targets.slopes[part]) / grid.step
    gradients *= slope[:, None, None]
    unknowns = math.prod(grid.counts)
    matrix = vstack(
        [
            _sparse(places, values, unknowns),
            _sparse(np.repeat(places[part], 3, axis=0), gradients.reshape(-1, ORDER**3), unknowns),
        ],
        format="csr",
    )
    wanted = targets.length * slope[:, None] * normals
    return matrix, np.concatenate([root * targets.heights / grid.step, wanted.ravel()])


@dataclass(frozen=True)
class _Level:
    """One grid of the preconditioner.

    Attributes:
        grams: Of each axis, for derivatives of order 0 to 3, the sparse matrix of their products' integrals.
        finer: Of each axis, the sparse matrix from this grid's coefficients to those of the next finer one.
        diagonal: Of the whole form.
        factor: Cholesky's factor of the whole form, on the coarsest grid alone.
    """

    grams: list[list[Any]]
    finer: list[Any]
    diagonal: np.ndarray
    factor: np.ndarray | None

    def rough(self, x: np.ndarray) -> np.ndarray:
        """The matrix of the integral of the squared third derivatives times coefficients."""
        sums: dict[int, np.ndarray | float] = {a: 0.0 for a in range(4)}
        inner = [_along(gram, x, 2) for gram in self.grams[2]]
        for (a, b, c), share in _SHARES:
            sums[a] = sums[a] + share * _along(self.grams[1][b], inner[c], 1)
        return np.sum([_along(self.grams[0][a], np.asarray(sums[a]), 0) for a in range(4)], axis=0)


def _levels(grid: Grid, targets: FieldTargets, roughness: float) -> list[_Level]:
    """The grid and coarser ones, each of cells twice as wide from the same corner on."""
    from scipy.sparse import csr_matrix

    # Sparse, of eleven diagonals: as dense products by BLAS's threads the iteration took twice as long.
    levels, scale = [], 1.0
    finer: list[Any] = [csr_matrix(np.eye(n)) for n in grid.counts]
    while True:
        cells = [n - ORDER + 1 for n in grid.counts]
        grams = [[csr_matrix(gram) for gram in _gram_matrices(n)] for n in grid.counts]
        last = max(cells) <= _COARSEST or min(cells) == 1
        # Lengths count in cells of the finest grid: scale^3 of the volume over scale^6 of the derivatives.
        rough = roughness * scale**-3
        diagonal, factor = _form(grid, targets, grams, rough, scale, whole=last)
        levels.append(_Level(grams, finer, diagonal, factor))
        if last:
            return levels
        finer = [csr_matrix(_two_scales(n)) for n in cells]
        counts = [m.shape[1] for m in finer]
        scale *= 2.0
        grid = Grid(grid.origin, 2.0 * grid.step, (counts[0], counts[1], counts[2]))


def _form(
    grid: Grid, targets: FieldTargets, grams: list[list[Any]], rough: float, scale: float, *, whole: bool
) -> tuple[np.ndarray, np.ndarray | None]:
    """Diagonal of the form on one grid, in the shape of its counts; if `whole`, its lower factor too."""
    from scipy.linalg import cholesky

    matrix, _ = _data(grid, targets)
    # `_data` divides by the width of its own cells, but lengths count in the finest ones: rows of values are
    # multiplied by the scale. In rows of slopes the width cancels.
    matrix.data[: matrix.indptr[len(targets.points)]] *= scale
    if not whole:
        squares = np.bincount(matrix.indices, matrix.data**2, minlength=math.prod(grid.counts))
        diagonal = squares.reshape(grid.counts)
        for orders, share in _SHARES:
            lines = [gram[order].diagonal() for gram, order in zip(grams, orders, strict=True)]
            diagonal = diagonal + rough * share * np.einsum("i,j,k->ijk", *lines)
        return diagonal, None
    dense = matrix.toarray()
    form = dense.T @ dense
    for orders, share in _SHARES:
        along = (gram[order].toarray() for gram, order in zip(grams, orders, strict=True))
        form += rough * share * reduce(np.kron, along)
    form[np.diag_indices_from(form)] += 1e-12 * np.max(np.diag(form))
    return np.diag(form).reshape(grid.counts), cholesky(form, lower=True, check_finite=False)


def _corrected(levels: list[_Level], residual: np.ndarray) -> np.ndarray:
    """The preconditioner: corrections of all grids, added up."""
    from scipy.linalg import cho_solve

    residuals = [residual]
    for level in levels[1:]:
        residuals.append(reduce(lambda x, k: _along(level.finer[k].T, x, k), range(3), residuals[-1]))
    coarsest = levels[-1]
    assert coarsest.factor is not None
    found = cho_solve((coarsest.factor, True), residuals[-1].ravel(), check_finite=False)
    found = found.reshape(residuals[-1].shape)
    for number in range(len(levels) - 2, -1, -1):
        finer = levels[number + 1].finer
        found = reduce(lambda x, k: _along(finer[k], x, k), range(3), found)
        found = found + residuals[number] / levels[number].diagonal
    return found


def _along(matrix: Any, x: np.ndarray, axis: int) -> np.ndarray:
    """A sparse matrix applied along one axis of an array."""
    front = np.moveaxis(x, axis, 0)
    found = matrix @ np.ascontiguousarray(front).reshape(len(front), -1)
    return np.moveaxis(found.reshape(-1, *front.shape[1:]), 0, axis)


def _two_scales(cells: int) -> np.ndarray:
    """The matrix from coefficients on cells twice as wide to those on a number of cells."""
    found = np.zeros((cells + ORDER - 1, (cells + 1) // 2 + ORDER - 1))
    for j in range(found.shape[1]):
        for k, weight in enumerate(_TWO_SCALES):
            # Function j begins 5 cells before cell j of its own grid.
            i = 2 * j - ORDER + 1 + k
            if 0 <= i < len(found):
                found[i, j] = weight
    return found


def _gram_matrices(count: int) -> np.ndarray:
    """Integrals of products of `count` functions' derivatives of order 0 to 3, shape (4, count, count)."""
    table, found = gram_tables(count), np.zeros((4, count, count))
    for shift in range(1 - ORDER, ORDER):
        j = np.arange(max(0, -shift), min(count, count - shift))
        found[:, j, j + shift] = table[:, shift + ORDER - 1, j]
    return found
