"""A check of the task errors of `control.Integral` that needs a state: can each of them move at all?

Contacts leave some directions of motion free, the null space N of $A$. With E the derivatives of the errors,
$E N$ tells how far these directions move them. If a singular value of $E N$ is zero, the contacts hold some
mixture of errors fast: its integral would grow for ever, and with it forces between the fingers.
`simulate` and `vector_field` ask before a run whose controller has a memory.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import factorise
from .._mechanics import compiled, Grasp, State, to_leaves
from .._results import computed_at_once, traced
from ..control import Integral, laws_of
from ._equations import bodies, sensed, touches
from ._linearisation import linearise

# Least singular value of E N, of rows of length one, at which errors count as free to move.
_FREE = 1e-5


def check_tasks(grasp: Grasp, state: State) -> None:
    """Raise where contacts hold fast a task error whose integral is fed back."""
    names = [name for law in _integrals_of(grasp) for name in law.errors]
    if not names or traced((grasp, state)):
        return
    with computed_at_once():
        moved = np.asarray(_moved(grasp, state))
    mixture, sizes, _ = np.linalg.svd(moved)
    if sizes.size != len(names) or not sizes[-1] > _FREE:
        held = names[int(np.argmax(np.abs(mixture[:, -1])))]
        raise ValueError(
            f"argument state must leave the errors of control.Integral free to move, but its contacts hold "
            f"{held!r} fast, or a mixture of it with others"
        )


def _integrals_of(grasp: Grasp) -> list[Integral]:
    """The integral terms among a grasp's controllers, the outer one first."""
    return [law for law in laws_of(grasp.controller) if isinstance(law, Integral)]


@compiled
def _moved(grasp: Grasp, state: State) -> Array:
    """E N, with the rows of E of length one and the columns of N orthonormal."""
    ready = grasp.prepared()
    leaves = to_leaves(state, ready.form)
    motions, inertias = bodies(ready, leaves)
    line = linearise(ready, motions, [factorise(i.mass) for i in inertias], touches(ready, leaves.s))
    starts = np.concatenate([[0], np.cumsum(ready.sizes)])
    a = []
    for contact, (tip, body) in zip(ready.contacts, line.jacobian, strict=True):
        row = jnp.zeros((contact.rows, ready.coordinates))
        row = row.at[:, : starts[1]].set(jnp.array(body))
        at = starts[1 + contact.finger]
        a.append(row.at[:, at : at + ready.sizes[1 + contact.finger]].set(jnp.array(tip)))
    jacobian = jnp.concatenate(a)
    free = jnp.linalg.svd(jacobian)[2][jacobian.shape[0] :].T
    zero = (0.0,) * ready.sizes[0]
    seen = sensed(ready, leaves, motions)
    measured = [each for law in _integrals_of(ready) for each in law.measured(seen)]
    errors = jnp.array([[*zero, *(x for block in slope for x in block)] for _, slope in measured])
    return (errors / jnp.linalg.norm(errors, axis=1, keepdims=True)) @ free
