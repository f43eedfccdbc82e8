"""Which files a reader has to open: those that execute in one evaluation, in a run, in its gradient.

`python -m benchmarks.walk` traces the pivoted scene and prints the files of jaxroll that run, in the order in
which they are entered, with their lengths. Packages' `__init__` and files of which only a decorator runs are
left out, as nobody reads these to follow a call.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import jax
import jax.numpy as jnp

import jaxroll as jxr
from jaxroll._integration._state_vector import layout, slope
from jaxroll._mechanics import tabled_grasp

ROOT = Path(jxr.__file__).parent


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

    return {
        "one evaluation of the equations of motion": lambda: jax.make_jaxpr(
            lambda y: slope(lay, ready, 0.0, y, formulation=jxr.Index1())[0]
        )(x),
        "simulate": lambda: jxr.simulate(grasp, state, 0.01, ts=1),
        "gradient of simulate": lambda: jax.jit(jax.grad(run)).lower(jnp.asarray(0.006)),
    }


def main() -> None:
    argparse.ArgumentParser("python -m benchmarks.walk", description=__doc__).parse_args()
    jax.config.update("jax_enable_x64", True)
    for name, call in calls().items():
        files = walked(call)
        print(f"{name}: {len(files)} files, {sum(files.values())} lines")
        print("".join(f"  {file} ({lines})\n" for file, lines in files.items()))


if __name__ == "__main__":
    main()
