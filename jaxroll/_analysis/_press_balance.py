r"""The chapter's Part 2 quantities: what tends to zero when a pressed object comes to rest.

At rest under `control.Press` the contact force balances the pull of the spring between the tip frame and its
target; $\Delta f$ and $\Delta\lambda$ of (78) are what is left over, and $(f_d/r) N_1$ is the moment of that
pull about the contact. `_contact_geometry` has the lengths, `multipliers_at` the forces.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._mechanics import check_planar, compiled, Grasp, State
from .._motion import as_times, Index1, multipliers_at, over_time
from .._printing import listed
from .._types import Scalar
from ..control import law_of, Press
from ._contact_geometry import geometry_at


class PressBalance(eqx.Module):
    r"""Quantities (60)-(63), (76)-(79) of every contact, under `control.Press`.

    Attributes:
        s: Chapter's s [m]: arclength of the contact on the object, in the direction of $b_1$.
        delta_f: $\Delta f = f + (f_d/r) Q_1$ [N], (78).
        delta_lam: $\Delta\lambda = \lambda + (f_d/r) R_1$ [N], (78).
        n1: $N_1 = l_{b0} Q_1 - l_{n0} R_1$ [m^2], (78): zero when the line from the tip frame to the target
            passes through the contact.
        moment: $(f_d/r) N_1$ [N m], the moment of Fig. 11, which drives the $q_i$ of (77), and $\theta$ of
            (76) where the target is the object's origin. It stands on the left of both: what it drives turns
            against it. It counts clockwise where $n_1$ lies clockwise of $b_1$, as in the chapter's figures,
            and counter-clockwise in their mirror image, which `scenes.pivoted` is.
        potential: $U = \frac{f_d}{2r}(Q_1^2 + R_1^2)$ [J] (Fig. 18).

    $Q_1$ and $R_1$ are the parts along $n_1$ and $b_1$ of the vector from the target to the tip frame. The
    chapter's target is the object's origin: then they are (79), $Q_1 = -(l_{n0} + l_{n1})$ and
    $R_1 = -(l_{b0} + l_{b1})$, printed there with the other sign, and
    $N_1 = l_{n0} l_{b1} - l_{b0} l_{n1}$, the last form of (78).
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

    Args:
        grasp: A grasp in the plane under `control.Press`.
        ts: Time [s], or one per state: a number of the controller may change in time.
        states: One state, or states with a leading time axis.

    Returns:
        `PressBalance`, of the states' leading shape.

    Raises:
        ValueError: If the grasp's controller is not `control.Press`, by itself or inside another one.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=3.0)
        >>> balance = jxr.press_balance(grasp, run.ts, run.states)
        >>> bool(abs(balance.n1[-1, 0]) < 1e-3 * abs(balance.n1[0, 0]))
        True
    """
    check_planar(grasp)
    if not isinstance(law_of(grasp.controller), Press):
        raise ValueError(
            f"argument grasp must be driven by control.Press, but was by {type(grasp.controller).__name__}"
        )
    ready, ts = grasp.prepared(), as_times(ts, states)
    return over_time(lambda state, t: _balance_at(ready, t, state), states, ts)


def _balance_at(grasp: Grasp, t: Scalar, state: State) -> PressBalance:
    """The quantities of a prepared grasp at one time [s] and state."""
    at, forces = geometry_at(grasp, state), multipliers_at(grasp, t, state, Index1())
    control = law_of(grasp.controller).at(t)
    stiffness = control.stiffness
    arm = at.centre_0 - control.target[None]
    # At a closed contact, where Q and R of (64)-(65) vanish, these are (79) if the target is the object's
    # origin, as in the chapter. About any target they are parts of the vector along which (75) pulls.
    q1, r1 = jnp.sum(arm * at.n_1, axis=-1), jnp.sum(arm * at.b_1, axis=-1)
    # The first form of (78): the last form has (79) in it, which holds for the object's origin alone.
    n1 = at.l_b0 * q1 - at.l_n0 * r1
    return PressBalance(
        s=at.s,
        delta_f=forces.f + stiffness * q1,
        delta_lam=forces.lam + stiffness * r1,
        n1=n1,
        moment=stiffness * n1,
        potential=0.5 * stiffness * (q1 * q1 + r1 * r1),
    )
