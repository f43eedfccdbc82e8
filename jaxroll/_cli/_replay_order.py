"""What `jaxroll replay` is asked for; JAX is not imported here, so that complaints come at once."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

_REPLAY = "Read a run that jaxroll.save wrote together with its grasp, print its report, draw and animate it."


@dataclass(frozen=True)
class ReplayOrder:
    """What to show again, and how.

    Attributes:
        file: Name of the file.
        film: "gif", "mp4", or None for no animation.
        fps: Pictures a second.
        speed: Simulated seconds per second shown; None: 1, or what makes the film 12 s long.
        until: Last time shown [s]; None: the end of the run.
    """

    file: str
    film: str | None
    fps: float
    speed: float | None
    until: float | None


def replay_parser(commands: Any, number: Callable[..., Any], about: str) -> None:
    """Add the command to a parser; `number` converts text within limits, `about` ends its help."""
    replay = commands.add_parser("replay", help=_REPLAY, description=_REPLAY, epilog=about)
    replay.add_argument(
        "file", metavar="FILE", help="as `demo` (run.npz) and `pinch` (pinch.npz) write it too"
    )
    replay.add_argument("--out", metavar="FOLDER", help="where to write (default: jaxroll-replay)")
    kinds = "of the animation (default: gif); mp4 needs the program ffmpeg"
    replay.add_argument("--film", choices=("gif", "mp4"), default="gif", help=kinds)
    replay.add_argument("--fps", metavar="N", type=number(1.0, 50.0), default=25.0, help="(default: 25)")
    pace = "simulated seconds per second shown (default: 1, or more if the film were longer than 12 s)"
    replay.add_argument("--speed", metavar="X", type=number(1e-4, 1e4), help=pace)
    replay.add_argument("--until", metavar="T", type=number(-1e4, 1e4), help="last time shown [s]")
    replay.add_argument("--no-animation", action="store_true", help="write no motion.gif")


def replay_order(options: argparse.Namespace) -> ReplayOrder:
    """The order that the command line gives."""
    film = None if options.no_animation else options.film
    return ReplayOrder(options.file, film, options.fps, options.speed, options.until)
