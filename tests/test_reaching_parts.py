"""Pieces of the searches for points to hold by and for postures, against hand-worked values and NumPy."""

from types import SimpleNamespace

import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._reaching import _choice, _grasp_points, _overlap, _postures, _reach, _sheet, sheet_of
from jaxroll._reaching._sheet import Frames
from tests.recorded import runs

RESULTS = jxr.RESULTS


def ways(*angles):
    """Unit vectors of the plane."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def turned(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def frames_of(*curves):
    """Frames of the plane: each point, the angle of its outward normal, its bend."""
    points, angles, bends = zip(*curves, strict=True)
    normals = ways(*angles)
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    return Frames(np.array(points), normals, tangents[:, None], np.array(bends, float)[:, None, None])


def pairs_of(points, normals=None, faces=None):
    """Pairs of points whose places are their first coordinates."""
    points = np.array(points, float)
    normals = np.zeros_like(points) if normals is None else np.array(normals, float)
    faces = np.zeros(points.shape[:2], int) if faces is None else np.array(faces)
    return _grasp_points._Pairs(faces, points[:, :, :1].copy(), points, normals)


# Points to hold by.


def test_the_friction_that_two_points_need_is_the_larger_tangent():
    """Angles of both normals to the line between the points, whose direction and length are any."""
    line, length = 0.7, 0.03
    one = np.array([0.2, -0.1])
    other = one + length * ways(line)[0]
    cases = {
        (0.2, 0.1): np.tan(0.2),
        (-0.1, 0.4): np.tan(0.4),
        (0.0, 0.0): 0.0,
        (1.0, -1.3): np.tan(1.3),
        (1.6, 0.0): np.inf,  # the first finger would have to pull, the second one, and both
        (0.1, 2.0): np.inf,
        (2.0, 2.5): np.inf,
    }
    for (first, second), wanted in cases.items():
        out = ways(line + np.pi + first, line + second)
        found = _grasp_points._needed(one[None], other[None], out[:1], out[1:])
        np.testing.assert_allclose(found, [wanted], rtol=1e-12, atol=1e-15)
    both = _grasp_points._needed(one[None], one[None], ways(np.pi), ways(0.0))
    assert np.isinf(both).all()


def test_pairs_that_differ_little_are_left_out():
    """Each is compared with those that were kept, and with known ones; the distance itself is too little."""
    at = np.array([0.0, 1.0, 2.5, 3.0, 9.0])
    pairs = pairs_of(np.stack([np.stack([at, 0 * at], 1), np.stack([at, 0 * at + 20.0], 1)], axis=1))
    assert _grasp_points._thinned(pairs, 9, 1.0).tolist() == [0, 2, 4]
    assert _grasp_points._thinned(pairs, 9, 0.9).tolist() == [0, 1, 2, 4]
    assert _grasp_points._thinned(pairs, 2, 0.1).tolist() == [0, 1]
    known = np.array([[[2.5, 20.0], [2.5, 0.0]], [[9.0, 0.0], [9.0, 21.5]]])
    assert _grasp_points._thinned(pairs, 9, 1.0, known).tolist() == [0, 4]
    assert _grasp_points._thinned(pairs, 9, 1.5, known).tolist() == [0]
    assert _grasp_points._thinned(pairs.taken([]), 3, 1.0).tolist() == []


def stationary(one, other):
    """Newton's step to where the squared distance of two parabolas is stationary, by central differences."""
    k = one.bends.shape[1]

    def half(steps):
        ends = []
        for frame, step in ((one, steps[:k]), (other, steps[k:])):
            bent = 0.5 * step @ frame.bends[0] @ step
            ends.append(frame.points[0] + step @ frame.tangents[0] - bent * frame.normals[0])
        return 0.5 * np.sum((ends[1] - ends[0]) ** 2)

    units = 1e-3 * np.eye(2 * k)
    slope = [(half(u) - half(-u)) / 2e-3 for u in units]
    bend = [[(half(u + v) - half(u - v) - half(v - u) + half(-u - v)) / 4e-6 for v in units] for u in units]
    return -np.linalg.solve(bend, slope)


def test_a_step_of_the_search_for_pairs_is_newtons():
    ends = frames_of(([0.1, -0.3], 2.9, 0.8)), frames_of(([1.3, 0.4], 0.5, -0.35))
    np.testing.assert_allclose(_grasp_points._newton(*ends)[0], stationary(*ends), rtol=1e-5)
    rng = np.random.default_rng(4)
    spatial = []
    for point, bend in (
        ([0.1, 0.2, 0.3], [[0.7, 0.2], [0.2, 0.4]]),
        ([1.5, 0.1, 0.0], [[0.3, -0.1], [-0.1, 0.6]]),
    ):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        spatial.append(Frames(np.array([point]), axes[:1], axes[None, 1:], np.array([bend])))
    np.testing.assert_allclose(_grasp_points._newton(*spatial)[0], stationary(*spatial), rtol=1e-3)
    # Opposite points of a circle of radius 2, turned a little: of all diameters the nearest.
    ball = (
        frames_of(([2.0, 0.0], 0.0, 0.5)),
        frames_of(([-2.0 * np.cos(0.1), -2.0 * np.sin(0.1)], np.pi + 0.1, 0.5)),
    )
    np.testing.assert_allclose(_grasp_points._newton(*ball)[0], [0.1, -0.1], rtol=1e-2)
    # Between parallel plates all that matters is how far the points are aside of each other.
    flat = frames_of(([0.3, 0.0], 0.0, 0.0)), frames_of(([-0.3, 0.08], np.pi, 0.0))
    np.testing.assert_allclose(_grasp_points._newton(*flat)[0], [0.04, 0.04], atol=1e-12)


def test_exact_pairs_are_each_once_and_the_narrowest_first():
    size = 2.0
    given = pairs_of(
        [
            [[3.0, 0.0], [0.0, 0.0]],  # of one face, so that the end with the lower coordinate comes first
            [[0.0, 1.0], [0.0, 0.0]],
            [[2.0, 1.0], [1.0, 1.0]],  # of two faces: it stays as it is
            [[0.0, 0.0], [1e-9, 1.0]],  # the second one again
            [[0.0, 0.0], [3e-6, 1.0]],  # another, as wide to rounding
        ],
        faces=[[0, 0], [1, 1], [1, 0], [1, 1], [1, 1]],
    )
    found = _grasp_points._merged(given, size)
    wanted = [[[0, 0], [0, 1]], [[0, 0], [3e-6, 1]], [[2, 1], [1, 1]], [[0, 0], [3, 0]]]
    np.testing.assert_allclose(found.points, wanted, atol=1e-8)
    assert found.faces.tolist() == [[1, 1], [1, 1], [1, 0], [0, 0]]
    np.testing.assert_allclose(found.places[:, :, 0], np.array(wanted)[:, :, 0], atol=1e-8)


def test_pairs_are_reported_with_their_numbers():
    sheets = [SimpleNamespace(coordinates=1), SimpleNamespace(coordinates=2)]
    pairs = _grasp_points._Pairs(
        np.array([[0, 1], [1, 0], [0, 0]]),
        np.array([[[1.0, 0.0], [2.0, 3.0]], [[4.0, 5.0], [6.0, 0.0]], [[7.0, 0.0], [8.0, 0.0]]]),
        np.array([[[0.0, 0.0], [0.3, 0.4]]] * 3),
        np.array([-ways(np.arctan2(4, 3)), ways(np.arctan2(4, 3) + 1e-10)])[None, :, 0].repeat(3, axis=0),
    )
    pairs.normals[1, 1] = ways(np.arctan2(4, 3) + 2e-9)[0]
    found = _grasp_points._reported(sheets, pairs, 2)
    assert len(found) == 2 and found.exact.tolist() == [True, False]
    np.testing.assert_allclose(found.distance, 0.5)
    np.testing.assert_allclose(found.demand, [0.0, 2e-9], rtol=1e-6)
    assert [[at.tolist() for at in pair] for pair in found.places] == [
        [[1.0], [2.0, 3.0]],
        [[4.0, 5.0], [6.0]],
    ]
    np.testing.assert_array_equal(found.faces, pairs.faces[:2])
    np.testing.assert_array_equal(found.normals, pairs.normals[:2])


def test_pairs_of_samples_are_those_that_can_be_held_by_rising_demand():
    """On a circle opposite ones need nothing, and those k steps off opposite the tangent of half of that."""
    number = np.arange(10)
    angles = 2.0 * np.pi * number / 10
    samples = _grasp_points._Pairs(
        number[:, None] % 3, angles[:, None, None], 3.0 * ways(*angles)[:, None], ways(*angles)[:, None]
    )
    # Three steps off opposite the normals do not face each other.
    found = _grasp_points._candidates(samples, 0.2)
    ends = np.round(found.places[..., 0] * 5 / np.pi).astype(int)
    off = np.abs(ends[:, 1] - ends[:, 0] - 5)
    assert off.tolist() == [0] * 5 + [1] * 10 + [2] * 10
    np.testing.assert_allclose(_grasp_points._demand(found), np.tan(np.pi * off / 10), rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(found.faces, ends % 3)
    # Beyond the limit some more are kept, as starts: those that need no more than 1.
    thin = samples._replace(points=samples.points * [1.0, 0.2])
    counts = [len(_grasp_points._candidates(thin, limit).faces) for limit in (0.2, 1.0, 3.0)]
    assert counts[0] == counts[1] < counts[2]
    assert _grasp_points._demand(_grasp_points._candidates(thin, 0.2)).max() <= 1.0


def test_faces_without_bounds_are_sampled_within_the_box_or_beside_the_others():
    line, disc = sheet_of(jxr.Line().moved((0.01, 0.0))), sheet_of(jxr.Circle(0.02).moved((0.05, 0.0)))
    beside = _grasp_points._sampled([disc, line], None)
    assert np.bincount(beside.faces[:, 0]).tolist() == [192, 192]
    ends = np.sort(beside.points[192:, 0, 1])[[0, -1]]
    np.testing.assert_allclose(ends, np.array([-0.07, 0.07]) * (1.0 - 1.0 / 192), rtol=1e-4)
    boxed = _grasp_points._sampled([line], np.array([0.03, 0.08]))
    reach = np.abs(boxed.points[:, 0, 1]).max()
    # Of 384 within half the diagonal those that are in the box.
    assert 0.0395 <= reach <= 0.04 and len(boxed.points) == 2 * round(192 * 0.04 / np.hypot(0.015, 0.04))
    assert len(_grasp_points._sampled([line], np.array([0.019, 0.08])).points) == 0
    assert len(_grasp_points._sampled([line], np.array([0.02, 0.08])).points) > 300
    alone = _grasp_points._sampled([line], None)
    np.testing.assert_allclose(np.abs(alone.points[:, 0, 1]).max(), 0.05 * (1.0 - 1.0 / 384), rtol=1e-12)
    # However many faces there are, each has 64 samples.
    assert len(_grasp_points._sampled([disc] * 8, None).points) == 8 * 64
    np.testing.assert_allclose(np.linalg.norm(beside.normals[:, 0], axis=1), 1.0)


def test_what_is_held_is_an_object_or_its_shapes():
    disc, ball = jxr.Circle(0.02), jxr.Sphere(0.02)
    shapes, box = _grasp_points._shapes_of(jxr.scenes.cuboid(0.02, 0.03, 0.04))
    assert len(shapes) == 2 and box.tolist() == [0.02, 0.03, 0.04]
    assert _grasp_points._shapes_of([disc, disc]) == ((disc, disc), None)
    finger = jxr.Finger([0.05], [0.02], disc)
    for given in (finger, [disc, ball], 3):
        with pytest.raises(ValueError, match="argument object"):
            _grasp_points._shapes_of(given)


def test_places_and_frames_are_of_the_face_of_each_end():
    """Of two discs, of which one is aside: ends move along their own circles."""
    sheets = [sheet_of(jxr.Circle(0.02)), sheet_of(jxr.Circle(0.05).moved((0.3, 0.1)))]
    faces, places = np.array([1, 0, 1]), np.array([[0.01, 7.0], [0.02, 8.0], [0.03, 9.0]])
    here = _grasp_points._frames_at(sheets, faces, places)
    radii, middles = np.array([0.05, 0.02, 0.05]), np.array([[0.3, 0.1], [0.0, 0.0], [0.3, 0.1]])
    normals = ways(*places[:, 0] / radii)
    np.testing.assert_allclose(here.points, middles + radii[:, None] * normals, atol=1e-15)
    np.testing.assert_allclose(here.normals, normals, atol=1e-15)
    np.testing.assert_allclose(here.bends[:, 0, 0], 1.0 / radii)
    moved = _grasp_points._moved_on(sheets, faces, places, np.array([[0.001], [0.002], [-0.02]]))
    np.testing.assert_allclose(moved, [[0.011, 7.0], [0.022, 8.0], [0.01, 9.0]], atol=1e-15)
    assert places[0, 0] == 0.01
    none = _grasp_points._frames_at(sheets, faces[:0], places[:0])
    assert [x.shape for x in none] == [(0, 2), (0, 2), (0, 1, 2), (0, 1, 1)]
    solid = _grasp_points._frames_at([sheet_of(jxr.Sphere(0.02))], faces[:0], places[:0])
    assert [x.shape for x in solid] == [(0, 3), (0, 3), (0, 2, 3), (0, 2, 2)]


def test_pairs_that_do_not_become_antipodal_are_left_out():
    """Of an open arc and a disc behind it; two places of the arc are nowhere opposite."""
    middle = np.array([-0.06, 0.004])
    sheets = [sheet_of(jxr.Catenary(0.02, (-0.03, 0.03))), sheet_of(jxr.Circle(0.01).moved(middle))]
    places = [[[0.004, 0.0], [0.01 * np.pi, 0.0]], [[0.025, 0.0], [-0.028, 0.0]]]
    found = _grasp_points._refined(sheets, pairs_of(places, faces=[[0, 1], [0, 0]]), 0.06)
    assert found.faces.tolist() == [[0, 1]]
    line = found.points[0, 1] - found.points[0, 0]
    line = line / np.linalg.norm(line)
    np.testing.assert_allclose(found.normals[0], [-line, line], atol=1e-12)
    np.testing.assert_allclose(found.points[0, 1], middle + 0.01 * line, atol=1e-14)
    np.testing.assert_allclose(found.points[0, 0], sheets[0].frames(found.places[:, 0]).points[0])
