"""Grasps of many fingers, whose constraints are factorised in a loop, against the same written out.

Small grasps are put into the loop for that: what is compiled is small, and there is what to compare with.
"""

import functools

import jax
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._motion import _linearisation, _projection
from tests.recorded import runs
from tests.subjects.driven_plate import driven_plate

# A friction that no force comes near makes a grasp of another structure, so that JAX traces its runs anew.
NEVER = 1e3


@pytest.fixture
def in_loops(monkeypatch):
    """A call after which every factorisation is a loop, and what it returns: how many were solved so."""

    def begin():
        calls, solve = [], _linearisation.solve_in_loop
        for module in (_linearisation, _projection):
            monkeypatch.setattr(module, "WRITTEN_OUT", 1)
        monkeypatch.setattr(_linearisation, "solve_in_loop", lambda *args: calls.append(1) or solve(*args))
        return calls

    return begin


def rubbing(grasp):
    """The grasp, whose contacts would slip at a force that they never meet."""
    contacts = [
        jxr.Contact(c.s_tip, c.s_object, finger=c.finger, contour=c.contour, sense=c.sense, friction=NEVER)
        for c in grasp.contacts
    ]
    return grasp.with_contacts(*contacts)


def test_a_run_in_a_loop_is_the_one_written_out_and_so_is_its_gradient(in_loops):
    """Of one contact: its two rows are the fewest of which a loop eliminates any."""
    grasp, state = driven_plate()
    end = lambda grasp, damping, **options: jxr.simulate(  # noqa: E731
        grasp.with_(damping=damping), state, 0.1, ts=1, **options
    )
    damping = float(grasp.controller.damping)
    steps = {k: end(grasp, damping * (1.0 + 0.02 * k), rtol=1e-12).last.q for k in range(-3, 4)}
    calls = in_loops()

    @jax.jit
    @functools.partial(jax.value_and_grad, has_aux=True)
    def looped(damping):
        # Without events, which do not occur, a run is another program, so that JAX traces it anew.
        run = end(grasp, damping, rtol=1e-12, throw=False, events=())
        return run.last.q[1], (run.last.q, run.result._value)

    (_, (last, code)), slope = looped(damping)
    assert calls and code == 0
    assert np.abs(last - state.q).max() > 1e-4  # it moves
    np.testing.assert_allclose(last, steps[0], rtol=1e-9, atol=1e-11)
    weights = {1: 45.0, 2: -9.0, 3: 1.0}
    wanted = sum(c * (steps[k][1] - steps[-k][1]) for k, c in weights.items()) / (60.0 * 0.02 * damping)
    np.testing.assert_allclose(slope, wanted, rtol=1e-7)


def test_forces_of_fingers_in_motion_are_those_written_out(in_loops):
    """Of two and of three joints: rows of two fingers share the object's columns alone."""
    grasp, state = runs.scene("pinch")
    moving = jxr.State(state.q, np.random.default_rng(0).normal(size=8), state.s)
    written = jxr.multipliers(grasp, 0.0, moving)
    calls = in_loops()
    looped = jxr.multipliers(rubbing(grasp), 0.0, moving)
    assert calls
    for name in ("f", "lam"):
        np.testing.assert_allclose(
            getattr(looped, name), getattr(written, name), rtol=1e-9, atol=1e-11, err_msg=name
        )


@pytest.mark.slow
def test_a_ring_of_twenty_fingers_stays_closed_and_keeps_its_energy():
    grasp, state = jxr.scenes.ring(20, gravity=(0.3, -0.7))
    run = jxr.simulate(grasp, state, 0.2, ts=5, record=("multipliers", "energy"))
    assert bool(run.result == jxr.RESULTS.successful)
    left = jxr.residuals(grasp, run.states)
    assert np.abs(left.normal).max() < 1e-14 and np.abs(left.tangential).max() < 1e-14
    assert np.abs(run.last.q[:3] - state.q[:3]).max() > 1e-5
    assert np.abs(run.energy.residual).max() < 1e-9 * np.abs(run.energy.work).max()
