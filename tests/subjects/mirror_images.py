"""Grasps and states under the mirror y -> -y, made with jaxroll."""

import equinox as eqx
import numpy as np

import jaxroll as jxr
from jaxroll.geometry import Moved

MIRROR = np.array([1.0, -1.0])


def mirrored_contour(contour):
    """The image under y -> -y, run through the other way; plain contours here are their own images."""
    if not isinstance(contour, Moved):
        return contour
    inner = mirrored_contour(contour.contour)
    return Moved(inner, MIRROR * contour.offset, -contour.angle, origin=-contour.origin)


def mirrored(grasp, states):
    """Grasp and states under y -> -y, with the other `sense` at every contact."""
    body = grasp.object
    contours = tuple(mirrored_contour(c) for c in body.contours)
    if isinstance(body, jxr.PivotedObject):
        body, signs = jxr.PivotedObject(contours, body.inertia, pivot=MIRROR * body.pivot), [-1.0]
    else:
        body, signs = jxr.FreeObject(contours, body.mass, body.inertia), [1.0, -1.0, -1.0]
    fingers = [
        jxr.Finger(f.lengths, f.masses, mirrored_contour(f.tip), base=MIRROR * f.base) for f in grasp.fingers
    ]
    contacts = [
        jxr.Contact(-c.s_tip, -c.s_object, finger=c.finger, contour=c.contour, sense=-c.sense)
        for c in grasp.contacts
    ]
    control = grasp.controller
    if isinstance(control, jxr.control.Press):
        control = eqx.tree_at(lambda c: c.target, control, MIRROR * control.target)
    else:
        control = eqx.tree_at(lambda c: c.start, control, -control.start)
    image = jxr.Grasp(body, fingers, contacts, controller=control)
    flip = np.array([*signs, *[-1.0] * (image.coordinates - len(signs))])
    return image, jxr.State(flip * states.q, flip * states.v, -states.s)
