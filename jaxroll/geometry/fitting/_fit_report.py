"""What `fit_contour` returns: the contour with its points, and a report of how it was made of them.

The numbers come from `_contour_fit`, which measures the contour, and from `_departures`; here they are put
into words: what is doubtful, and what to ask for instead.
"""

import textwrap
from collections.abc import Sized
from dataclasses import dataclass

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from ..contours import AbstractContour
from ._departures import CurvatureJump, Departure, natural_radius
from ._ordering import place_text

_MANY = 12  # changes of sign of the curvature beyond which it looks like noise
_WIDTH = 100  # of a printed line


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
        smallest_radius: Smallest radius of curvature that was asked for [m], or None.
        noise: Standard deviation of each coordinate [m]: given, or with a smallest radius estimated; else
            None.
        rejected: Points [m] left out because they lie off the contour alone.
        rounded: Stretches that the points lie off because the contour may not bend as they do; of a fit with
            a smallest radius.
        jumps: Where the curvature of the points jumps, or their direction.
        recommendation: What to ask for instead, in a sentence; empty where nothing speaks against the fit.
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
    smallest_radius: float | None
    noise: float | None
    rejected: tuple[tuple[float, float], ...]
    rounded: tuple[Departure, ...]
    jumps: tuple[CurvatureJump, ...]
    recommendation: str
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        changes = [f"{self.merged} merged"] if self.merged else []
        changes += [f"{len(self.rejected)} rejected"] if self.rejected else []
        changes += [word for word in ("reordered", "reversed") if getattr(self, word)]
        low, high = self.curvature
        wave = f"wavelength {1e3 * self.smoothing:.4g} mm" if self.smoothing else "none: through every point"
        distance = f"{1e6 * self.rms:.3g} um rms, {1e6 * self.largest:.3g} um at most"
        asked = "" if self.smallest_radius is None else f", {1e3 * self.smallest_radius:.4g} mm allowed"
        rows = {
            "contour": f"{'closed' if self.closed else 'open'} {self.field}, {1e3 * self.length:.6g} mm long",
            "points": ", ".join([f"{self.points} used", *changes]),
            "smoothing": wave,
            "distance of points": "none but rounding" if self.largest < 1e-13 else distance,
            "noise": "" if not self.noise else f"{1e6 * self.noise:.3g} um in each coordinate",
            "rounded": _rounded_text(self.rounded),
            "curvature": f"{low:.4g} to {high:.4g} 1/m, {self.inflections or 'no'} changes of sign",
            "smallest radius": f"{1e3 * self.radius:.4g} mm{asked}",
            "smoothness": f"{self.smoothness:g} continuous derivatives",
            "crosses itself": "yes" if self.self_intersecting else "no",
        }
        lines = [f"{name:<20}{value}" for name, value in rows.items() if value]
        lines += [line for text in self.warnings for line in textwrap.wrap(f"warning: {text}", _WIDTH)]
        if self.recommendation:
            lines += textwrap.wrap(f"recommended: {self.recommendation}", _WIDTH)
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


def _rounded_text(rounded: tuple[Departure, ...]) -> str:
    """How many stretches were rounded, and the worst of them."""
    if not rounded:
        return ""
    worst = max(rounded, key=lambda stretch: stretch.distance)
    count = f"{len(rounded)} stretches, " if len(rounded) > 1 else ""
    return f"{count}by up to {1e3 * worst.distance:.3g} mm at {place_text(np.array(worst.place))}"


def _plural(things: Sized) -> str:
    """The ending of a noun in the plural, where there are several."""
    return "s" if len(things) > 1 else ""


def doubts(report: FitReport, points: np.ndarray, distances: np.ndarray) -> list[str]:
    """Warnings about the fitted contour, as sentences."""
    spacing = float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    found, radius, free = [], report.radius, report.smallest_radius is None
    if report.self_intersecting:
        found.append("The contour crosses itself: state the noise, or thin out the points.")
    if free and radius < spacing:
        found.append(
            f"The contour bends with a radius of {1e3 * radius:.3g} mm, less than the points' spacing of "
            f"{1e3 * spacing:.3g} mm: it follows noise or a corner, or the points are too few."
        )
    if report.inflections > _MANY:
        found.append(
            f"The curvature changes sign {report.inflections} times: the contour may follow "
            "errors of the points; a larger "
            f"{'noise or smoothing' if free else 'smallest_radius'} leaves them out."
        )
    rms, worst = report.rms, int(np.argmax(distances))
    if free and distances[worst] > max(5.0 * rms, 1e-3 * spacing):
        found.append(
            f"The point {place_text(points[worst])} lies {1e3 * distances[worst]:.3g} mm off the contour, "
            f"{distances[worst] / rms:.1f} times the rms distance."
        )
    return [*found, *_departed(report), *_jumped(report)]


def _departed(report: FitReport) -> list[str]:
    """Sentences about points that were left out and stretches that were rounded."""
    found = []
    if report.rejected:
        first = place_text(np.array(report.rejected[0]))
        found.append(
            f"{len(report.rejected)} point{_plural(report.rejected)} left out as off the contour alone, the "
            f"first at {first}."
        )
    if report.rounded:
        where = max(report.rounded, key=lambda stretch: stretch.distance)
        found.append(
            f"The points bend more sharply than the smallest radius at {len(report.rounded)} "
            f"place{_plural(report.rounded)}, where the contour departs from them by up to "
            f"{1e3 * where.distance:.3g} mm, between the arclengths {1e3 * where.start:.4g} and "
            f"{1e3 * where.end:.4g} mm."
        )
    return found


def _jumped(report: FitReport) -> list[str]:
    """Sentences about jumps of the curvature and about corners."""
    corners = [jump for jump in report.jumps if jump.angle]
    arcs = [jump for jump in report.jumps if not jump.angle]
    found = []
    if corners and report.smallest_radius is not None:
        worst = max(corners, key=lambda jump: abs(jump.angle))
        found.append(
            f"The points have {len(corners)} corner{_plural(corners)}, of up to "
            f"{abs(np.rad2deg(worst.angle)):.0f} degrees at {place_text(np.array(worst.place))}, rounded to "
            "the smallest radius."
        )
    if arcs:
        worst = max(arcs, key=lambda jump: abs(jump.after - jump.before))
        found.append(
            f"The curvature of the points jumps at {len(arcs)} place{_plural(arcs)}, most at "
            f"{place_text(np.array(worst.place))} from {worst.before:.3g} to {worst.after:.3g} 1/m; the "
            "contour's does so over some distance."
        )
    return found


def recommended(report: FitReport, points: np.ndarray) -> str:
    """What to ask for instead, in a sentence, or nothing."""
    noisy = report.inflections > _MANY or report.self_intersecting
    if report.field == "spline" and report.smallest_radius is None:
        corners = [jump for jump in report.jumps if jump.angle]
        if corners:
            return (
                f"smallest_radius, as the radius that the points' {len(corners)} "
                f"corner{_plural(corners)} are to be rounded to."
            )
        spacing = float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        radius = natural_radius(points, closed=report.closed) if noisy or report.radius < spacing else None
        if radius is None:
            return ""
        return (
            f"smallest_radius={radius:.2g} [m]: no bend of the points that lasts while they are smoothed is "
            "sharper."
        )
    if report.smallest_radius is None:
        return ""
    if report.rounded:
        worst = max(report.rounded, key=lambda stretch: stretch.distance)
        return (
            f"a smallest_radius below {report.smallest_radius:.3g} m, if the points at "
            f"{place_text(np.array(worst.place))} are shape; if they are not, keep it."
        )
    if noisy:
        return (
            f"a smallest_radius above {report.smallest_radius:.3g} m: curvature that changes sign "
            f"{report.inflections} times may still be noise."
        )
    return ""
