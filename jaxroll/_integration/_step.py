r"""One step of a diffrax Runge-Kutta method on a grasp, and the return to the constraints at its end.

A step from $x_0$ over $h$ has stages $x_i = x_0 + h \sum_{j<i} a_{ij} k_j$ with slopes $k_i = f(t_i, x_i)$, f
being `slope` of `_state_vector`. The last stage is the step's end, off the constraints by the method's error;
its evaluation gives the derivative there, with which the next step begins, the linearised constraints for the
return (`_motion._projection`), and the margin, which tells whether the model still holds (`_events`).

diffrax supplies the methods as tables of $a_{ij}$. Its own step is not used for explicit ones: sharing the
last stage's factorisation with the projection, and stopping XLA from recomputing one stage inside the next,
is worth a factor of two in a run and four in a batch. `_run` and `_batch` take steps, `_derivative`
differentiates them.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import row, scalars, total, weighted_sum, with_row, with_row_selected
from .._mechanics import Grasp, Leaves
from .._motion import (
    Anchor,
    anchor_of,
    combine,
    compatible,
    Formulation,
    Index1,
    Linearisation,
    sample_due,
    settle,
    struck,
    unknown_anchor,
)
from .._types import Scalar
from .._xla import as_it_is, counted, once, sharing
from ..loads import impulses
from . import _jumps
from ._bundle import Bundle
from ._events import coded, first_dip, refused_blow, regime, smallest_clearance, watched, with_clearance
from ._methods import is_rosenbrock, on_tableau
from ._rosenbrock import advance, STAGE_TIMES
from ._state_vector import Flow, Layout, pack, slope, unpack


class RollingStep(eqx.Module):
    """A step of a diffrax method for the flow vector of a grasp.

    Attributes:
        method: The diffrax method: explicit Runge-Kutta ones are run on their tableau, Rosenbrock's in
            one loop too, any other one by its own `step`.
        formulation: Projection or stabilisation.
        lay: Layout of the flow vector.
        events: What ends a run, besides ends of contours, singular contacts and the limits of joints.
        sweeps: How often a step's end returns to the constraints (`_arguments.sweeps`).
        reverse: Whether JAX is to transpose the loop over the stages, as in dense output.
    """

    method: diffrax.AbstractSolver[Any]
    formulation: Formulation
    lay: Layout = eqx.field(static=True)
    events: tuple[str, ...] = eqx.field(static=True)
    sweeps: int = eqx.field(static=True)
    reverse: bool = eqx.field(static=True, default=False)

    @property
    def error_order(self) -> Any:
        """Order of the error estimate, as step-size controllers want it."""
        # Methods ask the terms only whether there is noise in them.
        return self.method.error_order(diffrax.ODETerm(lambda t, x, args: x))

    @eqx.filter_jit  # traced once for a run and its tangents
    def advance(
        self, bundle: Bundle, t0: Scalar, t1: Scalar, y0: Flow, *, over: Callable = as_it_is
    ) -> tuple[Flow, Flow, Scalar]:
        """One step as a pure map: the new vector, its error estimate, and where its margin dips (`_events`).

        `over` is `pulled` where the step is to be differentiated backwards.
        """
        return self.advance_lanes(bundle, (t0, t1), y0, over)

    def advance_lanes(
        self, bundle: Bundle, times: tuple[Array, Array], y0: Array, over: Callable[[Callable], Callable]
    ) -> tuple[Array, Array, Array]:
        """The same for lanes along the last axis; `over` maps a function of one lane, of (bundle, ...)."""
        if bundle.jumps:
            y0 = over(self.moved)(bundle, *times, y0)
        # `raw` is the end as the method gives it, `rates` the derivative there, `end` the packed `Ending`.
        raw, rates, error, end, dip = self._way(bundle, *times, y0, over)
        y1 = over(self.finish)(bundle, raw, rates, end, *sample_times(bundle, times[1]))
        if bundle.jumps and impulses(bundle.rest.load):  # a blow declares its time as a jump
            y1 = jnp.concatenate([y1[:-2], jnp.where(y0[-1:] > 0, y0[-2:], y1[-2:])])
        if "penetration" in self.events or bundle.thick:
            dip = jnp.minimum(dip, over(self._clearance_dip)(bundle, *times, y0, y1))
        # XLA would work both out again in everything that looks at them (see `_events`).
        with sharing():
            dip, leapt = once((dip, self._leapt(y0, raw, y1).astype(error.dtype)))
        error, dip, leapt = jax.lax.stop_gradient((error, dip, leapt))
        # An infinite error makes the step-size control take the step back and try a shorter one.
        error = jnp.where(leapt > 0, jnp.inf, error)
        unseen = jnp.zeros((self.lay.width + 2, *error.shape[1:]), error.dtype)
        return y1, jnp.concatenate([error, unseen]), dip

    def _leapt(self, y0: Array, raw: Array, y1: Array) -> Array:
        """Whether the projection carried a contact elsewhere than the step had: such a step is too long.

        Where a sum of curvatures runs out, tangency has no solution any more, and its Newton steps end
        somewhere else on the shapes. Error control does not see that: it does not look at places.
        """
        positions, velocities, places = self.lay.form.counts
        start, stop = positions + velocities, positions + velocities + places
        # Contact coordinates before the step, before the projection, and after it.
        at = [y[start:stop] for y in (y0, raw, y1)]
        carried = jnp.abs(at[2] - at[1])
        moved = jnp.minimum(jnp.abs(at[1] - at[0]), jnp.abs(at[2] - at[0]))
        return jnp.any(carried > 0.5 * moved + _NEAR, axis=0)

    @property
    def _way(self) -> Callable:
        if on_tableau(self.method):
            return self._explicit
        return self._rosenbrock if is_rosenbrock(self.method) else self._other

    def moved(self, bundle: Bundle, t0: Scalar, t1: Scalar, y0: Flow) -> Flow:
        """The flow vector at a step's start, moved with the time of a jump there, and struck (`_jumps`)."""
        grasp, width = bundle(), self.lay.width
        x0 = _jumps.moved(grasp, t0, t1, y0[:width], rates=y0[width : 2 * width])
        if not (blows := impulses(grasp.load)):
            return jnp.concatenate([x0, y0[width:]])
        acting = [(blow, jnp.where(_jumps.hits(t0, t1, blow.time), 1.0, 0.0)) for blow in blows]
        leaves, work = unpack(self.lay, x0)
        with sharing():
            done = struck(grasp, leaves, acting)
            hit = total([times for _, times in acting]) > 0
            no, number = refused_blow(grasp, done, self.events)
        after = pack(done.leaves, None if work is None else work + done.work)
        x0 = jnp.where(hit & ~no, after, x0)
        # A margin of minus infinity marks a refused impulse; a force has a finite one.
        end = jnp.stack([jnp.asarray(-jnp.inf, x0.dtype), number.astype(x0.dtype)])
        return jnp.concatenate([x0, y0[width:-2], jnp.where(hit & no, end, y0[-2:])])

    def finish(self, bundle: Bundle, raw: Array, rates: Array, end: Array, *t1: Scalar) -> Flow:
        """The flow vector at a step's end, back on the constraints, and after a sample that is due there.

        `t1` is the time of the end where the controller is sampled (`sample_times`), and not given otherwise.
        """
        grasp = bundle()
        with sharing():
            ending = Ending.unpacked(grasp, end)
            x1 = raw
            if isinstance(self.formulation, Index1):
                x1 = returned(self.lay, grasp, raw, ending.anchor, sweeps=self.sweeps)
            leaves, _ = unpack(self.lay, x1)
            judged = with_clearance(grasp, leaves, (ending.margin, ending.number), self.events)
            end = coded(x1, *judged)
            for t in t1:
                x1, rates = self._sampled(grasp, t, x1, rates, ending.anchor.line)
            return jnp.concatenate([x1, rates, end])

    def _sampled(
        self, grasp: Grasp, t: Scalar, x: Array, rates: Array, line: Linearisation
    ) -> tuple[Array, Array]:
        """The vector x and its slope after a sample, if one is due."""
        leaves, work = unpack(self.lay, x)
        slopes, power = unpack(self.lay, rates)
        waits = _jumps.pending(grasp, t) if grasp.jumps else False
        done = sample_due(grasp, t, leaves, slopes, line=line, waits=waits)
        x = pack(Leaves(leaves.q, leaves.v, leaves.s, done.memory), work)
        slopes = Leaves(slopes.q, combine(slopes.v, done.gained), slopes.s, slopes.memory)
        after = pack(slopes, None if power is None else power + done.power)
        # Continued back to the step's end the state is x + late (f_- - f_+), and the slope is the one there.
        way = rates - after
        slope_at = (self.lay, self.formulation, grasp, t, x, way)
        return x + done.late * way, after + _elsewhere(done.late, slope_at)

    def _within(self, t0: Scalar, t1: Scalar, y0: Flow, y1: Flow, share: Scalar) -> Array:
        """The vector x at a share of a step, by the cubic through both ends and their derivatives."""
        # Hermite's cubic: the straight line from x0 to x1, and what bends it to the slopes at both ends.
        width = self.lay.width
        (x0, k0), (x1, k1) = ((y[:width], (t1 - t0)[None] * y[width : 2 * width]) for y in (y0, y1))
        rise, rest = x1 - x0, 1.0 - share
        bent = rest * (k0 - rise) - share * (k1 - rise)
        return x0 + share * (rise + rest * bent)

    def _clearance_dip(self, bundle: Bundle, t0: Scalar, t1: Scalar, y0: Flow, y1: Flow) -> Scalar:
        """Where something overlaps within a step, by an audit of clearance at some places of it."""
        # The audit of clearance is long: in a loop it is compiled once, whatever the number of places.
        grasp, shares = bundle(), jnp.asarray(_AUDITED, y0.dtype)
        clear = lambda leaves: smallest_clearance(grasp, leaves, self.events)  # noqa: E731

        def audited(i: Scalar, margins: Array) -> Array:
            leaves, _ = unpack(self.lay, self._within(t0, t1, y0, y1, row(shares, i)))
            return jnp.where(jnp.arange(len(_AUDITED)) == i, clear(leaves), margins)

        margins = jax.lax.fori_loop(0, len(_AUDITED), audited, jnp.zeros(len(_AUDITED), y0.dtype))
        return first_dip(_AUDITED, list(margins))

    def _explicit(
        self, bundle: Bundle, t0: Array, t1: Array, y0: Array, over: Callable
    ) -> tuple[Array, Array, Array, Array, Array]:
        """All stages and the step's end in one loop, so that the equations are compiled once."""
        at = lambda t, x: over(self.at)(bundle, t, x)  # noqa: E731
        slopes, raw, end = self.stages(over(self.at), bundle, (t0, t1), y0, size=ending_size(bundle))
        _, shares, weights = tableau_of(self.method, y0.dtype)
        width, dt = self.lay.width, jax.lax.stop_gradient(t1 - t0)
        raw, error, rates = raw[:width], dt[None] * weighted_sum(weights, slopes)[:width], slopes[-1, :width]
        seen = watched(shares)
        if len(seen) > 2:
            return raw, rates, error, end, _earliest_dip(shares[seen], [slopes[i, width:] for i in seen])
        return raw, rates, error, end, self._dip_between(at, (t0, t1), y0, (raw, rates, end))

    def stages(
        self, at: Callable, bundle: Any, times: tuple[Array, Array], y0: Array, *, size: int
    ) -> tuple[Array, Array, Array]:
        """The slopes of all stages, the last stage's x, which is the step's end, and what is left of it.

        The slopes have two columns more than x, for the margins of the stages; their part of x is not read.
        """
        # The length of a step is not differentiated: a step is only moved in time, as a whole.
        dt, width = jax.lax.stop_gradient(times[1] - times[0]), self.lay.width
        rows, shares, _ = tableau_of(self.method, y0.dtype)
        shares, count = jnp.asarray(shares, y0.dtype), len(shares)
        margin = y0[self.lay.margin]
        x0, k0 = y0[: width + 2], jnp.concatenate([y0[width : 2 * width], jnp.stack([margin, margin])])
        slopes = jnp.concatenate([k0[None], jnp.zeros((count - 1, *k0.shape), k0.dtype)])
        put = with_row_selected if dt.ndim == 0 else with_row

        def stage(i: Scalar, carry: tuple[Array, Array, Array], bundle: Any) -> tuple[Array, Array, Array]:
            slopes, i = carry[0], i + 1
            x = x0 + dt[None] * weighted_sum(scalars(row(rows, i)), slopes)
            rates, end = at(bundle, times[0] + shares[i] * dt, x)
            margins = jax.lax.stop_gradient(end[_MARGINS])
            return put(slopes, jnp.concatenate([rates, margins]), i), x, end

        start = slopes, x0, jnp.zeros((size, *dt.shape), y0.dtype)
        # On accelerators every turn launches all its kernels anew: there the turns are written out, except
        # for a single run, whose derivative would take long to compile.
        unrolled = dt.ndim > 0 and jax.default_backend() != "cpu"
        if self.reverse or unrolled:
            plain = lambda i, carry: stage(i, carry, bundle)  # noqa: E731
            return jax.lax.fori_loop(0, count - 1, plain, start, unroll=unrolled or None)
        return counted(count - 1, stage, start, bundle)

    def at(self, bundle: Bundle, t: Scalar, x: Array) -> tuple[Array, Array]:
        """Time derivative of x, and what is needed of it if the step ends there, as vectors."""
        with sharing():
            rates, end = self._evaluated(bundle(), t, once(x))
            return rates, end.packed(x.dtype)

    def _evaluated(self, grasp: Grasp, t: Scalar, x: Array) -> tuple[Array, "Ending"]:
        rates, instant = slope(self.lay, grasp, t, x, formulation=self.formulation)
        leaves, _ = unpack(self.lay, x)
        margin, number, margins = regime(grasp, leaves, instant, self.events)
        return rates, Ending(anchor_of(instant), margins, margin, number)

    def _other(
        self, bundle: Bundle, t0: Scalar, t1: Scalar, y0: Flow, over: Callable
    ) -> tuple[Array, Array, Array, Array, Array]:
        def field(t: Scalar, x: Array, args: Grasp) -> Array:
            return slope(self.lay, args, t, x, formulation=self.formulation)[0]

        terms, grasp = diffrax.ODETerm(field), bundle()
        x0 = y0[: self.lay.width]
        # diffrax's own step, whatever it does inside; then one evaluation at its end, as the others have it.
        with sharing():
            memory = self.method.init(terms, t0, t1, x0, grasp)
            raw, error, _, _, code = self.method.step(terms, t0, t1, x0, grasp, memory, True)
        rates, end = self.at(bundle, t1, raw)
        if error is None:
            error = jnp.zeros_like(raw)
        # Where the equations of the stages were not solved, a shorter step may succeed.
        error = jnp.where(code == diffrax.RESULTS.successful, error, jnp.inf)
        at = lambda t, x: self.at(bundle, t, x)  # noqa: E731
        return raw, rates, error, end, self._dip_between(at, (t0, t1), y0, (raw, rates, end))

    def _dip_between(
        self, at: Callable, times: tuple[Scalar, Scalar], y0: Flow, after: tuple[Array, Array, Array]
    ) -> Scalar:
        """Where the margin dips within a step whose stages are not at hand: by evaluations of its own."""
        raw, rates, end = after
        y1, inner = jnp.concatenate([raw, rates]), jnp.asarray(_AUDITED[1:-1], y0.dtype)

        def margins(share: Scalar) -> Array:
            x = self._within(*times, y0, y1, share)
            return at(times[0] + share * (times[1] - times[0]), x)[1][_MARGINS]

        start = jnp.stack([y0[self.lay.margin]] * 2)
        return _earliest_dip(_AUDITED, [start, *jax.lax.map(margins, inner), end[_MARGINS]])

    def _rosenbrock(
        self, bundle: Bundle, t0: Scalar, t1: Scalar, y0: Flow, over: Callable
    ) -> tuple[Array, Array, Array, Array, Array]:
        at = lambda t, x: over(self.at)(bundle, t, x)  # noqa: E731
        nothing = jnp.zeros((ending_size(bundle), *t0.shape), y0.dtype)
        x0, margin = y0[: self.lay.width], y0[self.lay.margin]
        raw, rates, error, end, inner = advance(at, (t0, t1), x0, nothing, kept=_MARGINS)
        margins, seen = [jnp.stack([margin, margin]), *inner], watched(STAGE_TIMES)
        return raw, rates, error, end, _earliest_dip(STAGE_TIMES[seen], [margins[i] for i in seen])


def returned(lay: Layout, grasp: Grasp, raw: Array, anchor: Anchor, *, sweeps: int) -> Array:
    """The vector x back onto the constraints, positions before velocities."""
    x = raw
    # As a loop the sweeps would take longer to compile, backwards above all.
    for _ in range(sweeps):
        leaves, work = unpack(lay, x)
        x = once(pack(settle(grasp, leaves, anchor), work))
    leaves, work = unpack(lay, x)
    return pack(compatible(grasp, leaves, anchor.line), work)


def _earliest_dip(times: np.ndarray, margins: Sequence[Array]) -> Scalar:
    """Share of a step at which the first of both margins dips: of positions and of forces."""
    # As vectors of two: one after the other they would be a tenth of a run's program.
    place, force = first_dip(times, margins)
    return jnp.minimum(place, force)


class Ending(eqx.Module):
    """What a step's last evaluation leaves for its end: projection, margin and code.

    `margins` are those of positions and of forces, of which `margin` is the smaller while the geometry holds.
    """

    anchor: Anchor
    margins: tuple[Scalar, Scalar]
    margin: Scalar
    number: Scalar

    @classmethod
    def unknown(cls, grasp: Grasp) -> "Ending":
        """Zeros in the same places."""
        return cls(unknown_anchor(grasp), (0.0, 0.0), 0.0, 0.0)

    def packed(self, dtype: Any) -> Array:
        """All numbers as one vector: a loop carries it with one copy."""
        # Arrays, such as a large system's factor, before the numbers: the last two are margin and code.
        leaves = jax.tree.leaves(self)
        arrays, numbers = ([x for x in leaves if bool(jnp.ndim(x)) is kind] for kind in (True, False))
        vector = jnp.stack([jnp.asarray(number, dtype) for number in numbers])
        return jnp.concatenate([*map(jnp.ravel, arrays), vector]) if arrays else vector

    @classmethod
    def unpacked(cls, grasp: Grasp, numbers: Array) -> "Ending":
        """The way back."""
        leaves, form = jax.tree.flatten(cls.unknown(grasp))
        shapes = [jnp.shape(leaf) for leaf in leaves if jnp.ndim(leaf)]
        sizes = [math.prod(shape) for shape in shapes]
        *parts, rest = jnp.split(numbers, np.cumsum(sizes)) if sizes else [numbers]
        arrays, singles = iter(map(jnp.reshape, parts, shapes)), iter(scalars(rest))
        return jax.tree.unflatten(form, [next(arrays if jnp.ndim(leaf) else singles) for leaf in leaves])


@eqx.filter_custom_jvp
def _elsewhere(late: Scalar, slope_at: tuple) -> Array:
    """Zero, with the derivative of the slope as x moves by `late` times the way that ends `slope_at`."""
    return jnp.zeros_like(slope_at[-1])


@_elsewhere.def_jvp
def _elsewhere_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    lay, formulation, grasp, t, x, way = primals[1]
    late_dot = jnp.zeros_like(t) if tangents[0] is None else tangents[0]
    _, moved = jax.jvp(lambda x: slope(lay, grasp, t, x, formulation=formulation)[0], (x,), (way,))
    return jnp.zeros_like(way), late_dot * moved


def sample_times(bundle: Bundle, t1: Scalar) -> tuple[Scalar, ...]:
    """The time of a step's end, for `RollingStep.finish`, where the controller is sampled; else nothing."""
    return (t1,) if bundle.sampled else ()


def ending_size(bundle: Bundle) -> int:
    return sum(map(jnp.size, jax.tree.leaves(Ending.unknown(bundle.rest))))


# How far the projection may carry a contact in any case [m].
_NEAR = 1e-4
# Where the packed `Ending` has both margins: before the smaller one and the number of its limit.
_MARGINS = slice(-4, -2)
# Where a step is audited, or its margin evaluated if its stages cannot be used, as shares of it.
_AUDITED = np.array([0.0, 0.25, 0.5, 0.75, 1.0])


def tableau_of(method: Any, dtype: Any) -> tuple[Array, np.ndarray, list[float]]:
    """Rows of all stages and of the step's end, their times, and the error's weights."""
    tableau = method.tableau
    # The last stage of some methods is the step's end already; the others get one more.
    ends_itself = bool(tableau.fsal and tableau.ssal)
    count = tableau.num_stages + int(not ends_itself)
    full, error = np.zeros((count, count)), np.zeros(count)
    for i, weights in enumerate([*tableau.a_lower, tableau.b_sol][: count - 1]):
        full[i + 1, : len(weights)] = weights
    times = np.concatenate([[0.0], tableau.c, [1.0]])[:count]
    error[: tableau.num_stages] = tableau.b_error
    return jnp.asarray(full, dtype), times, error.tolist()
