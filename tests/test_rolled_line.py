"""Where discs roll along a line: corners of triangles, for which the disc in each corner is known."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxroll.geometry.fitting import _rolled_line
from jaxroll.geometry.fitting._rolled_line import _stretches, along, rolled_line, spread_along

RADIUS, COUNT = 1.0, 4001
SLACK = 0.02 * RADIUS


def triangle(apex):
    """Corners of an isosceles triangle with sides of 12 radii, counter-clockwise, and its angles [rad]."""
    half = np.radians(apex) / 2.0
    foot = 12.0 * np.array([np.sin(half), -np.cos(half)])
    return np.array([[0.0, 0.0], foot * [-1.0, 1.0], foot]), np.array([2.0, 0.0, 0.0]) * half + np.array(
        [0.0, 1.0, 1.0]
    ) * (np.pi / 2 - half)


def in_corners(places, corners, angles):
    """Places moved onto the disc that touches both sides of a corner, where they are before it."""
    found = places.copy()
    for k in range(3):
        aside = [corners[j] - corners[k] for j in range(3) if j != k]
        inward = sum(side / np.linalg.norm(side) for side in aside)
        half = angles[k] / 2.0
        middle = corners[k] + inward / np.linalg.norm(inward) * RADIUS / np.sin(half)
        before = np.linalg.norm(places - corners[k], axis=1) < RADIUS / np.tan(half)
        # Wider corners than of 77 degrees are left: their arc is nearer than 0.6 radii.
        if RADIUS / np.sin(half) - RADIUS > 0.6 * RADIUS:
            arms = places[before] - middle
            found[before] = middle + RADIUS * arms / np.linalg.norm(arms, axis=1, keepdims=True)
    return found


def apart(one, other):
    """Largest distance of either line's places from the other's."""
    return max(KDTree(a).query(b)[0].max() for a, b in ((one, other), (other, one)))


@pytest.mark.parametrize("apex", [25.0, 60.0, 74.0, 81.0])
@pytest.mark.parametrize("inside", [True, False])
def test_corners_are_drawn_onto_the_disc_that_fits(apex, inside):
    """Of a body with sharp ends, and of one with notches: the same line the other way round."""
    corners, angles = triangle(apex)
    line = spread_along(np.concatenate([corners, corners[:1]]), COUNT)
    # The first place is on a side, not in a corner.
    line = np.concatenate([line[500:-1], line[:501]])
    points = line[::7] * 1.0
    moved, after = rolled_line(points, line if inside else line[::-1], RADIUS, 1e-3, closed=True)
    np.testing.assert_array_equal(after[0], after[-1])
    # A disc that reaches over the sides by the slack is nearer to the corner by so much over the sine.
    allowed = 1.05 * SLACK / np.sin(angles.min() / 2.0) + 0.01
    expected = in_corners(line, corners, angles)
    assert np.abs(expected - line).max() > 0.5
    assert apart(after, expected) < allowed
    np.testing.assert_allclose(moved, in_corners(points, corners, angles), atol=allowed)


def test_a_line_with_ends_keeps_them_and_loses_its_corner():
    corners, angles = triangle(45.0)
    line = spread_along(corners[[2, 0, 1]], COUNT)
    moved, after = rolled_line(line[::5], line, RADIUS, 1e-3, closed=False)
    expected = line.copy()
    upper = np.linalg.norm(line - corners[0], axis=1) < 6.0
    expected[upper] = in_corners(line, corners, angles)[upper]
    allowed = 1.05 * SLACK / np.sin(angles[0] / 2.0) + 0.01
    assert apart(after, expected) < allowed
    np.testing.assert_allclose(after[[0, -1]], line[[0, -1]], atol=1e-12)
    np.testing.assert_allclose(moved, expected[::5], atol=allowed)


@pytest.mark.parametrize(("radius", "noise"), [(6.0, 1e-3), (1.0, 0.125)])
def test_nothing_is_moved_where_no_disc_fits_or_noise_is_half_a_radius(radius, noise):
    corners, _ = triangle(45.0)
    line = spread_along(np.concatenate([corners, corners[:1]]), COUNT)
    moved, after = rolled_line(line[::5], line, radius, noise, closed=True)
    assert apart(after, line) < 5e-3
    np.testing.assert_array_equal(moved, line[::5])


def test_lengths_along_a_polygon():
    corners = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0]])
    assert along(corners).tolist() == [0.0, 3.0, 4.0]
    np.testing.assert_allclose(spread_along(corners, 5), [[0, 0], [1, 0], [2, 0], [3, 0], [3, 1]])


def test_stretches_of_a_closed_line_go_on_past_its_end():
    off = np.array([1, 1, 0, 0, 1, 0, 1], bool)
    assert [list(each) for each in _stretches(off, closed=True)] == [[4], [6, 0, 1]]
    assert [list(each) for each in _stretches(off, closed=False)] == [[0, 1], [4], [6]]
    for all_alike in (np.ones(5, bool), np.zeros(5, bool)):
        assert _stretches(all_alike, closed=True) == _stretches(all_alike, closed=False) == []


@pytest.mark.parametrize(("left", "moved"), [(70, True), (69, False)])
def test_nothing_is_moved_where_three_tenths_of_the_line_would_be(left, moved, monkeypatch):
    """By more than the radius: of a hundred places those beyond what is left, which is a unit away."""
    line = np.stack([np.arange(100.0), np.zeros(100)], axis=1)
    asked = []

    def rolled(points, given, side, slack, *, closed):
        asked.append((side, slack, closed))
        return points + 1.0, given[:left] if len(asked) == 2 else given

    monkeypatch.setattr(_rolled_line, "_rolled_on", rolled)
    found, after = rolled_line(line[::5], line, 0.5, 0.02, closed=False)
    assert asked == [(0.5, 0.08, False), (-0.5, 0.08, False)]
    np.testing.assert_array_equal(found, line[::5] + (2.0 if moved else 0.0))
    np.testing.assert_array_equal(after, line[:left] if moved else line)
    asked.clear()
    rolled_line(line[::5], line, 0.5, 0.001, closed=True)
    assert asked == [(0.5, 0.01, True), (-0.5, 0.01, True)]


@pytest.mark.parametrize("size", [1e-3, 250.0])
def test_lines_of_any_size_are_rolled_alike(size):
    corners, _ = triangle(45.0)
    line = spread_along(np.concatenate([corners, corners[:1]]), 801)
    line = np.concatenate([line[100:-1], line[:101]])
    wanted = rolled_line(line[::7], line, RADIUS, 1e-3, closed=True)
    assert np.abs(wanted[1] - line).max() > 0.5
    found = rolled_line(size * line[::7], size * line, size * RADIUS, size * 1e-3, closed=True)
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one, size * other, rtol=1e-9, atol=1e-9 * size)


def test_points_are_drawn_onto_the_nearest_disc_unless_they_are_nearly_there():
    middles = np.array([[0.0, 0.0], [10.0, 0.0]])
    points = np.array([[0.0, 2.09], [0.0, 2.11], [1.0, 0.0], [13.0, 4.0], [6.0, 0.0]])
    found = _rolled_line._drawn(points, middles, 2.0, 0.1)
    wanted = [[0.0, 2.09], [0.0, 2.0], [1.0, 0.0], [11.2, 1.6], [8.0, 0.0]]
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
