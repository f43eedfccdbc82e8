"""The first call of one function in a fresh process, phase by phase.

`python -m benchmarks._first_call forward pinch` prints JSON: seconds of wall and of processor for every
phase, and how the run ended.
"""

import time

_PHASES, _LAST = {}, [(time.perf_counter(), time.process_time())]


def _mark(name: str) -> None:
    """End a phase."""
    now = time.perf_counter(), time.process_time()
    _PHASES[name] = [now[0] - _LAST[0][0], now[1] - _LAST[0][1]]
    _LAST[0] = time.perf_counter(), time.process_time()


import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

import jaxroll as jxr  # noqa: E402

# Names are imported with their first use: what runs need (diffrax above all) belongs to the import.
_ = jxr.simulate
_mark("import")

import json  # noqa: E402
import sys  # noqa: E402
from collections.abc import Callable  # noqa: E402
from typing import Any  # noqa: E402

import jax.numpy as jnp  # noqa: E402

from benchmarks import _shaped  # noqa: E402

_TIPS = {"tip": (_shaped.catenary, jnp.ones(1)), "axes": (_shaped.ellipse, jnp.ones(2))}


def call(scene: str) -> Any:
    """`simulate` as a user calls it, the scene made before; then a second time."""
    grasp, state = jax.block_until_ready(getattr(jxr.scenes, scene)())
    _mark("scene")
    runs = []
    for name in ("call", "again"):
        runs.append(jax.block_until_ready(jxr.simulate(grasp, state, _shaped.SECONDS[scene])))
        _mark(name)
    return runs[0].result._value


def compiled(function: Callable, *args: Any) -> Any:
    """Any function under `jax.jit`: tracing, lowering and compiling, running; twice run."""
    traced = jax.jit(function).trace(*args)
    _mark("trace")
    lowered = traced.lower()
    _mark("lower")
    program = lowered.compile()
    _mark("compile")
    out = jax.block_until_ready(program(*args))
    _mark("call")
    jax.block_until_ready(program(*args))
    _mark("again")
    return out


def forward(scene: str) -> Any:
    """The same run inside `jax.jit`."""
    grasp, state = jax.block_until_ready(getattr(jxr.scenes, scene)())
    _mark("scene")
    return compiled(lambda g, s: _shaped.end(scene, g, s), grasp, state)[1]


def gradient(scene: str, which: str) -> Any:
    """Value and reverse gradient in parameters of the fingertips, through closing."""
    tip, x = _TIPS[which]
    goal = lambda x: _shaped.end(scene, *_shaped.with_tip(scene, tip(x)))  # noqa: E731
    jax.block_until_ready(getattr(jxr.scenes, scene)())
    _mark("scene")
    return compiled(jax.value_and_grad(goal, has_aux=True), x)[0][1]


def main() -> None:
    way, scene = sys.argv[1:]
    ways = {"call": call, "forward": forward}
    _mark("rest")
    code = ways[way](scene) if way in ways else gradient(scene, way)
    print(json.dumps({**_PHASES, "code": int(code)}))


if __name__ == "__main__":
    main()
