"""Statics, equilibria and verdicts of grasps, against differences, closed forms and simulation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.stability import (
    _equilibrium,
    assess,
    equilibrium,
    margin,
    pinch_rest,
    pinch_statics,
    rectangle_hessian,
    VERDICTS,
)
from jaxroll.stability._equilibrium import _force_size
from jaxroll.stability._memory_loop import _TWICE, eigenvalues
from jaxroll.stability._statics import _damped, _is_parallel, _is_straight, _solved
from jaxroll.stability._verdict import _bent_down, _verdict
from tests.helpers import in_single, slow_among
from tests.oracles.chapter_part1 import Part1
from tests.recorded import runs
from tests.subjects.rolling_disc import on_driven_plate, on_slope

VIOLATING = jxr.Circle(0.005).moved((0.005, 0.0))  # centre ahead of O_i: h = 10 mm, 1/kappa = 5 mm
BLUNT = jxr.Circle(0.015).moved((-0.005, 0.0))  # centre behind: h = 10 mm, 1/kappa = 15 mm
SHARP = jxr.Circle(0.0098).moved((0.0002, 0.0))  # just violates (41)


@pytest.fixture(scope="module")
def pinch():
    """The pinch whose equilibria are those of U alone."""
    grasp, state = runs.scene("pinch")
    return grasp.with_(alpha=0.0), state


def collinear(grasp, guess):
    """The chapter's s_i where grad U = 0, by Newton from a guess."""
    s = jnp.asarray(guess, float)
    for _ in range(30):
        at = pinch_statics(grasp, s)
        s = s - jnp.linalg.solve(at.hessian, at.gradient)
    return s


@pytest.mark.parametrize(
    "tips",
    [
        (jxr.Ellipse(0.015, 0.015).moved((-0.005, 0.0)), VIOLATING),
        None,
        (jxr.Ellipse(0.012, 0.009).moved((0.0, 0.0)), BLUNT),
    ],
)
def test_hessian_of_u_is_the_corrected_39_and_40(tips):
    """(39)-(40) where Fig. 3 comes to rest, on one line; the chapter's own form lacks the rank-one term."""
    with runs.not_closed():
        grasp, _ = jxr.scenes.pinch(tips=tips, s=(0.001, -0.0005))
    s = collinear(grasp, (0.0002, 0.0001))
    at, closed = pinch_statics(grasp, s), rectangle_hessian(grasp, s)
    scale = np.abs(closed).max()
    assert np.abs(at.gradient).max() <= 1e-12 and abs(at.d) <= 1e-12
    np.testing.assert_allclose(at.hessian, closed, rtol=0, atol=1e-12 * scale)
    printed = np.diag(np.diag(closed) - np.array([closed[0, 1] ** 2 / closed[1, 0]] * 2))
    assert np.abs(printed - closed).max() > 1e-2 * scale


def on_parallel_faces(chapter, s):
    """Of both contacts: gamma_i, b_i, n_i, kappa_i; gamma_0i, b_0i, n_0i; and Pi_i gamma_i."""
    tips, faces = ([side(i, s[i]) for i in (0, 1)] for side in (chapter.tip, chapter.face))
    # Pi_i takes b_i to b_0i and n_i to -n_0i.
    turned = [
        (b @ gamma) * b0 - (n @ gamma) * n0
        for (gamma, b, n, _), (_, b0, n0, _) in zip(tips, faces, strict=True)
    ]
    return tips, faces, turned


@pytest.mark.parametrize("s", [(0.004, -0.002), (-0.006, 0.003), (0.001, 0.0075)])
def test_statics_are_25_to_33(pinch, s):
    """(25)-(33) and (51) as printed, of the fingertips (82)-(83) on parallel faces; V vanishes."""
    chapter, (s1, s2) = Part1(np.zeros(2)), s
    tips, faces, turned = on_parallel_faces(chapter, s)
    along, across = zip(*((b @ gamma, n @ gamma) for gamma, b, n, _ in tips), strict=True)
    (_, b01, n01, _), (_, _, n02, _) = faces
    apart = -turned[0] + turned[1] + faces[0][0] - faces[1][0]  # (25)
    d, l_ = s1 - s2 - along[0] + along[1], -chapter.width + across[0] + across[1]  # (28)-(29)
    np.testing.assert_allclose(apart, d * b01 + l_ * n01, atol=1e-16)  # (26)
    v = apart @ n01 - sum(across) - n01 @ faces[0][0] - n02 @ faces[1][0]  # (30)
    assert abs(v) <= 1e-17
    found = pinch_statics(pinch[0], jnp.asarray(s))
    np.testing.assert_allclose([found.d, found.l], [d, l_], atol=1e-16)
    assert float(found.potential) == pytest.approx(0.5 * chapter.beta * (d**2 + l_**2), rel=1e-14)  # (27)
    # W of (31) is U, as V vanishes: (32) without its second term, with the vectors of (33); the same by (51).
    for i, sign in ((0, -1.0), (1, 1.0)):
        kappa, (_, b0, n0, _) = tips[i][3], faces[i]
        xi = across[i] * b0 + along[i] * n0
        slope = sign * chapter.beta * kappa * (apart @ xi)
        assert float(found.gradient[i]) == pytest.approx(slope, rel=1e-12)
        slope = sign * chapter.beta * (across[i] * d - sign * along[i] * l_) * kappa
        assert float(found.gradient[i]) == pytest.approx(slope, rel=1e-12)


def test_condition_37_is_no_equilibrium(pinch):
    """(34)-(36) and (38) at s_1 = s_2, (37): the printed slope of W vanishes there, that of U does not."""
    chapter, s = Part1(np.zeros(2)), (0.004, 0.004)
    tips, faces, turned = on_parallel_faces(chapter, s)
    along, across = zip(*((b @ gamma, n @ gamma) for gamma, b, n, _ in tips), strict=True)
    apart = -turned[0] + turned[1] + faces[0][0] - faces[1][0]
    eta = chapter.beta * apart @ faces[0][2]  # (34)
    for i, sign in ((0, -1.0), (1, 1.0)):
        (_, _, _, kappa), (_, b0, n0, _) = tips[i], faces[i]
        assert abs(apart @ b0) <= 1e-17  # (35)
        xi = across[i] * b0 + along[i] * n0
        printed = sign * chapter.beta * kappa * (apart @ xi) + eta * kappa * along[i]  # (32)
        assert abs(printed) <= 1e-15
    assert along[0] == pytest.approx(along[1]) and abs(along[0]) > 1e-3
    found = pinch_statics(pinch[0], jnp.asarray(s))
    assert np.abs(found.gradient).min() > 0.01  # [N]


def test_hessian_of_u_against_central_differences(pinch):
    grasp, _ = pinch
    point, h = jnp.array([0.004, -0.002]), 2e-5
    at = pinch_statics(grasp, point)
    potential = lambda s: pinch_statics(grasp, s).potential  # noqa: E731
    unit = h * jnp.eye(2)
    slopes = jnp.stack([(potential(point + e) - potential(point - e)) / (2 * h) for e in unit])
    np.testing.assert_allclose(at.gradient, slopes, rtol=1e-6)
    gradient = lambda s: pinch_statics(grasp, s).gradient  # noqa: E731
    second = jnp.stack([(gradient(point + e) - gradient(point - e)) / (2 * h) for e in unit])
    np.testing.assert_allclose(at.hessian, second, rtol=1e-6)


@pytest.mark.parametrize("function", [pinch_statics, rectangle_hessian])
def test_statics_beyond_an_end_of_a_contour_are_no_numbers(function, pinch):
    """The rectangle's sides are 50 mm long: 25 mm off their middles there is nothing to touch."""
    grasp, _ = pinch
    at = lambda s: np.concatenate([np.ravel(x) for x in jax.tree.leaves(function(grasp, s))])  # noqa: E731
    assert np.isfinite(at((0.0249, -0.0249))).all()
    for beyond in ((0.0251, 0.0), (0.0, -0.0251), (1.0, 0.0)):
        assert np.isnan(at(beyond)).all()


def test_places_of_a_scene_are_counted_from_where_its_fingers_face_the_object():
    """Those of the statics from the contour's zero: `contact_geometry` converts."""
    grasp, state = runs.scene("pinch_ellipse")
    at = jxr.contact_geometry(grasp, state)
    s, apart = at.s, at.centre_0
    half = 0.5 * float(grasp.object.contours[0].domain()[1])
    beside = 0.5 * float(grasp.controller.beta) * float(jnp.sum((apart[0] - apart[1]) ** 2))
    np.testing.assert_allclose(s, [0.004 + half, -0.003], atol=1e-12)
    assert float(pinch_statics(grasp, s).potential) == pytest.approx(beside, rel=1e-12)


@pytest.mark.slow
def test_statics_agree_with_the_moving_grasp(pinch):
    """U(s_1, s_2), d and l from contact coordinates alone, against tip positions along a run."""
    grasp, state = pinch
    run = jxr.simulate(grasp, state, 1.0, ts=5)
    found = jxr.pinch_balance(grasp, run.ts, run.states)
    at = pinch_statics(grasp, found.s)
    np.testing.assert_allclose(at.potential, found.potential, rtol=1e-13)
    np.testing.assert_allclose(at.d, found.d[:, 0], atol=1e-15)
    np.testing.assert_allclose(at.l, found.l[:, 0], atol=1e-15)


def potential(grasp, q):
    """(22) in plain NumPy."""
    control, tips, turns, start = grasp.controller, [], [], 3
    for finger in grasp.fingers:
        angles = np.cumsum(q[start : start + finger.joints])
        start += finger.joints
        links = np.asarray(finger.lengths)
        reach = [links @ np.cos(angles), links @ np.sin(angles)]
        tips.append(np.asarray(finger.base) + reach)
        turns.append(angles[-1])
    kept = 0.5 * np.asarray(control.alpha) @ (np.array(turns) - control.start) ** 2
    return 0.5 * float(control.beta) * np.sum((tips[0] - tips[1]) ** 2) + kept


@jax.jit
def rows(z, grasp, v):
    """What contacts keep at zero, of q and s in one vector."""
    left = jxr.residuals(grasp, jxr.State(z[: v.shape[0]], v, z[v.shape[0] :]))
    return jnp.concatenate([left.normal, left.tangential, left.tangency])


slopes_of_rows = jax.jit(jax.jacfwd(rows))


def rolled(grasp, state, dq):
    """The state at q + dq, to first order, with both contacts closed and rolled on: SciPy's root."""
    from scipy.optimize import root

    n = state.q.shape[0]
    here = np.concatenate([state.q, state.s])
    slopes = np.asarray(slopes_of_rows(here, grasp, state.v))
    ds = np.linalg.lstsq(slopes[:, n:], -slopes[:, :n] @ dq, rcond=None)[0]
    start, normals = here + np.concatenate([dq, ds]), slopes.T  # corrected along the manifold's normals
    found = root(
        lambda y: np.asarray(rows(start + normals @ y, grasp, state.v)), np.zeros(normals.shape[1]), tol=1e-15
    )
    return start + normals @ found.x


@pytest.mark.parametrize("scene", ["pinch", pytest.param("pinch_ellipse", marks=pytest.mark.slow)])
def test_reduced_hessian_against_second_differences(scene):
    """Of P along the constraint manifold, at an equilibrium, in every tangent direction and one mixed."""
    grasp, state = runs.scene(scene)
    found = assess(grasp, state)
    rest, p0 = found.equilibrium.state, potential(grasp, np.asarray(found.equilibrium.state.q))
    directions = [*np.eye(4), np.array([0.3, -0.5, 0.7, 0.4])]
    size = np.abs(found.hessian).max()
    for xi in directions:
        step = 2e-3 / np.abs(found.tangent @ xi).max()
        second = []
        for h in (step, 2 * step):
            ends = [potential(grasp, rolled(grasp, rest, k * h * found.tangent @ xi)[:8]) for k in (1, -1)]
            second.append((sum(ends) - 2 * p0) / h**2)
        fine = (4 * second[0] - second[1]) / 3
        assert abs(fine - xi @ found.hessian @ xi) <= 1e-6 * size


def test_reduced_hessian_is_that_of_u_on_a_rectangle(pinch):
    """H = (ds/dxi)^T (39)-(40) (ds/dxi), with ds_i from (7) on flat faces."""
    found = assess(*pinch)
    closed = rectangle_hessian(pinch[0], collinear(pinch[0], (0.0, 0.0)))
    spins = found.tangent[2], found.tangent[3:6].sum(axis=0), found.tangent[6:].sum(axis=0)
    kappa = 40.0  # both tips touch at the vertex of (82)-(83)
    slopes = np.stack([-(spins[0] - spins[1]), spins[0] - spins[2]]) / kappa
    wanted = slopes.T @ closed @ slopes
    np.testing.assert_allclose(found.hessian, wanted, atol=1e-9 * np.abs(wanted).max())


def test_verdicts(pinch, scene):
    """(41) holds: stable but for the redundant joints; circles about O_i: one more neutral direction."""
    plate, start = runs.scene("ball_plate")
    free = plate.with_(alpha=0.0 * plate.controller.alpha)
    good, circles = assess(*pinch), assess(free, start)
    assert good.verdict == VERDICTS.neutral and int(good.neutral) == 2
    assert circles.verdict == VERDICTS.neutral and int(circles.neutral) == 3
    assert np.asarray(good.curvatures[2:]).min() > 1.0
    # alpha_i holds the rotation of the object: two neutral directions fewer with centred circles.
    held = assess(plate, start)
    assert held.verdict == VERDICTS.neutral and int(held.neutral) == 1
    grasp, state = scene
    damped = assess(grasp, state)
    assert damped.verdict == VERDICTS.asymptotically_stable and int(damped.neutral) == 0
    swinging = assess(grasp.with_(damping=0.0), state)
    assert swinging.verdict == VERDICTS.undamped and int(swinging.neutral) == 0
    assert np.abs(swinging.rates.real).max() < 1e-9 < 1.0 < np.abs(swinging.rates.imag).min()
    # Without damping, xi'' + H xi = 0: the curvatures are the squared frequencies.
    frequencies = np.abs(swinging.rates.imag)
    np.testing.assert_allclose(frequencies**2, np.repeat(swinging.curvatures, 2), rtol=1e-9)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_pinch_is_found_at_rest_from_where_its_object_was_moved_away(pinch, axis):
    """By 5 cm: at rest the line between the tips is normal to both faces."""
    grasp, state = pinch
    for way in (-0.05, 0.05):
        rest = assess(grasp, jxr.State(state.q.at[axis].add(way), state.v, state.s)).equilibrium
        assert bool(rest.found)
        assert np.abs(jxr.pinch_balance(grasp, 0.0, rest.state).lean).max() < 1e-9


def test_margin_of_41():
    """(41) as a margin, of circles about any centre."""
    for tip, wanted in ((VIOLATING, -0.005), (BLUNT, 0.005), (SHARP, -0.0002), (jxr.Circle(0.01), 0.0)):
        assert abs(margin(tip, 0.0) - wanted) <= 1e-15
    # As h'' of the support function about O_i, by differences over the normal's angle.
    tip = jxr.Ellipse(0.012, 0.009).moved((0.001, 0.0005))
    s = np.linspace(0.002, 0.012, 5)
    h = lambda u: np.sum(np.asarray(tip.point(u)) * np.asarray(tip.normal(u)), axis=-1)  # noqa: E731
    e = 1e-5
    slope = lambda u: (h(u + e) - h(u - e)) / (2 * e) / np.asarray(tip.curvature(u))  # noqa: E731
    second = (slope(s + e) - slope(s - e)) / (2 * e) / np.asarray(tip.curvature(s))
    np.testing.assert_allclose(margin(tip, s), second, rtol=1e-4)


def test_rectangle_hessian_refuses_faces_that_are_not_straight_and_parallel(pinch):
    """Where numbers are traced, a curved class is refused all the same, and what only numbers tell is NaN."""
    grasp, s = runs.scene("pinch_ellipse")[0], jnp.zeros(2)
    with pytest.raises(ValueError, match="straight, parallel faces, but its contours were Ellipse"):
        rectangle_hessian(grasp, s)
    with pytest.raises(ValueError, match="straight, parallel faces, but its contours were Ellipse"):
        jax.jit(rectangle_hessian)(grasp, s)

    flat = pinch[0]
    face = lambda angle: flat.object.contours[1].moved(angle=angle)  # noqa: E731
    wedge = lambda angle: eqx.tree_at(lambda g: g.object.contours[1], flat, face(angle))  # noqa: E731
    with pytest.raises(ValueError, match="argument grasp must .* were -?2.865 degrees from opposite"):
        rectangle_hessian(wedge(0.05), (0.0, 0.0))
    traced = jax.jit(lambda angle: rectangle_hessian(wedge(angle), (0.0, 0.0)))
    np.testing.assert_allclose(traced(0.0), rectangle_hessian(flat, (0.0, 0.0)), rtol=1e-12)
    assert np.isnan(traced(0.05)).all()

    round_ = jxr.Parametric(lambda u: 0.02 * jnp.array([jnp.cos(u), jnp.sin(u)]), (0.0, 6.28), closed=False)
    bent = eqx.tree_at(lambda g: g.object.contours[1], flat, round_)
    with pytest.raises(ValueError, match=r"curvatures at the contacts were \[0.0, 5\d"):
        rectangle_hessian(bent, (0.0, 0.03))


def test_rectangle_hessian_counts_places_as_the_contacts_do(pinch):
    """With one `sense` for both contacts s_2 runs the other way, and the mixed term changes sign."""
    grasp, _ = pinch
    kept = lambda c: {"finger": c.finger, "contour": c.contour, "sense": 1}  # noqa: E731
    other = grasp.with_contacts(*(jxr.Contact(c.s_tip, c.s_object, **kept(c)) for c in grasp.contacts))
    found = rectangle_hessian(other, (0.0, 0.0))
    np.testing.assert_allclose(found, pinch_statics(other, (0.0, 0.0)).hessian, rtol=1e-12)
    assert found[0, 1] > 1.0


def test_margin_ends_where_an_open_contour_does():
    """At the ends themselves it has one; beyond them it is refused, and NaN where it is traced."""
    tip = jxr.Catenary(1.0 / 40.0, (-0.03, 0.03)).moved((0.01, 0.0))
    assert np.isfinite(margin(tip, np.array([-0.03, 0.0, 0.03]))).all()
    with pytest.raises(ValueError, match=r"argument s must lie between .*-0.03 and 0.03 m, but was \[0.05\]"):
        margin(tip, [0.0, 0.05])
    with pytest.raises(ValueError, match=r"argument s must lie between .*-0.03 and 0.03 m, but was \[0.05\]"):
        jax.grad(lambda s: margin(tip, s))(0.05)
    found = jax.jit(lambda s: margin(tip, s))(jnp.array([0.0, 0.05]))
    assert np.isfinite(found[0]) and np.isnan(found[1])
    circle = jxr.Circle(0.01)  # closed: it has no end
    np.testing.assert_allclose(margin(circle, 1.0), 0.0, atol=1e-15)


def leans(grasp, state, t1, **options):
    run = jxr.simulate(grasp, state, t1, ts=5, throw=False, **options)
    found = jxr.pinch_balance(grasp, run.stats.t_end, run.last)
    return run, np.abs(found.lean).max()


@pytest.mark.slow
def test_grasps_do_what_the_verdict_says(pinch):
    """(41): to collinear within 1e-6 rad. Indefinite: away. One finger against (41): stable all the same."""
    run, end = leans(*pinch, 12.0)
    assert run.result == jxr.RESULTS.successful and end <= 1e-6

    leaving = jxr.scenes.pinch(tips=VIOLATING, alpha=0.0, s=(0.0003, -0.0003))
    verdict = assess(*leaving)
    assert verdict.verdict == VERDICTS.unstable and verdict.curvatures[0] < 0
    first = np.abs(jxr.pinch_balance(leaving[0], 0.0, leaving[1]).lean).max()
    run, end = leans(*leaving, 12.0)
    assert end > 5 * first or run.result != jxr.RESULTS.successful

    odd = jxr.scenes.pinch(tips=(SHARP, BLUNT), alpha=0.0, s=(0.001, -0.001))
    assert margin(SHARP, 0.0) < 0 < margin(BLUNT, 0.0)
    verdict = assess(*odd)
    assert verdict.verdict == VERDICTS.neutral and int(verdict.neutral) == 2
    start = np.abs(jxr.pinch_balance(odd[0], 0.0, odd[1]).lean).max()
    run, end = leans(*odd, 20.0)
    assert run.result == jxr.RESULTS.successful and end < 0.5 * start


def test_slowest_rate_is_the_decay_of_a_run(pinch):
    grasp, state = pinch
    run = jxr.simulate(grasp, state, 10.0, rtol=1e-10)
    at = np.array([180, 270])  # 6 s and 9 s
    np.testing.assert_allclose(run.ts[at], [6.0, 9.0], rtol=1e-14)
    each = [jax.tree.map(lambda x, i=i: np.asarray(x)[i], (run.ts, run.states)) for i in at]
    lean = [np.abs(jxr.pinch_balance(grasp, *then).lean[0]) for then in each]
    rates = np.sort(assess(grasp, run.last).rates.real)
    slowest = rates[:-2][-1]  # two neutral directions
    assert abs(np.log(lean[1] / lean[0]) / 3.0 / slowest - 1) <= 1e-3


@pytest.mark.slow
def test_any_contour_any_number_of_fingers():
    """From the end of a run, an elliptic object: the run comes to rest where Newton says."""
    grasp, state = jxr.scenes.pinch_ellipse()
    run = jxr.simulate(grasp, state, 3.0, ts=1)
    found = assess(grasp, run.last)
    assert bool(found.equilibrium.found) and found.verdict == VERDICTS.neutral
    assert np.abs(found.equilibrium.state.s - run.last.s).max() < 2e-4
    rest = found.equilibrium
    balance = jxr.multipliers(grasp, 0.0, rest.state)
    np.testing.assert_allclose(rest.multipliers.f, balance.f, atol=1e-12)
    np.testing.assert_allclose(rest.multipliers.lam, balance.lam, atol=1e-12)


@pytest.mark.slow
def test_three_fingers():
    found = assess(*jxr.scenes.ring(3))
    assert found.verdict == VERDICTS.asymptotically_stable and found.rates.shape == (6,)


@pytest.mark.slow
@pytest.mark.optimised
def test_gradient_and_batch():
    """The smallest firm curvature over the radius of the tips: forward mode against differences."""
    tips = lambda radius: jxr.Circle(radius).moved(jnp.stack([0.010 - radius, 0.0 * radius]))  # noqa: E731

    def firmness(radius):
        grasp, state = base
        for i, old in enumerate(grasp.fingers):
            grasp = grasp.with_tip(i, tips(radius).moved(angle=old.tip.angle))
        return assess(*jxr.close(grasp, state)).curvatures[2]

    base = jxr.scenes.pinch(tips=tips(jnp.array(0.014)), alpha=0.0, s=(0.001, 0.0005))
    # One program for the values and the derivative.
    both, h = jax.jit(lambda radius: jax.jvp(firmness, (radius,), (1.0,))), 1e-5
    value, slope = both(0.014)
    assert abs((both(0.014 + h)[0] - both(0.014 - h)[0]) / (2 * h) / slope - 1) <= 1e-6
    many = jax.jit(jax.vmap(firmness))(jnp.array([0.012, 0.014]))
    assert abs(many[1] - value) <= 1e-9 * many[1]


def test_what_is_not_found_is_said():
    grasp, state = on_slope(0.0)
    with pytest.raises(ValueError, match="argument state.q must be finite"):
        assess(grasp, jxr.State(state.q * jnp.nan, state.v, state.s))

    @jax.jit
    def looked_for(q):
        looked = assess(grasp, jxr.State(q, state.v, state.s))
        return looked.verdict == VERDICTS.not_found, looked.equilibrium.found

    said, found = looked_for(state.q * jnp.nan)
    assert said and not found
    assert looked_for(state.q)[1]
    with pytest.raises(ValueError, match="argument grasp must be two fingers with one contact each"):
        pinch_statics(grasp, jnp.zeros(2))


@pytest.mark.parametrize(("lengths", "held"), [([0.08], 2), ([0.08, 0.05], 4)])
def test_a_grasp_that_cannot_move_has_no_verdict(lengths, held):
    """A finger of one joint on a pivoted disc; and two contacts of one finger of two on one with two rims."""
    rims = (jxr.Circle(0.02), jxr.Circle(0.01))[: held // 2]
    disc = jxr.PivotedObject(rims, 1e-5, pivot=(0.03, 0.09))
    finger = jxr.Finger(lengths, [0.05] * len(lengths), jxr.Circle(0.01))
    contacts = [jxr.Contact(contour=i) for i in range(len(rims))]
    grasp, n = jxr.Grasp(disc, finger, contacts), 1 + len(lengths)
    state = jxr.State(jnp.ones(n), jnp.zeros(n), jnp.zeros(len(rims)))
    words = f"argument grasp must leave a direction free, but its contacts hold {held} and it has {n}"
    with pytest.raises(ValueError, match=words):
        jxr.stability.assess(grasp, state)


def test_hessian_of_u_where_contacts_begin_elsewhere(pinch):
    """The chapter's s_i count from where both contours were marked: any marks give one Hessian."""
    grasp, _ = pinch
    # So that both tips touch with their vertices 2 mm along the faces, opposite each other.
    first, second = (contact.sense * 0.002 for contact in grasp.contacts)
    marked = grasp.with_contacts(
        jxr.Contact(first + 0.001, -0.001, finger=0, contour=0, sense=grasp.contacts[0].sense),
        jxr.Contact(second - 0.0005, 0.0005, finger=1, contour=1, sense=grasp.contacts[1].sense),
    )
    s = collinear(marked, (0.0018, 0.0021))
    at, closed = pinch_statics(marked, s), rectangle_hessian(marked, s)
    np.testing.assert_allclose(s, 0.002, atol=1e-12)
    np.testing.assert_allclose(at.hessian, closed, rtol=0, atol=1e-12 * np.abs(closed).max())
    unmarked = rectangle_hessian(grasp, collinear(grasp, (0.0, 0.0)))
    np.testing.assert_allclose(closed, unmarked, rtol=0, atol=1e-12 * np.abs(closed).max())


def test_rates_are_slow_beside_the_fastest():
    """What decays at 1e-8 of the fastest rate is not known to decay, whatever the fastest one is."""
    for fastest in (1e-3, 1.0, 1e4):
        for share, verdict in ((1e-8, VERDICTS.undamped), (1e-6, VERDICTS.asymptotically_stable)):
            rates = fastest * jnp.array([-share, -1.0])
            found = _verdict(rates, jnp.asarray(False), jnp.asarray(0), jnp.asarray(1e-7))
            assert found == verdict, (fastest, share)
            grows = _verdict(-rates, jnp.asarray(False), jnp.asarray(0), jnp.asarray(1e-7))
            assert grows == VERDICTS.unstable


class Growing(eqx.Module):
    """Springs in the joints, and a torque on the first of them that changes with time."""

    stiffness: jax.Array
    angles: jax.Array

    def __call__(self, t, angles, rates, tips):
        return [-self.stiffness * (angles[0] - self.angles) + jnp.array([0.01, 0.0]) * self.stiffness * t**2]


@pytest.fixture(scope="module")
def rest_of(scene):
    """Where the pivoted scene rests, in three numbers, and the derivative of that along a direction.

    These are how far the start is off contact [m], the time at which the controller is held [s], and the
    stiffness of its springs, with which all of its torques vanish [N m/rad].
    """
    grasp, state = scene

    def rest(numbers):
        far, t, stiffness = numbers
        held = grasp.with_(controller=Growing(stiffness, state.q[1:]))
        return equilibrium(held, jxr.State(state.q.at[0].add(far), state.v, state.s), t=t).state.q

    both = jax.jit(lambda numbers, way: jax.jvp(rest, (numbers,), (way,)))
    return lambda *given: tuple(map(np.asarray, both(*map(np.asarray, given))))


def test_equilibrium_moves_with_the_time_at_which_a_controller_is_held(rest_of):
    """A torque that grows with time: the derivative in t against central differences."""
    here, way, h = np.array([0.0, 0.5, 0.5]), np.array([0.0, 1.0, 0.0]), 1e-3
    wanted = (rest_of(here + h * way, way)[0] - rest_of(here - h * way, way)[0]) / (2 * h)
    assert np.abs(wanted).max() >= 1e-3
    np.testing.assert_allclose(rest_of(here, way)[1], wanted, rtol=1e-5, atol=1e-9)


def test_derivative_of_the_nearest_equilibrium_of_a_family(rest_of):
    """Of a controller without torques every state in contact is one: forwards against central differences.

    The start is off contact by so much that the bend of the family counts: of its two terms in the
    derivative the smaller one is a fortieth.
    """
    here, way, h = np.array([0.1, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), 1e-4
    wanted = (rest_of(here + h * way, way)[0] - rest_of(here - h * way, way)[0]) / (2 * h)
    np.testing.assert_allclose(rest_of(here, way)[1], wanted, rtol=1e-7)


@pytest.mark.parametrize("name", slow_among(("pivoted", "pinch_ellipse"), "pinch_ellipse"))
def test_single_precision_finds_the_equilibrium_of_double_precision(name):
    """With a neutral direction (the pinch) and without; where it rests, and the verdict, which names both."""
    grasp, state = getattr(jxr.scenes, name)()
    moved = jxr.State(state.q + 1e-3, state.v, state.s)
    found, single = assess(grasp, moved), in_single(assess, grasp, moved)
    rest, near = found.equilibrium, single.equilibrium
    assert near.imbalance.dtype == jnp.float32 and bool(near.found) and float(near.imbalance) <= 2e-6
    np.testing.assert_allclose(near.state.q, rest.state.q, rtol=0, atol=5e-5)
    np.testing.assert_allclose(near.push, rest.push, rtol=0, atol=5e-5 * np.abs(rest.push).max())
    assert single.verdict == found.verdict and single.neutral == found.neutral
    np.testing.assert_allclose(
        single.curvatures, found.curvatures, rtol=1e-4, atol=1e-6 * np.abs(found.curvatures).max()
    )


@pytest.mark.slow
def test_single_precision_finds_the_equilibria_of_a_batch(scene):
    grasp, state = scene
    away = 1e-2 * np.random.default_rng(0).normal(size=(4, state.q.shape[0]))

    def rests(grasp, state, away):
        at = lambda d: equilibrium(grasp, jxr.State(state.q + d, state.v, state.s))  # noqa: E731
        return jax.vmap(at)(away)

    found, single = rests(grasp, state, away), in_single(rests, grasp, state, away)
    assert bool(single.found.all())
    np.testing.assert_allclose(single.state.q, found.state.q, rtol=0, atol=1e-5)


def pinched_alone(name="pinch", **given):
    """A pinch of which the potential U alone says where it rests, but for what is given."""
    grasp, state = runs.scene(name)
    return grasp.with_(**{"alpha": 0.0} | given), state


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"alpha": 1e-3}, "must have alpha = 0 "),
        ({"alpha": (0.0, -1e-3)}, "must have alpha = 0 "),
        ({"alpha": lambda t: 0.0 * t}, "must have alpha = 0 "),
        ({"gravity": (0.0, -9.81)}, "must have no gravity "),
        ({"load": jxr.loads.Push((0.0, 1.0), 0.1, 0.1)}, "must have no loads "),
    ],
)
def test_where_more_than_its_potential_acts_a_pinch_rests_elsewhere(given, words):
    """Under gravity U bends up where the grasp falls; with alpha it rests a tenth of a millimetre further."""
    with pytest.raises(ValueError, match=f"argument grasp {words}") as caught:
        pinch_rest(*pinched_alone(**given))
    assert "\n" not in str(caught.value)


def test_what_does_nothing_at_rest_is_no_reason_to_refuse_a_pinch():
    loads = (jxr.loads.Drag(0.1), jxr.loads.Impulse((0.0, 1e-3), 0.1))
    s, _ = pinch_rest(*pinched_alone(gravity=(0.0, 0.0), load=loads))
    np.testing.assert_array_equal(s, pinch_rest(*pinched_alone())[0])


def test_numbers_that_jax_traces_leave_no_place_of_rest_where_they_are_not_zero():
    at = jax.jit(lambda alpha, g: pinch_rest(*pinched_alone(alpha=alpha, gravity=g)))
    for alpha, g in ((1e-3, (0.0, 0.0)), (0.0, (0.0, -9.81))):
        assert all(np.isnan(x).all() for x in jax.tree.leaves(at(alpha, jnp.array(g))))
    np.testing.assert_allclose(at(0.0, jnp.zeros(2))[0], pinch_rest(*pinched_alone())[0], atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("ways", [1, 2])
def test_jaws_that_keep_their_angles_do_not_rest_where_their_potential_is_least(ways):
    """Rolling on one jaw turns the object, and so rolls it on the other: U is least along one line only."""
    held, state = pinched_alone("pinch_ellipse")
    middle, tip = np.asarray(state.q[:2]), jxr.Ellipse(0.012, 0.02).moved((0.002, 0.001))
    jaws = [
        jxr.Jaw(tip, 0.1, [0.0, np.pi / 2][:ways], base=middle + np.array(base), angle=angle)
        for base, angle in (((-0.029, 0.002), 0.0), ((0.029, -0.001), np.pi))
    ]
    gripper = jxr.Grasp(
        held.object, jaws, held.contacts, controller=jxr.control.Opposition(20.0, 0.006, start=(0.0, 0.0))
    )
    guess = jxr.State(jnp.append(state.q[:3], np.zeros(2 * ways)), np.zeros(3 + 2 * ways), state.s)
    gripper, closed = jxr.close(gripper, guess, locate=True)
    rest = equilibrium(gripper, closed).state
    slope = pinch_statics(gripper, jxr.contact_geometry(gripper, rest).s).gradient
    assert np.max(np.abs(slope)) > 1e-3
    with pytest.raises(ValueError, match="must have fingertips that roll independently of each other"):
        pinch_rest(gripper, closed)


def test_a_grasp_that_no_force_holds_is_neutral():
    """Its curvatures are rounding of nothing, of which one that is negative looks large beside the others."""
    grasp, state = pinched_alone(beta=0.0)
    found = assess(grasp, state)
    assert found.verdict == VERDICTS.neutral and int(found.neutral) == 4 and not bool(found.bends_down)


def test_a_grasp_rests_where_it_does_however_weak_its_forces_are():
    """All forces and masses times a power of two: rounding is the same, in places and in rates."""
    grasp, state = runs.scene("pinch")
    weights = lambda g: (  # noqa: E731
        [g.object.mass, g.object.inertia, g.controller.beta, g.controller.alpha, g.controller.damping]
        + [x for f in g.fingers for x in (f.masses, f.inertias)]
    )
    weak = eqx.tree_at(weights, grasp, [2.0**-50 * x for x in weights(grasp)])
    here, there = assess(grasp, state), assess(weak, state)
    assert bool(there.equilibrium.found) and here.verdict == there.verdict
    assert jnp.array_equal(here.equilibrium.state.q, there.equilibrium.state.q)
    assert jnp.abs(there.rates / here.rates - 1.0).max() <= 1e-12


@pytest.mark.parametrize(("first", "there"), [(0.003, False), (-0.001, True), (0.0, True)])
def test_no_grasp_rests_beyond_the_ends_of_its_contours(first, there):
    """Held from above on faces that begin so far above the middle, where the pinch would come to rest."""
    with runs.not_closed():
        grasp, state = jxr.scenes.pinch(alpha=0.0, s=(0.008, 0.004))
    faces = (
        jxr.Line((first, 0.025)).moved((-0.015, 0.0), np.pi),
        jxr.Line((-0.025, -first)).moved((0.015, 0.0)),
    )
    held = jxr.Grasp(
        jxr.FreeObject(faces, 0.02, 1e-5), grasp.fingers, grasp.contacts, controller=grasp.controller
    )
    found = assess(held, state)
    assert bool(found.equilibrium.found) == there
    assert (found.verdict == VERDICTS.neutral) == there and (found.verdict == VERDICTS.not_found) != there
    places, statics = pinch_rest(held, state)
    assert np.isnan(places).any() != there and bool(np.isnan(statics.potential)) != there


def test_single_precision_finds_where_a_pinch_rests():
    """In a batch of starts, at a distance of the centres of some centimetres."""
    grasp, state = pinched_alone("pinch_ellipse")
    away = np.array([[0.0, 0.0], [1e-3, -2e-3], [-3e-3, -1e-3]])

    def rests(grasp, state, away):
        return jax.vmap(lambda d: pinch_rest(grasp, jxr.State(state.q, state.v, state.s + d)))(away)

    alone = [pinch_rest(grasp, jxr.State(state.q, state.v, state.s + d)) for d in away]
    # By the frames alone, against U differentiated automatically.
    found, statics = alone[1]
    there = pinch_statics(grasp, found)
    np.testing.assert_allclose(there.gradient, [0.0, 0.0], atol=1e-14)
    np.testing.assert_allclose(statics.hessian, there.hessian, rtol=1e-11)
    np.testing.assert_allclose(statics.potential, there.potential, rtol=1e-13)
    np.testing.assert_allclose([statics.d, statics.l], [there.d, there.l], rtol=0, atol=1e-14)
    single, near = in_single(rests, grasp, state, away)
    assert single.dtype == jnp.float32
    for i, (found, statics) in enumerate(alone):
        np.testing.assert_allclose(single[i], found, rtol=0, atol=1e-7)
        np.testing.assert_allclose(near.hessian[i], statics.hessian, rtol=1e-5)


@jax.jit
def root_of_two(start):
    equations = lambda z: jnp.stack([z[0] - 1.0, z[1] + 2.0 * z[0]])  # noqa: E731
    return _equilibrium._newton(equations, start, 1, jnp.zeros(2))


@pytest.mark.parametrize(("far", "reached"), [(8.95, True), (11.0, False)])
def test_newtons_method_goes_a_tenth_of_a_radian_at_once_and_a_hundred_times(far, reached):
    """To the root of two linear equations, of one angle and one force: at first the force alone moves."""
    found = root_of_two(np.array([1.0 - far, 0.5]))
    if reached:
        np.testing.assert_allclose(found, [1.0, -2.0], rtol=1e-13)
    else:
        np.testing.assert_allclose(found[0], 1.0 - far + 0.1 * 99, rtol=1e-12)


def test_a_plain_function_as_controller_has_no_precision():
    """Its place among a grasp's leaves is no array, and no reason to fail."""
    slack, state = on_driven_plate(lambda t, joints, rates, tips: [jnp.zeros(1)])
    assert bool(assess(slack, state).equilibrium.found)  # nothing pushes anywhere


@pytest.mark.parametrize("share", [0.0, 0.1, 1.0])
def test_a_damped_solution_is_bounded_where_an_eigenvalue_is_small(share):
    """Along each direction x/(x^2 + e^2), with e the share of the size of all eigenvalues x."""
    turned, values = np.array([[0.8, -0.6], [0.6, 0.8]]), np.array([-0.02, 5.0])
    matrix, right = turned @ np.diag(values) @ turned.T, np.array([0.3, -0.7])
    size = share * np.sqrt(np.sum(values**2))
    wanted = turned @ (values / (values**2 + size**2) * (turned.T @ right))
    np.testing.assert_allclose(_damped(jnp.asarray(matrix), jnp.asarray(right), share), wanted, rtol=1e-9)


@jax.jit
def rate_and_derivatives(k, c):
    """A root x of x^2 + c x + k, and of Re x - 2 Im x the derivative in k, and the second one in two ways."""
    rate = lambda k: eigenvalues(jnp.array([[0.0, 1.0], [-k, -c]]))[0]  # noqa: E731
    part = lambda k: rate(k).real - 2.0 * rate(k).imag  # noqa: E731
    return rate(k), jax.grad(part)(k), [jax.hessian(part)(k), jax.grad(jax.grad(part))(k)]


@pytest.mark.skipif(not _TWICE, reason="this version of JAX cannot be told")
@pytest.mark.parametrize("c", [3.0, 1.0])
def test_second_derivatives_of_rates_are_those_of_a_quadratic_equation(c):
    """The roots of x^2 + c x + k, real and complex: x_k = -1/r, x_kk = -2/r^3 with r = 2 x + c."""
    rate, slope, bends = rate_and_derivatives(1.1, c)
    r = 2.0 * np.asarray(rate) + c
    np.testing.assert_allclose(rate**2 + c * rate + 1.1, 0.0, atol=1e-14)
    first, second = -1.0 / r, -2.0 / r**3
    assert abs(r.imag if c < 2.0 else r.real) > 0.5
    np.testing.assert_allclose(slope, first.real - 2.0 * first.imag, rtol=1e-13)
    np.testing.assert_allclose(bends, [second.real - 2.0 * second.imag] * 2, rtol=1e-12)


def test_two_equations_by_hand():
    matrix, right = jnp.array([[3.0, 0.5], [0.5, -2.0]]), jnp.array([0.7, -1.1])
    np.testing.assert_allclose(_solved(matrix, right), np.linalg.solve(matrix, right), rtol=1e-14)


@pytest.mark.parametrize(
    ("share", "fine"), [(0.7e-6, True), (-0.7e-6, True), (1.5e-6, False), (-1.5e-6, False)]
)
def test_faces_are_straight_and_parallel_to_a_millionth(share, fine):
    """Beside the curvature of the fingertip; of an angle in radians. In single precision to 1e-4."""
    bends = np.array([[50.0 * share, 50.0], [0.0, -3.0]])
    assert _is_straight(bends).tolist() == [fine, True] and bool(_is_parallel(np.array(share))) == fine
    single = np.float32(100.0) * bends.astype(np.float32) * [[1.0, 0.01], [1.0, 0.01]]
    assert _is_straight(single.astype(np.float32)).tolist() == [fine, True]


def test_an_end_may_be_passed_by_rounding():
    """By a part of 1e12 of the contour's length, at either end."""
    tip = jxr.Catenary(1.0 / 40.0, (-0.02, 0.03)).moved((0.01, 0.0))
    for share, fine in ((0.7e-12, True), (1.5e-12, False)):
        for place in (-0.02 - 0.05 * share, 0.03 + 0.05 * share):
            if fine:
                assert np.isfinite(margin(tip, place))
                continue
            with pytest.raises(ValueError, match="argument s must lie between the contour's ends"):
                margin(tip, place)


class Coupled(eqx.Module):
    """Springs and dampers at all joints; one angle pulls at another joint besides, which has no potential."""

    angles: jax.Array
    stiffness: jax.Array

    def __call__(self, t, angles, rates, tips):
        return [-self.stiffness @ (angles[0] - self.angles) - 0.05 * rates[0]]


def test_without_a_potential_the_rates_alone_decide(scene):
    """The symmetric part of the Hessian has a negative eigenvalue, and every disturbance dies out.

    The finger of the pivoted scene has a third joint here, in whose axis the first link begins.
    """
    grasp, state = scene
    old, (turned, *angles) = grasp.fingers[0], np.asarray(state.q)
    finger = jxr.Finger(
        (0.05, *np.asarray(old.lengths)),
        (0.05, *np.asarray(old.masses)),
        old.tip,
        base=np.asarray(old.base) - [0.05, 0.0],
    )
    law = Coupled(jnp.array([0.0, *angles]), jnp.eye(3).at[1, 2].set(3.0))
    held = jxr.Grasp(grasp.object, finger, grasp.contacts, controller=law)
    found = assess(held, jxr.State(np.array([turned, 0.0, *angles]), np.zeros(4), state.s))
    assert found.verdict == VERDICTS.asymptotically_stable and found.rates.real.max() < -5.0
    assert found.curvatures[0] < -0.1 * found.curvatures[-1] and not found.bends_down


@pytest.mark.parametrize(
    ("rates", "bent", "neutral", "verdict"),
    [
        ([-3.0, -1.0, -1.0, -0.5], False, 0, "asymptotically_stable"),
        ([-3.0, -1.0, 0.0, -0.5], False, 1, "neutral"),
        ([-3.0, 0.0, 0.0, -0.5], False, 1, "undamped"),
        ([-3.0, -1.0, 0.0, -0.5], False, 0, "undamped"),
        ([-3.0, -1.0, 0.1, -0.5], False, 0, "unstable"),
        ([-3.0, -1.0, -1.0, -0.5], True, 0, "unstable"),
        ([-3.0, -1.0, 3.0 * 0.7e-7, -0.5], False, 1, "neutral"),
        ([-3.0, -1.0, 3.0 * 1.5e-7, -0.5], False, 1, "unstable"),
        ([-3.0, -1.0, -3.0 * 1.5e-7, -0.5], False, 0, "asymptotically_stable"),
        ([-3.0, -1.0, -3.0 * 0.7e-7, -0.5], False, 0, "undamped"),
    ],
)
def test_a_verdict_follows_from_rates_and_whether_the_potential_bends_down(rates, bent, neutral, verdict):
    found = _verdict(jnp.array(rates) + 0.0j, jnp.asarray(bent), jnp.asarray(neutral), jnp.asarray(1e-7))
    assert repr(found) == verdict


@pytest.mark.parametrize(
    ("least", "skew", "bent"),
    [
        (-0.7e-7, 0.0, False),
        (-1.5e-7, 0.0, True),
        (-0.5, 0.9e-7, True),
        (-0.5, 2e-7, False),
        (0.5, 0.0, False),
    ],
)
def test_a_potential_bends_down_where_there_is_one(least, skew, bent):
    hessian = 4.0 * jnp.array([[least, 0.5 * skew], [-0.5 * skew, 1.0]])
    assert bool(_bent_down(hessian, 4.0 * jnp.array([least, 1.0]), 1e-7)) == bent


def test_forces_that_vanish_at_the_start_are_sized_by_their_stiffness():
    """Of a spring that is at rest: a millionth of its stiffness times the mean length of a link."""
    grasp, state = runs.scene("pinch")
    spring = jxr.loads.Spring(80.0, anchor=state.q[:2])
    held = grasp.with_(controller=None, load=spring)
    size = float(eqx.filter_jit(_force_size)(held, state, jnp.zeros(0), t=0.0))
    mean = sum(float(finger.lengths.mean()) for finger in grasp.fingers) / 2.0
    np.testing.assert_allclose(size, 1e-6 * 80.0 * mean, rtol=1e-12)
