r"""The chapter's contact geometry: frames, angles and the four lengths of Figs. 2, 5 and 6.

At a contact the fingertip (index 0) and the object (index 1) have a common tangent. What the equations of
motion need of either shape are then two lengths, the position of its contact point along that tangent and
across it, and they depend on the arclength alone: (60)-(63). `_press_balance` and `_pinch_balance` are
computed from them. The simulation itself does not use these quantities: it differentiates the gap (see
`contact`).
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._linalg import Pose2, Vec2
from .._mechanics import check_planar, compiled, Grasp, State, to_leaves
from .._motion import over_time, touches, world_poses
from .._printing import listed
from .._types import Scalar
from ..contact import Contact, Touch


class ContactGeometry(eqx.Module):
    r"""Quantities (56)-(70) of every contact: index 0 is the fingertip, 1 the object, as in Part 2.

    Part 1 writes $b_i, n_i, \gamma_i, \kappa_i, O_i$ for what has index 0 here (finger $i$), and
    $b_{0i}, n_{0i}, \gamma_{0i}, \kappa_{0i}, O_m$ for what has index 1. All vectors are in world axes,
    turned there from their bodies' as in (4).

    Attributes:
        s: Chapter's s [m]: arclength of the contact on the object, in the direction of $b_1$.
        point: Contact point $P_1$ [m] in the world, of the object's contour.
        centre_0: $O_{01}$ [m] in the world, the origin of the fingertip's frame.
        centre_1: $O_m$ [m] in the world, the origin of the object's frame.
        gamma_0: $\gamma_0$ [m], from $O_{01}$ to the contact point of the fingertip.
        gamma_1: $\gamma$ [m], from $O_m$ to that of the object.
        b_0: Unit tangent of the fingertip's contour, (58): $d\gamma_0/ds$ at a fixed pose.
        b_1: Unit tangent of the object's contour, (58): $d\gamma/ds$ at a fixed pose.
        n_0: Unit normal into the fingertip, (59).
        n_1: Unit normal into the object, (59).
        psi_0: $\psi_0$ [rad] in $(-\pi, \pi]$, (57): angle from the fingertip's axis $Y_0$ to $b_0$.
        theta_1: $\theta_1$ [rad] in $(-\pi, \pi]$, (56): angle from the object's axis $Y$ to $b_1$.
        l_b0: $l_{b0} = \gamma_0 \cdot b_0$ [m], (60).
        l_b1: $l_{b1} = -\gamma \cdot b_1$ [m], (61).
        l_n0: $l_{n0} = -\gamma_0 \cdot n_0$ [m], (62).
        l_n1: $l_{n1} = -\gamma \cdot n_1$ [m], (63).
        kappa_0: $\kappa_0$ [1/m], (69); positive where the fingertip is convex.
        kappa_1: $\kappa_1$ [1/m], (70); positive where the object is convex.
        misalignment: What (58) leaves over: the angle [rad] from $b_1$ to $b_0$,
            $(p + \psi_0) - (\theta + \theta_1) - \pi/2$ with the angle $p$ of the fingertip's frame. Zero
            where the tangents coincide, $b_0 = b_1$ and $n_0 = -n_1$.
        q: What (66) leaves over: $Q = l_{n0} + l_{n1} - \overline{P_0' P_1'}$ [m], (65).
        r: What (67) leaves over: $R = l_{b0} + l_{b1} - (\overline{O_m P_1'} + \overline{P_0' O_{01}})$ [m],
            (64).

    $P_0'$ and $P_1'$ are the feet of the perpendiculars from $O_{01}$ and $O_m$ on the line through the
    contact along $n_1$ (Fig. 6). The distances of (66)-(67) are those of the frames' origins, with their
    signs: $(O_m - O_{01}) \cdot n_1$ for (66), $(O_m - O_{01}) \cdot b_1$ for (67). So $P_1$ lies $l_{n0}$
    from $P_0'$ and $l_{n1}$ from $P_1'$. In the equations of motion (73)-(74), $l_{b0}$ and $l_{b1}$ are the
    levers of $f$ about the two origins, $l_{n0}$ and $l_{n1}$ those of $\lambda$.

    Where the tangents coincide, `q` and `r` are `normal` and `tangential` of `residuals`. Elsewhere those
    project the gap on $n_1$ and $b_1$ alone, while here the fingertip's lengths are along $b_0$ and $n_0$, as
    (60) and (62) define them.

    **Angles and mirror image.** (56)-(59) hold with angles that count clockwise and a contour that runs
    clockwise round the object. Contours here run counter-clockwise. So a contact with `sense` -1 is the
    chapter's: $\theta$, $p$, $\theta_1$ and $\psi_0$ count clockwise, and the axes of (56)-(63) are $X = x$,
    $Y = y$ on the object and $X_0 = y$, $Y_0 = -x$ on the fingertip, whose own x axis runs along the last
    link. A contact with `sense` 1, as in `scenes.pivoted`, is its mirror image: angles count
    counter-clockwise, and the axes are $X = x$, $Y = -y$, $X_0 = -y$, $Y_0 = -x$. Either way (56)-(70) hold
    as printed, with (69) corrected to $\kappa_0 = -X_0'' Y_0' + X_0' Y_0''$; a grasp and its mirror
    image with the other `sense` have the same angles, lengths, curvatures and residuals.

    **Along the contour.** $d\theta_1/ds = \kappa_1$ and $d\psi_0/ds = -\kappa_0$, of which (68) follows, and

    $$ l_{b0}' = 1 - \kappa_0 l_{n0}, \quad l_{n0}' = \kappa_0 l_{b0}, \qquad
       l_{b1}' = -1 + \kappa_1 l_{n1}, \quad l_{n1}' = -\kappa_1 l_{b1}, $$

    so that rolling by ds changes the distances in (66)-(67) by $(\kappa_0 l_{b0} - \kappa_1 l_{b1})\,ds$ and
    $(\kappa_1 l_{n1} - \kappa_0 l_{n0})\,ds$.
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("s", "point", "centre_0", "centre_1", "gamma_0", "gamma_1"), "m"),
        **dict.fromkeys(("psi_0", "theta_1", "misalignment"), "rad"),
        **dict.fromkeys(("l_b0", "l_b1", "l_n0", "l_n1", "q", "r"), "m"),
        **dict.fromkeys(("kappa_0", "kappa_1"), "1/m"),
    }

    s: Float[Array, "... c"]
    point: Float[Array, "... c 2"]
    centre_0: Float[Array, "... c 2"]
    centre_1: Float[Array, "... c 2"]
    gamma_0: Float[Array, "... c 2"]
    gamma_1: Float[Array, "... c 2"]
    b_0: Float[Array, "... c 2"]
    b_1: Float[Array, "... c 2"]
    n_0: Float[Array, "... c 2"]
    n_1: Float[Array, "... c 2"]
    psi_0: Float[Array, "... c"]
    theta_1: Float[Array, "... c"]
    l_b0: Float[Array, "... c"]
    l_b1: Float[Array, "... c"]
    l_n0: Float[Array, "... c"]
    l_n1: Float[Array, "... c"]
    kappa_0: Float[Array, "... c"]
    kappa_1: Float[Array, "... c"]
    misalignment: Float[Array, "... c"]
    q: Float[Array, "... c"]
    r: Float[Array, "... c"]


@compiled
def contact_geometry(grasp: Grasp, states: State) -> ContactGeometry:
    r"""The chapter's contact geometry (56)-(70) at one state, or along a leading time axis.

    Under any controller; the contacts need not be closed: what they lack is `misalignment`, `q` and `r`.

    Args:
        grasp: A grasp in the plane, of c contacts.
        states: One state, or states with a leading time axis; their `q` in radians and metres.

    Returns:
        A `ContactGeometry`, whose docstring has the definitions: shapes (c,) and (c, 2), with the axis of
        time in front. Of a time that a run did not reach everything is NaN.

    Raises:
        ValueError: If the grasp lives in space, or the states do not fit it.

    Accuracy: closed form in the contours' frames; exact to rounding.

    Example:
        >>> import jaxroll as jxr
        >>> found = jxr.contact_geometry(*jxr.scenes.pivoted())
        >>> f"l_b0 = {1e3 * found.l_b0[0]:.3f} mm, l_n0 = {1e3 * found.l_n0[0]:.3f} mm"
        'l_b0 = 1.801 mm, l_n0 = 10.107 mm'
    """
    check_planar(grasp)
    ready = grasp.prepared()
    return over_time(lambda state: geometry_at(ready, state), states)


def geometry_at(grasp: Grasp, state: State) -> ContactGeometry:
    """Contact geometry of a prepared grasp at one state."""
    leaves = to_leaves(state, grasp.form)
    body, *tips = world_poses(grasp, leaves.q)
    # One contact after the other, then stacked field by field: their contours may be of different kinds.
    each = zip(grasp.contacts, leaves.s, touches(grasp, leaves.s), strict=True)
    columns = [_at_contact(contact, place, (tips[contact.finger], body), at) for contact, place, at in each]
    return jax.tree.map(lambda *column: jnp.stack(column), *columns)


def _at_contact(contact: Contact, place: Scalar, poses: tuple[Pose2, Pose2], at: Touch) -> ContactGeometry:
    """Geometry of one contact, without the axis of contacts.

    Args:
        contact: The contact.
        place: Its coordinate: the arclength rolled since the start [m].
        poses: Of the fingertip and of the object, in the world.
        at: Both contours' frames at the contact, each in its own body.
    """
    (tip, body), sense = poses, contact.sense
    # Both contours run counter-clockwise, so their tangents oppose each other at the contact.
    own_0, own_1 = at.tip.tangent * -sense, at.object.tangent * sense
    b_0, b_1 = tip.turn(own_0), body.turn(own_1)
    # Left of a contour lies its body, whichever way the chapter's tangent runs.
    n_0, n_1 = b_0.left() * -sense, b_1.left() * sense
    gamma_0, gamma_1 = tip.turn(at.tip.point), body.turn(at.object.point)
    l_b0, l_b1 = gamma_0.dot(b_0), -gamma_1.dot(b_1)
    l_n0, l_n1 = -gamma_0.dot(n_0), -gamma_1.dot(n_1)
    apart = body.origin - tip.origin
    # The contact moves by `place` forwards on the fingertip's contour, and so backwards on the object's.
    return ContactGeometry(
        s=jnp.asarray(sense * (contact.s_object - place)),
        point=(body.origin + gamma_1).array(),
        centre_0=tip.origin.array(),
        centre_1=body.origin.array(),
        gamma_0=gamma_0.array(),
        gamma_1=gamma_1.array(),
        b_0=b_0.array(),
        b_1=b_1.array(),
        n_0=n_0.array(),
        n_1=n_1.array(),
        # In the chapter's axes: fingertip X_0 = -sense y, Y_0 = -x; object X = x, Y = -sense y.
        psi_0=_from_y(Vec2(own_0.y * -sense, -own_0.x)),
        theta_1=_from_y(Vec2(own_1.x, own_1.y * -sense)),
        l_b0=l_b0,
        l_b1=l_b1,
        l_n0=l_n0,
        l_n1=l_n1,
        kappa_0=jnp.broadcast_to(at.tip.curvature, jnp.shape(place)),
        kappa_1=jnp.broadcast_to(at.object.curvature, jnp.shape(place)),
        misalignment=sense * jnp.arctan2(b_1.cross(b_0), b_1.dot(b_0)),
        q=l_n0 + l_n1 - apart.dot(n_1),
        r=l_b0 + l_b1 - apart.dot(b_1),
    )


def _from_y(tangent: Vec2) -> Scalar:
    """Angle of (56)-(57), from the axis Y towards X, of a tangent in the chapter's axes."""
    return jnp.arctan2(tangent.x, tangent.y)
