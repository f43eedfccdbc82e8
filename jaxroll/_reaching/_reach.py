r"""`reach`: joint angles at which the fingertips touch given points of an object, as a closed start.

The object is held. Each finger is searched for all of its postures that touch what its contacts are to touch
(`_postures`); of these one is taken that keeps joint limits and elbow sides, overlaps the object nowhere
(`_overlap`), and is nearest to the guess, or else keeps its links farthest from the object. Where fingers
have too few joints, the object may be let go: then `close` moves it too.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._closing import held_velocities
from .._linalg import unstack
from .._mechanics import check_planar, check_spatial, check_states, Grasp, State, tabled_grasp
from .._motion import residuals
from .._printing import listed
from .._results import as_array, as_floats, check_finite, check_flag, check_instance, RESULTS, shown, traced
from .._types import Given
from .._xla import quickly
from ._overlap import heights, Solid, solid_of
from ._postures import poses_at, Postures, Reacher, searched_postures, Targets, touching
from ._sheet import Sheet, sheet_of

# A point given counts as one of the object if it is off by no more than this share of the object's size.
_NEAR = 0.01
# An overlap below this is the contact itself [m].
_TOLERANCE = 1e-7
# Samples of a fingertip, in the plane and in space, and points on each link.
_TIP, _LINK = (384, 720), 16
# A search's starts, and an object's extent where its faces have no bounds [m].
_STARTS, _EXTENT = 64, 0.1
# Contacts count as closed, of postures and of what `close` found [m or rad].
_CLOSED = 1e-12
# Joints of one finger differ from the guess by their share of a turn; displacements by this length [m].
_LENGTH = 0.05


class Reach(eqx.Module):
    """A start from `reach`, or why there is none.

    Attributes:
        grasp: The grasp; in the plane its contacts have the arclengths that touch.
        state: At rest, the contacts closed if `result` is `successful`; else as near as was found.
        result: Code of `jaxroll.RESULTS`: `successful`; `unreachable` where a finger does not get there, or
            only with its elbow on the other side; `joint_limit`, `penetration`, `singular_contact`.
        reason: Why, in a sentence with numbers; empty where it is a success.
        gap: Largest distance of two contact points [m].
        tilt: Largest length of a sum of two outward normals.
        overlap: How deep fingertips and object overlap away from their contacts [m].
        links: Least distance of the fingers' links, as lines, from the object [m]; negative inside.
        postures: How many postures of each finger touch, limits and elbows aside.
    """

    __repr__ = listed

    grasp: Grasp
    state: State
    result: RESULTS
    reason: str = eqx.field(static=True)
    gap: float = eqx.field(static=True)
    tilt: float = eqx.field(static=True)
    overlap: float = eqx.field(static=True)
    links: float = eqx.field(static=True)
    postures: tuple[int, ...] = eqx.field(static=True)

    @property
    def start(self) -> tuple[Grasp, State]:
        """Grasp and state, as `simulate` takes them."""
        return self.grasp, self.state


class _Wish(NamedTuple):
    """What one finger is asked for."""

    elbow: int  # wanted sign of the last joint's angle; 0 for either
    guess: np.ndarray | None  # joints to stay near
    limits: np.ndarray | None  # (k, 2)


class _Choice(NamedTuple):
    """The posture taken of one finger, and what is wrong with it."""

    posture: Postures
    code: str
    reason: str
    overlap: float
    links: float
    count: int


def reach(
    grasp: Grasp,
    contacts: Given,
    *,
    pose: Given | None = None,
    guess: State | None = None,
    hold: str | Sequence[str] = (),
    elbow: int | Sequence[int] | None = None,
    hold_object: bool = True,
) -> Reach:
    r"""Find a closed start in which the fingertips touch an object where they are asked to.

    Args:
        grasp: The grasp. Each contact says which finger touches which contour or surface; its arclengths are
            replaced by those found.
        contacts: Where each contact is to be on the object: points in its frame, shape (c, 2) or (c, 3) [m],
            such as a row of `grasp_points(...).points`; or arclengths (c,), or coordinates (c, 2) of charts.
        pose: Of the object: its positions as in a state, $(x, y, \theta)$, or position and quaternion, or the
            angle of a pivoted one. Default: that of `guess`, or the world's axes.
        guess: A state with joints to stay near; `hold` takes its joints from there. Default: none; then links
            stay as far from the object as they can.
        hold: Joints that keep the values of `guess`, by name: 'finger 0', 'finger 1 q[0]'.
        elbow: Sign of the last joint's angle, 1 or -1, for all fingers or for each; 0 for either.
        hold_object: If False, and a finger does not get there, `close` may move the object and roll the
            contacts.

    Returns:
        A `Reach`: `simulate(*found.start, t1)` runs it where `found.result` is `successful`.

    Raises:
        ValueError: If an argument does not fit, a point is off the object by more than a hundredth of its
            size, or contacts are of one's own class.

    Accuracy: gaps below 1e-12 m. Searches go on from 64 starts; a posture may be missed whose joints are
    nearly stretched. Overlap is that of samples, 384 of a contour and 720 of a surface.

    Example:
        >>> import jaxroll as jxr
        >>> links, masses, tip = [0.06, 0.05], [0.03, 0.02], jxr.Circle(0.01)
        >>> fingers = [jxr.Finger(links, masses, tip, base=(x, 0.0)) for x in (-0.03, 0.03)]
        >>> disc = jxr.FreeObject.uniform(jxr.Circle(0.02), density=20.0)
        >>> grasp = jxr.Grasp(disc, fingers, [jxr.Contact(finger=0), jxr.Contact(finger=1)])
        >>> found = jxr.reach(grasp, [(-0.02, 0.0), (0.02, 0.0)], pose=(0.0, 0.08, 0.0))
        >>> found.result, found.gap < 1e-12
        (successful, True)
    """
    _check(grasp, guess, hold_object)
    positions = _object_at(grasp, pose, guess)
    held = held_velocities(grasp, hold)
    if held and guess is None:
        raise ValueError(f"argument guess must be a state where joints are held, but hold was {shown(hold)}")
    ready = tabled_grasp(grasp)
    faces = [sheet_of(shape) for shape in ready.object.shapes]
    solid = solid_of(faces, _extent(grasp))
    at = _places_on(grasp, faces, solid, contacts)
    targets = _targets(ready, faces, at, positions)
    elbows = _elbows(elbow, len(grasp.fingers))
    chosen = []
    for i in range(len(grasp.fingers)):
        own = [j for j, contact in enumerate(grasp.contacts) if contact.finger == i]
        wish = _Wish(elbows[i], _joints(grasp, guess, i), _limits(grasp.fingers[i]))
        reacher = _reacher(ready, i, held)
        mine = Targets(targets.points[own], targets.normals[own])
        chosen.append(_chosen(reacher, mine, wish, (solid, *poses_at(ready.object, positions[None]))))
    found = _assembled(grasp, positions, chosen, at)
    if hold_object or found.result == RESULTS.successful:
        return found
    return _let_go(found, held)


def _check(grasp: Grasp, guess: State | None, hold_object: bool) -> None:
    check_flag("hold_object", hold_object)
    check_instance("grasp", grasp, Grasp, "a Grasp")
    if traced((grasp, guess)):
        raise ValueError("argument grasp must be known before tracing, but was traced")
    (check_spatial if grasp.spatial else check_planar)(grasp)
    if guess is not None:
        check_states(grasp, guess, "guess")


def _object_at(grasp: Grasp, pose: Given | None, guess: State | None) -> np.ndarray:
    """Positions of the object, a quaternion at unit length."""
    count = grasp.form.positions[0]
    if pose is None:
        rest = np.zeros(count)
        if grasp.spatial and count == 7:
            rest[3] = 1.0
        return rest if guess is None else np.array(guess.q, float)[:count]
    given = np.array(as_floats("pose", pose, (count,)), float)
    if grasp.spatial and count == 7:
        size = np.linalg.norm(given[3:])
        if not size > 0:
            raise ValueError(f"argument pose must end with a quaternion, but was {shown(given)}")
        given[3:] /= size
    return given


def _extent(grasp: Grasp) -> float:
    """Half the diagonal of an object's outline; without one, a hand's order of magnitude [m]."""
    outline = getattr(grasp.object, "outline", None)
    return _EXTENT if outline is None else 0.5 * float(np.linalg.norm(np.asarray(outline)))


def _elbows(elbow: Any, count: int) -> list[int]:
    each = (
        [0] * count if elbow is None else list(elbow) if isinstance(elbow, list | tuple) else [elbow] * count
    )
    if len(each) != count or not all(type(x) is int and x in (-1, 0, 1) for x in each):
        raise ValueError(
            f"argument elbow must be 1, -1 or 0, once or for each finger, but was {shown(elbow)}"
        )
    return each


def _limits(finger: Any) -> np.ndarray | None:
    limits = getattr(finger, "limits", None)
    return None if limits is None else np.asarray(limits, float)


def _joints(grasp: Grasp, guess: State | None, finger: int) -> np.ndarray | None:
    """The guessed joints of a finger."""
    if guess is None:
        return None
    ends = np.cumsum(grasp.form.positions)
    return np.array(guess.q, float)[ends[finger] : ends[finger + 1]]


def _reacher(grasp: Grasp, i: int, held: tuple[int, ...]) -> Reacher:
    """A finger ready for searches, with its free joints and its length."""
    finger = grasp.fingers[i]
    first = int(np.cumsum([0, *grasp.sizes])[i + 1])
    free = np.array([first + j not in held for j in range(finger.joints)], bool)
    tip = sheet_of(finger.tip)
    extent = float(np.abs(tip.frames(tip.sampled(64, _LENGTH)).points).max())
    return Reacher(finger, tip, free, float(finger.size) * max(1, finger.joints) + extent)


def _places_on(grasp: Grasp, faces: list[Sheet], solid: Solid, contacts: Given) -> list[np.ndarray]:
    """Places on the touched faces, a row of coordinates for each contact."""
    given = np.asarray(check_finite("contacts", as_array("contacts", contacts)), float)
    count, axes = len(grasp.contacts), 3 if grasp.spatial else 2
    touched = [faces[contact.touched] for contact in grasp.contacts]
    if given.shape == (count, axes):
        return [
            _foot(solid, contact.touched, point) for contact, point in zip(grasp.contacts, given, strict=True)
        ]
    rows = given.reshape(count, -1) if given.ndim and len(given) == count else np.zeros((0, 0))
    if given.ndim > 2 or not all(len(rows) and rows.shape[1] == face.coordinates for face in touched):
        raise ValueError(
            f"argument contacts must have shape ({count}, {axes}), or be a place for each contact, but had "
            f"shape {given.shape}"
        )
    return list(rows)


def _foot(solid: Solid, which: int, point: np.ndarray) -> np.ndarray:
    """The place of a face nearest to a point, which must be near it."""
    face, samples = solid.faces[which], solid.points[which]
    nearest = solid.places[which][np.argmin(np.linalg.norm(samples - point, axis=1))]
    at = face.feet(point[None], nearest[None], 24)
    away = float(np.linalg.norm(face.frames(at).points[0] - point))
    size = max(float(np.ptp(np.concatenate(solid.points), axis=0).max()), float(np.abs(point).max()))
    if not away <= _NEAR * size:
        raise ValueError(
            f"argument contacts must be points of the object, but {shown(point)} is {away:.3g} m from "
            f"face {which}"
        )
    return at[0]


def _targets(grasp: Grasp, faces: list[Sheet], at: list[np.ndarray], positions: np.ndarray) -> Targets:
    """Points and outward normals of the places in the world."""
    here = [faces[c.touched].frames(place[None]) for c, place in zip(grasp.contacts, at, strict=True)]
    origin, turn = (x[0] for x in poses_at(grasp.object, positions[None]))
    points, normals = (np.concatenate([getattr(x, name) for x in here]) for name in ("points", "normals"))
    return Targets(origin + points @ turn.T, normals @ turn.T)


def _chosen(
    reacher: Reacher, targets: Targets, wish: _Wish, object_: tuple[Solid, np.ndarray, np.ndarray]
) -> _Choice:
    """The best posture of one finger that touches its targets."""
    starts = _starts(reacher, targets, wish)
    found = searched_postures(reacher, targets, starts)
    good = touching(reacher, found)
    if not len(good.q) and not len(targets.points):
        good = found.taken([0])
    if not len(good.q):
        nearest = found.taken([int(np.argmin(found.gaps / reacher.length + found.tilts))])
        return _Choice(nearest, "unreachable", _too_far(reacher, targets, nearest), 0.0, np.inf, 0)
    fair = good.taken(_within(reacher, good, wish.limits))
    if not len(fair.q) and wish.limits is not None:
        fair = touching_within(reacher, targets, starts, wish.limits)
    if not len(fair.q):
        return _Choice(good.taken([0]), "joint_limit", _beyond(good, wish.limits), 0.0, np.inf, len(good.q))
    sided = fair.taken(wish.elbow * fair.q[:, -1:].sum(axis=1) >= 0.0)
    if not len(sided.q):
        reason = f"only postures whose last joint has the other sign than elbow={wish.elbow} touch"
        return _Choice(fair.taken([0]), "unreachable", reason, 0.0, np.inf, len(good.q))
    overlaps, links = _clearances(reacher, sided, object_)
    # First whether it overlaps, then how near it is to the guess or how far its links stay away.
    if wish.guess is None:
        cost = -np.minimum(links, reacher.length)
    else:
        scale = 2.0 * np.pi if reacher.finger.turns else _LENGTH
        cost = np.linalg.norm((sided.q - wish.guess) / scale, axis=1)
    best = np.lexsort((cost, overlaps > _TOLERANCE))[0]
    one, overlap = sided.taken([int(best)]), float(overlaps[best])
    code = "penetration" if overlap > _TOLERANCE else "successful"
    reason = (
        f"its tip overlaps the object by {overlap:.3g} m in every posture" if overlap > _TOLERANCE else ""
    )
    return _Choice(one, code, reason, overlap, float(links[best]), len(good.q))


def touching_within(reacher: Reacher, targets: Targets, starts: np.ndarray, limits: np.ndarray) -> Postures:
    """Postures that touch, from searches that stay within joint limits: of fingers with joints to spare."""
    found = searched_postures(reacher, targets, np.clip(starts, *limits.T), limits)
    good = touching(reacher, found)
    return good.taken(_within(reacher, good, limits))


def _starts(reacher: Reacher, targets: Targets, wish: _Wish) -> np.ndarray:
    """Joints that searches start from: the guess and around it, then spread over the limits or a turn."""
    rng, k = np.random.default_rng(0), reacher.finger.joints
    low, high = np.full(k, -np.pi), np.full(k, np.pi)
    if not reacher.finger.turns:
        far = float(np.abs(targets.points).max(initial=_LENGTH)) + reacher.length
        low, high = np.full(k, -far), np.full(k, far)
    if wish.limits is not None:
        low, high = np.maximum(low, wish.limits[:, 0]), np.minimum(high, wish.limits[:, 1])
        high = np.maximum(low, high)
    starts = rng.uniform(low, high, (_STARTS, k))
    if wish.guess is not None:
        near = wish.guess + 0.2 * (high - low) * rng.normal(size=(_STARTS // 4, k))
        starts[: len(near)] = near
        starts[0] = wish.guess
        starts = np.where(reacher.free, starts, wish.guess)
    return starts


def _within(reacher: Reacher, found: Postures, limits: np.ndarray | None) -> np.ndarray:
    """Which postures keep the limits of the joints."""
    if limits is None:
        return np.ones(len(found.q), bool)
    slack = 1e-12 * (1.0 + np.abs(limits))
    return ((found.q >= limits[:, 0] - slack[:, 0]) & (found.q <= limits[:, 1] + slack[:, 1])).all(axis=1)


def _too_far(reacher: Reacher, targets: Targets, nearest: Postures) -> str:
    """Why no posture touches, in numbers."""
    base = getattr(reacher.finger, "base", None)
    if base is not None:
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
    reacher: Reacher, found: Postures, object_: tuple[Solid, np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """How deep the tip overlaps the object, and how far the links stay from it, at each posture [m]."""
    solid, origins, turns = object_
    at = reacher.tip.sampled(_TIP[reacher.tip.spatial], _LENGTH)
    local = reacher.tip.frames(at).points
    tips, ways = poses_at(reacher.finger, found.q)
    joints = _skeletons(reacher.finger, found.q)
    overlaps, links = [], []
    for tip, way, chain in zip(tips, ways, joints, strict=True):
        points = (tip + local @ way.T - origins[0]) @ turns[0]
        overlaps.append(max(0.0, -float(heights(solid, points).min())))
        share = np.linspace(0.0, 1.0, _LINK, endpoint=False)[None, :, None]
        along = (chain[:-1, None] * (1.0 - share) + chain[1:, None] * share).reshape(-1, chain.shape[1])
        along = np.concatenate([along, chain[-1:]])
        links.append(float(heights(solid, (along - origins[0]) @ turns[0]).min()))
    return np.array(overlaps), np.array(links)


def _skeletons(finger: Any, q: np.ndarray) -> np.ndarray:
    """Joints and tip frames of postures, shape (n, points, d)."""
    padded = np.resize(q, (_STARTS * max(1, -(-len(q) // _STARTS)), q.shape[1]))
    return np.asarray(_chains(finger, jnp.asarray(padded)))[: len(q)]


@quickly
def _chains(finger: Any, q: Array) -> Array:
    ready = finger.prepared()
    return jax.vmap(lambda row: jnp.stack([point.array() for point in ready.skeleton(unstack(row))]))(q)


def _assembled(grasp: Grasp, positions: np.ndarray, chosen: list[_Choice], at: list[np.ndarray]) -> Reach:
    """The postures of all fingers as a state, with the worst of their codes."""
    q = np.concatenate([positions, *(one.posture.q[0] for one in chosen)])
    rest = [list(one.posture.places[0]) for one in chosen]
    tips = [rest[contact.finger].pop(0) for contact in grasp.contacts]
    if grasp.spatial:
        s = np.concatenate([x for pair in zip(tips, at, strict=True) for x in pair])
        new = grasp
    else:
        s = np.zeros(len(at))
        fields = lambda g: [x for c in g.contacts for x in (c.s_tip, c.s_object)]  # noqa: E731
        values = [jnp.asarray(x[0]) for pair in zip(tips, at, strict=True) for x in pair]
        new = eqx.tree_at(fields, grasp, values)
    state = State(jnp.asarray(q), jnp.zeros(grasp.coordinates), jnp.asarray(s))
    worst = next((i for i, one in enumerate(chosen) if one.code != "successful"), None)
    reason = "" if worst is None else f"finger {worst}: {chosen[worst].reason}"
    return Reach(
        new,
        state,
        RESULTS.successful if worst is None else getattr(RESULTS, chosen[worst].code),
        reason,
        max(float(one.posture.gaps[0]) for one in chosen),
        max(float(one.posture.tilts[0]) for one in chosen),
        max(one.overlap for one in chosen),
        min(one.links for one in chosen),
        tuple(one.count for one in chosen),
    )


def _let_go(found: Reach, held: tuple[int, ...]) -> Reach:
    """The start that `close` makes of the nearest postures, the object and the contacts free to move."""
    grasp, state = close(found.grasp, found.state, hold_contacts=False, throw=False)
    left = residuals(grasp, state)
    gap = max(float(jnp.max(jnp.abs(part))) for part in (left.normal, left.tangential))
    tilt = float(jnp.max(jnp.abs(left.tangency)))
    if not max(gap, tilt) <= _CLOSED:
        return found
    return Reach(grasp, state, RESULTS.successful, "", gap, tilt, found.overlap, found.links, found.postures)
