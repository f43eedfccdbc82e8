"""Limits of joints and torques: where a run ends, with which code, and what `reach` makes of them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr

WIDE, STRONG = np.array([[-10.0, 10.0]] * 2), np.array([10.0, 10.0])


def limited(grasp, *, limits=WIDE, torque_limits=STRONG):
    """The pivoted scene with limits of its finger; all of one structure, and so one program."""
    old = grasp.fingers[0]
    finger = jxr.Finger(
        old.lengths, old.masses, old.tip, base=old.base, limits=limits, torque_limits=torque_limits
    )
    return grasp.with_(fingers=(finger,))


def test_a_run_ends_where_a_joint_or_a_torque_does(scene):
    """Against the same run without limits: its state at that time is at the limit, and not before."""
    grasp, state = scene
    free = jxr.simulate(grasp, state, 1.0, ts=101, rtol=1e-10)
    q = np.asarray(free.states.q)[:, 1:]
    torques = np.asarray(jxr.torques(grasp, free.ts, free.states)[0])
    # A joint that turns one way, stopped half way; and the torque that rises, likewise.
    joint = int(np.argmax(np.ptp(q, axis=0)))
    way = np.sign(q[-1, joint] - q[0, joint])
    stop = q[0, joint] + 0.5 * way * np.abs(q[:, joint] - q[0, joint]).max()
    limits = WIDE.copy()
    limits[joint, int(way > 0)] = stop
    run = jxr.simulate(limited(grasp, limits=limits), state, 1.0, ts=101, rtol=1e-10, throw=False)
    assert run.result == jxr.RESULTS.joint_limit and int(run.stats.contact) == joint
    assert f"finger 0 q[{joint}] passed the end of its range" in str(run)
    assert abs(float(run.last.q[1 + joint]) - stop) <= 1e-12 and abs(float(run.stats.margin)) <= 1e-12
    there = np.array([np.interp(run.stats.t_end, free.ts, column) for column in q.T])
    assert abs(there[joint] - stop) <= 1e-4  # the interpolation's error
    assert np.all(way * (stop - q[np.asarray(free.ts) < float(run.stats.t_end), joint]) > 0)

    sizes = np.abs(torques)
    axis = int(np.argmax(sizes.max(axis=0) - sizes[0]))
    most = 0.5 * (sizes[0, axis] + sizes[:, axis].max())
    strength = STRONG.copy()
    strength[axis] = most
    run = jxr.simulate(limited(grasp, torque_limits=strength), state, 1.0, ts=101, rtol=1e-10, throw=False)
    assert run.result == jxr.RESULTS.torque_limit and int(run.stats.contact) == axis
    asked = jxr.torques(grasp, run.stats.t_end, run.last)[0]
    assert abs(abs(float(asked[axis])) - most) <= 1e-11
    assert "needs more torque than it has" in str(run)
    with pytest.raises(RuntimeError, match="range"):
        jxr.simulate(limited(grasp, limits=limits), state, 1.0, ts=101, rtol=1e-10)


def test_wherever_a_joint_is_stopped_the_run_ends_there(scene):
    """An angle is rounded more coarsely than time: for many steps of the search its margin may be zero."""
    grasp, state = scene
    start, found = float(state.q[1]), []
    for way in np.geomspace(1e-4, 0.11, 24):
        limits = WIDE.copy()
        limits[0, 1] = start + way
        run = jxr.simulate(limited(grasp, limits=limits), state, 1.0, ts=101, rtol=1e-10, throw=False)
        found.append((run.result == jxr.RESULTS.joint_limit, run.stats.steps, run.last.q[1] - start - way))
    ended, steps, beyond = np.array(found, float).T
    assert ended.all() and steps.max() < 150 and np.abs(beyond).max() < 1e-13


@pytest.mark.parametrize(("side", "code"), [(0, "successful"), (1, "joint_limit")])
def test_a_joint_at_an_end_of_its_range_may_leave_it_and_not_pass_it(scene, side, code):
    """A hand's joints often start there. The joint turns to larger angles; rounding moves it either way."""
    grasp, state = scene
    limits = WIDE.copy()
    limits[0, side] = state.q[1]
    run = jxr.simulate(limited(grasp, limits=limits), state, 1.0, ts=101, rtol=1e-10, throw=False)
    assert run.result == jxr.RESULTS._name_to_item[code]


def test_reach_keeps_limits_or_says_which_joint_would_pass():
    disc = jxr.FreeObject.uniform(jxr.Circle(0.02), density=20.0)

    def found(limits):
        finger = jxr.Finger([0.06, 0.05], [0.03, 0.02], jxr.Circle(0.01), limits=limits)
        return jxr.reach(jxr.Grasp(disc, finger, jxr.Contact()), [(-0.02, 0.0)], pose=(0.06, 0.06, 0.0))

    free = found(None)
    assert free.postures == (2,)
    bend = float(free.state.q[4])
    other = found([(-np.pi, np.pi), tuple(sorted((-0.1 * bend, -1.1 * bend)))])
    assert other.result == jxr.RESULTS.successful
    np.testing.assert_allclose(other.state.q[4], -bend, rtol=1e-12)
    none = found([(-np.pi, np.pi), (-0.4 * abs(bend), 0.5 * abs(bend))])
    assert none.result == jxr.RESULTS.joint_limit
    assert f"joint 1 would have to be {0.5 * abs(bend):.3g} beyond" in none.reason


def test_limits_rise_and_fit():
    links = ([0.06, 0.05], [0.03, 0.02], jxr.Circle(0.01))
    for bad in ([(1.0, 0.0), (0.0, 1.0)], [(0.0, 1.0)], 1.0, [(0.0, np.inf), (0.0, 1.0)], "wide"):
        with pytest.raises(ValueError, match="argument limits must"):
            jxr.Finger(*links, limits=bad)
    for bad in ((0.0, 1.0), (1.0,), -1.0):
        with pytest.raises(ValueError, match="argument torque_limits must"):
            jxr.Finger(*links, torque_limits=bad)
    assert "limits" not in repr(jxr.Finger(*links))
    jaw = jxr.Jaw(jxr.Line(), directions=[0.0], limits=[(0.0, 0.02)], torque_limits=[1.0])
    assert jaw.prepared().limits[0][1] == 0.02
    swapped = eqx.tree_at(lambda j: j.limits, jaw, jnp.array([[0.0, 0.03]]))
    assert float(swapped.limits[0, 1]) == 0.03
