"""Points to grasp by, and hands that reach them: closed forms, SciPy, and residuals as runs measure them."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import jaxroll as jxr
from jaxroll._reaching import _choice, _grasp_points, _postures, _reach, sheet_of
from jaxroll._reaching._choice import Choice
from tests.helpers import in_single
from tests.recorded import runs
from tests.subjects.random_hands import planar_case, spatial_case

SUCCESS = jxr.RESULTS.successful
A, B = 0.02, 0.01


def demand_of(pair, normals):
    """Least friction, from angles: the larger tangent against the line between two points."""
    line = pair[1] - pair[0]
    cosines = np.array([-normals[0] @ line, normals[1] @ line]) / np.linalg.norm(line)
    return np.tan(np.arccos(np.clip(cosines, -1.0, 1.0))).max()


def test_an_ellipse_has_its_axes_as_antipodal_pairs():
    found = jxr.grasp_points(jxr.Ellipse(A, B), 0.5, count=8)
    assert len(found) == 8 and found.exact.tolist() == [True] * 2 + [False] * 6
    np.testing.assert_allclose(found.distance[:2], [2 * B, 2 * A], rtol=1e-14)
    # Which end comes first is said by its coordinates, and the seam counts as the contour's beginning.
    np.testing.assert_allclose(found.points[0], [[0.0, -B], [0.0, B]], atol=1e-15)
    np.testing.assert_allclose(found.points[1], [[-A, 0.0], [A, 0.0]], atol=1e-15)
    np.testing.assert_allclose(found.places[1][1], [0.0], atol=1e-15)
    for pair, normals, demand, exact in zip(
        found.points, found.normals, found.demand, found.exact, strict=True
    ):
        gradient = pair / np.array([A, B]) ** 2
        outward = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
        np.testing.assert_allclose(normals, outward, atol=1e-9)
        if not exact:
            np.testing.assert_allclose(demand, demand_of(pair, outward), rtol=1e-7)
    # Mirrored pairs need the same, to rounding.
    assert np.all(np.diff(found.demand) >= -1e-9) and found.demand[-1] <= 0.5


def test_places_are_those_of_the_points():
    shape = jxr.Ellipse(A, B)
    found = jxr.grasp_points(shape, 0.2, count=4)
    for pair, places in zip(found.points, found.places, strict=True):
        np.testing.assert_allclose(shape.point(np.concatenate(places)), pair, atol=1e-16)
    assert np.all(found.demand <= 0.2)


def test_a_curve_of_three_lobes_has_its_six_pairs():
    """r = 1 + a cos 3u: a diameter at angle u has r(u) + r(u + pi) = 2, stationary where sin 3u = 0."""
    curve = lambda u: 0.01 * (1.0 + 0.15 * jnp.cos(3.0 * u)) * jnp.stack([jnp.cos(u), jnp.sin(u)])  # noqa: E731
    found = jxr.grasp_points(jxr.Parametric(curve, (0.0, 2.0 * np.pi), closed=True), count=6)
    assert found.exact.all()
    np.testing.assert_allclose(found.distance[:3], 0.02, rtol=1e-9)

    def width(v):
        """Of the chord across the axis of symmetry, at right angles to it: stationary by symmetry."""
        return -2.0 * 0.01 * (1.0 + 0.15 * np.cos(3.0 * v)) * np.sin(v)

    best = minimize_scalar(width, bounds=(1.2, 2.6), method="bounded", options={"xatol": 1e-12})
    np.testing.assert_allclose(found.distance[3:], -best.fun, rtol=1e-9)


def test_two_faces_and_a_ball_have_families_of_pairs():
    plates = jxr.grasp_points(jxr.scenes.rectangle(), 0.5, count=5)
    assert plates.exact.all() and set(map(tuple, plates.faces)) <= {(0, 1), (1, 0)}
    np.testing.assert_allclose(plates.distance, 0.03, rtol=1e-13)
    ball = jxr.grasp_points(jxr.Sphere(A), 0.5, count=6)
    assert ball.exact.all()
    np.testing.assert_allclose(ball.points[:, 0], -ball.points[:, 1], atol=1e-12)
    apart = np.linalg.norm(ball.points[:, None, 0] - ball.points[None, :, 0], axis=-1)
    assert apart[np.triu_indices(6, 1)].min() > 0.1 * A


def test_pairs_of_a_family_lie_apart_and_leave_room_for_others():
    """Of a spheroid every diameter of the waist is one, and so is its axis."""
    found = jxr.grasp_points(jxr.Ellipsoid(0.02, 0.02, 0.025), 0.3, count=12)
    wide = found.distance > 0.045
    round_, along = found.points[found.exact & ~wide], found.points[wide]
    np.testing.assert_allclose(along, [[[0.0, 0.0, -0.025], [0.0, 0.0, 0.025]]], atol=1e-12)
    np.testing.assert_allclose(round_[:, 0], -round_[:, 1], atol=1e-12)
    angles = np.sort(np.arctan2(round_[:, 0, 1], round_[:, 0, 0]) % np.pi)
    # As pairs of points that lie on the waist within 0.12 of the size, 50 mm, would be one.
    assert 8 <= len(angles) <= 10
    assert np.diff([*angles, angles[0] + np.pi]).min() > 2 * np.arcsin(0.0029 / 0.02)


def test_an_ellipsoid_has_three():
    found = jxr.grasp_points(jxr.Ellipsoid(0.03, 0.02, 0.01), 0.3, count=4)
    assert found.exact.tolist() == [True, True, True, False]
    np.testing.assert_allclose(found.distance[:3], [0.02, 0.04, 0.06], rtol=1e-13)


LINKS, MASSES, TIP = [0.06, 0.05], [0.03, 0.02], jxr.Circle(0.01)


def two_fingers(**options):
    """Two fingers of two links beside each other, under a disc."""
    fingers = [jxr.Finger(LINKS, MASSES, TIP, base=(x, 0.0), **options) for x in (-0.03, 0.03)]
    disc = jxr.FreeObject.uniform(jxr.Circle(0.02), density=20.0)
    return jxr.Grasp(disc, fingers, [jxr.Contact(finger=0), jxr.Contact(finger=1)])


SIDES, POSE = [(-0.02, 0.0), (0.02, 0.0)], (0.003, 0.08, 0.4)


def worst_residual(found):
    left = jxr.residuals(*found.start)
    return max(float(np.abs(part).max()) for part in (left.normal, left.tangential, left.tangency))


def two_links(base, goal, elbow):
    """Joint angles of two links whose end is at a goal: the law of cosines."""
    arm = np.subtract(goal, base)
    bend = elbow * np.arccos((arm @ arm - LINKS[0] ** 2 - LINKS[1] ** 2) / (2.0 * LINKS[0] * LINKS[1]))
    aside = np.arctan2(LINKS[1] * np.sin(bend), LINKS[0] + LINKS[1] * np.cos(bend))
    return np.array([np.arctan2(arm[1], arm[0]) - aside, bend])


def test_two_links_against_the_law_of_cosines():
    grasp = two_fingers()
    cos, sin = np.cos(POSE[2]), np.sin(POSE[2])
    for elbow in ((1, 1), (1, -1), (-1, 1)):
        found = jxr.reach(grasp, SIDES, pose=POSE, elbow=elbow)
        assert found.result == SUCCESS and found.reason == "" and found.postures == (2, 2)
        assert worst_residual(found) <= 1e-14 and found.gap <= 1e-14
        np.testing.assert_array_equal(found.state.q[:3], POSE)
        for i, side in enumerate((-1.0, 1.0)):
            # The tip's centre is one radius of the disc and one of the tip from the disc's centre.
            goal = POSE[:2] + side * 0.03 * np.array([cos, sin])
            wanted = two_links((-0.03 + 0.06 * i, 0.0), goal, elbow[i])
            np.testing.assert_allclose(found.state.q[3 + 2 * i : 5 + 2 * i], wanted, atol=1e-12)


def test_single_precision_has_the_same_pairs_and_postures():
    """No posture closed contacts to 1e-13 there, and no pair counted as antipodal."""
    pairs = in_single(lambda: jxr.grasp_points(jxr.Ellipse(A, B), count=3))
    assert pairs.exact.tolist() == [True, True, False]
    np.testing.assert_allclose(pairs.points[:2], [[[0, -B], [0, B]], [[-A, 0], [A, 0]]], atol=1e-7)
    found = in_single(lambda: jxr.reach(two_fingers(), SIDES, pose=POSE, elbow=(1, -1)))
    assert found.result == SUCCESS and found.postures == (2, 2), found.reason
    for i, side in enumerate((-1.0, 1.0)):
        goal = POSE[:2] + side * 0.03 * np.array([np.cos(POSE[2]), np.sin(POSE[2])])
        wanted = two_links((-0.03 + 0.06 * i, 0.0), goal, (1, -1)[i])
        np.testing.assert_allclose(found.state.q[3 + 2 * i : 5 + 2 * i], wanted, atol=1e-5)


def test_a_start_stays_near_the_guess_and_holds_joints():
    fingers = [jxr.Finger([0.05, 0.04, 0.03], [0.02] * 3, TIP, base=(x, 0.0)) for x in (-0.03, 0.03)]
    grasp = jxr.Grasp(two_fingers().object, fingers, two_fingers().contacts)
    first = jxr.reach(grasp, SIDES, pose=POSE)
    assert first.result == SUCCESS
    moved = first.state.q.at[:3].add(jnp.array([0.002, -0.001, 0.05]))
    guess = jxr.State(moved, first.state.v, first.state.s)
    again = jxr.reach(grasp, SIDES, guess=guess, hold=["finger 0 q[2]", "finger 1 q[2]"])
    assert again.result == SUCCESS and again.gap <= 1e-14
    kept = np.array([0, 1, 2, 5, 8])
    np.testing.assert_array_equal(again.state.q[kept], moved[kept])
    assert np.abs(again.state.q - moved).max() < 0.3


def test_links_keep_away_from_the_object_where_they_have_a_radius():
    """With its elbow inwards a finger's last link passes the disc more closely than with it outwards."""
    inwards = jxr.reach(two_fingers(), SIDES, pose=(0.0, 0.08, 0.0), elbow=(1, -1))
    assert inwards.result == SUCCESS and inwards.links < 0.004
    # Lines from joint to joint, against the disc's centre; `links` looks at 16 points of each.
    middle = np.array([0.0, 0.08])
    lines = [pair for chain in joints_of(inwards) for pair in zip(chain[:-1], chain[1:], strict=True)]
    least = min(segment(*pair, middle) for pair in lines) - 0.02
    assert least - 1e-12 <= inwards.links <= least + 2e-4
    free = jxr.reach(two_fingers(), SIDES, pose=(0.0, 0.08, 0.0), link_radius=0.004)
    assert free.result == SUCCESS and free.links >= 0.004
    stuck = jxr.reach(two_fingers(), SIDES, pose=(0.0, 0.08, 0.0), elbow=(1, -1), link_radius=0.004)
    assert stuck.result == jxr.RESULTS.links_meet and "come within" in stuck.reason


def joints_of(found):
    """Joints of every finger of two links, in the world."""
    for finger, q in zip(found.grasp.fingers, np.asarray(found.state.q[3:]).reshape(-1, 2), strict=True):
        headings = np.cumsum(q)
        steps = np.asarray(finger.lengths)[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=1)
        yield np.asarray(finger.base) + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def segment(one, other, point):
    """Distance of a point from a segment."""
    along = other - one
    share = np.clip((point - one) @ along / (along @ along), 0.0, 1.0)
    return np.linalg.norm(one + share * along - point)


def test_why_a_start_is_not_closed_is_said():
    far = jxr.reach(two_fingers(), SIDES, pose=(0.0, 0.2, 0.0))
    assert far.result == jxr.RESULTS.unreachable and "reaches 0.12 m at most" in far.reason
    # The farthest point of a tip counts: here it is 10 mm from a middle 50 mm from the last link's end.
    aside = [jxr.Finger(LINKS, MASSES, TIP.moved((0.03, 0.04)), base=(x, 0.0)) for x in (-0.03, 0.03)]
    grasp = jxr.Grasp(two_fingers().object, aside, two_fingers().contacts)
    assert "reaches 0.17 m at most" in jxr.reach(grasp, SIDES, pose=(0.0, 0.3, 0.0)).reason
    # A large fingertip does not fit into a hollow.
    bean = lambda u: 0.02 * (1.0 + 0.45 * jnp.cos(2.0 * u)) * jnp.stack([jnp.cos(u), jnp.sin(u)])  # noqa: E731
    body = jxr.FreeObject.uniform(jxr.Parametric(bean, (0.0, 2.0 * np.pi), closed=True), 20.0)
    blunt = [jxr.Finger(LINKS, MASSES, jxr.Circle(0.02), base=(0.0, 0.08 * side)) for side in (-1.0, 1.0)]
    grasp = jxr.Grasp(body, blunt, [jxr.Contact(finger=0), jxr.Contact(finger=1)])
    waist = np.array([[0.0, -0.011], [0.0, 0.011]])
    stuck = jxr.reach(grasp, waist)
    assert stuck.result == jxr.RESULTS.penetration and stuck.overlap > 1e-4 and "overlaps" in stuck.reason


def turned(vectors, angle):
    return vectors @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def gaps_and_tilts(grasp, state):
    """Of every contact in the plane: links end to end, and the shapes' points and normals there."""
    q = iter(np.split(np.asarray(state.q), np.cumsum([3, *(f.joints for f in grasp.fingers)])[:-1]))
    x, y, angle = next(q)
    for contact, finger, joints in zip(grasp.contacts, grasp.fingers, q, strict=True):
        tip, face = grasp.shapes(contact)
        headings = np.cumsum(joints)
        end = finger.base + finger.lengths @ np.stack([np.cos(headings), np.sin(headings)], axis=1)
        point = end + turned(np.asarray(tip.point(contact.s_tip)), headings[-1])
        other = np.array([x, y]) + turned(np.asarray(face.point(contact.s_object)), angle)
        normals = turned(tip.normal(contact.s_tip), headings[-1]) + turned(
            face.normal(contact.s_object), angle
        )
        yield np.linalg.norm(point - other), np.linalg.norm(normals)


@pytest.mark.parametrize("seed", range(4))
def test_random_hands_in_the_plane(seed):
    grasp, points, pose = planar_case(1000 + seed)
    found = jxr.reach(grasp, points, pose=pose)
    assert found.result == SUCCESS, found.reason
    assert max(map(max, gaps_and_tilts(*found.start))) <= 1e-12
    for contact, face, point in zip(found.grasp.contacts, grasp.object.contours * 2, points, strict=True):
        np.testing.assert_allclose(face.point(contact.s_object), point, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_random_hands_in_space(seed):
    grasp, points, pose = spatial_case(1000 + seed)
    found = jxr.reach(grasp, points, pose=pose)
    assert found.result == SUCCESS, found.reason
    assert worst_residual(found) <= 1e-12


@pytest.mark.slow
def test_an_object_that_is_let_go_turns_between_two_plates():
    """Plates do not turn: an ellipse that is tilted between them does, until they face its ends."""
    plates = [
        jxr.Jaw(jxr.Line().moved(angle=angle), 0.1, [0.0], base=(x, 0.0))
        for angle, x in ((0.0, -0.05), (np.pi, 0.05))
    ]
    body = jxr.FreeObject.uniform(jxr.Ellipse(A, 0.7 * A), 20.0)
    grasp = jxr.Grasp(body, plates, [jxr.Contact(finger=0), jxr.Contact(finger=1)])
    ends = [(-A, 0.0), (A, 0.0)]
    straight = jxr.reach(grasp, ends)
    assert straight.result == SUCCESS
    np.testing.assert_allclose(straight.state.q[3:], [0.03, -0.03], rtol=1e-12)
    assert jxr.reach(grasp, ends, pose=(0.0, 0.0, 0.3)).result == jxr.RESULTS.unreachable
    free = jxr.reach(grasp, ends, pose=(0.0, 0.0, 0.3), hold_object=False)
    assert free.result == SUCCESS and worst_residual(free) <= 1e-12
    assert float(free.state.q[2]) < 0.3


def test_a_finger_touches_two_walls_at_once():
    """A round tip in a corner: its centre is one radius from both walls, which face down and aside."""
    angles = np.radians([-60.0, -120.0])
    walls = [jxr.Line().moved(angle=angle) for angle in angles]
    finger = jxr.Finger(LINKS, MASSES, TIP, base=(-0.03, 0.0))
    contacts = [jxr.Contact(finger=0, contour=0), jxr.Contact(finger=0, contour=1)]
    grasp = jxr.Grasp(jxr.FreeObject(walls, mass=0.1, inertia=1e-5), [finger], contacts)
    centre = np.array([0.0, -0.01 / np.cos(np.radians(30.0))])
    points = centre - 0.01 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    found = jxr.reach(grasp, points, pose=(0.0, 0.08, 0.0), elbow=1)
    assert found.result == SUCCESS, found.reason
    wanted = two_links((-0.03, 0.0), centre + (0.0, 0.08), 1)
    np.testing.assert_allclose(found.state.q[3:], wanted, atol=1e-12)
    for contact, wall, point in zip(found.grasp.contacts, walls, points, strict=True):
        np.testing.assert_allclose(wall.point(contact.s_object), point, atol=1e-14)


def test_one_elbow_is_that_of_all_fingers():
    one, each = (jxr.reach(two_fingers(), SIDES, pose=POSE, elbow=e) for e in (-1, (-1, -1)))
    assert one.result == SUCCESS and np.all(np.asarray(one.state.q)[[4, 6]] < 0.0)
    np.testing.assert_array_equal(one.state.q, each.state.q)


def test_an_object_that_fingers_reach_is_not_moved_though_it_may_be(monkeypatch):
    held = jxr.reach(two_fingers(), SIDES, pose=POSE)
    monkeypatch.setattr(_reach, "close", None)
    free = jxr.reach(two_fingers(), SIDES, pose=POSE, hold_object=False)
    np.testing.assert_array_equal(free.state.q, held.state.q)


@pytest.mark.parametrize("limited", [False, True])
def test_letting_the_object_go_hides_nothing_that_was_asked_of_the_fingers(limited):
    """Fingers that get there, beyond their limits or with links in the object, start from there as little."""
    limits = [(-0.2, 0.2)] * 2 if limited else None
    fingers = [jxr.Finger(LINKS, MASSES, TIP, base=(x, 0.0), limits=limits) for x in (-0.03, 0.03)]
    grasp = jxr.Grasp(two_fingers().object, fingers, two_fingers().contacts)
    wanted = jxr.RESULTS.joint_limit if limited else jxr.RESULTS.links_meet
    radius = None if limited else 0.1
    for hold in (True, False):
        found = jxr.reach(grasp, SIDES, pose=(0.0, 0.08, 0.0), hold_object=hold, link_radius=radius)
        assert found.result == wanted and found.reason.startswith("finger 0: ")


def test_fingers_that_do_not_get_there_are_not_wound_up():
    """A search may end whole turns off; the limits are those of the angles next to zero."""
    limits = [(-3.1, 3.1)] * 2
    fingers = [jxr.Finger(LINKS, MASSES, TIP, base=(x, 0.0), limits=limits) for x in (-0.03, 0.03)]
    grasp = jxr.Grasp(two_fingers().object, fingers, two_fingers().contacts)
    far = jxr.reach(grasp, SIDES, pose=(0.0, 0.13, 0.0))
    assert far.result == jxr.RESULTS.unreachable and np.abs(far.state.q[3:]).max() <= np.pi + 1e-12
    free = jxr.reach(grasp, SIDES, pose=(0.0, 0.13, 0.0), hold_object=False)
    assert free.result == SUCCESS, free.reason


@pytest.mark.slow
@pytest.mark.parametrize("ends, wanted", [((-1.0, 1.0), "successful"), ((0.0, 0.001), "joint_limit")])
def test_fingers_that_an_object_was_let_go_for_keep_what_they_were_asked_for(ends, wanted):
    """The plates of `test_an_object_that_is_let_go_turns_between_two_plates`, one with a limit."""
    tilted = [jxr.Line().moved(angle=angle) for angle in (0.0, np.pi)]
    plates = [jxr.Jaw(tilted[0], 0.1, [0.0], base=(-0.05, 0.0), limits=[ends])]
    plates.append(jxr.Jaw(tilted[1], 0.1, [0.0], base=(0.05, 0.0)))
    body = jxr.FreeObject.uniform(jxr.Ellipse(A, 0.7 * A), 20.0)
    grasp = jxr.Grasp(body, plates, [jxr.Contact(finger=0), jxr.Contact(finger=1)])
    found = jxr.reach(grasp, [(-A, 0.0), (A, 0.0)], pose=(0.0, 0.0, 0.3), hold_object=False)
    assert found.result == getattr(jxr.RESULTS, wanted), found.reason
    assert worst_residual(found) <= 1e-12 and np.isfinite(found.links)


# Postures by their overlaps, the distances of their links and these on average, joints, and which is taken.
CLEARANCES = {
    "the links that are farthest": ([0, 0], [2e-3, 3e-3], [9e-3, 3e-3], [[0.1], [0.9]], 1),
    "of these on average": ([0, 0], [2e-3 + 1e-13, 2e-3], [3e-3, 4e-3], [[0.1], [0.9]], 1),
    "of these with the smallest angles": ([0, 0], [2e-3, 2e-3], [3e-3 + 1e-13, 3e-3], [[0.9], [-0.1]], 1),
    "of these the lower angle": ([0, 0], [2e-3, 2e-3], [3e-3, 3e-3], [[0.1 - 1e-13], [-0.1]], 1),
    "before all one that overlaps less": ([2e-6, 1e-6], [3e-3, 2e-3], [3e-3, 2e-3], [[0.1], [0.9]], 1),
    "touching is no overlap": ([2e-8, 1e-8], [3e-3, 2e-3], [3e-3, 2e-3], [[0.1], [0.9]], 0),
}


@pytest.mark.parametrize("case", CLEARANCES)
@pytest.mark.parametrize("turned", [False, True])
def test_which_posture_is_taken(case, turned, monkeypatch):
    overlaps, links, average, q, wanted = (np.array(x) for x in CLEARANCES[case])
    order = slice(None, None, -1 if turned else 1)
    seen = tuple(np.asarray(x, float)[order] for x in (overlaps, links, average))
    monkeypatch.setattr(_choice, "_clearances", lambda *_: seen)
    found = _postures.Postures(q[order], np.zeros((2, 1, 1)), np.zeros(2), np.zeros(2))
    wish = _choice.Wish(0, None, None, -np.inf)
    one, overlap, away = _choice._best(SimpleNamespace(length=0.1), found, wish, None)
    assert one.q.tolist() == [q[wanted].tolist()]
    assert (overlap, away) == (overlaps[wanted], links[wanted])


def test_of_postures_whose_links_meet_the_object_that_is_taken_that_does_so_least(monkeypatch):
    postures = _postures.Postures(
        np.array([[0.1], [0.2], [0.3]]), np.zeros((3, 1, 1)), np.zeros(3), np.zeros(3)
    )
    seen = (np.zeros(3), np.array([1e-3, 2e-3, 5e-3]), np.zeros(3))
    monkeypatch.setattr(_choice, "_clearances", lambda *_: seen)
    reacher = SimpleNamespace(finger=SimpleNamespace(turns=True), length=0.1)
    # With a guess the nearest of those that stay clear, without it the farthest away; if none does, the best.
    for guess, radius, wanted in (
        (0.0, 1.5e-3, 0.2),
        (None, 1.5e-3, 0.3),
        (0.0, 6e-3, 0.3),
        (0.0, 1e-4, 0.1),
    ):
        near = None if guess is None else np.array([guess])
        one, _, _ = _choice._best(reacher, postures, _choice.Wish(0, near, None, radius), None)
        assert one.q.tolist() == [[wanted]]


def test_joints_at_their_limits_are_within_them():
    limits = np.array([[-0.5, 1.0], [0.0, 2.0]])
    q = np.array([[-0.5, 2.0], [1.0, 0.0], [-0.5 - 1e-13, 2.0 + 1e-13], [-0.5 - 1e-10, 1.0], [0.0, 2.1]])
    found = _postures.Postures(q, np.zeros((5, 1, 1)), np.zeros(5), np.zeros(5))
    assert _choice._within(None, found, limits).tolist() == [True, True, True, False, False]
    assert _choice._within(None, found, None).all()


def test_pairs_differ_by_the_larger_distance_of_their_ends_in_either_order():
    one = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    pairs = one + np.array([[[1.0, -1.0, 1.0], [0.0, 0.0, 0.0]], [[3.0, 2.0, 0.0], [-3.0, 0.0, 0.5]]])
    np.testing.assert_allclose(_grasp_points._apart(pairs, one), [np.sqrt(3.0), 2.0])


def test_samples_are_shared_among_the_faces_of_an_object():
    sheets = [sheet_of(jxr.Circle(A).moved((x, 0.0))) for x in (-0.05, 0.0, 0.05)]
    for count in (1, 2, 3):
        found = _grasp_points._sampled(sheets[:count], None)
        assert len(found.points) == 384 and np.bincount(found.faces[:, 0]).tolist() == [384 // count] * count


def test_an_object_without_bounds_is_looked_at_within_its_outline():
    boxed = SimpleNamespace(object=SimpleNamespace(outline=np.array([0.06, 0.08, 0.24])))
    assert _reach._extent(boxed) == pytest.approx(0.13)
    assert _reach._extent(SimpleNamespace(object=SimpleNamespace(outline=None))) == _reach._EXTENT


def test_jaws_and_stages_without_limits_reach_what_is_before_them():
    """A jaw along one axis and a stage along two: displacements are how far the faces are from the object."""
    jaws = [
        jxr.Jaw(jxr.Line().moved(angle=0.0), 0.1, [0.0], base=(-0.05, 0.0)),
        jxr.Jaw(jxr.Circle(0.004), 0.1, [0.0, 0.5 * np.pi], base=(0.07, -0.03)),
    ]
    disc = jxr.FreeObject.uniform(jxr.Circle(A), density=20.0)
    grasp = jxr.Grasp(disc, jaws, [jxr.Contact(finger=0), jxr.Contact(finger=1)])
    found = jxr.reach(grasp, [(-A, 0.0), (A, 0.0)], pose=(0.001, 0.002, 0.0))
    assert found.result == SUCCESS, found.reason
    np.testing.assert_allclose(found.state.q[3:], [0.031, A + 0.004 + 0.001 - 0.07, 0.032], atol=1e-12)
    assert worst_residual(found) <= 1e-14


@pytest.mark.parametrize("shape", [0.0, 0.5])
def test_pairs_of_one_width_are_in_the_order_of_their_ends(shape):
    """A curve of four lobes has two pairs of each width, whichever way it is turned before it is sampled."""
    angles = 2.0 * np.pi * (np.arange(96) + shape) / 96
    radii = A * (1.0 + 0.02 * np.cos(4.0 * angles))
    curve = jxr.Spline(np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1))
    found = jxr.grasp_points(curve, 0.5, count=4)
    assert found.exact.all()
    thin, thick = 0.98 * A * np.sqrt(0.5), 1.02 * A
    wanted = [
        [(-thin, -thin), (thin, thin)],
        [(-thin, thin), (thin, -thin)],
        [(-thick, 0.0), (thick, 0.0)],
        [(0.0, -thick), (0.0, thick)],
    ]
    np.testing.assert_allclose(found.points, wanted, atol=2e-6)


def test_many_postures_are_placed_in_parts():
    finger = jxr.Finger(LINKS, MASSES, TIP, base=(0.01, 0.02))
    q = np.random.default_rng(8).uniform(-3.0, 3.0, (150, 2))
    origin, turn, origin_rate, turn_rate = _postures.placed_at(finger, q)
    headings, base = np.cumsum(q, axis=1), np.asarray(finger.base)
    ways = np.stack([np.cos(headings), np.sin(headings)], axis=2)
    ends = base + np.einsum("k,nkd->nd", LINKS, ways)
    np.testing.assert_allclose(origin, ends, atol=1e-15)
    np.testing.assert_allclose(turn[:, :, 0], ways[:, 1], atol=1e-15)
    # Each joint turns what is beyond it.
    for joint, pivot in enumerate((base, base + LINKS[0] * ways[:, 0])):
        arm = ends - pivot
        np.testing.assert_allclose(origin_rate[..., joint], np.stack([-arm[:, 1], arm[:, 0]], 1), atol=1e-15)
        np.testing.assert_allclose(turn_rate[:, :, 0, joint], turn[:, :, 1], atol=1e-15)


def test_half_a_turn_is_pi_whatever_its_rounding():
    grasp = two_fingers()
    reacher = SimpleNamespace(length=0.1, finger=grasp.fingers[0], free=np.array([True, True]))
    q = np.array([[-np.pi + 1e-14, 0.3], [np.pi - 1e-14, 0.3], [3.5, -4.0], [-np.pi + 1e-9, 0.3]])
    found = _postures.Postures(q, np.zeros((4, 1, 1)), np.zeros(4), np.zeros(4))
    kept = _postures.touching(reacher, found).q
    wanted = [[np.pi, 0.3], [3.5 - 2.0 * np.pi, 2.0 * np.pi - 4.0], [-np.pi + 1e-9, 0.3]]
    np.testing.assert_allclose(kept, wanted, atol=1e-13)
    # A joint that is held keeps its angle.
    reacher.free = np.array([False, True])
    np.testing.assert_allclose(_postures.touching(reacher, found.taken([2])).q, [[3.5, 2.0 * np.pi - 4.0]])


def test_arguments_that_do_not_fit_are_refused():
    grasp = two_fingers()
    calls = [
        ("contacts must have shape", lambda: jxr.reach(grasp, SIDES[:1])),
        ("contacts must be points of the object", lambda: jxr.reach(grasp, [(-0.015, 0.0), (0.02, 0.0)])),
        ("pose must have shape", lambda: jxr.reach(grasp, SIDES, pose=(0.0, 0.0))),
        ("elbow must be 1, -1 or 0", lambda: jxr.reach(grasp, SIDES, elbow=2)),
        ("elbow must be 1, -1 or 0", lambda: jxr.reach(grasp, SIDES, elbow=(1,))),
        ("guess must be a state", lambda: jxr.reach(grasp, SIDES, hold="finger 0")),
        (
            "hold must name",
            lambda: jxr.reach(
                grasp, SIDES, guess=jxr.State(np.zeros(7), np.zeros(7), np.zeros(2)), hold="thumb"
            ),
        ),
        (
            "guess.q must have shape",
            lambda: jxr.reach(grasp, SIDES, guess=jxr.State(np.zeros(3), np.zeros(3), np.zeros(1))),
        ),
        ("contacts must be a real number", lambda: jxr.reach(grasp, None)),
        ("grasp must be a Grasp", lambda: jxr.reach(None, SIDES)),
        ("object must be one or more", lambda: jxr.grasp_points(3)),
        (
            "object must be of the plane or of space",
            lambda: jxr.grasp_points([jxr.Circle(0.01), jxr.Sphere(0.01)]),
        ),
        ("friction must be positive", lambda: jxr.grasp_points(jxr.Circle(0.01), 0.0)),
        ("count must be a whole number", lambda: jxr.grasp_points(jxr.Circle(0.01), count=0)),
        (
            "object must have a boundary",
            lambda: jxr.grasp_points(
                jxr.geometry.Implicit(lambda x, y, z: x * x + y * y + z * z - 1e-4, radius=0.005)
            ),
        ),
    ]
    for words, call in calls:
        with pytest.raises(ValueError, match=f"argument {words}"):
            call()


def test_of_a_straight_line_there_are_no_pairs():
    assert len(jxr.grasp_points(jxr.Line((0.0, 0.1)))) == 0


def test_an_object_in_space_is_asked_for_at_a_pose_of_length_one():
    grasp, state = runs.scene("pinch3d")
    upright = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(_reach._object_at(grasp, None, None), upright)
    np.testing.assert_array_equal(_reach._object_at(grasp, None, state), state.q[:7])
    given = [0.1, 0.2, 0.3, 0.0, 3.0, 0.0, 4.0]
    np.testing.assert_allclose(_reach._object_at(grasp, given, state), [0.1, 0.2, 0.3, 0.0, 0.6, 0.0, 0.8])
    with pytest.raises(ValueError, match="argument pose must end with a quaternion, but was"):
        _reach._object_at(grasp, np.zeros(7), None)
    # So is that of a guess, whose quaternion may have any length.
    long = jxr.State(state.q.at[3:7].multiply(2.5), state.v, state.s)
    np.testing.assert_allclose(_reach._object_at(grasp, None, long), state.q[:7], rtol=1e-15)
    none = jxr.State(state.q.at[3:7].set(0.0), state.v, state.s)
    with pytest.raises(ValueError, match=r"argument guess must have in q\[3:7\] a quaternion, but was"):
        jxr.reach(grasp, np.zeros((2, 3)), guess=none)
    plane, start = runs.scene("pinch")
    np.testing.assert_array_equal(_reach._object_at(plane, None, None), np.zeros(3))
    np.testing.assert_array_equal(_reach._object_at(plane, [1.0, 2.0, 3.0], start), [1.0, 2.0, 3.0])


@pytest.mark.parametrize("name", ["pinch", "pinch3d"])
def test_postures_of_all_fingers_are_one_start(name):
    """Of two fingers, the second of which is held up: its code and reason, and the worst of each number."""
    grasp, state = runs.scene(name)
    k = grasp.form.positions
    chosen = []
    for i, code in enumerate(("successful", "unreachable")):
        places = np.full((1, 1, 3 if grasp.spatial else 1), 0.1 * (i + 1))
        posture = SimpleNamespace(
            q=np.full((1, k[1 + i]), 0.5 + i),
            places=places,
            gaps=np.array([1e-13 * i]),
            tilts=np.array([2e-13]),
        )
        chosen.append(Choice(posture, code, "why not" * i, 1e-6 * i, 0.02 - 0.01 * i, 5 + i))
    at = [np.full(3 if grasp.spatial else 1, -0.3), np.full(3 if grasp.spatial else 1, -0.4)]
    found = _reach._assembled(grasp, np.asarray(state.q[: k[0]]), chosen, at)
    np.testing.assert_allclose(found.state.q, [*state.q[: k[0]], *[0.5] * k[1], *[1.5] * k[2]])
    if grasp.spatial:
        np.testing.assert_allclose(found.state.s, np.repeat([0.1, -0.3, 0.2, -0.4], 3))
    else:
        places = [(float(c.s_tip), float(c.s_object)) for c in found.grasp.contacts]
        np.testing.assert_allclose(places, [(0.1, -0.3), (0.2, -0.4)])
    assert (found.result, found.reason) == (jxr.RESULTS.unreachable, "finger 1: why not")
    assert (found.gap, found.tilt, found.overlap, found.links) == (1e-13, 2e-13, 1e-6, 0.01)
    assert found.postures == (5, 6)


@pytest.mark.parametrize("off", [0.0, 1e-3])
def test_what_is_let_go_is_taken_where_it_closes(monkeypatch, off):
    grasp, state = runs.scene("pinch")
    asked = []

    def closed(grasp, state, **options):
        asked.append(options)
        return grasp, state

    left = SimpleNamespace(
        normal=jnp.array([0.0, off]), tangential=jnp.zeros(2), tangency=jnp.array([-2e-14, 1e-14])
    )
    monkeypatch.setattr(_reach, "close", closed)
    monkeypatch.setattr(_reach, "residuals", lambda grasp, state: left)
    before = jxr.Reach(grasp, state, jxr.RESULTS.unreachable, "far", 1.0, 2.0, 0.1, 0.2, (3, 4))
    found = _reach._let_go(before, "finger 0 q[1]")
    assert asked == [{"hold_contacts": False, "throw": False, "hold": "finger 0 q[1]"}]
    if off:
        assert found is before
        return
    assert (found.result, found.reason, found.gap, found.tilt) == (jxr.RESULTS.successful, "", 0.0, 2e-14)
    assert (found.overlap, found.links, found.postures) == (0.1, 0.2, (3, 4))
