"""Pieces of the searches for points to hold by and for postures, against hand-worked values and NumPy."""

import functools
from types import SimpleNamespace

import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._reaching import _choice, _grasp_points, _overlap, _postures, _reach, sheet_of
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
    pairs.normals[1, 1] = ways(np.arctan2(4, 3) + 1.5e-9)[0]
    found = _grasp_points._reported(sheets, pairs, 2)
    assert len(found) == 2 and found.exact.tolist() == [True, False]
    np.testing.assert_allclose(found.distance, 0.5)
    np.testing.assert_allclose(found.demand, [0.0, 1.5e-9], rtol=1e-5)
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


# Sheets and what is outside of an object.


def test_a_place_of_a_surface_after_a_step_is_on_it_beside_the_stepped_point():
    """On a ball: below the end of the tangent step, which is any combination of both tangents."""
    sheet = sheet_of(jxr.Sphere(0.03))
    at = 0.03 * np.array([[0.6, 0.0, 0.8], [-0.48, 0.6, 0.64]])
    steps = np.array([[0.004, -0.001], [0.002, 0.005]])
    here = sheet.frames(at)
    ends = at + np.einsum("nk,nkd->nd", steps, here.tangents)
    wanted = 0.03 * ends / np.linalg.norm(ends, axis=1)[:, None]
    np.testing.assert_allclose(sheet.moved(at, steps), wanted, atol=1e-15)


def test_bends_of_a_surface_are_how_its_normals_turn():
    sheet, h = sheet_of(jxr.Ellipsoid(0.03, 0.02, 0.012)), 1e-6
    unit = np.array([[0.36, 0.48, 0.8], [-0.64, 0.6, 0.48]])
    at = unit * [0.03, 0.02, 0.012]
    here = sheet.frames(at)
    np.testing.assert_allclose(here.points, at, atol=1e-15)
    gradient = at / np.array([0.03, 0.02, 0.012]) ** 2
    np.testing.assert_allclose(here.normals, gradient / np.linalg.norm(gradient, axis=1)[:, None], atol=1e-14)
    axes = np.concatenate([here.normals[:, None], here.tangents], axis=1)
    np.testing.assert_allclose(axes @ np.swapaxes(axes, 1, 2), [np.eye(3)] * 2, atol=1e-14)
    for b in range(2):
        ahead, behind = (sheet.frames(sheet.moved(at, s * h * np.eye(2)[[b, b]])).normals for s in (1, -1))
        turning = np.einsum("nkd,nd->nk", here.tangents, (ahead - behind) / (2.0 * h))
        np.testing.assert_allclose(here.bends[:, :, b], turning, rtol=1e-6, atol=1e-6)


def test_frames_of_many_places_are_those_of_each():
    at = np.linspace(-0.2, 0.7, 1300)[:, None]
    here = sheet_of(jxr.Circle(0.05).moved((0.3, 0.1), 0.4)).frames(at)
    out = ways(*(at[:, 0] / 0.05 + 0.4))
    np.testing.assert_allclose(here.points, [0.3, 0.1] + 0.05 * out, atol=1e-15)
    np.testing.assert_allclose(here.normals, out, atol=1e-14)
    np.testing.assert_allclose(here.tangents[:, 0], out @ turned(np.pi / 2).T, atol=1e-14)
    assert here.bends.shape == (1300, 1, 1) and np.allclose(here.bends, 20.0)


def test_a_foot_is_found_from_the_far_side_too():
    """A point in a disc, nearest to a place beyond the centre from where the search begins."""
    sheet = sheet_of(jxr.Circle(0.02))
    point = 0.015 * ways(0.3)
    for start in (3.0, -2.2, 1.9):
        found = sheet.feet(point, np.array([[0.02 * start]]), 60)
        np.testing.assert_allclose(sheet.frames(found).points, 0.02 * ways(0.3), atol=1e-12)


def test_points_are_outside_of_an_object_by_the_farthest_of_its_faces():
    """Of a plate by both of its faces, of a disc by one; past ends by the way to them."""
    points = np.array([[0.03, 0.002], [0.004, 0.01], [-0.06, 0.04], [0.0, 0.0]])
    plate = _overlap.sampled_object([sheet_of(x) for x in jxr.scenes.rectangle(0.02, 0.05).contours], 0.1)
    np.testing.assert_allclose(_overlap.heights(plate, points), [0.02, -0.006, np.hypot(0.07, 0.015), -0.01])
    disc = _overlap.sampled_object([sheet_of(jxr.Circle(0.02).moved((0.01, 0.0)))], 0.1)
    wanted = np.linalg.norm(points - [0.01, 0.0], axis=1) - 0.02
    np.testing.assert_allclose(_overlap.heights(disc, points), wanted, atol=1e-12)
    endless = _overlap.sampled_object([sheet_of(jxr.Line().moved((0.01, 0.0), 0.3))], 0.1)
    np.testing.assert_allclose(_overlap.heights(endless, points), (points - [0.01, 0.0]) @ ways(0.3)[0])
    # A line along y: beside its end the way counts where it is off the normal by some degrees.
    line = _overlap.sampled_object([sheet_of(jxr.Line((-0.02, 0.03)))], 0.1)
    off = np.radians([2.0, 3.0, 40.0, 110.0])
    beside = [0.0, 0.03] + 0.05 * ways(*off)
    np.testing.assert_allclose(_overlap.heights(line, beside), [0.05 * np.cos(off[0]), 0.05, 0.05, 0.05])


def test_faces_with_ends_are_those_that_do_not_go_round():
    shapes = [jxr.Line((-0.02, 0.03)), jxr.Line(), jxr.Circle(0.02), jxr.Plane(), jxr.Sphere(0.02)]
    assert [_overlap._has_ends(sheet_of(shape)) for shape in shapes] == [True, False, False, False, False]


# Postures.


def damped(rows, slopes, damping):
    square = slopes.T @ slopes
    return -np.linalg.solve(square + damping * np.diag(np.diag(square)), slopes.T @ rows)


def test_steps_are_damped_by_the_diagonal():
    rng = np.random.default_rng(2)
    rows, slopes = rng.normal(size=(3, 6)), rng.normal(size=(3, 6, 4)) * [0.1, 1.0, 7.0, 2.0]
    damping = np.array([1e-3, 0.5, 30.0])
    found = _postures._damped(rows, slopes, damping)
    wanted = [damped(*each) for each in zip(rows, slopes, damping, strict=True)]
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    # A direction in which nothing changes is not gone.
    slopes[..., 1] = 0.0
    found = _postures._damped(rows, slopes, damping)
    assert np.isfinite(found).all() and np.abs(found[:, 1]).max() == 0.0


@functools.cache
def reacher_of(free=(True, True), length=0.13):
    """A finger of two links with an elliptic tip that is aside of its frame."""
    tip = jxr.Ellipse(0.012, 0.008).moved((0.003, -0.002), 0.4)
    finger = jxr.Finger([0.06, 0.05], [0.03, 0.02], tip, base=(0.01, 0.02))
    sheet = sheet_of(tip)
    places = sheet.sampled(384, 0.05)
    return _postures.Reacher(finger, sheet, np.array(free), length, places, sheet.frames(places))


def tip_at(reacher, q, places):
    """Points and normals of the tip in the world, of one posture."""
    headings = np.cumsum(q)
    origin = np.array([0.01, 0.02]) + np.array([0.06, 0.05]) @ ways(*headings)
    here = reacher.tip.frames(places)
    turn = turned(headings[-1])
    return origin + here.points @ turn.T, here.normals @ turn.T


TARGETS = _postures.TouchPoints(np.array([[0.07, 0.04], [0.02, 0.11]]), ways(2.0, -0.7))


def test_rows_and_slopes_of_postures_are_those_of_their_points():
    """Two contacts of one tip; slopes by central differences. A joint that is held changes nothing."""
    reacher, h = reacher_of(free=(True, False)), 1e-6
    q, places = np.array([[0.3, 0.9], [-0.4, 1.7]]), np.array([[[0.004], [0.02]], [[0.011], [0.033]]])
    _, _, error, rows, slopes, bends = _postures._evaluated(reacher, TARGETS, q, places)

    def rows_of(i, step):
        points, normals = tip_at(reacher, q[i] + step[:2], places[i] + step[2:, None])
        gaps = (points - TARGETS.points) / 0.13
        return np.concatenate([gaps.ravel(), (normals + TARGETS.normals).ravel()])

    for i in range(2):
        np.testing.assert_array_equal(bends[i], reacher.tip.frames(places[i]).bends)
        np.testing.assert_allclose(rows[i], rows_of(i, np.zeros(4)), atol=1e-14)
        np.testing.assert_allclose(error[i], np.sum(rows[i] ** 2))
        for k, step in enumerate(h * np.eye(4)):
            wanted = (rows_of(i, step) - rows_of(i, -step)) / (2.0 * h)
            np.testing.assert_allclose(slopes[i, :, k], 0.0 * wanted if k == 1 else wanted, atol=1e-7)
    # What is not a number is farther than all else.
    q[0, 0] = np.nan
    assert np.isinf(_postures._evaluated(reacher, TARGETS, q, places)[2]).tolist() == [True, False]


def test_a_search_begins_where_the_tip_faces_its_targets():
    reacher, q = reacher_of(), np.array([[0.3, 0.9], [-0.4, 1.7], [2.0, 0.1]])
    found = _postures._facing(reacher, TARGETS, q)
    assert found.shape == (3, 2, 1)
    for posture, places in zip(q, found, strict=True):
        _, normals = tip_at(reacher, posture, places)
        np.testing.assert_allclose(np.sum(normals * TARGETS.normals, axis=1), -1.0, atol=0.01)


def test_places_of_a_tip_are_shifted_by_less_than_half_its_radius():
    reacher = reacher_of()
    places = np.array([[[0.004], [0.02]], [[0.011], [0.033]]])
    steps = np.array([[1e-4, -2e-4], [3e-4, 1.0]])
    bends = reacher.tip.frames(places.reshape(4, 1)).bends.reshape(2, 2, 1, 1)
    length = float(np.diff(reacher.tip.shape.domain())[0])
    wanted = places[..., 0] + [[1e-4, -2e-4], [3e-4, 0.5 / bends[1, 1, 0, 0]]]
    found = _postures._shifted(reacher.tip, places, bends, steps)
    np.testing.assert_allclose(found[..., 0] % length, wanted % length)


def test_what_a_search_leaves_is_told_in_metres_and_by_normals():
    """Two targets that one tip cannot touch at once: the larger gap, and the larger sum of two normals."""
    reacher, limits = reacher_of(), np.array([[-0.2, 0.6], [0.5, 1.1]])
    starts = np.random.default_rng(5).uniform(-3.0, 3.0, (10, 2))
    found = _postures.searched_postures(reacher, TARGETS, np.clip(starts, *limits.T), limits)
    assert found.q.shape == (64, 2) and found.places.shape == (64, 2, 1)
    assert np.all((found.q >= limits[:, 0]) & (found.q <= limits[:, 1]))
    for i in (0, 5, 9):
        points, normals = tip_at(reacher, found.q[i], found.places[i])
        gaps = np.linalg.norm(points - TARGETS.points, axis=1)
        tilts = np.linalg.norm(normals + TARGETS.normals, axis=1)
        np.testing.assert_allclose((found.gaps[i], found.tilts[i]), (gaps.max(), tilts.max()), rtol=1e-9)


def stands(q, gaps=None, tilts=None):
    n = len(q)
    zero = np.zeros(n)
    return _postures.Postures(
        np.array(q, float),
        np.arange(n, dtype=float).reshape(n, 1, 1),
        zero if gaps is None else np.array(gaps),
        zero if tilts is None else np.array(tilts),
    )


def test_a_posture_touches_where_its_points_and_normals_meet_to_rounding():
    q = [[0.1], [0.2], [0.3], [0.4], [0.1 + 0.9e-6], [0.3 + 1.5e-6]]
    found = stands(q, [0.9e-14, 1.5e-14, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.8e-11, 1.5e-11, 0.0, 0.0])
    reacher = SimpleNamespace(length=0.1, finger=SimpleNamespace(turns=False), free=np.array([True]))
    assert _postures.touching(reacher, found).places.ravel().tolist() == [0.0, 2.0, 5.0]
    # Of a tiny finger, to what is rounding of a millimetre.
    small = SimpleNamespace(length=1e-5, finger=SimpleNamespace(turns=False), free=np.array([True]))
    tiny = stands([[0.1], [0.2]], [0.9e-16, 1.5e-16])
    assert _postures.touching(small, tiny).places.ravel().tolist() == [0.0]
    # Displacements are not brought within a turn.
    assert _postures.touching(reacher, stands([[7.0]])).q.tolist() == [[7.0]]


def test_frames_in_space_have_their_axes_as_columns():
    from scipy.spatial.transform import Rotation

    body, turn = jxr.scenes.cuboid(), Rotation.from_rotvec([0.3, -0.8, 0.5])
    q = np.concatenate([[0.1, -0.2, 0.3], np.roll(turn.as_quat(), 1)])
    origin, way = _postures.poses_at(body, q[None])
    np.testing.assert_allclose(origin, q[None, :3])
    np.testing.assert_allclose(way[0], turn.as_matrix(), atol=1e-15)


def test_origins_of_tips_are_the_ends_of_the_links():
    grasp, _ = runs.scene("pinch")
    q = np.array([0.3, 0.2, 0.1, 1.0, -0.5, 0.3, 0.9, 0.8])
    found = _postures.tip_origins(grasp, q)
    for finger, joints, end in zip(grasp.fingers, (q[3:6], q[6:]), found, strict=True):
        links = np.asarray(finger.lengths) @ ways(*np.cumsum(joints))
        np.testing.assert_allclose(end, np.asarray(finger.base) + links, atol=1e-15)


# Which posture is taken, and what is said where none is.


def chosen(monkeypatch, found, wish=None, *, clear=None, touches=None, targets=1, later=None, length=0.1):
    """The choice among postures that a search is said to find, of which some are said to touch."""
    answers = [found] + ([] if later is None else [later])
    monkeypatch.setattr(_choice, "searched_postures", lambda *_: answers.pop(0))
    kept = slice(None) if touches is None else touches
    monkeypatch.setattr(_choice, "touching", lambda reacher, found: found.taken(kept))
    overlaps, links = (np.zeros(9), np.full(9, 0.05)) if clear is None else clear
    seen = lambda reacher, some, _: (overlaps[: len(some.q)], links[: len(some.q)], links[: len(some.q)])  # noqa: E731
    monkeypatch.setattr(_choice, "_clearances", seen)
    finger = SimpleNamespace(joints=2, turns=True, base=np.array([0.01, 0.02]))
    reacher = SimpleNamespace(finger=finger, length=length, free=np.array([True, True]))
    points = np.array([[0.04, 0.06], [0.07, 0.10]])[:targets]
    wish = wish or _choice.Wish(0, None, None, -np.inf)
    return _choice.chosen_posture(reacher, _postures.TouchPoints(points, 0.0 * points), wish, None)


JOINTS = [[0.4, -1.0], [0.3, 1.2], [0.2, 0.7]]


def test_a_posture_that_touches_and_overlaps_nothing_is_taken(monkeypatch):
    one = chosen(monkeypatch, stands(JOINTS))
    assert (one.code, one.reason, one.count, one.overlap, one.links) == ("successful", "", 3, 0.0, 0.05)
    assert one.posture.q.tolist() == [[0.2, 0.7]]  # the smallest angles
    for elbow, wanted in ((1, [0.2, 0.7]), (-1, [0.4, -1.0])):
        one = chosen(monkeypatch, stands(JOINTS), _choice.Wish(elbow, None, None, -np.inf))
        assert one.code == "successful" and one.posture.q.tolist() == [wanted]
    one = chosen(monkeypatch, stands(JOINTS[1:]), _choice.Wish(-1, None, None, -np.inf))
    assert (one.code, one.count, one.overlap, one.links) == ("unreachable", 2, 0.0, np.inf)
    assert one.posture.q.tolist() == [[0.3, 1.2]] and "other sign than elbow=-1" in one.reason
    one = chosen(monkeypatch, stands(JOINTS), _choice.Wish(0, np.array([0.3, 1.1]), None, -np.inf))
    assert one.posture.q.tolist() == [[0.3, 1.2]]  # the nearest to the guess
    # A finger that touches nothing may stay where its search began.
    one = chosen(monkeypatch, stands(JOINTS), touches=[], targets=0)
    assert one.code == "successful" and one.posture.q.tolist() == [[0.4, -1.0]]


def test_where_none_touches_the_nearest_is_told(monkeypatch):
    """By gaps over the finger's length and sums of normals together; why, by the target that is too far."""
    nearest = stands(JOINTS, [0.03, 0.02, 0.06], [0.2, 0.35, 0.05])
    one = chosen(monkeypatch, nearest, touches=[])
    assert (one.code, one.overlap, one.links, one.count) == ("unreachable", 0.0, np.inf, 0)
    assert one.posture.q.tolist() == [[0.4, -1.0]]
    assert one.reason.startswith("its nearest posture leaves 0.03 m and normals that are 0.2 off")
    far = SimpleNamespace(finger=SimpleNamespace(base=np.array([0.01, 0.02]), turns=True), length=0.0999)
    targets = _postures.TouchPoints(np.array([[0.04, 0.06], [0.07, 0.10]]), None)
    said = _choice._too_far(far, targets, nearest.taken([1]))
    assert said == "a target is 0.1 m from its base, and it reaches 0.0999 m at most"
    far.length = 0.1001
    assert _choice._too_far(far, targets, nearest.taken([1])).startswith("its nearest posture leaves 0.02 m")
    # Jaws slide as far as they must, and a stage has no base.
    jaw = SimpleNamespace(base=far.finger.base, turns=False)
    for finger in (jaw, SimpleNamespace(turns=True)):
        said = _choice._too_far(SimpleNamespace(finger=finger, length=0.01), targets, nearest.taken([0]))
        assert said.startswith("its nearest posture leaves 0.03")


def test_the_joint_that_is_least_beyond_its_limit_is_told(monkeypatch):
    limits = np.array([[-0.1, 0.25], [-0.5, 0.6]])
    one = chosen(
        monkeypatch, stands(JOINTS), _choice.Wish(0, None, limits, -np.inf), later=stands(JOINTS[:2])
    )
    assert (one.code, one.count, one.overlap, one.links) == ("joint_limit", 3, 0.0, np.inf)
    assert one.posture.q.tolist() == [[0.4, -1.0]]
    assert one.reason == "joint 1 would have to be 0.1 beyond its limit"
    below = _choice._beyond(stands([[-0.4, 0.0], [0.9, -0.7]]), limits)
    assert below == "joint 0 would have to be 0.3 beyond its limit"
    # A second search that stays within the limits may find one.
    inside = stands([[0.9, 0.0], [0.1, 0.5]])
    one = chosen(monkeypatch, stands(JOINTS), _choice.Wish(0, None, limits, -np.inf), later=inside)
    assert (one.code, one.count, one.posture.q.tolist()) == ("successful", 3, [[0.1, 0.5]])


def test_overlaps_and_links_that_meet_are_told(monkeypatch):
    wish = _choice.Wish(0, None, None, 0.004)
    for overlap, links, code in (
        (0.9e-7, 0.004, "successful"),
        (1.1e-7, 0.004, "penetration"),
        (0.0, 0.0039, "links_meet"),
        (2e-4, 0.0039, "penetration"),
    ):
        one = chosen(monkeypatch, stands(JOINTS[:1]), wish, clear=(np.array([overlap]), np.array([links])))
        assert (one.code, one.overlap, one.links, one.count) == (code, overlap, links, 1)
        assert (str(links) in one.reason) == (code == "links_meet")
        assert (f"overlaps the object by {overlap:.3g} m" in one.reason) == (code == "penetration")
    # What an overlap is, the size of the finger says.
    for length, code in ((0.12, "successful"), (0.1e-3, "penetration")):
        one = chosen(monkeypatch, stands(JOINTS[:1]), length=length, clear=(np.array([1.1e-7]), np.ones(1)))
        assert one.code == code


def test_postures_are_looked_at_some_at_a_time_until_one_overlaps_nothing(monkeypatch):
    """By a guess the nearest first: of the first dozen all overlap, one of the next does not."""
    asked = []

    def seen(reacher, some, _):
        asked.append(len(some.q))
        overlaps = np.where(some.q[:, 0] > 1.35, 0.0, 1e-3 * some.q[:, 0])
        return overlaps, 0.02 + some.q[:, 0], some.q[:, 0]

    monkeypatch.setattr(_choice, "_clearances", seen)
    reacher = SimpleNamespace(finger=SimpleNamespace(turns=True), length=0.1)
    many = stands(np.arange(40, 0, -1)[:, None] / 10)
    wish = _choice.Wish(0, np.array([0.0]), None, 0.0)
    one, overlap, links = _choice._best(reacher, many, wish, None)
    assert asked == [12, 12] and one.q.tolist() == [[1.4]] and (overlap, links) == (0.0, pytest.approx(1.42))
    # If all overlap, or links meet, the best of all.
    one, overlap, links = _choice._best(reacher, many.taken(many.q[:, 0] < 1.35), wish, None)
    assert (
        asked[2:] == [12, 1] and one.q.tolist() == [[0.1]] and (overlap, links) == (1e-4, pytest.approx(0.12))
    )
    one, overlap, links = _choice._best(reacher, many, wish._replace(link_radius=9.0), None)
    assert (
        asked[4:] == [12, 12, 12, 4]
        and one.q.tolist() == [[4.0]]
        and (overlap, links) == (0.0, pytest.approx(4.02))
    )


def test_searches_start_within_the_limits_and_about_the_guess():
    turning = SimpleNamespace(joints=2, turns=True)
    reacher = SimpleNamespace(finger=turning, length=0.1, free=np.array([True, False]))
    targets = _postures.TouchPoints(np.array([[0.3, -0.7]]), None)
    spread = lambda starts: np.stack([starts.min(axis=0), starts.max(axis=0)])  # noqa: E731
    free = _choice._starts(reacher, targets, _choice.Wish(0, None, None, 0.0))
    assert free.shape == (64, 2)
    np.testing.assert_allclose(spread(free), [[-np.pi] * 2, [np.pi] * 2], atol=0.3)
    limits = np.array([[-0.5, 9.0], [1.0, 1.5]])
    kept = _choice._starts(reacher, targets, _choice.Wish(0, None, limits, 0.0))
    np.testing.assert_allclose(spread(kept), [[-0.5, 1.0], [np.pi, 1.5]], atol=0.2)
    assert np.all(kept >= limits[:, 0]) and np.all(kept[:, 1] <= 1.5)
    # Limits that are beyond a turn leave one number.
    beyond = _choice._starts(
        reacher, targets, _choice.Wish(0, None, np.array([[4.0, 5.0], [-1.0, 1.0]]), 0.0)
    )
    assert np.all(beyond[:, 0] == 4.0)
    guess = np.array([0.3, 0.8])
    near = _choice._starts(reacher, targets, _choice.Wish(0, guess, limits, 0.0))
    assert near[0].tolist() == [0.3, 0.8] and np.all(near[:, 1] == 0.8)  # the second joint is held
    about = near[1:16, 0] - 0.3
    assert abs(about.mean()) < 0.6 and 0.3 < about.std() < 1.5
    np.testing.assert_array_equal(near[16:, 0], kept[16:, 0])
    jaw = SimpleNamespace(finger=SimpleNamespace(joints=1, turns=False), length=0.1, free=np.array([True]))
    far = _choice._starts(jaw, targets, _choice.Wish(0, None, None, 0.0))
    np.testing.assert_allclose(spread(far), [[-0.8], [0.8]], atol=0.1)
    none = _postures.TouchPoints(np.zeros((0, 2)), None)
    near = _choice._starts(jaw, none, _choice.Wish(0, None, None, 0.0))
    np.testing.assert_allclose(spread(near), [[-0.15], [0.15]], atol=0.02)


def test_how_deep_a_tip_overlaps_and_how_far_its_links_stay():
    """Of a disc that is aside of the object's frame, which is turned; 70 postures, as more than one batch."""
    reacher, middle, pose, angle = reacher_of(), np.array([0.01, -0.02]), np.array([0.05, 0.06]), 0.7
    solid = _overlap.sampled_object([sheet_of(jxr.Circle(0.03).moved(middle))], 0.1)
    q = np.random.default_rng(1).uniform(-1.0, 2.0, (70, 2))
    found = _choice._clearances(
        reacher, _postures.Postures(q, None, None, None), (solid, pose[None], turned(angle)[None])
    )
    centre = pose + turned(angle) @ middle
    share = np.linspace(0.0, 1.0, 16)[:, None]
    overlaps = []
    for i in range(70):
        headings = np.cumsum(q[i])
        joints = np.array([0.01, 0.02]) + np.concatenate(
            [[[0.0, 0.0]], np.cumsum(ways(*headings) * [[0.06], [0.05]], axis=0)]
        )
        links = np.concatenate([a + share * (b - a) for a, b in zip(joints[:-1], joints[1:], strict=True)])
        away = np.linalg.norm(links - centre, axis=1) - 0.03
        np.testing.assert_allclose((found[1][i], found[2][i]), (away.min(), away.mean()), atol=1e-6)
        tip = joints[-1] + reacher.samples.points @ turned(headings[-1]).T
        overlaps.append(max(0.0, 0.03 - np.linalg.norm(tip - centre, axis=1).min()))
    np.testing.assert_allclose(found[0], overlaps, atol=1e-6)
    assert 5 < np.count_nonzero(overlaps) < 65
    assert _choice._links(np.zeros((3, 4, 2))) == [(0, 1), (1, 2), (2, 3)]
    assert _choice._links(np.zeros((3, 1, 2))) == [(0, 0)]


# What `reach` is asked for.


def test_points_of_an_object_are_given_by_themselves_or_by_places():
    body = jxr.FreeObject([jxr.Circle(0.02), jxr.Line((-0.03, 0.03)).moved((0.1, 0.0))], 0.1, 1e-5)
    fingers = [jxr.Finger([0.05], [0.02], jxr.Circle(0.01))] * 2
    contacts = [jxr.Contact(finger=0, contour=1), jxr.Contact(finger=1, contour=0)]
    grasp = jxr.Grasp(body, fingers, contacts)
    faces = [sheet_of(x) for x in body.contours]
    solid = _overlap.sampled_object(faces, 0.1)
    at = _reach._places_on(grasp, faces, solid, [(0.1, 0.013), 0.02 * ways(0.7)[0]])
    np.testing.assert_allclose(np.ravel(at), [0.013, 0.02 * 0.7], atol=1e-12)
    at = _reach._places_on(grasp, faces, solid, [0.013, 0.004])
    assert [x.tolist() for x in at] == [[0.013], [0.004]]
    for given in ([0.1], [[0.1, 0.2, 0.3]] * 2, 0.3, np.zeros((2, 1, 1)), np.zeros((1, 2))):
        with pytest.raises(
            ValueError, match=r"argument contacts must have shape \(2, 2\), or be a place for"
        ):
            _reach._places_on(grasp, faces, solid, given)
    # By a hundredth of the object's size, 0.12 m, a point may be off.
    _reach._foot(solid, 1, np.array([0.1011, 0.0]))
    with pytest.raises(ValueError, match=r"argument contacts must be points of the object.* 0.0013 m from"):
        _reach._foot(solid, 1, np.array([0.1013, 0.0]))
    # So it is however far from the body's origin its faces lie.
    away = _overlap.sampled_object([sheet_of(x.moved((50.0, -20.0))) for x in body.contours], 0.1)
    _reach._foot(away, 1, np.array([50.1011, -20.0]))
    with pytest.raises(ValueError, match=r"argument contacts must be points of the object.* 0.0013 m from"):
        _reach._foot(away, 1, np.array([50.1013, -20.0]))
    targets = _reach._targets(grasp, faces, at, np.array([0.3, -0.2, 0.4]))
    points = np.array([[0.1, 0.013], 0.02 * ways(0.2)[0]])
    normals = np.array([[1.0, 0.0], ways(0.2)[0]])
    np.testing.assert_allclose(targets.points, [0.3, -0.2] + points @ turned(0.4).T, atol=1e-15)
    np.testing.assert_allclose(targets.normals, normals @ turned(0.4).T, atol=1e-15)


def test_a_finger_is_measured_by_its_links_and_its_tip():
    grasp, state = runs.scene("pinch")
    first, second = (_reach._reacher(grasp, i, (4, 7)) for i in (0, 1))
    assert first.free.tolist() == [True, False, True] and second.free.tolist() == [True, False]
    for reacher in (first, second):
        tip = np.hypot(*reacher.tip.frames(reacher.places).points.T).max()
        np.testing.assert_allclose(reacher.length, 0.13 + tip)
        assert len(reacher.places) == 384
    q = np.arange(8.0)
    guess = jxr.State(q, state.v, state.s)
    assert [_reach._joints(grasp, guess, i).tolist() for i in (0, 1)] == [[3.0, 4.0, 5.0], [6.0, 7.0]]
    assert _reach._joints(grasp, None, 0) is None
    plain, thick = SimpleNamespace(), SimpleNamespace(link_radius=0.003, limits=[(0, 1)])
    assert [_reach._radius(x, r) for x in (plain, thick) for r in (None, 0.002)] == [
        -np.inf,
        0.002,
        0.003,
        0.002,
    ]
    assert _reach._limits(plain) is None and _reach._limits(thick).tolist() == [[0.0, 1.0]]
    assert _reach._elbows(None, 3) == [0, 0, 0] and _reach._elbows((1, 0, -1), 3) == [1, 0, -1]
    for elbow in (True, (1, 2), [1, 1.0], "up"):
        with pytest.raises(ValueError, match="argument elbow must be 1, -1 or 0"):
            _reach._elbows(elbow, 2)


def test_places_past_an_end_of_their_face_are_refused():
    """Of an open contour and of a sheet in space; round a closed contour a place may go on."""
    box = jxr.scenes.rectangle(0.03, 0.05)
    fingers = [jxr.Finger([0.06, 0.05], [0.03, 0.02], jxr.Circle(0.01), base=(x, 0.0)) for x in (-0.03, 0.03)]
    contacts = [jxr.Contact(finger=i, contour=i) for i in (0, 1)]
    with pytest.raises(
        ValueError, match=r"argument contacts must be .*, but .*0.03.* is 0.005 m past .* face 1"
    ):
        jxr.reach(jxr.Grasp(box, fingers, contacts), [-0.025, 0.03])
    sheet = jxr.geometry.Patch(
        np.stack([*np.meshgrid(*2 * [0.01 * np.arange(6)], indexing="ij"), np.zeros((6, 6))], -1)
    )
    for place in ((0.0, 5.0), (2.5, 2.5)):
        _reach._check_on(sheet_of(sheet), 0, np.array(place))
    for place in ((-0.1, 2.5), (2.5, 5.1)):
        with pytest.raises(ValueError, match=r"is 0.001 m past one of face 2"):
            _reach._check_on(sheet_of(sheet), 2, np.array(place))
    _reach._check_on(sheet_of(jxr.Circle(0.01)), 0, np.array([3.0]))
    _reach._check_on(sheet_of(jxr.Catenary(0.01)), 0, np.array([3.0]))
