"""What `jaxroll replay` does: a run that `jaxroll.save` wrote is told of, drawn and animated again."""

import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from .. import plotting
from .._integration import Trajectory
from .._mechanics import Grasp
from .._saving import load
from ._replay_order import ReplayOrder

# The animation takes no longer than this [s], unless a speed is asked for.
_LONGEST = 12.0


def replayed(asked: ReplayOrder, folder: Path, timed: Callable[[str], AbstractContextManager]) -> list[str]:
    """Read, draw and animate; returns the lines of the report.

    Raises:
        ValueError: If the file does not hold one grasp and one run, or a film cannot be written here.
    """
    if asked.film == "mp4" and shutil.which("ffmpeg") is None:
        raise ValueError("argument --film must be gif where there is no program ffmpeg, but was mp4")
    with timed("Reading"):
        grasp, run = _read(asked.file)
    names, missing = [], []
    with timed("Drawing"):
        for name, picture in _pictures(grasp, run).items():
            picture.savefig(folder / name, dpi=150)
            names.append(name)
    if asked.film is not None:
        ts = np.asarray(run.ts)
        end = float(np.max(ts[np.isfinite(ts)], initial=0.0)) if asked.until is None else asked.until
        speed = asked.speed or max(1.0, (end - float(ts[0])) / _LONGEST)
        names.append(f"motion.{asked.film}")
        with timed("Animating"):
            plotting.animate(grasp, run, folder / names[-1], fps=asked.fps, speed=speed, until=asked.until)
    try:
        with timed("Writing the page"):
            plotting.page(grasp, run, folder / "page.html")
        names.append("page.html")
    except ImportError as error:
        missing.append(f"  no page.html: {error}")
    return [f"{run}", f"Files in {folder}:", "  " + ", ".join(names), *missing]


def _pictures(grasp: Grasp, run: Trajectory) -> dict[str, Any]:
    """The figures of a run, by the names of their files."""
    forces = run.multipliers is not None
    pictures = {"poses.png": plotting.poses(grasp, run, forces=forces)}
    pictures["responses.png"] = plotting.responses(grasp, run)
    if grasp.spatial:
        pictures["loci.png"] = plotting.loci(grasp, run)
    return pictures


def _read(file: str) -> tuple[Grasp, Trajectory]:
    """The one grasp of a file and its one run."""
    try:
        held = load(file)
    except ValueError as error:
        raise ValueError(str(error).replace("argument path", "argument FILE", 1)) from None
    found = list(_parts(held))
    grasps = [each for each in found if isinstance(each, Grasp)]
    runs = [each for each in found if isinstance(each, Trajectory)]
    if len(grasps) != 1 or len(runs) != 1:
        raise ValueError(
            "argument FILE must hold one grasp and one run of it, as jaxroll.save(FILE, (grasp, run)) writes "
            f"them, but {Path(file).name} holds {len(grasps)} and {len(runs)}"
        )
    return grasps[0], runs[0]


def _parts(held: Any) -> Any:
    """What a file holds, taken out of its tuples, lists and dicts."""
    if isinstance(held, dict):
        held = list(held.values())
    if type(held) not in (list, tuple):
        yield held
        return
    for each in held:
        yield from _parts(each)
