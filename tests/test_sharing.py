"""Numbers that several others use: worked out once, and the same."""

import gc
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._xla import counted, repeated, uncollected
from jaxroll._xla._compute_once import once, sharing
from jaxroll._xla._share_cotangents import pulled, shared


@jax.jit
def wave(x):
    return jnp.sin(x) * x


@jax.custom_jvp
def cube(x):
    return x**3


cube.defjvp(lambda primals, tangents: (cube(*primals), 3.0 * primals[0] ** 2 * tangents[0]))


def chain(given, unused):
    """Calls, a custom derivative, an array and a whole number among the numbers."""
    x, many, k = given["x"], given["many"], given["k"]
    y = wave(x) + cube(x)
    z = jnp.exp(y) * y + jax.lax.fori_loop(0, 3, lambda i, a: 0.5 * a + y, x)
    return {"z": z * z, "many": many * z, "k": k + 1}


@pytest.fixture
def given():
    return {"x": jnp.asarray(0.3), "many": jnp.arange(3.0), "k": jnp.asarray(2)}


def test_the_same_comes_out(given):
    plain, other = chain(given, 1.0), shared(chain)(given, 1.0)
    assert jax.tree.structure(plain) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(plain), jax.tree.leaves(other), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=1e-15)
    assert other["k"] == 3


OPTIMISED = {
    "xla_backend_optimization_level": 3,
    "xla_cpu_use_fusion_emitters": True,
    "xla_cpu_opt_preset": "CPU_OPT_PRESET_DEFAULT",
}


@pytest.mark.parametrize("value", [0.0, -0.0, 1e-310, -jnp.inf, jnp.inf])
def test_a_number_passes_unchanged(value):
    with sharing():
        # Optimised as for users: it is LLVM that makes nothing of the division, denormal numbers included.
        passed = jax.jit(once, compiler_options=OPTIMISED)(jnp.asarray(value))
    np.testing.assert_array_equal(np.asarray(passed).tobytes(), np.float64(value).tobytes())


def test_nan_stays_nan():
    with sharing():
        assert np.isnan(jax.jit(once)(jnp.nan))


def divisions(function, *args):
    return jax.jit(function).lower(*args).as_text().count("stablehlo.divide")


def test_numbers_used_again_get_a_barrier():
    """Of two sines one is used twice."""
    both = lambda x: (jnp.sin(x) ** 2 + jnp.sin(x), jnp.sin(2.0 * x))  # noqa: E731

    def reused(x):
        y = jnp.sin(x)
        return y * y + jnp.cos(y), jnp.sin(2.0 * x)

    assert divisions(both, 0.3) == 0
    assert divisions(shared(reused), 0.3) == 1


def test_no_barriers_on_an_accelerator(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    with sharing():
        assert divisions(lambda x: once(jnp.sin(x)), 0.3) == 0
    assert divisions(shared(lambda x: (jnp.sin(x), jnp.sin(x) ** 2)), 0.3) == 0


def test_counted_loops_are_differentiated_and_mapped():
    """A factorial's logarithm, turn by turn, against the closed form and JAX's own loop."""
    turn = lambda i, total, held: total + held["scale"] * jnp.log(i + held["first"])  # noqa: E731
    run = lambda x: counted(5, turn, jnp.zeros(()), {"scale": x, "first": 1, "name": "factorial"})  # noqa: E731
    assert float(run(2.0)) == pytest.approx(2.0 * math.log(120.0), rel=1e-15)
    assert float(jax.jvp(run, (2.0,), (1.0,))[1]) == pytest.approx(math.log(120.0), rel=1e-15)
    np.testing.assert_allclose(jax.vmap(run)(jnp.arange(3.0)), np.arange(3.0) * math.log(120.0), rtol=1e-15)


def test_nothing_moves_out_of_a_repeated_loop():
    """What every turn works out anew stays with its use; out of JAX's own loop XLA moves it."""
    going, turn = (lambda x: x < 10.0), (lambda x, held: x + jnp.exp(held))
    ours = jax.jit(lambda x: repeated(going, turn, 0.0 * x, x))
    plain = jax.jit(lambda x: jax.lax.while_loop(going, lambda y: turn(y, x), 0.0 * x))
    assert float(ours(0.5)) == float(plain(0.5))
    together = ["exponential_add" in f.lower(0.5).compile().as_text() for f in (ours, plain)]
    assert together == [True, False]


@pytest.mark.parametrize("was", [True, False])
def test_the_collector_is_left_as_it_was(was):
    """Off inside, also after an inner one has ended; afterwards as before, an exception or not."""
    before, seen = gc.isenabled(), []
    try:
        (gc.enable if was else gc.disable)()
        with pytest.raises(ZeroDivisionError), uncollected():
            with uncollected():
                pass
            seen.append(gc.isenabled())
            raise ZeroDivisionError
        assert seen == [False] and gc.isenabled() is was
        # A run that is compiled collects nothing meanwhile, and does not leave it so.
        jxr.simulate(*jxr.scenes.pivoted(), 0.01, ts=1, max_steps=77)
        assert gc.isenabled() is was
    finally:
        (gc.enable if before else gc.disable)()


def test_a_pulled_function_has_the_cotangents_of_its_own():
    def function(x, n, pair):
        return jnp.sin(x) ** n * pair["a"] + jnp.cos(x) * pair["b"]

    given = jnp.array([0.3, 0.7]), 3, {"a": jnp.array([2.0, 0.5]), "b": jnp.array(1.5)}
    total = lambda call: lambda x, pair: jnp.sum(call(x, given[1], pair) ** 2)  # noqa: E731
    np.testing.assert_allclose(pulled(function)(*given), function(*given))
    found = jax.grad(total(pulled(function)), argnums=(0, 1))(given[0], given[2])
    wanted = jax.grad(total(function), argnums=(0, 1))(given[0], given[2])
    jax.tree.map(np.testing.assert_allclose, found, wanted)
