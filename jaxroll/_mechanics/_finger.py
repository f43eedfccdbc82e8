r"""A planar finger as users make it: a serial chain of links on revolute joints, with a contour at its end.

Constructor, checks and copies are here; `_plane_bodies` has kinematics, mass matrix and bias.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._results import (
    as_count,
    as_floats,
    check_between,
    check_instance,
    check_positive,
    concrete,
    shown,
)
from .._types import Given
from .._xla import at_once
from ..geometry import AbstractContour
from ._plane_bodies import AbstractChain


def as_tip(name: str, tip: Any) -> AbstractContour:
    """Raise unless an argument is a contour."""
    return check_instance(name, tip, AbstractContour, "a contour")


def check_links(name: str, array: Array) -> Array:
    """Raise for a chain without links."""
    if not array.shape[0]:
        raise ValueError(f"argument {name} must hold one link or more, but had none")
    return array


def check_limits(name: str, limits: Array) -> Array:
    """Raise unless every row of concrete limits rises."""
    seen = concrete(limits)
    if seen is not None and not np.all(seen[:, 0] < seen[:, 1]):
        raise ValueError(f"argument {name} must rise from the least to the most, but was {shown(seen)}")
    return limits


def _as_lengths(name: str, lengths: Array) -> Array:
    return check_positive(name, check_links(name, lengths))


class Finger(AbstractChain):
    r"""A planar serial chain of $k$ revolute joints.

    The first joint angle is measured from the world's x axis, each other one from the link before;
    the tip frame sits at the end of the last link, its x axis along that link.

    Args:
        lengths: Shape (k,), link lengths, in metres.
        masses: Shape (k,), link masses, in kilograms.
        tip: Contour of the fingertip in the tip frame.
        base: Shape (2,), position of the first joint in the world, in metres.
        centres: Shape (k,), distance of each centre of mass from its joint, in metres. Default: half
            the length (a uniform slender rod; the chapter does not state it).
        inertias: Shape (k,), moment of each link about its centre of mass, in kg m^2. Default:
            $m l^2/12$.
        limits: Shape (k, 2), least and largest angle of every joint [rad]: a run ends there with the code
            `joint_limit`. Default: none, and then it costs nothing.
        torque_limits: Shape (k,), largest torque of every joint [N m]: a run ends with `torque_limit` where
            the controller asks for more. Default: none, and then it costs nothing.
        link_radius: Radius of the links as capsules, from joint to joint and to the tip frame [m]. A run ends
            with `links_meet` where one meets the object, or a link of another finger that has a radius.
            `reach` keeps links away from the object. Default: none, and then it costs nothing.

    Raises:
        ValueError: If a shape does not fit, there is no link, a length, mass, inertia, torque limit or the
            links' radius is not positive, or limits do not rise.

    Example:
        >>> import jaxroll as jxr
        >>> finger = jxr.Finger([0.065, 0.065], [0.045, 0.040], tip=jxr.Circle(0.01))
        >>> finger.joints
        2
    """

    lengths: Float[Array, " k"] = real(None, check=_as_lengths)
    masses: Float[Array, " k"] = real(None, check=check_positive)
    tip: AbstractContour = through(as_tip)
    base: Float[Array, "2"] = real(2)
    centres: Float[Array, " k"] = real(None)
    inertias: Float[Array, " k"] = real(None, check=check_positive)
    limits: Float[Array, "k 2"] | None = real(None, 2, check=check_limits, optional=True)
    torque_limits: Float[Array, " k"] | None = real(None, check=check_positive, optional=True)
    link_radius: Float[Array, ""] | None = real(check=check_positive, optional=True)

    def __init__(
        self,
        lengths: Given,
        masses: Given,
        tip: AbstractContour,
        *,
        base: Given = (0.0, 0.0),
        centres: Given | None = None,
        inertias: Given | None = None,
        limits: Given | None = None,
        torque_limits: Given | None = None,
        link_radius: Given | None = None,
    ) -> None:
        self.lengths = taken(self, "lengths", lengths)
        links = self.lengths.shape
        self.masses = taken(self, "masses", masses, shape=links)
        self.base = taken(self, "base", base)
        self.tip = taken(self, "tip", tip)
        halves, rods = _rods(self.masses, self.lengths)
        self.centres = taken(self, "centres", halves if centres is None else centres, shape=links)
        inertias = rods if inertias is None else inertias
        self.inertias = taken(self, "inertias", inertias, shape=links)
        self.limits = taken(self, "limits", limits, shape=(*links, 2))
        self.torque_limits = taken(self, "torque_limits", torque_limits, shape=links)
        self.link_radius = taken(self, "link_radius", link_radius)

    def with_payload(
        self, mass: Given, *, link: int | None = None, at: Given | None = None, inertia: Given = 0.0
    ) -> "Finger":
        r"""A copy with a body fixed to one link: a camera, a sensor, a fingertip's weight.

        Mass, centre of mass and moment of the link become those of both together, exactly:
        $m' = m + p$, $c' = (m c + p a)/m'$, $I' = I + I_p + \frac{m p}{m'} (a - c)^2$.

        Args:
            mass: $p$ [kg], positive.
            link: Which link, counted from zero. Default: the last one.
            at: $a$, how far along the link the body's centre of mass is from the joint [m]. Default: at its
                end.
            inertia: $I_p$, the body's moment about its own centre of mass [kg m^2].

        Raises:
            ValueError: If there is no such link, or a number is not what it must be.

        Example:
            >>> import jaxroll as jxr
            >>> finger = jxr.Finger([0.06, 0.06], [0.03, 0.01], jxr.Circle(0.01))
            >>> heavy = finger.with_payload(0.01)
            >>> f"{heavy.masses[1]:.3f} kg at {1e3 * heavy.centres[1]:.0f} mm"
            '0.020 kg at 45 mm'
        """
        i = self.joints - 1 if link is None else as_count("link", link, least=0, most=self.joints - 1)
        p, own = as_floats("mass", mass, ()), as_floats("inertia", inertia, ())
        check_positive("mass", p)
        check_between("inertia", own, 0.0, jnp.inf)
        place = self.lengths[i] if at is None else as_floats("at", at, ())
        m, c = self.masses[i], self.centres[i]
        apart = place - c
        new = (m + p, c + p / (m + p) * apart, self.inertias[i] + own + m * p / (m + p) * apart**2)
        fields = lambda f: (f.masses, f.centres, f.inertias)  # noqa: E731
        arrays = (old.at[i].set(x) for old, x in zip(fields(self), new, strict=True))
        return eqx.tree_at(fields, self, tuple(arrays))


@at_once
def _rods(xp: Any, masses: Array, lengths: Array) -> tuple[Array, Array]:
    """Centres of slender rods and their moments about these."""
    return 0.5 * lengths, masses * lengths**2 / 12.0
