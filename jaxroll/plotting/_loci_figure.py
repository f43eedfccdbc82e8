"""The curves that contacts trace on two surfaces (Fig. 20)."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._analysis import Loci, loci as loci_of
from .._integration import Trajectory
from .._mechanics import check_spatial, Grasp
from ._doors import guarded
from ._scene3 import tip_name
from ._style import CYCLE, LOCUS_OBJECT, LOCUS_TIP, MM, Picture, save_figure, tidy
from ._views import single

_ROWS = (
    ("Normal curvature", r"$\kappa_n$ [1/mm]", "normal_curvature"),
    ("Geodesic curvature", r"$\kappa_g$ [1/mm]", "geodesic_curvature"),
    ("Geodesic torsion", r"$\tau_g$ [1/mm]", "geodesic_torsion"),
    ("Torsion", r"$\tau$ [1/mm]", "torsion"),
)
_WIDTH, _HEIGHT = 4.2, 1.7
# Below this share of a contact's greatest speed it all but rests, and its locus has no curvature.
_SLOW = 0.02
# Share of a locus whose values must be seen, and how far the axis goes beyond these values, over their range.
# Not all are shown, since towards a turning point curvature and torsion grow beyond all bounds.
_SEEN, _BEYOND = 0.85, 0.35
# A locus that bends by less than this angle is straight.
_STRAIGHT = 1e-3
# Below this share of the arclength, a difference is what floating-point arithmetic leaves over.
_ROUNDING = 1e-13
_SMALL = 1e-3


@guarded
def loci_figure(grasp: Grasp, trajectory: Trajectory, folder: str | Path | None = None) -> Figure:
    r"""Plot the loci of all contacts on both surfaces as curves: a column for each contact.

    Above, arclengths over time, and their difference, which A-2 says is zero: the error of a run. Below, over
    the arclength, normal and geodesic curvature, geodesic torsion, and the torsion of the curve in space.
    The outward normals of the bodies oppose each other, so that under rolling without spin about the normal
    the geodesic curvatures are opposite numbers. Where a contact turns back its locus has a tip, and
    curvatures are not finite; they are left out where its speed is below 2 % of its greatest.

    Args:
        grasp: The grasp that was simulated, in space.
        trajectory: One run of it.
        folder: Where to write the figure too, as `loci.png`. Default: nowhere.

    Returns:
        The figure.

    Raises:
        ValueError: If the grasp lives in the plane, or the trajectory is a batch.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> grasp, state = jxr.scenes.turntable()
        >>> run = jxr.simulate(grasp, state, t1=0.2, ts=5)
        >>> plotting.loci(grasp, run).axes[2].get_ylabel()
        '$\\kappa_n$ [1/mm]'
    """
    check_spatial(grasp)
    _, reached = single(trajectory)
    if reached.sum() < 2:
        raise ValueError("argument trajectory must hold two states or more for a locus, but held one")
    found, contacts = loci_of(grasp, trajectory), len(grasp.contacts)
    figure = Picture(0.6 + _WIDTH * contacts, 0.4 + _HEIGHT * (2 + len(_ROWS)))
    axes = figure.subplots(2 + len(_ROWS), contacts, squeeze=False)
    for c, column in enumerate(axes.T):
        _lengths(column[:2], found, c, reached)
        _curves(column[2:], found, c)
        for ax in column:
            ax.margins(x=0.0)
            ax.set_title(_title(ax.get_title(loc="left"), c, contacts), fontsize=9.5, loc="left")
            if c:
                ax.set_ylabel("")
    tip = tip_name(grasp)
    names = (f"locus on the {tip}", "locus on the object")
    handles = axes[0, 0].get_lines()[:2]
    figure.legend(handles, names, loc="outside lower center", ncols=2, fontsize=8.5, frameon=False)
    figure.align_ylabels()
    if folder is not None:
        save_figure(figure, folder, "loci.png")
    return figure


def _lengths(axes: np.ndarray, found: Loci, c: int, reached: np.ndarray) -> None:
    """Arclengths and their difference over time."""
    above, below = axes
    ts = np.asarray(found.ts)[reached]
    tip, body = (np.asarray(locus.arclength)[c, reached] for locus in (found.tip, found.object))
    _pair(above, (ts, ts), (MM * tip, MM * body))
    tidy(above, ylabel="arclength [mm]", title="Arclengths")
    above.tick_params(labelbottom=False)
    off, unit = _in_powers(tip - body)
    below.plot(ts, off, color=CYCLE[1], lw=0.8)
    below.axhline(0.0, color="#BBBBBB", lw=0.7, zorder=0)
    label = rf"$s_\mathrm{{tip}} - s_\mathrm{{obj}}$ [{unit}]"
    rounding = np.abs(tip - body).max() < _ROUNDING * body.max()
    title = "Their difference (rounding level)" if rounding else "Their difference"
    tidy(below, xlabel="time $t$ [s]", ylabel=label, title=title)


def _curves(axes: np.ndarray, found: Loci, c: int) -> None:
    """Curvatures and torsions over the arclength."""
    pair = found.tip, found.object
    # Where nothing rolls there is nothing to show: the axes are those of a locus of 1 mm.
    whole = MM * max(float(np.nanmax(np.asarray(locus.arclength)[c])) for locus in pair) or 1.0
    speed = np.asarray(found.object.speed)[c]
    moving = _moving(speed)
    for ax, (title, label, name) in zip(axes, _ROWS, strict=True):
        values = [np.where(moving, np.asarray(getattr(locus, name))[c] / MM, np.nan) for locus in pair]
        limits = _limits(np.concatenate(values), np.tile(speed, 2), _STRAIGHT / whole)
        scale, label = _powers(max(-limits[0], limits[1]), label)
        _pair(ax, [MM * np.asarray(locus.arclength)[c] for locus in pair], [scale * v for v in values])
        ax.set_ylim(*(scale * limits))
        ax.axhline(0.0, color="#BBBBBB", lw=0.7, zorder=0)
        last = name == _ROWS[-1][-1]
        tidy(ax, xlabel="arclength [mm]" if last else "", ylabel=label, title=title)
        ax.set_xlim(0.0, whole)
        ax.tick_params(labelbottom=last)


def _moving(speed: np.ndarray) -> np.ndarray:
    """Where a contact does not all but rest."""
    return np.isfinite(speed) & (speed > _SLOW * float(np.nanmax(speed, initial=0.0)))


def _pair(ax: Axes, xs, ys) -> None:
    # The curves may coincide: both must be seen.
    ax.plot(xs[0], ys[0], color=LOCUS_TIP, lw=3.6, alpha=0.4)
    ax.plot(xs[1], ys[1], color=LOCUS_OBJECT, lw=1.5, ls=(0, (5, 2)))


def _powers(size: float, label: str) -> tuple[float, str]:
    """Small values in a power of ten that the label states."""
    power = 0 if size >= _SMALL else int(np.floor(np.log10(size)))
    return 10.0**-power, label.replace("[1", f"[$10^{{{power}}}$") if power else label


def _limits(values: np.ndarray, weights: np.ndarray, least: float) -> np.ndarray:
    """Ends of an axis that shows zero and values on most of the way, with a margin of at least `least`."""
    order = np.argsort(values)[: np.isfinite(values).sum()]
    values, share = np.append(values[order], 0.0), np.cumsum(weights[order])
    ends = 0.5 + np.array([-0.5, 0.5]) * _SEEN
    found = values[np.searchsorted(share, ends * share[-1])] if len(order) else np.zeros(2)
    low, high = min(found[0], 0.0), max(found[1], 0.0)
    margin = max(_BEYOND * (high - low), least)
    ends = max(low - margin, values.min() - 0.3 * margin), min(high + margin, values.max() + 0.3 * margin)
    return np.array(ends)


def _in_powers(values: np.ndarray) -> tuple[np.ndarray, str]:
    """Lengths in a power of ten of metres, and that unit."""
    peak = float(np.nanmax(np.abs(values), initial=0.0))
    if peak == 0.0:
        return values, "m"
    power = int(np.floor(np.log10(peak)))
    return values / 10.0**power, f"$10^{{{power}}}$ m"


def _title(title: str, c: int, contacts: int) -> str:
    return title if contacts == 1 else f"{title}, contact {c + 1}"
