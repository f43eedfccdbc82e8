"""A page to turn a grasp round in a browser, or to play one in the plane: the only door to plotly."""

from pathlib import Path
from typing import Any

import numpy as np

from .._integration import Trajectory
from .._mechanics import Grasp
from .._results import missing_library
from ._doors import guarded
from ._forces3 import Pushes, pushes
from ._motion3 import Motion3D, times_of
from ._page_parts import checked_page, controls, PAGE_FONT, page_times, write_html
from ._page_plane import plane_figure
from ._poses3 import facing, scaled, tick_step
from ._scene3 import DrawnLocus, Scene3, scene3, Solid
from ._style import (
    CONTACT,
    FORCE_COLOUR,
    JOINT_BODY,
    LINK_BODY,
    LOCUS_OBJECT,
    LOCUS_TIP,
    OBJECT_BODY,
    TIP_BODY,
)
from ._tubes import camera, shades
from ._views import single, visible
from ._views3 import check_options, scene_motion, View

_LIGHT = {
    "ambient": 0.66,
    "diffuse": 0.5,
    "specular": 0.2,
    "roughness": 0.45,
    "fresnel": 0.05,
    "facenormalsepsilon": 0.0,
    "vertexnormalsepsilon": 0.0,
}
# In the axes of the camera: to the right, up, and away from it.
_LAMP = {"x": -5e4, "y": 8e4, "z": -1e5}
# Width and height of the box of the axes as seen, and distance of the camera, as plotly counts.
_SEEN, _DISTANCE = (2.3, 1.7), 2.2
# Rows and columns of a mesh: all positions of all vertices are in the file.
_MESH = (18, 36)
# How far loci are lifted off their surfaces, over the thickness of a link.
_LIFT = 0.07
# Radius of the rings, over the thickness of a link.
_RING = 1.5
# A mesh with no more triangles has edges.
_FEW = 12
# How many points of a locus are shown at most.
_POINTS = 160


def plotly_door() -> Any:
    """Plotly's graph objects, imported with their first use."""
    try:
        import plotly.graph_objects as plotly
    except ImportError:
        raise missing_library("plotly", "viz") from None
    return plotly


@guarded
def page(
    grasp: Grasp,
    trajectory: Trajectory,
    path: str | Path = "grasp.html",
    *,
    title: str = "Rolling contact",
    frames: int = 40,
    view: View | None = None,
) -> Path:
    """Write a run as one HTML file, to be played in a browser, and of a grasp in space to be turned round.

    It opens at the start. The file needs nothing else, no network either: plotly's script is within, 4.8 MB,
    and each frame adds some 40 kB for an object and two fingertips in space. Every frame is the saved state
    nearest to a round time. Where contact forces were recorded, they and the force of all loads are drawn on
    the object, with their scale.

    Args:
        grasp: The grasp that was simulated.
        trajectory: One run of it.
        path: The file to write, ending in `.html`; its folder is made if need be.
        title: What stands above the picture.
        frames: How many instants can be shown at most, evenly spaced in time.
        view: How to look at a grasp in space at first.

    Returns:
        The path that was written.

    Raises:
        ValueError: If the trajectory is a batch, `path` is no HTML file, `view` is given for a grasp in the
            plane, or a surface cannot be drawn.
        ImportError: Without the extra `viz`.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=3.0)
        >>> plotting.page(grasp, run, "grasp.html").name
        'grasp.html'
    """
    if not grasp.spatial:
        check_options(grasp, view=view)
    trajectory = visible(grasp, trajectory)
    ts, reached = single(trajectory)
    if not grasp.spatial:
        path, frames = checked_page(path, frames)
        rows = np.flatnonzero(reached)[page_times(ts[reached], frames)]
        return write_html(plane_figure(plotly_door(), grasp, trajectory, rows, title=title), path)
    motion = scene_motion(grasp, trajectory.states)
    forces = None if trajectory.multipliers is None else pushes(grasp, trajectory, motion)
    return write_page(grasp, motion, ts, path, title=title, frames=frames, view=view, forces=forces)


def write_page(
    grasp: Grasp,
    motion: Motion3D,
    ts: np.ndarray,
    path: str | Path,
    *,
    title: str = "Rolling contact",
    frames: int = 40,
    view: View | None = None,
    forces: Pushes | None = None,
) -> Path:
    """Write a motion at the times `ts`, as `page` does."""
    plotly, view = plotly_door(), View() if view is None else view
    ts = times_of(motion, ts)
    path, frames = checked_page(path, frames)
    motion, reached = motion.reached()
    ts = ts[reached]
    scene = scene3(grasp, motion, rows=_MESH[0], columns=_MESH[1], links=view.links)
    rows = page_times(ts, frames)
    arrows = None if forces is None else scaled(scene, forces, reached)
    still, start = _still(scene, arrows), _moving(scene, 0, arrows)
    kinds = [plotly.Mesh3d if "i" in trace else plotly.Scatter3d for trace in still]
    seen = [
        plotly.Frame(
            data=[kind(moved) for kind, moved in zip(kinds, _moving(scene, int(row), arrows), strict=True)],
            name=str(k),
            traces=list(range(len(kinds))),
        )
        for k, row in enumerate(rows)
    ]
    figure = plotly.Figure(
        data=[kind(a | b) for kind, a, b in zip(kinds, still, start, strict=True)],
        layout=_layout(scene, title, ts[rows], facing(scene, view)),
        frames=seen,
    )
    return write_html(figure, path)


def _still(scene: Scene3, arrows: Pushes | None) -> list[dict[str, Any]]:
    """Of each trace what does not change: first the solids, then fingers, loci, contact points."""
    found = [
        _solid(solid, scene.tip_name if solid.finger >= 0 else "object", k)
        for k, solid in enumerate(scene.solids)
    ]
    found += [_limbs(scene, k) for k in range(len(scene.skeletons))]
    for k in range(len(scene.on_tips)):
        found += [
            _trace(f"locus on the {scene.tip_name}", LOCUS_TIP, first=k == 0),
            _trace("locus on the object", LOCUS_OBJECT, first=k == 0),
        ]
    line = {"color": CONTACT, "width": 5}
    found.append({"mode": "lines", "line": line, "name": "contact: ring in the tangent plane"})
    if arrows is not None:
        line = {"color": FORCE_COLOUR, "width": 7}
        what = "contact force" if arrows.load is None else "force"
        name = f"{what} on the object, 1 N as {arrows.scale:.2g} mm"
        found.append({"mode": "lines", "line": line, "name": name})
    return found


def _moving(scene: Scene3, i: int, arrows: Pushes | None) -> list[dict[str, Any]]:
    """The positions of each trace at instant i."""
    found = [_xyz(solid.at(i)) for solid in scene.solids]
    found += [_xyz(skeleton[i]) for skeleton in scene.skeletons]
    for on_tip, on_object in zip(scene.on_tips, scene.on_object, strict=True):
        found += [_xyz(_path(scene, locus, i)) for locus in (on_tip, on_object)]
    rings = [_ring(scene, locus, i) for locus in scene.on_object]
    found.append(_xyz(np.reshape(rings, (-1, 3))))
    if arrows is not None:
        found.append(_xyz(np.concatenate([_shaft(*each) for each in _acting(scene, i, arrows)])))
    return found


def _acting(scene: Scene3, i: int, arrows: Pushes) -> list[tuple[np.ndarray, np.ndarray]]:
    """Where each force acts, and its arrow, which ends there [mm]: those of contacts, then that of loads."""
    points = [locus.at(i)[0][i] for locus in scene.on_object]
    found = list(zip(points, arrows.contacts[:, i], strict=True))
    if arrows.load is not None and arrows.at is not None:
        found.append((arrows.at[i], arrows.load[i]))
    return found


def _shaft(point: np.ndarray, force: np.ndarray) -> np.ndarray:
    """A line to a point with two barbs, whose size goes with it; it ends with a gap."""
    aside = np.cross(force, np.eye(3)[np.argmin(np.abs(force))])
    aside *= 0.09 * np.linalg.norm(force) / max(float(np.linalg.norm(aside)), 1e-300)
    foot = point - 0.22 * force
    return np.stack([point - force, point, foot + aside, point, foot - aside, np.full(3, np.nan)])


def _ring(scene: Scene3, locus: DrawnLocus, i: int) -> np.ndarray:
    """A circle about the contact in the tangent plane, which no convex body hides; it ends with a gap."""
    points, normals = locus.at(i)
    first = np.cross(normals[i], np.eye(3)[np.argmin(np.abs(normals[i]))])
    first /= np.linalg.norm(first)
    angle = np.linspace(0.0, 2.0 * np.pi, 37)[:, None]
    along = np.cos(angle) * first + np.sin(angle) * np.cross(normals[i], first)
    return np.append(points[i] + _RING * scene.thickness * along, np.full((1, 3), np.nan), axis=0)


def _path(scene: Scene3, locus: DrawnLocus, i: int) -> np.ndarray:
    """A locus up to an instant, lifted off its surface so that it is not sunk in the flat triangles."""
    # Thinned out, for every frame holds its loci in full.
    some = np.unique(np.linspace(0, i, min(i, _POINTS) + 1).astype(int))
    return locus.at(i, _LIFT * scene.thickness)[0][some]


def _xyz(points: np.ndarray) -> dict[str, np.ndarray]:
    return {axis: points[:, k].astype(np.float32) for k, axis in enumerate("xyz")}


def _solid(solid: Solid, name: str, k: int) -> dict[str, Any]:
    colour = OBJECT_BODY if solid.finger < 0 else TIP_BODY
    corners = solid.mesh.faces.astype(np.int32)
    return {
        **{name: corners[:, c] for c, name in enumerate("ijk")},
        "facecolor": shades(colour, solid.mesh.checks),
        "opacity": 0.6 if _flat(solid) else 1.0,
        "flatshading": len(solid.mesh.faces) <= _FEW,
        "lighting": _LIGHT,
        "lightposition": _LAMP,
        "name": name,
        "color": colour,
        "legendgroup": name,
        "showlegend": k == 0 or solid.finger == 0,
        "hoverinfo": "skip",
    }


def _flat(solid: Solid) -> bool:
    """Whether it is a plane, to be seen through from below."""
    areas = solid.mesh.areas
    # Area vectors add up to zero over a closed surface, and to the whole area over a plane.
    return bool(np.linalg.norm(areas.sum(axis=0)) > 0.999 * np.linalg.norm(areas, axis=1).sum())


def _limbs(scene: Scene3, finger: int) -> dict[str, Any]:
    drawn = scene.skeletons[finger].shape[1] > 1
    return {
        "mode": "lines+markers" if drawn else "markers",
        "line": {"color": LINK_BODY, "width": 14},
        "marker": {"size": 9 if drawn else 0.1, "color": JOINT_BODY},
        "name": "links",
        "legendgroup": "links",
        "showlegend": drawn and not any(s.shape[1] > 1 for s in scene.skeletons[:finger]),
        "hoverinfo": "skip",
    }


def _trace(name: str, colour: str, *, first: bool) -> dict[str, Any]:
    line = {"color": colour, "width": 6}
    return {"mode": "lines", "line": line, "name": name, "legendgroup": name, "showlegend": first}


def _layout(scene: Scene3, title: str, ts: np.ndarray, angles: tuple[float, float]) -> dict[str, Any]:
    low, high = scene.corners + np.array([[-1.5], [1.5]]) * scene.thickness
    axes = {
        f"{axis}axis": {
            # The empty line keeps the title clear of the numbers.
            "title": {"text": f"<br>{axis} [mm]", "font": {"size": 13}},
            "tickfont": {"size": 11},
            "dtick": tick_step(high - low),
            "range": [float(low[k]), float(high[k])],
            "backgroundcolor": "#F6F7F8",
            "gridcolor": "#DDE1E4",
            "showbackground": True,
            "zeroline": False,
            "showspikes": False,
        }
        for k, axis in enumerate("xyz")
    }
    towards, _ = camera(*angles)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    # What is seen of the box of the axes from there fits into the window.
    seen = [(high - low) @ np.abs(axis) for axis in (right, np.cross(towards, right))]
    spans = (high - low) * min(most / whole for most, whole in zip(_SEEN, seen, strict=True))
    eye = {"eye": _point(_DISTANCE * towards), "projection": {"type": "orthographic"}}
    return {
        "title": {"text": title, "x": 0.5, "xanchor": "center", "font": {"size": 18}},
        "font": PAGE_FONT,
        "paper_bgcolor": "white",
        "margin": {"l": 10, "r": 10, "t": 60, "b": 10},
        "scene": axes | {"aspectmode": "manual", "aspectratio": _point(spans), "camera": eye},
        "legend": {"x": 0.01, "y": 0.98, "bgcolor": "rgba(255,255,255,0.8)", "itemsizing": "constant"},
        # As long as this stays the same, plotly keeps the reader's camera from frame to frame.
        "uirevision": "kept",
        **controls(ts),
    }


def _point(values: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", values.tolist(), strict=True))
