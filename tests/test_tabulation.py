"""Derivatives of tables over arclength: by the implicit function theorem, against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.geometry import tabled
from jaxroll.geometry.contours._arclength import parameters_reaching, rising_sums
from tests.measures import both_ways
from tests.oracles.known_curves import ellipse_points

RING = ellipse_points(16) * (1.0 + 0.03 * np.random.default_rng(0).normal(size=(16, 1)))
WAVES = np.array([0.01, 0.0, 3e-4, 1e-4, 0.0, 2e-4, 1e-4])
SHAPES = {
    "closed spline": (lambda x: jxr.Spline(x, cells=64), RING),
    "open spline": (lambda x: jxr.Spline(x, closed=False, origin=5, cells=192), RING),
    "support function": (lambda x: jxr.SupportFunction(x[0], x[1:4], x[4:], cells=64), WAVES),
    "ellipse": (lambda x: jxr.Ellipse(x[0], x[1], cells=64).prepared(), np.array([0.012, 0.02])),
}


@pytest.mark.parametrize("name", SHAPES)
def test_table_is_differentiated_in_both_modes(name):
    """Its coefficients, and what is read from it a third of the way along."""
    make, numbers = SHAPES[name]

    def build(x):
        ready = tabled(make(x))
        frame = ready.frame(0.37 * ready.domain()[1])
        # In numbers about as large as coefficients, or else they would hide these.
        read = [frame.point.x, 0.01 * frame.tangent.y, 1e-4 * frame.curvature]
        return jnp.concatenate([ready.table.coefficients.ravel(), jnp.stack(read)])

    way = 1e-2 * np.abs(numbers).max() * np.random.default_rng(1).normal(size=numbers.shape)
    weights = np.random.default_rng(2).normal(size=jax.eval_shape(build, numbers).shape)
    both = both_ways(build)
    _, pushed, pulled = both(numbers, way, weights)
    at = lambda t: np.asarray(both(numbers + t * way, way, weights)[0])  # noqa: E731
    h = 1e-2
    steps = [(45.0, 1), (-9.0, 2), (1.0, 3)]
    slope = sum(c * (at(k * h) - at(-k * h)) for c, k in steps) / (60.0 * h)
    np.testing.assert_allclose(pushed, slope, rtol=0, atol=1e-8 * np.abs(slope).max())
    np.testing.assert_allclose(pushed[-3:], slope[-3:], rtol=0, atol=1e-7 * np.abs(slope[-3:]).max())
    np.testing.assert_allclose(np.sum(pulled * way), weights @ pushed, rtol=1e-10)


def test_root_has_derivatives_of_any_order():
    """x with a x + x^3 = 2 at a = 1: x = 1, x' = -1/4 and x'' = 1/32."""

    def root(a):
        progress = lambda a, x: (a * x + x**3, a + 3.0 * x**2)  # noqa: E731
        return parameters_reaching(progress, a, jnp.array([0.9]), jnp.array([2.0]))[0]

    first, second = jax.grad(root), jax.jacfwd(jax.grad(root))
    found = jax.jit(lambda a: (root(a), first(a), second(a)))(1.0)
    np.testing.assert_allclose(found, [1.0, -0.25, 0.03125], rtol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 16, 17, 1024])
def test_rising_sums(count):
    values = np.random.default_rng(count).uniform(size=count)
    expected = np.concatenate([[0.0], np.cumsum(values)])
    np.testing.assert_allclose(rising_sums(jnp.asarray(values)), expected, rtol=1e-14)
