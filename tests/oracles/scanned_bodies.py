"""Clouds of points like scans, of bodies whose distances are known in closed form. NumPy.

A body of revolution is a polygon of radius and height, a block three half widths; both have signed distances,
with which it is known where a ball fits. Ellipsoids, tori and superellipsoids are level surfaces.
"""

import numpy as np
from scipy.spatial import KDTree


class LevelBody:
    """A body given by a function whose zeros bound it, with gradient and second derivatives."""

    def __init__(self, value, gradient, hessian):
        self.value, self.gradient, self.hessian = value, gradient, hessian

    def feet(self, points, rounds=6):
        found = np.array(points, float)
        for _ in range(rounds):
            slope = self.gradient(found)
            found -= (self.value(found) / np.sum(slope**2, axis=1))[:, None] * slope
        return found


def superellipsoid(axes, power):
    """The body of all points with sum |x / a|^p < 1; an ellipsoid with p = 2."""
    axes = np.asarray(axes, float)
    value = lambda x: np.sum(np.abs(x / axes) ** power, axis=1) - 1.0  # noqa: E731
    slope = lambda x: power * np.abs(x / axes) ** (power - 1) * np.sign(x) / axes  # noqa: E731

    def hessian(x):
        lines = power * (power - 1.0) * np.abs(x / axes) ** (power - 2) / axes**2
        return lines[:, :, None] * np.eye(3)

    return LevelBody(value, slope, hessian)


def torus(ring, tube):
    """The body of all points nearer than `tube` to a circle of radius `ring`."""

    def parts(x):
        far = np.hypot(x[:, 0], x[:, 1])
        outward = np.stack([x[:, 0] / far, x[:, 1] / far, 0.0 * far], axis=1)
        return far, outward

    def value(x):
        return (parts(x)[0] - ring) ** 2 + x[:, 2] ** 2 - tube**2

    def slope(x):
        far, outward = parts(x)
        return 2.0 * (far - ring)[:, None] * outward + 2.0 * x * np.array([0.0, 0.0, 1.0])

    def hessian(x):
        far, outward = parts(x)
        along = outward[:, :, None] * outward[:, None, :]
        flat = np.diag([1.0, 1.0, 0.0])
        bent = 2.0 * (along + (1.0 - ring / far)[:, None, None] * (flat - along))
        return bent + 2.0 * np.diag([0.0, 0.0, 1.0])

    return LevelBody(value, slope, hessian)


def superellipsoid_cloud(rng, axes, power, count):
    """Points evenly over a superellipsoid: by lot from a ball's, each by the area it stands for."""
    axes, body = np.asarray(axes, float), superellipsoid(axes, power)
    found = np.zeros((0, 3))
    while len(found) < count:
        u = rng.normal(size=(count, 3))
        u /= np.linalg.norm(u, axis=1)[:, None]
        scale = np.sum(np.abs(u) ** power, axis=1) ** (-1.0 / power)
        points = (scale[:, None] * u) * axes
        slope = body.gradient(points)
        # Area over solid angle of the ball that was drawn from, scaled by the half axes.
        area = scale**2 * np.linalg.norm(slope, axis=1) / np.sum(slope * axes * u, axis=1)
        found = np.concatenate([found, points[rng.uniform(size=count) < area / area.max()]])
    return found[:count]


def torus_cloud(rng, ring, tube, count):
    """Points evenly over a torus."""
    v = rng.uniform(0.0, 2.0 * np.pi, 4 * count)
    v = v[rng.uniform(size=4 * count) < (ring + tube * np.cos(v)) / (ring + tube)][:count]
    u, out = rng.uniform(0.0, 2.0 * np.pi, count), ring + tube * np.cos(v)
    return np.stack([out * np.cos(u), out * np.sin(u), tube * np.sin(v)], axis=-1)


class TurnedBody:
    """A body of revolution about z, from a polygon of (radius, height) that begins and ends on the axis.

    The polygon runs upward along the outside.
    """

    def __init__(self, profile):
        self.profile = np.asarray(profile, float)

    def distance(self, points):
        """Signed distance [m], negative inside."""
        at = np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]], axis=1)
        least, inside = np.full(len(at), np.inf), np.zeros(len(at), bool)
        for a, b in zip(self.profile[:-1], self.profile[1:], strict=True):
            arm, edge = at - a, b - a
            part = np.clip(arm @ edge / (edge @ edge), 0.0, 1.0)
            least = np.minimum(least, np.linalg.norm(arm - part[:, None] * edge, axis=1))
            # Crossings of the ray outward from the point.
            if a[1] != b[1]:
                between = (at[:, 1] >= min(a[1], b[1])) & (at[:, 1] < max(a[1], b[1]))
                meets = a[0] + (at[:, 1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
                inside ^= between & (meets > at[:, 0])
        return np.where(inside, -least, least)

    def cloud(self, rng, count):
        """Points evenly over it, and outward normals."""
        a, b = self.profile[:-1], self.profile[1:]
        length = np.linalg.norm(b - a, axis=1)
        areas = length * (a[:, 0] + b[:, 0])
        which = rng.choice(len(a), count, p=areas / areas.sum())
        low, high, u = a[which, 0], b[which, 0], rng.uniform(size=count)
        # Radius squared is even along an edge, but for edges of one radius.
        sloped = np.abs(high - low) > 1e-9
        slope = np.where(sloped, high - low, 1.0)
        share = np.where(sloped, (np.sqrt(low**2 + u * (high**2 - low**2)) - low) / slope, u)
        at = a[which] + share[:, None] * (b - a)[which]
        out = ((b - a) / length[:, None])[which] @ np.array([[0.0, -1.0], [1.0, 0.0]])
        turn = rng.uniform(0.0, 2.0 * np.pi, count)
        around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        points = np.concatenate([at[:, :1] * around, at[:, 1:]], axis=1)
        return points, np.concatenate([out[:, :1] * around, out[:, 1:]], axis=1)


class Block:
    """A rectangular block about the origin."""

    def __init__(self, *half):
        self.half = np.asarray(half, float)

    def distance(self, points):
        """Signed distance [m], negative inside."""
        over = np.abs(points) - self.half
        return np.linalg.norm(np.maximum(over, 0.0), axis=1) + np.minimum(over.max(axis=1), 0.0)

    def cloud(self, rng, count):
        """Points evenly over it, and outward normals."""
        areas = np.prod(self.half) / self.half
        axis = rng.choice(3, count, p=areas / areas.sum())
        points = self.half * rng.uniform(-1.0, 1.0, (count, 3))
        normals = np.zeros((count, 3))
        normals[np.arange(count), axis] = rng.choice([-1.0, 1.0], count)
        points = np.where(normals != 0.0, normals * self.half, points)
        return points, normals


CAN = [(0, 3), (30, 3), (30.5, 0), (33, 0), (33, 102), (30.5, 102), (30, 99), (0, 99)]
BOTTLE = [(0, 0), (36, 0), (36, 100), (30, 130), (13, 150), (13, 165), (17, 165), (17, 190), (0, 190)]
VESSEL = [(0, 0), (40, 0), (45, 80), (42, 80), (37, 3), (0, 3)]
PEN = [(0, 0), (9.5, 0), (9.5, 110), (6, 121), (0, 121)]


def turned(profile):
    """A body of revolution from a profile in millimetres."""
    return TurnedBody(1e-3 * np.asarray(profile, float))


def where_balls_fit(body, points, normals, radius):
    """Which points of a body's surface a ball inside and one outside can touch, to 2 % of its radius."""
    inside = body.distance(points - radius * normals) <= -0.98 * radius
    return inside & (body.distance(points + radius * normals) >= 0.98 * radius)


def where_balls_fit_points(cloud, points, normals, radius):
    """The same for a surface that is known by many points."""
    tree = KDTree(cloud)
    near = [tree.query(points + side * radius * normals, workers=-1)[0] for side in (-1.0, 1.0)]
    return (near[0] >= 0.98 * radius) & (near[1] >= 0.98 * radius)
