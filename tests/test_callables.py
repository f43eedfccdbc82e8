"""Callers' own laws, loads and commands: as quick as built-in ones, or told why not."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._xla import in_arithmetic
from jaxroll._xla._one_kernel import misfits


def operations(function, *args):
    """Names of the operations of a function that a run's kernel could not hold."""
    return misfits(jax.make_jaxpr(lambda *args: in_arithmetic("law", function, *args))(*args).jaxpr)


A = jnp.arange(12.0).reshape(3, 4) - 5.0
B = jnp.cos(jnp.arange(20.0)).reshape(4, 5)


@pytest.mark.parametrize(
    "function",
    [
        lambda a, b: a @ b,
        lambda a, b: jnp.einsum("ij,kj->ik", a, a),
        lambda a, b: jnp.einsum("ij,jk,ij->k", a, b, a),
        lambda a, b: jnp.outer(a[0], b[0]),
        lambda a, b: jnp.dot(a[0], b[:, 0]),
        lambda a, b: jax.vmap(jnp.dot)(a, 2.0 * a),
        lambda a, b: a.at[1].set(b[0, :4]),
        lambda a, b: a.at[1, 2].add(3.0),
        lambda a, b: a.at[7].set(1.0),  # out of bounds: dropped
        lambda a, b: a.at[7, 0].add(1.0, mode="clip"),
        lambda a, b: a.at[-1].set(b[0, :4]),
        lambda a, b: a.at[-8].set(1.0),
        lambda a, b: jax.jit(lambda x: x @ b)(a),
        lambda a, b: jax.lax.fori_loop(0, 3, lambda i, x: x @ (b @ b.T) * 0.1, a),
        lambda a, b: jax.lax.cond(a[0, 0] > 0, lambda x: x @ b, lambda x: -x @ b, a),
        lambda a, b: jax.lax.scan(lambda x, row: (x, row @ b), 0.0, a)[1],
        lambda a, b: {"sum": (a @ b).sum(), "none": None, "text": 3.0},
    ],
)
def test_products_and_updates_written_out_are_the_same(function):
    """In value and derivative; nothing is left that calls a library."""
    found, wanted = in_arithmetic("law", function, A, B), function(A, B)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-13, atol=1e-13), found, wanted)
    assert not operations(function, A, B)
    total = lambda f: lambda a, b: sum(jnp.sum(x**2) for x in jax.tree.leaves(f(a, b)))  # noqa: E731
    slopes = jax.grad(total(lambda a, b: in_arithmetic("law", function, a, b)), argnums=(0, 1))(A, B)
    for x, y in zip(slopes, jax.grad(total(function), argnums=(0, 1))(A, B), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-12)


def test_what_calls_a_library_is_named_and_large_products_stay():
    with pytest.warns(UserWarning, match="argument law uses .*lu"):
        in_arithmetic("law", lambda a: jnp.linalg.solve(a[:3, :3] + 9.0 * jnp.eye(3), a[:, 0]), A)
    large = jnp.ones((80, 80))
    with pytest.warns(UserWarning, match="dot_general"):
        in_arithmetic("law", lambda a: a @ a, large)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        in_arithmetic("law", lambda a: jnp.sin(a) @ B, A)


def test_a_law_of_ones_own_keeps_a_run_in_one_kernel():
    """The built-in law written with arrays: its motion, and no operation that would break up the kernel."""
    grasp, state = jxr.scenes.pivoted()
    law = grasp.controller

    def own(t, angles, rates, tips):
        pull = law.stiffness * (tips[0].position - law.target)
        return (-law.damping * rates[0] - tips[0].jacobian.T @ pull,)

    acted = grasp.with_(controller=own)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = jxr.simulate(acted, state, 0.2, ts=3)
    np.testing.assert_allclose(run.last.q, jxr.simulate(grasp, state, 0.2, ts=3).last.q, rtol=0, atol=1e-10)
    text = jax.jit(lambda c: jxr.simulate(acted.with_(gravity=c), state, 0.2, ts=3).last.q).lower(
        jnp.zeros(2)
    )
    assert "dot_general" not in text.as_text() and "xla_cpu_small_call" in text.as_text()
