r"""How far a fingertip stays clear of an object, away from their contact too.

A run that is asked for the event 'penetration' calls `clearance` with its poses, in space `clearance3`: the
samples of the fingertip are compared with the object's faces, and the smallest signed distance is returned.
Samples are too far apart for that to be accurate, so that some Newton steps go down from the lowest one: down
the signed distance h of one shape's points from the other.

In space, with the foot's normal $n$ and the shape operators $L$ of both, a tangent step $\delta$ changes h
by $n \cdot \delta + \frac12 \delta \cdot (L_A + L_B)\, \delta$ where the normals are nearly opposite, so
that $\delta = -(L_A + L_B)^{-1} n$ in the tangent plane.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._linalg import larger, Pose2, Pose3, root, row, smaller, square, Sym3, Vec3
from ..._types import Scalar, Scalars
from ...geometry import AbstractContour, AbstractSurface, Gauss3
from ._candidates import Feet, feet, into, nearest_dense, spread, toward
from ._pair3 import summed
from ._samples3 import footed

# An overlap below this is taken for the contact itself, whose gap a run keeps at zero to rounding [m].
TOLERANCE = 1e-7
# Newton steps down the distance in the plane, from the lowest sample.
_STEPS = 3


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
    walked = spread(tip, samples)
    points = into(poses[1], poses[0].place(tip.frame(walked).point))
    found: list[tuple[AbstractContour, Any, Feet]] = []
    for face in faces:
        s = spread(face, samples)
        # Inside the single kernel of a run, one reduction is cheaper than the loop of `nearest_blocked`.
        near = nearest_dense(face.frame(s).point, points)
        found.append((face, (s[0], s[-1]), feet(face, s, points, near)))
    # A point is inside a convex body where it is inside of all its faces: the largest distance counts.
    heights = functools.reduce(larger, [foot.distance for _, _, foot in found])
    lowest = jnp.argmin(heights)
    nearest = [(face, ends, foot.s[lowest]) for face, ends, foot in found]
    most, smallest = walked[1] - walked[0], heights[lowest]
    for along in range(len(nearest)):
        # A loop, which compiles in two thirds of the time of its turns written out, and runs as fast.
        steps = lambda at, _: (_down(poses, tip, at, along, most), None)  # noqa: B023, E731
        at, _ = jax.lax.scan(steps, (walked[lowest], nearest), None, length=_STEPS)
        place = at[0] if tip.closed else jnp.clip(at[0], walked[0], walked[-1])
        smallest = smaller(smallest, _apart(poses, tip, (place, at[1])))
    return smallest


# Arclength of a fingertip [m], and of each face with its ends the arclength of its foot.
_Place = tuple[Array, list[tuple[AbstractContour, Any, Array]]]


def _down(poses: tuple[Pose2, Pose2], tip: AbstractContour, at: _Place, along: int, most: Scalar) -> _Place:
    r"""A place of a fingertip after one Newton step down its distance h from one of the faces.

    With the foot's normal n, $h' = n \cdot t$, and close to a contact
    $h'' = \kappa\, n \cdot t_\perp + \kappa_f (t \cdot t_f)^2$. No step is longer than `most`.
    """
    frame = tip.frame(at[0])
    point, tangent = into(poses[1], poses[0].place(frame.point)), poses[1].back(poses[0].turn(frame.tangent))
    feet = [(face, ends, toward(face, ends, (s, face.frame(s)), point)) for face, ends, s in at[1]]
    face, _, foot = feet[along]
    there = face.frame(foot.s)
    slope, across = foot.slope.dot(tangent), tangent.dot(there.tangent)
    bend = frame.curvature * foot.slope.dot(tangent.left()) + there.curvature * across * across
    bend = larger(bend, jnp.abs(slope) / most)
    step = jnp.where(bend > 0.0, slope / jnp.where(bend > 0.0, bend, 1.0), 0.0)
    return at[0] - step, [(face, ends, foot.s) for face, ends, foot in feet]


def _apart(poses: tuple[Pose2, Pose2], tip: AbstractContour, at: _Place) -> Scalar:
    """How far a place of a fingertip is outside of the convex body that the faces bound."""
    point = into(poses[1], poses[0].place(tip.frame(at[0]).point))
    distances = []
    for face, ends, s in at[1]:
        near = toward(face, ends, (s, face.frame(s)), point).s
        foot = toward(face, ends, (near, face.frame(near)), point)
        # Where the foot has not been found there is no distance; that of the samples stays.
        found = jnp.abs(foot.s - near) <= _FOUND * (ends[1] - ends[0])
        distances.append(jnp.where(found, foot.distance, jnp.inf))
    return functools.reduce(larger, distances)


# Newton steps down the distance, of the foot for each of them, and of the feet of all samples.
_DOWN, _FOOT = 4, 6
# A foot that the last step moves by less than this share of its contour has been found.
_FOUND = 1e-5
# A foot not farther than this from an end of its surface is at the end [m].
_AT_END = 1e-9


def clearance3(
    poses: tuple[Pose3, Pose3], tip: AbstractSurface, faces: Sequence[AbstractSurface], *, samples: int
) -> Scalar:
    """Smallest signed distance [m] of a fingertip from an object in space.

    The points of a bounded fingertip are measured against the object's faces, which must bound a convex body,
    as in the plane. With an unbounded fingertip the points of the object's faces, which must then be bounded,
    are measured against the fingertip.

    Args:
        poses: World poses of fingertip and object.
        tip: The fingertip's surface.
        faces: The object's surfaces.
        samples: Places on each surface that is sampled.
    """
    if tip.spread(1) is not None:
        return _lowest(poses, tip, faces, samples)
    return functools.reduce(smaller, [_lowest((poses[1], poses[0]), face, [tip], samples) for face in faces])


def _lowest(
    poses: tuple[Pose3, Pose3], walked: AbstractSurface, others: Sequence[AbstractSurface], samples: int
) -> Scalar:
    """Smallest signed distance of a bounded surface's points from the body that some surfaces bound."""
    at = walked.spread(samples)
    assert at is not None
    at = tuple(jnp.asarray(x) for x in at)
    points = jax.vmap(lambda at: walked.frame(at).point)(at)
    heights = jax.vmap(lambda point: _outside(poses, point, others))(points)
    lowest = jnp.argmin(heights)
    begin, least = tuple(row(x, lowest) for x in at), row(heights, lowest)
    # No step is longer than samples are apart: the size of what they cover over the root of their number.
    apart = root(jnp.max(points.dot(points))) * (3.0 / samples**0.5)
    for other in others:
        down = lambda place, _: (_downward(poses, walked, place, other, apart), None)  # noqa: B023, E731
        place, _ = jax.lax.scan(down, begin, None, length=_DOWN)
        least = smaller(least, _outside(poses, walked.frame(place).point, others))
    return least


def _outside(poses: tuple[Pose3, Pose3], point: Vec3, others: Sequence[AbstractSurface]) -> Scalar:
    """How far a point of one body is outside of the convex body that surfaces of the other one bound."""
    there = poses[1].local(poses[0].place(point))
    return functools.reduce(larger, [height3(there, other)[0] for other in others])


def height3(point: Vec3, surface: AbstractSurface) -> tuple[Scalar, Vec3, Array]:
    """Signed distance of a point in a surface's frame from it [m], normal at the foot, whether at an end.

    Beside an end of the surface a point is outside, by its distance.
    """
    at, foot = _foot(surface, point)
    arm = point - foot.point
    height = arm.dot(foot.normal)
    ended = jnp.asarray(False)
    for margin in surface.margins(at):
        height = jnp.where(margin <= _AT_END, larger(height, root(arm.dot(arm))), height)
        ended = ended | (margin <= _AT_END)
    return height, foot.normal, ended


def _foot(surface: AbstractSurface, point: Vec3) -> tuple[Scalars, Gauss3]:
    """The place of a surface nearest to a point in its frame, and the Gauss frame there."""
    start = tuple(jnp.asarray(x, jnp.result_type(point.x)) for x in surface.start(point))
    at = footed(surface, start, point, _FOOT)
    return at, surface.frame(at)


def _downward(
    poses: tuple[Pose3, Pose3], walked: AbstractSurface, at: Scalars, other: AbstractSurface, most: Scalar
) -> Scalars:
    """A place on a surface after one Newton step down its distance from another one."""
    frame = walked.frame(at)
    _, foot = _foot(other, poses[1].local(poses[0].place(frame.point)))
    n, out = poses[1].turn(foot.normal), poses[0].turn(frame.normal)
    slope = n - out * n.dot(out)
    # H^-1 = (tr H - H) / det H in the tangent plane, H = L_A + L_B; a flat pair stays where it is.
    bend = frame.shape.turned(poses[0]) + foot.shape.turned(poses[1])
    plane = Sym3(1.0, 0.0, 0.0, 1.0, 0.0, 1.0) - square(out)
    size, trace = bend.minors(), bend.trace()
    firm = (size > 1e-9 * trace * trace) & (trace > 0)
    inverse = (plane * trace - bend) * jnp.where(firm, 1.0 / jnp.where(firm, size, 1.0), 0.0)
    step = -inverse.apply(slope)
    length = root(step.dot(step))
    step = step * jnp.where(length > most, most / jnp.where(length > 0, length, 1.0), 1.0)
    return walked.within(walked.settled(summed(at, walked.rate(at, poses[0].back(step)))))
