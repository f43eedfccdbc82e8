"""What JAX can be told to be strict about: kinds of numbers, and traced arrays that outlive their trace."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._xla._one_kernel import inner_programs
from tests.recorded import runs

ROUND = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
POINTS = np.stack([0.02 * np.cos(ROUND), 0.018 * np.sin(ROUND)], axis=-1)


def test_the_derivative_of_a_run_mixes_no_kinds_of_numbers(scene):
    """In reverse mode, of a run that jumps."""
    grasp, state = scene

    def end(scale):
        moved = grasp.with_(load=jxr.loads.Push(scale * np.array([0.1, 0.0]), 0.02 * scale, 0.04))
        return jxr.simulate(moved, state, t1=0.05, ts=3).states.q[-1, 0]

    with jax.numpy_dtype_promotion("strict"):
        assert jax.jit(jax.grad(end)).lower(1.0).as_text()


def oval(u):
    return jnp.stack([0.02 * jnp.cos(u), 0.018 * jnp.sin(u)])


@pytest.mark.parametrize(
    "contour",
    [
        lambda scale: jxr.Ellipse(0.02 * scale, 0.018, cells=16),
        lambda scale: jxr.Spline(scale * POINTS, degree=3, cells=16, origin=9),
        lambda scale: jxr.Parametric(oval, (0.0, 2 * np.pi), closed=True, origin=scale, cells=16),
    ],
)
def test_tables_of_contours_mix_no_kinds_of_numbers(contour):
    with jax.numpy_dtype_promotion("strict"):
        jax.eval_shape(lambda scale: contour(scale).prepared().table.coefficients, jnp.asarray(0.5))


def test_the_balance_of_a_pinch_mixes_no_kinds_of_numbers():
    grasp, state = runs.scene("pinch")
    with jax.numpy_dtype_promotion("strict"):
        found = jax.eval_shape(lambda beta: jxr.pinch_balance(grasp.with_(beta=beta), 0.0, state).l, 10.0)
    assert found.shape == (2,)


def test_a_state_of_less_precision_is_refused_as_ever_where_no_kinds_may_be_mixed(scene):
    single = jax.tree.map(lambda x: x.astype(jnp.float32), scene[1])
    with (
        jax.numpy_dtype_promotion("strict"),
        pytest.raises(ValueError, match="must be of its grasp's float64"),
    ):
        jxr.simulate(scene[0], single, 0.1, rtol=1e-5)


def kept(thing, seen):
    """All traced arrays that a rule or a function closes over, or what these hold."""
    if id(thing) in seen:
        return
    seen[id(thing)] = thing
    if isinstance(thing, jax.core.Tracer):
        yield thing
    elif inspect.isfunction(thing):
        for cell in thing.__closure__ or ():
            yield from kept(cell.cell_contents, seen)
    elif callable(thing) and hasattr(thing, "__wrapped__"):
        yield from kept(thing.__wrapped__, seen)
    else:
        for leaf in jax.tree.leaves(thing):
            if leaf is not thing:
                yield from kept(leaf, seen)


def equations(program):
    for equation in program.eqns:
        yield equation
        for inside in inner_programs(equation.params):
            yield from equations(inside)


def test_programs_keep_no_traced_arrays(scene):
    """Else whole traces live as long as the programs, and `jax.checking_leaks` stops every derivative."""
    grasp, state = scene

    def q(damping):
        return jxr.simulate(grasp.with_(damping=damping), state, t1=0.05, ts=3).states.q

    program = jax.make_jaxpr(jax.jacfwd(q))(0.006).jaxpr
    rules = [e.params["rule"] for e in equations(program) if e.primitive.name == "custom_vmap_call"]
    maps = [e.params["there"] for e in equations(program) if e.primitive.name == "linear_map"]
    assert rules and maps
    assert not [x for rule in (*rules, *maps) for x in kept(rule, {})]


@pytest.mark.parametrize("leaf", [None, (3,), "x", object(), True, 1.5])
def test_what_is_no_run_and_no_grasp_prints_all_the_same(scene, run, leaf):
    """As trees of `in_axes` or of shardings are, and what `equinox.partition` leaves."""
    for thing in (*scene, run):
        other = jax.tree.map(lambda _: leaf, thing)
        assert str(other).startswith(type(thing).__name__) and repr(other).startswith(type(thing).__name__)


def test_grasps_of_numpys_arrays_run_as_those_of_jax(scene):
    """`jax.device_get` leaves such ones."""
    grasp, state = scene
    there = jxr.energies(*jax.device_get(scene))
    np.testing.assert_array_equal(there, jxr.energies(grasp, state))
    odd = jax.tree.map(lambda x: np.asarray(x)[None], grasp)
    with pytest.raises(ValueError, match=r"^argument grasp.object.*must (be of the shape|have shape)"):
        jxr.energies(odd, state)
