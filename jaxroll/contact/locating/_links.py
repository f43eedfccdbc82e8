r"""How far the links of fingers stay clear of an object and of each other.

Links are straight, from joint to joint and to the tip frame. Their distance from an object is that of points
along them, between which the lowest place is looked for; of two links it is in closed form.
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._linalg import largest, Pose2, Pose3, smaller, Vec2, Vec3
from ..._types import Scalar
from ..._xla import counted
from ...geometry import AbstractContour, AbstractSurface
from ._candidates import feet, into, nearest_dense, spread
from ._clearance import height3

# Points along each link, both ends included.
_ALONG = 17
# Steps of the Illinois method beside the lowest of them.
_TRIES = 10


def links_clearance(
    body: Pose2, chains: Sequence[Sequence[Vec2]], faces: Sequence[AbstractContour], *, samples: int
) -> list[Scalar]:
    """Least signed distance [m] of each chain's links from an object in the plane.

    As for `clearance`, several faces must bound a convex body.

    Args:
        body: World pose of the object.
        chains: Joints of each finger and its tip frame's origin, in the world.
        faces: The object's contours, with ends or closed.
        samples: Points on each contour.
    """

    def heights(points: Any, faces: Any) -> tuple[Array, Any]:
        found = []
        for face in faces:
            s = spread(face, samples)
            foot = feet(face, s, points, nearest_dense(face.frame(s).point, points))
            found.append((foot.distance, foot.slope, foot.ended))
        return _from_body(found)

    own = [[into(body, point) for point in chain] for chain in chains]
    return _lowest(own, Vec2, heights, faces)


def links_clearance3(
    body: Pose3, chains: Sequence[Sequence[Vec3]], faces: Sequence[AbstractSurface]
) -> list[Scalar]:
    """The same in space; the object's surfaces need no bounds."""

    def heights(points: Any, faces: Any) -> tuple[Array, Any]:
        return jax.vmap(lambda point: _from_body([height3(point, face) for face in faces]))(points)

    return _lowest([[body.local(point) for point in chain] for chain in chains], Vec3, heights, faces)


def _from_body(found: Sequence[tuple[Array, Any, Array]]) -> tuple[Array, Any]:
    """Signed distance of points from a convex body, and its gradient, from those of its faces.

    It is the largest height of a point above the faces that it lies over, if that is positive. Otherwise a
    point past the ends of other faces is as far from the body as from the nearest of these ends, and any
    other point is inside.

    Args:
        found: Of every face the distance, its gradient, and whether the foot is at an end.
    """
    (first, slope, ended), *rest = found
    height, nearest = jnp.where(ended, -jnp.inf, first), jnp.where(ended, first, jnp.inf)
    along = slope
    for other, way, ended in rest:
        higher, nearer = ~ended & (other > height), ended & (other < nearest)
        height, nearest = jnp.where(higher, other, height), jnp.where(nearer, other, nearest)
        pick = lambda now, new, old: jax.tree.map(lambda a, b: jnp.where(now, a, b), new, old)  # noqa: E731
        slope, along = pick(higher, way, slope), pick(nearer, way, along)
    past = (height <= 0) & (nearest < jnp.inf)
    return jnp.where(past, nearest, height), jax.tree.map(lambda a, b: jnp.where(past, a, b), along, slope)


def _lowest(
    chains: Sequence[Sequence[Any]], kind: Any, heights: Callable, faces: Sequence[Any]
) -> list[Scalar]:
    """The least height of each chain of links.

    The slope of the height along a link is zero between the lowest of the link's points and the one beside
    it. That place is found by the Illinois method: beside an end of a face the slope bends, and plain secants
    would hardly move.

    Args:
        chains: Points in the object's frame.
        kind: Of the points.
        heights: From points and faces to heights and their gradients.
        faces: Of the object.
    """
    ends = [(a, b) for chain in chains for a, b in itertools.pairwise(chain)]
    axes = range(len(jax.tree.leaves(ends[0][0])))
    starts, stops = (jnp.stack([jnp.stack(list(end[side])) for end in ends]) for side in (0, 1))
    share = jnp.linspace(0.0, 1.0, _ALONG)

    def at(places: Array, held: Any) -> tuple[Array, Array]:
        """Heights at places from 0 to 1 of every link, shape (m, n), and their slopes by the place."""
        starts, ways, faces = held
        points = starts[:, None] + places[..., None] * ways[:, None]
        found, slope = heights(kind(*(points[..., k].ravel() for k in axes)), faces)
        across = jnp.stack(list(slope), axis=-1).reshape(points.shape)
        return found.reshape(places.shape), jnp.sum(across * ways[:, None], axis=-1)

    held = (starts, stops - starts, list(faces))
    sampled, slopes = at(jnp.broadcast_to(share, (len(ends), _ALONG)), held)
    i = jnp.argmin(sampled, axis=1)
    of = lambda values, k: jnp.take_along_axis(values, k[:, None], axis=1)[:, 0]  # noqa: E731
    # The slope changes its sign between the lowest point and the one beside it that lies downhill.
    down = of(slopes, i) < 0
    low = jnp.where(down, i, jnp.maximum(i - 1, 0))
    high = jnp.where(down, jnp.minimum(i + 1, _ALONG - 1), i)

    def turn(_: Any, carry: Any, held: Any) -> Any:
        low, fall, high, rise, side = carry
        place = _crossing(low, fall, high, rise)
        here = at(place[:, None], held)[1][:, 0]
        up = here > 0
        fall, rise = jnp.where(side > 0, 0.5 * fall, fall), jnp.where(side < 0, 0.5 * rise, rise)
        before = jnp.where(up, low, place), jnp.where(up, fall, here)
        after = jnp.where(up, place, high), jnp.where(up, here, rise)
        return *before, *after, jnp.where(up, 1.0, -1.0)

    start = share[low], of(slopes, low), share[high], of(slopes, high), jnp.zeros_like(share[low])
    place = _crossing(*counted(_TRIES, turn, start, held)[:4])
    # At the lowest place the height does not change with the place, to first order.
    found, _ = at(jax.lax.stop_gradient(place)[:, None], held)
    each = smaller(found[:, 0], of(sampled, i))
    counts = np.cumsum([0, *(len(chain) - 1 for chain in chains)])
    return [-largest(-each[a:b]) for a, b in itertools.pairwise(counts)]


def _crossing(low: Array, fall: Array, high: Array, rise: Array) -> Array:
    """Where the line through a slope that falls at one place and one that rises at another is zero."""
    return low + (high - low) * jnp.clip(_over(-fall, rise - fall), 0.0, 1.0)


def _over(above: Array, below: Array) -> Array:
    """A quotient; 0 where the divisor is zero."""
    return jnp.where(below != 0, above / jnp.where(below != 0, below, 1.0), 0.0)


def chains_apart(first: Sequence[Any], second: Sequence[Any]) -> Scalar:
    """Least distance [m] of the links of two chains."""
    pairs = [
        links_apart((a, b), (c, d))
        for a, b in zip(first[:-1], first[1:], strict=True)
        for c, d in zip(second[:-1], second[1:], strict=True)
    ]
    return functools.reduce(smaller, pairs)


def links_apart(first: tuple[Any, Any], second: tuple[Any, Any]) -> Scalar:
    r"""Distance of two straight links [m], each given by its ends.

    With $d_1$, $d_2$ the links and $r$ from the second's start to the first's, the places are
    $s = (b f - c e)/(a e - b^2)$ and $t = (b s + f)/e$, where $a = d_1^2$, $b = d_1 \cdot d_2$,
    $c = d_1 \cdot r$, $e = d_2^2$ and $f = d_2 \cdot r$; each is kept between 0 and 1, and s then the best
    for t.
    """
    one, two, apart = first[1] - first[0], second[1] - second[0], first[0] - second[0]
    a, b, e = one.dot(one), one.dot(two), two.dot(two)
    c, f = one.dot(apart), two.dot(apart)
    s = _between(b * f - c * e, a * e - b * b)
    t = _between(b * s + f, e)
    s = _between(b * t - c, a)
    left = apart + one * s - two * t
    square = left.dot(left)
    # Not by `square > 0`, with which NaN would become zero.
    return jnp.where(square == 0, 0.0, jnp.sqrt(jnp.where(square == 0, 1.0, square)))


def _between(above: Scalar, below: Scalar) -> Scalar:
    """A quotient kept between 0 and 1; 0 where the divisor is not positive."""
    return jnp.where(below > 0, jnp.clip(above / jnp.where(below > 0, below, 1.0), 0.0, 1.0), 0.0)
