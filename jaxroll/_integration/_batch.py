"""Many runs in one program: a few slots step together, and a slot whose run is over takes the next one.

Runs (lanes) lie along the last axis, so that every operation is unit-stride vector code. On a processor the
slots are few enough for their data to stay in its cache. Since a slot never waits for its neighbours, runs of
unequal length waste nothing. Step and step-size control are those of a single run (`_run`, `_step`).
`_derivative` uses this where `simulate` is called under `vmap`, with a method that `_step` runs itself.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._types import Scalar
from .._xla import VECTOR
from ._bundle import Bundle
from ._run import aim, Course, embark, judge, Path, path_of, Plan

# On a processor the data of all slots, about 2-6 kB each, should fit the second-level cache many times over,
# and there should be enough of them to fill its vector unit: measured flat from 64 to 256 slots. An
# accelerator is faster the more slots it has.
_CPU_SLOTS = 64
_DEVICE_SLOTS = 65536


def _slots(size: int, most: int) -> int:
    """Number of slots for `size` runs, at most `most`, in whole vectors of the processor.

    It is the smallest number with which the runs take as few rounds as with `most` slots.
    """
    rounds = -(-size // most)
    return min(size, -(-size // (rounds * VECTOR)) * VECTOR)


class Slots(NamedTuple):
    """The runs in progress, lanes last.

    Attributes:
        run: Index of the run that a slot holds; `size` or more where none was left.
        task: The batched numbers of grasp, start and plan of that run.
        course: State of that run in progress.
    """

    run: Array
    task: list[Array]
    course: Course

    @property
    def done(self) -> Array:
        """Which slots hold a run that is over."""
        return ~self.course.busy


class Output(NamedTuple):
    """Results, one row per run, plus one scratch row: writes that are to be discarded go there.

    Attributes:
        saved: Flow vectors at the save times.
        ends: Last flow vector, its time, attempted and accepted steps, diffrax's code.
    """

    saved: Array
    ends: Array


class Ensemble:
    """The loop over `size` runs of a batched (grasp, start, plan)."""

    def __init__(self, size: int, batched: Any, arrays: Any, still: Any) -> None:
        """Divide the arguments of all runs into those that differ and those that all runs share.

        Args:
            size: Number of runs.
            batched: Pytree like `arrays`: whether a leaf has the runs as its leading axis.
            arrays: The arrays of (grasp, start, plan).
            still: All other leaves of (grasp, start, plan).
        """
        self.size = size
        leaves, self.form = jax.tree.flatten(arrays)
        self.marks, self.still = jax.tree.leaves(batched), still
        self.queue = [x for x, b in zip(leaves, self.marks, strict=True) if b]
        self.shared = [x for x, b in zip(leaves, self.marks, strict=True) if not b]
        self.on_cpu = jax.default_backend() == "cpu"
        self.slots = _slots(size, _CPU_SLOTS if self.on_cpu else _DEVICE_SLOTS)

    def problem(self, task: list[Array]) -> tuple[Bundle, Array, Plan]:
        """Grasp, start and plan of one run, from its batched numbers."""
        own, shared = iter(task), iter(self.shared)
        leaves = [next(own) if b else next(shared) for b in self.marks]
        return eqx.combine(jax.tree.unflatten(self.form, leaves), self.still)

    def run(self) -> Path:
        """All runs, as a `Path` with a leading axis."""
        plan = self.problem([x[0] for x in self.queue])[2]
        start = jax.vmap(lambda i: self._fresh(i), out_axes=-1)(jnp.arange(self.slots))
        saves, width = plan.ts.shape[0], plan.stepper.lay.margin + 2
        # NaN marks save times that a run does not reach.
        nothing = jnp.full((self.size + 1, saves, width), jnp.nan, start.course.y.dtype)
        output = Output(nothing, jnp.zeros((self.size + 1, width + 4), start.course.y.dtype))
        # The last part of the carry is the next run to be started.
        carry = (start, output, jnp.asarray(self.slots))
        _, output, _ = jax.lax.while_loop(lambda c: jnp.any(c[0].course.busy), self._turn, carry)
        return self._paths(output, width)

    def _fresh(self, run: Scalar) -> Slots:
        """A slot at the start of a run; past the last run, a slot that is not busy."""
        # An index past the end gives the last run's numbers: JAX clamps it.
        task = [jax.lax.dynamic_index_in_dim(x, run, keepdims=False) for x in self.queue]
        _, y0, plan = self.problem(task)
        course = embark(plan, y0)
        return Slots(run, task, course._replace(busy=run < self.size))

    def _turn(self, carry: tuple[Slots, Output, Array]) -> tuple[Slots, Output, Array]:
        """One attempted step of every slot; then results are written and finished slots refilled."""
        slots, output, following = carry
        slots = self._step(slots)
        way = self._one_by_one if self.on_cpu else self._together
        return way(slots, output, following)

    def _step(self, slots: Slots) -> Slots:
        """One attempted step of every slot; a slot that is not busy stays as it is."""
        over = lambda function: jax.vmap(function, in_axes=-1, out_axes=-1)  # noqa: E731

        # The step asks for functions of a bundled grasp to be mapped over lanes. Only some of the grasp's
        # numbers may have lanes, so each lane makes its own bundle from its task and ignores the one given.
        def over_bundles(function: Callable) -> Callable:
            def mapped(_: Bundle, *args: Array) -> Any:
                one = lambda task, *rest: function(self.problem(task)[0], *rest)  # noqa: E731
                return over(one)(slots.task, *args)

            return mapped

        bundle, _, plan = self.problem(slots.task)
        times = over(lambda slot: aim(self.problem(slot.task)[2], slot.course))(slots)
        step = plan.stepper.advance_lanes(bundle, times, slots.course.y, over_bundles)
        judged = lambda slot, *rest: judge(self.problem(slot.task)[2], slot.course, *rest)  # noqa: E731
        return slots._replace(course=over(judged)(slots, times, step))

    def _ends(self, course: Course) -> Array:
        """A row of `Output.ends`, with lanes along the last axis where `course` has them."""
        pace = course.pace
        more = [pace.t, pace.attempted, pace.accepted, course.loop]
        return jnp.concatenate([course.y, jnp.stack([x.astype(course.y.dtype) for x in more])])

    def _together(self, slots: Slots, output: Output, following: Array) -> tuple[Slots, Output, Array]:
        """Write results and refill finished slots, all at once by scatters: for accelerators."""
        # `row` is the scratch row where there is nothing to write.
        course, done = slots.course, slots.done & (slots.run < self.size)
        row = jnp.where(course.hit, slots.run, self.size)
        saved = output.saved.at[row, jnp.maximum(course.saved - 1, 0)].set(course.y.T)
        row = jnp.where(done, slots.run, self.size)
        ends = output.ends.at[row].set(self._ends(course).T)
        # Finished slots take the runs that follow, in the order of the slots.
        run = following + jnp.cumsum(done) - 1
        fresh = jax.vmap(self._fresh, out_axes=-1)(jnp.minimum(run, self.size))
        pick = jax.vmap(lambda done, new, old: jnp.where(done, new, old), in_axes=-1, out_axes=-1)
        slots = jax.tree.map(lambda new, old: pick(done, new, old), fresh, slots)
        return slots, Output(saved, ends), following + jnp.sum(done)

    def _one_by_one(self, slots: Slots, output: Output, following: Array) -> tuple[Slots, Output, Array]:
        """The same as `_together`, one slot after the other, for processors.

        Scatters would not stay in the kernel of the loop; updates of one slice do.
        """

        def serve(carry: tuple) -> tuple:
            flags, slots, output, following = carry
            i = jnp.argmax(flags)
            at = jax.tree.map(lambda x: jax.lax.dynamic_index_in_dim(x, i, -1, keepdims=False), slots)
            course, done = at.course, at.done
            row = jnp.where(course.hit, at.run, self.size)
            saved = jax.lax.dynamic_update_slice(
                output.saved, course.y[None, None], (row, course.saved - 1, 0)
            )
            row = jnp.where(done, at.run, self.size)
            ends = jax.lax.dynamic_update_slice(output.ends, self._ends(course)[None], (row, 0))
            fresh = self._fresh(jnp.minimum(following, self.size))
            fresh = jax.tree.map(lambda new, old: jnp.where(done, new, old), fresh, at)
            put = lambda x, one: jax.lax.dynamic_update_index_in_dim(x, one, i, -1)  # noqa: E731
            slots, flags = jax.tree.map(put, slots, fresh), put(flags, jnp.asarray(False))
            return flags, slots, Output(saved, ends), following + jnp.where(done, 1, 0)

        # Slots with something to write: a saved state, or a finished run.
        flags = slots.course.hit | slots.done & (slots.run < self.size)
        carry = (flags, slots, output, following)
        return jax.lax.while_loop(lambda c: jnp.any(c[0]), serve, carry)[1:]

    def _paths(self, output: Output, width: int) -> Path:
        """The output without its scratch row, as paths with a leading axis of runs."""
        ends = output.ends[: self.size]
        last, (t, *counts) = ends[:, :width], ends[:, width:].T
        return jax.vmap(path_of)(output.saved[: self.size], last, t, tuple(counts))
