"""What `reach` and `grasp_points` walk over: samples of contours and surfaces, places nearest to points."""

import jax
import numpy as np

import jaxroll as jxr
from jaxroll._reaching._sheet import Sheet, sheet_of, shortened
from tests.measures import programs


def test_samples_of_contours():
    """Middles of equal parts from end to end; of a line without ends about the foot of the origin."""
    middles = (np.arange(5) + 0.5) / 5
    arc = Sheet(jxr.Catenary(0.02, (-0.01, 0.03)))
    np.testing.assert_allclose(arc.sampled(5, 9.0)[:, 0], -0.01 + 0.04 * middles)
    disc = Sheet(jxr.Circle(0.02))
    found = disc.sampled(5, 9.0)
    assert found.shape == (5, 1)
    np.testing.assert_allclose(np.diff(found[:, 0]), 0.04 * np.pi / 5)
    line = Sheet(jxr.Line().moved((0.3, 0.1), 0.4))
    found = line.sampled(5, 0.2)
    points = line.frames(found).points
    along = np.array([-np.sin(0.4), np.cos(0.4)])
    foot = np.array([0.3, 0.1]) - along * (along @ [0.3, 0.1])
    np.testing.assert_allclose(sorted(points @ along), 0.2 * (2.0 * middles - 1.0), atol=1e-12)
    np.testing.assert_allclose(points.mean(axis=0), foot, atol=1e-12)


def test_places_within_a_contour():
    at = np.array([[-0.02], [0.0], [0.05]])
    arc = Sheet(jxr.Catenary(0.02, (-0.01, 0.03)))
    np.testing.assert_allclose(arc.within(at)[:, 0], [-0.01, 0.0, 0.03])
    disc, length = Sheet(jxr.Circle(0.02)), 0.04 * np.pi
    low = float(jxr.Circle(0.02).domain()[0])
    expected = low + np.mod(at[:, 0] - low, length)
    np.testing.assert_allclose(disc.within(at + 3 * length)[:, 0], expected, atol=1e-12)
    np.testing.assert_array_equal(Sheet(jxr.Line()).within(at), at)


def test_samples_of_surfaces():
    """Of a ball all over it; of a plane, which has no bounds, no farther than the cube that is asked for."""
    ball = Sheet(jxr.Sphere(0.02))
    points = ball.frames(ball.sampled(64, 9.0)).points
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.02)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=2e-3)
    np.testing.assert_allclose(points.T @ points / 64, 0.02**2 / 3.0 * np.eye(3), atol=2e-5)
    table = Sheet(jxr.Plane())
    points = table.frames(table.sampled(64, 0.3)).points
    assert np.abs(points).max() <= 0.3 and np.ptp(points, axis=0).max() > 0.5


def test_feet_are_nearest():
    """On a catenary, on both of its sides, from guesses nearby: against all places."""
    arc = Sheet(jxr.Catenary(0.02, (-0.03, 0.03)))
    every = arc.sampled(5001, 1.0)
    there = arc.frames(every)
    at = np.array([400, 1500, 2400, 2600, 3900])
    for height in (-0.015, 0.008, 0.03):
        points = there.points[at] + height * there.normals[at]
        best = np.argmin(np.linalg.norm(points[:, None] - there.points, axis=2), axis=1)
        found = arc.frames(arc.feet(points, every[best] + 2e-3))
        arms = points - found.points
        nearest = np.linalg.norm(points - there.points[best], axis=1)
        np.testing.assert_allclose(np.linalg.norm(arms, axis=1), nearest, rtol=1e-6)
        np.testing.assert_allclose(np.sum(arms * found.tangents[:, 0], axis=1), 0.0, atol=1e-15)


def test_steps_are_cut_to_half_the_radius():
    bends = np.array([[[50.0]], [[50.0]], [[0.0]]])
    found = shortened(np.array([[0.005], [0.04], [3.0]]), bends)
    np.testing.assert_allclose(found[:, 0], [0.005, 0.01, 3.0])


def test_a_surface_is_spread_over_without_compiling_anew(caplog):
    """Another ellipsoid has other numbers alone."""
    jxr.Ellipsoid(0.01, 0.02, 0.03).spread(31)
    with jax.log_compiles():
        jxr.Ellipsoid(0.02, 0.01, 0.015).spread(31)
    assert programs(caplog) == []


def test_a_sheet_that_is_asked_for_stays_known():
    """However many tips are made beside it, as of the tries of a pinch."""
    shape = jxr.Circle(0.01)
    known = sheet_of(shape)
    for k in range(40):
        sheet_of(jxr.Circle(0.02 + 0.001 * k))
        assert sheet_of(shape) is known
