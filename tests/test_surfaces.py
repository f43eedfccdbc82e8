"""Every surface: closed forms against autodiff, curvature against textbooks, coordinates, placement."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._linalg import _space as sp
from jaxroll.geometry import (
    Chart,
    Cylinder,
    Ellipsoid,
    Extruded,
    Implicit,
    Patch,
    Plane,
    Sphere,
    SplineSurface,
    Superellipsoid,
    Torus,
)
from jaxroll.geometry.contours._bspline import basis
from jaxroll.geometry.surfaces._tensor_bspline import UNIFORM
from tests.helpers import slow_among
from tests.measures import both_slopes, observed_order, taylor_remainders

A, B, C = 0.03, 0.02, 0.012
MAJOR, MINOR = 0.03, 0.011
TURN = np.array([0.5, -0.1, 0.7, 0.3])
RNG = np.random.default_rng(5)


def ring(u, v):
    out = MAJOR + MINOR * jnp.cos(v)
    return out * jnp.cos(u), out * jnp.sin(u), MINOR * jnp.sin(v)


def ring_field(x, y, z):
    """Quartic, unlike the distance that `Torus` uses."""
    return ((x**2 + y**2 + z**2 + MAJOR**2 - MINOR**2) ** 2 - 4 * MAJOR**2 * (x**2 + y**2)) / (
        8 * MAJOR**2 * MINOR
    )


def sphere_piece(n, radius=0.02):
    """Points of a sphere, away from the poles, whose chart is not orthogonal."""
    u, v = np.meshgrid(np.linspace(-0.6, 0.6, n), np.linspace(-0.5, 0.5, n), indexing="ij")
    turn, rise = u + 0.3 * v + 0.1 * v**2, v - 0.2 * u
    flat = np.stack([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)], -1)
    return radius * flat


def wavy_field(n=12):
    """Coefficients of the distance from a sphere, sampled at the functions' centres: a lumpy ball."""
    x = 0.005 * (np.arange(n) - 2.0) - 0.0175
    grid = np.stack(np.meshgrid(x, x, x, indexing="ij"), -1)
    return SplineSurface(np.linalg.norm(grid, axis=-1) - 0.013, (-0.0175,) * 3, 0.005)


RING_CHART = Chart(ring, domain=((0, 2 * np.pi), (0, 2 * np.pi)))
WAVE = 2 * np.pi * np.arange(24) / 24
BAR = (0.02 + 0.002 * np.cos(3 * WAVE))[:, None] * np.stack([np.cos(WAVE), 0.7 * np.sin(WAVE)], -1)
SURFACES = {
    "plane": Plane(),
    "sphere": Sphere(B),
    "cylinder": Cylinder(C),
    "torus": Torus(MAJOR, MINOR),
    "ellipsoid": Ellipsoid(A, B, C),
    "superellipsoid": Superellipsoid(A, B, C, exponent=4),
    "fractional": Superellipsoid(A, B, C, exponent=3.5),
    "implicit": Implicit(ring_field),
    "field": wavy_field(),
    "chart": RING_CHART,
    "patch": Patch(sphere_piece(12)),
    "extruded": Extruded(jxr.Ellipse(A, B)),
    "bar": Extruded(jxr.Spline(BAR)).moved((0.01, -0.02, 0.03), TURN),
    "moved": Ellipsoid(A, B, C).moved((0.01, -0.02, 0.03), TURN),
    "moved chart": RING_CHART.moved((0.01, -0.02, 0.03), TURN),
}
IMPLICIT = [name for name in SURFACES if SURFACES[name].coordinates == 3 and name != "moved"]
# From a guess the search is that from a start of its own, after which it is the same for all of a kind.
GUESSED = [SURFACES[name] for name in ("torus", "chart", "moved")]
CLOUD = RNG.normal(size=(40, 3)) * np.array([0.02, 0.015, 0.008]) + np.array([0.02, 0.0, 0.003])


@functools.cache
def places(name):
    """Coordinates of forty places of a surface."""
    surface = SURFACES[name]
    if surface.coordinates == 3:
        # The field is known within its grid alone.
        cloud = 0.013 * CLOUD / np.linalg.norm(CLOUD, axis=-1)[:, None] if name == "field" else CLOUD
        return np.asarray(surface.near(cloud))
    return RNG.uniform(0.5, 6.0, size=(40, 2))


@pytest.fixture(scope="module", params=SURFACES)
def case(request):
    return SURFACES[request.param], places(request.param)


@jax.jit
def levels(surface, at):
    """The derivatives a surface gives; and value, gradient and second derivatives by JAX's own."""

    def one(row):
        field = lambda p: surface.derivatives(sp.Vec3(*p)).value  # noqa: E731
        return surface.derivatives(sp.Vec3(*row)), (field(row), jax.grad(field)(row), jax.hessian(field)(row))

    return jax.vmap(one)(at)


STAY = np.float64(0.0)  # of the type that steps have, for which there is a program


@jax.jit
def walked(surface, at, velocity, h):
    """Coordinates a step of `h` along a tangent velocity, settled; and how fast the point moves with them."""
    surface = surface.prepared()

    def one(row, v):
        rate = surface.rate(tuple(row), sp.Vec3(*v))
        moved = tuple(x + h * r for x, r in zip(row, rate, strict=True))
        _, pace = jax.jvp(lambda at: surface.frame(at).point.array(), (tuple(row),), (rate,))
        return jnp.stack(surface.settled(moved)), pace

    return jax.vmap(one)(at, velocity)


@pytest.mark.parametrize("name", IMPLICIT)
def test_frame_is_that_of_the_level_set(name):
    """Closed forms against autodiff; L from projected second derivatives, by matrices of NumPy."""
    surface, at = SURFACES[name], places(name)
    given, auto = levels(surface, at)
    value, gradient, hessian = (np.asarray(x) for x in auto)
    scale = np.abs(hessian).max() + 1e-3
    np.testing.assert_allclose(given.value, value, atol=1e-16)
    np.testing.assert_allclose(
        np.stack(np.broadcast_arrays(*given.gradient), -1), gradient, rtol=1e-11, atol=1e-13
    )
    mine = np.broadcast_arrays(*given.hessian)
    theirs = [hessian[:, i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]
    np.testing.assert_allclose(np.stack(mine) / scale, np.stack(theirs) / scale, atol=1e-12)
    size = np.linalg.norm(gradient, axis=-1)
    n = gradient / size[:, None]
    np.testing.assert_allclose(surface.normal(at), n, atol=1e-12)
    flat = np.eye(3)[None] - n[:, :, None] * n[:, None, :]
    expected = flat @ hessian @ flat / size[:, None, None]
    np.testing.assert_allclose(
        surface.shape_operator(at), expected, atol=1e-11 * np.abs(expected).max() + 1e-13
    )


def test_shape_operator_is_symmetric_and_tangent(case):
    surface, at = case
    n, shape = np.asarray(surface.normal(at)), np.asarray(surface.shape_operator(at))
    size = 1.0 + np.abs(shape).max()
    np.testing.assert_allclose(np.linalg.norm(n, axis=-1), 1.0, atol=1e-14)
    np.testing.assert_array_equal(shape, np.swapaxes(shape, -1, -2))
    np.testing.assert_allclose(np.einsum("...ij,...j", shape, n) / size, 0.0, atol=1e-13)


def test_principal_curvatures_are_the_eigenvalues(case):
    surface, at = case
    shape = np.asarray(surface.shape_operator(at))
    values, directions = (np.asarray(x) for x in surface.principal_curvatures(at))
    size = 1.0 + np.abs(shape).max()
    assert np.all(np.diff(values) >= 0)
    eigen = np.linalg.eigvalsh(shape)
    pick = np.argmin(np.abs(eigen), axis=-1)  # that of the normal is zero
    rest = np.array([np.delete(e, i) for e, i in zip(eigen, pick, strict=True)])
    np.testing.assert_allclose(values / size, rest / size, atol=1e-12)
    turned = np.einsum("...ij,...kj->...ki", shape, directions)
    np.testing.assert_allclose(turned / size, values[..., None] * directions / size, atol=1e-12)
    gram = np.einsum("...ij,...kj->...ik", directions, directions)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(2), gram.shape), atol=1e-13)


def test_eulers_formula_and_the_forms(case):
    surface, at = case
    values, directions = (np.asarray(x) for x in surface.principal_curvatures(at))
    low, high = values.T
    angle = np.linspace(0, np.pi, len(at))
    along = np.cos(angle)[:, None] * directions[:, 0] + np.sin(angle)[:, None] * directions[:, 1]
    expected = low * np.cos(angle) ** 2 + high * np.sin(angle) ** 2
    size = 1.0 + np.abs(high).max()
    slanted = 3.0 * along + 0.7 * np.asarray(surface.normal(at))
    np.testing.assert_allclose(surface.normal_curvature(at, slanted) / size, expected / size, atol=1e-12)
    first, second = (np.asarray(x) for x in surface.forms(at))
    roots = np.sort(np.linalg.eigvals(np.linalg.solve(first, second)).real, axis=-1)
    # The chart's form is not symmetric: near an umbilic its roots keep half the digits.
    np.testing.assert_allclose(roots / size, np.stack([low, high], -1) / size, atol=1e-7)
    np.testing.assert_allclose(
        np.linalg.det(second) / np.linalg.det(first) / size**2, low * high / size**2, atol=1e-12
    )


def test_normal_turns_by_the_shape_operator(case):
    """dn = L ds along a step over the surface: central differences, of order 2."""
    surface, at = case
    frame, n = np.asarray(surface.tangents(at)), surface.normal
    velocity = 0.6 * frame[:, 0] - 0.8 * frame[:, 1]
    expected = np.einsum("...ij,...j", np.asarray(surface.shape_operator(at)), velocity)
    size = 1.0 + np.abs(np.asarray(surface.shape_operator(at))).max()
    errors = []
    steps = np.array([4e-4, 2e-4, 1e-4]) * min(1.0, 50.0 / size)
    for h in steps:
        ahead, behind = (walked(surface, at, velocity, s)[0] for s in (h, -h))
        errors.append(np.abs((n(ahead) - n(behind)) / (2 * h) - expected).max() / size)
    if max(errors) > 1e-10:  # else it is exact: plane, sphere, cylinder
        assert abs(observed_order(steps, errors) - 2.0) < 0.2
        assert errors[-1] < 1e-2


def test_coordinates_follow_the_velocity_and_settle(case):
    """Rates move the point at the velocity; an error of 1e-7 m off the surface settles to rounding."""
    surface, at = case
    frame = np.asarray(surface.tangents(at))
    velocity = 0.3 * frame[:, 0] + 0.4 * frame[:, 1]
    np.testing.assert_allclose(walked(surface, at, velocity, STAY)[1], velocity, atol=1e-13)
    if surface.coordinates == 3:
        off = at + 1e-7 * np.asarray(RNG.normal(size=at.shape))
        settled = walked(surface, off, np.zeros_like(at), STAY)[0]
        inner = getattr(surface, "surface", surface)
        level = levels(inner, settled)[0]
        slope = np.linalg.norm(np.broadcast_arrays(*level.gradient), axis=0)
        assert np.abs(level.value / slope).max() < 1e-16 + 2e-15 * np.abs(settled).max()
        assert np.linalg.norm(settled - off, axis=-1).max() < 1e-6


def test_near_finds_the_closest_point(case):
    """The way to it is along the normal, and no other place of many is closer."""
    surface, at = case
    n = np.asarray(surface.normal(at))
    height = 0.2 / (1.0 + np.abs(np.asarray(surface.shape_operator(at))).max())
    if surface is SURFACES["patch"]:
        at = np.clip(at, 1.0, 10.0)
        n = np.asarray(surface.normal(at))
    for sign in (1.0, -1.0):
        target = np.asarray(surface.point(at)) + sign * height * n
        if any(surface is each for each in GUESSED):
            found = surface.point(surface.near(target, at + 1e-4))
            np.testing.assert_allclose(found, surface.point(at), atol=1e-12)
        np.testing.assert_allclose(surface.point(surface.near(target)), surface.point(at), atol=1e-12)


def test_sphere_everywhere():
    poles = B * np.concatenate([np.eye(3), -np.eye(3), [[0.6, 0.0, -0.8], [0.0, 0.48, -0.64]]])
    values, directions = Sphere(B).principal_curvatures(poles)
    np.testing.assert_allclose(values[:6], 1 / B, rtol=1e-14)
    assert np.all(np.isfinite(directions))
    np.testing.assert_allclose(Sphere(B).normal(poles[:6]), poles[:6] / B, atol=1e-15)


def ellipsoid_places():
    """As many as those of `places`, as elsewhere: programs of 40 places are there."""
    u = RNG.normal(size=(34, 3))
    u = np.concatenate([u / np.linalg.norm(u, axis=-1)[:, None], np.eye(3), -np.eye(3)])
    return u * np.array([A, B, C])


@pytest.mark.parametrize("name", ["ellipsoid", "superellipsoid", "implicit", "spline"])
def test_ellipsoid_curvatures(name):
    """Gaussian and mean curvature of the textbooks, poles included; four ways to have the same surface."""
    p, axes = ellipsoid_places(), np.array([A, B, C])
    form = lambda x, y, z: (x / A) ** 2 + (y / B) ** 2 + (z / C) ** 2 - 1.0  # noqa: E731
    surface = {
        "ellipsoid": Ellipsoid(A, B, C),
        "superellipsoid": Superellipsoid(A, B, C, exponent=2),
        "implicit": Implicit(form),
        "spline": quadric(axes),
    }[name]
    weight = np.sum((p / axes**2) ** 2, axis=-1)
    gauss = 1.0 / ((A * B * C) ** 2 * weight**2)
    mean = (np.sum(axes**2) - np.sum(p**2, -1)) / (2 * (A * B * C) ** 2 * weight**1.5)
    low, high = np.asarray(surface.principal_curvatures(p)[0]).T
    np.testing.assert_allclose(low * high, gauss, rtol=1e-11)
    np.testing.assert_allclose(0.5 * (low + high), mean, rtol=1e-11)


def quadric(axes, step=0.007):
    """The field of B-splines that is a quadratic form exactly: x^2 has coefficients j^2 - 1/2."""
    counts = 2 * np.ceil(axes / step).astype(int) + 5
    parts = []
    for axis, count in zip(axes, counts, strict=True):
        centre = np.arange(count) - 0.5 * (count - 1)
        parts.append((centre**2 - 0.5) * step**2 / axis**2)
    x, y, z = np.meshgrid(*parts, indexing="ij")
    return SplineSurface(x + y + z - 1.0, -0.5 * (counts - 5) * step, step)


def test_torus_three_ways():
    """Closed form, quartic field and chart agree with the textbook: 1/r and cos v / (R + r cos v)."""
    at = np.concatenate([RNG.uniform(0, 2 * np.pi, size=(37, 2)), [[0, 0], [0, np.pi], [1, np.pi / 2]]])
    points = np.asarray(RING_CHART.point(at))
    cos = np.cos(at[:, 1])
    expected = np.stack([cos / (MAJOR + MINOR * cos), np.full(len(at), 1 / MINOR)], -1)
    for surface, where in (
        (RING_CHART, at),
        (Torus(MAJOR, MINOR), points),
        (Implicit(ring_field), points),
    ):
        np.testing.assert_allclose(surface.principal_curvatures(where)[0], expected, atol=1e-9)
        np.testing.assert_allclose(surface.normal(where), RING_CHART.normal(at), atol=1e-13)
        operator = RING_CHART.shape_operator(at)
        np.testing.assert_allclose(surface.shape_operator(where), operator, atol=1e-10)


@pytest.mark.parametrize(("name", "total"), [("torus", 0.0), ("ellipsoid", 4 * np.pi)])
def test_gauss_bonnet(name, total):
    """The integral of the product of the curvatures is 2 pi times the Euler characteristic."""
    u = 2 * np.pi * np.arange(48) / 48
    if name == "torus":
        v, weight = u, np.full(48, 2 * np.pi / 48)
        chart = ring
    else:
        v, weight = np.polynomial.legendre.leggauss(48)
        v, weight = 0.5 * np.pi * v, 0.5 * np.pi * weight
        chart = lambda u, v: (  # noqa: E731
            A * jnp.cos(u) * jnp.cos(v), B * jnp.sin(u) * jnp.cos(v), C * jnp.sin(v)
        )  # fmt: skip
    at = np.stack(np.meshgrid(u, v, indexing="ij"), -1)
    surface = Chart(chart, domain=((0, 1), (0, 1)))
    first = np.asarray(surface.forms(at)[0])
    area = np.sqrt(np.linalg.det(first))
    low, high = np.moveaxis(np.asarray(SURFACES[name].principal_curvatures(surface.point(at))[0]), -1, 0)
    integral = np.sum(low * high * area * weight[None, :]) * 2 * np.pi / 48
    np.testing.assert_allclose(integral, total, atol=1e-5)


def test_patch_orders_on_a_sphere():
    """Point h^6, normal h^5 or better, curvature h^4, in a chart with slanted axes; and at the edge."""
    share = np.concatenate([RNG.uniform(0, 1, size=(38, 2)), [[0, 0], [1, 0.5]]])
    sizes, errors = np.array([12, 17, 24]), []
    for n in sizes:
        patch, at = Patch(sphere_piece(int(n))), share * (n - 1)
        point, normal = np.asarray(patch.point(at)), np.asarray(patch.normal(at))
        errors.append(
            [
                np.abs(np.linalg.norm(point, axis=-1) / 0.02 - 1.0).max(),
                np.abs(normal - point / np.linalg.norm(point, axis=-1)[:, None]).max(),
                np.abs(np.asarray(patch.principal_curvatures(at)[0]) * 0.02 - 1.0).max(),
            ]
        )
    orders = [-observed_order(sizes - 1, e) for e in np.array(errors).T]
    assert np.all(np.abs(np.array(orders) - np.array([6.0, 5.0, 4.0])) < 0.7), orders
    assert np.all(np.array(errors)[-1] < [1e-7, 1e-6, 1e-4])


def test_patch_goes_through_its_points_and_round():
    u = 2 * np.pi * np.arange(20) / 20
    grid = np.stack(np.meshgrid(u, u, indexing="ij"), -1)
    points = np.stack(ring(grid[..., 0], grid[..., 1]), -1)
    patch = Patch(points, periodic=(True, True))
    i, j = np.array([0, 3, 19, 5]), np.array([0, 19, 7, 5])
    at = np.stack([i, j], -1).astype(float)
    np.testing.assert_allclose(patch.point(at), points[i, j], atol=1e-16)
    np.testing.assert_allclose(patch.point(at + np.array([20.0, -40.0])), points[i, j], atol=1e-16)
    normal = np.stack([np.cos(u[i]) * np.cos(u[j]), np.sin(u[i]) * np.cos(u[j]), np.sin(u[j])], -1)
    np.testing.assert_allclose(patch.normal(at), normal, atol=1e-5)


def test_uniform_functions_are_the_basis_functions():
    found = jax.jit(lambda at: basis(at, 5, closed=True).polynomials)(jnp.arange(13.0))
    np.testing.assert_allclose(found, np.broadcast_to(UNIFORM / 120.0, found.shape), atol=1e-15)


CURVED = {
    "ellipsoid": (lambda x: Ellipsoid(A * x, B, C / x), (0.015, 0.01, 0.0084)),
    "torus": (lambda x: Torus(MAJOR * x, MINOR / x), (0.02, 0.03, 0.006)),
    "patch": (lambda x: Patch(sphere_piece(12) * jnp.stack([x, x**2, 1 / x])[None, None, :]), (3.3, 2.7)),
    "field": (
        lambda x: SplineSurface(wavy_field().coefficients + (x - 1) * 0.01, (-0.0175,) * 3, 0.005 * x),
        (0.008, 0.006, 0.0084),
    ),
    "moved": (
        lambda x: Ellipsoid(A, B, C).moved((x, 0, 0), jnp.stack([x, 0.2 * x**2, 0.0 * x, 0.1 / x])),
        (0.015, 0.01, 0.0084),
    ),
}


@pytest.mark.parametrize("name", slow_among(CURVED, "field", "patch"))
def test_curvature_is_differentiable_in_the_shape(name):
    """Taylor's remainder falls with the square of the step; forward and reverse agree."""
    make, at = CURVED[name]

    def measure(x):
        values, directions = make(x).principal_curvatures(at)
        return values[0] / 40.0 + values[1] / 80.0 + directions[0, 1]

    both, x = both_slopes(measure), jnp.asarray(1.1)
    _, forward, slope = map(float, both(x))
    np.testing.assert_allclose(forward, slope, rtol=1e-10)
    steps = np.array([1e-2, 1e-3, 1e-4])
    remainder = taylor_remainders(lambda y: float(both(y)[0]), x, 1.0, slope, steps)
    assert abs(slope) > 1e-3
    assert np.all(np.abs(np.log10(remainder[:-1] / remainder[1:]) - 2.0) < 0.15), remainder


def test_derivatives_at_an_umbilic_are_finite():
    total = lambda r: Sphere(r).principal_curvatures(jnp.stack([r, 0.0 * r, 0.0 * r]))[0].sum()  # noqa: E731
    slope = jax.jit(jax.grad(total))(0.01)
    np.testing.assert_allclose(slope, -2.0 / 0.01**2, rtol=1e-12)


def test_vmap_over_shapes_is_a_loop():
    axes = np.array([0.02, 0.03, 0.05])
    at = np.array([0.0, 0.0, C])
    many = jax.jit(jax.vmap(lambda a: Ellipsoid(a, B, C).principal_curvatures(at)[0]))(axes)
    np.testing.assert_allclose(
        many, np.stack([C / np.maximum(axes, B) ** 2, C / np.minimum(axes, B) ** 2], -1)
    )


@pytest.mark.parametrize(("name", "shape"), [("ellipsoid", ()), ("chart", (3,)), ("moved", (2, 4))])
def test_public_shapes(name, shape):
    surface = SURFACES[name]
    at = np.broadcast_to(places(name)[0], (*shape, surface.coordinates))
    values, directions = surface.principal_curvatures(at)
    first, second = surface.forms(at)
    assert (values.shape, directions.shape) == ((*shape, 2), (*shape, 2, 3))
    assert first.shape == second.shape == (*shape, 2, 2)
    assert surface.point(at).shape == (*shape, 3)
    assert surface.near(surface.point(at)).shape == at.shape
    assert surface.normal_curvature(at, np.ones((*shape, 3))).shape == shape


def test_leading_axes_that_do_not_fit_are_named():
    ball = Sphere(A)
    with pytest.raises(ValueError, match="arguments at and direction must have shapes that fit"):
        ball.normal_curvature(np.full((4, 3), A), np.ones((3, 3)))
    with pytest.raises(ValueError, match="arguments point and guess must have shapes that fit"):
        ball.near(np.full((2, 4, 3), A), np.full((3, 3), A))
    # What can be broadcast is: three directions at each of two places.
    found = ball.normal_curvature(np.full((2, 1, 3), A / np.sqrt(3.0)), np.eye(3))
    np.testing.assert_allclose(found, np.full((2, 3), 1.0 / A), rtol=1e-12)


def test_moved_surface_is_the_surface_moved():
    """Against the rotation matrix of SciPy."""
    rotations = pytest.importorskip("scipy.spatial.transform").Rotation
    matrix = rotations.from_quat(TURN[[1, 2, 3, 0]]).as_matrix()
    still, moved, at = SURFACES["ellipsoid"], SURFACES["moved"], places("ellipsoid")
    np.testing.assert_allclose(
        moved.point(at), np.asarray(still.point(at)) @ matrix.T + np.array([0.01, -0.02, 0.03]), atol=1e-16
    )
    np.testing.assert_allclose(moved.normal(at), still.normal(at) @ matrix.T, atol=1e-14)
    turned = matrix @ np.asarray(still.shape_operator(at)) @ matrix.T
    np.testing.assert_allclose(moved.shape_operator(at), turned, atol=1e-12)


def test_algebra_of_space():
    """Products, rotations and rates against matrices; a pose's rate against the quaternion's."""
    q = sp.normalised(tuple(jnp.asarray(x) for x in TURN))
    other = sp.normalised(tuple(jnp.asarray(x) for x in (0.1, 0.9, -0.2, 0.4)))
    u, v = sp.Vec3(0.3, -0.5, 0.2), sp.Vec3(1.1, 0.4, -0.7)
    pose = sp.pose_at(u, q)
    matrix = np.stack([c.array() for c in sp.rotation(q)], -1)
    np.testing.assert_allclose(matrix.T @ matrix, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(matrix), 1.0, rtol=1e-14)
    np.testing.assert_allclose(pose.turn(v).array(), matrix @ v.array(), atol=1e-15)
    np.testing.assert_allclose(pose.back(v).array(), matrix.T @ v.array(), atol=1e-15)
    np.testing.assert_allclose(pose.local(pose.place(v)).array(), v.array(), atol=1e-15)
    np.testing.assert_allclose(u.cross(v).array(), np.cross(u.array(), v.array()), atol=1e-16)
    after = np.stack([c.array() for c in sp.rotation(sp.quaternion_product(other, q))], -1)
    np.testing.assert_allclose(
        after, np.stack([c.array() for c in sp.rotation(other)], -1) @ matrix, atol=1e-15
    )
    one = jnp.stack(sp.quaternion_product(q, sp.conjugate(q)))
    np.testing.assert_allclose(one, [1.0, 0.0, 0.0, 0.0], atol=1e-15)
    _, columns = jax.jvp(sp.rotation, (q,), (sp.quaternion_rate(q, v),))
    rate = pose.rate(sp.Twist3(u, v))
    for column, expected in zip(columns, (rate.x, rate.y, rate.z), strict=True):
        np.testing.assert_allclose(column.array(), expected.array(), atol=1e-15)
    form = sp.Sym3(1.0, 0.3, -0.2, 2.0, 0.5, 3.0)
    np.testing.assert_allclose(form.turned(pose).array(), matrix @ form.array() @ matrix.T, atol=1e-14)
    np.testing.assert_allclose(form.apply(v).array(), form.array() @ v.array(), atol=1e-15)
    mixed = np.outer(u.array(), v.array())
    np.testing.assert_allclose(sp.outer(u, v).array(), 0.5 * (mixed + mixed.T), atol=1e-16)


def test_tangents_are_orthonormal_and_right_handed():
    n = RNG.normal(size=(200, 3))
    n = np.concatenate([n / np.linalg.norm(n, axis=-1)[:, None], np.eye(3), -np.eye(3)])
    first, second = sp.tangents(sp.Vec3(*jnp.asarray(n.T)))
    frame = np.stack([first.array(), second.array(), n], -2)
    unit = np.broadcast_to(np.eye(3), frame.shape)
    np.testing.assert_allclose(frame @ np.swapaxes(frame, -1, -2), unit, atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(frame), 1.0, rtol=1e-14)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sphere(-0.01), "argument radius must be positive"),
        (lambda: Torus(0.01, 0.02), "argument major must be larger"),
        (lambda: Superellipsoid(A, B, C, exponent=1.5), "argument exponent must be at least 2"),
        (lambda: Superellipsoid(A, B, C, exponent=np.complex128(4)), "argument exponent must be at least 2"),
        (lambda: jax.eval_shape(lambda p: Superellipsoid(A, B, C, exponent=p), 4.0), "number that is known"),
        (lambda: Implicit(3.0), "argument function must be a function"),
        (lambda: Patch(np.zeros((4, 8, 3))), "argument points must have at least 6"),
        (lambda: SplineSurface(np.zeros((4, 8, 8)), (0, 0, 0), 1.0), "argument coefficients must have at"),
        (lambda: Sphere(0.01).point((0.1, 0.2)), r"argument at must have shape \(\.\.\., 3\)"),
        (lambda: Sphere(0.01).moved(rotation=(0, 0, 0, 0)), "argument rotation must be a quaternion"),
        (lambda: jxr.geometry.MovedSurface(3.0), "argument surface must be a surface"),
    ],
)  # fmt: skip
def test_bad_arguments_say_what_they_must_be(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@jax.jit
def moves_of_the_foot(surface, point):
    """Forwards and backwards, of one linearisation."""
    _, push = jax.linearize(surface.near, point)
    pull = jax.linear_transpose(push, point)
    return jax.vmap(push, out_axes=1)(jnp.eye(3)), jax.vmap(lambda row: pull(row)[0])(jnp.eye(3))


@pytest.mark.parametrize("exponent", [2.5, 3.0, 4.0])
@pytest.mark.parametrize("height", [0.013, 0.008])
def test_derivatives_of_near_where_the_surface_is_flat(exponent, height):
    """The shape operator is zero on an axis: a point moves its foot as above a plane, in both modes."""
    block = jxr.geometry.Superellipsoid(0.03, 0.02, 0.01, exponent=exponent)
    point = jnp.array([0.0, 0.0, height])
    for found in moves_of_the_foot(block, point):
        np.testing.assert_allclose(found, np.diag([1.0, 1.0, 0.0]), atol=1e-9)


@pytest.mark.parametrize(
    "kind", [jxr.Ellipsoid, pytest.param(jxr.geometry.Superellipsoid, marks=pytest.mark.slow)]
)
def test_derivatives_of_near_in_the_shape_of_the_surface(kind):
    """The foot of a fixed point moves with the half axes: both modes, and one after the other."""
    point, axes, way = (
        np.array([0.02, 0.013, 0.004]),
        np.array([0.012, 0.01, 0.011]),
        np.array([1.0, -0.4, 0.7]),
    )
    more = {} if kind is jxr.Ellipsoid else {"exponent": 2.5}
    foot = lambda x: kind(*(axes + 1e-3 * x * way), **more).near(point)  # noqa: E731

    once = lambda x, row: jax.value_and_grad(lambda x: row @ foot(x))(x)  # noqa: E731
    # One program: a coordinate and its derivative backwards, and how both change forwards.
    twice = jax.jit(lambda x, row: jax.jvp(lambda x: once(x, row), (x,), (1.0,)))
    step = 1e-3
    for row in np.eye(3):
        (ahead, behind), here = (twice(0.1 + k * step, row)[0] for k in (1, -1)), twice(0.1, row)
        (_, backwards), (forwards, second) = here
        np.testing.assert_allclose(forwards, (ahead[0] - behind[0]) / (2.0 * step), atol=1e-9)
        np.testing.assert_allclose(second, (ahead[1] - behind[1]) / (2.0 * step), atol=1e-9)
        np.testing.assert_allclose(backwards, forwards, rtol=1e-10)
