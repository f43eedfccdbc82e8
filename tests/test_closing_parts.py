"""The linear algebra with which `close` goes on, against NumPy."""

import jax
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._closing import _search
from tests.recorded import runs


@pytest.mark.parametrize("redundant", [False, True])
def test_the_shortest_steps_change_the_rows_as_is_wanted(redundant):
    """In a metric of any sizes; of rows of which one says the same as another, the wanted changes agree."""
    rng = np.random.default_rng(3)
    rows, root = rng.normal(size=(3, 5)) * [[1.0], [1e-3], [40.0]], rng.normal(size=(5, 5))
    metric = root @ root.T + np.diag([1.0, 2.0, 0.5, 3.0, 1.0])
    wanted = rng.normal(size=(3, 2)) * [[1.0], [1e-3], [40.0]]
    if redundant:
        rows[2], wanted[2] = 7.0 * rows[0], 7.0 * wanted[0]
    pressures, steps, each = jax.jit(_search.solve_schur)(rows, metric, wanted)
    np.testing.assert_allclose(rows @ steps, wanted, rtol=1e-9)
    np.testing.assert_allclose(steps, np.linalg.solve(metric, rows.T) @ np.asarray(pressures), rtol=1e-9)
    np.testing.assert_allclose(each, np.diag(rows @ np.linalg.solve(metric, rows.T)) ** -0.5, rtol=1e-12)
    # Shortest: by the eigenvectors of the metric, lengths are those of plain vectors.
    half = np.linalg.cholesky(metric)
    shortest = np.linalg.solve(half.T, np.linalg.pinv(np.linalg.solve(half, rows.T).T, rcond=1e-10) @ wanted)
    np.testing.assert_allclose(steps, shortest, rtol=1e-7, atol=1e-9)


def pivoted(size):
    """Part 2's scene with all lengths times `size`, and angles near its own."""
    reach = (-0.03 * size, 0.03 * size)
    tip = jxr.Catenary(size / 40.0, reach).moved((0.01 * size, 0.0)).moved(angle=-np.pi / 2)
    face = jxr.Catenary(size / 100.0, reach).moved((-0.02 * size, 0.0), np.pi)
    finger = jxr.Finger(np.array([0.065, 0.065]) * size, [0.045, 0.045], tip)
    body = jxr.PivotedObject(face, 1e-5 * size**2, pivot=np.array([0.03, 0.105]) * size)
    contact = jxr.Contact(s_tip=-0.003 * size, s_object=0.003 * size)
    return jxr.Grasp(body, finger, contact), np.array([-0.45, 1.95, -0.8]), np.ones(3)


def pinched(size):
    """An ellipse between two others with all lengths times `size`, and coordinates near a closed pose."""
    with runs.not_closed():
        grasp, state = jxr.scenes.pinch_ellipse(tips=jxr.Ellipse(0.012, 0.02))
    body = jxr.FreeObject(
        jxr.Ellipse(0.015 * size, 0.025 * size), grasp.object.mass, grasp.object.inertia * size**2
    )
    tip = jxr.Ellipse(0.012 * size, 0.02 * size)
    fingers = [
        jxr.Finger(f.lengths * size, f.masses, tip.moved(angle=side * np.pi / 2), base=f.base * size)
        for f, side in zip(grasp.fingers, (-1, 1), strict=True)
    ]
    contacts = [
        jxr.Contact(c.s_tip * size, c.s_object * size, finger=c.finger, sense=c.sense) for c in grasp.contacts
    ]
    away = [-0.0019, 0.0023, 0.067, 0.039, 0.013, -0.016, 0.073, 0.098]
    units = np.array([size, size, *np.ones(6)])
    return jxr.Grasp(body, fingers, contacts), (np.asarray(state.q) + away) * units, units


@pytest.mark.parametrize(
    ("scene", "size"), [(pivoted, 1e-6), (pivoted, 0.1), (pinched, 1e-3), (pinched, 0.1)]
)
def test_the_nearest_pose_is_that_of_a_grasp_of_any_size(scene, size):
    """Where contacts may roll, how far counts beside the mean weight of a coordinate: hardly in these."""

    def nearest(size):
        grasp, q, units = scene(size)
        guess = jxr.State(q, np.zeros(len(q)), np.zeros(len(grasp.contacts)))
        return jxr.close(grasp, guess, hold_contacts=False)[1].q / units

    np.testing.assert_allclose(nearest(size), nearest(1.0), rtol=0, atol=1e-5)
