"""A valid call of every public name of jaxroll: arguments by parameter name, and exceptions to it.

`calls()` walks over the public names and their signatures; a name, or a parameter, without an example raises.
"""

import dataclasses
import functools
import importlib
import inspect
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr
from benchmarks._hostile_values import KINDS, planar, planar_run, spatial, spatial_run

MODULES = ("contact", "control", "design", "geometry", "io", "plotting", "scenes", "stability")

# Not called by users at all, or not called with arguments.
ABSTRACT = {"AbstractContour", "AbstractSurface", "AbstractContact", "AbstractController", "AbstractGoal"}
ABSTRACT |= {"AbstractSupport", "AbstractChart", "AbstractImplicit", "AbstractTabulated"}
ENUMERATIONS = {"RESULTS", "VERDICTS"}
# What functions return: plain records, which hold whatever they are given (JAX puts anything in a pytree).
RECORDS = {"State", "Trajectory", "LocalMinima", "Location", "SurfaceLocation", "SurfaceMinima", "Motion"}
RECORDS |= {
    "Touch",
    "Touch3",
    "Sensed",
    "Tip",
    "Design",
    "ArclengthTable",
    "Frenet2",
    "Fit",
    "FitReport",
    "Gauss3",
}
RECORDS |= {"Principal", "NetworkFit", "CleanPoints", "Jet", "SurfaceFit", "SurfaceReport", "Level", "Table"}
RECORDS |= {"TableError", "Equilibrium", "PinchStatics", "Stability"}
# Written on scalars for use inside compiled programs, by other layers and by a caller's own shapes: nothing
# is checked there, for every check would be one more on the way of each run.
INNER = {"gap", "gap_bias", "gap_rate", "pfaffian", "rolling_rate", "tangency", "tangency3", "clearance"}
INNER |= {"check_unit_speed", "sense", "joint_angles", "UserController", "as_controller", "frenet", "tabled"}
INNER |= {"approach", "principal", "jet", "differentiated", "level_frame", "spread_in_box", "from_frames"}
INNER |= {"tabulated"}
LEFT_OUT = ABSTRACT | ENUMERATIONS | RECORDS | INNER


@dataclasses.dataclass(frozen=True)
class Argument:
    """What a parameter means, a valid value of it, and what it takes besides what its kind does."""

    kind: str
    valid: Callable[[], Any]
    also: frozenset[str] = frozenset()

    @property
    def taken(self) -> frozenset[str]:
        """Names of the values that may be taken whatever the valid one is."""
        return self.also | KINDS[self.kind].sensible


@dataclasses.dataclass(frozen=True)
class Call:
    """A public function, its arguments, and which of them it cannot do without."""

    name: str
    function: Callable[..., Any]
    arguments: dict[str, Argument]
    needed: tuple[str, ...]
    slow: bool = False


def _is(kind: str, valid: Any, *also: str) -> Argument:
    return Argument(kind, (lambda: valid), frozenset(also))


def _made(kind: str, valid: Callable[[], Any], *also: str) -> Argument:
    return Argument(kind, valid, frozenset(also))


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
    if path.suffix == ".stl":
        return jxr.io.write_stl(jxr.Circle(0.01), path, height=0.005, tolerance=1e-4)
    return jxr.io.write_outline(jxr.Circle(0.01), path, unit="mm", tolerance=1e-4)


def network() -> Any:
    """A small network."""
    return jxr.geometry.PeriodicNetwork(4, width=4, depth=1, key=jax.random.key(0))


def lifted(tip: Any) -> tuple[jxr.Grasp, jxr.State]:
    """The pivoted scene with another fingertip."""
    return jxr.close(planar()[0].with_tip(0, tip), planar()[1])


_POSITIVE = """
    radius mass inertia length major minor size ahead flat steepness width height depth period bore tube pixel
    speed fps tolerance rtol gamma_f omega_f gamma_lambda omega_lambda step band
"""
_COUNTS = """
    cells samples candidates knots degree steps frames count harmonics finger contour surface
"""
# By name of the parameter, unless a call says otherwise.
PARAMETERS: dict[str, Argument] = {
    **{name: _is("positive", 0.01) for name in _POSITIVE.split()},
    **{name: _is("count", 16) for name in _COUNTS.split()},
    "a": _is("positive", 0.02),
    "b": _is("positive", 0.014),
    "c": _is("positive", 0.01),
    "azimuth": _is("number", 10.0),
    "alpha": _is("not negative", 1e-3),
    "angle": _is("number", 0.3),
    "ax": _is("part", None),
    "axes": _is("array", (0.2, 0.03, 0.02)),
    "axis": _is("array", (0.0, 0.0, 1.0)),
    "base": _is("array", (0.01, 0.02)),
    "beta": _is("not negative", 20.0),
    "centre": _is("array", (0.001, 0.002)),
    "centres": _is("array", (0.03, 0.03)),
    "cases": _made("any array", lambda: np.array([0.1, 0.2])),
    "climb": _is("number", 0.3),
    "closed": _is("flag", True),
    "coefficients": _made("array", slope),
    "contacts": _made("contact", lambda: planar()[0].contacts),
    "contours": _made("contours", lambda: jxr.Circle(0.02)),
    "controller": _is("function", None),
    "damping": _is("not negative", 0.006),
    "directions": _is("array", (0.0, 1.5), "empty list", "empty tuple", "two numbers"),
    "domain": _is("array", (-0.02, 0.02)),
    "elevation": _is("number", 10.0),
    "exponent": _is("number", 4.0),
    "field": _is("choice", "spline"),
    "fingers": _made("finger", lambda: planar()[0].fingers),
    "force": _is("number", 0.5),
    "friction": _is("positive", 0.3),
    "goal": _made("part", jxr.design.Margin),
    "grasp": _made("grasp", lambda: planar()[0]),
    "gravity": _is("array", (0.0, -9.81)),
    "guess": _made("state", lambda: planar()[1]),
    "hold_contacts": _is("flag", True),
    "image": _made("array", disc_image, "square", "itself as bits", "itself and infinity"),
    "inclination": _is("number", 1.2),
    "inertias": _is("array", (1e-5, 1e-5)),
    "interval": _is("array", (-0.005, 0.005)),
    "key": _made("part", lambda: jax.random.key(0), "key"),
    "lengths": _is("array", (0.065, 0.065)),
    "limits": _made("part", jxr.design.Limits),
    "line": _is("flag", False),
    "links": _is("flag", True),
    "locate": _is("flag", False),
    "lowered": _is("number", 0.01),
    "masses": _is("array", (0.045, 0.04)),
    "motion": _made("function", lambda: jxr.Turning(2.0)),
    "noise": _is("not negative", 1e-6),
    "normal": _is("array", (0.0, 0.0, 1.0), "three numbers"),
    "normals": _made("array", cloud),
    "object": _made("part", lambda: jxr.scenes.rectangle(), "object in the plane"),
    "offset": _is("array", (0.01, 0.0)),
    "ordered": _is("flag", True),
    "origin": _is("number", 0.0),
    "outline": _is("array", (0.01, 0.02, 0.03)),
    "pivot": _is("array", (0.03, 0.105)),
    "points": _made("array", dots),
    "pose_a": _is("array", (0.05, 0.0, 0.0), "three numbers"),
    "pose_b": _is("array", (0.0, 0.05, 0.0), "three numbers"),
    "precession": _is("number", 3.0),
    "progress": _is("flag", False, "function", "class", "class of states"),
    "rate": _is("number", 2.0),
    "reverse": _is("flag", False),
    "rotation": _is("array", (1.0, 0.0, 0.0, 0.0)),
    "s": _is("number", 0.003),
    "sense": _is("count", 1),
    "shape": _made("contour", lambda: jxr.Circle(0.01)),
    "signal": _made("array", lambda: np.linspace(0.0, 0.1, 4)[:, None]),
    "skew": _is("number", 0.03),
    "smoothing": _is("not negative", 1e-3),
    "smoothness": _is("positive", 4.0, "infinity"),
    "solver": _is("part", None),
    "spin": _is("choice", "free"),
    "start": _is("array", (1.5, 1.7)),
    "state": _made("state", lambda: planar()[1]),
    "states": _made("state", lambda: planar()[1]),
    "surfaces": _made("surface", lambda: jxr.Sphere(0.02)),
    "s_object": _is("number", 0.001),
    "s_tip": _is("number", 0.001),
    "target": _is("array", (0.0, 0.1), "two numbers", "three numbers"),
    "threshold": _is("number", 0.5),
    "throw": _is("flag", True),
    "tilt": _is("number", 0.01),
    "tip": _made("contour", lambda: jxr.Circle(0.01)),
    "tips": _made("contour", lambda: jxr.Circle(0.01)),
    "trajectory": _made("run", planar_run),
    "travel": _is("number", 0.03),
    "ts": _is("count", 4),
    "t": _is("number", 0.0),
    "t0": _is("number", 0.0),
    "t1": _is("positive", 0.02),
    "turn": _is("number", 10.0),
    "unit": _is("choice", "mm"),
    "view": _made("part", lambda: None),
    "which": _is("count", 0, "whole zero"),
}
_SLOW = {
    "close",
    "simulate",
    "roll",
    "sweep",
    "fit_contour",
    "optimise_fingertip",
    "fit_surface",
    "equilibrium",
}
_SLOW |= {
    "assess",
    "pinch_rest",
    "locate",
    "locate_surfaces",
    "animate",
    "page",
    "poses",
    "responses",
    "phase",
}
_SLOW |= {
    "pinch_balance",
    "press_balance",
    "energies",
    "multipliers",
    "equation_terms",
    "loci",
    "pinch",
    "ring",
}
_SLOW |= {
    "pinch_ellipse",
    "ball_plate",
    "pinch3d",
    "rattleback",
    "wheel",
    "tube",
    "turntable",
    "roller",
    "design",
}


def _family(names: str, **changed: Argument) -> dict[str, dict[str, Argument]]:
    return dict.fromkeys(names.split(), changed)


_CLOUD, _BALL = _made("array", cloud), _made("surface", lambda: jxr.Sphere(0.02))
_ROUND = _made("contour", lambda: jxr.Circle(0.01))
_RUN, _BODY = _made("run", planar_run), _made("contour", lambda: jxr.Ellipse(0.02, 0.014))
_SPATIAL = {
    "grasp": _made("grasp in space", lambda: spatial()[0]),
    "trajectory": _made("run in space", spatial_run),
}
_PATH = {"path": _made("path", lambda: folder() / "new" / "shape.csv"), "contour": _BODY}
# Where a parameter means something else than its name says elsewhere, or has another shape.
EXCEPTIONS: dict[str, dict[str, Argument]] = {
    **_family("Ellipse NeuralSupport NeuralCurvature SupportFunction", cells=_is("count", 64)),
    **_family("pinch ring pinch_ellipse ball_plate", gravity=_is("array", (0.0, -9.81))),
    **_family("incline rattleback tube turntable wheel", gravity=_is("not negative", 9.81)),
    **_family("MovedSurface", offset=_is("array", (0.01, 0.0, 0.0)), surface=_BALL),
    **_family("Hollow", surface=_BALL),
    **_family("loci", **_SPATIAL),
    **_family("contours phase pose poses responses animate", trajectory=_RUN),
    **_family("friction_demand overshoot peak_force settling_time tracking_error", run=_RUN),
    **_family("fit_surface", points=_CLOUD, smoothing=_is("not negative", 0.02)),
    "Finger": {"tip": _ROUND},
    "Contact3": {"finger": _is("count", 0, "whole zero"), "surface": _is("count", 0, "whole zero")},
    "Contact": {"finger": _is("count", 0, "whole zero"), "contour": _is("count", 0, "whole zero")},
    "Finger3": {
        "axes": _is("array", ((0, 0, 1.0), (0, 1.0, 0))),
        "offsets": _is("array", ((0.05, 0, 0), (0.05, 0, 0))),
        "tip": _BALL,
        "base": _is("array", (0.0, 0.0, 0.0), "three numbers"),
        "centres": _is("array", ((0.02, 0, 0), (0.02, 0, 0))),
        "inertias": _is("array", (1e-5, 1e-5)),
    },
    "FreeObject3": {"inertia": _is("positive", 1e-5, "three numbers")},
    "Grasp": {"object": _made("object", lambda: planar()[0].object)},
    "Jaw": {"contour": _ROUND},
    "NeuralCurvature": {
        "network": _made("part", network),
        "length": _is("positive", 0.06),
        "cells": _is("count", 64),
    },
    "NeuralSupport": {"network": _made("part", network), "cells": _is("count", 64)},
    "PivotedObject": {"pivot": _is("array", (0.01, 0.02))},
    "Spline": {
        "degree": _is("count", 5),
        "origin": _is("count", 0, "whole zero"),
        "cells": _is("count", 128),
    },
    "Stage": {"surface": _BALL, "base": _is("array", (0.0, 0.0, 0.0), "three numbers")},
    "SupportFunction": {
        "cosines": _is("array", (0.0, 1e-4), "empty list", "empty tuple"),
        "sines": _is("array", (0.0, 1e-4)),
    },
    "Turning": {"centre": _is("array", (0.0, 0.0, 0.0), "three numbers")},
    "multipliers": {"ts": _is("number", 0.0), "formulation": _made("part", jxr.CSM, "method")},
    "pinch_balance": {
        "ts": _is("number", 0.0),
        "grasp": _made("grasp", lambda: pinch()[0]),
        "states": _made("state", pinch_state),
    },
    "press_balance": {"ts": _is("number", 0.0)},
    "roll": {
        "tip": _BALL,
        "object": _made("surface", jxr.Plane),
        "velocity": _made("function", lambda: _rolling),
        "ts": _is("array", (0.0, 0.1, 0.2), "three numbers", "seven numbers"),
        "at_tip": _is("array", (0.0, 0.0, -0.02)),
        "at_object": _is("array", (0.0, 0.0, 0.0)),
        "spin": _is("function", None),
    },
    "simulate": {
        "t1": _is("positive", 0.02),
        "formulation": _made("part", jxr.Index1),
        "record": _is("part", ()),
    },
    "sweep": {
        "make": _made("function", lambda: _scene_of),
        "parameters": _made("any array", lambda: np.array([0.004, 0.006]), "empty tuple"),
        "keep": _made("function", lambda: _kept),
        "chunk": _is("count", 2),
        "resume": _made("folder", lambda: folder() / "runs"),
    },
    "locate": {
        "a": _ROUND,
        "b": _ROUND,
        "pose_a": _is("array", (0.05, 0.0, 0.0)),
        "samples": _is("count", 32),
    },
    "locate_surfaces": {
        "a": _BALL,
        "b": _BALL,
        "pose_a": _is("array", (0.05, 0, 0, 1.0, 0, 0, 0)),
        "pose_b": _is("array", (0, 0.05, 0, 1.0, 0, 0, 0)),
        "samples": _is("count", 32),
    },
    "Press": {"radius": _is("positive", 0.01)},
    "Opposition": {"damping": _is("not negative", 0.006), "alpha": _is("not negative", 1e-3)},
    "ClosedLoop": {
        "make": _made("function", lambda: lifted),
        "objective": _is("function", {"overshoot": 1.0}),
    },
    "Firmness": {
        "make": _made("function", lambda: lifted),
        "measure": _is("choice", "stiffness"),
        "neutral": _is("count", 1, "whole zero"),
        "scale": _is("positive", 1.0),
    },
    "optimise_fingertip": {"tip": _BODY, "steps": _is("count", 10), "symmetric": _is("flag", False)},
    "value_and_grad": {
        "function": _made("function", lambda: jnp.sum),
        "mode": _is("choice", "auto"),
        "has_aux": _is("flag", False),
    },
    "Moved": {"contour": _ROUND},
    "crossings": {"points": _made("array", dots)},
    "PeriodicNetwork": {
        "harmonics": _is("count", 4),
        "decay": _is("not negative", 1.0),
        "width": _is("count", 4),
        "depth": _is("count", 1),
        "activation": _is("choice", "tanh"),
        "amplitude": _is("number", 1.0),
    },
    "smoothing_for": {"degree": _is("count", 5)},
    "Chart": {
        "function": _made("function", lambda: _bowl),
        "domain": _is("array", ((-1.0, 1.0), (-1.0, 1.0))),
        "periodic": _is("part", (False, False), "flags"),
    },
    "Extruded": {"contour": _ROUND},
    "Implicit": {"function": _made("function", lambda: _ball)},
    "Patch": {"points": _made("array", tube), "periodic": _is("part", (True, False), "flags")},
    "SplineSurface": {"origin": _is("array", (0.0, 0.0, 0.0), "three numbers")},
    "metres_per": {"unit": _is("choice", "mm")},
    "Superellipsoid": {"exponent": _is("number", 4.0)},
    "read_points": {
        "path": _made("path", lambda: written("disc.csv")),
        "columns": _is("part", (0, 1)),
        "pixel": _is("part", None),
    },
    "write_outline": {**_PATH, "tolerance": _is("positive", 1e-4)},
    "read_silhouette": {"pixel": _is("positive", 1e-3)},
    "read_mesh": {"path": _made("path", lambda: written("disc.stl"))},
    "write_stl": {
        "contour": _BODY,
        "path": _made("path", lambda: folder() / "new.stl"),
        "tolerance": _is("positive", 1e-4),
    },
    "section": {
        "vertices": _is("array", TETRAHEDRON),
        "faces": _is("array", TRIANGLES),
        "origin": _is("array", (0.0, 0.0, 0.005), "three numbers"),
    },
    "animate": {
        **{"path": _made("path", lambda: folder() / "new.gif"), "until": _is("positive", 0.01)},
        **{"forces": _is("flag", False), "size": _is("positive", 2.0)},
        "progress": _is("function", None),
    },
    "comparison": {
        "runs": _made("part", lambda: [planar_run(), planar_run()]),
        "names": _is("part", ("before", "after")),
        "folder": _made("folder", lambda: folder() / "plots"),
    },
    "design": {
        "design": _made("part", designed),
        "folder": _made("folder", lambda: folder() / "plots"),
    },
    "fit": {"fit": _made("part", fitted)},
    "plotting.loci": {**_SPATIAL, "folder": _made("folder", lambda: folder() / "plots")},
    "page": {**_SPATIAL, "path": _made("path", lambda: folder() / "new.html"), "title": _is("text", "Page")},
    "phase": {"rest": _made("state", lambda: planar()[1])},
    "poses": {"times": _is("array", (0.0, 0.01)), "forces": _is("flag", False)},
    "responses": {"folder": _made("folder", lambda: folder() / "plots")},
    "pinch": {"s": _is("array", (0.004, -0.003)), "damping": _is("not negative", 0.006)},
    "ring": {"count": _is("count", 3)},
    "pivoted": {"s": _is("number", 0.003)},
    "roller": {"contour": _BODY, "force": _is("number", 5.0), "period": _is("positive", 3.0)},
    "incline": {"slope": _is("number", 0.3)},
    "rattleback": {"spin": _is("number", -5.0), "inertia": _is("array", (2e-4, 1.6e-3, 1.7e-3))},
    "tube": {"spin": _is("number", 4.0), "bore": _is("positive", 0.2)},
    "turntable": {
        "position": _is("array", (0.3, 0.1)),
        "velocity": _is("array", (0.2, -0.4)),
        "spin": _is("number", 0.7),
    },
    "wheel": {"tube": _is("positive", 0.005), "radius": _is("positive", 0.1)},
    "pinch3d": {
        "tips": _made("surface", lambda: jxr.Sphere(0.01)),
        "object": _made("part", lambda: jxr.scenes.cuboid(), "object in space"),
        "gravity": _is("array", (0.0, 0.0, -9.81), "three numbers"),
    },
    "with_tip": {"finger": _is("count", 0, "whole zero"), "tip": _ROUND},
    "with_contacts": {"contacts": _made("contact", jxr.Contact)},
    "on_contour": {"s": _is("any array", 0.001)},
    "on_surface": {"at": _is("array", (0.0, 0.0, 0.01), "three numbers", "square")},
    "near_surface": {
        "point": _is("array", (0.0, 0.01, 0.02), "three numbers", "square"),
        "guess": _is("array", (0.0, 0.01, 0.02), "three numbers"),
    },
    "margin": {"contour": _ROUND, "s": _is("any array", 0.001)},
    **_family(
        "pinch_statics rectangle_hessian",
        grasp=_made("grasp", lambda: pinch()[0]),
        s=_is("array", (0.0, 0.0)),
    ),
    "pinch_rest": {"grasp": _made("grasp", lambda: pinch()[0]), "state": _made("state", pinch_state)},
    "assess": {"tolerance": _is("positive", 1e-7)},
}


def _rolling(t: Any) -> tuple[float, float, float]:
    return (0.1, 0.0, 0.0)


def _scene_of(damping: Any) -> tuple[jxr.Grasp, jxr.State]:
    return planar()[0].with_(damping=damping), planar()[1]


def _kept(run: jxr.Trajectory) -> Any:
    return run.last.q


def _bowl(u: Any, v: Any) -> tuple[Any, Any, Any]:
    return u, v, 5.0 * (u**2 + v**2)


def _ball(x: Any, y: Any, z: Any) -> Any:
    return x**2 + y**2 + z**2 - 1e-4


def public() -> dict[str, Any]:
    """Every public name, with the module where two of them share one; what is left out is left out here."""
    found: dict[str, Any] = {}
    for place in ("", *MODULES):
        module = importlib.import_module(f"jaxroll.{place}" if place else "jaxroll")
        for name in _listed(module, place):
            thing = getattr(module, name)
            if isinstance(thing, ModuleType) or name in LEFT_OUT or any(thing is x for x in found.values()):
                continue
            found[f"{place}.{name}" if name in found else name] = thing
    return found


def _listed(module: ModuleType, place: str) -> list[str]:
    if not place or place == "control":  # the latter is one file: what it imports is not its own
        names = getattr(module, "__all__", None) or [
            name for name, x in vars(module).items() if getattr(x, "__module__", "") == module.__name__
        ]
    else:
        names = getattr(module, "__all__", None) or list(vars(module))
    mine = lambda x: getattr(x, "__module__", "").startswith("jaxroll")  # noqa: E731
    return [n for n in names if not n.startswith("_") and (not place or mine(getattr(module, n)))]


def with_tip(finger: Any, tip: Any) -> Any:
    """`Grasp.with_tip` of the pivoted scene."""
    return planar()[0].with_tip(finger, tip)


def with_contacts(contacts: Any) -> Any:
    """`Grasp.with_contacts` of the pivoted scene."""
    return planar()[0].with_contacts(contacts)


def with_(
    inertia: Any = 1e-5, pivot: Any = (0.0, 0.1), damping: Any = 0.01, gravity: Any = (0.0, 0.0)
) -> Any:
    """`Grasp.with_` of the pivoted scene, one field each of its object, its controller and its own."""
    return planar()[0].with_(inertia=inertia, pivot=pivot, damping=damping, gravity=gravity)


def moved(offset: Any = (0.0, 0.0), angle: Any = 0.0, origin: Any = 0.0) -> Any:
    """`moved` of a contour."""
    return jxr.Circle(0.01).moved(offset, angle, origin=origin)


def on_contour(s: Any) -> Any:
    """What a contour says of a place on it."""
    shape = jxr.Circle(0.01)
    return shape.point(s), shape.tangent(s), shape.normal(s), shape.curvature(s)


def on_surface(at: Any) -> Any:
    """What a surface says of a place on it."""
    shape = jxr.Sphere(0.01)
    return shape.point(at), shape.normal(at), shape.principal_curvatures(at), shape.forms(at)


def near_surface(point: Any, guess: Any = None) -> Any:
    """`near` of a surface."""
    return jxr.Sphere(0.01).near(point, guess)


# Methods that take a caller's arguments.
METHODS = (with_tip, with_contacts, with_, moved, on_contour, on_surface, near_surface)
# What `**options` takes.
OPTIONS: dict[str, dict[str, Argument]] = {
    "simulate": {
        "events": _is("part", ("lift",)),
        "atol": _is("positive", 1e-8),
        "dt0": _is("positive", 1e-4),
        "max_steps": _is("count", 64),
        "stepsize_controller": _is("part", None, "None"),
        "progress_meter": _is("part", None, "None"),
    },
    "optimise_fingertip": {
        "starts": _is("count", 1),
        "seed": _is("count", 1, "whole zero"),
        "optimiser": _is("part", None, "None"),
        "mode": _is("choice", "auto"),
        "checkpoint": _made("path", lambda: folder() / "checkpoint.npz", "None"),
    },
}


@functools.cache
def calls() -> dict[str, Call]:
    """A valid call of every public name, and of the methods that take a caller's arguments.

    Raises:
        LookupError: If a name or a parameter has no example.
    """
    things = {**public(), **{method.__name__: method for method in METHODS}}
    return {name: _call(name, thing) for name, thing in things.items()}


def _call(name: str, thing: Callable[..., Any]) -> Call:
    own, needed = EXCEPTIONS.get(name, {}), []
    arguments = dict(OPTIONS.get(name, {}))
    for parameter in inspect.signature(thing).parameters.values():
        if parameter.kind is parameter.VAR_KEYWORD:
            continue
        argument = own.get(parameter.name, PARAMETERS.get(parameter.name))
        if argument is None:
            raise LookupError(f"{name}: parameter {parameter.name} has no example in {__file__}")
        if parameter.default is None:
            argument = dataclasses.replace(argument, also=argument.also | {"None"})
        if parameter.default is parameter.empty:
            needed.append(parameter.name)
        arguments[parameter.name] = argument
    return Call(name, thing, arguments, tuple(needed), name.split(".")[-1] in _SLOW)
