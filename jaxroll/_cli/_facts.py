"""What `jaxroll demo` says of the chapter's scenes and of runs of them: lines of numbers, as text.

For each part of the chapter, `..._scene` describes a scene and `..._facts` a run of it.
"""

from typing import Any

import numpy as np

from .. import _analysis, stability


def _row(array: Any) -> str:
    """Lengths in mm or masses in g, from metres or kilograms, as text."""
    return ", ".join(f"{1e3 * float(x):g}" for x in np.asarray(array))


def _finger(finger: Any) -> str:
    """Lengths and masses of a finger's links."""
    return f"{_row(finger.lengths)} mm; {_row(finger.masses)} g"


def pivoted_scene(grasp: Any, state: Any) -> list[str]:
    """Links, object and control of Part 2."""
    control, body = grasp.controller, grasp.object
    return [
        f"  links       {_finger(grasp.fingers[0])}",
        f"  object      {float(body.inertia):g} kg m^2 about its pivot at ({_row(body.pivot)}) mm",
        f"  control     f_d = {float(control.force):g} N, r = {1e3 * float(control.radius):g} mm, "
        f"c = {float(control.damping):g} N m s",
    ]


def pivoted_facts(grasp: Any, run: Any) -> list[str]:
    """What the chapter plots of Part 2, at the start and the end of a run."""
    found = _analysis.press_balance(grasp, run.ts, run.states)
    rows = (
        ("Delta f [N]", found.delta_f, 1.0),
        ("Delta lambda [N]", found.delta_lam, 1.0),
        ("(f_d/r) N_1 [N m]", found.moment, 1.0),
        ("s [mm]", found.s, 1e3),
        ("U [mJ]", found.potential, 1e3),
    )
    lines = [f"{'Chapter, Figs. 9-18':22}{'start':>14}{'end':>14}"]
    for name, values, scale in rows:
        start, end = scale * np.asarray(values)[[0, -1], 0]
        lines.append(f"  {name:20}{start:14.5g}{end:14.5g}")
    return lines + _checks(run)


def pinch_scene(grasp: Any, state: Any) -> list[str]:
    """Links, object and control of Part 1."""
    control, body = grasp.controller, grasp.object
    alpha, damping = float(np.asarray(control.alpha)[0]), float(np.asarray(control.damping)[0])
    return [
        *(f"  finger i={i}  {_finger(finger)}" for i, finger in enumerate(grasp.fingers, 1)),
        f"  object      {1e3 * float(body.mass):g} g, {float(body.inertia):.4g} kg m^2",
        f"  control     beta = {float(control.beta):g} N/m, alpha = {alpha:g} N m/rad, c = {damping:g} N m s",
        *_verdict(grasp, state),
    ]


def _verdict(grasp: Any, state: Any) -> list[str]:
    """What linearisation at the equilibrium says, before anything is simulated."""
    found = stability.assess(grasp, state)
    neutral, rates = int(found.neutral), np.asarray(found.rates)
    # Each neutral direction has one rate of zero.
    moving = rates[np.argsort(np.abs(rates))][neutral:]
    return [
        f"  verdict     {stability.VERDICTS[found.verdict]}",
        f"              neutral directions: {neutral}; slowest rate of the others: "
        f"{float(np.max(np.real(moving))):.3g} 1/s",
    ]


def pinch_facts(grasp: Any, run: Any) -> list[str]:
    """What the chapter plots of Part 1, at the start and the end of a run."""
    found = _analysis.pinch_balance(grasp, run.ts, run.states)
    rows = (
        ("s_i [mm]", found.s, 1e3),
        ("Delta f_i [N]", found.delta_f, 1.0),
        ("Delta lambda_i [N]", found.delta_lam, 1.0),
        ("Delta N_i [mN m]", found.delta_n, 1e3),
        ("S_N [mN m]", found.s_n, 1e3),
        ("U [mJ]", found.potential, 1e3),
        ("lean of O_iP_i [rad]", found.lean, 1.0),
    )
    lines = [f"{'Chapter, Part 1':24}{'start: i = 1':>15}{'2':>12}{'end: i = 1':>15}{'2':>12}"]
    for name, values, scale in rows:
        ends = scale * np.reshape(np.asarray(values)[[0, -1]], (2, -1))
        # Two numbers, one per finger, except for quantities of the whole pinch.
        cells = [f"{end[0]:15.5g}" + (f"{end[1]:12.5g}" if end.size > 1 else " " * 12) for end in ends]
        lines.append(f"  {name:22}" + "".join(cells).rstrip())
    return lines + _checks(run)


def _checks(run: Any) -> list[str]:
    """A line on the energy dissipated, the error of the energy balance, and the largest gaps."""
    peak = lambda array: float(np.nanmax(np.abs(np.asarray(array))))  # noqa: E731
    left, energy = run.residuals, run.energy
    return [
        f"  energy      {1e3 * -float(np.asarray(energy.work)[-1]):.4g} mJ dissipated; balance off by "
        f"{peak(energy.residual):.1e} J; |Q| {peak(left.normal):.1e} m, |R| {peak(left.tangential):.1e} m",
    ]


def pinch3d_scene(grasp: Any, state: Any) -> list[str]:
    """Links, object and control of Part 3."""
    control, body = grasp.controller, grasp.object
    damping = float(np.asarray(control.damping)[0])
    links = [np.linalg.norm(np.asarray(finger.offsets), axis=1) for finger in grasp.fingers]
    return [
        *(
            f"  finger i={i}  {_row(lengths)} mm; {_row(finger.masses)} g"
            for i, (lengths, finger) in enumerate(zip(links, grasp.fingers, strict=True), 1)
        ),
        f"  object      {_row(body.outline)} mm, {1e3 * float(body.mass):g} g",
        f"  control     beta = {float(control.beta):g} N/m, c = {damping:g} N m s",
    ]


def pinch3d_facts(grasp: Any, run: Any) -> list[str]:
    """What the chapter plots of Part 3, at the start and the end of a run."""
    found, f = _analysis.loci(grasp, run), np.asarray(run.multipliers.f)
    aside = np.linalg.norm(np.asarray(run.multipliers.lam), axis=-1)
    on_tip, on_object = np.asarray(found.tip.arclength), np.asarray(found.object.arclength)
    # The last time that the run reached.
    last = np.flatnonzero(np.isfinite(f).all(axis=1))[-1]
    rows = (
        ("f_i [N]", f),
        ("|lambda_i| [N]", aside),
        ("|lambda_i| / f_i", aside / f),
        ("s_i on the tip [mm]", 1e3 * on_tip.T),
        ("s_i on the object [mm]", 1e3 * on_object.T),
    )
    lines = [f"{'Chapter, Part 3':24}{'start: i = 1':>15}{'2':>12}{'end: i = 1':>15}{'2':>12}"]
    for name, values in rows:
        cells = [f"{end[0]:15.5g}{end[1]:12.5g}" for end in values[[0, last]]]
        lines.append(f"  {name:22}" + "".join(cells))
    off = np.nanmax(np.abs(on_tip - on_object))
    return [*lines, f"  A-2         arclengths of both loci differ by {off:.1e} m", *_checks(run)]
