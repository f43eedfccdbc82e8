"""Steps of fits of scans in space: rolled balls, wavelengths, holes, regions, and what is said of a fit."""

import types
from typing import Any

import numpy as np
import pytest

from jaxroll.geometry.fitting import _scan_fit, _scan_verdict
from jaxroll.geometry.fitting._field_fit import Grid
from jaxroll.geometry.fitting._indicator import Body
from jaxroll.geometry.fitting._rolling import _cores, centres, rolled
from jaxroll.geometry.fitting._scan import Scan
from jaxroll.geometry.fitting._surface_measured import evenly
from jaxroll.geometry.fitting._surface_report import regions_of, trusted_places

HALF, STEP = np.array([0.02, 0.015, 0.012]), 0.001


def scan_of(points, normals, **changes):
    count = len(points)
    found = {"areas": np.full(count, STEP**2), "sure": np.ones(count), "spacing": STEP} | changes
    return Scan(points, normals, **found)


def box():
    """A cuboid's faces at a millimetre, and their normals."""
    points, normals = [], []
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        u, v = (np.arange(-HALF[n], HALF[n] + STEP / 2, STEP) for n in (i, j))
        for side in (-1.0, 1.0):
            face = np.zeros((len(u) * len(v), 3))
            face[:, i], face[:, j] = (x.ravel() for x in np.meshgrid(u, v))
            face[:, k] = side * HALF[k]
            points.append(face)
            normals.append(np.tile(side * np.eye(3)[k], (len(face), 1)))
    return np.concatenate(points), np.concatenate(normals)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rolled_balls_round_a_box_from_inside(side):
    """All points come to lie one radius from the box that is smaller by it; of a cavity, too."""
    (points, normals), radius = box(), 0.005
    found = rolled(scan_of(points, side * normals), radius, 1e-4)
    assert found is not None
    inner = np.clip(found.points, -(HALF - radius), HALF - radius)
    arms = found.points - inner
    lengths = np.linalg.norm(arms, axis=1)
    # Points nearly there, by two tolerances, stay. Others are on balls, whose centres are a millimetre apart.
    moved = np.any(found.points != points, axis=1)
    assert moved.sum() > 1000
    np.testing.assert_allclose(lengths[moved], radius, atol=6e-5)
    np.testing.assert_allclose(lengths, radius, atol=2e-4)
    cosines = np.sum(arms / lengths[:, None] * found.normals, axis=1) * side
    assert cosines.min() > 0.95
    flat = np.sort(HALF - np.abs(points), axis=1)[:, 1] > radius
    np.testing.assert_array_equal(found.points[flat], points[flat])
    np.testing.assert_array_equal(found.normals[flat], side * normals[flat])
    assert found.free[flat].all()
    assert not found.free[np.sort(HALF - np.abs(points), axis=1)[:, 1] < 0.9 * radius].any()
    assert not found.thin.any()


def test_where_no_ball_fits_there_is_nothing():
    points, normals = box()
    assert rolled(scan_of(points, normals), 0.013, 1e-4) is None
    assert rolled(scan_of(points, normals, sure=np.full(len(points), 0.2)), 0.005, 1e-4) is None
    places = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.003]])
    assert centres(points, places, 0.0115).tolist() == [True, False]


@pytest.mark.parametrize(("thickness", "cores"), [(0.6, True), (0.9, True), (0.45, False)])
def test_thin_parts_have_the_largest_balls_that_touch_both_sides(thickness, cores):
    """Two plates, their distance in diameters of the balls."""
    radius, x = 0.005, np.arange(-0.01, 0.0101, STEP)
    u, v = (grid.ravel() for grid in np.meshgrid(x, x))
    half = thickness * radius
    points = np.concatenate([np.stack([u, v, side * half + 0.0 * u], axis=1) for side in (1, -1)])
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], len(u), axis=0)
    middles, thin = _cores(points, normals, np.ones(len(points), bool), radius)
    assert thin.all()
    expected = points * [1.0, 1.0, 0.0] if cores else np.zeros((0, 3))
    np.testing.assert_allclose(middles, expected, atol=1e-17)


def problem(points, filled=0) -> Any:
    return types.SimpleNamespace(whole=types.SimpleNamespace(points=points), filled=filled)


def test_the_longest_wavelength_that_is_nearly_as_good(monkeypatch):
    """From 0.6 of the size down to 2.4 radii by factors of 1.5: here 0.6, 0.9, 1.35 ... times 4 mm."""
    size, radius = 0.03, 0.004 / 2.4
    cloud = np.array([[0.0, 0.0, 0.0], [size, 0.01, 0.0]])
    ladder = 0.004 * 1.5 ** np.arange(3, -1, -1.0)
    assert 0.6 * size / 1.5 < ladder[0] <= 0.6 * size
    for scores, best in (
        ([8.0, 4.0, 2.0, 1.0], 3),
        ([8.0, 1.005, 2.0, 1.0], 1),
        ([8.0, 1.02, 1.0, 1.5], 2),
        ([1.0, 1.0, 1.0, 1.0], 0),
    ):
        known = dict(zip(np.round(ladder, 9), scores, strict=True))
        monkeypatch.setattr(_scan_fit, "_score", lambda _, at, known=known: known[round(at, 9)])
        assert _scan_fit._chosen(problem(cloud), cloud, radius) == pytest.approx(ladder[best])
    monkeypatch.setattr(_scan_fit, "_score", lambda _, at: 1.0)
    assert _scan_fit._chosen(problem(cloud), cloud, 0.02) == pytest.approx(0.048)


def test_a_shorter_wavelength_is_taken_if_it_is_better_and_not_too_dear(monkeypatch):
    radius = 0.005
    cloud = np.array([[0.0, 0.0, 0.0], [0.03, 0.02, 0.02]])
    scores = {0.012: 1.0, 0.008: 0.98}
    monkeypatch.setattr(_scan_fit, "_score", lambda _, at: scores[round(at, 9)])
    assert _scan_fit._finer(problem(cloud), 0.012, radius) == pytest.approx(0.008)
    assert _scan_fit._finer(problem(cloud), 0.018, radius) is None  # not the end of the ladder
    assert _scan_fit._finer(problem(8.0 * cloud), 0.012, radius) is None  # 86 x 61 x 61 cells and more
    scores[0.008] = 0.995
    assert _scan_fit._finer(problem(cloud), 0.012, radius) is None


def test_the_grid_has_room_for_the_points_and_no_more():
    points = np.array([[0.0, 0.1, 0.2], [0.03, 0.12, 0.205]])
    grid = _scan_fit._grid(points, 0.002)
    assert grid.counts == (20 + 5, 15 + 5, 8 + 5)  # 15, 10 and 2.5 cells, 2.5 on either side, rounded up
    middle = grid.origin + 0.5 * grid.step * (np.array(grid.counts) - 5)
    np.testing.assert_allclose(middle, points.mean(axis=0))
    with pytest.raises(ValueError, match=r"argument smallest_radius must be larger for a body of 0.03 m"):
        _scan_fit._grid(points * [1.0, 1.0, 6.0], 0.0001)


def net():
    """An octahedron of 10 mm as a body: its indicator is |x| + |y| + |z| - 10 mm on a grid of 1 mm."""
    ends = 0.01 * np.concatenate([np.eye(3), -np.eye(3)])
    faces = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    x = np.arange(-0.02, 0.0201, 0.001)
    values = np.abs(np.meshgrid(x, x, x, indexing="ij")).sum(axis=0) - 0.01
    return Body(values, np.full(3, -0.02), 0.001, ends, np.array(faces))


def test_holes_of_a_scan_are_filled_from_the_body():
    """One point near the end of the first axis: the other five ends are farther away, and fill."""
    scan = scan_of(np.array([[0.0104, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]]), sure=np.array([0.5]))
    whole, filled = _scan_fit._filled(scan, net(), 0.002)
    assert filled == 5
    np.testing.assert_allclose(whole.points, [[0.0104, 0, 0], *net().vertices[1:]])
    np.testing.assert_allclose(whole.normals, [[1.0, 0.0, 0.0], *(100.0 * net().vertices[1:])], atol=1e-15)
    # Four faces of sqrt(3) / 2 edge^2 / 2 meet at each end, which stands for a third of each.
    share = 4.0 / 3.0 * np.sqrt(3.0) / 4.0 * 2e-4
    np.testing.assert_allclose(whole.areas, [STEP**2, *5 * [0.1 * share]])
    assert whole.sure.tolist() == [0.5, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert _scan_fit._filled(scan, net(), 0.05)[1] == 0


def test_distances_are_asked_for_away_from_the_body():
    """At every second node that is more than 1.5 cells from the body's vertices: negative inside."""
    grid = Grid(np.full(3, -0.018), 0.002, (23, 23, 23))
    nodes, distances = _scan_fit._distances(grid, net())
    every = np.stack(np.meshgrid(*3 * [-0.018 + 0.004 * np.arange(10)], indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    least = np.linalg.norm(every[:, None] - net().vertices, axis=2).min(axis=1)
    far = least > 0.003
    np.testing.assert_allclose(nodes, every[far])
    inside = np.abs(every).sum(axis=1) < 0.01
    np.testing.assert_allclose(distances, np.where(inside, -least, least)[far])


@pytest.mark.parametrize("count", [1, 200_000, 200_001, 400_000, 900_001])
def test_of_many_points_as_many_are_measured_as_may_be(count):
    """Every k-th; with k less one they would be too many."""
    k = evenly(count).step
    assert len(range(count)[evenly(count)]) <= 200_000
    assert k == 1 or len(range(count)[:: k - 1]) > 200_000


def test_regions_are_what_hangs_together():
    line = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    one, other = regions_of(line, np.array([1.0, 2.0, 3.0, 4.0]), 1.1, "no data")
    assert (one.centre, one.radius, one.area, one.reason) == ((1.0, 0.0, 0.0), 1.0, 6.0, "no data")
    assert (other.centre, other.radius, other.area) == ((5.0, 0.0, 0.0), 0.0, 4.0)
    assert regions_of(line[:0], np.zeros(0), 1.0, "no data") == []


def test_a_place_is_trusted_near_points_that_are_near_the_surface():
    """The median of the five nearest counts, and the distance of the nearest."""
    points = np.arange(10.0)[:, None] * [1.0, 0.0, 0.0]
    feet = points + np.where(np.arange(10)[:, None] < 5, 0.25, 0.5) * [0.0, 0.0, 1.0]
    places = np.array([[0.0, 0.5, 0.0], [0.0, 0.7, 0.0], [4.1, 0.0, 0.0], [4.9, 0.0, 0.0], [9.0, 0.0, 0.0]])
    found = trusted_places(points, feet, places, reach=0.5, tolerance=0.25)
    assert found.tolist() == [True, False, True, False, False]


SAID = {
    "whole": ((1e-4, 2e-4), None, 0.0, 0.0, ", 0.1 mm rms from 100 % of the points"),
    "edges": (
        (1e-4, 2e-4),
        (1e-3, 3e-3),
        0.25,
        0.0005,
        ", 0.1 mm rms from 75 % of the points, the other 25 % rounded off by up to 3 mm",
    ),
    "hole": (
        None,
        (1e-3, 3e-3),
        1.0,
        0.12,
        ", the other 100 % rounded off by up to 3 mm, 12 % of it closed without data",
    ),
}


@pytest.mark.parametrize("name", SAID)
def test_a_verdict_says_what_was_kept_rounded_and_closed(name):
    kept, rounded, share, uncovered, words = SAID[name]
    assert _scan_verdict._verdict(kept, rounded, share, uncovered, 0.005) == (
        "one smooth surface with radii of curvature from 5 mm up" + words
    )
    assert _scan_verdict._pair(np.array([0.3, 0.4])) == pytest.approx((np.sqrt(0.125), 0.4))
    assert _scan_verdict._pair(np.zeros(0)) is None


FINE = {
    "curvatures": (-100.0, 200.0),
    "thin": 0.2,
    "parts": (1, 1),
    "moved": 0.3,
    "uncovered": 0.6,
    "turned": 0.02,
}
BEYOND = {
    "thin": ({"thin": 0.3}, "smallest_radius must be smaller for a body of which 30 % is thinner"),
    "moved": ({"moved": 0.4}, "smallest_radius must be smaller for these points, of which 40 % by"),
    "two bodies": ({"parts": (2, 1)}, "points must determine one closed surface, but the fit to them has 2$"),
    "a cavity": ({"parts": (1, 2)}, "points must determine one closed surface, but the fit to them has 2$"),
    "no curvature": ({"curvatures": (-100.0, np.nan)}, "points must determine one closed surface"),
    "bent out": (
        {"curvatures": (-100.0, 201.0)},
        "smallest_radius must be smaller .* still bends with 0.00498 m",
    ),
    "bent in": (
        {"curvatures": (-250.0, 150.0)},
        "smallest_radius must be smaller .* still bends with 0.004 m",
    ),
    "bare": ({"uncovered": 0.7}, "points must cover most of a closed surface, but 70 %"),
    "turned": ({"turned": 0.03}, "normals must point outward, but 3.0 % of them"),
}


def judged(curvatures, thin, parts, moved, uncovered, turned):
    """Ten points and vertices at the same places, of areas 1 to 4, with these shares."""
    points = np.arange(10.0)[:, None] * [1.0, 0.0, 0.0]
    areas = np.ones(10)
    distances = np.where(np.arange(10) < round(10 * moved), 0.0026, 0.0024)
    body = types.SimpleNamespace(thin=np.arange(10) < round(10 * thin))
    found: Any = types.SimpleNamespace(
        curvatures=curvatures, rolled=body, vertices=points + 0.1, areas=areas, parts=parts
    )
    _scan_verdict._refused(found, points, distances, uncovered, turned, 0.005)


@pytest.mark.parametrize("name", BEYOND)
def test_a_surface_that_is_not_the_body_is_refused(name):
    judged(**FINE)
    change, words = BEYOND[name]
    with pytest.raises(ValueError, match="^argument " + words):
        judged(**FINE | change)


@pytest.mark.parametrize("most", ["enough", "too few"])
def test_a_shorter_wavelength_is_tried_if_its_grid_has_few_enough_cells(most, monkeypatch):
    """The count beforehand is the grid's own, or up to one more along each axis."""
    points, radius = np.array([[0.0, 0.0, 0.0], [0.1, 0.07, 0.05]]), 0.01
    wavelength = _scan_fit._WAVE * radius
    finer = wavelength / _scan_fit._LADDER
    counts = np.array(_scan_fit._grid(points, finer / _scan_fit._CELLS).counts)
    room = {"enough": np.prod(counts + 1), "too few": np.prod(counts - 1)}
    monkeypatch.setattr(_scan_fit, "_FINER", room[most])
    monkeypatch.setattr(_scan_fit, "_score", lambda problem, tried: tried)
    problem: Any = types.SimpleNamespace(whole=types.SimpleNamespace(points=points))
    found = _scan_fit._finer(problem, wavelength, radius)
    assert found == (pytest.approx(finer) if most == "enough" else None)
    assert _scan_fit._finer(problem, 1.1 * wavelength, radius) is None
