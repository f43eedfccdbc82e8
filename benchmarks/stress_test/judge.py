"""The judge of the stress test: is what a lane returned true, and its code the cause? NumPy alone.

It gets a scene as plain numbers, arrays of four runs of it (as asked for; with many saved times; at a tenth
of the tolerance; from a start moved by 1e-10), and names of codes. Nothing here imports the engine.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from benchmarks.stress_test.judge_plane import Instant, Motion

# Limits of the verdicts; what each is relative to stands where it is used.
GAP, TANGENCY, CREEP, FORCE = 1e-11, 1e-8, 1e-7, 1e-6
ENERGY, DEFECT, AGREEMENT = 10.0, 1e3, 10.0
_ZERO, _SINGULAR, _NEARLY = 1e-6, 1e-6, 1e-3
# Relative sum of curvatures at which a run says that a contact is singular, and what rounding adds.
_FLAT = 1e-4 + 1e-7
# What a start may be off by [m, rad].
REACH = 1e-9
_DENSE = 513
# How well the time is known at which a sum of curvatures runs out [s]: `_FLAT` falls that long before it.
_POLE = 1e-9
# How often a step beside a pole is quartered.
_QUARTERS = 12
# Part of their time by which ends of runs beside a pole may differ.
_LAYER = 1e-3
# Part of its time by which a motion that is not chaotic does not move an end from run to run.
_CHAOTIC = 1e-3
# Rounding of a length in double precision [m].
_ROUNDED = 1e-16
# Shortest steps of a search for an event, in roundings of the time.
_SEARCHED = 2 * 64 * 8
# Steps of the judge's own beyond an end.
_AHEAD = 60
_TABLED = ("support", "neural_support", "spline", "neural_curvature")
# What each code says has run out.
_LIMITS = {"contact_lost": "force", "slipping": "cone", "contour_end": "room", "joint_limit": "range"}


@dataclass
class Run:
    """One run of every lane: saved motion (lanes, times, ...), last state, code's name, end, steps attempted.

    `last` is a motion of one time. `f` and `lam` are the recorded forces, if any.
    """

    ts: np.ndarray
    saved: Motion
    last: Motion
    code: np.ndarray
    t_end: np.ndarray
    steps: np.ndarray
    f: np.ndarray | None = None
    lam: np.ndarray | None = None


@dataclass
class Verdicts:
    """Per lane: measures, and what is wrong in words; an empty list where nothing is."""

    code: np.ndarray
    measures: dict[str, np.ndarray]
    wrong: list[list[str]] = field(default_factory=list)


def quadrature(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """At nodes -cos(pi k/n): coefficients of values, running integrals of values, values on a dense grid."""
    x = -np.cos(np.pi * np.arange(count) / (count - 1))
    spectrum = np.linalg.inv(chebyshev.chebvander(x, count - 1))
    running = chebyshev.chebvander(x, count) @ chebyshev.chebint(spectrum, axis=0)
    dense = chebyshev.chebvander(-np.cos(np.pi * np.linspace(0, 1, _DENSE)), count - 1) @ spectrum
    return spectrum, running - running[0], dense


@dataclass(frozen=True)
class _Slack:
    """Factors on the limits of constraint rows, and of forces."""

    rows: float
    forces: float


class Judge:
    """Measures and verdicts for the lanes of one scene."""

    def __init__(self, equations: Any, scene: Any) -> None:
        self.equations, self.scene = equations, scene
        self.friction = [c["friction"] for c in scene["contacts"]]
        self.ranges = _ranges(scene)
        shapes = scene.get("faces", []) + [finger["tip"] for finger in scene["fingers"]]
        # The engine reads these from tables, whose own error it states; the judge does not.
        tabled = any(shape["kind"] in _TABLED for shape in shapes)
        self.slack = _Slack(100.0, 100.0) if tabled else _Slack(1.0, 1.0)
        single = scene["rtol"].dtype == np.float32
        self.precision = float(np.finfo(np.float32 if single else np.float64).eps)
        if single:
            self.slack = _Slack(1e5, 1e4)

    def __call__(
        self, base: Run, whole: Run, tight: Run, moved: Run, start: Motion, shifted: Motion
    ) -> Verdicts:
        """Everything about every lane."""
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of lanes that did not start
            return self._judged(base, whole, tight, moved, start, shifted)

    def _judged(
        self, base: Run, whole: Run, tight: Run, moved: Run, start: Motion, shifted: Motion
    ) -> Verdicts:
        rows = _followed_by(whole)
        seen, end = self.equations.at(rows.saved), self.equations.at(base.last)
        self.size = self._size(seen)
        last = self._size(end)
        self.size = np.maximum(self.size, np.where(np.isfinite(last), last, 0.0))
        self.reached = np.isfinite(rows.saved.q).all(axis=-1)
        tol = self.scene["rtol"][:, None]
        m: dict[str, np.ndarray] = {"steps": base.steps}
        at_start = self.equations.at(start)
        m |= {"start_gap": _worst(np.abs(at_start.gap)), "start_tangency": _worst(np.abs(at_start.tangency))}
        m |= self._rows(seen, rows.saved)
        if whole.f is not None and whole.lam is not None:
            size = self.size[:, None, None]
            count = whole.f.shape[1]
            m["force"] = _worst(
                np.abs(seen.f - whole.f) / size,
                np.abs(seen.lam - whole.lam).reshape(size.shape[0], count, -1) / size,
            )
        m |= self._energy(seen, rows, tol)
        m |= self._defect(seen, rows, tol)
        m |= self._agreement(base, tight, moved, start, shifted, tol)
        margins = self._margins(seen, rows.saved)
        m |= {f"least_{name}": self._least(values) for name, values in margins.items()}
        at_end = self._margins(end, base.last)
        m |= {
            f"end_{name}": np.min(values[:, 0], axis=-1)
            for name, values in at_end.items()
            if values.shape[-1]
        }
        m |= self._beyond(base.last, end)
        m["depth"] = self._depths(base, whole, (tight, moved))
        m["whole"], m["tight"] = whole.code, tight.code
        m["most_steps"] = np.full(len(base.steps), self.scene.get("max_steps", 4096))
        m["t_end"], m["t1"] = base.t_end, self.scene["t1"]
        m["t_whole"], m["t_tight"] = whole.t_end, tight.t_end
        m["rtol"] = self.scene["rtol"]
        m["precision"] = np.full(len(base.steps), self.precision)
        # Forces are known to rounding over the square of the firmness: where that exceeds the tolerance, no
        # step is short enough.
        m["near"] = np.maximum(_NEARLY, np.sqrt(self.precision / self.scene["rtol"]))
        m["finite"] = np.isfinite(base.last.q).all(axis=(1, 2)) & np.isfinite(base.last.v).all(axis=(1, 2))
        verdicts = Verdicts(base.code, m)
        verdicts.wrong = [self._words(verdicts, i) for i in range(len(base.code))]
        return verdicts

    def _size(self, seen: Instant) -> np.ndarray:
        """Largest contact force of each lane at some times [N]."""
        return _worst(np.abs(seen.f), np.abs(seen.lam)) + 1e-300

    def _rows(self, seen: Instant, saved: Motion) -> dict[str, np.ndarray]:
        """Constraint rows: gap over size, tangency, creep over the lane's largest velocity."""
        quick = np.nanmax(np.abs(saved.v), axis=(1, 2)) + 1e-3
        return {
            "gap": _worst(np.abs(seen.gap)),
            "tangency": _worst(np.abs(seen.tangency)),
            "creep": _worst(np.abs(seen.creep)) / quick,
        }

    def _energy(self, seen: Instant, run: Run, tol: np.ndarray) -> dict[str, np.ndarray]:
        spectrum, running, _ = quadrature(run.ts.shape[1])
        half = 0.5 * (run.ts[:, -1] - run.ts[:, 0])[:, None]
        lost = half * (seen.loss @ running.T)
        total = seen.kinetic + seen.potential
        off = np.abs(total - total[:, :1] + lost)
        scale = np.nanmax(seen.kinetic, axis=1) + np.nanmax(
            np.abs(seen.potential - seen.potential[:, :1]), axis=1
        )
        whole = np.isfinite(total).all(axis=1)
        most = np.nanmax(np.abs(lost), axis=1, initial=0.0)
        # How far the judge's own integral may be off, which tolerances of 1e-13 are finer than.
        blind = _tail(spectrum, seen.loss) * most
        sharp = blind < 1e-9 * (scale + 1e-300)
        # What a tolerance of every velocity and position is worth.
        unit = np.nanmax(
            np.sum(np.abs(seen.momentum) * tol[..., None] * (1 + np.abs(run.saved.v)), axis=-1), axis=1
        )
        unit += np.nanmax(np.sum(np.abs(seen.inertial), axis=-1) * tol, axis=1)
        judged = whole & sharp
        worst = np.where(judged, np.maximum(np.max(off, axis=1) - blind, 0.0), np.nan)
        # Where nothing can move, energies are those of forces over lengths at rounding: a gap at rounding
        # leaves positions open by as much more as the rows are less firm.
        rounded = _ROUNDED * self.precision / np.finfo(float).eps
        none = rounded * self.size / np.nanmin(seen.firmness, axis=1)
        return {"energy": worst / (scale + none), "energy_units": worst / (unit + none)}

    def _defect(self, seen: Instant, run: Run, tol: np.ndarray) -> dict[str, np.ndarray]:
        """Does the motion satisfy the judge's own equations, integrated over the run?"""
        spectrum, running, _ = quadrature(run.ts.shape[1])
        half = 0.5 * (run.ts[:, -1] - run.ts[:, 0])[:, None, None]
        off, sharp = 0.0, True
        doubt = self.precision * seen.doubt
        pairs = [(run.saved.v, seen.rates, doubt), (run.saved.s, seen.rolling, 0.0 * doubt)]
        for value, rate, noise in pairs:
            gone = half * np.einsum("jk,lkn->ljn", running, rate)
            step = np.abs(value - value[:, :1] - gone) / (tol[..., None] * (1 + np.abs(value)))
            off = np.maximum(off, np.max(step, axis=(1, 2)))
            coarse = np.max(np.abs(half * rate), axis=(1, 2)) * _tail(spectrum, rate)
            coarse = coarse + np.nanmax(half * noise, axis=(1, 2))
            sharp = sharp & (coarse < 10 * self.scene["rtol"])
        return {"defect": np.where(sharp, off, np.nan)}

    def _agreement(
        self, base: Run, tight: Run, moved: Run, start: Motion, shifted: Motion, tol: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Disagreement with a tenth of the tolerance, in tolerances, over the growth of a disturbance."""

        def apart(a: Motion, b: Motion, unit: Any) -> np.ndarray:
            parts = [np.abs(x - y) / (unit * (1 + np.abs(x))) for x, y in ((a.q, b.q), (a.v, b.v))]
            return _worst(*parts)

        units = tol[..., None]
        grown = apart(base.last, moved.last, units) / apart(start, shifted, units)
        same = (base.code == tight.code) & (base.t_end == tight.t_end)
        off = np.where(same, apart(base.last, tight.last, units), np.nan)
        growth = np.where((base.code == moved.code) & (base.t_end == moved.t_end), grown, np.nan)
        return {
            "growth": growth,
            "off": off,
            "agreement": off / np.maximum(growth, 1.0) / np.maximum(base.steps, 1),
        }

    def _margins(self, seen: Instant, motion: Motion) -> dict[str, np.ndarray]:
        """What has to stay positive, over what it is measured by: (lanes, times, any)."""
        low, high = self.ranges[:, None, :, 0], self.ranges[:, None, :, 1]
        size, none = self.size[:, None, None], np.zeros((*seen.f.shape[:2], 0))
        cones = [
            (mu[:, None] * seen.f[..., k] - rubbing(seen)[..., k]) / (1.0 + mu[:, None])
            for k, mu in enumerate(self.friction)
            if mu is not None
        ]
        return {
            "force": seen.f / size,
            "cone": np.stack(cones, axis=-1) / size if cones else none,
            "room": seen.room,
            "range": np.concatenate([motion.q - low, high - motion.q], axis=-1)
            if np.isfinite(self.ranges).any()
            else none,
            "bend": seen.bend,
            "firmness": seen.firmness[..., None],
        }

    def _least(self, values: np.ndarray) -> np.ndarray:
        """Smallest value over the run, between its saved times too where these resolve it."""
        if not values.shape[-1]:
            return np.full(len(values), np.inf)
        least = np.nanmin(np.where(self.reached[..., None], values, np.nan), axis=(1, 2))
        spectrum, _, dense = quadrature(values.shape[1])
        between = np.min(np.einsum("jk,lkn->ljn", dense, values), axis=(1, 2))
        sharp = _tail(spectrum, values) < 1e-7
        return np.where(np.isfinite(between) & sharp, np.minimum(least, between), least)

    def _beyond(self, last: Motion, end: Instant) -> dict[str, np.ndarray]:
        """How force, cone and room change through the end, by the judge's own equations of motion."""
        step = self._step(last, end)
        bend, found = self._margins(end, last)["bend"][:, 0], {}
        for _ in range(_QUARTERS):
            apart = [self._carried(last, sign * step) for sign in (-1.0, 1.0)]
            sides = [self._margins(self.equations.at(side), side) for side in apart]
            # Beside a pole all that is asked for is what changes before it. Each side is compared with the
            # end: a step across the pole is thrown anywhere, back to the other side's value too.
            change = np.max(np.abs([side["bend"][:, 0] - bend for side in sides]), axis=0)
            far = ~np.all(change < 0.25 * np.abs(bend), axis=-1)
            if not far.any():
                break
            step = np.where(far[:, None], 0.25 * step, step)
        for name in ("force", "cone", "room", "range", "bend"):
            if sides[0][name].shape[-1]:
                here = self._margins(end, last)[name][:, 0]
                which = np.nanargmin(np.where(np.isfinite(here), here, np.inf), axis=-1)
                before, after = (side[name][np.arange(len(which)), 0, which] for side in sides)
                found[f"drift_{name}"] = after - before
                found[f"slope_{name}"] = np.abs(after - before) / (2.0 * step[:, 0])
        return found | {"aside": step[:, 0]}

    def _depths(self, base: Run, whole: Run, others: Sequence[Run]) -> np.ndarray:
        """How far a limit is passed that ended the run with many saved times, and not the other one.

        From that end on, as far as the other one went, by the judge's own equations, in growing steps. Zero
        where there is none; infinite where the equations end too.
        """
        depth = np.zeros(len(base.code))
        # One event has as many times as there are runs of it, by their errors and by what has grown of them.
        apart = [np.where(r.code == base.code, np.abs(r.t_end - base.t_end), 0.0) for r in others]
        same = 10.0 * np.max(apart, axis=0)
        sooner = base.t_end - whole.t_end
        # Where the steps of all others were too few, nothing tells the times of one event from two events.
        told = np.any([r.code != "max_steps_reached" for r in others], axis=0)
        # Where the other runs have this end at times far apart, the motion is chaotic, and rounding decides
        # whether it comes at all: lane 439 of `pinch-four`, seed 112716, moved by 1e-15 at its start, ends at
        # any time from 2.37 to 4.7 s.
        spread = [np.where(r.code == whole.code, np.abs(r.t_end - whole.t_end), 0.0) for r in others]
        told &= np.max(spread, axis=0) <= _CHAOTIC * whole.t_end
        early = told & (sooner > np.maximum(1e-5 * base.t_end, same))
        depth[early & (whole.code == "singular_contact") & (sooner > _POLE)] = np.inf
        lanes = np.flatnonzero(early & np.isin(whole.code, list(_LIMITS)))
        if not lanes.size:
            return depth
        scene = picked(self.scene, lanes)
        other = Judge(type(self.equations)(scene), scene)
        other.size = self.size[lanes]
        at = Motion(*(part[lanes] for part in (whole.last.q, whole.last.v, whole.last.s)))
        step = 0.1 * self._step(at, other.equations.at(at))
        left = sooner[lanes]
        for _ in range(_AHEAD):
            at, left, step = other._carried(at, step), left - step[:, 0], 1.15 * step
            margins = other._margins(other.equations.at(at), at)
            for i in np.flatnonzero(left > 0.0):
                least = np.min(margins[_LIMITS[str(whole.code[lanes[i]])]][i], initial=np.inf)
                depth[lanes[i]] = max(depth[lanes[i]], -least)
        return depth

    @staticmethod
    def _step(at: Motion, seen: Instant) -> np.ndarray:
        """A short time for a motion [s]."""
        pace = np.sqrt(np.nansum(at.v**2, axis=-1)) + np.sqrt(np.sqrt(np.nansum(seen.rates**2, axis=-1)))
        return 1e-4 / (pace + 1e-3)

    def _carried(self, motion: Motion, step: np.ndarray) -> Motion:
        """A motion carried on by a short time, by Runge and Kutta's method."""

        def rate(at: Motion) -> tuple[np.ndarray, ...]:
            seen = self.equations.at(at)
            return self.equations.velocity(at), seen.rates, seen.rolling

        def moved(k: Any, share: float) -> Motion:
            h = share * step[..., None]
            return Motion(motion.q + h * k[0], motion.v + h * k[1], motion.s + h * k[2])

        first = rate(motion)
        second = rate(moved(first, 0.5))
        third = rate(moved(second, 0.5))
        fourth = rate(moved(third, 1.0))
        mean = [(a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(first, second, third, fourth, strict=True)]
        return moved(mean, 1.0)

    def _words(self, verdicts: Verdicts, i: int) -> list[str]:
        """What is wrong with a lane."""
        m = {name: values[i] for name, values in verdicts.measures.items()}
        code, wrong = str(verdicts.code[i]), []
        if code == "unreachable":
            return [] if max(m["start_gap"], m["start_tangency"]) > REACH else ["cause: the start is closed"]
        if not m["finite"] and code != "not_finite":
            wrong.append("not finite")
        # Forces are known no better than the precision and the conditioning let them be.
        firm = np.nanmin([m["least_firmness"], m["end_firmness"]])
        noise = 100.0 * self.precision / max(firm, 1e-12) ** 2
        rows, forces = self.slack.rows, max(self.slack.forces, noise / FORCE)
        limits = {
            "gap": rows * GAP,
            "tangency": rows * TANGENCY,
            # Velocities are put back with the rows of where the step ended, before positions were: what
            # these moved by, some part of the tolerance, turns the rows.
            # Where curvatures cancel, that turns them by as much more: places move by gaps over their sum.
            "creep": rows * max(CREEP, 1e-2 * m["rtol"] / np.clip(m["least_bend"], 1e-4, 1.0)),
            "force": forces * FORCE,
        }
        for name, limit in limits.items():
            if not (m[name] <= limit or np.isnan(m[name])):
                wrong.append(f"{name} {m[name]:.1e}")
        # The errors of many steps add up: each may be as large as the tolerance.
        if m["energy_units"] > ENERGY + 0.1 * m["steps"] and m["energy"] > 1e-12:
            wrong.append(f"energy {m['energy']:.1e}, {m['energy_units']:.1e} tolerances")
        if m["defect"] > DEFECT:
            wrong.append(f"defect {m['defect']:.1e} tolerances")
        if m["agreement"] > AGREEMENT:
            wrong.append(f"agreement {m['agreement']:.1e}")
        return [*wrong, *_missed(code, m, forces), *_cause(code, m, forces)]


def _missed(code: str, m: dict[str, Any], slack: float) -> list[str]:
    """Limits that were crossed while the run went on."""
    found = []
    known = _known_forces(m, slack)
    ends = ("room", 1e-9 * slack), ("range", 1e-9 * slack)
    for name, limit in (("force", known), ("cone", known), *ends, ("bend", 0.0)):
        if m[f"least_{name}"] < -limit - _search_error(name, m):
            found.append(f"missed: {name} fell to {m[f'least_{name}']:.1e}")
    if code == "successful" and m["t_end"] != m["t1"]:
        found.append("ended early")
    growth = m["growth"] if m["growth"] > 1.0 else 1.0
    # Forces are relative, distances from an end in metres, and those of joints in radians.
    known = max(1e-6 * slack, 100.0 * m["rtol"] * growth) * (1e-2 if m["whole"] == "contour_end" else 1.0)
    if m["depth"] > known:
        found.append(
            f"missed: many saved times end {m['whole']} at {m['t_whole']:.6g}, {m['depth']:.0e} deep"
        )
    return found


def _known_forces(m: dict[str, Any], slack: float) -> float:
    """How well forces are known: a step is judged where it ended, before its return to the constraints."""
    return max(_ZERO * slack, m["rtol"])


def _ranges(scene: Any) -> np.ndarray:
    """Least and largest value of every coordinate, infinite but for joints with limits: (lanes, n, 2)."""
    q = scene["q"]
    found = np.stack([np.full(q.shape, -np.inf), np.full(q.shape, np.inf)], axis=-1)
    last = q.shape[-1]
    for finger in reversed(scene["fingers"]):
        first = last - finger["joints"]
        if "limits" in finger:
            found[:, first:last] = finger["limits"]
        last = first
    return found


def picked(scene: Any, lanes: np.ndarray) -> Any:
    """Some lanes of a scene."""
    if isinstance(scene, dict):
        return {name: picked(value, lanes) for name, value in scene.items()}
    if isinstance(scene, list | tuple):
        return type(scene)(picked(value, lanes) for value in scene)
    return scene[lanes] if isinstance(scene, np.ndarray) else scene


def rubbing(seen: Instant) -> np.ndarray:
    """Sizes of the tangential forces [N]: numbers in the plane, vectors in space."""
    return np.abs(seen.lam) if seen.lam.ndim == seen.f.ndim else np.linalg.norm(seen.lam, axis=-1)


def _search_error(name: str, m: dict[str, Any]) -> float:
    """How far a limit may be from zero at an end: rounding misleads a search by so much time."""
    slope = m.get(f"slope_{name}", np.nan)
    return _SEARCHED * m["precision"] * m["t_end"] * slope if np.isfinite(slope) else 0.0


def _beside_pole(m: dict[str, Any]) -> bool:
    """Whether a run ended where its precision no longer tells forces, and others of it collapsed there.

    Beside a pole the force grows without limit, and falls through zero, within less time than the runs'
    ends are apart: that of the exact motion lies among them.
    """
    collapsed = [
        abs(m[f"t_{other}"] - m["t_end"]) < _LAYER * m["t_end"]
        for other in ("whole", "tight")
        if m[other] in ("step_collapsed", "singular_contact")
    ]
    return m["end_firmness"] < m["near"] and any(collapsed)


def _cause(code: str, m: dict[str, Any], slack: float) -> list[str]:
    """Why a code is not the cause, if so."""
    if code in _LIMITS:
        name = _LIMITS[code]
        if f"end_{name}" not in m:
            return ["cause: nothing limits that"]
        limit = slack * 1e-9 if name in ("room", "range") else _known_forces(m, slack)
        limit += _search_error(name, m)
        value, drift = m[f"end_{name}"], m[f"drift_{name}"]
        at_start = m["t_end"] == 0.0
        if value > limit or (value < -limit and not at_start):
            return [] if _beside_pole(m) else [f"cause: {name} is {value:.1e} at the end"]
        # So near the start the judge's step leads before it, and what sets off from rest comes from where it
        # goes to.
        if not drift < 0 and m["t_end"] > m["aside"]:
            return [f"cause: {name} does not fall through zero ({drift:.1e})"]
        singular = min(m["end_bend"], m["end_firmness"])
        return [f"cause: singular ({singular:.1e})"] if singular < _ZERO else []
    if code == "max_steps_reached" and m["steps"] < m["most_steps"]:
        return [f"cause: {m['steps']} steps"]
    if code == "singular_contact" and not (m["end_bend"] < _FLAT or m["end_firmness"] ** 2 < _SINGULAR):
        return [f"cause: bend {m['end_bend']:.1e}, firmness {m['end_firmness']:.1e}"]
    if code in ("step_collapsed", "not_finite") and not min(m["end_bend"], m["end_firmness"]) < m["near"]:
        return [f"cause: bend {m['end_bend']:.1e}, firmness {m['end_firmness']:.1e}"]
    return []


def _followed_by(run: Run) -> Run:
    """A run whose last saved row, which an event keeps from being saved, is its end."""
    saved = Motion(run.saved.q.copy(), run.saved.v.copy(), run.saved.s.copy())
    gone = ~np.isfinite(saved.q[:, -1]).all(axis=-1) & (run.t_end == run.ts[:, -1])
    for rows, last in ((saved.q, run.last.q), (saved.v, run.last.v), (saved.s, run.last.s)):
        rows[gone, -1] = last[gone, 0]
    return Run(run.ts, saved, run.last, run.code, run.t_end, run.steps, run.f, run.lam)


def _tail(spectrum: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Size of the highest Chebyshev coefficients over that of the values: whether they are resolved."""
    values = values.reshape(*values.shape[:2], -1)
    waves = np.abs(np.einsum("jk,lkn->ljn", spectrum, values))
    return np.max(waves[:, -6:], axis=(1, 2)) / (np.max(np.abs(values), axis=(1, 2)) + 1e-300)


def _worst(*arrays: np.ndarray) -> np.ndarray:
    """Largest number of each lane, among those that were reached."""
    flat = np.concatenate([a.reshape(len(a), -1) for a in arrays], axis=1)
    return np.max(np.where(np.isfinite(flat), flat, -np.inf), axis=1, initial=-np.inf)
