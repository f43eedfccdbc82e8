"""Closest points of two surfaces: closed forms, SciPy on support functions, derivatives, second contacts."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import jaxroll as jxr
from jaxroll._linalg import _space as sp
from jaxroll.contact import locate_surfaces
from jaxroll.contact.locating._location3 import _downhill
from jaxroll.contact.locating._pair3 import Pair3, TangentForm
from jaxroll.geometry import (
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
from tests.helpers import in_single, slow_among
from tests.measures import both_ways, taylor_remainders

SUCCESS = jxr.RESULTS.successful
STILL = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
TURN = np.array([0.5, -0.1, 0.7, 0.3])


def posed(position, quaternion=TURN):
    return np.concatenate([position, quaternion])


def matrix(pose):
    return Rotation.from_quat(np.roll(pose[3:], -1)).as_matrix()


@jax.jit
def spheres(radii, pose_a, pose_b):
    return locate_surfaces(Sphere(radii[0]), Sphere(radii[1]), pose_a=pose_a, pose_b=pose_b)


def gap_and_all(axes_a, axes_b, pose_a, pose_b):
    found = locate_surfaces(Ellipsoid(*axes_a), Ellipsoid(*axes_b), pose_a=pose_a, pose_b=pose_b)
    return found.gap, found


# Where two ellipsoids are nearest, and before that the derivatives of their gap in both poses.
slopes_and_met = jax.jit(jax.grad(gap_and_all, argnums=(2, 3), has_aux=True))


def slopes_and_met_of(*given):
    """The same as NumPy's arrays. All tests ask for one pair at a time, so that it is one program."""
    return jax.device_get(slopes_and_met(*(np.asarray(x, float) for x in given)))


def met_one(*given):
    """Where a pair of ellipsoids is nearest."""
    return slopes_and_met_of(*given)[1]


def met(*given):
    """Where pairs of ellipsoids are nearest."""
    return jax.tree.map(lambda *rows: np.stack(rows), *(met_one(*pair) for pair in zip(*given, strict=True)))


def balls(radii, pose_a, pose_b):
    """Where two balls are nearest: ellipsoids of equal half axes."""
    return met_one(np.full(3, radii[0]), np.full(3, radii[1]), pose_a, pose_b)


@pytest.mark.parametrize("offset", [(0.05, 0.02, -0.01), (0.018, 0.024, 0.0), (0.02, -0.01, 0.005)])
def test_two_balls(offset):
    base = np.array([0.1, -0.2, 0.3])
    away = np.linalg.norm(offset)
    normal = np.asarray(offset) / away
    found = balls((0.01, 0.02), posed(base + offset), posed(base, TURN[::-1]))
    assert found.result == SUCCESS and bool(found.unique) and int(found.others.count) == 0
    np.testing.assert_allclose(float(found.gap), away - 0.03, atol=2e-16)
    np.testing.assert_allclose(found.normal, normal, atol=1e-14)
    np.testing.assert_allclose(found.points[0], base + offset - 0.01 * normal, atol=1e-15)
    np.testing.assert_allclose(found.points[1], base + 0.02 * normal, atol=1e-15)
    np.testing.assert_allclose(matrix(posed(base)) @ np.asarray(found.at_a), -0.01 * normal, atol=1e-15)
    assert bool(found.penetrating) == (float(found.gap) < 0.0) and float(found.residual) <= 1e-14


def test_a_grain_on_a_boulder():
    """The grain's samples find the place; inside, the grain has a deepest point and the boulder has none."""
    normal = np.array([0.48, -0.6, 0.64])
    for radii in ((1.0, 0.001), (0.001, 1.0)):
        found = balls(radii, STILL, posed((1.001 + 1e-4) * normal))
        assert found.result == SUCCESS and bool(found.unique)
        np.testing.assert_allclose(float(found.gap), 1e-4, atol=1e-15)

    inside = balls((0.001, 1.0), STILL, posed(0.99 * normal))
    assert inside.result == SUCCESS and abs(float(inside.gap) + 0.011) <= 1e-15
    assert balls((1.0, 0.001), STILL, posed(0.99 * normal)).result == jxr.RESULTS.too_deep


def test_concentric_balls_are_not_unique():
    found = balls((0.01, 0.02), STILL, STILL)
    assert not bool(found.unique)
    np.testing.assert_allclose(float(found.gap), -0.01, atol=1e-15)


@pytest.mark.parametrize("swapped", [False, True])
def test_sphere_and_plane_either_way(swapped):
    """At any depth, since it is the sphere that is walked; one by one, and with `vmap` all at once."""
    heights = np.array([0.03, 0.01, 0.004, -0.02])
    balls = [posed((0.2, 0.1, height)) for height in heights]
    if swapped:
        met = jax.vmap(lambda ball: locate_surfaces(Plane(), Sphere(0.01), pose_a=STILL, pose_b=ball))
        found = met(np.stack(balls))
    else:
        each = [locate_surfaces(Sphere(0.01), Plane(), pose_a=ball, pose_b=STILL) for ball in balls]
        found = jax.tree.map(lambda *rows: np.stack(rows), *each)
    assert np.all(found.result == SUCCESS) and np.all(found.unique)
    np.testing.assert_allclose(found.gap, heights - 0.01, atol=1e-15)
    floor = np.tile([0.2, 0.1, 0.0], (4, 1))
    expected = np.stack([floor + (heights - 0.01)[:, None] * [0.0, 0.0, 1.0], floor], axis=1)
    np.testing.assert_allclose(found.points, expected[:, ::-1] if swapped else expected, atol=1e-15)
    normals = np.tile([0.0, 0.0, -1.0 if swapped else 1.0], (4, 1))
    np.testing.assert_allclose(found.normal, normals, atol=1e-14)
    np.testing.assert_allclose(found.at_a if swapped else found.at_b, floor, atol=1e-15)


@functools.cache
def ellipsoids():
    """Forty pairs placed at chosen directions, apart, touching, and overlapping a little."""
    rng = np.random.default_rng(1)
    axes = rng.uniform(0.01, 0.03, size=(2, 40, 3))
    poses = np.concatenate([rng.normal(size=(2, 40, 3)) * 0.1, rng.normal(size=(2, 40, 4))], axis=-1)
    gaps = np.concatenate([rng.uniform(0.0, 0.03, 16), np.zeros(8), -rng.uniform(0.0, 5e-4, 16)])
    normal = rng.normal(size=(40, 3))
    normal /= np.linalg.norm(normal, axis=-1)[:, None]
    for i in range(40):
        reach = support(axes[0, i], poses[0, i], -normal[i])[1] - poses[0, i, :3]
        poses[0, i, :3] = support(axes[1, i], poses[1, i], normal[i])[1] + gaps[i] * normal[i] - reach
    return axes, poses, gaps


def support(axes, pose, n):
    """How far an ellipsoid reaches along a direction, and its farthest point."""
    turn = matrix(pose)
    local = axes * (turn.T @ n)
    size = np.linalg.norm(local)
    return pose[:3] @ n + size, pose[:3] + turn @ (axes * local / size)


def widest(axes, poses, starts):
    """The largest separation by a plane, by SciPy from many starts."""
    # An ellipsoid about c reaches c n + |S n| along n, with the rows of S its half axes.
    between = poses[1, :3] - poses[0, :3]
    half = [(matrix(pose) * own).T for pose, own in zip(poses, axes, strict=True)]

    def overlap(v):
        """In units of a millimetre, and its derivative."""
        size = np.sqrt(v @ v)
        n = v / size
        ends = [rows @ n for rows in half]
        reach = [np.sqrt(end @ end) for end in ends]
        slope = between + sum(rows.T @ end / r for rows, end, r in zip(half, ends, reach, strict=True))
        return 1e3 * (between @ n + sum(reach)), 1e3 * (slope - n * (n @ slope)) / size

    found = [minimize(overlap, v, jac=True, method="BFGS", options={"gtol": 1e-10}) for v in starts]
    return -1e-3 * min(f.fun for f in found)


def test_two_ellipsoids_against_scipy():
    axes, poses, gaps = ellipsoids()
    found = met(*axes, *poses)
    assert np.all(np.asarray(found.result == SUCCESS)) and np.all(np.asarray(found.unique))
    assert float(found.residual.max()) <= 1e-12
    np.testing.assert_allclose(found.gap, gaps, atol=1e-15)
    starts = np.random.default_rng(2).normal(size=(12, 3))
    for i in range(0, 40, 2):
        gap = widest(axes[:, i], poses[:, i], starts)
        np.testing.assert_allclose(float(found.gap[i]), gap, atol=1e-12)


def test_ellipsoids_of_equal_half_axes_are_the_balls_that_they_are():
    """Long steps from samples far away end a little inside of an implicit surface: lower than all of it."""
    rng, count = np.random.default_rng(3), 10
    way, turns = rng.normal(size=(count, 3)), rng.normal(size=(2, count, 4))
    gaps = np.geomspace(1e-9, 1e-4, count) * (-1.0) ** np.arange(count)
    centres = way * ((0.03 + gaps) / np.linalg.norm(way, axis=1))[:, None]
    poses = [
        np.concatenate([where, turn], axis=1) for where, turn in zip((centres, 0.0 * way), turns, strict=True)
    ]
    found = met(np.full((count, 3), 0.01), np.full((count, 3), 0.02), *poses)
    assert np.all(found.result == SUCCESS)
    np.testing.assert_allclose(found.gap, gaps, rtol=0, atol=1e-15)


@jax.jit
def crossed(turn, height):
    """A rod across a ring, tilted a little."""
    rod = Ellipsoid(0.05, 0.006, 0.008)
    pose = jnp.stack([0.002, 0.0, height, jnp.cos(turn), 0.0, jnp.sin(turn), 0.0])
    return locate_surfaces(rod, Torus(0.03, 0.011), pose_a=pose)


@pytest.mark.slow
def test_a_rod_on_a_ring_touches_twice():
    found = crossed(0.02, 0.021)
    assert found.result == SUCCESS and bool(found.unique) and int(found.others.count) == 1
    assert float(found.residual) <= 1e-12
    sides = np.array([found.points[1, 0], found.others.at_b[0, 0]])
    assert sides.min() < -0.025 and sides.max() > 0.025
    level = crossed(0.0, 0.021)
    assert int(level.others.count) == 1
    # Exchanged, the same two contacts.
    rod, ring = Ellipsoid(0.05, 0.006, 0.008), Torus(0.03, 0.011)
    pose = np.array([0.002, 0.0, 0.021, np.cos(0.02), 0.0, np.sin(0.02), 0.0])
    other = locate_surfaces(ring, rod, pose_b=pose)
    np.testing.assert_allclose(float(other.gap), float(found.gap), atol=1e-15)
    np.testing.assert_allclose(float(other.others.gap[0]), float(found.others.gap[0]), atol=1e-15)
    np.testing.assert_allclose(other.others.at_b[0], found.others.at_a[0], atol=1e-12)


def test_exchanged_scene_is_the_same():
    """Where a place of `a` is in the frame of `b`, it is back in its own by the exchanged pose."""
    pose = sp.pose_at(sp.Vec3(0.1, -0.2, 0.3), sp.normalised(tuple(TURN)))
    scene = Pair3(Sphere(0.01), Torus(0.03, 0.011), pose, 0.02)
    other = scene.reversed()
    assert (other.a, other.b) == (scene.b, scene.a)
    point = sp.Vec3(0.03, 0.05, -0.02)
    np.testing.assert_allclose(other.pose.place(pose.place(point)).array(), point.array(), atol=1e-16)


FORM = Implicit(lambda x, y, z: 0.01 * ((x / 0.03) ** 2 + (y / 0.02) ** 2 + (z / 0.012) ** 2 - 1.0))
MAJOR, MINOR = 0.03, 0.011


def ring_field(x, y, z):
    """Quartic, unlike the distance that `Torus` uses; about a metre for a metre at the surface."""
    out = x**2 + y**2
    return ((out + z**2 + MAJOR**2 - MINOR**2) ** 2 - 4 * MAJOR**2 * out) / (8 * MAJOR**2 * MINOR)


RING = Implicit(ring_field, radius=0.0415)
MET = {
    "field of unknown size": FORM,
    "field of known size": RING,
    "superellipsoid": Superellipsoid(0.03, 0.02, 0.012, exponent=4),
    "moved": Ellipsoid(0.03, 0.02, 0.012).moved((0.01, 0.02, 0.0), TURN),
    "extruded": Extruded(jxr.Ellipse(0.03, 0.02)),
}


def place_of(name, near):
    """Coordinates, point and normal where a shape is nearest to a point; of the ring by its formula."""
    shape = MET[name]
    if shape is not RING:
        at = shape.near(near)
        return at, np.asarray(shape.point(at)), np.asarray(shape.normal(at))
    middle = MAJOR * near * [1, 1, 0] / np.hypot(*near[:2])
    normal = (near - middle) / np.linalg.norm(near - middle)
    point = middle + MINOR * normal
    return point, point, normal


@pytest.mark.parametrize("name", slow_among(MET, *(name for name in MET if name != "field of known size")))
def test_sphere_placed_along_a_normal(name):
    """4 mm above a place of a surface, and 1 mm below it."""
    shape, (at, point, normal) = MET[name], place_of(name, np.array([0.02, 0.018, 0.008]))
    body = posed((0.1, 0.2, -0.1))
    for gap in (0.004, -0.001):
        ball = posed(body[:3] + matrix(body) @ (point + (0.01 + gap) * normal))
        found = locate_surfaces(shape, Sphere(0.01), pose_a=body, pose_b=ball)
        assert found.result == SUCCESS and bool(found.unique) and float(found.residual) <= 1e-12
        np.testing.assert_allclose(float(found.gap), gap, atol=1e-15)
        np.testing.assert_allclose(found.at_a, at, atol=1e-12)
        np.testing.assert_allclose(found.normal, -matrix(body) @ normal, atol=1e-12)


def test_overlap_without_a_single_nearest_point_is_reported():
    found = met_one(np.full(3, 0.004), (0.03, 0.03, 0.012), STILL, STILL)
    assert found.result == jxr.RESULTS.too_deep and not bool(found.unique)


@pytest.mark.parametrize("x", [(0.003, 0.001, 0.0005), (0.009, 0.0, 0.0), (0.012, 0.002, 0.001)])
def test_what_is_deep_inside_says_how_deep_its_lowest_sample_is(x):
    """Of a small body in a large one: the nearest of a million points of the large one, by brute force."""
    axes, small = np.array([0.02, 0.012, 0.011]), np.array([0.0015, 0.001, 0.0008])
    place = posed(np.array(x))
    found = met_one(axes, small, STILL, place)
    assert found.result == jxr.RESULTS.too_deep
    on_large, on_small = np.asarray(found.points)
    np.testing.assert_allclose(((on_large / axes) ** 2).sum(), 1.0, atol=1e-12)
    np.testing.assert_allclose((((on_small - x) @ matrix(place) / small) ** 2).sum(), 1.0, atol=1e-12)
    u, v = np.meshgrid(np.linspace(-np.pi, np.pi, 1601), np.linspace(-np.pi / 2, np.pi / 2, 801))
    points = axes * np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], axis=-1)
    depth = np.linalg.norm(points - on_small, axis=-1).min()
    np.testing.assert_allclose(-float(found.gap), depth, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("swapped", [False, True])
def test_derivatives_of_the_lowest_sample_where_no_pair_is_the_answer(swapped):
    """The sample is one of either surface, or stays there; its foot on the other one moves."""
    shapes = (Ellipsoid(0.03, 0.02, 0.01), Sphere(0.02))[:: 1 if swapped else -1]
    start = jnp.array([0.0031, 0.002, 0.0015, 1.0, 0.1, 0.2, 0.0])
    way = jnp.array([1.0, 0.3, 0.2, 0.0, 0.0, 0.5, 0.0])

    @jax.jit
    def both(x):
        def found(x):
            at = locate_surfaces(*shapes, pose_a=start + x * way, samples=128, candidates=1)
            return jnp.append(jnp.ravel(jnp.asarray(at.points)), at.gap), at.result

        return jax.jvp(lambda x: found(x)[0], (x,), (1.0,)), found(x)[1]

    h = 1e-6
    (low, _), (high, _) = (both(x)[0] for x in (-h, h))
    (_, slope), code = both(0.0)
    assert code == jxr.RESULTS.too_deep and abs(slope[-1]) > 0.1
    np.testing.assert_allclose(slope, (high - low) / (2.0 * h), rtol=1e-6, atol=1e-7)


def sphere_piece(n, radius):
    u, v = np.meshgrid(np.linspace(-0.6, 0.6, n), np.linspace(-0.5, 0.5, n), indexing="ij")
    return radius * np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], -1)


@functools.cache
def wall():
    """The plane x = 0 as a field on a grid of 30 mm."""
    slope = np.broadcast_to(0.01 * (np.arange(8) - 3.0)[:, None, None], (8, 8, 8))
    return SplineSurface(slope, (-0.01, -0.01, -0.01), 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["patch", "field"])
def test_small_piece_and_a_sphere(name):
    """A piece of a sphere by points, one of a plane by a field; past their ends there is no pair."""
    ball, pose = Sphere(0.01), posed((0.04, 0.01, -0.008))
    if name == "patch":
        pair, place, past = (Patch(sphere_piece(16, 0.02)), ball), "pose_b", (0.0, 0.05, 0.0)
        gap = np.linalg.norm(pose[:3]) - 0.03
    else:
        pair, place, past, gap = (ball, wall()), "pose_a", (0.04, 0.05, 0.0), 0.03
    found = locate_surfaces(*pair, **{place: pose})
    assert found.result == SUCCESS and float(found.residual) <= 1e-12
    np.testing.assert_allclose(float(found.gap), gap, atol=1e-9)
    assert locate_surfaces(*pair, **{place: posed(past)}).result == jxr.RESULTS.contour_end


@jax.jit
def meet(sizes, pose_a, pose_b):
    shapes = Ellipsoid(sizes[0], sizes[1], sizes[2]), Torus(sizes[3], sizes[4])
    return locate_surfaces(*shapes, pose_a=pose_a, pose_b=pose_b, samples=64, candidates=2)


SIZES = np.array([0.03, 0.02, 0.012, 0.03, 0.011])
PLACES = {"apart": 0.066, "overlapping": 0.0505}


def case(name):
    return SIZES, posed((PLACES[name], 0.012, 0.01)), posed((0.003, -0.002, 0.001), TURN[::-1])


def measure(point):
    found = meet(*point)
    return 1e2 * jnp.concatenate([found.gap[None], found.at_a, found.at_b, 1e-2 * found.normal])


# The value, its derivative along a direction, and a row of all its derivatives.
EVERY = both_ways(measure)
BARS = np.eye(10)


@pytest.mark.parametrize("name", PLACES)
def test_gradient_of_the_gap_is_the_relative_velocity_along_the_normal(name):
    r"""$\dot g = n \cdot (v_a + \omega_a \times r_a - v_b - \omega_b \times r_b)$."""
    sizes, *poses = case(name)
    rows, found = slopes_and_met_of(sizes[:3], (0.0445, 0.0415, 0.0175), *poses)
    assert found.result == SUCCESS and (float(found.gap) < 0.0) == (name == "overlapping")
    n = np.asarray(found.normal)
    for row, pose, point, sign in zip(map(np.asarray, rows), poses, found.points, (1.0, -1.0), strict=True):
        np.testing.assert_allclose(row[:3], sign * n, atol=1e-12)
        w, vector = pose[3], pose[4:]
        for spin in np.eye(3):
            rate = 0.5 * np.concatenate([[-spin @ vector], spin * w + np.cross(spin, vector)])
            velocity = np.cross(spin, np.asarray(point) - pose[:3])
            np.testing.assert_allclose(row[3:] @ rate, sign * n @ velocity, atol=1e-13)


@pytest.mark.parametrize("centre", [(0.06, 0.01, 0.02), (0.004, 0.003, 0.001), (0.0, 0.024, 0.019)])
def test_ring_and_ball(centre):
    """The distance of a point from a circle; also from inside the hole, and overlapping."""
    found = locate_surfaces(RING, Sphere(0.012), pose_a=STILL, pose_b=posed(centre))
    x, y, z = centre
    np.testing.assert_allclose(float(found.gap), np.hypot(np.hypot(x, y) - 0.03, z) - 0.023, atol=1e-15)
    assert found.result == SUCCESS and bool(found.unique)


@pytest.mark.parametrize("name", slow_among(PLACES, *PLACES, optimised=["apart"]))
def test_derivatives_in_shapes_and_poses(name):
    """Taylor remainders of gap, coordinates and normal fall as the square of the step; both modes agree."""
    point, rng = case(name), np.random.default_rng(0)
    direction = tuple(0.01 * rng.standard_normal(x.shape) for x in point)
    value = lambda point: EVERY(point, direction, BARS[0])[0]  # noqa: E731
    _, forward, _ = EVERY(point, direction, BARS[0])
    rows = [EVERY(point, direction, bar)[2] for bar in BARS]
    reverse = [sum(x @ d for x, d in zip(row, direction, strict=True)) for row in rows]
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-12)
    steps = np.array([1e-1, 1e-2, 1e-3])
    for i, slope in enumerate(forward):
        left = taylor_remainders(lambda p, i=i: value(p)[i], point, direction, slope, steps)
        assert np.polyfit(np.log(steps), np.log(left), 1)[0] > 1.85, (i, left)


@pytest.mark.slow
@pytest.mark.parametrize("name", PLACES)
def test_coordinates_against_central_differences(name):
    sizes, pose_a, pose_b = case(name)
    for way, step in zip(np.eye(7), [1e-6] * 3 + [1e-5] * 4, strict=True):
        direction = (np.zeros(5), way, np.zeros(7))
        at = lambda x: EVERY((sizes, pose_a + x * way, pose_b), direction, BARS[0])  # noqa: B023, E731
        wanted = (at(step)[0] - at(-step)[0]) / (2.0 * step)
        np.testing.assert_allclose(at(0.0)[1][1:7], wanted[1:7], rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_second_derivative_of_the_gap():
    """Two spheres: the Hessian of the distance of their centres."""
    gap = lambda p: spheres((0.01, 0.02), jnp.concatenate([p, jnp.asarray(TURN)]), STILL).gap  # noqa: E731
    p = np.array([0.04, 0.03, 0.02])
    away = np.linalg.norm(p)
    exact = (np.eye(3) - np.outer(p, p) / away**2) / away
    np.testing.assert_allclose(jax.jit(jax.hessian(gap))(jnp.asarray(p)), exact, atol=1e-10)


@pytest.mark.slow
def test_vmap_is_a_loop():
    poses = np.stack([case(name)[1] for name in PLACES])
    sizes, _, pose_b = case("apart")
    many = jax.vmap(lambda p: meet(sizes, p, pose_b))(poses)
    for i, pose in enumerate(poses):
        one = meet(sizes, pose, pose_b)
        assert one.result == SUCCESS and bool((many.result == SUCCESS)[i])
        np.testing.assert_allclose(many.gap[i], one.gap, atol=1e-16)
        np.testing.assert_allclose(many.at_a[i], one.at_a, atol=1e-14)
        np.testing.assert_allclose(many.at_b[i], one.at_b, atol=1e-14)


@pytest.mark.parametrize(
    ("pair", "options", "words"),
    [
        ((Plane(), Cylinder(0.01)), {}, "a or b must be a bounded surface, but they were Plane and Cyl"),
        ((Sphere(0.01), 0.01), {}, "argument b must be a surface"),
        ((Sphere(0.01), Plane()), {"pose_a": (0.0, 1.0)}, r"argument pose_a must have shape \(7\)"),
        ((Sphere(0.01), Plane()), {"pose_b": np.zeros(7)}, "argument pose_b must end with a quaternion"),
        ((Sphere(0.01), Plane()), {"samples": 4}, "samples must be a whole number of at least 16"),
        ((Sphere(0.01), Plane()), {"candidates": 0}, "candidates must be a whole number of at least 1"),
    ],
)  # fmt: skip
def test_bad_arguments_say_what_they_must_be(pair, options, words):
    with pytest.raises(ValueError, match=words):
        locate_surfaces(*pair, **options)


@pytest.mark.parametrize("gap", [0.0, 0.001, -0.0001])
def test_gradient_of_the_gap_is_one_along_the_normal_where_surfaces_touch_too(gap):
    """A ball of 12 mm on top of a lens."""
    ball = posed((0.0, 0.0, 0.023 + gap))
    (slope, _), found = slopes_and_met_of(np.full(3, 0.012), (0.04, 0.03, 0.011), ball, STILL)
    np.testing.assert_allclose((found.gap, slope[2]), (gap, 1.0), atol=1e-12)


BESIDE = np.array(
    [posed((0.05, 0.03, 0.01)), posed((-0.012, 0.026, 0.015), TURN[::-1]), posed((0.0, -0.03, 0.021), -TURN)]
)


PAIRS = {
    "spheres": (Sphere(0.01), Sphere(0.02)),
    "sphere and ellipsoid": (Sphere(0.01), Ellipsoid(0.03, 0.02, 0.012)),
    "plane and ellipsoid": (Plane(), Ellipsoid(0.03, 0.02, 0.012)),
    "ellipsoid and torus": (Ellipsoid(0.015, 0.01, 0.008), Torus(0.03, 0.01)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PAIRS)
def test_single_precision_finds_what_double_precision_finds(name):
    """A batch of poses."""
    many = jax.vmap(lambda a, b, pose: locate_surfaces(a, b, pose_a=pose), (None, None, 0))
    found, single = many(*PAIRS[name], BESIDE), in_single(many, *PAIRS[name], BESIDE)
    assert single.gap.dtype == jnp.float32 and np.all(np.asarray(found.result == SUCCESS))
    assert np.all(np.asarray(single.result == SUCCESS))
    np.testing.assert_allclose(single.gap, found.gap, rtol=0, atol=3e-8)
    np.testing.assert_allclose(single.points, found.points, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(single.unique, found.unique)
    np.testing.assert_array_equal(single.others.there, found.others.there)


@pytest.mark.parametrize("lowest", [-3.0, -1e-4, 1e-3, 0.5])
def test_steps_of_a_search_go_downhill(lowest):
    """A second derivative that falls is reflected, about a thousandth of the largest: both then rise."""
    turned = np.array([[0.8, -0.6], [0.6, 0.8]])
    form, slope = turned @ np.diag([lowest, 2.0]) @ turned.T, np.array([0.3, -0.7])
    least = 1e-3 * max(abs(lowest), 2.0)
    more = 2.0 * (least - lowest) if lowest < least else 0.0
    wanted = -np.linalg.solve(form + more * np.eye(2), slope)
    found = _downhill(TangentForm(form[0, 0], form[0, 1], form[1, 1]), tuple(slope))
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    assert slope @ wanted < 0.0


def test_two_spheres_in_single_precision():
    for pose in BESIDE:
        found = in_single(spheres, (np.array(0.01), np.array(0.02)), pose, STILL)
        away = np.linalg.norm(pose[:3])
        assert found.gap.dtype == jnp.float32 and found.result == SUCCESS and bool(found.unique)
        assert abs(float(found.gap) - (away - 0.03)) <= 1e-8 and int(found.others.count) == 0
        np.testing.assert_allclose(found.points[1], 0.02 * pose[:3] / away, rtol=0, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("both", [True, False])
def test_rounded_poses_of_shapes_in_double_precision(both):
    pose = BESIDE[1].astype(np.float32)
    still = STILL.astype(np.float32) if both else STILL
    single, found = spheres((0.01, 0.02), pose, still), spheres((0.01, 0.02), BESIDE[1], STILL)
    assert single.result == SUCCESS and abs(float(single.gap - found.gap)) <= 3e-8
