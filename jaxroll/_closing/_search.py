r"""The nearest configuration in which every contact is closed and tangent.

Minimises $\frac12 d^T M(q_0)\, d$ over displacements $d$ from a guess subject to the constraint rows
$c(d) = 0$. Steps are $d \to d - M^{-1} A^T S^{-1} c - P d$ with $S = A M^{-1} A^T$ and $P$ the projection
along $M^{-1} A^T$: where they stop, $c = 0$ and $M d = A^T \mu$, the conditions of the minimum. Only first
derivatives of the rows are compiled for it; second ones are for the derivative of the minimum alone.
"""

import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import lu_factor, lu_solve
from jaxtyping import Array

from .._linalg import unstack
from .._mechanics import Grasp, join, split, State, to_leaves, to_places
from .._motion import bodies, displaced, mass_matrix, touches, world_poses
from .._xla import one_kernel, sharing

_STEPS = 300
# Rows below this are close enough to the constraints to follow them [m or rad].
_NEAR = 1e-6
# Closed to this share of the way left along them is enough to go on: sooner, one step undoes the other.
_CLOSED = 0.01


class ClosingProblem(eqx.Module):
    """The search for the closed configuration nearest to a guess.

    Attributes:
        grasp: A prepared grasp.
        guess: Where to start, its contacts on their shapes.
        metric: Of displacements: `metric_at` the guess.
    """

    grasp: Grasp
    guess: State
    metric: Array

    def rows(self, step: Array) -> Array:
        """What the constraints leave over after a step."""
        return constraint_rows(self.grasp, *after_step(self.grasp, self.guess, step))

    def linearised(self, step: Array) -> tuple[Array, Array]:
        """The rows and their Jacobian."""
        with sharing():
            left, push = jax.linearize(self.rows, step)
            return left, jax.vmap(push, out_axes=-1)(jnp.eye(step.shape[0], dtype=step.dtype))

    def lagrangian(self, z: Array) -> Array:
        """What the minimum makes stationary; `z` holds the step and the multipliers of the rows."""
        step, pressure = z[: self.metric.shape[0]], z[self.metric.shape[0] :]
        with sharing():
            weight = jnp.sum(self.metric * step[None, :], axis=1)
            return 0.5 * jnp.sum(step * weight) + jnp.sum(pressure * self.rows(step))

    def slopes(self, z: Array) -> Array:
        """Its second derivative, one column after the other: side by side compiles thrice as long."""
        unit = lambda i: jnp.where(jnp.arange(z.shape[0]) == i, 1.0, 0.0).astype(z.dtype)  # noqa: E731
        column = lambda i: jax.jvp(jax.grad(self.lagrangian), (z,), (unit(i),))[1]  # noqa: E731
        return jax.lax.map(column, jnp.arange(z.shape[0])).T


def solve_schur(jacobian: Array, metric: Array, right: Array) -> tuple[Array, Array]:
    r"""Solutions of $A M^{-1} A^T p$ = each column of `right`, and the smallest steps $M^{-1} A^T p$."""
    weighed = jnp.linalg.solve(metric, jacobian.T)
    schur = jacobian @ weighed
    scale = 1.0 / jnp.sqrt(jnp.diag(schur))
    unit = schur * jnp.outer(scale, scale)  # its rows scaled to unit diagonal
    # Redundant rows (an over-determined pose) make it singular: a ridge; a second pass takes its error back.
    factors = lu_factor(unit + 1e-13 * np.eye(right.shape[0], dtype=right.dtype))
    scaled = right * scale[:, None]
    first = lu_solve(factors, scaled)
    pressures = scale[:, None] * (first + lu_solve(factors, scaled - unit @ first))
    return pressures, weighed @ pressures


class _Search(NamedTuple):
    """A search in progress.

    Attributes:
        step: Best displacement so far.
        jacobian: Of the rows there.
        size: Largest of the rows.
        move: Where to go from there, downwards being minus.
        scale: How much of it is tried.
        length: Of its part along the constraints, in the metric, where they were last closed.
        share: How much of that part is taken.
        rolling: Whether any of it is in this move.
        count: Evaluations so far.
    """

    step: Array
    jacobian: Array
    size: Array
    move: Array
    scale: Array
    length: Array
    share: Array
    rolling: Array
    count: Array


def searched(problem: ClosingProblem) -> tuple[Array, Array]:
    """Displacement, as `after_step` takes it, to the nearest closed configuration; the rows' Jacobian there.

    The loop: Gauss-Newton back onto the constraints, and along them to the minimum.
    """
    one = jnp.ones((), problem.metric.dtype)
    start = jnp.zeros(problem.metric.shape[0], problem.metric.dtype)
    count = sum(len(contact.equation_names()) for contact in problem.grasp.contacts)
    nothing, far = jnp.zeros((count, start.shape[0]), start.dtype), jnp.inf * one
    first = _Search(start, nothing, far, start, one, far, one, jnp.array(False), jnp.array(0))

    def more(search: _Search) -> Array:
        tiny = 4.0 * jnp.finfo(start.dtype).eps * _length(problem, search.step)
        done = (search.size < 1e-13) & ((search.length <= tiny) | (search.share < 1e-3))
        return ~done & (search.scale > 1e-6) & (search.count < _STEPS)

    last = jax.lax.while_loop(more, lambda search: _improved(problem, search), first)
    return last.step, last.jacobian


def _improved(problem: ClosingProblem, search: _Search) -> _Search:
    trial = search.step - search.scale * search.move
    left, jacobian = one_kernel(ClosingProblem.linearised, problem, trial)
    size = jnp.max(jnp.abs(left))
    both = jnp.stack([left, jacobian @ trial], axis=-1)
    normal, across = solve_schur(jacobian, problem.metric, both)[1].T
    along = trial - across
    length = _length(problem, along)
    # A step along the constraints opens them a little, and is taken all the same; others have to help.
    closed = (size < _NEAR) | (size < _CLOSED * length)
    better = closed | (size < search.size) | (search.rolling & (size < search.length))
    share = jnp.where(closed & (length > 0.9 * search.length), 0.5 * search.share, search.share)
    move = normal + jnp.where(closed, share, 0.0) * along
    one, count = jnp.ones_like(size), search.count + 1
    known = jnp.where(closed, length, search.length)
    taken = _Search(trial, jacobian, size, move, one, known, share, closed, count)
    left_alone = search._replace(scale=0.25 * search.scale, count=count)
    return jax.tree.map(lambda new, old: jnp.where(better, new, old), taken, left_alone)


def _length(problem: ClosingProblem, step: Array) -> Array:
    return jnp.sqrt(step @ problem.metric @ step)


def on_shapes(grasp: Grasp, guess: State) -> State:
    """A guess with every contact's place on both of its shapes."""
    places = to_places(guess.s, grasp.form)
    each = zip(grasp.contacts, places, strict=True)
    settled = [contact.onto(grasp.shapes(contact), place) for contact, place in each]
    return State(guess.q, guess.v, jnp.stack(jax.tree.leaves(settled)))


def after_step(grasp: Grasp, guess: State, step: Array) -> tuple[Array, Array]:
    """Positions and contact coordinates after a step from a guess; the contacts' part may be missing."""
    leaves, rest = to_leaves(guess, grasp.form), iter(unstack(step))
    blocks = tuple(tuple(itertools.islice(rest, size)) for size in grasp.sizes)
    q, places = displaced(grasp, leaves.q, blocks), []
    for contact, place in zip(grasp.contacts, leaves.s, strict=True):
        shift = tuple(itertools.islice(rest, contact.slack))
        places.append(contact.shift(grasp.shapes(contact), place, shift) if shift else place)
    return join(q), jnp.stack(jax.tree.leaves(places))


def constraint_rows(grasp: Grasp, q: Array, s: Array) -> Array:
    """Gap [m] and tangency [rad] of every contact of a prepared grasp: in the plane shape (3c,)."""
    frames = world_poses(grasp, split(q, grasp.form.positions))
    each = zip(grasp.contacts, touches(grasp, to_places(s, grasp.form)), strict=True)
    rows = [row for c, t in each for row in c.equations((frames[1 + c.finger], frames[0]), t)]
    return jnp.stack(rows)


def metric_at(grasp: Grasp, guess: State, hold: bool) -> Array:
    """The mass matrix at the guess, scaled to unit mean; free contact coordinates weigh next to nothing."""
    with sharing():
        _, inertias = bodies(grasp, to_leaves(guess, grasp.form))
        mass = mass_matrix([inertia.mass for inertia in inertias], grasp.coordinates)
    n = grasp.coordinates
    size = n + (0 if hold else sum(contact.slack for contact in grasp.contacts))
    scaled = jnp.pad(mass * (n / jnp.trace(mass)), (0, size - n))
    return scaled + np.diag(np.where(np.arange(size) < n, 0.0, 1e-3).astype(scaled.dtype))
