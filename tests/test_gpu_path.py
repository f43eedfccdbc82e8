"""What a GPU runs, as far as a processor can tell: the ensemble's way there, and the run of one kernel."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from benchmarks import gpu
from benchmarks.contenders.one_kernel import integrate
from tests.measures import both_slopes

LANES = 6
SPAN, RTOL = 0.1, 1e-7


@pytest.fixture(scope="module")
def dampings():
    return jnp.linspace(0.004, 0.008, LANES).at[2].set(jnp.nan)


@pytest.fixture(scope="module")
def lane(scene):
    grasp, state = scene

    def run(damping):
        options = {"ts": 1, "rtol": RTOL, "solver": diffrax.Tsit5(), "throw": False}
        return jxr.simulate(grasp.with_(damping=damping), state, SPAN, **options)

    return run


@pytest.fixture(scope="module")
def whole(lane, dampings):
    return jax.jit(jax.vmap(lane))(dampings)


def agree(run, whole):
    """The same ends, steps and codes; a lane that failed may have failed with any numbers."""
    good = np.asarray(whole.result._value) == 0
    assert good.sum() == LANES - 1
    np.testing.assert_array_equal(run.result._value, whole.result._value)
    for name in ("q", "v", "s"):
        found, known = (np.asarray(getattr(x.last, name)) for x in (run, whole))
        np.testing.assert_allclose(found[good], known[good], rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.optimised
def test_the_ensemble_of_an_accelerator_gives_the_same(lane, whole, dampings, monkeypatch):
    """No kernel calls, no barriers against recomputation, loops unrolled, slots served all at once."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    jax.clear_caches()
    other = jax.jit(jax.vmap(lambda damping: lane(damping)))(dampings)
    agree(other, whole)
    np.testing.assert_allclose(other.stats.steps, whole.stats.steps, atol=1)


@pytest.mark.slow
@pytest.mark.optimised
def test_gradients_of_lanes_on_an_accelerator_are_the_same(lane, dampings, monkeypatch):
    """Side by side there, each lane with its record."""
    good = dampings[jnp.isfinite(dampings)]
    slopes = lambda: jax.vmap(both_slopes(lambda damping: jnp.sum(lane(damping).last.q)))(good)[1:]  # noqa: E731
    known = slopes()
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    jax.clear_caches()
    np.testing.assert_allclose(slopes(), known, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.optimised
def test_a_run_of_one_kernel_is_the_run(scene, whole, dampings):
    """The kernel emulated, two blocks, the second one not full."""
    grasp, state = scene

    def run(damping):
        changed = grasp.with_(damping=damping)
        return integrate(changed, state, SPAN, rtol=RTOL, block=4, interpret=True)

    ends = jax.jit(jax.vmap(run))(dampings)
    agree(ends, whole)
    np.testing.assert_allclose(ends.steps[:, 0], whole.stats.steps, atol=1)
    np.testing.assert_array_equal(ends.t_end[whole.result._value == 0], SPAN)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_the_kernel_lowers_to_triton(precision):
    """All its operations are known to Pallas' GPU back end; no GPU is needed to see that."""
    case = gpu.Case("pivoted", precision, 3.0, emulated=False)
    traced = jax.jit(jax.vmap(case.one_kernel, (0, None))).trace(
        case.shares(300), jnp.asarray(1e-5, precision)
    )
    text = traced.lower(lowering_platforms=("cuda",)).as_text()
    assert text.count("triton") == 1
    assert "grid_x = 3 : i32" in text  # three blocks of 128 lanes


def test_kernels_of_a_loop_are_counted():
    """A loop of known length inside counts as often as it turns."""
    text = """
%inner (p: (s64[], f64[4])) -> (s64[], f64[4]) {
  %fusion.1 = f64[4]{0} fusion(%a), kind=kLoop, calls=%f
  ROOT %t = (s64[], f64[4]{0}) tuple(%i, %fusion.1)
}
%until (p: (s64[], f64[4])) -> pred[] {
  ROOT %c = pred[] fusion(%i), kind=kLoop, calls=%g
}
%outer (p: (s64[], f64[4])) -> (s64[], f64[4]) {
  %copy.1 = f64[4]{0} copy(%b)
  %while.1 = (s64[], f64[4]{0}) while(%t), condition=%until, body=%inner, backend_config={"known_trip_count":{"n":"6"}}
  ROOT %fusion.2 = (s64[], f64[4]{0}) fusion(%w), kind=kLoop, calls=%h
}
ENTRY %main (x: f64[4]) -> f64[4] {
  %while.2 = (s64[], f64[4]{0}) while(%t), condition=%until, body=%outer
  ROOT %r = f64[4]{0} get-tuple-element(%while.2), index=1
}
"""  # noqa: E501
    assert gpu.launches(text) == 1 + 6 + 1 + 1


def test_without_a_gpu_nothing_is_measured():
    assert gpu.report() == gpu.NOT_MEASURED
