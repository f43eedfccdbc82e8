"""The command line: scenes of the chapter, fingertips by design, shapes from files and pinches of them.

`sweep` runs a scene many times, and `map` draws what came of it; `replay` shows a saved run again.
"""

import argparse
import contextlib
import math
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import _cli

# jax and matplotlib are imported where they are needed, so that help and complaints come at once.

_ABOUT = "Differentiable simulation of grasping under rolling contact."
_DEMO = "Simulate a scene of the chapter, print a report, and write its figures."
_DESIGN = (
    "Start from a fingertip that loses the grasp of a rectangle, change it within limits until it holds, and "
    "write figures, animations of both, and the fingertip to draw or to make. The exit code is 1 if it "
    "does not hold."
)
_CACHE = (
    "Compiled programs are kept in $XDG_CACHE_HOME/jaxroll or ~/.cache/jaxroll, so that the next "
    "start is quick. The environment variable JAXROLL_CACHE names another folder; 'off' keeps "
    "nothing."
)
# What helps a demo whose run ends early, in the words of this command line.
_REMEDIES = {
    "max_steps_reached": "a larger --rtol or fewer --seconds",
    "step_collapsed": "a larger --rtol",
    "not_finite": "fewer --seconds",
}
_LONGEST_GIF = 12.0
_FPS = 25.0


@dataclass(frozen=True)
class Demo:
    """A scene that the command line can run.

    Attributes:
        title: What it shows.
        seconds: Time to simulate by default [s].
        speed: Simulated seconds per second of animation.
        figures: By the file name of each figure, which has the chapter's number if there is one, a function
            of `plotting`, the grasp and its run that draws it.
        scene: Name of the function in `_cli` that gives lines about a grasp and its start.
        facts: Name of the function in `_cli` that gives lines about a run.
        shown: How many of the first seconds are animated, and saved densely. Default: the whole run.
        animated: From `plotting`, further arguments of `plotting.animate`.
        page: Whether there is a page for a browser too.
    """

    title: str
    seconds: float
    speed: float
    figures: dict[str, Callable[[Any, Any, Any], Any]]
    scene: str
    facts: str
    shown: float = math.inf
    animated: Callable[[Any], dict[str, Any]] = lambda plotting: {}
    page: bool = False


class _Parser(argparse.ArgumentParser):
    """A parser whose complaint is one sentence."""

    def error(self, message: str) -> Any:
        self.exit(2, f"{self.prog}: {message}\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: Arguments after the program's name. Default: those of the process.

    Returns:
        The exit code: 0 if all went well, 1 if the run failed or nothing holds, 2 for an argument that does
        not fit, 130 if it was interrupted.

    Example:
        >>> main(["demo", "--seconds", "-1"])
        2
    """
    parser = _parser()
    try:
        options = parser.parse_args(argv)
    except SystemExit as stop:
        return int(stop.code or 0)
    if options.version:
        from . import __version__

        print(f"jaxroll {__version__}")
        return 0
    if options.command is None:
        parser.print_help()
        return 0
    try:
        if options.command in ("sweep", "map"):
            _sweep_or_map(options)
            return 0
        folder, made = _folder(options)
        try:
            if options.command in _ORDERS:
                return _ORDERS[options.command](options, folder)
            _run(options, DEMOS[options.scene], folder)
        finally:
            _without_empty(made)
    except (_Unfit, ValueError) as error:
        _cli.say(f"jaxroll {options.command}: {_told(error, options)}")
        return 2
    except KeyboardInterrupt:
        _cli.say(f"jaxroll {options.command}: interrupted")
        return 130
    except Exception as error:  # whatever went wrong, the command line answers in one line
        _cli.say(
            f"jaxroll {options.command}: {' '.join(_told(error, options).split()) or type(error).__name__}"
        )
        return 1
    return 0


def _told(error: Exception, options: argparse.Namespace) -> str:
    """What went wrong, by the names of this command's options."""
    given = [text.partition("=")[0] for text in getattr(options, "set", [])]
    return _cli.in_options(str(error), options.command, given)


class _Unfit(Exception):
    """An argument of the command line that does not fit."""


def _folder(options: argparse.Namespace) -> tuple[Path, list[Path]]:
    """The folder to write to, made and tried before any work is done, and the folders that were made for it.

    The inner folders come first. Raises unless the files to read are there, too.
    """
    for word, name in (("--tip", "tip"), ("FILE", "file"), ("--hand", "hand")):
        given = getattr(options, name, None)
        if given is not None and not os.path.isfile(given):
            what = "{!r} is a folder" if os.path.isdir(given) else "there is none called {!r}"
            raise _Unfit(f"argument {word} must name a file, but {what.format(given)}")
    name = options.scene if options.command == "demo" else options.command
    if options.command in ("fit", "pinch"):  # `demo pinch` has the other name
        name = f"{name}-{Path(options.file).stem}"
    given = f"jaxroll-{name}" if options.out is None else options.out
    made = _missing(given)
    return _writable(given), made


def _missing(given: str) -> list[Path]:
    """Which folders would be made for one, the inner ones first."""
    return [each for each in (Path(given), *Path(given).parents) if given.strip() and not _there(each)]


def _there(path: Path) -> bool:
    """Whether there is such a file or folder; True for a name that none can have, which cannot be made."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return True


def _without_empty(folders: list[Path]) -> None:
    """Remove folders in which nothing was written."""
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


def _writable(given: str) -> Path:
    try:
        if not given.strip():
            raise ValueError("it was empty")
        return _cli.tried_folder(Path(given))
    except (OSError, ValueError) as error:
        raise _Unfit(f"argument --out must name a folder that can be written to, but: {error}") from None


def _parser() -> _Parser:
    parser = _Parser(prog="jaxroll", description=_ABOUT, epilog=_CACHE)
    parser.add_argument("--version", action="store_true", help="print the version, and nothing else")
    commands = parser.add_subparsers(dest="command", title="commands", metavar="COMMAND")
    demo = commands.add_parser("demo", help=_DEMO, description=_DEMO, epilog=_CACHE)
    scenes, default = tuple(DEMOS), next(iter(DEMOS))
    told = "; ".join(f"{name}: {item.title}" for name, item in DEMOS.items())
    lengths = ", ".join(f"{item.seconds:g} for {name}" for name, item in DEMOS.items())
    demo.add_argument(
        "scene", nargs="?", choices=scenes, default=default, help=f"{told} (default: {default})"
    )
    demo.add_argument("--out", metavar="FOLDER", help="where to write (default: jaxroll-SCENE)")
    demo.add_argument(
        "--seconds",
        metavar="T",
        type=_number(1e-3, 1e3),
        help=f"seconds to simulate (default: {lengths})",
    )
    demo.add_argument(
        "--rtol",
        metavar="R",
        type=_number(1e-13, 1e-2),
        default=1e-8,
        help="relative tolerance of the solver (default: 1e-8)",
    )
    demo.add_argument("--no-animation", action="store_true", help="write no motion.gif")
    _design_parser(commands)
    _cli.shape_parsers(commands, _number, _CACHE)
    _cli.sweep_parser(commands, _number)
    _cli.replay_parser(commands, _number, _CACHE)
    return parser


def _design_parser(commands: Any) -> None:
    design = commands.add_parser("design", help=_DESIGN, description=_DESIGN, epilog=_CACHE)
    design.add_argument("--out", metavar="FOLDER", help="where to write (default: jaxroll-design)")
    design.add_argument(
        "--goal",
        choices=("margin", "stiffness", "run"),
        default="margin",
        help="margin of condition (41) (default), stiffness at rest, or a run that settles soon with little "
        "friction; the last takes minutes to compile",
    )
    most, batch = _number(1, 100_000, int), _number(1, 1000, int)
    design.add_argument(
        "--steps", metavar="N", type=most, default=200, help="at most, rounded up to tens (default: 200)"
    )
    design.add_argument("--starts", metavar="N", type=batch, default=1, help="in one batch (default: 1)")
    design.add_argument(
        "--tip",
        metavar="FILE",
        help="points of a closed outline about the finger's end, facing +x, to start from, "
        "made symmetric about x",
    )
    design.add_argument("--unit", choices=_cli.FILE_UNITS, default="mm", help="of FILE (default: mm)")
    design.add_argument("--no-animation", action="store_true", help="write no before.gif and after.gif")


def _number(low: float, high: float, kind: type = float) -> Callable[[str], Any]:
    what = "lie" if kind is float else "be a whole number"

    def convert(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"must {what} between {low:.6g} and {high:.6g}, but was {text}")
        return value

    return convert


def _run(options: argparse.Namespace, demo: Demo, folder: Path) -> None:
    with _cli.timed("Loading"):
        _cli.configure()
        import jax

        from . import __version__, plotting, scenes
        from ._integration import complaint, simulate
        from ._printing import code_name
        from ._saving import save
    seconds = options.seconds or demo.seconds
    with _cli.timed("Closing the contacts"):
        grasp, state = getattr(scenes, options.scene)()
    with _cli.timed("Describing the scene"):
        scene = getattr(_cli, demo.scene)(grasp, state)
    record, ts = ("multipliers", "energy"), _save_times(demo, seconds)
    settings = {"t1": seconds, "ts": ts, "rtol": options.rtol, "record": record, "throw": False}
    with _cli.timed(f"Simulating {seconds:g} s") as first:
        run = jax.block_until_ready(simulate(grasp, state, **settings))
        if code_name(run.result) != "successful":
            raise RuntimeError(complaint(run, _REMEDIES))
    with _cli.timed("Simulating it again") as again:
        jax.block_until_ready(simulate(grasp, state, **settings))
    names = list(demo.figures)
    with _cli.timed("Drawing"):
        facts = getattr(_cli, demo.facts)(grasp, run)
        for name, draw in demo.figures.items():
            draw(plotting, grasp, run).savefig(folder / name, dpi=150)
    if not options.no_animation:
        names.append("motion.gif")
        until = min(seconds, demo.shown)
        speed = max(demo.speed, until / _LONGEST_GIF)
        pace = {"fps": _FPS, "speed": speed, "until": until} | demo.animated(plotting)
        with _cli.timed("Animating"):
            plotting.animate(grasp, run, folder / "motion.gif", progress=_progress, **pace)
    save(folder / "run.npz", {"grasp": grasp, "state": state, "run": run})
    names.append("run.npz")
    missing = _page(demo, folder, names, plotting=plotting, grasp=grasp, run=run) if demo.page else []
    print(f"jaxroll {__version__}, {options.scene}: {demo.title}")
    print("\n".join([*scene, f"{run}", *facts]))
    print(f"  wall time   {first['s']:.3g} s with compilation, {again['s']:.3g} s again")
    print(f"Files in {folder}:")
    print("\n".join(["  " + ", ".join(names), *missing]))


def _design(options: argparse.Namespace, folder: Path) -> int:
    with _cli.timed("Loading"):
        _cli.configure()
        from . import __version__
        from ._cli import designed, DesignOrder, fingertip
    try:
        tip = fingertip(options.tip, options.unit)
    except (ValueError, OSError, ImportError) as error:
        told = str(error)
        if not told.startswith("argument --tip "):
            told = f"argument --tip must be a file with the points of a closed outline, but: {told}"
        raise _Unfit(told) from None
    asked = DesignOrder(options.goal, tip, options.steps, options.starts, animated=not options.no_animation)
    lines, held = designed(asked, folder, _cli.timed)
    print("\n".join([f"jaxroll {__version__}, design: a fingertip to hold a rectangle", *lines]))
    return 0 if held else 1


def _fit(options: argparse.Namespace, folder: Path) -> int:
    with _cli.timed("Loading"):
        _cli.configure()
        from . import __version__
        from ._cli import fitted
    lines = fitted(_shape(options), folder, _cli.timed)
    print("\n".join([f"jaxroll {__version__}, fit: {options.file}", *lines]))
    return 0


def _pinch(options: argparse.Namespace, folder: Path) -> int:
    with _cli.timed("Loading"):
        _cli.configure()
        from . import __version__
        from ._cli import pinched, PinchOrder
    asked = PinchOrder(
        _shape(options),
        options.hand,
        density=options.density,
        thickness=1e-3 * options.thickness,
        friction=options.friction,
        force=options.force,
        seconds=options.seconds,
        animated=not options.no_animation,
    )
    lines, held = pinched(asked, folder, _cli.timed)
    report = _cli.in_options("\n".join(lines), "pinch")
    print(f"jaxroll {__version__}, pinch: {options.file}\n{report}")
    return 0 if held else 1


def _replay(options: argparse.Namespace, folder: Path) -> int:
    with _cli.timed("Loading"):
        _cli.configure()
        from . import __version__
        from ._cli import replayed
    lines = replayed(_cli.replay_order(options), folder, _cli.timed)
    print("\n".join([f"jaxroll {__version__}, replay: {options.file}", *lines]))
    return 0


def _shape(options: argparse.Namespace) -> Any:
    """Which shape to make of which file."""
    from ._cli import ShapeOrder

    metres = lambda x: None if x is None else 1e-3 * x  # noqa: E731
    radius, pixel = metres(options.smallest_radius), metres(options.pixel)
    return ShapeOrder(options.file, options.unit, radius, pixel, options.section, options.which)


# The function of each command but `demo`, `sweep` and `map`; it returns the exit code.
_ORDERS: dict[str, Callable[[argparse.Namespace, Path], int]] = {
    "design": _design,
    "fit": _fit,
    "pinch": _pinch,
    "replay": _replay,
}


def _sweep_or_map(options: argparse.Namespace) -> None:
    order: Any = _cli.sweep_order(options) if options.command == "sweep" else _cli.map_order(options)
    filled = options.command == "sweep" and order.store
    # A sweep keeps its chunks in a folder within, which is empty if its first chunk failed.
    made = [] if filled else [Path(order.out, "chunks"), *_missing(order.out)]
    folder = Path(order.store) if filled else _writable(order.out)
    try:
        with _cli.timed("Loading"):
            _cli.configure()
            work = _cli.swept if options.command == "sweep" else _cli.mapped
        print("\n".join(work(order, folder, _cli.timed)))
    finally:
        _without_empty(made)


def _page(demo: Demo, folder: Path, names: list[str], *, plotting: Any, grasp: Any, run: Any) -> list[str]:
    """Write page.html, or say what that needs."""
    try:
        with _cli.timed("Writing the page"):
            plotting.page(grasp, run, folder / "page.html", title=demo.title)
    except ImportError as error:
        return [f"  no page.html: {error}"]
    names.append("page.html")
    return []


def _save_times(demo: Demo, seconds: float) -> Any:
    """How many states to save, evenly spaced; or at which times: at each frame of the film, then fewer."""
    if seconds <= demo.shown:
        return min(max(301, round(100 * seconds) + 1), 3001)
    import numpy as np

    frames = np.arange(0.0, demo.shown, demo.speed / _FPS)
    return np.concatenate([frames, np.linspace(demo.shown, seconds, 301)])


def _progress(done: int, total: int) -> None:
    if sys.stderr.isatty():
        _cli.say(f"\rAnimating ... {done} of {total} frames", end="," if done == total else "")


DEMOS = {
    "pivoted": Demo(
        "a two-joint finger rolls on a pivoted object (Part 2)",
        seconds=3.0,
        speed=0.5,
        figures={
            "fig07_contours.png": lambda plotting, grasp, run: plotting.contours(grasp),
            "fig08_poses.png": lambda plotting, grasp, run: plotting.poses(grasp, run),
            "fig09_18_responses.png": lambda plotting, grasp, run: plotting.responses(grasp, run),
        },
        scene="pivoted_scene",
        facts="pivoted_facts",
    ),
    "pinch": Demo(
        "a three-joint and a two-joint finger pinch a free rectangle (Part 1)",
        seconds=10.0,
        speed=0.1,
        figures={
            "contours.png": lambda plotting, grasp, run: plotting.contours(grasp),
            "fig01_poses.png": lambda plotting, grasp, run: plotting.poses(grasp, run, forces=True),
            "responses.png": lambda plotting, grasp, run: plotting.responses(grasp, run),
            "phase.png": lambda plotting, grasp, run: plotting.phase(grasp, run),
        },
        scene="pinch_scene",
        facts="pinch_facts",
        shown=0.6,
    ),
    "pinch3d": Demo(
        "two three-joint fingers pinch a cuboid in space (Part 3)",
        seconds=2.0,
        speed=0.1,
        figures={
            "pose.png": lambda plotting, grasp, run: plotting.poses(grasp, run, forces=True),
            "loci.png": lambda plotting, grasp, run: plotting.loci(grasp, run),
            "responses.png": lambda plotting, grasp, run: plotting.responses(grasp, run),
        },
        scene="pinch3d_scene",
        facts="pinch3d_facts",
        shown=0.6,
        animated=lambda plotting: {
            "view": plotting.View(elevation=14.0, azimuth=-72.0, links=False),
            "forces": False,
            "size": 6.5,
        },
        page=True,
    ),
}


if __name__ == "__main__":
    sys.exit(main())
