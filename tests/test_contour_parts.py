"""Parts of contours: series of support functions, polynomials in pieces, tables, free numbers, limits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.geometry.contours import (
    _arclength as arclength,
    _bspline as bspline,
    _free_numbers as free,
    _spline as spline,
    _support as support,
    _table as tables,
)
from jaxroll.geometry.contours._given_points import numbers, polygon_area
from tests.helpers import in_single
from tests.measures import both_ways
from tests.oracles.known_curves import ellipse_points

TURN = 2.0 * np.pi


@pytest.fixture
def unlooked(monkeypatch):
    """Support functions without the look whether they fold, a program of its own for each size."""
    monkeypatch.setattr(support, "check_convex", lambda name, contour: None)


class Loaded:
    """A random generator whose numbers are known: 1, 2, 3, ... over ten, on and on."""

    def __init__(self):
        self.drawn = 0

    def standard_normal(self, shape):
        count = int(np.prod(shape))
        found = 0.1 * (1.0 + self.drawn + np.arange(count))
        self.drawn += count
        return found.reshape(shape)


def oval(angle):
    """h, h' and h'' of a support function of three waves, by hand."""
    a, b, c = 0.3, 0.05, -0.02
    wave = 2.0 + a * np.cos(angle) - b * np.sin(2.0 * angle) + c * np.cos(3.0 * angle)
    first = -a * np.sin(angle) - 2.0 * b * np.cos(2.0 * angle) - 3.0 * c * np.sin(3.0 * angle)
    second = -a * np.cos(angle) + 4.0 * b * np.sin(2.0 * angle) - 9.0 * c * np.cos(3.0 * angle)
    return wave, first, second


SERIES = np.array([2.0, 0.3, 0.0, -0.02, 0.0, -0.05, 0.0])


def normals(angle):
    return np.stack([np.cos(angle), np.sin(angle)], -1), np.stack([-np.sin(angle), np.cos(angle)], -1)


def oval_points(angle):
    height, slope, _ = oval(angle)
    out, along = normals(angle)
    return height[:, None] * out + slope[:, None] * along


def test_waves_of_a_support_function_have_their_derivatives():
    angle = np.array([0.1, 1.3, 4.0])
    for basis, wanted in zip(support._basis(angle, 3), oval(angle), strict=True):
        assert basis.shape == (3, 7)
        np.testing.assert_allclose(basis @ SERIES, wanted, rtol=1e-13)


def test_feet_of_points_beside_an_oval_are_where_its_normals_go_through_them():
    angle = np.linspace(0.3, 6.0, 11)
    beside = oval_points(angle) + np.linspace(-0.4, 0.8, 11)[:, None] * normals(angle)[0]
    found = support._feet(beside, SERIES, angle + 0.05)
    np.testing.assert_allclose(found, angle, rtol=1e-12)
    # Within the hollow of its evolute there is no foot near: the guess stays.
    np.testing.assert_array_equal(support._feet(np.array([[-3.0, 0.0]]), SERIES, np.array([0.0])), [0.0])


def test_a_series_through_points_of_an_oval_is_its_own_wherever_it_lies():
    angle = np.sort(np.random.default_rng(1).uniform(0.0, TURN, 40))
    centre, size = np.array([0.5, -0.2]), 1e-3
    found, feet = support.fit_series(centre + size * oval_points(angle), 4)
    wanted = size * np.insert(SERIES, [4, 7], 0.0)
    wanted[[1, 5]] += centre
    np.testing.assert_allclose(found, wanted, atol=1e-14)
    np.testing.assert_allclose(np.mod(feet - angle + 1.0, TURN), 1.0, atol=1e-10)


class Named:
    """What stands in for a series, and says how large it was asked to be."""

    density = 9

    def __init__(self, terms):
        self.terms = terms

    def heights(self, angle):
        return (self.terms + 0.0 * angle,) * 3

    def bend(self, angle):
        return self.terms + angle

    def smallest_radius(self):
        return jnp.asarray(0.5 * self.terms)

    def table(self, cells):
        return self.terms, cells


class Asked(support.AbstractSupport):
    """A support function whose series only says how many terms it was asked for."""

    cells: int = 1024
    table: None = None

    def series(self, terms):
        return Named(terms)


def test_a_support_function_is_asked_for_as_many_terms_as_its_table_needs():
    asked = Asked()
    for cells, terms in ((256, 64), (512, 64), (520, 65), (1024, 128)):
        assert asked.tabulate(cells) == (terms, cells)
    assert asked.support(np.zeros((2, 3))).tolist() == [[128.0] * 3] * 2
    assert float(asked.smallest_radius()) == 64.0
    assert float(asked.margin(0.25, 0.75)) == 128.25


def test_the_grid_of_a_series_has_sixteen_places_to_its_shortest_wave():
    made = lambda m: support.Series(jnp.ones(()), jnp.zeros(m), jnp.zeros(m))  # noqa: E731
    assert [made(m).density for m in (1, 6)] == [80, 160]


def test_cells_of_a_support_function_are_four_to_its_shortest_wave_and_eight_at_least(unlooked):
    for waves, least in ((1, 8), (3, 12)):
        assert jxr.SupportFunction(0.01, [0.0] * waves, [0.0] * waves, cells=least).cells == least
        with pytest.raises(ValueError, match=f"argument cells must be .* at least {least}, but"):
            jxr.SupportFunction(0.01, [0.0] * waves, [0.0] * waves, cells=least - 1)


def test_a_support_function_goes_through_more_than_twice_as_many_points_as_it_has_terms(unlooked):
    points = oval_points(TURN * np.arange(9) / 9)
    fit = jxr.SupportFunction.through(points, terms=4, cells=64)
    assert (fit.cells, fit.cosines.shape, fit.sines.shape) == (64, (4,), (4,))
    np.testing.assert_allclose(fit.cosines, [0.3, 0.0, -0.02, 0.0], atol=1e-9)
    np.testing.assert_allclose(fit.sines, [0.0, -0.05, 0.0, 0.0], atol=1e-9)
    for count, terms in ((8, 4), (9, 0), (9, 5)):
        with pytest.raises(ValueError, match="argument terms must"):
            jxr.SupportFunction.through(points[:count], terms=terms)
    with pytest.raises(ValueError, match="argument points must lie round a body, but lie on one line"):
        jxr.SupportFunction.through([[0.01 * x, 0.3 - 0.02 * x] for x in range(9)], terms=2)


def test_free_numbers_of_a_support_function_are_its_series_divided_by_what_waves_bend(unlooked):
    tip = jxr.SupportFunction(0.01, [1e-3, 2e-4, 1e-4], [3e-3, -1e-4, 5e-5])
    assert [x is y for x, y in zip(tip.free_numbers(), (tip.radius, tip.cosines, tip.sines), strict=True)]
    each = [1.0, 2.0 / 5.0, 2.0 / 10.0]
    np.testing.assert_allclose(tip.preconditioner(0.3), np.diag([1.0, *each, *each]))
    even = tip.symmetrised()
    np.testing.assert_array_equal(even.cosines, tip.cosines)
    np.testing.assert_array_equal(even.sines, np.zeros(3))
    other = tip.perturbed(Loaded())
    size = 0.15 * 0.01 / np.array([1.0, 8.0, 27.0])
    np.testing.assert_allclose(other.cosines, [1e-3, 2e-4, 1e-4] + size * [0.1, 0.2, 0.3])
    np.testing.assert_allclose(other.sines, [3e-3, -1e-4, 5e-5] + size * [0.4, 0.5, 0.6])
    assert float(other.radius) == 0.01


class Own(jxr.AbstractContour):
    """A caller's own contour with numbers of two kinds."""

    axes: jax.Array
    turn: jax.Array
    shift: jax.Array

    closed, smoothness = True, 4.0

    def curve(self, s):
        raise NotImplementedError

    def domain(self):
        return 0.0, 1.0


def test_numbers_of_a_contour_of_ones_own_are_measured_against_themselves():
    shape = Own(jnp.array([3.0, 4.0]), jnp.asarray(0.5), jnp.zeros(2))
    root = np.sqrt(12.5)
    np.testing.assert_allclose(shape.preconditioner(2.0), np.diag([root / 2.0] * 2 + [0.25] + [1.0] * 2))
    other = shape.perturbed(Loaded())
    np.testing.assert_allclose(other.axes, [3.0 * 1.015, 4.0 * 1.03])
    np.testing.assert_allclose(other.turn, 0.5 * 1.045)
    with pytest.raises(ValueError, match="argument symmetric must be False for a Own"):
        shape.symmetrised()


def test_a_placed_contour_is_its_mirror_image_about_the_x_axis_of_the_body_or_has_none():
    tip = jxr.SupportFunction(0.01, [1e-3, 2e-4], [3e-3, -1e-4])
    for angle in (0.0, np.pi):
        placed = tip.moved((0.1, 0.0), angle)
        image = placed.symmetrised()
        np.testing.assert_array_equal(image.contour.sines, np.zeros(2))
        assert image.offset is placed.offset
    for offset, angle in (((0.1, 0.0), 1e-9), ((0.1, 1e-9), 0.0), ((0.0, -0.1), np.pi)):
        with pytest.raises(
            ValueError, match="symmetric must be False unless a contour is placed with its x ax"
        ):
            tip.moved(offset, angle).symmetrised()


def test_a_placed_contour_has_the_free_numbers_of_what_it_places(unlooked):
    tip = jxr.SupportFunction(0.01, [1e-3, 2e-4], [3e-3, -1e-4])
    placed = tip.moved((0.1, 0.2), 0.3, origin=0.004)
    assert placed.free_numbers()[0] is tip.radius
    np.testing.assert_array_equal(placed.preconditioner(2.0), tip.preconditioner(2.0))
    np.testing.assert_array_equal(placed.perturbed(Loaded()).contour.sines, tip.perturbed(Loaded()).sines)
    assert (placed.closed, placed.smoothness) == (True, np.inf)
    line = jxr.Line((-0.01, 0.03)).moved(origin=0.1)
    np.testing.assert_allclose(np.stack(line.domain()), [0.09, 0.13])
    np.testing.assert_allclose(line.point(0.12), [0.0, 0.02], atol=1e-16)
    assert jxr.Line().moved(origin=0.1).domain() is None and not line.closed


@pytest.mark.parametrize("count", [7, 12])
def test_waves_along_points_are_divided_by_what_they_bend(count):
    """Closed: k waves in a period. Open: they are cosines of half the order, mirrored at the ends."""
    place = np.arange(count)
    for closed, waves, orders in (
        (True, [np.cos(TURN * k * place / count + 0.3) for k in (0, 1, 2, 3)], [0, 1, 2, 3]),
        (False, [np.cos(np.pi * k * place / (count - 1)) for k in (0, 1, 2, 5)], [0, 0.5, 1, 2.5]),
    ):
        matrix = free.point_waves(count, closed=closed)
        assert matrix.shape == (2 * count, 2 * count)
        for wave, order in zip(waves, orders, strict=True):
            for way in ([1.0, 0.0], [0.3, -2.0]):
                given = np.outer(wave, way)
                # The mirror image doubles what lies between the ends, which come once.
                found = (matrix @ given.ravel()).reshape(count, 2)
                factor = 2.0 / (1.0 + order**2)
                if closed:
                    np.testing.assert_allclose(found, factor * given, atol=1e-13)


def test_the_waves_of_an_open_contour_are_those_of_it_there_and_back():
    """One point moved, and its mirror image: of the contour there and back, the first half is kept."""
    count = 6
    whole = 2 * count - 2
    wave = np.abs(np.fft.fftfreq(whole) * whole) / 2.0
    matrix = free.point_waves(count, closed=False)
    for j in range(count):
        there = np.zeros(whole)
        there[j] += 1.0
        there[-j % whole] += 1.0
        smooth = np.fft.ifft(np.fft.fft(there) * 2.0 / (1.0 + wave**2)).real[:count]
        np.testing.assert_allclose(matrix[::2, 2 * j], smooth, atol=1e-15)
        np.testing.assert_allclose(matrix[1::2, 2 * j + 1], smooth, atol=1e-15)
        assert not matrix[::2, 2 * j + 1].any()


def test_points_are_shifted_by_a_translation_and_three_waves():
    points = np.random.default_rng(3).normal(size=(5, 2)) * [0.01, 0.03]
    drawn = Loaded().standard_normal((7, 2))
    u = TURN * np.arange(5) / 5
    waves = [1.0 + 0.0 * u, np.cos(u), np.sin(u), np.cos(2 * u) / 2, np.sin(2 * u) / 2]
    waves += [np.cos(3 * u) / 3, np.sin(3 * u) / 3]
    size = 0.075 * np.sqrt((points**2).sum() / 5)
    wanted = size * sum(np.outer(wave, way) for wave, way in zip(waves, drawn, strict=True))
    np.testing.assert_allclose(free.wavy_shift(points, Loaded()), wanted, rtol=1e-12)
    outline = jxr.Spline(square(9))
    moved = outline.perturbed(Loaded()).points - outline.points
    np.testing.assert_allclose(moved, free.wavy_shift(np.asarray(outline.points), Loaded()))


def square(count):
    """Points of an oval off the origin."""
    return np.array([0.3, -0.1]) + oval_points(TURN * np.arange(count) / count)


def test_powers_and_derivatives_of_polynomials_in_pieces():
    rng = np.random.default_rng(0)
    for order in (4, 10):
        x = rng.uniform(size=(2, 3))
        np.testing.assert_allclose(bspline.powers(jnp.asarray(x), order), x[..., None] ** np.arange(order))
        coefficients = rng.normal(size=(4, order, 2))
        piece = np.array([[3, 0, 2], [1, 1, 0]])
        places = x[0]
        made = jax.jit(lambda c, x: (bspline.jet_of_pieces(c, piece, x), bspline.jets(c, places)))  # noqa: B023
        found, everywhere = made(coefficients, x)
        for k in range(3):
            for d, (one, other) in enumerate(
                zip((found[k].x, found[k].y), (everywhere[k].x, everywhere[k].y), strict=True)
            ):
                lines = [np.polynomial.Polynomial(c[:, d]).deriv(k) for c in coefficients]
                wanted = [
                    [lines[p](at) for p, at in zip(*row, strict=True)] for row in zip(piece, x, strict=True)
                ]
                np.testing.assert_allclose(one, wanted, rtol=1e-12)
                np.testing.assert_allclose(other, [line(places) for line in lines], rtol=1e-12)


def test_intervals_of_parameters_at_and_beyond_breaks():
    breaks = jnp.array([1.0, 1.5, 3.0, 7.0])
    places = jnp.array([[0.5, 1.0, 1.25], [1.5, 2.0, 8.0]])
    index, local = jax.jit(bspline.interval_of)(breaks, places)
    np.testing.assert_array_equal(index, [[0, 0, 0], [1, 1, 2]])
    np.testing.assert_allclose(local, [[-1.0, 0.0, 0.5], [0.0, 1.0 / 3.0, 1.25]])


def test_roughness_of_a_closed_spline_is_the_integral_of_its_third_derivative_squared():
    u = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 14))
    given = np.random.default_rng(2).normal(size=(13, 2))

    @jax.jit
    def made(u, given):
        functions = bspline.basis(u, 3, closed=True)
        assert functions.count == 13
        values = functions.at_breaks(), functions.matrix(u[:-1])
        return functions.pieces(given).coefficients, functions.roughness(), values

    pieces, rough, (at_breaks, matrix) = made(u, given)
    total = np.zeros(2)
    for row, step in zip(np.asarray(pieces), np.diff(u), strict=True):
        for d in range(2):
            third = np.polynomial.Polynomial(row[:, d]).deriv(3)
            total[d] += (third**2).integ()(1.0) / step**5
    np.testing.assert_allclose([given[:, d] @ rough @ given[:, d] for d in range(2)], total, rtol=1e-9)
    np.testing.assert_allclose(at_breaks, matrix, atol=1e-12)


def test_chords_of_points_with_and_without_the_last_one():
    points = jnp.array([[1.0, 1.0], [4.0, 5.0], [4.0, 7.0], [1.0, 3.0]])
    open_, closed = jax.jit(lambda x: (spline.chords(x, False), spline.chords(x, True)))(points)
    np.testing.assert_allclose(open_, [0.0, 5.0, 7.0, 12.0])
    np.testing.assert_allclose(closed, [0.0, 5.0, 7.0, 12.0, 14.0])


def test_fewer_knots_lie_evenly_among_the_data():
    u = np.array([0.0, 1.0, 3.0, 6.0, 10.0, 15.0, 21.0, 28.0, 36.0])
    breaks = lambda knots, closed: jax.jit(  # noqa: E731
        lambda u: spline.spline_basis(u, knots, 3, closed=closed).breaks
    )(u)
    np.testing.assert_allclose(breaks(4, True), [0.0, 3.0, 10.0, 21.0, 36.0])
    # Open, the knots next to the ends are none.
    np.testing.assert_allclose(breaks(5, False), [0.0, 10.0, 36.0])
    np.testing.assert_allclose(breaks(None, True), u)


def test_half_pieces_are_the_cells_of_a_curve():
    coefficients = np.random.default_rng(5).normal(size=(3, 6, 2))
    half, x = np.array([0, 3, 4]), np.array([0.2, 0.7, 0.9])
    found = jax.jit(spline._halves)(coefficients, half, x)
    places, pieces = np.array([0.1, 0.85, 0.45]), [0, 1, 2]
    rates = []
    for d in range(2):
        lines = [np.polynomial.Polynomial(coefficients[p][:, d]) for p in pieces]
        for k, factor in enumerate((1.0, 0.5, 0.25)):
            wanted = [factor * line.deriv(k)(at) for line, at in zip(lines, places, strict=True)]
            np.testing.assert_allclose((found[k].x, found[k].y)[d], wanted, rtol=1e-12)
        rates.append([line.deriv(1)(at) for line, at in zip(lines, places, strict=True)])
    speed = jax.jit(spline._speed)(coefficients, np.array(pieces), places)
    np.testing.assert_allclose(speed, np.hypot(*rates))


def test_knots_are_no_more_than_memory_holds():
    assert spline.knot_count(None, 4096, 5) is None
    assert spline.knot_count(6, 6, 5) == 6
    assert spline.knot_count(np.int64(16), 1 << 20, 5) == 16
    refused = [(None, 4097), (5, 100), (101, 100), (17, 1 << 20), (6.0, 100), (True, 100), ("8", 100)]
    for knots, count in refused:
        with pytest.raises(ValueError, match="argument (points|knots) must"):
            spline.knot_count(knots, count, 5)
    with pytest.raises(ValueError, match="argument points must be at most 4096 where"):
        spline.knot_count(None, 4097, 5)
    with pytest.raises(ValueError, match="argument points must be at most 4096 where"):
        spline.knot_count(6, spline._LARGEST + 1, 5)
    with pytest.raises(ValueError, match="argument knots must be at most 16 for 1048576 points"):
        spline.knot_count(17, 1 << 20, 5)


def test_a_spline_has_more_points_than_its_degree():
    for degree in (3, 5, 7, 9):
        assert jxr.Spline(square(degree + 1), degree=degree).smoothness == degree - 1
        with pytest.raises(ValueError, match=f"must have at least {degree + 1} points for degree {degree}"):
            jxr.Spline(square(degree), degree=degree)
    for degree in (1, 4, 11, 5.0, "5"):
        with pytest.raises(ValueError, match="argument degree must be 3, 5, 7 or 9"):
            jxr.Spline(square(20), degree=degree)


def test_the_origin_of_a_spline_is_the_number_of_a_point():
    for origin in (0, 8, np.int32(3)):
        assert jxr.Spline(square(9), origin=origin).origin == origin
    for origin in (-1, 9, True, 1.0):
        with pytest.raises(ValueError, match="argument origin must be the number of a point, below 9"):
            jxr.Spline(square(9), origin=origin)
    with pytest.raises(ValueError, match="argument symmetric must be False unless .* 3 of 9"):
        jxr.Spline(square(9), closed=False, origin=3).symmetrised()


@pytest.mark.parametrize(("closed", "rows", "which"), [(True, [8, 0], "8 and 0"), (False, [3, 4], "3 and 4")])
def test_points_that_follow_themselves_are_named(closed, rows, which):
    points = square(9)
    points[rows[1]] = points[rows[0]]
    with pytest.raises(ValueError, match=f"but points {which} are the same"):
        spline.check_distinct(points, closed)
    if closed:
        spline.check_distinct(points, False)


@pytest.mark.parametrize(("kind", "share"), [(np.float64, 1e-12), (np.float32, 1e-6)])
def test_neighbours_that_are_equal_to_rounding_are_one_point(kind, share):
    """Beside the extent of the points, at their ends too, and beside how far they are from the origin."""
    for turn, closed, which in ((3, False, "3 and 4"), (-1, True, "4 and 0")):
        for times, same in ((0.9, True), (1.1, False)):
            points = np.array([(0.0, 0.0), (0.0, 4 * times * share), (0, 3), (-4, 3), (-4, 0)], kind)
            points = np.roll(points, turn, axis=0)
            if same:
                with pytest.raises(ValueError, match=f"points {which} are the same to rounding, .* m apart"):
                    spline.check_distinct(points, closed)
            else:
                spline.check_distinct(points, closed)
    far = (square(9) + 1e4).astype(kind)
    far[4] = far[3] + np.array([0.0, 2.0 * np.spacing(kind(1e4))])
    with pytest.raises(ValueError, match="but points 3 and 4 are the same to rounding"):
        spline.check_distinct(far, False)


def test_smoothing_is_a_wavelength_or_nothing():
    assert jxr.Spline(square(9)).wavelength == 0.0
    assert float(jxr.Spline(square(9), smoothing=0.3).wavelength) == 0.3
    (points,) = (line := jxr.Spline(square(9), closed=False)).free_numbers()
    assert points is line.points
    np.testing.assert_array_equal(line.preconditioner(1.0), free.point_waves(9, closed=False))
    disc = jxr.Spline(square(9))
    np.testing.assert_array_equal(disc.preconditioner(1.0), free.point_waves(9, closed=True))


def test_points_are_checked_row_by_row():
    for bad in ([[0.0, 1.0, 2.0]], [1.0, 2.0], "points", [[0.0, "a"]]):
        with pytest.raises(ValueError, match=r"argument dots must (be numbers of|have) shape \(any, 2\)"):
            numbers("dots", bad, 2)
    with pytest.raises(ValueError, match="argument dots must be finite, but row 2 was"):
        numbers("dots", [[0.0, 1.0], [2.0, 3.0], [np.inf, 0.0], [np.nan, 0.0]], 2)
    with pytest.raises(ValueError, match="argument dots must not be one point again and again"):
        numbers("dots", [[1.0, 2.0], [1.0, 2.0]], 2)
    with pytest.raises(ValueError, match="argument dots must be concrete numbers"):
        jax.eval_shape(lambda x: numbers("dots", x, 2), np.zeros((3, 2)))
    assert numbers("dots", [[1, 2]], 2).dtype == np.float64
    np.testing.assert_array_equal(numbers("dots", [[1.0, 2.0], [1.0, 3.0]], 2), [[1.0, 2.0], [1.0, 3.0]])


def test_the_area_of_a_polygon_far_off():
    """A triangle of 3 by 4 m and a dart, a thousand kilometres away."""
    triangle = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]])
    assert polygon_area(triangle + [1e6, -2e6]) == pytest.approx(6.0, rel=1e-9)
    assert polygon_area(triangle[::-1]) == pytest.approx(-6.0)
    assert polygon_area([[0.0, 0.0], [5.0, 0.0], [1.0, 1.0], [0.0, 3.0]]) == pytest.approx(4.0)
    with pytest.raises(ValueError, match="argument points must have at least 3 rows, but had 2"):
        polygon_area(triangle[:2])


def test_quintics_between_values_and_derivatives_are_those_that_these_were_taken_of():
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(2, 6))
    lines = [np.polynomial.Polynomial(row) for row in rows]
    ends = [np.array([[line.deriv(k)(x) for line in lines] for x in (0.0, 1.0)]) for k in range(3)]
    found = arclength.hermite(*(jnp.asarray(x) for x in ends))
    np.testing.assert_allclose(found[0], rows, rtol=1e-9, atol=1e-12)


def rising(shape, cell, x):
    """Speed of an arclength u^2 + 3 u in cells of half a unit, in the cell's own coordinate."""
    return 0.5 * shape * (cell + x + 3.0)


def test_uniform_arclengths_of_a_curve_whose_arclength_is_known():
    """s = u^2 + 3 u times 2, u in [0, 2.5]: u = sqrt(2.25 + s) - 1.5."""
    at = lambda arcs: arclength.arclength_at(  # noqa: E731
        rising, jnp.asarray(2.0), arcs, cell=jnp.asarray(3), x=jnp.asarray(0.4)
    )

    @jax.jit
    def made(size):
        cell, x, arcs = arclength.spaced(rising, size, 5, 7)
        return cell, x, arcs, at(arcs)

    cell, x, arcs, between = made(jnp.asarray(2.0))
    u = 0.5 * np.arange(6)
    np.testing.assert_allclose(arcs, 2.0 * (u**2 + 3.0 * u), rtol=1e-14)
    wanted = np.sqrt(2.25 + 0.5 * arcs[-1] * np.arange(8) / 7) - 1.5
    np.testing.assert_allclose(0.5 * (cell + x), wanted, atol=1e-13)
    assert int(cell[0]) == 0 and int(cell[-1]) == 4 and float(x[-1]) == pytest.approx(1.0)
    assert float(between) == pytest.approx(2.0 * (1.7**2 + 5.1), rel=1e-13)


def test_a_parameter_by_its_arclength_goes_on_round_after_round():
    """Speed 2 + cos(u) / 2 has the arclength 2 u + sin(u) / 2: to the sixth power of the cells' width."""
    rate = lambda size, u: size * (2.0 + 0.5 * jnp.cos(u))  # noqa: E731
    size = jnp.asarray(3.0)
    table = jax.jit(lambda size: arclength.tabulate(rate, size, period=TURN, cells=64))(size)
    assert table.coefficients.shape == (64, 6) and table.period == TURN
    assert float(table.length) == pytest.approx(12.0 * np.pi, rel=1e-13)
    u = np.array([0.7, 5.9, 6.5, 19.3, -1.1, -13.0])
    arcs = jnp.asarray(3.0 * (2.0 * u + 0.5 * np.sin(u)))
    inverse = lambda s: arclength.invert(rate, size, table, s)  # noqa: E731
    found, slope = jax.jit(jax.vmap(lambda s: jax.jvp(inverse, (s,), (1.0,))))(arcs)
    np.testing.assert_allclose(found, u, atol=1e-10)
    np.testing.assert_allclose(slope, 1.0 / (3.0 * (2.0 + 0.5 * np.cos(u))), rtol=1e-9)


def straight(rates, *, closed=False):
    """A table of cells of 2 m along the x axis, in which x runs at such speeds from such places on."""
    rows = np.zeros((len(rates), 12))
    rows[:, 0], rows[:, 6] = np.concatenate([[5.0], 5.0 + 2.0 * np.cumsum(rates)[:-1]]), 3.0
    rows[:, 1] = 2.0 * np.asarray(rates)
    length = jnp.asarray(2.0 * len(rates))
    return tables.Table(jnp.asarray(rows), length, length, jnp.asarray(-1.0), closed)


def test_a_table_is_read_in_its_cells_and_goes_on_beyond_its_ends_or_round():
    rows = np.random.default_rng(7).normal(size=(3, 12)) + 2.0 * (np.arange(12) % 6 == 1)
    length = jnp.asarray(6.0)
    lines = [[np.polynomial.Polynomial(row[:6]), np.polynomial.Polynomial(row[6:])] for row in rows]
    s = np.array([-2.5, -1.0, 0.4, 1.5, 4.9, 5.6, 11.4])
    for closed, cells, local in (
        (False, [0, 0, 0, 1, 2, 2, 2], [-0.75, 0.0, 0.7, 0.25, 0.95, 1.3, 4.2]),
        (True, [2, 0, 0, 1, 2, 0, 0], [0.25, 0.0, 0.7, 0.25, 0.95, 0.3, 0.2]),
    ):
        table = tables.Table(jnp.asarray(rows), length, length, jnp.asarray(-1.0), closed)
        frame, point = jax.jit(lambda table, s: (table.frame(s), table.point(s)))(table, s)
        jets = [
            [[line.deriv(k)(x) for line in lines[c]] for c, x in zip(cells, local, strict=True)]
            for k in range(3)
        ]
        at, rate, bend = np.array(jets).transpose(0, 2, 1)
        speed = np.hypot(*rate)
        np.testing.assert_allclose([point.x, point.y], at, rtol=1e-9)
        np.testing.assert_allclose([frame.point.x, frame.point.y], at, rtol=1e-9)
        np.testing.assert_allclose([frame.tangent.x, frame.tangent.y], rate / speed, rtol=1e-9)
        curvature = (rate[0] * bend[1] - rate[1] * bend[0]) / speed**3
        np.testing.assert_allclose(frame.curvature, curvature, rtol=1e-8)


def test_a_tables_speed_is_compared_with_one_in_its_cells():
    assert tables.unevenness(straight([1.0, 1.0, 1.0])) == pytest.approx(0.0, abs=1e-15)
    assert tables.unevenness(straight([1.0, 0.97, 1.01])) == pytest.approx(0.03)
    assert tables.unevenness(straight([1.0, 1.05, 0.96])) == pytest.approx(0.05)
    table = straight([1.0, 1.0])
    # x = 2 t + 0.4 t^4 in the first cell: the speed is 1 + 0.8 t^3, at most at the last quarter.
    bent = eqx.tree_at(lambda t: t.coefficients, table, table.coefficients.at[0, 4].add(0.4))
    assert tables.unevenness(bent) == pytest.approx(0.8 * 0.75**3)
    steep = eqx.tree_at(lambda t: t.coefficients, table, table.coefficients.at[1, 7].set(1.5))
    assert tables.unevenness(steep) == pytest.approx(0.25)
    assert jax.eval_shape(lambda t: jnp.asarray(tables.unevenness(t)), table).shape == ()


def arc(count, turned):
    """Frames at uniform arclengths of a quarter of a circle of 2 m, the tangents turned by an angle."""
    angle = np.linspace(0.0, 0.5 * np.pi, count + 1)
    out, along = normals(angle)
    slope = normals(angle + turned)[1]
    assert np.allclose(normals(angle)[1], along)
    return 2.0 * out, slope, np.full(count + 1, 0.5), np.array(np.pi)


def test_a_table_of_frames_has_its_length_where_its_speed_is_one():
    made = jax.jit(lambda *frames: tables.from_frames(*frames, closed=False))
    table = made(*arc(8, 0.0))
    assert table.coefficients.shape == (8, 12) and not table.closed
    np.testing.assert_allclose([table.length, table.span, table.start], [np.pi, np.pi, 0.0])
    frame = jax.jit(lambda table, s: table.frame(s))(table, 1.3)
    np.testing.assert_allclose([frame.point.x, frame.point.y], 2.0 * normals(0.65)[0], atol=1e-8)
    np.testing.assert_allclose([frame.tangent.x, frame.tangent.y], normals(0.65)[1], atol=1e-7)
    assert float(frame.curvature) == pytest.approx(0.5, abs=1e-5)
    # Tangents that lean by 20 mrad from the curve make it faster and slower by a thousandth.
    for lean, worst, length in ((0.0185, 0.96e-3, np.pi), (0.0195, 1.02e-3, np.nan)):
        table = made(*arc(8, lean))
        off = tables._unevenness(np.asarray(table.coefficients), float(table.span))
        assert off == pytest.approx(worst, rel=0.02)
        np.testing.assert_allclose([table.length, table.span], [length, np.pi], equal_nan=True)


def test_quartics_are_those_whose_bends_they_are_given():
    """Of x^4, whose bend goes on beyond the ends; of a circle up to fourth differences of bends."""
    x = np.arange(7.0)
    quartics = jax.jit(arclength.quartics, static_argnames="closed")
    rows = np.asarray(quartics(x**4, 4.0 * x**3, 12.0 * x**2, closed=False))
    between = np.array([0.25, 0.5, 1.0])
    found = rows @ between[None, :] ** np.arange(6.0)[:, None]
    np.testing.assert_allclose(found, (x[:-1, None] + between[None, :]) ** 4, rtol=0, atol=1e-11)
    step = TURN / 64.0
    angle = step * np.arange(65.0)
    around = np.cos(angle), -step * np.sin(angle), -(step**2) * np.cos(angle)
    halves = 0.5 ** np.arange(6.0)
    quintics = np.asarray(jax.jit(arclength.hermite)(*around)) @ halves
    found = np.asarray(quartics(*around, closed=True)) @ halves
    np.testing.assert_allclose(found, quintics, rtol=0, atol=2e-3 * step**5)


def quintic_cells(table):
    """Which cells of a table have terms of the fifth power, those that are no quartics."""
    return np.any(np.asarray(table.coefficients)[:, [5, 11]], axis=1)


def test_a_table_in_single_precision_has_quartics_where_these_meet():
    """All over an arc; not where a straight line begins, nor for tangents that lean, of which all is told."""
    frames = jax.jit(lambda *parts: tables.from_frames(*parts, closed=False))
    table = in_single(frames, *arc(64, 0.0))
    assert table.coefficients.dtype == np.float32 and not quintic_cells(table).any()
    assert quintic_cells(frames(*arc(64, 0.0))).all()
    points, tangents, bends, length = (np.asarray(part) for part in arc(64, 0.0))
    ahead = np.pi / 64.0 * np.arange(1, 65)[:, None] * tangents[-1:]
    joined = (
        np.append(points, points[-1:] + ahead, 0),
        np.append(tangents, np.tile(tangents[-1:], (64, 1)), 0),
    )
    table = in_single(frames, *joined, np.append(bends, np.zeros(64)), 2.0 * length)
    found = quintic_cells(table)
    assert found[64] and not found[:62].any() and not found[67:].any()
    ends = np.stack([table.coefficients[:, :6].sum(1), table.coefficients[:, 6:].sum(1)], axis=-1)
    np.testing.assert_allclose(ends, joined[0][1:], rtol=0, atol=4e-6)
    # Bends that turn the tangent a little too far, though each point is met to rounding.
    table = in_single(frames, points, tangents, 1.001 * bends, length)
    assert quintic_cells(table).all()
    for lean, length in ((0.033, np.pi), (0.037, np.nan)):
        table = in_single(frames, *arc(64, lean))
        np.testing.assert_allclose([table.length, table.span], [length, np.pi], rtol=1e-6, equal_nan=True)


def circle_of_field(kind, radius):
    """A circle as each of the fields that make their table in a way of their own, off the origin."""
    turn = np.linspace(0.0, TURN, 65)[:-1]
    around = jnp.stack([jnp.cos(turn), jnp.sin(turn)], axis=-1)
    centre = jnp.array([0.02, -0.01])
    if kind == "spline":
        return jxr.Spline(centre[None] + radius * around)
    if kind == "curve":
        curve = lambda radius, u: centre + radius * jnp.stack([jnp.cos(u), jnp.sin(u)])  # noqa: E731
        return jxr.Parametric(jax.tree_util.Partial(curve, radius), (0.0, TURN), closed=True)
    network = jxr.geometry.PeriodicNetwork(key=jax.random.key(0), amplitude=0.0)
    return jxr.NeuralCurvature(network, TURN * radius, centre=centre)


# A spline passes through points that are rounded themselves.
@pytest.mark.parametrize(
    ("kind", "close", "slopes_close"),
    [("spline", 5e-4, 4e-2), ("curve", 5e-6, 1e-3), ("network", 5e-6, 1e-3)],
)
def test_curvatures_of_tables_in_single_precision_and_their_derivatives(kind, close, slopes_close):
    """1 / r and -1 / r^2; of quintics both drown in the rounding of points, over the square of a step."""
    places, radius = np.array([0.003, 0.01317, 0.0272, 0.0611]), 0.02

    def curvatures(radius):
        contour = circle_of_field(kind, radius)
        return contour.curvature(jnp.asarray(places, radius.dtype))

    def found(radius):
        both = both_ways(curvatures)
        values, along, _ = both(radius, 1.0, np.ones(4))
        return values, along, np.stack([both(radius, 1.0, one)[2] for one in np.eye(4)])

    values, along, back = in_single(found, np.array(radius))
    assert values.dtype == np.float32
    np.testing.assert_allclose(values, 1.0 / radius, rtol=close)
    for slopes in (along, back):
        np.testing.assert_allclose(slopes, -1.0 / radius**2, rtol=slopes_close)


def test_a_spline_in_single_precision_bends_as_its_points_do():
    """All round an ellipse: neighbouring pieces have tangents apart by more than the rounding of a step."""
    s = np.linspace(0.0, 0.1, 301)
    contour = in_single(lambda points: jxr.Spline(points).tabled(), ellipse_points(64))
    points, found = in_single(lambda s: (contour.point(s), contour.curvature(s)), s)
    angle = np.arctan2(points[:, 1] / 0.014, points[:, 0] / 0.02)
    exact = 0.02 * 0.014 / np.hypot(0.02 * np.sin(angle), 0.014 * np.cos(angle)) ** 3
    np.testing.assert_allclose(found, exact, rtol=0.0, atol=3e-4 * exact.max())


def test_tables_that_do_not_resolve_their_contour_are_read_by_their_span():
    good, bad = straight([1.0, 1.0]), straight([1.0, 1.0])
    bad = eqx.tree_at(lambda t: t.length, bad, jnp.asarray(jnp.nan))
    tree, unresolved = tables.as_it_is_resolved({"one": good, "two": [bad, 3.0]})
    assert bool(unresolved) and tree["two"][1] == 3.0
    assert float(tree["two"][0].length) == 4.0 and float(tree["one"].length) == 4.0
    assert not bool(tables.as_it_is_resolved((good, good))[1])
    assert tables.as_it_is_resolved([1.0, 2.0])[1] is None


def test_an_ellipse_has_cells_for_the_ratio_of_its_axes():
    """20 to the square of the ratio, rounded up to a power of two; four at least."""
    made = lambda ratio, **options: jxr.Ellipse(0.01, 0.01 * ratio, **options).cells  # noqa: E731
    assert [made(r) for r in (1.0, 7.1, 7.2, 1.0 / 7.2, 10.0, 100.0, 0.01)] == [
        1024, 1024, 2048, 2048, 2048, 262144, 262144,
    ]  # fmt: skip
    assert [made(2.0, cells=n) for n in (16, 17)] == [16, 17]
    assert made(4.0, cells=64) == 64 and made(0.25, cells=64) == 64
    for ratio, options, words in (
        (101.0, {}, "argument b must lie between a / 100 and 100 a"),
        (1.0 / 101.0, {}, "argument b must lie between"),
        (4.01, {"cells": 64}, "argument cells must be at least 4 times the square of the ratio"),
        (1.0, {"cells": 15}, "argument cells must"),
    ):
        with pytest.raises(ValueError, match=words):
            made(ratio, **options)
    traced = jax.eval_shape(lambda b: jxr.Ellipse(0.01, b), jnp.asarray(0.02))
    assert traced.cells == 1024
    assert jax.eval_shape(lambda b: jxr.Ellipse(0.01, b, cells=48), jnp.asarray(0.02)).cells == 48


def test_an_ellipse_whose_cells_are_too_few_has_no_length():
    length = jax.jit(lambda a, b: jxr.Ellipse(a, b, cells=16).domain()[1])
    assert 0.09 < float(length(0.02, 0.01)) < 0.1 and 0.09 < float(length(0.01, 0.02)) < 0.1
    assert np.isnan([length(0.02, 0.0099), length(0.0202, 0.01), length(0.0099, 0.02)]).all()


def test_domains_rise_and_the_vertex_of_a_catenary_has_a_radius_of_at_most_a_kilometre():
    for made in (jxr.Line, lambda ends: jxr.Catenary(0.02, ends)):
        np.testing.assert_allclose(np.stack(made((-0.01, 0.03)).domain()), [-0.01, 0.03])
        assert made(None).domain() is None
        for ends in ((0.1, 0.1), (0.2, 0.1)):
            with pytest.raises(ValueError, match="argument domain must be increasing"):
                made(ends)
    for size in (1e-12, 1e3):
        assert float(jxr.Catenary(size).a) == size
    for size in (0.9e-12, 1.1e3):
        with pytest.raises(ValueError, match="argument a must"):
            jxr.Catenary(size)


def test_a_curve_of_ones_own_has_its_origin_within_its_domain_and_ends_where_it_began():
    def made(gap=0.0, sense=1.0, **options):
        u = lambda u: sense * (1.0 + gap) * u  # noqa: E731
        curve = lambda v: jnp.stack([3.0 + jnp.cos(u(v)), 2.0 * jnp.sin(u(v))])  # noqa: E731
        return jxr.Parametric(curve, (0.0, TURN), **({"closed": True} | options))

    assert made().closed and made(origin=TURN).smoothness == np.inf
    assert made(origin=0.0, smoothness=3).smoothness == 3
    for options in ({"origin": -0.01}, {"origin": 6.29}):
        with pytest.raises(ValueError, match="argument origin must lie within"):
            made(**options)
    with pytest.raises(ValueError, match="counter-clockwise round its body, but runs clockwise"):
        made(sense=-1.0)
    made(sense=-1.0, closed=False)
    # Round 4 m the ends are apart by 12.6 times the gap: 4e-9 m are let pass.
    made(gap=2.5e-10)
    for gap in (4e-10, 1e-3):
        with pytest.raises(ValueError, match="argument function must end where it began if closed"):
            made(gap=gap)
    made(gap=1e-3, closed=False)
