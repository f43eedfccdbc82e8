"""Responses over time: the chapter's Figs. 9-18, or what there is of them for another grasp."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import AutoLocator, MaxNLocator

from .._integration import Trajectory
from .._mechanics import Grasp
from .._results import told_apart
from ._doors import guarded
from ._panels import Panel, panels
from ._panels3 import panels3
from ._style import MANY, Picture, save_figure, tidy
from ._views import how_it_ended, single, visible

_COLUMNS = 3
# How many names stand side by side in a legend, without and with long words among them, and the height of a
# row of them as a share of the range of values.
_ABREAST, _LEGEND = (3, 2), 0.17
# The most letters of a word that is not long: three such fit beside each other.
_WORD = 7
# A line that lies on earlier ones, within this share of the panel's range, is dashed so that both are seen.
_ON, _DASHES = 0.01, ((0, (4, 4)), (0, (1.2, 6.8)))
# If numbers at the time axis have more characters than this, there is no room for all that matplotlib writes.
_SHORT = 5
# A run whose contacts have gone this share of their way in a tenth of the time gets a stretched time axis.
_SHARE = 0.9


@guarded
def responses(grasp: Grasp, trajectory: Trajectory, folder: str | Path | None = None) -> Figure:
    r"""Plot the responses of one run over time.

    For one finger under `control.Press` these are Figs. 9-18 of the chapter, with its numbers and
    symbols: $\Delta f$ [N], $\Delta\lambda$ [N], $(f_d/r) N_1$ [mN m], $s$ [mm], joint rates and
    object rate [rad/s], $R$ and $Q$ [m], $U$ [mJ]. For a pinch of two fingers under
    `control.Opposition`, those of Part 1 for both contacts: $f_i$ and $\lambda_i$ [N], $s_i$ [mm],
    $\Delta f_i$ and $\Delta\lambda_i$ [N], $\Delta N_i$ and $S_N$ [mN m], $U$ [mJ], the angles [rad]
    between $O_i P_i$ and $O_1 O_2$, motion of object and joints since the first saved time, $Q_i$ and
    $R_i$ [m]. For any other grasp: contact forces, rolling coordinates, rates, residuals. The energy balance
    is added if it was recorded.

    In space: position of the object, its orientation as the vector $\theta a$ of axis and angle in world
    axes, and joint angles, all since the first saved time; of each contact the normal force $f$, the size of
    the tangential one $|\lambda|$ and their ratio, the friction that rolling needs; velocity and spin of the
    object, joint rates, $Q$ and $|R|$.

    Where the contacts are nearly through with their motion in a tenth of the time, the time axis is
    stretched: linear at first, then logarithmic; its label says from when on, and a dotted line marks it. A
    line that lies on another one is dashed, so that both are seen; what is zero but for rounding is drawn as
    zero. If only one state was saved, or none, so that only the end of the run is known, it is drawn as dots.
    The title of a run that ended early says when, and its code.

    Args:
        grasp: The grasp that was simulated.
        trajectory: One run of it. Its recorded multipliers are used if there are any.
        folder: Where to write the figure too, as `responses.png`. Default: nowhere.

    Returns:
        The figure.

    Raises:
        ValueError: If the trajectory is a batch.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=0.1)
        >>> plotting.responses(grasp, run).axes[0].get_ylabel()
        '$\\Delta f$ [N]'
    """
    trajectory = visible(grasp, trajectory)
    ts, reached = single(trajectory)
    shown = panels3(grasp, trajectory) if grasp.spatial else panels(grasp, trajectory)
    rows = -(-len(shown) // _COLUMNS)
    figure = Picture(10.0, 2.05 * rows + 0.2)
    axes = figure.subplots(rows, _COLUMNS, sharex=True, squeeze=False).ravel()
    for i, (ax, panel) in enumerate(zip(axes, shown, strict=False)):
        _draw(ax, ts[reached], panel, reached)
        last = i + _COLUMNS >= len(shown)
        tidy(ax, xlabel="time $t$ [s]" if last else "", ylabel=panel.label, title=panel.title)
        ax.tick_params(labelbottom=last)
    if told := how_it_ended(trajectory, float(trajectory.stats.t_end)):
        figure.suptitle(f"ended at t = {float(trajectory.stats.t_end):.4g} s{told}", fontsize=10)
    for ax in axes[len(shown) :]:
        ax.remove()
    beyond = _stretch(axes[0], ts[reached], np.asarray(trajectory.states.s)[reached])
    if not beyond:
        _thin(axes[0])
    for ax in axes[: len(shown)] if beyond else ():
        if ax.get_xlabel():
            _, told = told_apart(ts[reached][0], beyond, least=2)
            ax.set_xlabel(f"time $t$ [s], logarithmic beyond {told} s", fontsize=9)
        ax.axvline(beyond, color="#BBBBBB", lw=0.7, ls=(0, (1, 3)), zorder=0)
    figure.align_ylabels()
    if folder is not None:
        save_figure(figure, folder, "responses.png")
    return figure


def _thin(ax: Axes) -> None:
    """Fewer marks along the shared time axis where their numbers are long, as of times far from zero."""
    # As many as there may be, whatever the layout.
    finest = AutoLocator().tick_values(*ax.get_xlim())
    if max(map(len, ax.xaxis.get_major_formatter().format_ticks(list(finest))), default=0) > _SHORT:
        ax.xaxis.set_major_locator(MaxNLocator(3))


def _draw(ax: Axes, ts: np.ndarray, panel: Panel, reached: np.ndarray) -> None:
    values = np.reshape(panel.values, (len(reached), -1))[reached]
    peak = float(np.max(np.abs(values)))
    for k, line in enumerate(values.T):
        name = panel.names[k] if len(panel.names) > 1 else None
        mark, color = "o" if len(ts) == 1 else None, MANY[k % len(MANY)]
        ax.plot(
            ts, line, marker=mark, ls=_dashes(values, k, panel.least), color=color, lw=panel.width, label=name
        )
    if panel.least is not None:
        ax.set_ylim(-panel.least, panel.least)
    ax.margins(x=0.0, y=0.08)
    low, high = ax.get_ylim()
    if high - low < 1e-4 * peak:
        middle = 0.5 * (low + high)
        low, high = ax.set_ylim(middle - 0.1 * peak, middle + 0.1 * peak)
    if low <= 0.0 <= high:
        ax.axhline(0.0, color="#BBBBBB", lw=0.7, zorder=0)
    if len(panel.names) > 1:
        # Above all lines: no free place need be left among them.
        abreast = _ABREAST[any(len(name) > _WORD for name in panel.names if "$" not in name)]
        rows = -(-len(panel.names) // abreast)
        ax.set_ylim(low, high + _LEGEND * rows * (high - low))
        ax.legend(
            ncols=min(abreast, len(panel.names)),
            loc="upper right",
            borderaxespad=0.1,
            fontsize=7.5,
            frameon=False,
            handlelength=1.4,
            columnspacing=1.2,
            labelspacing=0.3,
        )


def _dashes(values: np.ndarray, k: int, least: float | None) -> Any:
    """The style of line k: solid, but dashed where it lies on earlier ones, which would be hidden."""
    spread, peak = float(np.nanmax(values) - np.nanmin(values)), float(np.nanmax(np.abs(values)))
    near = _ON * max(spread, 0.1 * peak, least or 1e-300)
    under = sum(float(np.nanmax(np.abs(values[:, k] - values[:, j]))) < near for j in range(k))
    return _DASHES[min(under, len(_DASHES)) - 1] if under else "-"


def _stretch(ax: Axes, ts: np.ndarray, s: np.ndarray) -> float | None:
    """Stretch the shared time axis where nearly all rolling happens in the first tenth of it.

    Returns the time [s] about which it goes over from linear to logarithmic, or None.
    """
    rolled = np.append(0.0, np.cumsum(np.abs(np.diff(s, axis=0)).sum(axis=1)))
    start, whole = ts[0], ts[-1] - ts[0]
    early = ts[np.searchsorted(rolled, _SHARE * rolled[-1])] - start
    if not 0.0 < early < 0.1 * whole:
        return None
    ax.set_xscale(
        "function",
        functions=(lambda t: np.arcsinh((t - start) / early), lambda u: start + early * np.sinh(u)),
    )
    powers = np.floor(np.log10([early, whole]))
    steps = 10.0 ** np.arange(powers[0], powers[1] + 1)
    marks = np.array([0.0, *(k * step for step in steps for k in (1, 3))])
    ax.set_xticks(start + marks[marks <= whole], told_apart(*(start + marks[marks <= whole]), least=3))
    ax.set_xlim(start, ts[-1])
    return float(start + early)
