"""Runs that go on with other contacts: a jaw lifts off and returns, three hand over to two."""

import dataclasses
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxroll as jxr
from jaxroll._integration import _resume
from jaxroll._linalg import pose_at, Vec3
from jaxroll.contact import clearance3
from jaxroll.loads import Impulse, Push
from tests.oracles import reference_space as reference
from tests.oracles.dense_impacts import dense_strike
from tests.recorded import runs
from tests.subjects.disc_between_jaws import disc_among_jaws, disc_between_jaws
from tests.subjects.pinches_in_space import same_in_reference

EVENTS = ("lift", "friction", "penetration")


def pieces(grasp, state, t1):
    """All pieces of a run to t1: grasp, start, time and run of each.

    To look for overlaps makes a program three times as long: that is done while a finger is away.
    """
    t, found = 0.0, []
    while True:
        away = len(grasp.contacts) < len(grasp.fingers)
        events = EVENTS if away else EVENTS[:2]
        run = jxr.simulate(grasp, state, t1, t0=t, ts=3, throw=False, events=events, rtol=1e-12)
        found.append((grasp, state, float(t), run))
        if bool(run.result == jxr.RESULTS.successful):
            return found
        grasp, state, t = jxr.resume(grasp, run)


@pytest.fixture(scope="module")
def pushed():
    """A disc that is pushed off one of two jaws, which follows it.

    The program of the first piece, before the loss, runs the last one too, after the touch.
    """
    return pieces(*disc_between_jaws(Push((8.0, -0.5), 0.0, 0.01)), 0.1)


def until_the_touch(pushed):
    """The state just before the touch, by the program that ran into it."""
    _, (grasp, state, t0, _), (_, _, t1, _) = pushed
    return jxr.simulate(grasp, state, t1, t0=t0, ts=3, events=EVENTS, rtol=1e-12).last


def test_a_jaw_lifts_off_and_returns(pushed):
    """Gaps stay closed to rounding, velocities pass through a loss, energy is never gained at a touch."""
    first, second, third = pushed
    fingers = [[c.finger for c in piece[0].contacts] for piece in (first, second, third)]
    assert fingers == [[1, 0], [1], [1, 0]]
    lost, found = first[3], second[3]
    assert bool(lost.result == jxr.RESULTS.contact_lost)
    assert bool(found.result == jxr.RESULTS.penetration)
    np.testing.assert_array_equal(second[1].v, lost.last.v)
    np.testing.assert_array_equal(second[1].q, lost.last.q)
    assert second[2] == float(lost.stats.t_end)
    for grasp, state, _, run in (first, second, third):
        left = jxr.residuals(grasp, state)
        assert max(np.abs(left.normal).max(), np.abs(left.tangential).max()) < 1e-14
        assert np.nanmax(np.abs(run.residuals.normal)) < 1e-14
    # At the touch the shapes have not overlapped yet; the audit sees them once they do by 1e-7 m.
    assert 0.0 < float(found.stats.t_end) - third[2] < 1e-4
    before = until_the_touch(pushed)
    np.testing.assert_allclose(third[1].q, before.q, rtol=0, atol=1e-9)
    energy = [float(jxr.energies(g, s)[0]) for g, s in ((second[0], before), (third[0], third[1]))]
    assert energy[1] < energy[0]


def test_samples_are_those_of_the_time_of_the_touch(pushed):
    """Held torques stay, at times before zero too, and a sample between touch and overlap is still due."""
    _, (grasp, _, _, run), (_, start, touch, _) = pushed
    period, early, end = 1e-3, 1.0, float(run.stats.t_end)
    between = 0.5 * (touch + end) - early
    law = jxr.control.Sampled(grasp.controller, period, first=between - 100 * period)
    held = jnp.concatenate([*jxr.torques(grasp, run.stats.t_end, run.last), jnp.array([between + period])])
    last = jxr.State(run.last.q, run.last.v, run.last.s, held)
    parts = lambda r: (r.last, r.stats.t_end)  # noqa: E731
    sampled = eqx.tree_at(parts, run, (last, run.stats.t_end - early))
    _, state, t = jxr.resume(grasp.with_(controller=law, load=None), sampled)
    assert float(t) == pytest.approx(touch - early, abs=1e-12)
    np.testing.assert_allclose(state.q, start.q, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(state.memory[:-1], held[:-1])
    assert float(state.memory[-1]) == pytest.approx(between, abs=1e-14)


def test_a_contact_that_a_blow_knocks_off_is_dropped_before_the_blow(pushed):
    """It presses until then; the run that goes on deals the blow to the grasp without it."""
    grasp, state, _, _ = pushed[0]
    hit = grasp.with_(load=Impulse((0.01, -0.001), 0.0))
    lost = jxr.simulate(hit, state, 0.1, ts=1, throw=False)
    assert bool(lost.result == jxr.RESULTS.contact_lost)
    left, start, t = jxr.resume(hit, lost)
    assert [c.finger for c in left.contacts] == [1] and float(t) == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_array_equal(start.v, lost.last.v)
    assert bool(jxr.strike(left, start, hit.load[0]).result == jxr.RESULTS.successful)


def test_three_jaws_hand_over_to_two():
    """A push takes the disc off one of them, in a direction in which its friction does not hold it."""
    loaded, state = disc_among_jaws(Push((-8.0, -0.5), 0.0, 0.03))
    lost = jxr.simulate(loaded, state, 0.1, ts=3, throw=False)
    assert bool(lost.result == jxr.RESULTS.contact_lost) and int(lost.stats.contact) == 0
    left, start, t = jxr.resume(loaded, lost)
    assert [c.finger for c in left.contacts] == [1, 2] and start.s.shape == (2,)
    assert np.abs(jxr.residuals(left, start).normal).max() < 1e-14
    np.testing.assert_array_equal(start.q, lost.last.q)
    assert np.min(jxr.multipliers(left, t, start).f) > 0.0  # so that it goes on


def test_a_touch_is_an_inelastic_impact(pushed):
    """Momentum: M (v+ - v-) = A^T mu with A v+ = 0, all rows of the new set of contacts."""
    _, second, third = pushed
    before = until_the_touch(pushed)
    terms = jxr.equation_terms(third[0], third[1])
    rows = np.concatenate([terms.normal, terms.tangential])
    v, _ = dense_strike(np.asarray(terms.mass), rows, np.asarray(before.v), np.zeros(5))
    np.testing.assert_allclose(third[1].v, v, rtol=0, atol=1e-10)
    assert np.abs(rows @ np.asarray(third[1].v)).max() < 1e-12


@pytest.mark.slow
def test_a_finger_touches_in_space():
    """The other finger of a pinch comes near: gap, energy, momentum, and the run goes on with both."""
    grasp, state = jxr.scenes.pinch3d()
    one = grasp.with_contacts(grasp.contacts[0])
    apart = jxr.State(state.q.at[11].add(-0.02).at[10].add(0.01), state.v, state.s[:6])
    run = jxr.simulate(one, apart, 0.1, ts=3, throw=False, events=EVENTS, rtol=1e-12)
    assert bool(run.result == jxr.RESULTS.penetration) and int(run.stats.contact) == 1
    both, start, t = jxr.resume(one, run)
    assert [c.finger for c in both.contacts] == [0, 1] and 0.0 < float(run.stats.t_end) - float(t) < 1e-5
    left = jxr.residuals(both, start)
    assert max(np.abs(left.normal).max(), np.abs(left.tangential).max()) < 1e-14
    before = jxr.simulate(one, apart, float(t), ts=3, events=EVENTS, rtol=1e-12).last
    np.testing.assert_allclose(start.q, before.q, rtol=0, atol=1e-13)
    terms = reference.equations(same_in_reference(both), np.asarray(start.q), np.asarray(before.v))
    v, _ = dense_strike(terms[0], terms[3], np.asarray(before.v), np.zeros(12))
    np.testing.assert_allclose(start.v, v, rtol=0, atol=1e-10)
    assert np.abs(terms[3] @ np.asarray(start.v)).max() < 1e-12
    energy = [float(jxr.energies(g, s)[0]) for g, s in ((one, before), (both, start))]
    assert energy[1] < energy[0]
    on = jxr.simulate(both, start, 0.1, t0=t, ts=3, events=("lift", "friction"))
    assert np.abs(on.residuals.normal).max() < 1e-14


@pytest.mark.slow
def test_a_ball_that_rolls_into_a_corner_is_found_and_refused():
    """At the time of its distance over its speed. Floor and wall hold it twice."""
    ball, state = jxr.scenes.incline(slope=0.0)
    side = np.sqrt(0.5)
    wall = jxr.Stage(jxr.Plane(), base=(0.2, 0.0, 0.0), rotation=(side, 0.0, -side, 0.0))
    room = ball.with_(fingers=[*ball.fingers, wall])
    rolling = jxr.State(state.q, [0.3, 0.0, 0.0, 0.0, 0.3 / 0.05, 0.0], state.s)
    run = jxr.simulate(room, rolling, 2.0, throw=False, events=EVENTS, rtol=1e-11)
    assert bool(run.result == jxr.RESULTS.penetration)
    assert float(run.stats.t_end) == pytest.approx((0.2 - 0.05 + 1e-7) / 0.3, abs=1e-9)
    with pytest.raises(ValueError, match="held twice"):
        jxr.resume(room, run)


def distance_of(axes, p):
    """From a point p outside to an ellipsoid, whose foot has x_i = a_i^2 p_i / (a_i^2 + t): t is a root."""
    square = np.asarray(axes) ** 2
    off = lambda t: np.sum(square * p**2 / (square + t) ** 2) - 1.0  # noqa: E731
    return np.linalg.norm(p - square * p / (square + brentq(off, 0.0, 1.0, xtol=1e-16, rtol=1e-14)))


def test_clearance_in_space_is_the_distance_of_the_surfaces():
    """Of a bounded fingertip over a plane and over a sphere, apart and overlapping; and of one without."""
    axes, q = np.array([0.02, 0.015, 0.01]), np.array([0.9, 0.1, 0.2, 0.3])
    tip, q = jxr.Ellipsoid(*axes), q / np.linalg.norm(q)
    turned = reference.quaternion_matrix(q)
    plane, ball = jxr.Plane(), jxr.Sphere(0.03)
    still = pose_at(Vec3(0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))

    @jax.jit
    def found(at):
        pose = pose_at(Vec3(*at), tuple(q))
        over = [clearance3((pose, still), tip, [face], samples=64) for face in (plane, ball)]
        return jnp.stack([*over, clearance3((still, pose), plane, [tip], samples=64)])

    for height in (0.05, 0.014, 0.011):
        at = np.array([0.003, -0.002, height])
        # An ellipsoid reaches sqrt(sum (a_i n_i)^2) far along a direction n of its axes.
        below = height - np.linalg.norm(axes * turned[2])
        raised = at + np.array([0.0, 0.0, 0.03])
        near = distance_of(axes, -turned.T @ raised) - 0.03
        np.testing.assert_allclose(found(at)[::2], [below] * 2, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found(raised)[1], near, rtol=0, atol=1e-8)


def test_what_cannot_go_on_is_said(pushed):
    grasp, _, _, run = pushed[-1]
    with pytest.raises(ValueError, match="contact_lost or penetration, .* but was successful"):
        jxr.resume(grasp, run)
    for friction, words in ((-1.0, "positive"), ("much", "a real number"), (np.nan, "finite")):
        with pytest.raises(ValueError, match=f"argument friction must be {words}"):
            jxr.resume(grasp, run, friction=friction)
    alone, _ = runs.scene("pivoted")
    with pytest.raises(ValueError, match="must leave the grasp a contact, but lost its only one"):
        jxr.resume(alone, runs.run("pivoted", ended="contact_lost"))
    with pytest.raises(ValueError, match="then opens, .*: give the contacts a `friction`, .* its normal"):
        pieces(*disc_between_jaws(Push((8.0, 2.0), 0.0, 0.01)), 0.1)


def test_a_fingertip_that_met_the_end_of_a_face_is_said():
    """The end of a plate that turns about one round jaw, 1e-6 m inside of another one past it."""
    plate, radius = jxr.FreeObject(jxr.Line((-0.02, 0.02)), 0.05, 1e-5), 0.01
    past = (0.8 * radius - 1e-6, 0.02 + 0.6 * radius)
    jaws = [jxr.Jaw(jxr.Circle(radius), 0.1, [0.0], base=at) for at in ((radius, 0.0), past)]
    grasp = jxr.Grasp(plate, jaws, [jxr.Contact(np.pi * radius, 0.0)])
    turning, before = jxr.State(np.zeros(5), [0.0, 0.0, -1.0, 0.0, 0.0], np.zeros(1)), runs.run("pivoted")
    stats = dataclasses.replace(before.stats, contact=jnp.asarray(1), t_end=jnp.ones(()))
    run = dataclasses.replace(before, result=jxr.RESULTS.penetration, last=turning, stats=stats)
    with pytest.raises(ValueError, match=r"finger 1 met the end of face 0 of .* \(s_object = 0.02 m\)"):
        jxr.resume(grasp, run)


@pytest.mark.parametrize(
    ("tip", "face", "s", "end"),
    [
        (jxr.Circle(0.01), jxr.Line((-0.02, 0.02)), (0.06, -0.0195), ("s_object", -0.02)),
        (jxr.Line((-0.03, 0.01)), jxr.Line((-0.02, 0.02)), (0.01, 0.0195), ("s_tip", 0.01)),
        (jxr.Circle(0.01), jxr.Line((-0.02, 0.02)), (0.06, 0.019), None),
        (jxr.Circle(0.01), jxr.Circle(0.02), (0.06, 0.0), None),
    ],
)
def test_the_end_that_met_is_the_nearest_of_both_shapes(tip, face, s, end):
    """The fingertip's or the face's; none where both touch elsewhere, or have no ends."""
    assert _resume._end_near((tip, face), SimpleNamespace(s=np.array(s))) == end


def test_what_jax_traces_cannot_be_resumed(pushed):
    """Which contacts there are is decided on the way: in a derivative that gave JAX's own error."""
    grasp, _, _, lost = pushed[0]
    after = lambda scale: jxr.resume(grasp, eqx.tree_at(lambda r: r.last.v, lost, lost.last.v * scale))[2]  # noqa: E731
    for way in (jax.grad, jax.jit):
        with pytest.raises(ValueError, match="argument run must hold known numbers, but JAX is tracing some"):
            way(after)(1.0)


def test_a_contact_lost_in_space_is_dropped():
    """With the places of the contacts that stay, and no change of the state: fingers that let go."""
    grasp, state = runs.scene("pinch3d")
    grasp = grasp.with_(beta=-20.0)
    # What a run says that ends where it begins, without its program.
    stats = dataclasses.replace(runs.run("pinch3d").stats, contact=jnp.asarray(1), t_end=jnp.zeros(()))
    ended = {"result": jxr.RESULTS.contact_lost, "last": state, "stats": stats}
    run = dataclasses.replace(runs.run("pinch3d"), **ended)
    left, at, t = jxr.resume(grasp, run)
    kept = 1 - int(run.stats.contact)
    assert [c.finger for c in left.contacts] == [kept] and float(t) == float(run.stats.t_end)
    np.testing.assert_array_equal(at.s, run.last.s.reshape(2, -1)[kept])
    assert np.abs(jxr.residuals(left, at).normal).max() < 1e-14
    jax.tree.map(np.testing.assert_array_equal, (at.q, at.v), (run.last.q, run.last.v))
