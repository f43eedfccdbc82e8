"""Orders of points, and what is refused or doubted of them: one case at either side of each limit."""

import itertools

import numpy as np
import pytest

from jaxroll.geometry.fitting import _band, _clean_points, _ordering
from tests.helpers import refused
from tests.subjects.polygons import on_circle, path, row

# The band of points that scatter by more than their spacing.


def scattered_plane():
    """Points that no order by nearness has, some of them far from the others."""
    points = np.random.default_rng(0).uniform(0.0, 1.0, (300, 2)) * (0.6, 1.0)
    points[:3] = [(0.2, 3.0), (0.25, 3.4), (-1.0, -2.0)]
    return points


def distances_in_order(points):
    return np.sort(np.linalg.norm(points[:, None] - points, axis=2), axis=1)


@pytest.mark.parametrize("scale", [1e-3, 0.2])
def test_scales_that_are_tried_grow_from_the_fourth_neighbours_to_an_eighth_of_the_size(scale, monkeypatch):
    """Each with all points, and without those whose eighth neighbour is three times as far as is usual."""
    points, tried = scattered_plane(), []
    monkeypatch.setattr(_band, "_by_nearness", lambda _, keep, at, **__: tried.append((at, keep)))
    away = distances_in_order(points)
    widest = 0.125 * np.ptp(points[:, 1])
    worst = int(np.argmax(away[:, 4]))
    words = rf"at no scale up to {1e3 * widest:.3g} mm .* the loneliest is row {worst} at"
    with pytest.raises(ValueError, match=words):
        _band.found_band(points, scale, closed=True, ordered=False)
    scales = [max(scale, np.median(away[:, 4]))]
    while scales[-1] * 1.4 < widest:
        scales.append(scales[-1] * 1.4)
    np.testing.assert_allclose([at for at, _ in tried], np.repeat(scales, 2), rtol=1e-12)
    near = away[:, 8] <= 3.0 * np.median(away[:, 8])
    assert 3 <= np.sum(~near) < 20
    for k, (_, keep) in enumerate(tried):
        np.testing.assert_array_equal(keep, near if k % 2 else np.ones(300, bool))


def test_what_is_loose_is_three_times_as_lonely_as_is_usual(monkeypatch):
    """In a lattice the eighth neighbour is a diagonal away; of one point beside it, a little less or more."""
    x, y = np.meshgrid(np.arange(12.0), np.arange(12.0))
    lattice = np.stack([x.ravel(), y.ravel()], axis=1)
    lattice += 1e-3 * np.random.default_rng(1).normal(size=lattice.shape)
    usual = np.median(distances_in_order(lattice)[:, 8])
    ways = np.linspace(2.0, 8.0, 6001)
    eighths = [np.sort(np.linalg.norm(lattice - (11.0 + out, 5.2), axis=1))[7] for out in ways]
    for factor, loose in ((2.95, False), (3.05, True)):
        points = np.concatenate([lattice, [(11.0 + np.interp(factor * usual, eighths, ways), 5.2)]])
        tried: list[np.ndarray] = []
        keep_all = lambda _, keep, at, tried=tried, **__: tried.append(keep)  # noqa: E731
        monkeypatch.setattr(_band, "_by_nearness", keep_all)
        monkeypatch.setattr(_band, "crust", lambda *_: None)
        with pytest.raises(ValueError, match="at no scale"):
            _band.found_band(points, 0.5, closed=True, ordered=False)
        assert any(not keep[-1] for keep in tried) == loose


def test_a_given_order_is_looked_at_on_seven_scales(monkeypatch):
    points, tried = on_circle(50, 1.0) + (0.3, 0.1), []
    strung = _band._strung

    def noted(given, scale, *, closed):
        tried.append(scale)
        return strung(given, scale, closed=closed)

    monkeypatch.setattr(_band, "_strung", noted)
    monkeypatch.setattr(_band, "_plausible", lambda *_, **__: len(tried) == 7)
    found = _band.found_band(points, 0.1, closed=True, ordered=None)
    np.testing.assert_allclose(tried, 0.1 * 1.4 ** np.arange(7), rtol=1e-12)
    assert not found.reordered and found.indices.tolist() == list(range(50)) and len(found.strays) == 0
    np.testing.assert_array_equal(found.chain, strung(points, tried[-1], closed=True))
    # Then what nearness says; an order that is to be believed is kept, at the first scale.
    monkeypatch.setattr(_band, "_plausible", lambda *_, **__: False)
    by_nearness = _band.found_band(points, 0.1, closed=True, ordered=None)
    assert by_nearness.reordered and len(tried) == 7 + 7 + 1 and tried[-1] == 0.1
    kept = _band.found_band(points, 0.1, closed=True, ordered=True)
    np.testing.assert_array_equal(kept.chain, strung(points, 0.1, closed=True))
    assert not kept.reordered


def test_an_order_that_leads_across_itself_names_both_places():
    chain = np.array([(0.0, 0.0), (4.0, 0.5), (4.0, 3.0), (1.0, 3.0), (1.0, -2.0), (3.0, -3.0)])
    with pytest.raises(ValueError, match=r"near \(0, 0\) m meets itself near \(1, 3\) m"):
        _band._check_uncrossed(chain, closed=False)
    _band._check_uncrossed(chain[:4], closed=True)


@pytest.mark.parametrize(("gap", "count", "plausible"), [
    (9.5, 12, True), (10.0, 12, True), (10.5, 12, False), (11.0, 60, True), (11.0, 50, True),
    (11.0, 40, False),
])  # fmt: skip
@pytest.mark.parametrize("axes", [(0, 1), (1, 0)])
def test_a_chain_jumps_by_ten_steps_and_a_fifth_of_its_size(gap, count, plausible, axes):
    """With a gap of 11 steps the extent is 69, 59 or 49."""
    steps = np.ones(count - 1)
    steps[count // 3] = gap
    assert _band._plausible(row(*steps, height=300.0)[:, axes], closed=False) == plausible


def test_a_short_chain_is_plausible_unless_it_crosses_itself():
    """Of fewer than eight means no jumps are looked for."""
    for count, plausible in ((7, True), (8, False)):
        assert _band._plausible(row(*[1.0] * (count - 2), 30.0), closed=False) == plausible
    crossed = np.array([(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)])
    assert not _band._plausible(crossed, closed=False)
    assert not _band._plausible(row(1.0), closed=False) and _band._plausible(row(1.0, 1.0), closed=False)


@pytest.mark.parametrize(("count", "height", "stray"), [
    (1, 6.7, False), (1, 7.2, True),  # 2 (h^2 + 1)^(1/2) - 2 = 12 at h = 6.93
    (2, 9.7, False), (2, 10.2, True),  # 2 (h^2 + 1)^(1/2) - 2 = 18 at h = 9.95
    (3, 12.7, False), (3, 13.3, True),  # 24 at h = 12.96
])  # fmt: skip
@pytest.mark.parametrize("size", [1.0, 0.01])
def test_a_detour_is_six_usual_steps_for_every_step_of_it(count, height, stray, size):
    points = row(*[1.0] * 59)
    off = np.arange(20, 20 + count)
    points[off, 1] = height
    kept, strays = _band._without_detours(size * points, 1e-3 * size, closed=False)
    assert strays.tolist() == (off.tolist() if stray else [])
    assert kept.tolist() == sorted(set(range(60)) - set(strays))


@pytest.mark.parametrize(("scale", "gap", "count"), [
    (0.1, 6.0, 1), (0.1, 6.2, 2), (0.1, 8.0, 2), (0.1, 8.2, 3), (0.1, 10.0, 3), (0.1, 10.2, 0),
    (2.0, 7.8, 1), (2.0, 8.2, 2), (2.0, 12.2, 0),
])  # fmt: skip
@pytest.mark.parametrize("size", [1.0, 0.01])
def test_a_corner_between_long_sides_is_no_detour(scale, gap, count, size):
    """The way past strays is shorter than three usual steps for each of its own, and a scale."""
    points = row(*[1.0] * 29, 0.5 * gap, 0.5 * gap, *[1.0] * 29)
    points[30, 1] = 60.0
    assert len(_band._without_detours(size * points, scale * size, closed=False)[1]) == count


def test_of_ten_points_one_may_be_a_stray():
    for count, strays in ((10, [4]), (9, [])):
        points = row(*[1.0] * (count - 1))
        points[4, 1] = 30.0
        assert _band._without_detours(points, 1e-3, closed=False)[1].tolist() == strays
    # At its ends an open line has no ways past a point.
    points = row(*[1.0] * 29)
    points[[0, 29], 1] = 40.0, -40.0
    assert len(_band._without_detours(points, 1e-3, closed=False)[1]) == 0


def test_of_overlapping_detours_the_longest_counts():
    """A point far off, with neighbours that are a little off, and one as far two places on."""
    points = row(*[1.0] * 59)
    points[[30, 32], 1] = 40.0, 30.0
    found = _band._without_detours(points, 1e-3, closed=False)
    assert found[1].tolist() == [30, 32] and 31 in found[0]


def test_cells_are_made_of_the_points_nearest_to_means():
    """From the first points a scale apart; twice moved to the means of their cells."""
    points, scale = np.random.default_rng(2).uniform(0.0, 1.0, (400, 2)), 0.17
    seeds: list[int] = []
    for i, p in enumerate(points):
        if all(np.linalg.norm(p - points[k]) > scale for k in seeds):
            seeds.append(i)
    middles = points[seeds]
    for turn in range(3):
        labels = np.argmin(np.linalg.norm(points[:, None] - middles, axis=2), axis=1)
        if turn < 2:
            middles = np.stack([points[labels == k].mean(axis=0) for k in np.unique(labels)])
    np.testing.assert_array_equal(_band._cells(points, scale), labels)


def ring_with_gap(gap):
    """Thirty places on a circle, evenly but for one step that is `gap` times as long, begun in the middle."""
    steps = np.array([gap, *[1.0] * 29])
    angles = 2.0 * np.pi * np.cumsum(steps) / steps.sum()
    return np.roll(3.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1) + (1.0, 5.0), 7, axis=0)


@pytest.mark.parametrize("gap", [2.4, 2.6])
def test_an_open_band_begins_behind_a_gap_that_stands_out(gap):
    """By two and a half usual steps; the gap's chord is a little shorter than its arc."""
    points = ring_with_gap(gap)
    found = _band._by_nearness(points, np.ones(30, bool), 0.1, closed=False)
    if gap < 2.5:
        assert found is None
        return
    places = found.indices.tolist()
    assert {places[0], places[-1]} == {7, 6} and sorted(places) == list(range(30))
    np.testing.assert_array_equal(found.chain, points[places])
    assert found.reordered and len(found.strays) == 0


def test_an_arc_is_a_band_with_two_ends_unless_these_are_near_each_other():
    arc = on_circle(60, 5.0)[:30] + (1.0, 2.0)
    found = _band._by_nearness(arc, np.ones(30, bool), 0.1, closed=False)
    assert found.indices.tolist() in (list(range(30)), list(range(29, -1, -1)))
    assert _band._by_nearness(arc, np.ones(30, bool), 0.1, closed=True) is None
    line = row(3.0, 3.0, 3.0)
    assert _band._closes(line[:3]) and not _band._closes(line) and _band._closes(0.1 * line[:3])


@pytest.mark.parametrize("count", [7, 8])
def test_a_chain_has_eight_means_at_least(count):
    points = on_circle(count, 2.0) + (1.0, 0.5)
    found = _band._by_nearness(points, np.ones(count, bool), 0.1, closed=True)
    assert (found is None) == (count == 7)


@pytest.mark.parametrize("left_out", [10, 11])
def test_a_tenth_of_all_points_may_be_strays(left_out):
    points = on_circle(100, 5.0) + (1.0, 0.5)
    keep = np.ones(100, bool)
    keep[: 9 * left_out : 9] = False
    found = _band._by_nearness(points, keep, 0.05, closed=True)
    if left_out == 11:
        assert found is None
    else:
        assert found.strays.tolist() == np.flatnonzero(~keep).tolist()
        np.testing.assert_array_equal(points[found.indices], found.chain)


@pytest.mark.parametrize("thickness", [0.19, 0.21])
def test_a_band_is_thinner_than_a_fifth_of_its_scale(thickness, monkeypatch):
    """Points at either side of sixty means, in cells of their own."""
    middles = on_circle(60, 10.0)
    points = np.concatenate([middles * (1.0 + side * thickness / 10.0) for side in (1.0, -1.0)])
    monkeypatch.setattr(_band, "_cells", lambda *_: np.tile(np.arange(60), 2))
    found = _band._by_nearness(points, np.ones(120, bool), 1.0, closed=True)
    assert (found is None) == (thickness > 0.2)


@pytest.mark.parametrize("few", [2, 3])
def test_cells_with_a_tenth_of_the_usual_number_are_strays(few, monkeypatch):
    """Thirty cells of twenty points; one more has few. One point is suspected beforehand."""
    middles = on_circle(30, 10.0)
    points = np.concatenate([np.repeat(middles, 20, axis=0), np.tile([[10.5, 0.0]], (few, 1)), [[0.0, 0.0]]])
    points += 0.01 * np.random.default_rng(3).normal(size=points.shape)

    def cells(given, scale):
        return np.argmin(np.linalg.norm(given[:, None] - [*middles, (10.5, 0.0)], axis=2), axis=1)

    monkeypatch.setattr(_band, "_cells", cells)
    monkeypatch.setattr(_band, "_THIN", 10.0)
    suspected = np.arange(len(points)) == len(points) - 1
    monkeypatch.setattr(_band, "crust", lambda means, _: _ordering.Order(np.arange(len(means)), loop=True))
    monkeypatch.setattr(_band, "crossings", lambda *_, **__: [])
    found = _band._by_nearness(points, ~suspected, 1.0, closed=True)
    assert found.strays.tolist() == [*(range(600, 602) if few == 2 else []), len(points) - 1]


def test_a_stretch_goes_on_to_the_scale_itself():
    """And of two that meet at the seam the last joins the first only where it has fewer points."""
    chain = _band._strung(row(*[1.0] * 8), 2.0, closed=False)
    np.testing.assert_allclose(chain[:, 0], [1.0, 4.0, 7.0])
    three = np.array([(0.0, 0.0), (0.2, 0.0), (1.1, 0.0), (1.1, 0.2), (0.4, 0.65), (0.3, 0.6)])
    chain = _band._strung(three, 0.9, closed=True)
    np.testing.assert_allclose(
        chain, [three[:2].mean(axis=0), three[2:4].mean(axis=0), three[4:].mean(axis=0)]
    )


# Orders by nearness.


def sawtooth(count, turn):
    """So many points that turn to and fro at each."""
    heading = np.where(np.arange(count) % 2, 0.5, -0.5) * np.radians(turn)
    return np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)


def test_a_zigzag_turns_by_more_than_thirty_degrees():
    assert _ordering.zigzags(sawtooth(20, 32.0), closed=False)
    assert not _ordering.zigzags(sawtooth(20, 28.0), closed=False)
    # Forty points, of which eight turn to and fro, are none; with nine they are.
    for teeth, zigzag in ((11, False), (12, True)):
        start = sawtooth(teeth, 50.0)
        line = start[-1] + np.arange(1, 41 - teeth)[:, None] * (1.0, 0.0)
        assert _ordering.zigzags(np.concatenate([start, line]), closed=False) == zigzag


def test_turnings_have_signs_and_ends_of_open_points_have_none():
    points = np.array([(1.0, 2.0), (3.0, 2.0), (3.0, 5.0), (7.0, 5.0), (8.0, 4.0)])
    quarter, eighth = 0.5 * np.pi, 0.25 * np.pi
    open_angles = [0.0, quarter, -quarter, -eighth, 0.0]
    np.testing.assert_allclose(_ordering.turnings(points, closed=False), open_angles, atol=1e-15)
    closed = _ordering.turnings(points, closed=True)
    np.testing.assert_allclose(closed[1:4], open_angles[1:4], atol=1e-15)
    back = np.arctan2(-2.0, -7.0)
    last = (back + eighth + np.pi) % (2.0 * np.pi) - np.pi
    np.testing.assert_allclose(closed[[4, 0]], [last, -back], atol=1e-14)


@pytest.mark.parametrize(("gap", "told"), [(9.8, True), (10.2, False)])
def test_a_crossing_as_given_is_told_where_no_step_is_longer_than_ten(gap, told):
    """A loop of a line with unit steps, whose ends go on; the crossing is at (10.5, 0)."""
    angles = np.radians(np.arange(0.0, 360.0, 15.0))
    heading = np.concatenate([np.zeros(12), angles, np.zeros(12)])
    points = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    points[-6:, 0] += gap - 1.0
    points = points + (0.31, 0.57)
    pairs = _ordering.crossings(points, closed=False)
    assert len(pairs) >= 1
    place = points[[*pairs[0], *(pairs[0] + 1)]].mean(axis=0)
    # To a ten-millionth of the size, which is between ten and a hundred.
    wanted = f"({round(place[0], 5):.4g}, {round(place[1], 5):.4g}) m"
    assert _ordering.crosses_as_given(points, closed=False) == (wanted if told else "")


def test_the_place_of_a_crossing_is_the_middle_of_the_ends_of_both_sides():
    corners = np.array([(0.0, 0.0), (2.0, 2.0), (2.0, 0.0), (0.0, 2.0)])
    share = np.arange(5)[:, None] / 5
    bow = np.concatenate([a + (b - a) * share for a, b in itertools.pairwise([*corners, corners[0]])])
    assert _ordering.crosses_as_given(bow, closed=True) == "(1, 1) m"
    assert _ordering.crosses_as_given(1e-3 * bow, closed=True) == "(0.001, 0.001) m"
    # Rounding is taken away, and no zero has a sign.
    assert _ordering.crosses_as_given(bow - (1.0 + 1e-9, 0.0), closed=True) == "(0, 1) m"
    assert _ordering.crosses_as_given(bow[:3], closed=True) == ""
    assert _ordering.crosses_as_given(bow[:10], closed=False) == ""


@pytest.mark.parametrize(("gap", "fair"), [(9.5, True), (10.0, True), (10.5, False)])
def test_an_order_has_no_step_of_more_than_ten(gap, fair):
    points = row(*[1.0] * 10, gap, *[1.0] * 10)
    near = _ordering.nearest_points(points, 4)
    assert _ordering.ordered_already(points, near, closed=False) == fair


@pytest.mark.parametrize(("jumped", "fair"), [(2, True), (3, False)])
def test_nineteen_of_twenty_points_have_their_nearest_beside_them(jumped, fair):
    """Within two places of forty, or a twentieth of all; round the seam of closed points too."""
    points = on_circle(40, 1.0)
    near = ((np.arange(40) + 1) % 40)[:, None]
    near[:jumped] = (np.arange(jumped)[:, None] + 20) % 40
    assert _ordering.ordered_already(points, near, closed=True) == fair
    assert _ordering.ordered_already(points, (near + 0) % 40, closed=False) == (fair and jumped < 2)


@pytest.mark.parametrize(("apart", "fair"), [(5, True), (6, False)])
def test_of_many_points_the_nearest_may_be_a_twentieth_of_the_whole_away(apart, fair):
    points = on_circle(100, 1.0)
    near = ((np.arange(100) + apart) % 100)[:, None]
    assert _ordering.ordered_already(points, near, closed=True) == fair


def test_pieces_are_parted_by_ten_usual_steps():
    for gap, parted in ((9.5, False), (10.0, False), (10.5, True)):
        points = row(*[1.0] * 10, gap, *[1.0] * 10)
        with refused(r"into 2 pieces, with gaps of up to .*e\+0[34] mm .* of 1e\+03 mm", parted):
            _ordering._in_one_piece(points, closed=False)
    # A ring with one gap is one piece; with two it is two, and an open line three.
    angles = np.cumsum([1.0] * 40 + [30.0] + [1.0] * 40 + [12.0])
    ring = 1e-3 * np.stack([np.cos(a := 2.0 * np.pi * angles / angles[-1]), np.sin(a)], axis=1)
    with refused("into 2 pieces"):
        _ordering._in_one_piece(ring, closed=True)
    with refused("into 3 pieces"):
        _ordering._in_one_piece(ring, closed=False)
    _ordering._in_one_piece(ring[:40], closed=False)


@pytest.mark.parametrize(("swap", "fair"), [(3, True), (4, False)])
def test_the_nearest_points_are_within_three_places_along_the_curve(swap, fair, monkeypatch):
    """Whatever the tour is: here the tour in order, and nearest points so many places on."""
    points = on_circle(40)
    near = (np.arange(40)[:, None] + [1, -1, 2, -2, 3, -3, 4, -4]) % 40
    near[11, :2] = 12, (11 + swap) % 40
    monkeypatch.setattr(_ordering, "_shortened", lambda *_, **__: np.arange(40))
    with refused(r"more than one order is plausible near row 11 at", not fair):
        found = _ordering.repaired(points, near, closed=True)
        assert found.indices.tolist() == list(range(40)) and found.loop
    near[11, 1], near[38, 1] = 10, (38 + swap) % 40
    with refused(r"more than one order is plausible near row 38 at", not fair):
        _ordering.repaired(points, near, closed=True)


def test_the_shortest_links_make_chains_without_rings():
    """Links from the shortest on: a square's closing side, and what would be a third neighbour, stay out."""
    points = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.1), (0.0, 1.3), (3.0, 0.0), (3.1, 0.1)])
    near = _ordering.nearest_points(points, 3)
    chains = _ordering._fragments(points, near)
    found = {min(tuple(c), tuple(reversed(c))) for c in chains}
    # 0-1 (1.0), 2-3 (1.02), 1-2 (1.1); 3-0 would close the ring; 4-5 first of all, and 1-4 has no free end.
    assert found == {(3, 2, 1, 0), (4, 5)} or found == {(0, 1, 2, 3), (4, 5)} or len(found) == 1
    lengths = sorted(len(c) for c in chains)
    assert sum(lengths) == 6


def greedy(points, near):
    """Links of chains, from the shortest on, by brute force."""
    pairs = sorted({tuple(sorted((i, int(j)))) for i, others in enumerate(near) for j in others},
                   key=lambda p: np.linalg.norm(points[p[0]] - points[p[1]]))  # fmt: skip
    taken, part = [], list(range(len(points)))
    for a, b in pairs:
        degrees = [sum(x in link for link in taken) for x in (a, b)]
        if max(degrees) < 2 and part[a] != part[b]:
            taken.append((a, b))
            part = [part[a] if x == part[b] else x for x in part]
    return set(taken)


@pytest.mark.parametrize("seed", range(3))
def test_chains_are_those_of_the_shortest_links(seed):
    points = np.random.default_rng(seed).uniform(size=(30, 2))
    near = _ordering.nearest_points(points, 5)
    links = {
        tuple(sorted(pair))
        for chain in _ordering._fragments(points, near)
        for pair in itertools.pairwise(chain)
    }
    assert links == greedy(points, near)


@pytest.mark.parametrize("closed", [True, False])
def test_chains_are_joined_by_their_nearest_ends(closed, monkeypatch):
    """Without any move afterwards: three pieces of a line, two of them the other way round."""
    points = row(*[1.0] * 4, 3.0, *[1.0] * 3, 2.0, *[1.0] * 6)
    chains = [[4, 3, 2, 1, 0], [5, 6, 7, 8], [15, 14, 13, 12, 11, 10, 9]]
    monkeypatch.setattr(_ordering, "_best_move", lambda *_: None)
    tour = _ordering._shortened(points, None, chains, closed=closed)
    line = list(range(16))
    assert tour.tolist() in ((line, line[::-1]) if closed else ([*line, 16], [*line[::-1], 16]))


def test_a_tour_is_moved_while_it_becomes_shorter_and_no_longer_than_the_bound(monkeypatch):
    """Four moves a point, or twenty where the points are very many: then 200 000 over their number."""
    calls: list[int] = []
    monkeypatch.setattr(_ordering, "_best_move", lambda tour, *_: calls.append(1) or tour)
    for count, most in ((5, 20), (400, 500), (15_000, 20)):
        calls.clear()
        points = row(*[1.0] * (count - 1))
        _ordering._shortened(points, None, [list(range(count))], closed=True)
        assert len(calls) == most


def test_the_further_point_of_an_open_tour_is_at_no_distance(monkeypatch):
    asked = []
    monkeypatch.setattr(_ordering, "_best_move", lambda tour, near, apart: asked.append(apart))
    points = np.array([(0.0, 0.0), (3.0, 0.0), (3.0, 4.0)])
    _ordering._shortened(points, None, [[0, 1, 2]], closed=False)
    assert asked[0](np.array([0, 0, 1, 3, 2]), np.array([1, 2, 2, 0, 3])).tolist() == [
        3.0,
        5.0,
        4.0,
        0.0,
        0.0,
    ]


@pytest.mark.parametrize(("length", "kept"), [(1.19, True), (1.2, True), (1.21, False)])
def test_a_given_order_stays_unless_it_is_a_fifth_longer(length, kept, monkeypatch):
    """Whatever else is to be said of it: its length, and that of the order by nearness, are set here."""
    points = row(*[1.0] * 20)
    swapped = np.arange(21)
    lengths = iter([length, 1.0])
    monkeypatch.setattr(_ordering, "_length", lambda *_, **__: next(lengths))
    found = _ordering.order_points(points, closed=False, ordered=None)
    assert (found is None) == kept
    if not kept:
        assert found.tolist() in (swapped.tolist(), swapped[::-1].tolist())
    assert _ordering.order_points(points, closed=False, ordered=True) is None


def test_lengths_of_polygons():
    points = np.array([(0.0, 0.0), (3.0, 0.0), (3.0, 4.0)])
    assert _ordering._length(points, closed=False) == 7.0 and _ordering._length(points, closed=True) == 12.0


@pytest.mark.parametrize("gap", [2.4, 2.6])
def test_points_all_round_are_opened_at_a_gap_that_stands_out(gap):
    points = ring_with_gap(gap)
    found = _ordering.Order(np.roll(np.arange(30), 4), loop=True)
    with refused("points that go all round, .* but the largest gap is", gap < 2.5):
        opened = _ordering._started(points, found, closed=False)
        assert opened.tolist() == [*range(7, 30), *range(7)]
    assert _ordering._started(points, found, closed=True).tolist() == list(range(30))


# What is said of raw points.


def sizes(*radii):
    """Points at these distances from the origin, all round."""
    radii = np.array(radii)
    return radii[:, None] * on_circle(len(radii), 1.0, 0.2)


@pytest.mark.parametrize(("factor", "mixed"), [(99.0, False), (101.0, True)])
def test_two_groups_a_hundred_times_apart_are_in_two_units(factor, mixed):
    small = [1.0, 1.1, 1.2, 1.3]
    points = sizes(*small, *(1.3 * factor * x for x in (1.0, 1.05, 1.1, 1.2)))
    with refused(rf"but 4 lie within 1.3 m of the origin and 4 beyond {1.3 * factor:.3g} m", mixed):
        _clean_points.check_one_unit(points, closed=False)
    # One point near the origin is no group, nor is one at the origin; two are.
    for alone in ([0.0], [1e-6], [0.0, 1e-6]):
        _clean_points.check_one_unit(sizes(*alone, *small), closed=False)
    with refused("but 4 lie within 1.3 m"):
        _clean_points.check_one_unit(sizes(0.0, *small, 500.0, 510.0), closed=False)
    with refused("but 2 lie within 2e-06 m"):
        _clean_points.check_one_unit(sizes(1e-6, *small, 2e-6), closed=False)


@pytest.mark.parametrize("axes", [(0, 1), (1, 0)])
@pytest.mark.parametrize(
    ("width", "closed", "fair"), [(99.0, True, True), (101.0, True, False), (101.0, False, True)]
)
def test_a_closed_contour_is_no_hundred_times_as_long_as_wide(axes, width, closed, fair):
    plate = np.array([(0.0, 3.0), (100.0, 3.0), (100.0, 4.0), (0.0, 4.0)])
    _clean_points.check_one_unit(plate[:, axes], closed=True)
    points = (on_circle(40, 0.5) * (width, 1.0) + (0.0, 3.0))[:, axes]
    text = "by".join(rf" {np.ptp(x):.3g} m " for x in points.T).strip()
    with refused("both columns in one unit and enclose an area, but extend over " + text, not fair):
        _clean_points.check_one_unit(points, closed=closed)


@pytest.mark.parametrize("anywhere", [True, False])
def test_points_within_a_billionth_of_the_size_are_one(anywhere):
    for apart, merged in ((0.4e-9, True), (1.8e-9, False)):
        points = 7.0 * np.array([(0.0, 0.0), (1.0, 0.0), (1.0 + apart, 0.0), (0.3, 0.6)])
        found = _clean_points.distinct(points[:, ::-1], closed=True, anywhere=anywhere).tolist()
        assert found == ([0, 1, 3] if merged or (anywhere and apart < 0.5e-9) else [0, 1, 2, 3])
    far = 7.0 * np.array([(0.0, 0.0), (1.0, 0.0), (0.4, 0.7), (1.0, 0.0), (0.0, 1e-10)])
    assert _clean_points.distinct(far, closed=True, anywhere=anywhere).tolist() == (
        [0, 1, 2] if anywhere else [0, 1, 2, 3]
    )
    assert len(_clean_points.distinct(far, closed=False, anywhere=False)) == 5


@pytest.mark.parametrize(("rounds", "cut"), [((60, 40), True), ((61, 39), False)])
def test_points_that_go_round_more_than_once_are_cut_to_their_first_round(rounds, cut, monkeypatch):
    """Where the distinct ones are three fifths of all, and come first."""
    monkeypatch.setattr(_clean_points, "order_points", lambda *_, **__: None)
    ring = on_circle(rounds[0])
    points = np.concatenate([ring, ring[: rounds[1]]])
    found = _clean_points._order(points, closed=True, ordered=None)
    assert (found is not None) == cut
    if cut:
        assert found.tolist() == list(range(60))
    doubled = np.repeat(ring, 2, axis=0)
    assert _clean_points._order(doubled, closed=True, ordered=None) is None
    assert _clean_points._order(points, closed=True, ordered=True) is None
    # An order that is found is one of the distinct points.
    monkeypatch.setattr(_clean_points, "order_points", lambda given, **__: np.arange(len(given))[::-1])
    assert (
        _clean_points._order(doubled, closed=True, ordered=None).tolist()
        == list(range(0, len(doubled), 2))[::-1]
    )


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize(("height", "lonely"), [(19.9, False), (20.1, True)])
def test_a_point_twenty_spacings_from_both_neighbours_is_refused(closed, height, lonely):
    points = 1e-3 * row(*[1.0] * 40)
    points[13, 1] = 1e-3 * height
    if closed:  # a loop, whose way back is as close
        points = np.concatenate([points, points[::-1] - (0.0, 1e-3)])
    far = f"{np.hypot(height, 1.0):.3g}"
    words = rf"the point \(0.013, {1e-3 * height:.4g}\) m lies {far} mm from its neighbours, which are 1 mm"
    with refused(words, lonely):
        _clean_points.check_spacing(points, closed=closed)


def test_steps_of_just_twenty_and_gaps_of_just_five_are_fair():
    _clean_points.check_spacing(row(*[1.0] * 9, 20.0, 20.0, *[1.0] * 9), closed=False)
    sides = [row(*[1.0] * 19), row(*[1.0] * 9)[:, ::-1] + (20.0, 0.0)]
    ring = np.concatenate([*sides, *((20.0, 10.0) - side for side in sides)])
    assert len(ring) == 60
    _clean_points.check_spacing(np.delete(ring, np.s_[5:9], axis=0), closed=True)
    with refused("leave a gap of 6e"):
        _clean_points.check_spacing(np.delete(ring, np.s_[5:10], axis=0), closed=True)


@pytest.mark.parametrize(("size", "doubted"), [(0.9e-4, True), (1.1e-4, False), (0.95, False), (1.05, True)])
def test_sizes_from_a_tenth_of_a_millimetre_to_a_metre_are_plausible(size, doubted):
    """The diagonal counts."""
    box = size * np.array([(0.0, 0.1), (0.6, 0.1), (0.6, 0.9), (0.0, 0.9)]) + (3.0, 2.0)
    told = _clean_points.size_warnings(box)
    assert len(told) == doubted and all(f"extend over {size:.3g} m" in text for text in told)


@pytest.mark.parametrize(("longest", "doubted"), [(4.9, False), (5.1, True)])
def test_steps_of_five_to_one_are_uneven(longest, doubted):
    assert _clean_points._spacing(row(2.0, 1.0, 5.0, 3.0), closed=False) == []
    told = _clean_points._spacing(1e-3 * row(2.0, 1.0, longest, 3.0), closed=False)
    assert len(told) == doubted and all(f"uneven, 1 to {longest:.3g} mm" in text for text in told)


@pytest.mark.parametrize(("count", "turn", "noise"), [(17, 37.0, True), (17, 35.0, False), (16, 37.0, False)])
def test_a_median_turning_above_36_degrees_is_noise(count, turn, noise):
    points = path(*[turn if k % 2 else -turn for k in range(count - 2)])
    assert ("noise is as large" in " ".join(_clean_points._bends(points, closed=False))) == noise


@pytest.mark.parametrize(("turn", "cusp"), [(143.0, False), (145.0, True), (-145.0, True)])
def test_points_that_turn_back_by_144_degrees_have_a_cusp(turn, cusp):
    points = path(*[1.0] * 12, turn, *[1.0] * 12)
    with refused(rf"turn back by {abs(turn):.0f} degrees \(a cusp\)", cusp):
        _clean_points._bends(points, closed=False)


@pytest.mark.parametrize(("usual", "turns", "count"), [
    (1.0, [29.0], 0), (1.0, [31.0], 1), (7.0, [34.0], 0), (7.0, [36.0], 1),  # 30 degrees, five times usual
    (1.0, [29.0, 29.0], 0), (1.0, [29.5, 31.0], 1), (0.5, [29.0, 32.0], 1),  # a corner cut off has two halves
    (5.9, [29.0, 29.5], 0), (13.0, [29.0, 29.5], 0), (1.0, [-40.0], 1), (1.0, [29.9, -29.9], 0),
])  # fmt: skip
def test_a_corner_turns_by_thirty_degrees_and_five_times_the_usual(usual, turns, count):
    points = path(*[usual] * 12, *turns, *[usual] * 12)
    told = _clean_points._bends(points, closed=False)
    assert len(told) == count
    for text in told:
        worst = np.argmax(np.abs(turns))
        place = points[13 + worst]
        assert f"1 corner, of up to {max(map(abs, turns)):.0f} degrees" in text
        assert f"near ({place[0]:.4g}, {place[1]:.4g}) m" in text


@pytest.mark.parametrize(("apart", "count"), [(1, 1), (2, 1), (3, 2), (9, 2)])
def test_turns_with_one_point_between_them_are_of_one_corner(apart, count):
    points = path(*[0.5] * 15, 40.0, *[0.5] * (apart - 1), 50.0, *[0.5] * 15)
    (told,) = _clean_points._bends(points, closed=False)
    assert told.startswith(f"The points have {count} corner{'s' if count > 1 else ''}, of up to 50 degrees")


def test_corners_are_counted_round_the_seam_of_closed_points():
    """A square whose first corner lies in two halves at either side of the seam."""
    side = np.arange(1, 12)[:, None] / 12
    corners = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    points = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        points += [a[None], a + (b - a) * side]
    ring = np.concatenate(points)[1:] * 0.02
    (told,) = _clean_points._bends(ring, closed=True)
    assert told.startswith("The points have 4 corners, of up to 90 degrees")


@pytest.mark.parametrize("closed", [True, False])
def test_what_is_usual_is_the_median_of_eight_around(closed):
    values = np.random.default_rng(5).uniform(size=30)
    wanted = []
    for i in range(30):
        around = [i + k for k in (-5, -4, -3, -2, 2, 3, 4, 5)]
        wanted.append(np.median([values[k % 30] if closed else values[min(max(k, 1), 28)] for k in around]))
    np.testing.assert_array_equal(_clean_points._beside(values, closed=closed, measure=np.median), wanted)


def looped(before, sides, after):
    """A line with a loop of so many sides, the first and the last of which cross."""
    turn = np.radians(360.0 / (sides - 1))
    heading = np.concatenate([np.zeros(before), turn * np.arange(sides), np.zeros(after)])
    return 1e-3 * np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)


@pytest.mark.parametrize(
    ("count", "sides", "fair"), [(60, 4, True), (60, 5, False), (170, 5, True), (170, 6, False)]
)
def test_small_loops_are_noise_and_large_ones_crossings(count, sides, fair):
    """Of up to three sides, or of a fortieth of all: between the two sides that cross."""
    turn = np.linspace(0.0, 0.02, count)
    points = 1e-3 * np.stack([np.arange(count), 100.0 * turn], axis=1)
    # The side that begins at 20 and the one that begins at 20 + apart cross: their ends are exchanged.
    apart = sides - 1
    first, last = 20, 20 + apart
    a, b = points[first].copy(), points[last + 1].copy()
    middle = 0.5 * (a + b)
    way = (b - a) / np.linalg.norm(b - a)
    side = np.array([-way[1], way[0]])
    for k, angle in zip(range(first + 1, last + 1), np.linspace(-0.35, np.pi + 0.35, apart), strict=True):
        points[k] = middle + 4e-4 * (np.cos(angle) * way + np.sin(angle) * side) + 3e-4 * side
    pairs = _clean_points.crossings(points, closed=False)
    assert pairs.tolist() == [[first, last]]
    with refused("must not cross themselves, but the side that begins at", not fair):
        (told,) = _clean_points._crossed(points, closed=False)
        assert told.startswith("The points cross themselves in 1 small loops")
    # In closed points the shorter way round counts, wherever they begin.
    closed = np.concatenate([points, points[::-1] - (0.0, 0.05)])
    turned = np.roll(closed, -first - 1 - apart // 2, axis=0)
    most = max(3, len(closed) // 40)
    with refused("must not cross themselves", apart > most):
        assert len(_clean_points._crossed(turned, closed=True)) == 1


def test_points_of_an_open_order_found_are_turned_to_bend_to_the_left():
    # Of 27 degrees, and of a square millimetre.
    arc = 0.01 * on_circle(40)[:5]
    for given, against in ((arc, False), (arc[::-1], True)):
        assert _clean_points._against(given, closed=False, reordered=True)[0] == against
        assert _clean_points._against(given, closed=False, reordered=False) == (False, [])
        assert _clean_points._against(given, closed=True, reordered=True) == (against, [])


@pytest.mark.parametrize("name", ["closed", "ordered", "reverse"])
def test_flags_are_flags(name):
    with refused(f"argument {name} must be"):
        _clean_points.clean_points(on_circle(40), **{name: "yes"})


def test_sides_of_one_line_touch_where_they_overlap():
    """Along x, along y and slanted; a little apart they do not."""
    for way in ((1.0, 0.0), (0.0, 1.0), (3.0, 4.0), (-3.0, 4.0)):
        for gap, found in ((-0.25, True), (0.0, True), (0.25, False)):
            at = np.array([0.0, 1.0, 5.0, 5.0, 1.0 + gap, 2.0 + gap])
            points = at[:, None] * way + np.array([0, 0, 3, 4, 0, 0])[:, None] * (-way[1], way[0])
            assert ([0, 4] in _ordering.crossings(points, closed=False).tolist()) == found


@pytest.mark.parametrize("ordered", [None, True, False])
def test_points_are_compared_with_all_others_where_an_order_is_to_be_found(ordered, monkeypatch):
    asked = []

    def noted(points, *, closed, anywhere):
        asked.append((closed, anywhere))
        return np.arange(len(points))

    monkeypatch.setattr(_clean_points, "distinct", noted)
    clean = _clean_points.clean_points(on_circle(40), ordered=ordered)
    assert asked[0] == (True, ordered is False) and len(clean.points) == 40
