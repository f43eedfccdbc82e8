r"""Equilibria: configurations where joint torques, loads, gravity and contact forces balance.

The unknowns $z$ are configuration, contact coordinates, contact forces and a controller's memory, scaled to
be comparable (`_Scale`). The equations are the balance of forces $F(q) + A^T \mu = 0$, the constraint rows
(gap and tangency, of `_closing`), and zero for the rates of the memory. `_newton` solves them with the
pseudo-inverse of their Jacobian, since neutral directions, such as redundant joints, make it singular: the
equilibria are then a family.

Of a family the member nearest to the given state is returned, with $W$ the weights of `_weights`,

$$ \text{minimise } \tfrac12 (z - z_0)^T W (z - z_0) \quad \text{subject to } R(z) = 0, $$

and the conditions of this minimum (`_nearest`) are what the implicit function theorem differentiates. They
determine $z$ even where $R(z) = 0$ does not. `_verdict` linearises the closed loop at what is found here.
"""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._closing import constraint_rows
from .._linalg import unstack, value_and_jacobian, Vec2
from .._mechanics import check_planar, compiled, Grasp, split, State
from .._motion import (
    generalised_force,
    memory_after_sample,
    memory_rates,
    Multipliers,
    split_forces,
    touches,
    world_poses,
)
from .._printing import listed
from .._results import as_floats
from .._types import ByPrecision, Given, Scalar
from .._xla import perturbed
from ..contact import gap

_STEPS = 100
# Singular values below this, relative to the largest, count as zero: along their directions, the neutral
# ones, the residual does not change.
_RANK = ByPrecision(1e-9, 1e-5)
# Newton's method is near enough to count neutral directions if no scaled unknown moves by more than this, ...
_NEAR = ByPrecision(1e-9, 1e-4)
# ... and has converged when none moves by more than this.
_DONE = ByPrecision(1e-13, 1e-5)
# Largest scaled residual of an equilibrium.
_BALANCED = ByPrecision(1e-9, 1e-5)
# How far rounding may put a contact beyond an end of its contour, relative to a length.
_AT_END = ByPrecision(1e-9, 1e-5)
# Forces at the start count as rounding below this share of their change over a radian or a length.
_SLIGHT = 1e-6
# Longest step of one iteration, in radians or mean link lengths.
_LONGEST = 0.1


class Equilibrium(eqx.Module):
    r"""A grasp at rest.

    Attributes:
        state: Configuration and contact coordinates, at zero velocity.
        push: Shape (c, 2), force of each contact on its fingertip in world axes [N].
        multipliers: The same forces as $f$ and $\lambda$ of the chapter.
        imbalance: Largest scaled residual of force balance and constraints; about 1e-15 when found, in single
            precision about 1e-7.
        found: Whether Newton's method converged, to contacts between the ends of their contours.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"push": "N"}

    state: State
    push: Float[Array, "c 2"]
    multipliers: Multipliers
    imbalance: Float[Array, ""]
    found: Bool[Array, ""]


def equilibrium(grasp: Grasp, state: State, *, t: Given = 0.0) -> Equilibrium:
    r"""Find an equilibrium of the closed loop near a state: Newton on the constrained problem.

    Solves $F(q) + A^T \mu = 0$ with gap and tangency closed, for configuration, contact coordinates and
    contact forces together; $F$ are joint torques at rest, loads and gravity. Where all of $F$ derives from a
    potential, such as (22), equilibria are its stationary points on the constraint manifold, stable or not.
    Where neutral directions make a whole family of equilibria, the one returned is the nearest to `state` in
    the coordinates (lengths measured in mean link lengths).

    Args:
        grasp: The grasp.
        state: Where to start: the end of a simulated run, or a closed state. Its velocity is ignored.
        t: Time [s] at which a time-dependent controller or load is held.

    Returns:
        An `Equilibrium`; `found` is False where none was reached.

    Raises:
        ValueError: If the grasp lives in space, the state is not one of it, or `t` is not a finite number.

    Accuracy: residuals at rounding level; in single precision forces and coordinates are right to some 1e-5,
    relative to their scales. Derivatives with respect to `grasp`, `state` and `t`, in both
    modes, are those of the implicit function theorem, along a family too.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> rest = jxr.stability.equilibrium(grasp, state)
        >>> bool(rest.found), f"{1e3 * (0.003 - rest.state.s[0]):.3f} mm"
        (True, '-4.788 mm')
    """
    # A Python number would be of JAX's weak type, and compile a second program beside that for a run's end.
    held = as_floats("t", t, ())
    return _equilibrium(grasp, state, jnp.asarray(held, held.dtype))


@compiled
def _equilibrium(grasp: Grasp, state: State, t: Array) -> Equilibrium:
    """The equilibrium, compiled as one program; the array of unknowns is taken apart again."""
    check_planar(grasp)
    ready = grasp.prepared()
    found, left = rest_state(ready, state, t)
    q, s, push, memory = parts_of(ready, found)
    push = push.reshape(-1, 2)
    worst = jnp.max(jnp.abs(left))
    forces = _multipliers(ready, q, s, push)
    at = _resting(ready, q, s, memory, t)
    found_there = (worst < _BALANCED.of(worst)) & between_ends(ready, unstack(s), _sizes(ready)[0])
    return Equilibrium(at, push, forces, worst, found_there)


def between_ends(grasp: Grasp, places: Sequence[Scalar], length: Scalar) -> Bool[Array, ""]:
    """Whether every contact lies between the ends of its contours, to rounding of a positive length [m]."""
    each = zip(grasp.contacts, places, strict=True)
    margins = [margin for c, place in each for margin in c.ends(grasp.shapes(c), place)]
    # Beyond an end a contour goes on as a formula, where there is nothing to touch. `length` is among the
    # margins because these may be none.
    return jnp.all(jnp.stack([*margins, length]) >= -_AT_END.of(length) * length)


def on_contours(grasp: Grasp, s: Array, length: Scalar) -> Bool[Array, ""]:
    """The same for places as the chapter's $s_i$: on the object, counted along each contact's `sense`."""
    places = [c.s_object - c.sense * at for c, at in zip(grasp.contacts, s, strict=True)]
    return between_ends(grasp, places, length)


@eqx.filter_custom_jvp
def rest_state(grasp: Grasp, state: State, t: Given) -> tuple[Array, Array]:
    """The unknowns at rest, in SI units, and the scaled residual of the equations.

    The unknowns are configuration, contact coordinates, contact forces (world axes) and a controller's
    memory, in one array. A custom derivative replaces that of Newton's iterations.
    """
    start, scale = _start(grasp, state, t)
    moving = grasp.coordinates + len(grasp.contacts)
    z = _newton(lambda z: _balance(grasp, z, scale, t), start, moving, _weights(grasp, scale))
    return z * scale.unknowns, _balance(grasp, z, scale, t)


@rest_state.def_jvp
def _rest_state_jvp(primals: Any, tangents: Any) -> Any:
    """The implicit function theorem for the conditions of the equilibrium nearest to the state.

    The unknowns of these conditions are z and the multipliers p of R(z) = 0. The scales count as constant, as
    they only choose units.
    """
    grasp, state, t = primals
    found, left = rest_state(grasp, state, t)
    _, scale = _start(grasp, state, t)
    z, weights = found / scale.unknowns, _weights(grasp, scale)
    jacobian = jax.jacfwd(lambda z: _balance(grasp, z, scale, t))(z)
    away = weights * (z - _at(state, z) / scale.unknowns)
    # From W (z - z0) + J^T p = 0: p = -(J^T)^+ W (z - z0). On a family J is singular, hence pinv.
    pair = jnp.concatenate([z, -jnp.linalg.pinv(jacobian, rtol=_RANK.of(z)).T @ away])
    matrix = jax.jacfwd(lambda pair: _nearest(grasp, state, pair, scale, t))(pair)
    inverse = jnp.linalg.pinv(matrix, rtol=_RANK.of(z))
    moving, still, moving_dot = perturbed(primals, tangents)

    def conditions(moving: Any) -> Array:
        grasp, state, t = eqx.combine(moving, still)
        return _nearest(grasp, state, pair, scale, t)

    _, change = jax.jvp(conditions, (moving,), (moving_dot,))
    found_dot = -(inverse @ change)[: z.shape[0]] * scale.unknowns
    return (found, left), (found_dot, jnp.zeros_like(left))


class _Scale(eqx.Module):
    """Sizes that make unknowns and equations comparable: what is solved for is without dimension.

    Attributes:
        unknowns: 1 for angles, mean link length for lengths [m], the largest force at the start for forces
            [N].
        equations: That force for balances of forces, times a length for those of torques; a length for gaps;
            1 for tangencies.
    """

    unknowns: Array
    equations: Array


def _start(grasp: Grasp, state: State, t: Given) -> tuple[Array, _Scale]:
    """The first guess of the scaled unknowns, in which contact forces are zero, and the scales."""
    contacts, kept = len(grasp.contacts), _kept(grasp, state)
    one, (length, coordinates) = jnp.ones((), state.q.dtype), _sizes(grasp)
    force = _force_size(grasp, state, kept, t=t)
    ones = jnp.ones(contacts, state.q.dtype)
    unknowns = jnp.concatenate([coordinates, ones * length, jnp.tile(ones, 2) * force])
    rows = jnp.tile(jnp.stack([length, length, one]), contacts)
    equations = jnp.concatenate([force * length / coordinates, rows])
    start = jnp.concatenate([state.q, state.s, jnp.zeros(2 * contacts, state.q.dtype)])
    if kept.size:
        sizes = {"drives": equations[: grasp.coordinates], "coordinates": coordinates}
        unit, size = _memory_sizes(grasp, state, kept, t=t, **sizes)
        unknowns, equations = jnp.concatenate([unknowns, unit]), jnp.concatenate([equations, size])
        start = jnp.concatenate([start, kept])
    return start / unknowns, _Scale(unknowns, equations)


def _force_size(grasp: Grasp, state: State, kept: Array, *, t: Given) -> Scalar:
    """The largest force of controller, loads and gravity [N], or torque over a length, whatever the units.

    One where none of them acts.
    """
    length, coordinates = _sizes(grasp)
    drive = lambda q: _drive(grasp, q, state.s, kept, t=t)[0] * coordinates / length  # noqa: E731
    stiff = jnp.max(jnp.abs(jax.jacfwd(drive)(state.q) * coordinates[None]))
    size = jnp.maximum(jnp.max(jnp.abs(drive(state.q))), _SLIGHT * stiff)
    return jnp.where(size > 0.0, size, 1.0)


def _memory_sizes(
    grasp: Grasp, state: State, kept: Array, *, t: Given, drives: Array, coordinates: Array
) -> tuple[Array, Array]:
    """Units of a memory's numbers, which change the scaled forces by one, and sizes of its rates.

    `drives` are the sizes of the generalised forces, `coordinates` those of the configuration.
    """
    asked = lambda q, m: _drive(grasp, q, state.s, m, t=t)  # noqa: E731
    (_, by_kept), (by_q, by_itself) = jax.jacfwd(asked, argnums=(0, 1))(state.q, kept)
    positive = lambda x: jnp.where(x > 0, x, 1.0)  # noqa: E731
    unit = 1.0 / positive(jnp.linalg.norm(by_kept / drives[:, None], axis=0))
    scaled = jnp.concatenate([by_q * coordinates[None], by_itself * unit[None]], axis=1)
    return unit, positive(jnp.linalg.norm(scaled, axis=1))


def _kept(grasp: Grasp, state: State) -> Array:
    """The memory of a grasp's law, without what samples hold; of no length where there is none."""
    held = grasp.memory
    if held is None:
        return jnp.zeros(0, state.q.dtype)
    memory = held.astype(state.q.dtype) if state.memory is None else state.memory
    return memory[: _count(grasp)]


def _count(grasp: Grasp) -> int:
    """How many numbers the memory of a grasp's law has, without what samples hold."""
    joints = sum(finger.joints for finger in grasp.fingers)
    return grasp.form.memory - (joints + 1 if grasp.form.sampled else 0)


def parts_of(grasp: Grasp, z: Array) -> tuple[Array, Array, Array, Array]:
    """The unknowns as configuration, contact coordinates, contact forces and memory."""
    n, contacts = grasp.coordinates, len(grasp.contacts)
    return z[:n], z[n : n + contacts], z[n + contacts : n + 3 * contacts], z[n + 3 * contacts :]


def _resting(grasp: Grasp, q: Array, s: Array, kept: Array, t: Given) -> State:
    """The state at rest, with the memory of its controller; a sampled one holds what its law says there."""
    zero = jnp.zeros_like(q)
    if not grasp.form.memory:
        return State(q, zero, s)
    if not grasp.form.sampled:
        return State(q, zero, s, kept)
    joints = sum(finger.joints for finger in grasp.fingers)
    due = jnp.broadcast_to(jnp.asarray(t, q.dtype), (1,))
    memory = jnp.concatenate([kept, jnp.zeros(joints, q.dtype), due])
    held = memory_after_sample(grasp, jnp.asarray(t, q.dtype), State(q, zero, s, memory))
    # A sample moves the law's own memory, which is to stay.
    return State(q, zero, s, jnp.concatenate([kept, held[kept.shape[0] :]]))


def _sizes(grasp: Grasp) -> tuple[Scalar, Array]:
    """Mean size of the fingers [m], and the unit of each coordinate: 1 for angles, that size for lengths."""
    length = sum(finger.size for finger in grasp.fingers) / len(grasp.fingers)
    # An object with one freedom turns about its pivot; a free one has x, y and an angle.
    angles = [True] if grasp.object.freedoms == 1 else [False, False, True]
    for finger in grasp.fingers:
        angles += [finger.turns] * finger.joints
    one = jnp.ones_like(length)
    return length, jnp.stack([one if turns else length for turns in angles])


def _drive(grasp: Grasp, q: Array, s: Array, kept: Array, *, t: Given) -> tuple[Array, Array]:
    """$F(q)$: generalised forces of controller, loads and gravity at zero velocity; and how a memory changes.

    That is its time derivative, of a sampled law what a sample adds.
    """
    at, time = _resting(grasp, q, s, kept, t), jnp.asarray(t, q.dtype)
    force = generalised_force(grasp, time, at)
    if not kept.size:
        return force, kept
    if grasp.form.sampled:
        return force, memory_after_sample(grasp, time, at)[: kept.shape[0]] - kept
    return force, memory_rates(grasp, time, at)


def contact_force(grasp: Grasp, q: Array, s: Array, push: Array) -> Array:
    r"""$A^T \mu$: generalised force of the contacts at frozen contact coordinates.

    `push` holds the forces on the fingertips in world axes, $\mu$ by gaps. As the gap runs from the object's
    contact point to the fingertip's, its rows of $A$ are $\partial g / \partial q$, and $A^T \mu$ is the
    gradient of $\mu \cdot g$, which costs one pass backwards instead of all of $A$.
    """
    pushes = push.reshape(-1, 2)

    def done(q: Array) -> Scalar:
        body, *tips = world_poses(grasp, split(q, grasp.sizes))
        work = jnp.zeros((), q.dtype)
        each = zip(grasp.contacts, touches(grasp, unstack(s)), pushes, strict=True)
        for contact, touching, force in each:
            work = work + gap(tips[contact.finger], body, touching.points).dot(Vec2(*force))
        return work

    return jax.grad(done)(q)


def _balance(grasp: Grasp, z: Array, scale: _Scale, t: Given) -> Array:
    """$R(z)$: balance of forces and constraint rows, scaled; `z` is scaled too."""
    q, s, push, kept = parts_of(grasp, z * scale.unknowns)
    drive, change = _drive(grasp, q, s, kept, t=t)
    force = drive + contact_force(grasp, q, s, push)
    rows = [force, constraint_rows(grasp, q, s)] + ([change] if kept.size else [])
    return jnp.concatenate(rows) / scale.equations


def _nearest(grasp: Grasp, state: State, pair: Array, scale: _Scale, t: Given) -> Array:
    """Conditions of the equilibrium nearest to a state: $J^T p + W (z - z_0) = 0$ and $R(z) = 0$.

    `pair` holds z, then the multipliers p.
    """
    z, pressure = jnp.split(pair, 2)
    left, pull = jax.vjp(lambda z: _balance(grasp, z, scale, t), z)
    away = _weights(grasp, scale) * (z - _at(state, z) / scale.unknowns)
    return jnp.concatenate([pull(pressure)[0] + away, left])


def _at(state: State, z: Array) -> Array:
    """$z_0$ in SI units: the state's configuration, padded with zeros, whose weight is zero."""
    return jnp.concatenate([state.q, jnp.zeros(z.shape[0] - state.q.shape[0], z.dtype)])


def _weights(grasp: Grasp, scale: _Scale) -> Array:
    """Diagonal of W: the squared distance of configurations, angles in radians, lengths in mean link lengths.

    Contact coordinates and forces have no weight: they follow from the configuration.
    """
    n = grasp.coordinates
    squared = (scale.unknowns[:n] / _sizes(grasp)[1]) ** 2
    return jnp.zeros_like(scale.unknowns).at[:n].set(squared)


def _newton(equations: Callable[[Array], Array], start: Array, moving: int, weights: Array) -> Array:
    """Newton's method with bounded steps; on a family also along it, to the member nearest to the start.

    Args:
        equations: The residual R of the scaled unknowns.
        start: The scaled unknowns to start from.
        moving: How many of them, the first ones, are configuration and contact coordinates: these make
            bounded steps.
        weights: Diagonal of W.
    """
    size = start.shape[0]
    place = jnp.arange(size)

    # The loop carries z, the number of neutral directions (-1 while unknown), the largest entry of the last
    # step before it was shortened, and the number of passes.
    def improve(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        z, nullity, moved, i = carry
        left, jacobian = value_and_jacobian(equations, z)
        # The first pass solves for contact forces and memory alone, by least squares: the Jacobian contains
        # the change of A^T mu with the configuration, which would be that of zero forces.
        known = (i > 0) | (place[None, :] >= moving)
        u, sigma, vt = jnp.linalg.svd(jnp.where(known, jacobian, 0.0))
        firm = sigma > _RANK.of(sigma) * sigma[0]
        # Away from a family its directions are not exactly neutral: their number is counted once Newton's
        # method has converged, and kept from then on. The last `nullity` singular values then count as zero.
        nullity = jnp.where((nullity < 0) & (moved < _NEAR.of(moved)), jnp.sum(~firm), nullity)
        firm = jnp.where(nullity < 0, firm, place < size - nullity)
        step = vt.T @ (jnp.where(firm, u.T @ left / jnp.where(firm, sigma, 1.0), 0.0))
        # Along the family: with its directions as the rows of V, the step that minimises the weighted
        # distance is V^T (V W V^T)^-1 V W (z - z0). The other rows are zero, with ones on the diagonal of the
        # matrix: shapes must not depend on the number of neutral directions.
        loose = jnp.where(firm[:, None], 0.0, vt)
        metric = loose @ (weights[:, None] * loose.T) + jnp.diag(jnp.where(firm, 1.0, 0.0))
        back = loose.T @ jnp.linalg.solve(metric, loose @ (weights * (z - start)))
        step = step + jnp.where(nullity > 0, back, 0.0)
        share = jnp.minimum(1.0, _LONGEST / jnp.max(jnp.abs(step[:moving]) + 1e-300))
        return z - step * share, nullity, jnp.max(jnp.abs(step)), i + 1

    # Until Newton's method has converged, and the number of neutral directions is known.
    def more(carry: tuple[Any, ...]) -> Scalar:
        _, nullity, moved, i = carry
        return ((moved > _DONE.of(moved)) | (nullity < 0)) & (i < _STEPS)

    first = (start, jnp.array(-1), jnp.inf * jnp.ones((), start.dtype), jnp.array(0))
    return jax.lax.while_loop(more, improve, first)[0]


def _multipliers(grasp: Grasp, q: Array, s: Array, push: Array) -> Multipliers:
    r"""Contact forces as the chapter has them, $f$ along the normal and $\lambda$ along the tangent [N]."""
    frames, touching = world_poses(grasp, split(q, grasp.sizes)), touches(grasp, unstack(s))
    return split_forces(grasp, frames, touching, unstack(push))
