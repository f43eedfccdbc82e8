"""Instants of a grasp in space, as the chapter's Figs. 19 and 20 draw them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import MultipleLocator
from mpl_toolkits.mplot3d import proj3d

from .._mechanics import Grasp
from ._drawing3 import Axes3, Drawing3
from ._forces3 import Pushes
from ._motion3 import Motion3D
from ._scene3 import looking, Scene3, scene3
from ._style import GUIDE, MM, Picture
from ._views3 import View

# Length of the longest force, over the diagonal of all that is drawn.
_LONGEST = 0.14
# What part of the picture the box of the axes fills at most, and what its labels take below and above.
_WIDE, _TALL, _LABELS = 0.76, 0.84, 0.16
# Heights of a row of the legend and of the title [inch].
_ROW, _TITLE = 0.19, 0.3
# Room is left for so many entries of a legend, and one for a load. The legend is in one column in figures
# narrower than `_NARROW` [inch], in two below `_BROAD`, else in four.
_ENTRIES, _NARROW, _BROAD = 7, 5.4, 8.0
# Size of the letters of a legend [pt], or less where it would be wider than this share of the figure.
_SIZE, _FULL = 8.0, 0.96


def snapshots3(
    grasp: Grasp,
    motion: Motion3D,
    picks: Sequence[int] = (-1,),
    *,
    titles: Sequence[str] = ("",),
    forces: Pushes | None = None,
    view: View | None = None,
    size: float = 6.0,
) -> Figure:
    """Draw a spatial grasp at some instants side by side, with the loci of the contacts on both surfaces.

    Each locus lies on its own body, where that body is at the instant; rolling makes them touch with a common
    tangent at the contact. The part of a locus on the far side of its body is dotted.

    Args:
        grasp: What is drawn.
        motion: Its motion.
        picks: Which of the times reached; -1 is the last. Loci are drawn up to each.
        titles: One for each.
        forces: Forces on the object to draw.
        view: How to look at it.
        size: Width of each in inches.

    Raises:
        ValueError: If grasp and motion do not belong together, a pick is out of range, or a surface cannot
            be drawn.
    """
    view = View() if view is None else view
    motion, rows = motion.reached()
    instants = [index(at, motion.times) for at in picks]
    scene = scene3(grasp, motion, links=view.links)
    arrows = None if forces is None else scaled(scene, forces, rows)
    loaded = arrows is not None and arrows.load is not None
    figure, axes = stage(scene, facing(scene, view), size, columns=len(instants), loaded=loaded)
    for k, (ax, instant, title) in enumerate(zip(axes, instants, titles, strict=True)):
        drawing = Drawing3(ax, scene, arrows=arrows)
        drawing.show(instant)
        if title:
            heading(figure, title, (k + 0.5) / len(instants))
    legend(figure, drawing, instants)
    return figure


def facing(scene: Scene3, view: View) -> tuple[float, float]:
    """Elevation and azimuth of the camera, in degrees."""
    elevation, azimuth = looking(scene)
    given = view.elevation, view.azimuth
    return elevation if given[0] is None else given[0], azimuth if given[1] is None else given[1]


def index(at: int, times: int) -> int:
    """A row of the motion, counted from the front."""
    if not -times <= at < times:
        raise ValueError(f"argument at must be the number of one of {times} times, but was {at}")
    return at % times


def scaled(scene: Scene3, forces: Pushes, rows: np.ndarray) -> Pushes:
    """Forces at these rows as arrows and where loads act, in mm; the longest is a share of the picture."""
    shape, contacts = forces.contacts.shape, len(scene.on_object)
    if len(shape) != 3 or shape[::2] != (contacts, 3) or shape[1] <= rows[-1]:
        raise ValueError(f"argument forces must have shape ({contacts}, t, 3), but had shape {shape}")
    forces = forces.rows(rows)
    peak, longest = forces.peak, _LONGEST * float(np.linalg.norm(scene.corners[1] - scene.corners[0]))
    size = longest / peak if peak > 0.0 else 0.0
    if forces.load is None or forces.at is None:
        return Pushes(size * forces.contacts, scale=size)
    return Pushes(size * forces.contacts, size * forces.load, MM * forces.at, size)


def stage(
    scene: Scene3,
    view: tuple[float, float],
    size: float,
    azimuths: np.ndarray | None = None,
    *,
    columns: int = 1,
    loaded: bool = False,
) -> tuple[Picture, list[Axes3]]:
    """A figure and axes of equal scale that hold all of a scene, from all azimuths of the camera.

    The legend has room for one entry more if a load is drawn (`loaded`).
    """
    low, high = scene.corners
    figure = Picture(columns * size, size)
    # The layout of `Picture` does not know what axes in space take up; all is placed by hand below.
    figure.set_layout_engine("none")
    axes = [_axes(figure, scene.corners) for _ in range(columns)]
    turns = view[1:] if azimuths is None else azimuths
    width, height = np.max([_spans(axes[0], view[0], float(azimuth)) for azimuth in turns], axis=0)
    zoom = min(_WIDE / width, _TALL / height)
    # Each is square; the figure is as high as what is seen of them.
    seen = size * (zoom * height + _LABELS)
    # -(-a // b) is a / b rounded up.
    below = _ROW * -(-(_ENTRIES + loaded) // _columns(columns * size))
    whole = below + seen + _TITLE
    figure.set_size_inches(columns * size, whole)
    for k, ax in enumerate(axes):
        ax.set_box_aspect(high - low, zoom=zoom)
        ax.view_init(*view)
        ax.set_position((k / columns, (below + 0.5 * (seen - size)) / whole, 1.0 / columns, size / whole))
    return figure, axes


def _axes(figure: Picture, corners: np.ndarray) -> Axes3:
    low, high = corners
    ax: Axes3 = figure.add_axes(
        (0.0, 0.0, 1.0, 1.0), projection="3d", computed_zorder=False, facecolor="none"
    )
    ax.set_proj_type("ortho")
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low)
    for axis, name in zip((ax.xaxis, ax.yaxis, ax.zaxis), "xyz", strict=True):
        axis.set_pane_color((0.965, 0.97, 0.975, 1.0))
        axis.line.set_color("#999999")
        axis.set_label_text(f"{name} [mm]", fontsize=9, color=GUIDE)
        axis.labelpad = 2
        axis.set_tick_params(labelsize=8, color="#999999", pad=1)
        axis.set_major_locator(MultipleLocator(tick_step(high - low)))
        axis._axinfo["grid"] |= {"color": "#E2E5E8", "linewidth": 0.6}
    return ax


def _spans(ax: Axes3, elevation: float, azimuth: float) -> np.ndarray:
    """Width and height of the box of the axes, as shares of the picture."""
    # The projection is that of the axes as they are turned now.
    ax.view_init(elevation, azimuth)
    ends = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
    corners = np.array([[ends[0, i], ends[1, j], ends[2, k]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    x, y, _ = proj3d.proj_transform(*corners.T, ax.get_proj())  # pyright: ignore[reportCallIssue]
    return np.array([np.ptp(x) / ax.viewLim.width, np.ptp(y) / ax.viewLim.height])


def tick_step(spans: np.ndarray) -> float:
    """A round distance between ticks, the same on all axes."""
    rough = float(spans.max()) / 6.0
    power = 10.0 ** np.floor(np.log10(rough))
    return power * min((1.0, 2.0, 5.0, 10.0), key=lambda k: abs(np.log(k * power / rough)))


def legend(figure: Picture, drawing: Drawing3, instants: Sequence[int]) -> None:
    """Put a legend below the axes, of what is drawn at the instants that are shown."""
    handles, names = zip(*drawing.legend(instants), strict=True)
    anchor = (0.5, 0.03 / figure.get_figheight())
    columns = _columns(figure.get_figwidth())
    look = {"loc": "lower center", "frameon": False, "bbox_to_anchor": anchor}
    shown = figure.legend(handles, names, ncols=columns, fontsize=_SIZE, **look)
    across = shown.get_window_extent(figure.agg.get_renderer()).width / figure.bbox.width
    if across > _FULL:
        shown.remove()
        figure.legend(handles, names, ncols=columns, fontsize=_SIZE * _FULL / across, **look)


def _columns(width: float) -> int:
    """How many columns the legend has in a figure of this width [inch]."""
    return 1 if width < _NARROW else 2 if width < _BROAD else 4


def heading(figure: Picture, text: str, x: float, **style: Any) -> Text:
    """Text at the top of a figure."""
    y = 1.0 - 0.14 / figure.get_figheight()
    style = {"ha": "center", "fontsize": 11, "color": GUIDE} | style
    return figure.text(x, y, text, va="top", **style)
