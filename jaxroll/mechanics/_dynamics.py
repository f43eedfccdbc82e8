r"""Constrained forward dynamics: (1)-(3) and (73)-(74) with the constraints differentiated twice.

$M \dot v + h = F + A^T \mu$ and $A \dot v = -\mathrm{bias}$, solved by the Schur complement
$A M^{-1} A^T$. The multiplier $\mu$ of a contact is the force on its fingertip in world axes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax

from .._algebra import factorise, once, Pose2, solve, total, Vec2
from .._types import Scalar, Scalars
from ..contact import Contact, gap_bias, rolling_rate, Touch
from ..geometry import Frenet2
from ._body import Inertia, Motion
from ._constraints import (
    apply_jacobian,
    balance,
    bodies,
    combine,
    Linearisation,
    linearise,
    respond,
    touches,
)
from ._grasp import Grasp
from ._state import Blocks, Leaves

Torques = tuple[Scalars, ...]
Stabiliser = Callable[[Sequence[Motion], Sequence[Touch], tuple[Vec2, ...]], tuple[Vec2, ...]]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Instant:
    """All that one evaluation of the equations of motion works out.

    Attributes:
        rates: Time derivative of the state.
        forces: Contact force on the fingertip of each contact, in world axes [N].
        motions: Kinematics of the object and of every fingertip.
        touching: Contact frames.
        line: Constraint Jacobian and factorised Schur complement.
    """

    rates: Leaves
    forces: tuple[Vec2, ...]
    motions: tuple[Motion, ...]
    touching: tuple[Touch, ...]
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
    sigma_rates = tuple(
        rolling_rate(t, motions[1 + c.finger].twist.spin, motions[0].twist.spin)
        for c, t in zip(grasp.contacts, touching, strict=True)
    )
    wanted = tuple(
        -(a + _bias(motions[1 + c.finger], motions[0], t, rate))
        for c, t, rate, a in zip(
            grasp.contacts, touching, sigma_rates, apply_jacobian(grasp, line, free), strict=True
        )
    )
    if stabiliser is not None:
        closing = apply_jacobian(grasp, line, leaves.v)
        extra = stabiliser(motions, touching, closing)
        wanted = tuple(w - e for w, e in zip(wanted, extra, strict=True))
    forces = once(balance(line, once(wanted)))
    rates = Leaves(leaves.v, once(combine(free, respond(grasp, line, forces))), sigma_rates)
    return Instant(rates, forces, motions, touching, line)


def normal_and_tangential(contact: Contact, body: Pose2, face: Frenet2, force: Vec2) -> tuple[Scalar, Scalar]:
    r"""Multipliers $f$ (positive when pressing) and $\lambda$ [N] of the force on one fingertip."""
    tangent = body.turn(face.tangent)
    return force.dot(tangent.right()), -contact.sense * force.dot(tangent)


def net_force(inertia: Inertia, drive: Scalars | None) -> Scalars:
    """Generalised force of one body's coordinates: its drive less its bias force."""
    if drive is None:
        return tuple(-h for h in inertia.force)
    return tuple(u - h for u, h in zip(drive, inertia.force, strict=True))


def _bias(tip: Motion, body: Motion, touching: Touch, sigma_rate: Scalar) -> Vec2:
    return gap_bias(
        (tip.pose, body.pose),
        (tip.twist, body.twist),
        (tip.bias, body.bias),
        touch=touching,
        sigma_rate=sigma_rate,
    )


def kinetic_energy(inertias: Sequence[Inertia], rates: Blocks) -> Scalar:
    r"""$\frac12 v^T M v$: (13), (71)."""
    return total([_quadratic(i.mass, v) for i, v in zip(inertias, rates, strict=True)])


def _quadratic(mass: Sequence[Sequence[Scalar]], v: Scalars) -> Scalar:
    terms = []
    for i, row in enumerate(mass):
        terms += [row[j] * v[i] * v[j] for j in range(i)]
        terms.append(0.5 * row[i] * v[i] * v[i])
    return total(terms)
