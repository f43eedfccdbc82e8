"""From raw points to a contour, with a report of how well it fits and what is doubtful.

`fit_contour` cleans the points (`_clean_points`), fits a contour of the wanted kind (`FIELDS`), makes sure
that its table can be built, and measures the result: distances of the points, curvature, self-crossings. How
much to smooth a spline is found by `_smoothing`; the kinds of contours are those of `geometry/contours`.
"""

import textwrap
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._results import as_floats, shown
from ..._types import Given
from .._tabled import tabled
from ..contours import AbstractContour, NeuralCurvature, NeuralSupport, Spline, SupportFunction
from ._clean_points import clean_points, CleanPoints
from ._crossings import crossings
from ._ordering import place_text
from ._smoothing import smoothing_for

_SAMPLES = 2048  # intervals between the places at which a contour is measured
# Cells of a spline's table where the default, 1024, is too few; a contour that needs more is refused.
_CELLS = (4096, 16384)
_DENSE = 512  # most knots of a smoothing spline, unless told; the cost grows with their cube
_TERMS = (3, 4, 6, 8, 11, 15, 20)  # numbers of Fourier terms of a support function, tried in turn


@dataclass(frozen=True)
class FitReport:
    """How a contour was made of points; prints as a table.

    Attributes:
        field: Kind of field, as given to `fit_contour`.
        closed: Whether the contour closes on itself.
        points: Number of points used.
        merged: Number of points dropped as duplicates.
        reordered: Whether an order had to be found.
        reversed: Whether the points ran clockwise.
        smoothing: Wavelength [m] of the wiggles that were halved; 0 where none were.
        rms: Root mean square distance of the points from the contour [m].
        largest: Largest such distance [m].
        length: Arclength [m].
        curvature: Smallest and largest curvature [1/m].
        radius: Smallest radius of curvature [m].
        smoothness: Continuous derivatives of the point.
        inflections: How often the curvature changes sign; changes below 1 % of its peak are not counted.
        self_intersecting: Whether the contour crosses itself.
        warnings: What is doubtful, in sentences.
    """

    field: str
    closed: bool
    points: int
    merged: int
    reordered: bool
    reversed: bool
    smoothing: float
    rms: float
    largest: float
    length: float
    curvature: tuple[float, float]
    radius: float
    smoothness: float
    inflections: int
    self_intersecting: bool
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        changes = [f"{self.merged} merged"] if self.merged else []
        changes += [word for word in ("reordered", "reversed") if getattr(self, word)]
        low, high = self.curvature
        wave = f"wavelength {1e3 * self.smoothing:.4g} mm" if self.smoothing else "none: through every point"
        distance = f"{1e6 * self.rms:.3g} um rms, {1e6 * self.largest:.3g} um at most"
        rows = {
            "contour": f"{'closed' if self.closed else 'open'} {self.field}, {1e3 * self.length:.6g} mm long",
            "points": ", ".join([f"{self.points} used", *changes]),
            "smoothing": wave,
            "distance of points": "none but rounding" if self.largest < 1e-13 else distance,
            "curvature": f"{low:.4g} to {high:.4g} 1/m, {self.inflections or 'no'} changes of sign",
            "smallest radius": f"{1e3 * self.radius:.4g} mm",
            "smoothness": f"{self.smoothness:g} continuous derivatives",
            "crosses itself": "yes" if self.self_intersecting else "no",
        }
        lines = [f"{name:<20}{value}" for name, value in rows.items()]
        lines += [line for text in self.warnings for line in textwrap.wrap(f"warning: {text}", 100)]
        return "\n".join(lines)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Fit:
    """A contour made of points.

    Attributes:
        contour: The contour, differentiable in its own arrays; s = 0 at or near the first point.
        points: Shape (n, 2), the points used [m].
        feet: Shape (n,), arclengths [m] of the points of the contour nearest to them.
        report: `FitReport`.
    """

    contour: AbstractContour
    points: Array
    feet: Array
    report: FitReport = eqx.field(static=True)


@dataclass(frozen=True)
class _Wish:
    """What `fit_contour` was asked for beyond the points."""

    closed: bool
    noise: float | None
    smoothing: float | None
    knots: int | None


Maker = Callable[[np.ndarray, _Wish], tuple[AbstractContour, float]]


def _spline(points: np.ndarray, wish: _Wish) -> tuple[AbstractContour, float]:
    """A spline, through every point without noise, otherwise smoothed as `smoothing_for` finds it."""
    smoothing, knots = wish.smoothing, wish.knots
    # Order matters: whether there is any smoothing decides on the knots, and the knots on how much.
    if smoothing is None and wish.noise == 0.0:
        smoothing = 0.0
    if knots is None and smoothing != 0.0 and len(points) > _DENSE:
        knots = _DENSE
    if smoothing is None:
        smoothing = float(smoothing_for(points, closed=wish.closed, noise=wish.noise, knots=knots))
    contour = Spline(points, closed=wish.closed, smoothing=smoothing, knots=knots)
    return contour, smoothing


def _support(points: np.ndarray, wish: _Wish) -> tuple[AbstractContour, float]:
    """A support function of as few terms as leave residuals no larger than the noise.

    Without noise it has as many terms as there may be at all: 20, or a third of the number of points.
    """
    most = min(_TERMS[-1], (len(points) - 1) // 3)
    tried = [terms for terms in _TERMS if terms < most] if wish.noise else []
    for terms in (*tried, most):
        contour = SupportFunction.through(points, terms=terms)
        distances = np.asarray(measured(tabled(contour), jnp.asarray(points))[1])
        if wish.noise and np.sqrt(np.mean(distances**2)) <= wish.noise:
            break
    return contour, 0.0


def _network(kind: type[NeuralSupport] | type[NeuralCurvature]) -> Maker:
    """A maker of networks of one kind; training stops at residuals as small as the noise, or 1e-8 m."""

    def make(points: np.ndarray, wish: _Wish) -> tuple[AbstractContour, float]:
        return kind.through(points, key=jax.random.key(0), tolerance=wish.noise or 1e-8), 0.0

    return make


# What makes each kind of field: the contour, and its smoothing [m].
FIELDS: dict[str, Maker] = {
    "spline": _spline,
    "support": _support,
    "support network": _network(NeuralSupport),
    "curvature network": _network(NeuralCurvature),
}


def fit_contour(
    points: Given,
    *,
    field: str = "spline",
    closed: bool = True,
    ordered: bool | None = None,
    noise: float | None = None,
    smoothing: float | None = None,
    knots: int | None = None,
    unit: str = "m",
    reverse: bool = False,
) -> Fit:
    r"""A smooth contour through or near raw points, with a report.

    The points are cleaned first: duplicates merged, an order found where there is none, turned to run
    counter-clockwise. What cannot be one smooth contour is refused; what is doubtful is in the report.

    Time and memory grow with the cube and the square of the number of knots, which is that of the points
    where every point is met: some thousand at most. Ordering scattered points takes $O(n \log n)$ time, and
    $O(n^2)$ where noise makes it try many orders.

    Args:
        points: Shape (n, 2), n >= 6, in `unit`.
        field: Kind of contour: "spline"; "support", the Fourier series of a support function, convex;
            "support network" (convex) or "curvature network", closed, fitted for some seconds. `noise`
            bounds what the last three are fitted to.
        closed: Whether the contour closes on itself. An open one has the body on its left.
        ordered: True to believe the given order, False to find one, None to find out which.
        noise: Standard deviation of each coordinate's error [m]: 0 goes through every point; None finds
            the smoothing by cross-validation.
        smoothing: Wavelength [m] of wiggles to halve, instead of `noise`.
        knots: Number of knots; None: one at every point, but at most 512 where smoothing.
        unit: Of `points`: "m", "mm", "um" or "in". All else is in metres.
        reverse: Turn an open contour round, where the points have the body on their right.

    Returns:
        `Fit`, with `contour` and `report`.

    Raises:
        ValueError: If the points are not finite, fewer than six, in mixed units, in no plausible order,
            leave a gap where `closed`, cross themselves or turn back; or another argument is out of range.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> u = 2 * np.pi * np.arange(48) / 48
        >>> fit = jxr.fit_contour(np.stack([20 * np.cos(u), 14 * np.sin(u)], -1), unit="mm", noise=0.0)
        >>> f"{1e3 * fit.report.radius:.2f} mm"  # exact: b**2 / a = 9.8
        '9.80 mm'
    """
    if not isinstance(field, str) or field not in FIELDS:
        raise ValueError(
            f"argument field must be one of {', '.join(map(repr, FIELDS))}, but was {shown(field)}"
        )
    clean = clean_points(points, closed=closed, ordered=ordered, unit=unit, reverse=reverse)
    size = float(np.ptp(clean.points, axis=0).max())
    _check_length("noise", noise, 0.1 * size)
    _check_length("smoothing", smoothing, 100.0 * size)
    if noise is not None and smoothing is not None:
        raise ValueError(f"argument noise must be None where smoothing is given, but was {shown(noise)}")
    if field != "spline" and not (closed and smoothing is None and knots is None):
        raise ValueError(
            f"arguments smoothing, knots, closed=False are for splines, but field was {shown(field)}"
        )
    contour, wavelength = FIELDS[field](clean.points, _Wish(closed, noise, smoothing, knots))
    return _reported(_resolved(contour), clean, field, wavelength)


def _resolved(contour: AbstractContour) -> AbstractContour:
    """The contour with as many cells as its table needs: 1024, 4096 or 16384 for a spline.

    A table is refused with a sentence about `cells` where the contour bends too sharply for its cells.
    Contours of other kinds are not changed.
    """
    for cells in (*_CELLS, None):
        try:
            tabled(contour)
        except ValueError as error:
            if not str(error).startswith("argument cells"):
                break
            if cells is None or not isinstance(contour, Spline):
                break
            # The number of cells is a static field: a new contour of the same points and smoothing.
            options = {"closed": contour.closed, "knots": contour.knots, "cells": cells}
            contour = Spline(contour.points, smoothing=contour.wavelength, **options)
        else:
            return contour
    raise ValueError(
        "argument points must determine a contour, but the fit to them bends more sharply than its table can "
        "follow: state the noise, or thin out the points"
    )


def _check_length(name: str, value: Any, most: float) -> None:
    """Raise unless a length is None or lies between 0 and `most` [m]."""
    if value is None:
        return
    try:
        seen = float(as_floats(name, value, ()))
    except ValueError as error:
        if "finite" in str(error):  # infinity and NaN: the sentence below, with the bounds, says more
            seen = float(value)
        else:
            raise ValueError(f"argument {name} must be a length in metres, but was {shown(value)}") from None
    if not 0.0 <= seen <= most:
        raise ValueError(f"argument {name} must lie between 0 and {most:.3g} m here, but was {seen:g}")


def _reported(contour: AbstractContour, clean: CleanPoints, field: str, smoothing: float) -> Fit:
    """The fit with its report: the contour measured, and what the numbers make doubtful."""
    points = jnp.asarray(clean.points)
    feet, distances, outline, curvatures, ends = measured(tabled(contour), points)
    outline, curvatures, distances = (np.asarray(x) for x in (outline, curvatures, distances))
    if not np.all(np.isfinite(curvatures)):
        raise ValueError("argument points must determine a contour, but the fit to them is not finite")
    closed = contour.closed
    crosses = len(crossings(outline[:-1] if closed else outline, closed=closed)) > 0
    peak = float(np.max(np.abs(curvatures)))
    radius = 1.0 / peak if peak > 0.0 else float("inf")
    report = FitReport(
        field=field,
        closed=closed,
        points=len(clean.points),
        merged=clean.merged,
        reordered=clean.reordered,
        reversed=clean.reversed,
        smoothing=smoothing,
        rms=float(np.sqrt(np.mean(distances**2))),
        largest=float(distances.max()),
        length=float(ends[1] - ends[0]),
        curvature=(float(curvatures.min()), float(curvatures.max())),
        radius=radius,
        smoothness=contour.smoothness,
        inflections=_inflections(curvatures, closed=closed),
        self_intersecting=crosses,
        warnings=clean.warnings,
    )
    doubts = _doubts(report, clean.points, distances)
    return Fit(contour, points, feet, replace(report, warnings=(*clean.warnings, *doubts)))


def _inflections(curvatures: np.ndarray, *, closed: bool) -> int:
    """How often the curvature changes sign; values below 1 % of the largest are left out as rounding."""
    signs = np.sign(curvatures[np.abs(curvatures) > 0.01 * np.abs(curvatures).max()])
    return int(np.sum(signs[1:] != signs[:-1])) + int(closed and signs[0] != signs[-1])


def _doubts(report: FitReport, points: np.ndarray, distances: np.ndarray) -> list[str]:
    """Warnings about the fitted contour, as sentences."""
    spacing = float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    doubts, radius = [], report.radius
    if report.self_intersecting:
        doubts.append("The contour crosses itself: state the noise, or thin out the points.")
    if radius < spacing:
        doubts.append(
            f"The contour bends with a radius of {1e3 * radius:.3g} mm, less than the points' spacing of "
            f"{1e3 * spacing:.3g} mm: it follows noise or a corner, or the points are too few."
        )
    if report.inflections > 12:
        doubts.append(
            f"The curvature changes sign {report.inflections} times: the contour may follow "
            "errors of the points; a larger noise or smoothing leaves them out."
        )
    rms, worst = report.rms, int(np.argmax(distances))
    if distances[worst] > max(5.0 * rms, 1e-3 * spacing):
        doubts.append(
            f"The point {place_text(points[worst])} lies {1e3 * distances[worst]:.3g} mm off the contour, "
            f"{distances[worst] / rms:.1f} times the rms distance."
        )
    return doubts


@eqx.filter_jit
def measured(contour: AbstractContour, points: Array) -> tuple[Array, Array, Array, Array, Array]:
    r"""Feet [m] and distances [m] of points; outline [m] and curvatures [1/m] at 2049 places; both ends [m].

    A foot solves $(p - c(s)) \cdot t(s) = 0$, by Newton's method from the nearest of those places. The slope
    of the left side is $-(1 - \kappa\,(p - c) \cdot n)$ with the normal n to the left.
    """
    ready = contour.prepared()
    domain = ready.domain()
    assert domain is not None, "a contour through points has ends"
    low, high = domain
    step = (high - low) / _SAMPLES
    places = low + step * jnp.arange(_SAMPLES + 1)
    frames = ready.frame(places)
    outline = frames.point.array()

    def near(point: Array) -> Array:
        return places[jnp.argmin(jnp.sum((outline - point[None, :]) ** 2, axis=-1))]

    # In blocks of 256 points: all at once would hold n times 2049 distances.
    start = jax.lax.map(near, points, batch_size=256)
    first, last = start - step, start + step
    if not contour.closed:
        first, last = jnp.maximum(first, low), jnp.minimum(last, high)
    s = start
    # Four quadratic steps from within half a cell reach rounding. A foot stays between the neighbours of its
    # place; the slope is kept from zero for points near the centre of curvature, whose foot is not unique.
    for _ in range(4):
        frame = ready.frame(s)
        x, y = points[:, 0] - frame.point.x, points[:, 1] - frame.point.y
        along = x * frame.tangent.x + y * frame.tangent.y
        inward = y * frame.tangent.x - x * frame.tangent.y
        s = jnp.clip(s + along / jnp.maximum(1.0 - frame.curvature * inward, 0.1), first, last)
    foot = ready.frame(s).point
    distances = jnp.hypot(points[:, 0] - foot.x, points[:, 1] - foot.y)
    return s, distances, outline, frames.curvature, jnp.stack([low, high])
