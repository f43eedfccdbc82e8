"""A check of the task errors of `control.Integral` that needs a state: can each of them move at all?

Contacts leave some directions of motion free, the null space N of $A$. With E the derivatives of the errors,
$E N$ tells how far these directions move them. Where a singular value of it is zero, some mixture of errors
is held fast by the contacts: its integral would grow for ever, and with it forces between the fingers.
`simulate` and `vector_field` ask before a run.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import factorise
from .._mechanics import compiled, Grasp, State, to_leaves
from .._results import traced
from ..control import Integral
from ._equations import bodies, sensed, touches
from ._linearisation import linearise

# Least singular value of E N, of rows of length one, at which errors count as free to move.
_FREE = 1e-5


def check_tasks(grasp: Grasp, state: State) -> None:
    """Raise where contacts hold fast a task error whose integral is fed back."""
    law = _integral_of(grasp)
    if law is None or traced((grasp, state)):
        return
    moved = np.asarray(_moved(grasp, state))
    mixture, sizes, _ = np.linalg.svd(moved)
    if sizes.size != len(law.errors) or not sizes[-1] > _FREE:
        held = law.errors[int(np.argmax(np.abs(mixture[:, -1])))]
        raise ValueError(
            f"argument state must leave the errors of control.Integral free to move, but its contacts hold "
            f"{held!r} fast, or a mixture of it with others"
        )


def _integral_of(grasp: Grasp) -> Integral | None:
    """The integral term among a grasp's controllers; of several the outer one."""
    controller = grasp.controller
    while controller is not None and not isinstance(controller, Integral):
        controller = getattr(controller, "law", None)
    return controller


@compiled
def _moved(grasp: Grasp, state: State) -> Array:
    """E N, with the rows of E of length one and the columns of N orthonormal."""
    ready = grasp.prepared()
    law, leaves = _integral_of(ready), to_leaves(state, ready.form)
    assert law is not None
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
    measured = law.measured(sensed(ready, leaves, motions))
    errors = jnp.array([[*zero, *(x for block in slope for x in block)] for _, slope in measured])
    return (errors / jnp.linalg.norm(errors, axis=1, keepdims=True)) @ free
