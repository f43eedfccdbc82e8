"""Largest and smallest numbers whose derivatives compare nothing with the result."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxroll._linalg import larger, largest, smaller
from jaxroll._xla._one_kernel import inner_programs
from jaxroll.design._goals import soft_worst
from jaxroll.design._limits import soft_least
from jaxroll.design._measures import MEASURES

EXTREMES = {
    "largest": (largest, jnp.max),
    "larger": (lambda x: larger(x[0], x[1]), lambda x: jnp.maximum(x[0], x[1])),
    "smaller": (lambda x: smaller(x[0], x[1]), lambda x: jnp.minimum(x[0], x[1])),
    "soft_worst": (lambda x: soft_worst(x, 1.0), None),
    "soft_least": (lambda x: soft_least(x, 20.0), None),
}


def comparisons(function, *args):
    """How often a derivative asks whether two floating-point numbers are equal: as `jnp.max` does."""

    def count(program):
        own = 0
        for equation in program.eqns:
            kinds = [v.aval.dtype.kind for v in equation.invars]
            own += equation.primitive.name == "eq" and "f" in kinds
            own += sum(count(inside) for inside in inner_programs(equation.params))
        return own

    return count(jax.make_jaxpr(jax.grad(function))(*args).jaxpr)


@pytest.mark.parametrize("name", EXTREMES)
def test_values_and_derivatives_of_extremes(name):
    function, plain = EXTREMES[name]
    value, gradient = jax.jit(function), jax.jit(jax.grad(function))
    lanes, compared = jax.jit(jax.vmap(function)), comparisons(function, jnp.zeros(3))
    for x in ([2.0, -1.0, 0.5], [-1.0, 3.0, 0.5]):
        x, h = np.array(x), 1e-6 * np.eye(3)
        slope = gradient(x)
        if plain is not None:
            lost = [value(np.where(np.arange(3) == k, np.nan, x)) for k in (0, 1)]
            assert value(x) == plain(x) and np.isnan(lost).all()
            np.testing.assert_array_equal(slope, jax.grad(plain)(x))
            assert compared < comparisons(plain, x)
        steps = np.asarray(lanes(x + h)) - np.asarray(lanes(x - h))
        np.testing.assert_allclose(slope, steps / 2e-6, rtol=1e-7, atol=1e-8)
    assert compared == 0


@pytest.mark.parametrize("name", MEASURES)
def test_measures_of_a_run_compare_nothing_with_their_extremes(name, run):
    moving, still = eqx.partition(run, eqx.is_inexact_array)
    assert comparisons(lambda moving: MEASURES[name][0](eqx.combine(moving, still)), moving) == 0
