"""Contact forces and loads as arrows, and the key that gives their scale."""

from dataclasses import dataclass

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch

from .._integration import Trajectory
from .._mechanics import Grasp
from .._motion import Multipliers, wrenches
from ..loads import Impulse
from ._outlines import rolling_contacts
from ._style import FORCE_COLOUR, GUIDE, MM
from ._views import Views

# Length of the longest arrow, as a share of the picture's diagonal.
_LONGEST = 0.07
_ROUND = np.array([1.0, 2.0, 5.0])


@dataclass(frozen=True)
class Arrows:
    """Contact forces and the load on the object, drawn to one scale.

    Attributes:
        points: Shape (t, c, 2), where they act [mm]: at the contacts, and for a grasp with loads one more.
        vectors: Shape (t, c, 2), arrows [mm].
        loaded: Whether the last of c is the force of the loads.
        scale: Millimetres for one newton; zero if there is no force.
        peak: The largest force [N].
    """

    points: np.ndarray
    vectors: np.ndarray
    loaded: bool
    scale: float
    peak: float


def arrows(
    grasp: Grasp, trajectory: Trajectory, picks: np.ndarray, seen: Views, *, corners: np.ndarray
) -> Arrows:
    """Recorded forces at the saved states `picks`, scaled to a picture with these corners [mm].

    All loads together are one force. It is drawn on the line on which it alone has their torque too, at the
    point nearest to the object's origin.

    Raises:
        ValueError: If the run has no recorded multipliers.
    """
    found = recorded_forces(trajectory)
    contacts = rolling_contacts(grasp)
    senses, drawn = np.array([contact.sense for contact in contacts.values()]), list(contacts)
    f, lam = (np.asarray(part)[picks][:, drawn, None] for part in (found.f, found.lam))
    # lambda acts on the object along the chapter's b_0, which runs along its contour where `sense` is 1; f
    # presses it against its outward normal, the tangent turned right.
    lam = lam * senses[:, None]
    along = seen.tangents
    outward = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    points, on_object = seen.points, lam * along - f * outward
    if loaded := acts(grasp):
        states = jax.tree.map(lambda a: np.asarray(a)[picks], trajectory.states)
        force, torque = map(np.asarray, wrenches(grasp, trajectory.ts[picks], states))
        # r = F T / |F|^2 turned right: r x F = T.
        square = np.maximum((force**2).sum(axis=-1), 1e-300)
        arm = np.stack([force[:, 1], -force[:, 0]], axis=-1) * (torque / square)[:, None]
        points = np.concatenate([points, (seen.frames[0][:, :2] + MM * arm)[:, None]], axis=1)
        on_object = np.concatenate([on_object, force[:, None]], axis=1)
    peak = float(np.linalg.norm(on_object, axis=-1).max(initial=0.0))
    longest = _LONGEST * float(np.linalg.norm(corners[1] - corners[0]))
    scale = longest / peak if peak > 0.0 else 0.0
    return Arrows(points, scale * on_object, loaded, scale, peak)


def recorded_forces(trajectory: Trajectory) -> Multipliers:
    """The contact forces of a run; raise if it has none."""
    if trajectory.multipliers is None:
        raise ValueError(
            "argument trajectory must hold contact forces if they are to be drawn: "
            "simulate with record=('multipliers',)"
        )
    return trajectory.multipliers


def acts(grasp: Grasp) -> bool:
    """Whether a load has a force to draw; blows act at no time."""
    return any(not isinstance(load, Impulse) for load in grasp.load)


def arrow(
    ax: Axes, start: tuple[float, float], end: tuple[float, float], colour: str = FORCE_COLOUR
) -> FancyArrowPatch:
    """One arrow on an axes."""
    shape = {"arrowstyle": "-|>", "mutation_scale": 11, "shrinkA": 0, "shrinkB": 0}
    patch = FancyArrowPatch(start, end, color=colour, lw=1.8, zorder=8.7, **shape)
    ax.add_patch(patch)
    return patch


def key(ax: Axes, forces: Arrows) -> FancyArrowPatch | None:
    """An arrow of a round force in the upper left corner, with its value beside it."""
    if forces.scale == 0.0:
        return None
    size = 10.0 ** np.floor(np.log10(forces.peak))
    # The largest of 1, 2 and 5 times a power of ten that is not above the peak.
    newtons = float(size * _ROUND[_ROUND * size <= forces.peak][-1])
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    x, y = left + 0.03 * (right - left), high - 0.025 * (high - low)
    patch = arrow(ax, (x, y), (x + forces.scale * newtons, y))
    beside = {"xytext": (5, 0), "textcoords": "offset points", "va": "center"}
    ax.annotate(
        f"{newtons:g} N", (x + forces.scale * newtons, y), fontsize=8, color=GUIDE, zorder=9, **beside
    )
    return patch
