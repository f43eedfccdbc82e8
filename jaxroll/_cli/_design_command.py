"""What `jaxroll design` does: a fingertip that loses a grasp, a better one, and runs with both.

`fingertip` makes the start from a file or takes the built-in one. `designed` improves it by
`design.optimise_fingertip`, simulates the pinch with both, writes figures, animations and the new outline,
and returns the report.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from .. import io, plotting, scenes
from .._integration import cause, simulate
from .._printing import code_name
from .._results import RESULTS
from ..design import (
    AbstractGoal,
    ClosedLoop,
    Design,
    Fair,
    Firmness,
    friction_demand,
    Limits,
    Margin,
    optimise_fingertip,
    overshoot,
    peak_force,
    settling_time,
)
from ..geometry import fit_contour, Spline

# The built-in start: half axes [m] of an ellipse whose sharp end faces the object, sharper than a circle
# about O_i; and the number of points on any start.
_LONG, _WIDE, _POINTS = 0.018, 0.009, 24
_INTERVAL = (-0.006, 0.006)  # arclengths of the fingertip that are judged [m]
_FRICTION = 0.5
_SEEN = 1e-6  # a point that was moved farther than this is mentioned in the report [m]
# Animations: time shown [s], its speed; thickness of the solid fingertip [m].
_SHOWN, _SPEED, _THICK = 0.15, 0.05, 0.01
_OUT = ("fingertip.csv", "fingertip.svg", "fingertip.dxf")


@dataclass(frozen=True)
class DesignOrder:
    """What to design.

    Attributes:
        goal: Name of the goal: 'margin', 'stiffness' or 'run'.
        tip: The fingertip to begin with.
        steps: Most steps of the search, which rounds them up to tens.
        starts: Number of starts that are tried side by side.
        animated: Whether to write animations.
    """

    goal: str
    tip: Spline
    steps: int
    starts: int
    animated: bool


def make(tip: Any, s: Sequence[float] = (0.004, -0.003)) -> tuple[Any, Any]:
    """The pinch of a rectangle, with orientation left to the fingertips and limited friction."""
    return scenes.pinch(tips=tip, s=s, alpha=0.0, friction=_FRICTION)


def _at_rest(tip: Any) -> tuple[Any, Any]:
    """The same pinch, held in the middle of both faces: near its equilibrium, where firmness is judged."""
    return make(tip, (0.0, 0.0))


GOALS: dict[str, Callable[[], AbstractGoal]] = {
    "margin": Margin,
    "stiffness": lambda: Firmness(_at_rest),
    "run": lambda: ClosedLoop(make, {"tracking_error": 2.0, "friction_demand": 1.0}, t1=0.5, ts=51),
}


def fingertip(path: str | None, unit: str) -> Spline:
    """The fingertip to begin with, about $O_i$ and facing +x: built in, or through points of a file."""
    u = 2.0 * np.pi * np.arange(_POINTS) / _POINTS
    if path is None:
        return Spline(np.stack([_LONG * np.cos(u), _WIDE * np.sin(u)], axis=-1), cells=128)
    contour = fit_contour(io.read_points(path, unit=unit), unit="m").contour
    if not contour.closed:
        raise ValueError(f"argument --tip must be a closed outline, but {path} is open")
    # A spline of few points, as the search wants it, at equal arclengths from the foremost point, its s = 0.
    ends = contour.domain()
    assert ends is not None  # a closed contour has a length
    long, least = float(ends[1] - ends[0]), _INTERVAL[1] - _INTERVAL[0]
    if long < least:
        raise ValueError(
            f"argument --tip must be no shorter than the {1e3 * least:g} mm that are judged, but {path} is "
            f"{1e3 * long:.4g} mm round"
        )
    s = np.linspace(float(ends[0]), float(ends[1]), 1 + 40 * _POINTS)[:-1]
    start = s[np.argmax(np.asarray(contour.point(s))[:, 0])]
    return Spline(contour.point(start + (s[-1] + s[1] - 2 * s[0]) * u / (2.0 * np.pi)), cells=128)


def designed(
    asked: DesignOrder, folder: Path, timed: Callable[[str], AbstractContextManager]
) -> tuple[list[str], bool]:
    """Design, simulate, draw and write; returns the lines of the report, and whether the fingertip holds.

    Args:
        asked: What to design.
        folder: Where the files go.
        timed: Context that announces a piece of work and says how long it took.
    """
    tip = asked.tip
    size = float(np.max(np.hypot(*np.asarray(tip.points).T)))
    limits = Limits(size=size, radius=0.2 * size, ahead=size / 3.0)
    options: dict[str, Any] = {
        "steps": asked.steps,
        "starts": asked.starts,
        "goal": Fair(GOALS[asked.goal]()),
    }
    _check_reach(tip)
    with timed(f"Designing for {asked.goal}"):
        found = optimise_fingertip(tip, _INTERVAL, limits=limits, symmetric=True, **options)
    # Written before the runs, so that the outline is there even if these fail.
    written, missing = _write(found, folder)
    with timed("Simulating both"):
        pairs = [make(one) for one in (found.start, found.tip)]
        settings = {"t1": 1.0, "ts": 401, "throw": False, "record": ("multipliers",)}
        runs = [jax.block_until_ready(simulate(*pair, **settings)) for pair in pairs]
    names = ["design.png", "comparison.png"]
    with timed("Drawing"):
        plotting.design(found, folder)
        plotting.comparison(runs, folder=folder)
    if asked.animated:
        with timed("Animating"):
            for pair, run, name in zip(pairs, runs, ("before.gif", "after.gif"), strict=True):
                plotting.animate(pair[0], run, folder / name, fps=10.0, speed=_SPEED, until=_SHOWN, size=4.5)
                names.append(name)
    files = [f"Files in {folder}:", "  " + ", ".join(names + written), *missing]
    held = bool(runs[1].result == RESULTS.successful)
    told = "holds" if held else "does not hold"
    if not bool(found.holds[found.chosen]):
        short = "ended within its limits" if found.result == RESULTS.infeasible else "reached its goal"
        told += f"; the search has not {short}: more --steps or --starts may"
    lines = [
        found.report("--steps", millimetres=True),
        *_begun(found, asked),
        f"  outcome   the fingertip {told}",
        *_facts(runs),
        *files,
    ]
    return lines, held


def _check_reach(tip: Any) -> None:
    """Raise unless the fingers reach the rectangle with a fingertip, before a search that takes minutes."""
    try:
        make(tip)
    except ValueError as error:
        told = str(error).partition("but ")[2] or str(error)
        raise ValueError(f"argument tip must be one with which the fingers reach, but {told}") from None


def _begun(found: Design, asked: DesignOrder) -> list[str]:
    """A line that says which outline `before` is, unless it is the given one."""
    if found.chosen:
        return [
            f"  before    of start {found.chosen + 1} of {asked.starts}, a variation of the outline at random"
        ]
    start: Any = found.start
    moved = float(np.max(np.hypot(*np.asarray(start.points - asked.tip.points).T)))
    told = f"the outline made symmetric about x, which moved it by up to {1e3 * moved:.2g} mm"
    return [f"  before    of {told}"] if moved > _SEEN else []


def _facts(runs: Sequence[Any]) -> list[str]:
    """Lines that compare the run before with the run after."""
    rows = (
        ("held until [s]", lambda run: run.stats.t_end),
        ("settling time [s]", settling_time),
        ("overshoot", overshoot),
        ("peak force [N]", peak_force),
        ("friction demand", friction_demand),
    )
    lines = [f"Runs of 1 s with friction {_FRICTION:g}"]
    for name, measure in rows:
        before, after = (float(measure(run)) for run in runs)
        lines.append(f"  {name:<28}{before:>12.4g}{after:>12.4g}")
    return lines + [
        f"  {name:<8}{_outcome(run)}" for name, run in zip(("before", "after"), runs, strict=True)
    ]


def _outcome(run: Any) -> str:
    """How a run ended, in one line: which contact and when; not by how much, which at an event is zero."""
    return code_name(run.result) if run.result == RESULTS.successful else cause(run).split(": ")[0]


def _write(found: Design, folder: Path) -> tuple[list[str], list[str]]:
    """Write the fingertip as files; returns their names, and a line for each that needs a missing library."""
    names, missing = [], []
    jobs = [(name, lambda path: io.write_outline(found.tip, path, unit="mm")) for name in _OUT]
    jobs.append(("fingertip.stl", lambda path: io.write_stl(found.tip, path, height=_THICK)))
    for name, write in jobs:
        try:
            write(folder / name)
        except ImportError as error:
            missing.append(f"  no {name}: {error}")
        else:
            names.append(name)
    return names, missing
