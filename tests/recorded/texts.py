"""What the command line offers, asks of the library, and prints: nothing is simulated, searched or drawn."""

import argparse
import contextlib
import dataclasses
import io
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np

import jaxroll as jxr
from jaxroll import __main__ as command_line, _analysis, _cli, _integration, plotting, stability
from jaxroll._cli import _design_command, _pinch_command
from tests.recorded import runs
from tests.recorded.compare import described

_DRAWN = ("contours", "poses", "responses", "phase", "loci")


def offered() -> dict[str, Any]:
    """All commands with their options, as the parser has them; how they are laid out is Python's business."""
    parser = command_line._parser()
    found = {"jaxroll": _parser(parser)}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found |= {name: _parser(each) for name, each in action.choices.items()}
    return found


def _parser(parser: argparse.ArgumentParser) -> dict[str, Any]:
    told = {"about": f"{parser.description}", "at the end": f"{parser.epilog}"}
    for action in parser._actions:
        name = " ".join(action.option_strings) or action.dest
        choices = None if action.choices is None else list(action.choices)
        told[name] = {
            "default": described(action.default),
            "choices": choices,
            "called": described(action.metavar),
            "help": action.help,
            "takes": _bounds(action.type),
        }
    return told


def _bounds(convert: Any) -> list[str]:
    """What an option answers to numbers around the ends of its range."""
    if convert is None:
        return []
    answers = []
    for text in (
        "0",
        "1",
        "2.5",
        "1e-14",
        "1e-13",
        "1e-3",
        "9e-4",
        "1e-2",
        "0.011",
        "1000",
        "1001",
        "100001",
        "nan",
    ):
        try:
            answers.append(f"{text}: {convert(text)}")
        except argparse.ArgumentTypeError as error:
            answers.append(f"{text}: {error}")
    return answers


def demos() -> dict[str, Any]:
    """What each demo runs, and when it saves states."""
    found = {}
    for name, demo in command_line.DEMOS.items():
        kept = {field.name: getattr(demo, field.name) for field in dataclasses.fields(demo)}
        kept |= {"figures": list(demo.figures), "animated": demo.animated(plotting)}
        times = {f"{t} s": command_line._save_times(demo, t) for t in (0.1, 0.5, 2.5, 10.0, 100.0)}
        found[name] = described(kept | times)
    return found


def facts() -> dict[str, Any]:
    """The lines about scenes and runs."""
    found = {}
    rates = np.array([-3.0 + 4.0j, -3.0 - 4.0j, 1e-12, -0.5, -20.0])
    verdict = SimpleNamespace(neutral=1, rates=rates, verdict=stability.VERDICTS.asymptotically_stable)
    for name in ("pivoted", "pinch", "pinch3d"):
        grasp, state = runs.scene(name)
        made = runs.loci(2, times=13)
        with mock.patch.object(_analysis, "loci", lambda grasp, run, made=made: made):
            told = getattr(_cli, f"{name}_facts")(grasp, runs.run(name))
        with mock.patch.object(stability, "assess", lambda grasp, state: verdict):
            found[name] = getattr(_cli, f"{name}_scene")(grasp, state) + told
    broken = runs.run("pinch3d", ended="slipping")
    with mock.patch.object(_analysis, "loci", lambda grasp, run: made):
        found["broken"] = _cli.pinch3d_facts(runs.scene("pinch3d")[0], broken)
    return found


class _Asked:
    """Notes what a function is asked, and answers."""

    def __init__(self) -> None:
        self.calls: dict[str, Any] = {}

    def __call__(
        self, name: str, answer: Callable[..., Any] = lambda *args, **options: None
    ) -> Callable[..., Any]:
        def asked(*args: Any, **options: Any) -> Any:
            given = [
                each for each in args if not isinstance(each, Path) and "grasp" not in type(each).__module__
            ]
            plain = [each for each in given if isinstance(each, int | float | str | tuple | type(None))]
            files = [_file(each) for each in args if isinstance(each, Path)]
            told = {key: _file(each) if isinstance(each, Path) else each for key, each in options.items()}
            self.calls[f"{len(self.calls)} {name}"] = described([files, plain, told])
            return answer(*args, **options)

        return asked


def _file(path: Path) -> str:
    return "FOLDER" if path.is_dir() else path.name


def _picture(asked: _Asked) -> Any:
    return lambda *args, **options: SimpleNamespace(savefig=asked("savefig"))


@contextlib.contextmanager
def _instead(asked: _Asked, run: Any) -> Iterator[None]:
    """Stand-ins for what takes long."""

    @contextlib.contextmanager
    def timed(doing: str) -> Iterator[dict[str, float]]:
        asked(f"timed: {doing}")()
        yield {"s": 1.0}

    with contextlib.ExitStack() as stack:
        for name in _DRAWN:
            stack.enter_context(mock.patch.object(plotting, name, asked(name, _picture(asked))))
        for name in ("animate", "page", "design", "comparison"):
            stack.enter_context(mock.patch.object(plotting, name, asked(name)))
        for home, name, answer in ((_cli, "timed", timed), (_cli, "configure", lambda: None)):
            stack.enter_context(mock.patch.object(home, name, answer))
        for home in (_integration, _design_command):
            stack.enter_context(mock.patch.object(home, "simulate", asked("simulate", lambda *a, **o: run)))
        yield


def demonstrated(name: str, *, seconds: float | None = None, ended: str | None = None) -> dict[str, Any]:
    """What `jaxroll demo` asks for and prints, the work left out."""
    asked, run, (grasp, state) = _Asked(), runs.run(name, ended=ended), runs.scene(name)
    arguments = ["demo", name] + ([] if seconds is None else ["--seconds", f"{seconds}", "--no-animation"])
    with (
        tempfile.TemporaryDirectory() as folder,
        _instead(asked, run),
        mock.patch.object(_cli, f"{name}_scene", lambda grasp, state: ["  the scene"]),
        mock.patch.object(_cli, f"{name}_facts", lambda grasp, run: ["  the facts"]),
        mock.patch.object(jxr.scenes, name, lambda: (grasp, state)),
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as complaint,
    ):
        code = command_line.main([*arguments, "--out", folder])
    return {
        "code": code,
        "asked": asked.calls,
        **_said(out, folder, "out"),
        **_said(complaint, folder, "complaint"),
    }


def _said(stream: io.StringIO, folder: str, name: str) -> dict[str, Any]:
    text = (
        stream.getvalue().replace(folder, "FOLDER").replace(f"jaxroll {jxr.__version__}", "jaxroll VERSION")
    )
    return {name: text.splitlines()}


def ordered(goal: str) -> dict[str, Any]:
    """What `jaxroll design` asks for and prints, the work left out."""
    asked, run = _Asked(), runs.run("pinch", ended="slipping")
    tip = _cli.fingertip(None, "mm")
    found = SimpleNamespace(
        start=tip,
        tip=jxr.Circle(0.01),
        holds=np.array([True]),
        chosen=0,
        report=lambda *args, **options: f"the report, {args} {options}",
    )
    order = _cli.DesignOrder(goal, tip, steps=7, starts=2, animated=goal == "margin")

    @contextlib.contextmanager
    def timed(doing: str) -> Iterator[None]:
        asked(f"timed: {doing}")()
        yield

    search = asked("optimise_fingertip", lambda *args, **options: found)
    grasp = runs.scene("pinch")
    with (
        tempfile.TemporaryDirectory() as folder,
        _instead(asked, run),
        mock.patch.object(_design_command, "optimise_fingertip", search),
        mock.patch.object(_design_command.scenes, "pinch", asked("pinch", lambda **options: grasp)),
    ):
        lines, held = _cli.designed(order, Path(folder), timed)
        written = sorted(path.name for path in Path(folder).iterdir())
    lines = [line.replace(folder, "FOLDER") for line in lines]
    return {"asked": asked.calls, "lines": lines, "held": held, "written": written, "tip": described(tip)}


def fingertips() -> dict[str, Any]:
    """A fingertip from a file, and measures of two runs."""
    with tempfile.TemporaryDirectory() as folder:
        u = 0.7 + 2.0 * np.pi * np.arange(120) / 120
        file = Path(folder) / "tip.csv"
        np.savetxt(file, np.stack([15.0 * np.cos(u) - 2.0, 9.0 * np.sin(u)], axis=-1), delimiter=",")
        tip = _cli.fingertip(str(file), "mm")
    s = np.linspace(-0.01, 0.01, 5)
    return described({"ends": tip.domain(), "points": tip.point(s), "bends": tip.curvature(s)})


_RING = 2.0 * np.pi * np.arange(80) / 80
_EGG = np.stack([30.0 * np.cos(_RING) + 5.0 * np.cos(2.0 * _RING), 20.0 * np.sin(_RING)], axis=-1)


def fitted_file(*options: str) -> dict[str, Any]:
    """What `jaxroll fit` writes and prints of an outline, the picture left out."""
    asked = _Asked()
    with (
        tempfile.TemporaryDirectory() as folder,
        _instead(asked, None),
        mock.patch.object(plotting, "fit", asked("fit", _picture(asked))),
        contextlib.redirect_stdout(io.StringIO()) as out,
    ):
        np.savetxt(file := Path(folder) / "egg.csv", _EGG, delimiter=",")
        code = command_line.main(["fit", str(file), "--out", folder, *options])
        written = sorted(path.name for path in Path(folder).iterdir())
        report = (Path(folder) / "report.txt").read_text()
    said = _said(out, folder, "out")
    return {"code": code, "asked": asked.calls, "written": written, "report": report, **said}


def pinched_file(*options: str, ended: str | None = None) -> dict[str, Any]:
    """What `jaxroll pinch` asks for and prints of an egg; all between its fit and its report is left out."""
    asked, run, scene = _Asked(), runs.run("pinch", ended=ended), runs.scene("pinch")
    verdict = SimpleNamespace(verdict=stability.VERDICTS.neutral)

    def held(body: Any, **options: Any) -> Any:
        asked(f"body of {float(body.mass):.4g} kg")()
        return scene

    with (
        tempfile.TemporaryDirectory() as folder,
        _instead(asked, run),
        mock.patch.object(plotting, "fit", asked("fit", _picture(asked))),
        mock.patch.object(_pinch_command, "simulate", asked("simulate", lambda *a, **o: run)),
        mock.patch.object(stability, "assess", asked("assess", lambda *a: verdict)),
        mock.patch.object(jxr.scenes, "pinch_object", asked("pinch_object", held)),
        contextlib.redirect_stdout(io.StringIO()) as out,
    ):
        np.savetxt(file := Path(folder) / "egg.csv", _EGG, delimiter=",")
        code = command_line.main(["pinch", str(file), "--out", folder, *options])
        load = described(jxr.load(Path(folder) / "pinch.npz")["grasp"].load)
        written = sorted(path.name for path in Path(folder).iterdir())
    found = {"code": code, "asked": asked.calls, "load": load, "written": written}
    return found | _said(out, folder, "out")


TEXTS: dict[str, Callable[[], dict[str, Any]]] = {
    "offered": offered,
    "demos": demos,
    "facts": facts,
    "fingertips": fingertips,
    "ordered_margin": lambda: ordered("margin"),
    "ordered_stiffness": lambda: ordered("stiffness"),
    "ordered_run": lambda: ordered("run"),
    "fit": fitted_file,
    "fit_radius": lambda: fitted_file("--smallest-radius", "8"),
    "pinch": pinched_file,
    "pinch_ended": lambda: pinched_file(
        *("--density", "500", "--thickness", "20", "--friction", "0.4", "--force", "2"),
        *("--seconds", "0.35", "--no-animation"),
        ended="slipping",
    ),
    "demo_pivoted": lambda: demonstrated("pivoted"),
    "demo_pinch": lambda: demonstrated("pinch"),
    "demo_pinch3d": lambda: demonstrated("pinch3d"),
    "demo_pinch_short": lambda: demonstrated("pinch", seconds=0.25),
    "demo_ended": lambda: demonstrated("pivoted", ended="max_steps_reached"),
}
