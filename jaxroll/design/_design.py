"""`Design`: a fingertip that was optimised, with the record of its search and a printed report."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from .._printing import code_name
from .._results import concrete, RESULTS
from ..geometry import AbstractContour
from ._minimise import KEPT


class Design(eqx.Module):
    r"""A fingertip that was optimised.

    Attributes:
        tip: The best contour of all starts.
        start: The contour that it began as.
        tips: The best of every start, with a leading axis on every array.
        before: Shape (starts,), figure of merit of the starts: with `Margin`, the worst margin of (41) [m].
        after: Shape (starts,), that of the best contours.
        violation: Shape (starts,), by how much the most violated limit is passed, relative to it.
        holds: Shape (starts,), which starts ended within the limits with a fingertip that holds.
        chosen: Which start `tip` comes from.
        history: Shape (starts, steps), cost after each step: the smoothed one that is minimised, without
            dimension.
        result: `successful`, `max_steps_reached`, or `infeasible` where no start came within the limits; the
            contour is then the one that passes them least.
        figures: What the goal reports of `start` and of `tip`, by name with unit.
        parts: By how much `tip` passes each limit, relative to it; negative where it is kept.
        interval: First and last arclength of the contact interval [m].
    """

    tip: AbstractContour
    start: AbstractContour
    tips: AbstractContour
    before: Float[Array, " starts"]
    after: Float[Array, " starts"]
    violation: Float[Array, " starts"]
    holds: Bool[Array, " starts"]
    chosen: int = eqx.field(static=True)
    history: Float[Array, "starts steps"]
    result: RESULTS
    figures: dict[str, tuple[float, float]] = eqx.field(static=True)
    parts: dict[str, float] = eqx.field(static=True)
    interval: Float[Array, "2"]

    def __repr__(self) -> str:
        return f"Design({code_name(self.result)}; {type(self.tip).__name__})"

    def __str__(self) -> str:
        return self.report()

    def report(self, steps: str = "`steps`", *, millimetres: bool = False) -> str:
        """What is printed, lengths in metres or `millimetres`; `steps` is the name of the argument."""
        figures = self.figures
        if millimetres:
            figures = dict(_figure_in_millimetres(name, pair) for name, pair in figures.items())
        lines = [
            f"Design: {code_name(self.result)}",
            *self._remedy(steps),
            f"  {'':<28}{'before':>12}{'after':>12}",
            *(f"  {name:<28}{a:>12.4g}{b:>12.4g}" for name, (a, b) in figures.items()),
            f"  steps {self.history.shape[1]}; {int(self.holds.sum())} of {self.after.shape[0]} starts hold",
        ]
        lines += [f"  limit on {name:<19}{_kept(excess)}" for name, excess in self.parts.items()]
        return "\n".join(lines)

    def _remedy(self, steps: str) -> list[str]:
        """A line that says why the search did not succeed, and what helps; none if it did."""
        if concrete(self.result._value) is None:
            return []
        told = {
            "max_steps_reached": f"all {self.history.shape[1]} steps were taken; {steps} allows more",
            "infeasible": f"no start came within the limits in {self.history.shape[1]} steps: {steps} allows "
            "more, or widen those passed below, or begin with another tip",
        }
        text = told.get(code_name(self.result), RESULTS[self.result])
        return [f"  ended     {text}"] if text else []


def _figure_in_millimetres(name: str, pair: tuple[float, float]) -> tuple[str, tuple[float, float]]:
    """A figure and its values; a length in millimetres."""
    if not name.endswith("[m]"):
        return name, pair
    return f"{name.removesuffix('[m]')}[mm]", (1e3 * pair[0], 1e3 * pair[1])


def _kept(excess: float) -> str:
    """In words, by how much a limit is passed or kept; `excess` is relative to its bound."""
    if not np.isfinite(excess):
        return "not finite"
    if excess > KEPT:
        return f"passed by {100 * excess:.3g} %"
    return "met exactly" if excess > -1e-4 else f"kept, {-100 * excess:.3g} % to spare"
