"""Where a contour departs from its points, and why: rounded stretches, strays, jumps of the curvature.

All of it is judged by the points in their order. A stretch where neighbours lie off together is shape that
the contour does not have; one point off alone is a stray. A curvature that jumps between two stretches of
steady curvature is a line that meets an arc; a corner is a jump of the direction. `_contour_fit` puts what is
found here into its report.
"""

from dataclasses import dataclass

import numpy as np

from ._even_spline import low_passed
from ._ordering import turnings

_OFF = 3.0  # standard deviations beyond which a point counts as off the contour
_STRAY = 6.0  # standard deviations beyond which a point alone is a stray
# Least standard deviations that are reckoned with, in smallest radii: for stretches, and for single points;
# the latter is larger, since neighbouring points of a scan share errors.
_FINEST = 1e-3
_ALONE = 5e-3
_SIDE = 4  # points on either side of a jump from which curvature is taken
_STANDS_OUT = 6.0  # times by which a jump must exceed the changes of curvature on both sides of it
_ABOVE = 20.0  # times the noise that a corner or a jump must move a point by over one step
_LEAST_JUMP = 0.02  # least jump, as a share of the largest curvature
_TRIED = 40  # wavelengths that are tried for a recommendation


@dataclass(frozen=True)
class Departure:
    """A stretch of a contour that the points lie off.

    Attributes:
        start: Arclength [m] of its first point's foot.
        end: Arclength [m] of its last point's foot; below `start` where the stretch runs past the end.
        place: The point that lies farthest off [m].
        distance: How far that is [m].
    """

    start: float
    end: float
    place: tuple[float, float]
    distance: float


@dataclass(frozen=True)
class CurvatureJump:
    """A place where the curvature of the points jumps, or their direction.

    Attributes:
        place: The point there [m].
        arclength: Of its foot on the contour [m].
        before: Curvature of the points before it [1/m].
        after: Curvature of the points behind it [1/m].
        angle: Angle of a corner [rad], to the left positive; 0 where only the curvature jumps.
    """

    place: tuple[float, float]
    arclength: float
    before: float
    after: float
    angle: float


def departures(
    points: np.ndarray, feet: np.ndarray, distances: np.ndarray, *, closed: bool, noise: float, radius: float
) -> tuple[Departure, ...]:
    """Stretches of at least two neighbouring points off the contour by more than noise explains.

    Args:
        points: Shape (n, 2) [m].
        feet: Arclengths of their feet [m].
        distances: From the contour [m].
        closed: Whether a stretch may run past the contour's end.
        noise: Standard deviation of each coordinate [m].
        radius: Smallest radius that was asked for [m]; stretches nearer to each other than that are one.
    """
    order = np.argsort(feet, kind="stable")
    off = order[distances[order] > _OFF * max(noise, _FINEST * radius)]
    if not len(off):
        return ()
    parts = np.split(off, np.flatnonzero(np.diff(feet[off]) > radius) + 1)
    # A stretch that runs past s = 0 comes in two parts, at both ends of the order.
    length = float(np.max(feet)) - float(np.min(feet))
    if closed and len(parts) > 1 and feet[parts[0][0]] - feet[parts[-1][-1]] + length < radius:
        parts = [*parts[1:-1], np.concatenate([parts[-1], parts[0]])]
    found = []
    for part in parts:
        if len(part) < 2:
            continue
        worst = int(part[np.argmax(distances[part])])
        place = (float(points[worst, 0]), float(points[worst, 1]))
        found.append(Departure(float(feet[part[0]]), float(feet[part[-1]]), place, float(distances[worst])))
    return tuple(found)


def strays(
    places: np.ndarray, distances: np.ndarray, bending: np.ndarray, *, noise: float, radius: float
) -> np.ndarray:
    """Indices of points far off a curve whose neighbours are not.

    Args:
        places: Of the points' feet along the curve, in any unit.
        distances: From the curve [m].
        bending: Curvature of the curve there, as a share of what is allowed: where it is near 1, the curve
            may be off because it cannot bend more.
        noise: Standard deviation of each coordinate [m].
        radius: Smallest radius that was asked for [m].
    """
    order = np.argsort(places, kind="stable")
    off, felt = np.abs(distances)[order], max(noise, _ALONE * radius)
    beside = np.median([np.roll(off, k) for k in (-2, -1, 1, 2)], axis=0)
    alone = (off > _STRAY * felt) & (beside < 2.0 * felt) & (np.abs(bending[order]) < 0.9)
    return np.sort(order[alone])


def three_point_curvatures(points: np.ndarray, *, closed: bool) -> np.ndarray:
    """Curvature [1/m] of the circle through every point and its neighbours; an open polygon's ends have 0."""
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    across = before + after
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    sides = np.prod([np.linalg.norm(x, axis=1) for x in (before, after, across)], axis=0)
    curvatures = 2.0 * cross / np.maximum(sides, np.finfo(float).tiny)
    if not closed:
        curvatures[[0, -1]] = 0.0
    return curvatures


def jumps(
    points: np.ndarray, feet: np.ndarray, *, closed: bool, noise: float = 0.0
) -> tuple[CurvatureJump, ...]:
    """Corners, and places where the curvature of points without noise jumps.

    The curvature beside a jump must be steady: on both sides together it changes by less than a sixth of the
    jump over four points. A smooth curve's does not do that. Noise may by chance: what is found must be
    larger than what `noise`, its standard deviation [m], makes of points as near each other.
    """
    n = len(points)
    if n < 4 * _SIDE + 4:
        return ()
    bend, angles = three_point_curvatures(points, closed=closed), turnings(points, closed=closed)
    here = np.arange(n) if closed else np.arange(_SIDE + 2, n - _SIDE - 2)
    # The curvature at a point and at its two neighbours mixes both sides of a jump there.
    sides = [bend[(here[:, None] + k * np.arange(2, _SIDE + 2)) % n] for k in (-1, 1)]
    (before, one), (after, other) = ((np.median(x, axis=1), np.ptp(x, axis=1)) for x in sides)
    unsteady = one + other
    size, steady = np.abs(after - before), _LEAST_JUMP * float(np.max(np.abs([before, after])))
    # A corner turns by more than the curvature on both sides of it over its two steps.
    step = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    reach = 0.5 * (step + np.roll(step, 1))[here]
    angle = angles[here] - 0.5 * (before + after) * reach
    corner = (np.abs(angle) > np.pi / 18) & (np.abs(angle) > _STANDS_OUT * (unsteady + size) * reach)
    corner &= np.abs(angle) * reach > _ABOVE * noise
    jump = (size > _STANDS_OUT * unsteady) & (size > steady) & (size * reach**2 > _ABOVE * noise) & ~corner
    found = []
    for i in _peaks(jump | corner, np.where(corner, np.abs(angle) / reach, size), closed=closed):
        k = int(here[i])
        place = (float(points[k, 0]), float(points[k, 1]))
        turn = float(angle[i]) if corner[i] else 0.0
        found.append(CurvatureJump(place, float(feet[k]), float(before[i]), float(after[i]), turn))
    return tuple(found)


def _peaks(flags: np.ndarray, sizes: np.ndarray, *, closed: bool) -> list[int]:
    """The flagged place of the largest size in every run of flags with gaps of at most two."""
    at = np.flatnonzero(flags)
    if not len(at):
        return []
    runs = np.split(at, np.flatnonzero(np.diff(at) > 3) + 1)
    if closed and len(runs) > 1 and runs[0][0] + len(flags) - runs[-1][-1] <= 3:
        runs = [np.concatenate([runs[-1], runs[0]]), *runs[1:-1]]
    return sorted(int(run[np.argmax(sizes[run])]) for run in runs)


def natural_radius(points: np.ndarray, *, closed: bool) -> float | None:
    """A smallest radius of curvature [m] that leaves the shape and not its noise, or None.

    The polygon is smoothed by ever longer wavelengths. Changes of sign of the curvature that noise makes
    vanish one after the other, those of the shape stay: over the widest range of wavelengths in which their
    number stays, the shape is what is left, and the smallest radius at the beginning of that range is
    the answer.
    """
    line = np.concatenate([points, points[:1]]) if closed else points
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    length, count = float(along[-1]), 1024
    at = np.linspace(0.0, length, count + 1)[:-1] if closed else np.linspace(0.0, length, count)
    nodes = np.stack([np.interp(at, along, x) for x in line.T], axis=1)
    waves = np.geomspace(2.0 * length / len(points), 0.25 * length, _TRIED)
    changes, peaks = [], []
    for wave in waves:
        bend = three_point_curvatures(low_passed(nodes, length, wave, closed=closed), closed=closed)
        changes.append(inflections(bend, closed=closed))
        peaks.append(float(np.max(np.abs(bend))))
    runs = np.split(np.arange(_TRIED), np.flatnonzero(np.diff(changes)) + 1)
    longest = max(runs, key=len)
    if len(longest) < 4 or not peaks[longest[0]] > 0.0:
        return None
    # To two digits, downwards.
    radius = 1.0 / peaks[longest[0]]
    unit = 10.0 ** (np.floor(np.log10(radius)) - 1.0)
    return float(np.floor(radius / unit) * unit)


def inflections(curvatures: np.ndarray, *, closed: bool) -> int:
    """How often the curvature changes sign; values below 1 % of the largest are left out as rounding."""
    signs = np.sign(curvatures[np.abs(curvatures) > 0.01 * np.abs(curvatures).max()])
    if not len(signs):
        return 0
    return int(np.sum(signs[1:] != signs[:-1])) + int(closed and signs[0] != signs[-1])
