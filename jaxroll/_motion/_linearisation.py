r"""The rolling constraints of a grasp linearised: $A$, $M^{-1} A^T$, and one factorisation of $A M^{-1} A^T$.

The Schur complement that the accelerations need is the one that the return to positions and to velocities
needs: `_equations` and `_projection` share the `Linearisation` built here. It holds rows of scalars, and so
does not know whether they are those of the plane or of space.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from .._linalg import Factor, factorise, inner, plus, solve, times, total
from .._mechanics import Blocks, Grasp
from .._types import Scalars
from ..contact import Motion, Rows

Pair = tuple[Rows, Rows]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Linearisation:
    r"""Constraint Jacobian $A$, $M^{-1}A^T$ and the factorised Schur complement $A M^{-1} A^T$.

    Attributes:
        jacobian: For each contact: its rows over the finger's and over the object's coordinates.
        weighted: The same rows solved with the mass matrices: those of $A M^{-1}$.
        schur: Factor of the Schur complement.
        drift: For each contact the rates of its gap that are prescribed; none where nothing is.
    """

    jacobian: tuple[Pair, ...]
    weighted: tuple[Pair, ...]
    schur: Factor
    drift: tuple[Scalars | None, ...]


def linearise(
    grasp: Grasp,
    motions: Sequence[Motion],
    masses: Sequence[Factor],
    touching: Sequence[Any],
) -> Linearisation:
    """Rows of every contact from the twists of its two bodies, and the factorised Schur complement."""
    jacobian, weighted, drift = [], [], []
    for contact, t in zip(grasp.contacts, touching, strict=True):
        pair = motions[1 + contact.finger], motions[0]
        rows = contact.pfaffian(pair, t)
        jacobian.append(rows)
        # The mass matrix is one block per body, so that a row is weighted block by block.
        factors = masses[1 + contact.finger], masses[0]
        weighted.append(tuple(_solve(factor, block) for factor, block in zip(factors, rows, strict=True)))
        # A jaw, or a stage, moves as prescribed: what its motion alone does to the gap is no part of A v.
        moving = grasp.fingers[contact.finger].prescribed
        drift.append(contact.closing((pair[0], pair[1].resting()), t) if moving else None)
    # Lower triangle of A M^-1 A^T. Two contacts have the object in common, and the finger if it is the same.
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
    return Linearisation(tuple(jacobian), tuple(weighted), factorise(rows), tuple(drift))


def unknown_line(grasp: Grasp) -> Linearisation:
    """A linearisation full of zeros, as the state of a loop that will fill it."""
    zero = jnp.zeros(())
    pairs, drift = [], []
    for c in grasp.contacts:
        pairs.append(tuple(((zero,) * k,) * c.rows for k in (grasp.sizes[1 + c.finger], grasp.sizes[0])))
        drift.append((zero,) * c.rows if grasp.fingers[c.finger].prescribed else None)
    m = sum(c.rows for c in grasp.contacts)
    schur = Factor(tuple((zero,) * i for i in range(m)), (zero,) * m, zero)
    return Linearisation(tuple(pairs), tuple(pairs), schur, tuple(drift))


def _solve(mass: Factor, rows: Rows) -> Rows:
    return tuple(solve(mass, row) for row in rows)


def apply_jacobian(grasp: Grasp, line: Linearisation, rates: Blocks) -> Rows:
    """$A v$: one tuple per contact."""
    found = []
    for c, pair in zip(grasp.contacts, line.jacobian, strict=True):
        tip, body = rates[1 + c.finger], rates[0]
        found.append(tuple(inner((*a, *b), (*tip, *body)) for a, b in zip(*pair, strict=True)))
    return tuple(found)


def closing(grasp: Grasp, line: Linearisation, v: Blocks) -> Rows:
    """Rates of the rows' gaps: $A v$ and what is prescribed."""
    found = zip(apply_jacobian(grasp, line, v), line.drift, strict=True)
    return tuple(own if given is None else add(own, given) for own, given in found)


def add(left: Scalars, right: Scalars) -> Scalars:
    """Sum, number by number."""
    return tuple(map(plus, left, right))


def balance(line: Linearisation, wanted: Rows) -> Rows:
    """Contact forces (impulses) on the fingertips that make $A M^{-1} A^T$ times them `wanted`."""
    flat, found = list(solve(line.schur, [component for rows in wanted for component in rows])), []
    for rows in wanted:
        found.append(tuple(flat[: len(rows)]))
        flat = flat[len(rows) :]
    return tuple(found)


def respond(grasp: Grasp, line: Linearisation, forces: Rows) -> Blocks:
    """$M^{-1} A^T$ times contact forces: what each velocity gains."""
    object_terms = []
    finger_terms: dict[int, list[Scalars]] = {}
    for contact, pair, force in zip(grasp.contacts, line.weighted, forces, strict=True):
        tip, body = (tuple(inner(column, force) for column in zip(*rows, strict=True)) for rows in pair)
        finger_terms.setdefault(contact.finger, []).append(tip)
        object_terms.append(body)
    gains = [_sum_blocks(object_terms)]
    for i, size in enumerate(grasp.sizes[1:]):
        gains.append(_sum_blocks(finger_terms[i]) if i in finger_terms else (0.0,) * size)
    return tuple(gains)


def _sum_blocks(terms: list[Scalars]) -> Scalars:
    return tuple(total(list(each)) for each in zip(*terms, strict=True))


def combine(left: Blocks, right: Blocks, factor: float = 1.0) -> Blocks:
    """`left + factor * right`, block by block."""
    return tuple(
        tuple(plus(a, times(factor, b)) for a, b in zip(x, y, strict=True))
        for x, y in zip(left, right, strict=True)
    )


def negative(blocks: Blocks) -> Blocks:
    """Blocks, or rows, with the other sign."""
    return tuple(tuple(-x for x in block) for block in blocks)
