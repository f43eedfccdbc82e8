"""A spatial finger: a serial chain of links on revolute joints, with a surface at its end.

`Finger3` is what users make; `_chain3` has its kinematics, mass matrix and bias, in the frames of the joints.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._linalg import Pose3, total, unstack, Vec3
from .._results import (
    as_count,
    as_floats,
    as_positive,
    check_direction,
    check_instance,
    check_positive,
    concrete,
    shown,
)
from .._types import Given, Scalar, Scalars
from .._xla import at_once
from ..contact import Motion
from ..geometry import AbstractSurface
from ._body import AbstractFinger, Inertia, Spin
from ._chain3 import Chain3, chain_of, unit
from ._finger import check_limits, check_links
from ._object3 import check_inertia

# Default inertias are those of solid cylinders, with this radius relative to the mean length of the links.
_THICKNESS = 0.1


def as_surface(name: str, surface: Any) -> AbstractSurface:
    """Raise unless an argument is a surface."""
    return check_instance(name, surface, AbstractSurface, "a surface")


def as_direction(name: str, vectors: Array) -> Array:
    """Vectors scaled to unit length."""
    check_direction(name, vectors)
    return unit(vectors)


def _as_axes(name: str, axes: Array) -> Array:
    return as_direction(name, check_links(name, axes))


def _as_armature(name: str, values: Array) -> Array:
    """Raise for inertias below zero."""
    seen = concrete(values)
    if seen is not None and (seen < 0).any():
        raise ValueError(f"argument {name} must not be negative, but was {shown(values)}")
    return values


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
        armature: Shape (k,), inertia of each joint's rotor as the joint feels it, that of the motor times the
            square of its gear ratio [kg m^2]: added to the diagonal of the mass matrix. Default: none, and
            then it costs nothing.
        limits: Shape (k, 2), least and largest angle of every joint [rad]: a run ends there with the code
            `joint_limit`. Default: none, and then it costs nothing.
        torque_limits: Shape (k,), largest torque of every joint [N m]: a run ends with `torque_limit` where
            the controller asks for more. Default: none, and then it costs nothing.
        link_radius: Radius of the links as capsules, from joint to joint and to the tip frame [m]. A run ends
            with `links_meet` where one meets the object, or a link of another finger that has a radius.
            `reach` keeps links away from the object. Default: none, and then it costs nothing.

    Raises:
        ValueError: If a shape does not fit, a mass, a torque limit or the links' radius is not positive, an
            axis has no length, an inertia is not positive definite, a rotor's is negative, or limits do not
            rise.

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
    armature: Float[Array, " k"] | None = real(None, check=_as_armature, optional=True)
    limits: Float[Array, "k 2"] | None = real(None, 2, check=check_limits, optional=True)
    torque_limits: Float[Array, " k"] | None = real(None, check=check_positive, optional=True)
    link_radius: Float[Array, ""] | None = real(check=check_positive, optional=True)

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
        armature: Given | None = None,
        limits: Given | None = None,
        torque_limits: Given | None = None,
        link_radius: Given | None = None,
    ) -> None:
        self.tip = taken(self, "tip", tip)
        self.axes = taken(self, "axes", axes)
        links = self.axes.shape[0]
        self.offsets = taken(self, "offsets", offsets, shape=(links, 3))
        self.masses = taken(self, "masses", masses, shape=(links,))
        self.base = taken(self, "base", base)
        self.rotation = taken(self, "rotation", rotation)
        halves, cylinders = _cylinders(self.masses, self.offsets)
        centres = halves if centres is None else centres
        self.centres = taken(self, "centres", centres, shape=(links, 3))
        inertias = cylinders if inertias is None else inertias
        self.inertias = taken(self, "inertias", inertias, shape=(links, 3, 3))
        self.armature = taken(self, "armature", armature, shape=(links,))
        self.limits = taken(self, "limits", limits, shape=(links, 2))
        self.torque_limits = taken(self, "torque_limits", torque_limits, shape=(links,))
        self.link_radius = taken(self, "link_radius", link_radius)

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
        p = as_positive("mass", mass)
        place = self.offsets[i] if at is None else as_floats("at", at, (3,))
        own = jnp.zeros((3, 3)) if inertia is None else as_floats("inertia", inertia, (3, 3))
        new = _loaded((self.masses[i], self.centres[i], self.inertias[i]), p, place, own)
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

    def prepared(self) -> Chain3:
        return chain_of(self)

    def placed(self, q: Scalars) -> tuple[Pose3, Spin]:
        return self.prepared().placed(q)

    def skeleton(self, q: Scalars) -> tuple[Vec3, ...]:
        return self.prepared().skeleton(q)

    def motion(self, q: Scalars, v: Scalars, gravity: Vec3 | None) -> tuple[Motion, Inertia]:
        return self.prepared().motion(q, v, gravity)

    def gravity_potential(self, q: Scalars, gravity: Vec3) -> Scalar:
        return self.prepared().gravity_potential(q, gravity)


@at_once
def _loaded(
    xp: Any, link: tuple[Array, Array, Array], mass: Array, place: Array, inertia: Array
) -> tuple[Array, Array, Array]:
    """Mass, centre and inertia of a link with a payload whose centre is at a place."""
    m, centre, own = link
    apart, share = place - centre, mass / (m + mass)
    about = xp.eye(3, dtype=apart.dtype) * (apart @ apart) - xp.outer(apart, apart)
    return m + mass, centre + share * apart, own + inertia + m * share * about


@at_once
def _cylinders(xp: Any, masses: Array, offsets: Array) -> tuple[Array, Array]:
    """Centres of solid cylinders along the offsets, and their inertia tensors about these: shape (k, 3, 3).

    With length l along the unit vector e and radius r: m l^2/12 (1 - e e^T) + m r^2/4 (1 + e e^T).
    """
    square_ = xp.sum(offsets**2, axis=-1)
    radius = _THICKNESS * xp.mean(xp.sqrt(square_))
    along = offsets[:, :, None] * offsets[:, None, :]
    eye = xp.eye(3, dtype=offsets.dtype)[None]
    rod = (square_[:, None, None] * eye - along) / 12.0
    # An offset of no length has no direction e: m r^2/4 about every axis is left.
    unit = along / xp.where(square_ > 0, square_, 1.0)[:, None, None]
    return 0.5 * offsets, masses[:, None, None] * (rod + radius**2 * (eye + unit) / 4.0)
