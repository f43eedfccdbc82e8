"""Mass, centre and inertia: closed forms, trimesh, and the same body as another kind of shape."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxroll as jxr
from jaxroll.geometry import (
    Chart,
    Hollow,
    Implicit,
    mass_properties,
    Patch,
    SplineSurface,
    Superellipsoid,
    Vec3,
)

A, B, C = 0.03, 0.02, 0.012
MAJOR, MINOR = 0.03, 0.01
TURN, SHIFT = Rotation.from_rotvec([0.4, -0.7, 0.3]), np.array([0.2, -0.1, 0.05])


def agree(found, size, centre, inertia, allowed):
    extent = np.sqrt(np.abs(inertia).max() / size)
    np.testing.assert_allclose(float(found.size), size, rtol=allowed)
    np.testing.assert_allclose(found.centre, centre, atol=allowed * extent)
    np.testing.assert_allclose(found.inertia, inertia, atol=allowed * np.abs(inertia).max())


def snail(waves, u):
    """r = 1 + a cos(u), in centimetres; shifted off the origin."""
    radius = 0.01 * (1.0 + waves[0] * jnp.cos(u))
    return jnp.stack([0.05 + radius * jnp.cos(u), radius * jnp.sin(u)])


def snails(a):
    return jxr.Parametric(jax.tree_util.Partial(snail, jnp.stack([a])), (0.0, 2.0 * np.pi), closed=True)


def test_a_polar_curve():
    """Area, first and polar moment of r(u): integrals of r^2 / 2, r^3 cos(u) / 3 and r^4 / 4."""

    def truth(a):
        area = np.pi * 0.01**2 * (1.0 + a**2 / 2.0)
        first = np.pi * 0.01**3 * (a + a**3 / 4.0)
        return area, first / area, np.pi * 0.01**4 * (0.5 + 1.5 * a**2 + 0.1875 * a**4) - first**2 / area

    area, shift, moment = truth(0.4)
    agree(mass_properties(snails(jnp.asarray(0.4)), 3.0), area, [0.05 + shift, 0.0], 3.0 * moment, 1e-12)
    slope = jax.grad(lambda a: mass_properties(snails(a), 3.0).inertia)(jnp.asarray(0.4))
    wanted = 3.0 * (truth(0.4 + 1e-5)[2] - truth(0.4 - 1e-5)[2]) / 2e-5
    np.testing.assert_allclose(slope, wanted, rtol=1e-8)


def through(x, y):
    """A spline by 192 points, by which `test_an_ellipse_in_every_form` has compiled its program."""
    return jxr.Spline(0.01 * np.stack([x, y], -1))


def dented(depth):
    """A disc of 10 mm with a dent at its top, so deep: through its underside beyond 20 mm."""
    u = 2.0 * np.pi * np.arange(192) / 192
    return through(np.cos(u), np.sin(u) - 100.0 * depth * np.exp(-(((u - np.pi / 2.0) / 0.3) ** 2)))


def eight():
    u = 2.0 * np.pi * np.arange(192) / 192
    return through(np.sin(2.0 * u) + 0.2 * np.cos(u), 2.0 * np.sin(u))


def twice_round():
    return jxr.Parametric(jax.tree_util.Partial(snail, jnp.array([0.4])), (0.0, 4.0 * np.pi), closed=True)


NO_BODY = {
    "twice round": (twice_round, "the tangent of this Parametric turned round 2 times"),
    "a loop inside": (
        lambda: snails(jnp.asarray(2.0)),
        "the tangent of this Parametric turned round 2 times",
    ),
    "figure eight": (eight, "the tangent of this Spline turned round 0 times"),
    "dent through the far side": (lambda: dented(0.0205), r"this Spline did near \[-?0.00"),
    "placed elsewhere": (lambda: eight().moved((0.1, 0.0), 0.3), "turned round 0 times"),
}


@pytest.mark.parametrize("name", NO_BODY)
def test_a_contour_that_crosses_itself_or_runs_round_twice_has_no_mass(name):
    make, words = NO_BODY[name]
    words = f"^argument shape must be a contour that runs once round its body .* itself, but .*{words}"
    with pytest.raises(ValueError, match=words):
        mass_properties(make(), 1.0)


def test_a_contour_that_nearly_meets_itself_has_its_mass():
    """By a neck of a micrometre."""
    assert 0.0 < float(mass_properties(dented(0.019999), 1.0).size) < np.pi * 0.01**2


def test_an_ellipse_in_every_form():
    """Closed form, table and spline, each placed elsewhere; the plate's mass counts its thickness."""
    size, inertia = np.pi * A * B, np.pi * A * B * (A**2 + B**2) / 4.0
    turns = 2.0 * np.pi * np.arange(192) / 192
    shapes = [
        (jxr.Ellipse(A, B), 1e-14),
        (
            jxr.Parametric(
                lambda u: jnp.stack([A * jnp.cos(u), B * jnp.sin(u)]), (0.0, 2 * np.pi), closed=True
            ),
            1e-13,
        ),
        (jxr.Spline(np.stack([A * np.cos(turns), B * np.sin(turns)], -1)), 1e-9),
    ]
    for shape, allowed in shapes:
        plate = mass_properties(shape.moved((0.1, 0.2), 0.3), 1000.0, thickness=0.004)
        agree(plate, size, [0.1, 0.2], 4.0 * inertia, allowed)
        np.testing.assert_allclose(plate.mass, 4.0 * size, rtol=allowed)


def solid_ellipsoid(density):
    size = 4.0 / 3.0 * np.pi * A * B * C
    return size, density * size / 5.0 * np.diag([B**2 + C**2, A**2 + C**2, A**2 + B**2])


def solid_ring(density):
    size = 2.0 * np.pi**2 * MAJOR * MINOR**2
    across = MAJOR**2 / 2.0 + 5.0 * MINOR**2 / 8.0
    return size, density * size * np.diag([across, across, MAJOR**2 + 0.75 * MINOR**2])


def bulb(u, v):
    return A * jnp.sin(v) * jnp.cos(u), B * jnp.sin(v) * jnp.sin(u), -C * jnp.cos(v)


def ring(u, v):
    out = MAJOR + MINOR * jnp.cos(v)
    return out * jnp.cos(u), out * jnp.sin(u), MINOR * jnp.sin(v)


def ring_patch(m, n):
    u, v = np.meshgrid(2 * np.pi * np.arange(m) / m, 2 * np.pi * np.arange(n) / n, indexing="ij")
    return Patch(np.stack(ring(u, v), -1), periodic=(True, True))


ROUND = ((0.0, 2.0 * np.pi), (0.0, 2.0 * np.pi))
SURFACES = {
    "ellipsoid": (lambda: jxr.Ellipsoid(A, B, C), solid_ellipsoid, 1e-14),
    "superellipsoid": (lambda: Superellipsoid(A, B, C, exponent=2.0), solid_ellipsoid, 1e-14),
    "chart with poles": (
        lambda: Chart(bulb, domain=(ROUND[0], (0.0, np.pi)), periodic=(True, False)),
        solid_ellipsoid,
        1e-12,
    ),
    "torus": (lambda: jxr.Torus(MAJOR, MINOR), solid_ring, 1e-14),
    "chart of a torus": (lambda: Chart(ring, domain=ROUND, periodic=(True, True)), solid_ring, 1e-12),
}


@pytest.mark.slow
def test_a_patch_of_a_torus():
    """Its points are met exactly, the surface between them to the sixth power of their distance."""
    size, inertia = solid_ring(700.0)
    agree(mass_properties(ring_patch(96, 96), 700.0), size, np.zeros(3), inertia, 1e-8)


@pytest.mark.parametrize("name", SURFACES)
def test_closed_surfaces(name):
    make, solid, allowed = SURFACES[name]
    size, inertia = solid(700.0)
    agree(mass_properties(make(), 700.0), size, np.zeros(3), inertia, allowed)


def test_a_surface_placed_elsewhere():
    size, inertia = solid_ellipsoid(1.0)
    matrix = TURN.as_matrix()
    placed = jxr.Ellipsoid(A, B, C).moved(SHIFT, np.roll(TURN.as_quat(), 1))
    agree(mass_properties(placed, 1.0), size, SHIFT, matrix @ inertia @ matrix.T, 1e-13)


def fields():
    """Fields of one ring, one ellipsoid and one box with rounded edges."""
    tube = lambda x, y, z: (jnp.sqrt(x * x + y * y) - MAJOR) ** 2 + z * z - MINOR**2  # noqa: E731
    egg = lambda x, y, z: (x / A) ** 2 + (y / B) ** 2 + (z / C) ** 2 - 1.0  # noqa: E731
    block = lambda x, y, z: (x / A) ** 4 + (y / B) ** 4 + (z / C) ** 4 - 1.0  # noqa: E731
    rounded = mass_properties(Superellipsoid(A, B, C, exponent=4.0), 1.0)
    return {
        "ring": (tube, solid_ring(1.0)),
        "egg": (egg, solid_ellipsoid(1.0)),
        "block": (block, (float(rounded.size), np.asarray(rounded.inertia))),
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ring", "egg", "block"])
def test_implicit_surfaces_of_any_genus(name):
    field, (size, inertia) = fields()[name]
    found = mass_properties(Implicit(field, radius=0.045), 1.0)
    agree(found, size, np.zeros(3), inertia, 1e-9)
    assert 0.0 < found.error < 1e-8


@pytest.mark.slow
def test_a_field_of_splines_that_is_a_ball():
    """Quintic splines have a quadratic field exactly: a ball."""
    x = 0.005 * (np.arange(16) - 7.5)
    # Of uniform quintic B-splines the coefficients of x^2 are the squares of the centres less h^2 / 2.
    square = x**2 - 0.005**2 / 2.0
    field = square[:, None, None] + square[None, :, None] + square[None, None, :] - 0.02**2
    ball = SplineSurface(field, (x[2], x[2], x[2]), 0.005)
    size = 4.0 / 3.0 * np.pi * 0.02**3
    agree(mass_properties(ball, 1.0), size, np.zeros(3), 0.4 * size * 0.02**2 * np.eye(3), 1e-9)


@pytest.mark.slow
def test_a_field_that_is_negative_beyond_its_grid():
    """(u - r^2) (R^2 - u), u the squared distance: a ball of radius r within the grid, and all beyond R."""
    step, small, large = 0.005, 0.02**2, 0.039**2
    x = step * (np.arange(14) - 6.5)
    # Coefficients of x^2 and x^4; those of a product of functions of x, y and z are products.
    square = x**2 - step**2 / 2.0
    fourth = x**4 - 3.0 * step**2 * x**2 + 0.8 * step**4
    along = (lambda c: c[:, None, None], lambda c: c[None, :, None], lambda c: c[None, None, :])
    squares, one = [place(square) for place in along], np.ones((14, 14, 14))
    twice = sum(place(fourth) for place in along) + 2.0 * (
        squares[0] * squares[1] + squares[1] * squares[2] + squares[2] * squares[0]
    )
    field = (small + large) * sum(squares) - twice - small * large * one
    ball = SplineSurface(field / large, (x[2],) * 3, step)
    assert float(ball.derivatives(Vec3(0.0, 0.0, 0.02)).value) == pytest.approx(0.0, abs=1e-15)
    size = 4.0 / 3.0 * np.pi * 0.02**3
    agree(mass_properties(ball, 1.0), size, np.zeros(3), 0.4 * size * small * np.eye(3), 1e-9)


def test_meshes_against_trimesh():
    trimesh = pytest.importorskip("trimesh")
    for mesh in (trimesh.creation.icosphere(2, 0.02), trimesh.creation.torus(MAJOR, MINOR)):
        mesh.apply_transform(trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.5, 0.7])))
        mesh.apply_translation(SHIFT)
        for given in (mesh, (mesh.vertices, mesh.faces), (mesh.triangles.reshape(-1, 3), soup(mesh))):
            found = mass_properties(given, 1.0)
            agree(found, mesh.volume, mesh.center_mass, mesh.moment_inertia, 1e-11)


def soup(mesh):
    """Faces of a mesh whose triangles share no vertex, as STL files have it."""
    return np.arange(3 * len(mesh.faces)).reshape(-1, 3)


def box():
    """A cuboid of 1, 2 and 3 cm as a mesh."""
    corners = np.array([[x, y, z] for x in (0, 0.01) for y in (0, 0.02) for z in (0, 0.03)])
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    return corners, np.array([*faces, (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)])


def test_a_cuboid():
    size = 6e-6
    inertia = size / 12.0 * np.diag([0.02**2 + 0.03**2, 0.01**2 + 0.03**2, 0.01**2 + 0.02**2])
    agree(mass_properties(box(), 1.0), size, [0.005, 0.01, 0.015], inertia, 1e-14)


def test_uniform_objects_have_their_frame_at_the_centre():
    plate = jxr.FreeObject.uniform(jxr.Ellipse(A, B).moved((0.1, 0.0)), 1000.0, thickness=0.01)
    np.testing.assert_allclose(mass_properties(plate.contours[0], 1.0).centre, 0.0, atol=1e-17)
    np.testing.assert_allclose(plate.mass, 10.0 * np.pi * A * B)
    solid = jxr.FreeObject3.uniform(jxr.Ellipsoid(A, B, C).moved(SHIFT), 700.0)
    np.testing.assert_allclose(solid.inertia, solid_ellipsoid(700.0)[1], rtol=1e-13, atol=1e-18)
    np.testing.assert_allclose(mass_properties(solid.surfaces[0], 1.0).centre, 0.0, atol=1e-17)


REFUSED = {
    "open contour": (lambda: jxr.Line((-0.1, 0.1)), "but was an open Line"),
    "endless surface": (jxr.Plane, "but was a Plane"),
    "hole": (lambda: Hollow(jxr.Sphere(0.01)), "but was a Hollow"),
    "mesh with a hole": (lambda: (box()[0], box()[1][1:]), "3 of its 18 edges"),
    "mesh inside out": (lambda: (box()[0], box()[1][:, ::-1]), "counter-clockwise from outside"),
    "one face turned": (
        lambda: (box()[0], np.concatenate([box()[1][:1, ::-1], box()[1][1:]])),
        "3 of its 18 edges",
    ),
    "faces beyond": (lambda: (box()[0][:-1], box()[1]), "from 0 to 6, but one was 7"),
    "fractions": (lambda: (box()[0], box()[1] + 0.5), "from 0 to 7, but one was 0.5"),
    "chart with an edge": (
        lambda: Chart(bulb, domain=(ROUND[0], (0.0, 3.0)), periodic=(True, False)),
        "has an edge at v = 3",
    ),
    "chart twice round": (
        lambda: Chart(bulb, domain=((0.0, 4.0 * np.pi), (0.0, np.pi)), periodic=(True, False)),
        "runs once round its body, but this Chart does so 2 times",
    ),
    "field beyond its bounds": (
        lambda: Implicit(lambda x, y, z: x * x + y * y + z * z - 1e-4, radius=0.005),
        "no point of this Implicit",
    ),
    "nothing": (lambda: None, "but was None"),
    "one of three": (lambda: box() + (1,), "a contour, a surface, or vertices and faces"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_encloses_nothing_is_refused(name):
    shape, words = REFUSED[name]
    with pytest.raises(ValueError, match=f"argument shape must .*{words}"):
        mass_properties(shape(), 1.0)


def test_numbers_are_checked():
    for bad in (0.0, -1.0, np.nan, "1", None):
        with pytest.raises(ValueError, match="argument density must"):
            mass_properties(jxr.Circle(0.01), bad)
    with pytest.raises(ValueError, match=r"argument thickness must be positive, but was 0\.0"):
        mass_properties(jxr.Circle(0.01), 1.0, thickness=0.0)
    with pytest.raises(ValueError, match="argument thickness must be None in space"):
        mass_properties(jxr.Sphere(0.01), 1.0, thickness=0.01)
