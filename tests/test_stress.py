"""Random scenes under a judge that shares nothing with the engine, and the judge under corrupted runs."""

import ast
import dataclasses
import types
from pathlib import Path

import numpy as np
import pytest

import jaxroll as jxr
from benchmarks.stress_test.hard_scenes import grazing
from benchmarks.stress_test.judge import Judge, picked
from benchmarks.stress_test.judge_contours import along, length
from benchmarks.stress_test.judge_plane import Motion, Plane
from benchmarks.stress_test.judge_space import Space
from benchmarks.stress_test.planar_scenes import _contour, draw, Structure
from benchmarks.stress_test.spatial_scenes import draw_space, Spatial
from tests.subjects.dipping_force import dipping, T1, TOLERANCE

SCENES = Structure(
    "test",
    ("catenary",),
    ("catenary",),
    (2,),
    free=False,
    control="servo",
    gravity=True,
    lanes=200,
)
FOLDER = Path(__file__).parents[1] / "benchmarks" / "stress_test"


@pytest.fixture(scope="module")
def case():
    """200 scenes and their four runs, as plain arrays; all are made by two programs."""
    from benchmarks.stress_test.one_batch import Batches, scene_of

    scene, rng = scene_of(SCENES, 0, 0)
    return scene, Batches(SCENES).runs(scene, rng)


def verdicts(scene, runs):
    return Judge(Plane(scene), scene)(*runs)


def test_nothing_is_wrong_with_200_random_scenes(case):
    found = verdicts(*case)
    assert [(i, found.code[i], words) for i, words in enumerate(found.wrong) if words] == []
    ends = set(found.code)
    assert {"successful", "contact_lost", "contour_end"} <= ends
    assert np.isfinite(found.measures["agreement"]).sum() > 50
    assert np.isfinite(found.measures["energy"]).sum() > 50
    assert np.isfinite(found.measures["defect"]).sum() > 50


def test_judge_imports_nothing_of_the_engine():
    known = {"numpy", "scipy", "dataclasses", "typing", "collections", "warnings"}
    files = [*FOLDER.glob("judge*.py")]
    assert len(files) == 4
    for path in files:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = [node.module] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
                for name in names:
                    ours = name.startswith("benchmarks.stress_test.judge")
                    assert ours or name.split(".")[0] in known, (path, name)


@pytest.fixture(scope="module")
def few(case):
    """Some of the lanes, of each end that there is: a judge for every corruption is quick with these."""
    scene, runs = case
    ends = runs[0].code
    moving = (runs[0].t_end > 0) & (np.abs(runs[1].saved.v).max(axis=(1, 2)) > 1e-2)
    lanes = [
        np.flatnonzero((ends == end) & moving)[:6] for end in ("successful", "contact_lost", "contour_end")
    ]
    lanes = np.concatenate(lanes)
    return picked(scene, lanes), [only(run, lanes) for run in runs]


def only(run, lanes):
    """A run, or its motion, of some lanes."""
    if isinstance(run, np.ndarray):
        return run[lanes]
    return dataclasses.replace(
        run, **{f.name: only(getattr(run, f.name), lanes) for f in dataclasses.fields(run)}
    )


def copied(runs):
    """The runs with arrays of their own."""

    def copy(run):
        if isinstance(run, np.ndarray):
            return run.copy()
        return dataclasses.replace(
            run, **{f.name: copy(getattr(run, f.name)) for f in dataclasses.fields(run)}
        )

    return [copy(run) for run in runs]


def lane_of(runs, code):
    """A lane with this end."""
    return int(np.flatnonzero(runs[0].code == code)[0])


CORRUPTED = {
    "gap": lambda runs, i: runs[1].saved.q.__setitem__((i, 30, 0), runs[1].saved.q[i, 30, 0] + 1e-7),
    "tangency": lambda runs, i: runs[1].saved.s.__setitem__((i, 30), runs[1].saved.s[i, 30] + 1e-8),
    "creep": lambda runs, i: runs[1].saved.v.__setitem__(
        (i, 30, 1), 1.001 * runs[1].saved.v[i, 30, 1] + 1e-6
    ),
    "force": lambda runs, i: runs[1].f.__setitem__(i, -runs[1].f[i]),
    "energy": lambda runs, i: runs[1].saved.v.__setitem__(i, 1.001 * runs[1].saved.v[i]),
    "defect": lambda runs, i: runs[1].ts.__setitem__(i, 1.01 * runs[1].ts[i]),
    "agreement": lambda runs, i: runs[2].last.v.__setitem__(i, runs[2].last.v[i] + 0.1),
    "not finite": lambda runs, i: runs[0].last.q.__setitem__(i, np.nan),
    "ended early": lambda runs, i: runs[0].t_end.__setitem__(i, 0.9 * runs[0].t_end[i]),
}


@pytest.mark.parametrize("word", CORRUPTED)
def test_judge_sees_a_corrupted_run(few, word):
    scene, runs = few[0], copied(few[1])
    found = verdicts(scene, runs)
    measure = {"energy": "energy", "defect": "defect"}.get(word)
    good = np.isfinite(found.measures[measure]) if measure else np.ones(len(found.code), bool)
    lane = int(np.flatnonzero((found.code == "successful") & good)[0])
    if word == "energy":  # what velocities gain at once, positions do not tell
        runs[1].saved.v[lane, 20:] *= 1.001
    else:
        CORRUPTED[word](runs, lane)
    assert any(text.startswith(word) for text in verdicts(scene, runs).wrong[lane])


@pytest.mark.parametrize(
    "code",
    [
        "contact_lost",
        "slipping",
        "contour_end",
        "singular_contact",
        "step_collapsed",
        "not_finite",
        "unreachable",
    ]
    + ["max_steps_reached"],
)
def test_judge_sees_a_code_that_is_not_the_cause(few, code):
    scene, runs = few[0], copied(few[1])
    for true in ("successful", "contact_lost", "contour_end"):
        if true != code:
            lane = lane_of(runs, true)
            runs[0].code[lane] = code
            assert any(text.startswith("cause") for text in verdicts(scene, runs).wrong[lane]), true
            runs[0].code[lane] = true


def test_judge_sees_an_event_that_success_hides(few):
    scene, runs = few[0], copied(few[1])
    lane = lane_of(runs, "contact_lost")
    # What a run over the event would say, which the one with many saved times stops at.
    runs[0].code[lane], runs[0].t_end[lane] = "successful", scene["t1"][lane]
    missed = lambda: [text for text in verdicts(scene, runs).wrong[lane] if "many saved times" in text]  # noqa: E731
    assert len(missed()) == 1
    # A chaotic motion comes to it at another time in every run: it need not come in all of them.
    runs[2].t_end[lane] *= 1.01
    assert not missed()


@pytest.mark.parametrize("limit", ["force", "cone", "room", "bend"])
def test_judge_sees_a_limit_that_was_passed(few, limit):
    scene, runs = dict(few[0]), few[1]
    lane = lane_of(runs, "successful")
    if limit == "force":
        scene["controller"] = scene["controller"] | {"push": [-5.0 * p for p in scene["controller"]["push"]]}
        scene["gravity"] = -scene["gravity"]
    if limit == "cone":
        scene["contacts"] = [scene["contacts"][0] | {"friction": np.full(len(runs[0].code), 1e-9)}]
    tip = scene["fingers"][0]["tip"]
    if limit == "room":
        tip = tip | {"ends": tip["ends"] - 2.0 * np.ptp(tip["ends"], axis=1)[:, None]}
    if limit == "bend":
        tip = tip | {"kind": "bowl", "a": 1e-3 * tip["a"]}
        tip["origin"] = tip["origin"] + few[0]["contacts"][0]["s_tip"] - tip["origin"]
    scene["fingers"] = [scene["fingers"][0] | {"tip": tip}]
    wrong = verdicts(scene, runs).wrong[lane]
    assert any(text.startswith(f"missed: {limit}") for text in wrong)


@pytest.mark.parametrize(
    "kind", ["line", "circle", "catenary", "bowl", "ellipse", "support", "neural_support"]
)
def test_judges_contours_have_unit_speed_and_their_curvature(kind):
    rng = np.random.default_rng(3)
    shape = _contour(kind, rng, 5, np.full(5, 0.02))
    span = length(shape)[:, None] if "ends" not in shape else np.ptp(shape["ends"], axis=1)[:, None]
    s = shape["origin"][:, None] + span * np.linspace(-0.45, 1.4 if "ends" not in shape else 0.45, 50)
    step = 1e-5 * span
    before, here, after = (along(shape, s + k * step) for k in (-1, 0, 1))
    assert np.abs((after.point - before.point) / (2 * step) - here.tangent).max() < 1e-6
    turn = np.angle(after.tangent / before.tangent) / (2 * step)
    assert np.abs(turn - here.curvature).max() < 1e-5 * np.abs(here.curvature).max() + 1e-9


PLANES = (
    Structure(
        "a",
        ("ellipse",),
        ("circle", "line"),
        (3, "jaw2"),
        gravity=True,
        control="servo",
        touch=((0, 0), (1, 0)),
    ),
    Structure("b", ("support",), ("circle", "ellipse"), (2, 3), touch=((0, 0), (1, 0)), gravity=True),
    Structure("c", ("catenary",), ("circle",), (3,), free=False, control="press", gravity=True),
)
SPACES = (
    Spatial("d", ("ellipsoid",), ("torus", "sphere"), (3, 2)),
    Spatial("e", ("sphere",), ("plane",), (0,), spin="prevented"),
    Spatial("f", ("sphere",), ("cylinder",), (0,), hollow=True),
)


@pytest.mark.parametrize("structure", (*PLANES, *SPACES), ids=lambda s: s.name)
def test_judges_equations_keep_contact_and_energy(structure):
    """Carried on by its own accelerations, a motion stays in contact, and its energy goes where it says."""
    rng = np.random.default_rng(1)
    space = isinstance(structure, Spatial)
    scene = draw_space(structure, rng, 40) if space else draw(structure, rng, 40, lambda shape: shape)
    equations = Space(scene) if space else Plane(scene)
    motion = Motion(*(scene[name][:, None] for name in ("q", "v", "s")))
    motion.v = 0.0 * motion.v
    judge = Judge(equations, scene)
    with np.errstate(all="ignore"):
        start = equations.at(motion)
        slow = (np.min(start.bend[:, 0], axis=-1) > 0.1) & (start.firmness[:, 0] > 0.05)
        pace = np.sqrt(np.sqrt(np.sum(start.rates**2, axis=-1))) + 1.0
        one, two = [judge._carried(motion, h / pace) for h in (0.02, 0.04)]
        ends = [equations.at(at) for at in (one, two)]
    for seen in ends:
        assert np.abs(seen.gap[slow]).max() < 1e-6
        assert np.abs(seen.tangency[slow]).max() < 1e-4
    assert slow.sum() > 10
    gained = [seen.kinetic + seen.potential - start.kinetic - start.potential for seen in ends]
    scale = ends[1].kinetic + 1e-300
    lost = np.abs(gained[1] / scale)[slow, 0]
    assert np.median(lost) < (0.2 if "damping" in scene["controller"] else 1e-4)


@pytest.mark.parametrize(("kind", "friction"), [("ellipse", False), ("circle", True)])
def test_grazing_scenes_roll_and_graze(kind, friction):
    scene = grazing(np.random.default_rng(0), 64, kind, friction=friction)
    seen = Plane(scene).at(Motion(*(scene[name][:, None] for name in ("q", "v", "s"))))
    assert np.abs(seen.gap).max() < 1e-15
    assert np.abs(seen.tangency).max() < 1e-14
    assert np.abs(seen.creep).max() < 1e-14


def test_a_force_that_dips_between_two_stages_is_not_hidden_by_a_small_pivot():
    """A contact pulls from 0.3223 to 0.3303 s, within one step of 0.04 s."""
    hand, start = dipping()
    run = jxr.simulate(hand, start, T1, ts=1, rtol=TOLERANCE, throw=False)
    assert run.result == jxr.RESULTS.contact_lost and int(run.stats.contact) == 1
    assert abs(float(run.stats.t_end) - 0.3223009) < 1e-6


def test_the_judge_leaves_out_what_its_own_integral_cannot_tell():
    """Of a loss 1/(a^2 + x^2), whose integral is an arctangent; energies may be right, or wrong by 1e-8."""
    x, a = -np.cos(np.pi * np.arange(65) / 64), 0.38
    gone = (np.arctan(x / a) - np.arctan(-1.0 / a)) / a
    judge = Judge.__new__(Judge)
    judge.precision, judge.size = np.finfo(float).eps, 0.0
    one, found = np.ones((1, 65, 1)), []
    run = types.SimpleNamespace(ts=x[None], saved=types.SimpleNamespace(v=0.0 * one))
    for wrong in (0.0, 1e-8):
        seen = types.SimpleNamespace(
            loss=(1.0 / (a**2 + x**2))[None],
            kinetic=(10.0 - gone + wrong * (x > 0.5))[None],
            potential=0.0 * x[None],
            momentum=one,
            inertial=one,
            firmness=one[..., 0],
        )
        found.append(judge._energy(seen, run, 1e-15 * one[..., 0])["energy_units"][0])
    assert found[0] < 10.0 and found[1] > 1e6
