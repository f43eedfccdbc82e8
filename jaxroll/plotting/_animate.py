"""Animations of a run: what moves is redrawn over a still background."""

from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from PIL import Image

from .._integration import Trajectory
from .._mechanics import Grasp
from .._results import up_to
from ._animate3 import animate3
from ._artists import Drawing, limits
from ._doors import check_frames, guarded
from ._film import check_stays, checked_path, clock_texts, hundredths, write_film
from ._forces import Arrows, arrows, key
from ._forces3 import pushes
from ._gif import nearest_rows
from ._style import Picture, tidy
from ._views import single, Views, views, visible
from ._views3 import check_options, scene_motion, View


@guarded
def animate(
    grasp: Grasp,
    trajectory: Trajectory,
    path: str | Path = "motion.gif",
    *,
    fps: float = 25.0,
    speed: float = 1.0,
    until: float | None = None,
    forces: bool | None = None,
    size: float = 5.5,
    view: View | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a run as an animated GIF or an MP4 with true contours or surfaces, to scale.

    In the plane thick stretches of equal length on both contours show what has rolled; in space the loci of
    the contacts on both surfaces do. Forces on the object are drawn if they were recorded. Every frame is the
    saved state nearest to its time, never a blend of two; save at least `fps / speed` states per second for
    smooth motion. A run that ended before a state was saved is one frame: where it ended. In space a frame
    takes some 0.3 s to draw, and there are at most 60: a longer animation has fewer frames per second.

    Args:
        grasp: The grasp that was simulated.
        trajectory: One run of it.
        path: The file to write, ending in `.gif`, or in `.mp4` where the program ffmpeg is installed; its
            folder is made if need be.
        fps: Frames per second of the file, at most 50. A GIF counts in hundredths of a second: the nearest
            rate that this allows is taken, for an MP4 too.
        speed: Simulated seconds per second shown: 0.5 plays at half speed.
        until: Last time shown [s]. Default: the end of the run.
        forces: Whether to draw the contact forces on the object and the force of its loads, with their
            scale. Contact forces must have been recorded; by default forces are drawn if they were.
        size: Longer side of the drawing, without its legend, in inches of 100 pixels; in space its width.
        view: How to look at a grasp in space.
        progress: Called after each frame with the frames done and the frames in all.

    Returns:
        The path that was written.

    Raises:
        ValueError: If the trajectory is a batch, `path` ends otherwise or there is no ffmpeg, a number is not
            positive, `until` comes before the first saved state, there would be more than 5000 frames in the
            plane, a saved state would stay for more than the 655 s that a GIF can say, `view` is given for a
            grasp in the plane, or `forces` is True and the run was not simulated with
            `record=("multipliers",)`.

    Example:
        >>> import tempfile
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=0.1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = plotting.animate(grasp, run, f"{folder}/motion.gif", fps=20, size=3)
        ...     path.name
        'motion.gif'
    """
    path = checked_path(path)
    trajectory = visible(grasp, trajectory)
    drawn = trajectory.multipliers is not None if forces is None else forces
    ts, rows = _shown(trajectory, until)
    if grasp.spatial:
        motion = scene_motion(grasp, trajectory.states)
        pushed = pushes(grasp, trajectory, motion).rows(rows) if drawn else None
        pace = {"fps": fps, "speed": speed, "progress": progress}
        return animate3(grasp, motion.at(rows), ts, path, forces=pushed, size=size, view=view, **pace)
    check_options(grasp, view=view)
    delay = hundredths(fps)
    check_frames("speed", (ts[-1] - ts[0]) / (0.01 * delay * speed))
    seen_at = nearest_rows(ts, 0.01 * delay * speed)
    check_stays("speed", speed, seen_at, 0.01 * delay)
    ts, picks = ts[seen_at], rows[seen_at]
    states = jax.tree.map(lambda a: np.asarray(a)[picks], trajectory.states)
    seen = views(grasp, states)
    corners = limits(seen, above=0.05 * drawn)
    shafts = arrows(grasp, trajectory, picks, seen, corners=corners) if drawn else None
    clocks, look = clock_texts(ts), {"corners": corners, "size": size, "speed": speed}
    stage = _Stage(grasp, seen, shafts, **look, clock=max(clocks, key=len))
    frames = []
    for i, clock in enumerate(clocks):
        frames.append(stage.frame(i, clock))
        if progress is not None:
            progress(i + 1, len(ts))
    write_film(path, frames, 10 * delay)
    return path


def _shown(trajectory: Trajectory, until: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Times and rows of the saved states that were reached, up to a time."""
    ts, reached = single(trajectory)
    if until is not None:
        reached = reached & up_to(ts, until)
        if not reached.any():
            raise ValueError(f"argument until must be at least the first saved time, but was {until:g}")
    return ts[reached], np.flatnonzero(reached)


class _Stage:
    """A still background, and the artists that move over it."""

    def __init__(
        self,
        grasp: Grasp,
        seen: Views,
        forces: Arrows | None,
        *,
        corners: np.ndarray,
        size: float,
        speed: float,
        clock: str,
    ) -> None:
        low, high = corners
        width, height = size * (high - low) / (high - low).max()
        figure = Picture(max(width + 0.7, 4.6), height + 1.9)
        figure.set_dpi(100)
        self.ax = ax = figure.subplots()
        self.drawing = Drawing(ax, grasp, seen, forces=forces, traced=True)
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        ax.ticklabel_format(style="plain")  # a power of ten would stand where the clock is
        tidy(ax, xlabel="x [mm]", ylabel="y [mm]")
        # Made with the longest text of all frames, which says what room is left beside it (`_freeze`).
        self.clock = ax.text(0.0, 1.02, clock, transform=ax.transAxes, fontsize=10)
        pace = "real time" if speed == 1.0 else f"shown at {speed:g} x real time"
        self.pace = ax.text(1.0, 1.02, pace, transform=ax.transAxes, fontsize=8, ha="right", color="#555555")
        # Drawn by hand in every frame, and so in the order in which matplotlib would draw them.
        moving = sorted([*ax.lines, *ax.patches], key=lambda a: a.get_zorder())
        self.moving = [*moving, self.clock]
        if forces is not None:
            key(ax, forces)
        handles, names = zip(*self.drawing.legend(), strict=True)
        figure.legend(handles, names, loc="outside lower center", ncols=2, fontsize=7, frameon=False)
        self._freeze(figure)

    def _freeze(self, figure: Picture) -> None:
        # Laid out once: the axes must not move from frame to frame.
        figure.draw_without_rendering()
        clock, pace, axes = (each.get_window_extent() for each in (self.clock, self.pace, self.ax))
        if clock.x1 + clock.height > pace.x0:  # a narrow picture: the pace goes to a line above the clock
            self.pace.set_y(1.02 + 1.4 * clock.height / axes.height)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        for artist in self.moving:
            artist.set_animated(True)
        self.canvas = figure.agg
        self.canvas.draw()
        self.background = self.canvas.copy_from_bbox(figure.bbox)

    def frame(self, i: int, clock: str) -> Image.Image:
        self.drawing.show(i)
        self.clock.set_text(clock)
        self.canvas.restore_region(self.background)
        for artist in self.moving:
            self.ax.draw_artist(artist)
        return Image.fromarray(np.asarray(self.canvas.buffer_rgba())[..., :3].copy())
