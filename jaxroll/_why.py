"""`why`: one page on why a grasp fails, or that it holds.

The questions come in the order in which one failure hides the next: without closed contacts there is no
start; without positive margins at the start there is no run; without a run there is no end; and only of a
grasp that holds an equilibrium is of use. `close` answers the first, `bearing` has margins and forces at the
start and the end, `simulate` makes the run, `stability.assess` finds the equilibrium. The first failure found
makes the summary and the remedy; all numbers that were computed on the way are printed.
"""

import textwrap
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from ._analysis import Bearing, bearing
from ._closing import close
from ._integration import (
    amount,
    cause,
    check_choices,
    check_one_run,
    contact_name,
    FLAT,
    ProgressMeter,
    RECORDS,
    REMEDIES,
    RTOL,
    RunOptions,
    simulate,
    SINGULAR,
    Solver,
    StepSizeControl,
    Trajectory,
)
from ._mechanics import check_grasp, check_states, Grasp, State
from ._motion import closed_within, Formulation, residuals, worst
from ._printing import code_name, entry, lowered
from ._results import check_instance, on_host
from ._types import ByPrecision, Given, Scalar
from .contact import Contact
from .control import Sampled
from .stability import assess, Equilibrium, Stability, VERDICTS

# If no coordinate of a run changed by more than this [m or rad], no direction is given.
_STILL = 1e-9
# A contact whose forces are smaller than this [N] bears none: where nothing presses, rounding leaves some.
_NO_FORCE = 2e-13
# Share of the largest force that the rounding of its root leaves where a contact lifts.
_AT_ROOT = ByPrecision(1e-9, 1e-4)
# Coordinates that change by less than this share of the largest change are left out of a direction.
_SLIGHT = 0.02
# What helps where the failure is not the end of a run: `REMEDIES` has the others, by the code of the run.
_MEND = {
    "open": "a guess nearer to contact, or `close` with `hold_contacts=False` or `locate=True`, which let "
    "the contacts move",
    "pulls": "a push that presses there (force or beta of the controller, gravity), or contacts elsewhere",
    "slips": "a larger `friction` of that contact, or contacts where the push is nearer to the normal",
    "unstable": "fingertips that are blunter there: `stability.margin` is the chapter's measure, and "
    "`design.optimise_fingertip` finds them",
    "not_found": "another start, or a controller whose forces balance somewhere near it",
    "sampled": "a shorter `period` of `Sampled`: the same law, asked all the time, holds it",
    "heavy": "a stronger push against the weight: without `gravity` the same grasp holds",
    "driven": "a controller with a potential, that takes energy out of every motion (`damping` above zero)",
}
# Ends of a run that say nothing of where the grasp goes: failures to integrate, and the end asked for.
_STEPS = ("max_steps_reached", "step_collapsed", "not_finite", "solver_failed")
_FAILED = (*_STEPS, "unordered_times", "inconsistent_shape", "not_rolling")
_NOWHERE = ("successful", *_FAILED)


@dataclass(frozen=True)
class Why:
    """Why a grasp fails. Printed, it is one page.

    Attributes:
        summary: What comes first, in one sentence; 'holds' where nothing was found.
        closed: Whether the contacts close.
        gap: Largest residual of `state` [m or rad].
        state: The start of the run, on the constraints; the guess where its contacts do not close.
        start: How the grasp bears there: curvatures, pivot, forces; None where it does not close.
        run: The run from there; None where there was nothing to run.
        end: How it bears where the run ended.
        contact: Which contact failed; -1 where none did.
        ended: Which contact ended the run, when and by how much; empty if it reached its end.
        stability: Equilibrium and verdict; None unless all contacts are `Contact`s and a direction is free.
        direction: In which direction it falls, by coordinate; empty where none does.
        remedy: What helps, in the words of this package's arguments; empty where nothing is needed.
        grasp: The grasp.
    """

    summary: str
    closed: bool
    gap: float
    state: State
    start: Bearing | None
    run: Trajectory | None
    end: Bearing | None
    contact: int
    ended: str
    stability: Stability | None
    direction: str
    remedy: str
    grasp: Grasp

    def __repr__(self) -> str:
        return f"Why({self.summary})"

    def __str__(self) -> str:
        first, *more = textwrap.wrap(f"Why: {self.summary}", 100, subsequent_indent="     ")
        lines = [first, *more, *entry("closed", [self._closing()])]
        if self.start is not None:
            lines += entry("singular", [_singular(self.grasp, self.start)])
            lines += entry("start", _forces(self.grasp, self.start))
        if self.run is not None:
            lines += entry("run", [self.ended or f"to t = {float(self.run.stats.t_end):.6g} s"])
            lines += entry("its end", _forces(self.grasp, self.end) if self.end is not None else [])
        lines += entry("rest", self._rest())
        lines += entry("falls", [self.direction] if self.direction else [])
        lines += entry("remedy", [self.remedy] if self.remedy else [])
        return "\n".join(lines)

    def _closing(self) -> str:
        """The line on whether the contacts close."""
        unit = f"worst row {self.gap:.1e} m or rad"
        return f"yes, {unit}" if self.closed else f"no, {unit} at the guess"

    def _rest(self) -> list[str]:
        """The lines on the equilibrium: its verdict, and the forces at each contact there."""
        found = self.stability
        if found is None:
            none = "not assessed: verdicts are of contacts of class Contact, in the plane"
            told = "no direction is free to move" if _contours_roll(self.grasp) else none
            return [told] if self.closed else []
        verdict = f"{code_name(found.verdict)}: {VERDICTS[found.verdict]}"
        if not bool(found.equilibrium.found):
            return [verdict]
        return [verdict, *_forces(self.grasp, found.equilibrium)]


@on_host
def why(
    grasp: Grasp,
    state: State | Trajectory,
    *,
    t1: Given = 1.0,
    t0: Given = 0.0,
    ts: Given | int = 301,
    formulation: Formulation | None = None,
    solver: Solver | None = None,
    rtol: Given = RTOL,
    atol: Given | None = None,
    dt0: Given = 1e-4,
    max_steps: int = 4096,
    events: Collection[str] = ("lift", "friction"),
    stepsize_controller: StepSizeControl | None = None,
    progress_meter: ProgressMeter | None = None,
    record: Collection[str] = (),
) -> Why:
    r"""Say why a grasp fails: close, run, assess, and one page.

    Answers, in this order: do the contacts close; is one of them, or an arm, singular; which forces press and
    which friction they need; what ends a run, where, when and by how much; in the plane, whether there is an
    equilibrium near, what its verdict is and which direction falls; and what helps.

    Args (daily use):
        grasp: The grasp.
        state: A state, or a guess of one; or a run of this grasp: then no other run is made, and the
            arguments below are checked, but not used.
        t1: Final time of the run that is made [s].
    Args (rarely changed):
        t0, ts, formulation, solver, rtol, atol, dt0, max_steps, events, stepsize_controller, progress_meter,
            record: As for `simulate`, and with its defaults. If they are those of your own run, nothing is
            compiled anew for this one.

    Returns:
        A `Why`; print it.

    Raises:
        ValueError: If a state does not fit the grasp, a run is a batch, an argument is not what `simulate`
            takes, or anything is being traced.

    Example:
        >>> import jaxroll as jxr
        >>> grasp, state = jxr.scenes.pivoted()
        >>> jxr.why(grasp.with_(force=-0.5), state).summary  # a finger that pulls
        'fails at the start: contact 0 (finger 0 on contour 0) pulls with 1.55 N'
    """
    # Checked before anything else: of a grasp that does not close there is no run.
    options = RunOptions(
        t0=t0,
        formulation=formulation,
        solver=solver,
        rtol=rtol,
        atol=atol,
        dt0=dt0,
        max_steps=max_steps,
        events=events,
        stepsize_controller=stepsize_controller,
        progress_meter=progress_meter,
        record=check_choices("record", record, RECORDS),
    ).checked(t1, ts)
    check_grasp(grasp)
    check_instance("state", state, (State, Trajectory), "a State, or a run of the grasp")
    run = state if isinstance(state, Trajectory) else None
    begin, begins = _start(state) if isinstance(state, Trajectory) else (state, options.t0)
    check_states(grasp, begin)
    gap = float(worst(residuals(grasp, begin)))
    # A state that is on the constraints is taken as it is: closing it again would move it by rounding.
    closed = begin if gap <= closed_within(begin.q.dtype) else _closed(grasp, begin)
    if isinstance(closed, str):
        told = f"the contacts do not close: {closed}"
        none = {"start": None, "run": None, "end": None, "stability": None}
        rest = {"contact": -1, "ended": "", "direction": "", "remedy": _MEND["open"]}
        return Why(told, False, gap, begin, grasp=grasp, **none, **rest)
    if run is None:
        run = simulate(grasp, closed, t1, ts=ts, throw=False, **options._asdict())
    return _judged(grasp, closed, begins, run)


def _start(run: Trajectory) -> tuple[State, Scalar]:
    """The first state that a run saved, and its time [s]; its last ones where none was saved."""
    check_one_run("state", run)
    # Rows of times that the run did not reach are NaN.
    saved = np.asarray(run.reached)
    if not saved.any():
        return run.last, run.stats.t_end
    first = int(np.argmax(saved))
    return jax.tree.map(lambda x: x[first], run.states), run.ts[first]


def _closed(grasp: Grasp, guess: State) -> State | str:
    """The closed state near a guess; where there is none, what `close` says about it, as text."""
    try:
        return close(grasp, guess)[1]
    except ValueError as error:
        return str(error).partition("but ")[2] or str(error)


def _judged(grasp: Grasp, state: State, t0: Scalar, run: Trajectory) -> Why:
    """The report on a grasp whose contacts close, from a start, its time [s] and the run from there.

    A failure at the start comes before one of the run, and that before an equilibrium that would not hold.
    """
    # Not a number of Python, of JAX's weak type: what follows would be compiled once more for the run's end.
    t0, t = np.asarray(t0, run.last.q.dtype), run.stats.t_end
    start = bearing(grasp, t0, state)
    end = bearing(grasp, t, run.last) if np.isfinite(run.last.q).all() else None
    failed = (code := code_name(run.result)) != "successful"
    # An equilibrium is sought from where the run came to its end; a run that failed may have ended anywhere.
    near, when = (state, t0) if failed else (run.last, t)
    found = _assessed(grasp, near, when)
    contact = _culprit(grasp, run, end)
    ended = _ending(grasp, run, contact) if failed else ""
    direction = _direction(grasp, found, state, run)
    # The first of these findings that applies is the summary; the others are on the page below it.
    early = _early(grasp, start, int(run.stats.contact))
    verdict = "" if found is None else code_name(found.verdict)
    if early is not None:
        summary, remedy, contact = early
    elif failed:
        summary, remedy = f"fails: {ended}", REMEDIES.get(code, "")
        if found is not None and verdict == "unstable":
            summary = f"{summary}; its equilibrium is unstable"
            remedy = f"{_MEND[_blamed(grasp, found, near, when)]}; against the end alone, {remedy}"
    elif found is not None and verdict in _MEND:
        summary = f"holds until t = {float(t):.4g} s, but {lowered(VERDICTS[found.verdict])}"
        remedy = _MEND[_blamed(grasp, found, near, when)]
    else:
        summary, remedy = "holds", ""
    return Why(
        summary=summary,
        closed=True,
        gap=float(worst(residuals(grasp, state))),
        state=state,
        start=start,
        run=run,
        end=end,
        contact=contact,
        ended=ended,
        stability=found,
        direction=direction,
        remedy=remedy,
        grasp=grasp,
    )


def _assessed(grasp: Grasp, state: State, t: Scalar) -> Stability | None:
    """Equilibrium and verdict; None where no contour rolls, or the contacts leave no coordinate free."""
    free = grasp.coordinates - sum(contact.rows for contact in grasp.contacts)
    return assess(grasp, state, t=t) if _contours_roll(grasp) and free > 0 else None


def _blamed(grasp: Grasp, found: Stability, near: State, t: Scalar) -> str:
    """The key of the remedy in `_MEND`: the part without which the grasp would hold, or else the verdict."""
    law = grasp.controller
    if isinstance(law, Sampled) and _holds(grasp.with_(controller=law.law), near, t):
        return "sampled"
    if grasp.gravity is not None and _holds(grasp.with_(gravity=None), near, t):
        return "heavy"
    verdict = code_name(found.verdict)
    # Where the potential bends down nowhere, what grows is driven by rates or by forces without potential.
    return "driven" if verdict == "unstable" and not found.bends_down else verdict


def _holds(grasp: Grasp, near: State, t: Scalar) -> bool:
    """Whether a grasp has an equilibrium near a state, and none of its disturbances grows."""
    found = _assessed(grasp, State(near.q, near.v, near.s), t)
    return found is not None and code_name(found.verdict) not in ("unstable", "not_found")


def _contours_roll(grasp: Grasp) -> bool:
    """Whether all contacts are between contours: only there is an equilibrium assessed."""
    return all(isinstance(contact, Contact) for contact in grasp.contacts)


def _early(grasp: Grasp, start: Bearing, ended: int) -> tuple[str, str, int] | None:
    """What is wrong at the start already: the sentence, what helps, and which contact; None if nothing is.

    In this order, because forces mean nothing at a singular state, nor friction at a contact that pulls.
    Comparisons with zero are written so that NaN counts as a failure. A contact without force does not pull.
    Of contacts that fail by the same to rounding, the one at which the run `ended` is named.
    """
    curvature = np.asarray(start.curvature)
    if not np.all(curvature > FLAT):
        at = int(np.argmin(curvature))
        told = f"is singular, the sum of its curvatures is not positive to {FLAT:g}"
        told = f"fails at the start: {contact_name(grasp.labels, at)} {told}"
        return told, REMEDIES["singular_contact"], at
    if not float(start.pivot) > SINGULAR:
        told = (
            "fails at the start: contacts are redundant or an arm is straight, so that forces have no answer"
        )
        return told, REMEDIES["singular_contact"], -1
    pairs, f = _pairs(start.multipliers), _pressing(grasp, start)
    if not all(pressing > 0.0 or pair == (0.0, 0.0) for pressing, pair in zip(f, pairs, strict=True)):
        lost = np.isnan(f)
        at = int(np.argmax(lost)) if lost.any() else _least(f, ended)
        does = f"pulls with {-f[at]:.3g} N" if f[at] else "presses with nothing"
        does = "bears a force that is no number" if lost[at] else does
        what = REMEDIES["not_finite"] if lost[at] else _MEND["pulls"]
        return f"fails at the start: {contact_name(grasp.labels, at)} {does}", what, at
    limits = [_friction(grasp, i) for i in range(len(grasp.contacts))]
    room = [
        np.inf if limit is None else limit * pressing - aside
        for limit, (pressing, aside) in zip(limits, pairs, strict=True)
    ]
    if min(room) < 0.0:
        at = _least(np.array(room), ended)
        name, (pressing, aside) = contact_name(grasp.labels, at), pairs[at]
        need = aside / pressing if pressing else np.inf
        told = f"fails at the start: {name} needs friction {need:.3g}, but has {limits[at]:.3g}"
        return told, _MEND["slips"], at
    return None


def _least(values: np.ndarray, preferred: int) -> int:
    """Where the least of some values is; the preferred place if its value is the same but for rounding."""
    least = int(np.argmin(values))
    alike = preferred >= 0 and values[preferred] <= values[least] + 1e-9 * abs(values[least])
    return preferred if alike else least


def _pressing(grasp: Grasp, at: Bearing) -> np.ndarray:
    """Normal force of each contact [N]; infinite for one that holds both ways, which cannot be lost."""
    each = zip(grasp.contacts, _pairs(at.multipliers), strict=True)
    return np.array([pressing if contact.presses else np.inf for contact, (pressing, _) in each])


def _culprit(grasp: Grasp, run: Trajectory, end: Bearing | None) -> int:
    """Number of the contact that ended a run, -1 if none did.

    A run that ends at an event says which; otherwise it is the contact with the least margin at the end.
    """
    contact, code = int(run.stats.contact), code_name(run.result)
    if contact >= 0 or end is None:
        return contact
    if code == "contact_lost":
        return int(np.argmin(_pressing(grasp, end)))
    if code == "contour_end":
        return int(np.argmin(end.ends))
    # The code stands for two margins; the smaller one ended the run, and only curvature belongs to a contact.
    if code == "singular_contact" and not np.min(end.curvature) > float(end.pivot):
        return int(np.argmin(end.curvature))
    if code == "slipping":
        limits = [_friction(grasp, i) for i in range(len(grasp.contacts))]
        over = [
            -np.inf if limit is None else aside - limit * pressing
            for limit, (pressing, aside) in zip(limits, _pairs(end.multipliers), strict=True)
        ]
        return int(np.argmax(over))
    return -1


def _ending(grasp: Grasp, run: Trajectory, contact: int) -> str:
    """Sentence on the end of a run, with the contact's name in it where the run did not know the contact."""
    told = cause(run)
    if int(run.stats.contact) < 0 <= contact:
        told = told.replace("a contact", contact_name(grasp.labels, contact), 1)
    return told


def _friction(grasp: Grasp, contact: int) -> float | None:
    """Coefficient of friction of a contact; None where it has no limit."""
    limit = grasp.contacts[contact].friction
    return None if limit is None else float(limit)


def _pairs(forces: Any) -> list[tuple[float, float]]:
    """Normal force and magnitude of the tangential force of each contact [N].

    In the plane the tangential force of a contact is one number, in space a vector. A normal force that is
    rounding beside the largest force is zero.
    """
    f, lam = np.asarray(forces.f), np.asarray(forces.lam)
    aside = np.linalg.norm(lam, axis=-1) if lam.ndim > f.ndim else np.abs(lam)
    largest = np.max(np.abs([f, aside]), initial=0.0, where=np.isfinite([f, aside]))
    f = np.where(np.abs(f) <= _AT_ROOT.of(f) * largest, 0.0, f)
    return [(float(a), float(b)) for a, b in zip(f, aside, strict=True)]


def _singular(grasp: Grasp, at: Bearing) -> str:
    """The line on whether a contact or an arm is singular."""
    curvature, pivot = np.asarray(at.curvature), float(at.pivot)
    least = int(np.argmin(curvature))
    fine = curvature[least] > FLAT and pivot > SINGULAR
    told = f"curvatures add up to {curvature[least]:.3g} of their size (contact {least}, the least)"
    return f"{'no' if fine else 'yes'}, {told}; smallest pivot {pivot:.3g}"


def _forces(grasp: Grasp, at: Bearing | Equilibrium) -> list[str]:
    """A line on the force at each contact."""
    return [_force(grasp, i, *pair) for i, pair in enumerate(_pairs(at.multipliers))]


def _force(grasp: Grasp, contact: int, pressing: float, aside: float) -> str:
    """The line on one contact, from its normal and its tangential force [N]."""
    name, limit = contact_name(grasp.labels, contact), _friction(grasp, contact)
    has = "no limit was given" if limit is None else f"it has {limit:.3g}"
    if not grasp.contacts[contact].presses:
        return f"{name} holds both ways, with {pressing:z.4g} N and {aside:.4g} N beside"
    if np.isnan(pressing) or max(abs(pressing), aside) < _NO_FORCE:
        return f"{name} bears {'a force that is no number' if np.isnan(pressing) else 'no force'}"
    if not pressing > 0.0:
        does = f"pulls with {-pressing:.4g} N" if pressing else f"presses with nothing, {aside:.4g} N beside"
        return f"{name} {does}: no friction would do"
    return f"{name} presses with {pressing:.4g} N and needs friction {round(aside / pressing, 9):.4g}; {has}"


def _direction(grasp: Grasp, found: Stability | None, start: State, run: Trajectory) -> str:
    """The direction in which a grasp fails, in words; empty where it does not.

    At an unstable equilibrium this is the mode in which the potential falls most, or the rate at which an
    oscillation grows; otherwise it is how far the coordinates moved in a run that a limit ended.
    """
    if found is not None and code_name(found.verdict) == "unstable":
        told = _named(grasp, _scaled(grasp, np.asarray(found.modes)[:, 0]))
        return f"along {told}, where the potential bends down" if found.bends_down else _growing(found)
    way = np.asarray(run.last.q) - np.asarray(start.q)
    if code_name(run.result) in _NOWHERE or not np.isfinite(way).all() or np.abs(way).max() < _STILL:
        return ""
    return f"it had moved by {_named(grasp, way)}"


def _growing(found: Stability) -> str:
    """Growth and frequency of the fastest growing mode; rates come by rising real part."""
    rate = np.asarray(found.rates)[-1]
    return f"along a swing that grows at {float(rate.real):.3g} 1/s, {abs(float(rate.imag)):.3g} rad/s"


def _scales(grasp: Grasp) -> np.ndarray:
    """What makes coordinates comparable: one radian, and the mean length of a link in metres."""
    size = float(np.mean([float(f.size) for f in grasp.fingers]))
    units = [each.unit for _, labels in grasp.labels.bodies for each in labels]
    return np.array([size if unit == "m" else 1.0 for unit in units])


def _scaled(grasp: Grasp, way: np.ndarray) -> np.ndarray:
    """A direction so long that its largest part is one radian, or the mean length of a link."""
    scales = _scales(grasp)
    largest = np.argmax(np.abs(way / scales))
    return way / (way[largest] / scales[largest])


def _named(grasp: Grasp, way: np.ndarray) -> str:
    """Changes in words, coordinate by coordinate, body by body, without those that are slight beside others.

    `way` has one number per coordinate of the grasp's state.
    """
    parts, at = [], 0
    sizes = np.abs(way / _scales(grasp))
    large = sizes > _SLIGHT * sizes.max()
    for body, labels in grasp.labels.bodies:
        seen = [(each, way[i]) for i, each in enumerate(labels, at) if large[i]]
        at += len(labels)
        told = ", ".join(f"{each.name} {amount(float(x), each.unit, signed=True)}" for each, x in seen)
        parts += [f"{body}: {told}"] if told else []
    return "; ".join(parts)
