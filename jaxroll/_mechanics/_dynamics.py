r"""Constrained forward dynamics: (1)-(3) and (73)-(74) with the constraints differentiated twice.

$M \dot v + h = F + A^T \mu$ and $A \dot v = -\mathrm{bias}$, solved by the Schur complement
$A M^{-1} A^T$. The multiplier $\mu$ of a contact is the force on its fingertip in world axes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax

from .._linalg import factorise, solve, total
from .._types import Scalar, Scalars
from .._xla import once
from ..contact import Motion, Rows
from ._body import Inertia
from ._constraints import (
    add,
    apply_jacobian,
    balance,
    bodies,
    combine,
    Linearisation,
    linearise,
    negative,
    respond,
    touches,
)
from ._controller import Torques
from ._grasp import Grasp
from ._state import Blocks, Leaves

Stabiliser = Callable[[Sequence[Motion], Sequence[Any], Rows], Rows]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Instant:
    """All that one evaluation of the equations of motion works out.

    Attributes:
        rates: Time derivative of the state.
        forces: Contact force on the fingertip of each contact [N], by constraint rows: in world axes, then
            what of a torque there is.
        motions: Kinematics of the object and of every fingertip.
        touching: Contact frames.
        line: Constraint Jacobian and factorised Schur complement.
    """

    rates: Leaves
    forces: Rows
    motions: tuple[Motion, ...]
    touching: tuple[Any, ...]
    line: Linearisation


def accelerate(
    grasp: Grasp,
    leaves: Leaves,
    torques: Callable[[Sequence[Motion]], Torques],
    stabiliser: Stabiliser | None = None,
) -> Instant:
    """Evaluate the equations of motion; `stabiliser` adds the chapter's CSM terms."""
    motions, inertias = bodies(grasp, leaves)
    touching = touches(grasp, leaves.s)
    masses = [factorise(inertia.mass) for inertia in inertias]
    line = linearise(grasp, motions, masses, touching)
    drives = (None, *torques(motions))
    free = tuple(
        solve(mass, net_force(inertia, drive))
        for mass, inertia, drive in zip(masses, inertias, drives, strict=True)
    )
    pairs = [(motions[1 + c.finger], motions[0]) for c in grasp.contacts]
    each = list(zip(grasp.contacts, pairs, touching, strict=True))
    rollings = once(tuple(c.rolling(pair, t) for c, pair, t in each))
    biases = [c.bias(pair, t, r) for (c, pair, t), r in zip(each, rollings, strict=True)]
    wanted = tuple(add(*both) for both in zip(apply_jacobian(grasp, line, free), biases, strict=True))
    if stabiliser is not None:
        extra = stabiliser(motions, touching, apply_jacobian(grasp, line, leaves.v))
        wanted = tuple(add(*both) for both in zip(wanted, extra, strict=True))
    forces = once(balance(line, once(negative(wanted))))
    gained = once(combine(free, respond(grasp, line, forces)))
    places = zip(grasp.contacts, leaves.s, pairs, rollings, strict=True)
    s_rates = tuple(
        c.place_rate(grasp.shapes(c), place, (tip.pose, body.pose), rolling)
        for c, place, (tip, body), rolling in places
    )
    moving = zip(grasp.bodies, leaves.q, leaves.v, strict=True)
    rates = Leaves(tuple(body.rates(q, v) for body, q, v in moving), gained, s_rates)
    return Instant(rates, forces, motions, touching, line)


def net_force(inertia: Inertia, drive: Scalars | None) -> Scalars:
    """Generalised force of one body's coordinates: its drive less its bias force."""
    if drive is None:
        return tuple(-h for h in inertia.force)
    return tuple(u - h for u, h in zip(drive, inertia.force, strict=True))


def kinetic_energy(inertias: Sequence[Inertia], rates: Blocks) -> Scalar:
    r"""$\frac12 v^T M v$: (13), (71)."""
    return total([_quadratic(i.mass, v) for i, v in zip(inertias, rates, strict=True)])


def _quadratic(mass: Sequence[Sequence[Scalar]], v: Scalars) -> Scalar:
    terms = []
    for i, row in enumerate(mass):
        terms += [row[j] * v[i] * v[j] for j in range(i)]
        terms.append(0.5 * row[i] * v[i] * v[i])
    return total(terms)
