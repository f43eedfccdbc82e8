"""Ways downhill that look at one point at a time, so that the objective is compiled once.

A line search inside a step would compile it again, and a batch of starts would wait for its slowest
search (measured: 25 s instead of 4 s to compile the two half axes of an ellipse).
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

# Share of the expected descent that a step must bring, and the shortest share of a step that is tried.
_ENOUGH, _LEAST = 1e-4, 1e-6
# No step is longer than this, in units of the unknowns.
_LONGEST = 4.0


class Walk(eqx.Module):
    """How far one start has come.

    Attributes:
        x: The last point that was taken.
        cost: The function there; infinite before the first evaluation.
        slope: Its gradient there.
        trial: The point to look at next.
        share: How much of the way from `x` was tried.
        memory: What the method remembers.
    """

    x: Float[Array, " n"]
    cost: Float[Array, ""]
    slope: Float[Array, " n"]
    trial: Float[Array, " n"]
    share: Float[Array, ""]
    memory: Any


class AbstractDescent(eqx.Module):
    """A method that proposes points one by one."""

    @abc.abstractmethod
    def fresh(self, x: Array) -> Any:
        """Memory of a method that knows nothing."""

    @abc.abstractmethod
    def ahead(
        self, walk: Walk, cost: Array, slope: Array, function: Callable[[Array], Array]
    ) -> tuple[Walk, Bool[Array, ""]]:
        """The next walk, given what was found at its trial, and whether that point was taken.

        `function` is there for methods that want to look at more points than one.
        """

    def begin(self, x: Array) -> Walk:
        """Before the first evaluation."""
        one = jnp.ones((), x.dtype)
        return Walk(x, jnp.inf * one, jnp.zeros_like(x), x, one, self.fresh(x))

    def again(self, walk: Walk) -> Walk:
        """The function has changed: look at the same point once more."""
        return eqx.tree_at(lambda w: (w.cost, w.trial), walk, (jnp.full_like(walk.cost, jnp.inf), walk.x))


class Bfgs(AbstractDescent):
    r"""Quasi-Newton steps, shortened until they bring a ten-thousandth of the descent they promise (Armijo).

    The inverse Hessian is kept whole: contours have tens of free numbers. Pairs without positive curvature
    are left out.
    """

    def fresh(self, x: Array) -> Array:
        return jnp.zeros((x.shape[0], x.shape[0]), x.dtype)  # zeros stand for "nothing known"

    def ahead(
        self, walk: Walk, cost: Array, slope: Array, function: Callable[[Array], Array]
    ) -> tuple[Walk, Bool[Array, ""]]:
        first = jnp.isinf(walk.cost)
        way = walk.trial - walk.x
        promise = walk.slope @ way
        sound = jnp.isfinite(cost) & jnp.all(jnp.isfinite(slope))
        taken = sound & (first | (cost <= walk.cost + _ENOUGH * promise))
        change = slope - walk.slope
        known = jnp.where(first, walk.memory, _learnt(walk.memory, way, change))
        # Where the function bends downwards, it is worth going twice as far as last time.
        least = jnp.where(~first & (way @ change <= 0.0), 2.0 * jnp.sqrt(way @ way), 0.0)
        moved = self._onward(walk.trial, cost, slope, known, least)
        back = self._shorter(walk, cost, promise)
        return jax.tree.map(lambda a, b: jnp.where(taken, a, b), moved, back), taken

    def _onward(self, x: Array, cost: Array, slope: Array, known: Array, least: Array) -> Walk:
        way = _direction(known, slope)
        downhill = slope @ way < 0.0
        known = jnp.where(downhill, known, 0.0)
        way = jnp.where(downhill, way, _direction(jnp.zeros_like(known), slope))
        length = jnp.sqrt(way @ way)
        longer = jnp.clip(least, length, jnp.maximum(length, _LONGEST))
        way = way * (longer / jnp.where(length > 0.0, length, 1.0))
        return Walk(x, cost, slope, x + way, jnp.ones_like(cost), known)

    def _shorter(self, walk: Walk, cost: Array, promise: Array) -> Walk:
        """A shorter step on the same way, by a parabola; where steps are too short, afresh and downhill."""
        bend = cost - walk.cost - promise
        factor = jnp.clip(jnp.where(bend > 0.0, -0.5 * promise / bend, 0.1), 0.1, 0.5)
        share = walk.share * jnp.where(jnp.isfinite(factor), factor, 0.1)
        spent = share < _LEAST
        way = (walk.trial - walk.x) * (share / walk.share)
        steep = _direction(jnp.zeros_like(walk.memory), walk.slope)
        trial = walk.x + jnp.where(spent, steep, way)
        known = jnp.where(spent, 0.0, walk.memory)
        return Walk(walk.x, walk.cost, walk.slope, trial, jnp.where(spent, 1.0, share), known)


def _learnt(inverse: Array, step: Array, change: Array) -> Array:
    """The inverse Hessian after one more pair of a step and the change of the gradient along it."""
    along, size = step @ change, change @ change
    one = jnp.eye(step.shape[0], dtype=step.dtype)
    useful = along > 1e-10 * jnp.sqrt((step @ step) * size)
    rho = 1.0 / jnp.where(useful, along, 1.0)
    nothing = jnp.all(inverse == 0.0)
    before = jnp.where(nothing, one * (along / jnp.where(size > 0.0, size, 1.0)), inverse)
    left = one - rho * jnp.outer(step, change)
    after = left @ before @ left.T + rho * jnp.outer(step, step)
    return jnp.where(useful, after, inverse)


def _direction(inverse: Array, slope: Array) -> Array:
    """Downhill, no farther than the longest step; by at most one unit where nothing is known."""
    length = jnp.sqrt(slope @ slope)
    way = jnp.where(jnp.all(inverse == 0.0), -slope / jnp.maximum(length, 1.0), -(inverse @ slope))
    far = jnp.sqrt(way @ way)
    return way * jnp.minimum(1.0, _LONGEST / jnp.where(far > 0.0, far, 1.0))


class Optax(AbstractDescent):
    """Any optax optimiser; every point it proposes is taken, unless the objective is not finite there."""

    method: optax.GradientTransformationExtraArgs

    def fresh(self, x: Array) -> Any:
        return self.method.init(x)

    def ahead(
        self, walk: Walk, cost: Array, slope: Array, function: Callable[[Array], Array]
    ) -> tuple[Walk, Bool[Array, ""]]:
        sound = jnp.isfinite(cost) & jnp.all(jnp.isfinite(slope))
        told = {"value": cost, "grad": slope, "value_fn": function}
        update, memory = self.method.update(slope, walk.memory, walk.trial, **told)
        trial = jnp.asarray(optax.apply_updates(walk.trial, update))
        moved = Walk(walk.trial, cost, slope, trial, walk.share, memory)
        # A step into nowhere is halved, and the method starts afresh.
        middle = 0.5 * (walk.x + walk.trial)
        back = Walk(walk.x, walk.cost, walk.slope, middle, walk.share, self.fresh(walk.x))
        return jax.tree.map(lambda a, b: jnp.where(sound, a, b), moved, back), sound


def descent(optimiser: optax.GradientTransformation | None) -> AbstractDescent:
    """The default, or any method of optax."""
    return Bfgs() if optimiser is None else Optax(optax.with_extra_args_support(optimiser))
