"""A figure of matplotlib in words: every artist by its kind, what it shows, and how it looks.

Left out is what matplotlib derives itself: fonts, ticks that it chooses, where a layout engine puts axes.
"""

import collections
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import Collection, LineCollection
from matplotlib.colors import to_hex
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, Patch, Polygon
from matplotlib.spines import Spine
from matplotlib.text import Annotation, Text
from matplotlib.ticker import AutoLocator, NullLocator
from mpl_toolkits.mplot3d.art3d import Line3D

from jaxroll.plotting._artists3 import Triangles
from tests.recorded.compare import described

# Of a picture: labels that are put where there is room depend on the sizes of letters.
_INCH = "±0.02"


def figure(drawn: Figure, *, placed: bool = True) -> dict[str, Any]:
    """A figure; without `placed`, labels beside their points are left where they are."""
    width, height = drawn.get_size_inches()
    sizes = f"size in inches {_INCH}" if placed else "size in inches ±0.2"
    found: dict[str, Any] = {sizes: [round(float(width), 6), round(float(height), 6)]}
    found["dpi"] = float(drawn.dpi)
    found["colour"] = _colour(drawn.get_facecolor())
    titles = [text for text in [drawn._suptitle] if text is not None]  # pyright: ignore
    rest = [
        child for child in drawn.get_children() if not isinstance(child, Axes) and child is not drawn.patch
    ]
    found |= _named(titles + [child for child in rest if child not in titles], drawn, placed)
    for k, ax in enumerate(drawn.axes):
        title = ax.get_title(loc="left")
        # A list beside a drawing has its places, whatever labels the drawing has.
        told = axes(ax, placed=placed or not ax.axison)
        found[f"axes {k}" + (f" ({title})" if title else "")] = told
    return found


def axes(ax: Axes, *, placed: bool = True) -> dict[str, Any]:
    """One axes: limits, labels, and what is drawn on it."""
    space = hasattr(ax, "get_zlim")
    found: dict[str, Any] = {"title": ax.get_title(loc="left"), "drawn": ax.axison}
    for name in "xyz" if space else "xy":
        found[f"{name} axis"] = _axis(getattr(ax, f"{name}axis"), getattr(ax, f"get_{name}lim")())
    found["aspect"] = described(ax.get_aspect())
    found["shared"] = [
        len(list(group.get_siblings(ax))) for group in (ax.get_shared_x_axes(), ax.get_shared_y_axes())
    ]
    if (cells := ax.get_subplotspec()) is not None:
        grid = cells.get_gridspec()
        found["rows, columns"] = [[span.start, span.stop] for span in (cells.rowspan, cells.colspan)]
        found["grid"] = [*grid.get_geometry(), list(grid.get_height_ratios()), list(grid.get_width_ratios())]
    if space:
        view: Any = ax
        found["camera"] = described([float(view.elev), float(view.azim), float(view.roll)])
        found["box"] = described(np.asarray(view._box_aspect))
        found["projection"] = described(view._focal_length)
        found["place"] = described(np.array(ax.get_position().bounds))
    spines = {
        name: [spine.get_linewidth(), _colour(spine.get_edgecolor())] if spine.get_visible() else None
        for name, spine in ax.spines.items()
    }
    found["spines"] = {} if space else spines
    drawn = [
        child
        for child in ax.get_children()
        if not isinstance(child, Axis | Spine)
        and child is not ax.patch
        and not (isinstance(child, Text) and child in (ax.title, ax._left_title, ax._right_title))  # pyright: ignore
    ]
    return found | _named(drawn, ax, placed)


def _axis(axis: Axis, limits: tuple[float, float]) -> dict[str, Any]:
    label, ticks = axis.get_label(), axis.get_tick_params()
    kept = ("labelsize", "length", "width", "color", "direction", "labelbottom", "labelleft")
    found = {
        "label": label.get_text(),
        "size": label.get_fontsize(),
        "limits": described(np.array(limits)),
        "scale": axis.get_scale(),
        "ticks look": ", ".join(f"{name} {ticks[name]}" for name in kept if name in ticks),
    }
    locator = axis.get_major_locator()
    # A locator for logarithms chooses by itself as well.
    if not isinstance(locator, AutoLocator | NullLocator) and "Log" not in type(locator).__name__:
        inside = [x for x in locator() if min(limits) <= x <= max(limits)]
        found["ticks"] = described(np.array(inside, float))
        found["tick labels"] = [text.get_text() for text in axis.get_ticklabels()][:40]
    return found


def _named(children: list[Any], home: Any, placed: bool) -> dict[str, Any]:
    """Descriptions under names that say which artist it is."""
    counts: collections.Counter[str] = collections.Counter()
    found = {}
    for child in children:
        kind = type(child).__name__
        told = child.get_text() if isinstance(child, Text) else str(child.get_label() or "")
        if isinstance(child, Text) and not told:
            continue
        name = f"{kind} {counts[kind]}" + (f" ({told})" if told and not told.startswith("_") else "")
        counts[kind] += 1
        found[name] = artist(child, home, placed=placed)
    return found


def artist(one: Artist, home: Any = None, *, placed: bool = True) -> dict[str, Any]:
    """One artist."""
    found: dict[str, Any] = {"z-order": float(one.get_zorder()), "visible": one.get_visible()}
    if one.get_alpha() is not None:
        found["alpha"] = described(one.get_alpha())
    if home is not None and not isinstance(one, Legend):
        found["in"] = _frame(one, home)
    match one:
        case Line2D():
            found |= _line(one)
        case Text():
            found |= _text(one, placed)
        case Legend():
            found |= _legend(one)
        case ContourSet():
            found |= _contours(one)
        case Triangles():
            found |= _triangles(one)
        case Collection():
            found |= _collection(one)
        case Patch():
            found |= _patch(one)
    return found


def _frame(one: Artist, home: Any) -> str:
    """Whose coordinates an artist is in."""
    if one.axes is None:
        return "figure"
    ax: Any = one.axes
    known = {"data": ax.transData, "axes": ax.transAxes, "x": ax.get_xaxis_transform()}
    known["y"] = ax.get_yaxis_transform()
    mine = one.get_transform()
    for name, transform in known.items():
        if mine == transform:
            return name
    return "data" if mine.contains_branch(ax.transData) else "another"


def _line(line: Line2D) -> dict[str, Any]:
    data = line.get_data_3d() if isinstance(line, Line3D) else line.get_data()
    marked = line.get_marker() not in ("None", "none", "", None, " ")
    found: dict[str, Any] = {
        "data": described(np.array([np.asarray(row, float) for row in data]).T),
        "colour": _colour(line.get_color()),
        "width": float(line.get_linewidth()),
        "style": described(line._unscaled_dash_pattern),  # pyright: ignore
        "drawn": line.get_linestyle() not in ("None", "none", ""),
        "ends": [str(line.get_solid_capstyle()), str(line.get_dash_capstyle())],
    }
    if marked:
        found["marker"] = [
            str(line.get_marker()),
            float(line.get_markersize()),
            _colour(line.get_markerfacecolor()),
            _colour(line.get_markeredgecolor()),
            float(line.get_markeredgewidth()),
        ]
    return found


def _text(text: Text, placed: bool) -> dict[str, Any]:
    found: dict[str, Any] = {
        "text": text.get_text(),
        "size": text.get_fontsize(),
        "colour": _colour(text.get_color()),
        "set": [text.get_ha(), text.get_va(), float(text.get_rotation())],
    }
    if isinstance(text, Annotation):
        found["at"] = described(np.array(text.xy, float))
        found["counted in"] = str(text.anncoords)
        if placed:
            found["beside"] = described(np.array(text.xyann, float))
    else:
        # A layout engine moves headings up and down.
        found["x"] = described(float(text.get_position()[0]))
    return found


def _legend(legend: Legend) -> dict[str, Any]:
    handles = [handle for handle in legend.legend_handles if handle is not None]
    return {
        "entries": [text.get_text() for text in legend.get_texts()],
        "sizes": [text.get_fontsize() for text in legend.get_texts()],
        "columns": legend._ncols,  # pyright: ignore
        "frame": legend.get_frame_on(),
        "corner": described(legend._loc_real),  # pyright: ignore
        "outside": described(legend._outside_loc),  # pyright: ignore
        "handles": {
            f"{k} {type(handle).__name__}": {
                key: value
                for key, value in artist(handle).items()
                if key not in ("data", "corners", "visible")
            }
            for k, handle in enumerate(handles)
        },
    }


def _patch(patch: Patch) -> dict[str, Any]:
    found: dict[str, Any] = {
        "fill": _colour(patch.get_facecolor()),
        "edge": _colour(patch.get_edgecolor()),
        "width": float(patch.get_linewidth()),
        "style": described(patch.get_linestyle()),
    }
    if hasattr(patch, "ends"):  # an arrow in space
        found["corners"] = described(np.asarray(patch.ends))
    if isinstance(patch, FancyArrowPatch):
        style = patch.get_arrowstyle()
        found["head"] = [type(style).__name__, float(patch.get_mutation_scale())]
        found["shrunk"] = [float(patch.shrinkA), float(patch.shrinkB)]
        if "corners" not in found:
            found["corners"] = described(np.array(patch._posA_posB, float))  # pyright: ignore
    elif isinstance(patch, Polygon):
        found["corners"] = described(patch.get_xy())
    else:
        found["corners"] = described(patch.get_path().vertices)
    return found


def _triangles(many: Triangles) -> dict[str, Any]:
    return {
        "triangles": len(many.colours),
        "corners": described(many.corners.reshape(-1, 3)),
        "colours": described(many.colours),
        "softened": many.get_agg_filter() is not None,
    }


def _collection(many: Collection) -> dict[str, Any]:
    found: dict[str, Any] = {"widths": described(np.asarray(many.get_linewidths(), float)[:4])}
    if isinstance(many, LineCollection):
        found["lines"] = [described(np.asarray(line, float)) for line in many.get_segments()[:6]]
    found["faces"] = described(np.asarray(many.get_facecolor(), float)[:12])
    found["edges"] = described(np.asarray(many.get_edgecolor(), float)[:12])
    found["paths"] = {str(k): described(path.vertices) for k, path in enumerate(many.get_paths()[:8])}
    found["offsets"] = described(np.asarray(many.get_offsets(), float))
    return found


def _contours(lines: ContourSet) -> dict[str, Any]:
    """Levels and where their lines run; how many points a line has is matplotlib's choice."""
    paths = [path.vertices for path in lines.get_paths()]
    boxes = [[*np.min(xy, axis=0), *np.max(xy, axis=0)] if len(xy) else [np.nan] * 4 for xy in paths]
    return {
        "levels": described(np.asarray(lines.levels)),
        "filled": lines.filled,
        "boxes": {str(k): described(np.array(box, float)) for k, box in enumerate(boxes)},
        "faces": described(np.asarray(lines.get_facecolor(), float)[:12]),
        "edges": described(np.asarray(lines.get_edgecolor(), float)[:12]),
        "widths": described(np.asarray(lines.get_linewidths(), float)[:4]),
    }


def _colour(colour: Any) -> str:
    if isinstance(colour, str) and colour in ("none", "auto"):
        return colour
    return to_hex(colour, keep_alpha=True)
