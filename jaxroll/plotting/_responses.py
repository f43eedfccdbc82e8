"""Responses over time: the chapter's Figs. 9-18, or what there is of them for another grasp."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..control import Press
from ..integration import multipliers, press_balance, Trajectory
from ..mechanics import Grasp, PivotedObject
from ._style import CYCLE, MM, Picture, save, tidy
from ._views import single

_COLUMNS = 3
# Below this share of its scale, a residual is what floating-point arithmetic leaves over.
_ROUNDING = 1e-13
_SMALL = 1e-3


@dataclass(frozen=True)
class Panel:
    """One panel: values of shape (t,) or (t, lines), with a name for each line."""

    title: str
    label: str
    values: np.ndarray
    names: tuple[str, ...] = ()
    width: float = 1.4


def responses(grasp: Grasp, trajectory: Trajectory, folder: str | Path | None = None) -> Figure:
    r"""Plot the responses of one run over time.

    For one finger under `control.Press` these are Figs. 9-18 of the chapter, with its numbers and
    symbols: $\Delta f$ [N], $\Delta\lambda$ [N], $(f_d/r) N_1$ [mN m], $s$ [mm], joint rates and
    object rate [rad/s], $R$ and $Q$ [m], $U$ [mJ]. For any other grasp: contact forces, rolling
    coordinates, rates, residuals, and the energy balance if it was recorded.

    Args:
        grasp: The grasp that was simulated.
        trajectory: One run of it. Its recorded multipliers are used if there are any.
        folder: Where to write the figure too, as `responses.png`. Default: nowhere.

    Returns:
        The figure.

    Raises:
        ValueError: If the trajectory is a batch.

    Example:
        >>> import jaxroll as jxr
        >>> from jaxroll import plotting
        >>> grasp, state = jxr.scenes.pivoted()
        >>> run = jxr.simulate(grasp, state, t1=0.1, ts=3)
        >>> plotting.responses(grasp, run).axes[0].get_ylabel()
        '$\\Delta f$ [N]'
    """
    ts, reached = single(trajectory)
    panels = _panels(grasp, trajectory)
    rows = -(-len(panels) // _COLUMNS)
    figure = Picture(10.0, 2.05 * rows + 0.2)
    axes = figure.subplots(rows, _COLUMNS, sharex=True, squeeze=False).ravel()
    for i, (ax, panel) in enumerate(zip(axes, panels, strict=False)):
        _draw(ax, ts[reached], panel, reached)
        last = i + _COLUMNS >= len(panels)
        tidy(ax, xlabel="time $t$ [s]" if last else "", ylabel=panel.label, title=panel.title)
        ax.tick_params(labelbottom=last)
    for ax in axes[len(panels) :]:
        ax.remove()
    figure.align_ylabels()
    if folder is not None:
        save(figure, folder, "responses.png")
    return figure


def _draw(ax: Axes, ts: np.ndarray, panel: Panel, reached: np.ndarray) -> None:
    values = np.reshape(panel.values, (len(reached), -1))[reached]
    peak = float(np.max(np.abs(values)))
    for k, line in enumerate(values.T):
        name = panel.names[k] if len(panel.names) > 1 else None
        ax.plot(ts, line, color=CYCLE[k % len(CYCLE)], lw=panel.width, label=name)
    ax.margins(x=0.0, y=0.08)
    low, high = ax.get_ylim()
    if high - low < 1e-4 * peak:
        middle = 0.5 * (low + high)
        low, high = ax.set_ylim(middle - 0.1 * peak, middle + 0.1 * peak)
    if low <= 0.0 <= high:
        ax.axhline(0.0, color="#BBBBBB", lw=0.7, zorder=0)
    if len(panel.names) > 1:
        ax.legend(fontsize=7.5, framealpha=0.8, edgecolor="none", handlelength=1.4, labelspacing=0.3)


def _panels(grasp: Grasp, run: Trajectory) -> list[Panel]:
    pressed = isinstance(grasp.controller, Press)
    contacts = _numbered("contact", len(grasp.contacts))
    panels = _press(grasp, run, contacts) if pressed else []
    if not pressed:
        title = "rolling coordinate"
        panels.append(Panel(title, r"$\sigma$ [mm]", MM * np.asarray(run.states.s), contacts))
    panels += _joint_rates(grasp, run) + _object_rates(grasp, run)
    panels += _gaps(grasp, run, contacts)
    if pressed:
        panels.append(panels.pop(_POTENTIAL))
    panels += _forces(grasp, run, contacts) + _extra(run, contacts)
    figures = 10 if _is_part_2(grasp) else 0
    return [
        replace(_in_powers(p), title=f"Fig. {9 + i}: {p.title}" if i < figures else _sentence(p.title))
        for i, p in enumerate(panels)
    ]


def _in_powers(panel: Panel) -> Panel:
    """Small values in a power of ten that the axis label states."""
    peak = float(np.nanmax(np.abs(panel.values)))
    if not 0.0 < peak < _SMALL:
        return panel
    power = int(np.floor(np.log10(peak)))
    label = panel.label.replace("[", f"[$10^{{{power}}}$ ")
    return replace(panel, label=label, values=panel.values / 10.0**power)


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:]


# Where `_press` puts U, which the chapter shows last.
_POTENTIAL = 4


def _is_part_2(grasp: Grasp) -> bool:
    alone = len(grasp.fingers) == 1 and len(grasp.contacts) == 1
    pressed = isinstance(grasp.controller, Press) and isinstance(grasp.object, PivotedObject)
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


def _joint_rates(grasp: Grasp, run: Trajectory) -> list[Panel]:
    v, at, panels = np.asarray(run.states.v), grasp.sizes[0], []
    single_finger = len(grasp.fingers) == 1
    for i, finger in enumerate(grasp.fingers):
        rates = v[:, at : at + finger.joints]
        at += finger.joints
        if single_finger and finger.joints <= 3:
            panels += [
                Panel(f"rate of joint {j + 1}", rf"$\dot{{q}}_{{{j + 1}}}$ [rad/s]", rates[:, j])
                for j in range(finger.joints)
            ]
            continue
        title = "joint rates" if single_finger else f"joint rates of finger {i + 1}"
        names = tuple(f"joint {j + 1}" for j in range(finger.joints))
        panels.append(Panel(title, r"$\dot{q}$ [rad/s]", rates, names))
    return panels


def _object_rates(grasp: Grasp, run: Trajectory) -> list[Panel]:
    v = np.asarray(run.states.v)[:, : grasp.sizes[0]]
    turning = Panel("rate of the object", r"$\dot{\theta}$ [rad/s]", v[:, -1])
    if v.shape[1] == 1:
        return [turning]
    names = (r"$\dot{x}$", r"$\dot{y}$")
    return [turning, Panel("velocity of the object", "velocity [mm/s]", MM * v[:, :2], names)]


def _gaps(grasp: Grasp, run: Trajectory, contacts: tuple[str, ...]) -> list[Panel]:
    left, size = run.residuals, float(np.mean(np.asarray(grasp.fingers[0].lengths)))
    return [
        _residual("tangential gap", r"$R$ [m]", left.tangential, size, contacts),
        _residual("normal gap", r"$Q$ [m]", left.normal, size, contacts),
    ]


def _forces(grasp: Grasp, run: Trajectory, contacts: tuple[str, ...]) -> list[Panel]:
    found = run.multipliers
    if found is None:
        found = multipliers(grasp, run.ts, run.states)
    f, lam = np.asarray(found.f), np.asarray(found.lam)
    if len(contacts) == 1:
        both = np.concatenate([f, lam], axis=1)
        return [Panel("contact force", "force [N]", both, ("normal $f$", r"tangential $\lambda$"))]
    return [
        Panel("normal force", "$f$ [N]", f, contacts),
        Panel("tangential force", r"$\lambda$ [N]", lam, contacts),
    ]


def _extra(run: Trajectory, contacts: tuple[str, ...]) -> list[Panel]:
    energy = run.energy
    if energy is None:
        return [_residual("tangency", "sine [rad]", run.residuals.tangency, 1.0, contacts)]
    size = float(np.nanmax(np.abs(np.asarray(energy.kinetic + energy.potential))))
    return [_residual("energy balance", r"$\Delta(K + P - W)$ [J]", energy.residual, size, ())]


def _residual(title: str, label: str, values: object, size: float, names: tuple[str, ...]) -> Panel:
    """A panel of what should be zero, in a thin line that shows scatter."""
    seen = np.asarray(values)
    if np.nanmax(np.abs(seen)) < _ROUNDING * size:
        title += " (rounding level)"
    return Panel(title, label, seen, names, 0.8)


def _numbered(noun: str, count: int) -> tuple[str, ...]:
    return tuple(f"{noun} {i + 1}" for i in range(count))
