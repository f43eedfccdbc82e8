"""An exact test: a roller between two plates, in jaxroll, MuJoCo, Drake and PyBullet (about three minutes).

A roller of 10 mm is squeezed by 5 N; the upper plate moves 0-30-0 mm in 3 s. Rolling without slip, the
roller's centre travels u/2 and its circumference turns by as much. `python -m benchmarks.roller --write`
rewrites its section of README.md and roller.png; `--quick` leaves out what is slow and takes under a minute.
"""

import dataclasses
import functools
import importlib
import importlib.util
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib import patheffects

import jaxroll as jxr
from benchmarks._common import command, device, interleaved, ms, size, table, versions
from benchmarks._roller_problem import (
    Case,
    CIRCLE,
    facets,
    PERIOD,
    POINTS,
    polygon,
    RADIUS,
    RATE,
    SAMPLES,
    TRAVEL,
)

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)

FIGURE = Path(__file__).with_name("roller.png")
PEERS = {"MuJoCo": "mujoco", "Drake": "pydrake", "PyBullet": "pybullet"}
# What is asked of jaxroll: largest error of the centre [m].
ASKED = {CIRCLE: 1e-9, POINTS: 1e-8}
# Errors below this are rounding: peers that are exact are told apart by their time.
ROUNDING = 1e-15
SETTLED = 0.1
COLOURS = {"jaxroll": "#d62728", "MuJoCo": "#1f77b4", "Drake": "#2ca02c", "PyBullet": "#9467bd"}


@dataclasses.dataclass(frozen=True)
class Score:
    """Steps, median seconds (by the clock, and of the processor) and largest errors [m] of one case.

    `centre` and `angle` are taken against half the plate's actual travel, `drive` is that travel's
    own error, and `ripple` the peak-to-peak height of the centre once 0.1 s have passed.
    """

    case: Case
    steps: int
    seconds: float
    cpu: float
    centre: float
    angle: float
    ripple: float
    drive: float
    outcome: str


def jaxroll_cases() -> list[Case]:
    shapes = {CIRCLE: ("circle", jxr.Circle(RADIUS)), POINTS: ("spline", jxr.Spline(polygon()))}
    return [
        _jaxroll_case(given, name, jxr.scenes.roller(contour), rtol, saved)
        for given, (name, contour) in shapes.items()
        for rtol, saved in ((1e-8, SAMPLES), (1e-3, SAMPLES), (1e-11, SAMPLES), (1e-8, 30))
    ]


def _jaxroll_case(
    given: str, shape: str, scene: tuple[jxr.Grasp, jxr.State], rtol: float, saved: int
) -> Case:
    times = jnp.linspace(0.0, PERIOD, saved + 1)
    tolerance: Any = jnp.asarray(rtol)  # one compiled program for all tolerances

    def run() -> jxr.Trajectory:
        found = jxr.simulate(*scene, PERIOD, ts=times, rtol=tolerance, throw=False)
        return jax.block_until_ready(found)

    default = " (default)" if rtol == 1e-8 else ""
    few = "" if saved == SAMPLES else f", {saved} samples"
    setting = f"rtol {rtol:.0e}{default}{few}"
    return Case("jaxroll", given, shape, setting, run, _path, _steps, _outcome)


def _path(run: jxr.Trajectory) -> np.ndarray:
    x, y, turn, u, _ = np.asarray(run.states.q).T
    return np.stack([x, y - y[0], -RADIUS * turn, u], axis=-1)


def _steps(run: jxr.Trajectory) -> int:
    return int(run.stats.steps)


def _outcome(run: jxr.Trajectory) -> str:
    return "successful" if bool(run.result == jxr.RESULTS.successful) else str(jxr.RESULTS[run.result])


def peer_cases() -> tuple[list[Case], list[str]]:
    """Cases of the engines that are installed, and the names of the others."""
    found, missing = [], []
    for name, package in PEERS.items():
        if importlib.util.find_spec(package) is None:
            missing.append(name)
        else:
            found += importlib.import_module(f"benchmarks.contenders.roller_{name.lower()}").cases()
    return found, missing


def measure(quick: bool) -> tuple[list[Score], list[str]]:
    peers, missing = peer_cases()
    cases = [case for case in (*jaxroll_cases(), *peers) if not (quick and case.slow)]
    results = [case.call() for case in cases]  # the first call compiles
    spent: list[list[float]] = [[] for _ in cases]
    calls = [functools.partial(_clocked, *pair) for pair in zip(cases, spent, strict=True)]
    seconds = interleaved(calls, rounds=2 if quick else 9)
    cpu = map(statistics.median, spent)
    return [score(*each) for each in zip(cases, results, seconds, cpu, strict=True)], missing


def _clocked(case: Case, spent: list[float]) -> None:
    """Note the processor's time, which other work on the machine does not stretch."""
    start = time.process_time()
    case.call()
    spent.append(time.process_time() - start)


def score(case: Case, result: Any, seconds: float, cpu: float) -> Score:
    path = case.read(result)
    x, y, turned, u = path.T
    t = np.linspace(0.0, PERIOD, len(path))
    asked = 0.5 * TRAVEL * (1.0 - np.cos(RATE * t))
    centre, angle, drive = (float(np.abs(e).max()) for e in (x - 0.5 * u, turned - 0.5 * u, u - asked))
    ripple = float(np.ptp(y[t >= SETTLED]))
    return Score(case, case.count(result), seconds, cpu, centre, angle, ripple, drive, case.outcome(result))


def ours(scores: Sequence[Score], given: str) -> Score:
    """Defaults of jaxroll; every time in the table is a multiple of this one's."""
    return next(s for s in scores if s.case.engine == "jaxroll" and s.case.given == given)


def rivals(scores: Sequence[Score], given: str) -> list[Score]:
    return [s for s in scores if s.case.engine != "jaxroll" and s.case.given == given]


def most_accurate(scores: Sequence[Score]) -> Score | None:
    """The quickest of those whose centre has the smallest error, or no error but rounding."""
    least = max(ROUNDING, min((s.centre for s in scores), default=0.0))
    return min((s for s in scores if s.centre <= least), key=lambda s: s.seconds, default=None)


def quickest(scores: Sequence[Score], given: str) -> Score | None:
    """The quickest that meets what is asked of jaxroll."""
    return min((s for s in scores if s.centre <= ASKED[given]), key=lambda s: s.seconds, default=None)


def conclusion(scores: Sequence[Score], given: str) -> str:
    one, peers = ours(scores, given), rivals(scores, given)
    error = one.centre + 0.5 * one.drive
    said = (
        f"**{given.capitalize()}.** jaxroll at its defaults takes {ms(one.seconds)} ms ({one.outcome}) and "
        f"keeps the centre to {error:.1e} m of half the prescribed travel ({one.centre:.1e} m of half the "
        f"actual one; asked: {ASKED[given]:.0e}), the angle to {one.angle:.1e} m."
    )
    best, fast = most_accurate(peers), quickest(peers, given)
    if best is None:
        return f"{said} No peer is installed."
    met = error <= ASKED[given] and one.outcome == "successful" and one.seconds < best.seconds
    said += f" The most accurate peer is {_told(best, one)}: the row is {'met' if met else '**not met**'}."
    if fast is None:
        return f"{said} No peer keeps its centre to {ASKED[given]:.0e} m."
    if fast is best:
        return said
    return f"{said} The quickest peer within {ASKED[given]:.0e} m is {_told(fast, one)}."


def _told(score: Score, one: Score) -> str:
    case = score.case
    return (
        f"{case.engine} ({case.shape}; {case.setting}) with {score.centre:.1e} m in {ms(score.seconds)} ms, "
        f"{score.seconds / one.seconds:.1f} times jaxroll's time ({score.cpu / one.cpu:.1f} times the "
        f"processor's; angle: {score.angle:.1e} m)"
    )


def angles(scores: Sequence[Score]) -> str:
    """What the centre cannot tell: by symmetry it is right for a polygon, and when both sides slip alike."""
    least = min(rivals(scores, POINTS), key=lambda s: max(s.centre, s.angle), default=None)
    if least is None:
        return ""
    return (
        "**Angle.** By symmetry the centre is right even where both plates slip alike, and for a polygon; "
        f"the angle tells. An exactly rolling 128-gon turns {facets():.2e} m less than the circle; "
        f"the best peer given 128 points ({least.case.engine}; {least.case.setting}) is "
        f"{least.angle:.2e} m off, jaxroll {ours(scores, POINTS).angle:.1e} m."
    )


def full_table(scores: Sequence[Score]) -> str:
    header = [
        "engine",
        "given",
        "shape",
        "setting",
        "steps",
        "wall [ms]",
        "CPU [ms]",
        "centre [m]",
        "angle [m]",
    ]
    header += ["ripple [m]", "drive [m]", "wall over jaxroll's"]
    lines = []
    for s in sorted(scores, key=lambda s: s.case.given != CIRCLE):
        case, ratio = s.case, s.seconds / ours(scores, s.case.given).seconds
        result = f": {s.outcome}" if s.outcome else ""
        lines.append([case.engine, case.given, case.shape, case.setting + result, str(s.steps)])
        lines[-1] += [
            ms(s.seconds),
            ms(s.cpu),
            *map(size, (s.centre, s.angle, s.ripple, s.drive)),
            f"{ratio:.2f}",
        ]
    return table(header, lines)


def footer() -> list[str]:
    packages = {"MuJoCo": "mujoco", "Drake": "drake", "PyBullet": "pybullet"}
    there = [packages[name] for name, module in PEERS.items() if importlib.util.find_spec(module)]
    return [device(), versions("jax", "jaxlib", "diffrax", *there)]


def report(quick: bool = False, *, drawn: bool = False) -> str:
    scores, missing = measure(quick)
    if drawn:
        draw(scores, FIGURE)
    said = [conclusion(scores, given) for given in ASKED]
    lines = [f"**Conclusion.** {said[0]}", *said[1:], angles(scores)]
    lines.append(f"![Time of a warm run against its error]({FIGURE.name})")
    lines += [full_table(scores), *(f"{name}: not installed." for name in missing), "  \n".join(footer())]
    return "\n\n".join(line for line in lines if line)


def draw(scores: Sequence[Score], path: Path) -> None:
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, panels = plt.subplots(1, 2, figsize=(12.0, 5.4), sharey=True)
        for axes, given in zip(panels, ASKED, strict=True):
            _draw_panel(axes, [s for s in scores if s.case.given == given], given)
        panels[0].set_ylabel("time of one warm run [ms]")
        figure.suptitle(
            "A roller squeezed between two plates: filled, its centre; hollow, its angle (as a length)",
            fontsize=11.5,
            x=0.06,
            ha="left",
        )
        figure.subplots_adjust(left=0.06, right=0.985, top=0.87, bottom=0.17, wspace=0.05)
        figure.text(0.06, 0.02, "\n".join(footer()), fontsize=7, color="0.35", va="bottom")
        figure.savefig(path, dpi=160)
        plt.close(figure)


def _draw_panel(axes: Any, scores: Sequence[Score], given: str) -> None:
    axes.set(xscale="log", yscale="log", xlim=(3e-2, 1e-19), xlabel="largest error [m]")
    axes.axvline(ASKED[given], color="0.4", lw=0.9, ls=":", zorder=0)
    note = {"xycoords": ("data", "axes fraction"), "xytext": (3, 3), "textcoords": "offset points"}
    axes.annotate("asked", (ASKED[given], 0.0), color="0.4", fontsize=7.5, **note)
    placed: list[tuple[float, float]] = []
    mine = ours(scores, given)
    for s in sorted((s for s in scores if s is mine or s.case.engine != "jaxroll"), key=lambda s: s.seconds):
        _draw_score(axes, s, placed)
    axes.set_title("given as a circle" if given == CIRCLE else f"given by {given}", fontsize=9.5)
    axes.grid(True, color="0.9", lw=0.6)
    axes.set_axisbelow(True)


def _draw_score(axes: Any, s: Score, placed: list[tuple[float, float]]) -> None:
    """A marker for the centre and one for the angle; the label steps up where it would cover another."""
    colour, taken = COLOURS[s.case.engine], 1e3 * s.seconds
    marker, width, layer = ("*", 14, 4) if s.case.engine == "jaxroll" else ("o", 5.5, 3)
    look = {"marker": marker, "ms": width, "color": colour, "zorder": layer}
    centre, angle = (max(e, 1e-18) for e in (s.centre, s.angle))
    axes.plot([centre, angle], [taken, taken], color=colour, lw=0.7, alpha=0.45)
    axes.plot(angle, taken, mfc="w", **look)
    axes.plot(centre, taken, **look)
    spot = (np.log10(centre), np.log10(taken))
    while any(abs(spot[0] - x) < 6.5 and abs(spot[1] - y) < 0.068 for x, y in placed):
        spot = (spot[0], spot[1] + 0.01)
    style: dict[str, Any] = {"ha": "left", "va": "center", "xytext": (6, 0), "fontsize": 7.0}
    if s.case.engine == "jaxroll":
        style = {"ha": "right", "va": "bottom", "xytext": (6, 6), "fontsize": 9.0}
    elif centre < ROUNDING:  # no room on the right
        style |= {"ha": "right", "va": "top", "xytext": (6, -4)}
        spot = (spot[0], np.log10(taken))
    placed.append(spot)
    outline = [patheffects.withStroke(linewidth=2.0, foreground="w")]
    style |= {"textcoords": "offset points", "path_effects": outline, "zorder": 2, "color": colour}
    axes.annotate(_brief(s.case), (centre, 10.0 ** spot[1]), **style)


def _brief(case: Case) -> str:
    if case.engine == "jaxroll":
        return "jaxroll"
    shape = f" {case.shape}" if case.given == CIRCLE else ""
    if case.setting.startswith("default"):
        return f"{case.engine}{shape}, default"
    return f"{case.engine}{shape}, {case.setting.rsplit(', ', 1)[-1]}"


if __name__ == "__main__":
    command("roller", report, drawn="")
