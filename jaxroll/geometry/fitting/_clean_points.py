"""Raw points made fit for a contour, in NumPy: what cannot be one smooth contour is refused here.

In this order: units, duplicates, order (`_ordering`), direction, spacing, corners, self-crossings
(`_crossings`). What no contour can be made of raises one sentence; what is merely doubtful becomes a warning.
Thresholds are relative to the median spacing or to the turning at neighbouring points, so that they hold for
any size and any number of points. `_contour_fit` fits a contour to the result, and repeats the warnings in
its report.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._results import check_flag, shown
from ..contours import check_extent, numbers, polygon_area
from ._crossings import crossings
from ._ordering import order_given_up, order_points, place_text, turnings

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
_FEWEST = 6  # as many as a quintic has coefficients
_SAME = 1e-9  # times the larger extent: points nearer than that are one point
_AT_ORIGIN = 1e-7  # times the largest distance from the origin: points nearer than that lie at it


@dataclass(frozen=True)
class CleanPoints:
    """Points in metres, in order, without duplicates, the body on their left; and what was done to them.

    Attributes:
        points: Shape (n, 2), in metres.
        merged: How many points were dropped as duplicates.
        reordered: Whether an order had to be found.
        reversed: Whether they were turned round to run counter-clockwise.
        warnings: What is doubtful about them, in sentences.
    """

    points: np.ndarray
    merged: int
    reordered: bool
    reversed: bool
    warnings: tuple[str, ...]


def metres_per(unit: Any) -> float:
    """Metres in one unit of length.

    Raises:
        ValueError: If the unit is none of "m", "cm", "mm", "um" and "in".

    Example:
        >>> from jaxroll.geometry import metres_per
        >>> metres_per("in")
        0.0254
    """
    if not isinstance(unit, str) or unit not in UNITS:
        raise ValueError(f"argument unit must be one of {', '.join(map(repr, UNITS))}, but was {shown(unit)}")
    return UNITS[unit]


def clean_points(
    points: Any,
    *,
    closed: bool = True,
    ordered: bool | None = None,
    unit: str = "m",
    reverse: bool = False,
) -> CleanPoints:
    r"""Check points on a contour, put them in order, counter-clockwise, in metres.

    Scattered points are ordered by nearness: right where a smooth curve is sampled finely compared with its
    bends, its thickness and the noise; refused where more than one order is plausible. It takes
    $O(n \log n)$ time, and $O(n^2)$ where noise makes it try many orders.

    Args:
        points: Shape (n, 2), n >= 6, in `unit`.
        closed: Whether the contour is to close on itself. An open one has the body on its left.
        ordered: True to believe the given order, False to find one, None to find out which.
        unit: Of the numbers given: "m", "cm", "mm", "um" or "in".
        reverse: Turn an open contour round, where the points have the body on their right.

    Returns:
        `CleanPoints`; a closed contour starts at the first point given.

    Raises:
        ValueError: If the points are not finite, fewer than six, in mixed units, in no plausible order, leave
            a gap where `closed`, cross themselves, turn back on themselves, or one lies far off the others.

    Example:
        >>> import numpy as np
        >>> from jaxroll.geometry import clean_points
        >>> u = -2.0 * np.pi * np.arange(8) / 8  # clockwise
        >>> clean_points(np.stack([np.cos(u), np.sin(u)], axis=1), unit="mm").reversed
        True
    """
    check_flag("closed", closed)
    check_flag("reverse", reverse)
    if ordered is not None:
        check_flag("ordered", ordered)
    given = given_points(points, unit)
    check_one_unit(given, closed=closed)
    kept = given[distinct(given, closed=closed, anywhere=ordered is False)]
    check_number(kept)
    indices = _order(kept, closed=closed, ordered=ordered)
    given_up = []
    if indices is not None:
        given_up = order_given_up(kept, closed=closed) if ordered is None else []
        kept = kept[indices]
    against, doubt = _against(kept, closed=closed, reordered=indices is not None)
    # A closed contour's direction follows from its points; `reverse` has a meaning for open ones alone. The
    # shift by one keeps the first point of a closed contour first.
    if against != (reverse and not closed):
        kept = np.roll(kept[::-1], 1, axis=0) if closed else kept[::-1]
    check_spacing(kept, closed=closed)
    warnings = [
        *given_up,
        *doubt,
        *size_warnings(kept),
        *_spacing(kept, closed=closed),
        *_bends(kept, closed=closed),
    ]
    warnings += _crossed(kept, closed=closed)
    merged = len(given) - len(kept)
    return CleanPoints(kept, merged, indices is not None, bool(closed and against), tuple(warnings))


def given_points(points: Any, unit: Any) -> np.ndarray:
    """The points in metres, shape (n, 2): finite, at least six, and as far apart as shapes may be long."""
    array = numbers("points", points, 2)
    check_number(array)
    array = array * metres_per(unit)
    check_extent("points", array)
    return array


def check_number(points: np.ndarray) -> None:
    if len(points) < _FEWEST:
        raise ValueError(
            f"argument points must be {_FEWEST} distinct points or more, but there were {len(points)}"
        )


def check_one_unit(points: np.ndarray, *, closed: bool) -> None:
    """Refuse points in mixed units.

    Rows in different units fall into two groups by their distance from the origin, with a factor of 100 or
    more between the groups; columns in different units make a closed contour a hundred times longer than
    wide.
    """
    sizes = np.sort(np.linalg.norm(points, axis=1))
    # Points at the origin, to rounding, are none of another unit, however often one is there.
    sizes = sizes[sizes > _AT_ORIGIN * sizes[-1]]
    ratios = sizes[1:] / sizes[:-1]
    jump = int(np.argmax(ratios)) if len(ratios) else 0
    # A single point near the origin is no group: any contour may pass close by it.
    if len(ratios) and jump >= 1 and ratios[jump] >= 100.0:
        raise ValueError(
            f"argument points must be in one unit, but {jump + 1} lie within {sizes[jump]:.3g} m of the "
            f"origin and {len(sizes) - jump - 1} beyond {sizes[jump + 1]:.3g} m"
        )
    width, height = np.ptp(points, axis=0)
    if closed and max(width, height) > 100.0 * min(width, height):
        raise ValueError(
            "argument points must have both columns in one unit and enclose an area, but extend over "
            f"{width:.3g} m by {height:.3g} m"
        )


def distinct(points: np.ndarray, *, closed: bool, anywhere: bool) -> np.ndarray:
    """Indices of the points that do not repeat the point before them or, with `anywhere`, any before them.

    Within a given order only neighbours are duplicates: a second pass through the same point is a crossing.
    Where an order is to be found, points are compared by their cell in a grid, which takes O(n log n) time.
    """
    size = _SAME * max(float(np.ptp(points, axis=0).max()), np.finfo(float).tiny)
    if anywhere:
        cells = np.round((points - points.min(axis=0)) / size).astype(np.int64)
        return np.sort(np.unique(cells, axis=0, return_index=True)[1])
    kept = np.flatnonzero(np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > size))
    # A closed outline often repeats its first point at the end.
    meet = closed and len(kept) > 1 and np.linalg.norm(points[kept[-1]] - points[0]) <= size
    return kept[:-1] if meet else kept


def _order(points: np.ndarray, *, closed: bool, ordered: bool | None) -> np.ndarray | None:
    """Indices that put the points in order without repetitions; None to keep them as they are."""
    if ordered:
        return None
    places = distinct(points, closed=closed, anywhere=True)
    check_number(points[places])
    indices = order_points(points[places], closed=closed, ordered=ordered)
    if indices is not None:
        return places[indices]
    # The given order is plausible. If the distinct points are the first ones, and the many others repeat
    # them, the points go round more than once, and the first round is kept. A few repetitions stay: they are
    # crossings, which `_crossed` judges.
    return places if len(places) <= 0.6 * len(points) and places[-1] == len(places) - 1 else None


def _against(points: np.ndarray, *, closed: bool, reordered: bool) -> tuple[bool, list[str]]:
    """Whether the points run against the convention of a body on the left, and what is doubtful about that.

    A closed contour runs clockwise if its area is negative. The direction of an open one is the caller's; if
    its order was found here it has none, and it is turned to bend to the left as a whole, which puts the body
    on the inside of the bend.
    """
    if closed:
        return polygon_area(points) < 0.0, []
    if not reordered:
        return False, []
    return float(turnings(points, closed=False).sum()) < 0.0, [
        "The direction of these open points was not given: the body was put on the inside of their bend; "
        "reverse=True puts it on the other side."
    ]


def _steps(points: np.ndarray, *, closed: bool) -> np.ndarray:
    """Distances [m] of each point from the next; of a closed polygon also of the last from the first."""
    return np.linalg.norm(np.diff(points, axis=0, append=points[:1] if closed else points[:0]), axis=1)


def check_spacing(points: np.ndarray, *, closed: bool) -> None:
    """Refuse a point far off all others, and a closed contour with a gap in it."""
    steps = _steps(points, closed=closed)
    typical, longest = float(np.median(steps)), int(np.argmax(steps))
    # Distance of every point from the nearer of its two neighbours: large for a stray point alone, while a
    # gap makes only one of the two distances large.
    beside = np.minimum(steps, np.roll(steps, 1)) if closed else np.minimum(steps[1:], steps[:-1])
    lonely = int(np.argmax(beside))
    if beside[lonely] > 20.0 * typical:
        row = lonely if closed else lonely + 1
        raise ValueError(
            f"argument points must lie on one curve in one unit, but the point {place_text(points[row])} "
            f"lies {1e3 * beside[lonely]:.3g} mm from its neighbours, which are {1e3 * typical:.3g} mm apart"
        )
    # One gap is longer than all others: several long steps are a coarse sampling of straight sides.
    second = float(np.partition(steps, -2)[-2])
    if closed and steps[longest] > max(5.0 * typical, 2.0 * second):
        start, end = place_text(points[longest]), place_text(points[(longest + 1) % len(points)])
        raise ValueError(
            f"argument points must go all round a closed contour, but leave a gap of "
            f"{1e3 * steps[longest]:.3g} mm from {start} to {end} at a typical spacing of "
            f"{1e3 * typical:.3g} mm (closed=False makes an open one)"
        )


def size_warnings(points: np.ndarray) -> list[str]:
    """Warn of a size beyond 0.1 mm to 1 m, which suggests a wrong unit."""
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if 1e-4 <= size <= 1.0:
        return []
    return [
        f"The points extend over {size:.3g} m, implausible for something grasped: check the argument unit."
    ]


def _spacing(points: np.ndarray, *, closed: bool) -> list[str]:
    """Warn of steps of which the longest is more than five times the shortest."""
    steps = _steps(points, closed=closed)
    if steps.max() <= 5.0 * steps.min():
        return []
    return [
        f"The spacing of the points is uneven, {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} mm: where "
        "it is wide, the contour is a guess."
    ]


def _bends(points: np.ndarray, *, closed: bool) -> list[str]:
    """Refuse points that turn back; warn of corners and of noise as large as the spacing.

    The turning at a point of a smooth curve is its curvature times the spacing. A corner turns by its angle
    however fine the spacing is, and so stands out from the turning at the points around it.
    """
    angles = turnings(points, closed=closed)
    sizes = np.abs(angles)
    # A closed polygon of n points turns by 360 degrees / n in the mean: with more than 16 points a median
    # above 36 degrees is noise, not shape.
    if np.median(sizes) > np.pi / 5 and len(points) > 16:
        return ["The points turn to and fro from one to the next: their noise is as large as their spacing."]
    usual = _beside(sizes, closed=closed, measure=np.median)
    worst = int(np.argmax(sizes))
    if sizes[worst] > 0.8 * np.pi:
        raise ValueError(
            f"argument points must follow a smooth contour, but turn back by "
            f"{np.rad2deg(sizes[worst]):.0f} degrees (a cusp) at {place_text(points[worst])}"
        )
    # A sharp corner lies in one point; of a corner that was cut off between two points each has a part.
    pairs = np.abs(angles + np.roll(angles, -1))
    sharp = (sizes > np.pi / 6) & (sizes > 5.0 * usual)
    chamfer = (pairs > np.pi / 3) & (pairs > 5.0 * usual)
    corners = np.flatnonzero(sharp | chamfer)
    if not len(corners):
        return []
    worst = int(corners[np.argmax(sizes[corners])])
    # Flagged points next to each other, or with one point between them, belong to the same corner.
    gaps = np.diff(corners, append=corners[:1] + len(sizes))
    count = max(1, int(np.sum((gaps if closed else gaps[:-1]) > 2)) + (0 if closed else 1))
    return [
        f"The points have {count} corner{'s' if count > 1 else ''}, of up to "
        f"{np.rad2deg(sizes[worst]):.0f} degrees within one spacing near {place_text(points[worst])}: the "
        "contour rounds them off as the spacing lets it."
    ]


def _beside(values: np.ndarray, *, closed: bool, measure: Callable) -> np.ndarray:
    """A measure of the eight values around each one, its own and those of its two neighbours left out.

    They are left out because a corner may extend over them.
    """
    reach = [i for i in range(-5, 6) if abs(i) > 1]
    rows = np.arange(len(values))[:, None] + np.array(reach)
    rows = rows % len(values) if closed else np.clip(rows, 1, len(values) - 2)
    return measure(values[rows], axis=1)


def _crossed(points: np.ndarray, *, closed: bool) -> list[str]:
    """Refuse a polygon that crosses itself; warn if all its loops are small, as noise makes them."""
    pairs = crossings(points, closed=closed)
    if not len(pairs):
        return []
    # Number of sides in the loop that a crossing cuts off.
    apart = pairs[:, 1] - pairs[:, 0]
    if closed:
        apart = np.minimum(apart, len(points) - apart)
    worst = int(np.argmax(apart))
    if apart[worst] > max(3, len(points) // 40):
        first, second = pairs[worst]
        raise ValueError(
            "argument points must not cross themselves, but the side that begins at "
            f"{place_text(points[first])} meets the one that begins at {place_text(points[second])}"
        )
    return [
        f"The points cross themselves in {len(pairs)} small loops: their noise is as large as their spacing."
    ]
