"""Contenders that several benchmarks share: jaxroll, SciPy, SUNDIALS and a loop written by hand for Numba."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import ode, odeint, solve_ivp

import jaxroll as jxr
from benchmarks._common import Contender, Run
from benchmarks.contenders.loops_numba import adaptive

MOST_STEPS = 100_000


@dataclasses.dataclass(frozen=True)
class Problem:
    """Equations written by hand, compiled by Numba: x' = rates(t, x) from x0 at t = 0 to `end` [s].

    `scales` multiply the tolerance of each unknown; `controlled` unknowns, the first ones (None: all), have
    their error controlled by the Numba loop; `read` turns states, shape (t, n), into what is compared.
    """

    name: str
    rates: Callable[[float, np.ndarray], np.ndarray]
    fill_rates: Callable[[float, np.ndarray, np.ndarray], None]
    x0: np.ndarray
    end: float
    scales: float | np.ndarray = 1.0
    controlled: int | None = None
    read: Callable[[np.ndarray], np.ndarray] = np.asarray


def planar(scene: Any, x0: np.ndarray, end: float) -> Problem:
    """One of the planar scenes, given by its module."""
    return Problem("index-1", scene.rates, scene.fill_rates, x0, end, scene.SCALES, scene.CONTROLLED)


def evaluations_per_step(solver: diffrax.AbstractSolver, unknowns: int = 0) -> int:
    """Of the equations of motion; `jxr.Rosenbrock` also differentiates in time and in all unknowns."""
    if not isinstance(solver, diffrax.AbstractERK):
        return unknowns + 10
    tableau = solver.tableau
    return tableau.num_stages - int(bool(tableau.fsal and tableau.ssal))


def jaxroll_contender(
    names: tuple[str, str],
    scene: tuple[jxr.Grasp, jxr.State],
    end: float,
    read: Callable[[jxr.Trajectory], np.ndarray],
    **options: Any,
) -> Contender:
    """`jxr.simulate` of a scene with a solver among the options; `names` are family and formulation."""
    grasp, state = scene
    solver, unknowns = options["solver"], state.q.size + state.v.size + state.s.size
    compiled: dict[int, Callable] = {}

    def make(tolerance: float, times: np.ndarray) -> Run:
        ts = 1 if times.size == 1 else jnp.asarray(times)
        # An array, not a Python number: one compiled program serves the whole ladder.
        rtol = jnp.asarray(tolerance)
        bare = compiled.setdefault(
            times.size,
            jax.jit(lambda g, x, r: jxr.simulate(g, x, end, ts=ts, rtol=r, **options).states),
        )

        def call() -> jxr.Trajectory:
            return jax.block_until_ready(jxr.simulate(grasp, state, end, ts=ts, rtol=rtol, **options))

        def count() -> tuple[int, int]:
            steps = int(call().stats.steps)
            return steps, 1 + evaluations_per_step(solver, unknowns) * steps

        jitted = lambda: jax.block_until_ready(bare(grasp, state, rtol))  # noqa: E731
        return Run(call, read, count, jitted)

    return Contender(*names, type(solver).__name__, make)


def formulation_contender(
    scene: tuple[jxr.Grasp, jxr.State], end: float, formulation: Any, **options: Any
) -> Contender:
    """The same, named after its formulation."""
    name = type(formulation).__name__.lower()
    read = options.pop("read")
    settings = {"formulation": formulation, "max_steps": 20_000, **options}
    return jaxroll_contender((f"jaxroll {name}", name), scene, end, read, **settings)


def loop_contender(problem: Problem, solver: diffrax.AbstractERK) -> Contender:
    """A method of jaxroll's; loop and equations are one program, which knows this scene only."""
    loop = adaptive(problem.fill_rates, problem.x0.size, solver, problem.controlled)

    def make(tolerance: float, times: np.ndarray) -> Run:
        def count() -> tuple[int, int]:
            steps = loop(problem.x0, times, tolerance)[1]
            return steps, 1 + evaluations_per_step(solver) * steps

        call = functools.partial(loop, problem.x0, times, tolerance)
        return Run(call, lambda found: problem.read(found[0]), count)

    return Contender("Numba", problem.name, f"{type(solver).__name__} loop", make)


def solve_ivp_contender(problem: Problem, method: str, tightest: float) -> Contender:
    def make(tolerance: float, times: np.ndarray) -> Run:
        def run(**more: Any) -> Any:
            solved = solve_ivp(
                problem.rates,
                (0.0, problem.end),
                problem.x0,
                method,
                rtol=tolerance,
                atol=tolerance * problem.scales,
                **more,
            )
            if not solved.success:
                raise RuntimeError(solved.message)
            return solved

        def count() -> tuple[int, int]:
            solved = run()
            return solved.t.size - 1, solved.nfev

        return Run(lambda: run(t_eval=times), lambda solved: problem.read(solved.y.T), count)

    return Contender("SciPy", problem.name, f"{method} (solve_ivp)", make, tightest)


def odeint_contender(problem: Problem) -> Contender:
    def make(tolerance: float, times: np.ndarray) -> Run:
        ts = np.concatenate([[0.0], times])

        def run(full: bool = False) -> Any:
            return odeint(
                problem.rates,
                problem.x0,
                ts,
                rtol=tolerance,
                atol=tolerance * problem.scales,
                tfirst=True,
                mxstep=MOST_STEPS,
                full_output=full,
            )

        def count() -> tuple[int, int]:
            info = run(full=True)[1]
            if info["message"] != "Integration successful.":
                raise RuntimeError(info["message"])
            return int(info["nst"][-1]), int(info["nfe"][-1])

        return Run(run, lambda path: problem.read(path[1:]), count)

    return Contender("SciPy", problem.name, "LSODA (odeint)", make)


def compiled_dop853_contender(problem: Problem) -> Contender:
    """DOP853 by `scipy.integrate.ode`: its loop is compiled, unlike that of `solve_ivp`."""

    def make(tolerance: float, times: np.ndarray) -> Run:
        def run(function: Callable = problem.rates, watch: Callable | None = None) -> np.ndarray:
            solver = ode(function).set_integrator("dop853", rtol=tolerance, atol=tolerance, nsteps=MOST_STEPS)
            if watch is not None:
                solver.set_solout(watch)
            solver.set_initial_value(problem.x0, 0.0)
            path = [solver.integrate(t) for t in times]
            if not solver.successful():
                raise RuntimeError(f"dop853 returned {solver.get_return_code()}")
            return np.array(path)

        def count() -> tuple[int, int]:
            evaluations, steps = [], []

            def function(t: float, x: np.ndarray) -> np.ndarray:
                evaluations.append(t)
                return problem.rates(t, x)

            run(function, lambda t, x: steps.append(t))
            return len(steps) - times.size, len(evaluations)

        return Run(run, problem.read, count)

    return Contender("SciPy", problem.name, "DOP853 (ode)", make)


def _sundials_run(problem: Problem, solver: Any, start: tuple[np.ndarray, ...], times: np.ndarray) -> Run:
    """A run of CVODE or IDA from `start`, a state and for IDA its rates."""
    ts = np.concatenate([[0.0], times])

    def checked(solved: Any) -> Any:
        if not solved.success:
            raise RuntimeError(solved.message)
        return solved

    def run() -> Any:
        if times.size == 1:
            solver.init_step(0.0, *start)
            return checked(solver.step(times[-1]))
        return checked(solver.solve(ts, *start))

    def read(solved: Any) -> np.ndarray:
        return problem.read(np.atleast_2d(solved.y)[-times.size :, : problem.x0.size])

    def count() -> tuple[int, int]:
        solved = checked(solver.solve([0.0, times[-1]], *start))
        return solved.t.size - 1, int(solved.nfev)

    return Run(run, read, count)


def cvode_contender(problem: Problem, method: str) -> Contender:
    from sksundae.cvode import CVODE

    def make(tolerance: float, times: np.ndarray) -> Run:
        solver = CVODE(
            problem.fill_rates,
            method=method,
            rtol=tolerance,
            atol=tolerance * problem.scales,
            max_num_steps=MOST_STEPS,
        )
        return _sundials_run(problem, solver, (problem.x0,), times)

    return Contender("SUNDIALS", problem.name, f"CVODE {method}", make)


def ida_contender(problem: Problem, scene: Any, index: int) -> Contender:
    """The equations of a planar scene left implicit, with their multipliers."""
    from sksundae.ida import IDA

    residual, size = getattr(scene, f"fill_residual_index{index}"), problem.x0.size
    y0, rates0 = scene.with_multipliers(problem.x0)
    extra = np.zeros((y0.size - size) * (index - 1))
    y0, rates0 = (np.concatenate([a, extra]) for a in (y0, rates0))

    def make(tolerance: float, times: np.ndarray) -> Run:
        # Multipliers are left out of error control, as is usual above index 1.
        scales = np.full(y0.size, 1e12)
        scales[:size] = problem.scales
        solver = IDA(
            residual,
            algebraic_idx=list(range(size, y0.size)),
            rtol=tolerance,
            atol=tolerance * scales,
            max_num_steps=MOST_STEPS,
        )
        return _sundials_run(problem, solver, (y0, rates0), times)

    formulation = {1: "index-1, implicit", 2: "stabilised index-2"}[index]
    return Contender("SUNDIALS", formulation, "IDA", make)
