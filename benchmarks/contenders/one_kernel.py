"""A whole adaptive run inside one GPU kernel: a contender beside the ordinary batch.

The ordinary batch is a loop of many kernels, launched anew for every step of all lanes; here every lane
runs its own loop in registers, written in Pallas for its Triton back end. The equations of motion,
projection and limits of the model are jaxroll's own, evaluated on numbers of shape (block,).

What it leaves out: save times but the last, the exact time of an event (the run ends with its code after the
step that passed it), derivatives, and contours that are read from tables.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton as plgpu
from jaxtyping import Array, Float, Int

from jaxroll._integration._arguments import SWEEPS
from jaxroll._integration._events import decode, regime
from jaxroll._integration._step import tableau_of
from jaxroll._linalg._plane import total
from jaxroll._mechanics import Form, Grasp, Leaves, State
from jaxroll._motion._equations import evaluate
from jaxroll._motion._formulation import Index1
from jaxroll._motion._projection import anchor_of, compatible, settle
from jaxroll._results import RESULTS

# One lane per thread: a lane's state fills a thread's registers.
BLOCK = 128
_WARP = 32
# Step-size control, as `diffrax.PIDController` has it by default.
_SAFETY, _SHRINK, _GROW, _SHORTEST = 0.9, 0.2, 10.0, 1e-12
# Stops closer than this are the same [s].
_SAME_TIME = 1e-10
_EVENTS = ("lift", "friction")

Block = Array  # shape (block,)
Blocks = tuple[Block, ...]


class Ends(NamedTuple):
    """Where a run ended: state, time [s], attempted and accepted steps, result code."""

    last: State
    t_end: Float[Array, ""]
    steps: Int[Array, "2"]
    result: RESULTS


class Setup(NamedTuple):
    """What is compiled in."""

    solver: diffrax.AbstractERK
    max_steps: int
    block: int
    interpret: bool


def integrate(
    grasp: Grasp,
    state: State,
    t1: float,
    *,
    rtol: float,
    solver: diffrax.AbstractERK | None = None,
    dt0: float = 1e-4,
    max_steps: int = 4096,
    block: int = BLOCK,
    interpret: bool = False,
) -> Ends:
    """The end of a run from 0 to `t1` [s]; under `jax.vmap` all lanes are one kernel.

    Args:
        grasp: The grasp; what of it `vmap` maps is read lane by lane, the rest once.
        state: A state on the constraints.
        t1: Final time [s].
        rtol: Relative and absolute tolerance.
        solver: An explicit Runge-Kutta method of diffrax. Default: `diffrax.Tsit5()`.
        dt0: Length of the first step [s].
        max_steps: Steps to attempt at most.
        block: Lanes per program of the kernel, a power of 2.
        interpret: Whether to emulate the kernel with ordinary operations, on any device.
    """
    dtype = state.q.dtype
    numbers, rebuild = _numbers(grasp.prepared())
    start = jnp.concatenate([state.q, state.v, state.s])
    times = jnp.asarray([t1, dt0, rtol], dtype)
    setup = Setup(solver or diffrax.Tsit5(), max_steps, block, interpret)
    kernel = functools.partial(_lanes, setup, rebuild, grasp.form)

    @jax.custom_batching.custom_vmap
    def alone(numbers: list[Array], start: Array) -> Any:
        ends = kernel([False] * len(numbers), numbers, start[None], times)
        return jax.tree.map(lambda x: x[0], ends)

    @alone.def_vmap
    def _(size: int, batched: Any, numbers: list[Array], start: Array) -> Any:
        owned, moved = batched
        if not moved:
            start = jnp.broadcast_to(start, (size, *start.shape))
        ends = kernel(owned, numbers, start, times)
        return ends, jax.tree.map(lambda _: True, ends)

    return _ends(grasp.form, *alone(numbers, start))


def _ends(form: Form, x: Array, t: Array, counts: Array) -> Ends:
    positions, velocities, _ = form.counts
    moving = positions + velocities
    last = State(x[:positions], x[positions:moving], x[moving:])
    attempted, accepted, number, code = (counts[i] for i in range(4))
    loop = eqx.tree_at(lambda r: r._value, diffrax.RESULTS.successful, code)
    return Ends(last, t, jnp.stack([attempted, accepted]), decode(number, loop))


class _Vector(tuple):
    """A short vector as a tuple of its numbers, which the scalar algebra takes as it is."""

    @property
    def shape(self) -> tuple[int]:
        return (len(self),)


def _numbers(grasp: Grasp) -> tuple[list[Array], Callable[[list[Array]], Grasp]]:
    """All numbers of a prepared grasp, each by itself, and the way back."""
    leaves, tree = jax.tree.flatten(grasp)
    if any(jnp.ndim(leaf) > 1 for leaf in leaves):
        raise ValueError("argument grasp must have no tables in it: the kernel cannot look numbers up")
    sizes = [None if jnp.ndim(leaf) == 0 else leaf.shape[0] for leaf in leaves]
    flat = [x for leaf in leaves for x in ([leaf] if jnp.ndim(leaf) == 0 else list(leaf))]

    def rebuild(numbers: list[Array]) -> Grasp:
        rest = iter(numbers)
        parts = [next(rest) if n is None else _Vector(next(rest) for _ in range(n)) for n in sizes]
        return jax.tree.unflatten(tree, parts)

    return flat, rebuild


def _lanes(
    setup: Setup,
    rebuild: Callable,
    form: Form,
    owned: list[bool],
    numbers: list[Array],
    starts: Array,
    times: Array,
) -> tuple[Array, Array, Array]:
    """Launch the kernel: states (lanes, width), times (lanes,) and counts (lanes, 4) at the ends."""
    lanes, width = starts.shape
    dtype, block = starts.dtype, setup.block
    filled = -(-lanes // block) * block
    each = list(zip(numbers, owned, strict=True))
    # Never empty: a kernel takes no arrays without numbers.
    own = jnp.stack([x for x, b in each if b] or [jnp.zeros(lanes, dtype)])
    shared = jnp.stack([x for x, b in each if not b] or [jnp.zeros((), dtype)])
    # The last block is filled up with the last lane.
    fill = lambda x: jnp.pad(x, ((0, 0), (0, filled - lanes)), mode="edge")  # noqa: E731
    rows, shares, weights = tableau_of(_checked(setup.solver), dtype)
    columns = [jnp.asarray(x, dtype)[:, None] for x in (shares, weights)]
    table = jnp.concatenate([rows, *columns], axis=1)
    order = setup.solver.error_order(None)  # pyright: ignore[reportArgumentType]
    by_lane = lambda rows: pl.BlockSpec((rows, block), lambda i: (0, i))  # noqa: E731
    whole = lambda x: pl.BlockSpec(x.shape, lambda _: (0,) * x.ndim)  # noqa: E731
    run = pl.pallas_call(
        functools.partial(_kernel, setup, (rebuild, form, owned, order)),
        out_shape=[jax.ShapeDtypeStruct((n, filled), k) for n, k in ((width + 1, dtype), (4, jnp.int32))],
        grid=(filled // block,),
        in_specs=[whole(times), whole(table.ravel()), whole(shared), by_lane(own.shape[0]), by_lane(width)],
        out_specs=[by_lane(width + 1), by_lane(4)],
        interpret=setup.interpret,
        compiler_params=plgpu.CompilerParams(num_warps=max(1, block // _WARP), num_stages=1),
        name="rolling",
    )
    x, counts = run(times, table.ravel(), shared, fill(own), fill(starts.T))
    return x[:width, :lanes].T, x[width, :lanes], counts[:, :lanes].T


class _Course(NamedTuple):
    """Runs in progress, each field by lane: state, its rates, time, next length, control and counts."""

    x: Blocks
    rates: Blocks
    t: Block
    length: Block
    forced: Block
    attempted: Block
    accepted: Block
    number: Block
    loop: Block
    busy: Block


def _kernel(setup: Setup, problem: tuple, *refs: Any) -> None:
    times, table, shared, own, start, out, counts = refs
    rebuild, form, owned, order = problem
    t1, dt0, rtol = (times[i] for i in range(3))

    def grasp() -> Grasp:
        # Read where it is used: kept in registers all along, the numbers would push the state out.
        mine, common = iter(range(len(owned))), iter(range(len(owned)))
        return rebuild([own[next(mine), :] if b else shared[next(common)] for b in owned])

    x0 = tuple(start[i, :] for i in range(start.shape[0]))
    zero, none = jnp.zeros_like(x0[0]), jnp.zeros(x0[0].shape, jnp.int32)
    method = _Method(setup.solver, table, form, grasp)
    goal = _Goal(t1, dt0, rtol, order, setup.max_steps, sum(form.counts[:2]))
    no, yes = none > 0, none == 0
    course = _Course(x0, tuple(zero for _ in x0), zero, zero, no, none, none, none, none, yes)
    turn = lambda course: _judged(goal, course, *_step(method, goal, course))  # noqa: E731
    course = jax.lax.while_loop(lambda c: jnp.max(c.busy.astype(jnp.int32)) > 0, turn, course)
    for i, value in enumerate((*course.x, course.t)):
        out[i, :] = value
    for i, value in enumerate((course.attempted, course.accepted, course.number, course.loop)):
        counts[i, :] = value


class _Method(NamedTuple):
    """A Runge-Kutta method with its numbers in memory, and the grasp it is for."""

    solver: diffrax.AbstractERK
    table: Any
    form: Form
    grasp: Callable[[], Grasp]

    @property
    def stages(self) -> int:
        return len(tableau_of(_checked(self.solver), np.float64)[2])

    def row(self, i: Any) -> list[Array]:
        """Weights of a stage, then its time, then the error's weight of it."""
        width = self.stages + 2
        return [self.table[i * width + j] for j in range(width)]


def _checked(solver: diffrax.AbstractERK) -> diffrax.AbstractERK:
    if not isinstance(solver.tableau, diffrax.ButcherTableau):
        raise ValueError(f"argument solver must have one tableau, but was {solver!r}")
    return solver


class _Goal(NamedTuple):
    """Final time, first length, tolerance, order, step limit; how many numbers error control looks at."""

    t1: Array
    dt0: Array
    rtol: Array
    order: float
    max_steps: int
    seen: int


def _step(method: _Method, goal: _Goal, course: _Course) -> tuple[Blocks, Blocks, Blocks, Block, Block]:
    """State, rates, error estimate, event number and end of the next step."""
    ahead = course.t + course.length
    t1 = jnp.where(ahead > goal.t1 - _SAME_TIME, goal.t1, ahead)
    t1 = jnp.where((course.length == 0.0) | ~course.busy, course.t, t1)
    dt, count = t1 - course.t, method.stages
    nothing = tuple(jnp.zeros_like(k) for k in course.rates)
    slopes = (course.rates, *(nothing for _ in range(count - 2)))

    def mixed(slopes: tuple[Blocks, ...], weights: list[Array]) -> Blocks:
        each = zip(*slopes, strict=True)
        return tuple(dt * total([w * k for w, k in zip(weights, ks, strict=False)]) for ks in each)

    def moved(slopes: tuple[Blocks, ...], row: list[Array]) -> Blocks:
        return tuple(x + d for x, d in zip(course.x, mixed(slopes, row), strict=True))

    def stage(i: Any, slopes: tuple[Blocks, ...]) -> tuple[Blocks, ...]:
        row = method.row(i)
        t, x = course.t + row[count] * dt, moved(slopes, row)
        rates = _flat(evaluate(method.grasp(), t, _leaves(method.form, x), Index1()).rates)
        kept = slopes[:1]
        for j in range(1, count - 1):
            kept += (tuple(jnp.where(i == j, new, old) for new, old in zip(rates, slopes[j], strict=True)),)
        return kept

    slopes = jax.lax.fori_loop(jnp.int32(1), jnp.int32(count - 1), stage, slopes)
    grasp, raw = method.grasp(), moved(slopes, method.row(count - 1))
    leaves = _leaves(method.form, raw)
    instant = evaluate(grasp, t1, leaves, Index1())
    _, number, _ = regime(grasp, leaves, instant, _EVENTS)
    anchor, rates = anchor_of(instant), _flat(instant.rates)
    for _ in range(SWEEPS):
        leaves = settle(grasp, leaves, anchor)
    x = _flat(compatible(grasp, leaves, anchor.line))
    error = mixed((*slopes, rates), [method.row(i)[count + 1] for i in range(count)])
    finite = functools.reduce(jnp.logical_and, [jnp.abs(v) < jnp.inf for v in x])
    not_finite = 1
    return x, rates, error, jnp.where(finite, number, not_finite).astype(jnp.int32), t1


def _judged(
    goal: _Goal, course: _Course, x: Blocks, rates: Blocks, error: Blocks, number: Block, t1: Block
) -> _Course:
    """Take a step or leave it, lane by lane."""
    scaled = [
        e / (goal.rtol + goal.rtol * jnp.maximum(jnp.abs(a), jnp.abs(b)))
        for e, a, b in list(zip(error, course.x, x, strict=True))[: goal.seen]
    ]
    size = jnp.sqrt(total([e * e for e in scaled]) * (1.0 / goal.seen))
    first = t1 == course.t
    small = (size < 1.0) | course.forced
    least, most = jnp.where(small, 1.0, _SHRINK), jnp.where(small, _GROW, _SAFETY)
    wanted = _SAFETY * (1.0 / size) ** (1.0 / goal.order)
    # Comparisons, not minimum and maximum: what is not a number shrinks the step.
    factor = jnp.where(wanted >= least, jnp.where(wanted <= most, wanted, most), least)
    length = factor.astype(course.t.dtype) * (t1 - course.t)
    forced = jnp.where(first, course.forced, length <= _SHORTEST)
    length = jnp.where(first, goal.dt0, jnp.maximum(length, _SHORTEST)).astype(course.t.dtype)
    keep = (first | small) & course.busy
    over = course.busy & (course.attempted > goal.max_steps)
    ended = keep & ((number > 0) | (t1 == goal.t1))
    pick = lambda new, old: tuple(jnp.where(keep, a, b) for a, b in zip(new, old, strict=True))  # noqa: E731
    return _Course(
        pick(x, course.x),
        pick(rates, course.rates),
        jnp.where(keep, t1, course.t),
        jnp.where(course.busy, length, course.length),
        jnp.where(course.busy, forced, course.forced),
        course.attempted + course.busy.astype(jnp.int32),
        course.accepted + keep.astype(jnp.int32),
        jnp.where(keep, number, course.number),
        jnp.where(over, _MANY_STEPS, course.loop),
        course.busy & ~ended & ~over,
    )


_MANY_STEPS = int(diffrax.RESULTS.max_steps_reached._value)


def _leaves(form: Form, x: Blocks) -> Leaves:
    """The numbers of a state in their places."""
    rest = iter(x)
    blocks = lambda sizes: tuple(tuple(next(rest) for _ in range(n)) for n in sizes)  # noqa: E731
    q, v = blocks(form.positions), blocks(form.sizes)
    return Leaves(q, v, jax.tree.unflatten(form.places, list(rest)))


def _flat(leaves: Leaves) -> Blocks:
    """The way back."""
    moving = [leaf for blocks in (leaves.q, leaves.v) for block in blocks for leaf in block]
    return (*moving, *jax.tree.leaves(leaves.s))
