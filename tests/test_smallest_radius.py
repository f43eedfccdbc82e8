"""Contours with a smallest radius of curvature, from points as they come: noisy, scattered, with corners."""

import pathlib
import time
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree

import jaxroll as jxr
from jaxroll.geometry import tabled
from jaxroll.geometry.fitting._band import Band, found_band
from jaxroll.geometry.fitting._bounded_curve import bounded_curve
from jaxroll.geometry.fitting._departures import jumps, natural_radius, strays
from jaxroll.geometry.fitting._even_spline import displacements, EvenSpline, low_passed
from jaxroll.geometry.fitting._limited_fit import _turned, Wanted

DATA = pathlib.Path(__file__).parents[2] / "shared" / "data"
# Sizes and radii below ask for 256 nodes of most closed contours, and for 96 of open ones: one program each.
N = 300
U = 2 * np.pi * np.arange(N) / N
A, B = 0.03, 0.02
ELLIPSE = np.stack([A * np.cos(U), B * np.sin(U)], axis=1)  # radii of curvature of 13.3 mm and more


def noisy(points, noise, seed=0):
    return points + noise * np.random.default_rng(seed).normal(size=points.shape)


def scattered(points, seed=1):
    return np.random.default_rng(seed).permutation(points)


def everywhere(fit, count=6000):
    """Points and curvatures of a fitted contour, of the latter also by differences of its tangent."""
    s = np.linspace(0.0, fit.report.length, count)
    frames = tabled(fit.contour).frame(s)
    angle = np.unwrap(np.arctan2(frames.tangent.y, frames.tangent.x))
    return np.stack([frames.point.x, frames.point.y], 1), frames.curvature, np.diff(angle) / np.diff(s)


def off_polygon(points, corners, closed=True):
    """Distances of points from a polygon."""
    starts = corners if closed else corners[:-1]
    sides = np.roll(corners, -1, axis=0) - corners if closed else np.diff(corners, axis=0)
    away = points[:, None] - starts
    share = np.clip((away * sides).sum(-1) / (sides**2).sum(-1), 0.0, 1.0)
    return np.linalg.norm(away - share[..., None] * sides, axis=-1).min(axis=1)


def filled(corners, step, closed=True):
    """Points along a polygon, its corners among them."""
    ends = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    parts = [
        a
        + np.linspace(0.0, 1.0, max(1, round(np.linalg.norm(b - a) / step)), endpoint=False)[:, None]
        * (b - a)
        for a, b in (ends if closed else list(ends)[:-1])
    ]
    return np.concatenate(parts if closed else [*parts, corners[-1:]])


def check_bound(fit, radius):
    """Nowhere above the bound, by the contour's own curvature and by differences of its tangent."""
    _, own, turned = everywhere(fit)
    assert np.abs(own).max() <= (1.0 + 1e-9) / radius
    assert np.abs(turned).max() <= 1.001 / radius
    assert fit.report.radius >= radius * (1.0 - 1e-9)


@pytest.mark.parametrize("order", ["in order", "clockwise", "scattered"])
def test_noise_is_left_out_and_its_size_found(order):
    """An ellipse with noise of 0.2 mm, its points 0.5 mm apart, where every bend is allowed."""
    points = noisy(ELLIPSE, 2e-4)
    points = {"in order": points, "clockwise": points[::-1], "scattered": scattered(points)}[order]
    fit = jxr.fit_contour(points, smallest_radius=4e-3)
    check_bound(fit, 4e-3)
    off = KDTree(everywhere(fit)[0]).query(ELLIPSE)[0]
    report = fit.report
    assert off.max() < 2.0 * 2e-4 and np.sqrt(np.mean(off**2)) < 0.7 * 2e-4
    assert report.noise == pytest.approx(2e-4, rel=0.2) and report.inflections == 0
    assert report.rounded == () and report.rejected == () and report.recommendation == ""
    assert (report.reordered, report.reversed) == (order == "scattered", order == "clockwise")
    assert report.points == N and report.smallest_radius == 4e-3


def test_strays_are_named_and_left_out():
    points = noisy(ELLIPSE, 2e-4)
    far = [20, 100, 101, 220]
    points[far] += [[0.01, 0.0], [0.0, 0.008], [0.0, 0.008], [-0.02, 0.03]]
    for given in (points, scattered(points)):
        fit = jxr.fit_contour(given, smallest_radius=4e-3)
        assert sorted(fit.report.rejected) == sorted(map(tuple, points[far].tolist()))
        assert fit.report.points == N - 4 and "4 rejected" in str(fit.report)
        assert KDTree(everywhere(fit)[0]).query(ELLIPSE)[0].max() < 2.0 * 2e-4


@pytest.mark.parametrize(
    ("off", "bending", "noise", "found"),
    [
        ({7: 7e-5}, {}, 1e-5, [7]),
        ({7: 5e-5}, {}, 1e-5, []),  # below six times the noise
        ({0: -7e-5, 8: 7e-5, 9: -7e-5}, {}, 1e-5, [0, 8, 9]),  # either way, on its own or two together
        ({7: 7e-5, 8: 7e-5, 9: 7e-5}, {}, 1e-5, []),  # three together are shape
        ({5: 1.5e-5, 6: 1.5e-5, 7: 7e-5, 8: 1.5e-5, 9: 1.5e-5}, {}, 1e-5, [7]),
        ({5: 2.5e-5, 6: 2.5e-5, 7: 7e-5, 8: 2.5e-5, 9: 2.5e-5}, {}, 1e-5, []),  # all there are off
        ({7: 7e-5, 12: 7e-5}, {7: -0.95, 12: -0.85}, 1e-5, [12]),  # the curve cannot bend more
        ({7: 7e-5, 12: 4e-5}, {}, 0.0, [7, 12]),  # half a hundredth of the radius is the least noise
        ({7: 7e-5, 12: 2.5e-5}, {}, 0.0, [7]),
    ],
)
def test_a_stray_lies_off_where_its_neighbours_do_not(off, bending, noise, found):
    """Whatever order the points come in: neighbours are those along the curve."""
    distances, bends = np.zeros(20), np.zeros(20)
    distances[list(off)] = list(off.values())
    bends[list(bending)] = list(bending.values())
    order = np.random.default_rng(3).permutation(20)
    rows = strays(order.astype(float), distances[order], bends[order], noise=noise, radius=1e-3)
    assert rows.tolist() == sorted(rows.tolist()) and sorted(order[rows].tolist()) == found


def test_hooks_at_both_ends_of_an_open_line_are_two_places():
    """Each is nearer to its end than the radius; of a closed contour they would be one, past s = 0."""
    up, along = np.linspace(3.0, 0.0, 15, endpoint=False), np.linspace(0.0, 60.0, 301)
    left = np.stack([0.0 * up, up], axis=1)
    points = np.concatenate([left, np.stack([along, 0.0 * along], axis=1), [60.0, 0.0] + left[::-1]])
    fit = jxr.fit_contour(points, unit="mm", closed=False, ordered=True, smallest_radius=5e-3)
    first, last = fit.report.rounded
    assert 0.0 <= first.start < first.end < 0.01 and 0.05 < last.start < last.end


@pytest.mark.parametrize("count", [4, 6])
def test_corners_are_rounded_and_the_sides_left_alone(count):
    """Of a regular polygon with noise of 0.1 mm: off its corners it is met within two of it.

    The arc of radius R in a corner with the turning angle t begins R tan(t/2) from it and misses it by
    R (1 / cos(t/2) - 1).
    """
    angles, half = 2 * np.pi * np.arange(count) / count, np.pi / count
    corners = 0.033 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    radius, noise = 4e-3, 1e-4
    fit = jxr.fit_contour(noisy(filled(corners, 3e-4), noise), smallest_radius=radius)
    check_bound(fit, radius)
    points = everywhere(fit)[0]
    away = np.linalg.norm(points[:, None] - corners, axis=-1)
    flat = np.all(away > 1.5 * radius * np.tan(half), axis=1)
    assert off_polygon(points, corners)[flat].max() < 2.0 * noise
    np.testing.assert_allclose(
        away.min(axis=0), radius * (1.0 / np.cos(half) - 1.0), atol=4 * noise, rtol=0.1
    )
    found = fit.report.rounded
    assert len(found) == count
    for stretch in found:
        assert np.linalg.norm(corners - stretch.place, axis=1).min() < 2e-3
    words = " ".join(fit.report.warnings)
    assert "bend more sharply than the smallest radius" in words and "keep it" in fit.report.recommendation


def test_concave_parts_are_bounded_too():
    """A block with a slot of 4 mm, narrower than an inner radius of 3 mm has room for."""
    corners = 1e-3 * np.array(
        [(0, 0), (40, 0), (40, 20), (22, 20), (22, 5), (18, 5), (18, 20), (0, 20)], float
    )
    fit = jxr.fit_contour(noisy(filled(corners, 2e-4), 3e-5), smallest_radius=3e-3)
    check_bound(fit, 3e-3)
    low, high = fit.report.curvature
    assert low < -200.0 and high > 200.0 and not fit.report.self_intersecting
    worst = max(fit.report.rounded, key=lambda stretch: stretch.distance)
    assert abs(worst.place[0] - 0.02) < 2.2e-3


def test_an_open_contour_keeps_its_ends():
    corners = np.array([[0.0, 0.0], [0.05, 0.0], [0.05, 0.04]])
    line = filled(corners, 3e-4, closed=False)
    for given in (noisy(line, 1e-4), scattered(noisy(line, 1e-4))):
        fit = jxr.fit_contour(given, closed=False, smallest_radius=5e-3)
        check_bound(fit, 5e-3)
        points = everywhere(fit)[0]
        assert min(np.linalg.norm(points[0] - end) for end in line[[0, -1]]) < 5e-4
        assert min(np.linalg.norm(points[-1] - end) for end in line[[0, -1]]) < 5e-4
        flat = np.linalg.norm(points - corners[1], axis=1) > 7.5e-3
        assert off_polygon(points, corners, closed=False)[flat].max() < 2.5e-4
        assert not fit.report.closed and len(fit.report.rounded) == 1
    straight = np.stack([np.linspace(0.0, 0.05, 60), np.zeros(60)], axis=1)
    assert jxr.fit_contour(straight, closed=False, smallest_radius=3e-3).report.curvature == (0.0, 0.0)


def test_more_points_than_a_square_of_them_allows():
    """10 000 points, scattered: an order or a refusal within a second, but for what else the machine does."""
    u = 2 * np.pi * np.random.default_rng(0).random(10_000)
    reach = 1.0 + 0.2 * np.cos(3 * u)
    ring = np.stack([0.03 * reach * np.cos(u), 0.02 * reach * np.sin(u)], axis=1)
    rank = np.argsort(u)
    found_band(ring[:500], 1e-3, closed=True, ordered=None)  # imports
    for noise in (0.0, 1e-4, 5e-4):
        begin = time.process_time()
        band = found_band(noisy(ring, noise), 7.5e-4, closed=True, ordered=False)
        assert time.process_time() - begin < 2.0
        # Far apart along the chain means far apart along the ring: no step between two bands of it.
        place = np.empty(len(u))
        place[rank] = np.arange(len(u))
        steps = np.diff(place[band.indices], append=place[band.indices[:1]])
        steps = np.abs((steps + 5000) % 10_000 - 5000)
        assert np.quantile(steps, 0.99) < 60.0 + 4.0 * noise / 2e-5 and band.reordered
    area = np.random.default_rng(1).random((10_000, 2)) * 0.1
    begin = time.process_time()
    with pytest.raises(ValueError, match="argument points must be in order, or lie near one curve"):
        found_band(area, 1e-3, closed=True, ordered=None)
    with pytest.raises(ValueError, match="argument points must"):
        jxr.geometry.clean_points(area)
    assert time.process_time() - begin < 4.0


def test_jumps_of_curvature_are_named():
    """A stadium: lines that meet half circles, without corners; and an ellipse, which has none."""
    t = np.linspace(0.0, 1.0, 120, endpoint=False)[:, None]
    angle = np.pi * t
    right = np.hstack([0.02 + 0.01 * np.sin(angle), -0.01 * np.cos(angle)])
    line = np.hstack([-0.02 + 0.04 * t, -0.01 + 0 * t])
    stadium = np.concatenate([line, right, -line, -right])
    report = jxr.fit_contour(stadium, smallest_radius=3.5e-3).report
    assert len(report.jumps) == 4 and all(jump.angle == 0.0 for jump in report.jumps)
    for jump in report.jumps:
        assert np.abs(np.abs(jump.place) - (0.02, 0.01)).max() < 5e-4
        assert sorted((round(jump.before), round(jump.after))) == [0, 100]
    assert "jumps at 4 places" in " ".join(report.warnings)
    assert jumps(ELLIPSE, np.arange(N), closed=True) == ()
    assert jumps(noisy(ELLIPSE, 1e-4), np.arange(N), closed=True) == ()
    corners = jumps(filled(np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]]), 0.05), np.zeros(240), closed=True)
    angles = sorted(np.rad2deg(jump.angle) for jump in corners)
    np.testing.assert_allclose(angles, [90.0, 180.0 - 53.130102, 180.0 - 36.869898], atol=1e-6)


def test_a_radius_is_recommended_where_the_curvature_looks_like_noise():
    report = jxr.fit_contour(noisy(ELLIPSE[::3], 1e-4), noise=0.0).report
    radius = float(report.recommendation.split("=")[1].split(" ")[0])
    assert report.inflections > 12 and 2e-3 < radius < 0.02
    assert jxr.fit_contour(noisy(ELLIPSE[::3], 1e-4), smallest_radius=radius).report.inflections <= 4
    assert natural_radius(ELLIPSE, closed=True) == pytest.approx(B**2 / A, rel=0.2)
    assert jxr.fit_contour(ELLIPSE[::3], noise=0.0).report.recommendation == ""


def test_the_contour_is_differentiable_in_its_nodes():
    contour = jxr.fit_contour(noisy(ELLIPSE, 2e-4), smallest_radius=4e-3).contour

    def place(points):
        return jnp.sum(jxr.Spline(points, knots=points.shape[0]).point(0.03))

    nodes = contour.points
    way = 1e-8 * np.random.default_rng(0).normal(size=nodes.shape)
    slope = float(jnp.sum(jax.grad(place)(nodes) * way))
    central = float(place(nodes + way) - place(nodes - way)) / 2.0
    assert slope == pytest.approx(central, rel=1e-4)


@pytest.mark.parametrize(
    ("longer", "radius", "peak", "off"), [(0.020, 0.0199, 0.995, 1e-5), (0.022, 0.0195, 0.95, 2e-3)]
)
def test_a_curve_that_still_bends_too_much_is_tried_with_less(longer, radius, peak, off):
    """A circle that bends nearly as much as it may is met; an ellipse that bends more is rounded."""
    points = np.stack([longer * np.cos(U), 0.020 * np.sin(U)], axis=1)
    fit = jxr.fit_contour(points, smallest_radius=radius)
    _, direct, other = everywhere(fit, 2000)
    for bends in (direct, other):
        assert peak - 0.03 < radius * np.abs(bends).max() <= 1.0 + 1e-3
    assert fit.report.rms < off


def test_an_open_line_has_its_body_inside_its_bend():
    """Three quarters of a circle, turned in steps: on the left where it runs counter-clockwise."""
    wanted = Wanted(False, None, False, 1e-3, None, None, None)
    for start in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False):
        u = start + np.linspace(0.0, 1.5 * np.pi, 40)
        chain = np.stack([np.cos(u), np.sin(u)], axis=1) + [0.3, -2.0]
        for way, given in ((1, chain), (-1, chain[::-1])):
            band = Band(given, np.arange(40)[::way], np.zeros(0, int), True)
            turned, against, doubts = _turned(band, wanted)
            np.testing.assert_array_equal(turned.chain, chain)
            np.testing.assert_array_equal(turned.indices, np.arange(40))
            assert against == (way < 0) and len(doubts) == 1
            # In an order that was kept nothing is turned, nor doubted; `reverse` turns what was found.
            kept, _, none = _turned(band._replace(reordered=False), wanted)
            np.testing.assert_array_equal(kept.chain, given)
            assert none == ()
            other, _, _ = _turned(band, replace(wanted, reverse=True))
            np.testing.assert_array_equal(other.chain, chain[::-1])


REFUSED = {
    "few": (np.repeat(ELLIPSE[::60], 3, axis=0), {}, "must be 6 distinct points or more, but there were 5"),
    "two places": (
        np.repeat(ELLIPSE[[0, 99]], 6, axis=0),
        {},
        "must be 6 distinct points or more, but there were 2",
    ),
    "bent back": (
        ELLIPSE / [A, B] * [0.0202, 0.02],
        {"smallest_radius": 0.01995},
        "leave room for a smooth contour among the points, but with 0.01995 m the curvature stays at 5",
    ),
    "too large": (ELLIPSE, {"smallest_radius": 0.021}, "must be at most 0.02 m here, half the least width"),
    "zero": (ELLIPSE, {"smallest_radius": 0.0}, "smallest_radius must be a positive length"),
    "negative": (ELLIPSE, {"smallest_radius": -1.0}, "smallest_radius must lie between 0 and"),
    "text": (ELLIPSE, {"smallest_radius": "a"}, "smallest_radius must be a length in metres"),
    "gap": (ELLIPSE[:150], {}, "leave a gap of 60 mm"),
    "two": (np.concatenate([ELLIPSE, ELLIPSE + 0.1]), {}, "do they follow a single one"),
    "eight": (
        np.stack([A * np.sin(U), B * np.sin(2 * U)], 1),
        {"ordered": True},
        "must not cross themselves",
    ),
    "field": (ELLIPSE, {"field": "support"}, "smallest_radius, knots, closed=False are for splines"),
    "knots": (ELLIPSE, {"knots": 10}, "argument knots must be a whole number of at least 48"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_such_contour_is_refused(case):
    points, options, words = REFUSED[case]
    with pytest.raises(ValueError, match=words) as caught:
        jxr.fit_contour(points, **{"smallest_radius": 3e-3, **options})
    assert str(caught.value).startswith("argument") and len(str(caught.value)) <= 300


def section(name, origin, normal):
    path = DATA / f"ycb_{name}.npz"
    if not path.exists():
        pytest.skip("the scan is not here")
    scan = np.load(path)
    return jxr.io.section(scan["vertices"], scan["faces"], origin=origin, normal=normal)[0]


SECTIONS = {
    "banana across": ("011_banana", (0.02, 0.0, 0.0), (1, 0, 0), 5e-3),
    "banana nearer its stem": ("011_banana", (-0.03, 0.0, 0.0), (1, 0, 0), 5e-3),
    "can across": ("010_potted_meat_can", (0.0, 0.0, -0.01), (0, 0, 1), 8e-3),
}


@pytest.mark.slow
@pytest.mark.parametrize("noise", [1e-4, 3e-4, 5e-4])
@pytest.mark.parametrize("case", SECTIONS)
def test_noisy_sections_of_scans(case, noise):
    name, origin, normal, radius = SECTIONS[case]
    truth = section(name, origin, normal)
    given = scattered(noisy(truth, noise))
    fit = jxr.fit_contour(given, smallest_radius=radius)
    check_bound(fit, radius)
    sides = filled(truth, 1e-4)
    off = KDTree(everywhere(fit)[0]).query(sides)[0]
    print(
        f"{case}, {noise}: {off.max() / noise:.2f} of the noise at most, {fit.report.inflections} inflections"
    )
    assert off.max() <= 2.0 * noise and fit.report.jumps == ()
    assert fit.report.noise == pytest.approx(noise, rel=0.3)


# The parts, one by one.


@pytest.mark.parametrize("closed", [True, False])
def test_even_splines_against_a_circle(closed):
    angle = 2 * np.pi * np.arange(64) / 64
    ring = EvenSpline(np.stack([np.cos(angle), np.sin(angle)], axis=1), closed)
    u = np.linspace(8.0, 50.0, 97)
    frame = ring.frames(u)
    np.testing.assert_allclose(frame.curvature, 1.0, rtol=2e-5)
    np.testing.assert_allclose(frame.normal, -frame.point, atol=1e-6)
    np.testing.assert_allclose(ring.feet(1.3 * frame.point), u, atol=1e-5)
    total = 2 * np.pi * (1.0 if closed else 63 / 64)
    assert ring.arclengths()[1][-1] == pytest.approx(total, rel=1e-3 if closed else 1e-4)
    np.testing.assert_allclose(np.linalg.norm(ring.spread(50).nodes, axis=1), 1.0, atol=1e-5)


@pytest.mark.parametrize("closed", [True, False])
def test_displacements_are_sums_of_smooth_bumps(closed):
    """Second derivatives against differences; all coefficients 1 give 1 everywhere."""
    u = np.linspace(0.0, 20.0, 81)[:-1]
    rng = np.random.default_rng(0)
    value, second = (displacements(u, 20, closed=closed, order=k) for k in (0, 2))
    np.testing.assert_allclose(value @ np.ones(value.shape[1]), 1.0, atol=1e-14)
    weights, h = rng.normal(size=value.shape[1]), 1e-3
    inner = u[2:-2] + 0.1
    a, b, c = (displacements(inner + k * h, 20, closed=closed) @ weights for k in (-1, 0, 1))
    np.testing.assert_allclose(
        displacements(inner, 20, closed=closed, order=2) @ weights, (a - 2 * b + c) / h**2, atol=1e-5
    )
    assert second.shape == value.shape


def test_the_bound_binds_and_the_weights_let_go():
    """Points on a circle of radius 1 with a bound of 2 are met, a square's corners with one of 3 not."""
    angle = 2 * np.pi * np.arange(200) / 200
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    start = EvenSpline(1.05 * ring[::2], closed=True)
    options = {"noise": 1e-3, "wavelength": 0.3}
    free = bounded_curve(ring, start, line=ring, bound=2.0, **options)
    assert np.abs(free.distances).max() < 1e-5
    square = filled(np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]), 0.05)
    tight = bounded_curve(square, start, line=square, bound=3.0, **options)
    assert tight.sharpest() < 3.1
    assert np.abs(tight.distances).max() == pytest.approx((2**0.5 - 1) / 3.0, rel=0.15)


@pytest.mark.parametrize("closed", [True, False])
def test_a_wave_of_the_wavelength_is_halved(closed):
    s = np.arange(400) / 400 if closed else np.linspace(0.0, 1.0, 400)
    wave = np.stack([s, 0.01 * np.sin(2 * np.pi * 10 * s)], axis=1)
    flat = low_passed(wave[:, 1:] @ np.ones((1, 2)), 1.0, 0.1, closed=closed)
    np.testing.assert_allclose(flat[:, 0], 0.5 * wave[:, 1], atol=2e-4)
    # One of two wavelengths is left alone, one of half a wavelength goes.
    for wavelength, left in ((0.05, 1.0), (0.2, 0.0)):
        flat = low_passed(wave[:, 1:] @ np.ones((1, 2)), 1.0, wavelength, closed=closed)
        np.testing.assert_allclose(flat[:, 0], left * wave[:, 1], atol=4e-4)


@pytest.mark.parametrize(("angle", "height"), [(45.0, 0.065), (25.0, 0.08)])
def test_sharp_corners_do_not_become_bulbs(angle, height):
    """An isosceles triangle: the disc in its corner is known, and nothing lies outside of the sides."""
    half, radius, noise = np.radians(angle) / 2.0, 4e-3, 5e-5
    corners = height * np.array([(0.0, -np.tan(half)), (1.0, 0.0), (0.0, np.tan(half))])
    fit = jxr.fit_contour(noisy(filled(corners, 4e-4), noise), smallest_radius=radius)
    check_bound(fit, radius)
    points = everywhere(fit)[0]
    sides = np.abs(points[:, 1]) * np.cos(half) - (height - points[:, 0]) * np.sin(half)
    assert np.maximum(sides, -points[:, 0]).max() < 6.0 * noise
    # The foremost place: a radius before the disc's middle, which is a radius from both sides; a disc may be
    # off them by some hundredths of that.
    foremost = height - radius / np.sin(half) + radius
    assert abs(points[:, 0].max() - foremost) < 0.04 * radius / np.sin(half)
