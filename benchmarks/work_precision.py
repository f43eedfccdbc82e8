"""Run time against error on the chapter's Part 2 testbed: jaxroll, SciPy and SUNDIALS.

    python -m benchmarks.work_precision            # full run; rewrites README.md and work_precision.png
    python -m benchmarks.work_precision --quick    # under a minute; prints only
"""

import argparse
import dataclasses
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from scipy.integrate import ode, odeint, solve_ivp
from sksundae.cvode import CVODE
from sksundae.ida import IDA

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import jaxroll as jxr
from benchmarks import _pivoted_numba as pivoted
from benchmarks._common import device, interleaved, table, versions, write_section

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)

END = 3.0
TIMES = np.array([0.01, 0.03, 0.06, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, END])
TARGET = 1e-8
FIGURE = Path(__file__).with_name("work_precision.png")
LADDER = tuple(10.0**-k for k in range(4, 13))
SHORT_LADDER = (1e-6, 1e-8, 1e-10)
# s [m] of the peers is controlled a hundred times tighter than angles [rad]: the curvatures add to 140 1/m.
SCALES = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.01])
MOST_STEPS = 100_000


@dataclasses.dataclass(frozen=True)
class Run:
    """One contender at one tolerance and one set of saved times, ready to be timed.

    `call` is timed; `read` turns what it returned into states of shape (t, 7); `count` gives steps and
    evaluations of the equations of motion, untimed; `bare` is the same run with less Python around it.
    """

    call: Callable[[], Any]
    read: Callable[[Any], np.ndarray]
    count: Callable[[], tuple[int | None, int | None]]
    bare: Callable[[], Any] | None = None


@dataclasses.dataclass(frozen=True)
class Contender:
    """A formulation and a solver; `make(tolerance, times)` prepares a run."""

    family: str
    formulation: str
    solver: str
    make: Callable[[float, np.ndarray], Run]
    tightest: float = 1e-12


@dataclasses.dataclass
class Result:
    """What one contender did at one tolerance: seconds and largest errors [rad], both ladders."""

    contender: Contender
    tolerance: float
    steps: int | None = None
    evaluations: int | None = None
    gap: float = float("nan")
    outcome: str = "ok"
    errors: dict[str, float] = dataclasses.field(default_factory=dict)
    times: dict[str, float] = dataclasses.field(default_factory=dict)
    bare_times: dict[str, float] = dataclasses.field(default_factory=dict)


# --- jaxroll -----------------------------------------------------------------------------------------


def jaxroll_contender(formulation: Any, solver: diffrax.AbstractERK) -> Contender:
    grasp, state = jxr.scenes.pivoted()
    options: dict[str, Any] = {"solver": solver, "formulation": formulation, "max_steps": 20_000}
    tableau = solver.tableau
    stages = tableau.num_stages - int(bool(tableau.fsal and tableau.ssal))
    compiled: dict[int, Callable] = {}

    def make(tolerance: float, times: np.ndarray) -> Run:
        ts = 1 if times.size == 1 else jnp.asarray(times)
        # An array, not a Python number: one compiled program serves the whole ladder.
        rtol = jnp.asarray(tolerance)
        bare = compiled.setdefault(
            times.size,
            jax.jit(lambda g, x, r: jxr.simulate(g, x, END, ts=ts, rtol=r, **options).states),
        )

        def call() -> jxr.Trajectory:
            return jax.block_until_ready(
                jxr.simulate(grasp, state, END, ts=ts, rtol=rtol, **options)
            )

        def count() -> tuple[int, int]:
            steps = int(call().stats.steps)
            return steps, 1 + stages * steps

        return Run(call, _from_jaxroll, count, lambda: jax.block_until_ready(bare(grasp, state, rtol)))

    name = type(formulation).__name__.lower()
    return Contender(f"jaxroll {name}", name, type(solver).__name__, make)


def _from_jaxroll(run: jxr.Trajectory) -> np.ndarray:
    states = run.states
    return np.concatenate([states.q, states.v, pivoted.S_START - np.asarray(states.s)], axis=1)


# --- SciPy -------------------------------------------------------------------------------------------


def solve_ivp_contender(x0: np.ndarray, method: str, tightest: float) -> Contender:
    def make(tolerance: float, times: np.ndarray) -> Run:
        def run(**more: Any) -> Any:
            solved = solve_ivp(
                pivoted.rates, (0.0, END), x0, method, rtol=tolerance, atol=tolerance * SCALES, **more
            )
            if not solved.success:
                raise RuntimeError(solved.message)
            return solved

        def count() -> tuple[int, int]:
            solved = run()
            return solved.t.size - 1, solved.nfev

        return Run(lambda: run(t_eval=times), lambda solved: solved.y.T, count)

    return Contender("SciPy", "index-1", f"{method} (solve_ivp)", make, tightest)


def odeint_contender(x0: np.ndarray) -> Contender:
    def make(tolerance: float, times: np.ndarray) -> Run:
        ts = np.concatenate([[0.0], times])

        def run(full: bool = False) -> Any:
            return odeint(
                pivoted.rates,
                x0,
                ts,
                rtol=tolerance,
                atol=tolerance * SCALES,
                tfirst=True,
                mxstep=MOST_STEPS,
                full_output=full,
            )

        def count() -> tuple[int, int]:
            info = run(full=True)[1]
            if info["message"] != "Integration successful.":
                raise RuntimeError(info["message"])
            return int(info["nst"][-1]), int(info["nfe"][-1])

        return Run(run, lambda path: path[1:], count)

    return Contender("SciPy", "index-1", "LSODA (odeint)", make)


def compiled_dop853_contender(x0: np.ndarray) -> Contender:
    """Hairer's DOP853 inside `scipy.integrate.ode`: the loop is compiled, unlike that of `solve_ivp`."""

    def make(tolerance: float, times: np.ndarray) -> Run:
        def run(function: Callable = pivoted.rates, watch: Callable | None = None) -> np.ndarray:
            solver = ode(function).set_integrator(
                "dop853", rtol=tolerance, atol=tolerance, nsteps=MOST_STEPS
            )
            if watch is not None:
                solver.set_solout(watch)
            solver.set_initial_value(x0, 0.0)
            path = [solver.integrate(t) for t in times]
            if not solver.successful():
                raise RuntimeError(f"dop853 returned {solver.get_return_code()}")
            return np.array(path)

        def count() -> tuple[int, int]:
            evaluations, steps = [], []

            def function(t: float, x: np.ndarray) -> np.ndarray:
                evaluations.append(t)
                return pivoted.rates(t, x)

            run(function, lambda t, x: steps.append(t))
            return len(steps) - times.size, len(evaluations)

        return Run(run, lambda path: path, count)

    return Contender("SciPy", "index-1", "DOP853 (ode)", make)


# --- SUNDIALS ----------------------------------------------------------------------------------------


def _sundials_run(solver: Any, start: tuple[np.ndarray, ...], times: np.ndarray) -> Run:
    ts = np.concatenate([[0.0], times])

    def checked(solved: Any) -> Any:
        if not solved.success:
            raise RuntimeError(solved.message)
        return solved

    def run() -> Any:
        if times.size == 1:
            solver.init_step(0.0, *start)
            return checked(solver.step(END))
        return checked(solver.solve(ts, *start))

    def read(solved: Any) -> np.ndarray:
        return np.atleast_2d(solved.y)[-times.size :, :7]

    def count() -> tuple[int, int]:
        solved = checked(solver.solve([0.0, END], *start))
        return solved.t.size - 1, int(solved.nfev)

    return Run(run, read, count)


def cvode_contender(x0: np.ndarray, method: str) -> Contender:
    def make(tolerance: float, times: np.ndarray) -> Run:
        solver = CVODE(
            pivoted.fill_rates,
            method=method,
            rtol=tolerance,
            atol=tolerance * SCALES,
            max_num_steps=MOST_STEPS,
        )
        return _sundials_run(solver, (x0,), times)

    return Contender("SUNDIALS", "index-1", f"CVODE {method}", make)


def ida_contender(x0: np.ndarray, index: int) -> Contender:
    residual = {1: pivoted.fill_residual_index1, 2: pivoted.fill_residual_index2}[index]
    extra = 2 * (index - 1)
    y0, rates0 = (np.concatenate([a, np.zeros(extra)]) for a in pivoted.with_multipliers(x0))

    def make(tolerance: float, times: np.ndarray) -> Run:
        # Multipliers are left out of error control, as is usual above index 1.
        scales = np.concatenate([SCALES, np.full(2 + extra, 1e12)])
        solver = IDA(
            residual,
            algebraic_idx=list(range(7, y0.size)),
            rtol=tolerance,
            atol=tolerance * scales,
            max_num_steps=MOST_STEPS,
        )
        return _sundials_run(solver, (y0, rates0), times)

    formulation = {1: "index-1, implicit", 2: "stabilised index-2"}[index]
    return Contender("SUNDIALS", formulation, "IDA", make)


# --- the run -----------------------------------------------------------------------------------------


def contenders(x0: np.ndarray, quick: bool) -> list[Contender]:
    solvers = (diffrax.Tsit5(), diffrax.Dopri5(), diffrax.Dopri8())
    listed = [
        jaxroll_contender(formulation, solver)
        for formulation in (jxr.Index1(), jxr.CSM())
        for solver in (solvers[2:] if quick else solvers)
    ]
    listed += [solve_ivp_contender(x0, "LSODA", 1e-12), solve_ivp_contender(x0, "DOP853", 1e-12)]
    listed += [solve_ivp_contender(x0, "Radau", 1e-8 if quick else 1e-10)]
    listed += [odeint_contender(x0), compiled_dop853_contender(x0)]
    listed += [cvode_contender(x0, method) for method in ("BDF", "Adams")]
    return listed + [ida_contender(x0, index) for index in (1, 2)]


def reference(x0: np.ndarray, span: float = 0.01) -> np.ndarray:
    """States at TIMES: DOP853 at 1e-13 on the hand-written equations, put back on the constraints often."""
    marks = np.union1d(np.arange(1, round(END / span) + 1) * span, TIMES)
    marks = marks[np.concatenate([[True], np.diff(marks) > 1e-9])]
    path, x, t = [], x0, 0.0
    for mark in marks:
        solved = solve_ivp(pivoted.rates, (t, mark), x, "DOP853", rtol=1e-13, atol=1e-15 * SCALES)
        x, t = pivoted.onto_constraints(solved.y[:, -1]), mark
        path.append(x)
    return np.array([path[int(np.argmin(np.abs(marks - t)))] for t in TIMES])


def agreement(exact: np.ndarray) -> str:
    """How far jaxroll at a tight tolerance is from the reference, in words."""
    grasp, state = jxr.scenes.pivoted()
    parts = []
    for way, rtol in ((jxr.Index1(), 1e-13), (jxr.CSM(), 1e-12)):
        run = jxr.simulate(
            grasp, state, END, ts=TIMES, rtol=jnp.asarray(rtol), formulation=way, max_steps=20_000
        )
        error = np.max(np.abs(np.asarray(run.states.q) - exact[:, :3]))
        parts.append(f"`{type(way).__name__.lower()}` at {rtol:.0e}: {error:.1e} rad")
    return "; ".join(parts)


def first_calls(result: Result, runs: dict[str, Run], exact: np.ndarray) -> dict[str, Run]:
    """Warm up and judge one contender; what fails is recorded and not timed."""
    try:
        for ladder, run in runs.items():
            path = run.read(run.call())
            error = np.abs(path[:, :3] - exact[-path.shape[0] :, :3])
            result.errors[ladder] = float(np.max(error))
            if ladder == "end":
                gap_q, gap_r, _ = pivoted.closure(*path[-1, [0, 1, 2, 6]])
                result.gap = max(abs(gap_q), abs(gap_r))
            if run.bare is not None:
                run.bare()
        result.steps, result.evaluations = runs["end"].count()
    except Exception as error:
        result.outcome = str(error).splitlines()[0][:60] or type(error).__name__
        result.errors.clear()
        return {}
    return runs


def measure(quick: bool) -> tuple[list[Result], str]:
    grasp, state = jxr.scenes.pivoted()
    x0 = np.concatenate([state.q, state.v, [pivoted.S_START]])
    exact = reference(x0)
    start_error = np.max(np.abs(pivoted.start() - x0))
    note = f"starting pose: {start_error:.0e} rad; {agreement(exact)}"
    print(f"reference against jaxroll: {note}", flush=True)
    results, calls, slots = [], [], []
    for contender in contenders(x0, quick):
        for tolerance in SHORT_LADDER if quick else LADDER:
            if tolerance < 0.99 * contender.tightest:
                continue
            result = Result(contender, tolerance)
            runs = {"end": contender.make(tolerance, TIMES[-1:]), "along": contender.make(tolerance, TIMES)}
            for ladder, run in first_calls(result, runs, exact).items():
                calls.append(run.call)
                slots.append((result.times, ladder))
                if run.bare is not None:
                    calls.append(run.bare)
                    slots.append((result.bare_times, ladder))
            results.append(result)
        print(f"ready: {contender.formulation}, {contender.solver}", flush=True)
    seconds = interleaved(calls, rounds=3 if quick else 9)
    for (where, ladder), value in zip(slots, seconds, strict=True):
        where[ladder] = value
    return results, note


# --- report ------------------------------------------------------------------------------------------


def fastest(results: Sequence[Result], ladder: str, bare: bool = False) -> Result | None:
    """The fastest ladder point whose error meets the target."""
    timed = [r for r in results if r.errors.get(ladder, np.inf) <= TARGET]
    timed = [r for r in timed if ladder in (r.bare_times if bare else r.times)]
    return min(timed, key=lambda r: (r.bare_times if bare else r.times)[ladder], default=None)


def by_contender(results: Sequence[Result]) -> dict[tuple[str, str], list[Result]]:
    groups: dict[tuple[str, str], list[Result]] = {}
    for r in results:
        groups.setdefault((r.contender.formulation, r.contender.solver), []).append(r)
    return groups


def same_solver_table(results: Sequence[Result], ladder: str) -> str:
    """(a): `index1` against `csm`, the same solver, each at its fastest point that meets the target."""
    groups, lines = by_contender(results), []
    for name in dict.fromkeys(solver for way, solver in groups if way == "csm"):
        pair = [groups["index1", name], groups["csm", name]]
        one, two = (fastest(group, ladder) for group in pair)
        bare_one, bare_two = (fastest(group, ladder, bare=True) for group in pair)
        if not (one and two and bare_one and bare_two):
            lines.append([name] + ["target not met"] + [""] * 6)
            continue
        fewest = [min(r.steps for r in g if r.errors.get(ladder, np.inf) <= TARGET) for g in pair]
        times = (one.times[ladder], two.times[ladder])
        bare = (bare_one.bare_times[ladder], bare_two.bare_times[ladder])
        lines.append(
            [name, str(fewest[0]), str(fewest[1]), f"**{fewest[1] / fewest[0]:.1f}**"]
            + [_ms(times[0]), _ms(times[1]), f"**{times[1] / times[0]:.1f}**"]
            + [_ms(bare[0]), _ms(bare[1]), f"**{bare[1] / bare[0]:.1f}**"]
        )
    header = ["solver", "steps `index1`", "steps `csm`", "ratio", "call `index1` [ms]", "call `csm` [ms]"]
    return table([*header, "ratio", "jitted `index1` [ms]", "jitted `csm` [ms]", "ratio"], lines)


def best_table(results: Sequence[Result], ladder: str) -> str:
    """(b): the fastest point of every contender that meets the target, fastest first."""
    found = []
    for group in by_contender(results).values():
        for bare in (False, True):
            best = fastest(group, ladder, bare)
            if best is not None:
                time = (best.bare_times if bare else best.times)[ladder]
                name = f"{best.contender.solver}{', jitted' if bare else ''}"
                found.append((time, name, best))
    lines = [
        [best.contender.family, best.contender.formulation, name, f"{best.tolerance:.0e}"]
        + [_ms(time), f"{best.errors[ladder]:.1e}", _count(best.evaluations)]
        for time, name, best in sorted(found, key=lambda item: item[0])
    ]
    return table(
        ["family", "formulation", "solver", "tolerance", "time [ms]", "error [rad]", "evaluations"], lines
    )


def verdict(results: Sequence[Result], ladder: str) -> str:
    """(b) in one sentence."""
    ours = [r for r in results if r.contender.family == "jaxroll index1"]
    peers = [r for r in results if r.contender.family in ("SciPy", "SUNDIALS")]
    call, bare, peer = fastest(ours, ladder), fastest(ours, ladder, bare=True), fastest(peers, ladder)
    if not (call and bare and peer):
        return "The target was not met by all families."
    ratios = [t / peer.times[ladder] for t in (call.times[ladder], bare.bare_times[ladder])]
    return (
        f"jaxroll's best: {_ms(call.times[ladder])} ms per public call ({call.contender.solver}), "
        f"{_ms(bare.bare_times[ladder])} ms under `jax.jit` ({bare.contender.solver}); best peer: "
        f"{_ms(peer.times[ladder])} ms ({peer.contender.solver}). jaxroll takes {ratios[0]:.2f} (call) "
        f"and {ratios[1]:.2f} (jitted) times the best peer's time."
    )


def full_table(results: Sequence[Result]) -> str:
    lines = [
        [r.contender.formulation, r.contender.solver, f"{r.tolerance:.0e}"]
        + [_count(r.steps), _count(r.evaluations), _ms(r.times.get("end")), _ms(r.bare_times.get("end"))]
        + [_size(r.errors.get("end")), _size(r.gap), _ms(r.times.get("along"))]
        + [_ms(r.bare_times.get("along")), _size(r.errors.get("along")), r.outcome]
        for r in results
    ]
    header = ["formulation", "solver", "tolerance", "steps", "evaluations", "call [ms]", "jitted [ms]"]
    header += ["error at 3 s [rad]", "gap at 3 s [m]", "13 saved: call [ms]", "13 saved: jitted [ms]"]
    return table([*header, "13 saved: largest error [rad]", "result"], lines)


def _ms(seconds: float | None) -> str:
    return "" if seconds is None else f"{1e3 * seconds:.3g}"


def _size(value: float | None) -> str:
    return "" if value is None or np.isnan(value) else f"{value:.1e}"


def _count(value: int | None) -> str:
    return "" if value is None else str(value)


def footer() -> list[str]:
    packages = ("jax", "jaxlib", "diffrax", "scipy", "numba", "scikit-sundae")
    return [device(), versions(*packages)]


def report(results: Sequence[Result], note: str) -> str:
    sections = []
    names = (("end", "one saved state, error at 3 s"), ("along", "13 saved states, largest error"))
    for ladder, name in names:
        sections += [
            f"### At {TARGET:.0e} rad: {name}",
            f"(a) `index1` against `csm`, same solver:\n\n{same_solver_table(results, ladder)}",
            f"(b) One trajectory, warm. {verdict(results, ladder)}\n\n{best_table(results, ladder)}",
        ]
    sections.append(f"### Reference\n\nLargest difference from jaxroll: {note}.")
    details = f"<details><summary>All points</summary>\n\n{full_table(results)}\n\n</details>"
    return "\n\n".join([*sections, details, "  \n".join(footer())])


# --- figure ------------------------------------------------------------------------------------------

_SHADES = {"jaxroll index1": "Blues", "jaxroll csm": "Oranges", "SciPy": "Greens", "SUNDIALS": "Purples"}
_MARKS = {"jaxroll index1": "os^", "jaxroll csm": "os^", "SciPy": "DvPX*", "SUNDIALS": "DvPX"}


def draw(results: Sequence[Result]) -> None:
    import matplotlib.pyplot as plt

    style = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    with plt.rc_context(style):
        figure, panels = plt.subplots(1, 2, figsize=(11.5, 5.2), sharey=True, sharex=True)
        titles = ("one saved state: error at 3 s", "13 saved states: largest error")
        for axes, ladder, title in zip(panels, ("end", "along"), titles, strict=True):
            _draw_panel(axes, results, ladder)
            axes.set_title(title, fontsize=9.5)
            axes.set_xlabel("error of $q$ [rad]")
        panels[0].set_ylabel("time of one warm run [ms]")
        panels[0].invert_xaxis()
        figure.suptitle("Work and precision on the pivoted scene (Part 2), 3 s", fontsize=11.5, y=0.98)
        figure.subplots_adjust(left=0.065, right=0.79, top=0.88, bottom=0.19, wspace=0.06)
        _draw_legend(figure, panels[0])
        figure.text(0.065, 0.025, "\n".join(footer()), fontsize=7, color="0.35", va="bottom")
        figure.savefig(FIGURE, dpi=160)
        plt.close(figure)


def _draw_panel(axes: Any, results: Sequence[Result], ladder: str) -> None:
    seen: dict[str, int] = {}
    totals = {f: len({(r.contender.formulation, r.contender.solver) for r in results if r.contender.family == f}) for f in _SHADES}
    axes.axvline(TARGET, color="0.6", lw=0.8, zorder=0)
    for (formulation, solver), group in by_contender(results).items():
        family = group[0].contender.family
        i = seen[family] = seen.get(family, -1) + 1
        shade = matplotlib.colormaps[_SHADES[family]](0.45 + 0.5 * i / max(1, totals[family] - 1))
        mark = _MARKS[family][i]
        own = family.startswith("jaxroll")
        label = solver if own or solver != "IDA" else f"IDA, {formulation}"
        _draw_line(axes, group, ladder, False, color=shade, marker=mark, lw=1.7 if own else 1.2, label=label)
        if family == "jaxroll index1" and i == totals[family] - 1:
            _draw_line(
                axes, group, ladder, True, color=shade, marker=mark, mfc="w", ls="--", label=f"{solver}, jitted"
            )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, which="major", color="0.9", lw=0.6)
    axes.set_axisbelow(True)


def _draw_line(axes: Any, group: Sequence[Result], ladder: str, bare: bool, **style: Any) -> None:
    points = [
        (r.errors[ladder], 1e3 * (r.bare_times if bare else r.times)[ladder])
        for r in group
        if ladder in r.times
    ]
    if points:
        axes.plot(*zip(*points, strict=True), ms=4.5, **style)


def _draw_legend(figure: Any, axes: Any) -> None:
    handles, labels = axes.get_legend_handles_labels()
    top = 0.9
    starts = {"jaxroll index1": "jaxroll, index1", "jaxroll csm": "jaxroll, csm"}
    starts |= {"SciPy": "SciPy + Numba", "SUNDIALS": "SUNDIALS + Numba"}
    for family, title in starts.items():
        shades = [matplotlib.colormaps[_SHADES[family]](x) for x in np.linspace(0.45, 0.95, 256)]
        picked = [
            (h, n)
            for h, n in zip(handles, labels, strict=True)
            if any(np.allclose(h.get_color(), s, atol=0.02) for s in shades)
        ]
        legend = figure.legend(
            *zip(*picked, strict=True),
            title=title,
            loc="upper left",
            bbox_to_anchor=(0.795, top),
            frameon=False,
            fontsize=8,
            title_fontproperties={"weight": "bold", "size": 8.5},
            alignment="left",
            labelspacing=0.25,
        )
        figure.add_artist(legend)
        top -= 0.055 + 0.0345 * len(picked)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="under a minute; writes nothing")
    quick = parser.parse_args().quick
    results, note = measure(quick)
    text = report(results, note)
    print(text)
    if not quick:
        write_section("work_precision", text)
        draw(results)


if __name__ == "__main__":
    main()
