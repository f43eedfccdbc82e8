"""The site's pages: code is run and prints what they say, and the reference has every public name."""

import importlib
import pathlib
import pkgutil
import re

import pytest

import jaxroll as jxr
from notebooks.extensions import code_blocks, docstrings, pages, public_names
from tests.helpers import numbers_blurred, slow_among

PAGES = [page for page in code_blocks.written_pages() if code_blocks.blocks(page)]
# Pages whose programs take long to compile.
LONG = [
    "how_to/choose_a_radius.md",
    "how_to/gradient_in_your_own_loop.md",
    "how_to/hand_from_urdf.md",
    "how_to/object_from_a_scan.md",
    "how_to/own_surface_goal_and_scene.md",
    "how_to/own_controller_with_memory.md",
    "how_to/print_a_fingertip.md",
    "how_to/push_at_half_a_second.md",
    "index.md",
    "tour.md",
]


@pytest.mark.parametrize("page", slow_among(PAGES, *LONG, optimised=["tour.md"]))
def test_code_on_a_page_prints_what_the_page_says(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    shown = [block.printed for block in code_blocks.blocks(page)]
    for told, output in zip(shown, code_blocks.printed(page), strict=True):
        assert told is None or (told.strip() and numbers_blurred(told) == numbers_blurred(output))


def test_every_block_of_a_page_is_run_or_named():
    """What is in no language that is run stands on a page whose reason is given."""
    assert len(PAGES) >= 9
    run = {"python", "text", "{code-cell}", "{toctree}", "{include}"}
    for page in code_blocks.written_pages():
        others = code_blocks.languages(page) - run
        allowed = {"bash"} if page in (*code_blocks.RECIPES, "index.md") else set()
        assert others <= allowed, (page, others)
    assert set(code_blocks.RECIPES) <= set(code_blocks.written_pages())
    # The command on the first page is one of README's, which CI runs.
    index, readme = ((code_blocks.HERE / path).read_text() for path in ("index.md", "../README.md"))
    for command in re.findall(r"```bash\n(.*?)```", index, flags=re.S):
        assert command in readme


def test_a_page_that_prints_something_else_is_noticed(tmp_path, monkeypatch):
    monkeypatch.setattr(code_blocks, "HERE", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("```python\nx = 2\nprint(x)\n```\n\n```text\n3\n```\n\n```python\nprint(x + 1)\n```\n")
    first, second = code_blocks.blocks("page.md")
    assert (first.printed, second.printed) == ("3\n", None)
    assert code_blocks.printed("page.md") == ["2\n", "3\n"]
    assert "```text\n2\n```" in code_blocks._rewritten("page.md")


DOCUMENTED = re.findall(
    r"^\.\. auto(?:class|function|data):: (\S+)$", "".join(pages.reference().values()), re.M
)


def test_the_reference_has_every_public_name_once():
    assert len(DOCUMENTED) == len(set(DOCUMENTED)) > 200
    assert set(public_names.public_names()) | set(pages.records()) == set(DOCUMENTED)


def test_no_export_is_missing_from_the_reference():
    """Found another way: by what the packages have when they are imported."""
    documented = {id(value) for value in public_names.public_names().values()}
    assert all(id(getattr(jxr, name)) in documented or name in _MODULES for name in jxr.__all__)
    for name in _MODULES:
        package = importlib.import_module(f"jaxroll.{name}")
        for key, value in vars(package).items():
            own = getattr(value, "__module__", "").startswith("jaxroll") and not key.startswith("_")
            if own and hasattr(package, "__path__"):
                assert id(value) in documented, f"{name}.{key}"


_MODULES = {module.name for module in pkgutil.iter_modules(jxr.__path__) if module.name[0] != "_"}


def test_everything_public_has_a_docstring_that_converts():
    assert not public_names.undocumented()
    for name, value in (public_names.public_names() | pages.records()).items():
        found = docstrings.converted(value.__doc__ or "")
        assert not [part for code, part in docstrings._parts(found) if not code and "$" in part], name


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("of $a_1$ and\n$b$.", "of :math:`a_1` and\n:math:`b`."),
        ("`simulate` and `_step`", ":py:obj:`simulate <jaxroll.simulate>` and ``_step``"),
        ("`jxr.control.Press`", ":py:obj:`jxr.control.Press <jaxroll.control.Press>`"),
        ("|x| and s_ and **bold** a*b", "\\|x\\| and s\\_ and **bold** a\\*b"),
        (">>> f($x$)\n'|'\n\n|", ">>> f($x$)\n'|'\n\n\\|"),
        ("it is\n- one\n- two", "it is\n\n- one\n- two"),
        ("$k$-th, the `State`s", ":math:`k`-th, the :py:obj:`State <jaxroll.State>`\\ s"),
    ],
)
def test_docstrings_become_restructured_text(text, wanted):
    assert docstrings.converted(text) == wanted


def test_formulas_become_paragraphs():
    found = docstrings.converted("It is\n\n    $$ a\n    = b, $$\n\nand so on.")
    assert re.search(r"\n    \.\. math::\n\n        a = b,\n", found) and "$" not in found


@pytest.fixture(scope="module")
def equations_page():
    """The table of equations, for which all of jaxroll is read."""
    return pages.table_of_equations()


def test_pages_are_written_once(tmp_path, monkeypatch, equations_page):
    monkeypatch.setattr(pages, "table_of_equations", lambda: equations_page)
    pages.write(tmp_path)
    files = sorted(tmp_path.rglob("*.*"))
    before = [path.stat().st_mtime_ns for path in files]
    (tmp_path / "reference" / "gone.rst").write_text("of a part that is no more")
    pages.write(tmp_path)
    assert sorted(tmp_path.rglob("*.*")) == files
    assert [path.stat().st_mtime_ns for path in files] == before
    assert len(files) == len(pages.reference()) + 1


def test_the_table_of_equations_links_to_the_reference(equations_page):
    text = equations_page
    assert "{py:obj}`Opposition <jaxroll.control.Opposition>`" in text
    linked = set(re.findall(r"\{py:obj\}`[^<]*<([^>]*)>`", text))
    owners = {name for name in linked if name in DOCUMENTED}
    # The others are members of classes that are documented.
    assert all(name.rpartition(".")[0] in DOCUMENTED for name in linked - owners) and len(owners) > 20


def test_how_tos_are_found_by_the_site():
    """A new file in the folder is on the site without another line."""
    assert "how_to/*" in (code_blocks.HERE / "how_to.md").read_text()
    assert len(list(pathlib.Path(code_blocks.HERE / "how_to").glob("*.md"))) >= 9
