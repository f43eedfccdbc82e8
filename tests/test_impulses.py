"""Velocities that change at once, against dense linear algebra, closed forms and runs in two pieces."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.loads import Impulse
from tests.oracles import reference_space as reference
from tests.oracles.dense_impacts import dense_strike
from tests.recorded import runs
from tests.subjects.disc_on_a_hill import disc_on_a_hill
from tests.subjects.driven_plate import driven_plate
from tests.subjects.pinches_in_space import same_in_reference


@pytest.fixture(scope="module")
def pinch():
    return runs.scene("pinch")


@pytest.fixture(scope="module")
def pivoted():
    return runs.scene("pivoted")


def compatible(rows, v):
    """The velocities nearest to `v` that keep the gaps with these rows closed."""
    rows = np.asarray(rows)
    return v - np.linalg.pinv(rows) @ (rows @ v)


def moving_pinch(grasp, state):
    """A state in motion, and what stands in the equations there."""
    terms = jxr.equation_terms(grasp, state)  # of its pose alone, but for the bias
    wild = np.asarray(state.v) + np.linspace(-0.4, 0.5, 8)
    v = compatible(np.concatenate([terms.normal, terms.tangential]), wild)
    moving = jxr.State(state.q, v, state.s)
    return moving, jxr.equation_terms(grasp, moving)


def blow(when, share=1.0):
    """It strikes a disc that rolls down a hill forwards and onto it, which presses all the more."""
    return Impulse(share * np.array([1e-3, -2e-3]), when, angular=-2e-5 * share)


# The same program for every run without a blow.
EVERY = {"ts": 3, "rtol": 1e-12, "record": ("energy",)}


@pytest.fixture(scope="module")
def disc():
    """A disc that begins to roll down a hill, and one that has rolled for 0.06 s."""
    grasp, state = disc_on_a_hill(reach=0.06)
    return grasp, state, jxr.simulate(grasp, state, 0.06, **EVERY).last


def test_a_blow_in_the_plane_against_the_dense_equations(pinch):
    grasp, state = pinch
    moving, terms = moving_pinch(grasp, state)
    push, point, turn = np.array([1e-4, 2e-4]), np.array([0.004, 0.007]), 3e-7
    hit = jxr.strike(grasp, moving, Impulse(push, 0.0, point=point, angular=turn), events=())
    theta = float(moving.q[2])
    arm = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]]) @ point
    p = np.zeros(8)
    p[:3] = *push, arm[0] * push[1] - arm[1] * push[0] + turn
    # The rows of f and lambda stand on the left of (1)-(3): their impulses act with the other sign.
    rows = np.concatenate([terms.normal, terms.tangential])
    v, forces = dense_strike(np.asarray(terms.mass), rows, np.asarray(moving.v), p)
    np.testing.assert_allclose(hit.state.v, v, rtol=1e-11, atol=1e-14)
    found = np.concatenate([hit.multipliers.f, hit.multipliers.lam])
    np.testing.assert_allclose(found, -forces, rtol=1e-10, atol=1e-16)
    assert float(hit.work) == pytest.approx(p @ (v + np.asarray(moving.v)) / 2, rel=1e-11)
    energy = [float(jxr.energies(grasp, s)[0]) for s in (moving, hit.state)]
    assert energy[1] - energy[0] == pytest.approx(float(hit.work), rel=1e-10)


def test_a_blow_in_space_against_the_dense_equations():
    grasp, state = runs.scene("pinch3d")
    plain, q = same_in_reference(grasp), np.asarray(state.q)
    v = np.asarray(state.v) + np.linspace(-0.4, 0.5, 12)
    v = compatible(reference.equations(plain, q, v)[3], v)
    moving = jxr.State(state.q, v, state.s)
    push, point, turn = (
        np.array([1e-4, -2e-4, 3e-4]),
        np.array([0.004, 0.007, -0.003]),
        np.array([1, 2, -3]) * 1e-7,
    )
    blow = Impulse(push, 0.0, point=point, angular=turn)
    hit = jxr.strike(grasp, moving, blow, events=())
    M, _, _, A, _, _ = reference.equations(plain, q, v)
    R = reference.quaternion_matrix(q[3:7])
    p = np.zeros(len(v))
    p[:3], p[3:6] = push, R.T @ (np.cross(R @ point, push) + turn)  # spins are in body axes
    after, _ = dense_strike(M, A, v, p)
    np.testing.assert_allclose(hit.state.v, after, rtol=1e-9, atol=1e-12)
    assert float(hit.work) == pytest.approx(p @ (after + v) / 2, rel=1e-9)


def test_a_ball_that_is_hit_rolls_on_with_five_sevenths():
    """P along the floor: v = P / (m + I/r^2), and the floor gives back 2/7 of it."""
    grasp, state = jxr.scenes.incline(slope=0.0)
    hit = jxr.strike(grasp, state, Impulse((0.021, 0.042, 0.0), 0.0))
    np.testing.assert_allclose(
        hit.state.v[:3], np.array([0.021, 0.042, 0.0]) * 5 / 7 / 0.3, rtol=1e-13, atol=1e-16
    )
    np.testing.assert_allclose(hit.multipliers.lam[0], [-0.006, -0.012, 0.0], rtol=1e-13, atol=1e-16)
    assert bool(hit.result == jxr.RESULTS.successful)
    rough = grasp.with_contacts(jxr.Contact3(friction=0.5))
    hit_at = lambda *push, **more: jxr.strike(rough, state, Impulse(push, 0.0), **more)  # noqa: E731
    # Along the floor there is no normal impulse for friction to work with; half downwards there is.
    assert bool(hit_at(0.042, 0.0, 0.0).result == jxr.RESULTS.slipping)
    assert bool(hit_at(0.042, 0.0, -0.042).result == jxr.RESULTS.successful)
    assert bool(hit_at(0.042, 0.0, 0.0, events=()).result == jxr.RESULTS.successful)
    # What a blow cannot cause is not watched for: it moves nothing.
    with pytest.raises(ValueError, match="argument events must .*'penetration'"):
        hit_at(0.042, 0.0, 0.0, events=("penetration",))
    # Along a slope the normal impulse is rounding alone, in single precision too.
    grasp_on, on_slope = jax.tree.map(lambda x: x.astype(jnp.float32), jxr.scenes.incline(slope=0.3))
    turns, along = np.linspace(0.0, 2.0 * np.pi, 8), np.array([np.cos(0.3), 0.0, -np.sin(0.3)])
    blows = 0.03 * (np.outer(np.cos(turns), along) + np.outer(np.sin(turns), [0.0, 1.0, 0.0]))
    hits = jax.vmap(lambda p: jxr.strike(grasp_on, on_slope, Impulse(p, 0.0)))(blows.astype(np.float32))
    assert set(hits.result.names) == {"successful"}
    up = hit_at(0.0, 0.0, 0.042)
    assert bool(up.result == jxr.RESULTS.contact_lost)
    assert float(up.multipliers.f[0]) == pytest.approx(-0.042)


def test_gaps_that_close_are_brought_to_rest(pivoted):
    """A blow of no size: the nearest velocities in the mass metric, and never more energy."""
    grasp, state = pivoted
    wild = jxr.State(state.q, jnp.array([3.0, -2.0, 1.0]), state.s)
    after = jxr.strike(grasp, wild, Impulse((0.0, 0.0), 0.0), events=()).state
    terms = jxr.equation_terms(grasp, state)
    rows = np.concatenate([terms.normal, terms.tangential])
    v, _ = dense_strike(np.asarray(terms.mass), rows, np.asarray(wild.v), np.zeros(3))
    np.testing.assert_allclose(after.v, v, rtol=1e-12)
    assert float(jxr.energies(grasp, after)[0]) < float(jxr.energies(grasp, wild)[0])


def test_a_run_with_a_blow_is_two_runs(disc):
    grasp, state, first = disc
    hit = grasp.with_(load=blow(0.06))
    run = jxr.simulate(hit, state, 0.15, **EVERY | {"ts": [0.03, 0.06, 0.15]})
    struck = jxr.strike(grasp, first, blow(0.06))
    assert bool(struck.result == jxr.RESULTS.successful) and float(struck.multipliers.f[0]) > 0
    second = jxr.simulate(grasp, struck.state, 0.15, t0=0.06, **EVERY).last
    np.testing.assert_allclose(run.states.v[1], struck.state.v, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(run.last.q, second.q, rtol=0, atol=1e-12)
    assert abs(np.asarray(run.energy.residual)).max() < 1e-9 * float(np.max(run.energy.kinetic))
    assert abs(np.asarray(run.residuals.normal)).max() < 1e-15
    # At the start and at the end of a run it acts too; before it and after it, it does not.
    begun = jxr.simulate(hit, first, 0.15, t0=0.06, **EVERY).last
    np.testing.assert_allclose(begun.q, second.q, rtol=0, atol=1e-12)
    ended = jxr.simulate(hit, state, 0.06, **EVERY)
    np.testing.assert_allclose(ended.last.v, struck.state.v, rtol=1e-10, atol=1e-12)
    assert float(ended.stats.t_end) == pytest.approx(0.06, abs=1e-15)
    past = jxr.simulate(hit, struck.state, 0.15, t0=0.0601, **EVERY).last
    plain = jxr.simulate(grasp, struck.state, 0.15, t0=0.0601, **EVERY).last
    np.testing.assert_allclose(past.q, plain.q, rtol=0, atol=1e-14)


def growing(pull, t, pose, twist):
    """A torque that turns the object until a contour ends."""
    return jnp.zeros(2), pull * t


def rolled(x, t1):
    """Of a struck disc on its hill: where it is, its velocity, the time, and the blow's contact impulses.

    By a blow's time, impulse, angular impulse and place, and by what grows: a vector of 7 numbers.
    """
    blow = Impulse(x[1:3], x[0], angular=x[3], point=x[4:6])
    scene = disc_on_a_hill(load=(blow, jax.tree_util.Partial(growing, x[6])))
    run = jxr.simulate(*scene, t1, ts=1, throw=False, rtol=1e-12, record=("multipliers",))
    forces = jnp.stack([run.impulses.f[0, 0], run.impulses.lam[0, 0]])
    return jnp.concatenate([run.last.q, run.last.v, run.stats.t_end[None], forces])


@jax.jit
def both(x, t1, along, bar):
    """What `rolled` says, its derivative along a direction, and the gradient of a weighted sum."""
    values, push = jax.linearize(lambda x: rolled(x, t1), x)
    return values, push(along), jax.linear_transpose(push, x)(bar)[0]


ROLLED = lambda *given: both(*(jnp.asarray(x, float) for x in given))  # noqa: E731


def test_derivatives_of_a_blow():
    """Of the end and the contact impulse, in the blow's time, size and place: in both modes, and a batch."""
    x = np.array([0.06, 1e-3, -2e-3, -2e-5, 0.003, 0.004, 0.0])
    steps = np.array([1e-5, 1e-6, 1e-6, 1e-7, 1e-5, 1e-5])
    weights = np.array([[1.0, -0.7, 0.004, *np.zeros(6)], [*np.zeros(7), 3.0, -2.1]])
    moves = np.eye(6, 7) * steps[:, None]
    near = np.concatenate([x + moves, x - moves, x[None]])
    many = np.asarray(jax.jit(jax.vmap(rolled, (0, None)))(near, 0.12))
    wanted = (many[:6] - many[6:12]) @ weights.T / (2 * steps[:, None])
    along = np.cos(np.arange(6.0)) @ moves
    value, forward, reverse = ROLLED(x, 0.12, along, weights.sum(axis=0))
    np.testing.assert_allclose(reverse[:6], wanted.sum(axis=1), rtol=1e-7)
    np.testing.assert_allclose(weights.sum(axis=0) @ forward, reverse @ along, rtol=1e-9)
    np.testing.assert_allclose(many[12] @ weights.T, value @ weights.T, rtol=1e-11)
    sizes = np.abs(wanted)
    assert (sizes.min(axis=1) > 0.1 * sizes.max(axis=1)).all()  # neither is lost in the sum


@pytest.mark.parametrize("when", [0.02, 0.9], ids=["after a blow", "before a blow"])
def test_an_end_moves_with_what_brings_it_about_in_runs_with_blows_too(when):
    """In a torque and in the time of a blow, in both modes."""
    at, ways = np.array([when, 0.0, 0.0, 1e-6, 0.0, 0.0, -0.005]), np.eye(7)[[6, 0]]
    bars, step = np.eye(9)[3:7], 1e-5
    seen = lambda x: np.asarray(ROLLED(x, 1.0, ways[0], bars[0])[0])[3:7]  # noqa: E731
    assert 0.02 < seen(at)[-1] < 0.9
    wanted = np.array([(seen(at + step * way) - seen(at - step * way)) / (2.0 * step) for way in ways]).T
    assert (abs(wanted[:, 0]) > 0.1).all() and (when == 0.9) == (not wanted[:, 1].any())
    reverse = np.array([ROLLED(at, 1.0, ways[0], bar)[2] for bar in bars])[:, [6, 0]]
    np.testing.assert_allclose(reverse, wanted, rtol=1e-5, atol=1e-8)
    forwards = np.array([ROLLED(at, 1.0, way, bars[0])[1] for way in ways]).T[3:7]
    np.testing.assert_allclose(forwards, reverse, rtol=1e-9, atol=1e-12)


def test_a_blow_that_contacts_cannot_answer_ends_the_run():
    """With the state before it, to go on from; away from the plate, which would have to pull."""
    grasp, state = driven_plate()
    hit = grasp.with_(load=Impulse((0.0, 1e-3), 0.1))
    run = jxr.simulate(hit, state, 0.2, ts=1, throw=False)
    assert bool(run.result == jxr.RESULTS.contact_lost)
    assert float(run.stats.t_end) == pytest.approx(0.1, abs=1e-15)
    # The same program: of a blow that is still to come.
    later = grasp.with_(load=Impulse((0.0, 1e-3), 0.9))
    before = jxr.simulate(later, state, 0.1, ts=1).last
    np.testing.assert_allclose(run.last.v, before.v, rtol=0, atol=1e-6)
    assert "no longer presses at t = 0.1 s" in str(run) and "inf" not in str(run)
    held = jxr.simulate(hit, state, 0.2, ts=1, events=())
    assert bool(held.result == jxr.RESULTS.successful)


def test_blows_at_one_time_add_up(disc):
    grasp, state, _ = disc
    # One of them some rounding units later, as a time that was summed up is; and one that is still to come.
    halves = [(blow(0.06, 0.5), blow(when, 0.5)) for when in (0.06, 0.06 + 1e-16)]
    assert float(halves[1][1].time) > 0.06
    every = [*halves, (blow(0.06), blow(0.9))]
    ends = [jxr.simulate(grasp.with_(load=blows), state, 0.15, ts=1).last.q for blows in every]
    np.testing.assert_allclose(ends[0], ends[2], rtol=0, atol=1e-13)
    np.testing.assert_allclose(ends[1], ends[2], rtol=0, atol=1e-13)
    without = jxr.simulate(grasp, state, 0.15, **EVERY).last.q
    assert abs(np.asarray(ends[2] - without))[0] > 1e-3


def test_torques_and_accelerations_of_states(pivoted, pinch):
    """(75) and (16) line by line, and M v' + h = u + A^T mu with the forces of `multipliers`."""
    (grasp, _), run = pivoted, runs.run("pivoted")
    (u,) = jxr.torques(grasp, run.ts, run.states)
    control, lengths = grasp.controller, np.asarray(grasp.fingers[0].lengths)
    for i in range(3):
        q, rate = np.asarray(run.states.q[i, 1:]), np.asarray(run.states.v[i, 1:])
        along = np.cumsum(q)
        links = lengths[:, None] * np.stack([np.cos(along), np.sin(along)], axis=1)
        tip = np.asarray(grasp.fingers[0].base) + links.sum(axis=0)
        arms = np.stack([links[j:].sum(axis=0) for j in range(2)])
        jacobian = np.stack([-arms[:, 1], arms[:, 0]])
        pull = float(control.force / control.radius) * (tip - np.asarray(control.target))
        np.testing.assert_allclose(u[i], -float(control.damping) * rate - jacobian.T @ pull, rtol=1e-12)
    grasp, state = pinch
    moving, terms = moving_pinch(grasp, state)
    forces = jxr.multipliers(grasp, 0.0, moving)
    drive = np.concatenate([np.zeros(3), *jxr.torques(grasp, 0.0, moving)])
    left = terms.mass @ jxr.accelerations(grasp, 0.0, moving) + terms.bias
    left = left + forces.f @ terms.normal + forces.lam @ terms.tangential
    np.testing.assert_allclose(left, drive, rtol=0, atol=1e-12)


def test_a_run_that_records_forces_has_the_contact_impulses(disc):
    """Those of `strike` at the state before; of two at once those of both, and none of one still to come."""
    grasp, state, before = disc
    hit = grasp.with_(load=[blow(0.06), blow(0.9), blow(0.06, 0.5)])
    ts = np.array([0.03, 0.12])
    run = jxr.simulate(hit, state, 0.12, ts=ts, rtol=1e-12, record=("multipliers",))
    struck = jxr.strike(grasp, before, blow(0.06, 1.5))
    wanted = struck.multipliers
    for part in ("f", "lam"):
        found = np.asarray(getattr(run.impulses, part))
        assert found.shape == (3, 1) and np.isnan(found[1]).all()
        np.testing.assert_allclose(found[::2], np.stack([getattr(wanted, part)] * 2), rtol=1e-9)
    # Saved states and forces are those without the record.
    first = jxr.simulate(grasp, state, ts[0], **EVERY).last
    second = jxr.simulate(grasp, struck.state, ts[1], t0=0.06, **EVERY).last
    np.testing.assert_allclose(run.states.q, [first.q, second.q], rtol=0, atol=1e-12)
    forces = jxr.multipliers(hit, run.ts, run.states)
    np.testing.assert_allclose(run.multipliers.f, forces.f, rtol=1e-12)


def test_an_impulse_is_called_what_its_argument_is_called_and_has_units(pivoted):
    blow = Impulse((0.0, 1e-4, 0.0), 0.1)
    assert "0.0001, 0] N s, time=0.1 s" in repr(blow)
    with pytest.raises(ValueError, match="argument blow must have 2 numbers as impulse, as the grasp's"):
        jxr.strike(*pivoted, blow)
