"""`optimise_fingertip`: from a fingertip to a better one within limits.

This module joins the parts. `_Problem` maps a vector of unknowns to a contour (`_shape_transform`), that to
samples of its frame (`_limits`), and both to a cost (`_goals`) and to what the limits ask. `minimise`
searches from all starts at once, and `_design` makes a `Design` of the best one.

The starts are contours of one kind: their arrays are stacked along a leading axis, and what they share
besides is kept once.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array

from .._results import (
    as_count,
    as_several,
    check_callable,
    check_choice,
    check_flag,
    check_instance,
    is_foreign,
    on_host,
    RESULTS,
    traceable,
)
from .._sweep import as_now
from .._types import Given
from .._xla import quickly
from ..geometry import AbstractContour, tabled
from ._design import Design
from ._goals import AbstractGoal, check_answers, Margin
from ._gradient import Mode
from ._limits import check_interval, ContourSamples, Limits, sampled
from ._minimise import check_checkpoint, DesignProgress, Found, KEPT, minimise
from ._shape_transform import as_batch, body_radii, check_image, check_tip, ShapeTransform, varied


@on_host
def optimise_fingertip(
    tip: AbstractContour | Sequence[AbstractContour],
    interval: Given = (-0.01, 0.01),
    *,
    goal: AbstractGoal | None = None,
    limits: Limits | None = None,
    steps: int = 200,
    symmetric: bool = False,
    progress: DesignProgress = False,
    starts: int = 1,
    seed: int = 0,
    optimiser: optax.GradientTransformation | None = None,
    mode: Mode = "auto",
    checkpoint: str | Path | None = None,
) -> Design:
    r"""Change a fingertip until it is as good as it can be.

    By default the margin of condition (41), $1/\kappa + n \cdot \gamma > 0$, becomes as large as it can on
    the contact interval; another `goal` looks at runs of the closed loop or at the Hessian at rest. What
    changes are the free numbers of the contour: points of a spline, terms of a support function, weights of a
    network, half axes of an ellipse. `limits` are kept by an augmented Lagrangian.

    Args (daily use):
        tip: A fingertip about $O_i$ facing +x at s = 0, or several of one kind and size: they are optimised
            together in one batch, and the best is returned.
        interval: First and last arclength of the contact interval [m].
        goal: `Margin()` (default), `ClosedLoop(...)`, `Firmness(...)`, any of them in `Fair(...)`, or an
            `AbstractGoal` of one's own.
        limits: Default: `Limits(size=..., radius=..., ahead=...)` with the first start's largest distance
            from $O_i$, a tenth and a half of it.
        steps: At most so many, rounded up to tens; each is one evaluation with its gradient.
        symmetric: Keep the contour its own mirror image about the x axis; of a placed one, about its own.
        progress: True prints after every ten steps; a function is called with step, cost, violation.
    Args (rarely changed):
        starts: How many in all: those not given are smooth variations of the given ones.
        seed: Of NumPy, for these variations.
        optimiser: Any of optax, with its schedule; its unknowns are in units of a twentieth of the contour's
            size, and waves of points and terms of series are divided by about their order squared, so that
            all bend the contour alike (a Sobolev gradient; see `ShapeTransform`). Default: BFGS with
            backtracking, which evaluates one point a step.
        mode: How to differentiate, 'auto', 'forward' or 'reverse': see `value_and_grad`.
        checkpoint: A file to write after every ten steps, and to go on from where it exists.

    Returns:
        A `Design`. An infeasible problem ends with that code and the contour that passes the limits least.

    Raises:
        ValueError: If a contour is endless or already prepared, contours differ in kind or size, or the
            interval leaves one or is longer than it; if another argument is not what it must be, or
            `checkpoint` cannot be written or is of another search (`steps`, `mode` and `progress` may
            differ); for `Firmness`, if the first start has no equilibrium in the first case.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> u = 2 * np.pi * np.arange(16) / 16
        >>> ring = 0.01 * np.stack([np.cos(u), np.sin(u)], -1) + np.array([0.004, 0.0])  # violates (41)
        >>> start = jxr.Spline(ring, cells=128)
        >>> design = jxr.design.optimise_fingertip(start, (-0.005, 0.005), symmetric=True, steps=50)
        >>> float(design.before[0]) < 0 < float(design.after[0])
        True
    """
    tips = list(as_several("tip", tip, AbstractContour, "contours"))
    for one in tips:
        check_tip(one)
    _check_parts(goal, limits, progress, optimiser, mode, checkpoint)
    steps, symmetric = as_count("steps", steps), check_flag("symmetric", symmetric)
    count, seed = as_count("starts", starts, most=10_000), as_count("seed", seed, least=0, most=2**63 - 1)
    # The interval must lie on every one of the contours.
    ends = jnp.stack([check_interval(one, interval) for one in tips])[0]
    goal = Margin() if goal is None else goal
    asked = {"tip": tips, "interval": np.asarray(ends), "goal": goal, "limits": limits, "starts": count}
    asked |= {"symmetric": symmetric, "seed": seed, "optimiser": optimiser}
    transform = ShapeTransform(tips[0], symmetric=symmetric)
    for one in tips[1:] if symmetric else ():
        check_image(one)
    arrays, rest = as_batch(varied(tips, max(count, len(tips)), seed))
    sizes, reaches = body_radii(arrays, rest)
    # Default limits: the first start's largest distance from O, and shares of it.
    if limits is None:
        size = float(reaches[0])
        limits = Limits(size=size, radius=0.1 * size, ahead=0.5 * size)
    # Before anything is traced, the goal takes what it needs from the first start, such as a scale.
    wanted = check_instance("goal.aimed, in what it returns,", goal.aimed(tips[0]), AbstractGoal, "a goal")
    data, problem = (arrays, sizes), _Problem(transform, rest, ends, limits, wanted)
    start = _starts(problem, data)
    # JAX keeps what it traced for the functions of a goal, whatever these hold since.
    with as_now(goal):
        _check_answers(problem, start, data)
        found = minimise(
            problem,
            start,
            data,
            steps=steps,
            in_turn=wanted.in_turn,
            progress=progress,
            optimiser=optimiser,
            mode=mode,
            checkpoint=checkpoint,
            asked=asked,
        )
        return _design(problem, start, data, found)


def _check_parts(
    goal: Any, limits: Any, progress: Any, optimiser: Any, mode: Any, checkpoint: str | Path | None
) -> None:
    """Raise unless each of these arguments of `optimise_fingertip` is what it must be."""
    if goal is not None:
        check_instance("goal", goal, AbstractGoal, "a goal, such as design.Margin()")
    if limits is not None:
        check_instance("limits", limits, Limits, "design.Limits(...)")
    if not isinstance(progress, bool):
        check_callable("progress", progress, "True, False or a function of step, cost and violation", takes=3)
    if optimiser is not None:
        check_instance("optimiser", optimiser, optax.GradientTransformation, "one of optax")
    check_choice("mode", mode, ("auto", "forward", "reverse"))
    if checkpoint is not None:
        check_checkpoint(checkpoint)


def _check_answers(problem: "_Problem", start: Array, data: Any) -> None:
    """Raise unless a goal of a caller's own class, or one inside another, answers as it must."""
    goals = (problem.goal, getattr(problem.goal, "goal", None))
    own = [goal for goal in goals if goal is not None and is_foreign(goal)]
    x, one = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[1:], a.dtype), (start, data))
    for goal in own:
        with traceable("goal"):
            jax.eval_shape(lambda x, one: check_answers(goal, *problem.seen(x, one), one[1]), x, one)  # noqa: B023


class _Problem(eqx.Module):
    """The search's problem: from a vector of unknowns to the cost of its contour and what the limits ask.

    Attributes:
        transform: That of the first start. Other starts share its matrix, but have arrays and size of their
            own.
        rest: What the contours of all starts share: everything but their floating-point arrays.
        interval: First and last arclength of the contact interval [m].
        limits: What the contour must keep to.
        goal: What is minimised, aimed at the first start.

    `data` of a start are its contour's arrays and its size [m].
    """

    transform: ShapeTransform
    rest: Any
    interval: Array
    limits: Limits
    goal: AbstractGoal

    def of(self, data: Any) -> ShapeTransform:
        """The transform of one start."""
        arrays, size = data
        own = (eqx.combine(arrays, self.rest), size)
        return eqx.tree_at(lambda t: (t.tip, t.size), self.transform, own)

    def contour(self, x: Array, data: Any) -> AbstractContour:
        """The contour of a vector."""
        return self.of(data).contour(x)

    def seen(self, x: Array, data: Any) -> tuple[AbstractContour, ContourSamples]:
        """The contour with its table, and its samples."""
        ready = tabled(self.contour(x, data))
        return ready, sampled(ready, self.interval)

    def __call__(self, x: Array, data: Any, sharpness: Array) -> tuple[Array, Array]:
        """The cost, and by how much the limits are passed, shape (k,): as `minimise` takes a problem."""
        tip, seen = self.seen(x, data)
        return self.goal.cost(tip, seen, data[1], sharpness), self.limits.all(seen)

    def outcome(self, x: Array, data: Any) -> tuple[Any, Any, Any]:
        """The contour's arrays, what the goal reports of it, and by how much it passes each limit."""
        tip, seen = self.seen(x, data)
        arrays = eqx.filter(self.contour(x, data), eqx.is_inexact_array)
        excess = {name: jnp.max(value) for name, value in self.limits.excess(seen).items()}
        return arrays, self.goal.figures(tip, seen), excess


@quickly
def _starts(problem: _Problem, data: Any) -> Array:
    """The vector of every start's contour."""
    return jax.vmap(lambda one: problem.of(one).start)(data)


@quickly
def _outcomes(problem: _Problem, x: Array, data: Any) -> tuple[Any, Any, Any]:
    """`outcome` of every start, with a leading axis."""
    if problem.goal.in_turn:
        return jax.lax.map(lambda pair: problem.outcome(*pair), (x, data))
    return jax.vmap(problem.outcome)(x, data)


def _design(problem: _Problem, start: Array, data: Any, found: Found) -> Design:
    """The result: what the goal reports before and after, and the best of all starts."""
    search = found.search
    first, figures_before, _ = _outcomes(problem, start, data)
    arrays, figures, excess = _outcomes(problem, search.best, data)
    inside = np.asarray(search.violation) <= KEPT
    # The best start is the lowest one within the limits; where none is, the one that passes them least.
    rank = np.where(inside, search.lowest, np.inf) if inside.any() else np.asarray(search.violation)
    best = int(np.argmin(rank))
    result = RESULTS.successful if bool(search.done[best]) else RESULTS.max_steps_reached
    merit = problem.goal.merit
    names = [merit, *(name for name in figures if name != merit)]
    pairs = {name: (float(figures_before[name][best]), float(figures[name][best])) for name in names}
    of_best = lambda a: jax.device_put(np.asarray(a)[best])  # noqa: E731
    pick = lambda tree: eqx.combine(jax.tree.map(of_best, tree), problem.rest)  # noqa: E731
    return Design(
        tip=pick(arrays),
        start=pick(first),
        tips=eqx.combine(arrays, problem.rest),
        before=figures_before[merit],
        after=figures[merit],
        violation=search.violation,
        holds=problem.goal.reached(figures) & jnp.asarray(inside),
        chosen=best,
        history=jnp.asarray(found.history),
        result=result if inside.any() else RESULTS.infeasible,
        figures=pairs,
        parts={name: float(value[best]) for name, value in excess.items()},
        interval=problem.interval,
    )
