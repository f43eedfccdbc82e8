"""Splines through points: closed forms, SciPy's splines, noise, gradients, and bad points."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline, make_interp_spline

import jaxroll as jxr
from jaxroll.geometry import frenet, smoothing_for, tabled
from jaxroll.geometry.contours._bspline import basis
from tests.measures import both_ways, observed_order
from tests.oracles.known_curves import circle_points, ellipse_errors, ellipse_points, RADIUS
from tests.recorded import runs

FULL_TURN = np.linspace(0.0, 2.0 * np.pi, 25)  # its end is its start, to rounding


def test_ellipse_from_64_points():
    """The row of the accuracy table; the order is observed from 64 to 96 points."""
    counts = np.array([64, 96])
    errors = np.array([ellipse_errors(jxr.Spline(ellipse_points(n))) for n in counts])
    assert np.all(errors[0] <= [1e-9, 1e-8, 1e-6])
    orders = [-observed_order(counts, e) for e in errors.T]
    print("ellipse, 64 points:", errors[0], "orders:", orders)
    assert np.all(np.array(orders) > [5.8, 4.8, 3.8])


def test_degree_seven_is_finer():
    assert np.all(np.array(ellipse_errors(jxr.Spline(ellipse_points(64), degree=7))) <= [1e-11, 1e-9, 1e-7])


@pytest.mark.parametrize(("degree", "closed"), [(3, True), (5, True), (5, False), (7, False)])
def test_basis_is_scipys(degree, closed):
    rng = np.random.default_rng(degree)
    u = np.cumsum(rng.uniform(0.5, 1.5, 15))
    data = rng.normal(size=(15, 2))
    if closed:
        data[-1] = data[0]
    oracle = make_interp_spline(u, data, k=degree, bc_type="periodic" if closed else None)
    fine = np.linspace(u[0], u[-1], 200)

    @jax.jit
    def through(u, data):
        functions = basis(u, degree, closed=closed)
        values = functions.matrix(u[: functions.count])
        pieces = functions.pieces(jnp.linalg.solve(values, data[: functions.count]))
        return pieces.curve(jnp.asarray(fine)).array()

    np.testing.assert_allclose(through(u, data), oracle(fine), atol=1e-11)


def test_roughness_is_the_integral():
    u = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 12))
    roughness = np.asarray(jax.jit(lambda u: basis(u, 5, closed=False).roughness())(u))
    coefficients = np.random.default_rng(2).normal(size=12)
    interior = u[3:-3]
    oracle = BSpline(np.r_[[u[0]] * 6, interior, [u[-1]] * 6], coefficients, 5).derivative(3)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    breaks = np.r_[u[0], interior, u[-1]]
    half = 0.5 * np.diff(breaks)
    at = breaks[:-1, None] + half[:, None] * (1 + nodes)
    integral = np.sum(half[:, None] * weights * oracle(at) ** 2)
    np.testing.assert_allclose(coefficients @ roughness @ coefficients, integral, rtol=1e-10)


def long_arc(count):
    """Half an ellipse with 10 um of noise, 54 mm long."""
    u = np.linspace(0.0, np.pi, count)
    noise = 1e-5 * np.random.default_rng(7).normal(size=(count, 2))
    return np.stack([0.02 * np.cos(u), 0.014 * np.sin(u)], axis=1) + noise


fit_at = eqx.filter_jit(lambda contour, u: contour._fit(u))


@pytest.mark.parametrize("wave", [0.01, 0.05, 0.1])
def test_smoothing_is_exact_however_long_the_wavelength(wave):
    """Against least squares by rotations, whose condition is the square root of that of normal equations."""
    points = long_arc(300)
    contour = jxr.Spline(points, closed=False, smoothing=wave)
    u = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    knots = np.r_[[u[0]] * 6, u[3:-3], [u[-1]] * 6]
    basis_of = BSpline(knots, np.eye(300), 5)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    breaks = np.r_[u[0], u[3:-3], u[-1]]
    half = 0.5 * np.diff(breaks)
    third = basis_of.derivative(3)((breaks[:-1, None] + half[:, None] * (1.0 + nodes)).ravel())
    root = (wave / (2.0 * np.pi)) ** 3 / np.sqrt(u[-1]) * np.sqrt(np.outer(half, weights)).reshape(-1, 1)
    rows = np.concatenate([basis_of(u) / np.sqrt(300), root * third])
    q, r = np.linalg.qr(rows)
    exact = np.linalg.solve(r, q[:300].T @ points / np.sqrt(300))
    pieces = fit_at(contour, jnp.asarray(u))
    middles = 0.5 * (breaks[1:] + breaks[:-1])
    found = np.asarray(pieces.curve(jnp.asarray(middles)).array())
    # The rotations themselves are good to 1e-10 of the size here.
    np.testing.assert_allclose(found, BSpline(knots, exact, 5)(middles), rtol=0.0, atol=4e-12)


@pytest.mark.parametrize("noise", [1e-5, None])
def test_how_much_is_smoothed_does_not_depend_on_where_the_origin_is(noise):
    near, far = (smoothing_for(long_arc(80) + away, closed=False, noise=noise) for away in (0.0, 100.0))
    assert far == pytest.approx(near, rel=1e-9)


def _measured(contour):
    """Of a place a third of the way along a contour: curvature, point and tangent in one number."""
    ready = contour.prepared()
    frame = ready.frame(0.37 * ready.domain()[1])
    return frame.curvature + 10.0 * frame.point.x + frame.tangent.y


# That number of an open contour, its derivative along a direction of points and wavelength, and in each.
SMOOTHED = both_ways(lambda given: _measured(jxr.Spline(**given, closed=False, origin=40, cells=64)))
NUMBER = np.arange(100.0)[:, None]
WAYS = {
    "noise": 1e-6 * np.random.default_rng(1).normal(size=(100, 2)),
    "waves": 1e-5 * np.cos(0.1 * NUMBER + 0.002 * NUMBER**2 * [1.0, -1.0] + [0.3, 1.2]),
}


@pytest.mark.parametrize(
    ("smoothing", "along", "differences", "modes"),
    [(0.15, "noise", 1e-5, 1e-5), (0.03, "waves", 1e-7, 1e-9)],
)
def test_derivatives_in_points_and_wavelength(smoothing, along, differences, modes):
    """Both modes and differences of fourth order; without refinement there is no solution at all here."""
    x = {"points": long_arc(100), "smoothing": smoothing}
    way = {"points": WAYS[along], "smoothing": 1e-3 * smoothing}
    moved = lambda k: SMOOTHED({name: x[name] + k * way[name] for name in x}, way, 1.0)  # noqa: E731
    _, forward, slopes = moved(0.0)
    near, far = (float(moved(k)[0] - moved(-k)[0]) for k in (1.0, 2.0))
    central = (8.0 * near - far) / 12.0
    reverse = sum(np.sum(np.asarray(slopes[name]) * way[name]) for name in x)
    np.testing.assert_allclose(forward, central, rtol=differences)
    np.testing.assert_allclose(reverse, forward, rtol=modes)


def test_forward_derivatives_of_a_smoothing_spline_in_all_directions_at_once():
    """As `jax.jacfwd`, `identify` and designs of few numbers take them; traced, not compiled."""
    measured = lambda points: _measured(jxr.Spline(points, smoothing=0.01, cells=64))  # noqa: E731
    assert jax.eval_shape(jax.jacfwd(measured), jnp.asarray(circle_points())).shape == circle_points().shape


def test_smoothing_too_long_for_its_knots_is_refused_or_unresolved():
    points = long_arc(300)
    far = jxr.Spline(points, closed=False, smoothing=1.0)
    with pytest.raises(ValueError, match="argument smoothing must be shorter for 300 knots .* was 1.0 m"):
        tabled(far)
    with pytest.raises(ValueError, match="argument smoothing must be shorter for 300 knots"):
        runs.scene("pivoted")[0].with_tip(0, far)
    with pytest.raises(ValueError, match="at most half the length of a closed contour, 0.0628 m, .* 0.07 m"):
        tabled(jxr.Spline(circle_points(), smoothing=0.07))
    # Within a program nothing can be refused: its numbers are lost.
    given = {"points": long_arc(100), "smoothing": 3.0}
    assert np.isnan(SMOOTHED(given, given, 1.0)[0])
    # With fewer knots it is the parabola that every long wavelength gives.
    ends = [jxr.Spline(points, closed=False, smoothing=wave, knots=20) for wave in (1.0, 1.5)]
    s = np.linspace(0.0, 0.05, 20)
    bends = [np.asarray(tabled(end).curvature(s)) for end in ends]
    np.testing.assert_allclose(bends[0], bends[1], rtol=1e-5)


@pytest.mark.parametrize("noise", [1e-6, None])
def test_noisy_circle(noise):
    """200 points with 1 um noise on a 10 mm circle: curvature within 1 %."""
    dots = circle_points() + 1e-6 * np.random.default_rng(3).normal(size=(200, 2))
    disc = jxr.Spline(dots, smoothing=smoothing_for(dots, noise=noise)).prepared()
    s = np.linspace(0, float(disc.domain()[1]), 1000)
    worst = np.abs(np.asarray(disc.curvature(s)) * RADIUS - 1).max()
    print("curvature of the noisy circle within", worst)
    assert worst <= 0.01
    assert np.abs(np.asarray(jxr.Spline(dots).curvature(s)) * RADIUS - 1).max() > 0.1  # unsmoothed


def test_smoothing_halves_its_wavelength():
    u = 2 * np.pi * np.arange(200) / 200
    ripple = 1e-6 * np.cos(12 * u)
    dots = (RADIUS + ripple)[:, None] * np.stack([np.cos(u), np.sin(u)], -1)
    wave = 2 * np.pi * RADIUS / 12
    smooth = jxr.Spline(dots, smoothing=wave)
    s = float(smooth.domain()[1]) * np.arange(200) / 200
    left = np.linalg.norm(np.asarray(smooth.point(s)), axis=1)
    amplitude = 2 * np.mean(left * np.cos(12 * u))
    np.testing.assert_allclose(amplitude, 0.5e-6, rtol=0.02)


def test_fewer_knots_than_points():
    dots = ellipse_points(400)
    slim = jxr.Spline(dots, knots=64)
    assert np.all(np.array(ellipse_errors(slim)) <= [1e-7, 3e-6, 2e-4])


def test_open_spline_has_its_origin_and_ends():
    a = 0.02
    s = np.linspace(-0.03, 0.03, 65)
    exact = jxr.Catenary(a)
    bow = jxr.Spline(exact.point(s), closed=False, origin=32).prepared()
    start, end = bow.domain()
    np.testing.assert_allclose([start, end], [-0.03, 0.03], atol=1e-10)
    at = np.linspace(-0.03, 0.03, 333)
    np.testing.assert_allclose(bow.point(at), exact.point(at), atol=3e-10)
    np.testing.assert_allclose(bow.curvature(at[20:-20]), exact.curvature(at[20:-20]), rtol=1e-5)
    assert not bow.closed and bow.smoothness == 4


@pytest.mark.parametrize(("closed", "origin"), [(True, 0), (True, 5), (False, 6)])
def test_a_spline_is_made_symmetric_about_its_origin(closed, origin):
    """Each point becomes the mean of its own and of the mirror image of its partner on the other side."""
    points = np.random.default_rng(2).normal(size=(13, 2))
    found = np.asarray(jxr.Spline(points, closed=closed, origin=origin).symmetrised().points)
    for k in range(7):
        one, other = (origin + k) % 13, (origin - k) % 13
        np.testing.assert_allclose(found[one], 0.5 * (points[one] + points[other] * [1.0, -1.0]))
        np.testing.assert_allclose(found[other], found[one] * [1.0, -1.0])


def test_table_is_by_arclength_and_closes():
    contour = jxr.Spline(ellipse_points(32), cells=256).prepared()
    length = float(contour.domain()[1])
    s = np.linspace(0.0, length, 700)
    np.testing.assert_allclose(contour.point(s + length), contour.point(s), atol=1e-15)
    np.testing.assert_allclose(contour.point(s - 3 * length), contour.point(s), atol=1e-15)
    auto = jax.jit(jax.vmap(lambda s: frenet(contour.curve, s)))(s)
    np.testing.assert_allclose(np.hypot(auto.tangent.x, auto.tangent.y), 1.0, atol=1e-9)
    given = contour.curvature(s)
    turned = np.stack([auto.tangent.x, auto.tangent.y], axis=-1)
    np.testing.assert_allclose(turned, contour.tangent(s), atol=1e-9)
    np.testing.assert_allclose(auto.curvature, given, rtol=1e-6)
    coarse = jxr.Spline(ellipse_points(32), cells=128).table_error()
    fine = contour.table_error()
    assert coarse.point > 20 * fine.point and coarse.curvature > 6 * fine.curvature
    reference = jxr.Spline(ellipse_points(32), cells=4096).prepared()
    true = np.abs(given - reference.curvature(s)).max()
    assert fine.curvature * 0.5 < true < fine.curvature * 1.2


def test_a_contours_table_is_built_once():
    contour = jxr.Spline(ellipse_points(32), cells=256)
    placed = contour.moved(angle=0.3)
    assert tabled(contour).table.coefficients is tabled(placed).contour.table.coefficients
    assert tabled(contour) is tabled(contour) and tabled(placed) is tabled(placed)
    ready = contour.prepared()
    assert tabled(ready) is ready


@pytest.mark.parametrize(
    ("points", "options", "message"),
    [
        (ellipse_points(5), {}, "at least 6 points"),
        (ellipse_points(30)[::-1], {}, "counter-clockwise"),
        (np.vstack([ellipse_points(30), ellipse_points(30)[:1]]), {}, "must not repeat a point"),
        (
            RADIUS * np.stack([np.cos(FULL_TURN), np.sin(FULL_TURN)], -1),
            {},
            "24 and 0 are the same to rounding",
        ),
        (np.full((30, 2), np.nan), {}, "must be finite"),
        (np.zeros((30, 3)), {}, "shape"),
        (ellipse_points(30), {"degree": 4}, "degree"),
        (ellipse_points(30), {"origin": 30}, "origin"),
        (ellipse_points(30), {"knots": 31}, "knots"),
        (ellipse_points(30), {"smoothing": -1.0}, "smoothing"),
    ],
)
def test_bad_points(points, options, message):
    with pytest.raises(ValueError, match=message) as caught:
        jxr.Spline(points, **options)
    assert str(caught.value).startswith("argument ")
