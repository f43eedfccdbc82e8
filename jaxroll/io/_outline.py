"""A contour as a polygon within a tolerance; polygons with evenly spaced points; checks of numbers for `io`.

`_files` and `_mesh` write what `outline` makes; `_svg` and `_dxf` use the functions on polygons below it.
"""

from typing import Any

import numpy as np

from .._results import as_array, check_instance, shown
from .._xla import quickly
from ..geometry import AbstractContour, tabled

_FINE = 4096  # intervals in which the curvature is sampled
_FEWEST = 32  # fewest points on a contour
_MOST = 200_000  # most points


def outline(contour: AbstractContour, tolerance: float) -> np.ndarray:
    r"""Points [m] on a contour whose chords stay within a tolerance of it.

    A chord of length $h$ leaves the curve by $|\kappa| h^2/8$, so points stand $\sqrt{8\epsilon/|\kappa|}$
    apart, at most a 32nd of the length; the middle of every chord is then checked.

    Args:
        contour: With ends, or closed; a closed one's first point is not repeated.
        tolerance: Largest distance [m] of a chord from the contour.

    Raises:
        ValueError: If the contour has no ends, or the tolerance is not positive or needs over 200000 points.
    """
    tolerance = positive("tolerance", tolerance)
    contour = _prepared(tabled(check_instance("contour", contour, AbstractContour, "a contour")))
    domain = contour.domain()
    if domain is None:
        raise ValueError(f"argument contour must be closed or have ends, but was {shown(contour)}")
    low, high = (float(end) for end in domain)
    fine = np.linspace(low, high, _FINE + 1)
    # `density`: points per metre, sqrt(curvature / (8 tolerance)), at least 32 on the whole length. Its
    # integral `total` counts points; equal steps of it give chords that all leave the contour equally far.
    bend = np.abs(np.asarray(contour.curvature(fine)))
    density = np.maximum(np.sqrt(bend / (8.0 * tolerance)), _FEWEST / (high - low))
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(fine)
    total = np.concatenate([[0.0], np.cumsum(steps)])
    count = int(np.ceil(1.02 * total[-1]))
    while count <= _MOST:
        # Ends of chords and points halfway in turn. Deviations fall with the square of the number of chords.
        s = np.interp(np.linspace(0.0, total[-1], 2 * count + 1), total, fine)
        points = _points(contour, s)
        ends, middles = points[::2], points[1::2]
        worst = float(_off_chords(ends, middles).max())
        if worst <= tolerance:
            return ends[:-1] if contour.closed else ends
        count = int(np.ceil(1.05 * np.sqrt(worst / tolerance) * count))
    raise ValueError(f"argument tolerance must need at most {_MOST} points, but was {tolerance:g} m")


def positive(name: str, value: Any) -> float:
    """The value as a positive, finite number; raises a ValueError where it is none."""
    wanted = f"argument {name} must be a positive number, but was {{}}"
    try:
        number = float(as_array(name, value))
    except (TypeError, ValueError):
        raise ValueError(wanted.format(shown(value))) from None
    if not 0.0 < number < np.inf:
        raise ValueError(wanted.format(f"{number:g}"))
    return number


@quickly
def _prepared(contour: AbstractContour) -> AbstractContour:
    """The contour with all worked out that does not depend on the place."""
    return contour.prepared()


def _points(contour: AbstractContour, s: np.ndarray) -> np.ndarray:
    """Points [m] at any number of arclengths.

    Their number is rounded up to a power of two, since JAX compiles anew for every length of an array.
    """
    room = 1 << int(np.ceil(np.log2(len(s))))
    return np.asarray(contour.point(np.pad(s, (0, room - len(s)), mode="edge")))[: len(s)]


def _off_chords(ends: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Distances [m] of points from the chords that they lie in the middle of: |chord x arm| / |chord|."""
    chord, arm = np.diff(ends, axis=0), middles - ends[:-1]
    return np.abs(chord[:, 0] * arm[:, 1] - chord[:, 1] * arm[:, 0]) / np.linalg.norm(chord, axis=1)


def as_points(name: str, value: Any, width: int) -> np.ndarray:
    """The value as finite numbers of shape (n, width); raises a ValueError where it is not."""
    as_array(name, value)
    array = np.asarray(value, float)
    if array.ndim != 2 or array.shape[1] != width or not np.all(np.isfinite(array)):
        raise ValueError(
            f"argument {name} must be finite numbers of shape (any, {width}), but had shape {array.shape} "
            f"and {int(np.sum(~np.isfinite(array)))} that are not finite"
        )
    return array


def without_repeats(polygon: np.ndarray, *, closed: bool) -> np.ndarray:
    """The points that differ from the one before them; of a closed polygon the first from the last."""
    before = np.roll(polygon, 1, axis=0)
    fresh = np.any(polygon != before, axis=1)
    fresh[0] |= not closed
    return polygon[fresh] if fresh.any() else polygon[:1]


def even(polygon: np.ndarray, count: int, *, closed: bool) -> np.ndarray:
    """So many points at equal distances along a polygon; a closed one's first point is not repeated."""
    around = np.concatenate([polygon, polygon[:1]]) if closed else polygon
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(around, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], count + 1)[:-1] if closed else np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(at, along, column) for column in around.T], axis=1)


def filled_places(total: float, corners: np.ndarray, count: int, *, closed: bool) -> np.ndarray:
    """Arclengths of about so many points: every corner, and evenly spaced ones from each to the next.

    Args:
        total: Length of the outline.
        corners: Arclengths of the corners, rising from zero on.
        count: About how many points.
        closed: Whether the last point is followed by the first.
    """
    if closed and len(corners):
        ends = np.append(corners, corners[0] + total)
    else:
        ends = np.unique(np.concatenate([[0.0], corners, [total]]))
    parts = [
        np.linspace(a, b, max(1, round(count * (b - a) / total)), endpoint=False)
        for a, b in zip(ends[:-1], ends[1:], strict=True)
    ]
    places = np.concatenate(parts if closed else [*parts, [total]])
    return np.sort(places % total) if closed else places


def filled_polygon(polygon: np.ndarray, count: int, *, closed: bool, sharp: float) -> np.ndarray:
    """About so many points along a polygon, with all its corners that are sharper than an angle [rad]."""
    around = np.concatenate([polygon, polygon[:1]]) if closed else polygon
    sides = np.diff(around, axis=0)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(sides, axis=1))])
    after = sides if closed else sides[1:]
    before = np.roll(sides, 1, axis=0) if closed else sides[:-1]
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], np.sum(before * after, axis=1))
    corners = np.flatnonzero(np.abs(turn) > sharp) + (0 if closed else 1)
    at = filled_places(float(along[-1]), along[corners], count, closed=closed)
    return np.stack([np.interp(at, along, column) for column in around.T], axis=1)


def chosen(outlines: list[np.ndarray], which: int, what: str) -> np.ndarray:
    """The outline with a given number, counting from the one with the largest bounding box (by its diagonal).

    Raises:
        ValueError: If there are not so many.
    """
    if not 0 <= which < len(outlines):
        raise ValueError(
            f"argument which must be below the number of {what}, {len(outlines)}, but was {which}"
        )
    sizes = [-float(np.linalg.norm(np.ptp(o, axis=0))) for o in outlines]
    return outlines[int(np.argsort(sizes, kind="stable")[which])]
