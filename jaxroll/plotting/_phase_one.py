r"""The path of a grasp with one direction of motion, over the level lines of its energy: Part 2.

With the contact closed, all of the motion is $s(t)$, and its energy is
$E(s, \dot s) = U(s) + \frac12 m(s) \dot s^2$ with $m(s) = 2K/\dot s^2$ of any motion through s. Without
damping and loads the path would be a level line.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._analysis import press_balance
from .._closing import close
from .._fields import changes_in_time
from .._integration import Trajectory, vector_field
from .._mechanics import Grasp, State
from .._motion import energies
from .._xla import quickly
from ..control import law_of, Press
from ._phase_parts import draw_path, energy_bar, energy_levels, least_of, on_contour
from ._style import MM, Picture, tidy
from ._views import single

_PLACES, _RATES, _LEVELS = 61, 81, 16
# Free space round the path, as a share of it, and a gripper's smallest half widths of the picture [m; m/s].
_MARGIN, _LEAST = 0.2, (5e-4, 1e-3)


def has_one_direction(grasp: Grasp) -> bool:
    """Whether a planar grasp under `control.Press` moves in one way only."""
    free = grasp.coordinates - sum(contact.rows for contact in grasp.contacts)
    pressed = isinstance(law_of(grasp.controller), Press) and len(grasp.contacts) == 1
    return pressed and free == 1 and not grasp.spatial


def check_potential(grasp: Grasp) -> None:
    """Raise unless the law of such a grasp has a potential, whose level lines are to be drawn."""
    if changes_in_time(law_of(grasp.controller), "force", "radius", "target"):
        raise ValueError(
            "argument grasp must have numbers as its controller's force, radius and target, but one was a "
            "function of time, of which there is no potential; "
            "grasp.with_(controller=grasp.controller.at(t)) holds it"
        )


def phase_of_one(grasp: Grasp, trajectory: Trajectory, rest: State | None) -> Figure:
    r"""Draw $(s, \dot s)$ over the level lines of kinetic and potential energy; see `phase`."""
    # Without loads, whose energy does not count; of a law in another one only the inner law has a potential.
    held = grasp.with_(controller=law_of(grasp.controller), load=None)
    ts, reached = single(trajectory)
    states = jax.tree.map(lambda a: np.asarray(a)[reached], _bare(trajectory.states))
    # The state of rest, if there is one, follows those of the path, where it is part of the same program.
    told = [states] if rest is None else [states, _bare(rest)]
    places = _chapter_s(held, jax.tree.map(lambda *each: np.vstack(each), *told))
    count = len(states.q)
    path = np.stack([places[:count], _rates(held, states)], axis=-1)
    goal = np.stack([places[count:], np.zeros(len(places) - count)], axis=-1)
    every = np.concatenate([path, goal])
    middle = 0.5 * (every.min(axis=0) + every.max(axis=0))
    least = [least_of(grasp, each) for each in _LEAST]
    half = np.maximum((0.5 + _MARGIN) * np.ptp(every, axis=0), least)
    figure = Picture(6.4, 5.0)
    ax = figure.subplots()
    _levels(ax, held, states, middle, half)
    draw_path(ax, path, goal, ts[reached])
    tidy(
        ax,
        xlabel="$s$ [mm]",
        ylabel=r"$\dot s$ [mm/s]",
        title="Contact on the object, over the energy $K + U$",
    )
    handles, names = ax.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return figure


def _bare(states: State) -> State:
    """States without the memory of a controller."""
    return State(states.q, states.v, states.s)


def _chapter_s(grasp: Grasp, states: State) -> np.ndarray:
    """The chapter's s [m] of states along a leading axis."""
    return np.asarray(press_balance(grasp, jnp.zeros(states.q.shape[:-1]), states).s)[..., 0]


def _rates(grasp: Grasp, states: State) -> np.ndarray:
    """The rate of the chapter's s [m/s]."""
    ys, count = np.concatenate([states.q, states.v, states.s], axis=-1), len(states.q)
    # As many at a time as the level lines have places: one program serves both, and paths of any length.
    blocks = [ys[np.minimum(i + np.arange(_PLACES), count - 1)] for i in range(0, count, _PLACES)]
    free = grasp.with_(controller=None, load=None)
    rolled = np.concatenate([_rolling_rates(free, jnp.asarray(block)) for block in blocks])[:count]
    return -grasp.contacts[0].sense * rolled


@quickly
def _rolling_rates(grasp: Grasp, ys: Array) -> Array:
    """The rate of the contact's coordinate at states given as rows of the field of a run [m/s]."""
    field = vector_field(grasp, events=())
    return field.states(jax.vmap(lambda y: field(0.0, y))(ys)).s[:, 0]


@quickly
def _closed(grasp: Grasp, guesses: State) -> State:
    """States near guesses along a leading axis, with the contact closed."""
    return jax.vmap(lambda guess: close(grasp, guess, throw=False)[1])(guesses)


def _levels(ax: Axes, grasp: Grasp, states: State, middle: np.ndarray, half: np.ndarray) -> None:
    """Level lines of the energy; nothing where the contact would be past the end of a contour."""
    contact = grasp.contacts[0]
    line = middle[0] + np.linspace(-half[0], half[0], _PLACES)
    # The chapter's s is sense (s_object,0 - sigma). Each pose is guessed as the saved one nearest in sigma.
    rolled = float(contact.s_object) - contact.sense * line
    near = np.argmin(np.abs(np.asarray(states.s)[:, 0][None] - rolled[:, None]), axis=1)
    fastest = states.v[np.argmax(np.abs(states.v).sum(axis=1))]
    moving = jnp.tile(jnp.asarray(fastest), (_PLACES, 1))
    guesses = State(jnp.asarray(states.q[near]), moving, jnp.asarray(rolled)[:, None])
    closed = _closed(grasp, guesses)
    kinetic, potential = map(np.asarray, energies(grasp, closed))
    speed = _rates(grasp, jax.tree.map(np.asarray, closed))
    inertia = np.where(speed != 0.0, 2.0 * kinetic / np.where(speed != 0.0, speed, 1.0) ** 2, np.nan)
    inertia[~_inside(grasp, rolled)] = np.nan
    rates = middle[1] + np.linspace(-half[1], half[1], _RATES)
    energy = 1e3 * (potential + 0.5 * inertia * rates[:, None] ** 2)
    levels = energy_levels(energy, _LEVELS)
    ax.contourf(MM * line, MM * rates, energy, levels, cmap="Blues", alpha=0.8)
    ax.contour(MM * line, MM * rates, energy, levels, colors="white", linewidths=0.8)
    energy_bar(ax, levels, "$K + U$ [mJ]")


def _inside(grasp: Grasp, rolled: np.ndarray) -> np.ndarray:
    """Where a contact is on both of its contours, for rolling coordinates [m]."""
    contact = grasp.contacts[0]
    tip, face = grasp.shapes(contact)
    on_tip, on_face = float(contact.s_tip) + rolled, float(contact.s_object) - rolled
    return on_contour(tip, on_tip) & on_contour(face, on_face)
