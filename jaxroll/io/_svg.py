"""Outlines in SVG files; the only file that imports svgpathtools.

Everything here is in the drawing's own unit; `scale` is the caller's statement of it, in metres, and is
compared with what the drawing says of itself. An outline of straight segments gives its corners; one with
curved ones gives points at equal distances on the curve itself. `_files` calls the reader and the writer;
`_dxf` has the like for DXF.
"""

import re
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from ._drawing import check_scale, finite, reading, without_outline
from ._extra import missing
from ._outline import filled_places, filled_polygon, without_repeats
from ._svg_style import GEOMETRY, inherited, is_zero, kind_of, OUTERMOST, StyleSheet, TRANSFORMS

# Least angles [rad] of a corner: between straight pieces, and between any.
_ANY, _SHARP = 1e-9, 0.02
_NEAR = 1e-6  # ends of lines and curves meet within this share of the drawing's size
_ROUGH = np.linspace(0.0, 1.0, 5)  # parameters of a segment that tell how large a drawing is
_FINE = 64  # intervals of the parameter of a curved piece, from which its length is summed
_GROUPS = ("svg", "g", "a", "switch")  # parts of an SVG that show what is in them
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
# Metres in the units in which a drawing may state its width.
_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72, "pc": 0.0254 / 6, "q": 2.5e-4}


def read_svg(path: Path, scale: float, samples: int, *, fill: bool) -> list[np.ndarray]:
    """Points of every outline in the drawing's own unit, y up.

    Args:
        path: The file.
        scale: Metres in one unit of the drawing, according to the caller.
        samples: Number of points on an outline with curved pieces.
        fill: Whether there are points along straight pieces, and one at every corner.
    """
    try:
        import svgpathtools  # noqa: F401
    except ImportError:
        raise missing("svgpathtools") from None
    with reading(path):
        root = ElementTree.parse(path).getroot()
        tracks = list(_Walk(root).tracks())
        # Frames round icons have no paint. A drawing in which nothing has any is one of bare outlines.
        tracks = [track for track in tracks if track.painted] or tracks
        drawn = [(piece, track.clips) for track in tracks for piece in _placed(track)]
    check_scale(scale, _svg_scale(root, path), path)
    if not drawn:
        raise without_outline(path)
    seen = finite(np.concatenate([segment.at(_ROUGH) for piece, _ in drawn for segment in piece]), path)
    near = _NEAR * float(np.hypot(np.ptp(np.real(seen)), np.ptp(np.imag(seen))))
    with reading(path):
        for piece, clips in drawn:
            for clip in clips:
                _check_within(_along(piece, samples, fill), clip)
    return [_along(piece, samples, fill) for piece in _joined([piece for piece, _ in drawn], near)]


# The shapes of a clip path, each by the polygons of its pieces, whose places are complex numbers.
_Clip = list[list[np.ndarray]]


class _Track(NamedTuple):
    """A shape of an SVG.

    Attributes:
        text: Of a path.
        matrix: To the drawing's coordinates.
        clips: What clips it: what lies in none of a clip path's shapes is not shown.
        painted: Whether it has a fill or a stroke.
    """

    text: str
    matrix: np.ndarray
    clips: tuple[_Clip, ...]
    painted: bool


class _Segment(NamedTuple):
    """A line, an arc or a Bezier curve of svgpathtools, and the matrix to the drawing's coordinates."""

    curve: Any
    matrix: np.ndarray

    @property
    def straight(self) -> bool:
        return type(self.curve).__name__ == "Line"

    def at(self, t: Any) -> np.ndarray:
        """Places in the drawing, as complex numbers, where the parameter is `t`, from 0 to 1."""
        points = np.array([self.curve.point(x) for x in np.ravel(t).tolist()])
        x, y, _ = self.matrix @ [np.real(points), np.imag(points), np.ones(len(points))]
        return (x + 1j * y).reshape(np.shape(t))

    def reversed(self) -> "_Segment":
        return self._replace(curve=self.curve.reversed())


# Segments each of which begins where the one before it ends.
_Piece = list[_Segment]


class _Walk:
    """Every shape that an SVG shows.

    The matrices are not applied to the curves but to points on them: an ellipse's arc that is tilted and then
    mirrored or stretched has other axes, which svgpathtools gets wrong.
    """

    def __init__(self, root: Element) -> None:
        self.root = root
        self.named = {part.get("id"): part for part in root.iter() if part.get("id")}
        self.sheet = StyleSheet(root)

    def tracks(self) -> Iterator[_Track]:
        """The shapes, y up."""
        yield from self._below(self.root, np.diag([1.0, -1.0, 1.0]), OUTERMOST, (), ())

    def _below(
        self,
        part: Element,
        matrix: np.ndarray,
        around: Mapping[str, str],
        users: tuple[Element, ...],
        clips: tuple[_Clip, ...],
    ) -> Iterator[_Track]:
        """The shapes of one part of the drawing.

        Args:
            part: A shape, a group or a reference; what is none of these shows nothing.
            matrix: From the coordinates around it to those of the drawing.
            around: How the parts around it are shown, where it may say otherwise.
            users: The references by which the part was reached, the last one last.
            clips: What the parts around it are clipped to.
        """
        from svgpathtools.document import CONVERSIONS

        kind, referred = kind_of(part), bool(users) and self._target(users[-1]) is part
        if kind not in (*CONVERSIONS, "use", *_GROUPS) and not (kind in ("symbol", "clipPath") and referred):
            return
        said = self.sheet.said(part, around)
        if said.get("display") == "none" or is_zero(said.get("opacity", "1")):
            return
        matrix = matrix @ _transform(part, said)
        if np.linalg.det(matrix) == 0.0:  # pressed flat, it is not drawn
            return
        clips += self._clip(said, matrix, users)
        around = inherited(said)
        if kind in CONVERSIONS and said["visibility"] == "visible":
            _check_shape(part, said)
            text = CONVERSIONS[kind](_rounded(part) if kind == "rect" else part)
            yield _Track(text, matrix, clips, self.sheet.painted(said))
        elif kind == "use":
            target = self._target(part)
            if part in users:
                raise ValueError(f"a use of #{target.get('id')} stands within what it refers to")
            matrix = matrix @ _shift(_number(part, "x", "0"), _number(part, "y", "0"))
            yield from self._below(target, matrix, around, (*users, part), clips)
        if kind in ("svg", "symbol") and part is not self.root:
            matrix = matrix @ _window(part, users[-1] if referred else part)
        for child in _children(part) if kind in (*_GROUPS, "symbol", "clipPath") else ():
            yield from self._below(child, matrix, around, users, clips)

    def _clip(
        self, said: Mapping[str, str], matrix: np.ndarray, users: tuple[Element, ...]
    ) -> tuple[_Clip, ...]:
        """What a part is clipped to by itself: nothing, or the shapes of one clip path."""
        clip = said.get("clip-path", "none")
        if clip == "none":
            return ()
        name = re.fullmatch(r"""url\(\s*["']?(#.+?)["']?\s*\)""", clip)
        user = Element("use", {"href": name[1] if name else clip})
        if self._target(user).get("clipPathUnits") == "objectBoundingBox":
            raise ValueError(f"{user.get('href')} clips in shares of what it clips")
        tracks = self._below(self._target(user), matrix, OUTERMOST, (*users, user), ())
        return ([_polygons(track) for track in tracks],)

    def _target(self, use: Element) -> Element:
        """The part that a `use` refers to."""
        name = use.get("href", use.get("{http://www.w3.org/1999/xlink}href", ""))
        if not name.startswith("#") or name[1:] not in self.named:
            raise ValueError(f"what a use or a clip refers to, {name!r}, is not in the file")
        return self.named[name[1:]]


def _children(part: Element) -> list[Element]:
    """The parts of a part; of a switch the one that is shown: the first that is for every reader."""
    if kind_of(part) != "switch":
        return list(part)
    tests = ("requiredExtensions", "systemLanguage")
    return [child for child in part if kind_of(child) and not any(child.get(test) for test in tests)][:1]


def _transform(part: Element, said: Mapping[str, str]) -> np.ndarray:
    """The matrix of a part's own transform, which must stand in its attribute."""
    from svgpathtools.parser import parse_transform

    for name in TRANSFORMS:
        if said.get(name, "none") != part.get(name, "none"):
            raise ValueError(f"the {name} of a {kind_of(part)} stands in its style")
    if said.get("mask", "none") != "none":
        raise ValueError(f"a {kind_of(part)} has a mask")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a transform that is not understood would be left out
        # Numbers that only a sign or a second point keeps apart, `scale(.5.25)`, get spaces between them.
        matrix = parse_transform(_NUMBER.sub(r" \g<0> ", part.get("transform", "")))
    origin = said.get("transform-origin", "0 0")
    if not all(map(is_zero, origin.split())) and np.any(matrix[:2, :2] != np.eye(2)):
        raise ValueError(f"the transform of a {kind_of(part)} has the origin {origin!r}")
    return matrix


def _number(part: Element, name: str, default: str | None = None) -> float:
    """A length in the drawing's unit; a ValueError where it has another unit, or none is given."""
    text = part.get(name, default)
    if text is None:
        raise ValueError(f"a {kind_of(part)} with a viewBox has no {name}")
    return float(text.strip().removesuffix("px"))


def _shift(x: float, y: float) -> np.ndarray:
    """The matrix of a displacement."""
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def _window(part: Element, sized: Element) -> np.ndarray:
    """The matrix from the coordinates within a drawing that stands in another to those around it.

    Args:
        part: The inner drawing, `svg` or `symbol`.
        sized: What says how large it is, if it does: itself, or the `use` that refers to it.
    """
    place = _shift(_number(part, "x", "0"), _number(part, "y", "0"))
    box = np.array(part.get("viewBox", "").replace(",", " ").split(), float)
    if len(box) != 4:
        return place
    sized = sized if {"width", "height"} <= set(sized.keys()) else part
    size = np.array([_number(sized, "width"), _number(sized, "height")])
    if not (min(*size, *box[2:]) > 0.0 and np.all(np.isfinite([*size, *box]))):
        raise ValueError(f"a {kind_of(part)} within it has no positive, finite size")
    scales, fit = size / box[2:], part.get("preserveAspectRatio", "xMidYMid")
    if not fit.startswith("none"):
        scales[:] = scales.max() if fit.endswith("slice") else scales.min()
    # What is left free at both sides is parted as it says.
    shares = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}
    free = size - scales * box[2:]
    at = np.array([shares.get(fit[1:4], 0.0), shares.get(fit[5:8], 0.0)]) * free - scales * box[:2]
    return place @ _shift(*at.tolist()) @ np.diag([*scales, 1.0])


def _check_shape(part: Element, said: Mapping[str, str]) -> None:
    """Raise for geometry that stands in a style, a size below zero, and a circle without a radius."""
    for name in GEOMETRY:
        text = part.get(name)
        if said.get(name, "auto").strip().lower() != (text or "auto").strip().lower():
            raise ValueError(f"the {name} of a {kind_of(part)} stands in its style")
        if name in ("r", "rx", "ry", "width", "height") and text and text.strip().startswith("-"):
            raise ValueError(f"a {kind_of(part)} has the {name} {text}")
    for name in {"circle": ("r",), "ellipse": ("rx", "ry")}.get(kind_of(part), ()):
        if part.get(name, "auto") == "auto":
            raise ValueError(f"a shape of kind {kind_of(part)} has no {name}")


def _rounded(rect: Element) -> Element:
    """A rectangle whose radii are at most half its sides, as the standard has it."""
    given = {name: float(rect.get(name, "auto")) for name in ("rx", "ry") if rect.get(name, "auto") != "auto"}
    others = {name: value for name, value in rect.items() if name not in ("rx", "ry")}
    if not given or min(given.values()) <= 0.0:
        return Element(rect.tag, others)
    halves = {"rx": 0.5 * _number(rect, "width", "0"), "ry": 0.5 * _number(rect, "height", "0")}
    radii = {name: min(given.get(name, max(given.values())), half) for name, half in halves.items()}
    return Element(rect.tag, others | {name: repr(radius) for name, radius in radii.items()})


def _pieces(text: str) -> list[Any]:
    """The connected pieces of a path, each an outline: a closed one ends where it is closed.

    svgpathtools alone would join a closed piece to one that begins where that ends, and passes over what is
    neither a command nor a number.
    """
    from svgpathtools import parse_path, Path as Track

    if text.strip() == "none":
        return []
    if wrong := re.search(r"[^MZLHVCSQTAE\d.,+\-\s]+", text, re.I):
        raise ValueError(f"a path holds {wrong[0]!r}")
    found: list[list[Any]] = []
    here = 0j
    for part in re.findall(r"[Mm][^MmZz]*[Zz]?|[^MmZz\s][^MmZz]*[Zz]?", text):
        begun = part if part[0] in "Mm" else f"M {here.real!r} {here.imag!r} {part}"
        try:
            piece = list(parse_path(begun, here))
        except AssertionError:
            raise ValueError(f"a path has an arc that ends where it begins: {part!r}") from None
        if not piece:  # a move that nothing follows: a step after it tells where that leads
            here = parse_path(f"{begun.rstrip('Zz ')} h 1", here)[0].start
            continue
        here = piece[-1].end
        # Some programs write a move before every line and arc.
        if found and found[-1][-1].end == piece[0].start != found[-1][0].start:
            found[-1] += piece
        else:
            found.append(piece)
    return [Track(*piece) for piece in found]


def _placed(track: _Track) -> list[_Piece]:
    """The pieces of a path, each segment with the path's matrix; without those from a point to itself."""
    extended = [[curve for curve in piece if _extends(curve)] for piece in _pieces(track.text)]
    return [[_Segment(curve, track.matrix) for curve in piece] for piece in extended if piece]


def _extends(curve: Any) -> bool:
    """Whether a line or a Bezier curve has more than one point, as arcs always have."""
    return type(curve).__name__ == "Arc" or len(set(curve.bpoints())) > 1


def _joined(pieces: list[_Piece], near: float) -> list[_Piece]:
    """Pieces with those joined whose ends meet, unless more than two meet at a place; closed ones stay alone.

    Programs for drawing write lines and arcs one by one. Ends meet that are nearer than `near` to each other.
    """
    from scipy.spatial import KDTree

    ends = np.array([(piece[0].at(0.0), piece[-1].at(1.0)) for piece in pieces])
    places = np.stack([np.real(ends), np.imag(ends)], axis=-1).reshape(-1, 2)
    free = np.flatnonzero(np.repeat(np.abs(ends[:, 0] - ends[:, 1]) > near, 2))
    pairs = free[KDTree(places[free]).query_pairs(near, output_type="ndarray")]
    met = np.bincount(pairs.ravel(), minlength=len(places))
    # End 2 k + 1 of piece k, or its beginning 2 k, with the one end of another piece that it meets.
    other = {int(a): int(b) for pair in pairs for a, b in (pair, pair[::-1]) if met[a] == met[b] == 1}
    done: list[_Piece] = []
    left = dict.fromkeys(range(len(pieces)))
    while left:
        k, first = next(iter(left)), 0
        # Back to where the chain begins, or once round it.
        seen = {k}
        while (before := other.get(2 * k + first)) is not None and before // 2 not in seen:
            k, first = before // 2, 1 - before % 2
            seen.add(k)
        chain: _Piece = []
        while k in left:
            del left[k]
            chain += [each.reversed() for each in reversed(pieces[k])] if first else pieces[k]
            following = other.get(2 * k + 1 - first, 2 * k)
            k, first = following // 2, following % 2
        done.append(chain)
    return done


def _check_within(outline: np.ndarray, clip: _Clip) -> None:
    """Raise where a part of an outline lies in none of the shapes that it is clipped to."""
    near = 1e-3 * np.ptp(outline, axis=0).max()  # curves are polygons here
    places = outline @ [1.0, 1.0j]
    covered = np.zeros(len(places), bool)
    for shape in clip:
        covered |= _covers(shape, places, near)
    if not covered.all():
        raise ValueError("an outline is cut off by a clip path")


def _polygons(track: _Track) -> list[np.ndarray]:
    """The pieces of a shape that clips others, by places as complex numbers."""
    return [_along(piece, 4 * _FINE, False) @ [1.0, 1.0j] for piece in _placed(track)]


def _covers(polygons: list[np.ndarray], places: np.ndarray, near: float) -> np.ndarray:
    """Whether polygons together run round each place, or are near it; all are complex numbers."""
    turns, distance = np.zeros(len(places)), np.full(len(places), np.inf)
    for polygon in polygons:
        start, side = polygon - places[:, None], np.roll(polygon, -1) - polygon
        square = np.maximum(np.abs(side) ** 2, np.finfo(float).tiny)
        nearest = start + side * np.clip(-np.real(start * side.conj()) / square, 0.0, 1.0)
        turns += np.angle((start + side) * start.conj()).sum(axis=1) / (2.0 * np.pi)
        distance = np.minimum(distance, np.abs(nearest).min(axis=1))
    return (np.abs(turns) > 0.5) | (distance <= near)


def _svg_scale(root: Any, path: Path) -> float | None:
    """Metres in one unit of the drawing, or None where it states no length.

    Width and height may state it, or one of them. Where both do and disagree, the drawing is as large as fits
    into both, unless it is to cover both.
    """
    box, fit = root.get("viewBox", "").replace(",", " ").split(), root.get("preserveAspectRatio", "")
    with reading(path):
        sizes = [_metres(root.get(name, "")) for name in ("width", "height")]
        spans = [float(text) for text in box[2:]] if len(box) == 4 else [1.0, 1.0]
    pairs = [(size, span) for size, span in zip(sizes, spans, strict=True) if size is not None]
    if not all(0.0 < number < np.inf for pair in pairs for number in pair):
        told = ", ".join(
            f"{name} {root.get(name)!r}" for name in ("width", "height", "viewBox") if root.get(name)
        )
        raise ValueError(
            f"argument path must name a drawing of a positive, finite size, but {path.name} has {told}"
        )
    if not pairs or len(box) != 4:  # without a viewBox one unit is a pixel of CSS
        return 0.0254 / 96 if pairs else None
    scales = [size / span for size, span in pairs]
    if fit.strip().startswith("none") and max(scales) > 1.001 * min(scales):
        raise ValueError(
            f"argument path must name a drawing in one unit, but {path.name} is stretched: one unit is "
            f"{1e3 * scales[0]:.6g} mm along x and {1e3 * scales[1]:.6g} mm along y"
        )
    return max(scales) if fit.strip().endswith("slice") else min(scales)


def _metres(text: str) -> float | None:
    """A stated length [m], or None where it has no unit of length."""
    text = text.strip().lower()
    unit = next((unit for unit in _LENGTHS if text.endswith(unit)), None)
    return None if unit is None else float(text.removesuffix(unit)) * _LENGTHS[unit]


def _along(piece: _Piece, samples: int, fill: bool) -> np.ndarray:
    """Corners of a piece of straight segments; of any other, points at equal distances on the curve itself.

    Distances are those after the matrices. A piece is closed whose ends meet to a millionth of its size.
    """
    straight = all(segment.straight for segment in piece)
    fine = np.array([segment.at(np.linspace(0.0, 1.0, 2 if straight else _FINE + 1)) for segment in piece])
    size = max(np.ptp(np.real(fine)), np.ptp(np.imag(fine)))
    closed = bool(np.abs(fine[0, 0] - fine[-1, -1]) <= _NEAR * size)
    if straight:
        corners = np.append(fine[:, 0], [] if closed else fine[-1, -1:])
        corners = without_repeats(np.stack([np.real(corners), np.imag(corners)], axis=1), closed=closed)
        return filled_polygon(corners, samples, closed=closed, sharp=_ANY) if fill else corners
    # Length along the piece against its parameter, which is the number of the segment plus the parameter
    # within it; then the parameters at equal lengths.
    steps = np.abs(np.diff(fine, axis=1)).ravel()
    along = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, along[-1], samples + 1)[:-1] if closed else np.linspace(0.0, along[-1], samples)
    if fill:
        # Directions at both ends of every segment, from its first and last thousandth.
        out = np.array([segment.at(1e-3) for segment in piece]) - fine[:, 0]
        end = fine[:, -1] - np.array([segment.at(1.0 - 1e-3) for segment in piece])
        turn = np.abs(np.angle(out * np.conj(np.roll(end, 1))))
        turn[0] = turn[0] if closed else 0.0
        corners = along[::_FINE][:-1][turn > _SHARP]
        at = filled_places(float(along[-1]), corners, samples, closed=closed)
    place = np.interp(at, along, np.arange(len(along)) / _FINE)
    which = np.minimum(place.astype(int), len(piece) - 1)
    points = np.array([piece[i].at(x - i) for i, x in zip(which.tolist(), place.tolist(), strict=True)])
    return np.stack([np.real(points), np.imag(points)], axis=1)


def write_svg(path: Path, points: np.ndarray, scale: float, *, closed: bool) -> None:
    """Write a polygon as one path, y turned down, in a drawing whose size is stated in millimetres.

    Around it is a margin of a twentieth of its size; the viewBox has the caller's unit, so that the numbers
    of the path are those of the points.
    """
    x, y = points.T * np.array([[1.0], [-1.0]])
    margin = 0.05 * max(np.ptp(x), np.ptp(y))
    low = np.array([x.min(), y.min()]) - margin
    width, height = np.array([np.ptp(x), np.ptp(y)]) + 2.0 * margin
    track = " L ".join(f"{a:.12g},{b:.12g}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
    millimetres = 1e3 * scale
    drawing = Element(
        "svg",
        xmlns="http://www.w3.org/2000/svg",
        width=f"{width * millimetres:.12g}mm",
        height=f"{height * millimetres:.12g}mm",
        viewBox=f"{low[0]:.12g} {low[1]:.12g} {width:.12g} {height:.12g}",
    )
    pen = {"fill": "none", "stroke": "black", "stroke-width": f"{0.2 * margin:.3g}"}
    ElementTree.SubElement(drawing, "path", {"d": f"M {track}{' Z' if closed else ''}", **pen})
    ElementTree.indent(drawing, "")
    ElementTree.ElementTree(drawing).write(path, encoding="utf-8")
