"""The line along a band of noisy points, and their order along it, at a scale above the noise.

Points that scatter by more than their spacing have no order by nearness. Their means over cells of a wider
scale have: of many points each, a scale apart, with a noise that is a small part of it. A `chain` is the
polygon of such means. Where the given order is to be kept, the cells are stretches of it; where it is not,
they are places in the plane, ordered by `crust`. Then every point is projected onto the chain.

Everything takes O(n log n) time. `_limited_fit` calls `found_band`, with a scale from the smallest radius
that the caller asks for.
"""

from typing import NamedTuple

import numpy as np

from ._crossings import crossings
from ._ordering import crosses_as_given, crust, nearest_points, place_text, zigzags

_WIDER = 1.4  # factor from one scale that is tried to the next
_THIN = 0.2  # most of the rms distance from the chain, in scales: a filled area has 0.29
_TRIES = 7  # scales at which the given order is looked at
_FEWEST = 8  # fewest means in a chain
_WIDEST = 0.125  # widest scale that is tried, as a share of the larger extent
_DENSE = 8  # nearest points whose distance tells how dense the points are somewhere
_LOOSE = 3.0  # times the median of that distance beyond which a point may be a stray
_NEAR = 24  # means among which the neighbours of a mean are sought
_FEW = 0.1  # share of the median number of points in a cell below which its points may be strays
_STRAYS = 0.1  # largest share of all points that may be strays


class Band(NamedTuple):
    """What was found of the points.

    Attributes:
        chain: Shape (m, 2), means in their order along the curve [m].
        indices: The points in their order along the chain, without strays.
        strays: Indices of points that belong to no part of the chain.
        reordered: Whether the order given was not kept.
    """

    chain: np.ndarray
    indices: np.ndarray
    strays: np.ndarray
    reordered: bool


def found_band(points: np.ndarray, scale: float, *, closed: bool, ordered: bool | None) -> Band:
    """The chain of distinct points, by their given order or by nearness, at `scale` [m] or a wider one.

    Args:
        points: Shape (n, 2), distinct.
        scale: Smallest distance of the means [m].
        closed: Whether the curve is to close on itself.
        ordered: True to believe the given order, False to find one, None to find out which.

    Raises:
        ValueError: If neither the order given nor any by nearness is plausible.
    """
    if ordered is not False:
        kept, strays = _without_detours(points, scale, closed=closed)
        # What noise makes look like no order at one scale may be one at the next.
        for wider in scale * _WIDER ** np.arange(_TRIES):
            chain = _strung(points[kept], wider, closed=closed)
            if _plausible(chain, closed=closed):
                return Band(chain, kept, strays, reordered=False)
        if ordered:
            chain = _strung(points[kept], scale, closed=closed)
            _check_uncrossed(chain, closed=closed)
            return Band(chain, kept, strays, reordered=False)
    near = nearest_points(points, _NEAR)
    exact = crust(points, near)
    if exact is not None and exact.loop == closed:
        chain = _strung(points[exact.indices], scale, closed=closed)
        if not len(crossings(chain, closed=closed)):
            return Band(chain, exact.indices, np.zeros(0, int), reordered=True)
    apart = np.linalg.norm(points[near[:, min(_DENSE, near.shape[1]) - 1]] - points, axis=1)
    loose = apart > _LOOSE * float(np.median(apart))
    # Cells narrower than the distance to the fourth nearest point hold too few points for a mean.
    fourth = np.linalg.norm(points[near[:, min(4, near.shape[1]) - 1]] - points, axis=1)
    scale, widest = max(scale, float(np.median(fourth))), _WIDEST * float(np.ptp(points, axis=0).max())
    while scale < widest:
        for keep in (np.ones(len(points), bool), ~loose) if loose.any() else (np.ones(len(points), bool),):
            band = _by_nearness(points, keep, scale, closed=closed)
            if band is not None:
                return band
        scale *= _WIDER
    worst = int(np.argmax(fourth))
    place = crosses_as_given(points, closed=closed) if ordered is None else ""
    if place:
        raise ValueError(
            f"argument points must not cross themselves, but in the order given they do near {place}, and by "
            "nearness they follow no single curve"
        )
    raise ValueError(
        "argument points must be in order, or lie near one curve, "
        f"{'closed' if closed else 'with two ends'}, but at no scale up to {1e3 * widest:.3g} mm do they "
        f"follow a single one; the loneliest is row {worst} at {place_text(points[worst])}"
    )


def _check_uncrossed(chain: np.ndarray, *, closed: bool) -> None:
    """Refuse an order that leads across itself."""
    pairs = crossings(chain, closed=closed)
    if len(pairs):
        first, second = (place_text(chain[i]) for i in pairs[0])
        raise ValueError(
            f"argument points must not cross themselves in the order given, but the curve near {first} meets "
            f"itself near {second}"
        )


def _without_detours(points: np.ndarray, scale: float, *, closed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the points in the order given, and of those to which the way is a detour.

    The detour by a few points is how much longer the way past them is than the way without them. A stray
    makes one of twice its distance, noise one of a few standard deviations. The way without them must be
    short, or they are a corner between long sides.
    """
    kept = np.arange(len(points))
    for count in (1, 2, 3):
        here = points[kept]
        if len(here) < 4 * count + 6:
            break
        steps = np.linalg.norm(np.diff(here, axis=0, append=here[:1]), axis=1)
        along = sum(np.roll(steps, -k) for k in range(count + 1))
        straight = np.linalg.norm(np.roll(here, -count - 1, axis=0) - here, axis=1)
        detour = along - straight
        if not closed:
            detour[-count - 1 :] = 0.0
        usual = float(np.median(detour)) + float(np.median(steps))
        short = straight < 3.0 * (count + 1) * float(np.median(steps)) + scale
        far = np.flatnonzero(short & (detour > max(6.0 * (count + 1) * usual, 2.0 * scale)))
        # Of overlapping detours only the longest counts: its points are left out.
        drop: set[int] = set()
        for i in far[np.argsort(-detour[far], kind="stable")].tolist():
            away = {(i + k) % len(here) for k in range(1, count + 1)}
            beside = {(i + k) % len(here) for k in range(count + 2)}
            if not drop & beside:
                drop |= away
        kept = np.delete(kept, sorted(drop))
    strays = np.setdiff1d(np.arange(len(points)), kept)
    # What leaves out a good part of the points is no search for strays.
    if len(strays) > _STRAYS * len(points):
        return np.arange(len(points)), np.zeros(0, int)
    return kept, strays


def _strung(points: np.ndarray, scale: float, *, closed: bool) -> np.ndarray:
    """Means of stretches of points in order; a point over a scale from a stretch's start begins the next."""
    groups, start, group = [], points[0], 0
    for point in points:
        if np.hypot(*(point - start)) > scale:
            group, start = group + 1, point
        groups.append(group)
    labels = np.array(groups)
    if closed and group > 1 and np.hypot(*(points[-1] - points[0])) < scale:
        # The last stretch was cut short by the first one.
        labels[labels == group] = 0 if np.sum(labels == group) < np.sum(labels == 0) else group
    return _means(points, labels, int(labels.max()) + 1)


def _means(points: np.ndarray, labels: np.ndarray, count: int) -> np.ndarray:
    """Means of the points by their labels, empty ones left out."""
    number = np.bincount(labels, minlength=count)
    sums = np.stack([np.bincount(labels, weights=x, minlength=count) for x in points.T], axis=1)
    return sums[number > 0] / number[number > 0, None]


def _plausible(chain: np.ndarray, *, closed: bool) -> bool:
    """Whether a chain of points in the order given looks like one curve."""
    if len(chain) < _FEWEST:
        return len(chain) >= 3 and not len(crossings(chain, closed=closed))
    steps = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    jumps = steps.max() > 10.0 * np.median(steps) and steps.max() > 0.2 * np.ptp(chain, axis=0).max()
    return not jumps and not zigzags(chain, closed=closed) and not len(crossings(chain, closed=closed))


def _by_nearness(points: np.ndarray, keep: np.ndarray, scale: float, *, closed: bool) -> Band | None:
    """The band of the points to keep at one scale, or None; of cells with few points these are strays too."""
    if not keep.all():
        labels = _cells(points[keep], scale)
        number = np.bincount(labels)
        keep = keep.copy()
        keep[np.flatnonzero(keep)[number[labels] <= _FEW * np.median(number)]] = False
    if np.sum(~keep) > _STRAYS * len(points):
        return None
    inside = points[keep]
    labels = _cells(inside, scale)
    means = _means(inside, labels, int(labels.max()) + 1)
    if len(means) < _FEWEST:
        return None
    found = crust(means, nearest_points(means, _NEAR))
    if found is None or (closed and not found.loop and not _closes(means[found.indices])):
        return None
    chain = means[found.indices]
    if found.loop and not closed:
        steps = np.linalg.norm(np.diff(chain, axis=0, append=chain[:1]), axis=1)
        if steps.max() < 2.5 * np.median(steps):
            return None
        chain = np.roll(chain, -int(np.argmax(steps)) - 1, axis=0)
    along, off = _projected(inside, chain, closed=closed)
    if len(crossings(chain, closed=closed)) or np.sqrt(np.mean(off**2)) > _THIN * scale:
        return None
    return Band(chain, np.flatnonzero(keep)[np.argsort(along, kind="stable")], np.flatnonzero(~keep), True)


def _closes(chain: np.ndarray) -> bool:
    """Whether the ends of an open chain are as near each other as its other neighbours may be."""
    steps = np.linalg.norm(np.diff(chain, axis=0), axis=1)
    return bool(np.linalg.norm(chain[0] - chain[-1]) <= 2.0 * steps.max())


def _cells(points: np.ndarray, scale: float) -> np.ndarray:
    """Labels of cells about a scale wide: from seeds a scale apart, moved to the means of their points."""
    from scipy.spatial import KDTree  # set-up only: imported with the first use

    tree, fresh, seeds = KDTree(points), np.ones(len(points), bool), []
    for i in range(len(points)):
        if fresh[i]:
            seeds.append(i)
            fresh[tree.query_ball_point(points[i], scale)] = False
    middles = points[seeds]
    for _ in range(2):
        labels = np.asarray(KDTree(middles).query(points)[1])
        middles = _means(points, labels, len(middles))
    return np.asarray(KDTree(middles).query(points)[1])


def _projected(points: np.ndarray, chain: np.ndarray, *, closed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Places of points along a chain and distances from it [m], to a sixteenth of a step."""
    from scipy.spatial import KDTree

    ring = np.concatenate([chain, chain[:1]]) if closed else chain
    at = np.linspace(0.0, len(ring) - 1.0, 16 * (len(ring) - 1) + 1)
    fine = np.stack([np.interp(at, np.arange(len(ring)), x) for x in ring.T], axis=1)
    off, index = KDTree(fine).query(points)
    return np.asarray(index, float), np.asarray(off)
