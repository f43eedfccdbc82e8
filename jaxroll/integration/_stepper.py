"""One step of a diffrax Runge-Kutta method on a grasp, and the return to the constraints.

diffrax supplies the tableaus and runs the loop; its own step is not used for explicit methods, because
sharing the last stage's factorisation with the projection and stopping XLA from recomputing
one stage inside the next is worth a factor of two in a run and four in a batch.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._types import Scalar
from ..mechanics import Grasp, Instant
from ._closed_loop import evaluate, power, project
from ._flow import Bundle, Flow, Layout, pack, unpack
from ._formulation import Formulation, Index1
from ._regime import coded, regime


class RollingStep(diffrax.AbstractAdaptiveSolver):
    """A diffrax solver for the flow vector of a grasp; `args` is the bundled grasp.

    Attributes:
        method: The diffrax method: explicit Runge-Kutta ones are run on their tableau, any
            other one by its own `step`.
        formulation: Projection or stabilisation.
        lay: Layout of the flow vector.
        events: What ends a run, besides the ends of contours and singular contacts.
    """

    method: diffrax.AbstractSolver
    formulation: Formulation
    lay: Layout = eqx.field(static=True)
    events: tuple[str, ...] = eqx.field(static=True)

    term_structure: ClassVar[Any] = diffrax.ODETerm
    # Required by diffrax, never evaluated: save times are step ends.
    interpolation_cls: ClassVar[Any] = diffrax.LocalLinearInterpolation

    def order(self, terms: Any) -> int | None:
        return self.method.order(terms)

    def error_order(self, terms: Any) -> Any:
        return self.method.error_order(terms)

    def func(self, terms: Any, t0: Scalar, y0: Flow, args: Bundle) -> Flow:
        raise NotImplementedError("the first step size is given, never estimated")

    def init(self, terms: Any, t0: Scalar, t1: Scalar, y0: Flow, args: Bundle) -> None:
        return None

    def step(
        self,
        terms: Any,
        t0: Scalar,
        t1: Scalar,
        y0: Flow,
        args: Bundle,
        solver_state: None,
        made_jump: Any,
    ) -> tuple[Flow, Flow, dict[str, Flow], None, diffrax.RESULTS]:
        y1, error = self.advance(args, t0, t1, y0)
        return y1, error, {"y0": y0, "y1": y1}, None, diffrax.RESULTS.successful

    @eqx.filter_jit  # traced once, however often diffrax traces its loop
    def advance(self, bundle: Bundle, t0: Scalar, t1: Scalar, y0: Flow) -> tuple[Flow, Flow]:
        """One step as a pure map: the new vector and its error estimate."""
        hold, grasp = holder(t0), bundle()
        if isinstance(self.method, diffrax.AbstractERK):
            raw, rates, error, instant = self._explicit(bundle, t0, t1, y0, hold)
        else:
            raw, rates, error, instant = self._other(grasp, t0, t1, y0)
        leaves, work = unpack(self.lay, raw)
        if isinstance(self.formulation, Index1):
            leaves = project(grasp, leaves, instant, hold)
        x1 = pack(leaves, work)
        end = coded(x1, *regime(grasp, leaves, instant, self.events))
        y1 = jnp.concatenate([x1, rates, end])
        return y1, jnp.concatenate([error, jnp.zeros(self.lay.width + 2, error.dtype)])

    @eqx.filter_jit
    def drift(self, bundle: Bundle, t: Scalar, y: Flow) -> Flow:
        """Time derivative of the whole flow vector, margin included: what an event's time needs."""
        width = self.lay.width

        def ahead(t: Scalar, x: Array) -> Array:
            grasp, (leaves, _) = bundle(), unpack(self.lay, x)
            rates, instant = self.rates(grasp, t, x)
            return jnp.concatenate([x, rates, coded(x, *regime(grasp, leaves, instant, self.events))])

        return jax.jvp(ahead, (t, y[:width]), (jnp.ones_like(t), y[width : 2 * width]))[1]

    def _explicit(
        self, bundle: Bundle, t0: Scalar, t1: Scalar, y0: Flow, hold: Callable
    ) -> tuple[Array, Array, Array, Instant]:
        tableau = self.method.tableau  # pyright: ignore[reportAttributeAccessIssue]
        dt, width = t1 - t0, self.lay.width
        # The last stage of such a method is the step's end, and is shared with it.
        shared = bool(tableau.fsal and tableau.ssal)
        looped = tableau.num_stages - int(shared)
        rows, times, ends = _tables(tableau, looped, y0.dtype)
        x0, k0 = y0[:width], y0[width : 2 * width]
        cuts = _small_cuts(width, looped)
        blocks = [jnp.zeros((c.stop - c.start, looped), y0.dtype).at[:, 0].set(k0[c]) for c in cuts]

        def mix(blocks: list[Array], weights: Array) -> Array:
            return jnp.concatenate([jnp.sum(block * weights[None, :], axis=1) for block in blocks])

        def stage(i: Scalar, blocks: list[Array]) -> list[Array]:
            weights = jnp.concatenate([columns[i] for columns in rows])
            x = hold(x0 + dt * mix(blocks, weights))
            rates, _ = self.rates(bundle(), t0 + times[i] * dt, x)
            return [b.at[:, i].set(rates[c]) for b, c in zip(blocks, cuts, strict=True)]

        blocks = jax.lax.fori_loop(1, looped, stage, blocks)
        raw = hold(x0 + dt * mix(blocks, ends[0]))
        rates, instant = self.rates(bundle(), t1, raw)
        error = mix(blocks, ends[1])
        if shared:
            error = error + float(tableau.b_error[-1]) * rates
        return raw, rates, dt * error, instant

    def rates(self, grasp: Grasp, t: Scalar, x: Array) -> tuple[Array, Instant]:
        """Time derivative of x, and all else that its evaluation worked out."""
        leaves, _ = unpack(self.lay, x)
        instant = evaluate(grasp, t, leaves, self.formulation)
        gained = power(grasp, t, leaves, instant.motions) if self.lay.audited else None
        return pack(instant.rates, gained), instant

    def _other(self, grasp: Grasp, t0: Scalar, t1: Scalar, y0: Flow) -> tuple[Array, Array, Array, Instant]:
        def field(t: Scalar, x: Array, args: Grasp) -> Array:
            return self.rates(args, t, x)[0]

        terms = diffrax.ODETerm(field)
        x0 = y0[: self.lay.width]
        memory = self.method.init(terms, t0, t1, x0, grasp)
        raw, error, _, _, code = self.method.step(terms, t0, t1, x0, grasp, memory, True)
        rates, instant = self.rates(grasp, t1, raw)
        if error is None:
            error = jnp.zeros_like(raw)
        error = jnp.where(code == diffrax.RESULTS.successful, error, jnp.inf)
        return raw, rates, error, instant


def holder(t: Scalar) -> Callable[[Any], Any]:
    """A function that makes XLA compute its argument once.

    It divides by a one that the compiler cannot see through. XLA's fusion copies cheap producers into
    each consumer, but never a division: without this, projection was 4 times slower in a batch.
    """
    one = jnp.where(jnp.isinf(jax.lax.stop_gradient(t)), 2.0, 1.0).astype(jnp.result_type(t))
    return lambda tree: jax.tree.map(lambda leaf: leaf / one, tree)


# XLA's CPU runtime hands a loop to its thread pool, at some 20 us a turn, as soon as one buffer in it is
# larger than this; a stage costs 1 us.
_SMALL_BUFFER = 512


def _small_cuts(size: int, length: int) -> list[slice]:
    """Cut `size` rows of `length` doubles into blocks that stay small."""
    most = max(1, _SMALL_BUFFER // (8 * length))
    return [slice(i, min(i + most, size)) for i in range(0, size, most)]


def _tables(tableau: diffrax.ButcherTableau, looped: int, dtype: Any) -> tuple[list[Array], Array, Array]:
    """Stage rows in blocks of columns, stage times, and the rows for solution and error."""
    full = np.zeros((tableau.num_stages, tableau.num_stages))
    for i, row in enumerate(tableau.a_lower):
        full[i + 1, : i + 1] = row
    times = np.concatenate([[0.0], tableau.c])
    ends = np.stack([tableau.b_sol[:looped], tableau.b_error[:looped]])
    rows = [full[:looped, cut] for cut in _small_cuts(looped, looped)]
    return (
        [jnp.asarray(r, dtype) for r in rows],
        jnp.asarray(times, dtype),
        jnp.asarray(ends, dtype),
    )
