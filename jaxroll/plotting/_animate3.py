"""Animations of a run in space."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from .._mechanics import Grasp
from . import _film, _gif
from ._drawing3 import Drawing3
from ._forces3 import Pushes
from ._motion3 import Motion3D, times_of
from ._poses3 import facing, heading, legend, scaled, stage
from ._scene3 import scene3
from ._style import CONTACT, FINGER, FORCE_COLOUR, GUIDE, LOCUS_OBJECT, LOCUS_TIP, OBJECT
from ._views3 import View

# The most frames, since each is drawn afresh, which takes some 0.3 s.
_MOST = 60
# Colours that the palette of a GIF keeps as they are.
_KEPT = ("white", CONTACT, FINGER, FORCE_COLOUR, GUIDE, LOCUS_OBJECT, LOCUS_TIP, OBJECT)


def animate3(
    grasp: Grasp,
    motion: Motion3D,
    ts: np.ndarray,
    path: str | Path,
    *,
    fps: float = 25.0,
    speed: float = 1.0,
    forces: Pushes | None = None,
    size: float = 5.5,
    view: View | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a motion of a spatial grasp as an animated GIF or an MP4, to scale.

    Args:
        grasp: The grasp that was simulated.
        motion: Its motion.
        ts: The times of the motion, shape (t,) [s].
        path: The file to write.
        fps: Frames per second of the file.
        speed: Simulated seconds per second shown.
        forces: Forces on the object to draw.
        size: Width of the picture in inches of 100 pixels.
        view: How to look at it.
        progress: Called after each frame with the frames done and the frames in all.

    Raises:
        ValueError: If `path` ends neither in .gif nor in .mp4, a number is not positive, times or forces do
            not fit the motion, or a surface cannot be drawn.
    """
    path, view = _film.checked_path(path), View() if view is None else view
    fps, speed, size = _film.positive_numbers(fps=fps, speed=speed, size=size)
    ts = times_of(motion, ts)
    motion, reached = motion.reached()
    ts = ts[reached]
    rows, delay = _paced(ts, fps, speed)
    scene = scene3(grasp, motion, links=view.links)
    elevation, azimuth = facing(scene, view)
    azimuths = azimuth + view.turn * (ts[rows] - ts[0]) / max(ts[-1] - ts[0], 1e-300)
    loaded = forces is not None and forces.load is not None
    figure, (ax,) = stage(scene, (elevation, azimuth), size, azimuths, loaded=loaded)
    figure.set_dpi(100)
    drawing = Drawing3(ax, scene, arrows=None if forces is None else scaled(scene, forces, reached))
    legend(figure, drawing, rows.tolist())
    clock = heading(figure, "", 0.04, ha="left")
    pace = "real time" if speed == 1.0 else f"shown at {speed:g} x real time"
    heading(figure, pace, 0.96, ha="right", fontsize=8.5, color="#555555")
    frames = []
    texts = _film.clock_texts(ts[rows])
    for done, (row, turn, told) in enumerate(zip(rows, azimuths, texts, strict=True), 1):
        ax.view_init(elevation, turn)
        drawing.show(int(row))
        clock.set_text(told)
        figure.agg.draw()
        frames.append(Image.fromarray(np.asarray(figure.agg.buffer_rgba())[..., :3].copy()))
        if progress is not None:
            progress(done, len(rows))
    _film.write_film(path, frames, delay, _KEPT)
    return path


def _paced(ts: np.ndarray, fps: float, speed: float) -> tuple[np.ndarray, int]:
    """The rows to show and how long each stays [ms]."""
    delay = 0.01 * _film.hundredths(fps)
    slowest = (ts[-1] - ts[0]) / speed / (_MOST - 1)
    delay = max(delay, 0.01 * np.ceil(100.0 * _film.check_delay("speed", speed, slowest) - 1e-9))
    rows = _gif.nearest_rows(ts, delay * speed)
    _film.check_stays("speed", speed, rows, delay)
    return rows, round(1000.0 * delay)
