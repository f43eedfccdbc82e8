"""The engine's side of the stress test: grasps from plain numbers, and compiled batches of runs."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxroll as jxr
from benchmarks.stress_test.judge_contours import SAMPLES

# Saved times of the run that is judged: nodes of Clenshaw and Curtis' quadrature.
NODES = 65
SHARES = 0.5 * (1.0 - np.cos(np.pi * np.arange(NODES) / (NODES - 1)))
# Of the runs that save nothing on their way: the same program is to serve, so they save at their very end.
LATE = 1.0 - 1e-6 * np.linspace(1.0, 0.0, NODES)


class Servo(eqx.Module):
    """A user's controller: springs towards wanted angles, dampers, and constant pushes."""

    gain: Any
    damping: Any
    wanted: Any
    push: Any

    def __call__(self, t: Any, angles: Any, rates: Any, tips: Any) -> tuple:
        """Torques of every finger."""
        each = zip(angles, rates, self.wanted, self.push, strict=True)
        return tuple(p - self.gain * (a - w) - self.damping * r for a, r, w, p in each)


class Bowl(jxr.AbstractContour):
    """A caller's own contour: a catenary seen from its other side, hollow, and most so at its vertex."""

    a: Any
    limits: Any

    @property
    def closed(self) -> bool:
        """It has ends."""
        return False

    @property
    def smoothness(self) -> float:
        """It is analytic."""
        return float("inf")

    def curve(self, s: Any) -> Any:
        """The mirror image of a catenary's point."""
        return self.frame(s).point

    def frame(self, s: Any) -> Any:
        """Point, tangent and curvature."""
        own = jxr.Catenary(self.a).frame(s)
        point, tangent = (type(v)(-v.x, v.y) for v in (own.point, own.tangent))
        return type(own)(point, tangent, -own.curvature)

    def prepared(self) -> "Bowl":
        """Nothing to work out."""
        return self

    def domain(self) -> Any:
        """Both ends."""
        return self.limits[0], self.limits[1]


def contour(shape: dict[str, Any]) -> Any:
    """A contour of the engine from plain numbers."""
    kind = shape["kind"]
    if kind == "line":
        own = jxr.Line(shape["ends"])
    elif kind == "circle":
        own = jxr.Circle(shape["radius"])
    elif kind == "catenary":
        own = jxr.Catenary(shape["a"], shape["ends"])
    elif kind == "bowl":
        own = Bowl(shape["a"], shape["ends"])
    elif kind == "ellipse":
        own = jxr.Ellipse(shape["a"], shape["b"])
    elif kind == "support":
        own = jxr.SupportFunction(shape["radius"], shape["cosines"], shape["sines"])
    elif kind == "spline":
        own = jxr.Spline(shape["points"])
    else:
        own = _neural(shape)
    return own.moved(shape["offset"], shape["angle"], origin=shape["origin"])


def _neural(shape: dict[str, Any]) -> Any:
    harmonics, width = shape["weights"][0].shape[1] // 2, shape["weights"][0].shape[0]
    network = jxr.geometry.PeriodicNetwork(
        harmonics, decay=1.0, width=width, depth=len(shape["weights"]) - 1, key=jax.random.key(0)
    )
    leaves = lambda n: [x for layer in n.layers for x in (layer.weight, layer.bias)]  # noqa: E731
    given = [x for pair in zip(shape["weights"], shape["biases"], strict=True) for x in pair]
    network = eqx.tree_at(leaves, network, given)
    if shape["kind"] == "neural_support":
        return jxr.NeuralSupport(network, shape["radius"], shape["centre"])
    return jxr.NeuralCurvature(network, shape["length"], shape["turn"], shape["centre"])


def surface(shape: dict[str, Any]) -> Any:
    """A surface of the engine from plain numbers."""
    kinds = jxr.geometry
    made = {
        "plane": lambda: kinds.Plane(),
        "sphere": lambda: kinds.Sphere(shape["radius"]),
        "cylinder": lambda: kinds.Cylinder(shape["radius"]),
        "torus": lambda: kinds.Torus(shape["major"], shape["minor"]),
        "ellipsoid": lambda: kinds.Ellipsoid(shape["half"][0], shape["half"][1], shape["half"][2]),
    }[shape["kind"]]()
    made = kinds.Hollow(made) if shape.get("hollow") else made
    return made.moved(shape["offset"], shape["rotation"])


def _grasp3(scene: dict[str, Any]) -> jxr.Grasp:
    body = scene["object"]
    held = jxr.FreeObject3([surface(x) for x in scene["surfaces"]], body["mass"], body["inertia"])
    contacts = [
        jxr.Contact3(c["finger"], c["surface"], spin=c["spin"], friction=c["friction"])
        for c in scene["contacts"]
    ]
    fingers = [_finger3(f) for f in scene["fingers"]]
    return jxr.Grasp(held, fingers, contacts, controller=_controller(scene), gravity=scene["gravity"])


def _finger3(finger: dict[str, Any]) -> Any:
    tip, place = surface(finger["tip"]), {"base": finger["base"], "rotation": finger["rotation"]}
    if finger["kind"] == "stage":
        turning = finger.get("turning")
        if turning is not None:
            turning = jxr.Turning(turning["rate"], axis=turning["axis"], centre=turning["centre"])
        return jxr.Stage(tip, turning, **place)
    inside = {"centres": finger["centres"], "inertias": finger["inertias"]}
    return jxr.Finger3(finger["axes"], finger["offsets"], finger["masses"], tip, **place, **inside)


def grasp(scene: dict[str, Any]) -> jxr.Grasp:
    """The engine's grasp of one lane."""
    if "surfaces" in scene:
        return _grasp3(scene)
    faces, body = tuple(contour(face) for face in scene["faces"]), scene["object"]
    if body["kind"] == "free":
        held = jxr.FreeObject(faces, body["mass"], body["inertia"])
    else:
        weight = {"mass": body["mass"], "centre": body["centre"]} if "mass" in body else {}
        held = jxr.PivotedObject(faces, body["inertia"], pivot=body["pivot"], **weight)
    contacts = [
        jxr.Contact(
            c["s_tip"],
            c["s_object"],
            finger=c["finger"],
            contour=c["face"],
            sense=c["sense"],
            friction=c["friction"],
        )
        for c in scene["contacts"]
    ]
    fingers = [_finger(f) for f in scene["fingers"]]
    return jxr.Grasp(held, fingers, contacts, controller=_controller(scene), gravity=scene["gravity"])


def _finger(finger: dict[str, Any]) -> Any:
    tip = contour(finger["tip"])
    if finger["kind"] == "jaw":
        place = {"base": finger["base"], "angle": finger["angle"]}
        return jxr.Jaw(tip, finger["mass"], finger["directions"], **place)
    inside = {"centres": finger["centres"], "inertias": finger["inertias"], "limits": finger.get("limits")}
    return jxr.Finger(finger["lengths"], finger["masses"], tip, base=finger["base"], **inside)


def _controller(scene: dict[str, Any]) -> Any:
    control = scene["controller"]
    if control["kind"] == "press":
        own = (control["force"], control["radius"], control["damping"])
        return jxr.control.Press(*own, target=control["target"])
    if control["kind"] == "opposition":
        own = (control["beta"], control["damping"], control["alpha"])
        return jxr.control.Opposition(*own, start=control["start"])
    if control["kind"] == "servo":
        return Servo(control["gain"], control["damping"], control["wanted"], control["push"])
    return None


def is_number(x: Any) -> bool:
    """Whether a leaf of a scene differs from lane to lane."""
    return isinstance(x, np.ndarray | jax.Array)


class Programs:
    """The programs of one structure: samples of contours, starts, runs with few and with many saved times."""

    def __init__(self, still: Any, options: dict[str, Any]) -> None:
        self.still = still
        self.options = options

    @functools.cached_property
    def start(self) -> Any:
        """Starts: every lane's state on the constraints."""

        def one(numbers: Any, q: Any, v: Any, places: Any) -> Any:
            hand = grasp(eqx.combine(numbers, self.still))
            _, state = jxr.close(hand, jxr.State(q, v, places), throw=False, hold_contacts=False)
            return state

        return jax.jit(jax.vmap(one))

    @functools.cached_property
    def run(self) -> Any:
        """Runs from starts; save times are given as shares of `until`."""

        def one(numbers: Any, state: jxr.State, t1: Any, rtol: Any, ts: Any) -> Any:
            hand = grasp(eqx.combine(numbers, self.still))
            record = {"record": ("multipliers",), "throw": False}
            return jxr.simulate(hand, state, t1, ts=ts, rtol=rtol, **record, **self.options)

        return jax.jit(jax.vmap(one))


@eqx.filter_jit
def samples(shape: Any, still: Any) -> Any:
    """Length and points at uniform arclengths of contours that only the engine defines."""

    def one(numbers: Any) -> Any:
        own = contour(eqx.combine(numbers, still)).contour.prepared()
        low, high = own.domain()
        s = low + (high - low) * jnp.arange(SAMPLES) / SAMPLES
        return high - low, own.point(s)

    return jax.vmap(one)(shape)


def sampled(shape: dict[str, Any]) -> dict[str, Any]:
    """A contour with its samples, if it needs them."""
    if shape["kind"] not in ("spline", "neural_curvature"):
        return shape
    numbers, still = eqx.partition(shape, is_number)
    length, points = samples(numbers, still)
    points = np.asarray(points)
    return shape | {"length": np.asarray(length), "samples": points[..., 0] + 1j * points[..., 1]}
