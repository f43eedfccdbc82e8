"""The printed form of a `Trajectory`, and the sentences that say why a run ended early.

Everything here works with NumPy on what the run holds: no program is compiled for a report. `simulate` raises
what `complaint` says; `_why` and the command line use parts of it.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._mechanics import Coordinate, Labels, QUATERNION
from .._printing import code_name, entry, lowered, so_many
from .._results import concrete, message

# What is said of the contact ("who") whose margin ran out; "by" is filled in from `_BY`.
_TOLD = {
    "contact_lost": "{who} no longer presses{when}{by}",
    "slipping": "{who} needs more friction than there is{when}{by}",
    "contour_end": "{who} ran past the end of an open contour{when}{by}",
    "singular_contact": "{who} became singular{when}: its curvatures cancel, to 1e-4 of their size{by}",
    "penetration": "{who} overlaps the object away from its contact{when}{by}",
    "joint_limit": "{who} passed the end of its range{when}{by}",
    "torque_limit": "{who} needs more torque than it has{when}{by}",
    "links_meet": "links of {who} meet the object or those of another finger{when}{by}",
    "not_rolling": "the gap of {who} changes as its place alone moves: it was held to other motions than its "
    "gap says",
}
# By how much the margin passed zero: by rounding at an event that was located, by more at a start beyond it.
_BY = {
    "contact_lost": ": it pulls with {:.3g} N",
    "slipping": ": its force is {:.3g} N outside the friction cone",
    "contour_end": ": by {:.3g} m",
    "singular_contact": "",
    "penetration": ": by {:.3g} m",
    "joint_limit": ": by {:.3g} {unit}",
    "torque_limit": ": by {:.3g} {unit}",
    "links_meet": ": by {:.3g} m",
    "not_rolling": "",
}
# Units of joints whose coordinates are angles, lengths, or not known to be either.
_JOINT_UNITS = {
    "joint_limit": {"rad": "rad", "m": "m", "": "rad or m"},
    "torque_limit": {"rad": "N m", "m": "N", "": "N m or N"},
}
# What is said instead where the margin is zero but for rounding: words in place of others.
_AT = {
    "slipping": (_BY["slipping"], ": its force is at the edge of the friction cone"),
    "contour_end": ("ran past the end", "ran to the end"),
}
# What the number in `stats.contact` counts, where that is no contact.
_COUNTED = {
    "joint_limit": "joint",
    "torque_limit": "joint",
    "penetration": "finger",
    "links_meet": "finger",
}
# How many roundings of 1 N or 1 m a located root leaves at most.
_ROUNDINGS = {"slipping": 1000.0, "contour_end": 100.0}
# What helps against each code, in terms of the arguments of `simulate`; other callers may give others.
REMEDIES = {
    "max_steps_reached": "a larger `max_steps` (each sample of a `Sampled` law ends a step), a larger "
    "`rtol`, or `solver=jaxroll.Rosenbrock()` where fast rates that have died out hold the steps short",
    "step_collapsed": "`jaxroll.why(grasp, run)` says which contact or which arm is nearly singular there; "
    "what single precision cannot pass, double may",
    "singular_contact": "shapes whose curvatures add up to more than zero (a hollow flatter than what rolls "
    "in it), joints away from a straight arm, or fewer contacts where two of one finger hold a motion twice",
    "contour_end": "a longer contour or a wider surface there, or an earlier `t1`",
    "contact_lost": "press harder there, or leave 'lift' out of `events` to let contacts pull",
    "slipping": "a larger `friction` of that contact, or leave 'friction' out of `events`",
    "penetration": "shapes that curve away from each other, or leave 'penetration' out of `events`",
    "joint_limit": "another start (`jaxroll.reach`), wider `limits` of the finger, or an earlier `t1`",
    "links_meet": "another start (`jaxroll.reach`), a smaller `link_radius` of the finger, or an "
    "earlier `t1`",
    "torque_limit": "a gentler controller, or larger `torque_limits` of the finger",
    "not_finite": "look at the last state: a number of the grasp, a time, or a function of your own is or "
    "gives NaN there",
    "unreachable": "`jaxroll.close(grasp, state)` first",
    "unordered_times": "`ts` that rises from `t0` to a later `t1`, and a `dt0` above zero: unknown before a "
    "compiled function runs, they are first looked at there",
    "inconsistent_shape": "a grasp made once with numbers that JAX does not trace: it is refused by a "
    "sentence that says what is wrong with the shape, and where",
    "not_rolling": "a `gap` and a `touch` between which points of both shapes meet without slipping, in all "
    "closed poses of these shapes",
    "unresolved": "more `cells` for that contour, or points with less noise",
    "solver_failed": "another `solver`, or none: the default",
}


def report(run: Any, remedies: Mapping[str, str] = REMEDIES) -> str:
    """What `print` shows of one run; `remedies` are what helps, in the caller's words."""
    lines = [f"Trajectory: {code_name(run.result)}"]
    if _code(run):
        lines += entry("ended", [cause(run)])
        lines += entry("remedy", [remedies.get(code_name(run.result), "none known")])
    saved = np.asarray(run.reached)
    stats, end = run.stats, f"ended at {float(run.stats.t_end):.6g} s"
    if saved.any():
        ts = np.asarray(run.ts)[saved]
        span = f"{ts[0]:g} to {ts[-1]:g}" if len(ts) > 1 else f"{ts[0]:g}"
        kept = f"{span} s, {saved.sum()} of {saved.size} states saved"
    else:
        kept = f"none of {saved.size} states saved, `last` is where it stopped"
    lines.append(f"  time      {kept}; {end}")
    lines.append(f"  steps     {int(stats.accepted)} accepted, {int(stats.rejected)} rejected")
    if saved.any():
        lines.append(_left(run.residuals))
    lines += [*_rolled(run, saved), *_motion(run, saved), *_forces(run, saved)]
    if run.energy is not None and saved.any():
        lines.append(f"  energy    {_balance(run, saved)}")
    return "\n".join(lines)


def batch_report(runs: Any) -> str:
    """What `print` shows of many runs: how many ended with each code, and where they are at the end."""
    codes, stats = np.asarray(runs.result._value), runs.stats
    steps = so_many(np.sum(stats.accepted), "accepted step")
    lines = [f"Trajectory of {so_many(codes.size, 'lane')}, {steps}"]
    names = {int(code): code_name(type(runs.result)(code, runs.result._enumeration)) for code in codes.flat}
    for code, name in sorted(names.items()):
        here = codes == code
        where = _where(runs, here, name) if code else ""
        lines.append(f"  {so_many(here.sum(), 'lane')}: {name}{where}")
    lines += _at_the_end(runs.labels, np.asarray(runs.last.q), "at end")
    return "\n".join(lines)


def cause(run: Any) -> str:
    """Why one run ended early: which contact, when, by how much; one sentence without its full stop."""
    name, stats = code_name(run.result), run.stats
    t, contact, margin = float(stats.t_end), int(stats.contact), float(stats.margin)
    when = f" at t = {t:.6g} s"
    if name == "max_steps_reached":
        # The first step has no length (`_step_size.StopAt`), and is not among those that are limited.
        return f"the step limit was reached{when}, after {so_many(stats.steps - 1, 'step')}"
    if name in ("unreachable", "inconsistent_shape"):  # of the start or the shapes, whatever was run
        return lowered(message(run.result))
    if name not in _TOLD or (contact < 0 and name == "singular_contact"):
        return f"{lowered(message(run.result))}{when}"
    who = "a contact" if contact < 0 else contact_name(run.labels, contact)
    if _COUNTED.get(name) == "finger":  # an audit looks at fingers, whether they have a contact or not
        who = f"finger {contact}"
    unit = ""
    if _COUNTED.get(name) == "joint":
        who, of = _joint(run.labels, contact)
        unit = _JOINT_UNITS[name].get(of, _JOINT_UNITS[name][""])
    told, by = _TOLD[name], _BY[name] if np.isfinite(margin) else ""
    if abs(margin) <= _ROUNDINGS.get(name, 0.0) * np.finfo(np.asarray(stats.margin).dtype).eps:
        past, at = _AT[name]
        told, by = told.replace(past, at), at if by == past else ""
    if _in_space(run.labels):
        told = told.replace("end of an open contour", "edge of an open surface")
    return told.format(who=who, when=when, by=by.format(0.0 - margin, unit=unit))


def complaint(run: Any, remedies: Mapping[str, str] = REMEDIES) -> str:
    """The sentence of an error about a run that ended early: cause and remedy."""
    told, remedy = cause(run), remedies.get(code_name(run.result))
    return f"{told[0].upper()}{told[1:]}" + (f"; what helps: {remedy}" if remedy else "")


def _in_space(labels: Labels | None) -> bool:
    """Whether these are names of a grasp in space: something in it turns by a quaternion."""
    return labels is not None and any(part.name in QUATERNION for _, parts in labels.bodies for part in parts)


def contact_name(labels: Labels | None, contact: int) -> str:
    """What a contact is called."""
    if labels is None or contact >= len(labels.contacts):
        return f"contact {contact}"
    return labels.contacts[contact]


def joint_name(labels: Labels | None, joint: int) -> str:
    """What a joint is called, counted over all fingers."""
    return _joint(labels, joint).name


def _joint(labels: Labels | None, joint: int) -> Coordinate:
    """Name, its finger's before it, and unit of a joint, counted over all fingers; '' where none is known."""
    bodies = () if labels is None else labels.bodies[1:]
    # A stage's clock is a position, but no joint.
    joints = [
        Coordinate(f"{body} {part.name}", part.unit)
        for body, parts in bodies
        for part in parts
        if part.unit != "s"
    ]
    return joints[joint] if 0 <= joint < len(joints) else Coordinate(f"joint {joint}", "")


def amount(value: float, unit: str, *, signed: bool = False) -> str:
    """A coordinate's value: lengths in millimetres, to a micrometre; angles to 1e-4 rad."""
    scale, digits, shown_unit = (1e3, 3, "mm") if unit == "m" else (1.0, 4, unit)
    number = f"{round(scale * value, digits) + 0.0:{'+' if signed else ''}.{digits}f}"
    return f"{number} {shown_unit}".rstrip()


def _code(run: Any) -> int:
    return int(concrete(run.result._value))  # pyright: ignore[reportArgumentType]


def peak(*arrays: Any) -> float:
    """Largest absolute value in some arrays, NaN aside: rows that a run did not reach hold NaN."""
    return max(float(np.nanmax(np.abs(np.asarray(a)), initial=0.0)) for a in arrays)


def _left(left: Any) -> str:
    gap, tangency = peak(left.normal, left.tangential), peak(left.tangency)
    return f"  residuals gap {gap:.1e} m, tangency {tangency:.1e} rad"


def _balance(run: Any, saved: np.ndarray) -> str:
    """By how much the energy is off, of a run that saved more than its start."""
    off, stats = peak(run.energy.residual), run.stats
    scale = np.nanmax(np.abs(np.asarray(run.energy.kinetic) + np.asarray(run.energy.potential)))
    # The balance counts from the start, where it is zero but for rounding, of positions too, which a run
    # brings back to the constraints at once: alone it says nothing.
    rounding = 64.0 * np.finfo(np.asarray(run.energy.residual).dtype).eps * scale
    if saved.sum() == 1 and off <= rounding and not np.asarray(run.energy.work)[saved].any():
        there = float(np.asarray(run.ts)[saved][0])
        if float(stats.t_end) > there or int(stats.accepted) <= 1:
            return "balance not known: the start alone was saved"
    # Where there is hardly any energy, its rounding is no share of it.
    told = f"{off / scale:.1e} of its size" if off <= scale > 0 else f"{off:.1e} J"
    return f"balance within {told}"


def _rolled(run: Any, saved: np.ndarray) -> list[str]:
    """In the plane: the range of each contact's rolling coordinate over the saved states."""
    if run.residuals.tangential.ndim > run.residuals.normal.ndim or saved.sum() < 2:
        return []
    travel = 1e3 * np.ptp(np.asarray(run.states.s)[saved], axis=0)
    # Places of a caller's own contacts have units that only the caller knows, and may be none.
    places = getattr(run.labels, "places", ())
    if len(places) == len(travel):
        travel = travel[[place.unit == "m" for place in places]]
    if not len(travel):
        return []
    return [f"  rolled    {', '.join(f'{x:.3f}' for x in travel)} mm{_since(run, saved)}"]


def _since(run: Any, saved: np.ndarray) -> str:
    """From when on motion is counted, which is the first saved time, if that is not zero."""
    first = float(np.asarray(run.ts)[saved][0])
    return f" since {first:g} s" if first else ""


def _motion(run: Any, saved: np.ndarray) -> list[str]:
    """How every body moved from the first saved state to the end; with one state, where it is."""
    end = np.asarray(run.last.q)
    labels = _labels(run.labels, end.shape[-1])
    if saved.sum() < 2:
        return _at_the_end(labels, end[None], "at end" if saved.any() or run.stats.t_end > 0 else "start")
    since = _since(run, saved)
    start, lines, at = np.asarray(run.states.q)[saved][0], [f"{since.strip()}:"] if since else [], 0
    for body, coordinates in labels.bodies:
        here = slice(at, at := at + len(coordinates))
        if coordinates:
            lines.append(f"{body}: {_moved(coordinates, start[here], end[here])}")
    return entry("moved", lines)


def _moved(coordinates: Sequence[Coordinate], start: np.ndarray, end: np.ndarray) -> str:
    """Changes, grouped by unit; four numbers of an orientation as the angle between both."""
    groups: list[list[str]] = []
    last, turn = None, [i for i, each in enumerate(coordinates) if each.name in QUATERNION]
    for i, each in enumerate(coordinates):
        if len(turn) == 4 and i in turn:
            continue
        text = f"{each.name} {amount(end[i] - start[i], each.unit, signed=True)}"
        if last == each.unit:
            groups[-1] = [*(part.removesuffix(_suffix(each.unit)) for part in groups[-1]), text]
        else:
            groups.append([text])
        last = each.unit
    parts = [part for group in groups for part in group]
    if len(turn) == 4:
        parts.append(f"turned by {_angle(start[turn], end[turn]):.4f} rad")
    return ", ".join(parts)


def _suffix(unit: str) -> str:
    return f" {'mm' if unit == 'm' else unit}"


def _angle(start: np.ndarray, end: np.ndarray) -> float:
    """Angle [rad] between two orientations, given as quaternions."""
    # The vector part of the quaternion from one to the other has the size |sin(a/2)|; the absolute value
    # makes q and -q the same orientation.
    start, end = start / np.linalg.norm(start), end / np.linalg.norm(end)
    vector = start[0] * end[1:] - end[0] * start[1:] - np.cross(end[1:], start[1:])
    return float(2.0 * np.arctan2(np.linalg.norm(vector), abs(start @ end)))


def _at_the_end(labels: Labels | None, q: np.ndarray, title: str) -> list[str]:
    """Where every body is: for each coordinate its range over all lanes."""
    rows = q.reshape(-1, q.shape[-1])
    rows = rows[np.isfinite(rows).all(axis=-1)]
    if not len(rows):
        return []
    lines, at = [], 0
    for body, coordinates in _labels(labels, q.shape[-1]).bodies:
        parts = []
        for i, each in enumerate(coordinates, at):
            low, high = (amount(f(rows[:, i]), each.unit) for f in (np.min, np.max))
            whole = low if low == high else f"{low.removesuffix(_suffix(each.unit))} to {high}"
            parts.append(f"{each.name} {whole}")
        at += len(coordinates)
        lines += [f"{body}: {', '.join(parts)}"] if parts else []
    return entry(title, lines)


def _labels(labels: Labels | None, positions: int) -> Labels:
    """The labels of a run; if it was made by hand without fitting ones, the coordinates by number."""
    if labels is not None and sum(len(each) for _, each in labels.bodies) == positions:
        return labels
    return Labels((("state", tuple(Coordinate(f"q[{i}]", "") for i in range(positions))),), ())


def _forces(run: Any, saved: np.ndarray) -> list[str]:
    """Contact forces and the friction that rolling needs, where they were recorded."""
    if run.multipliers is None:
        return ["  forces    not recorded (nor the friction they need): record=('multipliers',)"]
    f, lam = np.asarray(run.multipliers.f), np.asarray(run.multipliers.lam)
    lam = np.linalg.norm(lam, axis=-1) if lam.ndim > f.ndim else lam
    if not saved.any():
        return []
    # Rounding beside the largest normal force is told as zero: the report is the same on all machines.
    least = 1e-12 * np.nanmax(np.abs(f))
    ranges = [[0.0 if abs(x) <= least else x for x in (np.nanmin(y), np.nanmax(y))] for y in (f, lam)]
    (low, high), (aside, most) = ranges
    lines = [f"  forces    normal {low:.4g} to {high:.4g} N, tangential {aside:.4g} to {most:.4g} N"]
    if run.multipliers.spin is not None:
        lines.append(f"  spin      prevented by up to {np.nanmax(np.abs(run.multipliers.spin)):.4g} N m")
    return [*lines, f"  friction  {_demand(run, f, np.abs(lam))}"]


def _demand(run: Any, f: np.ndarray, aside: np.ndarray) -> str:
    """Largest coefficient of friction |lambda| / f that rolling needs, at which contact and when.

    For a contact that pulls, f <= 0, no coefficient would do: the first of these is reported instead.
    Contacts that hold both ways need none.
    """
    presses = run.labels.presses if run.labels is not None else ()
    seen = np.isfinite(f) & np.isfinite(aside) & np.array(presses or (True,))
    if not seen.any():
        return "none needed: no contact can only press"
    seen &= (f != 0.0) | (aside != 0.0)  # where there is no force at all, nothing is asked of friction
    if not seen.any():
        return "none needed: no contact bears a force"
    pulls = seen & ~(f > 0.0)
    need = np.where(seen & ~pulls, aside, -np.inf) / np.where(pulls | ~seen, 1.0, f)
    if pulls.any():
        row, contact = np.unravel_index(np.argmax(pulls), f.shape)
        first = float(np.asarray(run.ts)[row])
        return f"! {contact_name(run.labels, int(contact))} pulls at t = {first:.4g} s: no friction would do"
    # The first of those equal up to rounding, so that the report does not depend on the machine.
    row, contact = np.unravel_index(np.argmax(need >= need.max() * (1.0 - 1e-9)), need.shape)
    most, t = float(need[row, contact]), float(np.asarray(run.ts)[row])
    warning = "; ! above 1: few materials give that" if most > 1.0 else ""
    return f"demand up to {most:.4g}, of contact {contact} at t = {t:.4g} s{warning}"


def _where(runs: Any, here: np.ndarray, name: str) -> str:
    """Of the lanes with one code: when they ended, and at which contacts, fingers or joints."""
    ends, contacts = np.asarray(runs.stats.t_end)[here], np.asarray(runs.stats.contact)[here]
    low, high = (f"{f(ends):.4g}" for f in (np.min, np.max))
    span = f" at t = {low} s" if low == high else f" at t = {low} to {high} s"
    what = _COUNTED.get(name, "contact")
    known = [f"{what} {c}: {int(np.sum(contacts == c))}" for c in np.unique(contacts) if c >= 0]
    return span + (f" ({', '.join(known)})" if known else "")
