"""Pieces of the pinch of any object: the order of what is tried, lines between tips, hands and gains."""

from types import SimpleNamespace

import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._reaching import Frames
from jaxroll.scenes import _any_pinch, _pinch_targets
from tests.recorded import runs


def ways(*angles):
    """Unit vectors of the plane."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def pairs_of(points, demand=None):
    points = np.array(points, float)
    distance = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
    demand = np.zeros(len(points)) if demand is None else np.array(demand)
    normals = (points[:, [1, 0]] - points) / distance[:, None, None]
    return SimpleNamespace(points=points, distance=distance, demand=demand, normals=-normals)


def test_pairs_of_points_are_ranked_by_friction_arm_and_width():
    """Numbers of each by hand: all points are within a box whose longer side is 10."""
    given = pairs_of(
        [
            [[-5.0, 0.0], [5.0, 0.0]],  # through the centre of mass, as wide as any: 0.3
            [[1.0, -2.0], [1.0, 2.0]],  # passes it at 1 in 10: 0.1 + 0.3 * 0.4 = 0.22
            [[-1.0, -2.0], [-1.0, 2.0]],  # the same: it comes later
            [[2.0, -1.0], [2.0, 1.0]],  # 0.2 + 0.3 * 0.2 = 0.26
            [[0.0, 2.0], [0.0, -2.0]],  # 0.12, and friction of 0.15: 0.27
        ],
        demand=[0.0, 0.0, 0.0, 0.0, 0.15],
    )
    assert _any_pinch._ranked(given).tolist() == [1, 2, 3, 4, 0]
    given.demand[1] += 1e-11
    assert _any_pinch._ranked(given).tolist() == [1, 2, 3, 4, 0]
    given.demand[1] += 1e-8
    assert _any_pinch._ranked(given).tolist() == [2, 1, 3, 4, 0]
    # The middle may be far from the centre of mass if the line is not.
    aside = pairs_of([[[1.0, 1.0], [3.0, 3.0]], [[0.5, -1.0], [0.5, 1.9]]])
    assert _any_pinch._ranked(aside).tolist() == [0, 1]


def test_some_poses_of_each_pair_are_tried_before_more_of_any(monkeypatch):
    counts = {2: 3, 0: 19, 1: 8}
    monkeypatch.setattr(_any_pinch, "_ranked", lambda pairs: np.array([2, 0, 1]))
    monkeypatch.setattr(_any_pinch, "_placed", lambda object, tips, pairs, row: iter(range(counts[row])))
    found = list(_any_pinch._in_turn(None, None, None))
    first = [(2, i) for i in range(3)] + [(0, i) for i in range(8)] + [(1, i) for i in range(8)]
    assert found == first + [(0, i) for i in range(8, 19)]


def tips_of(middles, radius, joints=3, ball=None):
    finger = SimpleNamespace(joints=joints)
    q = np.arange(float(len(middles)))[:, None]
    return _any_pinch._Tips(finger, np.array(middles, float), radius, q, ball)


def test_lines_between_tips_are_those_about_as_long_as_wanted():
    """Tips of radius 1 and 2 about an object of 3: middles are to be 6 apart."""
    left = tips_of([[0.0, 0.0], [1.0, 1.0], [0.0, 0.0], [0.0, 0.0]], 1.0)
    right = tips_of([[8.0, 0.0], [1.0, 6.5], [0.0, -12.5], [0.0, 11.9]], 2.0)
    found = list(_any_pinch._lines_between([left, right], 3.0))
    # Off by 0.5, 2 and 5.9; by 6.5, as much as itself, is too far.
    assert [hand for hand, _, _ in found] == [[left.finger, right.finger]] * 3
    np.testing.assert_allclose(
        [middle for _, (middle, _), _ in found], [[1.0, 3.75], [4.0, 0.0], [0.0, 5.95]]
    )
    np.testing.assert_allclose([along for _, (_, along), _ in found], [[0.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    assert [held for _, _, held in found] == [None] * 3
    # Six of each two fingers are looked at, twelve of all.
    many = [tips_of(np.array([[9.0 * i, 0.01 * k] for k in range(9)]), 1.0) for i in range(3)]
    found = list(_any_pinch._lines_between(many, 3.0))
    assert len(found) == 12 and all(hand[0] is not hand[1] for hand, _, _ in found)
    assert len(list(_any_pinch._lines_between(many[:2], 3.0))) == 6
    offs = [abs(np.linalg.norm(many[0].middles[0] - many[1].middles[0]) - 5.0)]
    assert offs == [4.0] and all(
        np.allclose(np.abs(along), [1.0, 0.0], atol=0.01) for _, (_, along), _ in found
    )


def test_fingers_of_few_joints_are_held_where_both_tips_are_round():
    ball = (np.array([0.1, 0.2]), 0.5)
    far = np.array([[6.0, 0.0], [9.0, 0.0]])
    for joints, round_, wanted in (((1, 2), True, True), ((2, 2), True, False), ((2, 1), False, False)):
        one = tips_of(0.0 * far, 1.0, joints[0], ball)
        other = tips_of(far, 2.0, joints[1], (ball[0] + 1.0, 0.7) if round_ else None)
        (_, _, held), _ = _any_pinch._lines_between([one, other], 3.0)
        assert (held is not None) == wanted
        if wanted:
            assert held.fingers == (one.finger, other.finger) and held.radii == (0.5, 0.7)
            np.testing.assert_array_equal(held.q, [[0.0], [0.0]])
            np.testing.assert_allclose(held.centres, [[0.1, 0.2], [1.1, 1.2]])


def test_two_tips_are_put_as_far_apart_as_is_wanted():
    """Fingers of one link each, whose tips' centres are aside of the links' ends."""
    tip = jxr.Circle(0.012).moved((0.004, 0.003))
    fingers = tuple(jxr.Finger([0.06], [0.03], tip, base=(x, 0.01)) for x in (-0.03, 0.03))
    centre, q = np.array([0.004, 0.003]), (np.array([1.4]), np.array([1.3]))
    held = _any_pinch._Held(fingers, q, (centre, centre), (0.012, 0.012))

    def centres(angles):
        bases = np.array([[-0.03, 0.01], [0.03, 0.01]])
        away = np.hypot(0.064, 0.003)
        return bases + away * ways(*(np.array(angles) + np.arctan2(0.003, 0.064)))

    for i, finger in enumerate(fingers):
        place, rates = _any_pinch._centre(finger, q[i], centre)
        at, ahead, behind = (centres([x + s for x in (1.4, 1.3)])[i] for s in (0.0, 1e-6, -1e-6))
        np.testing.assert_allclose(place, at, atol=1e-15)
        np.testing.assert_allclose(rates[:, 0], (ahead - behind) / 2e-6, atol=1e-9)
    middle, along = _any_pinch._apart(held, 0.072)
    ends = middle - 0.036 * along, middle + 0.036 * along
    for end, base, start in zip(ends, ((-0.03, 0.01), (0.03, 0.01)), (1.4, 1.3), strict=True):
        arm = end - base
        np.testing.assert_allclose(np.linalg.norm(arm), np.hypot(0.064, 0.003), rtol=1e-12)
        angle = np.arctan2(arm[1], arm[0]) - np.arctan2(0.003, 0.064)
        assert 0.02 < abs(angle - start) < 0.1
    assert _any_pinch._apart(held, 0.25) is None
    tight = tuple(
        jxr.Finger([0.06], [0.03], tip, base=(x, 0.01), limits=[(a - 0.01, a + 0.01)])
        for x, a in ((-0.03, 1.4), (0.03, 1.3))
    )
    assert _any_pinch._apart(held._replace(fingers=tight), 0.072) is None


def test_round_tips_are_told_from_all_others():
    """By their points less a radius along the normals: one point of a ball alone."""
    rng = np.random.default_rng(7)
    for middle in (np.array([0.004, 0.003]), np.array([0.1, 0.2, 0.3])):
        normals = rng.normal(size=(30, len(middle)))
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        bends = np.full((30, len(middle) - 1, len(middle) - 1), 80.0)
        centre, radius = _any_pinch._ball(Frames(middle + normals / 80.0, normals, None, bends))
        np.testing.assert_allclose(centre, middle, atol=1e-15)
        assert radius == pytest.approx(1.0 / 80.0)
        assert _any_pinch._ball(Frames(middle + normals / 80.0, normals, None, 0.0 * bends)) is None
        assert _any_pinch._ball(Frames(middle + normals / 80.0, normals, None, -bends)) is None
        for off, round_ in ((1e-9, True), (3e-9, False)):
            points = middle + normals / 80.0
            points[3, 1] += 0.5 * off / 80.0
            assert (_any_pinch._ball(Frames(points, normals, None, bends)) is not None) == round_


def test_tips_are_looked_at_in_postures_within_the_joints_ranges():
    tip = jxr.Ellipse(0.012, 0.008).moved((0.004, -0.003))
    finger = jxr.Finger([0.06, 0.04], [0.03, 0.02], tip, base=(0.02, 0.01), limits=[(-0.5, 0.3), (1.0, 1.4)])
    found = _any_pinch._tips(finger, np.random.default_rng(3))
    assert found.q.shape == (4000, 2) and found.ball is None and found.finger is finger
    np.testing.assert_allclose(
        [found.q.min(axis=0), found.q.max(axis=0)], [[-0.5, 1.0], [0.3, 1.4]], atol=0.01
    )
    assert found.radius == pytest.approx(0.008, rel=1e-3)
    for q, middle in list(zip(found.q, found.middles, strict=True))[:70:10]:
        headings = np.cumsum(q)
        cos, sin = np.cos(headings[1]), np.sin(headings[1])
        end = np.array([0.02, 0.01]) + np.array([0.06, 0.04]) @ ways(*headings)
        aside = np.array([[cos, -sin], [sin, cos]]) @ [0.004, -0.003]
        np.testing.assert_allclose(middle, end + aside, atol=1e-6)


def test_what_may_help_is_said_of_the_fingers_that_there_are():
    own = "an object of another size or shape"
    assert _any_pinch._helps(None, False) == own == _any_pinch._helps(None, True)
    longer = f"longer fingers, wider ranges of joints, smaller tips, or {own}"
    few, many = tips_of([[0.0, 0.0]], 1.0, 1), tips_of([[0.0, 0.0]], 1.0, 2)
    round_ = tips_of([[0.0, 0.0]], 1.0, 1, ball=(np.zeros(2), 1.0))
    assert _any_pinch._helps([many, few], False) == "round tips, or 2 joints for each finger,"
    assert _any_pinch._helps([many, many], False) == longer == _any_pinch._helps([round_, many], False)
    assert _any_pinch._helps([many, many], True) == "round tips, or 3 joints for each finger,"


def test_a_hand_of_the_plane_is_the_chapters_times_its_size():
    grasp, _ = runs.scene("pinch")
    for finger, own in zip(_any_pinch._chapter_hand(3.0), grasp.fingers, strict=True):
        np.testing.assert_allclose(finger.lengths, 3.0 * np.asarray(own.lengths))
        np.testing.assert_allclose(finger.masses, 27.0 * np.asarray(own.masses))
        np.testing.assert_allclose(finger.base, 3.0 * np.asarray(own.base))
        assert float(finger.tip.radius) == pytest.approx(0.03)
    left, right = (_any_pinch._planar_contact(i, 4, 0.3) for i in (0, 1))
    assert (left.finger, left.contour, left.sense, float(left.friction)) == (0, 4, 1, 0.3)
    assert (right.finger, right.contour, right.sense, float(right.friction)) == (1, 4, -1, 0.3)


def test_gains_follow_from_the_force_or_the_weight(monkeypatch):
    ends = np.array([[0.01, 0.02, 0.0], [0.04, 0.06, 0.0]])
    monkeypatch.setattr(_any_pinch, "tip_origins", lambda grasp, q: ends)
    monkeypatch.setattr(_any_pinch, "Grasp", lambda *parts, **options: SimpleNamespace(**options))
    monkeypatch.setattr(_any_pinch, "orientations", lambda grasp, state: np.array([0.3, 0.4]))
    for name in ("pinch", "pinch3d"):
        grasp, state = runs.scene(name)
        for force, press in ((1.7, 1.7), (None, 3.0 * 9.81 * 0.02)):
            held, start = _any_pinch._controlled(grasp, state, force)
            assert start is state and float(held.controller.beta) == pytest.approx(press / 0.05)
            length = float(grasp.fingers[0].size) * grasp.fingers[0].joints
            alpha = 0.0 if grasp.spatial else 0.008 * press * length
            np.testing.assert_allclose(held.controller.alpha, alpha)
            np.testing.assert_allclose(held.controller.start, [0.0, 0.0] if grasp.spatial else [0.3, 0.4])


@pytest.mark.parametrize("reached", [True, False])
def test_round_tips_become_blunt_and_touch_where_they_did(monkeypatch, reached):
    """Half as large again, about a centre behind the old one: the tip still touches at the same point."""
    grasp, state = runs.scene("pinch")
    grasp = grasp.with_tip(0, jxr.Circle(0.01)).with_tip(1, jxr.Circle(0.012))
    code = jxr.RESULTS.successful if reached else jxr.RESULTS.penetration
    asked = []

    def answer(grasp, points, *, pose, guess):
        asked.append((grasp, points, pose, guess))
        return SimpleNamespace(result=code)

    monkeypatch.setattr(_any_pinch, "reach", answer)
    before = SimpleNamespace(grasp=grasp, state=state)
    found = _any_pinch._blunted(before, "points", "pose")
    assert (found is before) != reached
    ((blunt, *rest),) = asked
    assert rest == ["points", "pose", state]
    for i, radius in enumerate((0.01, 0.012)):
        angle = float(grasp.contacts[i].s_tip) / radius
        tip, place = blunt.fingers[i].tip, angle * 1.5 * radius
        np.testing.assert_allclose(tip.point(place), radius * ways(angle)[0], atol=1e-12)
        np.testing.assert_allclose(tip.curvature(place), 1.0 / (1.5 * radius))


def test_what_failed_is_known_by_its_fingers_points_and_normals_in_the_world():
    one, other = object(), object()
    points, normals = np.array([[0.02, 0.01], [-0.02, 0.0]]), ways(0.3, 2.9)
    pose = np.array([0.1, 0.2, 0.4])
    failed = _pinch_targets.FailedTargets()
    assert not failed.before([one, other], points, normals, pose)
    failed.add([one, other], points, normals, pose)
    assert failed.before([one, other], points, normals, pose)
    assert failed.before([one, other], points, normals, pose + [5e-10, 0.0, 0.0])
    assert not failed.before([one, other], points, normals, pose + [3e-9, 0.0, 0.0])
    assert not failed.before([other, one], points, normals, pose)
    assert not failed.before([one, other], points, -normals, pose)
    assert not failed.before([one, other], points[::-1], normals, pose)
    # Half a turn with both ends swapped is the same again, of what is alike on both sides.
    even, out = np.array([[0.02, 0.01], [-0.02, -0.01]]), ways(0.3, 0.3 + np.pi)
    failed.add([one, other], even, out, pose)
    assert failed.before([one, other], even[::-1], out[::-1], pose + [0.0, 0.0, np.pi])


def test_a_finger_reaches_as_far_as_its_links_and_its_tip():
    """A round tip of 12 mm, whose points have coordinates that add up to 17 mm at most."""
    fingers = [
        jxr.Finger([0.06, 0.03], [0.03, 0.02], jxr.Circle(0.012), base=(x, 0.01)) for x in (-0.03, 0.04)
    ]
    reach = 0.09 + 0.012 * np.sqrt(2.0)
    points = np.array([[0.0, 0.0], [0.05, 0.0]])
    for aside, said in ((reach - 1e-4, ""), (reach + 1e-4, "finger 1: a target is 0.107 m from its base")):
        pose = np.array([0.04 - 0.05 * np.cos(0.3), 0.01 + aside - 0.05 * np.sin(0.3), 0.3])
        near = np.array([[-0.03, 0.05] - pose[:2], points[1]])
        near[0] = np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]]) @ near[0]
        found = _pinch_targets.out_of_reach(fingers, near, pose)
        assert found.startswith(said) and bool(found) == bool(said)


def test_an_object_between_fingers_is_asked_for_pair_by_pair(monkeypatch):
    """A pinch with a search that is said to succeed at the third try."""
    body = jxr.FreeObject.uniform(jxr.Ellipse(0.02, 0.03), density=20.0)
    asked = []

    def answer(grasp, points, *, pose):
        asked.append((grasp, points, pose))
        code = "penetration" if len(asked) < 3 else "successful"
        return SimpleNamespace(result=getattr(jxr.RESULTS, code), reason="", grasp=grasp, state="state")

    monkeypatch.setattr(_any_pinch, "reach", answer)
    monkeypatch.setattr(_any_pinch, "_blunted", lambda found, points, pose: found)
    monkeypatch.setattr(_any_pinch, "_controlled", lambda *args: args)
    grasp, state, force = jxr.scenes.pinch_object(body, friction=0.4, force=2.0, gravity=(0.0, -1.0))
    assert len(asked) == 3 and grasp is asked[-1][0] and (state, force) == ("state", 2.0)
    for held, points, pose in asked:
        assert held.object is body and [c.finger for c in held.contacts] == [0, 1]
        assert [float(c.friction) for c in held.contacts] == [0.4, 0.4]
        np.testing.assert_allclose(held.gravity, [0.0, -1.0])
        # Each pair is the narrow one, with either end first; the left finger's point is on the left.
        turn = np.array([[np.cos(pose[2]), -np.sin(pose[2])], [np.sin(pose[2]), np.cos(pose[2])]])
        np.testing.assert_allclose(turn @ (points[1] - points[0]), [0.04, 0.0], atol=1e-12)


class Pairs(SimpleNamespace):
    """Pairs of points as `grasp_points` finds them."""

    def __len__(self):
        return len(self.points)


@pytest.mark.parametrize("axes", [2, 3])
def test_a_pinch_is_given_up_after_some_tries(monkeypatch, axes):
    """What was found unreachable is not tried again; of fingers of one's own that are too short none is."""
    if axes == 2:
        body, hand = jxr.FreeObject(jxr.Circle(0.02), 0.1, 1e-5), _any_pinch._chapter_hand(1.0)
    else:
        body, hand = jxr.scenes.spheroid(), _any_pinch._chapter_hand3(1.0)
    points = np.zeros((1, 2, axes))
    points[0, :, 0] = -0.02, 0.02
    pairs = Pairs(points=points, normals=points / 0.02, faces=np.zeros((1, 2), int))
    pose = np.zeros(3) if axes == 2 else np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    tries, given = [], []
    monkeypatch.setattr(_any_pinch, "grasp_points", lambda *args, **options: given.append(args[1:]) or pairs)
    monkeypatch.setattr(_any_pinch, "_in_turn", lambda *_: ((0, (hand, pose, (0, 1))) for _ in range(99)))
    monkeypatch.setattr(_any_pinch, "_tips_of", lambda fingers: None)
    monkeypatch.setattr(_any_pinch, "out_of_reach", lambda *_: "it is too far")

    def refused(code, **options):
        tries.clear()
        stuck = SimpleNamespace(result=getattr(jxr.RESULTS, code), reason="it is stuck")
        monkeypatch.setattr(_any_pinch, "reach", lambda *args, **options: tries.append(args) or stuck)
        with pytest.raises(ValueError) as told:
            jxr.scenes.pinch_object(body, **options)
        assert str(told.value).endswith("; an object of another size or shape may help")
        return str(told.value).removeprefix("argument fingers must reach the object, but did not ").split(";")

    most = 30 if axes == 2 else 40
    assert refused("penetration")[:2] == [f"in {most} tries", " at the last it is stuck"]
    assert len(tries) == most and given == [(0.8,)]
    for code in ("unreachable", "joint_limit"):
        assert refused(code)[:2] == ["in 1 try", " at the last it is stuck"] and len(tries) == 1
    assert refused("links_meet", fingers=hand, friction=0.3)[0] == "and none was tried: it is too far"
    assert tries == [] and given[-1] == (0.3,)
    monkeypatch.setattr(_any_pinch, "_in_turn", lambda *_: iter(()))
    assert refused("links_meet")[0].endswith("their tips are never about as far apart as it is wide")


def test_an_object_is_put_at_four_distances_from_its_hand():
    """As shares of the object's width of 90 mm, three times that of the chapter's; on the axis in space."""
    points = np.array([[[0.0, 0.1, 0.0], [0.0, 0.19, 0.0]]])
    body = SimpleNamespace(inertia=(1.0, 2.0, 3.0))
    for axes, x in ((2, 0.0825), (3, 0.0)):
        pairs = SimpleNamespace(
            points=points[..., :axes], normals=points[..., :axes], distance=np.array([0.09])
        )
        spatial = jxr.scenes.cuboid() if axes == 3 else body
        tried = list(_any_pinch._placed(spatial, None, pairs, 0))
        turns = 4 if axes == 3 else 1
        assert [order for _, _, order in tried] == ([(0, 1)] * turns + [(1, 0)] * turns) * 4
        middles = []
        for hand, pose, order in tried:
            assert len(hand) == 2 and float(hand[0].tip.radius) == pytest.approx(0.03)
            there = _pinch_targets._in_world(points[0, list(order), :axes], points[0, :, :axes], pose)[0]
            np.testing.assert_allclose(there[1] - there[0], [0.09, 0.0, 0.0][:axes], atol=1e-12)
            middles.append(there.mean(axis=0))
        ahead = np.repeat([0.345, 0.3, 0.39, 0.255], 2 * turns)
        np.testing.assert_allclose(
            middles, np.stack([x + 0 * ahead, ahead, 0 * ahead], 1)[:, :axes], atol=1e-12
        )


def test_a_frame_has_its_third_axis_near_a_direction_unless_that_is_the_first():
    """To a millionth of a radian; from there on any third axis does."""
    first, across = np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.8, 0.0])
    np.testing.assert_allclose(_any_pinch._frame(first, first + 1.5e-6 * across)[:, 2], across, atol=1e-9)
    for near in (first, -first, first + 0.5e-6 * across):
        frame = _any_pinch._frame(first, near)
        np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-12)
        assert frame[2, 0] == 1.0 and np.linalg.det(frame) == pytest.approx(1.0)
        assert abs(frame[:, 2] @ across) < 0.9
