"""Residuals, contact forces and energies of states, in the chapter's definitions and signs.

`residuals`, `multipliers`, `torques`, `wrenches`, `accelerations` and `energies` are public and take one
state or many. Those that end in `_at` take one state of a prepared grasp; `simulate` maps them over its saved
states. Contact forces cost one more evaluation of the equations of motion. `power` is what a run integrates
where energy is recorded.
"""

import contextlib
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._linalg import inner, plus, stacked, total, Vec2, Vec3
from .._mechanics import Blocks, compiled_for_many, Grasp, Inertia, join, Leaves, reached, State, to_leaves
from .._printing import listed
from .._results import as_array
from .._types import Scalar, Scalars
from .._xla import sharing
from ..contact import Rows
from ..control import as_controller, joint_angles
from ._equations import bodies, evaluate, Instant, loaded, sensed, touches, world_poses, wrench_on
from ._formulation import as_formulation, Formulation
from ._projection import residual


class Residuals(eqx.Module):
    r"""What the constraints leave over at each saved time, per contact.

    Attributes:
        normal: $Q$, the gap along the object's inward normal [m], positive where the shapes overlap: (65),
            and $Q_{ni}$ of (5)-(6). The gap runs from the object's contact point to the fingertip's.
        tangential: $R$, the gap along the object's tangent $b_1$, $b_{0i}$ [m]: (64), and $Q_{bi}$ of
            (5)-(6). In space, shape (..., c, 3): its part in the object's tangent plane, in world axes.
        tangency: Sine of the angle between the two tangents. In space, shape (..., c, 3): the sum of the two
            outward normals, in world axes.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"normal": "m", "tangential": "m"}
    AXES: ClassVar[dict[str, tuple[str, ...]]] = {
        "normal": ("contact",),
        "tangential": ("contact", "axis"),
        "tangency": ("contact", "axis"),
    }

    normal: Float[Array, "... c"]
    tangential: Float[Array, "..."]
    tangency: Float[Array, "..."]


class Multipliers(eqx.Module):
    r"""Contact forces in the chapter's sign and frame.

    Attributes:
        f: Normal force [N] of each contact, positive when pressing.
        lam: Tangential force $\lambda$ [N]: the object pushes the fingertip along $-\lambda\, b_0$. In
            space, shape (..., c, 3): the tangential force on the object, in world axes.
        spin: Torque [N m] on the object about its outward normal at each contact that prevents spin, and zero
            at others; None where no contact does.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"f": "N", "lam": "N", "spin": "N m"}
    AXES: ClassVar[dict[str, tuple[str, ...]]] = {
        "f": ("contact",),
        "lam": ("contact", "axis"),
        "spin": ("contact",),
    }

    f: Float[Array, "... c"]
    lam: Float[Array, "..."]
    spin: Float[Array, "... c"] | None = None


class Energy(eqx.Module):
    r"""Energy balance (20) at each saved time.

    Attributes:
        kinetic: $K$ [J], (13), (71).
        potential: Artificial and gravitational potential energy [J], (22). That of a controller with numbers
            that change in time is left out.
        work: Work of all else [J]: of loads and blows, less the dissipation with a built-in controller. With
            any other, and with numbers that change in time, it has all work of the joint torques.
        residual: $(K + P - W) - (K + P)(t_0)$ [J], with the total energy $K + P$ of (21); zero in the exact
            motion.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"kinetic": "J", "potential": "J", "work": "J", "residual": "J"}
    AXES: ClassVar[dict[str, tuple[str, ...]]] = dict.fromkeys(UNITS, ())

    kinetic: Float[Array, "..."]
    potential: Float[Array, "..."]
    work: Float[Array, "..."]
    residual: Float[Array, "..."]


def residuals_at(grasp: Grasp, state: State) -> Residuals:
    """Residuals of a prepared grasp at one state."""
    leaves = to_leaves(state, grasp.form)
    frames, touching = world_poses(grasp, leaves.q), touches(grasp, leaves.s)
    left = residual(grasp, frames, touching)
    each = zip(grasp.contacts, left.gaps, touching, strict=True)
    rows = [c.split_gap((frames[1 + c.finger], frames[0]), t, gap) for c, gap, t in each]
    normal, tangential = zip(*rows, strict=True)
    tangencies = [c.reported(t) for c, t in zip(grasp.contacts, left.tangencies, strict=True)]
    return Residuals(_column(normal), _column(tangential), _column(tangencies))


def worst(residuals: Residuals) -> Array:
    """Largest absolute residual over contacts, per state: metres and radians together."""
    rows = residuals.normal.shape[:-1]
    parts = [residuals.normal, residuals.tangential, residuals.tangency]
    flat = jnp.concatenate([part.reshape(*rows, -1) for part in parts], axis=-1)
    return jnp.max(jnp.abs(flat), axis=-1)


def closed_within(dtype: Any) -> float:
    """Largest size of the worst row [m or rad] at which a state still counts as on the constraints."""
    return 1e-9 if np.dtype(dtype) == np.float64 else 1e-5


def multipliers_at(grasp: Grasp, t: Scalar, state: State, formulation: Formulation) -> Multipliers:
    """Contact forces of a prepared grasp at one state."""
    # Forces are unknowns of the equations of motion, and depend on the velocities and the torques too.
    instant = evaluate(grasp, t, to_leaves(state, grasp.form), formulation)
    return split_forces(grasp, [m.pose for m in instant.motions], instant.touching, instant.forces)


def split_forces(grasp: Grasp, frames: Sequence[Any], touching: Sequence[Any], forces: Rows) -> Multipliers:
    r"""The chapter's $f$ and $\lambda$ from the forces on the fingertips, given row by row in world axes."""
    each = zip(grasp.contacts, touching, forces, strict=True)
    pairs = [c.split_force((frames[1 + c.finger], frames[0]), t, force) for c, t, force in each]
    f, lam = zip(*pairs, strict=True)
    spins = [c.spin_torque(force) for c, force in zip(grasp.contacts, forces, strict=True)]
    if all(spin is None for spin in spins):
        return Multipliers(_column(f), _column(lam))
    zero = jnp.zeros_like(f[0])
    return Multipliers(_column(f), _column(lam), _column([zero if spin is None else spin for spin in spins]))


def _column(values: Sequence[Any]) -> Array:
    """One number or vector per contact as an array, shape (c,) or (c, 3)."""
    return jnp.stack([x.array() if isinstance(x, Vec3) else jnp.asarray(x) for x in values])


def energies_at(grasp: Grasp, state: State) -> tuple[Scalar, Scalar]:
    """Kinetic and potential energy of a prepared grasp at one state."""
    leaves = to_leaves(state, grasp.form)
    motions, inertias = bodies(grasp, leaves)
    tips, angles = [motion.pose.origin for motion in motions[1:]], joint_angles(grasp, leaves.q)
    stored = as_controller(grasp.controller).potential(tips, angles)
    return _kinetic_energy(inertias, leaves.v), stored + _gravity_potential(grasp, leaves)


def _kinetic_energy(inertias: Sequence[Inertia], rates: Blocks) -> Scalar:
    r"""$\frac12 v^T M v$: (13), (71)."""
    return total([_quadratic(i.mass, v) for i, v in zip(inertias, rates, strict=True)])


def _quadratic(mass: Sequence[Sequence[Scalar]], v: Scalars) -> Scalar:
    r"""$\frac12 v^T M v$ of one body, from the lower triangle of its mass matrix."""
    # Entries below the diagonal stand for two, which cancels the half.
    terms = []
    for i, row in enumerate(mass):
        terms += [row[j] * v[i] * v[j] for j in range(i)]
        terms.append(0.5 * row[i] * v[i] * v[i])
    return total(terms)


def _gravity_potential(grasp: Grasp, leaves: Leaves) -> Scalar:
    """Potential energy [J] of all bodies in the grasp's gravity; zero where it has none."""
    each = zip(grasp.bodies, leaves.q, grasp.fields(), strict=True)
    return total([body.gravity_potential(q, field) for body, q, field in each if field is not None])


def power(grasp: Grasp, t: Scalar, leaves: Leaves, instant: Instant) -> Scalar:
    r"""Power [W] that changes $K + P$: $\sum u \cdot \dot q + \dot P$, (18) and (20).

    With the built-in controllers it is minus the dissipation; with a user's controller, whose
    potential is unknown, it is the whole power of the joint torques. Loads have the power
    $F \cdot v + T \cdot \omega$, $Q \cdot v$ in the object's coordinates. Bodies that move as prescribed do
    work too: $-\mu \cdot b$ at a contact whose gap they change at the rate b.
    """
    motions = instant.motions
    controller = as_controller(grasp.controller)
    torques, _ = controller.driven(t, sensed(grasp, leaves, motions), leaves.memory)
    drive = total(
        [u * w for us, ws in zip(torques, leaves.v[1:], strict=True) for u, w in zip(us, ws, strict=True)]
    )
    tips = [m.pose.origin for m in motions[1:]]
    # Velocities of what rests are Python's own zeros, which would be doubles beside single precision.
    moves = jax.tree.map(
        lambda rate, at: jnp.asarray(rate, jnp.result_type(at)),
        [m.twist.velocity for m in motions[1:]],
        tips,
    )
    # dP/dt of the controller's potential, as its derivative along the rates of tips and joint angles.
    _, stored = jax.jvp(
        lambda points, angles: controller.potential(points, angles),
        (tips, joint_angles(grasp, leaves.q)),
        (moves, leaves.v[1:]),
    )
    # On the constraints A v = -b, so that the contact forces A^T mu have the power v . A^T mu = -mu . b.
    pushed = [
        inner(force, given)
        for force, given in zip(instant.forces, instant.line.drift, strict=True)
        if given is not None
    ]
    load = loaded(grasp, t, leaves.q[0], motions[0])
    return plus(drive + stored - total(pushed), 0.0 if load is None else inner(load, leaves.v[0]))


def of_reached(function: Callable, states: State, start: State) -> Any:
    """`function` of states along a leading axis, NaN for those that a run did not reach.

    The function itself is given `start` in their place. At NaN its derivative would be NaN, and in reverse
    mode the product of that with the zero cotangent of these rows would be NaN too.
    """
    there = reached(states)
    where = lambda a, b: jnp.where(there.reshape(-1, *(1,) * (a.ndim - 1)), a, b)  # noqa: E731
    found = function(jax.tree.map(where, states, start))
    return jax.tree.map(lambda a: where(a, jnp.nan), found)


@compiled_for_many
def residuals(grasp: Grasp, states: State) -> Residuals:
    """Constraint residuals of one state, or of states with a leading time axis.

    Returns:
        `Residuals`, of the states' leading shape.

    Raises:
        ValueError: If the states do not fit this grasp.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> bool(abs(jxr.residuals(grasp, state).normal[0]) < 1e-15)
        True
    """
    ready = grasp.prepared()
    return over_time(lambda state: residuals_at(ready, state), states)


def multipliers(
    grasp: Grasp, ts: Float[Array, "..."], states: State, formulation: Formulation | None = None
) -> Multipliers:
    """Contact forces [N] at one time and state, or along a leading time axis.

    Returns:
        `Multipliers`, of the states' leading shape.

    Raises:
        ValueError: If the states do not fit this grasp, or `ts` has not one time for every state.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> bool(jxr.multipliers(grasp, 0.0, state).f[0] > 0)  # pressing
        True
    """
    return _multipliers(grasp, ts, states, as_formulation(grasp, formulation))


@compiled_for_many
def _multipliers(
    grasp: Grasp, ts: Float[Array, "..."], states: State, formulation: Formulation
) -> Multipliers:
    ready, ts = grasp.prepared(), as_times(ts, states)
    return over_time(lambda state, t: multipliers_at(ready, t, state, formulation), states, ts)


def torques(grasp: Grasp, ts: Float[Array, "..."], states: State) -> tuple[Array, ...]:
    r"""Joint torques $u$ of the grasp's controller at one time and state, or along a leading time axis.

    (16) of `control.Opposition` and (75) of `control.Press`; what a caller's own controller returns. At a
    declared jump they are those after it. A controller with a memory is given the memory in the states:
    `control.Sampled` gives the torques that it holds. With states that have no memory it is given the initial
    one, and `control.Sampled` gives what a sample there would.

    Returns:
        One array per finger, shape (..., k) for its k joints [N m]; of a `Jaw` forces [N].

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch()
        >>> [u.shape for u in jxr.torques(grasp, 0.0, state)]
        [(3,), (2,)]
    """
    return _torques(grasp, ts, states)


@compiled_for_many
def _torques(grasp: Grasp, ts: Float[Array, "..."], states: State) -> tuple[Array, ...]:
    ready, ts = grasp.prepared(), as_times(ts, states)

    def at(state: State, t: Scalar) -> tuple[Array, ...]:
        leaves = to_leaves(state, ready.form)
        motions, _ = bodies(ready, leaves)
        each, _ = as_controller(ready.controller).driven(t, sensed(ready, leaves, motions), leaves.memory)
        return tuple(stacked(us).astype(state.q.dtype) for us in each)

    return over_time(at, states, ts)


def wrenches(
    grasp: Grasp, ts: Float[Array, "..."], states: State
) -> tuple[Float[Array, "... d"], Float[Array, "..."]]:
    """Force and torque of all loads on the object, at one time and state or along a leading time axis.

    They are zero for a grasp without loads. Blows (`loads.Impulse`) act for no time and are left out.

    Returns:
        Force [N], shape (..., d), and torque [N m] about the object's origin, in space of shape (..., 3).
        Both are in world axes.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch()
        >>> pushed = grasp.with_(load=jxr.loads.Push((0.2, 0.0), 0.1, 0.05))
        >>> force, torque = jxr.wrenches(pushed, 0.125, state)
        >>> f"{force[0]:.3f} N"
        '0.200 N'
    """
    return _wrenches(grasp, ts, states)


@compiled_for_many
def _wrenches(grasp: Grasp, ts: Float[Array, "..."], states: State) -> tuple[Array, Array]:
    ready, ts = grasp.prepared(), as_times(ts, states)

    def at(state: State, t: Scalar) -> tuple[Array, Array]:
        leaves = to_leaves(state, ready.form)
        motion = bodies(ready, leaves)[0][0]
        found = wrench_on(ready, t, leaves.q[0], motion)
        force, torque = (jax.tree.map(jnp.zeros_like, motion.pose.origin), None) if found is None else found
        if torque is None:
            torque = jnp.zeros(3 if ready.spatial else ())
        parts = (x.array() if isinstance(x, Vec2 | Vec3) else jnp.asarray(x) for x in (force, torque))
        pushed, turned = (x.astype(state.q.dtype) for x in parts)
        return pushed, turned

    return over_time(at, states, ts)


def accelerations(
    grasp: Grasp, ts: Float[Array, "..."], states: State, formulation: Formulation | None = None
) -> Float[Array, "... n"]:
    r"""Accelerations $\dot v$ of one state, or along a leading time axis: in the order of `State.v`.

    From (1)-(3), (73)-(74) with the constraints differentiated twice, $A \dot v = -\dot A v$; with torques
    put in, these are the closed loops (19), (23) of `control.Opposition` and (76)-(77) of `control.Press`.
    The bodies' velocities are in the coordinates of their classes (of a `FreeObject3` the spin in body axes).

    Returns:
        Shape (..., n) [m/s^2, rad/s^2].

    Raises:
        ValueError: If the states do not fit this grasp, or `ts` has not one time for every state.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> jxr.accelerations(grasp, 0.0, state).shape
        (3,)
    """
    return _accelerations(grasp, ts, states, as_formulation(grasp, formulation))


@compiled_for_many
def _accelerations(
    grasp: Grasp, ts: Float[Array, "..."], states: State, formulation: Formulation
) -> Float[Array, "... n"]:
    ready, ts = grasp.prepared(), as_times(ts, states)

    def at(state: State, t: Scalar) -> Array:
        return join(evaluate(ready, t, to_leaves(state, ready.form), formulation).rates.v)

    return over_time(at, states, ts)


@compiled_for_many
def energies(grasp: Grasp, states: State) -> tuple[Array, Array]:
    """Kinetic and potential energy [J] of one state, or of states with a leading time axis.

    Returns:
        Two arrays [J], of the states' leading shape.

    Raises:
        ValueError: If the states do not fit this grasp.

    Example:
        >>> import jaxroll as jxr
        >>> kinetic, potential = jxr.energies(*jxr.scenes.pivoted())
        >>> f"{1e3 * potential:.2f} mJ"
        '22.70 mJ'
    """
    ready = grasp.prepared()
    return over_time(lambda state: energies_at(ready, state), states)


def as_times(ts: Any, states: State) -> Array:
    """Times [s] as an array: one for every state."""
    times, wanted = as_array("ts", ts), states.q.shape[:-1]
    if times.shape != wanted:
        raise ValueError(f"argument ts must have shape {wanted}, as states have, but had {times.shape}")
    return times


def over_time(function: Callable, states: State, *beside: Array) -> Any:
    """`function` of one state, or of each along a leading time axis (see `of_reached`).

    `beside` are further arguments, such as times, one for every state. A function that takes times evaluates
    the equations of motion, and is traced with `sharing`: so the multipliers of 101 states of the spatial
    pinch compile in a quarter of the time. Other functions are too small for that to pay.
    """

    def one(*given: Any) -> Any:
        with sharing() if beside else contextlib.nullcontext():
            return function(*given)

    if states.q.ndim == 1:
        return one(states, *beside)
    each = jax.vmap(one)
    if not states.q.shape[0]:  # there is no first state, nor one that was not reached
        return each(states, *beside)
    return of_reached(lambda rows: each(rows, *beside), states, jax.tree.map(lambda rows: rows[0], states))
