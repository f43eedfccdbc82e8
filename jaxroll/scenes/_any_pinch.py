r"""Any object between two fingers: points to hold it by, a posture that touches them, and the blind control.

`grasp_points` says where little friction is needed, `reach` how the fingers get there. Unless fingers are
given, they are the chapter's, enlarged with the object: lengths by k, masses by $k^3$; their tips are round,
since a flat pad finds no single place to touch in a hollow. The control is
(16)-(17) with gains that follow from the force asked for:

$$ \beta = f / |r_1 - r_2|, \qquad c_i = 2 \zeta L_i \sqrt{\beta J_i}, \qquad J_i = \tfrac13 m_i L_i^2, $$

where $L_i$ and $m_i$ are a finger's length and mass, and $\zeta$ is that of the chapter's own numbers.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import Pose3, seven, unstack, Vec3
from .._mechanics import Finger, Finger3, FreeObject, FreeObject3, Grasp, State
from .._reaching import (
    Frames,
    grasp_points,
    GraspPoints,
    placed_at,
    poses_at,
    Reach,
    reach,
    sheet_of,
    tip_origins,
)
from .._results import as_positive, on_host, RESULTS, shown
from .._types import Given
from .._xla import quickly
from ..contact import Contact, Contact3
from ..control import Opposition, orientations
from ..geometry import Circle, Sphere
from ._pinch_targets import FailedTargets, out_of_reach, SAME
from ._plane_scenes import BASES, LINK_MASSES, LINKS
from ._space_scenes import AXES3, LINKS3, MASSES3, SPAN3

# Width of the chapter's objects, for which its fingers are made, and how far from the bases objects of that
# width are held, first where the chapter holds them [m].
_WIDTH = 0.03
_AHEAD = (0.115, 0.100, 0.130, 0.085)
# Damping of the fingers' opening and closing, as a share of the critical one.
_ZETA = 0.235
# Force of a pinch, as a multiple of the object's weight, and the acceleration of gravity [m/s^2].
_WEIGHTS, _GRAVITY = 3.0, 9.81
# alpha of (16), which keeps orientations, as a share of the moment of the force at a finger's length.
_ALPHA = 0.008
# Pairs of points that are looked at, and the weight of their width against friction and arm.
_PAIRS, _NARROW = 24, 0.3
# By what share of the distance of O_i from the contact the radius of the round tips is larger than it.
_BLUNT = 0.5
# Fingers of one's own: postures that are looked at, and object poses that are tried for each pair of points.
_POSTURES, _TRIED = 4000, 6
# Starts that are searched for, in the plane and in space; one takes some tenths of a second. Pairs of points
# take turns, each with so many poses.
_MOST, _TURN = (30, 40), 8
# Steps by which two tips are put as far apart as an object is wide, and how near they come, relatively.
_STEPS, _NEAR = 30, 1e-14


@on_host
def pinch_object(
    object: FreeObject | FreeObject3,
    *,
    fingers: Sequence[Finger] | Sequence[Finger3] | None = None,
    friction: Given = 0.8,
    force: Given | None = None,
    gravity: Given | None = None,
) -> tuple[Grasp, State]:
    r"""Two fingers pinch an object of any shape, in the plane or in space, where that needs little friction.

    Of the pairs that `grasp_points` finds, those come first that need little friction, are narrow, and whose
    line passes near the centre of mass; of each several poses of the object are tried, until both fingers
    reach it without overlap: 30 in the plane and 40 in space at most. The control is (16)-(17), "blind".

    Args:
        object: A `FreeObject` or a `FreeObject3` of any smooth shape.
        fingers: Two or more fingers of one's own, such as those of `io.load_hand`, of which two are taken;
            the object is put where they reach it. Default: the chapter's, enlarged by the width of the
            object over 30 mm.
        friction: Coefficient of friction of both contacts: pairs of points that need more are not tried, and
            a run that needs more ends.
        force: With which the fingers press at the start, about [N]. Default: three times the object's
            weight.
        gravity: As for `Grasp`. Default: none.

    Returns:
        The grasp, and a state at rest with both contacts closed.

    Raises:
        ValueError: If an argument does not fit, no two points of the object are held with this friction, or
            the fingers reach none of them; the sentence says how many were tried, what hindered the last, and
            what may help.

    Example:
        >>> import jaxroll as jxr
        >>> egg = jxr.FreeObject.uniform(jxr.Ellipse(0.02, 0.03), density=20.0)
        >>> grasp, state = jxr.scenes.pinch_object(egg)
        >>> bool(abs(jxr.residuals(grasp, state).normal).max() < 1e-12)
        True
    """
    if not isinstance(object, FreeObject | FreeObject3):
        raise ValueError(f"argument object must be a FreeObject or a FreeObject3, but was {shown(object)}")
    spatial = isinstance(object, FreeObject3)
    press = None if force is None else float(as_positive("force", force))
    pairs = grasp_points(object, friction, count=_PAIRS)
    if not len(pairs):
        raise ValueError(
            "argument object must have two points that are held with the friction given, but none was found "
            f"with {float(np.asarray(friction)):.3g}"
        )
    hindered = "their tips are never about as far apart as it is wide"
    tips = None if fingers is None else _tips_of(fingers)
    tries, failed = 0, FailedTargets()
    for row, (hand, pose, order) in _in_turn(object, tips, pairs):
        points, faces = pairs.points[row][list(order)], pairs.faces[row]
        if fingers is not None and (far := out_of_reach(hand, points, pose)):
            hindered = far
            continue
        if failed.before(hand, points, pairs.normals[row][list(order)], pose):
            continue
        if tries == _MOST[spatial]:
            break
        tries += 1
        kind = Contact3 if spatial else _planar_contact
        contacts = [kind(i, int(faces[end]), friction=friction) for i, end in enumerate(order)]
        found = reach(Grasp(object, hand, contacts, gravity=gravity), points, pose=pose)
        if found.result == RESULTS.successful:
            blunt = _blunted(found, points, pose) if fingers is None else found
            return _controlled(blunt.grasp, blunt.state, press)
        if found.result in (RESULTS.unreachable, RESULTS.joint_limit):
            failed.add(hand, points, pairs.normals[row][list(order)], pose)
        hindered = found.reason
    tried = f"in {tries} {'try' if tries == 1 else 'tries'}; at the last" if tries else "and none was tried:"
    raise ValueError(
        f"argument fingers must reach the object, but did not {tried} {hindered}; {_helps(tips, spatial)} "
        "may help"
    )


def _helps(tips: "list[_Tips] | None", spatial: bool) -> str:
    """What may help where no start is found."""
    few = [one for one in tips or () if one.finger.joints < 2 + spatial]
    if any(one.ball is None for one in few):
        return f"round tips, or {2 + spatial} joints for each finger,"
    own = "an object of another size or shape"
    return own if tips is None else f"longer fingers, wider ranges of joints, smaller tips, or {own}"


def _ranked(pairs: GraspPoints) -> np.ndarray:
    """Numbers of the pairs: first those of little friction demand, near the centre of mass, and narrow.

    Where the width is stationary a grasp is stable if it is least there: fingers that draw each other
    together are then moved apart wherever they roll.
    """
    along = (pairs.points[:, 1] - pairs.points[:, 0]) / pairs.distance[:, None]
    middle = pairs.points.mean(axis=1)
    aside = middle - np.sum(middle * along, axis=1)[:, None] * along
    size = float(np.ptp(pairs.points.reshape(-1, middle.shape[1]), axis=0).max())
    narrow = _NARROW * pairs.distance / pairs.distance.max()
    worth = pairs.demand + np.linalg.norm(aside, axis=1) / size + narrow
    # Of pairs that are as good to rounding the first stays first.
    return np.argsort(np.round(worth, 9), kind="stable")


def _planar_contact(finger: int, contour: int, friction: Given) -> Contact:
    # The chapter's s_i runs along the object's contour on the left and against it on the right.
    return Contact(finger=finger, contour=contour, sense=(1, -1)[finger], friction=friction)


def _in_turn(
    object: FreeObject | FreeObject3, tips: "list[_Tips] | None", pairs: GraspPoints
) -> Iterator[tuple[int, tuple[list[Any], np.ndarray, tuple[int, int]]]]:
    """What is to be tried, with the number of the pair of points: some of each pair, then more of each."""
    waiting = []
    for row in _ranked(pairs):
        waiting.append((int(row), _placed(object, tips, pairs, int(row))))
    while waiting:
        left = []
        for row, poses in waiting:
            some = list(itertools.islice(poses, _TURN))
            yield from ((row, one) for one in some)
            left += [(row, poses)] if len(some) == _TURN else []
        waiting = left


def _placed(
    object: FreeObject | FreeObject3, tips: "list[_Tips] | None", pairs: GraspPoints, row: int
) -> Iterator[tuple[list[Any], np.ndarray, tuple[int, int]]]:
    """Two fingers, a pose of the object, and which of its points each is to touch, to be tried in turn."""
    points, normals, width = pairs.points[row], pairs.normals[row], float(pairs.distance[row])
    spatial = isinstance(object, FreeObject3)
    if tips is None:
        k = width / _WIDTH
        hand = _chapter_hand3(k) if spatial else _chapter_hand(k)
        middles = [np.array([0.0 if spatial else 0.0275, ahead]) * k for ahead in _AHEAD]
        lines = [(np.append(m, 0.0) if spatial else m, np.eye(3 if spatial else 2)[0]) for m in middles]
        choices = [(hand, line, None) for line in lines]
    else:
        choices = _lines_between(tips, width)
    for hand, line, held in choices:
        for order in ((0, 1), (1, 0)):
            ends = points[list(order)]
            if held is not None:
                # From centre to centre of the tips instead, which are to be as far apart as is wanted.
                ends = ends + np.array(held.radii)[:, None] * normals[list(order)]
                line = _apart(held, float(np.linalg.norm(ends[1] - ends[0])))
            if line is None:
                continue
            middle, along = line
            for turn in _turns(object, ends[1] - ends[0], along):
                origin = middle - turn @ ends.mean(axis=0)
                yield hand, np.concatenate([origin, _as_positions(turn)]), order


def _chapter_hand(k: float) -> list[Finger]:
    """Part 1's fingers, k times as long, with round tips."""
    return [
        Finger(
            [k * length for length in lengths],
            [k**3 * mass for mass in masses],
            Circle(0.01 * k),
            base=(k * base[0], k * base[1]),
        )
        for lengths, masses, base in zip(LINKS, LINK_MASSES, BASES, strict=True)
    ]


def _chapter_hand3(k: float) -> list[Finger3]:
    """Part 3's fingers, k times as long."""
    links, masses = k * np.array(LINKS3), k**3 * np.array(MASSES3)
    return [
        Finger3(AXES3, links, masses, Sphere(0.01 * k), base=(side * k * SPAN3, 0.0, 0.0))
        for side in (-1.0, 1.0)
    ]


def _blunted(found: Reach, points: np.ndarray, pose: np.ndarray) -> Reach:
    """The same posture with larger round tips that touch at the same points, where these overlap nothing.

    Of a round tip about $O_i$ (41) says that it is neither stable nor unstable. One that is half as large
    again, with $O_i$ between its centre and the contact, is stable.
    """
    grasp, state = found.grasp, found.state
    tips = []
    for i, finger in enumerate(grasp.fingers):
        radius = finger.tip.radius
        at = state.s[6 * i : 6 * i + 3] if grasp.spatial else grasp.contacts[i].s_tip
        larger = type(finger.tip)((1.0 + _BLUNT) * radius)
        tips.append(larger.moved(-_BLUNT * radius * finger.tip.normal(at)))
    for i, tip in enumerate(tips):
        grasp = grasp.with_tip(i, tip)
    blunt = reach(grasp, points, pose=pose, guess=state)
    return blunt if blunt.result == RESULTS.successful else found


class _Tips(NamedTuple):
    """Where a finger's tip is in random postures: its middle, shape (n, d), and its radius [m].

    `q` are the postures; `ball` is the centre in the tip's frame and the radius of a tip that is round.
    """

    finger: Any
    middles: np.ndarray
    radius: float
    q: np.ndarray
    ball: tuple[np.ndarray, float] | None


class _Held(NamedTuple):
    """Two fingers with few joints and round tips, and their joints in a posture."""

    fingers: tuple[Any, Any]
    q: tuple[np.ndarray, np.ndarray]
    centres: tuple[np.ndarray, np.ndarray]  # of the tips, in their frames
    radii: tuple[float, float]


def _tips_of(fingers: Any) -> list[_Tips]:
    """The tips of fingers of one's own, which are checked."""
    several = isinstance(fingers, list | tuple) and len(fingers) >= 2
    if not several or not all(isinstance(finger, Finger | Finger3) for finger in fingers):
        raise ValueError(f"argument fingers must be two fingers or more, but was {shown(fingers)}")
    draw = np.random.default_rng(0)
    return [_tips(finger, draw) for finger in fingers]


def _lines_between(
    tips: list[_Tips], width: float
) -> Iterator[tuple[list[Any], tuple[np.ndarray, np.ndarray], _Held | None]]:
    """Pairs of fingers, and lines on which both hold something between them: its middle and direction.

    Random postures of both are compared: the middles of their tips should be as far apart as the object is
    wide, and the tips' radii more. Postures in which that distance is wrong by as much as itself are not
    tried. The tip of a finger with fewer joints than there are axes stays on a line or a surface, so that no
    posture near a random one need fit: both tips are then put in place exactly (`_apart`).
    """
    found = []
    for one, other in itertools.combinations(tips, 2):
        apart = other.middles - one.middles
        distance = np.linalg.norm(apart, axis=1)
        wanted = width + one.radius + other.radius
        out = np.abs(distance - wanted)
        for k in np.argsort(out)[:_TRIED]:
            if out[k] < wanted:
                line = 0.5 * (one.middles[k] + other.middles[k]), apart[k] / distance[k]
                few = min(one.finger.joints, other.finger.joints) < apart.shape[1]
                held = _held(one, other, k) if few else None
                found.append((out[k], [one.finger, other.finger], line, held))
    for _, *line in sorted(found, key=lambda each: each[0])[: 2 * _TRIED]:
        yield tuple(line)


def _held(one: _Tips, other: _Tips, k: int) -> _Held | None:
    """Two fingers in one of their postures; None where a tip is not round."""
    if one.ball is None or other.ball is None:
        return None
    fingers, q = (one.finger, other.finger), (one.q[k], other.q[k])
    return _Held(fingers, q, (one.ball[0], other.ball[0]), (one.ball[1], other.ball[1]))


def _apart(held: _Held, wanted: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Middle and direction of the line between the centres of two round tips that are `wanted` apart [m].

    From a posture the shortest steps are taken that lead there; None where the ranges of joints forbid it.
    """
    q = [x.copy() for x in held.q]
    for _ in range(_STEPS):
        centres, slopes = zip(*map(_centre, held.fingers, q, held.centres), strict=True)
        arm = centres[1] - centres[0]
        distance = float(np.linalg.norm(arm))
        off = distance - wanted
        along = arm / distance
        if abs(off) < _NEAR * (wanted + float(np.abs(centres).max())):
            return 0.5 * (centres[0] + centres[1]), along
        rates = [-along @ slopes[0], along @ slopes[1]]
        square = sum(float(rate @ rate) for rate in rates)
        if not square > 0.0:
            return None
        for finger, x, rate in zip(held.fingers, q, rates, strict=True):
            x -= off / square * rate
            np.clip(x, *_ranges(finger), out=x)
    return None


def _centre(finger: Any, q: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A point of a tip's frame in the world, shape (d,), and its derivatives by the joints, shape (d, k)."""
    origin, turn, origin_rate, turn_rate = (x[0] for x in placed_at(finger, q[None]))
    return origin + turn @ middle, origin_rate + np.einsum("ijq,j->iq", turn_rate, middle)


def _tips(finger: Any, draw: np.random.Generator) -> _Tips:
    """A finger's tip in random postures."""
    q = draw.uniform(*_ranges(finger), (_POSTURES, finger.joints))
    origins, turns = poses_at(finger, q)
    tip = sheet_of(finger.tip)
    here = tip.frames(tip.sampled(256, 0.05))
    points = here.points
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = 0.5 * float(np.ptp(points, axis=0).min())
    return _Tips(finger, origins + turns @ middle, radius, q, _ball(here))


def _ranges(finger: Any) -> tuple[Any, Any]:
    """Least and largest angles of a finger's joints that are looked at."""
    limits = getattr(finger, "limits", None)
    if limits is None:
        return -np.pi / 2, np.pi / 2
    low, high = np.asarray(limits, float).clip(-np.pi, np.pi).T
    return low, high


def _ball(here: Frames) -> tuple[np.ndarray, float] | None:
    """Centre and radius of a tip that is round; None for any other."""
    bend = float(here.bends[:, 0, 0].mean())
    if not bend > 0.0:
        return None
    centres = here.points - here.normals / bend
    return (centres.mean(axis=0), 1.0 / bend) if np.ptp(centres, axis=0).max() < SAME / bend else None


def _turns(object: Any, across: np.ndarray, along: np.ndarray) -> list[np.ndarray]:
    """Rotations that turn a direction of the object along one of the world, to be tried in turn."""
    across, along = across / np.linalg.norm(across), along / np.linalg.norm(along)
    if len(across) == 2:
        cosine, sine = across @ along, across[0] * along[1] - across[1] * along[0]
        return [np.array([[cosine, -sine], [sine, cosine]])]
    # The object's longest extent, about which its inertia is least, goes across the fingers' plane first.
    inertia = np.asarray(object.inertia, float)
    long = np.linalg.eigh(np.diag(inertia) if inertia.ndim == 1 else inertia)[1][:, 0]
    own, world = _frame(across, long), _frame(along, np.array([0.0, 0.0, 1.0]))
    quarters = [np.pi * k / 2 for k in range(4)]
    about = [np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]]) for a in quarters]
    return [world @ turn @ own.T for turn in about]


def _frame(first: np.ndarray, near: np.ndarray) -> np.ndarray:
    """A right-handed frame as columns: the first axis, and a third one as near as may be to a direction."""
    third = near - (near @ first) * first
    if np.linalg.norm(third) < 1e-6:
        third = np.roll(first, 1) - (np.roll(first, 1) @ first) * first
    third = third / np.linalg.norm(third)
    return np.stack([first, np.cross(third, first), third], axis=1)


def _as_positions(turn: np.ndarray) -> np.ndarray:
    """A rotation as an angle, or as a quaternion."""
    if len(turn) == 2:
        return np.array([np.arctan2(turn[1, 0], turn[0, 0])])
    return np.asarray(_quaternion(jnp.asarray(turn)))


@quickly  # as one program: each of its small operations by itself would be compiled too
def _quaternion(turn: Array) -> Array:
    axes = (Vec3(*column) for column in zip(*map(unstack, unstack(turn)), strict=True))
    return seven(Pose3(Vec3(0.0, 0.0, 0.0), *axes))[3:]


def _controlled(grasp: Grasp, state: State, force: float | None) -> tuple[Grasp, State]:
    """The grasp under (16)-(17), with gains for a force."""
    weight = _GRAVITY * float(grasp.object.mass)
    press = _WEIGHTS * weight if force is None else force
    first, second = tip_origins(grasp, np.asarray(state.q))
    beta = press / float(np.linalg.norm(second - first))
    damping = [_damping(finger, beta) for finger in grasp.fingers]
    alpha = 0.0 if grasp.spatial else _ALPHA * press * _length(grasp.fingers[0])
    start = jnp.zeros(2) if grasp.spatial else orientations(grasp, state)
    control = Opposition(beta, damping, alpha, start=start)
    return Grasp(
        grasp.object, grasp.fingers, grasp.contacts, controller=control, gravity=grasp.gravity
    ), state


def _damping(finger: Any, beta: float) -> float:
    """Damping of a finger's joints [N m s] under the control's pull."""
    length = _length(finger)
    inertia = float(np.sum(np.asarray(finger.masses))) * length**2 / 3.0
    return 2.0 * _ZETA * length * np.sqrt(beta * inertia)


def _length(finger: Any) -> float:
    return finger.joints * float(finger.size)
