"""Grasps beyond the chapter's Part 2: a user's controller, free objects, several fingers."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._closing import _search
from jaxroll._mechanics import to_leaves
from jaxroll._motion import Index1
from jaxroll._motion._equations import evaluate
from tests.helpers import in_single
from tests.measures import both_slopes


class Opposing(eqx.Module):
    """A user's controller after (16): damping, and tips that pull towards their common centre."""

    beta: float
    damping: float

    def __call__(self, t, angles, rates, tips):
        centre = sum(tip.position for tip in tips) / len(tips)
        pull = [self.beta * tip.jacobian.T @ (tip.position - centre) for tip in tips]
        return tuple(-self.damping * w - p for w, p in zip(rates, pull, strict=True))


def around(count, tip, contour, controller, gravity=None):
    """Fingers evenly round a free object at the origin, tips on its rim, elbows out."""
    fingers, contacts, guess = [], [], [np.zeros(3)]
    length = 0.02 * 2 * np.pi if isinstance(contour, jxr.Circle) else float(contour.domain()[1])
    for i in range(count):
        angle = 2 * np.pi * i / count
        out = np.array([np.cos(angle), np.sin(angle)])
        fingers.append(jxr.Finger([0.05, 0.05], [0.05, 0.04], tip, base=0.1 * out + 0.02 * out[::-1]))
        s_tip = 0.01 * np.pi - 0.01 * angle  # the side of the tip that faces the object
        contacts.append(jxr.Contact(s_tip, length * i / count, finger=i))
        guess.append(np.array([angle + 2.5, 1.2]))
    body = jxr.FreeObject(contour, mass=0.05, inertia=1.2e-5)
    grasp = jxr.Grasp(body, fingers, contacts, controller=controller, gravity=gravity)
    q = np.concatenate(guess)
    start = jxr.State(jnp.asarray(q), jnp.zeros(q.size), jnp.zeros(count))
    return jxr.close(grasp, start, hold_contacts=False)


def test_a_users_controller_equals_the_built_in_one(scene):
    """(75) written by a user, against control.Press."""
    grasp, state = scene
    target = grasp.controller.target

    def press(t, angles, rates, tips):
        return (-0.006 * rates[0] - 50.0 * tips[0].jacobian.T @ (tips[0].position - target),)

    user = jxr.simulate(grasp.with_(controller=press), state, 0.5, ts=3, rtol=1e-11, record=("energy",))
    built_in = jxr.simulate(grasp, state, 0.5, ts=3, rtol=1e-11)
    np.testing.assert_allclose(user.states.q, built_in.states.q, atol=1e-11)
    # Its potential is unknown, so all its power counts as work; the balance closes all the same.
    assert np.abs(user.energy.residual).max() <= 1e-9 * np.abs(user.energy.work).max()


@pytest.mark.parametrize("count", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_free_objects_between_fingers(count):
    """Rows at rounding level, energy in balance, and the object in Newton's hands, with gravity."""
    contour = jxr.Circle(0.02) if count == 2 else jxr.Ellipse(0.024, 0.018)
    grasp, state = around(count, jxr.Circle(0.01), contour, Opposing(20.0, 0.004), (0.0, -0.5))
    run = jxr.simulate(grasp, state, 0.3, ts=31, rtol=1e-10, record=("multipliers", "energy"))
    left = run.residuals
    assert max(np.abs(x).max() for x in (left.normal, left.tangential, left.tangency)) <= 1e-12
    size = np.abs(np.asarray(run.energy.kinetic)).max() + np.abs(np.asarray(run.energy.work)).max()
    assert np.abs(run.energy.residual).max() <= 1e-8 * size
    assert np.ptp(np.asarray(run.states.s), axis=0).min() > 1e-5  # every contact rolls
    assert np.asarray(run.multipliers.f).min() > 0  # and presses


@pytest.mark.slow
def test_ellipse_and_its_circle_agree():
    """A circular object as Circle and as Ellipse with a table: the same motion."""
    control = Opposing(20.0, 0.004)
    runs = []
    for contour in (jxr.Circle(0.02), jxr.Ellipse(0.02, 0.02)):
        grasp, state = around(2, jxr.Circle(0.01), contour, control, (0.0, -0.5))
        runs.append(jxr.simulate(grasp, state, 0.2, ts=3, rtol=1e-10).states.q)
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-11)


def test_features_that_are_off_cost_nothing(scene):
    """Operation count of the lowered right-hand side: no gravity is no larger than some."""

    def rates(grasp, state):
        ready = grasp.prepared()
        return evaluate(ready, 0.0, to_leaves(state, grasp.form), Index1()).rates

    def lines(gravity):
        grasp, state = scene
        return len(jax.jit(rates).lower(grasp.with_(gravity=gravity), state).as_text().splitlines())

    assert lines(None) < lines((0.0, -9.81))


def test_held_contacts_stay_and_those_that_roll_are_nearer(scene):
    """In the metric of the guess: with held contacts the way is longer than it would have to be."""
    grasp, state = scene
    guess = jxr.State(state.q + jnp.array([0.05, -0.03, 0.04]), state.v, state.s)
    weight, ways = jxr.equation_terms(grasp, guess).mass, {}
    for hold in (True, False):
        found = jxr.close(grasp, guess, hold_contacts=hold)[1]
        ways[hold] = float((found.q - guess.q) @ weight @ (found.q - guess.q))
        assert bool(found.s[0] == guess.s[0]) == hold
    assert ways[False] < 0.6 * ways[True]


@pytest.mark.slow
@pytest.mark.parametrize("hold", [True, False])
def test_single_precision_closes_what_double_precision_closes(scene, hold):
    """A batch of guesses: held contacts, and such that roll."""
    grasp, state = scene
    away = np.random.default_rng(0).normal(size=(3, state.q.shape[0])) * np.array([[1e-4], [1e-3], [5e-3]])

    def closed(grasp, state, away):
        guess = lambda d: jxr.State(state.q + d, state.v, state.s)  # noqa: E731
        close = lambda d: jxr.close(grasp, guess(d), hold_contacts=hold)[1]  # noqa: E731
        return jax.jit(jax.vmap(close))(away)

    found, single = closed(grasp, state, away), in_single(closed, grasp, state, away)
    assert single.q.dtype == jnp.float32
    np.testing.assert_allclose(single.q, found.q, rtol=0, atol=2e-6)
    np.testing.assert_allclose(single.s, found.s, rtol=0, atol=1e-6)


@pytest.mark.parametrize("hold", [pytest.param(True, marks=pytest.mark.slow), False])
def test_the_search_for_a_closed_state_ends_in_single_precision(scene, hold, monkeypatch):
    grasp, state = scene
    ends, loop = [], jax.lax.while_loop
    monkeypatch.setattr(jax.lax, "while_loop", lambda *args: ends.append(loop(*args)) or ends[-1])

    @jax.jit
    def steps(grasp, q, s):
        guess, ready = jxr.State(q, jnp.zeros_like(q), s), grasp.prepared()
        metric = _search.metric_at(ready, guess, hold)
        _search.searched(_search.ClosingProblem(ready, guess, metric, ()))
        return ends[-1].count

    for away, least in ((0.0, 0), (1e-3, 2), (1e-2, 2)):
        assert least <= int(in_single(steps, grasp, state.q + away, state.s)) <= 20, away


@pytest.mark.parametrize("hold", [True, False])
def test_displacements_are_measured_by_the_mass_matrix_and_those_along_contours_hardly(scene, hold):
    grasp, state = scene
    metrics = lambda state: [_search.metric_at(grasp.prepared(), state, hold, kept) for kept in ((), (1,))]  # noqa: E731
    found, held = map(np.asarray, jax.jit(metrics)(state))
    n, slack = len(state.q), 0 if hold else 1
    assert found.shape == (n + slack, n + slack)
    # The object turns about its pivot by itself; finger and object are coupled by nothing but forces.
    assert found[0, 0] > 0.0 and not found[0, 1:].any()
    moving = found[:n, :n]
    np.testing.assert_allclose(np.trace(moving), n)
    np.testing.assert_allclose(held, np.delete(np.delete(found, 1, axis=0), 1, axis=1))
    # Of two rods in a row, by hand; q[1] is the angle between them.
    links = grasp.fingers[0]
    (length, _), (m1, m2), (c1, c2), (i1, i2) = (
        np.asarray(x) for x in (links.lengths, links.masses, links.centres, links.inertias)
    )
    last = m2 * c2**2 + i2
    first = m1 * c1**2 + i1 + last + m2 * (length**2 + 2.0 * length * c2 * np.cos(state.q[2]))
    coupled = last + m2 * length * c2 * np.cos(state.q[2])
    wanted = np.array([[first, coupled], [coupled, last]]) / np.asarray(grasp.object.inertia)
    np.testing.assert_allclose(moving[1:, 1:] / moving[0, 0], wanted, rtol=1e-12)
    if not hold:
        np.testing.assert_allclose(found[n], 1e-3 * (np.arange(n + 1) == n))


def test_redundant_rows_are_solved_in_single_precision():
    """A row twice: the shortest step in the metric, by the pseudo-inverse."""
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(2, 5))
    rows, right = np.concatenate([rows, rows[:1]]), rng.normal(size=2)
    right = np.append(right, right[0])
    metric = np.diag(rng.uniform(0.5, 2.0, 5))
    half = np.sqrt(np.linalg.inv(metric))
    wanted = half @ np.linalg.pinv(rows @ half) @ right
    _, steps, _ = in_single(_search.solve_schur, rows, metric, right[:, None])
    assert steps.dtype == jnp.float32
    np.testing.assert_allclose(steps[:, 0], wanted, rtol=1e-4, atol=1e-5)


def test_what_is_held_stays_while_the_rest_closes(scene):
    """Three rows determine the three unknowns that are left, whatever else the guess says of them."""
    grasp, state = scene
    off = jxr.State(state.q + jnp.array([0.0, 0.05, -0.04]), state.v, state.s)

    def closed(q, names):
        found = jxr.close(grasp, jxr.State(q, off.v, off.s), hold_contacts=False, hold=names)[1]
        return found.q, found

    slopes_and_state = jax.jit(jax.jacfwd(lambda q: closed(q, "object"), has_aux=True))
    step = 1e-5 * np.array([1.0, 0.0, 0.0])
    slopes, with_the_object = slopes_and_state(off.q)
    for held, found in ((0, with_the_object), (2, closed(off.q, ("finger 0 q[1]",))[1])):
        assert float(found.q[held]) == float(off.q[held])
        left = jxr.residuals(grasp, found)
        assert max(float(abs(part).max()) for part in (left.normal, left.tangential, left.tangency)) <= 1e-14
    np.testing.assert_allclose(slopes[:, 1:], 0.0, atol=1e-12)
    ahead, behind = (slopes_and_state(off.q + k * step)[1].q for k in (1.0, -1.0))
    np.testing.assert_allclose(slopes[:, 0], (ahead - behind) / 2e-5, rtol=1e-7)


def test_the_rest_of_what_is_held_has_a_derivative_where_it_is_the_nearest_of_many(scene):
    """More unknowns than rows: the shortest way onto the constraints, among those that leave the rest."""
    # The scene's last link in two halves, and the joint between these straight.
    finger = jxr.Finger([0.065, 0.0325, 0.0325], [0.04, 0.02, 0.02], scene[0].fingers[0].tip)
    grasp, q = scene[0].with_(fingers=(finger,)), np.append(scene[1].q, 0.0)
    state = jxr.State(q, np.zeros(4), scene[1].s)
    way = jnp.array([0.3, 0.5, -0.4, 0.6])

    def closed(x):
        guess = jxr.State(state.q + x * way, state.v, state.s)
        found = jxr.close(grasp, guess, hold_contacts=False, hold="finger 0 q[0]")[1]
        return found.q @ jnp.cos(jnp.arange(4.0))

    at, step, both = 1e-3, 1e-5, both_slopes(closed)
    wanted = (both(at + step)[0] - both(at - step)[0]) / (2.0 * step)
    np.testing.assert_allclose(both(at)[1:], wanted, atol=1e-6)


@pytest.mark.parametrize("names", ["thumb", "object x", ["finger 0", "object"], 3, None, [0]])
def test_names_that_are_not_held_are_refused(scene, names):
    with pytest.raises(ValueError, match="argument hold must"):
        jxr.close(*scene, hold=names)


def test_a_pose_that_cannot_be_closed_names_what_was_held(scene):
    """A finger of two joints alone cannot close a gap, a tangency and where both contours touch."""
    grasp, state = scene
    off = jxr.State(state.q.at[0].add(0.1), state.v, state.s)
    with pytest.raises(ValueError, match=r"best found while \['object'\] is held leaves the"):
        jxr.close(grasp, off, hold=["object"])
