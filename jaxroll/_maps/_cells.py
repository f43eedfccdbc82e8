"""Cells of a grid, halved again and again: which of them hold a change, and what stands between known points.

A level is one list of indices for each axis of the grid, its lines; between them lie its cells. Each level
has the lines of the one before, and one more in the middle of every cell that is wider than one step of the
grid. Any number of axes. `_adaptive` runs what is asked for here.
"""

from collections.abc import Callable, Sequence

import numpy as np

Lines = tuple[np.ndarray, ...]


def halved_lines(shape: Sequence[int], levels: int) -> list[Lines]:
    """Lines of all levels: every 2**levels-th index and the last one, then every half of it, down to all."""
    return [tuple(np.unique([*range(0, n, 2**k), n - 1]) for n in shape) for k in range(levels, -1, -1)]


class Spread:
    """Least and largest of what is known, where `known` is True; values elsewhere count for nothing."""

    def __init__(self, values: np.ndarray, known: np.ndarray) -> None:
        # Further axes of one point's value count one by one.
        seen = known.reshape(*known.shape, *(1,) * (values.ndim - known.ndim))
        if values.dtype.kind == "f":
            seen = seen & np.isfinite(values)
            ends = -np.inf, np.inf
        else:
            ends = np.iinfo(values.dtype).min, np.iinfo(values.dtype).max
        self.axes = known.ndim
        self.largest, self.least = np.where(seen, values, ends[0]), np.where(seen, values, ends[1])

    def exceeds(self, lines: Lines, tolerance: float) -> np.ndarray:
        """Which cells, their borders included, hold two known values further apart than this."""
        largest = _over_cells(np.maximum, self.largest, lines)
        least = _over_cells(np.minimum, self.least, lines)
        some = largest >= least
        with np.errstate(invalid="ignore"):  # infinity less infinity, where nothing is known
            apart: np.ndarray = some & (largest.astype(float) - least > tolerance)
        return np.any(apart.reshape(*apart.shape[: self.axes], -1), axis=-1)


def _over_cells(choose: np.ufunc, values: np.ndarray, lines: Lines) -> np.ndarray:
    """The extreme of every closed cell: one axis after the other."""
    for axis, at in enumerate(lines):
        # From each line to before the next one, then with that; the last stretch has its own end already.
        inside = choose.reduceat(values, at[:-1], axis=axis)
        values = choose(inside, np.take(values, at[1:], axis=axis))
    return values


def wanted_points(lines: list[Lines], changed: Callable[[Lines], np.ndarray]) -> np.ndarray:
    """Which points of the grid are to be known, given which cells hold a change by what is known so far.

    All of the coarsest level; and of a cell with a change, if it was made by splitting one, those of its
    halves. Points on a border belong to both sides, so that a change which leaves a cell that was split is
    followed into its neighbour, however coarse that one is.
    """
    wanted = np.zeros(tuple(len(at) for at in lines[-1]), bool)
    wanted[np.ix_(*lines[0])] = True
    there = np.ones(tuple(len(at) - 1 for at in lines[0]), bool)
    for coarse, fine in zip(lines[:-1], lines[1:], strict=True):
        split = there & changed(coarse)
        parents = [np.searchsorted(a, b[:-1], side="right") - 1 for a, b in zip(coarse, fine, strict=True)]
        there = split[np.ix_(*parents)]
        wanted[np.ix_(*fine)] |= _corners(there)
    return wanted


def _corners(cells: np.ndarray) -> np.ndarray:
    """The points at the corners of some cells."""
    for axis in range(cells.ndim):
        edge = [(0, 0)] * cells.ndim
        before, after = list(edge), list(edge)
        before[axis], after[axis] = (1, 0), (0, 1)
        cells = np.pad(cells, before) | np.pad(cells, after)
    return cells


def between(values: np.ndarray, known: np.ndarray, lines: list[Lines]) -> np.ndarray:
    """Values at all points of the grid: known ones as they are, others from the corners of their cell.

    Numbers are interpolated, linearly along each axis; of codes, all of which are the same there, one is
    taken.
    """
    block = values[np.ix_(*lines[0])]
    for coarse, fine in zip(lines[:-1], lines[1:], strict=True):
        for axis, (a, b) in enumerate(zip(coarse, fine, strict=True)):
            block = _stretched(block, axis, a, b)
        seen, own = known[np.ix_(*fine)], values[np.ix_(*fine)]
        block = np.where(seen.reshape(*seen.shape, *(1,) * (own.ndim - seen.ndim)), own, block)
    return block


def _stretched(block: np.ndarray, axis: int, coarse: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """Values along one axis at more lines."""
    below = np.searchsorted(coarse, fine, side="right") - 1
    above = np.minimum(below + 1, len(coarse) - 1)
    low = np.take(block, below, axis=axis)
    if block.dtype.kind != "f":
        return low
    gap = np.maximum(coarse[above] - coarse[below], 1)
    share = ((fine - coarse[below]) / gap).astype(block.dtype)
    share = share.reshape(*(-1 if k == axis else 1 for k in range(block.ndim)))
    high = np.take(block, above, axis=axis)
    with np.errstate(invalid="ignore"):  # infinity less infinity
        mixed = low + share * (high - low)
    # On a line the next one has no part, not even one that is NaN; between two infinities it is as they are.
    return np.where((share > 0.0) & (low != high), mixed, low)
