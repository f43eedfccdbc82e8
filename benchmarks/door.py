"""What the door to diffrax costs: `diffeqsolve` with `vector_field`, beside `simulate` (about three minutes).

`python -m benchmarks.door --write` rewrites its section of README.md. Both run the pivoted scene for 3 s with
`Dopri8`, the same tolerances and the projection after every step, under `jax.jit`; errors are those of the
object's angle at the end, against `simulate` at rtol 1e-13. Warm calls are timed interleaved; a first call
counts tracing and compilation, without a cache.
"""

import time
from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp

import jaxroll as jxr
from benchmarks._common import command, device, interleaved, table, versions

jax.config.update("jax_enable_x64", True)

T1, RTOL, ROUNDS = 3.0, 1e-8, 31
DAMPING = 0.006


def simulated(damping: Any) -> Any:
    """Angle of the object at the end, by `simulate`."""
    grasp, state = jxr.scenes.pivoted()
    run = jxr.simulate(
        grasp.with_(damping=damping), state, T1, ts=1, solver=diffrax.Dopri8(), rtol=RTOL, atol=RTOL
    )
    return run.last.q[0]


def solved(damping: Any, *, dense: bool = False) -> Any:
    """The same by `diffeqsolve`."""
    grasp, state = jxr.scenes.pivoted()
    field = jxr.vector_field(grasp.with_(damping=damping))
    found = diffrax.diffeqsolve(
        field.terms,
        field.projected(diffrax.Dopri8()),
        0.0,
        T1,
        1e-4,
        field.start(state),
        stepsize_controller=diffrax.PIDController(rtol=RTOL, atol=RTOL),
        saveat=diffrax.SaveAt(dense=dense, t1=not dense),
        max_steps=512,
    )
    y = found.evaluate(T1) if dense else found.ys[-1]  # pyright: ignore
    return field.states(y).q[0]


def densely(damping: Any) -> Any:
    """The same, the solution kept at all times."""
    return solved(damping, dense=True)


WAYS: dict[str, Callable[[Any], Any]] = {
    "`simulate`": simulated,
    "`diffeqsolve`": solved,
    "`diffeqsolve`, dense output": densely,
}


def report(quick: bool) -> str:
    """The table, and what comes of it."""
    grasp, state = jxr.scenes.pivoted()
    truth = float(jxr.simulate(grasp, state, T1, ts=1, rtol=1e-13, atol=1e-13).last.q[0])
    rows, calls, at = [], [], jnp.asarray(DAMPING)
    for name, way in WAYS.items():
        for what, function in (("run", way), ("value and gradient", jax.value_and_grad(way))):
            jitted = jax.jit(function)
            start = time.perf_counter()
            found = jax.block_until_ready(jitted(at))
            first = time.perf_counter() - start
            value = found if what == "run" else found[0]
            rows.append([name, what, f"{first:.1f}", f"{abs(float(value) - truth):.0e}"])
            calls.append(lambda jitted=jitted: jax.block_until_ready(jitted(at)))
    times = interleaved(calls, rounds=5 if quick else ROUNDS)
    for i, (row, seconds) in enumerate(zip(rows, times, strict=True)):
        row += [f"{1e3 * seconds:.2f}", f"{seconds / times[i % 2]:.1f}"]
    costs = f"a run {rows[2][-1]} times what `simulate` does, value and gradient {rows[3][-1]} times"
    header = ["way", "what", "first call [s]", "error [rad]", "warm [ms]", "over `simulate`"]
    grid = table(header, rows)
    versions_ = versions("jax", "jaxlib", "diffrax")
    return f"**Conclusion.** By the door, `diffeqsolve` costs {costs}.\n\n{grid}\n\n{device()}; {versions_}."


if __name__ == "__main__":
    command("door", report)
