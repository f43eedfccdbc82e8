"""Reports that are true: names and units, causes and remedies, friction, pictures of what failed, `why`."""

import dataclasses
import inspect
import pickle
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib import pyplot

import jaxroll as jxr
from jaxroll import _analysis, _mechanics, _motion, _printing, _why, plotting
from jaxroll._analysis import LinkClearance
from jaxroll._analysis._loci import Locus
from jaxroll._integration import cause, complaint, REMEDIES
from jaxroll._integration._strike import Strike
from jaxroll._integration._trajectory import Stats
from jaxroll._mechanics import AbstractBody, AbstractFinger
from jaxroll._motion import Multipliers, Residuals
from jaxroll._printing import listed
from jaxroll._why import _culprit, _early, _MEND, _singular
from jaxroll.design import ClosedLoop, Design, overshoot, settling_time, tracking_error
from jaxroll.design._measures import MEASURES, PARTIAL
from jaxroll.plotting._panels import _is_part_2, panels
from tests.recorded import runs
from tests.subjects import rolling_disc

RUNNING = set(REMEDIES)  # codes that a run can end with
TURNED = np.array([np.cos(0.2), 0.0, 0.0, np.sin(0.2)])  # a quaternion: 0.4 rad about z


def ended(run, code, *, contact=-1, margin=np.nan, t=0.5):
    """A run as if it had ended with a code."""
    where = lambda r: (r.result, r.stats.contact, r.stats.margin, r.stats.t_end)  # noqa: E731
    parts = (jxr.RESULTS._name_to_item[code], np.array(contact), np.array(margin), np.array(t))
    return eqx.tree_at(where, run, parts)


@pytest.mark.parametrize(
    ("curvature", "pivot", "told"),
    [
        (0.0, 1.0, "contact 0 (finger 0 on contour 0) is singular"),
        (9e-5, 1.0, "contact 0 (finger 0 on contour 0) is singular"),  # runs end there already
        (1.1e-4, 0.9e-9, "contacts are redundant or an arm is straight"),
        (1.0, 0.0, "contacts are redundant or an arm is straight"),
        (1.0, np.nan, "contacts are redundant or an arm is straight"),
    ],
)
def test_why_names_a_start_that_is_singular_before_its_forces(scene, curvature, pivot, told):
    pulls = SimpleNamespace(f=np.array([-1.0]))
    start: Any = SimpleNamespace(curvature=np.array([curvature]), pivot=pivot, multipliers=pulls)
    sentence, remedy, _ = _early(scene[0], start, -1)
    assert told in sentence and remedy == REMEDIES["singular_contact"]
    assert _singular(scene[0], start).startswith("yes")
    assert _singular(scene[0], bearing([1.0], [0.0], (1.1e-4,), pivot=1.1e-9)).startswith("no")


def bearing(f, lam, curvature=(1.0, 1.0), ends=(1.0, 1.0), pivot=1.0):
    """Forces and margins of two contacts."""
    forces = SimpleNamespace(f=np.array(f), lam=np.array(lam))
    return SimpleNamespace(
        multipliers=forces, curvature=np.array(curvature), ends=np.array(ends), pivot=pivot
    )


def rubbing_pair(*frictions):
    """Labels and contacts alone, of the pinch."""
    grasp, _ = runs.scene("pinch")
    contacts = [SimpleNamespace(friction=x, presses=True) for x in frictions]
    return SimpleNamespace(contacts=contacts, labels=grasp.labels)


def test_why_names_the_contact_that_would_slip_at_the_start_and_what_it_needs():
    start = bearing((2.0, 3.0), (0.5, 1.8))
    assert (
        _early(rubbing_pair(0.7, 0.7), start, -1) is None
        and _early(rubbing_pair(0.3, None), start, -1) is None
    )
    told, remedy, which = _early(rubbing_pair(0.3, 0.5), start, -1)
    assert told == "fails at the start: contact 1 (finger 1 on contour 1) needs friction 0.6, but has 0.5"
    assert which == 1 and remedy == _MEND["slips"]


@pytest.mark.parametrize(
    ("code", "end", "wanted"),
    [
        ("contact_lost", bearing((2.0, -3.0), (0.0, 0.0)), 1),
        ("contact_lost", bearing((-2.0, 3.0), (0.0, 0.0)), 0),
        ("contour_end", bearing((1.0, 1.0), (0.0, 0.0), ends=(0.1, -1e-9)), 1),
        ("singular_contact", bearing((1.0, 1.0), (0.0, 0.0), curvature=(1e-5, 0.5)), 0),
        ("singular_contact", bearing((1.0, 1.0), (0.0, 0.0), curvature=(0.3, 0.5), pivot=0.1), -1),
        ("slipping", bearing((2.0, 1.0), (0.9, 0.6)), 1),
        ("slipping", bearing((2.0, 1.0), (1.9, 0.6)), 0),
        ("joint_limit", bearing((-2.0, 1.0), (1.9, 0.6)), -1),
        ("contact_lost", None, -1),
    ],
)
def test_why_finds_the_contact_that_ended_a_run_which_does_not_say(code, end, wanted):
    run = ended(runs.run("pinch"), code)
    assert _culprit(rubbing_pair(0.5, 0.5), run, end) == wanted
    assert _culprit(rubbing_pair(0.5, 0.5), ended(run, code, contact=0), end) == 0


def moved(grasp, start, end, *, forces=None):
    """A run made by hand: two saved states of a grasp."""
    q = np.array([start, end], float)
    n, c = sum(body.positions for body in grasp.bodies), len(grasp.contacts)
    assert q.shape == (2, n)
    places = 6 * c if grasp.spatial else c
    states = jxr.State(q, np.zeros((2, grasp.coordinates)), np.zeros((2, places)))
    aside = np.zeros((2, c, 3) if grasp.spatial else (2, c))
    left = Residuals(np.zeros((2, c)), aside, aside)
    stats = Stats(*(np.array(k) for k in (3, 3, 0)), np.array(1.0), np.array(-1), np.array(np.nan))
    last = jax.tree.map(lambda x: np.asarray(x)[-1], states)
    given = jax.device_put((np.array([0.0, 1.0]), states, last, left))
    return jxr.Trajectory(*given, jxr.RESULTS.successful, stats, forces, labels=grasp.labels)


def on_a_plate(*directions):
    """A free disc on a plate with prismatic joints."""
    plate = jxr.Jaw(jxr.Line(), 0.1, directions)
    return jxr.Grasp(jxr.FreeObject(jxr.Circle(0.02), 0.05, 1e-5), plate, jxr.Contact())


def on_a_turntable():
    body = jxr.FreeObject3(jxr.Sphere(0.02), 0.05, 8e-6)
    return jxr.Grasp(body, jxr.Stage(jxr.Plane(), jxr.Turning(2.0)), jxr.Contact3())


def test_every_body_names_its_coordinates(scene):
    hinge = jxr.Finger3([(1, 0, 0)], [(0, 0.06, 0)], [0.04], jxr.Sphere(0.01))
    one = {
        jxr.PivotedObject: (scene[0].object, "theta [rad]"),
        jxr.FreeObject: (on_a_plate().object, "x [m] y [m] theta [rad]"),
        jxr.FreeObject3: (on_a_turntable().object, "x [m] y [m] z [m] qw [] qx [] qy [] qz []"),
        jxr.Finger: (scene[0].fingers[0], "q[0] [rad] q[1] [rad]"),
        jxr.Finger3: (hinge, "q[0] [rad]"),
        type(hinge.prepared()): (hinge.prepared(), "q[0] [rad]"),
        jxr.Jaw: (on_a_plate(0.0, 1.5).fingers[0], "q[0] [m] q[1] [m]"),
        jxr.Stage: (on_a_turntable().fingers[0], "clock [s]"),
    }
    known, found = set(one), {AbstractBody}
    for kind in [*found]:
        found |= {c for c in subclasses(kind) if c.__module__.startswith("jaxroll")}
    # A new body comes with its names. Abstract ones say so (`test_architecture`), by fields too.
    assert {c for c in found if not c.__name__.startswith("Abstract")} == known
    for body, names in one.values():
        assert len(body.labels) == body.positions
        assert " ".join(f"{each.name} [{each.unit}]" for each in body.labels) == names


def subclasses(kind):
    return {kind}.union(*(subclasses(c) for c in kind.__subclasses__()))


def test_a_printed_run_has_each_bodys_own_names_and_units(run):
    text = str(moved(on_a_plate(0.0), [0, 0, 0, 0.01], [2e-3, -1e-3, 0.5, 0.013]))
    assert "object: x +2.000, y -1.000 mm, theta +0.5000 rad" in text
    assert "finger 0: q[0] +3.000 mm" in text and "finger 0: q[0] +3.000 rad" not in text
    start, end = [0, 0, 0.02, 1, 0, 0, 0, 0.0], [1e-3, 0, 0.02, *TURNED, 1.0]
    text = str(moved(on_a_turntable(), start, end))
    assert "object: x +1.000, y +0.000, z +0.000 mm, turned by 0.4000 rad" in text
    assert "finger 0: clock +1.0000 s" in text
    q = np.asarray(run.states.q)
    assert f"object: theta {q[-1, 0] - q[0, 0]:+.4f} rad" in str(run)
    assert "finger 0: q[0] +0.2444, q[1] -0.4291 rad" in str(run)


def test_a_body_without_names_has_no_units():
    """A finger of one's own whose positions are not its joints, and a run that was made by hand."""

    class Own(AbstractFinger):
        tip: object = None
        joints = property(lambda self: 1)
        positions = property(lambda self: 2)
        turns = property(lambda self: True)
        size = property(lambda self: 1.0)
        skeleton = prepared = placed = motion = gravity_potential = lambda self, *args: None

    assert [each.unit for each in Own().labels] == ["", ""]
    bare = eqx.tree_at(lambda r: r.states, moved(on_a_plate(), [0, 0, 0], [1, 2, 3]), None)
    assert "Trajectory(successful" in repr(bare)
    labels = jxr.Trajectory(*(getattr(moved(on_a_plate(), [0.0] * 3, [1, 2, 3]), f) for f in FIRST))
    assert "state: q[0] +1.0000, q[1] +2.0000, q[2] +3.0000" in str(labels)


FIRST = ("ts", "states", "last", "residuals", "result", "stats")


def test_batches_print_names_units_and_which_contacts(run):
    both = [ended(run, "contact_lost", contact=0, t=0.2), ended(run, "contact_lost", contact=0, t=0.3), run]
    lanes = jax.tree.map(lambda *x: np.stack(x), *both)
    text = str(lanes)
    assert text.splitlines()[0].startswith("Trajectory of 3 lanes")
    assert "1 lane: successful" in text
    assert "2 lanes: contact_lost at t = 0.2 to 0.3 s (contact 0: 2)" in text
    assert "object: theta 0.2841 rad" in text and repr(lanes.result).count("contact_lost") == 2
    assert "traced" in repr(lanes) or "3 x 301 states" in repr(lanes)


@pytest.mark.parametrize(
    ("code", "counted"),
    [
        ("joint_limit", "joint"),
        ("torque_limit", "joint"),
        ("penetration", "finger"),
        ("links_meet", "finger"),
    ],
)
def test_batches_say_what_the_number_of_what_ended_them_counts(run, code, counted):
    lanes = jax.tree.map(lambda *x: np.stack(x), ended(run, code, contact=1, t=0.2), run)
    assert f"1 lane: {code} at t = 0.2 s ({counted} 1: 1)" in str(lanes)


@pytest.mark.parametrize("code", sorted(RUNNING))
def test_an_ended_run_says_which_contact_when_by_how_much_and_what_helps(run, code):
    lost = ended(run, code, contact=0, margin=-0.25, t=0.5)
    text = str(lost)
    assert text.startswith(f"Trajectory: {code}\n  ended     ")
    # One is of the start, and two of what was given.
    timeless = code in ("unreachable", "inconsistent_shape", "not_rolling")
    assert ("t = 0.5 s" in cause(lost)) is not timeless
    assert " ".join(REMEDIES[code].split()[:4]) in " ".join(text.split())
    assert complaint(lost).startswith(cause(lost)[0].upper()) and REMEDIES[code] in complaint(lost)
    assert complaint(lost, {}).count(";") == 0  # a caller who has no remedy names none
    if code in ("contact_lost", "slipping", "contour_end", "singular_contact", "penetration", "links_meet"):
        who = "finger 0" if code in ("penetration", "links_meet") else "contact 0 (finger 0 on contour 0)"
        assert who in cause(lost).lower()
        assert code == "singular_contact" or " 0.25 " in f"{cause(lost)} "
    assert max(map(len, text.splitlines())) <= 100


@pytest.mark.parametrize(
    ("code", "past", "words"),
    [
        ("slipping", "outside the friction cone", "at the edge of the friction cone"),
        ("contour_end", "ran past the end of an open contour", "ran to the end of an open contour"),
    ],
)
def test_what_is_rounding_of_the_root_is_not_told_as_an_amount(run, code, past, words):
    for margin in (-1.15e-15, 0.0, 8.88e-16):
        told = cause(ended(run, code, contact=0, margin=margin))
        assert words in told and past not in told and "e-1" not in told
    beyond = cause(ended(run, code, contact=0, margin=-1e-9))
    assert past in beyond and words not in beyond and "1e-09" in beyond


def test_a_run_out_of_steps_tells_how_many_it_was_given(run):
    """The first step, which has no length, is not one of them."""
    for steps, words in ((101, "after 100 steps"), (2, "after 1 step")):
        stats = dataclasses.replace(run.stats, steps=jnp.asarray(steps))
        assert cause(dataclasses.replace(ended(run, "max_steps_reached"), stats=stats)).endswith(words)


def test_hardly_any_energy_has_no_share_that_is_off(run):
    small = jax.tree.map(lambda x: 1e-33 * jnp.ones_like(x), run.energy)
    odd = dataclasses.replace(run, energy=dataclasses.replace(small, residual=1e-18 + 0.0 * small.residual))
    assert "balance within 1.0e-18 J" in str(odd) and "of its size" in str(run)


def test_records_print_their_units():
    """What a class says of the units of its attributes, its record prints."""
    one = np.ones(())
    place = jxr.contact.Location(0.01 * one, *[np.ones(2)] * 3, one, one, None, jxr.RESULTS.successful)
    assert "gap=0.01 m, s=[" in str(place) and "] m, normal=" in str(place)
    blow = Strike(one, Multipliers(one, one, one), one, jxr.RESULTS.successful)
    assert "f=1 N s, lam=1 N s, spin=1 N m s), work=1 J" in str(blow)
    assert str(Locus(*[one] * 8)).count("1/m") == 5
    assert "size=0.02 m, " in str(jxr.design.Limits(size=0.02, steepness=4.0))
    assert "least=0.5 m, time=2 s" in str(LinkClearance(one, one, one, ((0, 1),), 0.5, 2.0, "there"))


@pytest.mark.parametrize("missing", [slice(None), 1])
def test_pictures_want_saved_times(scene, run, missing, tmp_path):
    ts = np.array(run.ts)
    ts[missing] = np.nan
    times = eqx.tree_at(lambda r: r.ts, run, ts)
    for draw in (plotting.page, plotting.animate, plotting.poses, plotting.responses):
        file = (tmp_path / "it",) if draw in (plotting.page, plotting.animate) else ()
        with pytest.raises(ValueError, match=r"argument trajectory\.ts must be finite, but was"):
            draw(scene[0], times, *file)


def test_runs_print_in_a_derivative():
    """Where their counts are known and all else is traced."""
    seen = []

    def rolled(slope):
        grasp, state = rolling_disc.on_slope(slope, friction=0.3)
        run = jxr.simulate(grasp, state, 0.1, ts=3, throw=False)
        seen.append(str(run))
        return run.last.q[0]

    # The second one slips at its start. What would lead back is not asked for, and not compiled.
    jax.vjp(rolled, 0.5), jax.vjp(rolled, 1.0)
    assert seen == 2 * ["Trajectory (being traced)"]


def test_the_shapes_of_a_run_print(run):
    assert str(jax.eval_shape(lambda: run)) == "Trajectory (shapes alone)"


def test_every_code_of_a_run_has_a_remedy():
    others = {"successful", "too_deep", "infeasible", "undetermined"}  # of other functions
    assert set(jxr.RESULTS._name_to_item) - others == RUNNING


def test_an_unknown_contact_is_not_invented(run):
    for code in RUNNING:
        assert "contact 0" not in cause(ended(run, code)) and "nan" not in cause(ended(run, code))


def test_nothing_of_a_run_that_got_there_is_nan(run):
    """Else `jax_debug_nans` would stop every run."""
    assert np.isposinf(run.stats.margin)
    assert not any(np.isnan(leaf).any() for leaf in jax.tree.leaves(run))


def test_a_run_with_one_state_or_none_says_where_it_is(run):
    none = eqx.tree_at(lambda r: r.states.q, run, jnp.full_like(run.states.q, jnp.nan))
    text = str(ended(none, "contact_lost", contact=0, margin=-1.5, t=0.0))
    assert "none of 301 states saved" in text and "start     object: theta 0.2841 rad" in text
    assert "rolled" not in text and "moved" not in text and "residuals" not in text
    one = jax.tree.map(lambda x: x[-1:], (run.ts, run.states, run.residuals, run.multipliers, run.energy))
    where = lambda r: (r.ts, r.states, r.residuals, r.multipliers, r.energy)  # noqa: E731
    text = str(eqx.tree_at(where, run, one))
    assert "at end    object: theta 0.2841 rad" in text and "rolled" not in text and "moved" not in text


def test_the_start_alone_says_nothing_of_the_energy_balance(run):
    where = lambda r: (r.ts, r.states, r.residuals, r.multipliers, r.energy)  # noqa: E731
    first, last = (jax.tree.map(lambda x, k=k: x[k][None], where(run)) for k in (0, -1))
    assert "balance not known: the start alone was saved" in str(eqx.tree_at(where, run, first))
    assert "balance within" in str(eqx.tree_at(where, run, last))
    # One that moved for two steps, nothing being off: the state that is saved is not its start.
    still = eqx.tree_at(lambda energy: (energy.residual, energy.work), last[4], (jnp.zeros(1), jnp.zeros(1)))
    count = lambda n: (*last[:4], still, jnp.asarray(n))  # noqa: E731
    stepped = lambda r: (*where(r), r.stats.accepted)  # noqa: E731
    assert "balance within 0.0e+00 of its size" in str(eqx.tree_at(stepped, run, count(2)))
    assert "balance not known" in str(eqx.tree_at(stepped, run, count(1)))


def test_the_friction_demand_is_stated_and_warned_of(run):
    f, lam = np.asarray(run.multipliers.f), np.asarray(run.multipliers.lam)
    i = int(np.argmax(np.abs(lam / f)))
    assert f"demand up to {abs(lam / f)[i, 0]:.4g}, of contact 0 at t = {run.ts[i]:.4g} s" in str(run)
    assert "above 1" not in str(run)
    steep = eqx.tree_at(lambda r: r.multipliers.lam, run, jnp.where(jnp.arange(301)[:, None] == 7, -4.0, lam))
    assert f"demand up to {4.0 / f[7, 0]:.4g}, of contact 0 at t = 0.07 s; ! above 1" in str(steep)
    pulled = eqx.tree_at(lambda r: r.multipliers.f, run, jnp.where(jnp.arange(301)[:, None] == 7, -1.0, f))
    assert "contact 0 (finger 0 on contour 0) pulls at t = 0.07 s" in str(pulled)
    bare = eqx.tree_at(lambda r: r.multipliers, run, None)
    assert "not recorded" in str(bare) and "demand" not in str(bare)
    forces = Multipliers(jnp.array([[2.0], [4.0]]), jnp.array([[[0.3, 0.4, 0.0]], [[0.0, 0.0, -3.0]]]))
    text = str(
        moved(on_a_turntable(), [0, 0, 0.02, 1, 0, 0, 0, 0], [0, 0, 0.02, 1, 0, 0, 0, 1], forces=forces)
    )
    assert "demand up to 0.75, of contact 0 at t = 1 s" in text


CODES = [jxr.RESULTS, jxr.stability.VERDICTS]


@pytest.mark.parametrize("codes", CODES, ids=lambda codes: codes.__name__)
def test_codes_print_their_names_everywhere(codes):
    names = list(codes._name_to_item)
    items = [getattr(codes, name) for name in names]
    for name, item in zip(names, items, strict=True):
        assert str(item) == repr(item) == f"{item!r:}" == name
        assert pickle.loads(pickle.dumps(item)) == item and codes[item] == codes[getattr(codes, name)]
        assert isinstance(item, codes)
    chosen = jax.jit(lambda x: codes.where(x, items[1], items[0]))(True)
    assert repr(chosen) == names[1] and codes[chosen] == codes[items[1]]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *items[:2])
    assert repr(stacked) == f"[{names[0]}, {names[1]}]"
    many = jax.tree.map(lambda *x: jnp.stack(x), *[items[1]] * 20, items[0])
    assert repr(many) == f"1 {names[0]}, 20 {names[1]}"
    seen = []
    jax.jit(lambda x: seen.append(repr(codes.where(x, *items[:2]))) or x)(True)
    assert "traced" in seen[0] and codes.__name__ in seen[0]


def test_codes_of_a_batch_are_an_array_to_numpy(tmp_path):
    """They are counted, stored, taken apart and compared, by number or by name."""
    items = [jxr.RESULTS.successful, jxr.RESULTS.slipping, jxr.RESULTS.successful]
    codes = jax.tree.map(lambda *x: jnp.stack(x), *items)
    numbers = [int(item) for item in items]
    assert codes.shape == (3,) and len(codes) == 3 and items[0].shape == ()
    assert np.asarray(codes).tolist() == numbers and np.asarray(codes, float).dtype == float
    assert [list(x) for x in np.unique(codes.names, return_counts=True)] == [
        ["slipping", "successful"],
        [1, 2],
    ]
    np.savez(tmp_path / "codes.npz", codes=codes)
    assert np.load(tmp_path / "codes.npz")["codes"].tolist() == numbers
    assert codes[1] == jxr.RESULTS.slipping and repr(codes[1:]) == "[slipping, successful]"
    assert [repr(code) for code in codes] == ["successful", "slipping", "successful"]
    with pytest.raises(IndexError):
        codes[3]
    with pytest.raises(TypeError, match="compare it"):
        bool(items[0])


def records():
    """Every class of the package that holds results as fields, but for the internal ones."""
    public = [jxr, jxr.commands, jxr.contact, jxr.control, jxr.design, jxr.loads, jxr.stability]
    public += [_analysis, _mechanics, _motion]
    found = {jxr.State, Stats, Multipliers, Residuals, jxr.stability.Stability}
    for module in public:
        for value in [getattr(module, name) for name in dir(module) if not name.startswith("_")]:
            if inspect.isclass(value) and issubclass(value, eqx.Module) and value.__repr__ is listed:
                found.add(value)
    return sorted((c for c in found if not inspect.isabstract(c)), key=lambda c: c.__name__)


def test_shapes_print_their_numbers_and_not_what_is_left_out():
    assert repr(jxr.Circle(0.01)) == "Circle(radius=0.01)"
    moved = jxr.Circle(0.01).moved((0.002, 0.0))
    assert repr(moved) == "Moved(contour=Circle(radius=0.01), offset=[0.002, 0], angle=0, origin=0)"
    assert "tip=Circle(radius=0.01)" in repr(jxr.Finger([0.02], [0.05], jxr.Circle(0.01)))
    tabled = jxr.Ellipse(0.01, 0.02).tabled()
    assert repr(tabled).startswith("Ellipse(a=0.01, b=0.02, ") and len(repr(tabled)) < 100
    assert "None" not in repr(jxr.Sphere(0.01)) and "\n" not in repr(jxr.Ellipsoid(0.01, 0.02, 0.03))
    seen = []
    jax.vmap(lambda r: seen.append(repr(jxr.Circle(r))) or r)(jnp.ones(3))
    assert seen == ["Circle(radius=traced float64[])"]


@pytest.mark.parametrize("record", records(), ids=lambda c: c.__name__)
def test_records_print_as_one_line_concrete_batched_traced_and_abstract(record):
    names = [f.name for f in dataclasses.fields(record)]

    def filled(value):
        made = object.__new__(record)
        for name in names:
            object.__setattr__(made, name, value)
        return made

    for value in (jnp.ones(()), jnp.ones(3), jnp.ones((7, 3)).at[0].set(jnp.nan), None, True, 3):
        text = repr(filled(value))
        assert text.startswith(f"{record.__name__}(") and "\n" not in text and len(text) < 900
        left_out = {"memory"} if record is jxr.State and value is None else set()
        assert {name for name in names if f"{name}=" not in text} == left_out
    seen = []
    jax.eval_shape(lambda x: seen.append(repr(filled(x))) or x, jnp.ones(3))
    assert "traced float64[3]" in seen[0] or not names
    assert "unknown float64[3]" in repr(filled(jax.ShapeDtypeStruct((3,), np.float64))) or not names


def test_values_and_units_of_records(run):
    assert repr(run.stats).startswith(f"Stats(steps={int(run.stats.steps)}, accepted=")
    assert "t_end=3 s" in repr(run.stats)
    state = jxr.State(jnp.array([-0.4874871, 2.0]), jnp.zeros(2), jnp.array([1e-3]))
    assert repr(state) == "State(q=[-0.487487, 2], v=[0, 0], s=[0.001])"
    assert "f=301 x 1, 1.41138 to 1.5507 N" in repr(run.multipliers)
    assert len(repr(run)) < 60 and "301 states" in repr(run)
    first = jax.tree.map(lambda x: x[:1], run.states)
    assert "; 1 state)" in repr(dataclasses.replace(run, states=first))


def test_grasps_print_their_parts(scene):
    grasp, _ = scene
    assert repr(grasp) == "Grasp(PivotedObject, Finger; 1 contact; Press)"
    lines = str(grasp).splitlines()
    assert lines[:3] == [
        "Grasp in the plane",
        "  object    PivotedObject: theta [rad]",
        "  finger 0  Finger: q[0] [rad], q[1] [rad]",
    ]
    assert "Contact(s_tip=-0.003 m, s_object=0.003 m" in lines[3] and "force=0.5" in lines[4]
    assert "Jaw: fixed" in str(on_a_plate()) and "FreeObject: x [m], y [m], theta [rad]" in str(on_a_plate())
    assert "in space" in str(on_a_turntable()) and "clock [s]" in str(on_a_turntable())
    for one in (grasp, grasp.prepared(), on_a_turntable().prepared()):
        assert str(one) and "\n" not in repr(one)
    seen = []
    jax.eval_shape(lambda g: seen.append(f"{g} {g!r}") or 0.0, grasp)
    assert "theta [rad]" in seen[0]


def test_a_run_knows_its_labels_under_transformations(scene, run):
    grasp, _ = scene
    assert run.labels == grasp.labels and run.labels.coordinates[1] == "finger 0 q[0]"
    assert jax.tree.map(lambda x: x, run).labels == grasp.labels
    both = jax.tree.map(lambda *x: np.concatenate([a[None] for a in x]), run, run)
    assert both.labels == grasp.labels
    assert {hash(run.labels), hash(both.labels)} == {hash(grasp.labels)}


SETTLED = (settling_time, overshoot, tracking_error)


def test_what_never_came_to_rest_has_no_settling_time(run):
    lost = ended(run, "contact_lost", contact=0, t=2.9)

    @jax.jit
    def measured(run):
        of_s = lambda s: settling_time(eqx.tree_at(lambda r: r.states.s, run, s))  # noqa: E731
        whole = {name: measure(run) for name, (measure, _) in MEASURES.items()}
        return whole, {name: partial(run) for name, partial in PARTIAL.items()}, jax.grad(of_s)(run.states.s)

    held, _, slope = measured(run)
    assert all(map(np.isfinite, held.values())) and np.abs(slope).max() > 0
    whole, partial, slope = measured(lost)
    assert partial == held  # what searches go by stays finite, and is the same measure
    for name, (measure, _) in MEASURES.items():
        assert np.isnan(whole[name]) == (measure in SETTLED), name
    assert np.all(np.asarray(slope) == 0.0)


def test_a_design_reports_no_settling_time_of_lost_runs(monkeypatch):
    """Of two cases, one lost: the cost stays finite, the figures against the last value are none."""
    goal = ClosedLoop(lambda tip, case: None, {"settling_time": 1.0}, cases=jnp.arange(2.0))
    measured, own = jnp.arange(10.0).reshape(2, 5), jnp.zeros(2)
    monkeypatch.setattr("jaxroll.design._closed_loop_goal.worst_margin", lambda seen: jnp.zeros(()))
    for lost in (jnp.array([0.0, 0.4]), jnp.zeros(2)):
        monkeypatch.setattr(ClosedLoop, "run", lambda self, tip, names, lost=lost: (measured, own, lost))
        found = goal.figures(None, None)
        early = bool(lost.any())
        assert np.isfinite(found["worst cost"])
        for name, (_, title) in MEASURES.items():
            assert np.isnan(found[title]) == (early and MEASURES[name][0] in SETTLED), name


def design_of(code):
    tip, numbers = jxr.Ellipse(0.02, 0.01), jnp.zeros(1)
    arrays = {"before": numbers, "after": numbers, "violation": numbers, "holds": jnp.array([True])}
    rest = {"chosen": 0, "history": jnp.zeros((1, 30)), "interval": jnp.zeros(2)}
    figures, parts = {"worst margin [m]": (-0.1, 0.2), "firmness": (1.0, 2.0)}, {"size": 0.1}
    return Design(tip=tip, start=tip, tips=tip, **arrays, **rest, result=code, figures=figures, parts=parts)


def test_a_design_names_the_callers_own_option():
    text = str(design_of(jxr.RESULTS.max_steps_reached))
    assert "all 30 steps were taken; `steps` allows more" in text and "max_steps`" not in text
    assert "--steps allows more" in design_of(jxr.RESULTS.max_steps_reached).report("--steps")
    lines = str(design_of(jxr.RESULTS.successful)).splitlines()
    small = design_of(jxr.RESULTS.successful).report(millimetres=True).splitlines()
    assert [line.split() for line in lines[2:4]] == [
        ["worst", "margin", "[m]", "-0.1", "0.2"],
        ["firmness", "1", "2"],
    ]
    assert small[2].split() == ["worst", "margin", "[mm]", "-100", "200"] and small[3:] == lines[3:]
    assert str(design_of(jxr.RESULTS.successful)).splitlines()[0] == "Design: successful"
    assert "ended" not in str(design_of(jxr.RESULTS.successful))
    told = str(design_of(jxr.RESULTS.infeasible))
    assert "no start came within the limits in 30 steps: `steps` allows more, or widen" in told
    assert repr(design_of(jxr.RESULTS.infeasible)) == "Design(infeasible; Ellipse)"


@pytest.fixture(scope="module")
def pulling(scene):
    """The pivoted scene with a finger that pulls: it is lost at once."""
    grasp, state = scene
    grasp = grasp.with_(force=-0.5)
    record = ("multipliers", "energy")
    return grasp, state, jxr.simulate(grasp, state, 3.0, record=record, throw=False)


def test_a_run_lost_at_once_keeps_its_start_and_can_be_drawn(pulling, tmp_path):
    grasp, state, run = pulling
    assert run.result == jxr.RESULTS.contact_lost and float(run.stats.t_end) == 0.0
    np.testing.assert_allclose(run.last.q, state.q, atol=1e-12)
    assert "start     object: theta -0.4875 rad" in str(run)
    figure = plotting.poses(grasp, run)
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["(a)  t = 0 s: contact_lost"]
    figure = plotting.responses(grasp, run)
    assert figure._suptitle.get_text() == "ended at t = 0 s: contact_lost"
    assert figure.axes[0].get_lines()[0].get_marker() == "o"
    assert plotting.animate(grasp, run, tmp_path / "one.gif", fps=20, size=3).exists()
    assert plotting.pose(grasp, run.last).axes
    nowhere = eqx.tree_at(lambda r: r.last.q, run, jnp.full_like(run.last.q, jnp.nan))
    for draw in (plotting.poses, plotting.responses):
        with pytest.raises(ValueError, match=r"ended at t = 0 s \(contact_lost\) before the first$"):
            draw(grasp, nowhere)
    pyplot.close("all")


def test_quantities_of_part_2_are_those_of_one_finger_that_presses(scene):
    """Another finger that touches nothing has torques of its own."""
    grasp, _ = scene
    idle = jxr.Grasp(grasp.object, grasp.fingers * 2, grasp.contacts, controller=grasp.controller)
    bare = grasp.with_(controller=None)
    free = jxr.Grasp(jxr.scenes.rectangle(), grasp.fingers, grasp.contacts, controller=grasp.controller)
    assert [_is_part_2(each) for each in (grasp, idle, bare, free)] == [True, False, False, False]


def test_plots_of_jaws_are_in_millimetres():
    grasp = on_a_plate(0.0)
    forces = Multipliers(jnp.ones((2, 1)), jnp.zeros((2, 1)))
    run = moved(grasp, [0, 0, 0, 0.0], [0, 0, 0, 1e-3], forces=forces)
    labels = {p.title: p.label for p in panels(grasp, run)}
    assert labels["Rate of joint 1: zero"].endswith("[mm/s]")


def test_why_a_grasp_is_lost_at_once(pulling):
    grasp, state, run = pulling
    found = jxr.why(grasp, run)
    assert found.summary == "fails at the start: contact 0 (finger 0 on contour 0) pulls with 1.55 N"
    assert found.contact == 0 and found.closed and found.run is run
    assert float(found.start.multipliers.f[0]) == pytest.approx(-1.5507, rel=1e-3)
    assert repr(found.stability.verdict) == "unstable" and "object: theta +1.0000 rad" in found.direction
    # The direction is the mode that falls: the scene's one freedom.
    mode = np.asarray(found.stability.modes[:, 0])
    assert f"q[0] {mode[1] / mode[0]:+.4f} rad" in found.direction
    text = str(found)
    for words in ("closed    yes", "singular  no", "pulls with", "no longer presses at t = 0 s", "remedy"):
        assert words in text
    assert len(text.splitlines()) <= 30 and max(map(len, text.splitlines())) <= 100


def test_why_judges_the_start_at_the_time_of_the_start(scene, run, monkeypatch):
    """Commands, loads and laws may say another thing at another time."""
    times, plain = [], _why.bearing
    monkeypatch.setattr(_why, "bearing", lambda *given: times.append(float(given[1])) or plain(*given))
    jxr.why(scene[0], eqx.tree_at(lambda r: r.ts, run, run.ts + 2.0))
    assert times[0] == 2.0


def of_time(numbers, t):
    """A force that is one number before a time, and another one after it."""
    before, time, after = numbers
    return jnp.where(t < time, before, after)


def with_force(grasp, before, time, after):
    """A grasp that presses so; all of these are the same programs."""
    numbers = tuple(jnp.asarray(number, float) for number in (before, time, after))
    return grasp.with_(force=jax.tree_util.Partial(of_time, numbers))


def test_why_judges_what_is_near_under_the_forces_of_that_time(scene, run):
    """A pull that turned into a push by the end of the run: with it the equilibrium there falls."""
    grasp = with_force(scene[0], 0.5, 2.0, -0.5)
    found = jxr.why(grasp, run)
    at_the_end = jxr.stability.assess(grasp, run.last, t=run.stats.t_end)
    assert float(run.stats.t_end) == 3.0
    assert repr(found.stability.verdict) == repr(at_the_end.verdict) == "unstable"
    assert found.summary.startswith("holds until t = 3 s, but some small disturbance grows")


def test_why_a_grasp_holds(scene, run):
    found = jxr.why(scene[0], run)
    assert found.summary == "holds" and not found.remedy and not found.direction and found.contact == -1
    assert repr(found) == "Why(holds)"
    assert "asymptotically_stable" in str(found) and "to t = 3 s" in str(found)


def test_why_names_the_contact_that_slips_and_by_how_much(scene, run, monkeypatch):
    """The scene's run with a friction that it needs more than: judged where it stands."""
    monkeypatch.setattr(
        "jaxroll._why.assess", lambda grasp, state, t: jxr.stability.assess(scene[0], state, t=t)
    )
    contact = jxr.Contact(-0.003, 0.003, friction=0.1)
    grasp = scene[0].with_contacts(contact)
    demand = np.abs(np.asarray(run.multipliers.lam / run.multipliers.f))[:, 0]
    i = int(np.argmax(demand > 0.1))
    last = jax.tree.map(lambda x: x[i], run.states)
    slipped = eqx.tree_at(lambda r: r.last, ended(run, "slipping", t=float(run.ts[i])), last)
    found = jxr.why(grasp, slipped)
    assert found.contact == 0 and "contact 0 (finger 0 on contour 0) needs more friction" in found.summary
    assert f"needs friction {demand[i]:.4g}; it has 0.1" in " ".join(str(found).split())
    turned = float(last.q[0] - run.states.q[0, 0])
    assert f"it had moved by object: theta {turned:+.4f} rad" in found.direction
    assert "`friction`" in found.remedy


def test_why_names_what_an_equilibrium_would_be_stable_without(scene, run):
    """Damping that drives, samples that come too seldom: shapes are not the cause, and not what helps."""
    grasp, _ = scene
    driven = jxr.why(grasp.with_(damping=-1e-4), run)
    assert "`damping` above zero" in driven.remedy and "blunter" not in driven.remedy
    assert "a swing that grows" in driven.direction
    seldom = grasp.with_(controller=jxr.control.Sampled(grasp.controller, 0.05))
    held = lambda state: dataclasses.replace(state, memory=np.zeros((*state.q.shape[:-1], 3)))  # noqa: E731
    found = jxr.why(seldom, dataclasses.replace(run, states=held(run.states), last=held(run.last)))
    assert "a shorter `period` of `Sampled`" in found.remedy and "a swing that grows" in found.direction


def test_why_a_run_that_was_cut_off_has_no_direction(scene, run):
    found = jxr.why(scene[0], ended(run, "max_steps_reached"))
    assert found.direction == "" and "step limit" in found.summary


def test_why_a_guess_does_not_close(scene):
    grasp, state = scene
    far = grasp.with_(pivot=(3.0, 3.0))
    found = jxr.why(far, state)
    assert not found.closed and found.run is None and found.start is None
    assert "do not close" in found.summary and "gap [m] of contact 0 at" in found.summary
    assert "hold_contacts" in found.remedy and str(found).count("\n") < 10


def test_why_of_a_grasp_without_forces_is_what_its_run_says(scene, monkeypatch):
    """It rests: nothing pulls, and nothing ends the run. Forces that are no numbers are named as such."""
    grasp, state = scene
    times = []
    monkeypatch.setattr(_why, "bearing", lambda *given: times.append(given[1]) or _analysis.bearing(*given))
    idle = jxr.why(with_force(grasp, 0.0, 9.0, 0.0), state, t1=0.1)
    assert idle.summary == "holds" and "bears no force" in str(idle) and "pulls" not in str(idle)
    # Of a weak type one would be a program more.
    assert [(t.dtype, getattr(t, "weak_type", False)) for t in times] == [(np.float64, False)] * 2
    lost = jxr.why(with_force(grasp, np.nan, 9.0, np.nan), state, t1=0.1)
    assert lost.summary.endswith("bears a force that is no number") and "NaN" in lost.remedy


def test_why_says_what_it_cannot_judge(scene, run):
    grasp, state = scene
    with pytest.raises(ValueError, match="argument state must be a State, or a run of the grasp"):
        jxr.why(grasp, 3.0)
    with pytest.raises(ValueError, match="argument grasp must be a Grasp"):
        jxr.why(state, grasp)
    with pytest.raises(ValueError, match="argument state must be one run"):
        jxr.why(grasp, jax.tree.map(lambda x: np.stack([x, x]), run))
    with pytest.raises(ValueError, match="argument state must hold known numbers, but JAX is tracing"):
        jax.jit(lambda s: jxr.why(grasp, s).gap)(state)
    with pytest.raises(ValueError, match=r"argument state\.q must have shape"):
        jxr.why(grasp, jxr.State(state.q[:2], state.v, state.s))


@pytest.mark.parametrize(
    ("curvature", "pivot", "f", "told"),
    [
        ((0.7e-4, 1.0), 1.0, (1.0, 1.0), "contact 0 (finger 0 on contour 0) is singular"),
        ((1.0, -1.0), 1.0, (1.0, 1.0), "contact 1 (finger 1 on contour 1) is singular"),
        ((1.0, np.nan), 1.0, (1.0, 1.0), "contact 1 (finger 1 on contour 1) is singular"),
        ((1.0, 1.0), 0.7e-9, (1.0, 1.0), "contacts are redundant or an arm is straight"),
        ((1.0, 1.0), 1.0, (1.0, 0.0), None),
        ((1.0, 1.0), 1.0, (np.nan, 0.0), "contact 0 (finger 0 on contour 0) bears a force that is no number"),
        ((1.0, 1.0), 1.0, (0.0, np.nan), "contact 1 (finger 1 on contour 1) bears a force that is no number"),
        ((1.0, 1.0), 1.0, (-0.25, 1.0), "contact 0 (finger 0 on contour 0) pulls with 0.25 N"),
        ((1.4e-4, 1.0), 1.4e-9, (1.0, 1e-9), None),
    ],
)
def test_why_looks_at_curvatures_then_at_pivots_then_at_forces(curvature, pivot, f, told):
    start = bearing(f, (0.0, 0.0), curvature=curvature, pivot=pivot)
    found = _early(rubbing_pair(0.3, 0.3), start, -1)
    assert (found is None) == (told is None)
    if told is not None:
        assert found[0] == f"fails at the start: {told}" + (
            ", the sum of its curvatures is not positive to 0.0001" if "singular" in told else ""
        ) + (", so that forces have no answer" if "redundant" in told else "")
        assert found[2] == (-1 if "redundant" in told else int("contact 1" in told))


def test_why_takes_of_contacts_that_fail_alike_the_one_that_ended_the_run():
    alike = np.array([-2.0, -2.0 + 1.4e-9, -2.0 + 2.8e-9])
    assert [_why._least(alike, ended) for ended in (-1, 0, 1, 2)] == [0, 0, 1, 0]
    both = bearing((-2.0, -2.0), (0.0, 0.0))
    assert (
        _early(rubbing_pair(0.3, 0.3), both, 1)[2] == 1 and _early(rubbing_pair(0.3, 0.3), both, -1)[2] == 0
    )
    slips = bearing((2.0, 2.0), (1.0, 1.0))
    assert _early(rubbing_pair(0.3, 0.3), slips, 1)[2] == 1
    # Just as much friction as is needed will do.
    assert _early(rubbing_pair(0.5, 0.5), slips, 1) is None


def test_a_contact_that_holds_both_ways_cannot_be_lost():
    pair = rubbing_pair(None, 0.2)
    pair.contacts[0].presses = False
    assert _early(pair, bearing((-3.0, 1.0), (5.0, 0.1)), -1) is None
    assert _why._pressing(pair, bearing((-3.0, 1.0), (0.0, 0.0))).tolist() == [np.inf, 1.0]
    assert _why._force(pair, 0, -3.0, 0.5) == (
        "contact 0 (finger 0 on contour 0) holds both ways, with -3 N and 0.5 N beside"
    )
    assert "with 0 N and 0 N" in _why._force(pair, 0, -0.0, 0.0)
    assert _why._force(pair, 1, 2.0, 0.5) == (
        "contact 1 (finger 1 on contour 1) presses with 2 N and needs friction 0.25; it has 0.2"
    )
    pair.contacts[0].presses = True
    assert _why._force(pair, 0, 3.0, 0.0).endswith(
        "presses with 3 N and needs friction 0; no limit was given"
    )
    assert _why._force(pair, 0, -0.5, 1.0).endswith("pulls with 0.5 N: no friction would do")
    assert _why._force(pair, 0, 0.0, 1.0).endswith(
        "contour 0) presses with nothing, 1 N beside: no friction would do"
    )
    assert _why._force(pair, 0, -0.0, 0.0).endswith("contour 0) bears no force")
    assert _why._force(pair, 0, np.nan, 0.0).endswith("contour 0) bears a force that is no number")
    pushed = _early(rubbing_pair(0.3, 0.3), bearing((1.0, 0.0), (0.0, 1.0)), -1)
    assert pushed[0] == "fails at the start: contact 1 (finger 1 on contour 1) presses with nothing"
    in_space = SimpleNamespace(f=np.array([2.0, 1.0]), lam=np.array([[0.6, 0.0, -0.8], [0.0, 2.0, 0.0]]))
    assert _why._pairs(in_space) == [(2.0, 1.0), (1.0, 2.0)]
    assert _why._pairs(SimpleNamespace(f=np.array([2.0]), lam=np.array([-0.5]))) == [(2.0, 0.5)]


def test_a_contact_that_lifts_presses_with_nothing():
    """What the root of its force leaves is rounding, on either side of zero, and no pull."""
    pair = rubbing_pair(None, None)
    for kind, rounding in ((np.float64, 2.5e-12), (np.float32, 2.5e-5)):
        for f in (rounding, -rounding):
            found = bearing(np.array([f, 2.0], kind), (0.5, 0.5))
            assert "contour 0) presses with nothing, 0.5 N beside" in _why._forces(pair, found)[0]
            assert _early(pair, found, -1)[0].endswith(
                "contact 0 (finger 0 on contour 0) presses with nothing"
            )
            assert _early(pair, bearing(np.array([f, 2.0], kind), (0.0, 0.5)), -1) is None
    assert "pulls with 1e-08 N" in _why._forces(pair, bearing((-1e-8, 2.0), (0.5, 0.5)))[0]


@pytest.mark.parametrize(
    ("curvature", "pivot", "told"),
    [
        ((0.25, 0.125), 0.5, "no, curvatures add up to 0.125 of their size (contact 1, the least)"),
        ((1.4e-4, 0.125), 1.4e-9, "no, curvatures add up to 0.00014 of their size (contact 0, the least)"),
        ((0.7e-4, 0.125), 0.5, "yes, curvatures add up to 7e-05 of their size (contact 0, the least)"),
        ((0.25, 0.125), 0.7e-9, "yes, curvatures add up to 0.125 of their size (contact 1, the least)"),
    ],
)
def test_why_tells_the_least_curvature_and_pivot(curvature, pivot, told):
    at = bearing((1.0, 1.0), (0.0, 0.0), curvature=curvature, pivot=pivot)
    assert _why._singular(None, at) == f"{told}; smallest pivot {pivot:.3g}"


def test_a_direction_is_told_without_what_is_slight_in_it():
    """A link of the fingers is a fifth of a metre long: beside it, or beside a radian, parts count."""
    labels = runs.scene("pinch")[0].labels
    sized = SimpleNamespace(labels=labels, fingers=[SimpleNamespace(size=0.1), SimpleNamespace(size=0.3)])
    np.testing.assert_allclose(_why._scales(sized), [0.2, 0.2, *[1.0] * 6])
    way = np.array([0.1, 0.0038, -1.0, 0.019, -0.021, 0.0, 0.5, 0.0199])
    assert _why._named(sized, way) == (
        "object: x +100.000 mm, theta -1.0000 rad; finger 0: q[1] -0.0210 rad; finger 1: q[0] +0.5000 rad"
    )
    np.testing.assert_allclose(_why._scaled(sized, 0.4 * way), way / -1.0)
    longer = np.where(np.arange(8) == 0, -0.4, way)
    np.testing.assert_allclose(_why._scaled(sized, longer), -0.5 * longer)


@pytest.mark.parametrize(
    ("code", "move", "told"),
    [
        ("contact_lost", 2e-3, "it had moved by object: x +2.000 mm"),
        ("contact_lost", 1.4e-9, "it had moved by object: x +0.000 mm"),
        ("contact_lost", 0.7e-9, ""),
        ("contact_lost", np.nan, ""),
        ("successful", 2e-3, ""),
        ("step_collapsed", 2e-3, ""),
    ],
)
def test_why_tells_where_a_run_went_that_a_limit_ended(code, move, told):
    run = ended(moved(on_a_plate(), [0, 0, 0], [0.5 + move, 0.1, 0.2]), code)
    start = jxr.State(jnp.array([0.5, 0.1, 0.2]), jnp.zeros(3), jnp.zeros(1))
    grasp = SimpleNamespace(labels=run.labels, fingers=[SimpleNamespace(size=1.0)])
    assert _why._direction(grasp, None, start, run) == told


def test_a_swing_grows_by_the_last_of_its_rates():
    found = SimpleNamespace(rates=np.array([-3.0, 0.25 + 0.5j, 0.5 - 2.5j]))
    assert _why._growing(found) == "along a swing that grows at 0.5 1/s, 2.5 rad/s"


def test_the_first_saved_state_of_a_run_is_its_start(run):
    q = run.states.q.at[0].set(jnp.nan).at[1, 1].set(jnp.nan)
    late = eqx.tree_at(lambda r: r.states.q, run, q)
    start, begins = _why._start(late)
    np.testing.assert_array_equal(start.q, run.states.q[2])
    assert begins == run.ts[2]
    none = eqx.tree_at(lambda r: r.states.q, run, jnp.full_like(q, jnp.nan))
    assert _why._start(none)[0] is none.last and _why._start(none)[1] == run.stats.t_end


VERDICTS = jxr.stability.VERDICTS


def assessed(verdict, bends_down=False):
    return SimpleNamespace(verdict=getattr(VERDICTS, verdict), bends_down=bends_down)


@pytest.mark.parametrize(
    ("sampled", "weighs", "held_by", "verdict", "bends_down", "wanted"),
    [
        (True, False, "law", "unstable", True, "sampled"),
        (True, True, "law", "unstable", True, "sampled"),
        (True, True, "no weight", "unstable", True, "heavy"),
        (False, True, "no weight", "not_found", True, "heavy"),
        (False, True, "", "not_found", True, "not_found"),
        (False, False, "", "unstable", True, "unstable"),
        (False, False, "", "unstable", False, "driven"),
        (False, False, "", "not_found", False, "not_found"),
    ],
)
def test_what_helps_a_grasp_without_a_stable_equilibrium(
    monkeypatch, scene, sampled, weighs, held_by, verdict, bends_down, wanted
):
    """Another law, no weight, other shapes, or less of what drives it: whichever makes it hold."""
    grasp, state = scene
    law = grasp.controller
    grasp = grasp.with_(controller=jxr.control.Sampled(law, 0.01)) if sampled else grasp
    weight = np.array([0.0, -9.81]) if weighs else None
    parts = (grasp.object, grasp.fingers, grasp.contacts)
    grasp = jxr.Grasp(*parts, controller=grasp.controller, gravity=weight)
    asked = []

    def assess(grasp, near, t):
        asked.append(near)
        alone = not isinstance(grasp.controller, jxr.control.Sampled)
        bare = weighs and grasp.gravity is None and not (sampled and alone)
        held = {"law": sampled and alone, "no weight": bare}
        return assessed("neutral" if held.get(held_by) else "unstable")

    monkeypatch.setattr(_why, "_assessed", assess)
    near = dataclasses.replace(state, memory=jnp.ones(2))
    assert _why._blamed(grasp, assessed(verdict, bends_down), near, 0.0) == wanted
    assert all(each.memory is not near.memory for each in asked)


@pytest.mark.parametrize("verdict", ["not_found", "unstable", "neutral", "asymptotically_stable", "undamped"])
def test_what_holds_has_an_equilibrium_from_which_nothing_grows(monkeypatch, scene, verdict):
    monkeypatch.setattr(_why, "_assessed", lambda grasp, state, t: assessed(verdict))
    assert _why._holds(*scene, 0.0) == (verdict not in ("not_found", "unstable"))
    monkeypatch.setattr(_why, "_assessed", lambda grasp, state, t: None)
    assert not _why._holds(*scene, 0.0)


@pytest.mark.parametrize(
    ("early", "code", "verdict", "summary", "remedy", "contact"),
    [
        (("fails at the start", "mend it", 3), "slipping", "unstable", "fails at the start", "mend it", 3),
        (None, "slipping", "neutral", "fails: it slipped", REMEDIES["slipping"], 1),
        (None, "slipping", "unstable", "fails: it slipped; its equilibrium is unstable", None, 1),
        (None, "successful", "unstable", "holds until t = 0.25 s, but some small disturbance grows", None, 1),
        (None, "successful", "neutral", "holds", "", 1),
        (None, "successful", None, "holds", "", 1),
    ],
)
def test_the_first_finding_makes_the_summary(
    monkeypatch, scene, run, early, code, verdict, summary, remedy, contact
):
    grasp, state = scene
    looked = []
    monkeypatch.setattr(_why, "bearing", lambda grasp, t, state: bearing((1.0,), (0.0,)))
    found = None if verdict is None else assessed(verdict)
    monkeypatch.setattr(_why, "_assessed", lambda grasp, state, t: looked.append((state, t)) or found)
    monkeypatch.setattr(_why, "_culprit", lambda grasp, run, end: 1)
    monkeypatch.setattr(_why, "_ending", lambda grasp, run, contact: "it slipped")
    monkeypatch.setattr(_why, "_direction", lambda *args: "down")
    monkeypatch.setattr(_why, "_early", lambda grasp, start, ended: early)
    monkeypatch.setattr(_why, "_blamed", lambda grasp, found, near, t: "heavy")
    judged = _why._judged(grasp, state, 2.0, ended(run, code, t=0.25))
    against = f"{_MEND['heavy']}" + (
        f"; against the end alone, {REMEDIES['slipping']}" if code == "slipping" else ""
    )
    assert judged.summary == summary and judged.contact == contact
    assert judged.remedy == (against if remedy is None else remedy)
    assert judged.ended == ("it slipped" if code == "slipping" else "") and judged.direction == "down"
    # An equilibrium is looked for where and when a run ended that reached its end, else where it began.
    (near, when), reached = looked[0], code == "successful"
    np.testing.assert_array_equal(near.q, run.last.q if reached else state.q)
    assert when == (0.25 if reached else 2.0)  # loads and commands may say another thing at another time


def test_the_end_of_a_run_gets_the_name_of_the_contact_that_it_did_not_know(monkeypatch, run):
    labels = SimpleNamespace(labels=run.labels)
    unknown = ended(run, "contact_lost", contact=-1, margin=-0.5)
    named = "contact 0 (finger 0 on contour 0)"
    assert _why._ending(labels, unknown, 0) == cause(unknown).replace("a contact", named, 1) != cause(unknown)
    assert _why._ending(labels, unknown, -1) == cause(unknown)
    known = ended(run, "contact_lost", contact=0, margin=-0.5)
    assert _why._ending(labels, known, 0) == cause(known)


def test_which_grasps_have_an_equilibrium_that_is_assessed(monkeypatch, scene):
    """Of contours alone, and where the contacts leave a coordinate free."""
    monkeypatch.setattr(_why, "assess", lambda grasp, state, t: ("assessed", t))
    grasp, state = scene
    assert _why._assessed(grasp, state, 0.5) == ("assessed", 0.5)
    for free, wanted in ((2, None), (3, ("assessed", 0.5))):
        some = SimpleNamespace(coordinates=free, contacts=grasp.contacts)
        assert _why._assessed(some, state, 0.5) == wanted
    assert _why._assessed(on_a_turntable(), None, 0.5) is None


def test_entries_of_a_report_are_broken_at_a_hundred_characters():
    assert _printing.entry("run", ["a", "", "b"]) == ["  run       a", "            ", "            b"]
    for width in (88, 89):
        found = _printing.entry("run", [f"{'x' * (width - 2)} y"])
        assert len(found) == (1 if width == 88 else 2) and max(map(len, found)) <= 100


def test_values_are_told_in_full_up_to_twelve_numbers():
    assert _printing.shown_value(np.arange(12.0)).startswith("[0, 1, 2") and "13, 0 to 12" in (
        _printing.shown_value(np.arange(13.0), "m")
    )
    assert _printing.shown_value(np.arange(13.0), "m").endswith(" m")
    assert _printing.shown_value(np.array(1.23456789), "s") == "1.23457 s"
    assert _printing.shown_value([1, (2.5, "a"), None]) == "(1, (2.5, a), None)"
    assert _printing.shown_value(np.array([True, False])) == "[True, False]"
    assert _printing.shown_value(2.0 / 3.0) == "0.666667" and _printing.shown_value(True) == "True"
    twelve, thirteen = (jnp.zeros(n, int) for n in (12, 13))
    codes = lambda numbers: _printing.code_name(_printing.code_of(jxr.RESULTS, numbers))  # noqa: E731
    assert codes(twelve) == f"[{', '.join(['successful'] * 12)}]" and codes(thirteen) == "13 successful"
    assert codes(thirteen.at[3].set(1)).startswith("12 successful, 1 ")
    big = np.where(np.arange(20) == 3, np.nan + 0j, (3.0 - 4.0j) * np.arange(20))
    assert _printing._numbers(big) == "20, up to 95, 1 not finite"
    assert _printing._numbers(np.arange(-5, 15)) == "20, -5 to 14"
