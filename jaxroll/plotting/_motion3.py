"""What moves where in a spatial grasp: the input of all pictures in space."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_AT_CONTACTS = ("on_tip", "on_object", "out_of_tip", "out_of_object")


@dataclass(frozen=True)
class Motion3D:
    """Poses and contacts of a spatial grasp at times t, as NumPy arrays.

    A pose is a position [m] and a unit quaternion, scalar first.

    Args:
        body: Poses of the object, shape (t, 7).
        tips: Poses of the fingers' tip frames, shape (m, t, 7).
        skeletons: For each finger the points from its base to its tip frame, shape (t, points, 3) [m].
        on_tip: Contact points in the tip's frame, shape (c, t, 3) [m].
        on_object: Contact points in the object's frame, shape (c, t, 3) [m].
        out_of_tip: Outward unit normals of the fingertips there, shape (c, t, 3).
        out_of_object: Outward unit normals of the object.

    Times that a run did not reach are NaN; they are left out of the pictures.

    Raises:
        ValueError: If the shapes do not agree.
    """

    body: np.ndarray
    tips: np.ndarray
    skeletons: Sequence[np.ndarray]
    on_tip: np.ndarray
    on_object: np.ndarray
    out_of_tip: np.ndarray
    out_of_object: np.ndarray

    def __post_init__(self) -> None:
        for name in ("body", "tips", *_AT_CONTACTS):
            object.__setattr__(self, name, np.asarray(getattr(self, name), float))
        object.__setattr__(self, "skeletons", tuple(np.asarray(s, float) for s in self.skeletons))
        times, fingers = len(self.body), len(self.tips)
        _shaped("body", self.body, (times, 7))
        _shaped("tips", self.tips, (fingers, times, 7))
        for name in _AT_CONTACTS:
            _shaped(name, getattr(self, name), (len(self.on_tip), times, 3))
        if len(self.skeletons) != fingers:
            raise ValueError(
                f"argument skeletons must have one entry for each of {fingers} fingers, "
                f"but had {len(self.skeletons)}"
            )
        for skeleton in self.skeletons:
            _shaped("skeletons", skeleton, (times, skeleton.shape[1] if skeleton.ndim > 1 else 1, 3))

    @property
    def times(self) -> int:
        """How many times there are."""
        return len(self.body)

    def at(self, rows: np.ndarray) -> "Motion3D":
        """The same at some of its times."""
        skeletons = [skeleton[rows] for skeleton in self.skeletons]
        at_contacts = [getattr(self, name)[:, rows] for name in _AT_CONTACTS]
        return Motion3D(self.body[rows], self.tips[:, rows], skeletons, *at_contacts)

    def reached(self) -> tuple["Motion3D", np.ndarray]:
        """What there is before a run ended, if it ended early, and the rows of these times.

        Raises:
            ValueError: If no time was reached.
        """
        arrays = (self.body[None], self.tips, self.on_tip, self.on_object)
        finite = [np.isfinite(array).all(axis=(0, 2)) for array in arrays]
        rows = np.flatnonzero(np.all(finite, axis=0))
        if not len(rows):
            raise ValueError("argument motion must hold at least one time that was reached, but held none")
        return self.at(rows), rows


def _shaped(name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise ValueError(f"argument {name} must have shape {shape}, but had shape {array.shape}")


def times_of(motion: Motion3D, ts: np.ndarray) -> np.ndarray:
    """The times of a motion, as many as it has."""
    ts = np.asarray(ts, float)
    _shaped("ts", ts, (motion.times,))
    return ts


def matrices(quaternions: np.ndarray) -> np.ndarray:
    """Rotations, shape (..., 3, 3), of unit quaternions of shape (..., 4), scalar first."""
    w, x, y, z = np.moveaxis(np.asarray(quaternions, float), -1, 0)
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def placed(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Body-frame points, shape (n, 3), in the world; `pose` has shape (7,)."""
    # Points are rows: R p of each is p^T R^T.
    return points @ matrices(pose[3:]).T + pose[:3]


def turned(pose: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Body-frame directions, shape (n, 3), in world axes."""
    return vectors @ matrices(pose[3:]).T


def rotation_vectors(quaternions: np.ndarray) -> np.ndarray:
    """Axis times angle [rad] of the turns since the first, in world axes, shape (t, 3).

    Continuous up to a whole turn: the quaternions, shape (t, 4), may change sign from one to the next.
    """
    q = np.asarray(quaternions, float)
    # q and -q are one rotation: each takes the sign that is nearer to the one before. Without these flips the
    # angle would jump by a turn.
    flips = np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)
    q = q * np.cumprod(np.append(1.0, flips))[:, None]
    # q_i times the conjugate of q_0 is the turn since then: (cos(angle / 2), sin(angle / 2) axis).
    w0, v0 = q[0, 0], -q[0, 1:]
    scalar = q[:, 0] * w0 - q[:, 1:] @ v0
    vector = q[:, :1] * v0 + w0 * q[:, 1:] + np.cross(q[:, 1:], v0)
    sine = np.linalg.norm(vector, axis=1)
    angle = 2.0 * np.arctan2(sine, scalar)
    # Near no turn at all, angle / sin(angle / 2) is 2.
    return vector * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)[:, None]
