r"""How the constraints are kept during integration: projection, or the chapter's stabilisation.

The equations hold the second derivative of every gap at zero, so that a numerical error in a gap $g$ would
grow linearly in time. `Index1` removes it after each step (`_projection`). `CSM` instead asks for
$\ddot g = -\gamma \dot g - \omega g$, which `_equations` adds to the right-hand side through `restoring`.
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
from jaxtyping import Array, Float

from .._linalg import Vec2
from .._mechanics import check_planar, Grasp
from .._printing import listed
from .._results import as_positive, check_instance
from .._types import Given
from ..contact import gap, Motion, Rows, Touch


class Index1(eqx.Module):
    """Index-1 equations, projected onto positions and velocities after each accepted step.

    Adds no stiffness; drift stays at rounding level on any time span. The projection is the nearest
    point in the mass metric and uses the factorisation of the step's last evaluation.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, 1.0, formulation=jxr.Index1())  # the default
        >>> bool(abs(run.residuals.normal).max() < 1e-14)
        True
    """

    __repr__ = listed


class CSM(eqx.Module):
    r"""The chapter's constraint stabilisation method, with the gains of Table 2.

    $\ddot Q + \gamma_f \dot Q + \omega_f Q = 0$ along the object's normal, and
    $\ddot R + \gamma_\lambda \dot R + \omega_\lambda R = 0$ along its tangent. Tangency is only
    integrated through (68), never stabilised: an error at the start stays. The gap is differentiated in
    world axes and only then taken along normal and tangent: products of the gap with the rotation of the
    contact frame, which $\ddot Q$ and $\ddot R$ of (64)-(65) have, are left out. So this is the chapter's
    equation on the constraint manifold, and off it where the frame rests; a gap $\epsilon$ in a frame that
    turns at $\omega$ is pulled back with errors of order $\omega \epsilon$ in its rate. The gains add rates
    of $-750 \pm 1299i$ and $-1500 \pm 2598i$ 1/s, so explicit solvers take eleven times (301 saved states)
    to 26 times (one) as many steps.

    Args:
        gamma_f: $\gamma_{f1}$ [1/s]. Default: 1500.
        omega_f: $\omega_{f1}$ [1/s^2]. Default: 225e4.
        gamma_lambda: $\gamma_{\lambda 1}$ [1/s]. Default: 3000.
        omega_lambda: $\omega_{\lambda 1}$ [1/s^2]. Default: 900e4.

    Raises:
        ValueError: If a gain is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> jxr.simulate(grasp, state, 0.1, ts=1, formulation=jxr.CSM()).result
        successful
    """

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {
        "gamma_f": "1/s",
        "omega_f": "1/s^2",
        "gamma_lambda": "1/s",
        "omega_lambda": "1/s^2",
    }

    gamma_f: Float[Array, ""]
    omega_f: Float[Array, ""]
    gamma_lambda: Float[Array, ""]
    omega_lambda: Float[Array, ""]

    def __init__(
        self,
        gamma_f: Given = 1500.0,
        omega_f: Given = 225.0e4,
        gamma_lambda: Given = 3000.0,
        omega_lambda: Given = 900.0e4,
    ) -> None:
        self.gamma_f = as_positive("gamma_f", gamma_f)
        self.omega_f = as_positive("omega_f", omega_f)
        self.gamma_lambda = as_positive("gamma_lambda", gamma_lambda)
        self.omega_lambda = as_positive("omega_lambda", omega_lambda)

    def restoring(
        self, grasp: Grasp, motions: Sequence[Motion], touching: Sequence[Touch], closing: Rows
    ) -> Rows:
        r"""The terms $\gamma \dot g + \omega g$ of every contact in world axes [m/s^2]; (64)-(65).

        `closing` holds the rates of the gaps, $A v$, in world axes.
        """
        return tuple(
            tuple(self._at_contact(motions[1 + c.finger], motions[0], t, Vec2(*rate)))
            for c, t, rate in zip(grasp.contacts, touching, closing, strict=True)
        )

    def _at_contact(self, tip: Motion, body: Motion, touching: Touch, rate: Vec2) -> Vec2:
        # The gap and its rate along b_0 (R) and across it (Q), each with its own gains; the sum is in world
        # axes again. Which of the two normals is taken does not matter: it enters twice.
        open_ = gap(tip.pose, body.pose, touching.points)
        tangent = body.pose.turn(touching.object.tangent)
        normal = tangent.right()
        along = self.gamma_lambda * rate.dot(tangent) + self.omega_lambda * open_.dot(tangent)
        across = self.gamma_f * rate.dot(normal) + self.omega_f * open_.dot(normal)
        return tangent * along + normal * across


Formulation = Index1 | CSM
# Made once: equinox takes 8 us for each.
_DEFAULT = Index1()


def check_formulation(given: Any) -> None:
    """Raise for what is no formulation; None stands for the default."""
    if given is not None:
        check_instance("formulation", given, (Index1, CSM), "jaxroll.Index1() or jaxroll.CSM(...)")


def as_formulation(grasp: Grasp, given: Any) -> Formulation:
    """The formulation asked for, by default `Index1`; raise unless it is one, and one for this grasp."""
    check_formulation(given)
    if given is None:
        return _DEFAULT
    if isinstance(given, CSM):
        check_planar(grasp)
    return given
