"""What a gradient costs: value and gradient over the run, and where the time goes (about five minutes).

`python -m benchmarks.gradients --write` rewrites its section of README.md; `--quick`: two rows. Nearly all of
the time is compilation. Every function makes its scene from the parameters, closes it and runs it, with
tables of contours built inside; the primal does the same. Times are processor seconds, medians of interleaved
warm calls under `jax.jit`; a gradient's error is its largest difference from central differences of fourth
order at rtol 1e-12, over its largest component.
"""

import functools
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr
from benchmarks import _shaped
from benchmarks._common import command, device, interleaved, table, versions
from jaxroll.design import value_and_grad
from jaxroll.design._gradient import Mode
from jaxroll.geometry import AbstractContour

jax.config.update("jax_enable_x64", True)

ASKED, STEP, ROUNDS = 4.0, 3e-3, 31
Make = Callable[[jax.Array], tuple[jxr.Grasp, jxr.State]]


class Case(NamedTuple):
    """A scene made from parameters, where they are, and the modes that it is differentiated in."""

    scene: str
    name: str
    make: Make
    x: jax.Array
    modes: tuple[Mode, ...]


class Cost(NamedTuple):
    """What one gradient took: seconds of the primal and of value and gradient, error, result code."""

    case: Case
    mode: Mode
    primal: float
    both: float
    error: float
    code: str

    @property
    def ratio(self) -> float:
        """Value and gradient over the primal."""
        return self.both / self.primal


def tipped(scene: str, tip: Callable[[jax.Array], AbstractContour]) -> Make:
    return lambda x: _shaped.with_tip(scene, tip(x))


def cases(quick: bool) -> Iterator[Case]:
    shapes = {"support function": _shaped.support, "spline": _shaped.spline}
    for name, tip in list(shapes.items())[: 1 if quick else 2]:
        yield Case("pivoted", f"tip: {name}", tipped("pivoted", tip), jnp.zeros(30), ("reverse",))
    factors = lambda scene: functools.partial(_shaped.with_factors, scene)  # noqa: E731
    for scene in ("pivoted",) if quick else ("pivoted", "pinch"):
        yield Case(scene, "damping", factors(scene), jnp.ones(1), ("forward",))
        if not quick:
            yield Case(scene, "gains and masses", factors(scene), jnp.ones(7), ("forward",))
            both: tuple[Mode, ...] = ("forward", "reverse")
            yield Case(scene, "half axes of the tips", tipped(scene, _shaped.ellipse), jnp.ones(2), both)


class Many(NamedTuple):
    """Gradients of many runs in one call: seconds of one alone, of a run in a batch, of a gradient in one."""

    case: Case
    lanes: int
    alone: float
    run: float
    lane: float


def batches(quick: bool) -> Iterator[Many]:
    """Gradients in the damping, and in all seven numbers, of runs whose numbers differ by a tenth."""
    asked = ("pivoted", "damping", 1, 64 if quick else 512), ("pinch", "gains and masses", 7, 128)
    for scene, name, count, lanes in asked[: 1 if quick else 2]:
        make = functools.partial(_shaped.with_factors, scene)
        case = Case(scene, name, make, jnp.ones(count), ("reverse",))
        value = lambda x, make=make, scene=scene: _shaped.end(scene, *make(x), 1e-8)[0]  # noqa: E731
        draws = jnp.asarray(np.random.default_rng(0).uniform(0.9, 1.1, (lanes, count)))
        one, runs = ready(jax.value_and_grad(value), draws[0]), ready(jax.vmap(value), draws)
        slopes = ready(jax.vmap(jax.value_and_grad(value)), draws)
        times = interleaved([one, runs, slopes], rounds=5, clock=time.process_time)
        yield Many(case, lanes, times[0], times[1] / lanes, times[2] / lanes)


def ready(function: Callable, *args: Any) -> Callable[[], Any]:
    """The compiled function as a call that waits for its result."""
    program = jax.jit(function).lower(*args).compile()
    return lambda: jax.block_until_ready(program(*args))


def differences(value: Callable[[jax.Array, float], Any], x: jax.Array) -> np.ndarray:
    """Central differences of fourth order of a scalar function, one component after the other."""
    slopes = []
    for way in np.eye(x.size):
        ends = [float(value(x + k * STEP * way, 1e-12)[0]) for k in (-2, -1, 1, 2)]
        slopes.append((ends[0] - 8.0 * ends[1] + 8.0 * ends[2] - ends[3]) / (12.0 * STEP))
    return np.array(slopes)


def costs(case: Case) -> Iterator[Cost]:
    def value(x: jax.Array, rtol: Any) -> Any:
        return _shaped.end(case.scene, *case.make(x), rtol)

    either = jax.jit(value)
    exact = differences(either, case.x)
    primal = lambda: jax.block_until_ready(either(case.x, 1e-8))  # noqa: E731
    plain = lambda x: value(x, 1e-8)  # noqa: E731
    for mode in case.modes:
        both = ready(value_and_grad(plain, mode, has_aux=True), case.x)
        (_, code), slope = both()
        error = float(np.abs(slope - exact).max() / np.abs(exact).max())
        run, whole = interleaved([primal, both], rounds=ROUNDS, clock=time.process_time)
        yield Cost(case, mode, run, whole, error, "successful" if int(code) == 0 else f"code {int(code)}")


def parts() -> Iterator[tuple[str, float, float]]:
    """Seconds of what a gradient in 30 numbers is made of, alone: primal, and with its derivative."""
    shapes, none = (("support function", _shaped.support), ("spline", _shaped.spline)), jnp.zeros(30)
    for name, tip in shapes:
        build = lambda x, tip=tip: tip(x).prepared().table  # noqa: E731
        yield f"table of the {name}", *_both_ways(build, none)
    tip = _shaped.support(none).prepared()
    given = lambda table: eqx.tree_at(lambda c: c.table, tip, table)  # noqa: E731
    grasp, state = _shaped.with_tip("pivoted", tip)
    shape = lambda table: given(table).moved(angle=-0.5 * np.pi)  # noqa: E731
    closed = lambda table: jxr.close(grasp.with_tip(0, shape(table)), state)[1].q  # noqa: E731
    yield "closing, table given", *_both_ways(closed, tip.table)
    run = lambda table: _shaped.end("pivoted", grasp.with_tip(0, shape(table)), state)[0]  # noqa: E731
    yield "run, table and start given", *_both_ways(run, tip.table)


def _both_ways(function: Callable, x: Any) -> tuple[float, float]:
    """Seconds of a function, and of it with its cotangent; interleaved."""

    def back(x: Any, bar: Any) -> Any:
        out, pull = jax.vjp(function, x)
        return out, pull(bar)

    primal = ready(function, x)
    both = ready(back, x, jax.tree.map(jnp.ones_like, primal()))
    alone, whole = interleaved([primal, both], rounds=ROUNDS, clock=time.process_time)
    return alone, whole


def ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


def conclusion(found: list[Cost], pieces: list[tuple[str, float, float]]) -> str:
    large = [cost for cost in found if cost.case.x.size == 30]
    worst, error = max(cost.ratio for cost in large), max(cost.error for cost in found)
    said = f"Value and gradient in 30 numbers take {' and '.join(f'{c.ratio:.1f}' for c in large)} runs "
    said += f"(asked: {ASKED:g}, {'met' if worst <= ASKED else 'missed'}); of all gradients the largest "
    said += f"error is {error:.0e}. "
    if not pieces:
        return said.strip()
    name, primal, both = max(pieces, key=lambda piece: piece[2] - piece[1])
    return said + f"Of the parts the derivative of '{name}' costs most: {ms(both - primal)} ms more."


def report(quick: bool = False) -> str:
    found = []
    for case in cases(quick):
        for cost in costs(case):
            found.append(cost)
            print(case.scene, case.name, *cost[1:], f"{cost.ratio:.2f}", file=sys.stderr, flush=True)
    header = [
        "scene",
        "parameters",
        "how many",
        "mode",
        "run [ms]",
        "value and gradient [ms]",
        "ratio",
        "error",
        "result",
    ]
    lines = []
    for cost in found:
        what = [cost.case.scene, cost.case.name, str(cost.case.x.size), cost.mode]
        times = [ms(cost.primal), ms(cost.both), f"{cost.ratio:.1f}"]
        lines.append([*what, *times, f"{cost.error:.0e}", cost.code])
    pieces = [] if quick else list(parts())
    split = [[name, ms(primal), ms(both), f"{both / primal:.1f}"] for name, primal, both in pieces]
    sections = [table(header, lines)]
    if pieces:
        sections.append(table(["part", "alone [ms]", "with its derivative [ms]", "ratio"], split))
    many = [
        [m.case.scene, m.case.name, str(m.case.x.size), str(m.lanes), ms(m.alone), ms(m.run), ms(m.lane)]
        for m in batches(quick)
    ]
    what = ["scene", "parameters", "how many", "lanes", "gradient alone [ms]", "run in a batch [ms]"]
    sections.append(table([*what, "gradient in a batch [ms]"], many))
    footer = f"{device()}  \n{versions('jax', 'jaxlib', 'diffrax')}"
    return "\n\n".join([f"**Conclusion.** {conclusion(found, pieces)}", *sections, footer])


if __name__ == "__main__":
    command("gradients", report)
