r"""A closed state as a function of grasp and guess, and its derivative by the implicit function theorem.

`_search` finds the displacement from the guess that closes the contacts and is shortest in the metric. With
the multipliers of the rows it is a vector $z$ at which a Lagrangian $L(z; m)$ is stationary, $m$ being all
floating-point numbers of grasp and guess: $L_z(z(m); m) = 0$. Differentiated in $m$, this gives

$$ \dot z = -L_{zz}^{-1} L_{zm} \dot m \quad \text{(tangents)}, \qquad
   \bar m = \nabla_m (w \cdot L_z), \; w = -L_{zz}^{-1} \bar z \quad \text{(cotangents)}. $$

The closed state is a function of $m$ and the displacement (`_ending`), which adds its own derivatives. Where
there are as many rows as unknowns, the rows $c(z; m) = 0$ stand in for $L_z = 0$: there is nothing to
minimise, and the matrix is their Jacobian. The iterations of the search are not differentiated. `close` calls
`settled`.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import lu_factor, lu_solve
from jaxtyping import Array

from .._linalg import factorise
from .._mechanics import Grasp, join, State, to_leaves
from .._motion import bodies, compatible, linearise, touches
from .._xla import differentiable_once, linear_map, one_kernel, perturbed, shared, sharing, traced_once
from ._search import added, after_step, ClosingProblem, constraint_rows, metric_at, searched, solve_schur


def settled(
    grasp: Grasp, guess: State, hold: bool, *, resting: bool, held: tuple[int, ...] = ()
) -> tuple[State, Array]:
    """The closed state nearest to a guess, and its constraint rows: gaps [m] and tangencies [rad].

    Args:
        grasp: A prepared grasp.
        guess: Where to start, its contacts on their shapes.
        hold: Whether contacts stay where the guess puts them.
        resting: Whether all velocities are known to be zero, and so stay zero: then the program has no part
            that makes them compatible, which in space is nearly half of it.
        held: Indices of the velocities whose positions stay.

    The state is differentiable in both modes, but only once; the rows count as constant.
    """
    return _settled(grasp, guess, hold, resting, held)


@eqx.filter_custom_jvp
def _settled(
    grasp: Grasp, guess: State, hold: bool, resting: bool, held: tuple[int, ...]
) -> tuple[State, Array]:
    """`settled`, with the derivative below in place of that of its iterations."""
    return _found(grasp, guess, hold, resting=resting, held=held)[0]


@_settled.def_jvp
def _settled_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    """The closed state and its tangent, as a linear map that knows its own transpose for reverse mode."""
    # `moving` is m: the arrays that a derivative is asked in. `still` is all else.
    (*shapes, hold, resting, held) = primals
    moving, still, dots = perturbed(tuple(shapes), tuple(tangents[:2]))
    # Second derivatives would need derivatives of the matrix L_zz as well: refuse instead of being wrong.
    moving, still = differentiable_once((moving, still), "a closed state")
    grasp, guess = eqx.combine(moving, still)
    out, minimum = _found(grasp, guess, hold, resting=resting, held=held)
    response = _response(_Question(still, hold, resting, held), moving, minimum)
    return out, (linear_map(_Response.tangents, _Response.cotangents, response, dots, like=out[0]), None)


class _Minimum(NamedTuple):
    """Displacement to the closed state, the metric in which it is shortest, and the rows' Jacobian there."""

    step: Array
    metric: Array
    jacobian: Array


@traced_once
def _found(
    grasp: Grasp, guess: State, hold: bool, *, resting: bool, held: tuple[int, ...]
) -> tuple[tuple[State, Array], _Minimum]:
    """The closed state with its rows, and the minimum that the derivative needs."""
    metric = one_kernel(metric_at, grasp, guess, hold, held)
    step, jacobian = searched(ClosingProblem(grasp, guess, metric, held))
    return one_kernel(_ended, grasp, guess, step, resting, held), _Minimum(step, metric, jacobian)


class _Question(eqx.Module):
    """The closing problem as a function of the differentiable arrays of grasp and guess, `moving`.

    Attributes:
        still: Grasp and guess without these arrays.
        hold: Whether contacts stay where the guess puts them.
        resting: Whether all velocities are known to be zero.
        held: Indices of the velocities whose positions stay.
    """

    still: Any
    hold: bool = eqx.field(static=True)
    resting: bool = eqx.field(static=True)
    held: tuple[int, ...] = eqx.field(static=True)

    def problem(self, moving: Any) -> ClosingProblem:
        """The search's problem; its metric depends on the arrays too, and is differentiated with them."""
        grasp, guess = eqx.combine(moving, self.still)
        metric = metric_at(grasp, guess, self.hold, self.held)
        return ClosingProblem(grasp, guess, metric, self.held)

    def ending(self, moving: Any, step: Array) -> State:
        """The closed state after a displacement from the guess."""
        grasp, guess = eqx.combine(moving, self.still)
        return _ending(grasp, guess, step, resting=self.resting, held=self.held)


class _Response(eqx.Module):
    """The linear map from small changes of grasp and guess to those of the closed state, and its transpose.

    Attributes:
        question: The problem as a function of the arrays that change.
        moving: These arrays.
        z: Displacement and multipliers of the rows; where `square`, the displacement alone.
        slopes: Second derivative of the Lagrangian in z; where `square`, the Jacobian of the rows.
        added: What makes `slopes` invertible where rows are redundant, on its diagonal; None where `square`.
        size: Length of the displacement.
    """

    question: _Question
    moving: Any
    z: Array
    slopes: Array
    added: Array | None
    size: int = eqx.field(static=True)

    def tangents(self, dots: Any) -> State:
        """Tangent of the closed state, from tangents `dots` of the arrays."""
        change = one_kernel(_misfit, self, dots)
        step = -self._solved(change)[: self.size]
        return one_kernel(_carried, self, dots, step)

    def cotangents(self, bars: State) -> Any:
        """Cotangents of the arrays, from the cotangent `bars` of the closed state."""
        direct, step = one_kernel(_ending_pulled, self, bars)
        # The state depends on the displacement alone: the cotangents of the multipliers are zero.
        wide = jnp.pad(step, (0, self.slopes.shape[0] - self.size))
        turned = one_kernel(_conditions_pulled, self, -self._solved(wide, transposed=True))
        return jax.tree.map(jnp.add, direct, turned)

    def _solved(self, right: Array, *, transposed: bool = False) -> Array:
        """`right` over the matrix, or over its transpose."""
        matrix = self.slopes.T if transposed else self.slopes
        if self.added is None:
            return jnp.linalg.solve(matrix, right)
        # Redundant rows, as of parallel plates, leave their multipliers open, and nothing else. As in the
        # search one step of iterative refinement reduces the error of what is added.
        factors = lu_factor(matrix - jnp.diag(self.added))
        first = lu_solve(factors, right)
        return first + lu_solve(factors, right - matrix @ first)

    @property
    def step(self) -> Array:
        """The displacement from the guess."""
        return self.z[: self.size]

    @property
    def square(self) -> bool:
        """Whether the rows alone determine the step."""
        return self.slopes.shape[0] == self.size


def _response(question: _Question, moving: Any, minimum: _Minimum) -> _Response:
    """The linear map at a minimum, with its matrix."""
    step, metric, jacobian = minimum
    size = step.shape[0]
    if size == jacobian.shape[0]:
        return _Response(question, moving, step, jacobian, None, size)
    # The search does not compute multipliers. From M d + A^T p = 0, multiplied by A M^-1: S p = -A d.
    pressures, _, _ = solve_schur(jacobian, metric, -(jacobian @ step)[:, None])
    z = jnp.concatenate([step, pressures[:, 0]])
    grasp, guess = eqx.combine(moving, question.still)
    problem = ClosingProblem(grasp, guess, metric, question.held)
    slopes = one_kernel(ClosingProblem.slopes, problem, z, jacobian)
    small = jnp.concatenate([jnp.zeros_like(step), added(jacobian, metric)])
    return _Response(question, moving, z, slopes, small, size)


def _misfit(response: _Response, dots: Any) -> Array:
    r"""$L_{zm} \dot m$: change of the conditions of the minimum at fixed z, under tangents of the arrays."""

    def conditions(moving: Any) -> Array:
        problem = response.question.problem(moving)
        return problem.rows(response.z) if response.square else jax.grad(problem.lagrangian)(response.z)

    return jax.jvp(conditions, (response.moving,), (dots,))[1]


def _carried(response: _Response, dots: Any, step: Array) -> State:
    """Tangent of the closed state, from tangents of the arrays and of the displacement."""
    return jax.jvp(response.question.ending, (response.moving, response.step), (dots, step))[1]


def _ending_pulled(response: _Response, bars: State) -> tuple[Any, Array]:
    """Cotangents of the arrays and of the displacement, from that of the closed state."""
    back = lambda moving, step, bars: jax.vjp(response.question.ending, moving, step)[1](bars)  # noqa: E731
    return shared(back)(response.moving, response.step, bars)


def _conditions_pulled(response: _Response, w: Array) -> Any:
    r"""$\nabla_m (w \cdot L_z)$: cotangents of the arrays, from that of the conditions of the minimum."""

    def weighed(moving: Any, z: Array, w: Array) -> Array:
        problem = response.question.problem(moving)
        if response.square:
            return jnp.sum(w * problem.rows(z))
        # w . L_z is the derivative of L along w: forwards in z inside, backwards in m outside.
        return jax.jvp(problem.lagrangian, (z,), (w,))[1]

    return shared(jax.grad(weighed))(response.moving, response.z, w)


def _ending(grasp: Grasp, guess: State, step: Array, *, resting: bool, held: tuple[int, ...]) -> State:
    """The guess after a displacement, its velocities projected onto $A v = 0$ in the mass metric."""
    with sharing():
        q, s = after_step(grasp, guess, step, held)
        if resting:
            return State(q, guess.v, s, guess.memory)
        leaves = to_leaves(State(q, guess.v, s), grasp.form)
        motions, inertias = bodies(grasp, leaves)
        masses = [factorise(inertia.mass) for inertia in inertias]
        line = linearise(grasp, motions, masses, touches(grasp, leaves.s))
        return State(q, join(compatible(grasp, leaves, line).v), s, guess.memory)


def _ended(
    grasp: Grasp, guess: State, step: Array, resting: bool, held: tuple[int, ...]
) -> tuple[State, Array]:
    """The same, and its constraint rows."""
    state = _ending(grasp, guess, step, resting=resting, held=held)
    return state, constraint_rows(grasp, state.q, state.s)
