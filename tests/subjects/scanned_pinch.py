"""A scanned body between two fingertips that are fits to noisy scans themselves."""

import dataclasses
import pathlib

import numpy as np

import jaxroll as jxr
from tests.oracles.reference_space import Chain, quaternion_matrix
from tests.oracles.scanned_bodies import superellipsoid_cloud
from tests.oracles.spline_fields import SplineField

BANANA = pathlib.Path(__file__).parents[3] / "shared" / "data" / "ycb_011_banana.npz"
# Half axes of a fingertip like a thumb's [m], its roundness and the noise of its scan.
THUMB, ROUND, NOISE = (0.011, 0.009, 0.014), 2.5, 5e-5
POINTS, BODY_RADIUS, TIP_RADIUS, DENSITY = 6000, 5e-3, 4e-3, 300.0
# What moves the pinch [m/s^2].
GRAVITY = (1.0, -4.0, 2.0)


def banana():
    """Vertices [m] and faces of the shared scan."""
    with np.load(BANANA) as file:
        return file["vertices"].astype(float), file["faces"].astype(int)


def thumb(seed):
    """The fit to a noisy scan of a fingertip."""
    rng = np.random.default_rng(seed)
    cloud = superellipsoid_cloud(rng, THUMB, ROUND, POINTS)
    cloud += NOISE * rng.normal(size=cloud.shape)
    return jxr.geometry.fit_surface(cloud, smallest_radius=TIP_RADIUS)


def centred(surface, density=DENSITY):
    """A body of constant density within a surface of splines, whose grid is moved to its centre of mass."""
    found = jxr.geometry.mass_properties(surface, density)
    shifted = dataclasses.replace(surface, origin=surface.origin - found.centre)
    return jxr.FreeObject3(shifted, found.mass, found.inertia)


def pinched(surface, tips):
    """A scanned body between two scanned tips, which gravity moves: the grasp and its closed start."""
    body = centred(surface)
    grasp, state = jxr.scenes.pinch_object(body)
    points = np.reshape(state.s, (-1, 6))[:, 3:]
    for i, tip in enumerate(tips):
        grasp = grasp.with_tip(i, tip)
    found = jxr.reach(grasp, points, pose=np.asarray(state.q)[:7])
    if found.result != jxr.RESULTS.successful:
        raise RuntimeError(found.reason)
    grasp, state = found.start
    return grasp.with_(gravity=GRAVITY), state


def as_field(surface):
    return SplineField(surface.coefficients, surface.origin, surface.step)


def audited(grasp, states):
    """Least height of each surface's points over the other, contact by contact, and where, state by state.

    Poses are those of the finger's own chain, heights those of the fields over the lengths of their slopes.
    """
    chains = []
    for f in grasp.fingers:
        numbers = (np.asarray(x) for x in (f.base, f.axes, f.offsets, f.masses, f.centres, f.inertias))
        chains.append((Chain(*numbers, None), as_field(f.tip)))
    body = as_field(grasp.object.surfaces[0])
    outline = body.sampled(2)
    rims = [field.sampled(3) for _, field in chains]
    found = []
    for q in np.asarray(states.q):
        at, turn = q[:3], quaternion_matrix(q[3:7])
        angles = np.split(q[7:], len(chains))
        for (chain, field), rim, joints in zip(chains, rims, angles, strict=True):
            points, turned, _, _ = chain.place(joints)
            there = (points[-1] + rim @ turned[-1].T - at) @ turn
            near = np.linalg.norm(outline @ turn.T + at - points[-1], axis=1) < 0.04
            here = (outline[near] @ turn.T + at - points[-1]) @ turned[-1]
            found.append([lowest(body, there), lowest(field, here)])
    return np.array(found).reshape(len(states.q), len(chains), 2)


def lowest(field, points):
    """Least height of points over a field's surface [m], of those within its grid."""
    top = field.origin + field.step * (np.array(field.coefficients.shape) - 5)
    inside = np.all((points > field.origin) & (points < top), axis=1)
    points = points[inside]
    return np.min(field.derivative(points) / np.linalg.norm(field.gradient(points), axis=1))
