r"""What a disc can touch: data of the plane moved to where discs roll inside and outside. NumPy, SciPy.

As in space (`_rolling`): the union of all discs of radius r inside a body is its opening, which rounds
corners and cuts off thin ends; rolled outside, the closing fills notches. A curve of bounded curvature that
is fitted to points in a sharp corner bulges out beside the corner, since points far off it count little;
fitted to points that were moved onto the discs it does not. `_limited_fit` fits those, and reports distances
from the points themselves. What is thin between two thick parts is left alone: its sides may be straight.
"""

import numpy as np

from ._rolling import centres

_SLACK, _SIGMAS = 0.02, 4.0  # how far points may be off a disc that is rolled: in radii, in noises
_ACROSS = 0.125  # half the length over which the line's direction is taken, in radii
# A stretch is moved where it leaves the discs by more than this, in radii, as corners of less than 77 degrees
# do, and is longer than its chord by this factor. Wider corners a bounded curvature rounds by itself.
_FAR, _LONGER = 0.6, 1.3
_MOST = 0.3  # largest share of the line that may be moved by more than a radius


def rolled_line(
    points: np.ndarray, line: np.ndarray, radius: float, noise: float, *, closed: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Points and line moved to where discs roll, at sharp corners, thin ends and narrow notches.

    They remain as they are where no disc fits, or most of the line would be moved.

    Args:
        points: Shape (n, 2) [m].
        line: Shape (m, 2), close places along the curve, the body on its left; of a closed one the first
            place once more at the end.
        radius: Of the discs [m].
        noise: Standard deviation of the points [m].
        closed: Whether the line closes on itself.
    """
    from scipy.spatial import KDTree  # set-up only: imported with the first use

    slack = max(_SLACK * radius, _SIGMAS * noise)
    after, moved = line, points
    for side in (radius, -radius) if slack < 0.5 * radius else ():
        moved, after = _rolled_on(moved, after, side, slack, closed=closed)
    away = KDTree(after).query(line)[0]
    return (points, line) if np.mean(away > radius) > _MOST else (moved, after)


def along(line: np.ndarray) -> np.ndarray:
    """Lengths along a polygon to its corners [m]."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))


def spread_along(line: np.ndarray, count: int) -> np.ndarray:
    """So many places evenly along a polygon, from end to end."""
    lengths = along(line)
    at = np.linspace(0.0, float(lengths[-1]), count)
    return np.stack([np.interp(at, lengths, x) for x in line.T], axis=1)


def _rolled_on(
    points: np.ndarray, line: np.ndarray, side: float, slack: float, *, closed: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Points and line with discs rolled on the left of the line, or on its right: there `side` is -radius."""
    from scipy.spatial import KDTree

    radius, line = abs(side), spread_along(line, len(line))
    places = line[:-1] if closed else line
    middles = places + side * _normals(places, radius, closed=closed)
    fits = centres(places, middles, radius - slack)
    if not fits.any():
        return points, line
    near, after, found = KDTree(places).query(points)[1], places.copy(), points.copy()
    off = np.any(_drawn(places, middles[fits], radius, slack) != places, axis=1)
    beside = int(np.ceil(2.0 * radius / max(float(along(line)[1]), np.finfo(float).tiny)))
    for here in _stretches(off, closed=closed):
        # Discs that touch beside the stretch: others may be nearer, beyond something thin.
        ends = np.concatenate([here[0] - np.arange(1, beside + 1), here[-1] + np.arange(1, beside + 1)])
        ends = np.unique(ends % len(places) if closed else np.clip(ends, 0, len(places) - 1))
        ends = ends[fits[ends]]
        if not len(ends):
            continue
        moved = _drawn(places[here], middles[ends], radius, slack)
        far = np.linalg.norm(moved - places[here], axis=1).max() > _FAR * radius
        chord = float(np.linalg.norm(places[here[-1]] - places[here[0]]))
        if far and along(places[here])[-1] > _LONGER * chord:
            after[here] = moved
            own = np.isin(near, here)
            found[own] = _drawn(points[own], middles[ends], radius, slack)
    return found, np.concatenate([after, after[:1]]) if closed else after


def _stretches(off: np.ndarray, *, closed: bool) -> list[np.ndarray]:
    """Numbers of neighbouring places that are off, stretch by stretch; a closed line has no first place."""
    if off.all() or not off.any():
        return []
    shift = int(np.argmin(off)) if closed else 0
    order = (np.arange(len(off)) + shift) % len(off)
    turns = np.flatnonzero(np.diff(np.concatenate([[0], off[order].astype(int), [0]])))
    return [order[begin:end] for begin, end in turns.reshape(-1, 2)]


def _normals(places: np.ndarray, radius: float, *, closed: bool) -> np.ndarray:
    """Unit normals to the left of a line, of chords a quarter of a radius long."""
    step = float(np.median(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    k = int(np.clip(np.ceil(_ACROSS * radius / max(step, np.finfo(float).tiny)), 1, (len(places) - 1) // 2))
    number = np.arange(len(places))
    if closed:
        chords = places[(number + k) % len(places)] - places[(number - k) % len(places)]
    else:
        chords = places[np.minimum(number + k, len(places) - 1)] - places[np.maximum(number - k, 0)]
    lengths = np.maximum(np.linalg.norm(chords, axis=1, keepdims=True), np.finfo(float).tiny)
    return np.stack([-chords[:, 1], chords[:, 0]], axis=1) / lengths


def _drawn(points: np.ndarray, middles: np.ndarray, radius: float, slack: float) -> np.ndarray:
    """Points moved onto the disc with the nearest middle; nearly there they are not moved."""
    from scipy.spatial import KDTree

    distances, near = KDTree(middles).query(points)
    arms = (points - middles[near]) / np.maximum(distances, np.finfo(float).tiny)[:, None]
    off = distances > radius + slack
    return np.where(off[:, None], middles[near] + radius * arms, points)
