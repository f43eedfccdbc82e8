"""One row of `lanes`, in a process of its own: a batch of a number of lanes, or the steps that slots waste.

`python -m benchmarks._lanes_row batch pivoted 1000` prints a batch as JSON. Of wasted steps, a further word
names the number of the controller that is spread tenfold: `... _lanes_row waste pivoted 2048 force`.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr
from jaxroll._integration import _batch

jax.config.update("jax_enable_x64", True)

CHUNK = 2048
_CHECKED = 64  # lanes whose error is measured


class Case(NamedTuple):
    """A scene, solver, seconds and tolerance of its runs, name of its stiffness, and numbers of lanes."""

    scene: str
    solver: Any
    seconds: float
    rtol: float
    stiffness: str
    sizes: tuple[int, ...]


_SIZES = (1, 10, 100, 1000, CHUNK, 10**4, 10**5)
CASES = (
    Case("pivoted", diffrax.Tsit5(), 3.0, 1e-5, "force", (*_SIZES, 10**6)),
    Case("pinch", jxr.Rosenbrock(), 2.0, 1e-5, "beta", _SIZES),
)


def scaled(case: Case, name: str) -> Callable:
    """From a factor to the scene with one of its controller's numbers multiplied."""
    grasp, state = getattr(jxr.scenes, case.scene)()
    usual = getattr(grasp.controller, name)
    return lambda factor: (grasp.with_(**{name: factor * usual}), state)


def kept(run: jxr.Trajectory) -> tuple:
    """Of every run: final coordinates, code and attempted steps."""
    return run.last.q, run.result._value, run.stats.steps


def spent(call: Callable, rounds: int) -> tuple[float, float, Any]:
    """Median seconds of wall and of processor, and what the call returned."""
    walls, works, found = [], [], None
    for _ in range(rounds):
        wall, work = time.perf_counter(), time.process_time()
        found = jax.block_until_ready(call())
        walls.append(time.perf_counter() - wall)
        works.append(time.process_time() - work)
    return float(np.median(walls)), float(np.median(works)), found


def peak() -> float:
    """Largest resident memory of this process so far [MiB]; `getrusage` would count its parent's too."""
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


def batch(case: Case, lanes: int) -> dict[str, Any]:
    """One row: what a sweep of so many lanes takes, and a mapped program of as many."""
    make = scaled(case, "damping")
    factors = np.random.default_rng(0).uniform(2 / 3, 4 / 3, lanes)
    settings = {"rtol": case.rtol, "solver": case.solver}
    sweep = lambda x: jxr.sweep(make, x, case.seconds, keep=kept, chunk=CHUNK, **settings)  # noqa: E731
    rounds = 1 if lanes >= 10**5 else min(51, 3 + 2000 // lanes)
    sweep(factors[:CHUNK])
    wall, work, (q, codes, steps) = spent(lambda: sweep(factors), rounds)
    row = {"lanes": lanes, "wall": wall / lanes, "work": work / lanes, "peak": peak()}
    row |= {"successful": float(np.mean(codes == 0)), "steps": float(np.mean(steps))}
    row["kept"] = sum(x.nbytes for x in (factors, q, codes, steps)) // lanes
    seen = np.linspace(0, lanes - 1, min(lanes, _CHECKED)).astype(int)
    exact = jxr.sweep(make, factors[seen], case.seconds, keep=kept, rtol=1e-11)[0]
    row["error"] = float(np.abs(q[seen] - exact).max())
    if lanes <= 10**5:
        one = lambda x: kept(jxr.simulate(*make(x), case.seconds, ts=1, **settings))  # noqa: E731
        program = jax.jit(jax.vmap(one)).lower(jnp.asarray(factors)).compile()
        row["mapped"] = spent(lambda: program(jnp.asarray(factors)), rounds)[1] / lanes
    return row


def waste(case: Case, lanes: int, name: str) -> dict[str, Any]:
    """Steps that lanes are given over steps that they need, one number of the controller spread tenfold.

    Of a plain batched loop, which steps all lanes until the last is done, and of jaxroll's slots, counted in
    the loop itself. The number is spread evenly in its logarithm, in random order.
    """
    factors = 10.0 ** np.random.default_rng(0).uniform(-0.5, 0.5, lanes)
    turns, step = [], _batch.Ensemble._turn

    def counted(self: Any, carry: tuple) -> tuple:
        jax.debug.callback(lambda: turns.append(self.slots))
        return step(self, carry)

    make, settings = scaled(case, name), {"rtol": case.rtol, "solver": case.solver}
    with mock.patch.object(_batch.Ensemble, "_turn", counted):
        _, codes, steps = jxr.sweep(make, factors, case.seconds, keep=kept, chunk=lanes, **settings)
        jax.effects_barrier()
    need = float(steps.sum())
    row = {"lanes": lanes, "least": int(steps.min()), "most": int(steps.max())}
    row |= {"plain": float(steps.max()) * lanes / need, "slots": sum(turns) / need}
    return row | {"successful": float(np.mean(codes == 0))}


def main() -> None:
    way, scene, lanes, *name = sys.argv[1:]
    case = next(case for case in CASES if case.scene == scene)
    print(json.dumps({"batch": batch, "waste": waste}[way](case, int(lanes), *name)))


if __name__ == "__main__":
    main()
