"""Batches from one run to a million: time, error, memory, and what unlike lanes waste (about ten minutes).

`python -m benchmarks.lanes --write` rewrites its section of README.md and lanes.png; `--quick`: up to a
thousand lanes. Every row is a process of its own, whose peak memory is its own too (read from /proc, so on
Linux). Lanes differ in damping, by up to a factor of two; compilation is left out of all times.
"""

import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from benchmarks._common import command, device, fresh, table, versions
from benchmarks._lanes_row import Case, CASES, CHUNK

FIGURE = Path(__file__).parent / "lanes.png"
TARGET, FLAT, WASTE = 1e-6, 1.5, 1.3
Row = dict[str, Any]
# By scene: rows by number of lanes, and rows of waste.
Found = dict[str, tuple[list[Row], list[Row]]]


def measure(quick: bool) -> Found:
    found = {}
    with tempfile.TemporaryDirectory() as cache:

        def row(way: str, case: Case, lanes: int, *name: str) -> Row:
            made = fresh("benchmarks._lanes_row", way, case.scene, str(lanes), *name, cache=cache)
            print(f"{case.scene}, {way}: {made}", file=sys.stderr, flush=True)
            return made

        for case in CASES:
            sizes = [lanes for lanes in case.sizes if lanes <= 1000 or not quick]
            many, spread = 256 if quick else CHUNK, (case.stiffness, "damping")
            waste = [{"name": name, **row("waste", case, many, name)} for name in spread]
            found[case.scene] = [row("batch", case, lanes) for lanes in sizes], waste
    return found


def batches(rows: list[Row]) -> str:
    us = lambda row, key: f"{1e6 * row[key]:.1f}" if key in row else ""  # noqa: E731
    header = ["lanes", "wall [us]", "processor [us]", "mapped, processor [us]", "steps"]
    header += ["error [rad]", "successful", "peak memory [MiB]"]
    lines = []
    for row in rows:
        times = [us(row, key) for key in ("wall", "work", "mapped")]
        more = [
            f"{row['steps']:.0f}",
            f"{row['error']:.1e}",
            f"{row['successful']:.1%}",
            f"{row['peak']:.0f}",
        ]
        lines.append([str(row["lanes"]), *times, *more])
    return table(header, lines)


def wasted(waste: list[Row]) -> str:
    header = ["spread tenfold", "lanes", "steps", "lock step", "slots", "successful"]
    lines = []
    for row in waste:
        counts = [str(row["lanes"]), f"{row['least']} to {row['most']}"]
        shares = [f"{row['plain']:.2f}", f"{row['slots']:.2f}", f"{row['successful']:.1%}"]
        lines.append([row["name"], *counts, *shares])
    return table(header, lines)


def met(good: bool) -> str:
    return "met" if good else "missed"


def on_cost(rows: list[Row]) -> str:
    costs = [row["work"] for row in rows if row["lanes"] >= 100]
    lanes, error = [row["lanes"] for row in rows][-len(costs) :], max(row["error"] for row in rows)
    spread = max(costs) / min(costs)
    return (
        f"From {lanes[0]} to {lanes[-1]} lanes the processor time of a lane varies {spread:.2f} times "
        f"(asked: {FLAT}, {met(spread <= FLAT)}) at {error:.1e} rad (asked: {TARGET:.0e}, "
        f"{met(error <= TARGET)}); {min(row['successful'] for row in rows):.1%} of the runs succeed."
    )


def on_memory(rows: list[Row]) -> str:
    large = [row for row in rows if row["lanes"] > CHUNK]
    if len(large) < 2:
        return ""
    few, many = large[0], large[-1]
    grown = 2**20 * (many["peak"] - few["peak"]) / (many["lanes"] - few["lanes"])
    return (
        f"From {few['lanes']} to {many['lanes']} lanes peak memory goes from {few['peak']:.0f} to "
        f"{many['peak']:.0f} MiB: {grown:.0f} bytes a lane, where parameter and result are {few['kept']} "
        f"(asked: bounded by the chunk, so at most three copies of these; {met(grown <= 3 * few['kept'])})."
    )


def on_waste(waste: list[Row]) -> str:
    plain, slots = (max(row[key] for row in waste) for key in ("plain", "slots"))
    return (
        f"Lock step gives unlike lanes up to {plain:.2f} times the steps that they need, slots up to "
        f"{slots:.2f} times (asked: {WASTE}, {met(slots <= WASTE)})."
    )


def report(quick: bool = False, *, drawn: bool = False) -> str:
    found = measure(quick)
    if drawn:
        draw(found)
    said, sections = [], [f"![Time per lane against the number of lanes]({FIGURE.name})"]
    for case in CASES:
        rows, waste = found[case.scene]
        sections += [
            f"### {case.scene}, {case.seconds:g} s, {type(case.solver).__name__} at rtol {case.rtol:.0e}",
            batches(rows),
        ]
        sections += [wasted(waste), " ".join([on_memory(rows), on_waste(waste)]).strip()]
        said.append(f"`{case.scene}`: {on_cost(rows)}")
    footer = f"{device()}  \n{versions('jax', 'jaxlib', 'diffrax')}"
    return "\n\n".join([f"**Conclusion.** {' '.join(said)}", *sections, footer])


def draw(found: Found) -> None:
    """Time per lane against lanes, log-log."""
    with plt.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure, axes = plt.subplots(figsize=(6.4, 4.0), layout="constrained")
        lines = {
            "work": ("-", "sweep, processor"),
            "wall": ("--", f"sweep, wall, {os.cpu_count()} cores"),
            "mapped": (":", "one mapped program, processor"),
        }
        for (scene, (rows, _)), colour in zip(found.items(), ("C0", "C3"), strict=True):
            for key, (dashes, name) in lines.items():
                seen = [(row["lanes"], 1e6 * row[key]) for row in rows if key in row]
                axes.loglog(
                    *zip(*seen, strict=True), dashes, c=colour, marker="o", ms=3.5, label=f"{scene}: {name}"
                )
        axes.set(xlabel="lanes", ylabel=r"time per lane [$\mu$s]")
        axes.set_title("What a run costs in a batch", loc="left")
        axes.grid(True, color="0.9", lw=0.6)
        axes.legend(frameon=False, fontsize=7.5)
        figure.savefig(FIGURE, dpi=160)
        plt.close(figure)


if __name__ == "__main__":
    command("lanes", report, drawn="")
