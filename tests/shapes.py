"""Shapes for tests of contact location, and a search by brute force that shares nothing with the package."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

import jaxroll as jxr
from jaxroll._linalg._plane import sincos, Vec2
from jaxroll.geometry import AbstractContour, Frenet2
from jaxroll.geometry.contours._arclength import ArclengthTable, invert, tabulate


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


def polar_points(size, cosines, sines, count):
    """Points of the same curve, at equal steps of the angle, in NumPy."""
    u = np.arange(count) * (2.0 * np.pi / count)
    k = np.arange(1, len(cosines) + 1)[:, None]
    r = size * (1.0 + np.asarray(cosines) @ np.cos(k * u) + np.asarray(sines) @ np.sin(k * u))
    return np.stack([r * np.cos(u), r * np.sin(u)], -1)


def ellipse_points(a, b, count):
    u = np.arange(count) * (2.0 * np.pi / count)
    return np.stack([a * np.cos(u), b * np.sin(u)], -1)


def placed(points, pose):
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[cos, sin], [-sin, cos]]) + np.asarray(pose[:2])


def signed(tree, polygon, points):
    """Signed distances of points from a counter-clockwise closed polygon of many vertices."""
    _, j = tree.query(points)
    before, at, after = (polygon[(j + k) % len(polygon)] for k in (-1, 0, 1))
    arm, chord = points - at, after - before
    side = np.sign(arm[:, 0] * chord[:, 1] - arm[:, 1] * chord[:, 0])
    gaps = []
    for other in (before, after):
        edge = other - at
        part = np.clip(np.sum(arm * edge, -1) / np.sum(edge * edge, -1), 0.0, 1.0)
        gaps.append(np.linalg.norm(arm - part[:, None] * edge, axis=-1))
    return np.where(side >= 0, 1.0, -1.0) * np.minimum(*gaps)


def brute_gap(a, b, *, block=50):
    """Least signed distance over the vertices of `a` from polygon `b`: all of them, by bounds.

    The signed distance changes at most as fast as the point moves, so a block of vertices whose middle
    is farther than the best by more than the block's reach holds no lower one. Returns the distance and
    the vertex.
    """
    tree, count = cKDTree(b, balanced_tree=False, compact_nodes=False), len(a)
    middles = np.arange(block // 2, count, block)
    blocks = a.reshape(-1, block, 2)
    reach = np.linalg.norm(blocks - a[middles][:, None], axis=-1).max(axis=1)
    coarse = signed(tree, b, a[middles])
    near = np.flatnonzero(coarse - reach <= coarse.min())
    near = near[np.argsort(coarse[near])]
    first = (near[:3, None] * block + np.arange(block)).ravel()
    values = signed(tree, b, a[first])
    rest = near[3:][coarse[near[3:]] - reach[near[3:]] <= values.min()]
    rest = (rest[:, None] * block + np.arange(block)).ravel()
    values = np.concatenate([values, signed(tree, b, a[rest])]) if rest.size else values
    i = int(np.argmin(values))
    return values[i], int(np.concatenate([first, rest])[i])


def random_outlines(rng, kind, count):
    """Random shapes of about 2 cm, as arrays with a leading axis of `count`: convex and reentrant."""
    size = rng.uniform(0.01, 0.03, count)
    if kind == "ellipse":
        return size, size * np.exp(rng.uniform(-np.log(4.0), np.log(4.0), count) * 0.5)
    lobes = rng.integers(2, 6, count)
    cosines = 0.03 * rng.standard_normal((count, 5)) / np.arange(1, 6)
    sines = 0.03 * rng.standard_normal((count, 5)) / np.arange(1, 6)
    cosines[np.arange(count), lobes - 1] += rng.uniform(0.0, 0.3, count)
    return size, cosines, sines


def contour_of(kind, numbers):
    """The contour of one row of `random_outlines`; "spline": a polar one by 96 of its points."""
    if kind == "spline":
        u = jnp.arange(96) * (2.0 * np.pi / 96)
        r = _radius(numbers, u)[0]
        return jxr.Spline(jnp.stack([r * jnp.cos(u), r * jnp.sin(u)], axis=-1), cells=256)
    return jxr.Ellipse(*numbers, cells=256) if kind == "ellipse" else Polar(*numbers)


def points_of(kind, numbers, count):
    """Points of the same shape, by NumPy."""
    return (ellipse_points if kind == "ellipse" else polar_points)(*numbers, count)


KINDS = (("ellipse", "ellipse"), ("ellipse", "polar"), ("polar", "ellipse"), ("polar", "polar"))


def random_pairs(rng, kinds, count, place):
    """Shapes and poses: a third apart, a third touching, a third overlapping moderately.

    `place` is that of `placer`.
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


def placer(kinds):
    """Compiled `place` of `random_pairs`.

    Shapes that start apart are moved along the normal at their closest points, so that no point is
    deeper than asked for; depth counts in the smallest radius of curvature.
    """

    def place(shapes, pose_a, pose_b, gap):
        a, b = (contour_of(kind, numbers).prepared() for kind, numbers in zip(kinds, shapes, strict=True))
        found = jxr.contact.locate(a, b, pose_a=pose_a, pose_b=pose_b)
        bends = [c.frame(jnp.linspace(0.0, 1.0, 400) * c.domain()[1]).curvature for c in (a, b)]
        sharpest = jnp.max(jnp.stack(bends))
        return pose_a.at[:2].add((gap[0] - gap[1] / sharpest - found.gap) * found.normal)

    return jax.jit(jax.vmap(place))


def locator(kinds, **options):
    """Compiled location of a batch of random pairs."""

    def find(shapes, pose_a, pose_b):
        a, b = (contour_of(kind, numbers).prepared() for kind, numbers in zip(kinds, shapes, strict=True))
        return jxr.contact.locate(a, b, pose_a=pose_a, pose_b=pose_b, **options)

    return jax.jit(jax.vmap(find))
