"""Scans: a million points, smallest radii of curvature, and what is refused (about fifteen minutes).

`python -m benchmarks.scans --write` rewrites its section of README.md; `--quick`: 100 000 points, and two
scans. Every row is a process of its own, whose peak memory is its own too (read from /proc, so on Linux) and
whose time counts the compiling of what measures. The scans of the shared data are left out where these are
not there; all others are made.
"""

import sys
from typing import Any

from benchmarks._common import command, device, fresh, table, versions
from benchmarks._scan_row import DATA, FITTED, LEVELS, SCANS

COUNT = 10**6
SECONDS, MEMORY, NORMALS, CURVATURE, DEPARTURE = 60.0, 4096.0, 0.3, 0.03, 3e-4
Row = dict[str, Any]


def row(*words: str) -> Row:
    """One row, from a process of its own."""
    found = fresh("benchmarks._scan_row", *words)
    print(f"{' '.join(words)}: {found}", file=sys.stderr, flush=True)
    return found


def millions(count: int) -> tuple[list[list[str]], bool]:
    """Lines of the large clouds, and whether all limits are met."""
    lines, good = [], True
    for name in LEVELS:
        for way in ("plain", "bounded"):
            found = row("million", name, str(count), way)
            good &= found["seconds"] <= SECONDS and found["peak"] <= MEMORY
            good &= found["normals"] <= NORMALS and found["curvature"] <= CURVATURE
            lines.append(
                [name, "3 mm" if way == "bounded" else "", f"{found['seconds']:.0f}", f"{found['work']:.0f}"]
                + [f"{found['peak']:.0f}"]
                + [f"{found['normals']:.3f}", f"{100.0 * found['curvature']:.2f}"]
                + [f"{1e6 * found['points']:.1f}"]
            )
    return lines, good


def scans(names: list[str]) -> tuple[list[list[str]], list[str]]:
    """Lines of the scans, and the names of those that fall short."""
    lines, short = [], []
    for name in names:
        found = row("scan", name)
        bound = f"{1e3 * found['radius']:g}"
        start = [name, bound, str(found["points"]), f"{found['seconds']:.0f}"]
        if "refusal" in found:
            lines.append([*start, "", "", "", "", "", f"refused: {found['refusal']}"])
            if found["expected"] == FITTED:
                short.append(name)
            continue
        sharpest = found["curvature"] * found["radius"]
        fair = found["departure"] <= DEPARTURE and found["reversed"] == 0 and sharpest <= 1.0
        if not fair or found["expected"] != FITTED:
            short.append(name)
        lines.append(
            [*start, f"{1e3 * found['departure']:.3f}", f"{100 * found['free']:.0f} %"]
            + [f"{100 * found['untrusted']:.1f} %", str(found["reversed"]), f"{sharpest:.3f}"]
            + [found["verdict"]]
        )
    return lines, short


def pinched() -> str:
    """The table of the pinch between scans."""
    found = row("pinch")
    least, most = found["forces"]
    lines = [
        ["gap [m]", "<= 1e-12", f"{found['gap']:.1e}"],
        ["tangency", "<= 1e-12", f"{found['tangency']:.1e}"],
        ["energy, by the balance of work", "<= 1e-9", f"{found['energy']:.1e}"],
        ["depth of any sample of one surface in the other [m]", "<= 1e-9", f"{-found['lowest']:.1e}"],
        ["arclengths of both loci apart [m]", "<= 1e-9", f"{found['arclengths']:.1e}"],
        ["length of the loci [mm]", "", f"{1e3 * found['rolled']:.2f}"],
        ["normal forces [N]", "", f"{least:.3f} to {most:.3f}"],
    ]
    return table(["banana between two scanned fingertips, 1 s", "asked", "measured"], lines)


def report(quick: bool = False) -> str:
    """The tables, as Markdown."""
    count = 10**5 if quick else COUNT
    large, good = millions(count)
    there = [name for name in SCANS if not name.startswith(("banana", "potted")) or DATA.exists()]
    names = ["banana, mesh", "bottle"] if quick else there
    small, short = scans([name for name in names if name in there])
    missed = f": all but {', '.join(short)}" if short else ""
    said = (
        f"**Conclusion.** Fits to {count} points {'meet' if good else 'miss'} their limits (60 s, 4 GiB, "
        f"0.3 degrees, 3 %); {len(small) - len(short)} of {len(small)} scans come out as they "
        f"should{missed}. A scan is fitted within 0.3 mm rms where balls of the radius asked for fit, "
        "without reversed normals and with no larger curvature anywhere, or refused where it is thinner than "
        "that."
    )
    first = ["body", "smallest radius", "time [s]", "processor [s]", "peak memory [MiB]"]
    first += ["normals [deg rms]", "curvature [% of the largest, rms]", "places [um rms]"]
    second = ["scan", "radius [mm]", "points", "time [s]", "departure [mm rms]", "where balls fit"]
    second += ["not trusted of that", "reversed", "curvature times radius", "said"]
    return "\n\n".join(
        [
            said,
            table(first, large),
            table(second, small),
            *([] if quick or not DATA.exists() else [pinched()]),
            f"{device()}; {versions('jax', 'numpy', 'scipy')}.",
        ]
    )


if __name__ == "__main__":
    command("scans", report)
