"""Goals besides condition (41): runs of the closed loop, and stability at rest on any objects."""

import types

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._mechanics import as_grasp_and_state
from jaxroll.design import (
    _closed_loop_goal,
    _fingertip,
    _firmness,
    _goals,
    ClosedLoop,
    Fair,
    Firmness,
    friction_demand,
    Limits,
    Margin,
    optimise_fingertip,
    overshoot,
    peak_force,
    settling_time,
    tracking_error,
    value_and_grad,
)
from jaxroll.design._limits import sampled
from jaxroll.design._measures import FORCED, MEASURES, PARTIAL, SETTLED
from tests.measures import both_ways, programs
from tests.recorded import runs
from tests.subjects.fingertips import ellipse_pinched_by, INTERVAL, pivoted_with_tip, within


def with_signal(run, y):
    """A run whose saved times are fine, for signals given as functions of time."""
    ts = jnp.linspace(0.0, 4.0, 4001)
    states = jax.tree.map(lambda a: jnp.zeros((4001, *a.shape[1:])), run.states)
    return eqx.tree_at(lambda r: (r.ts, r.states), run, (ts, states)), y(ts)


def test_measures_of_signals_in_closed_form(run):
    still, decay = with_signal(run, lambda t: jnp.exp(-t / 0.2))
    assert abs(float(settling_time(still, signal=decay)) - 0.2 * np.log(50.0)) < 1e-5
    assert abs(float(tracking_error(still, signal=decay)) - 0.2) < 1e-5
    assert float(overshoot(still, signal=decay)) == 0.0
    a, w = 3.0, 12.0
    still, ringing = with_signal(run, lambda t: jnp.exp(-a * t) * jnp.cos(w * t))
    turn = np.pi - np.arctan(a / w)  # where its derivative vanishes first
    last = np.exp(-4.0 * a) * np.cos(4.0 * w)
    past = (last - np.exp(-a * turn / w) * np.cos(turn)) / (1.0 - last)
    # Also of a signal that ends far from zero.
    for rest in (0.0, 5.0):
        assert abs(float(overshoot(still, signal=rest + ringing)) - past) < 1e-5
    assert abs(float(settling_time(still, signal=5.0 + decay)) - 0.2 * np.log(50.0)) < 1e-5
    assert abs(float(tracking_error(still, signal=5.0 + decay)) - 0.2) < 1e-5
    ts = np.linspace(0.0, 4.0, 400001)
    outside = np.abs(np.exp(-a * ts) * np.cos(w * ts)) > 0.02
    assert abs(float(settling_time(still, signal=ringing)) - ts[outside].max()) < 1e-4
    constant, flat = with_signal(run, jnp.ones_like)
    assert float(settling_time(constant, signal=flat)) == 0.0
    assert float(tracking_error(constant, signal=flat)) == 0.0


@pytest.mark.parametrize("missing", [0, 1, 7, -1, slice(None)])
def test_a_signal_that_is_not_known_throughout_has_no_measure(run, missing):
    decay = np.exp(-np.linspace(0.0, 5.0, len(run.ts)))
    for measure in (settling_time, overshoot, tracking_error):
        assert np.isfinite(measure(run, signal=decay))
        some = decay.copy()
        some[missing] = np.nan
        assert np.isnan(measure(run, signal=some))


def test_a_run_of_one_saved_state_does_not_say_how_it_settled(run):
    one = eqx.tree_at(lambda r: (r.ts, r.states), run, jax.tree.map(lambda a: a[-1:], (run.ts, run.states)))
    for measure in (settling_time, overshoot, tracking_error):
        with pytest.raises(ValueError, match="argument run must have saved two states or more"):
            measure(one)


def test_measures_of_forces(run):
    f, lam = np.asarray(run.multipliers.f), np.asarray(run.multipliers.lam)
    assert float(peak_force(run)) == f.max()
    assert float(friction_demand(run)) == np.abs(lam / f).max()
    with pytest.raises(ValueError, match="must have recorded its multipliers"):
        peak_force(eqx.tree_at(lambda r: r.multipliers, run, None, is_leaf=lambda x: x is None))


def test_a_run_that_reached_nothing_has_no_forces_to_measure(run):
    """Its cost in a search stays finite; what was reported, zero, is less than that of a grasp that holds."""
    nothing = jnp.full_like(run.multipliers.f, jnp.nan)
    lost = eqx.tree_at(lambda r: (r.multipliers.f, r.multipliers.lam), run, (nothing, nothing))
    assert np.isnan(peak_force(lost)) and np.isnan(friction_demand(lost))
    assert float(PARTIAL["peak_force"](lost)) == 0.0 and float(PARTIAL["friction_demand"](lost)) == 0.0


def test_friction_demand_in_space_by_hand(run):
    """Tangential forces of two numbers, none of which acts but at one of the times."""
    f = jnp.full_like(run.multipliers.f, 4.0)
    lam = jnp.zeros((*f.shape, 2)).at[3, 0].set(jnp.array([0.6, -0.8]))

    def demand(lam):
        return friction_demand(eqx.tree_at(lambda r: (r.multipliers.f, r.multipliers.lam), run, (f, lam)))

    assert float(demand(lam)) == 0.25 and float(demand(0.0 * lam)) == 0.0
    slope = np.asarray(jax.grad(demand)(lam))
    np.testing.assert_allclose(slope[3, 0], [0.15, -0.2], rtol=1e-14)
    assert np.count_nonzero(slope) == 2  # and nothing is NaN


@pytest.mark.slow
def test_measures_see_only_what_a_run_reached():
    """A run that slips: rows after its end hold NaN, measures and their derivatives do not."""
    grasp, start = jxr.scenes.pinch(tips=jxr.Ellipse(0.018, 0.009), alpha=0.0, friction=0.5)

    def all_of(beta):
        held = grasp.with_(beta=beta)
        run = jxr.simulate(held, start, t1=1.0, ts=101, throw=False, record=("multipliers",), rtol=1e-6)
        settled = jnp.stack([settling_time(run), overshoot(run), tracking_error(run)])
        return jnp.stack([measure(run) for measure in PARTIAL.values()]), (run.stats.t_end, settled)

    @jax.jit
    def with_slopes(beta):
        values, pull, seen = jax.vjp(all_of, beta, has_aux=True)
        return values, jax.vmap(pull)(jnp.eye(values.size))[0], seen

    values, slopes, (end, settled) = with_slopes(20.0)
    assert float(end) < 1.0
    assert np.all(np.isfinite(values)) and np.all(np.isfinite(slopes))
    assert 0.4 < float(values[-1]) <= 0.5
    assert np.all(np.isnan(settled))  # it came to rest nowhere


LOOP = ClosedLoop(
    pivoted_with_tip,
    {"settling_time": 1.0, "tracking_error": 1.0, "peak_force": 0.2, "friction_demand": 0.5},
    t1=0.5,
    ts=51,
)


def loop_cost(x):
    tip = jxr.Ellipse(x[0], x[1])
    return LOOP.cost(tip, None, 1.0, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["reverse", "forward"])
def test_gradient_of_a_closed_loop_objective(mode):
    """Central differences of fourth order, through contact, closing and the run."""
    x, way = jnp.array([0.012, 0.02]), jnp.array([0.6, -0.8])
    cost, slope = jax.jit(loop_cost), jax.jit(value_and_grad(loop_cost, mode))
    h = 2e-5
    ends = [float(cost(x + k * h * way)) for k in (-2, -1, 1, 2)]
    expected = (ends[0] - 8.0 * ends[1] + 8.0 * ends[2] - ends[3]) / (12.0 * h)
    value, found = slope(x)
    assert abs(float(value) - float(cost(x))) < 1e-12
    assert abs(float(found @ way) - expected) < 1e-6 * abs(expected)


def test_forward_and_reverse_are_chosen_by_size():
    @jax.custom_jvp
    def seen(x):
        return jnp.sum(x**3)

    @seen.defjvp
    def _(primals, tangents):
        return seen(*primals), jnp.sum(3.0 * primals[0] ** 2 * tangents[0])

    for size in (2, 40):
        x = {"a": np.arange(1.0, 1.0 + size)}
        for mode in ("auto", "forward", "reverse"):
            value, slope = jax.jit(value_and_grad(lambda x: seen(x["a"]), mode))(x)
            np.testing.assert_allclose(slope["a"], 3.0 * x["a"] ** 2)
            np.testing.assert_allclose(value, np.sum(x["a"] ** 3))
    text = lambda mode, n: str(jax.make_jaxpr(value_and_grad(jnp.prod, mode))(jnp.ones(n)))  # noqa: E731
    assert text("auto", 1) == text("forward", 1) != text("reverse", 1)
    assert text("auto", 2) == text("reverse", 2) != text("forward", 2)
    assert text("auto", 9) == text("reverse", 9) != text("forward", 9)
    for mode in ("forward", "reverse"):
        both = value_and_grad(lambda x: (jnp.sum(x), {"word": "more", "twice": 2.0 * x}), mode, has_aux=True)
        _, aux = both(jnp.ones(3))[0]
        assert aux["word"] == "more" and aux["twice"].tolist() == [2.0, 2.0, 2.0]


@pytest.mark.slow
def test_rest_of_a_pinch_is_the_equilibrium_with_the_hessian_of_its_potential():
    """By contact places alone against Newton on the whole problem, and against autodiff of U."""
    tip = jxr.Ellipse(0.012, 0.02).moved((0.002, 0.001))
    grasp, state = ellipse_pinched_by(tip)
    s, rest = jxr.stability.pinch_rest(grasp, state)
    whole = jxr.stability.equilibrium(grasp, state)
    places = [c.sense * (c.s_object - x) for c, x in zip(grasp.contacts, whole.state.s, strict=True)]
    np.testing.assert_allclose(s, jnp.stack(places), atol=1e-11)
    by_autodiff = jxr.stability.pinch_statics(grasp, s)
    np.testing.assert_allclose(rest.hessian, by_autodiff.hessian, rtol=1e-11)
    np.testing.assert_allclose(rest.potential, by_autodiff.potential, rtol=1e-13)
    np.testing.assert_allclose([rest.d, rest.l], [by_autodiff.d, by_autodiff.l], atol=1e-14)


@pytest.mark.slow
def test_rest_of_a_pinch_answers_changes_of_the_fingertip():
    def place(x):
        tip = jxr.Ellipse(x, 0.02).moved((0.002, 0.001))
        s, rest = jxr.stability.pinch_rest(*ellipse_pinched_by(tip))
        return jnp.concatenate([s, rest.hessian.ravel()])

    every, h, bars = both_ways(place), 1e-6, np.eye(6)
    low, high = (every(0.012 + side * h, 1.0, bars[0])[0] for side in (-1, 1))
    expected = (high - low) / (2 * h)
    np.testing.assert_allclose(every(0.012, 1.0, bars[0])[1], expected, rtol=1e-6, atol=1e-6)
    backwards = [every(0.012, 1.0, bar)[2] for bar in bars]
    np.testing.assert_allclose(backwards, expected, rtol=1e-6, atol=1e-6)


def test_without_a_place_at_rest_there_is_no_number():
    """Discs about O on a plate: neutral everywhere, so the Hessian is singular."""
    scene = lambda ahead, s: jxr.scenes.pinch(tips=jxr.Circle(0.008).moved((ahead, 0.0)), s=s, alpha=0.0)  # noqa: E731
    with runs.not_closed():
        about, far = scene(0.0, (0.004, -0.003)), scene(0.006, (0.02, -0.02))
    s, _ = jxr.stability.pinch_rest(*about)
    assert np.all(np.isnan(s)) or np.all(np.isfinite(s))
    s, rest = jxr.stability.pinch_rest(*far)
    assert np.all(np.isnan(s)) == bool(np.isnan(rest.potential))


def on_plate(tip):
    return jxr.scenes.pinch(tips=tip, alpha=0.0, s=(0.0, 0.0))


@pytest.mark.slow
def test_on_a_plate_the_stiffness_is_the_margin_of_41_times_a_force():
    for tip in (jxr.Circle(0.01).moved((-0.002, 0.0)), jxr.Ellipse(0.01, 0.015), jxr.Ellipse(0.015, 0.01)):
        found = Firmness(on_plate).aimed(tip).values(tip)
        depth = 0.03 + 2.0 * float(tip.point(0.0)[0])
        expected = 20.0 * depth * float(jxr.stability.margin(tip, 0.0))
        np.testing.assert_allclose(found, expected, rtol=1e-10)


@pytest.mark.slow
def test_firmness_by_stiffness_has_the_analytic_optimum():
    r"""$\beta (w + 2h)(R - h)$ with R as large as it may be is largest at h = (2R - w)/4."""
    limits = Limits(size=0.03, ahead=0.008, flat=0.05)
    design = optimise_fingertip(
        jxr.Ellipse(0.015, 0.01), (-1e-4, 1e-4), goal=Firmness(on_plate), limits=limits, steps=150
    )
    assert float(design.before[0]) < 0.0
    np.testing.assert_allclose([design.tip.a, design.tip.b**2 / design.tip.a], [0.0175, 0.05], rtol=1e-4)
    np.testing.assert_allclose(design.after, 20.0 * (0.03 + 0.035) * (0.05 - 0.0175), rtol=1e-5)


def test_stiffnesses_are_eigenvalues_of_the_hessian_over_the_angles_of_the_fingertips(monkeypatch):
    r"""Both of $H_{ij} / r_i r_j$, with $H$ over contact places [m] and turnings $r_i$ there [rad/m]."""
    hessian, turning = np.array([[700.0, 90.0], [90.0, -300.0]]), np.array([50.0, 20.0])
    rest = types.SimpleNamespace(hessian=jnp.asarray(hessian), turning=jnp.asarray(turning))
    monkeypatch.setattr(_firmness, "pinch_rest", lambda grasp, state, damping: (None, rest))
    wanted = np.linalg.eigvalsh(hessian / np.outer(turning, turning))
    np.testing.assert_allclose(_firmness._stiffnesses(None, None, 0.0), wanted, rtol=1e-12)


@pytest.mark.parametrize("scale", [0.5, 4.0])
def test_the_cost_of_firmness_is_the_least_value_by_its_scale(monkeypatch, scale):
    monkeypatch.setattr(Firmness, "values", lambda goal, tip, floor: jnp.array([3.0, 2.0, 8.0]))
    found = Firmness(on_plate, scale=scale).cost(jxr.Circle(0.01), None, 1.0, 1e4)
    assert float(found) == pytest.approx(-2.0 / scale)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ({}, (1, 1.0)),
        ({"neutral": 2}, (2, 2.0)),
        ({"scale": 0.7}, (1, 0.7)),
        ({"neutral": 0, "scale": 3.0}, (0, 3.0)),
    ],
)
def test_a_goal_aims_at_what_its_first_case_has(monkeypatch, given, wanted):
    asked = []

    def first(make, cases, measure, tip):
        asked.append((cases, measure))
        return jnp.array([[3.0, -1.0, 0.5, 2.0]]), jnp.array([1])

    monkeypatch.setattr(_firmness, "_first", first)
    goal = Firmness(lambda tip, case: None, cases=jnp.array([7.0, 8.0]), measure="rate", **given)
    aimed = Fair(goal, weight=0.2).aimed(jxr.Circle(0.01))
    assert float(aimed.weight) == 0.2 and aimed.merit == goal.merit and aimed.in_turn == goal.in_turn
    assert (aimed.goal.neutral, float(aimed.goal.scale), aimed.goal.measure) == (*wanted, "rate")
    np.testing.assert_array_equal(asked[0][0], [7.0])
    np.testing.assert_array_equal(aimed.goal.cases, [7.0, 8.0])
    monkeypatch.setattr(_firmness, "_first", lambda *args: (jnp.array([[jnp.nan, 1.0]]), jnp.array([0])))
    with pytest.raises(ValueError, match="argument tip must have an equilibrium in the first case"):
        goal.aimed(jxr.Circle(0.01))


@pytest.mark.parametrize(
    ("found", "wanted"), [((3e-7, 4e-3), 4e-3), ((-1e-9, 4e-3), 4e-3), ((-1e-3, 4e-3), 1e-3)]
)
def test_a_stiffness_near_zero_is_no_scale(monkeypatch, found, wanted):
    """By it the cost of what is reached would be thousands, and no limit would be kept beside that."""
    monkeypatch.setattr(_firmness, "_first", lambda *args: (jnp.array([found]), jnp.array([0])))
    assert float(Firmness(on_plate).aimed(jxr.Circle(0.01)).scale) == wanted
    assert float(Firmness(on_plate, scale=2.0).aimed(jxr.Circle(0.01)).scale) == 2.0


def test_what_firmness_measures_and_reports(monkeypatch):
    at = types.SimpleNamespace(
        curvatures=jnp.array([4.0, 5.0]),
        rates=jnp.array([-2.0 + 1.0j, 3.0]),
        neutral=jnp.array(1),
        equilibrium=types.SimpleNamespace(found=jnp.array(True)),
    )
    monkeypatch.setattr(_firmness, "assess", lambda grasp, state: at)
    monkeypatch.setattr(_firmness, "_stiffnesses", lambda grasp, state, floor: jnp.array([floor, 1.0]))
    told = lambda measure: [np.asarray(x).tolist() for x in _firmness._values(measure, None, None, 0.5)]  # noqa: E731
    assert told("curvature") == [[4.0, 5.0], 1] and told("rate") == [[2.0, -3.0], 1]
    assert told("stiffness") == [[0.5, 1.0], 0]
    at.equilibrium.found = jnp.array(False)
    assert np.isnan(_firmness._values("rate", None, None)[0]).all()
    goal = Firmness(lambda tip: (None, None), neutral=1)
    monkeypatch.setattr(
        _firmness, "each_case", lambda make, cases, tip, found: jnp.stack([found(None, None)] * 2)
    )
    np.testing.assert_allclose(goal.values(None, 0.25), [1.0, 1.0])
    figures = jax.jit(lambda pad: Fair(goal).figures(None, sampled(jxr.Circle(0.01), pad)))([-1e-3, 1e-3])
    assert list(figures)[0] == goal.merit and float(figures[goal.merit]) == 1.0 and len(figures) == 2
    assert bool(goal.reached(figures)) and not bool(Fair(goal).reached({goal.merit: jnp.array(0.0)}))


def test_costs_of_closed_loops_are_weighed_measures_and_what_was_lost(monkeypatch):
    """Two cases: one whole run, and one that ends after 0.4 of 0.6 s, whose own objective has no value."""
    whole, short = runs.run("pinch"), runs.run("pinch", ended="slipping")
    given, asked = iter([whole, short] * 2), []

    def simulated(grasp, state, t1, *, ts, throw, record, **rest):
        asked.append((float(t1), ts, throw, record))
        return next(given)

    monkeypatch.setattr(_closed_loop_goal, "simulate", simulated)
    stacked = lambda parts: jax.tree.map(lambda *x: jnp.stack(x), *parts)  # noqa: E731
    each = lambda make, cases, tip, found, in_turn: stacked([found(None, None) for _ in range(2)])  # noqa: E731
    monkeypatch.setattr(_closed_loop_goal, "each_case", each)
    goal = ClosedLoop(pivoted_with_tip, {"peak_force": 2.0, "friction_demand": 0.5}, t1=0.6, ts=13)
    force = jax.jit(lambda run: 2.0 * PARTIAL["peak_force"](run) + 0.5 * PARTIAL["friction_demand"](run))
    forces = [force(run) for run in (whole, short)]
    lost = 1.0 - float(short.stats.t_end) / 0.6
    costs = jax.jit(lambda: goal._costs(None))()
    np.testing.assert_allclose(costs, [forces[0], forces[1] + _closed_loop_goal._LOST * lost])
    assert [each[3] for each in asked] == [("multipliers",)] * 2 and asked[0][2] is False
    own = ClosedLoop(pivoted_with_tip, lambda grasp, run: run.states.q[-1, 0] + 1.0, t1=0.6, ts=13)
    first = float(whole.states.q[-1, 0]) + 1.0
    np.testing.assert_allclose(own._costs(None), [first, _closed_loop_goal._LOST * lost])
    assert own.merit == goal.merit and own.in_turn
    assert bool(own.reached({_closed_loop_goal._EARLY: jnp.array(0)}))
    assert not bool(own.reached({_closed_loop_goal._EARLY: jnp.array(1)}))


def test_the_smallest_value_leaves_out_those_that_are_always_zero():
    """Unless one is negative, by more than rounding: 1e-7 of the largest."""
    for values, neutral, wanted in (
        ([3.0, 0.0, 2.0, 5.0], 1, 2.0),
        ([3.0, 2.0, 5.0], 0, 2.0),
        ([3.0, -1e-4, 2e-4, 400.0], 1, -1e-4),
        ([3.0, -1e-5, 2e-4, 400.0], 1, 2e-4),
        ([0.3, -1e-8, 2e-4, 0.04], 1, 2e-4),
        ([0.3, -1e-7, 2e-4, 0.04], 1, -1e-7),
    ):
        assert float(_firmness._smallest(jnp.array(values), neutral)) == wanted


def one_blunt(tip):
    """The other fingertip is a flat pad; limits keep this one from (41)."""
    blunt = jxr.Ellipse(0.004, 0.012)
    return jxr.scenes.pinch(tips=(tip, blunt), alpha=0.0, s=(0.0, 0.0))


@pytest.mark.slow
def test_a_fingertip_that_violates_41_may_hold_all_the_same():
    """(41) is sufficient, not necessary: within these limits it cannot hold, and yet the grasp does."""
    limits = Limits(size=0.02, ahead=0.009, flat=0.0075, radius=0.003)
    start = jxr.Ellipse(0.013, 0.008)
    tried = optimise_fingertip(start, (-1e-3, 1e-3), limits=limits, steps=100)
    assert float(tried.after[0]) < 0.0 and not bool(tried.holds[0])
    design = optimise_fingertip(start, (-1e-3, 1e-3), goal=Firmness(one_blunt), limits=limits, steps=100)
    assert bool(design.holds[0]) and float(design.after[0]) > 0.0
    assert design.figures["worst margin [m]"][1] < 0.0
    verdict = jxr.stability.assess(*one_blunt(design.tip)).verdict
    assert verdict == jxr.stability.VERDICTS.neutral  # the redundant joint; nothing grows


def compiled(caplog):
    """Which programs of a design were compiled."""
    return {name for name in ("_advance", "_outcomes", "_first") if f"jit({name})" in programs(caplog)}


@pytest.mark.slow
def test_64_objects_in_one_program_that_is_compiled_once(caplog):
    goal = Firmness(ellipse_pinched_by, cases=jnp.linspace(0.012, 0.018, 64))
    limits = Limits(size=0.02, radius=0.004, ahead=0.006)
    start = jxr.Ellipse(0.012, 0.012)
    with jax.log_compiles():
        few = optimise_fingertip(start, INTERVAL, goal=goal, limits=limits, steps=20)
        first = compiled(caplog)
        caplog.clear()
        many = optimise_fingertip(start, INTERVAL, goal=goal, limits=limits, steps=80)
    assert first == {"_advance", "_outcomes", "_first"} and not compiled(caplog)
    assert float(many.after[0]) >= float(few.after[0]) > 0.0
    each = np.asarray(goal.values(many.tip))
    assert each.shape == (64,)
    np.testing.assert_allclose(many.after[0], each.min(), rtol=1e-9)


@pytest.mark.slow
def test_curvature_and_rate_are_those_of_the_verdict():
    tip = jxr.Ellipse(0.01, 0.016)
    known = jxr.stability.assess(*ellipse_pinched_by(tip))
    neutral, rates = int(known.neutral), np.sort(-np.asarray(known.rates.real))
    curvature = Firmness(ellipse_pinched_by, measure="curvature").aimed(tip)
    np.testing.assert_allclose(curvature.values(tip), np.asarray(known.curvatures)[neutral], rtol=1e-8)
    rate = Firmness(ellipse_pinched_by, measure="rate").aimed(tip)
    np.testing.assert_allclose(rate.values(tip), rates[neutral], rtol=1e-8)


@pytest.mark.slow
def test_slowest_rate_answers_changes_of_the_fingertip():
    goal = Firmness(ellipse_pinched_by, measure="rate", neutral=2)
    value = lambda x: goal.values(jxr.Ellipse(x, 0.016))[0]  # noqa: E731
    both, h = jax.jit(value_and_grad(value, "forward")), 1e-6
    expected = (both(0.01 + h)[0] - both(0.01 - h)[0]) / (2 * h)
    assert abs(expected) > 1.0
    np.testing.assert_allclose(both(0.01)[1], expected, rtol=1e-5)


@pytest.mark.slow
def test_a_fingertip_that_loses_its_objects_is_changed_to_hold_them():
    """Three objects; violating fingertips slip off one of them at least, the last ones hold all."""
    loses = jxr.Ellipse(0.018, 0.009)
    make = lambda tip, half: jxr.scenes.pinch_ellipse(half, 0.02, tips=tip, alpha=0.0, friction=0.5)  # noqa: E731
    goal = ClosedLoop(
        make,
        {"tracking_error": 1.0, "friction_demand": 1.0},
        cases=jnp.array([0.012, 0.015, 0.018]),
        t1=0.4,
        ts=41,
    )
    limits = Limits(size=0.02, radius=0.004, ahead=0.006)
    design = optimise_fingertip(loses, INTERVAL, goal=goal, limits=limits, steps=40)
    lost = design.figures["runs that end early"]
    assert lost[0] > 0 and lost[1] == 0 and bool(design.holds[0])
    assert design.figures["worst cost"] == (float(design.before[0]), float(design.after[0]))
    assert float(design.after[0]) < float(design.before[0])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: ClosedLoop("make", {"overshoot": 1.0}), "make must be a function"),
        (lambda: ClosedLoop(pivoted_with_tip, {"speed": 1.0}), "objective must be a function, or weights of"),
        (lambda: ClosedLoop(pivoted_with_tip, {}), "objective must be"),
        (lambda: ClosedLoop(pivoted_with_tip, {"overshoot": 1.0}, t1=-1.0), "t1 must be positive"),
        (
            lambda: ClosedLoop(lambda tip, _: pivoted_with_tip(tip), max, cases=(jnp.ones(2), jnp.ones(3))),
            "common leading axis",
        ),
        (lambda: Firmness(pivoted_with_tip, measure="force"), "measure must be"),
        (lambda: Fair(Margin), "goal must be a goal"),
        (lambda: Fair(Margin(), weight=-1.0), "weight must be"),
        (lambda: value_and_grad(jnp.sum, "sideways"), "mode must be"),
        (lambda: value_and_grad(lambda: 0.0), "function must be a function of one argument, but was"),
    ],
)
def test_bad_goals(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()


def test_a_fair_contour_pays_for_changes_of_curvature_alone():
    r"""An ellipse (a cos u, b sin u): kappa = a b / v^3, v = ds/du, so that dkappa/ds = -3 a b v' / v^5."""
    goal, fair = Margin(), Fair(Margin(), weight=0.5)
    unit, sharpness = jnp.asarray(0.02), jnp.asarray(1.0)

    @eqx.filter_jit
    def extra(tip):
        seen = sampled(tip, jnp.array([-1e-3, 1e-3]))
        return fair.cost(tip, seen, unit, sharpness) - goal.cost(tip, seen, unit, sharpness)

    assert abs(extra(jxr.Circle(0.015))) < 1e-14
    a, b = 0.02, 0.018
    u = np.linspace(0.0, 2.0 * np.pi, 4001)
    v = np.hypot(a * np.sin(u), b * np.cos(u))
    slopes = -3.0 * a * b * (a * a - b * b) * np.sin(u) * np.cos(u) / v**6
    mean = np.trapezoid(slopes**2 * v, u) / np.trapezoid(v, u)
    # The samples are 257: differences err by the square of their distance.
    assert float(extra(jxr.Ellipse(a, b))) == pytest.approx(0.5 * 0.02**4 * mean, rel=1e-3)
    assert fair.merit == goal.merit and not fair.in_turn


def test_margin_is_the_default_goal(monkeypatch):
    """All that a search is given is the same."""
    asked = []
    monkeypatch.setattr(_fingertip, "minimise", lambda *args, **rest: asked.append((args, rest)))
    monkeypatch.setattr(_fingertip, "_design", lambda *args: None)
    options = {"limits": within(length=0.1, radius=0.004), "steps": 10}
    for given in ({}, {"goal": Margin()}, {"goal": Fair(Margin())}):
        optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, **given, **options)
    assert type(asked[0][0][0].goal) is Margin
    asked = jax.tree.map(lambda x: np.asarray(x) if eqx.is_array(x) else x, asked)
    assert eqx.tree_equal(asked[0], asked[1]) and not eqx.tree_equal(asked[0], asked[2])


def few_states(run, ts, y, reached):
    """A run of a few saved states at odd times, of which so many were reached, and a signal along it."""
    ts, y = jnp.asarray(ts), jnp.asarray(y)
    states = jax.tree.map(lambda a: jnp.zeros((len(ts), *a.shape[1:])), run.states)
    q = jnp.where(jnp.arange(len(ts))[:, None] < reached, states.q, jnp.nan)
    run = eqx.tree_at(lambda r: (r.ts, r.states), run, (ts, states))
    return eqx.tree_at(lambda r: r.states.q, run, q), y


@jax.jit
def measured(run, y, band):
    """The measures of the part that was reached, and those of a run that reached its end."""
    of_part = PARTIAL["settling_time"](run, y, band), PARTIAL["overshoot"](run, y)
    whole = settling_time(run, signal=y, band=band), overshoot(run, signal=y), tracking_error(run, signal=y)
    return (*of_part, PARTIAL["tracking_error"](run, y)), whole


@pytest.mark.parametrize("reached", [5, 7])
def test_measures_of_a_few_states_by_hand(run, reached):
    """Along (0.6, -0.8) from the last value: 10, 4, -3 and 0.1, of which the rest may not be known."""
    away = np.array([10.0, 4.0, -3.0, 0.1, 0.0, 0.0, 0.0])
    y = np.array([1.0, 2.0]) + away[:, None] * [0.6, -0.8]
    y[reached:] = 77.0
    some, y = few_states(run, [1.0, 1.5, 2.5, 3.0, 5.0, 6.0, 7.0], y, reached)
    area = 0.5 * 7.0 + 1.0 * 3.5 + 0.5 * 1.55 + 2.0 * 0.05
    # From 3 to 0.1 in half a second: below one at 2 / 2.9 of that. From 4 to 3 in one: below 3.5 in a half.
    for band, settled in ((0.1, 1.5 + 0.5 * 2.0 / 2.9), (0.35, 1.0)):
        for found in measured(some, y, band):
            np.testing.assert_allclose(found, [settled, 0.3, area / 10.0], rtol=1e-12)


def test_a_signal_may_leave_its_band_with_the_last_state_but_one(run):
    y = np.array([1.0, 2.0]) + np.array([8.0, 3.0, 0.0, 5.0, 6.0, 7.0, 8.0])[:, None] * [0.6, -0.8]
    some, y = few_states(run, [0.0, 1.0, 3.0, 4.0, 5.0, 6.0, 7.0], y, 3)
    for band, settled in ((0.25, 1.0 + 2.0 / 3.0), (0.375, 1.0), (0.02, 1.0 + 2.0 * 2.84 / 3.0)):
        (found, *_), _ = measured(some, y, band)
        assert float(found) == pytest.approx(settled, rel=1e-12)


def test_what_is_asked_of_runs_for_each_measure():
    assert set(MEASURES) == set(PARTIAL) == SETTLED | FORCED and not SETTLED & FORCED
    assert {"settling_time", "overshoot", "tracking_error"} == SETTLED


@pytest.mark.parametrize("floor", [0.0, 2.0, 30.0])
def test_stiffnesses_stay_finite_where_flat_meets_flat(monkeypatch, floor):
    r"""With a floor, one over the turning becomes $r / (r^2 + f^2)$."""
    hessian, turning = np.array([[700.0, 90.0], [90.0, -300.0]]), np.array([50.0, -20.0])
    rest, asked = types.SimpleNamespace(hessian=jnp.asarray(hessian), turning=jnp.asarray(turning)), []

    def pinched(grasp, state, damping):
        asked.append(damping)
        return None, rest

    monkeypatch.setattr(_firmness, "pinch_rest", pinched)
    inverse = turning / (turning**2 + floor**2)
    wanted = np.linalg.eigvalsh(hessian * np.outer(inverse, inverse))
    np.testing.assert_allclose(_firmness._stiffnesses(None, None, floor), wanted, rtol=1e-12)
    assert asked == [0.01]  # of the Hessian's size, below which the derivative is damped


def test_a_search_for_firmness_has_a_floor_of_two_radians_per_metre(monkeypatch):
    asked = []
    monkeypatch.setattr(Firmness, "values", lambda goal, tip, floor=0.0: asked.append(floor) or jnp.ones(1))
    monkeypatch.setattr(_firmness, "worst_margin", lambda seen: jnp.zeros(()))
    goal = Firmness(on_plate, scale=1.0)
    goal.cost(jxr.Circle(0.01), None, 1.0, 1.0)
    goal.figures(jxr.Circle(0.01), None)
    assert asked == [2.0, 0.0]


@pytest.mark.parametrize("sharpness", [1.0, 0.05])
def test_the_smooth_worst_of_some_costs(sharpness):
    """Above the largest by the logarithm of how many come near it, within a fiftieth of the largest size."""

    def bound(costs):
        size = np.abs(costs).max() / (50.0 * sharpness)
        return size * np.log(np.sum(np.exp(costs / size)))

    both = jax.jit(jax.value_and_grad(_goals.soft_worst))
    for costs in (np.array([0.3, -4.0, 0.25]), np.array([-2.0, -2.1, -2.11]), np.array([5.0, 5.01, 4.9])):
        found, slope = both(costs, sharpness)
        assert float(found) == pytest.approx(bound(costs), rel=1e-9) and found >= costs.max()
        ends = [[bound(costs + side * 1e-6 * way) for way in np.eye(3)] for side in (1, -1)]
        np.testing.assert_allclose(slope, (np.array(ends[0]) - ends[1]) / 2e-6, rtol=1e-7, atol=1e-8)


def test_the_cost_of_a_margin_is_its_smooth_least_by_the_size():
    """Of a circle about (1, 2) mm of 10 mm the margin is minus the part of that along the normal."""
    tip, unit, sharpness = jxr.Circle(0.01).moved((0.001, 0.002)), 0.02, 0.3

    @jax.jit
    def told(interval):
        seen = sampled(tip, interval)
        return seen, Margin().cost(tip, seen, unit, sharpness), Margin().figures(tip, seen)

    seen, cost, figures = told(np.array([-0.004, 0.009]))
    angle = np.linspace(-0.4, 0.9, 65)
    margins = -(0.001 * np.cos(angle) + 0.002 * np.sin(angle))
    k = 200.0 * sharpness
    wanted = np.log(np.sum(np.exp(-k * margins / unit))) / k
    assert float(cost) == pytest.approx(wanted, rel=1e-9)
    assert figures == {"worst margin [m]": pytest.approx(margins.min(), rel=1e-9)}
    assert not Margin().reached(figures) and Margin().reached({"worst margin [m]": 1e-9})
    assert not Margin().reached({"worst margin [m]": 0.0}) and Margin().aimed(tip) is not None
    # A quarter of the way round from end to end.
    np.testing.assert_allclose(np.stack([*seen.whole.point])[:, 64], [0.001, 0.012], atol=1e-12)
    np.testing.assert_allclose([seen.step, seen.length], [2e-2 * np.pi / 256, 2e-2 * np.pi], rtol=1e-12)


def test_cases_have_a_leading_axis_also_where_there_are_none(monkeypatch):
    monkeypatch.setattr(_goals, "as_grasp_and_state", lambda given: given)
    found = lambda grasp, state: {"sum": grasp + 10.0 * state}  # noqa: E731
    alone = _goals.each_case(lambda tip: (tip, 2.0), None, jnp.asarray(1.0), found)
    np.testing.assert_array_equal(alone["sum"], [21.0])
    for in_turn in (False, True):
        made = lambda tip, case: (tip, case)  # noqa: E731
        several = _goals.each_case(made, jnp.array([2.0, 3.0]), jnp.asarray(1.0), found, in_turn=in_turn)
        np.testing.assert_array_equal(several["sum"], [21.0, 31.0])


@pytest.mark.parametrize("given", [None, 3, (1, 2), [1], ()])
def test_a_make_returns_a_grasp_and_a_state(given, scene):
    with pytest.raises(ValueError, match="argument make must return a Grasp and a State"):
        as_grasp_and_state(given)
    with pytest.raises(ValueError, match="argument make must return a Grasp and a State"):
        as_grasp_and_state(tuple(reversed(scene)))
    assert as_grasp_and_state(list(scene)) == scene


def test_the_figures_of_closed_loops_are_the_worst_of_all_cases(monkeypatch):
    """By name of the measure; the cost with its weights, what was lost and an objective of one's own."""
    measured = jnp.array([[1.0, 20.0, 3.0, 4.0, 0.5], [2.0, 10.0, 1.0, 8.0, 0.25]])
    lost = jnp.array([0.0, 0.0])
    monkeypatch.setattr(_closed_loop_goal, "worst_margin", lambda seen: jnp.asarray(0.125))
    monkeypatch.setattr(ClosedLoop, "run", lambda goal, tip, names: (measured, jnp.array([0.5, 0.25]), lost))
    goal = ClosedLoop(pivoted_with_tip, {"settling_time": 2.0, "peak_force": 0.5})
    found = goal.figures(None, None)
    assert {name: float(value) for name, value in found.items()} == {
        "worst cost": 4.0 + 4.0 + 0.25,
        "runs that end early": 0.0,
        "settling time [s]": 2.0,
        "overshoot": 20.0,
        "tracking error [s]": 3.0,
        "peak force [N]": 8.0,
        "friction demand": 0.5,
        "worst margin [m]": 0.125,
    }
    lost = jnp.array([0.5, 0.0])
    assert float(goal.figures(None, None)["worst cost"]) == 2.0 + 2.0 + 0.5 + 5.0
    assert int(goal.figures(None, None)["runs that end early"]) == 1
    assert float(goal.figures(None, None)["peak force [N]"]) == 8.0
    # A run that ended where it began has no force to report; zero is no demand of friction.
    lost = jnp.array([1.0, 0.0])
    found = goal.figures(None, None)
    assert np.isnan(found["peak force [N]"]) and np.isnan(found["friction demand"])


def test_a_run_that_never_began_has_lost_all_of_its_time(monkeypatch, scene):
    """However far its clock says; an objective of one's own that is no number counts as zero there alone."""
    short = runs.run("pinch", ended="slipping")
    unreachable = eqx.tree_at(lambda r: r.result, short, jxr.RESULTS.unreachable)
    whole = runs.run("pinch")
    monkeypatch.setattr(
        _closed_loop_goal, "each_case", lambda make, cases, tip, found, in_turn: found(None, None)
    )
    given = []
    monkeypatch.setattr(_closed_loop_goal, "simulate", lambda *args, **options: given[-1])
    goal = ClosedLoop(pivoted_with_tip, lambda grasp, run: jnp.nan * run.ts[0], t1=0.6, ts=13)
    for run, wanted in ((unreachable, 1.0), (short, 1.0 - float(short.stats.t_end) / 0.6)):
        given.append(run)
        measured, own, lost = goal.run(None, ())
        assert measured.shape == (0,) and float(own) == 0.0 and float(lost) == pytest.approx(wanted)
    given.append(whole)
    assert np.isnan(goal.run(None, ())[1]) and float(goal.run(None, ())[2]) == 0.0
    # Where a program closes over a goal, XLA divides by its `t1` by the inverse, with another rounding.
    goal = ClosedLoop(pivoted_with_tip, {"peak_force": 1.0}, t1=0.72, ts=13)

    @jax.jit
    def lost_by(t):
        given.append(eqx.tree_at(lambda r: r.stats.t_end, whole, t))
        return goal.run(None, ())[2]

    assert float(lost_by(goal.t1)) == 0.0 and float(lost_by(0.36)) == pytest.approx(0.5)
    # What is lost is a share of the time that was asked for, wherever the clock begins.
    goal = ClosedLoop(pivoted_with_tip, {"peak_force": 1.0}, t0=5.0, t1=6.0, ts=13)
    for end, wanted in ((5.0, 1.0), (5.25, 0.75), (6.0, 0.0)):
        given.append(eqx.tree_at(lambda r: r.stats.t_end, whole, jnp.asarray(end)))
        assert float(goal.run(None, ())[2]) == pytest.approx(wanted)


def test_an_objective_without_a_value_hides_no_gradient(monkeypatch):
    """The largest of some angles, some of them NaN, has a derivative of NaN: the time lost has its own."""
    short = runs.run("pinch", ended="slipping")
    monkeypatch.setattr(
        _closed_loop_goal, "each_case", lambda make, cases, tip, found, in_turn: found(tip, None)
    )
    moving = lambda r: (r.states.q, r.stats.t_end)  # noqa: E731

    def simulated(size, *args, **options):
        # As in a run, what was not reached is NaN and does not move.
        parts = (jnp.where(jnp.isnan(x), x, size * jnp.nan_to_num(x)) for x in moving(short))
        return eqx.tree_at(moving, short, tuple(parts))

    monkeypatch.setattr(_closed_loop_goal, "simulate", simulated)
    goal = ClosedLoop(pivoted_with_tip, lambda grasp, run: jnp.max(run.states.q[:, 0]), t1=0.6, ts=13)
    wanted = -_closed_loop_goal._LOST * float(short.stats.t_end) / 0.6
    both = jax.jit(lambda size: [derivative(goal._costs)(size) for derivative in (jax.grad, jax.jacfwd)])
    assert [float(slope) for slope in both(1.0)] == pytest.approx([wanted] * 2)


def test_a_measure_is_one_program(caplog):
    """By themselves its small operations would be dozens, of 10 ms each."""
    run = runs.run("pivoted", times=17)  # of a shape that no other test measures
    with jax.log_compiles():
        for name in ("settling_time", "overshoot", "tracking_error", "peak_force"):
            MEASURES[name][0](run)
    # A number of Python's that was not met before, such as a band, is one more.
    assert 4 <= len([name for name in programs(caplog) if name != "jit(stage)"]) <= 5


class Bend(jxr.design.AbstractGoal):
    """A goal of a caller's own: the curvature in front."""

    merit = "bend [1/m]"

    def cost(self, tip, seen, unit, sharpness):
        return (tip.frame(0.0).curvature * unit - 1.0) ** 2

    def figures(self, tip, seen):
        return {"bend [1/m]": tip.frame(0.0).curvature}

    def reached(self, figures):
        return figures["bend [1/m]"] < 1e3


@pytest.mark.parametrize(
    ("member", "value", "words"),
    [
        ("cost", lambda *given: None, "goal, in what `cost` returns, must be a real number"),
        (
            "cost",
            lambda *given: jnp.ones(2),
            r"goal must have a `cost` of one number, but it had shape \(2,\)",
        ),
        ("cost", lambda self, tip, seen, unit, sharpness: np.sin(unit), "goal must compute with jax.numpy"),
        ("figures", lambda *given: [1.0], "goal must have `figures` that are a dict with its `merit`"),
        ("figures", lambda *given: {"a": 1.0}, "goal must have `figures` that are a dict with its `merit`"),
        ("figures", lambda *given: {"bend [1/m]": "a"}, "goal, in its figure 'bend .*must be a real number"),
        (
            "figures",
            lambda *given: {"bend [1/m]": jnp.ones(3)},
            "goal must have `figures` of one number each",
        ),
        ("reached", lambda *given: None, "goal must have `reached` that is True or False, but it was None"),
        ("reached", lambda *given: 0.3, "goal must have `reached` that is True or False, but it was 0.3"),
        ("aimed", lambda *given: None, "goal(.aimed, in what it returns,)? must be a goal, but was None"),
    ],
)
@pytest.mark.parametrize("inside", [False, True])
def test_answers_of_own_goals_that_are_none_are_refused_before_a_search(member, value, words, inside):
    goal = type("Odd", (Bend,), {member: value})()
    goal = Fair(goal) if inside else goal
    with pytest.raises(ValueError, match=f"^argument {words}"):
        jxr.design.optimise_fingertip(jxr.Ellipse(0.018, 0.009), (-0.002, 0.002), goal=goal, steps=10)


def test_a_search_sees_what_its_goal_holds_now():
    """The list from which a goal has its target: a blunter fingertip is found where it asks for one."""
    target = [1.0]

    class Aimed(Bend):
        def cost(self, tip, seen, unit, sharpness):
            return (tip.frame(0.0).curvature * unit - target[0]) ** 2

    start, limits = jxr.Circle(0.012), jxr.design.Limits(radius=0.001, flat=None)
    settings = {"goal": Aimed(), "limits": limits, "steps": 10}
    bends = []
    for target[0] in (3.0, 1.5):
        found = jxr.design.optimise_fingertip(start, (-0.002, 0.002), **settings)
        bends.append(found.figures["bend [1/m]"][1])
    np.testing.assert_allclose(bends[0] / bends[1], 2.0, rtol=0.05)
