"""Parts of fits, each against brute force or by hand: what stands out, what crosses, orders, views, cells."""

import itertools

import numpy as np
import pytest
from scipy.interpolate import BSpline, make_interp_spline
from scipy.sparse import csr_matrix

from jaxroll.geometry import clean_points
from jaxroll.geometry.fitting import (
    _band,
    _bounded_curve,
    _crossings,
    _departures,
    _even_spline,
    _indicator,
    _limited_fit,
    _ordering,
    _rolled_line,
    _scan,
    _scan_fit,
    _scan_verdict,
    _surface_normals,
    _visibility,
)
from tests.subjects.clouds import sphere
from tests.subjects.polygons import on_circle, wavy


def stadium(per_side=40, half=0.02, radius=0.01, first=0):
    """Two lines and two half circles, evenly spaced, counterclockwise from the middle of the lower line."""
    step = 2.0 * half / per_side
    arc = round(np.pi * radius / step)
    line = (np.arange(per_side) + 0.5) / per_side * 2.0 * half - half
    angles = (np.arange(arc) + 0.5) / arc * np.pi - 0.5 * np.pi
    right = np.stack([half + radius * np.cos(angles), radius * np.sin(angles)], axis=1)
    lower = np.stack([line, np.full(per_side, -radius)], axis=1)
    return np.roll(np.concatenate([lower, right, -lower, -right]), -first, axis=0), arc


def test_three_points_have_the_curvature_of_their_circle():
    curvatures = _departures.three_point_curvatures(on_circle(30, 0.05), closed=True)
    np.testing.assert_allclose(curvatures, 20.0, rtol=1e-12)
    uneven = 0.05 * np.exp(1j * np.cumsum([0.0, 0.1, 0.3, 0.2, 0.5]))
    points = np.stack([uneven.real, -uneven.imag], axis=1)
    np.testing.assert_allclose(
        _departures.three_point_curvatures(points, closed=False), [0.0, -20.0, -20.0, -20.0, 0.0], rtol=1e-12
    )


@pytest.mark.parametrize("first", [0, 18, 20, 39])
def test_lines_that_meet_arcs_are_jumps_of_the_curvature(first):
    points, arc = stadium(first=first)
    feet = np.arange(len(points)) * 1e-3
    found = _departures.jumps(points, feet, closed=True)
    ends = [(0.02, -0.01), (0.02, 0.01), (-0.02, 0.01), (-0.02, -0.01)]
    assert len(found) == 4 and arc == 31
    for jump in found:
        away = np.linalg.norm(np.array(ends) - jump.place, axis=1)
        i = int(np.argmin(away))
        ends.pop(i)
        assert away[i] < 1.5e-3 and jump.angle == 0.0
        assert sorted((jump.before, jump.after)) == pytest.approx([0.0, 100.0], abs=0.1)
        # From a line into an arc at the right below and at the left above.
        assert (jump.after > jump.before) == (jump.place[0] * jump.place[1] < 0.0)
        k = int(np.flatnonzero((points == jump.place).all(axis=1))[0])
        assert jump.arclength == feet[k]


def test_corners_turn_by_their_angle_and_ends_of_open_points_are_none():
    one = np.stack([np.linspace(0.0, 0.03, 31), np.zeros(31)], axis=1)
    way = np.array([np.cos(0.7), np.sin(0.7)])
    points = np.concatenate([one, one[-1] + np.arange(1, 31)[:, None] * 1e-3 * way])
    (corner,) = _departures.jumps(points, np.arange(61.0), closed=False)
    assert corner.place == pytest.approx((0.03, 0.0)) and corner.arclength == 30.0
    assert corner.angle == pytest.approx(0.7, rel=1e-12)
    (turned,) = _departures.jumps(points * (1.0, -1.0), np.arange(61.0), closed=False)
    assert turned.angle == pytest.approx(-0.7, rel=1e-12)
    # Noise that could make a corner of this angle hides it: 20 times the noise beside angle times step.
    assert _departures.jumps(points, np.arange(61.0), closed=False, noise=0.7e-3 / 20.0 * 1.01) == ()
    assert len(_departures.jumps(points, np.arange(61.0), closed=False, noise=0.7e-3 / 20.0 * 0.99)) == 1
    # A corner of an arc counts by what it turns beyond the arc.
    half = on_circle(60)[:31]
    bent = np.concatenate([half, half[-1] + (half[-1] - half[0]) / 0.04 * np.arange(1, 31)[:, None] * 2e-3])
    (met,) = _departures.jumps(bent, np.arange(61.0), closed=False)
    steps = np.diff(bent, axis=0)
    turning = np.arctan2(steps[29:31, 1], steps[29:31, 0])
    reach = 0.5 * (np.linalg.norm(steps[29]) + np.linalg.norm(steps[30]))
    bends = _departures.three_point_curvatures(bent, closed=False)
    beyond = (turning[1] - turning[0] + np.pi) % (2.0 * np.pi) - np.pi - 0.5 * (bends[25] + bends[35]) * reach
    assert met.place == pytest.approx(tuple(half[-1])) and met.angle == pytest.approx(beyond, rel=1e-9)


def test_the_largest_of_neighbouring_flags_is_taken():
    flags = np.zeros(20, bool)
    flags[[0, 1, 6, 9, 13, 18]] = True
    sizes = np.arange(20.0)
    assert _departures._peaks(flags, sizes, closed=False) == [1, 9, 13, 18]
    # Round the seam 18 and 0 are two apart.
    assert _departures._peaks(flags, sizes, closed=True) == [9, 13, 18]
    flags[[17, 18]] = True, False
    flags[0] = False
    # 17 and 1 are four apart.
    assert _departures._peaks(flags, sizes, closed=True) == [1, 9, 13, 17]
    assert _departures._peaks(np.zeros(5, bool), sizes[:5], closed=True) == []


def test_neighbours_off_a_contour_are_a_departure_and_one_alone_is_not():
    feet = np.arange(100) * 1e-3
    points = np.stack([feet, np.zeros(100)], axis=1)
    distances = np.zeros(100)
    distances[[40, 41, 42]] = 4e-4, 6e-4, 4e-4
    distances[60] = 9e-4
    shuffled = np.random.default_rng(0).permutation(100)
    options = {"closed": True, "noise": 1e-4, "radius": 2.5e-3}
    (one,) = _departures.departures(points[shuffled], feet[shuffled], distances[shuffled], **options)
    assert (one.start, one.end, one.place, one.distance) == (feet[40], feet[42], (feet[41], 0.0), 6e-4)
    # Below three standard deviations, or a thousandth of the radius three times, nothing is off.
    assert _departures.departures(points, feet, distances, closed=True, noise=2.1e-4, radius=2.5e-3) == ()
    assert len(_departures.departures(points, feet, distances, closed=True, noise=0.0, radius=2.5e-3)) == 1
    # Stretches closer than the radius are one; past s = 0 they go on.
    distances[[45, 46]] = 5e-4
    near, far = dict(options, radius=3.5e-3), dict(options, radius=2.5e-3)
    assert [d.end for d in _departures.departures(points, feet, distances, **near)] == [feet[46]]
    assert [d.end for d in _departures.departures(points, feet, distances, **far)] == [feet[42], feet[46]]
    distances[[98, 99, 0, 1]] = 5e-4
    assert len(_departures.departures(points, feet, distances, **dict(far, closed=False))) == 4
    found = _departures.departures(points, feet, distances, **far)
    assert [(d.start, d.end) for d in found] == [
        (feet[40], feet[42]),
        (feet[45], feet[46]),
        (feet[98], feet[1]),
    ]
    # At both ends, but too far apart round the seam.
    distances[[98, 99, 0, 1, 2, 3]] = 0.0, 0.0, 0.0, 0.0, 5e-4, 5e-4
    distances[[96, 97]] = 5e-4
    assert len(_departures.departures(points, feet, distances, **far)) == 4


def test_strays_stand_alone_and_far_off_where_the_curve_could_bend():
    places, distances, bending = np.arange(50.0), np.full(50, 1e-5), np.zeros(50)
    distances[[10, 20, 21, 30]] = 1e-3, 1e-3, 1e-3, -1e-3
    bending[30] = 0.95
    options = {"noise": 1e-4, "radius": 1e-3}
    shuffled = np.random.default_rng(1).permutation(50)
    found = _departures.strays(places[shuffled], distances[shuffled], bending[shuffled], **options)
    assert sorted(shuffled[found]) == [10, 20, 21]
    distances[[19, 22]] = 1e-3
    found = _departures.strays(places, distances, bending, **options)
    assert found.tolist() == [10]
    bending[30] = -0.85
    assert _departures.strays(places, distances, bending, **options).tolist() == [10, 30]
    # Six standard deviations, or six times a two-hundredth of the radius.
    assert _departures.strays(places, distances, bending, noise=1.7e-4, radius=1e-3).tolist() == []
    assert _departures.strays(places, distances, bending, noise=1e-4, radius=0.034).tolist() == []
    assert _departures.strays(places, distances, bending, noise=1e-4, radius=0.032).tolist() == [10, 30]


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("ends", [(0, 1), (1, 0)])
def test_a_side_that_ends_on_another_touches_it(flip, ends):
    """Whichever of the two comes first, and whichever of its ends lies there."""
    stem = np.array([(0.0, 0.0), (0.0, 1.0)])[list(ends)]
    bar = np.array([(-1.0, 0.0), (1.0, 0.0)])
    far = [(3.0, 2.0), (3.0, -2.0)]
    first, second = (bar, stem) if flip else (stem, bar)
    points = np.concatenate([first, far, second])
    assert [0, 4] in _crossings.crossings(points, closed=False).tolist()
    # A little apart they do not touch.
    moved = points + np.where((points == stem[:, None]).all(axis=2).any(axis=0)[:, None], (0.0, 1e-9), 0.0)
    assert [0, 4] not in _crossings.crossings(moved, closed=False).tolist()


@pytest.mark.parametrize("seed", range(4))
def test_the_best_move_of_a_tour_is_the_best_of_all(seed):
    x = np.random.default_rng(seed).uniform(size=(9, 2))
    near = np.array([np.delete(np.arange(9), i) for i in range(9)])

    def length(tour):
        return np.linalg.norm(x[tour] - x[np.roll(tour, -1)], axis=1).sum()

    tour = np.random.default_rng(seed + 10).permutation(9)
    while True:
        moves = [
            np.concatenate([tour[:i], tour[i:j][::-1], tour[j:]])
            for i, j in itertools.combinations(range(10), 2)
        ]
        for a, place in itertools.product(range(9), range(8)):
            moves.append(np.insert(tour[tour != a], place + 1, a))
        best = min(map(length, moves))
        better = _ordering._best_move(tour, near, lambda a, b: np.linalg.norm(x[a] - x[b], axis=-1))
        if better is None:
            assert best >= length(tour) - 1e-9
            break
        assert sorted(better) == list(range(9)) and length(better) == pytest.approx(best, rel=1e-12)
        tour = better


def test_noise_is_what_a_line_through_both_neighbours_leaves():
    rng = np.random.default_rng(3)
    places = np.sort(rng.uniform(size=20_000))
    order = rng.permutation(len(places))
    errors = 3e-4 * rng.normal(size=len(places))
    # A slope costs nothing, however uneven the places.
    assert _limited_fit.estimated_noise(places[order], (2.0 + 5.0 * places)[order]) < 1e-14
    measured = _limited_fit.estimated_noise(places[order], (5.0 * places + errors)[order])
    assert measured == pytest.approx(3e-4, rel=0.03)


def test_repeated_points_are_counted():
    points = on_circle(80)
    wanted = _limited_fit.Wanted(True, None, False, 5e-3, None, None, None)
    found = _limited_fit.limited(np.concatenate([points, points[:7]]), wanted)
    assert found.clean.merged == 7 and len(found.clean.points) == 80


def test_stretches_of_a_line():
    off = np.array([1, 1, 0, 0, 1, 0, 1, 1, 1], bool)
    several = _rolled_line._stretches(off, closed=False)
    assert [s.tolist() for s in several] == [[0, 1], [4], [6, 7, 8]]
    assert [s.tolist() for s in _rolled_line._stretches(off, closed=True)] == [[4], [6, 7, 8, 0, 1]]
    assert _rolled_line._stretches(np.ones(4, bool), closed=True) == []
    assert _rolled_line._stretches(np.zeros(4, bool), closed=False) == []


def test_chords_of_a_circle_have_its_normals():
    points = on_circle(200)
    inward = _rolled_line._normals(points, 0.02, closed=True)
    np.testing.assert_allclose(inward, -points / 0.02, atol=1e-12)
    # At the ends of open points the chord is one-sided.
    ends = _rolled_line._normals(points[:100], 0.02, closed=False)
    k = int(np.ceil(_rolled_line._ACROSS * 0.02 / np.linalg.norm(points[1] - points[0])))
    chord = points[k] - points[0]
    np.testing.assert_allclose(ends[0], np.array([-chord[1], chord[0]]) / np.linalg.norm(chord), atol=1e-12)
    np.testing.assert_allclose(ends[50], inward[50], atol=1e-12)


def test_ways_out_of_a_box_are_free_where_nothing_stands_in_them():
    cells = np.random.default_rng(4).integers(4, 9, (12, 3))
    found = _visibility._free_ways(cells)
    taken = set(map(tuple, cells.tolist()))
    shape = cells.max(axis=0) + 1 + 4
    assert found.shape == tuple(shape)
    inside = set(itertools.product(*map(range, shape.tolist())))
    for start in inside:
        free = 0
        for way in itertools.product((-1, 0, 1), repeat=3):
            if way == (0, 0, 0):
                continue
            place = tuple(map(sum, zip(start, way, strict=True)))
            while place in inside and place not in taken:
                place = tuple(map(sum, zip(place, way, strict=True)))
            free += place not in taken
        assert found[start] == free


def test_a_cell_has_one_side_of_six():
    rng = np.random.default_rng(5)
    points, normals = rng.uniform(size=(400, 3)), rng.normal(size=(400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for given in (None, normals):
        count, number = _scan._cells(points, given, 0.3)
        names = []
        for i, p in enumerate(points - points.min(axis=0)):
            main = 0 if given is None else int(np.argmax(np.abs(normals[i])))
            side = (0, 0) if given is None else (main, normals[i, main] > 0.0)
            names.append((*np.floor(p / 0.3).astype(int), *side))
        assert count == len(set(names)) == len(set(number))
        assert len(set(zip(names, number, strict=True))) == count


def test_a_thinned_cloud_keeps_area_and_leaves_out_what_lies_apart(monkeypatch):
    points = sphere(4000, 0.02)
    far = np.array([[0.0, 0.0, 0.05]])
    scan, numbers = _scan.thinned_scan(np.concatenate([points, far]), None, 2e-3)
    assert numbers[-1] == -1 and np.all(numbers[:-1] >= 0) and len(numbers) == 4001
    assert scan.areas.sum() == pytest.approx(4.0 * np.pi * 0.02**2, rel=0.06)
    outward = np.sum(scan.points * scan.normals, axis=1) / np.linalg.norm(scan.points, axis=1)
    assert outward.min() > 0.97 and np.all((scan.sure >= 0.0) & (scan.sure <= 1.0))
    for i in (0, 17, 3000):
        assert np.linalg.norm(scan.points[numbers[i]] - points[i]) < 2e-3 * np.sqrt(3.0)
    # Too many cells are widened, not much beyond what is needed.
    for most in (300, 700):
        monkeypatch.setattr(_scan, "_LARGEST", most)
        fewer, _ = _scan.thinned_scan(points, points / 0.02, 1e-3)
        assert 0.4 * most < len(fewer.points) <= most
        np.testing.assert_allclose(np.sum(fewer.points * fewer.normals, axis=1) > 0.0, True)


def test_normals_are_sure_where_neighbours_lie_in_a_plane():
    rng = np.random.default_rng(6)
    points = np.concatenate([rng.uniform(-1.0, 1.0, (300, 2)), rng.normal(0.0, 0.02, (300, 1))], axis=1)
    points[:150, 2] = 0.0
    points[:150, 0] -= 1.2
    points[150:, 0] += 1.2
    near = np.argsort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1)[:, :12]
    _, _, sure = _surface_normals.parted_normals(points, near, np.full(300, 0.01))
    flat = np.abs(points[near][:, :, 2]).max(axis=1) == 0.0
    assert flat.sum() > 80
    np.testing.assert_allclose(sure[flat], 1.0, atol=1e-9)
    for i in range(0, 300, 7):
        least, middle, _ = np.linalg.eigvalsh(np.cov(points[near[i]].T))
        expected = np.clip(1.0 - 10.0 * least / middle, 0.0, 1.0)
        np.testing.assert_allclose(sure[i], expected, atol=1e-9)


def test_neighbours_agree_along_the_tree_that_turns_least():
    """The sum over its links of 1 - |n . n'|, against Prim's method by hand."""
    rng = np.random.default_rng(7)
    points = rng.uniform(size=(40, 3))
    normals = rng.normal(size=(40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    near = np.argsort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1)[:, :9]
    order, before = _surface_normals._tree(normals, near)
    assert sorted(order) == list(range(40))
    cost = 1.0 - np.abs(normals @ normals.T)
    linked = np.full((40, 40), np.inf)
    for i, others in enumerate(near[:, 1:]):
        linked[i, others] = linked[others, i] = cost[i, others]
    reached, total = {int(order[0])}, 0.0
    while len(reached) < 40:
        i, j = min(itertools.product(reached, set(range(40)) - reached), key=lambda ij: linked[ij])
        total += linked[i, j]
        reached.add(j)
    assert sum(cost[i, before[i]] for i in order[1:]) == pytest.approx(total, rel=1e-9)


def test_a_grid_surrounds_its_points_with_room():
    points = sphere(200, 0.02) + (0.1, 0.0, -0.3)
    grid = _scan_fit._grid(points, 1e-3)
    cells = np.array(grid.counts) - (_scan_fit.ORDER - 1)
    low, high = np.array(grid.origin), np.array(grid.origin) + 1e-3 * cells
    room = _scan_fit._ROOM * 1e-3
    assert np.all(low <= points.min(axis=0) - room + 1e-12) and np.all(
        high >= points.max(axis=0) + room - 1e-12
    )
    assert np.all(high - low < np.ptp(points, axis=0) + 2.0 * room + 1e-3 + 1e-12)
    np.testing.assert_allclose(low + high, points.min(axis=0) + points.max(axis=0), atol=1e-12)
    with pytest.raises(
        ValueError, match="argument smallest_radius must be larger for a body of 0.0398 m: it asks"
    ):
        _scan_fit._grid(points, 2e-5)


def test_a_verdict_tells_what_is_kept_rounded_and_closed():
    say = _scan_verdict._verdict
    assert say(None, None, 0.0, 0.0005, 0.004) == "one smooth surface with radii of curvature from 4 mm up"
    said = say((3e-4, 1e-3), (1e-4, 2e-3), 0.25, 0.0015, 0.004).split(", ")
    assert said[1:] == [
        "0.3 mm rms from 75 % of the points",
        "the other 25 % rounded off by up to 2 mm",
        "0.15 % of it closed without data",
    ]


def crossed(one, other):
    return one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]


@pytest.mark.parametrize("closed", [True, False])
def test_an_even_spline_is_scipys_quintic(closed):
    nodes = wavy(40, closed)
    spline = _even_spline.EvenSpline(nodes, closed)
    assert spline.pieces == (40 if closed else 39)
    looped = np.concatenate([nodes, nodes[:1]]) if closed else nodes
    options = {"bc_type": "periodic"} if closed else {}
    other = make_interp_spline(np.arange(len(looped)), looped, k=5, **options)
    u = np.linspace(0.0, spline.pieces, 333)[:-1]
    frame = spline.frames(u)
    np.testing.assert_allclose(frame.point, other(u), atol=1e-15)
    rate, bend = other(u, 1), other(u, 2)
    np.testing.assert_allclose(frame.speed, np.linalg.norm(rate, axis=1), rtol=1e-10)
    np.testing.assert_allclose(np.sum(frame.normal * rate, axis=1), 0.0, atol=1e-15)
    # To the left, of length one; curvature by the cross product.
    np.testing.assert_allclose(crossed(rate, frame.normal), frame.speed, rtol=1e-10)
    np.testing.assert_allclose(frame.curvature, crossed(rate, bend) / frame.speed**3, rtol=1e-6)
    if closed:
        np.testing.assert_allclose(spline.frames(u + 40.0).point, frame.point, atol=1e-15)
    else:
        np.testing.assert_array_equal(spline.frames(np.array([-3.0, 50.0])).point, nodes[[0, -1]])


@pytest.mark.parametrize("closed", [True, False])
def test_nodes_are_spread_at_equal_distances(closed):
    spline = _even_spline.EvenSpline(wavy(40, closed), closed)
    u, along = spline.arclengths()
    fine = spline.frames(np.linspace(0.0, spline.pieces, 200_001)).point
    whole = np.linalg.norm(np.diff(fine, axis=0), axis=1).sum()
    assert along[0] == 0.0 and along[-1] == pytest.approx(whole, rel=1e-4) and u[-1] == spline.pieces
    fewer = spline.spread(25)
    feet = spline.feet(fewer.nodes)
    lengths = np.interp(feet, u, along)
    step = along[-1] / (25 if closed else 24)
    wanted = step * np.arange(25)
    away = (lengths - wanted + 0.5 * along[-1]) % along[-1] - 0.5 * along[-1] if closed else lengths - wanted
    assert len(fewer.nodes) == 25 and np.abs(away).max() < 1e-3 * step


@pytest.mark.parametrize("closed", [True, False])
def test_feet_are_the_nearest_points(closed):
    spline = _even_spline.EvenSpline(wavy(60, closed), closed)
    points = np.random.default_rng(10).normal(0.0, 0.025, (200, 2))
    points = points[np.linalg.norm(points, axis=1) > 0.012]
    # By brute force in two rounds: of the whole curve, then of what is beside the nearest place.
    coarse = np.linspace(0.0, spline.pieces, 1201)
    far = np.linalg.norm(spline.frames(coarse).point[:, None] - points[None], axis=2)
    fine = coarse[far.argmin(axis=0)][:, None] + np.linspace(-0.06, 0.06, 121)
    near = spline.frames(fine.ravel()).point.reshape(*fine.shape, 2)
    away = np.linalg.norm(near - points[:, None], axis=2).min(axis=1)
    found = np.linalg.norm(spline.frames(spline.feet(points)).point - points, axis=1)
    np.testing.assert_allclose(found, away, atol=2e-8)


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_displacements_are_sums_of_bumps(closed, order):
    u = np.concatenate([np.random.default_rng(11).uniform(0.0, 12.0, 50), [0.0, 12.0 - 1e-12, 5.0]])
    matrix = _even_spline.displacements(u, 12, closed=closed, order=order).toarray()
    assert matrix.shape == (53, 12 if closed else 17)
    bump = BSpline.basis_element(np.arange(-3.0, 4.0), extrapolate=False)
    bump = bump.derivative(order) if order else bump
    each = np.nan_to_num(bump(u[:, None] - np.arange(-2, 15)))
    if closed:
        # Bumps about j and j + 12 are the same one.
        each = np.stack([each[:, (np.arange(-2, 15) - j) % 12 == 0].sum(axis=1) for j in range(12)], axis=1)
    np.testing.assert_allclose(matrix, each, atol=1e-14)


def test_a_low_pass_halves_the_wave_of_its_length():
    at = np.arange(240) / 240
    waves = np.stack([np.cos(2.0 * np.pi * k * at) for k in (1, 4, 12)], axis=1)
    passed = _even_spline.low_passed(waves, 0.24, 0.06, closed=True)
    shares = 1.0 / (1.0 + (np.array([1, 4, 12]) / 4.0) ** 6)
    np.testing.assert_allclose(passed, shares * waves, atol=1e-14)
    # Between its ends an open curve is its chord and waves of half periods.
    share = np.linspace(0.0, 1.0, 121)[:, None]
    odd = np.sin(np.pi * np.array([2, 5, 9]) * share)
    line = (1.0 - share) * np.array([[1.0, 2.0, 3.0]]) + share * np.array([[3.0, 5.0, 4.0]])
    passed = _even_spline.low_passed(line + odd, 0.1, 0.04, closed=False)
    shares = 1.0 / (1.0 + (0.04 * np.array([2, 5, 9]) / 0.2) ** 6)
    np.testing.assert_allclose(passed, line + shares * odd, atol=1e-13)


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("n", [9, 10])
def test_banded_systems_are_solved_round_a_closed_curve_too(closed, n):
    rng = np.random.default_rng(12)
    matrix = np.zeros((n, n))
    for i, k in itertools.product(range(n), range(4)):
        if closed or i + k < n:
            matrix[i, (i + k) % n] = matrix[(i + k) % n, i] = rng.normal()
    matrix += 12.0 * np.eye(n)
    right = rng.normal(size=n)
    found = _bounded_curve._solved(csr_matrix(matrix), right, closed=closed)
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("bound", [0.3, 1e6])
def test_the_least_price_of_an_excess_has_no_slope(bound):
    """Where the bound is passed and where it is not; without it the minimum is that of the form alone."""
    rng = np.random.default_rng(13)
    half = rng.normal(size=(8, 8))
    form, pull, bend = half @ half.T + np.eye(8), rng.normal(size=8), rng.normal(size=(12, 8))
    now, rho = rng.normal(size=12), 3.0
    options = {"closed": False}
    w = _bounded_curve._minimum(csr_matrix(form), pull, csr_matrix(bend), now, bound, rho, **options)
    after = now + bend @ w
    excess = np.sign(after) * np.maximum(np.abs(after) - bound, 0.0)
    assert np.any(excess != 0.0) == (bound < 1.0)
    np.testing.assert_allclose(form @ w - pull + rho * bend.T @ excess, 0.0, atol=1e-6)
    if bound > 1.0:
        np.testing.assert_allclose(w, np.linalg.solve(form, pull), rtol=1e-6)


@pytest.mark.parametrize("closed", [True, False])
def test_points_off_the_way_are_detours(closed):
    points = on_circle(120) if closed else on_circle(160)[:120]
    out = 1.0 + np.where(np.isin(np.arange(120), [20, 50, 51, 90, 91, 92]), 1.0, 0.0)
    kept, strays = _band._without_detours(points * out[:, None], 1e-3, closed=closed)
    assert sorted(strays) == [20, 50, 51, 90, 91, 92]
    assert kept.tolist() == [i for i in range(120) if i not in strays]
    # Four together are shape; the first point of a closed curve may be one that is off.
    out = 1.0 + np.where(np.isin(np.arange(120), [0, 60, 61, 62, 63]), 1.0, 0.0)
    kept, strays = _band._without_detours(points * out[:, None], 1e-3, closed=closed)
    assert sorted(strays) == ([0] if closed else [])
    # Corners between long sides, and what is small beside the scale, are none.
    square = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    share = np.arange(10)[:, None] / 10
    sides = np.concatenate([a + (b - a) * share for a, b in zip(square, np.roll(square, -1, 0), strict=True)])
    assert len(_band._without_detours(sides, 1e-3, closed=True)[1]) == 0
    single = points * (1.0 + np.where(np.arange(120) == 20, 0.4, 0.0))[:, None]
    for scale, expected in ((5e-3, [20]), (9e-3, [])):
        assert _band._without_detours(single, scale, closed=closed)[1].tolist() == expected


def test_stretches_of_points_are_strung_a_scale_apart():
    line = np.stack([np.arange(10) * 1.0, np.zeros(10)], axis=1)
    # A stretch ends with the first point farther than the scale from where it began.
    chain = _band._strung(line, 2.5, closed=False)
    np.testing.assert_allclose(chain[:, 0], [1.0, 4.0, 7.0, 9.0])
    ring = on_circle(20, 1.0)
    chain = _band._strung(ring, 0.8, closed=True)
    step = 2.0 * np.sin(np.pi / 20)
    assert step * 2 < 0.8 < step * 3
    # Of seven stretches of three the last has two, and joins the first.
    wanted = [ring[[0, 1, 2, 18, 19]].mean(axis=0)] + [
        ring[3 * k : 3 * k + 3].mean(axis=0) for k in range(1, 6)
    ]
    np.testing.assert_allclose(chain, wanted, atol=1e-15)
    # So does the last of three; of two it is the other side, and stays.
    three = np.array([(0.0, 0.0), (0.2, 0.0), (1.1, 0.0), (1.1, 0.2), (0.4, 0.65)])
    chain = _band._strung(three, 0.9, closed=True)
    np.testing.assert_allclose(chain, [three[[0, 1, 4]].mean(axis=0), three[2:4].mean(axis=0)], atol=1e-15)
    two = np.array([(0.0, 0.0), (0.0, 0.1), (0.0, 0.2), (1.0, 0.0), (0.5, 0.0)])
    chain = _band._strung(two, 0.9, closed=True)
    np.testing.assert_allclose(chain, [two[:3].mean(axis=0), two[3:].mean(axis=0)], atol=1e-15)
    labels = np.array([3, 0, 3, 1, 0])
    np.testing.assert_allclose(_band._means(line[:5], labels, 5)[:, 0], [2.5, 3.0, 1.0])


def test_points_in_cells_with_few_are_strays_where_some_are_suspected():
    rng = np.random.default_rng(0)
    ring = on_circle(400, 1.0) * (1.0 + 0.01 * rng.normal(size=(400, 1)))
    points = np.concatenate([[[0.0, 0.1]], ring, [[0.3, 0.2]]])
    suspected = np.arange(len(points)) != 0
    found = _band._by_nearness(points, suspected, 0.2, closed=True)
    assert found.strays.tolist() == [0, 401] and sorted(found.indices.tolist()) == list(range(1, 401))
    # Along the ring; within a tenth of the scale points may change places.
    steps = np.diff(np.unwrap(np.arctan2(*points[found.indices].T[::-1])))
    assert abs(abs(steps.sum()) - 2.0 * np.pi) < 0.1 and np.abs(steps).max() < 0.1


@pytest.mark.parametrize("closed", [True, False])
def test_points_have_places_along_their_chain(closed):
    chain = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)])
    points = np.array([(0.5, -0.1), (2.2, 0.25), (1.0, 1.3), (-0.3, 0.5)])
    along, off = _band._projected(points, chain, closed=closed)
    # In sixteenths of a step; without the last side the fourth point is nearest to a corner.
    ends = [3.5, 0.3] if closed else [0.0, np.hypot(0.3, 0.5)]
    np.testing.assert_allclose(along / 16.0, [0.25, 1.25, 2.5, ends[0]], atol=1e-12)
    np.testing.assert_allclose(off, [0.1, 0.2, 0.3, ends[1]], atol=1e-12)


def test_a_chain_closes_where_its_ends_are_within_two_of_its_steps():
    line = np.stack([np.arange(4.0), np.zeros(4)], axis=1)
    assert _band._closes(line[:3]) and not _band._closes(line)


def test_the_body_that_most_of_a_scan_lies_on_is_taken_and_its_cavities_filled():
    """The second of two boxes, though the first has more cells; the other is a small part of the scan."""
    values = np.full((20, 10, 10), 1.0)
    values[1:9, 1:9, 1:9] = -2.0
    values[12:17, 3:8, 3:8] = -3.0
    values[14, 5, 5] = 1.0
    places = np.array([(12.0, 5.0, 5.0), (16.0, 5.0, 5.0), (14.0, 3.0, 5.0), (1.0, 5.0, 5.0)])
    outward = np.array([(-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0)])
    areas = np.array([1.0, 1.0, 1.0, 0.01])
    scan = _scan.Scan(places - 0.1 * outward, outward, areas, np.ones(4), 0.1)
    found = _indicator._alone(values, scan, np.zeros(3), 1.0)
    wanted = np.abs(values)
    wanted[12:17, 3:8, 3:8] = -3.0
    wanted[14, 5, 5] = -1.0
    np.testing.assert_array_equal(found, wanted)
    both = _scan.Scan(scan.points, outward, np.ones(4), np.ones(4), 0.1)
    with pytest.raises(ValueError, match="must enclose one body, but 25 % of them lie on 1 other$"):
        _indicator._alone(values, both, np.zeros(3), 1.0)
    with pytest.raises(ValueError, match="must enclose a body, but enclose none"):
        _indicator._alone(np.ones((3, 3, 3)), scan, np.zeros(3), 1.0)


def test_a_mesh_has_a_million_samples_or_two_at_most(monkeypatch):
    """Each of two triangles is cut into so many parts along its sides; a square of that many are sampled."""
    asked = []
    one = np.full((1, 3), 1.0 / 3.0)
    monkeypatch.setattr(_scan, "_middles", lambda parts: asked.append(parts) or one)
    corners = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)])
    points, normals = _scan.sampled_mesh(corners, np.array([(0, 1, 2), (0, 2, 3)]), 1e-9)
    assert 1e6 < 2 * asked[0] ** 2 < 5e6 and len(asked) == 1 and len(normals) == len(points) == 2


def test_an_open_order_begins_after_its_cut():
    """Points along an open arc, in any order, come out from one end to the other, none left out."""
    arc = on_circle(60)[:40]
    order = np.random.default_rng(14).permutation(40)
    points = arc[order]
    found = _ordering.repaired(points, _ordering.nearest_points(points, 8), closed=False)
    along = order[found.indices]
    assert along.tolist() in (list(range(40)), list(range(39, -1, -1)))


def test_repeated_points_are_too_few():
    five = on_circle(5)
    with pytest.raises(ValueError, match="must be 6 distinct points or more, but there were 5"):
        clean_points(np.repeat(five, 2, axis=0), ordered=True)


@pytest.mark.parametrize("shift", [0, 1, 20, 39, 40])
def test_wherever_a_tour_is_cut_open_no_point_is_lost(shift, monkeypatch):
    points = on_circle(60)[:40]
    tour = np.roll(np.arange(41), shift)  # 40 is the additional point
    monkeypatch.setattr(_ordering, "_shortened", lambda *_, **__: tour)
    found = _ordering.repaired(points, _ordering.nearest_points(points, 8), closed=False)
    assert found.indices.tolist() == list(range(40))


@pytest.mark.parametrize("block", [1, 7, 10_000])
def test_crossings_are_found_block_by_block(block, monkeypatch):
    monkeypatch.setattr(_crossings, "_BLOCK", block)
    points = np.random.default_rng(15).uniform(size=(25, 2))
    wanted = []
    for i, j in itertools.combinations(range(25), 2):
        a, b, c, d = points[[i, (i + 1) % 25, j, (j + 1) % 25]]
        # The place where both lines meet, as shares of both sides.
        t, u = np.linalg.solve(np.stack([b - a, c - d], axis=1), c - a)
        if j - i not in (1, 24) and 0.0 <= t <= 1.0 and 0.0 <= u <= 1.0:
            wanted.append([i, j])
    assert len(wanted) > 30 and _crossings.crossings(points, closed=True).tolist() == wanted


def test_an_arc_that_runs_into_a_line_has_one_jump():
    """What the ends of open points have beside them is not what the other end has."""
    arc = on_circle(60)[:30]
    way = (arc[-1] - arc[-2]) / np.linalg.norm(arc[-1] - arc[-2])
    points = np.concatenate(
        [arc, arc[-1] + np.arange(1, 31)[:, None] * np.linalg.norm(arc[1] - arc[0]) * way]
    )
    for given, sides in ((points, (50.0, 0.0)), (points[::-1], (0.0, -50.0))):
        (jump,) = _departures.jumps(given, np.arange(60.0), closed=False)
        assert abs(np.linalg.norm(np.array(jump.place) - arc[-1])) < 2.2e-3
        assert (jump.before, jump.after) == pytest.approx(sides, abs=1e-6) and jump.angle == 0.0


def test_an_order_that_is_to_be_believed_is_kept():
    assert _band._plausible(on_circle(3), closed=True) and not _band._plausible(on_circle(2), closed=True)
    zigzag = np.stack([np.arange(40) * 1e-3, np.where(np.arange(40) % 2, 8e-4, 0.0)], axis=1)
    found = _band.found_band(zigzag, 1e-6, closed=False, ordered=True)
    assert not found.reordered and found.indices.tolist() == list(range(40))
    assert found.chain.shape[1] == 2 and len(found.strays) == 0
