"""Step-size control: steps end at save times, and at the moment when the model stops holding.

An event needs no dense output and no second copy of the step: a step that would carry the run past it is
taken back and tried shorter, by the Illinois method on the margin that the flow vector carries, until it
lands on the event to rounding.
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._types import Scalar
from .._xla import once, sharing

# Steps shorter than this part of what error control asks for are not searched for dips of the margin.
_FINEST = 1.0 / 1024.0
# A start whose margin is smaller is left by a step shorter by this factor: where a limit is passed and met
# again at once, another one, further away, may be the nearest at all stages of a long step.
_BESIDE, _CAREFUL = 1e-6, 1e-3
# What becomes of a step: left for its error, taken back from beyond an event or before a dip; kept, or the
# last one.
_LEFT, _BACK, _DIPS, _KEPT, _ENDS = range(5)


class Hunt(NamedTuple):
    """A bracket round an event ahead.

    Attributes:
        beyond: How far ahead the model is known not to hold [s]; infinite while there is no event.
        low: Margin here, as the Illinois method weighs it.
        high: Minus the margin there, weighed likewise.
        side: Which end moved last: -1 this one, 1 that one, 0 neither.
        leap: Longest step while looking for a bracket anew [s]; infinite otherwise.
        grain: Shortest step of the hunt, in units of what still moves time.
    """

    beyond: Scalar
    low: Scalar
    high: Scalar
    side: Scalar
    leap: Scalar
    grain: Scalar

    @property
    def on(self) -> Scalar:
        """Whether an event is being approached."""
        return jnp.isfinite(self.beyond) | jnp.isfinite(self.leap)


class Pace(eqx.Module):
    """What the step-size control remembers between steps."""

    inner: Any
    length: Float[Array, ""]  # of the next step, before it is cut short by a stop or an event
    t: Float[Array, ""]
    attempted: Int[Array, ""]
    accepted: Int[Array, ""]
    hunt: Hunt


def resolution(t: Scalar) -> Scalar:
    """Shortest step that still moves time."""
    return 8.0 * jnp.finfo(jnp.result_type(t)).eps * jnp.maximum(jnp.abs(t), 1e-3)


def at_rest(inner: Any, t0: Scalar) -> Pace:
    """The pace before the first step."""
    none, zero = jnp.array(0), jnp.zeros_like(t0)
    return Pace(
        inner, zero, t0, none, none, Hunt(zero + jnp.inf, zero, zero, zero, zero + jnp.inf, zero + 1.0)
    )


class StopAt(eqx.Module):
    """Step-size control that ends steps at given times and at events, where a step is most accurate.

    The first step has no length: it works out the derivative that the flow vector carries, and so
    spares the program a copy of the equations of motion.

    Attributes:
        inner: The control of the error.
        pace: Where to go on from.
        dt0: Length of the first real step.
        dip: At what share of the last step its margin dips below zero and comes back (see `_events`).
        max_steps: Steps to attempt at most.
        margin: Where the flow vector carries the margin; its code is next.
    """

    inner: diffrax.AbstractStepSizeController
    pace: Pace
    dt0: Float[Array, ""]
    dip: Scalar
    max_steps: int = eqx.field(static=True)
    margin: int = eqx.field(static=True)

    def adapt_step_size(self, t0: Scalar, t1: Scalar, y0: Array, y1: Array, *rest: Any) -> tuple:
        pace = rest[-1]
        step = (t0, t1, y0, y1, *rest[:-1], pace.inner)
        keep, start, end, jumped, inner, code = self.inner.adapt_step_size(*step)  # pyright: ignore
        first, hunting = t0 == t1, pace.hunt.on
        past = y1[self.margin + 1] > 0
        # What is not finite has no error to be judged by: such a step is taken back and halved.
        judged = keep | jnp.isnan(y1[self.margin])
        ends = past & (first | judged & (t1 - t0 <= 2.0 * pace.hunt.grain * resolution(t1)))
        back = past & judged & ~ends
        near = self.dip * (t1 - t0)
        # Where the margin dips, a shorter step is to end. Below a part of the usual length it is not asked
        # any more: there all is smooth, and what dips is rounding.
        dips = keep & ~past & ~first & (self.dip < 1.0) & (near > _FINEST * pace.length)
        keep = first | ends | keep & ~back & ~dips
        # All that follows asks which it was: as numbers that is worked out once.
        fates = jnp.where(back, _BACK, jnp.where(dips, _DIPS, jnp.where(keep, _KEPT, _LEFT)))
        with sharing():
            fate = once(jnp.where(ends, _ENDS, fates).astype(t1.dtype))
        back, dips, ends, keep = fate == _BACK, fate == _DIPS, fate == _ENDS, fate >= _KEPT
        # The error control never sees the short steps of a hunt: it goes on at its pace afterwards.
        aside = first | back | dips | hunting & keep
        settled = lambda new, old: jnp.where(aside, old, new)  # noqa: E731
        inner = jax.tree.map(settled, inner, pace.inner)
        beside = y1[self.margin] < _BESIDE
        opening = jnp.where(beside, _CAREFUL * self.dt0, self.dt0)
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
        over = pace.attempted > self.max_steps
        code = diffrax.RESULTS.where(over, diffrax.RESULTS.max_steps_reached, code)
        code = diffrax.RESULTS.where(ends, diffrax.RESULTS.event_occurred, code)
        return keep, start, start, jumped, pace, code

    def ahead(self, t0: Scalar) -> Scalar:
        """Where the next step ends, save times aside."""
        pace = self.pace
        hunt, least = pace.hunt, pace.hunt.grain * resolution(t0)
        weight = hunt.low + hunt.high  # zero where a margin is, and what lies ahead says nothing: bisect
        guess = hunt.beyond * jnp.where(weight > 0, hunt.low / jnp.where(weight > 0, weight, 1.0), 0.5)
        guess = jnp.clip(guess, least, jnp.maximum(hunt.beyond - least, least))
        return t0 + jnp.minimum(jnp.where(jnp.isfinite(hunt.beyond), guess, hunt.leap), pace.length)


def _narrowed(
    hunt: Hunt, *, t0: Scalar, t1: Scalar, before: Scalar, after: Scalar, back: Scalar, kept: Scalar
) -> Hunt:
    """The bracket after a step from `t0` to `t1` that was taken `back`, or `kept` while hunting.

    `before` and `after` are the margins at its ends.
    """
    spent = t1 - t0
    # A value that is not finite says nothing of how far: bisect.
    high = jnp.where(jnp.isfinite(after), -after, before)
    low = jnp.where(hunt.side > 0, 0.5 * hunt.low, before)
    never = jnp.full_like(spent, jnp.inf)
    taken_back = Hunt(spent, low, high, jnp.ones_like(spent), never, hunt.grain)
    weighed = jnp.where(hunt.side < 0, 0.5 * hunt.high, hunt.high)
    # Short steps end a little elsewhere than the long one did, by its error or by rounding: where the
    # bracket is used up, look for another one in growing steps, and then more coarsely.
    with sharing():
        left, least = once((hunt.beyond - spent, hunt.grain * resolution(t1)))
    used_up = left <= 2.0 * least
    grain = jnp.where(used_up, 64.0, 1.0) * hunt.grain
    leap = jnp.where(jnp.isfinite(left), jnp.where(used_up, 8.0 * least, jnp.inf), 8.0 * hunt.leap)
    gone_on = Hunt(jnp.where(used_up, jnp.inf, left), after, weighed, -jnp.ones_like(spent), leap, grain)
    pick = lambda new, old: jnp.where(back, new, old)  # noqa: E731
    rest = jax.tree.map(lambda new, old: jnp.where(kept, new, old), gone_on, hunt)
    return jax.tree.map(pick, taken_back, rest)
