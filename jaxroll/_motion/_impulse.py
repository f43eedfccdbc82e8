r"""Velocities that change at once: blows on the object, and contacts that close with a speed.

An impulse $p$ acts in no time, and neither positions nor places change. The contacts answer with impulses
$\mu$ that keep every gap from changing, $A v_+ = -b$ with $b$ what prescribed motions add:

$$ M (v_+ - v_-) = p + A^T \mu, \qquad A M^{-1} A^T \mu = -(A (v_- + M^{-1} p) + b). $$

Without $p$ this is an inelastic impact: gaps that close with a speed $A v_- + b$ stop closing. The energy
changes by the work $p \cdot (v_- + v_+)/2$ of the blow, by $\mu \cdot (A v_- + b)/2$, which is lost, and by
the work $-\mu \cdot b$ of bodies that move as prescribed. `_integration` applies `struck` at the times of
`loads.Impulse` (`_jumps`), and makes it public as `strike`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp

from .._linalg import factorise, inner, plus, solve, total
from .._mechanics import Grasp, Leaves, Moving
from .._types import Scalar, Scalars
from .._xla import once
from ..contact import Motion, Rows
from ..loads import Impulse
from ._equations import bodies, object_force, touches
from ._linearisation import (
    apply_jacobian,
    balance,
    closing,
    combine,
    Linearisation,
    linearise,
    negative,
    respond,
)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Struck:
    r"""What an impulse did.

    Attributes:
        leaves: The state after it.
        forces: Impulse $\mu$ of each contact on its fingertip, row by row in world axes [N s].
        motions: Kinematics of the object and of every fingertip before it.
        touching: Contact frames.
        line: Constraint Jacobian and factorised Schur complement.
        momentum: What the impulse of each contact would be if all terms of $A v$ had one sign [N s]: an
            impulse that is small beside it may be rounding alone.
        work: Work of the blow, and of bodies that move as prescribed [J].
    """

    leaves: Leaves
    forces: Rows
    motions: tuple[Motion, ...]
    touching: tuple[Any, ...]
    line: Linearisation
    momentum: Rows
    work: Scalar


def struck(grasp: Grasp, leaves: Leaves, blows: Sequence[tuple[Impulse, Scalar]]) -> Struck:
    """A prepared grasp after one or more blows on its object; the number beside a blow multiplies it."""
    motions, inertias = bodies(grasp, leaves)
    touching = touches(grasp, leaves.s)
    masses = [factorise(inertia.mass) for inertia in inertias]
    line = linearise(grasp, motions, masses, touching)
    push = _pushed(motions[0], blows)
    # The object alone is hit: M^-1 p is zero for the fingers.
    gained = (solve(masses[0], push), *((0.0,) * size for size in grasp.sizes[1:]))
    free = combine(leaves.v, gained)
    forces = once(balance(line, once(negative(closing(grasp, line, free)))))
    after = once(combine(free, respond(grasp, line, forces)))
    mean = tuple(0.5 * plus(a, b) for a, b in zip(leaves.v[0], after[0], strict=True))
    drifts = zip(forces, line.drift, strict=True)
    moved = [inner(force, given) for force, given in drifts if given is not None]
    work = inner(push, mean) - total(moved)
    sizes = replace(line, jacobian=jax.tree.map(jnp.abs, line.jacobian))
    momentum = balance(line, once(apply_jacobian(grasp, sizes, jax.tree.map(jnp.abs, free))))
    ended = Leaves(leaves.q, after, leaves.s, leaves.memory)
    return Struck(ended, forces, motions, touching, line, momentum, work)


def _pushed(motion: Motion, blows: Sequence[tuple[Impulse, Scalar]]) -> Scalars:
    """Generalised impulse $p$ of some blows."""
    # A blow reads nothing but the pose.
    here = Moving(motion.pose, (), motion.twist)
    each = [[times * p for p in object_force(motion, blow.impulse(here))] for blow, times in blows]
    return tuple(total(list(parts)) for parts in zip(*each, strict=True))
