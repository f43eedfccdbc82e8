"""Random scenes of many structures, judged by code that shares nothing with the engine."""

import argparse
import sys
import time
from collections import Counter
from typing import Any

import equinox as eqx
import jax
import numpy as np

import jaxroll as jxr
from benchmarks import _stress_engine as engine
from benchmarks._judge import Judge, Run
from benchmarks._judge_plane import Motion, Plane
from benchmarks._judge_space import Space
from benchmarks._stress_hard import grazing
from benchmarks._stress_plane import draw, Structure
from benchmarks._stress_space import draw_space, Spatial

_RUN_KEYS = ("q", "v", "s", "t1", "rtol", "period", "push")

CODES = (
    "successful", "max_steps_reached", "step_collapsed", "singular_contact", "contour_end", "contact_lost",
    "slipping", "penetration", "not_finite", "unreachable", "solver_failed",
)
S = Structure
STRUCTURES = (
    S("pinch-circle", ("circle",), ("circle", "circle"), (2, 2), touch=((0, 0), (1, 0))),
    S("pinch-ellipse", ("ellipse",), ("ellipse", "circle"), (2, 3), touch=((0, 0), (1, 0))),
    S("faces-catenary", ("line", "line"), ("catenary", "catenary"), (3, 2), friction=True, gravity=True),
    S("pivot-catenary", ("catenary",), ("catenary",), (2,), free=False, control="press"),
    S("pivot-support", ("support",), ("ellipse",), (3,), free=False, control="servo", gravity=True, friction=True),
    S("roll-line", ("ellipse",), ("line",), ("jaw0",), control="none", gravity=True),
    S("ring-support", ("support",), ("circle", "support", "circle"), (2, 2, 2), touch=((0, 0), (1, 0), (2, 0)), friction=True),
    S("spline-pinch", ("spline",), ("circle", "circle"), (2, 2), touch=((0, 0), (1, 0)), friction=True),
    S("neural-press", ("neural_support",), ("neural_support",), (2,), free=False, control="press", friction=True),
    Spatial("egg-table", ("ellipsoid",), ("plane",), (0,)),
    Spatial("pinch-space", ("ellipsoid",), ("sphere", "ellipsoid"), (3, 2)),
    S("graze-lift", ("ellipse",), ("line",), ("jaw0",), control="none", gravity=True, twist="graze"),
    S("graze-slip", ("circle",), ("line",), ("jaw0",), control="none", gravity=True, friction=True, twist="graze"),
    S("neural-curve", ("neural_curvature",), ("circle",), ("jaw2",), control="servo", gravity=True),
)


def names(run: Any) -> np.ndarray:
    """Codes of a batch as words."""
    table = {int(getattr(jxr.RESULTS, name)._value): name for name in CODES}
    return np.array([table[int(x)] for x in np.asarray(run.result._value)])


def _motion(state: Any, one: bool = False) -> Motion:
    parts = [np.asarray(x, np.float64) for x in (state.q, state.v, state.s)]
    return Motion(*(x[:, None] if one else x for x in parts))


def plain(run: Any) -> Run:
    """A run of the engine as plain arrays."""
    forces = [None, None]
    if run.multipliers is not None:
        forces = [np.asarray(run.multipliers.f), np.asarray(run.multipliers.lam)]
    return Run(
        np.asarray(run.ts), _motion(run.states), _motion(run.last, one=True), names(run),
        np.asarray(run.stats.t_end), np.asarray(run.stats.accepted), *forces,
    )


def judged(structure: Structure, programs: dict, seed: int, lanes: int) -> tuple[Any, Any]:
    """Draw, run and judge one batch."""
    rng = np.random.default_rng([seed, *structure.name.encode()])
    space = isinstance(structure, Spatial)
    if not space and structure.twist.startswith("graze"):
        scene = grazing(rng, lanes, structure.faces[0], friction=structure.friction)
    else:
        scene = draw_space(structure, rng, lanes) if space else draw(structure, rng, lanes, engine.sampled)
    numbers = {k: v for k, v in scene.items() if k not in _RUN_KEYS}
    numbers, still = eqx.partition(numbers, engine.is_number)
    if structure.name not in programs:
        programs[structure.name] = engine.Programs(still, structure.options)
    run = programs[structure.name]
    start = run.start(numbers, scene["q"], scene["v"], scene["s"])
    aside = scene["q"] + 1e-10 * rng.normal(size=scene["q"].shape)
    shifted = run.start(numbers, aside, scene["v"], scene["s"])
    t1, rtol = scene["t1"], scene["rtol"]
    late = t1[:, None] * engine.LATE
    base = run.run(numbers, start, t1, rtol, late)
    t_end = np.asarray(base.stats.t_end)
    until = np.where(t_end > 0, t_end, t1)
    whole = run.run(numbers, start, t1, rtol, until[:, None] * engine.SHARES)
    tight = run.run(numbers, start, t1, 0.1 * rtol, late)
    moved = run.run(numbers, shifted, t1, rtol, late)
    judge = Judge(Space(scene) if space else Plane(scene), scene)
    runs = (plain(r) for r in (base, whole, tight, moved))
    return scene, judge(*runs, _motion(start, one=True), _motion(shifted, one=True))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--structure", nargs="*")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lanes", type=int, default=256)
    parser.add_argument("--lane", type=int)
    options = parser.parse_args()
    for structure in STRUCTURES:
        if options.structure and structure.name not in options.structure:
            continue
        start = time.perf_counter()
        try:
            _, verdicts = judged(structure, {}, options.seed, options.lanes)
        except Exception as error:
            import traceback; traceback.print_exc()
            print(f"== {structure.name}: {type(error).__name__}: {str(error)[:300]}", flush=True)
            continue
        m = verdicts.measures
        print(f"== {structure.name}: {time.perf_counter() - start:.0f} s; {dict(Counter(verdicts.code.tolist()))}")
        for name in ("gap", "tangency", "creep", "force", "energy", "energy_units", "defect", "agreement", "growth"):
            v = m[name][np.isfinite(m[name])]
            if len(v):
                print(f"   {name:12s} median {np.median(v):.1e} 99% {np.quantile(v, 0.99):.1e} max {v.max():.1e} ({len(v)})")
        kinds = Counter(w.split(" ")[0] + " " + (w.split(" ")[1] if ":" in w else "") for ws in verdicts.wrong for w in ws)
        print("   wrong:", sum(map(bool, verdicts.wrong)), dict(kinds))
        shown = [i for i, w in enumerate(verdicts.wrong) if w]
        for i in shown[:8]:
            print(f"     lane {i} {verdicts.code[i]} t {m['t_end'][i]:.4g}/{m['t1'][i]:.4g} steps {m['steps'][i]}: {'; '.join(verdicts.wrong[i])}")
        if options.lane is not None:
            i = options.lane
            print({k: v[i] for k, v in m.items()}, verdicts.code[i], verdicts.wrong[i])
        sys.stdout.flush()


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    import os
    jax.config.update("jax_compilation_cache_dir", os.environ.get("STRESS_CACHE", "/tmp/w/jaxcache/stress"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    main()
