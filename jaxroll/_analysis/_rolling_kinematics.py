r"""Rolling kinematics alone: one surface rolled over another along a given path, without forces.

The unknowns are the rolling body's quaternion, both places and the arclength. With the contact's velocity s
in the tangent plane of the surface that lies still, the body turns at $\omega = n \times (L_A + L_B)\,s +
\omega_n n$: the normals of both surfaces must stay opposite, and turn at $L_A s$ and $L_B s$. Its position is
no unknown: it is where the contact points of both surfaces coincide, so that they stay in contact to rounding
however large the steps are. diffrax integrates; `RESULTS` says how it went.
"""

import functools
from collections.abc import Callable
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._closures import opened
from .._integration import check_times, tolerance
from .._linalg import (
    normalised,
    Pose3,
    pose_at,
    quaternion_product,
    quaternion_rate,
    root,
    tangents,
    unstack,
    Vec3,
)
from .._printing import listed
from .._results import as_floats, check_callable, check_instance, concrete, RESULTS, shown, traceable
from .._types import ByPrecision, Given, Scalar, Scalars, Times
from .._xla import in_both_modes
from ..geometry import AbstractSurface, Gauss3

# Most steps of the integration.
_MAX_STEPS = 65536
# Unit vectors count as opposite if one plus their inner product is below this: the sum is half the square of
# the angle that is missing.
_OPPOSITE = ByPrecision(1e-12, 1e-6)
# A contact that is past an end of its surface by no more than this [m] counts as at the end.
_AT_END = ByPrecision(1e-9, 1e-6)


class Rolled(eqx.Module):
    """A surface rolled over another: everything in the frame of the one that lies still.

    Attributes:
        ts: Shape (t,), parameter of the path.
        pose: Shape (t, 7), position [m] and unit quaternion (scalar first) of the rolling body.
        at_tip: Shape (t, coordinates), the contact on the rolling surface.
        at_object: The contact on the still one.
        arclength: Shape (t,), of both loci [m].
        result: Code of `jaxroll.RESULTS`.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"arclength": "m"}

    ts: Times
    pose: Float[Array, "t 7"]
    at_tip: Float[Array, "t a"]
    at_object: Float[Array, "t b"]
    arclength: Float[Array, " t"]
    result: RESULTS


def roll(
    tip: AbstractSurface,
    object: AbstractSurface,
    velocity: Callable[[Any], Any],
    ts: Given,
    *,
    at_tip: Given,
    at_object: Given,
    rotation: Given = (1.0, 0.0, 0.0, 0.0),
    spin: Callable[[Any], Any] | None = None,
    rtol: float = 1e-12,
) -> Rolled:
    r"""Roll one surface over another that lies still, its contact led at a given velocity.

    Montana's equations in orthonormal frames: with the contact's velocity $s$ over either surface, the
    object's normal $n$ and the shape operators in common axes, the rolling body turns at
    $\omega = n \times (L_A + L_B)\,s + \omega_n n$. With $\omega_n = 0$ it does not spin about the normal,
    and a closed path leaves a rotation behind: its holonomy.

    Args:
        tip: The rolling surface.
        object: The one that lies still.
        velocity: `velocity(t)` [m per unit of t], three numbers in the object's axes; the part along the
            normal is left out.
        ts: Shape (t,), rising: where the answer is wanted; the first is the start.
        at_tip: Coordinates of the starting contact on the rolling surface.
        at_object: The same on the still one.
        rotation: Starting quaternion (scalar first) of the rolling body; it is turned by the smallest angle
            that makes the surfaces tangent.
        spin: `spin(t)` gives $\omega_n$ [rad per unit of t]. Default: none.
        rtol: Relative tolerance of the integration (Dopri8).

    Returns:
        A `Rolled`. Its code is `solver_failed` where the integration did not reach the end, and
        `contour_end` where a contact is past an end of its surface at one of these times.

    Raises:
        ValueError: If an argument does not fit.

    Accuracy: that of `rtol` at every time asked for, since steps end there; contacts stay on both surfaces to
    rounding. In single precision `rtol` must be given, 1e-5 or more. Differentiable in both modes, once.

    Example:
        >>> import jax.numpy as jnp, jaxroll as jxr
        >>> ball, table = jxr.Sphere(0.1), jxr.Plane()
        >>> once = jxr.roll(
        ...     ball, table, lambda t: (0.1, 0.0, 0.0), jnp.linspace(0, 2 * jnp.pi, 3),
        ...     at_tip=(0.0, 0.0, -0.1), at_object=(0.0, 0.0, 0.0),
        ... )
        >>> bool(abs(abs(once.pose[-1, 3]) - 1) < 1e-12)  # all the way round
        True
    """
    for name, surface in (("tip", tip), ("object", object)):
        check_instance(name, surface, AbstractSurface, "a surface")
    for name, function in (("velocity", velocity), ("spin", spin)):
        if name == "velocity" or function is not None:
            check_callable(name, function, "a function of t", takes=1)
    places = (
        as_floats("at_tip", at_tip, (tip.coordinates,)),
        as_floats("at_object", at_object, (object.coordinates,)),
    )
    turn, times = as_floats("rotation", rotation, (4,)), as_floats("ts", ts, (None,))
    known = concrete(turn)
    if known is not None and not known.any():
        raise ValueError(f"argument rotation must be a quaternion with a direction, but was {shown(turn)}")
    check_times(times)
    limit = tolerance("rtol", rtol, np.dtype(times.dtype))
    # Traced numbers that a function closes over take part in derivatives: as pytrees the functions show them.
    given = opened(velocity), opened(spin)
    return _roll((tip, object), given, times, (turn, *places), limit)


class _Rolling(eqx.Module):
    """The differential equations of `y`; `velocity` and `spin` are the caller's functions of t.

    `y` holds the quaternion of the rolling body, the place on it, the place on the other, and the arclength.
    """

    tip: AbstractSurface
    object: AbstractSurface
    velocity: Any
    spin: Any

    def frames(self, y: Array) -> tuple[Pose3, tuple[Scalars, Scalars], tuple[Gauss3, Gauss3]]:
        """Axes of the rolling body, both places, and the Gauss frames there, each in its own body's axes.

        The places are first brought back onto their surfaces, from which integration drifts away.
        """
        flat, n = unstack(y), 4 + self.tip.coordinates
        places = (self.tip.settled(flat[4:n]), self.object.settled(flat[n:-1]))
        axes = pose_at(Vec3(0.0, 0.0, 0.0), normalised(flat[:4]))
        return axes, places, (self.tip.frame(places[0]), self.object.frame(places[1]))

    # JAX then traces and differentiates them once for all loops of diffrax in which they are.
    @eqx.filter_jit
    def rates(self, t: Scalar, y: Array, args: Any) -> Array:
        """Rates of everything in `y`."""
        axes, (at_tip, at_object), (tip, face) = self.frames(y)
        # Only the part of the caller's velocity in the tangent plane.
        with traceable("velocity"):
            led = as_floats("velocity(t)", self.velocity(t), (3,))
        given = Vec3(*unstack(led.astype(y.dtype)))
        velocity = given - face.normal * given.dot(face.normal)
        bend = tip.shape.turned(axes) + face.shape
        turning = face.normal.cross(bend.apply(velocity))
        if self.spin is not None:
            with traceable("spin"):
                spin = as_floats("spin(t)", self.spin(t), ())
            turning = turning + face.normal * spin.astype(y.dtype)
        turned = quaternion_rate(normalised(unstack(y[:4])), turning)
        # Both places move with the same velocity, which the rolling body sees in its own axes.
        places = (*self.tip.rate(at_tip, axes.back(velocity)), *self.object.rate(at_object, velocity))
        return jnp.stack([*turned, *places, root(velocity.dot(velocity))])

    def answer(self, y: Array) -> tuple[Array, Array, Array]:
        """Pose of the rolling body and both places; its origin is where the contact points coincide."""
        axes, places, (tip, face) = self.frames(y)
        origin = face.point - axes.turn(tip.point)
        at = jnp.concatenate([origin.array(), jnp.stack(normalised(unstack(y[:4])))])
        return at, jnp.stack(places[0]), jnp.stack(places[1])

    def ended(self, y: Array) -> Array:
        """Whether a contact is past an end of its surface, where nothing is known of it."""
        _, (at_tip, at_object), _ = self.frames(y)
        past = -_AT_END.of(y)
        margins = (*self.tip.margins(at_tip), *self.object.margins(at_object))
        return functools.reduce(jnp.logical_or, [m < past for m in margins], jnp.array(False))

    def start(self, rotation: Array, at_tip: Array, at_object: Array) -> Array:
        r"""`y` with the body turned by the smallest angle that makes the surfaces tangent.

        From unit vector a (the body's normal) to b (the object's normal reversed) the smallest rotation is
        the quaternion $(1 + a \cdot b,\ a \times b)$, normalised.
        """
        turn = normalised(unstack(rotation))
        y = jnp.concatenate([jnp.stack(turn), at_tip, at_object, jnp.zeros(1)])
        limit = _OPPOSITE.of(rotation, at_tip, at_object)
        met = self._tangent(y, turn, limit)
        # Half a turn may miss by the angle of the limit, 1e-3 rad in single precision: a second turn follows.
        return met if limit == _OPPOSITE.double else self._tangent(met, unstack(met[:4]), limit)

    def _tangent(self, y: Array, turn: Scalars, limit: float) -> Array:
        """One such turn of the body of `y`; `turn` is its unit quaternion, `limit` that of `_OPPOSITE`."""
        axes, _, (tip, face) = self.frames(y)
        own, wanted = axes.turn(tip.normal), -face.normal
        cosine, axis = own.dot(wanted), own.cross(wanted)
        # Where b = -a that quaternion is zero. Half a turn about any axis across a will do.
        about = cosine < -1.0 + limit
        half = Vec3(*(jnp.where(about, a, b) for a, b in zip(tangents(own)[0], axis, strict=True)))
        bring = normalised((jnp.where(about, 0.0, 1.0 + cosine), *half))
        return y.at[:4].set(jnp.stack(quaternion_product(bring, turn)))


# Plain functions `velocity` and `spin` are static, so that another function is another program.
@eqx.filter_jit
def _roll(
    surfaces: tuple[AbstractSurface, AbstractSurface],
    given: tuple[Any, Any],
    ts: Array,
    start: tuple[Array, ...],
    rtol: Any,
) -> Rolled:
    # An adjoint of diffrax has one mode of differentiation.
    through = lambda adjoint: lambda *args: _integrated(*args, adjoint=adjoint)  # noqa: E731
    backwards = through(diffrax.RecursiveCheckpointAdjoint())
    args = surfaces, given, ts, start, rtol
    return in_both_modes(backwards, args, forwards=through(diffrax.ForwardMode()), backwards=backwards)


def _integrated(
    surfaces: tuple[AbstractSurface, AbstractSurface],
    given: tuple[Any, Any],
    ts: Array,
    start: tuple[Array, ...],
    rtol: Any,
    *,
    adjoint: diffrax.AbstractAdjoint,
) -> Rolled:
    rolling = _Rolling(surfaces[0].prepared(), surfaces[1].prepared(), *given)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rolling.rates),
        diffrax.Dopri8(),
        ts[0],
        ts[-1],
        None,
        rolling.start(*start),
        saveat=diffrax.SaveAt(ts=ts),
        # Steps end where answers are wanted: the solver's interpolation within a step is of lower order.
        stepsize_controller=diffrax.ClipStepSizeController(
            diffrax.PIDController(rtol=rtol, atol=rtol), step_ts=ts
        ),
        adjoint=adjoint,
        max_steps=_MAX_STEPS,
        throw=False,
    )
    fine, ys = solution.result == diffrax.RESULTS.successful, jnp.asarray(solution.ys)
    over = RESULTS.where(jnp.any(jax.vmap(rolling.ended)(ys)), RESULTS.contour_end, RESULTS.successful)
    result = RESULTS.where(fine, over, RESULTS.solver_failed)
    at, at_tip, at_object = jax.vmap(rolling.answer)(ys)
    return Rolled(ts, at, at_tip, at_object, ys[:, -1], result)
