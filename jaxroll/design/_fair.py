r"""A goal round another one: the back of the fingertip is not to be wavy.

A goal such as the margin of (41) asks nothing of the contour where it is not touched, and the search leaves
there whatever its first steps made. `Fair` adds the mean of $(\rho^2\,\mathrm{d}\kappa/\mathrm{d}s)^2$ over
the whole contour, with its size $\rho$: zero on a circle. `jaxroll design` adds it to every goal.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._results import as_positive, check_instance
from .._types import Given, Scalar
from ..geometry import AbstractContour
from ._goals import AbstractGoal
from ._limits import ContourSamples


class Fair(AbstractGoal):
    r"""Another goal, and a contour whose curvature changes little along it.

    To the goal's cost comes $w\,\overline{(\rho^2\,\mathrm{d}\kappa/\mathrm{d}s)^2}$, a mean over the whole
    contour by differences of 257 samples, where $\rho$ is the contour's size. What is reported is the goal's
    own.

    Args:
        goal: What the fingertip is for.
        weight: $w$, without dimension. With a hundredth, the default, the margin of (41) ends within 0.3 %
            of what it is without, and the back follows the limits smoothly.

    Raises:
        ValueError: If `goal` is not a goal, or `weight` is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> jxr.design.Fair(jxr.design.Margin()).merit
        'worst margin [m]'
    """

    goal: AbstractGoal
    weight: Float[Array, ""]

    def __init__(self, goal: AbstractGoal, *, weight: Given = 0.01) -> None:
        self.goal = check_instance("goal", goal, AbstractGoal, "a goal")
        self.weight = as_positive("weight", weight)

    @property
    def in_turn(self) -> bool:
        return self.goal.in_turn

    def cost(self, tip: AbstractContour, seen: ContourSamples, unit: Scalar, sharpness: Scalar) -> Scalar:
        # From end to end: the last sample of a closed contour is its first one again.
        slopes = jnp.diff(jnp.asarray(seen.whole.curvature)) / seen.step
        uneven = jnp.mean((unit**2 * slopes) ** 2)
        return self.goal.cost(tip, seen, unit, sharpness) + self.weight * uneven

    @property
    def merit(self) -> str:
        return self.goal.merit

    def figures(self, tip: AbstractContour, seen: ContourSamples) -> dict[str, Array]:
        return self.goal.figures(tip, seen)

    def reached(self, figures: dict[str, Array]) -> Bool[Array, "..."]:
        return self.goal.reached(figures)

    def aimed(self, tip: AbstractContour) -> "Fair":
        return Fair(self.goal.aimed(tip), weight=self.weight)
