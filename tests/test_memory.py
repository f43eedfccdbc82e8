"""Controllers with a memory: integral terms, samples that are held, laws of one's own with a state."""

import functools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._analysis._loci import _loci
from jaxroll._mechanics import AbstractController
from jaxroll._motion import check_due
from jaxroll.commands import Declared
from jaxroll.control import Integral, Sampled
from jaxroll.loads import Drag, Impulse, Spring
from tests.measures import both_ways, runge_kutta_step
from tests.oracles import reference_space as reference
from tests.oracles.chapter_part1 import JOINTS, Part1
from tests.recorded import runs
from tests.subjects.driven_plate import driven_plate
from tests.subjects.pinches_in_space import same_in_reference

S = (0.004, -0.003)
PERIOD, COUNT = 0.0015, 16
KEY = jax.random.key(0)
GAINS = {"y": 40.0, "tilt": 0.05, "orientation_1": 0.02}
TARGETS = {"y": 0.11, "tilt": 0.15, "orientation_1": 1.6}


@pytest.fixture(scope="module")
def pinch():
    return jxr.scenes.pinch(s=S)


@pytest.fixture(scope="module")
def chapter(pinch):
    q = np.asarray(pinch[1].q)
    return Part1(np.array([q[3:6].sum(), q[6:8].sum()]))


def integral(law):
    return Integral(law, TARGETS, jnp.array([GAINS[name] for name in TARGETS]))


def task_errors(places, X):
    """Values and derivatives of the three task errors, from tips and their Jacobians; shape (3,), (3, 5)."""
    (r1, J1, _), (r2, J2, _) = places
    line = r2 - r1
    values = [
        (r1 + r2)[1] / 2 - TARGETS["y"],
        np.arctan2(line[1], line[0]) - TARGETS["tilt"],
        X[JOINTS[1]].sum() - TARGETS["orientation_1"],
    ]
    along = np.array([-line[1], line[0]]) / (line @ line)
    slopes = np.array(
        [
            np.concatenate([J1[1], J2[1]]) / 2,
            np.concatenate([-along @ J1, along @ J2]),
            np.concatenate([np.zeros(3), np.ones(2)]),
        ]
    )
    return np.array(values), slopes


def law_of_chapter(chapter):
    """(16)-(17) with the integral term, as a function of (t, X, v, memory)."""

    def law(t, X, v, memory):
        places = chapter.places(X)
        values, slopes = task_errors(places, X)
        return chapter.torques(X, v, places) - slopes.T @ (np.array([*GAINS.values()]) * memory), values

    return law


def check_energy(run, most=1e-9):
    size = np.abs(run.energy.kinetic).max() + np.abs(run.energy.work).max()
    assert np.abs(run.energy.residual).max() <= most * size


# --- an integral term


def test_an_integral_term_against_the_augmented_system(pinch, chapter):
    grasp, state = pinch
    ts = np.linspace(0.0, 0.4, 5)
    acted = grasp.with_(controller=integral(grasp.controller))
    run = jxr.simulate(acted, state, 0.4, ts=ts, rtol=1e-12, record=("energy",))
    start = np.asarray(state.q), np.array(S)
    X, v, memory = chapter.simulate_integral(*start, ts, law=law_of_chapter(chapter), memory=np.zeros(3))
    assert np.abs(memory[-1]).min() > 1e-4
    idle = jxr.simulate(acted.with_(gain=np.zeros(3)), state, 0.4, ts=ts, rtol=1e-12, record=("energy",))
    assert np.abs(idle.states.q[-1] - X[-1]).max() > 1e-3  # it does act
    np.testing.assert_allclose(run.states.q, X, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.v, v, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.memory, memory, rtol=0, atol=1e-9)
    check_energy(run)


PULL = np.array([0.0, -0.02])


def pulling(force, t, pose, twist):
    """A load that is the same at all times."""
    return force, jnp.zeros(())


@pytest.fixture(scope="module")
def loaded(pinch):
    """The integral law under a constant load, and its verdict."""
    grasp, state = pinch
    pulled = grasp.with_(load=jax.tree_util.Partial(pulling, jnp.asarray(PULL)))
    acted = pulled.with_(controller=integral(grasp.controller))
    return acted, jxr.stability.assess(acted, state)


@pytest.fixture(scope="module")
def pulled_chapter(chapter):
    """The chapter's equations under the same load."""
    return Part1(chapter.start, lambda t, X, v: (PULL, 0.0))


def at_rest(acted, found):
    """q, v, the arclengths of the chapter and the memory of an equilibrium."""
    rest = found.equilibrium.state
    s = jxr.pinch_balance(acted, 0.0, rest).s  # as the chapter counts
    return [np.asarray(x) for x in (rest.q, rest.v, s, rest.memory)]


def test_an_integral_term_makes_up_for_a_constant_load(loaded, pulled_chapter):
    """At rest under it all errors are zero, and what the integral term holds would else move the object."""
    assert loaded[1].equilibrium.found
    X, v, s, memory = at_rest(*loaded)
    law = law_of_chapter(pulled_chapter)
    torques, errors = law(0.0, X, v, memory)
    np.testing.assert_allclose(errors, 0.0, rtol=0, atol=1e-12)
    moved = lambda u: pulled_chapter.accelerations(X, v, s, 0.0, u)[0]  # noqa: E731
    assert np.abs(moved(torques)).max() < 1e-9
    for k in range(3):
        without = law(0.0, X, v, np.where(np.arange(3) == k, 0.0, memory))[0]
        assert np.abs(moved(without)).max() > 1e-2


@pytest.mark.slow
def test_a_law_with_a_memory_in_space_against_the_augmented_system():
    """Of a caller's own, with a filter of what it pulls by; and the integral term of the mean height."""
    grasp, state = jxr.scenes.pinch3d()
    plain = same_in_reference(grasp)

    class Filtered(eqx.Module):
        beta: jax.Array
        damping: jax.Array
        memory: jax.Array

        def __call__(self, t, angles, rates, tips, memory):
            apart = tips[0].position - tips[1].position
            pulls = (-memory, memory)
            each = zip(tips, rates, pulls, strict=True)
            torques = [tip.jacobian.T @ p - self.damping * w for tip, w, p in each]
            return torques, 30.0 * (self.beta * apart - memory)

    beta, damping = grasp.controller.beta, grasp.controller.damping[0]
    given = np.asarray(state.q), np.asarray(state.v)
    (r1, _), (r2, _) = reference.tips_of(plain, reference.equations(plain, *given)[-1])
    start = 1.1 * float(beta) * (r1 - r2) + np.array([0.01, -0.02, 0.03])
    law = Integral(Filtered(beta, damping, jnp.asarray(start)), {"y": 0.12}, 20.0)
    ts = np.linspace(0.0, 0.2, 3)
    run = jxr.simulate(grasp.with_(controller=law), state, 0.2, ts=ts, rtol=1e-12, record=("energy",))

    def truth(t, v, tips, memory):
        (r1, J1), (r2, J2) = tips
        kept, z = memory[:3], memory[3]
        u = np.concatenate([J1.T @ -kept, J2.T @ kept]) - float(damping) * v[6:]
        u -= 20.0 * z * np.concatenate([J1[1], J2[1]]) / 2
        return u, np.append(30.0 * (float(beta) * (r1 - r2) - kept), (r1 + r2)[1] / 2 - 0.12)

    free = replace(plain, beta=0.0, damping=0.0)
    q, v, memory = reference.simulate(free, *given, ts, law=truth, memory=np.append(start, 0.0))
    assert np.abs(memory[-1] - memory[0]).min() > 1e-4
    np.testing.assert_allclose(run.states.q, q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.v, v, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.memory, memory, rtol=0, atol=1e-9)
    check_energy(run)


THREE, OTHERS = ("x", "y", "opening"), ("orientation_0", "orientation_1")


@pytest.mark.parametrize(
    ("scene", "names"),
    [("pinch", THREE), ("pinch", (*OTHERS, "tilt")), ("pinch3d", (*THREE, *OTHERS, "z"))],
)
def test_every_error_is_fed_back_along_its_own_derivative(scene, names):
    """The torques -g z de/dq of each by itself, against differences of the error that is integrated."""
    grasp, state = runs.scene(scene)
    count, size, first = len(names), 1e-5, grasp.form.positions[0]
    gains = np.array([2.0, 3.0, 5.0, 1.0, 4.0, 6.0])[:count]
    acted = grasp.with_(controller=Integral(None, dict.fromkeys(names, 0.37), gains))
    field = jxr.vector_field(acted)
    ahead = np.concatenate([state.v, state.s, np.zeros(count)])
    errors = jax.jit(lambda q: field(0.0, jnp.concatenate([q, ahead]))[-count:])
    slopes = []
    for i in range(first, state.q.shape[0]):
        step = size * np.eye(state.q.shape[0])[i]
        ends = [np.asarray(errors(np.asarray(state.q) + way * step)) for way in (-1, 1)]
        slopes.append((ends[1] - ends[0]) / (2 * size))
    for k in range(count):
        held = jxr.State(state.q, state.v, state.s, 0.7 * np.eye(count)[k])
        torques = np.concatenate(jxr.torques(acted, 0.0, held))
        np.testing.assert_allclose(torques, -0.7 * gains[k] * np.array(slopes)[:, k], rtol=0, atol=1e-8)
        assert np.abs(torques).max() > 1e-3


@pytest.fixture(scope="module")
def plate():
    """A disc on a driven plate, which a spring and a drag bring to rest."""
    return driven_plate([Spring(0.5, (0.0, 0.05)), Drag(0.2)])


def pressed_seldom(scene, ts, period, *, gain=0.0, first=0.0, noise=0.0, key=KEY, state=None, **told):
    """A run of the driven plate to the last of three saved times, under its own law, sampled.

    With an integral term, which does nothing unless told. One program for all tests here.
    """
    grasp, begin = scene
    law = Integral(grasp.controller, {"y": 0.1}, gain)
    held = Sampled(law, period, first=first, angle_noise=noise, key=key)
    told = {"ts": ts, "events": (), "throw": False} | told
    return jxr.simulate(grasp.with_(controller=held), begin if state is None else state, ts[-1], **told)


def test_a_sample_costs_one_step(plate):
    """The slope that the next step begins with is that after the sample: no step is rejected."""
    run = pressed_seldom(plate, np.array([0.0, 0.1, 0.2]), 1e-3)
    assert int(run.stats.steps) <= 205 and int(run.stats.rejected) <= 2


def test_no_more_errors_than_the_contacts_leave_free(pinch):
    grasp, state = pinch
    names = {f"orientation_{i}": 0.0 for i in (0, 1)} | {"x": 0.0, "y": 0.1, "tilt": 0.0}
    with pytest.raises(ValueError, match="at most 4 errors"):
        grasp.with_(controller=Integral(grasp.controller, names, 1.0))
    inside = Integral(grasp.controller, {"x": 0.03, "y": 0.11}, 1.0)
    with pytest.raises(ValueError, match="at most 1 errors"):
        grasp.with_(
            controller=Integral(inside, {"tilt": 0.1, "orientation_0": 1.5, "orientation_1": 1.5}, 1.0)
        )
    # Twice the same is a mixture that nothing moves.
    with pytest.raises(ValueError, match="hold '[xy]' fast"):
        jxr.simulate(grasp.with_(controller=Integral(inside, {"y": 0.1}, 1.0)), state, 0.1)
    # Where the tips touch with their vertices their distance is least: no motion changes it.
    grasp, rest = jxr.scenes.pinch(s=(0.0, 0.0))
    held = grasp.with_(controller=Integral(grasp.controller, {"opening": 0.05}, 1.0))
    with pytest.raises(ValueError, match="hold 'opening' fast"):
        jxr.simulate(held, rest, 0.1)
    with pytest.raises(ValueError, match="hold 'opening' fast"):  # known, though the end is traced
        jax.eval_shape(lambda t1: jxr.simulate(held, rest, t1, throw=False), 0.1)


@pytest.mark.parametrize(
    ("targets", "words"),
    [
        ({"width": 0.1}, "names among"),
        ({"orientation_2": 0.1}, "what 2 fingers can have"),
        ({"z": 0.1}, "2 axes"),
        ({}, "a dict"),
        ({"x": np.inf}, "finite"),
    ],
)
def test_task_errors_that_there_are_not(pinch, targets, words):
    with pytest.raises(ValueError, match=words):
        pinch[0].with_(controller=Integral(pinch[0].controller, targets, 1.0))


# --- samples


@pytest.fixture(scope="module")
def sampled(pinch):
    """The integral law, sampled, and a run that is saved at every sample.

    It begins with a memory, as those do that go on from one of its states: they are the same program.
    """
    grasp, state = pinch
    acted = grasp.with_(controller=Sampled(integral(grasp.controller), PERIOD))
    ts, memory = PERIOD * np.arange(COUNT + 1), acted.controller.initial_memory((3, 2))
    begin = jxr.State(state.q, state.v, state.s, memory)
    return acted, jxr.simulate(acted, begin, ts[-1], ts=ts, rtol=1e-12, record=("energy",))


def test_a_sampled_law_against_a_loop_written_by_hand(pinch, chapter, sampled):
    """Its integrals move by Euler's steps."""
    law = law_of_chapter(chapter)

    def stepped(t, X, v, memory):
        u, rate = law(t, X, v, memory)
        return u, memory + PERIOD * rate

    given = {"law": stepped, "memory": np.zeros(3), "period": PERIOD, "count": COUNT}
    X, v, memory, u = chapter.simulate_sampled(np.asarray(pinch[1].q), np.array(S), **given)
    run = sampled[1]
    np.testing.assert_allclose(run.states.q, X, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.v, v, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.memory[:, :3], memory, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.memory[:, 3:8], u, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.memory[:, 8], PERIOD * np.arange(1, COUNT + 2), rtol=1e-14)
    check_energy(run)


@pytest.mark.parametrize(
    "ways",
    [{"solver": jxr.Rosenbrock()}, {"formulation": jxr.CSM(2000.0, 1e6)}],
    ids=["rosenbrock", "csm"],
)
def test_samples_by_other_ways(plate, ways):
    """The state at the end depends on neither."""
    ts = PERIOD * np.array([4.5, 8.0, COUNT])
    run, other = (pressed_seldom(plate, ts, PERIOD, gain=5.0, rtol=1e-9, **told) for told in (ways, {}))
    for part in ("q", "memory"):
        np.testing.assert_allclose(getattr(run.last, part), getattr(other.last, part), rtol=0, atol=2e-8)


def test_samples_between_saved_times(sampled):
    acted, run = sampled
    begin = jax.tree.map(lambda x: np.asarray(x)[0], run.states)
    ts = np.linspace(0.3 * PERIOD, PERIOD * COUNT, COUNT + 1)
    other = jxr.simulate(acted, begin, ts[-1], ts=ts, rtol=1e-10, record=("energy",))
    for part in ("q", "memory"):
        np.testing.assert_allclose(getattr(other.last, part), getattr(run.last, part), rtol=0, atol=2e-8)


def test_a_run_goes_on_from_a_saved_state_with_what_was_held(sampled):
    """Begun between two samples, and at one, where nothing is sampled twice."""
    acted, run = sampled
    first, fourth = (jax.tree.map(lambda x, i=i: np.asarray(x)[i], run.states) for i in (0, 3))
    same = {"ts": COUNT + 1, "rtol": 1e-11, "record": ("energy",)}
    half = jxr.simulate(acted, first, 2.5 * PERIOD, **same)
    for t0, state in ((2.5 * PERIOD, half.last), (float(run.ts[3]), fourth)):
        on = jxr.simulate(acted, state, float(run.ts[-1]), t0=t0, **same)
        np.testing.assert_allclose(on.last.q, run.last.q, rtol=0, atol=1e-11)
        np.testing.assert_allclose(on.last.memory, run.last.memory, rtol=0, atol=1e-10)


def test_torques_of_states_with_and_without_memory(pinch, sampled):
    acted, run = sampled
    held = np.concatenate(jxr.torques(acted, run.ts, run.states), axis=-1)
    np.testing.assert_allclose(held, run.states.memory[:, 3:8], rtol=1e-15)
    bare = jxr.State(run.states.q, run.states.v, run.states.s)
    asked = np.concatenate(jxr.torques(acted, run.ts, bare), axis=-1)
    plain = np.concatenate(jxr.torques(pinch[0], run.ts, bare), axis=-1)
    np.testing.assert_allclose(asked, plain, rtol=1e-15)


def test_before_the_first_sample_nothing_is_pressed_and_late_ones_are_not_made_up_for(plate):
    told = {"period": 0.01, "first": 0.02}
    memory = np.asarray(pressed_seldom(plate, np.array([0.01, 0.02, 0.03]), **told).states.memory)
    assert memory[0, 1] == 0.0 and np.all(memory[1:, 1])
    np.testing.assert_allclose(memory[:, 2], [0.02, 0.03, 0.04], rtol=1e-14)
    begun = pressed_seldom(plate, np.array([0.096, 0.104, 0.105]), t0=0.095, **told)
    memory = np.asarray(begun.states.memory)
    np.testing.assert_allclose(memory[:, 2], [0.1, 0.11, 0.11], rtol=1e-14)
    assert memory[0, 1] != 0.0


class PI(eqx.Module):
    """A caller's own discrete law: the memory of the next sample is what it returns."""

    memory: jax.Array

    def __call__(self, t, angles, rates, tips, memory):
        pull = 20.0 * (tips[0].position - tips[1].position)
        each = zip(tips, rates, (-1.0, 1.0), strict=True)
        torques = [sign * tip.jacobian.T @ pull - 0.006 * w - memory[0] for tip, w, sign in each]
        return torques, 0.5 * memory + 1e-3 * (tips[0].position[1] - 0.1)


LINK, TIP, DISC = 0.05, 0.01, 0.02
BASES = np.array([[-1.0, 0.0], [1.0, 0.0]]) * (TIP + DISC) - [0.0, LINK]


def disc_between_links(law):
    """A disc between two upright fingers of one link each, which move to and fro with it; and the start."""
    fingers = [jxr.Finger([LINK], [0.02], jxr.Circle(TIP), base=base) for base in BASES]
    # The tips' axes point upwards: the left one touches a quarter of a turn behind its axis.
    quarter = 0.5 * np.pi
    contacts = [
        jxr.Contact(-quarter * TIP, np.pi * DISC, finger=0),
        jxr.Contact(quarter * TIP, 0.0, finger=1),
    ]
    grasp = jxr.Grasp(jxr.FreeObject(jxr.Circle(DISC), 0.05, 1e-5), fingers, contacts, controller=law)
    return grasp, jxr.State([0.0, 0.0, 0.0, quarter, quarter], np.zeros(5), np.zeros(2))


def test_a_law_of_ones_own_and_noise():
    """Noise is drawn from the key and the number of the sample, and the tips fit the angles as measured."""
    key = jax.random.key(3)
    law = Sampled(PI(jnp.zeros(1)), 0.002, angle_noise=1e-3, rate_noise=0.1, key=key)
    acted, state = disc_between_links(law)
    run = jxr.simulate(acted, state, 0.012, ts=0.002 * np.arange(7), rtol=1e-10)
    finer = jxr.simulate(acted, state, 0.012, ts=np.linspace(0.0005, 0.012, 7), rtol=1e-10)
    np.testing.assert_allclose(run.last.q, finer.last.q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.last.memory, finer.last.memory, rtol=0, atol=1e-8)
    memory = np.zeros(1)
    for k in range(7):
        drawn = np.asarray(jax.random.normal(jax.random.fold_in(key, k), (4,)))
        angles = np.array(run.states.q[k, 3:]) + 1e-3 * drawn[:2]
        rates = np.array(run.states.v[k, 3:]) + 0.1 * drawn[2:]
        links = LINK * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        tips, slopes = BASES + links, links[:, ::-1] * [-1.0, 1.0]
        pull = 20.0 * (tips[0] - tips[1])
        u = slopes @ pull * [-1.0, 1.0] - 0.006 * rates - memory
        memory = 0.5 * memory + 1e-3 * (tips[0, 1] - 0.1)
        np.testing.assert_allclose(run.states.memory[k, 1:3], u, rtol=0, atol=1e-12)
        np.testing.assert_allclose(run.states.memory[k, :1], memory, rtol=0, atol=1e-15)


@pytest.mark.slow
def test_a_sampled_law_in_space_against_a_loop_written_by_hand():
    grasp, state = jxr.scenes.pinch3d()
    acted = grasp.with_(controller=Sampled(grasp.controller, 0.01))
    run = jxr.simulate(acted, state, 0.05, ts=0.01 * np.arange(6), rtol=1e-12)
    plain = same_in_reference(grasp)
    free = replace(plain, beta=0.0, damping=0.0)
    q, v = np.asarray(state.q), np.asarray(state.v)
    for k in range(5):
        here = reference.equations(plain, q, v)[-1]
        (r1, J1), (r2, J2) = reference.tips_of(plain, here)
        pull = plain.beta * (r1 - r2)
        u = np.concatenate([-J1.T @ pull, J2.T @ pull]) - plain.damping * v[6:]
        np.testing.assert_allclose(run.states.memory[k, :-1], u, rtol=0, atol=1e-9)
        ends = np.array([0.0, 0.01])
        rows = reference.simulate(free, q, v, ends, law=lambda *_, u=u: (u, np.zeros(0)))
        q, v = (each[-1] for each in rows)
        np.testing.assert_allclose(run.states.q[k + 1], q, rtol=0, atol=1e-9)
        np.testing.assert_allclose(run.states.v[k + 1], v, rtol=0, atol=1e-9)


# --- batches and derivatives


class Ends(NamedTuple):
    """When and where a run ended, and what it had saved."""

    t_end: Any
    last: Any
    states: Any


NEVER = 9.0  # a time after the end of every run
STILL = {"period": 0.002, "first": 0.0, "damping": 8.0, "growth": 0.0, "force": 0.5, "fading": 1e9}
STILL |= {"step": NEVER, "after": 0.8, "gain": 0.0, "target": 0.01, "memory": 0.0}
STILL |= {"blow": NEVER, "spin": 0.0, "ts": np.array([0.005, 0.01, 0.0155]), "t1": 0.0155}


def ends_of(n):
    """A run of the driven plate by the numbers of `STILL`: its samples, what they ask, and a blow."""
    grasp, state = driven_plate()
    # Straight down, so that the disc stays on a plate that falls, before the first sample.
    grasp = grasp.with_(gravity=(0.0, -2.0))
    partial = jax.tree_util.Partial
    # The law inside depends on time, so that a sample that comes later asks it later.
    growing = partial(lambda n, t: n["damping"] * (1.0 + n["growth"] * t), n)
    fading = partial(
        lambda n, t: jnp.where(t >= n["step"], n["after"], n["force"] * (1.0 - (t / n["fading"]) ** 2)), n
    )
    force = Declared(fading, jnp.stack([n["step"]]))
    law = Integral(grasp.with_(damping=growing, force=force).controller, {"y": n["target"]}, n["gain"])
    blow = Impulse((0.0, 0.0), n["blow"], angular=n["spin"])
    acted = grasp.with_(controller=Sampled(law, n["period"], first=n["first"]), load=blow)
    memory = acted.controller.initial_memory((1,)).at[0].set(n["memory"])
    state = jxr.State(state.q, state.v, state.s, memory)
    run = jxr.simulate(acted, state, n["t1"], ts=n["ts"], rtol=1e-12, throw=False)
    return Ends(run.stats.t_end, run.last, run.states)


@pytest.fixture(scope="module")
def moved_ends():
    """`Ends` by numbers other than those of `STILL`, their derivative along some, and a cotangent's gradient.

    One program for all tests of derivatives here: a cotangent names parts of `Ends`, all others are zero.
    """
    both = both_ways(ends_of)
    shapes = jax.eval_shape(lambda: ends_of(jax.tree.map(jnp.asarray, STILL)))
    nothing = jax.tree.map(lambda x: np.zeros(x.shape), shapes)
    resting = jax.tree.map(lambda x: np.zeros(np.shape(x)), STILL)

    def found(numbers, along=None, bar=lambda nothing: nothing):
        given = STILL | numbers, resting | (along or {}), bar(nothing)
        return jax.tree.map(np.asarray, both(*given))

    return found


def test_derivatives_of_a_sampled_run(moved_ends):
    """With respect to the times of samples too; of the state at the end, as it is saved."""
    numbers = {"period": 0.002, "first": 0.0005, "damping": 8.0, "gain": 5.0, "target": 0.01, "memory": 1e-3}
    steps = dict(zip(numbers, (1e-6, 1e-6, 1e-2, 1e-2, 1e-3, 3e-5), strict=True))
    along = dict(zip(numbers, (1e-4, 2e-4, 1.0, 1.0, 0.1, 0.01), strict=True))
    weights = np.arange(1.0, 5.0), 0.1 * np.ones(4)
    last = np.array([[0.0], [0.0], [1.0]])
    told = lambda n: {"growth": 50.0, **n}  # noqa: E731

    def mixed(ends):
        return ends.states.q[-1] @ weights[0] + ends.states.v[-1] @ weights[1] + ends.last.memory[0]

    def bar(nothing):
        where = lambda e: (e.states.q, e.states.v, e.last.memory)  # noqa: E731
        return eqx.tree_at(where, nothing, (last * weights[0], last * weights[1], np.eye(3)[0]))

    ends, slopes, backwards = moved_ends(told(numbers), along, bar)
    assert float(ends.t_end) == STILL["t1"]
    for name, size in steps.items():
        near = [
            mixed(moved_ends(told(numbers | {name: numbers[name] + k * size}))[0]) for k in (-2, -1, 1, 2)
        ]
        slope = np.array([1.0, -8.0, 8.0, -1.0]) @ near / (12.0 * size)
        assert abs(slope) > 1e-6
        np.testing.assert_allclose(backwards[name], slope, rtol=1e-7)
    wanted = sum(backwards[name] * along[name] for name in numbers)
    np.testing.assert_allclose(mixed(slopes), wanted, rtol=1e-10)


def test_the_end_of_a_run_that_a_sample_ended_moves_with_the_sample(moved_ends):
    """The pull that is held from there on opens the contact, however strong: the period alone moves it."""
    told = {"t1": 0.2, "ts": np.array([0.02, 0.03, 0.05])}
    x = {"period": 0.0203, "force": 0.5, "fading": 0.07, "damping": 0.5}
    steps = {"period": 2e-6, "force": 1e-4, "fading": 1e-5, "damping": 1e-4}
    weights = np.split(np.cos(np.arange(10.0)), [1, 5, 9])

    def parts(ends):
        return np.concatenate([ends.t_end[None], ends.last.q, 0.1 * ends.last.v, ends.last.memory[1:2]])

    def bar(nothing):
        where = lambda e: (e.t_end, e.last.q, e.last.v, e.last.memory)  # noqa: E731
        t, q, v, memory = weights
        return eqx.tree_at(where, nothing, (t[0], q, 0.1 * v, np.array([0.0, memory[0], 0.0])))

    value, _, backwards = moved_ends(told | x, bar=bar)
    assert float(value.t_end) == pytest.approx(4 * x["period"], rel=1e-14)
    ending = moved_ends(told | x, bar=lambda nothing: nothing._replace(t_end=np.ones(())))[2]
    np.testing.assert_allclose([ending[name] for name in x], [4.0, 0.0, 0.0, 0.0], rtol=0, atol=1e-12)
    for name, step in steps.items():
        near = [parts(moved_ends(told | x | {name: x[name] + k * step})[0]) for k in (-2, -1, 1, 2)]
        slopes = np.array([1.0, -8.0, 8.0, -1.0]) @ np.array(near) / 12
        forwards = parts(moved_ends(told | x, {name: step})[1])
        np.testing.assert_allclose(forwards, slopes, rtol=0, atol=1e-6 * np.abs(slopes).max())
        weighed = float(np.concatenate(weights) @ forwards)
        assert weighed == pytest.approx(float(backwards[name] * step), rel=1e-9)


def test_a_sample_at_a_jump_is_asked_after_it(moved_ends):
    """Of a command that steps there it is told the later value, and it sees velocities after a blow.

    The derivative in the time of the blow is that of one a little earlier, which the same sample sees.
    """
    grasp, ts = driven_plate()[0], np.array([0.004, 0.006, 0.01])
    told = {"step": 0.006, "spin": 2e-5, "t1": 0.017, "ts": ts}
    found = lambda time: moved_ends(told | {"blow": time}, {"blow": 1.0})  # noqa: E731
    ends, slope, _ = found(0.01)
    states = ends.states
    bare = jxr.State(states.q, states.v, states.s)
    for i, force in enumerate((0.5, 0.8, 0.8)):
        (asked,) = jxr.torques(grasp.with_(force=force), ts, bare)
        np.testing.assert_allclose(states.memory[i, 1:2], asked[i], rtol=1e-12)
    np.testing.assert_allclose(states.memory[:, 2], ts + 0.002, rtol=1e-14)
    step = 1e-5
    earlier = [found(0.01 - k * step)[0].last.q for k in (1, 2, 3)]
    onesided = (11 * ends.last.q - 18 * earlier[0] + 9 * earlier[1] - 2 * earlier[2]) / (6 * step)
    np.testing.assert_allclose(slope.last.q, onesided, rtol=1e-5)


def test_the_first_sample_of_a_run_that_begins_at_a_jump_is_asked_after_it(moved_ends):
    """As a sample at a jump within a run is; derivatives in a blow go through what the sample asks for."""
    told, grasp = {"t1": 0.003, "ts": np.array([0.0, 0.0015, 0.003])}, driven_plate()[0]
    found = lambda spin: moved_ends(told | {"blow": 0.0, "spin": spin}, {"spin": 1.0})  # noqa: E731
    ends, slope, _ = found(2e-5)
    held = ends.states.memory
    struck = jxr.State(ends.states.q[0], ends.states.v[0], ends.states.s[0])
    np.testing.assert_allclose(held[0, 1:2], jxr.torques(grasp, 0.0, struck)[0], rtol=1e-12)
    np.testing.assert_allclose(held[:, 2], [0.002, 0.002, 0.004], rtol=1e-14)
    near = [found(spin)[0].last for spin in (1e-5, 3e-5)]
    for part in ("q", "memory"):
        less, more = (getattr(last, part) for last in near)
        np.testing.assert_allclose(getattr(slope.last, part), (more - less) / 2e-5, rtol=1e-6, atol=1e-9)
    # A command's jump whose time is that of the start but for rounding.
    later = moved_ends(told | {"step": 1e-19})[0].states.memory
    np.testing.assert_allclose(later[0, 1:2], jxr.torques(grasp.with_(force=0.8), 0.0, struck)[0], rtol=1e-2)


def test_a_batch_of_periods_and_keys(plate):
    ts = np.array([0.01, 0.02, 0.03])
    last = lambda period, key: pressed_seldom(plate, ts, period, noise=1e-4, key=key).last.q  # noqa: E731
    periods, keys = jnp.array([0.003, 0.004, 0.005]), jax.random.split(KEY, 3)
    together = np.asarray(jax.jit(jax.vmap(last))(periods, keys))
    for i in range(3):
        np.testing.assert_allclose(together[i], last(periods[i], keys[i]), rtol=0, atol=1e-12)
    assert np.abs(together[1] - last(periods[1], keys[0])).max() > 1e-9


# --- verdicts


def test_a_sampled_loop_is_unstable_where_its_damping_overshoots(plate):
    """The plate's damping has a rate of 74 1/s: above some 30 ms a sample more than turns it around.

    The verdict is that of the runs. Without pull, spring and weight nothing brings back plate or disc.
    """
    grasp, at = plate
    sampled = lambda period, **told: grasp.with_(**told).with_(  # noqa: E731
        controller=Sampled(grasp.with_(**told).controller, period)
    )
    plain = jxr.stability.assess(sampled(1e-6), at)  # nearly the loop that is not sampled
    assert -63 < plain.rates.real.min() < -61  # what the pull leaves of it
    rest = plain.equilibrium.state
    way = np.asarray(plain.modes)[:, 0]
    apart = jxr.State(rest.q, 1e-6 * way / np.linalg.norm(way), rest.s)
    still = jxr.State(rest.q, rest.v, rest.s)
    for period, verdict in ((0.027, "asymptotically_stable"), (0.033, "unstable")):
        found = jxr.stability.assess(sampled(period), still)
        assert str(found.verdict) == verdict
        # The fastest mode, disturbed a little, turns the plate around with each sample: by exp(rate T).
        rates = np.asarray(found.rates)
        fastest = rates[np.argmax(np.abs(rates.imag))]
        run = pressed_seldom(plate, period * np.array([3, 4, 5]), period, state=apart)
        changes = np.diff(run.states.v[:, 3])
        growth = -changes[1] / changes[0]
        assert (growth > 1.0) == (fastest.real > 0) == (verdict == "unstable")
        assert growth == pytest.approx(np.exp(fastest.real * period), rel=0.01)
    idle = [Spring(0.0, (0.0, 0.05)), Drag(0.2)]
    free = sampled(0.002, force=0.0, gravity=np.zeros(2), load=idle)
    assert str(jxr.stability.assess(free, still).verdict) == "neutral"


def test_rates_with_a_memory_against_the_linearised_augmented_system(loaded, pulled_chapter):
    """By differences of the chapter's own equations, on all 18 numbers and the memory."""
    found, chapter = loaded[1], pulled_chapter
    assert found.equilibrium.found and found.rates.shape == (8 + 3,)
    law = law_of_chapter(chapter)

    def rates(y):
        u, change = law(0.0, y[:8], y[8:16], y[18:])
        a = chapter.accelerations(y[:8], y[8:16], y[16:18], 0.0, u)[0]
        return np.concatenate([y[8:16], a, chapter.rolling(y[8:16], y[16:18]), change])

    rest = at_rest(*loaded)
    assert np.abs(chapter.constraints(rest[0], rest[2])).max() < 1e-14
    y0 = np.concatenate(rest)
    assert np.abs(rates(y0)).max() < 1e-9
    jacobian = np.array([(rates(y0 + h) - rates(y0 - h)) / 2e-6 for h in 1e-6 * np.eye(21)]).T
    values = np.linalg.eigvals(jacobian)
    # Off the constraints nothing moves: there the eigenvalues are zero, to the root of the differences.
    for rate in np.asarray(found.rates):
        assert np.abs(values - rate).min() < 1e-3 * max(1.0, abs(rate))


class Leaky(eqx.Module):
    """A caller's own law: a pull towards a point, and an integral of the height that leaks."""

    memory: jax.Array

    def __call__(self, t, angles, rates, tips, memory):
        pull = 50.0 * (tips[0].position - jnp.array([0.003, 0.01]))
        torque = -8.0 * rates[0] - tips[0].jacobian.T @ pull - 40.0 * memory[0] * tips[0].jacobian[1]
        return (torque,), tips[0].position[1:] - 0.002 - 3.0 * memory


class Stepped(Leaky):
    """The same for samples of a microsecond, which ask for the next memory: by one of Euler's steps."""

    def __call__(self, t, angles, rates, tips, memory):
        torques, change = Leaky.__call__(self, t, angles, rates, tips, memory)
        return torques, memory + 1e-6 * change


def test_rates_with_a_memory_of_ones_own_and_sampled(plate):
    """The first against the eigenvalues of all that is integrated; sampled often, both loops are the same."""
    grasp, state = plate
    acted = grasp.with_(controller=Leaky(jnp.zeros(1)))
    found = jxr.stability.assess(acted, state)
    assert found.equilibrium.found and abs(float(found.equilibrium.state.memory[0])) > 1e-4
    rest, field = found.equilibrium.state, jxr.vector_field(acted)
    jacobian = jax.jit(jax.jacfwd(lambda y: field(0.0, y)))(field.start(rest))
    values = np.linalg.eigvals(np.asarray(jacobian))
    for rate in np.asarray(found.rates):
        assert np.abs(values - rate).min() < 1e-6 * max(1.0, abs(rate))
    often = jxr.stability.assess(grasp.with_(controller=Sampled(Stepped(jnp.zeros(1)), 1e-6)), state)
    same = {"rtol": 2e-3, "atol": 1e-3}
    np.testing.assert_allclose(np.sort(np.abs(often.rates)), np.sort(np.abs(found.rates)), **same)


def test_a_law_that_has_rates_alone_is_sampled_by_eulers_step():
    law = SimpleNamespace(driven=lambda t, fingers, memory: ((fingers, t), (3.0, -4.0 * memory[1])))
    torques, later = AbstractController.stepped(law, 0.5, "fingers", (1.0, 2.0), 0.1)
    assert torques == ("fingers", 0.5)
    np.testing.assert_allclose(later, [1.3, 1.2], rtol=1e-15)


# --- sentences


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda c: Sampled(c, 0.0), "period must be positive"),
        (lambda c: Sampled(c, 0.1, angle_noise=-1.0), "angle_noise must be zero or more"),
        (lambda c: Sampled(c, 0.1, rate_noise=0.1), "key must be a key"),
        (lambda c: Sampled(c, 0.1, key=3), "key must be one key"),
        (lambda c: Sampled(Sampled(c, 0.1), 0.1), "must not be sampled"),
        (lambda c: Integral(Sampled(c, 0.1), {"x": 0.0}, 1.0), "must not be sampled"),
        (lambda c: Integral(c, {"x": 0.0}, [1.0, 2.0]), "gain"),
    ],
)
def test_bad_arguments(pinch, make, words):
    with pytest.raises(ValueError, match=words):
        pinch[0].with_(controller=make(pinch[0].controller))


def test_memories_that_do_not_fit(pinch):
    grasp, state = pinch
    acted = grasp.with_(controller=integral(grasp.controller))
    with pytest.raises(ValueError, match="memory must have shape"):
        jxr.simulate(acted, jxr.State(state.q, state.v, state.s, [0.0]), 0.1)
    with pytest.raises(ValueError, match="must be None"):
        jxr.simulate(grasp, jxr.State(state.q, state.v, state.s, [0.0]), 0.1)
    with pytest.raises(ValueError, match="sampled"):
        jxr.vector_field(grasp.with_(controller=Sampled(grasp.controller, 0.1)))
    with pytest.raises(ValueError, match="memory must have shape"):
        grasp.with_(controller=PI(jnp.zeros((1, 1))))


def test_a_state_goes_on_at_its_own_time(pinch):
    """At another one its torques would be held until a sample that is periods away."""
    grasp, state = pinch
    sampled = grasp.with_(controller=Sampled(grasp.controller, 0.01))
    waiting = lambda due: jxr.State(state.q, state.v, state.s, [*[0.0] * 5, due])  # noqa: E731
    check_due(sampled, waiting(0.11), 0.1)
    check_due(sampled, waiting(0.1), 0.3)  # overdue: it is asked at once
    check_due(sampled, state, 7.0)
    check_due(sampled.with_(first=0.5), waiting(0.5), 0.0)
    check_due(grasp, state, 0.0)
    with pytest.raises(
        ValueError, match="t0 must be at most the period of 0.01 s before .* at 0.11 s, but was 0.09"
    ):
        jxr.simulate(sampled, waiting(0.11), 0.2, t0=0.09)
    # A start that is known is looked at while something else is traced.
    t0 = jnp.asarray(0.1)
    assert jax.eval_shape(lambda x: check_due(sampled, waiting(0.11), t0), 0.0) is None


def test_other_numbers_of_a_law_inside(pinch):
    grasp, _ = pinch
    acted = grasp.with_(controller=Sampled(integral(grasp.controller), PERIOD))
    changed = acted.with_(damping=0.01, gain=2.0, period=0.1)
    assert changed.controller.law.law.damping[0] == 0.01 and changed.controller.period == 0.1
    with pytest.raises(ValueError, match="target"):
        acted.with_(target=1.0)


def test_the_chapters_quantities_are_those_of_the_law_inside(pinch, loaded):
    grasp, state = pinch
    unloaded = loaded[0].with_(load=jax.tree_util.Partial(pulling, jnp.zeros(2)))
    inside = jxr.pinch_balance(unloaded, 0.0, state)
    plain = jxr.pinch_balance(grasp, 0.0, state)
    np.testing.assert_allclose(inside.n, plain.n, rtol=1e-14)
    np.testing.assert_allclose(inside.delta_f, plain.delta_f, rtol=1e-10)


def slowed(numbers, t, q, v, tip):
    """Torques of a brake, and constant ones."""
    brake, constant = numbers
    return (brake * v[0] + constant,)


slope_of = jax.jit(lambda field, y: field(0.0, y))


@pytest.mark.parametrize("sampled", [False, True], ids=["integral", "sampled"])
def test_loci_have_the_accelerations_of_a_controller_with_a_memory(sampled):
    """By differences of the contact points, which move under the torques that its memory asks for."""
    finger = jxr.Finger3([(0, 0, 1)], [(0, 0.1, 0)], [0.02], jxr.Sphere(0.01))
    ball = jxr.FreeObject3(jxr.Sphere(0.02), 0.05, 8e-6)
    grasp = jxr.Grasp(ball, [finger], [jxr.Contact3()], gravity=(0, 0, -9.81))
    # The tip touches the ball at (0.01, 0.1, 0), moves there by (-0.2, 0.02, 0) and turns by (0, 0, 2).
    q, places = [0.03, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.01, 0.0, 0.0, -0.02, 0.0, 0.0]
    v = [-0.2, 0.04, -0.02, 1.0, 1.0, 1.0, 2.0]
    held = np.array([-2e-3])
    *numbers, gain = map(jnp.asarray, (0.0, held, 0.0) if sampled else (-0.01, np.zeros(1), 2.0))
    law = jax.tree_util.Partial(slowed, numbers)
    grasp = grasp.with_(controller=Integral(law, {"x": 0.0}, gain))
    slope, h = functools.partial(slope_of, jxr.vector_field(grasp)), 1e-4
    begin, ts = np.concatenate([q, v, places, [-0.03]]), h * np.arange(-2.0, 3.0)
    parts = np.split(np.stack([runge_kutta_step(slope, begin, t) for t in ts]), [8, 15, 21], axis=1)
    if sampled:
        # Between samples what is held is constant, whatever the law would say now.
        grasp = grasp.with_(controller=Sampled(lambda t, q, v, tip: (0.01 * q[0] - 0.002 * v[0],), 0.02))
        parts[3] = np.tile(np.append(held, 0.04), (5, 1))
    locus = _loci(grasp, ts, jxr.State(*parts)).object
    p = np.asarray(locus.point)[0]
    v = (p[0] - 8 * p[1] + 8 * p[3] - p[4]) / (12 * h)
    a = (-p[0] + 16 * p[1] - 30 * p[2] + 16 * p[3] - p[4]) / (12 * h**2)
    bent = a @ np.cross(ball.surfaces[0].normal(p[2]), v) / np.linalg.norm(v) ** 3
    np.testing.assert_allclose(locus.geodesic_curvature[0, 2], bent, rtol=1e-6)
