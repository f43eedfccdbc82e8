"""Raw points made fit for a contour, on the host: what cannot be one smooth contour is refused here."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..._results import check_flag, shown
from ..contours import numbers, polygon_area
from ._crossings import crossings
from ._ordering import order_points, place_text, turnings

UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
_FEWEST = 6  # as many as a quintic has coefficients
_SAME = 1e-9  # of the diameter: nearer points are one point


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
        ValueError: If the unit is none of "m", "mm", "um" and "in".

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
        unit: Of the numbers given: "m", "mm", "um" or "in".
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
    given = _checked(points) * metres_per(unit)
    _check_one_unit(given, closed=closed)
    kept = given[_distinct(given, closed=closed, anywhere=ordered is False)]
    _check_number(kept)
    indices = _order(kept, closed=closed, ordered=ordered)
    if indices is not None:
        kept = kept[indices]
    against, doubt = _against(kept, closed=closed, reordered=indices is not None)
    if against != (reverse and not closed):
        kept = np.roll(kept[::-1], 1, axis=0) if closed else kept[::-1]
    _check_spacing(kept, closed=closed)
    warnings = [*doubt, *_size(kept), *_spacing(kept, closed=closed), *_bends(kept, closed=closed)]
    warnings += _crossed(kept, closed=closed)
    merged = len(given) - len(kept)
    return CleanPoints(kept, merged, indices is not None, bool(closed and against), tuple(warnings))


def _checked(points: Any) -> np.ndarray:
    array = numbers("points", points, 2)
    _check_number(array)
    return array


def _check_number(points: np.ndarray) -> None:
    if len(points) < _FEWEST:
        raise ValueError(
            f"argument points must be {_FEWEST} distinct points or more, but there were {len(points)}"
        )


def _check_one_unit(points: np.ndarray, *, closed: bool) -> None:
    """Rows of different units fall into two groups of sizes; columns of different units make a needle."""
    sizes = np.sort(np.linalg.norm(points, axis=1))
    sizes = sizes[sizes > 0.0]
    ratios = sizes[1:] / sizes[:-1]
    jump = int(np.argmax(ratios)) if len(ratios) else 0
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


def _distinct(points: np.ndarray, *, closed: bool, anywhere: bool) -> np.ndarray:
    """Indices of points that do not repeat the one before, or any before."""
    size = _SAME * max(float(np.ptp(points, axis=0).max()), np.finfo(float).tiny)
    if anywhere:
        cells = np.round((points - points.min(axis=0)) / size).astype(np.int64)
        return np.sort(np.unique(cells, axis=0, return_index=True)[1])
    kept = np.flatnonzero(np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > size))
    meet = closed and len(kept) > 1 and np.linalg.norm(points[kept[-1]] - points[0]) <= size
    return kept[:-1] if meet else kept


def _order(points: np.ndarray, *, closed: bool, ordered: bool | None) -> np.ndarray | None:
    """Indices that put the points in order, and leave out those met before; None to leave all as it is."""
    if ordered:
        return None
    places = _distinct(points, closed=closed, anywhere=True)
    _check_number(points[places])
    indices = order_points(points[places], closed=closed, ordered=ordered)
    if indices is not None:
        return places[indices]
    # Points that went round more than once are kept once; one that was met again is a crossing.
    return places if len(places) <= 0.6 * len(points) and places[-1] == len(places) - 1 else None


def _against(points: np.ndarray, *, closed: bool, reordered: bool) -> tuple[bool, list[str]]:
    """Whether to turn the points round: closed ones that run clockwise, open ones of unknown direction."""
    if closed:
        return polygon_area(points) < 0.0, []
    if not reordered:
        return False, []
    return float(turnings(points, closed=False).sum()) < 0.0, [
        "The direction of these open points was not given: the body was put on the inside of their bend; "
        "reverse=True puts it on the other side."
    ]


def _steps(points: np.ndarray, *, closed: bool) -> np.ndarray:
    return np.linalg.norm(np.diff(points, axis=0, append=points[:1] if closed else points[:0]), axis=1)


def _check_spacing(points: np.ndarray, *, closed: bool) -> None:
    steps = _steps(points, closed=closed)
    typical, longest = float(np.median(steps)), int(np.argmax(steps))
    beside = np.minimum(steps, np.roll(steps, 1)) if closed else np.minimum(steps[1:], steps[:-1])
    lonely = int(np.argmax(beside))
    if beside[lonely] > 20.0 * typical:
        row = lonely if closed else lonely + 1
        raise ValueError(
            f"argument points must lie on one curve in one unit, but the point {place_text(points[row])} "
            f"lies {1e3 * beside[lonely]:.3g} mm from its neighbours, which are {1e3 * typical:.3g} mm apart"
        )
    second = float(np.partition(steps, -2)[-2])
    if closed and steps[longest] > max(5.0 * typical, 2.0 * second):
        start, end = place_text(points[longest]), place_text(points[(longest + 1) % len(points)])
        raise ValueError(
            f"argument points must go all round a closed contour, but leave a gap of "
            f"{1e3 * steps[longest]:.3g} mm from {start} to {end} at a typical spacing of "
            f"{1e3 * typical:.3g} mm (closed=False makes an open one)"
        )


def _size(points: np.ndarray) -> list[str]:
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if 1e-4 <= size <= 1.0:
        return []
    return [
        f"The points extend over {size:.3g} m, implausible for something grasped: check the argument unit."
    ]


def _spacing(points: np.ndarray, *, closed: bool) -> list[str]:
    steps = _steps(points, closed=closed)
    if steps.max() <= 5.0 * steps.min():
        return []
    return [
        f"The spacing of the points is uneven, {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} mm: where "
        "it is wide, the contour is a guess."
    ]


def _bends(points: np.ndarray, *, closed: bool) -> list[str]:
    """Refuse points that turn back; warn of corners and of noise as large as the spacing."""
    angles = turnings(points, closed=closed)
    sizes = np.abs(angles)
    if np.median(sizes) > np.pi / 5 and len(points) > 16:
        return ["The points turn to and fro from one to the next: their noise is as large as their spacing."]
    usual = _beside(sizes, closed=closed, measure=np.median)
    worst = int(np.argmax(sizes))
    if sizes[worst] > 0.8 * np.pi:
        raise ValueError(
            f"argument points must follow a smooth contour, but turn back by "
            f"{np.rad2deg(sizes[worst]):.0f} degrees (a cusp) at {place_text(points[worst])}"
        )
    pairs = np.abs(angles + np.roll(angles, -1))
    sharp = (sizes > np.pi / 6) & (sizes > 5.0 * usual)
    chamfer = (pairs > np.pi / 3) & (pairs > 5.0 * usual)
    corners = np.flatnonzero(sharp | chamfer)
    if not len(corners):
        return []
    worst = int(corners[np.argmax(sizes[corners])])
    gaps = np.diff(corners, append=corners[:1] + len(sizes))
    count = max(1, int(np.sum((gaps if closed else gaps[:-1]) > 2)) + (0 if closed else 1))
    return [
        f"The points have {count} corner{'s' if count > 1 else ''}, of up to "
        f"{np.rad2deg(sizes[worst]):.0f} degrees within one spacing near {place_text(points[worst])}: the "
        "contour rounds them off as the spacing lets it."
    ]


def _beside(values: np.ndarray, *, closed: bool, measure: Callable) -> np.ndarray:
    """A measure of the values near each one, itself and its two neighbours left out."""
    reach = [i for i in range(-5, 6) if abs(i) > 1]
    rows = np.arange(len(values))[:, None] + np.array(reach)
    rows = rows % len(values) if closed else np.clip(rows, 1, len(values) - 2)
    return measure(values[rows], axis=1)


def _crossed(points: np.ndarray, *, closed: bool) -> list[str]:
    """Refuse a polygon that crosses itself; loops no larger than a few spacings are noise."""
    pairs = crossings(points, closed=closed)
    if not len(pairs):
        return []
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
