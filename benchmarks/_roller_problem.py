"""The roller between two plates: its numbers, and what every engine that runs it hands over."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

# SI units, those of `jxr.scenes.roller()`; no gravity.
RADIUS, MASS, FORCE = 0.01, 0.02, 5.0
TRAVEL, PERIOD = 0.03, 3.0
PLATE = 10.0 * MASS
INERTIA = 0.5 * MASS * RADIUS**2
RATE = 2.0 * np.pi / PERIOD
# Peers' plate rides on a carriage too heavy to feel the roller. On a spring of this rate [1/s] it swings
# 0-30-0 mm by itself, with nothing to compute between steps.
CARRIAGE = 1e3
SPRING = CARRIAGE * RATE**2
SAMPLES = 300
CIRCLE, POINTS = "circle", "128 points"


@dataclasses.dataclass(frozen=True)
class Case:
    """One engine, shape and setting: `call` is timed, `read` turns its result into a path.

    A path has shape (t, 4): the roller's centre x and y (from its start), its angle times the radius,
    and the upper plate's travel u [m].
    """

    engine: str
    given: str
    shape: str
    setting: str
    call: Callable[[], Any]
    read: Callable[[Any], np.ndarray] = np.asarray
    count: Callable[[Any], int] = len
    outcome: Callable[[Any], str] = lambda _: ""
    slow: bool = False


def polygon(count: int = 128) -> np.ndarray:
    """Points of the circle, shape (n, 2)."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def prism() -> np.ndarray:
    """Corners of a prism over the polygon, 20 mm deep along y, shape (2 n, 3)."""
    x, z = polygon().T
    return np.concatenate([np.stack([x, np.full_like(x, y), z], axis=-1) for y in (-0.01, 0.01)])


def facets() -> float:
    """By how much the angle of an exactly rolling polygon of 128 points falls behind, as a length [m]."""
    half = np.pi / len(polygon())
    return 0.5 * TRAVEL * (1.0 - np.sin(half) / half)
