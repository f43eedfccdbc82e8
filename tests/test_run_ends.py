"""What a run is made of and leaves, piece by piece: its vector, controls, balance, delays, rows."""

import math
from types import SimpleNamespace

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

import jaxroll as jxr
from jaxroll._integration import _methods, _simulate, _trajectory
from jaxroll._integration._derivative import _Steps, moving_as, moving_if_successful, moving_in_time
from jaxroll._integration._run import Record
from jaxroll._integration._state_vector import Layout, pack, states_of, unpack, vector_of
from jaxroll._integration._step import RollingStep, sample_times
from jaxroll._mechanics import Form, State
from jaxroll._motion import _quantities
from tests.subjects.disc_on_a_hill import disc_on_a_hill
from tests.subjects.driven_plate import driven_plate

NAN, INF = math.nan, math.inf
PLACES = jax.tree.structure(((0.0, 0.0), 0.0))


def formed(*, memory=0, sampled=False, audited=False):
    """The layout of an object with three positions and two velocities, and a finger with two."""
    form = Form((3, 2), (2, 2), PLACES, memory, sampled)
    return Layout(form, audited, 5 + 4 + 3 + memory + int(audited))


def test_everything_has_its_place_in_the_vector():
    lay = formed(memory=2, audited=True)
    x = np.arange(15.0)
    leaves, work = jax.jit(lambda y: unpack(lay, y))(np.concatenate([x, 9.0 + x]))
    plain = lambda tree: [float(leaf) for leaf in jax.tree.leaves(tree)]  # noqa: E731
    assert [plain(part) for part in leaves.q] == [[0, 1, 2], [3, 4]]
    assert [plain(part) for part in leaves.v] == [[5, 6], [7, 8]]
    assert [plain(part) for part in leaves.s] == [[9, 10], [11]]
    assert plain(leaves.memory) == [12, 13] and float(work) == 14
    np.testing.assert_array_equal(pack(leaves, work), x)
    np.testing.assert_array_equal(pack(leaves, None), x[:-1])
    assert unpack(formed(), x)[1] is None
    assert lay.margin == 30 and lay.due == 13
    rows = np.stack([x, x + 100.0])
    states = states_of(lay, rows)
    for name, part in (
        ("q", slice(0, 5)),
        ("v", slice(5, 9)),
        ("s", slice(9, 12)),
        ("memory", slice(12, 14)),
    ):
        np.testing.assert_array_equal(getattr(states, name), rows[:, part])
    assert states_of(formed(), x).memory is None
    begun = vector_of(lay, State(x[:5], x[5:9], x[9:12], x[12:14]))
    np.testing.assert_array_equal(begun, [*range(14), *18 * [0.0]])
    bare = vector_of(formed(), State(x[:5], x[5:9], x[9:12]))
    np.testing.assert_array_equal(bare, [*range(12), *14 * [0.0]])


def test_error_control_looks_at_what_is_integrated_by_itself():
    seen = lambda lay: np.asarray(lay.controlled(np.arange(lay.width + 3.0))).tolist()  # noqa: E731
    moving = list(range(9))
    assert seen(formed()) == moving
    assert seen(formed(audited=True)) == [*moving, 12]
    assert seen(formed(memory=2)) == [*moving, 12, 13]
    assert seen(formed(memory=2, audited=True)) == [*moving, 12, 13, 14]
    assert seen(formed(memory=2, sampled=True)) == moving
    assert seen(formed(memory=2, sampled=True, audited=True)) == [*moving, 14]
    error = np.random.default_rng(1).normal(size=15)
    norm = jax.jit(_simulate._Norm(formed(memory=2, audited=True)))(error)
    wanted = np.sqrt(np.mean(np.square(np.array(error)[[*moving, 12, 13, 14]])))
    np.testing.assert_allclose(norm, wanted, rtol=1e-14)


def test_steps_of_one_length_are_taken_unless_their_error_is_not_finite():
    steady = _methods.Steady()
    first, length = steady.init(None, 1.0, 9.0, None, 0.25, None, None, 5)
    assert (first, length) == (1.25, 0.25) and steady.wrap(1) is steady
    for error, fine in (
        ([0.0, 1e9], True),
        ([INF, 0.0], False),
        ([0.0, NAN], False),
        ([0.0, 0.0, -INF], False),
    ):
        answer = steady.adapt_step_size(1.0, 1.5, None, None, None, jnp.array(error), 5, length)
        keep, start, end, jumped, memory, code = answer
        assert (bool(keep), start, end, jumped, memory) == (fine, 1.5, 1.75, False, 0.25)
        wanted = diffrax.RESULTS.successful if fine else diffrax.RESULTS.nonlinear_divergence
        assert int(code._value) == int(wanted._value)


class Asked(diffrax.AbstractStepSizeController):
    """A control that says what it was given."""

    way: int = 0

    def wrap(self, direction):
        return Asked(direction)

    def init(self, *given):
        return given

    def adapt_step_size(self, *given):
        return given


def test_a_callers_control_sees_positions_velocities_and_work():
    lay = formed(audited=True)
    seeing, x = _methods.Seeing(Asked(), lay).wrap(-1), jnp.arange(26.0)
    assert seeing.inner.way == -1 and seeing.lay is lay
    controlled = [*range(9), 12]
    terms, t0, t1, y0, *rest = seeing.init("terms", 0.0, 1.0, x, 0.1, "args", "func", 5)
    assert (terms, t0, t1, *rest) == ("terms", 0.0, 1.0, 0.1, "args", "func", 5) and y0.tolist() == controlled
    t0, t1, before, after, args, error, *rest = seeing.adapt_step_size(
        0.0, 1.0, x, x + 1.0, "args", 2.0 * x, 5, "m"
    )
    assert (t0, t1, args, *rest) == (0.0, 1.0, "args", 5, "m")
    for found, wanted in ((before, 0.0), (after, 1.0)):
        np.testing.assert_array_equal(found, np.array(controlled) + wanted)
    np.testing.assert_array_equal(error, 2.0 * np.array(controlled))


class Slow(diffrax.Tsit5):
    """A method with a step of its own."""

    def step(self, *given):
        return super().step(*given)


class Orderless(diffrax.Tsit5):
    def error_order(self, terms):
        return None


class Drawn(jxr.Rosenbrock):
    def step(self, *given):
        return super().step(*given)


def test_methods_are_told_apart_by_class_and_step():
    explicit = [diffrax.Tsit5(), diffrax.Dopri8(), Orderless()]
    others = [Slow(), diffrax.HalfSolver(diffrax.Tsit5()), diffrax.Kvaerno3(), jxr.Rosenbrock()]
    assert [_methods.on_tableau(m) for m in explicit + others] == 3 * [True] + 4 * [False]
    assert [_methods.is_rosenbrock(m) for m in (jxr.Rosenbrock(), Drawn(), diffrax.Tsit5())] == [
        True,
        False,
        False,
    ]


def test_tolerances_go_to_root_finders_that_have_none():
    found = _methods.with_tolerances(diffrax.Kvaerno3(), 1e-5, 1e-7).root_finder
    assert (found.rtol, found.atol, found.norm) == (1e-5, 1e-7, optimistix.max_norm)
    half = _methods.with_tolerances(diffrax.HalfSolver(diffrax.Kvaerno3()), 1e-5, 1e-7)
    assert half.solver.root_finder.rtol == 1e-5
    own = diffrax.Kvaerno3(root_finder=diffrax.VeryChord(rtol=1e-3, atol=1e-4))
    kept = _methods.with_tolerances(own, 1e-5, 1e-7).root_finder
    assert (kept.rtol, kept.atol) == (1e-3, 1e-4)
    plain = diffrax.Tsit5()
    assert _methods.with_tolerances(plain, 1e-5, 1e-7) is plain
    assert _methods.without_checkpoints(plain).scan_kind == "lax"
    assert _methods.without_checkpoints(diffrax.HalfSolver(plain)).solver.scan_kind == "lax"
    bounded = diffrax.Tsit5(scan_kind="bounded")
    assert _methods.without_checkpoints(bounded) is bounded


def test_methods_that_will_not_do_say_why():
    x, adaptive, steady = jnp.zeros(3), diffrax.PIDController(rtol=1e-6, atol=1e-6), _methods.Steady()
    implicit = _methods.with_tolerances(diffrax.Kvaerno3(), 1e-6, 1e-6)
    for good in (diffrax.Tsit5(), implicit, jxr.Rosenbrock(), diffrax.HalfSolver(diffrax.Euler())):
        _methods.check_method(good, adaptive, x)
    _methods.check_method(diffrax.Euler(), steady, x)
    _methods.check_method(Orderless(), steady, x)
    refused = [
        (diffrax.Euler(), "estimate its error, as diffrax.HalfSolver makes any method do"),
        (Orderless(), "say of what order its error estimate is"),
        (diffrax.KenCarp3(), "take one ordinary differential equation, neither split"),
        (diffrax.LeapfrogMidpoint(), "remember nothing of earlier steps"),
    ]
    for bad, told in refused:
        with pytest.raises(ValueError, match=f"argument solver must {told}"):
            _methods.check_method(bad, adaptive, x)


def test_a_field_and_a_control_choose_the_plan():
    lay = formed()
    stepper = RollingStep(diffrax.Dopri8(), None, lay, ("lift",), 2)
    given = _simulate.Numbers(*map(jnp.asarray, (0.5, 2.0, jnp.array([1.0, 2.0]), 0.125, 1e-6, 1e-9)))
    setup = _simulate.Setup(diffrax.Tsit5(), None, None, 99, ("dense",), ("lift",), 2)
    y0 = jnp.zeros(2 * lay.width + 2)
    plan = _simulate._plan(stepper, y0, given, setup, jumps=None)
    assert isinstance(plan.controller, diffrax.PIDController) and plan.controller.norm.lay is lay
    assert (plan.controller.rtol, plan.controller.atol) == (1e-6, 1e-9) and plan.controller.dtmin is None
    assert (plan.max_steps, plan.dense, plan.jumps) == (99, True, None)
    assert [float(x) for x in (plan.t0, plan.t1, plan.dt0)] == [0.5, 2.0, 0.125] and plan.ts.tolist() == [
        1.0,
        2.0,
    ]
    assert isinstance(plan.progress, diffrax.NoProgressMeter) and isinstance(
        plan.stepper.method, diffrax.Tsit5
    )
    assert (plan.stepper.sweeps, plan.stepper.events, plan.stepper.lay) == (2, ("lift",), lay)
    steady = _simulate._plan(
        stepper, y0, given, setup._replace(controller=diffrax.ConstantStepSize(), record=()), jumps=None
    )
    assert isinstance(steady.controller, _methods.Steady) and not steady.dense and float(steady.dt0) == 0.125
    own = diffrax.PIDController(rtol=1e-3, atol=1e-4, dtmax=0.0625)
    seeing = _simulate._plan(stepper, y0, given, setup._replace(controller=own), jumps=given.ts)
    assert isinstance(seeing.controller, _methods.Seeing) and seeing.jumps is given.ts
    assert float(seeing.dt0) == 0.0625


def test_a_state_of_less_precision_than_its_grasp_is_refused(scene):
    grasp, state = scene
    single = jax.tree.map(lambda x: x.astype(np.float32), state)
    with pytest.raises(ValueError, match="argument state must be of its grasp's float64, but was of float32"):
        _simulate.check_precision(grasp, single)
    _simulate.check_precision(grasp, state)
    _simulate.check_precision(jax.tree.map(lambda x: x.astype(np.float32), grasp), state)


def test_the_balance_is_what_energy_and_work_leave_since_the_start():
    kinetic, potential, work = np.array([[1.0, 3.0, 2.0], [0.5, 0.25, 4.0], [0.0, 1.5, 6.0]])
    # The energies begin with those of the start, which is no saved state.
    begin = np.array([[0.75], [0.125]])
    energies = jnp.asarray(np.concatenate([begin, [kinetic, potential]], axis=1))
    found = _simulate._balance((energies[0], energies[1]), jnp.asarray(work))
    np.testing.assert_allclose(found.residual, [0.625, 0.875, -0.875])
    for part, wanted in ((found.kinetic, kinetic), (found.potential, potential), (found.work, work)):
        np.testing.assert_array_equal(part, wanted)


def test_the_worst_residual_counts_every_row_with_either_sign():
    parts = np.zeros((3, 4, 2))
    for i, size in enumerate((0.3, -0.5, 0.4)):
        parts[i, i, i % 2] = size
    found = _quantities.worst(_quantities.Residuals(*map(jnp.asarray, parts)))
    np.testing.assert_array_equal(found, [0.3, 0.5, 0.4, 0.0])
    assert _quantities.closed_within(np.float64) == 1e-9 and _quantities.closed_within(np.float32) == 1e-5


def test_half_the_square_of_velocities_in_a_mass_matrix():
    matrix = np.array([[2.0, 0.3, -0.4], [0.3, 1.5, 0.7], [-0.4, 0.7, 3.0]])
    v, rows = np.array([0.5, -1.0, 2.0]), [matrix[i, : i + 1] for i in range(3)]
    np.testing.assert_allclose(_quantities._quadratic(rows, v), 0.5 * v @ matrix @ v, rtol=1e-15)
    both = [SimpleNamespace(mass=rows), SimpleNamespace(mass=[[4.0]])]
    np.testing.assert_allclose(_quantities._kinetic_energy(both, (v, (3.0,))), 0.5 * v @ matrix @ v + 18.0)


def test_times_are_one_for_every_state():
    states = State(jnp.zeros((2, 3)), jnp.zeros((2, 3)), jnp.zeros((2, 1)))
    assert _quantities.as_times([0, 1], states).tolist() == [0.0, 1.0]
    with pytest.raises(ValueError, match=r"argument ts must have shape \(2,\), as states have, but had \(\)"):
        _quantities.as_times(0.0, states)


def test_what_a_run_did_not_reach_is_not_a_number_and_has_no_part_in_derivatives():
    rows = State(jnp.array([[4.0, 1.0], [NAN, NAN]]), jnp.array([[9.0], [NAN]]), jnp.array([[1.0], [NAN]]))
    start = State(jnp.array([1.0, 1.0]), jnp.array([1.0]), jnp.array([1.0]))

    roots = lambda scale: _quantities.of_reached(lambda x: jnp.sqrt(scale * x.q) * x.v, rows, start)  # noqa: E731
    summed = lambda scale: (jnp.nansum(found := roots(scale)), found)  # noqa: E731
    (_, found), slope = jax.jit(jax.value_and_grad(summed, has_aux=True))(4.0)
    np.testing.assert_allclose(found, [[36.0, 18.0], [NAN, NAN]], equal_nan=True)
    np.testing.assert_allclose(slope, 54.0 / 8.0)


def steps_of(ts, ys, *, saves=(), jumps=None, margin=2):
    """Recorded steps, as far as delays and save times are asked of them."""
    lay = SimpleNamespace(margin=margin, width=1, form=SimpleNamespace(sampled=False))
    plan = SimpleNamespace(stepper=SimpleNamespace(lay=lay), ts=jnp.asarray(saves), jumps=jumps, dense=False)
    record = Record(
        jnp.asarray(np.array([*ts, INF, INF])), jnp.asarray(np.array([*ys, [0.0] * 4, [0.0] * 4]))
    )
    return _Steps(None, None, plan, None, record, jnp.asarray(len(ts) - 1))


ROWS = [[1.0, 5.0, 0.5, -4.0], [2.0, 6.0, 0.25, -4.0], [3.0, 7.0, -1e-17, 20.0]]


def test_steps_span_their_records_and_save_times_end_them():
    steps = steps_of([0.5, 0.75, 1.5], ROWS, saves=[0.5, 0.75, 1.5, 2.0])
    spans = [tuple(float(t) for t in steps.span(jnp.asarray(k))) for k in range(3)]
    assert spans == [(0.5, 0.75), (0.75, 1.5), (1.5, 1.5)]
    index, reached = steps.saved_at()
    assert index.tolist() == [0, 1, 2, 2] and reached.tolist() == [True, True, True, False]
    np.testing.assert_array_equal(steps.passing, [7.0, 0.0, 0.0, 0.0])
    assert steps.margin == 2


def test_an_event_is_delayed_by_its_margin_over_the_drift_of_it():
    of = lambda steps, drift: float(steps.postponed(jnp.asarray(drift), jnp.asarray(3.0)))  # noqa: E731
    ended, whole = steps_of([0.5, 0.75, 1.5], ROWS), steps_of([0.5, 0.75], ROWS[:2])
    assert of(ended, -2.0) == 1.5 and of(ended, 4.0) == -0.75
    assert of(ended, 0.0) == of(ended, NAN) == of(ended, INF) == 0.0
    assert of(whole, -2.0) == 0.0
    at_jump = steps_of([0.5, 1.5 - 4 * np.finfo(float).eps, 1.5], ROWS, jumps=jnp.array([1.5]))
    assert of(at_jump, -2.0) == 0.0
    assert of(steps_of([0.5, 0.75, 1.5], ROWS, jumps=jnp.array([1.5])), -2.0) == 1.5


def test_what_is_saved_moves_with_its_time_at_the_slope_that_it_carries():
    ys = jnp.array([[1.0, 2.0, 5.0, 6.0, 0.5, -4.0], [3.0, 4.0, 7.0, 8.0, 0.5, -4.0]])
    found, moved = jax.jvp(
        lambda ts: moving_in_time(2, ys, ts), (jnp.array([0.1, 0.2]),), (jnp.array([2.0, 3.0]),)
    )
    np.testing.assert_array_equal(found, ys)
    np.testing.assert_array_equal(moved, [[10.0, 12.0, 0, 0, 0, 0], [21.0, 24.0, 0, 0, 0, 0]])
    _, moved = jax.jvp(lambda ys: moving_in_time(2, ys, jnp.zeros(2)), (ys,), (0.5 * ys,))
    np.testing.assert_array_equal(moved, 0.5 * ys)
    found, moved = jax.jvp(lambda t: moving_as(jnp.asarray(7.0), t), (1.0,), (3.0,))
    assert (float(found), float(moved)) == (7.0, 3.0)
    for code, share in ((0, 1.0), (3, 0.0)):
        found, moved = jax.jvp(
            lambda t, code=code: moving_if_successful(t, jnp.asarray(code)), (2.0,), (3.0,)
        )
        assert (float(found), float(moved)) == (2.0, 3.0 * share)


def test_samples_are_asked_of_sampled_grasps_alone():
    assert sample_times(SimpleNamespace(sampled=True), 0.5) == (0.5,)
    assert sample_times(SimpleNamespace(sampled=False), 0.5) == ()


def trajectory(q, **more):
    """Lanes of runs with these positions, everything else in proportion."""
    q = np.asarray(q)
    states = State(q, 2.0 * q, 3.0 * q)
    column, first = q[..., :1], q[..., 0]
    left = _quantities.Residuals(*map(jnp.asarray, (column, 4.0 * column, 5.0 * column)))
    energy = _quantities.Energy(*(jnp.asarray(k * first) for k in (1.0, 2.0, 3.0, 4.0)))
    end = jax.tree.map(lambda x: jnp.asarray(np.full((*q.shape[:-2], x.shape[-1]), 9.0)), states)
    count = np.zeros(q.shape[:-2], int)
    stats = _trajectory.Stats(*map(jnp.asarray, (count, count, count, 1.0 + count, count, 0.5 + count)))
    codes = type(jxr.RESULTS.slipping)(jnp.asarray(count), jxr.RESULTS.slipping._enumeration)
    times = jnp.asarray(np.broadcast_to(np.arange(float(q.shape[-2])), q.shape[:-1]))
    return _trajectory.Trajectory(times, states, end, left, codes, stats, energy=energy, **more)


def test_rows_that_a_run_did_not_reach_are_filled():
    lanes = [[[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], [[1.0, 2.0], [3.0, 4.0], [NAN, NAN]], 3 * [[NAN, NAN]]]
    fill = eqx.filter_jit(lambda run: run.filled())
    full = fill(trajectory(lanes))
    np.testing.assert_array_equal(full.states.q[0], lanes[0])
    np.testing.assert_array_equal(full.states.v[1], [[2.0, 4.0], [6.0, 8.0], [9.0, 9.0]])
    np.testing.assert_array_equal(full.states.s[2], 3 * [[9.0, 9.0]])
    np.testing.assert_array_equal(
        full.energy.residual, [[4.0, 12.0, 20.0], [4.0, 12.0, 12.0], [0.0, 0.0, 0.0]]
    )
    np.testing.assert_array_equal(
        full.residuals.tangency[:, :, 0], [[5.0, 15.0, 25.0], [5.0, 15.0, 15.0], [0, 0, 0]]
    )
    there = [[True, True, True], [True, True, False], [False, False, False]]
    assert trajectory(lanes).reached.tolist() == there
    assert jax.jit(lambda run: run.reached)(trajectory(lanes)).tolist() == there
    alone = fill(trajectory(lanes[1]))
    np.testing.assert_array_equal(alone.states.q, [[1.0, 2.0], [3.0, 4.0], [9.0, 9.0]])
    np.testing.assert_array_equal(alone.energy.work, [3.0, 9.0, 9.0])


def test_one_run_is_told_from_many_and_from_what_is_none():
    one, lanes = trajectory([[1.0, 2.0], [3.0, 4.0]]), trajectory([[[1.0, 2.0], [3.0, 4.0]]])
    _trajectory.check_one_run("run", one)
    assert repr(one) == "Trajectory(successful; 2 states)"
    assert repr(lanes).endswith("1 x 2 states)")
    none = jax.tree.map(lambda x: x[:0] if x.ndim else x, one)
    put = lambda where, value: eqx.tree_at(where, one, value)  # noqa: E731
    refused = [
        (3, "argument run must be a Trajectory, but was 3"),
        (lanes, "argument run must be one run, but its states have shape (1, 2, 2)"),
        (put(lambda r: r.ts, one.ts[:1]), "argument run must hold a state for each of its times"),
        (put(lambda r: r.states.s, one.states.s[:1]), "argument run must hold a state for each of its times"),
        (
            none,
            "argument run must hold a state for each of its times",
        ),
        (put(lambda r: r.states.v, 3.0), "argument run must hold real numbers as states.v, but had 3.0"),
        (put(lambda r: r.ts, np.arange(2)), "argument run must hold real numbers as ts, but had [0, 1]"),
        (put(lambda r: r.ts, one.ts[None]), "argument run must be one run"),
    ]
    for bad, told in refused:
        with pytest.raises(ValueError) as error:
            _trajectory.check_one_run("run", bad)
        assert str(error.value).startswith(told)
    with pytest.raises(ValueError, match="argument t must be given to a run that kept its steps"):
        one(0.5)


@pytest.fixture(scope="module")
def of_traced_times():
    """A run whose times are unknown until its program runs."""
    grasp, state = disc_on_a_hill()
    return jax.jit(lambda t0, t1, ts, dt0: jxr.simulate(grasp, state, t1, t0=t0, ts=ts, dt0=dt0, throw=False))


@pytest.mark.parametrize(
    "changed",
    [
        {"ts": [0.01, 0.02, 0.04]},
        {"ts": [0.04, 0.05, 0.06]},
        {"ts": [0.01, 0.03, 0.02]},
        {"ts": [-0.01, 0.01, 0.02]},
        {"ts": [0.01, np.nan, 0.02]},
        {"ts": [0.01, 0.02, np.inf]},
        {"t1": -0.03},
        {"t1": np.nan},
        {"t0": -np.inf},
        {"t0": np.nan},
        {"dt0": -1e-4},
        {"dt0": 0.0},
        {"dt0": np.inf},
    ],
    ids=str,
)
def test_times_that_only_a_program_sees_and_that_do_not_rise_are_no_run(of_traced_times, changed):
    """Known ones are refused; these were said to have collapsed the steps, with states beyond the end."""
    given = {"t0": 0.0, "t1": 0.03, "ts": [0.01, 0.02, 0.03], "dt0": 1e-4}
    asked = lambda given: of_traced_times(*map(np.asarray, given.values()))  # noqa: E731
    assert asked(given).result == jxr.RESULTS.successful
    run = asked(given | changed)
    assert run.result == jxr.RESULTS.unordered_times and int(run.stats.steps) <= 1
    np.testing.assert_array_equal(run.stats.t_end, (given | changed)["t0"])
    assert np.isnan(run.states.q).all() and np.isnan(run.last.q).all()


def test_one_lane_whose_times_do_not_rise_leaves_the_others_theirs(of_traced_times):
    t1, dt0 = np.array([0.03, -0.03]), np.array(1e-4)
    times = lambda t1: (np.zeros_like(t1), t1, np.linspace(t1 / 3.0, t1, 3, axis=-1), dt0)  # noqa: E731
    run = jax.vmap(of_traced_times, (0, 0, 0, None))(*times(t1))
    assert repr(run.result) == "[successful, unordered_times]"
    alone = of_traced_times(*times(t1[0]))
    np.testing.assert_allclose(run.states.q[0], alone.states.q, rtol=0, atol=1e-10)
    assert np.isnan(run.states.q[1]).all()


def test_a_limit_that_is_met_just_where_a_run_ends_or_saves_uses_up_no_steps():
    """A run to the end of another: all tries within 1e-10 s of its end went to that end, past the limit."""
    grasp, state = driven_plate()
    falling = grasp.with_(force=jxr.commands.Ramps([0.0, 0.2], [0.5, -0.3]), damping=2e-3)

    @jax.jit
    @jax.vmap
    def run(t1, more):
        ts = jnp.stack([t1, t1 + more])
        run = jxr.simulate(falling, state, ts[1], ts=ts, throw=False)
        return run.result._value, run.stats.steps, run.stats.t_end

    beyond = np.concatenate([[0.0], np.geomspace(1e-15, 1e-9, 40)])
    asked = lambda t1, more: map(np.asarray, run(t1, np.full(beyond.size, more)))  # noqa: E731
    code = int(jxr.RESULTS.contact_lost._value)
    codes, _, ends = asked(np.full(beyond.size, 1.0), 0.01)
    assert np.all(codes == code) and np.ptp(ends) == 0.0 and 0.0 < ends[0] < 0.2
    whole = ends[0]
    for more in (1e-12, 0.01):  # at the end of the run, at a save time within it
        codes, steps, ends = asked(whole + beyond, more)
        lost = codes == code
        assert np.all(lost | (codes == 0)) and lost[beyond > 1e-11].all()
        assert np.max(steps) < 60
        np.testing.assert_allclose(ends, whole, rtol=0, atol=1e-11)
