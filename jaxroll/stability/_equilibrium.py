"""Equilibria: configurations where joint torques, gravity and contact forces balance."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._types import Given, Scalar
from ..integration import constraint_rows, generalised_force, Multipliers
from ..mechanics import Grasp, poses, split, State, touches

_STEPS = 100
# Singular values below this, relative to the largest, are neutral directions: along them nothing moves.
_RANK = 1e-9
# Longest step of one iteration, in radians or mean link lengths.
_LONGEST = 0.1


class Equilibrium(eqx.Module):
    r"""A grasp at rest.

    Attributes:
        state: Configuration and contact coordinates, at zero velocity.
        push: Shape (c, 2), force of each contact on its fingertip in world axes [N].
        multipliers: The same forces as $f$ and $\lambda$ of the chapter.
        imbalance: Largest scaled residual of force balance and constraints; about 1e-15 when found.
        found: Whether Newton's method converged.
    """

    state: State
    push: Float[Array, "c 2"]
    multipliers: Multipliers
    imbalance: Float[Array, ""]
    found: Bool[Array, ""]


@eqx.filter_jit
def equilibrium(grasp: Grasp, state: State, *, t: Given = 0.0) -> Equilibrium:
    r"""Find an equilibrium of the closed loop near a state: Newton on the constrained problem.

    Solves $F(q) + A^T \mu = 0$ with gap and tangency closed, for configuration, contact coordinates and
    contact forces together; $F$ are joint torques at rest and gravity. With a built-in controller these are
    the stationary points of the potential (22) on the constraint manifold, stable or not. Where neutral
    directions make a whole family of equilibria, the one returned is the nearest to `state` in the
    coordinates (lengths measured in mean link lengths).

    Args:
        grasp: The grasp.
        state: Where to start: the end of a simulated run, or a closed state. Its velocity is ignored.
        t: Time [s] at which a time-dependent controller is held.

    Returns:
        An `Equilibrium`; `found` is False where none was reached.

    Accuracy: residuals at rounding level. Derivatives, in both modes, are those of the implicit function
    theorem, along a family too.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> rest = jxr.stability.equilibrium(grasp, state)
        >>> bool(rest.found), f"{1e3 * (0.003 - rest.state.s[0]):.3f} mm"
        (True, '-4.788 mm')
    """
    ready = grasp.prepared()
    rest, left = locate(ready, state, t)
    q, s, push = rest
    worst = jnp.max(jnp.abs(left))
    forces = _multipliers(ready, q, s, push)
    at = State(q, jnp.zeros_like(q), s)
    return Equilibrium(at, push, forces, worst, worst < 1e-9)


def locate(grasp: Grasp, state: State, t: Given) -> tuple[tuple[Array, Array, Array], Array]:
    """Configuration, contact coordinates and forces at rest, differentiable, and what is left over."""
    fixed, still = jax.tree.map(lambda x: jax.lax.stop_gradient(x) if eqx.is_array(x) else x, (grasp, state))
    start, scale = _start(fixed, still, t)
    z = _newton(lambda z: _balance(fixed, z, scale, t), start, grasp.coordinates + len(grasp.contacts))
    pair, inverse = _settle(lambda pair: _nearest(fixed, still, pair, scale, t), z)
    size = start.shape[0]
    left = _nearest(grasp, state, pair, scale, t)
    z = (pair - inverse @ left)[:size] * scale.unknowns  # one more step, which carries the derivative
    n, contacts = grasp.coordinates, len(grasp.contacts)
    return (z[:n], z[n : n + contacts], z[n + contacts :].reshape(contacts, 2)), left[size:]


class _Scale(eqx.Module):
    """Sizes that make unknowns and equations comparable."""

    unknowns: Array
    equations: Array


def _start(grasp: Grasp, state: State, t: Given) -> tuple[Array, _Scale]:
    """The first guess, without contact forces, and the sizes of everything."""
    contacts = len(grasp.contacts)
    drive = _drive(grasp, state.q, state.s, t)
    one, (length, coordinates) = jnp.ones((), state.q.dtype), _sizes(grasp)
    force = jnp.maximum(jnp.max(jnp.abs(drive * coordinates)) / length, 1e-6)
    ones = jnp.ones(contacts, state.q.dtype)
    unknowns = jnp.concatenate([coordinates, ones * length, jnp.tile(ones, 2) * force])
    rows = jnp.tile(jnp.stack([length, length, one]), contacts)
    equations = jnp.concatenate([force * length / coordinates, rows])
    start = jnp.concatenate([state.q, state.s, jnp.zeros(2 * contacts, state.q.dtype)])
    return start / unknowns, _Scale(unknowns, equations)


def _sizes(grasp: Grasp) -> tuple[Scalar, Array]:
    """Mean link length, and what makes each coordinate comparable with an angle."""
    length = sum(jnp.mean(jnp.stack(f.lengths)) for f in grasp.fingers) / len(grasp.fingers)
    free = grasp.object.freedoms == 3
    one = jnp.ones_like(length)
    return length, jnp.stack([length if free and i < 2 else one for i in range(grasp.coordinates)])


def _drive(grasp: Grasp, q: Array, s: Array, t: Given) -> Array:
    """Torques and gravity at rest."""
    return generalised_force(grasp, jnp.asarray(t, q.dtype), State(q, jnp.zeros_like(q), s))


def contact_force(grasp: Grasp, q: Array, s: Array, push: Array) -> Array:
    r"""$A^T \mu$: generalised force of the contacts at frozen contact coordinates."""
    pushes = push.reshape(-1, 2)

    def done(q: Array) -> Scalar:
        body, *tips = poses(grasp, split(q, grasp.sizes))
        work = jnp.zeros((), q.dtype)
        at = touches(grasp, tuple(s[i] for i in range(s.shape[0])))
        for contact, touching, force in zip(grasp.contacts, at, pushes, strict=True):
            gap = tips[contact.finger].place(touching.tip.point) - body.place(touching.object.point)
            work = work + gap.x * force[0] + gap.y * force[1]
        return work

    return jax.grad(done)(q)


def _balance(grasp: Grasp, z: Array, scale: _Scale, t: Given) -> Array:
    """Balance of forces and constraint rows, scaled."""
    n, contacts = grasp.coordinates, len(grasp.contacts)
    z = z * scale.unknowns
    q, s, push = z[:n], z[n : n + contacts], z[n + contacts :]
    force = _drive(grasp, q, s, t) + contact_force(grasp, q, s, push)
    return jnp.concatenate([force, constraint_rows(grasp, q, s)]) / scale.equations


def _nearest(grasp: Grasp, state: State, pair: Array, scale: _Scale, t: Given) -> Array:
    """Conditions of the equilibrium nearest to a state; `pair` holds it and their multipliers."""
    z, pressure = jnp.split(pair, 2)
    left, pull = jax.vjp(lambda z: _balance(grasp, z, scale, t), z)
    n = grasp.coordinates
    away = (z[:n] * scale.unknowns[:n] - state.q) / _sizes(grasp)[1] ** 2 * scale.unknowns[:n]
    return jnp.concatenate([pull(pressure)[0].at[:n].add(away), left])


def _newton(equations: Callable[[Array], Array], start: Array, moving: int) -> Array:
    """Newton's method with shortest, bounded steps of the first `moving` unknowns."""
    basis = jnp.eye(start.shape[0], dtype=start.dtype)
    only_forces = jnp.arange(start.shape[0])[None, :] >= moving

    def improve(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        z, _, i = carry
        left, push = jax.linearize(equations, z)
        jacobian = jax.vmap(push, out_axes=1)(basis)
        # The first iteration sets the contact forces alone: without them the curvature would be wrong.
        inverse = jnp.linalg.pinv(jnp.where((i > 0) | only_forces, jacobian, 0.0), rtol=_RANK)
        step = inverse @ left
        share = jnp.minimum(1.0, _LONGEST / jnp.max(jnp.abs(step[:moving]) + 1e-300))
        return z - step * share, jnp.max(jnp.abs(step)), i + 1

    def more(carry: tuple[Any, ...]) -> Scalar:
        _, moved, i = carry
        return (moved > 1e-12) & (i < _STEPS)

    first = (start, jnp.inf * jnp.ones((), start.dtype), jnp.array(0))
    return jax.lax.while_loop(more, improve, first)[0]


def _settle(equations: Callable[[Array], Array], z: Array) -> tuple[Array, Array]:
    """Newton from an equilibrium to the nearest one; also the pseudoinverse of the last Jacobian."""
    basis = jnp.eye(2 * z.shape[0], dtype=z.dtype)

    def improve(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        pair, _, _, i = carry
        left, push = jax.linearize(equations, pair)
        inverse = jnp.linalg.pinv(jax.vmap(push, out_axes=1)(basis), rtol=_RANK)
        step = inverse @ left
        return pair - step, inverse, jnp.max(jnp.abs(step[: z.shape[0]])), i + 1

    def more(carry: tuple[Any, ...]) -> Scalar:
        _, _, moved, i = carry
        return (moved > 1e-12) & (i < _STEPS // 4)

    start = jnp.concatenate([z, jnp.zeros_like(z)])
    first = (start, jnp.zeros_like(basis), jnp.inf * jnp.ones((), z.dtype), jnp.array(0))
    pair, inverse, _, _ = jax.lax.while_loop(more, improve, first)
    return pair, inverse


def _multipliers(grasp: Grasp, q: Array, s: Array, push: Array) -> Multipliers:
    """Contact forces in the chapter's sign and frame."""
    body = poses(grasp, split(q, grasp.sizes))[0]
    f, lam = [], []
    for i, contact in enumerate(grasp.contacts):
        face = grasp.contours(contact)[1].frame(contact.s_object - s[i])
        tangent = body.turn(face.tangent)
        f.append(push[i, 0] * tangent.y - push[i, 1] * tangent.x)
        lam.append(-contact.sense * (push[i, 0] * tangent.x + push[i, 1] * tangent.y))
    return Multipliers(jnp.stack(f), jnp.stack(lam))
