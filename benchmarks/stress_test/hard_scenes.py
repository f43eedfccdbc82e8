"""Adversarial planar scenes: what random numbers would hardly ever hit.

Each function changes the numbers of scenes that `planar_scenes` drew, or draws its own.
"""

from typing import Any

import numpy as np
from scipy.special import ellipeinc

from benchmarks.stress_test.judge_contours import along, length, TURN
from benchmarks.stress_test.planar_scenes import Rng, spread


def grazing(rng: Rng, lanes: int, kind: str, *, friction: bool) -> dict[str, Any]:
    r"""Bodies that roll on a line, with so much energy that a limit is grazed, missed or just crossed.

    One coordinate is left, the angle $\theta$ by which the normal from the contact has turned in the body:
    with the height $h(\theta)$ of the centre of mass over the line (the support function), $r^2 = h^2 + h'^2$
    and $J = I + m r^2$, energy gives $\dot\theta^2 = 2 (E - m g h)/J$, and the forces are linear in E. So
    the energy at which the normal force first touches zero, and the friction that a given energy needs, are
    extremes over one turn.
    """
    body = _rolling_body(rng, lanes, kind)
    mass, inertia = body["mass"], body["inertia"]
    gravity = 9.81 * spread(rng, 0.1, 1.0, lanes)
    turn = TURN * np.arange(4096) / 4096
    around = _Around(body["contour"], turn)
    f, lam, speed = around.forces(mass, inertia, gravity)
    # f = f0 + f1 E, over one turn.
    with np.errstate(all="ignore"):
        lifts = np.where(f[1] < 0, -f[0] / f[1], np.inf)
    limit = np.min(lifts, axis=1)
    top = mass * gravity * around.h.max(axis=1)
    away = spread(rng, 1e-12, 1e-1, lanes) * rng.choice([-1.0, 1.0], lanes)
    energy = limit * (1.0 + away)
    if friction:
        energy = mass * gravity * around.h.min(axis=1) * 0.0 + limit * rng.uniform(0.3, 0.95, lanes)
    # Slow tops take for ever: stay clear of the energy that just reaches them.
    near = np.abs(energy / top - 1.0) < 0.02
    energy = np.where(near & friction, 1.05 * top, energy)
    square = 2.0 * (energy[:, None] - mass[:, None] * gravity[:, None] * around.h) * speed
    start = np.argmax(square, axis=1)
    rate = np.sqrt(np.max(square, axis=1))
    reached = _reached(square > 0, start)
    need = np.abs(lam[0] + lam[1] * energy[:, None]) / (f[0] + f[1] * energy[:, None])
    need = np.max(np.where(reached, need, 0.0), axis=1)
    with np.errstate(all="ignore"):
        lap = np.mean(TURN / np.sqrt(np.where(reached, square, np.nan)), axis=1)
        slow = np.nansum(
            np.where(reached, TURN / len(turn) / np.sqrt(np.maximum(square, 1e-12)), 0.0), axis=1
        )
    span = np.where(np.isfinite(lap), lap, 2.0 * slow)
    body |= {"gravity": gravity, "start": turn[start], "rate": rate, "span": span}
    body["friction"] = need * (1.0 + away) if friction else None
    return _on_line(body, rng)


class _Around:
    """Heights of the centre of mass over the line, and their derivatives, at normals of given angles."""

    def __init__(self, contour: dict[str, Any], turn: np.ndarray) -> None:
        a, b = _half_axes(contour)
        own = turn - contour["angle"][:, None]
        aside = (contour["offset"][:, 0] + 1j * contour["offset"][:, 1])[:, None] * np.exp(-1j * turn)
        square = (a * np.cos(own)) ** 2 + (b * np.sin(own)) ** 2
        height = np.sqrt(square)
        self.h = height + aside.real
        self.first = (b**2 - a**2) * np.sin(own) * np.cos(own) / height + aside.imag
        self.second = (a * b) ** 2 / height**3 - self.h

    def forces(self, mass: Any, inertia: Any, gravity: Any) -> tuple[Any, Any, Any]:
        """Normal and tangential force as (constant, factor of energy), and 1/J."""
        m, g = mass[:, None], gravity[:, None]
        h, first, second = self.h, self.first, self.second
        j = inertia[:, None] + m * (h**2 + first**2)
        slope = m * first * (h + second)  # J' / 2
        # theta'^2 = 2 (E - m g h) / J;  theta'' = -(J'/2 theta'^2 + m g h') / J
        square = (-2.0 * m * g * h / j, 2.0 / j)
        bend = (-(slope * square[0] + m * g * first) / j, -slope * square[1] / j)
        f = (m * (g + second * square[0] + first * bend[0]), m * (second * square[1] + first * bend[1]))
        # Along the line the centre moves by h theta'.
        lam = (m * (first * square[0] + h * bend[0]), m * (first * square[1] + h * bend[1]))
        return f, lam, 1.0 / j


def _half_axes(contour: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    pair = ("radius", "radius") if contour["kind"] == "circle" else ("a", "b")
    return contour[pair[0]][:, None], contour[pair[1]][:, None]


def _places(contour: dict[str, Any], turn: np.ndarray) -> np.ndarray:
    """Arclengths at which the outward normal has an angle; shape (lanes, 1)."""
    a, b = _half_axes(contour)
    own = turn - contour["angle"][:, None]
    u = np.arctan2(b * np.sin(own), a * np.cos(own))
    return contour["origin"][:, None] + b * ellipeinc(u, 1.0 - (a / b) ** 2)


def _reached(open_: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Angles that are reached from a start without passing where there is no energy left."""
    count = open_.shape[1]
    found = np.zeros_like(open_)
    for sign in (1, -1):
        order = (start[:, None] + sign * np.arange(count)) % count
        found[np.arange(len(start))[:, None], order] |= np.logical_and.accumulate(
            np.take_along_axis(open_, order, axis=1), axis=1
        )
    return found


def _rolling_body(rng: Rng, lanes: int, kind: str) -> dict[str, Any]:
    size, mass = spread(rng, 0.01, 0.05, lanes), 0.03 * spread(rng, 1e-2, 1e2, lanes)
    contour: dict[str, Any] = {"kind": kind}
    if kind == "circle":
        contour["radius"] = size
    else:
        contour |= {"a": size * rng.uniform(1.0, 2.0, lanes), "b": size}
    share = 0.3 if kind == "circle" else 0.1
    contour["offset"] = share * size[:, None] * rng.uniform(-1, 1, (lanes, 2))
    contour["angle"], contour["origin"] = rng.uniform(-np.pi, np.pi, lanes), np.zeros(lanes)
    return {"contour": contour, "mass": mass, "inertia": mass * size**2 * rng.uniform(0.2, 1.0, lanes)}


def _on_line(body: dict[str, Any], rng: Rng) -> dict[str, Any]:
    """The scene of a body that rolls along x on a fixed line."""
    contour, lanes = body["contour"], len(body["mass"])
    s = _places(contour, body["start"][:, None])
    place = along(contour, s)
    angle = np.angle(1.0 / place.tangent[:, 0])  # the tangent along +x, the body above
    arm = np.exp(1j * angle) * place.point[:, 0]
    q = np.stack([0.0 * angle, -arm.imag, angle], axis=1)
    # Rolling: the velocity of the contact point is zero.
    velocity = -1j * body["rate"] * arm
    far = 100.0 * length(contour)
    line = {"kind": "line", "ends": np.stack([-far, far], axis=1), "offset": np.zeros((lanes, 2))}
    line |= {"angle": np.zeros(lanes), "origin": np.zeros(lanes)}
    base = np.stack([arm.real, 0.0 * angle], axis=1)
    jaw = {
        "kind": "jaw",
        "joints": 0,
        "mass": np.ones(lanes),
        "directions": np.zeros((lanes, 0)),
        "tip": line,
    }
    jaw |= {"base": base, "angle": np.full(lanes, 0.5 * np.pi)}
    contact = {"finger": 0, "face": 0, "s_tip": np.zeros(lanes), "s_object": s[:, 0], "sense": 1}
    down = np.stack([0.0 * angle, -body["gravity"]], axis=1)
    return {
        "object": {"kind": "free", "mass": body["mass"], "inertia": body["inertia"]},
        "faces": [contour],
        "fingers": [jaw],
        "contacts": [contact | {"friction": body["friction"]}],
        "controller": {"kind": "none"},
        "gravity": down,
        "q": q,
        "v": np.stack([velocity.real, velocity.imag, body["rate"]], axis=1),
        "s": np.zeros((lanes, 1)),
        "t1": body["span"] * rng.uniform(0.5, 1.5, lanes),
        "rtol": np.full(lanes, 1e-8),
    }
