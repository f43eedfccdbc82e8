"""What each piece of hot-path machinery costs and gains: the same calls with it and without (ten minutes).

`python -m benchmarks.machinery --write` rewrites its section of README.md; `--quick`: one round. The pieces
are those of `jaxroll/_xla`, and the closed forms of the derivatives of a contact. Each row is a process of
its own, in which one piece is replaced by the plain thing that it stands for, before anything else of jaxroll
is imported. Rows are run in turn, round after round; the least times count.
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

from benchmarks._common import device, table, uncached, versions, write_section

_ROUNDS = 2
# By name: what is put in the place of names of `jaxroll._xla`, or of the contacts' own derivatives.
PIECES = {
    "as it is": "",
    "without `one_kernel`": "xla.one_kernel = lambda function, *args: function(*args)",
    "without `once`": "xla.once = lambda tree: tree",
    "without `shared`": "xla.shared = xla._share_cotangents.shared = lambda function: function",
    "without `perturbed`": """
import equinox as eqx
def all_of_them(values, tangents):
    moving, still = eqx.partition(values, eqx.is_inexact_array)
    fill = lambda x, dot: jnp.zeros_like(x) if dot is None else dot
    return moving, still, jax.tree.map(fill, moving, tangents)
xla.perturbed = xla._one_kernel.perturbed = all_of_them
""",
    "with XLA's sine and cosine": "xla.sine_cosine = lambda x: (jnp.sin(x), jnp.cos(x))",
    "without `remembered`": "xla.remembered = lambda build: build",
    "with JAX's loops": """
xla.repeated = lambda going, turn, start, held: jax.lax.while_loop(going, lambda x: turn(x, held), start)
xla.counted = lambda count, turn, start, held: jax.lax.fori_loop(
    0, count, lambda i, x: turn(i, x, held), start
)
""",
    "without `SOON`": "xla.SOON = {}",
    "without `uncollected`": "xla.uncollected = xla._primitives.uncollected = contextlib.nullcontext",
    "without closed forms of contacts": """
from jaxroll.contact import AbstractContact, Contact, Contact3
for name in ("gap_rate", "pfaffian", "rolling", "place_rate", "bias", "bend", "unknown_bend", "settled"):
    for kind in (Contact, Contact3):
        setattr(kind, name, getattr(AbstractContact, name))
""",
}
MEASURES = (
    "first call [s]",
    "public call [ms]",
    "run [ms]",
    "batch [us a run]",
    "gradient, first [s]",
    "gradient [ms]",
    "gradient in space, first [s]",
)


def measured(patch: str) -> dict[str, float]:
    """Times of the pivoted scene, and of a derivative in space, with one piece replaced; in this process."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    import jaxroll._xla as xla

    exec(patch, {"xla": xla, "jax": jax, "jnp": jnp, "contextlib": contextlib})
    import jaxroll as jxr

    def end_of(grasp: Any, state: Any) -> Callable[[Any], Any]:
        """The first coordinate at the end of a run, as a function of the damping of the joints."""
        return lambda damping: jxr.simulate(grasp.with_(damping=damping), state, 1.0, ts=1).last.q[0]

    grasp, state = jxr.scenes.pivoted()
    ended = end_of(grasp, state)
    found: dict[str, float] = {}
    found["first call [s]"] = _seconds(lambda: jxr.simulate(grasp, state, 1.0, ts=1).last.q)
    found["public call [ms]"] = 1e3 * _best(lambda: jxr.simulate(grasp, state, 1.0, ts=1).last.q, 40)
    run, many = jax.jit(ended), jax.jit(jax.vmap(ended))
    dampings = jnp.linspace(0.004, 0.008, 512)
    found["run [ms]"] = 1e3 * _best(lambda: run(0.006), 40)
    found["batch [us a run]"] = 1e6 / 512 * _best(lambda: many(dampings), 4)
    slope = jax.jit(jax.value_and_grad(ended))
    found["gradient, first [s]"] = _seconds(lambda: slope(0.006))
    found["gradient [ms]"] = 1e3 * _best(lambda: slope(0.006), 20)
    # What keeps a program small shows where it is large.
    spatial = jax.jit(jax.value_and_grad(end_of(*jxr.scenes.pinch3d())))
    found["gradient in space, first [s]"] = _seconds(lambda: spatial(0.01))
    return found


def _seconds(call: Callable[[], Any]) -> float:
    import jax

    start = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - start


def _best(call: Callable[[], Any], count: int) -> float:
    _seconds(call)
    return min(_seconds(call) for _ in range(count))


def _fresh(name: str) -> dict[str, float]:
    call = [sys.executable, "-m", "benchmarks.machinery", "--piece", name]
    done = subprocess.run(call, env=uncached(), capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{name}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout.strip().splitlines()[-1])


def report(rounds: int) -> str:
    """The table of all pieces, and what comes of it."""
    best: dict[str, dict[str, float]] = {}
    for _ in range(rounds):
        for name in PIECES:
            for measure, value in _fresh(name).items():
                mine = best.setdefault(name, {})
                mine[measure] = min(mine.get(measure, value), value)
    usual = best["as it is"]
    rows = [[name, *(_cell(mine[m], usual[m]) for m in MEASURES)] for name, mine in best.items()]
    pays = {
        name.removeprefix("without ").removeprefix("with "): max(mine[m] / usual[m] for m in MEASURES)
        for name, mine in best.items()
        if name != "as it is"
    }
    gains = "; ".join(f"{name} up to {gain:.2g} times" for name, gain in pays.items())
    head = f"**Conclusion.** Without a piece, or with the plain thing in its place, these calls take: {gains}"
    return f"{head}.\n\n{table(['1 s', *MEASURES], rows)}\n\n{device()}; {versions('jax', 'jaxlib')}."


def _cell(value: float, usual: float) -> str:
    return f"{value:.3g}" if value is usual else f"{value:.3g} ({value / usual:.2f})"


def main() -> None:
    parser = argparse.ArgumentParser("python -m benchmarks.machinery", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one round")
    parser.add_argument("--write", action="store_true", help="rewrite the section of the page")
    parser.add_argument("--piece", choices=PIECES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.piece:
        print(json.dumps(measured(PIECES[options.piece])))
        return
    text = report(1 if options.quick else _ROUNDS)
    print(text)
    if options.write:
        write_section("machinery", text)


if __name__ == "__main__":
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    main()
