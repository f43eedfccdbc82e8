"""The library's sentences as the command line says them: options for arguments, and lengths in their units.

A sentence of the library names an argument of a function, and gives lengths in metres; at the command line
there are options instead, and millimetres. JAX is not imported here.
"""

import re
from collections.abc import Iterable, Mapping

# For the commands that read a file of points, the option or words for each argument of a function.
_OF_SHAPES = {
    "path": "FILE",
    "image": "FILE",
    "points": "the points of FILE",
    "vertices": "the vertices of FILE",
    "faces": "the faces of FILE",
    "normals": "the normals of FILE",
    "unit": "--unit",
    "pixel": "--pixel",
    "which": "--which",
    "origin": "--section",
    "smallest_radius": "--smallest-radius",
}
OPTIONS: dict[str, dict[str, str]] = {
    "fit": _OF_SHAPES,
    "pinch": _OF_SHAPES
    | {
        "object": "FILE",
        "contour": "FILE",
        "surface": "FILE",
        "fingers": "--hand",
        "density": "--density",
        "thickness": "--thickness",
        "friction": "--friction",
        "force": "--force",
        "t1": "--seconds",
    },
    "design": {
        "path": "--tip",
        "tip": "--tip",
        "points": "the points of --tip",
        "unit": "--unit",
        "steps": "--steps",
    },
    "replay": {"path": "FILE", "until": "--until", "speed": "--speed", "fps": "--fps"},
    "sweep": {
        "resume": "--out",
        "store": "--store",
        "names": "--keep",
        "keep": "--keep",
        "t1": "--seconds",
        "ts": "--times",
        "rtol": "--rtol",
        "chunk": "--chunk",
        "client": "--workers",
        "make": "SCENE",
        "parameters": "--set",
    },
    "map": {
        "x": "-x",
        "y": "-y",
        "at": "--at",
        "parameters": "STORE",
        "path": "STORE",
        "values": "--show",
    },
}
# Advice that only Python can follow.
_IN_PYTHON = (
    " (closed=False makes an open one)",
    " (ordered=True keeps the order given; `fit_contour` with smallest_radius bears noise)",
)
_NUMBER = r"(-?\d[\d.]*(?:e[+-]?\d+)?)"
# One length in metres, or the first of two before their unit.
_LENGTH = re.compile(rf"(?<![\w.]){_NUMBER}(?:(?= to {_NUMBER} m\b)| (m)\b)")


def in_options(text: str, command: str, set_names: Iterable[str] = ()) -> str:
    """A sentence or a report of the library as a command says it.

    Args:
        text: The sentence.
        command: Which command says it.
        set_names: Of a sweep, the names that `--set` has given.
    """
    options = OPTIONS.get(command, {}) | {name: f"--set {name}" for name in set_names}
    for each in _IN_PYTHON:
        text = text.replace(each, "")
    text = re.sub(r"argument (\w+)", lambda found: _named(found[1], options), text)
    if "smallest_radius" not in options:
        return text
    # A line about the radius or a section has its lengths in metres; all other lines of a report are in
    # millimetres already.
    lines = text.replace("smallest_radius", "--smallest-radius").split("\n")
    in_metres = lambda line: "--smallest-radius" in line or "argument --section" in line  # noqa: E731
    return "\n".join(_in_millimetres(line) if in_metres(line) else line for line in lines)


def _named(name: str, options: Mapping[str, str]) -> str:
    """How a command begins a sentence about an argument."""
    told = options.get(name, name)
    return told if told.startswith("the ") else f"argument {told}"


def _in_millimetres(line: str) -> str:
    """A line whose lengths are in metres, with millimetres in their place."""
    unit = lambda found: " mm" if found[3] else ""  # noqa: E731
    return _LENGTH.sub(lambda found: f"{1e3 * float(found[1]):.6g}{unit(found)}", line)
