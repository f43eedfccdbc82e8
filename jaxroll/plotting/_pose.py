"""Poses of hand and object (Fig. 8; in space Figs. 19 and 20)."""

from collections.abc import Sequence

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._integration import Trajectory
from .._mechanics import Grasp, State
from .._results import told_apart
from ._artists import Drawing, limits
from ._doors import guarded
from ._forces import Arrows, arrows, key
from ._forces3 import pushes
from ._poses3 import snapshots3
from ._style import Picture, tidy
from ._views import along_time, how_it_ended, single, Views, views, visible
from ._views3 import check_options, scene_motion, View


@guarded
def pose(grasp: Grasp, state: State, *, ax: Axes | None = None, view: View | None = None) -> Figure:
    """Draw one pose with its true contours or surfaces, to scale.

    Open contours are closed by a thin rounded back, which is not part of the model, nor is the width of links
    without a `link_radius`. The dashed line joins what is in line with the contact at rest: under
    `control.Press` the tip frame and the target, for two fingers their tip frames.

    In space, surfaces have a pattern of patches that shows how they turn; those without end are drawn about
    the contact.

    Args:
        grasp: What is drawn.
        state: One state; its `q` in radians and metres.
        ax: An axes to draw on, in millimetres; in the plane alone. Default: a new figure with a legend.
        view: How to look at a grasp in space.

    Returns:
        The figure.

    Raises:
        ValueError: If `ax` is given in space or `view` in the plane, or a surface cannot be drawn.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> figure = plotting.pose(*jxr.scenes.pivoted())
        >>> figure.axes[0].get_xlabel()
        'x [mm]'
    """
    if grasp.spatial:
        check_options(grasp, ax=ax)
        return snapshots3(grasp, scene_motion(grasp, state), view=view)
    check_options(grasp, view=view)
    seen = views(grasp, along_time(state))
    if ax is None:
        return _side_by_side(grasp, seen, [""])
    _frame(ax, limits(seen), "")
    Drawing(ax, grasp, seen).show(0)
    figure = ax.get_figure(root=True)
    assert figure is not None
    return figure


@guarded
def poses(
    grasp: Grasp,
    trajectory: Trajectory,
    *,
    times: Sequence[float] | None = None,
    forces: bool = False,
    view: View | None = None,
) -> Figure:
    """Draw the poses at several times side by side, as Fig. 8 does for the first and the last.

    In space each picture has the loci of the contacts up to its time (Fig. 20), each on its body, where that
    body is then. Rolling makes both loci touch with a common tangent at the contact. The part of a locus on
    the far side of its body is dotted.

    Args:
        grasp: What is drawn.
        trajectory: One run of it.
        times: Times to draw [s]; each shows the saved state nearest to it. Default: first and last; of a run
            that ended before a state was saved, the state where it ended.
        forces: Whether to draw the contact forces on the object and the force of its loads, with their scale.
        view: How to look at a grasp in space.

    Returns:
        The figure.

    Raises:
        ValueError: If the trajectory is a batch, `view` is given in the plane, a surface cannot be drawn, or
            `forces` is True and the run was not simulated with `record=("multipliers",)`.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=0.1)
        >>> [ax.get_title(loc="left") for ax in plotting.poses(grasp, run).axes]
        ['(a)  t = 0 s', '(b)  t = 0.1 s']
    """
    trajectory = visible(grasp, trajectory)
    ts, reached = single(trajectory)
    ts, rows = ts[reached], np.flatnonzero(reached)
    ends = (ts[0], ts[-1]) if len(ts) > 1 else (ts[0],)
    wanted = ends if times is None else tuple(times)
    picks = [int(np.argmin(np.abs(ts - t))) for t in wanted]
    titles = [
        f"({chr(97 + k)})  t = {told} s{how_it_ended(trajectory, ts[i])}"
        for k, (i, told) in enumerate(zip(picks, told_apart(*ts[picks], least=4), strict=True))
    ]
    if grasp.spatial:
        motion = scene_motion(grasp, trajectory.states)
        pushed = pushes(grasp, trajectory, motion) if forces else None
        return snapshots3(grasp, motion, picks, titles=titles, forces=pushed, view=view)
    check_options(grasp, view=view)
    states = jax.tree.map(lambda a: np.asarray(a)[rows[picks]], trajectory.states)
    seen = views(grasp, states)
    if not forces:
        return _side_by_side(grasp, seen, titles)
    corners = limits(seen, above=0.05)
    return _side_by_side(grasp, seen, titles, arrows(grasp, trajectory, rows[picks], seen, corners=corners))


def _side_by_side(grasp: Grasp, seen: Views, titles: list[str], forces: Arrows | None = None) -> Figure:
    corners = limits(seen, above=0.0 if forces is None else 0.05)
    width, height = corners[1] - corners[0]
    columns = 4 if len(titles) > 1 else 2
    panel = max(2.9, min(4.2, 5.6 * width / height))
    below = 1.9 - 0.16 * columns
    whole = max(panel * len(titles) + 0.6, 1.7 * columns)
    figure = Picture(whole, panel * height / width + below)
    axes = figure.subplots(1, len(titles), sharex=True, sharey=True, squeeze=False)[0]
    for i, (ax, title) in enumerate(zip(axes, titles, strict=True)):
        drawing = Drawing(ax, grasp, seen, forces=forces)
        drawing.show(i)
        _frame(ax, corners, title)
        if forces is not None:
            key(ax, forces)
        if i:
            ax.set_ylabel("")
    handles, names = zip(*drawing.legend(), strict=True)
    figure.legend(handles, names, loc="outside lower center", ncols=columns, fontsize=8, frameon=False)
    # The first layout leaves too little room for the titles of a tall grasp; the next one does not.
    figure.draw_without_rendering()
    return figure


def _frame(ax: Axes, corners: np.ndarray, title: str) -> None:
    (left, low), (right, high) = corners
    ax.set(xlim=(left, right), ylim=(low, high), aspect="equal")
    tidy(ax, xlabel="x [mm]", ylabel="y [mm]", title=title)
