r"""A spatial finger: a serial chain of links on revolute joints, with a surface at its end.

As in `_finger`, mass matrix and bias come from one pass over composite bodies, here with inertia tensors:
$M_{ij} = a_j \cdot (J a_i + (p_i - p_j) \times (a_i \times c))$ for joints $j \le i$ at $p$ with axes $a$,
where $c$ and $J$ are first moment and inertia, about joint $i$, of all links from there to the tip.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._linalg import (
    normalised,
    outer as product,
    Pose3,
    pose_at,
    sincos,
    square,
    Sym3,
    total,
    Twist3,
    unstack,
    Vec3,
)
from .._results import as_count, as_floats, check_direction, check_instance, check_positive
from .._types import Given, Scalar, Scalars
from .._xla import once
from ..contact import Motion
from ..geometry import AbstractSurface
from ._body import Inertia, Spin
from ._finger import AbstractFinger, check_links
from ._object3 import check_inertia

# Default inertias are those of solid cylinders, with this radius relative to the mean length of the links.
_THICKNESS = 0.1


class _Chain(NamedTuple):
    """A chain at one configuration: link frames (their origins are the joints), joint axes, tip frame."""

    links: tuple[Pose3, ...]
    axes: tuple[Vec3, ...]
    tip: Pose3


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class _Outer:
    """All links from one joint to the tip as one body: its moments about that joint, and the forces it needs.

    Attributes:
        mass: Mass [kg].
        moment: First moment, sum of m r from the joint [kg m].
        second: Inertia tensor about the joint, in world axes [kg m^2].
        force: Sum of m (a - g) [N], with the accelerations a at zero joint accelerations.
        torque: Torque of these forces, and of the turning of each link, about the joint [N m].
    """

    mass: Scalar
    moment: Vec3
    second: Sym3
    force: Vec3
    torque: Vec3


def as_surface(name: str, surface: Any) -> AbstractSurface:
    """Raise unless an argument is a surface."""
    return check_instance(name, surface, AbstractSurface, "a surface")


def as_direction(name: str, vectors: Array) -> Array:
    """Vectors scaled to unit length."""
    check_direction(name, vectors)
    return vectors / jnp.linalg.norm(vectors, axis=-1, keepdims=True)


def _as_axes(name: str, axes: Array) -> Array:
    return as_direction(name, check_links(name, axes))


class Finger3(AbstractFinger):
    r"""A chain of $k$ revolute joints in space.

    With all joint angles zero every link's frame has the axes of the base. Link $i$ turns by $q_i$ about
    `axes[i]`, given in its own frame (and so in that of the link before); `offsets[i]` leads from its joint
    to the next one, the last of them to the tip frame, whose axes are the last link's.

    Args:
        axes: Shape (k, 3), joint axes; scaled to unit length.
        offsets: Shape (k, 3), in metres.
        masses: Shape (k,), link masses [kg].
        tip: Surface of the fingertip in the tip frame.
        base: Shape (3,), position of the first joint [m].
        rotation: Quaternion (scalar first) of the base's axes; scaled to unit length.
        centres: Shape (k, 3), centres of mass from the joints [m]. Default: half the offsets.
        inertias: Shape (k, 3, 3), about the centres of mass, in the links' axes [kg m^2]: symmetric and
            positive definite. Default: those of solid cylinders along the offsets, of a tenth of their mean
            length in radius.

    Raises:
        ValueError: If a shape does not fit, a mass is not positive, an axis has no length, or an inertia is
            not positive definite.

    Example:
        >>> import jaxroll as jxr
        >>> links = [(0, 0.06, 0), (0, 0.06, 0)]
        >>> finger = jxr.Finger3([(1, 0, 0), (0, 0, 1)], links, [0.04, 0.04], jxr.Sphere(0.01))
        >>> finger.joints
        2
    """

    axes: Float[Array, "k 3"] = real(None, 3, check=_as_axes)
    offsets: Float[Array, "k 3"] = real(None, 3)
    masses: Float[Array, " k"] = real(None, check=check_positive)
    tip: AbstractSurface = through(as_surface)
    base: Float[Array, "3"] = real(3)
    rotation: Float[Array, "4"] = real(4, check=as_direction)
    centres: Float[Array, "k 3"] = real(None, 3)
    inertias: Float[Array, "k 3 3"] = real(None, 3, 3, check=check_inertia)

    def __init__(
        self,
        axes: Given,
        offsets: Given,
        masses: Given,
        tip: AbstractSurface,
        *,
        base: Given = (0.0, 0.0, 0.0),
        rotation: Given = (1.0, 0.0, 0.0, 0.0),
        centres: Given | None = None,
        inertias: Given | None = None,
    ) -> None:
        self.tip = taken(self, "tip", tip)
        self.axes = taken(self, "axes", axes)
        links = self.axes.shape[0]
        self.offsets = taken(self, "offsets", offsets, shape=(links, 3))
        self.masses = taken(self, "masses", masses, shape=(links,))
        self.base = taken(self, "base", base)
        self.rotation = taken(self, "rotation", rotation)
        centres = 0.5 * self.offsets if centres is None else centres
        self.centres = taken(self, "centres", centres, shape=(links, 3))
        inertias = _cylinders(self.masses, self.offsets) if inertias is None else inertias
        self.inertias = taken(self, "inertias", inertias, shape=(links, 3, 3))

    @property
    def joints(self) -> int:
        return len(self.axes)

    def with_payload(
        self, mass: Given, *, link: int | None = None, at: Given | None = None, inertia: Given | None = None
    ) -> "Finger3":
        r"""A copy with a body fixed to one link: a camera, a sensor, a fingertip's weight.

        Mass, centre of mass and inertia of the link become those of both together, exactly; with d the vector
        from the link's centre of mass to the body's, $I' = I + I_p + \frac{m p}{m + p} (d^2 1 - d d^T)$.

        Args:
            mass: p [kg], positive.
            link: Which link, counted from zero. Default: the last one.
            at: Shape (3,), the body's centre of mass from the link's joint [m]. Default: the link's end.
            inertia: $I_p$, shape (3, 3), about the body's own centre of mass in the link's axes [kg m^2];
                symmetric. Default: none, a point.

        Raises:
            ValueError: If there is no such link, or a number is not what it must be.

        Example:
            >>> import jaxroll as jxr
            >>> links = [(0, 0.06, 0), (0, 0.06, 0)]
            >>> finger = jxr.Finger3([(1, 0, 0), (0, 0, 1)], links, [0.03, 0.01], jxr.Sphere(0.01))
            >>> heavy = finger.with_payload(0.01, at=(0.02, 0.03, 0.0))
            >>> f"{heavy.masses[1]:.3f} kg at {1e3 * heavy.centres[1, 0]:.0f} mm"
            '0.020 kg at 10 mm'
        """
        i = self.joints - 1 if link is None else as_count("link", link, least=0, most=self.joints - 1)
        p = check_positive("mass", as_floats("mass", mass, ()))
        place = self.offsets[i] if at is None else as_floats("at", at, (3,))
        own = jnp.zeros((3, 3)) if inertia is None else as_floats("inertia", inertia, (3, 3))
        m, apart = self.masses[i], place - self.centres[i]
        about = jnp.eye(3) * (apart @ apart) - jnp.outer(apart, apart)
        new = (
            m + p,
            self.centres[i] + p / (m + p) * apart,
            self.inertias[i] + own + m * p / (m + p) * about,
        )
        fields = lambda f: (f.masses, f.centres, f.inertias)  # noqa: E731
        arrays = [old.at[i].set(x) for old, x in zip(fields(self), new, strict=True)]
        arrays[2] = taken(self, "inertias", arrays[2], shape=self.inertias.shape, name="inertia")
        return eqx.tree_at(fields, self, tuple(arrays))

    @property
    def size(self) -> Scalar:
        lengths = [Vec3(*unstack(offset)).norm() for offset in self.offsets]
        return total(lengths) / self.joints

    @property
    def turns(self) -> bool:
        return True

    def prepared(self) -> "Finger3":
        fields = lambda f: (f.axes, f.offsets, f.masses, f.base, f.rotation, f.centres, f.inertias, f.tip)  # noqa: E731
        *arrays, tip = fields(self)
        return eqx.tree_at(fields, self, (*map(unstack, arrays), tip.prepared()))

    def _chain(self, q: Scalars) -> _Chain:
        """The chain at these joint angles, from the base to the tip."""
        # Scaled once more: `tree_at`, or a step along a gradient, may have changed its length.
        at = pose_at(Vec3(*unstack(self.base)), normalised(unstack(self.rotation)))
        links, axes = [], []
        for i, angle in enumerate(q):
            axis = Vec3(*unstack(self.axes[i]))
            # A frame that turns about its own axis leaves that axis where it is.
            axes.append(once(at.turn(axis)))
            at = once(Pose3(at.origin, *_turned(at, axes[-1], *sincos(angle))))
            links.append(at)
            at = Pose3(once(at.place(Vec3(*unstack(self.offsets[i])))), at.x, at.y, at.z)
        return _Chain(tuple(links), tuple(axes), at)

    def placed(self, q: Scalars) -> tuple[Pose3, Spin]:
        chain = self._chain(q)
        return chain.tip, lambda v: total([axis * rate for axis, rate in zip(chain.axes, v, strict=True)])

    def skeleton(self, q: Scalars) -> tuple[Vec3, ...]:
        chain = self._chain(q)
        return (*(link.origin for link in chain.links), chain.tip.origin)

    def motion(self, q: Scalars, v: Scalars, gravity: Vec3 | None) -> tuple[Motion, Inertia]:
        chain = self._chain(q)
        spins, bends, pulls = self._biases(chain, v)
        units = tuple(
            Twist3(axis.cross(chain.tip.origin - link.origin), axis)
            for axis, link in zip(chain.axes, chain.links, strict=True)
        )
        velocity = total([unit.velocity * rate for unit, rate in zip(units, v, strict=True)])
        motion = Motion(
            chain.tip, once(units), once(Twist3(velocity, spins[-1])), Twist3(pulls[-1], bends[-1])
        )
        return motion, self._inertia(chain, (spins, bends, pulls), gravity)

    def _biases(self, chain: _Chain, v: Scalars) -> tuple[list[Vec3], list[Vec3], list[Vec3]]:
        """Spins and angular accelerations of the links, accelerations of the joints and of the tip frame.

        Three lists, of k, k and k + 1 vectors; accelerations are those at zero joint accelerations.
        """
        # Link i turns against the one before at a_i v_i, and that axis itself turns with the link before.
        still = Vec3(0.0, 0.0, 0.0)
        ends = [*(link.origin for link in chain.links[1:]), chain.tip.origin]
        spins, bends, pulls = [], [], [still]
        for i, (axis, link) in enumerate(zip(chain.axes, chain.links, strict=True)):
            rate = axis * v[i]
            spins.append(once(spins[-1] + rate) if i else rate)
            bends.append(once(bends[-1] + spins[i - 1].cross(rate)) if i else still)
            pulls.append(once(pulls[-1] + _centripetal(spins[i], bends[i], ends[i] - link.origin)))
        return spins, bends, pulls

    def _inertia(
        self, chain: _Chain, biases: tuple[list[Vec3], list[Vec3], list[Vec3]], gravity: Vec3 | None
    ) -> Inertia:
        """Mass matrix and bias, joint by joint from the tip inwards; `biases` are those of `_biases`."""
        rows, forces = [], []
        outer: _Outer | None = None
        for i in reversed(range(self.joints)):
            own = self._link(i, chain.links[i], (biases[0][i], biases[1][i], biases[2][i]), gravity)
            if outer is not None:
                own = _joined(own, outer, chain.links[i + 1].origin - chain.links[i].origin)
            outer = own = once(own)
            # Unit acceleration of joint i needs the force a_i x c and, about the joint, the torque J a_i.
            push, twist = chain.axes[i].cross(own.moment), own.second.apply(chain.axes[i])
            row = []
            for j in range(i + 1):
                arm = chain.links[i].origin - chain.links[j].origin
                row.append(chain.axes[j].dot(twist + arm.cross(push)))
            rows.append(tuple(row))
            forces.append(chain.axes[i].dot(own.torque))
        return once(Inertia(tuple(reversed(rows)), tuple(reversed(forces))))

    def _link(self, i: int, link: Pose3, bias: tuple[Vec3, Vec3, Vec3], gravity: Vec3 | None) -> _Outer:
        """One link alone, about its joint; `bias` holds its spin, angular and joint's acceleration."""
        spin, bend, pull = bias
        mass, arm = self.masses[i], once(link.turn(Vec3(*unstack(self.centres[i]))))
        # In world axes, in which all links are added up.
        tensor = once(_symmetric(self.inertias[i]).turned(link))
        pull = pull + _centripetal(spin, bend, arm)
        force = (pull if gravity is None else pull - gravity) * mass
        # Euler's equation, I w' + w x I w, and the torque of the force at the centre of mass.
        torque = tensor.apply(bend) + spin.cross(tensor.apply(spin)) + arm.cross(force)
        return _Outer(mass, arm * mass, tensor + _about(mass, arm), force, torque)

    def gravity_potential(self, q: Scalars, gravity: Vec3) -> Scalar:
        links = self._chain(q).links
        centres = [link.place(Vec3(*unstack(c))) for link, c in zip(links, self.centres, strict=True)]
        return total([-gravity.dot(c) * m for c, m in zip(centres, self.masses, strict=True)])


def _turned(frame: Pose3, axis: Vec3, sin: Scalar, cos: Scalar) -> tuple[Vec3, Vec3, Vec3]:
    """The axes of a frame turned about a unit axis: Rodrigues' formula."""
    x, y, z = (
        vector * cos + axis.cross(vector) * sin + axis * (axis.dot(vector) * (1.0 - cos))
        for vector in (frame.x, frame.y, frame.z)
    )
    return x, y, z


def _centripetal(spin: Vec3, bend: Vec3, arm: Vec3) -> Vec3:
    r"""Acceleration of an arm's end less its start's: $\dot\omega\times r + \omega\times(\omega\times r)$.

    `bend` is $\dot\omega$, the angular acceleration.
    """
    return bend.cross(arm) + spin.cross(spin.cross(arm))


def _about(mass: Scalar, arm: Vec3) -> Sym3:
    """Second moment of a point mass about a point: $m (|r|^2 - r r^T)$."""
    away = arm.dot(arm)
    return (Sym3(away, 0.0, 0.0, away, 0.0, away) - square(arm)) * mass


def _joined(own: _Outer, outer: _Outer, step: Vec3) -> _Outer:
    """A link and all beyond it as one body, about the link's joint; `step` leads to the next joint."""
    # The inertia about a point further back by d: J + 2 (d . c) - (d c^T + c d^T) + m (|d|^2 - d d^T).
    shifted = outer.moment + step * outer.mass
    both = 2.0 * step.dot(outer.moment)
    mixed = product(step, outer.moment) * -2.0
    moved = outer.second + Sym3(both, 0.0, 0.0, both, 0.0, both) + mixed + _about(outer.mass, step)
    return _Outer(
        own.mass + outer.mass,
        own.moment + shifted,
        own.second + moved,
        own.force + outer.force,
        own.torque + outer.torque + step.cross(outer.force),
    )


def _symmetric(matrix: Any) -> Sym3:
    """A symmetric matrix from its upper triangle."""
    rows = unstack(matrix)
    return Sym3(rows[0][0], rows[0][1], rows[0][2], rows[1][1], rows[1][2], rows[2][2])


def _cylinders(masses: Array, offsets: Array) -> Array:
    """Inertia tensors of solid cylinders along the offsets, about their centres: shape (k, 3, 3).

    With length l along the unit vector e and radius r: m l^2/12 (1 - e e^T) + m r^2/4 (1 + e e^T).
    """
    square_ = jnp.sum(offsets**2, axis=-1)
    radius = _THICKNESS * jnp.mean(jnp.sqrt(square_))
    along = offsets[:, :, None] * offsets[:, None, :]
    eye = jnp.eye(3, dtype=offsets.dtype)[None]
    rod = (square_[:, None, None] * eye - along) / 12.0
    # An offset of no length has no direction e: m r^2/4 about every axis is left.
    unit = along / jnp.where(square_ > 0, square_, 1.0)[:, None, None]
    return masses[:, None, None] * (rod + radius**2 * (eye + unit) / 4.0)
