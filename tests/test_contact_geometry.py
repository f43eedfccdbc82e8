"""Contact geometry (56)-(70): against the chapter's closed forms, mirror images, derivatives by autodiff."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from tests.measures import runge_kutta_step
from tests.oracles.chapter_part2 import Part2
from tests.recorded import runs
from tests.subjects.mirror_images import MIRROR, mirrored

LENGTHS = ("l_b0", "l_b1", "l_n0", "l_n1")
VECTORS = ("point", "centre_0", "centre_1", "gamma_0", "gamma_1", "b_0", "b_1", "n_0", "n_1")
WRAPPED = ("psi_0", "theta_1", "misalignment")


def names(found):
    return [f.name for f in dataclasses.fields(found)]


def dot(a, b):
    return np.sum(np.asarray(a) * np.asarray(b), axis=-1)


def ellipse_between_fingers():
    """The fingers of the pinch about an ellipse, with a contact of each sense; the state closes neither."""
    grasp, state = runs.scene("pinch")
    body = jxr.FreeObject(jxr.Ellipse(0.015, 0.025), mass=0.02, inertia=4e-6)
    contacts = (jxr.Contact(0.001, 0.06, finger=0), jxr.Contact(-0.002, 0.003, finger=1, sense=-1))
    return jxr.Grasp(body, grasp.fingers, contacts, controller=grasp.controller), state


GRASPS = {"pivoted": lambda: runs.scene("pivoted"), "ellipse": ellipse_between_fingers}


@pytest.fixture(scope="module")
def moving(scene, run):
    """The pivoted scene at five times of a run, and its contact geometry."""
    grasp, _ = scene
    ts, states = jax.tree.map(lambda x: x[::75], (run.ts, run.states))
    run = dataclasses.replace(run, ts=ts, states=states)
    return grasp, run, jxr.contact_geometry(grasp, run.states)


def test_angles_lengths_and_curvatures_are_the_chapters(moving):
    """(56)-(57), (60)-(63) and (69)-(70), from the printed contours at the same s."""
    _, _, found = moving
    chapter = Part2()

    @jax.jit
    @jax.vmap
    def printed(s):
        angles, slopes = jax.jvp(chapter.angles, (s,), (jnp.ones_like(s),))
        return angles, slopes, chapter.lengths(s)

    (theta1, psi0), (turn_1, turn_0), lengths = printed(found.s[:, 0])
    np.testing.assert_allclose(found.theta_1[:, 0], theta1, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.psi_0[:, 0], psi0, rtol=0, atol=1e-13)
    for name, length in zip(LENGTHS, lengths, strict=True):
        np.testing.assert_allclose(getattr(found, name)[:, 0], length, rtol=1e-12, atol=1e-15)
    # theta_1' = kappa_1 of (70); psi_0' = -kappa_0 of (69), corrected.
    np.testing.assert_allclose(found.kappa_1[:, 0], turn_1, rtol=1e-11)
    np.testing.assert_allclose(-np.asarray(found.kappa_0)[:, 0], turn_0, rtol=1e-11)


def test_tangents_and_normals_are_58_and_59_mirrored(moving):
    """(58)-(59) as printed, with the chapter's clockwise theta and p = q_1 + q_2: ours in the mirror."""
    _, run, found = moving
    turn = np.asarray(run.states.q[:, 0] + found.theta_1[:, 0])
    tip = np.asarray(run.states.q[:, 1] + run.states.q[:, 2] + found.psi_0[:, 0])
    printed = {
        "b_1": [np.sin(turn), np.cos(turn)],
        "b_0": [-np.cos(tip), np.sin(tip)],
        "n_1": [np.cos(turn), -np.sin(turn)],
        "n_0": [-np.sin(tip), -np.cos(tip)],
    }
    for name, columns in printed.items():
        vector = MIRROR * np.asarray(getattr(found, name))[:, 0]
        np.testing.assert_allclose(vector, np.stack(columns, axis=-1), atol=1e-13, err_msg=name)


def test_60_to_63_and_66_67_with_the_axes_of_the_docstring():
    """(60)-(63), (66)-(67) off the constraints, for both senses: by the contours' points and origins."""
    grasp, state = ellipse_between_fingers()
    assert [contact.sense for contact in grasp.contacts] == [1, -1]
    rng = np.random.default_rng(1)
    off = jxr.State(state.q + 1e-2 * rng.normal(size=state.q.shape), state.v, state.s + 2e-3)
    found, q = jxr.contact_geometry(grasp, off), np.asarray(off.q)
    tips, first = [], 3
    for finger in grasp.fingers:
        tips.append(q[first : first + finger.joints].sum())
        first += finger.joints
    for i, contact in enumerate(grasp.contacts):
        shape, face = grasp.shapes(contact)
        sense, place = contact.sense, float(off.s[i])
        at_tip, at_face = contact.s_tip + place, contact.s_object - place
        axes_0 = lambda v: np.array([-sense * v[1], -v[0]])  # noqa: B023, E731
        axes_1 = lambda v: np.array([v[0], -sense * v[1]])  # noqa: B023, E731
        (x0, y0), (dx0, dy0) = axes_0(shape.point(at_tip)), -sense * axes_0(shape.tangent(at_tip))
        (x, y), (dx, dy) = axes_1(face.point(at_face)), sense * axes_1(face.tangent(at_face))
        psi, theta = np.arctan2(dx0, dy0), np.arctan2(dx, dy)
        wanted = {
            "psi_0": psi,
            "theta_1": theta,
            "l_b0": x0 * np.sin(psi) + y0 * np.cos(psi),
            "l_b1": -x * np.sin(theta) - y * np.cos(theta),
            "l_n0": x0 * np.cos(psi) - y0 * np.sin(psi),
            "l_n1": -x * np.cos(theta) + y * np.sin(theta),
        }
        # The distances of (66)-(67), along the printed b_1 and n_1 in the chapter's world.
        lean = sense * q[2] + theta
        apart = np.asarray(found.centre_1[i] - found.centre_0[i]) * [1.0, -sense]
        wanted["q"] = wanted["l_n0"] + wanted["l_n1"] - apart @ [np.cos(lean), -np.sin(lean)]
        wanted["r"] = wanted["l_b0"] + wanted["l_b1"] - apart @ [np.sin(lean), np.cos(lean)]
        left = sense * tips[i] + psi - lean - np.pi / 2
        wanted["misalignment"] = left - 2 * np.pi * np.round(left / (2 * np.pi))
        assert min(abs(wanted[name]) for name in ("q", "r", "misalignment")) > 1e-5
        for name, value in wanted.items():
            assert float(getattr(found, name)[i]) == pytest.approx(float(value), abs=1e-14), name


def test_what_is_left_over_is_residuals(moving):
    """Zero along a run; with the base moved aside, `residuals` to rounding, in their signs."""
    grasp, run, found = moving
    for name, largest in (("q", 1e-14), ("r", 1e-14), ("misalignment", 1e-12)):
        assert np.abs(getattr(found, name)).max() <= largest
    np.testing.assert_allclose(found.b_0, found.b_1, atol=1e-12)
    np.testing.assert_allclose(found.n_0, -found.n_1, atol=1e-12)
    moved = eqx.tree_at(lambda g: g.fingers[0].base, grasp, jnp.array([3e-4, -2e-4]))
    left, here = jxr.residuals(moved, run.states), jxr.contact_geometry(moved, run.states)
    assert np.abs(here.q).min() > 1e-5 and np.abs(here.r).min() > 1e-5
    np.testing.assert_allclose(here.q, left.normal, atol=1e-14)
    np.testing.assert_allclose(here.r, left.tangential, atol=1e-14)


def test_misalignment_is_the_angle_whose_sine_is_tangency():
    """In the sense of the contact: the fingers turned against the object by a tenth of a radian."""
    grasp, state = runs.scene("pinch")
    turned = jxr.State(state.q.at[2].add(0.1), state.v, state.s)
    found, left = jxr.contact_geometry(grasp, turned), jxr.residuals(grasp, turned)
    senses = np.array([contact.sense for contact in grasp.contacts])
    np.testing.assert_allclose(found.misalignment, -0.1 * senses, atol=1e-12)
    np.testing.assert_allclose(np.sin(found.misalignment), senses * np.asarray(left.tangency), atol=1e-14)


@pytest.mark.parametrize("name", GRASPS)
def test_a_mirror_image_with_the_other_sense_has_the_same_geometry(name):
    """Off the constraints: every number alike, every vector mirrored."""
    grasp, state = GRASPS[name]()
    rng = np.random.default_rng(2)
    off = jxr.State(state.q + 1e-3 * rng.normal(size=state.q.shape), state.v, state.s + 1e-3)
    image, seen = mirrored(grasp, off)
    here, there = jxr.contact_geometry(grasp, off), jxr.contact_geometry(image, seen)
    for key in names(here):
        values, others = np.asarray(getattr(here, key)), np.asarray(getattr(there, key))
        if key in VECTORS:
            values = MIRROR * values
        elif key in WRAPPED:  # pi and -pi are one angle
            values, others = np.exp(1j * values), np.exp(1j * others)
        assert np.abs(values).max() > 0, key
        np.testing.assert_allclose(others, values, rtol=1e-9, atol=1e-13, err_msg=key)


@pytest.mark.parametrize("name", GRASPS)
def test_derivatives_along_the_contour(name):
    """Those of the docstring, and the change of the distances in (66)-(67), by autodiff in the place."""
    grasp, state = GRASPS[name]()
    senses = np.array([contact.sense for contact in grasp.contacts])

    def at(s):
        return jxr.contact_geometry(grasp, jxr.State(state.q, state.v, state.s + s))

    # s runs along b_1, the place against the object's contour.
    found, rates = jax.jvp(at, (jnp.zeros(senses.shape),), (jnp.asarray(-senses, float),))
    k0, k1 = found.kappa_0, found.kappa_1
    wanted = {
        "s": np.ones(senses.shape),
        "theta_1": k1,
        "psi_0": -k0,
        "l_b0": 1 - k0 * found.l_n0,
        "l_n0": k0 * found.l_b0,
        "l_b1": -1 + k1 * found.l_n1,
        "l_n1": -k1 * found.l_b1,
        "gamma_0": found.b_0,
        "gamma_1": found.b_1,
        "misalignment": -(k0 + k1),  # (68)
    }
    for key, value in wanted.items():
        np.testing.assert_allclose(getattr(rates, key), value, rtol=1e-9, atol=1e-11, err_msg=key)
    distances = rates.l_n0 + rates.l_n1, rates.l_b0 + rates.l_b1
    np.testing.assert_allclose(distances[0], k0 * found.l_b0 - k1 * found.l_b1, atol=1e-12)
    np.testing.assert_allclose(distances[1], k1 * found.l_n1 - k0 * found.l_n0, atol=1e-12)


def test_68_holds_along_a_run(moving):
    """(68) with the rates of theta, p and s from the run: (kappa_0 + kappa_1) s' = p' - theta'."""
    grasp, run, found = moving
    i, h = 2, 1e-5
    here = jax.tree.map(lambda x: x[i], run.states)
    # With the options of the run of `moving`: the same program.
    near = jxr.simulate(grasp, here, h, rtol=1e-12, record=("multipliers", "energy"))
    ends = [jax.tree.map(lambda x: np.asarray(x)[end], near.states) for end in (0, -1)]  # noqa: B023
    before, after = (float(jxr.contact_geometry(grasp, state).s[0]) for state in ends)
    rolled, v = (after - before) / h, 0.5 * (ends[0].v + ends[1].v)
    sum_ = float(found.kappa_0[i, 0] + found.kappa_1[i, 0])
    assert sum_ * rolled == pytest.approx(v[1] + v[2] - v[0], rel=1e-4)


def test_fig_7_is_drawn_in_the_axes_of_the_frames():
    """Fig. 7, (80)-(83): X_0 = -y, Y_0 = -x on the fingertip, X = x, Y = -y on the object, with `sense` 1."""
    grasp, _ = runs.scene("pivoted")
    tip, face = grasp.shapes(grasp.contacts[0])
    for s in (-0.004, 0.0, 0.007):
        (x0, y0), (x, y) = tip.point(-s), face.point(s)
        np.testing.assert_allclose([-y0, -x0], Part2.tip_contour(s), atol=1e-16)
        np.testing.assert_allclose([x, -y], Part2.object_contour(s), atol=1e-16)
    np.testing.assert_allclose(tip.point(0.0), [0.0, -0.010], atol=1e-16)
    assert [ax.get_xlabel() for ax in jxr.plotting.contours(grasp).axes[:2]] == ["x [mm]"] * 2


def test_7_has_the_sign_of_the_sense_and_the_rolled_arclength_none():
    """(7) for both fingers: (kappa_i + kappa_0i) s_i' = (-1)^i (theta' - p_i'); sigma' has one."""
    grasp, state = runs.scene("pinch")
    field = jxr.vector_field(grasp)
    slope = jax.jit(lambda y: field(0.0, y))
    rows = [np.concatenate([state.q, state.v, state.s])]
    # A while after it set off, three times that lie close together.
    for h in [1e-3] * 50 + [1e-4] * 2:
        rows.append(runge_kutta_step(slope, rows[-1], h))
    states = [jxr.State(*np.split(row, [8, 16])) for row in rows[-3:]]
    found, v = [jxr.contact_geometry(grasp, state) for state in states], states[1].v
    s, sigma = ((np.asarray(x[2].s) - np.asarray(x[0].s)) / 2e-4 for x in (found, states))
    bend, faster = found[1].kappa_0 + found[1].kappa_1, np.array([v[3:6].sum(), v[6:].sum()]) - v[2]
    assert [contact.sense for contact in grasp.contacts] == [1, -1]
    np.testing.assert_allclose(bend * s, [faster[0], -faster[1]], rtol=1e-4)
    np.testing.assert_allclose(bend * sigma, -faster, rtol=1e-4)


def test_coefficients_of_73_and_74(moving):
    """(72) makes (73)-(74): levers as printed, which are the change of (64)-(65) while s follows (68)."""
    grasp, run, found = moving
    chapter, lengths = Part2(), np.asarray(grasp.fingers[0].lengths)

    def printed(x, s):
        """Q and R of (64)-(65), in the chapter's frame."""
        p, (l_b0, l_b1, l_n0, l_n1) = jnp.cumsum(x[1:]), chapter.lengths(s)
        tip = chapter.base + jnp.stack([jnp.cos(p), -jnp.sin(p)]) @ lengths
        (dx, dy), turn = tip - chapter.pivot, x[0] + chapter.angles(s)[0]
        q = dx * jnp.cos(turn) - dy * jnp.sin(turn) + l_n0 + l_n1
        return jnp.stack([q, dx * jnp.sin(turn) + dy * jnp.cos(turn) + l_b0 + l_b1])

    changed = jax.jit(lambda at, along: jax.jvp(printed, at, along)[1])
    for i in (0, 2, 4):
        state, at = (jax.tree.map(lambda x: np.asarray(x)[i], tree) for tree in (run.states, found))  # noqa: B023
        outer = np.asarray(at.centre_0[0]) - np.asarray(grasp.fingers[0].base)
        inner = outer - lengths[1] * np.array([np.cos(state.q[1:].sum()), np.sin(state.q[1:].sum())])
        jacobian = np.stack([[-arm[1], arm[0]] for arm in (outer, outer - inner)], axis=-1)
        terms = jxr.equation_terms(grasp, state)
        by_f = np.append(at.l_b1, jacobian.T @ at.n_1[0] + at.l_b0)
        by_lam = np.append(-at.l_n1, jacobian.T @ at.b_1[0] - at.l_n0)
        np.testing.assert_allclose(terms.normal[0], by_f, atol=1e-14)
        np.testing.assert_allclose(terms.tangential[0], by_lam, atol=1e-14)
        for direction in np.eye(3):
            rolled = (direction[1] + direction[2] - direction[0]) / (at.kappa_0[0] + at.kappa_1[0])
            change = changed((state.q, at.s[0]), (direction, rolled))
            np.testing.assert_allclose(change, [by_f @ direction, by_lam @ direction], atol=1e-12)


def test_along_time_it_is_state_by_state(moving):
    """What a run did not reach is NaN, and adds nothing to a gradient."""
    grasp, run, found = moving
    rounding = 8 * np.finfo(float).eps  # a misalignment is what is left of angles and of unit vectors
    assert found.s.shape == (5, 1) and found.b_0.shape == (5, 1, 2)
    for i in (0, 3):
        one = jxr.contact_geometry(grasp, jax.tree.map(lambda x: x[i], run.states))  # noqa: B023
        for key in names(found):
            np.testing.assert_allclose(
                getattr(found, key)[i], getattr(one, key), rtol=1e-13, atol=rounding, err_msg=key
            )
    lost = jax.tree.map(lambda x: x.at[3:].set(jnp.nan), run.states)
    left = jxr.contact_geometry(grasp, lost)
    assert np.isnan(left.l_b0[3:]).all() and np.isnan(left.b_0[3:]).all()
    np.testing.assert_array_equal(left.l_b0[:3], found.l_b0[:3])
    slope = jax.grad(lambda s: jnp.nansum(jxr.contact_geometry(grasp, s).psi_0), allow_int=True)(lost)
    assert np.isfinite(slope.s).all() and np.abs(slope.s[:3]).min() > 0


def test_any_controller_and_fingers_that_do_not_turn():
    """A disc under a plate: no controller, and both contacts beside the centre."""
    grasp, state = runs.scene("roller")
    found = jxr.contact_geometry(grasp, state)
    np.testing.assert_allclose(found.l_n1, 1.0 / np.asarray(found.kappa_1), rtol=1e-12)
    np.testing.assert_allclose(found.l_b1, 0.0, atol=1e-15)


def test_a_grasp_in_space_is_refused():
    grasp, state = runs.scene("turntable")
    with pytest.raises(ValueError, match="argument grasp must live in the plane"):
        jxr.contact_geometry(grasp, state)


LABELS = ["gamma}_0", "gamma}$", "n}_0", "n}_1", "l_{b0}", "l_{b1}", "l_{n0}", "l_{n1}", "P_0'", "P_1'"]
LABELS += ["$X$", "$Y$", "$X_0$", "$Y_0$", "$O_m$"]


@pytest.mark.parametrize(("name", "contact"), [("pivoted", 0), ("pinch", 0), ("pinch", 1)])
def test_the_figure_has_every_label_once_and_none_hides_another(name, contact):
    """Figs. 2, 5 and 6: within the axes, for poses turned by any angle."""
    grasp, state = runs.scene(name)
    for turn in (0.0, 2.0, 4.0) if name == "pivoted" else (0.0,):
        # Turned as a whole about the origin of the world.
        c, s = np.cos(turn), np.sin(turn)
        pivot = getattr(grasp.object, "pivot", None)
        whole = grasp if pivot is None else grasp.with_(pivot=jnp.array([[c, -s], [s, c]]) @ pivot)
        turned = state if turn == 0.0 else jxr.State(state.q.at[:2].add(turn), state.v, state.s)
        figure = jxr.plotting.contact_geometry(whole, turned, contact=contact)
        ax = figure.axes[0]
        texts = [text for text in ax.texts if text.get_text()]
        found = [text.get_text() for text in texts]
        own = ["$O_{01}$" if name == "pivoted" else f"$O_{contact + 1}$", f"$P_{contact + 1}$", "b}_0 = "]
        for label in LABELS + own:
            assert sum(label in text for text in found) == 1, label
        assert len(found) == len(LABELS + own)
        figure.draw_without_rendering()
        window = ax.get_window_extent()
        # An annotation's own extent has the line that leads to it.
        boxes = [super(type(text), text).get_window_extent() for text in texts]
        for i, box in enumerate(boxes):
            assert window.x0 <= box.x0 and box.x1 <= window.x1, found[i]
            assert window.y0 <= box.y0 and box.y1 <= window.y1, found[i]
            for j in range(i):
                assert not box.overlaps(boxes[j]), (found[i], found[j])


def test_the_figure_of_an_open_contact_has_both_tangents():
    """On an axes of the caller's, without the values."""
    grasp, state = runs.scene("pivoted")
    figure = jxr.plotting.contact_geometry(grasp, state)
    values = [text.get_text() for text in figure.axes[1].texts]
    at = jxr.contact_geometry(grasp, state)
    assert f"{1e3 * float(at.l_n1[0]):.2f}" in values and f"{float(at.kappa_0[0]):.2f}" in values
    ax = figure.add_subplot()
    turned = jxr.State(state.q.at[0].add(0.3), state.v, state.s)
    assert jxr.plotting.contact_geometry(grasp, turned, ax=ax) is figure
    found = [text.get_text() for text in ax.texts]
    assert any("b}_0$" in text for text in found) and any("b}_1$" in text for text in found)


def test_a_contact_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match="argument contact must be below 1, but was 1"):
        jxr.plotting.contact_geometry(*runs.scene("pivoted"), contact=1)
