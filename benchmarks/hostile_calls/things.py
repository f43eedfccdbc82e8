"""What hostile calls are made with: scenes, points, files and functions, each made once it is needed."""

import functools
import os
import tempfile
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr
from benchmarks.hostile_calls.values import planar


@functools.cache
def folder() -> Path:
    """A folder for what the calls write; it is thrown away at the end."""
    kept = tempfile.TemporaryDirectory(prefix="hostile-")
    _KEPT.append(kept)
    os.chdir(kept.name)
    return Path(kept.name)


_KEPT: list[Any] = []


@functools.cache
def pinch() -> tuple[jxr.Grasp, jxr.State]:
    """The pinch of Part 1."""
    return jxr.scenes.pinch()


@functools.cache
def held_disc() -> jxr.Grasp:
    """Two fingers beside a disc."""
    links = ([0.06, 0.05], [0.03, 0.02], jxr.Circle(0.01))
    fingers = [jxr.Finger(*links, base=(x, 0.0)) for x in (-0.03, 0.03)]
    disc = jxr.FreeObject.uniform(jxr.Circle(0.02), density=20.0)
    return jxr.Grasp(disc, fingers, [jxr.Contact(finger=i) for i in (0, 1)])


@functools.cache
def held_state() -> jxr.State:
    return jxr.reach(held_disc(), ((-0.02, 0.0), (0.02, 0.0)), pose=(0.0, 0.08, 0.0)).state


@functools.cache
def pinch_state() -> jxr.State:
    return pinch()[1]


@functools.cache
def fitted() -> Any:
    """A contour fitted to points."""
    return jxr.fit_contour(dots(), noise=0.0)


@functools.cache
def designed() -> Any:
    """A fingertip after ten steps."""
    return jxr.design.optimise_fingertip(jxr.Ellipse(0.02, 0.01), (-0.005, 0.005), steps=10)


@functools.cache
def gridded() -> jxr.Parameters:
    """Two parameters on a grid of 3 x 3."""
    return jxr.Parameters.grid(a=[0.0, 1.0, 2.0], b=[0.0, 1.0, 2.0])


def halved(p: jxr.Parameters) -> Any:
    """A code over these."""
    return p.a > p.b


def dots(count: int = 24) -> np.ndarray:
    """Points on an ellipse."""
    u = 2 * np.pi * np.arange(count) / count
    return np.stack([0.02 * np.cos(u), 0.014 * np.sin(u)], axis=1)


def tube() -> np.ndarray:
    """A grid of points on a cylinder."""
    u, v = np.meshgrid(2 * np.pi * np.arange(32) / 32, np.linspace(0, 0.03, 8), indexing="ij")
    return np.stack([0.01 * np.cos(u), 0.01 * np.sin(u), v], -1)


def cloud() -> np.ndarray:
    """A cloud of points on a ball."""
    u = np.random.default_rng(0).normal(size=(1000, 3))
    return 0.02 * u / np.linalg.norm(u, axis=1)[:, None]


def slope() -> np.ndarray:
    """Coefficients of a wall."""
    return np.broadcast_to(0.01 * (np.arange(8) - 3.0)[:, None, None], (8, 8, 8)).copy()


def disc_image() -> np.ndarray:
    """Grey values of a disc."""
    y, x = np.mgrid[-20:21, -20:21]
    return np.clip(10.5 - np.hypot(x, y), 0.0, 1.0)


TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.01
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


@functools.cache
def written(name: str) -> Path:
    """An outline, or a solid, in a file."""
    path = folder() / name
    if path.suffix == ".npz":
        return jxr.save(path, jxr.Circle(0.01))
    if path.suffix == ".npy":
        np.save(path, TETRAHEDRON)
        return path
    if path.suffix == ".stl":
        return jxr.io.write_stl(jxr.Circle(0.01), path, height=0.005, tolerance=1e-4)
    return jxr.io.write_outline(jxr.Circle(0.01), path, unit="mm", tolerance=1e-4)


@functools.cache
def robot() -> Path:
    """A hand of one finger in a file."""
    path = folder() / "hand.xml"
    inertial = '<inertial mass="0.04" pos="0 0 0.03" diaginertia="1e-5 1e-5 1e-6"/>'
    body = f'<body name="finger"><joint name="knuckle" axis="1 0 0"/>{inertial}</body>'
    path.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    return path


def network() -> Any:
    """A small network."""
    return jxr.geometry.PeriodicNetwork(4, width=4, depth=1, key=jax.random.key(0))


def lifted(tip: Any) -> tuple[jxr.Grasp, jxr.State]:
    """The pivoted scene with another fingertip."""
    return jxr.close(planar()[0].with_tip(0, tip), planar()[1])


def rolling(t: Any) -> tuple[float, float, float]:
    return (0.1, 0.0, 0.0)


def scene_of(damping: Any) -> tuple[jxr.Grasp, jxr.State]:
    return planar()[0].with_(damping=damping), planar()[1]


def identified(numbers: dict[str, Any]) -> tuple[jxr.Grasp, jxr.State]:
    if "damping" not in numbers:
        raise ValueError("argument guess must have a damping")  # the caller's own check
    return scene_of(numbers["damping"])


def kept(run: jxr.Trajectory) -> Any:
    return run.last.q


def bowl(u: Any, v: Any) -> tuple[Any, Any, Any]:
    return u, v, 5.0 * (u**2 + v**2)


def ball(x: Any, y: Any, z: Any) -> Any:
    return x**2 + y**2 + z**2 - 1e-4


def egg(u: Any) -> Any:
    """A closed curve by its points."""
    return 0.01 * jnp.array([(1.2 + 0.2 * jnp.cos(u)) * jnp.cos(u), jnp.sin(u)])
