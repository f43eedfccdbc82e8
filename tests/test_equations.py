"""Every equation and figure of the chapter has a place in the code, and a test; docstrings say which."""

import ast
import re

import pytest

from notebooks.extensions import equations


@pytest.fixture(scope="module")
def table():
    return equations.table()


def test_every_number_of_the_chapter_is_in_the_table(table):
    numbers = [str(n) for n in range(1, 84)] + ["A-1", "A-2"] + [f"Fig. {n}" for n in range(1, 21)]
    assert [row.number for row in table] == numbers


def test_no_equation_and_no_figure_is_missing(table):
    """A function or the reason why there is none, never both; and a test."""
    assert not equations.missing(table)
    assert not [row.number for row in table if row.step and row.functions]


def test_what_is_missing_is_named():
    bare = equations.Row("16", "control", [], [], "", [])
    assert equations.missing([bare]) == ["16: no function", "16: no test"]
    assert equations.missing([bare._replace(step="It is a principle.")]) == ["16: no test"]


def test_every_correction_is_in_the_table(table):
    """A row of the errata without a number that the table knows would be shown nowhere."""
    text = (equations.ROOT / "notebooks" / "errata.md").read_text()
    rows = [line.split("|")[1] for line in text.splitlines() if re.match(r"\| [^-]", line)]
    numbered = [row for row in rows if re.search(r"\(\d+\)|A-\d", row)]
    assert len(numbered) >= 14
    assert all(equations.cited(row)[0] for row in numbered)
    corrected = {row.number for row in table if row.corrections}
    assert {"2", "9", "15", "36", "37", "40", "50", "52", "69", "77", "79", "82", "A-1", "A-2"} <= corrected


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("control (16)-(17), with (20).", {"16", "17", "20"}),
        ("(35) to\n  (37)", {"35", "36", "37"}),
        ("shape (3), SO(3), `f(2)`, p_i(0), $x$(4)", set()),
        ("(84), (0) and (7)", {"7"}),
        ("Figs. 2, 5 and 6", {"Fig. 2", "Fig. 5", "Fig. 6"}),
        ("Figs. 9-11 and 18; A-1", {"Fig. 9", "Fig. 10", "Fig. 11", "Fig. 18", "A-1"}),
    ],
)
def test_what_counts_as_a_citation(text, numbers):
    assert equations.cited(text)[0] == numbers


def test_examples_cite_nothing():
    tree = ast.parse('def f():\n    """(5).\n\n    >>> g (6)\n    """\n')
    assert dict(equations._docstrings(tree)) == {"f": "(5).\n"}


def test_what_a_function_defines_inside_counts_as_its_own(table):
    """A name with a point in it would be that of a test that nobody can run."""
    tree = ast.parse('def f():\n    """(5)."""\n    def g():\n        """(6)."""\n')
    assert dict(equations._docstrings(tree)) == {"f": "(5).\n\n(6)."}
    assert not [place for row in table for place in row.tests if "." in place.name]


def test_every_function_and_test_is_in_its_row(table):
    """None of them is cut off."""
    lines = equations.page(table).splitlines()[2:]
    for row, line in zip(table, lines, strict=True):
        assert all(f"::{place.name}`" in line for place in row.tests), row.number
        assert all(f"`{place.name or place.path}`" in line for place in row.functions), row.number
        assert not re.search(r"and \d+ more", line)


def test_the_table_is_a_table(table):
    lines = equations.page(table).splitlines()
    assert len(lines) == 2 + len(table)
    # Bars inside of a cell would split it.
    assert {len(re.findall(r"(?<!\\)\|", line)) for line in lines} == {6}
