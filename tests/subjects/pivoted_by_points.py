"""Part 2 of the chapter with contours through points of its catenaries."""

import functools

import equinox as eqx
import numpy as np

import jaxroll as jxr
from jaxroll.scenes import OBJECT_SHIFT

HALF = 64  # intervals on either side of the vertex


def catenary_points(a, reach=0.02, count=2 * HALF):
    """Points of the chapter's catenary (80)-(83), the vertex among them."""
    s = np.linspace(-reach, reach, count + 1)
    return np.asarray(jxr.Catenary(a).point(s))


def pivoted_by_points(tip_points, face_points):
    """Part 2 with the contours of `scenes.pivoted` given by points; their middle one is the vertex."""
    grasp, state = jxr.scenes.pivoted()
    spline = functools.partial(jxr.Spline, closed=False, cells=512)
    tip = spline(tip_points, origin=len(tip_points) // 2).moved((0.01, 0.0)).moved(angle=-np.pi / 2)
    face = spline(face_points, origin=len(face_points) // 2).moved((-0.02, 0.0), np.pi, origin=OBJECT_SHIFT)
    grasp = eqx.tree_at(lambda g: (g.fingers[0].tip, g.object.contours), grasp, (tip, (face,)))
    return grasp, state
