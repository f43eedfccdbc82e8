"""A map over two parameters as a page for a browser, where each place says what it is."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._sweep import Parameters
from ..io._paths import writable
from ._doors import guarded
from ._map_data import map_data, MapData
from ._map_figure import code_colours, NOTHING
from ._page import plotly_door
from ._page_parts import html_path, PAGE_FONT, WHOLE_WINDOW

_SCALE = "Viridis"


@guarded
def map_page(
    parameters: Parameters,
    values: Any,
    path: str | Path = "map.html",
    *,
    x: str | None = None,
    y: str | None = None,
    at: Mapping[str, float] | None = None,
    label: str = "",
    title: str = "Outcomes of a sweep",
) -> Path:
    """Write a code or a value over two parameters as one HTML file, to be zoomed and read in a browser.

    The file needs nothing else, no network either: plotly's script is within, 4.8 MB. Under the pointer stand
    both parameters, and the code or the value.

    Args:
        parameters: Of the runs.
        values: One number, truth value or code for each row, as `sweep` returns them or in the grid's shape.
        path: The file to write, ending in `.html`; its folder is made if need be.
        x: Which parameter runs along the lower side. Default: the first that changes.
        y: Which one along the left side. Default: the next one, along another axis of a grid.
        at: Of a grid of more axes, where the other parameters are held, by name, as for `parameter_map`.
        label: What the value is, with its unit.
        title: What stands above.

    Returns:
        The path that was written.

    Raises:
        ValueError: If there are no two parameters that change, or an argument does not fit.
        ImportError: Without the extra `viz`.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> grid = jxr.Parameters.grid(damping=[0.004, 0.006], beta=[10.0, 20.0, 30.0])
        >>> plotting.map_page(grid, grid.damping * grid.beta > 0.1, "map.html").name
        'map.html'
    """
    path = html_path(path)
    plotly, data = plotly_door(), map_data(parameters, values, x=x, y=y, at=at)
    writable(path)
    kind = plotly.Heatmap if data.gridded else plotly.Scattergl
    figure = plotly.Figure(data=[kind(_trace(data, label))], layout=_layout(data, title))
    config = {"displaylogo": False, "responsive": True, "scrollZoom": True}
    figure.write_html(path, include_plotlyjs=True, config=config, **WHOLE_WINDOW)
    return path


def _trace(data: MapData, label: str) -> dict[str, Any]:
    """The heat map of a grid, or the dots of samples."""
    sides = {"x": data.x.values, "y": data.y.values}
    what = f"{label or 'value'}: %{{z:.5g}}" if data.gridded else f"{label or 'value'}: %{{marker.color:.5g}}"
    colours = _colours(data, label)
    named: dict[str, Any] = {}
    if data.codes:
        words = np.asarray(data.codes)[data.z]
        named, what = {"text": words}, "%{text}"
    said = f"{data.x.label}: %{{x:.5g}}<br>{data.y.label}: %{{y:.5g}}<br>{what}<extra></extra>"
    # plotly writes NaN as null, for which it leaves a gap.
    z = np.where(np.isfinite(data.z), data.z, np.nan)
    if data.gridded:
        return sides | named | colours | {"z": z, "hovertemplate": said}
    marker = colours | {"color": z, "size": 6, "line": {"width": 0.3, "color": "#555555"}}
    return sides | named | {"mode": "markers", "marker": marker, "hovertemplate": said}


def _colours(data: MapData, label: str) -> dict[str, Any]:
    """Scale and bar: steps for codes."""
    bar: dict[str, Any] = {"title": {"text": label}, "outlinewidth": 0.5}
    if not data.codes:
        return {"colorscale": _SCALE, "colorbar": bar, "showscale": True}
    count = len(data.codes)
    steps = [[k / count, c] for k, c in enumerate(code_colours(data.codes))]
    ends = [[(k + 1) / count, c] for k, c in enumerate(code_colours(data.codes))]
    scale = [pair for two in zip(steps, ends, strict=True) for pair in two]
    low, high = ("zmin", "zmax") if data.gridded else ("cmin", "cmax")
    ticks = {"tickvals": list(range(count)), "ticktext": list(data.codes), "ticks": ""}
    return {
        "colorscale": scale,
        "colorbar": bar | ticks,
        "showscale": True,
        low: -0.5,
        high: count - 0.5,
    }


def _layout(data: MapData, title: str) -> dict[str, Any]:
    held = f"<br><sup>{data.held}</sup>" if data.held else ""
    side = {"showgrid": False, "zeroline": False, "ticks": "outside", "tickcolor": "#777777"}
    axes = {
        f"{name}axis": side | {"title": {"text": one.label}, "type": "log" if one.log else "linear"}
        for name, one in (("x", data.x), ("y", data.y))
    }
    return {
        "title": {"text": f"{title}{held}", "x": 0.5, "xanchor": "center", "font": {"size": 18}},
        "font": PAGE_FONT,
        "paper_bgcolor": "white",
        "plot_bgcolor": NOTHING if data.gridded else "white",
        "margin": {"l": 70, "r": 20, "t": 70, "b": 60},
        **axes,
    }
