"""Steps of fits of scans, by loops and by hand: thinning, double sheets, rolled balls, rounds, reports."""

import itertools
import types
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jaxroll import _results
from jaxroll.geometry.fitting import _rolling, _scan, _scan_fit, _scan_verdict
from jaxroll.geometry.fitting._field_fit import Grid
from jaxroll.geometry.fitting._scan import Scan
from jaxroll.geometry.fitting._surface_report import Region
from tests.helpers import refused


def random_scan(count, seed=0, spread=0.4, **changes):
    """Points near a plane, with normals mostly upwards."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3)) * spread + (0.0, 0.0, 1.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = {
        "points": rng.uniform(0.0, 1.0, (count, 3)) * (1.0, 1.0, 0.3),
        "normals": normals,
        "areas": rng.uniform(0.5, 2.0, count),
        "sure": rng.choice([0.2, 0.5, 0.6, 1.0], count), "spacing": 0.3,
    }  # fmt: skip
    return Scan(**(found | changes))


@pytest.mark.parametrize(("count", "reach"), [(20, 0.2), (60, 0.2), (60, 0.1)])
def test_sheets_are_joined_point_by_point(count, reach):
    """Of 24 neighbours those beside a point, with like normals; by the mean of their heights, by area."""
    scan = random_scan(count, spacing={0.2: 0.3, 0.1: 0.18}[reach])
    joined, moved = scan.joined(reach).points, 0
    for i, (point, normal) in enumerate(zip(scan.points, scan.normals, strict=True)):
        arms = scan.points - point
        near = np.argsort(np.linalg.norm(arms, axis=1))[:24]
        heights, weights = [], []
        for k in near:
            height = arms[k] @ normal
            aside = np.linalg.norm(arms[k] - height * normal)
            if scan.normals[k] @ normal > 0.8 and abs(height) < reach and aside < scan.spacing:
                heights.append(height)
                weights.append(scan.areas[k])
        mean = np.average(heights, weights=weights)
        spread = np.sqrt(np.average((np.array(heights) - mean) ** 2, weights=weights))
        double = spread > 0.25 * scan.spacing and scan.sure[i] > 0.5
        moved += double
        np.testing.assert_allclose(joined[i], point + (mean * normal if double else 0.0), atol=1e-12)
    assert 0 < moved < count - 3


def test_averages_of_cells_by_loops():
    """Places and levels by area; directions by area and by how sure they are."""
    scan = random_scan(200, spread=0.8)
    levels = np.random.default_rng(1).normal(size=200)
    mean, heights = scan.averaged(0.35, levels)
    _, number = _scan._cells(scan.points, scan.normals, 0.35)
    assert len(mean.points) == number.max() + 1 < 100 and mean.spacing == scan.spacing
    for k in range(len(mean.points)):
        own = number == k
        area = scan.areas[own].sum()
        np.testing.assert_allclose(
            mean.points[k], np.average(scan.points[own], axis=0, weights=scan.areas[own])
        )
        arrow = np.sum((scan.areas * scan.sure)[own, None] * scan.normals[own], axis=0)
        np.testing.assert_allclose(mean.normals[k], arrow / np.linalg.norm(arrow))
        assert mean.areas[k] == pytest.approx(area) and mean.sure[k] == pytest.approx(
            np.linalg.norm(arrow) / area
        )
        assert heights[k] == pytest.approx(np.average(levels[own], weights=scan.areas[own]))


def test_cells_grow_until_they_are_few_enough(monkeypatch):
    """By a quarter more than needed while they are over twice too many, then by a tenth."""
    points, widths, counts = np.random.default_rng(2).normal(size=(50, 3)), [], iter([121, 101, 100, 51, 50])

    def cells(given, normals, width):
        widths.append(width)
        return next(counts), np.arange(50)

    monkeypatch.setattr(_scan, "_cells", cells)
    monkeypatch.setattr(_scan, "_LARGEST", 50)
    scan, numbers = _scan.thinned_scan(points, np.tile([0.0, 0.0, 1.0], (50, 1)), 0.1)
    factors = [1.0, 1.25 * np.sqrt(121 / 50), 1.25 * np.sqrt(101 / 50), 1.1, 1.1]
    np.testing.assert_allclose(widths, 0.1 * np.cumprod(factors), rtol=1e-12)
    np.testing.assert_allclose(scan.points, points[numbers >= 0])


def lattice(monkeypatch, reach, fourth, normals=None, count=100):
    """A scan of so many cells whose neighbours are as far as told, in units of what is usual."""
    # Each point's fourth neighbour is the next one along a line, whose first steps lead aside.
    steps = np.tile([1.0, 0.0, 0.0], (count - 1, 1))
    steps[: len(fourth), 1] = np.sqrt(np.square(fourth) - 1.0)
    points = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    near = np.tile(np.arange(8), (count, 1))
    near[:, 4] = [*range(1, count), count - 2]
    areas = np.full(count, 4.0)
    areas[: len(reach)] = 4.0 * np.array(reach) ** 2
    monkeypatch.setattr(_scan, "neighbourhoods", lambda means: (near, areas))
    monkeypatch.setattr(_scan, "_cells", lambda *_: (count, np.arange(count)))
    return _scan.thinned_scan(points, normals, 0.1)


@pytest.mark.parametrize(("reach", "fourth", "apart"), [
    ([5.9], [1.0], 0), ([6.0], [1.0], 1), ([1.0], [2.9], 0), ([1.0], [3.1], 1), ([6.1, 1.0], [1.0, 3.1], 2),
])  # fmt: skip
def test_a_point_is_apart_by_its_24_neighbours_or_by_its_fourth(reach, fourth, apart, monkeypatch):
    """Six and three times as far as is usual."""
    up = np.tile([0.0, 0.0, 1.0], (100, 1))
    scan, numbers = lattice(monkeypatch, reach, fourth, up)
    assert numbers.tolist() == [-1] * apart + list(range(100 - apart)) and len(scan.points) == 100 - apart
    assert scan.spacing == 2.0 and scan.sure.tolist() == [1.0] * (100 - apart)


@pytest.mark.parametrize("count", [5, 6])
def test_a_twentieth_of_the_points_may_lie_apart(count, monkeypatch):
    up = np.tile([0.0, 0.0, 1.0], (100, 1))
    with refused(f"one connected surface, but {count} of 100 were apart", count > 5):
        assert len(lattice(monkeypatch, [9.0] * count, [1.0], up)[0].points) == 95


def test_normals_of_thinned_points_are_those_joined(monkeypatch):
    """Where there are none given, what a tree does not join is apart."""
    directions, joined = np.tile([0.0, 1.0, 0.0], (100, 1)), np.arange(100) != 7
    asked = []

    def parted(means, near, areas):
        asked.append((means, near, areas))
        return directions, joined, np.linspace(0.0, 1.0, 100)

    monkeypatch.setattr(_scan, "parted_normals", parted)
    scan, numbers = lattice(monkeypatch, [1.0], [1.0])
    assert numbers.tolist() == [*range(7), -1, *range(7, 99)] and len(scan.points) == 99
    np.testing.assert_array_equal(scan.normals, directions[joined])
    np.testing.assert_array_equal(scan.sure, np.linspace(0.0, 1.0, 100)[joined])
    assert asked[0][1].shape == (100, 8)


def test_cells_count_by_what_they_hold():
    """A cell's area: its share of what its neighbours hold together, of all their areas."""
    rng = np.random.default_rng(3)
    x = np.arange(12.0)
    plane = np.stack(np.meshgrid(x, x, [0.0]), axis=-1).reshape(-1, 3) + 0.25
    many = rng.integers(1, 5, len(plane))
    cloud = np.repeat(plane, many, axis=0)
    scan, numbers = _scan.thinned_scan(cloud, np.tile([0.0, 0.0, 1.0], (len(cloud), 1)), 0.5)
    assert len(scan.points) == 144 and numbers.min() == 0
    held = np.bincount(numbers)
    away = np.linalg.norm(scan.points[:, None] - scan.points, axis=2)
    near, areas = _scan.neighbourhoods(scan.points)
    for k in range(0, 144, 5):
        wanted = held[k] * areas[near[k]].sum() / held[near[k]].sum()
        assert scan.areas[k] == pytest.approx(wanted, rel=1e-12)
    np.testing.assert_allclose(
        scan.spacing, np.median(np.sqrt(np.pi * np.sort(away, axis=1)[:, 23] ** 2 / 23))
    )


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_triangles_without_area_have_no_samples(size):
    ends = size * np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.02, 0], [0, 0, 0.03], [0.005, 0, 1e-16]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3], [0, 1, 4]])
    points, _ = _scan.sampled_mesh(ends, faces, 0.02 * size)
    fewer, normals = _scan.sampled_mesh(ends, faces[:4], 0.02 * size)
    np.testing.assert_array_equal(points, fewer)
    assert normals is not None and len(points) > 4


def test_a_mesh_inside_out_is_turned_wherever_it_lies():
    ends = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.02, 0], [0, 0, 0.03]]) + (0.5, -0.7, 0.9)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    for given in (faces, faces[:, ::-1]):
        points, normals = _scan.sampled_mesh(ends, given, 0.02)
        assert np.sum((points - ends.mean(axis=0)) * normals, axis=1).min() > 0.0


@pytest.mark.parametrize(("double", "alike"), [(3, True), (4, False)])
def test_a_fiftieth_of_a_meshs_edges_may_be_run_along_twice(double, alike):
    """Of fifty triangles, which have 150 edges."""
    faces = np.arange(150).reshape(50, 3)
    for k in range(double):
        faces[2 * k + 1, :2] = faces[2 * k, :2]
    assert _scan._alike(faces) == alike


@pytest.mark.parametrize(("faces", "fair"), [
    ([[0, 1, 5]], True), ([[0, 1, 6]], False), ([[-1, 1, 2]], False), ([[0.0, 1.0, 2.0]], False),
    ([[0, 1]], False), ([0, 1, 2], False), (np.zeros((0, 3), int), False), ([[0, 1, 2], [1, 2]], False),
    ("abc", False),
])  # fmt: skip
def test_faces_are_numbers_of_vertices(faces, fair):
    with refused(r"faces must be whole numbers of shape \(any, 3\) from 0 to 5", not fair):
        assert _results.as_faces(faces, 6).tolist() == [[0, 1, 5]]


@pytest.mark.parametrize("parts", [1, 2, 5])
def test_middles_of_the_parts_of_a_triangle(parts):
    """Each a third of the way between corners of a finer net; evenly over the whole."""
    middles = _scan._middles(parts)
    assert middles.shape == (parts**2, 3) and len(np.unique(np.round(middles, 9), axis=0)) == parts**2
    np.testing.assert_allclose(middles.sum(axis=1), 1.0)
    np.testing.assert_allclose(middles.mean(axis=0), 1.0 / 3.0)
    thirds = 3.0 * parts * middles
    np.testing.assert_allclose(thirds, np.round(thirds), atol=1e-9)
    assert np.all(np.round(thirds) % 3 != 0) and middles.min() > 0.0


# Rolled balls.


@pytest.mark.parametrize(("share", "thin"), [(0.97, True), (0.99, False)])
@pytest.mark.parametrize("turned", [0.0, 1.0])
def test_a_part_is_thin_that_is_two_hundredths_thinner_than_the_balls(share, thin, turned):
    radius, x = 0.005, np.arange(-0.01, 0.0101, 0.001)
    u, v = (grid.ravel() for grid in np.meshgrid(x, x))
    points = np.concatenate([np.stack([u, v, side * share * radius + 0.0 * u], axis=1) for side in (1, -1)])
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], len(u), axis=0)
    chosen = np.arange(len(points)) % 3 > 0
    middles, found = _rolling._cores(points + turned, normals, chosen, radius)
    np.testing.assert_array_equal(found, chosen if thin else np.zeros(len(points), bool))
    np.testing.assert_allclose(middles, points[chosen & thin] * (1.0, 1.0, 0.0) + turned, atol=1e-12)


@pytest.mark.parametrize(("thickness", "cores"), [(0.51, True), (0.49, False)])
def test_a_part_thinner_than_half_the_balls_is_not_thickened(thickness, cores):
    radius = 0.005
    points = np.array([[0.0, 0.0, thickness * radius], [0.0, 0.0, -thickness * radius]])
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    middles, thin = _rolling._cores(points, normals, np.ones(2, bool), radius)
    assert thin.all() and len(middles) == (2 if cores else 0)


@pytest.mark.parametrize(("degrees", "thin"), [(134.0, False), (135.0, True)])
def test_opposite_sides_face_away_from_each_other(degrees, thin):
    """By a cosine of -0.7, which 134.4 degrees have: in an edge balls touch at both sides too."""
    turn = np.radians(degrees)
    normals = np.array([[0.0, 0.0, 1.0], [np.sin(turn), 0.0, np.cos(turn)]])
    points = np.array([[0.0, 0.0, 0.003], [0.0, 0.0, -0.003]])
    _, found = _rolling._cores(points, normals, np.array([True, False]), 0.005)
    assert found.tolist() == [thin, False]


def test_balls_shrink_to_the_nearest_point_within_them():
    """Step by step: each time to the point nearest to the middle."""
    rng = np.random.default_rng(4)
    points = rng.uniform(-1.0, 1.0, (400, 3)) * (1.0, 1.0, 0.3)
    points[0] = (0.0, 0.0, 0.35)
    normals = np.tile([0.0, 0.0, -1.0], (400, 1))
    normals[0] = (0.0, 0.0, 1.0)
    middles, thin = _rolling._cores(points, normals, np.arange(400) == 0, 0.5)
    # The largest ball below the first point that holds no other.
    best = 0.5
    for p in points[1:]:
        arm = points[0] - p
        if arm[2] > 0.0:
            best = min(best, arm @ arm / (2.0 * arm[2]))
    assert best < 0.4 and thin[0]
    if best > 0.25:
        np.testing.assert_allclose(middles, [[0.0, 0.0, 0.35 - best]], atol=2e-3)
    else:
        assert len(middles) == 0


@pytest.mark.parametrize("count", [4, 40])
def test_points_are_drawn_onto_the_nearest_ball(count):
    """Unless they are within two tolerances of it; then the normal is away from the mean of six middles."""
    rng = np.random.default_rng(5)
    middles, radius, tolerance = rng.normal(size=(count, 3)), 1.0, 0.01
    ways = rng.normal(size=(30, 3))
    points = middles.mean(axis=0) + 4.0 * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    normals = np.tile([1.0, 0.0, 0.0], (30, 1))
    for k, off in enumerate((0.019, 0.021, -0.019, -0.021)):
        far = middles[np.argmax(middles[:, 0])]
        points[k] = far + (1.0 + off) * np.array([1.0, 0.0, 0.0])
        points[k, 1:] = far[1:]
    place, found = _rolling._drawn(points, normals, middles, radius, tolerance)
    for k, p in enumerate(points):
        order = np.argsort(np.linalg.norm(middles - p, axis=1))
        arm = p - middles[order[0]]
        length = np.linalg.norm(arm)
        if abs(length - radius) > 2.0 * tolerance:
            np.testing.assert_allclose(
                place[k], middles[order[0]] + radius * arm / length, rtol=1e-12, atol=1e-12
            )
            mean = p - middles[order[:6]].mean(axis=0)
            np.testing.assert_allclose(found[k], mean / np.linalg.norm(mean), rtol=1e-9, atol=1e-12)
        else:
            assert k in (0, 2)
            np.testing.assert_array_equal(place[k], p)
            np.testing.assert_array_equal(found[k], normals[k])


@pytest.mark.parametrize(("sure", "fits"), [(0.3, False), (0.31, True)])
def test_balls_have_their_places_where_normals_are_sure(sure, fits):
    """A single point's ball fits in it; the outer one is as far from it as both radii."""
    points, normals = (
        np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]),
        np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]),
    )
    scan = Scan(points, normals, np.ones(2), np.full(2, sure), 0.1)
    found = _rolling.rolled(scan, 0.9, 0.01)
    assert (found is not None) == fits
    if fits:
        assert found.free.all() and not found.thin.any()
        np.testing.assert_array_equal(found.points, points)
        np.testing.assert_array_equal(found.normals, normals)


@pytest.mark.parametrize(("radius", "fits"), [(1.009, True), (1.011, False)])
def test_points_may_reach_into_a_ball_by_the_tolerance(radius, fits):
    """Two plates at a distance of two: a ball between them of a radius 0.01 larger fits nearly."""
    x = np.linspace(-2.0, 2.0, 9)
    u, v = (grid.ravel() for grid in np.meshgrid(x, x))
    points = np.concatenate([np.stack([u, v, side + 0.0 * u], axis=1) for side in (1.0, -1.0)])
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], len(u), axis=0)
    scan = Scan(points, normals, np.ones(len(points)), np.ones(len(points)), 0.5)
    # A ball that touches one plate is 2 - r from the other, which must be no less than r less the tolerance.
    found = _rolling.rolled(scan, radius, 2.0 * (1.01 - 1.0))
    assert (found is not None and bool(found.free.all())) == fits


def test_thin_parts_are_seen_where_normals_are_sure():
    """A thick part, two plates at a distance of two, and beside it a thin one of 0.8."""
    x = np.linspace(-2.0, 2.0, 9)
    u, v = (grid.ravel() for grid in np.meshgrid(x, x))
    parts = [(0.0, 1.0, 1.0), (0.0, -1.0, -1.0), (10.0, 0.4, 1.0), (10.0, -0.4, -1.0)]
    points = np.concatenate(
        [np.stack([u + along, v, height + 0.0 * u], axis=1) for along, height, _ in parts]
    )
    normals = np.repeat([[0.0, 0.0, up] for *_, up in parts], len(u), axis=0)
    sure = np.where(np.arange(len(points)) % 3 == 0, 0.3, 1.0)
    found = _rolling.rolled(Scan(points, normals, np.ones(len(points)), sure, 0.5), 0.9, 0.01)
    np.testing.assert_array_equal(found.thin, (points[:, 0] > 5.0) & (sure > 0.3))


# Rounds of a fit.


def scan_of(points, **changes):
    count = len(points)
    found = {
        "normals": np.tile([0.0, 0.0, 1.0], (count, 1)),
        "areas": np.ones(count),
        "sure": np.ones(count),
        "spacing": 0.1,
    }
    return Scan(np.asarray(points, float), **(found | changes))


def test_levels_are_means_over_the_points_that_a_point_stands_for(monkeypatch):
    """Where it stands for none, its own."""
    monkeypatch.setattr(_scan_fit, "levels_at", lambda _, places: places[:, 0])
    whole = scan_of([[10.0, 0, 0], [20.0, 0, 0], [30.0, 0, 0]])
    points = np.array([[1.0, 0, 0], [2.0, 0, 0], [4.0, 0, 0], [100.0, 0, 0]])
    found = _scan_fit._levels(None, whole, points, np.array([2, 0, 2, -1]))
    assert found.tolist() == [2.0, 20.0, 2.5]


class Flat:
    """A body below z = 0, whose indicator is z but at places told."""

    def __init__(self, step):
        self.step = step

    def at(self, points):
        np.testing.assert_allclose(np.abs(points[:, 2]), self.step)  # one step to either side
        return points[:, 2]


@pytest.mark.parametrize(("radius", "spacing", "step"), [(4.0, 1.2, 1.0), (4.0, 1.6, 1.2)])
def test_a_bodys_step_is_a_quarter_radius_or_three_quarters_of_the_spacing(
    radius, spacing, step, monkeypatch
):
    asked = []
    monkeypatch.setattr(_scan_fit, "enclosed", lambda scan, step: asked.append((scan, step)) or Flat(step))
    normals = np.array([[0.0, 0.0, 1.0]] * 3 + [[0.0, 0.0, -1.0]] * 2)
    scan = scan_of(np.zeros((5, 3)), normals=normals, spacing=spacing, sure=np.arange(1.0, 6.0))
    body, found = _scan_fit._body(scan, radius, given=True)
    assert body.step == pytest.approx(step) and len(asked) == 1
    np.testing.assert_array_equal(found.normals, normals)
    assert found.sure.tolist() == [1.0, 2.0, 3.0, 0.0, 0.0]
    # Normals that were not given are turned round; then none contradicts the body.
    body, found = _scan_fit._body(scan, radius, given=False)
    np.testing.assert_array_equal(found.normals, np.tile([0.0, 0.0, 1.0], (5, 1)))
    assert found.sure.tolist() == scan.sure.tolist() and len(asked) == 3


def test_normals_are_turned_round_four_times_at_most(monkeypatch):
    asked = []

    def enclosed(scan, step):
        asked.append(scan.normals[:, 2].copy())
        # A body that always contradicts the first two of a thousand and more.
        body = Flat(step)
        body.at = lambda points, z=scan.normals[:, 2]: np.where(
            np.arange(len(points)) < few, -z * points[:, 2], points[:, 2] * z
        )
        return body

    monkeypatch.setattr(_scan_fit, "enclosed", enclosed)
    for few, rounds in ((2, 4), (1, 1)):
        asked.clear()
        count = 2000
        _, found = _scan_fit._body(scan_of(np.zeros((count, 3))), 1.0, given=False)
        assert len(asked) == rounds and (found.sure == 0.0).sum() == few


def test_a_scan_is_rolled_to_a_fiftieth_of_the_radius(monkeypatch):
    asked = []
    monkeypatch.setattr(_scan_fit, "rolled", lambda *args: asked.append(args) or "rolled")
    assert _scan_fit._rolled("scan", 0.5) == "rolled" and asked == [("scan", 0.5, 0.01)]
    monkeypatch.setattr(_scan_fit, "rolled", lambda *args: None)
    with refused("but of 0.5 m none fits"):
        _scan_fit._rolled("scan", 0.5)


@pytest.mark.parametrize("count", [3000, 30_000])
@pytest.mark.parametrize("based", [True, False])
def test_what_a_field_is_fitted_to(count, based, monkeypatch):
    """Data by cells, 2.5 to one of the grid along an axis or more of small scans; and distances, loosely."""
    rng, wavelength, seen = np.random.default_rng(6), 0.5, {}
    scan = scan_of(
        rng.uniform(0.0, 1.0, (count, 3)), sure=rng.uniform(size=count), areas=rng.uniform(1.0, 2.0, count)
    )
    grid, step = Grid(np.array([0.1, 0.2, 0.3]), 0.2, (11, 10, 9)), 0.2
    held, distances = rng.normal(size=(5, 3)), rng.normal(size=5)
    data = scan_of(rng.normal(size=(7, 3)), sure=rng.uniform(size=7), areas=rng.uniform(1.0, 2.0, 7))
    means = rng.normal(size=7)

    def averaged(self, width, levels):
        seen.update(width=width, levels=levels)
        return data, means

    def solved(*args):
        seen["solved"] = args
        return np.ones(grid.counts)

    monkeypatch.setattr(Scan, "averaged", averaged)
    monkeypatch.setattr(
        _scan_fit, "_grid", lambda points, step: seen.update(around=points, step=step) or grid
    )
    monkeypatch.setattr(_scan_fit, "_distances", lambda *_: (held, distances))
    monkeypatch.setattr(_scan_fit, "solved", solved)
    monkeypatch.setattr(_scan_fit, "levels_at", lambda surface, places: 3.0 * places[:, 0])
    whole: Any = types.SimpleNamespace(points="whole")
    levels = rng.normal(size=count)
    start = types.SimpleNamespace(coefficients=np.full(grid.counts, 2.0))
    surface = _scan_fit._Problem(whole, 0, "body").fitted(
        scan, wavelength, (start, levels) if based else None
    )
    assert seen["width"] == pytest.approx(step / 2.5 * min(1.0, count / 12_000), rel=1e-12)
    np.testing.assert_array_equal(seen["levels"], levels if based else np.zeros(count))
    assert (seen["around"], seen["step"]) == ("whole", pytest.approx(0.2))
    given, targets, rough, first = seen["solved"]
    waves = 2.5 / (2.0 * np.pi)
    assert given is grid and rough == pytest.approx(3.0 / 16.0 * waves**5, rel=1e-12)
    np.testing.assert_array_equal(first, np.full(grid.counts, 2.0 if based else 0.0))
    np.testing.assert_array_equal(targets.points, [*data.points, *held])
    heights = 3.0 * data.points[:, 0] - means if based else np.zeros(7)
    np.testing.assert_allclose(targets.heights, [*heights, *distances], atol=1e-15)
    np.testing.assert_allclose(targets.weights, [*data.areas, *[1e-4 * 0.2**2] * 5], rtol=1e-12)
    np.testing.assert_array_equal(targets.normals, [*data.normals, *np.zeros((5, 3))])
    np.testing.assert_allclose(
        targets.slopes, [*(0.005 * waves**2 * data.areas * data.sure), *[0.0] * 5], rtol=1e-12
    )
    assert targets.length == 0.3 and surface.coefficients.shape == grid.counts and float(surface.step) == 0.2
    np.testing.assert_array_equal(surface.origin, grid.origin)


def test_a_score_is_the_error_at_the_points_not_used(monkeypatch):
    """By area; points that fill holes are always used, and never counted."""
    used = []
    whole = scan_of(np.arange(1.0, 14.0)[:, None] * [1.0, 0.0, 0.0], areas=np.arange(1.0, 14.0) ** 2)
    monkeypatch.setattr(
        _scan_fit._Problem, "fitted", lambda self, scan, wavelength: used.append((scan, wavelength))
    )
    monkeypatch.setattr(_scan_fit, "levels_at", lambda _, places: 0.5 * places[:, 0])
    score = _scan_fit._score(_scan_fit._Problem(whole, 3, None), 0.7)
    (scan, wavelength), left = used[0], set(range(1, 11))
    numbers = [int(x) for x in scan.points[:, 0]]
    assert wavelength == 0.7 and numbers[-3:] == [11, 12, 13] and len(numbers) == 8
    assert numbers[:5] != sorted(numbers[:5])  # by lot
    left -= set(numbers)
    assert score == pytest.approx(sum(k**2 * (0.5 * k) ** 2 for k in left), rel=1e-12)


def test_extremes_are_looked_for_between_the_vertices(monkeypatch):
    """Uphill in steps of h, h / 2 ... h / 16, a sixth of a cell at first: to 1.3125 h of a hill at 1.3 h.

    Down to a valley at -0.8 h along another axis: -h, then h / 4 back, and -h / 16.
    """
    step = 0.06
    h = 0.5 * step / 3.0

    def measured(surface, places):
        places = np.asarray(places)
        hill = 50.0 - np.sum((places - np.array([1.3 * h, 0.0, 0.0])) ** 2, axis=1)
        valley = -70.0 + np.sum((places - np.array([5.0, -0.8 * h, 0.0])) ** 2, axis=1)
        other = np.sum((places - np.array([1.3 * h, 0.0, 0.0])) ** 2, axis=1) > 1.0
        return places, None, np.stack([np.where(other, valley, 0.0), np.where(other, 0.0, hill)], axis=1)

    monkeypatch.setattr(_scan_fit, "measured", measured)
    surface: Any = types.SimpleNamespace(step=step)
    feet = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.02, 0.5, 0.0], [4.5, 0.0, 0.3]])
    low, high = _scan_fit._extremes(surface, feet, measured(surface, feet)[2])
    assert high == pytest.approx(50.0 - (0.0125 * h) ** 2, abs=1e-12)
    assert low == pytest.approx(-70.0 + (0.0125 * h) ** 2, abs=1e-12)
    assert np.isnan(_scan_fit._extremes(surface, feet, np.array([[1.0, np.nan]] * 4))).all()


def test_the_256_most_extreme_vertices_are_climbed_from(monkeypatch):
    asked = []

    def measured(surface, places):
        asked.append(np.asarray(places))
        return np.asarray(places), None, np.zeros((len(places), 2))

    monkeypatch.setattr(_scan_fit, "measured", measured)
    rng = np.random.default_rng(7)
    feet, bends = rng.normal(size=(600, 3)), np.sort(rng.normal(size=(600, 2)), axis=1)
    low, high = _scan_fit._extremes(types.SimpleNamespace(step=0.6), feet, 100.0 * bends + [-500.0, 500.0])
    assert low == 100.0 * bends[:, 0].min() - 500.0 and high == 100.0 * bends[:, 1].max() + 500.0
    assert len(asked) == 5
    places = asked[0].reshape(512, 6, 3).mean(axis=1)
    np.testing.assert_allclose(places[:256], feet[np.argsort(bends[:, 0])[:256]], atol=1e-12)
    np.testing.assert_allclose(places[256:], feet[np.argsort(-bends[:, 1])[:256]], atol=1e-12)
    for k, tried in enumerate(asked):
        away = np.linalg.norm(tried.reshape(512, 6, 3) - places[:, None], axis=2)
        np.testing.assert_allclose(away, 0.1 * 0.5**k, rtol=1e-9)


class Rounds:
    """A fit whose surfaces are as sharp as told, one after the other; all else is noted."""

    def __init__(
        self, monkeypatch, sharp, *, radius=1.0, finer=None, off=(), count=100, size=40.0, body_step=0.2,
        spacing=0.3,
    ):  # fmt: skip
        self.said: list[tuple[Any, ...]] = []
        points = np.zeros((count, 3))
        points[:] = (0.0, 3.0, -70.0)
        points[:, 0] = np.linspace(0.0, size, count)
        self.points = points
        self.scan = scan_of(points, spacing=spacing)
        self.sharpest_of = {}
        self.body = types.SimpleNamespace(vertices=points + [0.0, 0.0, 0.0], step=body_step)
        shifted = points.copy()
        for k, distance in off:
            shifted[k, 2] += distance
        sharpest = iter(sharp)

        def noted(name, answer):
            def call(*args, **options):
                self.said.append((name, args, options))
                return answer(*args, **options) if callable(answer) else answer

            return call

        def looked(surface):
            self.sharpest_of[surface] = next(sharpest)
            return types.SimpleNamespace(
                sharpest=self.sharpest_of[surface] / radius,
                vertices=surface,
                areas="areas",
                curvatures="bends",
                parts=(1, 1),
            )

        first = replace(self.scan, points=shifted)
        names = {
            "thinned_scan": lambda *_: (first, np.arange(count)),
            "_body": lambda scan, radius, *, given: (self.body, scan),
            "_filled": lambda scan, body, reach: (scan, 4),
            "_chosen": 7.0,
            "_finer": finer,
            "_looked_at": looked,
            "_levels": "levels",
            "_rolled": lambda whole, radius: types.SimpleNamespace(
                points=2.0 * whole.points, normals=-whole.normals
            ),
        }
        for name, answer in names.items():
            monkeypatch.setattr(_scan_fit, name, noted(name, answer))
        self.numbers = itertools.count(1)

        def fitted(problem, scan, wavelength, base=None):
            self.said.append(("fitted", (scan, wavelength, base), {}))
            return next(self.numbers)

        monkeypatch.setattr(_scan_fit._Problem, "fitted", fitted)
        monkeypatch.setattr(
            Scan, "joined", lambda scan, reach: self.said.append(("joined", (reach,), {})) or scan
        )
        self.found = _scan_fit.closed_through(points, None, radius)

    def args(self, name):
        return [args for said, args, _ in self.said if said == name]


def test_a_scan_smooth_enough_is_fitted_twice(monkeypatch):
    """To its means, and to the levels of its points; at the wavelength chosen."""
    told = Rounds(monkeypatch, [1.0], radius=2.0)
    assert [args[1:] for args in told.args("fitted")] == [(7.0, None), (7.0, (1, "levels"))]
    assert told.args("joined") == [(1.0,)] and len(told.args("_body")) == 1
    assert told.args("thinned_scan")[0][2] == 0.5
    assert told.args("_filled")[0][2] == 1.0 and told.args("_rolled")[0][1] == 2.0
    found = told.found
    assert (found.surface, found.wavelength, found.filled, found.reach) == (2, 7.0, 4, 1.0)
    assert (found.vertices, found.areas, found.curvatures, found.parts) == (2, "areas", "bends", (1, 1))
    assert not found.apart.any() and found.apart.shape == (100,)
    assert found.rolled.points[99, 0] == 80.0


def test_cells_of_a_scan_are_a_quarter_radius_or_a_four_hundredth_of_the_size(monkeypatch):
    told = Rounds(monkeypatch, [1.0], radius=0.2)
    assert told.args("thinned_scan")[0][2] == pytest.approx(0.1)
    # Places within three spacings are covered.
    assert told.found.reach == pytest.approx(0.9)


@pytest.mark.parametrize(("sharp", "number"), [([0.9, 1.0], 4), ([0.9, 1.01], 2)])
def test_a_finer_fit_is_taken_if_it_is_smooth_enough(sharp, number, monkeypatch):
    told = Rounds(monkeypatch, sharp, radius=2.0, finer=5.0)
    assert told.found.surface == number and told.found.wavelength == (5.0 if number == 4 else 7.0)
    assert [args[1] for args in told.args("fitted")] == [7.0, 7.0, 5.0, 5.0]


def test_balls_grow_until_the_surface_is_smooth_enough(monkeypatch):
    """From a tenth more than the radius: by what is lacking, between 3 and 30 per cent each time."""
    monkeypatch.setattr(_scan_fit, "_misfit", lambda scan, shape: 0.0)
    told = Rounds(monkeypatch, [2.0, 1.2, 1.01, 1.5, 1.0], radius=2.0)
    balls = [args[1] for args in told.args("_rolled")[1:]]
    np.testing.assert_allclose(balls, 2.2 * np.cumprod([1.0, 1.2, 1.03, 1.3]), rtol=1e-12)
    later = told.args("fitted")[2:]
    assert [(args[1], args[2]) for args in later] == [(4.8, None)] * 4
    np.testing.assert_array_equal(later[0][0].points, 2.0 * told.points)
    np.testing.assert_array_equal(later[0][0].normals, -told.scan.normals)
    assert len(told.args("_rolled")) == 5
    assert told.found.surface == 6 and told.found.wavelength == pytest.approx(4.8)
    assert not told.args("_finer")


@pytest.mark.parametrize(
    ("spacing", "sharp", "met", "fitted", "surface"),
    [
        (0.3, [1.0], True, 3, 3),  # dense, and the scan leads to a surface
        (
            1.01,
            [1.0, 2.0, 1.0],
            True,
            5,
            5,
        ),  # points too far apart: both lead to one, that of the net is nearer
        (1.01, [1.0] + [2.0] * 6, True, 9, 3),  # the net leads to none
        (0.3, [2.0] * 6 + [1.0], True, 9, 9),  # the scan leads to none
        (0.3, [2.0] * 12, False, 14, 14),  # nothing does: the nearer one is told
    ],
)
def test_balls_roll_on_the_net_too_where_the_scan_does_not_do(
    spacing, sharp, met, fitted, surface, monkeypatch
):
    """Two fits to the scan itself; then six at most by balls on it, and six by balls on the surface's net."""
    monkeypatch.setattr(_scan_fit, "_rounded_by_net", lambda scan, shape, balls: scan)
    # The later a fit, the nearer it is.
    monkeypatch.setattr(_scan_fit, "_misfit", lambda scan, shape: -shape.vertices)
    told = Rounds(monkeypatch, [2.0, *sharp], radius=2.0, spacing=spacing)
    assert (told.found.surface, len(told.args("fitted"))) == (surface, fitted)
    assert (told.sharpest_of[told.found.surface] <= 1.0) == met


def test_a_net_that_no_ball_rolls_on_is_not_tried_further(monkeypatch):
    def refuse(*_):
        raise ValueError("none fits")

    monkeypatch.setattr(_scan_fit, "_rounded_by_net", refuse)
    monkeypatch.setattr(_scan_fit, "_misfit", lambda scan, shape: 0.0)
    assert Rounds(monkeypatch, [2.0, 1.0], radius=2.0, spacing=1.5).found.surface == 3


def test_what_bends_too_much_gives_way_to_its_surface_rolled(monkeypatch):
    """Points nearest to a free vertex stay; vertices that are not free come in, where they roll."""
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    scan = scan_of(points, spacing=0.3)
    vertices = points + [0.1, 0.0, 0.5]
    shape = _scan_fit._Shape(vertices, -points, np.array([5.0, 6.0, 7.0]), (0.0, 1.0), (1, 1))
    free = np.array([True, False, True])
    rolled = types.SimpleNamespace(points=vertices + 1.0, normals=points + 3.0, free=free)
    seen = []
    monkeypatch.setattr(_scan_fit, "_rolled", lambda net, balls: seen.append((net, balls)) or rolled)
    found = _scan_fit._rounded_by_net(scan, shape, 2.5)
    np.testing.assert_array_equal(seen[0][0].points, vertices)
    assert seen[0][1] == 2.5 and found.spacing == 0.3
    np.testing.assert_array_equal(found.points, [points[0], points[2], vertices[1] + 1.0])
    np.testing.assert_array_equal(found.normals[2], points[1] + 3.0)
    np.testing.assert_array_equal(found.areas, [*scan.areas[[0, 2]], 6.0])


def test_misfit_is_by_area():
    scan = scan_of(np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]]), spacing=0.3)
    shape = _scan_fit._Shape(np.array([[0.0, 0.0, 2.0], [3.0, 0.0, -1.0]]), None, None, None, None)
    assert _scan_fit._misfit(replace(scan, areas=np.array([3.0, 5.0])), shape) == pytest.approx(3 * 4 + 5)


@pytest.mark.parametrize(("off", "step", "radius", "apart"), [
    ([(5, 1.0), (6, 1.01)], 0.2, 2.0, [6]), ([(5, 2.49), (6, 2.51)], 1.0, 2.0, [6]),
    ([(5, 2.0), (6, 2.0)], 0.2, 2.0, [5, 6]), ([(5, 2.0), (6, 2.0), (7, 2.0)], 0.2, 2.0, []),
    ([], 0.2, 2.0, []),
])  # fmt: skip
def test_points_off_the_body_are_left_out_if_they_are_few(off, step, radius, apart, monkeypatch):
    """By half a radius and two and a half nodes; less than three of a hundred."""
    told = Rounds(monkeypatch, [1.0], radius=radius, off=off, body_step=step)
    assert np.flatnonzero(told.found.apart).tolist() == apart
    assert len(told.found.scan.points) == 100 - len(apart)
    given = [options["given"] for name, _, options in told.said if name == "_body"]
    assert given == ([False, True] if apart else [False])


@pytest.mark.parametrize(("radius", "fair"), [(20.0, True), (20.1, False)])
def test_a_ball_has_room_in_the_extent_of_a_scan(radius, fair, monkeypatch):
    with refused("room for a ball of that radius in a body of 40 m, but was 20.1 m", not fair):
        Rounds(monkeypatch, [1.0], radius=radius)


def test_a_surface_through_the_points_begins_at_that_through_their_means(monkeypatch):
    assert _scan_fit._Shape(None, None, None, (-3.0, 2.0), (1, 1)).sharpest == 3.0
    assert _scan_fit._Shape(None, None, None, (-1.0, 2.0), (1, 1)).sharpest == 2.0


# What is said of it.


def closed(**changes):
    """Ten vertices of a net in a row; a scan of eight points beside them, two of which fill holes."""
    vertices = np.arange(10.0)[:, None] * [1.0, 0.0, 0.0]
    points = np.concatenate([vertices[:6], vertices[8:]]) + [0.0, 0.3, 0.0]
    free = np.array([True, True, True, False, True, True, True, False])
    found = {
        "surface": types.SimpleNamespace(coefficients=np.zeros((9, 8, 7)), step=0.25, smoothness=4),
        "wavelength": 0.7,
        "scan": scan_of(points, sure=np.array([1.0, 0.5, 1.0, 1.0, 0.6, 1.0, 1.0, 1.0])), "filled": 2,
        "rolled": types.SimpleNamespace(free=free, thin=np.zeros(8, bool)), "vertices": vertices,
        "areas": np.arange(1.0, 11.0), "curvatures": (-0.4, 0.3), "parts": (1, 1), "reach": 1.2,
        "apart": np.array([False] * 6 + [True] * 3),
    }  # fmt: skip
    return types.SimpleNamespace(**(found | changes))


def test_a_report_of_a_scan(monkeypatch):
    """Six points, the fourth where no ball fits, the second and the fifth with normals that face inward."""
    off = np.array([0.1, 0.2, 0.2, 0.6, 0.0, 0.3])
    points = np.arange(6.0)[:, None] * [1.0, 0.0, 0.0]
    facing = np.tile([0.0, 0.0, 1.0], (6, 1))
    facing[[1, 3, 4]] *= -1.0
    monkeypatch.setattr(
        _scan_verdict, "measured", lambda *_: (points + off[:, None] * [0.0, 0.6, 0.8], facing, None)
    )
    asked = []
    monkeypatch.setattr(_scan_verdict, "_refused", lambda *args: asked.append(args))
    monkeypatch.setattr(_scan_verdict, "_regions", lambda *args: asked.append(args) or ("regions",))
    found = closed()
    report, used, feet = _scan_verdict._report(found, points, None, 2.0)
    free = np.array([0.1, 0.2, 0.2, 0.0, 0.3])
    kept = (pytest.approx(np.sqrt(np.mean(free**2))), pytest.approx(0.3))
    assert report.kept == kept and report.rounded == (pytest.approx(0.6), pytest.approx(0.6))
    assert report.rounded_share == pytest.approx(1.0 / 6.0) and report.reversed == pytest.approx(1.0 / 6.0)
    assert report.tolerance == pytest.approx(3.0 * np.sqrt(0.18 / 5.0))
    # Vertices up to the sixth place are covered, and the one beside it.
    assert report.uncovered == pytest.approx(27.0 / 55.0) and report.area == 55.0
    assert (report.points, report.rejected, report.cells, report.step) == (6, 3, (4, 3, 2), 0.25)
    assert (report.rms, report.largest) == (pytest.approx(np.sqrt(0.54 / 6.0)), pytest.approx(0.6))
    assert (report.normals, report.curvature, report.smallest_radius) == (None, (-0.4, 0.3), 2.0)
    assert (report.reach, report.regions, report.smoothing) == (1.2, ("regions",), 0.7)
    np.testing.assert_array_equal(used, points)
    np.testing.assert_allclose(np.linalg.norm(feet - points, axis=1), off)
    _, _, distances, uncovered, turned, radius = asked[0]
    np.testing.assert_allclose(distances, off)
    assert (uncovered, turned, radius) == (report.uncovered, report.reversed, 2.0)
    np.testing.assert_array_equal(asked[1][3], np.arange(10) < 7)
    assert asked[1][4] == report.tolerance
    # With normals given: the angles to them, and which of them point inward.
    normals = np.tile([0.0, 0.0, 1.0], (6, 1))
    normals[[3, 4]] *= -1.0
    other, _, _ = _scan_verdict._report(found, points, normals, 20.0)
    assert other.normals == (pytest.approx(np.pi / 6.0**0.5), pytest.approx(np.pi))
    assert other.reversed == 0.0 and other.tolerance == pytest.approx(1.2)
    none = closed(rolled=types.SimpleNamespace(free=np.zeros(8, bool), thin=np.zeros(8, bool)))
    bare, _, _ = _scan_verdict._report(none, points, None, 2.0)
    assert bare.kept is None and bare.tolerance == pytest.approx(0.12) and bare.reversed == 0.0


def test_regions_are_the_largest_without_data_or_off_them(monkeypatch):
    """Eight at most, each larger than the square of the link, which is two usual steps."""
    asked = []

    def regions(places, areas, link, reason):
        asked.append((places, areas, link, reason))
        sizes = [1.0, 17.0, 3.9, 30.0, 5.0, 6.0] if reason == "no data" else [40.0, 4.1, 7.0, 8.0, 9.0]
        return [Region((0.0, 0.0, 0.0), 1.0, 2.25 * size, reason) for size in sizes]

    monkeypatch.setattr(_scan_verdict, "regions_of", regions)
    near = np.arange(10) % 2 == 0
    monkeypatch.setattr(
        _scan_verdict, "trusted_places", lambda *args, **options: asked.append(options) or near
    )
    found = closed(areas=2.25 * np.array([0.9, 1.1, 0.1, 0.2, 7.0, 8.0, 9.0, 0.3, 0.4, 3.0]))
    covered = np.arange(10) < 7
    told = _scan_verdict._regions(found, np.zeros((6, 3)), np.zeros((6, 3)), covered, 0.25)
    assert [region.area / 2.25 for region in told] == [40.0, 30.0, 17.0, 9.0, 8.0, 7.0, 6.0, 5.0]
    assert asked[0] == {"reach": np.inf, "tolerance": 0.25}
    link = 3.0
    for (places, areas, given, reason), chosen, said in zip(
        asked[1:], (~covered, covered & ~near), ("no data", "rounded off"), strict=True
    ):
        np.testing.assert_array_equal(places, found.vertices[chosen])
        np.testing.assert_array_equal(areas, found.areas[chosen])
        assert given == pytest.approx(link) and reason == said
    monkeypatch.setattr(
        _scan_verdict,
        "regions_of",
        lambda *_: [Region((0.0,) * 3, 1.0, 2.25 * x, "no data") for x in (4.1, 4.0)],
    )
    told = _scan_verdict._regions(found, np.zeros((6, 3)), np.zeros((6, 3)), covered, 0.25)
    assert [region.area for region in told] == [2.25 * 4.1, 2.25 * 4.1]


@pytest.mark.parametrize(("samples", "between"), [(59, False), (60, True), (61, True)])
def test_a_mesh_is_looked_at_between_its_vertices_or_at_them(samples, between, monkeypatch):
    """Between them where there are twenty samples to each or more; vertices of no face do not count."""
    seen = {}
    vertices, faces = np.arange(15.0).reshape(5, 3), np.array([[0, 1, 3]])
    cloud, directions = np.zeros((samples, 3)), np.ones((samples, 3))
    cloud[:, 0] = np.arange(samples)
    apart = np.arange(samples) == 2
    whole = closed(apart=apart)

    def report(found, points, normals, radius):
        seen.update(points=points, normals=normals)
        return "report", points[:1], points[1:2]

    monkeypatch.setattr(
        _scan_verdict, "sampled_mesh", lambda *args: (seen.update(mesh=args), (cloud, directions))[1]
    )
    monkeypatch.setattr(_scan_verdict, "closed_through", lambda *args: (seen.update(through=args), whole)[1])
    monkeypatch.setattr(_scan_verdict, "_report", report)
    _scan_verdict.fit_scan(vertices, None, faces, 0.8)
    assert seen["mesh"] == (vertices, faces, pytest.approx(0.2))
    assert seen["through"] == (cloud, directions, 0.8) and seen["normals"] is None
    np.testing.assert_array_equal(seen["points"], cloud[~apart] if between else vertices[[0, 1, 3]])
    # A cloud as it is, without what lies apart.
    normals = cloud + 1.0
    fit = _scan_verdict.fit_scan(cloud, normals, None, 0.8)
    assert seen["through"] == (cloud, normals, 0.8)
    np.testing.assert_array_equal(seen["points"], cloud[~apart])
    np.testing.assert_array_equal(seen["normals"], normals[~apart])
    assert fit.surface is whole.surface and fit.report == "report"
    assert (fit.points.tolist(), fit.feet.tolist()) == ([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]])


@pytest.mark.parametrize(("length", "fair"), [(103.9, True), (104.1, False)])
def test_a_grid_has_a_million_and_a_half_coefficients_at_most(length, fair):
    """114^3 are fewer, of 109 cells along each axis: five of them are room. 115^3 are more."""
    points = np.array([[0.0, 0.0, 0.0], [length, length, length]]) + (1.0, -2.0, 300.0)
    with refused(f"for a body of {length:.3g} m: it asks for 110 x 110 x 110 cells", not fair):
        assert _scan_fit._grid(points, 1.0).counts == (114, 114, 114)


def test_the_whole_zero_set_is_looked_at_on_a_net(monkeypatch):
    """Two regions below zero, three above; areas are those of the net between the feet."""
    values = np.array([-1.0, 2.0, 0.0, 3.0, 0.0, -1.0, -2.0, 0.0, 1.0])[:, None, None] * np.ones((1, 2, 2))
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [5.0, 5.0, 5.0]])
    triangles, asked = np.array([[0, 1, 2]]), []
    monkeypatch.setattr(_scan_fit, "surface_values", lambda surface, n: (asked.append(n), values)[1])
    monkeypatch.setattr(
        _scan_fit, "surface_net", lambda surface, n: (asked.append(n), (vertices, triangles))[1]
    )
    monkeypatch.setattr(_scan_fit, "measured", lambda surface, at: (2.0 * np.asarray(at), None, "bends"))
    monkeypatch.setattr(_scan_fit, "_extremes", lambda *args: (asked.append(args), (-3.0, 2.0))[1])
    shape = _scan_fit._looked_at("surface")
    assert asked[:2] == [3, 3] and shape.parts == (2, 3) and shape.curvatures == (-3.0, 2.0)
    np.testing.assert_array_equal(shape.vertices, 2.0 * vertices)
    np.testing.assert_allclose(shape.areas, [2.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0, 0.0])
    assert asked[2][0] == "surface" and asked[2][2] == "bends"
    monkeypatch.setattr(_scan_fit, "surface_net", lambda *_: (vertices, triangles[:0]))
    with refused("determine a closed surface, but the fit to them has none"):
        _scan_fit._looked_at("surface")
