"""Contours as points to draw, in millimetres, and bodies made of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._mechanics import Grasp
from .._xla import quickly
from ..contact import Contact
from ..geometry import AbstractContour, tabled
from ._style import MM

_SAMPLES = 241
# Arclengths that are evaluated at a time.
_BLOCK = 256
Window = tuple[float, float]


@dataclass(frozen=True)
class Outline:
    """A body in its own frame: `faces` are true contours, `rings` the closed shapes to fill."""

    faces: tuple[np.ndarray, ...]
    rings: tuple[np.ndarray, ...]


class OutlineSamples(NamedTuple):
    """Points [mm] and unit tangents of shape (n, 2), curvatures [1/m] of shape (n,)."""

    points: np.ndarray
    tangents: np.ndarray
    curvatures: np.ndarray

    @property
    def outward(self) -> np.ndarray:
        """Outward unit normals, shape (n, 2): the tangents turned right."""
        return np.stack([self.tangents[:, 1], -self.tangents[:, 0]], axis=1)


def comb(curve: OutlineSamples, tooth: float, count: int = 150) -> tuple[np.ndarray, np.ndarray]:
    """A comb of curvature: the line along the ends of its teeth, and some teeth as one line with gaps.

    Args:
        curve: A contour.
        tooth: Length of a tooth over the curvature [mm m]; where that is negative, a tooth points inwards.
        count: How many teeth are drawn.
    """
    ends = curve.points + tooth * curve.curvatures[:, None] * curve.outward
    some = np.linspace(0, len(ends) - 1, count).astype(int)
    # NaN lifts the pen between two teeth.
    gaps = np.full((count, 2), np.nan)
    return ends, np.stack([curve.points[some], ends[some], gaps], axis=1).reshape(-1, 2)


def sample(contour: AbstractContour, s: np.ndarray) -> OutlineSamples:
    """A contour at arclengths [m] of shape (n,)."""
    ready = tabled(contour)
    sampled = lambda some: _sampled(ready, some)  # noqa: E731
    points, tangents, curvatures = in_blocks(sampled, np.asarray(s, float), length=_BLOCK)
    return OutlineSamples(MM * points, tangents, curvatures)


def in_blocks(function: Callable[[Any], Any], rows: Any, *, length: int) -> Any:
    """What a compiled function says of each of many rows; all that it returns has their leading axis.

    In blocks of one length, the last filled up: figures ask for many numbers of rows, and one program serves
    all.
    """
    count = len(jax.tree.leaves(rows)[0])
    shape = max(-(-count // length), 1), length
    blocks = jax.tree.map(lambda a: np.resize(a, (*shape, *np.shape(a)[1:])), rows)
    parts = [function(jax.tree.map(lambda a: a[i], blocks)) for i in range(shape[0])]  # noqa: B023
    return jax.tree.map(lambda *each: np.concatenate(each)[:count], *parts)


@quickly
def _sampled(contour: AbstractContour, s: Array):
    ready = contour.prepared()

    def at(u: Array):
        frame = ready.frame(u)
        return frame.point.array(), frame.tangent.array(), jnp.asarray(frame.curvature)

    return jax.vmap(at)(s)


def contours_of(grasp: Grasp) -> tuple[tuple[AbstractContour, ...], ...]:
    """Contours of the object, then of each fingertip."""
    return (tuple(grasp.object.contours), *((finger.tip,) for finger in grasp.fingers))


def rolling_contacts(grasp: Grasp) -> dict[int, Contact]:
    """The contacts of contours by their numbers; those of a caller's own have no point to be drawn."""
    return {i: contact for i, contact in enumerate(grasp.contacts) if isinstance(contact, Contact)}


def rolling_coordinates(grasp: Grasp, s: np.ndarray) -> np.ndarray:
    """Of states' s, the coordinates of `rolling_contacts`, shape (t, c)."""
    # A caller's own contact may have any number of coordinates, or none: `at` counts past them.
    columns, at = [], 0
    for i, contact in enumerate(grasp.contacts):
        if i in rolling_contacts(grasp):
            columns.append(s[:, at])
        at += len(jax.tree.leaves(contact.form(grasp.shapes(contact))))
    return np.stack(columns, axis=1) if columns else np.zeros((len(s), 0))


def starts_of(grasp: Grasp) -> list[list[list[tuple[int, float, int]]]]:
    """For every body and contour: (column of sigma, starting arclength [m], direction in sigma)."""
    starts = [[[] for _ in contours] for contours in contours_of(grasp)]
    for i, contact in enumerate(rolling_contacts(grasp).values()):
        # A state counts s_tip = s_tip,0 + sigma and s_object = s_object,0 - sigma.
        starts[0][contact.contour].append((i, float(contact.s_object), -1))
        starts[1 + contact.finger][0].append((i, float(contact.s_tip), 1))
    return starts


def extents(grasp: Grasp, sigmas: np.ndarray) -> list[list[Window]]:
    """Arclengths [m] to draw of every contour of every body: whole, or where it was touched."""
    margin = 0.3 * float(np.mean([f.size for f in grasp.fingers]))
    drawn = []
    for contours, starts in zip(contours_of(grasp), starts_of(grasp), strict=True):
        rows = []
        for contour, touched in zip(contours, starts, strict=True):
            passed = [s + way * sigmas[:, i] for i, s, way in touched] or [np.zeros(1)]
            low, high = np.min(passed), np.max(passed)
            ends = contour.domain()
            rows.append((low - margin, high + margin) if ends is None else tuple(map(float, ends)))
        drawn.append(rows)
    return drawn


def outlines(grasp: Grasp, sigmas: np.ndarray) -> list[Outline]:
    """Outline of the object, then of each fingertip, for rolling coordinates of shape (t, c)."""
    pairs = zip(contours_of(grasp), extents(grasp, sigmas), strict=True)
    return [_outline(contours, windows) for contours, windows in pairs]


def _outline(contours: Sequence[AbstractContour], windows: Sequence[Window]) -> Outline:
    """The faces of a body, and what to fill: open faces are joined up behind the contour."""
    faces, rings, open_faces = [], [], []
    for contour, window in zip(contours, windows, strict=True):
        face = sample(contour, np.linspace(*window, _SAMPLES))
        faces.append(face.points)
        if contour.closed:
            # The last point is the first again, to rounding: whatever fills the ring closes it by itself.
            rings.append(face.points[:-1])
        else:
            open_faces.append((face.points, face.tangents[[0, -1]]))
    if len(open_faces) == 1:
        # One open face gets a back of its own; several are joined to one ring, as the faces of a rectangle.
        rings.append(_backed(*open_faces[0]))
    elif open_faces:
        rings.append(_joined([face for face, _ in open_faces]))
    return Outline(tuple(faces), tuple(rings))


def _joined(faces: list[np.ndarray]) -> np.ndarray:
    middles = np.array([face[_SAMPLES // 2] for face in faces])
    # In the order of their directions from the middle of all: counter-clockwise, as each face runs.
    spokes = middles - middles.mean(axis=0)
    order = np.argsort(np.arctan2(spokes[:, 1], spokes[:, 0]))
    return np.concatenate([faces[i] for i in order])


def _backed(face: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """Close one open face by a rounded back: a Bezier arc on the body's side of its chord."""
    first, last = face[0], face[-1]
    chord = np.linalg.norm(last - first)
    # The chord turned left, since a contour has its body on the left.
    inward = np.array([first[1] - last[1], last[0] - first[0]]) / chord
    leave, enter = _unit(tangents[1] + inward), _unit(inward - tangents[0])
    u = np.linspace(0.0, 1.0, 41)[1:-1, None]
    # Bernstein's polynomials, from the last point back to the first.
    arc = (
        (1 - u) ** 3 * last
        + 3 * u * (1 - u) ** 2 * (last + 0.22 * chord * leave)
        + 3 * u**2 * (1 - u) * (first + 0.22 * chord * enter)
        + u**3 * first
    )
    return np.concatenate([face, arc])


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
