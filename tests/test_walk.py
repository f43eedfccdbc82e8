"""CONTRIBUTING and the benchmark page say how many files a reader opens to follow a call."""

import pathlib
import re
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[1]
MOST_FILES, MOST_LINES = 14, 2000


@pytest.mark.slow  # in a process of its own: what another test has traced is not entered again
def test_as_many_files_are_entered_as_contributing_says():
    command = [sys.executable, "-m", "benchmarks.walk"]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    found = [tuple(map(int, pair)) for pair in re.findall(r": (\d+) files, (\d+) lines", printed)]
    (evaluation, lines), (run, _), (gradient, _) = found
    assert evaluation <= MOST_FILES and lines <= MOST_LINES, printed
    text = " ".join((ROOT / "CONTRIBUTING.md").read_text().split())
    said = re.search(r"evaluation of the equations of motion \((\d+), with at most (\d+) lines\)", text)
    others = re.search(r"in `simulate` \((\d+)\) and in its gradient \((\d+)\)", text)
    assert said is not None and others is not None
    assert tuple(map(int, said.groups() + others.groups())) == (evaluation, MOST_LINES, run, gradient)
    page = (ROOT / "benchmarks" / "README.md").read_text()
    conclusion = printed[printed.index("**Conclusion.**") :]
    assert conclusion.strip() in page, "the page's section is written by `python -m benchmarks.walk --write`"
