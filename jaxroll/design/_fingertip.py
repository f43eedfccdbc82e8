"""A fingertip for condition (41): the largest worst margin on the contact interval."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

from .._results import RESULTS
from .._types import Given
from ..geometry import AbstractContour
from ._limits import check_interval, Limits, margins, sampled, Samples, soft_least
from ._minimise import KEPT, minimise, Progress
from ._shape import check_unprepared, divided, extent, mirrored, stacked

# How sharply the least margin is told from its neighbours, in units of the fingertip's size.
_SHARPNESS = 200.0
# Unit of the free numbers, as a share of the fingertip's size: L-BFGS's first step is no longer than one.
_UNIT = 0.05


class Design(eqx.Module):
    r"""A fingertip that was optimised.

    Attributes:
        tip: The best contour of all starts.
        tips: The best of every start, with a leading axis on every array.
        before: Shape (starts,), worst margin of (41) on the interval at the start [m].
        after: Shape (starts,), that of the best contours [m].
        violation: Shape (starts,), by how much the most violated limit is passed, relative to it.
        chosen: Which start `tip` comes from.
        history: Shape (starts, steps), worst margin before each step [m], smoothed.
        result: `successful`, `max_steps_reached`, or `infeasible` where no start came within the limits; the
            contour is then the one that passes them least.
        parts: By how much `tip` keeps each limit (negative) or passes it, relative to the limit.
    """

    tip: AbstractContour
    tips: AbstractContour
    before: Float[Array, " starts"]
    after: Float[Array, " starts"]
    violation: Float[Array, " starts"]
    chosen: int = eqx.field(static=True)
    history: Float[Array, "starts steps"]
    result: RESULTS
    parts: dict[str, float] = eqx.field(static=True)

    @property
    def holds(self) -> Bool[Array, " starts"]:
        """Which starts reached a positive margin on the whole interval, within the limits."""
        return (self.after > 0.0) & (self.violation <= KEPT)

    def __str__(self) -> str:
        lines = [
            f"Design: {RESULTS[self.result] or 'successful'}",
            f"  margin    {1e3 * float(self.before[self.chosen]):+.3f} to "
            f"{1e3 * float(self.after[self.chosen]):+.3f} mm, "
            f"{int(self.holds.sum())} of {self.after.shape[0]} hold",
            f"  steps     {self.history.shape[1]}",
        ]
        lines += [f"  {name:<10}{_kept(excess)}" for name, excess in self.parts.items()]
        return "\n".join(lines)


def _kept(excess: float) -> str:
    if excess > KEPT:
        return f"passed by {100 * excess:.3g} %"
    return "met exactly" if excess > -1e-4 else f"kept, {-100 * excess:.3g} % to spare"


def optimise_fingertip(
    tip: AbstractContour | Sequence[AbstractContour],
    interval: Given = (-0.01, 0.01),
    *,
    limits: Limits | None = None,
    optimiser: optax.GradientTransformation | None = None,
    steps: int = 200,
    symmetric: bool = False,
    progress: Progress = False,
    checkpoint: str | Path | None = None,
) -> Design:
    r"""Change a fingertip until condition (41) holds by as much as it can.

    Maximises the least of $1/\kappa + n \cdot \gamma$ over the contact interval, within `limits`, over the
    free numbers of the contour: points of a spline, terms of a support function, weights of a network, half
    axes of an ellipse. (41) makes a pinch of parallel flat faces stable; it is sufficient, not necessary.

    The least margin is a smooth one, $-\frac{1}{k} \log \sum_i e^{-k m_i}$ over 65 points with $k$ = 200 over
    the contour's size; reported margins are the true least ones. Limits are kept by an augmented Lagrangian.

    Args:
        tip: A fingertip about $O_i$ facing +x at s = 0, or several of one kind and size: they are optimised
            together in one batch, and the best is returned.
        interval: First and last arclength of the contact interval [m].
        limits: Default: `Limits(size=..., radius=...)` with the first start's own size and a tenth of it.
        optimiser: Any of optax, for free numbers in units of a twentieth of the contour's size. Default:
            `optax.lbfgs()`.
        steps: At most so many, rounded up to tens.
        symmetric: Keep the contour its own mirror image about the x axis.
        progress: True prints after every ten steps; a function is called with step, objective, violation.
        checkpoint: A file to write after every ten steps, and to go on from where it exists.

    Returns:
        A `Design`. An infeasible problem ends with that code and the contour that passes the limits least.

    Raises:
        ValueError: If a contour is endless or already prepared, contours differ in kind or size, or the
            interval leaves one.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> u = 2 * np.pi * np.arange(16) / 16
        >>> ring = 0.01 * np.stack([np.cos(u), np.sin(u)], -1) + np.array([0.004, 0.0])  # violates (41)
        >>> start = jxr.Spline(ring, cells=128)
        >>> design = jxr.design.optimise_fingertip(start, (-0.005, 0.005), symmetric=True)
        >>> float(design.before[0]) < 0 < float(design.after[0])
        True
    """
    tips = list(tip) if isinstance(tip, Sequence) else [tip]
    for one in tips:
        if not isinstance(one, AbstractContour):
            raise ValueError(f"argument tip must be one contour or several, but was {one!r}")
        check_unprepared(one)
    ends = jnp.stack([check_interval(one, interval) for one in tips])[0]
    if symmetric:
        mirrored(tips[0])  # raises where the class has no mirror image
    arrays, rest = stacked(tips)
    if limits is None:
        size = float(jnp.max(jax.vmap(lambda a: _reach(eqx.combine(a, rest)))(arrays)))
        limits = Limits(size=size, radius=0.1 * size)
    data = (arrays, jax.vmap(lambda a: extent(eqx.combine(a, rest)))(arrays))
    start = jax.vmap(lambda a, unit: _flat(eqx.combine(a, rest), unit))(*data)
    shape = _Shape(rest, ends, limits, symmetric)
    method = optax.lbfgs() if optimiser is None else optimiser
    options: dict[str, Any] = {"steps": steps, "progress": progress, "checkpoint": checkpoint}
    found = minimise(shape, start, data, optimiser=method, **options)
    return _design(shape, start, data, found)


class _Shape(eqx.Module):
    """From a vector of free numbers to the contour, and what is asked of it."""

    rest: Any
    interval: Array
    limits: Limits
    symmetric: bool = eqx.field(static=True)

    def contour(self, x: Array, data: Any) -> AbstractContour:
        arrays, unit = data
        free, fixed = divided(eqx.combine(arrays, self.rest))
        _, unravel = jax.flatten_util.ravel_pytree(free)
        contour = eqx.combine(unravel(x * (_UNIT * unit)), fixed)
        return mirrored(contour) if self.symmetric else contour

    def samples(self, x: Array, data: Any) -> Samples:
        return sampled(self.contour(x, data), self.interval)

    def __call__(self, x: Array, data: Any) -> tuple[Array, Array]:
        """The objective, and what the limits ask."""
        seen, unit = self.samples(x, data), data[1]
        return -soft_least(margins(seen.pad, unit) / unit, _SHARPNESS), self.limits.all(seen)

    def worst(self, x: Array, data: Any) -> Array:
        return jnp.min(margins(self.samples(x, data).pad, data[1]))


def _reach(contour: AbstractContour) -> Array:
    point = sampled(contour, jnp.zeros(2)).whole.point
    return jnp.sqrt(jnp.max(point.dot(point)))


def _flat(contour: AbstractContour, unit: Array) -> Array:
    return jax.flatten_util.ravel_pytree(divided(contour)[0])[0] / (_UNIT * unit)


@eqx.filter_jit
def _outcome(shape: _Shape, x: Array, data: Any) -> tuple[Array, Any]:
    """Worst margins of all starts, and their contours."""
    worst = jax.vmap(shape.worst)(x, data)
    return worst, jax.vmap(lambda x, d: eqx.filter(shape.contour(x, d), eqx.is_inexact_array))(x, data)


def _design(shape: _Shape, start: Array, data: Any, found: Any) -> Design:
    search = found.search
    before, _ = _outcome(shape, start, data)
    after, arrays = _outcome(shape, search.best, data)
    inside = search.violation <= KEPT
    rank = jnp.where(inside, after, -jnp.inf)
    best = int(jnp.argmax(rank)) if bool(inside.any()) else int(jnp.argmin(search.violation))
    tip = eqx.combine(jax.tree.map(lambda a: a[best], arrays), shape.rest)
    result = RESULTS.successful if bool(search.done[best]) else RESULTS.max_steps_reached
    if not bool(inside.any()):
        result = RESULTS.infeasible
    excess = shape.limits.excess(sampled(tip, shape.interval))
    return Design(
        tip=tip,
        tips=eqx.combine(arrays, shape.rest),
        before=before,
        after=after,
        violation=search.violation,
        chosen=best,
        history=-jnp.asarray(found.history) * data[1][:, None],
        result=result,
        parts={name: float(jnp.max(value)) for name, value in excess.items()},
    )
