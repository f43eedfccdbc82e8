"""How far a fingertip stays clear of an object, away from their contact too."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra import Pose2, Vec2
from .._types import Scalar
from ..geometry import AbstractContour, Frenet2

# Overlaps below this are not told from the contact itself [m].
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
    points = tip.frame(_spread(tip, samples)).point
    local = _into(poses[1], poses[0].place(points))
    outside = [_signed_distance(face, _spread(face, samples), local) for face in faces]
    return _least(jnp.max(jnp.stack(outside), axis=0), tip.closed)


def _least(values: Array, closed: bool) -> Scalar:
    """Smallest of sampled values, by the parabola through it and its neighbours."""
    last = values.shape[0] - 1  # on a closed contour the first sample again
    i = jnp.argmin(values)
    before = values[(i - 1) % last if closed else jnp.maximum(i - 1, 0)]
    after = values[(i + 1) % last if closed else jnp.minimum(i + 1, last)]
    bend = before + after - 2.0 * values[i]
    inside = closed | ((i > 0) & (i < last))
    drop = (after - before) ** 2 / (8.0 * jnp.where(bend > 0, bend, 1.0))
    return values[i] - jnp.where(inside & (bend > 0), drop, 0.0)


def _spread(contour: AbstractContour, count: int) -> Float[Array, " samples"]:
    ends = contour.domain()
    if ends is None:
        raise ValueError(
            f"argument events may hold 'penetration' only if every contour has ends or is closed, "
            f"but {type(contour).__name__} is endless"
        )
    return ends[0] + (ends[1] - ends[0]) * jnp.linspace(0.0, 1.0, count)


def _into(pose: Pose2, point: Vec2) -> Vec2:
    """A world point in the body frame."""
    arm = point - pose.origin
    return Vec2(pose.cos * arm.x + pose.sin * arm.y, pose.cos * arm.y - pose.sin * arm.x)


def _signed_distance(face: AbstractContour, s: Array, points: Vec2) -> Array:
    """Distance outwards from one face: nearest sample, then one Newton step along the contour."""
    frame = face.frame(s)
    away = (points.x[:, None] - frame.point.x[None, :]) ** 2
    away = away + (points.y[:, None] - frame.point.y[None, :]) ** 2
    near = s[jnp.argmin(away, axis=1)]
    along, _ = _offset(face.frame(near), points)
    foot, past = near + along, jnp.zeros_like(along)
    if not face.closed:
        foot = jnp.clip(foot, s[0], s[-1])
        past = jnp.abs(near + along - foot)
    along, out = _offset(face.frame(foot), points)
    return jnp.where(past > 0.0, jnp.hypot(along, out), out)


def _offset(frame: Frenet2, points: Vec2) -> tuple[Array, Array]:
    """Arclength to the foot of each point, and distance outwards, to second order."""
    arm = Vec2(points.x - frame.point.x, points.y - frame.point.y)
    along, out = arm.dot(frame.tangent), arm.cross(frame.tangent)
    bend = jnp.maximum(1.0 + frame.curvature * out, 0.5)
    return along / bend, out + 0.5 * frame.curvature * along * along
