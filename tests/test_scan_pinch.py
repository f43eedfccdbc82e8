"""A scanned body pinched by fingertips that are scans: constraints, energy, overlap by SciPy's B-splines."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from tests.subjects import scanned_pinch as scanned


@pytest.mark.slow
@pytest.mark.optimised
def test_a_banana_between_two_scanned_fingertips():
    if not scanned.BANANA.exists():
        pytest.skip("the scan is not here")
    vertices, faces = scanned.banana()
    body = jxr.geometry.fit_surface(vertices, faces=faces, smallest_radius=scanned.BODY_RADIUS).surface
    grasp, state = scanned.pinched(body, [scanned.thumb(seed).surface for seed in (1, 2)])
    # A bump of the scan passes in 20 ms: that is how dense the states must be for lengths of loci.
    run = jxr.simulate(grasp, state, 1.0, ts=161, record=("multipliers", "energy"))
    left = run.residuals
    for part in (left.normal, left.tangential, left.tangency):
        assert np.abs(part).max() <= 1e-12
    size = np.abs(run.energy.kinetic + run.energy.potential).max()
    assert np.abs(run.energy.residual).max() <= 1e-9 * size
    assert run.multipliers.f.min() > 0.3
    path = np.asarray(run.states.q)
    assert np.abs(path[-1, :3] - path[0, :3]).max() > 1e-3  # it moves

    # Contact points lie on both fields, whose slopes are opposite there.
    fields = [scanned.as_field(f.tip) for f in grasp.fingers], scanned.as_field(grasp.object.surfaces[0])
    places = np.asarray(run.states.s).reshape(-1, 2, 2, 3)
    for i, tip in enumerate(fields[0]):
        for field, at in ((tip, places[:, i, 0]), (fields[1], places[:, i, 1])):
            height = field.derivative(at) / np.linalg.norm(field.gradient(at), axis=1)
            assert np.abs(height).max() <= 1e-12
    # No sample of one is below the other: the lowest is as high as its distance from the contact lets it be.
    clear = scanned.audited(grasp, jax.tree.map(lambda part: part[::4], run.states))
    assert clear.min() >= -1e-9 and clear.max() <= 1e-3

    curves = jxr.loci(grasp, run)
    lengths = np.asarray(curves.tip.arclength), np.asarray(curves.object.arclength)
    np.testing.assert_allclose(lengths[0], lengths[1], atol=1e-9)
    assert lengths[0][:, -1].min() > 1e-3
    for curve, side in ((curves.tip, 0), (curves.object, 1)):
        steps = np.linalg.norm(np.diff(places[:, :, side], axis=0), axis=2).sum(axis=0)
        np.testing.assert_allclose(steps, np.asarray(curve.arclength)[:, -1], rtol=5e-3)
    torques = jxr.torques(grasp, run.ts, run.states)
    assert jnp.isfinite(jnp.concatenate([jnp.ravel(x) for x in torques])).all()
