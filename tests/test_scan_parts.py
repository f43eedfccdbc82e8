"""Parts of fits of scans in space: splines on grids, thinned clouds, samples of meshes, moments by grids."""

import itertools

import numpy as np
import pytest
from scipy.interpolate import BSpline

from jaxroll.geometry.fitting._field_fit import Grid
from jaxroll.geometry.fitting._field_solve import (
    _gram_matrices,
    _two_scales,
    FieldTargets,
    solved,
    values_matrix,
)
from jaxroll.geometry.fitting._scan import normals_of_net, sampled_mesh, Scan, thinned_scan
from jaxroll.geometry.mass import mass_properties
from jaxroll.geometry.mass._level_moments import _along_knots, _around, _on_grid, _sampled, _triangles
from jaxroll.geometry.surfaces import Implicit, SplineSurface
from tests.subjects.clouds import sphere

BALL = 0.02
SIZE = 4.0 / 3.0 * np.pi * BALL**3


def quintics(cells):
    """SciPy's uniform quintic B-splines that are not zero on cells of width one from zero on."""
    knots = np.arange(-5.0, cells + 6.0)
    return [BSpline.basis_element(knots[j : j + 7], extrapolate=False) for j in range(cells + 5)]


def values(functions, x, order=0):
    return np.stack([np.nan_to_num(f.derivative(order)(x) if order else f(x)) for f in functions])


@pytest.mark.parametrize("cells", [1, 4, 7])
def test_wide_splines_are_sums_of_narrow_ones(cells):
    x = np.linspace(1e-6, cells - 1e-6, 50)
    wide = values(quintics((cells + 1) // 2), x / 2.0)
    np.testing.assert_allclose(_two_scales(cells).T @ values(quintics(cells), x), wide, atol=1e-14)


@pytest.mark.parametrize("cells", [1, 3, 8])
def test_integrals_of_products_of_splines(cells):
    for order, found in enumerate(_gram_matrices(cells + 5)):
        np.testing.assert_allclose(found, gram(cells, order), atol=1e-12)


def gram(cells, order):
    """Integrals of products of derivatives, of polynomials of order ten or less: exact by six points."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    at = values(quintics(cells), (np.arange(cells)[:, None] + 0.5 * (1.0 + nodes)).ravel(), order)
    return (at * np.tile(0.5 * weights, cells)) @ at.T


def test_a_field_of_least_squares():
    """Against dense normal equations with SciPy's B-splines and Gauss's rule, on 13 x 4 x 3 cells."""
    rng, cells, step, roughness, length = np.random.default_rng(0), (13, 4, 3), 0.004, 0.03, 0.4
    origin, size = np.array([-0.02, 0.01, 0.03]), step * np.array(cells)
    points = origin + size * rng.uniform(0.02, 0.98, (500, 3))
    arms = points - origin - [0.5, -0.3, -0.6] * size
    heights = np.linalg.norm(arms, axis=1) - 0.03
    normals = arms / np.linalg.norm(arms, axis=1, keepdims=True)
    weights, slopes = rng.uniform(0.5, 1.0, (2, 500)) * step**2
    slopes[::3] = 0.0
    grid = Grid(origin, step, (18, 9, 8))
    places = (points - origin).T / step
    lines = [[values(quintics(n), x, k).T for k in (0, 1)] for n, x in zip(cells, places, strict=True)]
    orders = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    parts = [[line[k] for line, k in zip(lines, each, strict=True)] for each in orders]
    field, *gradient = (np.einsum("ni,nj,nk->nijk", *each).reshape(500, -1) for each in parts)
    # What is in the norm: heights in cells, and slopes, whose part along the normal counts by its length.
    squeeze = np.eye(3) - (1.0 - length) * normals[:, :, None] * normals[:, None, :]
    areas, wanted = (np.sqrt(weights) / step, np.sqrt(slopes) / step), length * normals
    slope_rows = areas[1][:, None, None] * squeeze @ np.stack(gradient, axis=1)
    matrix = np.concatenate([areas[0][:, None] * field, *slope_rows.swapaxes(0, 1)])
    right = np.concatenate([areas[0] * heights / step, *(areas[1][:, None] * wanted).T])
    form = matrix.T @ matrix
    for orders in itertools.product(range(4), repeat=3):
        if sum(orders) == 3:
            # How many of the 27 third derivatives are this one.
            times = len(set(itertools.permutations("x" * orders[0] + "y" * orders[1] + "z" * orders[2])))
            lines = [gram(n, k) for n, k in zip(cells, orders, strict=True)]
            form += roughness * times * np.kron(np.kron(lines[0], lines[1]), lines[2])
    exact = np.linalg.solve(form, matrix.T @ right)
    targets = FieldTargets(points, heights, weights, normals, slopes, length)
    found = solved(grid, targets, roughness, np.zeros(grid.counts)).ravel() / step
    off = found - exact
    # The iteration ends at a residual of 1e-4, or after 30 steps, which suffices with a good preconditioner.
    assert off @ form @ off < 1e-5 * (exact @ form @ exact)
    np.testing.assert_allclose(values_matrix(grid, points) @ found, field @ found, atol=1e-13)


def test_few_points_stand_for_all():
    points = np.arange(30.0).reshape(10, 3)
    targets = FieldTargets(points, points[:, 0], np.ones(10), points, 2.0 * np.ones(10), 0.5)
    some = targets.sparser(5)
    for found, expected in ((some.points, points), (some.heights, points[:, 0]), (some.normals, points)):
        np.testing.assert_array_equal(found, expected[::2])
    assert (some.weights.tolist(), some.slopes.tolist(), some.length) == ([2.0] * 5, [4.0] * 5, 0.5)
    np.testing.assert_array_equal(targets.sparser(20).points, points)


def test_a_thinned_cloud_has_means_areas_and_normals():
    """A ball of 20 mm: its points' means by brute force, its area, radial normals; three points off it.

    Two are far off, the third so near that its twenty-fourth neighbour is no farther than usual.
    """
    middle = np.array([0.0, 0.0, 0.05])
    normals = np.concatenate([sphere(6000), np.eye(3)])
    cloud = middle + normals * np.append(np.full(6000, BALL), [0.1, 0.1, 0.032])[:, None]
    for given in (normals, None):
        scan, numbers = thinned_scan(cloud, given, 0.0025)
        assert 500 < len(scan.points) < 3000
        assert (numbers[-3:] == -1).all()
        assert (numbers[:-3] >= 0).all()
        means = [cloud[numbers == k].mean(axis=0) for k in range(len(scan.points))]
        np.testing.assert_allclose(scan.points, means, atol=1e-15)
        radial = (scan.points - middle) / np.linalg.norm(scan.points - middle, axis=1, keepdims=True)
        assert np.sum(radial * scan.normals, axis=1).min() > 0.99
        np.testing.assert_allclose(np.linalg.norm(scan.normals, axis=1), 1.0)
        np.testing.assert_allclose(scan.areas.sum(), 4.0 * np.pi * BALL**2, rtol=0.1)
        np.testing.assert_allclose(scan.spacing, np.sqrt(scan.areas.mean()), rtol=0.2)
        assert np.median(scan.sure) > 0.9
        # Without every second point: the numbers of what the others are means of.
        left = np.arange(len(scan.points)) % 2 == 0
        part, after = scan.without(left, numbers)
        kept = (numbers >= 0) & (numbers % 2 == 1)
        np.testing.assert_array_equal(after >= 0, kept)
        np.testing.assert_array_equal(part.points[after[kept]], scan.points[numbers[kept]])


def plane(count):
    """Points a unit apart, shape (count^2, 3)."""
    x = np.arange(float(count))
    return np.stack(np.meshgrid(x, x, [0.0]), axis=-1).reshape(-1, 3)


def test_normals_that_contradict_each_other_are_not_sure():
    """Both normals share their largest component, along z; turned by 40 degrees each to its own side."""
    bend = np.radians(40.0)
    sides = [[np.sin(bend), 0, np.cos(bend)], [-np.sin(bend), 0, np.cos(bend)]]
    scan, _ = thinned_scan(np.repeat(plane(20), 2, axis=0), np.tile(sides, (400, 1)), 0.5)
    np.testing.assert_allclose(scan.sure, 2.0 * np.cos(bend) - 1.0)
    np.testing.assert_allclose(scan.normals, np.tile([0.0, 0.0, 1.0], (400, 1)), atol=1e-15)


def test_double_sheets_are_put_together_at_their_mean():
    """Two planes 0.8 apart, the upper of them of three times the weight."""
    flat = plane(12)
    both = np.concatenate([flat, flat + [0.5, 0.5, 0.8]])
    up = np.tile([0.0, 0.0, 1.0], (len(both), 1))
    scan = Scan(both, up, np.repeat([1.0, 3.0], len(flat)), np.ones(len(both)), 0.75)
    inner = (np.abs(both[:, :2] - 6.0) < 3.0).all(axis=1)
    joined = scan.joined(1.0).points
    np.testing.assert_allclose(joined[inner, :2], both[inner, :2])
    # A point is beside itself, and four of the other sheet are within 0.75.
    mean = np.where(both[:, 2] > 0.0, (3.0 * 0.8 + 4.0 * 0.0) / 7.0, (12.0 * 0.8) / 13.0)
    np.testing.assert_allclose(joined[inner, 2], mean[inner])
    np.testing.assert_array_equal(scan.joined(0.7).points, both)


def test_averages_of_a_scan_keep_areas_and_moments():
    rng = np.random.default_rng(1)
    normals = np.tile([0.0, 0.0, 1.0], (500, 1))
    scan = Scan(rng.uniform(0, 1, (500, 3)), normals, rng.uniform(1, 2, 500), np.full(500, 0.5), 0.1)
    levels = rng.standard_normal(500)
    mean, heights = scan.averaged(0.4, levels)
    assert 20 < len(mean.points) <= 27
    np.testing.assert_allclose(mean.areas.sum(), scan.areas.sum())
    np.testing.assert_allclose(mean.areas @ mean.points, scan.areas @ scan.points)
    np.testing.assert_allclose(mean.areas @ heights, scan.areas @ levels)
    np.testing.assert_allclose(mean.sure, 0.5)
    np.testing.assert_allclose(mean.normals, normals[: len(mean.points)])


def corner():
    """A tetrahedron of edges 1, 2 and 3 cm along the axes, its faces seen from outside."""
    ends = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.02, 0], [0, 0, 0.03]])
    return ends, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def test_points_that_stand_for_no_area_are_no_surface():
    line = np.linspace(0.0, 1.0, 20)[:, None] * np.array([1.0, 2.0, 3.0])
    scan = Scan(line, np.tile([0.0, 0.0, 1.0], (20, 1)), np.zeros(20), np.ones(20), 0.05)
    with pytest.raises(ValueError, match="argument points must cover a surface, but some of them lie along"):
        scan.averaged(0.2, np.zeros(20))


@pytest.mark.parametrize("inside_out", [False, True])
def test_samples_of_a_mesh(inside_out):
    """Middles of k^2 equal parts of each face: its mean, and its second moments but for 1 / k^2 of them."""
    ends, faces = corner()
    points, normals = sampled_mesh(ends, faces[:, ::-1] if inside_out else faces, 0.004)
    assert normals is not None
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    slanted = np.array([6.0, 3.0, 2.0]) / 7.0
    off = 0.01 * 6.0 / 7.0
    for normal, height, which in (*((-np.eye(3)[k], 0.0, k) for k in range(3)), (slanted, off, None)):
        on = np.all(np.abs(normals - normal) < 1e-12, axis=1)
        corners = ends[[k for k in range(4) if k == 0 or k - 1 != which]] if which is not None else ends[1:]
        np.testing.assert_allclose(points[on] @ normal, height, atol=1e-15)
        np.testing.assert_allclose(points[on].mean(axis=0), corners.mean(axis=0), atol=1e-15)
        arms = corners - corners.mean(axis=0)
        whole, count = arms.T @ arms / 12.0, on.sum()
        spread = np.cov(points[on].T, bias=True)
        np.testing.assert_allclose(spread, whole * (1.0 - 1.0 / count), rtol=1e-12, atol=1e-18)
        longest = max(np.linalg.norm(np.roll(corners, 1, axis=0) - corners, axis=1))
        assert count == np.ceil(longest / 0.004) ** 2
    mixed = faces.copy()
    mixed[0] = mixed[0, ::-1]
    assert sampled_mesh(ends, mixed, 0.004)[1] is None


def test_normals_of_a_nets_vertices():
    ends, faces = corner()
    normals, areas = normals_of_net(ends, faces)
    sides = np.array([0.5e-4 * 2, 0.5e-4 * 3, 0.5e-4 * 6, 0.5e-4 * 7])
    vectors = np.array([[0, 0, -1], [0, -1, 0], [-1, 0, 0], [6 / 7, 3 / 7, 2 / 7]]) * sides[:, None]
    for k in range(4):
        around = [i for i in range(4) if k in faces[i]]
        mean = vectors[around].sum(axis=0)
        np.testing.assert_allclose(normals[k], mean / np.linalg.norm(mean), atol=1e-15)
        np.testing.assert_allclose(areas[k], sides[around].sum() / 3.0)


def test_moments_of_an_ellipsoid_by_one_grid():
    """By 8 cells along its side; the closed form to 1e-8. Its middle is not the origin."""
    middle = np.array([0.003, -0.002, 0.005])
    field = lambda x, y, z: (  # noqa: E731
        ((x - middle[0]) ** 2 + (y - middle[1]) ** 2 + 0.5 * (z - middle[2]) ** 2) / BALL - BALL
    )
    egg = Implicit(field, radius=0.03)
    at = egg.spread(64)
    assert at is not None
    known = np.stack([np.asarray(x) for x in at], axis=-1)
    values, axes = _sampled(egg, lambda padding: _around(known, 8, padding))
    found = _on_grid(egg, _triangles(values, axes), 5)
    assert found is not None
    size, squeezed = SIZE * 2.0**0.5, np.array([1.0, 1.0, 2.0])
    np.testing.assert_allclose(found.size, size, rtol=1e-8)
    np.testing.assert_allclose(found.centre, middle, atol=1e-8 * BALL)
    spread = size * BALL**2 / 5.0 * np.diag(squeezed)
    np.testing.assert_allclose(found.spread, spread, atol=1e-7 * spread.max())


def test_the_grid_of_a_field_of_splines_is_that_of_its_knots_and_ends_with_it():
    """14 x 12 x 10 coefficients: five cells fewer. Padding is a share of the longest extent, here 2 mm."""
    corner, step = np.array([-0.02, -0.01, 0.01]), 0.004
    surface = SplineSurface(np.ones((14, 12, 10)), tuple(corner), step)
    known = np.array([[-0.007, 0.001, 0.021], [0.003, 0.003, 0.023]])
    axes = _along_knots(surface, known, 1, 0.2)
    for axis, start, last in zip(axes, corner, (7, 4, 4), strict=True):
        ends = start + step * np.array([2, last])
        np.testing.assert_allclose(axis[[0, -1]], ends, atol=1e-16)
        np.testing.assert_allclose(np.diff(axis), step, rtol=1e-12)
    halves = _along_knots(surface, known, 2, 0.2)
    assert [len(axis) for axis in halves] == [2 * len(axis) - 1 for axis in axes]
    whole = _along_knots(surface, known, 1, 9.0)
    for axis, start, cells in zip(whole, corner, (9, 7, 5), strict=True):
        np.testing.assert_allclose(axis, start + step * np.arange(cells + 1), atol=1e-16)
    # A formula is known everywhere.
    wide = _around(known, 10, 9.0)
    assert all(axis[0] < -0.06 and axis[-1] > 0.09 for axis in wide)


def test_moments_of_a_field_of_splines_are_exact_to_its_knots():
    """A ball's field in splines is exact: x^2 + y^2 + z^2 has coefficients sum of x_i^2 - step^2 / 2."""
    step, radius, count = 0.004, 0.013, 14
    nodes = step * (np.arange(count) - 0.5 * (count - 1))
    # The functions' centres are the nodes; the quintic's variance is half a cell squared.
    squares = nodes**2 - 0.5 * step**2
    field = squares[:, None, None] + squares[:, None] + squares - radius**2
    corner = nodes[0] + 2.0 * step
    surface = SplineSurface(field / (2.0 * radius), (corner,) * 3, step)
    ball = mass_properties(surface, 1000.0)
    size = 4.0 / 3.0 * np.pi * radius**3
    np.testing.assert_allclose(ball.size, size, rtol=1e-9)
    np.testing.assert_allclose(ball.centre, 0.0, atol=1e-9 * radius)
    np.testing.assert_allclose(
        ball.inertia, 400.0 * size * radius**2 * np.eye(3), atol=1e-8 * size * radius**2
    )
    assert ball.error < 1e-6
