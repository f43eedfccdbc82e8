"""Loci of contact on both surfaces: conditions A-1 and A-2 of Part 3, looked at as curves."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra import sharing
from .._backend import one_kernel
from .._spatial import Vec3
from .._types import Scalar, Times
from ..mechanics import bodies, compiled, Grasp, State, touches
from ._closed_loop import evaluate
from ._flow import layout, pack, unpack
from ._formulation import Index1
from ._trajectory import Trajectory


class Locus(eqx.Module):
    r"""The curve of contact points on one surface, in its body's frame, with Darboux frame $(t, n \times t, n)$.

    Every quantity has shape (c, times): one row per contact. Where the contact rests, curvatures are not
    finite.

    Attributes:
        point: Shape (c, times, 3) [m].
        arclength: From the first saved time [m].
        speed: Rate of the arclength [m/s].
        normal_curvature: $\kappa_n = t \cdot L t$ [1/m], positive where the body is convex.
        geodesic_curvature: $\kappa_g = t' \cdot (n \times t)$ [1/m].
        geodesic_torsion: $\tau_g = -(n \times t) \cdot L t$ [1/m].
        curvature: $\sqrt{\kappa_n^2 + \kappa_g^2}$, of the curve in space [1/m].
        torsion: Of the curve in space [1/m]; not finite where it is straight.
    """

    point: Float[Array, "c t 3"]
    arclength: Float[Array, "c t"]
    speed: Float[Array, "c t"]
    normal_curvature: Float[Array, "c t"]
    geodesic_curvature: Float[Array, "c t"]
    geodesic_torsion: Float[Array, "c t"]
    curvature: Float[Array, "c t"]
    torsion: Float[Array, "c t"]


class Loci(eqx.Module):
    """Loci of all contacts over a run.

    Attributes:
        ts: Saved times [s].
        tip: On the fingertips.
        object: On the object.
    """

    ts: Times
    tip: Locus
    object: Locus


class _Jet(eqx.Module):
    """One curve at one time: point, three derivatives in time, normal, and $L$ times the first."""

    point: Array
    rates: tuple[Array, Array, Array]
    normal: Array
    bend: Array


def loci(grasp: Grasp, trajectory: Trajectory) -> Loci:
    r"""Loci of contact on both surfaces along a run in space (Fig. 20).

    Velocity, acceleration and jerk of the contact points over their surfaces are derivatives of the rolling
    velocity along the equations of motion, not differences. The arclength is integrated from speed and its
    rate at the saved times by Hermite's rule, whose error is of fourth order in their distance; both
    surfaces' arclengths come from their own points, so that A-2 can be seen to hold.

    Args:
        grasp: The grasp that was simulated, in space.
        trajectory: One run of it.

    Raises:
        ValueError: If the grasp lives in the plane, or the trajectory is a batch.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.incline()
        >>> run = jxr.simulate(grasp, state, t1=1.0, ts=11)
        >>> found = jxr.loci(grasp, run)
        >>> bool(abs(found.tip.arclength[0, -1] - found.object.arclength[0, -1]) < 1e-12)
        True
    """
    if not grasp.spatial:
        raise ValueError("argument grasp must live in space, but its contacts are those of the plane")
    if jnp.ndim(trajectory.ts) != 1 or jnp.ndim(trajectory.states.q) != 2:
        raise ValueError(f"argument trajectory must be one run, but had shape {trajectory.states.q.shape}")
    return _loci(grasp, trajectory.ts, trajectory.states)


@compiled
def _loci(grasp: Grasp, ts: Array, states: State) -> Loci:
    ready = grasp.prepared()
    tip, face = one_kernel(jax.vmap(_jets, in_axes=(None, 0, 0)), ready, ts, states)
    return Loci(ts, _locus(ts, tip), _locus(ts, face))


def _jets(grasp: Grasp, t: Scalar, state: State) -> tuple[_Jet, _Jet]:
    """Curves on fingertips and object, stacked over the contacts."""
    lay = layout(grasp, audited=False)
    x = jnp.concatenate([state.q, state.v, state.s])
    with sharing(t):
        rates = lambda t, x: _rates(grasp, lay, t, x)  # noqa: E731
        first = lambda t, x: _velocities(grasp, unpack(lay, x)[0])  # noqa: E731
        second = _along(first, rates)
        (velocity, acceleration), (_, jerk) = _both(first, second, _along(second, rates), t, x)
        points, normals, bends = _frames(grasp, unpack(lay, x)[0], velocity)
    parts = [_Jet(points[:, i], _column((velocity, acceleration, jerk), i), normals[:, i], bends[:, i]) for i in (0, 1)]
    return parts[0], parts[1]
