r"""Minimisation within limits: an augmented Lagrangian, many starts at once, one compiled program.

To minimise $f(x)$ with $g_i(x) \le 0$, the augmented Lagrangian

$$ f + \frac{1}{2\mu} \sum_i \left(\max(0, \lambda_i + \mu g_i)^2 - \lambda_i^2\right) $$

is descended for a chunk of steps (`_chunk`, with a method of `_descent`); then multipliers $\lambda$ and
weight $\mu$ are updated (`_judged`). A chunk is one call of a compiled program, which takes all starts;
between chunks Python prints progress, writes the checkpoint, and ends the loop when every start has settled.
`_fingertip` poses the problem.

Progress is printed here, not drawn by tqdm as a sweep's is, because it tells how the objective and the
violation fall, and a search that settles ends before its last step.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Int

from .._fingerprint import fingerprint
from .._linalg import larger
from .._results import check_instance, shown
from .._xla import quickly, soon
from ._descent import AbstractDescent, descent, Walk
from ._gradient import Mode, value_and_grad

STEPS_PER_CHUNK = 10
# A limit counts as kept if it is passed by less than this, relative to its bound.
KEPT = 1e-7
# The objective counts as unchanged if it changes by less than this in a chunk, relative to one plus its size.
_SETTLED = 1e-9
# Weight mu of the first chunk, and the largest one.
_FIRST_WEIGHT, _LAST_WEIGHT = 10.0, 1e5
# Sharpness of the first chunk; it doubles with every chunk, up to one.
_DULL = 0.05
# The weight stays as it is while a chunk reduces the largest excess to this share of what it was: the
# multipliers alone bring the search into its limits then.
_BETTER = 0.5

DesignProgress = bool | Callable[[int, float, float], None]


# `problem(x, data, sharpness)` returns the objective f, and the excess g: limits ask every entry to be <= 0.
# Sharpness rises to one during the search: objectives that smooth a largest value start out smoother.
DesignProblem = Callable[[Array, Any, Array], tuple[Array, Array]]


class Search(eqx.Module):
    r"""State of one start.

    Attributes:
        walk: The last point that was taken, and the next one to evaluate.
        value: Objective f at the last point taken.
        excess: g there, positive where a limit is passed.
        multipliers: Of the limits, $\lambda \ge 0$.
        weight: $\mu$ of the augmented Lagrangian.
        sharpness: Of the objective.
        best: The best point seen: the lowest value among those within limits, else the least violation.
        lowest: Objective there.
        violation: Largest excess there, at least zero.
        last: Objective at the end of the last chunk.
        passed: Largest excess at the end of the last chunk, at least zero.
        calm: For how many chunks the objective has hardly changed.
        done: Whether it has settled within the limits.
    """

    walk: Walk
    value: Float[Array, ""]
    excess: Float[Array, " k"]
    multipliers: Float[Array, " k"]
    weight: Float[Array, ""]
    sharpness: Float[Array, ""]
    best: Float[Array, " n"]
    lowest: Float[Array, ""]
    violation: Float[Array, ""]
    last: Float[Array, ""]
    passed: Float[Array, ""]
    calm: Int[Array, ""]
    done: Bool[Array, ""]


class Found(NamedTuple):
    """Where all starts ended, the steps taken, and the objective after each; shape (starts, steps)."""

    search: Search
    steps: int
    history: np.ndarray


def minimise(
    problem: DesignProblem,
    start: Float[Array, "starts n"],
    data: Any,
    *,
    optimiser: optax.GradientTransformation | None = None,
    steps: int,
    mode: Mode = "auto",
    in_turn: bool = False,
    progress: DesignProgress = False,
    checkpoint: str | Path | None = None,
    asked: dict[str, Any] | None = None,
) -> Found:
    r"""Minimise from many starts in one batch.

    The augmented Lagrangian $f + \frac{1}{2\mu} \sum_i (\max(0, \lambda_i + \mu g_i)^2 - \lambda_i^2)$ is
    descended for a chunk of ten steps; then $\lambda_i \leftarrow \max(0, \lambda_i + \mu g_i)$, and $\mu$
    grows threefold unless limits are kept or the chunk has halved the largest excess. A step is one
    evaluation with its gradient.

    Args:
        problem: Objective and excess, compiled once for each function and shape.
        start: One row per start.
        data: Any pytree that the functions need, with a leading axis of starts.
        optimiser: Any of optax; its steps are in the units of `start`. Default: `Bfgs`.
        steps: At most so many, rounded up to tens; ends also when every start has settled.
        mode: How to differentiate, as `value_and_grad` takes it.
        in_turn: Whether starts are taken one after the other instead of side by side.
        progress: True prints; a function is called with step, best value and violation after every chunk.
        checkpoint: A file that is written after every chunk, and read to begin with where it exists.
        asked: What the search depends on, by the names of the caller's arguments: a checkpoint of another
            search is refused.
    """
    method = descent(optimiser)
    search = _begin(problem, method, start, data)
    done, history = 0, []
    path = None if checkpoint is None else Path(checkpoint)
    marks = {} if path is None else {name: fingerprint(value) for name, value in (asked or {}).items()}
    if path is not None and path.exists():
        search, done, history = _restored(path, search, marks)
    report = progress if callable(progress) else (_printed if progress else None)
    while done < steps and not np.all(search.done):
        search, values = _advance(problem, method, search, data, mode=mode, in_turn=in_turn)
        history.append(np.asarray(values))
        done += STEPS_PER_CHUNK
        if path is not None:
            _saved(path, search, done, history, marks)
        if report is not None:
            report(done, float(np.min(search.lowest)), float(np.min(search.violation)))
    rows = np.concatenate(history, axis=1) if history else np.zeros((start.shape[0], 0))
    return Found(search, done, rows)


def _printed(step: int, value: float, violation: float) -> None:
    """The report of `progress=True`: the best objective, and the least violation, of all starts."""
    print(f"step {step}: objective {value:.6g}, limits passed by {violation:.1e}")


def _begin(problem: DesignProblem, method: AbstractDescent, start: Array, data: Any) -> Search:
    """The state of every start before anything is evaluated."""
    # How many limits there are is known from shapes alone, without running the problem.
    one = jax.tree.map(lambda a: a[0], (start, data))
    _, excess = jax.eval_shape(problem, *one, jnp.ones((), start.dtype))
    return _fresh(method, start, excess.shape)


@quickly
def _fresh(method: AbstractDescent, start: Array, limits: tuple[int, ...]) -> Search:
    """The state of every start of a problem with so many limits."""

    def each(x: Array) -> Search:
        far, zeros = jnp.full((), jnp.inf, x.dtype), jnp.zeros(limits, x.dtype)
        weight, dull = jnp.full((), _FIRST_WEIGHT, x.dtype), jnp.full((), _DULL, x.dtype)
        # Not `jnp.array(0)`, of a weak type: a checkpoint does not keep that, and would be compiled for anew.
        walk, none, off = method.begin(x), jnp.zeros((), int), jnp.array(False)
        return Search(walk, far, zeros, zeros, weight, dull, x, far, far, far, far, none, off)

    return jax.vmap(each)(start)


@soon
def _advance(
    problem: DesignProblem,
    method: AbstractDescent,
    search: Search,
    data: Any,
    *,
    mode: Mode,
    in_turn: bool,
) -> tuple[Search, Array]:
    """One chunk of all starts, and the objective after each of its steps, shape (starts, steps)."""
    one = lambda search, data: _chunk(problem, method, mode, search, data)  # noqa: E731
    if in_turn:
        return jax.lax.map(lambda pair: one(*pair), (search, data))
    return jax.vmap(one)(search, data)


def _chunk(
    problem: DesignProblem, method: AbstractDescent, mode: Mode, search: Search, data: Any
) -> tuple[Search, Array]:
    """One chunk of one start: ten steps of the method on a fixed augmented Lagrangian, then its update."""
    multipliers, weight, sharpness = search.multipliers, search.weight, search.sharpness

    def lagrangian(x: Array) -> tuple[Array, Any]:
        value, excess = problem(x, data, sharpness)
        pushed = larger(multipliers + weight * excess, 0.0)
        return value + jnp.sum(pushed**2 - multipliers**2) / (2.0 * weight), (value, excess)

    def step(now: Search, _: None) -> tuple[Search, Array]:
        # One evaluation: every point that is looked at may be the best one, taken or not.
        (cost, seen), slope = value_and_grad(lagrangian, mode, has_aux=True)(now.walk.trial)
        now = _kept(now, *seen)
        walk, taken = method.ahead(now.walk, cost, slope, lambda x: lagrangian(x)[0])
        value, excess = (jnp.where(taken, a, b) for a, b in zip(seen, (now.value, now.excess), strict=True))
        now = eqx.tree_at(lambda s: (s.walk, s.value, s.excess), now, (walk, value, excess))
        return now, value

    # Multipliers, weight or sharpness have changed since the last chunk: the last point is evaluated again.
    search = eqx.tree_at(lambda s: s.walk, search, method.again(search.walk))
    search, values = jax.lax.scan(step, search, None, length=STEPS_PER_CHUNK)
    return _judged(method, search), values


def _judged(method: AbstractDescent, search: Search) -> Search:
    """After a chunk: new multipliers and weight, and whether the start has settled."""
    excess, value, weight = search.excess, search.value, search.weight
    worst = jnp.maximum(jnp.max(excess), 0.0)
    # First-order update: the new multipliers are the slopes of the penalty, so the point stays stationary.
    multipliers = jnp.maximum(0.0, search.multipliers + weight * excess)
    multipliers = jnp.where(jnp.isfinite(multipliers), multipliers, 0.0)
    heavier = (worst > KEPT) & (worst > _BETTER * search.passed)
    weight = jnp.where(heavier, jnp.minimum(3.0 * weight, _LAST_WEIGHT), weight)
    still = jnp.abs(value - search.last) <= _SETTLED * (1.0 + jnp.abs(value))
    calm = jnp.where(still, search.calm + 1, 0)
    # A method that stands still, though the multipliers have changed, may be held back by what it remembers
    # of the function before: its memory is emptied.
    fresh, memory = method.fresh(search.walk.x), search.walk.memory
    memory = jax.tree.map(lambda a, b: jnp.where(still, a, b), fresh, memory)
    settled = (search.violation <= KEPT) & (worst <= KEPT) & (calm >= 2) & (search.sharpness == 1.0)
    sharper = jnp.minimum(2.0 * search.sharpness, 1.0)
    where = lambda s: (s.multipliers, s.weight, s.sharpness, s.last, s.passed, s.calm, s.walk.memory, s.done)  # noqa: E731
    news = (multipliers, weight, sharper, value, worst, calm, memory, search.done | settled)
    return eqx.tree_at(where, search, news)


def _kept(search: Search, value: Array, excess: Array) -> Search:
    """The search with the point just evaluated as its best one, where it is better.

    A point within the limits is better than one outside; of two within, that with the lower objective; of two
    outside, that with the smaller violation.
    """
    violation = jnp.maximum(jnp.max(excess), 0.0)
    inside, was = violation <= KEPT, search.violation <= KEPT
    better = jnp.where(inside & was, value < search.lowest, violation < search.violation)
    better = (better | (inside & ~was)) & jnp.isfinite(value)
    new = (search.walk.trial, value, violation)
    old = (search.best, search.lowest, search.violation)
    best = jax.tree.map(lambda a, b: jnp.where(better, a, b), new, old)
    return eqx.tree_at(lambda s: (s.best, s.lowest, s.violation), search, best)


def _saved(path: Path, search: Search, steps: int, history: list[np.ndarray], marks: dict[str, str]) -> None:
    """Write the checkpoint: what the search depends on, steps taken, history, state of every start."""
    part = path.with_suffix(path.suffix + ".part")
    with part.open("wb") as file:
        np.save(file, np.array(list(marks.items()), str).reshape(-1, 2))
        np.save(file, np.array(steps))
        np.save(file, np.concatenate(history, axis=1))
        eqx.tree_serialise_leaves(file, search)
    part.replace(path)  # in one step: a search that is cut off while writing leaves the previous file whole


def check_checkpoint(path: Any) -> None:
    """Raise unless a checkpoint could be written there, before hours of work are to be saved."""
    check_instance("checkpoint", path, (str, Path), "the path of a file")
    folder = Path(path).parent
    # `_saved` writes beside it, under a name that is longer by a few letters.
    if (
        len(os.fsencode(Path(path).name)) > 240
        or os.path.isdir(path)
        or not os.access(folder, os.W_OK)
        or not os.path.isdir(folder)
    ):
        raise ValueError(f"argument checkpoint must be a file in a folder to write to, but was {shown(path)}")


def _restored(path: Path, like: Search, marks: dict[str, str]) -> tuple[Search, int, list[np.ndarray]]:
    """Read a checkpoint of a search with these marks, whose arrays have the shapes of those in `like`."""
    try:
        with path.open("rb") as file:
            there = dict(np.load(file).tolist())
            steps, history = int(np.load(file)), np.load(file)
            # Where another optimiser or number of starts was asked for, the arrays have other shapes too.
            others = [name for name in marks if there.get(name) != marks[name]]
            search = like if others else eqx.tree_deserialise_leaves(file, like)
    except Exception as error:  # whatever NumPy and equinox make of bytes that are not theirs
        raise ValueError(
            f"argument checkpoint must be a new file, or of a search like this one, but was {shown(path)}"
        ) from error
    if others:
        raise ValueError(
            f"argument checkpoint must be a new file, or of a search like this one, but {shown(path)} is of "
            f"one with another {', '.join(others)}"
        )
    return search, steps, [history]
