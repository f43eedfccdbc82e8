"""The result of a run: `_simulate` makes a `Trajectory`, `_report` prints it, `check_one_run` checks one."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._mechanics import check_not_cut, Labels, reached, State
from .._motion import Energy, Multipliers, Residuals
from .._printing import code_name, listed, so_many
from .._results import as_array, check_instance, is_array_like, RESULTS, shown, traced
from .._types import Given, Times
from .._xla import quickly
from ._dataset import dataset_of
from ._dense import Dense, states_at
from ._report import batch_report, report


class Stats(eqx.Module):
    """How the run went.

    Attributes:
        steps: Attempted steps, with a first one of no length, which `max_steps` does not count.
        accepted: Accepted steps, with that first one.
        rejected: Rejected steps.
        t_end: Time that the run reached [s].
        contact: Which contact ended it, in case of 'penetration' and 'links_meet' which finger, of
            'joint_limit' and 'torque_limit' which joint, counted over all fingers; -1 where none did.
        margin: What ran out there, at the end: normal force or distance to the friction cone [N], distance to
            the end of a contour or to the object [m], to the end of a joint's range [rad or m], what torque
            is left [N m or N], what the relative sum of curvatures has beyond 1e-4, or a million times what
            the relative smallest pivot of A M^-1 A^T has beyond 1e-9; infinite where nothing did, and minus
            infinity where contacts could not answer a blow.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"t_end": "s"}
    AXES: ClassVar[dict[str, tuple[str, ...]]] = dict.fromkeys(
        ("steps", "accepted", "rejected", "t_end", "contact", "margin"), ()
    )

    steps: Int[Array, ""]
    accepted: Int[Array, ""]
    rejected: Int[Array, ""]
    t_end: Float[Array, ""]
    contact: Int[Array, ""]
    margin: Float[Array, ""]


class Trajectory(eqx.Module):
    """States at the saved times, with what is needed to judge them.

    Under `vmap` every leaf gains a leading axis, `result` included: one code per lane. Rows after
    the end of a failed run hold NaN, at which `jax_debug_nans` stops a program; `last` is the final state it
    reached in any case, and `filled()` puts it in their place, for losses. Printed, it says how the run went,
    and if it ended early which contact ended it, when, by how much, and what helps.

    Attributes:
        ts: Shape (t,), saved times [s].
        states: `State` with leading axis t.
        last: `State` where the run ended.
        residuals: Constraint residuals at the saved times.
        result: Result code of `jaxroll.RESULTS`.
        stats: Steps taken, how far, and what ended it.
        multipliers: Contact forces at the saved times, if recorded.
        impulses: With contact forces recorded, the contact impulses [N s] of every blow (`loads.Impulse`),
            with a leading axis of blows in the grasp's order; NaN of one that the run did not come to.
        energy: Energy balance at the saved times, if recorded.
        dense: Its steps, if 'dense' was recorded; `run(t)` reads them.
        labels: What its bodies, coordinates (with units) and contacts are called. Static.

    Runs of `jax.vmap` are one `Trajectory` whose fields have a leading axis of lanes; lane k is
    `jax.tree.map(lambda x: x[k], runs)`.
    """

    # What the names of its fields begin with in a table; `dense` and `labels` are not in one.
    PARTS: ClassVar[dict[str, str]] = {
        "states": "",
        "last": "last_",
        "residuals": "residual_",
        "result": "result",
        "stats": "",
        "multipliers": "",
        "energy": "energy_",
        "impulses": "impulse_",
    }

    ts: Times
    states: State
    last: State
    residuals: Residuals
    result: RESULTS
    stats: Stats
    multipliers: Multipliers | None = None
    energy: Energy | None = None
    impulses: Multipliers | None = None
    dense: Dense | None = None
    labels: Labels | None = eqx.field(static=True, default=None)

    def __call__(self, t: Given) -> State:
        r"""States at any times, of a run that recorded 'dense': by one more step of its own method each.

        As accurate as saved states, on the constraints as they are, and of the method's own order in the
        step; what a step costs, per time, and compiled with the first call. Differentiable like saved states,
        and with respect to `t`. Before the start of a run and after its end states are NaN.

        Args:
            t: Times [s], of any shape, which comes first in what is returned.

        Raises:
            ValueError: If the run kept no steps, or is several runs: `jax.vmap(lambda run: run(t))(runs)`.

        Example:
            >>> import jaxroll as jxr
            >>> grasp, state = jxr.scenes.pivoted()
            >>> run = jxr.simulate(grasp, state, 1.0, record=("dense",))
            >>> run([0.1, 0.35]).q.shape
            (2, 3)
        """
        if self.dense is None:
            raise ValueError(
                "argument t must be given to a run that kept its steps, by `simulate(..., record=('dense',))`"
            )
        if self.dense.count.ndim:
            raise ValueError(
                f"argument t must be given to one run, but these were {self.dense.count.shape}; "
                "jax.vmap(lambda run: run(t))(runs) asks each"
            )
        check_not_cut("run", (self.ts.dtype,))
        return states_at(self.dense, as_array("t", t).astype(self.ts.dtype))

    @property
    def reached(self) -> Bool[Array, " t"]:
        """Which of the saved times the run reached, shape (t,): the rows of the others are NaN.

        Example:
            >>> import jaxroll as jxr
            >>> grasp, state = jxr.scenes.pivoted()
            >>> run = jxr.simulate(grasp, state, 1.0, ts=5, max_steps=30, throw=False)
            >>> run.reached.tolist(), bool(run.ts[run.reached][-1] < run.stats.t_end)
            ([True, True, False, False, False], True)
        """
        return jnp.asarray(reached(self.states))

    def filled(self) -> "Trajectory":
        r"""The same run with finite rows after an early end, for losses that an optimiser follows.

        States that the run did not reach are its `last` one; residuals, forces and energies those of the last
        row that it reached, zero if it reached none. All of it is differentiable: a run that stands still
        from $t_{end}$ on, where `last` and `stats.t_end` move with what is differentiated. A loss of filled
        rows alone may reward an early end; $t_1 - t_{end}$ beside it, times a weight, makes runs last.

        Example:
            >>> import jax.numpy as jnp
            >>> import jaxroll as jxr
            >>> grasp, state = jxr.scenes.pivoted()
            >>> run = jxr.simulate(grasp.with_(force=-0.5), state, 1.0, throw=False)  # it lets go at once
            >>> loss = jnp.mean(run.filled().states.q ** 2) + (1.0 - run.stats.t_end)
            >>> bool(jnp.isfinite(loss))
            True
        """
        parts = lambda run: (run.states, run.residuals, run.multipliers, run.energy)  # noqa: E731
        found = _all_filled(self.last, *parts(self))
        return eqx.tree_at(parts, self, found, is_leaf=lambda x: x is None)

    def to_xarray(self) -> Any:
        """The run as an `xarray.Dataset`: names, units and labels beside the numbers. Needs the extra `data`.

        Dimensions are `time`, `position`, `velocity`, `place` (contact coordinates), `contact` and, in space,
        `axis`; a batch has `lane` before them. Along `position`, `velocity` and `place` stand names such as
        'object theta' and, beside these, units (`position_unit`). Fields keep their names: `q`, `v`, `s`,
        `f`, `lam`; those of `last` are `last_q` and so on, of `residuals` `residual_normal`, of `energy`
        `energy_kinetic`; `stats.contact` is `ended_by`. Codes are whole numbers with the attributes
        `flag_values` and `flag_meanings`. Steps of `record=('dense',)` are left out. The dataset's own
        `to_netcdf(path, engine='h5netcdf')` and `to_zarr` write it to files.

        Raises:
            ImportError: Without the extra `data`.
            ValueError: While JAX is tracing the run.

        Example:
            >>> import jaxroll as jxr
            >>> grasp, state = jxr.scenes.pivoted()
            >>> table = jxr.simulate(grasp, state, 1.0).to_xarray()
            >>> theta = table.q.sel(position="object theta")
            >>> theta.dims, str(theta.position_unit.values), table.time.attrs["units"]
            (('time',), 'rad', 's')
        """
        return dataset_of(self)

    def __str__(self) -> str:
        if traced(self):  # a derivative traces what moves alone, and so not the counts
            return "Trajectory (being traced)"
        if isinstance(self.stats.steps, jax.ShapeDtypeStruct):
            return "Trajectory (shapes alone)"  # as `jax.eval_shape` gives it
        parts = self.ts, self.states.q, self.last.q, self.result, self.stats
        if not all(map(is_array_like, jax.tree.leaves(parts, is_leaf=lambda x: x is None))):
            return repr(self)  # something else in the places of its numbers, as `jax.tree.map` may leave it
        return batch_report(self) if np.ndim(self.stats.steps) else report(self)

    def __repr__(self) -> str:
        shape = getattr(getattr(self.states, "q", None), "shape", ())
        rows = shape[:-1]
        states = (
            so_many(rows[0], "state") if len(rows) == 1 else f"{' x '.join(map(str, rows)) or 'no'} states"
        )
        return f"Trajectory({code_name(self.result)}; {states})"


@quickly
def _all_filled(last: State, states: State, *others: Any) -> tuple[Any, ...]:
    """Rows of states, and others beside them, as `Trajectory.filled` has them."""
    there = reached(states)
    # Lanes of a batch come before the axis of times.
    count = jnp.sum(there, axis=-1)

    def held(rows: Array) -> Array:
        axis = there.ndim - 1
        at = jnp.expand_dims(jnp.maximum(count - 1, 0), range(axis, rows.ndim))
        end = jnp.take_along_axis(rows, at, axis=axis).squeeze(axis)
        some = (count > 0).reshape(*count.shape, *(1,) * (end.ndim - count.ndim))
        return _filled(there, rows, jnp.where(some, end, 0.0))

    stood = jax.tree.map(lambda rows, end: _filled(there, rows, end), states, last)
    return stood, *jax.tree.map(held, others)


def _filled(there: Array, rows: Array, end: Array) -> Array:
    """Rows along time, the ones that are not `there` replaced by `end`; lanes may come before."""
    axis = there.ndim - 1
    mask = there.reshape(*there.shape, *(1,) * (rows.ndim - there.ndim))
    return jnp.where(mask, rows, jnp.expand_dims(end, axis))


def check_one_run(name: str, run: Any) -> None:
    """Raise unless an argument is one run and not a batch, with a state for each of its times, one or more.

    It need not be what `simulate` returned: `jax.tree.map` and `equinox.tree_at` put anything into a pytree.
    """
    check_instance(name, run, Trajectory, "a Trajectory")
    parts: dict[str, Any] = {"ts": run.ts} | {
        f"states.{part}": getattr(run.states, part, None) for part in "qvs"
    }
    for part, value in parts.items():
        if not is_array_like(value) or value.dtype.kind != "f":
            raise ValueError(f"argument {name} must hold real numbers as {part}, but had {shown(value)}")
    shape, count = run.states.q.shape, np.size(run.ts)
    if run.ts.ndim != 1 or len(shape) != 2:
        raise ValueError(
            f"argument {name} must be one run, but its states have shape {shape}; "
            f"take one lane with jax.tree.map(lambda x: x[i], {name})"
        )
    if not count or any(value.shape[:1] != (count,) for value in parts.values()):
        raise ValueError(
            f"argument {name} must hold a state for each of its times, one or more, but was of shapes "
            f"{shown([value.shape for value in parts.values()])}"
        )
