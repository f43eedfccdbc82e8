"""Every argument of every public class and function of bodies, contacts, control, stability and design.

A table has one valid call of each; every argument in turn is replaced by every member of a list of bad
values, and must be refused in one sentence unless the table says that the value means something.
"""

import dataclasses
import functools
import inspect
import os
import re
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll import _fields, commands, control, design, loads, stability
from jaxroll._mechanics import AbstractController
from jaxroll._results import check_positive
from jaxroll.control import _user, Sensed, UserController
from jaxroll.design._limits import sampled
from jaxroll.design._minimise import _restored, check_checkpoint

TIP, BALL = jxr.Circle(0.01), jxr.Sphere(0.01)
FINGER = jxr.Finger([0.06, 0.06], [0.04, 0.04], TIP)
CONTOUR = jxr.Catenary(0.01, (-0.01, 0.01))
BODY = jxr.PivotedObject(CONTOUR, 1e-5)
CHAIN = [(0, 0.06, 0), (0, 0.06, 0)]
FINGER3 = jxr.Finger3([(1, 0, 0), (0, 0, 1)], CHAIN, [0.04, 0.04], BALL)
BALL3 = jxr.FreeObject3(BALL, 0.05, 8e-6)
OPPOSITION = {"beta": 20.0, "damping": 0.006, "alpha": 0.001, "start": (1.5, 1.7)}
PLANE = jxr.Grasp(BODY, FINGER, jxr.Contact(), controller=control.Press(0.5, 0.01, 0.006, target=(0, 0.1)))
PINCH = jxr.Grasp(
    jxr.FreeObject([jxr.Line(), jxr.Line()], 0.02, 1e-5),
    [FINGER, FINGER],
    [jxr.Contact(finger=0), jxr.Contact(finger=1, contour=1, sense=-1)],
    controller=control.Opposition(**OPPOSITION),
    gravity=(0, -9.81),
)
SPACE = jxr.Grasp(
    BALL3,
    [FINGER3, FINGER3],
    [jxr.Contact3(finger=i) for i in (0, 1)],
    controller=control.Opposition(**OPPOSITION),
)
STATE = jxr.State([0.1, 1.0, 0.5], [0, 0, 0], [0])
ALONE = PINCH.with_(gravity=(0, 0), alpha=0.0)
PINCHED = jxr.State(np.zeros(7), np.zeros(7), np.zeros(2))

BAD = {
    "text": "0.1",
    "bytes": b"0.1",
    "nothing": None,
    "ragged": [1.0, [2.0]],
    "complex": 1j,
    "complex array": jnp.array([1j, 1j]),
    "true": True,
    "flags": [True, False],
    "nan": np.nan,
    "inf": np.inf,
    "nan array": [np.nan, 1.0],
    "wrong shape": np.ones((5, 7)),
    "empty": [],
    "object": object(),
    "dict": {"a": 1.0},
    "set": {1.0},
    "texts": ["a", "b"],
    "nones": (None, None),
    "class": jxr.Circle,
    "contour": TIP,
    "surface": BALL,
    "finger": FINGER,
    "grasp": PLANE,
    "state": STATE,
    "module": np,
    "function of nothing": lambda: 0.0,
}
ONE_NUMBER = {"number": 0.5}
NOT_POSITIVE = {"zero": 0.0, "negative": -1e-3}
AXES = {"of one axis": (0.1,), "of four": (0, 0, 0, 0)}


def functions_of(count):
    """A function of so many arguments, which nothing calls."""
    return (lambda a: a, lambda a, b: a, lambda a, b, c: a, lambda a, b, c, d: (a,))[count - 1]


# Of two joints.
LIMITED = {"limits": [(-1.0, 1.0), (0.0, 2.0)], "torque_limits": [0.1, 0.1]}
LINKED = {"link_radius": 0.004}
NO_LIMITS = {"limits": {"nothing"}, "torque_limits": {"nothing"}}
FALLING = {"falling": [(-1.0, 1.0), (2.0, 0.0)], "level": [(-1.0, 1.0), (0.5, 0.5)]}

# Of each class: a valid call, what may be given of the bad values, and what more must be refused.
CLASSES = {
    jxr.Finger: (
        {"lengths": [0.1, 0.1], "masses": [0.1, 0.1], "tip": TIP, "base": (0, 0), "centres": (0, 0)}
        | {"inertias": [1e-4, 1e-4], **LIMITED, **LINKED},
        {"tip": {"contour"}, "centres": {"nothing"}, "inertias": {"nothing"}, "link_radius": {"nothing"}}
        | NO_LIMITS,
        {
            name: {"not positive": [0.1, -0.1], "zero": [0.0, 0.1]}
            for name in ("lengths", "masses", "inertias", "torque_limits")
        }
        | {"limits": FALLING, "link_radius": NOT_POSITIVE},
    ),
    jxr.Finger3: (
        {"axes": [(1, 0, 0), (0, 0, 1)], "offsets": CHAIN, "masses": [0.1, 0.1], "tip": BALL}
        | {"base": (0, 0, 0), "rotation": (1, 0, 0, 0), "centres": CHAIN, "inertias": [np.eye(3), np.eye(3)]}
        | {"armature": [1e-4, 0.0]}
        | LIMITED
        | LINKED,
        {"tip": {"surface"}, "centres": {"nothing"}, "inertias": {"nothing"}}
        | {"armature": {"nothing"}, "link_radius": {"nothing"}}
        | NO_LIMITS,
        {
            "armature": {"negative": [1e-4, -1e-4], "one": [1e-4]},
            "axes": {"no length": [(1, 0, 0), (0, 0, 0)], "too long": [(1e200, 0, 0), (0, 0, 1)]},
            "rotation": {"no length": (0, 0, 0, 0)},
            "masses": {"zero": [0.1, 0.0]},
            "link_radius": NOT_POSITIVE,
            "limits": FALLING,
            "torque_limits": {"zero": [0.1, 0.0]},
            "inertias": {
                "not symmetric": [np.eye(3), np.eye(3) + np.eye(3, k=1)],
                "not definite": [np.eye(3), np.diag([1.0, 1.0, -1.0])],
                "singular": [np.eye(3), np.zeros((3, 3))],
            },
        },
    ),
    jxr.Jaw: (
        {"contour": TIP, "mass": 0.1, "directions": (0.0, 1.0), "base": (0, 0), "angle": 0.0}
        | dict.fromkeys(LIMITED),
        {"contour": {"contour"}, "directions": {"empty"}} | NO_LIMITS,
        {
            "mass": NOT_POSITIVE,
            "limits": FALLING,
            "torque_limits": {"zero": [0.1, 0.0]},
            "directions": {"three": (0, 1, 2), "parallel": (0.3, 0.3 + np.pi)},
        },
    ),
    jxr.Stage: (
        {"surface": BALL, "motion": jxr.Turning(1.0), "base": (0, 0, 0), "rotation": (1, 0, 0, 0)},
        {"surface": {"surface"}, "motion": {"nothing"}},
        {"rotation": {"no length": (0, 0, 0, 0)}, "motion": {"of two": functions_of(2)}},
    ),
    jxr.Turning: (
        {"rate": 1.0, "axis": (0, 0, 1), "centre": (0, 0, 0)},
        {},
        {"axis": {"no length": (0, 0, 0), "too long": (1e200, 0, 0)}},
    ),
    jxr.PivotedObject: (
        {"contours": [CONTOUR, TIP], "inertia": 1e-5, "pivot": (0, 0), "mass": 0.1, "centre": (0, 0)},
        {"contours": {"contour"}, "mass": {"nothing"}},
        {"inertia": NOT_POSITIVE, "mass": NOT_POSITIVE, "contours": {"mixed": [TIP, BALL]}},
    ),
    jxr.FreeObject: (
        {"contours": CONTOUR, "mass": 0.1, "inertia": 1e-5},
        {"contours": {"contour"}},
        {"inertia": NOT_POSITIVE, "mass": NOT_POSITIVE},
    ),
    jxr.FreeObject3: (
        {"surfaces": BALL, "mass": 0.1, "inertia": (1.0, 2.0, 3.0), "outline": (1, 1, 1)},
        {"surfaces": {"surface"}, "outline": {"nothing"}},
        {
            "mass": NOT_POSITIVE,
            "inertia": NOT_POSITIVE | {"not symmetric": np.eye(3) + np.eye(3, k=1), "one": (1.0, -1.0, 1.0)},
            "outline": {"negative": (1, -1, 1)},
        },
    ),
    jxr.Grasp: (
        {"object": BODY, "fingers": [FINGER], "contacts": [jxr.Contact()], "controller": PLANE.controller}
        | {"gravity": (0, -9.81), "load": loads.Drag(0.1)},
        {"fingers": {"finger"}, "controller": {"nothing"}, "gravity": {"nothing"}}
        | {"load": {"nothing", "empty"}},
        {
            "object": {"of space": BALL3},
            "fingers": {"of space": [FINGER3], "one of space": [FINGER, FINGER3]},
            "contacts": {
                "of space": [jxr.Contact3()],
                "both": [jxr.Contact(), jxr.Contact3()],
                "no such finger": [jxr.Contact(finger=1)],
                "no such contour": [jxr.Contact(contour=1)],
                "past the end": [jxr.Contact(s_object=0.02)],
            },
            "controller": {
                "class": control.Press,
                "of three": functions_of(3),
                "of two fingers": control.Opposition(**OPPOSITION),
                "of space": control.Press(1.0, 1.0, 1.0, target=(0, 0, 0)),
                "number": 1.0,
            },
            "gravity": ONE_NUMBER | {"of space": (0, 0, -9.81), "of three": np.zeros((3, 2))},
            "load": ONE_NUMBER
            | {
                "class": loads.Drag,
                "of two": functions_of(2),
                "of space": loads.Push((0, 0, 1), 0.1, 0.1),
                "one of two": [loads.Drag(0.1), functions_of(2)],
            },
        },
    ),
    jxr.State: (
        {"q": [0, 1, 2], "v": np.zeros(3), "s": jnp.zeros(1), "memory": [0.5]},
        {name: {"nan array", "wrong shape", "empty"} for name in "qvs"}
        | {"memory": {"nan array", "wrong shape", "empty", "nothing"}},
        {name: ONE_NUMBER for name in (*"qvs", "memory")},
    ),
    jxr.Contact: (
        {"s_tip": 0.0, "s_object": 0.0, "finger": 0, "contour": 0, "sense": -1, "friction": 0.5},
        {"friction": {"nothing"}},
        {
            "finger": {"fraction": 0.5, "float": 0.0, "negative": -1},
            "contour": {"fraction": 0.5, "float": 0.0, "negative": -1},
            "sense": {"zero": 0, "float": 1.0, "two": 2},
            "friction": NOT_POSITIVE,
        },
    ),
    jxr.Contact3: (
        {"finger": 0, "surface": 0, "spin": "free", "line": False, "friction": 0.5},
        {"friction": {"nothing"}, "line": {"true"}},
        {
            "finger": {"fraction": 0.5, "float": 0.0, "negative": -1},
            "surface": {"fraction": 0.5, "float": 0.0, "negative": -1},
            "line": {"one": 1},
            "friction": NOT_POSITIVE,
        },
    ),
    control.Passive: ({}, {}, {}),
    control.Press: (
        {"force": 0.5, "radius": 0.01, "damping": 0.006, "target": (0, 0.1)},
        {},
        {
            "force": {"of two": functions_of(2), "returns two": lambda t: (t, t)},
            "radius": NOT_POSITIVE | {"returns text": lambda t: "wide"},
            "damping": {"returns nothing": lambda t: None},
            "target": {"of one axis": (0.1,), "of four": (0, 0, 0, 0), "returns one": lambda t: t},
        },
    ),
    control.Opposition: (
        OPPOSITION,
        {},
        {
            "beta": {"of two": functions_of(2), "returns two": lambda t: (t, t)},
            "start": {"one": (1.5,), "returns one": lambda t: t},
            "damping": {"three": (1, 2, 3), "returns a flag": lambda t: t > 0},
            "alpha": {"three": (1, 2, 3), "returns rows": lambda t: ((t, t), (t, t))},
        },
    ),
    control.Carry: (
        {"beta": 12.0, "damping": 0.02, "stiffness": 200.0, "home": [(0.03, 0, 0), (-0.03, 0, 0)]}
        | {"position": (0, 0, 0.1), "turn": (0, 0, 0.2), "force": (0, 0, 1)},
        {},
        {
            "beta": {"of two": functions_of(2), "returns two": lambda t: (t, t)},
            "stiffness": NOT_POSITIVE | {"returns text": lambda t: "stiff"},
            "damping": {"three": (1, 2, 3), "returns a flag": lambda t: t > 0},
            "home": {"one": [(0.03, 0, 0)], "of the plane": [(1, 0), (0, 1)], "returns one": lambda t: t},
            "position": AXES | {"returns one": lambda t: t},
            "turn": AXES | ONE_NUMBER,
            "force": AXES | {"of the plane": (0, 1)},
        },
    ),
    control.Integral: (
        {"law": None, "targets": {"x": 0.03, "tilt": 0.1}, "gain": 20.0},
        {"law": {"nothing"}},
        {
            "law": {"sampled": control.Sampled(None, 0.001)},
            "targets": {"unknown": {"width": 0.1}, "none": {}, "text": {"x": "a"}, "numbered": {0: 0.1}},
            "gain": {"three": (1, 2, 3)},
        },
    ),
    control.Sampled: (
        {"law": None, "period": 0.001, "first": 0.0, "angle_noise": 1e-4, "rate_noise": 0.1}
        | {"key": jax.random.key(0)},
        {"law": {"nothing"}, "angle_noise": {"nothing"}, "rate_noise": {"nothing"}, "key": {"nothing"}},
        {
            "law": {"sampled": control.Sampled(None, 0.001)},
            "period": NOT_POSITIVE,
            "angle_noise": {"negative": -1.0},
            "rate_noise": {"negative": -1.0},
            "key": {"number": 3, "keys": jax.random.split(jax.random.key(0), 2)},
        },
    ),
    loads.Push: (
        {"force": (0.2, 0), "start": 0.1, "duration": 0.05, "point": (0, 0.01)},
        {"point": {"nothing"}},
        {"duration": NOT_POSITIVE, "force": AXES, "point": AXES},
    ),
    loads.Impulse: (
        {"impulse": (0, 1e-4), "time": 0.1, "angular": 1e-6, "point": (0, 0.01)},
        {"angular": {"nothing"}, "point": {"nothing"}},
        {"impulse": AXES, "point": AXES, "angular": {"of space": (0, 0, 1e-6)}},
    ),
    loads.Drag: ({"linear": 0.1, "angular": 1e-5}, {}, {}),
    loads.Spring: (
        {"stiffness": 20.0, "anchor": (0, 0.1), "point": (0, 0.01), "length": 0.05, "damping": 0.1},
        {"point": {"nothing"}, "length": {"nothing"}},
        {"anchor": AXES, "point": AXES | {"of space": (0, 0, 0)}, "length": NOT_POSITIVE},
    ),
    commands.Steps: (
        {"times": [0.5], "values": [0.5, 0.8]},
        {},
        {"times": {"falling": [0.5, 0.4], "twice": [0.5, 0.5]}, "values": {"three": (1, 2, 3)} | ONE_NUMBER},
    ),
    commands.Ramps: (
        {"times": [0.0, 1.0], "values": [0.5, 0.8]},
        {},
        {"times": {"falling": [0.5, 0.4], "twice": [0.5, 0.5]}, "values": {"three": (1, 2, 3)} | ONE_NUMBER},
    ),
    commands.Declared: (
        {"function": functions_of(1), "jumps": [0.1, 0.2]},
        {"jumps": {"empty"}},
        {"function": {"of two": functions_of(2)}, "jumps": ONE_NUMBER},
    ),
    design.Margin: ({}, {}, {}),
    design.Fair: (
        {"goal": design.Margin(), "weight": 0.01},
        {},
        {"goal": {"class": design.Margin}, "weight": NOT_POSITIVE},
    ),
    design.Limits: (
        dict.fromkeys(("size", "length", "radius", "ahead", "flat", "steepness"), 0.01),
        dict.fromkeys(("size", "length", "radius", "ahead", "flat", "steepness"), {"nothing"}),
        dict.fromkeys(("size", "length", "radius", "ahead", "flat", "steepness"), NOT_POSITIVE),
    ),
    design.ShapeTransform: (
        {"tip": jxr.SupportFunction(0.01, [1e-4], [0.0]), "symmetric": False},
        {"tip": {"contour"}, "symmetric": {"true"}},
        {"tip": {"endless": jxr.Line()}},
    ),
    design.Firmness: (
        {"make": functions_of(2), "cases": np.ones(3), "measure": "rate", "neutral": 1, "scale": 1.0},
        {"cases": {"wrong shape"}, "neutral": {"nothing"}, "scale": {"nothing"}},
        {
            "make": {"of one": functions_of(1)},
            "neutral": {"float": 1.0, "negative": -1},
            "scale": NOT_POSITIVE,
        },
    ),
    design.ClosedLoop: (
        {"make": functions_of(2), "objective": {"overshoot": 1.0}, "cases": np.ones(3), "t1": 1.0, "ts": 11}
        | {"t0": 0.0, "formulation": None, "solver": None, "rtol": 1e-7, "atol": None, "dt0": 1e-3}
        | {"max_steps": 64, "events": ("lift",), "stepsize_controller": None, "progress_meter": None}
        | {"record": ("energy",)},
        {"cases": {"wrong shape"}, "events": {"empty"}, "record": {"nothing", "empty"}}
        | dict.fromkeys(
            ("formulation", "solver", "atol", "stepsize_controller", "progress_meter"), {"nothing"}
        ),
        {
            "make": {"of one": functions_of(1)},
            "objective": {"of one": functions_of(1), "unknown": {"speed": 1.0}}
            | {f"weight {name}": {"overshoot": BAD[name]} for name in ("text", "nothing", "nan", "complex")},
            "t1": NOT_POSITIVE,
            "ts": {"float": 11.0, "one": 1},
            "t0": {"after t1": 2.0},
            "rtol": NOT_POSITIVE | {"large": 1.0},
            "atol": NOT_POSITIVE,
            "dt0": NOT_POSITIVE,
            "max_steps": {"zero": 0, "float": 64.0},
            "events": {"unknown": ("lift", "slip"), "one name": "lift"},
            "record": {"unknown": ("forces",)},
        },
    ),
}
# Classes that the package makes and hands back, and what callers subclass.
MADE = {
    *("Pose", "Twist", "Moving", "UserLoad"),
    *("Tip", "Sensed", "UserController", "Touch", "Touch3", "Motion"),
    *("Location", "LocalMinima", "SurfaceLocation", "SurfaceMinima"),
    *("Equilibrium", "PinchStatics", "Stability", "VERDICTS", "Design"),
}
HOMES = (
    "jaxroll._mechanics",
    "jaxroll._motion._equation_terms",
    "jaxroll.commands",
    "jaxroll.control",
    "jaxroll.loads",
    "jaxroll.contact",
    "jaxroll.stability",
    "jaxroll.design",
)


def public(kind):
    """Public classes or functions of these modules, by name."""
    spaces = (jxr, commands, control, loads, jxr.contact, stability, design)
    names = [(space, name) for space in spaces for name in getattr(space, "__all__", vars(space))]
    given = {name: getattr(space, name) for space, name in names if not name.startswith("_")}
    mine = {
        name: thing for name, thing in given.items() if getattr(thing, "__module__", "").startswith(HOMES)
    }
    return {name: thing for name, thing in mine.items() if kind(thing)}


def test_every_public_class_is_in_the_table():
    classes = public(inspect.isclass)
    abstract = {name for name in classes if name.startswith("Abstract")}
    assert set(classes) - abstract - MADE == {cls.__name__ for cls in CLASSES}


def refusal(call):
    """The sentence that refuses a call; None if it goes through."""
    try:
        call()
    except ValueError as error:
        return str(error)
    return None


# Where arguments do not fit each other, the sentence may name the other one.
FIT = {
    "object": "contacts",
    "fingers": "contacts",
    "cases": "argument make",
    "controller": "of two fingers or more, but|as the grasp's",
}


def check_sentence(sentence, name):
    assert sentence is not None and sentence.startswith("argument "), sentence
    assert re.search(f"{name}|{FIT.get(name, name)}" if name.isidentifier() else re.escape(name), sentence)
    assert "\n" not in sentence and len(sentence) <= 300 and "Tracer" not in sentence, sentence


def bad_values(own, name, more):
    """Names and values that an argument must refuse."""
    allowed = own.get(name, set())
    return {key: BAD[key] for key in BAD if key not in allowed} | more.get(name, {})


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_constructors_refuse_in_one_sentence(cls):
    valid, own, more = CLASSES[cls]
    given = set(inspect.signature(cls).parameters)
    assert given == set(valid), "an argument is missing from the table"
    cls(**valid)
    for name in valid:
        for key in own.get(name, ()):
            cls(**valid | {name: BAD[key]})
        for key, value in bad_values(own, name, more).items():
            sentence = refusal(lambda: cls(**valid | {name: value}))  # noqa: B023
            assert sentence is not None, f"{cls.__name__}({name}={key}) went through"
            check_sentence(sentence, name)


def passed_on():
    """Pairs of functions: the first passes on to the second all but some arguments of its own."""
    scenes, run = jxr.scenes, jxr.simulate
    yield jxr.why, run, {"t1"}
    yield design.ClosedLoop, run, {"make", "objective", "cases", "t1", "ts", "rtol", "record"}
    yield scenes.ball_plate, scenes.pinch, {"radius"}
    yield scenes.pinch_ellipse, scenes.pinch, {"a", "b", "mass"}
    for kind in (jxr.NeuralCurvature, jxr.NeuralSupport):
        yield kind.through, kind.fit, set()


@pytest.mark.parametrize(("first", "second", "own"), list(passed_on()))
def test_what_is_passed_on_has_the_same_defaults(first, second, own):
    """Each name of the second is one of the first, but for what the first sets itself."""
    outer, inner = (inspect.signature(function).parameters for function in (first, second))
    assert set(outer) - own <= set(inner)
    assert set(inner) - set(outer) <= {"grasp", "state", "throw", "tips", "object"}
    assert all(outer[name].default == inner[name].default for name in set(outer) & set(inner) - own)


def test_no_public_function_takes_options_without_names():
    """But for the fields that `Grasp.with_` replaces, and for names that the caller gives himself."""
    found = set()
    for space in (
        jxr,
        commands,
        jxr.contact,
        control,
        design,
        loads,
        jxr.geometry,
        jxr.io,
        jxr.plotting,
        jxr.scenes,
        stability,
    ):
        for thing in (getattr(space, name) for name in dir(space) if not name.startswith("_")):
            if not getattr(thing, "__module__", "").startswith("jaxroll") or not callable(thing):
                continue
            members = inspect.getmembers(thing, callable) if inspect.isclass(thing) else ()
            own = [
                each for name, each in members if not name.startswith("_") and hasattr(each, "__qualname__")
            ]
            for each in (thing, *own):
                named = inspect.signature(each).parameters.values()
                found |= {each.__qualname__ for one in named if one.kind is one.VAR_KEYWORD}
    names = {"Parameters", "Parameters.sobol", "Parameters.latin_hypercube", "Parameters.with_units"}
    assert found == {"Grasp.with_", "Parameters.grid", "measures"} | names


def test_a_goal_hands_its_options_to_every_run(monkeypatch):
    """As they were given: numbers as Python's, for they are part of the compiled program."""
    told = {}
    monkeypatch.setattr(
        "jaxroll.design._closed_loop_goal.simulate", lambda *args, **asked: told.update(asked)
    )
    more = {"rtol": np.float64(1e-7), "dt0": jnp.asarray(1e-3), "events": ["lift"], "record": ("energy",)}
    goal = design.ClosedLoop(lambda tip: (PLANE, STATE), {"overshoot": 1.0}, ts=11, **more)
    hash(goal.options)
    with pytest.raises(ValueError, match="run must be a Trajectory"):  # the one that nobody made
        goal.run(TIP, ("overshoot",))
    assert told["rtol"] == 1e-7 and type(told["rtol"]) is float and type(told["dt0"]) is float
    assert told["events"] == ("lift",) and told["record"] == ("energy",) and told["throw"] is False
    assert told["ts"] == 11 and told["atol"] is None
    with pytest.raises(ValueError, match="argument rtol must be a known number here"):
        jax.jit(lambda r: design.ClosedLoop(functions_of(1), {"overshoot": 1.0}, rtol=r).t1)(1e-6)


# --- changed copies


def owners(grasp):
    return [grasp, grasp.controller, grasp.object]


def fields(owner):
    """Arguments of a constructor that are fields, and so can be changed."""
    return [name for name in CLASSES[type(owner)][0] if name in type(owner).__dataclass_fields__]


@pytest.mark.parametrize("grasp", [PLANE, PINCH, SPACE], ids=("plane", "pinch", "space"))
def test_with_refuses_what_the_constructor_refuses(grasp):
    for owner in owners(grasp):
        _, own, more = CLASSES[type(owner)]
        whole = {name: getattr(owner, name) for name in fields(owner)}
        more = {} if owner is grasp and grasp is not PLANE else more
        for name in whole:
            for key, value in bad_values(own, name, more).items():
                wanted = refusal(functools.partial(type(owner), **whole | {name: value}))
                found = refusal(functools.partial(grasp.with_, **{name: value}))
                assert found is not None and wanted is not None, (name, key, found, wanted)
                check_sentence(found, name)
                assert found == wanted or "shape" in found, (found, wanted)


def test_with_takes_what_the_constructor_takes():
    assert PINCH.with_(damping=0.01).controller.damping.tolist() == [0.01, 0.01]
    assert PINCH.with_(gravity=None).gravity is None
    assert PLANE.with_(gravity=(0, -9.81)).gravity.dtype == jnp.float64
    assert PLANE.with_(controller=None).controller is None
    assert PLANE.with_(weight_moment=(0, 1)).object.weight_moment.tolist() == [0.0, 1.0]
    assert SPACE.with_(inertia=2.0).object.inertia.tolist() == (2.0 * np.eye(3)).tolist()
    assert SPACE.with_(surfaces=BALL).object.surfaces == (BALL,)
    assert PLANE.with_(fingers=FINGER, contacts=jxr.Contact(0.001)).fingers == (FINGER,)
    assert PLANE.with_(force=-0.5).controller.stiffness == -50.0  # a push away is a force
    for name in ("force", "radius"):
        changing = PLANE.with_(**{name: lambda t: 0.1 + t}).controller
        with pytest.raises(ValueError, match="must have numbers as force and radius, as those of `at"):
            changing.stiffness  # noqa: B018


@pytest.mark.parametrize("index", [-1, 1, 0.0, True, None, "0", [0], 10**9])
def test_with_tip_refuses_a_finger_that_is_not_there(index):
    check_sentence(refusal(lambda: PLANE.with_tip(index, TIP)), "finger")


@pytest.mark.parametrize("key", [key for key in BAD if key != "contour"])
def test_with_tip_refuses_what_is_no_contour(key):
    check_sentence(refusal(lambda: PLANE.with_tip(0, BAD[key])), "tip")


def test_contacts_are_looked_at_again():
    """A start that was on the old contour, and is past the end of the new one."""
    short = jxr.Catenary(0.01, (0.002, 0.01))
    for name, change in {
        "contacts[0].s_tip": lambda: PLANE.with_tip(0, short),
        "contacts[0].s_object": lambda: PLANE.with_(contours=short),
        "contacts[0].finger": lambda: PINCH.with_contacts(jxr.Contact(finger=2)),
        "contacts[1].contour": lambda: PINCH.with_(contours=(CONTOUR,)),
        "start": lambda: PINCH.with_(fingers=(FINGER, FINGER, FINGER)),
        "tip": lambda: PLANE.with_tip(0, BALL),
        "contacts": lambda: PLANE.with_contacts(),
    }.items():
        check_sentence(refusal(change), name)
    moved = PLANE.with_(contours=short, contacts=jxr.Contact(0.0, 0.003))
    assert float(moved.contacts[0].s_object) == 0.003


class Own(eqx.Module):
    """A caller's own controller, with checks of its own."""

    gain: jax.Array

    def __check_init__(self):
        if not isinstance(self.gain, jax.core.Tracer) and self.gain < 0:
            raise ValueError("argument gain must not be negative")

    def __call__(self, t, angles, rates, tips):
        return (-self.gain * rates[0],)


def test_with_runs_a_callers_own_checks():
    grasp = PLANE.with_(controller=Own(jnp.array(1.0)))
    assert grasp.with_(gain=2.0).controller.gain == 2.0
    check_sentence(refusal(lambda: grasp.with_(gain=-1.0)), "gain")
    check_sentence(refusal(lambda: grasp.with_(gain=[1.0, 2.0])), "gain")


def test_nothing_is_checked_while_jax_traces():
    """Values that no constructor takes pass as tracers, by every transformation; shapes are seen."""
    radius = lambda x: PLANE.with_(radius=x, inertia=x).controller.radius ** 2  # noqa: E731
    assert jax.grad(radius)(-3.0) == -6.0
    assert jax.vmap(radius)(jnp.array([-1.0, 2.0])).tolist() == [1.0, 4.0]
    assert jax.jvp(radius, (-3.0,), (1.0,))[1] == -6.0
    tip = lambda r: PLANE.with_tip(0, jxr.Circle(r)).fingers[0].tip.radius  # noqa: E731
    assert jax.eval_shape(tip, jax.ShapeDtypeStruct((), float)).shape == ()
    contact = lambda s: PLANE.with_contacts(jxr.Contact(s_object=s)).contacts[0].s_object  # noqa: E731
    assert jax.vmap(contact)(jnp.array([0.0, 9.0])).tolist() == [0.0, 9.0]
    with pytest.raises(ValueError, match="argument radius must have shape"):
        jax.eval_shape(radius, jax.ShapeDtypeStruct((2,), float))


def test_a_leaf_with_a_batch_axis_does_not_hinder_other_changes():
    batched = eqx.tree_at(lambda g: g.controller.damping, PLANE, jnp.ones(3))
    assert batched.with_(force=1.0, inertia=1.0).controller.damping.shape == (3,)
    assert batched.with_(damping=(1, 2, 3)).controller.damping.tolist() == [1.0, 2.0, 3.0]


# --- states


def test_states_become_floating_arrays_of_one_precision():
    state = jxr.State([0, 1, 2], np.zeros(3, np.float32), jnp.zeros(1, int))
    assert [x.dtype for x in (state.q, state.v, state.s)] == [jnp.float64] * 3
    q = jnp.zeros(3)
    assert jxr.State(q, q, q).q is q
    lost = jax.tree.map(lambda x: None, state)
    assert (lost.q, lost.v, lost.s) == (None, None, None)
    traced = jax.eval_shape(lambda q: jxr.State(q, q, q), jax.ShapeDtypeStruct((3,), jnp.float32))
    assert traced.q.dtype == jnp.float32


GIVEN_STATES = {
    "residuals": lambda state: jxr.residuals(PLANE, state),
    "multipliers": lambda state: jxr.multipliers(PLANE, 0.0, state),
    "energies": lambda state: jxr.energies(PLANE, states=state),
    "torques": lambda state: jxr.torques(PLANE, 0.0, state),
    "wrenches": lambda state: jxr.wrenches(PLANE, 0.0, state),
    "accelerations": lambda state: jxr.accelerations(PLANE, 0.0, state),
    "strike": lambda state: jxr.strike(PLANE, state, loads.Impulse((0, 1e-4), 0.0)),
    "equation_terms": lambda state: jxr.equation_terms(PLANE, state),
    "press_balance": lambda state: jxr.press_balance(PLANE, 0.0, state),
    "contact_geometry": lambda state: jxr.contact_geometry(PLANE, state),
    "equilibrium": lambda state: stability.equilibrium(PLANE, state),
    "assess": lambda state: stability.assess(PLANE, state),
    "orientations": lambda state: control.orientations(PLANE, state),
    "pinch_rest": lambda state: stability.pinch_rest(ALONE, STATE if state is PINCHED else state),
    "pinch_balance": lambda state: jxr.pinch_balance(PINCH, 0.0, STATE if state is PINCHED else state),
}
FOREIGN = {
    "of another grasp": PINCHED,
    "mixed axes": jxr.State(np.zeros((2, 3)), np.zeros(3), np.zeros(1)),
    "too few contacts": jxr.State(np.zeros(3), np.zeros(3), np.zeros(0)),
    "array": np.zeros(3),
    "nothing": None,
    "tuple": (1, 2, 3),
    "class": jxr.State,
}


@pytest.mark.parametrize("name", GIVEN_STATES)
def test_states_of_another_grasp_are_refused(name):
    for state in FOREIGN.values():
        check_sentence(refusal(lambda: GIVEN_STATES[name](state)), "state")  # noqa: B023


def test_arguments_too_many_are_not_passed_over():
    with pytest.raises(TypeError, match="too many positional arguments"):
        jxr.residuals(PLANE, STATE, 1.0)


# --- functions


def run_of(shape=()):
    """A run that nobody made: shapes are all that a check sees."""
    states = jxr.State(np.zeros((*shape, 4, 3)), np.zeros((*shape, 4, 3)), np.zeros((*shape, 4, 1)))
    nothing = dict.fromkeys(jxr.Trajectory.__dataclass_fields__)
    run = object.__new__(jxr.Trajectory)
    for name, value in (nothing | {"ts": jnp.zeros((*shape, 4)), "states": states}).items():
        object.__setattr__(run, name, value)
    return run


GRASP, AT = {"array": np.zeros(3)}, {"array": np.zeros(3), "of another": PINCHED}
PAIR = {"three": (1, 2, 3), "number": 1.0}
RUN = {"batch": run_of((2,))}
# Of each function: a call, which nothing is made of, values that mean something, and what more is refused.
FUNCTIONS = {
    jxr.equation_terms: ({"grasp": PLANE, "state": STATE}, {}, {"grasp": GRASP, "state": AT}),
    control.orientations: ({"grasp": PLANE, "state": STATE}, {}, {"grasp": GRASP, "state": AT}),
    stability.equilibrium: ({"grasp": PLANE, "state": STATE, "t": 0.0}, {}, {"grasp": GRASP, "state": AT}),
    stability.assess: (
        {"grasp": PLANE, "state": STATE, "t": 0.0, "tolerance": 1e-7},
        {},
        {"grasp": GRASP, "state": AT, "tolerance": {"negative": -1.0, "large": 2.0}},
    ),
    stability.pinch_statics: ({"grasp": PINCH, "s": (0, 0)}, {}, {"grasp": GRASP, "s": PAIR}),
    stability.rectangle_hessian: (
        {"grasp": PINCH, "s": (0, 0)},
        {},
        {"grasp": GRASP, "s": PAIR | {"many": np.zeros((3, 2))}},
    ),
    stability.pinch_rest: (
        {"grasp": ALONE, "state": PINCHED, "damping": 0.0},
        {},
        {"grasp": GRASP, "damping": {"negative": -0.1, "large": 1.5, "two": (0.1, 0.1)}},
    ),
    stability.margin: (
        {"contour": TIP, "s": 0.0},
        {"contour": {"contour"}, "s": {"wrong shape", "empty"}},
        {"s": {"inf": [0.0, np.inf]}},
    ),
    design.value_and_grad: (
        {"function": functions_of(1), "mode": "auto", "has_aux": False},
        {"has_aux": {"true"}},
        {"function": {"of two": functions_of(2)}, "has_aux": {"one": 1}},
    ),
    design.settling_time: (
        {"run": run_of(), "band": 0.02, "signal": np.zeros((4, 1))},
        {"signal": {"nothing"}},
        {"run": RUN, "band": NOT_POSITIVE, "signal": {"too long": np.zeros(5)}},
    ),
    design.overshoot: (
        {"run": run_of(), "signal": np.zeros((4, 1))},
        {"signal": {"nothing"}},
        {"run": RUN, "signal": {"too long": np.zeros(5)}},
    ),
    design.tracking_error: (
        {"run": run_of(), "signal": np.zeros((4, 1))},
        {"signal": {"nothing"}},
        {"run": RUN, "signal": {"too long": np.zeros(5)}},
    ),
    design.peak_force: ({"run": run_of()}, {}, {"run": RUN | {"without forces": run_of()}}),
    design.friction_demand: ({"run": run_of()}, {}, {"run": RUN | {"without forces": run_of()}}),
    design.optimise_fingertip: (
        {"tip": TIP, "interval": (-0.01, 0.01), "goal": design.Margin(), "limits": design.Limits()}
        | {"steps": 10, "symmetric": False, "progress": False, "starts": 1, "seed": 0, "optimiser": None}
        | {"mode": "auto", "checkpoint": None},
        {"tip": {"contour"}, "goal": {"nothing"}, "limits": {"nothing"}, "symmetric": {"true"}}
        | {"progress": {"true"}, "optimiser": {"nothing"}, "checkpoint": {"nothing", "text"}},
        {
            "tip": {"endless": jxr.Line(), "mixed": [TIP, BALL], "two kinds": [TIP, CONTOUR]},
            "interval": {"falling": (0.01, -0.01)},
            "goal": {"class": design.Margin},
            "limits": {"class": design.Limits},
            "steps": {"zero": 0, "float": 10.0},
            "progress": {"one": 1, "of one": functions_of(1)},
            "starts": {"zero": 0, "float": 2.0},
            "seed": {"negative": -1, "float": 1.0},
            "mode": {"other": "sideways"},
            "checkpoint": {"folder": "/", "nowhere": "/no/such/folder/file"},
        },
    ),
}
# Formulas on frames, poses and twists that are for the package's own programs, and checks.
INNER = {
    *(
        "clearance",
        "clearance3",
        "chains_apart",
        "links_apart",
        "links_clearance",
        "links_clearance3",
        "gap",
        "gap_bias",
        "gap_rate",
        "pfaffian",
        "rolling_rate",
        "tangency",
        "tangency3",
    ),
    *("sense", "joint_angles", "as_controller", "as_drive", "check_states", "split"),
    *("as_load", "impulses", "total_wrench", "law_of", "laws_of"),
}
# Searches for the closest points of two shapes have tests of their own.
SEARCHES = {"locate", "locate_surfaces"}


def test_every_public_function_is_in_the_table():
    given = public(lambda thing: inspect.isfunction(thing) and not inspect.isclass(thing))
    assert set(given) - INNER - SEARCHES == {function.__name__ for function in FUNCTIONS}


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.__name__)
def test_functions_refuse_in_one_sentence(function):
    valid, own, more = FUNCTIONS[function]
    named = set(inspect.signature(function).parameters)
    assert named <= set(valid), "an argument is missing from the table"
    for name in valid:
        right = {"grasp": {"grasp"}, "state": {"state"}}.get(name, set())
        for key, value in bad_values({name: own.get(name, set()) | right}, name, more).items():
            sentence = refusal(functools.partial(function, **valid | {name: value}))
            assert sentence is not None, f"{function.__name__}({name}={key}) went through"
            check_sentence(sentence, name)


def test_quantities_of_the_plane_are_refused_in_space():
    q, v, s = map(np.zeros, SPACE.form.counts)
    q[3] = 1.0  # of the unit quaternion
    at = jxr.State(q, v, s)
    for call in (
        lambda: stability.pinch_statics(SPACE, (0, 0)),
        lambda: stability.rectangle_hessian(SPACE, (0, 0)),
        lambda: stability.pinch_rest(SPACE, at),
        lambda: stability.equilibrium(SPACE, at),
        lambda: stability.assess(SPACE, at),
        lambda: jxr.pinch_balance(SPACE, 0.0, at),
        lambda: jxr.press_balance(SPACE, 0.0, at),
        lambda: jxr.contact_geometry(SPACE, at),
    ):
        check_sentence(refusal(call), "grasp must live in the plane")


def test_a_checkpoint_of_other_bytes_is_refused(tmp_path):
    path = tmp_path / "search.npy"
    for content in (b"", b"not a search", bytes(1000)):
        path.write_bytes(content)
        check_sentence(refusal(lambda: _restored(path, jnp.zeros(3), {})), "checkpoint")


def test_a_checkpoint_is_a_file_in_a_folder_to_write_to(tmp_path, monkeypatch):
    check_checkpoint(tmp_path / "new")
    check_checkpoint(str(tmp_path / "new"))
    for path in (tmp_path, tmp_path / "none" / "new"):
        check_sentence(refusal(functools.partial(check_checkpoint, path)), "checkpoint")
    # Whoever runs the tests may be allowed to write anywhere.
    monkeypatch.setattr(os, "access", lambda folder, mode: mode != os.W_OK)
    check_sentence(refusal(functools.partial(check_checkpoint, tmp_path / "new")), "checkpoint")


def test_a_contour_of_one_curvature_has_as_many_samples_as_any():
    seen = jax.eval_shape(lambda ends: sampled(TIP, ends), jnp.zeros(2))
    assert seen.whole.curvature.shape == seen.whole.point.x.shape and seen.pad.curvature.ndim == 1


# --- what callers' functions return


SENSED = [Sensed((jnp.zeros(()), jnp.zeros(())), (jnp.zeros(()),) * 2, None, ())]
RETURNED = {
    "nothing": None,
    "one array": jnp.zeros(2),
    "too many": (jnp.zeros(2), jnp.zeros(2)),
    "wrong shape": (jnp.zeros(3),),
    "complex": (jnp.zeros(2) * 1j,),
    "flags": (jnp.zeros(2) > 0,),
    "texts": (["a", "b"],),
    "none": (None,),
    "ragged": ([1.0, [2.0]],),
    "dict": {"torque": jnp.zeros(2)},
}


@pytest.fixture
def blind(monkeypatch):
    """Controllers that are told no tips: what they return is what counts."""
    monkeypatch.setattr(_user, "tip_of", lambda finger: None)


@pytest.mark.parametrize("key", RETURNED)
def test_controllers_that_return_something_else_are_refused(blind, key):
    user = UserController(lambda t, angles, rates, tips: RETURNED[key])
    check_sentence(refusal(lambda: user.torques(jnp.zeros(()), SENSED)), "controller")


def test_controllers_may_return_lists_and_whole_numbers(blind):
    user = UserController(lambda t, angles, rates, tips: [[1, 2]])
    (torques,) = user.torques(jnp.zeros(()), SENSED)
    assert [float(x) for x in torques] == [1.0, 2.0] and torques[0].dtype == jnp.float64


UNIT = (1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "given",
    [None, 1.0, (1, 2, 3), ((0, 0), UNIT), ((0, 0, 0), (0, 0, 0)), ("abc", UNIT), ((1j, 0, 0), UNIT)]
    + [(None, UNIT), (0.0, UNIT), (jnp.zeros((3, 1)), UNIT), ((0, 0, jnp.zeros(2)), UNIT)],
)
def test_motions_that_return_something_else_are_refused(given):
    check_sentence(refusal(lambda: jxr.Stage(jxr.Plane(), lambda t: given)), "motion")


def test_functions_without_one_number_have_no_gradient():
    for function in (lambda x: x, lambda x: None, lambda x: "a", lambda x: x[0] * 1j):
        for mode in ("forward", "reverse"):
            both = design.value_and_grad(function, mode)
            check_sentence(refusal(lambda: both(jnp.ones(2))), "function")  # noqa: B023
    check_sentence(refusal(lambda: design.value_and_grad(jnp.sum, has_aux=True)(jnp.ones(2))), "function")
    check_sentence(refusal(lambda: design.value_and_grad(jnp.sum)("abc")), "x")


def test_goals_refuse_a_make_that_makes_no_grasp():
    for given in (None, PLANE, (PLANE,), (PLANE, None), (STATE, PLANE), (PLANE, STATE, 1)):
        goal = design.Firmness(lambda tip: given)  # noqa: B023
        check_sentence(refusal(lambda: goal.values(TIP)), "make")  # noqa: B023


def test_built_in_controllers_say_which_grasps_they_drive():
    class Silent(AbstractController):
        def torques(self, t, fingers):
            return ()

        def potential(self, tips, angles):
            return 0.0

    assert PLANE.with_(controller=Silent()).controller == Silent()


class Numbers(eqx.Module):
    """Fields of every kind."""

    one: jax.Array = _fields.real(check=check_positive)
    pair: jax.Array | None = _fields.real(2, optional=True)
    rows: jax.Array = _fields.real(None, 3)
    law: Any = _fields.command(2)
    each: jax.Array = _fields.each(check_positive)
    driven: Any = _fields.command(each_finger=True)
    word: str = _fields.through(lambda name, value: f"{name} {value}", static=True)


def taken(field, value, **options):
    return _fields.taken(object.__new__(Numbers), field, value, **options)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("one", None, "argument one must be"),
        ("one", [1.0], "argument one must have shape"),
        ("one", -1.0, "argument one must be positive"),
        ("one", np.nan, "argument one must be finite"),
        ("pair", [1.0, 2.0, 3.0], "argument pair must have shape"),
        ("rows", np.ones((4, 2)), "argument rows must have shape"),
        ("law", [1.0, 2.0, 3.0], "argument law must have shape"),
        ("law", lambda t: jnp.ones(3), r"argument law, in what it returns, must have shape \(2,\), but had"),
        ("law", lambda t: jnp.ones(()), r"argument law, in what it returns, must have shape \(2,\), but had"),
        ("each", [[1.0]], "argument each must have shape"),
        ("each", [1.0, -1.0], "argument each must be positive"),
        ("driven", lambda t: jnp.ones((2, 2)), r"must have shape \(any,\), but had shape \(2, 2\)"),
    ],
)
def test_fields_take_numbers_of_their_shape_alone(field, value, words):
    with pytest.raises(ValueError, match=words):
        taken(field, value)


def test_fields_convert_what_they_take():
    assert float(taken("one", 2)) == 2.0 and taken("pair", None) is None
    assert taken("pair", (1, 2)).tolist() == [1.0, 2.0] and taken("rows", np.ones((5, 3))).shape == (5, 3)
    assert taken("rows", np.ones((5, 3)), shape=(5, 3)).shape == (5, 3)
    with pytest.raises(ValueError, match="argument given must have shape"):
        taken("rows", np.ones((5, 3)), shape=(4, 3), name="given")
    assert taken("each", 3.0, shape=(2,)).tolist() == [3.0, 3.0]
    assert taken("each", [1.0, 2.0], shape=(2,)).tolist() == [1.0, 2.0]
    assert taken("word", "a") == "word a" and taken("word", "a", name="b") == "b a"
    for field, value in (("law", jnp.ones(2)), ("driven", jnp.ones(())), ("driven", jnp.ones(3))):
        function = taken(field, lambda t, value=value: t * value)
        assert _fields.shape_of(function) == value.shape
    assert _fields.shape_of(jnp.ones((2, 3))) == (2, 3)


@pytest.mark.parametrize(
    ("value", "command"), [(lambda t: t, True), (jxr.Circle, False), (np.ones(2), False), (3.0, False)]
)
def test_functions_of_time_are_told_from_numbers(value, command):
    assert _fields.is_command(value) == command


def test_commands_are_held_at_a_time():
    held = eqx.tree_at(
        lambda n: (n.law, n.one),
        dataclasses.replace(bare_numbers(), law=0.0, one=0.0),
        (jxr.commands.Steps([1.0], [[1.0, 2.0], [3.0, 4.0]]), jnp.asarray(5.0)),
    )
    assert _fields.changes_in_time(held, "one", "law") and not _fields.changes_in_time(held, "one", "each")
    for t, wanted in ((0.5, [1.0, 2.0]), (1.5, [3.0, 4.0])):
        now = _fields.held(held, t)
        assert now.law.tolist() == wanted and float(now.one) == 5.0
        assert _fields.held(now, t) is now


def bare_numbers():
    made = object.__new__(Numbers)
    for field in dataclasses.fields(Numbers):
        object.__setattr__(made, field.name, 0.0)
    return made


THREE = [1.0, 2.0, 3.0]
ODD = [([], [1.0]), ([1.0, 1.0], THREE), ([2.0, 1.0], THREE), ([1.0], [1.0]), ([1.0], THREE)]


@pytest.mark.parametrize(("times", "values"), ODD)
def test_steps_rise_and_have_one_value_more_than_times(times, values):
    with pytest.raises(ValueError, match="argument (times|values) must hold"):
        jxr.commands.Steps(times, values)
    with pytest.raises(ValueError, match="argument (times|values) must hold"):
        jxr.commands.Ramps(times, np.ones(len(times) + 1))
    assert jxr.commands.Ramps([1.0, 2.0], [1.0, 3.0]).times.shape == (2,)
