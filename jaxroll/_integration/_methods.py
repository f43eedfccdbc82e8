"""Which methods and step-size controls of diffrax a run accepts, and how it adapts them.

`check_method` examines what a caller hands in by its structure while a run is traced, and refuses in one
sentence what would not work; calls of a compiled run pay nothing for it. `Steady` and `Seeing` are the
controls that `simulate` uses in place of a caller's own; `_step` asks `on_tableau` and `is_rosenbrock` how to
run a method.
"""

from typing import Any, get_origin

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array

from .._linalg import total
from .._results import shown
from .._types import Scalar
from ._rosenbrock import Rosenbrock
from ._state_vector import Layout

Method = diffrax.AbstractSolver
Controller = diffrax.AbstractStepSizeController


class Steady(diffrax.AbstractStepSizeController):
    """Steps of constant length, but for those cut short by a save time or an event.

    It stands for `diffrax.ConstantStepSize`, which counts steps to place their ends and so cannot be cut
    short.
    """

    def wrap(self, direction: Any) -> "Steady":
        """As it is: time runs forwards."""
        return self

    def init(
        self,
        terms: Any,
        t0: Scalar,
        t1: Scalar,
        y0: Array,
        dt0: Scalar,
        args: Any,
        func: Any,
        error_order: Any,
    ) -> tuple[Scalar, Scalar]:
        """End of the first step, and the state of the control: the length of all steps."""
        return t0 + dt0, dt0

    def adapt_step_size(
        self,
        t0: Scalar,
        t1: Scalar,
        y0: Array,
        y1_candidate: Array,
        args: Any,
        y_error: Array,
        error_order: Any,
        controller_state: Scalar,
    ) -> tuple[Scalar, Scalar, Scalar, bool, Scalar, diffrax.RESULTS]:
        """Every step is accepted, except one whose error is not finite: that ends the run."""
        # `_step` gives an infinite error where implicit equations were not solved, or where the projection
        # carried a contact away. The sum is finite only if all terms are (no reduction: see `weighted_sum`).
        parts = jax.lax.split(y_error, (1,) * y_error.shape[0])
        solved = jnp.isfinite(total(parts))[0]
        results = diffrax.RESULTS
        failed: Any = results.nonlinear_divergence
        code = results.where(solved, results.successful, failed)
        return solved, t1, t1 + controller_state, False, controller_state, code


class Seeing(diffrax.AbstractStepSizeController):
    """A caller's own control of the error, which is shown what the default one sees (`Layout.controlled`).

    Attributes:
        inner: The control.
        lay: Layout of the flow vector.
    """

    inner: Controller
    lay: Layout = eqx.field(static=True)

    def wrap(self, direction: Any) -> "Seeing":
        """Time runs forwards."""
        return Seeing(self.inner.wrap(direction), self.lay)

    def init(
        self,
        terms: Any,
        t0: Scalar,
        t1: Scalar,
        y0: Array,
        dt0: Scalar,
        args: Any,
        func: Any,
        error_order: Any,
    ) -> tuple[Any, Any]:
        """The start of the inner control."""
        return self.inner.init(terms, t0, t1, self.lay.controlled(y0), dt0, args, func, error_order)

    def adapt_step_size(
        self,
        t0: Scalar,
        t1: Scalar,
        y0: Array,
        y1_candidate: Array,
        args: Any,
        y_error: Array,
        error_order: Any,
        controller_state: Any,
    ) -> tuple:
        """The inner control's verdict."""
        before, after, error = (self.lay.controlled(y) for y in (y0, y1_candidate, y_error))
        return self.inner.adapt_step_size(t0, t1, before, after, args, error, error_order, controller_state)


def on_tableau(method: Method) -> bool:
    """Whether a method is explicit Runge-Kutta with diffrax's own `step`: then its tableau says all.

    By class, not by instance: diffrax's wrappers claim to be instances of what they wrap.
    """
    explicit = issubclass(type(method), diffrax.AbstractERK)
    return explicit and type(method).step is diffrax.AbstractRungeKutta.step


def is_rosenbrock(method: Method) -> bool:
    """Whether a method is `Rosenbrock` itself."""
    return issubclass(type(method), Rosenbrock) and type(method).step is Rosenbrock.step


def without_checkpoints(method: Any) -> Any:
    """The method with a plain loop over its stages; diffrax's own loop has a derivative only backwards."""
    if issubclass(type(method), diffrax.AbstractWrappedSolver):
        return eqx.tree_at(lambda m: m.solver, method, without_checkpoints(method.solver))
    if getattr(method, "scan_kind", "lax") is not None:
        return method
    return eqx.tree_at(lambda m: m.scan_kind, method, "lax", is_leaf=lambda x: x is None)


def with_tolerances(method: Any, rtol: Any, atol: Any) -> Any:
    """The method, with the run's tolerances for a root finder that has none of its own."""
    if issubclass(type(method), diffrax.AbstractWrappedSolver):
        inner = with_tolerances(method.solver, rtol, atol)
        return eqx.tree_at(lambda m: m.solver, method, inner)
    finder = getattr(method, "root_finder", None)
    if finder is None:
        return method
    given = {"rtol": rtol, "atol": atol, "norm": optimistix.max_norm}
    free = _free(finder)
    if not free:
        return method
    where = lambda m: [getattr(m.root_finder, n) for n in free]  # noqa: E731
    return eqx.tree_at(where, method, [given[n] for n in free])


def waits_for_tolerances(method: Any) -> bool:
    """Whether the root finder of a method, or of one inside of it, has a tolerance to be set by a run."""
    if issubclass(type(method), diffrax.AbstractWrappedSolver):
        return waits_for_tolerances(method.solver)
    finder = getattr(method, "root_finder", None)
    return finder is not None and bool(_free(finder))


def _free(finder: Any) -> list[str]:
    """Names of a root finder's settings that are to be taken from elsewhere.

    diffrax marks these by an object that is neither number nor function.
    """
    return [name for name in ("rtol", "atol", "norm") if not _is_set(getattr(finder, name, 0.0))]


def _is_set(value: Any) -> bool:
    """Whether a root finder's setting is a number or a function, not diffrax's mark for one to be set."""
    return callable(value) or eqx.is_array_like(value)


def check_method(method: Method, controller: Controller, y0: Array) -> None:
    """Raise unless a method makes one step of y' = f(t, y) and says how wrong it is, if that is asked for."""
    steady = isinstance(controller, Steady)
    try:
        fault = _fault(method, y0, steady)
    except Exception as error:  # a caller's own method may fail in any way
        told = " ".join(str(error).split()) or type(error).__name__
        fault = f"make a step of one ordinary differential equation without a failure ({shown(told)})"
    if fault:
        raise ValueError(f"argument solver must {fault}, but was a {type(method).__name__}")


def _fault(method: Any, y0: Array, steady: bool) -> str | None:
    """What a method would have to do and does not, as the message words it; None if all is well."""
    structure = get_origin(method.term_structure) or method.term_structure
    if not (isinstance(structure, type) and issubclass(diffrax.ODETerm, structure)):
        return "take one ordinary differential equation, neither split into parts nor driven by noise"
    if on_tableau(method):
        table = method.tableau
        if not isinstance(table, diffrax.ButcherTableau) or table.implicit or table.c1 != 0.0:
            return "have an explicit tableau that begins at the start of a step"
        estimates = bool(np.any(table.b_error))
    else:
        memory, estimates = _tried(method, y0)
        if memory:
            return "remember nothing of earlier steps, each of which ends with a return to the constraints"
    if steady:
        return None
    if not estimates:
        return (
            "estimate its error, as diffrax.HalfSolver makes any method do, unless stepsize_controller is "
            "diffrax.ConstantStepSize()"
        )
    order = method.error_order(diffrax.ODETerm(_decay))
    return None if order is not None else "say of what order its error estimate is"


def _tried(method: Any, y0: Array) -> tuple[bool, bool]:
    """Whether a method remembers earlier steps, and whether it estimates its error.

    By tracing one step for shapes alone: nothing is computed.
    """
    terms, base = diffrax.ODETerm(_decay), method
    while issubclass(type(base), diffrax.AbstractWrappedSolver):
        base = base.solver

    def step(t0: Array, y0: Array) -> tuple[Any, Any, Array, Any]:
        memory, own = (m.init(terms, t0, t0 + 1.0, y0, None) for m in (method, base))
        y1, error, *_ = method.step(terms, t0, t0 + 1.0, y0, None, memory, True)
        return memory, own, y1, error

    t0 = jax.ShapeDtypeStruct((), y0.dtype)
    like = jax.ShapeDtypeStruct(y0.shape, y0.dtype)
    memory, own, y1, error = eqx.filter_eval_shape(step, t0, like)
    for found in (y1, y1 if error is None else error):
        if jax.tree.structure(found) != jax.tree.structure(like) or found.shape != like.shape:
            raise ValueError(f"a step of shape {jax.tree.map(jnp.shape, found)} for {like.shape}")
    # What a Runge-Kutta method keeps is the last derivative, which a step can compute anew. Whatever a
    # wrapper keeps beyond that is memory.
    kept = type(base).step is diffrax.AbstractRungeKutta.step
    forgetful = jax.tree.structure(memory) == jax.tree.structure(own) if kept else not jax.tree.leaves(memory)
    return not forgetful, error is not None


def _decay(t: Any, y: Array, args: Any) -> Array:
    """A vector field to try methods on: y' = -y."""
    return -y
