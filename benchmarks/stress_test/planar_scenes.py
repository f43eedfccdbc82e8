"""Random planar scenes as plain numbers: what a structure is, and how its lanes are drawn.

Starts are closed by construction: object and contact places first, then the pose of every fingertip that
touches there, then a chain that ends in it. Only NumPy and the judge's contours are used.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.stress_test.judge import picked
from benchmarks.stress_test.judge_contours import along, length, network, SAMPLES, TURN
from benchmarks.stress_test.judge_plane import Motion, Plane

Rng = np.random.Generator


@dataclass(frozen=True)
class Structure:
    """What is compiled once: everything but numbers.

    Attributes:
        name: How the command line calls it.
        faces: Kinds of the object's contours.
        tips: Kinds of the fingertips' contours.
        joints: Joints of every finger; of a jaw as "jaw0", "jaw1", "jaw2".
        free: Whether the object is free, or else pivoted.
        control: "none", "press", "opposition" or "servo".
        touch: For every contact its finger and its face.
        gravity: Whether there is any.
        friction: Whether contacts have coefficients.
        twist: Name of the adversarial change to the numbers, if any.
        lanes: In one batch.
        chunks: Batches in all.
        options: Further options of the run.
    """

    name: str
    faces: tuple[str, ...]
    tips: tuple[str, ...]
    joints: tuple[Any, ...]
    free: bool = True
    control: str = "opposition"
    touch: tuple[tuple[int, int], ...] = ()
    gravity: bool = False
    friction: bool = False
    twist: str = ""
    lanes: int = 384
    chunks: int = 6
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def touching(self) -> tuple[tuple[int, int], ...]:
        """Finger and face of every contact."""
        return self.touch or tuple((i, min(i, len(self.faces) - 1)) for i in range(len(self.tips)))


def spread(rng: Rng, low: float, high: float, *shape: int) -> np.ndarray:
    """Numbers uniform in their logarithm."""
    return np.exp(rng.uniform(np.log(low), np.log(high), shape))


def _contour(kind: str, rng: Rng, lanes: int, size: np.ndarray, *, hard: bool = False) -> dict[str, Any]:
    """One contour per lane, about `size` [m] large."""
    shape: dict[str, Any] = {"kind": kind, **_OWN[kind](rng, lanes, size)}
    shape["offset"] = 0.2 * size[:, None] * rng.normal(size=(lanes, 2))
    shape["angle"] = rng.uniform(-np.pi, np.pi, lanes)
    shape["origin"] = 0.3 * size * rng.normal(size=lanes)
    return shape


def _line(rng: Rng, lanes: int, size: np.ndarray) -> dict[str, Any]:
    half = size * rng.uniform(0.5, 2.0, lanes)
    return {"ends": np.stack([-half, half], axis=1)}


def _circle(rng: Rng, lanes: int, size: np.ndarray) -> dict[str, Any]:
    return {"radius": size * rng.uniform(0.5, 1.5, lanes)}


def _catenary(rng: Rng, lanes: int, size: np.ndarray) -> dict[str, Any]:
    a = size * spread(rng, 0.3, 3.0, lanes)
    half = a * rng.uniform(0.7, 3.0, lanes)
    return {"a": a, "ends": np.stack([-half, half], axis=1)}


def _ellipse(rng: Rng, lanes: int, size: np.ndarray) -> dict[str, Any]:
    return {"a": size * spread(rng, 0.4, 2.0, lanes), "b": size * spread(rng, 0.4, 2.0, lanes)}


def _support(rng: Rng, lanes: int, size: np.ndarray) -> dict[str, Any]:
    """Five harmonics that leave at least a sixth of the mean radius of curvature."""
    order = np.arange(1, 6)
    waves = rng.normal(size=(2, lanes, 5)) / order**2
    return {"radius": size, **_tamed(waves, size, rng.uniform(0.15, 0.9, lanes))}


def _tamed(waves: np.ndarray, size: np.ndarray, left: np.ndarray) -> dict[str, np.ndarray]:
    order = np.arange(1, waves.shape[2] + 1)
    angle = TURN * np.arange(256) / 256
    bend = 1.0 - order**2
    ripple = (bend * waves[0]) @ np.cos(np.outer(order, angle)) + (bend * waves[1]) @ np.sin(
        np.outer(order, angle)
    )
    scale = size * (1.0 - left) / np.maximum(-ripple.min(axis=1), 1e-9)
    cosines, sines = waves * np.minimum(scale, 0.3 * size)[:, None]
    return {"cosines": cosines, "sines": sines}


def _weights(rng: Rng, lanes: int, sizes: tuple[int, ...]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    weights, biases = [], []
    for a, b in zip(sizes[:-1], sizes[1:], strict=True):
        weights.append(rng.normal(size=(lanes, b, a)) / np.sqrt(a))
        biases.append(0.3 * rng.normal(size=(lanes, b)))
    return weights, biases


def _neural_support(rng: Rng, lanes: int, size: np.ndarray) -> dict[str, Any]:
    weights, biases = _weights(rng, lanes, (4, 8, 1))
    shape = {"weights": weights, "biases": biases}
    angle = TURN * np.arange(256) / 256
    waves = np.fft.rfft(network(shape, angle), axis=1)
    order = np.arange(waves.shape[1])
    bend = np.fft.irfft((1.0 - order**2) * (order > 0) * waves, 256, axis=1)
    scale = (1.0 - rng.uniform(0.2, 0.9, lanes)) / np.maximum(-bend.min(axis=1), 1e-9)
    scale = np.minimum(scale, 1.0)
    weights[-1] *= scale[:, None, None]
    # The mean belongs to the radius.
    biases[-1] = -np.mean(
        network({"weights": weights, "biases": [*biases[:-1], 0 * biases[-1]]}, angle), axis=1
    )[:, None]
    return {**shape, "radius": size, "centre": 0.1 * size[:, None] * rng.normal(size=(lanes, 2))}


def _neural_curvature(rng: Rng, lanes: int, size: np.ndarray) -> dict[str, Any]:
    weights, biases = _weights(rng, lanes, (4, 8, 1))
    weights[-1] *= rng.uniform(0.1, 0.6, lanes)[:, None, None]
    centre = 0.1 * size[:, None] * rng.normal(size=(lanes, 2))
    turn = rng.uniform(-np.pi, np.pi, lanes)
    return {"weights": weights, "biases": biases, "length": TURN * size, "turn": turn, "centre": centre}


def _spline(rng: Rng, lanes: int, size: np.ndarray) -> dict[str, Any]:
    """Points of a smooth closed curve, some of them not convex."""
    u = TURN * (np.arange(32) + 0.2 * rng.uniform(-1, 1, (lanes, 32))) / 32
    radius = np.ones((lanes, 32))
    for k in range(2, 5):
        radius += (
            0.25 * rng.uniform(0, 1, (lanes, 1)) / k**2 * np.cos(k * u + rng.uniform(0, TURN, (lanes, 1)))
        )
    points = size[:, None] * radius * np.exp(1j * u)
    return {"points": np.stack([points.real, points.imag], axis=-1)}


_OWN = {
    "line": _line,
    "circle": _circle,
    "catenary": _catenary,
    "bowl": _catenary,
    "ellipse": _ellipse,
    "support": _support,
    "neural_support": _neural_support,
    "neural_curvature": _neural_curvature,
    "spline": _spline,
}
SAMPLED = ("spline", "neural_curvature")


def draw(structure: Structure, rng: Rng, lanes: int, sample: Any) -> dict[str, Any]:
    """Scenes of a structure: plain numbers, lanes in front.

    Of three times as many, those that press in all contacts; of each eight one that may not. Coefficients
    of friction are about what the start needs. `sample(contour)` gives a contour its points at uniform
    arclengths where it has no other definition.
    """
    scene = _drawn(structure, rng, 3 * lanes, sample)
    rest = Motion(*(scene[name][:, None] for name in ("q", "v", "s")))
    rest.v = 0.0 * rest.v
    with np.errstate(all="ignore"):
        seen = Plane(scene).at(rest)
    presses = (seen.f[:, 0] > 0).all(axis=-1) & (np.min(seen.bend[:, 0], axis=-1) > 0.01)
    order = np.argsort(~presses, kind="stable")
    kept = order[: lanes - lanes // 8]
    kept = np.concatenate([kept, rng.permutation(order[len(kept) :])[: lanes - len(kept)]])
    # Some never slip: they may lose contact.
    ample = np.where(rng.uniform(size=3 * lanes) < 0.4, 1e3, 1.0)
    for k, contact in enumerate(scene["contacts"]):
        if contact["friction"] is not None:
            need = np.abs(seen.lam[:, 0, k]) / np.maximum(np.abs(seen.f[:, 0, k]), 1e-12)
            contact["friction"] = np.clip(need, 0.01, 1e3) * ample * spread(rng, 0.95, 10.0, 3 * lanes)
    return picked(scene, kept)


def _drawn(structure: Structure, rng: Rng, lanes: int, sample: Any) -> dict[str, Any]:
    grown = lambda: spread(rng, 0.005, 0.05, lanes)  # noqa: E731
    faces = [sample(_contour(kind, rng, lanes, grown())) for kind in structure.faces]
    tips = [sample(_contour(kind, rng, lanes, grown())) for kind in structure.tips]
    scene: dict[str, Any] = {"faces": faces, "contacts": []}
    size = np.sqrt(np.mean([_extent(face) ** 2 for face in faces], axis=0))
    mass = spread(rng, 1e-3, 1e3, lanes) * 0.03
    scene["object"] = {"kind": "free" if structure.free else "pivoted", "size": size}
    scene["object"] |= {"inertia": mass * size**2 * spread(rng, 0.1, 1.0, lanes), "mass": mass}
    pose = np.stack([*(0.1 * rng.normal(size=(2, lanes))), rng.uniform(-np.pi, np.pi, lanes)], axis=1)
    if not structure.free:
        scene["object"] |= {"pivot": pose[:, :2], "centre": 0.5 * size[:, None] * rng.normal(size=(lanes, 2))}
        if not structure.gravity:
            del scene["object"]["mass"], scene["object"]["centre"]
    _Arranged(structure, rng, scene, tips, pose).put()
    return scene


class _Arranged:
    """A scene on its way: contacts, fingers that reach them, controller, start."""

    def __init__(self, structure: Structure, rng: Rng, scene: dict, tips: list, pose: np.ndarray) -> None:
        self.structure, self.rng, self.scene, self.tips, self.pose = structure, rng, scene, tips, pose
        self.lanes = len(pose)
        self.mass = spread(rng, 1e-3, 1e3, self.lanes) * 0.03

    def put(self) -> None:
        """Fill the scene."""
        rng, scene, lanes = self.rng, self.scene, self.lanes
        self._contacts()
        angle = self.pose[:, 2] if self.structure.free else self.pose[:, 2]
        origin = self.pose[:, 0] + 1j * self.pose[:, 1]
        q, fingers = [self.pose if self.structure.free else self.pose[:, 2:]], []
        for i, tip in enumerate(self.tips):
            contact = next(c for c in scene["contacts"] if c["finger"] == i)
            face = along(scene["faces"][contact["face"]], contact["s_object"][:, None])
            own = along(tip, contact["s_tip"][:, None])
            turn = angle + np.angle(-face.tangent / own.tangent)[:, 0]
            at = origin + np.exp(1j * angle) * face.point[:, 0] - np.exp(1j * turn) * own.point[:, 0]
            finger, block = self._finger(i, tip, at, turn)
            fingers.append(finger)
            q.append(block)
        scene["fingers"] = fingers
        scene["q"] = np.concatenate(q, axis=1)
        gravity = 9.81 * spread(rng, 0.1, 1.0, lanes)[:, None] * _unit(rng.uniform(0, TURN, lanes))
        scene["gravity"] = gravity if self.structure.gravity else None
        self._control(q)
        self._time()

    def _contacts(self) -> None:
        rng, lanes = self.rng, self.lanes
        around = rng.uniform(0, TURN, lanes)
        for k, (finger, face) in enumerate(self.structure.touching):
            count = len(self.structure.touching)
            where = around + TURN * k / count + 0.35 * rng.normal(size=lanes)
            # The pad of a fingertip faces anywhere.
            contact = {
                "finger": finger,
                "face": face,
                "s_object": self._suited(finger, face, _facing(self.scene["faces"][face], where, rng)),
                "s_tip": _facing(self.tips[finger], rng.uniform(0, TURN, lanes), rng),
                "sense": int(rng.choice([1, -1])) if False else (1 if k % 2 == 0 else -1),
                "friction": spread(rng, 0.05, 5.0, lanes) if self.structure.friction else None,
            }
            self.scene["contacts"].append(contact)

    def _suited(self, finger: int, face: int, s: np.ndarray) -> np.ndarray:
        """The place on a face, where the adversary wants one; the fingertip's size, likewise."""
        shape, tip = self.scene["faces"][face], self.tips[finger]
        if self.structure.twist == "cancel":
            # The bowl's curvature reaches the fingertip's on the way to its vertex.
            away = (s - shape["origin"]) * (1.0 - spread(self.rng, 1e-3, 1.0, self.lanes))
            tip["radius"] = (shape["a"] ** 2 + away**2) / shape["a"]
        if self.structure.twist == "ends":
            low, high = shape["ends"].T
            left = (high - low) * spread(self.rng, 1e-13, 1e-1, self.lanes)
            return shape["origin"] + np.where(
                self.rng.uniform(size=self.lanes) < 0.5, low + left, high - left
            )
        return s

    def _finger(self, i: int, tip: dict, at: np.ndarray, turn: np.ndarray) -> tuple[dict, np.ndarray]:
        rng, lanes, kind = self.rng, self.lanes, self.structure.joints[i]
        if isinstance(kind, str):
            count = int(kind[3:])
            first = rng.uniform(0, TURN, lanes)
            across = first + rng.uniform(0.4, np.pi - 0.4, lanes)
            directions = np.stack([first, across], axis=1)[:, :count]
            q = 0.01 * rng.normal(size=(lanes, count))
            base = at - np.sum(q * np.exp(1j * directions), axis=1)
            jaw = {"kind": "jaw", "joints": count, "mass": self.mass * spread(rng, 0.3, 3.0, lanes)}
            return jaw | {"directions": directions, "base": _pair(base), "angle": turn, "tip": tip}, q
        lengths = spread(rng, 0.02, 0.1, lanes, kind)
        bends = rng.uniform(0.2, 1.5, (lanes, kind)) * rng.choice([-1, 1], (lanes, kind))
        if self.structure.twist == "straight":
            bends *= spread(rng, 1e-6, 1.0, lanes, 1)
        bends[:, 0] = turn - np.sum(bends[:, 1:], axis=1)
        links = lengths * np.exp(1j * np.cumsum(bends, axis=1))
        masses = self.mass[:, None] * spread(rng, 0.2, 5.0, lanes, kind) / kind
        finger = {"kind": "finger", "joints": kind, "lengths": lengths, "masses": masses, "tip": tip}
        finger |= {"base": _pair(at - np.sum(links, axis=1))}
        finger |= {"centres": lengths * rng.uniform(0.2, 0.8, (lanes, kind))}
        return finger | {"inertias": masses * lengths**2 * rng.uniform(0.02, 0.2, (lanes, kind))}, bends

    def _control(self, q: list[np.ndarray]) -> None:
        rng, lanes, scene = self.rng, self.lanes, self.scene
        gain, arm = spread(rng, 1e-2, 1e2, lanes), 0.05
        scene["push"] = gain
        quiet = np.where(rng.uniform(size=lanes) < 0.4, 0.0, 1.0)
        heavy = np.maximum(self.mass, scene["object"]["inertia"] / scene["object"]["size"] ** 2)
        damping = quiet * np.sqrt(gain / arm * heavy) * arm**2 * spread(rng, 1e-3, 1.0, lanes)
        count = len(self.tips)
        control: dict[str, Any] = {"kind": self.structure.control}
        if self.structure.control == "press":
            target = self.pose[:, :2] + 0.2 * scene["object"]["size"][:, None] * rng.normal(size=(lanes, 2))
            control |= {"force": gain, "radius": np.full(lanes, arm), "damping": damping, "target": target}
        elif self.structure.control == "opposition":
            several = damping[:, None] * np.ones(count)
            control |= {
                "beta": gain / arm,
                "damping": several,
                "start": np.stack([b.sum(axis=1) for b in q[1:]], 1),
            }
            control["alpha"] = (gain * arm * spread(rng, 1e-4, 1e-1, lanes))[:, None] * np.ones(count)
        elif self.structure.control == "servo":
            wanted = [b + 0.1 * rng.normal(size=b.shape) for b in q[1:]]
            control |= {
                "gain": gain * arm * spread(rng, 1e-2, 1.0, lanes),
                "damping": damping,
                "wanted": wanted,
            }
            control["push"] = [self._pushes(i, gain) for i in range(count)]
        scene["controller"] = control
        self.heavy, self.arm = heavy, arm

    def _pushes(self, i: int, gain: np.ndarray) -> np.ndarray:
        """Torques (forces) that press a fingertip onto the object."""
        finger, contact = self.scene["fingers"][i], self.scene["contacts"][i]
        start = np.cumsum([0, 3 if self.structure.free else 1, *(f["joints"] for f in self.scene["fingers"])])
        q = self.scene["q"][:, start[1 + i] : start[2 + i]]
        face = along(self.scene["faces"][contact["face"]], contact["s_object"][:, None])
        inward = 1j * np.exp(1j * self.pose[:, 2]) * face.tangent[:, 0]
        way = inward * np.exp(0.2j * self.rng.normal(size=self.lanes)) * gain
        if finger["kind"] == "jaw":
            moves = np.exp(1j * finger["directions"])
        else:
            links = finger["lengths"] * np.exp(1j * np.cumsum(q, axis=1))
            # From every joint to the tip frame.
            moves = 1j * np.cumsum(links[:, ::-1], axis=1)[:, ::-1]
        return (np.conj(moves) * way[:, None]).real

    def _time(self) -> None:
        """How long a run is, and how fast it starts: by the natural period of the whole."""
        rng, lanes, scene = self.rng, self.lanes, self.scene
        pull = scene["push"] if self.structure.control != "none" else np.zeros(lanes)
        if self.structure.gravity:
            pull = pull + self.heavy * np.hypot(*scene["gravity"].T)
        scene["period"] = np.sqrt(self.heavy * self.arm / np.maximum(pull, 1e-6))
        if self.structure.control == "none" and not self.structure.gravity:
            scene["period"] = np.ones(lanes)
        scene["t1"] = scene["period"] * spread(rng, 0.1, 10.0, lanes)
        quick = np.where(rng.uniform(size=lanes) < 0.5, 0.0, spread(rng, 1e-3, 1.0, lanes))
        scene["v"] = (quick / scene["period"])[:, None] * rng.normal(size=scene["q"].shape)
        if self.structure.free:
            scene["v"][:, :2] *= self.arm
        scene["rtol"] = np.full(lanes, 1e-8)
        if self.structure.twist == "tolerance":
            scene["rtol"] = spread(rng, 1e-13, 1e-3, lanes)
        if self.structure.twist == "single":
            scene["rtol"] = spread(rng, 1e-4, 1e-3, lanes)
        if self.structure.twist == "long":
            self._long()
        if self.structure.twist == "limits":
            self._limit()
        scene["s"] = np.zeros((lanes, len(scene["contacts"])))

    def _limit(self) -> None:
        """Ranges of all joints: ends near the start or just there, of half the scenes out of reach."""
        last, far = self.scene["q"].shape[1], self.rng.uniform(size=self.lanes) < 0.5
        for finger in reversed(self.scene["fingers"]):
            first = last - finger["joints"]
            q = self.scene["q"][:, first:last, None]
            room = spread(self.rng, 1e-5, 3.0, self.lanes, finger["joints"], 2)
            room[..., 0][self.rng.uniform(size=room.shape[:2]) < 0.05] = 0.0
            room[far] = 30.0
            finger["limits"] = q + room * np.array([-1.0, 1.0])
            last = first

    def _long(self) -> None:
        """A thousand seconds without damping, of periods about a third of one."""
        scene = self.scene
        scene["t1"], scene["rtol"] = np.full(self.lanes, 1e3), np.full(self.lanes, 1e-9)
        scene["controller"]["damping"] = np.zeros(self.lanes)
        scene["controller"]["force"] = scene["controller"]["force"] * (scene["period"] / 0.05) ** 2
        scene["push"], scene["period"] = scene["controller"]["force"], np.full(self.lanes, 0.05)
        scene["v"] = 0.01 / 0.05 * self.rng.normal(size=scene["q"].shape)
        scene["max_steps"] = 4_000_000


def _unit(angle: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _pair(values: np.ndarray) -> np.ndarray:
    return np.stack([values.real, values.imag], axis=-1)


def _extent(contour: dict[str, Any]) -> np.ndarray:
    """A typical radius [m]."""
    if "ends" in contour:
        return 0.5 * (contour["ends"][:, 1] - contour["ends"][:, 0])
    return length(contour) / TURN


def _facing(contour: dict[str, Any], angle: np.ndarray, rng: Rng) -> np.ndarray:
    """Arclength where a closed contour reaches far in a direction; anywhere on an open one."""
    lanes = len(angle)
    if "ends" in contour:
        low, high = contour["ends"].T
        return contour["origin"] + low + (high - low) * rng.uniform(0.15, 0.85, lanes)
    s = contour["origin"][:, None] + length(contour)[:, None] * np.linspace(0, 1, 128, endpoint=False)
    place = along(contour, s)
    reach = (np.exp(-1j * angle)[:, None] * (place.point - place.point.mean(axis=1)[:, None])).real
    reach = np.where(place.curvature > 0, reach, -np.inf)
    best = np.argmax(reach, axis=1)
    return s[np.arange(lanes), best]


__all__ = ["SAMPLED", "SAMPLES", "Structure", "draw", "spread"]
