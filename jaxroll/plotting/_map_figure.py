"""A map over two parameters: which code, or how large a value, at each place."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, Locator, LogLocator, MaxNLocator, NullFormatter

from .._sweep import Parameters
from ._doors import guarded
from ._map_data import map_data, MapData, Side
from ._style import MANY, Picture, tidy

# Colours: of codes that say that all is well, of what was not worked out, and of other codes in their order,
# the warm ones first.
WELL, NOTHING = "#DCEBF5", "#C8CCD0"
_WARM = ("#D55E00", "#CC79A7", "#E69F00", "#882255", "#999933", "#AA4499")
CODE_COLOURS = (*_WARM, *(each for each in MANY if each not in _WARM))
SCALE = "viridis"
_GOOD = ("successful", "stable", "asymptotically stable", "true")
# Verdicts of what holds although not every disturbance dies out: blues.
_HOLDS = {"neutral": "#56B4E9", "undamped": "#0072B2"}
# The code of runs that a store does not hold yet.
_MISSING = "not stored"
# Samples are dots of the area `_DOT` [pt^2], or of a quarter of it where there are more than `_MANY`.
_DOT, _MANY = 26.0, 2000
# A logarithmic axis has numbers at 1, 2 and 5 of every decade, if its values span a factor between these.
_FEW_NUMBERS, _MANY_NUMBERS = 5.0, 100.0


@guarded
def parameter_map(
    parameters: Parameters,
    values: Any,
    *,
    x: str | None = None,
    y: str | None = None,
    at: Mapping[str, float] | None = None,
    label: str = "",
    title: str = "",
    ax: Axes | None = None,
) -> Figure:
    """Draw a code or a value over two parameters: cells of a grid, or dots where samples are.

    An axis whose steps are even in the logarithm is drawn so. Cells without a number are grey. Of codes what
    holds is blue, the paler the better, and what fails has warm colours first.

    Args:
        parameters: Of the runs.
        values: One number, truth value or code for each row, as `sweep` returns them or in the grid's shape;
            of a stored sweep an array of its table.
        x: Which parameter runs along the lower side. Default: the first that changes.
        y: Which one along the left side. Default: the next one, along another axis of a grid.
        at: Of a grid of more axes, where the other parameters are held, by name: the nearest value of the
            grid is taken. Default: the one in the middle.
        label: What the value is, with its unit.
        title: What stands above; where other parameters are held is told beside it.
        ax: Axes to draw on, with the legend of codes within them. Default: a new figure, with it below.

    Returns:
        The figure.

    Raises:
        ValueError: If there are no two parameters that change, or an argument does not fit.

    Example:
        >>> import numpy as np
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> grid = jxr.Parameters.grid(damping=np.geomspace(0.002, 0.02, 5), beta=[10.0, 20.0, 30.0])
        >>> plotting.parameter_map(grid, grid.damping * grid.beta, label="rate").axes[0].get_xlabel()
        'damping'
    """
    data = map_data(parameters, values, x=x, y=y, at=at)
    figure: Any = Picture(6.4, 4.6) if ax is None else ax.figure
    axes: Any = figure.add_subplot() if ax is None else ax
    _draw(axes, data, label, alone=ax is None)
    told = f"{title}; {data.held}" if title and data.held else title or data.held
    tidy(axes, xlabel=data.x.label, ylabel=data.y.label, title=told)
    return figure


def code_colours(codes: tuple[str, ...]) -> list[str]:
    """A colour for each code: pale where all is well, blue where it holds, grey where nothing is known yet.

    Others are of what fails, in warm colours as long as there are such.
    """
    plain = dict.fromkeys(_GOOD, WELL) | _HOLDS | {_MISSING: NOTHING}
    rest = iter(CODE_COLOURS * (1 + len(codes) // len(CODE_COLOURS)))
    return [plain.get(code) or next(rest) for code in codes]


def _draw(ax: Axes, data: MapData, label: str, *, alone: bool) -> None:
    look: dict[str, Any] = {"cmap": SCALE}
    if data.codes:
        colours = code_colours(data.codes)
        bounds = np.arange(len(colours) + 1) - 0.5
        look = {"cmap": ListedColormap(colours), "norm": BoundaryNorm(bounds, len(colours))}
    ax.set_facecolor(NOTHING)
    if data.gridded:
        edges = _edges(data.x), _edges(data.y)
        drawn = ax.pcolormesh(*edges, np.ma.masked_invalid(data.z), rasterized=True, **look)
    else:
        ax.set_facecolor("white")
        size = _DOT if data.z.size <= _MANY else _DOT / 4.0
        known = np.isfinite(data.z)
        ax.scatter(data.x.values[~known], data.y.values[~known], s=size, c=NOTHING, lw=0.0)
        drawn = ax.scatter(
            data.x.values[known],
            data.y.values[known],
            s=size,
            c=data.z[known],
            ec="#55555599",
            lw=0.3,
            **look,
        )
    ax.set(xscale="log" if data.x.log else "linear", yscale="log" if data.y.log else "linear")
    for axis, side in ((ax.xaxis, data.x), (ax.yaxis, data.y)):
        if side.log:
            _number(axis, side.values.max() / side.values.min())
    if not data.codes:
        bar = ax.figure.colorbar(drawn, ax=ax, pad=0.02)
        bar.set_label(label, fontsize=9)
        bar.ax.tick_params(labelsize=8, length=3, width=0.7, color="#777777")
        bar.outline.set_linewidth(0.5)  # pyright: ignore[reportCallIssue]
    entries = _entries(data)
    if entries:
        # On the caller's axes the legend goes within: below, legends of several maps would cover each other.
        below = {"loc": "outside lower center", "frameon": False}
        where: dict[str, Any] = below if alone else {"loc": "upper right"}
        (ax.figure if alone else ax).legend(
            handles=entries,
            title=label if data.codes else None,
            ncols=min(len(entries), 3) if alone else 1,
            fontsize=8,
            title_fontsize=8,
            **where,
        )


def _number(axis: Axis, factor: float) -> None:
    """Plain numbers of one size at a logarithmic axis; `factor` is from its least value to its largest."""
    nice: Locator = MaxNLocator(6, steps=[1, 2, 5, 10])
    if factor >= _FEW_NUMBERS:
        nice = LogLocator(subs=(1.0, 2.0, 5.0) if factor <= _MANY_NUMBERS else (1.0,), numticks=9)
    axis.set_major_locator(nice)
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
    axis.set_tick_params(which="minor", length=2, width=0.5, color="#777777")


def _entries(data: MapData) -> list[Patch]:
    """Codes with their shares, and what grey means where something is grey."""
    share = lambda mask: f"{100.0 * np.mean(mask):.3g} %"  # noqa: E731
    entries = [
        Patch(fc=colour, ec="#888888", lw=0.4, label=f"{code}, {share(data.z == k)}")
        for k, (code, colour) in enumerate(zip(data.codes, code_colours(data.codes), strict=True))
    ]
    missing = ~np.isfinite(data.z)
    if missing.any():
        entries.append(Patch(fc=NOTHING, ec="#888888", lw=0.4, label=f"no number, {share(missing)}"))
    return entries


def _edges(axis: Side) -> np.ndarray:
    """Borders of the cells about the values: half way between two, on the axis' own scale."""
    seen = np.log(axis.values) if axis.log else axis.values
    middles = 0.5 * (seen[1:] + seen[:-1])
    edges = np.concatenate([[2.0 * seen[0] - middles[0]], middles, [2.0 * seen[-1] - middles[-1]]])
    return np.exp(edges) if axis.log else edges
