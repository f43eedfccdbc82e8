"""Grasps in space for the judge of the stress test, in NumPy alone.

The same as `judge_plane` with vectors of three numbers: arrays of shape (lanes, times, 3), rotations as
matrices. Surfaces are level sets with gradient and Hessian written out. Nothing here imports the engine.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.stress_test.judge_plane import Instant, Motion, Scene, solved

_EYE = np.eye(3)


@dataclass
class Frame:
    """A rigid frame: origin, axes (columns), spin; accelerations at zero accelerations of joints; columns.

    `velocity` is prescribed motion and joints together; `columns` are velocity and spin per unit rate.
    """

    origin: np.ndarray
    axes: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    pull: np.ndarray
    bend: np.ndarray
    columns: list[tuple[np.ndarray, np.ndarray]]


def _lane(values: np.ndarray) -> np.ndarray:
    return values[:, None]


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b, axis=-1)


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return np.einsum("...ij,...j->...i", matrix, vector)


def turned(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices of quaternions, the scalar first; they need not be unit."""
    q = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    w, u = q[..., 0, None, None], q[..., 1:]
    return _EYE * (2 * w**2 - 1) + 2 * u[..., :, None] * u[..., None, :] + 2 * w * skew(u)


def about(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotation matrices by angles about unit axes."""
    k = skew(axis)
    return _EYE + np.sin(angle)[..., None, None] * k + (1 - np.cos(angle))[..., None, None] * (k @ k)


def skew(u: np.ndarray) -> np.ndarray:
    """The matrices that take the cross product."""
    zero = np.zeros(u.shape[:-1])
    rows = [[zero, -u[..., 2], u[..., 1]], [u[..., 2], zero, -u[..., 0]], [-u[..., 1], u[..., 0], zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def level(surface: Scene, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance from a surface (to first order), outward normal and shape operator, in its own frame."""
    kind, x, y, z = surface["kind"], at[..., 0], at[..., 1], at[..., 2]
    zero, eye = np.zeros(x.shape), np.broadcast_to(_EYE, (*x.shape, 3, 3))
    if kind == "plane":
        value, slope, bend = z, np.stack([zero, zero, zero + 1], axis=-1), 0.0 * eye
    elif kind == "sphere":
        value, slope, bend = 0.5 * (_dot(at, at) - _lane(surface["radius"]) ** 2), at, eye
    elif kind == "cylinder":
        slope = np.stack([x, y, zero], axis=-1)
        value, bend = 0.5 * (x**2 + y**2 - _lane(surface["radius"]) ** 2), eye * np.array([1.0, 1.0, 0.0])
    elif kind == "ellipsoid":
        weights = 1.0 / _lane(surface["half"]) ** 2
        slope = weights * at
        value, bend = 0.5 * (_dot(slope, at) - 1), eye * weights[..., None, :]
    else:  # torus
        major, minor = _lane(surface["major"]), _lane(surface["minor"])
        radial = np.hypot(x, y)
        out = np.stack([x / radial, y / radial, zero], axis=-1)
        up = np.stack([zero, zero, zero + 1], axis=-1)
        slope = (radial - major)[..., None] * out + z[..., None] * up
        value = 0.5 * ((radial - major) ** 2 + z**2 - minor**2)
        both = out[..., :, None] * out[..., None, :]
        flat = eye * np.array([1.0, 1.0, 0.0]) - both
        bend = both + (1 - major / radial)[..., None, None] * flat + up[..., :, None] * up[..., None, :]
    size = np.linalg.norm(slope, axis=-1)
    normal = slope / size[..., None]
    flat = eye - normal[..., :, None] * normal[..., None, :]
    sign = -1.0 if surface.get("hollow") else 1.0
    return value / size, sign * normal, sign * (flat @ bend @ flat) / size[..., None, None]


class Space:
    """The equations of a scene in space."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        joints = [finger["joints"] for finger in scene["fingers"]]
        clocks = [int(finger.get("turning") is not None) for finger in scene["fingers"]]
        starts = np.concatenate([[6], 6 + np.cumsum(joints)])
        self.blocks = [slice(0, 6)] + [slice(a, b) for a, b in zip(starts[:-1], starts[1:], strict=True)]
        starts = np.concatenate([[7], 7 + np.cumsum(np.add(joints, clocks))])
        self.places = [slice(0, 7)] + [slice(a, b) for a, b in zip(starts[:-1], starts[1:], strict=True)]
        self.width = 6 + sum(joints)
        self.gravity = np.zeros((1, 1, 3)) if scene.get("gravity") is None else _lane(scene["gravity"])

    def at(self, motion: Motion) -> Instant:
        """Everything at once."""
        q, v = motion.q, motion.v
        shape = (*q.shape[:2], self.width)
        mass, bias = np.zeros((*shape, self.width)), np.zeros(shape)
        energy = [np.zeros(shape[:2])]
        frames = [self._object(q, v, mass, bias, energy)]
        each = zip(self.scene["fingers"], self.places[1:], self.blocks[1:], strict=True)
        for finger, place, block in each:
            part = (mass[..., block, block], bias[..., block])
            move = self._chain if finger["kind"] == "finger" else self._stage
            frames.append(move(finger, q[..., place], v[..., block], part, energy))
        drive, stored, loss = self._controller(frames, q, v)
        starts = np.cumsum([0, *(6 for _ in self.scene["contacts"])])
        touching = [
            self._contact(c, frames, motion.s[..., a : a + 6])
            for c, a in zip(self.scene["contacts"], starts[:-1], strict=True)
        ]
        rows = np.concatenate([t["rows"] for t in touching], axis=-2)
        wanted = -np.concatenate([t["bias"] for t in touching], axis=-1)
        pushes, rates, firmness, doubt = solved(mass, drive - bias, rows, wanted)
        given = np.concatenate([t["given"] for t in touching], axis=-1)
        creep = np.abs(np.einsum("ltmn,ltn->ltm", rows, v) + given)
        normals, rubs, at = [], [], 0
        for touch in touching:
            push = pushes[..., at : at + 3]
            # Bodies that move as prescribed take power out, or put it in.
            mine = slice(at, at + touch["given"].shape[-1])
            loss = loss + np.sum(pushes[..., mine] * touch["given"], axis=-1)
            normals.append(_dot(push, touch["normal"]))
            rubs.append(touch["normal"] * normals[-1][..., None] - push)
            at = mine.stop
        pile = lambda name: np.stack([touch[name] for touch in touching], axis=-1)  # noqa: E731
        return Instant(
            gap=pile("gap"),
            tangency=pile("tangency"),
            creep=creep,
            bend=pile("bend"),
            f=np.stack(normals, axis=-1),
            lam=np.stack(rubs, axis=-2),
            room=np.zeros((*shape[:2], 0)),
            rates=rates,
            rolling=np.concatenate([t["rolling"] for t in touching], axis=-1),
            firmness=firmness,
            kinetic=0.5 * np.einsum("lti,ltij,ltj->lt", v, mass, v),
            potential=energy[0] + stored,
            loss=loss,
            momentum=np.einsum("ltij,ltj->lti", mass, v),
            inertial=np.einsum("ltij,ltj->lti", mass, rates),
            doubt=doubt,
        )

    def velocity(self, motion: Motion) -> np.ndarray:
        """Rates of the positions: of the quaternion by half its product with the spin; clocks tick."""
        q, v = motion.q, motion.v
        w, u, spin = q[..., 3:4], q[..., 4:7], v[..., 3:6]
        turning = [-0.5 * np.sum(u * spin, axis=-1, keepdims=True), 0.5 * (w * spin + np.cross(u, spin))]
        parts = [v[..., :3], *turning]
        for place, block in zip(self.places[1:], self.blocks[1:], strict=True):
            parts.append(v[..., block])
            extra = (place.stop - place.start) - (block.stop - block.start)
            parts.append(np.ones((*q.shape[:2], extra)))
        return np.concatenate(parts, axis=-1)

    def _object(self, q: Any, v: Any, mass: Any, bias: Any, energy: list) -> Frame:
        body = self.scene["object"]
        weight, tensor = _lane(body["mass"]), _lane(body["inertia"])
        origin, axes, spin = q[..., :3], turned(q[..., 3:7]), v[..., 3:6]
        for k in range(3):
            mass[..., k, k] = weight
        mass[..., 3:, 3:][..., :3, :3] = tensor
        bias[..., :3] = -weight[..., None] * self.gravity
        bias[..., 3:6] = np.cross(spin, _times(tensor, spin))
        energy[0] = energy[0] - weight * _dot(np.broadcast_to(self.gravity, origin.shape), origin)
        zero = np.zeros(origin.shape)
        columns = [(zero + _EYE[k], zero) for k in range(3)] + [(zero, axes[..., k]) for k in range(3)]
        return Frame(origin, axes, v[..., :3], _times(axes, spin), zero, zero, columns)

    def _chain(self, finger: Scene, q: Any, v: Any, part: Any, energy: list) -> Frame:
        mass, bias = part
        zero = np.zeros((*q.shape[:2], 3))
        at, axes = (
            zero + _lane(finger["base"]),
            turned(_lane(finger["rotation"]) + np.zeros((*q.shape[:2], 4))),
        )
        velocity = spin = pull = bend = zero
        joints, hinges = [], []
        for i in range(finger["joints"]):
            hinge = _times(axes, _lane(finger["axes"][:, i]))
            joints.append(at)
            hinges.append(hinge)
            rate = hinge * v[..., i : i + 1]
            bend = bend + np.cross(spin, rate)
            spin = spin + rate
            axes = about(hinge, q[..., i]) @ axes
            arm, step = (_times(axes, _lane(finger[name][:, i])) for name in ("centres", "offsets"))
            tensor = axes @ _lane(finger["inertias"][:, i]) @ np.swapaxes(axes, -1, -2)
            weight, centre = _lane(finger["masses"][:, i]), at + arm
            force = pull + np.cross(bend, arm) + np.cross(spin, np.cross(spin, arm)) - self.gravity
            torque = _times(tensor, bend) + np.cross(spin, _times(tensor, spin))
            moves = [np.cross(h, centre - p) for h, p in zip(hinges, joints, strict=True)]
            for a in range(i + 1):
                bias[..., a] += weight * _dot(moves[a], force) + _dot(hinges[a], torque)
                for b in range(i + 1):
                    mass[..., a, b] += weight * _dot(moves[a], moves[b])
                    mass[..., a, b] += _dot(hinges[a], _times(tensor, hinges[b]))
            energy[0] = energy[0] - weight * _dot(np.broadcast_to(self.gravity, centre.shape), centre)
            pull = pull + np.cross(bend, step) + np.cross(spin, np.cross(spin, step))
            velocity = velocity + np.cross(spin, step)
            at = at + step
        columns = [(np.cross(h, at - p), h) for h, p in zip(hinges, joints, strict=True)]
        return Frame(at, axes, velocity, spin, pull, bend, columns)

    def _stage(self, stage: Scene, q: Any, v: Any, part: Any, energy: list) -> Frame:
        zero = np.zeros((*q.shape[:2], 3))
        base, axes = (
            zero + _lane(stage["base"]),
            turned(_lane(stage["rotation"]) + np.zeros((*q.shape[:2], 4))),
        )
        turning = stage.get("turning")
        if turning is None:
            return Frame(base, axes, zero, zero, zero, zero, [])
        axis = _lane(turning["axis"] / np.linalg.norm(turning["axis"], axis=-1, keepdims=True)) + zero
        centre = _lane(turning["centre"]) + zero
        own = about(axis, _lane(turning["rate"]) * q[..., 0])
        spin = _times(axes, axis) * _lane(turning["rate"])[..., None]
        arm = -_times(axes, _times(own, centre))
        velocity = np.cross(spin, arm)
        origin = base + _times(axes, centre) + arm
        return Frame(origin, axes @ own, velocity, spin, np.cross(spin, velocity), zero, [])

    def _controller(self, frames: list[Frame], q: Any, v: Any) -> tuple[Any, Any, Any]:
        control, drive = self.scene["controller"], np.zeros((*q.shape[:2], self.width))
        stored, loss = np.zeros(q.shape[:2]), np.zeros(q.shape[:2])
        tips = frames[1:]
        for i, (tip, block) in enumerate(zip(tips, self.blocks[1:], strict=True)):
            count = block.stop - block.start
            angles, rates = q[..., self.places[1 + i].start :][..., :count], v[..., block]
            if control["kind"] == "none" or not count:
                continue
            others = [other.origin for j, other in enumerate(tips) if j != i]
            pull = sum(tip.origin - other for other in others) * _lane(control["beta"])[..., None]
            turn = np.sum(angles, axis=-1) - _lane(control["start"][:, i])
            alpha, gain = _lane(control["alpha"][:, i]), _lane(control["damping"][:, i])
            pairs = sum(_dot(tip.origin - o, tip.origin - o) for o in others)
            # Every pair is met twice.
            stored = stored + 0.25 * pairs * _lane(control["beta"]) + 0.5 * alpha * turn**2
            for k, (move, _) in enumerate(tip.columns):
                drive[..., block.start + k] = -_dot(move, pull) - alpha * turn - gain * rates[..., k]
            loss = loss + gain * np.sum(rates**2, axis=-1)
        return drive, stored, loss

    def _contact(self, contact: Scene, frames: list[Frame], s: np.ndarray) -> dict[str, Any]:
        number = 1 + contact["finger"]
        tip, body = frames[number], frames[0]
        shapes = (self.scene["fingers"][contact["finger"]]["tip"], self.scene["surfaces"][contact["surface"]])
        found = []
        for frame, shape, at in zip((tip, body), shapes, (s[..., :3], s[..., 3:]), strict=True):
            off, normal, bend = level(shape, at)
            axes = frame.axes @ turned(_lane(shape["rotation"]))
            arm = _times(frame.axes, _lane(shape["offset"])) + _times(axes, at)
            bend = axes @ bend @ np.swapaxes(axes, -1, -2)
            found.append((arm, _times(axes, normal), bend, axes, np.abs(off)))
        (arm_a, normal_a, bend_a, axes_a, off_a), (arm_b, normal, bend_b, axes_b, off_b) = found
        turning, both = tip.spin - body.spin, bend_a + bend_b
        size = np.sqrt(np.sum(bend_a**2, axis=(-1, -2)) + np.sum(bend_b**2, axis=(-1, -2)))
        square = normal[..., :, None] * normal[..., None, :]
        flat = _EYE - square
        own = flat @ both @ flat
        whole = own + size[..., None, None] * square
        rolling = _safe_solve(whole, np.cross(turning, normal))
        rows = np.zeros((*s.shape[:2], 3 + (contact["spin"] == "prevented"), self.width))
        for frame, arm, block, sign in (
            (tip, arm_a, self.blocks[number], 1),
            (body, arm_b, self.blocks[0], -1),
        ):
            for k, (velocity, spin) in enumerate(frame.columns):
                rows[..., :3, block.start + k] += sign * (velocity + np.cross(spin, arm))
                if contact["spin"] == "prevented":
                    rows[..., 3, block.start + k] += sign * _dot(normal, spin) * _ARM
        bias = [
            f.pull + np.cross(f.bend, arm) + np.cross(f.spin, np.cross(f.spin, arm) + rolling)
            for f, arm in ((tip, arm_a), (body, arm_b))
        ]
        bias, given = bias[0] - bias[1], 0.0 * rolling
        if not tip.columns:
            given = tip.velocity + np.cross(tip.spin, arm_a)
        if contact["spin"] == "prevented":
            change = np.cross(body.spin, normal) + _times(bend_b, rolling)
            more = _dot(normal, tip.bend - body.bend) + _dot(change, turning)
            bias = np.concatenate([bias, _ARM * more[..., None]], axis=-1)
            spun = _dot(normal, tip.spin) if not tip.columns else 0.0 * more
            given = np.concatenate([given, _ARM * spun[..., None]], axis=-1)
        good = np.isfinite(own).all(axis=(-1, -2))
        values = np.linalg.eigvalsh(np.where(good[..., None, None], whole, _EYE))
        gap = tip.origin + arm_a - body.origin - arm_b
        return {
            "gap": np.linalg.norm(gap, axis=-1) + off_a + off_b,
            "tangency": np.linalg.norm(normal_a + normal, axis=-1),
            "bend": np.where(good, values[..., 0] / size, np.nan),
            "rows": rows,
            "bias": bias,
            "given": given,
            "normal": normal,
            "rolling": np.concatenate(
                [_times(np.swapaxes(axes, -1, -2), rolling) for axes in (axes_a, axes_b)], axis=-1
            ),
        }


# The row that prevents spin is the rate of an angle times this length [m].
_ARM = 0.01


def _safe_solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    good = np.isfinite(matrix).all(axis=(-1, -2)) & (np.abs(np.linalg.det(matrix)) > 0)
    found = np.linalg.solve(np.where(good[..., None, None], matrix, _EYE), right[..., None])[..., 0]
    return np.where(good[..., None], found, np.nan)
