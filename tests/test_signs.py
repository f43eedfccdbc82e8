"""Signs and frames: what is reported is the chapter's quantity, in a grasp and in its mirror image alike."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from tests.oracles.chapter_part2 import Part2
from tests.recorded import runs
from tests.subjects.mirror_images import MIRROR, mirrored


def fields(*modules):
    found = {f.name: getattr(m, f.name) for m in modules for f in dataclasses.fields(m)}
    # None: what only contacts in space have.
    return {name: np.asarray(value) for name, value in found.items() if value is not None}


@pytest.mark.parametrize("name", ["pivoted", "pinch"])
def test_a_mirror_image_with_the_other_sense_has_the_chapters_same_quantities(name):
    """Every quantity of Parts 1 and 2 that is reported, in motion and off the constraints by 0.1 mm."""
    grasp, state = runs.scene(name)
    rng = np.random.default_rng(0)
    v = jnp.asarray(rng.normal(size=state.v.shape))
    off = jxr.State(state.q + 1e-3 * rng.normal(size=v.shape), v, state.s + 1e-3)
    image, seen = mirrored(grasp, off)
    balance = jxr.press_balance if name == "pivoted" else jxr.pinch_balance
    quantities = []
    for one, at in ((grasp, off), (image, seen)):
        # In one program, in which XLA sees what they have in common.
        parts = jax.jit(lambda g, x: (balance(g, 0.0, x), jxr.residuals(g, x), jxr.multipliers(g, 0.0, x)))
        quantities.append(fields(*parts(one, at)))
    here, there = quantities
    assert set(here) >= {"s", "delta_f", "delta_lam", "normal", "tangential", "f", "lam", "potential"}
    for key, values in here.items():
        sign = -1.0 if key == "tangency" else 1.0  # an angle in the world, no quantity of the chapter's
        assert np.abs(values).max() > 0, key
        np.testing.assert_allclose(there[key], sign * values, rtol=1e-9, atol=1e-13, err_msg=key)


def test_residuals_are_64_and_65(scene):
    """With the finger's base moved aside: the printed (64)-(65), from the chapter's lengths and angles."""
    grasp, state = scene
    chapter, s = Part2(), 0.003
    moved = eqx.tree_at(lambda g: g.fingers[0].base, grasp, jnp.array([3e-4, -2e-4]))
    left = jxr.residuals(moved, state)
    theta, p = float(state.q[0]), np.cumsum(state.q[1:])
    tip = np.array([3e-4, 2e-4]) + 0.065 * np.sum([[np.cos(a), -np.sin(a)] for a in p], axis=0)
    (dx, dy), turn = tip - chapter.pivot, theta + float(chapter.angles(s)[0])
    l_b0, l_b1, l_n0, l_n1 = (float(x) for x in chapter.lengths(s))
    r = dx * np.sin(turn) + dy * np.cos(turn) + l_b0 + l_b1
    q = dx * np.cos(turn) - dy * np.sin(turn) + l_n0 + l_n1
    assert min(abs(r), abs(q)) > 1e-5
    np.testing.assert_allclose([left.normal[0], left.tangential[0]], [q, r], atol=1e-14)


def test_residuals_are_5_and_6():
    """(5)-(6) of a rectangle moved aside by (dx, dy): n_01 points right, n_02 left, b_01 and b_02 down."""
    grasp, state = runs.scene("pinch")
    dx, dy = 3e-5, -2e-5
    c, s = np.cos(float(state.q[2])), np.sin(float(state.q[2]))
    moved = jxr.State(state.q + jnp.array([c * dx - s * dy, s * dx + c * dy, *[0.0] * 6]), state.v, state.s)
    left = jxr.residuals(grasp, moved)
    np.testing.assert_allclose(left.normal, [-dx, dx], atol=1e-14)
    np.testing.assert_allclose(left.tangential, [dy, dy], atol=1e-14)


def test_overlap_is_a_positive_residual_in_space_too():
    """A ball pushed 10 um into its table, and 20 um aside."""
    grasp = jxr.Grasp(jxr.FreeObject3(jxr.Sphere(0.02), 0.05, 8e-6), jxr.Stage(jxr.Plane()), jxr.Contact3())
    q, places = jnp.array([2e-5, 0.0, 0.02 - 1e-5, 1.0, 0.0, 0.0, 0.0]), jnp.array([0, 0, 0, 0, 0, -0.02])
    left = jxr.residuals(grasp, jxr.State(q, jnp.zeros(6), places))
    assert float(left.normal[0]) == pytest.approx(1e-5, rel=1e-9)
    np.testing.assert_allclose(left.tangential, [[-2e-5, 0.0, 0.0]], atol=1e-14)


def test_the_angles_of_the_pivoted_scene_are_those_of_58(scene):
    """b_1 = b_0 as (58) prints them, in the chapter's frame; (59) then gives the normals."""
    grasp, state = scene
    theta1, psi0 = Part2().angles(0.003)
    turn, p = state.q[0] + theta1, state.q[1] + state.q[2] + psi0
    b_1, b_0 = jnp.array([jnp.sin(turn), jnp.cos(turn)]), jnp.array([-jnp.cos(p), jnp.sin(p)])
    np.testing.assert_allclose(b_1, b_0, atol=1e-13)
    tangent = grasp.object.contours[0].tangent(grasp.contacts[0].s_object)
    c, s = jnp.cos(state.q[0]), jnp.sin(state.q[0])
    world = jnp.array([c * tangent[0] - s * tangent[1], s * tangent[0] + c * tangent[1]])
    np.testing.assert_allclose(MIRROR * world, b_1, atol=1e-13)


def test_csm_pulls_q_and_r_back_as_its_gains_say(scene):
    r"""$\ddot Q + \gamma \dot Q + \omega Q = 0$ for either row, at first order in the gap."""
    grasp, state = scene
    moved = eqx.tree_at(lambda g: g.fingers[0].base, grasp, jnp.array([3e-7, -2e-7]))
    ts = np.array([0.0, 5e-4, 1e-3, 2e-3])
    run = jxr.simulate(moved, state, 2e-3, ts=ts, formulation=jxr.CSM(), rtol=1e-10)
    for rows, decay in ((run.residuals.normal, 750.0), (run.residuals.tangential, 1500.0)):
        rows, w = np.asarray(rows)[:, 0], decay * np.sqrt(3.0)
        exact = rows[0] * np.exp(-decay * ts) * (np.cos(w * ts) + decay / w * np.sin(w * ts))
        assert abs(rows[0]) > 1e-8
        np.testing.assert_allclose(rows, exact, atol=2e-3 * abs(rows[0]))


def test_roll_is_as_accurate_between_the_ends_as_at_the_end():
    """A ball led round: what is saved on the way agrees with runs that end there."""
    ball, table = jxr.Sphere(0.1), jxr.Plane()
    path = lambda t: (0.3 * jnp.cos(3.0 * t), 0.2 * jnp.sin(5.0 * t), 0.0)  # noqa: E731
    start = {"at_tip": (0.0, 0.0, -0.1), "at_object": (0.0, 0.0, 0.0), "rtol": 1e-10}
    ts = np.array([0.0, 0.33, 0.71, 0.93, 1.13, 1.6])
    whole = jxr.roll(ball, table, path, ts, **start)
    fine = jxr.roll(ball, table, path, ts, **start | {"rtol": 1e-13})
    off = np.abs(np.asarray(whole.pose - fine.pose)).max(axis=1)
    assert off[-1] > 0 and off[1:-1].max() <= 3.0 * off[-1]
