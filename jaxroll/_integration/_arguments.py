"""Checks of the arguments of `simulate`, and their conversion on the host.

An argument may be a tracer, without a value: `concrete` then returns None, and only its shape is checked.
"""

import functools
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import diffrax
import jax
import jax.core
import jax.numpy as jnp
import numpy as np

from .._motion import closed_within
from .._results import as_array, as_count, check_instance, concrete, shown, told_apart, traced

# What diffrax calls these, for the signatures of packages that leave diffrax to this one.
Solver = diffrax.AbstractSolver[Any]
StepSizeControl = diffrax.AbstractStepSizeController[Any, Any]
ProgressMeter = diffrax.AbstractProgressMeter[Any]
RECORDS = ("multipliers", "energy", "dense")
# Default relative tolerance.
RTOL = 1e-8
# Sweeps of the projection at the end of a step, at most.
SWEEPS = 2
# Smallest relative tolerance in single precision: below it rounding is the larger error, and steps collapse.
_FLOAT32_FLOOR = 1e-5
# Steps are counted in 32-bit integers unless JAX is set to 64 bits.
_MOST_STEPS = 2**31 - 2
# What integrates a run unless told; made once, as it takes a tenth of a short run's time.
_DEFAULT = diffrax.Dopri8()
# The largest number of save times that `save_times` will make.
_MOST_TIMES = 10**7


class Numbers(NamedTuple):
    """The numbers of a run, which are arguments of the compiled program: new values do not recompile it."""

    t0: Any
    t1: Any
    ts: Any
    dt0: Any
    rtol: Any
    atol: Any


def as_numbers(
    t0: Any, t1: Any, ts: Any, *, dt0: Any, rtol: Any, atol: Any, control: Any, dtype: np.dtype
) -> Numbers:
    """Times, first step and tolerances, checked; an adaptive step-size control has its own tolerances."""
    given = {"dt0": dt0, "rtol": rtol, "atol": atol, "control": control, "dtype": dtype}
    # The answer for Python's own numbers, which most calls give, is kept: finding it takes as long as a run.
    absolute = rtol if atol is None else atol
    if control is None and all(map(_plain, (t0, t1, ts, dt0, rtol, absolute))):
        return _kept_numbers(t0, t1, ts, **given)
    return _numbers(t0, t1, ts, **given)


def _numbers(
    t0: Any, t1: Any, ts: Any, *, dt0: Any, rtol: Any, atol: Any, control: Any, dtype: np.dtype
) -> Numbers:
    """`as_numbers`, worked out."""
    t0, t1, ts = save_times(t0, t1, ts, dtype)
    relative, absolute = _tolerances(rtol, atol, control, dtype)
    dt0 = _scalar("dt0", dt0, dtype)
    _check_positive("dt0", dt0)
    seen = concrete((t0, dt0))
    if seen is not None and not seen[0] + seen[1] > seen[0]:
        raise ValueError(f"argument dt0 must be long enough to move time from {t0:g} s, but was {dt0:g}")
    return Numbers(t0, t1, ts, dt0, relative, absolute)


def sweeps(numbers: Numbers, own_control: bool) -> int:
    """How often the end of a step returns to the constraints.

    A gap g that the step's error has left becomes one of order g^2 with the first sweep, g^3 with the second
    (`_motion._projection.settle`). Of the ready-made scenes a ball that rolls over a plane has the longest
    steps and leaves most: with one sweep rounding errors at the default tolerance and 3e-13 m at a hundred
    times that, with two sweeps rounding errors up to a tolerance of 1e-4 (`tests/test_rolling_bodies.py`).
    The second sweep takes a sixth of the time to compile. Where tolerances are not known before compiling,
    there are two.
    """
    seen = None if own_control else concrete((numbers.rtol, numbers.atol))
    return 1 if seen is not None and max(seen) <= RTOL else SWEEPS


# An int counts and a float is a time, although 2 == 2.0: the cache tells their types apart.
_kept_numbers = functools.lru_cache(maxsize=64, typed=True)(_numbers)


def _plain(value: Any) -> bool:
    """Whether a value is a Python float, or an int that a float holds exactly."""
    return type(value) is float or type(value) is int and abs(value) < 2**53


def as_number(name: str, value: Any, dtype: np.dtype) -> Any:
    """Numbers as a NumPy array unless they are traced: an operation of JAX would cost 20 us."""
    listed = type(value) in (list, tuple) and all(map(_plain, value))
    # By `type`, not `isinstance`: masked arrays and other subclasses go to `as_array`, which refuses them.
    known = type(value) is np.ndarray and value.dtype.kind in "fiu"
    if _plain(value) or listed or known:
        return np.asarray(value, dtype)
    array = as_array(name, value)
    return jnp.asarray(array, dtype) if isinstance(array, jax.core.Tracer) else np.asarray(array, dtype)


def _scalar(name: str, value: Any, dtype: np.dtype) -> Any:
    """One finite number."""
    number = as_number(name, value, dtype)
    if np.ndim(number):
        raise ValueError(f"argument {name} must be one number, but had shape {np.shape(number)}")
    seen = concrete(number)
    if seen is not None and not np.isfinite(seen):
        raise ValueError(f"argument {name} must be finite, but was {shown(value)}")
    return number


def _check_positive(name: str, number: Any) -> None:
    seen = concrete(number)
    if seen is not None and not seen > 0:
        raise ValueError(f"argument {name} must be positive, but was {seen:g}")


def save_times(t0: Any, t1: Any, ts: Any, dtype: np.dtype) -> tuple[Any, Any, Any]:
    """Start, end and save times [s], checked; `ts` holds the save times, or says how many."""
    start, end = _scalar("t0", t0, dtype), _scalar("t1", t1, dtype)
    bounds = concrete((start, end))
    if bounds is not None and not bounds[1] > bounds[0]:
        first, was = told_apart(*bounds)
        raise ValueError(f"argument t1 must be above t0 = {first}, but was {was}")
    if not isinstance(ts, int | np.integer) or isinstance(ts, bool):
        saved = as_number("ts", ts, dtype)
        check_times(saved, bounds)
        return start, end, saved
    ts = as_count("ts", ts, most=_MOST_TIMES)
    share = np.linspace(0.0, 1.0, ts, dtype=dtype) if ts > 1 else np.ones(1, dtype)
    return start, end, start * (1 - share) + end * share


def check_times(saved: Any, bounds: np.ndarray | None = None) -> None:
    """Raise unless save times are one or more, rise and lie within these bounds."""
    if np.ndim(saved) != 1 or not np.size(saved):
        raise ValueError(
            f"argument ts must be a number of times, or times of shape (t,), but had shape {np.shape(saved)}"
        )
    seen = concrete(saved)
    if seen is None:
        return
    if not np.all(np.isfinite(seen)):
        raise ValueError(f"argument ts must be finite, but was {shown(seen)}")
    if not np.all(np.diff(seen) > 0):
        raise ValueError(f"argument ts must rise strictly, but was {shown(seen)}")
    if bounds is not None and (seen[0] < bounds[0] or seen[-1] > bounds[1]):
        low, high, first, last = told_apart(*bounds, seen[0], seen[-1])
        raise ValueError(f"argument ts must lie within [{low}, {high}], but ran from {first} to {last}")


def ordered_times(numbers: Numbers) -> Any:
    """Whether traced times rise from start to end and the first step moves time; None where all are known."""
    t0, t1, ts, dt0 = numbers[:4]
    if not traced(numbers[:4]):
        return None
    rises = jnp.all(ts[1:] >= ts[:-1]) & (ts[0] >= t0) & (ts[-1] <= t1) & (t1 > t0)
    return rises & jnp.isfinite(t0) & jnp.isfinite(t1) & jnp.isfinite(dt0) & (t0 + dt0 > t0)


def unclosed(off: Any) -> str:
    """What is said of a start whose worst row is so far off the constraints [m or rad]."""
    return (
        f"argument state must be on the constraints to {closed_within(off.dtype):g}, but its worst row "
        f"is {float(off):.3g} m or rad off; jaxroll.close makes it consistent"
    )


def check_choices(name: str, given: Any, known: tuple[str, ...]) -> tuple[str, ...]:
    """Raise unless every name given is known."""
    if isinstance(given, str):
        example = given if given in known else known[0]
        raise ValueError(
            f"argument {name} must be a tuple of names, such as ({example!r},), "
            f"but was the string {shown(given)}"
        )
    no_names = (bytes, Mapping, np.ndarray, jax.Array)
    several = isinstance(given, Collection) and not isinstance(given, no_names)
    if not several or any(not isinstance(item, str) or item not in known for item in given):
        raise ValueError(f"argument {name} must be among {known}, but was {shown(given)}")
    return tuple(given)


def _tolerances(rtol: Any, atol: Any, control: Any, dtype: np.dtype) -> tuple[Any, Any]:
    """Relative and absolute tolerance: those of an adaptive step-size control, if the caller gave one."""
    relative = tolerance("rtol", rtol, dtype)
    absolute = tolerance("atol", rtol if atol is None else atol, dtype)
    if not isinstance(control, diffrax.AbstractAdaptiveStepSizeController):
        return relative, absolute
    inside = "stepsize_controller.{}".format
    own = [tolerance(inside(name), getattr(control, name), dtype) for name in ("rtol", "atol")]
    # An rtol equal to the default cannot be told from one that was not given.
    left = type(rtol) is float and rtol == RTOL
    given = (None if left else relative, None if atol is None else absolute)
    for name, asked, has in zip(("rtol", "atol"), given, own, strict=True):
        seen = None if asked is None else concrete((asked, has))
        if seen is not None and seen[0] != seen[1]:
            was, its = told_apart(*seen)
            raise ValueError(
                f"argument {name} must be left to the stepsize_controller, whose own is {its}, but was {was}"
            )
    return own[0], own[1]


def tolerance(name: str, value: Any, dtype: np.dtype) -> Any:
    """A tolerance, positive, below one where it is relative, and one that the precision can meet."""
    number = _scalar(name, value, dtype)
    _check_positive(name, number)
    seen = concrete(number)
    if seen is None:
        # With a tolerance of NaN no step is accepted, so that what nobody can refuse yet is no success.
        allowed = number > 0 if name.endswith("atol") else (number > 0) & (number < 1)
        return jnp.where(allowed, number, jnp.nan)
    if name.endswith("atol"):
        return number
    if not seen < 1:
        raise ValueError(f"argument {name} must be below 1, but was {told_apart(1.0, seen)[1]}")
    if dtype == np.float32 and seen < np.float32(_FLOAT32_FLOOR):
        floor, was = told_apart(_FLOAT32_FLOOR, seen)
        remedy = (
            "give the grasp and its state numbers of it"
            if jnp.result_type(float) == np.float64
            else "put jax.config.update('jax_enable_x64', True) first"
        )
        raise ValueError(
            f"argument {name} must be at least {floor} in single precision, but was {was}; "
            f"for double precision {remedy}"
        )
    return number


def check_control(control: Any) -> Any:
    """Raise unless a step-size control is None, constant, or adapts and lets steps be cut short."""
    name, constant = "stepsize_controller", diffrax.ConstantStepSize
    if control is None or type(control) is constant:
        return control
    kinds = diffrax.AbstractAdaptiveStepSizeController
    check_instance(name, control, kinds, "diffrax.ConstantStepSize() or an adaptive one, for ts holds times")
    if isinstance(control, diffrax.ClipStepSizeController):
        raise ValueError(f"argument {name} must leave times to ts, where steps end, but was {shown(control)}")
    if isinstance(control, diffrax.PIDController) and control.dtmin is not None:
        raise ValueError(
            f"argument {name} must have no dtmin, which takes steps whatever their error, "
            f"but its dtmin was {shown(control.dtmin)}"
        )
    return control


def check_meter(meter: Any) -> Any:
    """Raise unless a progress meter is one of diffrax's kind."""
    if meter is not None:
        check_instance("progress_meter", meter, diffrax.AbstractProgressMeter, "a diffrax progress meter")
    return meter


def check_solver(solver: Any) -> diffrax.AbstractSolver:
    """The default, or what was given if it is a diffrax solver at all."""
    if solver is None:
        return _DEFAULT
    return check_instance("solver", solver, diffrax.AbstractSolver, "a diffrax solver")


def step_limit(value: Any) -> int:
    """How many steps to attempt at most."""
    return as_count("max_steps", value, most=_MOST_STEPS)
