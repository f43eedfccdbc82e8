"""Throughput of batches on one GPU, what bounds it, and a run of one kernel beside them (ten minutes there).

`python -m benchmarks.gpu --write` on a machine with a GPU rewrites its section of README.md; without one it
says so. `--quick` is a short run, `--cpu` a small check without a GPU (both kinds of run; the kernel is
emulated). Every lane has its own damping, 0.8 to 1.2 of the scene's. Times are the least of three warm calls;
errors are the largest over 16 lanes against float64 at a relative tolerance of 1e-11.
"""

import dataclasses
import re
import time
from collections.abc import Iterator
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr
from benchmarks._common import command, device, table, versions
from benchmarks.contenders.one_kernel import integrate
from jaxroll._integration import _batch

jax.config.update("jax_enable_x64", True)

TARGET, SAMPLE = 1e-6, 16
SPANS = {"pivoted": 3.0, "pinch": 2.0}
LADDER = {"float64": (1e-4, 3e-5, 1e-5, 3e-6, 1e-6), "float32": (1e-4, 3e-5, 1e-5)}
# A kernel's launch, and the trip to the host that a loop without a known length takes at every turn [s].
LAUNCH = (2e-6, 5e-6)
# Datasheets, dense and without tensor cores: float64 and float32 [FLOP/s], memory [B/s].
PEAKS = {
    "H200": {"float64": 34e12, "float32": 67e12, "memory": 4.8e12},
    "H100 PCIe": {"float64": 26e12, "float32": 51e12, "memory": 2.0e12},
    "H100": {"float64": 34e12, "float32": 67e12, "memory": 3.35e12},
    "A100": {"float64": 9.7e12, "float32": 19.5e12, "memory": 2.0e12},
}
_NO_KERNELS = ("parameter", "get-tuple-element", "tuple", "bitcast", "constant", "while", "after-all")
NOT_MEASURED = "**Conclusion.** not measured: no GPU at hand"


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene in one precision, how long it runs [s], and whether the kernel is emulated."""

    scene: str
    precision: str
    span: float
    emulated: bool
    start: tuple[Any, Any] = dataclasses.field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Close the scene here, not in every lane."""
        scene = getattr(jxr.scenes, self.scene)()
        object.__setattr__(self, "start", jax.tree.map(lambda x: x.astype(self.precision), scene))

    def make(self, share: Any) -> tuple[Any, Any]:
        """Grasp and state with this share of the scene's damping."""
        grasp, state = self.start
        return grasp.with_(damping=grasp.controller.damping * share), state

    def shares(self, lanes: int) -> jax.Array:
        """Every lane's share."""
        return jnp.linspace(0.8, 1.2, lanes, dtype=self.precision)

    def batch(self, share: Any, rtol: Any) -> tuple[Any, Any, Any]:
        """Last configuration, code and attempted steps of an ordinary run."""
        options = {"ts": 1, "rtol": rtol, "solver": diffrax.Tsit5(), "throw": False}
        run = jxr.simulate(*self.make(share), self.span, **options)
        return run.last.q, run.result._value, run.stats.steps

    def one_kernel(self, share: Any, rtol: Any) -> tuple[Any, Any, Any]:
        """The same in one kernel."""
        options = {"block": SAMPLE, "interpret": True} if self.emulated else {}
        run = integrate(*self.make(share), self.span, rtol=rtol, **options)
        return run.last.q, run.result._value, run.steps[0]

    def reference(self) -> np.ndarray:
        """What 16 lanes come to in double precision."""
        exact = dataclasses.replace(self, precision="float64")
        run = lambda k: jxr.simulate(*exact.make(k), self.span, ts=1, rtol=1e-11, max_steps=65536)  # noqa: E731
        return np.asarray(jax.jit(jax.vmap(run))(exact.shares(SAMPLE)).last.q)


@dataclasses.dataclass
class Measured:
    """What one program did with so many lanes."""

    case: Case
    way: str
    rtol: float
    lanes: int
    compilation: float
    seconds: float
    error: float
    good: float
    attempted: tuple[int, int]  # most of any lane, sum
    memory: int
    text: str
    cost: dict[str, float]

    def row(self) -> list[str]:
        """Its line in the table."""
        return [
            self.case.scene,
            self.case.precision,
            self.way,
            f"{self.rtol:g}",
            f"{self.lanes}",
            f"{self.compilation:.1f}",
            f"{1e3 * self.seconds:.4g}",
            f"{self.lanes / self.seconds:.3g}",
            f"{self.error:.1e}",
            f"{100.0 * self.good:.2f}",
            f"{self.memory / 2**20:.0f}" if self.memory else "",
        ]


HEADER = ["scene", "precision", "way", "rtol", "lanes", "compilation [s]", "time [ms]", "runs/s",
          "error [rad, m]", "successful [%]", "peak memory [MiB]"]  # fmt: skip


def measured(case: Case, way: str, rtol: float, lanes: int, exact: np.ndarray) -> Measured:
    """Compile and time one program; errors are those of a sample of its lanes."""
    shares, tolerance = case.shares(lanes), jnp.asarray(rtol, case.precision)
    start = time.perf_counter()
    lowered = jax.jit(jax.vmap(getattr(case, way), (0, None))).lower(shares, tolerance)
    program = lowered.compile()
    compilation = time.perf_counter() - start
    q, codes, steps = jax.block_until_ready(program(shares, tolerance))
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        jax.block_until_ready(program(shares, tolerance))
        best = min(best, time.perf_counter() - start)
    picked = np.round(np.linspace(0, lanes - 1, SAMPLE)).astype(int)
    error = float(np.abs(np.asarray(q)[picked] - exact).max())
    attempted = int(np.max(steps)), int(np.sum(np.asarray(steps, np.int64)))
    return Measured(
        case, way, rtol, lanes, compilation, best, error, float(np.mean(np.asarray(codes) == 0)),
        attempted, _peak_memory(), program.as_text() or "", _cost(lowered, program),
    )  # fmt: skip


def _peak_memory() -> int:
    stats = jax.devices()[0].memory_stats() or {}
    return int(stats.get("peak_bytes_in_use", 0))


def _cost(lowered: Any, program: Any) -> dict[str, float]:
    """Flops and bytes; a loop of unknown length counts as one turn of it."""
    cost = program.cost_analysis()
    if cost:
        return dict(cost)
    # Before compilation every loop counts as one turn, and bytes are those of a program without fusion.
    return {"flops": (lowered.cost_analysis() or {}).get("flops", 0.0)}


def tolerance(case: Case, exact: np.ndarray) -> float:
    """The loosest tolerance that meets the target, else the most accurate one."""
    program = jax.jit(jax.vmap(case.batch, (0, None)))
    errors = {}
    for rtol in LADDER[case.precision]:
        q, _, _ = program(case.shares(SAMPLE), jnp.asarray(rtol, case.precision))
        errors[rtol] = float(np.abs(np.asarray(q) - exact).max())
        if errors[rtol] <= TARGET:
            return rtol
    return min(errors, key=lambda rtol: errors[rtol])


def growing(limit: int) -> Iterator[int]:
    """10^3, 10^4, 10^5, 10^6, then twice as many every time."""
    lanes = 1000
    while lanes <= limit:
        yield lanes
        lanes *= 10 if lanes < 10**6 else 2


def climbed(case: Case, way: str, rtol: float, exact: np.ndarray, sizes: list[int]) -> list[Measured]:
    """More and more lanes, until memory is spent or a call takes a minute."""
    found: list[Measured] = []
    for lanes in sizes:
        try:
            found.append(measured(case, way, rtol, lanes, exact))
        except jax.errors.JaxRuntimeError as failure:
            if "RESOURCE_EXHAUSTED" not in str(failure):
                raise
            print(f"{case.scene}, {case.precision}, {way}: no memory for {lanes} lanes")
            break
        print(" ".join(found[-1].row()), flush=True)
        if found[-1].seconds > 60.0:
            break
    return found


def launches(text: str) -> int:
    """Kernels that one turn of a compiled program's longest loop launches.

    Of the loops without a known length; one with a known length inside counts that many times.
    """
    bodies: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in text.splitlines():
        head = re.match(r"(?:ENTRY )?%?([\w.\-]+) \(.*\{$", line)
        if head:
            lines = bodies.setdefault(head[1], [])
        elif line.startswith("  "):
            lines.append(line)
    turns = [0]
    for line in (line for lines in bodies.values() for line in lines):
        loop = _loop(line)
        if loop and loop[2] is None:
            turns.append(_kernels(bodies, loop[0]) + _kernels(bodies, loop[1]))
    return max(turns)


def _loop(line: str) -> tuple[str, str, int | None] | None:
    """Body, condition and known length of a loop."""
    if " while(" not in line:
        return None
    body, condition = (re.search(rf"{kind}=%?([\w.\-]+)", line) for kind in ("body", "condition"))
    known = re.search(r'known_trip_count":\{"n":"(\d+)"', line)
    if body is None or condition is None:
        return None
    return body[1], condition[1], int(known[1]) if known else None


def _kernels(bodies: dict[str, list[str]], name: str) -> int:
    count = 0
    for line in bodies.get(name, []):
        operation, loop = re.search(r" = .*? ([a-z][a-z\-]*)\(", line), _loop(line)
        if loop:
            count += (loop[2] or 1) * _kernels(bodies, loop[0])
        elif operation and operation[1] not in _NO_KERNELS:
            count += 1
    return count


def bounds(run: Measured, kind: str) -> list[str]:
    """What one batch would take at least by each of its limits [ms], and what it took."""
    most, total = run.attempted
    turns = max(most, -(-total // min(run.lanes, _batch._DEVICE_SLOTS)))
    kernels = launches(run.text)
    peak = next((p for name, p in PEAKS.items() if all(part in kind for part in name.split())), None)
    flops, moved = run.cost.get("flops"), run.cost.get("bytes accessed")
    limits = [
        1e3 * turns * flops / peak[run.case.precision] if peak and flops else None,
        1e3 * turns * moved / peak["memory"] if peak and moved else None,
        *(1e3 * turns * (kernels + 1) * each for each in LAUNCH),
    ]
    shown = ["" if x is None else f"{x:.3g}" for x in limits]
    head = [run.case.scene, run.case.precision, f"{run.lanes}", f"{turns}", f"{kernels}"]
    return [*head, *shown, f"{1e3 * run.seconds:.3g}"]


BOUNDS = ["scene", "precision", "lanes", "turns", "kernels per turn", "arithmetic [ms]", "memory [ms]",
          "launches of 2 us [ms]", "of 5 us [ms]", "measured [ms]"]  # fmt: skip


def tuned(case: Case, rtol: float, exact: np.ndarray, lanes: int) -> str:
    """The ordinary batch at other numbers of slots."""
    rows, usual = [], _batch._DEVICE_SLOTS
    for slots in (2**14, 2**16, 2**18, 2**20):
        _batch._DEVICE_SLOTS = slots
        jax.clear_caches()
        run = measured(case, "batch", rtol, lanes, exact)
        rows.append([f"{slots}", f"{lanes / run.seconds:.3g}"])
    _batch._DEVICE_SLOTS = usual
    jax.clear_caches()
    title = f"Runs stepped together, {case.scene}, {case.precision}, {lanes} lanes (the package has {usual}):"
    return f"{title}\n\n{table(['slots', 'runs/s'], rows)}"


def measure(cases: list[Case], sizes: list[int], slots_at: int | None = None) -> str:
    """The section as Markdown.

    Args:
        cases: What to run.
        sizes: Numbers of lanes, rising.
        slots_at: Lanes at which to try other numbers of slots, with the first case; None for not at all.
    """
    runs: list[Measured] = []
    rest = []
    for case in cases:
        exact = case.reference()
        rtol = tolerance(case, exact)
        for way in ("batch", "one_kernel"):
            runs += climbed(case, way, rtol, exact, sizes)
        if slots_at and case is cases[0]:
            rest.append(tuned(case, rtol, exact, slots_at))
    kind = jax.devices()[0].device_kind
    batches = [bounds(run, kind) for run in runs if run.way == "batch"]
    return "\n\n".join(
        [
            f"**Conclusion.** {conclusion(runs)}",
            f"{kind}, {device()}; {versions('jax', 'jaxlib', 'diffrax', 'jaxroll')}",
            table(HEADER, [run.row() for run in runs]),
            "What bounds the ordinary batch: arithmetic and memory traffic of the compiled program at the "
            "device's peak, and the launches of its kernels. Empty: the compiler or the table does not say.",
            table(BOUNDS, batches),
            *rest,
        ]
    )


def conclusion(runs: list[Measured]) -> str:
    """The highest rates of both ways."""
    parts = []
    for case in dict.fromkeys(run.case for run in runs):
        own = [run for run in runs if run.case == case]
        for way, name in (("batch", "the ordinary batch"), ("one_kernel", "one kernel")):
            best = max((r for r in own if r.way == way), key=lambda r: r.lanes / r.seconds, default=None)
            if best is not None:
                rate = f"{best.lanes / best.seconds:.3g} runs/s with {best.lanes} lanes ({best.error:.1e})"
                parts.append(f"{case.scene} in {case.precision}, {name}: {rate}")
    return f"Highest rates and their errors: {'; '.join(parts)}."


def report(quick: bool = False, *, cpu: bool = False) -> str:
    """The section as Markdown."""
    if cpu:
        return measure([Case("pivoted", p, 0.05, emulated=True) for p in LADDER], [SAMPLE])
    if jax.default_backend() != "gpu":
        return NOT_MEASURED
    scenes = ["pivoted"] if quick else list(SPANS)
    cases = [Case(scene, p, SPANS[scene], emulated=False) for scene in scenes for p in LADDER]
    limit = 10**5 if quick else 16 * 10**6
    return measure(cases, list(growing(limit)), None if quick else 10**6)


if __name__ == "__main__":
    command("gpu", report, cpu="a small check on the processor")
