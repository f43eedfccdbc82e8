"""Surfaces from clouds of points: the quadratic forms, noise, shapes that are not star-shaped, refusals."""

import pathlib

import numpy as np
import pytest

from jaxroll.geometry import Ellipsoid, fit_surface, Torus
from jaxroll.geometry.fitting._field_fit import grid_around, normal_band, offsets, roughness_band, rows
from tests.oracles.bands import full

AXES = np.array([0.02, 0.014, 0.01])
NOISE = 1e-4
BANANA = pathlib.Path(__file__).parents[2] / "shared" / "data" / "ycb_011_banana.npz"


def ellipsoid_cloud(count, seed=0):
    """Points evenly over an ellipsoid, by rejection, each coordinate off by `NOISE`."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(4 * count, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    stretch = np.linalg.norm(u / AXES, axis=1)
    points = (u[rng.uniform(size=len(u)) < stretch / stretch.max()] * AXES)[:count]
    assert len(points) == count
    return points + NOISE * rng.normal(size=points.shape)


def errors(fit, exact):
    """Largest distance [m], angle [deg] and relative error of the principal curvatures, at the feet."""
    at = np.asarray(fit.feet)
    true = np.asarray(exact.near(at))
    cos = np.sum(np.asarray(fit.surface.normal(at)) * np.asarray(exact.normal(true)), axis=1)
    curvature = np.asarray(fit.surface.principal_curvatures(at)[0])
    expected = np.asarray(exact.principal_curvatures(true)[0])
    off = np.linalg.norm(true - at, axis=1).max()
    size = np.abs(expected).max(axis=1, keepdims=True)
    return off, np.degrees(np.arccos(np.minimum(cos, 1.0))).max(), np.abs((curvature - expected) / size).max()


@pytest.mark.parametrize("sides", [(2.0, 1.0, 1.0), (1.0, 1.0, 2.0), (1.0, 2.0, 1.0)])
def test_quadratic_forms_on_polynomials(sides):
    """Cubics are in the space: their roughness is that of calculus, their fit to data exact."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0.0, 1.0, size=(900, 3)) * np.array(sides)
    points[:2] = np.array([np.zeros(3), sides])
    grid = grid_around(points, 1.0, 0.0)
    assert grid.counts == tuple(int(s) + 5 for s in sides)
    data, size = rows(grid, points), np.prod(grid.counts)
    matrix, slopes = np.zeros((900, size)), np.zeros((900, 3, size))
    places = data.base[:, None] + offsets(grid)[None, :]
    np.put_along_axis(matrix, places, data.field((0, 0, 0)), axis=1)
    for k, axis in enumerate(((1, 0, 0), (0, 1, 0), (0, 0, 1))):
        np.put_along_axis(slopes[:, k], places, data.field(axis), axis=1)
    x, y, z = points.T
    fields = np.stack([x**3, x * y * z, x**2 * y - 3 * z**2, y * z**2 + x**3], -1)
    found = np.linalg.lstsq(matrix, fields, rcond=1e-12)[0]
    np.testing.assert_allclose(matrix @ found, fields, atol=1e-9)
    np.testing.assert_allclose(slopes[:, 0] @ found[:, 0], 3 * x**2, atol=1e-7)
    rough = found.T @ full(roughness_band(grid)) @ found
    volume = np.prod(sides)
    np.testing.assert_allclose(np.diag(rough), volume * np.array([36.0, 6.0, 12.0, 48.0]), rtol=1e-6)
    np.testing.assert_allclose(rough[0, 3], volume * 36.0, rtol=1e-6)
    weight, turn = rng.uniform(size=900), rng.normal(size=(900, 3, 3))
    turned = (turn @ slopes).reshape(-1, size)
    expected = matrix.T @ (weight[:, None] * matrix) + turned.T @ turned
    np.testing.assert_allclose(full(normal_band(grid, data, weight, turn)), expected, atol=1e-12)


def test_noisy_ellipsoid():
    """4000 points 0.1 mm off a body of 40 by 28 by 20 mm: normals to 1 degree, curvatures to 5 %."""
    fit = fit_surface(ellipsoid_cloud(4000), smoothing=0.022)
    off, angle, curvature = errors(fit, Ellipsoid(*AXES))
    assert off < 5e-5
    assert angle < 1.0
    assert curvature < 0.05
    assert abs(fit.report.rms / NOISE - 1.0) < 0.05
    assert abs(fit.report.area / 2.3e-3 - 1.0) < 0.5
    assert "wavelength 22 mm" in str(fit.report)
    assert fit.report.verdict.startswith("the points lie")  # it encloses a body


@pytest.mark.slow
def test_torus_from_points_and_normals():
    """Neither convex nor star-shaped, and no quadric: errors fall with the wavelength."""
    exact = Torus(0.03, 0.011)
    rng = np.random.default_rng(2)
    u, v = rng.uniform(0.0, 2 * np.pi, size=(2, 4000))
    out = 0.03 + 0.011 * np.cos(v)
    cloud = np.stack([out * np.cos(u), out * np.sin(u), 0.011 * np.sin(v)], -1)
    coarse, fine = (fit_surface(cloud, exact.normal(cloud), smoothing=ell) for ell in (0.03, 0.018))
    before, after = errors(coarse, exact), errors(fine, exact)
    assert all(b > 3.0 * a for a, b in zip(after, before, strict=True)), (before, after)
    assert after[1] < 1.0
    assert after[2] < 0.05
    assert fine.report.normals is not None
    assert fine.report.normals[1] < np.radians(1.0)


@pytest.mark.slow
def test_smoothing_found_from_the_points():
    """20 000 points, nothing else given."""
    for noise in (None, NOISE):
        fit = fit_surface(ellipsoid_cloud(20_000), noise=noise)
        off, angle, curvature = errors(fit, Ellipsoid(*AXES))
        assert off < 5e-5
        assert angle < 0.5
        assert curvature < 0.05


@pytest.mark.slow
@pytest.mark.skipif(not BANANA.exists(), reason="the scan is not here")
def test_banana():
    """A scan that is not star-shaped: outward normals against those of its triangles."""
    with np.load(BANANA) as file:
        vertices, faces = file["vertices"].astype(float), file["faces"]
    fit = fit_surface(vertices, smoothing=0.02)
    corners = vertices[faces]
    middles = corners.mean(axis=1)
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.sum(middles * turned) > 0
    unit = turned / np.linalg.norm(turned, axis=1)[:, None]
    cos = np.sum(np.asarray(fit.surface.normal(fit.surface.near(middles))) * unit, axis=1)
    assert np.mean(cos > np.cos(np.radians(15.0))) > 0.9
    assert fit.report.rms < 3e-4


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: fit_surface(np.zeros((50, 3))), "argument points must have at least 100"),
        (lambda: fit_surface(np.zeros((500, 2))), "argument points must have shape"),
        (
            lambda: fit_surface(np.where(np.arange(600).reshape(200, 3) == 10, np.nan, ellipsoid_cloud(200))),
            "argument points must be finite, but row 3 was",
        ),
        (lambda: fit_surface(ellipsoid_cloud(200), np.zeros((9, 3))), "argument normals must have"),
        (lambda: fit_surface(ellipsoid_cloud(200), smoothing=-1.0), "argument smoothing must be positive"),
        (lambda: fit_surface(ellipsoid_cloud(200), smoothing=1e-4), "argument smoothing must be larger"),
        # A hundred times 40 mm; a tenth of it.
        (lambda: fit_surface(ellipsoid_cloud(200), smoothing=4.01), "argument smoothing must lie between"),
        (lambda: fit_surface(ellipsoid_cloud(200), noise=0.00401), "argument noise must lie between 0 and"),
        (lambda: fit_surface(ellipsoid_cloud(200), noise=1e300), "argument noise must lie between 0 and"),
        (
            lambda: fit_surface(ellipsoid_cloud(200), noise=1e-4, smoothing=0.02),
            "argument noise must be None where smoothing is given",
        ),
    ],
)
def test_bad_arguments_say_what_they_must_be(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_cloud_in_two_parts_is_refused():
    cloud = ellipsoid_cloud(400)
    with pytest.raises(ValueError, match="argument points must cover one connected surface"):
        fit_surface(np.concatenate([cloud, cloud + 0.2]), smoothing=0.02)


def test_points_given_twice_count_once_and_normals_stay_with_their_points():
    cloud = ellipsoid_cloud(300)
    once, twice = (
        fit_surface(points, smoothing=0.02) for points in (cloud, np.concatenate([cloud, cloud[::-1]]))
    )
    np.testing.assert_array_equal(once.feet, twice.feet)
    normals = Ellipsoid(*AXES).normal(cloud)
    fit = fit_surface(cloud, normals, smoothing=0.02)
    assert fit.report.normals[1] < np.radians(10.0)  # turned at random they would be 90 degrees off
    with pytest.raises(ValueError, match="argument"):
        fit_surface(cloud, normals[:0], smoothing=0.02)


@pytest.mark.parametrize("pressed", [(1.0, 0.0, 0.0), (1.0, 1.0, 0.0)])
def test_points_exactly_on_a_line_or_in_a_plane_are_refused_in_a_sentence(pressed):
    """Squares of the distance from a plane are zero on it with their slopes, without third derivatives."""
    u = np.random.default_rng(0).normal(size=(162, 3))
    u = 0.01 * u / np.linalg.norm(u, axis=1)[:, None]
    with pytest.raises(ValueError, match="argument points must tell the field of a surface, but they leave"):
        fit_surface(u * np.array(pressed))


def test_a_fit_that_encloses_no_body_says_so():
    """Half a ball without its bottom, whose field leaves the grid open."""
    u = np.random.default_rng(0).normal(size=(2000, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    fit = fit_surface(0.02 * u[u[:, 2] >= 0.0], smoothing=0.02)
    assert fit.report.verdict.startswith("not to be trusted: it encloses no body")
