"""README says what the benchmark page says."""

import pathlib

import pytest

from benchmarks.readme import conclusion_of, rewritten, section, table_of

ROOT = pathlib.Path(__file__).parents[1]


def test_tables_are_those_of_the_benchmark_page():
    """`python -m benchmarks.readme` rewrites them."""
    readme, page = (ROOT / name for name in ("README.md", "benchmarks/README.md"))
    text = readme.read_text()
    assert text.count("<!-- benchmarks: ") == text.count("<!-- end -->") >= 4
    assert rewritten(text, page.read_text()) == text


def test_another_number_on_the_page_is_another_one_in_readme():
    said = "**Conclusion.** It takes 3 ms. Good.\n\n| x | y |\n|---|---|\n| 1 | 2 |"
    page = f"<!-- a: begin -->\n{said}\n<!-- a: end -->"
    readme = (
        "<!-- benchmarks: table a -->\nold\n<!-- end -->\n<!-- benchmarks: conclusions a -->\n<!-- end -->"
    )
    wanted = "| x | y |\n|---|---|\n| 1 | 2 |"
    assert table_of(section(page, "a")) == wanted
    assert conclusion_of(section(page, "a")) == "It takes 3 ms. Good"
    found = rewritten(readme, page)
    assert wanted in found and "| `a` | It takes 3 ms. Good |" in found and "old" not in found
    with pytest.raises(LookupError, match="no section b"):
        section(page, "b")
