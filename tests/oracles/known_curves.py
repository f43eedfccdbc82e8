"""Points of known curves, and how far a contour through them is from the curve."""

import numpy as np

A, B = 0.02, 0.014
RADIUS = 0.01


def ellipse_points(count, shift=0.0):
    """Points of an ellipse at equal eccentric angles."""
    th = 2 * np.pi * (np.arange(count) + shift) / count
    return np.stack([A * np.cos(th), B * np.sin(th)], -1)


def circle_points(count=200):
    """Points of a circle of 10 mm."""
    u = 2 * np.pi * np.arange(count) / count
    return RADIUS * np.stack([np.cos(u), np.sin(u)], -1)


def nearest_angle(points):
    """Eccentric angle of the nearest point of the ellipse, by Newton's method."""
    x, y = np.asarray(points).T
    th = np.arctan2(y / B, x / A)
    for _ in range(20):
        dx, dy = A * np.cos(th) - x, B * np.sin(th) - y
        slope = -A * np.sin(th) * dx + B * np.cos(th) * dy
        bend = (A * np.sin(th)) ** 2 + (B * np.cos(th)) ** 2 - A * np.cos(th) * dx - B * np.sin(th) * dy
        th = th - slope / bend
    return th


def ellipse_errors(contour):
    """Largest errors: point over the half axis, tangent, curvature relative."""
    contour = contour.prepared()
    s = np.linspace(0.0, float(contour.domain()[1]), 2000)
    point, tangent = np.asarray(contour.point(s)), np.asarray(contour.tangent(s))
    th = nearest_angle(point)
    exact = np.stack([A * np.cos(th), B * np.sin(th)], -1)
    rate = np.stack([-A * np.sin(th), B * np.cos(th)], -1)
    speed = np.linalg.norm(rate, axis=1)
    turn = (tangent[:, 0] * rate[:, 1] - tangent[:, 1] * rate[:, 0]) / speed
    return (
        np.abs(point - exact).max() / A,
        np.abs(turn).max(),
        np.abs(np.asarray(contour.curvature(s)) * speed**3 / (A * B) - 1).max(),
    )
