"""Operations of our own for JAX: what they give, their derivatives, batches, and what is traced of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxroll._xla._one_kernel import in_turn
from jaxroll._xla._primitives import barrier, linear_map
from jaxroll._xla._traced_once import traced_once

MATRIX = jnp.asarray([[1.0, -2.0, 0.5], [0.3, 4.0, -1.0]])
X = {"a": jnp.asarray([0.2, 1.0]), "b": jnp.asarray(-0.7)}
CALLS = []


def apply(at, x):
    CALLS.append("apply")
    return (at["matrix"] * at["factor"]) @ jnp.concatenate([x["a"], x["b"][None]])


def transpose(at, bar):
    CALLS.append("transpose")
    flat = (at["matrix"] * at["factor"]).T @ bar
    return {"a": flat[:2], "b": flat[2]}


def mapped(matrix, x, factor=2.0):
    """Twice the matrix times x, after something that has a derivative of its own."""
    x = jax.tree.map(jnp.sin, x)
    return linear_map(apply, transpose, {"matrix": matrix, "factor": factor}, x, like=jnp.zeros(2))


@jax.jit
def plain(matrix, x):
    return 2.0 * matrix @ jnp.sin(jnp.concatenate([x["a"], x["b"][None]]))


def same(a, b):
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-15), a, b)


@pytest.mark.parametrize("way", [lambda f: f, jax.jit])
def test_value_and_both_modes(way):
    for derived in (lambda f: f, jax.jacfwd, jax.jacrev):
        same(*(way(derived(lambda x, f=f: f(MATRIX, x)))(X) for f in (mapped, plain)))


@pytest.mark.parametrize("axes", [(None, 0), (0, None), (0, 0), (1, 0)])
def test_lanes_of_x_of_what_the_map_depends_on_or_both(axes):
    many = jax.tree.map(lambda a: jnp.stack([a, 2.0 * a, -a]), X)
    matrices = jnp.stack([MATRIX, 3.0 * MATRIX, -MATRIX], axis=axes[0] or 0)
    args = (MATRIX if axes[0] is None else matrices, X if axes[1] is None else many)
    for derived in (lambda f: f, lambda f: jax.jacfwd(f, 1), lambda f: jax.jacrev(f, 1)):
        same(*(jax.jit(jax.vmap(derived(f), axes))(*args) for f in (mapped, plain)))
    total = lambda f: lambda x: jnp.sum(jax.vmap(f, axes)(args[0], x))  # noqa: E731
    same(*(jax.jit(jax.grad(total(f)))(args[1]) for f in (mapped, plain)))


def test_lanes_along_another_axis():
    many = {"a": jnp.asarray([[0.2, 0.4, -0.2], [1.0, 2.0, -1.0]]), "b": jnp.asarray([-0.7, -1.4, 0.7])}
    axes = (None, {"a": 1, "b": 0})
    for derived in (lambda f: f, lambda f: jax.jacrev(f, 1)):
        same(*(jax.jit(jax.vmap(derived(f), axes))(MATRIX, many) for f in (mapped, plain)))


def test_a_gradient_traces_the_way_back_alone():
    CALLS.clear()
    jax.jit(jax.grad(lambda x: jnp.sum(mapped(MATRIX, x)))).lower(X)
    # The value of a sum is not asked for.
    assert CALLS == ["transpose"]


def test_a_derivative_in_what_the_map_depends_on_is_refused():
    with pytest.raises(NotImplementedError, match="first derivatives only"):
        jax.jacfwd(lambda matrix: mapped(matrix, X))(MATRIX)


def test_a_barrier_changes_no_number_and_no_derivative():
    x = jnp.asarray([0.3, -jnp.inf, -0.0])
    np.testing.assert_array_equal(np.asarray(jax.jit(barrier)(x)).tobytes(), np.asarray(x).tobytes())
    f, g = lambda x: jnp.sin(barrier(x)) * barrier(x), lambda x: jnp.sin(x) * x  # noqa: E731
    for derived in (jax.jacfwd, jax.jacrev, jax.hessian, jax.vmap):
        same(derived(f)(X["a"]), jax.jit(derived(g))(X["a"]))
    with jax.disable_jit():
        same(jax.grad(f)(0.3), jax.grad(g)(0.3))


def test_rows_in_turn_are_differentiated_in_all_that_is_given():
    def function(shared, row, count):
        return {"y": jnp.sin(shared["w"] * row) * count, "count": count + 1}

    def through(way):
        def value(shared, rows):
            return jnp.sum(way(shared, rows)["y"] ** 2)

        return value

    counts, rows, shared = jnp.arange(3), jnp.asarray([0.1, 0.5, -0.9]), {"w": jnp.asarray(1.7)}
    turn = lambda shared, rows: in_turn(function, shared, rows, counts)  # noqa: E731
    side = lambda shared, rows: jax.vmap(lambda r, c: function(shared, r, c))(rows, counts)  # noqa: E731
    np.testing.assert_array_equal(turn(shared, rows)["count"], counts + 1)
    for derived in (jax.jacrev, jax.jacfwd):
        same(*(jax.jit(derived(through(way), (0, 1)))(shared, rows) for way in (turn, side)))
    many = jnp.stack([rows, 2.0 * rows])
    lanes = lambda way: jax.jit(jax.vmap(jax.grad(through(way), (0, 1)), (None, 0)))  # noqa: E731
    same(*(lanes(way)(shared, many) for way in (turn, side)))


def test_a_value_and_the_rule_for_its_derivative_are_traced_once():
    count = []

    @traced_once
    def shared(x, power):
        count.append(power)
        return x**power

    @jax.custom_jvp
    def call(x):
        return shared(x, 3)

    @call.defjvp
    def _(primals, tangents):
        (x,), (dot,) = primals, tangents
        return call(x), 3.0 * shared(x, 2) * dot

    x = jnp.asarray(2.0)
    value, slope = jax.jit(jax.value_and_grad(jax.jit(call)))(x)
    assert (value, slope) == (8.0, 12.0) and sorted(count) == [2, 3]
    assert jax.jit(jax.grad(jax.grad(call)))(x) == 12.0
    assert jax.vmap(call)(jnp.arange(3.0)).tolist() == [0.0, 1.0, 8.0]
    mesh = jax.make_mesh((1,), ("lanes",))
    with jax.set_mesh(mesh):
        assert jax.jit(call)(jnp.asarray(3.0)) == 27.0
