"""Cases of the `disc` benchmark: a wheel with rims of several radii, its reference, a start for each peer."""

import dataclasses
import functools

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import jaxroll as jxr
from benchmarks.contenders import disc_exudyn as exudyn, disc_numba as by_hand
from benchmarks.contenders.solver_libraries import Problem
from tests.oracles import closed_forms_space as closed

END, SAVES = 3.0, 12
TIMES = np.arange(1, SAVES + 1) * (END / SAVES)
INCLINATION, PRECESSION = 1.2, 3.0
AGREED = 1e-9  # [m], of independent formulations


@dataclasses.dataclass(frozen=True)
class Case:
    """A wheel with a rim of radius `rho` [m], started at its steady precession plus a tilt rate [rad/s]."""

    name: str
    rho: float
    tilt_rate: float = 3.0

    @functools.cached_property
    def wheel(self) -> closed.Wheel:
        return closed.Wheel(
            mass=by_hand.MASS,
            A=by_hand.ACROSS,
            C=by_hand.ABOUT,
            a=by_hand.RADIUS,
            rho=self.rho,
            gravity=by_hand.GRAVITY,
        )

    def start(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Quaternion, angular velocity in h, u, e, and the centre's place (2,)."""
        turned, spin, place = self.wheel.start(INCLINATION, PRECESSION)
        return turned, spin + np.array([self.tilt_rate, 0.0, 0.0]), place

    def problem(self) -> Problem:
        fill_rates = by_hand.fill_rates_of(self.rho)
        _, spin, place = self.start()
        x0 = np.array([INCLINATION, 0.0, 0.0, *spin, *place])
        read = functools.partial(by_hand.centre, rho=self.rho)
        return Problem(self.name, by_hand.rates_of(fill_rates), fill_rates, x0, END, read=read)

    def scene(self) -> tuple[jxr.Grasp, jxr.State]:
        grasp, state = jxr.scenes.wheel(
            inclination=INCLINATION,
            precession=PRECESSION,
            radius=by_hand.RADIUS,
            tube=self.rho,
            mass=by_hand.MASS,
            gravity=by_hand.GRAVITY,
        )
        # h is the world's x at the start.
        kick = jnp.array([self.tilt_rate, 0.0, 0.0])
        shove = jnp.cross(kick, state.q[:3] - state.s[:3])
        return grasp, jxr.State(state.q, state.v + jnp.concatenate([shove, kick]), state.s)

    def in_exudyn(self) -> exudyn.Start:
        """Exudyn's disc has no rim radius."""
        turned, spin, place = self.start()
        axes = closed.quaternion_matrix(turned)
        arm = by_hand.RADIUS * axes[:, 1]
        there = np.array([*place, arm[2]])
        return exudyn.Start(axes, there, np.cross(axes @ spin, arm), axes @ spin)


ROUND = Case("10 mm rim", 0.01)
SLIM = Case("1 mm rim", 0.001)
TINY = Case("1 um rim", 1e-6)
THIN = Case("thin rim", 0.0)
STEADY = Case("10 mm rim, steady", 0.01, 0.0)
STEADY_THIN = Case("thin rim, steady", 0.0, 0.0)
CASES = (ROUND, SLIM, TINY, THIN, STEADY, STEADY_THIN)


def reference(case: Case) -> np.ndarray:
    """Centres at TIMES: the closed form, or DOP853 at 1e-13 on the equations written by hand."""
    if case.tilt_rate == 0.0:
        radius = case.wheel.steady(INCLINATION, PRECESSION)[1]
        angle, height = PRECESSION * TIMES, by_hand.RADIUS * np.sin(INCLINATION) + case.rho
        return np.stack([-radius * np.sin(angle), radius * np.cos(angle), height + 0 * TIMES], axis=1)
    problem = case.problem()
    solved = solve_ivp(problem.rates, (0.0, END), problem.x0, "DOP853", t_eval=TIMES, rtol=1e-13, atol=1e-14)
    return problem.read(solved.y.T)


def distance(exact: np.ndarray, _: str, path: np.ndarray) -> float:
    """Largest distance of the centre from where it should be [m]."""
    return float(np.linalg.norm(path - exact, axis=1).max())


def agreement(case: Case, exact: np.ndarray) -> dict[str, float]:
    """How far the reference is from other formulations [m]."""
    turned, spin, place = case.start()
    second = case.wheel.roller().simulate(turned, spin, np.concatenate([[0.0], TIMES]), place)[1][1:]
    gaps = {"Newton-Euler equations in body axes": distance(exact, "", second)}
    if case.rho > 0.0:
        run = jxr.simulate(*case.scene(), END, ts=TIMES, rtol=jnp.asarray(1e-13), max_steps=20_000)
        gaps["jaxroll at 1e-13"] = distance(exact, "", centres(run))
    if max(gaps.values()) > AGREED:
        raise RuntimeError(f"the formulations of the disc with a {case.name} disagree: {gaps}")
    return gaps


def centres(run: jxr.Trajectory) -> np.ndarray:
    return np.asarray(run.states.q[:, :3])
