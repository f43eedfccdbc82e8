r"""The nearest configuration in which every contact is closed and tangent.

Minimises $\frac12 d^T M(q_0)\, d$ over displacements $d$ from a guess subject to the constraint rows
$c(d) = 0$. Steps are $d \to d - M^{-1} A^T S^{-1} c - P d$ with $S = A M^{-1} A^T$ and $P$ the projection
along $M^{-1} A^T$: where they stop, $c = 0$ and $M d = A^T \mu$, the conditions of the minimum. Only first
derivatives of the rows are compiled for it; second ones are for the derivative of the minimum alone.
"""

import itertools
from typing import Any, NamedTuple

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._algebra import sharing, unstack
from .._backend import differentiable_kernel, filled, one_kernel
from ..mechanics import (
    bodies,
    displaced,
    Grasp,
    join,
    mass_matrix,
    poses,
    split,
    State,
    to_leaves,
    to_places,
    touches,
)

_STEPS = 300
# Rows below this are close enough to the constraints to follow them [m or rad].
_NEAR = 1e-6
# Closed to this share of the way left along them is enough to go on: sooner, one step undoes the other.
_CLOSED = 0.01


class _Problem(eqx.Module):
    """A prepared grasp, the guess, and the metric of displacements."""

    grasp: Grasp
    guess: State
    metric: Array

    def rows(self, step: Array) -> Array:
        """What the constraints leave over after a step."""
        return constraint_rows(self.grasp, *moved(self.grasp, self.guess, step))

    def linearised(self, step: Array) -> tuple[Array, Array]:
        """The rows and their Jacobian."""
        with sharing(step[0]):
            left, push = jax.linearize(self.rows, step)
            return left, jax.vmap(push, out_axes=-1)(jnp.eye(step.shape[0], dtype=step.dtype))

    def conditions(self, z: Array) -> Array:
        """Those of the minimum; `z` holds the step and the multipliers of the rows."""
        step, pressure = z[: self.metric.shape[0]], z[self.metric.shape[0] :]
        with sharing(step[0]):
            left, pull = jax.vjp(self.rows, step)
            return jnp.concatenate([self.metric @ step + pull(pressure)[0], left])

    def slopes(self, z: Array) -> Array:
        """Jacobian of the conditions, one column after the other: side by side compiles thrice as long."""
        unit = lambda i: jnp.where(jnp.arange(z.shape[0]) == i, 1.0, 0.0).astype(z.dtype)  # noqa: E731
        column = lambda i: jax.jvp(self.conditions, (z,), (unit(i),))[1]  # noqa: E731
        return jax.lax.map(column, jnp.arange(z.shape[0])).T


def nearest(grasp: Grasp, guess: State, hold: bool) -> Array:
    """Displacement from a guess, as `moved` takes it, to the nearest closed configuration.

    Args:
        grasp: A prepared grasp.
        guess: Where to start, its contacts on their shapes.
        hold: Whether contacts stay where the guess puts them.
    """
    size = grasp.coordinates + (0 if hold else sum(contact.slack for contact in grasp.contacts))
    return _nearest(_Problem(grasp, guess, _metric(differentiable_kernel(_mass, grasp, guess), size)))


@eqx.filter_custom_jvp
def _nearest(problem: _Problem) -> Array:
    return _searched(problem)


@_nearest.def_jvp
def _nearest_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    """Implicit function theorem on the conditions of the minimum."""
    (problem,), (dots,) = primals, tangents
    step = _nearest(problem)
    moving, still = eqx.partition(problem, eqx.is_inexact_array)
    moving, step = eqxi.nondifferentiable((moving, step), name="a closed state (second derivatives)")
    problem = eqx.combine(moving, still)
    left, jacobian = one_kernel(_Problem.linearised, problem, step)
    pressure = -_pressure(jacobian, problem.metric, jacobian @ step)
    z = jnp.concatenate([step, pressure])
    n = step.shape[0]
    _, change = jax.jvp(lambda m: eqx.combine(m, still).conditions(z), (moving,), (filled(moving, dots),))
    if n == left.shape[0]:  # nothing left to minimise: the rows alone
        return step, -jnp.linalg.solve(jacobian, change[n:])
    return step, -jnp.linalg.solve(one_kernel(_Problem.slopes, problem, z), change)[:n]


def _pressure(jacobian: Array, metric: Array, right: Array) -> Array:
    """Solve with $A M^{-1} A^T$, its rows scaled to unit diagonal."""
    schur = jacobian @ jnp.linalg.solve(metric, jacobian.T)
    scale = 1.0 / jnp.sqrt(jnp.diag(schur))
    unit = schur * jnp.outer(scale, scale)
    # Redundant rows (an over-determined pose) make it singular: a ridge; a second pass takes its error back.
    firm = unit + 1e-13 * jnp.eye(right.shape[0], dtype=right.dtype)
    first = jnp.linalg.solve(firm, right * scale)
    return scale * (first + jnp.linalg.solve(firm, right * scale - unit @ first))


def _normal(jacobian: Array, metric: Array, right: Array) -> Array:
    """$M^{-1} A^T S^{-1}$ times a change of the rows: the smallest step that makes it."""
    return jnp.linalg.solve(metric, jacobian.T @ _pressure(jacobian, metric, right))


class _Search(NamedTuple):
    """A search in progress.

    Attributes:
        step: Best displacement so far.
        size: Largest of its rows.
        move: Where to go from there, downwards being minus.
        scale: How much of it is tried.
        length: Of its part along the constraints, in the metric, where they were last closed.
        share: How much of that part is taken.
        rolling: Whether any of it is in this move.
        count: Evaluations so far.
    """

    step: Array
    size: Array
    move: Array
    scale: Array
    length: Array
    share: Array
    rolling: Array
    count: Array


def _searched(problem: _Problem) -> Array:
    """The loop: Gauss-Newton back onto the constraints, and along them to the minimum."""
    one = jnp.ones((), problem.metric.dtype)
    start = jnp.zeros(problem.metric.shape[0], problem.metric.dtype)
    first = _Search(start, jnp.inf * one, start, one, jnp.inf * one, one, jnp.array(False), jnp.array(0))

    def more(search: _Search) -> Array:
        tiny = 4.0 * jnp.finfo(start.dtype).eps * _length(problem, search.step)
        done = (search.size < 1e-13) & ((search.length <= tiny) | (search.share < 1e-3))
        return ~done & (search.scale > 1e-6) & (search.count < _STEPS)

    return jax.lax.while_loop(more, lambda search: _improved(problem, search), first).step


def _improved(problem: _Problem, search: _Search) -> _Search:
    trial = search.step - search.scale * search.move
    left, jacobian = one_kernel(_Problem.linearised, problem, trial)
    size = jnp.max(jnp.abs(left))
    normal = _normal(jacobian, problem.metric, left)
    along = trial - _normal(jacobian, problem.metric, jacobian @ trial)
    length = _length(problem, along)
    # A step along the constraints opens them a little, and is taken all the same; others have to help.
    closed = (size < _NEAR) | (size < _CLOSED * length)
    better = closed | (size < search.size) | (search.rolling & (size < search.length))
    share = jnp.where(closed & (length > 0.9 * search.length), 0.5 * search.share, search.share)
    move = normal + jnp.where(closed, share, 0.0) * along
    one, count = jnp.ones_like(size), search.count + 1
    known = jnp.where(closed, length, search.length)
    taken = _Search(trial, size, move, one, known, share, closed, count)
    left_alone = search._replace(scale=0.25 * search.scale, count=count)
    return jax.tree.map(lambda new, old: jnp.where(better, new, old), taken, left_alone)


def _length(problem: _Problem, step: Array) -> Array:
    return jnp.sqrt(step @ problem.metric @ step)


def on_shapes(grasp: Grasp, guess: State) -> State:
    """A guess with every contact's place on both of its shapes."""
    places = to_places(guess.s, grasp.form)
    each = zip(grasp.contacts, places, strict=True)
    settled = [contact.onto(grasp.shapes(contact), place) for contact, place in each]
    return State(guess.q, guess.v, jnp.stack(jax.tree.leaves(settled)))


def moved(grasp: Grasp, guess: State, step: Array) -> tuple[Array, Array]:
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
    frames = poses(grasp, split(q, grasp.form.positions))
    each = zip(grasp.contacts, touches(grasp, to_places(s, grasp.form)), strict=True)
    rows = [row for c, t in each for row in c.equations((frames[1 + c.finger], frames[0]), t)]
    return jnp.stack(rows)


def _mass(grasp: Grasp, guess: State) -> Array:
    """Mass matrix at the guess."""
    with sharing(guess.q[0]):
        _, inertias = bodies(grasp, to_leaves(guess, grasp.form))
        return mass_matrix([inertia.mass for inertia in inertias], grasp.coordinates)


def _metric(mass: Array, size: int) -> Array:
    """A mass matrix scaled to unit mean; free contact coordinates weigh next to nothing."""
    n = mass.shape[0]
    scaled = jnp.pad(mass * (n / jnp.trace(mass)), (0, size - n))
    free = jnp.where(jnp.arange(size) < n, 0.0, 1e-3)
    return scaled + jnp.diag(free.astype(scaled.dtype))
