"""READMEs' tables, taken from the benchmark page: nothing there is typed by hand.

`python -m benchmarks.readme` rewrites what stands between the markers of the READMEs, as does every benchmark
that rewrites its section of the page: `table NAME` is a section's table, `conclusions NAME ...` the first
sentences of some sections' conclusions. `tests/test_readme.py` compares.
"""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
QUOTING = ("README.md", "jaxroll/_xla/README.md")
_MARK = re.compile(r"<!-- benchmarks: (\w+) ([\w ]+) -->\n.*?<!-- end -->", re.DOTALL)
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


def quoted(kind: str, names: str, page: str) -> str:
    """What stands between a pair of markers."""
    if kind == "table":
        return table_of(section(page, names))
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
