r"""Commands that change in time: numbers of a controller given as functions of time.

Any function of time may stand for a number of a controller (`control.Press`, `control.Opposition`,
`control.Carry`). Where such a function or a derivative of it jumps, an integration method loses its order
unless a step ends there. So jumps are *declared*: any part of a controller or of a load declares them by an
attribute `jumps` [s], as the classes here do. A run then ends a step just before each jump and begins anew
just after it, and its derivative with respect to the time of the jump is right (`_integration/_jumps`). What
is not declared is integrated as if it were smooth: the method loses its order, and may step over a jump.
"""

import abc
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._closures import as_tree
from ._fields import real, taken, through
from ._linalg import larger, smaller
from ._printing import listed
from ._results import as_array, check_callable, check_finite, concrete, shown, traced
from ._types import Given, Scalar

__all__ = ("AbstractSchedule", "Declared", "Ramps", "Steps")


# What the tab key offers: not the names that are imported here.
def __dir__() -> tuple[str, ...]:
    return __all__


def _as_rising(name: str, times: Array) -> Array:
    """Raise unless there are one or more times, and they rise."""
    seen = concrete(times)
    if not times.shape[0] or seen is not None and not (seen[1:] > seen[:-1]).all():
        raise ValueError(f"argument {name} must hold one time or more, and rise, but was {shown(times)}")
    return times


def _as_function(name: str, value: Any) -> Any:
    """A function of time as a pytree."""
    return as_tree(name, check_callable(name, value, "a function of time", takes=1))


def _as_finite(name: str, values: Any) -> Array:
    """Finite numbers of any shape."""
    return check_finite(name, as_array(name, values))


def _check_count(values: Array, count: int, words: str) -> None:
    """Raise unless there are so many values along the first axis."""
    if values.shape[:1] != (count,):
        raise ValueError(
            f"argument values must hold {words}, {count} along their first axis, but had shape {values.shape}"
        )


def _in_order(times: Array, values: Array) -> Array:
    """The values; NaN where JAX traces times, which nobody can refuse then, and these do not rise."""
    return jnp.where(jnp.all(times[1:] > times[:-1]), values, jnp.nan) if traced(times) else values


class AbstractSchedule(eqx.Module):
    """A function of time given by values at times, and all of these times are its jumps."""

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"times": "s"}

    times: eqx.AbstractVar[Float[Array, " k"]]
    values: eqx.AbstractVar[Float[Array, "..."]]

    @property
    def jumps(self) -> Float[Array, " k"]:
        """When it, or its slope, jumps [s]."""
        return self.times

    @abc.abstractmethod
    def __call__(self, t: Scalar) -> Array:
        """The value at a time [s]."""


class Steps(AbstractSchedule):
    """A value that jumps: before the first time it is the first value, from then on the second, and so on.

    Args:
        times: Shape (k,), when it jumps [s]; rising. Differentiable.
        values: Shape (k + 1, ...): what it is before, between and after the times. Differentiable.

    Raises:
        ValueError: If times do not rise, or there is not one value more than there are times. Of times that
            JAX traces and that do not rise all values are NaN.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> harder = grasp.with_(force=jxr.commands.Steps([0.5], [0.5, 0.8]))
        >>> float(harder.controller.at(0.7).force)
        0.8
    """

    times: Float[Array, " k"] = real(None, check=_as_rising)
    values: Float[Array, "..."] = through(_as_finite)

    def __init__(self, times: Given, values: Given) -> None:
        self.times = taken(self, "times", times)
        self.values = taken(self, "values", values)
        _check_count(self.values, self.times.shape[0] + 1, "one value more than there are times")
        self.values = _in_order(self.times, self.values)

    def __call__(self, t: Scalar) -> Array:
        value = self.values[0]
        for i in range(self.times.shape[0]):
            value = jnp.where(t >= self.times[i], self.values[i + 1], value)
        return value


class Ramps(AbstractSchedule):
    """A value on straight lines from one to the next, at rest before the first and after the last.

    Args:
        times: Shape (k,), when it has the values [s]; rising. Differentiable.
        values: Shape (k, ...). Differentiable.

    Raises:
        ValueError: If times do not rise, or there are not as many values. Of times that JAX traces and that
            do not rise all values are NaN.

    Example:
        >>> import jaxroll as jxr
        >>> slowly = jxr.commands.Ramps([0.0, 1.0], [0.5, 0.8])
        >>> float(slowly(0.5))
        0.65
    """

    times: Float[Array, " k"] = real(None, check=_as_rising)
    values: Float[Array, "..."] = through(_as_finite)

    def __init__(self, times: Given, values: Given) -> None:
        self.times = taken(self, "times", times)
        self.values = taken(self, "values", values)
        _check_count(self.values, self.times.shape[0], "as many values as there are times")
        self.values = _in_order(self.times, self.values)

    def __call__(self, t: Scalar) -> Array:
        value = self.values[0]
        for i in range(self.times.shape[0] - 1):
            share = (t - self.times[i]) / (self.times[i + 1] - self.times[i])
            rise = self.values[i + 1] - self.values[i]
            # Each piece adds its rise: nothing before it begins, all of it once it is over.
            value = value + smaller(larger(share, 0.0), 1.0) * rise
        return value


class Declared(eqx.Module):
    """Any function of time, with the times of its jumps.

    Args:
        function: `function(t)`, any callable pytree.
        jumps: Shape (k,), when it or a derivative of it jumps [s]. At a jump it must have its later value.
            A derivative with respect to these times is right if `function` jumps at them.

    Example:
        >>> import jax.numpy as jnp
        >>> import jaxroll as jxr
        >>> square = jxr.commands.Declared(lambda t: jnp.where(t % 0.2 < 0.1, 0.5, 0.6), [0.1, 0.2, 0.3])
        >>> float(square(0.15))
        0.6
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"jumps": "s"}

    function: Callable[[Any], Any] = through(_as_function)
    jumps: Float[Array, " k"] = real(None)

    def __init__(self, function: Callable[[Any], Any], jumps: Given) -> None:
        self.function = taken(self, "function", function)
        self.jumps = taken(self, "jumps", jumps)

    def __call__(self, t: Scalar) -> Any:
        return self.function(t)
