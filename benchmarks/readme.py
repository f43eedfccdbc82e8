"""READMEs' tables, taken from the benchmark page: nothing there is typed by hand.

`python -m benchmarks.readme` rewrites what stands between the markers of the READMEs, as does every benchmark
that rewrites its section of the page: `table NAME` is a section's table, `conclusions NAME ...` the first
sentences of some sections' conclusions, `peers NAME ...` the best of every program in some sections' tables.
`tests/test_readme.py` compares.
"""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
QUOTING = ("README.md", "jaxroll/_xla/README.md")
_MARK = re.compile(r"<!-- benchmarks: (\w+) ([\w ]+) -->\n.*?<!-- end -->", re.DOTALL)
# What a section compares programs by: the row's name in README, the column of the figure, that of the
# program, and what a row of the section's table must say to count.
_COMPARED = {
    "work_precision": ("one run, Part 2 to 1e-8 rad [ms]", "time [ms]", "family", ""),
    "disc": ("disc on a plane to 1e-8 m [ms]", "time [ms]", "family", ""),
    "long_pinch": ("20 s of the stiff pinch to 1e-6 rad [ms]", "time [ms]", "family", ""),
    "batch": ("runs per second and core, pivoted", "runs/s per core", "contender", "pivoted"),
}
# Columns of the comparison: the words by which a program's rows begin, and whether that is within `jax.jit`.
_PROGRAMS = {
    "jaxroll": ("jaxroll", False),
    "in `jax.jit`": ("jaxroll", True),
    "Numba, by hand": ("Numba", False),
    "SciPy": ("SciPy", False),
    "SUNDIALS": ("SUNDIALS", False),
    "Exudyn": ("Exudyn", False),
    "diffrax": ("plain diffrax", False),
}
# A cell holds sentences up to this length.
_LONGEST = 420


def section(page: str, name: str) -> str:
    """What the benchmark page says in one section."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    if begin not in page or end not in page:
        raise LookupError(f"the benchmark page has no section {name}")
    return page.split(begin, 1)[1].split(end, 1)[0].strip()


def table_of(text: str) -> str:
    """The first table of a section."""
    rows = re.search(r"(?:^\|.*\n?)+", text, re.MULTILINE)
    if rows is None:
        raise LookupError("a section that is quoted has no table")
    return rows.group(0).strip()


def conclusion_of(text: str) -> str:
    """The first sentences of a section's conclusion, on one line."""
    found = re.search(r"\*\*Conclusion\.\*\* (.*?)(?:\n\n|$)", text, re.DOTALL)
    if found is None:
        raise LookupError("a section that is quoted has no conclusion")
    sentences = re.split(r"(?<=[a-z0-9)`])\. (?=[A-Za-z*`])", " ".join(found.group(1).split()))
    told = sentences[0]
    for sentence in sentences[1:]:
        if len(told) + len(sentence) > _LONGEST:
            break
        told += f". {sentence}"
    return told.rstrip(".").replace("|", "\\|")


def rows_of(table: str) -> list[dict[str, str]]:
    """The rows of a table, by the names of its columns."""
    head, _, *rows = ([cell.strip() for cell in line.strip("| ").split(" | ")] for line in table.splitlines())
    return [dict(zip(head, row, strict=False)) for row in rows]


def best_of(table: str, program: str, column: str, who: str, said: str) -> str:
    """The least time of a program in a section's table, or its most runs; empty where it has no row."""
    begins, within = _PROGRAMS[program]
    found = [
        row[column]
        for row in rows_of(table)
        if row[who].startswith(begins)
        and ("jitted" in row.get("solver", "")) == within
        and (not said or said in " ".join(row.values()))
    ]
    return (max if "/s" in column else min)(found, key=float, default="")


def compared(names: str, page: str) -> str:
    """The best of every program, section by section; the best of a row is bold."""
    lines = ["| | " + " | ".join(_PROGRAMS) + " |", "|---" * (len(_PROGRAMS) + 1) + "|"]
    for name in names.split():
        title, column, who, said = _COMPARED[name]
        tables = re.findall(r"(?:^\|.*\n?)+", section(page, name), re.MULTILINE)
        table = next(t for t in tables if f"| {who} |" in t and f"| {column} |" in t)
        cells = [best_of(table, program, column, who, said) for program in _PROGRAMS]
        best = (max if "/s" in column else min)(filter(None, cells), key=float)
        lines.append(f"| {title} | " + " | ".join(f"**{c}**" if c == best else c for c in cells) + " |")
    return "\n".join(lines)


def quoted(kind: str, names: str, page: str) -> str:
    """What stands between a pair of markers."""
    if kind == "table":
        return table_of(section(page, names))
    if kind == "peers":
        return compared(names, page)
    rows = [f"| `{name}` | {conclusion_of(section(page, name))} |" for name in names.split()]
    return "\n".join(["| `python -m benchmarks.` | what came of it |", "|---|---|", *rows])


def rewritten(readme: str, page: str) -> str:
    """README with what it quotes of the benchmark page."""

    def replaced(match: re.Match[str]) -> str:
        kind, names = match.group(1), match.group(2)
        head = match.group(0).split("\n", 1)[0]
        return f"{head}\n{quoted(kind, names, page)}\n<!-- end -->"

    return _MARK.sub(replaced, readme)


def main() -> None:
    page = (ROOT / "benchmarks" / "README.md").read_text()
    for name in QUOTING:
        path = ROOT / name
        path.write_text(rewritten(path.read_text(), page))


if __name__ == "__main__":
    main()
