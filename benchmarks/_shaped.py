"""Scenes whose fingertips, masses and gains are functions of a vector: what gradients are taken of."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr
from jaxroll.geometry import AbstractContour
from jaxroll.geometry.contours._support import fit_series

SECONDS = {"pivoted": 3.0, "pinch": 2.0, "pinch3d": 0.5}
_WEIGHTS = {
    3: (1.0, -0.7, 0.4),
    8: (20.0, -10.0, 1.0, 1.0, -0.7, 0.4, 0.8, -0.5),
    13: (20.0, -10.0, 15.0, 1.0, -0.7, 0.4, 0.9, 0.8, -0.5, 0.6, 0.3, -0.2, 0.7),
}
# Numbers of each grasp that a gradient is taken of, the first alone or all seven.
_SEVEN = {
    "pivoted": lambda g: [
        g.controller.damping,
        g.controller.force,
        g.controller.radius,
        g.object.inertia,
        g.fingers[0].masses,
        g.fingers[0].inertias,
        g.fingers[0].tip.contour.contour.a,
    ],
    "pinch": lambda g: [
        g.controller.damping,
        g.controller.beta,
        g.controller.alpha,
        g.object.mass,
        g.object.inertia,
        g.fingers[0].masses,
        g.fingers[1].masses,
    ],
}


def with_tip(scene: str, tip: AbstractContour) -> tuple[jxr.Grasp, jxr.State]:
    """The scene with another fingertip (on both fingers of the pinch), closed again."""
    if scene == "pinch":
        return jxr.scenes.pinch(tips=tip)
    grasp, state = jxr.scenes.pivoted()
    return jxr.close(grasp.with_tip(0, tip.moved(angle=-0.5 * np.pi)), state)


def with_factors(scene: str, factors: jax.Array) -> tuple[jxr.Grasp, jxr.State]:
    """The scene with as many of its numbers multiplied, closed again."""
    grasp, state = getattr(jxr.scenes, scene)()
    where = lambda g: _SEVEN[scene](g)[: factors.shape[0]]  # noqa: E731
    values = [x * factors[i] for i, x in enumerate(where(grasp))]
    return jxr.close(eqx.tree_at(where, grasp, values), state)


def catenary(factors: jax.Array) -> AbstractContour:
    """The chapter's fingertip, its one number multiplied."""
    return jxr.Catenary(factors[0] / 40.0, (-0.03, 0.03)).moved((0.01, 0.0))


def ellipse(factors: jax.Array) -> AbstractContour:
    """An ellipse, both half axes multiplied."""
    return jxr.Ellipse(0.012 * factors[0], 0.02 * factors[1])


def ellipsoids(factors: jax.Array) -> tuple[jxr.Ellipsoid, jxr.Ellipsoid]:
    """An ellipsoid for each finger in space, all six half axes multiplied."""
    a = jnp.array([0.012, 0.010, 0.011, 0.012, 0.010, 0.011]) * factors
    return jxr.Ellipsoid(*a[:3]), jxr.Ellipsoid(*a[3:])


def support(shifts: jax.Array) -> jxr.SupportFunction:
    """A rounded fingertip by its support function: 15 harmonics, changed by as many mm over their squares."""
    series, _ = fit_series(_outline(96), 15)
    a, b = 1e-3 * shifts.reshape(2, 15) / jnp.arange(1.0, 16.0) ** 2
    return jxr.SupportFunction(series[0], series[1:16] + a, series[16:] + b)


def spline(shifts: jax.Array) -> jxr.Spline:
    """The same fingertip as a spline through 15 points, changed by so many mm."""
    return jxr.Spline(_outline(15) + 1e-3 * shifts.reshape(15, 2))


def _outline(count: int) -> np.ndarray:
    """Points of an ellipse, from the one that faces +x."""
    u = 2.0 * np.pi * np.arange(count) / count
    return np.stack([0.012 * np.cos(u), 0.02 * np.sin(u)], axis=-1)


def end(scene: str, grasp: jxr.Grasp, state: jxr.State, rtol: Any = 1e-8) -> tuple[jax.Array, Any]:
    """A smooth number of a run's end [rad], and the run's code."""
    run = jxr.simulate(grasp, state, SECONDS[scene], ts=1, rtol=rtol, throw=False)
    return run.last.q @ jnp.asarray(_WEIGHTS[run.last.q.shape[0]]), run.result._value
