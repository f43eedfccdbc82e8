"""The wrench form of a pinch, (42)-(55), as identities along runs of two objects."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from tests.measures import gradients_with_and_without_an_end

ODD = np.array([-1.0, 1.0])  # (-1)^i as the chapter counts


@pytest.fixture(scope="module", params=["pinch", pytest.param("pinch_ellipse", marks=pytest.mark.slow)])
def moving(request):
    """Grasp, saved states in full motion, their forces, and the quantities under test."""
    grasp, state = getattr(jxr.scenes, request.param)()
    run = jxr.simulate(grasp, state, 0.15, ts=np.array([0.02, 0.06, 0.15]), record=("multipliers",))
    return grasp, run, jxr.pinch_balance(grasp, run.ts, run.states)


def turn(angle, vector):
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * vector[..., 0] - s * vector[..., 1], s * vector[..., 0] + c * vector[..., 1]], -1)


def geometry(grasp, run):
    """World vectors of Fig. 2 for each contact, from the contours' public frames: gamma_i, b_i, n_i, ..."""
    q, found = np.asarray(run.states.q), []
    tips = [q[:, 3:6].sum(axis=1), q[:, 6:].sum(axis=1)]
    for i, contact in enumerate(grasp.contacts):
        tip, face = grasp.shapes(contact)
        sigma = np.asarray(run.states.s)[:, i]
        on_tip = turn(tips[i], np.asarray(tip.point(contact.s_tip + sigma)))
        at = contact.s_object - sigma
        on_body = turn(q[:, 2], np.asarray(face.point(at)))
        b0 = contact.sense * turn(q[:, 2], np.asarray(face.tangent(at)))
        n0 = -turn(q[:, 2], np.asarray(face.normal(at)))
        found.append((on_tip, on_body, b0, n0))
    return found


def tip_jacobians(grasp, run):
    """Positions of both tip frames, and their derivatives in the joint angles, by hand."""
    q, places, jacobians, first = np.asarray(run.states.q), [], [], 3
    for finger in grasp.fingers:
        angles = np.cumsum(q[:, first : first + finger.joints], axis=1)
        first += finger.joints
        links = np.asarray(finger.lengths)[None, :, None] * np.stack([np.cos(angles), np.sin(angles)], -1)
        outer = np.cumsum(links[:, ::-1], axis=1)[:, ::-1]
        places.append(np.asarray(finger.base) + links.sum(axis=1))
        jacobians.append(np.stack([-outer[..., 1], outer[..., 0]], axis=1))
    return places, jacobians


def dot(a, b):
    return np.sum(a * b, axis=-1)


def test_d_l_and_44(moving):
    """d, l from (25)-(26), and (44): the opposition torque in the contact frames."""
    grasp, run, found = moving
    places, jacobians = tip_jacobians(grasp, run)
    arm, beta = places[0] - places[1], float(grasp.controller.beta)
    for i, (_, _, b0, n0) in enumerate(geometry(grasp, run)):
        np.testing.assert_allclose(found.d[:, i], dot(arm, b0), atol=1e-15)
        np.testing.assert_allclose(found.l[:, i], -ODD[i] * dot(arm, n0), atol=1e-15)
        left = -ODD[i] * beta * np.einsum("tak,ta->tk", jacobians[i], arm)
        inner = np.asarray(found.l)[:, i, None] * n0 - ODD[i] * np.asarray(found.d)[:, i, None] * b0
        np.testing.assert_allclose(left, beta * np.einsum("tak,ta->tk", jacobians[i], inner), atol=1e-15)


def test_joint_torques_in_wrench_form(moving):
    """(19) and (45) leave over the same: forces and control against (42)-(43), (46) and (53)."""
    grasp, run, found = moving
    places, jacobians = tip_jacobians(grasp, run)
    arm, control = places[0] - places[1], grasp.controller
    q, first = np.asarray(run.states.q), 3
    f, lam = np.asarray(run.multipliers.f), np.asarray(run.multipliers.lam)
    for i, (on_tip, _, b0, n0) in enumerate(geometry(grasp, run)):
        joints = grasp.fingers[i].joints
        kept = q[:, first : first + joints].sum(axis=1) - float(control.start[i])
        first += joints
        # b_i . gamma_i and n_i . gamma_i: Pi_i b_i = b_0i and Pi_i n_i = -n_0i in the world.
        along, across = dot(on_tip, b0), -dot(on_tip, n0)
        push = lambda v: np.einsum("tak,ta->tk", jacobians[i], v)  # noqa: B023, E731
        by_f = push(n0) - ODD[i] * along[:, None]
        by_lam = push(b0) - ODD[i] * across[:, None]
        drive = -ODD[i] * float(control.beta) * push(arm) + float(control.alpha[i]) * kept[:, None]
        left = drive + f[:, i, None] * by_f + lam[:, i, None] * by_lam
        df, dl = np.asarray(found.delta_f)[:, i, None], np.asarray(found.delta_lam)[:, i, None]
        right = df * by_f + dl * by_lam + np.asarray(found.delta_n)[:, i, None]
        np.testing.assert_allclose(left, right, atol=1e-14)
        wanted = ODD[i] * along * found.l[:, i] - across * found.d[:, i]
        np.testing.assert_allclose(found.n[:, i], wanted, atol=1e-16)


def test_wrench_on_the_object(moving):
    """(1)-(2) against (47)-(48) with S_N, and the second form of (49) on a rectangle.

    Forces stand with a plus on the left, so that the Lagrangian (50) of this form has a minus, as (24) has.
    """
    grasp, run, found = moving
    f, lam = np.asarray(run.multipliers.f), np.asarray(run.multipliers.lam)
    df, dl = np.asarray(found.delta_f), np.asarray(found.delta_lam)
    force, wrench, moment, rest = 0.0, 0.0, 0.0, np.asarray(found.s_n)
    for i, (_, on_body, b0, n0) in enumerate(geometry(grasp, run)):
        force = force + f[:, i, None] * n0 + lam[:, i, None] * b0
        wrench = wrench + df[:, i, None] * n0 + dl[:, i, None] * b0
        arms = dot(on_body, b0), dot(on_body, n0)
        moment = moment + ODD[i] * (f[:, i] * arms[0] - lam[:, i] * arms[1])
        rest = rest + ODD[i] * (df[:, i] * arms[0] - dl[:, i] * arms[1])
    np.testing.assert_allclose(force, wrench, atol=1e-14)
    np.testing.assert_allclose(moment, rest, atol=1e-15)
    if len(grasp.object.contours) == 2:
        width = 0.03
        last = float(grasp.controller.beta) * (
            (found.s[:, 0] - found.s[:, 1]) * found.l[:, 0] + width * found.d[:, 0]
        )
        np.testing.assert_allclose(found.s_n, last, atol=1e-15)


def test_change_of_the_potential(moving):
    """(52), (54), (55): dU/dt and dP/dt along the motion, against the tips' velocities."""
    grasp, run, found = moving
    places, jacobians = tip_jacobians(grasp, run)
    control, v = grasp.controller, np.asarray(run.states.v)
    rates = [v[:, 3:6], v[:, 6:]]
    moves = [np.einsum("tak,tk->ta", j, w) for j, w in zip(jacobians, rates, strict=True)]
    pulled = float(control.beta) * dot(places[0] - places[1], moves[0] - moves[1])
    turns = np.stack([w.sum(axis=1) for w in rates], axis=1)
    n = float(control.beta) * np.asarray(found.n)
    power = np.asarray(found.s_n) * v[:, 2] + dot(n, turns)
    np.testing.assert_allclose(power, pulled, atol=1e-15)
    q = np.asarray(run.states.q)
    kept = np.stack([q[:, 3:6].sum(axis=1), q[:, 6:].sum(axis=1)], axis=1) - np.asarray(control.start)
    whole = pulled + dot(np.asarray(control.alpha) * kept, turns)
    power = np.asarray(found.s_n) * v[:, 2] + dot(np.asarray(found.delta_n), turns)
    np.testing.assert_allclose(power, whole, atol=1e-15)
    stored = 0.5 * float(control.beta) * dot(places[0] - places[1], places[0] - places[1])
    np.testing.assert_allclose(found.potential, stored, rtol=1e-14)
    assert np.abs(pulled).max() > 1e-5  # in motion


def test_lean_is_zero_on_one_line(moving):
    """The angle at O_i, against the points themselves."""
    grasp, run, found = moving
    places, _ = tip_jacobians(grasp, run)
    for i, (on_tip, *_) in enumerate(geometry(grasp, run)):
        other = places[1 - i] - places[i]
        cross = other[:, 0] * on_tip[:, 1] - other[:, 1] * on_tip[:, 0]
        np.testing.assert_allclose(found.lean[:, i], np.arctan2(cross, dot(other, on_tip)), atol=1e-14)


def test_other_grasps_are_refused():
    with pytest.raises(ValueError, match="argument grasp must be two fingers with one contact each"):
        jxr.pinch_balance(jxr.scenes.pivoted()[0], 0.0, jxr.scenes.pivoted()[1])
    with pytest.raises(ValueError, match="argument count must be a whole number of at least 2, but was 1"):
        jxr.scenes.ring(1)
    grasp, _ = jxr.scenes.pinch()
    with pytest.raises(ValueError, match="argument start must have one angle for each"):
        jxr.simulate(grasp.with_(controller=jxr.control.Opposition(1.0, 1.0, start=jnp.zeros(3))), _, 0.1)


def test_the_controller_that_will_not_do_is_named_by_its_class():
    """Not by its numbers, which are traced by the time that the sentence is made."""
    pinch, pivoted = jxr.scenes.pinch(), jxr.scenes.pivoted()
    with pytest.raises(ValueError, match=r"driven by control\.Press, but was by Opposition\b(?!\()"):
        jxr.press_balance(pinch[0], 0.0, pinch[1])
    sampled = pinch[0].with_(controller=jxr.control.Sampled(pinch[0].controller, 0.004))
    with pytest.raises(ValueError, match=r"control\.Opposition itself, but was by Sampled\b(?!\()"):
        jxr.stability.pinch_statics(sampled, (0.0, 0.0))
    with pytest.raises(ValueError, match=r"under control\.Opposition, .* under Press\b(?!\()"):
        jxr.pinch_balance(pivoted[0], 0.0, pivoted[1])


def test_gradients_of_a_run_that_ended_early_are_those_of_what_it_reached():
    """The rows that were not reached are NaN, and leave the derivatives of the others alone."""
    wanted, found = gradients_with_and_without_an_end(jxr.pinch_balance, *jxr.scenes.pinch())
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_the_moment_of_part_2_turns_the_object_against_it():
    """It stands on the left of (76); at rest the object sets off the other way."""
    grasp, state = jxr.scenes.pivoted()
    moment = float(jxr.press_balance(grasp, 0.0, state).moment[0])
    assert moment * float(jxr.accelerations(grasp, 0.0, state)[0]) < 0.0
