"""Random scenes in space as plain numbers; see `planar_scenes`, whose ways these follow.

Only NumPy, SciPy's rotations and the judge's surfaces are used.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.stress_test.judge_space import about, level, turned
from benchmarks.stress_test.planar_scenes import Rng, spread


@dataclass(frozen=True)
class Spatial:
    """What is compiled once, of a scene in space.

    Attributes:
        name: How the command line calls it.
        surfaces: Kinds of the object's surfaces.
        tips: Kinds of the fingertips' (stages') surfaces.
        joints: Joints of every finger; 0 for a fixed stage, -1 for one that turns.
        hollow: Whether the fingertips' surfaces are turned inside out.
        spin: "free" or "prevented".
        friction: Whether contacts have coefficients.
        lanes: In one batch.
        chunks: Batches in all.
        options: Further options of the run.
    """

    name: str
    surfaces: tuple[str, ...]
    tips: tuple[str, ...]
    joints: tuple[int, ...]
    hollow: bool = False
    spin: str = "free"
    friction: bool = False
    twist: str = ""
    lanes: int = 384
    chunks: int = 6
    options: dict[str, Any] = field(default_factory=dict)


def _surface(kind: str, rng: Rng, lanes: int, size: np.ndarray) -> dict[str, Any]:
    shape: dict[str, Any] = {"kind": kind}
    if kind in ("sphere", "cylinder"):
        shape["radius"] = size
    elif kind == "ellipsoid":
        shape["half"] = size[:, None] * spread(rng, 0.5, 2.0, lanes, 3)
    elif kind == "torus":
        shape |= {"major": size, "minor": size * rng.uniform(0.1, 0.6, lanes)}
    shape["offset"] = 0.2 * size[:, None] * rng.normal(size=(lanes, 3))
    shape["rotation"] = _quaternions(Rotation.random(lanes, rng))
    return shape


def _quaternions(turns: Rotation) -> np.ndarray:
    return np.roll(turns.as_quat(), 1, axis=-1)


def _place(shape: dict[str, Any], rng: Rng, lanes: int) -> np.ndarray:
    """A point of a surface, in its own frame, on the convex side of a torus."""
    way = rng.normal(size=(lanes, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    if shape["kind"] == "sphere":
        return shape["radius"][:, None] * way
    if shape["kind"] == "ellipsoid":
        return shape["half"] * way
    flat = way * np.array([1.0, 1.0, 0.0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0])
    if shape["kind"] == "plane":
        return 0.1 * flat
    if shape["kind"] == "cylinder":
        return shape["radius"][:, None] * flat + 0.1 * way[:, 2:] * up
    roll = rng.uniform(-1.2, 1.2, lanes)[:, None]
    minor = shape["minor"][:, None]
    return flat * (shape["major"][:, None] + minor * np.cos(roll)) + up * minor * np.sin(roll)


def draw_space(structure: Spatial, rng: Rng, lanes: int) -> dict[str, Any]:
    """Scenes of a structure: plain numbers, lanes in front."""
    size = spread(rng, 0.005, 0.05, lanes)
    surfaces = [
        _surface(kind, rng, lanes, size * rng.uniform(0.7, 1.3, lanes)) for kind in structure.surfaces
    ]
    reach = 4.0 * size if structure.hollow else size * spread(rng, 0.5, 3.0, lanes)
    tips = [_surface(kind, rng, lanes, reach) for kind in structure.tips]
    mass = 0.03 * spread(rng, 1e-3, 1e3, lanes)
    axes = np.linalg.qr(rng.normal(size=(lanes, 3, 3)))[0]
    moments = (mass * size**2)[:, None] * np.sort(rng.uniform(0.3, 0.55, (lanes, 3)), axis=1)
    tensor = np.einsum("lij,lj,lkj->lik", axes, moments, axes)
    scene: dict[str, Any] = {"surfaces": surfaces, "fingers": [], "contacts": []}
    scene["object"] = {"mass": mass, "inertia": 0.5 * (tensor + np.swapaxes(tensor, 1, 2)), "size": size}
    pose = Rotation.random(lanes, rng)
    origin = 0.1 * rng.normal(size=(lanes, 3))
    q, s = [np.concatenate([origin, _quaternions(pose)], axis=1)], []
    first = None
    for i, (tip, joints) in enumerate(zip(tips, structure.joints, strict=True)):
        if structure.hollow:
            tip["hollow"] = True
        face = surfaces[min(i, len(surfaces) - 1)]
        at = (_place(tip, rng, lanes), _place(face, rng, lanes))
        if i and len(surfaces) == 1:
            at = (at[0], _opposite(face, first, rng))
        first = at[1] if first is None else first
        frame = _against(tip, at, (origin, pose.as_matrix()), face, rng)
        finger, block = _finger(joints, tip, frame, rng, lanes)
        scene["fingers"].append(finger)
        friction = spread(rng, 0.05, 5.0, lanes) if structure.friction else None
        scene["contacts"].append(
            {
                "finger": i,
                "surface": min(i, len(surfaces) - 1),
                "spin": structure.spin,
                "friction": friction,
            }
        )
        q.append(block)
        s.append(np.concatenate(at, axis=1))
    scene["q"], scene["s"] = np.concatenate(q, axis=1), np.concatenate(s, axis=1)
    _driven(structure, scene, rng, lanes, q)
    return scene


def _opposite(face: dict[str, Any], at: np.ndarray, rng: Rng) -> np.ndarray:
    """A place about opposite to another one, of a closed surface about its origin."""
    lanes = len(at)
    way = -at / np.linalg.norm(at, axis=1, keepdims=True) + 0.3 * rng.normal(size=(lanes, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return (face["half"] if face["kind"] == "ellipsoid" else face["radius"][:, None]) * way


def _against(
    tip: dict, at: tuple[np.ndarray, np.ndarray], body: tuple[np.ndarray, np.ndarray], face: dict, rng: Rng
) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the tip's frame where both surfaces touch: origins and axes."""
    own, there = (
        (np.einsum("lij,lj->li", turned(shape["rotation"]), place), level(shape, place[:, None])[1][:, 0])
        for shape, place in ((tip, at[0]), (face, at[1]))
    )
    arms = [place + shape["offset"] for (place, _), shape in ((own, tip), (there, face))]
    normals = [
        np.einsum("lij,lj->li", turned(shape["rotation"]), n) for (_, n), shape in ((own, tip), (there, face))
    ]
    outward = np.einsum("lij,lj->li", body[1], normals[1])
    spin = about(outward[:, None], rng.uniform(0, 2 * np.pi, (len(outward), 1)))[:, 0]
    # A frame with each normal for its third axis; the second one reversed.
    axes = spin @ _frame(-outward) @ np.swapaxes(_frame(normals[0]), 1, 2)
    point = body[0] + np.einsum("lij,lj->li", body[1], arms[1])
    return point - np.einsum("lij,lj->li", axes, arms[0]), axes


def _frame(normal: np.ndarray) -> np.ndarray:
    """A rotation whose third axis is a normal."""
    other = np.where(np.abs(normal[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    first = np.cross(other, normal)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normal, first), normal], axis=-1)


def _finger(
    joints: int, tip: dict, frame: tuple[np.ndarray, np.ndarray], rng: Rng, lanes: int
) -> tuple[dict, np.ndarray]:
    origin, axes = frame
    if joints < 1:
        stage = {"kind": "stage", "joints": 0, "base": origin, "tip": tip}
        stage["rotation"] = _quaternions(Rotation.from_matrix(axes))
        if joints < 0:
            centre, axis = 0.1 * rng.normal(size=(lanes, 3)), rng.normal(size=(lanes, 3))
            stage["turning"] = {"rate": rng.normal(size=lanes), "axis": axis, "centre": centre}
        return stage, np.zeros((lanes, int(joints < 0)))
    hinges = rng.normal(size=(lanes, joints, 3))
    hinges /= np.linalg.norm(hinges, axis=2, keepdims=True)
    ways = rng.normal(size=(lanes, joints, 3))
    offsets = (
        spread(rng, 0.02, 0.1, lanes, joints)[..., None] * ways / np.linalg.norm(ways, axis=2, keepdims=True)
    )
    masses = 0.03 * spread(rng, 1e-3, 1e3, lanes, 1) * spread(rng, 0.3, 3.0, lanes, joints)
    q = rng.uniform(-1.5, 1.5, (lanes, joints))
    at, turn = np.zeros((lanes, 3)), np.broadcast_to(np.eye(3), (lanes, 3, 3))
    for i in range(joints):
        turn = turn @ about(hinges[:, i][:, None], q[:, i : i + 1])[:, 0]
        at = at + np.einsum("lij,lj->li", turn, offsets[:, i])
    base = axes @ np.swapaxes(turn, 1, 2)
    lengths = np.sum(offsets**2, axis=-1)
    inertias = (masses * lengths * spread(rng, 0.05, 0.2, lanes, joints))[..., None, None] * np.eye(3)
    finger = {"kind": "finger", "joints": joints, "axes": hinges, "offsets": offsets, "masses": masses}
    finger |= {"centres": 0.5 * offsets, "inertias": inertias, "tip": tip}
    finger |= {"base": origin - np.einsum("lij,lj->li", base, at)}
    return finger | {"rotation": _quaternions(Rotation.from_matrix(base))}, q


def _driven(structure: Spatial, scene: dict[str, Any], rng: Rng, lanes: int, q: list[np.ndarray]) -> None:
    """Gravity or fingers that attract each other; how long a run is."""
    size, arm = scene["object"]["size"], 0.05
    if max(structure.joints) > 0:
        gain = spread(rng, 1e-2, 1e2, lanes)
        heavy = np.maximum(
            scene["object"]["mass"], np.max([f["masses"].max(axis=1) for f in scene["fingers"]], axis=0)
        )
        quiet = np.where(rng.uniform(size=lanes) < 0.4, 0.0, 1.0)
        damping = quiet * np.sqrt(gain / arm * heavy) * arm**2 * spread(rng, 1e-3, 1.0, lanes)
        pair = np.ones(len(scene["fingers"]))
        control = {"kind": "opposition", "beta": gain / arm, "damping": damping[:, None] * pair}
        control["start"] = np.stack([block.sum(axis=1) for block in q[1:]], axis=1)
        control["alpha"] = (gain * arm * spread(rng, 1e-4, 1e-1, lanes))[:, None] * pair
        scene |= {"controller": control, "gravity": None, "period": np.sqrt(heavy * arm / gain)}
    else:
        stage, contact = scene["fingers"][0], scene["contacts"][0]
        del contact
        normal = level(stage["tip"], scene["s"][:, None, :3])[1][:, 0]
        turn = turned(stage["rotation"]) @ turned(stage["tip"]["rotation"])
        down = -np.einsum("lij,lj->li", turn, normal) + 0.3 * rng.normal(size=(lanes, 3))
        down /= np.linalg.norm(down, axis=1, keepdims=True)
        strength = 9.81 * spread(rng, 0.1, 1.0, lanes)
        scene |= {"controller": {"kind": "none"}, "gravity": strength[:, None] * down}
        scene["period"] = np.sqrt(size / strength)
    scene["t1"] = scene["period"] * spread(rng, 0.1, 10.0, lanes)
    quick = np.where(rng.uniform(size=lanes) < 0.3, 0.0, spread(rng, 1e-2, 2.0, lanes))
    width = scene["q"].shape[1] - 1 - sum(f.get("turning") is not None for f in scene["fingers"])
    scene["v"] = (quick / scene["period"])[:, None] * rng.normal(size=(lanes, width))
    scene["v"][:, :3] *= size[:, None]
    scene["rtol"] = np.full(lanes, 1e-8)
