"""Limits that are crossed and crossed back within one step, seen from the step's own stages.

A step is judged at its end. A force that falls below zero and rises again before the step ends would pass
unseen; but the stages of a method evaluate the equations, and with them the margin of the model (see
`_events`), inside the step anyway. About the lowest of these margins goes a parabola; where that
falls below zero, `StopAt` takes the step back and ends a shorter one there.

What it costs cannot be measured (below 1 % of a batch of the pivoted scene with Tsit5, by `python -m
benchmarks.batch` with `first_dip` returning infinity beside), as long as it is worked out once a step: left
to itself XLA works it out again in every number of the pace, and a batch takes 15 % longer.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

# Stages closer than this share of a step to a later one, or to the start, are left out: later stages are of
# higher order, and a difference of near neighbours would magnify what is wrong with the earlier one.
_APART = 0.07

# A margin that falls to this part of its neighbours' is close to zero.
_CLOSE = 0.05


def watched(times: np.ndarray) -> np.ndarray:
    """Which stages of a method to look at: their numbers, in order of time; the last one is the step's end.

    Args:
        times: When each stage is evaluated, as a share of the step; the first is the start, the last the end.
    """
    picked: list[int] = []
    for i in reversed(range(1, len(times))):
        inside = _APART <= times[i] <= 1.0
        if inside and all(abs(times[i] - times[j]) >= _APART for j in picked):
            picked.append(i)
    return np.array([0, *sorted(picked, key=lambda i: times[i])])


def first_dip(times: np.ndarray, margins: Sequence[Array]) -> Array:
    r"""Share of a step at which its margin is lowest, if that is below zero or close to it; else infinity.

    Through the lowest value inside the step and its two neighbours goes the parabola $m + b x + a x^2$ about
    the middle one. It dips below zero if $m < 0$, or if $4 a m < b^2$ and its lowest place $-b / 2a$ lies
    within these three. What comes close beside these neighbours is looked at from nearby as well: there the
    parabola may err by more than what is left. The ends of the step are judged by themselves.

    Args:
        times: Shape (n,), rising shares of the step, the start and the end included.
        margins: The margins there.
    """
    shares = times.tolist()  # plain numbers, which leave single precision as it is
    low = (margins[0], margins[1], margins[2], *shares[:3])
    for i in range(2, len(shares) - 1):
        lower = margins[i] < low[1]
        new = (*margins[i - 1 : i + 2], *shares[i - 1 : i + 2])
        low = tuple(jnp.where(lower, a, b) for a, b in zip(new, low, strict=True))
    before, here, after, start, middle, end = low
    back, ahead = middle - start, end - middle
    # Multiplied by the three distances, which are positive, so that nothing is divided.
    down, up = (here - before) * ahead, (after - here) * back
    a, b = up - down, up * back + down * ahead
    size = back * ahead * (back + ahead)
    close = here - _CLOSE * jnp.maximum(before, after)
    between = (a > 0) & (b < 2.0 * back * a) & (b > -2.0 * ahead * a)
    dips = (here < 0) | between & (4.0 * a * close * size < b * b)
    lowest = middle + jnp.where(between, -0.5 * b / jnp.where(between, a, 1.0), 0.0)
    return jnp.where(dips, lowest, jnp.inf)
