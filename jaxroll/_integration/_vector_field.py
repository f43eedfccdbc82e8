r"""The equations of motion of a grasp for diffrax itself: terms, start and projection for `diffeqsolve`.

`simulate` runs the methods of diffrax in a loop of its own, because one kernel for a whole run is several
times as fast. This module is for what only `diffeqsolve` has: `SaveAt` with functions, its adjoints,
events of one's own. The equations are the same,

$$ y' = (\dot q, \dot v, \dot s), \quad M \dot v + h = u + A^T \mu, \quad A \dot v + \dot A v = 0 $$

of `_motion`, and so is the return to the constraints after every step, by a method that wraps another one
(`_projected_method`).
"""

from collections.abc import Collection
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._mechanics import check_grasp, check_states, Grasp, Leaves, State, tabled_grasp
from .._motion import (
    anchor_of,
    as_formulation,
    begun,
    check_rolling,
    check_tasks,
    closed_within,
    evaluate,
    Formulation,
    Index1,
    Instant,
    residuals,
    worst,
)
from .._printing import listed
from .._results import check_instance, computed_at_once, shown, traced
from .._types import Scalar
from .._xla import without_derivative
from ..commands import Declared, Steps
from ..loads import impulses
from ._arguments import check_choices, SWEEPS, unclosed
from ._events import OF_FORCES, regime
from ._methods import check_method, Steady, waits_for_tolerances, with_tolerances
from ._projected_method import Projected
from ._state_vector import Layout, layout, slope, states_of, unpack, vector_of
from ._step import returned

Y = Float[Array, " y"]


class VectorField(eqx.Module):
    r"""The equations of motion of a grasp, for `diffrax.diffeqsolve`; made by `vector_field`.

    What is integrated is one array $y = (q, v, s)$, with a controller's memory behind it if it has one. The
    field is a pytree: derivatives with respect to the grasp go through `terms`.
    """

    __repr__ = listed

    grasp: Grasp
    formulation: Formulation
    events: tuple[str, ...] = eqx.field(static=True)
    _lay: Layout = eqx.field(static=True)

    @property
    def terms(self) -> diffrax.ODETerm[Any]:
        """$y' = f(t, y)$, for `terms` of `diffeqsolve`; its `args` are not looked at."""
        return diffrax.ODETerm(self)

    @property
    def jumps(self) -> Float[Array, " k"]:
        """Times [s] that commands and loads declare: `jump_ts` of `diffrax.ClipStepSizeController`."""
        times = [jnp.asarray(each, float) for each in self.grasp.jumps]
        return jax.lax.stop_gradient(jnp.sort(jnp.concatenate([jnp.zeros(0), *times])))

    def __call__(self, t: Scalar, y: Y, args: Any = None) -> Y:
        """Time derivative of $y$ [1/s of its units]."""
        self._check(y)
        grasp = _held_jumps(self.grasp) if self.grasp.jumps else self.grasp
        return slope(self._lay, grasp, jnp.asarray(t, y.dtype), y, formulation=self.formulation)[0]

    def start(self, state: State) -> Y:
        """$y$ of a state on the constraints, as `close` returns it: `y0` of `diffeqsolve`.

        Raises:
            ValueError: If the state does not fit the grasp, or is off the constraints where these are not
                stabilised.
        """
        check_states(self.grasp, state)
        if isinstance(self.formulation, Index1) and not traced((self.grasp, state)):
            with computed_at_once():
                off = np.asarray(worst(residuals(self.grasp, state)))
            if not off <= closed_within(off.dtype):
                raise ValueError(unclosed(off))
        if self.grasp.own_contacts:
            check_rolling(self.grasp, state)
        if self._lay.form.memory:
            check_tasks(self.grasp, state)
            state = begun(self.grasp, state, jnp.zeros((), state.q.dtype))
        return vector_in(self, state)

    def states(self, ys: Float[Array, "... y"]) -> State:
        """The states of solutions $y$ along any leading axes: of `solution.ys`, or of `evaluate(t)`."""
        self._check(ys)
        return states_of(self._lay, ys)

    def project(self, t: Scalar, y: Y) -> Y:
        """The nearest $y$, in the mass metric, with every gap, tangency and rate of a gap at zero.

        From a step's error away: two Newton steps with one Jacobian leave the third power of it.
        """
        if not isinstance(self.formulation, Index1):
            return y
        # One more evaluation, at y, which `simulate` has from the last stage of a step.
        leaves, instant = self._at(t, y)
        return returned(self._lay, self.grasp, y, anchor_of(instant), sweeps=SWEEPS)

    def projected(self, solver: diffrax.AbstractSolver[Any] | None = None) -> Projected:
        """A method of diffrax that projects after every step; None: `diffrax.Dopri8()`.

        An implicit method takes the tolerances of an adaptive step-size control. For constant steps, where
        diffrax raises an error else, its root finder has to have its own, as in
        `diffrax.ImplicitEuler(root_finder=diffrax.VeryChord(1e-8, 1e-8))`.

        Raises:
            ValueError: If `solver` does not solve one ordinary differential equation step by step, as methods
                for stochastic or split equations do not, nor those that remember earlier steps; or if it
                wraps an implicit method whose root finder has no tolerances, which diffrax cannot give it.
        """
        solver = diffrax.Dopri8() if solver is None else solver
        check_instance("solver", solver, diffrax.AbstractSolver, "a diffrax solver")
        # diffrax gives a method its control's tolerances, but none that is inside of another.
        if issubclass(type(solver), diffrax.AbstractWrappedSolver) and waits_for_tolerances(solver):
            raise ValueError(
                f"argument solver must have a root finder with tolerances of its own, such as "
                f"diffrax.VeryChord(1e-8, 1e-8), in what it wraps, but was {shown(solver)}"
            )
        # Tolerances are diffrax's affair; any will do for the check. `Steady` asks for no error estimate.
        check_method(with_tolerances(solver, 1e-6, 1e-6), Steady(), jnp.zeros(self._lay.width))
        return Projected(solver, self.project, self._lay.width)

    def margin(self, t: Scalar, y: Y, args: Any = None, **others: Any) -> Scalar:
        """How far the model still holds, positive while it does: `cond_fn` of `diffrax.Event`.

        The smallest of forces [N], distances to ends [m], relative curvatures, and what joints have left of
        range [rad or m] and torque [N m or N], as for `simulate`.
        """
        leaves, instant = self._at(t, y)
        return jnp.asarray(regime(self.grasp, leaves, instant, self.events)[0], y.dtype)

    def _check(self, y: Any) -> None:
        """Raise unless this is an array whose last axis holds what is integrated."""
        shape = getattr(y, "shape", ())
        if shape[-1:] != (self._lay.width,):
            raise ValueError(
                f"argument y must hold {self._lay.width} numbers along its last axis, but was {shown(y)}"
            )

    def _at(self, t: Scalar, y: Y) -> tuple[Leaves, Instant]:
        """The state of y as scalars, and the equations of motion evaluated there."""
        self._check(y)
        leaves, _ = unpack(self._lay, y)
        return leaves, evaluate(self.grasp, jnp.asarray(t, y.dtype), leaves, self.formulation)


def vector_in(field: VectorField, state: State) -> Y:
    """$y$ of a state as it is, with a memory where the controller has one."""
    return vector_of(field._lay, state)[: field._lay.width]


def vector_field(
    grasp: Grasp, *, formulation: Formulation | None = None, events: tuple[str, ...] = ("lift", "friction")
) -> VectorField:
    r"""The equations of motion of a grasp as terms, start and projection for `diffrax.diffeqsolve`.

    For what `simulate` has not: `SaveAt` with functions and steps, diffrax's adjoints, events
    and controls of your own. A run costs some eight times what one of `simulate` does, which is one kernel
    (`python -m benchmarks.door`).

    Args:
        grasp: The grasp; every array in it is differentiable.
        formulation: `Index1()` (default), whose steps are to be projected, or `CSM(...)`, whose are not.
        events: What `margin` watches besides contour ends, singular contacts and the limits of joints:
            'lift', 'friction'.

    Returns:
        A `VectorField`: `terms`, `start(state)`, `projected(solver)`, `margin` and `states(ys)`.

    Raises:
        ValueError: If an argument does not fit, or the grasp has what `diffeqsolve` cannot give it: a sampled
            controller, or blows (`loads.Impulse`).

    Declared jumps: diffrax's steps do not end at them by themselves, and may pass over a short push. Give
    them to it, as `stepsize_controller=diffrax.ClipStepSizeController(control, jump_ts=field.jumps)`.

    Accuracy: that of the method and the tolerances given; constraint rows at rounding after every step, and
    between steps, in dense output, at the method's error.
    Gradients: `ForwardMode` goes through the steps; so does, backwards, with n the `max_steps` of the run,
    `RecursiveCheckpointAdjoint(checkpoints=n)`. Fewer, as by default, and `DirectAdjoint` are for steps of
    given lengths alone: they take steps again on the way back, and rounding, which is all the error estimate
    of the first ones, gives these another length. What diffrax 0.7.2 returns is silently off then, of some
    runs by a hundredth.
    `BacksolveAdjoint` fails, with a sentence where the start is differentiated, else with diffrax's own.
    In times of `commands.Steps` and `Declared` a derivative is refused: only `simulate` carries it.

    Example:
        >>> import diffrax
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> field = jxr.vector_field(grasp)
        >>> solution = diffrax.diffeqsolve(
        ...     field.terms, field.projected(), 0.0, 3.0, 1e-4, field.start(state),
        ...     stepsize_controller=diffrax.PIDController(rtol=1e-8, atol=1e-8),
        ...     saveat=diffrax.SaveAt(dense=True),
        ... )
        >>> turned = field.states(solution.evaluate(3.0)).q[0] - state.q[0]
        >>> f"{turned:.3f} rad"
        '0.772 rad'
    """
    check_grasp(grasp)
    if grasp.form.sampled:
        raise ValueError(
            f"argument grasp must not have a sampled controller, which only `simulate` asks at its samples, "
            f"but was driven by {shown(grasp.controller)}"
        )
    if blows := impulses(grasp.load):
        raise ValueError(
            f"argument grasp must have no blows, which only `simulate` deals between two steps, "
            f"but had {shown(blows[0])}"
        )
    return held_field(grasp, formulation, events)


def held_field(grasp: Grasp, formulation: Formulation | None, events: Collection[str]) -> VectorField:
    """The same of any grasp: torques of a sampled controller stay as the state has them."""
    watched = check_choices("events", events, OF_FORCES)
    way, ready = as_formulation(grasp, formulation), tabled_grasp(grasp).prepared()
    return VectorField(ready, way, watched, layout(grasp, False))


def _held_jumps(grasp: Grasp) -> Grasp:
    """The grasp, with times at which numbers jump that refuse a derivative: it would be zero."""

    def held(part: Any) -> Any:
        if not jumping(part):
            return part
        times = (lambda p: p.times) if isinstance(part, Steps) else (lambda p: p.jumps)
        told = "a vector field has no derivatives in the times of jumps: `simulate` has them"
        return eqx.tree_at(times, part, without_derivative(times(part), told))

    jumping = lambda part: isinstance(part, Steps | Declared)  # noqa: E731
    return jax.tree.map(held, grasp, is_leaf=jumping)
