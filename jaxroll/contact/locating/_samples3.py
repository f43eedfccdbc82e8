"""Sampled signed distance between two surfaces, and where on one of them it is smallest.

`cover` samples a surface; every sample is brought to its foot on the other surface by Newton's method
(`feet3`), and the samples that are lowest among their neighbours become the pairs from which `_location3`
goes down (`starts`). Samples are compared all with all: their neighbours are found without a mesh, so that
any surface that can `spread` places over itself will do.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._linalg import root, Vec3
from ..._types import ByPrecision, Scalar, Scalars
from ...geometry import AbstractSurface, approach, Gauss3
from ._candidates import lowest
from ._pair3 import Pair3, Places, summed

# Newton steps from a near sample to the foot of a point.
_FOOT = 6
# Samples are neighbours if they are not farther apart than this many times the widest distance from a sample
# to the one nearest to it.
_NEIGHBOURS = 1.3
# A place not farther than this from an end of its surface is at the end, relative to the pair's scale.
END = ByPrecision(1e-9, 1e-6)
# Samples nearer to each other than this are the same place, relative to the largest distance of any two.
_REPEATED = ByPrecision(1e-6, 1e-4)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Cover:
    """Samples all over a surface.

    Attributes:
        at: Their coordinates, shape (samples,) each.
        points: Their points in the frame of the surface's body [m].
        width: The widest distance from a sample to the one nearest to it [m].
    """

    at: Scalars
    points: Vec3
    width: Scalar

    def size(self) -> Scalar:
        """Root mean square distance of the samples from their mean [m]."""
        return jnp.sqrt(sum(jnp.var(x) for x in self.points))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Starts:
    """Pairs from which the refinement starts, those of one surface's samples lowest first.

    Attributes:
        at: Coordinates on both surfaces, shape (candidates,) each.
        there: Which entries hold a pair.
        reach: Longest step from a pair [m].
        sample: The pair with the lowest signed distance of all samples.
        of_b: Whether that sample is one of `b`, and its foot on `a`.
        distance: That signed distance [m].
        bound: The lowest signed distance of a sample of `a` [m]: the gap cannot be above it.
    """

    at: Places
    there: Array
    reach: Array
    sample: Places
    of_b: Array
    distance: Scalar
    bound: Scalar


def cover(surface: AbstractSurface, count: int) -> Cover | None:
    """Samples of a prepared surface; None where it has no bounds."""
    at = surface.spread(count)
    if at is None:
        return None
    points = jax.vmap(lambda at: surface.frame(at).point)(at)
    apart = _apart(points, points)
    # Neither a sample itself nor one that repeats it, but for rounding, is the one nearest to it.
    other = apart > _REPEATED.of(points) ** 2 * jnp.max(apart)
    nearest = jnp.min(jnp.where(other, apart, jnp.inf), axis=1)
    return Cover(at, points, jnp.sqrt(jnp.max(jnp.where(jnp.isfinite(nearest), nearest, 0.0))))


def ended(surface: AbstractSurface, at: Scalars, room: Scalar) -> Array:
    """Whether a place is within `room` [m] of an end of its surface, or past it."""
    at_end = jnp.zeros((), bool)
    for margin in surface.margins(at):
        at_end = at_end | (margin <= room)
    return at_end


def distance(pair: Pair3, a: Vec3, b: Gauss3, at_b: Scalars) -> Scalar:
    """Signed distance [m] of a point `a` from its foot on `b`; at an end of `b` the distance without a sign.

    Args:
        pair: Both surfaces.
        a: The point, in the frame of `b`.
        b: Gauss frame of `b` at the foot.
        at_b: Coordinates of the foot.
    """
    arm = a - b.point
    square, past = arm.dot(arm), ended(pair.b, at_b, END.of(at_b, pair.pose) * pair.scale)
    return jnp.where(past & (square > 0.0), root(square), arm.dot(b.normal))


def footed(surface: AbstractSurface, at: Scalars, point: Vec3, steps: int) -> Scalars:
    """Coordinates of the foot of a point in the surface's frame: Newton steps from a place near it.

    The foot stays within the ends of the surface.
    """

    def step(at: Scalars, _: None) -> tuple[Scalars, None]:
        ahead = surface.rate(at, approach(surface.frame(at), point))
        return surface.within(surface.settled(summed(at, ahead))), None

    return jax.lax.scan(step, at, None, length=steps)[0]


def feet3(pair: Pair3, samples: Cover | None, points: Vec3) -> Scalars:
    """Coordinates of the feet on `b` of points in its frame.

    The search starts at the nearest of its samples. An unbounded surface has none, and says itself where to
    start.
    """
    if samples is None:
        start = jax.vmap(pair.b.start)(points)
    else:
        near = jnp.argmin(_apart(points, samples.points), axis=1)
        start = tuple(x[near] for x in samples.at)
    return jax.vmap(lambda at, point: footed(pair.b, at, point, _FOOT))(start, points)


def starts(pair: Pair3, walked: Cover, other: Cover | None, count: int) -> Starts:
    """The samples of `a` that are lowest among their neighbours, `count` at most, with their feet on `b`.

    Args:
        pair: Both surfaces.
        walked: Samples of `a`.
        other: Samples of `b`, if it is bounded.
        count: How many to keep, lowest first.
    """
    points = jax.vmap(pair.pose.place)(walked.points)
    at_b = feet3(pair, other, points)
    value = jax.vmap(lambda p, at: distance(pair, p, pair.b.frame(at), at))(points, at_b)
    value = jnp.where(jnp.isfinite(value), value, jnp.inf)
    number = jnp.arange(value.shape[0])
    close = _apart(walked.points, walked.points) <= (_NEIGHBOURS * walked.width) ** 2
    # Of equal neighbours the first counts as lower: otherwise a level row of samples would have no lowest
    # sample, or as many as it is long.
    before = number[None, :] < number[:, None]
    beaten = (value[None, :] < value[:, None]) | ((value[None, :] == value[:, None]) & before)
    score = jnp.where(jnp.any(close & beaten, axis=1), jnp.inf, value)
    order, best = lowest(score, count), jnp.argmin(value)
    there = (jnp.arange(count) < jnp.sum(jnp.isfinite(score))) & jnp.isfinite(score[order])
    pairs = (walked.at, at_b)
    at = jax.tree.map(lambda x: x[order], pairs)
    reach = jnp.full(count, walked.width)
    sample = jax.tree.map(lambda x: x[best], pairs)
    return Starts(at, there, reach, sample, jnp.array(False), value[best], value[best])


def _apart(left: Vec3, right: Vec3) -> Array:
    """Squared distances [m^2] between the points of two clouds; a row for each point of the first one."""
    parts = [(x[:, None] - y[None, :]) ** 2 for x, y in zip(left, right, strict=True)]
    return parts[0] + parts[1] + parts[2]
