"""How far points stay outside of an object: of a fingertip away from its contact, and of a finger's links.

A point is outside of a body with one closed face by its signed distance from that face, and outside of one
with several faces as far as it is outside of the farthest: several faces must bound a convex body.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ._sheet import Sheet

# Samples of a contour and of a surface.
_SAMPLES = (512, 720)
# Newton steps to a point's foot, from the nearest sample.
_FEET = 4
# A foot is at an end of its face if the arm is aside of the normal by more than this share of its length.
_ASIDE = 1e-3


class SampledObject(NamedTuple):
    """Faces of an object with samples of each.

    Attributes:
        faces: Its sheets.
        places: Samples of each face.
        points: Their points.
    """

    faces: tuple[Sheet, ...]
    places: tuple[np.ndarray, ...]
    points: tuple[np.ndarray, ...]


def sampled_object(faces: Sequence[Sheet], extent: float) -> SampledObject:
    """An object with its faces sampled; those without bounds within `extent` of its origin [m]."""
    places = tuple(face.sampled(_SAMPLES[face.spatial], extent) for face in faces)
    points = tuple(face.frames(at).points for face, at in zip(faces, places, strict=True))
    return SampledObject(tuple(faces), places, points)


def heights(solid: SampledObject, points: np.ndarray) -> np.ndarray:
    """Signed distances of points from an object, shape (n,) [m]; negative inside. All in its frame."""
    from scipy.spatial import KDTree  # set-up only: imported with the first use

    outside = np.full(len(points), -np.inf)
    for face, places, samples in zip(solid.faces, solid.places, solid.points, strict=True):
        at = face.feet(points, places[KDTree(samples).query(points)[1]], _FEET)
        here = face.frames(at)
        arm = points - here.points
        height = np.einsum("nd,nd->n", arm, here.normals)
        length = np.linalg.norm(arm, axis=1)
        # Beside an end of the face a point is outside, by its distance.
        aside = length - np.abs(height) > _ASIDE * length
        open_ = _has_ends(face)
        outside = np.maximum(outside, np.where(aside & open_, length, height))
    return outside


def _has_ends(face: Sheet) -> bool:
    if face.spatial:
        at = tuple(np.zeros(face.coordinates) + 0.1)  # any place: asked is whether there are margins at all
        return bool(face.shape.margins(at))
    return face.shape.domain() is not None and not face.shape.closed
