"""Run time against error on the chapter's Part 2 testbed: jaxroll, SciPy and SUNDIALS.

`python -m benchmarks.work_precision` rewrites its section of README.md and work_precision.png;
with `--quick` it takes under a minute and only prints.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import ode, odeint, solve_ivp
from sksundae.cvode import CVODE
from sksundae.ida import IDA

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import jaxroll as jxr
from benchmarks import _pivoted_numba as pivoted
from benchmarks._common import (
    by_contender,
    Contender,
    device,
    fastest,
    interleaved,
    meets,
    ms,
    Result,
    Run,
    size,
    table,
    TARGET,
    versions,
    write_section,
)

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)

END = 3.0
TIMES = np.array([0.01, 0.03, 0.06, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, END])
LADDERS = {"end": "one saved state, error at 3 s", "along": "13 saved states, largest error"}
FIGURE = Path(__file__).with_name("work_precision.png")
LADDER = tuple(10.0**-k for k in range(4, 13))
SHORT_LADDER = (1e-6, 1e-8, 1e-10)
# Peers control s [m] a hundred times tighter than angles [rad]: the curvatures add to 140 1/m.
SCALES = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.01])
MOST_STEPS = 100_000
OURS = "jaxroll index1"
# Colour map and markers of each family.
STYLES = {
    OURS: ("Blues", "os^"),
    "jaxroll csm": ("Oranges", "os^"),
    "SciPy": ("Greens", "DvPX*"),
    "SUNDIALS": ("Purples", "DvPX"),
}


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
            return jax.block_until_ready(jxr.simulate(grasp, state, END, ts=ts, rtol=rtol, **options))

        def count() -> tuple[int, int]:
            steps = int(call().stats.steps)
            return steps, 1 + stages * steps

        jitted = lambda: jax.block_until_ready(bare(grasp, state, rtol))  # noqa: E731
        return Run(call, _from_jaxroll, count, jitted)

    name = type(formulation).__name__.lower()
    return Contender(f"jaxroll {name}", name, type(solver).__name__, make)


def _from_jaxroll(run: jxr.Trajectory) -> np.ndarray:
    states = run.states
    return np.concatenate([states.q, states.v, pivoted.S_START - np.asarray(states.s)], axis=1)


def solve_ivp_contender(x0: np.ndarray, method: str, tightest: float) -> Contender:
    def make(tolerance: float, times: np.ndarray) -> Run:
        def run(**more: Any) -> Any:
            solved = solve_ivp(
                pivoted.rates,
                (0.0, END),
                x0,
                method,
                rtol=tolerance,
                atol=tolerance * SCALES,
                **more,
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
    """DOP853 by `scipy.integrate.ode`: its loop is compiled, unlike that of `solve_ivp`."""

    def make(tolerance: float, times: np.ndarray) -> Run:
        def run(function: Callable = pivoted.rates, watch: Callable | None = None) -> np.ndarray:
            solver = ode(function).set_integrator("dop853", rtol=tolerance, atol=tolerance, nsteps=MOST_STEPS)
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
    """States at TIMES: DOP853 at 1e-13, put back on the constraints after each `span` [s]."""
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
            result.steps[ladder], result.evaluations[ladder] = run.count()
    except Exception as error:
        result.outcome = str(error).splitlines()[0][:60] or type(error).__name__
        result.errors.clear()
        return {}
    return runs


def measure(quick: bool) -> tuple[list[Result], str]:
    grasp, state = jxr.scenes.pivoted()
    x0 = np.concatenate([state.q, state.v, [pivoted.S_START]])
    start_error = np.max(np.abs(pivoted.start() - x0))
    if start_error > 1e-12:
        raise RuntimeError("benchmarks/_pivoted_numba.py is not the scene of jxr.scenes.pivoted")
    exact = reference(x0)
    note = f"starting pose: {start_error:.0e} rad; {agreement(exact)}"
    print(f"reference against jaxroll: {note}", flush=True)
    results, calls, slots = [], [], []
    for contender in contenders(x0, quick):
        for tolerance in SHORT_LADDER if quick else LADDER:
            if tolerance < 0.99 * contender.tightest:
                continue
            result = Result(contender, tolerance)
            saved = {"end": TIMES[-1:], "along": TIMES}
            runs = {name: contender.make(tolerance, times) for name, times in saved.items()}
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


def compare_formulations(results: Sequence[Result], ladder: str) -> tuple[str, str]:
    """(a): `index1` against `csm` with each solver, at the fastest points that meet the target."""
    groups, lines, ratios = by_contender(results), [], []
    for name in [solver for way, solver in groups if way == "csm"]:
        pair = [groups["index1", name], groups["csm", name]]
        if not all(fastest(group, ladder) for group in pair):
            lines.append([name, "target not met", *[""] * 8])
            continue
        costs = [[min(r.steps[ladder] for r in group if meets(r, ladder)) for group in pair]]
        for bare in (False, True):
            costs.append([fastest(group, ladder, bare).seconds(bare)[ladder] for group in pair])
        ratios.append([slow / fast for fast, slow in costs])
        cells = [f(x) for f, cost in zip((str, ms, ms), costs, strict=True) for x in cost]
        for at, ratio in zip((2, 5, 8), ratios[-1], strict=True):
            cells.insert(at, f"**{ratio:.1f}**")
        lines.append([name, *cells])
    header = ["solver", "steps, index1", "steps, csm", "ratio", "call, index1 [ms]"]
    header += ["call, csm [ms]", "ratio", "jitted, index1 [ms]", "jitted, csm [ms]", "ratio"]
    spans = [f"{min(r):.1f} to {max(r):.1f}" for r in zip(*ratios, strict=True)]
    if not spans:
        return table(header, lines), "No solver met the target in both formulations."
    return table(header, lines), (
        f"With the same solver `csm` takes {spans[0]} times the steps of `index1`, {spans[1]} "
        f"times the time by public calls and {spans[2]} times under `jax.jit`."
    )


def compare_contenders(results: Sequence[Result], ladder: str) -> tuple[str, str]:
    """(b): the fastest point of every contender that meets the target, fastest first."""
    found = []
    for group in by_contender(results).values():
        for bare in (False, True):
            best = fastest(group, ladder, bare)
            if best is not None:
                found.append((best.seconds(bare)[ladder], bare, best))
    found.sort(key=lambda item: item[0])
    lines = [
        [r.contender.family, r.contender.formulation, r.contender.solver + ", jitted" * bare]
        + [f"{r.tolerance:.0e}", ms(time), f"{r.errors[ladder]:.1e}", str(r.evaluations[ladder])]
        for time, bare, r in found
    ]
    header = ["family", "formulation", "solver", "tolerance", "time [ms]", "error [rad]"]
    ours = [[f for f in found if f[2].contender.family == OURS and f[1] == bare] for bare in (0, 1)]
    peers = [f for f in found if not f[2].contender.family.startswith("jaxroll")]
    if not (all(ours) and peers):
        return table([*header, "evaluations"], lines), "The target was not met by all families."
    (call, _, one), (bare, _, two), (peer, _, other) = ours[0][0], ours[1][0], peers[0]
    return table([*header, "evaluations"], lines), (
        f"jaxroll's best takes {ms(call)} ms by a public call ({one.contender.solver}) and "
        f"{ms(bare)} ms under `jax.jit` ({two.contender.solver}); the best peer takes {ms(peer)} "
        f"ms ({other.contender.solver}): {call / peer:.2f} and {bare / peer:.2f} times as long."
    )


def full_table(results: Sequence[Result]) -> str:
    lines = []
    for r in results:
        line = [r.contender.formulation, r.contender.solver, f"{r.tolerance:.0e}"]
        line += [str(count.get("end", "")) for count in (r.steps, r.evaluations)]
        for ladder in LADDERS:
            line += [ms(r.times.get(ladder)), ms(r.bare_times.get(ladder))]
            line.append(size(r.errors.get(ladder)))
        lines.append([*line, size(r.gap), r.outcome])
    header = ["formulation", "solver", "tolerance", "steps", "evaluations"]
    header += ["call [ms]", "jitted [ms]", "error at 3 s [rad]"]
    header += ["13 saved: call [ms]", "jitted [ms]", "largest error [rad]"]
    return table([*header, "gap at 3 s [m]", "result"], lines)


def footer() -> list[str]:
    return [device(), versions("jax", "jaxlib", "diffrax", "scipy", "numba", "scikit-sundae")]


def report(results: Sequence[Result], note: str) -> str:
    sections = [f"![Time of one warm run against its error]({FIGURE.name})"]
    for ladder, name in LADDERS.items():
        one, said = compare_formulations(results, ladder)
        two, verdict = compare_contenders(results, ladder)
        sections += [f"### At {TARGET:.0e} rad: {name}", f"(a) {said}", one, f"(b) {verdict}", two]
    sections.append(f"Reference, largest difference from jaxroll: {note}.")
    details = f"<details><summary>All points</summary>\n\n{full_table(results)}\n\n</details>"
    return "\n\n".join([*sections, details, "  \n".join(footer())])


def draw(results: Sequence[Result]) -> None:
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, panels = plt.subplots(1, 2, figsize=(11.5, 5.2), sharey=True, sharex=True)
        for axes, (ladder, name) in zip(panels, LADDERS.items(), strict=True):
            handles = _draw_panel(axes, results, ladder)
            axes.set_title(name, fontsize=9.5)
            axes.set_xlabel("error of $q$ [rad]")
        panels[0].set_ylabel("time of one warm run [ms]")
        panels[0].invert_xaxis()
        title = "Work and precision on the pivoted scene (Part 2), 3 s"
        figure.suptitle(title, fontsize=11.5, x=0.065, ha="left", y=0.975)
        figure.subplots_adjust(left=0.065, right=0.785, top=0.87, bottom=0.185, wspace=0.06)
        _draw_legends(figure, handles)
        figure.text(0.065, 0.02, "\n".join(footer()), fontsize=7, color="0.35", va="bottom")
        figure.savefig(FIGURE, dpi=160)
        plt.close(figure)


def _draw_panel(axes: Any, results: Sequence[Result], ladder: str) -> dict[str, list[Any]]:
    axes.axvline(TARGET, color="0.4", lw=0.9, ls=":", zorder=0)
    note = {"xycoords": ("data", "axes fraction"), "xytext": (4, -9), "textcoords": "offset points"}
    axes.annotate("target", (TARGET, 1.0), color="0.4", fontsize=7.5, **note)
    handles: dict[str, list[Any]] = {family: [] for family in STYLES}
    for family, (colours, marks) in STYLES.items():
        own = [r for r in results if r.contender.family == family]
        groups = by_contender(own)
        for i, ((formulation, solver), group) in enumerate(groups.items()):
            shade = matplotlib.colormaps[colours](0.4 + 0.55 * i / max(1, len(groups) - 1))
            label = f"{solver}, {formulation}" if solver == "IDA" else solver
            style = {"color": shade, "marker": marks[i], "lw": 1.1 + 0.5 * (family == OURS)}
            handles[family] += _draw_line(axes, group, ladder, False, label=label, **style)
            if family == OURS and i == len(groups) - 1:
                style |= {"mfc": "w", "ls": "--", "label": f"{solver}, jitted"}
                handles[family] += _draw_line(axes, group, ladder, True, **style)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, color="0.9", lw=0.6)
    axes.set_axisbelow(True)
    return handles


def _draw_line(axes: Any, group: Sequence[Result], ladder: str, bare: bool, **style: Any) -> list[Any]:
    timed = [r for r in group if ladder in r.seconds(bare)]
    errors = [r.errors[ladder] for r in timed]
    times = [1e3 * r.seconds(bare)[ladder] for r in timed]
    return axes.plot(errors, times, ms=4.5, **style) if timed else []


def _draw_legends(figure: Any, handles: dict[str, list[Any]]) -> None:
    top = 0.885
    for family, lines in handles.items():
        legend = figure.legend(
            handles=lines,
            title=family if family.startswith("jaxroll") else f"{family} with Numba",
            loc="upper left",
            bbox_to_anchor=(0.79, top),
            frameon=False,
            fontsize=8,
            title_fontproperties={"weight": "bold", "size": 8.5},
            alignment="left",
            labelspacing=0.25,
        )
        figure.add_artist(legend)
        top -= 0.06 + 0.0335 * len(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="under a minute; writes nothing")
    options = parser.parse_args()
    results, note = measure(options.quick)
    text = report(results, note)
    print(text)
    if not options.quick:
        write_section("work_precision", text)
        draw(results)


if __name__ == "__main__":
    main()
