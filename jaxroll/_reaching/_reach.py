r"""`reach`: joint angles at which the fingertips touch given points of an object, as a closed start.

The object is held. Each finger is searched for all of its postures that touch what its contacts are to touch
(`_postures`); of these one is taken (`_choice`) that keeps joint limits and elbow sides, overlaps the object
nowhere (`_overlap`), and is nearest to the guess, or else keeps its links farthest from the object. Where
fingers have too few joints, the object may be let go: then `close` moves it too, and the postures at which it
ends must keep the same limits.
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._closing import close, held_velocities
from .._mechanics import check_planar, check_spatial, check_states, Grasp, State, tabled_grasp
from .._motion import residuals
from .._printing import listed
from .._results import (
    as_array,
    as_floats,
    as_length,
    check_finite,
    check_flag,
    check_instance,
    on_host,
    RESULTS,
    shown,
)
from .._types import ByPrecision, Given, Scalars
from .._xla import quickly
from ..geometry import AbstractSurface
from ._choice import Choice, chosen_posture, judged_posture, Wish
from ._overlap import sampled_object, SampledObject
from ._postures import poses_at, Reacher, TouchPoints
from ._sheet import Sheet, sheet_of

# A point given counts as one of the object if it is off by no more than this share of the object's size, and
# so many roundings of its coordinates.
_NEAR, _ROUNDINGS = 0.01, 64
# A place not farther than this past an end of its face is at the end [m].
_AT_END = 1e-9
# Samples of a fingertip, in the plane and in space.
_TIP = (384, 720)
# Extent of an object whose faces have no bounds, and of a tip [m].
_EXTENT, _LENGTH = 0.1, 0.05
# Contacts count as closed, of postures and of what `close` found [m or rad].
_CLOSED = ByPrecision(1e-12, 1e-6)


class Reach(eqx.Module):
    """A start from `reach`, or why there is none.

    Attributes:
        grasp: The grasp; in the plane its contacts have the arclengths that touch.
        state: At rest, the contacts closed if `result` is `successful`; else as near as was found.
        result: Code of `jaxroll.RESULTS`: `successful`; `unreachable` where a finger does not get there, or
            only with its elbow on the other side; `joint_limit`, `penetration`, `links_meet`.
        reason: Why, in a sentence with numbers; empty where it is a success.
        gap: Largest distance of two contact points [m].
        tilt: Largest length of a sum of two outward normals.
        overlap: How deep fingertips and object overlap away from their contacts [m].
        links: Least distance of the fingers' links from the object, of 16 points of each line from joint to
            joint [m]; negative inside.
        postures: How many postures of each finger touch, limits and elbows aside.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"gap": "m", "overlap": "m", "links": "m"}

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


@on_host
def reach(
    grasp: Grasp,
    contacts: Given,
    *,
    pose: Given | None = None,
    guess: State | None = None,
    hold: str | Sequence[str] = (),
    elbow: int | Sequence[int] | None = None,
    hold_object: bool = True,
    link_radius: Given | None = None,
) -> Reach:
    r"""Find a closed start in which the fingertips touch an object where they are asked to.

    Args:
        grasp: The grasp; each contact says which finger touches which contour or surface; its arclengths are
            replaced by those found.
        contacts: Where each contact is to be on the object: points in its frame, shape (c, 2) or (c, 3) [m],
            such as a row of `grasp_points(...).points`; or arclengths (c,), or coordinates (c, 2) of charts.
        pose: Of the object: its positions as in a state, $(x, y, \theta)$, or position and quaternion, or the
            angle of a pivoted one. Default: that of `guess`, or the world's axes.
        guess: A state with joints to stay near; `hold` takes its joints from there. Default: none; then links
            stay as far from the object as they can.
        hold: Joints that keep the values of `guess`, by name: 'finger 0', 'finger 1 q[0]'.
        elbow: Sign of the last joint's angle, 1 or -1, or 0 for either; one for all fingers, or one for each.
            Default: either.
        hold_object: If False, and a finger does not get there, `close` may move the object and roll the
            contacts; limits, elbows and links are then looked at where that ends.
        link_radius: Of the links, as capsules from joint to joint [m]: postures in which they meet the object
            are not taken. Default: the finger's own `link_radius`; where it has none, links may pass through
            the object, and `links` of the result says whether they do.

    Returns:
        A `Reach`: `simulate(*found.start, t1)` runs it where `found.result` is `successful`.

    Raises:
        ValueError: If an argument does not fit, a point is off the object by more than a hundredth of its
            size, a place is past an end of its face, or contacts are of one's own class.

    Accuracy: gaps below 1e-12 m, in single precision below 1e-6 m. Searches go on from 64 starts; a posture
    may be missed whose joints are nearly stretched. Overlap is that of samples, 384 of a contour and 720 of a
    surface.

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
    faces = [sheet_of(shape) for shape in grasp.object.shapes]
    solid = sampled_object(faces, _extent(grasp))
    at = _places_on(grasp, faces, solid, contacts)
    targets = _targets(ready, faces, at, positions)
    elbows = _elbows(elbow, len(grasp.fingers))
    radius = None if link_radius is None else float(as_length("link_radius", link_radius))
    asked, chosen = [], []
    for i in range(len(grasp.fingers)):
        own = [j for j, contact in enumerate(grasp.contacts) if contact.finger == i]
        finger = grasp.fingers[i]
        wish = Wish(elbows[i], _joints(grasp, guess, i), _limits(finger), _radius(finger, radius))
        reacher = _reacher(ready, i, held)
        mine = TouchPoints(targets.points[own], targets.normals[own])
        asked.append((reacher, wish))
        chosen.append(chosen_posture(reacher, mine, wish, (solid, *poses_at(ready.object, positions[None]))))
    found = _assembled(grasp, positions, chosen, at)
    if hold_object or found.result != RESULTS.unreachable:
        return found
    free = _let_go(found, hold)
    return found if free is found else _judged(free, ready, solid, asked)


def _check(grasp: Grasp, guess: State | None, hold_object: bool) -> None:
    check_flag("hold_object", hold_object)
    check_instance("grasp", grasp, Grasp, "a Grasp")
    (check_spatial if grasp.spatial else check_planar)(grasp)
    if guess is not None:
        check_states(grasp, guess, "guess", unit=False)


def _object_at(grasp: Grasp, pose: Given | None, guess: State | None) -> np.ndarray:
    """Positions of the object, a quaternion at unit length."""
    count = grasp.form.positions[0]
    turns = grasp.spatial and count == 7
    if pose is guess is None:
        rest = np.zeros(count)
        if turns:
            rest[3] = 1.0
        return rest
    if pose is not None:
        told, positions = "pose must end with", np.array(as_floats("pose", pose, (count,)), float)
    else:
        assert guess is not None
        told, positions = "guess must have in q[3:7]", np.array(guess.q, float)[:count]
    if turns:
        size = np.linalg.norm(positions[3:])
        if not size > 0:
            raise ValueError(f"argument {told} a quaternion, but was {shown(positions)}")
        positions[3:] /= size
    return positions


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


def _radius(finger: Any, given: float | None) -> float:
    """Radius of a finger's links [m]; minus infinity where they may pass through the object."""
    own = getattr(finger, "link_radius", None)
    if given is not None:
        return given
    return -np.inf if own is None else float(own)


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
    places = tip.sampled(_TIP[tip.spatial], _LENGTH)
    samples = tip.frames(places)
    length = float(finger.size) * max(1, finger.joints) + float(np.linalg.norm(samples.points, axis=1).max())
    return Reacher(finger, tip, free, length, places, samples)


def _places_on(grasp: Grasp, faces: list[Sheet], solid: SampledObject, contacts: Given) -> list[np.ndarray]:
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
    for contact, face, row in zip(grasp.contacts, touched, rows, strict=True):
        _check_on(face, contact.touched, row)
    return list(rows)


def _check_on(face: Sheet, which: int, place: np.ndarray) -> None:
    """Raise for a place past an end of its face, where nothing is known of it."""
    if face.spatial:
        margins = _margins(face.shape, tuple(map(jnp.asarray, place)))
    else:
        ends = face.shape.domain()
        margins = () if ends is None or face.shape.closed else (place[0] - ends[0], ends[1] - place[0])
    past = -min((float(margin) for margin in margins), default=0.0)
    if past > _AT_END:
        raise ValueError(
            f"argument contacts must be places between the ends of faces, but {shown(place)} is {past:.3g} m "
            f"past one of face {which}"
        )


@quickly
def _margins(surface: AbstractSurface, at: Scalars) -> Scalars:
    return surface.margins(at)


def _foot(solid: SampledObject, which: int, point: np.ndarray) -> np.ndarray:
    """The place of a face nearest to a point, which must be near it."""
    face, samples = solid.faces[which], solid.points[which]
    nearest = solid.places[which][np.argmin(np.linalg.norm(samples - point, axis=1))]
    at = face.feet(point[None], nearest[None], 24)
    away = float(np.linalg.norm(face.frames(at).points[0] - point))
    size = float(np.ptp(np.concatenate(solid.points), axis=0).max())
    rounding = _ROUNDINGS * np.finfo(samples.dtype).eps * float(np.abs(point).max())
    if not away <= _NEAR * size + rounding:
        raise ValueError(
            f"argument contacts must be points of the object, but {shown(point)} is {away:.3g} m from "
            f"face {which}"
        )
    return at[0]


def _targets(grasp: Grasp, faces: list[Sheet], at: list[np.ndarray], positions: np.ndarray) -> TouchPoints:
    """Points and outward normals of the places in the world."""
    here = [faces[c.touched].frames(place[None]) for c, place in zip(grasp.contacts, at, strict=True)]
    origin, turn = (x[0] for x in poses_at(grasp.object, positions[None]))
    points, normals = (np.concatenate([getattr(x, name) for x in here]) for name in ("points", "normals"))
    return TouchPoints(origin + points @ turn.T, normals @ turn.T)


def _assembled(grasp: Grasp, positions: np.ndarray, chosen: list[Choice], at: list[np.ndarray]) -> Reach:
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
    state = State(jnp.asarray(q), np.zeros(grasp.coordinates), jnp.asarray(s))
    result, reason = _verdict(chosen)
    return Reach(
        new,
        state,
        result,
        reason,
        max(float(one.posture.gaps[0]) for one in chosen),
        max(float(one.posture.tilts[0]) for one in chosen),
        max(one.overlap for one in chosen),
        min(one.links for one in chosen),
        tuple(one.count for one in chosen),
    )


def _verdict(chosen: list[Choice]) -> tuple[RESULTS, str]:
    """The code of the first finger with which something is wrong, and the reason."""
    worst = next((i for i, one in enumerate(chosen) if one.code != "successful"), None)
    if worst is None:
        return RESULTS.successful, ""
    return getattr(RESULTS, chosen[worst].code), f"finger {worst}: {chosen[worst].reason}"


def _let_go(found: Reach, hold: str | Sequence[str]) -> Reach:
    """The start that `close` makes of the nearest postures, the object and the contacts free to move."""
    grasp, state = close(found.grasp, found.state, hold_contacts=False, throw=False, hold=hold)
    left = residuals(grasp, state)
    gap = max(float(jnp.max(jnp.abs(part))) for part in (left.normal, left.tangential))
    tilt = float(jnp.max(jnp.abs(left.tangency)))
    if not max(gap, tilt) <= _CLOSED.of(state):
        return found
    return Reach(grasp, state, RESULTS.successful, "", gap, tilt, found.overlap, found.links, found.postures)


def _judged(free: Reach, ready: Grasp, solid: SampledObject, asked: list[tuple[Reacher, Wish]]) -> Reach:
    """A closed start with what is wrong with its postures, and how far from the object they stay."""
    position, *joints = np.split(np.asarray(free.state.q), np.cumsum(ready.form.positions)[:-1])
    there = (solid, *poses_at(ready.object, position[None]))
    judged = [
        judged_posture(reacher, q, wish, there) for (reacher, wish), q in zip(asked, joints, strict=True)
    ]
    result, reason = _verdict(judged)
    overlap, links = max(one.overlap for one in judged), min(one.links for one in judged)
    return Reach(free.grasp, free.state, result, reason, free.gap, free.tilt, overlap, links, free.postures)
