"""Steps of fits of curves: rounds of bounded curves, how much is smoothed, what departs, and what is said."""

import types
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.sparse import csr_matrix

import jaxroll as jxr
from jaxroll._results import check_length
from jaxroll.geometry import tabled
from jaxroll.geometry.fitting import (
    _bounded_curve,
    _contour_fit,
    _departures,
    _fit_report,
    _limited_fit,
)
from jaxroll.geometry.fitting._band import Band
from jaxroll.geometry.fitting._even_spline import EvenSpline
from tests.helpers import refused
from tests.subjects.polygons import on_circle, path, row, wavy


def bumps(u, pieces, closed, order=0):
    """Derivatives of displacements' cardinal splines at places u, one column each."""
    bump = BSpline.basis_element(np.arange(-3.0, 4.0), extrapolate=False)
    bump = bump.derivative(order) if order else bump
    each = np.nan_to_num(bump(u[:, None] - np.arange(-2, pieces + 3)))
    if not closed:
        return each
    numbers = np.arange(-2, pieces + 3) % pieces
    return np.stack([each[:, numbers == j].sum(axis=1) for j in range(pieces)], axis=1)


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("stride", ["short", "long"])
def test_a_round_minimises_the_form_of_the_docstring(closed, stride, monkeypatch):
    """Its matrices against dense ones, term by term; a displacement may not be longer than 0.3 radii."""
    rng, noise, bound, wavelength = np.random.default_rng(1), 2e-4, 40.0, 0.011
    curve = EvenSpline(wavy(17, closed), closed)
    pieces, count = curve.pieces, 60
    u = rng.uniform(0.1, pieces - 0.1, count)
    away, weights = 1e-3 * rng.normal(size=count), rng.uniform(0.2, 1.0, count)
    line = curve.nodes + 4e-4 * rng.normal(size=curve.nodes.shape)
    line[3] += 5e-3
    from scipy.spatial import KDTree

    seen, size = {}, pieces if closed else pieces + 5
    w = (1e-3 if stride == "short" else 3e-2) * rng.normal(size=size)

    def minimum(form, pull, bend, now, bound, rho, *, closed):
        seen.update(
            form=form.toarray(), pull=pull, bend=bend.toarray(), now=now, given=(bound, closed), rho=rho
        )
        return w

    monkeypatch.setattr(_bounded_curve, "_minimum", minimum)
    places = _bounded_curve._places(curve)
    moved, longest = _bounded_curve._moved(
        curve, u, away, weights, KDTree(line), places, bound, noise, wavelength
    )
    halves = 0.5 * np.arange(2 * pieces + (0 if closed else 1))
    frame = curve.frames(halves)
    spacing = np.mean(frame.speed)
    length = pieces * spacing
    bend = bumps(halves, pieces, closed, 2) / spacing**2 + frame.curvature[:, None] ** 2 * bumps(
        halves, pieces, closed
    )
    turn = lambda x: np.diff(x, axis=0, append=x[:1]) if closed else np.diff(x, axis=0)  # noqa: E731
    # d kappa / ds at steps of half a spacing, and the integral over them.
    rate, steps = turn(bend) / (0.5 * spacing), 0.5 * spacing
    price = count / length * (wavelength / (2.0 * np.pi)) ** 6
    normals = frame.normal[::2]
    nearest = np.argmin(np.linalg.norm(curve.nodes[:, None] - line, axis=2), axis=1)
    aside = np.sum((line[nearest] - curve.nodes) * normals, axis=1)
    held = 0.03 * count / pieces * np.minimum(1.0, 2.0 * noise / np.abs(aside))
    assert np.any(held < held.max()) and np.sum(held == held.max()) > 3
    at, nodes = bumps(u, pieces, closed), bumps(np.arange(len(curve.nodes)), pieces, closed)
    form = at.T @ (weights[:, None] * at) + nodes.T @ (held[:, None] * nodes) + price * steps * rate.T @ rate
    pull = at.T @ (weights * away) + nodes.T @ (held * aside)
    pull -= price * steps * rate.T @ turn(frame.curvature) / (0.5 * spacing)
    for name, wanted in (("bend", bend), ("form", form), ("pull", pull), ("now", frame.curvature)):
        np.testing.assert_allclose(seen[name], wanted, rtol=1e-9, atol=1e-10 * np.abs(wanted).max())
    assert seen["given"] == (bound, closed)
    # One standard deviation of all points is the price of passing the bound by a hundredth everywhere.
    assert seen["rho"] == pytest.approx(count / pieces * (noise / (0.01 * bound)) ** 2, rel=1e-12)
    way = nodes @ w
    assert longest == pytest.approx(np.abs(way).max(), rel=1e-12)
    assert (longest > 0.3 / bound) == (stride == "long")
    way *= min(1.0, 0.3 / bound / longest)
    np.testing.assert_allclose(moved.nodes, curve.nodes + way[:, None] * normals, rtol=1e-12, atol=1e-15)
    assert moved.closed == closed


@pytest.mark.parametrize("stop", [None, 16, 3])
def test_rounds_go_on_until_the_curve_stays_and_weights_are_kept_after_a_dozen(stop, monkeypatch):
    """25 rounds at most; the last moves the curve by less than a twentieth of the noise."""
    noise, rounds, start = 1e-3, [], EvenSpline(on_circle(20, 1.0), closed=True)
    points = on_circle(60, 1.0) * (1.0 + 0.01 * np.random.default_rng(2).normal(size=(60, 1)))
    points[7] *= 1.2

    def moved(curve, feet, away, weights, line, places, bound, given, wavelength):
        rounds.append((away, weights, bound, given, wavelength))
        way = 0.049 * noise if len(rounds) == stop else 0.051 * noise
        return EvenSpline(curve.nodes * 1.001, closed=True), way

    monkeypatch.setattr(_bounded_curve, "_moved", moved)
    found = _bounded_curve.bounded_curve(points, start, line=points, bound=3.0, noise=noise, wavelength=0.2)
    assert len(rounds) == (stop or 25) and len(found.curve.nodes) == 20
    # The weights: one up to twice the noise or the median distance, then falling with the third power.
    tail = 0.0
    for k, (away, weights, *rest) in enumerate(rounds):
        assert rest == [3.0, noise, 0.2]
        if k < 12:
            tail = 2.0 * np.median(np.abs(away))
            wanted = np.minimum(1.0, tail / np.abs(away)) ** 3
        np.testing.assert_allclose(weights, wanted, rtol=1e-12)
    assert tail > 2.0 * noise and np.min(wanted) < 0.1
    reach = 1.0 * 1.001 ** len(rounds)
    np.testing.assert_allclose(found.distances, reach - np.linalg.norm(points, axis=1), atol=1e-4)
    np.testing.assert_allclose(found.curve.frames(found.feet).point, reach * points / np.linalg.norm(
        points, axis=1, keepdims=True), atol=1e-4)  # fmt: skip


def test_points_within_twice_the_noise_count_fully(monkeypatch):
    """Where most are nearer than that, the noise is the measure."""
    start, weighed = EvenSpline(on_circle(20, 1.0), closed=True), []
    monkeypatch.setattr(_bounded_curve, "_moved", lambda *given: (weighed.append(given[3]), (start, 0.0))[1])
    points = on_circle(40, 1.0)
    points[[3, 4, 5]] *= np.array([1.019, 1.021, 0.96])[:, None]
    _bounded_curve.bounded_curve(points, start, line=points, bound=3.0, noise=0.01, wavelength=0.2)
    (weights,) = weighed
    wanted = np.ones(40)
    wanted[4:6] = (0.02 / 0.021) ** 3, 0.5**3
    np.testing.assert_allclose(weights, wanted, atol=2e-3)


def test_what_neither_points_nor_bound_see_is_not_displaced():
    form, bend = np.diag([2.0, 3.0, 0.0, 5.0]), np.zeros((1, 4))
    pull = np.array([1.0, -6.0, 0.0, 2.5])
    given = csr_matrix(form + np.diag([1e-3] * 3, 1) * 0.0), pull, csr_matrix(bend), np.zeros(1), 1.0, 1.0
    found = _bounded_curve._minimum(*given, closed=False)
    np.testing.assert_allclose(found, [0.5, -2.0, 0.0, 0.5], rtol=1e-6)


def test_the_sharpest_curvature_is_looked_for_at_sixteenths_of_a_piece():
    curve = EvenSpline(wavy(23, True), closed=True)
    u = np.arange(16 * 23 + 1) / 16.0
    rate, bend = curve.curve(np.mod(u, 23.0), 1), curve.curve(np.mod(u, 23.0), 2)
    bends = (rate[:, 0] * bend[:, 1] - rate[:, 1] * bend[:, 0]) / np.hypot(*rate.T) ** 3
    found = _bounded_curve.Bounded(curve, np.zeros(0), np.zeros(0)).sharpest()
    assert found == pytest.approx(np.abs(bends).max(), rel=1e-12)
    turned = _bounded_curve.Bounded(EvenSpline(curve.nodes[::-1], closed=True), np.zeros(0), np.zeros(0))
    assert turned.sharpest() == pytest.approx(found, rel=1e-9)


@pytest.mark.parametrize("closed", [True, False])
def test_arclengths_are_sums_over_sixteenths_and_feet_are_at_right_angles(closed):
    spline = EvenSpline(wavy(30, closed), closed)
    u, along = spline.arclengths()
    np.testing.assert_allclose(u, np.arange(16 * spline.pieces + 1) / 16.0, rtol=1e-14)
    speeds = np.linalg.norm(spline.curve(u, 1), axis=1)
    np.testing.assert_allclose(along[-1], np.trapezoid(speeds, u), rtol=1e-12)
    assert len(along) == len(u) and along[0] == 0.0
    points = spline.frames(np.linspace(0.3, spline.pieces - 0.3, 77)).point + (1e-3, -8e-4)
    frame = spline.frames(spline.feet(points))
    away = points - frame.point
    inner = np.abs(np.sum(away * frame.normal, axis=1)) > 0.0
    ahead = away[:, 0] * frame.normal[:, 1] - away[:, 1] * frame.normal[:, 0]
    inside = (spline.feet(points) > 0.0) & (spline.feet(points) < spline.pieces)
    assert inner.all() and np.abs(ahead[inside]).max() < 1e-9


# How much is smoothed with a smallest radius.

ASKED = _limited_fit.Wanted(True, None, False, 0.01, None, None, None)


def ready(points, noise=0.0, wanted=ASKED, start=None, **more):
    clean: Any = _limited_fit.CleanPoints(points, 0, False, False, ())
    curve = start or EvenSpline(on_circle(40, 0.05), closed=True)
    return _limited_fit.Limited(clean, np.zeros((0, 2)), points, curve, noise, wanted, **more)


LENGTH = float(EvenSpline(on_circle(40, 0.05), closed=True).arclengths()[1][-1])


@pytest.mark.parametrize("longer", [1.0, 2.25])
@pytest.mark.parametrize(("count", "noise", "wavelength"), [
    (1000, 1e-4, 2e-3 * np.pi),  # 2 pi (noise times radius)^(1/2), five points at least
    (1000, 1e-6, 2e-3 * np.pi * 0.5**0.5),  # half a hundredth of the radius at least
    (200, 1e-4, 5.0 * LENGTH / 200),
    (100, 1e-4, 1.5 * 2e-3 * np.pi),  # half as much again at most
])  # fmt: skip
def test_wavelengths_that_a_radius_asks_for(count, noise, wavelength, longer):
    found = ready(np.zeros((count, 2)), noise, longer=longer)
    assert found.sparse == pytest.approx(5.0 * LENGTH / count, rel=1e-12)
    assert found.wavelength == pytest.approx(longer * wavelength, rel=1e-12)
    assert replace(found, wanted=replace(ASKED, smoothing=0.123)).wavelength == 0.123
    assert found._felt == max(noise, 5e-6)
    assert found.onwards(types.SimpleNamespace(curve=3)).start == 3


@pytest.mark.parametrize("closed", [True, False])
def test_a_fit_is_made_where_discs_roll_and_measured_where_the_points_are(closed, monkeypatch):
    """The closed curve begins next to the first point; on its left distances are positive."""
    wanted = replace(ASKED, closed=closed)
    start = (
        EvenSpline(on_circle(40, 0.05), closed=True)
        if closed
        else EvenSpline(row(*[0.01] * 39), closed=False)
    )
    out = np.linspace(0.9, 1.1, 50)
    points = (
        on_circle(50, 0.05, 2.0 * np.pi * 10.3 / 40) * out[:, None]
        if closed
        else row(*[0.007] * 49, height=3e-3)
    )
    given, calls = ready(points, 2e-4, wanted, start), []

    def rolled(*args, **options):
        calls.append((args, options))
        return "points", "line"

    def bounded(*args, **options):
        calls.append((args, options))
        return _bounded_curve.Bounded(start, np.zeros(50), np.zeros(50))

    monkeypatch.setattr(_limited_fit, "rolled_line", rolled)
    monkeypatch.setattr(_limited_fit, "bounded_curve", bounded)
    found = given.solved(0.8)
    assert calls[0] == ((given.clean.points, given.line, 0.01, 2e-4), {"closed": closed})
    options = {"line": "line", "bound": 0.8 / 0.01, "noise": 2e-4, "wavelength": given.wavelength}
    assert calls[1] == (("points", start), options)
    if closed:
        np.testing.assert_allclose(found.distances, 0.05 * (1.0 - out), atol=1e-7)
        np.testing.assert_allclose(found.curve.nodes[0], points[0] / out[0], atol=1e-7)
        np.testing.assert_allclose(
            found.curve.nodes[1], on_circle(40, 0.05, 2.0 * np.pi * 10.3 / 40)[1], atol=1e-7
        )
        away = (found.feet - np.arange(50) * 40 / 50 + 20.0) % 40.0 - 20.0
        assert found.feet[0] == 0.0 and np.abs(away).max() < 1e-4
    else:
        np.testing.assert_allclose(found.distances, 3e-3, rtol=1e-9)
        np.testing.assert_allclose(found.feet, 0.7 * np.arange(50), rtol=1e-9, atol=1e-9)
        assert found.curve is start


@pytest.mark.parametrize(("noise", "scale"), [(None, 2.5e-3), (5e-4, 2.5e-3), (7e-4, 2.8e-3)])
def test_points_are_put_in_order_on_a_quarter_of_the_radius_or_four_noises(noise, scale, monkeypatch):
    asked = []

    def found_band(points, given, *, closed, ordered):
        asked.append((given, closed, ordered))
        return Band(points[::2], np.arange(len(points))[1:], np.array([0]), reordered=False)

    monkeypatch.setattr(_limited_fit, "found_band", found_band)
    monkeypatch.setattr(_limited_fit, "_judged", lambda found: found)
    points = on_circle(120, 0.05)
    wanted = replace(ASKED, noise=noise, ordered=True)
    found = _limited_fit.limited(np.concatenate([points, points[5:9]]), wanted)
    assert asked == [(pytest.approx(scale, rel=1e-12), True, True)]
    assert found.noise == (noise or 0.0) and found.wanted == wanted and found.longer == 1.0
    np.testing.assert_array_equal(found.clean.points, points[1:])
    np.testing.assert_array_equal(found.strays, points[:1])
    assert (found.clean.merged, found.clean.reordered, found.clean.reversed) == (4, False, False)
    assert found.clean.warnings == ()


@pytest.mark.parametrize("ordered", [None, False])
@pytest.mark.parametrize("reordered", [True, False])
def test_an_order_that_was_given_up_is_told_where_it_might_have_been_kept(ordered, reordered, monkeypatch):
    asked = []
    band = lambda points, *_, **__: Band(points, np.arange(len(points)), np.zeros(0, int), reordered)  # noqa: E731
    monkeypatch.setattr(_limited_fit, "found_band", band)
    monkeypatch.setattr(_limited_fit, "_judged", lambda found: found)
    monkeypatch.setattr(_limited_fit, "order_given_up", lambda *_, closed: (asked.append(closed), ["so"])[1])
    found = _limited_fit.limited(on_circle(120, 0.05), replace(ASKED, ordered=ordered))
    assert found.clean.warnings == (("so",) if reordered and ordered is None else ())
    assert found.clean.reordered == reordered and asked == [True] * len(found.clean.warnings)


def judged(distances, monkeypatch, noise=None, radius=0.01, off=0.0, **changes):
    """What is kept of points on a circle, if the curve through them is at these distances."""
    count = len(distances)
    points = on_circle(count, 0.05) * (1.0 + np.asarray(off) / 0.05)
    curve = EvenSpline(on_circle(40, 0.05), closed=True)
    asked = []

    def solved(self, share):
        asked.append((share, self.wanted.smoothing, self.noise))
        return _bounded_curve.Bounded(curve, np.arange(count) * 40.0 / count, np.asarray(distances))

    monkeypatch.setattr(_limited_fit.Limited, "solved", solved)
    monkeypatch.setattr(_limited_fit, "_smoothest", lambda found: (asked.append("smoothest"), found)[1])
    wanted = replace(ASKED, noise=noise, radius=radius, **changes)
    return _limited_fit._judged(ready(points, noise or 0.0, wanted)), asked


def test_noise_is_what_neighbours_differ_by_or_share():
    """At most a quarter of the radius."""
    size = 1e-3
    with pytest.MonkeyPatch.context() as patch:
        # All on one side: what neighbours share, by the median.
        shared, _ = judged(np.full(60, size), patch)
        assert shared.noise == pytest.approx(1.4826 * size, rel=1e-9)
        # To and fro: the middle of three is off the line of its neighbours by twice the distance.
        other, _ = judged(size * (-1.0) ** np.arange(60), patch)
        assert other.noise == pytest.approx(1.4826 * 2.0 * size / 1.5**0.5, rel=1e-6)
        most, _ = judged(np.full(60, 0.01), patch)
        assert most.noise == pytest.approx(0.0025, rel=1e-12)
        given, _ = judged(np.full(60, size), patch, noise=3e-4)
        assert given.noise == 3e-4
        # Before that, what the points differ by from the rough curve.
        to_and_fro = size * (-1.0) ** np.arange(60)
        _, asked = judged(np.zeros(60), patch, off=to_and_fro[:, None])
        assert asked[0][2] == pytest.approx(1.4826 * 2.0 * size / 1.5**0.5, rel=1e-4)


@pytest.mark.parametrize(("radius", "count", "smoothing"), [
    (0.03, 1000, 0.03), (0.001, 100, 5.0 * LENGTH / 100), (0.004, 1000, None), (0.001, 100, 0.05),
])  # fmt: skip
def test_the_first_curve_is_as_smooth_as_the_radius_the_points_and_the_noise_ask_for(
    radius, count, smoothing, monkeypatch
):
    """Not to follow every point, of which nothing of the noise would be left."""
    _, ((share, used, noise), *more) = judged(
        np.full(count, 1e-5),
        monkeypatch,
        noise=1e-3,
        radius=radius,
        smoothing=0.05 if smoothing == 0.05 else None,
    )
    felt = 2.0 * np.pi * np.sqrt(1e-3 * radius)
    assert share == 0.97 and noise == 1e-3 and more == ([] if smoothing == 0.05 else ["smoothest"])
    wanted = {0.05: 0.05}.get(smoothing, max(felt, radius, 5.0 * LENGTH / count))
    assert used == pytest.approx(wanted if smoothing != 0.05 else max(0.05, 5.0 * LENGTH / count), rel=1e-9)


@pytest.mark.parametrize("count", [6, 7])
def test_a_tenth_of_the_points_at_most_are_left_out(count, monkeypatch):
    """Of 60 with a noise of a tenth of a millimetre, those six tenths off: six, but not seven."""
    distances = np.zeros(60)
    distances[8 * np.arange(count) + 3] = 7e-4
    found, _ = judged(distances, monkeypatch, noise=1e-4)
    away = distances > 0.0 if count == 6 else np.zeros(60, bool)
    np.testing.assert_array_equal(found.strays, on_circle(60, 0.05)[away])
    np.testing.assert_array_equal(found.clean.points, on_circle(60, 0.05)[~away])
    assert found.start.nodes.shape == (40, 2)


@pytest.mark.parametrize(("sizes", "taken"), [
    ([1.0, 1.0, 1.0, 1.0, 1.0, 1.0], 5), ([1.0, 1.0, 1.2, 1.0, 1.0, 1.0], 1), ([1.0, 1.3], 0),
    ([1.0, 1.05, 1.3], 1),
])  # fmt: skip
def test_wavelengths_grow_while_the_estimate_of_the_error_falls(sizes, taken, monkeypatch):
    """By half each, five times at most; sizes are those of the residuals, in noises."""
    noise, count, tried = 2e-4, 400, []
    signs = (-1.0) ** np.arange(count)

    def solved(self, share):
        k = len(tried)
        tried.append((share, self.longer))
        return _bounded_curve.Bounded(
            EvenSpline((1.0 + k) * on_circle(40, 0.05), True), np.arange(count), noise * sizes[k] * signs
        )

    monkeypatch.setattr(_limited_fit.Limited, "solved", solved)
    first = ready(np.zeros((count, 2)), noise)
    found = _limited_fit._smoothest(first)
    assert found.longer == pytest.approx(1.5**taken, rel=1e-12)
    assert {share for share, _ in tried} == {0.97}
    np.testing.assert_allclose([longer for _, longer in tried], 1.5 ** np.arange(len(tried)))
    assert len(tried) == min(taken + 2, 6)
    np.testing.assert_allclose(found.start.nodes, (1.0 + taken) * on_circle(40, 0.05))
    # Where there is hardly any noise, nothing is tried.
    tried.clear()
    calm = ready(np.zeros((count, 2)), 5e-3 * 0.01)
    assert _limited_fit._smoothest(calm) is calm and not tried


@pytest.mark.parametrize(("gain", "taken"), [(0.98, 0), (1.02, 1)])
def test_the_estimate_is_that_of_mallows(gain, taken, monkeypatch):
    """A wavelength half as long again frees a third of 4 pi / 3 squares of the noise for every wave."""
    noise, count = 2e-4, 400
    first = ready(np.zeros((count, 2)), noise)
    freed = 4.0 * np.pi / 3.0 * noise**2 * LENGTH / first.wavelength / 3.0
    signs = (-1.0) ** np.arange(count)
    # One far off counts nine squares of the noise, before and after.
    both = [signs * noise, signs * np.sqrt(noise**2 + freed / gain / (count - 1))]
    both[0][0], both[1][0] = 4.0 * noise, 50.0 * noise
    both.append(10.0 * both[1])
    left = iter(both)
    curve = EvenSpline(on_circle(40, 0.05), closed=True)
    monkeypatch.setattr(_limited_fit, "_leaning", lambda *_: 0.0)
    monkeypatch.setattr(
        _limited_fit.Limited, "solved", lambda *_: _bounded_curve.Bounded(curve, np.arange(count), next(left))
    )
    assert _limited_fit._smoothest(first).longer == pytest.approx(1.5**taken)


@pytest.mark.parametrize(("leaning", "taken"), [(0.99, 1), (1.01, 0)])
@pytest.mark.parametrize("before", [0.1, 2.0])
def test_neighbours_lean_by_no_more_than_chance_or_as_before(leaning, taken, before, monkeypatch):
    """Three standard deviations of the mean of half a wavelength's points, or what they did before."""
    noise, count = 2e-4, 400
    first = ready(np.zeros((count, 2)), noise)
    together = round(0.5 * first.wavelength / LENGTH * count)
    assert together > 5
    chance = 3.0 * noise / np.sqrt(together)
    limits, asked = iter([before * chance, leaning * max(before, 1.0) * chance, np.inf]), []
    monkeypatch.setattr(_limited_fit, "_leaning", lambda found, n: (asked.append(n), next(limits))[1])
    curve = EvenSpline(on_circle(40, 0.05), closed=True)
    monkeypatch.setattr(
        _limited_fit.Limited,
        "solved",
        lambda *_: _bounded_curve.Bounded(curve, np.arange(count), np.zeros(count)),
    )
    assert _limited_fit._smoothest(first).longer == pytest.approx(1.5**taken)
    assert set(asked) == {together}


def test_no_wavelength_is_longer_than_half_the_curve(monkeypatch):
    """Here the first is 0.4 of it: the next one, 0.6, is not taken."""
    noise = (0.4 * LENGTH / (2.0 * np.pi)) ** 2 / 0.01
    curve = EvenSpline(on_circle(40, 0.05), closed=True)
    monkeypatch.setattr(_limited_fit, "_leaning", lambda *_: 0.0)
    monkeypatch.setattr(
        _limited_fit.Limited,
        "solved",
        lambda *_: _bounded_curve.Bounded(curve, np.arange(400), np.zeros(400)),
    )
    for share, taken in ((0.4, 0), (0.3, 1), (0.21, 2)):
        first = ready(np.zeros((4000, 2)), noise * (share / 0.4) ** 2)
        assert first.wavelength == pytest.approx(share * LENGTH, rel=1e-9)
        assert _limited_fit._smoothest(first).longer == pytest.approx(1.5**taken)
    # Of few points five are looked at together at least.
    few, asked = ready(np.zeros((12, 2)), 1e-4), []
    monkeypatch.setattr(_limited_fit, "_leaning", lambda _, n: (asked.append(n), 0.0)[1])
    monkeypatch.setattr(
        _limited_fit.Limited, "solved", lambda *_: _bounded_curve.Bounded(curve, np.arange(12), np.zeros(12))
    )
    _limited_fit._smoothest(few)
    assert set(asked) == {5}


def test_neighbours_lean_by_the_largest_mean_of_so_many():
    rng = np.random.default_rng(4)
    feet, distances = rng.permutation(50).astype(float), rng.normal(size=50) - 0.3
    found = _limited_fit._leaning(_bounded_curve.Bounded(None, feet, distances), 7)
    along = distances[np.argsort(feet)]
    assert found == pytest.approx(max(abs(along[k : k + 7].mean()) for k in range(44)), rel=1e-12)


def test_noise_by_hand_of_uneven_places():
    """Seven distances, each against the line between its neighbours, whatever the order."""
    u, r = np.array([0.0, 1.0, 1.5, 4.0, 5.0, 7.0, 7.5]), np.array([0.3, -0.2, 0.5, 0.1, -0.4, 0.2, 0.6])
    errors = []
    for k in range(1, 6):
        share = (u[k] - u[k - 1]) / (u[k + 1] - u[k - 1])
        off = r[k] - np.interp(u[k], u[[k - 1, k + 1]], r[[k - 1, k + 1]])
        errors.append(abs(off) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2))
    order = np.array([3, 0, 6, 2, 5, 1, 4])
    assert _limited_fit.estimated_noise(u[order], r[order]) == pytest.approx(
        1.4826 * np.median(errors), rel=1e-12
    )


@pytest.mark.parametrize(("closed", "most"), [(True, 0.02), (False, 0.0592)])
def test_a_disc_has_room_in_half_the_least_width_or_the_extent(closed, most):
    """Of a box of 60 by 40 mm, turned by five of the 64 steps in which widths are taken."""
    turn = 5.0 * np.pi / 64
    box = np.array([(0.0, 0.0), (0.06, 0.0), (0.06, 0.04), (0.0, 0.04)]) + (0.3, 0.1)
    points = box @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    if not closed:
        most = np.ptp(points, axis=0).max()
        assert most > 0.06
    _limited_fit._check_width(
        box - (0.3, 0.1), replace(ASKED, closed=closed, radius=0.02 if closed else 0.06)
    )
    for radius, fits in ((0.999 * most, True), (1.001 * most, False)):
        what = "half the least width of the points" if closed else "the extent of the points"
        with refused(f"must be at most {str(most)[:6]}.* m here, {what}, but was", not fits):
            _limited_fit._check_width(points, replace(ASKED, closed=closed, radius=radius))


def test_points_farther_apart_than_the_radius_are_doubted():
    assert _limited_fit._sparse(row(2.0, 2.0, 5.0), replace(ASKED, radius=2.0)) == []
    for radius, doubted in ((0.0099, True), (0.0101, False)):
        told = _limited_fit._sparse(row(0.01, 0.01, 0.05, 0.01, 0.002), replace(ASKED, radius=radius))
        assert len(told) == doubted and all("The points are 10 mm apart" in text for text in told)


def test_a_closed_band_runs_counter_clockwise_from_the_first_point_used():
    chain = on_circle(12) + (0.1, 0.2)
    order = np.array([5, 9, 2, 7, 11, 4])
    for given, places, against in ((chain, order, False), (chain[::-1], order[::-1], True)):
        found, turned, doubts = _limited_fit._turned(Band(given, places, np.zeros(0, int), True), ASKED)
        np.testing.assert_array_equal(found.chain, chain)
        assert found.indices.tolist() == [2, 7, 11, 4, 5, 9] and turned == against and doubts == ()
        reverse, _, _ = _limited_fit._turned(
            Band(given, places, np.zeros(0, int), True), replace(ASKED, reverse=True)
        )
        assert reverse.indices.tolist() == [2, 7, 11, 4, 5, 9]


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize(("radius", "knots", "nodes", "wave"), [
    (0.01, None, 192, 0.06), (0.012, None, 192, 0.072), (0.009, None, 192, 0.054), (0.0079, None, 256, None),
    (0.1, None, 48, None), (1e-4, None, 1024, None), (0.01, 64, 64, 0.06), (0.01, 65, 96, 0.06),
])  # fmt: skip
def test_a_first_curve_has_five_nodes_to_a_radius_and_is_smoothed_by_six(
    closed, radius, knots, nodes, wave, monkeypatch
):
    """A ring or an arc of about 0.31 m: lengths, numbers of nodes, wavelengths of up to 0.3 of the whole."""
    seen = {}
    chain = on_circle(90, 0.05)

    def rolled(points, line, radius, noise, *, closed):
        seen.update(places=line, noise=noise, radius=radius)
        return points, line

    def low(nodes, length, wave, *, closed):
        seen.update(nodes=nodes, length=length, wave=wave)
        return nodes

    monkeypatch.setattr(_limited_fit, "rolled_line", rolled)
    monkeypatch.setattr(_limited_fit, "low_passed", low)
    monkeypatch.setattr(_limited_fit, "_to_the_ends", lambda points, chain: chain)
    wanted = replace(ASKED, closed=closed, radius=radius, knots=knots)
    places, start = _limited_fit._started(chain, chain, wanted)
    step = 2.0 * 0.05 * np.sin(np.pi / 90)
    length = step * (90 if closed else 89)
    if knots is None:
        first = next((n for n in _limited_fit.NODES if n >= 5.0 * length / radius), 1024)
        assert first == nodes or not closed
        nodes = first
    assert places.shape == (8 * nodes + 1, 2) and len(start.nodes) == nodes and start.closed == closed
    assert (
        seen["places"] is places
        and seen["noise"] == pytest.approx(0.01 * radius)
        and seen["radius"] == radius
    )
    assert seen["length"] == pytest.approx(length, rel=1e-9)
    wave = min(max(6.0 * radius, 2.0 * step), 0.3 * length)
    assert seen["wave"] == pytest.approx(wave, rel=1e-9)
    assert len(seen["nodes"]) == nodes
    np.testing.assert_array_equal(seen["nodes"][0], chain[0])
    np.testing.assert_allclose(seen["nodes"][-1], places[-9] if closed else places[-1], atol=1e-6)
    assert start.closed == closed


def test_an_open_chain_is_continued_to_the_last_points():
    """Straight on, as far as points within two of its steps go along it; not backwards."""
    chain = np.array([(1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (3.0, 1.5)])
    points = np.array([(0.3, 0.4), (-1.0, 0.0), (-1.01, 0.0), (2.5, 0.1), (3.2, 3.4), (2.0, 4.6), (3.1, 1.0)])
    found = _limited_fit._to_the_ends(points, chain)
    np.testing.assert_allclose(found, [(-1.0, 0.0), *chain, (3.0, 3.4)], atol=1e-12)
    found = _limited_fit._to_the_ends(points[[3, 6]], chain)
    np.testing.assert_allclose(found, [chain[0], *chain, chain[-1]], atol=1e-12)


@pytest.mark.parametrize("low", range(9))
def test_numbers_of_nodes_are_a_few(low, monkeypatch):
    """Programs are compiled for each; the next one up is taken, and the largest where none is."""
    nodes = [48, 64, 96, 128, 192, 256, 384, 512, 768, 1024]
    monkeypatch.setattr(_limited_fit, "rolled_line", lambda points, line, *_, **__: (points, line))
    chain = on_circle(30, 0.05)
    for knots, count in ((nodes[low], nodes[low]), (nodes[low] + 1, nodes[low + 1]), (1025, 1024)):
        assert len(_limited_fit._started(chain, chain, replace(ASKED, knots=knots))[1].nodes) == count


# What lies off, where curvature jumps, and how often it changes its sign.


def test_at_their_limits_points_are_neither_off_nor_strays():
    """Of whole numbers: three and six noises, two of the neighbours, gaps of just the radius."""
    feet = np.arange(30.0)
    points = np.stack([feet, 0.0 * feet], axis=1)
    distances = np.zeros(30)
    distances[[10, 11, 14, 15]] = 2.0
    distances[12] = 1.5
    found = _departures.departures(points, feet, distances, closed=True, noise=0.5, radius=3.0)
    assert [(d.start, d.end) for d in found] == [(10.0, 15.0)]
    assert len(_departures.departures(points, feet, distances, closed=True, noise=0.5, radius=2.9)) == 2
    distances[[12, 26, 27, 1, 2]] = 1.5, 2.0, 2.0, 2.0, 2.0
    # Round the seam, 29 long, from 27 to 1 it is 3.
    assert len(_departures.departures(points, feet, distances, closed=True, noise=0.5, radius=3.0)) == 3
    assert len(_departures.departures(points, feet, distances, closed=True, noise=0.5, radius=3.5)) == 2
    off, bending = np.zeros(30), np.zeros(30)
    off[[5, 10, 20]], off[[18, 19, 21, 22]] = (3.0, 4.0, 4.0), 1.0
    options = {"noise": 0.5, "radius": 1.0}
    assert _departures.strays(feet, off, bending, **options).tolist() == [10]
    bending[10] = 0.9
    assert _departures.strays(feet, off, bending, **options).tolist() == []


# Where the curvature jumps.


def turning(curvature, step=1e-3):
    """The turning [deg] between equal steps whose ends lie on a circle of that curvature."""
    return np.degrees(2.0 * np.arcsin(0.5 * curvature * step))


@pytest.mark.parametrize(("angle", "found"), [(9.9, 0), (10.1, 1), (-10.1, 1)])
def test_a_corner_turns_by_ten_degrees(angle, found):
    points = path(*[0.0] * 12, angle, *[0.0] * 12)
    jumps = _departures.jumps(points, np.arange(27.0), closed=False)
    assert len(jumps) == found
    assert all(j.angle == pytest.approx(np.radians(angle), rel=1e-9) for j in jumps)


@pytest.mark.parametrize(("count", "found"), [(19, 0), (20, 1)])
def test_twenty_points_may_have_a_corner(count, found):
    points = path(*[0.0] * 8, 50.0, *[0.0] * (count - 11))
    assert len(points) == count
    assert len(_departures.jumps(points, np.arange(20.0), closed=False)) == found


@pytest.mark.parametrize(("turn", "corner"), [(19.0, False), (20.0, True)])
def test_a_corner_stands_out_from_what_bends_beside_it(turn, corner):
    """A line meets an arc that turns by three degrees a step: beyond half of that, six times as much."""
    points = path(*[0.0] * 15, turn, *[3.0] * 15)
    (jump,) = _departures.jumps(points, np.arange(33.0), closed=False)
    assert (jump.angle != 0.0) == corner
    if corner:
        assert jump.angle == pytest.approx(np.radians(turn - 1.5), rel=1e-3)
        assert jump.place == pytest.approx(tuple(points[16])) and jump.arclength == 16.0
    assert (jump.before, jump.after) == pytest.approx((0.0, np.radians(3.0) * 1e3), rel=1e-3, abs=1e-6)


@pytest.mark.parametrize(("after", "found"), [(101.9, 0), (102.2, 1), (98.1, 0), (97.9, 1)])
def test_a_jump_is_a_fiftieth_of_the_largest_curvature(after, found):
    points = path(*[turning(100.0)] * 20, *[turning(after)] * 20)
    jumps = _departures.jumps(points, np.arange(42.0), closed=False)
    assert len(jumps) == found
    assert all((j.before, j.after) == pytest.approx((100.0, after), rel=1e-6) for j in jumps)


@pytest.mark.parametrize(("size", "found"), [(5.8, 0), (6.2, 1)])
@pytest.mark.parametrize("side", ["before", "after"])
def test_a_jump_is_six_times_what_the_curvature_changes_beside_it(size, found, side):
    """To and fro by 10 per metre on one side, whose middle is 100; steady on the other."""
    unsteady = [turning(105.0 if k % 2 else 95.0) for k in range(24)]
    steady = [turning(100.0 + 10.0 * size)] * 24
    points = path(*(unsteady + steady if side == "before" else steady + unsteady))
    assert len(_departures.jumps(points, np.arange(50.0), closed=False)) == found


@pytest.mark.parametrize(("share", "found"), [(0.98, 1), (1.02, 0)])
def test_noise_may_hide_a_jump(share, found):
    """Twenty times the noise is what a step moves a point by: the jump times its square."""
    points = path(*[0.0] * 20, *[turning(100.0)] * 20)
    noise = share * 100.0 * 1e-6 / 20.0
    assert len(_departures.jumps(points, np.arange(42.0), closed=False, noise=noise)) == found


def test_flags_three_places_apart_are_of_one_run_round_the_seam_too():
    flags, sizes = np.zeros(20, bool), np.arange(20.0)
    flags[[0, 17]] = True
    assert _departures._peaks(flags, sizes, closed=True) == [17]
    flags[[0, 1]] = False, True
    assert _departures._peaks(flags, sizes, closed=True) == [1, 17]


def test_a_natural_radius_is_that_of_a_circle_to_two_digits_downwards():
    """No inflection at any wavelength: the sharpest bend of the least smoothed, whatever the size."""
    for size, radius in ((0.01239, 0.012), (1.998, 1.9), (354.0, 350.0)):
        found = _departures.natural_radius(on_circle(2048, size) + size * np.array([0.2, 3.0]), closed=True)
        assert found == pytest.approx(radius, rel=1e-9)
    assert _departures.natural_radius(row(*[1.0] * 40), closed=False) is None


def test_a_natural_radius_leaves_the_shape_and_not_its_wiggles(monkeypatch):
    """The widest range of wavelengths with as many inflections; its first one tells."""
    tried, counts = [], [9] * 3 + [5] * 7 + [4] * 12 + [2] * 11 + [0] * 7
    curve = on_circle(100, 0.02) + 0.5

    def low(nodes, length, wave, *, closed):
        tried.append((len(nodes), length, wave, closed))
        # The radius is that of the number of the try.
        return on_circle(1024, len(tried) + 0.05)

    monkeypatch.setattr(_departures, "low_passed", low)
    rest = iter(counts)
    monkeypatch.setattr(_departures, "inflections", lambda *_, **__: next(rest))
    # The twelve begin with the eleventh, whose radius is 11.
    assert _departures.natural_radius(curve, closed=True) == pytest.approx(11.0)
    length = 100 * 2.0 * 0.02 * np.sin(np.pi / 100)
    assert {(n, closed) for n, _, _, closed in tried} == {(1024, True)} and len(tried) == 40
    np.testing.assert_allclose([size for _, size, _, _ in tried], length)
    np.testing.assert_allclose(
        [wave for _, _, wave, _ in tried], np.geomspace(length / 50, 0.25 * length, 40)
    )
    for longest, told in ((3, False), (4, True)):
        rest = iter(k // longest for k in range(40))
        tried.clear()
        assert (_departures.natural_radius(curve, closed=True) is not None) == told
    rest = iter([0] * 40)
    tried.clear()
    _departures.natural_radius(curve[:50], closed=False)
    np.testing.assert_allclose([size for _, size, _, _ in tried], 49 * length / 100)


def test_nodes_for_a_natural_radius_are_even_along_the_polygon(monkeypatch):
    seen = []

    def low(nodes, *_, closed):
        seen.append((nodes, closed))
        return nodes

    monkeypatch.setattr(_departures, "low_passed", low)
    corners = np.array([(0.0, 0.0), (3.0, 0.0), (3.0, 1.0)])
    for closed in (True, False):
        seen.clear()
        _departures.natural_radius(corners, closed=closed)
        nodes, given = seen[0]
        lengths = [0.0, 3.0, 4.0, 4.0 + 10.0**0.5][: 4 if closed else 3]
        at = lengths[-1] * np.arange(1024) / (1024 if closed else 1023)
        ends = np.concatenate([corners, corners[:1]])[: len(lengths)]
        np.testing.assert_allclose(
            nodes, np.stack([np.interp(at, lengths, x) for x in ends.T], axis=1), atol=1e-12
        )
        assert given == closed


def test_changes_of_sign_below_a_hundredth_are_rounding():
    bends = np.array([100.0, 5.0, -1.1, 3.0, -1.0, 2.0, -50.0, -2.0])
    assert (
        _departures.inflections(bends, closed=False) == 3 and _departures.inflections(bends, closed=True) == 4
    )
    assert _departures.inflections(-bends[::-1], closed=False) == 3
    assert _departures.inflections(np.zeros(5), closed=True) == 0
    assert _departures.inflections(np.array([1.0, -1.0, 1.0]), closed=True) == 2


# What is said of a contour.

CALM = _fit_report.FitReport(
    field="spline", closed=True, points=5, merged=0, reordered=False, reversed=False, smoothing=0.0, rms=1e-5,
    largest=2e-5, length=0.1, curvature=(20.0, 50.0), radius=0.02, smoothness=4.0, inflections=0,
    self_intersecting=False, smallest_radius=None, noise=None, rejected=(), rounded=(), jumps=(),
    recommendation="", warnings=(),
)  # fmt: skip
LINE = row(0.01, 0.01, 0.03, 0.01)
SPACING = float(np.median(np.diff(LINE[:, 0])))


def said(distances=(1e-5, 2e-5, 1e-5, 0.0, 0.0), **changes):
    return _fit_report.doubts(replace(CALM, **changes), LINE, np.array(distances))


def test_what_is_doubtful_of_a_contour_is_said_beyond_its_limit():
    assert said() == []
    assert "crosses itself" in said(self_intersecting=True)[0]
    # A radius below the median spacing, of a contour whose radius is free.
    assert said(radius=SPACING) == [] and said(radius=0.0099, smallest_radius=0.005) == []
    assert said(radius=0.0099)[0].startswith(
        "The contour bends with a radius of 9.9 mm, less than the points' spacing of 10 mm"
    )
    assert said(inflections=12) == []
    assert (
        "changes sign 13 times" in said(inflections=13)[0] and "noise or smoothing" in said(inflections=13)[0]
    )
    assert "a larger smallest_radius leaves" in said(inflections=13, smallest_radius=0.005)[0]
    # Five times the rms distance, and a thousandth of the spacing.
    assert said((0.0, 0.0, 5e-5, 0.0, 0.0)) == []
    (text,) = said((0.0, 0.0, 5.1e-5, 0.0, 0.0))
    assert text == "The point (0.02, 0) m lies 0.051 mm off the contour, 5.1 times the rms distance."
    assert said((0.0, 0.0, 5.1e-5, 0.0, 0.0), smallest_radius=0.005) == []
    assert (
        said((0.0, 0.0, 0.9e-5, 0.0, 0.0), rms=1e-7) == []
        and len(said((0.0, 0.0, 1.1e-5, 0.0, 0.0), rms=1e-7)) == 1
    )


STRETCHES = tuple(
    _departures.Departure(start, start + 0.01, place, off)
    for start, place, off in ((0.01, (0.1, 0.2), 1e-3), (0.05, (0.3, 0.4), 3e-3), (0.08, (0.5, 0.6), 2e-3))
)
JUMPS = tuple(
    _departures.CurvatureJump(place, 0.01, before, after, angle)
    for place, before, after, angle in (
        ((0.1, 0.2), 0.0, 50.0, 0.0), ((0.3, 0.4), 50.0, -20.0, 0.0), ((0.7, 0.8), 30.0, 0.0, 0.0),
        ((0.5, 0.6), 0.0, 0.0, 0.5), ((0.9, 1.0), 0.0, 0.0, -0.7), ((1.1, 1.2), 0.0, 900.0, 0.6),
    )
)  # fmt: skip


def test_what_was_left_out_and_rounded_is_told_by_its_worst():
    (text,) = said(rejected=((0.1, 0.2), (0.3, 0.4)))
    assert text == "2 points left out as off the contour alone, the first at (0.1, 0.2) m."
    assert said(rejected=((0.1, 0.2),))[0].startswith("1 point left out")
    (text,) = said(rounded=STRETCHES)
    assert "at 3 places, where" in text and "by up to 3 mm, between the arclengths 50 and 60 mm." in text
    assert "at 1 place, where" in said(rounded=STRETCHES[:1])[0]
    assert _fit_report._rounded_text(STRETCHES) == "3 stretches, by up to 3 mm at (0.3, 0.4) m"
    assert _fit_report._rounded_text(STRETCHES[:1]) == "by up to 1 mm at (0.1, 0.2) m"
    assert _fit_report._rounded_text(()) == ""


def test_corners_and_jumps_are_told_by_the_largest():
    (text,) = said(jumps=JUMPS[:3])
    assert "jumps at 3 places, most at (0.3, 0.4) m from 50 to -20 1/m" in text
    (text,) = said(jumps=JUMPS[:1])
    assert "jumps at 1 place, most at (0.1, 0.2) m from 0 to 50 1/m" in text
    assert said(jumps=JUMPS[3:]) == []
    (text,) = said(jumps=JUMPS[3:], smallest_radius=0.005)
    assert "have 3 corners, of up to 40 degrees at (0.9, 1) m, rounded" in text
    assert (
        "have 1 corner, of up to 29 degrees at (0.5, 0.6) m"
        in said(jumps=JUMPS[3:4], smallest_radius=0.005)[0]
    )
    assert len(said(jumps=JUMPS, smallest_radius=0.005)) == 2


def test_what_to_ask_for_instead(monkeypatch):
    asked = []
    monkeypatch.setattr(
        _fit_report, "natural_radius", lambda points, *, closed: asked.append(closed) or 0.0123
    )
    instead = lambda **changes: _fit_report.recommended(replace(CALM, **changes), LINE)  # noqa: E731
    assert instead() == "" and instead(inflections=12, jumps=JUMPS[:3], radius=SPACING) == "" and asked == []
    assert instead(jumps=JUMPS[2:]).startswith(
        "smallest_radius, as the radius that the points' 3 corners are"
    )
    assert "the points' 1 corner are" in instead(jumps=JUMPS[:4])
    for changes in ({"inflections": 13}, {"self_intersecting": True}, {"radius": 0.0099}):
        assert instead(**changes).startswith("smallest_radius=0.012 [m]: no bend")
    assert instead(inflections=13, closed=False) != "" and asked == [True, True, True, False]
    monkeypatch.setattr(_fit_report, "natural_radius", lambda *_, **__: None)
    assert instead(inflections=13) == ""
    # Of other fields nothing; with a radius a smaller one where it rounds, a larger one where it is noisy.
    assert instead(field="support", inflections=13) == instead(field="support", jumps=JUMPS) == ""
    assert instead(smallest_radius=0.005, jumps=JUMPS) == ""
    text = instead(smallest_radius=0.005, rounded=STRETCHES, inflections=13)
    assert text.startswith("a smallest_radius below 0.005 m, if the points at (0.3, 0.4) m are shape")
    for changes in ({"inflections": 13}, {"self_intersecting": True}):
        assert instead(smallest_radius=0.005, **changes).startswith("a smallest_radius above 0.005 m")
    assert instead(smallest_radius=0.005, inflections=12) == ""


# From points to a contour.


def wish(**changes):
    return _contour_fit._Wish(**{"closed": True, "noise": None, "smoothing": None, "knots": None} | changes)


@pytest.mark.parametrize(("count", "given", "smoothing", "knots", "asked"), [
    (512, {}, 0.5, None, True), (513, {}, 0.5, 512, True), (513, {"noise": 1e-4}, 0.5, 512, True),
    (513, {"noise": 0.0}, 0.0, None, False), (513, {"smoothing": 0.0}, 0.0, None, False),
    (513, {"smoothing": 0.2}, 0.2, 512, False), (513, {"knots": 700}, 0.5, 700, True),
    (40, {"noise": 1e-4, "closed": False, "knots": 20}, 0.5, 20, True),
    # Twice round a line of a metre: 300 knots to a wavelength, but eight.
    (513, {"smoothing": 2.01}, 2.01, 299, False), (300, {"smoothing": 2.01}, 2.01, 299, False),
    (299, {"smoothing": 2.01}, 2.01, None, False), (40, {"smoothing": 1e3}, 1e3, 8, False),
    (513, {"smoothing": 2.01, "closed": False}, 2.01, 150, False),
])  # fmt: skip
def test_a_spline_has_512_knots_at_most_where_it_is_smoothed_and_300_to_a_wavelength(
    count, given, smoothing, knots, asked, monkeypatch
):
    seen, made = [], []
    monkeypatch.setattr(_contour_fit, "smoothing_for", lambda points, **options: seen.append(options) or 0.5)
    monkeypatch.setattr(_contour_fit, "Spline", lambda points, **options: made.append(options) or "contour")
    found = wish(**given)
    points = np.stack([np.linspace(0.0, 1.0, count), np.zeros(count)], axis=-1)
    assert _contour_fit._spline(points, found) == ("contour", smoothing)
    assert made == [{"closed": found.closed, "smoothing": smoothing, "knots": knots}]
    assert seen == ([{"closed": found.closed, "noise": found.noise, "knots": knots}] if asked else [])


def test_lengths_lie_between_nothing_and_their_limit():
    for value, fair in (
        (0.0, True),
        (0.2, True),
        (0.201, False),
        (-1e-9, False),
        (np.inf, False),
        (np.nan, False),
    ):
        with refused("argument noise must lie between 0 and 0.2 m here", not fair):
            check_length("noise", value, 0.2)
    check_length("noise", None, 0.2)
    with refused("must be a length in metres, but was"):
        check_length("noise", [1.0, 2.0], 0.2)
    assert _contour_fit._radius(3) == 3.0


class Tried:
    """A fit with a smallest radius whose curves bend as told, by shares of what is allowed."""

    def __init__(self, told):
        self.told, self.shares, self.onward = told, [], []
        self.clean = types.SimpleNamespace(points=np.zeros((9, 2)))
        self.strays, self.wavelength, self.noise = np.array([[1.0, 2.0], [3.0, 4.0]]), 0.7, 2e-4

    def solved(self, share):
        self.shares.append(share)
        curve = types.SimpleNamespace(nodes=np.full((9, 2), float(len(self.shares))))
        return types.SimpleNamespace(sharpest=lambda: self.told[len(self.shares) - 1][0], curve=curve)

    def onwards(self, found):
        self.onward.append(found.curve.nodes[0, 0])
        return self


# Curvatures of the curve and, where that is allowed, of the contour's table, in units of the bound; and the
# factors from one share to the next.
TRIALS = {
    "at once": ([(0.99, 0.999)], []),
    "the curve first": ([(1.1, None), (1.0, 1.0)], [0.98 / 1.1]),
    "the table": ([(0.9, 1.05), (0.9, 1.001), (0.9, 0.95)], [0.98 / 1.05, 0.98 / 1.001]),
    "never": ([(2.0, None)] * 8, [0.49] * 7),
}


@pytest.mark.parametrize("name", TRIALS)
def test_curves_are_tried_with_less_until_their_table_is_within_the_bound(name, monkeypatch):
    bends, factors = TRIALS[name]
    radius = 0.02
    told = Tried([tuple(None if x is None else x / radius for x in pair) for pair in bends])
    known = []
    report = types.SimpleNamespace(self_intersecting=False, rounded=())
    monkeypatch.setattr(_contour_fit, "limited", lambda *_: told)
    monkeypatch.setattr(_contour_fit, "_through", lambda nodes, *, closed: (nodes[0, 0], closed))
    monkeypatch.setattr(_contour_fit, "_resolved", lambda contour: contour)
    monkeypatch.setattr(_contour_fit, "tabled", lambda contour: contour)
    seen = lambda *_: types.SimpleNamespace(peak=told.told[len(told.shares) - 1][1])  # noqa: E731
    monkeypatch.setattr(_contour_fit, "_measured", seen)
    made = lambda *given: known.append(given) or types.SimpleNamespace(report=report)  # noqa: E731
    monkeypatch.setattr(_contour_fit, "_reported", made)
    wanted = replace(ASKED, radius=radius)
    points = np.array([(0.0, 0.0), (1.0, 0.5)])
    with refused(r"with 0.02 m the curvature stays at 100 1/m", name == "never"):
        _contour_fit._bent_at_most(points, wanted)
    np.testing.assert_allclose(told.shares, 0.97 * np.cumprod([1.0, *factors]), rtol=1e-12)
    assert told.onward[: len(factors)] == list(range(1, len(factors) + 1))
    if name != "never":
        contour, clean, what, _ = known[0]
        assert contour == (len(bends), True) and clean is told.clean
        assert what == _contour_fit._Known("spline", 0.7, 2e-4, radius, ((1.0, 2.0), (3.0, 4.0)))
    # A contour that crosses itself is refused, with the worst of what it rounds.
    for rounded, words in ((STRETCHES, "it does near"), ((), "it does$")):
        told.shares.clear()
        report.self_intersecting, report.rounded = True, rounded
        if name != "never":
            with pytest.raises(ValueError, match=words) as error:
                _contour_fit._bent_at_most(points, wanted)
            assert not rounded or "near (0.3, 0.4) m" in str(error.value)


def test_lengths_with_a_smallest_radius_are_those_of_the_points(monkeypatch):
    monkeypatch.setattr(_contour_fit, "limited", lambda *_: pytest.skip.Exception)
    points = np.array([(0.0, 0.0), (1.0, 0.5)])
    for changes, words in (
        ({"noise": 0.101}, "between 0 and 0.1 m"),
        ({"smoothing": 1.01}, "between 0 and 1 m"),
    ):
        with refused(words):
            _contour_fit._bent_at_most(points, replace(ASKED, **changes))
        inside = {name: 0.99 * value for name, value in changes.items()}
        with pytest.raises((AttributeError, TypeError)):
            _contour_fit._bent_at_most(points, replace(ASKED, **inside))


def test_an_open_contour_is_measured_between_its_ends():
    """Points beyond an end have that for their foot; the peak of curvature is looked for at 16385 places."""
    u = np.linspace(0.2, 2.0, 14)
    contour = tabled(jxr.Spline(0.03 * np.stack([np.cos(u), 0.6 * np.sin(u)], axis=1), closed=False))
    table = eqx.tree_at(lambda table: table.start, contour.read(), jnp.asarray(0.37))
    low, high = 0.37, 0.37 + float(table.length)
    # All places in one call: each length of an array is a program of its own.
    everywhere = np.concatenate([[low, high], np.linspace(low, high, 2049), np.linspace(low, high, 16385)])
    frame = table.frame(jnp.asarray(everywhere))
    points = np.stack([frame.point.x, frame.point.y], axis=1)
    ways = np.stack([frame.tangent.x, frame.tangent.y], axis=1)
    bends = np.asarray(frame.curvature)
    contour = types.SimpleNamespace(read=lambda: table)
    found = _contour_fit._measured(contour, points[:2] + 2e-3 * np.array([[-1.0], [1.0]]) * ways[:2])
    np.testing.assert_allclose(found.feet, [low, high], atol=1e-12)
    np.testing.assert_allclose(found.distances, 2e-3, rtol=1e-9)
    np.testing.assert_allclose(found.ends, [low, high])
    np.testing.assert_allclose(found.outline, points[2:2051], atol=1e-12)
    # At the ends of its table's cells rounding decides which of two curvatures there is.
    np.testing.assert_allclose(found.curvatures, bends[2:2051], rtol=1e-2)
    assert np.mean(np.isclose(found.curvatures, bends[2:2051], rtol=1e-7)) > 0.95
    assert found.peak == pytest.approx(np.abs(bends[2051:]).max(), rel=1e-3)


def test_points_are_measured_in_powers_of_two(monkeypatch):
    asked = []

    def measured(contour, points):
        asked.append(np.asarray(points))
        return _contour_fit.Measured(*(np.arange(len(points)) for _ in range(2)), *"abcd")

    monkeypatch.setattr(_contour_fit, "measured_contour", measured)
    for count, room in ((9, 16), (16, 16), (17, 32)):
        points = np.arange(2.0 * count).reshape(-1, 2)
        found = _contour_fit._measured(types.SimpleNamespace(read=lambda: None), points)
        assert asked[-1].shape == (room, 2) and found.feet.tolist() == found.distances.tolist() == list(
            range(count)
        )
        np.testing.assert_array_equal(asked[-1][:count], points)
        np.testing.assert_array_equal(asked[-1][count:], np.tile(points[-1:], (room - count, 1)))


def test_a_report_has_the_numbers_that_were_measured(monkeypatch):
    """Of a square with a loop in it, which crosses itself; open, it lacks the side that does."""
    outline = np.array([(0.0, 0.0), (3.0, 1.0), (3.0, 0.0), (0.0, 1.0), (0.0, 0.0)])
    asked = []
    monkeypatch.setattr(_contour_fit, "departures", lambda *_, **options: asked.append(options) or ())
    monkeypatch.setattr(_contour_fit, "jumps", lambda *_, **options: asked.append(options) or ())
    points = on_circle(8, 0.03)
    clean = _limited_fit.CleanPoints(points, 3, True, False, ("so",))
    seen = _contour_fit.Measured(
        np.arange(8.0), np.array([3.0, 0, 0, 0, 0, 0, 0, 1.0]), outline, np.array([10.0, -40.0, 5.0, 20.0]),
        np.array([1.0, 3.5]), 0.0,
    )  # fmt: skip
    contour: Any = types.SimpleNamespace(closed=True, smoothness=4.0)
    known = _contour_fit._Known("spline", 0.2, None, 0.005, ((0.1, 0.2),))
    report = _contour_fit._reported(contour, clean, known, seen).report
    assert (report.rms, report.largest, report.length) == (pytest.approx(1.25**0.5), 3.0, 2.5)
    assert (report.curvature, report.radius, report.inflections) == ((-40.0, 20.0), 0.025, 2)
    assert (report.points, report.merged, report.reordered, report.reversed) == (8, 3, True, False)
    assert report.self_intersecting and report.rejected == ((0.1, 0.2),) and report.smallest_radius == 0.005
    assert report.warnings[0] == "so" and len(report.warnings) > 1
    of_departures = {"closed": True, "noise": 0.0, "radius": 0.005}
    assert asked == [of_departures, {"closed": True, "noise": pytest.approx(1.25**0.5)}]
    asked.clear()
    other = _contour_fit._reported(contour, clean, replace(known, noise=0.3, radius=None), seen).report
    assert asked == [{"closed": True, "noise": 0.3}] and other.noise == 0.3
    flat = seen._replace(curvatures=np.zeros(4), outline=outline[:3])
    contour.closed = False
    report = _contour_fit._reported(contour, clean, known, flat).report
    assert report.radius == np.inf and not report.self_intersecting and not report.closed
    with refused("but the fit to them is not finite"):
        _contour_fit._reported(contour, clean, known, seen._replace(curvatures=np.array([1.0, np.nan])))


@pytest.mark.parametrize("name", ["closed", "smoothing", "knots", "smallest_radius"])
def test_what_is_for_splines_is_refused_for_others(name):
    options = {"closed": False, "smoothing": 0.01, "knots": 50, "smallest_radius": 0.01}
    with refused("closed=False are for splines, but field was 'support'"):
        jxr.fit_contour(on_circle(40), field="support", **{name: options[name]})


@pytest.mark.parametrize(
    ("smoothing", "closed", "fair"),
    [(3.99, False, True), (4.01, False, False), (0.0627, True, True), (0.0628, True, False)],
)
def test_a_wavelength_is_no_longer_than_half_a_closed_contour_or_a_hundred_extents(
    smoothing, closed, fair, monkeypatch
):
    made = []
    monkeypatch.setitem(
        _contour_fit.FIELDS, "spline", lambda points, wish: (made.append(wish), ("c", 0.7))[1]
    )
    monkeypatch.setattr(_contour_fit, "_resolved", lambda contour: contour + "r")
    monkeypatch.setattr(_contour_fit, "tabled", lambda contour: contour + "t")
    monkeypatch.setattr(_contour_fit, "_measured", lambda contour, points: (contour, points))
    monkeypatch.setattr(_contour_fit, "_reported", lambda *args: args)
    points = on_circle(40)
    # Twenty chords of 2 (20 mm) sin(pi / 40) each; a hundred times 40 mm.
    limit = "0.0627" if closed else "4 m"
    with refused(f"argument smoothing must lie between 0 and {limit}", not fair):
        found = jxr.fit_contour(points, smoothing=smoothing, closed=closed, ordered=True)
        contour, clean, known, (tabled_one, seen) = found
        assert (contour, tabled_one) == ("cr", "crt") and seen is clean.points
        assert made == [wish(smoothing=smoothing, closed=closed)]
        assert known == _contour_fit._Known("spline", 0.7, None)
        known = jxr.fit_contour(points, noise=1e-4, knots=13, ordered=True)[2]
        assert made[1] == wish(noise=1e-4, knots=13) and known == _contour_fit._Known("spline", 0.7, 1e-4)


def test_networks_are_fitted_to_the_noise_or_to_ten_nanometres(monkeypatch):
    asked = []
    for kind in (jxr.geometry.NeuralSupport, jxr.geometry.NeuralCurvature):
        monkeypatch.setattr(
            kind, "through", lambda points, *, key, tolerance, kind=kind: asked.append((kind, tolerance))
        )
    for name in ("support network", "curvature network"):
        for noise in (None, 0.0, 3e-4):
            assert _contour_fit.FIELDS[name](np.zeros((9, 2)), wish(noise=noise)) == (None, 0.0)
    wanted = [
        (kind, off)
        for kind in (jxr.geometry.NeuralSupport, jxr.geometry.NeuralCurvature)
        for off in (1e-8, 1e-8, 3e-4)
    ]
    assert asked == wanted
    assert set(_contour_fit.FIELDS) == {"spline", "support", "support network", "curvature network"}


@pytest.mark.parametrize("closed", [True, False])
def test_a_table_has_as_many_cells_as_a_spline_needs(closed, monkeypatch):
    """1024, 4096 or 16384; what is refused for another reason, or is no spline, is not tried again."""
    points = on_circle(30)[: 30 if closed else 20]
    contour = jxr.Spline(points, closed=closed, smoothing=0.004, knots=17)
    tried, told = [], {}

    def table(given):
        tried.append(given.cells)
        if given.cells < told["enough"]:
            raise ValueError(told["reason"])

    def refusals(given, reason, cells):
        tried.clear()
        told.update(enough=20_000, reason=reason)
        with refused("bends more sharply than its table can follow"):
            _contour_fit._resolved(given)
        assert tried == cells

    monkeypatch.setattr(_contour_fit, "tabled", table)
    for cells in (1024, 4096, 16384):
        tried.clear()
        told.update(enough=cells, reason="argument cells must be more")
        found = _contour_fit._resolved(contour)
        assert tried == [n for n in (1024, 4096, 16384) if n <= cells]
        assert (found.cells, found.closed, found.knots) == (cells, closed, contour.knots)
        assert found.wavelength == contour.wavelength
        np.testing.assert_array_equal(found.points, contour.points)
    refusals(contour, "argument cells must", [1024, 4096, 16384])
    refusals(contour, "argument knots", [1024])
    refusals(types.SimpleNamespace(cells=1024), "argument cells must", [1024])


def test_what_is_wanted_of_a_smallest_radius_is_checked():
    good = (False, None, True, 1e-4, 0.2, 0.03, 48)
    assert _contour_fit._wanted(*good) == _limited_fit.Wanted(False, None, True, 0.03, 1e-4, 0.2, 48)
    assert _contour_fit._wanted(*good[:6], None).knots is None
    assert _contour_fit._wanted(*good[:6], 1024).knots == 1024
    for place, value in ((0, "yes"), (1, "no"), (2, "no"), (5, -1.0), (5, 0.0), (6, 47), (6, 1025)):
        with refused("^argument (closed|ordered|reverse|smallest_radius|knots) "):
            _contour_fit._wanted(*good[:place], value, *good[place + 1 :])
