"""What there is to plot over time of a grasp in space."""

from dataclasses import replace

import numpy as np

from .._integration import Trajectory
from .._mechanics import Grasp
from ._motion3 import rotation_vectors
from ._panels import (
    all_in_powers,
    balance_panel,
    first_of,
    forces_of,
    numbered,
    Panel,
    residual_panel,
    sentence,
)
from ._style import MM

_AXES = ("$x$", "$y$", "$z$")
_ABOUT = ("about $x$", "about $y$", "about $z$")


def panels3(grasp: Grasp, run: Trajectory) -> list[Panel]:
    """All panels of a run in space, in the order in which the figure shows them."""
    contacts = numbered("contact", len(grasp.contacts))
    found = [*_moved(grasp, run), *_forces(grasp, run, contacts), *_rates(grasp, run)]
    found += _left(grasp, run, contacts)
    return [replace(p, title=sentence(p.title)) for p in all_in_powers(grasp, run, found)]


def _moved(grasp: Grasp, run: Trajectory) -> list[Panel]:
    """Object and joints since the first state."""
    q = np.asarray(run.states.q)
    reached = np.isfinite(q).all(axis=1)
    # Only rows that were reached: signs are followed from one quaternion to the next.
    start, turns = q[np.flatnonzero(reached)[0]], np.full((len(q), 3), np.nan)
    turns[reached] = rotation_vectors(q[reached, 3:7])
    place = Panel("position of the object", "moved [mm]", MM * (q[:, :3] - start[:3]), _AXES)
    return [
        place,
        Panel("orientation of the object", r"$\theta\,a$ [rad]", turns, _ABOUT),
        *_joints(
            grasp,
            q - start,
            grasp.form.positions,
            ("joint angles", f"$q - q({first_of(run)})$ [rad]", "$q_{{{0}{1}}}$"),
        ),
    ]


def _rates(grasp: Grasp, run: Trajectory) -> list[Panel]:
    v = np.asarray(run.states.v)
    words = ("joint rates", r"$\dot{q}$ [rad/s]", "joint {1}")
    return [
        Panel("velocity of the object", "velocity [mm/s]", MM * v[:, :3], _AXES),
        Panel("spin of the object, own axes", r"$\omega$ [rad/s]", v[:, 3:6], _ABOUT),
        *_joints(grasp, v, grasp.sizes, words),
    ]


def _joints(
    grasp: Grasp, values: np.ndarray, counts: tuple[int, ...], words: tuple[str, str, str]
) -> list[Panel]:
    """A panel for each finger with joints; `counts` are the object's and the fingers' columns."""
    (what, label, name), found, at = words, [], counts[0]
    for i, (finger, count) in enumerate(zip(grasp.fingers, counts[1:], strict=True), 1):
        mine, at = values[:, at : at + finger.joints], at + count
        names = tuple(name.format(i, j + 1) for j in range(finger.joints))
        if names:
            title = what if len(grasp.fingers) == 1 else f"{what} of finger {i}"
            found.append(Panel(title, label, mine, names))
    return found


def _forces(grasp: Grasp, run: Trajectory, contacts: tuple[str, ...]) -> list[Panel]:
    normal, tangential = forces_of(grasp, run)
    along = np.linalg.norm(tangential, axis=-1)
    ratio = np.divide(along, np.abs(normal), out=np.full_like(along, np.nan), where=normal != 0.0)
    return [
        Panel("normal force", "$f$ [N]", normal, contacts),
        Panel("tangential force", r"$|\lambda|$ [N]", along, contacts),
        Panel("friction that rolling needs", r"$|\lambda| / |f|$", ratio, contacts),
    ]


def _left(grasp: Grasp, run: Trajectory, contacts: tuple[str, ...]) -> list[Panel]:
    """What constraints and energy balance leave over."""
    left, size = run.residuals, float(grasp.fingers[0].size)
    aside, tilted = (np.linalg.norm(np.asarray(x), axis=-1) for x in (left.tangential, left.tangency))
    return [
        residual_panel("normal gap", "$Q$ [m]", left.normal, size=size, names=contacts),
        residual_panel("tangential gap", "$|R|$ [m]", aside, size=size, names=contacts),
        residual_panel("tangency", "sine [rad]", tilted, size=1.0, names=contacts),
        *(() if run.energy is None else (balance_panel(run.energy),)),
    ]
