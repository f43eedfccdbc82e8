"""Surfaces from scans with a smallest radius of curvature: holes, edges, thin parts, refusals, the net."""

import pathlib

import numpy as np
import pytest

from jaxroll.geometry import fit_surface, Superellipsoid
from jaxroll.geometry.fitting import _surface_fit
from jaxroll.geometry.surfaces import net, surface_net
from tests.oracles.spline_fields import principal_curvatures, SplineField

DATA = pathlib.Path(__file__).parents[2] / "shared" / "data"
NOISE = 1e-4
TORUS = 0.008  # smallest radius of the fit to a torus [m]


def torus_cloud(count, seed=0):
    """Points evenly over a torus of radii 30 and 11 mm, each coordinate off by `NOISE`."""
    rng = np.random.default_rng(seed)
    v = rng.uniform(0.0, 2 * np.pi, 4 * count)
    v = v[rng.uniform(size=4 * count) < (0.03 + 0.011 * np.cos(v)) / 0.041][:count]
    u, out = rng.uniform(0.0, 2 * np.pi, count), 0.03 + 0.011 * np.cos(v)
    cloud = np.stack([out * np.cos(u), out * np.sin(u), 0.011 * np.sin(v)], axis=-1)
    return cloud + NOISE * rng.normal(size=cloud.shape)


def ball_cloud(count, radius, seed=0):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(count, 3))
    return radius * u / np.linalg.norm(u, axis=1)[:, None]


def box_mesh(*half):
    """Vertices and faces of a box."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(half)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def test_a_net_of_a_torus_is_closed_and_has_its_volume():
    x, y, z = np.indices((60, 60, 30)) - np.array([30.0, 30.0, 15.0])[:, None, None, None]
    vertices, faces = net(np.hypot(np.hypot(x, y) - 18.0, z) - 7.0)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)
    np.testing.assert_array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))
    assert len(vertices) - len(edges) // 2 + len(faces) == 0  # Euler's number of one handle
    a, b, c = (vertices[faces[:, k]] - 30.0 for k in range(3))
    volume = np.sum(a * np.cross(b, c)) / 6.0
    assert abs(volume / (2 * np.pi**2 * 18.0 * 49.0) - 1.0) < 0.02


@pytest.fixture(scope="module")
def torus():
    return fit_surface(torus_cloud(2500), smallest_radius=TORUS)


def test_noisy_torus(torus):
    """2500 points 0.1 mm off a torus: no poles, a handle, normals and curvatures of the closed form."""
    at = np.asarray(torus.feet)
    ring = 0.03 * at * [1.0, 1.0, 0.0] / np.hypot(at[:, 0], at[:, 1])[:, None]
    away = np.linalg.norm(at - ring, axis=1)
    outward = (at - ring) / away[:, None]
    assert np.sqrt(np.mean((away - 0.011) ** 2)) < 5e-5
    cos = np.sum(np.asarray(torus.surface.normal(at)) * outward, axis=1)
    assert np.degrees(np.sqrt(np.mean(np.arccos(np.minimum(cos, 1.0)) ** 2))) < 0.5
    found = np.sort(np.asarray(torus.surface.principal_curvatures(at)[0]), axis=1)
    # Round the tube, and about the axis, from which the tube's inner side faces the other way.
    aside = np.sum(outward * ring, axis=1) / 0.03
    expected = np.stack([aside / (0.03 + 0.011 * aside), np.full(len(at), 1.0 / 0.011)], axis=1)
    assert np.sqrt(np.mean((found - expected) ** 2)) / np.abs(expected).max() < 0.03
    assert max(np.abs(torus.report.curvature)) <= 1.0 / TORUS
    assert torus.report.reversed == 0.0 and torus.report.uncovered == 0.0
    assert "one smooth surface" in str(torus.report)


def test_the_whole_zero_set_is_one_torus(torus):
    vertices, faces = surface_net(torus.surface, 3)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(vertices) - len(edges) // 2 + len(faces) == 0
    curvatures = np.asarray(torus.surface.principal_curvatures(vertices)[0])
    assert np.abs(curvatures).max() <= 1.0 / TORUS
    assert torus.trusted(vertices).all()
    # The report's extremes are those of a finer net, by SciPy's splines.
    surface = torus.surface
    field = SplineField(surface.coefficients, surface.origin, surface.step)
    at = field.sampled(6)
    bends = principal_curvatures(field.gradient(at), field.hessian(at))
    np.testing.assert_allclose(torus.report.curvature, [bends.min(), bends.max()], rtol=2e-3)
    assert torus.report.curvature[0] <= bends.min() + 1e-3 and torus.report.curvature[1] >= bends.max() - 1e-3


def test_a_missing_bottom_is_closed_and_not_trusted():
    cloud = ball_cloud(2500, 0.02)
    fit = fit_surface(cloud[cloud[:, 2] > -0.015], smallest_radius=0.012)
    vertices, faces = surface_net(fit.surface, 2)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(vertices) - len(edges) // 2 + len(faces) == 2
    trusted = fit.trusted(vertices)
    assert trusted[vertices[:, 2] > -0.010].all()
    assert not trusted[np.argmin(vertices[:, 2])]
    assert 0.02 < fit.report.uncovered < 0.15  # of the ball an eighth is missing
    region = fit.report.regions[0]
    assert region.reason == "no data" and region.centre[2] < -0.01
    assert np.abs(fit.report.curvature).max() <= 1.0 / 0.012


def test_edges_of_a_box_are_rounded_and_its_faces_kept():
    vertices, faces = box_mesh(0.03, 0.02, 0.018)
    fit = fit_surface(vertices, faces=faces, smallest_radius=0.008)
    assert np.abs(fit.report.curvature).max() <= 1.0 / 0.008
    points = np.asarray(fit.points)
    off = np.linalg.norm(np.asarray(fit.feet) - points, axis=1)
    # Nearer to an edge than the radius no ball touches from inside.
    inward = np.sort(np.array([0.03, 0.02, 0.018]) - np.abs(points), axis=1)[:, 1]
    assert np.sqrt(np.mean(off[inward > 0.009] ** 2)) < 3e-4
    assert fit.report.kept is not None and fit.report.kept[0] < 3e-4
    assert fit.report.rounded is not None and 2e-3 < fit.report.rounded[1] < 9e-3
    normals = np.sign(points) * (np.abs(points) > np.array([0.03, 0.02, 0.018]) - 1e-9)
    assert np.sum(np.asarray(fit.surface.normal(fit.feet)) * normals, axis=1).min() > 0.0
    assert any(region.reason == "rounded off" for region in fit.report.regions)


def test_points_far_away_are_rejected():
    cloud = ball_cloud(2500, 0.02)
    fit = fit_surface(np.concatenate([cloud, [[0.2, 0.0, 0.0], [0.0, 0.0, 0.15]]]), smallest_radius=0.012)
    assert fit.report.rejected == 2 and len(fit.points) == 2500
    assert fit.report.largest < 1e-4


def test_large_clouds_are_thinned_without_a_bias(monkeypatch):
    """The fit takes means of points, which lie below the surface: in cells of 2.7 and of 0.3 mm."""
    monkeypatch.setattr(_surface_fit, "_MANY", 5000)
    cloud = ball_cloud(6000, 0.02) + NOISE * np.random.default_rng(1).normal(size=(6000, 3))
    for options in ({"smallest_radius": 0.0106}, {"smoothing": 0.025}):
        away = np.linalg.norm(fit_surface(cloud, **options).feet, axis=1)
        assert abs(np.mean(away**2) - 0.02**2) < 3e-8
        assert abs(away.mean() - 0.02) < 2e-5


@pytest.mark.slow
def test_superellipsoid():
    rng = np.random.default_rng(2)
    u = ball_cloud(20_000, 1.0)
    axes = np.array([0.02, 0.014, 0.01])
    cloud = u * np.sum(np.abs(u) ** 3, axis=1, keepdims=True) ** (-1 / 3) * axes
    fit = fit_surface(cloud + NOISE * rng.normal(size=cloud.shape), smallest_radius=0.004)
    exact, at = Superellipsoid(*axes, 3.0), np.asarray(fit.feet)
    true = np.asarray(exact.near(at))
    assert np.sqrt(np.mean(np.sum((at - true) ** 2, axis=1))) < 5e-5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 7])
def test_few_points_of_a_scan_keep_its_ends(seed):
    """3000 points of a banana: balls that rolled on these cut 26 mm off its end, or became no surface."""
    path = DATA / "ycb_011_banana.npz"
    if not path.exists():
        pytest.skip("the scan is not here")
    with np.load(path) as file:
        vertices = file["vertices"].astype(float)
    some = np.random.default_rng(seed).permutation(len(vertices))[:3000]
    fit = fit_surface(vertices[some], smallest_radius=0.0038)
    assert np.abs(fit.report.curvature).max() <= 1.0 / 0.0038
    assert fit.report.kept is not None and fit.report.kept[0] < 1e-4
    assert fit.report.largest < 1.5e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["011_banana", "010_potted_meat_can"])
@pytest.mark.parametrize("mesh", [True, False])
def test_scans(name, mesh):
    """Asked for 5 mm: at most that curvature, 0.3 mm rms where the data's own radius exceeds it."""
    path = DATA / f"ycb_{name}.npz"
    if not path.exists():
        pytest.skip("the scan is not here")
    with np.load(path) as file:
        vertices, faces = file["vertices"].astype(float), file["faces"]
    fit = fit_surface(vertices, faces=faces if mesh else None, smallest_radius=0.005)
    curvatures = np.asarray(fit.surface.principal_curvatures(surface_net(fit.surface, 4)[0])[0])
    assert np.abs(curvatures).max() <= 1.0 / 0.005
    assert fit.report.kept is not None and fit.report.kept[0] < 3e-4
    assert fit.report.reversed < 1e-3


# A wedge into which no ball of 5 mm fits.
THIN = (
    np.array([(x, y, z) for y in (0.0, 0.0185) for x, z in ((0.0, 0.0), (0.0185, 0.0), (0.0185, 0.015))]),
    np.array([(0, 1, 2), (3, 5, 4), (0, 3, 4), (0, 4, 1), (1, 4, 5), (1, 5, 2), (0, 2, 5), (0, 5, 3)]),
)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: fit_surface(THIN[0], faces=THIN[1], smallest_radius=0.005), "argument smallest_radius must"),
        (
            lambda: fit_surface(
                np.concatenate([ball_cloud(900, 0.02), ball_cloud(900, 0.02) + 0.1]), smallest_radius=0.005
            ),
            "argument points must",
        ),
        (lambda: fit_surface(ball_cloud(900, 0.02), smallest_radius=-1.0), "argument smallest_radius must"),
        (
            lambda: fit_surface(ball_cloud(900, 0.02), smallest_radius=0.01, smoothing=0.02),
            "argument smoothing must be left out",
        ),
        (lambda: fit_surface(ball_cloud(900, 0.02), faces=[[0, 1, 900]]), "argument faces must"),
        (lambda: fit_surface(ball_cloud(900, 0.02), faces=[[0.0, 1.0, 2.0]]), "argument faces must"),
        (lambda: fit_surface(ball_cloud(900, 0.004), smallest_radius=0.005), "argument smallest_radius must"),
    ],
)
def test_what_cannot_be_one_smooth_surface_is_refused(make, words):
    with pytest.raises(ValueError, match=words) as error:
        make()
    assert len(str(error.value)) <= 300
