"""Step-size control with a search for events: the last step of a run ends where the model stops holding.

The control of the error is diffrax's, or a caller's own. An event needs no dense output and no second copy of
the step: a step that would carry the run past it is rejected and tried shorter, until one ends at the event
to rounding. Its length is found by the Illinois method, which is the secant method on a bracket with the
margin of an end halved when that end stays twice in succession. `_run` uses `StopAt`: `ahead` proposes where
a step ends, `adapt_step_size` says what becomes of it.
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._types import resolution, Scalar
from .._xla import once, sharing

# Steps shorter than this part of what error control asks for are not shortened for dips of the margin.
_FINEST = 1.0 / 1024.0
# A dip within this share of a step from its end counts as the end: it is lower only by the square of this.
_AT_END = 1e-6
# A run whose margin at the start is below _BESIDE begins with a step of _CAREFUL dt0. It may cross that limit
# and come back at once, and at all stages of a longer step another limit may have the smallest margin.
_BESIDE, _CAREFUL = 1e-6, 1e-3
# What becomes of a step: rejected for its error, since it passed an event, or since the margin dips below
# zero within it; accepted; accepted as the last one.
_LEFT, _BACK, _DIPS, _KEPT, _ENDS = range(5)


class Hunt(NamedTuple):
    """A bracket of an event ahead: it lies between the present time and the time `beyond` later.

    Attributes:
        beyond: How far ahead the model is known not to hold [s]; infinite while no event is known.
        low: Margin at the near end, the present time, as the Illinois method weighs it.
        high: Minus the margin at the far end, weighed likewise.
        side: Which end moved last: -1 the near one, 1 the far one, 0 neither.
        leap: Longest step while a bracket is looked for [s]; infinite otherwise.
        grain: Shortest step of the search, in multiples of `resolution`.
    """

    beyond: Scalar
    low: Scalar
    high: Scalar
    side: Scalar
    leap: Scalar
    grain: Scalar

    @property
    def on(self) -> Scalar:
        """Whether an event is being searched for."""
        return jnp.isfinite(self.beyond) | jnp.isfinite(self.leap)


class Pace(eqx.Module):
    """What the step-size control remembers between steps; `inner` is the state of the error control."""

    inner: Any
    length: Float[Array, ""]  # of the next step, before it is cut short by a stop or an event
    t: Float[Array, ""]
    attempted: Int[Array, ""]
    accepted: Int[Array, ""]
    hunt: Hunt


def at_rest(inner: Any, t0: Scalar) -> Pace:
    """The pace before the first step."""
    none, zero = jnp.array(0), jnp.zeros_like(t0)
    return Pace(
        inner, zero, t0, none, none, Hunt(zero + jnp.inf, zero, zero, zero, zero + jnp.inf, zero + 1.0)
    )


class StopAt(eqx.Module):
    """Step-size control that ends steps at events, where a step is most accurate; `_run.aim` adds save times.

    The first step has no length: it gives the start its derivative, margin and code, and so spares the
    program a second copy of the equations of motion.

    Attributes:
        inner: The control of the error.
        pace: Where to go on from.
        dt0: Length of the first real step.
        dip: Share of the last step at which its margin dips below zero (`_events.first_dip`), or infinity.
        at_jump: Whether the last step was a short one at a declared jump (`_jumps`), which says nothing of
            how long steps may be; None where no jumps are declared.
        max_steps: Steps to attempt at most.
        margin: Where the flow vector carries the margin; its code is next.
    """

    inner: diffrax.AbstractStepSizeController
    pace: Pace
    dt0: Float[Array, ""]
    dip: Scalar
    at_jump: Scalar | None
    max_steps: int = eqx.field(static=True)
    margin: int = eqx.field(static=True)

    def adapt_step_size(self, t0: Scalar, t1: Scalar, y0: Array, y1: Array, *rest: Any) -> tuple:
        pace = rest[-1]
        step = (t0, t1, y0, y1, *rest[:-1], pace.inner)
        keep, start, end, jumped, inner, code = self.inner.adapt_step_size(*step)  # pyright: ignore
        still, hunting = t0 == t1, pace.hunt.on
        first = still if self.at_jump is None else still | self.at_jump
        past = y1[self.margin + 1] > 0
        # A step beyond an event counts only if its error is small enough. One that is not finite has no
        # error: it is rejected and halved like one that passed an event.
        judged = keep | jnp.isnan(y1[self.margin])
        ends = past & (first | judged & (t1 - t0 <= 2.0 * pace.hunt.grain * resolution(t1)))
        near = self.dip * (t1 - t0)
        # If the margin dips below zero within a step of small error, the next try ends where it is lowest,
        # whatever was passed later in that step. Steps far below the usual length are exempt: on them the
        # margin is smooth, and a dip is rounding. So are dips at the very end of a step: the next try would
        # be the same step again, for ever.
        inside = near + _AT_END * (t1 - t0) + resolution(t1) < t1 - t0
        dips = keep & ~ends & ~first & inside & (near > _FINEST * pace.length)
        back = past & judged & ~ends & ~dips
        keep = first | ends | keep & ~back & ~dips
        # The outcome as one number: `once` has it computed once, where XLA would copy the comparisons into
        # all that depends on them.
        fates = jnp.where(back, _BACK, jnp.where(dips, _DIPS, jnp.where(keep, _KEPT, _LEFT)))
        with sharing():
            fate = once(jnp.where(ends, _ENDS, fates).astype(t1.dtype))
        back, dips, ends, keep = fate == _BACK, fate == _DIPS, fate == _ENDS, fate >= _KEPT
        # Steps that locate an event are hidden from the error control, which keeps its state and step length;
        # so is the first one, which has no length.
        aside = first | back | dips | hunting & keep
        settled = lambda new, old: jnp.where(aside, old, new)  # noqa: E731
        inner = jax.tree.map(settled, inner, pace.inner)
        beside = y1[self.margin] < _BESIDE
        opening = jnp.where(beside, _CAREFUL * self.dt0, self.dt0)
        if self.at_jump is not None:
            opening = jnp.where(still | beside, opening, pace.length)
        length = jnp.where(first, opening, settled(end - start, pace.length))
        start = jnp.where(keep, t1, t0)
        before, after = y0[self.margin], y1[self.margin]
        hunt = _narrowed(pace.hunt, t0=t0, t1=t1, before=before, after=after, back=back, kept=keep & hunting)
        hunt = hunt._replace(
            beyond=jnp.where(dips, jnp.inf, hunt.beyond), leap=jnp.where(dips, near, hunt.leap)
        )
        with sharing():
            hunt = once(hunt._replace(leap=jnp.where(hunt.leap < length, hunt.leap, jnp.inf)))
        hunt = hunt._replace(grain=jnp.where(hunt.on, hunt.grain, 1.0))
        count = pace.accepted + jnp.where(keep, 1, 0)
        pace = Pace(inner, length, start, pace.attempted + 1, count, hunt)
        code = diffrax.RESULTS.where(aside, diffrax.RESULTS.successful, code)
        # A rejected step that can hardly become shorter and still move time: the motion is singular ahead.
        collapsed = ~aside & ~keep & (length < resolution(t0))
        code = diffrax.RESULTS.where(collapsed, diffrax.RESULTS.dt_min_reached, code)
        over = pace.attempted > self.max_steps
        code = diffrax.RESULTS.where(over, diffrax.RESULTS.max_steps_reached, code)
        code = diffrax.RESULTS.where(ends, diffrax.RESULTS.event_occurred, code)
        return keep, start, start, jumped, pace, code

    def ahead(self, t0: Scalar) -> Scalar:
        """Where the next step ends, save times aside: by the secant if an event is bracketed."""
        # The root of the line through (0, low) and (beyond, -high); within the bracket by at least one grain.
        pace = self.pace
        hunt, least = pace.hunt, pace.hunt.grain * resolution(t0)
        # A margin may be zero by rounding, at times over thousands of grains: as a difference, such as that
        # of an angle from its limit, it is rounded more coarsely than time. Then the secant says nothing, but
        # the root is near: the guess is the geometric mean of one grain and the bracket, or the bracket's
        # middle where that was too near.
        weight = hunt.low + hunt.high
        secant = hunt.beyond * (hunt.low / jnp.where(weight > 0, weight, 1.0))
        near = jnp.where(hunt.side < 0, 0.5 * hunt.beyond, jnp.sqrt(hunt.beyond * least))
        guess = jnp.where(hunt.low > 0, secant, near)
        guess = jnp.clip(guess, least, jnp.maximum(hunt.beyond - least, least))
        return t0 + jnp.minimum(jnp.where(jnp.isfinite(hunt.beyond), guess, hunt.leap), pace.length)


def _narrowed(
    hunt: Hunt, *, t0: Scalar, t1: Scalar, before: Scalar, after: Scalar, back: Scalar, kept: Scalar
) -> Hunt:
    """The bracket after a step from t0 to t1: `back` if it passed an event, `kept` if it did not reach it.

    `before` and `after` are the margins at its ends. A step that is neither leaves the bracket as it is.
    """
    # Passed: the far end moves to t1, and the near end's margin is halved if it stays for the second time.
    # Not reached: the near end moves to t1, and the far end's margin is halved likewise.
    spent = t1 - t0
    # A margin that is not finite says nothing: minus the near one in its place makes the secant bisect.
    high = jnp.where(jnp.isfinite(after), -after, before)
    low = jnp.where(hunt.side > 0, 0.5 * hunt.low, before)
    never = jnp.full_like(spent, jnp.inf)
    taken_back = Hunt(spent, low, high, jnp.ones_like(spent), never, hunt.grain)
    weighed = jnp.where(hunt.side < 0, 0.5 * hunt.high, hunt.high)
    # Short steps end a little elsewhere than the long one did, by its error or by rounding, and may use up
    # the bracket without an event. Then another bracket is looked for, in steps that grow by a factor of 8,
    # and with a coarser grain.
    with sharing():
        left, least = once((hunt.beyond - spent, hunt.grain * resolution(t1)))
    used_up = left <= 2.0 * least
    grain = jnp.where(used_up, 64.0, 1.0) * hunt.grain
    leap = jnp.where(jnp.isfinite(left), jnp.where(used_up, 8.0 * least, jnp.inf), 8.0 * hunt.leap)
    gone_on = Hunt(jnp.where(used_up, jnp.inf, left), after, weighed, jnp.full_like(spent, -1.0), leap, grain)
    pick = lambda new, old: jnp.where(back, new, old)  # noqa: E731
    rest = jax.tree.map(lambda new, old: jnp.where(kept, new, old), gone_on, hunt)
    return jax.tree.map(pick, taken_back, rest)
