"""The geometry of one contact, labelled as in the chapter's Figs. 2, 5 and 6."""

from typing import Any

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Polygon

from .._analysis import contact_geometry
from .._mechanics import check_planar, Grasp, State
from .._results import as_count
from ._doors import guarded
from ._outlines import Outline
from ._style import CONTACT, FINGER, GUIDE, MM, OBJECT, OBJECT_DARK, OBJECT_FILL, Picture, tidy, TIP_FILL
from ._tags import put_tags, Tag
from ._views import along_time, place, views

# A `ContactGeometry` of one contact, of NumPy's arrays.
_Numbers = Any
# Length of a unit vector, over the largest distance between the points that are drawn.
_UNIT = 0.2
# A dimension shorter than this share of a unit vector has its arrows outside.
_SHORT = 0.5
# Width of the figure [inch].
_WIDTH = 7.4
# Tangents that differ by no more [rad] are drawn as one.
_ALIKE = 1e-3
# From this size on a value has no decimals, for which there is no room.
_LONG = 1e4


@guarded
def contact_figure(grasp: Grasp, state: State, *, contact: int = 0, ax: Axes | None = None) -> Figure:
    r"""Draw the geometry of one contact to scale: frames, tangents, normals, and the lengths of (60)-(63).

    As in the chapter's Figs. 2, 5 and 6, with the names of Part 2 at every contact: index 0 is the fingertip
    (blue), 1 the object (brown); `contact_geometry` defines all that is drawn, and says what Part 1 calls it.
    Wide arrows are the position vectors $\gamma_0$ and $\gamma$ from the origins of the frames to the
    contact, thin ones the unit vectors and the chapter's axes, which are the mirror image of the body's
    own where `sense` is 1. $P_0'$ and $P_1'$ are the feet of (66)-(67) on the line through the contact
    along $n_1$. Dimensions are signed: the values stand beside the drawing.

    Args:
        grasp: A grasp in the plane.
        state: One state; its `q` in radians and metres. The contact need not be closed.
        contact: Which contact, counted from 0.
        ax: An axes to draw on, in millimetres, without the values. Default: a new figure.

    Returns:
        The figure.

    Raises:
        ValueError: If the grasp lives in space, or has no such contact.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> figure = plotting.contact_geometry(*jxr.scenes.pivoted())
        >>> len(figure.axes)
        2
    """
    check_planar(grasp)
    contact = as_count("contact", contact, least=0)
    if contact >= len(grasp.contacts):
        raise ValueError(f"argument contact must be below {len(grasp.contacts)}, but was {contact}")
    found = contact_geometry(grasp, along_time(state))
    at = jax.tree.map(lambda x: np.asarray(x)[0, contact], found)
    if ax is not None:
        sketch = _sketched(ax, grasp, state, contact, at)
        put_tags(ax, sketch.tags, sketch.lines)
        whole = ax.get_figure(root=True)
        assert whole is not None
        return whole
    figure = Picture(_WIDTH, _WIDTH)
    axes, values = figure.subplots(1, 2, width_ratios=(5.0, 1.0))
    sketch = _sketched(axes, grasp, state, contact, at)
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    figure.set_size_inches(_WIDTH, 0.76 * _WIDTH * (high - low) / (right - left) + 0.8)
    _list_values(values, at)
    put_tags(axes, sketch.tags, sketch.lines)
    return figure


class _Sketch:
    """An axes, the lines on it that labels keep clear of, and the labels."""

    def __init__(self, ax: Axes, unit: float) -> None:
        self.ax, self.unit = ax, unit
        self.lines: list[np.ndarray] = []
        self.tags: list[Tag] = []
        self.reach: list[np.ndarray] = []

    def body(self, shape: Outline, frame: np.ndarray, colours: tuple[str, str]) -> None:
        """A filled body with its true contours."""
        for ring in shape.rings:
            self.ax.add_patch(Polygon(place(frame, ring), fc=colours[0], ec="none", alpha=0.55, zorder=1))
        for face in shape.faces:
            points = place(frame, face)
            self.ax.plot(*points.T, color=colours[1], lw=1.8, zorder=2)
            self.lines.append(points)

    def dash(self, start: np.ndarray, end: np.ndarray, **style: Any) -> None:
        """A thin auxiliary line."""
        ends = np.stack([start, end])
        self.ax.plot(*ends.T, **({"color": "#8A8A8A", "lw": 0.7, "zorder": 3} | style))
        self.lines.append(ends)

    def arrow(self, start: np.ndarray, end: np.ndarray, colour: str, **style: Any) -> None:
        """An arrow that ends at `end`."""
        look = {"arrowstyle": "-|>", "mutation_scale": 10, "lw": 1.3, "zorder": 8, "shrinkA": 0, "shrinkB": 0}
        self.ax.add_patch(FancyArrowPatch(tuple(start), tuple(end), color=colour, **(look | style)))
        self.lines.append(np.stack([start, end]))
        self.reach += [start, end]

    def dot(self, at: np.ndarray, text: str, colour: str, *, filled: bool = False) -> None:
        """A labelled point."""
        face = colour if filled else "white"
        self.ax.plot(*at[:, None], "o", ms=5, mfc=face, mec=colour, mew=1.1, zorder=10)
        step = 0.06 * self.unit
        self.lines.append(at + step * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1], [1, 1]]))
        self.tags.append(Tag(text, at, colour))
        self.reach.append(at)

    def dimension(
        self, start: np.ndarray, end: np.ndarray, aside: np.ndarray, *, text: str, colour: str
    ) -> None:
        """A length between two points as a dimension line, shifted `aside` of both."""
        first, last = start + aside, end + aside
        beyond = aside * (1.0 + 0.15 * self.unit / np.linalg.norm(aside))
        for point in (start, end):
            self.dash(point, point + beyond, lw=0.5)
        span = last - first
        length = float(np.linalg.norm(span))
        small = {"mutation_scale": 7, "lw": 0.9, "zorder": 6}
        if length >= _SHORT * self.unit:
            self.arrow(first, last, colour, **small | {"arrowstyle": "<|-|>"})
        else:
            across = np.array([aside[1], -aside[0]]) / np.linalg.norm(aside)
            way = span / length if length > 1e-9 * self.unit else across
            self.arrow(first - 0.6 * self.unit * way, first, colour, **small)
            self.arrow(last + 0.6 * self.unit * way, last, colour, **small)
            self.dash(first, last, color=colour, lw=0.9)
        self.tags.insert(0, Tag(text, 0.5 * (first + last), colour))


def _sketched(ax: Axes, grasp: Grasp, state: State, contact: int, at: _Numbers) -> _Sketch:
    """All that is drawn, but the labels, which need to know the layout."""
    seen, touch = views(grasp, along_time(state)), grasp.contacts[contact]
    tip, body = MM * at.centre_0, MM * at.centre_1
    points = np.stack([tip, body, tip + MM * at.gamma_0, body + MM * at.gamma_1])
    widest = np.linalg.norm(points[:, None] - points, axis=-1).max()
    sketch = _Sketch(ax, _UNIT * (float(widest) or 1.0))
    sketch.body(seen.body, seen.frames[0][0], (OBJECT_FILL, OBJECT))
    finger = touch.finger
    sketch.body(seen.tips[finger], seen.frames[1 + finger][0], (TIP_FILL, FINGER))
    _lengths(sketch, at)
    _vectors(sketch, at)
    # The chapter's axes, as `ContactGeometry` has them: X = x, Y = -+ y and X_0 = -+ y, Y_0 = -x.
    (x_0, y_0), (x, y) = (_axes(seen.frames[k][0]) for k in (1 + finger, 0))
    _frame(sketch, tip, (-touch.sense * y_0, -x_0), ("$X_0$", "$Y_0$"), FINGER)
    _frame(sketch, body, (x, -touch.sense * y), ("$X$", "$Y$"), OBJECT_DARK)
    number = contact + 1
    sketch.dot(MM * at.point, f"$P_{number}$", CONTACT, filled=True)
    alone = len(grasp.fingers) == 1
    sketch.dot(tip, "$O_{01}$" if alone else f"$O_{finger + 1}$", FINGER)
    sketch.dot(body, "$O_m$", OBJECT_DARK)
    low, high = _window(np.stack(sketch.reach), 0.5 * sketch.unit)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    tidy(ax, xlabel="x [mm]", ylabel="y [mm]", title=f"Contact geometry at $P_{number}$")
    return sketch


def _window(points: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner about all points, neither very wide nor very high."""
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    middle, size = 0.5 * (low + high), high - low
    half = 0.5 * np.maximum(size, [size[1], 0.6 * size[0]])
    return middle - half, middle + half


def _lengths(sketch: _Sketch, at: _Numbers) -> None:
    """The feet of (66)-(67), the lines through them, and the lengths (60)-(63) as dimensions."""
    unit, point, b, n = sketch.unit, MM * at.point, at.b_1, at.n_1
    feet = [point - MM * at.l_n0 * n, point + MM * at.l_n1 * n]
    centres = [MM * at.centre_0, MM * at.centre_1]
    # Along n, on the side of b where less is in the way: the tangents on one, the origins on either.
    beside = max(0.0, MM * at.l_b0, -MM * at.l_b1)
    ahead = max(1.1 * unit, -MM * at.l_b0, MM * at.l_b1)
    aside = b * (ahead + 0.4 * unit) if ahead < beside else -b * (beside + 0.55 * unit)
    along = sorted([float((x - point) @ n) for x in (*feet, point)])
    sketch.dash(point + (along[0] - 0.25 * unit) * n, point + (along[-1] + 0.25 * unit) * n, ls=(0, (6, 4)))
    sketch.dash(point - 1.6 * unit * b, point + 1.6 * unit * b, ls=(0, (6, 4)))
    sketch.dimension(feet[0], point, aside, text="$l_{n0}$", colour=FINGER)
    sketch.dimension(point, feet[1], aside, text="$l_{n1}$", colour=OBJECT_DARK)
    for centre, foot, text, colour, way in (
        (centres[0], feet[0], "$l_{b0}$", FINGER, -1.0 if at.l_n0 > 0 else 1.0),
        (centres[1], feet[1], "$l_{b1}$", OBJECT_DARK, 1.0 if at.l_n1 > 0 else -1.0),
    ):
        sketch.dimension(centre, foot, way * 1.05 * unit * n, text=text, colour=colour)
    sketch.dot(feet[0], "$P_0'$", FINGER)
    sketch.dot(feet[1], "$P_1'$", OBJECT_DARK)


def _vectors(sketch: _Sketch, at: _Numbers) -> None:
    """Position vectors, tangents and normals at the contact."""
    unit, on_body = sketch.unit, MM * at.point
    on_tip = MM * (at.centre_0 + at.gamma_0)
    wide: dict[str, Any] = {"lw": 3.6, "alpha": 0.4, "mutation_scale": 17, "zorder": 5}
    for centre, end, text, colour in (
        (MM * at.centre_0, on_tip, r"$\boldsymbol{\gamma}_0$", FINGER),
        (MM * at.centre_1, on_body, r"$\boldsymbol{\gamma}$", OBJECT_DARK),
    ):
        sketch.arrow(centre, end, colour, **wide)
        sketch.tags.append(Tag(text, centre + 0.45 * (end - centre), colour, 11.0))
    vectors = [
        (on_tip, at.n_0, r"$\boldsymbol{n}_0$", FINGER),
        (on_body, at.n_1, r"$\boldsymbol{n}_1$", OBJECT_DARK),
    ]
    if abs(at.misalignment) <= _ALIKE:
        vectors.append((on_body, at.b_1, r"$\boldsymbol{b}_0 = \boldsymbol{b}_1$", GUIDE))
    else:
        vectors.append((on_tip, at.b_0, r"$\boldsymbol{b}_0$", FINGER))
        vectors.append((on_body, at.b_1, r"$\boldsymbol{b}_1$", OBJECT_DARK))
    for start, vector, text, colour in vectors:
        sketch.arrow(start, start + unit * vector, colour, lw=1.7, mutation_scale=12)
        sketch.tags.append(Tag(text, start + unit * vector, colour, 11.0))


def _axes(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A body's own axes in the world; `frame` is one row (x, y, cos, sin)."""
    _, _, cos, sin = frame
    return np.array([cos, sin]), np.array([-sin, cos])


def _frame(
    sketch: _Sketch,
    origin: np.ndarray,
    axes: tuple[np.ndarray, np.ndarray],
    names: tuple[str, str],
    colour: str,
) -> None:
    """The chapter's axes of a body."""
    for axis, name in zip(axes, names, strict=True):
        end = origin + 0.75 * sketch.unit * axis
        sketch.arrow(origin, end, colour, lw=0.9, mutation_scale=8, zorder=7)
        sketch.tags.append(Tag(name, end, colour, 9.0))


def _list_values(ax: Axes, at: _Numbers) -> None:
    """The values, one below the other."""
    rows = [
        ("$s$", MM * at.s, "mm"),
        (r"$\psi_0$", np.degrees(at.psi_0), "°"),
        (r"$\theta_1$", np.degrees(at.theta_1), "°"),
        ("$l_{b0}$", MM * at.l_b0, "mm"),
        ("$l_{b1}$", MM * at.l_b1, "mm"),
        ("$l_{n0}$", MM * at.l_n0, "mm"),
        ("$l_{n1}$", MM * at.l_n1, "mm"),
        (r"$\kappa_0$", at.kappa_0, "1/m"),
        (r"$\kappa_1$", at.kappa_1, "1/m"),
    ]
    digits = {unit: _decimals([value for _, value, other in rows if other == unit]) for *_, unit in rows}
    ax.set_axis_off()
    ax.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    for k, (name, value, unit) in enumerate(rows):
        rounded = round(float(value), digits[unit]) + 0.0
        if unit == "°" and rounded <= -180.0:  # the angle of opposite directions has one sign
            rounded += 360.0
        number = f"{rounded:.{digits[unit]}f}".replace("-", "\N{MINUS SIGN}")
        row: Any = {"textcoords": "offset points", "va": "top", "color": GUIDE}
        for x, text, size, side in (
            (0.0, name, 10, "left"),
            (0.74, number, 9, "right"),
            (0.8, unit, 9, "left"),
        ):
            ax.annotate(text, (x, 1.0), xytext=(0.0, -6.0 - 19.0 * k), fontsize=size, ha=side, **row)


def _decimals(values: list[Any]) -> int:
    """How many decimals values of one unit have: two, more where all are small, none where they are long."""
    peak = float(np.max(np.abs(values)))
    if not 0.0 < peak < np.inf:
        return 2
    return 0 if peak >= _LONG else max(2, 2 - int(np.floor(np.log10(peak))))
