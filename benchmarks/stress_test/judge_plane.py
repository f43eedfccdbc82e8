"""Planar grasps for the judge of the stress test, in NumPy alone.

A scene is a plain dictionary of numbers with a lane axis in front; a motion has positions, velocities and
rolling coordinates of shape (lanes, times, ...). Vectors are complex numbers, the equations of motion are
Newton and Euler's for every link about its own centre of mass, and constraints and accelerations are solved
together, as one linear system. Nothing here imports the engine.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.stress_test.judge_contours import along, ends, Place

Scene = dict[str, Any]


@dataclass
class Motion:
    """Positions, velocities, rolling coordinates: shapes (lanes, times, n), the same, (lanes, times, c)."""

    q: np.ndarray
    v: np.ndarray
    s: np.ndarray


@dataclass
class Body:
    """A rigid frame: origin, angle, spin, acceleration of the origin at zero joint accelerations, columns.

    `moves` are the velocities of the origin per unit rate, `turns` its spins.
    """

    origin: np.ndarray
    angle: np.ndarray
    spin: np.ndarray
    pull: np.ndarray
    moves: list[np.ndarray]
    turns: list[float]


@dataclass
class Instant:
    """All the judge knows of a motion at its times.

    Attributes:
        gap: Per contact, complex [m].
        tangency: Per contact, angle between the tangents [rad].
        creep: Per contact, velocity of the fingertip's material over the object's [m/s], complex.
        bend: Per contact, sum of curvatures over the sum of their sizes.
        f: Per contact, normal force, positive when pressing [N].
        lam: Per contact, tangential force in the chapter's sign [N].
        room: Distances from the ends of open contours [m], per contour end.
        rates: Accelerations.
        rolling: Rates of the rolling coordinates.
        firmness: Smallest over largest singular value of the constraints, scaled by masses.
        kinetic: [J].
        potential: Of gravity and controller [J].
        loss: Power taken out by dampers [W].
        momentum: Mass matrix times velocities.
        inertial: Mass matrix times accelerations.
        doubt: What accelerations are known to, over the rounding of one.
    """

    gap: np.ndarray
    tangency: np.ndarray
    creep: np.ndarray
    bend: np.ndarray
    f: np.ndarray
    lam: np.ndarray
    room: np.ndarray
    rates: np.ndarray
    rolling: np.ndarray
    firmness: np.ndarray
    kinetic: np.ndarray
    potential: np.ndarray
    loss: np.ndarray
    momentum: np.ndarray
    inertial: np.ndarray
    doubt: np.ndarray


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (np.conj(a) * b).imag


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (np.conj(a) * b).real


def _col(values: np.ndarray) -> np.ndarray:
    return values[:, None]


def _point(values: np.ndarray) -> np.ndarray:
    return (values[:, 0] + 1j * values[:, 1])[:, None]


class Plane:
    """The equations of a planar scene."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.object = scene["object"]
        self.sizes = [3 if self.object["kind"] == "free" else 1]
        self.sizes += [finger["joints"] for finger in scene["fingers"]]
        starts = np.concatenate([[0], np.cumsum(self.sizes)])
        self.blocks = [slice(a, b) for a, b in zip(starts[:-1], starts[1:], strict=True)]
        self.width = int(starts[-1])
        gravity = scene.get("gravity")
        self.gravity = 0.0 if gravity is None else _point(gravity)

    def at(self, motion: Motion) -> Instant:
        """Everything at once."""
        q, v = motion.q, motion.v
        shape = (*q.shape[:2], self.width)
        mass, bias = np.zeros((*shape, self.width)), np.zeros(shape)
        energy = [np.zeros(shape[:2]), np.zeros(shape[:2])]
        frames = [self._object(q, v, mass, bias, energy)]
        for finger, block in zip(self.scene["fingers"], self.blocks[1:], strict=True):
            part = (mass[..., block, block], bias[..., block])
            move = self._chain if finger["kind"] == "finger" else self._jaw
            frames.append(move(finger, q[..., block], v[..., block], part, energy))
        drive, stored, loss = self._controller(frames, q, v)
        touching = [self._contact(c, frames, motion.s[..., i]) for i, c in enumerate(self.scene["contacts"])]
        rows = np.concatenate([np.stack([t["columns"].real, t["columns"].imag]) for t in touching])
        rows = np.moveaxis(rows, (0, 1), (-2, -1))
        wanted = -np.stack([x for t in touching for x in (t["bias"].real, t["bias"].imag)], axis=-1)
        pushes, rates, firmness, doubt = solved(mass, drive - bias, rows, wanted)
        forces = pushes[..., 0::2] + 1j * pushes[..., 1::2]
        kinetic = 0.5 * np.einsum("lti,ltij,ltj->lt", v, mass, v)
        normals, rubs, creeps = [], [], []
        for contact, touch, force in zip(
            self.scene["contacts"], touching, np.moveaxis(forces, -1, 0), strict=True
        ):
            normals.append(_dot(-1j * touch["tangent"], force))
            rubs.append(-contact["sense"] * _dot(touch["tangent"], force))
            creeps.append(sum(column * v[..., k] for k, column in enumerate(touch["columns"])))
        pile = lambda name: np.stack([touch[name] for touch in touching], axis=-1)  # noqa: E731
        room = [r for touch in touching for r in touch["room"]]
        return Instant(
            gap=pile("gap"),
            tangency=pile("tangency"),
            creep=np.stack(creeps, axis=-1),
            bend=pile("bend"),
            f=np.stack(normals, axis=-1),
            lam=np.stack(rubs, axis=-1),
            room=np.stack(room, axis=-1) if room else np.zeros((*shape[:2], 0)),
            rates=rates,
            rolling=pile("rolling"),
            firmness=firmness,
            kinetic=kinetic,
            potential=energy[1] + stored,
            loss=loss,
            momentum=np.einsum("ltij,ltj->lti", mass, v),
            inertial=np.einsum("ltij,ltj->lti", mass, rates),
            doubt=doubt,
        )

    def velocity(self, motion: Motion) -> np.ndarray:
        """Rates of the positions."""
        return motion.v

    def _object(self, q: Any, v: Any, mass: Any, bias: Any, energy: list) -> Body:
        body, zero = self.object, np.zeros(q.shape[:2], complex)
        if body["kind"] == "pivoted":
            mass[..., 0, 0] = _col(body["inertia"])
            origin, angle = zero + _point(body["pivot"]), q[..., 0]
            if "mass" in body:
                arm = np.exp(1j * angle) * _point(body["centre"])
                bias[..., 0] = -_col(body["mass"]) * _cross(arm, self.gravity + zero)
                energy[1] = energy[1] - _col(body["mass"]) * _dot(self.gravity + zero, arm)
            return Body(origin, angle, v[..., 0], zero, [zero], [1.0])
        weight = _col(body["mass"])
        for k in range(2):
            mass[..., k, k] = weight
        mass[..., 2, 2] = _col(body["inertia"])
        pull = -weight * (self.gravity + zero)
        bias[..., 0], bias[..., 1] = pull.real, pull.imag
        origin = q[..., 0] + 1j * q[..., 1]
        energy[1] = energy[1] - weight * _dot(self.gravity + zero, origin)
        return Body(origin, q[..., 2], v[..., 2], zero, [zero + 1.0, zero + 1j, zero], [0.0, 0.0, 1.0])

    def _chain(self, finger: Scene, q: Any, v: Any, part: Any, energy: list) -> Body:
        mass, bias = part
        angles, spins = np.cumsum(q, axis=-1), np.cumsum(v, axis=-1)
        joints, pull = [np.zeros(q.shape[:2], complex) + _point(finger["base"])], 0.0j
        for i in range(finger["joints"]):
            link = np.exp(1j * angles[..., i])
            reach, half = _col(finger["lengths"][:, i]), _col(finger["centres"][:, i])
            weight, inertia = _col(finger["masses"][:, i]), _col(finger["inertias"][:, i])
            centre = joints[i] + half * link
            turned = pull - spins[..., i] ** 2 * half * link - self.gravity
            arms = [1j * (centre - joints[a]) for a in range(i + 1)]
            for a, left in enumerate(arms):
                bias[..., a] += weight * _dot(left, turned)
                for b, right in enumerate(arms):
                    mass[..., a, b] += weight * _dot(left, right) + inertia
            energy[1] = energy[1] - weight * _dot(self.gravity + 0.0 * centre, centre)
            pull = pull - spins[..., i] ** 2 * reach * link
            joints.append(joints[i] + reach * link)
        moves = [1j * (joints[-1] - joint) for joint in joints[:-1]]
        return Body(joints[-1], angles[..., -1], spins[..., -1], pull, moves, [1.0] * len(moves))

    def _jaw(self, jaw: Scene, q: Any, v: Any, part: Any, energy: list) -> Body:
        mass, bias = part
        zero = np.zeros(q.shape[:2], complex)
        origin, moves = zero + _point(jaw["base"]), []
        weight = _col(jaw["mass"])
        for k in range(jaw["joints"]):
            moves.append(zero + np.exp(1j * _col(jaw["directions"][:, k])))
            origin = origin + moves[k] * q[..., k]
        for a, left in enumerate(moves):
            bias[..., a] = -weight * _dot(left, self.gravity + zero)
            for b, right in enumerate(moves):
                mass[..., a, b] = weight * _dot(left, right)
        energy[1] = energy[1] - weight * _dot(self.gravity + zero, origin)
        return Body(origin, zero.real + _col(jaw["angle"]), zero.real, zero, moves, [0.0] * len(moves))

    def _controller(self, frames: list[Body], q: Any, v: Any) -> tuple[Any, Any, Any]:
        control, drive = self.scene["controller"], np.zeros((*q.shape[:2], self.width))
        stored, loss = np.zeros(q.shape[:2]), np.zeros(q.shape[:2])
        tips = frames[1:]
        for i, (tip, block) in enumerate(zip(tips, self.blocks[1:], strict=True)):
            angles, rates = q[..., block], v[..., block]
            if control["kind"] == "press":
                pull = (tip.origin - _point(control["target"])) * _col(control["force"] / control["radius"])
                gains, stored = (
                    _col(control["damping"]),
                    stored + 0.5 * _dot(pull, tip.origin - _point(control["target"])),
                )
                torque = [-_dot(move, pull) for move in tip.moves]
            elif control["kind"] == "opposition":
                others = [other.origin for j, other in enumerate(tips) if j != i]
                pull = sum(tip.origin - other for other in others) * _col(control["beta"])
                turn = np.sum(angles, axis=-1) - _col(control["start"][:, i])
                alpha, gains = _col(control["alpha"][:, i]), _col(control["damping"][:, i])
                # Every pair is met twice.
                stored = stored + 0.25 * sum(np.abs(tip.origin - o) ** 2 for o in others) * _col(
                    control["beta"]
                )
                stored = stored + 0.5 * alpha * turn**2
                torque = [-_dot(move, pull) - alpha * turn for move in tip.moves]
            elif control["kind"] == "servo":
                gain, gains = _col(control["gain"]), _col(control["damping"])
                aside = angles - control["wanted"][i][:, None, :]
                stored = stored + 0.5 * gain * np.sum(aside**2, axis=-1)
                push = control["push"][i][:, None, :]
                stored = stored - np.sum(push * angles, axis=-1)
                torque = [push[..., k] - gain * aside[..., k] for k in range(angles.shape[-1])]
            else:
                torque, gains = [0.0 * angles[..., k] for k in range(angles.shape[-1])], 0.0
            for k, part in enumerate(torque):
                drive[..., block.start + k] = part - gains * rates[..., k]
                loss = loss + gains * rates[..., k] ** 2
        return drive, stored, loss

    def _contact(self, contact: Scene, frames: list[Body], sigma: np.ndarray) -> dict[str, Any]:
        tip, body = frames[1 + contact["finger"]], frames[0]
        shapes = (self.scene["fingers"][contact["finger"]]["tip"], self.scene["faces"][contact["face"]])
        places = (_col(contact["s_tip"]) + sigma, _col(contact["s_object"]) - sigma)
        own, face = (along(shape, s) for shape, s in zip(shapes, places, strict=True))
        arms = [np.exp(1j * b.angle) * p.point for b, p in ((tip, own), (body, face))]
        tangents = [np.exp(1j * b.angle) * p.tangent for b, p in ((tip, own), (body, face))]
        rolling = (body.spin - tip.spin) / (own.curvature + face.curvature)
        columns = np.zeros((self.width, *sigma.shape), complex)
        for frame, arm, number, sign in (
            (tip, arms[0], 1 + contact["finger"], 1.0),
            (body, arms[1], 0, -1.0),
        ):
            for k, (move, turn) in enumerate(zip(frame.moves, frame.turns, strict=True)):
                columns[self.blocks[number].start + k] += sign * (move + 1j * turn * arm)
        # The contact's points move over both bodies: their arms change by more than a turn.
        bias = tip.pull + 1j * tip.spin * (1j * tip.spin * arms[0] + tangents[0] * rolling)
        bias = bias - body.pull - 1j * body.spin * (1j * body.spin * arms[1] - tangents[1] * rolling)
        room = []
        for shape, s in zip(shapes, places, strict=True):
            limits = ends(shape)
            room += [] if limits is None else [s - _col(limits[0]), _col(limits[1]) - s]
        return {
            "gap": tip.origin + arms[0] - body.origin - arms[1],
            "tangency": np.angle(-tangents[0] / tangents[1]),
            "bend": _relative_sum(own, face),
            "rolling": rolling,
            "columns": columns,
            "bias": bias,
            "tangent": tangents[1],
            "room": room,
        }


def solved(mass: Any, drive: Any, rows: Any, wanted: Any) -> tuple[Any, Any, Any, Any]:
    """Forces on the fingertips, accelerations, firmness and doubt, from one system scaled by the masses."""
    n, m = drive.shape[-1], rows.shape[-2]
    scale = 1.0 / np.sqrt(np.einsum("...ii->...i", mass))
    unit = mass * scale[..., :, None] * scale[..., None, :]
    rows = rows * scale[..., None, :]
    sizes = np.linalg.norm(rows, axis=-1)
    rows, wanted = rows / sizes[..., None], wanted / sizes
    whole = np.zeros((*drive.shape[:2], n + m, n + m))
    whole[..., :n, :n], whole[..., n:, :n] = unit, rows
    whole[..., :n, n:] = -np.swapaxes(rows, -1, -2)
    right = np.concatenate([drive * scale, wanted], axis=-1)
    good = np.isfinite(whole).all(axis=(-1, -2)) & np.isfinite(right).all(axis=-1)
    whole = np.where(good[..., None, None], whole, np.eye(n + m))
    try:
        found = np.linalg.solve(whole, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        found = np.einsum("...ij,...j->...i", np.linalg.pinv(whole), right)
    found = np.where(good[..., None], found, np.nan)
    pushes = found[..., n:] / sizes
    # Columns whitened by the masses: what is left of the rows is geometry.
    lower = np.linalg.cholesky(whole[..., :n, :n])
    clean = np.where(good[..., None, None], rows, np.eye(m, n))
    spread = np.linalg.svd(np.linalg.solve(lower, np.swapaxes(clean, -1, -2)), compute_uv=False)
    firmness = np.where(good, spread[..., -1] / spread[..., 0], np.nan)
    # A grasp that cannot move accelerates by the rounding of what its forces would do to it alone.
    doubt = scale * np.linalg.norm(right, axis=-1, keepdims=True) / firmness[..., None] ** 2
    return pushes, found[..., :n] * scale, firmness, doubt


def _relative_sum(own: Place, face: Place) -> np.ndarray:
    size = np.abs(own.curvature) + np.abs(face.curvature)
    return (own.curvature + face.curvature) / np.where(size > 0, size, 1.0)
