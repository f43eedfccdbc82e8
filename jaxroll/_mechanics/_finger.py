r"""A planar finger: a serial chain of links on revolute joints, with a contour at its end.

Its mass matrix $G(q)$ and bias $(\dot G/2 + S)\,\dot q$ of (3) and (74) come from one pass over the links,
from the tip to the base. The bias is the torque that the motion needs at zero joint accelerations.
"""

import abc
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._linalg import Pose2, sincos, total, Twist2, unstack, Vec2
from .._printing import listed
from .._results import (
    as_count,
    as_floats,
    check_between,
    check_instance,
    check_positive,
    concrete,
    shown,
)
from .._types import Given, Scalar, Scalars
from .._xla import once
from ..contact import Motion
from ..geometry import AbstractContour
from ._body import AbstractBody, Coordinate, Inertia, Spin

_STILL = Vec2(0.0, 0.0)
FingerType = TypeVar("FingerType", bound="AbstractFinger")


class AbstractFinger(AbstractBody):
    """A driven mechanism that carries one shape in its tip frame.

    A class with fields `limits`, `torque_limits` or `link_radius`, None where there are none, has limits that
    runs watch.
    """

    tip: eqx.AbstractVar[Any]

    def __repr__(self) -> str:
        # Most fingers have no limits.
        text = listed(self)
        for name in ("limits", "torque_limits", "link_radius"):
            text = text.replace(f", {name}=None", "")
        return text

    @property
    @abc.abstractmethod
    def joints(self) -> int:
        """Number of joints."""

    @property
    @abc.abstractmethod
    def size(self) -> Scalar:
        """A typical length [m], for scaling and drawing."""

    @property
    @abc.abstractmethod
    def turns(self) -> bool:
        """Whether its coordinates are angles; else displacements."""

    @abc.abstractmethod
    def skeleton(self, q: Scalars) -> tuple[Any, ...]:
        """Points from the base to the tip frame, for drawing."""

    @property
    def prescribed(self) -> bool:
        """Whether its frame moves as a given function of time; then it has no joints (`Grasp` checks it).

        What joints and a given motion add to a gap together would need the twist of either by itself, and a
        `Motion` has their sum alone.
        """
        return False

    @property
    def freedoms(self) -> int:
        return self.joints

    @property
    def labels(self) -> tuple[Coordinate, ...]:
        unit = "" if self.positions != self.joints else "rad" if self.turns else "m"
        return tuple(Coordinate(f"q[{i}]", unit) for i in range(self.positions))

    @property
    def shapes(self) -> tuple[Any, ...]:
        return (self.tip,)


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


def with_scalar_limits(finger: FingerType) -> FingerType:
    """A finger whose limits, if it has some, are tuples of scalars."""
    fields = lambda f: [x for x in (f.limits, f.torque_limits) if x is not None]  # noqa: E731
    given = fields(finger)
    return eqx.tree_at(fields, finger, list(map(unstack, given))) if given else finger


def _as_lengths(name: str, lengths: Array) -> Array:
    return check_positive(name, check_links(name, lengths))


class Finger(AbstractFinger):
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
        link_radius: Of the links, as capsules from joint to joint and to the tip frame [m]: a run ends with
            `links_meet` where one meets the object, away from which `reach` keeps them too, or a link of
            another finger that has a radius. Default: none, and then it costs nothing.

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

    @property
    def joints(self) -> int:
        return len(self.lengths)

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

    @property
    def size(self) -> Scalar:
        return total(unstack(self.lengths)) / self.joints

    @property
    def turns(self) -> bool:
        return True

    def prepared(self) -> "Finger":
        fields = lambda f: (f.lengths, f.masses, f.base, f.centres, f.inertias, f.tip)  # noqa: E731
        *arrays, tip = fields(self)
        return with_scalar_limits(eqx.tree_at(fields, self, (*map(unstack, arrays), tip.prepared())))

    def directions(self, q: Scalars) -> tuple[Vec2, ...]:
        """Unit vectors along the links, in the world: the only sines and cosines of a finger."""
        angle, along = q[0], []
        for i in range(self.joints):
            angle = q[0] if i == 0 else angle + q[i]
            sin, cos = sincos(angle)
            along.append(Vec2(cos, sin))
        return tuple(along)

    def joint_positions(self, along: tuple[Vec2, ...]) -> tuple[Vec2, ...]:
        """Positions of the joints and, last, of the tip frame: k + 1 points."""
        points = [Vec2(self.base[0], self.base[1])]
        for length, direction in zip(self.lengths, along, strict=True):
            points.append(points[-1] + direction * length)
        return once(tuple(points))

    def skeleton(self, q: Scalars) -> tuple[Vec2, ...]:
        return self.joint_positions(self.directions(q))

    def placed(self, q: Scalars) -> tuple[Pose2, Spin]:
        along = self.directions(q)
        # Every joint turns all links beyond it: the tip's spin is the sum of all rates.
        return Pose2(self.joint_positions(along)[-1], along[-1].x, along[-1].y), total

    def motion(self, q: Scalars, v: Scalars, gravity: Vec2 | None) -> tuple[Motion, Inertia]:
        along = self.directions(q)
        points = self.joint_positions(along)
        # Link i has the spin w_i = v_0 + ... + v_i. Without joint accelerations joint i + 1 has the
        # acceleration of joint i, plus -w_i^2 l_i along the link; the base rests, and adds nothing.
        spins = _running_sums(v)
        centripetal = [-(w * w) for w in spins]
        joint_pull = [_STILL]
        for i, length in enumerate(self.lengths):
            step = along[i] * (centripetal[i] * length)
            joint_pull.append(step if i == 0 else joint_pull[i] + step)
        # Likewise the centre of mass of every link; gravity acts like an acceleration -g of the whole.
        centres = [p + d * c for p, d, c in zip(points, along, self.centres, strict=False)]
        pulls = []
        for i, centre in enumerate(self.centres):
            pull = along[i] * (centripetal[i] * centre)
            pull = pull if i == 0 else joint_pull[i] + pull
            pulls.append(pull if gravity is None else pull - gravity)
        motion = self._tip_motion(points, along[-1], v, spins[-1], joint_pull[-1])
        return motion, self._inertia(points, centres, pulls)

    def _tip_motion(
        self, points: tuple[Vec2, ...], heading: Vec2, v: Scalars, spin: Scalar, pull: Vec2
    ) -> Motion:
        """Motion of the tip frame; `pull` is its acceleration at zero joint accelerations."""
        tip = points[-1]
        # A unit rate of the joint at p moves the tip by tip - p, turned left a quarter.
        units = tuple(Twist2((tip - p).left(), 1.0) for p in points[:-1])
        velocity = total([u.velocity * rate for u, rate in zip(units, v, strict=True)])
        pose = Pose2(tip, heading.x, heading.y)
        velocity, pull = once((velocity, pull))
        return Motion(pose, units, Twist2(velocity, spin), Twist2(pull, 0.0))

    def _inertia(self, points: tuple[Vec2, ...], centres: list[Vec2], pulls: list[Vec2]) -> Inertia:
        """Mass matrix and bias: for each joint all links beyond it as one body, from the tip inwards.

        With mass m, first moment c = sum m (r - p_i) and second moment J about joint i of that body,
        M_ij = J + c . (p_i - p_j) for j <= i, and h_i is the torque of m (a - g) about joint i.
        """
        rows: list[Scalars] = []
        forces: list[Scalar] = []
        outer: tuple[Scalar, Vec2, Scalar, Vec2, Scalar] | None = None
        # `outer` is the body of all links from joint i + 1 on, about that joint. To be taken about joint i, a
        # link d further back, its c grows by m d, its J by 2 d . c + m d . d, and its torque by d x F.
        for i in reversed(range(self.joints)):
            arm = centres[i] - points[i]
            mass, moment = self.masses[i], arm * self.masses[i]
            second = self.masses[i] * arm.dot(arm) + self.inertias[i]
            force = pulls[i] * self.masses[i]
            torque = arm.cross(force)
            if outer is not None:  # moved from joint i + 1 to joint i, and added
                link = points[i + 1] - points[i]
                m, first, inner, push, twist = outer
                second = second + inner + 2.0 * link.dot(first) + m * link.dot(link)
                mass, moment = mass + m, moment + first + link * m
                torque, force = torque + twist + link.cross(push), force + push
            outer = (mass, moment, second, force, torque)
            row = [second + moment.dot(points[i] - points[j]) for j in range(i)]
            rows.append((*row, second))
            forces.append(torque)
        return once(Inertia(tuple(reversed(rows)), tuple(reversed(forces))))

    def gravity_potential(self, q: Scalars, gravity: Vec2) -> Scalar:
        along = self.directions(q)
        points = self.joint_positions(along)
        centres = [p + d * c for p, d, c in zip(points, along, self.centres, strict=False)]
        return total([-gravity.dot(c) * m for c, m in zip(centres, self.masses, strict=True)])


@jax.jit  # one small program, not three
def _rods(masses: Array, lengths: Array) -> tuple[Array, Array]:
    """Centres of slender rods and their moments about these."""
    return 0.5 * lengths, masses * lengths**2 / 12.0


def _running_sums(values: Scalars) -> list[Scalar]:
    sums = [values[0]]
    for value in values[1:]:
        sums.append(sums[-1] + value)
    return sums
