"""Outlines in DXF files; the only file that imports ezdxf.

Everything here is in the drawing's own unit; `scale` is the caller's statement of it, in metres, and is
compared with what the drawing says of itself. A path of straight pieces gives its corners; one with curved
pieces gives points at equal distances along a polygon that follows it within 1e-7 of the drawing's size.
`_files` calls the reader and the writer; `_svg` has the like for SVG.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ._drawing import check_scale, finite, reading, without_outline
from ._extra import missing
from ._outline import even, filled_polygon, without_repeats

# Least angles [rad] of a corner: between straight pieces, and in a polygon along a curve.
_ANY, _ALONG = 1e-9, 0.1
# Of how many pieces ezdxf makes an arc, and by how many halvings a span of a spline: with these the pieces
# are nearer to the curve than the polygon that follows them.
_PIECES = {"segments": 64, "level": 10}
# Least rise of an outline from the drawing's plane, relative to the drawing's size, that is more than a slip.
_RISE = 1e-3
# A vertex of a polyline that only frames the curve fitted to it.
_FRAME = 16
# Metres in the unit that a drawing states by its code ($INSUNITS); further down the codes that are written.
_CODES = {
    **{1: 0.0254, 2: 0.3048, 3: 1609.344, 4: 1e-3, 5: 1e-2, 6: 1.0, 7: 1e3, 8: 2.54e-8, 9: 2.54e-5},
    **{10: 0.9144, 11: 1e-10, 12: 1e-9, 13: 1e-6, 14: 0.1, 15: 10.0, 16: 100.0, 17: 1e9},
    **{18: 1.495978707e11, 19: 9.4607304725808e15, 20: 3.0856775814913673e16},
    # Foot, inch, yard and mile of the survey of the United States.
    **{21: 1200 / 3937, 22: 100 / 3937, 23: 3600 / 3937, 24: 6_336_000 / 3937},
}
# Kinds of a DXF's entities that are outlines, or parts of one.
_CURVES = ("LWPOLYLINE", "POLYLINE", "SPLINE", "ARC", "CIRCLE", "ELLIPSE", "LINE")
_CODE_OF = {"in": 1, "mm": 4, "cm": 5, "m": 6, "um": 13}


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
    with reading(path):
        drawing = ezdxf.readfile(str(path))
        unit = int(drawing.header.get("$INSUNITS", 0))
        pieces = _pieces(drawing.modelspace(), drawing.layers)
        tracks = [ezdxf.path.make_path(piece, **_PIECES) for piece in pieces]
    check_scale(scale, _CODES.get(unit), path)
    # A line from a point to itself shows nothing.
    tracks = [track for track in tracks if len(set(track.control_vertices())) > 1]
    if not tracks:
        raise without_outline(path)
    corners = [(v.x, v.y) for track in tracks for v in track.control_vertices()]
    corners = finite(np.array(corners), path)
    size = float(np.linalg.norm(np.ptp(corners, axis=0)))
    rise = max(np.ptp([v.z for v in track.control_vertices()]) for track in tracks)
    if not rise <= _RISE * max(size, rise):
        raise ValueError(
            f"argument path must name a drawing in the plane of x and y, but an outline of {path.name} rises "
            f"by {rise:.4g} along z"
        )
    # Relative to the drawing: polygons leave curves by half of 1e-7 of its size, and ends within 1e-6 meet.
    joined = _joined([_flat(track, 5e-8 * size) for track in tracks], 1e-6 * size)
    outlines = []
    for line, curved in joined:
        closed = bool(np.linalg.norm(line[0] - line[-1]) <= 1e-6 * size)
        line = without_repeats(line[:-1] if closed else line, closed=closed)
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
        around: The layer of the block; its parts on layer "0" count as on that.
    """
    from ezdxf.xclip import XClip

    for entity in entities:
        name = around if entity.dxf.layer == "0" else entity.dxf.layer
        layer = layers.get(name) if name in layers else None
        if entity.dxf.get("invisible", 0) or (layer is not None and layer.is_frozen()):
            continue
        # A block on a layer that is off, unlike on a frozen one, shows what it has on other layers.
        if entity.dxftype() == "INSERT":
            clip = XClip(entity)
            if clip.has_clipping_path and clip.is_clipping_enabled:
                raise ValueError(f"block {entity.dxf.name!r} is clipped")
            for block in entity.multi_insert():
                yield from _pieces(block.virtual_entities(), layers, name)
        elif entity.dxftype() in _CURVES and (layer is None or layer.is_on()):
            yield from _plain(entity)


def _plain(curve: Any) -> Iterator[Any]:
    """A curve as it is shown: a polyline without what frames it; a mesh, which is written as one, is none.

    ezdxf follows splines past their ends whose knots do not repeat there.
    """
    if curve.dxftype() == "POLYLINE":
        if curve.is_polygon_mesh or curve.is_poly_face_mesh:
            return
        curve.vertices[:] = [vertex for vertex in curve.vertices if not vertex.dxf.flags & _FRAME]
    if curve.dxftype() == "SPLINE" and len(curve.control_points):
        _clamp(curve)
    elif curve.dxftype() == "SPLINE":
        points = np.array(curve.fit_points, float)
        if not len(points):
            return
        if curve.closed and np.any(points[0] != points[-1]):
            raise ValueError("a closed spline has no control points")
        # Of a point twice in a row the second counts for nothing; ezdxf would divide by its distance.
        curve.fit_points = without_repeats(points, closed=False)
        if len(curve.fit_points) < 2:
            return
    yield curve


def _clamp(spline: Any) -> None:
    """Give a spline knots that repeat at both its ends, and the control points of the same curve by these."""
    from scipy.interpolate import BSpline, make_interp_spline

    degree, count, knots = spline.dxf.degree, len(spline.control_points), np.array(spline.knots, float)
    if len(knots) != count + degree + 1:
        return  # ezdxf says so, or chooses knots where there are none
    low, high = knots[degree], knots[count]
    if np.all(knots[:degree] == low) and np.all(knots[count:] == high):
        return
    # A rational spline is a plain one of its weights and of its weighted points.
    weights = np.array(spline.weights, float) if len(spline.weights) else np.ones(count)
    points = np.array(spline.control_points, float).reshape(count, 3) * weights[:, None]
    curve = BSpline(knots, np.column_stack([points, weights]), degree)
    inner = knots[(knots > low) & (knots < high)]
    clamped = np.concatenate([np.full(degree + 1, low), inner, np.full(degree + 1, high)])
    at = np.array([clamped[i + 1 : i + degree + 1].mean() for i in range(len(clamped) - degree - 1)])
    same = make_interp_spline(at, curve(at), k=degree, t=clamped).c
    spline.knots, spline.control_points = clamped - low, same[:, :3] / same[:, 3:]
    spline.weights = same[:, 3] if len(spline.weights) else []


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
