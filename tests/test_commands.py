"""Commands that change in time, and the jumps that they declare."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._linalg import Vec2
from jaxroll._mechanics import to_leaves
from jaxroll._motion import bodies
from jaxroll._motion._equations import sensed
from jaxroll.commands import Declared, Ramps, Steps
from jaxroll.control import Opposition, Press
from jaxroll.scenes import _space_scenes
from tests.measures import both_ways
from tests.oracles.chapter_part1 import Part1
from tests.recorded import runs
from tests.subjects.driven_plate import driven_plate

JUMP, END = 0.37, 0.8
AFTER = 0.8  # the force after the jump [N]; the scene's is 0.5


@pytest.fixture(scope="module")
def scene():
    """A plate that `Press` drives by 0.5 N, damped by 8 N s/m."""
    return driven_plate()


def flow(state):
    """All of a state as one vector."""
    return jnp.concatenate([state.q, state.v, state.s], axis=-1)


def run_of(scene, ts=(0.5, END), rtol=1e-12, t0=0.0, throw=True, **changes):
    """A run of the scene, changed; one program for all that declare one jump."""
    grasp, state = scene
    return jxr.simulate(
        grasp.with_(**changes), state, ts[-1], t0=t0, ts=jnp.asarray(ts), rtol=rtol, throw=throw
    )


def stepped(scene, time, ts=(0.5, END), before=0.5, after=AFTER, damping=(8.0, 8.0), **told):
    """A run whose force steps once; so does its damping, by nothing unless told."""
    times = jnp.stack([jnp.asarray(time)])
    changes = {"force": Steps(times, [before, after]), "damping": Steps(times, damping)}
    return run_of(scene, ts=ts, **changes, **told)


def in_sequence(scene, time, ts):
    """The same as two runs, the second from where the first one ends."""
    first = run_of(scene, (0.5 * time, time), force=0.5)
    second = run_of((scene[0], first.last), ts, t0=time, force=AFTER)
    return first, second


def test_a_step_is_two_runs_in_sequence(scene):
    run = stepped(scene, JUMP)
    _, second = in_sequence(scene, JUMP, (0.5, END))
    np.testing.assert_allclose(flow(run.states), flow(second.states), rtol=0, atol=1e-12)
    still = run_of(scene, force=0.5)
    assert np.abs(flow(run.last) - flow(still.last)).max() > 1e-3
    assert int(run.stats.rejected) <= 3  # no step has the jump inside


def test_jumps_at_the_ends_at_save_times_and_beyond(scene):
    """At its own time a jump is over: a run that begins there begins after it, one that ends there is before.

    A state is continuous at a jump, to what moves within its grain.
    """
    soft, hard = (run_of(scene, force=force) for force in (0.5, AFTER))
    for time, same in ((0.0, hard), (-1.0, hard), (END, soft), (2.0, soft), (END + 1e-9, soft)):
        run = stepped(scene, time)
        np.testing.assert_allclose(flow(run.states), flow(same.states), rtol=0, atol=1e-12, err_msg=str(time))
        assert float(run.stats.t_end) == END
    assert float(stepped(scene, 0.0, before=-0.5, after=-0.5, throw=False).stats.t_end) == 0.0
    run = stepped(scene, 0.5)
    _, second = in_sequence(scene, 0.5, (0.6, END))
    np.testing.assert_allclose(flow(run.states)[0], flow(soft.states)[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(flow(run.last), flow(second.last), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(run.ts, [0.5, END])
    assert float(run.stats.t_end) == pytest.approx(END, abs=1e-14)


def test_two_parts_may_jump_at_one_time(scene):
    run = stepped(scene, JUMP, damping=(8.0, 3.0))
    first, _ = in_sequence(scene, JUMP, (0.5, END))
    second = run_of((scene[0], first.last), (0.5, END), t0=JUMP, force=AFTER, damping=3.0)
    np.testing.assert_allclose(flow(run.states), flow(second.states), rtol=0, atol=1e-12)


def test_without_jumps_a_declared_function_is_the_function(scene):
    """The same program: a run asks a grasp alone whether there are jumps."""
    declared = scene[0].with_(force=Declared(lambda t: 0.5 + 0.1 * t, []))
    assert declared.jumps == () and float(declared.controller.at(2.0).force) == 0.7


def test_a_declared_jump_keeps_the_order_of_a_method(scene):
    """Of constant steps, halved thrice; the jump is on no grid. Undeclared, the order is about one."""
    grasp, state = scene
    true = flow(stepped(scene, JUMP).last)
    both = (Steps([JUMP], [0.5, AFTER]), lambda t: jnp.where(t >= JUMP, AFTER, 0.5))

    def orders(force, solver, steps):
        errors = []
        for h in steps:
            told = {"solver": solver, "stepsize_controller": diffrax.ConstantStepSize(), "dt0": h}
            run = jxr.simulate(grasp.with_(force=force), state, END, ts=1, **told)
            errors.append(np.abs(flow(run.last) - true).max())
        return np.log2(np.array(errors[:-1]) / errors[1:])

    steps = END / np.array([30, 60, 120])
    assert np.mean(orders(both[0], diffrax.Tsit5(), steps)) > 4.5
    assert np.mean(orders(both[1], diffrax.Tsit5(), steps)) < 2.5


# --- derivatives


def differences(function, x, step=2e-3):
    """A derivative by central differences of sixth order."""
    weights = {1: 45.0, 2: -9.0, 3: 1.0}
    both = [(function(x + n * step) - function(x - n * step)) * w for n, w in weights.items()]
    return np.sum(np.asarray(both), axis=0) / (60.0 * step)


def saved(scene, time, **told):
    return flow(stepped(scene, time, **told).states)


# Of the run of `jumping`: when its force steps, how long after that its damping's ramp ends, and when its
# force is zero: it fades to that, here practically not at all.
STILL = {"time": JUMP, "ramp": 0.2, "zero": 1e9}


def fading_force(numbers, t):
    """A force that steps, and fades the faster the later it is."""
    time, zero, before, after = numbers
    return jnp.where(t >= time, after, before) * (1.0 - (t / zero) ** 2)


@pytest.fixture(scope="module")
def jumping(scene):
    """Derivatives in the time of a step and of a ramp of the damping that begins with it.

    A function of times other than `STILL`, of both parts before and after, of which times are moved together,
    and of weights: what a run says, its derivative along these times, and the gradient of a sum with weights
    in all of them. One program for all tests of derivatives here.
    """

    def told(times, numbers):
        force, damping = numbers
        time, end = times["time"], times["time"] + times["ramp"]
        fading = jax.tree_util.Partial(fading_force, (time, times["zero"], *force))
        changes = {"force": Declared(fading, time[None]), "damping": Ramps(jnp.stack([time, end]), damping)}
        run = run_of(scene, (JUMP, END), throw=False, **changes)
        return (flow(run.states), flow(run.last), run.stats.t_end), run.result._value

    @jax.jit
    def both(times, numbers, along, weights):
        values, push, code = jax.linearize(lambda times: told(times, numbers), times, has_aux=True)
        (slopes,) = jax.linear_transpose(push, times)(weights)
        return values, push(along), slopes, code

    size = flow(scene[1]).size
    nothing = np.zeros((2, size)), np.zeros(size), np.zeros(())

    def found(numbers, along=("time",), weights=nothing, **times):
        along = {name: np.array(float(name in along)) for name in STILL}
        # Python's numbers are another type to JAX, and so would make another program.
        given = jax.tree.map(lambda x: np.asarray(x, float), (STILL | times, numbers, along, weights))
        return jax.tree.map(np.asarray, both(*given))

    return found


def test_derivatives_in_the_time_of_a_step_and_of_a_ramp_that_begins_with_it(scene, jumping):
    """Both modes against differences; of a state saved at the jump they are those of a jump a little earlier.

    Two parts that jump at one time are moved together; a ramp's slope jumps at its other end too.
    """
    numbers = (0.5, AFTER), (8.0, 3.0)
    values = lambda time: jumping(numbers, time=time)[0][0]  # noqa: E731
    forward = jumping(numbers)[1][0]
    slope = differences(lambda time: values(time)[-1], JUMP)
    assert np.abs(forward[-1] - slope).max() <= 1e-8 * np.abs(slope).max()
    weights = np.random.default_rng(0).normal(size=forward.shape)
    backward = jumping(numbers, weights=(weights, np.zeros(forward.shape[1]), 0.0))[2]["time"]
    assert float(backward) == pytest.approx(float(np.sum(weights * forward)), rel=1e-11)
    # At the jump itself velocities alone move, by the accelerations before it less those after it.
    count = scene[0].coordinates
    earlier = [values(JUMP - n * 1e-4)[0] for n in range(4)]
    onesided = (11 * earlier[0] - 18 * earlier[1] + 9 * earlier[2] - 2 * earlier[3]) / 6e-4
    np.testing.assert_allclose(forward[0], onesided, rtol=0, atol=1e-6 * np.abs(onesided).max())
    assert np.abs(forward[0][:count]).max() <= 1e-12 < np.abs(forward[0][count : 2 * count]).max()
    # At the start it is that of a jump a little later.
    later = [values(n * 1e-3)[-1] for n in range(5)]
    onesided = (-25 * later[0] + 48 * later[1] - 36 * later[2] + 16 * later[3] - 3 * later[4]) / 12e-3
    found = jumping(numbers, time=0.0)[1][0][-1]
    np.testing.assert_allclose(found, onesided, rtol=0, atol=1e-6 * np.abs(onesided).max())


@pytest.mark.slow
def test_derivatives_of_a_batch_over_jump_times(scene):
    times = jnp.array([0.2, JUMP, 0.6])
    many = jax.vmap(lambda time: saved(scene, time)[-1])
    values, slopes = jax.jvp(many, (times,), (jnp.ones(3),))
    np.testing.assert_allclose(values, [saved(scene, time)[-1] for time in times], rtol=0, atol=1e-12)
    for time, slope in zip(times, slopes, strict=True):
        wanted = differences(lambda time: saved(scene, time)[-1], time)
        assert np.abs(slope - wanted).max() <= 1e-8 * np.abs(wanted).max()


def test_a_limit_that_is_met_long_after_a_jump_has_a_derivative(jumping):
    """The search for it ends with a step as short as those at a jump: a third of these were taken for one."""
    numbers = (0.5, 0.5), (2e-3, 3e-3)
    times = np.linspace(0.1, 0.26, 24)
    bar = np.zeros((2, 9)), np.zeros(9), 1.0
    found = [jumping(numbers, ("zero",), bar, time=0.07, ramp=0.01, zero=zero) for zero in times]
    values, slopes = (np.array([each[k][2] for each in found]) for k in (0, 1))
    # The damping makes the contact open a little after the force is zero, ever by nearly as much.
    assert (np.abs(values - times) < 1e-3).all()
    np.testing.assert_allclose(slopes, 1.0, rtol=0, atol=1e-2)
    np.testing.assert_allclose([each[2]["zero"] for each in found], slopes, rtol=1e-9)


@pytest.mark.slow
def test_derivatives_with_rosenbrocks_method(scene):
    grasp, state = scene

    def end(time):
        force = Steps(jnp.stack([time]), [0.5, AFTER])
        run = jxr.simulate(grasp.with_(force=force), state, END, ts=1, solver=jxr.Rosenbrock(), rtol=1e-9)
        return flow(run.last)

    known, every = flow(stepped(scene, JUMP).last), both_ways(end)
    there, forwards, _ = every(JUMP, 1.0, known)
    np.testing.assert_allclose(there, known, rtol=0, atol=1e-6)
    wanted = differences(lambda time: saved(scene, time)[-1], JUMP)
    backwards = np.array([every(JUMP, 1.0, bar)[2] for bar in np.eye(known.size)])
    for found in (forwards, backwards):
        assert np.abs(found - wanted).max() <= 1e-7 * np.abs(wanted).max()


def test_a_jump_that_ends_a_run_ends_it_at_its_time(scene, jumping):
    """The force turns negative, and pulls the plate off: the end moves with the jump and nothing else."""
    # The damping's ramp is level.
    numbers = (0.5, -0.5), (8.0, 8.0)
    nothing = np.zeros((2, 9)), np.zeros(9)
    (_, last, time), (_, slope, rate), backward, code = jumping(numbers, weights=(*nothing, 1.0))
    assert int(code) == int(jxr.RESULTS.contact_lost._value) and float(time) == pytest.approx(JUMP, abs=1e-14)
    whole = run_of(scene, (0.5 * JUMP, JUMP), force=0.5)
    np.testing.assert_allclose(last, flow(whole.last), rtol=0, atol=1e-12)
    assert float(rate) == 1.0
    assert float(backward["time"]) == 1.0
    wanted = differences(lambda time: jumping(numbers, time=time)[0][1], JUMP)
    np.testing.assert_allclose(slope, wanted, rtol=0, atol=1e-8 * np.abs(wanted).max())


# --- controllers


def test_numbers_that_change_keep_the_energy_balance():
    """What a changing potential gives counts as work."""
    grasp, state = runs.scene("pivoted")
    target = np.asarray(grasp.controller.target)
    changed = grasp.with_(
        force=Steps([0.3], [0.5, AFTER]),
        radius=Declared(lambda t: 0.01 + 0.001 * jnp.abs(t - 0.5), [0.5]),
        damping=lambda t: 0.006 + 0.002 * jnp.sin(9.0 * t),
        target=Ramps([0.1, 0.6], [target, target + 0.002]),
    )
    run = jxr.simulate(changed, state, END, ts=9, rtol=1e-11, record=("energy",))
    size = np.abs(run.energy.kinetic).max() + np.abs(run.energy.work).max()
    assert np.abs(run.energy.residual).max() <= 1e-9 * size and not np.any(run.energy.potential)
    balance, at = jxr.press_balance(changed, 0.4, state), changed.with_(controller=changed.controller.at(0.4))
    for found, wanted in zip(
        *map(jax.tree.leaves, (balance, jxr.press_balance(at, 0.4, state))), strict=True
    ):
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-14)
    assert float(at.controller.force) == AFTER and float(at.controller.damping) != 0.006
    with pytest.raises(ValueError, match="argument controller must have numbers as force and radius"):
        _ = changed.controller.stiffness


def test_a_potential_of_numbers_that_change_is_none(scene):
    """Each of them by itself; damping is in no potential."""
    tips = [Vec2(*jnp.array(place)) for place in ((0.1, 0.2), (0.3, 0.1))]
    press, angles = scene[0].controller, [(0.3,), (0.4,)]
    pair = Opposition(20.0, 0.006, 0.001, start=(0.1, 0.2))
    for control, names in ((press, ("force", "radius", "target")), (pair, ("beta", "alpha", "start"))):
        kept = float(control.potential(tips, angles))
        assert kept > 0.0
        for name in (*names, "damping"):
            number = getattr(control, name)
            own = eqx.tree_at(lambda c: getattr(c, name), control, Declared(lambda t: number, []))  # noqa: B023
            assert float(own.potential(tips, angles)) == (kept if name == "damping" else 0.0)
            assert float(own.at(0.3).potential(tips, angles)) == kept


class Own(eqx.Module):
    """A user's own controller that jumps and says so."""

    press: Press
    after: Press
    jumps: jax.Array

    def __call__(self, t, angles, rates, tips):
        now = jax.tree.map(lambda a, b: jnp.where(t >= self.jumps[0], b, a), self.press, self.after)
        pull = [tip.jacobian.T @ (now.stiffness * (tip.position - now.target)) for tip in tips]
        return tuple(-now.damping * rate - each for rate, each in zip(rates, pull, strict=True))


def test_a_users_own_controller_declares_jumps(scene):
    grasp, _ = scene
    after = grasp.with_(force=AFTER).controller
    own = lambda time: flow(  # noqa: E731
        run_of(scene, controller=Own(grasp.controller, after, jnp.stack([jnp.asarray(time)]))).states
    )
    np.testing.assert_allclose(own(JUMP), saved(scene, JUMP), rtol=0, atol=1e-12)
    listed = eqx.tree_at(lambda c: c.jumps, Own(grasp.controller, after, jnp.zeros(1)), [0.1, 0.2])
    assert [times.tolist() for times in grasp.with_(controller=listed).jumps] == [[0.1, 0.2]]
    texts = eqx.tree_at(lambda c: c.jumps, listed, "soon")
    with pytest.raises(ValueError, match="argument jumps must be a real number or an array of them"):
        run_of(scene, controller=texts)
    for never in (jnp.nan, jnp.inf):
        odd = eqx.tree_at(lambda c: c.jumps, listed, [0.1, never])
        with pytest.raises(ValueError, match="argument jumps must be finite, but was"):
            grasp.with_(controller=odd)


class Changing(Part1):
    """The chapter's equations with numbers of the control that change."""

    def __init__(self, start):
        super().__init__(start)
        self.first = self.start

    def accelerations(self, X, v, s, t=0.0):
        self.beta, self.c, self.alpha = 20.0 + 30.0 * t, 0.006 + 0.01 * t, 1e-3 + 0.05 * t
        self.start = self.first + np.array([0.2, -0.1]) * t
        return super().accelerations(X, v, s, t)


def changing(start):
    """The same control."""
    return Opposition(
        Ramps([0.0, 1.0], [20.0, 50.0]),
        lambda t: 0.006 + 0.01 * t,
        lambda t: jnp.stack([1e-3 + 0.05 * t, 1e-3 + 0.05 * t]),
        start=lambda t: jnp.asarray(start) + jnp.array([0.2, -0.1]) * t,
    )


def test_opposition_with_numbers_that_change():
    """Against the chapter's equations, in the plane; balances are those of the numbers of that time."""
    grasp, state = runs.scene("pinch")
    start, ts = np.asarray(grasp.controller.start), np.linspace(0.0, 0.4, 5)
    changed = grasp.with_(controller=changing(start))
    run = jxr.simulate(changed, state, 0.4, ts=ts, rtol=1e-11)
    X, v, *_ = Changing(start).simulate(np.asarray(state.q), np.array([0.004, -0.003]), ts)
    np.testing.assert_allclose(run.states.q, X, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.v, v, rtol=0, atol=1e-8)
    held = changed.with_(controller=changed.controller.at(0.3))
    assert float(held.controller.beta) == pytest.approx(29.0) and held.controller.damping.shape == (2,)
    both = (jxr.pinch_balance(each, 0.3, run.last) for each in (changed, held))
    for found, wanted in zip(*map(jax.tree.leaves, both), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-14)
    for call in (
        lambda: jxr.stability.pinch_statics(changed, (0.0, 0.0)),
        lambda: jxr.stability.rectangle_hessian(changed, (0.0, 0.0)),
        lambda: jxr.stability.pinch_rest(changed, state),
    ):
        with pytest.raises(ValueError, match="argument grasp must have a number as its controller's beta"):
            call()


def test_opposition_with_numbers_that_change_in_space(monkeypatch):
    """Torques (16)-(17) with the numbers of that time, in a pose that need not be closed."""
    monkeypatch.setattr(_space_scenes, "close", lambda grasp, guess, **_: (grasp, guess))
    grasp, _ = jxr.scenes.pinch3d()
    start, t = np.array([0.3, -0.2]), 0.3
    q, v = np.random.default_rng(0).normal(size=(2, 13))
    ready = grasp.with_(controller=changing(start)).prepared()
    at = to_leaves(jxr.State(q, v[:12], np.zeros(12)), ready.form)
    seen = sensed(ready, at, bodies(ready, at)[0])
    r = np.array([finger.tip.array() for finger in seen])
    kept = (1e-3 + 0.05 * t) * (q[7:].reshape(2, 3).sum(axis=1) - start - np.array([0.2, -0.1]) * t)
    for i, torques in enumerate(ready.controller.torques(jnp.asarray(t), seen)):
        jacobian = np.stack([unit.velocity.array() for unit in seen[i].unit_twists], axis=-1)
        wanted = -29.0 * jacobian.T @ (r[i] - r[1 - i]) - 0.009 * v[6 + 3 * i : 9 + 3 * i] - kept[i]
        np.testing.assert_allclose(np.array(torques), wanted, rtol=1e-12, atol=1e-14)


@pytest.mark.slow
def test_a_run_in_space_with_numbers_that_change():
    """It keeps its energy balance, across a declared jump too."""
    grasp, state = jxr.scenes.pinch3d()
    control = changing(np.asarray(grasp.controller.start))
    stiffer = eqx.tree_at(lambda c: c.beta, control, Steps([0.03], [20.0, 30.0]))
    run = jxr.simulate(grasp.with_(controller=stiffer), state, 0.05, ts=3, rtol=1e-10, record=("energy",))
    size = np.abs(run.energy.kinetic).max() + np.abs(run.energy.work).max()
    assert np.abs(run.energy.residual).max() <= 1e-9 * size


# --- functions of time


@pytest.mark.parametrize("kind", [Steps, Ramps])
def test_traced_times_that_do_not_rise_are_no_command(kind):
    """What nobody can refuse yet is no success: values are NaN, and with them a run ends."""
    values = [1.0, 2.0, 3.0, 4.0][: 3 + (kind is Steps)]
    asked = jax.jit(jax.vmap(lambda times: kind(times, values)(0.5)))
    rows = np.array([[0.1, 0.2, 0.9], [0.2, 0.1, 0.9], [0.1, 0.1, 0.9]])
    found = asked(rows)
    assert float(found[0]) == float(kind(rows[0], values)(0.5))
    assert np.isnan(np.asarray(found[1:])).all()


def test_what_steps_and_ramps_are_between_their_times():
    step, ramp = Steps([1.0, 2.0], [[1, 10], [2, 20], [3, 30]]), Ramps([1.0, 2.0, 4.0], [1.0, 3.0, 2.0])
    seen = [step(t).tolist() for t in (0.9, 1.0, 1.9, 2.0, 5.0)]
    assert seen == [[1.0, 10.0], [2.0, 20.0], [2.0, 20.0], [3.0, 30.0], [3.0, 30.0]]
    seen = [float(ramp(t)) for t in (0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 9.0)]
    assert seen == [1.0, 1.0, 2.0, 3.0, 2.5, 2.0, 2.0]
    assert step.jumps.tolist() == [1.0, 2.0] and ramp.jumps.tolist() == [1.0, 2.0, 4.0]
