"""Broken formulas: how many of 100 small changes to the code do the default tests notice?

`python -m benchmarks.mutants` draws changes from the syntax tree by seed, over all folders of jaxroll,
applies each in a copy of the checkout and runs the test files that cover the changed function, those first
that are nearest to it and quickest, until one fails. What runs where is measured once (`--coverage`, as long
as the default tests) and kept in the folder `--data`, as are results: a run that was cut off goes on. It
prints the survivors, and the share noticed of those that are not equivalent (`EQUIVALENT`, with reasons).
"""

import argparse
import ast
import concurrent.futures
import dataclasses
import json
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks._mutations import drawn, Mutation, mutations

ROOT = Path(__file__).parents[1]
_COPIED = ("jaxroll", "tests", "benchmarks", "notebooks", "pyproject.toml", "README.md", "CHANGELOG.md")
# Tests of layers, imports and timings, and of what a machine has, which say nothing of formulas.
_SKIPPED = {
    "test_architecture.py",
    "test_examples.py",
    "test_oracles.py",
    "test_properties.py",
}
# A mutant may loop for ever: it is noticed where a test file takes this many seconds, and times as long.
_LONGEST = (60.0, 5.0)
# Changes that no test can notice, by hand: (file, function, before, after) and why. Where the function has
# the same text in other lines, in which a test would notice it, the line's text is the fifth.
EQUIVALENT: dict[tuple[str, ...], str] = {
    (
        "jaxroll/geometry/contours/_neural_curvature.py",
        "_closing.newton",
        "0.5",
        "(1.0)",
        "alpha, beta = (f - jnp.clip(step, -0.5, 0.5) for f, step in zip(found, steps, strict=True))",
    ): "how far a step may lead: the search comes to the same root",
    (
        "jaxroll/contact/_contact3.py",
        "Contact3.equations",
        "one.dot(first) > other.dot(second)",
        "(one.dot(first) >= other.dot(second))",
    ): "of two directions that serve as well either one will do",
    (
        "jaxroll/_integration/_bundle.py",
        "bundle",
        "True",
        "(False)",
        "_in_one([leaf for leaf, m in zip(leaves, moves, strict=True) if m is kind]) "
        "for kind in (True, False)",
    ): "the two are made of one another, and as long",
    (
        "jaxroll/geometry/fitting/_bounded_curve.py",
        "_minimum",
        "share > 1e-4",
        "(share >= 0.0001)",
    ): "no power of two is the limit itself",
    (
        "jaxroll/geometry/fitting/_surface_measured.py",
        "_batch.one",
        "2",
        "(3)",
        "at = jax.lax.fori_loop(0, 2, lambda _, at: surface.settled(at), unstack(point))",
    ): "one more round for points that two bring to the surface",
    (
        "jaxroll/_integration/_events.py",
        "check_overlaps",
        "1",
        "(0)",
    ): "whether places can be spread over a surface is the same for any number of them",
    (
        "jaxroll/plotting/_forces.py",
        "arrows",
        "-1",
        "(1)",
        "arm = np.stack([force[:, 1], -force[:, 0]], axis=-1) * (torque / square)[:, None]",
    ): "of a stack of rows the last axis is the second one",
    (
        "jaxroll/contact/_from_gap.py",
        "derived_margin",
        "1.0",
        "(-1.0)",
        "scale = 1.0 / jnp.where(length > 0, length, 1.0)",
    ): "all columns change their sign, their inner products do not",
    (
        "jaxroll/_reaching/_grasp_points.py",
        "_merged",
        "np.abs(line) > same",
        "(np.abs(line) >= same)",
    ): "a coordinate that differs by just the resolution goes either way",
    (
        "jaxroll/_analysis/_rolling_kinematics.py",
        "_Rolling._tangent",
        "cosine < -1.0 + limit",
        "(cosine <= -1.0 + limit)",
    ): "at the limit itself either turn will do",
    (
        "jaxroll/design/_closed_loop_goal.py",
        "ClosedLoop.run",
        "True",
        "(False)",
    ): "runs side by side are those in turn, and take longer",
    (
        "jaxroll/_fingerprint.py",
        "Reader.function",
        "1",
        "(2)",
    ): "a count of which nothing is asked but whether it has grown",
    (
        "jaxroll/_xla/_primitives.py",
        "_Way.__call__",
        "eqx.combine(jax.tree.unflatten(self.at_form, at), self.still)",
        "(eqx.combine(self.still, jax.tree.unflatten(self.at_form, at)))",
    ): "either has what the other has not",
    (
        "jaxroll/geometry/surfaces/_surface_closed_forms.py",
        "Superellipsoid.smoothness",
        "2.0",
        "(-2.0)",
    ): "the remainder is zero for the same numbers",
    (
        "jaxroll/geometry/contours/_table.py",
        "Table._cell",
        "each[:6]",
        "(each)",
    ): "a quintic reads its first six coefficients alone",
    (
        "jaxroll/_fingerprint.py",
        "of_lowered",
        '_sha(rest, digest("main"))',
        "(_sha(digest('main'), rest))",
    ): "a digest of the same two parts in another order tells programs apart as well",
    (
        "jaxroll/geometry/fitting/_bounded_curve.py",
        "_minimum",
        "1e-4 * share",
        "(0.0001)",
    ): "by how much a shortened step has to go down: the search comes to the same minimum",
    (
        "jaxroll/plotting/_forces3.py",
        "Pushes.rows",
        "self.load is None or self.at is None",
        "(self.load is None and self.at is None)",
    ): "a load and where it acts are given together",
    (
        "jaxroll/design/_fingertip.py",
        "_design",
        "eqx.combine(arrays, problem.rest)",
        "(eqx.combine(problem.rest, arrays))",
    ): "either has what the other has not",
    (
        "jaxroll/scenes/_any_pinch.py",
        "_blunted",
        "6",
        "(-6)",
    ): "of two contacts the second one's places are the last, however they are counted",
    (
        "jaxroll/_integration/_step.py",
        "RollingStep.stages",
        "self.reverse or unrolled",
        "(self.reverse)",
    ): "tests run on a CPU, where nothing is unrolled",
    (
        "jaxroll/_analysis/_loci.py",
        "_locus",
        "1.0",
        "(2.0)",
        "some, turning = jnp.where(moves, speed, 1.0), jnp.where(turns, binormal, 1.0)",
    ): "a number to divide by where the quotient is then replaced by NaN",
    (
        "jaxroll/_linalg/_plane.py",
        "root",
        "1.0",
        "(2.0)",
    ): "what the branch that is not taken is worked out of",
    (
        "jaxroll/geometry/contours/_table.py",
        "Table._cell",
        "jnp.clip(whole, 0.0, cells - 1.0)",
        "(jnp.clip(0.0, whole, cells - 1.0))",
    ): "the larger of two numbers is the same either way",
    (
        "jaxroll/_reaching/_postures.py",
        "",
        "100",
        "(101)",
    ): "a bound that a search that arrives does not come to",
    (
        "jaxroll/contact/_contact3.py",
        "Contact3.shift",
        "2",
        "(-2)",
    ): "of four the first or the last two, either way",
    (
        "jaxroll/_closing/_search.py",
        "searched.more",
        "search.count < _STEPS",
        "(search.count <= _STEPS)",
    ): "a bound that a search that arrives does not come to",
    (
        "jaxroll/geometry/fitting/_rolled_line.py",
        "_rolled_on",
        "np.linalg.norm(moved - places[here], axis=1).max() > _FAR * radius",
        "(np.linalg.norm(moved - places[here], axis=1).max() >= _FAR * radius)",
    ): "no place is moved by just that",
    (
        "jaxroll/_reaching/_postures.py",
        "placed_at",
        "np.resize(q, (count * _STARTS, q.shape[1])).reshape(count, _STARTS, -1)",
        "(np.resize(q, (count * _STARTS, q.shape[1])).reshape(_STARTS, count, -1))",
    ): "parts of another size, in the same order",
    (
        "jaxroll/_reaching/_postures.py",
        "_damped",
        "1e-300",
        "(2e-300)",
    ): "a number far below all that differ",
    (
        "jaxroll/_reaching/_grasp_points.py",
        "_refined",
        "1e-300",
        "(2e-300)",
    ): "a number far below all that differ",
    (
        "jaxroll/io/_robot_file.py",
        "_own_inertias",
        "1.0",
        "(2.0)",
        "body.ipos, body.iquat, body.fullinertia = np.zeros(3), (1.0, 0.0, 0.0, 0.0), (np.nan, *[0.0] * 5)",
    ): "MuJoCo brings quaternions to length one",
    (
        "jaxroll/geometry/fitting/_ordering.py",
        "_best_move",
        "flip.min() <= put.min()",
        "(flip.min() < put.min())",
    ): "of two changes that shorten a tour as much either may be made",
    (
        "jaxroll/geometry/fitting/_scan_fit.py",
        "_grid",
        "math.prod(counts) > _MOST",
        "(math.prod(counts) >= _MOST)",
    ): "no grid has just that many cells",
    (
        "jaxroll/geometry/fitting/_band.py",
        "_without_detours",
        "straight < 3.0 * (count + 1) * float(np.median(steps)) + scale",
        "(straight <= 3.0 * (count + 1) * float(np.median(steps)) + scale)",
    ): "no way is just that long",
    (
        "jaxroll/geometry/fitting/_departures.py",
        "jumps",
        "size > steady",
        "(size >= steady)",
    ): "no jump is just that large",
    (
        "jaxroll/plotting/_contours.py",
        "_count",
        "marks < high - 0.3 * step",
        "(marks <= high - 0.3 * step)",
    ): "no contour's length is just there",
    (
        "jaxroll/_analysis/_link_clearance.py",
        "_with_links",
        "finger.joints and finger.turns",
        "(finger.turns)",
    ): "what has no joints, a stage, does not turn",
    (
        "jaxroll/io/_drawing.py",
        "check_scale",
        "abs(scale / stated - 1.0) > 1e-3",
        "(abs(scale / stated - 1.0) >= 0.001)",
    ): "no drawing states a unit that is off by just that",
    (
        "jaxroll/geometry/contours/_support.py",
        "fit_series",
        "points - centre",
        "(points)",
        "size = np.sqrt(np.mean(np.sum((points - centre) ** 2, axis=-1)))",
    ): "the unit of length in which the fit is worked out",
    (
        "jaxroll/stability/_equilibrium.py",
        "_newton.improve",
        "0",
        "(1)",
        "firm = sigma > _RANK.of(sigma) * sigma[0]",
    ): "a limit near rounding, of the second largest value instead of the largest",
    (
        "jaxroll/geometry/surfaces/_surface_chart.py",
        "Chart.domain",
        "1",
        "(2)",
    ): "JAX takes the last of two for it",
    (
        "jaxroll/geometry/contours/_support.py",
        "Series.table",
        "self.density + 1",
        "(self.density - 1)",
    ): "a grid from which Newton's method begins",
    (
        "jaxroll/geometry/mass/_level_moments.py",
        "_onto.one",
        "first - 0.5 * first * first * way.dot(here.hessian.apply(way)) / square",
        "(-(0.5 * first * first * way.dot(here.hessian.apply(way)) / square))",
    ): "where Newton's method begins, which has a step to spare",
    ("jaxroll/scenes/_pinch_targets.py", "", "1e-9", "(2e-09)"): "a length far below all that differ [m]",
    (
        "jaxroll/plotting/_contours.py",
        "_count",
        "1e-9",
        "(2e-09)",
    ): "a share of a step, for rounding",
    (
        "jaxroll/_integration/_run.py",
        "judge",
        "course.busy & keep",
        "(course.busy | keep)",
    ): "a step at a jump is always kept, and a run that is over asks for no more jumps",
    (
        "jaxroll/_integration/_contact_impulses.py",
        "contact_impulses",
        "jnp.where(jnp.isfinite(row), row, 0.0)",
        "(jnp.where(row, jnp.isfinite(row), 0.0))",
    ): "a state that stands in for rows whose results are left out",
    ("jaxroll/plotting/_forces.py", "arrows", "2", "(-2)"): "of four columns the first two, either way",
    (
        "jaxroll/plotting/_artists.py",
        "Drawing.show",
        "1.5 * self.radius * _SQUARE",
        "(1.5 * self.radius / _SQUARE)",
    ): "all entries are one or minus one",
    (
        "jaxroll/geometry/fitting/_field_solve.py",
        "",
        "4",
        "(5)",
        "for a in range(4)",
    ): "of the fifth there is no b",
    ("jaxroll/stability/_equilibrium.py", "", "100", "101"): "a bound that no search that arrives comes near",
    ("jaxroll/geometry/contours/_spline.py", "Spline._fit", "u[-1] - u[0]", "(u[-1])"): "u begins at zero",
    (
        "jaxroll/stability/_equilibrium.py",
        "_newton",
        "1",
        "(2)",
    ): "a count that is below zero is only asked whether it is",
    (
        "jaxroll/contact/locating/_location3.py",
        "",
        "1e-13",
        "(2e-13)",
    ): "how much rounding a trial step may raise the distance by; the end is polished to rounding",
    (
        "jaxroll/_integration/_report.py",
        "_angle",
        "start / np.linalg.norm(start)",
        "(start)",
    ): "the arctangent of two numbers that both scale with it",
    (
        "jaxroll/_integration/_derivative.py",
        "_Steps.postponed",
        "1.0",
        "(-1.0)",
    ): "it stands in a quotient that is not taken",
    (
        "jaxroll/_xla/_primitives.py",
        "linear_map",
        "eqx.combine(jax.tree.unflatten(at_form, leaves), still)",
        "(eqx.combine(still, jax.tree.unflatten(at_form, leaves)))",
    ): "no leaf is in both",
    ("jaxroll/_integration/_batch.py", "Ensemble.run", "1", "(2)"): "one more row that nobody reads",
    (
        "jaxroll/stability/_statics.py",
        "_stationary.improve",
        "0.1",
        "(0.2)",
    ): "a bound on steps of a search whose end does not depend on it",
    (
        "jaxroll/geometry/contours/_neural_support.py",
        "_refreshed",
        "0.3",
        "(0.6)",
    ): "a bound on steps that a contour near its points does not reach",
    (
        "jaxroll/geometry/contours/_neural_curvature.py",
        "_start",
        "1e-9",
        "(2e-09)",
    ): "the start of a search whose end does not depend on it",
    (
        "jaxroll/geometry/fitting/_scan.py",
        "_alike",
        "edges[:, 0] * (faces.max() + 1) + edges[:, 1]",
        "(edges[:, 0] * (faces.max() + 1) - edges[:, 1])",
    ): "a number of its own for each pair, either way",
    (
        "jaxroll/geometry/fitting/_field_solve.py",
        "_form",
        "1e-12 * np.max(np.diag(form))",
        "(1e-12 / np.max(np.diag(form)))",
    ): "a ridge at rounding level, in the preconditioner alone",
    (
        "jaxroll/_reaching/_grasp_points.py",
        "_newton",
        "1",
        "(2)",
    ): "the shape operator is a square matrix; the other ones there raise",
    (
        "jaxroll/geometry/mass/_surface_moments.py",
        "_chart_moments",
        "change <= _SETTLED",
        "(change < _SETTLED)",
    ): "a difference of floating-point numbers that never is that number",
    (
        "jaxroll/_integration/_step_size.py",
        "_narrowed",
        "8.0",
        "(16.0)",
    ): "how fast the steps grow in which an event is looked for again; it ends at the same event",
    (
        "jaxroll/geometry/fitting/_rolling.py",
        "_drawn",
        "np.abs(distances[:, 0] - radius) > 2.0 * tolerance",
        "(np.abs(distances[:, 0] - radius) >= 2.0 * tolerance)",
    ): "a difference of floating-point numbers that never is that number",
    (
        "jaxroll/stability/_statics.py",
        "_pinch_rest",
        "jnp.max(jnp.abs(_rolled(still, found).gradient)) <= _AT_REST.of(size) * size",
        "(jnp.max(jnp.abs(_rolled(still, found).gradient)) < _AT_REST.of(size) * size)",
    ): "a floating-point number that never is that bound",
    (
        "jaxroll/_integration/_events.py",
        "check_overlaps",
        "1",
        "(2)",
    ): "whether a surface has bounds does not depend on how many of its places are asked for",
    (
        "jaxroll/control/_sensing.py",
        "tip_of",
        "-1",
        "(1)",
    ): "the vectors have one axis, so that both are the last",
    ("jaxroll/geometry/mass/_level_moments.py", "", "8192", "(8193)"): "how many are worked out at once",
    (
        "jaxroll/geometry/fitting/_even_spline.py",
        "EvenSpline.feet",
        "np.linspace(0.0, self.pieces, 8 * self.pieces + 1)",
        "(np.linspace(self.pieces, 0.0, 8 * self.pieces + 1))",
    ): "the same places to begin at, in another order",
    (
        "jaxroll/contact/locating/_location3.py",
        "_refine.improve",
        "2.0",
        "(4.0)",
    ): "how fast the longest step of a search grows again; its end is polished to rounding",
    (
        "jaxroll/geometry/contours/_neural_curvature.py",
        "_start",
        "1e-9 * len(points)",
        "(1e-09 / len(points))",
    ): "the start of a search whose end does not depend on it",
    (
        "jaxroll/contact/locating/_location.py",
        "_verified",
        "at.rise * scene.scale",
        "(at.rise)",
    ): "a bound at rounding level, which no valley of bodies larger than a micrometre comes near",
    ("jaxroll/design/_minimise.py", "", "0.05", "(0.1)"): "how dull a search begins; it ends as sharp",
    (
        "jaxroll/_mechanics/_entry.py",
        "compiled_for_many.called",
        "given <= _FEW",
        "(given > _FEW)",
    ): "which of two machine codes is made, of one value",
    (
        "jaxroll/plotting/_responses.py",
        "responses",
        "axes[: len(shown)]",
        "(axes)",
    ): "those beyond were taken out of the figure",
    (
        "jaxroll/geometry/fitting/_contour_fit.py",
        "_bent_at_most",
        "0.98",
        "(1.96)",
    ): "how much a further try gives up at least; it ends where the table bends no more than it may",
    (
        "jaxroll/_reaching/_choice.py",
        "_starts",
        "0.2 * (high - low)",
        "(0.2 / (high - low))",
    ): "how far about the guess some of the searches start",
    ("jaxroll/_reaching/_postures.py", "searched_postures", "1e-15", "(2e-15)"): "damping at rounding level",
    (
        "jaxroll/_cli/_shape_file.py",
        "_check_spread",
        "extents.min() > _FLAT * extents.max()",
        "(extents.min() >= _FLAT * extents.max())",
    ): "floating-point numbers that never are equal",
    (
        "jaxroll/_identify.py",
        "_deviation",
        "1",
        "(2)",
        "return 1.0 if known else float(np.sqrt(left @ left / max(len(left) - numbers, 1)))",
    ): "how small the last step must be where there are no more data than numbers",
    (
        "jaxroll/stability/_equilibrium.py",
        "_memory_sizes",
        "0",
        "(1)",
        "positive = lambda x: jnp.where(x > 0, x, 1.0)  # noqa: E731",
    ): "which sizes are taken for the units of a search; its end does not depend on them",
    (
        "jaxroll/plotting/_motion3.py",
        "rotation_vectors",
        "1e-12",
        "(-1e-12)",
    ): "where there is no turn at all both ways give zero",
}

# Arguments that change nothing wherever they stand: before, after, what the line has, and why.
_WITHOUT_EFFECT = (
    ("True", "(False)", "strict=True", "lengths that always agree are not compared"),
    ("-1", "(1)", "workers=-1", "one thread finds what several find"),
)


@dataclasses.dataclass(frozen=True)
class Coverage:
    """Seconds that each test file takes, and which of them run each function: by "file:function"."""

    seconds: dict[str, float]
    tests: dict[str, list[str]]

    def ordered(self, mutation: Mutation) -> list[str]:
        """The test files that run what is changed: the nearest by name and the quickest first."""
        place = f"{mutation.file}:{mutation.place}"
        known = self.tests.get(place)
        if known is None:  # module level, or a class's body: whatever runs something of that file
            known = sorted(
                {t for key, names in self.tests.items() if key.startswith(mutation.file) for t in names}
            )
        return sorted(known, key=lambda test: self._cost(test, mutation))

    def _cost(self, test: str, mutation: Mutation) -> float:
        words = set(re.split(r"[_/.]", mutation.file.removesuffix(".py"))) - {"jaxroll", ""}
        near = len({_stem(w) for w in words} & {_stem(w) for w in test.removesuffix(".py").split("_")})
        return self.seconds[test] / (1.0 + 4.0 * near)


def _stem(word: str) -> str:
    return word.rstrip("s0123456789")[:6]


def _environment(tree: Path) -> dict[str, str]:
    # XLA_FLAGS stay unset where they are: the tests then choose to compile quickly.
    ours = {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    return {**os.environ, **ours}


def _pytest(
    tree: Path,
    test: str,
    *,
    longest: float | None = None,
    prefix: tuple[str, ...] = (),
    options: tuple[str, ...] = ("-x",),
) -> int:
    """Exit code of one test file in a copy of the checkout; 1 where it took too long."""
    call = [sys.executable, *prefix, "-m", "pytest", "-n", "0", "-q", *options, "-p", "no:cacheprovider"]
    try:
        done = subprocess.run(
            [*call, f"tests/{test}"],
            cwd=tree,
            env=_environment(tree),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=longest,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return 1
    return done.returncode


def _copied(place: Path) -> Path:
    for name in _COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, place / name, ignore=shutil.ignore_patterns("__pycache__", "*.png"))
        elif source.exists():
            shutil.copy(source, place / name)
    return place


def covered(data: Path, jobs: int) -> Coverage:
    """What the default tests run, file by file; measured once and kept."""
    tests = sorted(path.name for path in (ROOT / "tests").glob("test_*.py"))
    left = [t for t in tests if t not in _SKIPPED and not (data / f"{t}.json").exists()]
    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        for test, seen in zip(left, pool.map(_measured, left), strict=True):
            (data / f"{test}.json").write_text(json.dumps(seen))
            print(f"{test}: {seen['seconds']:.0f} s, exit code {seen['code']}", file=sys.stderr, flush=True)
    return _read(data)


def _measured(test: str) -> dict[str, object]:
    """One test file's seconds, exit code and the functions that it runs, in a copy of the checkout."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as place:
        tree, raw = _copied(Path(place)), Path(place) / "coverage"
        prefix = ("-m", "coverage", "run", f"--data-file={raw}", "--source=jaxroll")
        code = _pytest(tree, test, prefix=prefix, options=())
        functions = _lines(tree, raw)
    return {"seconds": time.perf_counter() - start, "code": code, "functions": functions}


def _read(data: Path) -> Coverage:
    seconds, tests = {}, {}
    for path in sorted(data.glob("test_*.json")):
        seen = json.loads(path.read_text())
        if seen["code"] != 0:  # it fails as it is, and so says nothing of a change
            continue
        test = path.name.removesuffix(".json")
        seconds[test] = seen["seconds"]
        for place in seen["functions"]:
            tests.setdefault(place, []).append(test)
    return Coverage(seconds, tests)


def _lines(tree: Path, raw: Path) -> list[str]:
    """The functions that ran, by "file:function": a line of their bodies is among the lines that did."""
    import coverage

    data = coverage.CoverageData(str(raw))
    data.read()
    ran = []
    for file in data.measured_files():
        path = Path(file)
        lines = set(data.lines(file) or ())
        waiting: list[tuple[ast.AST, str]] = [(ast.parse(path.read_text()), "")]
        while waiting:
            node, place = waiting.pop()
            for child in ast.iter_child_nodes(node):
                inside = place
                if isinstance(child, ast.FunctionDef | ast.ClassDef):
                    inside = f"{place}.{child.name}".strip(".")
                if isinstance(child, ast.FunctionDef):
                    body = range(child.body[0].lineno, (child.end_lineno or 0) + 1)
                    if lines & set(body):
                        ran.append(f"{path.relative_to(tree).as_posix()}:{inside}")
                waiting.append((child, inside))
    return sorted(set(ran))


def tried(tree: Path, mutation: Mutation, reach: Coverage, budget: float) -> dict[str, object]:
    """Apply a mutation in a copy of the checkout, run tests until one fails, and take it back."""
    tests = reach.ordered(mutation)
    path, start, ran = tree / mutation.file, time.perf_counter(), []
    source = path.read_text()
    path.write_text(mutation.applied(source))
    by = None
    try:
        for test in tests:
            if time.perf_counter() - start > budget:
                break
            ran.append(test)
            if _pytest(tree, test, longest=_LONGEST[0] + _LONGEST[1] * reach.seconds[test]) != 0:
                by = test
                break
    finally:
        path.write_text(source)
    whole = by is not None or len(ran) == len(tests)
    spent = round(time.perf_counter() - start, 1)
    return {"noticed": by, "ran": ran, "whole": whole, "seconds": spent, **dataclasses.asdict(mutation)}


def run(chosen: list[Mutation], data: Path, jobs: int, budget: float) -> dict[str, dict[str, object]]:
    """Every mutation's fate; those already known are not tried again."""
    reach, kept = covered(data, jobs), data / "results.json"
    results: dict[str, dict[str, object]] = json.loads(kept.read_text()) if kept.exists() else {}
    trees: queue.Queue[Path] = queue.Queue()

    def one(mutation: Mutation) -> tuple[str, dict[str, object]]:
        tree = trees.get()
        try:
            return mutation.name, tried(tree, mutation, reach, budget)
        finally:
            trees.put(tree)

    with tempfile.TemporaryDirectory() as place, concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        for i in range(jobs):
            (Path(place) / str(i)).mkdir()
            trees.put(_copied(Path(place) / str(i)))
        left = [m for m in chosen if m.name not in results and reason(m) is None]
        for name, found in pool.map(one, left):
            results[name] = found
            part = kept.with_suffix(".part")
            part.write_text(json.dumps(results, indent=1))
            part.rename(kept)
            print(told(found), file=sys.stderr, flush=True)
    return {m.name: results[m.name] for m in chosen if m.name in results and reason(m) is None}


def reason(mutation: Mutation) -> str | None:
    """Why a mutation changes nothing, if it does not."""
    for before, after, word, why in _WITHOUT_EFFECT:
        line = mutation.text_of_line
        # The line has the same text nowhere else, so that it is this argument that changes.
        if (mutation.before, mutation.after) == (before, after) and word in line and line.count(before) == 1:
            return why
    key = (mutation.file, mutation.place, mutation.before, mutation.after)
    return EQUIVALENT.get(key) or EQUIVALENT.get((*key, mutation.text_of_line))


def told(found: dict[str, object]) -> str:
    """One line about a mutation's fate."""
    fate = f"noticed by {found['noticed']}" if found["noticed"] else "SURVIVED"
    if not found["whole"]:
        fate += " as far as the time went"
    change = " ".join(f"{found['before']}  ->  {found['after']}".split())
    return f"{fate} ({found['seconds']} s)  {found['file']}:{found['line']} {found['place']}: {change:.200}"


def main() -> None:
    parser = argparse.ArgumentParser("python -m benchmarks.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--budget", type=float, default=600.0, help="seconds of tests for one mutant")
    parser.add_argument("--data", type=Path, default=Path(tempfile.gettempdir()) / "jaxroll-mutants")
    parser.add_argument("--coverage", action="store_true", help="only measure which tests run what")
    parser.add_argument("--list", action="store_true", help="only print what is drawn")
    options = parser.parse_args()
    options.data.mkdir(parents=True, exist_ok=True)
    chosen = drawn(ROOT, options.count, options.seed)
    if options.list:
        print("\n".join(f"{m.file}:{m.line} {m.place}: {m.before!r:.80} -> {m.after!r:.80}" for m in chosen))
        print(f"{sum(len(mutations(ROOT, f)) for f in (ROOT / 'jaxroll').rglob('*.py'))} in all")
        return
    if options.coverage:
        covered(options.data, options.jobs)
        return
    found = run(chosen, options.data, options.jobs, options.budget)
    lived = [one for one in found.values() if not one["noticed"]]
    same = [m for m in chosen if reason(m) is not None]
    print("\n".join(told(one) for one in lived))
    for m in same:
        print(f"equivalent  {m.file}:{m.line} {m.place}: {m.before} -> {m.after}: {reason(m)}")
    share = 100.0 * (len(found) - len(lived)) / max(len(found), 1)
    print(f"{len(found) - len(lived)} of {len(found)} noticed ({share:.0f} %), {len(same)} equivalent")


if __name__ == "__main__":
    main()
