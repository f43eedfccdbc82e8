"""Closest points of two contours: closed forms, brute force, derivatives, ends, second contacts."""

import functools
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import jaxroll as jxr
from jaxroll._closing import _close
from jaxroll._linalg import Vec2
from jaxroll.contact import locate
from jaxroll.contact.locating._candidates import _lone, Feet, feet, minima
from tests.helpers import in_single, slow_among
from tests.measures import both_ways, taylor_remainders
from tests.oracles.closed_forms_space import quaternion_matrix
from tests.oracles.outlines import gap_by_brute_force, KINDS, placed_points, points_of
from tests.recorded import runs
from tests.subjects.polar_contours import compiled_search, Polar, random_pairs

SUCCESS = jxr.RESULTS.successful
# Vertices of the polygons lie on the curves; between them both bend away by this much [m].
POLYGON = 2e-7


def compare(kinds, count, seed):
    """Locate `count` random pairs and compare every gap with that of 10^4-vertex polygons."""
    search = compiled_search(kinds)
    rng, place = np.random.default_rng(seed), lambda *given: search(*given)[0]
    shapes, pose_a, pose_b = random_pairs(rng, kinds, count, place)
    _, found = search(shapes, pose_a, pose_b, np.zeros((2, count)))
    errors = []
    for i in range(count):
        outlines = [
            placed_points(points_of(kind, [x[i] for x in shape], 10_000), pose[i])
            for kind, shape, pose in zip(kinds, shapes, (pose_a, pose_b), strict=True)
        ]
        errors.append(float(found.gap[i]) - gap_by_brute_force(*outlines)[0])
    return found, np.array(errors)


def check_all(found, errors):
    assert np.all(np.asarray(found.result == SUCCESS))
    assert np.abs(errors).max() <= POLYGON
    assert float(found.residual.max()) <= 1e-12
    gap = np.asarray(found.gap)
    assert 0.3 < np.mean(gap < -1e-9) < 0.4 and np.mean(gap > 1e-3) > 0.2


@pytest.mark.slow
def test_no_pair_is_missed():
    check_all(*compare(("polar", "polar"), 240, seed=1))


@pytest.mark.slow
@pytest.mark.parametrize("kinds", KINDS)
def test_no_pair_is_missed_among_many(kinds):
    check_all(*compare(kinds, 2500, seed=2))


def test_the_search_by_brute_force_sees_a_wrong_gap():
    """The oracle on two circles, apart and overlapping."""
    u = np.arange(10_000) * (2 * np.pi / 10_000)
    circle = np.stack([np.cos(u), np.sin(u)], -1)
    for distance in (0.05, 0.03, 0.025):
        gap, vertex = gap_by_brute_force(0.01 * circle + np.array([distance, 0.0]), 0.02 * circle)
        assert abs(gap - (distance - 0.03)) <= 1e-8
        assert abs(vertex - 5000) <= 1


@jax.jit
def circles(radii, pose_a, pose_b):
    return locate(jxr.Circle(radii[0]), jxr.Circle(radii[1]), pose_a=pose_a, pose_b=pose_b)


@pytest.mark.parametrize("offset", [(0.05, 0.02), (0.018, 0.024), (0.02, -0.01), (0.0, 0.012)])
def test_two_circles(offset):
    pose_a, pose_b = np.array([*offset, 0.4]) + np.array([0.1, -0.2, 0.0]), np.array([0.1, -0.2, -2.0])
    found = circles((0.01, 0.02), pose_a, pose_b)
    away = np.hypot(*offset)
    normal = np.asarray(offset) / away
    assert found.result == SUCCESS and bool(found.unique) and int(found.others.count) == 0
    np.testing.assert_allclose(float(found.gap), away - 0.03, atol=1e-15)
    np.testing.assert_allclose(found.normal, normal, atol=1e-13)
    np.testing.assert_allclose(found.points[0], pose_a[:2] - 0.01 * normal, atol=1e-15)
    np.testing.assert_allclose(found.points[1], pose_b[:2] + 0.02 * normal, atol=1e-15)
    assert bool(found.penetrating) == (float(found.gap) < 0.0) and float(found.residual) <= 1e-15
    angle = np.arctan2(normal[1], normal[0])
    np.testing.assert_allclose(float(found.s[0]), 0.01 * ((angle + np.pi - 0.4) % (2 * np.pi)), atol=1e-14)
    np.testing.assert_allclose(float(found.s[1]), 0.02 * ((angle + 2.0) % (2 * np.pi)), atol=1e-14)


def test_concentric_circles_are_not_unique():
    found = circles((0.01, 0.02), np.zeros(3), np.zeros(3))
    assert not bool(found.unique)
    np.testing.assert_allclose(float(found.gap), -0.01, atol=1e-15)


def test_overlap_without_a_single_nearest_point_is_reported():
    """A circle about an ellipse's centre: its deepest points lie as near to both of the long sides."""
    found = locate(jxr.Circle(0.004), jxr.Ellipse(0.03, 0.012, cells=256))
    assert found.result == jxr.RESULTS.too_deep and not bool(found.unique)
    exact = -0.012 * np.sqrt(1.0 - 0.004**2 / (0.03**2 - 0.012**2))
    np.testing.assert_allclose(float(found.gap), exact, atol=2e-4)


def test_circle_and_ellipse():
    """Against the distance of a point from an ellipse by scalar minimisation."""
    a, b, centre = 0.03, 0.012, np.array([0.025, 0.03])
    away = lambda u: np.hypot(a * np.cos(u) - centre[0], b * np.sin(u) - centre[1])  # noqa: E731
    best = minimize_scalar(away, bounds=(0.0, np.pi / 2), method="bounded", options={"xatol": 1e-12})
    pose = (*centre, 0.3)
    for radius in (0.01, float(best.fun), 0.024):
        found = locate(jxr.Circle(radius), jxr.Ellipse(a, b, cells=256), pose_a=pose)
        np.testing.assert_allclose(float(found.gap), best.fun - radius, atol=1e-14)
        assert found.result == SUCCESS and bool(found.unique)


NODES = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
LOBES = 0.02 * (1.0 + 0.25 * np.cos(3 * NODES))[:, None] * np.stack([np.cos(NODES), np.sin(NODES)], axis=-1)


def test_circle_in_a_notch_touches_twice():
    """Three lobes; a circle on the axis of a notch is as close to both flanks."""
    trefoil = jxr.Spline(LOBES).prepared()
    at = np.pi / 3  # the middle of a notch
    found = locate(jxr.Circle(0.012), trefoil, pose_a=(0.032 * np.cos(at), 0.032 * np.sin(at), 0.0))
    assert found.result == SUCCESS and not bool(found.unique) and int(found.others.count) == 1
    np.testing.assert_allclose(float(found.others.gap[0]), float(found.gap), atol=1e-14)
    # Beyond those that there are, entries are as the docstring says.
    assert np.isinf(found.others.gap[1:]).all() and not np.any(found.others.s[1:])
    length = float(trefoil.domain()[1])
    middle = float(found.s[1] + found.others.s[0, 1]) / 2
    np.testing.assert_allclose(middle, length / 6, atol=1e-12)
    assert abs(float(found.s[1]) - middle) > 1e-3
    # Turned a little, one flank is closer.
    turned = locate(
        jxr.Circle(0.012), trefoil, pose_a=(0.032 * np.cos(at + 0.02), 0.032 * np.sin(at + 0.02), 0.0)
    )
    assert bool(turned.unique) and float(turned.others.gap[0]) > float(turned.gap) + 1e-5


LINE = jxr.Line((-0.01, 0.02))


@jax.jit
def line_and_slope(pose, last):
    """Where a circle is nearest to a line up to `last`, and the derivative of the gap in that."""

    def met(last):
        found = locate(jxr.Circle(0.02), jxr.Line(jnp.stack([jnp.asarray(-0.01), last])), pose_b=pose)
        return found.gap, found

    _, slope, found = jax.jvp(met, (last,), (1.0,), has_aux=True)
    return found, slope


@pytest.mark.parametrize(
    ("pose", "gap", "s"),
    [
        ((0.05, 0.0, np.pi), 0.03, 0.0),  # faces the circle
        ((0.05, 0.05, np.pi), np.hypot(0.05, 0.03) - 0.02, 0.02),  # its last point is closest
        ((0.05, -0.04, np.pi), np.hypot(0.05, 0.03) - 0.02, -0.01),
        ((0.015, 0.0, np.pi), -0.005, 0.0),
    ],
)
def test_line_with_ends_and_circle(pose, gap, s):
    alone = locate(LINE, jxr.Circle(0.02), pose_a=pose)
    for swapped, found in ((False, alone), (True, line_and_slope(pose, 0.02)[0])):
        np.testing.assert_allclose(float(found.gap), gap, atol=1e-14)
        np.testing.assert_allclose(float(found.s[int(swapped)]), s, atol=1e-14)
        assert found.result == SUCCESS and bool(found.unique)


def test_two_lines_by_their_ends():
    other = jxr.Line((-0.01, 0.03))
    found = locate(LINE, other, pose_a=(0.05, 0.05, np.pi - 0.4))
    points = [np.array([0.05, 0.05]) + 0.02 * np.array([-np.sin(0.4), -np.cos(0.4)]), np.array([0.0, 0.03])]
    np.testing.assert_allclose(found.points[0], points[0], atol=1e-15)
    gap = np.hypot(points[0][0], max(points[0][1] - 0.03, 0.0))
    np.testing.assert_allclose(float(found.gap), gap, atol=1e-15)
    np.testing.assert_allclose(np.asarray(found.s), [0.02, min(points[0][1], 0.03)], atol=1e-15)


def measure(parameters):
    """Gap and arclengths as functions of shapes and poses."""
    sizes, cosines, pose_a, pose_b = parameters
    a = jxr.Ellipse(sizes[0], sizes[1], cells=128)
    b = Polar(sizes[2], cosines, jnp.zeros(3), cells=128)
    found = locate(a, b, pose_a=pose_a, pose_b=pose_b, samples=64)
    return jnp.stack([1e2 * found.gap, 1e2 * found.s[0], 1e2 * found.s[1], found.normal[1]])


@pytest.mark.slow
@pytest.mark.parametrize(
    "reach",
    [pytest.param(0.055, marks=pytest.mark.optimised, id="apart"), pytest.param(0.037, id="overlapping")],
)
def test_derivatives_in_shapes_and_poses(reach):
    """Taylor remainders of gap, arclengths and normal fall as the square of the step; both modes agree."""
    point = (
        jnp.array([0.02, 0.012, 0.02]),
        jnp.array([0.02, 0.1, 0.12]),
        jnp.array([reach, 0.012, 0.6]),
        jnp.array([0.003, -0.002, -0.3]),
    )
    rng = np.random.default_rng(0)
    direction = jax.tree.map(lambda x: jnp.asarray(rng.standard_normal(x.shape)) * 0.02, point)
    every, bars = both_ways(measure), np.eye(4)
    value = lambda point: every(point, direction, bars[0])[0]  # noqa: E731
    assert float(value(point)[0]) * (reach - 0.045) > 0
    _, slope, _ = every(point, direction, bars[0])
    steps = np.array([1e-1, 1e-2, 1e-3])
    for i in range(4):
        left = taylor_remainders(lambda p, i=i: value(p)[i], point, direction, slope[i], steps)
        np.testing.assert_allclose(np.polyfit(np.log(steps), np.log(left), 1)[0], 2.0, atol=0.15)
    rows = [every(point, direction, bar)[2] for bar in bars]
    again = [sum(x @ d for x, d in zip(row, direction, strict=True)) for row in rows]
    np.testing.assert_allclose(again, slope, rtol=1e-10)


@pytest.mark.slow
def test_second_derivative_of_the_gap():
    """Two circles: the Hessian of the distance of their centres."""
    gap = lambda p: circles((0.01, 0.02), jnp.array([p[0], p[1], 0.3]), jnp.zeros(3)).gap  # noqa: E731
    p = jnp.array([0.04, 0.03])
    away, unit = 0.05, np.array([0.8, 0.6])
    np.testing.assert_allclose(jax.grad(gap)(p), unit, atol=1e-14)
    exact = (np.eye(2) - np.outer(unit, unit)) / away
    np.testing.assert_allclose(jax.hessian(gap)(p), exact, atol=1e-11)


def test_derivative_at_an_end():
    """The end follows its line's domain."""
    slope = line_and_slope((0.05, 0.05, np.pi), 0.02)[1]
    np.testing.assert_allclose(slope, -0.03 / np.hypot(0.05, 0.03), rtol=1e-12)


@pytest.mark.slow
def test_derivatives_of_the_lowest_sample_where_no_pair_is_the_answer():
    """A disc pressed in beyond the centres of curvature: a start for `close`, and so is its derivative."""
    face = jxr.Catenary(0.01, (-0.03, 0.03))

    @jax.jit
    def both(angle, rate):
        def found(angle):
            pose = jnp.stack([0.02 * angle, -0.003 + 0.01 * angle, angle])
            at = locate(jxr.Circle(0.02), face, pose_a=pose, samples=32, candidates=1)
            return at.s, at.result

        return jax.jvp(lambda x: found(x)[0], (angle,), (rate,)), found(angle)[1]

    h = 1e-5
    (low, _), (high, _) = (both(angle, 1.0)[0] for angle in (0.4 - h, 0.4 + h))
    (_, slope), code = both(0.4, 1.0)
    assert code == jxr.RESULTS.too_deep and abs(slope[1]) > 1e-3
    np.testing.assert_allclose(slope, (high - low) / (2.0 * h), rtol=1e-6, atol=1e-9)


def test_feet_beyond_an_open_contour_are_its_ends():
    """Of a line from -1 to 2 along y: whichever sample is nearest, and however few there are."""
    line = jxr.Line((-1.0, 2.0)).prepared()
    points = Vec2(np.array([0.3, 0.3, -0.3, 0.4]), np.array([-5.0, 1.2, 1.9, 6.0]))
    search = jax.jit(lambda s, near: feet(line, s, points, near))
    for count in (2, 3, 7):
        s = np.linspace(-1.0, 2.0, count)
        for near in (0, count - 1):
            found = search(s, np.full(4, near))
            np.testing.assert_allclose(found.s, [-1.0, 1.2, 1.9, 2.0], atol=1e-15)
            assert found.ended.tolist() == [True, False, False, True]
            ends = np.hypot([0.3, 0.4], 4.0)
            np.testing.assert_allclose(np.abs(found.distance), [ends[0], 0.3, 0.3, ends[1]], atol=1e-15)


def test_bad_arguments_raise_one_sentence():
    circle = jxr.Circle(0.01)
    with pytest.raises(ValueError, match="argument b must have ends or be closed, but was an endless Line"):
        locate(circle, jxr.Line())
    with pytest.raises(ValueError, match="argument pose_a must have shape"):
        locate(circle, circle, pose_a=(0.0, 1.0))
    with pytest.raises(ValueError, match="argument samples must be a whole number of at least 8"):
        locate(circle, circle, samples=4)
    with pytest.raises(ValueError, match="argument a must be a contour"):
        locate(0.01, circle)


def test_few_candidates_are_the_minima_and_not_what_lies_beside_them():
    """A distance with two dips that falls towards both ends of an open contour has these four minima."""
    s, number = np.linspace(0.0, 0.027, 28), 2.0 * np.pi / 0.012
    distance, rate = 1e-3 * np.cos(number * s) + 0.01 * s, 0.01 - 1e-3 * number * np.sin(number * s)
    feet = Feet(0.0 * s, distance, Vec2(0.0 * s, 0.0 * s + 1.0), np.zeros(s.shape, bool))
    found = jax.jit(lambda feet: minima(s, feet, rate, turn=np.inf, closed=False, count=4))(feet)
    dip = 0.006 - np.arcsin(0.01 / (1e-3 * number)) / number
    np.testing.assert_allclose(found.s[0], [dip, dip + 0.012, 0.027, 0.0], atol=2e-5)


lone = jax.jit(_lone, static_argnums=3)


@pytest.mark.parametrize("way", [1, -1])
def test_a_sample_is_a_minimum_beside_two_higher_ones_unless_its_cell_is_one(way):
    """Round a closed contour, whose last sample is the first again, and along an open one."""
    value, none = np.array([3.0, 1.0, 2.0, 4.0, 2.5, 3.0])[::way], np.zeros(5, bool)
    rate = np.array([-1.0, 1.0, 1.0, 0.0, 1.0, 1.0])
    where = lambda *args: np.flatnonzero(lone(value, rate, *args)).tolist()  # noqa: E731
    dips = np.arange(5) == (0 if way > 0 else 4)
    assert where(none, True) == [1, 4] == where(none, False)
    assert where(dips, True) == ([4] if way > 0 else [1]) == where(dips, False)
    rate = -rate  # at the ends of an open contour: now the distance falls towards them
    assert where(none, False) == [0, 1, 4, 5]


def disc_on_finger():
    finger = jxr.Finger([0.065, 0.065], [0.045, 0.040], tip=jxr.Ellipse(0.012, 0.008, cells=128))
    disc = jxr.PivotedObject(jxr.Circle(0.02), inertia=1e-5, pivot=(0.03, 0.09))
    return jxr.Grasp(disc, finger, jxr.Contact())


def test_contacts_go_to_the_closest_points_of_their_shapes_at_the_guess(monkeypatch):
    """Each pair of shapes is asked for at the poses of fingertip and object, in this order."""
    asked = []

    def answer(a, b, *, pose_a, pose_b):
        asked.append((type(a), type(b), np.asarray(pose_a), np.asarray(pose_b)))
        k = float(len(asked))
        return SimpleNamespace(s=(k, -k), at_a=jnp.array([k, 1.0, 2.0]), at_b=jnp.array([-k, 3.0, 4.0]))

    monkeypatch.setattr(_close, "locate_contours", answer)
    monkeypatch.setattr(_close, "locate_surfaces", answer)
    guess = jxr.State(jnp.array([0.3, 0.5, 1.2]), jnp.array([1.0, 2.0, 3.0]), jnp.array([0.004]))
    located, state = _close._at_closest_points(disc_on_finger(), guess)
    tip, body = asked[0][2:]
    np.testing.assert_allclose(body, [0.03, 0.09, 0.3])
    ends = 0.065 * (np.exp(0.5j) + np.exp(1.7j))
    np.testing.assert_allclose(tip, [ends.real, ends.imag, 1.7])
    assert asked[0][:2] == (jxr.Ellipse, jxr.Circle)
    contact = located.contacts[0]
    assert (float(contact.s_tip), float(contact.s_object), float(state.s[0])) == (1.0, -1.0, 0.0)
    np.testing.assert_array_equal(state.v, guess.v)
    grasp, start = runs.scene("pinch3d")
    asked.clear()
    located, state = _close._at_closest_points(grasp, start)
    assert located is grasp and len(asked) == 2
    np.testing.assert_array_equal(state.s, [1, 1, 2, -1, 3, 4, 2, 1, 2, -2, 3, 4])
    np.testing.assert_allclose(asked[1][3], start.q[:7])
    # At these poses of fingertip and object their surfaces meet at the places that the state has.
    placed = lambda pose, point: pose[:3] + quaternion_matrix(pose[3:]) @ np.asarray(point)  # noqa: E731
    for i, (s, (_, _, tip, body)) in enumerate(zip(np.reshape(start.s, (2, 6)), asked, strict=True)):
        touching, held = grasp.shapes(grasp.contacts[i])
        met = placed(body, held.point(s[3:]))
        np.testing.assert_allclose(placed(tip, touching.point(s[:3])), met, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(state.q, start.q)
    endless = disc_on_finger().with_tip(0, jxr.Line())
    with pytest.raises(
        ValueError, match="argument locate must be False for endless contours, as those of co"
    ):
        _close._at_closest_points(endless, guess)


@pytest.mark.slow
def test_close_locates_the_contacts():
    """From a guess whose arclengths are far off."""
    grasp = disc_on_finger()
    guess = jxr.State(jnp.array([0.3, 0.5, 1.2]), jnp.zeros(3), jnp.array([0.004]))
    closed, state = jxr.close(grasp, guess, locate=True)
    left = jxr.residuals(closed, state)
    for rows in (left.normal, left.tangential, left.tangency):
        assert float(jnp.abs(rows).max()) <= 1e-13
    assert float(jnp.abs(state.q - guess.q).max()) < 0.5
    contact = closed.contacts[0]
    assert abs(float(contact.s_tip)) > 1e-3 and abs(float(state.s[0])) < 0.02
    with pytest.raises(ValueError, match="argument locate must be False for endless contours"):
        jxr.close(grasp.with_tip(0, jxr.Line()), guess, locate=True)


AROUND = np.array(
    [[0.05, 0.03, 0.3], [0.012, 0.026, 1.0], [-0.035, 0.014, 2.5], [0.016, 0.016 * 3**0.5, 0.0]]
)
ROUNDED = jxr.SupportFunction(0.02, (0.0, 0.002, 0.0004), (0.0, 0.0, 0.0003))
PAIRS = {
    "circle and ellipse": (jxr.Circle(0.01), jxr.Ellipse(0.03, 0.012, cells=256)),
    "circle and spline": (jxr.Circle(0.012), jxr.Spline(LOBES)),
    "line and support function": (LINE, ROUNDED),
}


@jax.jit
@functools.partial(jax.vmap, in_axes=(None, None, 0))
def many_poses(a, b, pose):
    return locate(a, b, pose_a=pose)


@pytest.mark.parametrize("name", slow_among(PAIRS, "circle and spline", "line and support function"))
def test_single_precision_finds_what_double_precision_finds(name):
    """A batch of poses; in the last one the circle is as close to both flanks of a notch."""
    alone = [locate(*PAIRS[name], pose_a=pose) for pose in AROUND]
    found = jax.tree.map(lambda *rows: np.stack(rows), *alone)
    single = in_single(many_poses, *PAIRS[name], AROUND)
    assert single.gap.dtype == jnp.float32 and np.all(np.asarray(found.result == SUCCESS))
    assert np.all(np.asarray(single.result == SUCCESS))
    np.testing.assert_allclose(single.gap, found.gap, rtol=0, atol=3e-8)
    np.testing.assert_array_equal(single.unique, found.unique)
    np.testing.assert_array_equal(single.others.there, found.others.there)
    assert bool(single.unique[-1]) != (name == "circle and spline")
    # Of two equal gaps either may be the lowest.
    points = np.abs(np.asarray(single.points - found.points))[np.asarray(found.unique)]
    assert points.max() <= 1e-6


def test_concentric_circles_are_not_unique_in_single_precision():
    """Curvatures that cancel but for rounding; one of the circles is an ellipse of equal half axes."""
    turns = np.array([[0.0, 0.0, angle] for angle in (-0.7, 0.0, 0.3, 2.0)])
    found = in_single(many_poses, jxr.Circle(0.01), jxr.Ellipse(0.02, 0.02, cells=256), turns)
    assert np.all(found.result == SUCCESS) and not np.any(found.unique)
    np.testing.assert_allclose(found.gap, -0.01, rtol=0, atol=1e-8)
