"""Pinches in space, and the same ones for the second formulation: numbers alone are shared."""

from dataclasses import replace

import numpy as np

import jaxroll as jxr
from tests.oracles import reference_space as reference


def reference_shape(surface):
    """A tip or an object's surface for the reference."""
    if isinstance(surface, jxr.Sphere):
        return reference.sphere(float(surface.radius))
    if isinstance(surface, jxr.Ellipsoid):
        return reference.Ellipsoid(tuple(float(x) for x in (surface.a, surface.b, surface.c)))
    at = surface.near(np.zeros(3))
    return reference.Plane(tuple(np.asarray(surface.point(at))), tuple(np.asarray(surface.normal(at))))


def same_in_reference(grasp, **options):
    """The same grasp in the reference: numbers alone are shared."""
    fingers = []
    for f in grasp.fingers:
        numbers = (np.asarray(x) for x in (f.base, f.axes, f.offsets, f.masses, f.centres, f.inertias))
        fingers.append(reference.Chain(*numbers, reference_shape(f.tip)))
    body = grasp.object
    inner = reference.Body(
        float(body.mass), np.asarray(body.inertia), tuple(map(reference_shape, body.surfaces))
    )
    scene, _ = reference.pinch3d()
    contacts = tuple((c.finger, c.surface) for c in grasp.contacts)
    return replace(scene, fingers=tuple(fingers), body=inner, contacts=contacts, **options)


def egg():
    """An ellipsoid of 20 g to be pinched."""
    axes, mass = np.array([0.015, 0.025, 0.020]), 0.02
    return jxr.FreeObject3(jxr.Ellipsoid(*axes), mass, mass / 5 * (np.sum(axes**2) - axes**2))


PINCHES = {
    "cuboid": {},
    "ellipsoids": {"object": egg(), "tips": jxr.Ellipsoid(0.010, 0.008, 0.009)},
    "spin prevented": {"spin": "prevented"},
    "gravity": {"gravity": (0.3, -1.0, 0.5)},
}
AS_TOLD = {"spin prevented": {"no_spin": True}, "gravity": {"gravity": (0.3, -1.0, 0.5)}}
