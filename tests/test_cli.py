"""The command line: what does not fit is one line on stderr and exit code 2, before any work is done."""

import contextlib
import dataclasses
import json
import re
import sys
import time
import types
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from jax import monitoring
from PIL import Image

import jaxroll as jxr
from jaxroll import __main__ as command, _cli, plotting
from jaxroll.__main__ import _FPS, _missing, _parser, _save_times, _shape, _without_empty, main
from jaxroll._cli import (
    _design_command,
    _pinch_command,
    _replay_command,
    _run_pictures,
    _settings,
    _waiting,
    designed,
    DesignOrder,
)
from jaxroll._cli._design_command import fingertip
from jaxroll.geometry import Circle
from tests.recorded import runs

BAD = {
    "no such command": (["dance"], "invalid choice: 'dance'"),
    "part of a command": (["dem"], "invalid choice: 'dem'"),
    "no such scene": (["demo", "dance"], "invalid choice: 'dance'"),
    "seconds of NaN": (["demo", "--seconds", "nan"], "must lie between 0.001 and 1000, but was nan"),
    "seconds of words": (["demo", "--seconds", "long"], "must lie between 0.001 and 1000, but was long"),
    "negative seconds": (["demo", "--seconds", "-1"], "but was -1"),
    "infinite tolerance": (["demo", "--rtol", "inf"], "must lie between 1e-13 and 0.01, but was inf"),
    "half a step": (["design", "--steps", "2.5"], "must be a whole number between 1 and 100000, but was 2.5"),
    "no starts": (["design", "--starts", "0"], "must be a whole number between 1 and 1000, but was 0"),
    "goal": (["design", "--goal", "best"], "invalid choice: 'best'"),
    "unit": (["design", "--unit", "furlong"], "invalid choice: 'furlong'"),
    "empty folder": (
        ["demo", "--out", ""],
        "argument --out must name a folder that can be written to",
    ),
    "folder that is a file": (["design", "--out", "file"], "argument --out must name a folder that can be"),
    "folder in a file": (["demo", "--out", "file/new"], "argument --out must name a folder that can be"),
    "no such fingertip": (
        ["design", "--tip", "none.csv"],
        "argument --tip must name a file, but there is",
    ),
    "fingertip that is a folder": (["design", "--tip", "."], "argument --tip must name a file"),
    "fingertip without points": (
        ["design", "--tip", "empty.csv"],
        "--tip must .*empty.csv.* is empty",
    ),
    "no such object": (["pinch", "no.ply"], "argument FILE must name a file, but there is none called 'no.p"),
    "no such scan": (["fit", "no.xyz"], "argument FILE must name a file, but there is none called 'no.xyz'"),
    "object that is a folder": (["fit", "."], "argument FILE must name a file, but '.' is a folder"),
    "no such hand": (
        ["pinch", "nan.csv", "--hand", "none.urdf"],
        "argument --hand must name a file, but there",
    ),
    "scan with a hole in z": (["fit", "hole.csv"], "but line 2 of hole.csv was '4,5,nan'"),
    "scan with a hole, as XYZ": (["fit", "hole.xyz"], "but line 2 of hole.xyz was '4 5 nan'"),
    "fingertip with a NaN": (["design", "--tip", "nan.csv"], "argument --tip must .* line 1 of nan.csv was"),
    "fingertip of another kind": (["design", "--tip", "file"], "argument --tip must .* must end in .csv"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_does_not_fit_is_one_line(case, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "nan.csv").write_text("nan,1\n2,3\n")
    (tmp_path / "hole.csv").write_text("1,2,3\n4,5,nan\n")
    (tmp_path / "hole.xyz").write_text("1 2 3\n4 5 nan\n")
    arguments, words = BAD[case]
    assert main(arguments) == 2
    out, complaint = capfd.readouterr()
    lines = [line for line in complaint.splitlines() if not line.startswith(("Loading", "Reading"))]
    assert out == "" and len(lines) == 1 and lines[0].startswith("jaxroll")
    assert re.search(words, lines[0])
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".png", ".gif")]
    assert not list(tmp_path.glob("jaxroll-*"))


@pytest.mark.parametrize("command", [["demo", "--seconds", "0.001"], ["design", "--tip", "empty.csv"]])
def test_a_cache_that_is_no_folder_is_named_before_any_work(command, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "empty.csv").write_text("")
    monkeypatch.setenv("JAXROLL_CACHE", "file/cache")
    assert main(command) == 2
    assert (
        "environment variable JAXROLL_CACHE must name a folder that can be written to, but"
        in capfd.readouterr().err
    )


@pytest.mark.parametrize("animated", [True, False])
def test_a_design_names_the_files_that_it_wrote(animated, tmp_path, monkeypatch):
    """The search, the runs and the drawing left out."""
    tip = types.SimpleNamespace(points=np.eye(2))
    made = {"start": tip, "tip": Circle(0.01), "holds": np.array([animated, False]), "chosen": 0}
    made["result"] = jxr.RESULTS.successful if animated else jxr.RESULTS.infeasible
    found = types.SimpleNamespace(**made, report=lambda *args, **options: "the report")
    monkeypatch.setattr(_design_command, "optimise_fingertip", lambda *args, **options: found)
    code = jxr.RESULTS.successful if animated else jxr.RESULTS.slipping
    run = types.SimpleNamespace(result=code)
    monkeypatch.setattr(_design_command, "simulate", lambda *args, **options: run)
    monkeypatch.setattr(_design_command, "make", lambda tip: (None, None))
    monkeypatch.setattr(_design_command, "_facts", lambda runs: ["the runs"])
    monkeypatch.setattr(plotting, "design", lambda found, folder: (folder / "design.png").touch())
    monkeypatch.setattr(plotting, "comparison", lambda runs, folder: (folder / "comparison.png").touch())
    monkeypatch.setattr(plotting, "animate", lambda grasp, run, path, **options: path.touch())
    asked = DesignOrder("margin", tip, steps=1, starts=1, animated=animated)
    lines, held = designed(asked, tmp_path, lambda doing: contextlib.nullcontext())
    first, outcome, *others, names = lines[:5]
    missing = lines[5:]
    assert (first, *others) == ("the report", "the runs", f"Files in {tmp_path}:") and held == animated
    lost = "does not hold; the search has not ended within its limits: more --steps or --starts may"
    assert outcome == f"  outcome   the fingertip {'holds' if held else lost}"
    written = {path.name for path in tmp_path.iterdir()}
    assert names.startswith("  ") and set(names.strip().split(", ")) == written
    assert {"design.png", "comparison.png", "fingertip.csv"} <= written
    assert ({"before.gif", "after.gif"} <= written) == animated and all(" no " in line for line in missing)


@pytest.mark.parametrize(
    ("made", "begun", "outcome"),
    [
        (
            {"chosen": 0, "start": 0.0},
            "",
            "; the search has not reached its goal: more --steps or --starts may",
        ),
        (
            {"chosen": 0, "start": 1e-3, "result": jxr.RESULTS.infeasible},
            "the outline made symmetric about x, which moved it by up to 1.4 mm",
            "; the search has not ended within its limits: more --steps or --starts may",
        ),
        ({"chosen": 2, "start": 0.0, "holds": [0, 0, 1]}, "start 3 of 4, a variation of the outline", ""),
    ],
)
def test_a_design_says_what_its_start_is_and_how_its_search_ended(
    made, begun, outcome, tmp_path, monkeypatch
):
    """A start made symmetric is another than was given; and a fingertip within limits may not hold."""
    tip = types.SimpleNamespace(points=np.eye(2))
    made = {"tip": Circle(0.01), "holds": [0], "result": jxr.RESULTS.max_steps_reached} | made
    made["start"] = types.SimpleNamespace(points=np.eye(2) + made["start"])
    found = types.SimpleNamespace(**made, report=lambda *args, **options: "the report")
    run = types.SimpleNamespace(result=jxr.RESULTS.successful)
    for name, given in {
        "optimise_fingertip": lambda *args, **options: found,
        "simulate": lambda *args, **options: run,
        "make": lambda tip: (None, None),
        "_facts": lambda runs: [],
        "_write": lambda found, folder: ([], []),
    }.items():
        monkeypatch.setattr(_design_command, name, given)
    monkeypatch.setattr(plotting, "design", lambda found, folder: None)
    monkeypatch.setattr(plotting, "comparison", lambda runs, folder: None)
    asked = DesignOrder("margin", tip, steps=1, starts=4, animated=False)
    lines, _ = designed(asked, tmp_path, lambda doing: contextlib.nullcontext())
    assert lines[-3] == f"  outcome   the fingertip holds{outcome}"
    assert begun in lines[1] and (len(lines) == 5) == bool(begun)


def test_a_tip_out_of_the_fingers_reach_is_refused_before_any_search(tmp_path, monkeypatch):
    def beyond(tip):
        raise ValueError("argument guess must be near a pose, but the best found leaves the x gap at 0.34")

    monkeypatch.setattr(_design_command, "make", beyond)
    tip = types.SimpleNamespace(points=np.eye(2))
    asked = DesignOrder("margin", tip, steps=1, starts=1, animated=False)
    with pytest.raises(
        ValueError, match="tip must be one with which the fingers reach, but the best found leav"
    ):
        designed(asked, tmp_path, None)
    u = 2.0 * np.pi * np.arange(40) / 40  # as many as of the fingertip below: one program fits both
    np.savetxt(tmp_path / "small.csv", np.stack([np.cos(u), np.sin(u)], axis=-1), delimiter=",")
    with pytest.raises(
        ValueError, match="argument --tip must be no shorter than the 12 mm that are judged, but"
    ):
        fingertip(str(tmp_path / "small.csv"), "mm")


@pytest.mark.parametrize("held", [True, False])
def test_a_design_that_does_not_hold_is_no_success(held, tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    monkeypatch.setattr(_cli, "designed", lambda asked, folder, timed: (["the report"], held))
    assert main(["design", "--out", str(tmp_path)]) == (0 if held else 1)
    assert "the report" in capfd.readouterr().out


def test_help_and_nothing_at_all(capfd):
    assert main([]) == 0 and main(["demo", "--help"]) == 0 and main(["design", "--help"]) == 0
    assert "usage: jaxroll" in capfd.readouterr().out


def test_the_version_alone(capfd):
    assert main(["--version"]) == 0
    assert capfd.readouterr().out == f"jaxroll {jxr.__version__}\n"


class _Film:
    """A stand-in for ffmpeg: it keeps the arguments and the pictures that it is given."""

    PROGRAM = """#!{python}
import json, sys
with open({told!r}, "w") as told:
    json.dump([sys.argv[1:], len(sys.stdin.buffer.read())], told)
open(sys.argv[-1], "wb").close()
"""

    def __init__(self, folder):
        self.told = folder / "told.json"
        program = folder / "ffmpeg"
        program.write_text(self.PROGRAM.format(python=sys.executable, told=str(self.told)))
        program.chmod(0o755)

    def heard(self):
        return json.loads(self.told.read_text())


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A made run of three states, with its grasp, as `demo` writes it."""
    folder = tmp_path_factory.mktemp("saved")
    (grasp, state), run = runs.scene("pivoted"), runs.run("pivoted", times=3, t1=0.1)
    jxr.save(folder / "run.npz", {"grasp": grasp, "state": state, "run": run})
    jxr.save(folder / "grasp.npz", grasp)
    return folder


def _own_law(t, angles, rates, tips):
    return [-0.01 * rates[0]]


def test_a_saved_run_is_drawn_again(saved, tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    assert main(["replay", str(saved / "run.npz"), "--out", str(tmp_path), "--fps", "20"]) == 0
    lines = capfd.readouterr().out.splitlines()
    written = {path.name for path in tmp_path.iterdir()}
    assert lines[1] == "Trajectory: successful"
    assert any(
        line.startswith("  poses.png, ") and set(line.strip().split(", ")) == written for line in lines
    )
    assert written - {"page.html"} == {"poses.png", "responses.png", "motion.gif"}
    with Image.open(tmp_path / "motion.gif") as film:
        assert film.n_frames == 3
    assert main(["replay", str(saved / "grasp.npz"), "--out", str(tmp_path)]) == 2
    assert "argument FILE must hold one grasp and one run of it" in capfd.readouterr().err
    assert main(["replay", "none.npz", "--out", str(tmp_path)]) == 2
    assert "argument FILE must name a file, but there is none" in capfd.readouterr().err
    (tmp_path / "o.csv").write_text("x,y\n0,0\n")
    assert main(["replay", str(tmp_path / "o.csv"), "--out", str(tmp_path)]) == 2
    assert "argument FILE must name a file that `jaxroll.save` wrote, whose name" in capfd.readouterr().err
    # No option gives a command the caller's own functions.
    jxr.save(tmp_path / "law.npz", _own_law)
    assert main(["replay", str(tmp_path / "law.npz"), "--out", str(tmp_path)]) == 2
    told = capfd.readouterr().err
    assert (
        "names _own_law of " in told and "which is the caller's own: in Python `jaxroll.load(FILE, " in told
    )


def test_a_replay_shows_and_tells_of_a_run_up_to_a_time(saved, tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    words = ["replay", str(saved / "run.npz"), "--out", str(tmp_path), "--no-animation", "--until"]
    assert main([*words, "0.06"]) == 0
    told = capfd.readouterr().out
    assert "0 to 0.05 s, 2 of 2 states saved" in told and "  shown     up to 0.05 s, by --until" in told
    for until in ("0.2", "0.01"):
        assert main([*words, until]) == 2
        complaint = capfd.readouterr().err
        assert (
            "argument --until must be a time by which two states were saved, of a run from 0 to 0.1 s"
            in complaint
        )


def test_a_run_before_zero_is_shown_up_to_a_time_before_zero():
    asked = _parser().parse_args(["replay", "run.npz", "--until", "-0.7"])
    assert asked.until == -0.7


def test_a_film_of_a_long_run_takes_twelve_seconds(saved, tmp_path, monkeypatch, capfd):
    """Of a run whose first saved state is at 3 s and whose last is at 39 s: three times as fast as time."""
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    kept = jxr.load(saved / "run.npz")
    later = dataclasses.replace(kept["run"], ts=jnp.array([3.0, 20.0, 39.0]))
    asked = []
    monkeypatch.setattr(_replay_command, "_read", lambda _: (kept["grasp"], later))
    monkeypatch.setattr(_replay_command, "run_pictures", lambda *_: {})
    monkeypatch.setattr(_replay_command.plotting, "animate", lambda *_, **options: asked.append(options))
    monkeypatch.setattr(_replay_command.plotting, "page", lambda *_: None)
    for speed in ([], ["--speed", "2"]):
        assert main(["replay", str(saved / "run.npz"), "--out", str(tmp_path), "--fps", "9", *speed]) == 0
    assert asked == [{"fps": 9, "speed": 3.0}, {"fps": 9, "speed": 2.0}]
    assert "motion.gif, page.html" in capfd.readouterr().out


def test_a_film_is_as_long_as_the_run_not_as_what_was_asked_of_it():
    """Asked up to 100 s, ended after 3 s; and nothing reached at all."""
    run = SimpleNamespace(ts=np.array([0.0, 3.0, 100.0]), reached=np.array([True, True, False]))
    assert _run_pictures.pace(run, 1.0, 12.0) == 1.0 and _run_pictures.pace(run, 0.1, 12.0) == 0.25
    lost = SimpleNamespace(ts=run.ts, reached=np.array([False, False, False]))
    assert _run_pictures.pace(lost, 0.5, 12.0) == 0.5


def test_a_pinch_that_ends_before_the_push_says_so():
    """And it has two states or more, the first of them the start, however short it is."""
    left = SimpleNamespace(normal=np.zeros((2, 2)), tangential=np.zeros((2, 2)))
    forces = SimpleNamespace(f=np.array([[2.0, 3.0], [1.0, 1.0]]))
    control = SimpleNamespace(beta=20.0, damping=np.array([0.006]))
    grasp = SimpleNamespace(object=SimpleNamespace(mass=0.02), controller=control)
    for end, told in (
        (0.1, "not pushed by then: that begins at 0.1 s"),
        (0.11, "pushed aside with 0.5 N for 0.1 s"),
    ):
        run = SimpleNamespace(multipliers=forces, residuals=left, stats=SimpleNamespace(t_end=end))
        assert _pinch_command._described(grasp, run, 0.5)[1].endswith(f"pressed with 2 N, {told}")
    assert [_pinch_command._count(seconds) for seconds in (1e-3, 0.02, 1.0, 1e5)] == [2, 3, 101, 20_001]


def test_a_run_in_space_with_one_state_is_drawn_without_its_loci(monkeypatch):
    drawn = ("poses", "responses", "loci")
    for name in drawn:
        monkeypatch.setattr(_run_pictures.plotting, name, lambda *_, name=name, **options: name)
    run = lambda *there: SimpleNamespace(ts=np.arange(2.0), reached=np.array(there), multipliers=None)  # noqa: E731
    space, plane = SimpleNamespace(spatial=True), SimpleNamespace(spatial=False)
    assert list(_run_pictures.run_pictures(space, run(True, True)).values()) == list(drawn)
    assert list(_run_pictures.run_pictures(space, run(True, False)).values()) == list(drawn[:2])
    assert list(_run_pictures.run_pictures(plane, run(True, True)).values()) == list(drawn[:2])


WORDS = {
    "radius": (
        "fit",
        "argument smallest_radius must be at most 0.00454 m here, but was 0.01 m",
        "argument --smallest-radius must be at most 4.54 mm here, but was 10 mm",
    ),
    "recommendation": (
        "fit",
        "recommended: a smallest_radius below 0.00454 m, if the points\nare shape 3 m away; 12 1/m",
        "recommended: a --smallest-radius below 4.54 mm, if the points\nare shape 3 m away; 12 1/m",
    ),
    "points": (
        "pinch",
        "argument points must go all round, but leave a gap of 2 mm (closed=False makes an open one)",
        "the points of FILE must go all round, but leave a gap of 2 mm",
    ),
    "which": (
        "fit",
        "argument which must be below 2, but was 2",
        "argument --which must be below 2, but was 2",
    ),
    "section": ("pinch", "argument origin must put the plane", "argument --section must put the plane"),
    "a section's place": (
        "fit",
        "argument origin must put the plane through the mesh, but it lies from -0.50001 to -1.25e-3 m of it",
        "argument --section must put the plane through the mesh, but it lies from -500.01 to -1.25 mm of it",
    ),
    "hand": ("pinch", "argument fingers must reach the object", "argument --hand must reach the object"),
    "store": ("sweep", "argument resume must be a folder", "argument --out must be a folder"),
    "set": ("sweep", "argument beta must be positive", "argument --set beta must be positive"),
    "another": ("demo", "argument points must be 6", "argument points must be 6"),
}


@pytest.mark.parametrize("case", WORDS)
def test_sentences_name_options(case):
    command, text, told = WORDS[case]
    assert _cli.in_options(text, command, ["beta"]) == told


def test_a_film_is_handed_to_ffmpeg_and_refused_without_it(saved, tmp_path, monkeypatch):
    grasp, run = (jxr.load(saved / "run.npz")[name] for name in ("grasp", "run"))
    monkeypatch.setenv("PATH", str(tmp_path))
    path = tmp_path / "motion.mp4"
    with pytest.raises(ValueError, match=r"must end in \.gif where there is no program ffmpeg"):
        plotting.animate(grasp, run, path)
    film = _Film(tmp_path)
    assert plotting.animate(grasp, run, path, fps=20, size=3) == path and path.exists()
    told, received = film.heard()
    width, height = map(int, told[told.index("-s") + 1].split("x"))
    assert width % 2 == 0 and height % 2 == 0 and float(told[told.index("-framerate") + 1]) == 20.0
    # Three frames, and the last one for a second and a half more.
    assert received == (3 + 30) * width * height * 4


def test_a_fingertip_from_a_file_begins_at_its_foremost_point(tmp_path):
    """Wherever the file begins: the outline is the file's, and s = 0 is where x is greatest."""
    u = 0.7 + 2.0 * np.pi * np.arange(40) / 40
    points = np.stack([15.0 * np.cos(u) - 2.0, 9.0 * np.sin(u)], axis=-1)
    np.savetxt(tmp_path / "tip.csv", points, delimiter=",")
    tip = fingertip(str(tmp_path / "tip.csv"), "mm")
    first, last = tip.domain()
    x, y = np.asarray(tip.point(np.linspace(first, last, 60))).T
    assert tip.closed and np.asarray(tip.point(0.0))[0] > x.max() - 1e-6
    np.testing.assert_allclose(((x + 0.002) / 0.015) ** 2 + (y / 0.009) ** 2, 1.0, atol=5e-3)


def test_compiling_is_said_while_it_is_waited_for(capsys, monkeypatch):
    """JAX reports a program before and after its compiler; only one that takes long is told of at once."""
    monkeypatch.setattr(_waiting, "_PATIENCE", 0.05)
    before, after = (
        "/jax/core/compile/jaxpr_to_mlir_module_duration",
        "/jax/core/compile/backend_compile_duration",
    )
    with _waiting.timed("Thinking") as spent:
        for _ in range(2):
            monitoring.record_event_duration_secs(before, 0.01)
            time.sleep(0.15)
            monitoring.record_event_duration_secs(after, 0.15)
    assert spent["s"] > 0.3
    assert re.fullmatch(
        r"Thinking \.\.\. compiling \.\.\. 0\.3\d* s, 0\.3 s of it compiling\n", capsys.readouterr().err
    )
    with _waiting.timed("Thinking"):
        monitoring.record_event_duration_secs(before, 0.01)
        monitoring.record_event_duration_secs(after, 0.001)
        time.sleep(0.1)
    assert re.fullmatch(r"Thinking \.\.\. 0\.\d+ s\n", capsys.readouterr().err)
    monitoring.record_event_duration_secs(before, 0.01)  # nobody listens any more
    time.sleep(0.1)
    assert capsys.readouterr().err == ""


def test_what_goes_wrong_ends_the_line(capsys):
    with pytest.raises(RuntimeError), _waiting.timed("Thinking"):
        raise RuntimeError
    assert capsys.readouterr().err == "Thinking ...\n"


def test_lengths_of_a_shape_are_given_in_millimetres():
    asked = {
        "file": "a.csv",
        "unit": "in",
        "smallest_radius": 2.5,
        "pixel": 0.25,
        "section": None,
        "which": 1,
    }
    order = _shape(types.SimpleNamespace(**asked))
    assert (order.radius, order.pixel) == (2.5e-3, 2.5e-4) and order.unit == "in"
    order = _shape(types.SimpleNamespace(**asked | {"smallest_radius": None, "pixel": None}))
    assert order.radius is None and order.pixel is None


def test_what_is_shown_is_saved_densely():
    """Every frame of the animation; as long as all is shown, 100 states a second, 301 at least."""
    demo = types.SimpleNamespace(shown=5.0, speed=0.25)
    assert [_save_times(demo, t) for t in (0.1, 3.0, 4.0, 5.0)] == [301, 301, 401, 501]
    assert _save_times(types.SimpleNamespace(shown=np.inf), 100.0) == 3001
    times = _save_times(demo, 9.0)
    frames = np.arange(0.0, 5.0, 0.25 / _FPS)
    np.testing.assert_allclose(times, [*frames, *np.linspace(5.0, 9.0, 301)])


def test_folders_that_are_made_are_removed_again_where_nothing_was_written(tmp_path, monkeypatch):
    """The inner ones first; what was there before stays, and what holds a file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old").mkdir()
    made = _missing("old/new/deep")
    assert [str(path) for path in made] == ["old/new/deep", "old/new"]
    assert _missing("old") == [] and _missing(" ") == []
    (tmp_path / "old/new/deep").mkdir(parents=True)
    (tmp_path / "old/new/kept").touch()
    _without_empty(made)
    assert (tmp_path / "old/new/kept").exists() and not (tmp_path / "old/new/deep").exists()
    (tmp_path / "old/new/kept").unlink()
    _without_empty(made[1:])
    assert (tmp_path / "old").exists() and not (tmp_path / "old/new").exists()


@pytest.mark.parametrize(
    ("arguments", "name", "least", "most"),
    [
        (["demo"], "seconds", 1e-3, 1e3),
        (["demo"], "rtol", 1e-13, 1e-2),
        (["design"], "steps", 1, 100_000),
        (["design"], "starts", 1, 1000),
        (["fit", "a.csv"], "smallest-radius", 1e-6, 1e6),
        (["fit", "a.csv"], "pixel", 1e-6, 1e6),
        (["fit", "a.csv"], "which", 0, 1_000_000),
        (["pinch", "a.csv"], "density", 1e-3, 1e5),
        (["pinch", "a.csv"], "thickness", 1e-3, 1e5),
        (["pinch", "a.csv"], "friction", 1e-3, 1e5),
        (["pinch", "a.csv"], "seconds", 1e-3, 1e5),
        (["pinch", "a.csv"], "force", 1e-6, 1e6),
    ],
)
def test_numbers_have_ends_which_belong_to_them(arguments, name, least, most, capfd):
    whole = isinstance(least, int)
    for value in (least, most):
        found = _parser().parse_args([*arguments, f"--{name}", str(value)])
        assert getattr(found, name.replace("-", "_")) == value
    for beyond in (least - 1 if whole else 0.99 * least, most + 1 if whole else 1.01 * most):
        with pytest.raises(SystemExit):
            _parser().parse_args([*arguments, f"--{name}", str(beyond)])
    capfd.readouterr()


def test_what_is_not_given_has_a_default():
    known = lambda *words: vars(_parser().parse_args(words))  # noqa: E731
    demo, design, pinch, fit = known("demo"), known("design"), known("pinch", "a"), known("fit", "a")
    assert (demo["scene"], demo["rtol"], demo["seconds"], demo["no_animation"]) == (
        "pivoted",
        1e-8,
        None,
        False,
    )
    assert [design[name] for name in ("goal", "steps", "starts", "unit", "tip")] == [
        "margin",
        200,
        1,
        "mm",
        None,
    ]
    numbers = [pinch[name] for name in ("density", "thickness", "friction", "seconds", "force", "unit")]
    assert numbers == [1000.0, 20.0, 0.8, 1.0, None, "mm"]
    left = ("smallest_radius", "pixel", "section", "which", "out")
    assert not any(given[name] is not None for given in (pinch, fit) for name in left)


def test_a_section_is_an_axis_and_a_place_in_millimetres(capfd):
    given = lambda text: _parser().parse_args(["fit", "a.stl", "--section", text]).section  # noqa: E731
    assert given("y=-12.5") == ("y", pytest.approx(-0.0125)) and given("x=0") == ("x", 0.0)
    assert given("z=1e6")[1] == pytest.approx(1e3) and given("z=-1e6")[1] == pytest.approx(-1e3)
    for wrong in ("w=1", "z", "z=", "z=2e6", "z=-2e6", "12"):
        with pytest.raises(SystemExit):
            given(wrong)
        said = capfd.readouterr().err
        assert ("such as z=12.5, but was " + wrong in said) == (wrong in ("w=1", "z", "z=", "12"))


def test_a_page_that_needs_a_library_is_said_and_not_named(tmp_path, monkeypatch):
    demo = types.SimpleNamespace(title="a title")
    asked = []

    def page(grasp, run, path, *, title):
        asked.append((path, title))
        if len(asked) > 1:
            raise ImportError("argument: needs plotly")

    names = ["run.npz"]
    drawn = types.SimpleNamespace(page=page)
    assert command._page(demo, tmp_path, names, plotting=drawn, grasp=1, run=2) == []
    assert names == ["run.npz", "page.html"] and asked == [(tmp_path / "page.html", "a title")]
    told = command._page(demo, tmp_path, names, plotting=drawn, grasp=1, run=2)
    assert told == ["  no page.html: argument: needs plotly"] and names == ["run.npz", "page.html"]


@pytest.mark.parametrize("cache", ["named", "default", "off"])
def test_where_compiled_programs_are_kept(cache, tmp_path, monkeypatch):
    set_, place = {}, tmp_path / ("own" if cache == "named" else "jaxroll")
    monkeypatch.setattr("jax.config.update", set_.__setitem__)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("JAXROLL_CACHE", raising=False)
    if cache != "default":
        monkeypatch.setenv("JAXROLL_CACHE", "off" if cache == "off" else str(place))
    _settings.configure()
    kept = {
        "jax_compilation_cache_dir": str(place),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
    }
    assert set_ == {"jax_enable_x64": True} | ({} if cache == "off" else kept)
    assert place.is_dir() == (cache != "off")


@pytest.mark.parametrize("home", ["no folder", "nobody's"])
def test_without_a_home_to_write_to_nothing_is_kept(home, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.delenv("JAXROLL_CACHE", raising=False)
    monkeypatch.setenv(
        "XDG_CACHE_HOME", str(tmp_path / "file") if home == "no folder" else "~nobody-of-this-name"
    )
    assert _settings._kept_in() is None


@pytest.mark.parametrize("words", ["", "no such thing"])
def test_a_platform_that_jax_cannot_run_on_is_named(words, monkeypatch):
    def missing():
        raise AssertionError(words)

    monkeypatch.setattr("jax.default_backend", missing)
    monkeypatch.setattr("jax.config.update", lambda *_: None)
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    told = "environment variable JAX_PLATFORMS must name what JAX can run on here, but was 'cuda'"
    with pytest.raises(ValueError, match=f"^{told}{f'; JAX said: {words}' if words else ''}$", check=bool):
        _settings.configure()


def test_parts_of_what_a_file_holds_are_taken_out_of_lists_and_dicts():
    held = {"a": [1, (2, {"b": 3})], "c": "text"}
    assert list(_replay_command._parts(held)) == [1, 2, 3, "text"]
    assert list(_replay_command._parts(7)) == [7]


@pytest.mark.parametrize("result", ["successful", "slipping"])
def test_how_a_run_of_a_design_ended_is_told_without_an_amount(monkeypatch, result):
    monkeypatch.setattr(_design_command, "cause", lambda run: "contact 0 slips at t = 1 s: by 3 N")
    run = types.SimpleNamespace(result=getattr(jxr.RESULTS, result))
    wanted = "successful" if result == "successful" else "contact 0 slips at t = 1 s"
    assert _design_command._outcome(run) == wanted


def test_runs_of_a_design_are_compared_line_by_line(monkeypatch):
    names = ("settling_time", "overshoot", "peak_force", "friction_demand")
    for k, name in enumerate(names):
        monkeypatch.setattr(_design_command, name, lambda run, k=k: 10.0 * run.number + k)
    monkeypatch.setattr(_design_command, "_outcome", lambda run: f"ended {run.number}")
    runs = [types.SimpleNamespace(number=k, stats=types.SimpleNamespace(t_end=0.5 * k)) for k in (1, 2)]
    head, *lines = _design_command._facts(runs)
    assert head == "Runs of 1 s with friction 0.5"
    assert [line.split()[-2:] for line in lines[:5]] == [
        ["0.5", "1"],
        *([f"{10 + k}", f"{20 + k}"] for k in range(4)),
    ]
    assert lines[5:] == ["  before  ended 1", "  after   ended 2"]


def test_a_design_begins_with_an_ellipse_whose_sharp_end_is_in_front(tmp_path):
    """24 points on half axes of 18 and 9 mm; an outline that is open is refused."""
    points = np.asarray(fingertip(None, "mm").points)
    u = 2.0 * np.pi * np.arange(24) / 24
    np.testing.assert_allclose(points, np.stack([0.018 * np.cos(u), 0.009 * np.sin(u)], axis=-1), atol=1e-17)
    np.savetxt(
        tmp_path / "arc.csv",
        np.stack([10.0 * np.cos(0.4 * u), 10.0 * np.sin(0.4 * u)], axis=-1),
        delimiter=",",
    )
    with pytest.raises(ValueError, match="argument points must go all round a closed contour"):
        fingertip(str(tmp_path / "arc.csv"), "mm")
