r"""`resume`: the contacts with which a run goes on after one of them was lost, or a fingertip touched.

A lost contact is dropped, and all velocities stay. A touch is found by the event 'penetration' where the
shapes overlap by its tolerance. From there the motion is followed back to the time at which the closest
points of both shapes (`contact.locate`) are at distance zero; the new contact begins at them, and closes by
the inelastic impulse of `_motion._impulse`, which takes energy and never gives any.
"""

from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._linalg import seven, three, total
from .._mechanics import check_states, compiled, Grasp, split, State, to_leaves
from .._motion import accelerations, bodies, closed_within, memory_waiting, residuals, world_poses, worst
from .._printing import code_name
from .._results import as_positive, on_host
from .._types import Given, Scalar
from ..contact import Contact, Contact3, locate, locate_surfaces, Location, SurfaceLocation
from ..loads import Impulse
from ._report import contact_name
from ._strike import strike
from ._trajectory import check_one_run, Trajectory
from ._vector_field import held_field, vector_in

# Tolerance of the motion followed back from an overlap [m, rad, and these per second].
_BACK = 1e-12
# A distance that counts as none [m], and how many times the time of touch is corrected at most.
_TOUCHING, _PASSES = 1e-15, 12
# The gap of a contact that is lost where it does not rub has no acceleration, up to this share of its terms.
_AGAIN = 1e-6
# Share of a contour from its end in which a touch without a common tangent is one of that end. Where a corner
# is inside of a fingertip, `locate` has no more than its lowest sample, of 128.
_NEAR_END = 0.02


@on_host
def resume(grasp: Grasp, run: Trajectory, *, friction: Given | None = None) -> tuple[Grasp, State, Scalar]:
    r"""The grasp, the state and the time with which a run that an event ended goes on.

    After `contact_lost` it is the grasp without that contact, at the end of the run, with its velocities;
    where a blow knocked it off, those before the blow, which the run that goes on begins with.
    After `penetration` it has a new contact, its last, between the finger that overlaps and the face that it
    overlaps, at the time when they touched: all gaps stop closing there, by an inelastic impulse
    $v_+ = v_- - M^{-1} A^T (A M^{-1} A^T)^{-1} A v_-$, and the positions are those of the touch. Contacts
    that this blow throws off, because their impulse would have to pull, are dropped: there may be no more
    contacts than before.

    For a run without an end of its own give `simulate` the events ('lift', 'friction', 'penetration') and
    call `resume` wherever one ends; every set of contacts is a program of its own, compiled once.

    Args:
        grasp: The grasp of the run.
        run: One run, which ended `contact_lost` or `penetration`.
        friction: Coefficient of friction of a contact that is found. Default: no limit.

    Returns:
        Grasp, state and time [s]: `simulate(grasp, state, t1, t0=t)` goes on.

    Raises:
        ValueError: If the run ended otherwise, lost its only contact, or one that would close again at once,
            as a contact without a coefficient of friction may that rubs where it no longer presses; if a
            fingertip met the end of a face, such as the corner of a rectangle, or its own end met a face,
            where they have no common tangent; if a touch makes the contacts redundant, as of a ball that
            rolls into a corner; if friction cannot answer a touch; if contours or surfaces without bounds
            touch each other; or if JAX is tracing some number.

    Accuracy: gaps of a touch below 1e-14 m. Not differentiable: which contacts there are is decided on the
    way; the pieces of a run are. Torques of `control.Sampled` are held on the way back; a sample between the
    touch and the end of the run is taken again.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pinch()
        >>> pushed = grasp.with_(load=jxr.loads.Push((8.0, 0.0), 0.1, 0.01))  # off the left finger
        >>> run = jxr.simulate(pushed, state, 1.0, throw=False)
        >>> left, state, t = jxr.resume(pushed, run)
        >>> [contact.finger for contact in left.contacts], f"{t:.3f} s"
        ([1], '0.103 s')
    """
    check_one_run("run", run)
    if friction is not None:
        as_positive("friction", friction)
    check_states(grasp, run.last, "run.last")
    name = code_name(run.result)
    if name == "contact_lost":
        return _dropped(grasp, run)
    if name == "penetration":
        return _touched(grasp, run, friction)
    raise ValueError(
        f"argument run must have ended contact_lost or penetration, for `resume` to go on, but was {name}"
    )


def _dropped(grasp: Grasp, run: Trajectory) -> tuple[Grasp, State, Scalar]:
    """The grasp without the contact that the run lost."""
    lost = int(run.stats.contact)
    if len(grasp.contacts) == 1:
        raise ValueError(
            f"argument run must leave the grasp a contact, but lost its only one, "
            f"{contact_name(run.labels, lost)}"
        )
    left, state = _without(grasp, run.last, lost)
    # A margin of minus infinity is that of a blow (`_step.moved`), which the next run begins with: until then
    # the contact presses, and what opens it are velocities.
    if np.isneginf(float(run.stats.margin)):
        return left, state, run.stats.t_end
    pressed = float(_overlap_rate(grasp, run.last, accelerations(left, run.stats.t_end, state), lost))
    if pressed > _AGAIN:
        raise ValueError(
            f"argument run must lose a contact that then opens, but {contact_name(run.labels, lost)} rubs "
            f"where it no longer presses, and would close again at once: give the contacts a `friction`, so "
            f"that it slips before, or push along its normal"
        )
    return left, state, run.stats.t_end


@compiled
def _overlap_rate(grasp: Grasp, state: State, rates: Array, lost: int) -> Scalar:
    """Acceleration at which a contact's shapes would overlap, over the largest of its rows' parts."""
    ready = grasp.prepared()
    leaves = to_leaves(state, ready.form)
    motions, _ = bodies(ready, leaves)
    contact = ready.contacts[lost]
    shapes, pair, place = ready.shapes(contact), (motions[1 + contact.finger], motions[0]), leaves.s[lost]
    touch, poses = contact.touch(shapes, place), (pair[0].pose, pair[1].pose)
    bend = contact.bend(shapes, place, poses, touch)
    rolling = contact.rolling(shapes, place, pair, touch=touch, bend=bend)
    bias = contact.bias(shapes, place, pair, touch=touch, rolling=rolling)
    # g'' = A v' + A' v, of which the part along the normal counts as the gap itself does: overlaps positive.
    each = split(rates, ready.sizes)
    parts = [
        [a * v for a, v in zip(row, each[at], strict=True)]
        for rows, at in zip(contact.pfaffian(pair, touch), (1 + contact.finger, 0), strict=True)
        for row in rows
    ]
    count = contact.rows
    gained = tuple(total([*parts[i], *parts[count + i], bias[i]]) for i in range(count))
    largest = jnp.max(jnp.abs(jnp.stack([jnp.asarray(x) for part in parts for x in part])))
    return contact.split_gap(poses, touch, gained)[0] / largest


def _without(grasp: Grasp, state: State, lost: int) -> tuple[Grasp, State]:
    """A grasp and its state without one contact."""
    # How many numbers the place of each contact has.
    counts = [place.num_leaves for place in grasp.form.places.children()]
    starts = np.concatenate([[0], np.cumsum(counts)])
    kept = np.delete(np.arange(starts[-1]), np.arange(starts[lost], starts[lost + 1]))
    contacts = tuple(c for i, c in enumerate(grasp.contacts) if i != lost)
    return grasp.with_contacts(*contacts), State(state.q, state.v, np.asarray(state.s)[kept], state.memory)


def _touched(grasp: Grasp, run: Trajectory, friction: Given | None) -> tuple[Grasp, State, Scalar]:
    """The grasp with the contact that the run found, at the time of the touch, without closing speed."""
    finger = int(run.stats.contact)
    # The face with the gap of the smallest size is the one that was just passed.
    each = [_nearest(grasp, run.last, finger, i) for i in range(len(grasp.object.shapes))]
    face = int(np.argmin([abs(float(found.gap)) for found in each]))
    state, found = run.last, each[face]
    ends = [jnp.zeros(())], [found.gap]
    # The secant method on the time back from the overlap, from a first guess that is as good as any.
    ahead = jnp.asarray(1e-6, state.q.dtype)
    for _ in range(_PASSES):
        state = _earlier(grasp, run.last, run.stats.t_end, ahead)
        found = _nearest(grasp, state, finger, face)
        ends[0].append(ahead)
        ends[1].append(found.gap)
        if abs(float(found.gap)) <= _TOUCHING:
            break
        (t0, t1), (g0, g1) = (each[-2:] for each in ends)
        if g1 == g0:
            break
        ahead = jnp.maximum(t1 - g1 * (t1 - t0) / (g1 - g0), 0.0)
    contact, place = _contact_at(found, finger, face, friction)
    closed = grasp.with_contacts(*grasp.contacts, contact)
    touched, memory = run.stats.t_end - ends[0][-1], state.memory
    if grasp.form.sampled:
        memory = memory_waiting(grasp, touched, state)
    start = State(state.q, state.v, jnp.concatenate([state.s, place]), memory)
    _check_tangent(closed, start, found)
    nothing = Impulse((0.0,) * (3 if grasp.spatial else 2), 0.0)
    hit = strike(closed, start, nothing)
    while code_name(hit.result) == "contact_lost":
        # The impact knocks a contact off: without the one that would have to pull most, once more.
        closed, start = _without(closed, start, int(np.argmin(hit.multipliers.f)))
        hit = strike(closed, start, nothing)
    if code_name(hit.result) == "singular_contact":
        raise ValueError(
            f"argument run must touch so that all contacts hold something of their own, but with finger "
            f"{finger} on face {face} of the object some motion is held twice"
        )
    if code_name(hit.result) != "successful":
        raise ValueError(
            f"argument run must touch in a way that friction can answer, but the impulse of finger "
            f"{finger} on face {face} of the object made a contact slip"
        )
    return closed, hit.state, touched


def _nearest(grasp: Grasp, state: State, finger: int, face: int) -> Location | SurfaceLocation:
    """Closest points of a fingertip and a face of the object."""
    body, *tips = _poses(grasp, state)
    shapes = grasp.fingers[finger].tip, grasp.object.shapes[face]
    found = locate_surfaces if grasp.spatial else locate
    return found(*shapes, pose_a=tips[finger], pose_b=body)


@compiled
def _poses(grasp: Grasp, state: State) -> tuple[Array, ...]:
    """World poses of the object and of every fingertip, as numbers."""
    frames = world_poses(grasp.prepared(), split(state.q, grasp.form.positions))
    return tuple(map(seven if grasp.spatial else three, frames))


def _contact_at(
    found: Location | SurfaceLocation, finger: int, face: int, friction: Given | None
) -> tuple[Contact | Contact3, Array]:
    """A contact at closest points, and its place in a state."""
    if isinstance(found, SurfaceLocation):
        place = jnp.concatenate([found.at_a, found.at_b])
        return Contact3(finger, face, friction=friction), place
    contact = Contact(found.s[0], found.s[1], finger=finger, contour=face, friction=friction)
    return contact, jnp.zeros(1, found.s.dtype)


def _check_tangent(closed: Grasp, start: State, found: Location | SurfaceLocation) -> None:
    """Raise unless the last contact of a grasp, which was found there, closes: with a common tangent."""
    left = jax.tree.map(lambda x: x[-1:], residuals(closed, start))
    if float(worst(left)) <= closed_within(start.q.dtype):
        return
    new = closed.contacts[-1]
    tip, face = f"finger {new.finger}", f"face {new.touched} of the object"
    told = f"{tip} met {face} where they have no common tangent"
    if isinstance(found, Location) and (end := _end_near(closed.shapes(new), found)) is not None:
        name, s = end
        met = f"{tip} met the end of {face}" if name == "s_object" else f"the end of {tip} met {face}"
        told = f"{met} ({name} = {s:.4g} m): a corner is no contour"
    raise ValueError(f"argument run must end where a fingertip touches within a face, but {told}")


def _end_near(shapes: tuple[Any, Any], found: Location) -> tuple[str, float] | None:
    """The end of a contour that is nearest to closest points, and whose it is; None if none is near."""
    ends = []
    for name, shape, s in zip(("s_tip", "s_object"), shapes, found.s, strict=True):
        first, last = map(float, shape.domain())
        if not shape.closed:
            ends += [(abs(float(s) - end) / (last - first), name, end) for end in (first, last)]
    share, name, end = min(ends, default=(np.inf, "", 0.0))
    return (name, end) if share <= _NEAR_END else None


@eqx.filter_jit
def _earlier(grasp: Grasp, state: State, t: Scalar, back: Scalar) -> State:
    """The state so much earlier [s], by the same equations backwards in time."""
    field = held_field(grasp, None, ())
    y0 = vector_in(field, state)
    control = diffrax.PIDController(rtol=_BACK, atol=_BACK)
    ends = (t, t - back)
    found = diffrax.diffeqsolve(
        field.terms, field.projected(), *ends, -0.5 * back, y0, stepsize_controller=control
    )
    ys: Array = found.ys  # pyright: ignore[reportAssignmentType]
    return field.states(ys[-1])
