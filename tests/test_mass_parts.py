"""Parts of the integrals of mass: cut tetrahedra, carried triangles, rules, refinements, what is refused."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial import ConvexHull
from scipy.special import gamma

import jaxroll as jxr
from jaxroll.geometry import Chart, mass_properties, Patch, SplineSurface
from jaxroll.geometry.mass import _level_moments as level, _surface_moments as surface
from jaxroll.geometry.mass._mesh_moments import mesh_moments
from jaxroll.geometry.mass._moments import centred, checked, difference, from_cones, inertia_of, Moments
from jaxroll.geometry.surfaces import Ellipsoid


def body(size, centre, spread, error=0.0):
    return Moments(size, np.asarray(centre, float), np.asarray(spread, float), error)


def test_bodies_differ_by_the_largest_of_three_shares():
    """Volumes by their sum, 5 m^3; centres by the extent, of which 5 / 5 is the square; spreads by both."""
    one = body(2.0, [1.0, 2.0, 3.0], np.diag([1.0, 1.5, 2.5]))
    far = body(2.0, [1.0, 2.0, 3.0], np.diag([1.0, 1.5, 2.5]))
    assert difference(one, far) == 0.0
    assert difference(one, far._replace(size=-3.0)) == pytest.approx(5.0 / 5.0)
    extent = np.sqrt(5.0 / 4.0)
    shifted = far._replace(centre=np.array([1.1, 1.7, 3.2]))
    assert difference(one, shifted) == pytest.approx(0.3 / extent)
    turned = far._replace(spread=np.array([[1.0, 0.2, -0.7], [0.2, 1.5, 0.0], [-0.7, 0.0, 2.6]]))
    assert difference(one, turned) == pytest.approx(0.7 / 5.0)
    inside_out = one._replace(size=-2.0, spread=-one.spread)
    assert difference(inside_out, inside_out._replace(centre=one.centre + 0.1)) == pytest.approx(0.1 / extent)


def test_moments_that_settled_to_a_millionth_are_taken_with_their_change():
    found = body(2.0, np.zeros(3), np.eye(3))
    assert checked(found, 9e-7, None).error == 9e-7
    for moments, change in ((found, 1.1e-6), (found, np.nan), (None, 0.0), (found._replace(size=0.0), 0.0)):
        with pytest.raises(ValueError, match="argument shape must"):
            checked(moments, change, None)


def test_moments_of_a_body_placed_elsewhere_keep_their_size_and_error():
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    found = body(3.0, [2.0, 5.0], [[1.0, 0.3], [0.3, 4.0]], 1e-7).placed(turn, np.array([10.0, 20.0]))
    assert (found.size, found.error) == (3.0, 1e-7)
    np.testing.assert_allclose(found.centre, [5.0, 22.0])
    np.testing.assert_allclose(found.spread, [[4.0, -0.3], [-0.3, 1.0]])


def test_cones_over_the_sides_of_a_box_are_the_box():
    """2 x 3 x 5 m, from a point within that is not its middle; Gauss's rule of two is exact here."""
    sides, about = np.array([2.0, 3.0, 5.0]), np.array([0.3, 1.1, 4.0])
    nodes = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
    points, cones = [], []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        for end in (0.0, sides[axis]):
            for x in nodes:
                for y in nodes:
                    point = np.zeros(3)
                    point[axis], point[others] = end, sides[others] * [x, y]
                    out = (1.0 if end else -1.0) * (end - about[axis])
                    points.append(point - about)
                    cones.append(0.25 * sides[others].prod() * out)
    found = from_cones(np.array(points), np.array(cones), about)
    assert found.size == pytest.approx(30.0)
    np.testing.assert_allclose(found.centre, [1.0, 1.5, 2.5])
    np.testing.assert_allclose(found.spread, 30.0 / 12.0 * np.diag(sides**2), atol=1e-12)
    inertia = inertia_of(found.spread, 2.0)
    np.testing.assert_allclose(inertia, 5.0 * np.diag([34.0, 29.0, 13.0]), atol=1e-12)


def test_moments_about_the_centre_are_those_about_another_point_less_its_share():
    found = centred(2.0, np.array([0.4, -0.6]), np.array([[1.0, 0.2], [0.2, 3.0]]), np.array([5.0, 7.0]))
    np.testing.assert_allclose(found.centre, [5.2, 6.7])
    np.testing.assert_allclose(found.spread, [[1.0 - 0.08, 0.2 + 0.12], [0.2 + 0.12, 3.0 - 0.18]])
    assert float(inertia_of(found.spread, 10.0)) == pytest.approx(10.0 * (0.92 + 2.82))


def test_a_tetrahedron_is_cut_by_the_plane_on_which_a_linear_field_is_zero():
    """Triangles lie in the plane, and have the area of the hull of where it meets the edges."""
    rng = np.random.default_rng(4)
    places = rng.normal(size=(40, 4, 3))
    normal = np.array([0.6, 0.0, 0.8])
    levels = places @ normal - 0.1
    both = (levels < 0).any(axis=1) & (levels >= 0).any(axis=1)
    places, levels = places[both], levels[both]
    inside = (levels < 0).sum(axis=1)
    assert set(inside) == {1, 2, 3}
    across = np.array([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0]])
    for corners, values, count in zip(places, levels, inside, strict=True):
        triangles = np.concatenate(level._cut(corners[None], values[None]))
        assert len(triangles) == (2 if count == 2 else 1)
        np.testing.assert_allclose(triangles @ normal, 0.1, atol=1e-13)
        sides = triangles[:, 1:] - triangles[:, :1]
        area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()
        pairs = [(i, j) for i in range(4) for j in range(i) if (values[i] < 0) != (values[j] < 0)]
        meets = [
            corners[i] + (corners[j] - corners[i]) * values[i] / (values[i] - values[j]) for i, j in pairs
        ]
        assert area == pytest.approx(ConvexHull(np.array(meets) @ across.T).volume, rel=1e-10)


def test_triangles_of_a_plane_through_a_grid_of_uneven_cells_have_its_area():
    axes = [np.linspace(0.0, 2.0, 4), np.linspace(1.0, 2.0, 3), np.linspace(-1.0, 3.0, 6)]
    x, y, _ = np.meshgrid(*axes, indexing="ij")
    triangles = level._triangles(x + 2.0 * y - 4.2, axes)
    np.testing.assert_allclose(triangles[..., 0] + 2.0 * triangles[..., 1], 4.2, atol=1e-13)
    sides = triangles[:, 1:] - triangles[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()
    # From (0.2, 2) to (2, 1.1): as far as the box is wide, but for its corner.
    assert area == pytest.approx(4.0 * np.hypot(1.8, 0.9))


def test_a_field_that_is_zero_at_nodes_has_its_triangles_there_once():
    axes = [np.linspace(0.0, 2.0, 5), np.linspace(1.0, 2.0, 3), np.linspace(-1.0, 3.0, 6)]
    x, _, _ = np.meshgrid(*axes, indexing="ij")
    for sign in (1.0, -1.0):
        triangles = level._triangles(sign * (x - 1.0), axes)
        np.testing.assert_allclose(triangles[..., 0], 1.0, atol=1e-15)
        sides = triangles[:, 1:] - triangles[:, :1]
        assert 0.5 * np.linalg.norm(np.cross(*np.moveaxis(sides, 1, 0)), axis=1).sum() == pytest.approx(4.0)


def test_triangles_that_are_carried_nowhere_have_the_moments_of_the_polyhedron(monkeypatch):
    """A tetrahedron, two of whose faces run clockwise: their area vectors are turned by their signs."""
    corners, faces = tetrahedron()
    faces[[1, 2]] = faces[[1, 2], ::-1]
    turned = np.repeat([1.0, -3.0, -0.2, 2.0], 9)
    monkeypatch.setattr(
        level, "_carried_over", lambda _, places, one, other: (places, np.cross(one, other), turned)
    )
    found = level._on_grid(None, corners[faces], 3)
    assert found.size == pytest.approx(5.0)
    np.testing.assert_allclose(found.centre, [10.5, 20.75, 31.25])


def test_places_beside_an_ellipsoid_are_carried_onto_it_along_the_gradient_with_their_sides():
    """A third beside it they still arrive to rounding; the area vector is that of differences."""
    egg = Ellipsoid(0.02, 0.03, 0.05)
    axes = np.array([0.02, 0.03, 0.05])
    rng = np.random.default_rng(3)
    way = rng.normal(size=(6, 3))
    places = axes * way / np.linalg.norm(way, axis=1, keepdims=True) * rng.uniform(0.85, 1.25, (6, 1))
    one, other = 1e-3 * rng.normal(size=(2, 6, 3))
    carried = lambda at: level._carried_over(egg, at, one, other)  # noqa: E731
    points, areas, sides = carried(places)
    np.testing.assert_allclose(((points / axes) ** 2).sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.cross(points - places, places / axes**2), 0.0, atol=1e-12)
    h = 1e-3
    slopes = [(carried(places + h * x)[0] - carried(places - h * x)[0]) / (2.0 * h) for x in (one, other)]
    np.testing.assert_allclose(areas, np.cross(*slopes), atol=1e-6 * np.abs(areas).max())
    np.testing.assert_allclose(sides, np.sum(areas * points / axes**2, axis=1), rtol=1e-6)
    # From far the search is not over, but of high order: seven digits from half as far again.
    far = level._carried_over(egg, axes * np.array([[0.0, 0.9, 1.2]]), one[:1], other[:1])[0]
    assert abs(((far / axes) ** 2).sum() - 1.0) < 3e-8


def test_rows_go_through_a_program_in_batches_of_one_length(monkeypatch):
    monkeypatch.setattr(level, "_BATCH", 4)
    shapes, rows = [], np.arange(18.0).reshape(9, 2)

    def program(given, batch):
        shapes.append(batch.shape)
        return batch * given, batch.sum(axis=1)

    double, sums = level._batched(program, 2.0, rows)
    assert shapes == [(4, 2)] * 3
    np.testing.assert_array_equal(double, 2.0 * rows)
    np.testing.assert_array_equal(sums, rows.sum(axis=1))


def test_a_grid_about_points_has_its_cells_along_the_longest_side_and_is_never_symmetric():
    known = np.array([[0.0, 2.0, -1.0], [4.0, 3.0, 9.0], [1.0, 2.5, 0.0]])
    axes = level._around(known, 20, 0.2)
    assert [len(axis) - 1 for axis in axes] == [8, 6, 20]
    np.testing.assert_allclose([axis[0] for axis in axes], [-2.0, 0.0, -3.0])
    np.testing.assert_allclose([axis[-1] for axis in axes], [6.06, 5.06, 11.06])
    for axis in axes:
        np.testing.assert_allclose(np.diff(axis), (axis[-1] - axis[0]) / (len(axis) - 1))


@pytest.mark.parametrize(("radius", "paddings"), [(0.5, [0.08]), (1.3, [0.08, 0.16, 0.32])])
def test_a_grid_is_widened_until_the_inside_does_not_reach_its_ends(monkeypatch, radius, paddings):
    def field(_, rows):
        return (jnp.linalg.norm(rows, axis=1) - radius,)

    monkeypatch.setattr(level, "_values", field)
    asked = []

    def axes_with(padding):
        asked.append(padding)
        return [np.linspace(-1.0 - padding, 1.0 + padding, n) for n in (21, 22, 23)]

    values, axes = level._sampled(None, axes_with)
    np.testing.assert_allclose(asked, paddings)
    x, y, z = np.meshgrid(*axes, indexing="ij")
    np.testing.assert_allclose(values, np.sqrt(x**2 + y**2 + z**2) - radius, atol=1e-14)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("end", [-0.6, 0.6])
def test_a_grid_is_widened_also_if_the_inside_reaches_one_end_alone(monkeypatch, axis, end):
    middle = jnp.zeros((1, 3)).at[0, axis].set(end)
    monkeypatch.setattr(level, "_values", lambda _, rows: (jnp.linalg.norm(rows - middle, axis=1) - 0.5,))
    asked = []

    def axes_with(padding):
        asked.append(padding)
        return [np.linspace(-1.0 - padding, 1.0 + padding, 21)] * 3

    level._sampled(None, axes_with)
    np.testing.assert_allclose(asked, [0.08, 0.16])


@pytest.mark.parametrize("radius", [-0.1, 9.0])
def test_what_has_no_inside_or_no_end_is_no_body_after_four_grids(monkeypatch, radius):
    monkeypatch.setattr(level, "_values", lambda _, rows: (jnp.linalg.norm(rows, axis=1) - radius,))
    asked = []

    def axes_with(padding):
        asked.append(padding)
        return [np.linspace(-1.0, 1.0, 5)] * 3

    with pytest.raises(ValueError, match="argument shape must be closed with its inside where the field"):
        level._sampled(None, axes_with)
    np.testing.assert_allclose(asked, [0.08, 0.16, 0.32, 0.64])


def refinements(monkeypatch, shape, changes):
    """Which grids and rules a shape is integrated by, if each changes the volume by such a share."""
    grids, sizes = [], iter(np.cumprod([1.0, *(1.0 + np.array(changes))]))
    monkeypatch.setattr(level, "_sampled", lambda _, axes_with: (None, axes_with(0.1)))
    monkeypatch.setattr(level, "_triangles", lambda _, axes: [len(axis) - 1 for axis in axes])

    def on_grid(_, cells, nodes):
        grids.append((*cells, nodes))
        size = next(sizes)
        return None if np.isnan(size) else body(size, np.zeros(3), np.eye(3))

    monkeypatch.setattr(level, "_on_grid", on_grid)
    return level.level_moments(shape), grids


def spread(count):
    assert count == 720
    return np.array([-1.0, 1.0, 0.0]), np.array([-0.5, 0.5, 0.0]), np.array([-0.25, 0.25, 0.0])


def test_grids_of_a_formula_become_finer_until_the_moments_settle(monkeypatch):
    shape = types.SimpleNamespace(spread=spread)
    cells = [(16, 8, 6), (32, 16, 8), (64, 32, 16), (96, 48, 24)]
    found, grids = refinements(monkeypatch, shape, [1e-3, 1.8e-9, 0.0])
    assert grids == [(*each, 5) for each in cells[:3]]
    assert found.error == pytest.approx(0.9e-9, rel=1e-3)
    found, grids = refinements(monkeypatch, shape, [1e-3, 3e-9, 1e-7])
    assert grids == [(*each, 5) for each in cells]
    assert found.error == pytest.approx(0.5e-7, rel=1e-3)
    with pytest.raises(ValueError, match="still change by 2.0e-06 of themselves"):
        refinements(monkeypatch, shape, [1e-3, 3e-9, 4e-6])
    with pytest.raises(ValueError, match="still change by inf of themselves"):
        refinements(monkeypatch, shape, [np.nan] * 3)


def test_grids_of_a_field_of_splines_are_its_own_and_their_halves(monkeypatch):
    monkeypatch.setattr(SplineSurface, "spread", lambda self, count: spread(count))
    shape = SplineSurface(np.ones((14, 12, 10)), (-1.55, -1.0, -0.5), 0.3)
    whole, half = (8, 5, 4), (16, 10, 8)
    assert refinements(monkeypatch, shape, [1.8e-6])[1] == [(*whole, 5), (*whole, 7)]
    # A change that is let pass by the loop but not by the check at its end is none.
    found, grids = refinements(monkeypatch, shape, [3e-6, 1e-6])
    assert grids == [(*whole, 5), (*whole, 7), (*half, 7)]
    assert found.error == pytest.approx(5e-7, rel=1e-3)


@pytest.mark.parametrize(
    ("sides", "sizes", "resolved"),
    [
        ([[1, 1, 1, 1], [1, 1, 1, 1]], [1.0, 1.0], True),
        ([[1, 1, 1, 1], [-1, -1, -1, -1]], [1.0, 1.0], True),
        ([[1, 1, 1, 1], [1, 1, 1, -1]], [1.0, 1.0], False),
        ([[1, 1, 1, 1], [1, 1, 1, -1]], [1.0, 0.2e-6], True),
        ([[1, 1, 1, 1], [1, 1, 1, -1]], [1.0, 0.35e-6], False),
        ([[1, 1, 1, 1], [1, 1, 1, 1]], [1.0, np.nan], False),
    ],
)
def test_triangles_that_are_folded_do_not_resolve_a_surface_unless_they_are_slivers(
    monkeypatch, sides, sizes, resolved
):
    def carried(_, places, one, other):
        areas = np.repeat(np.array(sizes), 4)[:, None] * np.cross(one, other)
        points = np.where(np.isnan(areas), np.nan, places)
        return points, np.nan_to_num(areas), np.array(sides, float).ravel()

    monkeypatch.setattr(level, "_carried_over", carried)
    corners = np.array([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1]], [[1, 0, 0], [0, 2, 0], [0, 0, -3]]])
    assert (level._on_grid(None, corners, 2) is not None) == resolved


@pytest.mark.parametrize("exponent", [2.0, 2.5, 4.0, 7.0])
def test_superellipsoids_are_integrals_over_their_slices(exponent):
    """Slices across x are superellipses, whose area is a quotient of gamma functions."""
    a, b, c = 0.03, 0.02, 0.012
    p = exponent
    flat = 4.0 * b * c * gamma(1.0 + 1.0 / p) ** 2 / gamma(1.0 + 2.0 / p)
    across = lambda k: quad(lambda x: x**k * (1.0 - x**p) ** (2.0 / p), 0.0, 1.0, epsabs=1e-13)[0]  # noqa: E731
    found = surface._rounded(jnp.array([a, b, c]), p)
    assert float(found.size) == pytest.approx(2.0 * a * flat * across(0), rel=1e-8)
    second = 2.0 * a**3 * flat * across(2)
    wanted = second * np.diag(np.array([a, b, c]) ** 2) / a**2
    np.testing.assert_allclose(found.spread, wanted, rtol=1e-7, atol=1e-20)
    np.testing.assert_array_equal(found.centre, np.zeros(3))


def test_a_rule_on_panels_is_exact_to_the_fifteenth_power():
    places, weights = surface._rule(np.array([0.5, 2.0]), 3)
    assert places.shape == weights.shape == (24,)
    assert np.all((places[:8] > 0.5) & (places[:8] < 1.0)) and np.all(np.diff(places) > 0)
    for power in (0, 1, 8, 15):
        whole = (2.0 ** (power + 1) - 0.5 ** (power + 1)) / (power + 1)
        assert places**power @ weights == pytest.approx(whole, rel=1e-13)


def chart_of(kind, periodic=(False, False)):
    domain = ((0.0, np.pi), (0.0, 2.0 * np.pi)) if kind == "turned" else ((0.0, 2.0), (0.0, 3.0))
    return Chart(lambda u, v: (u, v, u * v), domain=domain, periodic=periodic)


def panels(monkeypatch, chart, changes):
    """How many panels a chart is integrated on, if each refinement changes the volume by such a share."""
    counts, sizes = [], iter(np.cumprod([1.0, *(1.0 + np.array(changes))]))
    monkeypatch.setattr(surface, "_check_edges", lambda *_: None)

    def on_panels(_, ends, given):
        np.testing.assert_array_equal(ends, np.asarray(chart.domain()))
        counts.append(tuple(given))
        return body(next(sizes), np.zeros(3), np.eye(3))

    monkeypatch.setattr(surface, "_on_panels", on_panels)
    return surface._chart_moments(chart), counts


def test_panels_of_a_chart_are_halved_until_the_moments_settle(monkeypatch):
    chart = chart_of("flat")
    found, counts = panels(monkeypatch, chart, [1e-3, 1.8e-12, 0.0])
    assert counts == [(4, 4), (8, 8), (16, 16)]
    assert found.error == pytest.approx(0.9e-12, rel=1e-3)
    found, counts = panels(monkeypatch, chart, [1e-3, 3e-12, 1e-5, 1e-6, 1e-7])
    assert counts == [(n, n) for n in (4, 8, 16, 32, 64, 128)]
    assert found.error == pytest.approx(0.5e-7, rel=1e-3)
    with pytest.raises(ValueError, match="still change"):
        panels(monkeypatch, chart, [1e-3, 1e-3, 1e-3, 1e-3, 4e-6])


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ((7, 9), [(6, 8), (12, 16), (24, 32), (48, 64), (96, 128)]),
        ((80, 71), [(79, 70), (158, 140)]),
        # At least one refinement, however many cells a patch has.
        ((150, 140), [(149, 139), (298, 278)]),
        ((7, 201), [(6, 200), (12, 400)]),
    ],
)
def test_panels_of_a_patch_are_its_cells(monkeypatch, shape, expected):
    patch = Patch(np.random.default_rng(0).normal(size=(*shape, 3)))
    found, counts = panels(monkeypatch, patch, [1e-7] * (len(expected) - 1))
    assert counts == expected
    assert found.error == pytest.approx(0.5e-7, rel=1e-3)


def lune(u, v):
    return 0.1 + 0.03 * jnp.sin(u) * jnp.cos(v), 0.2 + 0.02 * jnp.sin(u) * jnp.sin(v), 0.012 * jnp.cos(u)


@pytest.mark.parametrize(
    ("low", "high", "words"), [(0.1, np.pi, "u = 0.1"), (0.0, 3.0, "u = 3"), (0.0, np.pi, None)]
)
def test_a_chart_is_closed_where_its_ends_are_poles(low, high, words):
    chart = Chart(lune, domain=((low, high), (0.0, 2.0 * np.pi)), periodic=(False, True))
    if words is None:
        found = mass_properties(chart, 1.0)
        size = 4.0 / 3.0 * np.pi * 0.03 * 0.02 * 0.012
        assert float(found.size) == pytest.approx(size, rel=1e-12)
        np.testing.assert_allclose(found.centre, [0.1, 0.2, 0.0], atol=1e-14)
        wanted = size / 5.0 * np.diag([0.02**2 + 0.012**2, 0.03**2 + 0.012**2, 0.03**2 + 0.02**2])
        np.testing.assert_allclose(found.inertia, wanted, atol=1e-12 * wanted.max())
        return
    with pytest.raises(ValueError, match=f"argument shape must be closed, .* an edge at {words}"):
        mass_properties(chart, 1.0)


def tetrahedron():
    corners = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 5.0]])
    return corners + [10.0, 20.0, 30.0], np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def test_a_tetrahedron_has_the_moments_of_textbooks_also_with_empty_triangles():
    """Volume 5, centre at a quarter of its sides, spread V / 80 (3 on, -1 off the diagonal) times sides."""
    corners, faces = tetrahedron()
    sides = np.array([2.0, 3.0, 5.0])
    wanted = 5.0 / 80.0 * (4.0 * np.eye(3) - 1.0) * np.outer(sides, sides)
    corners = np.concatenate([corners, corners[1:2]])
    for given in (faces, np.concatenate([faces, [[1, 1, 2], [3, 1, 4]]])):
        found = mesh_moments(corners, given)
        assert found.size == pytest.approx(5.0)
        np.testing.assert_allclose(found.centre, [10.5, 20.75, 31.25])
        np.testing.assert_allclose(found.spread, wanted)


@pytest.mark.parametrize(
    "faces",
    [
        [[0, 2, 1, 3]],
        [0, 2, 1],
        [[0, 2, 1], [0, 1, -1], [0, -1, 2], [1, 2, -1]],
        [[0, 2, 4], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        np.zeros((0, 3)),
    ],
)
def test_faces_that_are_no_triples_of_corners_are_refused(faces):
    with pytest.raises(ValueError, match="argument shape must"):
        mass_properties((tetrahedron()[0], faces), 1.0)


def test_a_hole_is_found_by_its_edges_however_their_ends_are_numbered():
    """A cube without a side whose corners are 0, 5, 1 and 6, in this order: low and high ones in turn."""
    corners = np.array(
        [[0, 0, 0], [1, 1, 0], [1, 0, 1], [1, 1, 1], [0, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    )
    faces = [(2, 3, 4), (2, 4, 7), (0, 5, 2), (0, 2, 7), (5, 1, 3), (5, 3, 2), (1, 6, 4), (1, 4, 3)]
    faces += [(6, 0, 7), (6, 7, 4)]
    words = r"must be a watertight mesh, but 4 of its 17 edges .* the first between vertices \(0, 5\)"
    with pytest.raises(ValueError, match=words):
        mesh_moments(corners, np.array(faces))
    whole = mesh_moments(corners, np.array([*faces, (0, 6, 1), (0, 1, 5)]))
    assert whole.size == pytest.approx(1.0)


class Rows:
    """What is an array to NumPy alone."""

    def __init__(self, rows):
        self.rows = rows

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.rows, dtype)


def test_a_mesh_of_anything_that_numpy_reads_but_not_of_traced_numbers():
    corners, faces = tetrahedron()
    assert float(mass_properties((Rows(corners), Rows(faces)), 1.0).mass) == pytest.approx(5.0)
    with pytest.raises(ValueError, match="argument shape must be known before tracing"):
        jax.eval_shape(lambda x: mass_properties((x, faces), 1.0).mass, corners)


def test_a_mesh_may_be_given_as_lists_with_whole_numbers_as_floats():
    corners, faces = tetrahedron()
    for given in ((corners, faces), [corners.tolist(), (1.0 * faces).tolist()]):
        assert float(mass_properties(given, 3.0).mass) == pytest.approx(15.0)
    for several in ([jxr.Sphere(0.01), jxr.Sphere(0.02)], (jxr.Circle(0.01),)):
        with pytest.raises(ValueError, match="argument shape must be one shape, but was several"):
            mass_properties(several, 1.0)
    for bad in (types.SimpleNamespace(vertices=corners), types.SimpleNamespace(faces=faces), (corners,)):
        with pytest.raises(ValueError, match="argument shape must be a contour, a surface, or vertices"):
            mass_properties(bad, 1.0)


class Disc(jxr.AbstractContour):
    """A caller's disc off the origin, without a table, which may run the wrong way round."""

    sense: float

    closed, smoothness = True, float("inf")

    def curve(self, s):
        angle = self.sense * s / 0.02
        return jxr.geometry.Vec2(0.5 + 0.02 * jnp.cos(angle), 0.3 + 0.02 * jnp.sin(angle))

    def domain(self):
        return 0.01, 0.01 + 0.04 * np.pi


def test_a_contour_of_ones_own_is_integrated_without_a_table_and_must_run_counter_clockwise():
    found = mass_properties(Disc(1.0), 2.0)
    np.testing.assert_allclose(found.mass, 2.0 * np.pi * 0.02**2, rtol=1e-13)
    np.testing.assert_allclose(found.centre, [0.5, 0.3], rtol=1e-13)
    np.testing.assert_allclose(found.inertia, np.pi * 0.02**4, rtol=1e-12)
    with pytest.raises(ValueError, match="run counter-clockwise round its body, .* this Disc was -0.0"):
        mass_properties(Disc(-1.0), 2.0)


def _boxes(*placed):
    """Cuboids of 1, 2 and 3 cm as a mesh: scale and place along x of each, and whether it is inside out."""
    cube = np.array([(i & 1, i >> 1 & 1, i >> 2) for i in range(8)]) - 0.5
    sides = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = np.array([f for a, b, c, d in sides for f in ((a, b, c), (a, c, d))])
    corners = [scale * cube * (0.01, 0.02, 0.03) + np.array([x, 0.0, 0.0]) for scale, x, _ in placed]
    whole = [(faces[:, ::-1] if turned else faces) + 8 * i for i, (_, _, turned) in enumerate(placed)]
    return np.concatenate(corners), np.concatenate(whole)


@pytest.mark.parametrize(
    ("other", "share"),
    [
        ((1.0, 0.03, False), 2.0),
        ((1.0, 0.01, False), 2.0),
        ((0.5, 0.0, True), 0.875),
        ((0.5, 0.0075, False), 1.125),
    ],
)
def test_a_mesh_of_two_bodies_or_with_a_cavity(other, share):
    """Apart, side by side, one within the other."""
    found = mesh_moments(*_boxes((1.0, 0.0, False), other))
    assert float(found.size) == pytest.approx(6e-6 * share, rel=1e-12)


@pytest.mark.parametrize(
    ("other", "times"),
    [((1.0, 0.004, False), 2), ((0.5, 0.0, False), 2), ((1.0, 0.0, False), 2), ((0.9, 0.05, True), -1)],
)
def test_a_mesh_that_encloses_a_place_twice_or_inside_out_is_refused(other, times):
    """Overlapping, one within the other, all faces twice, and a part that is inside out beside another."""
    with pytest.raises(ValueError, match=f"places which it encloses {times} times: parts of it overlap"):
        mesh_moments(*_boxes((1.0, 0.0, False), other))


def test_a_part_of_a_mesh_without_area_encloses_nothing():
    """Two triangles of three corners in a row, back to back: without a word of what has no direction."""
    corners, faces = _boxes((1.0, 0.0, False))
    row = np.array([(0.1, 0.0, 0.0), (0.2, 0.0, 0.0), (0.3, 0.0, 0.0)])
    both = faces.max() + 1 + np.array([(0, 1, 2), (0, 2, 1)])
    with np.errstate(all="raise"):
        found = mesh_moments(np.concatenate([corners, row]), np.concatenate([faces, both]))
    assert float(found.size) == pytest.approx(6e-6, rel=1e-12)
