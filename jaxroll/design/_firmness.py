r"""The goal of stability on any objects, where (41) does not apply: by the Hessian, or by the slowest rate.

The measure comes from `stability.pinch_rest` or `stability.assess`, at the equilibrium of every case, and is
differentiated through it. For 'stiffness' the Hessian $U_{ij}$ is taken over the angles $\theta_i$ by which
the fingertips turn against the object, $d\theta_i = (\kappa_i + \kappa_{0i})\, ds_i$: on a rectangle with
like fingertips this leaves $\beta |l|$ times the margin of (41).
"""

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._mechanics import Grasp, State
from .._results import as_count, as_positive, check_choice
from .._types import Given, Scalar
from .._xla import quickly
from ..geometry import AbstractContour, tabled
from ..stability import assess, pinch_rest
from ._goals import (
    AbstractGoal,
    check_cases,
    check_make,
    each_case,
    Make,
    soft_worst,
    WORST_MARGIN,
    worst_margin,
)
from ._limits import ContourSamples

Measure = Literal["stiffness", "curvature", "rate"]
_NAMES = {
    "stiffness": "least stiffness [N m/rad]",
    "curvature": "least curvature [1/s^2]",
    "rate": "slowest decay [1/s]",
}
# Curvatures and rates that are negative by less than this share of the largest count as zero.
_NONE = 1e-7
# A stiffness below this share of the other one is no measure of what a search may reach.
_SOFT = 0.01
# Where a fingertip passes from unstable to stable, an eigenvalue of the Hessian is zero, and the place at
# rest changes infinitely fast with the shape: below this share of the Hessian's size that derivative is
# damped (`pinch_rest`).
_DAMPED = 0.01
# In the cost, 1 / c with the sum c of curvatures [rad/m] becomes c / (c^2 + _FLAT^2): a fingertip gains
# nothing by a sum smaller than this.
_FLAT = 2.0


class Firmness(AbstractGoal):
    r"""The grasp at rest as firm as it can be, on any object: (41) has no part in it.

    Maximises, in the worst of all cases, at the equilibrium near the start, one of

    - 'stiffness': the smaller eigenvalue of the Hessian of $U(s_1, s_2)$, (39)-(40) on any contours, over the
      angles by which the fingertips turn against the object [N m/rad]: for a pinch of two fingers under
      `control.Opposition` with $\alpha_i = 0$ and without gravity and loads. Seconds to compile
      (`stability.pinch_rest`). On a rectangle with two like fingertips it is $\beta |l|$ times the margin of
      (41).
    - 'curvature': the smallest eigenvalue of the Hessian of the potential on the constraint manifold, per
      unit of kinetic energy [1/s^2], of any grasp (`stability.assess`). Minutes to compile.
    - 'rate': the slowest rate at which the linearised closed loop returns [1/s], likewise.

    For the last two, directions that are neutral whatever the fingertip (redundant joints) are left out: as
    many as at the first start.

    Args:
        make: From a fingertip, and a case if there are any, to a grasp and a state so near the equilibrium
            that the search does not leap to another one as the fingertip changes.
        cases: A pytree of arrays with a leading axis. Default: one case.
        measure: 'stiffness' (default), 'curvature' or 'rate'.
        neutral: How many directions are left out. Default: as many as the first start has.
        scale: What counts as one in the cost, in the measure's unit. Default: its size at the first start; of
            a stiffness near zero there, as of round fingertips about $O_i$ on a plate, the size of the other
            eigenvalue.

    Raises:
        ValueError: If `make` cannot be called so, `cases` have no common leading axis, `measure` is none of
            the three, `neutral` is not a whole number from 0 up, or `scale` is not positive; and when the
            search begins, if there is no equilibrium in the first case, or 'stiffness' does not apply there.

    Example:
        >>> import jaxroll as jxr, jax.numpy as jnp
        >>> goal = jxr.design.Firmness(
        ...     lambda tip, a: jxr.scenes.pinch_ellipse(a, 0.02, tips=tip, alpha=0.0),
        ...     cases=jnp.linspace(0.012, 0.018, 4),
        ... )
    """

    make: Make = eqx.field(static=True)
    cases: Any
    measure: Measure = eqx.field(static=True)
    neutral: int | None = eqx.field(static=True)
    scale: Float[Array, ""] | None

    def __init__(
        self,
        make: Make,
        *,
        cases: Any = None,
        measure: Measure = "stiffness",
        neutral: int | None = None,
        scale: Given | None = None,
    ) -> None:
        self.make = check_make(make, cases)
        self.cases = check_cases(cases)
        self.measure = check_choice("measure", measure, tuple(_NAMES))
        self.neutral = None if neutral is None else as_count("neutral", neutral, least=0)
        self.scale = None if scale is None else as_positive("scale", scale)

    def aimed(self, tip: AbstractContour) -> "Firmness":
        """This goal; `neutral` and `scale`, unless given, are as at the first start in the first case."""
        case = jax.tree.map(lambda x: x[:1], self.cases)
        values, neutral = _first(self.make, case, self.measure, tabled(tip))
        if not np.all(np.isfinite(values)):
            alone = (
                ", for 'stiffness' with alpha = 0 and without gravity" if self.measure == "stiffness" else ""
            )
            raise ValueError(
                f"argument tip must have an equilibrium in the first case{alone}, but none was found"
            )
        left_out = int(neutral[0]) if self.neutral is None else self.neutral
        sizes = np.sort(np.abs(values[0]))
        soft = self.measure == "stiffness" and sizes[left_out] < _SOFT * sizes[-1]
        scale = sizes[-1 if soft else left_out] if self.scale is None else self.scale
        more = {"measure": self.measure, "neutral": left_out, "scale": scale}
        return Firmness(self.make, cases=self.cases, **more)

    def values(self, tip: AbstractContour, floor: float = 0.0) -> Array:
        """The measure in every case, shape (cases,); `floor` bounds the stiffness (`_stiffnesses`)."""
        neutral = self.neutral or 0

        def found(grasp: Grasp, state: State) -> Array:
            return _smallest(_values(self.measure, grasp, state, floor)[0], neutral)

        return each_case(self.make, self.cases, tip, found)

    def cost(self, tip: AbstractContour, seen: ContourSamples, unit: Scalar, sharpness: Scalar) -> Scalar:
        assert self.scale is not None, "aimed at a start"
        return soft_worst(-self.values(tip, _FLAT) / self.scale, sharpness)

    @property
    def merit(self) -> str:
        return _NAMES[self.measure]

    def figures(self, tip: AbstractContour, seen: ContourSamples) -> dict[str, Array]:
        return {self.merit: jnp.min(self.values(tip)), WORST_MARGIN: worst_margin(seen)}

    def reached(self, figures: dict[str, Array]) -> Bool[Array, "..."]:
        return figures[self.merit] > 0.0


def _values(measure: Measure, grasp: Grasp, state: State, floor: float = 0.0) -> tuple[Array, Array]:
    """The values whose smallest is the measure, NaN without an equilibrium; how many are neutral."""
    if measure == "stiffness":
        return _stiffnesses(grasp, state, floor), jnp.array(0)
    at = assess(grasp, state)
    values = at.curvatures if measure == "curvature" else -at.rates.real
    return jnp.where(at.equilibrium.found, values, jnp.nan), at.neutral


def _stiffnesses(grasp: Grasp, state: State, floor: float) -> Array:
    """Eigenvalues of the Hessian of U at rest, over the angles of the fingertips [N m/rad].

    Where flat meets flat a fingertip rolls without turning, and dividing by its turning would divide by zero:
    `floor` [rad/m] keeps the values finite.
    """
    rest = pinch_rest(grasp, state, damping=_DAMPED)[1]
    # H_ij / (c_i c_j) with c the turning per arclength; 1 / c where the floor is zero.
    inverse = rest.turning / (rest.turning**2 + floor**2)
    (a, b), (_, c) = rest.hessian * (inverse[:, None] * inverse[None, :])
    half, across = 0.5 * (a - c), b * b
    # Eigenvalues of a symmetric 2 x 2 matrix. The last term keeps the root differentiable where they are
    # equal.
    apart = jnp.sqrt(half * half + across + 1e-30 * (a * a + c * c))
    return jnp.stack([0.5 * (a + c) - apart, 0.5 * (a + c) + apart])


def _smallest(values: Array, neutral: int) -> Array:
    """The smallest value, apart from `neutral` zeros that are there whatever the fingertip.

    If a value is negative, the smallest one counts. Otherwise the first `neutral` values are those zeros, to
    rounding, and the next one counts: where it passes through zero it becomes the smallest, without a jump.
    """
    rising = jnp.sort(values)
    least = -_NONE * jnp.max(jnp.abs(values))
    return jnp.where(rising[0] < least, rising[0], rising[neutral])


@quickly
def _first(make: Make, cases: Any, measure: Measure, tip: AbstractContour) -> tuple[Array, Array]:
    """`_values` of every case given, compiled."""
    return each_case(make, cases, tip, lambda grasp, state: _values(measure, grasp, state))
