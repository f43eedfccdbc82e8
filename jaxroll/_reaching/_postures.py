r"""Postures of one finger that touch given points: inverse kinematics, by Newton's method from many starts.

Each target is a point P of the object with its outward normal N, in the world. Joint angles q and the places
of the tip are sought at which the tip's points X and normals m meet them,

$$ X(q, s) = P, \qquad m(q, s) = -N, $$

which in the plane are three equations for each contact, in space five. A step solves them linearised, damped
as by Levenberg and Marquardt; where a finger has more joints than it needs, the step is the shortest. All
starts go on together.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import Pose2, unstack
from .._mechanics import AbstractBody, Finger, Finger3, Grasp
from .._types import ByPrecision
from .._xla import quickly
from ..geometry import Circle, Sphere
from ._sheet import Frames, Sheet, shortened

# Starts of a search, which are also the rows of one call of a compiled program, and most steps of each.
STARTS, _STEPS = 64, 100
# About so many places of the tip, of which a start takes the one that faces its target.
_FACES = 96
# A posture touches where no gap is larger than the first, a share of the finger's length, and no tilt larger
# than the second.
_TOUCHES, _TILTS = ByPrecision(1e-13, 1e-6), ByPrecision(1e-11, 1e-5)
# A search whose damping has grown beyond this is stuck, and given up.
_STUCK = 1e8
# Least damping. A finger with joints to spare moves freely along a direction in which rounding alone says how
# far: where damping is not far above rounding, the posture found depends on the processor.
_DAMPING = 1e-9
# Rounding of angles [rad].
_ROUNDING = 1e-12
# Postures are one if no joint differs by more [rad or m].
_ALIKE = 1e-6


class TouchPoints(NamedTuple):
    """What the contacts of one finger are to touch, in the world.

    Attributes:
        points: Shape (c, d) [m].
        normals: Outward of the object, shape (c, d).
    """

    points: np.ndarray
    normals: np.ndarray


class Postures(NamedTuple):
    """Postures of a finger, one in each row.

    Attributes:
        q: Joint angles or displacements, shape (n, k).
        places: Of the tip, shape (n, c, coordinates).
        gaps: Largest distance of a point from its target [m], shape (n,).
        tilts: Largest length of a sum of both normals, shape (n,).
    """

    q: np.ndarray
    places: np.ndarray
    gaps: np.ndarray
    tilts: np.ndarray

    def taken(self, which: Any) -> "Postures":
        """Some of the postures."""
        return Postures(*(x[which] for x in self))


class Reacher(NamedTuple):
    """One finger and its tip, ready for searches.

    Attributes:
        finger: The finger.
        tip: Its tip.
        free: Which joints may move, shape (k,).
        length: What distances are measured against [m]; a finger that turns reaches no farther from its base.
        places: Of the tip, spread over it.
        samples: The tip's frames there.
    """

    finger: Any
    tip: Sheet
    free: np.ndarray
    length: float
    places: np.ndarray
    samples: Frames


def searched_postures(
    reacher: Reacher, targets: TouchPoints, starts: np.ndarray, limits: np.ndarray | None = None
) -> Postures:
    """Postures from starts, shape (n, k), by damped steps; kept within limits, shape (k, 2), if given.

    All that were found are returned: those that touch, and those that came as near as they could.
    """
    starts = np.resize(starts, (STARTS, starts.shape[1]))
    places = _facing(reacher, targets, starts)
    state = _evaluated(reacher, targets, starts, places)
    damping, rounding = np.full(STARTS, 1e-3), (0.01 * _TOUCHES.of(state)) ** 2
    for _ in range(_STEPS):
        q, places, error, rows, slopes, bends = state
        step = _damped(rows, slopes, damping)
        new_q = q + np.where(reacher.free, np.clip(step[:, : q.shape[1]], -0.5, 0.5), 0.0)
        if limits is not None:
            new_q = np.clip(new_q, *limits.T)
        shifted = _shifted(reacher.tip, places, bends, step[:, q.shape[1] :])
        trial = _evaluated(reacher, targets, new_q, shifted)
        better = trial[2] < error
        state = tuple(
            np.where(better.reshape(-1, *(1,) * (a.ndim - 1)), a, b)
            for a, b in zip(trial, state, strict=True)
        )
        damping = np.where(better, np.maximum(0.1 * damping, _DAMPING), 10.0 * damping)
        # Rounding alone is left, or no step helps.
        if np.all((state[2] < rounding) | (damping > _STUCK)):
            break
    q, places, _, rows, *_ = state
    c = len(targets.points)
    gaps, tilts = np.split(np.linalg.norm(rows.reshape(len(q), 2 * c, -1), axis=2), 2, axis=1)
    return Postures(q, places, gaps.max(axis=1) * reacher.length, tilts.max(axis=1))


def touching(reacher: Reacher, found: Postures) -> Postures:
    """Those postures that touch all targets, each once; angles between -pi and pi."""
    gap, tilt = _TOUCHES.of(found.gaps) * max(reacher.length, 1e-3), _TILTS.of(found.tilts)
    near = (found.gaps <= gap) & (found.tilts <= tilt)
    good = unwound(reacher, found.taken(near))
    kept: list[int] = []
    for i, q in enumerate(good.q):
        away = [np.abs(q - good.q[j]).max(initial=0.0) > _ALIKE for j in kept]
        if all(away):
            kept.append(i)
    return good.taken(np.array(kept, int))


def unwound(reacher: Reacher, found: Postures) -> Postures:
    """The same postures with the angles of free joints between -pi and pi."""
    if not reacher.finger.turns:
        return found
    # Half a turn is pi, to rounding, and not at times -pi.
    turns = np.ceil((found.q - np.pi - _ROUNDING) / (2.0 * np.pi))
    return found._replace(q=np.where(reacher.free, found.q - 2.0 * np.pi * turns, found.q))


def poses_at(body: AbstractBody, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins (n, d) and rotation matrices (n, d, d) of a body's frame at positions, shape (n, k)."""
    origin, turn, _, _ = placed_at(body, q)
    return origin, turn


def tip_origins(grasp: Grasp, q: np.ndarray) -> list[np.ndarray]:
    """Where the tip frames of a grasp's fingers are at its positions q [m]."""
    ends = np.cumsum(grasp.form.positions)
    each = zip(grasp.fingers, ends, ends[1:], strict=False)
    return [poses_at(finger, q[None, first:last])[0][0] for finger, first, last in each]


def _facing(reacher: Reacher, targets: TouchPoints, q: np.ndarray) -> np.ndarray:
    """Places of the tip whose normals face the targets best, for each start: shape (n, c, coordinates)."""
    some = slice(None, None, max(1, len(reacher.places) // _FACES))
    _, turn = poses_at(reacher.finger, q)
    facing = np.einsum("nij,mj,ci->ncm", turn, reacher.samples.normals[some], targets.normals)
    return reacher.places[some][np.argmin(facing, axis=2)]


def _shifted(tip: Sheet, places: np.ndarray, bends: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Places of the tip, where it has these bends, after tangent steps, shape (n, c k)."""
    count = places.shape[0] * places.shape[1]
    steps = shortened(steps.reshape(count, -1), bends.reshape(count, *bends.shape[2:]))
    return tip.moved(places.reshape(count, -1), steps).reshape(places.shape)


def _evaluated(reacher: Reacher, targets: TouchPoints, q: np.ndarray, places: np.ndarray) -> tuple[Any, ...]:
    """Joints, places, sum of squares, rows (n, r), their derivatives (n, r, u) and bends at postures.

    Rows are the gaps over the finger's length, contact by contact, then the sums of both normals.
    """
    n, c = places.shape[:2]
    flat = reacher.tip.frames(places.reshape(n * c, -1))
    tip = Frames(*(x.reshape(n, c, *x.shape[1:]) for x in flat))
    origin, turn, origin_rate, turn_rate = placed_at(reacher.finger, q)
    points = origin[:, None] + np.einsum("nij,ncj->nci", turn, tip.points)
    normals = np.einsum("nij,ncj->nci", turn, tip.normals)
    along = np.einsum("nij,nckj->ncki", turn, tip.tangents)
    gaps = (points - targets.points) / reacher.length
    tilts = normals + targets.normals
    # Derivatives: of the joints, then of tangent steps of each contact over the tip.
    joints = q.shape[1]
    by_joint = origin_rate[:, None] + np.einsum("nijq,ncj->nciq", turn_rate, tip.points)
    tilt_by_joint = np.einsum("nijq,ncj->nciq", turn_rate, tip.normals)
    tilt_along = np.einsum("ncab,nca...->nc...b", tip.bends, along)
    d, k = points.shape[2], along.shape[2]
    slopes = np.zeros((n, 2, c, d, joints + c * k))
    slopes[:, 0, ..., :joints] = by_joint / reacher.length * reacher.free
    slopes[:, 1, ..., :joints] = tilt_by_joint * reacher.free
    for i in range(c):
        own = slice(joints + i * k, joints + (i + 1) * k)
        slopes[:, 0, i, :, own] = np.swapaxes(along[:, i], 1, 2) / reacher.length
        slopes[:, 1, i, :, own] = tilt_along[:, i]
    rows = np.concatenate([gaps.reshape(n, -1), tilts.reshape(n, -1)], axis=1)
    error = np.einsum("nr,nr->n", rows, rows)
    error = np.where(np.isfinite(error), error, np.inf)
    return q, places, error, rows, slopes.reshape(n, 2 * c * d, -1), tip.bends


def _damped(rows: np.ndarray, slopes: np.ndarray, damping: np.ndarray) -> np.ndarray:
    r"""Steps $-(J^T J + \lambda D)^{-1} J^T r$, D the diagonal of $J^T J$."""
    square = np.einsum("nru,nrv->nuv", slopes, slopes)
    size = np.einsum("nuu->nu", square)
    scale = np.maximum(size, 1e-12 * size.max(axis=1, keepdims=True) + 1e-300)
    square += np.eye(size.shape[1]) * (scale * damping[:, None])[:, None, :]
    right = np.einsum("nru,nr->nu", slopes, rows)
    # Rounding may leave a singular matrix where the damping is least.
    square += np.eye(size.shape[1]) * (1e-15 * size.max(axis=1))[:, None, None]
    return -np.linalg.solve(square, right[..., None])[..., 0]


def placed_at(body: Any, q: np.ndarray) -> tuple[np.ndarray, ...]:
    """Origins and rotation matrices of a body's frame, and their derivatives in its positions."""
    # With round tips, which move nothing: one program for fingers with tips of any class.
    if isinstance(body, Finger | Finger3):
        body = eqx.tree_at(lambda f: f.tip, body, Circle(1.0) if isinstance(body, Finger) else Sphere(1.0))
    count = -(-len(q) // STARTS)
    padded = np.resize(q, (count * STARTS, q.shape[1])).reshape(count, STARTS, -1)
    found = [_poses(body, jnp.asarray(batch)) for batch in padded]
    return tuple(np.concatenate([np.asarray(x) for x in part])[: len(q)] for part in zip(*found, strict=True))


@quickly
def _poses(body: Any, q: Array) -> tuple[Array, ...]:
    ready = body.prepared()

    def frame(row: Array) -> tuple[Array, Array]:
        pose = ready.placed(unstack(row))[0]
        if isinstance(pose, Pose2):
            turn = jnp.stack([jnp.stack([pose.cos, -pose.sin]), jnp.stack([pose.sin, pose.cos])])
            return pose.origin.array(), turn
        return pose.origin.array(), jnp.stack([axis.array() for axis in (pose.x, pose.y, pose.z)], axis=1)

    def both(row: Array) -> tuple[Array, ...]:
        return *frame(row), *jax.jacfwd(frame)(row)

    return jax.vmap(both)(q)
