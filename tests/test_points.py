"""Raw points: put in order, turned round, or refused in one sentence."""

import contextlib
from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxroll.geometry import clean_points, crossings
from jaxroll.geometry.fitting._clean_points import check_spacing, distinct
from jaxroll.geometry.fitting._limited_fit import limited, Wanted
from jaxroll.geometry.fitting._ordering import (
    _best_move,
    nearest_points,
    order_given_up,
    ordered_already,
    repaired,
)

N = 200
U = 2 * np.pi * np.arange(N) / N
RING = 0.03 * np.stack([np.cos(U), np.sin(U)], axis=1)


def star(n, lobes=5, depth=0.3, noise=0.0, seed=0):
    """A non-convex ring; noise in units of the mean spacing."""
    u = 2 * np.pi * np.arange(n) / n
    points = (0.03 * (1.0 + depth * np.cos(lobes * u)))[:, None] * np.stack([np.cos(u), np.sin(u)], axis=1)
    spacing = np.linalg.norm(np.diff(points, axis=0), axis=1).mean()
    return points + noise * spacing * np.random.default_rng(seed).normal(size=points.shape)


def hook(n):
    """A thick open C whose ends come near each other."""
    u = np.linspace(0.25, 2 * np.pi - 0.25, n)
    return 0.02 * np.stack([np.cos(u), np.sin(u)], axis=1)


def same_ring(found, wanted):
    """Whether two rings hold the same points in the same cyclic order."""
    start = int(np.argmin(np.linalg.norm(wanted - found[0], axis=1)))
    np.testing.assert_allclose(found, np.roll(wanted, -start, axis=0), atol=1e-15)
    return True


@pytest.mark.parametrize("lobes", [1, 3, 5, 8])
@pytest.mark.parametrize("seed", [0, 1])
def test_scattered_points_of_a_smooth_ring_are_put_in_their_order(lobes, seed):
    ring = star(300, lobes)
    mixed = np.random.default_rng(seed).permutation(ring)
    clean = clean_points(mixed)
    assert clean.reordered and same_ring(clean.points, ring)
    np.testing.assert_array_equal(clean.points[0], mixed[0])


def test_scattered_points_of_an_open_curve_are_put_in_their_order():
    curve = hook(120)
    clean = clean_points(np.random.default_rng(2).permutation(curve), closed=False)
    np.testing.assert_allclose(clean.points, curve, atol=1e-15)
    assert clean.reordered and "direction of these open points" in " ".join(clean.warnings)
    turned = clean_points(np.random.default_rng(2).permutation(curve), closed=False, reverse=True)
    np.testing.assert_allclose(turned.points, curve[::-1], atol=1e-15)


def test_scattered_noisy_points_swap_neighbours_at_most():
    """Noise of 0.2 spacings, too much for two agreeing neighbours everywhere: the repair finds the order."""
    n = 1000
    mixed = np.random.default_rng(3).permutation(n)
    ring = star(n, noise=0.2)
    clean = clean_points(ring[mixed])
    rank = np.argmin(np.linalg.norm(clean.points[:, None] - ring[None], axis=-1), axis=1)
    steps = np.diff(rank, append=rank[:1]) % n
    assert np.all(np.minimum(steps, n - steps) <= 3) and np.mean(steps == 1) > 0.97


@pytest.mark.parametrize("turned", [False, True])
def test_a_piece_across_a_gap_is_joined_by_its_nearer_end(turned):
    """A line ends 9.0 mm from one end of an arc and 9.2 mm from the other, its points 1 mm apart."""
    line = np.stack([np.arange(-40.0, 1.0), np.zeros(41)], axis=1)
    first, last = np.array([6.0, 6.7]), np.array([-4.0, -8.3])
    centre, radius = 0.5 * (first + last), 0.5 * np.linalg.norm(first - last)
    angle = np.arctan2(*(first - centre)[::-1]) - np.linspace(0.0, np.pi, 29)
    arc = centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    curve = 1e-3 * np.concatenate([line, arc])
    curve = curve[:, ::-1] if turned else curve
    for seed in range(6):  # in each of them the pieces are found in other directions
        mixed = np.random.default_rng(seed).permutation(curve)
        found = mixed[repaired(mixed, nearest_points(mixed, 24), closed=False).indices]
        np.testing.assert_array_equal(found if np.all(found[0] == curve[0]) else found[::-1], curve)


def test_points_in_order_stay_as_they_are_even_where_noise_hides_it():
    for noise in (0.0, 0.5, 2.0):
        ring = star(400, noise=noise)
        clean = clean_points(ring)
        np.testing.assert_array_equal(clean.points, ring)
        assert not clean.reordered and bool(clean.warnings) == (noise > 0.0)
        assert noise < 1.0 or "noise is as large as their spacing" in " ".join(clean.warnings)


@pytest.mark.parametrize(
    "given",
    [RING[np.argsort(RING[:, 0], kind="stable")], np.concatenate([RING[: N // 2], RING[N // 2 :][::-1]])],
    ids=["by x", "two faces"],
)
def test_orders_of_tables_are_seen_to_be_none(given):
    clean = clean_points(given)
    assert clean.reordered and same_ring(clean.points, RING)


def test_repeated_points_are_merged():
    closed = clean_points(np.concatenate([RING, RING[:1]]))
    assert closed.merged == 1 and same_ring(closed.points, RING)
    doubled = clean_points(np.repeat(RING, 2, axis=0))
    assert doubled.merged == N and same_ring(doubled.points, RING)
    twice = clean_points(np.concatenate([RING, RING]))
    assert twice.merged == N and same_ring(twice.points, RING)


def test_closed_points_run_counter_clockwise_from_the_first():
    clean = clean_points(RING[::-1])
    assert clean.reversed and same_ring(clean.points, RING)
    np.testing.assert_array_equal(clean.points[0], RING[-1])
    arc = RING[:60]
    np.testing.assert_array_equal(clean_points(arc, closed=False).points, arc)
    np.testing.assert_array_equal(clean_points(arc, closed=False, reverse=True).points, arc[::-1])


@pytest.mark.parametrize(
    ("unit", "size"), [("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("um", 1e-6), ("in", 0.0254)]
)
def test_units(unit, size):
    np.testing.assert_allclose(clean_points(RING / size, unit=unit).points, RING, rtol=1e-14)


def square(side=20):
    t = np.arange(side) / side
    zero, one = 0 * t, 0 * t + 1
    sides = ((t, zero), (one, t), (1 - t, one), (zero, 1 - t))
    return 0.02 * np.concatenate([np.stack(side, axis=1) for side in sides])


def changed(rows, factor):
    points = RING.copy()
    points[rows] = points[rows] * factor
    return points


def bevelled():
    """A lens whose two corners are cut off: 35 degrees at both points of a bevel, 8 degrees elsewhere."""
    half = np.deg2rad([35.0, 35.0, *np.full(14, 110.0 / 14)])
    heading = np.cumsum(np.tile(half, 2))
    return 1e-3 * np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)


EIGHT = 0.03 * np.stack([np.sin(U), np.sin(2 * U)], axis=1)
CUSP = (0.02 * (1 - np.cos(U)))[:, None] * np.stack([np.cos(U), np.sin(U)], axis=1)
REFUSED = {
    "shape": (RING.T, {}, r"must have shape \(any, 2\), but had shape \(2, 200\)"),
    "text": ([["a", "b"]], {}, "must be numbers of shape"),
    "NaN": (np.where(np.arange(400).reshape(200, 2) == 33, np.nan, RING), {}, "finite, but row 16 was"),
    "too few": (RING[:5], {}, "6 distinct points or more, but there were 5"),
    "too few distinct": (np.repeat(RING[:3], 3, axis=0), {}, "but there were 3"),
    "unit": (RING, {"unit": "ft"}, "argument unit must be one of 'm', 'cm', 'mm', 'um', 'in', but was 'ft'"),
    "rows in mm": (
        changed(slice(50, 80), 1e3),
        {},
        "in one unit, but 170 lie within 0.03 m .* and 30 beyond",
    ),
    "one row in mm": (changed([5], 1e3), {}, "in one unit, but 199 lie within"),
    "one row in km": (changed([50], 1e-3), {"ordered": True}, "in one unit, but the point .* 30 mm from"),
    "column in mm": (RING * np.array([1.0, 1e3]), {}, "both columns in one unit"),
    "open": (
        RING[:120],
        {},
        r"leave a gap of 57.3 mm from \(-0.02481, -0.01686\) m to \(0.03, 0\) m .*closed=False",
    ),
    "open, scattered": (np.random.default_rng(4).permutation(RING[:120]), {}, "leave a gap of 57.3 mm"),
    "eight": (EIGHT, {}, "must not cross themselves"),
    "eight, scattered": (np.random.default_rng(4).permutation(EIGHT), {"ordered": False}, "plausible|pieces"),
    "cusp": (CUSP, {}, r"turn back by 17\d degrees \(a cusp\)"),
    "two rings": (np.concatenate([RING, RING + 0.1]), {}, "one curve, but fall into 2 pieces"),
    "ring as open": (
        np.random.default_rng(4).permutation(RING),
        {"closed": False},
        "argument closed must be True for points that go all round",
    ),
    "noise, scattered": (
        np.random.default_rng(5).permutation(star(200, noise=0.5)),
        {},
        "more than one order",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_one_contour_is_refused_in_one_sentence(case):
    points, options, sentence = REFUSED[case]
    with pytest.raises(ValueError, match=sentence) as error:
        clean_points(points, **options)
    assert str(error.value).startswith("argument ") and "\n" not in str(error.value)


def test_traced_points_are_refused():
    with pytest.raises(ValueError, match="argument points must be concrete numbers, but was traced"):
        jax.jit(lambda points: clean_points(points).points)(RING)


DOUBTED = {
    "metres that are millimetres": (1e3 * RING, "implausible for something grasped"),
    "microscopic": (1e-4 * RING, "implausible for something grasped"),
    "corners": (square(), "4 corners, of up to 90 degrees"),
    "bevels": (bevelled(), "2 corners, of up to 35 degrees"),
    "uneven": (np.delete(RING, np.r_[10:16, 40:46], axis=0), "spacing of the points is uneven"),
    "noise": (star(200, noise=0.6), "noise is as large as their spacing"),
}


@pytest.mark.parametrize("case", DOUBTED)
def test_what_is_doubtful_is_said(case):
    points, words = DOUBTED[case]
    assert words in " ".join(clean_points(points).warnings)
    assert clean_points(RING).warnings == ()


@pytest.mark.parametrize(
    ("long", "gap"), [((30, 16), False), ((34, 16), True), ((4.5,), False), ((5.5,), True)]
)
def test_a_gap_is_longer_than_all_other_steps(long, gap):
    """More than twice the next longest and five times the usual: others sample straight sides coarsely."""
    parts = np.array([*long[:1], *[1] * 150, *long[1:], *[1] * 150])
    u = 2.0 * np.pi * np.append(0.0, np.cumsum(parts)[:-1]) / parts.sum()
    ring = np.stack([np.cos(u), np.sin(u)], axis=1)
    with pytest.raises(ValueError, match="leave a gap of") if gap else contextlib.nullcontext():
        check_spacing(ring, closed=True)
    check_spacing(ring, closed=False)


@pytest.mark.parametrize("size", [1e-200, 1.0, 1e200])
def test_nearest_points_against_all_distances(size):
    """Of any size in floating point, far from the origin, and where fewer are there than asked for."""
    points = np.random.default_rng(0).normal(size=(150, 2)) + 1e3
    apart = np.hypot(*(points[:, None] - points[None, :]).T)
    for count in (1, 24, 200):
        wanted = np.argsort(apart, axis=1)[:, 1 : count + 1]
        np.testing.assert_array_equal(nearest_points(size * points, count), wanted)


def by_all_pairs(points, closed):
    """Proper and touching crossings of sides, pair by pair."""
    n = len(points) if closed else len(points) - 1
    found = []
    for i in range(n):
        for j in range(i + 2, n - (closed and i == 0)):
            a, b, c, d = points[i], points[(i + 1) % len(points)], points[j], points[(j + 1) % len(points)]
            matrix = np.stack([b - a, c - d], axis=1)
            if abs(np.linalg.det(matrix)) > 1e-14:
                t = np.linalg.solve(matrix, c - a)
                if np.all((t >= 0) & (t <= 1)):
                    found.append((i, j))
    return found


@pytest.mark.parametrize("closed", [True, False])
def test_crossings_against_every_pair_of_sides(closed):
    for seed in range(5):
        points = np.random.default_rng(seed).normal(size=(60, 2))
        found = [tuple(pair) for pair in crossings(points, closed=closed).tolist()]
        assert found == by_all_pairs(points, closed) and len(found) > 100
    assert len(crossings(star(3000), closed=True)) == 0


def test_of_few_points_the_nearest_may_come_two_places_on():
    """A zigzag of 20 points, whose nearest others are the next but one; three places on is no order."""
    places = np.arange(20)
    zigzag = np.stack([1.0 * places, 2.0 * (places % 2)], axis=1)
    near = nearest_points(zigzag, 1)
    assert set(np.abs(places - near[:, 0])) == {2}
    assert ordered_already(zigzag, near, closed=False)
    assert not ordered_already(zigzag, near + np.where(near > places[:, None], 1, -1), closed=False)


def test_one_point_many_times_is_one_point():
    """Even of a closed outline, which often repeats its first point at the end."""
    same = np.ones((5, 2))
    assert distinct(same, closed=True, anywhere=False).tolist() == [0]
    back = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]])
    assert distinct(back, closed=True, anywhere=False).tolist() == [0, 1]


@pytest.mark.parametrize(("width", "height"), [(30e-3, 15e-3), (35e-3, 20e-3)])
def test_an_eight_given_in_order_is_told_where_it_crosses(width, height):
    """By nearness it is a dumbbell, or no curve: either way its order crosses itself."""
    u = 2.0 * np.pi * np.arange(200) / 200
    points = np.stack([width * np.sin(u), height * np.sin(2.0 * u)], axis=1)
    wanted = Wanted(True, None, False, 2e-3, None, None, None)
    if width == 30e-3:
        (told,) = limited(points, wanted).clean.warnings
        assert "The order given crosses itself near (0.0002356, 0.0002355) m and was given up" in told
        assert not limited(points, replace(wanted, ordered=False)).clean.warnings
    else:
        with pytest.raises(ValueError, match="cross themselves, but in the order given they do near"):
            limited(points, wanted)
    shuffled = np.random.default_rng(0).permutation(points)
    assert order_given_up(shuffled, closed=True) == []


@pytest.mark.parametrize("seed", range(4))
def test_every_move_of_a_tour_shortens_it_until_none_does(seed):
    """Of ten random points, against all reversals of a stretch and all moves of one point."""
    points = np.random.default_rng(seed).uniform(size=(10, 2))
    apart = lambda a, b: np.linalg.norm(points[a] - points[b], axis=-1)  # noqa: E731
    length = lambda tour: float(apart(tour, np.roll(tour, -1)).sum())  # noqa: E731
    near = np.argsort(apart(np.arange(10)[:, None], np.arange(10)), axis=1)[:, 1:]

    def neighbours(tour):
        for i in range(10):
            for j in range(i + 2, 11):
                yield np.concatenate([tour[:i], tour[i:j][::-1], tour[j:]])
            for j in range(9):
                yield np.insert(np.delete(tour, i), j, tour[i])

    tour = np.arange(10)
    while (better := _best_move(tour, near, apart)) is not None:
        assert sorted(better) == list(range(10))
        shortest = min(map(length, neighbours(tour)))
        assert length(better) == pytest.approx(shortest) and shortest < length(tour)
        tour = better
    assert length(tour) <= min(map(length, neighbours(tour))) + 1e-12
