"""Run time against error in space: a wobbling disc by jaxroll and four others (about three minutes).

Numba, SciPy, SUNDIALS and Exudyn run beside it. `python -m benchmarks.disc --write` rewrites its section of
README.md and disc.png; `--quick` takes under a minute. Needs the `bench` and `test` extras.
"""

import functools
import importlib.util
from collections.abc import Sequence
from pathlib import Path

import diffrax
import jax
import matplotlib
import matplotlib.pyplot as plt

from benchmarks._common import (
    by_contender,
    command,
    Contender,
    device,
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
from benchmarks._disc_cases import (
    agreement,
    Case,
    CASES,
    centres,
    distance,
    END,
    reference,
    ROUND,
    SLIM,
    STEADY,
    STEADY_THIN,
    THIN,
    TIMES,
    TINY,
)
from benchmarks._plot import footnote, headline, legends, panel
from benchmarks.contenders import disc_exudyn as exudyn
from benchmarks.contenders.solver_libraries import (
    compiled_dop853_contender,
    cvode_contender,
    jaxroll_contender,
    loop_contender,
    odeint_contender,
)

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)

PATH = "path"
FIGURE = Path(__file__).with_name("disc.png")
LADDER = tuple(10.0**-k for k in range(4, 13))
SHORT_LADDER = (1e-6, 1e-8, 1e-10)
# Exudyn's methods have a fixed step [s].
STEPS = tuple(END / n for n in (300, 1200, 3000, 12_000, 30_000, 108_000))
SHORT_STEPS = STEPS[2:6:3]
STYLES = {
    "jaxroll": ("Blues", "os^v"),
    "Numba": ("Oranges", "os"),
    "SciPy": ("Greens", "DX"),
    "SUNDIALS": ("Purples", "DX"),
    "Exudyn": ("Greys", "vPX"),
}


def ours(case: Case, solver: diffrax.AbstractERK) -> Contender:
    names = ("jaxroll", case.name)
    return jaxroll_contender(names, case.scene(), END, centres, solver=solver, max_steps=20_000)


def contenders(quick: bool) -> list[tuple[Case, Contender]]:
    eight, five = diffrax.Dopri8(), diffrax.Tsit5()
    listed = [] if quick else [(TINY, ours(TINY, eight)), (ROUND, ours(ROUND, five))]
    listed += [(case, ours(case, eight)) for case in (SLIM, ROUND, STEADY)]
    problem = ROUND.problem()
    peers = [loop_contender(problem, eight), loop_contender(problem, five)]
    peers += [odeint_contender(problem), compiled_dop853_contender(problem)]
    if importlib.util.find_spec("sksundae"):
        peers += [cvode_contender(problem, method) for method in ("BDF", "Adams")]
    listed += [(ROUND, peer) for peer in peers]
    return listed + exudyns(quick) if exudyn.installed() else listed


def exudyns(quick: bool) -> list[tuple[Case, Contender]]:
    ways = [(THIN, exudyn.BEST), (STEADY_THIN, exudyn.BEST)]
    ways += [] if quick else [(THIN, way) for way in exudyn.OTHERS]
    return [(case, exudyn.exudyn_contender(case.name, case.in_exudyn(), way)) for case, way in ways]


def ladder_of(contender: Contender, quick: bool) -> Sequence[float]:
    if contender.family == "Exudyn":
        return SHORT_STEPS if quick else STEPS
    return SHORT_LADDER if quick else LADDER


def measure(quick: bool) -> tuple[list[Result], str]:
    exact = {case: reference(case) for case in CASES}
    cases = (ROUND, SLIM, THIN) if quick else (ROUND, SLIM, TINY, THIN)
    gaps = {case.name: agreement(case, exact[case]) for case in cases}
    note = "; ".join(f"{name}: {_listed(those)}" for name, those in gaps.items())
    print(f"reference, {note}", flush=True)
    prepared = []
    for case, contender in contenders(quick):
        judge = functools.partial(distance, exact[case])
        for tolerance in ladder_of(contender, quick):
            result = Result(contender, tolerance)
            runs = {PATH: contender.make(tolerance, TIMES)}
            prepared.append((result, warmed(result, runs, judge)))
        print(f"ready: {contender.family}, {contender.formulation}, {contender.solver}", flush=True)
    return timed(prepared, rounds=3 if quick else 41), note


def _listed(gaps: dict[str, float]) -> str:
    return ", ".join(f"{what} {gap:.0e} m" for what, gap in gaps.items())


def _is_steady(result: Result) -> bool:
    return "steady" in result.contender.formulation


def compare(results: Sequence[Result]) -> tuple[str, str]:
    """The fastest point of every contender that meets the target, and what follows."""
    found = ranked([r for r in results if not _is_steady(r)], PATH)
    own = [[f for f in found if _is_ours(f[2]) and f[1] == bare] for bare in (False, True)]
    peers = [f for f in found if f[2].contender.family != "jaxroll"]
    if not (all(own) and peers):
        return ranking(found, PATH, "m"), "The target was not met by jaxroll and a peer."
    call, bare = own[0][0], own[1][0]
    said = [
        f"At {TARGET:.0e} m jaxroll takes {ms(call[0])} ms by a public call ({call[2].contender.solver}) "
        f"and {ms(bare[0])} ms under `jax.jit` ({bare[2].contender.solver})."
    ]
    for family in STYLES:
        best = next((f for f in peers if f[2].contender.family == family), None)
        if best is not None:
            ratios = [f"{float(f'{best[0] / time:.2g}'):g}" for time, *_ in (call, bare)]
            said.append(
                f"{family}'s best, {best[2].contender.solver}, takes {ms(best[0])} ms, "
                f"{ratios[0]} and {ratios[1]} times as long."
            )
    return ranking(found, PATH, "m"), " ".join([*said, limits(results), slender(found)])


def _is_ours(result: Result) -> bool:
    return result.contender.family == "jaxroll" and result.contender.formulation == ROUND.name


def limits(results: Sequence[Result]) -> str:
    """Steps and cost per step of one method, in jaxroll and in a loop written by hand."""
    groups = by_contender(results)
    pair = (groups.get((ROUND.name, name), []) for name in ("Dopri8", "Dopri8 loop"))
    mine, hand = ([r for r in group if meets(r, PATH)] for group in pair)
    if not (mine and hand):
        return ""
    a, b = mine[0], hand[0]
    costs = [1e6 * seconds[PATH] / r.steps[PATH] for r, seconds in ((a, a.bare_times), (b, b.times))]
    python = a.times[PATH] - a.bare_times[PATH]
    return (
        f"With the same method (Dopri8) the loop written by hand takes {b.steps[PATH]} steps of "
        f"{costs[1]:.2g} us on 8 unknowns, jaxroll {a.steps[PATH]} steps of {costs[0]:.2g} us on 19, "
        f"and {ms(python)} ms of Python a call."
    )


def slender(found: Sequence[tuple[float, bool, Result]]) -> str:
    """What thinner rims cost jaxroll."""
    own = [(time, r) for time, bare, r in found if r.contender.family == "jaxroll" and not bare]
    said = [
        f"{ms(time)} ms and {r.steps[PATH]} steps with a {r.contender.formulation}"
        for time, r in own
        if r.contender.formulation != ROUND.name
    ]
    return f"A thinner rim costs it more: {', '.join(said)}." if said else ""


def full_table(results: Sequence[Result]) -> str:
    lines = [
        [r.contender.family, r.contender.formulation, r.contender.solver, f"{r.tolerance:.1e}"]
        + [str(r.steps.get(PATH, "")), str(r.evaluations.get(PATH, ""))]
        + [ms(r.times.get(PATH)), ms(r.bare_times.get(PATH)), size(r.errors.get(PATH)), r.outcome]
        for r in results
    ]
    header = ["family", "rim", "solver", "tolerance or step [s]", "steps", "evaluations"]
    return table([*header, "call [ms]", "jitted [ms]", "error [m]", "result"], lines)


def footer() -> list[str]:
    packages = ["jax", "jaxlib", "diffrax", "scipy", "numba"]
    peers = {"scikit-sundae": "sksundae", "exudyn": "exudyn"}
    there = [name for name, module in peers.items() if importlib.util.find_spec(module)]
    missing = [f"{name}: not installed" for name in peers if name not in there]
    return [device(), versions(*packages, *there), *missing]


def report(quick: bool = False, *, drawn: bool = False) -> str:
    """The section of the README; with `drawn` also its plot."""
    results, note = measure(quick)
    if drawn:
        draw(results)
    fastest, said = compare(results)
    steady = ranking(ranked([r for r in results if _is_steady(r)], PATH), PATH, "m")
    sections = [
        f"![Time of one warm run against its error]({FIGURE.name})",
        f"**Conclusion.** {said}",
        f"At {TARGET:.0e} m, the wobbling disc:",
        fastest,
        "Steady precession, against its closed form:",
        steady,
        f"Reference, largest difference from other formulations: {note}.",
        f"<details><summary>All points</summary>\n\n{full_table(results)}\n\n</details>",
        "  \n".join(footer()),
    ]
    return "\n\n".join(sections)


def draw(results: Sequence[Result]) -> None:
    shown = [r for r in results if not _is_steady(r)]
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, axes = plt.subplots(figsize=(8.6, 5.4))
        handles = panel(axes, shown, PATH, STYLES, jitted=_is_dashed, label=_label)
        axes.set_xlabel("largest error of the centre's path [m]")
        axes.set_ylabel("time of one warm run [ms]")
        axes.invert_xaxis()
        headline(figure, "Work and precision on a rolling disc that wobbles, 3 s")
        figure.subplots_adjust(left=0.085, right=0.665, top=0.9, bottom=0.19)
        legends(figure, handles, 0.675)
        footnote(figure, footer())
        figure.savefig(FIGURE, dpi=160)
        plt.close(figure)


def _is_dashed(family: str, i: int, count: int) -> bool:
    return family == "jaxroll" and i == count - 1


def _label(contender: Contender) -> str:
    plain = contender.family != "jaxroll" or contender.formulation == ROUND.name
    return contender.solver if plain else f"{contender.solver}, {contender.formulation}"


if __name__ == "__main__":
    command("disc", report, drawn="")
