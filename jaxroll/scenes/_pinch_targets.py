"""Targets of two fingers that need no search: those that failed before, and those that are too far away.

`_any_pinch` asks both before it calls `reach`, which takes some tenths of a second.
"""

from typing import Any

import numpy as np

from .._reaching import sheet_of

# Targets that differ by less are the same, in metres and in their normals. To `_any_pinch` a tip is round if
# its centres of curvature differ by less, relative to its radius.
SAME = 1e-9


class FailedTargets:
    """What fingers could not touch, so that it is not searched for again.

    The turns of an object about the line between two antipodal points leave what is to be touched where it
    was, and so does a swap of the two: a search would find the same as before.
    """

    def __init__(self) -> None:
        self.known: list[tuple[list[Any], np.ndarray]] = []

    def before(self, hand: list[Any], points: np.ndarray, normals: np.ndarray, pose: np.ndarray) -> bool:
        """Whether these fingers failed at the same points and normals in the world."""
        at = _in_world(points, normals, pose)
        return any(
            all(a is b for a, b in zip(hand, other, strict=True)) and np.abs(at - there).max() < SAME
            for other, there in self.known
        )

    def add(self, hand: list[Any], points: np.ndarray, normals: np.ndarray, pose: np.ndarray) -> None:
        """Remember that these fingers failed."""
        self.known.append((hand, _in_world(points, normals, pose)))


def _in_world(points: np.ndarray, normals: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Points of an object and normals there, in the world: shape (2, n, d)."""
    d = points.shape[1]
    turn = _turned(pose[d:])
    return np.stack([pose[:d] + points @ turn.T, normals @ turn.T])


def _turned(given: np.ndarray) -> np.ndarray:
    """The rotation matrix of an angle, or of a unit quaternion."""
    if len(given) == 1:
        cos, sin = np.cos(given[0]), np.sin(given[0])
        return np.array([[cos, -sin], [sin, cos]])
    w, (x, y, z) = given[0], given[1:]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross


def out_of_reach(hand: list[Any], points: np.ndarray, pose: np.ndarray) -> str:
    """How a point is farther from a finger's base than the finger is long; empty where none is."""
    places = _in_world(points, points, pose)[0]
    for i, (finger, place) in enumerate(zip(hand, places, strict=True)):
        tip = sheet_of(finger.tip)
        longest = float(np.abs(tip.frames(tip.sampled(256, 0.05)).points).sum(axis=1).max())
        length = finger.joints * float(finger.size) + longest
        away = float(np.linalg.norm(place - np.asarray(finger.base)))
        if away > length:
            return (
                f"finger {i}: a target is {away:.3g} m from its base, and it reaches {length:.3g} m at most"
            )
    return ""
