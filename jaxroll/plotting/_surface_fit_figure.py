"""A surface made of points: what it looks like, how far the points lie from it, how it bends."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from ..geometry import SurfaceFit
from ..geometry.fitting import measured
from ._artists3 import Triangles
from ._meshes import mesh
from ._style import CONTACT, FINGER, GUIDE, MM, OBJECT_BODY, Picture, tidy
from ._tubes import camera, lit

# Directions from which the surface is seen: elevation and azimuth, in degrees.
_VIEWS = ((22.0, -60.0), (22.0, 120.0))
_LONG = 1.8  # times as broad as high
_ZOOM = 0.8  # leaves room for the labels
_BINS = 60
_SEEN = 99.5  # per cent of the numbers that a histogram shows
# Distances of labels and ticks from the axes of a cube, the largest that labels have, and what matplotlib
# adds to each [pt].
_LABEL, _TICK, _FARTHEST, _OWN = 12.0, 8.0, 36.0, 8.0
_WHITE = (1.0, 1.0, 1.0, 0.0)


def surface_figure(fit: SurfaceFit) -> Figure:
    """The surface [mm] from two sides, and histograms of distances [um] and principal curvatures [1/m]."""
    drawn = mesh(fit.surface)
    corners = MM * drawn.vertices[drawn.faces]
    # Of a long body, which leaves a square place half empty, the picture is lower.
    figure = Picture(11.0, 3.8 if _breadth(corners) > _LONG else 4.6)
    grid = figure.add_gridspec(2, 3, width_ratios=(1.0, 1.0, 0.95))
    for k, view in enumerate(_VIEWS):
        _seen(figure.add_subplot(grid[:, k], projection="3d", computed_zorder=False), corners, view)
    # `measured` is a program that the fit has compiled already.
    feet, normals, bends = measured(fit.surface, fit.feet)
    away = 1e6 * np.sum((np.asarray(fit.points) - feet) * normals, axis=1)
    _histogram(figure.add_subplot(grid[0, 2]), away, [], CONTACT)
    tidy(
        figure.axes[2],
        xlabel="distance of points, outward [\N{MICRO SIGN}m]",
        ylabel="points",
        title=f"{fit.report.points} points, {1e6 * fit.report.rms:.3g} \N{MICRO SIGN}m rms",
    )
    asked = fit.report.smallest_radius
    limits = [] if asked is None else [-1.0 / asked, 1.0 / asked]
    _histogram(figure.add_subplot(grid[1, 2]), bends.ravel(), limits, FINGER)
    low, high = fit.report.curvature
    title = f"{low:.4g} to {high:.4g} 1/m"
    tidy(figure.axes[3], xlabel="principal curvatures [1/m]", ylabel="points", title=title)
    return figure


def _breadth(corners: np.ndarray) -> float:
    """How many times as broad as high a body is as it is seen: the mean of the views."""
    found = []
    for view in _VIEWS:
        towards, _ = camera(*view)
        across = np.cross([0.0, 0.0, 1.0], towards) / np.hypot(towards[0], towards[1])
        found.append(np.ptp(corners @ across) / np.ptp(corners @ np.cross(towards, across)))
    return float(np.mean(found))


def _seen(ax: Any, corners: np.ndarray, view: tuple[float, float]) -> None:
    """The surface from one direction, lit."""
    towards, light = camera(*view)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    front = normals @ towards > 0.0
    colours = lit(OBJECT_BODY, normals[front], light, towards)
    surface = Triangles()
    surface.corners, surface.colours = corners[front], colours
    ax.add_artist(surface)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low, zoom=_ZOOM)
    ax.set_proj_type("ortho")
    ax.view_init(*view)
    ax.patch.set_visible(False)  # it would hide a label of the axes to the left
    size = (high - low) / max(high - low)
    for k, axis in enumerate((ax.xaxis, ax.yaxis, ax.zaxis)):
        # Labels move out along the two other axes, and by so much less as the body is short along these.
        across = max(np.delete(size, k))
        axis.set_pane_color(_WHITE)
        axis.labelpad = min(_LABEL / across, _FARTHEST) - _OWN
        axis.set_label_text(f"{'xyz'[k]} [mm]", fontsize=8, color=GUIDE)
        axis.set_tick_params(labelsize=7, color="#999999", pad=min(_TICK / across, 0.6 * _FARTHEST) - _OWN)
        axis.set_major_locator(_few(high - low))
        axis._axinfo["grid"] |= {"color": "#E2E5E8", "linewidth": 0.6}


def _few(extent: np.ndarray) -> Any:
    """Ticks at one step along all axes, some five along the longest."""
    step = float(extent.max()) / 5.0
    power = 10.0 ** np.floor(np.log10(step))
    return MultipleLocator(float(power * min((1.0, 2.0, 5.0, 10.0), key=lambda k: abs(k * power - step))))


def _histogram(ax: Axes, values: np.ndarray, limits: list[float], colour: str) -> None:
    """How often values occur, without the few farthest ones, and limits as lines."""
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, [100.0 - _SEEN, _SEEN])
    ends = (min([low, *limits]), max([high, *limits]))
    ax.hist(values, bins=_BINS, range=ends if ends[0] < ends[1] else None, color=colour, alpha=0.85)
    for limit in limits:
        ax.axvline(limit, color=GUIDE, lw=0.9, ls=(0, (4, 2)))
