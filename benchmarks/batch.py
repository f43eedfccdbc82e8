"""Throughput of batches of both planar scenes, beside Numba loops and plain diffrax (about five minutes).

`python -m benchmarks.batch --write` rewrites its section of README.md; `--quick` takes fewer lanes.
Needs the `bench` extra. Every contender is pushed to the loosest setting whose error at the end stays below
1e-6 rad; times are processor time, least of interleaved rounds, compilation left out. jaxroll and plain
diffrax are compiled for vectors of 512 bits, as `jxr.sweep` does.
"""

import dataclasses
import time
from collections.abc import Callable, Iterator
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import jaxroll as jxr
from benchmarks._common import command, device, table, versions
from benchmarks.contenders import pinch_numba, pivoted_numba, plain_diffrax
from benchmarks.contenders.loops_numba import adaptive, many, rk4
from jaxroll._xla._one_kernel import WIDE

jax.config.update("jax_enable_x64", True)

TARGET = 1e-6
TOLERANCES = tuple(a * 10.0**-k for k in range(3, 9) for a in (3.0, 1.0))[1:]


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene of jaxroll, its hand-written peer, how long it runs [s] and how many lanes."""

    name: str
    scene: Any
    peer: Any
    span: float
    lanes: int

    def reference(self) -> np.ndarray:
        """Coordinates at the end: DOP853 at 1e-13."""
        x = self.peer.onto_constraints(self.peer.start())
        path = solve_ivp(self.peer.rates, (0.0, self.span), x, "DOP853", rtol=1e-13, atol=1e-15)
        return path.y[: self.peer.COORDINATES, -1]


@dataclasses.dataclass
class Entry:
    """A contender at its loosest setting that meets the target."""

    name: str
    setting: float
    error: float
    lanes: int
    codes: str
    call: Callable[[], Any]
    seconds: float = np.inf

    def rate(self) -> float:
        """Runs per second and core."""
        return self.lanes / self.seconds


# What a call gives: coordinates at the end, shape (lanes, n), and codes of the runs or None.
Lanes = Callable[[float], tuple[Any, Any]]


def jaxroll_lanes(case: Case, solver: diffrax.AbstractSolver) -> Lanes:
    grasp, state = case.scene()

    def end(v: Any, rtol: Any) -> tuple[Any, Any]:
        start = jxr.State(state.q, v, state.s)
        run = jxr.simulate(grasp, start, case.span, ts=1, rtol=rtol, solver=solver, throw=False)
        return run.last.q, run.result == jxr.RESULTS.successful

    run = jax.jit(jax.vmap(end, in_axes=(0, None)), compiler_options=WIDE)
    still = jnp.zeros((case.lanes, state.v.size))
    return lambda rtol: jax.block_until_ready(run(still, rtol))


def numba_lanes(case: Case, loop: Callable) -> Lanes:
    run = many(loop)
    start = case.peer.onto_constraints(case.peer.start())
    starts = np.tile(start, (case.lanes, 1))
    return lambda setting: (run(starts, case.span, setting)[:, : case.peer.COORDINATES], None)


def plain_lanes(case: Case, solver: diffrax.AbstractSolver) -> Lanes:
    start = case.peer.onto_constraints(case.peer.start())
    starts = jnp.tile(start, (case.lanes, 1))

    def call(tolerance: float) -> tuple[Any, Any]:
        run = plain_diffrax.lanes(starts, case.span, tolerance, solver)
        return jax.block_until_ready(run)[:, : case.peer.COORDINATES], None

    return call


def contenders(case: Case) -> Iterator[tuple[str, tuple[float, ...], Lanes, int]]:
    """Name, ladder of settings and call of each, with the number of lanes: few for the slow ones."""
    for solver in (diffrax.Tsit5(), diffrax.Bosh3()):
        name = type(solver).__name__
        yield f"jaxroll, {name}", TOLERANCES, jaxroll_lanes(case, solver), case.lanes
        loop = adaptive(case.peer.fill_rates, case.peer.SIZE, solver, case.peer.CONTROLLED)
        yield f"Numba, {name}", TOLERANCES, numba_lanes(case, loop), case.lanes
    yield "jaxroll, Rosenbrock", TOLERANCES, jaxroll_lanes(case, jxr.Rosenbrock()), case.lanes
    steps = tuple(n * 2**i for i in range(5) for n in (400, 600))
    equal = rk4(case.peer.fill_rates, case.peer.SIZE)
    few = dataclasses.replace(case, lanes=case.lanes // 16)
    yield "Numba, RK4, equal steps", steps, numba_lanes(few, equal), few.lanes
    if case.peer is pivoted_numba:
        yield "plain diffrax, Tsit5", TOLERANCES, plain_lanes(case, diffrax.Tsit5()), case.lanes


def loosest(case: Case) -> Iterator[Entry]:
    """Each contender at the first setting of its ladder that meets the target."""
    exact = case.reference()
    for name, ladder, call, lanes in contenders(case):
        for setting in ladder:
            ends, good = call(setting)
            error = float(np.abs(np.asarray(ends) - exact).max())
            if error <= TARGET:
                codes = "" if good is None else f"{int(np.sum(good))} of {lanes} successful"
                yield Entry(name, setting, error, lanes, codes, lambda c=call, x=setting: c(x))
                break


def measure(case: Case, rounds: int) -> list[Entry]:
    """Processor time of every contender, fastest first."""
    entries = list(loosest(case))
    for _ in range(rounds):
        for entry in entries:
            start = time.process_time()
            entry.call()
            entry.seconds = min(entry.seconds, time.process_time() - start)
    return sorted(entries, key=Entry.rate, reverse=True)


def best(entries: list[Entry], family: str) -> Entry:
    return next(entry for entry in entries if entry.name.startswith(family))


def _alike(entries: list[Entry]) -> str:
    """The same ratio for equal methods."""
    rates = {entry.name: entry.rate() for entry in entries}
    pairs = [name for name in ("Tsit5", "Bosh3") if f"jaxroll, {name}" in rates]
    ratios = [f"{rates[f'jaxroll, {x}'] / rates[f'Numba, {x}']:.2f} with {x} in both" for x in pairs]
    return "".join(f"; {ratio}" for ratio in ratios)


def conclusion(found: dict[str, list[Entry]]) -> str:
    parts = []
    for name, entries in found.items():
        ours, peer = best(entries, "jaxroll"), best(entries, "Numba")
        ratio = ours.rate() / peer.rate()
        parts.append(f"{ratio:.2f} times in `{name}` ({ours.name} against {peer.name}{_alike(entries)})")
        plain = [e for e in entries if e.name.startswith("plain")]
        if plain:
            parts[-1] += f", where it is {ours.rate() / plain[0].rate():.0f} times a plain diffrax solve"
    return f"Per core jaxroll's runs per second are, of the best Numba loop's, {'; '.join(parts)}."


def report(quick: bool = False) -> str:
    """Markdown: one table for both scenes and a sentence computed from it."""
    lanes, rounds, found, lines = (256, 2, {}, []) if quick else (4096, 4, {}, [])
    for case in (
        Case("pivoted", jxr.scenes.pivoted, pivoted_numba, 3.0, lanes),
        Case("pinch", jxr.scenes.pinch, pinch_numba, 2.0, lanes),
    ):
        entries = found[case.name] = measure(case, rounds)
        peer = best(entries, "Numba").rate()
        for e in entries:
            line = [f"{case.name}, {case.span:g} s", e.name, f"{e.setting:g}", f"{e.error:.1e}"]
            lines.append([*line, str(e.lanes), f"{e.rate():.0f}", f"{e.rate() / peer:.2f}", e.codes])
    header = ["scene", "contender", "setting", "error [rad]", "lanes", "runs/s per core"]
    footer = f"{device()}; {versions('jax', 'jaxlib', 'diffrax', 'numba')}."
    grid = table([*header, "over the best Numba", "result codes"], lines)
    return "\n\n".join([f"**Conclusion.** {conclusion(found)}", grid, footer])


if __name__ == "__main__":
    command("batch", report)
