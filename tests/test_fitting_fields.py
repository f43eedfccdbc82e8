"""Parts of fits of fields in space, against dense matrices, loops and formulas."""

import functools
import itertools
import types
from typing import Any

import numpy as np
import pytest
from scipy.linalg import cho_solve
from scipy.special import erf

from jaxroll.geometry import fit_surface, smoothing_for
from jaxroll.geometry.fitting import (
    _field_fit,
    _field_solve,
    _indicator,
    _scan,
    _smoothing,
    _surface_fit,
    _surface_measured,
    _surface_normals,
    _visibility,
)
from jaxroll.geometry.fitting._field_fit import AXES, Grid, grid_around, offsets, rows
from jaxroll.geometry.surfaces import SplineSurface
from tests.helpers import refused
from tests.oracles.bands import full
from tests.subjects.clouds import sphere

TALL = ((9, 7, 8), (8, 9, 7), (7, 8, 9), (9, 8, 7), (8, 7, 9), (7, 9, 8))


@pytest.mark.parametrize("counts", TALL)
def test_the_shortest_axis_of_a_grid_runs_fastest(counts):
    """Then the middle one, seven places at a time, then the longest."""
    grid = Grid(np.zeros(3), 1.0, counts)
    assert grid.strides == tuple({7: 1, 8: 7, 9: 56}[n] for n in counts)
    assert grid.band == 5 * (1 + 7 + 56)
    numbers = [i * grid.strides[0] + j * grid.strides[1] + k * grid.strides[2]
               for i, j, k in itertools.product(range(6), repeat=3)]  # fmt: skip
    assert offsets(grid).tolist() == numbers


def test_a_grid_is_the_smallest_with_its_margin_in_the_middle():
    points = np.array([[0.1, 2.0, -1.0], [0.4, 2.9, -1.0], [0.7, 2.1, -1.0]])
    grid = grid_around(points, 0.25, 1.5)
    # 0.6, 0.9 and 0 and three cells of margin: 5.4, 6.6 and 3 cells.
    assert grid.counts == (6 + 5, 7 + 5, 3 + 5) and grid.step == 0.25
    middle = grid.origin + 0.5 * 0.25 * np.array([6, 7, 3])
    np.testing.assert_allclose(middle, [0.4, 2.45, -1.0], rtol=1e-12)
    assert grid_around(points, 0.25, 0.0).counts == (3 + 5, 4 + 5, 1 + 5)


def test_a_grids_matrix_takes_half_a_gigabyte_at_most(monkeypatch):
    """Of a cube of n functions along each axis 8 n^3 (5 (1 + n + n^2) + 1) bytes."""
    ends = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    assert grid_around(ends, 1.0 / 20.999, 0.0).counts == (26, 26, 26)
    size = 8 * 10**3 * (5 * (1 + 10 + 100) + 1)
    for most, fair in ((size, True), (size - 1, False)):
        monkeypatch.setattr(_field_fit, "_MEMORY", most)
        with refused("5 x 5 x 5 cells", not fair):
            grid_around(ends, 0.21, 0.0)
    monkeypatch.undo()
    with pytest.raises(ValueError, match=r"22 x 22 x 22 cells: its system would take 0.6 GB"):
        grid_around(ends, 1.0 / 21.999, 0.0)


def test_points_beyond_a_grid_belong_to_its_last_cells():
    grid = Grid(np.array([1.0, 2.0, 3.0]), 0.5, (9, 8, 7))
    places = np.array([[-1.0, 0.5, 0.1], [0.0, 1.0, 1.0], [3.7, 2.2, 1.9], [4.0, 3.0, 2.0], [9.0, 9.0, 9.0]])
    cells = np.array([[0, 0, 0], [0, 1, 1], [3, 2, 1], [3, 2, 1], [3, 2, 1]])
    data = rows(grid, grid.origin + 0.5 * places)
    assert data.base.tolist() == (cells @ grid.strides).tolist()
    np.testing.assert_allclose(data.field((0, 0, 0)).sum(axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(data.field((0, 1, 0)).sum(axis=1), 0.0, atol=1e-6)
    assert data.field((0, 0, 0), slice(1, 3)).shape == (2, 216)
    numbers = _field_solve._places(grid, grid.origin + 0.5 * places)
    wanted = [
        [
            np.ravel_multi_index((a + i, b + j, c + k), grid.counts)
            for i, j, k in itertools.product(range(6), repeat=3)
        ]
        for a, b, c in cells
    ]
    assert numbers.tolist() == wanted


# The preconditioner: what the form is on coarser grids.


def targets(grid, count=300, seed=1):
    rng = np.random.default_rng(seed)
    size = grid.step * (np.array(grid.counts) - 5)
    points = grid.origin + size * rng.uniform(0.03, 0.97, (count, 3))
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    weights, slopes = rng.uniform(0.5, 1.0, (2, count)) * grid.step**2
    slopes[::4] = 0.0
    return _field_solve.FieldTargets(points, rng.normal(size=count), weights, normals, slopes, 0.3)


@pytest.fixture(scope="module")
def levels():
    """A grid of 16 x 4 x 4 cells and two coarser ones, with dense forms of all three."""
    grid = Grid(np.array([0.1, -0.2, 0.3]), 0.02, (21, 9, 9))
    given, rough = targets(grid), 0.07
    found = _field_solve._levels(grid, given, rough)
    matrix = _field_solve._data(grid, given)[0].toarray()
    grams = [_field_solve._gram_matrices(n) for n in grid.counts]
    roughness = np.zeros((21 * 81, 21 * 81))
    for a, b, c in itertools.product(range(4), repeat=3):
        if a + b + c == 3:
            times = 6.0 / np.prod([float(np.prod(range(1, n + 1))) for n in (a, b, c)])
            roughness += times * np.kron(np.kron(grams[0][a], grams[1][b]), grams[2][c])
    forms, ways = [matrix.T @ matrix + rough * roughness], []
    for cells in ((16, 4, 4), (8, 2, 2)):
        ways.append(functools.reduce(np.kron, [_field_solve._two_scales(n) for n in cells]))
        forms.append(ways[-1].T @ forms[-1] @ ways[-1])
    return found, forms, ways, roughness


def test_coarser_grids_have_the_form_of_the_finest(levels):
    """Their functions are sums of finer ones, so that their forms follow from the finest one's."""
    found, forms, _, roughness = levels
    assert len(found) == 3
    ridge = 1e-12 * np.diag(forms[2]).max()
    for level, form, more in zip(found, forms, (0.0, 0.0, ridge), strict=True):
        np.testing.assert_allclose(level.diagonal.ravel(), np.diag(form) + more, rtol=1e-9)
    assert found[0].factor is None and found[1].factor is None
    lower = np.tril(found[2].factor)
    np.testing.assert_allclose(lower @ lower.T, forms[2], atol=1e-8 * forms[2].max())
    x = np.random.default_rng(2).normal(size=(21, 9, 9))
    np.testing.assert_allclose(found[0].rough(x).ravel(), roughness @ x.ravel(), atol=1e-9)


def test_corrections_of_all_grids_are_added_up(levels):
    found, forms, ways, _ = levels
    residual = np.random.default_rng(3).normal(size=(21, 9, 9))
    first = ways[0].T @ residual.ravel()
    second = ways[1].T @ first
    wanted = residual.ravel() / np.diag(forms[0]) + ways[0] @ (
        first / np.diag(forms[1]) + ways[1] @ cho_solve((found[2].factor, True), second)
    )
    corrected = _field_solve._corrected(found, residual)
    assert corrected.shape == (21, 9, 9)
    np.testing.assert_allclose(corrected.ravel(), wanted, rtol=1e-6, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize(("cells", "number"), [
    ((6, 6, 6), 1), ((7, 6, 6), 2), ((12, 12, 12), 2), ((13, 3, 4), 3), ((12, 12, 1), 1), ((24, 2, 12), 2),
])  # fmt: skip
def test_the_coarsest_grid_has_six_cells_or_one_across(cells, number, monkeypatch):
    made = []

    def form(grid, given, grams, rough, scale, *, whole):
        made.append((grid, rough, scale, whole))
        return None, None

    monkeypatch.setattr(_field_solve, "_form", form)
    grid = Grid(np.arange(3.0), 0.5, tuple(n + 5 for n in cells))
    assert len(_field_solve._levels(grid, None, 0.3)) == number
    for k, (coarse, rough, scale, whole) in enumerate(made):
        assert scale == 2.0**k and rough == pytest.approx(0.3 / 8.0**k) and whole == (k == number - 1)
        assert coarse.step == 0.5 * 2.0**k and coarse.origin.tolist() == [0.0, 1.0, 2.0]
        assert [n - 5 for n in coarse.counts] == [-(-n // 2**k) for n in cells]


def test_a_field_that_is_solved_already_stays():
    grid = Grid(np.array([0.1, -0.2, 0.3]), 0.02, (10, 9, 8))
    given, rough = targets(grid, 200), 0.07
    matrix, right = _field_solve._data(grid, given)
    level = _field_solve._levels(grid, given, rough)[0]
    exact = np.linalg.solve(np.tril(level.factor) @ np.tril(level.factor).T, matrix.T @ right)
    wanted = 0.02 * exact.reshape(grid.counts)
    for start in (wanted, np.zeros(grid.counts)):
        found = _field_solve.solved(grid, given, rough, start)
        np.testing.assert_allclose(found, wanted, atol=1e-4 * np.abs(wanted).max())


def test_targets_are_scaled_by_the_roots_of_their_weights():
    """Heights in cells; gradients less 0.7 of their part along the normal, where there are any."""
    grid = Grid(np.array([0.1, -0.2, 0.3]), 0.02, (10, 9, 8))
    given = targets(grid, 12)
    matrix, right = _field_solve._data(grid, given)
    data, places = rows(grid, given.points), _field_solve._places(grid, given.points)
    part = np.flatnonzero(given.slopes > 0.0)
    assert matrix.shape == (12 + 3 * 9, 720) and len(part) == 9
    for i in range(12):
        wanted = np.zeros(720)
        wanted[places[i]] = data.field((0, 0, 0))[i] * np.sqrt(given.weights[i]) / 0.02
        np.testing.assert_allclose(matrix[i].toarray()[0], wanted, rtol=1e-12)
        assert right[i] == pytest.approx(np.sqrt(given.weights[i]) * given.heights[i] / 0.02**2, rel=1e-12)
    for row, i in enumerate(part):
        normal = given.normals[i]
        gradient = np.stack([data.field(axis)[i] for axis in AXES])
        squeezed = np.sqrt(given.slopes[i]) / 0.02 * (np.eye(3) - 0.7 * np.outer(normal, normal)) @ gradient
        wanted = np.zeros((3, 720))
        wanted[:, places[i]] = squeezed
        at = slice(12 + 3 * row, 15 + 3 * row)
        np.testing.assert_allclose(matrix[at].toarray(), wanted, atol=1e-12)
        np.testing.assert_allclose(right[at], np.sqrt(given.slopes[i]) / 0.02 * 0.3 * normal, rtol=1e-12)


# What is inside.


def test_the_box_about_a_scan_has_room_and_sizes_quick_to_transform():
    points = np.array([[0.0, 1.0, 2.0], [0.1, 1.04, 2.02]])
    origin, step, shape = _indicator._box(points, 0.0105)
    # 0.16, 0.10 and 0.08 with 0.03 on all sides: 17, 11 and 9 nodes, 17 and 11 of which have large factors.
    assert step == 0.0105 and shape == (18, 12, 9)
    np.testing.assert_allclose(origin + 0.00525 * (np.array(shape) - 1), points.mean(axis=0), rtol=1e-12)
    _, least, many = _indicator._box(points, 1e-5)
    assert least == pytest.approx(np.cbrt(0.16 * 0.10 * 0.08 / 6e6), rel=1e-12)
    assert 6e6 <= np.prod(many) < 7e6


def ball(count, radius=1.0, middle=(0.0, 0.0, 0.0), **changes):
    """A scan of a ball, evenly spread."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - 5.0**0.5) * np.arange(count)
    normals = np.stack([np.sqrt(1.0 - z**2) * np.cos(angle), np.sqrt(1.0 - z**2) * np.sin(angle), z], axis=1)
    found = {
        "areas": np.full(count, 4.0 * np.pi * radius**2 / count),
        "sure": np.ones(count),
        "spacing": 0.05,
    }
    return _scan.Scan(np.array(middle) + radius * normals, normals, **(found | changes))


def blurred_ball(r, radius, width):
    """One inside a ball and zero outside, smoothed by a Gaussian of that standard deviation."""
    ends = [(radius - r) / (2.0**0.5 * width), (radius + r) / (2.0**0.5 * width)]
    step = 0.5 * (erf(ends[0]) + erf(ends[1]))
    return step - width / ((2.0 * np.pi) ** 0.5 * r) * (np.exp(-(ends[0] ** 2)) - np.exp(-(ends[1] ** 2)))


@pytest.mark.parametrize(("step", "spacing"), [(0.12, 0.05), (0.1, 0.25)])
@pytest.mark.parametrize("sure", [1.0, 0.5])
def test_the_indicator_of_a_ball_is_that_ball_blurred(step, spacing, sure):
    """By a Gaussian as wide as a step or the spacing; points share their strength linearly among nodes."""
    scan = ball(6000, 1.0, (0.3, -0.2, 0.1), spacing=spacing, sure=np.full(6000, sure))
    origin, shape = np.array([-1.7, -2.1, -2.0]), (36, 40, 45) if step == 0.1 else (32, 32, 36)
    values = _indicator._potential(scan, origin, step, shape)
    assert values.shape == shape
    nodes = np.stack(
        np.meshgrid(*(o + step * np.arange(n) for o, n in zip(origin, shape, strict=True)), indexing="ij"),
        axis=-1,
    )
    r = np.linalg.norm(nodes - (0.3, -0.2, 0.1), axis=-1)
    wanted = -sure * blurred_ball(np.maximum(r, 1e-3), 1.0, np.sqrt(max(step, spacing) ** 2 + step**2 / 6.0))
    np.testing.assert_allclose(values - values.mean(), wanted - wanted.mean(), atol=0.012 * sure)


def test_values_are_shared_among_the_eight_nodes_around():
    place, values = np.array([[1.25, 2.5, 0.125], [3.0, 0.75, 1.0]]), np.array([8.0, -2.0])
    found = _indicator._splatted(place, values, (5, 4, 3))
    wanted = np.zeros((5, 4, 3))
    for at, value in zip(place, values, strict=True):
        for node in itertools.product(range(5), range(4), range(3)):
            wanted[node] += value * np.prod(np.maximum(1.0 - np.abs(np.array(node) - at), 0.0))
    np.testing.assert_allclose(found, wanted, atol=1e-15)
    field = np.add.outer(np.add.outer(2.0 * np.arange(5), 3.0 * np.arange(4)), -np.arange(3.0))
    np.testing.assert_allclose(_indicator._linear(field, place), place @ [2.0, 3.0, -1.0], rtol=1e-12)
    np.testing.assert_allclose(_indicator._linear(field, np.array([[9.0, -1.0, 0.5]])), [7.5])


def test_a_body_is_enclosed_by_its_scan():
    """The indicator's middle value lies on the points; the net is the ball's surface, seen from outside."""
    scan = ball(4000, 0.02, (0.1, 0.2, -0.3), spacing=1e-3)
    body = _indicator.enclosed(scan, 2e-3)
    assert body.step == 2e-3 and abs(np.median(body.at(scan.points))) < 0.02
    away = np.linalg.norm(body.vertices - (0.1, 0.2, -0.3), axis=1)
    assert np.abs(away - 0.02).max() < 5e-4 and len(body.vertices) > 300
    inside = body.at(np.array([(0.1, 0.2, -0.3), (0.1, 0.215, -0.3), (0.1, 0.225, -0.3)]))
    assert inside[0] == pytest.approx(-0.5, abs=0.06) and inside[1] < -0.3 and inside[2] > 0.3
    a, b, c = (body.vertices[body.triangles[:, k]] - (0.1, 0.2, -0.3) for k in range(3))
    assert np.sum(a * np.cross(b, c)) / 6.0 == pytest.approx(4.0 / 3.0 * np.pi * 0.02**3, rel=0.05)


@pytest.mark.parametrize(("share", "fair"), [(0.049, True), (0.051, False)])
def test_a_twentieth_of_a_scan_may_lie_on_other_bodies(share, fair):
    """Its points lie a spacing outside of the nodes that count."""
    values = np.ones((20, 8, 8))
    values[2:8, 2:6, 2:6] = values[12:15, 2:6, 2:6] = -1.0
    outward = np.array([(-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    points = np.array([(2.0, 4.0, 4.0), (14.0, 4.0, 4.0)]) + 0.9 * outward
    scan = _scan.Scan(points + (0.5, 0.0, 0.0), outward, np.array([1.0 - share, share]), np.ones(2), 1.0)
    with refused(r"but 5 % of them lie on 1 other$", not fair):
        found = _indicator._alone(values, scan, np.array([0.5, 0.0, 0.0]), 1.0)
        assert (found < 0.0).sum() == 6 * 16 and (found[12:15] > 0.0).all()


# Numbers near a surface.


def test_angles_between_normals():
    turn = np.radians([0.0, 10.0, 50.0])
    normals = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    mean, most = _surface_measured.angles(normals * (1.0 + 1e-15), np.tile([1.0, 0.0, 0.0], (3, 1)))
    assert mean == pytest.approx(np.radians((2600.0 / 3.0) ** 0.5), rel=1e-9)
    assert most == pytest.approx(np.radians(50.0), rel=1e-9)
    assert _surface_measured.angles(-normals[:1], normals[:1])[1] == pytest.approx(np.pi)


@pytest.mark.parametrize("batch", [3, 7, 100])
def test_levels_are_worked_out_batch_by_batch(batch, monkeypatch):
    """Of a linear field; the middle of the first function is two cells before the grid."""
    monkeypatch.setattr(_surface_measured, "_BATCH", batch)
    step, origin = 0.5, np.array([1.0, 2.0, 3.0])
    nodes = [o + step * (np.arange(n) - 2.0) for o, n in zip(origin, (9, 8, 7), strict=True)]
    field = np.add.outer(np.add.outer(2.0 * nodes[0], 3.0 * nodes[1]), -1.0 * nodes[2]) - 7.0
    surface = SplineSurface(field, tuple(origin), step)
    points = origin + np.random.default_rng(4).uniform(0.0, 1.0, (7, 3)) * step * np.array([4.0, 3.0, 2.0])
    np.testing.assert_allclose(
        _surface_measured.levels_at(surface, points), points @ [2.0, 3.0, -1.0] - 7.0, rtol=1e-9
    )
    assert _surface_measured.levels_at(surface, points[:0]).shape == (0,)


# Surfaces of clouds.


@pytest.mark.parametrize("counts", TALL)
def test_a_field_in_the_order_of_its_unknowns_becomes_a_surface_in_metres(counts):
    grid = Grid(np.array([1.0, 2.0, 3.0]), 0.25, counts)
    found = np.random.default_rng(5).normal(size=504)
    surface = _surface_fit._surface(grid, found)
    for i, j, k in ((0, 0, 0), (1, 2, 3), (6, 5, 4), tuple(n - 1 for n in counts)):
        number = i * grid.strides[0] + j * grid.strides[1] + k * grid.strides[2]
        assert float(surface.coefficients[i, j, k]) == 0.25 * found[number]
    assert surface.coefficients.shape == counts and float(surface.step) == 0.25


def test_a_cloud_is_fitted_by_least_squares():
    """Against dense matrices; the mean square of distances and the trace of what maps heights to fits."""
    rng, wavelength = np.random.default_rng(6), 0.05
    normals = sphere(70) * 1.0
    points = normals * (0.02, 0.017, 0.014) + (0.3, 0.1, -0.2) + 2e-4 * rng.normal(size=(70, 3))
    areas = rng.uniform(0.5, 1.5, 70) * 4e-5
    problem = _surface_fit._Problem(points, normals, areas)
    probes = rng.choice([-1.0, 1.0], size=(3, 70))
    surface, square, used = problem.solved(wavelength, probes)
    step = wavelength / 2.5
    grid = grid_around(points, step, 2.0)
    data, size = rows(grid, points), int(np.prod(grid.counts))
    places = data.base[:, None] + offsets(grid)
    matrix, slopes = np.zeros((70, size)), np.zeros((70, 3, size))
    np.put_along_axis(matrix, places, data.field((0, 0, 0)), axis=1)
    for k, axis in enumerate(AXES):
        np.put_along_axis(slopes[:, k], places, data.field(axis), axis=1)
    share = wavelength / (2.0 * np.pi)
    # Areas in squares of cells, lengths in cells.
    value = areas / step**2
    slope = 0.02 * (share / step) ** 2 * value
    flat = np.eye(3) - 0.9 * normals[:, :, None] * normals[:, None, :]
    turned = (np.sqrt(slope)[:, None, None] * flat @ slopes).reshape(-1, size)
    rough = full(_field_fit.roughness_band(grid))
    form = matrix.T @ (value[:, None] * matrix) + turned.T @ turned + 3.0 / 16.0 * (share / step) ** 5 * rough
    right = np.einsum("n,nki,nk->i", 0.01 * slope, slopes, normals)
    inverse = np.linalg.solve(
        form, np.concatenate([right[:, None], matrix.T @ (value[:, None] * probes.T)], axis=1)
    )
    found = inverse[:, 0]
    lengths = np.linalg.norm(slopes @ found, axis=1)
    heights = step * (matrix @ found) / np.median(lengths)
    np.testing.assert_allclose(_surface_measured.levels_at(surface, points), heights, atol=1e-6 * step)
    assert square == pytest.approx(np.mean((step * (matrix @ found) / lengths) ** 2), rel=1e-6)
    assert used == pytest.approx(np.mean(np.sum(probes.T * (matrix @ inverse[:, 1:]), axis=0)) / 70, rel=1e-6)
    np.testing.assert_allclose(surface.origin, grid.origin)


class Ladder:
    """A problem whose fits have these squares and shares of degrees of freedom, one after the other."""

    def __init__(self, told):
        self.told, self.asked = told, []
        self.points = np.array([[0.0, 0.0, 0.0], [0.01, 0.04, 0.02], [0.02, 0.01, 0.0]])

    def solved(self, wavelength, probes):
        assert probes.shape == (2, 3) and set(np.abs(probes).ravel()) == {1.0}
        self.asked.append(wavelength)
        if len(self.asked) > len(self.told):
            raise ValueError("argument smoothing must be larger")
        return (len(self.asked), *self.told[len(self.asked) - 1])


LADDERS = {
    "falls": (None, [(1.0, 0.0), (0.9, 0.0), (0.8, 0.0), (0.7, 0.0)], 4, 5),
    "rises": (None, [(1.0, 0.0), (0.9, 0.0), (0.9, 0.001), (0.1, 0.0)], 2, 3),
    "by less than a hundredth": (None, [(1.0, 0.0), (0.991, 0.0), (0.1, 0.0)], 1, 2),
    "by a hundredth": (None, [(1.0, 0.0), (0.99, 0.0), (0.985, 0.0)], 2, 3),
    "freedom counts": (None, [(1.0, 0.5), (0.9, 0.6), (0.1, 0.0)], 1, 2),  # 4 and 5.6
    "freedom counts twice": (None, [(1.0, 0.5), (0.5, 0.6), (0.6, 0.6)], 2, 3),  # 4 and 3.1, 3.75
    "noise, more": (1.0, [(1.0, 0.1), (0.5, 0.36), (0.1, 0.1)], 1, 2),  # 1.2 and 1.22
    "noise, less": (1.0, [(1.0, 0.1), (0.5, 0.32), (0.9, 0.32)], 2, 3),  # 1.2 and 1.14
    "noise squared": (0.5, [(1.0, 0.1), (0.9, 0.29), (0.9, 0.5)], 1, 2),  # 1.05 and 1.045
    "to the end": (None, [(0.5**k, 0.0) for k in range(12)], 10, 10),
}


@pytest.mark.parametrize("name", LADDERS)
def test_wavelengths_fall_by_a_quarter_while_the_estimate_does(name):
    noise, told, best, tried = LADDERS[name]
    problem = Ladder(told)
    wavelength, number = _surface_fit._chosen(problem, noise)
    assert number == best and wavelength == pytest.approx(0.04 * 0.75 ** (best + 1), rel=1e-12)
    np.testing.assert_allclose(problem.asked, 0.04 * 0.75 ** np.arange(2, 2 + tried))


def test_a_grid_too_fine_at_first_is_refused_and_no_noise_is_none():
    cloud = np.array([[0.0, 0.0, 0.0], [0.01, 0.04, 0.02]])
    lengths = functools.partial(_surface_fit._lengths, cloud)
    assert lengths(None, 0) == (None, 0.0) and lengths(4.0, None) == (4.0, None)
    assert lengths(None, None) == (None, None)
    with pytest.raises(ValueError, match="smoothing must be larger"):
        _surface_fit._chosen(Ladder([]), None)


def test_a_surface_bends_no_more_than_its_smoothing_or_is_not_to_be_trusted():
    verdict = lambda *asked: _surface_fit._verdict(*asked)[0]  # noqa: E731
    fine = "the points lie 100 um rms from it, and it bends no more than its smoothing"
    wave = 2.0 * np.pi / 100.0
    assert verdict((-99.0, 99.0), wave, 1e-4, 4.9e-4) == fine
    assert _surface_fit._verdict((-99.0, 99.0), wave, 1e-4, 4.9e-4)[1] == ()
    assert (
        verdict((-50.0, 101.0), wave, 1e-4, 0.0)
        == "not to be trusted: it bends with a radius of 9.9 mm; give smallest_radius"
    )
    assert "a radius of 9.8 mm" in verdict((-102.0, 50.0), wave, 1e-4, 0.0)
    # Farther than five times the usual distance, and than a twentieth of the wavelength.
    assert verdict((-1.0, 1.0), 0.1, 1e-3, 0.005) == verdict((-1.0, 1.0), 0.1, 1e-4, 0.0049).replace(
        "100 um", "1e+03 um"
    )
    assert (
        verdict((-1.0, 1.0), 0.1, 1e-3, 0.0051)
        == "not to be trusted: a point is 5.1 mm off it; give smallest_radius"
    )
    assert verdict((-1.0, 1.0), 0.2, 1e-4, 0.0099).startswith("the points")
    assert " and a point is 5.1 mm" in verdict((-1.0, 90.0), 0.1, 1e-3, 0.0051)


@pytest.mark.parametrize(("count", "given", "radius", "asked"), [
    (99, {}, None, 100), (100, {}, None, None), (99, {"faces": [[0, 1, 2]]}, None, 100),
    (3, {"faces": [[0, 1, 2]]}, 0.01, 4), (4, {"faces": [[0, 1, 2]]}, 0.01, None), (99, {}, 0.01, 100),
])  # fmt: skip
def test_a_cloud_has_a_hundred_points_and_a_mesh_four_vertices(count, given, radius, asked, monkeypatch):
    seen = []
    monkeypatch.setattr(_surface_fit, "_smoothed", lambda *args: seen.append(args) or "smooth")
    monkeypatch.setattr(_surface_fit, "fit_scan", lambda *args: seen.append(args) or "scan")
    points = np.random.default_rng(7).normal(size=(count, 3))
    with refused(f"points must have at least {asked} rows, but had {count}", asked is not None):
        found = _surface_fit.fit_surface(points, smallest_radius=radius, **given)
        assert found == ("smooth" if radius is None else "scan") and len(seen) == 1


def test_normals_of_a_meshs_faces_are_turned_outward(monkeypatch):
    """Of its vertices that are used; given normals come first, scaled to one."""
    seen = []
    monkeypatch.setattr(_surface_fit, "_smoothed", lambda *args: seen.append(args))
    rng = np.random.default_rng(8)
    points = np.concatenate([sphere(120), [[5.0, 5.0, 5.0]]]) * 0.02 + (0.3, 0.0, 0.0)
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points[:120])
    faces = hull.simplices.copy()
    inward = (
        np.einsum(
            "ni,ni->n",
            np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]),
            points[faces[:, 0]] - (0.3, 0.0, 0.0),
        )
        < 0.0
    )
    faces[inward] = faces[inward][:, ::-1]
    for turned in (faces, faces[:, ::-1]):
        _surface_fit.fit_surface(points, faces=turned)
        cloud, normals, smoothing, noise = seen.pop()
        np.testing.assert_array_equal(cloud, points[:120])
        assert np.sum(normals * (cloud - (0.3, 0.0, 0.0)), axis=1).min() > 0.019 * 0.9
        assert smoothing is None and noise is None
    given = rng.uniform(0.5, 2.0, (121, 1)) * sphere(121, 1.0)
    _surface_fit.fit_surface(points, given, faces=faces, smoothing=0.2)
    cloud, normals, smoothing, noise = seen.pop()
    unit = given / np.linalg.norm(given, axis=1, keepdims=True)
    np.testing.assert_allclose(normals, unit[:120], rtol=1e-12)
    np.testing.assert_array_equal(cloud, points[:120])
    assert (smoothing, noise) == (0.2, None)
    with pytest.raises(ValueError, match="argument noise must be left out with smallest_radius"):
        _surface_fit.fit_surface(points, smallest_radius=0.01, noise=1e-4)


@pytest.mark.parametrize("count", [50_000, 50_001])
def test_clouds_of_more_than_fifty_thousand_points_are_thinned(count, monkeypatch):
    """To cells of a hundred and twentieth of the largest extent."""
    seen = []
    thin = types.SimpleNamespace(points=np.zeros((9, 3)), normals=np.ones((9, 3)), areas=np.full(9, 2.0))
    monkeypatch.setattr(_surface_fit, "thinned_scan", lambda *args: (seen.append(args) or thin, None))
    monkeypatch.setattr(_surface_fit, "_few", lambda cloud, given: _surface_fit._Problem(cloud, given, cloud))
    monkeypatch.setattr(_surface_fit, "_chosen", lambda problem, noise: ((problem, noise), "surface"))
    monkeypatch.setattr(_surface_fit, "_reported", lambda *args: args)
    cloud = np.zeros((count, 3))
    cloud[0], cloud[1] = (1.0, 2.0, 3.0), (1.5, 4.4, -1.0)
    surface, problem, (same, noise), whole, given = _surface_fit._smoothed(cloud, cloud, None, 0.25)
    assert surface == "surface" and same is problem and noise == 0.25 and whole is given is cloud
    assert len(problem.points) == (9 if count > 50_000 else count)
    if count > 50_000:
        assert seen[0][2] == pytest.approx(4.4 / 120, rel=1e-12) and seen[0][0] is cloud


def test_a_report_of_a_smoothed_surface(monkeypatch):
    cloud = np.random.default_rng(9).normal(size=(6, 3))
    off = np.array([1.0, 2.0, 2.0, 0.0, 0.0, 3.0])
    feet = cloud + off[:, None] * (0.0, 0.6, 0.8)
    normals = np.tile([0.0, 1.0, 0.0], (6, 1))
    curvatures = np.array([[-3.0, 1.0], [2.0, 4.0], *[[0.0, 0.5]] * 4])
    monkeypatch.setattr(_surface_fit, "measured", lambda surface, points: (feet, normals, curvatures))
    surface: Any = types.SimpleNamespace(coefficients=np.zeros((9, 8, 7)), step=0.25, smoothness=4)
    problem = _surface_fit._Problem(cloud, normals, np.array([1.0, 4.0, 9.0, 16.0, 25.0, 100.0]) * 1e-4)
    fit = _surface_fit._reported(surface, problem, 0.7, cloud, normals[:, [1, 0, 2]])
    report = fit.report
    assert (report.points, report.cells, report.step, report.smoothing) == (6, (4, 3, 2), 0.25, 0.7)
    assert (report.rms, report.largest) == (pytest.approx(3.0**0.5), pytest.approx(3.0))
    assert report.area == pytest.approx(155e-4) and report.curvature == (-3.0, 4.0)
    assert report.normals == pytest.approx((0.5 * np.pi, 0.5 * np.pi))
    assert report.reach == pytest.approx(3.0 * 0.035) and report.tolerance == pytest.approx(5.0 * 3.0**0.5)
    assert _surface_fit._reported(surface, problem, 1e5, cloud, None).report.tolerance == pytest.approx(100.0)
    assert _surface_fit._reported(surface, problem, 1e5, cloud, None).report.normals is None
    curvatures[0, 0] = np.nan
    with refused("the fit to them is not finite"):
        _surface_fit._reported(surface, problem, 0.7, cloud, None)


# Normals of a cloud.


@pytest.mark.parametrize("count", [24, 80, 10])
def test_a_point_stands_for_the_disc_of_its_23_neighbours(count):
    points = np.random.default_rng(10).normal(size=(count, 3))
    near, areas = _surface_normals.neighbourhoods(points)
    away = np.linalg.norm(points[:, None] - points, axis=2)
    many = min(24, count)
    np.testing.assert_array_equal(near, np.argsort(away, axis=1)[:, :many])
    np.testing.assert_allclose(
        areas, np.pi * np.sort(away, axis=1)[:, many - 1] ** 2 / (many - 1), rtol=1e-12
    )


def test_normals_point_out_by_gausss_theorem():
    """By areas: a far face of small area that points in does not decide."""
    normals = sphere(50)
    points = normals + (3.0, 1.0, -2.0)
    for side in (1.0, -1.0):
        np.testing.assert_array_equal(_surface_normals.outward(points, side * normals, np.ones(50)), normals)
    areas = np.where(np.arange(50) < 40, 1e-3, 1.0)
    mixed = np.where(np.arange(50)[:, None] < 40, -normals, normals)
    np.testing.assert_array_equal(_surface_normals.outward(points, -mixed, areas), mixed)


@pytest.mark.parametrize("radius", [None, 0.3])
@pytest.mark.parametrize("count", [300, 9000])
def test_normals_that_point_into_the_body_are_refused(count, radius):
    """Whatever their lengths; some of very many tell."""
    normals = sphere(count)
    points = normals * (1.0, 0.8, 1.2) + (3.0, 1.0, -2.0)
    with pytest.raises(ValueError, match="^argument normals must point out of the body, but on the whole"):
        fit_surface(points, -2.0 * normals, smallest_radius=radius)


@pytest.mark.parametrize("first", [12, 30])
def test_a_tree_joins_the_most_points_wherever_they_stand(first):
    """Two clouds far apart, of twelve and of thirty points, whichever comes first."""
    points = np.random.default_rng(13).normal(size=(42, 3))
    points[first:] += 100.0
    near = np.argsort(np.linalg.norm(points[:, None] - points, axis=2), axis=1)[:, :9]
    order, before = _surface_normals._tree(sphere(42), near)
    most = range(12, 42) if first == 12 else range(30)
    assert sorted(order) == list(most) and set(before[order[1:]]) <= set(most)


def test_places_are_looked_up_in_the_cells_of_a_box():
    free = np.arange(24).reshape(2, 3, 4)
    place = np.array([[0.9, 1.2, 3.99], [-2.0, 0.0, 0.0], [1.0, 7.0, 2.5]])
    assert _visibility._at(free, place).tolist() == [7.0, 0.0, 22.0]


@pytest.mark.parametrize(("area", "width"), [(1e-4, 2.0 / 80), (4e-2, 0.4)])
@pytest.mark.parametrize("seen", [1.0, 0.01])
def test_patches_of_normals_turn_to_where_more_ways_are_free(area, width, seen, monkeypatch):
    """By loops: patches of links that turn by a cosine of 0.8, their votes by area, twenty rounds."""
    rng, count = np.random.default_rng(12), 91
    points = rng.uniform(0.0, 1.0, (count, 3)) * (1.0, 2.0, 0.5)
    points[:2] = (0.5, 0.0, 0.1), (0.5, 2.0, 0.1)
    normals = rng.normal(size=(count, 3)) * 0.5 + np.where(rng.uniform(size=(count, 1)) < 0.5, 1.0, -1.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    near = np.argsort(np.linalg.norm(points[:, None] - points, axis=2), axis=1)[:, :24]
    areas = area * rng.uniform(0.5, 1.5, count) ** 2
    areas *= area / np.median(areas)
    views, asked = seen * rng.integers(-8, 9, (2, count)), []
    monkeypatch.setattr(_visibility, "_free_ways", lambda cells: (asked.append(cells), "free")[1])
    monkeypatch.setattr(
        _visibility, "_at", lambda free, place: (asked.append(place), views[len(asked) - 2])[1]
    )
    found = _visibility.turned_outward(points, normals, near, areas)
    origin = points.min(axis=0) - 4.0 * width
    np.testing.assert_array_equal(asked[0], np.floor((points - origin) / width))
    for place, side in zip(asked[1:], (1.0, -1.0), strict=True):
        np.testing.assert_allclose(
            place, (points + side * 2.5 * width * normals - origin) / width, rtol=1e-12
        )
    patch = list(range(count))
    for i, j in itertools.product(range(count), range(1, 11)):
        if normals[i] @ normals[near[i, j]] > 0.8:
            old, new = patch[near[i, j]], patch[i]
            patch = [new if p == old else p for p in patch]
    sight = views[0] - views[1]
    votes = [sum(areas[k] * sight[k] for k in range(count) if patch[k] == patch[i]) for i in range(count)]
    signs = np.where(np.array(votes) < 0.0, -1.0, 1.0)
    for _ in range(20):
        heard = [sum(normals[i] @ normals[k] * signs[k] for k in near[i, 1:11]) for i in range(count)]
        signs = np.where(0.5 * sight + heard < 0.0, -1.0, 1.0)
    assert 20 < np.sum(signs < 0.0) < 70
    np.testing.assert_array_equal(found, signs[:, None] * normals)


# How much to smooth from the noise.


@pytest.mark.parametrize("noise, degree", [(None, 5), (4e-4, 5), (2e-5, 5), (4e-4, 3), (4e-4, 7), (4e-4, 9)])
@pytest.mark.parametrize("closed", [True, False])
def test_smoothing_is_the_best_of_six_hundred_wavelengths(noise, degree, closed):
    """By the matrix that maps data to fit, for each of them: from two knots a wave, halved, to the length."""
    rng, n = np.random.default_rng(11), 60
    u = 2.0 * np.pi * np.arange(n) / n if closed else np.linspace(0.0, 4.0, n)
    points = 0.03 * np.stack([np.cos(u), 0.7 * np.sin(u + 0.1 * np.sin(2.0 * u))], axis=1) + (0.1, 0.05)
    points += 2e-4 * rng.normal(size=(n, 2))
    matrix, rough, length = (np.asarray(x) for x in _smoothing._forms(points, 20, degree, closed))
    normal = matrix.T @ matrix / n
    waves = np.geomspace(length / matrix.shape[1], length, 600)
    scores = []
    for wave in waves:
        inverse = np.linalg.solve(normal + (wave / (2.0 * np.pi)) ** 6 / length * rough, matrix.T / n)
        trace = np.sum(matrix.T * inverse)
        square = np.sum((points - matrix @ (inverse @ points)) ** 2)
        scores.append(square / (n - trace) ** 2 if noise is None else square + 4.0 * noise**2 * trace)
    found = smoothing_for(points, closed=closed, noise=noise, knots=20, degree=degree)
    best = int(np.argmin(scores))
    assert found == pytest.approx(waves[best], rel=1e-6)
    assert 0 < best < 599 or noise == 2e-5
