"""Everything shown is executed: docstrings, README, notebooks, the command line."""

import contextlib
import doctest
import importlib
import io
import itertools
import json
import os
import pathlib
import pkgutil
import re
import subprocess
import sys

import jax
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

import jaxroll as jxr
from jaxroll.__main__ import _page, DEMOS, main
from jaxroll.plotting import _page as _page_module
from jaxroll.plotting._style import LOCUS_OBJECT, LOCUS_TIP
from tests.helpers import numbers_blurred, slow_among
from tests.recorded import runs

ROOT = pathlib.Path(__file__).parent.parent
MODULES = [
    name for _, name, _ in pkgutil.walk_packages(jxr.__path__, "jaxroll.") if name != "jaxroll.__main__"
]


# Examples whose scenes take long to compile; other tests run what is in them.
LONG = [
    "jaxroll.design._measures",
    "jaxroll._analysis._loci",
    "jaxroll._integration._rosenbrock",
    "jaxroll.design._fingertip",
    "jaxroll.plotting._design_figure",
    "jaxroll.plotting._loci_figure",
    "jaxroll.scenes._plane_scenes",
    "jaxroll.scenes._space_scenes",
    "jaxroll.stability._statics",
]


@pytest.mark.parametrize("name", slow_among(MODULES, *LONG))
def test_docstring_examples(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(name)
    result = doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.failed == 0


def test_there_are_docstring_examples():
    finder = doctest.DocTestFinder()
    tests = (t for n in MODULES for t in finder.find(importlib.import_module(n)) if t.examples)
    assert len(list(itertools.islice(tests, 12))) == 12


def readme_examples():
    """The README's Python blocks and the output printed below each."""
    text = (ROOT / "README.md").read_text()
    return re.findall(r"```python\n(.*?)```\n+```text\n(.*?)```", text, flags=re.S)


@pytest.mark.slow
@pytest.mark.optimised
def test_readme_examples_print_what_they_say():
    names = {}
    for code, printed in readme_examples():
        assert len(code.strip().splitlines()) <= 18
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(compile(code, "README.md", "exec"), names)
        assert numbers_blurred(out.getvalue()) == numbers_blurred(printed)


NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.mark.slow
@pytest.mark.optimised
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_is_stored_without_outputs(path, monkeypatch):
    import nbformat
    from nbclient import NotebookClient

    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", jax.config.jax_compilation_cache_dir)
    least = jax.config.jax_persistent_cache_min_compile_time_secs
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", str(least))
    stored = json.loads(path.read_text())
    cells = [c for c in stored["cells"] if c["cell_type"] == "code"]
    assert all(not c["outputs"] and c["execution_count"] is None for c in cells)
    book = nbformat.read(path, as_version=4)
    # Against hanging alone: a cell takes seconds, on a machine with much else to do twenty times as long.
    NotebookClient(book, timeout=1200, kernel_name="python3", record_timing=False).execute()
    if folder := os.environ.get("JAXROLL_EXECUTED"):  # for the site, which need not run it again
        pathlib.Path(folder).mkdir(parents=True, exist_ok=True)
        nbformat.write(book, pathlib.Path(folder) / path.name)
    images = [
        o for c in book.cells if c.cell_type == "code" for o in c.outputs if "image/png" in o.get("data", {})
    ]
    assert len(images) >= 3


def run_cli(*args, cwd):
    env = os.environ | {"JAXROLL_CACHE": os.environ.get("JAXROLL_TEST_CACHE", str(cwd / "cache"))}
    return subprocess.run(
        [sys.executable, "-m", "jaxroll", *args],
        cwd=cwd,
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )


def test_demo_writes_its_figures_and_a_report(tmp_path, monkeypatch, capsys):
    """Figs. 4, 7 and 8, and Figs. 9-18 on one page."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    assert main(["demo", "--seconds", "0.2"]) == 0
    told = capsys.readouterr().out
    folder = tmp_path / "jaxroll-pivoted"
    files = {p.name: p.stat().st_size for p in folder.iterdir()}
    assert {
        "fig07_contours.png",
        "fig08_poses.png",
        "fig09_18_responses.png",
        "motion.gif",
        "run.npz",
    } <= files.keys()
    assert all(size > 5_000 for size in files.values())
    assert "jaxroll-pivoted" in told and "successful" in told
    assert len(told.splitlines()) <= 30 and max(map(len, told.splitlines())) <= 100


@pytest.mark.slow
@pytest.mark.optimised
def test_pinch_demo_writes_its_figures_and_a_report(tmp_path):
    """Figs. 1 and 3, and what the chapter has no figures of."""
    done = run_cli("demo", "pinch", "--seconds", "1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    files = {p.name: p.stat().st_size for p in (tmp_path / "jaxroll-pinch").iterdir()}
    drawn = {"contours.png", "fig01_poses.png", "responses.png", "phase.png", "motion.gif", "run.npz"}
    assert drawn == files.keys() and all(size > 5_000 for size in files.values())
    for words in ("successful", "verdict", "neutral directions: 1", "Delta N_i", "dissipated"):
        assert words in done.stdout
    assert len(done.stdout.splitlines()) <= 30 and max(map(len, done.stdout.splitlines())) <= 100


@pytest.mark.slow
@pytest.mark.optimised
def test_pinch3d_demo_writes_its_figures_and_a_report(tmp_path):
    """Figs. 19 and 20: the pose with its loci."""
    done = run_cli("demo", "pinch3d", "--seconds", "0.3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    files = {p.name: p.stat().st_size for p in (tmp_path / "jaxroll-pinch3d").iterdir()}
    drawn = {"responses.png", "loci.png", "pose.png", "motion.gif", "run.npz"}
    assert drawn == files.keys() - {"page.html"} and all(size > 5_000 for size in files.values())
    assert ("page.html" in files) != ("no page.html" in done.stdout)
    for words in ("successful", "|lambda_i| / f_i", "A-2", "dissipated"):
        assert words in done.stdout
    assert len(done.stdout.splitlines()) <= 30 and max(map(len, done.stdout.splitlines())) <= 100
    with Image.open(tmp_path / "jaxroll-pinch3d" / "motion.gif") as image:
        image.seek(image.n_frames - 1)
        last = np.asarray(image.convert("RGB"), int)
    for colour in (LOCUS_TIP, LOCUS_OBJECT):  # in the picture, above the legend
        seen = np.abs(last - 255 * np.array(to_rgb(colour))).max(axis=-1) < 6
        assert seen[: len(last) * 3 // 4].sum() > 20


def test_the_command_line_says_how_to_get_a_page(monkeypatch, tmp_path):
    monkeypatch.setattr(_page_module, "plotly_door", _no_plotly)
    grasp, _ = runs.scene("incline")
    names = []
    told = _page(
        DEMOS["pinch3d"], tmp_path, names, plotting=jxr.plotting, grasp=grasp, run=runs.run("incline")
    )
    assert told == ["  no page.html: this needs plotly"] and not names and not list(tmp_path.iterdir())


def _no_plotly():
    raise ImportError("this needs plotly")


@pytest.mark.slow
@pytest.mark.optimised
def test_design_ends_with_a_fingertip_that_holds(tmp_path):
    done = run_cli("design", "--steps", "100", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    files = {p.name: p.stat().st_size for p in (tmp_path / "jaxroll-design").iterdir()}
    drawn = {"design.png", "comparison.png", "before.gif", "after.gif", "fingertip.csv", "fingertip.stl"}
    assert drawn <= files.keys() and all(size > 5_000 for size in files.values())
    lines = done.stdout.splitlines()
    before, after = (
        next(line for line in lines if line.startswith(f"  {word} ")) for word in ("before", "after")
    )
    assert "more friction than there is" in before and after.split() == ["after", "successful"]
    assert len(lines) <= 30 and max(map(len, lines)) <= 120
    # Its own outline is a start as good as any.
    again = run_cli(
        "design", "--tip", "jaxroll-design/fingertip.csv", "--steps", "10", "--no-animation", cwd=tmp_path
    )
    assert again.returncode == 0, again.stderr


def test_an_outline_that_is_not_there_gets_one_sentence(tmp_path):
    """From a process of its own; what else gets one, and leaves no folder, is in `test_cli`."""
    done = run_cli("design", "--tip", "nothing.csv", cwd=tmp_path)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "nothing.csv" in done.stderr.splitlines()[-1] and not list(tmp_path.glob("jaxroll-*"))


@pytest.mark.slow
def test_figures_are_drawn_for_grasps_that_are_not_the_chapters(tmp_path):
    """Two fingers on a free disc, no Press control: what is there is drawn."""
    left = jxr.Finger([0.05, 0.05], [0.05, 0.04], tip=jxr.Circle(0.01), base=(-0.08, 0.0))
    right = jxr.Finger([0.05, 0.05], [0.05, 0.04], tip=jxr.Circle(0.01), base=(0.08, 0.0))
    disc = jxr.FreeObject(jxr.Circle(0.02), mass=0.05, inertia=1e-5)
    contacts = (
        jxr.Contact(0.0, 0.02 * np.pi, finger=0),
        jxr.Contact(0.01 * np.pi, 0.0, finger=1, sense=-1),
    )
    grasp = jxr.Grasp(disc, (left, right), contacts)
    guess = jxr.State(np.array([0.0, 0.08, 0.0, 1.6, -1.2, 1.5, 1.3]), np.zeros(7), np.zeros(2))
    grasp, state = jxr.close(grasp, guess, hold_contacts=False)
    run = jxr.simulate(grasp, state, 0.02, ts=5, throw=False)
    figure = jxr.plotting.responses(grasp, run, folder=tmp_path)
    assert figure.axes and list(tmp_path.glob("*.png"))
