"""A consistent initial state: every contact closed and tangent, every velocity compatible."""

import itertools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from .._algebra import factorise, Pose2, unstack
from .._results import concrete
from ..contact import locate as locate_contours
from ..mechanics import (
    bodies,
    compiled,
    displaced,
    Grasp,
    join,
    linearise,
    mass_matrix,
    poses,
    split,
    State,
    to_leaves,
    to_places,
    touches,
)
from ._closed_loop import compatible

_RESTORE_STEPS = 60


def close(
    grasp: Grasp,
    guess: State,
    *,
    hold_contacts: bool = True,
    throw: bool = True,
    locate: bool = False,
) -> tuple[Grasp, State]:
    r"""Move a guess onto the constraints: the nearest consistent state.

    Positions minimise $\frac12 (q - q_0)^T M(q_0) (q - q_0)$ subject to gap (5)-(6), (64)-(65) and
    tangency, by a damped Newton method on the optimality conditions; velocities are then projected
    onto $A v = 0$ in the same metric. The result is differentiable in both modes, by the implicit
    function theorem, with respect to every number in `grasp` and `guess`; leaving this out of a gradient
    through a simulation makes it wrong, not inexact.

    Args:
        grasp: The grasp.
        guess: A state near the one wanted.
        hold_contacts: If True, contacts stay where `guess.s` puts them, and the pose is moved
            until they touch. If False they may roll, and the pose is moved as little as possible.
        locate: If True, every contact starts from the closest points of its two contours at the
            guessed pose, found globally by `contact.locate`, whatever the guess says; from there it
            may roll. The grasp returned has the contacts' new arclengths, and `s` counts from them.
        throw: If False, or while JAX traces, an unreachable pose is returned as it is, and
            `simulate` gives it the code `unreachable`.

    Returns:
        The grasp and the closed state, ready for `simulate(*close(grasp, guess), t1)`.

    Raises:
        ValueError: If shapes do not fit, or no pose near the guess closes the contacts: the worst row
            and its size are named. If `locate` is asked for endless contours, or for two contacts of the
            same contours.

    Accuracy: rows below 1e-14 m (rad); derivatives to rounding.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> moved = grasp.with_tip(0, jxr.Circle(0.02).moved(angle=-1.5))
        >>> _, start = jxr.close(moved, state)
        >>> bool(abs(jxr.residuals(moved, start).tangential[0]) < 1e-14)
        True
    """
    check_state(grasp, guess)
    if locate:
        grasp, guess = _at_closest_points(grasp, guess)
    state, rows = _close(grasp, guess, hold_contacts and not locate)
    seen = concrete(rows)
    if throw and seen is not None:
        worst = int(np.nanargmax(np.where(np.isnan(seen), np.inf, np.abs(seen))))
        if not abs(seen[worst]) <= reach(guess.q.dtype):
            raise ValueError(
                f"argument guess must be near a pose that closes every contact, but the best "
                f"found leaves {row_name(grasp, worst)} at {abs(seen[worst]):.3g}"
            )
    return grasp, state


def _at_closest_points(grasp: Grasp, guess: State) -> tuple[Grasp, State]:
    """The grasp with its contacts at the closest points of their contours at the guessed pose."""
    pairs = [(contact.finger, contact.contour) for contact in grasp.contacts]
    if len(set(pairs)) < len(pairs):
        raise ValueError(
            f"argument locate must be False if two contacts share contours, but was True: {pairs}"
        )
    for i, contact in enumerate(grasp.contacts):
        if any(contour.domain() is None for contour in grasp.shapes(contact)):
            raise ValueError(
                f"argument locate must be False for endless contours, as those of contact {i} are"
            )
    body, *tips = poses(grasp, split(guess.q, grasp.form.positions))
    found = []
    for contact in grasp.contacts:
        tip, face = grasp.shapes(contact)
        pair = locate_contours(tip, face, pose_a=_numbers(tips[contact.finger]), pose_b=_numbers(body))
        found += [pair.s[0], pair.s[1]]
    places = lambda g: [s for c in g.contacts for s in (c.s_tip, c.s_object)]  # noqa: E731
    located = eqx.tree_at(places, grasp, found)
    return located, State(guess.q, guess.v, jnp.zeros_like(guess.s))


def _numbers(pose: Pose2) -> Array:
    """A pose as position and angle."""
    return jnp.stack([pose.origin.x, pose.origin.y, jnp.arctan2(pose.sin, pose.cos)])


def reach(dtype: Any) -> float:
    """Size of the worst row [m or rad] above which a state is not on the constraints."""
    return 1e-9 if np.dtype(dtype) == np.float64 else 1e-5


def check_state(grasp: Grasp, state: State) -> None:
    """Raise unless a state has the shapes of its grasp and finite numbers."""
    sizes = grasp.form.counts
    for name, value, size in zip("qvs", (state.q, state.v, state.s), sizes, strict=True):
        if jnp.shape(value) != (size,):
            raise ValueError(f"argument state.{name} must have shape ({size},), but had {jnp.shape(value)}")
        seen = concrete(value)
        if seen is not None and not np.all(np.isfinite(seen)):
            raise ValueError(f"argument state.{name} must be finite, but was {seen.tolist()}")


def row_name(grasp: Grasp, row: int) -> str:
    """What constraint row this is, for messages."""
    names = [(name, i) for i, contact in enumerate(grasp.contacts) for name in contact.equation_names()]
    name, contact = names[row]
    return f"the {name} of contact {contact}"


@compiled
def _close(grasp: Grasp, guess: State, hold: bool) -> tuple[State, Array]:
    ready = grasp.prepared()
    start = jnp.zeros(_unknowns(ready, hold), guess.q.dtype)
    args = (ready, guess, _metric(ready, guess, start.shape[0]))

    def rows(step: Array, args: Any) -> Array:
        return constraint_rows(args[0], *moved(args[0], args[1], step))

    def optimality(unknown: tuple[Array, Array], args: Any) -> tuple[Array, Array]:
        step, pressure = unknown
        left, pull = jax.vjp(lambda step: rows(step, args), step)
        return args[2] @ step + pull(pressure)[0], left

    count = sum(len(contact.equation_names()) for contact in ready.contacts)
    near = jax.lax.stop_gradient(_restore(lambda step: rows(step, args), start, args[2]))
    if start.shape[0] == count:  # nothing left to minimise
        step = _root(rows, near, args)
    else:
        step, _ = _root(optimality, (near, jnp.zeros(count, start.dtype)), args)
    q, s = moved(ready, guess, step)
    return State(q, _compatible(ready, q, guess.v, s), s), constraint_rows(ready, q, s)


def _unknowns(grasp: Grasp, hold: bool) -> int:
    return grasp.coordinates + (0 if hold else sum(contact.slack for contact in grasp.contacts))


def moved(grasp: Grasp, guess: State, step: Array) -> tuple[Array, Array]:
    """Positions and contact coordinates after a step from a guess; the contacts' part may be missing."""
    leaves, rest = to_leaves(guess, grasp.form), iter(unstack(step))
    blocks = tuple(tuple(itertools.islice(rest, size)) for size in grasp.sizes)
    q, places = displaced(grasp, leaves.q, blocks), []
    for contact, place in zip(grasp.contacts, leaves.s, strict=True):
        shapes, shift = grasp.shapes(contact), tuple(itertools.islice(rest, contact.slack))
        place = contact.onto(shapes, place)
        places.append(contact.shift(shapes, place, shift) if shift else place)
    return join(q), jnp.stack(jax.tree.leaves(places))


def constraint_rows(grasp: Grasp, q: Array, s: Array) -> Array:
    """Gap [m] and tangency [rad] of every contact of a prepared grasp: in the plane shape (3c,)."""
    frames = poses(grasp, split(q, grasp.form.positions))
    each = zip(grasp.contacts, touches(grasp, to_places(s, grasp.form)), strict=True)
    rows = [row for c, t in each for row in c.equations((frames[1 + c.finger], frames[0]), t)]
    return jnp.stack(rows)


def _metric(grasp: Grasp, guess: State, size: int) -> Array:
    """Mass matrix at the guess, scaled to unit mean; free contact coordinates weigh next to nothing."""
    _, inertias = bodies(grasp, to_leaves(guess, grasp.form))
    n = grasp.coordinates
    mass = mass_matrix([inertia.mass for inertia in inertias], n)
    metric = jnp.zeros((size, size), guess.q.dtype).at[:n, :n].set(mass * (n / jnp.trace(mass)))
    free = jnp.where(jnp.arange(size) < n, 0.0, 1e-3)
    return metric + jnp.diag(free.astype(metric.dtype))


def _root(function: Callable, start: Any, args: Any) -> Any:
    """Newton's method from a point close by; differentiated by the implicit function theorem."""
    newton = optx.Newton(rtol=1e-12, atol=1e-12)
    return optx.root_find(function, newton, start, args, max_steps=32, throw=False).value


def _restore(rows: Callable[[Array], Array], start: Array, metric: Array) -> Array:
    """Gauss-Newton in the mass metric; a step that does not help is shortened."""

    def newton_step(jacobian: Array, left: Array) -> Array:
        weighted = jnp.linalg.solve(metric, jacobian.T)
        schur = jacobian @ weighted
        # Redundant rows (an over-determined pose) make it singular: a ridge far below rounding's reach.
        ridge = 1e-14 * jnp.trace(schur) * jnp.eye(left.shape[0], dtype=left.dtype)
        return weighted @ jnp.linalg.solve(schur + ridge, left)

    def improve(carry: tuple[Array, ...]) -> tuple[Array, ...]:
        best, smallest, step, scale, i = carry
        trial = best - scale * step
        left, push = jax.linearize(rows, trial)
        jacobian = jax.vmap(push, out_axes=-1)(jnp.eye(trial.shape[0], dtype=trial.dtype))
        size = jnp.max(jnp.abs(left))
        better = size < smallest
        keep = lambda new, old: jnp.where(better, new, old)  # noqa: E731
        return (
            keep(trial, best),
            keep(size, smallest),
            keep(newton_step(jacobian, left), step),
            keep(jnp.ones_like(scale), 0.25 * scale),
            i + 1,
        )

    def more(carry: tuple[Array, ...]) -> Array:
        _, smallest, _, scale, i = carry
        return (smallest > 1e-13) & (scale > 1e-6) & (i < _RESTORE_STEPS)

    one = jnp.ones((), start.dtype)
    first = (start, jnp.inf * one, jnp.zeros_like(start), one, jnp.array(0))
    return jax.lax.while_loop(more, improve, first)[0]


def _compatible(grasp: Grasp, q: Array, v: Array, s: Array) -> Array:
    """Project velocities onto $A v = 0$ in the mass metric."""
    leaves = to_leaves(State(q, v, s), grasp.form)
    motions, inertias = bodies(grasp, leaves)
    masses = [factorise(inertia.mass) for inertia in inertias]
    line = linearise(grasp, motions, masses, touches(grasp, leaves.s))
    return join(compatible(grasp, leaves, line).v)
