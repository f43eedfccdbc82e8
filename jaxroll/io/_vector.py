"""Outlines as drawings, SVG and DXF; the only file that imports svgpathtools and ezdxf.

Everything here is in the drawing's own unit; `scale` is the caller's statement of it, in metres, and is
compared with what the drawing says of itself. A path of straight pieces gives its corners; one with curved
pieces gives points at equal distances along it: of an SVG on the curve itself, of a DXF on a polygon that
follows it within 1e-7 of the drawing's size. `_files` calls the readers and writers.
"""

import contextlib
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from .._results import shown
from ._extra import missing
from ._outline import chosen, even, filled_places, filled_polygon

# Least angles [rad] of a corner: between straight pieces, between any, and in a polygon along a curve.
_ANY, _SHARP, _ALONG = 1e-9, 0.02, 0.1
_FINE = 64  # intervals of the parameter of a curved piece, from which its length is summed
_GROUPS = ("svg", "g", "a", "switch")  # parts of an SVG that show what is in them
# Metres in the units in which an SVG may state its width; metres in a DXF's unit by the code that it states
# ($INSUNITS), and the code of each unit that is written.
_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72, "pc": 0.0254 / 6, "q": 2.5e-4}
_CODES = {
    **{1: 0.0254, 2: 0.3048, 3: 1609.344, 4: 1e-3, 5: 1e-2, 6: 1.0, 7: 1e3, 8: 2.54e-8, 9: 2.54e-5},
    **{10: 0.9144, 11: 1e-10, 12: 1e-9, 13: 1e-6, 14: 0.1, 15: 10.0, 16: 100.0, 17: 1e9},
    **{18: 1.495978707e11, 19: 9.4607304725808e15, 20: 3.0856775814913673e16},
    # Foot, inch, yard and mile of the survey of the United States.
    **{21: 1200 / 3937, 22: 100 / 3937, 23: 3600 / 3937, 24: 6_336_000 / 3937},
}
# Kinds of a DXF's entities that are outlines, or parts of one.
_CURVES = ("LWPOLYLINE", "POLYLINE", "SPLINE", "ARC", "CIRCLE", "ELLIPSE", "LINE")
_CODE_OF = {"in": 1, "mm": 4, "m": 6, "um": 13}


def read_svg(path: Path, scale: float, samples: int, *, fill: bool) -> list[np.ndarray]:
    """Points of every outline in the drawing's own unit, y up.

    Args:
        path: The file.
        scale: Metres in one unit of the drawing, according to the caller.
        samples: Number of points on an outline with curved pieces.
        fill: Whether there are points along straight pieces, and one at every corner.
    """
    try:
        from svgpathtools import parse_path
    except ImportError:
        raise missing("svgpathtools") from None
    with _read(path):
        root = ElementTree.parse(path).getroot()
        # One path may hold several outlines.
        drawn = [
            (piece, matrix)
            for text, matrix in _Walk(root).tracks()
            for piece in parse_path(text).continuous_subpaths()
            if len(piece)
        ]
    _check_scale(scale, _svg_scale(root, path), path)
    if not drawn:
        raise _without_outline(path)
    return [_along(piece, matrix, samples, fill) for piece, matrix in drawn]


class _Walk:
    """Every shape that an SVG shows, as the text of a path, with the matrix to the drawing's coordinates.

    The matrices are not applied to the curves but to points on them: an ellipse's arc that is tilted and then
    mirrored or stretched has other axes, which svgpathtools gets wrong.
    """

    def __init__(self, root: Element) -> None:
        self.root = root
        self.named = {part.get("id"): part for part in root.iter() if part.get("id")}
        # Programs hide layers by rules for a class (".a") or a name ("#a") too; no others are known here.
        sheets = " ".join(part.text or "" for part in root.iter() if _kind(part) == "style")
        self.hidden = {
            name.strip()
            for names, rules in re.findall(
                r"([^{}]*){([^{}]*)}", re.sub(r"/\*.*?\*/", "", sheets, flags=re.S)
            )
            if _rules(rules).get("display") == "none"
            for name in names.split(",")
        }

    def tracks(self) -> Iterator[tuple[str, np.ndarray]]:
        """Texts of paths and their matrices, y up."""
        yield from self._below(self.root, np.diag([1.0, -1.0, 1.0]), "visible", ())

    def _below(
        self, part: Element, matrix: np.ndarray, visibility: str, users: tuple[Element, ...]
    ) -> Iterator[tuple[str, np.ndarray]]:
        """The shapes of one part of the drawing.

        Args:
            part: A shape, a group or a reference; what is none of these shows nothing.
            matrix: From the coordinates around it to those of the drawing.
            visibility: What it is where the part does not say: unlike `display`, it may be overruled below.
            users: The references by which the part was reached, the last one last.
        """
        from svgpathtools.document import CONVERSIONS
        from svgpathtools.parser import parse_transform

        kind, style = _kind(part), _rules(part.get("style", ""))
        referred = bool(users) and self._target(users[-1]) is part
        if kind not in (*CONVERSIONS, "use", *_GROUPS) and not (kind == "symbol" and referred):
            return
        visibility = style.get("visibility", part.get("visibility", visibility))
        names = [f".{name}" for name in part.get("class", "").split()] + [f"#{part.get('id')}"]
        by_name = None if self.hidden.isdisjoint(names) else "none"
        if style.get("display", by_name or part.get("display")) == "none":
            return
        if style.get("transform", "none") != "none":
            raise ValueError(f"the transform of a {kind} stands in its style")
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a transform that is not understood would be left out
            matrix = matrix @ parse_transform(part.get("transform"))
        if np.linalg.det(matrix) == 0.0:  # pressed flat, it is not drawn
            return
        if kind in CONVERSIONS and visibility == "visible":
            yield CONVERSIONS[kind](_rounded(part) if kind == "rect" else part), matrix
        elif kind == "use":
            target = self._target(part)
            if part in users:
                raise ValueError(f"a use of #{target.get('id')} stands within what it refers to")
            matrix = matrix @ _shift(_number(part, "x", "0"), _number(part, "y", "0"))
            yield from self._below(target, matrix, visibility, (*users, part))
        if kind in ("svg", "symbol") and part is not self.root:
            matrix = matrix @ _window(part, users[-1] if referred else part)
        for child in part if kind in (*_GROUPS, "symbol") else ():
            yield from self._below(child, matrix, visibility, users)

    def _target(self, use: Element) -> Element:
        """The part that a `use` refers to."""
        name = use.get("href", use.get("{http://www.w3.org/1999/xlink}href", ""))
        if not name.startswith("#") or name[1:] not in self.named:
            raise ValueError(f"what a use refers to, {name!r}, is not in the file")
        return self.named[name[1:]]


def _kind(part: Element) -> str:
    """The name of a part of an SVG; empty for parts of other kinds of files, and for remarks."""
    name = part.tag if isinstance(part.tag, str) else ""
    name = name.removeprefix("{http://www.w3.org/2000/svg}")
    return "" if "}" in name else name


def _rules(text: str) -> dict[str, str]:
    """The rules of a style by name, `display: none; ...`."""
    pairs = (rule.split(":", 1) for rule in text.split(";") if ":" in rule)
    return {name.strip(): value.replace("!important", "").strip() for name, value in pairs}


def _number(part: Element, name: str, default: str | None = None) -> float:
    """A length in the drawing's unit; a ValueError where it has another unit, or none is given."""
    text = part.get(name, default)
    if text is None:
        raise ValueError(f"a {_kind(part)} with a viewBox has no {name}")
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
        raise ValueError(f"a {_kind(part)} within it has no positive, finite size")
    scales, fit = size / box[2:], part.get("preserveAspectRatio", "xMidYMid")
    if not fit.startswith("none"):
        scales[:] = scales.max() if fit.endswith("slice") else scales.min()
    # What is left free at both sides is parted as it says.
    shares = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}
    free = size - scales * box[2:]
    at = np.array([shares.get(fit[1:4], 0.0), shares.get(fit[5:8], 0.0)]) * free - scales * box[:2]
    return place @ _shift(*at.tolist()) @ np.diag([*scales, 1.0])


def _rounded(rect: Element) -> Element:
    """A rectangle whose radii are at most half its sides, as the standard has it."""
    given = {name: float(rect.get(name, "auto")) for name in ("rx", "ry") if rect.get(name, "auto") != "auto"}
    others = {name: value for name, value in rect.items() if name not in ("rx", "ry")}
    if not given or min(given.values()) <= 0.0:
        return Element(rect.tag, others)
    halves = {"rx": 0.5 * _number(rect, "width", "0"), "ry": 0.5 * _number(rect, "height", "0")}
    radii = {name: min(given.get(name, max(given.values())), half) for name, half in halves.items()}
    return Element(rect.tag, others | {name: repr(radius) for name, radius in radii.items()})


def _without_outline(path: Path) -> ValueError:
    return ValueError(f"argument path must name a drawing with an outline, but {path.name} has none")


def drawn_outline(outlines: list[np.ndarray], which: int, path: Path) -> np.ndarray:
    """One outline of a drawing, counting from the largest."""
    return _finite(chosen(outlines, which, f"outlines in {path.name}"), path)


@contextlib.contextmanager
def _read(path: Path) -> Iterator[None]:
    """Turn whatever a library raises on a file that it cannot read into one sentence, a ValueError."""
    try:
        yield
    except Exception as error:
        raise ValueError(
            f"argument path must name a drawing, but {path.name} could not be read: {shown(str(error))}"
        ) from None


def _svg_scale(root: Any, path: Path) -> float | None:
    """Metres in one unit of the drawing, or None where it states no length.

    Width and height may state it, or one of them. Where both do and disagree, the drawing is as large as fits
    into both, unless it is to cover both.
    """
    box, fit = root.get("viewBox", "").replace(",", " ").split(), root.get("preserveAspectRatio", "")
    with _read(path):
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


def _check_scale(scale: float, stated: float | None, path: Path) -> None:
    """Raise where the drawing states a unit that differs from the caller's by more than rounding."""
    if stated is not None and abs(scale / stated - 1.0) > 1e-3:
        raise ValueError(
            f"argument unit must agree with {path.name}, which states that one unit is "
            f"{1e3 * stated:.6g} mm, but was {1e3 * scale:.6g} mm"
        )


def _along(piece: Any, matrix: np.ndarray, samples: int, fill: bool) -> np.ndarray:
    """Corners of a path of straight pieces; of any other, points at equal distances on the curve itself.

    svgpathtools has points as complex numbers, x + iy. Distances are those after the matrix.
    """
    closed = bool(piece.isclosed())

    def moved(points: Any) -> np.ndarray:
        plane = np.stack([np.real(points), np.imag(points)], axis=-1) @ matrix[:2, :2].T + matrix[:2, 2]
        return plane[..., 0] + 1j * plane[..., 1]

    if all(type(segment).__name__ == "Line" for segment in piece):
        corners = moved([segment.start for segment in piece] + ([] if closed else [piece[-1].end]))
        corners = np.stack([np.real(corners), np.imag(corners)], axis=1)
        return filled_polygon(corners, samples, closed=closed, sharp=_ANY) if fill else corners
    # Length along the path against its parameter, which is the number of the piece plus the parameter within
    # it; then the parameters at equal lengths.
    t = np.linspace(0.0, 1.0, _FINE + 1)
    fine = moved([[segment.point(x) for x in t] for segment in piece])
    steps = np.abs(np.diff(fine, axis=1)).ravel()
    along = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, along[-1], samples + 1)[:-1] if closed else np.linspace(0.0, along[-1], samples)
    if fill:
        # Directions at both ends of every piece, from its first and last thousandth.
        out = moved([segment.point(1e-3) for segment in piece]) - fine[:, 0]
        end = fine[:, -1] - moved([segment.point(1.0 - 1e-3) for segment in piece])
        turn = np.abs(np.angle(out * np.conj(np.roll(end, 1))))
        turn[0] = turn[0] if closed else 0.0
        corners = along[::_FINE][:-1][turn > _SHARP]
        at = filled_places(float(along[-1]), corners, samples, closed=closed)
    place = np.interp(at, along, np.arange(len(along)) / _FINE)
    which = np.minimum(place.astype(int), len(piece) - 1)
    points = moved([piece[i].point(x - i) for i, x in zip(which.tolist(), place.tolist(), strict=True)])
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


def _ezdxf() -> Any:
    """The library ezdxf, imported with the first use."""
    try:
        import ezdxf
        import ezdxf.path
    except ImportError:
        raise missing("ezdxf") from None
    return ezdxf


def read_dxf(path: Path, scale: float, samples: int, *, fill: bool) -> list[np.ndarray]:
    """Points of every outline in the drawing's own unit.

    Pieces (lines, arcs, splines) whose ends meet are joined to one outline, unless more than two meet at a
    point. The arguments are those of `read_svg`.
    """
    ezdxf = _ezdxf()
    with _read(path):
        drawing = ezdxf.readfile(str(path))
        unit = int(drawing.header.get("$INSUNITS", 0))
        pieces = _pieces(drawing.modelspace(), drawing.layers)
        tracks = [ezdxf.path.make_path(piece, segments=8, level=8) for piece in pieces]
    _check_scale(scale, _CODES.get(unit), path)
    tracks = [track for track in tracks if len(track)]
    if not tracks:
        raise _without_outline(path)
    corners = [(v.x, v.y) for track in tracks for v in track.control_vertices()]
    corners = _finite(np.array(corners), path)
    size = float(np.linalg.norm(np.ptp(corners, axis=0)))
    # Relative to the drawing: curves are followed to 1e-7 of its size, and ends within 1e-6 of it meet.
    joined = _joined([_flat(track, 1e-7 * size) for track in tracks], 1e-6 * size)
    outlines = []
    for line, curved in joined:
        closed = bool(np.linalg.norm(line[0] - line[-1]) <= 1e-6 * size)
        line = line[:-1] if closed else line
        if fill:
            outlines.append(filled_polygon(line, samples, closed=closed, sharp=_ALONG if curved else _ANY))
        else:
            outlines.append(even(line, samples, closed=closed) if curved else line)
    return outlines


def _pieces(entities: Iterable[Any], layers: Any, around: str = "0") -> Iterator[Any]:
    """The lines and curves that a DXF shows, those of blocks where these are inserted.

    Args:
        entities: Of the drawing, or of one block in its place.
        layers: The drawing's table of layers.
        around: The layer of the block, on which stands what its parts have on layer "0".
    """
    for entity in entities:
        name = around if entity.dxf.layer == "0" else entity.dxf.layer
        layer = layers.get(name) if name in layers else None
        if entity.dxf.get("invisible", 0) or (layer is not None and layer.is_frozen()):
            continue
        # A block on a layer that is off, unlike on a frozen one, shows what it has on other layers.
        if entity.dxftype() == "INSERT":
            for block in entity.multi_insert():
                yield from _pieces(block.virtual_entities(), layers, name)
        elif entity.dxftype() in _CURVES and (layer is None or layer.is_on()):
            yield entity


def _finite(points: np.ndarray, path: Path) -> np.ndarray:
    """The points, if all are finite."""
    if not np.all(np.isfinite(points)):
        raise ValueError(
            f"argument path must name an outline of finite points, but that of {path.name} is not"
        )
    return points


def _flat(track: Any, distance: float) -> tuple[np.ndarray, bool]:
    """A path as a polygon that stays within a distance of it, and whether the path has curved pieces."""
    vertices = track.flattening(distance) if track.has_curves else track.control_vertices()
    return np.array([(v.x, v.y) for v in vertices]), bool(track.has_curves)


def _joined(lines: Sequence[tuple[np.ndarray, bool]], near: float) -> list[tuple[np.ndarray, bool]]:
    """Join open polygons where exactly two ends meet; one that was drawn twice counts once.

    Args:
        lines: Polygons, each with whether it follows a curve.
        near: Distance below which two ends meet.

    Returns:
        Polygons, each with whether a part of it follows a curve; those that are closed already come first.
    """
    from ezdxf import edgeminer

    done = [line for line in lines if np.linalg.norm(line[0][0] - line[0][-1]) <= near]
    pieces = [line for line in lines if np.linalg.norm(line[0][0] - line[0][-1]) > near]
    if not pieces:
        return done
    edges = [edgeminer.make_edge(line[0], line[-1], payload=(line, curved)) for line, curved in pieces]
    deposit = edgeminer.Deposit(edges, gap_tol=near)

    def same(one: edgeminer.Edge, other: edgeminer.Edge) -> bool:
        (line, _), (twin, _) = one.payload, other.payload
        return len(line) == len(twin) and any(np.abs(line - t).max() <= near for t in (twin, twin[::-1]))

    deposit = edgeminer.Deposit(edgeminer.filter_coincident_edges(deposit, same), gap_tol=near)
    # `left` is an ordered set: the order of the outlines must not depend on hashes.
    left = dict.fromkeys(sorted(deposit.edges, key=lambda edge: edge.id))
    while left:
        chain = edgeminer.find_simple_chain(deposit, next(iter(left)))
        for edge in chain:
            del left[edge]
        # Each part begins where the one before it ended: that point is kept once.
        parts = [edge.payload[0][::-1] if edge.is_reverse else edge.payload[0] for edge in chain]
        whole = np.concatenate([parts[0][:1], *(part[1:] for part in parts)])
        done.append((whole, any(edge.payload[1] for edge in chain)))
    return done


def write_dxf(path: Path, points: np.ndarray, unit: str, *, closed: bool) -> None:
    """Write a polygon as one polyline, in a drawing that states its unit."""
    ezdxf = _ezdxf()
    drawing = ezdxf.new()
    drawing.header["$INSUNITS"] = _CODE_OF[unit]
    drawing.modelspace().add_lwpolyline(points.tolist(), close=closed)
    drawing.saveas(str(path))
