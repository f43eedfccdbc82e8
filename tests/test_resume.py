"""Runs that go on with other contacts: a finger lifts off and returns, three hand over to two, and back."""

import jax
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.loads import Push
from tests.oracles.dense_impacts import dense_strike

EVENTS = ("lift", "friction", "penetration")


def pieces(grasp, state, t1):
    """All pieces of a run to t1: grasp, start, time and run of each."""
    t, found = 0.0, []
    while True:
        run = jxr.simulate(grasp, state, t1, t0=t, ts=3, throw=False, events=EVENTS)
        found.append((grasp, state, float(t), run))
        if bool(run.result == jxr.RESULTS.successful):
            return found
        grasp, state, t = jxr.resume(grasp, run)


@pytest.fixture(scope="module")
def pushed():
    """A pinch whose object is pushed off one finger, which follows it."""
    grasp, state = jxr.scenes.pinch()
    return pieces(grasp.with_(load=Push((8.0, 0.0), 0.1, 0.01)), state, 0.4)


def test_a_finger_lifts_off_and_returns(pushed):
    """Gaps stay closed to rounding, velocities pass through a loss, energy is never gained at a touch."""
    first, second, third = pushed
    assert [len(piece[0].contacts) for piece in (first, second, third)] == [2, 1, 2]
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
    before = jxr.simulate(second[0], second[1], third[2], t0=second[2], ts=1, rtol=1e-11).last
    np.testing.assert_allclose(third[1].q, before.q, rtol=0, atol=1e-9)
    energy = [float(jxr.energies(g, s)[0]) for g, s in ((second[0], before), (third[0], third[1]))]
    assert energy[1] < energy[0]


def test_three_fingers_hand_over_to_two():
    """A push takes the disc off one of them, in a direction in which its friction does not hold it."""
    grasp, state = jxr.scenes.ring(3)
    loaded = grasp.with_(load=Push((-0.03, -6.0), 0.0, 0.03))
    lost = jxr.simulate(loaded, state, 0.1, ts=3, throw=False, events=EVENTS)
    assert bool(lost.result == jxr.RESULTS.contact_lost) and int(lost.stats.contact) == 0
    left, start, t = jxr.resume(loaded, lost)
    assert [c.finger for c in left.contacts] == [1, 2] and start.s.shape == (2,)
    run = jxr.simulate(left, start, float(t) + 0.001, t0=t, ts=11, events=EVENTS)
    assert np.abs(run.residuals.normal).max() < 1e-14
    np.testing.assert_allclose(run.states.q[0], lost.last.q, rtol=0, atol=1e-14)


def test_a_touch_is_an_inelastic_impact(pushed):
    """Momentum: M (v+ - v-) = A^T mu with A v+ = 0, all rows of the new set of contacts."""
    _, second, third = pushed
    before = jxr.simulate(second[0], second[1], third[2], t0=second[2], ts=1, rtol=1e-12).last
    terms = jxr.equation_terms(third[0], third[1])
    rows = np.concatenate([terms.normal, terms.tangential])
    v, _ = dense_strike(np.asarray(terms.mass), rows, np.asarray(before.v), np.zeros(8))
    np.testing.assert_allclose(third[1].v, v, rtol=0, atol=1e-7)
    assert np.abs(rows @ np.asarray(third[1].v)).max() < 1e-12


def test_what_cannot_go_on_is_said(pushed):
    grasp, _, _, run = pushed[-1]
    with pytest.raises(ValueError, match="contact_lost or penetration, .* but was successful"):
        jxr.resume(grasp, run)
    alone, start = jxr.scenes.pivoted()
    lost = jxr.simulate(alone.with_(force=-0.5), start, 0.1, throw=False)
    with pytest.raises(ValueError, match="must leave the grasp a contact, but lost its only one"):
        jxr.resume(alone, lost)
    ring, start = jxr.scenes.ring(3)
    rubbing = jxr.simulate(ring.with_(load=Push((3.0, -6.0), 0.0, 0.03)), start, 0.1, throw=False)
    with pytest.raises(ValueError, match="must lose a contact that then opens"):
        jxr.resume(ring.with_(load=Push((3.0, -6.0), 0.0, 0.03)), rubbing)


def test_a_contact_lost_in_space_is_dropped():
    """With the places of the contacts that stay, and no change of the state: fingers that let go."""
    grasp, state = jxr.scenes.pinch3d()
    grasp = grasp.with_(beta=-20.0)
    run = jxr.simulate(grasp, state, 0.1, throw=False)
    assert bool(run.result == jxr.RESULTS.contact_lost)
    left, at, t = jxr.resume(grasp, run)
    kept = 1 - int(run.stats.contact)
    assert [c.finger for c in left.contacts] == [kept] and float(t) == float(run.stats.t_end)
    np.testing.assert_array_equal(at.s, run.last.s.reshape(2, -1)[kept])
    assert np.abs(jxr.residuals(left, at).normal).max() < 1e-14
    jax.tree.map(np.testing.assert_array_equal, (at.q, at.v), (run.last.q, run.last.v))
