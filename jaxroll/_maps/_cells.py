"""Cells of a grid, halved again and again: which of them hold a change, and values between known points.

A level has for each axis of the grid a list of indices, its lines; between these lie its cells. Each level
has the lines of the one before, and those half way between them. The last cell of an axis may be narrower
than the others, and is then halved later. A grid may have any number of axes. `_adaptive` runs the points
that are wanted here.
"""

from collections.abc import Callable, Sequence

import numpy as np

Lines = tuple[np.ndarray, ...]


def halved_lines(shape: Sequence[int], levels: int) -> list[Lines]:
    """Lines of all levels: every 2**levels-th index and the last one, with half that step each time, to 1."""
    return [tuple(np.unique([*range(0, n, 2**k), n - 1]) for n in shape) for k in range(levels, -1, -1)]


class Spread:
    """Least and largest of the values in each cell, of those that are `known` and finite."""

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
        # `reduceat` takes a cell from its first line up to the second one, which is added here. Its last
        # stretch goes to the end of the axis, and so holds that line already.
        inside = choose.reduceat(values, at[:-1], axis=axis)
        values = choose(inside, np.take(values, at[1:], axis=axis))
    return values


def wanted_points(lines: list[Lines], changed: Callable[[Lines], np.ndarray]) -> np.ndarray:
    """Which points of the grid are to be known, given which cells hold a change by what is known so far.

    These are all points of the coarsest level, and the corners of the halves of every cell that holds a
    change and is one of the coarsest, or a half of another such cell. A point on a border belongs to the
    cells on both sides, so that a change that leaves a halved cell is followed into the next one, however
    coarse.
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
    """Values at more lines along one axis."""
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
    # On a line the next one has no share, and must not pass on its NaN; two equal infinities give no NaN.
    return np.where((share > 0.0) & (low != high), mixed, low)
