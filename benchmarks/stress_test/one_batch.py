"""One batch of the stress test: drawn, run by the engine, judged."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

import jaxroll as jxr
from benchmarks.stress_test import engine_runs as engine
from benchmarks.stress_test.hard_scenes import grazing
from benchmarks.stress_test.judge import Judge, Run, Verdicts
from benchmarks.stress_test.judge_plane import Motion, Plane
from benchmarks.stress_test.judge_space import Space
from benchmarks.stress_test.planar_scenes import draw, Structure
from benchmarks.stress_test.spatial_scenes import draw_space, Spatial

# What of a scene is not the grasp's.
_NOT_GRASP = ("q", "v", "s", "t1", "rtol", "period", "push", "max_steps")
CODES = (
    "successful",
    "max_steps_reached",
    "step_collapsed",
    "singular_contact",
    "contour_end",
    "contact_lost",
    "slipping",
    "joint_limit",
    "penetration",
    "not_finite",
    "unreachable",
    "solver_failed",
)
# By how much the start of the fourth run is moved.
DISTURBANCE = 1e-10


def scene_of(structure: Any, seed: int, chunk: int) -> tuple[dict[str, Any], np.random.Generator]:
    """The plain numbers of a batch, and the generator that drew them."""
    rng = np.random.default_rng([seed, chunk, *structure.name.encode()])
    if isinstance(structure, Spatial):
        return draw_space(structure, rng, structure.lanes), rng
    if structure.twist == "graze":
        return grazing(rng, structure.lanes, structure.faces[0], friction=structure.friction), rng
    scene = draw(structure, rng, structure.lanes, engine.sampled)
    if structure.twist == "single":
        scene = jax.tree.map(lambda x: x.astype(np.float32) if engine.is_number(x) else x, scene)
    return scene, rng


class Batches:
    """The batches of one structure, which share their programs."""

    def __init__(self, structure: Structure | Spatial) -> None:
        self.structure = structure
        self.programs: engine.Programs | None = None

    def __call__(self, seed: int, chunk: int) -> Verdicts:
        """Draw, run and judge one batch."""
        scene, rng = scene_of(self.structure, seed, chunk)
        return judged(scene, *self.runs(scene, rng))

    def runs(self, scene: dict[str, Any], rng: np.random.Generator) -> tuple[Any, ...]:
        """The four runs of a batch, and the two starts: plain arrays."""
        single = self.structure.twist == "single"
        numbers, still = eqx.partition(
            {name: value for name, value in scene.items() if name not in _NOT_GRASP}, engine.is_number
        )
        if self.programs is None:
            self.programs = engine.Programs(still, self.structure.options)
        q, v, s, t1, rtol = (scene[name] for name in ("q", "v", "s", "t1", "rtol"))
        size = DISTURBANCE if not single else 1e-6
        aside = q + (size * rng.normal(size=q.shape)).astype(q.dtype)
        start, shifted = (self.programs.start(numbers, at, v, s) for at in (q, aside))
        late, shares = (x.astype(q.dtype) for x in (engine.LATE, engine.SHARES))
        if single:
            late = np.linspace(0.9, 1.0, engine.NODES, dtype=q.dtype)
        late = t1[:, None] * late
        run = self.programs.run
        base = run(numbers, start, t1, rtol, late)
        t_end = np.asarray(base.stats.t_end)
        until = np.where(t_end > 0, t_end, t1)
        whole = run(numbers, start, t1, rtol, until[:, None] * shares)
        tight = run(numbers, start, t1, (0.1 * rtol).astype(q.dtype), late)
        moved = run(numbers, shifted, t1, rtol, late)
        plain = [plainly(r) for r in (base, whole, tight, moved)]
        return (*plain, motion(start, one=True), motion(shifted, one=True))


def judged(scene: dict[str, Any], *runs: Any) -> Verdicts:
    """The verdicts on a batch."""
    return Judge(Space(scene) if "surfaces" in scene else Plane(scene), scene)(*runs)


def plainly(run: Any) -> Run:
    """A run of the engine as plain arrays and words."""
    forces = [np.asarray(x, np.float64) for x in (run.multipliers.f, run.multipliers.lam)]
    table = {int(getattr(jxr.RESULTS, name)._value): name for name in CODES}
    return Run(
        np.asarray(run.ts, np.float64),
        motion(run.states),
        motion(run.last, one=True),
        np.array([table[int(x)] for x in np.asarray(run.result._value)], "U20"),
        np.asarray(run.stats.t_end, np.float64),
        np.asarray(run.stats.steps),
        *forces,
    )


def motion(state: Any, one: bool = False) -> Motion:
    """States of the engine as plain arrays; with `one`, states of one time."""
    parts = [np.asarray(x, np.float64) for x in (state.q, state.v, state.s)]
    return Motion(*(x[:, None] if one else x for x in parts))
