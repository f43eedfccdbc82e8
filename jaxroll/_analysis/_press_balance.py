"""The chapter's Part 2 quantities: what tends to zero when a pressed object comes to rest."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._linalg import Vec2
from .._mechanics import check_planar, compiled, Grasp, State, to_leaves
from .._motion import as_times, Index1, multipliers_at, touches, world_poses
from .._printing import listed
from .._results import shown
from .._types import Scalar
from ..control import Press


class PressBalance(eqx.Module):
    r"""Quantities (60)-(63), (76)-(79) of every contact, under `control.Press`.

    Attributes:
        s: Chapter's s [m]: arclength of the contact on the object, in the direction of $b_1$.
        delta_f: $\Delta f = f + (f_d/r) Q_1$ [N], (78).
        delta_lam: $\Delta\lambda = \lambda + (f_d/r) R_1$ [N], (78).
        n1: $N_1 = l_{n0} l_{b1} - l_{b0} l_{n1}$ [m^2], (78): zero when the line from the tip frame to the
            target passes through the contact.
        moment: $(f_d/r) N_1$ [N m], the moment of Fig. 11; it drives $\theta$ and the $q_i$ of (76)-(77),
            which run clockwise where $n_1$ lies clockwise of $b_1$: in the chapter's figures, and, in the
            mirror image that `scenes.pivoted` is, counter-clockwise.
        potential: $U = \frac{f_d}{2r}(Q_1^2 + R_1^2)$ [J] (Fig. 18).

    With $R_1 = -(l_{b0} + l_{b1})$; the chapter prints (79) with the other sign.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {
        "s": "m",
        "delta_f": "N",
        "delta_lam": "N",
        "n1": "m^2",
        "moment": "N m",
        "potential": "J",
    }

    s: Float[Array, "... c"]
    delta_f: Float[Array, "... c"]
    delta_lam: Float[Array, "... c"]
    n1: Float[Array, "... c"]
    moment: Float[Array, "... c"]
    potential: Float[Array, "... c"]


@compiled
def press_balance(grasp: Grasp, ts: Float[Array, "..."], states: State) -> PressBalance:
    """Part 2's quantities at one time and state, or along a leading time axis.

    Raises:
        ValueError: If the grasp's controller is not `control.Press`.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=3.0)
        >>> balance = jxr.press_balance(grasp, run.ts, run.states)
        >>> bool(abs(balance.n1[-1, 0]) < 1e-3 * abs(balance.n1[0, 0]))
        True
    """
    check_planar(grasp)
    if not isinstance(grasp.controller, Press):
        raise ValueError(
            f"argument grasp must be driven by control.Press, but was by {shown(grasp.controller)}"
        )
    ready, ts = grasp.prepared(), as_times(ts, states)
    if states.q.ndim == 1:
        return _balance_at(ready, ts, states)
    return jax.vmap(lambda t, state: _balance_at(ready, t, state))(ts, states)


def _balance_at(grasp: Grasp, t: Scalar, state: State) -> PressBalance:
    leaves = to_leaves(state, grasp.form)
    frames, touching = world_poses(grasp, leaves.q), touches(grasp, leaves.s)
    forces = multipliers_at(grasp, t, state, Index1())
    stiffness, target = grasp.controller.stiffness, Vec2(*grasp.controller.target)
    columns = []
    for i, (contact, at) in enumerate(zip(grasp.contacts, touching, strict=True)):
        tip, body = frames[1 + contact.finger], frames[0]
        tangent = body.turn(at.object.tangent)
        # The chapter's b_1 and n_1: the normal points into the object whichever way b_1 runs.
        b, n = tangent * contact.sense, tangent.left()
        on_tip, on_body = tip.turn(at.tip.point), body.turn(at.object.point)
        l_b0, l_b1 = on_tip.dot(b), -on_body.dot(b)
        l_n0, l_n1 = on_tip.dot(n), -on_body.dot(n)
        arm = tip.origin - target
        q1, r1 = arm.dot(n), arm.dot(b)
        n1 = l_n0 * l_b1 - l_b0 * l_n1
        columns.append(
            (
                contact.sense * (contact.s_object - leaves.s[i]),
                forces.f[i] + stiffness * q1,
                forces.lam[i] + stiffness * r1,
                n1,
                stiffness * n1,
                0.5 * stiffness * (q1 * q1 + r1 * r1),
            )
        )
    return PressBalance(*(jnp.stack(column) for column in zip(*columns, strict=True)))
