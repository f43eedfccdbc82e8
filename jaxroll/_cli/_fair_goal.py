r"""What `jaxroll design` adds to every goal: a fingertip whose back is not wavy.

A goal such as the margin of (41) asks nothing of the contour where it is not touched, and the search leaves
there whatever its first steps made. The term is the mean of $(\rho^2\,\mathrm{d}\kappa/\mathrm{d}s)^2$ over
the whole contour, with its size $\rho$: zero on a circle.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool

from .._types import Scalar
from ..design import AbstractGoal
from ..geometry import AbstractContour

# A hundredth: the margin is within 0.3 % of what it is without, and the back follows the limits smoothly.
_WEIGHT = 0.01


class FairGoal(AbstractGoal):
    """Another goal, and a contour whose curvature changes little along it.

    Args:
        goal: What the fingertip is for.
    """

    goal: AbstractGoal

    @property
    def in_turn(self) -> bool:
        return self.goal.in_turn

    def cost(self, tip: AbstractContour, seen: Any, unit: Scalar, sharpness: Scalar) -> Scalar:
        # From end to end: of a closed contour the last sample is the first one again.
        slopes = jnp.diff(jnp.asarray(seen.whole.curvature)) / seen.step
        uneven = jnp.mean((unit**2 * slopes) ** 2)
        return self.goal.cost(tip, seen, unit, sharpness) + _WEIGHT * uneven

    @property
    def merit(self) -> str:
        return self.goal.merit

    def figures(self, tip: AbstractContour, seen: Any) -> dict[str, Array]:
        return self.goal.figures(tip, seen)

    def reached(self, figures: dict[str, Array]) -> Bool[Array, "..."]:
        return self.goal.reached(figures)

    def aimed(self, tip: AbstractContour) -> "FairGoal":
        return FairGoal(self.goal.aimed(tip))
