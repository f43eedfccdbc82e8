"""Minimisation within limits: any optax optimiser inside an augmented Lagrangian, many starts at once."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float, Int

CHUNK = 10
# Violations below this count as kept, relative to the bound.
KEPT = 1e-7
# A start is done when its value changes by less in a chunk, within its limits.
_SETTLED = 1e-9
_FIRST_WEIGHT, _LAST_WEIGHT = 10.0, 1e5

Progress = bool | Callable[[int, float, float], None]


# `problem(x, data)`: the objective over a vector, and the excess, every entry of which is to be <= 0.
Problem = Callable[[Array, Any], tuple[Array, Array]]


class Search(eqx.Module):
    r"""State of one start.

    Attributes:
        x: Where it is; shape (n,).
        memory: State of the optimiser.
        multipliers: Of the limits, $\lambda \ge 0$.
        weight: $\mu$ of the augmented Lagrangian.
        best: The best point seen: the lowest value among those within limits, else the least violation.
        value: Objective there.
        violation: Largest excess there, at least zero.
        last: Objective at the end of the last chunk.
        calm: For how many chunks it has hardly changed.
        done: Whether it has settled within the limits.
    """

    x: Float[Array, " n"]
    memory: Any
    multipliers: Float[Array, " k"]
    weight: Float[Array, ""]
    best: Float[Array, " n"]
    value: Float[Array, ""]
    violation: Float[Array, ""]
    last: Float[Array, ""]
    calm: Int[Array, ""]
    done: Bool[Array, ""]


class Found(NamedTuple):
    """Where all starts ended, the steps taken, and the objective before each; shape (starts, steps)."""

    search: Search
    steps: int
    history: np.ndarray


def minimise(
    problem: Problem,
    start: Float[Array, "starts n"],
    data: Any,
    *,
    optimiser: optax.GradientTransformation,
    steps: int,
    progress: Progress = False,
    checkpoint: str | Path | None = None,
) -> Found:
    r"""Minimise from many starts in one batch.

    The augmented Lagrangian $f + \frac{1}{2\mu} \sum_i (\max(0, \lambda_i + \mu g_i)^2 - \lambda_i^2)$ is
    descended for a chunk of ten steps; then $\lambda_i \leftarrow \max(0, \lambda_i + \mu g_i)$, and $\mu$
    grows threefold where a limit is still passed.

    Args:
        problem: Objective and excess, compiled once for each function and shape.
        start: One row per start.
        data: Any pytree that the functions need, with a leading axis of starts.
        optimiser: Any of optax; its learning rate is in units of `start`.
        steps: At most so many, rounded up to tens; ends also when every start has settled.
        progress: True prints; a function is called with step, best value and violation after every chunk.
        checkpoint: A file that is written after every chunk, and read to begin with where it exists.
    """
    method = optax.with_extra_args_support(optimiser)
    search = _begin(problem, method, start, data)
    done, history = 0, []
    path = None if checkpoint is None else Path(checkpoint)
    if path is not None and path.exists():
        search, done, history = _restored(path, search)
    report = progress if callable(progress) else (_printed if progress else None)
    while done < steps and not bool(jnp.all(search.done)):
        search, values = _advance(problem, method, search, data)
        history.append(np.asarray(values))
        done += CHUNK
        if path is not None:
            _saved(path, search, done, history)
        if report is not None:
            report(done, float(jnp.min(search.value)), float(jnp.min(search.violation)))
    rows = np.concatenate(history, axis=1) if history else np.zeros((start.shape[0], 0))
    return Found(search, done, rows)


def _printed(step: int, value: float, violation: float) -> None:
    print(f"step {step}: objective {value:.6g}, limits passed by {violation:.1e}")


def _lagrangian(problem: Problem, search: Search, data: Any) -> Callable[[Array], tuple[Array, Any]]:
    """Cost; beside it the objective and the excess."""

    def function(x: Array) -> tuple[Array, Any]:
        value, excess = problem(x, data)
        pushed = jnp.maximum(0.0, search.multipliers + search.weight * excess)
        cost = value + jnp.sum(pushed**2 - search.multipliers**2) / (2.0 * search.weight)
        return cost, (value, excess)

    return function


@eqx.filter_jit
def _begin(problem: Problem, method: Any, start: Array, data: Any) -> Search:
    def one(x: Array, data: Any) -> Search:
        value, excess = problem(x, data)
        worst = jnp.maximum(jnp.max(excess), 0.0)
        zero = jnp.zeros_like(excess)
        weight = jnp.full_like(value, _FIRST_WEIGHT)
        return Search(
            x,
            method.init(x),
            zero,
            weight,
            x,
            value,
            worst,
            jnp.full_like(value, jnp.inf),
            jnp.array(0),
            jnp.array(False),
        )

    return jax.vmap(one)(start, data)


@eqx.filter_jit
def _advance(problem: Problem, method: Any, search: Search, data: Any) -> tuple[Search, Array]:
    return jax.vmap(lambda one, data: _chunk(problem, method, one, data))(search, data)


def _chunk(problem: Problem, method: Any, search: Search, data: Any) -> tuple[Search, Array]:
    lagrangian = _lagrangian(problem, search, data)
    cost = lambda x: lagrangian(x)[0]  # noqa: E731

    def step(now: Search, _: None) -> tuple[Search, Array]:
        (value, seen), slope = jax.value_and_grad(lagrangian, has_aux=True)(now.x)
        now = _kept(now, *seen)
        update, memory = method.update(slope, now.memory, now.x, value=value, grad=slope, value_fn=cost)
        moved = jnp.asarray(optax.apply_updates(now.x, update))
        # A step into nowhere is not taken; the next one starts afresh from the best point.
        sound = jnp.all(jnp.isfinite(jnp.append(moved, value)))
        x = jnp.where(sound, moved, now.best)
        fresh = jax.tree.map(lambda a, b: jnp.where(sound, a, b), memory, method.init(now.best))
        return eqx.tree_at(lambda s: (s.x, s.memory), now, (x, fresh)), seen[0]

    search, values = jax.lax.scan(step, search, None, length=CHUNK)
    value, excess = lagrangian(search.x)[1]
    search = _kept(search, value, excess)
    worst = jnp.maximum(jnp.max(excess), 0.0)
    multipliers = jnp.maximum(0.0, search.multipliers + search.weight * excess)
    multipliers = jnp.where(jnp.isfinite(multipliers), multipliers, 0.0)
    weight = jnp.where(worst > KEPT, jnp.minimum(3.0 * search.weight, _LAST_WEIGHT), search.weight)
    still = jnp.abs(value - search.last) <= _SETTLED * (1.0 + jnp.abs(value))
    calm = jnp.where(still, search.calm + 1, 0)
    # The multipliers have moved on: an optimiser that stands still may be held by what it remembers.
    memory = jax.tree.map(lambda a, b: jnp.where(still, a, b), method.init(search.x), search.memory)
    settled = (search.violation <= KEPT) & (worst <= KEPT) & (calm >= 2)
    where = lambda s: (s.multipliers, s.weight, s.last, s.calm, s.memory, s.done)  # noqa: E731
    news = (multipliers, weight, value, calm, memory, search.done | settled)
    return eqx.tree_at(where, search, news), values


def _kept(search: Search, value: Array, excess: Array) -> Search:
    """Take the present point as the best where it is better: within limits first, then by value."""
    violation = jnp.maximum(jnp.max(excess), 0.0)
    inside, was = violation <= KEPT, search.violation <= KEPT
    better = jnp.where(inside & was, value < search.value, violation < search.violation)
    better = (better | (inside & ~was)) & jnp.isfinite(value)
    new = (search.x, value, violation)
    old = (search.best, search.value, search.violation)
    best = jax.tree.map(lambda a, b: jnp.where(better, a, b), new, old)
    return eqx.tree_at(lambda s: (s.best, s.value, s.violation), search, best)


def _saved(path: Path, search: Search, steps: int, history: list[np.ndarray]) -> None:
    part = path.with_suffix(path.suffix + ".part")
    with part.open("wb") as file:
        np.save(file, np.array(steps))
        np.save(file, np.concatenate(history, axis=1))
        eqx.tree_serialise_leaves(file, search)
    part.replace(path)  # a run cut off here leaves the last whole one


def _restored(path: Path, like: Search) -> tuple[Search, int, list[np.ndarray]]:
    with path.open("rb") as file:
        steps, history = int(np.load(file)), np.load(file)
        return eqx.tree_deserialise_leaves(file, like), steps, [history]
