r"""A closed state as a function of grasp and guess, and its derivative by the implicit function theorem.

The step z from the guess, with the multipliers of the rows, makes a Lagrangian $L(z; m)$ stationary, m being
all numbers of grasp and guess. So $\dot z = -L_{zz}^{-1} L_{zm} \dot m$; backwards, with
$w = -L_{zz}^{-1} \bar z$, the cotangent is the gradient in m of the slope of L along w. Each is one kernel.
"""

from typing import Any, NamedTuple

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._linalg import factorise
from .._mechanics import Grasp, join, State, to_leaves
from .._motion import bodies, compatible, linearise, touches
from .._xla import filled, linear_map, one_kernel, shared, sharing
from ._search import after_step, ClosingProblem, constraint_rows, metric_at, searched, solve_schur


def settled(grasp: Grasp, guess: State, hold: bool, *, resting: bool) -> tuple[State, Array]:
    """The closed state nearest to a guess, and what the constraints leave over.

    Args:
        grasp: A prepared grasp.
        guess: Where to start, its contacts on their shapes.
        hold: Whether contacts stay where the guess puts them.
        resting: Whether all velocities are known to be zero, and so stay zero: then the program has no part
            that makes them compatible, which is two fifths of it.

    The state is differentiable in both modes, once; what is left over counts as constant.
    """
    return _settled(grasp, guess, hold, resting)


@eqx.filter_custom_jvp
def _settled(grasp: Grasp, guess: State, hold: bool, resting: bool) -> tuple[State, Array]:
    return _found(grasp, guess, hold, resting=resting)[0]


@_settled.def_jvp
def _settled_jvp(primals: Any, tangents: Any) -> tuple[Any, Any]:
    (*shapes, hold, resting) = primals
    moving, still = eqx.partition(tuple(shapes), eqx.is_inexact_array)
    moving = eqxi.nondifferentiable(moving, name="a closed state (second derivatives)")
    grasp, guess = eqx.combine(moving, still)
    out, minimum = _found(grasp, guess, hold, resting=resting)
    response = _response(_Question(still, hold, resting), moving, minimum)
    dots = filled(moving, tangents[:2])
    return out, (linear_map(_Response.tangents, _Response.cotangents, response, dots, like=out[0]), None)


class _Minimum(NamedTuple):
    """The step to the closed state, the metric it is shortest in, and the Jacobian of the rows there."""

    step: Array
    metric: Array
    jacobian: Array


def _found(
    grasp: Grasp, guess: State, hold: bool, *, resting: bool
) -> tuple[tuple[State, Array], _Minimum]:
    metric = one_kernel(metric_at, grasp, guess, hold)
    step, jacobian = searched(ClosingProblem(grasp, guess, metric))
    return one_kernel(_ended, grasp, guess, step, resting), _Minimum(step, metric, jacobian)


class _Question(eqx.Module):
    """All that is asked of the numbers of a grasp and a guess but themselves."""

    still: Any
    hold: bool = eqx.field(static=True)
    resting: bool = eqx.field(static=True)

    def problem(self, moving: Any) -> ClosingProblem:
        grasp, guess = eqx.combine(moving, self.still)
        return ClosingProblem(grasp, guess, metric_at(grasp, guess, self.hold))

    def ending(self, moving: Any, step: Array) -> State:
        grasp, guess = eqx.combine(moving, self.still)
        return _ending(grasp, guess, step, resting=self.resting)


class _Response(eqx.Module):
    """How a closed state answers small changes of its grasp and guess.

    Attributes:
        slopes: Second derivative of the Lagrangian; with nothing left to minimise, the rows' Jacobian.
    """

    question: _Question
    moving: Any
    z: Array
    slopes: Array
    size: int = eqx.field(static=True)

    def tangents(self, dots: Any) -> State:
        change = one_kernel(_misfit, self, dots)
        step = -jnp.linalg.solve(self.slopes, change)[: self.size]
        return one_kernel(_carried, self, dots, step)

    def cotangents(self, bars: State) -> Any:
        direct, step = one_kernel(_ending_pulled, self, bars)
        wide = jnp.pad(step, (0, self.slopes.shape[0] - self.size))
        turned = one_kernel(_conditions_pulled, self, -jnp.linalg.solve(self.slopes.T, wide))
        return jax.tree.map(jnp.add, direct, turned)

    @property
    def step(self) -> Array:
        return self.z[: self.size]

    @property
    def square(self) -> bool:
        """Whether the rows alone determine the step."""
        return self.slopes.shape[0] == self.size


def _response(question: _Question, moving: Any, minimum: _Minimum) -> _Response:
    step, metric, jacobian = minimum
    size = step.shape[0]
    if size == jacobian.shape[0]:
        return _Response(question, moving, step, jacobian, size)
    pressures, _ = solve_schur(jacobian, metric, -(jacobian @ step)[:, None])
    z = jnp.concatenate([step, pressures[:, 0]])
    grasp, guess = eqx.combine(moving, question.still)
    problem = ClosingProblem(grasp, guess, metric)
    return _Response(question, moving, z, one_kernel(ClosingProblem.slopes, problem, z), size)


def _misfit(response: _Response, dots: Any) -> Array:
    """Change of the conditions of the minimum at a fixed step."""

    def conditions(moving: Any) -> Array:
        problem = response.question.problem(moving)
        return problem.rows(response.z) if response.square else jax.grad(problem.lagrangian)(response.z)

    return jax.jvp(conditions, (response.moving,), (dots,))[1]


def _carried(response: _Response, dots: Any, step: Array) -> State:
    return jax.jvp(response.question.ending, (response.moving, response.step), (dots, step))[1]


def _ending_pulled(response: _Response, bars: State) -> tuple[Any, Array]:
    """Cotangents of all that moves, and of the step, from those of the state."""
    back = lambda moving, step, bars: jax.vjp(response.question.ending, moving, step)[1](bars)  # noqa: E731
    return shared(back)(response.moving, response.step, bars)


def _conditions_pulled(response: _Response, w: Array) -> Any:
    """Cotangent of all that moves, from that of the conditions of the minimum."""

    def weighed(moving: Any, z: Array, w: Array) -> Array:
        problem = response.question.problem(moving)
        if response.square:
            return jnp.sum(w * problem.rows(z))
        return jax.jvp(problem.lagrangian, (z,), (w,))[1]

    return shared(jax.grad(weighed))(response.moving, response.z, w)


def _ending(grasp: Grasp, guess: State, step: Array, *, resting: bool) -> State:
    """The state after a step, its velocities projected onto $A v = 0$ in the mass metric."""
    with sharing():
        q, s = after_step(grasp, guess, step)
        if resting:
            return State(q, guess.v, s)
        leaves = to_leaves(State(q, guess.v, s), grasp.form)
        motions, inertias = bodies(grasp, leaves)
        masses = [factorise(inertia.mass) for inertia in inertias]
        line = linearise(grasp, motions, masses, touches(grasp, leaves.s))
        return State(q, join(compatible(grasp, leaves, line).v), s)


def _ended(grasp: Grasp, guess: State, step: Array, resting: bool) -> tuple[State, Array]:
    """The same with what the constraints leave over: one kernel that feeds another breaks XLA in a batch."""
    state = _ending(grasp, guess, step, resting=resting)
    return state, constraint_rows(grasp, state.q, state.s)
