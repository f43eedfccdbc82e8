r"""How far the links of fingers stay clear of an object and of each other.

Links are straight, from joint to joint and to the tip frame. Their distance from an object is that of points
along them, from the lowest of which a secant goes on; of two links it is in closed form.
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
# Steps of the secant from the lowest of them.
_SECANTS = 5


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
            found.append((foot.distance, foot.slope))
        return _farthest(found)

    own = [[into(body, point) for point in chain] for chain in chains]
    return _lowest(own, Vec2, heights, faces)


def links_clearance3(
    body: Pose3, chains: Sequence[Sequence[Vec3]], faces: Sequence[AbstractSurface]
) -> list[Scalar]:
    """The same in space; the object's surfaces need no bounds."""

    def heights(points: Any, faces: Any) -> tuple[Array, Any]:
        return jax.vmap(lambda point: _farthest([height3(point, face) for face in faces]))(points)

    return _lowest([[body.local(point) for point in chain] for chain in chains], Vec3, heights, faces)


def _farthest(found: Sequence[tuple[Array, Any]]) -> tuple[Array, Any]:
    """The largest of several heights, and its gradient."""
    height, slope = found[0]
    for other, way in found[1:]:
        higher = other > height
        height = jnp.where(higher, other, height)
        slope = jax.tree.map(lambda a, b, higher=higher: jnp.where(higher, a, b), way, slope)
    return height, slope


def _lowest(
    chains: Sequence[Sequence[Any]], kind: Any, heights: Callable, faces: Sequence[Any]
) -> list[Scalar]:
    """The least height of each chain of links.

    From the lowest of a link's points a secant goes on, between the points beside it, to where the height's
    slope along the link is zero.

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
    low, high = jnp.maximum(i - 1, 0), jnp.minimum(i + 1, _ALONG - 1)
    of = lambda values, k: jnp.take_along_axis(values, k[:, None], axis=1)[:, 0]  # noqa: E731
    bend = (of(slopes, high) - of(slopes, low)) / (share[high] - share[low])
    first, slope = share[i], of(slopes, i)
    second = jnp.clip(first - _over(slope, bend), share[low], share[high])

    def turn(_: Any, carry: Any, held: Any) -> Any:
        before, slope, place = carry
        bounds, rest = held
        _, here = at(place[:, None], rest)
        bend = _over(here[:, 0] - slope, place - before)
        return place, here[:, 0], jnp.clip(place - _over(here[:, 0], bend), *bounds)

    bounds = (share[low], share[high])
    _, _, place = counted(_SECANTS, turn, (first, slope, second), (bounds, held))
    # At the lowest place the height does not depend on it, to first order.
    found, _ = at(jax.lax.stop_gradient(place)[:, None], held)
    each = smaller(found[:, 0], of(sampled, i))
    counts = np.cumsum([0, *(len(chain) - 1 for chain in chains)])
    return [-largest(-each[a:b]) for a, b in itertools.pairwise(counts)]


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
    # Not by `square > 0`: what is not a number stays so.
    return jnp.where(square == 0, 0.0, jnp.sqrt(jnp.where(square == 0, 1.0, square)))


def _between(above: Scalar, below: Scalar) -> Scalar:
    """A quotient kept between 0 and 1; 0 where the divisor is not positive."""
    return jnp.where(below > 0, jnp.clip(above / jnp.where(below > 0, below, 1.0), 0.0, 1.0), 0.0)
