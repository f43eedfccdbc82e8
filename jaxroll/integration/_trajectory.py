"""The outcome of a run."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from .._results import concrete, message, RESULTS
from .._types import Times
from ..mechanics import State
from ._observe import Energy, Multipliers, Residuals


class Stats(eqx.Module):
    """How the run went.

    Attributes:
        steps: Attempted steps.
        accepted: Accepted steps.
        rejected: Rejected steps.
        t_end: Time that the run reached [s].
    """

    steps: Int[Array, ""]
    accepted: Int[Array, ""]
    rejected: Int[Array, ""]
    t_end: Float[Array, ""]


class Trajectory(eqx.Module):
    """States at the saved times, with what is needed to judge them.

    Under `vmap` every leaf gains a leading axis, `result` included: one code per lane. Rows after
    the end of a failed run hold NaN; `last` is the final state it reached in any case.

    Attributes:
        ts: Shape (t,), saved times [s].
        states: `State` with leading axis t.
        last: `State` where the run ended.
        residuals: Constraint residuals at the saved times.
        result: Result code of `jaxroll.RESULTS`.
        stats: Steps taken, and how far.
        multipliers: Contact forces at the saved times, if recorded.
        energy: Energy balance at the saved times, if recorded.
    """

    ts: Times
    states: State
    last: State
    residuals: Residuals
    result: RESULTS
    stats: Stats
    multipliers: Multipliers | None = None
    energy: Energy | None = None

    def __str__(self) -> str:
        if concrete(self.stats.steps) is None:
            return "Trajectory (being traced)"
        if np.ndim(self.stats.steps):
            return _batch_report(self)
        return _report(self)


def _report(run: Trajectory) -> str:
    stats, left = run.stats, run.residuals
    saved = np.isfinite(np.asarray(run.states.q)).all(axis=-1)
    if not saved.any():
        return f"Trajectory: {message(run.result)}\n  nothing saved; ended at {float(stats.t_end):.6g} s"
    ts = np.asarray(run.ts)[saved]
    lines = [
        f"Trajectory: {message(run.result)}",
        f"  time      {_span(ts)} s, {saved.sum()} of {saved.size} states saved"
        f"; ended at {float(stats.t_end):.6g} s",
        f"  steps     {int(stats.accepted)} accepted, {int(stats.rejected)} rejected",
        f"  residuals gap {_peak(left.normal, left.tangential):.1e} m"
        f", tangency {_peak(left.tangency):.1e} rad",
        *(_motion3(run.states.q) if left.tangential.ndim > left.normal.ndim else _motion(run.states)),
    ]
    if run.multipliers is not None:
        f, lam = np.asarray(run.multipliers.f), np.asarray(run.multipliers.lam)
        lam = np.linalg.norm(lam, axis=-1) if lam.ndim > f.ndim else lam
        lines.append(
            f"  forces    normal {np.nanmin(f):.4g} to {np.nanmax(f):.4g} N"
            f", tangential {np.nanmin(lam):.4g} to {np.nanmax(lam):.4g} N"
        )
    if run.energy is not None:
        scale = np.nanmax(np.abs(np.asarray(run.energy.kinetic + run.energy.potential)))
        lines.append(f"  energy    balance within {_peak(run.energy.residual) / scale:.1e} of its size")
    return "\n".join(lines)


def _batch_report(runs: Trajectory) -> str:
    codes = np.asarray(runs.result._value)
    lines = [f"Trajectory of {codes.size} lanes, {int(np.sum(runs.stats.accepted))} accepted steps"]
    for code in np.unique(codes):
        item = eqx.tree_at(lambda r: r._value, runs.result, np.asarray(code))
        lines.append(f"  {int(np.sum(codes == code))} lanes: {message(item)}")
    return "\n".join(lines)


def _span(ts: np.ndarray) -> str:
    return f"{ts[0]:g} to {ts[-1]:g}"


def _peak(*arrays: Array) -> float:
    return max(float(np.nanmax(np.abs(np.asarray(a)))) for a in arrays)


def _motion(states: State) -> list[str]:
    return [f"  rolled    {_range(states.s)} mm", f"  turned    {_turns(states.q)} rad"]


def _motion3(q: Array) -> list[str]:
    """In space: way of the object, and the angle between its first and its last orientation."""
    seen = np.asarray(q)[np.isfinite(np.asarray(q)).all(axis=-1)][[0, -1]]
    moved = ", ".join(f"{x:+.3f}" for x in np.round(1e3 * (seen[1, :3] - seen[0, :3]), 3) + 0.0)
    start, end = seen[:, 3:7] / np.linalg.norm(seen[:, 3:7], axis=1, keepdims=True)
    half = np.arctan2(np.linalg.norm(_turn_between(start, end)), abs(start @ end))
    return [f"  object    moved {moved} mm, turned by {2.0 * half:.4f} rad"]


def _turn_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Vector part of the quaternion from one orientation to another."""
    return start[0] * end[1:] - end[0] * start[1:] - np.cross(end[1:], start[1:])


def _range(s: Array) -> str:
    travel = 1e3 * np.ptp(np.asarray(s)[np.isfinite(np.asarray(s)).all(axis=-1)], axis=0)
    return ", ".join(f"{x:.3f}" for x in travel)


def _turns(q: Array) -> str:
    seen = np.asarray(q)[np.isfinite(np.asarray(q)).all(axis=-1)]
    return ", ".join(f"{x:+.4f}" for x in seen[-1] - seen[0])
