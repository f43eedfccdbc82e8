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

from .._algebra import once, sharing
from .._types import Scalar
from ..mechanics import Grasp, Instant, unknown_line
from ._closed_loop import Anchor, anchor_of, compatible, evaluate, power, settle
from ._flow import Bundle, Flow, Layout, pack, unpack
from ._formulation import Formulation, Index1
from ._regime import coded, regime, with_clearance


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
        with sharing(t0):
            return self._advance(bundle, t0, t1, y0)

    def _advance(self, bundle: Bundle, t0: Scalar, t1: Scalar, y0: Flow) -> tuple[Flow, Flow]:
        grasp = bundle()
        way = self._explicit if isinstance(self.method, diffrax.AbstractERK) else self._other
        raw, rates, error, end = way(bundle, t0, t1, y0)
        x1 = self._return(grasp, raw, end.anchor) if isinstance(self.formulation, Index1) else raw
        leaves, _ = unpack(self.lay, x1)
        tail = coded(x1, *with_clearance(grasp, leaves, (end.margin, end.number), self.events))
        y1 = jnp.concatenate([x1, rates, tail])
        return y1, jnp.concatenate([error, jnp.zeros(self.lay.width + 2, error.dtype)])

    def _return(self, grasp: Grasp, raw: Array, anchor: Anchor) -> Array:
        """Back onto the constraints, positions before velocities."""

        def sweep(_: Scalar, x: Array) -> Array:
            leaves, work = unpack(self.lay, x)
            return once(pack(settle(grasp, leaves, anchor), work))

        leaves, work = unpack(self.lay, jax.lax.fori_loop(0, _SWEEPS, sweep, raw))
        return pack(compatible(grasp, leaves, anchor.line), work)

    @eqx.filter_jit
    def drift(self, bundle: Bundle, t: Scalar, y: Flow) -> Flow:
        """Time derivative of the whole flow vector, margin included: what an event's time needs."""
        width = self.lay.width

        def ahead(t: Scalar, x: Array) -> Array:
            grasp, (leaves, _) = bundle(), unpack(self.lay, x)
            rates, end = self._at(grasp, t, x)
            tail = with_clearance(grasp, leaves, (end.margin, end.number), self.events)
            return jnp.concatenate([x, rates, coded(x, *tail)])

        with sharing(t):
            return jax.jvp(ahead, (t, y[:width]), (jnp.ones_like(t), y[width : 2 * width]))[1]

    def _explicit(
        self, bundle: Bundle, t0: Scalar, t1: Scalar, y0: Flow
    ) -> tuple[Array, Array, Array, "Ending"]:
        """All stages and the step's end in one loop, so that the equations are compiled once."""
        tableau = self.method.tableau  # pyright: ignore[reportAttributeAccessIssue]
        dt, width = t1 - t0, self.lay.width
        rows, times, weights = _tables(tableau, y0.dtype)
        count = times.shape[0]
        x0, k0 = y0[:width], y0[width : 2 * width]
        cuts = _small_cuts(width, count)
        blocks = [jnp.zeros((c.stop - c.start, count), y0.dtype).at[:, 0].set(k0[c]) for c in cuts]
        flat, unravel = _flattener(Ending.unknown(bundle()), y0.dtype)

        def mix(blocks: list[Array], weights: Array) -> Array:
            return jnp.concatenate([jnp.sum(block * weights[None, :], axis=1) for block in blocks])

        def stage(i: Scalar, carry: tuple) -> tuple:
            blocks = carry[0]
            x = once(x0 + dt * mix(blocks, jnp.concatenate([columns[i] for columns in rows])))
            rates, end = self._at(bundle(), t0 + times[i] * dt, x)
            blocks = [b.at[:, i].set(rates[c]) for b, c in zip(blocks, cuts, strict=True)]
            return blocks, x, _flattener(end, y0.dtype)[0]

        blocks, raw, flat = jax.lax.fori_loop(1, count, stage, (blocks, x0, flat))
        rates = jnp.concatenate([block[:, -1] for block in blocks])
        return raw, rates, dt * mix(blocks, weights), unravel(flat)

    def _at(self, grasp: Grasp, t: Scalar, x: Array) -> tuple[Array, "Ending"]:
        """Time derivative of x, and what is needed of it if the step ends there."""
        rates, instant = self.rates(grasp, t, x)
        leaves, _ = unpack(self.lay, x)
        return rates, Ending(anchor_of(instant), *regime(grasp, leaves, instant, self.events))

    def rates(self, grasp: Grasp, t: Scalar, x: Array) -> tuple[Array, Instant]:
        """Time derivative of x, and all else that its evaluation worked out."""
        leaves, _ = unpack(self.lay, x)
        instant = evaluate(grasp, t, leaves, self.formulation)
        gained = power(grasp, t, leaves, instant.motions) if self.lay.audited else None
        return pack(instant.rates, gained), instant

    def _other(
        self, bundle: Bundle, t0: Scalar, t1: Scalar, y0: Flow
    ) -> tuple[Array, Array, Array, "Ending"]:
        def field(t: Scalar, x: Array, args: Grasp) -> Array:
            return self.rates(args, t, x)[0]

        terms, grasp = diffrax.ODETerm(field), bundle()
        x0 = y0[: self.lay.width]
        memory = self.method.init(terms, t0, t1, x0, grasp)
        raw, error, _, _, code = self.method.step(terms, t0, t1, x0, grasp, memory, True)
        rates, end = self._at(grasp, t1, raw)
        if error is None:
            error = jnp.zeros_like(raw)
        error = jnp.where(code == diffrax.RESULTS.successful, error, jnp.inf)
        return raw, rates, error, end


class Ending(eqx.Module):
    """What a step's last evaluation leaves for its end: projection, margin and code."""

    anchor: Anchor
    margin: Scalar
    number: Scalar

    @classmethod
    def unknown(cls, grasp: Grasp) -> "Ending":
        """Zeros in the same places."""
        zero = jnp.zeros(())
        return cls(Anchor(unknown_line(grasp), (zero,) * len(grasp.contacts)), zero, zero)


def _flattener(tree: Any, dtype: Any) -> tuple[list[Array], Callable[[list[Array]], Any]]:
    """Scalars as few small vectors, and the way back."""
    leaves, form = jax.tree.flatten(tree)
    numbers = jnp.stack([jnp.asarray(leaf, dtype) for leaf in leaves])
    cuts = _small_cuts(len(leaves), 1)

    def back(parts: list[Array]) -> Any:
        whole = jnp.concatenate(parts)
        return jax.tree.unflatten(form, [whole[i] for i in range(len(leaves))])

    return [numbers[c] for c in cuts], back


# Sweeps of the projection: a gap of 1e-6 m is below rounding after two.
_SWEEPS = 2
# XLA's CPU runtime hands a loop to its thread pool, at some 20 us a turn, as soon as one buffer in it is
# larger than this; a stage costs 1 us.
_SMALL_BUFFER = 512


def _small_cuts(size: int, length: int) -> list[slice]:
    """Cut `size` rows of `length` doubles into blocks that stay small."""
    most = max(1, _SMALL_BUFFER // (8 * length))
    return [slice(i, min(i + most, size)) for i in range(0, size, most)]


def _tables(tableau: diffrax.ButcherTableau, dtype: Any) -> tuple[list[Array], Array, Array]:
    """Rows of all stages and of the step's end in blocks of columns, their times, and the error's weights."""
    # The last stage of some methods is the step's end already; the others get one more.
    ends_itself = bool(tableau.fsal and tableau.ssal)
    count = tableau.num_stages + int(not ends_itself)
    full, error = np.zeros((count, count)), np.zeros(count)
    for i, row in enumerate([*tableau.a_lower, tableau.b_sol][: count - 1]):
        full[i + 1, : len(row)] = row
    times = np.concatenate([[0.0], tableau.c, [1.0]])[:count]
    error[: tableau.num_stages] = tableau.b_error
    rows = [jnp.asarray(full[:, cut], dtype) for cut in _small_cuts(count, count)]
    return rows, jnp.asarray(times, dtype), jnp.asarray(error, dtype)
