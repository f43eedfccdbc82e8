"""The linear algebra with which `close` goes on, against NumPy."""

import jax
import numpy as np
import pytest

from jaxroll._closing import _search


@pytest.mark.parametrize("redundant", [False, True])
def test_the_shortest_steps_change_the_rows_as_is_wanted(redundant):
    """In a metric of any sizes; of rows of which one says the same as another, the wanted changes agree."""
    rng = np.random.default_rng(3)
    rows, root = rng.normal(size=(3, 5)) * [[1.0], [1e-3], [40.0]], rng.normal(size=(5, 5))
    metric = root @ root.T + np.diag([1.0, 2.0, 0.5, 3.0, 1.0])
    wanted = rng.normal(size=(3, 2)) * [[1.0], [1e-3], [40.0]]
    if redundant:
        rows[2], wanted[2] = 7.0 * rows[0], 7.0 * wanted[0]
    pressures, steps = jax.jit(_search.solve_schur)(rows, metric, wanted)
    np.testing.assert_allclose(rows @ steps, wanted, rtol=1e-9)
    np.testing.assert_allclose(steps, np.linalg.solve(metric, rows.T) @ np.asarray(pressures), rtol=1e-9)
    # Shortest: by the eigenvectors of the metric, lengths are those of plain vectors.
    half = np.linalg.cholesky(metric)
    shortest = np.linalg.solve(half.T, np.linalg.pinv(np.linalg.solve(half, rows.T).T, rcond=1e-10) @ wanted)
    np.testing.assert_allclose(steps, shortest, rtol=1e-7, atol=1e-9)
