"""A grasp in the plane as a figure of plotly, frame by frame."""

from typing import Any

import jax
import numpy as np

from .._integration import Trajectory
from .._mechanics import Grasp
from ._artists import limits
from ._forces import Arrows, arrows
from ._outlines import Outline
from ._page_parts import controls, PAGE_FONT
from ._style import CONTACT, FINGER, FORCE_COLOUR, LINK_FILL, OBJECT, OBJECT_FILL, ROLLED, TIP_FILL
from ._views import place, Views, views

_GAP = np.full((1, 2), np.nan)


def plane_figure(plotly: Any, grasp: Grasp, run: Trajectory, rows: np.ndarray, *, title: str) -> Any:
    """The figure of a run at the saved rows: bodies, links, what has rolled, contact points, forces.

    Args:
        plotly: Plotly's graph objects.
        grasp: The grasp that was simulated.
        run: One run of it.
        rows: Which of its saved states to show.
        title: What stands above.
    """
    ts = np.asarray(run.ts)[rows]
    seen = views(grasp, jax.tree.map(lambda a: np.asarray(a)[rows], run.states))
    corners = limits(seen)
    shafts = None if run.multipliers is None else arrows(grasp, run, rows, seen, corners=corners)
    still = _still(seen, shafts)
    frames = [
        plotly.Frame(
            data=[plotly.Scatter(_xy(part)) for part in _moving(seen, shafts, k)],
            name=str(k),
            traces=list(range(len(still))),
        )
        for k in range(len(rows))
    ]
    first = _moving(seen, shafts, 0)
    data = [plotly.Scatter(trace | _xy(part)) for trace, part in zip(still, first, strict=True)]
    return plotly.Figure(data=data, layout=_layout(corners, title, ts), frames=frames)


def _still(seen: Views, shafts: Arrows | None) -> list[dict[str, Any]]:
    """Of each trace what does not change."""
    links = {"mode": "lines+markers", "line": {"color": LINK_FILL, "width": 14}, "name": "links"}
    joint = {"size": 8, "color": "white", "line": {"color": "#55636E", "width": 1.5}}
    found = [links | {"marker": joint}]
    colours = [(OBJECT_FILL, OBJECT, "object"), *[(TIP_FILL, FINGER, "fingertip") for _ in seen.tips]]
    for k, (fill, edge, name) in enumerate(colours):
        body = {"mode": "lines", "fill": "toself", "fillcolor": fill, "line": {"color": edge, "width": 2}}
        found.append(body | {"name": name, "legendgroup": name, "showlegend": k < 2})
    rolled = {"mode": "lines", "line": {"color": ROLLED, "width": 5}}
    found.append(rolled | {"name": "rolled so far: as long on both bodies"})
    points = {"size": 9, "color": CONTACT, "line": {"color": "white", "width": 1}}
    found.append({"mode": "markers", "marker": points, "name": "contact points"})
    if shafts is not None:
        head = {"symbol": "arrow", "size": 13, "angleref": "previous", "color": FORCE_COLOUR}
        name = f"force on the object, 1 N as {shafts.scale:.2g} mm"
        line = {"color": FORCE_COLOUR, "width": 3}
        found.append({"mode": "lines+markers", "line": line, "marker": head, "name": name})
    return [{"hoverinfo": "skip"} | trace for trace in found]


def _moving(seen: Views, shafts: Arrows | None, i: int) -> list[np.ndarray]:
    """The points of each trace at instant i, pieces apart by a gap."""
    links = [piece for joints in seen.joints for piece in (joints[i], _GAP)]
    bodies = [_placed(shape, seen.frames[k][i]) for k, shape in enumerate((seen.body, *seen.tips))]
    rolled = [
        piece
        for owner, paths in zip(seen.owners, seen.rolled, strict=True)
        for body, path in zip((1 + owner, 0), paths, strict=True)
        for piece in (place(seen.frames[body][i], path[: i + 1]), _GAP)
    ]
    found = [np.concatenate(links), *bodies, np.concatenate([*rolled, _GAP]), seen.points[i]]
    if shafts is not None:
        ends = zip(shafts.points[i], shafts.points[i] + shafts.vectors[i], strict=True)
        # Of a caller's own contacts no forces are drawn: there may be none.
        pieces = [piece for pair in ends for piece in (np.stack(pair), _GAP)]
        found.append(np.concatenate(pieces or [_GAP]))
    return found


def _placed(shape: Outline, frame: np.ndarray) -> np.ndarray:
    """Closed outlines in the world."""
    rings = [np.append(ring, ring[:1], axis=0) for ring in shape.rings]
    return np.concatenate([piece for ring in rings for piece in (place(frame, ring), _GAP)])


def _xy(points: np.ndarray) -> dict[str, np.ndarray]:
    return {axis: points[:, k].astype(np.float32) for k, axis in enumerate("xy")}


def _layout(corners: np.ndarray, title: str, ts: np.ndarray) -> dict[str, Any]:
    look = {"showgrid": True, "gridcolor": "#EDF0F2", "zeroline": False, "ticks": "outside"}
    across, up = corners.T
    return {
        "font": PAGE_FONT,
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "margin": {"l": 60, "r": 20, "t": 20, "b": 40},
        "xaxis": look | {"title": {"text": "x [mm]"}, "range": across.tolist(), "constrain": "domain"},
        "yaxis": look
        | {"title": {"text": "y [mm]"}, "range": up.tolist(), "scaleanchor": "x", "constrain": "domain"},
        # Above, so that button and slider have the whole width. What stands above the picture is the legend's
        # own title: a figure's would be met by a legend of several lines, as narrow pages have it.
        "legend": {
            "title": {"text": title, "side": "top center", "font": {"size": 18}},
            "orientation": "h",
            "x": 0.5,
            "xanchor": "center",
            "y": 1.0,
            "yanchor": "bottom",
        },
        **controls(ts),
    }
