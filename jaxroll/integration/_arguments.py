"""Checks of the arguments of `simulate`, and their conversion on the host."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from .._results import concrete

RECORDS = ("multipliers", "energy")
OPTIONS = ("atol", "dt0", "max_steps", "stepsize_controller", "progress_meter", "events")
# Below this relative tolerance single precision cannot deliver: steps collapse.
_FLOAT32_FLOOR = 1e-5


def as_number(value: Any, dtype: np.dtype) -> Any:
    """A number as an array, on the host where that is possible: a jnp operation costs 20 us."""
    seen = concrete(value)
    return jnp.asarray(value, dtype) if seen is None else np.asarray(seen, dtype)


def save_times(t0: Any, t1: Any, ts: Any, dtype: np.dtype) -> tuple[Any, Any, Any]:
    """Start, end and save times, checked; `ts` may be their number."""
    start, end = as_number(t0, dtype), as_number(t1, dtype)
    bounds = concrete((start, end))
    if bounds is not None and not bounds[1] > bounds[0]:
        raise ValueError(f"argument t1 must be above t0 = {bounds[0]:g}, but was {bounds[1]:g}")
    if not isinstance(ts, int):
        saved = as_number(ts, dtype)
        _check_times(saved, bounds)
        return start, end, saved
    if ts < 1:
        raise ValueError(f"argument ts must be at least 1 time, but was {ts}")
    share = np.linspace(0.0, 1.0, ts, dtype=dtype) if ts > 1 else np.ones(1, dtype)
    return start, end, start * (1 - share) + end * share


def _check_times(saved: Any, bounds: np.ndarray | None) -> None:
    if np.ndim(saved) != 1:
        raise ValueError(f"argument ts must have shape (t,), but had shape {np.shape(saved)}")
    seen = concrete(saved)
    if seen is None:
        return
    if not (np.all(np.diff(seen) > 0) and np.all(np.isfinite(seen))):
        raise ValueError(f"argument ts must rise strictly, but was {seen.tolist()}")
    if bounds is not None and (seen[0] < bounds[0] or seen[-1] > bounds[1]):
        raise ValueError(
            f"argument ts must lie within [{bounds[0]:g}, {bounds[1]:g}], "
            f"but ran from {seen[0]:g} to {seen[-1]:g}"
        )


def check_choices(name: str, given: tuple[str, ...], known: tuple[str, ...]) -> None:
    """Raise unless every name given is known."""
    unknown = [item for item in given if item not in known]
    if isinstance(given, str) or unknown:
        raise ValueError(f"argument {name} must be among {known}, but was {given!r}")


def check_precision(dtype: Any, rtol: float) -> None:
    """Raise for a tolerance that is not positive, or that the precision cannot meet."""
    seen = concrete(rtol)
    if seen is not None and not seen > 0:
        raise ValueError(f"argument rtol must be positive, but was {seen:g}")
    if dtype == np.float32 and seen is not None and seen < _FLOAT32_FLOOR:
        raise ValueError(
            f"argument rtol must be at least {_FLOAT32_FLOOR:g} in single precision, but was {seen:g}; "
            "for double precision put jax.config.update('jax_enable_x64', True) first"
        )
