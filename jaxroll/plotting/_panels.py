"""What there is to plot over time: one panel for each quantity of the chapter."""

import re
from dataclasses import dataclass, replace

import numpy as np

from .._analysis import check_pinch, pinch_balance, press_balance
from .._integration import Trajectory
from .._mechanics import AbstractFinger, Grasp, PivotedObject
from .._motion import Energy, multipliers
from ..contact import Contact
from ..control import law_of, Press
from ._style import MM

# Below this share of its scale, a residual is what floating-point arithmetic leaves over.
_ROUNDING = 1e-13
_SMALL = 1e-3
# Forces, motions and rates below `_NOTHING`, in the units of their panels, are rounding, and are drawn on an
# axis from -`_FLAT` to `_FLAT`. For a grasp whose own forces or lengths are smaller than these units, the
# first is a share of these forces or lengths (`scales_of`).
_NOTHING, _FLAT = 1e-10, 1e-3
_GRAVITY = 9.81
_UNIT = re.compile(r"\[([^$\]]*)\]$")


@dataclass(frozen=True)
class Panel:
    """One panel: values of shape (t,) or (t, lines), with a name for each line.

    `left_over` says that the values should be zero: what they are is the error of a run. Where the values of
    any other panel are zero but for rounding, `least` is the half height of its axis.
    """

    title: str
    label: str
    values: np.ndarray
    names: tuple[str, ...] = ()
    width: float = 1.4
    least: float | None = None
    left_over: bool = False


def panels(grasp: Grasp, run: Trajectory) -> list[Panel]:
    """All panels of a run, in the order in which the figure shows them."""
    contacts, figures = numbered("contact", len(grasp.contacts)), 0
    if is_pinch(grasp):
        found = _pinch(grasp, run)
    elif isinstance(law_of(grasp.controller), Press):
        *first, potential = _press(grasp, run, contacts)
        # In the order of the chapter's Figs. 9-18.
        found = [*first, *_motion(grasp, run, contacts), potential, *_forces(grasp, run, contacts)]
        figures = 10 if _is_part_2(grasp) else 0
    else:
        rolled = _rolled(grasp, run, contacts)
        found = [*rolled, *_motion(grasp, run, contacts), *_forces(grasp, run, contacts)]
    found.append(_last(run, contacts))
    return [
        replace(p, title=f"Fig. {9 + i}: {p.title}" if i < figures else sentence(p.title))
        for i, p in enumerate(all_in_powers(grasp, run, found))
    ]


def is_pinch(grasp: Grasp) -> bool:
    """Whether the quantities of the chapter's Part 1 are defined."""
    try:
        check_pinch(grasp)
    except ValueError:
        return False
    return True


def _motion(grasp: Grasp, run: Trajectory, contacts: tuple[str, ...]) -> list[Panel]:
    normal, *tangential = _gaps(grasp, run, contacts, contacts)
    return [*_joint_rates(grasp, run), *_object_rates(grasp, run), *tangential, normal]


def _rolled(grasp: Grasp, run: Trajectory, contacts: tuple[str, ...]) -> list[Panel]:
    """Contact coordinates: a panel for those of contours [mm], and one for places of a caller's own contacts.

    An own contact may have any number of coordinates, or none, and only the caller knows their units.
    """
    own: list[bool] = []
    names: list[str] = []
    for name, contact, part in zip(contacts, grasp.contacts, grasp.form.places.children(), strict=True):
        count = part.num_leaves
        names += [name] if count == 1 else [f"{name}, {k + 1}" for k in range(count)]
        own += [not isinstance(contact, Contact)] * count
    s, found = np.asarray(run.states.s), []
    titles = ("rolling coordinate", r"$\sigma$ [mm]", MM), ("places of own contacts", "place", 1.0)
    for (title, label, scale), mine in zip(titles, (~np.array(own, bool), np.array(own, bool)), strict=True):
        if mine.any():
            kept = tuple(name for name, one in zip(names, mine, strict=True) if one)
            found.append(Panel(title, label, scale * s[:, mine], kept))
    return found


def all_in_powers(grasp: Grasp, run: Trajectory, panels: list[Panel]) -> list[Panel]:
    """Panels of a run, their small values in powers of ten, beside the scales of its grasp."""
    scales = scales_of(grasp, forces_of(grasp, run)[0])
    units = [found[1] if (found := _UNIT.search(panel.label)) else "" for panel in panels]
    return [in_powers(panel, scales.get(unit, 1.0)) for panel, unit in zip(panels, units, strict=True)]


def scales_of(grasp: Grasp, normal: np.ndarray) -> dict[str, float]:
    """For each unit of a panel how large its values may be, at most one: the forces of a tiny grasp are tiny.

    Args:
        grasp: Whose fingers have a size, and bodies a weight.
        normal: Normal forces of a run.
    """
    held = [getattr(body, "mass", getattr(body, "masses", None)) for body in grasp.bodies]
    weights = [_GRAVITY * float(np.sum(np.asarray(mass))) for mass in held if mass is not None]
    force = max(float(np.max(np.abs(normal), initial=0.0, where=np.isfinite(normal))), sum(weights))
    force = min(1.0, force) if weights else 1.0
    length = MM * max(float(finger.size) for finger in grasp.fingers)
    units = {"N": force, "mm": length, "mm/s": length, "mN m": force * length, "mJ": force * length}
    return {unit: min(1.0, scale) for unit, scale in units.items()}


def in_powers(panel: Panel, scale: float = 1.0) -> Panel:
    """Small values in a power of ten that the axis label states; zero but for rounding is drawn as zero.

    Args:
        panel: With values in its own units.
        scale: How large such values may be.
    """
    peak = float(np.nanmax(np.abs(panel.values)))
    if peak < _NOTHING * scale and not panel.left_over:
        return replace(panel, title=f"{panel.title}: zero", least=_FLAT)
    if not 0.0 < peak < _SMALL:
        return panel
    power = int(np.floor(np.log10(peak)))
    label = panel.label.replace("[", f"[$10^{{{power}}}$ ")
    return replace(panel, label=label, values=panel.values / 10.0**power)


def sentence(words: str) -> str:
    """The words with a capital first letter."""
    return words[0].upper() + words[1:]


def _is_part_2(grasp: Grasp) -> bool:
    alone = len(grasp.fingers) == 1 and len(grasp.contacts) == 1
    pressed = isinstance(law_of(grasp.controller), Press) and isinstance(grasp.object, PivotedObject)
    return alone and pressed and grasp.fingers[0].joints == 2


def _press(grasp: Grasp, run: Trajectory, contacts: tuple[str, ...]) -> list[Panel]:
    found = press_balance(grasp, run.ts, run.states)
    rows = (
        ("unbalanced normal force", r"$\Delta f$ [N]", found.delta_f, 1.0),
        ("unbalanced tangential force", r"$\Delta\lambda$ [N]", found.delta_lam, 1.0),
        ("unbalanced moment", r"$(f_d/r)\,N_1$ [mN m]", found.moment, 1e3),
        ("contact on the object's contour", "$s$ [mm]", found.s, MM),
        ("artificial potential", "$U$ [mJ]", found.potential, 1e3),
    )
    return [Panel(t, label, scale * np.asarray(x), contacts) for t, label, x, scale in rows]


def _pinch(grasp: Grasp, run: Trajectory) -> list[Panel]:
    found, (f, lam) = pinch_balance(grasp, run.ts, run.states), forces_of(grasp, run)
    moments = np.concatenate([found.delta_n, np.asarray(found.s_n)[:, None]], axis=1)
    return [
        Panel("normal forces", "$f_i$ [N]", f, _both("f")),
        Panel("tangential forces", r"$\lambda_i$ [N]", lam, _both(r"\lambda")),
        _contacts(MM * np.asarray(found.s), first_of(run)),
        Panel("unbalanced normal forces", r"$\Delta f_i$ [N]", np.asarray(found.delta_f), _both(r"\Delta f")),
        Panel(
            "unbalanced tangential forces",
            r"$\Delta\lambda_i$ [N]",
            np.asarray(found.delta_lam),
            _both(r"\Delta\lambda"),
        ),
        Panel("unbalanced moments", "moment [mN m]", 1e3 * moments, (*_both(r"\Delta N"), "$S_N$")),
        Panel("artificial potential", "$U$ [mJ]", 1e3 * np.asarray(found.potential)),
        Panel("off the line $O_1O_2$", "angle [rad]", np.asarray(found.lean), ("$O_1P_1$", "$O_2P_2$")),
        *_moved(grasp, run),
        *_gaps(grasp, run, _both("Q"), _both("R")),
    ]


def _both(symbol: str) -> tuple[str, str]:
    return f"${symbol}_1$", f"${symbol}_2$"


def first_of(run: Trajectory) -> str:
    """The first saved time, since which motion is counted, as the argument of a symbol."""
    t = float(np.asarray(run.ts)[np.asarray(run.reached)][0])
    return f"{t:.4g}" + r"\,\mathrm{s}" * (t != 0.0)


def _contacts(s: np.ndarray, then: str) -> Panel:
    """Places of both contacts [mm]; since the first state, where they are too far apart for one scale."""
    # On a closed object both lie far apart and move little: one scale for both would show two straight lines.
    title, reached = "contacts on the object's contour", s[np.isfinite(s).all(axis=1)]
    if 0.0 < 4.0 * np.ptp(reached, axis=0).max() < np.ptp(reached):
        return Panel(title, f"$s_i - s_i({then})$ [mm]", s - reached[0], _both("s"))
    return Panel(title, "$s_i$ [mm]", s, _both("s"))


def _moved(grasp: Grasp, run: Trajectory) -> list[Panel]:
    """How far object and joints have moved since the first state."""
    q = np.asarray(run.states.q)
    start = q[np.flatnonzero(np.isfinite(q).all(axis=1))[0]]
    moved, at, then = q - start, grasp.sizes[0], first_of(run)
    # The last of the object's coordinates is its angle, whether it is pivoted or free.
    turned = Panel("rotation of the object", rf"$\theta - \theta({then})$ [rad]", moved[:, at - 1])
    found = [turned]
    if at > 1:
        names = (f"$x - x({then})$", f"$y - y({then})$")
        found.append(Panel("path of the object", "moved [mm]", MM * moved[:, :2], names))
    for i, finger in enumerate(grasp.fingers):
        mine = slice(at, at + finger.joints)
        at += finger.joints
        names = tuple(f"$q_{{{i + 1}{j + 1}}}$" for j in range(finger.joints))
        what, unit, scale = _joint_words(finger)
        title = f"joint {what} of finger {i + 1}"
        found.append(Panel(title, f"$q - q({then})$ [{unit}]", scale * moved[:, mine], names))
    return found


def _joint_words(finger: AbstractFinger) -> tuple[str, str, float]:
    """What a finger's coordinates are called, and the unit to show them in with its scale."""
    units = {each.unit for each in finger.labels}
    return ("displacements", "mm", MM) if units == {"m"} else ("angles", "rad", 1.0)


def _joint_rates(grasp: Grasp, run: Trajectory) -> list[Panel]:
    v, at, panels = np.asarray(run.states.v), grasp.sizes[0], []
    single_finger = len(grasp.fingers) == 1
    for i, finger in enumerate(grasp.fingers):
        _, unit, scale = _joint_words(finger)
        label, rates = rf"$\dot{{q}}$ [{unit}/s]", scale * v[:, at : at + finger.joints]
        at += finger.joints
        if not finger.joints:
            continue
        if single_finger and finger.joints <= 3:
            panels += [
                Panel(f"rate of joint {j + 1}", rf"$\dot{{q}}_{{{j + 1}}}$ [{unit}/s]", rates[:, j])
                for j in range(finger.joints)
            ]
            continue
        title = "joint rates" if single_finger else f"joint rates of finger {i + 1}"
        names = tuple(f"joint {j + 1}" for j in range(finger.joints))
        panels.append(Panel(title, label, rates, names))
    return panels


def _object_rates(grasp: Grasp, run: Trajectory) -> list[Panel]:
    v = np.asarray(run.states.v)[:, : grasp.sizes[0]]
    turning = Panel("rate of the object", r"$\dot{\theta}$ [rad/s]", v[:, -1])
    if v.shape[1] == 1:
        return [turning]
    names = (r"$\dot{x}$", r"$\dot{y}$")
    return [turning, Panel("velocity of the object", "velocity [mm/s]", MM * v[:, :2], names)]


def _gaps(grasp: Grasp, run: Trajectory, normal: tuple[str, ...], tangential: tuple[str, ...]) -> list[Panel]:
    left, size = run.residuals, float(grasp.fingers[0].size)
    found = [residual_panel("normal gap", r"$Q$ [m]", left.normal, size=size, names=normal)]
    if beside := _beside(grasp):
        values, names = np.asarray(left.tangential)[:, beside], tuple(tangential[i] for i in beside)
        found.append(residual_panel("tangential gap", r"$R$ [m]", values, size=size, names=names))
    return found


def _beside(grasp: Grasp) -> list[int]:
    """Which contacts have tangential gaps and forces: one of a caller's own may have a single row."""
    return [i for i, contact in enumerate(grasp.contacts) if contact.rows > 1]


def _forces(grasp: Grasp, run: Trajectory, contacts: tuple[str, ...]) -> list[Panel]:
    (f, lam), beside = forces_of(grasp, run), _beside(grasp)
    if len(contacts) == 1 and beside:
        both = np.concatenate([f, lam], axis=1)
        return [Panel("contact force", "force [N]", both, ("normal $f$", r"tangential $\lambda$"))]
    found = [Panel("normal force", "$f$ [N]", f, contacts)]
    if beside:
        names = tuple(contacts[i] for i in beside)
        found.append(Panel("tangential force", r"$\lambda$ [N]", lam[:, beside], names))
    return found


def forces_of(grasp: Grasp, run: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Normal and tangential forces, recorded or not."""
    found = run.multipliers
    if found is None:
        found = multipliers(grasp, run.ts, run.states)
    return np.asarray(found.f), np.asarray(found.lam)


def _last(run: Trajectory, contacts: tuple[str, ...]) -> Panel:
    energy = run.energy
    if energy is None:
        return residual_panel("tangency", "sine [rad]", run.residuals.tangency, size=1.0, names=contacts)
    return balance_panel(energy)


def balance_panel(energy: Energy) -> Panel:
    """The energy balance."""
    size = float(np.nanmax(np.abs(np.asarray(energy.kinetic) + np.asarray(energy.potential))))
    return residual_panel("energy balance", r"$\Delta(K + P - W)$ [J]", energy.residual, size=size)


def residual_panel(
    title: str, label: str, values: object, *, size: float, names: tuple[str, ...] = ()
) -> Panel:
    """A panel of what should be zero, in a thin line that shows scatter."""
    seen = np.asarray(values)
    if np.nanmax(np.abs(seen)) < _ROUNDING * size:
        title += " (rounding level)"
    return Panel(title, label, seen, names, 0.8, left_over=True)


def numbered(noun: str, count: int) -> tuple[str, ...]:
    """The noun with each number from 1 to `count`."""
    return tuple(f"{noun} {i + 1}" for i in range(count))
