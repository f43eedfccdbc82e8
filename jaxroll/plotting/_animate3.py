"""Animations of a run in space."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from . import _gif
from ._drawing3 import Drawing3
from ._motion3 import Motion3D, SpatialGrasp, times_of
from ._scene3 import looking, scene3
from ._space import finish, heading, scaled, stage
from ._style import CONTACT, FINGER, FORCE, GUIDE, LOCUS_OBJECT, LOCUS_TIP, OBJECT

# Each frame is drawn afresh, some 0.3 s: no more of them than this.
_MOST = 60
_KEPT = ("white", CONTACT, FINGER, FORCE, GUIDE, LOCUS_OBJECT, LOCUS_TIP, OBJECT)


def animate3(
    grasp: SpatialGrasp,
    motion: Motion3D,
    ts: np.ndarray,
    path: str | Path = "motion.gif",
    *,
    fps: float = 20.0,
    speed: float = 1.0,
    forces: np.ndarray | None = None,
    links: bool = True,
    view: tuple[float, float, float] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a run of a spatial grasp as an animated GIF, to scale.

    Shows the loci of the contacts grow on both surfaces. Every frame is the state nearest to its time, never
    a blend of two. There are at most 60 frames, some 0.3 s of work each: for more time than these last, the
    file has fewer frames per second.

    Args:
        grasp: The grasp that was simulated.
        motion: Its motion.
        ts: The times of the motion, shape (t,) [s].
        path: The file to write, ending in `.gif`; its folder is made if need be.
        fps: Frames per second of the file, at most 50.
        speed: Simulated seconds per second shown: 0.5 plays at half speed.
        forces: Contact forces on the object in world axes to draw, shape (c, t, 3) [N].
        links: Whether to draw the links of the fingers.
        view: Elevation and azimuth of the camera, and by how much it goes round, in degrees. Default: it
            stands still, and sees the first contact from the side.
        progress: Called after each frame with the frames done and the frames in all.

    Returns:
        The path that was written.

    Raises:
        ValueError: If `path` is no GIF, a number is not positive, times or forces do not fit the motion, or
            a surface cannot be drawn.

    Example:
        >>> import tempfile
        >>> import numpy as np
        >>> from types import SimpleNamespace as Record
        >>> from jaxroll import geometry, plotting
        >>> hand = Record(tip=geometry.Plane())
        >>> ball = Record(surfaces=(geometry.Sphere(0.02),), outline=None)
        >>> grasp = Record(object=ball, fingers=(hand,), contacts=(Record(finger=0, surface=0),))
        >>> turn, zero = np.linspace(0.0, 1.0, 3), np.zeros(3)  # a ball rolls on the palm
        >>> columns = [0.02 * turn, zero, zero + 0.02, np.cos(turn / 2), zero, np.sin(turn / 2), zero]
        >>> palm = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (3, 1))
        >>> motion = plotting.Motion3D(
        ...     np.stack(columns, -1),
        ...     palm[None],
        ...     [palm[:, None, :3]],
        ...     np.stack([0.02 * turn, zero, zero], -1)[None],
        ...     0.02 * np.stack([np.sin(turn), zero, -np.cos(turn)], -1)[None],
        ... )
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     plotting.animate3(grasp, motion, np.linspace(0, 0.1, 3), f"{folder}/roll.gif").name
        'roll.gif'
    """
    path = _gif.checked(path, fps=fps, speed=speed)
    ts = times_of(motion, ts)
    motion, reached = motion.reached()
    ts = ts[reached]
    rows, delay = _paced(ts, fps, speed)
    scene = scene3(grasp, motion, links=links)
    elevation, azimuth, turn = (*looking(scene), 0.0) if view is None else view
    azimuths = azimuth + turn * (ts[rows] - ts[0]) / max(ts[-1] - ts[0], 1e-300)
    figure, ax = stage(scene, (elevation, azimuth), 5.6, azimuths)
    figure.set_dpi(100)
    drawing = Drawing3(ax, scene, arrows=None if forces is None else scaled(scene, forces, reached))
    finish(figure, drawing, "")
    clock = heading(figure, "", 0.04, ha="left")
    pace = "real time" if speed == 1.0 else f"shown at {speed:g} x real time"
    heading(figure, pace, 0.96, ha="right", fontsize=8.5, color="#555555")
    frames = []
    for done, (row, azimuth) in enumerate(zip(rows, azimuths, strict=True), 1):
        ax.view_init(elevation, azimuth)
        drawing.show(int(row))
        clock.set_text(f"t = {ts[row]:.2f} s")
        figure.agg.draw()
        frames.append(Image.fromarray(np.asarray(figure.agg.buffer_rgba())[..., :3].copy()))
        if progress is not None:
            progress(done, len(rows))
    _gif.write(path, frames, delay, _KEPT)
    return path


def _paced(ts: np.ndarray, fps: float, speed: float) -> tuple[np.ndarray, int]:
    """The rows to show and how long each stays [ms]."""
    # A GIF counts hundredths of a second.
    delay = 0.01 * max(2, round(100.0 / fps))
    slowest = (ts[-1] - ts[0]) / speed / (_MOST - 1)
    delay = max(delay, 0.01 * np.ceil(100.0 * slowest - 1e-9))
    return _gif.nearest(ts, delay * speed), round(1000.0 * delay)
