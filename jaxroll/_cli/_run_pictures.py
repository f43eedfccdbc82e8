"""The figures of one run that `jaxroll pinch` and `jaxroll replay` write, and the pace of its animation."""

from typing import Any

import numpy as np

from .. import plotting
from .._integration import Trajectory
from .._mechanics import Grasp


def run_pictures(grasp: Grasp, run: Trajectory) -> dict[str, Any]:
    """The figures of a run, by the names of their files; a locus takes two states."""
    pictures = {
        "poses.png": plotting.poses(grasp, run, forces=run.multipliers is not None),
        "responses.png": plotting.responses(grasp, run),
    }
    if grasp.spatial and len(times_reached(run)) > 1:
        pictures["loci.png"] = plotting.loci(grasp, run)
    return pictures


def pace(run: Trajectory, least: float, longest: float) -> float:
    """Simulated seconds per second shown: `least`, or more where the film were longer than `longest` [s]."""
    ts = times_reached(run)
    return max(least, (float(ts[-1]) - float(ts[0])) / longest) if len(ts) else least


def times_reached(run: Trajectory) -> np.ndarray:
    """The saved times that a run reached [s]."""
    return np.asarray(run.ts)[np.asarray(run.reached)]
