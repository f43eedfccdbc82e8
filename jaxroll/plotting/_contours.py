"""Contours in their own frames, and their curvature over arclength (Fig. 7)."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._mechanics import check_planar, Grasp
from .._results import on_host
from ..geometry import AbstractContour
from ._outlines import contours_of, extents, Outline, outlines, sample, starts_of, Window
from ._style import CONTACT, FINGER, GUIDE, MM, OBJECT, OBJECT_FILL, Picture, tidy, TIP_FILL

# Steps between the numbers along a contour [mm]: enough for a grain of sand and for a ship.
_STEPS = np.outer(10.0 ** np.arange(-6, 9), [1.0, 2.0, 5.0]).ravel()
_BESIDE: Any = {"textcoords": "offset points", "ha": "center", "va": "center"}


@on_host
def contours(grasp: Grasp) -> Figure:
    r"""Draw every fingertip and the object in their own frames, and curvature over arclength.

    Dots along a contour count its arclength in millimetres, counter-clockwise round the body; the chapter's
    $s_i$, as in `responses`, counts along $b_i$, and may have the other sign. A contour without ends is drawn
    around its starting contact.

    The axes x and y are those of the body's frame, with a fingertip's x along its last link. In Fig. 7 and
    (80)-(83) they are turned and mirrored: with the contact's `sense` $\varsigma$, $X = x$ and
    $Y = -\varsigma y$ on the object, $X_0 = -\varsigma y$ and $Y_0 = -x$ on the fingertip. So the vertex
    of (82)-(83) in `scenes.pivoted`, at $X_0 = 10$ mm, is drawn at (0, -10) mm.

    Args:
        grasp: Whose contours to draw.

    Returns:
        The figure: one column per body; shapes [mm] above, curvature [1/m] below.

    Raises:
        ValueError: If the grasp lives in space.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> grasp, _ = jxr.scenes.pivoted()
        >>> len(plotting.contours(grasp).axes)
        4
    """
    check_planar(grasp)
    still = np.zeros((1, len(grasp.contacts)))
    order = (*range(1, 1 + len(grasp.fingers)), 0)
    shapes, windows = outlines(grasp, still), extents(grasp, still)
    starts, bodies = starts_of(grasp), contours_of(grasp)
    figure = Picture(4.4 * len(order), 6.4)
    axes = figure.subplots(2, len(order), squeeze=False, height_ratios=(1.3, 1.0))
    sizes = np.array([np.ptp(np.concatenate(shape.rings), axis=0) for shape in shapes])
    arrow, margin = 0.3 * float(sizes.min()), 0.2 * float(sizes.max())
    boxes = [_box(shape, arrow, margin) for shape in shapes]
    half = 0.5 * np.max([high - low for low, high in boxes], axis=0)
    for body, above, below in zip(order, *axes, strict=True):
        colours = (TIP_FILL, FINGER) if body else (OBJECT_FILL, OBJECT)
        _shape(above, shapes[body], colours)
        for contour, window, touched in zip(bodies[body], windows[body], starts[body], strict=True):
            at = np.array([s for _, s, _ in touched])
            _count(above, contour, window)
            _curvature(below, contour, window, colours[1])
            start = sample(contour, at)
            above.plot(*start.points.T, "o", ms=7, color=CONTACT, zorder=5)
            below.plot(MM * at, start.curvatures, "o", ms=6, color=CONTACT, zorder=5)
        if body == 0 and len(grasp.contacts) > 1:
            _name_contacts(above, below, grasp)
        middle = np.mean(boxes[body], axis=0)
        ends = np.stack([middle - half, middle + half], axis=1)
        above.set(xlim=ends[0], ylim=ends[1], aspect="equal")
        _arrows(above, arrow, "$O_m$" if body == 0 else _origin(grasp, body))
        _label(above, below, _name(grasp, body), first=body == order[0])
    top = max(ax.get_ylim()[1] for ax in axes[1])
    low = min(ax.get_ylim()[0] for ax in axes[1])
    for ax in axes[1]:
        ax.set_ylim(low, top)
    figure.legend(
        # Drawn last were the dots of the arclength, the start of the contact, and the frame's origin.
        [axes[0, 0].lines[-2], axes[0, 0].lines[-3]],
        [
            "starting contact",
            "arclength s [mm], counter-clockwise round the body; the chapter's $s_i$ is along $b_i$",
        ],
        loc="outside lower center",
        ncols=2,
        fontsize=8,
        frameon=False,
    )
    return figure


def _box(shape: Outline, arrow: float, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners [mm] of a body with its frame's arrows and the numbers along it."""
    every = np.concatenate([*shape.rings, [[0.0, 0.0], [arrow, arrow]]])
    return every.min(axis=0) - margin, every.max(axis=0) + margin


def _name(grasp: Grasp, body: int) -> str:
    if body == 0:
        return "the object"
    return "the fingertip" if len(grasp.fingers) == 1 else f"fingertip {body}"


def _origin(grasp: Grasp, body: int) -> str:
    return "$O_{01}$" if len(grasp.fingers) == 1 else f"$O_{{{body}}}$"


def _shape(ax: Axes, shape: Outline, colours: tuple[str, str]) -> None:
    for ring in shape.rings:
        ax.fill(*ring.T, fc=colours[0], ec=colours[1], lw=0.6)
    for face in shape.faces:
        ax.plot(*face.T, color=colours[1], lw=1.8)


def _arrows(ax: Axes, length: float, origin: str) -> None:
    arrow = {"arrowstyle": "-|>", "color": GUIDE, "lw": 1.0, "shrinkA": 0, "shrinkB": 0}
    for tip, push, letter in (((length, 0.0), (-5, -9), "x"), ((0.0, length), (-8, 0), "y")):
        ax.annotate("", tip, (0.0, 0.0), arrowprops=arrow, zorder=6)
        ax.annotate(f"${letter}$", tip, push, fontsize=9, zorder=6, **_BESIDE)
    ax.plot(0, 0, "o", ms=5, mfc="white", mec=GUIDE, zorder=7)
    ax.annotate(origin, (0, 0), (-11, -9), fontsize=9, zorder=7, **_BESIDE)


def _label(above: Axes, below: Axes, name: str, *, first: bool) -> None:
    shape, bend = ("y [mm]", "curvature [1/m]") if first else ("", "")
    title = f"{name[0].upper()}{name[1:]} in its own frame"
    tidy(above, xlabel="x [mm]", ylabel=shape, title=title)
    tidy(below, xlabel="arclength s [mm]", ylabel=bend, title=f"Curvature of {name}")
    below.axhline(0.0, color="#BBBBBB", lw=0.7, zorder=0)


def _count(ax: Axes, contour: AbstractContour, window: Window) -> None:
    """Dots with the arclength beside them, on the outside."""
    low, high = MM * window[0], MM * window[1]
    step = _STEPS[np.argmin(np.abs(_STEPS - (high - low) / 6))]
    # By 1e-9 of a step more: an end that misses a mark by rounding still has it.
    marks = step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1)
    if contour.closed:
        # After one turn the end is the start again, where a number stands already.
        marks = marks[marks < high - 0.3 * step]
    there = sample(contour, marks / MM)
    ax.plot(*there.points.T, "o", ms=3.5, color=GUIDE, zorder=4)
    for mark, point, along in zip(marks, there.points, there.tangents, strict=True):
        text = "$s$ = 0" if mark == 0 else f"{mark:g}".replace("-", "\N{MINUS SIGN}")
        far = 17.0 if mark == 0 else 11.0
        # The tangent turned right points outwards.
        push = (far * along[1], -far * along[0])
        ax.annotate(text, point, push, fontsize=7.5, color=GUIDE, **_BESIDE)


def _name_contacts(above: Axes, below: Axes, grasp: Grasp) -> None:
    """$P_i$ beside the contacts: inside the object, and over its curvature on the outer side."""
    starts = np.array([float(contact.s_object) for contact in grasp.contacts])
    style = {"fontsize": 9, "color": CONTACT, **_BESIDE}
    crowded = MM * float(np.diff(np.sort(starts)).min()) < 0.1 * float(np.ptp(below.get_xlim()))
    for i, contact in enumerate(grasp.contacts):
        there = sample(grasp.shapes(contact)[1], starts[i : i + 1])
        along, name = there.tangents[0], f"$P_{{{i + 1}}}$"
        above.annotate(name, there.points[0], (-14 * along[1], 14 * along[0]), **style)
        side = (8 if starts[i] >= starts.mean() else -8) if crowded else 0
        below.annotate(name, (MM * starts[i], there.curvatures[0]), (side, 11), **style)


def _curvature(ax: Axes, contour: AbstractContour, window: Window, colour: str) -> None:
    s = np.linspace(*window, 241)
    ax.plot(MM * s, sample(contour, s).curvatures, color=colour, lw=1.6)
