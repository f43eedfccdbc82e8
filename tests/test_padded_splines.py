"""Surfaces of splines in arrays of few sizes, so that surfaces of all shapes share programs."""

import jax
import numpy as np
import pytest

from jaxroll._linalg import Vec3
from jaxroll.geometry import SplineSurface
from jaxroll.geometry.surfaces import padded


def some(counts, step):
    """A field of any numbers, on a grid with so many functions along each axis."""
    return SplineSurface(np.random.default_rng(1).normal(size=counts), (1.0, 2.0, 3.0), step)


@pytest.mark.parametrize("counts", [(6, 9, 8), (7, 33, 6), (6, 6, 129)])
def test_a_padded_field_is_the_surfaces_own_within_its_grid_and_beyond(counts):
    """There the last polynomials go on, and none of the zeros is met; arrays that are too long stay."""
    surface, cells = some(counts, 0.5), np.array(counts) - 5
    shares = np.random.default_rng(2).uniform(-0.5, 1.5, (40, 3))
    points = np.array([1.0, 2.0, 3.0]) + 0.5 * cells * shares
    levels = jax.jit(lambda field, points: jax.vmap(lambda p: field.derivatives(Vec3(*p)))(points))
    both = (jax.tree.leaves(levels(field, points)) for field in (surface, padded(surface)))
    for wanted, found in zip(*both, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-10)


def test_arrays_of_unlike_surfaces_are_of_the_same_types():
    """Also of a step that is Python's own number, which JAX would take for another type."""
    surfaces = some((6, 9, 8), 0.5), some((30, 7, 32), np.ones(()))
    one, other = (jax.tree.map(jax.typeof, padded(surface)) for surface in surfaces)
    assert one == other and one.coefficients.shape == (32, 32, 32)
