"""The numbers of every scene: all fields of grasp and state.

Two records of a scene: as it asks for its contacts to be closed, with the guess of its state, which costs
nothing and no rounding; and the state in which they are closed (`closed_states`, which pictures start from).
"""

import inspect
import json
from typing import Any

import numpy as np

import jaxroll as jxr
from jaxroll import geometry
from tests.recorded import runs
from tests.recorded.compare import described, path_of

# Scenes whose contacts are closed by `close`; of the others the state is by formulas.
CLOSED = ("pivoted", "pinch", "pinch_ellipse", "ball_plate", "ring", "roller", "pinch3d")
# Those that are closed by default: the others take longer to trace.
QUICKLY = ("pivoted", "pinch")


def scene_names() -> list[str]:
    """Every public function of `jaxroll.scenes` that needs no argument."""
    scenes = {name: each for name, each in vars(jxr.scenes).items() if inspect.isfunction(each)}
    needed = lambda each: any(  # noqa: E731
        x.default is x.empty for x in inspect.signature(each).parameters.values()
    )
    return sorted(name for name, each in scenes.items() if name[0] != "_" and not needed(each))


def _egg() -> Any:
    return geometry.Spline(
        np.stack([0.02 * np.cos(_ROUND) + 0.004 * np.cos(2.0 * _ROUND), 0.015 * np.sin(_ROUND)], axis=-1)
    )


_ROUND = 2.0 * np.pi * np.arange(24) / 24
# Calls with other arguments than the defaults, all of them.
VARIED = {
    "pivoted": {"s": 0.001, "base": (0.01, 0.02), "pivot": (0.04, 0.1), "gravity": (0.0, -9.81)},
    "rectangle": {"width": 0.02, "height": 0.07, "mass": 0.03},
    "pinch": {"s": (0.001, 0.002), "beta": 3.0, "alpha": (0.1, 0.2), "damping": 0.01, "friction": 0.4},
    "pinch_ellipse": {"a": 0.02, "b": 0.03, "mass": 0.04, "s": (0.002, 0.001), "gravity": (1.0, 2.0)},
    "ball_plate": {"radius": 0.02, "beta": 7.0},
    "ring": {"count": 2, "beta": 3.0, "alpha": 0.1, "damping": 0.2, "gravity": (1.0, 2.0)},
    "roller": {"force": 2.0, "travel": 0.01, "period": 2.0, "mass": 0.5},
    "cuboid": {"width": 0.02, "height": 0.03, "depth": 0.04, "mass": 0.5},
    "pinch3d": {
        "gravity": (1, 2, 3), "beta": 2.0, "damping": (1.0, 2.0), "spin": "prevented", "friction": 0.3,
    },
    "spheroid": {"radius": 0.01, "height": 0.04, "mass": 0.5},
    "tripod": {"fingers": 4, "beta": 2.0, "damping": 0.1, "stiffness": 30.0, "gravity": (1, 2, 3)},
}  # fmt: skip


def numbers(name: str) -> dict[str, Any]:
    """Grasp and state with the defaults and, where there are some in `VARIED`, with other arguments."""
    calls = {"defaults": {}} | ({"varied": VARIED[name]} if name in VARIED else {})
    if name == "pinch3d":
        calls["larger"] = {"size": 2.0}
    if name in ("pinch", "roller"):
        body = jxr.FreeObject(_egg(), 0.02, 1e-6)
        calls["egg"] = {"object": body} if name == "pinch" else {"contour": body.contours[0]}
    found = {}
    with runs.not_closed():
        for call, options in calls.items():
            made = getattr(jxr.scenes, name)(**options)
            grasp, state = made if isinstance(made, tuple) else (made, None)
            found[call] = {"state": described(state)} | described(grasp)
    if name == "roller":
        push = getattr(jxr.scenes, name).__globals__["Conveyor"](5.0, 0.03, 3.0, 0.2)
        found["pushed"] = {str(t): described(push(t, None, None, None)[0]) for t in (0.0, 0.4, 1.0)}
    return found


def pinched() -> dict[str, Any]:
    """An egg that is held where `pinch_object` finds that it can be, by default and otherwise."""
    body = jxr.FreeObject.uniform(_egg(), density=20.0)
    calls = {"defaults": {}, "varied": {"force": 2.0, "friction": 0.4, "gravity": (0.0, -1.0)}}
    found = {}
    for call, options in calls.items():
        grasp, state = jxr.scenes.pinch_object(body, **options)
        hand = [
            {name: getattr(finger, name) for name in ("lengths", "masses", "inertias", "centres", "base")}
            for finger in grasp.fingers
        ]
        places = [{"s_object": c.s_object, "friction": c.friction, "sense": c.sense} for c in grasp.contacts]
        gains = {name: getattr(grasp.controller, name) for name in ("beta", "damping", "alpha")}
        scene = {"q": state.q, "hand": hand, "places": places, "gains": gains}
        found[call] = described(scene | {"object": grasp.object, "gravity": grasp.gravity})
    return found


def held_at() -> dict[str, Any]:
    """Where two fingers would hold objects of one face and of several, in the plane and in space."""
    pair = [jxr.Circle(0.01), jxr.Ellipse(0.012, 0.006).moved((0.03, 0.004), 0.4)]
    objects = {
        "egg": (_egg(), 0.5),
        "egg with little friction": (_egg(), 0.05),
        "two": (pair, 0.3),
        "plate": (jxr.scenes.rectangle(0.02, 0.07), 0.5),
        "ellipsoid": (jxr.Ellipsoid(0.03, 0.02, 0.01), 0.2),
        "cuboid": (jxr.scenes.cuboid(0.02, 0.03, 0.04), 0.4),
    }
    return {
        name: described(jxr.grasp_points(each, friction, count=5))
        for name, (each, friction) in objects.items()
    }


def closed(names: tuple[str, ...] = CLOSED) -> dict[str, Any]:
    """The states in which contacts are closed."""
    found = {}
    for name in names:
        _, state = getattr(jxr.scenes, name)()
        found[name] = {part: np.asarray(getattr(state, part)).tolist() for part in "qvs"}
    return found


def kept_states() -> dict[str, Any]:
    """The recorded states in which contacts are closed."""
    return json.loads(path_of("closed_states").read_text())
