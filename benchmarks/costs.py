"""Where the time of a run and of its first call goes: operations, fusions, memory, stages (six minutes).

`python -m benchmarks.costs --write` rewrites its section of README.md; `--quick` measures fewer rounds.
Operations are those of the traced program after dead code is dropped, before XLA copies or merges any, with
the barriers against copies, three each, that leave no machine code. Times are processor time, medians of
interleaved warm runs. The times of an evaluation and of the rest of a step follow from methods of 3, 6 and 12
evaluations a step. Stages are those of a program without a cache: JAX traces it and lowers it to lines of
text, which XLA compiles; `tests/test_program_size.py` limits the number of lines.
"""

import time
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters.partial_eval import dce_jaxpr

import jaxroll as jxr
from benchmarks._common import command, device, interleaved, table, versions
from jaxroll._integration._bundle import bundle
from jaxroll._integration._state_vector import layout, vector_of
from jaxroll._integration._step import RollingStep
from jaxroll._xla._one_kernel import WIDE

jax.config.update("jax_enable_x64", True)

SECONDS = {"pivoted": 3.0, "pinch": 2.0, "pinch3d": 0.5}
SOLVERS = {3: diffrax.Bosh3(), 6: diffrax.Tsit5(), 12: diffrax.Dopri8()}
LANES = 512


class Counts(NamedTuple):
    """Operations of an evaluation, of a step's end, and of the cotangents of both."""

    evaluation: int
    ending: int
    evaluation_back: int
    ending_back: int


class Times(NamedTuple):
    """Microseconds of an evaluation and of the rest of a step; kernels and bytes of the program."""

    evaluation: float
    rest: float
    fusions: int
    memory: int


def operations(function: Any, *args: Any) -> int:
    """Operations of a traced function, those that it calls included; a loop's body counts once."""
    jaxpr = jax.make_jaxpr(function)(*args).jaxpr
    return _counted(dce_jaxpr(jaxpr, [True] * len(jaxpr.outvars))[0])


def _counted(jaxpr: Any) -> int:
    inner = lambda x: hasattr(x, "eqns") or hasattr(x, "jaxpr")  # noqa: E731
    count = 0
    for equation in jaxpr.eqns:
        called = [x for x in jax.tree.leaves(list(equation.params.values()), is_leaf=inner) if inner(x)]
        count += sum(_counted(getattr(x, "jaxpr", x)) for x in called) if called else 1
    return count


def counts(scene: str) -> Counts:
    grasp, state = getattr(jxr.scenes, scene)()
    ready, lay = bundle(grasp.prepared()), layout(grasp, False)
    step = RollingStep(diffrax.Dopri8(), jxr.Index1(), lay, ("lift", "friction"), sweeps=1)
    moving, still = eqx.partition(ready, eqx.is_inexact_array)
    y, t = vector_of(lay, state), jnp.zeros(())
    x = y[: lay.width]
    at = lambda m, x: step.at(eqx.combine(m, still), t, x)  # noqa: E731
    end = lambda m, x, *rest: step.finish(eqx.combine(m, still), x, *rest)  # noqa: E731
    rates, left = at(moving, x)
    at_back = lambda m, x, bars: jax.vjp(at, m, x)[1](bars)  # noqa: E731
    end_back = lambda m, x, r, e, bars: jax.vjp(end, m, x, r, e)[1](bars)  # noqa: E731
    return Counts(
        operations(at, moving, x),
        operations(end, moving, x, rates, left),
        operations(at_back, moving, x, (rates, left)),
        operations(end_back, moving, x, rates, left, y),
    )


def program(scene: str, solver: Any, lanes: int) -> tuple[Any, Any]:
    """A compiled run, or many, and what it is called with."""
    grasp, state = getattr(jxr.scenes, scene)()

    def run(v: Any) -> tuple[Any, Any]:
        start = jxr.State(state.q, v, state.s)
        done = jxr.simulate(grasp, start, SECONDS[scene], ts=1, rtol=1e-5, solver=solver, throw=False)
        return done.last.q, done.stats.steps

    v = jnp.tile(state.v, (lanes, 1)) if lanes else state.v
    mapped = jax.vmap(run) if lanes else run
    return jax.jit(mapped, compiler_options=WIDE).lower(v).compile(), v


def times(scene: str, lanes: int, rounds: int) -> Times:
    made = {count: program(scene, solver, lanes) for count, solver in SOLVERS.items()}
    calls = [lambda f=f, v=v: jax.block_until_ready(f(v)) for f, v in made.values()]
    spent = interleaved(calls, rounds=rounds, clock=time.process_time)
    steps = [int(np.sum(f(v)[1])) for f, v in made.values()]
    each = 1e6 * np.array(spent) / steps
    slope, rest = np.polyfit(list(made), each, 1)
    tsit5 = made[6][0]
    fusions = sum(" fusion(" in line for line in tsit5.as_text().splitlines())
    return Times(slope, rest, fusions, tsit5.memory_analysis().temp_size_in_bytes)


class Stages(NamedTuple):
    """Lines of a lowered program, and processor seconds of what makes a program of a function."""

    lines: int
    trace: float
    lower: float
    compile: float


def stages(scene: str, gradient: bool) -> Stages:
    """The stages of a run, or of its value and gradient in the controller's damping."""
    grasp, state = getattr(jxr.scenes, scene)()

    def end(damping: Any) -> Any:
        return jxr.simulate(grasp.with_(damping=damping), state, SECONDS[scene], ts=1).last.q[0]

    jax.clear_caches()
    times = [time.process_time()]
    traced = jax.jit(jax.value_and_grad(end) if gradient else end).trace(grasp.controller.damping)
    times.append(time.process_time())
    lowered = traced.lower()
    times.append(time.process_time())
    lowered.compile()
    times.append(time.process_time())
    return Stages(len(lowered.as_text().splitlines()), *np.diff(times).tolist())


def conclusion(found: dict[str, tuple[Counts, Times, Times]]) -> str:
    parts = []
    for scene, (n, alone, many) in found.items():
        share = 6 * many.evaluation / (6 * many.evaluation + many.rest)
        alone_ns, many_ns = (1e3 * x.evaluation / n.evaluation for x in (alone, many))
        parts.append(
            f"in `{scene}` an evaluation of {n.evaluation} operations takes {alone.evaluation:.2f} us alone "
            f"and {many.evaluation:.2f} us a lane ({alone_ns:.2f} and {many_ns:.2f} ns an operation), "
            f"{share:.0%} of a lane's step with Tsit5"
        )
    return f"What remains is arithmetic: {'; '.join(parts)}."


def report(quick: bool = False) -> str:
    scenes = ("pivoted", "pinch") if quick else tuple(SECONDS)
    rounds = 3 if quick else 9
    found = {
        scene: (counts(scene), times(scene, 0, rounds), times(scene, LANES, min(rounds, 5)))
        for scene in scenes
    }
    first = ["scene", "evaluation", "step's end", "cotangents of an evaluation", "of a step's end"]
    numbers = table(first, [[scene, *map(str, n)] for scene, (n, _, _) in found.items()])
    second = ["scene", "lanes", "an evaluation [us]", "the rest of a step [us]", "fusions", "memory [kB]"]
    rows = [
        [scene, str(lanes), f"{x.evaluation:.3f}", f"{x.rest:.2f}", str(x.fusions), f"{x.memory / 1e3:.0f}"]
        for scene, (_, alone, many) in found.items()
        for lanes, x in ((1, alone), (LANES, many))
    ]
    third = ["scene", "program", "lines", "tracing [s]", "lowering [s]", "compiling [s]"]
    programs = [
        [scene, name, str(x.lines), f"{x.trace:.2f}", f"{x.lower:.2f}", f"{x.compile:.1f}"]
        for scene in scenes
        for name, gradient in (("run", False), ("value and gradient", True))
        if (x := stages(scene, gradient))
    ]
    footer = f"{device()}; {versions('jax', 'jaxlib', 'diffrax')}."
    return "\n\n".join(
        [f"**Conclusion.** {conclusion(found)}", numbers, table(second, rows), table(third, programs), footer]
    )


if __name__ == "__main__":
    command("costs", report)
