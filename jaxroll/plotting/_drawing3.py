"""One instant of a spatial grasp on matplotlib's axes in space."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ._artists3 import Arrow, NO_TRIANGLES, Triangles
from ._forces3 import Pushes
from ._scene3 import DrawnLocus, Scene3, Solid
from ._style import (
    CONTACT,
    FINGER,
    FORCE_COLOUR,
    GUIDE,
    JOINT_BODY,
    LINK_BODY,
    LOAD_COLOUR,
    LOCUS_OBJECT,
    LOCUS_TIP,
    OBJECT,
    OBJECT_BODY,
    TIP_BODY,
)
from ._tubes import ball, camera, chequered, lit, tube_mesh

# matplotlib has no types for what it draws in space.
Axes3 = Any
# How much of what is behind a body is hidden.
_OPAQUE = 0.86
# Radius of a joint over that of its links, where these have no radius of their own.
_SWOLLEN = 1.45
_WHITE = {"color": "white", "solid_capstyle": "round"}


class Drawing3:
    """A spatial grasp on an axes, redrawn by `show`.

    Args:
        ax: Where to draw, in millimetres, in parallel projection.
        scene: What is drawn.
        arrows: Forces on the object to draw [mm], or None.
    """

    def __init__(self, ax: Axes3, scene: Scene3, *, arrows: Pushes | None = None) -> None:
        self.ax, self.scene, self.arrows = ax, scene, arrows
        # One layer for the parts of the fingers behind the object, one for the object, and one for the parts
        # before it. matplotlib has no depth buffer: a layer sorts its triangles, layers go by `zorder`.
        self.layers = [_layer(ax, zorder) for zorder in (1, 10, 20)]
        self.lines = [
            (_Trace(ax, on_tip, LOCUS_TIP), _Trace(ax, on_object, LOCUS_OBJECT))
            for on_tip, on_object in zip(scene.on_tips, scene.on_object, strict=True)
        ]
        (self.points,) = ax.plot([], [], [], "o", ms=6, mfc=CONTACT, mec="white", mew=0.9, zorder=60)
        self.normals = [_arrow(ax, GUIDE, 1.2, 9, 58) for _ in scene.on_object]
        self.forces = (
            [] if arrows is None else [_arrow(ax, FORCE_COLOUR, 2.0, 12, 59) for _ in scene.on_object]
        )
        self.load = [] if arrows is None or arrows.load is None else [_arrow(ax, LOAD_COLOUR, 2.0, 12, 59.5)]

    def show(self, i: int) -> None:
        """Move everything to the instant i, as the camera sees it now."""
        towards, light = camera(self.ax.elev, self.ax.azim)
        touching = [locus.at(i) for locus in self.scene.on_object]
        points, normals = (np.array([pair[k][i] for pair in touching]).reshape(-1, 3) for k in (0, 1))
        parts = self.parts(i, towards, light)
        for layer, (corners, colours) in zip(self.layers, parts, strict=True):
            layer.corners, layer.colours = corners, colours
        for pair in self.lines:
            for trace in pair:
                trace.show(i, towards)
        self.points.set_data_3d(*points.T)
        length = 3.2 * self.scene.thickness
        for arrow, point, normal in zip(self.normals, points, normals, strict=True):
            arrow.ends = np.stack([point, point + length * normal])
        if self.arrows is not None:
            acting = [(force[i], point) for force, point in zip(self.arrows.contacts, points, strict=True)]
            if self.arrows.load is not None and self.arrows.at is not None:
                acting.append((self.arrows.load[i], self.arrows.at[i]))
            for arrow, (force, point) in zip([*self.forces, *self.load], acting, strict=True):
                # They push on the object: their points are where they act.
                arrow.ends = np.stack([point - force, point])
                arrow.set_visible(bool(np.linalg.norm(force) > 1e-3 * self.scene.thickness))

    def _scale(self) -> str:
        """How long an arrow is, for the legend."""
        scale = 0.0 if self.arrows is None else self.arrows.scale
        return f", 1 N as {scale:.2g} mm" if scale > 0.0 else ""

    def parts(self, i: int, towards: np.ndarray, light: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Triangles, shape (k, 3, 3), and their colours in each of the three layers."""
        scene = self.scene
        behind, before = [NO_TRIANGLES], [NO_TRIANGLES]
        own = [_faces(solid, i, towards, light) for solid in scene.solids if solid.finger < 0]
        centre = scene.solids[0].frames[i, :3] @ towards
        for solid in (s for s in scene.solids if s.finger >= 0):
            skeleton, faces = scene.skeletons[solid.finger][i], _faces(solid, i, towards, light)
            nearer = self._nearer(i, solid.finger, towards)
            (before if nearer else behind).append(faces)
            # Pieces of links as near to the tip's frame as the tip's triangles go into the tip's layer.
            reach = np.linalg.norm(faces[0] - skeleton[-1], axis=-1).max(initial=0.0)
            radius = scene.radii[solid.finger]
            # Links with a radius are capsules, whose ends are no wider than they are.
            look = (scene.thickness, _SWOLLEN) if radius is None else (radius, 1.0)
            for corners, colours in _limbs(skeleton, look, towards, light):
                middles = corners.mean(axis=1)
                within = np.linalg.norm(middles - skeleton[-1], axis=-1) < reach
                first = np.where(within, nearer, middles @ towards > centre)
                before.append((corners[first], colours[first]))
                behind.append((corners[~first], colours[~first]))
        return [_joined(layer) for layer in (behind, own, before)]

    def _nearer(self, i: int, finger: int, towards: np.ndarray) -> bool:
        """Whether a tip is before the object: its side of the tangent plane between them tells."""
        on = [locus for tip, locus in zip(self.scene.on_tips, self.scene.on_object, strict=True)
              if tip.finger == finger]  # fmt: skip
        if on:
            return bool(np.mean([locus.at(i)[1][i] for locus in on], axis=0) @ towards > 0.0)
        apart = self.scene.skeletons[finger][i, -1] - self.scene.solids[0].frames[i, :3]
        return bool(apart @ towards > 0.0)

    def legend(self, instants: Sequence[int]) -> list[tuple[Any, str]]:
        """Handles and names of what is drawn at some instants."""
        tip = self.scene.tip_name
        entries = [
            (Patch(fc=TIP_BODY, ec=FINGER, lw=1.0), tip),
            (Patch(fc=OBJECT_BODY, ec=OBJECT, lw=1.0), "object"),
            (Line2D([], [], color=LOCUS_TIP, lw=2.8), f"locus of the contact on the {tip}"),
            (Line2D([], [], color=LOCUS_OBJECT, lw=2.8), "locus of the contact on the object"),
            (self.points, "contact point"),
            (Line2D([], [], marker=r"$\rightarrow$", ms=13, ls="none", color=GUIDE), "normal of the object"),
        ]
        if self.forces:
            sign = Line2D([], [], marker=r"$\rightarrow$", ms=14, ls="none", color=FORCE_COLOUR)
            entries.append((sign, f"contact force on the object{self._scale()}"))
        # A push that acts at no time that is shown has no arrow to explain.
        if (
            self.arrows is not None
            and self.arrows.load is not None
            and self.arrows.load[list(instants)].any()
        ):
            sign = Line2D([], [], marker=r"$\rightarrow$", ms=14, ls="none", color=LOAD_COLOUR)
            entries.append((sign, "load on the object"))
        return entries


class _Trace:
    """A locus on its surface: strong on the near side, faint and dotted on the far one."""

    def __init__(self, ax: Axes3, locus: DrawnLocus, colour: str) -> None:
        self.locus = locus
        self.halo = _line(ax, lw=4.2, zorder=49, alpha=0.75, **_WHITE)
        self.far = _line(ax, lw=2.0, zorder=50, alpha=0.6, color=colour, ls=(0, (2, 0.8)))
        self.near = _line(ax, lw=2.6, zorder=51, color=colour, solid_capstyle="round")

    def show(self, i: int, towards: np.ndarray) -> None:
        points, normals = self.locus.at(i)
        points, normals = points[: i + 1], normals[: i + 1]
        before = (normals @ towards > 0.0)[:, None]
        self.far.set_data_3d(*points.T)
        for line in (self.near, self.halo):
            line.set_data_3d(*np.where(before, points, np.nan).T)


def _line(ax: Axes3, **style: Any) -> Any:
    (line,) = ax.plot([], [], [], **style)
    return line


def _arrow(ax: Axes3, colour: str, width: float, head: float, zorder: float) -> Arrow:
    arrow = Arrow(color=colour, lw=width, mutation_scale=head, zorder=zorder)
    ax.add_artist(arrow)
    return arrow


def _joined(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    corners, colours = zip(*parts, strict=True)
    return np.concatenate(corners), np.concatenate(colours)


def _layer(ax: Axes3, zorder: float) -> Triangles:
    """An artist whose triangles hide each other, but as a whole let through a little of what is behind."""
    triangles = Triangles(zorder=zorder)
    triangles.set_agg_filter(_softened)
    ax.add_artist(triangles)
    return triangles


def _softened(image: Any, _: float) -> tuple[np.ndarray, int, int]:
    image[..., 3] *= _OPAQUE
    return image, 0, 0


def _faces(solid: Solid, i: int, towards: np.ndarray, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    corners = solid.at(i)[solid.mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # A triangle without area has no normal, and is not to divide by zero.
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    checks = solid.mesh.checks
    if solid.mesh.closed:
        # Of a closed body only what faces the camera is drawn; an open surface has two sides, both lit.
        seen = normals @ towards > 0.0
        corners, normals, checks = corners[seen], normals[seen], checks[seen]
    else:
        normals = normals * np.where(normals @ towards > 0.0, 1.0, -1.0)[:, None]
    colour = OBJECT_BODY if solid.finger < 0 else TIP_BODY
    return corners, chequered(lit(colour, normals, light, towards), checks)


def _limbs(
    joints: np.ndarray, look: tuple[float, float], towards: np.ndarray, light: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Links of a radius, and joints of some times that radius: the numbers of `look`."""
    if len(joints) < 2:
        return []
    radius, swell = look
    parts = [(*tube_mesh(a, b, radius), LINK_BODY) for a, b in zip(joints[:-1], joints[1:], strict=True)]
    parts += [(*ball(joint, swell * radius), JOINT_BODY) for joint in joints[:-1]]
    found = []
    for corners, normals, colour in parts:
        # A little past the visible edge too, since each flat strip has a single normal.
        seen = normals @ towards > -0.1
        found.append((corners[seen], lit(colour, normals[seen], light, towards)))
    return found
