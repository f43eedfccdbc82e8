"""The rule of `tests.oracles`: nothing in it comes from jaxroll, or from where something of jaxroll may."""

import ast
import collections
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ORACLES = sorted((ROOT / "tests" / "oracles").glob("*.py"))
LIBRARIES = {"numpy", "scipy", "jax"} | sys.stdlib_module_names


def imported(tree):
    """Names of all modules that a file imports, wherever in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "." * node.level + (node.module or "")


def foreign(tree):
    """What an oracle must not import; a relative import is one as well, for it hides where it leads."""
    return [
        name
        for name in imported(tree)
        if name.split(".")[0] not in LIBRARIES
        and name != "tests.oracles"
        and not name.startswith("tests.oracles.")
        or name.split(".")[0] == "importlib"
    ]


@pytest.mark.parametrize("path", ORACLES, ids=lambda path: path.stem)
def test_an_oracle_imports_nothing_of_the_engine(path):
    assert not foreign(ast.parse(path.read_text()))


def test_the_check_sees_what_an_oracle_must_not_import():
    hidden = (
        "import jaxroll as jxr\ndef f():\n    from jaxroll.geometry import Ellipse\nfrom ..helpers import g\n"
    )
    others = "import importlib\nfrom tests.subjects import fingertips\nimport diffrax\nimport numpy as np\n"
    assert len(foreign(ast.parse(hidden))) == 3 and len(foreign(ast.parse(others))) == 3
    assert len(ORACLES) >= 7


def defined(tree):
    """Public names of a module's own."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Assign):
            leaves = (leaf for target in node.targets for leaf in ast.walk(target))
            yield from (leaf.id for leaf in leaves if isinstance(leaf, ast.Name))


# Written twice, because two oracles that judge each other share nothing: one thing, and so one name.
TWICE = {"STEP", "cross_matrix", "quaternion_matrix"}


def test_a_name_means_one_thing_in_all_oracles():
    homes = collections.defaultdict(list)
    for path in ORACLES:
        for name in defined(ast.parse(path.read_text())):
            homes[name].append(path.name)
    assert len(homes) > 50
    assert {name for name, paths in homes.items() if len(paths) > 1} == TWICE


def test_the_page_of_oracles_names_them_all():
    page = ast.get_docstring(ast.parse((ROOT / "tests" / "oracles" / "__init__.py").read_text()))
    assert {path.stem for path in ORACLES} - {"__init__"} == {
        line.split("`")[1] for line in page.splitlines() if line.startswith("| `")
    }


def test_what_files_share_is_found_without_a_changed_path_and_not_in_a_test():
    """Tests and benchmarks are packages below the root, and what they share lies in no test."""
    for path in (*ROOT.glob("tests/**/*.py"), *ROOT.glob("benchmarks/**/*.py")):
        tree = ast.parse(path.read_text())
        changed = [
            node.lineno
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute)
            and node.attr == "path"
            and getattr(node.value, "id", "") == "sys"
        ]
        assert not changed, path
        assert not [name for name in imported(tree) if name.startswith("tests.test_")], path
