"""Run time against error on the chapter's Part 2: jaxroll, SciPy, SUNDIALS and Numba (about four minutes).

`python -m benchmarks.work_precision --write` rewrites its section of README.md and work_precision.png;
with `--quick` it takes under a minute. Needs the `bench` extra.
"""

import functools
from collections.abc import Sequence
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import jaxroll as jxr
from benchmarks._common import (
    by_contender,
    command,
    Contender,
    device,
    fastest,
    limit_of_code,
    meets,
    ms,
    ranked,
    ranking,
    Result,
    size,
    table,
    TARGET,
    timed,
    versions,
    warmed,
)
from benchmarks._plot import footnote, headline, legends, panel
from benchmarks.contenders import pivoted_numba as pivoted
from benchmarks.contenders.solver_libraries import (
    compiled_dop853_contender,
    cvode_contender,
    formulation_contender,
    ida_contender,
    loop_contender,
    odeint_contender,
    planar,
    solve_ivp_contender,
)

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)

END = 3.0
TIMES = np.array([0.01, 0.03, 0.06, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, END])
LADDERS = {"end": "one saved state, error at 3 s", "along": "13 saved states, largest error"}
FIGURE = Path(__file__).with_name("work_precision.png")
LADDER = tuple(10.0**-k for k in range(4, 13))
SHORT_LADDER = (1e-6, 1e-8, 1e-10)
OURS = "jaxroll index1"
# Colour map and markers of each family.
STYLES = {
    OURS: ("Blues", "os^"),
    "jaxroll csm": ("Oranges", "os^"),
    "SciPy": ("Greens", "DvPX*"),
    "SUNDIALS": ("Purples", "DvPX"),
    "Numba": ("Reds", "o"),
}


def _from_jaxroll(run: jxr.Trajectory) -> np.ndarray:
    states = run.states
    return np.concatenate([states.q, states.v, pivoted.S_START - np.asarray(states.s)], axis=1)


def contenders(x0: np.ndarray, quick: bool) -> list[Contender]:
    solvers, scene = (diffrax.Tsit5(), diffrax.Dopri5(), diffrax.Dopri8()), jxr.scenes.pivoted()
    listed = [
        formulation_contender(scene, END, formulation, solver=solver, read=_from_jaxroll)
        for formulation in (jxr.Index1(), jxr.CSM())
        for solver in (solvers[2:] if quick else solvers)
    ]
    problem = planar(pivoted, x0, END)
    listed += [solve_ivp_contender(problem, method, 1e-12) for method in ("LSODA", "DOP853")]
    listed += [solve_ivp_contender(problem, "Radau", 1e-8 if quick else 1e-10)]
    listed += [odeint_contender(problem), compiled_dop853_contender(problem)]
    listed += [cvode_contender(problem, method) for method in ("BDF", "Adams")]
    listed += [ida_contender(problem, pivoted, index) for index in (1, 2)]
    return [*listed, loop_contender(problem, diffrax.Tsit5())]


def reference(x0: np.ndarray, span: float = 0.01) -> np.ndarray:
    """States at TIMES: DOP853 at 1e-13, put back on the constraints after each `span` [s]."""
    marks = np.union1d(np.arange(1, round(END / span) + 1) * span, TIMES)
    marks = marks[np.concatenate([[True], np.diff(marks) > 1e-9])]
    path, x, t = [], x0, 0.0
    for mark in marks:
        solved = solve_ivp(pivoted.rates, (t, mark), x, "DOP853", rtol=1e-13, atol=1e-15 * pivoted.SCALES)
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


def judged(result: Result, exact: np.ndarray, ladder: str, path: np.ndarray) -> float:
    """Largest error of the angles [rad]; notes the gap at the end."""
    if ladder == "end":
        gap_q, gap_r, _ = pivoted.closure(*path[-1, [0, 1, 2, 6]])
        result.gap = max(abs(gap_q), abs(gap_r))
    return float(np.max(np.abs(path[:, :3] - exact[-path.shape[0] :, :3])))


def measure(quick: bool) -> tuple[list[Result], str]:
    grasp, state = jxr.scenes.pivoted()
    x0 = np.concatenate([state.q, state.v, [pivoted.S_START]])
    start_error = np.max(np.abs(pivoted.start() - x0))
    if start_error > 1e-12:
        raise RuntimeError("benchmarks/contenders/pivoted_numba.py is not the scene of jxr.scenes.pivoted")
    exact = reference(x0)
    note = f"starting pose: {start_error:.0e} rad; {agreement(exact)}"
    print(f"reference against jaxroll: {note}", flush=True)
    prepared = []
    for contender in contenders(x0, quick):
        for tolerance in SHORT_LADDER if quick else LADDER:
            if tolerance < 0.99 * contender.tightest:
                continue
            result = Result(contender, tolerance)
            saved = {"end": TIMES[-1:], "along": TIMES}
            runs = {name: contender.make(tolerance, times) for name, times in saved.items()}
            prepared.append((result, warmed(result, runs, functools.partial(judged, result, exact))))
        print(f"ready: {contender.formulation}, {contender.solver}", flush=True)
    return timed(prepared, rounds=3 if quick else 9), note


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
    found = ranked(results, ladder)
    ours = [[f for f in found if f[2].contender.family == OURS and f[1] == bare] for bare in (0, 1)]
    peers = [f for f in found if f[2].contender.family in ("SciPy", "SUNDIALS")]
    if not (all(ours) and peers):
        return ranking(found, ladder, "rad"), "The target was not met by all families."
    (call, _, one), (bare, _, two), (peer, _, other) = ours[0][0], ours[1][0], peers[0]
    return ranking(found, ladder, "rad"), (
        f"jaxroll's best takes {ms(call)} ms by a public call ({one.contender.solver}) and "
        f"{ms(bare)} ms under `jax.jit` ({two.contender.solver}); the best library takes {ms(peer)} "
        f"ms ({other.contender.solver}): {call / peer:.2f} and {bare / peer:.2f} times as long. "
        f"{limit_of_code(found, bare)}"
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


def report(quick: bool = False, *, drawn: bool = False) -> str:
    results, note = measure(quick)
    if drawn:
        draw(results)
    sections = [f"![Time of one warm run against its error]({FIGURE.name})"]
    for i, (ladder, name) in enumerate(LADDERS.items()):
        one, said = compare_formulations(results, ladder)
        two, verdict = compare_contenders(results, ladder)
        if i == 0:
            sections.insert(0, f"**Conclusion.** At {TARGET:.0e} rad, {name}: {verdict}")
        sections += [f"### At {TARGET:.0e} rad: {name}", f"(a) {said}", one, f"(b) {verdict}", two]
    sections.append(f"Reference, largest difference from jaxroll: {note}.")
    details = f"<details><summary>All points</summary>\n\n{full_table(results)}\n\n</details>"
    return "\n\n".join([*sections, details, "  \n".join(footer())])


def draw(results: Sequence[Result]) -> None:
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, panels = plt.subplots(1, 2, figsize=(11.5, 5.9), sharey=True, sharex=True)
        for axes, (ladder, name) in zip(panels, LADDERS.items(), strict=True):
            handles = panel(axes, results, ladder, STYLES, jitted=_is_dashed, label=_label)
            axes.set_title(name, fontsize=9.5)
            axes.set_xlabel("error of $q$ [rad]")
        panels[0].set_ylabel("time of one warm run [ms]")
        panels[0].invert_xaxis()
        headline(figure, "Work and precision on the pivoted scene (Part 2), 3 s")
        figure.subplots_adjust(left=0.065, right=0.785, top=0.87, bottom=0.185, wspace=0.06)
        legends(figure, handles, 0.79)
        footnote(figure, footer())
        figure.savefig(FIGURE, dpi=160)
        plt.close(figure)


def _is_dashed(family: str, i: int, count: int) -> bool:
    return family == OURS and i == count - 1


def _label(contender: Contender) -> str:
    both = f"{contender.solver}, {contender.formulation}"
    return both if contender.solver == "IDA" else contender.solver


if __name__ == "__main__":
    command("work_precision", report, drawn="")
