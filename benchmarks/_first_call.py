"""The first call of one function in a fresh process, phase by phase.

`python -m benchmarks._first_call forward pinch` prints JSON: seconds of wall and of processor for every
phase, lines of the lowered program, and how the run ended. A scene is named with its argument, as in
`ring(5)`.
"""

import time

_PHASES: dict = {}
_LAST = [(time.perf_counter(), time.process_time())]


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
import re  # noqa: E402
import sys  # noqa: E402
from collections.abc import Callable  # noqa: E402
from typing import Any  # noqa: E402

import jax.numpy as jnp  # noqa: E402

from benchmarks import _shaped  # noqa: E402

# Numbers of the fingertips that a gradient is taken in, and the scene made of them.
_TIPS = {
    "tip": (jnp.ones(1), lambda scene, x: _shaped.with_tip(scene, _shaped.catenary(x))),
    "axes": (jnp.ones(2), lambda scene, x: _shaped.with_tip(scene, _shaped.ellipse(x))),
    "six axes": (jnp.ones(6), lambda scene, x: jxr.scenes.pinch3d(tips=_shaped.ellipsoids(x))),
}


def made(scene: str) -> tuple[jxr.Grasp, jxr.State]:
    """The scene of a name such as `pinch` or `ring(5)`."""
    name, count = re.fullmatch(r"(\w+)(?:\((\d+)\))?", scene).groups()  # type: ignore[union-attr]
    grasp, state = jax.block_until_ready(getattr(jxr.scenes, name)(*([int(count)] if count else [])))
    _mark("scene")
    return grasp, state


def call(scene: str, **options: Any) -> Any:
    """`simulate` as a user calls it, the scene made before; then a second time."""
    grasp, state = made(scene)
    seconds = _shaped.SECONDS.get(scene, 0.5)
    runs = []
    for name in ("call", "again"):
        runs.append(jax.block_until_ready(jxr.simulate(grasp, state, seconds, **options)))
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
    _PHASES["lines"] = lowered.as_text().count("\n")
    return out


def forward(scene: str) -> Any:
    """The same run inside `jax.jit`."""
    grasp, state = made(scene)
    return compiled(lambda g, s: _shaped.end(scene, g, s), grasp, state)[1]


def damping(scene: str) -> Any:
    """Value and reverse gradient in the controller's damping; the start is given."""
    grasp, state = made(scene)
    goal = lambda c: _shaped.end(scene, grasp.with_(damping=c), state)  # noqa: E731
    return compiled(jax.value_and_grad(goal, has_aux=True), grasp.controller.damping)[0][1]


def gradient(scene: str, which: str) -> Any:
    """Value and reverse gradient in parameters of the fingertips, through closing."""
    x, shaped = _TIPS[which]
    goal = lambda x: _shaped.end(scene, *shaped(scene, x))  # noqa: E731
    made(scene)
    return compiled(jax.value_and_grad(goal, has_aux=True), x)[0][1]


def main() -> None:
    way, scene = sys.argv[1:]
    ways = {
        "call": call,
        "stiff": lambda scene: call(scene, solver=jxr.Rosenbrock()),
        "forward": forward,
        "damping": damping,
    }
    _mark("rest")
    code = ways[way](scene) if way in ways else gradient(scene, way)
    print(json.dumps({**_PHASES, "code": int(code)}))


if __name__ == "__main__":
    main()
