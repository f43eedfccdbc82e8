"""Order of scattered points along one curve, in NumPy.

Two methods are tried in turn. `crust` links every point to its nearest neighbour on either side, which is
right where a smooth curve is sampled finely enough; it fails, and says so, where noise blurs which side is
which. `repaired` then builds a short tour by nearest links and local improvements, as solvers of the
travelling salesman's problem do, and is refused unless the tour is the only plausible one.

Written here because a travelling salesman's solver returns a tour of any points, and does not say whether
another is as plausible. `_clean_points` calls `order_points`.
"""

from typing import NamedTuple

import numpy as np

from ._crossings import crossings

_NEAR = 24  # nearest points among which `crust` looks for a point's two neighbours on the curve
_MOVES = 200_000  # points that all moves together look at
_REPAIR = 8  # nearest points to which `repaired` may link a point


class Order(NamedTuple):
    """Indices of the points in their order along the curve, and whether the curve closes on itself."""

    indices: np.ndarray
    loop: bool


def nearest_points(points: np.ndarray, count: int) -> np.ndarray:
    """Indices (n, count) of the nearest other points, nearest first, equally near ones in any order.

    Takes O(n log n) time. The points must be distinct: then each is the nearest to itself.
    """
    from scipy.spatial import KDTree  # set-up only: imported with the first use

    # The tree squares distances: of points about one metre apart these neither overflow nor vanish.
    points = points / np.abs(points).max()
    return np.asarray(KDTree(points).query(points, k=min(count + 1, len(points)))[1])[:, 1:]


def place_text(point: np.ndarray) -> str:
    """A point as text for a sentence."""
    return f"({point[0]:.4g}, {point[1]:.4g}) m"


def turnings(points: np.ndarray, *, closed: bool) -> np.ndarray:
    """Signed turning angle [rad] at every point; zero at the ends of an open polygon."""
    steps = np.diff(points, axis=0, append=points[:1])
    before = np.roll(steps, 1, axis=0)
    cross = before[:, 0] * steps[:, 1] - before[:, 1] * steps[:, 0]
    angles = np.arctan2(cross, np.sum(before * steps, axis=1))
    if not closed:
        angles[[0, -1]] = 0.0
    return angles


def crust(points: np.ndarray, near: np.ndarray) -> Order | None:
    """The curve on which every point agrees with its two neighbours, or None if there is no such curve.

    A point picks its nearest neighbour, and the nearest one on the other side of itself (Dey and Kumar's
    NN-crust, 1999): exactly its two neighbours where a smooth curve is sampled finely enough.
    """
    first = near[:, 0]
    # A point k lies on the other side of point i than its nearest neighbour if (p_k - p_i) . (p_first - p_i)
    # is negative; `near` is sorted, so that the first such point is the nearest.
    away = points[near] - points[:, None, :]
    behind = np.einsum("nki,ni->nk", away, points[first] - points) < 0.0
    second = np.where(behind.any(axis=1), near[np.arange(len(near)), behind.argmax(axis=1)], -1)
    picks = np.stack([first, second], axis=1)
    # Only links that both points have picked are kept. A curve then has no point without a link, and two with
    # one (its ends) or none (a loop).
    mutual = (picks >= 0) & np.any(picks[picks] == np.arange(len(points))[:, None, None], axis=-1)
    degree = mutual.sum(axis=1)
    ends = np.flatnonzero(degree == 1)
    if np.any(degree == 0) or len(ends) not in (0, 2):
        return None
    links = np.where(mutual, picks, -1)
    walked = _walk(links, int(ends[0]) if len(ends) else 0)
    if len(walked) < len(points):  # the points fall into several curves
        return None
    found = Order(np.array(walked), loop=not len(ends))
    return None if zigzags(points[found.indices], closed=found.loop) else found


def _walk(links: np.ndarray, start: int) -> list[int]:
    """Indices met by following the links from one point until an end, or until the start comes again."""
    walked, previous, here = [start], -1, start
    while True:
        ahead = [int(i) for i in links[here] if i >= 0 and i != previous]
        if not ahead or ahead[0] == start:
            return walked
        previous, here = here, ahead[0]
        walked.append(here)


def zigzags(points: np.ndarray, *, closed: bool) -> bool:
    """Whether the polygon turns to and fro, by over 30 degrees, at more than a fifth of its points.

    A wrong order jumps between the two sides of a thin shape or of a noisy band, which looks like this.
    """
    angles = turnings(points, closed=closed)
    beside = np.roll(angles, -1)
    to_and_fro = (angles * beside < 0.0) & (np.minimum(np.abs(angles), np.abs(beside)) > np.pi / 6)
    return bool(np.mean(to_and_fro) > 0.2)


def crosses_as_given(points: np.ndarray, *, closed: bool) -> str:
    """Where points that look like one curve in their order cross themselves, as text; empty if not."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if len(points) < 4 or steps.max() > 10.0 * np.median(steps) or zigzags(points, closed=closed):
        return ""
    pairs = crossings(points, closed=closed)
    if not len(pairs):
        return ""
    # In the middle of all ends of the two sides that meet, to a ten-millionth of the size.
    middle = points[np.concatenate([pairs[0], pairs[0] + 1]) % len(points)].mean(axis=0)
    digits = 7 - int(np.ceil(np.log10(np.ptp(points, axis=0).max())))
    return place_text(np.round(middle, digits) + 0.0)


def order_given_up(points: np.ndarray, *, closed: bool) -> list[str]:
    """A sentence where another order was taken, because the one given crosses itself; else none."""
    place = crosses_as_given(points, closed=closed)
    if not place:
        return []
    return [
        f"The order given crosses itself near {place} and was given up: the contour joins the points by "
        "nearness, which may be another shape."
    ]


def repaired(points: np.ndarray, near: np.ndarray, *, closed: bool) -> Order:
    """A short curve through all the points: chains of the shortest links, joined, then shortened by moves.

    Raises:
        ValueError: If one of the two points nearest to some point is more than three places from it along the
            curve, or the curve zigzags: then more than one order is plausible. Also if it falls into pieces.
    """
    near = near[:, :_REPAIR]
    tour = _shortened(points, near, _fragments(points, near), closed=closed)
    if not closed:
        # The tour of an open curve passes through an additional point, index n, where it is cut open.
        cut = int(np.flatnonzero(tour == len(points))[0])
        tour = np.concatenate([tour[cut + 1 :], tour[:cut]])
    rank = np.empty(len(points), int)
    rank[tour] = np.arange(len(points))
    # How many places each point's two nearest points are from it along the curve.
    apart = np.abs(rank[:, None] - rank[near[:, :2]])
    if closed:
        apart = np.minimum(apart, len(points) - apart)
    apart = apart.max(axis=1)
    _in_one_piece(points[tour], closed=closed)
    worst = int(np.argmax(apart))
    if apart[worst] > 3 or zigzags(points[tour], closed=closed):
        raise ValueError(
            "argument points must be in order, or lie finely enough on one curve to be ordered by nearness, "
            f"but more than one order is plausible near row {worst} at {place_text(points[worst])} "
            "(ordered=True keeps the order given; `fit_contour` with smallest_radius bears noise)"
        )
    return Order(tour, loop=closed)


def _in_one_piece(points: np.ndarray, *, closed: bool) -> None:
    """Refuse ordered points with steps of more than ten times the median, which part them into pieces.

    One such step parts an open curve in two; a closed one has one piece still, with a gap in it.
    """
    steps = np.linalg.norm(np.diff(points, axis=0, append=points[:1]), axis=1)
    steps = np.sort(steps if closed else steps[:-1])
    pieces = int(np.sum(steps > 10.0 * np.median(steps))) + (0 if closed else 1)
    if pieces > 1:
        raise ValueError(
            f"argument points must lie on one curve, but fall into {pieces} pieces, with gaps of up to "
            f"{1e3 * steps[-1]:.3g} mm at a typical spacing of {1e3 * np.median(steps):.3g} mm"
        )


def _fragments(points: np.ndarray, near: np.ndarray) -> list[list[int]]:
    """Open chains of points: links are added from the shortest on (the greedy start of a tour).

    A link is left out where it would give a point a third neighbour, or close a chain to a ring.
    """
    n, count = near.shape
    pairs = np.stack([np.repeat(np.arange(n), count), near.ravel()], axis=1)
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    lengths = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    chains = {i: [i] for i in range(n)}
    chain_of = list(range(n))
    for a, b in pairs[np.argsort(lengths, kind="stable")].tolist():
        _join(chains, chain_of, a, b)
    return list(chains.values())


def _join(chains: dict[int, list[int]], chain_of: list[int], a: int, b: int) -> None:
    """Link points a and b in place, if each is at an end of a chain, and these are two chains."""
    one, other = chain_of[a], chain_of[b]
    left, right = chains[one], chains[other]
    if one == other or a not in (left[0], left[-1]) or b not in (right[0], right[-1]):
        return
    left = left if left[-1] == a else left[::-1]
    right = right if right[0] == b else right[::-1]
    chains[one] = left + right
    for i in right:
        chain_of[i] = one
    del chains[other]


def _shortened(points: np.ndarray, near: np.ndarray, chains: list[list[int]], *, closed: bool) -> np.ndarray:
    """One closed tour of all chains, made shorter by reversals and by moving single points.

    The tour of an open curve is closed through an additional point, index n, whose distance from every other
    is zero: the shortest tour through it is then the shortest open curve.
    """
    n = len(points)
    tour = max(chains, key=len)
    rest = [chain for chain in chains if chain is not tour]
    while rest:
        # Attach the chain that has an end nearest to an end of the tour, turned so that these two ends meet.
        # `far`: chain, end of the tour (0 first, 1 last), end of the chain.
        ends = points[[[c[0], c[-1]] for c in rest]]
        far = np.linalg.norm(ends[:, None] - points[[tour[0], tour[-1]]][None, :, None], axis=-1)
        which, mine, its = np.unravel_index(np.argmin(far), far.shape)
        chain = rest.pop(int(which))
        chain = chain[::-1] if its == mine else chain
        tour = chain + tour if mine == 0 else tour + chain
    tour = np.array(tour if closed else [*tour, n])
    # Point n has no coordinates: distances from it come out as NaN, and are set to zero.
    x, y = np.concatenate([points, np.full((1, 2), np.nan)]).T

    def far_apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.nan_to_num(np.hypot(x[a] - x[b], y[a] - y[b]), nan=0.0)

    # Every move shortens the tour, so that this ends by itself; the bound keeps the time at O(n): what needs
    # more moves has no single order, which `repaired` will say.
    for _ in range(min(4 * n, max(_MOVES // n, 20))):
        better = _best_move(tour, near, far_apart)
        if better is None:
            break
        tour = better
    return tour


def _best_move(tour: np.ndarray, near: np.ndarray, far_apart) -> np.ndarray | None:
    """The tour after the one reversal or move of a point that shortens it most, or None if none does.

    For a point a and one of its near points b, with a+ and b+ the points that follow them and a- the one
    before: a reversal ("2-opt") replaces the links a a+ and b b+ by a b and a+ b+, a move puts a between b
    and b+. `flip` and `put` are the changes of the tour's length [m].
    """
    rank = np.empty(len(tour), int)
    rank[tour] = np.arange(len(tour))
    after, before = np.empty_like(tour), np.empty_like(tour)
    after[tour], before[tour] = np.roll(tour, -1), np.roll(tour, 1)
    one = np.arange(len(near))[:, None]
    to, ahead = far_apart(one, near), far_apart(one, after[one])
    flip = to + far_apart(after[one], after[near]) - ahead - far_apart(near, after[near])
    put = to + far_apart(one, after[near]) - far_apart(near, after[near])
    put = put + far_apart(before[one], after[one]) - far_apart(before[one], one) - ahead
    # Where b+ is a itself nothing would move, and the sum is wrong. To swap a with the next point, b = a+, is
    # left to the reversals.
    put = np.where((after[near] == one) | (near == after[one]), np.inf, put)
    # A gain within rounding is none: it could be lost by the next move, without an end.
    slack = -1e-12 * float(np.max(to))
    if min(flip.min(), put.min()) >= slack:
        return None
    if flip.min() <= put.min():
        a, k = np.unravel_index(np.argmin(flip), flip.shape)
        low, high = sorted((rank[a], rank[near[a, k]]))
        return np.concatenate([tour[: low + 1], tour[low + 1 : high + 1][::-1], tour[high + 1 :]])
    a, k = np.unravel_index(np.argmin(put), put.shape)
    thinned = tour[tour != a]
    there = int(np.flatnonzero(thinned == near[a, k])[0])
    return np.insert(thinned, there + 1, a)


def ordered_already(points: np.ndarray, near: np.ndarray, *, closed: bool) -> bool:
    """Whether the order given is plausible: points close together come close together, without jumps.

    For 95 % of the points the nearest other point comes within a twentieth of the whole, and no step is
    longer than ten times the median.
    """
    n = len(points)
    apart = np.abs(np.arange(n) - near[:, 0])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if closed:
        apart = np.minimum(apart, n - apart)
    return bool(np.mean(apart <= max(2, n // 20)) >= 0.95 and steps.max() <= 10.0 * np.median(steps))


def _length(points: np.ndarray, *, closed: bool) -> float:
    """Length [m] of a polygon."""
    steps = np.diff(points, axis=0, append=points[:1]) if closed else np.diff(points, axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def order_points(points: np.ndarray, *, closed: bool, ordered: bool | None) -> np.ndarray | None:
    """Indices that put distinct points in order along one curve, or None where they are in order.

    Args:
        points: Shape (n, 2), distinct.
        closed: Whether the curve is to close on itself.
        ordered: True to believe the given order, False to find one, None to find out which.

    Raises:
        ValueError: If the points are not in order and no order is the only plausible one.
    """
    if ordered:
        return None
    near = nearest_points(points, _NEAR)
    found = crust(points, near)
    if found is None:
        # Noise hides the order from nearness; the given one is then kept if nothing speaks against it.
        if ordered is None and ordered_already(points, near, closed=closed):
            return None
        found = repaired(points, near, closed=closed)
    indices = _started(points, found, closed=closed)
    # Even where an order is found, the given one stays unless it makes a curve that is a fifth longer: it may
    # differ at a few points by their noise.
    given, best = _length(points, closed=closed), _length(points[indices], closed=closed)
    return None if ordered is None and given <= 1.2 * best else indices


def _started(points: np.ndarray, found: Order, *, closed: bool) -> np.ndarray:
    """Indices of a closed curve from the first point given on, or of an open curve from one end to the other.

    Raises:
        ValueError: If an open curve is wanted, but the points go all round and leave no gap to be its ends.
    """
    indices = found.indices
    if closed and found.loop:
        return np.roll(indices, -int(np.flatnonzero(indices == 0)[0]))
    if found.loop:
        # Open it at its longest step, which must stand out.
        along = points[indices]
        steps = np.linalg.norm(np.diff(along, axis=0, append=along[:1]), axis=1)
        longest = int(np.argmax(steps))
        if steps[longest] < 2.5 * np.median(steps):
            raise ValueError(
                "argument closed must be True for points that go all round, or the points must be in order, "
                f"but the largest gap is {1e3 * steps[longest]:.3g} mm, no more than the others"
            )
        indices = np.roll(indices, -longest - 1)
    return indices
