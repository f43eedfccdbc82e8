"""One instant of a grasp as matplotlib artists, which an animation then moves."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from .._mechanics import Grasp, PivotedObject
from ._forces import arrow, Arrows
from ._outlines import Outline
from ._style import (
    CONTACT,
    FINGER,
    FORCE_COLOUR,
    GUIDE,
    LINK_FILL,
    LOAD_COLOUR,
    MM,
    OBJECT,
    OBJECT_FILL,
    ROLLED,
    TIP_FILL,
)
from ._views import place, Views

# Radius of links that have none of their own, as a share of the fingers' size. The square at a base is one
# and a half times as wide as the links.
_RADIUS = 0.045
_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_TURN = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 13)


class Drawing:
    """A grasp on an axes, redrawn by `show`.

    Args:
        ax: Where to draw, in millimetres.
        grasp: What is drawn.
        seen: Its shapes and poses.
        forces: Contact forces to draw at the contacts, or None.
        traced: Whether to draw the rolled stretch of both contours.
    """

    def __init__(
        self,
        ax: Axes,
        grasp: Grasp,
        seen: Views,
        *,
        forces: Arrows | None = None,
        traced: bool = False,
    ) -> None:
        self.seen, self.forces, self.traced = seen, forces, traced
        self.jointed = any(joints.shape[1] > 1 for joints in seen.joints)
        self.pivoted = isinstance(grasp.object, PivotedObject)
        slim = _RADIUS * MM * float(np.mean([f.size for f in grasp.fingers]))
        self.radii = [slim if radius is None else radius for radius in seen.radii]
        # All artists are made once, empty; `show` gives them their places.
        fill = partial(_polygon, ax, np.zeros((3, 2)))
        line = lambda *args, **style: ax.plot([], [], *args, **style)[0]  # noqa: E731
        grey = {"ec": "#8A99A4", "lw": 0.8}
        self.links = [
            [fill(fc=LINK_FILL, zorder=2, **grey) for _ in range(j.shape[1] - 1)] for j in seen.joints
        ]
        self.pins = [line("o", ms=4.5, mfc="white", mec="#55636E", mew=1.2, zorder=3) for _ in seen.joints]
        self.bases = [fill(fc="#55636E", ec="none", zorder=1.5) for _ in seen.joints]
        self.bodies = [_Body(ax, seen.body, (OBJECT_FILL, OBJECT), 1)]
        self.bodies += [_Body(ax, tip, (TIP_FILL, FINGER), 4) for tip in seen.tips]
        thick = {"lw": 3.4, "solid_capstyle": "butt", "zorder": 6, "color": ROLLED}
        self.stretches = [(line(**thick), line(**thick)) for _ in seen.rolled]
        self.guides = [line("--", color=GUIDE, lw=1.0, zorder=7) for _ in seen.guides]
        self.centres = line("o", ms=5, mfc="white", mec=GUIDE, mew=1.2, zorder=8)
        pivot = {"ms": 8, "mfc": "white", "mec": GUIDE, "mew": 1.3}
        self.origin = line("o" if self.pivoted else "P", zorder=8, **pivot)
        self.dot = line("o", ms=2.5, color=GUIDE, zorder=8.5)
        self.points = line("o", ms=5.5, mfc=CONTACT, mec="white", mew=0.8, zorder=9)
        colours = [FORCE_COLOUR] * len(seen.owners)
        if forces is not None and forces.loaded:
            colours.append(LOAD_COLOUR)
        self.arrows = [] if forces is None else [arrow(ax, (0, 0), (1, 0), colour) for colour in colours]

    def show(self, i: int) -> None:
        """Move everything to the instant `i`."""
        seen = self.seen
        for body, frames in zip(self.bodies, seen.frames, strict=True):
            body.show(frames[i])
        limbs = zip(self.links, self.pins, self.bases, self.radii, seen.joints, strict=True)
        for links, pins, base, radius, joints in limbs:
            for link, ends in zip(links, zip(joints[i, :-1], joints[i, 1:], strict=True), strict=True):
                link.set_xy(_capsule(*ends, radius))
            pins.set_data(*joints[i, :-1].T)
            base.set_xy(joints[i, 0] + 1.5 * radius * _SQUARE)
            base.set_visible(joints.shape[1] > 1)  # a jaw has none to show
        for guide, ends in zip(self.guides, seen.guides, strict=True):
            guide.set_data(*ends[i].T)
        # The last point of a skeleton is the tip frame's origin, O_i.
        self.centres.set_data(*np.array([joints[i, -1] for joints in seen.joints]).T)
        self.origin.set_data(*seen.frames[0][i, :2, None])
        if self.pivoted:
            self.dot.set_data(*seen.frames[0][i, :2, None])
        self.points.set_data(*seen.points[i].T)
        if self.traced:
            self._stretch(i)
        if self.forces is not None:
            each = zip(self.arrows, self.forces.points[i], self.forces.vectors[i], strict=True)
            for shaft, point, vector in each:
                shaft.set_positions(point, point + vector)
                shaft.set_visible(bool(np.any(vector)))

    def _stretch(self, i: int) -> None:
        for finger, lines, paths in zip(self.seen.owners, self.stretches, self.seen.rolled, strict=True):
            for line, path, frame in zip(lines, paths, (1 + finger, 0), strict=True):
                # A path lies on its body, where that is now.
                line.set_data(*place(self.seen.frames[frame][i], path[: i + 1]).T)

    def legend(self) -> list[tuple[Any, str]]:
        """Handles and names of what is drawn."""
        alone = len(self.seen.tips) == 1 and len(self.seen.owners) == 1
        entries = [
            (Patch(fc=TIP_FILL, ec=FINGER, lw=1.4), "fingertip"),
            (Patch(fc=OBJECT_FILL, ec=OBJECT, lw=1.4), "object"),
            *[(base, "fixed base") for base in self.bases[:1] if self.jointed],
            *[(self.points, _point_name(len(self.seen.owners))) for _ in self.seen.owners[:1]],
            (self.centres, _centre_name(len(self.seen.tips), alone)),
            ((self.origin, self.dot), "pivot $O_m$")
            if self.pivoted
            else (self.origin, "centre of mass $O_m$"),
        ]
        if self.guides:
            entries.append((self.guides[0], self._guide_name()))
        if self.traced and self.stretches:
            entries.append((self.stretches[0][0], "rolled so far: as long on both bodies"))
        if self.forces is not None:
            sign = Line2D([], [], marker=r"$\rightarrow$", ms=14, ls="none", color=FORCE_COLOUR)
            entries.append((sign, "contact force on the object"))
            # A push that acts at no time that is shown has no arrow to explain.
            if self.forces.loaded and self.forces.vectors[:, -1].any():
                sign = Line2D([], [], marker=r"$\rightarrow$", ms=14, ls="none", color=LOAD_COLOUR)
                entries.append((sign, "load on the object"))
        return entries

    def _guide_name(self) -> str:
        if len(self.seen.tips) == 1:
            return "line $O_{01}O_m$: meets $P_1$ at rest"
        if len(self.seen.guides) == 1:
            return "line $O_1O_2$"
        return "lines to the target"


def _point_name(contacts: int) -> str:
    return ("contact point $P_1$", "contact points $P_1$, $P_2$", "contact points $P_i$")[
        min(contacts, 3) - 1
    ]


def _centre_name(tips: int, alone: bool) -> str:
    if alone:
        return "tip frame $O_{01}$"
    return "finger centres $O_1$, $O_2$" if tips == 2 else "finger centres $O_i$"


class _Body:
    def __init__(self, ax: Axes, shape: Outline, colours: tuple[str, str], zorder: float) -> None:
        self.shape = shape
        soft = {"fc": colours[0], "ec": colours[1], "lw": 0.6, "zorder": zorder, "alpha": 0.92}
        self.fills = [_polygon(ax, ring, **soft) for ring in shape.rings]
        solid = {"color": colours[1], "lw": 1.8, "zorder": zorder + 0.2}
        self.edges = [ax.plot([], [], **solid)[0] for _ in shape.faces]

    def show(self, frame: np.ndarray) -> None:
        for fill, ring in zip(self.fills, self.shape.rings, strict=True):
            fill.set_xy(place(frame, ring))
        for edge, face in zip(self.edges, self.shape.faces, strict=True):
            edge.set_data(*place(frame, face).T)


def _polygon(ax: Axes, corners: np.ndarray, **style: Any) -> Polygon:
    polygon = Polygon(corners, **style)
    ax.add_patch(polygon)
    return polygon


def _capsule(start: np.ndarray, end: np.ndarray, radius: float) -> np.ndarray:
    along = end - start
    heading = np.arctan2(along[1], along[0])
    arc = lambda turn: radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)  # noqa: E731
    # Half a circle about either end; the straight sides are the polygon's edges between them.
    return np.concatenate([end + arc(heading + _TURN), start + arc(heading + _TURN + np.pi)])


def limits(seen: Views, margin: float | None = None, *, above: float = 0.0) -> np.ndarray:
    """Lower left and upper right corner [mm] of all that is drawn at any time, shape (2, 2).

    Args:
        seen: What is drawn.
        margin: Around skeletons, shapes and guides [mm]. Default: 6 mm, or more for a grasp much larger than
            a gripper, and less for a much smaller one.
        above: A strip to leave free at the top, as a share of the height.
    """
    shapes = (seen.body, *seen.tips)
    cloud = [joints.reshape(-1, 2) for joints in seen.joints]
    cloud += [guide.reshape(-1, 2) for guide in seen.guides]
    for shape, frames in zip(shapes, seen.frames, strict=True):
        rough = np.concatenate([ring[::6] for ring in shape.rings])
        cloud += [place(frame, rough) for frame in frames]
    every = np.concatenate(cloud)
    low, high = every.min(axis=0), every.max(axis=0)
    if margin is None:
        across = float(np.max(high - low))
        links = [np.linalg.norm(np.diff(j[0], axis=0), axis=-1) for j in seen.joints if j.shape[1] > 1]
        base = 1.6 * _RADIUS * max((float(lengths.mean()) for lengths in links), default=0.0)
        thick = 1.6 * max((radius for radius in seen.radii if radius is not None), default=0.0)
        margin = max(min(6.0, 0.2 * across), 0.02 * across, base, thick)
    low, high = low - margin, high + margin
    return np.stack([low, high + np.array([0.0, above * (high[1] - low[1])])])
