"""A fingertip that was optimised, before and after: shape, condition (41), and what the grasp does."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .._integration import check_one_run, Trajectory
from .._results import check_instance
from ..design import Design
from ..geometry import AbstractContour, tabled
from ..stability import margin
from ._doors import guarded
from ._motion3 import rotation_vectors
from ._outlines import comb, OutlineSamples, sample
from ._style import CYCLE, GUIDE, MM, Picture, save_figure, tidy, TIP_FILL

# Arclengths at which a contour is drawn.
_PLACES = 2049
_NAMES = ("before", "after")
# Widths [inch] of a line in a legend with the space around it, and of a letter beside it.
_SIGN, _LETTER = 0.7, 0.075
_COLOURS = (CYCLE[4], CYCLE[0])
# Styles of line, one for each contact. The first few are plain; later ones have more and more dots between
# their dashes, and need a longer line in a legend to be seen whole.
_DASHES = ("-", "--", ":", "-.", *((0, (6, 2) + (1, 1.6) * dots) for dots in range(2, 6)))
_PLAIN = 4
# Titles and labels of the upper two panels, in the plane and in space, where places on surfaces do not say
# how far a contact has rolled.
_PANELS = (
    (
        ("Rolled by the contacts", r"rolled $\sigma_i$ [mm]"),
        ("Motion of the object", "object turned by [rad]"),
    ),
    (("Turn of the object", "object turned by [rad]"), ("Motion of the object", "object moved by [mm]")),
)
_FORCES = (
    ("Normal forces", "normal force $f_i$ [N]"),
    ("Friction that rolling needs", r"$|\lambda_i| / f_i$"),
)
# Margins beyond so many times the size of the fingertip are cut off: where it is flat, they are infinite.
_FAR = 6.0


@guarded
def design(design: Design, folder: str | Path | None = None) -> Figure:
    r"""Draw a design before and after: contours with combs of curvature, condition (41), the search.

    The comb's teeth stand on the outside where the contour is convex, to one scale for both contours, which a
    bar gives; the contact interval is drawn thick. The margin of (41) is $1/\kappa + n \cdot \gamma$ [mm]; it
    is cut off where the contour is nearly flat, and has no value where it is hollow.

    Args:
        design: From `design.optimise_fingertip`.
        folder: Where to write the figure too, as `design.png`. Default: nowhere.

    Returns:
        The figure: both contours [mm], margin over arclength [mm], cost over steps of every start.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> better = jxr.design.optimise_fingertip(jxr.Ellipse(0.02, 0.01), (-0.005, 0.005), steps=10)
        >>> len(plotting.design(better).axes)
        4
    """
    figure = Picture(11.0, 6.2)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.5, 1.0))
    left = grid[:, 0].subgridspec(1, 2)
    first = figure.add_subplot(left[0])
    shapes = [first, figure.add_subplot(left[1], sharex=first, sharey=first)]
    tips = [tabled(tip) for tip in (design.start, design.tip)]
    curves = [_curve(tip) for tip in tips]
    ends = np.asarray(design.interval)
    pads = [sample(tip, np.linspace(ends[0], ends[1], 257)) for tip in tips]
    peak = max(float(np.abs(curve.curvatures).max()) for curve in curves)
    tooth = 0.25 * max(float(np.ptp(curve.points, axis=0).max()) for curve in curves) / peak
    each = zip(shapes, tips, curves, pads, _NAMES, _COLOURS, strict=True)
    for ax, tip, curve, pad, name, colour in each:
        # The last point of a closed contour is the first again, to rounding: what fills it closes it.
        ring = curve.points[:-1] if tip.closed else curve.points
        ax.fill(*ring.T, fc=TIP_FILL, ec="none", alpha=0.6)
        _shape(ax, curve, pad, tooth, colour)
        tidy(ax, xlabel="X [mm]", ylabel="Y [mm]" if ax is first else "", title=f"Fingertip {name}")
    _scale_of_comb(first, tooth, peak)
    _margins(figure.add_subplot(grid[0, 1]), tips, ends)
    _search(figure.add_subplot(grid[1, 1]), np.asarray(design.history), design.chosen)
    if folder is not None:
        save_figure(figure, folder, "design.png")
    return figure


def _curve(tip: AbstractContour) -> OutlineSamples:
    domain = tip.domain()
    assert domain is not None, "a designed contour has ends"
    return sample(tip, np.linspace(float(domain[0]), float(domain[1]), _PLACES))


def _shape(ax: Axes, curve: OutlineSamples, pad: OutlineSamples, tooth: float, colour: str) -> None:
    ends, teeth = comb(curve, tooth)
    ax.plot(*teeth.T, color=colour, lw=0.5, alpha=0.7)
    ax.plot(*ends.T, color=colour, lw=0.8)
    ax.plot(*curve.points.T, color=GUIDE, lw=1.0)
    ax.plot(*pad.points.T, color=colour, lw=3.0, solid_capstyle="butt")
    ax.plot(0, 0, "o", ms=5, mfc="white", mec=GUIDE)
    ax.annotate("$O_i$", (0, 0), (-11, -9), textcoords="offset points", fontsize=9, ha="center")
    ax.set_aspect("equal")


def _scale_of_comb(ax: Axes, tooth: float, peak: float) -> None:
    """A bar as long as the tooth of a round curvature, in the upper left corner."""
    size = 10.0 ** np.floor(np.log10(peak))
    bend = float(max(k * size for k in (1.0, 2.0, 5.0) if k * size <= peak))
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    x, y = left + 0.03 * (right - left), high + 0.06 * (high - low)
    ax.set(xlim=(left, right), ylim=(low, high + 0.12 * (high - low)))
    ax.plot((x, x + tooth * bend), (y, y), color=GUIDE, lw=1.6, marker="|", ms=5)
    beside = {"xytext": (6, 0), "textcoords": "offset points", "va": "center", "fontsize": 8, "color": GUIDE}
    ax.annotate(rf"comb: $\kappa$ = {bend / MM:g} /mm", (x + tooth * bend, y), **beside)


def _margins(ax: Axes, tips: Sequence[AbstractContour], ends: np.ndarray) -> None:
    s = np.linspace(ends[0], ends[1], 257)
    values = []
    for tip in tips:
        bends, room = sample(tip, s).curvatures, MM * np.asarray(margin(tip, s))
        values.append(np.where(bends > 0.0, room, np.nan))
    # 1 / kappa has a pole where the contour is flat: beyond `reach` no line is drawn.
    reach = _FAR * max(float(np.abs(sample(tip, s).points).max()) for tip in tips)
    for value, name, colour in zip(values, _NAMES, _COLOURS, strict=True):
        shown = np.where(np.abs(value) < reach, value, np.nan)
        ax.plot(MM * s, shown, color=colour, lw=1.8, label=f"{name}, {np.nanmin(value):+.2f} at least")
    ax.axhline(0.0, color="#BBBBBB", lw=0.9, zorder=0)
    ax.legend(fontsize=8, frameon=False)
    title = r"Margin of (41): $1/\kappa + n\cdot\gamma > 0$ holds a plate"
    tidy(ax, xlabel="arclength s on the contact interval [mm]", ylabel="margin [mm]", title=title)


def _search(ax: Axes, history: np.ndarray, chosen: int) -> None:
    steps = np.arange(1, 1 + history.shape[1])
    for i, row in enumerate(history):
        own = i == chosen
        style = {"color": _COLOURS[1] if own else "#BBBBBB", "lw": 1.6 if own else 0.7, "zorder": 2 + own}
        ax.plot(steps, np.where(np.isfinite(row), row, np.nan), **style)
    starts = "" if len(history) == 1 else f" of {len(history)} starts"
    tidy(ax, xlabel="step", ylabel="cost", title=f"Search{starts}")


@guarded
def comparison(
    runs: Sequence[Trajectory], names: Sequence[str] = _NAMES, folder: str | Path | None = None
) -> Figure:
    r"""Draw the same responses of several runs over each other, say with a fingertip before and after.

    In the plane rolling coordinates $\sigma_i$ [mm] and the angle of the object [rad], in space that angle
    and how far the object is [mm], all since the first saved time; normal forces [N]; $|\lambda| / f$, the
    friction that rolling needs. A cross marks where a run ended early; one that ended before its first saved
    time has no line. Each run has a colour, each contact a style of line.

    Args:
        runs: Single runs that recorded their multipliers, all in the plane or all in space.
        names: One for each.
        folder: Where to write the figure too, as `comparison.png`. Default: nowhere.

    Returns:
        The figure.

    Raises:
        ValueError: If a run is a batch or has no multipliers, some runs are of the plane and some of space,
            or the numbers of runs and names differ.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=0.1, ts=3, record=("multipliers",))
        >>> len(plotting.comparison([run, run]).axes)
        4
    """
    check_instance("runs", runs, list | tuple, "several runs")  # pyright: ignore
    check_instance("names", names, list | tuple, "several names")  # pyright: ignore
    for i, run in enumerate(runs):
        check_instance(f"runs[{i}]", run, Trajectory, "a Trajectory")
    for i, name in enumerate(names):
        check_instance(f"names[{i}]", name, str, "text")
    if not runs or len(runs) != len(names):
        raise ValueError(f"argument names must have one for each of {len(runs)} runs, but had {len(names)}")
    _check_comparable(runs, names)
    figure = Picture(10.0, 6.0)
    axes = figure.subplots(2, 2, sharex=True)
    for i, (run, name) in enumerate(zip(runs, names, strict=True)):
        _responses(axes.ravel(), run, name, _colour(i))
    for ax, (title, label) in zip(axes.ravel(), _PANELS[_spatial(runs[0])] + _FORCES, strict=True):
        tidy(ax, xlabel="time $t$ [s]" if ax in axes[1] else "", ylabel=label, title=title)
        ax.axhline(0.0, color="#BBBBBB", lw=0.7, zorder=0)
    _key(figure, runs, names)
    figure.align_ylabels()
    if folder is not None:
        save_figure(figure, folder, "comparison.png")
    return figure


def _colour(i: int) -> str:
    """The colour of the run i."""
    return CYCLE[4] if i == 0 else CYCLE[(i - 1) % 4]


def _key(figure: Picture, runs: Sequence[Trajectory], names: Sequence[str]) -> None:
    """Which colour is which run, and which line is which contact."""
    signs = [Line2D([], [], color=_colour(i), lw=2.0, label=name) for i, name in enumerate(names)]
    contacts = max(np.shape(run.multipliers.f)[-1] for run in runs if run.multipliers is not None)
    if contacts > 1:
        signs += [
            Line2D([], [], color=GUIDE, lw=1.2, ls=_DASHES[k % len(_DASHES)], label=f"contact {k + 1}")
            for k in range(contacts)
        ]
    if any(float(run.stats.t_end) < float(np.asarray(run.ts)[-1]) for run in runs):
        signs.append(Line2D([], [], color=GUIDE, ls="none", marker="x", mew=1.8, label="ended early"))
    # As many side by side as there is room for, whatever their names.
    widest = max(len(str(sign.get_label())) for sign in signs)
    abreast = max(1, min(len(signs), int(figure.get_figwidth() / (_SIGN + _LETTER * widest))))
    figure.legend(
        handles=signs,
        loc="outside lower center",
        ncols=abreast,
        fontsize=8.5,
        frameon=False,
        handlelength=2.0 if contacts <= _PLAIN else 3.2,
    )


def _check_comparable(runs: Sequence[Trajectory], names: Sequence[str]) -> None:
    for run, name in zip(runs, names, strict=True):
        check_one_run("runs", run)
        if run.multipliers is None:
            raise ValueError(
                f"argument runs must have recorded their multipliers, but the run {name!r} has none"
            )
        if _spatial(run) != _spatial(runs[0]):
            told = "space", "the plane"
            raise ValueError(
                f"argument runs must all live in the plane or all in space, but the run {name!r} lives in "
                f"{told[not _spatial(run)]} and {names[0]!r} in {told[_spatial(run)]}"
            )


def _spatial(run: Trajectory) -> bool:
    return run.multipliers is not None and np.ndim(run.multipliers.lam) > 2


def _angle_of_object(run: Trajectory) -> int:
    """Which coordinate of an object in the plane is its angle: the first in radians."""
    labels = run.labels.bodies[0][1] if run.labels is not None else ()
    return next((i for i, each in enumerate(labels) if each.unit == "rad"), 0)


def _rolled(run: Trajectory, s: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Numbers of the contacts of contours, and how far each rolled [m]; places of others are no lengths."""
    places = run.labels.places if run.labels is not None else ()
    if len(places) != s.shape[1]:
        return []
    lengths = {place.name: k for k, place in enumerate(places) if place.unit == "m"}
    return [(int(name.split()[1]), s[:, k] - s[0, k]) for name, k in lengths.items()]


def _responses(axes: np.ndarray, run: Trajectory, name: str, colour: str) -> None:
    ts, reached = np.asarray(run.ts), np.asarray(run.reached)
    assert run.multipliers is not None
    if not reached.any():
        return
    f, lam = np.asarray(run.multipliers.f)[reached], np.asarray(run.multipliers.lam)[reached]
    q, s = np.asarray(run.states.q)[reached], np.asarray(run.states.s)[reached]
    if _spatial(run):
        aside, moved = np.linalg.norm(lam, axis=-1), MM * np.linalg.norm(q[:, :3] - q[0, :3], axis=1)
        first = [(0, np.linalg.norm(rotation_vectors(q[:, 3:7]), axis=1))]
    else:
        angle = q[:, _angle_of_object(run)]
        aside, moved = np.abs(lam), angle - angle[0]
        first = [(contact, MM * rolled) for contact, rolled in _rolled(run, s)]
    panels = first, [(0, moved)], list(enumerate(f.T)), list(enumerate((aside / f).T))
    end = float(run.stats.t_end)
    for ax, lines in zip(axes, panels, strict=True):
        for k, values in lines:
            label = name if k == 0 else None
            ax.plot(ts[reached], values, color=colour, lw=1.5, ls=_DASHES[k % len(_DASHES)], label=label)
            if end < float(ts[-1]):
                ax.plot(ts[reached][-1], values[-1], "x", color=colour, ms=7, mew=1.8)
