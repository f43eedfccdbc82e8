"""Parts of a run by themselves: declared jumps, limits and their codes, where steps end, what they leave."""

import itertools
import math
from types import SimpleNamespace

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._integration import _events, _jumps
from jaxroll._integration._batch import _slots
from jaxroll._integration._contact_impulses import blow_times, merged, times_before
from jaxroll._integration._run import aim, embark, empty_record, judge, path_of, Plan
from jaxroll._integration._step import tableau_of
from jaxroll._integration._step_size import Hunt, Pace
from jaxroll._xla import VECTOR

EPS = np.finfo(float).eps
INF, NAN = math.inf, math.nan
CODES = diffrax.RESULTS


def same(found, wanted):
    """Equal to the last digit."""
    np.testing.assert_array_equal(np.asarray(found, float), np.asarray(wanted, float))


def with_jumps(*jumps):
    """What is asked of a grasp that declares jumps."""
    return SimpleNamespace(jumps=tuple(jnp.asarray(each) for each in jumps))


def test_the_grain_of_time_is_four_rounding_units():
    same(_jumps.grain(jnp.array([2.0, -2.0, 0.0, 1e-4])), [8 * EPS, 8 * EPS, 4e-3 * EPS, 4e-3 * EPS])


def test_jumps_are_put_in_order_each_once_within_the_run():
    # A time within a grain of an end is there; two closer than four grains of the later one are one.
    late = [1.0 + 12 * EPS, 2.0 + 40 * EPS, 4.0 + 8 * EPS, 4.0 + 32 * EPS, INF]
    grasp = with_jumps([2.0, 1.0], 0.25 - 0.75 * EPS, late, [0.25 - 2 * EPS, 0.1, 1.0])
    wanted = [0.25 - 0.75 * EPS, 1.0, 2.0, 2.0 + 40 * EPS, 4.0 + 8 * EPS, *6 * [INF]]
    same(jax.jit(lambda t0, t1: _jumps.ordered(grasp, t0, t1))(0.25, 4.0), wanted)


def test_times_at_a_jump_are_moved_to_one_side_of_it():
    jumps = jnp.array([1.0, 2.0, INF])
    ts = jnp.array([0.0, 0.5, 1 - 4 * EPS, 1.0, 1 + 4 * EPS, 1 + 8 * EPS, 2 - 8 * EPS, 2.0, 2 + 16 * EPS])
    after, before = 1 + 4 * EPS, 1 - 4 * EPS
    beside = jax.jit(_jumps.beside, static_argnums=2)
    same(beside(jumps, ts, 1), [0.0, 0.5, *3 * [after], ts[5], *2 * [2 + 8 * EPS], ts[-1]])
    same(beside(jumps, ts, -1), [0.0, 0.5, *3 * [before], ts[5], *2 * [2 - 8 * EPS], ts[-1]])


def test_a_step_ends_before_at_and_after_each_jump():
    jumps = jnp.array([1.0, 2.0])
    visits = [
        (0, 0.5, 1 - 4 * EPS, 1.0),
        (0, 1 - 4 * EPS, 1.0, 1.0),
        (1, 1.0, 1 + 4 * EPS, 1 + 4 * EPS),
        (2, 1 + 4 * EPS, 2 - 8 * EPS, 2.0),
        (2, 2 - 8 * EPS, 2.0, 2.0),
        (3, 2.0, 2 + 8 * EPS, 2 + 8 * EPS),
        (4, 2 + 8 * EPS, INF, INF),
        (5, 3.0, INF, INF),
    ]
    passed, t, stop, short = (np.array(x) for x in zip(*visits, strict=True))
    stops = jax.jit(jax.vmap(lambda passed, t: _jumps.stop(jumps, passed, t)))
    same(stops(passed, t), stop)
    passing = jax.jit(jax.vmap(lambda passed, t: _jumps.passed_at(jumps, passed, t)))
    for x in (1 - 4 * EPS, 1.0, 1 + 4 * EPS, 2 - 8 * EPS, 2.0, 2 + 8 * EPS, 2 + 16 * EPS):
        same(passing(passed, np.full(len(t), x)), short == x)


def test_short_steps_and_the_one_that_a_blow_acts_in():
    one = 1.0
    steps = {
        (one - 4 * EPS, one): (True, True),
        (one, one + 4 * EPS): (True, False),
        (one - 8 * EPS, one): (True, True),
        (one - 9 * EPS, one): (False, False),
        (one - 0.5, one): (False, False),
        (one, one): (False, False),
        (one, one - 4 * EPS): (False, False),
        (one - 2 * EPS, one): (True, False),
        (one - 4 * EPS, one + 2 * EPS): (True, True),
        (one - 4 * EPS, one + 3 * EPS): (True, False),
        (one - 8 * EPS, one - 2 * EPS): (True, True),
        (one - 8 * EPS, one - 3 * EPS): (True, False),
    }
    short, hit = zip(*steps.values(), strict=True)
    t0, t1 = jnp.array(list(steps)).T
    both = jax.jit(lambda t0, t1: (_jumps.is_short(t0, t1), _jumps.hits(t0, t1, jnp.ones_like(t0))))
    same(both(t0, t1), (short, hit))


def test_the_state_at_a_jump_moves_with_its_time_and_back():
    """The second of three steps has the slope in it, the third less it; two that jump at once share it."""
    x, rates = np.array([0.5, -1.0]), np.array([3.0, 7.0])

    def start(first, second, t0, t1):
        grasp = SimpleNamespace(jumps=(first[None], jnp.stack([second, second + 1.0])))
        return _jumps.moved(grasp, t0, t1, x, rates=rates)

    def late(first, second, t):
        return _jumps.lateness(SimpleNamespace(jumps=(first[None], jnp.stack([second, second + 1.0]))), t)

    one, two = np.array(1.0), np.array(2.0)
    moved = jax.jit(lambda *given: (start(*given), jax.jacfwd(start, (0, 1))(*given)))
    late = jax.jit(jax.value_and_grad(late))
    turns = [(1 - 4 * EPS, 1.0, 1.0), (1.0, 1 + 4 * EPS, -1.0), (0.5, 1.0, 0.0), (1.0, 1.5, 0.0)]
    for t0, t1, way in turns:
        now, slopes = moved(one, two, t0, t1)
        same(now, x)
        for found, share in zip(slopes, (1.0, 0.0), strict=True):
            same(found, way * share * rates)
        for found in moved(one, one, t0, t1)[1]:
            same(found, 0.5 * way * rates)
    for t, share in ((1.0, 1.0), (1 + 2 * EPS, 1.0), (1 - 2 * EPS, 1.0), (1 + 3 * EPS, 0.0), (2.0, 0.0)):
        same(late(one, two, t), (0.0, share))


def parabola_dips(times, margins):
    """Share at which a parabola through the lowest inner margin and its neighbours dips, by `polyfit`."""
    i = 1 + int(np.argmin(margins[1:-1]))
    a, b, c = np.polyfit(times[i - 1 : i + 2] - times[i], margins[i - 1 : i + 2], 2)
    place = -0.5 * b / a if a > 0 else NAN
    within = times[i - 1] - times[i] < place < times[i + 1] - times[i]
    least = c - 0.25 * max(margins[i - 1], margins[i + 1]) - (0.25 * b * b / a if within else 0.0)
    if margins[-1] < 0 and not (within and c < margins[i + 1]):
        return INF
    if c < 0 or within and least < 0:
        return times[i] + (place if within else 0.0)
    return INF


def test_dips_are_those_of_the_parabola_through_the_lowest_margin_within():
    rng, times = np.random.default_rng(3), np.array([0.0, 0.15, 0.4, 0.65, 0.92, 1.0])
    rows = np.concatenate([rng.uniform(-0.05, 1.0, (300, 6)), rng.uniform(0.3, 1.0, (300, 6))])
    rows[::3] = np.sort(rows[::3], axis=1)  # lowest at an end, which is judged elsewhere
    rows[1::3, 2] *= 0.3
    rows[2::3, -1] -= 0.5
    found = jax.jit(lambda m: _events.first_dip(times, list(m)))(jnp.asarray(rows.T))
    wanted = [parabola_dips(times, row) for row in rows]
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    assert 100 < np.isfinite(wanted).sum() < 500
    past = rows[:, -1] < 0
    assert 20 < np.isfinite(wanted)[past].sum() < past.sum() - 20


def test_stages_that_are_watched_are_a_fourteenth_of_the_step_apart():
    shares = np.array([0.0, 0.05, 0.2, 0.28, 0.34, 0.6, 0.96, 1.0])
    assert _events.watched(shares).tolist() == [0, 2, 4, 5, 7]
    assert _events.watched(np.array([0.0, 0.08, 0.0, 1.0])).tolist() == [0, 1, 3]


KINDS = 16
NUMBER = {"singular": 2, "end": 3, "lost": 4, "slip": 5, "overlap": 6, "joint": 7, "torque": 8, "links": 9}


def numbered(kind, which=None):
    """A limit's number: its code, and 16 for all together or for each contact before it and itself."""
    return NUMBER[kind] + (0 if which is None else KINDS * (which + 1))


class Held:
    """A contact of which all is known: what is asked for limits."""

    def __init__(self, finger, *, friction=None, presses=True, force=(1.0, (0.0,)), ends=(), bend=1.0):
        self.finger, self.friction, self.presses = finger, friction, presses
        self.force, self.margins, self.sum = force, ends, bend

    def ends(self, shapes, place):
        return [margin + place for margin in self.margins]

    def curvature_margin(self, shapes, place, pair, touching):
        assert pair == (f"tip {self.finger}", "object") and touching.endswith(str(self.finger))
        return self.sum + place

    def split_force(self, pair, touching, force):
        assert pair == (f"tip {self.finger}", "object")
        return jnp.asarray(self.force[0] + sum(force)), self.force[1]

    def rubbing(self, tangential):
        return [abs(x) for x in tangential] + [-5.0]


def body(joints, limits=None, torque_limits=None, link_radius=None):
    return SimpleNamespace(joints=joints, limits=limits, torque_limits=torque_limits, link_radius=link_radius)


def held(*contacts, fingers=(), pivot=1.0, torques=(), forces=None):
    """A grasp and its instant, as far as limits are asked of them."""
    count = 1 + max(c.finger for c in contacts)
    fingers = fingers or tuple(body(1) for _ in range(count))
    grasp = SimpleNamespace(contacts=contacts, fingers=fingers, shapes=lambda contact: None)
    motions = [SimpleNamespace(pose=name) for name in ("object", *(f"tip {i}" for i in range(count)))]
    schur = SimpleNamespace(smallest_pivot=jnp.asarray(pivot))
    instant = SimpleNamespace(
        motions=motions,
        touching=[f"touch {c.finger}" for c in contacts],
        forces=forces or [(0.0,)] * len(contacts),
        momentum=[],
        line=SimpleNamespace(schur=schur),
        torques=torques or ((),) * len(fingers),
    )
    places = tuple(0.0 for _ in contacts)
    q = ((0.0,), *((0.1,) * f.joints for f in fingers))
    return grasp, SimpleNamespace(q=q, s=places), instant


def told(limits):
    """Margins and numbers, as plain numbers."""
    return [(pytest.approx(float(x.margin), rel=1e-12), int(x.number)) for x in limits]


def test_limits_of_joints_and_torques_are_counted_over_all_fingers():
    ranged = body(2, limits=((-1.0, 2.0), (-3.0, 0.5)))
    strong = body(1, limits=((0.0, 1.0),), torque_limits=(0.3,))
    still = body(1, torque_limits=(0.7,))
    torques = ((5.0, 5.0), (), (-0.2,), ())
    grasp, _, instant = held(Held(0), fingers=(ranged, body(3), strong, still), torques=torques)
    leaves = SimpleNamespace(q=((0.0,), (0.5, -0.25), (9.0,) * 3, (0.25,), (4.0,)))
    wanted = [(1.5, "joint", 0), (1.5, "joint", 0), (2.75, "joint", 1), (0.75, "joint", 1)]
    wanted += [(0.25, "joint", 5), (0.75, "joint", 5), (0.1, "torque", 5), (0.7, "torque", 6)]
    found = told(_events._joints(grasp, leaves, instant))
    assert found == [(margin, numbered(kind, which)) for margin, kind, which in wanted]


def test_limits_of_forces_are_those_asked_for():
    rubs = Held(0, friction=0.5, force=(3.0, (1.0, 0.25)))
    sticks = Held(1, friction=0.4, presses=False, force=(2.0, (0.5,)))
    free = Held(2, force=(-7.0, (9.0,)))
    grasp, _, instant = held(rubs, sticks, free, forces=[(1.5, -0.5), (0.0,), (0.0,)])
    lift = [(4.0, numbered("lost", 0)), (-7.0, numbered("lost", 2))]
    cones = [(x, numbered("slip", 0)) for x in (1.0, 1.75, 7.0)] + [
        (x, numbered("slip", 1)) for x in (0.3, 5.8)
    ]
    asked = lambda *events: sorted(told(_events._forces(grasp, instant, events)), key=repr)  # noqa: E731
    assert [(x, n) for x, n in told(_events._forces(grasp, instant, ("lift",)))] == lift
    assert told(_events._forces(grasp, instant, ("friction",))) == cones
    assert told(_events._forces(grasp, instant, ("lift", "friction"))) == [
        lift[0],
        *cones,
        lift[1],
    ]
    assert asked("penetration") == []


def test_limits_of_the_geometry_are_ends_sums_of_curvature_and_one_pivot():
    one, other = Held(0, ends=(0.25, 0.5), bend=0.125), Held(1, ends=(0.75,), bend=0.01)
    grasp, leaves, instant = held(one, other, pivot=3e-9)
    ends = [(0.25, numbered("end", 0)), (0.5, numbered("end", 0)), (0.75, numbered("end", 1))]
    bends = [(0.125 - 1e-4, numbered("singular", 0)), (0.01 - 1e-4, numbered("singular", 1))]
    found = told(_events._geometry(grasp, leaves, instant))
    assert found == [*ends, *bends, (pytest.approx(2e-3, rel=1e-9), numbered("singular"))]


@pytest.mark.parametrize(
    ("contact", "pivot", "fingers", "wanted"),
    [
        (Held(0, force=(0.5, (0.0,))), 1.0, (), (0.5, -numbered("lost", 0))),
        (Held(0, force=(-0.5, (0.0,))), 1.0, (), (-0.5, numbered("lost", 0))),
        # Limits of the geometry come first, however far the forces are beyond theirs.
        (Held(0, force=(-5.0, (0.0,)), bend=-0.25), 1.0, (), (-0.2501, numbered("singular", 0))),
        (Held(0, force=(-5.0, (0.0,)), bend=1e-4), 1.0, (), (-5.0, numbered("lost", 0))),
        (Held(0, force=(NAN, (0.0,)), bend=0.25), 1.0, (), (0.2499, -numbered("singular", 0))),
        (Held(0, force=(3.0, (0.0,)), ends=(0.0,)), 1.0, (), (0.0, -numbered("end", 0))),
        (Held(0, force=(3.0, (0.0,))), 0.5e-9, (), (-5e-4, numbered("singular"))),
        (Held(0), 1.0, (body(1, limits=((0.2, 1.0),)),), (-0.1, numbered("joint", 0))),
    ],
)
def test_the_smallest_margin_and_its_number(contact, pivot, fingers, wanted):
    margin, number, parts = _events.regime(*held(contact, pivot=pivot, fingers=fingers), ("lift",))
    assert float(margin) == pytest.approx(wanted[0], rel=1e-9) and int(number) == wanted[1]
    shape = contact.margins[0] if contact.margins else min(contact.sum - 1e-4, (pivot - 1e-9) * 1e6)
    # Dips are looked for in positions, and in forces while the geometry holds. A force that is no number is
    # passed over.
    place, force = min(shape, *[-0.1] * len(fingers), INF), contact.force[0]
    assert float(parts[0]) == pytest.approx(place, rel=1e-9)
    assert float(parts[1]) == pytest.approx(place if shape < 0 else INF if np.isnan(force) else force)
    if not fingers:
        margin, _, parts = _events.regime(*held(contact, pivot=pivot), ())
        assert [float(x) for x in (margin, *parts)] == pytest.approx([shape] * 3, rel=1e-9)


@pytest.mark.parametrize(
    ("end", "audit", "wanted"),
    [
        ((2.0, -4.0), [1.0], (1.0, -4.0)),
        ((2.0, -4.0), [0.5], (0.5, -4.0)),
        ((2.0, -4.0), [-1.0, -3.0], (-3.0, 22.0)),
        ((-2.0, 4.0), [-1.0], (-2.0, 4.0)),
        ((-2.0, 4.0), [-3.0], (-3.0, 4.0)),
        ((2.0, 0.0), [-1.0], (-1.0, 22.0)),
        ((2.0, -4.0), [], (2.0, -4.0)),
    ],
)
def test_an_overlap_is_the_cause_unless_a_limit_was_passed_before(monkeypatch, end, audit, wanted):
    limits = [_events.Limit(jnp.asarray(x), 22.0 + 16.0 * i) for i, x in enumerate(audit)]
    monkeypatch.setattr(_events, "_audits", lambda *_: limits)
    found = _events.with_clearance(None, None, end, ())
    assert tuple(float(x) for x in found) == wanted


def test_what_is_not_finite_has_no_margin_and_its_own_code():
    whole, broken = jnp.array([1.0, 2.0]), jnp.array([1.0, INF])
    same(_events.coded(whole, 0.5, jnp.asarray(-20)), [0.5, -20.0])
    same(_events.coded(broken, 0.5, jnp.asarray(-20)), [NAN, 1.0])
    same(_events.coded(broken, 0.5, jnp.asarray(0)), [NAN, 1.0])
    same(_events.coded(broken, -0.5, jnp.asarray(20)), [NAN, 20.0])


def test_codes_of_runs_are_those_of_the_limit_that_was_passed():
    results, of = jxr.RESULTS, _events.decode
    assert of(jnp.asarray(-20.0), CODES.successful) == results.successful
    assert of(jnp.asarray(0.0), CODES.max_steps_reached) == results.max_steps_reached
    assert of(jnp.asarray(-4.0), CODES.dt_min_reached) == results.step_collapsed
    assert of(jnp.asarray(-4.0), CODES.nonlinear_divergence) == results.solver_failed
    names = ["not_finite", "singular_contact", "contour_end", "contact_lost", "slipping", "penetration"]
    for i, name in enumerate(names, 1):
        for which, loop in (
            (0, CODES.successful),
            (KINDS, CODES.dt_min_reached),
            (5 * KINDS, CODES.successful),
        ):
            assert of(jnp.asarray(float(i + which)), loop) == getattr(results, name)
    limited = SimpleNamespace(fingers=(body(1), body(1, limits=((0.0, 1.0),))))
    thick = SimpleNamespace(fingers=(body(1, link_radius=0.01),))
    pulled = SimpleNamespace(fingers=(body(1, torque_limits=(1.0,)), SimpleNamespace()))
    plain = SimpleNamespace(fingers=(body(1), SimpleNamespace()))
    for i, name in enumerate(("joint_limit", "torque_limit", "links_meet"), 7):
        number = jnp.asarray(float(i + 2 * KINDS))
        assert of(number, CODES.successful) == results.successful  # grasps without limits have no such code
        for grasp in (limited, thick, pulled):
            assert _events.decode_joints(grasp, number, results.successful) == getattr(results, name)
            assert _events.decode_joints(grasp, -number, results.slipping) == results.slipping
        assert _events.decode_joints(plain, number, results.slipping) == results.slipping
    ends = [_events.whose(jnp.asarray(float(x))) for x in (-20, 0, 4, 15, 16 + 4, 32 + 9, 48)]
    assert [int(x) for x in ends] == [-1, -1, -1, -1, 0, 1, 2]


def test_a_blow_is_refused_beyond_the_rounding_of_its_momentum():
    def refused(force, *, momentum=2.0, events=("lift",)):
        grasp, _, done = held(Held(0, force=(force, (0.0,))))
        done.momentum = [(momentum, -0.5), (0.25,)]
        return _events.refused_blow(grasp, done, events)

    for force, no in ((1.0, False), (-1.9e-9, False), (-2.1e-9, True)):
        answer, number = refused(force)
        assert bool(answer) is no and int(number) == numbered("lost", 0)
    assert bool(refused(-2.1e-9, momentum=-4.0)[0]) is False
    answer, number = refused(-1.0, events=())
    assert bool(answer) is False and int(number) == 0


@pytest.mark.parametrize(("pivot", "twice"), [(1e-3, False), (1.1e-9, False), (0.9e-9, True), (NAN, True)])
def test_contacts_that_hold_a_motion_twice_are_told(pivot, twice):
    done = held(Held(0), pivot=pivot)[2]
    assert bool(_events.are_redundant(done)) is twice


class Steady:
    """A control of the error that takes each step, or none, and has the next one as long."""

    def __init__(self, keep=True):
        self.keep = keep

    def init(self, terms, t0, t1, y0, dt0, args, func, order):
        return t0 + dt0, dt0 + order

    def adapt_step_size(self, t0, t1, y0, y1, args, error, order, memory):
        keep = jnp.asarray(self.keep)
        return keep, jnp.where(keep, t1, t0), jnp.where(keep, t1, t0) + 0.25, False, memory, CODES.successful


def planned(*, ts, jumps=None, sampled=False, keep=True):
    """A plan from 0.2 s to 2 s; of four numbers in the flow vector the second is when a sample is due."""
    lay = SimpleNamespace(form=SimpleNamespace(sampled=sampled), due=1, margin=2)
    stepper = SimpleNamespace(lay=lay, error_order=5.0)
    start, end, dt0 = jnp.asarray(0.2), jnp.asarray(2.0), jnp.asarray(0.01)
    jumps = None if jumps is None else jnp.asarray(jumps)
    return Plan(stepper, Steady(keep), start, end, jnp.asarray(ts), dt0, jumps, None, 9, False)


def under_way(plan, *, t=0.2, length=0.1, y=(0.5, 0.25, 1.0, -20.0), **changes):
    """A run in progress."""
    course = embark(plan, jnp.asarray(y))
    one = jnp.asarray
    hunt = Hunt(*(one(x) for x in (INF, 0.0, 0.0, 0.0, INF, 1.0)))
    pace = Pace(one(5.01), one(length), one(t), one(3), one(2), hunt)
    return course._replace(pace=pace, **{k: one(v) for k, v in changes.items()})


def test_a_run_embarks_at_rest_and_knows_its_control():
    plan = planned(ts=[0.5])
    course = embark(plan, jnp.asarray((0.5, 0.25, 1.0, -20.0)))
    assert float(course.pace.inner) == pytest.approx(5.01) and float(course.pace.t) == 0.2
    assert (int(course.saved), bool(course.hit), bool(course.busy), course.passed) == (0, False, True, None)
    assert int(course.loop) == CODES.successful._value
    assert int(embark(planned(ts=[0.5], jumps=[1.0]), course.y).passed) == 0


@pytest.mark.parametrize(
    ("plan", "course", "wanted"),
    [
        ({"ts": [0.5, 1.0]}, {}, 0.2 + 0.1),
        ({"ts": [0.5, 1.0]}, {"length": 0.3 - 0.5e-10}, 0.5),
        ({"ts": [0.5, 1.0]}, {"length": 0.3 - 1.5e-10}, 0.5 - 1.5e-10),
        ({"ts": [0.5, 1.0]}, {"length": 7.0}, 0.5),
        ({"ts": [0.5, 1.0]}, {"length": 7.0, "saved": 1}, 1.0),
        ({"ts": [0.5, 1.0]}, {"length": 7.0, "saved": 2}, 2.0),
        ({"ts": [0.2 + 0.5e-10]}, {"length": 0.0}, 0.2),
        ({"ts": [0.5]}, {"length": 0.3, "busy": False}, 0.2),
        ({"ts": [0.5], "sampled": True}, {"length": 7.0}, 0.25),
        ({"ts": [0.25], "sampled": True}, {"length": 7.0, "y": (0.5, 0.25 - EPS / 4, 1.0, -1.0)}, 0.25),
        (
            {"ts": [0.25], "sampled": True},
            {"length": 7.0, "y": (0.5, 0.25 - 32 * EPS, 1.0, -1.0)},
            0.25 - 32 * EPS,
        ),
        ({"ts": [0.25], "sampled": True}, {"length": 7.0, "y": (0.5, 0.75, 1.0, -1.0)}, 0.25),
        ({"ts": [0.5], "jumps": [0.25, 1.0]}, {"length": 7.0}, 0.25 - EPS),
        ({"ts": [0.5], "jumps": [0.25, 1.0]}, {"length": 7.0, "passed": 2}, 0.5),
    ],
)
def test_where_a_run_aims(plan, course, wanted):
    plan = planned(**plan)
    t0, t1 = aim(plan, under_way(plan, **course))
    assert float(t0) == 0.2 and abs(float(t1) - wanted) <= 1e-16


def judged(plan, course, times, y1, dip=INF):
    times = tuple(jnp.asarray(t) for t in times)
    return judge(plan, course, times, (jnp.asarray(y1), jnp.zeros(4), jnp.asarray(dip)))


def test_what_a_run_makes_of_a_step():
    plan = planned(ts=[0.5, 2.0])
    good, before = (0.75, 0.5, 3.0, -4.0), (0.5, 0.25, 1.0, -20.0)
    going = judged(plan, under_way(plan), (0.2, 0.3), good)
    same(going.y, good)
    assert (int(going.saved), bool(going.hit), bool(going.busy), going.passed) == (0, False, True, None)
    assert float(going.pace.t) == 0.3 and int(going.pace.accepted) == 3
    # At a save time, and at the end, which is over once all are saved.
    saved = judged(plan, under_way(plan), (0.2, 0.5), good)
    assert (int(saved.saved), bool(saved.hit), bool(saved.busy)) == (1, True, True)
    over = judged(plan, under_way(plan, saved=1), (1.9, 2.0), good)
    assert (int(over.saved), bool(over.hit), bool(over.busy)) == (2, True, False)
    again = judged(plan, under_way(plan, saved=2), (1.9, 2.0), good)
    assert (int(again.saved), bool(again.hit), bool(again.busy)) == (2, False, False)
    later = judged(planned(ts=[0.5]), under_way(plan, saved=1), (1.0, 1.5), good)
    assert (int(later.saved), bool(later.hit), bool(later.busy)) == (1, False, True)
    # A step that is left, and a run that is over, which stays as it is.
    left = judged(planned(ts=[0.5], keep=False), under_way(plan), (0.2, 0.5), good)
    same(left.y, before)
    assert (int(left.saved), bool(left.hit), bool(left.busy)) == (0, False, True)
    idle = judged(plan, under_way(plan, busy=False), (0.2, 0.5), good)
    same(idle.y, before)
    assert (int(idle.saved), bool(idle.hit), bool(idle.busy)) == (0, False, False)
    assert float(idle.pace.t) == 0.2 and int(idle.pace.attempted) == 3
    # Beyond a limit, by a first step of no length; where something is not finite the state before is kept.
    ended = judged(plan, under_way(plan, length=0.0), (0.5, 0.5), (0.75, 0.5, -3.0, 20.0))
    same(ended.y, (0.75, 0.5, -3.0, 20.0))
    assert (int(ended.saved), bool(ended.hit), bool(ended.busy)) == (0, False, False)
    assert int(ended.loop) == CODES.event_occurred._value
    broken = judged(plan, under_way(plan, length=0.0), (0.2, 0.2), (NAN, 0.5, NAN, 1.0))
    same(broken.y, (*before[:3], 1.0))
    assert not broken.busy
    unjudged = judged(
        planned(ts=[0.5], keep=False), under_way(plan, y=(0.5, 0.25, 1.0, 0.0)), (0.2, 0.5), good
    )
    assert unjudged.busy


def test_short_steps_at_jumps_are_counted():
    plan, good = planned(ts=[0.5], jumps=[0.25]), (0.75, 0.5, 3.0, -4.0)
    for t1, passed, wanted in (
        (0.25, 0, 1),
        (0.25 + EPS, 1, 2),
        (0.25 - EPS, 0, 0),
        (0.25, 1, 1),
        (0.3, 2, 2),
    ):
        course = judged(plan, under_way(plan, passed=passed), (0.2, t1), good)
        assert int(course.passed) == wanted
    idle = judged(plan, under_way(plan, passed=0, busy=False), (0.2, 0.25), good)
    assert int(idle.passed) == 0


def test_a_path_counts_what_was_tried_taken_and_left():
    counts = tuple(jnp.asarray(x) for x in (9.0, 7.0, float(CODES.dt_min_reached._value)))
    path = path_of(jnp.zeros((2, 4)), jnp.array([0.0, 20.0, 1.0, -4.0]), jnp.asarray(0.5), counts)
    assert path.steps.tolist() == [9, 7, 2] and path.result == jxr.RESULTS.step_collapsed
    assert path.record is None and float(path.t_last) == 0.5


def test_times_of_blows_come_among_the_save_times_just_before_their_jumps():
    saves, more = jnp.array([0.5, 1.0, 2.0]), jnp.array([1.5, 0.75])
    times, of_saves, of_more = merged(saves, more)
    same(times, [0.5, 0.75, 1.0, 1.5, 2.0])
    assert (of_saves.tolist(), of_more.tolist()) == ([0, 2, 4], [3, 1])
    blows = tuple(jxr.loads.Impulse((1.0, 0.0), t) for t in (1.5, 0.25, 3.0))
    grasp = SimpleNamespace(load=(jxr.loads.Drag(1.0), *blows))
    same(blow_times(grasp), [1.5, 0.25, 3.0])
    jumps, end = jnp.array([1.5, INF]), jnp.asarray(2.0)
    same(times_before(grasp, jumps, jnp.asarray(0.5), end), [1.5 - 4 * EPS * 1.5, 0.5, 2.0])


def test_a_record_has_room_for_all_steps_the_first_of_no_length_and_the_start():
    record = empty_record(SimpleNamespace(max_steps=9), jnp.zeros(4))
    assert record.ts.tolist() == 11 * [INF] and record.ys.shape == (11, 4) and not record.ys.any()


@pytest.mark.parametrize("size", [1, 5, 8, 63, 64, 65, 127, 128, 129, 200, 1000])
def test_slots_are_the_fewest_whole_vectors_that_need_no_more_rounds(size):
    rounds = math.ceil(size / 64)
    wanted = next(n for n in itertools.count(VECTOR, VECTOR) if math.ceil(size / n) <= rounds)
    assert _slots(size, 64) == min(size, wanted)


@pytest.mark.parametrize("method", [diffrax.Heun(), diffrax.Tsit5(), diffrax.Dopri8(), diffrax.Bosh3()])
def test_a_tableau_ends_with_the_end_of_the_step(method):
    """Rows by stage, of which each sums to its time; the last one is the solution's."""
    own = method.tableau
    rows, shares, errors = tableau_of(method, float)
    count = own.num_stages + (0 if own.fsal and own.ssal else 1)
    assert rows.shape == (count, count) and len(shares) == len(errors) == count
    np.testing.assert_allclose(rows.sum(axis=1), shares, atol=1e-14)
    same(rows[0], np.zeros(count))
    same(rows[-1, : len(own.b_sol)], own.b_sol[:count])
    for i, weights in enumerate(own.a_lower, 1):
        same(rows[i], [*weights, *(count - len(weights)) * [0.0]])
    same(errors, [*own.b_error, *(count - own.num_stages) * [0.0]])
    assert shares[0] == 0.0 and shares[-1] == 1.0
