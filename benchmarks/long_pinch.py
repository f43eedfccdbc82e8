"""One run of the pinch over 20 s by jaxroll, SciPy, SUNDIALS and Numba, fastest first (about five minutes).

`python -m benchmarks.long_pinch --write` rewrites its section of README.md; `--quick` takes short ladders and
three rounds. Needs the `bench` extra. The light last links damp at 1000 1/s and the grasp settles at 0.1 1/s,
so explicit methods are bound by stability. Each contender is shown at its fastest tolerance whose error at
20 s stays below 1e-6 rad; times are processor time, medians of interleaved rounds, compilation left out.
"""

import time
from collections.abc import Callable, Sequence

import diffrax
import jax
import numpy as np
from scipy.integrate import solve_ivp

import jaxroll as jxr
from benchmarks._common import (
    command,
    Contender,
    device,
    limit_of_code,
    meets,
    ms,
    ranked,
    ranking,
    Result,
    timed,
    versions,
    warmed,
)
from benchmarks.contenders import pinch_numba as pinch
from benchmarks.contenders.solver_libraries import (
    compiled_dop853_contender,
    cvode_contender,
    formulation_contender,
    ida_contender,
    loop_contender,
    odeint_contender,
    planar,
    Problem,
    solve_ivp_contender,
)

jax.config.update("jax_enable_x64", True)

END, TARGET, AT = 20.0, 1e-6, "end"
LADDER, SHORT_LADDER = tuple(10.0**-k for k in range(3, 12)), (1e-4, 1e-8, 1e-9, 1e-10)
Found = Sequence[tuple[float, bool, Result]]


def contenders(problem: Problem, quick: bool) -> list[Contender]:
    explicit = (diffrax.Tsit5(), diffrax.Dopri8(), diffrax.Dopri5(), diffrax.Bosh3())
    solvers, scene = (jxr.Rosenbrock(), *explicit), jxr.scenes.pinch()
    ours = [
        formulation_contender(scene, END, jxr.Index1(), solver=solver, read=_from_jaxroll)
        for solver in (solvers[:2] if quick else solvers)
    ]
    scipy = [odeint_contender(problem), compiled_dop853_contender(problem)]
    scipy += [solve_ivp_contender(problem, "LSODA", 0.0)]
    sundials = [cvode_contender(problem, method) for method in ("BDF", "Adams")]
    loop = loop_contender(problem, diffrax.Tsit5())
    return [*ours, *scipy, *sundials, ida_contender(problem, pinch, 1), loop]


def _from_jaxroll(run: jxr.Trajectory) -> np.ndarray:
    return np.asarray(run.states.q)


def reference(problem: Problem, span: float = 0.1) -> np.ndarray:
    """Coordinates at the end: DOP853 at 1e-12, put back on the constraints after each `span` [s]."""
    x = problem.x0
    for _ in range(round(problem.end / span)):
        path = solve_ivp(problem.rates, (0.0, span), x, "DOP853", rtol=1e-12, atol=1e-14)
        x = pinch.onto_constraints(path.y[:, -1])
    return x[: pinch.COORDINATES]


def candidates(contender: Contender, ladder: Sequence[float], judge: Callable) -> list:
    """The three loosest tolerances of one contender that meet the target, warmed up."""
    found = []
    for tolerance in ladder:
        result = Result(contender, tolerance)
        runs = warmed(result, {AT: contender.make(tolerance, np.array([END]))}, judge)
        if meets(result, AT, TARGET):
            found.append((result, runs))
        if len(found) == 3:
            break
    return found


def measure(quick: bool) -> Found:
    """Time, whether under `jax.jit`, and result of every contender that meets the target, fastest first."""
    problem = planar(pinch, pinch.start(), END)
    if np.abs(problem.x0[: pinch.COORDINATES] - jxr.scenes.pinch()[1].q).max() > 1e-12:
        raise RuntimeError("benchmarks/contenders/pinch_numba.py is not the scene of jxr.scenes.pinch")
    exact, prepared = reference(problem), []
    judge = lambda _, path: float(np.abs(path[-1, : exact.size] - exact).max())  # noqa: E731
    for contender in contenders(problem, quick):
        prepared += candidates(contender, SHORT_LADDER if quick else LADDER, judge)
        print(f"ready: {contender.formulation}, {contender.solver}", flush=True)
    results = timed(prepared, rounds=3 if quick else 9, clock=time.process_time)
    return ranked(results, AT, TARGET)


def conclusion(found: Found) -> str:
    ours = [item for item in found if item[2].contender.family.startswith("jaxroll")]
    call, bare = (next(item for item in ours if item[1] == jitted) for jitted in (False, True))
    peers = [item for item in found if item[2].contender.family in ("SciPy", "SUNDIALS")]
    peer, explicit = peers[0], next(item for item in peers if "DOP853" in item[2].contender.solver)
    return (
        f"Over 20 s jaxroll's best public call ({call[2].contender.solver}) takes {ms(call[0])} ms "
        f"and {ms(bare[0])} ms under `jax.jit`; the call takes "
        f"{call[0] / peer[0]:.2f} times as long as the best peer ({peer[2].contender.solver}, {ms(peer[0])} "
        f"ms) and {call[0] / explicit[0]:.2f} times as long as the best explicit library "
        f"({explicit[2].contender.solver}, {ms(explicit[0])} ms). {limit_of_code(found, call[0])}"
    )


def report(quick: bool = False) -> str:
    """Markdown: what the table says, and the table."""
    found = measure(quick)
    footer = f"{device()}; {versions('jax', 'diffrax', 'scipy', 'numba', 'scikit-sundae')}."
    return "\n\n".join([f"**Conclusion.** {conclusion(found)}", ranking(found, AT, "rad"), footer])


if __name__ == "__main__":
    command("long_pinch", report)
