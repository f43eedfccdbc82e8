"""The branch-free sine and cosine against extended precision, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxroll._xla._trigonometry import branch_free_inverse_sinh, inverse_sinh, sine_cosine


def units(found, exact):
    """Largest error in units in the last place of the exact value."""
    return np.max(np.abs(found - exact) / np.spacing(np.abs(exact).astype(float)))


@pytest.mark.parametrize(("scale", "bound"), [(0.7, 1.1), (10.0, 1.6), (1e4, 3.0), (1e6, 3.0)])
def test_within_three_units_in_the_last_place(scale, bound):
    angles = np.random.default_rng(0).uniform(-scale, scale, 200_000)
    sine, cosine = map(np.asarray, jax.jit(jax.vmap(sine_cosine))(jnp.asarray(angles)))
    exact = angles.astype(np.longdouble)
    assert units(sine, np.sin(exact)) <= bound and units(cosine, np.cos(exact)) <= bound


def test_quadrants_signs_and_zero():
    angles = np.concatenate([np.arange(-9, 10) * np.pi / 2, [0.0, -0.0, np.pi / 4, -np.pi / 4]])
    both = jax.jit(jax.vmap(sine_cosine))
    sine, cosine = map(np.asarray, both(angles))
    np.testing.assert_allclose(sine, np.sin(angles), atol=1e-300, rtol=3e-16)
    np.testing.assert_allclose(cosine, np.cos(angles), atol=1e-300, rtol=3e-16)
    assert all(np.isnan(x).all() for x in both(np.full_like(angles, np.nan)))


def test_derivatives_and_single_precision():
    x = jnp.array(1.234)
    for order, (sine, cosine) in enumerate([(jnp.cos, lambda a: -jnp.sin(a)), (lambda a: -jnp.sin(a), None)]):
        f, g = (lambda a: sine_cosine(a)[0]), (lambda a: sine_cosine(a)[1])
        for _ in range(order + 1):
            f, g = jax.grad(f), jax.grad(g)
        assert abs(f(x) - sine(x)) < 1e-15
        assert cosine is None or abs(g(x) - cosine(x)) < 1e-15
        assert abs(jax.vmap(f)(x[None])[0] - f(x)) < 1e-15
    single = sine_cosine(jnp.float32(0.5))
    assert single[0].dtype == jnp.float32 and abs(single[0] - np.sin(0.5)) < 1e-7


def test_branch_free_inverse_sinh_is_within_two_ulp():
    rng = np.random.default_rng(0)
    x = np.concatenate(
        [rng.uniform(-3.0, 3.0, 20000), 10.0 ** rng.uniform(-12.0, 12.0, 20000), [0.0, -1e150]]
    )
    exact = np.arcsinh(x.astype(np.longdouble))
    # Compiled: XLA reckons with sums as if they were exact, unless something keeps it from that.
    off = np.abs(np.asarray(jax.jit(branch_free_inverse_sinh)(x)) - exact)
    assert np.max(off / np.spacing(np.abs(exact).astype(float))) <= 2.0
    np.testing.assert_allclose(jax.vmap(inverse_sinh)(jnp.asarray(x)), jnp.arcsinh(x), rtol=1e-15)
    slope = jax.jit(jax.vmap(jax.grad(inverse_sinh)))(x[:100])
    np.testing.assert_allclose(slope, 1.0 / np.sqrt(1.0 + x[:100] ** 2), rtol=1e-15)
