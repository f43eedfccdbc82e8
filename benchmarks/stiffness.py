"""Solvers for long runs of Part 1's pinch, whose fast rates (-700 1/s) die out early (about five minutes).

`python -m benchmarks.stiffness --write` rewrites its section of README.md; `--quick`: 20 s only, and without
diffrax's implicit methods, which take minutes to compile. Errors are those of angles and positions
at ten saved times against `Dopri8` at 1e-12; times are processor time, medians of interleaved warm runs,
which other work on the machine moves less than the clock's.
"""

import dataclasses
import time

import diffrax
import jax
import numpy as np

import jaxroll as jxr
from benchmarks._common import command, device, interleaved, ms, size, table, versions
from benchmarks.contenders.stiff_solvers import RKC

jax.config.update("jax_enable_x64", True)

TARGETS = (1e-4, 1e-6, 1e-8)
EXPLICIT = {
    "Dopri8 (default)": diffrax.Dopri8(),
    "Dopri5": diffrax.Dopri5(),
    "Tsit5": diffrax.Tsit5(),
    "Bosh3": diffrax.Bosh3(),
}
STABILISED = {"RKC, rate 1000 1/s given": RKC(1000.0), "RKC, rate estimated": RKC()}
# diffrax's KenCarp methods want the field in two parts, and do not run on one.
IMPLICIT = {"Kvaerno3": diffrax.Kvaerno3(), "Kvaerno5": diffrax.Kvaerno5()}
OURS = {"jxr.Rosenbrock": jxr.Rosenbrock()}
LADDER = 10.0 ** -np.arange(3, 11)
HEADER = ("solver", "rtol", "steps", "evaluations", "ms", "error at the end", "largest error", "code")


@dataclasses.dataclass
class Point:
    """One solver at one tolerance: what it did and how long it took [s]."""

    name: str
    rtol: float
    steps: int
    evaluations: int | None
    ends: float
    largest: float
    code: int
    seconds: float = float("nan")

    def row(self) -> list[str]:
        """For the table."""
        count = "" if self.evaluations is None else str(self.evaluations)
        code = "ok" if self.code == 0 else f"failed ({self.code})"
        errors = size(self.ends), size(self.largest)
        return [self.name, f"{self.rtol:.0e}", str(self.steps), count, ms(self.seconds), *errors, code]


class Race:
    """Solvers on the pinch over one span."""

    def __init__(self, span: float) -> None:
        self.scene, self.span = jxr.scenes.pinch(), span
        self.ts = np.linspace(span / 10, span, 10)
        self.exact = np.asarray(self.run(None, 1e-12).states.q)

    def run(self, solver, rtol):
        """One run to its end."""
        options = {"ts": self.ts, "throw": False, "max_steps": 10**6}
        return jax.block_until_ready(
            jxr.simulate(*self.scene, self.span, solver=solver, rtol=rtol, **options)
        )

    def point(self, name, solver, rtol) -> Point:
        """Errors and counts, untimed."""
        done = self.run(solver, rtol)
        off = np.abs(np.asarray(done.states.q) - self.exact).max(axis=1)
        steps = int(done.stats.steps)
        each = evaluations(solver, done.states)
        count = None if each is None else each * steps
        return Point(name, rtol, steps, count, off[-1], off.max(), int(done.result._value))

    def best(self, solvers, targets=TARGETS) -> list[Point]:
        """For each solver the loosest tolerance that meets each target, timed side by side."""
        points = [p for name, solver in solvers.items() for p in self.meeting(name, solver, targets)]
        calls = [lambda p=p: self.run(solvers[p.name], p.rtol) for p in points]
        for point, spent in zip(points, interleaved(calls, rounds=15, clock=time.process_time), strict=True):
            point.seconds = spent
        return points

    def meeting(self, name, solver, targets) -> list[Point]:
        """The loosest tolerances that meet the targets; the first one where a run fails."""
        found, left = {}, sorted(targets, reverse=True)
        for rtol in LADDER:
            point = self.point(name, solver, rtol)
            if point.code:
                found.setdefault(rtol, point)
                break
            while left and point.largest <= left[0]:
                found[rtol] = point
                left.pop(0)
            if not left:
                break
        return list(found.values())


def evaluations(solver, states) -> int | None:
    """Evaluations of the equations of motion in a step."""
    if isinstance(solver, diffrax.AbstractERK):
        tableau = solver.tableau
        return tableau.num_stages - int(tableau.fsal and tableau.ssal)  # pyright: ignore
    if isinstance(solver, jxr.Rosenbrock):
        return sum(x.shape[-1] for x in (states.q, states.v, states.s)) + 2 + 8
    return None


def compiling(solver) -> float:
    """Processor time of a first call [s], less that of a warm one."""
    scene, spent = jxr.scenes.pinch(), []
    jax.clear_caches()
    for _ in range(2):
        start = time.process_time()
        jax.block_until_ready(jxr.simulate(*scene, 0.02, ts=2, solver=solver, throw=False))
        spent.append(time.process_time() - start)
    return spent[0] - spent[1]


def fastest(points, explicit, target):
    """The quickest point of a kind that meets a target."""
    met = [p for p in points if p.code == 0 and p.largest <= target and (p.name in EXPLICIT) == explicit]
    return min(met, key=lambda p: p.seconds, default=None)


def verdict(points, span) -> str:
    """Who wins, from the numbers."""
    lines = []
    for target in TARGETS:
        old, new = fastest(points, True, target), fastest(points, False, target)
        if old is None or new is None:
            continue
        ratio = old.seconds / new.seconds
        lines.append(
            f"- {span:g} s, error <= {target:.0e}: {new.name} takes {ms(new.seconds)} ms, "
            f"the best explicit method ({old.name}) {ms(old.seconds)} ms: {ratio:.1f} times as long."
        )
    return "\n".join(lines)


def report(quick: bool = False) -> str:
    """The tables and what they say, as Markdown."""
    solvers = {**EXPLICIT, **STABILISED, **OURS, **({} if quick else IMPLICIT)}
    said, parts = [], []
    for span in (20.0,) if quick else (20.0, 10.0, 100.0):
        contenders = solvers if span == 20.0 else {**EXPLICIT, **OURS}
        points = Race(span).best(contenders)
        said.append(verdict(points, span))
        parts += [f"{span:g} s:", table(HEADER, [point.row() for point in points])]
    names = list(OURS) + ["Dopri8 (default)", "Bosh3"]
    costs = ", ".join(f"{name} {compiling(solvers[name]):.1f} s" for name in names)
    parts.append(f"First call less a warm one, processor time: {costs}.")
    parts.append(f"{device()}; {versions('jax', 'diffrax')}.")
    return "\n\n".join(["**Conclusion.**", *said, *parts])


if __name__ == "__main__":
    command("stiffness", report)
