"""README says what the benchmark page says."""

import pathlib
import re

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


def test_the_best_of_each_program_is_found_and_the_best_of_all_is_bold():
    rows = [
        "jaxroll | Tsit5 | 2.5",
        "jaxroll | Tsit5, jitted | 0.5",
        "Numba | loop | 12",
        "Numba | other loop | 9.5",
        "SciPy | LSODA | 10",
    ]
    table = "\n".join(["| family | solver | time [ms] |", "| --- | --- | --- |", *(f"| {r} |" for r in rows)])
    page = f"<!-- disc: begin -->\n| a | b |\n|---|---|\n| 1 | 2 |\n\n{table}\n<!-- disc: end -->"
    readme = "<!-- benchmarks: peers disc -->\n<!-- end -->"
    assert "[ms] | 2.5 | **0.5** | 9.5 | 10 |  |  |  |" in rewritten(readme, page)
    assert "[ms] | 2.5 | **0.5** | 9.5 | 9 |  |  |  |" in rewritten(readme, page.replace("| 10 |", "| 9 |"))


def test_hooks_before_a_commit_need_no_network():
    """Every hook is a command of the extra `dev`, on files that there are."""
    text = (ROOT / ".pre-commit-config.yaml").read_text()
    assert set(re.findall(r"repo: (\S+)", text)) == {"local"}
    commands = re.findall(r"entry: (.+?)(?:, language|\n)", text)
    assert len(commands) >= 4 and {c.split()[0] for c in commands} <= {"ruff", "pyright", "pytest"}
    files = [word for command in commands for word in command.split() if word.endswith(".py")]
    assert files and all((ROOT / file).is_file() for file in files)
