"""`jaxroll sweep` and `jaxroll map`: orders from options and files, tables, pictures of them."""

import argparse
import contextlib
import csv
import inspect
import re
import sys
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll import scenes
from jaxroll.__main__ import _parser, main
from jaxroll._cli import _sweep_command, _sweep_order, _sweep_table
from jaxroll._cli._sweep_command import maker, parameters_of
from jaxroll._cli._sweep_order import _ENDS, _FILE, _fits, map_order, Range, SCENES, sweep_order, unit_of
from jaxroll._cli._sweep_table import read_table
from jaxroll.plotting import map_page, parameter_map
from tests.subjects.swinging_plate import swinging

FILE = """
scene = "pivoted"
number = 12
sampling = "latin"
keep = ["result"]
[set]
damping = "0.002:0.02:log"
force = [0.4, 0.5]
"""


def ordered(*arguments):
    return sweep_order(_parser().parse_args(["sweep", *arguments]))


def test_every_scene_can_be_swept():
    able = [name for name in dir(scenes) if inspect.isfunction(getattr(scenes, name))]
    assert set(SCENES) == set(able) - {"rectangle", "cuboid", "spheroid", "pinch_object"}


def test_ranges_are_read_as_they_are_written():
    found = ordered(
        "pinch", "--set", "a=1:2", "--set", "b=1:2:5", "--set", "c=1:2:log", "--set", "d=1:4:3:log"
    )
    assert found.ranges == {
        "a": Range(1.0, 2.0),
        "b": Range(1.0, 2.0, 5),
        "c": Range(1.0, 2.0, None, True),
        "d": Range(1.0, 4.0, 3, True),
    }
    found = ordered("pinch", "--set", "a=1,2.5,-3", "--set", "b=1e-3")
    assert found.ranges == {"a": Range(values=(1.0, 2.5, -3.0)), "b": Range(values=(1e-3,))}


def test_a_grid_has_as_many_runs_as_are_asked_for():
    """Along ranges without a number of values of their own, as many along each."""
    rows = parameters_of(
        ordered("pinch", "--set", "a=0:1:4", "--set", "b=1:100:log", "--set", "c=0:1", "--number", "100")
    )
    assert rows.shape == (4, 5, 5)
    np.testing.assert_allclose(rows.axis("b"), [1.0, 10**0.5, 10.0, 10**1.5, 100.0])
    assert parameters_of(ordered("pinch", "--set", "damping=0:1", "--set", "q=3")).shape == (1024, 1)


def test_what_the_command_line_says_comes_before_the_file(tmp_path):
    file = tmp_path / "sweep.toml"
    file.write_text(FILE)
    found = ordered("--file", str(file), "--number", "20", "--set", "force=0.6")
    assert (found.scene, found.number, found.sampling, found.keep) == ("pivoted", 20, "latin", ("result",))
    assert found.ranges == {"damping": Range(0.002, 0.02, None, True), "force": Range(values=(0.6,))}
    rows = parameters_of(ordered("--file", str(file)))
    assert rows.shape == (12, 2) and rows.units == {"damping": "N m s", "force": "N"}
    assert rows.damping.min() >= 0.002 and rows.damping.max() <= 0.02 and set(rows.force) == {0.4, 0.5}


def test_every_number_that_a_scene_takes_has_a_unit():
    other = {"object", "fingers", "friction", "tips", "tip", "contour", "count", "size"}
    able = [getattr(scenes, name) for name in SCENES]
    assert all(map(inspect.isfunction, able))
    for scene in able:
        assert [name for name in inspect.signature(scene).parameters if not unit_of(name)] == [
            name for name in inspect.signature(scene).parameters if name in other
        ]
    found = {"beta": "N/m", "s": "m", "slope": "rad", "rate": "rad/s", "gravity": "m/s^2", "climb": "m/s"}
    assert {name: unit_of(name) for name in found} == found


BAD = {
    "no scene": (["--set", "a=1:2"], "argument SCENE must be given"),
    "unknown scene": (["dance", "--set", "a=1:2"], "argument SCENE must be one of pivoted"),
    "no such file": (["none.py:make", "--set", "a=1:2"], "argument SCENE must be one of"),
    "nothing to set": (["pinch"], "argument --set must be given"),
    "no name": (["pinch", "--set", "1:2"], "argument --set must be NAME=VALUES, but was '1:2'"),
    "a name twice": (
        ["pinch", "--set", "a=1", "--set", "a=1:2"],
        "must be given once for a, but was for 1:2",
    ),
    "no number": (["pinch", "--set", "a=1:x"], "argument --set must give a finite numbers, but one was 'x'"),
    "NaN": (["pinch", "--set", "a=nan"], "argument --set must give a finite numbers"),
    "falling": (["pinch", "--set", "a=2:1"], "argument --set must give a a range that goes up"),
    "level": (["pinch", "--set", "a=2:2"], "argument --set must give a a range that goes up"),
    "log of zero": (["pinch", "--set", "a=0:1:log"], "a range that goes up above zero"),
    "half a value": (["pinch", "--set", "a=0:1:2.5"], "argument --set must give a a COUNT"),
    "too many parts": (["pinch", "--set", "a=0:1:2:3"], "argument --set must give a as LOW:HIGH"),
    "count of samples": (["pinch", "--set", "a=0:1:3", "--sampling", "sobol"], "a has a COUNT"),
    "samples of nothing": (["pinch", "--set", "a=1", "--sampling", "latin"], "but there is none"),
    "number beside counts": (
        ["pinch", "--set", "a=0:1:3", "--number", "9"],
        "argument --number must be left out",
    ),
    "store of rounds": (
        ["pinch", "--set", "a=0:1", "--sampling", "adaptive", "--store", "a.zarr"],
        "argument --store must be left out with --sampling adaptive",
    ),
    "rounds without a code": (
        ["pinch", "--set", "a=0:1", "--sampling", "adaptive", "--keep", "t_end", "steps"],
        "argument --keep must have result or first_event .* but was t_end steps",
    ),
    "workers": (["pinch", "--set", "a=0:1", "--workers", "0"], "must be a whole number between 1 and 1024"),
    "sampling": (["pinch", "--set", "a=0:1", "--sampling", "dense"], "invalid choice: 'dense'"),
    "tolerance": (["pinch", "--set", "a=0:1", "--rtol", "1"], "must lie between 1e-13 and 0.01"),
    "no file": (["--file", "none.toml"], "argument --file must name a file that can be read"),
    "no TOML": (["--file", "bad.toml"], "argument --file must be in TOML"),
    "unknown entry": (["--file", "entry.toml"], "argument --file must hold scene, .* has 'scenes'"),
    "kind of entry": (["--file", "kind.toml"], "argument --file must give a number as on the command line"),
}
FILES = {
    "bad.toml": "scene = pinch",
    "entry.toml": "scenes = 'pinch'",
    "kind.toml": "scene = 'pinch'\nnumber = 2.5\n[set]\na = '0:1'",
}


@pytest.mark.parametrize("case", BAD)
def test_an_order_that_does_not_fit_is_one_line(case, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    arguments, words = BAD[case]
    assert main(["sweep", *arguments]) == 2
    out, complaint = capfd.readouterr()
    assert out == "" and len(complaint.splitlines()) == 1 and re.search(words, complaint), complaint
    assert not (tmp_path / "jaxroll-sweep").exists()


def test_a_refusal_after_loading_leaves_no_folder(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    assert main(["sweep", "pivoted", "--set", "damping=0.004", "--keep", "nonsense"]) == 2
    assert "argument --keep must be among result" in capfd.readouterr().err
    assert not list(tmp_path.iterdir())
    # What only the scene knows is refused after the folder of its runs was made.
    assert main(["sweep", "pivoted", "--set", "pivot=0.03", "--out", "a/b"]) == 2
    assert "argument --set pivot must have shape (2)" in capfd.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["tip_radius", "friction", "mass"])
def test_a_value_that_the_scene_refuses_is_none_to_run(name, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    monkeypatch.setattr(_sweep_command, "sweep", lambda *_, **__: pytest.fail("it was run"))
    assert main(["sweep", "pinch", "--set", f"{name}=-0.01:0.01:3"]) == 2
    assert f"argument --set {name} must be positive, but was -0.01" in capfd.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_name_is_looked_for_in_the_scene():
    """Numbers of the controller without building it anew, and tips whose foremost points stay."""
    rows = jxr.Parameters(damping=[0.004], friction=[0.3], mass=[0.05], tip_radius=[0.006])
    grasp, state = maker("pinch", rows.names)(rows[0])
    usual, _ = scenes.pinch()
    np.testing.assert_allclose(grasp.controller.damping, 0.004)
    assert float(grasp.object.mass) == 0.05 and float(grasp.contacts[0].friction) == 0.3
    for old, new in zip(usual.fingers, grasp.fingers, strict=True):
        assert float(new.tip.curvature(0.0)) == pytest.approx(1.0 / 0.006)
        np.testing.assert_allclose(new.tip.point(0.0), old.tip.point(0.0), rtol=0, atol=1e-12)
    left = jxr.residuals(grasp, state)
    assert all(float(np.abs(x).max()) < 1e-12 for x in (left.normal, left.tangential, left.tangency))
    alone = scenes.pinch(damping=0.004)
    changed = maker("pinch", ("damping",))(jxr.Parameters(damping=[0.004])[0])
    np.testing.assert_array_equal(changed[1].q, alone[1].q)
    np.testing.assert_array_equal(changed[0].controller.damping, alone[0].controller.damping)
    with pytest.raises(ValueError, match="argument --set must name one of s, base, .*damping.* but was NOPE"):
        maker("pivoted", ("NOPE",))
    with pytest.raises(
        ValueError, match="argument --set must give tip_radius to a scene that takes fingertips"
    ):
        maker("pivoted", ("tip_radius",))


def test_names_are_those_that_ones_own_scene_takes(tmp_path):
    (tmp_path / "own.py").write_text(
        "def egg(mass, size=1.0): ...\ndef any_of(**given): ...\ndef fixed(): ..."
    )
    egg = f"{tmp_path / 'own.py'}:egg"
    with pytest.raises(
        ValueError, match="argument --set must name what .*egg takes, mass, size, but .*'masss'"
    ):
        maker(egg, ("mass", "masss"))
    with pytest.raises(
        ValueError, match="argument --set must name .* but missing a required argument: 'mass'"
    ):
        maker(egg, ("size",))
    with pytest.raises(
        ValueError, match="argument --set must name what .*fixed takes, nothing, but .*'size'"
    ):
        maker(f"{tmp_path / 'own.py'}:fixed", ("size",))
    maker(egg, ("size", "mass"))
    maker(f"{tmp_path / 'own.py'}:any_of", ("size",))


def test_a_damaged_table_is_one_of_the_folder_that_was_named(tmp_path, capfd):
    (tmp_path / "table.npz").write_bytes(b"PK")
    assert main(["map", str(tmp_path)]) == 2
    told = "argument STORE must name a file that `jaxroll.save` wrote, but table.npz could not be read as one"
    assert told in capfd.readouterr().err


def test_a_map_is_written_beside_a_store_of_zarr_and_into_a_folder(tmp_path):
    for name in ("plain", "array.zarr"):
        (tmp_path / name).mkdir()
    (tmp_path / "array.zarr" / "zarr.json").write_text("{}")
    for name, beside in (("plain", tmp_path / "plain"), ("array.zarr", tmp_path)):
        options = argparse.Namespace(
            store=str(tmp_path / name), show=None, x=None, y=None, at=["b=2"], out=None
        )
        order = map_order(options)
        assert order.out == str(beside) and order.at == {"b": 2.0} and order.store == str(tmp_path / name)
        options.out = "elsewhere"
        assert map_order(options).out == "elsewhere"


def test_a_sweep_and_its_map(tmp_path, monkeypatch, capfd):
    """From the command line, over a scene of one's own: table, text, picture and page."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    (tmp_path / "own.py").write_text(
        "from tests.subjects.swinging_plate import swinging\nGRASP, STATE = swinging()\n"
        "def make(damping, stiffness):\n"
        "    return GRASP.with_(damping=damping, stiffness=stiffness), STATE\n"
    )
    ranges = ["--set", "damping=0.4:0.8:3", "--set", "stiffness=4,5"]
    order = ["sweep", "own.py:make", *ranges, "--seconds", "0.2", "--keep", "result", "final_pose", "t_end"]
    assert main(order) == 0, capfd.readouterr().err
    out, err = capfd.readouterr()
    assert "6 successful" in out and "6 of 6 runs" in err and "table.npz, table.csv" in out
    # What a further call goes on from lies in a folder of its own, beside the tables.
    assert {path.name for path in (tmp_path / "jaxroll-sweep").iterdir()} == {
        "chunks",
        "table.npz",
        "table.csv",
    }
    table = read_table(tmp_path / "jaxroll-sweep")
    assert table.parameters.shape == (3, 2) and table.values["final_pose"].shape == (6, 4)
    last = jxr.simulate(*swinging(damping=0.8, stiffness=4.0), 0.2, rtol=1e-6).last.q
    np.testing.assert_allclose(table.values["final_pose"][4], last, rtol=0, atol=1e-7)
    with (tmp_path / "jaxroll-sweep" / "table.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 6 and {line["result"] for line in lines} == {"successful"}
    written = [float(line["final_pose[0]"]) for line in lines]
    np.testing.assert_array_equal(written, table.values["final_pose"][:, 0])
    pytest.importorskip("plotly")
    assert main(["map", "jaxroll-sweep", "--show", "final_pose[0]", "--out", "drawn"]) == 0
    assert {path.suffix for path in (tmp_path / "drawn").iterdir()} == {".png", ".html"}
    assert main(["map", "jaxroll-sweep", "--show", "speed"]) == 2
    assert "argument --show must be one of final_pose[0]" in capfd.readouterr().err
    assert main(["map", "none"]) == 2 and main(["map", "drawn"]) == 2
    complaints = capfd.readouterr().err
    assert "argument STORE must name the folder of a sweep" in complaints
    assert "argument STORE must be the folder of a sweep that is done" in complaints


def test_what_a_scene_of_ones_own_makes_without_its_parameters_is_known_to_it(tmp_path):
    """The scene of the how-to was refused: `pinch_object` takes no numbers that JAX is tracing."""
    (tmp_path / "disc.py").write_text(
        "import jaxroll as jxr\n"
        "def disc(force, damping):\n"
        "    body = jxr.FreeObject.uniform(jxr.Circle(0.015), density=20.0)\n"
        "    grasp, state = jxr.scenes.pinch_object(body)\n"
        "    return grasp.with_(damping=damping * force), state\n"
    )
    make = maker(f"{tmp_path}/disc.py:disc", ("damping", "force"))
    given = jxr.Parameters(damping=np.array([0.002, 0.02]), force=np.array([2.0, 3.0]))
    grasp, state = jax.jit(jax.vmap(make))(given)
    np.testing.assert_allclose(grasp.controller.damping[:, 0], [0.004, 0.06], rtol=1e-12)
    assert state.q.shape == (2, 8)


def test_a_scene_of_ones_own_may_lie_anywhere_and_import_what_lies_beside_it(tmp_path, monkeypatch):
    """As where Python runs it: no neighbours were found, and annotations in words ended dataclasses."""
    monkeypatch.syspath_prepend(str(tmp_path / "elsewhere"))  # afterwards the path is as it was
    (tmp_path / "beside_it.py").write_text("DAMPING = 0.25\n")
    (tmp_path / "study.py").write_text(
        "from __future__ import annotations\nfrom dataclasses import dataclass\n"
        "import jaxroll as jxr\nfrom beside_it import DAMPING\n"
        "@dataclass\nclass Numbers:\n    force: float = 3.0\n"
        "def make(damping):\n    grasp, state = jxr.scenes.pivoted()\n"
        "    return grasp.with_(damping=damping * DAMPING, force=Numbers().force), state\n"
    )
    grasp, _ = maker(f"{tmp_path}/study.py:make", ("damping",))(jxr.Parameters(damping=np.array([0.02]))[0])
    assert (float(grasp.controller.damping), float(grasp.controller.force)) == (0.005, 3.0)
    assert "study" not in sys.modules  # workers are sent its functions, not its name
    (tmp_path / "broken.py").write_text("import nothing_of_this_name\n")
    with pytest.raises(ValueError, match="SCENE must name a file that runs, but .* raised ModuleNotFound"):
        maker(f"{tmp_path}/broken.py:make", ())


@pytest.fixture(scope="module")
def grid():
    return jxr.Parameters.grid(
        a=np.geomspace(1.0, 100.0, 5), b=np.linspace(0.0, 1.0, 4), c=[1.0, 2.0, 3.0]
    ).with_units(a="m")


def slipping_above(b):
    """Codes of rows."""
    codes = jxr.RESULTS
    return jax.vmap(lambda x: codes.where(x > 0.5, codes.slipping, codes.successful))(b)


def drawn(figure):
    """Numbers of the cells, by rows from below."""
    return figure.axes[0].collections[0].get_array()


def test_a_map_shows_the_slice_that_is_asked_for(grid):
    values = grid.a + 10.0 * grid.b + 1000.0 * grid.c
    figure = parameter_map(grid, values, at={"c": 2.9}, label="height [m]")
    ax = figure.axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_xscale(), ax.get_yscale()) == (
        "a [m]",
        "b",
        "log",
        "linear",
    )
    assert ax.get_title(loc="left") == "c = 3" and figure.axes[1].get_ylabel() == "height [m]"
    expected = grid.axis("a")[None, :] + 10.0 * grid.axis("b")[:, None] + 3000.0
    np.testing.assert_allclose(drawn(figure), expected)
    turned = parameter_map(grid, grid.shaped(values), x="c", y="a")
    np.testing.assert_allclose(drawn(turned), grid.shaped(values)[:, 2, :])
    assert turned.axes[0].get_title(loc="left") == "b = 0.6667"


def test_codes_have_colours_and_names_with_their_shares(grid):
    codes = slipping_above(grid.b)
    figure = parameter_map(grid, codes)
    told = [text.get_text() for text in figure.legends[0].get_texts()]
    assert told == ["successful, 50 %", "slipping, 50 %"]
    np.testing.assert_array_equal(drawn(figure)[:, 0], [0, 0, 1, 1])


def test_what_is_no_number_is_told(grid):
    figure = parameter_map(grid, np.where(grid.b > 0.9, np.nan, grid.a))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["no number, 25 %"]
    assert drawn(figure).mask[3].all() and not drawn(figure).mask[:3].any()


def test_samples_are_dots():
    some = jxr.Parameters.sobol(64, a=(0.0, 1.0), b=(1.0, 100.0, "log"), c=(0.0, 1.0))
    figure = parameter_map(some, some.a)
    dots = figure.axes[0].collections[1]
    np.testing.assert_allclose(dots.get_offsets(), np.stack([some.a, some.b], axis=1))
    assert figure.axes[0].get_yscale() == "log" and figure.axes[0].get_xscale() == "linear"
    assert figure.axes[0].get_title(loc="left") == "c between its bounds"


def test_a_page_of_a_map_holds_its_numbers(grid, tmp_path):
    pytest.importorskip("plotly")
    codes = slipping_above(grid.b)
    text = map_page(grid, codes, tmp_path / "new" / "map.html", title="Some pinches").read_text()
    assert "Some pinches" in text and "slipping" in text and '"type":"heatmap"' in text.replace(" ", "")
    some = jxr.Parameters.sobol(16, a=(0.0, 1.0), b=(0.0, 1.0))
    assert "scattergl" in map_page(some, some.a, tmp_path / "dots.html").read_text()


UNFIT = {
    "parameters": ({"parameters": 3}, "argument parameters must be Parameters"),
    "one that changes": ({"parameters": jxr.Parameters(a=[1.0, 2.0])}, "argument parameters must have two"),
    "values": ({"values": np.ones(3)}, "argument values must be one number or code for each of the 60 rows"),
    "x": ({"x": "q"}, "argument x must be a parameter of one number that changes"),
    "y": ({"x": "a", "y": "a"}, "argument y must be another parameter than x"),
    "at a side": ({"at": {"a": 1.0}}, "argument at must hold parameters that are no side"),
    "at no number": ({"at": {"c": "x"}}, "argument at must hold parameters that are no side"),
    "at no name": ({"at": 3.0}, "argument at must say by name"),
    "label": ({"label": 3}, "argument label must be text"),
}


@pytest.mark.parametrize("case", UNFIT)
def test_a_map_that_does_not_fit(case, grid):
    changes, words = UNFIT[case]
    with pytest.raises(ValueError, match=words):
        parameter_map(**{"parameters": grid, "values": grid.a} | changes)


def test_entries_of_a_file_have_the_ends_of_their_options():
    options = next(a for a in _parser()._actions if isinstance(a, argparse._SubParsersAction)).choices[
        "sweep"
    ]
    for name, ends in _ENDS.items():
        kind, convert = _FILE[name], options._option_string_actions[f"--{name}"].type
        for value, beyond in zip(
            ends, (ends[0] / 2 if kind is float else ends[0] - 1, 2 * ends[1]), strict=True
        ):
            assert convert(str(kind(value))) == value and _fits(name, kind, kind(value))
            assert not _fits(name, kind, kind(beyond))
            with pytest.raises(argparse.ArgumentTypeError):
                convert(str(kind(beyond)))
    assert (
        _fits("seconds", float, 3) and not _fits("seconds", float, True) and not _fits("seconds", float, "3")
    )
    assert not _fits("times", int, 3.5) and not _fits("times", int, True)
    assert _fits("keep", list, ["settling"]) and not any(_fits("keep", list, bad) for bad in ([], ["a", 3]))
    assert _fits("sampling", str, "grid") and not _fits("sampling", str, "dice")


def test_help_of_both():
    commands = next(a for a in _parser()._actions if isinstance(a, argparse._SubParsersAction)).choices
    assert {"sweep", "map"} <= set(commands) and "SCENE" in commands["sweep"].format_help()


def test_an_adaptive_sweep_maps_what_is_kept_of_each_run(monkeypatch, tmp_path):
    """Counts of steps are numbers to the map, not codes; what did not run is said."""
    asked = {}

    def mapped(outcome, grid, *, chunk, progress):
        asked.update(chunk=chunk, kept=outcome(grid), progress=progress)
        values = {"steps": np.arange(6.0).reshape(2, 3), "t_end": np.ones((2, 3))}
        return SimpleNamespace(values=values, ran=np.array([[True] * 3, [False] * 3]), runs=3, spent=4)

    kept = {"steps": np.array([3, 4]), "t_end": np.array([0.1, 0.2])}
    keep = lambda run: kept  # noqa: E731
    keep.timed, keep.record = False, ()
    monkeypatch.setattr(_sweep_command, "measures", lambda *names: keep)
    monkeypatch.setattr(_sweep_command, "maker", lambda scene, names: lambda p: ("grasp", "state"))
    monkeypatch.setattr(
        _sweep_command, "simulate", lambda *args, **options: asked.update(run=(args, options))
    )
    monkeypatch.setattr(_sweep_command, "adaptive_map", mapped)
    values = ("--set", "damping=0.001:0.002:2", "--set", "s=0:0.002:3")
    order = ordered("pivoted", *values, "--sampling", "adaptive", "--seconds", "0.3", "--chunk", "4")
    lines = _sweep_command.swept(order, tmp_path, lambda doing: contextlib.nullcontext())
    assert asked["run"] == (("grasp", "state", 0.3), {"throw": False, "ts": 1, "rtol": 1e-6, "record": ()})
    assert asked["chunk"] == 4 and asked["progress"] is True
    assert asked["kept"]["steps"].dtype == float and asked["kept"]["t_end"] is kept["t_end"]
    assert "  3 runs of 0.3 s in " in lines[2]
    table = read_table(tmp_path)
    np.testing.assert_array_equal(table.values["ran"], [True] * 3 + [False] * 3)
    np.testing.assert_array_equal(table.values["steps"], np.arange(6.0))


@pytest.mark.parametrize(
    ("text", "fine"),
    [("1", False), ("2", True), ("1000000", True), ("1000001", False), ("-3", False), ("3.0", False)],
)
def test_a_grid_has_two_to_a_million_values_along_an_axis(text, fine):
    if fine:
        assert _sweep_order._count("a", text) == int(text)
        return
    with pytest.raises(ValueError, match="argument --set must give a a COUNT from 2 to 1000000"):
        _sweep_order._count("a", text)


def test_what_is_not_said_of_a_sweep():
    order = ordered("pivoted", "--set", "damping=1:2")
    assert (order.number, order.sampling, order.seconds, order.times) == (None, "grid", 1.0, 101)
    assert (order.rtol, order.chunk, order.seed, order.out) == (1e-6, 512, 0, "jaxroll-sweep")
    assert (order.keep, order.store, order.workers) == (("result", "t_end", "settling_time"), None, None)
    said = (
        "--seconds",
        "2",
        "--times",
        "3",
        "--rtol",
        "1e-5",
        "--chunk",
        "4",
        "--seed",
        "5",
        "--workers",
        "6",
    )
    order = ordered("pivoted", "--set", "damping=1:2", *said, "--store", "a.zarr", "--out", "b")
    assert (order.seconds, order.times, order.rtol, order.chunk, order.seed, order.workers) == (
        2,
        3,
        1e-5,
        4,
        5,
        6,
    )
    assert (order.store, order.out) == ("a.zarr", "b")


@pytest.mark.parametrize(
    ("words", "shape"),
    [
        (("--set", "a=0:1", "--set", "b=0:1", "--number", "3"), (2, 2)),
        (("--set", "a=0:1", "--set", "b=0:1", "--set", "c=1,2,3", "--number", "75"), (5, 5, 3)),
        (("--set", "a=0:1", "--set", "b=0:1:10", "--number", "44"), (4, 10)),
        (("--set", "a=0:1", "--set", "b=0:1:10", "--number", "46"), (5, 10)),
        (("--set", "a=0:1", "--set", "b=0:1"), (32, 32)),
        (("--set", "a=1", "--set", "b=0:1:7"), (1, 7)),
    ],
)
def test_ranges_without_a_count_share_the_runs(words, shape):
    assert parameters_of(ordered("pinch", *words)).shape == shape


@pytest.mark.parametrize("sampling", ["sobol", "latin"])
def test_samples_are_drawn_by_the_seed_for_each_combination_of_listed_values(sampling):
    words = ("pinch", "--set", "a=1:100:log", "--set", "b=5,6", "--sampling", sampling, "--seed", "3")
    rows = parameters_of(ordered(*words, "--number", "8"))
    draw = jxr.Parameters.sobol if sampling == "sobol" else jxr.Parameters.latin_hypercube
    np.testing.assert_array_equal(rows.axis("a"), draw(8, seed=3, a=(1.0, 100.0, "log")).a)
    assert rows.shape == (8, 2) and rows.b.tolist() == [5.0, 6.0] * 8
    many = parameters_of(ordered("pinch", "--set", "a=1:2", "--sampling", sampling))
    assert many.shape == (1024,)
    np.testing.assert_array_equal(many.a, draw(1024, seed=0, a=(1.0, 2.0)).a)


def test_a_number_stands_for_all_that_a_controller_has_of_it():
    grasp = SimpleNamespace(controller=SimpleNamespace(damping=np.ones(2), beta=np.ones(())))
    np.testing.assert_array_equal(_sweep_command._held(grasp, "damping", np.array(3.0)), [3.0, 3.0])
    for name, value in (("damping", np.array([1.0, 2.0])), ("beta", np.array(3.0)), ("mass", np.array(4.0))):
        assert _sweep_command._held(grasp, name, value) is value


def test_a_map_shows_the_result_or_what_comes_first(monkeypatch, tmp_path):
    """With the label of a measure, and in a file of its name."""
    asked, grid = [], jxr.Parameters.grid(a=[1.0, 2.0], b=[1.0, 2.0])
    figure = SimpleNamespace(savefig=lambda path, dpi: asked.append((path.name, dpi)))
    draw = lambda rows, values, **look: asked.append((values.tolist(), look)) or figure  # noqa: E731
    monkeypatch.setattr(_sweep_command.plotting, "parameter_map", draw)
    monkeypatch.setattr(
        _sweep_command.plotting, "map_page", lambda *args, **look: asked.append((args[2].name, look))
    )
    values = {"speed": np.arange(4.0), "t_end": np.ones(4)}
    for kept, show, name, label in (
        (values, None, "speed", "speed"),
        (values | {"result": np.arange(4)}, None, "result", "result"),
        (values, "t_end", "t_end", "time reached [s]"),
    ):
        asked.clear()
        table = _sweep_table.SweepTable(grid, kept, "some scene")
        monkeypatch.setattr(_sweep_command, "read_table", lambda folder, table=table: table)
        order = _sweep_order.MapOrder("store", show, "a", None, {"b": 1.0}, "out")
        lines = _sweep_command.mapped(order, tmp_path, lambda doing: contextlib.nullcontext())
        look = {"x": "a", "y": None, "at": {"b": 1.0}, "label": label, "title": "some scene"}
        assert asked == [(kept[name].tolist(), look), (f"map_{name}.png", 150), (f"map_{name}.html", look)]
        assert lines[-1] == f"  map_{name}.png, map_{name}.html"
    with pytest.raises(ValueError, match="argument --show must be one of speed, t_end, but was 'nothing'"):
        _sweep_command.mapped(
            _sweep_order.MapOrder("store", "nothing", None, None, {}, "out"), tmp_path, None
        )


def test_columns_of_a_table_are_flat_and_named_by_their_places():
    values = {
        "last": {"q": np.arange(6.0).reshape(2, 3)},
        "pair": np.arange(8).reshape(2, 2, 2),
        "t": np.ones(2),
    }
    found = dict(_sweep_table.flat_values(values))
    assert list(found) == [
        *(f"last.q[{i}]" for i in range(3)),
        *(f"pair[{i}, {j}]" for i in (0, 1) for j in (0, 1)),
        "t",
    ]
    assert found["last.q[1]"].tolist() == [1.0, 4.0] and found["pair[1, 0]"].tolist() == [2, 6]
    codes = slipping_above(np.array([0.0, 1.0, 0.0]))
    assert _sweep_table.entries_of(codes) == ["successful", "slipping", "successful"]
    assert _sweep_command._told({"code": codes, "t": np.array([1.0, 2.5])}) == [
        "  code                2 successful, 1 slipping",
        "  t                   [1, 2.5]",
    ]
