"""What a design is after: a cost to minimise, and the figures that are reported of it.

`AbstractGoal` is the contract between a goal and `optimise_fingertip`: the search minimises `cost`, which is
smooth and without dimension, and the caller reads `figures`, which are not smoothed and in SI units. `Margin`
is the default; `ClosedLoop` and `Firmness` look at a whole grasp, in several cases, with the helpers at the
end.
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from .._mechanics import as_grasp_and_state
from .._results import as_array, check_callable, check_finite, shown
from .._types import Scalar
from ..geometry import AbstractContour
from ._limits import ContourSamples, margins, soft_least

# k of the smooth least margin, over the fingertip's size: margins within size / 200 of the least one
# have a weight too.
_SHARPNESS = 200.0
# k of the smooth worst case, over the largest cost: cases within a fiftieth of it count too.
_WORST = 50.0

# Name of the figure that all goals of this package report.
WORST_MARGIN = "worst margin [m]"

# From a fingertip, and a case where there are several, to a grasp and its start.
Make = Callable[..., tuple[Any, Any]]


class AbstractGoal(eqx.Module):
    """What `optimise_fingertip` is to reach."""

    @property
    def in_turn(self) -> bool:
        """Whether starts are better taken in turn than side by side."""
        return False

    @abc.abstractmethod
    def cost(self, tip: AbstractContour, seen: ContourSamples, unit: Scalar, sharpness: Scalar) -> Scalar:
        """What is minimised, without dimension and of order one.

        `unit` is the fingertip's size; `sharpness` rises to one in the course of the search. What a fingertip
        costs must not rise with `sharpness` (a smooth upper bound of a largest value falls), as the lowest
        cost of all steps decides which fingertip is returned.
        """

    @property
    @abc.abstractmethod
    def merit(self) -> str:
        """Name of the figure of merit."""

    @abc.abstractmethod
    def figures(self, tip: AbstractContour, seen: ContourSamples) -> dict[str, Array]:
        """What is reported, in SI units that the names state, the figure of merit among them."""

    @abc.abstractmethod
    def reached(self, figures: dict[str, Array]) -> Bool[Array, "..."]:
        """Whether a fingertip with these figures holds the grasp."""

    def aimed(self, tip: AbstractContour) -> "AbstractGoal":
        """This goal, with what it needs from the first start; called once, before anything is traced."""
        del tip
        return self


def check_answers(goal: AbstractGoal, tip: AbstractContour, seen: ContourSamples, unit: Scalar) -> Scalar:
    """Raise unless a goal answers with what the search can use; called while JAX traces, returns the cost."""
    name = "argument goal must have"
    cost = as_array("goal, in what `cost` returns,", goal.cost(tip, seen, unit, jnp.ones(())))
    if cost.ndim:
        raise ValueError(f"{name} a `cost` of one number, but it had shape {cost.shape}")
    figures = goal.figures(tip, seen)
    if not isinstance(figures, dict) or goal.merit not in figures:
        raise ValueError(
            f"{name} `figures` that are a dict with its `merit` {shown(goal.merit)}, but they were "
            f"{shown(figures)}"
        )
    found = {key: as_array(f"goal, in its figure {shown(key)},", value) for key, value in figures.items()}
    if shapes := [value.shape for value in found.values() if value.shape]:
        raise ValueError(f"{name} `figures` of one number each, but one had shape {shapes[0]}")
    # Asked of all starts at once.
    reached = goal.reached({key: value[None] for key, value in found.items()})
    if not eqx.is_array_like(reached) or not jnp.issubdtype(jnp.result_type(reached), np.bool_):
        raise ValueError(f"{name} `reached` that is True or False, but it was {shown(reached)}")
    return cost


class Margin(AbstractGoal):
    r"""The least margin $1/\kappa + n \cdot \gamma$ of (41) on the contact interval, as large as it can be.

    (41) makes a pinch of parallel flat faces stable; it is sufficient, not necessary. What is maximised is a
    smooth lower bound of the least margin, $-\frac{1}{k} \log \sum_i e^{-k m_i}$ over 65 points with k = 200
    over the contour's size; what is reported is the true least one.

    Example:
        >>> import jaxroll as jxr
        >>> goal = jxr.design.Margin()
    """

    def cost(self, tip: AbstractContour, seen: ContourSamples, unit: Scalar, sharpness: Scalar) -> Scalar:
        return -soft_least(margins(seen.pad, unit) / unit, _SHARPNESS * sharpness)

    @property
    def merit(self) -> str:
        return WORST_MARGIN

    def figures(self, tip: AbstractContour, seen: ContourSamples) -> dict[str, Array]:
        return {WORST_MARGIN: worst_margin(seen)}

    def reached(self, figures: dict[str, Array]) -> Bool[Array, "..."]:
        return figures[WORST_MARGIN] > 0.0


def worst_margin(seen: ContourSamples) -> Array:
    """Least margin of (41) on the contact interval [m], bounded where the contour is hollow or flat."""
    return jnp.min(margins(seen.pad, jnp.max(jnp.sqrt(seen.whole.point.dot(seen.whole.point)))))


def each_case(
    make: Make, cases: Any, tip: AbstractContour, found: Callable[[Any, Any], Any], *, in_turn: bool = False
) -> Any:
    """`found(grasp, state)` of every case, with a leading axis; of length one where there are no cases.

    Args:
        make: From a fingertip, and a case if there are any, to a grasp and a state.
        cases: Arrays with a leading axis, or None.
        tip: The fingertip.
        found: What is wanted of each grasp and state.
        in_turn: Take the cases one after the other, by `jax.lax.map`. Runs that are differentiated side by
            side, by `jax.vmap`, take as long, and their program half as long again to compile.
    """
    if cases is None:
        return jax.tree.map(lambda x: x[None], found(*as_grasp_and_state(make(tip))))
    each = lambda case: found(*as_grasp_and_state(make(tip, case)))  # noqa: E731
    return jax.lax.map(each, cases) if in_turn else jax.vmap(each)(cases)


def soft_worst(costs: Array, sharpness: Scalar) -> Scalar:
    r"""Smooth upper bound of the largest of some costs, $v + \frac{a}{k} \log\sum_i e^{k (v_i - v)/a}$.

    $v$ is the largest cost, $a$ the largest absolute value, and $k$ is 50 times `sharpness`.
    """
    # The exponents are at most zero, and cannot overflow. Whatever v is, the result is the same: it needs no
    # derivative. That of a maximum is NaN where rounding has made it none of the values: a is looked up.
    values = jax.lax.stop_gradient(costs)
    worst = jnp.max(values)
    size = (jnp.abs(costs[jnp.argmax(jnp.abs(values))]) + 1e-12) / (_WORST * sharpness)
    return worst + size * jnp.log(jnp.sum(jnp.exp((costs - worst) / size)))


def check_make(make: Any, cases: Any) -> Any:
    """Raise unless `make` can be called with a fingertip, and with a case if there are any."""
    if cases is None:
        return check_callable("make", make, "a function of a fingertip alone", takes=1)
    return check_callable("make", make, "a function of a fingertip and a case", takes=2)


def check_cases(cases: Any) -> Any:
    """The cases as floating-point arrays with one common leading axis, or None."""
    if cases is None:
        return None
    arrays = jax.tree.map(lambda x: jnp.asarray(check_finite("cases", as_array("cases", x)), float), cases)
    lengths = {jnp.shape(x)[:1] for x in jax.tree.leaves(arrays)}
    if len(lengths) != 1 or lengths == {()} or lengths == {(0,)}:
        raise ValueError(
            f"argument cases must hold arrays with one common leading axis, but their leading axes were "
            f"{shown(sorted(lengths))}"
        )
    return arrays
