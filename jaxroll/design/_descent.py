r"""Methods of descent that evaluate one point at a time, so that the objective is compiled once.

A method is given the function and its gradient at the point it has asked for (`Walk.trial`), and answers with
the next point to evaluate. A line search inside a step would compile the objective again, and a batch of
starts would wait for its slowest search (measured: 25 s instead of 4 s to compile the two half axes of an
ellipse).

`Bfgs` is the default, with backtracking spread over steps: a trial that does not satisfy Armijo's condition
$f(x + p) \le f(x) + 10^{-4}\, \nabla f \cdot p$ is followed by a shorter one from the same point. `Optax`
wraps any method of optax. All decisions are selections (`jnp.where`), as `_minimise` runs many starts side by
side.
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Bool, Float

# Share of the descent promised by the gradient that a step must bring (Armijo), and the shortest share of a
# step that is tried before the method starts afresh.
_ENOUGH, _LEAST = 1e-4, 1e-6
# No step is longer than this, in units of the unknowns (of a fingertip: a twentieth of its size).
_LONGEST = 4.0


class Walk(eqx.Module):
    """State of a descent from one start.

    Attributes:
        x: The last point that was taken.
        cost: The function there; infinite before the first evaluation.
        slope: Its gradient there.
        trial: The point to evaluate next.
        share: Which share of the step that was first tried from `x` leads to `trial`.
        memory: What the method keeps from step to step: `Bfgs` its inverse Hessian, optax its own state.
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
        """The memory at the beginning, when nothing is known of the function."""

    @abc.abstractmethod
    def ahead(
        self, walk: Walk, cost: Array, slope: Array, function: Callable[[Array], Array]
    ) -> tuple[Walk, Bool[Array, ""]]:
        """The next state, and whether the trial point was taken as the new x.

        Args:
            walk: The state before.
            cost: The function at `walk.trial`.
            slope: Its gradient there.
            function: The function itself, for methods that evaluate more than one point in a step.
        """

    def begin(self, x: Array) -> Walk:
        """The state before the first evaluation: the start itself is the first trial."""
        one = jnp.ones((), x.dtype)
        return Walk(x, jnp.inf * one, jnp.zeros_like(x), x, one, self.fresh(x))

    def again(self, walk: Walk) -> Walk:
        """The state after the function has changed: the last point is evaluated again, taken if finite."""
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
        # Nothing to compare with: at the start, and after the function has changed.
        first = jnp.isinf(walk.cost)
        way = walk.trial - walk.x
        promise = walk.slope @ way
        sound = jnp.isfinite(cost) & jnp.all(jnp.isfinite(slope))
        taken = sound & (first | (cost <= walk.cost + _ENOUGH * promise))
        change = slope - walk.slope
        known = jnp.where(first, walk.memory, _learnt(walk.memory, way, change))
        # Negative curvature along the step: BFGS learns nothing from it, and a step of the usual length would
        # cross such a region slowly. The next one is at least twice as long as this one.
        least = jnp.where(~first & (way @ change <= 0.0), 2.0 * jnp.sqrt(way @ way), 0.0)
        moved = self._onward(walk.trial, cost, slope, known, least)
        back = self._shorter(walk, cost, promise)
        return jax.tree.map(lambda a, b: jnp.where(taken, a, b), moved, back), taken

    def _onward(self, x: Array, cost: Array, slope: Array, known: Array, least: Array) -> Walk:
        """From a point that was taken: the next quasi-Newton step, at least as long as `least`."""
        way = _direction(known, slope)
        # An inverse Hessian that rounding has made indefinite is forgotten, and the gradient followed.
        downhill = slope @ way < 0.0
        known = jnp.where(downhill, known, 0.0)
        way = jnp.where(downhill, way, _direction(jnp.zeros_like(known), slope))
        length = jnp.sqrt(way @ way)
        longer = jnp.clip(least, length, jnp.maximum(length, _LONGEST))
        way = way * (longer / jnp.where(length > 0.0, length, 1.0))
        return Walk(x, cost, slope, x + way, jnp.ones_like(cost), known)

    def _shorter(self, walk: Walk, cost: Array, promise: Array) -> Walk:
        """After a trial that was not taken: a shorter step in the same direction.

        With the cost $f_0$ at x, the slope $p$ along the step and the cost $f_1$ at its end, the parabola
        through them is lowest at the share $-p / (2 (f_1 - f_0 - p))$, kept from 0.1 to 0.5. A step that has
        become too short means that the direction was wrong: the memory is emptied, and the gradient followed.
        """
        bend = cost - walk.cost - promise
        factor = jnp.clip(jnp.where(bend > 0.0, -0.5 * promise / bend, 0.1), 0.1, 0.5)
        # Where the cost at the trial was not finite, a tenth.
        share = walk.share * jnp.where(jnp.isfinite(factor), factor, 0.1)
        spent = share < _LEAST
        way = (walk.trial - walk.x) * (share / walk.share)
        steep = _direction(jnp.zeros_like(walk.memory), walk.slope)
        trial = walk.x + jnp.where(spent, steep, way)
        known = jnp.where(spent, 0.0, walk.memory)
        return Walk(walk.x, walk.cost, walk.slope, trial, jnp.where(spent, 1.0, share), known)


def _learnt(inverse: Array, step: Array, change: Array) -> Array:
    r"""The inverse Hessian H after a step s along which the gradient has changed by y.

    $(1 - \rho s y^T) H (1 - \rho y s^T) + \rho s s^T$ with $\rho = 1 / (s \cdot y)$. A pair without positive
    curvature, $s \cdot y \le 0$ to rounding, is left out: H would not stay positive definite.
    """
    along, size = step @ change, change @ change
    one = jnp.eye(step.shape[0], dtype=step.dtype)
    useful = along > 1e-10 * jnp.sqrt((step @ step) * size)
    rho = 1.0 / jnp.where(useful, along, 1.0)
    # The first pair replaces "nothing known" by a multiple of the identity, (s . y) / (y . y), which is the
    # size of the inverse Hessian along y.
    nothing = jnp.all(inverse == 0.0)
    before = jnp.where(nothing, one * (along / jnp.where(size > 0.0, size, 1.0)), inverse)
    left = one - rho * jnp.outer(step, change)
    after = left @ before @ left.T + rho * jnp.outer(step, step)
    return jnp.where(useful, after, inverse)


def _direction(inverse: Array, slope: Array) -> Array:
    r"""The step $-H \nabla f$, at most `_LONGEST` long; where H is not known, $-\nabla f$, at most one."""
    length = jnp.sqrt(slope @ slope)
    way = jnp.where(jnp.all(inverse == 0.0), -slope / jnp.maximum(length, 1.0), -(inverse @ slope))
    far = jnp.sqrt(way @ way)
    return way * jnp.minimum(1.0, _LONGEST / jnp.where(far > 0.0, far, 1.0))


class Optax(AbstractDescent):
    """Any optax optimiser; every point it proposes is taken, unless the objective is not finite there."""

    method: optax.GradientTransformationExtraArgs

    def fresh(self, x: Array) -> Any:
        # Of types that are not weak, as what comes of a step: JAX would compile the steps twice.
        return jax.tree.map(lambda a: jnp.asarray(a, jnp.result_type(a)), self.method.init(x))

    def ahead(
        self, walk: Walk, cost: Array, slope: Array, function: Callable[[Array], Array]
    ) -> tuple[Walk, Bool[Array, ""]]:
        sound = jnp.isfinite(cost) & jnp.all(jnp.isfinite(slope))
        told = {"value": cost, "grad": slope, "value_fn": function}
        update, memory = self.method.update(slope, walk.memory, walk.trial, **told)
        trial = jnp.asarray(optax.apply_updates(walk.trial, update))
        moved = Walk(walk.trial, cost, slope, trial, walk.share, memory)
        # A step to where the objective is not finite is halved, and the method starts with an empty memory.
        middle = 0.5 * (walk.x + walk.trial)
        back = Walk(walk.x, walk.cost, walk.slope, middle, walk.share, self.fresh(walk.x))
        return jax.tree.map(lambda a, b: jnp.where(sound, a, b), moved, back), sound


def descent(optimiser: optax.GradientTransformation | None) -> AbstractDescent:
    """The method of descent for a caller's `optimiser`: the default, or any of optax."""
    return Bfgs() if optimiser is None else Optax(optax.with_extra_args_support(optimiser))
