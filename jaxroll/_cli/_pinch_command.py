"""What `jaxroll pinch` does: an object from a file is held between two fingers, pushed, and watched.

`smooth_shape` makes the object's shape, `uniform` its mass, `scenes.pinch_object` finds where to hold it and
how the fingers get there. A grasp in which nothing moves shows nothing: a tenth of a second after the start
the object is pushed aside for a moment, so that it must come to rest again if the grasp is firm.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .. import io, loads, plotting, scenes, stability
from .._integration import cause, report, simulate
from .._mechanics import FreeObject, FreeObject3, Grasp, State
from .._printing import code_name
from .._reaching import tip_origins
from .._results import RESULTS
from .._saving import save
from ..geometry import Fit, Sphere, SurfaceFit
from ._run_pictures import pace, run_pictures
from ._shape_file import read, ShapeOrder, size_told, smooth_shape, warn

# The push: when it begins and how long it lasts [s], its size beside that of the fingers.
_BEGINS, _LASTS, _SHARE = 0.1, 0.1, 0.25
# Radius of the tips of a hand from a file, where the file has none that can be used [m].
_TIP = 0.01
# The largest angle of a joint either way, if its file has none or a larger one [rad].
_TURNS = 4.0 * np.pi
# Below this speed [m/s] and this rate [rad/s] an object is said to be at rest.
_STILL = (1e-4, 1e-2)
# By the name of the verdict, why a run that held does not say that the grasp is stable.
_DOUBTS = {
    "unstable": ", but some small disturbance grows",
    "undamped": ", but some small disturbance never dies out",
    "not_found": ", but no equilibrium was found near the start",
}
# What helps a run that ended early, in the words of the command line.
_REMEDIES = {
    "max_steps_reached": "fewer --seconds",
    "step_collapsed": "fewer --seconds, or another --smallest-radius",
    "not_finite": "fewer --seconds",
    "singular_contact": "a larger --smallest-radius, which makes hollows flatter",
    "contact_lost": "a larger --force",
    "slipping": "a larger --friction",
    "penetration": "fewer --seconds, or a larger --smallest-radius",
    "joint_limit": "fewer --seconds, or a --hand with wider ranges",
    "links_meet": "fewer --seconds, or another --hand",
    "torque_limit": "a smaller --force, or another --hand",
    "unresolved": "a larger --smallest-radius",
}
# The animation: pictures a second, few since in space each takes long to draw, and simulated seconds per
# second shown.
_FPS, _SPEED = 12.0, 0.5
# The longest film [s], and the most states that are saved.
_LONGEST, _MOST = 60.0, 20_001


@dataclass(frozen=True)
class PinchOrder:
    """What to hold, with what, and how.

    Attributes:
        shape: Which shape to make of which file.
        hand: Name of a hand's file, or None for the chapter's fingers.
        density: Of the object [kg/m^3].
        thickness: Of an object of the plane [m].
        friction: Coefficient of friction.
        force: With which the fingers press [N]; None: three times the object's weight.
        seconds: How long to simulate [s].
        animated: Whether to write an animation.
    """

    shape: ShapeOrder
    hand: str | None
    density: float
    thickness: float
    friction: float
    force: float | None
    seconds: float
    animated: bool


def pinched(
    asked: PinchOrder, folder: Path, timed: Callable[[str], AbstractContextManager]
) -> tuple[list[str], bool]:
    """Fit, find where to hold, close, run, draw and write; returns the report's lines, and whether it held.

    Args:
        asked: What to hold, with what, and how.
        folder: Where the files go.
        timed: Context that announces a piece of work and says how long it took.
    """
    with timed("Reading"):
        outline = read(asked.shape)
    size = size_told(asked.shape, outline)
    warn(size)
    with timed("Fitting"):
        found = smooth_shape(asked.shape, outline)
    flat = isinstance(found, Fit)
    with timed("Weighing"):
        body = _body(found, asked)
    with timed("Finding where to hold it"):
        hand = None if asked.hand is None else _hand(asked.hand, flat)
        fingers = None if hand is None else _fingers(hand[0])
        grasp, state = scenes.pinch_object(body, fingers=fingers, friction=asked.friction, force=asked.force)
    verdict = None
    if flat:
        with timed("Judging the grasp"):
            verdict = stability.assess(grasp, state).verdict
    with timed(f"Simulating {asked.seconds:g} s"):
        pushed, push = _pushed(grasp, state)
        record = ("multipliers", "energy")
        run = simulate(pushed, state, asked.seconds, ts=_count(asked.seconds), record=record, throw=False)
        jax.block_until_ready(run)
    names = _written(asked, folder, timed, found=found, grasp=pushed, run=run)
    save(folder / "pinch.npz", {"grasp": pushed, "state": state, "run": run})
    held = bool(run.result == RESULTS.successful)
    lines = [
        *size,
        f"{found.report}",
        *_described(grasp, run, push),
        *([] if hand is None else _hand_told(*hand)),
        _verdict(verdict),
        report(run, _REMEDIES),
        f"  outcome     {outcome(run, verdict)}",
        *_checks(run),
        f"Files in {folder}:",
        "  " + ", ".join([*names, "pinch.npz"]),
    ]
    return lines, held


def _count(seconds: float) -> int:
    """How many states are saved, the start and the end among them."""
    return min(max(2, 1 + round(100 * seconds)), _MOST)


def _body(found: Fit | SurfaceFit, asked: PinchOrder) -> FreeObject | FreeObject3:
    """The object of constant density within what was fitted."""
    if not isinstance(found, Fit):
        return FreeObject3.uniform(found.surface, asked.density)
    if not found.report.closed:
        raise ValueError("argument FILE must hold a closed outline, but it is open")
    return FreeObject.uniform(found.contour, asked.density, thickness=asked.thickness)


def _hand(path: str, flat: bool) -> tuple[io.Hand, bool]:
    """The hand of a file, and whether its tips are its own: else they are balls."""
    if flat:
        raise ValueError("argument --hand must be left out for an object of the plane")
    try:
        return io.load_hand(path, "mesh"), True
    except ValueError:
        return io.load_hand(path, Sphere(_TIP)), False


def _fingers(hand: io.Hand) -> list[Any]:
    """The fingers of a hand with their ranges."""
    return [_limited(*each) for each in zip(hand.fingers, hand.limits, strict=True)]


def _hand_told(hand: io.Hand, own: bool) -> list[str]:
    """A line on what is in the file of a hand and not in the fingers that are used, if there is anything."""
    parts = {
        "largest torques": any(np.isfinite(x).any() for x in hand.torques),
        "damping": any(np.any(x) for x in hand.damping),
        "dry friction": any(np.any(x) for x in hand.friction),
        "springs": any(np.any(x) for x in hand.stiffness),
    }
    left = [*(name for name, given in parts.items() if given), *hand.left_out]
    told = [] if own else [f"its tips are balls of {1e3 * _TIP:g} mm, for its file has none that can be used"]
    told += [f"its file's {', '.join(left)} not counted"] if left else []
    return [f"  hand        {'; '.join(told)}"] if told else []


def _limited(finger: Any, limits: Any) -> Any:
    """A finger that keeps to the ranges of its joints, which are two turns either way at most."""
    ranges = jnp.clip(limits, -_TURNS, _TURNS)
    return eqx.tree_at(lambda f: f.limits, finger, ranges, is_leaf=lambda x: x is None)


def _verdict(verdict: Any) -> str:
    """What linearisation at the equilibrium says; it is done in the plane alone."""
    told = "not assessed in space" if verdict is None else stability.VERDICTS[verdict]
    return f"  verdict     {told}"


def outcome(run: Any, verdict: Any) -> str:
    """How a run ended, whether the object was at rest by then, and what the verdict adds to that.

    Args:
        run: One run, whole or ended early.
        verdict: One of `stability.VERDICTS`; None where stability was not assessed.
    """
    if run.result != RESULTS.successful:
        return cause(run)
    last = np.asarray(run.states.v)[-1]
    # Of an object in the plane two velocities and a rate, in space three and a spin.
    moves, turns = (
        (last[:2], last[2:3]) if run.states.q.shape[-1] == run.states.v.shape[-1] else (last[:3], last[3:6])
    )
    speed, rate = float(np.linalg.norm(moves)), float(np.linalg.norm(turns))
    still = speed < _STILL[0] and rate < _STILL[1]
    state = "at rest at the end" if still else "still moving at the end"
    told = f"held for {float(run.stats.t_end):g} s, {state} ({1e3 * speed:.2g} mm/s, {rate:.2g} rad/s)"
    doubt = "" if verdict is None else _DOUBTS.get(code_name(verdict), "")
    longer = "" if still and not doubt else "; a larger --seconds shows what becomes of it"
    return f"{told}{doubt}{longer}"


def _pushed(grasp: Grasp, state: State) -> tuple[Grasp, float]:
    """The grasp with a push across the line between both tip frames, and how large that is [N]."""
    first, second = tip_origins(grasp, np.asarray(state.q))
    line = second - first
    # Along that line the control pulls with its gain times the length.
    push = _SHARE * float(grasp.controller.beta) * float(np.linalg.norm(line))
    force = push * jnp.asarray(_aside(line))
    load = loads.Push(force, _BEGINS, _LASTS)
    given = {"controller": grasp.controller, "gravity": grasp.gravity, "load": load}
    return Grasp(grasp.object, grasp.fingers, grasp.contacts, **given), push


def _aside(line: np.ndarray) -> np.ndarray:
    """A direction across a line."""
    line = line / np.linalg.norm(line)
    # Of the axes, less their parts along the line, the two longest in space and the longest in the plane.
    across = np.eye(len(line)) - np.outer(line, line)
    longest = np.argsort(np.linalg.norm(across, axis=1))[1:]
    direction = across[longest].sum(axis=0)
    return direction / np.linalg.norm(direction)


def _described(grasp: Grasp, run: Any, push: float) -> list[str]:
    """Lines about the object and how it is held."""
    press = float(np.min(np.asarray(run.multipliers.f)[0]))
    body, control = grasp.object, grasp.controller
    left = run.residuals
    gap = max(float(np.abs(np.asarray(part)[0]).max()) for part in (left.normal, left.tangential))
    pushed = f"pushed aside with {push:.3g} N for {_LASTS:g} s"
    if float(run.stats.t_end) <= _BEGINS:
        pushed = f"not pushed by then: that begins at {_BEGINS:g} s"
    return [
        f"  object      {1e3 * float(body.mass):.4g} g; no gravity acts on it or on the fingers",
        f"  control     beta = {float(control.beta):.4g} N/m, c = {float(control.damping[0]):.3g} N m s; "
        f"pressed with {press:.3g} N, {pushed}",
        f"  closed      gaps of {gap:.1e} m",
    ]


def _checks(run: Any) -> list[str]:
    """A line on the errors of the run."""
    peak = lambda array: float(np.nanmax(np.abs(np.asarray(array))))  # noqa: E731
    left = run.residuals
    return [
        f"  errors      gap {max(peak(left.normal), peak(left.tangential)):.1e} m, energy "
        f"{peak(run.energy.residual):.1e} J"
    ]


def _written(
    asked: PinchOrder, folder: Path, timed: Callable[[str], AbstractContextManager], **made: Any
) -> list[str]:
    """Draw the fit, the poses, the responses and the motion; returns the names of the files."""
    grasp, run = made["grasp"], made["run"]
    with timed("Drawing"):
        pictures = {"fit.png": plotting.fit(made["found"])} | run_pictures(grasp, run)
        for name, picture in pictures.items():
            picture.savefig(folder / name, dpi=150)
    names = list(pictures)
    if asked.animated:
        with timed("Animating"):
            speed = pace(run, _SPEED, _LONGEST)
            plotting.animate(grasp, run, folder / "motion.gif", fps=_FPS, speed=speed)
        names.append("motion.gif")
    return names
