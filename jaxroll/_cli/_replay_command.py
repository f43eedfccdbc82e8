"""What `jaxroll replay` does: a run that `jaxroll.save` wrote is told of, drawn and animated again."""

import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .. import plotting
from .._integration import REMEDIES, report, Trajectory
from .._mechanics import Grasp
from .._results import told_apart, up_to
from .._saving import load
from ._replay_order import ReplayOrder
from ._run_pictures import pace, run_pictures

# What helps a run that ended early must be done in Python, by whoever made it.
_REMEDIES = {name: f"in Python, where it was made: {text}" for name, text in REMEDIES.items()}
# A command cannot be given the caller's own classes and functions, which `load` asks for.
_OWN = (
    "which argument own must hold",
    "which is the caller's own: in Python `jaxroll.load(FILE, own=[...])` reads it, and `jaxroll.plotting` "
    "draws it",
)
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
    if asked.until is not None:
        run = _until(run, asked.until)
    names, missing = [], []
    with timed("Drawing"):
        for name, picture in run_pictures(grasp, run).items():
            picture.savefig(folder / name, dpi=150)
            names.append(name)
    if asked.film is not None:
        speed = asked.speed or pace(run, 1.0, _LONGEST)
        names.append(f"motion.{asked.film}")
        with timed("Animating"):
            plotting.animate(grasp, run, folder / names[-1], fps=asked.fps, speed=speed)
    try:
        with timed("Writing the page"):
            plotting.page(grasp, run, folder / "page.html")
        names.append("page.html")
    except ImportError as error:
        missing.append(f"  no page.html: {error}")
    shown = (
        [] if asked.until is None else [f"  shown     up to {float(np.asarray(run.ts)[-1]):g} s, by --until"]
    )
    return [report(run, _REMEDIES), *shown, f"Files in {folder}:", "  " + ", ".join(names), *missing]


def _until(run: Trajectory, until: float) -> Trajectory:
    """A run's states up to a time, as a run that ended with the last of them.

    Raises:
        ValueError: If fewer than two states were saved by then, or the run ended before.
    """
    ts = np.asarray(run.ts)
    reached = np.asarray(run.reached)
    first, last = float(ts[reached].min(initial=np.inf)), float(ts[reached].max(initial=-np.inf))
    count = int(np.sum(reached & up_to(ts, until)))
    if not up_to(until, last) or count < 2:
        begin, end, was = told_apart(first, last, until)
        raise ValueError(
            f"argument --until must be a time by which two states were saved, of a run from {begin} to "
            f"{end} s, but was {was}"
        )
    names = (
        "ts",
        "states",
        "residuals",
        *(n for n in ("multipliers", "energy") if getattr(run, n) is not None),
    )
    parts = lambda each: [getattr(each, name) for name in names]  # noqa: E731
    shown = eqx.tree_at(parts, run, jax.tree.map(lambda x: x[:count], parts(run)))
    return eqx.tree_at(lambda each: each.last, shown, jax.tree.map(lambda x: x[-1], shown.states))


def _read(file: str) -> tuple[Grasp, Trajectory]:
    """The one grasp of a file and its one run."""
    try:
        held = load(file)
    except ValueError as error:
        told = str(error).replace("argument path", "argument FILE", 1)
        raise ValueError(told.replace(*_OWN)) from None
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
