"""From raw points to a contour: accuracy, the report, and that bad data never gives a wrong contour."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special

import jaxroll as jxr
from jaxroll.geometry import tabled
from jaxroll.geometry.fitting import _contour_fit
from jaxroll.geometry.fitting._contour_fit import measured_contour

N = 96
U = 2 * np.pi * np.arange(N) / N
A, B = 20.0, 14.0  # mm
ELLIPSE = np.stack([A * np.cos(U), B * np.sin(U)], axis=1)
NOISE = 0.03  # mm
NOISY = ELLIPSE + NOISE * np.random.default_rng(0).normal(size=ELLIPSE.shape)


def off_ellipse(points):
    """Distances [m] of points from the ellipse, to first order."""
    x, y = 1e3 * points.T
    level = np.hypot(x / A, y / B)
    return 1e-3 * (level - 1.0) * level / np.hypot(x / A**2, y / B**2)


@pytest.fixture(scope="module")
def exact():
    """Scattered, clockwise, in millimetres, one point twice; then interpolated."""
    mixed = np.random.default_rng(1).permutation(np.concatenate([ELLIPSE, ELLIPSE[:1]]))
    return jxr.fit_contour(mixed, unit="mm", noise=0.0, ordered=False)


@pytest.fixture(scope="module")
def noisy():
    """Smoothed by the noise level, and by cross-validation."""
    return [jxr.fit_contour(NOISY, unit="mm", noise=noise) for noise in (1e-3 * NOISE, None)]


def everywhere(fit):
    s = np.linspace(0.0, fit.report.length, 512)
    contour = tabled(fit.contour)
    return np.asarray(contour.point(s)), np.asarray(contour.curvature(s))


def test_exact_points_give_the_ellipse(exact):
    report = exact.report
    assert np.abs(off_ellipse(everywhere(exact)[0])).max() < 1e-9
    assert report.radius == pytest.approx(1e-3 * B**2 / A, rel=1e-4)
    assert report.curvature == pytest.approx((1e3 * B / A**2, 1e3 * A / B**2), rel=1e-4)
    assert report.length == pytest.approx(float(jxr.Ellipse(0.02, 0.014).domain()[1]), rel=1e-8)
    assert (report.points, report.merged, report.reordered) == (N, 1, True)
    assert report.largest < 1e-12 and report.smoothing == 0.0 and report.smoothness == 4.0
    assert report.inflections == 0 and not report.self_intersecting and report.warnings == ()


def test_the_contour_starts_at_the_first_point(exact):
    np.testing.assert_allclose(tabled(exact.contour).point(0.0), exact.points[0], atol=1e-12)
    np.testing.assert_allclose(exact.feet[0], 0.0, atol=1e-12)
    assert np.all(np.diff(exact.feet) > 0)


def test_noise_is_smoothed_out(noisy):
    """The contour is nearer to the truth than the points are, in place and by far in curvature."""
    for fit in noisy:
        points, curvatures = everywhere(fit)
        assert np.sqrt(np.mean(off_ellipse(points) ** 2)) < 0.65e-3 * NOISE
        assert 0.75e-3 * NOISE < fit.report.rms < 1.3e-3 * NOISE
        assert fit.report.smoothing > 0.005 and fit.report.warnings == ()
        assert curvatures.min() > 25.0 and curvatures.max() < 120.0


def test_interpolated_noise_is_warned_of():
    report = jxr.fit_contour(NOISY, unit="mm", noise=0.0).report
    words = " ".join(report.warnings)
    assert report.inflections > 12 and "errors of the points" in words
    assert report.largest < 1e-8


def test_corners_are_warned_of():
    t = np.arange(N // 4) / (N // 4)
    zero, one = 0 * t, 0 * t + 1
    sides = ((t, zero), (one, t), (1 - t, one), (zero, 1 - t))
    report = jxr.fit_contour(
        np.concatenate([np.stack(s, axis=1) for s in sides]), unit="in", noise=0.0
    ).report
    words = " ".join(report.warnings)
    assert "4 corners, of up to 90 degrees" in words and "less than the points' spacing" in words


def test_a_contour_that_crosses_itself_is_seen():
    """Every other point of a thin sickle: the points do not cross, the spline through them does."""
    u = np.linspace(-1.0, 1.0, N // 2)

    def sickle(height):
        outer = np.stack([20 * u, height * (1 - u**2)], axis=1)
        inner = np.stack([20 * u, (height - 0.01) * (1 - u**2) - 1e-3], axis=1)[::-1]
        return np.concatenate([outer, inner])

    report = jxr.fit_contour(sickle(2.0), unit="mm", noise=0.0, ordered=True).report
    assert report.self_intersecting and "crosses itself" in " ".join(report.warnings)
    with pytest.raises(ValueError, match="argument points .* bends more sharply than its table can follow"):
        jxr.fit_contour(sickle(8.0), unit="mm", noise=0.0, ordered=True)


EIGHT = np.stack([A * np.sin(U), B * np.sin(2 * U)], axis=1)
CUSP = (1 - np.cos(U))[:, None] * ELLIPSE / A
BAD = {
    "NaN": (np.where(np.arange(2 * N).reshape(N, 2) == 7, np.nan, ELLIPSE), {}, "finite, but row 3"),
    "too few": (ELLIPSE[:5], {}, "6 distinct points or more"),
    "open": (ELLIPSE[: N // 2], {}, "leave a gap of 40"),
    "crossing": (EIGHT, {}, "must not cross themselves"),
    "cusp": (CUSP, {}, r"turn back by 1\d\d degrees \(a cusp\)"),
    "units": (ELLIPSE * np.where(np.arange(N) < 20, 1e-3, 1.0)[:, None], {}, "in one unit"),
    "field": (ELLIPSE, {"field": "clay"}, "argument field must be one of 'spline'"),
    "noise": (ELLIPSE, {"noise": -1.0}, "argument noise must lie between 0 and 0.004 m here, but was -1"),
    "noise in mm": (ELLIPSE, {"noise": 0.02}, "argument noise must lie between 0 and 0.004 m here"),
    "noise text": (ELLIPSE, {"noise": "low"}, "argument noise must be a length in metres"),
    "smoothing": (ELLIPSE, {"smoothing": np.nan}, "argument smoothing must lie between 0"),
    "both": (ELLIPSE, {"smoothing": 0.01, "noise": 1e-5}, "argument noise must be None where smoothing"),
}


@pytest.mark.parametrize("times", [2, 5])
def test_points_at_the_origin_are_of_no_other_unit(times):
    """An outline that begins and ends there, to rounding: as a drawing whose corner lies at zero."""
    u = np.linspace(-np.pi, np.pi, N + 1)
    round_ = np.stack([0.02 + 0.02 * np.cos(u), 0.014 * np.sin(u)], axis=-1)
    fit = jxr.fit_contour(np.concatenate([round_, np.repeat(round_[:1], times - 2, axis=0)]), noise=0.0)
    around = 0.08 * special.ellipe(1.0 - 0.7**2)
    assert float(fit.contour.domain()[1]) == pytest.approx(around, rel=1e-7)


@pytest.mark.parametrize("case", BAD)
def test_bad_data_gives_no_contour(case):
    points, options, sentence = BAD[case]
    with pytest.raises(ValueError, match=sentence) as error:
        jxr.fit_contour(points, unit="mm", **options)
    assert str(error.value).startswith("argument ") and "\n" not in str(error.value)


def test_wrong_units_are_warned_of(exact):
    report = jxr.fit_contour(ELLIPSE, noise=0.0).report
    assert "check the argument unit" in " ".join(report.warnings)
    assert report.length == pytest.approx(1e3 * exact.report.length, rel=1e-9)


def test_feet_and_distances_are_those_of_offset_points():
    """Points moved off an ellipse along its normal by a known way come back to where they were."""
    around = lambda u: jnp.array([0.02 * jnp.cos(u), 0.014 * jnp.sin(u)])  # noqa: E731
    body = tabled(jxr.Parametric(around, (0.0, 2.0 * np.pi), closed=True))
    s = np.linspace(0.001, 0.1, 128)  # as many as a fit to 96 points is measured at
    way = np.linspace(-0.005, 0.004, 128)
    points = np.asarray(body.point(s)) + way[:, None] * np.asarray(body.normal(s))
    feet, distances, *_ = measured_contour(body.read(), jnp.asarray(points))
    np.testing.assert_allclose(feet, s, atol=1e-10)
    np.testing.assert_allclose(distances, np.abs(way), atol=1e-14)


def test_an_open_contour_keeps_its_ends_and_its_side():
    arc = ELLIPSE[8:56]
    fit = jxr.fit_contour(arc, unit="mm", closed=False, noise=0.0)
    contour = tabled(fit.contour)
    np.testing.assert_allclose(
        contour.point(np.array([0.0, fit.report.length])), 1e-3 * arc[[0, -1]], atol=1e-12
    )
    assert not fit.report.closed and fit.report.curvature[0] > 0.0
    turned = jxr.fit_contour(arc, unit="mm", closed=False, noise=0.0, reverse=True).report
    assert turned.curvature[1] < 0.0 and turned.length == pytest.approx(fit.report.length, rel=1e-9)


def test_a_fit_is_a_tree_of_arrays(exact):
    doubled = jax.tree.map(lambda x: 2.0 * x, exact)
    np.testing.assert_allclose(doubled.points, 2.0 * exact.points)
    assert doubled.report is exact.report


def test_the_report_is_a_screenful(exact, noisy):
    for fit in (exact, *noisy):
        lines = str(fit.report).splitlines()
        assert 8 <= len(lines) <= 20 and max(map(len, lines)) <= 100
    assert "96 used, 1 merged, reordered" in str(exact.report) and "through every point" in str(exact.report)


def test_the_picture_shows_points_curvature_and_residuals(noisy):
    fit = noisy[0]
    figure = jxr.plotting.fit(fit)
    shape, bend, miss = figure.axes
    drawn = [line.get_xydata() for line in shape.lines]
    assert any(len(d) == N and np.allclose(d, 1e3 * np.asarray(fit.points)) for d in drawn)
    assert "curvature" in bend.get_ylabel()
    ends = [1e3 * float(end) for end in fit.contour.domain()]
    np.testing.assert_allclose(bend.lines[1].get_xdata()[[0, -1]], ends, atol=1e-12)
    residuals = miss.lines[-1].get_ydata()
    assert np.sqrt(np.mean(residuals**2)) == pytest.approx(1e6 * fit.report.rms, rel=1e-6)
    outside = off_ellipse(np.asarray(fit.points))
    assert np.corrcoef(residuals, outside)[0, 1] > 0.8


def test_support_function_field():
    """Exact points of an ellipse, and noisy ones, where few terms must do."""
    u = 2 * np.pi * np.arange(96) / 96
    dots = np.stack([0.02 * np.cos(u), 0.019 * np.sin(u)], -1)
    exact = jxr.fit_contour(dots, field="support").report
    assert exact.largest < 1e-10 and abs(exact.radius - 0.01805) < 1e-8
    noisy = dots + 1e-5 * np.random.default_rng(0).normal(size=dots.shape)
    report = jxr.fit_contour(noisy, field="support", noise=1e-5).report
    assert report.rms < 1.2e-5 and abs(report.radius - 0.01805) < 0.03 * 0.01805
    with pytest.raises(ValueError, match="are for splines"):
        jxr.fit_contour(dots, field="support", smoothing=0.01)


@pytest.mark.parametrize(
    ("noise", "count", "tried"),
    [
        (1.3e-4, 96, [3, 4, 6, 8]),  # the first that leaves no more than the noise
        (6e-5, 96, [3, 4, 6, 8, 11, 15, 20]),
        (1e-5, 96, [3, 4, 6, 8, 11, 15, 20]),  # no more terms than that, whatever is left
        (1e-5, 31, [3, 4, 6, 8, 10]),  # a third of the points
        (0.0, 96, [20]),
        (None, 31, [10]),
        (None, 30, [9]),  # three numbers to a term, and one more
    ],
)
def test_numbers_of_terms_are_tried_in_turn(monkeypatch, noise, count, tried):
    """As if residuals fell with the number of terms: 1 mm over it."""
    terms = []
    fields = SimpleNamespace(through=lambda points, terms: terms)
    monkeypatch.setattr(_contour_fit, "SupportFunction", fields)
    ready = lambda found: terms.append(found) or SimpleNamespace(read=lambda: found)  # noqa: E731
    monkeypatch.setattr(_contour_fit, "tabled", ready)
    monkeypatch.setattr(_contour_fit, "measured_contour", lambda found, at: (0, np.full(9, 1e-3 / found)))
    wish = _contour_fit._Wish(closed=True, noise=noise, smoothing=None, knots=None)
    assert _contour_fit._support(np.zeros((count, 2)), wish) == (tried[-1], 0.0)
    assert terms == tried


@pytest.mark.slow
def test_network_field():
    u = 2 * np.pi * np.arange(96) / 96
    dots = np.stack([0.02 * np.cos(u), 0.014 * np.sin(u)], -1)
    report = jxr.fit_contour(dots, field="support network").report
    assert report.largest < 1e-6 and abs(report.radius - 0.0098) < 0.02 * 0.0098


def test_every_spline_that_is_made_is_tried(monkeypatch):
    contour, made, tried, init = jxr.Spline(1e-3 * ELLIPSE), [], [], jxr.Spline.__init__

    def noted(self, *given, **options):
        made.append(options["cells"])
        init(self, *given, **options)

    def refused(contour):
        tried.append(contour.cells)
        raise ValueError("argument cells must be more")

    monkeypatch.setattr(jxr.Spline, "__init__", noted)
    monkeypatch.setattr(_contour_fit, "tabled", refused)
    with pytest.raises(ValueError, match="bends more sharply"):
        _contour_fit._resolved(contour)
    assert len(made) > 1 and tried == [1024, *made]
