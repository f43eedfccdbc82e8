"""README says what the benchmark page says."""

import pathlib

import pytest

from benchmarks.readme import conclusion_of, QUOTING, rewritten, section, table_of

ROOT = pathlib.Path(__file__).parents[1]


@pytest.mark.parametrize("name", QUOTING)
def test_tables_are_those_of_the_benchmark_page(name):
    """`python -m benchmarks.readme` rewrites them."""
    text, page = ((ROOT / path).read_text() for path in (name, "benchmarks/README.md"))
    assert text.count("<!-- benchmarks: ") == text.count("<!-- end -->") >= 1
    assert rewritten(text, page) == text


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
