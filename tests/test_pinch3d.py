"""Part 3: a pinch in space against a second formulation, its rows, its planar case and its gradients."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.scenes import _space_scenes
from tests.helpers import slow_among
from tests.measures import both_slopes
from tests.oracles import reference_space as reference
from tests.subjects.pinches_in_space import AS_TOLD, egg, PINCHES, same_in_reference

TS = np.linspace(0.0, 1.0, 11)


HARD = slow_among([*PINCHES], *PINCHES, optimised=["ellipsoids"])


@pytest.fixture(scope="module", params=HARD)
def case(request):
    scene = jxr.scenes.pinch3d(**PINCHES[request.param])
    run = jxr.simulate(*scene, t1=1.0, ts=TS, record=("multipliers", "energy"), rtol=1e-11)
    return request.param, scene, run


def test_motion_and_forces_against_a_second_formulation(case):
    """Located contacts, null space and SciPy; neither rows nor integration are shared."""
    kind, (grasp, state), run = case
    scene = same_in_reference(grasp, **AS_TOLD.get(kind, {}))
    q, v = reference.simulate(scene, np.asarray(state.q), np.asarray(state.v), TS)
    assert np.abs(run.states.q - q).max() <= 1e-8
    assert np.abs(run.states.v - v).max() <= 1e-8
    assert np.abs(q[-1] - q[0]).max() > 1e-2  # it moves
    for i in (0, 10):
        normal, tangential, spin = reference.forces(scene, q[i], v[i])
        np.testing.assert_allclose(run.multipliers.f[i], normal, atol=1e-7)
        np.testing.assert_allclose(run.multipliers.lam[i], -np.asarray(tangential), atol=1e-7)
        if kind == "spin prevented":
            assert np.abs(spin).max() > 1e-5
            np.testing.assert_allclose(run.multipliers.spin[i], -np.asarray(spin), atol=1e-9)
        else:
            assert run.multipliers.spin is None


def test_rows_and_energy(case):
    _, _, run = case
    left = run.residuals
    for part in (left.normal, left.tangential, left.tangency):
        assert np.abs(part).max() <= 1e-12
    size = np.abs(run.energy.kinetic + run.energy.potential).max()
    assert np.abs(run.energy.residual).max() <= 1e-9 * size
    np.testing.assert_allclose(np.linalg.norm(run.states.q[:, 3:7], axis=-1), 1.0, atol=1e-15)


def test_contact_points_stay_on_their_surfaces(case):
    kind, (grasp, _), run = case
    if kind != "ellipsoids":
        pytest.skip("the ellipsoids' is the hard case")
    tip, body = grasp.fingers[0].tip, grasp.object.surfaces[0]
    for surface, at in ((tip, run.states.s[:, :3]), (body, run.states.s[:, 3:6])):
        axes = np.array([float(surface.a), float(surface.b), float(surface.c)])
        assert np.abs(np.sum((np.asarray(at) / axes) ** 2, axis=-1) - 1.0).max() <= 1e-14


def test_the_scene_has_the_numbers_of_the_second_formulation(monkeypatch):
    """Written down twice; and the search for closed contacts starts with the fingertips at them."""
    monkeypatch.setattr(_space_scenes, "close", lambda grasp, guess, **_: (grasp, guess))
    grasp, state = jxr.scenes.pinch3d()
    for i, (finger, side) in enumerate(zip(grasp.fingers, (-1.0, 1.0), strict=True)):
        wanted = reference.three_joint_finger((0.0275 * side, 0.0, 0.0), reference.sphere(0.010))
        for name in ("base", "axes", "offsets", "masses", "centres"):
            np.testing.assert_allclose(getattr(finger, name), getattr(wanted, name), err_msg=name)
        assert float(finger.tip.radius) == 0.010
        tip = wanted.place(state.q[7 + 3 * i : 10 + 3 * i])[0][-1]
        np.testing.assert_allclose(tip, (0.025 * side, 0.113, -0.004 * side), atol=1e-3)
    assert [(c.finger, c.surface) for c in grasp.contacts] == [(0, 0), (1, 1)]


@pytest.mark.slow
def test_a_scene_of_another_size_moves_alike():
    """Froude's similarity: in the same gravity lengths times k, forces times k^3, times times its root."""
    found = []
    for k in (1.0, 2.5):
        scene = jxr.scenes.pinch3d(size=k, gravity=(0.3, -1.0, 0.5))
        run = jxr.simulate(*scene, t1=0.5 * k**0.5, ts=6, rtol=1e-11, record=("multipliers",))
        q = np.asarray(run.states.q) / np.where(np.arange(13) < 3, k, 1.0)[None]
        found.append((q, np.asarray(run.multipliers.f) / k**3))
    (q, f), (similar, forces) = found
    np.testing.assert_allclose(similar, q, atol=1e-11)
    np.testing.assert_allclose(forces, f, atol=1e-11)
    assert np.abs(q[-1] - q[0]).max() > 1e-2


@pytest.mark.slow
def test_default_settings_are_within_a_micrometre():
    grasp, state = jxr.scenes.pinch3d()
    runs = [jxr.simulate(grasp, state, t1=1.0, ts=TS, rtol=rtol).states.q for rtol in (1e-8, 1e-11)]
    assert np.abs(runs[0] - runs[1]).max() <= 1e-8


def flat(spatial):
    """A planar pinch with round tips, and the same in space: cylinders, a cuboid, joints about z."""
    grasp, state = jxr.scenes.ball_plate(alpha=0.0)
    if not spatial:
        return grasp, state
    fingers = []
    for finger in grasp.fingers:
        k = finger.joints
        along = lambda x, k=k: np.stack([np.asarray(x), np.zeros(k), np.zeros(k)], axis=-1)  # noqa: E731
        turning = np.zeros((k, 3, 3)) + 1e-9 * np.eye(3)
        turning[:, 2, 2] = finger.inertias
        options = {"base": np.append(finger.base, 0.0), "centres": along(finger.centres), "inertias": turning}
        axes = np.tile([0.0, 0.0, 1.0], (k, 1))
        fingers.append(
            jxr.Finger3(axes, along(finger.lengths), finger.masses, jxr.geometry.Cylinder(0.01), **options)
        )
    body = jxr.scenes.cuboid(0.03, 0.05, 0.05, 0.02)
    inertia = np.asarray(body.inertia).copy()
    inertia[2, 2] = float(grasp.object.inertia)
    body = jxr.FreeObject3(body.surfaces, 0.02, inertia)
    contacts = [jxr.Contact3(i, i, line=True) for i in range(2)]
    control = jxr.control.Opposition(20.0, 0.006, start=jnp.zeros(2))
    x, y, turn = np.asarray(state.q[:3])
    q = np.concatenate([[x, y, 0, np.cos(turn / 2), 0, 0, np.sin(turn / 2)], state.q[3:]])
    return jxr.Grasp(body, fingers, contacts, controller=control), q


@pytest.mark.slow
def test_planar_scene_in_space_is_the_planar_one():
    grasp, state = flat(False)
    spatial, q = flat(True)
    body, tips = spatial.object, spatial.fingers
    places = []
    for i, finger in enumerate(spatial.fingers):
        pose = finger.prepared().pose(tuple(jnp.asarray(q[7 + 3 * i : 7 + 3 * i + finger.joints])))
        reach = body.surfaces[i].near(_in(q, np.asarray(pose.origin.array())))
        there = _out(q, np.asarray(body.surfaces[i].point(reach)))
        local = jnp.stack(list(pose.local(type(pose.origin)(*there))))
        places += [tips[i].tip.near(local), reach]
    start = jxr.State(jnp.asarray(q), jnp.zeros(11), jnp.concatenate(places))
    _, start = jxr.close(spatial, start)
    np.testing.assert_allclose(start.q, q, atol=1e-12)
    flat_run = jxr.simulate(grasp, state, t1=1.0, ts=TS, rtol=1e-11, record=("multipliers",))
    run = jxr.simulate(spatial, start, t1=1.0, ts=TS, rtol=1e-11, record=("multipliers",))
    turn = 2 * np.arctan2(run.states.q[:, 6], run.states.q[:, 3])
    found = np.concatenate([run.states.q[:, :2], turn[:, None], run.states.q[:, 7:]], axis=-1)
    assert np.abs(found - flat_run.states.q).max() <= 1e-9
    assert np.abs(run.multipliers.f - flat_run.multipliers.f).max() <= 1e-9
    assert np.abs(run.states.q[:, 2]).max() <= 1e-12  # it stays in the plane


def _in(q, point):
    """A world point in the object's axes."""
    return reference.quaternion_matrix(q[3:7]).T @ (point - q[:3])


def _out(q, point):
    return q[:3] + reference.quaternion_matrix(q[3:7]) @ point


def final(scene, axes):
    """Where the object is after 0.3 s, fingertips and object of these semi-axes."""
    grasp, state = scene
    tip = jxr.Ellipsoid(*axes[:3])
    moved = grasp.with_tip(0, tip).with_tip(1, tip).with_(surfaces=(jxr.Ellipsoid(*axes[3:]),))
    closed = jxr.close(moved, state, hold_contacts=False)
    return jxr.simulate(*closed, t1=0.3, ts=2, rtol=1e-11).last.q[:7]


def central(cost, axes, way, h):
    """Derivative along a way by central differences of fourth order."""
    samples = [float(cost(axes + k * h * way)) for k in (-2, -1, 1, 2)]
    return (samples[0] - 8 * samples[1] + 8 * samples[2] - samples[3]) / (12 * h)


@pytest.mark.slow
def test_gradient_in_surface_parameters_of_a_pinch():
    """Semi-axes of both tips and of the object, reverse mode, through close and simulate."""
    axes = jnp.array([0.010, 0.008, 0.009, 0.015, 0.025, 0.020])
    way = jnp.array([1.0, -0.5, 0.7, 0.4, -1.0, 0.8])
    scene = jxr.scenes.pinch3d(object=egg(), tips=jxr.Ellipsoid(0.010, 0.008, 0.009))
    cost = lambda axes: final(scene, axes) @ jnp.array([1.0, 2.0, -1.0, 0.5, 0.3, -0.7, 1.5])  # noqa: E731
    both = jax.jit(jax.value_and_grad(cost))
    slope = both(axes)[1] @ way
    assert float(slope) == pytest.approx(central(lambda x: both(x)[0], axes, way, 2e-5), rel=1e-6)


def rocked(scene, axes):
    """Where an egg of these semi-axes is after it rocked on a table for 0.3 s, started by hand."""
    grasp, state = scene
    moved = grasp.with_(surfaces=(jxr.Ellipsoid(*axes).moved((0.0, 0.0, 0.01)),))
    _, closed = jxr.close(moved, state, hold_contacts=False)
    return jxr.simulate(moved, closed, t1=0.3, ts=2, rtol=1e-11).last.q


@pytest.mark.slow
@pytest.mark.optimised
def test_gradient_in_surface_parameters_of_a_rolling_body():
    """In both modes."""
    axes, way = jnp.array([0.05, 0.03, 0.04]), jnp.array([1.0, -0.6, 0.8])
    scene = jxr.scenes.rattleback(spin=2.0, tilt=0.2, axes=(0.05, 0.03, 0.04))
    both = both_slopes(lambda axes: rocked(scene, axes) @ jnp.array([1.0, 2.0, -1.0, 0.5, 0.3, -0.7, 1.5]))
    wanted = central(lambda axes: both(axes, way)[0], axes, way, 2e-5)
    _, forward, reverse = both(axes, way)
    np.testing.assert_allclose([forward, reverse @ way], wanted, rtol=1e-6)


@pytest.mark.slow
def test_close_from_located_contacts():
    """`locate=True` finds the contacts of a displaced pose by itself."""
    grasp, state = jxr.scenes.pinch3d(object=egg(), tips=jxr.Sphere(0.01))
    rng = np.random.default_rng(1)
    moved = state.q.at[:3].add(1e-3 * rng.normal(size=3)).at[7:].add(0.02 * rng.normal(size=6))
    lost = jxr.State(moved, state.v, jnp.ones_like(state.s) * 0.004)
    _, found = jxr.close(grasp, lost, locate=True)
    left = jxr.residuals(grasp, found)
    for part in (left.normal, left.tangential, left.tangency):
        assert np.abs(part).max() <= 1e-14


@pytest.mark.slow
def test_close_out_of_reach_names_the_worst_row():
    """Two fingers 10 m apart cannot hold one object, however the search goes."""
    grasp, state = jxr.scenes.pinch3d()
    apart = eqx.tree_at(lambda g: g.fingers[1].base, grasp, replace_fn=lambda base: base + 10.0)
    with pytest.raises(ValueError, match="argument guess must be near a pose that closes every contact"):
        jxr.close(apart, state)


def test_close_refuses_an_object_without_an_orientation():
    grasp, state = jxr.scenes.incline()
    guess = jxr.State(state.q.at[3:7].set(0.0), state.v, state.s)
    with pytest.raises(ValueError, match=r"argument guess must have a quaternion .* in q\[3:7\]"):
        jxr.close(grasp, guess)


@pytest.mark.parametrize("length", [1.0 - 2e-4, 1.0 + 2e-4, 2.0])
def test_a_quaternion_that_would_bend_the_object_is_refused(length):
    """Of one state and of several; four decimals, steps of differences and rows without numbers are not."""
    grasp, state = jxr.scenes.incline()
    at = lambda q: jxr.State(q, state.v, state.s)  # noqa: E731
    many = lambda q: jax.tree.map(lambda x: jnp.stack([x, x]), at(q))  # noqa: E731
    words = r"argument states?\.q must hold a unit quaternion in q\[3:7\], but its length was "
    bent = state.q.at[3:7].multiply(length)
    calls = (
        lambda: jxr.residuals(grasp, at(bent)),
        lambda: jxr.residuals(grasp, many(bent)),
        lambda: jxr.multipliers(grasp, 0.0, at(bent)),
        lambda: jxr.simulate(grasp, at(bent), 0.01),
        lambda: jxr.control.orientations(grasp, at(bent)),
    )
    for call in calls:
        with pytest.raises(ValueError, match=f"{words}{length:.4g}"):
            call()
    rounded = state.q.at[3].add(5e-5)
    lost = jax.tree.map(lambda x: x.at[1].set(jnp.nan), many(rounded))
    np.testing.assert_allclose(jxr.residuals(grasp, lost).normal[0], jxr.residuals(grasp, at(rounded)).normal)
    # Whatever its length is, a guess is scaled.
    closed = jxr.close(grasp, at(bent))[1]
    np.testing.assert_allclose(np.linalg.norm(closed.q[3:7]), 1.0, rtol=1e-14)


@pytest.mark.slow
def test_batch_of_grasps_is_the_grasps():
    grasp, state = jxr.scenes.pinch3d()
    betas = jnp.array([15.0, 20.0, 25.0])

    def end(beta):
        return jxr.simulate(grasp.with_(beta=beta), state, t1=0.3, ts=2, throw=False).last.q

    np.testing.assert_allclose(jax.vmap(end)(betas), [end(beta) for beta in betas], atol=1e-10)


@pytest.mark.slow
def test_blind_control_sees_tips_in_space():
    """A user's controller gets positions and Jacobians of shape (3,) and (3, k)."""

    def push(t, angles, rates, tips):
        pulls = (tips[0].position - tips[1].position, tips[1].position - tips[0].position)
        each = zip(rates, tips, pulls, strict=True)
        return tuple(-0.006 * rate - 20.0 * tip.jacobian.T @ pull for rate, tip, pull in each)

    grasp, state = jxr.scenes.pinch3d()
    own = jxr.simulate(grasp.with_(controller=push), state, t1=0.2, ts=2)
    known = jxr.simulate(grasp, state, t1=0.2, ts=2)
    np.testing.assert_allclose(own.states.q, known.states.q, atol=1e-11)
