r"""Loci of contact on both surfaces: conditions A-1 and A-2 of Part 3, looked at as curves.

While two bodies roll, the contact point moves over either surface and traces a curve, its locus. Without slip
both points have one velocity at every time (A-2), so that both loci have one arclength. The curvatures of a
locus follow from derivatives in time of the contact point in the body's axes, with v the velocity, a the
acceleration, j the jerk, n the unit normal and $L$ the shape operator:
$$ \kappa_n = \frac{v \cdot L v}{|v|^2}, \quad \kappa_g = \frac{a \cdot (n \times v)}{|v|^3}, \quad
   \tau_g = -\frac{(n \times v) \cdot L v}{|v|^2}, \quad
   \tau = \frac{(v \times a) \cdot j}{|v \times a|^2}. $$

v is what a contact calls its `rolling` in space; a is its derivative along the equations of motion.
`plotting` draws the loci.
"""

import functools
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._integration import check_one_run, layout, pack, Trajectory, unpack
from .._linalg import Pose3, root, total, Twist3, Vec3
from .._mechanics import check_spatial, check_states, compiled, Grasp, Leaves, State
from .._motion import evaluate, Index1, touches
from .._printing import listed
from .._results import check_finite
from .._types import ByPrecision, Scalar, Scalars, Times
from .._xla import in_turn, once, sharing
from ..contact import Motion

# Distance in time of the accelerations whose difference is the jerk [s]. The difference is of fourth order,
# so that its error and the rounding of accelerations divided by it are both small.
_STEP = ByPrecision(1e-4, 2e-3)


class Locus(eqx.Module):
    r"""The curve of contact points on one surface, in its body's axes; Darboux frame $(t, n \times t, n)$.

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

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {
        "point": "m",
        "arclength": "m",
        "speed": "m/s",
        "normal_curvature": "1/m",
        "geodesic_curvature": "1/m",
        "geodesic_torsion": "1/m",
        "curvature": "1/m",
        "torsion": "1/m",
    }

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

    __repr__ = listed
    UNITS: ClassVar[dict[str, str]] = {"ts": "s"}

    ts: Times
    tip: Locus
    object: Locus


class _Jet(eqx.Module):
    """The loci on one side at one time, in the bodies' axes, every field of shape (c, 3).

    Attributes:
        point: Contact points [m].
        velocity: Their velocities over the surface [m/s].
        acceleration: Derivatives of these in time [m/s^2].
        jerk: Derivatives of the accelerations [m/s^3].
        normal: Unit normals.
        bend: $L v$ [1/s]: shape operator times velocity.
    """

    point: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    normal: Array
    bend: Array


def loci(grasp: Grasp, trajectory: Trajectory) -> Loci:
    r"""Loci of contact on both surfaces along a run in space (Fig. 20).

    Velocity and acceleration of the contact points over their surfaces are those of the equations of motion,
    not differences of states; the jerk, which the torsion alone needs, is a difference of fourth order of
    accelerations along the motion, over 0.4 ms, in single precision over 8 ms, and on one side of a declared
    jump. The arclength is integrated from speed and its rate at the saved times by Hermite's rule, whose
    error is of fourth order in their distance, where forces jump of second order, and at a blow of first;
    both surfaces' arclengths come from their own points, so that A-2 can be seen to hold.

    Args:
        grasp: The grasp that was simulated, in space.
        trajectory: One run of it.

    Returns:
        `Loci`.

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
    check_spatial(grasp)
    check_run(grasp, trajectory)
    return _loci(grasp, trajectory.ts, trajectory.states)


def check_run(grasp: Grasp, trajectory: Trajectory) -> None:
    """Raise unless a trajectory is one run, and one that could be of this grasp, with saved times."""
    check_one_run("trajectory", trajectory)
    check_states(grasp, trajectory.states, "trajectory.states", axes=1)
    check_finite("trajectory.ts", trajectory.ts)


@compiled
def _loci(grasp: Grasp, ts: Array, states: State) -> Loci:
    """Loci from saved times and states: derivatives state by state, then curvatures of all at once."""
    ready = grasp.prepared()
    # State by state: under `vmap` the derivatives would take ten times as long to compile.
    tip, face = in_turn(_jets, ready, ts, states)
    return Loci(ts, _locus(ts, tip), _locus(ts, face))


def _jets(grasp: Grasp, t: Scalar, state: State) -> tuple[_Jet, _Jet]:
    """Derivatives of the loci on the fingertips and on the object at one time [s] and state."""
    lay = layout(grasp, audited=False)
    # With the controller's memory, where the run has saved one: its torques are part of the accelerations.
    memory = [] if state.memory is None else [state.memory]
    x = jnp.concatenate([state.q, state.v, state.s, *memory])

    def moving(t: Scalar, x: Array) -> tuple[Array, Array, Array]:
        """Velocities of the contact points, their derivatives in time, and the rates of the whole state x.

        The equations of motion give dx/dt, and with it how poses, twists and places change; the derivative
        of the velocities along that change is one jvp.
        """
        with sharing():
            # Without `once` XLA would work out the whole vector again for each of its numbers.
            x = once(x)
            leaves = unpack(lay, x)[0]
            now = evaluate(grasp, t, leaves, Index1())
            rates = pack(now.rates, None)
            at = (leaves.s, [(motion.pose, motion.twist) for motion in now.motions])
            along = (now.rates.s, [_carried(*each) for each in zip(now.motions, now.rates.v, strict=True)])
            found = jax.jvp(lambda at: _velocities(grasp, *at), (_arrays(at, x),), (_arrays(along, x),))
        return *found, rates

    # The states lie on the straight line x + step dx/dt, not on the motion itself: at step 0 both have the
    # same derivative, and on either the error of the difference quotient is of fourth order in the step.
    # Step 0 comes first and gives dx/dt to the others, so that the program has the equations of motion once.
    # With `checkpoint` a gradient works a step out again; to store what happened in all steps, in hundreds of
    # arrays, takes longer to compile.
    @functools.partial(jax.checkpoint, prevent_cse=False)
    def later(line: Array, step: Scalar) -> tuple[Array, tuple[Array, Array]]:
        velocities, changes, rates = moving(t + step, x + step * line)
        return jnp.where(step == 0.0, rates, line), (velocities, changes)

    apart = _STEP.of(x)
    # In the state's precision: a number of NumPy's is one of double precision, unlike one of Python's.
    places, weights = (row.astype(x.dtype) for row in _differences(grasp, t, apart))
    _, (velocities, near) = jax.lax.scan(later, jnp.zeros_like(x), apart * places)
    velocity, acceleration = velocities[0], near[0]
    jerk = total([weight * each for weight, each in zip(weights, near, strict=True)]) / (12.0 * apart)
    points, normals, bends = _frames(grasp, unpack(lay, x)[0], velocity)
    parts = (points, velocity, acceleration, jerk, normals, bends)
    tip, face = (_Jet(*(part[:, i] for part in parts)) for i in (0, 1))  # pyright: ignore
    return tip, face


def _differences(grasp: Grasp, t: Scalar, apart: float) -> tuple[Any, Any]:
    """Where accelerations are taken for the jerk, in steps from a time [s], and twelve times their weights.

    On both sides of the time, but on one side of a declared jump: forces on the other are of another motion.
    """
    both = np.array([[0.0, -2.0, -1.0, 1.0, 2.0], [0.0, 1.0, -8.0, 8.0, -1.0]])
    ahead = np.array([[0.0, 1.0, 2.0, 3.0, 4.0], [-25.0, 48.0, -36.0, 16.0, -3.0]])
    if not grasp.jumps:
        return both[0], both[1]
    since = t - jax.lax.stop_gradient(jnp.concatenate(grasp.jumps))
    past, coming = (since >= 0) & (since < 2.0 * apart), (since < 0) & (since >= -2.0 * apart)
    beyond = jnp.where(jnp.any(past), ahead, jnp.where(jnp.any(coming), -ahead, both))
    return beyond[0], beyond[1]


def _arrays(tree: Any, like: Array) -> Any:
    """A tree whose numbers are arrays, as derivatives want them: some are Python's own zeros."""
    return jax.tree.map(lambda number: jnp.asarray(number, like.dtype), tree)


def _carried(motion: Motion, accelerations: Scalars) -> tuple[Pose3, Twist3]:
    """Rates of a body's pose and twist: unit twists times accelerations, and what these do not enter."""
    change = motion.bias
    for unit, rate in zip(motion.unit_twists, accelerations, strict=True):
        change = change + unit * rate
    return motion.pose.rate(motion.twist), change


def _velocities(grasp: Grasp, places: Any, bodies: list[tuple[Pose3, Twist3]]) -> Array:
    """Velocities [m/s] of the contact points over their surfaces: contact, fingertip or object, axis.

    In the world both points have the same velocity over their surfaces; it is turned into either body's axes.
    """
    # A rolling rate depends on poses and twists alone.
    motions = [Motion(pose, (), twist, twist) for pose, twist in bodies]
    rows = []
    each = zip(grasp.contacts, places, touches(grasp, places), strict=True)
    for contact, place, touching in each:
        pair = motions[1 + contact.finger], motions[0]
        shapes, poses = grasp.shapes(contact), (pair[0].pose, pair[1].pose)
        bend = contact.bend(shapes, place, poses, touching)
        velocity = contact.rolling(shapes, place, pair, touch=touching, bend=bend)
        rows.append(jnp.stack([motion.pose.back(velocity).array() for motion in pair]))
    return jnp.stack(rows)


def _frames(grasp: Grasp, leaves: Leaves, velocity: Array) -> tuple[Array, Array, Array]:
    """Points, normals and $L v$ in the bodies' axes: contact, fingertip or object, axis."""
    found = []
    for touching, pair in zip(touches(grasp, leaves.s), velocity, strict=True):
        frames = (touching.tip, touching.object)
        bends = [frame.shape.apply(Vec3(*v)) for frame, v in zip(frames, pair, strict=True)]
        parts = ([f.point for f in frames], [f.normal for f in frames], bends)
        found.append([jnp.stack([vector.array() for vector in part]) for part in parts])
    points, normals, bends = (jnp.stack(part) for part in zip(*found, strict=True))
    return points, normals, bends


def _locus(ts: Array, jet: _Jet) -> Locus:
    """One surface's loci from their derivatives, whose axes are time, contact, vector.

    The formulas are those at the top of the file. Where the contact rests they are 0/0, and so NaN. A first
    `where` keeps the zeros out of the division, a second one puts in the NaN: so no other derivative is NaN.
    """
    jet = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), jet)
    dot = lambda a, b: jnp.sum(a * b, axis=-1)  # noqa: E731
    v, a = jet.velocity, jet.acceleration
    across = jnp.cross(v, a)
    binormal = dot(across, across)
    speed = root(dot(v, v))
    moves, turns = speed > 0.0, binormal > 0.0
    some, turning = jnp.where(moves, speed, 1.0), jnp.where(turns, binormal, 1.0)
    of_moving = lambda value: jnp.where(moves, value, jnp.nan)  # noqa: E731
    side = jnp.cross(jet.normal, v)
    normal, geodesic = dot(v, jet.bend) / some**2, dot(a, side) / some**3
    # The rate of the speed is v . a / |v|; where the contact is at rest it sets off with |a|.
    hastening = jnp.where(moves, dot(v, a) / some, root(dot(a, a)))
    return Locus(
        jet.point,
        _integrated(ts, speed, hastening),
        speed,
        of_moving(normal),
        of_moving(geodesic),
        of_moving(-dot(side, jet.bend) / some**2),
        of_moving(root(normal**2 + geodesic**2)),
        jnp.where(turns, dot(across, jet.jerk) / turning, jnp.nan),
    )


def _integrated(ts: Array, rate: Array, slope: Array) -> Array:
    r"""Integral of a rate over the last axis, from the first time on, by Hermite's rule.

    Over one interval of length h: $\frac h2 (f_0 + f_1) + \frac{h^2}{12} (f_0' - f_1')$.
    """
    h = jnp.diff(ts)[None]
    parts = 0.5 * h * (rate[:, :-1] + rate[:, 1:]) + h**2 / 12.0 * (slope[:, :-1] - slope[:, 1:])
    return jnp.pad(jnp.cumsum(parts, axis=-1), ((0, 0), (1, 0)))
