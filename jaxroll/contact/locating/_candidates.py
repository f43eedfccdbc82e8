r"""Sampled signed distance between two contours, and where along one of them it is smallest.

Points of one contour, given in the frame of the other one, are compared with samples of the latter
(`nearest_dense`, `nearest_blocked`). From the nearest sample the foot of the perpendicular follows to second
order (`toward`, `feet`). With the arm to the point, $u$ along the tangent and $w$ along the outward normal,
and the curvature $\kappa$, foot and signed distance are

$$ s + \frac{u}{1 + \kappa w}, \qquad w + \frac{\kappa u^2}{2 (1 + \kappa w)}. $$

`minima` then estimates where this distance is least along the first contour. `_location` refines these
estimates; `_clearance` and `_links` need only the feet; `_location3` and `_samples3` take `lowest`.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..._linalg import Pose2, Vec2
from ..._types import Scalar
from ...geometry import AbstractContour, Frenet2

# Samples that are compared in one pass of the loop, with the best distance and its index kept in registers.
_BLOCK = 16
# Most samples on a contour or surface: the work, and in space the memory, grows with their square.
MOST_SAMPLES = 2**14


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Feet:
    """Where given points are nearest to a contour.

    Attributes:
        s: Arclength of the nearest point of the contour [m].
        distance: Signed distance [m], negative inside.
        slope: Gradient of the distance with respect to the given point: a unit
            vector, to first order.
        ended: Whether the nearest point is an end of an open contour.
    """

    s: Array
    distance: Array
    slope: Vec2
    ended: Bool[Array, "..."]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Minima:
    """Estimated local minima of the distance along a contour, lowest first; shape (candidates,) each.

    Attributes:
        s: Arclength on the contour that is walked, and on the other [m].
        reach: How far the minimum may lie from `s`, on both [m].
        bound: Estimated lower bound of the distance there [m]. Where there are fewer minima than entries, the
            first sample fills the rest: its bound is infinite unless it is a minimum itself, which is then
            repeated.
    """

    s: tuple[Array, Array]
    reach: tuple[Array, Array]
    bound: Array


def spread(contour: AbstractContour, count: int) -> Float[Array, " samples"]:
    """Arclengths from end to end of a contour with ends, or once round a closed one."""
    ends = contour.domain()
    if ends is None:
        raise ValueError(
            f"argument events may hold 'penetration' only if every contour has ends or is closed, "
            f"but {type(contour).__name__} is endless"
        )
    return ends[0] + (ends[1] - ends[0]) * jnp.linspace(0.0, 1.0, count)


def into(pose: Pose2, point: Vec2) -> Vec2:
    """A point of the world in the frame of a body, which has this pose."""
    return pose.back(point - pose.origin)


def nearest_dense(samples: Vec2, points: Vec2) -> Array:
    """Index of the sample nearest to each point, by one reduction: the fewest XLA operations."""
    away = (points.x[:, None] - samples.x[None, :]) ** 2
    return jnp.argmin(away + (points.y[:, None] - samples.y[None, :]) ** 2, axis=1)


def nearest_blocked(samples: Vec2, points: Vec2) -> Array:
    """Index of the sample nearest to each point, by a loop over the samples.

    XLA compiles `argmin` to scalar code on a CPU; this loop compares one sample with all points at once, in
    vector code.
    """
    count = samples.x.shape[0]

    def compare(block: Array, best: tuple[Array, Array]) -> tuple[Array, Array]:
        least, index = best
        for step in range(_BLOCK):
            # The last block may reach past the last sample, which is then compared again.
            j = jnp.minimum(block * _BLOCK + step, count - 1)
            x = jax.lax.dynamic_index_in_dim(samples.x, j, keepdims=False)
            y = jax.lax.dynamic_index_in_dim(samples.y, j, keepdims=False)
            away = (points.x - x) ** 2 + (points.y - y) ** 2
            # The index is carried as a floating-point number of the same width as `away`, which is exact up
            # to `MOST_SAMPLES`.
            index = jnp.where(away < least, j.astype(away.dtype), index)
            least = jnp.minimum(away, least)
        return least, index

    start = (jnp.full_like(points.x, jnp.inf), jnp.zeros_like(points.x))
    return jax.lax.fori_loop(0, -(-count // _BLOCK), compare, start)[1].astype(int)


def feet(face: AbstractContour, s: Float[Array, " samples"], points: Vec2, near: Array) -> Feet:
    """Signed distance of points from a contour: two Newton steps along it, from the nearest sample.

    Args:
        face: The contour.
        s: Its samples, from `spread`.
        points: In its body's frame.
        near: Index of the nearest sample of each point.
    """
    near = s[near]
    first = toward(face, (s[0], s[-1]), (near, face.frame(near)), points)
    return toward(face, (s[0], s[-1]), (first.s, face.frame(first.s)), points)


def toward(
    face: AbstractContour, ends: tuple[Scalar, Scalar], at: tuple[Array, Frenet2], points: Vec2
) -> Feet:
    """One Newton step along a contour to the feet of points, with the distance to second order.

    Args:
        face: The contour.
        ends: Its first and last arclength [m]. A foot past the end of an open contour is put onto that end.
        at: Arclengths [m] close to the feet, and the frames there.
        points: In the contour's frame.
    """
    s, frame = at
    arm = points - frame.point
    along, out = arm.dot(frame.tangent), arm.cross(frame.tangent)
    # 1 + kappa out is zero at the centre of curvature, where no foot is nearest: it is kept away from zero.
    bend = jnp.maximum(1.0 + frame.curvature * out, 0.5)
    out = out + 0.5 * frame.curvature * along * (along / bend)
    foot, normal = s + along / bend, frame.tangent.right()
    # The gradient of the distance is the normal at the foot: that at s, turned by curvature times
    # arclength.
    slope = normal + frame.tangent * (frame.curvature * (foot - s))
    if face.closed:
        return Feet(foot, out, slope, jnp.zeros(foot.shape, bool))
    held = jnp.clip(foot, *ends)
    # From an end the distance is the plain one, never negative, and its gradient points along the arm.
    ended, size = held != foot, jnp.hypot(arm.x, arm.y)
    away = jnp.where(size > 0.0, size, 1.0)
    slope = Vec2(jnp.where(ended, arm.x / away, slope.x), jnp.where(ended, arm.y / away, slope.y))
    return Feet(held, jnp.where(ended, size, out), slope, ended)


def minima(s: Array, found: Feet, rate: Array, *, turn: Scalar, closed: bool, count: int) -> Minima:
    """Local minima of the distance along a sampled contour, at most `count`.

    One in every cell at whose ends the distance falls inwards, one at every sample that is lowest
    among its neighbours without such a cell, and one at every end towards which the distance falls.

    Args:
        s: The samples, from `spread`.
        found: Their feet on the other contour.
        rate: Derivative of the distance along the contour, at the samples.
        turn: Length of the other contour if it is closed, else infinite.
        closed: Whether the contour that is walked is closed.
        count: How many to keep, lowest first.
    """
    value, step = found.distance, s[1] - s[0]
    low, high = rate[:-1], rate[1:]
    dips = (low < 0.0) & (high >= 0.0)
    drop = jnp.where(dips, high - low, 1.0)
    # Height at which the tangents at both ends of a cell meet. A convex function lies above it in between.
    bound = (value[:-1] * high - value[1:] * low + low * high * step) / drop
    # How far the foot moves over a cell, the shorter way round a closed contour.
    hop = found.s[1:] - found.s[:-1]
    hop = hop - jnp.where(jnp.isfinite(turn), turn * jnp.round(hop / turn), 0.0)
    # The rate taken as linear over the cell is zero at this share of it.
    part = jnp.where(dips, -low / drop, 0.0)
    # Cells and samples share one array: a cell is entered at its first sample. That is free, as no sample at
    # the end of such a cell counts as a minimum of its own (`_lone`).
    pad = jnp.zeros(1, value.dtype)
    part, hop, bound = (jnp.concatenate([x, pad]) for x in (part, hop, bound))
    lone, dips = _lone(value, rate, dips, closed), jnp.concatenate([dips, jnp.zeros(1, bool)])
    bound = jnp.where(dips, bound, jnp.where(lone, value, jnp.inf))
    order = lowest(bound, count)
    foot = found.s + part * hop
    wide = jnp.where(dips, jnp.abs(hop), 0.0) + step
    return Minima(((s + part * step)[order], foot[order]), (jnp.full(count, step), wide[order]), bound[order])


def _lone(value: Array, rate: Array, dips: Array, closed: bool) -> Array:
    """Samples that are minima by themselves: not above their neighbours, not at the end of a dipping cell.

    On an open contour also its ends, where the distance falls towards them. `dips` tells in which cells the
    distance falls inwards from both ends.
    """
    false, inf = jnp.zeros(1, bool), jnp.full(1, jnp.inf, value.dtype)
    if closed:  # the last sample is the first again
        before, after = jnp.roll(value[:-1], 1), jnp.roll(value[:-1], -1)
        lowest = (value[:-1] <= before) & (value[:-1] <= after) & ~dips & ~jnp.roll(dips, 1)
        return jnp.concatenate([lowest, false])
    before, after = jnp.concatenate([inf, value[:-1]]), jnp.concatenate([value[1:], inf])
    explained = jnp.concatenate([dips, false]) | jnp.concatenate([false, dips])
    lowest = (value <= before) & (value <= after) & ~explained
    last = jnp.arange(value.shape[0]) == value.shape[0] - 1
    first = jnp.arange(value.shape[0]) == 0
    return lowest | (first & (rate > 0.0)) | (last & (rate < 0.0))


def lowest(score: Array, count: int) -> Array:
    """Indices of the lowest entries, in order; where there are too few, entries repeat."""
    number = jnp.arange(score.shape[0])

    # A loop over the entries: side by side, XLA would fuse the computation of the scores into every `argmin`.
    def take(left: Array, _: None) -> tuple[Array, Array]:
        i = jnp.argmin(left)
        return jnp.where(number == i, jnp.inf, left), i

    return jax.lax.scan(take, score, None, length=count)[1]
