r"""Which of a finger's postures is taken: one that keeps limits and elbow side, and overlaps nothing.

What is wrong where there is none is told by a code of `RESULTS` and a sentence with numbers.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import unstack
from .._xla import quickly
from ._overlap import heights, SampledObject
from ._postures import (
    poses_at,
    Postures,
    Reacher,
    searched_postures,
    STARTS,
    touching,
    TouchPoints,
    unwound,
)

# An overlap below this share of a finger's length is the contact itself.
_TOLERANCE = 1e-6
# Lengths and angles that differ by less are the same: rounding must not choose between postures.
_EQUAL = 1e-9
# Points on each link.
_LINK = 16
# Postures that are compared; of a finger with joints to spare there are many more.
_JUDGED = 12
# Displacements of a jaw are measured against this length, and searched for at least as far [m].
_LENGTH = 0.05


class Wish(NamedTuple):
    """What one finger is asked for."""

    elbow: int  # wanted sign of the last joint's angle; 0 for either
    guess: np.ndarray | None  # joints to stay near
    limits: np.ndarray | None  # (k, 2)
    link_radius: float  # of the links, as capsules; minus infinity where they may pass through the object


class Choice(NamedTuple):
    """The posture taken of one finger, and what is wrong with it."""

    posture: Postures
    code: str  # the name of one of `RESULTS`
    reason: str  # why, after the finger's number; empty where nothing is wrong
    overlap: float  # of the tip and the object [m]
    links: float  # least distance of the links from the object [m]
    count: int  # postures that touch


def chosen_posture(
    reacher: Reacher, targets: TouchPoints, wish: Wish, object_: tuple[SampledObject, np.ndarray, np.ndarray]
) -> Choice:
    """The best posture of one finger that touches its targets."""
    starts = _starts(reacher, targets, wish)
    found = searched_postures(reacher, targets, starts)
    good = touching(reacher, found)
    if not len(good.q) and not len(targets.points):
        good = found.taken([0])
    if not len(good.q):
        nearest = unwound(reacher, found.taken([int(np.argmin(found.gaps / reacher.length + found.tilts))]))
        return Choice(nearest, "unreachable", _too_far(reacher, targets, nearest), 0.0, np.inf, 0)
    fair = good.taken(_within(reacher, good, wish.limits))
    if not len(fair.q) and wish.limits is not None:
        fair = _touching_within(reacher, targets, starts, wish.limits)
    if not len(fair.q):
        return Choice(good.taken([0]), "joint_limit", _beyond(good, wish.limits), 0.0, np.inf, len(good.q))
    sided = fair.taken(wish.elbow * fair.q[:, -1:].sum(axis=1) >= 0.0)
    if not len(sided.q):
        reason = f"only postures whose last joint has the other sign than elbow={wish.elbow} touch"
        return Choice(fair.taken([0]), "unreachable", reason, 0.0, np.inf, len(good.q))
    one, overlap, links = _best(reacher, sided, wish, object_)
    touches = overlap <= _TOLERANCE * reacher.length
    if touches and links >= wish.link_radius:
        return Choice(one, "successful", "", overlap, links, len(good.q))
    if touches:
        reason = f"its links come within {links:.3g} m of the object in every posture"
        return Choice(one, "links_meet", reason, overlap, links, len(good.q))
    reason = f"its tip overlaps the object by {overlap:.3g} m or more in every posture"
    return Choice(one, "penetration", reason, overlap, links, len(good.q))


def judged_posture(
    reacher: Reacher, q: np.ndarray, wish: Wish, object_: tuple[SampledObject, np.ndarray, np.ndarray]
) -> Choice:
    """One posture that touches, joints of shape (k,), which no search here found: what is wrong with it."""
    one = Postures(q[None], np.zeros((1, 0, 0)), np.zeros(1), np.zeros(1))
    (overlap,), (links,), _ = (x.tolist() for x in _clearances(reacher, one, object_))
    wrong = ("successful", "")
    if links < wish.link_radius:
        wrong = ("links_meet", f"its links come within {links:.3g} m of the object")
    if overlap > _TOLERANCE * reacher.length:
        wrong = ("penetration", f"its tip overlaps the object by {overlap:.3g} m")
    if wish.elbow * q[-1:].sum() < 0.0:
        wrong = ("unreachable", f"its last joint has the other sign than elbow={wish.elbow}")
    if not _within(reacher, one, wish.limits)[0]:
        wrong = ("joint_limit", _beyond(one, wish.limits))
    return Choice(one, *wrong, overlap, links, 1)


def _best(
    reacher: Reacher, found: Postures, wish: Wish, object_: tuple[SampledObject, np.ndarray, np.ndarray]
) -> tuple[Postures, float, float]:
    """The posture nearest to the guess or with links farthest away, its overlap and its links' distance.

    Of postures whose links come equally near, as where the end of the last link is nearest in all of them,
    the one is taken whose links are farthest away on average, and of mirrored ones the one with the smallest
    angles.

    Postures that overlap come last, and before them those whose links meet the object. Some postures at a
    time are looked at, until one does neither.
    """
    if wish.guess is not None:
        scale = 2.0 * np.pi if reacher.finger.turns else _LENGTH
        away = np.linalg.norm((found.q - wish.guess) / scale, axis=1)
        found = found.taken(np.argsort(away, kind="stable"))
    best: tuple[Postures, float, float] | None = None
    least = _TOLERANCE * reacher.length
    for begin in range(0, len(found.q), _JUDGED):
        some = found.taken(slice(begin, begin + _JUDGED))
        overlaps, links, average = _clearances(reacher, some, object_)
        # Without a guess they are in no order.
        away = [-links, -average, np.abs(some.q).sum(axis=1), *some.q.T]
        costs = [np.round(cost / _EQUAL) for cost in away] if wish.guess is None else []
        meets = np.maximum(np.round((wish.link_radius - links) / _EQUAL), 0.0)
        i = int(np.lexsort((*costs[::-1], meets, np.maximum(overlaps, least)))[0])
        worse = best is not None and (best[1], -best[2]) <= (overlaps[i], -links[i])
        if best is None or not worse:
            best = some.taken([i]), float(overlaps[i]), float(links[i])
        if best[1] <= least and best[2] >= wish.link_radius:
            break
    assert best is not None
    return best


def _touching_within(
    reacher: Reacher, targets: TouchPoints, starts: np.ndarray, limits: np.ndarray
) -> Postures:
    """Postures that touch, from searches that stay within joint limits: of fingers with joints to spare."""
    found = searched_postures(reacher, targets, np.clip(starts, *limits.T), limits)
    good = touching(reacher, found)
    return good.taken(_within(reacher, good, limits))


def _starts(reacher: Reacher, targets: TouchPoints, wish: Wish) -> np.ndarray:
    """Joints that searches start from: the guess and around it, then spread over the limits or a turn."""
    rng, k = np.random.default_rng(0), reacher.finger.joints
    low, high = np.full(k, -np.pi), np.full(k, np.pi)
    if not reacher.finger.turns:
        far = float(np.abs(targets.points).max(initial=_LENGTH)) + reacher.length
        low, high = np.full(k, -far), np.full(k, far)
    if wish.limits is not None:
        low, high = np.maximum(low, wish.limits[:, 0]), np.minimum(high, wish.limits[:, 1])
        high = np.maximum(low, high)
    starts = rng.uniform(low, high, (STARTS, k))
    if wish.guess is not None:
        near = wish.guess + 0.2 * (high - low) * rng.normal(size=(STARTS // 4, k))
        starts[: len(near)] = near
        starts[0] = wish.guess
        starts = np.where(reacher.free, starts, wish.guess)
    return starts


def _within(reacher: Reacher, found: Postures, limits: np.ndarray | None) -> np.ndarray:
    """Which postures keep the limits of the joints."""
    if limits is None:
        return np.ones(len(found.q), bool)
    slack = 1e-12 * (1.0 + np.abs(limits))
    inside = (found.q >= limits[:, 0] - slack[:, 0]) & (found.q <= limits[:, 1] + slack[:, 1])
    return np.all(inside, axis=1)


def _too_far(reacher: Reacher, targets: TouchPoints, nearest: Postures) -> str:
    """Why no posture touches, in numbers."""
    base = getattr(reacher.finger, "base", None)
    if base is not None and reacher.finger.turns:  # a jaw slides as far as it must
        away = float(np.linalg.norm(targets.points - np.asarray(base), axis=1).max())
        if away > reacher.length:
            return f"a target is {away:.3g} m from its base, and it reaches {reacher.length:.3g} m at most"
    return (
        f"its nearest posture leaves {float(nearest.gaps[0]):.3g} m and normals that are "
        f"{float(nearest.tilts[0]):.3g} off being opposite"
    )


def _beyond(found: Postures, limits: np.ndarray | None) -> str:
    """Which joint has to pass its limit, by the posture that passes it least."""
    assert limits is not None
    over = np.maximum(limits[:, 0] - found.q, found.q - limits[:, 1])
    best = int(np.argmin(over.max(axis=1)))
    joint = int(np.argmax(over[best]))
    return f"joint {joint} would have to be {over[best, joint]:.3g} beyond its limit"


def _clearances(
    reacher: Reacher, found: Postures, object_: tuple[SampledObject, np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How deep the tip overlaps the object, how far the links stay from it and are on average [m]."""
    solid, origins, turns = object_
    local = reacher.samples.points
    tips, ways = poses_at(reacher.finger, found.q)
    joints = _skeletons(reacher.finger, found.q)
    points = tips[:, None] + np.einsum("nij,mj->nmi", ways, local)
    share = np.linspace(0.0, 1.0, _LINK)[:, None]
    along = [joints[:, i, None] * (1.0 - share) + joints[:, j, None] * share for i, j in _links(joints)]
    both = np.concatenate([points, *along], axis=1)
    world = (both - origins[0]).reshape(-1, both.shape[2]) @ turns[0]
    away = heights(solid, world).reshape(both.shape[:2])
    count = len(local)
    links = away[:, count:]
    return np.maximum(0.0, -away[:, :count].min(axis=1)), links.min(axis=1), links.mean(axis=1)


def _links(joints: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of joints that a link connects; a jaw has one point alone."""
    last = joints.shape[1] - 1
    return [(i, min(i + 1, last)) for i in range(max(1, last))]


def _skeletons(finger: Any, q: np.ndarray) -> np.ndarray:
    """Joints and tip frames of postures, shape (n, points, d)."""
    padded = np.resize(q, (STARTS * max(1, -(-len(q) // STARTS)), q.shape[1]))
    return np.asarray(_chains(finger, jnp.asarray(padded)))[: len(q)]


@quickly
def _chains(finger: Any, q: Array) -> Array:
    ready = finger.prepared()
    return jax.vmap(lambda row: jnp.stack([point.array() for point in ready.skeleton(unstack(row))]))(q)
