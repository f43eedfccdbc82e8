r"""`grasp_points`: pairs of points by which two fingers may hold an object with the least friction.

Two point contacts that press along the line between them need a coefficient of friction of
$\mu = \max(\tan \alpha_1, \tan \alpha_2)$, where $\alpha_i$ is the angle between that line and the inward
normal. It is zero at antipodal points, where the squared distance of two boundary points is stationary.
Newton's method finds these from pairs of samples: with $d = p_2 - p_1$ and the bends K of both sheets,

$$ g = (-T_1 d,\; T_2 d), \qquad
   H = \begin{pmatrix} 1 + (d \cdot n_1) K_1 & -T_1 T_2^T \\
   -T_2 T_1^T & 1 - (d \cdot n_2) K_2 \end{pmatrix}. $$

On a ball every diameter is stationary, and H singular: its pseudo-inverse moves a pair as little as it can.
Searches end anywhere in such a family of pairs, and of those that end near each other one is kept.
"""

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import numpy as np

from .._mechanics import AbstractBody, AbstractFinger
from .._printing import listed
from .._results import as_count, as_positive, as_several, concrete, on_host, shown
from .._types import ByPrecision, Given
from ..geometry import AbstractContour, AbstractShape, AbstractSurface, check_shape
from ._sheet import Frames, Sheet, sheet_of, shortened

# Samples on all faces together, in the plane and in space.
_SAMPLES = (384, 720)
# Pairs that Newton's method starts from, its steps, and pairs from which those are taken.
_STARTS, _STEPS, _MOST = 96, 24, 60_000
# Pairs are different if an end of theirs is farther apart than this share of the object's size ...
_APART = 0.12
# ... and exact ones that belong to no family, farther than this.
_SAME = ByPrecision(1e-6, 1e-4)
# Demands that differ by less are one: symmetric shapes have many of the same, which rounding must not order.
_EQUAL = ByPrecision(1e-9, 1e-6)
# Eigenvalues of H below this count as zero: a family of pairs.
_SINGULAR = ByPrecision(1e-7, 1e-5)
# A pair is antipodal where the tangents of both angles are below this.
_EXACT = ByPrecision(1e-9, 1e-5)
# What stands for the size of an object whose faces have no bounds [m].
_SIZE = 0.05


class GraspPoints(eqx.Module):
    """Pairs of points to hold an object by: antipodal ones, narrowest first, then others by rising demand.

    Demands within 1e-9, in single precision 1e-6, count as equal. Which end of a pair comes first does not
    depend on rounding.

    Attributes:
        points: In the object's frame, shape (n, 2, d) [m]; a row is what `reach` takes as its contacts.
        normals: Outward unit normals there, shape (n, 2, d).
        faces: Which of the object's contours or surfaces each point lies on, shape (n, 2).
        places: Arclength or surface coordinates of both points of each pair.
        demand: Least coefficient of friction that holds, shape (n,).
        distance: Of both points [m], shape (n,).
        exact: Whether the points are antipodal, to rounding, shape (n,).
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"points": "m", "distance": "m"}

    points: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    places: tuple[tuple[np.ndarray, np.ndarray], ...]
    demand: np.ndarray
    distance: np.ndarray
    exact: np.ndarray

    def __len__(self) -> int:
        return len(self.demand)


class _Pairs(NamedTuple):
    """Pairs of points: face, place and frame of both ends, in lists by end."""

    faces: np.ndarray  # (n, 2)
    places: np.ndarray  # (n, 2, most coordinates of any face)
    points: np.ndarray  # (n, 2, d)
    normals: np.ndarray

    def taken(self, which: Any) -> "_Pairs":
        return _Pairs(*(x[which] for x in self))


@on_host
def grasp_points(
    object: AbstractBody | AbstractShape | Sequence[Any], friction: Given = 0.5, *, count: int = 8
) -> GraspPoints:
    r"""Pairs of points at which two fingers hold an object with least friction.

    The antipodal pairs of its boundary come first: there the line between the points is normal to both sides,
    and no friction is needed; of a family of such pairs, as all round a bottle, some that lie apart. Where
    they are fewer than `count`, the best other pairs follow that the friction holds, each apart from all
    before. Fingers press inwards at both points; `reach` says whether they get there.

    Args:
        object: A `FreeObject`, `PivotedObject` or `FreeObject3`, or one or more contours or surfaces. Faces
            without bounds, such as planes, are looked at within the object's `outline`, or within the extent
            of its other faces.
        friction: Largest coefficient of friction that a pair may need.
        count: Most pairs that are returned.

    Returns:
        A `GraspPoints`; empty where no pair is held with this friction.

    Raises:
        ValueError: If `object` is none of these or has no boundary within its bounds, a number is not
            positive, or `count` is above 1000.

    Accuracy: exact pairs to rounding; others are pairs of samples, 384 in the plane and 720 in space: their
    own demand is exact, that of the best pair of all may be lower. Antipodal pairs of features finer than the
    samples' distance may be missed.

    Example:
        >>> import jaxroll as jxr
        >>> found = jxr.grasp_points(jxr.Ellipse(0.02, 0.01), count=2)
        >>> [f"{1e3 * width:.1f} mm, friction {mu:.0f}" for width, mu in zip(found.distance, found.demand)]
        ['20.0 mm, friction 0', '40.0 mm, friction 0']
    """
    limit = float(as_positive("friction", friction))
    count = as_count("count", count, most=1000)
    shapes, box = _shapes_of(object)
    sheets = [sheet_of(shape) for shape in shapes]
    samples = _sampled(sheets, box)
    size = float(np.ptp(samples.points, axis=0).max()) if len(samples.points) else 0.0
    if not size > 0.0:  # a search that finds nothing gives one place again and again
        raise ValueError(
            "argument object must have a boundary within its bounds, but no points of one were found there"
        )
    pairs = _candidates(samples, limit)
    starts = pairs.taken(_thinned(pairs, _STARTS, _APART * size))
    exact = _spread(sheets, _merged(_refined(sheets, starts, size), size), _APART * size)
    others = pairs.taken(_demand(pairs) <= limit)
    kept = _thinned(others, count, _APART * size, exact.points) if len(exact.faces) < count else []
    both = _Pairs(*(np.concatenate(x) for x in zip(exact, others.taken(kept), strict=True)))
    return _reported(sheets, both, count)


def _shapes_of(given: Any) -> tuple[tuple[Any, ...], np.ndarray | None]:
    """The shapes of an object, and the edge lengths of the box in which they count."""
    box = None
    if isinstance(given, AbstractFinger):
        raise ValueError(f"argument object must be an object or its shapes, but was {shown(given)}")
    if isinstance(given, AbstractBody):
        outline = getattr(given, "outline", None)
        box, given = None if outline is None else concrete(outline), given.shapes
    shapes = as_several("object", given, AbstractShape, "contours or surfaces, or an object that has some")
    kinds = {isinstance(shape, AbstractSurface) for shape in shapes}
    if len(kinds) > 1 or not all(isinstance(s, AbstractContour | AbstractSurface) for s in shapes):
        raise ValueError(f"argument object must be of the plane or of space, but was {shown(given)}")
    for shape in shapes:
        check_shape("object", shape)
    return shapes, box


def _sampled(sheets: Sequence[Sheet], box: np.ndarray | None) -> _Pairs:
    """Single samples of all faces, as pairs with one end: shape (n, 1, ...) each, but `faces` (n, 1)."""
    each = max(64, _SAMPLES[sheets[0].spatial] // len(sheets))
    extent = _SIZE if box is None else 0.5 * float(np.linalg.norm(box))
    bounded = [sheet for sheet in sheets if _bounded(sheet, each)]
    if box is None and bounded:
        points = [sheet.frames(sheet.sampled(each, 0.0)).points for sheet in bounded]
        extent = float(np.abs(np.concatenate(points)).max())
    width = max(sheet.coordinates for sheet in sheets)
    parts = []
    for i, sheet in enumerate(sheets):
        at = sheet.sampled(each, extent)
        here = sheet.frames(at)
        fair = np.isfinite(here.points).all(axis=1)
        if box is not None:
            fair &= (np.abs(here.points) <= 0.5 * box * (1.0 + 1e-9)).all(axis=1)
        places = np.pad(at, ((0, 0), (0, width - at.shape[1])))
        faces = np.full((len(at), 1), i)
        parts.append([x[fair] for x in (faces, places[:, None], here.points[:, None], here.normals[:, None])])
    return _Pairs(*(np.concatenate(x) for x in zip(*parts, strict=True)))


def _bounded(sheet: Sheet, count: int) -> bool:
    if sheet.spatial:
        return sheet.spread(count) is not None
    return sheet.shape.domain() is not None


def _candidates(samples: _Pairs, limit: float) -> _Pairs:
    """Pairs of samples by rising demand; beyond the limit a few, as starts of Newton's method."""
    points, normals = samples.points[:, 0], samples.normals[:, 0]
    i, j = np.triu_indices(len(points), 1)
    keep = np.einsum("nd,nd->n", normals[i], normals[j]) < 0.0
    i, j = i[keep], j[keep]
    demand = _needed(points[i], points[j], normals[i], normals[j])
    # Samples are coarse: an antipodal pair may have none of small demand near it.
    order = np.argsort(np.round(demand / _EQUAL.of(demand)), kind="stable")[:_MOST]
    order = order[demand[order] <= max(limit, 1.0)]
    i, j = i[order], j[order]
    return _Pairs(*(np.concatenate([x[i], x[j]], axis=1) for x in samples))


def _needed(one: np.ndarray, other: np.ndarray, out_one: np.ndarray, out_other: np.ndarray) -> np.ndarray:
    """Least coefficient of friction of pairs; infinite where a finger would have to pull."""
    line = other - one
    length = np.linalg.norm(line, axis=-1)
    line = line / np.where(length > 0, length, 1.0)[..., None]
    worst = np.zeros(length.shape)
    for normal, sign in ((out_one, -1.0), (out_other, 1.0)):
        along = sign * np.einsum("...d,...d->...", normal, line)
        aside = np.linalg.norm(normal - sign * along[..., None] * line, axis=-1)
        tangent = aside / np.where(along > 0, along, 1.0)
        worst = np.maximum(worst, np.where((along > 0) & (length > 0), tangent, np.inf))
    return worst


def _demand(pairs: _Pairs) -> np.ndarray:
    (one, other), (out_one, out_other) = (np.moveaxis(x, 1, 0) for x in (pairs.points, pairs.normals))
    return _needed(one, other, out_one, out_other)


def _thinned(
    pairs: _Pairs, count: int, apart: float | np.ndarray, known: np.ndarray | None = None
) -> np.ndarray:
    """Indices of the first pairs that are all different from each other, and from known ones.

    How far a pair must be from those before it, `apart`, is one number or that of each pair.
    """
    far, rows = np.broadcast_to(apart, len(pairs.points)), np.arange(len(pairs.points))
    for one in () if known is None else known:
        rows = rows[_apart(pairs.points[rows], one) > far[rows]]
    kept: list[int] = []
    while len(rows) and len(kept) < count:
        kept.append(int(rows[0]))
        rows = rows[1:]
        rows = rows[_apart(pairs.points[rows], pairs.points[kept[-1]]) > far[rows]]
    return np.array(kept, int)


def _apart(points: np.ndarray, one: np.ndarray) -> np.ndarray:
    """How far pairs differ from one pair: the larger distance of their ends, in either order."""
    # Coordinate by coordinate: NumPy is slow at sums over an axis of two or three numbers.
    ways = []
    for pair in (one, one[::-1]):
        squares = np.zeros(points.shape[:2])
        for k in range(points.shape[2]):
            squares += (points[..., k] - pair[:, k]) ** 2
        ways.append(np.maximum(squares[:, 0], squares[:, 1]))
    return np.sqrt(np.minimum(*ways))


def _refined(sheets: Sequence[Sheet], starts: _Pairs, size: float) -> _Pairs:
    """Pairs carried to where their distance is stationary; those that do not arrive are left out."""
    faces, places = starts.faces, starts.places.copy()
    ends = [_frames_at(sheets, faces[:, e], places[:, e]) for e in (0, 1)]
    for _ in range(_STEPS if len(faces) else 0):
        step = _newton(*ends)
        for e, part in enumerate(np.split(step, 2, axis=1)):
            cut = np.minimum(1.0, 0.1 * size / np.maximum(np.linalg.norm(part, axis=1), 1e-300))
            part = shortened(part * cut[:, None], ends[e].bends)
            places[:, e] = _moved_on(sheets, faces[:, e], places[:, e], part)
        ends = [_frames_at(sheets, faces[:, e], places[:, e]) for e in (0, 1)]
        if np.abs(step).max() < 1e-15 * size:
            break
    points, normals = (np.stack([getattr(end, x) for end in ends], axis=1) for x in ("points", "normals"))
    found = _Pairs(faces, places, points, normals)
    return found.taken(_demand(found) <= _EXACT.of(points))


def _moved_on(
    sheets: Sequence[Sheet], faces: np.ndarray, places: np.ndarray, steps: np.ndarray
) -> np.ndarray:
    """Places of several faces after tangent steps."""
    moved = places.copy()
    for i, sheet in enumerate(sheets):
        on, own = faces == i, sheet.coordinates
        if on.any():
            moved[on, :own] = sheet.moved(places[on, :own], steps[on])
    return moved


def _frames_at(sheets: Sequence[Sheet], faces: np.ndarray, places: np.ndarray) -> Frames:
    """Frames at places of several faces."""
    parts: list[np.ndarray] | None = None
    for i, sheet in enumerate(sheets):
        on = faces == i
        if not on.any():
            continue
        here = sheet.frames(places[on, : sheet.coordinates])
        if parts is None:
            parts = [np.zeros((len(faces), *x.shape[1:]), x.dtype) for x in here]
        for whole, part in zip(parts, here, strict=True):
            whole[on] = part
    if parts is None:
        d = 3 if sheets[0].spatial else 2
        parts = [np.zeros((0, d)), np.zeros((0, d)), np.zeros((0, d - 1, d)), np.zeros((0, d - 1, d - 1))]
    return Frames(*parts)


def _newton(one: Frames, other: Frames) -> np.ndarray:
    """Steps to where the distance is stationary, shape (n, 2 k): -H^+ g."""
    slope, matrix = _derivatives(one, other)
    inverse = np.linalg.pinv(matrix, rcond=_SINGULAR.of(one), hermitian=True)
    return -(inverse @ slope[..., None])[..., 0]


def _derivatives(one: Frames, other: Frames) -> tuple[np.ndarray, np.ndarray]:
    """Of half the squared distance the gradient g, shape (n, 2 k), and H, (n, 2 k, 2 k)."""
    line = other.points - one.points
    k = one.bends.shape[1]
    slope = np.concatenate(
        [-np.einsum("nkd,nd->nk", one.tangents, line), np.einsum("nkd,nd->nk", other.tangents, line)], axis=1
    )
    matrix = np.tile(np.eye(2 * k), (len(line), 1, 1))
    matrix[:, :k, :k] += np.einsum("nd,nd->n", line, one.normals)[:, None, None] * one.bends
    matrix[:, k:, k:] -= np.einsum("nd,nd->n", line, other.normals)[:, None, None] * other.bends
    mixed = -np.einsum("nad,nbd->nab", one.tangents, other.tangents)
    matrix[:, :k, k:], matrix[:, k:, :k] = mixed, np.swapaxes(mixed, 1, 2)
    return slope, matrix


def _spread(sheets: Sequence[Sheet], pairs: _Pairs, apart: float) -> _Pairs:
    """Exact pairs without those of a family, which have a singular H, that lie near one before them."""
    ends = [_frames_at(sheets, pairs.faces[:, e], pairs.places[:, e]) for e in (0, 1)]
    sizes = np.abs(np.linalg.eigvalsh(_derivatives(*ends)[1]))
    in_family = sizes.min(axis=1) <= _SINGULAR.of(ends) * sizes.max(axis=1)
    return pairs.taken(_thinned(pairs, len(pairs.points), np.where(in_family, apart, 0.0)))


def _merged(pairs: _Pairs, size: float) -> _Pairs:
    """Exact pairs, each once, the narrowest first.

    Which end comes first, and which of several pairs of one width, is said by their coordinates, not by the
    rounding of the search that found them.
    """
    same = _SAME.of(pairs.points) * size
    line = pairs.points[:, 1] - pairs.points[:, 0]
    first = np.take_along_axis(line, np.argmax(np.abs(line) > same, axis=1)[:, None], axis=1)[:, 0]
    back = (pairs.faces[:, 0] == pairs.faces[:, 1]) & (first < 0.0)
    pairs = _Pairs(*(np.where(back.reshape(-1, *(1,) * (x.ndim - 1)), x[:, ::-1], x) for x in pairs))
    width = np.round(np.linalg.norm(line, axis=1) / same)
    ends = np.round(np.concatenate([pairs.points[:, 0], pairs.points[:, 1]], axis=1) / same)
    pairs = pairs.taken(np.lexsort((*ends.T[::-1], width)))
    return pairs.taken(_thinned(pairs, len(pairs.points), same))


def _reported(sheets: Sequence[Sheet], pairs: _Pairs, count: int) -> GraspPoints:
    pairs = pairs.taken(slice(count))
    demand = _demand(pairs)
    exact = demand <= _EXACT.of(pairs.points)
    counts = np.array([sheet.coordinates for sheet in sheets])[pairs.faces]
    each = zip(pairs.places, counts, strict=True)
    places = tuple((at[0, : count[0]], at[1, : count[1]]) for at, count in each)
    width = np.linalg.norm(pairs.points[:, 1] - pairs.points[:, 0], axis=1)
    return GraspPoints(
        pairs.points, pairs.normals, pairs.faces, places, np.where(exact, 0.0, demand), width, exact
    )
