"""Pieces of the search for closest points: samples, feet, minima, and which of them is the answer."""

import functools
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._linalg import Pose2, Pose3, Vec2, Vec3
from jaxroll.contact.locating import _candidates, _clearance, _links, _location, _location3, _pair3, _samples3
from jaxroll.geometry import Frenet2

RESULTS = jxr.RESULTS


def pose(x, y, angle):
    return Pose2(Vec2(jnp.asarray(x), jnp.asarray(y)), jnp.cos(angle), jnp.sin(angle))


def ways(*angles):
    """Unit vectors of the plane."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


# Samples and feet in the plane.


def test_points_of_the_world_in_the_frame_of_a_body():
    body, point = pose(0.3, -0.2, 0.7), np.array([0.5, 0.4])
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    np.testing.assert_allclose(_candidates.into(body, Vec2(*point)).array(), turn.T @ (point - [0.3, -0.2]))
    other = _location._relative(pose(0.5, 0.4, 1.9), body)
    np.testing.assert_allclose(other.origin.array(), turn.T @ (point - [0.3, -0.2]))
    np.testing.assert_allclose((other.cos, other.sin), (np.cos(1.2), np.sin(1.2)))


@pytest.mark.parametrize("count", [5, 16, 37])
def test_the_nearest_sample_is_found_however_many_there_are(count):
    rng = np.random.default_rng(count)
    samples, points = rng.normal(size=(count, 2)), rng.normal(size=(50, 2))
    points[:2] = samples[[0, -1]] + 1e-3
    wanted = np.argmin(np.linalg.norm(points[:, None] - samples, axis=2), axis=1)
    both = jax.jit(lambda *given: (_candidates.nearest_dense(*given), _candidates.nearest_blocked(*given)))
    assert wanted[:2].tolist() == [0, count - 1]
    for found in both(Vec2(*samples.T), Vec2(*points.T)):
        np.testing.assert_array_equal(found, wanted)


def test_feet_on_an_arc_are_to_second_order_and_beyond_its_ends_the_ends():
    """Of a circle of radius 2, whose feet are known, from places up to 0.1 rad off."""
    toward = jax.jit(
        lambda face, ends, at, points: _candidates.toward(face, ends, (at, face.frame(at)), points)
    )
    angles, heights, off = np.array([0.3, 2.0, 4.0, 5.5]), np.array([0.5, -0.8, 1.5, -0.7]), 0.02
    # The last point is beyond the centre, where a step is cut: twice along the tangent what is aside there.
    at = 2.0 * np.append(angles + off * np.array([1.0, -1.0, 0.5, 1.0]), 0.3)
    points = np.concatenate([(2.0 + heights)[:, None] * ways(*angles), -0.5 * ways(0.3 + 1.0)])
    found = toward(jxr.Circle(2.0).prepared(), (0.0, 4.0 * np.pi), at, Vec2(*points.T))
    aside = -0.5 * np.sin(1.0)
    np.testing.assert_allclose(found.s[:4], 2.0 * angles, atol=2e-3)
    np.testing.assert_allclose(found.distance[:4], heights, atol=2e-4)
    np.testing.assert_allclose(np.stack([*found.slope], axis=1)[:4], ways(*angles), atol=2e-3)
    np.testing.assert_allclose(
        (found.s[4], found.distance[4]), (0.6 + 2.0 * aside, -0.5 * np.cos(1.0) - 2.0 + 0.5 * aside**2)
    )
    assert not found.ended.any()
    line = jxr.Line((-1.0, 2.0)).prepared()
    points = Vec2(np.array([0.3, -0.4, 0.0, -0.6]), np.array([-1.4, 2.3, 2.0, 2.0]))
    found = toward(line, (-1.0, 2.0), np.array([-1.0, 2.0, 2.0, 2.0]), points)
    np.testing.assert_allclose(found.s, [-1.0, 2.0, 2.0, 2.0])
    # At the end itself the distance has the sign of its side.
    normal = float(line.frame(jnp.zeros(())).tangent.right().x)
    np.testing.assert_allclose(found.distance, [0.5, 0.5, 0.0, -0.6 * normal], atol=1e-15)
    np.testing.assert_allclose(np.stack([*found.slope], 1)[:2], [[0.6, -0.8], [-0.8, 0.6]])


@jax.jit
@functools.partial(jax.vmap, in_axes=(None, None, 0, 0))
def overlap(tip, face, u, w):
    """How deep a fingertip is in a face against which it is laid from outside, at shares of both lengths."""
    s, z = (ends[0] + (ends[1] - ends[0]) * x for ends, x in ((tip.domain(), u), (face.domain(), w)))
    at, on = tip.frame(s), face.frame(z)
    # The tangents are opposite, the points the same.
    cos, sin = -at.tangent.dot(on.tangent), -at.tangent.cross(on.tangent)
    turned = Pose2(Vec2(0.0, 0.0), cos, sin)
    place = Pose2(on.point - turned.turn(at.point), cos, sin)
    still = Pose2(Vec2(jnp.zeros(()), jnp.zeros(())), jnp.ones(()), jnp.zeros(()))
    return -_clearance.clearance((place, still), tip, [face], samples=64)


@pytest.mark.parametrize(
    ("tip", "face"),
    [
        (jxr.Ellipse(0.01, 0.02), jxr.Line((-0.1, 0.1))),
        # Circles as ellipses: one program for all three.
        (jxr.Ellipse(0.01, 0.01), jxr.Ellipse(0.015, 0.025)),
        (jxr.Ellipse(0.01, 0.05), jxr.Ellipse(0.01, 0.01)),
        # The tip's samples are further apart than the face is wide.
        (jxr.Ellipse(1.0, 1.0), jxr.Ellipse(0.01, 0.01)),
        (jxr.Catenary(1 / 40, (-0.03, 0.03)), jxr.Ellipse(1.5, 2.5)),
    ],
)
def test_shapes_that_touch_do_not_overlap(tip, face):
    """A fingertip laid against a face from outside, wherever both are touched: to rounding."""
    u, w = np.random.default_rng(0).uniform(0.1, 0.9, (2, 200))
    # With their tables as they are in a run, made before.
    assert np.asarray(overlap(tip.prepared(), face.prepared(), u, w)).max() <= 1e-14


def test_a_foot_counts_if_its_last_step_is_small_beside_the_whole_contour():
    """A point beside an ellipse, whose foot one step leaves millionths of the contour away, or far more."""
    tip, face = jxr.Circle(0.01), jxr.Ellipse(0.02, 0.03)
    low, high = map(float, face.domain())
    s, length, middle = np.linspace(low, high, 200_001), high - low, -0.5 * (low + high)
    there = jax.jit(lambda s: (tip.frame(0.0).point.array(), face.frame(s).point.array()))
    own, points = map(np.asarray, there(s))
    away = np.linalg.norm(points - own - np.array([0.05, 0.01]), axis=1)
    exact = s[np.argmin(away)]

    @jax.jit
    def apart(ends, start):
        poses = pose(0.05, 0.01, 0.0), pose(0.0, 0.0, 0.0)
        return _clearance._apart(poses, tip, (jnp.zeros(()), [(face, ends, start)]))

    for off, found in ((1e-3, True), (0.2, False)):
        told = float(apart((low, high), exact + off * length))
        assert told == pytest.approx(away.min(), rel=1e-6) if found else np.isinf(told)
        assert float(apart((low + middle, high + middle), exact + off * length)) == told


def test_a_dip_is_placed_by_its_rates_and_bounded_by_its_tangents():
    """A distance (s - 0.23)^2 over cells of 0.1, of which the foot moves half as far the other way."""
    s = np.linspace(0.0, 0.6, 7)
    value, rate = (s - 0.23) ** 2 + 0.5, 2.0 * (s - 0.23)
    program = jax.jit(lambda feet, turn: _candidates.minima(s, feet, rate, turn=turn, closed=False, count=2))
    feet = _candidates.Feet((1.0 - 0.5 * s) % 0.95, value, Vec2(0.0 * s, 1.0 + 0.0 * s), s < 0.0)
    for turn, hop in ((0.95, -0.05), (np.inf, -0.05)):
        found = program(feet, turn)
        np.testing.assert_allclose(found.s[0], [0.23, 0.0])
        np.testing.assert_allclose(found.s[1], [0.885, 0.05], atol=1e-12)
        # Tangents at 0.2 and at 0.3 meet in between, below the curve.
        np.testing.assert_allclose(found.bound, [0.5009 - 0.06 * 0.05, np.inf])
        np.testing.assert_allclose(found.reach[0], [0.1, 0.1])
        np.testing.assert_allclose(found.reach[1], [0.1 + abs(hop), 0.1])
    # Where the foot crosses the seam of the other contour, it moves the shorter way.
    feet = _candidates.Feet((0.12 - 0.5 * s) % 0.95, value, feet.slope, feet.ended)
    found = program(feet, 0.95)
    np.testing.assert_allclose((found.s[1][0], found.reach[1][0]), (0.02 - 0.015, 0.15), atol=1e-12)


def test_the_lowest_entries_are_in_order():
    found = _candidates.lowest(jnp.array([3.0, 1.0, np.inf, -2.0, 1.0]), 4)
    assert found.tolist() == [3, 1, 4, 0]


# Pairs of places of two contours.


def scene_of(a, b, at=(0.01, 0.035, 0.8)):
    a, b = a.prepared(), b.prepared()
    scale = (_location._length(a) + _location._length(b)) / (4.0 * np.pi)
    return _location._Scene(a, b, pose(*at), scale)


@functools.cache
def settled():
    """The same with the foot on `b` found by many Newton steps."""

    def found(shapes, s_a, s_b):
        scene = scene_of(*shapes)

        def step(_, s_b):
            at = _location._pairs(scene, (s_a, s_b))
            return s_b + jnp.where(at.held[1], 0.0, at.along)

        return _location._pairs(scene, (s_a, jax.lax.fori_loop(0, 12, step, s_b)))

    return jax.jit(found)


def test_slope_and_rise_of_a_pair_are_derivatives_of_its_distance():
    """At feet, with the foot following; by central differences."""
    shapes, h = (jxr.Ellipse(0.02, 0.012), jxr.Ellipse(0.03, 0.018)), 1e-5
    s_a, s_b = jnp.array([0.03, 0.07, 0.09]), jnp.array([0.04, 0.05, 0.06])
    low, found, high = (settled()(shapes, s_a + step, s_b) for step in (-h, 0.0, h))
    arm = np.stack([*found.arm], axis=1)
    np.testing.assert_allclose(np.abs(found.distance), np.linalg.norm(arm, axis=1), rtol=1e-12)
    low, here, high = (np.asarray(each.distance) for each in (low, found, high))
    np.testing.assert_allclose(found.slope, (high - low) / (2 * h), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.rise, (high - 2.0 * here + low) / h**2, rtol=1e-3)
    np.testing.assert_allclose(found.bend, 1.0 + np.asarray(found.b.curvature * found.distance))
    assert not found.held[0].any() and not found.held[1].any()


def test_from_an_end_the_distance_is_that_of_its_point():
    shapes, h = (jxr.Ellipse(0.02, 0.012), jxr.Line((-0.01, 0.012))), 1e-5
    s_a, s_b = jnp.array([0.03, 0.07]), jnp.array([0.012, 0.012])
    low, found, high = (settled()(shapes, s_a + step, s_b) for step in (-h, 0.0, h))
    low, here, high = (np.asarray(each.distance) for each in (low, found, high))
    assert found.held[1].all()
    points = np.stack([*found.a.point], axis=1)
    np.testing.assert_allclose(found.distance, np.linalg.norm(points - [0.0, 0.012], axis=1))
    np.testing.assert_allclose(found.slope, (high - low) / (2 * h), rtol=1e-6)
    np.testing.assert_allclose(found.rise, (high - 2.0 * here + low) / h**2, rtol=1e-3)


def test_a_place_is_held_at_an_end_that_it_would_go_past():
    line, disc = jxr.Line((-1.0, 2.0)), jxr.Circle(1.0)
    s, push = (
        np.array([-1.0, -1.0, -0.9, 2.0, 2.0, 1.9, -1.1, 2.1]),
        np.array([-1.0, 1, -1, 1, -1, 1, -1, 1]),
    )
    held = [True, False, False, True, False, False, True, True]
    pressing = lambda *given: [_location._pressing(*one) for one in given]  # noqa: E731
    found = jax.jit(lambda: pressing((line, s, push), (line, s, 0.0 * push), (disc, s, push)))()
    assert found[0].tolist() == held and not found[1].any() and not found[2].any()
    first, length, apart = float(disc.domain()[0]), 2.0 * np.pi, np.array([-3.0, 0.4, 0.6, 9.0])

    @jax.jit
    def placed():
        ends = (
            _location._nearer_end(line, apart),
            _location._inside(line, apart),
            _location._inside(disc, apart),
        )
        way = np.array([0.3, 4.0, -4.0, 13.0])
        around = [_location._around(shape, way) for shape in (line, disc)]
        return ends, around, [_location._wrapped(shape, first + way) for shape in (line, disc)]

    ends, around, wrapped = placed()
    for found, wanted in zip(ends, ([-1, -1, 2, 2], [-1.0, 0.4, 0.6, 2.0], apart), strict=True):
        np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(around[0], [0.3, 4.0, -4.0, 13.0])
    np.testing.assert_allclose(around[1], [0.3, 4 - length, length - 4, 13 - 2 * length])
    np.testing.assert_array_equal(wrapped[0], first + np.array([0.3, 4.0, -4.0, 13.0]))
    np.testing.assert_allclose(wrapped[1], first + np.array([0.3, 4.0, length - 4.0, 13.0 - 2 * length]))


def found_pairs(**given):
    """What was evaluated at pairs: all alike unless told otherwise."""
    ones = np.ones(len(next(iter(given.values()))))
    frame = Frenet2(Vec2(ones, 2 * ones), Vec2(0 * ones, -ones), ones)
    other = Frenet2(Vec2(3 * ones, 4 * ones), Vec2(0 * ones, ones), ones)
    known = {
        "a": frame,
        "b": other,
        "arm": Vec2(ones, 0 * ones),
        "along": ones,
        "bend": ones,
        "distance": ones,
    }
    known |= {"slope": 0 * ones, "rise": ones, "held": (ones < 0, ones < 0)}
    shown = ("a", "b", "arm", "held")
    return _location._Pairs(
        **(known | {k: v if k in shown else np.array(v, float) for k, v in given.items()})
    )


def line_scene():
    line = jxr.Line((-9.0, 9.0))
    return _location._Scene(line, line, pose(0.0, 0.0, 0.0), 2.0)


@functools.cache
def report():
    return jax.jit(
        lambda pairs, start, sample: _location._report(
            line_scene(), pose(0.5, 0.6, 0.3), pairs, (start, sample)
        )
    )


def reported(distance, s_a, fair, *, bound=None, sample=5.0, rise=None):
    """The report of pairs, of which the last is the lowest sample; one program for all."""
    n, more = len(distance) - 1, 5 - len(distance)
    filled = lambda given, value: np.array([*given[:n], *[value] * more, *given[n:]], float)  # noqa: E731
    at = found_pairs(
        distance=filled(distance, 7.0), rise=filled(np.ones(n + 1) if rise is None else rise, 1.0)
    )
    s = filled(s_a, 50.0)
    start = _candidates.Minima((s, s), (s, s), filled(np.full(n, np.inf) if bound is None else bound, np.inf))
    return report()(((s, 0.1 + s), at, filled(fair, False) > 0), start, sample)


def test_the_answer_is_the_lowest_minimum_and_the_others_follow():
    found = reported([2.0, 1.0, 1.5, 0.2, 3.0], [0.0, 1.0, 2.0, 3.0, 4.0], [True, True, True, False, False])
    assert found.result == RESULTS.successful and bool(found.unique)
    assert float(found.gap) == 1.0 and found.s.tolist() == [1.0, 1.1]
    assert found.others.there.tolist() == [True, True, False, False] and int(found.others.count) == 2
    assert found.others.gap[:2].tolist() == [1.5, 2.0] and np.isinf(found.others.gap[2:]).all()
    np.testing.assert_allclose(found.others.s, [[2.0, 2.1], [0.0, 0.1], [0.0, 0.0], [0.0, 0.0]])
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    np.testing.assert_allclose(found.points, [0.5, 0.6] + np.array([[1.0, 2.0], [3.0, 4.0]]) @ turn.T)
    np.testing.assert_allclose(found.normal, turn @ [1.0, 0.0], atol=1e-15)


def test_minima_that_are_the_same_count_once_and_equal_gaps_are_not_unique():
    """Of a scene of scale 2: places within 2e-6, gaps within 2e-9."""
    for apart, same in ((1.9e-6, True), (2.1e-6, False)):
        found = reported([1.0, 1.0, 5.0], [0.0, apart, 4.0], [True, True, False])
        assert int(found.others.count) == 1 - same and bool(found.unique) == same
    for more, unique in ((1.9e-9, False), (2.1e-9, True)):
        found = reported([1.0 + more, 1.0, 5.0], [0.0, 1.0, 4.0], [True, True, False])
        assert float(found.gap) == 1.0 and bool(found.unique) == unique
    # What is flat along the contour does not single out a pair.
    for rise, unique in ((4e-10, False), (6e-10, True)):
        assert bool(reported([1.0, 5.0], [0.0, 4.0], [True, False], rise=[rise, 1.0]).unique) == unique
    # Twins of one that is not the lowest are left out too; one that is no minimum is nobody's twin.
    found = reported([3.0, 1.0, 3.0, 1.0, 9.0], [0.0, 1.0, 0.0, 1.0, 4.0], [True, True, True, False, False])
    assert found.others.gap[:2].tolist() == [3.0, np.inf] and bool(found.unique)


@pytest.mark.parametrize("below", [1.9e-4, 2.1e-4])
def test_a_lowest_minimum_was_missed_where_a_sample_or_an_estimate_lies_below(below):
    missed = below > 2e-4
    fair = [True, False, False]
    for depth in (0.0, 3.0):
        lowest = 1.0 - depth
        sampled = reported([lowest, 7.0, lowest - below], [0.0, 1.0, 4.0], fair, sample=lowest - below)
        assert bool(sampled.result == RESULTS.successful) != missed and bool(sampled.unique) != missed
        if missed:
            assert sampled.result == (RESULTS.too_deep if depth else RESULTS.solver_failed)
            assert float(sampled.gap) == lowest - below and float(sampled.s[0]) == 4.0
            assert int(sampled.others.count) == 0
    estimated = reported([1.0, 7.0, 1.0], [0.0, 1.0, 4.0], fair, bound=[0.0, 1.0 - below], sample=1.0)
    assert bool(estimated.result == RESULTS.successful) != missed
    none = reported([1.0, 7.0, 3.0], [0.0, 1.0, 4.0], [False, False, False], sample=3.0)
    assert none.result == RESULTS.solver_failed and float(none.gap) == 3.0


def test_a_pair_is_singled_out_by_its_bends_or_by_its_ends():
    held = np.array([False, False, False, True, False]), np.array([False, False, False, False, True])
    at = found_pairs(rise=[1.0, 4e-10, -1.0, 0.0, 1.0], bend=[1.0, 1.0, 5e-10, 1.0, 0.0], held=held)
    assert _location._singled_out(line_scene(), at).tolist() == [True, False, False, True, True]


def test_what_is_left_of_the_conditions_depends_on_the_ends():
    """Of tangents turned by 0.1 rad in a scene of scale 2, and an arm of (0.3, 0.07) along both."""
    n, ones = 4, np.ones(4)
    b = Frenet2(Vec2(0 * ones, 0 * ones), Vec2(0 * ones, ones), ones)
    a = Frenet2(b.point, Vec2(0 * ones + np.sin(0.1), -np.cos(0.1) * ones), ones)
    held = np.array([False, True, False, True]), np.array([False, False, True, True])
    at = found_pairs(along=np.ones(n), a=a, b=b, arm=Vec2(0.3 * ones, 0.07 * ones), held=held)
    beside = abs(0.3 * np.sin(0.1) - 0.07 * np.cos(0.1))
    np.testing.assert_allclose(_location._residual(line_scene(), at), [2.0 * np.sin(0.1), 0.07, beside, 0.0])


@functools.cache
def newton():
    return jax.jit(
        lambda shapes, s, held: _location._newton(scene_of(*shapes, at=(0.05, 0.004, 2.9)), s, held)
    )


def test_a_step_to_closest_points_is_newtons_wherever_a_place_is_held():
    """Of two open arcs: what is left of an error is of its second order."""
    shapes = jxr.Catenary(0.02, (-0.02, 0.011)), jxr.Catenary(0.03, (-0.013, 0.02))
    held = np.array([False, False, True, True]), np.array([False, True, False, True])
    root = np.array([0.003, 0.003, 0.011, 0.011]), np.array([-0.002, -0.013, -0.006, -0.013])
    for _ in range(30):
        root = tuple(np.asarray(x) for x in newton()(shapes, root, held))
    scene = scene_of(*shapes, at=(0.05, 0.004, 2.9))
    at = jax.jit(lambda s, held: _location._pairs(scene, s, held))(root, held)
    arm, along_a, along_b = (np.stack([*x], axis=1) for x in (at.arm, at.a.tangent, at.b.tangent))
    turned = along_a[:, 0] * along_b[:, 1] - along_a[:, 1] * along_b[:, 0]
    aside = turned, np.sum(arm * along_a, axis=1), np.sum(arm * along_b, axis=1)
    np.testing.assert_allclose(root[0][2:], 0.011, atol=1e-15)
    np.testing.assert_allclose(root[1][1::2], -0.013, atol=1e-15)
    np.testing.assert_allclose([aside[0][0], aside[2][0], aside[1][1], aside[2][2]], 0.0, atol=1e-14)
    for step in ((1e-5, 0.0), (0.0, 1e-5), (1e-5, -2e-5)):
        found = newton()(shapes, (root[0] + step[0], root[1] + step[1]), held)
        for x, wanted in zip(found, root, strict=True):
            assert np.abs(x - wanted).max() < 3e-8


def test_between_parallel_lines_the_first_place_stays():
    line = jxr.Line((-0.02, 0.03)).prepared()
    scene = _location._Scene(line, line, pose(0.05, 0.004, np.pi), 0.02)
    s, held = (jnp.array([0.01]), jnp.array([0.007])), (jnp.array([False]),) * 2
    found = jax.jit(lambda s: _location._newton(scene, s, held))(s)
    np.testing.assert_allclose(np.ravel(found), [0.01, 0.004 - 0.01], atol=1e-15)


def test_pairs_are_minima_that_fit_in_every_respect():
    """Of a line with samples 0.1 apart, in a scene of scale 2: some pairs just fit, others just fail."""
    n, line = 16, jxr.Line((-1.0, 2.0)).prepared()
    ones = np.ones(n)
    side = float(line.frame(jnp.zeros(())).tangent.right().x)
    s_a, s_b, distance, rise, bend, arm = (
        0.4 * ones,
        0.3 * ones,
        0.5 * ones,
        ones.copy(),
        ones.copy(),
        0.0 * ones,
    )
    held = np.zeros((2, n), bool)
    bound, wanted = 0.0 * ones[1:], [True]
    # Not stationary, falling along the contour, beyond a centre of curvature unless the place is an end.
    arm[1:3], wanted = (1.9e-11, 2.1e-11), [*wanted, True, False]
    rise[3:6], wanted = (-4e-10, -6e-10, -6e-10), [*wanted, True, False, True]
    held[0, 5] = True
    bend[6:8], wanted = -0.1, [*wanted, False, True]
    held[1, 7] = True
    # Another place of the contour is nearer, by where it is and by how far.
    s_b[8:12], distance[8:12] = (0.324, 0.326, 0.276, 0.35), (0.6, 0.6, 0.6, 0.50009)
    wanted = [*wanted, True, False, True, True]
    s_b[12], distance[12], wanted = 0.35, 0.50011, [*wanted, False]
    # Past the end, and not one of the estimates; the last pair is no minimum.
    s_a[13], wanted = 2.0 + 2.1e-9, [*wanted, False]
    bound[14], wanted = np.inf, [*wanted, False, False]
    frame = Frenet2(Vec2(0.5 * side * ones, 0.3 * ones), Vec2(0 * ones, -ones), 0 * ones)
    other = Frenet2(Vec2(0 * ones, 0.3 * ones), Vec2(0 * ones, ones), 0 * ones)
    at = found_pairs(
        bend=bend, distance=distance, rise=rise, a=frame, b=other, arm=Vec2(0.5 * ones, arm), held=tuple(held)
    )
    start = _candidates.Minima((bound, bound), (bound, bound), bound)

    def verified(pairs):
        samples = _candidates.spread(line, 31)
        scene = _location._Scene(line, line, pose(0.0, 0.0, 0.0), 2.0)
        return _location._verified(scene, (samples, line.frame(samples)), pairs, start)

    found = jax.jit(verified)(((s_a, s_b), at))
    assert found.tolist() == wanted


# Pairs of places of two surfaces.


def test_forms_of_a_tangent_plane_are_symmetric_matrices():
    matrix, v = np.array([[0.7, -0.4], [-0.4, 0.2]]), np.array([0.3, 1.1])
    form = _pair3.TangentForm(0.7, -0.4, 0.2)
    np.testing.assert_allclose(form.apply(tuple(v)), matrix @ v)
    np.testing.assert_allclose(form.plus(0.5), [1.2, -0.4, 0.7])
    assert float(form.determinant()) == pytest.approx(-0.02)
    np.testing.assert_allclose(form.eigenvalues(), np.linalg.eigvalsh(matrix))
    np.testing.assert_allclose(form.solve(tuple(v)), np.linalg.solve(matrix, v))
    np.testing.assert_allclose(_pair3.TangentForm(1.0, 2.0, 4.0).solve((1.0, 2.0)), [0.0, 0.0])
    # Singular is what cancels to rounding of the squared size, 7 here: up to 4.9e-13 of the determinant.
    for det, firm in ((4e-13, False), (6e-13, True)):
        near = _pair3.TangentForm(jnp.asarray(1.0), jnp.asarray(2.0), jnp.asarray(4.0 + det))
        assert (float(near.solve((1.0, 0.0))[0]) != 0.0) == firm
    np.testing.assert_allclose(_location3._cut((0.3, -0.4), 0.25), [0.15, -0.2])
    np.testing.assert_allclose(_location3._cut((0.3, -0.4), 0.6), [0.3, -0.4])


def rotated(x, y, z, angle):
    """A pose turned about a slanting axis."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec(angle * np.array([0.48, 0.6, 0.64])).as_matrix()
    return Pose3(Vec3(x, y, z), *(Vec3(*column) for column in turn.T))


def test_equations_of_a_pair_are_derivatives_of_its_distance():
    """Of two ellipsoids, with the foot following, by central differences; second ones where normals meet."""
    axes = np.array([[0.02, 0.015, 0.01], [0.03, 0.022, 0.018]])
    h, unit = 1e-4, np.array([[0.6, 0.48, 0.64], [-0.36, 0.8, 0.48]])
    steps = h * np.array(
        [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [1, -1], [-1, 1], [-1, -1]], float
    )
    turned = rotated(0.0, 0.0, 0.0, 0.7)
    turn = np.stack([np.array([v.x, v.y, v.z]) for v in (turned.x, turned.y, turned.z)], axis=1)
    support = lambda axes, n: axes**2 * n / np.linalg.norm(axes * n)  # noqa: E731
    # Two places anywhere, and for two normals those of either surface, apart and inside.
    places = [*(unit * axes[0]), *(support(axes[0], -n @ turn) for n in unit)]
    origins = [np.array([0.012, 0.004, 0.02])] * 2
    for n, gap, place in zip(unit, (0.006, -0.002), places[2:], strict=True):
        origins.append(support(axes[1], n) + gap * n - turn @ place)

    def told(origin, place):
        pose = Pose3(Vec3(*origin), turned.x, turned.y, turned.z)
        pair = _pair3.Pair3(*(jxr.Ellipsoid(*each).prepared() for each in axes), pose, 0.02)
        at_a = tuple(place)
        point = pose.place(pair.a.frame(at_a).point)
        at = at_a, _samples3.footed(pair.b, pair.b.start(point), point, 20)
        frames = pair.frames(at)
        equations = _pair3.linear(*frames)

        def moved(step):
            ahead = _pair3.stepped(pair, at, equations.basis, ((step[0], step[1]), (0.0, 0.0)))
            point = pose.place(pair.a.frame(ahead[0]).point)
            foot = pair.b.frame(_samples3.footed(pair.b, at[1], point, 8))
            return (point - foot.point).dot(foot.normal), foot.point.array()

        heights, feet = jax.vmap(moved)(steps)
        follow = jnp.stack(equations.follow((0.0, 0.0), (0.3, -0.8)))
        basis = jnp.stack([vector.array() for vector in equations.basis[1]])
        slope, aside = equations.conditions(*frames)
        # From a place beside the foot the slope is that at the foot, and the way back to it is known.
        beside = _pair3.stepped(pair, at, equations.basis, ((0.0, 0.0), (5e-5, -3e-5)))
        there = pair.frames(beside)
        nearby = _pair3.linear(*there)
        pulled, off = nearby.conditions(*there)
        again = _pair3.stepped(pair, beside, nearby.basis, ((0.0, 0.0), nearby.follow(off, (0.0, 0.0))))
        slips = [pair.frames(x)[1].point - frames[1].point for x in (beside, again)]
        lost = jnp.stack([*(p - s for p, s in zip(pulled, slope, strict=True)), *(x.norm() for x in slips)])
        return (
            lost,
            heights,
            feet,
            jnp.stack(slope),
            jnp.stack(aside),
            jnp.stack([*equations.rise]),
            follow,
            basis,
        )

    found = jax.jit(jax.vmap(told))(np.array(origins), np.array(places))
    for i, (lost, height, feet, slope, aside, rise, follow, basis) in enumerate(
        zip(*map(np.asarray, found), strict=True)
    ):
        np.testing.assert_allclose(aside, 0.0, atol=1e-14)
        np.testing.assert_allclose(lost[:2], 0.0, atol=3e-5)
        np.testing.assert_allclose(lost[2:], [np.hypot(5e-5, 3e-5), 0.0], atol=3e-7)
        rates = np.array([height[1] - height[2], height[3] - height[4]]) / (2.0 * h)
        np.testing.assert_allclose(slope, rates, atol=5e-5)
        rates = np.stack([feet[1] - feet[2], feet[3] - feet[4]]) / (2.0 * h)
        np.testing.assert_allclose(follow, basis @ (np.array([0.3, -0.8]) @ rates), rtol=1e-3)
        if i > 1:
            np.testing.assert_allclose(slope, 0.0, atol=1e-13)
            np.testing.assert_allclose(height[0], (0.006, -0.002)[i - 2], atol=1e-15)
            bends = [
                height[1] + height[2] - 2 * height[0],
                0.25 * (height[5] - height[6] - height[7] + height[8]),
            ]
            bends.append(height[3] + height[4] - 2 * height[0])
            np.testing.assert_allclose(rise, np.array(bends) / h**2, rtol=2e-3, atol=0.05)


def test_a_cover_tells_its_size_and_the_widest_distance_of_its_samples():
    found = jax.jit(lambda: _samples3.cover(jxr.Ellipsoid(0.02, 0.015, 0.01).prepared(), 40))()
    points = np.stack([*found.points], axis=1)
    np.testing.assert_allclose(np.sum((points / [0.02, 0.015, 0.01]) ** 2, axis=1), 1.0)
    apart = np.linalg.norm(points[:, None] - points, axis=2) + 9.0 * np.eye(40)
    np.testing.assert_allclose(found.width, apart.min(axis=1).max())
    away = points - points.mean(axis=0)
    np.testing.assert_allclose(found.size(), np.sqrt(np.sum(away**2) / 40))
    assert _samples3.cover(jxr.Plane().prepared(), 40) is None


def test_surfaces_are_compared_by_the_mean_of_their_sizes(monkeypatch):
    """Of those that are bounded: what counts as equal is a share of it."""

    class Made(Exception):
        pass

    def made(a, b, pose, scale):
        raise Made(float(scale))

    monkeypatch.setattr(_location3, "Pair3", made)
    small, large = jxr.Sphere(0.01), jxr.Sphere(0.04)
    with jax.disable_jit():
        for pair, wanted in (((small, large), 0.025), ((small, jxr.Plane()), 0.01)):
            with pytest.raises(Made) as caught:
                jxr.contact.locate_surfaces(*pair, samples=64)
            assert caught.value.args[0] == pytest.approx(wanted, rel=2e-3)


def test_a_place_is_ended_where_any_margin_is_small():
    surface = SimpleNamespace(margins=lambda at: (at[0], 1.0 - at[0]))
    found = [bool(_samples3.ended(surface, (x,), 0.1)) for x in (0.05, 0.1, 0.2, 0.8, 0.95, -3.0)]
    assert found == [True, True, False, False, True, True]
    assert not _samples3.ended(SimpleNamespace(margins=lambda at: ()), (0.0,), 0.1)
    # At an end the distance has no sign, if there is one.
    point, up = Vec3(*jnp.array([0.3, 0.0, -0.4])), Vec3(*jnp.array([0.0, 0.0, 1.0]))
    still = rotated(0.0, 0.0, 0.0, 0.0)
    foot = SimpleNamespace(point=Vec3(*jnp.zeros(3)), normal=up)
    for margin, wanted in ((1.9e-9, 0.5), (2.1e-9, -0.4)):
        b = SimpleNamespace(margins=lambda at, margin=margin: (jnp.asarray(margin),))
        pair = _pair3.Pair3(None, b, still, 2.0)
        assert float(_samples3.distance(pair, point, foot, (jnp.zeros(()),))) == pytest.approx(wanted)
    assert (
        float(_samples3.distance(_pair3.Pair3(None, b, still, 9.0), foot.point, foot, (jnp.zeros(()),)))
        == 0.0
    )


@functools.cache
def reports():
    """What is reported of three places of a ball over a plane, in a program of its own."""

    def told(places, there, missed, start, swapped):
        pair = _pair3.Pair3(
            jxr.Sphere(0.5).prepared(), jxr.Plane().prepared(), rotated(0.1, 0.2, 0.9, 0.0), 2.0
        )
        on_plane = tuple(x + y for x, y in zip(places, (0.1, 0.2, 0.0), strict=True))[:2]
        at = (places, (*on_plane, 0.0 * places[0]))
        return _location3._report(pair, (rotated(0.3, -0.1, 0.2, 0.6), swapped), (at, there, missed), start)

    return jax.jit(told, static_argnums=4)


def begun(**given):
    """Where a search of three pairs began."""
    known = {
        "at": None,
        "there": None,
        "reach": np.full(3, 0.1),
        "distance": 0.3,
        "bound": 0.3,
        "of_b": False,
    }
    known["sample"] = ((np.zeros(()),) * 3, (np.zeros(()),) * 3)
    return _samples3.Starts(**(known | given))


@pytest.mark.parametrize("swapped", [False, True])
def test_the_closest_places_are_reported_and_then_the_others(swapped):
    """Places of a ball of radius 0.5 whose centre is 0.9 above a plane: its gap there is 0.9 + z."""
    turn = np.stack(
        [np.array([*axis]) for axis in (lambda p: (p.x, p.y, p.z))(rotated(0, 0, 0, 0.6))], axis=1
    )
    places = np.array([[0.0, 0.0, -0.5], [0.3, 0.0, -0.4], [0.0, 0.48, 0.14]])
    there = np.array([True, True, False])
    found = reports()(tuple(places.T), there, np.array(False), begun(), swapped)
    assert found.result == RESULTS.successful and bool(found.unique)
    np.testing.assert_allclose((found.gap, found.residual), (0.4, 0.0), atol=1e-15)
    ball, plane = (found.at_b, found.at_a) if swapped else (found.at_a, found.at_b)
    np.testing.assert_allclose((ball, plane), [[0.0, 0.0, -0.5], [0.1, 0.2, 0.0]], atol=1e-15)
    world = [0.3, -0.1, 0.2] + np.array([[0.1, 0.2, 0.4], [0.1, 0.2, 0.0]]) @ turn.T
    np.testing.assert_allclose(found.points, world[::-1] if swapped else world, atol=1e-12)
    np.testing.assert_allclose(found.normal, turn @ [0.0, 0.0, -1.0 if swapped else 1.0], atol=1e-12)
    others = found.others
    assert others.there.tolist() == [True, False, False]
    np.testing.assert_allclose(others.gap, [0.5, np.inf, np.inf])
    ball, plane = (others.at_b, others.at_a) if swapped else (others.at_a, others.at_b)
    np.testing.assert_allclose(ball, [[0.3, 0.0, -0.4], [0, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(plane, [[0.4, 0.2, 0.0], [0, 0, 0], [0, 0, 0]])


def test_equal_gaps_and_missed_minima_are_not_unique():
    """In a scene of scale 2 gaps are equal up to 2e-9."""
    for more, unique in ((1.9e-9, False), (2.1e-9, True)):
        z = -0.4 + more
        places = np.array([[0.3, 0.0, -0.4], [0.0, np.sqrt(0.25 - z * z), z], [0.5, 0.0, 0.0]])
        found = reports()(tuple(places.T), np.array([True, True, False]), np.array(False), begun(), False)
        assert bool(found.unique) == unique
        # Normals of a place aside are not opposite, which is the larger part of what is left.
        np.testing.assert_allclose(found.residual, np.sqrt(0.6**2 + 0.2**2), rtol=1e-9)
    for distance, code in ((0.3, RESULTS.solver_failed), (-0.3, RESULTS.too_deep)):
        start = begun(distance=np.array(distance))
        found = reports()(tuple(places.T), np.array([False] * 3), np.array(True), start, False)
        assert found.result == code and not bool(found.unique) and not found.others.there.any()


# Links and fingertips.


def test_quotients_are_kept_between_bounds_and_where_nothing_is_divided():
    above, below = np.array([0.3, -1.0, 3.0, 1.0, 0.5]), np.array([0.6, 2.0, 2.0, 0.0, -1.0])
    between, over = jax.jit(lambda *given: (_links._between(*given), _links._over(*given)))(above, below)
    np.testing.assert_allclose(between, [0.5, 0.0, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(over, [0.5, -0.5, 1.5, 0.0, -0.5])
    # Over the farther face where it is over one, else past the nearer of the ends that it is past.
    flags = lambda *values: jnp.array(values)  # noqa: E731
    heights = [(jnp.array([1.0, 5.0, 3.0, -1.0, -2.0]), flags(False, False, True, False, False))]
    heights += [(jnp.array([2.0, 4.0, 2.0, 7.0, -1.0]), flags(False, True, True, True, False))]
    one, two = (Vec2(k * jnp.ones(5), k * jnp.full(5, 3.0)) for k in (1.0, 2.0))
    found = [(height, way, ended) for (height, ended), way in zip(heights, (one, two), strict=True)]
    height, slope = _links._from_body(found)
    assert height.tolist() == [2.0, 5.0, 2.0, 7.0, -1.0]
    assert slope.x.tolist() == [2.0, 1.0, 2.0, 2.0, 2.0] and slope.y.tolist() == [6.0, 3.0, 6.0, 6.0, 6.0]
    ends = np.zeros(3), np.array([-1.0, 1.0, 0.0]), np.ones(3), np.array([3.0, 2.0, 0.0])
    crossed = jax.jit(_links._crossing)(*ends)
    np.testing.assert_allclose(crossed, [0.25, 0.0, 0.0])
    # Of chains the closest links: parallel ones 0.3 apart, which begin 0.1 apart along them.
    chain = [Vec2(0.0, 5.0), Vec2(0.0, 0.0), Vec2(1.0, 0.0)]
    other = [Vec2(1.1, 0.4), Vec2(2.0, 0.4), Vec2(2.0, -9.0)]
    assert float(jax.jit(_links.chains_apart)(chain, other)) == pytest.approx(np.hypot(0.1, 0.4))


def plate_heights(points, width, height):
    """How far points are outside of a plate by the farther one of its two faces."""
    sides = []
    for sign in (1.0, -1.0):
        beyond = np.abs(points[:, 1]) - 0.5 * height
        across = sign * points[:, 0] - 0.5 * width
        sides.append(np.where(beyond > 0.0, np.hypot(across, beyond), across))
    return np.maximum(*sides)


def test_links_and_tips_stay_clear_of_a_plate_as_all_their_points_do():
    """The plate is turned and elsewhere; chains of two links and of one, the second into it."""
    body, turn = pose(0.02, -0.01, 0.4), np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    faces = [jxr.Line((-0.04, 0.04)).moved((x, 0.0), angle) for x, angle in ((-0.015, np.pi), (0.015, 0.0))]
    own = [
        np.array([[0.05, -0.07], [0.031, 0.013], [0.06, 0.03]]),
        np.array([[-0.04, 0.01], [-0.006, 0.022]]),
    ]
    chains = [[Vec2(*(np.array([0.02, -0.01]) + turn @ point)) for point in chain] for chain in own]
    tip, at = jxr.Circle(0.012), np.array([0.024, 0.012])
    place = pose(*(np.array([0.02, -0.01]) + turn @ at), 0.9)

    def told(chains):
        ready = [face.prepared() for face in faces]
        links = _links.links_clearance(body, chains, ready, samples=64)
        return links, _clearance.clearance((place, body), tip.prepared(), ready, samples=128)

    links, tips = jax.jit(told)(chains)
    share = np.linspace(0.0, 1.0, 20_001)[:, None]
    for chain, found in zip(own, links, strict=True):
        points = np.concatenate([a + share * (b - a) for a, b in zip(chain[:-1], chain[1:], strict=True)])
        np.testing.assert_allclose(found, plate_heights(points, 0.03, 0.08).min(), atol=1e-6)
    points = at + 0.012 * ways(*np.linspace(0.0, 2.0 * np.pi, 20_001))
    np.testing.assert_allclose(tips, plate_heights(points, 0.03, 0.08).min(), atol=1e-6)


def test_beside_an_end_of_a_surface_a_point_is_outside_by_its_distance(monkeypatch):
    foot = SimpleNamespace(point=Vec3(*jnp.zeros(3)), normal=Vec3(*jnp.array([0.0, 0.0, 1.0])))
    point = Vec3(*jnp.array([0.3, 0.0, -0.4]))
    for margin, wanted in ((0.9e-9, 0.5), (1.1e-9, -0.4), (-1.0, 0.5)):
        monkeypatch.setattr(_clearance, "_foot", lambda surface, point, m=margin: ((jnp.asarray(m),), foot))
        surface = SimpleNamespace(margins=lambda at: (jnp.asarray(1.0), at[0]))
        height, normal, _ = _clearance.height3(point, surface)
        assert float(height) == pytest.approx(wanted) and normal is foot.normal
