"""Small runs that are made by formulas: every coordinate swings about the scene's start.

They are no motions of a grasp, and need not be: a picture shows whatever states, forces and residuals it is
given. Nothing is simulated, so that there is little to compile, and no number of a picture is an error of
rounding.
"""

import contextlib
import dataclasses
import functools
import json
from collections.abc import Iterator
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr
from jaxroll._analysis._loci import Loci, Locus
from jaxroll._integration._trajectory import Stats
from jaxroll._motion import Energy, Multipliers, Residuals
from jaxroll.scenes import _plane_scenes, _space_scenes, _tripod
from tests.recorded.compare import path_of
from tests.subjects import stand_in_grasp

_LENGTH, _ANGLE = 1.5e-3, 0.08


@functools.cache
def scene(name: str) -> tuple[Any, Any]:
    """A scene with its defaults, its state the recorded one: to close its contacts takes seconds to trace."""
    kept = json.loads(path_of("closed_states").read_text()).get(name)
    if kept is None:
        return getattr(jxr.scenes, name)()
    q, s = (jnp.asarray(kept[part]) for part in ("q", "s"))
    with not_closed(jxr.State(q, jnp.zeros(len(kept["v"])), s)):
        return getattr(jxr.scenes, name)()


@contextlib.contextmanager
def not_closed(state: Any = None) -> Iterator[None]:
    """Scenes whose contacts are not closed: they start at a state, or else at what they guess."""

    def instead(grasp: Any, guess: Any, **options: Any) -> tuple[Any, Any]:
        return grasp, guess if state is None else state

    with (
        mock.patch.object(_plane_scenes, "close", instead),
        mock.patch.object(_space_scenes, "close", instead),
        mock.patch.object(_tripod, "close", instead),
    ):
        yield


def swinging(times: int, shape: tuple[int, ...], size: Any, begin: float = 0.0) -> np.ndarray:
    """Waves of shape (times, *shape), each with its own rate, that begin at zero."""
    count = int(np.prod(shape, dtype=int))
    rates, phases = 2.0 + 0.7 * np.arange(count), begin + 0.9 * np.arange(count)
    t = np.linspace(0.0, 1.0, times)[:, None]
    return np.broadcast_to(size, shape) * (np.sin(rates * t + phases) - np.sin(phases)).reshape(times, *shape)


@functools.cache
def run(name: str, *, times: int = 13, t1: float = 0.6, ended: str | None = None) -> Any:
    """A made run of a scene; with `ended`, by that code after two thirds of its time."""
    grasp, state = scene(name)
    q, v, s = (np.asarray(x) for x in (state.q, state.v, state.s))
    sizes = np.array(
        [_LENGTH if each.unit == "m" else _ANGLE for _, labels in grasp.labels.bodies for each in labels]
    )
    sizes = np.resize(sizes, q.shape)
    qs = q + swinging(times, q.shape, sizes)
    if grasp.spatial:
        qs[:, 3:7] /= np.linalg.norm(qs[:, 3:7], axis=1, keepdims=True)
    states = [qs, v + swinging(times, v.shape, 0.3, 1.0), s + swinging(times, s.shape, _LENGTH, 2.0)]
    ts, reached = np.linspace(0.0, t1, times), times
    if ended is not None:
        reached = 2 * times // 3
    each = (len(grasp.contacts),) + ((3,) if grasp.spatial else ())
    forces = [
        0.8 + swinging(times, each[:1], 0.2, 3.0),
        0.1 + swinging(times, each, 0.15, 4.0),
    ]
    left = [
        swinging(times, each[:1], 2e-9, 5.0),
        swinging(times, each, 3e-8, 6.0),
        swinging(times, each, 4e-7),
    ]
    energy = [swinging(times, (), size, 7.0) for size in (2e-4, 3e-4, -4e-4, 5e-10)]
    for rows in (*states, *forces, *left, *energy):
        rows[reached:] = np.nan
    last = jxr.State(*jax.device_put([rows[reached - 1] for rows in states]))
    code = jxr.RESULTS.successful if ended is None else getattr(jxr.RESULTS, ended)
    numbers = [np.asarray(x) for x in (37, 35, 2, ts[reached - 1], -1 if ended is None else 0, np.nan)]
    return jxr.Trajectory(
        jax.device_put(ts),
        jxr.State(*jax.device_put(states)),
        last,
        Residuals(*jax.device_put(left)),
        code,
        Stats(*jax.device_put(numbers)),
        Multipliers(*jax.device_put(forces)),
        Energy(*jax.device_put(energy)),
        labels=grasp.labels,
    )


@functools.cache
def loci(contacts: int, times: int = 41, whole: float = 0.012) -> Any:
    """Made loci: arclengths that differ by some nanometres, curvatures that grow without bound at one end."""
    t = np.linspace(0.0, 1.0, times)
    found = []
    for k in range(2):
        c = np.arange(1, contacts + 1)[:, None]
        speed = whole * np.sin(0.5 * np.pi * (1.0 - t)) * c
        arclength = whole * (t + 0.1 * np.sin(3.0 * t)) * c + 2e-9 * k * np.sin(5.0 * t)
        bends = [(20.0 + 30.0 * i * np.sin(4.0 * t + k) + 0.1 / (1.02 - t)) * c for i in range(5)]
        bends[3 - k] = 1e-2 * bends[3 - k]
        point = np.stack([arclength, 0.2 * arclength, -arclength], axis=-1)
        found.append(Locus(point, arclength, speed, *bends))
    return Loci(jnp.asarray(t), *found)


@functools.cache
def stand_in() -> tuple[Any, Any, np.ndarray]:
    """Two balls that roll on an ellipsoid: grasp, motion, times."""
    return stand_in_grasp.stand_in(13)


@functools.cache
def designed() -> Any:
    """A design of two starts, before and after, without the search."""
    before, after = jxr.Ellipse(0.018, 0.009), jxr.Ellipse(0.012, 0.010)
    history = np.array([[5.0, 3.0, 2.0, np.nan], [4.0, 1.5, 1.0, 0.8]])
    return jxr.design.Design(
        tip=after,
        start=before,
        tips=after,
        before=jnp.array([-1e-3, -2e-3]),
        after=jnp.array([1e-3, 2e-3]),
        violation=jnp.zeros(2),
        holds=jnp.array([True, True]),
        chosen=1,
        history=jnp.asarray(history),
        result=jxr.RESULTS.successful,
        figures={"margin [mm]": (-1.0, 2.0)},
        parts={"size": -0.1},
        interval=jnp.array([-0.005, 0.004]),
    )


@functools.cache
def fitted(*, closed: bool = True) -> Any:
    """A contour through points of an ellipse, or of a part of it, that are a little off."""
    u = 2.0 * np.pi * np.arange(48) / 48
    radius = 1.0 + 1e-3 * np.sin(5.0 * u)
    points = np.stack([20.0 * radius * np.cos(u), 14.0 * radius * np.sin(u)], axis=-1)
    found = jxr.fit_contour(points if closed else points[:30], unit="mm", noise=0.0, closed=closed)
    # The contour runs through the points but for rounding, which is not to be drawn: it gets others.
    off = 1e-5 * np.stack([np.sin(3.0 * u), np.cos(2.0 * u)], axis=-1)[: len(found.points)]
    report = dataclasses.replace(found.report, rms=7e-6, largest=1.2e-5)
    return dataclasses.replace(found, points=found.points + off, report=report)


def without(made: Any, **parts: Any) -> Any:
    """A run in which some parts are others."""
    return dataclasses.replace(made, **parts)
