"""vmap over anything: lanes equal single runs, and a failing lane changes no other."""

import os
import subprocess
import sys

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from tests.measures import programs
from tests.subjects.swinging_plate import swinging

LANES = 256


def make(x):
    """A grasp whose gains, masses, contours and starting contact all depend on x, shape (6,)."""
    grasp, state = jxr.scenes.pivoted()
    scale = 1.0 + x
    contact = grasp.contacts[0]
    grasp = eqx.tree_at(
        lambda g: (
            g.controller.damping,
            g.controller.force,
            g.fingers[0].masses,
            g.fingers[0].tip.contour.contour.a,
            g.object.contours[0].contour.a,
            g.contacts[0].s_tip,
            g.contacts[0].s_object,
        ),
        grasp,
        (
            grasp.controller.damping * scale[0],
            grasp.controller.force * scale[1],
            grasp.fingers[0].masses * scale[2],
            grasp.fingers[0].tip.contour.contour.a * scale[3],
            grasp.object.contours[0].contour.a * scale[4],
            contact.s_tip - 1e-2 * x[5],
            contact.s_object + 1e-2 * x[5],
        ),
    )
    return grasp, state


@pytest.fixture(scope="module")
def draws():
    return np.asarray(np.random.default_rng(1).uniform(-0.2, 0.2, (LANES, 6)))


@pytest.fixture(scope="module")
def scenes(draws):
    """All of them closed, in one program."""
    return jax.jit(jax.vmap(lambda x: jxr.close(*make(x))))(draws)


EIGHT = range(0, LANES, LANES // 8)


def lane(tree, i):
    return jax.tree.map(lambda x: x[i], tree)


ADAPTIVE = {"t1": 0.2, "ts": 1, "rtol": 1e-8}
FIXED = {"t1": 0.05, "ts": 1, "stepsize_controller": diffrax.ConstantStepSize(), "dt0": 2e-3}


def fixed(x):
    """Steps of equal lengths, of a disc on a plate that swings: springs, dampers and masses depend on x."""
    scale = 1.0 + x
    grasp, state = swinging(0.8 * scale[0], 5.0 * scale[1])
    parts = lambda g: (g.object.mass, g.object.inertia, g.fingers[0].mass)  # noqa: E731
    masses = [part * factor for part, factor in zip(parts(grasp), scale[2:5], strict=True)]
    return jxr.simulate(eqx.tree_at(parts, grasp, masses), state, **FIXED).states


@jax.jit
@jax.vmap
def adaptive(scene):
    """Runs of many scenes; those that do not fail take a tenth of the steps that they may."""
    return jxr.simulate(*scene, **ADAPTIVE, max_steps=200)


@pytest.fixture(scope="module")
def batch(scenes):
    return adaptive(scenes)


def test_every_lane_succeeds_with_its_own_code(batch):
    assert batch.result._value.shape == (LANES,)
    assert bool(jnp.all(batch.result == jxr.RESULTS.successful))
    assert len(np.unique(np.asarray(batch.stats.steps))) > 3  # they do differ
    assert np.isfinite(np.asarray(batch.states.q)).all()
    assert np.abs(batch.residuals.normal).max() <= 1e-12
    assert str(LANES) in str(batch)


def test_closed_lanes_equal_single_ones(scenes, draws):
    for i in EIGHT:
        alone = jxr.close(*make(draws[i]))
        same = lambda a, b: np.testing.assert_allclose(a, b, rtol=0, atol=1e-14)  # noqa: E731
        jax.tree.map(same, lane(scenes, i), alone)


def test_adaptive_lanes_equal_single_runs_to_tolerance(batch, scenes):
    for i in EIGHT:
        one = jxr.simulate(*lane(scenes, i), **ADAPTIVE)
        np.testing.assert_allclose(batch.states.q[i], one.states.q, atol=1e-8)


def test_fixed_step_lanes_equal_single_runs_to_1e_12(draws):
    lanes, alone = jax.jit(jax.vmap(fixed))(draws), jax.jit(fixed)
    for i in EIGHT:
        one = alone(draws[i])
        np.testing.assert_allclose(lanes.q[i], one.q, rtol=0, atol=1e-12)
        np.testing.assert_allclose(lanes.s[i], one.s, rtol=0, atol=1e-12)
    assert np.ptp(lanes.q[:, :, 3]) > 1e-5


def test_a_failing_lane_leaves_the_others_bit_identical(batch, scenes):
    """Three lanes fail, each in its own way; same program, same other lanes."""
    failing = eqx.tree_at(
        lambda scene: (scene[0].controller.damping, scene[0].controller.force, scene[1].q),
        scenes,
        replace_fn=np.array,
    )
    grasp, state = failing
    grasp.controller.damping[1], grasp.controller.force[3], state.q[6] = np.nan, 1e9, state.q[6] + 0.1
    bad = adaptive(failing)
    codes = np.asarray(bad.result._value)
    assert np.flatnonzero(codes).tolist() == [1, 3, 6]
    assert codes[6] == int(jxr.RESULTS.unreachable._value)
    for found, wanted in ((bad.states.q, batch.states.q), (bad.states.v, batch.states.v)):
        np.testing.assert_array_equal(np.asarray(found)[codes == 0], np.asarray(wanted)[codes == 0])


def test_new_numbers_do_not_recompile():
    """One trace per shape."""
    grasp, state = swinging()
    traces = []

    @eqx.filter_jit
    def run(c):
        traces.append(1)
        return jxr.simulate(grasp.with_(damping=c), state, 0.02, ts=1).states.q

    for c in (0.004, 0.006, 0.008):
        run(jnp.asarray(c))
    assert len(traces) == 1


def test_a_number_as_an_array_is_the_number(scene, caplog):
    """JAX gives Python's numbers a weak type, and would compile once more for each of another kind."""
    grasp, state = scene

    def again(damping):
        jxr.simulate(grasp.with_(damping=damping), state, 0.02, ts=1)
        jxr.multipliers(grasp.with_(damping=damping), 0.0, state)

    again(0.006)
    caplog.clear()
    with jax.log_compiles():
        again(jnp.asarray(0.007, float))
        again(np.float64(0.008))
    assert not {"jit(_run)", "jit(_multipliers)"} & {*programs(caplog)}
    # Seen first in a program of the caller's own, it is still no part of that program.
    other = grasp.with_(damping=0.009)
    ends = jax.jit(lambda v: jxr.simulate(other, jxr.State(state.q, v, state.s), 0.02, ts=1).last.q)(state.v)
    np.testing.assert_allclose(ends, jxr.simulate(other, state, 0.02, ts=1).last.q, rtol=0, atol=1e-12)


SHARED_OUT = """
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
import jaxroll as jxr

grasp, state = jxr.scenes.pivoted()
end = lambda c: jnp.sum(jxr.simulate(grasp.with_(damping=c), state, 0.1, ts=1).last.q)
mesh, lanes = jax.make_mesh((jax.device_count(),), ("lanes",)), jax.P("lanes")
dampings = np.linspace(0.004, 0.008, 6)
for one in (end, jax.value_and_grad(end)):
    each = jax.vmap(one)
    split = jax.shard_map(each, mesh=mesh, in_specs=lanes, out_specs=lanes, check_vma=False)
    program = jax.jit(split).lower(jax.device_put(dampings, jax.NamedSharding(mesh, lanes))).compile()
    found = program(jax.device_put(dampings, jax.NamedSharding(mesh, lanes)))
    plain = jax.jit(each).lower(dampings).compile()
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(plain(dampings)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9)
    kernels = [p.as_text().count("xla_cpu_small_call") for p in (program, plain)]
    assert kernels[0] == kernels[1] > 0, kernels
auto = jax.make_mesh((jax.device_count(),), ("lanes",), (jax.sharding.AxisType.Auto,))
merely = jax.jit(jax.vmap(end))(jax.device_put(dampings, jax.NamedSharding(auto, lanes)))
np.testing.assert_allclose(merely, found[0], rtol=1e-6, atol=1e-9)
print(jax.device_count())
"""


def test_of_no_runs_there_are_no_results():
    """As from a filter that left nothing: empty arrays, of the shapes that those of one run would have."""
    grasp, state = swinging()
    none = jnp.zeros((0,))
    end = lambda damping: jxr.simulate(grasp.with_(damping=damping), state, 0.2, ts=1).last.q  # noqa: E731
    assert jax.vmap(end)(none).shape == (0, 4)
    assert jax.vmap(jax.grad(lambda damping: end(damping)[0]))(none).shape == (0,)
    assert jax.vmap(jax.vmap(end))(jnp.zeros((2, 0))).shape == (2, 0, 4)
    states = jax.tree.map(lambda x: jnp.zeros((0, *x.shape)), state)
    assert jxr.multipliers(grasp, none, states).f.shape == (0, 1)
    assert jxr.residuals(grasp, states).normal.shape == (0, 1)


@pytest.mark.slow
@pytest.mark.optimised
def test_lanes_shared_out_among_devices_are_those_of_one():
    """And in the same kernels: a derivative there has an operation of its own, `reshard`."""
    env = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    told = subprocess.run([sys.executable, "-c", SHARED_OUT], env=env, capture_output=True, text=True)
    assert told.returncode == 0 and told.stdout.strip() == "2", told.stderr
