"""`close`: from a guess to a consistent initial state.

Consistent means that every contact is closed (gap zero) and tangent, and that the velocities keep it so,
$A v = 0$. This module checks the arguments, locates the contacts where that is asked for, and names the worst
constraint row in its message; `_search` finds the configuration, and `_implicit_derivative` makes it and its
velocities differentiable. `simulate` takes what is returned.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import Pose3, seven, three
from .._mechanics import check_states, compiled, FreeObject3, Grasp, has_unchecked_shapes, split, State
from .._motion import closed_within, world_poses
from .._results import check_flag, concrete, shown
from ..contact import Contact, Contact3, locate as locate_contours, locate_surfaces
from ..geometry import as_it_is_resolved
from ._hold import held_velocities
from ._implicit_derivative import settled
from ._search import on_shapes


def close(
    grasp: Grasp,
    guess: State,
    *,
    hold_contacts: bool = True,
    throw: bool = True,
    locate: bool = False,
    hold: str | Sequence[str] = (),
) -> tuple[Grasp, State]:
    r"""Move a guess onto the constraints: the nearest pose with its contacts where the guess has them.

    By default every contact stays at the places on both shapes where `guess.s` puts it, and the bodies are
    moved until these places touch: what is found is the nearest of the states with *those* contacts, and in
    general not the nearest of all consistent states. That one is found with `hold_contacts=False`.

    Positions minimise $\frac12 (q - q_0)^T M(q_0) (q - q_0)$ subject to gap (5)-(6), (64)-(65) and tangency,
    by damped Gauss-Newton steps from the guess, and so locally; where contacts may roll, how far they roll
    counts too, with a thousandth of the mean weight of a coordinate. Velocities are then projected
    onto $A v = 0$ in the mass metric of the closed pose. The result is differentiable in both modes, by the
    implicit function theorem, with respect to every number in `grasp` and `guess`; leaving this out of a
    gradient through a simulation makes it wrong, not inexact.

    Args:
        grasp: The grasp.
        guess: A state near the one wanted.
        hold_contacts: If True, contacts stay where `guess.s` puts them, and the pose is moved
            until they touch. If False they may roll, and the pose is moved as little as possible. With
            `locate` it counts as False.
        locate: If True, every contact starts from the closest points of its two contours at the
            guessed pose, found globally by `contact.locate`, whatever the guess says; from there it
            may roll. The grasp returned has the contacts' new arclengths, and `s` counts from them.
        hold: Names of bodies ('object', 'finger 0') and of single coordinates with their body's ('object x',
            'finger 0 q[1]', as `grasp.labels.coordinates` lists them) whose positions stay at the guess, and
            the shortest displacement of the others is found. An orientation in space can be held only with
            its whole body. Velocities are projected as without `hold`.
        throw: If False, or while JAX traces, an unreachable pose is returned as it is, and
            `simulate` gives it the code `unreachable`.

    Returns:
        The grasp and the closed state, ready for `simulate(*close(grasp, guess), t1)`.

    Raises:
        ValueError: If shapes do not fit, or no pose near the guess closes the contacts: the worst row
            and its size are named. If `locate` is asked for endless contours, or for two contacts of the
            same contours.

    Accuracy: rows below 1e-14 m (rad), in single precision below 1e-6 m (rad); derivatives to rounding, in
    both modes. Where rows are redundant, as between parallel plates, this holds for changes that leave them
    redundant. Second derivatives are refused.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> moved = grasp.with_tip(0, jxr.Circle(0.02).moved(angle=-1.5))
        >>> _, start = jxr.close(moved, state)
        >>> bool(abs(jxr.residuals(moved, start).tangential[0]) < 1e-14)
        True
    """
    check_states(grasp, guess, "guess", unit=False)
    _check_turned(grasp, guess)
    for name, flag in (("hold_contacts", hold_contacts), ("throw", throw), ("locate", locate)):
        check_flag(name, flag)
    held = held_velocities(grasp, hold)
    if len(held) == grasp.coordinates:
        raise ValueError(f"argument hold must leave some coordinate free, but was {shown(hold)}")
    if locate:
        grasp, guess = _at_closest_points(grasp, guess)
    still = hold_contacts and not locate
    state, rows = _close(grasp, guess, still, resting=_resting(grasp, guess), held=held)
    # While JAX traces, the rows have no values, and nothing can be raised.
    seen = concrete(rows)
    if throw and seen is not None:
        if np.isnan(seen).all() and has_unchecked_shapes(grasp):
            raise ValueError(
                "argument grasp must be made of contours given by their arclength, and have frames that are "
                "those of its shapes, but a shape of your own, with numbers that JAX traces, was not"
            )
        # A NaN among the rows counts as the worst. The comparison below is negated, so that a NaN fails it.
        worst = int(np.nanargmax(np.where(np.isnan(seen), np.inf, np.abs(seen))))
        if not abs(seen[worst]) <= closed_within(guess.q.dtype):
            kept = f" while {shown(hold)} is held" if held else ""
            raise ValueError(
                f"argument guess must be near a pose that closes every contact, but the best found{kept} "
                f"leaves {row_name(grasp, worst)} at {abs(seen[worst]):.3g}"
            )
    return grasp, state


def _check_turned(grasp: Grasp, guess: State) -> None:
    """Raise for an object in space whose quaternion is zero: it has no orientation, and no way to one."""
    known = concrete(guess.q)
    if isinstance(grasp.object, FreeObject3) and known is not None and not np.any(known[3:7]):
        raise ValueError(
            "argument guess must have a quaternion of the object's orientation in q[3:7], but it was zero"
        )


def _at_closest_points(grasp: Grasp, guess: State) -> tuple[Grasp, State]:
    """The grasp with its contacts at the closest points of their shapes at the guessed pose."""
    # Closest points are one pair per two shapes: a second contact of the same shapes would get the same ones.
    pairs = [(contact.finger, contact.touched) for contact in grasp.contacts]
    if len(set(pairs)) < len(pairs):
        raise ValueError(
            f"argument locate must be False if two contacts share contours, but was True: {pairs}"
        )
    kind = Contact3 if grasp.spatial else Contact
    for i, contact in enumerate(grasp.contacts):
        if not isinstance(contact, kind):
            raise ValueError(
                f"argument locate must be False for contacts of one's own, "
                f"as contact {i} is: {shown(contact)}"
            )
    # Poses of the object, then of every fingertip.
    frames = world_poses(grasp, split(guess.q, grasp.form.positions))
    if grasp.spatial:
        # In space the state itself holds the contact coordinates, and the grasp stays as it is.
        return grasp, State(guess.q, guess.v, _closest_places(grasp, frames), guess.memory)
    for i, contact in enumerate(grasp.contacts):
        if any(contour.domain() is None for contour in grasp.shapes(contact)):
            raise ValueError(
                f"argument locate must be False for endless contours, as those of contact {i} are"
            )
    found = []
    for contact in grasp.contacts:
        tip, face = grasp.shapes(contact)
        own, body = three(frames[1 + contact.finger]), three(frames[0])
        pair = locate_contours(tip, face, pose_a=own, pose_b=body)
        found += [pair.s[0], pair.s[1]]
    # In the plane the state counts arclengths from those that the contact holds. The contact gets the new
    # arclengths, and the state's s is zero.
    places = lambda g: [s for c in g.contacts for s in (c.s_tip, c.s_object)]  # noqa: E731
    located = eqx.tree_at(places, grasp, found)
    return located, State(guess.q, guess.v, jnp.zeros_like(guess.s), guess.memory)


def _closest_places(grasp: Grasp, frames: tuple[Pose3, ...]) -> Array:
    """Contact coordinates of the closest points of both surfaces of every contact."""
    places = []
    for contact in grasp.contacts:
        tip, face = grasp.shapes(contact)
        own, body = seven(frames[1 + contact.finger]), seven(frames[0])
        found = locate_surfaces(tip, face, pose_a=own, pose_b=body)
        places += [found.at_a, found.at_b]
    return jnp.concatenate(places)


def row_name(grasp: Grasp, row: int) -> str:
    """What a row of `constraint_rows` is, in words, such as "the x gap [m] of contact 0"."""
    names = [(name, i) for i, contact in enumerate(grasp.contacts) for name in contact.equation_names()]
    name, contact = names[row]
    return f"the {name} of contact {contact}"


def _resting(grasp: Grasp, guess: State) -> bool:
    """Whether nothing moves, as far as can be told before the program is made."""
    rates = concrete(guess.v)
    return rates is not None and not np.any(rates) and not any(f.prescribed for f in grasp.fingers)


@compiled
def _close(
    grasp: Grasp, guess: State, hold: bool, *, resting: bool, held: tuple[int, ...] = ()
) -> tuple[State, Array]:
    """The closed state and its constraint rows, compiled as one program."""
    ready, _ = as_it_is_resolved(grasp.prepared())  # a run from there says if a table is too coarse
    start = on_shapes(ready, guess)
    state, rows = settled(ready, start, hold, resting=resting, held=held)
    if not hold:
        return state, rows
    # Where contacts are held, their places come straight from the start: a program around this one that reads
    # only these, as that of `design.Firmness` does, is compiled without the search.
    return State(state.q, state.v, start.s, state.memory), rows
