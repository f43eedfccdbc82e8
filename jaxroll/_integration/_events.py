"""Where the model ends: its margins, and the code of the one that ran out.

A margin is positive while the model holds and passes through zero where it ends: a normal force, a distance
to the friction cone or to the end of a contour, a relative sum of curvatures. The smallest one and its code
are carried in the flow vector (`_state_vector`). The step-size control finds the time of its root
(`_step_size`), and `_derivative` the derivative of that time.

A step is judged at its end. A force that falls below zero and rises again before the end would go unnoticed,
but the stages of a method evaluate the equations inside the step, and with them the margin. `first_dip` puts
a parabola through the lowest of these margins and its neighbours; where it falls below zero, `StopAt` rejects
the step and ends a shorter one there. Limits of positions and of forces have a parabola each: in the
smallest number of all, a distance of some millimetres would hide a force of some hundredths of newtons that
falls below zero and rises again between two stages.

That costs below 1 % of a batch of the pivoted scene with Tsit5 (`python -m benchmarks.batch`, against a
`first_dip` that returns infinity), as long as it is computed once per step (`_step.advance_lanes`). Otherwise
XLA computes it again for every number of the step-size control, and a batch takes 15 % longer.
"""

import functools
import itertools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import diffrax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import smaller
from .._mechanics import check_planar, check_spatial, Grasp, Leaves
from .._motion import Instant, Struck, world_poses
from .._results import RESULTS
from .._types import ByPrecision, Scalar
from ..contact import (
    AbstractContact,
    chains_apart,
    clearance,
    clearance3,
    links_clearance,
    links_clearance3,
    TOLERANCE,
)

# Relative size below which a pivot of A M^-1 A^T counts as zero. Its margin is what it has beyond that, times
# _FIRM: a pivot is small all along a run whose masses differ by decades, and the smallest margin would hide
# forces that fall below zero and rise again between two stages (lane 1956 of the structure `tolerance-pinch`,
# seed 5 of `benchmarks.stress`: a pivot of 0.004 beside forces of 0.2 N).
SINGULAR, _FIRM = 1e-9, 1e6
# Relative size below which a sum of curvatures counts as zero. The rolling rate is proportional to its
# inverse, (7), so that near zero the sum falls as the square root of the time that is left. At this size some
# 1e-10 s are left, enough for a step to end there; at a smaller one it would be less than the shortest step.
FLAT = 1e-4
# Share of the largest contact impulse that counts as zero: a blow often leaves a contact alone, to rounding.
_BALANCED = ByPrecision(1e-9, 1e-5)
# A joint may start at an end of its range, as in a hand that is stretched out, and the first return to the
# constraints may then move it past that end by rounding. So a range ends this many rounding units of 1 beyond
# its limits, 6e-14 rad or m.
_SLACK = 256.0
# Points on each contour or surface in the audit of penetration.
_SAMPLES = 64

# Of two stages closer in time than this share of a step only the one that the method evaluates later is used,
# since it is of higher order: the difference of close neighbours would magnify the error of the other. Stages
# that close to the start are left out too.
_APART = 0.07

# A margin that falls below this part of the larger of its neighbours counts as close to zero. With a
# twentieth, 3 of 8064 bodies that graze lift-off were lost, by up to 5e-6 of their force; the shorter steps
# that a quarter asks for are less than one in a hundred (`benchmarks.stress --structure graze-lift`,
# seeds 1 to 3).
_CLOSE = 0.25

# Result codes by number: the flow vector holds numbers only, and diffrax's codes know nothing of contacts.
_CODES = (
    RESULTS.successful,
    RESULTS.not_finite,
    RESULTS.singular_contact,
    RESULTS.contour_end,
    RESULTS.contact_lost,
    RESULTS.slipping,
    RESULTS.penetration,
    RESULTS.joint_limit,
    RESULTS.torque_limit,
    RESULTS.links_meet,
)
_NOT_FINITE, _SINGULAR_CONTACT, _CONTOUR_END, _LOST, _SLIPPING, _PENETRATION, _JOINT, _TORQUE, _LINKS = range(
    1, 10
)
# A limit's number is its code plus this for each contact or joint (see `_numbered`): above all codes.
_KINDS = 16
# What contact forces tell of themselves, and with it what is looked for in the shapes.
OF_FORCES = ("lift", "friction")
EVENTS = (*OF_FORCES, "penetration")
# Fields of a finger that may hold limits.
_LIMITS = ("limits", "torque_limits", "link_radius")


class Limit(NamedTuple):
    """One limit of the model at one state.

    Attributes:
        margin: How far away it is; negative beyond it.
        number: Its code and its contact in one number (see `_numbered`).
    """

    margin: Scalar
    number: Any


def regime(
    grasp: Grasp, leaves: Leaves, instant: Instant, events: tuple[str, ...]
) -> tuple[Scalar, Scalar, tuple[Scalar, Scalar]]:
    """Smallest margin at one state, and the number of its limit, negated unless the margin is below zero.

    The third result is what `first_dip` is to look at: the smallest margin of positions, and that of forces
    and torques, or the first again where there is none or the geometry does not hold.

    Contour ends, singular contacts and limits of joints are always watched, normal forces and friction cones
    if `events` names them; a friction cone only where its contact has a coefficient.

    Limits of the geometry come before those of the forces. Where the sum of curvatures passes through zero
    the forces have a pole: beyond it they have the other sign and no meaning, because nothing rolls there.
    A force that fell below zero is then no cause of its own.
    """
    shape = _nearest(_geometry(grasp, leaves, instant))
    forces, joints = _forces(grasp, instant, events), _joints(grasp, leaves, instant)
    ranges = [limit for limit in joints if limit.number % _KINDS == _JOINT]
    forces += [limit for limit in joints if limit.number % _KINDS != _JOINT]
    place, holds = shape if not ranges else _nearest([shape, *ranges]), shape.margin >= 0
    if not forces:
        limit, parts = place, (place.margin, place.margin)
    else:
        force = _nearest(forces)
        lower = force.margin < place.margin
        limit = Limit(*(jnp.where(lower, a, b) for a, b in zip(force, place, strict=True)))
        parts = place.margin, jnp.where(holds, force.margin, place.margin)
    least, number = (jnp.where(holds, a, b) for a, b in zip(limit, shape, strict=True))
    return least, jnp.where(least < 0, number, -number), parts


def _nearest(limits: Sequence[Limit]) -> Limit:
    """The limit with the smallest margin; a margin that is NaN is passed over."""
    # Comparisons with NaN are false; `jnp.minimum` would return it.
    least, number = jnp.inf, jnp.asarray(0)
    for limit in limits:
        lower = limit.margin < least
        number = jnp.where(lower, limit.number, number)
        least = jnp.where(lower, limit.margin, least)
    return Limit(least, number)


def with_clearance(
    grasp: Grasp, leaves: Leaves, end: tuple[Scalar, Scalar], events: tuple[str, ...]
) -> tuple[Scalar, Scalar]:
    """Margin and number with those of audits, of which there may be none; called at the end of a step."""
    least, number = end
    for margin, which in _audits(grasp, leaves, events):
        number = jnp.where((number <= 0) & (margin < 0), which, number)
        least = smaller(margin, least)
    return least, number


def smallest_clearance(grasp: Grasp, leaves: Leaves, events: tuple[str, ...]) -> Scalar:
    """Clearance of the nearest fingertip or link that is audited [m]; negative in an overlap."""
    return functools.reduce(jnp.minimum, [limit.margin for limit in _audits(grasp, leaves, events)])


def _audits(grasp: Grasp, leaves: Leaves, events: tuple[str, ...]) -> list[Limit]:
    """Limits from overlaps of fingertips with the object, if asked for, and of links where they are thick."""
    found = []
    if "penetration" in events:
        clear = _clearances(grasp, leaves)
        found = [Limit(margin, _numbered(_PENETRATION, i)) for i, margin in enumerate(clear)]
    # Samples of a shape are doubles where JAX knows these, in a run of single precision too.
    kind = jnp.result_type(leaves.q[0][0])
    return [Limit(jnp.asarray(m, kind), number) for m, number in [*found, *_link_limits(grasp, leaves)]]


def _link_limits(grasp: Grasp, leaves: Leaves) -> list[Limit]:
    """Limits from distances of links, as capsules, to the object and to links of other fingers [m]."""
    watched = [i for i, f in enumerate(grasp.fingers) if getattr(f, "link_radius", None) is not None]
    if not watched:
        return []
    away, apart = link_distances(grasp, leaves, watched, samples=_SAMPLES)
    limits = [Limit(height, _numbered(_LINKS, i)) for i, height in zip(watched, away, strict=True)]
    pairs = itertools.combinations(watched, 2)
    return [*limits, *(Limit(gap, _numbered(_LINKS, i)) for (i, _), gap in zip(pairs, apart, strict=True))]


def link_distances(
    grasp: Grasp, leaves: Leaves, which: Sequence[int], *, samples: int
) -> tuple[list[Scalar], list[Scalar]]:
    """Distances [m] of some fingers' links from the object, and of every two of these fingers.

    Links are capsules; those of a finger without a `link_radius` have no thickness. `samples` is how many
    points of each contour of the object are looked at.
    """
    fingers: list[Any] = [grasp.fingers[i] for i in which]
    chains: Any = [finger.skeleton(leaves.q[1 + i]) for i, finger in zip(which, fingers, strict=True)]
    radii = [0.0 if (r := getattr(finger, "link_radius", None)) is None else r for finger in fingers]
    body, faces = world_poses(grasp, leaves.q)[0], grasp.object.shapes
    if grasp.spatial:
        away: Any = links_clearance3(body, chains, faces)
    else:
        away = links_clearance(body, chains, faces, samples=samples)
    clear = [height - radius for height, radius in zip(away, radii, strict=True)]
    ends = itertools.combinations(zip(chains, radii, strict=True), 2)
    return clear, [chains_apart(one, other) - a - b for (one, a), (other, b) in ends]


def coded(x: Array, margin: Scalar, number: Scalar) -> Array:
    """Margin and number as the flow vector carries them; the margin is NaN if any value of x is not finite.

    The number is then that of `not_finite`, unless a limit was passed, which is taken as the cause, such as
    the pole of a contact that does not roll.
    """
    finite = jnp.all(jnp.isfinite(x))
    number = jnp.where(finite | (number > 0), number, _NOT_FINITE)
    return jnp.stack([jnp.where(finite, margin, jnp.nan), number.astype(x.dtype)])


def decode(number: Scalar, loop: diffrax.RESULTS) -> RESULTS:
    """The result code of a run, from diffrax's code of its loop and the number in its last state.

    A limit that was passed is the cause, whatever became of the steps; `decode_joints` adds those of fingers.
    """
    result = RESULTS.where(loop == diffrax.RESULTS.successful, RESULTS.successful, RESULTS.solver_failed)
    steps = loop == diffrax.RESULTS.max_steps_reached
    result = RESULTS.where(steps, RESULTS.max_steps_reached, result)
    collapsed = loop == diffrax.RESULTS.dt_min_reached
    result = RESULTS.where(collapsed, RESULTS.step_collapsed, result)
    return _by_number(number, result, range(1, _JOINT))


def decode_joints(grasp: Grasp, number: Scalar, result: RESULTS) -> RESULTS:
    """A run's code, replaced where a limit of a finger ended it; unchanged where no finger has limits."""
    limited = [getattr(f, name, None) is not None for f in grasp.fingers for name in _LIMITS]
    return _by_number(number, result, (_JOINT, _TORQUE, _LINKS)) if any(limited) else result


def _by_number(number: Scalar, result: RESULTS, kinds: Iterable[int]) -> RESULTS:
    """A result, replaced by the code of the limit that was passed, if it is one of these kinds."""
    for i in kinds:
        result = RESULTS.where((number > 0) & (number % _KINDS == i), _CODES[i], result)
    return result


def _numbered(code: int, which: int | None) -> int:
    """A code and the contact it concerns as one number: for overlaps the finger, for limits the joint.

    None stands for all contacts together.
    """
    return code if which is None else code + _KINDS * (which + 1)


def whose(number: Scalar) -> Scalar:
    """The contact, finger or joint in the number of the limit that ended a run; -1 where there is none."""
    return (jnp.maximum(number, 0.0) // _KINDS).astype(int) - 1


def _geometry(grasp: Grasp, leaves: Leaves, instant: Instant) -> list[Limit]:
    """Limits from ends of contours, sums of curvatures, and the smallest pivot of A M^-1 A^T."""
    each = enumerate(zip(grasp.contacts, leaves.s, strict=True))
    limits = [
        Limit(margin, _numbered(_CONTOUR_END, i))
        for i, (contact, place) in each
        for margin in contact.ends(grasp.shapes(contact), place)
    ]
    bends = [
        c.curvature_margin(grasp.shapes(c), place, pair, t)
        for (c, pair, t), place in zip(_each_contact(grasp, instant), leaves.s, strict=True)
    ]
    # Added with its sign: a constant that is subtracted becomes a negation, which XLA moves (`_xla._loops`).
    limits += [Limit(m + -FLAT, _numbered(_SINGULAR_CONTACT, i)) for i, m in enumerate(bends)]
    # The pivot belongs to all contacts together.
    pivot = (instant.line.schur.smallest_pivot + -SINGULAR) * _FIRM
    return [*limits, Limit(pivot, _numbered(_SINGULAR_CONTACT, None))]


def _each_contact(
    grasp: Grasp, instant: Instant | Struck
) -> list[tuple[AbstractContact, tuple[Any, Any], Any]]:
    """Every contact with the poses of its fingertip and of the object, and its frames."""
    body, *tips = (motion.pose for motion in instant.motions)
    each = zip(grasp.contacts, instant.touching, strict=True)
    return [(c, (tips[c.finger], body), touching) for c, touching in each]


def _forces(grasp: Grasp, instant: Instant | Struck, events: tuple[str, ...]) -> list[Limit]:
    """Limits from normal forces f and from the distances mu f - |lambda| to the friction cones [N]."""
    limits = []
    each = zip(_each_contact(grasp, instant), instant.forces, strict=True)
    for i, ((contact, pair, touching), force) in enumerate(each):
        lift = "lift" in events and contact.presses
        rubs = "friction" in events and contact.friction is not None
        if not lift and not rubs:
            continue
        f, tangential = contact.split_force(pair, touching, force)
        if lift:
            limits.append(Limit(f, _numbered(_LOST, i)))
        if rubs:
            cone = contact.friction * f
            slips = _numbered(_SLIPPING, i)
            limits += [Limit(cone - rubbing, slips) for rubbing in contact.rubbing(tangential)]
    return limits


def _joints(grasp: Grasp, leaves: Leaves, instant: Instant) -> list[Limit]:
    """Limits from joints' ranges [rad or m] and largest torques [N m or N], of fingers that have some."""
    limits: list[Limit] = []
    first = 0
    for i, finger in enumerate(grasp.fingers):
        ranges: Any = getattr(finger, "limits", None) or ()
        largest: Any = getattr(finger, "torque_limits", None) or ()
        for j, (low, high) in enumerate(ranges):
            q, number = leaves.q[1 + i][j], _numbered(_JOINT, first + j)
            slack = _SLACK * jnp.finfo(jnp.result_type(q)).eps
            limits += [Limit(q - low + slack, number), Limit(high - q + slack, number)]
        for j, most in enumerate(largest):
            torque = instant.torques[i][j] if instant.torques[i] else 0.0
            limits.append(Limit(most - jnp.abs(torque), _numbered(_TORQUE, first + j)))
        first += finger.joints
    return limits


def refused_blow(grasp: Grasp, done: Struck, events: tuple[str, ...]) -> tuple[Scalar, Scalar]:
    """Whether contacts cannot answer a blow, and the number of the limit that says so, if one does.

    Contact impulses have the limits of contact forces, which they may pass by the rounding of momentum.
    """
    limits = _forces(grasp, done, events)
    if not limits:
        return jnp.asarray(False), jnp.asarray(0)
    limit = _nearest(limits)
    parts = [x for each in (done.forces, done.momentum) for rows in each for x in rows]
    largest = jnp.max(jnp.abs(jnp.stack(parts)))
    return limit.margin < -_BALANCED.of(largest) * largest, limit.number


def are_redundant(done: Struck) -> Scalar:
    """Whether contacts hold some motion twice, so that their impulses are not determined."""
    pivot = done.line.schur.smallest_pivot
    return jnp.isnan(pivot) | (pivot < SINGULAR)


def _clearances(grasp: Grasp, leaves: Leaves) -> list[Scalar]:
    """How far every fingertip stays clear of the object [m]."""
    body, *tips = world_poses(grasp, leaves.q)
    apart, faces = clearance3 if grasp.spatial else clearance, grasp.object.shapes
    return [
        apart((pose, body), finger.tip, faces, samples=_SAMPLES) + TOLERANCE
        for pose, finger in zip(tips, grasp.fingers, strict=True)
    ]


def check_overlaps(grasp: Grasp) -> None:
    """Raise where an audit of penetration has no points to look at."""
    if not grasp.spatial:
        check_planar(grasp)
        return
    check_spatial(grasp)
    for i, finger in enumerate(grasp.fingers):
        open_faces = any(face.spread(1) is None for face in grasp.object.shapes)
        if finger.tip.spread(1) is None and open_faces:
            raise ValueError(
                f"argument events may hold 'penetration' only if of finger {i} and the object one has "
                "surfaces with bounds, which neither has"
            )


def watched(times: np.ndarray) -> np.ndarray:
    """Indices of the stages whose margins `first_dip` uses, in order of time; the last is the step's end.

    Args:
        times: When each stage is evaluated, as a share of the step; the first is the start, the last the end.
    """
    picked: list[int] = []
    for i in reversed(range(1, len(times))):
        inside = _APART <= times[i] <= 1.0
        if inside and all(abs(times[i] - times[j]) >= _APART for j in picked):
            picked.append(i)
    return np.array([0, *sorted(picked, key=lambda i: times[i])])


def first_dip(times: np.ndarray, margins: Sequence[Array]) -> Array:
    r"""Share of a step at which its margin is lowest, if that is below zero or close to it; else infinity.

    The parabola $m + b x + a x^2$, with x from the middle one, goes through the lowest margin inside the step
    and its two neighbours. It dips below zero if $m < 0$, or if $4 a m < b^2$ and its lowest place $-b / 2a$
    lies between the neighbours. In the second condition m is lowered by `_CLOSE` of the larger neighbour:
    close to zero the parabola may err by more than m, and a shorter step decides. The ends of a step are
    judged elsewhere: where the end is below zero, only a dip before that counts, which rises again.

    Args:
        times: Shape (n,), rising shares of the step, the start and the end included.
        margins: The margins there.
    """
    shares = times.tolist()  # plain numbers, which leave single precision as it is
    # The lowest inner margin, both neighbours, and their times; which one it is, is known at run time only.
    low = (margins[0], margins[1], margins[2], *shares[:3])
    for i in range(2, len(shares) - 1):
        lower = margins[i] < low[1]
        new = (*margins[i - 1 : i + 2], *shares[i - 1 : i + 2])
        low = tuple(jnp.where(lower, a, b) for a, b in zip(new, low, strict=True))
    before, here, after, start, middle, end = low
    back, ahead = middle - start, end - middle
    # a and b times `size`, the product of the three distances, which is positive: so nothing is divided.
    down, up = (here - before) * ahead, (after - here) * back
    a, b = up - down, up * back + down * ahead
    size = back * ahead * (back + ahead)
    close = here - _CLOSE * jnp.maximum(before, after)
    between = (a > 0) & (b < 2.0 * back * a) & (b > -2.0 * ahead * a)
    dips = (here < 0) | between & (4.0 * a * close * size < b * b)
    dips = dips & ((margins[-1] >= 0) | between & (here < after))
    lowest = middle + jnp.where(between, -0.5 * b / jnp.where(between, a, 1.0), 0.0)
    return jnp.where(dips, lowest, jnp.inf)
