r"""A spatial finger in the frames of its joints: what `Finger3` is evaluated as.

The frame of a joint has the joint's axis as its third axis, so that turning the joint by $q$ mixes the first
two alone: $x' = \cos q\,x + \sin q\,y$, $y' = \cos q\,y - \sin q\,x$. What leads from one such frame to the
next does not change with the joint angles, and is worked out once for a run (`chain_of`); in the frames that
a user thinks in (`Finger3`) a joint would take Rodrigues' formula, with twice as many operations.

Mass matrix and bias come from one pass over the links, from the tip inwards. All moments are about the base
$b$, where those of several bodies add up: with first moment $c$ and inertia $J$ of all links beyond joint $i$
(`_Beyond`), and with the velocity $w_i = (p_i - b) \times a_i$ that a unit rate of joint $i$, at $p_i$ with
axis $a_i$, gives the point of the body at the base,

$$ M_{ij} = a_j \cdot (J a_i + c \times w_i) + w_j \cdot (a_i \times c + m\,w_i), \qquad j \le i. $$
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._linalg import plus, Pose3, rotation, sincos, square, Sym3, tangents, total, Twist3, unstack, Vec3
from .._types import Scalar, Scalars
from .._xla import at_once, once
from ..contact import Motion
from ..geometry import AbstractSurface
from ._body import AbstractFinger, Inertia, Spin

_STILL = Vec3(0.0, 0.0, 0.0)


class _Link(eqx.Module):
    """A link in the frame of its joint.

    Attributes:
        x: First axis of the joint's frame at angle zero, in the frame of the joint before; of the first joint
            in the world.
        y: The second axis likewise. The third is their cross product.
        offset: To the next joint, or to the tip [m].
        centre: Centre of mass [m].
        inertia: Upper triangle of the inertia tensor about the centre of mass, row by row [kg m^2].
        mass: In kilograms.
    """

    x: Scalars
    y: Scalars
    offset: Scalars
    centre: Scalars
    inertia: Scalars
    mass: Scalar


class _Posture(NamedTuple):
    """A chain at one configuration.

    Attributes:
        frames: Of all joints; the origins, here and in `tip`, are from the base, in world axes.
        tip: The tip frame.
    """

    frames: tuple[Pose3, ...]
    tip: Pose3


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class _Beyond:
    """One link, or several as one body: its moments about the base, and the wrench that its motion needs.

    Attributes:
        mass: Mass [kg].
        moment: First moment, sum of m r [kg m].
        second: Inertia tensor in world axes [kg m^2].
        force: Sum of m (a - g) [N], with the accelerations a at zero joint accelerations.
        torque: Torque of these forces, and of the turning of each link [N m].
    """

    mass: Scalar
    moment: Vec3
    second: Sym3
    force: Vec3
    torque: Vec3

    def __add__(self, other: "_Beyond") -> "_Beyond":
        return _Beyond(
            self.mass + other.mass,
            self.moment + other.moment,
            self.second + other.second,
            self.force + other.force,
            self.torque + other.torque,
        )


class Chain3(AbstractFinger):
    """A `Finger3` ready for evaluation.

    Attributes:
        base: The first joint [m].
        links: From the base to the tip.
        tip_x: First axis of the tip frame, in the frame of the last joint.
        tip_y: The second axis likewise.
        tip: Surface of the fingertip, ready for evaluation.
        armature: Inertias of the joints' rotors [kg m^2]; None without any.
        limits: Least and largest angle of every joint [rad], where there are limits.
        torque_limits: Largest torque of every joint [N m], where there are limits.
        link_radius: Radius of the links as capsules [m]; None without.
    """

    base: Scalars
    links: tuple[_Link, ...]
    tip_x: Scalars
    tip_y: Scalars
    tip: AbstractSurface
    armature: Scalars | None
    limits: tuple[Scalars, ...] | None
    torque_limits: Scalars | None
    link_radius: Scalar | None

    @property
    def joints(self) -> int:
        return len(self.links)

    @property
    def size(self) -> Scalar:
        return total([Vec3(*link.offset).norm() for link in self.links]) / self.joints

    @property
    def turns(self) -> bool:
        return True

    def prepared(self) -> "Chain3":
        return self

    def placed(self, q: Scalars) -> tuple[Pose3, Spin]:
        posture = self._posture(q)
        axes = [frame.z for frame in posture.frames]
        return self._tip(posture), lambda v: total([axis * rate for axis, rate in zip(axes, v, strict=True)])

    def skeleton(self, q: Scalars) -> tuple[Vec3, ...]:
        posture = self._posture(q)
        return tuple(Vec3(*self.base) + frame.origin for frame in (*posture.frames, posture.tip))

    def motion(self, q: Scalars, v: Scalars, gravity: Vec3 | None) -> tuple[Motion, Inertia]:
        posture = self._posture(q)
        spins, bends, pulls = _biases(posture, v)
        units = tuple(
            Twist3(frame.z.cross(posture.tip.origin - frame.origin), frame.z) for frame in posture.frames
        )
        velocity = total([unit.velocity * rate for unit, rate in zip(units, v, strict=True)])
        motion = Motion(
            self._tip(posture), once(units), once(Twist3(velocity, spins[-1])), Twist3(pulls[-1], bends[-1])
        )
        each = zip(self.links, posture.frames, spins, bends, pulls, strict=False)
        inertia = _inertia(posture.frames, [_about_base(*link, gravity) for link in each])
        if self.armature is None:
            return motion, inertia
        rows = [(*row[:-1], row[-1] + own) for row, own in zip(inertia.mass, self.armature, strict=True)]
        return motion, Inertia(tuple(rows), inertia.force)

    def gravity_potential(self, q: Scalars, gravity: Vec3) -> Scalar:
        each = zip(self.links, self._posture(q).frames, strict=True)
        base = Vec3(*self.base)
        return total([-gravity.dot(base + f.place(Vec3(*link.centre))) * link.mass for link, f in each])

    def _posture(self, q: Scalars) -> _Posture:
        """The chain at these joint angles, from the base to the tip."""
        # `origin`, `x` and `y` are the next frame before its joint turns: at first that of the first joint.
        origin, x, y, frames = _STILL, Vec3(*self.links[0].x), Vec3(*self.links[0].y), []
        ahead = [
            *((Vec3(*link.x), Vec3(*link.y)) for link in self.links[1:]),
            (Vec3(*self.tip_x), Vec3(*self.tip_y)),
        ]
        for link, angle, following in zip(self.links, q, ahead, strict=True):
            sin, cos = sincos(angle)
            first, second = once((x * cos + y * sin, y * cos - x * sin))
            at = Pose3(origin, first, second, once(first.cross(second)))
            frames.append(at)
            origin, x, y = once((at.place(Vec3(*link.offset)), *map(at.turn, following)))
        return _Posture(tuple(frames), Pose3(origin, x, y, once(x.cross(y))))

    def _tip(self, posture: _Posture) -> Pose3:
        """The tip frame in the world."""
        tip = posture.tip
        return Pose3(once(Vec3(*self.base) + tip.origin), tip.x, tip.y, tip.z)


def _biases(posture: _Posture, v: Scalars) -> tuple[list[Vec3], list[Vec3], list[Vec3]]:
    """Spins and angular accelerations of the links, accelerations of the joints and of the tip frame.

    Three lists, of k, k and k + 1 vectors; accelerations are those at zero joint accelerations.
    """
    # Link i turns against the one before at a_i v_i, and that axis itself turns with the link before.
    frames = posture.frames
    ends = [*(frame.origin for frame in frames[1:]), posture.tip.origin]
    spins, bends, pulls = [], [], [_STILL]
    for i, (frame, end) in enumerate(zip(frames, ends, strict=True)):
        rate = frame.z * v[i]
        spins.append(once(spins[-1] + rate) if i else rate)
        bends.append(once(bends[-1] + spins[i - 1].cross(rate)) if i else _STILL)
        pulls.append(once(pulls[-1] + _centripetal(spins[i], bends[i], end - frame.origin)))
    return spins, bends, pulls


def _centripetal(spin: Vec3, bend: Vec3, arm: Vec3) -> Vec3:
    r"""Acceleration of an arm's end less its start's: $\dot\omega\times r + \omega\times(\omega\times r)$.

    `bend` is $\dot\omega$, the angular acceleration.
    """
    return bend.cross(arm) + spin.cross(spin.cross(arm))


def _about_base(
    link: _Link, frame: Pose3, spin: Vec3, bend: Vec3, pull: Vec3, gravity: Vec3 | None
) -> _Beyond:
    """One link alone; `pull` is its joint's acceleration."""
    arm = once(frame.turn(Vec3(*link.centre)))
    tensor = once(_turned(Sym3(*link.inertia), frame))
    centre = once(frame.origin + arm)
    pull = pull + _centripetal(spin, bend, arm)
    force = once((pull if gravity is None else pull - gravity) * link.mass)
    # Euler's equation, I w' + w x I w, and the torque of the force at the centre of mass.
    torque = tensor.apply(bend) + spin.cross(tensor.apply(spin)) + centre.cross(force)
    # Second moment of a point mass: m (|r|^2 - r r^T).
    moment, away = centre * link.mass, centre.dot(centre) * link.mass
    second = tensor + Sym3(away, 0.0, 0.0, away, 0.0, away) - square(centre) * link.mass
    return _Beyond(link.mass, moment, second, force, torque)


def _turned(tensor: Sym3, frame: Pose3) -> Sym3:
    """`Sym3.turned` with a fifth fewer operations: what is left of the trace is the last entry.

    Rotations keep the trace, and a chain's frames are rotations to rounding. An object's is one only where
    its quaternion has unit length, from which the stages of a step depart.
    """
    x, y, z = (Vec3(*axes) for axes in zip(frame.x, frame.y, frame.z, strict=True))
    ax, ay = tensor.apply(x), tensor.apply(y)
    xx, yy = x.dot(ax), y.dot(ay)
    return Sym3(xx, x.dot(ay), z.dot(ax), yy, z.dot(ay), tensor.trace() - xx - yy)


def _inertia(frames: Sequence[Pose3], links: Sequence[_Beyond]) -> Inertia:
    """Mass matrix and bias, joint by joint from the tip inwards."""
    rates = [once(frame.origin.cross(frame.z)) for frame in frames]
    rows, forces, beyond = [], [], None
    for i in reversed(range(len(frames))):
        beyond = links[i] if beyond is None else once(beyond + links[i])
        axis, rate = frames[i].z, rates[i]
        # Rate of the momentum, linear and about the base, as joint i gathers speed at a unit rate.
        push = axis.cross(beyond.moment) + rate * beyond.mass
        twist = beyond.second.apply(axis) + beyond.moment.cross(rate)
        rows.append(tuple(_work(frames[j].z, rates[j], twist, push) for j in range(i + 1)))
        forces.append(_work(axis, rate, beyond.torque, beyond.force))
    return once(Inertia(tuple(reversed(rows)), tuple(reversed(forces))))


def _work(axis: Vec3, rate: Vec3, torque: Vec3, force: Vec3) -> Scalar:
    """Power of a wrench about the base per unit rate of a joint."""
    return plus(axis.dot(torque), rate.dot(force))


@at_once
def unit(xp: Any, vectors: Array) -> Array:
    """Vectors along the last axis, scaled to unit length."""
    return vectors / xp.linalg.norm(vectors, axis=-1, keepdims=True)


def chain_of(finger: Any) -> Chain3:
    """A `Finger3` in the frames of its joints."""
    # Scaled once more: `tree_at`, or a step along a gradient, may have changed a length.
    dots = functools.partial(jnp.einsum, precision="highest")
    normal = Vec3(*unit(finger.axes).T)
    # K_i: its rows are the axes of joint i's frame, in those of the link.
    own = jnp.stack([axis.array() for axis in (*tangents(normal), normal)], axis=1)
    base = jnp.stack([axis.array() for axis in rotation(tuple(unit(finger.rotation)))], axis=1)
    # The frame of joint i in that of the one before: the columns of K_{i-1} K_i^T. The base comes first in
    # place of a frame, and the tip frame last, whose axes are its link's.
    before = jnp.concatenate([base[None], own])
    after = jnp.concatenate([own, jnp.eye(3, dtype=own.dtype)[None]])
    steps = dots("krc,kjc->jkr", before, after)
    vectors = dots("krc,nkc->nkr", own, jnp.stack([finger.offsets, finger.centres]))
    tensors = dots("krc,kcd,ksd->krs", own, finger.inertias, own)
    upper = jnp.stack([tensors[:, r, c] for r in range(3) for c in range(r, 3)], axis=-1)
    x, y, offsets, centres, inertias, masses = map(unstack, (*steps[:2], *vectors, upper, finger.masses))
    links = tuple(map(_Link, x[:-1], y[:-1], offsets, centres, inertias, masses))
    armature, *limits = map(unstack, (finger.armature, finger.limits, finger.torque_limits))
    tip, beside = finger.tip.prepared(), (limits[0], limits[1], finger.link_radius)
    return Chain3(unstack(finger.base), links, x[-1], y[-1], tip, armature, *beside)
