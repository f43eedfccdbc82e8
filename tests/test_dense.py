"""Dense output: states of a run at any time, by one more step of its own method."""

import copy
import pickle

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from tests.measures import both_slopes
from tests.subjects.disc_on_a_hill import disc_on_a_hill
from tests.subjects.driven_plate import driven_plate


@pytest.fixture(scope="module")
def scene():
    """A disc that rolls on a plate, which rises."""
    return driven_plate()


def dense_error(scene, tight, loose, **ways):
    """Largest error of dense output between saved times, and of what the same run saved."""
    grasp, state = scene
    ts = np.linspace(0.0, 0.4, 42)
    run = jxr.simulate(grasp, state, 0.4, ts=[0.0, ts[20], 0.4], rtol=loose, record=("dense",), **ways)
    found = jax.tree.map(lambda x: np.asarray(x).reshape(42, -1), run(ts.reshape(6, 7)))
    assert np.abs(jxr.residuals(grasp, found).normal).max() <= 1e-12
    # Three times a run, in a program that many tests use.
    true = [jxr.simulate(grasp, state, 0.4, ts=each, rtol=tight).states.q for each in ts.reshape(-1, 3)]
    true = np.concatenate(true)
    saved = np.abs(run.states.q - true[[0, 20, 41]]).max()
    return np.abs(found.q - true).max(), saved, run, found


def test_dense_output_is_as_accurate_as_saved_states(scene):
    off, saved, run, found = dense_error(scene, 1e-12, 1e-6)
    assert 1e-13 < off <= 10.0 * saved
    # It meets the states of a step's both ends, and is not known outside the run.
    np.testing.assert_allclose(found.q[np.array([0, 20, 41])], run.states.q, rtol=0, atol=1e-14)
    assert all(np.isnan(run(outside).q).all() for outside in (-0.1, 0.5)) and np.isfinite(run(0.1).q).all()
    assert run(np.full((6, 7), 0.1)).v.shape == (6, 7, 4) and run([]).v.shape == (0, 4)
    with pytest.raises(ValueError, match="kept its steps"):
        jxr.simulate(*scene, 0.1, ts=1)(0.05)
    # Copies answer too, those from another process among them: what marks a tree's structure stays itself.
    for again in (copy.deepcopy(run), pickle.loads(pickle.dumps(run))):
        assert jax.tree.structure(again) == jax.tree.structure(run)
        np.testing.assert_array_equal(again(0.1).q, run(0.1).q)


def test_dense_output_has_the_methods_order(scene):
    """In steps of constant length, between their ends."""
    grasp, state = scene
    ways = {"solver": diffrax.Bosh3(), "stepsize_controller": diffrax.ConstantStepSize()}
    sizes = (4e-3, 2e-3)
    off = [dense_error(scene, 1e-12, 1e-8, dt0=size, **ways)[0] for size in sizes]
    assert 2.6 < np.log2(off[0] / off[1]) < 3.6


def test_dense_output_is_differentiated():
    """With respect to the grasp, the start and the time, in both modes; and mapped over runs."""

    def value(x):
        scene = disc_on_a_hill(mass=x[0], speed=x[1])
        run = jxr.simulate(*scene, 0.15, ts=1, rtol=1e-11, record=("dense",))
        return jnp.sum(run(x[2]).q * jnp.array([10.0, 20.0, 0.3])) + run.states.q[-1, 0]

    x, size, both = np.array([0.05, 0.02, 0.1]), np.array([1e-4, 1e-4, 1e-4]), both_slopes(value)
    ends = [[both(x + k * h * e)[0] for h, e in zip(size, np.eye(3), strict=True)] for k in (-2, -1, 1, 2)]
    wanted = (8 * (np.array(ends[2]) - ends[1]) - (np.array(ends[3]) - ends[0])) / (12 * size)
    along = np.array([1.0, 0.1, -0.1])
    here, forwards, backwards = both(x, along)
    np.testing.assert_allclose(backwards, wanted, rtol=1e-6)
    np.testing.assert_allclose(forwards, backwards @ along, rtol=1e-10)
    each = jax.jit(jax.vmap(value))(np.stack([x, 1.1 * x]))
    np.testing.assert_allclose(each, [here, both(1.1 * x)[0]], rtol=1e-12)


def test_dense_output_across_samples_jumps_and_an_early_end(scene):
    """Steps end at all of them, so that what is between is smooth; at a jump it is the state after it."""
    grasp, state = scene
    harder = jxr.commands.Steps([0.0513, 0.07], [0.5, 0.7, 0.6])
    law = jxr.control.Sampled(grasp.with_(force=harder).controller, 0.01)
    at = np.array([0.0049, 0.0051, 0.01, 0.055, 0.07, 0.0849])
    at_end = np.linspace(0.0995, 0.1, 6)
    for acted in (grasp.with_(controller=law), grasp.with_(force=harder)):
        # One program: another run, which saves at these times; this one saves close to its end alone.
        run = jxr.simulate(acted, state, 0.1, ts=at_end, rtol=1e-10, record=("dense",))
        true = jxr.simulate(acted, state, 0.1, ts=at, rtol=1e-11, record=("dense",)).states
        found = run(at)
        for part in ("q", "v", "s"):
            np.testing.assert_allclose(getattr(found, part), getattr(true, part), rtol=0, atol=2e-8)
        if true.memory is not None:
            np.testing.assert_allclose(found.memory, true.memory, rtol=0, atol=1e-8)
    pulled = grasp.with_(force=jxr.commands.Steps([0.05, 0.07], [0.5, -0.5, -0.5]))
    lost = jxr.simulate(pulled, state, 0.3, ts=6, record=("dense",), throw=False)
    assert str(lost.result) == "contact_lost"
    # As many times as above: the same program.
    ends = lost(float(lost.stats.t_end) + np.array([-1e-6, 0.0, 1e-6, 1e-5, 1e-4, 1e-3]))
    np.testing.assert_allclose(ends.q[1], lost.last.q, rtol=0, atol=1e-13)
    assert np.isfinite(ends.q[:2]).all() and np.isnan(ends.q[2:]).all()
    # A jump that a sampled run did not come to.
    acted = grasp.with_(controller=jxr.control.Sampled(pulled.controller, 0.01))
    sampled = jxr.simulate(acted, state, 0.1, ts=at_end, rtol=1e-10, record=("dense",), throw=False)
    end = float(sampled.stats.t_end)
    assert str(sampled.result) == "contact_lost" and end < 0.07
    reached = np.isfinite(sampled(np.array([0.0, end - 1e-6, end, end + 1e-6, 0.07, 0.08])).q).all(axis=-1)
    np.testing.assert_array_equal(reached, [True] * 3 + [False] * 3)
    with jax.enable_x64(False), pytest.raises(ValueError, match="argument run must be of single precision"):
        lost(0.01)
