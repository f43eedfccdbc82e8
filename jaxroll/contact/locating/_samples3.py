"""Sampled signed distance between two surfaces, and where on one of them it is smallest."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._linalg import root, Vec3
from ..._types import Scalar, Scalars
from ...geometry import AbstractSurface, approach, Gauss3
from ._candidates import lowest
from ._pair3 import Pair3, Places, summed

_FOOT = 6
# Neighbours of a sample lie within this many times the widest distance between samples that are nearest.
_NEIGHBOURS = 1.3
_END = 1e-9  # of the scale
_REPEATED = 1e-6  # of the surface's width


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Cover:
    """Samples all over a surface, in its body's frame, and the widest distance of two nearest ones [m]."""

    at: Scalars
    points: Vec3
    width: Scalar

    def size(self) -> Scalar:
        """Root mean square distance from the middle [m]."""
        return jnp.sqrt(sum(jnp.var(x) for x in self.points))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Starts:
    """Pairs to begin with, lowest first, shape (candidates,): which of them are there, and how far to step.

    `sample` is the lowest pair of samples, `distance` its signed distance [m]; `bound` is the least one of a
    sample of `a`.
    """

    at: Places
    there: Array
    reach: Array
    sample: Places
    distance: Scalar
    bound: Scalar


def cover(surface: AbstractSurface, count: int) -> Cover | None:
    """Samples of a prepared surface; None where it has no bounds."""
    at = surface.spread(count)
    if at is None:
        return None
    points = jax.vmap(lambda at: surface.frame(at).point)(at)
    apart = _apart(points, points)
    # A sample, and one that repeats it, is not its own neighbour; rounding may set them apart.
    other = apart > _REPEATED**2 * jnp.max(apart)
    nearest = jnp.min(jnp.where(other, apart, jnp.inf), axis=1)
    return Cover(at, points, jnp.sqrt(jnp.max(jnp.where(jnp.isfinite(nearest), nearest, 0.0))))


def ended(surface: AbstractSurface, at: Scalars, room: Scalar) -> Array:
    """Whether a place is within `room` [m] of an end of its surface, or past it."""
    at_end = jnp.zeros((), bool)
    for margin in surface.margins(at):
        at_end = at_end | (margin <= room)
    return at_end


def distance(pair: Pair3, a: Vec3, b: Gauss3, at_b: Scalars) -> Scalar:
    """Signed distance of a point from its foot on `b`; from an end, the plain one."""
    arm = a - b.point
    square, past = arm.dot(arm), ended(pair.b, at_b, _END * pair.scale)
    return jnp.where(past & (square > 0.0), root(square), arm.dot(b.normal))


def footed(surface: AbstractSurface, at: Scalars, point: Vec3, steps: int) -> Scalars:
    """Coordinates of the foot of a point, from a place near it, within the ends."""

    def step(at: Scalars, _: None) -> tuple[Scalars, None]:
        ahead = surface.rate(at, approach(surface.frame(at), point))
        return surface.within(surface.settled(summed(at, ahead))), None

    return jax.lax.scan(step, at, None, length=steps)[0]


def feet3(pair: Pair3, samples: Cover | None, points: Vec3) -> Scalars:
    """Coordinates of the feet on `b` of points in its frame: from the nearest samples, if there are any."""
    if samples is None:
        start = jax.vmap(pair.b.start)(points)
    else:
        near = jnp.argmin(_apart(points, samples.points), axis=1)
        start = tuple(x[near] for x in samples.at)
    return jax.vmap(lambda at, point: footed(pair.b, at, point, _FOOT))(start, points)


def starts(pair: Pair3, walked: Cover, other: Cover | None, count: int) -> Starts:
    """The lowest samples of `a` among their neighbours, and their feet on `b`."""
    points = jax.vmap(pair.pose.place)(walked.points)
    at_b = feet3(pair, other, points)
    value = jax.vmap(lambda p, at: distance(pair, p, pair.b.frame(at), at))(points, at_b)
    value = jnp.where(jnp.isfinite(value), value, jnp.inf)
    number = jnp.arange(value.shape[0])
    close = _apart(walked.points, walked.points) <= (_NEIGHBOURS * walked.width) ** 2
    before = number[None, :] < number[:, None]
    beaten = (value[None, :] < value[:, None]) | ((value[None, :] == value[:, None]) & before)
    score = jnp.where(jnp.any(close & beaten, axis=1), jnp.inf, value)
    order, best = lowest(score, count), jnp.argmin(value)
    there = (jnp.arange(count) < jnp.sum(jnp.isfinite(score))) & jnp.isfinite(score[order])
    pairs = (walked.at, at_b)
    at = jax.tree.map(lambda x: x[order], pairs)
    reach = jnp.full(count, walked.width)
    sample = jax.tree.map(lambda x: x[best], pairs)
    return Starts(at, there, reach, sample, value[best], value[best])


def _apart(left: Vec3, right: Vec3) -> Array:
    """Squares of the distances between two clouds, a row for each point of the first."""
    parts = [(x[:, None] - y[None, :]) ** 2 for x, y in zip(left, right, strict=True)]
    return parts[0] + parts[1] + parts[2]
