r"""The chapter's Part 1 quantities: how far a pinch is from balance, and the wrenches that drive it.

At rest the contact forces of a balanced pinch are $f_i = -\beta l_i$ and $\lambda_i = (-1)^i \beta d_i$; the
chapter rewrites the equations of motion in the differences from these, (42)-(49). They tend to zero as the
grasp settles. `_contact_geometry` has the lengths, `multipliers_at` the forces; `plotting` and `jaxroll demo`
show the result, and `stability` borrows `check_pinch`.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._mechanics import check_planar, compiled, Grasp, State
from .._motion import as_times, Index1, multipliers_at, over_time
from .._printing import listed
from .._types import Scalar
from ..control import law_of, Opposition, orientations
from ._contact_geometry import geometry_at


class PinchBalance(eqx.Module):
    r"""Quantities (25)-(29), (42)-(49) and (51)-(55) of a pinch, per finger i = 1, 2.

    Attributes:
        s: Chapter's $s_i$ [m]: arclength of the contact on the object, in the direction of $b_{0i}$.
        d: $(r_1 - r_2) \cdot b_{0i}$ [m], (28); the same for both on parallel faces.
        l: $-(-1)^i (r_1 - r_2) \cdot n_{0i}$ [m], (29); the same for both on parallel faces.
        delta_f: $\Delta f_i = f_i + \beta l_i$ [N], (42).
        delta_lam: $\Delta\lambda_i = \lambda_i - (-1)^i \beta d_i$ [N], (43).
        n: $N_i = (-1)^i (b_i \cdot \gamma_i) l_i - (n_i \cdot \gamma_i) d_i$ [m^2], (53).
        delta_n: $\Delta N_i = \beta N_i + \alpha_i (p_i - p_i(0))$ [N m], (46).
        s_n: $S_N$ [N m], a moment on the left of (48): its forces turn the object by $-S_N$.
        potential: $U = \frac\beta2 \|r_1 - r_2\|^2$ [J], (27).
        lean: Angle [rad] between $O_i P_i$ and the line through both centres: zero when
            $O_1, P_1, P_2, O_2$ are collinear.

    Angles ($p_i$, `lean`) count counter-clockwise where $b_{01}$ runs along the object's contour and $b_{02}$
    against it (`sense` 1 and -1), clockwise in the mirror image. On contours that are not parallel faces each
    finger has its own d and l, and (44)-(48) and (51)-(55) hold with them; the last form of (49) is that of a
    rectangle.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {
        "s": "m",
        "d": "m",
        "l": "m",
        "delta_f": "N",
        "delta_lam": "N",
        "n": "m^2",
        "delta_n": "N m",
        "s_n": "N m",
        "potential": "J",
        "lean": "rad",
    }

    s: Float[Array, "... 2"]
    d: Float[Array, "... 2"]
    l: Float[Array, "... 2"]  # noqa: E741
    delta_f: Float[Array, "... 2"]
    delta_lam: Float[Array, "... 2"]
    n: Float[Array, "... 2"]
    delta_n: Float[Array, "... 2"]
    s_n: Float[Array, "..."]
    potential: Float[Array, "..."]
    lean: Float[Array, "... 2"]


@compiled
def pinch_balance(grasp: Grasp, ts: Float[Array, "..."], states: State) -> PinchBalance:
    """Part 1's quantities at one time and state, or along a leading time axis.

    Args:
        grasp: The pinch.
        ts: Time [s], or one per state: a number of the controller may change in time.
        states: One state, or states with a leading time axis.

    Returns:
        `PinchBalance`, of the states' leading shape.

    Raises:
        ValueError: If the grasp is not two fingers, one contact each, under `control.Opposition`.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch()
        >>> found = jxr.pinch_balance(grasp, 0.0, state)
        >>> f"l = {1e3 * found.l[0]:.2f} mm"
        'l = -50.30 mm'
    """
    check_pinch(grasp)
    ready, ts = grasp.prepared(), as_times(ts, states)
    return over_time(lambda state, t: _balance_at(ready, t, state), states, ts)


def check_pinch(grasp: Grasp) -> None:
    """Raise unless two fingers, with one contact each, are driven by `control.Opposition`."""
    check_planar(grasp)
    touched = [contact.finger for contact in grasp.contacts]
    if len(grasp.fingers) != 2 or touched != [0, 1] or not isinstance(law_of(grasp.controller), Opposition):
        raise ValueError(
            f"argument grasp must be two fingers with one contact each, in order, under control.Opposition, "
            f"but was {len(grasp.fingers)} with contacts on {touched} under {type(grasp.controller).__name__}"
        )


def _balance_at(grasp: Grasp, t: Scalar, state: State) -> PinchBalance:
    """The quantities of a prepared pinch at one time [s] and state."""
    at, forces = geometry_at(grasp, state), multipliers_at(grasp, t, state, Index1())
    control = law_of(grasp.controller).at(t)
    kept = orientations(grasp, state) - control.start
    odd = jnp.array([-1.0, 1.0], state.q.dtype)  # (-1)^i as the chapter counts
    arm = at.centre_0[0] - at.centre_0[1]  # r_1 - r_2
    d, l_ = at.b_1 @ arm, -odd * (at.n_1 @ arm)
    # (53), where b_i . gamma_i is l_b0 and n_i . gamma_i is -l_n0.
    n = odd * at.l_b0 * l_ + at.l_n0 * d
    # Which way the chapter counts angles: its n_01 is +90 degrees from b_01, its n_02 -90 from b_02.
    way = -odd * jnp.array([contact.sense for contact in grasp.contacts], state.q.dtype)
    return PinchBalance(
        s=at.s,
        d=d,
        l=l_,
        delta_f=forces.f + control.beta * l_,
        delta_lam=forces.lam - odd * control.beta * d,
        n=n,
        delta_n=control.beta * n + control.alpha * way * kept,
        # (49), where b_0i . gamma_0i is -l_b1 and n_0i . gamma_0i is -l_n1.
        s_n=control.beta * jnp.sum(odd * l_ * at.l_b1 + d * at.l_n1),
        potential=0.5 * control.beta * (arm @ arm),
        lean=way * _angle(odd[:, None] * arm[None], at.gamma_0),
    )


def _angle(first: Array, second: Array) -> Array:
    """Angle [rad] from one plane vector to another, counter-clockwise, row by row."""
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return jnp.arctan2(cross, jnp.sum(first * second, axis=-1))
