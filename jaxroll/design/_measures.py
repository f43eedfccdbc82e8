"""How good a run is: settling time, overshoot, tracking error, peak force, friction demand; differentiable.

All look at the saved states that the run reached; save some tens of states over the time of interest, the
start among them: "first" is the first saved one, from which times count, and "last" the last one. A run that
ended early has not come to rest: what is measured against its last value is not a number then. `ClosedLoop`
needs a finite cost of such runs, and uses the measures in `PARTIAL`, of the part that was reached.

Arrays keep their length when a run ends early, and hold NaN from there on. A NaN in a branch that `jnp.where`
does not choose still makes the gradient NaN: so NaNs are replaced first (`_reached`, `_forces`), and the
places masked later.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._integration import check_one_run, Trajectory
from .._linalg import larger, largest
from .._motion import Multipliers
from .._results import as_array, as_positive, is_array_like, RESULTS, shown, traced
from .._types import Scalar
from .._xla import quickly

Signal = Float[Array, "t k"]


def settling_time(run: Trajectory, *, band: float = 0.02, signal: Signal | None = None) -> Scalar:
    r"""Time [s] after which a signal stays near its last value, counted from the first saved state.

    The last time at which $|y(t) - y_1|$ is above `band` times $|y_0 - y_1|$, on straight lines between the
    saved states; $y_0$ and $y_1$ belong to the first and the last of these. Its derivative is that of this
    time; the time jumps where one more swing leaves the band. Zero for a signal that ends where it began; not
    a number for a run that ended early, or a signal that holds NaN.

    Args:
        run: One run.
        band: Share of the way.
        signal: Shape (t, k), NaN where it is not known. Default: the contact coordinates.

    Returns:
        One number [s].

    Raises:
        ValueError: If `run` is no run, a batch or of one saved state, `band` is not positive, or `signal`
            does not fit the run.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=3.0)
        >>> f"{jxr.design.settling_time(run):.2f} s"
        '1.60 s'
    """
    return _of_whole(_settling, run, _checked(run, signal), as_positive("band", band))


def _settling(run: Trajectory, signal: Signal | None = None, band: Scalar | float = 0.02) -> Scalar:
    """`settling_time` of the part of a run that was reached."""
    seen, left, whole = _approach(run, signal)
    limit = band * whole
    outside = seen & (left > limit)
    # The last state outside of the band, and the one after it, inside: between them the distance is taken as
    # a straight line, so that the time has a derivative although the indices have none.
    last = jnp.max(jnp.where(outside, jnp.arange(left.shape[0]), 0))
    after = jnp.minimum(last + 1, jnp.sum(seen) - 1)
    drop = left[last] - left[after]
    share = jnp.where(drop > 0.0, (left[last] - limit) / jnp.where(drop > 0.0, drop, 1.0), 0.0)
    time = run.ts[last] + (run.ts[after] - run.ts[last]) * share - run.ts[0]
    return jnp.where(jnp.any(outside), time, 0.0)


def overshoot(run: Trajectory, *, signal: Signal | None = None) -> Scalar:
    r"""By how much a signal goes past its last value, as a share of the way there.

    The largest of $-(y(t) - y_1) \cdot (y_0 - y_1) / |y_0 - y_1|^2$, at least zero; $y_0$ and $y_1$ belong to
    the first and the last saved state; not a number for a run that ended early, or a signal that holds NaN.

    Args:
        run: One run.
        signal: Shape (t, k), NaN where it is not known. Default: the contact coordinates.

    Returns:
        One number, without a unit.

    Raises:
        ValueError: If `run` is no run, a batch or of one saved state, or `signal` does not fit it.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=3.0)
        >>> f"{jxr.design.overshoot(run):.3f}"
        '0.000'
    """
    return _of_whole(_overshoot, run, _checked(run, signal))


def _overshoot(run: Trajectory, signal: Signal | None = None) -> Scalar:
    """`overshoot` of the part of a run that was reached."""
    seen, y = _reached(run, signal)
    # The way back from the last value to the first one: what lies against it has gone past the last value.
    way = y[:1] - _last(seen, y)
    size = jnp.sum(way * way)
    past = -jnp.sum((y - _last(seen, y)) * way, axis=-1) / jnp.where(size > 0.0, size, 1.0)
    return larger(largest(jnp.where(seen, past, 0.0)), 0.0)


def tracking_error(run: Trajectory, *, signal: Signal | None = None) -> Scalar:
    r"""Mean time to the end [s], $\int |y(t) - y_1| dt / |y_0 - y_1|$: smooth where `settling_time` jumps.

    For a signal that decays as $e^{-t/T}$ it is T. The integral runs from the first saved state, which $y_0$
    belongs to, to the last one, which $y_1$ belongs to; not a number for a run that ended early, or a signal
    that holds NaN.

    Args:
        run: One run.
        signal: Shape (t, k), NaN where it is not known. Default: the contact coordinates.

    Returns:
        One number [s].

    Raises:
        ValueError: If `run` is no run, a batch or of one saved state, or `signal` does not fit it.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=3.0)
        >>> f"{jxr.design.tracking_error(run):.3f} s"
        '0.626 s'
    """
    return _of_whole(_tracking, run, _checked(run, signal))


def _tracking(run: Trajectory, signal: Signal | None = None) -> Scalar:
    """`tracking_error` of the part of a run that was reached: the integral by the trapezoidal rule."""
    seen, left, whole = _approach(run, signal)
    pairs = 0.5 * (left[1:] + left[:-1]) * jnp.diff(run.ts)
    return jnp.sum(jnp.where(seen[1:], pairs, 0.0)) / jnp.where(whole > 0.0, whole, 1.0)


def peak_force(run: Trajectory) -> Scalar:
    """Largest normal force of any contact [N]; the run must have recorded its multipliers.

    Returns:
        One number [N]; not a number for a run that ended before the first saved time.

    Raises:
        ValueError: If `run` is no run or a batch, or did not record its multipliers.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=0.5, ts=51, record=("multipliers",))
        >>> f"{jxr.design.peak_force(run):.3f} N"
        '1.551 N'
    """
    _check_forces(run)
    return _of_some(_peak, run)


def _peak(run: Trajectory) -> Scalar:
    """`peak_force` of the part of a run that was reached, zero if that is nothing."""
    forces, seen = _forces(run)
    return largest(jnp.where(seen, forces.f, 0.0))


def friction_demand(run: Trajectory) -> Scalar:
    r"""Friction coefficient that rolling needs, $\max |\lambda| / f$; the run must have recorded its forces.

    Only contacts count that press, $f > 0$, at each saved state: where one pulls no coefficient would do, so
    that the demand of a contact that always pulls is zero. Printed runs say which contact pulls, and a run
    whose `events` name 'lift' ends there.

    Returns:
        One number, without a unit; not a number for a run that ended before the first saved time.

    Raises:
        ValueError: If `run` is no run or a batch, or did not record its multipliers.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=0.5, ts=51, record=("multipliers",))
        >>> f"{jxr.design.friction_demand(run):.3f}"
        '0.171'
    """
    _check_forces(run)
    return _of_some(_demand, run)


def _demand(run: Trajectory) -> Scalar:
    """`friction_demand` of the part of a run that was reached, zero if that is nothing."""
    forces, seen = _forces(run)
    aside = forces.lam
    if aside.ndim > forces.f.ndim:  # in space
        squared = jnp.sum(aside * aside, axis=-1)
        # The root has no derivative at zero: it is taken of one there, and the result set to zero.
        aside = jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0)) * (squared > 0.0)
    pressing = seen & (forces.f > 0.0)
    return largest(jnp.where(pressing, jnp.abs(aside) / jnp.where(pressing, forces.f, 1.0), 0.0))


# Each measure is compiled as one program: of single operations a first call would compile dozens.


@quickly
def _of_whole(measure: Callable[..., Scalar], run: Trajectory, signal: Signal, *given: Any) -> Scalar:
    """A measure of a run that reached its end; else not a number, with a derivative of zero.

    So is one of a signal that is not known throughout, whose first and last values may be missing.
    """
    known = (run.result == RESULTS.successful) & jnp.all(jnp.isfinite(signal))
    return jnp.where(known, measure(run, signal, *given), jnp.nan)


@quickly
def _of_some(measure: Callable[..., Scalar], run: Trajectory) -> Scalar:
    """A measure of a run that reached a saved time; else not a number, with a derivative of zero."""
    return jnp.where(jnp.any(_forces(run)[1]), measure(run), jnp.nan)


def _check_forces(run: Trajectory) -> Multipliers:
    """The contact forces of a run; raise unless it holds some for each of its times."""
    check_one_run("run", run)
    if run.multipliers is None:
        raise ValueError("argument run must have recorded its multipliers, but has none")
    for value in jax.tree.leaves(run.multipliers):
        if not is_array_like(value) or value.dtype.kind != "f":
            raise ValueError(f"argument run must hold real numbers as multipliers, but had {shown(value)}")
    if run.multipliers.f.shape[:1] != run.ts.shape:
        raise ValueError(
            f"argument run must hold forces for each of its {len(run.ts)} times, but had "
            f"{shown(run.multipliers.f.shape)}"
        )
    return run.multipliers


def _forces(run: Trajectory) -> tuple[Multipliers, Array]:
    """Contact forces, zero where they are not known, and where they are known."""
    recorded = _check_forces(run)
    seen = jnp.isfinite(recorded.f)
    f = jnp.where(seen, recorded.f, 0.0)
    known = seen.reshape(*seen.shape, *(1,) * (recorded.lam.ndim - f.ndim))
    lam = jnp.where(known, recorded.lam, 0.0)
    return Multipliers(f, lam), seen  # no measure asks for the torques that prevent spin


def _checked(run: Trajectory, signal: Signal | None) -> Array:
    """The signal as an array, shape (t, k), by default the contact coordinates; raise unless it fits."""
    check_one_run("run", run)
    y = run.states.s if signal is None else as_array("signal", signal)
    if y.ndim not in (1, 2) or y.shape[0] != run.states.q.shape[0] or not y.size:
        raise ValueError(
            f"argument signal must have shape ({run.states.q.shape[0]}, any), but had shape {y.shape}"
        )
    if y.shape[0] < 2:
        raise ValueError("argument run must have saved two states or more, but saved one")
    if not traced(y) and np.isinf(np.asarray(y)).any():
        raise ValueError(f"argument signal must hold numbers, NaN where there is none, but was {shown(y)}")
    return y[:, None] if y.ndim == 1 else y


def _reached(run: Trajectory, signal: Signal | None) -> tuple[Array, Array]:
    """Which saved states were reached, shape (t,), and the signal, shape (t, k), zero where they were not."""
    y = _checked(run, signal)
    seen = jnp.all(jnp.isfinite(y), axis=-1) & run.reached
    return seen, jnp.where(seen[:, None], y, 0.0)


def _last(seen: Array, y: Array) -> Array:
    """The signal at the last state that was reached, shape (1, k)."""
    return y[jnp.maximum(jnp.sum(seen) - 1, 0)][None]


def _approach(run: Trajectory, signal: Signal | None) -> tuple[Array, Array, Array]:
    """Which states were reached, the signal's distance from its last value, and that of the first one."""
    seen, y = _reached(run, signal)
    squared = jnp.sum((y - _last(seen, y)) ** 2, axis=-1)
    apart = seen & (squared > 0.0)
    left = jnp.where(apart, jnp.sqrt(jnp.where(apart, squared, 1.0)), 0.0)
    return seen, left, left[0]


MEASURES = {
    "settling_time": (settling_time, "settling time [s]"),
    "overshoot": (overshoot, "overshoot"),
    "tracking_error": (tracking_error, "tracking error [s]"),
    "peak_force": (peak_force, "peak force [N]"),
    "friction_demand": (friction_demand, "friction demand"),
}
# The same measures of the part of a run that was reached: finite however it ended, as a search needs.
PARTIAL = {
    "settling_time": _settling,
    "overshoot": _overshoot,
    "tracking_error": _tracking,
    "peak_force": _peak,
    "friction_demand": _demand,
}
# Those measured against the value at rest, which a run that ended early has not reached.
SETTLED = frozenset(("settling_time", "overshoot", "tracking_error"))
# Those that need the contact forces.
FORCED = frozenset(("peak_force", "friction_demand"))
