r"""The rolling constraints of a grasp linearised: $A$, $M^{-1} A^T$, and one factorisation of $A M^{-1} A^T$.

Accelerations and the returns to positions and to velocities are all solved with the Schur complement
$A M^{-1} A^T$: `_equations` and `_projection` share the `Linearisation` built here. Its rows are tuples of
scalars, so that the same lines serve the plane and space.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax

from .._linalg import (
    Factor,
    factorise,
    factorise_in_loop,
    inner,
    LoopFactor,
    plus,
    scalars,
    solve,
    solve_in_loop,
    stacked,
    times,
    total,
)
from .._mechanics import Blocks, Grasp
from .._types import Scalar, Scalars
from ..contact import Motion, Rows
from ._schur_array import Pair, schur_array

# Most rows whose factorisation is written out number by number, which runs faster (`_linalg._loop_factor`):
# those of `scenes.ring(16)`, which takes half a minute to compile.
WRITTEN_OUT = 32


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Linearisation:
    r"""Constraint Jacobian $A$, $M^{-1}A^T$ and the factorised Schur complement $A M^{-1} A^T$.

    Attributes:
        jacobian: For each contact its rows of $A$: the block over the finger's velocities, then the one over
            the object's. All other blocks of these rows are zero.
        weighted: The rows of $A M^{-1}$, in the same blocks.
        schur: The Schur complement, factorised: number by number, or in a loop where its rows are many.
        drift: For each contact the rate at which a prescribed motion of its fingertip changes its gap, row by
            row [m/s]; None for a contact whose finger has no prescribed motion.
    """

    jacobian: tuple[Pair, ...]
    weighted: tuple[Pair, ...]
    schur: Factor | LoopFactor
    drift: tuple[Scalars | None, ...]


def linearise(
    grasp: Grasp,
    motions: Sequence[Motion],
    masses: Sequence[Factor],
    touching: Sequence[Any],
) -> Linearisation:
    """The linearised constraints at one state, from motion and factorised mass matrix of every body."""
    jacobian, weighted, drift = [], [], []
    for contact, t in zip(grasp.contacts, touching, strict=True):
        pair = motions[1 + contact.finger], motions[0]
        rows = contact.pfaffian(pair, t)
        jacobian.append(rows)
        # The mass matrix is one block per body, so that a row is weighted block by block.
        factors = masses[1 + contact.finger], masses[0]
        weighted.append(tuple(_solve(factor, block) for factor, block in zip(factors, rows, strict=True)))
        # A moving stage has a twist but no velocities: what it does to the gap is missing in A v. Here the
        # object is at rest, so that this part alone is left; with joints, J v would come in twice (`Grasp`
        # refuses that).
        moving = grasp.fingers[contact.finger].prescribed
        poses, twists = (pair[0].pose, pair[1].pose), (pair[0].twist, pair[1].resting().twist)
        drift.append(contact.gap_rate(poses, twists, t) if moving else None)
    schur = _schur_factor(grasp, jacobian, weighted)
    return Linearisation(tuple(jacobian), tuple(weighted), schur, tuple(drift))


def _schur_factor(grasp: Grasp, jacobian: Sequence[Pair], weighted: Sequence[Pair]) -> Factor | LoopFactor:
    """$A M^{-1} A^T$, factorised number by number, or in a loop where its rows are many."""
    if sum(contact.rows for contact in grasp.contacts) > WRITTEN_OUT:
        return factorise_in_loop(schur_array(grasp, jacobian, weighted))
    # Lower triangle of A M^-1 A^T: each entry is a row of A times a row of A M^-1. Two contacts always share
    # the object's block (1), and the finger's (0) only if both are on the same finger.
    rows = []
    for i, contact in enumerate(grasp.contacts):
        for axis in range(contact.rows):
            row = []
            for j, other in enumerate(grasp.contacts[: i + 1]):
                blocks = (0, 1) if contact.finger == other.finger else (1,)
                row += [
                    functools.reduce(plus, [inner(jacobian[i][b][axis], weighted[j][b][k]) for b in blocks])
                    for k in range(other.rows if j < i else axis + 1)
                ]
            rows.append(tuple(row))
    return factorise(rows)


def _solve(mass: Factor, rows: Rows) -> Rows:
    """Rows of $A M^{-1}$ of one body; $M$ is symmetric, so that each is $M^{-1}$ times a row of $A$."""
    return tuple(solve(mass, row) for row in rows)


def apply_jacobian(grasp: Grasp, line: Linearisation, rates: Blocks) -> Rows:
    """$A v$, one tuple per contact, of velocities (or accelerations) given body by body."""
    found = []
    for c, pair in zip(grasp.contacts, line.jacobian, strict=True):
        tip, body = rates[1 + c.finger], rates[0]
        found.append(tuple(inner((*a, *b), (*tip, *body)) for a, b in zip(*pair, strict=True)))
    return tuple(found)


def closing(grasp: Grasp, line: Linearisation, v: Blocks) -> Rows:
    """Rate of every gap [m/s], row by row: $A v$, plus what prescribed motions add."""
    found = zip(apply_jacobian(grasp, line, v), line.drift, strict=True)
    return tuple(own if given is None else add(own, given) for own, given in found)


def add(left: Scalars, right: Scalars) -> Scalars:
    """Sum, number by number."""
    return tuple(map(plus, left, right))


def balance(line: Linearisation, wanted: Rows) -> Rows:
    r"""Solve $A M^{-1} A^T \mu = w$ for forces or impulses $\mu$, contact by contact; $w$ is `wanted`."""
    right, found = [component for rows in wanted for component in rows], []
    if isinstance(line.schur, LoopFactor):
        flat = scalars(solve_in_loop(line.schur, stacked(right).astype(line.schur.matrix.dtype)))
    else:
        flat = list(solve(line.schur, right))
    for rows in wanted:
        found.append(tuple(flat[: len(rows)]))
        flat = flat[len(rows) :]
    return tuple(found)


def respond(grasp: Grasp, line: Linearisation, forces: Rows) -> Blocks:
    r"""$M^{-1} A^T \mu$, body by body: accelerations from forces, or velocity changes from impulses."""
    object_terms = []
    finger_terms: dict[int, list[Scalars]] = {}
    for contact, pair, force in zip(grasp.contacts, line.weighted, forces, strict=True):
        # Columns of A M^-1 are rows of M^-1 A^T.
        tip, body = (tuple(inner(column, force) for column in zip(*rows, strict=True)) for rows in pair)
        finger_terms.setdefault(contact.finger, []).append(tip)
        object_terms.append(body)
    gains = [_sum_blocks(object_terms)]
    for i, size in enumerate(grasp.sizes[1:]):
        gains.append(_sum_blocks(finger_terms[i]) if i in finger_terms else (0.0,) * size)
    return tuple(gains)


def _sum_blocks(terms: list[Scalars]) -> Scalars:
    """Sum of one body's gains over its contacts."""
    return tuple(total(list(each)) for each in zip(*terms, strict=True))


def combine(left: Blocks, right: Blocks, factor: Scalar | float = 1.0) -> Blocks:
    """`left + factor * right`, block by block."""
    return tuple(
        tuple(plus(a, times(factor, b)) for a, b in zip(x, y, strict=True))
        for x, y in zip(left, right, strict=True)
    )


def negative(blocks: Blocks) -> Blocks:
    """Blocks, or rows, with their sign changed."""
    return tuple(tuple(-x for x in block) for block in blocks)
