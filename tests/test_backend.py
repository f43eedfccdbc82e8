"""One kernel per run: the attribute is there, changes no result, and stays away from what does not fit."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._integration import _simulate
from jaxroll._xla import _one_kernel, _quick, at_once, quickly
from jaxroll._xla._one_kernel import one_kernel
from tests.recorded import runs
from tests.subjects.swinging_plate import swinging

MARK = "xla_cpu_small_call"


def march(x, y):
    return jax.lax.fori_loop(0, 50, lambda i, x: x + 1e-2 * jnp.sin(x) * y, x), y


def text(function, *args):
    return jax.jit(lambda *a: one_kernel(function, *a)).lower(*args).as_text()


def test_a_run_is_one_kernel_and_so_is_a_batch(scene):
    grasp, state = scene
    run = jax.jit(lambda c: jxr.simulate(grasp.with_(damping=c), state, 0.1, ts=2).states.q)
    assert run.lower(0.006).as_text().count(f'{MARK} = "true"') == 1
    lanes = jax.jit(jax.vmap(run))
    assert lanes.lower(jnp.full(3, 0.006)).as_text().count(f'{MARK} = "true"') == 1


def test_the_kernel_changes_no_result(monkeypatch):
    grasp, state = swinging()
    marked = jxr.simulate(grasp, state, 0.2, ts=1, rtol=1e-11).states.q
    seen = []
    monkeypatch.setattr(_one_kernel, "misfits", lambda program: seen.append(program) or {"all"})
    # Another number of steps makes it another program: the one with kernels was traced before.
    plain = jxr.simulate(grasp, state, 0.2, ts=1, rtol=1e-11, max_steps=4093).states.q
    assert seen
    np.testing.assert_allclose(marked, plain, rtol=0, atol=1e-11)


@pytest.mark.parametrize("kind", [float, int])
def test_arguments_of_any_kind_come_through(kind):
    x, y = jnp.linspace(0.0, 1.0, 3), jnp.asarray(2, kind)
    assert MARK in text(march, x, y)
    out, same = jax.jit(lambda x, y: one_kernel(march, x, y))(x, y)
    np.testing.assert_allclose(out, march(x, y)[0], rtol=1e-14)
    assert same.dtype == y.dtype and same == 2


@pytest.mark.parametrize(
    "y", [np.int64(2**60 + 1), np.int64(-3), np.int64(0x7FF << 52 | 1), np.int64(1), np.uint64(2**64 - 1)]
)
def test_whole_numbers_that_no_double_is_come_through(y):
    def last_digit(x, y):
        return x, y % y.dtype.type(10), y

    x = jnp.linspace(0.0, 1.0, 3)
    lanes = jax.vmap(lambda y: one_kernel(last_digit, x, y)[1:])(jnp.stack([y, y]))
    for digit, same in (one_kernel(last_digit, x, jnp.asarray(y))[1:], [out[1] for out in lanes]):
        assert digit == y % y.dtype.type(10) and same == y


def test_vmap_maps_inside_the_kernel():
    x, y = jnp.linspace(0.0, 1.0, 12).reshape(4, 3), jnp.asarray(2.0)
    mapped = jax.vmap(lambda x: one_kernel(march, x, y)[0])
    assert MARK in jax.jit(mapped).lower(x).as_text()
    np.testing.assert_allclose(mapped(x), march(x, y)[0], rtol=1e-14)
    twice = jax.vmap(jax.vmap(lambda x, y: one_kernel(march, x, y)[0], (0, None)), (None, 0))
    np.testing.assert_allclose(twice(x, jnp.asarray([2.0, 2.0]))[1], march(x, y)[0], rtol=1e-14)


UNFIT = {
    "factorisation": lambda x: jnp.linalg.cholesky(jnp.eye(3) * (1.0 + x[0])),
    "sorting": jnp.sort,
    "scatter": lambda x: x.at[jnp.asarray([0, 2])].add(1.0),
    "product of matrices": lambda x: jnp.eye(3) @ x,
    "a large sum": lambda x: x + jnp.sum(jnp.ones((2, 2000)) * x[0]),
    "callback": lambda x: jax.pure_callback(np.sin, x, x),
}


@pytest.mark.parametrize("kind", UNFIT)
def test_what_does_not_fit_runs_as_it_always_did(kind):
    x, function = jnp.linspace(0.1, 1.0, 3), UNFIT[kind]
    assert MARK not in text(function, x)
    np.testing.assert_allclose(one_kernel(function, x), function(x))


def test_quick_programs_are_outermost_ones_alone():
    """A program takes options as a whole: nested in another, or derived, it is compiled as usual."""
    seen = []

    def doubled(x):
        seen.append(_quick.takes_options(x))
        return 2.0 * x

    quick = quickly(lambda x: jnp.sum(x * x))
    x = jnp.arange(3.0)
    doubled(x), jax.jit(doubled)(x), jax.vmap(doubled)(x), jax.grad(lambda x: jnp.sum(doubled(x)))(x)
    assert seen == [True, False, False, False]
    jax.jit(lambda: seen.append(_quick.takes_options(())))()
    assert seen[-1] is False
    assert quick(x) == jax.jit(quick)(x) == jax.jit(lambda: quick(x))() == 5.0
    np.testing.assert_array_equal(jax.grad(quick)(x), 2.0 * x)
    np.testing.assert_array_equal(jax.vmap(quick)(x[:, None]), x * x)


def test_a_run_has_options_of_its_own_where_it_is_the_whole_program(scene, monkeypatch):
    asked, runs = [], _simulate._RUNS

    def noted(key):
        return lambda *given: asked.append(key) or runs[key](*given)

    monkeypatch.setattr(_simulate, "_RUNS", {key: noted(key) for key in runs})
    grasp, state = scene
    end = lambda grasp, state: jxr.simulate(grasp, state, 0.1, ts=1).last.q  # noqa: E731
    alone, within = end(grasp, state), jax.jit(lambda state: end(grasp, state))(state)
    np.testing.assert_allclose(alone, within, rtol=1e-12)
    jax.eval_shape(lambda grasp: end(grasp, state), grasp)
    jax.eval_shape(lambda: end(grasp, state))
    assert asked == [(True, True)] + 3 * [(True, False)]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_small_functions_of_known_numbers_are_computed_by_numpy(dtype):
    modules = []

    @at_once
    def longer(xp, x, by, parts):
        modules.append(xp)
        return xp.concatenate([0.5 * x, parts[0] + by]), {"square": x * x}

    x = jnp.arange(1.0, 3.0, dtype=dtype)
    found = longer(x, 2.0, [x])
    assert all(isinstance(leaf, jax.Array) and leaf.dtype == dtype for leaf in jax.tree.leaves(found))
    np.testing.assert_allclose(found[0], [0.5, 1.0, 3.0, 4.0])
    np.testing.assert_allclose(found[1]["square"], [1.0, 4.0])
    # Known numbers stay known where something else is traced; traced ones have derivatives.
    inside = jax.jit(lambda y: y + float(np.asarray(longer(x, 2.0, [x])[0])[0]))(1.0)
    assert inside == 1.5 and modules == [np, np]
    by = jnp.asarray(2.0, dtype)
    slopes = jax.jacfwd(lambda x: longer(x, by, [x])[0])(x), jax.jacrev(lambda by: longer(x, by, [x])[0])(by)
    np.testing.assert_allclose(slopes[0], [[0.5, 0], [0, 0.5], [1, 0], [0, 1]])
    np.testing.assert_allclose(slopes[1], [0, 0, 1, 1])
    assert modules[2:] and set(modules[2:]) == {jnp}


def test_numbers_of_python_do_not_take_a_scene_out_of_single_precision():
    """They are of a weak type, which JAX fits to that of the arrays that they meet; NumPy's are not."""
    single = np.float32
    bodies = jxr.scenes.rectangle(single(0.03), single(0.05)), jxr.scenes.cuboid(single(0.03), single(0.05))
    assert [body.inertia.dtype for body in bodies] == [single, single]
    law = jxr.control.Opposition(20.0, damping=0.006, alpha=1e-3, start=np.zeros(2, single))
    grasp, state = jax.tree.map(lambda x: x.astype(single), runs.scene("pinch"))
    pressed = eqx.tree_at(lambda g: g.controller, grasp, law)
    run = jax.eval_shape(lambda: jxr.simulate(pressed, state, 0.01, rtol=1e-4, atol=1e-5, throw=False))
    assert run.last.q.dtype == single


def test_quick_programs_are_compiled_with_their_options(monkeypatch):
    asked = []
    monkeypatch.setattr(_quick.eqx, "filter_jit", lambda f, **options: asked.append(options) or f)
    quickly(lambda x: x)
    assert asked == [{}, {"compiler_options": _quick.QUICK}]


@pytest.mark.parametrize("within", [False, True])
def test_a_kernel_whose_only_result_is_large(within):
    """XLA divides large operations among threads, which its emitter of single functions does not know."""
    many = np.random.default_rng(0).normal(size=(20_000, 8))

    def lane(x):
        outer = one_kernel(lambda y: y[:, None] * y[None, :], x)
        return outer[0] + x if within else outer

    looped = lambda x: jax.lax.fori_loop(0, 2, lambda _, y: lane(y), x)  # noqa: E731
    found = jax.jit(jax.vmap(looped if within else lane))(many)
    wanted = many[:, :, None] * many[:, None, :]
    if within:
        wanted = many
        for _ in range(2):
            wanted = wanted[:, :1] * wanted + wanted
    np.testing.assert_allclose(found, wanted, rtol=1e-14)


@pytest.mark.parametrize(("names", "marked"), [(None, False), ({"x"}, False), ({"x", "y"}, True)])
def test_a_program_that_is_shared_out_among_devices_has_no_kernel(names, marked):
    """It cannot hold the exchanges that XLA puts into it; within `shard_map` over all axes there are none."""
    mesh = jax.sharding.AbstractMesh((2, 2), ("x", "y"))
    lanes = jax.P("x")
    x = jax.ShapeDtypeStruct((8,), float, sharding=jax.NamedSharding(mesh, lanes))

    def call(x):
        return one_kernel(jnp.sin, x)

    split = dict(mesh=mesh, in_specs=lanes, out_specs=lanes, check_vma=False)
    whole = call if names is None else jax.shard_map(call, axis_names=names, **split)
    assert (MARK in jax.jit(whole).trace(x).lower(lowering_platforms=("cpu",)).as_text()) is marked
