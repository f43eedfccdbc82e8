r"""The nearest configuration in which every contact is closed and tangent.

A displacement $d$ from the guess changes all positions and, where contacts may roll, their contact
coordinates. `searched` minimises $\frac12 d^T M(q_0)\, d$ subject to $c(d) = 0$: the rows $c$ are gap
(5)-(6), (64)-(65) and tangency of every contact, and $A$ is their Jacobian. An iteration is the sum of two
steps,

$$ d \to d - M^{-1} A^T S^{-1} c - P d, \qquad S = A M^{-1} A^T, \quad P = 1 - M^{-1} A^T S^{-1} A. $$

The first one is Gauss-Newton: the shortest step in the metric $M$ that makes the linearised rows zero. The
second one takes away the part of $d$ along the constraints ($A P = 0$), which does not help to close them; it
is taken only while the contacts are nearly closed. Both are zero where $c = 0$ and $M d = A^T \mu$, the
conditions of the minimum. Only first derivatives of the rows are needed, which keeps the loop quick to
compile; second ones (`ClosingProblem.slopes`) are needed once, where `_implicit_derivative` differentiates
the minimum. `_close` prepares the grasp and calls both.
"""

import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import lu_factor, lu_solve
from jaxtyping import Array

from .._linalg import stacked, unstack, value_and_jacobian
from .._mechanics import Grasp, join, Leaves, split, State, to_leaves, to_places
from .._motion import bodies, displaced, mass_matrix, touches, world_poses
from .._types import ByPrecision
from .._xla import one_kernel, shared, sharing

# Most evaluations of the rows.
_STEPS = 300
# The contacts count as closed, and steps along the constraints are taken, when each row would be closed by a
# step shorter than the first share of the whole displacement, or than the second one of its part along the
# constraints. With a larger share the two kinds of step undo each other: the constraints are curved, so that
# each spoils the other's result. And when no row is larger than the third [m or rad]: where contacts roll, a
# short step closes a tangency that is far open.
_NEAR, _CLOSED, _SMALL = 1e-6, 0.01, 1e-4
# The search ends with contacts closed to this [m or rad]. In single precision rounding alone makes rows of
# closed contacts up to 3e-7.
_DONE = ByPrecision(1e-13, 1e-6)
# What is added to a diagonal of ones, above rounding.
_ADDED = ByPrecision(1e-13, 1e-6)


class ClosingProblem(eqx.Module):
    """The search for the closed configuration nearest to a guess.

    Attributes:
        grasp: A prepared grasp.
        guess: Where to start, its contacts on their shapes.
        metric: Matrix in which displacements are measured, from `metric_at`. Its size tells whether contact
            coordinates are among the unknowns.
        held: Indices of the velocities that are not among them: their positions stay.
    """

    grasp: Grasp
    guess: State
    metric: Array
    held: tuple[int, ...] = eqx.field(static=True)

    def rows(self, step: Array) -> Array:
        """Gaps [m] and tangencies [rad] after a displacement from the guess."""
        return constraint_rows(self.grasp, *after_step(self.grasp, self.guess, step, self.held))

    def linearised(self, step: Array) -> tuple[Array, Array]:
        """The rows, and their Jacobian with respect to the displacement, shape (rows, unknowns)."""
        with sharing():
            return value_and_jacobian(self.rows, step)

    def lagrangian(self, z: Array) -> Array:
        r"""$L(z) = \frac12 d^T M d + p \cdot c(d)$, stationary at the minimum; $z$ is $d$ followed by $p$."""
        step, pressure = z[: self.metric.shape[0]], z[self.metric.shape[0] :]
        with sharing():
            weight = jnp.sum(self.metric * step[None, :], axis=1)
            return 0.5 * jnp.sum(step * weight) + jnp.sum(pressure * self.rows(step))

    def slopes(self, z: Array, jacobian: Array) -> Array:
        r"""Second derivative of the Lagrangian, shape (z, z), with the Jacobian A of the rows at d.

        $$ L_{zz} = \begin{pmatrix} M + \sum_k p_k \nabla^2 c_k & A^T \\ A & 0 \end{pmatrix} $$

        A loop computes one column of the sum after the other: `vmap` over the columns takes three times as
        long to compile.
        """
        count = self.metric.shape[0]
        step, pressure = z[:count], z[count:]

        def column(i: Array) -> Array:
            unit = jnp.where(jnp.arange(count) == i, 1.0, 0.0).astype(z.dtype)
            pressed = jax.grad(lambda step: jnp.sum(pressure * self.rows(step)))
            return jax.jvp(pressed, (step,), (unit,))[1]

        with sharing():
            bend = jax.lax.map(shared(column), jnp.arange(count))
        nothing = jnp.zeros((jacobian.shape[0], jacobian.shape[0]), z.dtype)
        above = jnp.concatenate([self.metric + bend, jacobian.T], axis=1)
        return jnp.concatenate([above, jnp.concatenate([jacobian, nothing], axis=1)])


def solve_schur(jacobian: Array, metric: Array, right: Array) -> tuple[Array, Array, Array]:
    r"""Multipliers and shortest steps that change the linearised rows by given amounts.

    Args:
        jacobian: $A$, shape (rows, unknowns).
        metric: $M$.
        right: Wanted changes of the rows, one in each column.

    Returns:
        $p$ with $A M^{-1} A^T p$ = `right`, and the steps $M^{-1} A^T p$, both column by column; and for each
        row the length in the metric of the shortest step that changes this row by one.
    """
    weighed = jnp.linalg.solve(metric, jacobian.T)
    schur = jacobian @ weighed
    # Gaps are metres and tangencies radians: rows and columns are scaled so that the diagonal is one.
    scale = 1.0 / jnp.sqrt(jnp.diag(schur))
    unit = schur * jnp.outer(scale, scale)
    # Redundant rows, of an over-determined pose, make this matrix singular; a small number on its diagonal
    # makes it invertible. One step of iterative refinement reduces the error that this makes.
    factors = lu_factor(unit + _ADDED.of(unit) * np.eye(right.shape[0], dtype=right.dtype))
    scaled = right * scale[:, None]
    first = lu_solve(factors, scaled)
    pressures = scale[:, None] * (first + lu_solve(factors, scaled - unit @ first))
    return pressures, weighed @ pressures, scale


def added(jacobian: Array, metric: Array) -> Array:
    """What `solve_schur` adds to every row's share in $A M^{-1} A^T$, by rows."""
    return _ADDED.of(jacobian) * jnp.sum(jacobian * jnp.linalg.solve(metric, jacobian.T).T, axis=1)


class _Search(NamedTuple):
    """State of the loop in `searched`.

    Attributes:
        step: Displacement from the guess that was accepted last.
        jacobian: Jacobian of the rows there.
        size: Largest absolute value of the rows there.
        move: The step proposed from there, with the opposite sign: `step - scale * move` is tried next.
        scale: Share of `move` that is tried, reduced while a trial is rejected.
        length: Length, in the metric, of the displacement's part along the constraints, P d, where the
            contacts were last closed.
        share: Share of that part which `move` takes away.
        rolling: Whether `move` has a part along the constraints.
        count: Evaluations of the rows so far.
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
    """Displacement from the guess to the nearest closed configuration, and the Jacobian of the rows there.

    The displacement is one that `after_step` takes. Where no closed configuration is found, it is the last
    one that was accepted: the caller looks at the rows.
    """
    one = jnp.ones((), problem.metric.dtype)
    start = jnp.zeros(problem.metric.shape[0], problem.metric.dtype)
    count = sum(len(contact.equation_names()) for contact in problem.grasp.contacts)
    nothing, far = jnp.zeros((count, start.shape[0]), start.dtype), jnp.inf * one
    first = _Search(start, nothing, far, start, one, far, one, jnp.array(False), jnp.array(0))

    # The first pass tries the guess itself, as `move` is zero, and accepts it, as `size` is infinite.
    def more(search: _Search) -> Array:
        # Closed, and the part along the constraints is rounding, or has failed to shrink ten times.
        tiny = 4.0 * jnp.finfo(start.dtype).eps * _length(problem, search.step)
        done = (search.size < _DONE.of(start)) & ((search.length <= tiny) | (search.share < 1e-3))
        return ~done & (search.scale > 1e-6) & (search.count < _STEPS)

    last = jax.lax.while_loop(more, lambda search: _improved(problem, search), first)
    # `_DONE` lies above rounding. The step proposed there takes what is left, which would otherwise depend on
    # how the search came there: its error is of second order, and needs no evaluation.
    return last.step - jnp.where(last.size < _DONE.of(start), last.move, 0.0), last.jacobian


def _improved(problem: ClosingProblem, search: _Search) -> _Search:
    """One pass of the loop: evaluate the next trial, then accept it or shorten the step."""
    trial = search.step - search.scale * search.move
    left, jacobian = one_kernel(ClosingProblem.linearised, problem, trial)
    size = jnp.max(jnp.abs(left))
    # Two right-hand sides with one factorisation: M^-1 A^T S^-1 c, and M^-1 A^T S^-1 A d = d - P d.
    both = jnp.stack([left, jacobian @ trial], axis=-1)
    _, steps, each = solve_schur(jacobian, problem.metric, both)
    normal, across = steps.T
    along = trial - across
    # How far the contacts are open, as a length in the metric: on grasps of every size, gaps in metres and
    # tangencies in radians cannot be compared with such lengths, nor with each other.
    length, reach = _length(problem, along), jnp.max(jnp.abs(left) * each)
    # A trial is accepted if it is closed or its largest row is smaller than before. A step along curved
    # constraints opens the contacts to second order in its length; it is accepted while they open by less.
    near = jnp.maximum(_NEAR * _length(problem, trial), _CLOSED * length)
    closed = (size < _DONE.of(size)) | ((reach < near) & (size < _SMALL))
    better = closed | (size < search.size) | (search.rolling & (reach < search.length))
    # Where the part along the constraints has not become a tenth shorter, its steps are too long: halve them.
    share = jnp.where(closed & (length > 0.9 * search.length), 0.5 * search.share, search.share)
    move = normal + jnp.where(closed, share, 0.0) * along
    one, count = jnp.ones_like(size), search.count + 1
    known = jnp.where(closed, length, search.length)
    taken = _Search(trial, jacobian, size, move, one, known, share, closed, count)
    left_alone = search._replace(scale=0.25 * search.scale, count=count)
    # A selection, not a branch: in a batch both would be computed anyway. Rows that are NaN are never better.
    return jax.tree.map(lambda new, old: jnp.where(better, new, old), taken, left_alone)


def _length(problem: ClosingProblem, step: Array) -> Array:
    """Length of a displacement in the metric."""
    return jnp.sqrt(step @ problem.metric @ step)


def on_shapes(grasp: Grasp, guess: State) -> State:
    """The guess with every contact's coordinates put onto both of its shapes.

    Coordinates on an implicit surface are a point of space, which a guess may give off the surface.
    """
    places = to_places(guess.s, grasp.form)
    each = zip(grasp.contacts, places, strict=True)
    settled = [contact.onto(grasp.shapes(contact), place) for contact, place in each]
    return State(guess.q, guess.v, stacked(jax.tree.leaves(settled)), guess.memory)


def after_step(grasp: Grasp, guess: State, step: Array, held: tuple[int, ...] = ()) -> tuple[Array, Array]:
    """Positions and contact coordinates after a displacement from a guess.

    The displacement has an entry for each velocity, body by body, then `slack` entries for each contact.
    Where contacts are held, these are missing, and the contacts stay where they are; so are the entries of
    `held` velocities.
    """
    leaves, rest = to_leaves(guess, grasp.form), iter(unstack(step))
    moves = iter([0.0 if i in held else next(rest) for i in range(grasp.coordinates)])
    blocks = tuple(tuple(itertools.islice(moves, size)) for size in grasp.sizes)
    q, places = displaced(grasp, leaves.q, blocks), []
    for contact, place in zip(grasp.contacts, leaves.s, strict=True):
        shift = tuple(itertools.islice(rest, contact.slack))
        places.append(contact.shift(grasp.shapes(contact), place, shift) if shift else place)
    return join(q), stacked(jax.tree.leaves(places))


def constraint_rows(grasp: Grasp, q: Array, s: Array) -> Array:
    """Gap [m] and tangency [rad] of every contact of a prepared grasp; in the plane the shape is (3c,)."""
    frames = world_poses(grasp, split(q, grasp.form.positions))
    each = zip(grasp.contacts, touches(grasp, to_places(s, grasp.form)), strict=True)
    rows = [row for c, t in each for row in c.equations((frames[1 + c.finger], frames[0]), t)]
    return jnp.stack(rows)


def metric_at(grasp: Grasp, guess: State, hold: bool, held: tuple[int, ...] = ()) -> Array:
    """The metric of displacements: the mass matrix at the guess, divided by the mean of its diagonal.

    Where contacts may roll, their coordinates follow with a small weight of 1e-3 each: they should move
    freely beside the poses, but a metric without any weight for them would be singular. Held velocities have
    no rows and columns.
    """
    # At rest: Python's own zeros leave all out that comes with velocities.
    leaves = to_leaves(guess, grasp.form)
    still = Leaves(leaves.q, tuple((0.0,) * size for size in grasp.sizes), leaves.s, leaves.memory)
    with sharing():
        _, inertias = bodies(grasp, still)
        mass = mass_matrix([inertia.mass for inertia in inertias], grasp.coordinates)
    n = grasp.coordinates
    size = n + (0 if hold else sum(contact.slack for contact in grasp.contacts))
    scaled = jnp.pad(mass * (n / jnp.trace(mass)), (0, size - n))
    whole = scaled + np.diag(np.where(np.arange(size) < n, 0.0, 1e-3).astype(scaled.dtype))
    free = [i for i in range(size) if i not in held]
    return whole if len(free) == size else whole[np.ix_(free, free)]
