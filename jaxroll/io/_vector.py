"""Outlines as drawings, SVG and DXF; the only file that imports svgpathtools and ezdxf.

Everything here is in the drawing's own unit; `scale` is the caller's statement of it, in metres, and is
compared with what the drawing says of itself. A path of straight pieces gives its corners; one with curved
pieces gives points at equal distances along it: of an SVG on the curve itself, of a DXF on a polygon that
follows it within 1e-7 of the drawing's size. `_files` calls the readers and writers.
"""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from .._results import shown
from ._extra import missing
from ._outline import chosen, even, filled_places, filled_polygon

# Least angles [rad] of a corner: between straight pieces, between any, and in a polygon along a curve.
_ANY, _SHARP, _ALONG = 1e-9, 0.02, 0.1
_FINE = 64  # intervals of the parameter of a curved piece, from which its length is summed
# Metres in the units in which an SVG may state its width; metres in a DXF's unit by the code that it states
# ($INSUNITS), and the code of each unit that is written.
_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72, "pc": 0.0254 / 6}
_CODES = {1: 0.0254, 2: 0.3048, 4: 1e-3, 5: 1e-2, 6: 1.0, 8: 2.54e-8, 9: 2.54e-5, 13: 1e-6, 14: 0.1}
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
        from svgpathtools import Document
    except ImportError:
        raise missing("svgpathtools") from None
    with _read(path):
        # `paths` applies the transforms of all groups; one path may hold several outlines.
        drawing = Document(str(path))
        pieces = [piece for whole in drawing.paths() for piece in whole.continuous_subpaths() if len(piece)]
    _check_scale(scale, _svg_scale(drawing.tree.getroot(), path), path)
    return [_along(piece, samples, fill) * np.array([1.0, -1.0]) for piece in pieces]


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
    """Metres in one unit of the drawing, or None where it states no length."""
    width, box = root.get("width", "").strip(), root.get("viewBox", "").replace(",", " ").split()
    size = _LENGTHS.get(width[-2:])
    if size is None:
        return None
    if len(box) != 4:  # without a viewBox one unit is a pixel of CSS
        return 0.0254 / 96
    with _read(path):
        return float(width[:-2]) * size / float(box[2])


def _check_scale(scale: float, stated: float | None, path: Path) -> None:
    """Raise where the drawing states a unit that differs from the caller's by more than rounding."""
    if stated is not None and abs(scale / stated - 1.0) > 1e-3:
        raise ValueError(
            f"argument unit must agree with {path.name}, which states that one unit is "
            f"{1e3 * stated:.6g} mm, but was {1e3 * scale:.6g} mm"
        )


def _along(piece: Any, samples: int, fill: bool) -> np.ndarray:
    """Corners of a path of straight pieces; of any other, points at equal distances on the curve itself.

    svgpathtools has points as complex numbers, x + iy.
    """
    closed = bool(piece.isclosed())
    if all(type(segment).__name__ == "Line" for segment in piece):
        corners = np.array([segment.start for segment in piece] + ([] if closed else [piece[-1].end]))
        corners = np.stack([np.real(corners), np.imag(corners)], axis=1)
        return filled_polygon(corners, samples, closed=closed, sharp=_ANY) if fill else corners
    # Length along the path against its parameter, which is the number of the piece plus the parameter within
    # it; then the parameters at equal lengths.
    t = np.linspace(0.0, 1.0, _FINE + 1)
    fine = np.array([[segment.point(x) for x in t] for segment in piece])
    steps = np.abs(np.diff(fine, axis=1)).ravel()
    along = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, along[-1], samples + 1)[:-1] if closed else np.linspace(0.0, along[-1], samples)
    if fill:
        # Directions at both ends of every piece, from its first and last thousandth.
        out = np.array([segment.point(1e-3) - segment.start for segment in piece])
        end = np.array([segment.end - segment.point(1.0 - 1e-3) for segment in piece])
        turn = np.abs(np.angle(out * np.conj(np.roll(end, 1))))
        turn[0] = turn[0] if closed else 0.0
        corners = along[::_FINE][:-1][turn > _SHARP]
        at = filled_places(float(along[-1]), corners, samples, closed=closed)
    place = np.interp(at, along, np.arange(len(along)) / _FINE)
    which = np.minimum(place.astype(int), len(piece) - 1)
    points = np.array([piece[i].point(x - i) for i, x in zip(which.tolist(), place.tolist(), strict=True)])
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
    drawing = ElementTree.Element(
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
    kinds = "LWPOLYLINE POLYLINE SPLINE ARC CIRCLE ELLIPSE LINE"
    with _read(path):
        drawing = ezdxf.readfile(str(path))
        unit = int(drawing.header.get("$INSUNITS", 0))
        tracks = [ezdxf.path.make_path(e, segments=8, level=8) for e in drawing.modelspace().query(kinds)]
    _check_scale(scale, _CODES.get(unit), path)
    tracks = [track for track in tracks if len(track)]
    if not tracks:
        raise ValueError(f"argument path must name a drawing with an outline, but {path.name} has none")
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
