"""Grasps of many fingers, whose constraints are factorised in a loop, against the same written out.

A ring of two is put into the loop for that: what is compiled is small, and there is what to compare with.
"""

import jax
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._motion import _linearisation, _projection

# A friction that no force comes near makes a grasp of another structure, so that JAX traces its runs anew.
NEVER = 1e3


@pytest.fixture
def both(monkeypatch):
    """A ring that moves, its contacts written out; and the same for the loop, with its limit lowered."""
    grasp, state = jxr.scenes.ring(2, gravity=(0.3, -0.7))
    written = jax.block_until_ready(ways(grasp, state))
    for module in (_linearisation, _projection):
        monkeypatch.setattr(module, "WRITTEN_OUT", 3)
    calls = []
    solve = _linearisation.solve_in_loop
    monkeypatch.setattr(_linearisation, "solve_in_loop", lambda *args: calls.append(1) or solve(*args))
    rubbing = [jxr.Contact(c.s_tip, c.s_object, finger=c.finger, friction=NEVER) for c in grasp.contacts]
    looped = ways(grasp.with_contacts(*rubbing), state)
    assert calls
    return written, looped


def ways(grasp, state):
    """The end of a run, a gradient in gains through it, and forces at its start."""

    def end(damping):
        run = jxr.simulate(grasp.with_(damping=damping), state, 0.1, ts=1, throw=False)
        return run.last.q[1], (run.last.q, run.result._value)

    damping = grasp.controller.damping
    (_, (last, code)), slope = jax.jit(jax.value_and_grad(end, has_aux=True))(damping)
    forces = jxr.multipliers(grasp, 0.0, state)
    return {"last": last, "code": code, "slope": slope, "f": forces.f, "lam": forces.lam}


def test_a_loop_gives_what_is_written_out(both):
    written, looped = both
    assert written["code"] == looped["code"] == 0
    assert np.abs(written["last"][:3]).max() > 1e-4  # it moves
    for name in ("last", "f", "lam"):
        np.testing.assert_allclose(looped[name], written[name], rtol=1e-9, atol=1e-11, err_msg=name)
    np.testing.assert_allclose(looped["slope"], written["slope"], rtol=1e-7)


@pytest.mark.slow
def test_a_ring_of_twenty_fingers_stays_closed_and_keeps_its_energy():
    grasp, state = jxr.scenes.ring(20, gravity=(0.3, -0.7))
    run = jxr.simulate(grasp, state, 0.2, ts=5, record=("multipliers", "energy"))
    assert bool(run.result == jxr.RESULTS.successful)
    left = jxr.residuals(grasp, run.states)
    assert np.abs(left.normal).max() < 1e-14 and np.abs(left.tangential).max() < 1e-14
    assert np.abs(run.last.q[:3] - state.q[:3]).max() > 1e-5
    assert np.abs(run.energy.residual).max() < 1e-9 * np.abs(run.energy.work).max()
