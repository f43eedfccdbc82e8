"""The path of a pinch over the level lines of its potential U(s1, s2); `_phase_one` draws that of Part 2."""

import numpy as np
from jaxtyping import Array
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._analysis import check_pinch
from .._integration import Trajectory
from .._mechanics import check_planar, compiled, Grasp, State
from .._types import Given
from ..control import law_of
from ..stability import equilibrium, pinch_statics
from ._doors import guarded
from ._phase_one import check_potential, has_one_direction, phase_of_one
from ._phase_parts import draw_path, energy_bar, energy_levels, least_of, on_contour
from ._style import MM, Picture, tidy
from ._views import single, visible

_GRID = 81
_LEVELS = 16
# Free space round the path, as a share of it, and the smallest half width of a gripper's picture [m].
_MARGIN, _LEAST = 0.2, 5e-4


@guarded
def phase(grasp: Grasp, trajectory: Trajectory, *, rest: State | None = None) -> Figure:
    r"""Draw the path of $(s_1, s_2)$ over levels of $U(s_1, s_2)$, (27); of Part 2 that of $(s, \dot s)$.

    A pinch rolls downhill; with $\alpha_i = 0$ it ends at a minimum of U, where $O_1, P_1, P_2, O_2$ are
    collinear, otherwise near it. One finger on a pivoted object has one direction of motion: its contact
    coordinate and the rate of that are drawn over level lines of the sum of kinetic and potential energy,
    which the motion crosses downwards. White is beyond the end of a contour.

    Args:
        grasp: A pinch of two fingers under `control.Opposition`; or a grasp with one contact and one
            direction of motion under `control.Press`. Both laws may be inside another one.
        trajectory: One run of it.
        rest: The equilibrium to mark, such as `stability.assess(...).equilibrium.state`. Default: the
            one that `stability.equilibrium` finds from the end of the run at its time, if it finds one.

    Returns:
        The figure: $s_i$ in millimetres, energies in millijoules; start, end and equilibrium are marked.

    Raises:
        ValueError: If the grasp is no such pinch, or lives in space, the law has no potential since its
            numbers are functions of time, or the trajectory is a batch.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> grasp, state = jxr.scenes.pinch()
        >>> run = jxr.simulate(grasp, state, t1=1.0)
        >>> plotting.phase(grasp, run, rest=state).axes[0].get_xlabel()
        '$s_1$ [mm]'
    """
    check_planar(grasp)
    alone = has_one_direction(grasp)
    (check_potential if alone else check_pinch)(grasp)
    trajectory = visible(grasp, trajectory)
    if rest is None:
        found = equilibrium(grasp, trajectory.last, t=trajectory.stats.t_end)
        rest = found.state if bool(found.found) else None
    if alone:
        return phase_of_one(grasp, trajectory, rest)
    # What is added to the law, or samples it, has no part in U.
    grasp = grasp.with_(controller=law_of(grasp.controller))
    ts, reached = single(trajectory)
    path = _chapter_s(grasp, trajectory.states)[reached]
    goal = np.zeros((0, 2)) if rest is None else _chapter_s(grasp, rest)
    every = np.concatenate([path, goal])
    middle = 0.5 * (every.min(axis=0) + every.max(axis=0))
    half = max((0.5 + _MARGIN) * float(np.ptp(every, axis=0).max()), least_of(grasp, _LEAST))
    figure = Picture(6.4, 5.4)
    ax = figure.subplots()
    _levels(ax, grasp, middle, half)
    draw_path(ax, path, goal, ts[reached])
    tidy(ax, xlabel="$s_1$ [mm]", ylabel="$s_2$ [mm]", title="Contacts on the object, over the potential $U$")
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def _chapter_s(grasp: Grasp, states: State) -> np.ndarray:
    """The chapter's $s_i$ [m] of one state or several, shape (t, 2)."""
    starts = np.array([float(contact.s_object) for contact in grasp.contacts])
    senses = np.array([contact.sense for contact in grasp.contacts])
    # The place on the object's contour, s_object,0 - sigma, in the chapter's direction.
    return senses * (starts - np.asarray(states.s).reshape(-1, 2))


@compiled  # without the derivatives of `pinch_statics`, which take three quarters of the time to compile
def _potential(grasp: Grasp, s: Given) -> Array:
    """$U(s_1, s_2)$ [J] of a pinch."""
    return pinch_statics(grasp, s).potential


def _levels(ax: Axes, grasp: Grasp, middle: np.ndarray, half: float) -> None:
    line = np.linspace(-half, half, _GRID)
    s1, s2 = np.meshgrid(middle[0] + line, middle[1] + line)
    u = 1e3 * np.array(_potential(grasp, np.stack([s1, s2], axis=-1)))
    u[~(_inside(grasp, 0, s1) & _inside(grasp, 1, s2))] = np.nan
    levels = energy_levels(u, _LEVELS)
    ax.contourf(MM * s1, MM * s2, u, levels, cmap="Blues", alpha=0.8)
    ax.contour(MM * s1, MM * s2, u, levels, colors="white", linewidths=0.8)
    ax.set_aspect("equal")
    energy_bar(ax, levels, "$U$ [mJ]")


def _inside(grasp: Grasp, i: int, s: np.ndarray) -> np.ndarray:
    """Where the chapter's $s_i$ lies on both contours of contact i."""
    contact = grasp.contacts[i]
    tip, face = grasp.shapes(contact)
    on_face = contact.sense * s
    # sigma = s_object,0 - s on the object, and s_tip = s_tip,0 + sigma.
    on_tip = float(contact.s_tip) + float(contact.s_object) - on_face
    return on_contour(tip, on_tip) & on_contour(face, on_face)
