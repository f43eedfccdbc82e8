r"""What pushes, pulls or brakes the object besides gravity and contacts: a wrench, in world axes.

A load is a function of time, pose and twist of the object. Its generalised force $J^T w$ joins the joint
torques on the right of $M \dot v + h = u + A^T \mu$, and its power $F \cdot v + T \cdot \omega$ the work in
the energy balance (20). `Push`, `Drag` and `Spring` are ready-made; any callable pytree `f(t, pose, twist)`
works too (see `Grasp`). `_motion/_equations` calls `total_wrench` in every evaluation; the program of a grasp
without loads has nothing of it. `Impulse` acts at one time, between two steps (`_motion._impulse`).
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._fields import real, taken, through
from ._linalg import root, sincos, total, unstack, Vec2, Vec3
from ._mechanics import AbstractLoad as AbstractLoad, Moving, Wrench
from ._printing import listed
from ._results import as_array, check_finite, check_positive, shown
from ._types import Given, Scalar
from ._xla import in_arithmetic

__all__ = ("AbstractLoad", "Drag", "Impulse", "Pose", "Push", "Spring", "Twist")


# What the tab key offers: not the names that are imported here.
def __dir__() -> tuple[str, ...]:
    return __all__


class Pose(eqx.Module):
    """The object's place as a load of a user's own sees it.

    Attributes:
        position: Shape (2,), in space (3,): origin of the object's frame in the world [m]. Of a
            `PivotedObject` that is the pivot, of the others the centre of mass.
        orientation: In the plane the angle [rad], which counts whole turns; in space shape (4,), the unit
            quaternion, scalar first, that turns body axes into world axes.
    """

    __repr__ = listed

    position: Float[Array, "d"]
    orientation: Float[Array, "..."]


class Twist(eqx.Module):
    """The object's velocity as a load of a user's own sees it.

    Attributes:
        velocity: Shape (2,), in space (3,): of the frame's origin, in world axes [m/s].
        spin: In the plane a number, in space shape (3,) in world axes [rad/s].
    """

    __repr__ = listed

    velocity: Float[Array, "d"]
    spin: Float[Array, "..."]


def _as_vector(name: str, vector: Array) -> Array:
    """A vector of two or three coordinates; the load's `check` compares their number with the grasp's."""
    if vector.shape[0] not in (2, 3):
        raise ValueError(f"argument {name} must have shape (2) or (3), but had shape {vector.shape}")
    return vector


def _check_axes(name: str, axes: int, **vectors: Array | None) -> None:
    """Raise unless vectors, named as a load's arguments are, have the coordinates of the grasp's points."""
    for argument, array in vectors.items():
        if array is not None and array.shape[-1] != axes:
            raise ValueError(
                f"argument {name} must have {axes} numbers as {argument}, as the grasp's points have, "
                f"but had {array.shape[-1]}"
            )


def _vector(parts: Array) -> Any:
    """An array of two or three numbers as a vector of scalars."""
    scalars = unstack(parts)
    return Vec3(*scalars) if len(scalars) == 3 else Vec2(*scalars)


def _as_angular(name: str, value: Any) -> Array | None:
    """Finite numbers of any shape, or None."""
    return None if value is None else check_finite(name, as_array(name, value))


def _taken_beside(load: AbstractLoad, vector: Array, point: Given | None) -> Array | None:
    """Argument `point` of a load, or None; it must have as many numbers as the load's other vector."""
    array = taken(load, "point", point)
    if array is not None and array.shape != vector.shape:
        raise ValueError(f"argument point must have shape {vector.shape}, but had shape {array.shape}")
    return array


def _acting_at(force: Any, point: Array | None, object_: Moving) -> Wrench:
    """The wrench about the object's origin of a force that acts at a point fixed in the object."""
    if point is None:
        return force, None
    return force, object_.pose.turn(_vector(point)).cross(force)


class Push(AbstractLoad):
    r"""A push of limited duration, $F(t) = F \sin^2(\pi (t - t_0) / T)$ from $t_0$ to $t_0 + T$.

    Its impulse is $F T / 2$. Both ends are declared jumps: steps end there, so that a push is never stepped
    over, however short it is.

    Args:
        force: Shape (2,), in space (3,): the largest force $F$, in world axes [N].
        start: $t_0$ [s].
        duration: $T$ [s], positive.
        point: Shape (2,), in space (3,): where it acts, in the object's frame [m]. Default: its origin.

    Raises:
        ValueError: If a number is not finite, a shape does not fit, or the duration is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch()
        >>> pushed = grasp.with_(load=jxr.loads.Push((0.2, 0.0), 0.1, 0.05))
        >>> jxr.simulate(pushed, state, 1.0).result  # the fingers hold it
        successful
    """

    UNITS: ClassVar[dict[str, str]] = {"force": "N", "start": "s", "duration": "s", "point": "m"}

    force: Float[Array, "d"] = real(None, check=_as_vector)
    start: Float[Array, ""] = real()
    duration: Float[Array, ""] = real(check=check_positive)
    point: Float[Array, "d"] | None = real(None, check=_as_vector, optional=True)

    def __init__(self, force: Given, start: Given, duration: Given, *, point: Given | None = None) -> None:
        self.force = taken(self, "force", force)
        self.start = taken(self, "start", start)
        self.duration = taken(self, "duration", duration)
        self.point = _taken_beside(self, self.force, point)

    @property
    def jumps(self) -> Array:
        """Where it begins and ends [s]: its second derivative jumps there."""
        return jnp.stack([self.start, self.start + self.duration])

    def wrench(self, t: Scalar, object_: Moving) -> Wrench:
        share = (t - self.start) / self.duration
        within = (share > 0.0) & (share < 1.0)
        sin, _ = sincos(jnp.pi * jnp.where(within, share, 0.0))
        return _acting_at(_vector(self.force) * (sin * sin), self.point, object_)

    def check(self, name: str, axes: int) -> None:
        _check_axes(name, axes, force=self.force, point=self.point)


class Drag(AbstractLoad):
    r"""Viscous resistance of the object's motion: $F = -c\,v$, $T = -d\,\omega$.

    Args:
        linear: $c$ [N s/m], of the velocity of the object's origin.
        angular: $d$ [N m s], of its spin.

    Negative coefficients feed energy in.

    Raises:
        ValueError: If a coefficient is not one finite number.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch()
        >>> grasp.with_(load=jxr.loads.Drag(0.1, 1e-5)).load
        (Drag(linear=0.1 N s/m, angular=1e-05 N m s),)
    """

    UNITS: ClassVar[dict[str, str]] = {"linear": "N s/m", "angular": "N m s"}

    linear: Float[Array, ""] = real()
    angular: Float[Array, ""] = real()

    def __init__(self, linear: Given, angular: Given = 0.0) -> None:
        self.linear = taken(self, "linear", linear)
        self.angular = taken(self, "angular", angular)

    def wrench(self, t: Scalar, object_: Moving) -> Wrench:
        del t
        return object_.twist.velocity * -self.linear, object_.twist.spin * -self.angular


class Spring(AbstractLoad):
    r"""A linear spring, with a damper beside it, from a point of the object to a point of the world.

    $F = -k\,(1 - l/|d|)\,d - c\,\dot d$ with $d$ from the anchor to the point; $-k\,d - c\,\dot d$ if the
    natural length $l$ is zero.

    Args:
        stiffness: $k$ [N/m].
        anchor: Shape (2,), in space (3,): the point of the world [m].
        point: The point of the object, in its frame [m]. Default: its origin.
        length: Natural length $l$ [m], positive. Default: zero. Where the spring has no length its direction
            is not defined, and it does not pull.
        damping: $c$ [N s/m], of any motion of the point, across the spring too.

    Raises:
        ValueError: If a number is not finite, a shape does not fit, or the length is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch()
        >>> held = grasp.with_(load=jxr.loads.Spring(20.0, state.q[:2]))  # to where it is at the start
        >>> float(held.load[0].stiffness)
        20.0
    """

    UNITS: ClassVar[dict[str, str]] = {
        "stiffness": "N/m",
        "anchor": "m",
        "point": "m",
        "length": "m",
        "damping": "N s/m",
    }

    stiffness: Float[Array, ""] = real()
    anchor: Float[Array, "d"] = real(None, check=_as_vector)
    point: Float[Array, "d"] | None = real(None, check=_as_vector, optional=True)
    length: Float[Array, ""] | None = real(check=check_positive, optional=True)
    damping: Float[Array, ""] = real()

    def __init__(
        self,
        stiffness: Given,
        anchor: Given,
        *,
        point: Given | None = None,
        length: Given | None = None,
        damping: Given = 0.0,
    ) -> None:
        self.stiffness = taken(self, "stiffness", stiffness)
        self.anchor = taken(self, "anchor", anchor)
        self.point = _taken_beside(self, self.anchor, point)
        self.length = taken(self, "length", length)
        self.damping = taken(self, "damping", damping)

    def wrench(self, t: Scalar, object_: Moving) -> Wrench:
        del t
        at, moves = object_.pose.origin, object_.twist.velocity
        if self.point is not None:
            arm = object_.pose.turn(_vector(self.point))
            at, moves = at + arm, object_.twist.at(arm)
        stretched = at - _vector(self.anchor)
        pull = self.stiffness
        if self.length is not None:
            long = root(stretched.dot(stretched))
            pull = pull * (1.0 - self.length / jnp.where(long > 0.0, long, self.length))
        return _acting_at(stretched * -pull - moves * self.damping, self.point, object_)

    def check(self, name: str, axes: int) -> None:
        _check_axes(name, axes, anchor=self.anchor, point=self.point)


class Impulse(AbstractLoad):
    r"""A blow: an impulse on the object at one time, after which it has other velocities.

    $M (v_+ - v_-) = p + A^T \mu$ with contact impulses $\mu$ that keep all gaps closed. A contact that would
    have to pull, or to rub more than its friction allows, ends the run with that code (unless `events` leaves
    it out), at the state before the blow: fingers that pinch have no hold against a blow along the pinch. A
    state saved at its time is the one after it. A run that records 'multipliers' has the contact impulses as
    `run.impulses`.

    Args:
        impulse: Shape (2,), in space (3,), in world axes [N s].
        time: When it acts [s]. It acts in a run that ends or begins at that time: of two runs that meet
            there, give one the grasp without it. It has no part in a run that begins later.
        angular: Angular impulse besides, a number, in space shape (3,) in world axes [N m s]. Default: none.
        point: Shape (2,), in space (3,): where it acts, in the object's frame [m]. Default: its origin.

    Raises:
        ValueError: If a number is not finite or a shape does not fit.

    Example:
        >>> import jaxroll as jxr
        >>> ball, state = jxr.scenes.incline()  # 0.3 kg, at rest on a slope along x
        >>> blow = jxr.loads.Impulse((0.0, 0.042, 0.0), 0.1)
        >>> hit = ball.with_(load=blow)  # in runs; what it does at once is said by `strike`
        >>> f"{jxr.strike(ball, state, blow).state.v[1]:.2f} m/s"  # 5/7 of it goes into moving on
        '0.10 m/s'
    """

    UNITS: ClassVar[dict[str, str]] = {"linear": "N s", "time": "s", "angular": "N m s", "point": "m"}

    linear: Float[Array, "d"] = real(None, check=_as_vector)
    time: Float[Array, ""] = real()
    angular: Float[Array, "..."] | None = through(_as_angular)
    point: Float[Array, "d"] | None = real(None, check=_as_vector, optional=True)

    def __init__(
        self, impulse: Given, time: Given, *, angular: Given | None = None, point: Given | None = None
    ) -> None:
        self.linear = taken(self, "linear", impulse, name="impulse")
        self.time = taken(self, "time", time)
        self.angular = taken(self, "angular", angular)
        self.point = _taken_beside(self, self.linear, point)
        wanted = () if self.linear.shape == (2,) else (3,)
        if self.angular is not None and self.angular.shape != wanted:
            raise ValueError(f"argument angular must have shape {wanted}, but had shape {self.angular.shape}")

    @property
    def jumps(self) -> Array:
        """When it acts [s]: velocities jump there."""
        return self.time[None]

    def impulse(self, object_: Moving) -> Wrench:
        """Impulse [N s] and angular impulse [N m s] about the object's origin, in world axes."""
        push, turn = _acting_at(_vector(self.linear), self.point, object_)
        if self.angular is None:
            return push, turn
        own = self.angular if self.angular.ndim == 0 else _vector(self.angular)
        return push, own if turn is None else turn + own

    def wrench(self, t: Scalar, object_: Moving) -> Wrench:
        # Abstract, so it must be here; `total_wrench` leaves impulses out, as they have no force at any time.
        return object_.twist.velocity * 0.0, None

    def check(self, name: str, axes: int) -> None:
        _check_axes(name, axes, impulse=self.linear, point=self.point)


class UserLoad(AbstractLoad):
    """Adapter that calls a user's `f(t, pose, twist)` with ordinary arrays."""

    function: Any

    def wrench(self, t: Scalar, object_: Moving) -> Wrench:
        pose, moves = object_.pose, object_.twist
        spatial = isinstance(pose.origin, Vec3)
        orientation = jnp.stack(object_.orientation) if spatial else jnp.asarray(object_.orientation[0])
        place = Pose(pose.origin.array(), orientation)
        # Velocities of what rests may be Python's own zeros, which have no precision of their own.
        kind = place.position.dtype
        spin = moves.spin.array() if spatial else jnp.asarray(moves.spin)
        twist = Twist(moves.velocity.array().astype(kind), spin.astype(kind))
        given = in_arithmetic("load", self.function, t, place, twist)
        if not isinstance(given, tuple | list) or len(given) != 2:
            raise ValueError(f"argument load must return a force and a torque, but returned {shown(given)}")
        force, torque = (as_array("load, in what it returns,", part) for part in given)
        if (shapes := (force.shape, torque.shape)) != (wanted := (twist.velocity.shape, twist.spin.shape)):
            raise ValueError(
                f"argument load must return a force and a torque of shapes {wanted}, but returned {shapes}"
            )
        force, torque = (part.astype(twist.velocity.dtype) for part in (force, torque))
        return _vector(force), _vector(torque) if spatial else torque


def as_load(load: Any) -> AbstractLoad:
    """Wrap a callable; pass a built-in load through."""
    return load if isinstance(load, AbstractLoad) else UserLoad(load)


def impulses(loads: Sequence[Any]) -> tuple[Impulse, ...]:
    """Those loads that act at one time each; the others act all along."""
    return tuple(load for load in loads if isinstance(load, Impulse))


def total_wrench(loads: Sequence[Any], t: Scalar, object_: Moving) -> Wrench | None:
    """Force [N] and torque [N m] about the object's origin of all loads; no torque where none gives one.

    None where no load acts all along.
    """
    wrenches = [as_load(load).wrench(t, object_) for load in loads if not isinstance(load, Impulse)]
    if not wrenches:
        return None
    torques = [torque for _, torque in wrenches if torque is not None]
    return total([force for force, _ in wrenches]), total(torques) if torques else None
