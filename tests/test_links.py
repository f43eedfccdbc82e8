"""Links that meet the object or each other: where a run ends, what is told of it, against brute force."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._integration import _events
from jaxroll._linalg import Pose3, Vec2, Vec3
from jaxroll._mechanics import to_leaves
from jaxroll.contact import links_apart, links_clearance3
from tests.recorded import runs

CENTRE, RADIUS, TIP = np.array([0.03, 0.1]), 0.02, 0.01
THICK, HOLDER = 0.004, 0.006
RATE, LENGTH = 3.0, 0.12


def resting(t, angles, rates, tips):
    """The first finger is damped, the other one swings free."""
    return (-0.05 * rates[0], 0.0 * rates[1])


def swept(base, angle):
    """A disc that a finger touches, and a straight link that swings at it or at the finger: one program."""
    disc = jxr.PivotedObject(jxr.Circle(RADIUS), inertia=1e-3, pivot=CENTRE)
    first = jxr.Finger([0.065, 0.065], [0.045, 0.040], jxr.Circle(TIP), link_radius=HOLDER)
    other = jxr.Finger([LENGTH], [0.045], jxr.Circle(0.002), base=base, link_radius=THICK)
    # The first tip touches the disc in this direction from its centre; both links of the finger are alike.
    towards = 2.5
    tip = CENTRE + (RADIUS + TIP) * np.array([np.cos(towards), np.sin(towards)])
    bend = np.arccos(np.hypot(*tip) / 0.13)
    joints = np.arctan2(tip[1], tip[0]) + bend, -2.0 * bend
    contact = jxr.Contact(TIP * (towards - np.pi - sum(joints)), RADIUS * towards)
    grasp = jxr.Grasp(disc, [first, other], contact, controller=resting)
    return grasp, jxr.State([0.0, *joints, angle], [0.0, 0.0, 0.0, RATE], [0.0])


def along(ends, count=4001):
    return ends[0] + np.linspace(0.0, 1.0, count)[:, None] * (ends[1] - ends[0])


def chain(base, angles, lengths):
    """Joints of a finger in the plane, and its tip frame."""
    turned = np.cumsum(angles)
    steps = np.asarray(lengths)[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=1)
    return np.concatenate([[base], base + np.cumsum(steps, axis=0)])


def test_a_link_that_swings_into_the_object_ends_the_run():
    """It turns evenly: by the triangle of base, centre and the foot on the link, the time is known."""
    base = np.array([0.11, 0.1])
    start, seconds = 0.75 * np.pi, 0.4
    grasp, state = swept(base, start)
    run = jxr.simulate(grasp, state, seconds, ts=41, events=(), throw=False)
    assert run.result == jxr.RESULTS.links_meet and int(run.stats.contact) == 1
    aside = np.arcsin((RADIUS + THICK) / 0.08)
    angle = float(run.last.q[3])
    assert abs(np.pi - aside - angle) <= 1e-4
    link = along(chain(base, [angle], [LENGTH]))
    assert abs(np.linalg.norm(link - CENTRE, axis=1).min() - RADIUS - THICK) <= 2e-6
    assert "links of finger 1 meet the object" in str(run)
    with pytest.raises(RuntimeError, match="Links of finger 1"):
        jxr.simulate(grasp, state, seconds, ts=41, events=())

    # The audit tells the same of the motion that goes on, and when it was closest: the link turns evenly, and
    # all else rests.
    ts = np.linspace(0.0, seconds, 41)
    q, v, s = (np.tile(x, (41, 1)) for x in (state.q, state.v, state.s))
    q[:, 3] += RATE * ts
    states = jxr.State(q, v, s)
    run = dataclasses.replace(run, ts=jnp.asarray(ts), states=states)
    told = jxr.link_clearance(grasp, run)
    angles = np.asarray(run.states.q)[:, 3]
    links = [along(chain(base, [angle], [LENGTH])) for angle in angles]
    away = np.array([np.linalg.norm(link - CENTRE, axis=1).min() - RADIUS - THICK for link in links])
    np.testing.assert_allclose(told.object[away > 0.0, 1], away[away > 0.0], atol=2e-5)
    assert told.where == "finger 1 and the object" and told.pairs == ((0, 1),)
    held = [chain(np.zeros(2), q, [0.065, 0.065]) for q in np.asarray(run.states.q)[:, 1:3]]
    for i in (0, 20, 40):
        points = np.concatenate([along(held[i][:2], 1001), along(held[i][1:], 1001)])
        apart = np.linalg.norm(points[:, None] - links[i][None, ::8], axis=2).min() - HOLDER - THICK
        assert abs(float(told.links[i, 0]) - apart) <= 2e-4 and told.links[i, 0] <= apart + 1e-12


def test_links_of_two_fingers_that_meet_end_the_run():
    base = np.array([-0.12, -0.03])
    grasp, state = swept(base, -0.3)
    run = jxr.simulate(grasp, state, 0.5, ts=41, events=(), throw=False)
    assert run.result == jxr.RESULTS.links_meet and int(run.stats.contact) == 0
    q = np.asarray(run.last.q)
    held, link = chain(np.zeros(2), q[1:3], [0.065, 0.065]), chain(base, q[3:], [LENGTH])
    points = np.concatenate([along(held[:2]), along(held[1:])])
    gaps = np.linalg.norm(points[:, None] - along(link, 401)[None], axis=2)
    assert abs(gaps.min() - HOLDER - THICK) <= 1e-5
    told = jxr.link_clearance(grasp, run)
    assert float(told.links[0, 0]) > 1e-3 and np.isnan(float(told.links[-1, 0]))


def test_what_a_run_did_not_reach_is_no_overlap():
    """Beside open faces, whose ends no place without numbers lies between."""
    grasp, state = jxr.scenes.pivoted()
    run = jxr.simulate(grasp, state, 3.0)
    whole = jxr.link_clearance(grasp, run)
    cut = jax.tree.map(lambda x: x.at[150:].set(jnp.nan), run.states)
    told = jxr.link_clearance(grasp, dataclasses.replace(run, states=cut))
    assert np.isnan(np.asarray(told.object)[150:]).all()
    assert told.least == np.min(np.asarray(whole.object)[:150]) and told.time < 1.5


def test_links_without_a_radius_are_not_watched():
    """Of three fingers the last two: from the object, and from each other, under their own numbers."""
    finger = lambda radius: jxr.Finger([LENGTH], [0.045], jxr.Circle(0.002), link_radius=radius)  # noqa: E731
    disc = jxr.PivotedObject(jxr.Circle(RADIUS), inertia=1e-3, pivot=CENTRE)
    grasp = jxr.Grasp(disc, [finger(None), finger(HOLDER), finger(THICK)], jxr.Contact())
    numbers = []

    def watched(state):
        limits = _events._link_limits(grasp, to_leaves(state, grasp.form))
        numbers.extend(int(limit.number) for limit in limits)
        return [limit.margin for limit in limits]

    jax.eval_shape(watched, jxr.State(np.zeros(4), np.zeros(4), np.zeros(1)))
    assert numbers == [int(_events._numbered(_events._LINKS, i)) for i in (1, 2, 1)]


@pytest.mark.parametrize("kind", [Vec2, Vec3])
def test_the_distance_of_two_links_is_that_of_all_their_points(kind):
    """Crossing, parallel, end to end, and links without length."""
    count = 2 if kind is Vec2 else 3
    rng = np.random.default_rng(count)
    ends = rng.normal(size=(60, 4, count))
    ends[:10, 3] = ends[:10, 2] + ends[:10, 1] - ends[:10, 0]  # parallel
    ends[10:15, 1] = ends[10:15, 0]
    ends[15:20, 3] = ends[15:20, 2]
    ends[20, 1], ends[20, 3] = ends[20, 0], ends[20, 2]
    as_pair = lambda a, b: (kind(*a), kind(*b))  # noqa: E731
    each = jax.jit(jax.vmap(lambda e: links_apart(as_pair(e[0], e[1]), as_pair(e[2], e[3]))))
    found = np.asarray(each(ends))
    share = np.linspace(0.0, 1.0, 401)[:, None]
    for (a, b, c, d), distance in zip(ends, found, strict=True):
        one, two = a + share * (b - a), c + share * (d - c)
        brute = np.linalg.norm(one[:, None] - two[None], axis=2).min()
        assert distance <= brute + 1e-12 and brute - distance <= 0.02
        # The least distance is a stationary one: it is at an end of one link, or normal to both.
    crossing = np.array([[-1.0, -1.0, 0], [1.0, 1.0, 0], [-1.0, 1.0, 0], [1.0, -1.0, 0.0]])[:, :count]
    apart = crossing + np.array([[0.0], [0.0], [0.25], [0.25]]) * np.eye(count)[-1]
    wanted = 0.0 if kind is Vec2 else 0.25
    met, away, *_ = each(np.stack([crossing, apart] * 30))  # as many as above: the same program
    assert met == 0.0 and away == pytest.approx(wanted, abs=1e-15)


def test_links_in_space_keep_away_from_an_ellipsoid_as_all_their_points_do():
    axes, rng = np.array([0.03, 0.02, 0.015]), np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    pose = Pose3(Vec3(0.01, -0.02, 0.0), *(Vec3(*column) for column in turn.T))
    chains = 0.06 * rng.normal(size=(3, 4, 3)) + np.array([0.0, 0.0, 0.1])
    given = [[Vec3(*point) for point in points] for points in chains]
    found = jax.jit(lambda: jnp.stack(links_clearance3(pose, given, [jxr.Ellipsoid(*axes)])))()
    u = rng.normal(size=(50_000, 3))
    surface = axes * u / np.linalg.norm(u, axis=1)[:, None]
    from scipy.spatial import KDTree

    tree = KDTree(surface)
    for points, distance in zip(chains, found, strict=True):
        links = np.concatenate([along(points[i : i + 2], 801) for i in range(3)])
        local = (links - np.array([0.01, -0.02, 0.0])) @ turn
        outside = np.sum((local / axes) ** 2, axis=1) > 1.0
        assert outside.all()
        assert abs(tree.query(local)[0].min() - float(distance)) <= 2e-4


@pytest.mark.slow
def test_a_link_in_space_ends_the_run_and_is_told():
    grasp, state = jxr.scenes.pinch3d()
    swinging = jxr.Finger3(
        [(0, 0, 1.0)], [(0.0, 0.1, 0.0)], [0.03], jxr.Sphere(0.002), base=(0.1, 0.1, 0.0), link_radius=0.003
    )
    law = lambda t, angles, rates, tips: (-0.05 * rates[0], -0.05 * rates[1], 0.0 * rates[2])  # noqa: E731
    whole = jxr.Grasp(grasp.object, [*grasp.fingers, swinging], grasp.contacts, controller=law)
    q = jnp.concatenate([state.q, jnp.array([0.9])])
    v = jnp.concatenate([state.v, jnp.array([2.0])])
    start = jxr.State(q, v, state.s)
    run = jxr.simulate(whole, start, 0.6, ts=7, throw=False, events=())
    assert run.result == jxr.RESULTS.links_meet and int(run.stats.contact) == 2
    angle, at = float(run.last.q[-1]), np.asarray(run.last.q)
    tip = np.array([0.1, 0.1, 0.0]) + 0.1 * np.array([-np.sin(angle), np.cos(angle), 0.0])
    link = along(np.array([[0.1, 0.1, 0.0], tip]))
    w, x, y, z = at[3:7]
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    local = (link - at[:3]) @ turn
    # The cuboid's faces towards the fingers are its two planes.
    assert abs((np.abs(local[:, 0]) - 0.015).min() - 0.003) <= 1e-5


@jax.jit
def above_a_ball(height):
    """How far a link along x, so high above the centre of a ball of 1 mm, keeps from it [m]."""
    zero, one = jnp.zeros(()), jnp.ones(())
    pose = Pose3(Vec3(zero, zero, zero), Vec3(one, zero, zero), Vec3(zero, one, zero), Vec3(zero, zero, one))
    place = lambda x, y: Vec3(x * one, y * one, height * one)  # noqa: E731
    link = [[place(-0.0831, 0.02), place(0.1169, 0.02)]]
    return links_clearance3(pose, link, [jxr.geometry.Sphere(0.001).moved((0.0, 0.02, 0.0))])[0]


@pytest.mark.parametrize("height", [0.004, 0.03])
def test_the_lowest_place_of_a_link_is_found_to_rounding(height):
    """A ball of 1 mm below a link of 0.2 m, past which the distance bends within a few millimetres."""
    assert float(above_a_ball(height)) == pytest.approx(height - 0.001, abs=1e-15)


def test_links_beside_the_ends_of_faces_keep_away_as_all_their_points_do():
    """Of the pinch's rectangle: past the ends of both faces the one on the other side counted."""
    (grasp, state), run = runs.scene("pinch"), runs.run("pinch", times=5)
    # Swung a fifth as far as in pictures, so that no link is inside of it.
    states = jax.tree.map(
        lambda start, x: np.asarray(start) + 0.2 * (np.asarray(x) - np.asarray(start)), state, run.states
    )
    run = dataclasses.replace(run, states=states)
    found = np.asarray(jxr.link_clearance(grasp, run).object)
    for q, row in zip(np.asarray(run.states.q), found, strict=True):
        sin, cos = np.sin(q[2]), np.cos(q[2])
        for finger, angles, away in zip(grasp.fingers, (q[3:6], q[6:]), row, strict=True):
            joints = (chain(np.asarray(finger.base), angles, finger.lengths) - q[:2]) @ [
                [cos, -sin],
                [sin, cos],
            ]
            links = np.concatenate(
                [along(ends, 100_001) for ends in zip(joints[:-1], joints[1:], strict=True)]
            )
            beyond = np.maximum(np.abs(links[:, 1]) - 0.025, 0.0)
            assert abs(np.hypot(np.abs(np.abs(links[:, 0]) - 0.015), beyond).min() - away) <= 1e-9
