r"""Maps over parameters: coarse first, then refined where a code or a value changes.

A boundary between two outcomes is a line in a map of two parameters, so that of $N^2$ points only some N
decide where it runs. `_cells` says which points are wanted, given the outcomes known so far; here they are
run, in chunks of one compiled program, until no more are wanted.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool
from tqdm import tqdm

from .._printing import shown_value
from .._results import (
    as_count,
    as_floats,
    check_callable,
    check_flag,
    check_instance,
    is_array_like,
    on_host,
    shown,
)
from .._sweep import answer, as_now, Parameters
from .._xla import WIDE
from ._cells import between, halved_lines, Spread, wanted_points

# Runs in a chunk by default: fewer than in a sweep, since part of each round's last chunk is run for nothing.
_CHUNK = 256
# The most halvings: a coarse cell of 2^20 steps along each axis is as large as any grid.
_MOST_LEVELS = 20


class AdaptiveMap(eqx.Module):
    """Outcomes over a grid of parameters, with what was run for it.

    Attributes:
        parameters: The grid.
        values: What the outcome returned, with the axes of the grid first; filled in where nothing was run.
        ran: Shape of the grid: which points were run.
        spent: How many runs the program did: those of `ran`, and copies that filled the last chunk of a
            round.
    """

    parameters: Parameters
    values: Any
    ran: Bool[np.ndarray, "..."]
    spent: int

    @property
    def runs(self) -> int:
        """How many points were run."""
        return int(self.ran.sum())

    def __repr__(self) -> str:
        laid = " x ".join(map(str, self.parameters.shape))
        share = self.runs / self.ran.size
        return f"AdaptiveMap({laid} points, {self.runs} of them run ({share:.1%}); {_told(self.values)})"


@on_host
def adaptive_map(
    outcome: Callable[[Parameters], Any],
    grid: Parameters,
    *,
    levels: int = 4,
    tolerance: Any = None,
    chunk: int = _CHUNK,
    progress: bool = False,
) -> AdaptiveMap:
    r"""An outcome over a grid of parameters, run at few of its points and near all changes that these show.

    First every 2**levels-th point along each axis is run. Then each cell between such points is halved along
    all axes, and the new points are run, wherever the points known on it or on its border differ in a code,
    or in a value by more than its tolerance; and so on, down to the cells of the grid. A cell that was left
    whole is halved later where a neighbour's point on their border differs. So a boundary that is met
    anywhere is followed to both of its ends, and each point of it lies between two neighbouring points of the
    grid that were run.

    **What is missed**: whatever no point shows. A region that lies between the coarse points, so narrower
    than 2**levels steps of the grid along some axis, and does not reach one of them or a boundary that is
    followed, is not in the map. Fewer `levels` leave less to chance, and cost more.

    Args (daily use):
        outcome: From one row of the parameters, `p.damping`, to a pytree of arrays, by JAX operations: such
            as `simulate(*make(p), t1, throw=False).result` or `stability.assess(*make(p)).verdict`. Whole
            numbers, truth values and codes are codes (make a count floating), and so is whether a value with
            a tolerance is a number, NaN, or infinite with either sign.
        grid: From `Parameters.grid`, or products of such, with values that rise or fall along each axis.
        levels: How often a coarse cell is halved.
        tolerance: For floating values, one number for all or by name where the outcome is a dict: cells are
            halved where they change by more. Default: only codes decide, and values are interpolated.
    Args (rarely changed):
        chunk: Runs per program call; each round of halving fills its last chunk with repeated runs.
        progress: Whether to report runs and speed on standard error; their number is not known beforehand.

    Returns:
        An `AdaptiveMap`. At points that were not run, a code is the one that all corners of the cell have,
        and a value is interpolated between the corners, linearly in the indices of the grid.
        `plotting.parameter_map(found.parameters, found.values)` draws one code or value of it.

    Raises:
        ValueError: If an argument does not fit, or the outcome has neither a code nor a value with a
            tolerance.

    Accuracy: over 320 x 320 pinches (friction, radius of the fingertips; `python -m benchmarks.maps`) the map
    is that of all 102400 runs at every point.

    Example:
        >>> import numpy as np
        >>> import jaxroll as jxr
        >>> grid = jxr.Parameters.grid(x=np.linspace(-1.0, 1.0, 129), y=np.linspace(-1.0, 1.0, 129))
        >>> disc = jxr.adaptive_map(lambda p: p.x**2 + p.y**2 < 0.5, grid)
        >>> inside = grid.shaped(grid.x**2 + grid.y**2 < 0.5)
        >>> bool((disc.values == inside).all()), disc.runs < grid.rows / 5
        (True, True)
    """
    check_callable("outcome", outcome, "a function of one row of parameters", takes=1)
    check_instance("grid", grid, Parameters, "Parameters on a grid, from `Parameters.grid`")
    if min(grid.shape) < 2:
        raise ValueError(f"argument grid must have two values or more along each axis, but had {grid.shape}")
    levels = as_count("levels", levels, least=0, most=_MOST_LEVELS)
    if levels:
        _check_order(grid)
    size = as_count("chunk", chunk, most=sys.maxsize)
    check_flag("progress", progress)
    program = _Program(outcome, grid, min(size, grid.rows))
    limits = _limits(program.results, tolerance)
    known, found = (
        np.zeros(grid.shape, bool),
        [np.zeros((*grid.shape, *x.shape), x.dtype) for x in program.leaves],
    )
    lines, spent = halved_lines(grid.shape, levels), 0
    with tqdm(disable=not progress, unit=" runs", bar_format="{n} runs, {rate_noinv_fmt}") as meter:
        while True:
            spreads = _spreads(found, known, limits)
            wanted = wanted_points(lines, lambda at: _any_exceeds(spreads, at))  # noqa: B023
            todo = np.flatnonzero(wanted & ~known)
            if not todo.size:
                break
            for count in program.run(todo, found):
                spent += program.size
                meter.update(count)
            known.flat[todo] = True
    filled = [between(values, known, lines) for values in found]
    return AdaptiveMap(grid, jax.tree.unflatten(program.structure, filled), known, spent)


def _check_order(grid: Parameters) -> None:
    """Raise where the values along an axis neither rise nor fall: then nothing lies between its points."""
    for names in grid.axes:
        along = {name: np.asarray(grid.axis(name)) for name in names}
        if not any(values.ndim > 1 or _is_ordered(values.astype(float)) for values in along.values()):
            name, values = next(iter(along.items()))
            raise ValueError(
                f"argument grid must have values that rise or fall along each axis, unless levels = 0, but "
                f"{name} was {shown(values)}"
            )


def _is_ordered(values: np.ndarray) -> bool:
    steps = np.diff(values)
    return bool(np.all(steps >= 0.0) or np.all(steps <= 0.0))


def _any_exceeds(spreads: list[tuple[Spread, float]], lines: Any) -> np.ndarray:
    return np.any([spread.exceeds(lines, limit) for spread, limit in spreads], axis=0)


def _spreads(
    found: list[np.ndarray], known: np.ndarray, limits: list[float | None]
) -> list[tuple[Spread, float]]:
    """What decides where to refine, with limits: codes, values, and codes of values that are not finite."""
    spreads = []
    for values, limit in zip(found, limits, strict=True):
        if values.dtype.kind != "f":
            spreads.append((Spread(values.astype(np.int64), known), 0.0))
        elif limit is not None:
            spreads.append((Spread(values, known), limit))
            spreads.append((Spread(_endless(values), known), 0.0))
    return spreads


def _endless(values: np.ndarray) -> np.ndarray:
    """A code that tells infinity, minus infinity and NaN from each other, and from numbers, which have 0."""
    signs = np.where(np.isinf(values), np.sign(values), 0.0)
    return np.where(np.isnan(values), 2.0, signs).astype(np.int64)


def _limits(results: Any, tolerance: Any) -> list[float | None]:
    """The tolerance of each array of an outcome; None where a value decides nothing."""
    named = isinstance(tolerance, Mapping)
    if named and not (isinstance(results, dict) and set(tolerance) <= set(results)):
        known = list(results) if isinstance(results, dict) else "no names"
        raise ValueError(
            f"argument tolerance must be for names that the outcome has, {shown(known)}, but was for "
            f"{shown(list(tolerance))}"
        )
    # Every tolerance is checked, also one for codes, which have no use for it.
    each = {name: _tolerance(given) for name, given in tolerance.items()} if named else _tolerance(tolerance)
    limits = []
    for path, form in jax.tree.leaves_with_path(results):
        limit = each.get(path[0].key) if isinstance(each, dict) else each
        limits.append(limit if form.dtype.kind == "f" else None)
    if all(limit is None for limit in limits) and all(x.dtype.kind == "f" for x in jax.tree.leaves(results)):
        raise ValueError(
            "argument tolerance must be given where the outcome has floating values but no codes, and was not"
        )
    return limits


def _tolerance(value: Any) -> float | None:
    if value is None:
        return None
    limit = float(as_floats("tolerance", value, ()))
    if limit < 0.0:
        raise ValueError(f"argument tolerance must not be negative, but was {shown(limit)}")
    return limit


def _outcome_of(outcome: Callable, row: Any) -> Any:
    """What the outcome returns for one row, checked."""
    found, leaves = answer("outcome", outcome, row)
    if not leaves or not all(map(_is_real, leaves)):
        raise ValueError(f"argument outcome must return arrays of real numbers, but returned {shown(found)}")
    return found


def _is_real(leaf: Any) -> bool:
    # The dtype of keys of `jax.random` has no kind.
    kind = getattr(leaf.dtype, "kind", "V") if is_array_like(leaf) else "V"
    return isinstance(leaf, bool | int | float) or kind in "fiub"


class _Program:
    """The outcome of a chunk of rows, compiled once."""

    def __init__(self, outcome: Callable, grid: Parameters, size: int) -> None:
        self.grid, self.size = grid, size
        # JAX keeps the trace of a run by the identity of its functions, though what these hold may change.
        with as_now(outcome):
            traced = jax.jit(jax.vmap(lambda p: _outcome_of(outcome, p)), compiler_options=WIDE).trace(
                self._rows(np.zeros(size, int))
            )
        self.results = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), traced.out_info)
        self.leaves, self.structure = jax.tree.leaves(self.results), jax.tree.structure(self.results)
        self._call = traced.lower().compile()

    def _rows(self, index: np.ndarray) -> Any:
        return jax.tree.map(lambda x: jax.device_put(x[index]), self.grid)

    def run(self, todo: np.ndarray, found: list[np.ndarray]) -> Iterator[int]:
        """Run rows, put their outcomes into the arrays of the map, and yield how many each chunk had."""
        for start in range(0, len(todo), self.size):
            # Copies of the last row fill the last chunk.
            index = todo[np.minimum(np.arange(start, start + self.size), len(todo) - 1)]
            pieces = jax.tree.leaves(self._call(self._rows(index)))
            for values, piece in zip(found, pieces, strict=True):
                values.reshape(self.grid.rows, *piece.shape[1:])[index] = np.asarray(piece)
            yield min(self.size, len(todo) - start)


def _told(values: Any) -> str:
    if isinstance(values, dict):
        return ", ".join(f"{name}: {shown_value(value)}" for name, value in values.items())
    return shown_value(values)
