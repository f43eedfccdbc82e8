"""Does a change of the code leave all programs as they were? Fingerprints of what JAX hands to XLA.

`python -m benchmarks.lowered --keep before.json` keeps the fingerprints of all scenes' programs: runs, a
batch, a gradient, starts and what is observed. After a move or a renaming `python -m benchmarks.lowered
--compare before.json` says which of them differ; symbols are numbered in order, so that names of functions
do not count.
"""

import argparse
import hashlib
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import diffrax
import jax
import jax.numpy as jnp

import jaxroll as jxr

SCENES = (
    ("pivoted", {}),
    ("pinch", {}),
    ("ball_plate", {}),
    ("pinch_ellipse", {}),
    ("ring", {}),
    ("roller", {}),
    ("turntable", {}),
    ("tube", {}),
    ("wheel", {}),
    ("rattleback", {}),
    ("incline", {}),
    ("pinch3d", {}),
)


def programs() -> dict[str, Callable[[], Any]]:
    """What to lower, by name: a function that does."""
    found: dict[str, Callable[[], Any]] = {}
    for name, options in SCENES:
        found[f"{name}: run"] = lambda name=name, options=options: _run(name, options)
        found[f"{name}: close"] = lambda name=name, options=options: _closed(name, options)
        found[f"{name}: residuals"] = lambda name=name, options=options: _seen(name, options)
    found["pivoted: batch of 64, Tsit5"] = _batch
    found["pivoted: gradient"] = _gradient
    found["pinch: Rosenbrock"] = lambda: _run("pinch", {}, solver=jxr.Rosenbrock())
    found["pivoted: CSM"] = lambda: _run("pivoted", {}, formulation=jxr.CSM())
    found["pinch: penetration"] = lambda: _run("pinch", {}, events=("lift", "penetration"))
    return found


def _run(name: str, options: dict[str, Any], **asked: Any) -> Any:
    grasp, state = getattr(jxr.scenes, name)(**options)
    record = ("multipliers", "energy")
    return jax.jit(lambda s: jxr.simulate(grasp, s, 0.1, ts=3, record=record, **asked)).lower(state)


def _closed(name: str, options: dict[str, Any]) -> Any:
    grasp, state = getattr(jxr.scenes, name)(**options)
    return jax.jit(lambda s: jxr.close(grasp, s)).lower(state)


def _seen(name: str, options: dict[str, Any]) -> Any:
    grasp, state = getattr(jxr.scenes, name)(**options)
    return jax.jit(lambda s: (jxr.residuals(grasp, s), jxr.multipliers(grasp, 0.0, s))).lower(state)


def _turned(damping: Any) -> Any:
    grasp, state = jxr.scenes.pivoted()
    return jxr.simulate(grasp.with_(damping=damping), state, 0.1, ts=1, solver=diffrax.Tsit5()).last.q[0]


def _batch() -> Any:
    return jax.jit(jax.vmap(_turned)).lower(jnp.linspace(0.004, 0.008, 64))


def _gradient() -> Any:
    return jax.jit(jax.grad(_turned)).lower(jnp.asarray(0.006))


def fingerprint(lowered: Any) -> str:
    """Of a program's text, without places and names."""
    names: dict[str, str] = {}

    def numbered(match: re.Match[str]) -> str:
        return names.setdefault(match.group(0), f"@{len(names)}")

    text = re.sub(r"@[\w.$]+", numbered, lowered.as_text())
    return hashlib.sha256(text.encode()).hexdigest()


def main() -> None:
    parser = argparse.ArgumentParser("python -m benchmarks.lowered", description=__doc__)
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--keep", type=Path, metavar="FILE", help="write the fingerprints")
    where.add_argument("--compare", type=Path, metavar="FILE", help="say which differ from those kept")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    found = {name: fingerprint(lower()) for name, lower in programs().items()}
    if options.keep:
        options.keep.write_text(json.dumps(found, indent=1))
        print(f"{len(found)} programs")
        return
    kept = json.loads(options.compare.read_text())
    changed = [name for name in kept if found.get(name) != kept[name]]
    print("\n".join([*changed, f"{len(changed)} of {len(kept)} programs differ"]))
    sys.exit(bool(changed))


if __name__ == "__main__":
    main()
