r"""What a fingertip must keep to: size, length, radii and smoothness.

A contour is evaluated once, on its contact interval (the pad) and from end to end (`sampled`). The limits,
and the goals that judge the contour itself, look at these samples alone. A limit is written as an excess
$g \le 0$ at every sample, relative to its bound, as `_minimise` takes it: without dimension, so that one
weight suits all limits.

`margins` has the margin of (41), bounded where the contour is flat or hollow, and `soft_least` its smooth
minimum, for the goal `Margin`.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._fields import real, taken
from .._linalg import larger, root, smaller
from .._printing import listed
from .._results import as_floats, check_positive, traced
from .._types import Given, Scalar
from ..geometry import AbstractContour, Frenet2

# Samples on the contact interval, and from end to end of the contour.
_PAD, _WHOLE = 65, 257


class ContourSamples(eqx.Module):
    """A contour at its samples.

    Attributes:
        pad: Frames on the contact interval.
        whole: Frames from end to end of the contour, or once round it.
        step: Arclength between neighbours in `whole` [m].
        length: Arclength of the contour [m].
        beyond: Shape (2,), how far the contact interval reaches beyond either end, over its own length; None
            of a closed contour, which goes on there.
    """

    pad: Frenet2
    whole: Frenet2
    step: Scalar
    length: Scalar
    beyond: Array | None


def sampled(contour: AbstractContour, interval: Array) -> ContourSamples:
    """Evaluate a contour on its contact interval and from end to end."""
    ready = contour.prepared()
    ends = ready.domain()
    assert ends is not None  # checked where the contour came in
    length = ends[1] - ends[0]
    pad = _frames(ready, interval[0] + (interval[1] - interval[0]) * jnp.linspace(0.0, 1.0, _PAD))
    whole = _frames(ready, ends[0] + length * jnp.linspace(0.0, 1.0, _WHOLE))
    # A search moves the ends of an open contour too, and its frame goes on beyond them: places that no finger
    # has.
    over = jnp.stack([ends[0] - interval[0], interval[1] - ends[1]]) / (interval[1] - interval[0])
    return ContourSamples(pad, whole, length / (_WHOLE - 1), length, None if contour.closed else over)


def _frames(contour: AbstractContour, s: Array) -> Frenet2:
    """Frames with one curvature for each arclength; by itself a circle gives one for all."""
    return jax.vmap(lambda s: jax.tree.map(jnp.asarray, contour.frame(s)))(s)


class Limits(eqx.Module):
    r"""Bounds on a fingertip; None leaves one out. All are kept on samples, 257 all round and 65 on the pad.

    That the contact interval stays between the ends of an open contour is a limit in any case.

    Args:
        size: Largest distance of a point from $O_i$ [m].
        length: Largest arclength of the whole contour [m].
        radius: Smallest radius of curvature anywhere, hollow or not [m]: what a nozzle or cutter can make.
        ahead: Least distance of the pad in front of $O_i$ [m], $-n \cdot \gamma$ on the contact interval:
            the last link ends behind it. (41) wants it small.
        flat: Largest radius of curvature on the contact interval [m]. Without it the best pad is flat and
            rolls on its ends alone; with None the interval is still kept convex. Default: 0.1.
        steepness: Largest $|d\kappa/ds|$ [1/m^2]: smoothness.

    Raises:
        ValueError: If a bound is not one positive number, or None.

    Example:
        >>> import jaxroll as jxr
        >>> limits = jxr.design.Limits(size=0.02, radius=0.002, flat=0.05)
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {
        "size": "m",
        "length": "m",
        "radius": "m",
        "ahead": "m",
        "flat": "m",
        "steepness": "1/m^2",
    }

    size: Float[Array, ""] | None = real(check=check_positive, optional=True)
    length: Float[Array, ""] | None = real(check=check_positive, optional=True)
    radius: Float[Array, ""] | None = real(check=check_positive, optional=True)
    ahead: Float[Array, ""] | None = real(check=check_positive, optional=True)
    flat: Float[Array, ""] | None = real(check=check_positive, optional=True)
    steepness: Float[Array, ""] | None = real(check=check_positive, optional=True)

    def __init__(
        self,
        *,
        size: Given | None = None,
        length: Given | None = None,
        radius: Given | None = None,
        ahead: Given | None = None,
        flat: Given | None = 0.1,
        steepness: Given | None = None,
    ) -> None:
        self.size = taken(self, "size", size)
        self.length = taken(self, "length", length)
        self.radius = taken(self, "radius", radius)
        self.ahead = taken(self, "ahead", ahead)
        self.flat = taken(self, "flat", flat)
        self.steepness = taken(self, "steepness", steepness)

    def excess(self, seen: ContourSamples) -> dict[str, Array]:
        """By how much each bound is passed at each sample, relative to it: not positive where it is kept."""
        found, point, bends = {}, seen.whole.point, seen.whole.curvature
        if seen.beyond is not None:
            found["interval"] = seen.beyond
        if self.size is not None:
            # A contour may pass through $O_i$, where a distance has no derivative: there no limit is near.
            found["size"] = root(point.dot(point)) / self.size - 1.0
        if self.length is not None:
            found["length"] = jnp.atleast_1d(seen.length / self.length - 1.0)
        # An absolute value is bounded as two limits, each of them smooth.
        if self.radius is not None:
            found["radius"] = jnp.concatenate([bends, -bends]) * self.radius - 1.0
        # The support function -n . gamma, with the chapter's inward normal n: `right` is the outward one.
        if self.ahead is not None:
            found["ahead"] = 1.0 - seen.pad.tangent.right().dot(seen.pad.point) / self.ahead
        # Bounded as a curvature, 1 / kappa <= flat would be kept by every negative kappa. Without a bound the
        # interval is kept convex, kappa >= 0, with the contour's length to take the dimension away.
        if self.flat is None:
            found["convex"] = -seen.pad.curvature * seen.length
        else:
            found["flat"] = 1.0 - seen.pad.curvature * self.flat
        if self.steepness is not None:
            slope = jnp.diff(bends) / (seen.step * self.steepness)
            found["steepness"] = jnp.concatenate([slope, -slope]) - 1.0
        return found

    def all(self, seen: ContourSamples) -> Array:
        """All of `excess` in one vector."""
        return jnp.concatenate(list(self.excess(seen).values()))


def margins(frames: Frenet2, scale: Scalar) -> Array:
    r"""Margin of (41), $1/\kappa + n \cdot \gamma$ [m], continued through $\kappa = 0$ by a bounded function.

    Below $\kappa_0$ = `1 / (50 scale)` the radius is $(2 - 1/(2 - \kappa/\kappa_0))/\kappa_0$, which meets
    $1/\kappa$ with its slope at $\kappa_0$ and is below $2/\kappa_0$ however hollow the contour.
    """
    least = 1.0 / (50.0 * scale)
    bend = frames.curvature
    # Both functions are evaluated everywhere and selected from: neither may divide by zero where it is not
    # chosen, or the gradient is NaN.
    hollow = (2.0 - 1.0 / (2.0 - smaller(bend / least, 1.0))) / least
    radius = jnp.where(bend > least, 1.0 / larger(bend, least), hollow)
    return radius - frames.tangent.right().dot(frames.point)


def soft_least(values: Array, sharpness: float) -> Array:
    r"""Smooth lower bound of the least of dimensionless values: $-\log\sum_i e^{-k v_i}/k$."""
    # Whatever `least` is, the result is the same: it needs no derivative. The derivative of a minimum
    # compares values, which a program may have computed twice and rounded differently, and is NaN where none
    # is equal.
    least = jnp.min(jax.lax.stop_gradient(values))
    return least - jnp.log(jnp.sum(jnp.exp(-sharpness * (values - least)))) / sharpness


def check_interval(contour: AbstractContour, interval: Given) -> Array:
    """The contact interval [m] as an array; raises unless it rises and lies on the contour."""
    ends = as_floats("interval", interval, (2,))
    if traced(ends):
        raise ValueError("argument interval must be known before tracing, but was traced")
    low, high = np.asarray(ends)
    if not low < high:
        raise ValueError(f"argument interval must be increasing, but was {[float(low), float(high)]}")
    domain, kind = contour.domain(), type(contour).__name__
    if domain is None:
        raise ValueError(f"argument tip must have ends or be closed, but was an endless {kind}")
    if not contour.closed and not (float(domain[0]) <= low and high <= float(domain[1])):
        raise ValueError(
            f"argument interval must lie on the contour, between {float(domain[0]):g} and "
            f"{float(domain[1]):g} m, but was {[float(low), float(high)]}"
        )
    # A closed contour goes on beyond its ends; but samples of more than one round, such as of an interval in
    # millimetres, are places that nobody chose.
    if high - low > (1.0 + 1e-9) * (length := float(domain[1]) - float(domain[0])):
        raise ValueError(
            f"argument interval must be no longer than the contour, {length:g} m, but was "
            f"{[float(low), float(high)]}"
        )
    return ends
