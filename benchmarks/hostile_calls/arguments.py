"""Arguments of public names: what each parameter means by its name, and where a call means something else."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr
from benchmarks.hostile_calls.things import (
    ball,
    bowl,
    cloud,
    designed,
    disc_image,
    dots,
    egg,
    fitted,
    folder,
    gridded,
    halved,
    held_disc,
    held_state,
    identified,
    kept,
    lifted,
    network,
    pinch,
    pinch_state,
    robot,
    rolling,
    scene_of,
    slope,
    TETRAHEDRON,
    TRIANGLES,
    tube,
    written,
)
from benchmarks.hostile_calls.values import KINDS, NUMERIC, planar, planar_run, spatial, spatial_run


@dataclasses.dataclass(frozen=True)
class Argument:
    """What a parameter means, a valid value of it, and what it takes besides what its kind does."""

    kind: str
    valid: Callable[[], Any]
    also: frozenset[str] = frozenset()

    @property
    def taken(self) -> frozenset[str]:
        """Names of the values that may be taken whatever the valid one is."""
        return self.also | KINDS[self.kind].sensible | {"itself"}

    def needs_valid(self, name: str) -> bool:
        """Whether the value of this name is made of the valid one, or compared with it."""
        spoilt = any(name in spoils for spoils in KINDS[self.kind].spoils)
        return spoilt or self.kind in NUMERIC


def _is(kind: str, valid: Any, *also: str) -> Argument:
    return Argument(kind, (lambda: valid), frozenset(also))


def _made(kind: str, valid: Callable[[], Any], *also: str) -> Argument:
    return Argument(kind, valid, frozenset(also))


_POSITIVE = """
    radius mass inertia length major minor size ahead flat steepness width height depth period bore tube pixel
    speed fps tolerance rtol gamma_f omega_f gamma_lambda omega_lambda step band duration
"""
_COUNTS = """
    cells samples candidates knots degree steps frames count harmonics finger contour surface
"""
# Places that there are not: what is asked of them is not finite either.
_NOWHERE = ("NaN", "NaN among numbers", "itself and NaN", "infinity", "minus infinity")
_NOWHERE += ("infinity among numbers", "itself and infinity")
# Flags as parameters of a sweep.
_FLAGS = ("True", "False", "NumPy's True", "flags", "flag among numbers", "flag array")
_VECTORS = ("two numbers", "three numbers", "seven numbers", "whole numbers", "numbers of float32")
_VECTORS += ("its last twice", "its last left out")
# By name of the parameter, unless a call says otherwise.
PARAMETERS: dict[str, Argument] = {
    **{name: _is("positive", 0.01) for name in _POSITIVE.split()},
    **{name: _is("count", 16) for name in _COUNTS.split()},
    "a": _is("positive", 0.02),
    "b": _is("positive", 0.014),
    "c": _is("positive", 0.01),
    "atol": _is("positive", 1e-8),
    "azimuth": _is("number", 10.0),
    "alpha": _is("not negative", 1e-3),
    "anchor": _is("array", (0.0, 0.1), "three numbers", "its last twice"),
    "angle": _is("number", 0.3),
    "angular": _is("number", 1e-5),
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
    "coefficients": _made("array", slope, "its last twice", "its last left out"),
    "contacts": _made("contact", lambda: planar()[0].contacts),
    "contours": _made("contours", lambda: jxr.Circle(0.02)),
    "controller": _is("function", None),
    "damping": _is("not negative", 0.006),
    "density": _is("positive", 1000.0),
    "directions": _is("array", (0.0, 1.5), "empty list", "empty tuple", "two numbers", "its last left out"),
    "domain": _is("array", (-0.02, 0.02)),
    "dt0": _is("positive", 1e-4),
    "elevation": _is("number", 10.0),
    "events": _is("part", ("lift",), "empty list", "empty tuple"),
    "exponent": _is("number", 4.0),
    "field": _is("choice", "spline"),
    "fingers": _made("finger", lambda: planar()[0].fingers),
    "force": _is("number", 0.5),
    "friction": _is("positive", 0.3),
    "goal": _made("part", jxr.design.Margin),
    "grasp": _made("grasp", lambda: planar()[0]),
    "gravity": _is("array", (0.0, -9.81)),
    "guess": _made("state", lambda: planar()[1]),
    "hold": _is("choice", "finger 0", "empty list", "empty tuple"),
    "hold_contacts": _is("flag", True),
    "image": _made(
        "array",
        disc_image,
        "square",
        "itself as bits",
        "itself and infinity",
        "its last left out",
        "its last twice",
    ),
    "inclination": _is("number", 1.2),
    "inertias": _is("array", (1e-5, 1e-5)),
    "interval": _is("array", (-0.005, 0.005)),
    "jumps": _is("array", (0.1, 0.2), *_VECTORS, "empty list", "empty tuple"),
    "key": _made("part", lambda: jax.random.key(0), "key"),
    "lengths": _is("array", (0.065, 0.065)),
    "limits": _made("part", jxr.design.Limits),
    "line": _is("flag", False),
    "linear": _is("number", 0.1),
    "links": _is("flag", True),
    "load": _is("function", None, "empty list", "empty tuple"),
    "locate": _is("flag", False),
    "lowered": _is("number", 0.01),
    "masses": _is("array", (0.045, 0.04)),
    "max_steps": _is("count", 64),
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
    "progress_meter": _is("part", None),
    "progress": _is("flag", False, "function", "class", "class of states"),
    "rate": _is("number", 2.0),
    "reverse": _is("flag", False),
    "rotation": _is("array", (1.0, 0.0, 0.0, 0.0)),
    "s": _is("number", 0.003),
    "sense": _is("count", 1),
    "shape": _made("contour", lambda: jxr.Circle(0.01)),
    # NaN says that a signal is not known there.
    "signal": _made("array", lambda: np.linspace(0.0, 0.1, 4)[:, None], "itself and NaN", "its last twice"),
    "skew": _is("number", 0.03),
    "smallest_radius": _is("positive", 2e-3),
    "smoothing": _is("not negative", 1e-3),
    "smoothness": _is("not negative", 4.0, "infinity"),
    "solver": _is("part", None),
    "spin": _is("choice", "free"),
    # As many as the finger has joints, which the controller alone does not know.
    "stepsize_controller": _is("part", None),
    "start": _is("array", (1.5, 1.7), *_VECTORS),
    "state": _made("state", lambda: planar()[1]),
    "stiffness": _is("number", 20.0),
    # Of a time that a run did not reach the states are NaN, and so is what is worked out of them.
    "states": _made("state", lambda: planar()[1], "NaN in it", "NaN in all of it", "one axis more in all"),
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
    "thickness": _is("positive", 0.01),
    "turn": _is("number", 10.0),
    "unit": _is("choice", "mm"),
    "values": _is("array", (0.5, 0.8), "three axes"),
    "view": _made("part", lambda: None),
    "which": _is("count", 0, "whole zero"),
}


def _constant(t: Any) -> float:
    """A function of time."""
    del t
    return 0.5


def _family(names: str, **changed: Argument) -> dict[str, dict[str, Argument]]:
    return dict.fromkeys(names.split(), changed)


_CLOUD, _BALL = _made("array", cloud), _made("surface", lambda: jxr.Sphere(0.02))
_ROUND = _made("contour", lambda: jxr.Circle(0.01))
_ANY_RUN = _made("run", planar_run, "run in space")
_RUN, _BODY = _made("run", planar_run), _made("contour", lambda: jxr.Ellipse(0.02, 0.014))
_SPATIAL = {
    "grasp": _made("grasp in space", lambda: spatial()[0]),
    "trajectory": _made("run in space", spatial_run),
}
_PATH = {"path": _made("path", lambda: folder() / "new" / "shape.csv"), "contour": _BODY}
# One number, or one for each of two fingers.
_EACH = _is("not negative", 0.006, "two numbers", "numbers of float32", "whole numbers", "its last twice")
# With three numbers as `start` it is for three fingers.
_EACH_OF_SOME = dataclasses.replace(_EACH, also=_EACH.also | {"three numbers"})
# Gains of a controller may be functions of time.
_EACH_IN_TIME, _EACH_OF_SOME_IN_TIME = (
    dataclasses.replace(each, also=each.also | {"function"}) for each in (_EACH, _EACH_OF_SOME)
)
# What is optional by itself: None is sensible where it is not the default, too.
_NO_FLAT = _is("positive", 0.1, "None")
# Its first numbers are the ends of a line, which may have none.
_PINCH = _made("grasp", lambda: pinch()[0], "None in it")
# What has a boundary that fingers may touch; nothing is between a shape of the plane and one of space.
_PARTS_TO_GRASP = (
    "circle",
    "endless line",
    "sphere",
    "endless plane",
    "object in the plane",
    "object in space",
)
# Of two joints.
_LIMITS = {
    "limits": _is("array", ((-3.0, 3.0), (-2.0, 2.0))),
    "torque_limits": _is("array", (0.5, 0.4), "two numbers", "empty list"),  # of a jaw that rests
}
# Where a parameter means something else than its name says elsewhere, or has another shape.
EXCEPTIONS: dict[str, dict[str, Argument]] = {
    **_family("Ellipse NeuralSupport NeuralCurvature SupportFunction", cells=_is("count", 64)),
    **_family("pinch ring pinch_ellipse ball_plate", gravity=_is("array", (0.0, -9.81))),
    **_family("MovedSurface", offset=_is("array", (0.01, 0.0, 0.0)), surface=_BALL),
    **_family("Hollow", surface=_BALL),
    **_family("loci", **_SPATIAL),
    **_family("link_clearance", trajectory=_RUN),
    **_family("contours phase pose poses responses animate", trajectory=_RUN),
    **_family("friction_demand overshoot peak_force settling_time tracking_error", run=_ANY_RUN),
    **_family(
        "fit_surface",
        points=_CLOUD,
        smoothing=_is("not negative", 0.02),
        smallest_radius=_is("positive", None, "None"),
        faces=_is("part", None),
    ),
    # As many of both are links: three, or seven.
    "mass_properties": {"shape": _made("contour", lambda: jxr.Circle(0.01), "sphere")},
    "uniform_object": {"contour": _ROUND},
    "uniform_solid": {"surface": _BALL},
    "grasp_points": {
        "object": _made("part", lambda: jxr.Circle(0.01), *_PARTS_TO_GRASP),
        "friction": _is("positive", 0.5),
    },
    "reach": {
        "grasp": _made("grasp", held_disc),
        "contacts": _is(
            "array",
            ((-0.02, 0.0), (0.02, 0.0)),
            "two numbers",
            "whole numbers",
            "numbers of float32",
            "its last left out",
        ),
        "pose": _is("array", (0.0, 0.08, 0.0), "three numbers"),
        "guess": _made("state", held_state),
        "elbow": _is("part", None, "one", "minus one", "whole zero"),
        "hold_object": _is("flag", True),
        "link_radius": _is("positive", 0.004),
    },
    "Finger": {
        "tip": _ROUND,
        "lengths": _is("array", (0.065, 0.065), "its last twice", "three numbers", "seven numbers"),
        "masses": _is("array", (0.045, 0.04), "its last twice", "three numbers", "seven numbers"),
        "link_radius": _is("positive", 0.004),
        **_LIMITS,
    },
    "Contact3": {"finger": _is("count", 0, "whole zero"), "surface": _is("count", 0, "whole zero")},
    "Contact": {"finger": _is("count", 0, "whole zero"), "contour": _is("count", 0, "whole zero")},
    "Finger3": {
        "axes": _is("array", ((0, 0, 1.0), (0, 1.0, 0))),
        "offsets": _is("array", ((0.05, 0, 0), (0.05, 0, 0))),
        "tip": _BALL,
        "base": _is("array", (0.0, 0.0, 0.0), "three numbers"),
        "centres": _is("array", ((0.02, 0, 0), (0.02, 0, 0))),
        "inertias": _is("array", 2 * (((1e-5, 0, 0), (0, 1e-5, 0), (0, 0, 1e-5)),)),
        "link_radius": _is("positive", 0.004),
        "armature": _is("not negative", (1e-4, 2e-4), "two numbers"),
        **_LIMITS,
    },
    "FreeObject3": {"inertia": _is("positive", 1e-5, "three numbers", "square")},
    "Grasp": {"object": _made("object", lambda: planar()[0].object)},
    "Jaw": {
        "contour": _ROUND,
        # Of a jaw that rests, which has no directions.
        "limits": _is("array", ((-3.0, 3.0), (-2.0, 2.0)), "empty rows", "empty list", "empty tuple"),
        "torque_limits": _is("array", (0.5, 0.4), "two numbers", "empty list", "empty tuple"),
    },
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
        "cosines": _is("array", (0.0, 1e-4), "empty list", "empty tuple", "its last left out"),
        "sines": _is("array", (0.0, 1e-4), "its last left out"),
    },
    "Turning": {"centre": _is("array", (0.0, 0.0, 0.0), "three numbers")},
    **_family(
        "multipliers accelerations", ts=_is("number", 0.0), formulation=_made("part", jxr.CSM, "method")
    ),
    "torques": {"ts": _is("number", 0.0)},
    "wrenches": {"ts": _is("number", 0.0)},
    "Impulse": {
        "impulse": _is("array", (0.0, 1e-4), "two numbers", "three numbers", "its last twice"),
        "time": _is("number", 0.1),
        # Three numbers beside an impulse in space, of three numbers.
        "angular": _is("number", 1e-6, "three numbers"),
        "point": _is("array", (0.0, 0.01), "two numbers", "three numbers", "its last twice"),
    },
    "resume": {"run": _ANY_RUN},
    "strike": {"blow": _made("part", lambda: jxr.loads.Impulse((0.0, 1e-4), 0.1))},
    "pinch_balance": {
        "ts": _is("number", 0.0),
        "grasp": _PINCH,
        "states": _made("state", pinch_state, "NaN in it", "NaN in all of it"),
    },
    "press_balance": {"ts": _is("number", 0.0)},
    "roll": {
        "tip": _BALL,
        "object": _made("surface", jxr.Plane),
        "velocity": _made("function", lambda: rolling),
        "ts": _is("array", (0.0, 0.1, 0.2), *_VECTORS),
        "at_tip": _is("array", (0.0, 0.0, -0.02)),
        "at_object": _is("array", (0.0, 0.0, 0.0)),
        "spin": _is("function", None),
    },
    "simulate": {
        "ts": _is("count", 4, "two numbers", "numbers of float32"),
        "t1": _is("positive", 0.02),
        "formulation": _made("part", jxr.Index1, "method"),
        "record": _is("part", (), "empty list", "empty tuple"),
    },
    "why": {
        "state": _made("state", lambda: planar()[1], "run in the plane"),
        "ts": _is("count", 4, "two numbers", "three numbers", "seven numbers", "numbers of float32"),
        "formulation": _made("part", jxr.Index1, "method"),
        "record": _is("part", (), "empty list", "empty tuple"),
    },
    "identify": {
        # The scene is made before it is traced: it is kept, and would keep tracers.
        "make": _made("function", lambda: (planar(), identified)[1]),
        "guess": _is("part", {"damping": 0.005}),
        "ts": _is("array", (0.1, 0.2)),
        "measured": _is("any array", ((0.1, 0.2), (0.1, 0.2))),
        "noise": _is("positive", 0.1),
        "steps": _is("count", 1),
        "observe": _is("function", None),
    },
    "sweep": {
        "formulation": _made("part", jxr.Index1, "method"),
        "record": _is("part", (), "empty list", "empty tuple"),
        "ts": _is("count", 1, "two numbers", "numbers of float32"),
        "make": _made("function", lambda: scene_of),
        # Runs with a number that means nothing carry their code.
        "parameters": _made("any array", lambda: np.array([0.004, 0.006]), "empty tuple", *_NOWHERE),
        "keep": _made("function", lambda: kept),
        "chunk": _is("count", 2),
        "resume": _made("folder", lambda: folder() / "runs"),
        "store": _is("folder", None),
        "client": _is("part", None),
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
    "Limits": {"flat": _NO_FLAT},
    # Numbers of controllers may be functions of time.
    "Press": {
        "force": _is("number", 0.5, "function"),
        "radius": _is("positive", 0.01, "function"),
        "damping": _is("not negative", 0.006, "function"),
        "target": _is("array", (0.0, 0.1), "two numbers", "three numbers", "its last twice", "function"),
    },
    "Opposition": {
        "beta": _is("not negative", 20.0, "function"),
        "damping": _EACH_OF_SOME_IN_TIME,
        "alpha": _EACH_OF_SOME_IN_TIME,
        "start": _is("array", (1.5, 1.7), *_VECTORS, "function"),
    },
    "Carry": {
        "beta": _is("not negative", 12.0, "function"),
        "damping": _EACH_IN_TIME,
        "stiffness": _is("positive", 200.0, "function"),
        "home": _is("array", ((0.03, 0.0, 0.0), (-0.03, 0.0, 0.0)), "square", "function"),
        "position": _is("array", (0.0, 0.0, 0.1), "three numbers", "function"),
        "turn": _is("array", (0.0, 0.0, 0.3), "three numbers", "function"),
        "force": _is("array", (0.0, 0.0, 0.5), "three numbers", "function"),
    },
    "Integral": {
        "law": _is("function", None, "None"),
        "targets": _made("part", lambda: {"x": 0.03, "tilt": 0.1}),
        "gain": _EACH_OF_SOME,
    },
    "Sampled": {
        "law": _is("function", None, "None"),
        "first": _is("number", 0.0),
        "angle_noise": _is("not negative", 1e-4),
        "rate_noise": _is("not negative", 0.1),
        "key": _made("part", lambda: jax.random.key(0), "key"),
    },
    "with_payload": {
        "link": _is("count", 1, "whole zero"),
        "at": _is("number", 0.03),
        "inertia": _is("not negative", 1e-6),
    },
    "with_": {
        "damping": _is("not negative", 0.006, "function"),
        "gravity": _is("array", (0.0, -9.81), "None"),
    },
    "Push": {
        "force": _is("array", (0.2, 0.0), "three numbers", "its last twice"),
        "start": _is("number", 0.1),
        "point": _is("array", (0.0, 0.01), "three numbers", "its last twice"),
    },
    "Spring": {
        "point": _is("array", (0.0, 0.01), "three numbers", "its last twice"),
        "damping": _is("number", 0.1),
    },
    "Steps": {"times": _is("array", (0.5,))},
    # As many of both are a ramp: two, three or seven.
    "Ramps": {
        "times": _is("array", (0.0, 1.0), "three numbers", "seven numbers"),
        "values": _is("array", (0.5, 0.8), "three axes", "three numbers", "seven numbers"),
    },
    # What a function of time gives is looked at where it is used: a run gives states.
    "Declared": {"function": _made("function", lambda: _constant, "run in the plane", "run in space")},
    "ClosedLoop": {
        "make": _made("function", lambda: lifted, "run in the plane", "run in space"),
        "objective": _is("function", {"overshoot": 1.0}),
        "formulation": _made("part", jxr.Index1, "method"),
        "record": _is("part", (), "empty list", "empty tuple"),
    },
    "Fair": {"weight": _is("positive", 0.01)},
    "Firmness": {
        "make": _made("function", lambda: lifted, "run in the plane", "run in space"),
        "measure": _is("choice", "stiffness"),
        "neutral": _is("count", 1, "whole zero"),
        "scale": _is("positive", 1.0),
    },
    "optimise_fingertip": {
        "tip": _BODY,
        "steps": _is("count", 10),
        "symmetric": _is("flag", False),
        "starts": _is("count", 1),
        "seed": _is("count", 1, "whole zero"),
        "optimiser": _is("part", None),
        "mode": _is("choice", "auto"),
        "checkpoint": _made("path", lambda: folder() / "checkpoint.npz", "text", "number as text", "path"),
    },
    "ShapeTransform": {"tip": _BODY, "symmetric": _is("flag", False)},
    "value_and_grad": {
        "function": _made("function", lambda: jnp.sum, "run in the plane", "run in space"),
        "mode": _is("choice", "auto"),
        "has_aux": _is("flag", False),
    },
    "Moved": {"contour": _ROUND},
    "crossings": {"points": _made("array", dots, "empty rows")},
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
        "function": _made("function", lambda: bowl),
        "domain": _is("array", ((-1.0, 1.0), (-1.0, 1.0))),
        "periodic": _is("part", (False, False), "flags"),
    },
    "Extruded": {"contour": _ROUND},
    # What it gives is looked at where the surface is used, as that of any function: a run gives states.
    "Implicit": {"function": _made("function", lambda: ball, "run in the plane", "run in space")},
    "Parametric": {
        "function": _made("function", lambda: egg),
        "domain": _is("array", (0.0, 6.283185307179586)),
        "origin": _is("number", 0.5),
        "smoothness": _is("positive", 4.0, "infinity"),
        "cells": _is("count", 256),
    },
    "adaptive_map": {
        "outcome": _made("function", lambda: halved),
        "grid": _made("part", gridded),
        "levels": _is("count", 1, "whole zero"),
        "tolerance": _is("not negative", 0.1),
        "chunk": _is("count", 4),
    },
    "columns": {
        "damping": _is("any array", (0.1, 0.2), "whole zero", *_FLAGS),
        "force": _is("any array", 0.5, *_FLAGS),
    },
    "sobol": {
        "count": _is("count", 4),
        "seed": _is("count", 0, "whole zero"),
        "beta": _is("array", (0.0, 1.0), "two numbers"),
    },
    "measures": {"names": _is("choice", "result")},
    **_family(
        "parameter_map map_page",
        parameters=_made("part", gridded),
        # Of runs that failed there are none: the map is blank there.
        values=_made("any array", lambda: gridded().a, "flags", "itself and NaN", "itself and infinity"),
        x=_is("choice", "a"),
        y=_is("choice", "b"),
        at=_is("part", None, "dict"),
        label=_is("text", "height"),
        title=_is("text", "Map"),
        path=_made("path", lambda: folder() / "map.html"),
    ),
    "save": {"path": _made("folder", lambda: folder() / "saved.npz"), "value": _is("anything", 1.0)},
    "load": {
        "path": _made("path", lambda: written("disc.npz")),
        "own": _is("part", (), "empty list", "empty tuple"),
    },
    "vector_field": {
        "grasp": _made("grasp", lambda: planar()[0], "grasp in space"),
        "formulation": _made("part", jxr.Index1, "method"),
    },
    "Patch": {"points": _made("array", tube), "periodic": _is("part", (True, False), "flags")},
    "SplineSurface": {"origin": _is("array", (0.0, 0.0, 0.0), "three numbers")},
    "metres_per": {"unit": _is("choice", "mm")},
    "Superellipsoid": {"exponent": _is("number", 4.0)},
    "read_points": {
        "path": _made("path", lambda: written("disc.csv")),
        "columns": _is("part", (0, 1)),
        "fill": _is("flag", False),
        "pixel": _is("part", None),
    },
    "read_cloud": {
        "path": _made("path", lambda: written("cloud.npy")),
        "columns": _is("part", (0, 1, 2)),
        "normals": _is("part", None),
    },
    "write_outline": {**_PATH, "tolerance": _is("positive", 1e-4)},
    "read_silhouette": {"pixel": _is("positive", 1e-3)},
    "read_mesh": {"path": _made("path", lambda: written("disc.stl"))},
    "load_hand": {
        "path": _made("path", lambda: robot()),
        "tips": _made("surface", lambda: jxr.Sphere(0.01)),
        "held": _is("part", {}, "dict"),
        "position": _is("array", (0.0, 0.0, 0.1), "three numbers"),
    },
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
        **{"path": _made("path", lambda: folder() / "new.gif"), "until": _is("not negative", 0.01)},
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
    "plotting.contact_geometry": {"contact": _is("count", 0, "whole zero")},
    "plotting.loci": {**_SPATIAL, "folder": _made("folder", lambda: folder() / "plots")},
    "page": {**_SPATIAL, "path": _made("path", lambda: folder() / "new.html"), "title": _is("text", "Page")},
    "phase": {"rest": _made("state", lambda: planar()[1])},
    # Each time shows the saved state nearest to it.
    "poses": {
        "times": _is(
            "array", (0.0, 0.01), "three numbers", "seven numbers", "its last twice", "its last left out"
        ),
        "forces": _is("flag", False),
    },
    "responses": {"folder": _made("folder", lambda: folder() / "plots")},
    "pinch": {"s": _is("array", (0.004, -0.003)), "damping": _EACH_IN_TIME, "alpha": _EACH_IN_TIME},
    "pinch_ellipse": {"s": _is("array", (0.004, -0.003)), "damping": _EACH_IN_TIME, "alpha": _EACH_IN_TIME},
    "ball_plate": {"s": _is("array", (0.004, -0.003)), "damping": _EACH_IN_TIME, "alpha": _EACH_IN_TIME},
    "pinch_object": {
        "object": _made("part", lambda: jxr.scenes.rectangle(), "object in the plane", "object in space")
    },
    "ring": {
        "count": _is("count", 3),
        "damping": _EACH_OF_SOME_IN_TIME,
        "alpha": _EACH_OF_SOME_IN_TIME,
    },
    "pivoted": {"s": _is("number", 0.003)},
    "roller": {"contour": _BODY, "force": _is("number", 5.0), "period": _is("positive", 3.0)},
    "incline": {"gravity": _is("not negative", 9.81), "slope": _is("number", 0.3)},
    "rattleback": {
        "gravity": _is("not negative", 9.81),
        "spin": _is("number", -5.0),
        "inertia": _is("array", (2e-4, 1.6e-3, 1.7e-3)),
    },
    "tube": {"gravity": _is("not negative", 9.81), "spin": _is("number", 4.0), "bore": _is("positive", 0.2)},
    "turntable": {
        "gravity": _is("not negative", 9.81),
        "position": _is("array", (0.3, 0.1)),
        "velocity": _is("array", (0.2, -0.4)),
        "spin": _is("number", 0.7),
    },
    "wheel": {
        "gravity": _is("not negative", 9.81),
        "tube": _is("positive", 0.005),
        "radius": _is("positive", 0.1),
    },
    "pinch3d": {
        "tips": _made("surface", lambda: jxr.Sphere(0.01)),
        "object": _made("part", lambda: jxr.scenes.cuboid(), "object in space"),
        "gravity": _is("array", (0.0, 0.0, -9.81), "three numbers", "square"),  # of three bodies
        "damping": _EACH_IN_TIME,
    },
    "tripod": {
        "fingers": _is("count", 3),
        "tips": _made("surface", lambda: jxr.Sphere(0.01)),
        "object": _made("part", lambda: jxr.scenes.spheroid(), "object in space"),
        "gravity": _is("array", (0.0, 0.0, -9.81), "three numbers"),
        "damping": _EACH_OF_SOME_IN_TIME,
    },
    "with_tip": {"finger": _is("count", 0, "whole zero"), "tip": _ROUND},
    "with_contacts": {"contacts": _made("contact", jxr.Contact)},
    "on_contour": {"s": _is("any array", 0.001, *_NOWHERE)},
    "on_surface": {"at": _is("array", (0.0, 0.0, 0.01), "three numbers", "square", "itself, one axis more")},
    "near_surface": {
        "point": _is("array", (0.0, 0.01, 0.02), "three numbers", "square", "itself, one axis more"),
        "guess": _is("array", (0.0, 0.01, 0.02), "three numbers", "square", "itself, one axis more"),
    },
    "margin": {"contour": _ROUND, "s": _is("any array", 0.001)},
    **_family(
        "pinch_statics rectangle_hessian",
        grasp=_PINCH,
        s=_is("array", (0.0, 0.0), "empty rows", "itself, one axis more"),
    ),
    "pinch_rest": {
        "grasp": _made("grasp", lambda: pinch()[0].with_(alpha=0.0), "None in it"),
        "state": _made("state", pinch_state),
    },
    "assess": {"tolerance": _is("not negative", 1e-7)},
}
