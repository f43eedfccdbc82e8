"""Which files a reader has to open: those that execute in one evaluation, in a run, in its gradient.

`python -m benchmarks.walk` traces the pivoted scene and prints the files of jaxroll that run, in the order in
which they are entered, with their lengths; `--write` writes how many there are into its section of README.md.
Packages' `__init__` and files of which only a decorator runs are left out, as nobody reads these to follow a
call.
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import jax
import jax.numpy as jnp

import jaxroll as jxr
from benchmarks._common import command, table
from jaxroll._integration._state_vector import layout, slope
from jaxroll._mechanics import tabled_grasp

ROOT = Path(jxr.__file__).parent
LONGEST = 500  # lines that a file may have: `tests/test_architecture.py`
ASKED = {  # files, and lines where these are asked too
    "one evaluation of the equations of motion": (10, 1500),
    "simulate": (20, None),
    "gradient of simulate": (22, None),
}


def walked(function: Callable[[], Any]) -> dict[str, int]:
    """Files of the package that a call enters, in order, and how many lines each has."""
    found: dict[str, int] = {}

    def seen(frame: FrameType, event: str, _: Any) -> None:
        path = frame.f_code.co_filename
        if event == "call" and path.startswith(str(ROOT)) and frame.f_code.co_name != "<module>":
            name = Path(path).relative_to(ROOT).as_posix()
            if name not in found and not name.endswith("__init__.py"):
                found[name] = len(Path(path).read_text().splitlines())

    sys.setprofile(seen)
    try:
        function()
    finally:
        sys.setprofile(None)
    return found


def calls() -> dict[str, Callable[[], Any]]:
    """An evaluation of the equations of motion, a run, and a gradient of one."""
    grasp, state = jxr.scenes.pivoted()
    ready, lay = tabled_grasp(grasp).prepared(), layout(grasp, False)
    x = jnp.concatenate([state.q, state.v, state.s])

    def run(damping: Any) -> Any:
        return jxr.simulate(grasp.with_(damping=damping), state, 0.02, ts=1).last.q[0]

    ways = (
        lambda: jax.make_jaxpr(lambda y: slope(lay, ready, 0.0, y, formulation=jxr.Index1())[0])(x),
        lambda: jxr.simulate(grasp, state, 0.01, ts=1),
        lambda: jax.jit(jax.grad(run)).lower(jnp.asarray(0.006)),
    )
    return dict(zip(ASKED, ways, strict=True))


def joined(lengths: Sequence[int]) -> int:
    """Files that are left where all that fit into one are joined, the longest first."""
    room: list[int] = []
    for length in sorted(lengths, reverse=True):
        fits = [i for i, left in enumerate(room) if length <= left]
        if fits:
            room[fits[0]] -= length
        else:
            room.append(LONGEST - length)
    return len(room)


def report(quick: bool) -> str:
    """The files of each call; on the page, how many there are and what keeps them from being fewer."""
    found = {name: walked(call) for name, call in calls().items()}
    evaluation, run, gradient = found.values()
    rows = []
    for (name, files), (most, most_lines) in zip(found.items(), ASKED.values(), strict=True):
        # Those of an evaluation with each other alone: what else stood there would be more to read for it.
        own = [lines for file, lines in files.items() if file in evaluation]
        others = [lines for file, lines in files.items() if file not in evaluation]
        asked = f"{most}" if most_lines is None else f"{most}, {most_lines} lines"
        rows.append(
            [name, asked, f"{len(files)}", f"{sum(files.values())}", f"{joined(own) + joined(others)}"]
        )
        print(f"{name}: {len(files)} files, {sum(files.values())} lines")
        print("".join(f"  {file} ({lines})\n" for file, lines in files.items()))
    header = ["files that a reader enters in", "asked, at most", "files", "lines", "joined by length alone"]
    said = (
        f"An evaluation is read in {len(evaluation)} files, a run in {len(run)}, its gradient in"
        f" {len(gradient)}; asked are {', '.join(str(most) for most, _ in ASKED.values())}."
    )
    return f"**Conclusion.** {said}\n\n{table(header, rows)}"


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    command("walk", report)
