"""Random outlines as polygons, in NumPy, and the gap between two of them by a search over all vertices."""

import functools

import numpy as np
from scipy.spatial import cKDTree

KINDS = (("ellipse", "ellipse"), ("ellipse", "polar"), ("polar", "ellipse"), ("polar", "polar"))


@functools.cache
def waves(orders, count):
    """Cosines and sines of 1, 2, ... times the angle, at equal steps of it."""
    angles = np.arange(1, orders + 1)[:, None] * (np.arange(count) * (2.0 * np.pi / count))
    return np.cos(angles), np.sin(angles)


def points_of_polar(size, cosines, sines, count):
    """Points of the same curve, at equal steps of the angle, in NumPy."""
    cos, sin = waves(len(cosines), count)
    r = size * (1.0 + np.asarray(cosines) @ cos + np.asarray(sines) @ sin)
    return np.stack([r * cos[0], r * sin[0]], -1)


def points_of_ellipse(a, b, count):
    (cos,), (sin,) = waves(1, count)
    return np.stack([a * cos, b * sin], -1)


def placed_points(points, pose):
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[cos, sin], [-sin, cos]]) + np.asarray(pose[:2])


def signed_distances(tree, polygon, points):
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


def gap_by_brute_force(a, b, *, block=50):
    """Least signed distance over the vertices of `a` from polygon `b`: all of them, by bounds.

    The signed distance changes at most as fast as the point moves, so a block of vertices whose middle
    is farther than the best by more than the block's reach holds no lower one. Returns the distance and
    the vertex.
    """
    tree, count = cKDTree(b, leafsize=64, balanced_tree=False, compact_nodes=False), len(a)
    middles = np.arange(block // 2, count, block)
    blocks = a.reshape(-1, block, 2)
    reach = np.linalg.norm(blocks - a[middles][:, None], axis=-1).max(axis=1)
    coarse = signed_distances(tree, b, a[middles])
    near = np.flatnonzero(coarse - reach <= coarse.min())
    near = near[np.argsort(coarse[near])]
    first = (near[:3, None] * block + np.arange(block)).ravel()
    values = signed_distances(tree, b, a[first])
    rest = near[3:][coarse[near[3:]] - reach[near[3:]] <= values.min()]
    rest = (rest[:, None] * block + np.arange(block)).ravel()
    values = np.concatenate([values, signed_distances(tree, b, a[rest])]) if rest.size else values
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


def points_of(kind, numbers, count):
    """Points of the same shape, by NumPy."""
    return (points_of_ellipse if kind == "ellipse" else points_of_polar)(*numbers, count)
