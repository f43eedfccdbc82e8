r"""The terms of the equations of motion (1)-(3), (73)-(74) as ordinary arrays, for users and tests.

Inside the package a mass matrix is a triangle of scalars per body, and constraint rows are in world axes, in
one block per body of a contact (`_linearisation`). Here the mass matrices become one array, and the rows the
gradients of the chapter's $Q_i$ and $R_i$, and of what is their like in space.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._linalg import factorise, Vec2, Vec3
from .._mechanics import (
    check_grasp,
    check_planar,
    check_spatial,
    compiled,
    Grasp,
    join,
    State,
    to_leaves,
)
from .._printing import listed
from .._types import Scalar
from ..contact import Rows
from ._equations import bodies, drives, net_force, touches
from ._linearisation import linearise


class EquationTerms(eqx.Module):
    r"""$M \dot v + h + \sum_i (f_i \nabla Q_i + \lambda_i \nabla R_i + \tau_i \nabla S_i) = u$ at one state.

    Attributes:
        mass: Shape (n, n), mass matrix $M$: $G(X)$ of (15).
        bias: Shape (n,), $h = (\frac12 \dot G + S) v$ less the generalised force of gravity.
        normal: Shape (c, n), $\nabla Q_i$: coefficients of $f_i$ in (1)-(3), (73)-(74).
        tangential: Shape (c, n), $\nabla R_i$: coefficients of $\lambda_i$. In space, shape (c, 3, n): of its
            components in world axes.
        spin: Shape (c, n), $\nabla S_i$: coefficients of the torques $\tau_i$ that prevent spin, with
            $\nabla S_i \cdot v = n \cdot (\omega_A - \omega_B)$ for the object's outward normal; zero for
            contacts that leave it free. None where no contact prevents it.
    """

    __repr__ = listed

    mass: Float[Array, "n n"]
    bias: Float[Array, " n"]
    normal: Float[Array, "c n"]
    tangential: Float[Array, "..."]
    spin: Float[Array, "c n"] | None = None


@compiled
def equation_terms(grasp: Grasp, state: State) -> EquationTerms:
    r"""Mass matrix, bias force and constraint gradients of one state.

    The gradients are derivatives of the world-frame gap at frozen contact coordinates, projected on the
    object's inward normal $n_0$ and on $b_0$; in space on $n_0$ and on the tangent plane. These are the
    coefficients of the chapter's (2)-(3) and (73)-(74); its partial derivative of Q at fixed s (11), (15),
    (72) would give others.

    Forces are those of `multipliers`: $f_i$, $\lambda_i$, and in space $\tau_i$ its `spin`.

    Returns:
        `EquationTerms`.

    Raises:
        ValueError: If `grasp` is not a grasp, or the state does not fit it.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> jxr.equation_terms(grasp, state).normal.shape
        (1, 3)
    """
    check_grasp(grasp)
    (check_spatial if grasp.spatial else check_planar)(grasp)
    ready = grasp.prepared()
    leaves = to_leaves(state, ready.form)
    motions, inertias = bodies(ready, leaves)
    touching = touches(ready, leaves.s)
    line = linearise(ready, motions, [factorise(i.mass) for i in inertias], touching)
    gradients = _gradients3 if grasp.spatial else _gradients2
    each = [
        gradients(ready, contact, rows, (motions[0].pose, t))
        for contact, rows, t in zip(ready.contacts, line.jacobian, touching, strict=True)
    ]
    normal, tangential, spin = zip(*each, strict=True)
    forces = [force for inertia in inertias for force in inertia.force]
    return EquationTerms(
        mass_matrix([i.mass for i in inertias], grasp.coordinates),
        jnp.stack([jnp.asarray(f, state.q.dtype) for f in forces]),
        jnp.stack(normal),
        jnp.stack(tangential),
        jnp.stack(spin) if any(c.rows > 3 for c in grasp.contacts) else None,
    )


_Gradients = tuple[Array, Array, Array]


def _gradients2(grasp: Grasp, contact: Any, rows: tuple[Rows, Rows], place: tuple[Any, Any]) -> _Gradients:
    """Of Q and R, shape (n,) each; nothing spins in the plane."""
    # A contact's two rows are the derivatives of the gap's world components x and y; a column (x, y) of
    # them, one per coordinate, is a vector, whose parts along n_0 and b_0 are entries of the gradients.
    pose, touch = place
    b = pose.turn(touch.object.tangent)
    tip, face = ([Vec2(*pair) for pair in zip(*block, strict=True)] for block in rows)
    blocks = {0: face, 1 + contact.finger: tip}
    normal = _row(grasp, {k: [c.dot(b.left()) for c in v] for k, v in blocks.items()})
    signed = b * contact.sense
    tangential = _row(grasp, {k: [c.dot(signed) for c in v] for k, v in blocks.items()})
    return normal, tangential, jnp.zeros_like(normal)


def _gradients3(grasp: Grasp, contact: Any, rows: tuple[Rows, Rows], place: tuple[Any, Any]) -> _Gradients:
    """Of Q, shape (n,), of the tangential parts of the gap, shape (3, n), and of the spin, shape (n,)."""
    pose, touch = place
    n = pose.turn(touch.object.normal)
    tip, face = ([Vec3(*column) for column in zip(*block[:3], strict=True)] for block in rows)
    blocks = {0: face, 1 + contact.finger: tip}
    # The force on the fingertip is f n - lambda, with lambda in the tangent plane.
    normal = _row(grasp, {k: [-c.dot(n) for c in v] for k, v in blocks.items()})
    aside = {k: [c - n * c.dot(n) for c in v] for k, v in blocks.items()}
    tangential = jnp.stack(
        [_row(grasp, {k: [getattr(c, axis) for c in v] for k, v in aside.items()}) for axis in "xyz"]
    )
    if contact.rows == 3:
        return normal, tangential, jnp.zeros_like(normal)
    # The torque on the object by a multiplier of one. The row divided by it has the coefficients of a torque.
    torque = contact.spin_torque((0.0, 0.0, 0.0, 1.0))
    turning = {0: rows[1][3], 1 + contact.finger: rows[0][3]}
    return normal, tangential, _row(grasp, {k: [-x / torque for x in v] for k, v in turning.items()})


def _row(grasp: Grasp, blocks: dict[int, list]) -> Array:
    """A row of length n from its blocks, by body (0 is the object); zero for the bodies that have none."""
    entries: list = []
    for i, size in enumerate(grasp.sizes):
        entries += blocks.get(i, [0.0] * size)
    return jnp.stack([jnp.asarray(e) for e in entries])


def mass_matrix(masses: list, n: int) -> Float[Array, "n n"]:
    """Block-diagonal mass matrix, shape (n, n), from the lower triangles of the bodies."""
    # Python's own zeros have no precision, so that the matrix has that of the masses.
    entries: list[list[Any]] = [[0.0] * n for _ in range(n)]
    at = 0
    for mass in masses:
        for i, row in enumerate(mass):
            for j, entry in enumerate(row):
                entries[at + i][at + j] = entries[at + j][at + i] = entry
        at += len(mass)
    return jnp.stack([jnp.stack(row) for row in entries])


def generalised_force(grasp: Grasp, t: Scalar, state: State) -> Array:
    """$u - h$, shape (n,): joint torques, loads and gravity less velocity terms, without contact forces."""
    leaves = to_leaves(state, grasp.form)
    motions, inertias = bodies(grasp, leaves)
    driven, _ = drives(grasp, t, leaves, motions)
    return join(tuple(net_force(i, u) for i, u in zip(inertias, driven, strict=True)))


def memory_rates(grasp: Grasp, t: Scalar, state: State) -> Float[Array, " k"]:
    """Time derivative of the controller's memory."""
    leaves = to_leaves(state, grasp.form)
    motions, _ = bodies(grasp, leaves)
    return jnp.stack(drives(grasp, t, leaves, motions)[1])
