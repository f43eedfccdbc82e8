"""The rolling constraints of a grasp: residuals, and their linearisation with one factorisation.

The Schur complement $A M^{-1} A^T$ that the accelerations need is the one that the projection onto
positions and velocities needs; both use the `Linearisation` built here.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from .._algebra import Factor, factorise, once, Pose2, solve, total, Vec2
from .._types import Scalar, Scalars
from ..contact import gap, pfaffian, tangency, Touch, touch
from ._body import Inertia, Motion
from ._grasp import Grasp
from ._state import Blocks, Leaves

Vectors = tuple[Vec2, ...]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Residual:
    """What the rolling constraints leave over, per contact: gap vectors and sines of tangency."""

    gaps: Vectors
    tangencies: Scalars


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Linearisation:
    r"""Constraint Jacobian $A$, $M^{-1}A^T$ and the factorised Schur complement $A M^{-1} A^T$.

    Attributes:
        jacobian: For each contact: its columns for the finger's and for the object's coordinates.
        weighted: The same columns solved with the mass matrices, as rows (x, then y) of $A M^{-1}$.
        schur: Factor of the (2c, 2c) Schur complement.
    """

    jacobian: tuple[tuple[Vectors, Vectors], ...]
    weighted: tuple[tuple[tuple[Scalars, Scalars], tuple[Scalars, Scalars]], ...]
    schur: Factor


def poses(grasp: Grasp, q: Blocks) -> tuple[Pose2, ...]:
    """World poses of the object and of every fingertip."""
    tips = (finger.tip_pose(angles) for finger, angles in zip(grasp.fingers, q[1:], strict=True))
    return (grasp.object.pose(q[0]), *tips)


def touches(grasp: Grasp, s: Scalars) -> tuple[Touch, ...]:
    """Contact frames at the given rolling coordinates."""
    return tuple(
        touch(contact, *grasp.contours(contact), sigma)
        for contact, sigma in zip(grasp.contacts, s, strict=True)
    )


def residual(grasp: Grasp, frames: Sequence[Pose2], touching: Sequence[Touch]) -> Residual:
    """Gap and tangency of every contact."""
    pairs = [(frames[1 + c.finger], frames[0]) for c in grasp.contacts]
    return Residual(
        tuple(gap(*pair, t.points) for pair, t in zip(pairs, touching, strict=True)),
        tuple(tangency(*pair, t) for pair, t in zip(pairs, touching, strict=True)),
    )


def linearise(
    grasp: Grasp,
    motions: Sequence[Motion],
    masses: Sequence[Factor],
    touching: Sequence[Touch],
) -> Linearisation:
    """Jacobian by autodiff of the gap, and the factorised Schur complement."""
    jacobian, weighted = [], []
    for contact, t in zip(grasp.contacts, touching, strict=True):
        tip, body = motions[1 + contact.finger], motions[0]
        columns = once(pfaffian((tip.pose, body.pose), (tip.unit_twists, body.unit_twists), t.points))
        jacobian.append(columns)
        weighted.append((_solve(masses[1 + contact.finger], columns[0]), _solve(masses[0], columns[1])))
    rows = []
    for i, (contact, columns) in enumerate(zip(grasp.contacts, jacobian, strict=True)):
        for axis in (0, 1):
            row = []
            for j in range(i + 1):
                shared = contact.finger == grasp.contacts[j].finger
                row += [_schur_entry(columns, axis, weighted[j], other, shared) for other in (0, 1)]
            rows.append(tuple(row[: 2 * i + axis + 1]))
    return Linearisation(tuple(jacobian), tuple(weighted), factorise(rows))


def unknown_line(grasp: Grasp) -> Linearisation:
    """A linearisation full of zeros, as the state of a loop that will fill it."""
    zero = jnp.zeros(())
    jacobian, weighted = [], []
    for contact in grasp.contacts:
        counts = (grasp.sizes[1 + contact.finger], grasp.sizes[0])
        jacobian.append(tuple((Vec2(zero, zero),) * k for k in counts))
        weighted.append(tuple(((zero,) * k, (zero,) * k) for k in counts))
    m = 2 * len(grasp.contacts)
    schur = Factor(tuple((zero,) * i for i in range(m)), (zero,) * m, zero)
    return Linearisation(tuple(jacobian), tuple(weighted), schur)


def _solve(mass: Factor, columns: Vectors) -> tuple[Scalars, Scalars]:
    return solve(mass, [c.x for c in columns]), solve(mass, [c.y for c in columns])


def _component(vector: Vec2, axis: int) -> Scalar:
    return vector.y if axis else vector.x


def _schur_entry(
    columns: tuple[Vectors, Vectors],
    axis: int,
    weighted: tuple[tuple[Scalars, Scalars], tuple[Scalars, Scalars]],
    other: int,
    shared: bool,
) -> Scalar:
    blocks = (0, 1) if shared else (1,)
    return total(
        [
            _component(column, axis) * weight
            for block in blocks
            for column, weight in zip(columns[block], weighted[block][other], strict=True)
        ]
    )


def spins(grasp: Grasp, rates: Blocks) -> Scalars:
    """Angular rates of the object and of every fingertip."""
    tips = (finger.spin(block) for finger, block in zip(grasp.fingers, rates[1:], strict=True))
    return (grasp.object.spin(rates[0]), *tips)


def apply_jacobian(grasp: Grasp, line: Linearisation, rates: Blocks) -> Vectors:
    """$A v$: one vector per contact."""
    return tuple(
        total(
            [
                column * rate
                for columns, block in zip(pair, (rates[1 + c.finger], rates[0]), strict=True)
                for column, rate in zip(columns, block, strict=True)
            ]
        )
        for c, pair in zip(grasp.contacts, line.jacobian, strict=True)
    )


def balance(line: Linearisation, wanted: Sequence[Vec2]) -> Vectors:
    """Contact forces (impulses) on the fingertips that make $A M^{-1} A^T$ times them `wanted`."""
    flat = solve(line.schur, [component for vector in wanted for component in vector])
    return tuple(Vec2(flat[2 * i], flat[2 * i + 1]) for i in range(len(wanted)))


def respond(grasp: Grasp, line: Linearisation, forces: Sequence[Vec2]) -> Blocks:
    """$M^{-1} A^T$ times contact forces: what each coordinate gains."""
    object_terms = []
    finger_terms: dict[int, list[tuple[Scalar, ...]]] = {}
    for contact, pair, force in zip(grasp.contacts, line.weighted, forces, strict=True):
        tip, body = (tuple(x * force.x + y * force.y for x, y in zip(*rows, strict=True)) for rows in pair)
        finger_terms.setdefault(contact.finger, []).append(tip)
        object_terms.append(body)
    gains = [_sum_blocks(object_terms)]
    for i, size in enumerate(grasp.sizes[1:]):
        gains.append(_sum_blocks(finger_terms[i]) if i in finger_terms else (0.0,) * size)
    return tuple(gains)


def _sum_blocks(terms: list[tuple[Scalar, ...]]) -> Scalars:
    return tuple(total(column) for column in zip(*terms, strict=True))


def combine(left: Blocks, right: Blocks, factor: float = 1.0) -> Blocks:
    """`left + factor * right`, block by block."""
    return tuple(
        tuple(a + b if factor == 1.0 else a + factor * b for a, b in zip(x, y, strict=True))
        for x, y in zip(left, right, strict=True)
    )


def bodies(grasp: Grasp, leaves: Leaves) -> tuple[tuple[Motion, ...], tuple[Inertia, ...]]:
    """Kinematics and inertia of the object and of every finger."""
    field = grasp.field()
    pairs = [grasp.object.motion(leaves.q[0], leaves.v[0], field)]
    for finger, q, v in zip(grasp.fingers, leaves.q[1:], leaves.v[1:], strict=True):
        pairs.append(finger.motion(q, v, field))
    return tuple(m for m, _ in pairs), tuple(i for _, i in pairs)
