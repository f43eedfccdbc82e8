"""Contours of random outlines, and their location, compiled: what `tests.oracles.outlines` judges."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr
from jaxroll._linalg._plane import sincos, Vec2
from jaxroll.geometry import AbstractContour, Frenet2
from jaxroll.geometry.contours._arclength import ArclengthTable, invert, tabulate
from tests.oracles.outlines import random_outlines


def _radius(shape, u):
    """Radius of a polar curve and its first two derivatives in the angle."""
    size, cosines, sines = shape
    sin, cos = sincos(u)
    c, s = cos, sin
    r, d, dd = 1.0 + 0.0 * u, 0.0 * u, 0.0 * u
    for k in range(1, cosines.shape[0] + 1):
        a, b = cosines[k - 1], sines[k - 1]
        r, d, dd = r + a * c + b * s, d + k * (b * c - a * s), dd - k * k * (a * c + b * s)
        c, s = c * cos - s * sin, s * cos + c * sin
    return size * r, size * d, size * dd


def _speed(shape, u):
    r, d, _ = _radius(shape, u)
    return jnp.sqrt(r * r + d * d)


class Polar(AbstractContour):
    """r(u) = size (1 + sum_k a_k cos(k u) + b_k sin(k u)): smooth, with reentrant parts where r falls."""

    size: jnp.ndarray
    cosines: jnp.ndarray
    sines: jnp.ndarray
    cells: int = eqx.field(static=True)
    table: ArclengthTable | None

    def __init__(self, size, cosines, sines, *, cells=256):
        self.size = jnp.asarray(size, float)
        self.cosines, self.sines = jnp.asarray(cosines, float), jnp.asarray(sines, float)
        self.cells, self.table = cells, None

    @property
    def shape(self):
        return self.size, self.cosines, self.sines

    @property
    def closed(self):
        return True

    @property
    def smoothness(self):
        return float("inf")

    def arclengths(self):
        if self.table is not None:
            return self.table
        return tabulate(_speed, self.shape, period=2.0 * np.pi, cells=self.cells)

    def curve(self, s):
        u = invert(_speed, self.shape, self.arclengths(), s)
        sin, cos = sincos(u)
        r = _radius(self.shape, u)[0]
        return Vec2(r * cos, r * sin)

    def frame(self, s):
        u = invert(_speed, self.shape, self.arclengths(), s)
        sin, cos = sincos(u)
        r, d, dd = _radius(self.shape, u)
        rate = 1.0 / jnp.sqrt(r * r + d * d)
        tangent = Vec2((d * cos - r * sin) * rate, (d * sin + r * cos) * rate)
        return Frenet2(Vec2(r * cos, r * sin), tangent, (r * r + 2.0 * d * d - r * dd) * rate**3)

    def prepared(self):
        return eqx.tree_at(lambda c: c.table, self, self.arclengths(), is_leaf=lambda x: x is None)

    def domain(self):
        return 0.0, self.arclengths().length


def contour_of(kind, numbers):
    """The contour of one row of `random_outlines`; "spline": a polar one by 96 of its points."""
    if kind == "spline":
        u = jnp.arange(96) * (2.0 * np.pi / 96)
        r = _radius(numbers, u)[0]
        return jxr.Spline(jnp.stack([r * jnp.cos(u), r * jnp.sin(u)], axis=-1), cells=256)
    return jxr.Ellipse(*numbers, cells=256) if kind == "ellipse" else Polar(*numbers)


def random_pairs(rng, kinds, count, place):
    """Shapes and poses: a third apart, a third touching, a third overlapping moderately.

    `place` is that of `compiled_placement`, or the first of what `compiled_search` gives.
    """
    shapes = tuple(random_outlines(rng, kind, count) for kind in kinds)
    turn = rng.uniform(-np.pi, np.pi, (3, count))
    away = rng.uniform(0.12, 0.16, count)
    pose_a = np.stack([away * np.cos(turn[0]), away * np.sin(turn[0]), turn[1]], -1)
    pose_b = np.stack([*(0.05 * rng.standard_normal((2, count))), turn[2]], -1)
    pose_a[:, :2] += pose_b[:, :2]
    third = np.arange(count) % 3
    apart = rng.uniform(0.0, 0.05, count) * (third == 0)
    depth = rng.uniform(0.0, 0.5, count) * (third == 2)
    return shapes, np.asarray(place(shapes, pose_a, pose_b, (apart, depth))), pose_b


def _searched(kinds):
    """Where a pair of shapes is to be placed, and how it is located before.

    Shapes that start apart are moved along the normal at their closest points, so that no point is
    deeper than asked for; depth counts in the smallest radius of curvature.
    """

    def search(shapes, pose_a, pose_b, gap):
        a, b = (contour_of(kind, numbers).prepared() for kind, numbers in zip(kinds, shapes, strict=True))
        found = jxr.contact.locate(a, b, pose_a=pose_a, pose_b=pose_b)
        bends = [c.frame(jnp.linspace(0.0, 1.0, 400) * c.domain()[1]).curvature for c in (a, b)]
        sharpest = jnp.max(jnp.stack(bends))
        return pose_a.at[:2].add((gap[0] - gap[1] / sharpest - found.gap) * found.normal), found

    return search


def compiled_placement(kinds):
    """Compiled `place` of `random_pairs`."""
    return jax.jit(jax.vmap(lambda *given: _searched(kinds)(*given)[0]))


@functools.cache
def compiled_search(kinds, lanes=250):
    """Compiled `place` of `random_pairs`, and location: one program for any number of pairs, in parts."""
    search = jax.jit(jax.vmap(_searched(kinds)))

    def searched(*given):
        count = len(given[1])
        # The last pair once more where there are no others.
        rows = np.minimum(np.arange(-(-count // lanes) * lanes), count - 1).reshape(-1, lanes)
        given = given[:3] + (tuple(given[3]),)
        parts = [search(*jax.tree.map(lambda x: x[some], given)) for some in rows]  # noqa: B023
        return jax.tree.map(lambda *x: jnp.concatenate(x)[:count], *parts)

    return searched


def compiled_location(kinds, **options):
    """Compiled location of a batch of random pairs."""

    def find(shapes, pose_a, pose_b):
        a, b = (contour_of(kind, numbers).prepared() for kind, numbers in zip(kinds, shapes, strict=True))
        return jxr.contact.locate(a, b, pose_a=pose_a, pose_b=pose_b, **options)

    return jax.jit(jax.vmap(find))
