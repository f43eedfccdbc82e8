"""Points along lines and curves of the plane, of which contours are made."""

import numpy as np


def on_circle(count, radius=0.02, turn=0.0):
    angles = turn + 2.0 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def wavy(count, closed=True):
    """A closed curve with three lobes, or an open one with one bend."""
    u = 2.0 * np.pi * np.arange(count) / count if closed else np.linspace(0.3, 2.5, count)
    radius = 0.02 * (1.0 + 0.15 * np.cos(3.0 * u))
    return np.stack([radius * np.cos(u), 1.3 * radius * np.sin(u)], axis=1)


def row(*steps, height=0.0):
    """Points along the x axis with these steps between them."""
    x = np.append(0.0, np.cumsum(steps))
    return np.stack([x, np.full(len(x), height)], axis=1)


def path(*degrees, step=1e-3):
    """Points with these turnings between steps of one millimetre; the ends have none."""
    heading = np.radians(np.cumsum([0.0, *degrees]))
    steps = step * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
