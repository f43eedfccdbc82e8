"""What both phase pictures have: the path with its ends, the bar of energies, and where a contour ends."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.ticker import MaxNLocator

from .._mechanics import Grasp
from .._results import told_apart
from ..geometry import AbstractContour
from ._style import CONTACT, GUIDE, MM

# Length of the links of a gripper [m]. Numbers beside a bar of energies that reach this power of ten, or are
# as small, have the power on its label.
_SIZE, _POWERS = 0.04, 5


def least_of(grasp: Grasp, gripper: float) -> float:
    """The smallest half width of a picture: a gripper's, or less in proportion for smaller fingers."""
    return gripper * min(1.0, max(float(finger.size) for finger in grasp.fingers) / _SIZE)


def draw_path(ax: Axes, path: np.ndarray, goal: np.ndarray, ts: np.ndarray) -> None:
    """A path, shape (t, 2), with start, end and the equilibria `goal`, shape (0 or 1, 2) [m or m/s]."""
    ax.plot(*(MM * path.T), color=CONTACT, lw=1.4, label="path", zorder=3)
    start, end = told_apart(ts[0], ts[-1], least=3)
    dot = {"ls": "none", "marker": "o", "mec": CONTACT, "mew": 1.4, "zorder": 5}
    ax.plot(*(MM * path[:1].T), **dot, ms=7, mfc="white", label=f"start, {start} s")
    ax.plot(*(MM * path[-1:].T), **dot, ms=7, mfc=CONTACT, label=f"end, {end} s")
    if goal.size:
        ax.plot(*(MM * goal.T), "+", color=GUIDE, ms=13, mew=1.5, zorder=6, label="equilibrium")


def energy_levels(energy: np.ndarray, about: int) -> np.ndarray:
    """Round numbers, evenly spaced, that enclose all energies; some `about` steps."""
    low, high = float(np.nanmin(energy)), float(np.nanmax(energy))
    locator = MaxNLocator(about, steps=[1, 2, 5, 10])
    return np.asarray(locator.tick_values(low, max(high, low + 1e-9 * abs(high))))


def energy_bar(ax: Axes, levels: np.ndarray, label: str) -> Colorbar:
    """The bar of the filled levels that were drawn last on an axes, with round numbers."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    every = 1 if len(levels) <= 11 else 2
    bar = figure.colorbar(ax.collections[0], ax=ax, shrink=0.9, ticks=levels[::every])
    # As many digits as tell two levels apart; of tiny and of huge ones the power of ten is on the label.
    peak, step = (int(np.floor(np.log10(x) + 1e-9)) for x in (np.abs(levels).max(), levels[1] - levels[0]))
    power = 0 if -_POWERS <= peak < _POWERS else peak
    digits = max(0, power - step)
    bar.ax.set_yticklabels([f"{level / 10.0**power:.{digits}f}" for level in levels[::every]])
    bar.set_label(label.replace("[", f"[$10^{{{power}}}$ ") if power else label, fontsize=9)
    bar.ax.tick_params(labelsize=8, length=3, width=0.7, color="#777777")
    bar.outline.set(linewidth=0.7, edgecolor="#777777")  # pyright: ignore
    return bar


def on_contour(contour: AbstractContour, s: np.ndarray) -> np.ndarray:
    """Which arclengths lie on a contour."""
    ends = contour.domain()
    if contour.closed or ends is None:
        return np.ones(s.shape, bool)
    return (s >= float(ends[0])) & (s <= float(ends[1]))
