"""How far a fingertip stays clear of an object, away from their contact too.

A run that is asked for the event 'penetration' calls `clearance` with its poses: the samples of the fingertip
are compared with the object's faces (`_candidates`), and the smallest signed distance is returned.
"""

from collections.abc import Sequence

import jax.numpy as jnp

from ..._linalg import Pose2
from ..._types import Scalar
from ...geometry import AbstractContour
from ._candidates import feet, into, least, nearest_dense, spread

# An overlap below this is taken for the contact itself, whose gap a run keeps at zero to rounding [m].
TOLERANCE = 1e-7


def clearance(
    poses: tuple[Pose2, Pose2],
    tip: AbstractContour,
    faces: Sequence[AbstractContour],
    *,
    samples: int,
) -> Scalar:
    """Smallest signed distance [m] of a fingertip's sampled points from an object.

    A point is outside an object with several faces as far as it is outside the farthest one, so the
    faces must bound a convex body; a point past the end of an open face is outside. Features of the
    fingertip finer than its sampling are not seen.

    Args:
        poses: World poses of fingertip and object.
        tip: The fingertip's contour, with ends or closed.
        faces: The object's contours, with ends or closed.
        samples: Points on each contour.
    """
    points = into(poses[1], poses[0].place(tip.frame(spread(tip, samples)).point))
    outside = []
    for face in faces:
        s = spread(face, samples)
        # Inside the single kernel of a run, one reduction is cheaper than the loop of `nearest_blocked`.
        near = nearest_dense(face.frame(s).point, points)
        outside.append(feet(face, s, points, near).distance)
    # A point is inside a convex body where it is inside of all its faces: the largest distance counts.
    return least(jnp.max(jnp.stack(outside), axis=0), tip.closed)
