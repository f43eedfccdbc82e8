"""Parts of surfaces: even places, nets, splines of axes, steps to a foot, starts of searches, limits."""

import functools
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline, make_interp_spline

import jaxroll as jxr
from jaxroll._linalg._space import Sym3, Vec3
from jaxroll.geometry import (
    Chart,
    Extruded,
    Hollow,
    Patch,
    Plane,
    Sphere,
    SplineSurface,
    Superellipsoid,
    Torus,
)
from jaxroll.geometry.surfaces import (
    _gauss as gauss,
    _net as nets,
    _spline_net as spline_nets,
    _spread as spreads,
    _surface_chart as charts,
    _surface_closed_forms as forms,
    _surface_spline as surfaces,
    _tensor_bspline as splines,
)

TURN = 2.0 * np.pi


def test_directions_are_even_in_height_and_turn_by_the_golden_ratio():
    found = spreads.directions(5)
    np.testing.assert_allclose(found[:, 2], [0.8, 0.4, 0.0, -0.4, -0.8], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)
    turns = np.unwrap(np.arctan2(found[:, 1], found[:, 0])) / TURN
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    np.testing.assert_allclose(np.mod(np.diff(turns) - golden + 0.5, 1.0), 0.5, atol=1e-12)
    assert turns[0] == 0.0


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_lattice_steps_by_powers_of_the_root_of_its_equation(axes):
    """ratio^(axes + 1) = ratio + 1; axis k steps by ratio^-k, from the middle on."""
    (ratio,) = (x.real for x in np.roots([1.0, *[0.0] * (axes - 1), -1.0, -1.0]) if x.real > 1.0)
    found = spreads.lattice(7, axes)
    assert found.shape == (7, axes)
    for k in range(axes):
        steps = np.arange(7) * ratio ** -(k + 1.0)
        np.testing.assert_allclose(found[:, k], np.mod(0.5 + steps, 1.0), atol=1e-12)


def test_thinned_places_are_each_the_farthest_from_all_before():
    points = np.random.default_rng(6).normal(size=(30, 3))
    fair = np.arange(30) % 4 != 0
    kept, left = [1], np.linalg.norm(points - points[1], axis=1)
    for _ in range(7):
        kept.append(int(np.argmax(np.where(fair, left, -1.0))))
        left = np.minimum(left, np.linalg.norm(points - points[kept[-1]], axis=1))
    cloud = Vec3(*jnp.asarray(points.T))
    assert spreads.thinned(cloud, jnp.asarray(fair), 8).tolist() == kept
    two = spreads.thinned(cloud, jnp.asarray(np.isin(np.arange(30), [5, 9])), 8).tolist()
    assert two[:2] == [5, 9] and set(two) == {5, 9}


def test_a_net_of_a_slanted_plane_lies_on_it_and_faces_where_the_field_is_positive():
    x, y, z = np.indices((4, 5, 6)) * 1.0
    for sign in (1.0, -1.0):
        vertices, triangles = nets.net(sign * (x + 0.5 * y - 0.25 * z - 1.3))
        np.testing.assert_allclose(vertices @ [1.0, 0.5, -0.25], 1.3, atol=1e-13)
        sides = vertices[triangles[:, 1:]] - vertices[triangles[:, :1]]
        facing = np.cross(sides[:, 0], sides[:, 1]) @ [1.0, 0.5, -0.25]
        assert np.all(sign * facing > 0)
        # A vertex for each cell that the plane goes through, whose corners differ in sign.
        inside = sign * (x + 0.5 * y - 0.25 * z - 1.3) < 0
        corners = [inside[i : i + 3, j : j + 4, k : k + 5] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        mixed = np.any(corners, axis=0) & ~np.all(corners, axis=0)
        assert len(vertices) == mixed.sum()
        # Two triangles for each edge that it crosses within the grid.
        inner = tuple(slice(1, -1) for _ in range(3))
        whole = (slice(None),) * 3
        crossed = 0
        for axis in range(3):
            along = tuple(whole[k] if k == axis else inner[k] for k in range(3))
            crossed += np.sum(np.diff(inside[along].astype(int), axis=axis) != 0)
        assert len(triangles) == 2 * crossed > 10
        assert {tuple(cell) for cell in np.floor(vertices).astype(int)} == set(map(tuple, np.argwhere(mixed)))


def test_a_vertex_is_the_mean_of_where_the_field_vanishes_along_the_edges_of_its_cell():
    values = np.ones((2, 2, 2))
    values[0, 0, 0], values[1, 0, 0], values[0, 1, 0], values[0, 0, 1] = -1.0, 3.0, 1.0, 0.0
    vertices, triangles = nets.net(values)
    np.testing.assert_allclose(vertices, [[0.25 / 3, 0.5 / 3, 1.0 / 3]])
    assert triangles.shape == (0, 3)


def test_quadrangles_are_cut_along_the_shorter_diagonal():
    corners = np.array([[5.0, 7, 9], [6, 7, 9], [8, 9, 9], [5, 8, 9]])
    assert nets._halved(corners, np.array([[0, 1, 2, 3]])).tolist() == [[1, 2, 3], [1, 3, 0]]
    corners[2] = [5.5, 7.5, 9.0]
    assert nets._halved(corners, np.array([[0, 1, 2, 3]])).tolist() == [[0, 1, 2], [0, 2, 3]]


def uneven(shape=(7, 8, 6)):
    return np.random.default_rng(8).normal(size=shape)


def scipys(coefficients, at, orders):
    """A field of uniform quintic B-splines by SciPy's functions, in cells."""
    found = coefficients
    for count, x, order in zip(coefficients.shape, at, orders, strict=True):
        line = BSpline(np.arange(-5.0, count + 1.0), np.eye(count), 5)
        found = np.tensordot(line.derivative(order)(x) if order else line(x), found, axes=(0, 0))
    return found


def test_values_of_a_field_of_splines_at_its_nodes_and_between():
    given = uneven()
    field = SplineSurface(given, (0.1, 0.2, 0.3), 0.5)
    found = spline_nets.surface_values(field, 3)
    assert found.shape == (7, 10, 4)
    for i, j, k in ((0, 0, 0), (6, 9, 3), (1, 5, 2), (4, 3, 1)):
        wanted = scipys(given, (i / 3.0, j / 3.0, k / 3.0), (0, 0, 0))
        assert found[i, j, k] == pytest.approx(wanted, abs=1e-13)
    # The field x is zero to rounding at nodes in a plane: there it is zero.
    slope = np.broadcast_to((np.arange(8) - 3.0)[:, None, None], (8, 6, 6)) * 0.1
    assert not spline_nets.surface_values(SplineSurface(slope, (0, 0, 0), 1.0), 2)[2].any()


def test_places_are_looked_for_from_the_grid():
    """The field (p^2 - 1)(16 - p^2) of a ball of radius 1 is negative again farther out than 4."""
    at = np.linspace(-1.5, 1.5, 8)
    p2 = at[:, None, None] ** 2 + at[:, None] ** 2 + at**2
    functions = BSpline(np.arange(-5.0, 9.0), np.eye(8), 5)(at + 1.5)
    given = (p2 - 1.0) * (16.0 - p2)
    for axis in range(3):
        given = np.moveaxis(np.tensordot(np.linalg.inv(functions), given, axes=(1, axis)), 0, axis)
    ball = SplineSurface(given, (-1.5, -1.5, -1.5), 1.0)
    far = np.array([[0.5, 6.0, 1.0], [-7.0, 5.0, -9.0], [0.0, 0.3, 30.0]])
    wanted = far / np.linalg.norm(far, axis=1, keepdims=True)
    np.testing.assert_allclose(ball.near(far), wanted, rtol=0, atol=1e-12)


def test_a_field_with_room_is_the_same_and_goes_on_beyond_its_grid():
    """Its coefficients are kept to the last bit; those added continue the last polynomial of each axis."""
    given = uneven((7, 32, 33))
    roomy = surfaces.with_room(SplineSurface(given, (0.1, 0.2, 0.3), 0.5))
    assert roomy.coefficients.shape == (32, 32, 64)
    np.testing.assert_array_equal(roomy.coefficients[:7, :, :33], given)
    np.testing.assert_array_equal((*roomy.origin, roomy.step), (0.1, 0.2, 0.3, 0.5))
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(roomy))
    for at in ((1.3, 20.1, 27.2), (2.1, 26.9, 28.4), (6.4, 3.0, 5.0), (5.2, 14.6, 33.7)):
        wanted = scipys(given, at, (0, 0, 0))
        assert scipys(np.asarray(roomy.coefficients), at, (0, 0, 0)) == pytest.approx(wanted, rel=1e-9)


def test_derivatives_of_a_field_of_splines_are_scipys_per_metre():
    given, origin, step = uneven(), np.array([0.1, 0.2, 0.3]), 0.5
    field = SplineSurface(given, tuple(origin), step)
    at = np.array([0.7, 2.3, 0.4])
    level = jax.jit(lambda *p: field.derivatives(Vec3(*p)))(*(origin + step * at))
    each = lambda *orders: scipys(given, at, orders) / step ** sum(orders)  # noqa: E731
    assert float(level.value) == pytest.approx(each(0, 0, 0))
    np.testing.assert_allclose(level.gradient.array(), [each(1, 0, 0), each(0, 1, 0), each(0, 0, 1)])
    mixed = [each(1, 1, 0), each(1, 0, 1), each(0, 1, 1)]
    wanted = [
        [each(2, 0, 0), mixed[0], mixed[1]],
        [mixed[0], each(0, 2, 0), mixed[2]],
        [mixed[1], mixed[2], each(0, 0, 2)],
    ]
    np.testing.assert_allclose(level.hessian.array(), wanted)
    assert field.smoothness == 4.0


@pytest.mark.parametrize("closed", [False, True])
def test_functions_of_an_axis_are_those_of_scipys_interpolation(closed):
    """Through data at the integers, not-a-knot or periodic; beyond open ends the last polynomials go on."""
    data = np.random.default_rng(9).normal(size=9)
    whole = np.append(data, data[0]) if closed else data
    line = make_interp_spline(np.arange(len(whole)), whole, k=5, bc_type="periodic" if closed else None)
    functions, solve = splines.axis(9, closed=closed)
    coefficients = solve @ data
    if closed:
        coefficients = np.append(coefficients, coefficients[:5])
    local = jax.jit(lambda u: functions.local(u, closed=closed))
    for u in (0.0, 1.7, 2.99, 4.5, 6.2, 7.4, *((8.6, -0.3, 21.1) if closed else (8.0, -0.2, 8.3))):
        first, weights = local(u)
        found = weights @ coefficients[int(first) : int(first) + 6]
        at = np.mod(u, 9.0) if closed else u
        wanted = [line(at), line.derivative(1)(at), line.derivative(2)(at)]
        np.testing.assert_allclose(found, wanted, atol=1e-9)


@functools.cache
def stepped(careful):
    return jax.jit(lambda form, away: gauss.approach(plane_frame(form), FOOT + Vec3(*away), careful=careful))


FOOT = Vec3(0.1, 0.2, 0.3)


def plane_frame(form):
    return gauss.Gauss3(
        Vec3(0.1, 0.2, 0.3), Vec3(0.0, 0.0, 1.0), Sym3(form[0], form[1], 0.0, form[2], 0.0, 0.0)
    )


@pytest.mark.parametrize(
    ("form", "away", "careful", "kind"),
    [
        ((30.0, 7.0, 12.0), (1e-3, -2e-3, 0.01), False, "newton"),
        ((30.0, 7.0, 12.0), (1e-3, -2e-3, 0.01), True, "newton"),
        ((30.0, 7.0, 12.0), (1e-3, -2e-3, -0.5), False, "newton"),
        ((30.0, 7.0, 12.0), (1e-3, -2e-3, -0.5), True, "damped"),
        ((30.0, 7.0, 12.0), (0.02, -0.05, 0.01), True, "cut"),
        ((-30.0, 0.0, 12.0), (1e-3, -2e-3, 0.05), True, "damped"),
        ((-40.0, 0.0, -38.0), (1e-4, -2e-4, 0.024), True, "damped"),
        ((-34.0, 0.0, -34.0), (1e-4, -2e-4, 0.025), True, "newton"),
        ((-35.6, 0.0, -35.6), (1e-4, -2e-4, 0.025), True, "newton"),
        ((-30.0, 8.0, -30.0), (1e-5, -2e-5, 0.025), True, "newton"),
        ((0.0, 0.0, 0.0), (0.3, -0.4, 0.2), True, "newton"),
    ],
)
def test_steps_to_a_foot_are_newtons_in_the_tangent_plane(form, away, careful, kind):
    """Beyond a centre of curvature a gradient's, shortened; never longer than half the least radius."""
    found = np.asarray(stepped(careful)(form, away).array())
    matrix = np.array([[form[0], form[1]], [form[1], form[2]]])
    size = np.linalg.norm(matrix)
    wanted = np.linalg.solve(np.eye(2) + away[2] * matrix, away[:2])
    if kind == "damped":
        wanted = np.array(away[:2]) / (1.0 + abs(away[2]) * size)
    if size * np.linalg.norm(wanted) > 0.5 and careful:
        wanted = wanted * 0.5 / (size * np.linalg.norm(wanted))
        assert kind == "cut"
    np.testing.assert_allclose(found, [*wanted, 0.0], rtol=1e-9)


def test_steps_to_a_foot_are_careful_where_nothing_else_is_said():
    assert inspect.signature(gauss.approach).parameters["careful"].default is True


@pytest.mark.parametrize("p", [2.0, 2.5, 3.0, 4.0, 7.0])
def test_powers_have_their_derivatives_also_at_zero_and_below(p):
    x = np.array([-1.3, -0.2, 0.0, 0.4, 2.0])
    value, slope, bend = forms._power(jnp.asarray(x), p)
    np.testing.assert_allclose(value, np.abs(x) ** p, rtol=1e-12)
    np.testing.assert_allclose(slope, np.sign(x) * np.abs(x) ** (p - 1.0), rtol=1e-12)
    np.testing.assert_allclose(bend, (p - 1.0) * np.abs(x) ** (p - 2.0), rtol=1e-12)


def test_smoothness_and_exponents_of_superellipsoids():
    made = lambda p: Superellipsoid(0.03, 0.02, 0.01, exponent=p).smoothness  # noqa: E731
    assert [made(p) for p in (2, 2.5, 3, np.float64(4.0), 5, 32.0)] == [np.inf, 2.0, 2.0, np.inf, 4.0, np.inf]
    assert Superellipsoid(0.03, 0.02, 0.01).exponent == 4.0
    for p in (1.99, 32.1, True, "4"):
        with pytest.raises(ValueError, match="argument exponent must be at least 2 and at most 32"):
            made(p)
    with pytest.raises(ValueError, match="argument major must be larger than minor"):
        Torus(0.01, 0.01)
    for shape in (Plane(), Sphere(0.1), Torus(0.02, 0.01), jxr.geometry.Cylinder(0.1)):
        assert shape.smoothness == np.inf and shape.coordinates == 3
    assert float(Plane().derivatives(Vec3(0.1, 0.2, 0.3)).value) == 0.3


def test_parameters_are_brought_into_their_domain():
    for x, wanted in ((0.2, 0.5), (1.1, 1.1), (9.0, 2.5)):
        assert float(charts.bounded(jnp.asarray(x), (0.5, 2.5), False)) == wanted
    for x, wanted in ((0.2, 2.2), (1.1, 1.1), (2.5, 0.5), (9.0, 1.0), (-5.0, 1.0)):
        assert float(charts.bounded(jnp.asarray(x), (0.5, 2.5), True)) == pytest.approx(wanted)
    assert charts.as_flags([True, np.bool_(False)]) == (True, False)
    for bad in (True, (True,), (True, False, True), (1, 0), "TF"):
        with pytest.raises(ValueError, match="argument periodic must be two of True and False"):
            charts.as_flags(bad)


def test_searches_begin_at_the_nearest_of_places_all_over():
    """On 16 by 16 middles of a rectangle; on 64 of a line, of a contour with ends."""
    flat = Chart(lambda u, v: (u, 2.0 * v, 0.0 * u), domain=((0.0, 3.2), (-1.0, 2.2)))
    found = jax.jit(lambda *p: flat.start(Vec3(*p)))(0.72, 3.35, 5.0)
    np.testing.assert_allclose(found, [0.7, 1.7], atol=1e-12)
    bar = Extruded(jxr.Line((-1.0, 5.4)))
    found = jax.jit(lambda *p: bar.start(Vec3(*p)))(7.0, 1.26, -3.0)
    np.testing.assert_allclose(found, [1.25, -3.0], atol=1e-12)
    assert flat.coordinates == bar.coordinates == 2


def test_a_chart_has_rates_of_its_slanted_parameters():
    slanted = Chart(lambda u, v: (u + 2.0 * v, 3.0 * v, 0.5 * u), domain=((0.0, 1.0), (0.0, 1.0)))
    u, v = np.array([1.0, 0.0, 0.5]), np.array([2.0, 3.0, 0.0])
    found = jax.jit(lambda way: slanted.rate((0.3, 0.4), Vec3(*way)))(tuple(0.7 * u - 1.1 * v))
    np.testing.assert_allclose(np.stack(found), [0.7, -1.1])


def test_a_placed_and_a_hollow_surface_pass_on_what_they_are_made_of():
    turn = np.array([0.5, -0.1, 0.7, 0.3])
    egg, offset = jxr.Ellipsoid(0.03, 0.02, 0.01), (0.1, 0.2, 0.3)
    placed = egg.moved(offset, turn)
    assert (placed.coordinates, placed.smoothness) == (3, np.inf)
    pose, way = placed.placed(), Vec3(0.3, -0.2, 0.5)
    at = (0.03, 0.0, 0.0)
    np.testing.assert_allclose(np.stack(placed.rate(at, pose.turn(way))), [0.3, -0.2, 0.5])
    for one, other in zip(placed.basis(at), egg.basis(at), strict=True):
        np.testing.assert_allclose(one.array(), pose.turn(other).array())
    only = egg.moved(offset)
    np.testing.assert_allclose(np.stack(only.rate(at, way)), [0.3, -0.2, 0.5])
    hollow = Hollow(egg)
    first, second = hollow.basis(at)
    np.testing.assert_allclose(first.cross(second).array(), hollow.frame(at).normal.array(), atol=1e-15)
    np.testing.assert_allclose(hollow.frame(at).normal.array(), [-1.0, 0.0, 0.0])
    assert hollow.rate(at, way) == egg.rate(at, way)
    for bad in (lambda: Hollow(3.0), lambda: jxr.geometry.MovedSurface(jxr.Circle(0.01))):
        with pytest.raises(ValueError, match="argument surface must be a surface, but was"):
            bad()


def test_patches_and_fields_have_six_points_along_every_axis():
    rng = np.random.default_rng(0)
    assert Patch(rng.normal(size=(6, 7, 3))).smoothness == 4.0
    domain = Patch(rng.normal(size=(6, 9, 3)), periodic=(True, False)).domain()
    assert domain == ((0.0, 6.0), (0.0, 8.0))
    for shape in ((5, 9, 3), (9, 5, 3)):
        with pytest.raises(ValueError, match="argument points must have at least 6 along both axes"):
            Patch(rng.normal(size=shape))
    for shape in ((5, 9, 9), (9, 5, 9), (9, 9, 5)):
        with pytest.raises(ValueError, match="argument coefficients must have at least 6 along every axis"):
            SplineSurface(np.zeros(shape), (0, 0, 0), 1.0)


def test_a_search_has_arrived_where_the_normal_goes_through_its_target_to_a_millionth():
    from jaxroll.geometry.surfaces._surface import _arrived

    class Loose(Sphere):
        """A ball of 1 m whose places are not put back."""

        def settled(self, at):
            return (at[0] + 0.0, at[1] + jnp.asarray(0.0), at[2])

    ball = Loose(1.0)
    arrived = lambda aside, height: bool(  # noqa: E731
        _arrived(ball, Vec3(aside, 0.0, 1.0 + height), (jnp.zeros(()), jnp.zeros(()), jnp.ones(())))
    )
    # The size is that of the place and of the arm, 5 / 4 m.
    assert arrived(1.2e-6, 0.75) and not arrived(1.3e-6, 0.75)

    class Drifting(Sphere):
        """One whose places are put back by so much."""

        def settled(self, at):
            return (at[0], at[1], at[2] + self.radius)

    def frame_of(by):
        found = Drifting(by)
        return bool(_arrived(found, Vec3(0.0, 0.0, 1.75), (jnp.zeros(()), jnp.zeros(()), jnp.ones(()))))

    assert frame_of(1.2e-6) and not frame_of(1.3e-6)
