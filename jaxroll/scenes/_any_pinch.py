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
from .._reaching import grasp_points, GraspPoints, poses_at, Reach, reach, sheet_of, tip_origins
from .._results import RESULTS, shown
from .._types import Given
from .._xla import quickly
from ..contact import Contact, Contact3
from ..control import Opposition, orientations
from ..geometry import Circle, Sphere
from ._plane_scenes import BASES, LINK_MASSES, LINKS
from ._scene_arguments import as_positive
from ._space_scenes import AXES3, LINKS3, MASSES3, SPAN3

# Width of the chapter's objects [m], for which its fingers are made, and how far from the bases they are
# held, as shares of it: at first where the chapter holds them.
_WIDTH = 0.03
_AHEAD = (0.115, 0.100, 0.130, 0.085)
# Damping of the fingers' opening and closing beside the critical one.
_ZETA = 0.235
# Force of a pinch beside the object's weight.
_WEIGHTS, _GRAVITY = 3.0, 9.81
# (16)'s moment that keeps orientations, for a turn by one, beside that of the force at a finger's length.
_ALPHA = 0.008
# Pairs of points that are looked at, and what their width counts beside friction and arm.
_PAIRS, _NARROW = 24, 0.3
# By how much the round tips are larger than the distance of O_i from the contact, beside it.
_BLUNT = 0.5
# Fingers of one's own: postures that are looked at, and object poses that are tried for each pair of points.
_POSTURES, _TRIED = 4000, 6


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
    line passes near the centre of mass; for each several poses of the object are tried, until both fingers
    reach it without overlap. The control is (16)-(17), "blind".

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
            the fingers reach none of them; the sentence says what hindered the last.

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
    for row in _ranked(pairs):
        points, faces, width = pairs.points[row], pairs.faces[row], pairs.distance[row]
        for hand, pose, order in _placed(object, tips, points, float(width)):
            kind = Contact3 if spatial else _planar_contact
            contacts = [kind(i, int(faces[end]), friction=friction) for i, end in enumerate(order)]
            found = reach(Grasp(object, hand, contacts, gravity=gravity), points[list(order)], pose=pose)
            if found.result == RESULTS.successful:
                blunt = _blunted(found, points[list(order)], pose) if fingers is None else found
                return _controlled(blunt.grasp, blunt.state, press)
            hindered = found.reason
    raise ValueError(f"argument fingers must reach the object, but did not: {hindered}")


def _ranked(pairs: GraspPoints) -> np.ndarray:
    """Numbers of the pairs: first those of little friction demand, near the centre of mass, and narrow.

    Of the critical points of the width those where it is least are the stable ones: fingers that draw each
    other together come apart wherever they roll from there.
    """
    along = (pairs.points[:, 1] - pairs.points[:, 0]) / pairs.distance[:, None]
    middle = pairs.points.mean(axis=1)
    aside = middle - np.sum(middle * along, axis=1)[:, None] * along
    size = float(np.ptp(pairs.points.reshape(-1, middle.shape[1]), axis=0).max())
    narrow = _NARROW * pairs.distance / pairs.distance.max()
    return np.argsort(pairs.demand + np.linalg.norm(aside, axis=1) / size + narrow)


def _planar_contact(finger: int, contour: int, friction: Given) -> Contact:
    # The chapter's s_i runs along the object's contour on the left and against it on the right.
    return Contact(finger=finger, contour=contour, sense=(1, -1)[finger], friction=friction)


def _placed(
    object: FreeObject | FreeObject3, tips: "list[_Tips] | None", points: np.ndarray, width: float
) -> Iterator[tuple[list[Any], np.ndarray, tuple[int, int]]]:
    """Two fingers, a pose of the object, and which of its points each is to touch, to be tried in turn."""
    spatial = isinstance(object, FreeObject3)
    if tips is None:
        k = width / _WIDTH
        hand = _chapter_hand3(k) if spatial else _chapter_hand(k)
        middles = [np.array([0.0 if spatial else 0.0275, ahead]) * k for ahead in _AHEAD]
        lines = [(np.append(m, 0.0) if spatial else m, np.eye(3 if spatial else 2)[0]) for m in middles]
        choices = [(hand, line) for line in lines]
    else:
        choices = list(_lines_between(tips, width))
    for hand, (middle, along) in choices:
        for order in ((0, 1), (1, 0)):
            ends = points[list(order)]
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
    """Where a finger's tip is in random postures: its middle, shape (n, d), and its radius [m]."""

    finger: Any
    middles: np.ndarray
    radius: float


def _tips_of(fingers: Any) -> list[_Tips]:
    """The tips of fingers of one's own, which are checked."""
    several = isinstance(fingers, list | tuple) and len(fingers) >= 2
    if not several or not all(isinstance(finger, Finger | Finger3) for finger in fingers):
        raise ValueError(f"argument fingers must be two fingers or more, but was {shown(fingers)}")
    draw = np.random.default_rng(0)
    return [_tips(finger, draw) for finger in fingers]


def _lines_between(
    tips: list[_Tips], width: float
) -> Iterator[tuple[list[Any], tuple[np.ndarray, np.ndarray]]]:
    """Pairs of fingers, and lines on which both hold something between them: its middle and direction.

    Random postures of both are compared: their tips should be as far apart as the object is wide, and the
    tips' sizes more. Where that is out by as much as itself in all postures, nothing comes of trying.
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
                found.append((out[k], [one.finger, other.finger], line))
    for _, pair, line in sorted(found, key=lambda each: each[0])[: 2 * _TRIED]:
        yield pair, line


def _tips(finger: Any, draw: np.random.Generator) -> _Tips:
    """A finger's tip in random postures."""
    limits = getattr(finger, "limits", None)
    low, high = (-np.pi / 2, np.pi / 2) if limits is None else np.asarray(limits, float).clip(-np.pi, np.pi).T
    origins, turns = poses_at(finger, draw.uniform(low, high, (_POSTURES, finger.joints)))
    tip = sheet_of(finger.tip)
    points = tip.frames(tip.sampled(256, 0.05)).points
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return _Tips(finger, origins + turns @ middle, 0.5 * float(np.ptp(points, axis=0).min()))


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
