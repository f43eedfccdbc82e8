"""From raw points to a contour, with a report of how well it fits and what is doubtful.

`fit_contour` cleans the points (`_clean_points`), fits a contour of the wanted kind (`FIELDS`), makes sure
that its table can be built, and measures the result: distances of the points, curvature, self-crossings. How
much to smooth a spline is found by `_smoothing`; the kinds of contours are those of `geometry/contours`. With
a smallest radius of curvature all of this goes another way, from the order of the points on (`_limited_fit`).
`_fit_report` has what is returned.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._results import as_count, check_flag, check_length, on_host, shown
from ..._types import Given
from ..._xla import quickly
from .._tabled import tabled
from ..contours import (
    AbstractTabulated,
    NeuralCurvature,
    NeuralSupport,
    polygon_length,
    Spline,
    SupportFunction,
    Table,
)
from ._clean_points import clean_points, CleanPoints, given_points
from ._crossings import crossings
from ._departures import departures, inflections, jumps
from ._fit_report import doubts, Fit, FitReport, recommended
from ._limited_fit import limited, NODES, SHARE, Wanted
from ._ordering import place_text
from ._smoothing import check_alone, smoothing_for

_SAMPLES = 2048  # intervals between the places at which a contour is measured
# Cells of a spline's table where the default, 1024, is too few; a contour that needs more is refused.
_CELLS = (4096, 16384)
# Most knots of a smoothing spline, unless told, and to a wavelength; the cost grows with their cube.
_DENSE, _TO_A_WAVE = 512, 300
_FEWEST = 8  # knots of a smoothing spline, however long the wavelength
_PLACES = 16385  # at which the curvature is compared with what is allowed
_AIM = 0.98  # share of the allowed curvature at which every try but the first aims
_TRIES = 8
_TERMS = (3, 4, 6, 8, 11, 15, 20)  # numbers of Fourier terms of a support function, tried in turn


@dataclass(frozen=True)
class _Wish:
    """What `fit_contour` was asked for beyond the points."""

    closed: bool
    noise: float | None
    smoothing: float | None
    knots: int | None


Maker = Callable[[np.ndarray, _Wish], tuple[AbstractTabulated, float]]


def _spline(points: np.ndarray, wish: _Wish) -> tuple[AbstractTabulated, float]:
    """A spline, through every point without noise, otherwise smoothed as `smoothing_for` finds it."""
    smoothing, knots = wish.smoothing, wish.knots
    # Order matters: whether there is any smoothing decides on the knots, and the knots on how much.
    if smoothing is None and wish.noise == 0.0:
        smoothing = 0.0
    if knots is None and smoothing != 0.0 and len(points) > _DENSE:
        knots = _DENSE
    if smoothing is None:
        smoothing = float(smoothing_for(points, closed=wish.closed, noise=wish.noise, knots=knots))
    if wish.knots is None and smoothing:
        # More knots to a wavelength add nothing but rounding.
        length = polygon_length(points, closed=wish.closed)
        enough = max(_FEWEST, math.ceil(_TO_A_WAVE * length / smoothing))
        knots = enough if enough < (knots or len(points)) else knots
    contour = Spline(points, closed=wish.closed, smoothing=smoothing, knots=knots)
    return contour, smoothing


def _support(points: np.ndarray, wish: _Wish) -> tuple[AbstractTabulated, float]:
    """A support function of as few terms as leave residuals no larger than the noise.

    Without noise it has as many terms as there may be at all: 20, or a third of the number of points.
    """
    most = min(_TERMS[-1], (len(points) - 1) // 3)
    tried = [terms for terms in _TERMS if terms < most] if wish.noise else []
    for terms in (*tried, most):
        contour = SupportFunction.through(points, terms=terms)
        distances = np.asarray(measured_contour(tabled(contour).read(), jnp.asarray(points))[1])
        if wish.noise and np.sqrt(np.mean(distances**2)) <= wish.noise:
            break
    return contour, 0.0


def _network(kind: type[NeuralSupport] | type[NeuralCurvature]) -> Maker:
    """A maker of networks of one kind; training stops at residuals as small as the noise, or 1e-8 m."""

    def make(points: np.ndarray, wish: _Wish) -> tuple[AbstractTabulated, float]:
        return kind.through(points, key=jax.random.key(0), tolerance=wish.noise or 1e-8), 0.0

    return make


# What makes each kind of field: the contour, and its smoothing [m].
FIELDS: dict[str, Maker] = {
    "spline": _spline,
    "support": _support,
    "support network": _network(NeuralSupport),
    "curvature network": _network(NeuralCurvature),
}


@on_host
def fit_contour(
    points: Given,
    *,
    field: str = "spline",
    closed: bool = True,
    ordered: bool | None = None,
    noise: float | None = None,
    smoothing: float | None = None,
    smallest_radius: float | None = None,
    knots: int | None = None,
    unit: str = "m",
    reverse: bool = False,
) -> Fit:
    r"""A smooth contour through or near raw points, with a report.

    The points are cleaned first: duplicates merged, an order found where there is none, turned to run
    counter-clockwise. What cannot be one smooth contour is refused; what is doubtful is in the report.

    Measured points want `smallest_radius`. The contour's curvature is then nowhere above its inverse, in
    concave parts as little as in convex ones, and everything else is found: the noise, from how neighbours
    differ; the smoothing, from the wavelength $2\pi\sqrt{\sigma R}$ on at which noise of standard deviation
    $\sigma$ bends by 1/R; an order, also where the points scatter by more than their spacing; which points
    lie off alone, and are left out; where the points bend more sharply, and are rounded. The report has all
    of that. Such a contour is a spline through nodes of its own.

    Time and memory grow with the cube and the square of the number of knots, which is that of the points
    where every point is met: some thousand at most. Ordering scattered points takes $O(n \log n)$ time,
    and $O(n^2)$ where noise makes it try many orders.

    Args:
        points: Shape (n, 2), n >= 6, in `unit`.
        field: Kind of contour: "spline"; "support", the Fourier series of a support function, convex;
            "support network" (convex) or "curvature network", closed, fitted for some seconds. `noise`
            bounds what the last three are fitted to.
        closed: Whether the contour closes on itself. An open one has the body on its left.
        ordered: True to believe the given order, False to find one, None to find out which.
        noise: Standard deviation of each coordinate's error [m]: 0 goes through every point; None finds
            the smoothing by cross-validation, with `smallest_radius` the noise itself.
        smoothing: Wavelength [m] of wiggles to halve, instead of `noise`. At most half the length of a closed
            contour; 100 times the extent of an open one.
        smallest_radius: Smallest radius of curvature [m] that the contour may have.
        knots: Number of knots. Default: one at every point, where smoothing at most 512 and at most 300 to a
            wavelength; with `smallest_radius` five to a length of that radius, at most 1024. Given with
            `smallest_radius` it must be 48 to 1024, and is rounded up to one of the program's sizes (48, 64,
            96, ...).
        unit: Of `points`: "m", "cm", "mm", "um" or "in". All else is in metres.
        reverse: Turn an open contour round, where the points have the body on their right.

    Returns:
        `Fit`, with `contour` and `report`.

    Raises:
        ValueError: If the points are not finite, fewer than six, in mixed units, in no plausible order,
            leave a gap where `closed`, cross themselves or turn back; if no contour among them can have the
            smallest radius; or another argument is out of range.

    Accuracy: with `smallest_radius`, within twice the noise where the points' own radius allows it, on
    sections of scans with noise of 0.1 to 0.5 mm (`tests/test_smallest_radius.py`).

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> u = 2 * np.pi * np.arange(48) / 48
        >>> fit = jxr.fit_contour(np.stack([20 * np.cos(u), 14 * np.sin(u)], -1), unit="mm", noise=0.0)
        >>> f"{1e3 * fit.report.radius:.2f} mm"  # exact: b**2 / a = 9.8
        '9.80 mm'
        >>> square = [(x, y) for x in range(41) for y in range(41) if x in (0, 40) or y in (0, 40)]
        >>> fit = jxr.fit_contour(square, unit="mm", ordered=False, smallest_radius=5e-3)
        >>> fit.report.radius >= 5e-3, len(fit.report.rounded)
        (True, 4)
    """
    if not isinstance(field, str) or field not in FIELDS:
        raise ValueError(
            f"argument field must be one of {', '.join(map(repr, FIELDS))}, but was {shown(field)}"
        )
    if field != "spline" and not (closed and smoothing is None and knots is None and smallest_radius is None):
        raise ValueError(
            "arguments smoothing, smallest_radius, knots, closed=False are for splines, but field was "
            f"{shown(field)}"
        )
    check_alone(noise, smoothing)
    if smallest_radius is not None:
        wanted = _wanted(closed, ordered, reverse, noise, smoothing, smallest_radius, knots)
        return _bent_at_most(given_points(points, unit), wanted)
    clean = clean_points(points, closed=closed, ordered=ordered, unit=unit, reverse=reverse)
    size = float(np.ptp(clean.points, axis=0).max())
    check_length("noise", noise, 0.1 * size)
    # A closed contour is itself a wave: longer wavelengths shrink it, round by round, from 0.8 of its length
    # on to a point.
    longest = 0.5 * polygon_length(clean.points, closed=True) if closed else 100.0 * size
    check_length("smoothing", smoothing, longest)
    contour, wavelength = FIELDS[field](clean.points, _Wish(closed, noise, smoothing, knots))
    known = None if noise is None else float(noise)
    contour = _resolved(contour)
    seen = _measured(tabled(contour), clean.points)
    return _reported(contour, clean, _Known(field, wavelength, known), seen)


def _resolved(contour: AbstractTabulated) -> AbstractTabulated:
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
        "follow: give smallest_radius, state the noise, or thin out the points"
    )


class Measured(NamedTuple):
    """What a contour is like, and how points lie to it.

    Attributes:
        feet: Arclengths of the points nearest to the data [m].
        distances: Of the data from the contour [m].
        outline: Points of the contour at 2049 places [m].
        curvatures: There [1/m].
        ends: Arclengths of both ends [m].
        peak: Largest absolute curvature at 16385 places [1/m].
    """

    feet: Any
    distances: Any
    outline: Any
    curvatures: Any
    ends: Any
    peak: Any


def _through(nodes: np.ndarray, *, closed: bool) -> Spline:
    """The spline through nodes at equal distances, over arclength.

    With a number of knots, a closed one keeps arclength as its parameter. In one that follows the curvature,
    nodes at equal distances are unevenly spaced: the curvature between them was a quarter too large.
    """
    return Spline(nodes, closed=closed, knots=len(nodes) if closed else None)


@dataclass(frozen=True)
class _Known:
    """What the report repeats of how a contour was made; the last two with a smallest radius alone."""

    field: str
    smoothing: float
    noise: float | None
    radius: float | None = None
    rejected: tuple[tuple[float, float], ...] = ()


def _reported(contour: AbstractTabulated, clean: CleanPoints, known: _Known, seen: Measured) -> Fit:
    """The fit with its report: the contour measured, and what the numbers make doubtful."""
    feet, distances, outline, curvatures, ends, _ = seen
    if not np.all(np.isfinite(curvatures)):
        raise ValueError("argument points must determine a contour, but the fit to them is not finite")
    closed, radius = contour.closed, known.radius
    crosses = len(crossings(outline[:-1] if closed else outline, closed=closed)) > 0
    peak = float(np.max(np.abs(curvatures)))
    rms = float(np.sqrt(np.mean(distances**2)))
    rounded = ()
    if radius is not None:
        limits = {"noise": known.noise or 0.0, "radius": radius}
        rounded = departures(clean.points, feet, distances, closed=closed, **limits)
    report = FitReport(
        field=known.field,
        closed=closed,
        points=len(clean.points),
        merged=clean.merged,
        reordered=clean.reordered,
        reversed=clean.reversed,
        smoothing=known.smoothing,
        rms=rms,
        largest=float(distances.max()),
        length=float(ends[1] - ends[0]),
        curvature=(float(curvatures.min()), float(curvatures.max())),
        radius=1.0 / peak if peak > 0.0 else float("inf"),
        smoothness=contour.smoothness,
        inflections=inflections(curvatures, closed=closed),
        self_intersecting=crosses,
        smallest_radius=radius,
        noise=known.noise,
        rejected=known.rejected,
        rounded=rounded,
        jumps=jumps(clean.points, feet, closed=closed, noise=rms if known.noise is None else known.noise),
        recommendation="",
        warnings=clean.warnings,
    )
    said = (*clean.warnings, *doubts(report, clean.points, distances))
    report = replace(report, warnings=said, recommendation=recommended(report, clean.points))
    return Fit(contour, jax.device_put(clean.points), jax.device_put(feet), report)


def _measured(contour: AbstractTabulated, points: np.ndarray) -> Measured:
    """What `measured_contour` says of a contour with its table, in NumPy.

    The number of points is rounded up to a power of two: JAX compiles anew for every length of an array.
    """
    room = 1 << int(np.ceil(np.log2(len(points))))
    padded = np.pad(points, ((0, room - len(points)), (0, 0)), mode="edge")
    feet, distances, *rest = (np.asarray(x) for x in measured_contour(contour.read(), jnp.asarray(padded)))
    return Measured(feet[: len(points)], distances[: len(points)], *rest)


@quickly
def measured_contour(table: Table, points: Array) -> Measured:
    r"""Feet and distances of points, and the contour itself at evenly spaced places.

    A foot solves $(p - c(s)) \cdot t(s) = 0$, by Newton's method from the nearest of those places. The slope
    of the left side is $-(1 - \kappa\,(p - c) \cdot n)$ with the normal n to the left.

    Compiled quickly: the first call takes 0.5 s instead of 1.1 s of 256 points, and as long of 65 000. It
    reads the table alone, so that one program does for contours of all kinds.
    """
    low, high = table.start, table.start + table.length
    step = (high - low) / _SAMPLES
    places = low + step * jnp.arange(_SAMPLES + 1)
    frames = table.frame(places)
    outline = frames.point.array()

    def near(point: Array) -> Array:
        return places[jnp.argmin(jnp.sum((outline - point[None, :]) ** 2, axis=-1))]

    # In blocks of 256 points: all at once would hold n times 2049 distances.
    start = jax.lax.map(near, points, batch_size=256)
    first, last = start - step, start + step
    if not table.closed:
        first, last = jnp.maximum(first, low), jnp.minimum(last, high)
    s = start
    # Four quadratic steps from within half a cell reach rounding. A foot stays between the neighbours of its
    # place; the slope is kept from zero for points near the centre of curvature, whose foot is not unique.
    for _ in range(4):
        frame = table.frame(s)
        x, y = points[:, 0] - frame.point.x, points[:, 1] - frame.point.y
        along = x * frame.tangent.x + y * frame.tangent.y
        inward = y * frame.tangent.x - x * frame.tangent.y
        s = jnp.clip(s + along / jnp.maximum(1.0 - frame.curvature * inward, 0.1), first, last)
    foot = table.frame(s).point
    distances = jnp.hypot(points[:, 0] - foot.x, points[:, 1] - foot.y)
    sharpest = jnp.max(jnp.abs(table.frame(jnp.linspace(low, high, _PLACES)).curvature))
    return Measured(s, distances, outline, frames.curvature, jnp.stack([low, high]), sharpest)


def _wanted(
    closed: Any, ordered: Any, reverse: Any, noise: Any, smoothing: Any, radius: Any, knots: Any
) -> Wanted:
    """The arguments of a fit with a smallest radius, checked as far as they can be without the points."""
    check_flag("closed", closed)
    check_flag("reverse", reverse)
    if ordered is not None:
        check_flag("ordered", ordered)
    return Wanted(
        closed=closed,
        ordered=ordered,
        reverse=reverse,
        radius=_radius(radius),
        noise=noise,
        smoothing=smoothing,
        knots=None if knots is None else as_count("knots", knots, least=NODES[0], most=NODES[-1]),
    )


def _radius(value: Any) -> float:
    """The smallest radius [m], checked; the sentence for what is no length says so."""
    check_length("smallest_radius", value, float("inf"))
    if not float(value) > 0.0:
        raise ValueError("argument smallest_radius must be a positive length in metres, but was 0")
    return float(value)


def _bent_at_most(points: np.ndarray, wanted: Wanted) -> Fit:
    """The fit with a smallest radius of curvature.

    Between its nodes a curve may bend a little more than at them. So it is tried with ever less than what is
    allowed, until its table nowhere bends more.
    """
    size = float(np.ptp(points, axis=0).max())
    check_length("noise", wanted.noise, 0.1 * size)
    check_length("smoothing", wanted.smoothing, size)
    ready, share = limited(points, wanted), SHARE
    for _ in range(_TRIES):
        found = ready.solved(share)
        peak = wanted.radius * found.sharpest()
        if peak <= 1.0:
            nodes = found.curve.nodes
            contour = _resolved(_through(nodes, closed=wanted.closed))
            seen = _measured(tabled(contour), ready.clean.points)
            peak = wanted.radius * float(seen.peak)
            if peak <= 1.0:
                break
        ready, share = ready.onwards(found), share * min(_AIM, _AIM / peak)
    else:
        raise ValueError(
            f"argument smallest_radius must leave room for a smooth contour among the points, but with "
            f"{wanted.radius:.4g} m the curvature stays at {peak / wanted.radius:.4g} 1/m: the points bend "
            "back too narrowly"
        )
    rejected = tuple((float(x), float(y)) for x, y in ready.strays)
    known = _Known("spline", ready.wavelength, ready.noise, wanted.radius, rejected)
    fit = _reported(contour, ready.clean, known, seen)
    if fit.report.self_intersecting:
        worst = max(fit.report.rounded, key=lambda stretch: stretch.distance, default=None)
        where = "" if worst is None else f" near {place_text(np.array(worst.place))}"
        raise ValueError(
            f"argument smallest_radius must leave room for a contour that does not cross itself, but with "
            f"{wanted.radius:.4g} m it does{where}"
        )
    return fit
