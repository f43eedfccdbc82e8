"""Loads on the object and gravity per body: closed forms, second formulations, derivatives, sentences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.loads import Drag, Push, Spring
from tests.measures import both_slopes
from tests.oracles import reference_space as reference
from tests.oracles.chapter_part1 import Part1, planar_rotation, turned_left
from tests.recorded import runs
from tests.subjects.pinches_in_space import same_in_reference

RADIUS, MASS, INERTIA = 0.02, 0.1, 3e-5
TS = np.linspace(0.0, 1.0, 11)


def disc(load=None):
    """A disc that rests on a level line, which it presses by its weight, and can roll along x."""
    floor = jxr.Jaw(jxr.Line(), directions=(), angle=0.5 * np.pi)
    body = jxr.FreeObject(jxr.Circle(RADIUS), MASS, INERTIA)
    grasp = jxr.Grasp(body, floor, jxr.Contact(), gravity=(0.0, -9.81), load=load)
    return grasp, jxr.State([0.0, RADIUS, 1.5 * np.pi], np.zeros(3), np.zeros(1))


def ball(load=None):
    """A solid ball on a level plane."""
    grasp, state = jxr.scenes.incline(slope=0.0)
    return grasp.with_(load=load), state


def three(axes, **numbers):
    """One load of each kind, so that one program serves all tests; those not named are zero."""
    none = np.zeros(axes)
    given = {"force": none, "start": 0.2, "duration": 0.3, "linear": 0.0, "angular": 0.0}
    given |= {"stiffness": 0.0, "anchor": none} | numbers
    push = Push(*(given[name] for name in ("force", "start", "duration")))
    return push, Drag(given["linear"], given["angular"]), Spring(given["stiffness"], given["anchor"])


def rolled(scene, load, velocity=()):
    """A run of a rolling body under loads; the first coordinates of its origin, and their rates."""
    grasp, state = scene(load)
    axes, r = 3 if grasp.spatial else 2, float(state.q[2 if grasp.spatial else 1])
    v = np.zeros(state.v.shape)
    if len(velocity):
        v[: axes - 1] = velocity
        v[axes:] = (-velocity[1] / r, velocity[0] / r, 0.0) if grasp.spatial else -velocity[0] / r
    state = eqx.tree_at(lambda s: s.v, state, jnp.asarray(v))
    run = jxr.simulate(grasp, state, 1.0, ts=TS, rtol=1e-12, record=("energy",))
    size = np.abs(run.energy.kinetic).max() + np.abs(run.energy.work).max()
    assert size > 0 and np.abs(run.energy.residual).max() <= 1e-9 * size
    q, v = np.asarray(run.states.q), np.asarray(run.states.v)
    return q[:, : axes - 1] - np.asarray(state.q)[: axes - 1], v[:, : axes - 1]


# Scene, mass with the inertia that rolls along, square of the radius.
ROLLING = {
    "plane": (disc, MASS + INERTIA / RADIUS**2, RADIUS**2),
    "space": (ball, 1.4 * 0.3, 0.05**2),
}
rolling = pytest.mark.parametrize(("scene", "inert", "square"), ROLLING.values(), ids=ROLLING)


def height(scene):
    """Of the centre [m]."""
    return RADIUS if scene is disc else 0.05


@rolling
def test_a_spring_at_the_centre_makes_it_oscillate(scene, inert, square):
    """About the anchor: x = a (1 - cos(w t)) with w^2 = k / (m + I/r^2)."""
    anchor = np.array([0.01] if scene is disc else [0.01, -0.02])
    load = three(len(anchor) + 1, stiffness=5.0, anchor=np.append(anchor, height(scene)))
    x, v = rolled(scene, load)
    w = np.sqrt(5.0 / inert)
    np.testing.assert_allclose(x, anchor * (1 - np.cos(w * TS))[:, None], rtol=0, atol=1e-9)
    np.testing.assert_allclose(v, anchor * w * np.sin(w * TS)[:, None], rtol=0, atol=1e-9)


@rolling
def test_drag_makes_the_speed_decay(scene, inert, square):
    """At the rate (c + d/r^2) / (m + I/r^2)."""
    start, axes = np.array([0.3] if scene is disc else [0.3, -0.1]), 2 if scene is disc else 3
    x, v = rolled(scene, three(axes, linear=0.2, angular=1e-4), start)
    rate = (0.2 + 1e-4 / square) / inert
    assert np.abs(v).max() > 0.1
    np.testing.assert_allclose(v, start * np.exp(-rate * TS)[:, None], rtol=0, atol=1e-9)
    np.testing.assert_allclose(x, start * -np.expm1(-rate * TS)[:, None] / rate, rtol=0, atol=1e-9)


@rolling
def test_a_push_gives_its_impulse(scene, inert, square):
    """Velocity F (t/2 - T/(4 pi) sin(2 pi t/T)) / (m + I/r^2) after its begin, and F T/2 / (...) at last."""
    force = np.array([0.1] if scene is disc else [0.1, 0.2])
    _, v = rolled(scene, three(len(force) + 1, force=np.append(force, 0.0)))
    t = np.clip(TS - 0.2, 0.0, 0.3)
    impulse = t / 2 - 0.3 / (4 * np.pi) * np.sin(2 * np.pi * t / 0.3)
    assert impulse[-1] == pytest.approx(0.15, rel=1e-15)
    np.testing.assert_allclose(v, force * impulse[:, None] / inert, rtol=0, atol=1e-9)


class Own(eqx.Module):
    """A user's load: a constant force, a drag and a spring at the origin."""

    force: jax.Array
    linear: jax.Array
    angular: jax.Array
    stiffness: jax.Array
    anchor: jax.Array

    def __call__(self, t, pose, twist):
        force = self.force - self.linear * twist.velocity - self.stiffness * (pose.position - self.anchor)
        return force, -self.angular * twist.spin


@rolling
def test_a_users_own_load(scene, inert, square):
    """A constant force accelerates evenly; a drag and a spring of one's own are those that are built in."""
    way = 1 if scene is disc else 2
    zero, none = jnp.zeros(()), jnp.zeros(way + 1)
    force = none.at[:way].set(jnp.array([0.1, 0.2])[:way])
    x, v = rolled(scene, Own(force, zero, zero, zero, none))
    force = np.asarray(force)
    np.testing.assert_allclose(v, force[:way] * TS[:, None] / inert, rtol=0, atol=1e-9)
    np.testing.assert_allclose(x, 0.5 * force[:way] * TS[:, None] ** 2 / inert, rtol=0, atol=1e-9)
    numbers = {"linear": 0.2, "angular": 1e-4, "stiffness": 5.0, "anchor": jnp.append(none[:way] + 0.01, 0.1)}
    built_in, _ = rolled(scene, three(way + 1, **numbers), np.full(way, 0.1))
    own, _ = rolled(scene, Own(none, *map(jnp.asarray, numbers.values())), np.full(way, 0.1))
    np.testing.assert_allclose(own, built_in, rtol=0, atol=1e-12)


# --- second formulations


def push_of(t, force, start, duration):
    """The force of a push."""
    share = (t - start) / duration
    return np.asarray(force) * (np.sin(np.pi * share) ** 2 if 0.0 < share < 1.0 else 0.0)


def pull_of(numbers, at, moves):
    """The force of a spring on a point of the object."""
    apart = at - np.asarray(numbers["anchor"])
    long = np.sqrt(apart @ apart)
    return -numbers["stiffness"] * (long - numbers["length"]) * apart / long - numbers["damping"] * moves


def full(numbers):
    """All that the three loads can do."""
    return (
        Push(numbers["force"], numbers["start"], numbers["duration"], point=numbers["pushed"]),
        Drag(numbers["linear"], numbers["angular"]),
        Spring(
            numbers["stiffness"],
            numbers["anchor"],
            point=numbers["hung"],
            length=numbers["length"],
            damping=numbers["damping"],
        ),
    )


PLANE = {"force": (0.3, -0.2), "start": 0.05, "duration": 0.2, "pushed": (0.01, 0.02), "linear": 0.05}
PLANE |= {"angular": 1e-5, "stiffness": 15.0, "anchor": (0.05, 0.15), "hung": (-0.01, 0.015)}
PLANE |= {"length": 0.03, "damping": 0.02}
SPACE = {"force": (0.1, -0.1, 0.05), "start": 0.05, "duration": 0.2, "pushed": (0.01, 0.02, -0.015)}
SPACE |= {"linear": 0.05, "angular": 1e-4, "stiffness": 5.0, "anchor": (0.05, 0.08, 0.1)}
SPACE |= {"hung": (-0.01, 0.015, 0.03), "length": 0.03, "damping": 0.02}


def check_energy(run):
    size = np.abs(run.energy.kinetic).max() + np.abs(run.energy.work).max()
    assert np.abs(run.energy.work).max() > 1e-6 and np.abs(run.energy.residual).max() <= 1e-9 * size


def test_a_pinch_under_loads_against_the_chapters_equations():
    """Also of gravity that pulls the object alone, its fingers' weight compensated."""
    grasp, state = jxr.scenes.pinch(s=(0.004, -0.003))
    weight = np.array([0.5, -3.0])
    gravity = np.stack([weight, np.zeros(2), np.zeros(2)])
    ts = np.linspace(0.0, 0.4, 9)
    loaded = grasp.with_(load=full(PLANE), gravity=gravity)
    run = jxr.simulate(loaded, state, 0.4, ts=ts, rtol=1e-12, record=("energy",))

    def wrench(t, X, v):
        turned = planar_rotation(X[2])
        pushed, hung = turned @ PLANE["pushed"], turned @ PLANE["hung"]
        push = push_of(t, PLANE["force"], PLANE["start"], PLANE["duration"])
        pull = pull_of(PLANE, X[:2] + hung, v[:2] + v[2] * turned_left(hung))
        drag = -PLANE["linear"] * v[:2]
        torque = turned_left(pushed) @ push + turned_left(hung) @ pull - PLANE["angular"] * v[2]
        return push + pull + drag + Part1.mass * weight, torque

    q = np.asarray(state.q)
    chapter = Part1(np.array([q[3:6].sum(), q[6:8].sum()]), wrench)
    X, v, *_ = chapter.simulate(q, np.array([0.004, -0.003]), ts)
    assert np.ptp(X[:, 2]) > 0.02  # it does turn
    np.testing.assert_allclose(run.states.q, X, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.v, v, rtol=0, atol=1e-9)
    check_energy(run)


def test_a_ball_in_space_under_loads_against_a_second_formulation():
    """Its centre of mass in its middle, its inertia about three axes unlike, so that axes matter."""
    grasp, state = ball(full(SPACE))
    grasp = grasp.with_(inertia=(2e-4, 3e-4, 4e-4), gravity=((0.2, 0.1, -9.0), (5.0, 5.0, 5.0)))
    ts = np.linspace(0.0, 0.4, 5)
    v0 = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    state = eqx.tree_at(lambda s: s.v, state, jnp.asarray(v0))
    run = jxr.simulate(grasp, state, 0.4, ts=ts, rtol=1e-12, record=("energy",))
    nothing, none = np.zeros(0), np.zeros((0, 3))
    table = reference.Chain(
        np.zeros(3), none, none, nothing, none, np.zeros((0, 3, 3)), reference.Plane((0, 0, 0), (0, 0, 1.0))
    )
    body = reference.Body(0.3, np.diag([2e-4, 3e-4, 4e-4]), (reference.sphere(0.05),))
    scene = reference.Scene((table,), body, ((0, 0),), gravity=(0.2, 0.1, -9.0))

    def wrench(t, q, v):
        R = reference.quaternion_matrix(q[3:7])
        spin = R @ v[3:6]
        pushed, hung = R @ SPACE["pushed"], R @ SPACE["hung"]
        push = push_of(t, SPACE["force"], SPACE["start"], SPACE["duration"])
        pull = pull_of(SPACE, q[:3] + hung, v[:3] + np.cross(spin, hung))
        torque = np.cross(pushed, push) + np.cross(hung, pull) - SPACE["angular"] * spin
        return push + pull - SPACE["linear"] * v[:3], torque

    q, v = reference.simulate(scene, np.asarray(state.q), v0, ts, wrench=wrench)
    assert np.abs(q[-1] - q[0])[[0, 1, 4, 5, 6]].min() > 1e-3
    np.testing.assert_allclose(run.states.q, q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.v, v, rtol=0, atol=1e-9)
    check_energy(run)


@pytest.mark.slow
def test_a_pinch_in_space_under_loads_against_a_second_formulation():
    grasp, state = jxr.scenes.pinch3d()
    force, torque = jnp.array([0.05, -0.1, 0.08]), jnp.array([1e-4, -2e-4, 1e-4])
    loaded = grasp.with_(load=[lambda t, pose, twist: (force * t, torque), Drag(0.05, 1e-5)])
    ts = np.linspace(0.0, 0.3, 4)
    run = jxr.simulate(loaded, state, 0.3, ts=ts, rtol=1e-12, record=("energy",))

    def wrench(t, q, v):
        spin = reference.quaternion_matrix(q[3:7]) @ v[3:6]
        return np.asarray(force) * t - 0.05 * v[:3], np.asarray(torque) - 1e-5 * spin

    start = np.asarray(state.q), np.asarray(state.v)
    q, v = reference.simulate(same_in_reference(grasp), *start, ts, wrench=wrench)
    np.testing.assert_allclose(run.states.q, q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.states.v, v, rtol=0, atol=1e-9)
    check_energy(run)


# --- batches and derivatives

# Of the loads on the disc: a vector of all their numbers.
NUMBERS = {"force": (0.1, -0.05), "start": 0.1, "duration": 0.25, "pushed": (0.01, 0.005), "linear": 0.05}
NUMBERS |= {"angular": 1e-5, "stiffness": 4.0, "anchor": (0.03, 0.06), "hung": (-0.005, 0.01)}
NUMBERS |= {"length": 0.02, "damping": 0.02}
FLAT, REBUILT = jax.flatten_util.ravel_pytree(jax.tree.map(float, NUMBERS, is_leaf=np.isscalar))
FLAT = np.asarray(FLAT)


def disc_end(p, ts=1):
    """Where the disc is under the loads of these numbers."""
    grasp, state = disc(full(REBUILT(p)))
    run = jxr.simulate(grasp, state, 0.6, ts=ts, rtol=1e-11)
    return run.last.q[0] + 0.1 * run.last.v[0]


# One program for the values and both derivatives.
SLOPES = both_slopes(disc_end)
STEPS = 1e-4 * np.maximum(np.abs(FLAT), 0.01)


@pytest.fixture(scope="module")
def lanes():
    """Rows of numbers and their ends as one batch: three unlike ones, and four steps along each number."""
    unlike = FLAT * np.array([[0.5], [1.0], [1.5]])
    near = FLAT + np.array([-2, -1, 1, 2])[:, None, None] * np.diag(STEPS)
    rows = np.concatenate([unlike, near.reshape(-1, FLAT.size)])
    return rows, np.asarray(jax.jit(jax.vmap(disc_end))(rows))


def test_derivatives_in_all_numbers_of_the_loads(lanes):
    """Both modes against central differences, and each other."""
    ways = np.eye(FLAT.size)
    forward = np.array([SLOPES(FLAT, way)[1] for way in ways])
    backward = SLOPES(FLAT)[2]
    np.testing.assert_allclose(backward, forward, rtol=1e-12, atol=1e-12 * np.abs(forward).max())
    slopes = np.array([1, -8, 8, -1]) @ lanes[1][3:].reshape(4, -1) / (12 * STEPS)
    assert (np.abs(slopes - forward) <= 1e-7 * np.maximum(1.0, np.abs(slopes))).all()
    assert np.abs(forward).min() > 1e-6


def test_a_batch_over_a_loads_number_is_the_single_runs(lanes):
    alone = [SLOPES(p)[0] for p in lanes[0][:3]]
    np.testing.assert_allclose(lanes[1][:3], alone, rtol=0, atol=1e-13)


# --- what else reads loads


def test_of_a_pivoted_object_the_torque_alone_counts(scene):
    grasp, state = scene
    f = lambda load: np.asarray(jxr.multipliers(grasp.with_(load=load), 0.1, state).f)  # noqa: E731
    push = lambda force, point: (Push(force, 0.0, 0.2, point=point), Drag(0.5, 0.0), Spring(9.0, (0, 0)))  # noqa: E731
    twisted = lambda torque: f(jax.tree_util.Partial(twisting, jnp.asarray(torque)))  # noqa: E731
    bare, turned = f(None), f(push((0.3, -0.2), (0.01, 0.02)))
    for none in (f(push((0.0, 0.0), (0, 0))), f(push((0.7, 0.9), (0, 0))), twisted(0.0)):
        np.testing.assert_allclose(bare, none, rtol=0, atol=1e-15)
    arm = planar_rotation(float(state.q[0])) @ [0.01, 0.02]
    wanted = twisted(turned_left(arm) @ [0.3, -0.2])
    assert np.abs(turned - bare).max() > 1e-3
    np.testing.assert_allclose(turned, wanted, rtol=1e-13)


def twisting(torque, t, pose, twist):
    """A load with a force, which a pivoted object does not feel."""
    return jnp.array([5.0, 7.0]), torque


def test_equilibrium_and_verdict_under_a_spring():
    """At rest under the anchor; the only way out of it has the curvature k / (m + I/r^2)."""
    anchor = (0.01, 0.05)
    for stiffness, verdict in ((5.0, "asymptotically_stable"), (-5.0, "unstable")):
        grasp, state = disc([Spring(stiffness, anchor), Drag(0.2, 0.0)])
        found = jxr.stability.assess(grasp, state)
        rest, inert = found.equilibrium, MASS + INERTIA / RADIUS**2
        assert bool(rest.found) and found.verdict == getattr(jxr.stability.VERDICTS, verdict)
        assert float(rest.state.q[0]) == pytest.approx(0.01, abs=1e-12)
        assert float(found.hessian[0, 0]) == pytest.approx(stiffness / inert, rel=1e-9)
        assert complex(found.rates.sum()).real == pytest.approx(-0.2 / inert, rel=1e-9)
        pressed = MASS * 9.81 - stiffness * (anchor[1] - RADIUS)
        assert float(rest.multipliers.f[0]) == pytest.approx(pressed, rel=1e-12)


def test_at_the_length_of_nothing_a_spring_does_not_pull():
    """Where its direction is not defined it is zero, with finite derivatives."""
    grasp, state = disc(Spring(5.0, (0.0, RADIUS), length=0.01))
    grasp_without, _ = disc()
    pressed = lambda a: jxr.multipliers(grasp.with_(load=Spring(5.0, a, length=0.01)), 0.0, state).f[0]  # noqa: E731
    at = jnp.array([0.0, RADIUS])
    assert float(pressed(at)) == pytest.approx(float(jxr.multipliers(grasp_without, 0.0, state).f[0]))
    assert np.isfinite(jax.grad(pressed)(at)).all()


# --- sentences


def returned(given):
    grasp, state = disc(lambda t, pose, twist: given)
    return lambda: jxr.simulate(grasp, state, 0.1)


REFUSED = {
    "of space on a disc": (
        lambda: disc(Push((0, 0, 1), 0, 1)),
        r"load must have 2 numbers as force, as the grasp's points have, but had 3",
    ),
    "a point of space": (
        lambda: disc(Spring(1.0, (0, 0), point=(0, 0, 0))),
        r"point must have shape \(2,\), but had shape \(3,\)",
    ),
    "of the plane on a ball": (lambda: ball(Spring(1.0, (0, 0))), "load must have 3 numbers as anchor"),
    "four numbers": (lambda: Push((0, 0, 0, 0), 0, 1), r"force must have shape \(2\) or \(3\)"),
    "no duration": (lambda: Push((0, 0), 0, 0.0), "duration must be positive"),
    "no length": (lambda: Spring(1.0, (0, 0), length=0.0), "length must be positive"),
    "no load": (lambda: disc("heavy"), "load must be a load, or callable as f"),
    "of two arguments": (lambda: disc(lambda t, pose: 0.0), "load must be a load, or callable as f"),
    "gravity for too many": (
        lambda: disc()[0].with_(gravity=np.zeros((3, 2))),
        r"gravity must have shape \(2\) or \(2, 2\), but had shape \(3, 2\)",
    ),
    "returns nothing": (returned(None), "load must return a force and a torque, but returned None"),
    "returns a force": (returned((jnp.zeros(2),)), "load must return a force and a torque"),
    "returns a force of space": (
        returned((jnp.zeros(3), 0.0)),
        r"load must return a force and a torque of shapes \(\(2,\), \(\)\), but returned \(\(3,\), \(\)\)",
    ),
    "returns two torques": (
        returned((jnp.zeros(2), jnp.zeros(2))),
        "load must return a force and a torque of",
    ),
    "returns text": (returned(("a", 0.0)), "load, in what it returns, must be a real number"),
}


@pytest.mark.parametrize(("call", "sentence"), REFUSED.values(), ids=REFUSED)
def test_wrong_loads_are_refused_in_one_sentence(call, sentence):
    with pytest.raises(ValueError, match=f"argument {sentence}"):
        call()


def test_changed_loads_are_looked_at_again():
    grasp, _ = disc(Drag(0.1))
    with pytest.raises(ValueError, match="argument load must have 2 numbers as force"):
        grasp.with_(load=Push((0, 0, 1), 0, 1))
    assert grasp.with_(load=None).load == () and len(grasp.with_(load=[Drag(1.0), Drag(2.0)]).load) == 2
    assert "Drag(linear=0.1 N s/m" in str(grasp)


# --- what is seen of loads


def test_wrenches_are_those_of_the_loads_and_are_drawn():
    """About the origin, along a made run; the arrow's line has the torque too. None without loads."""
    (grasp, state), run = runs.scene("pinch"), runs.run("pinch")
    push = Push((0.3, 0.1), 0.05, 0.2, point=(0.0, 0.02))
    acted = grasp.with_(load=[push, Drag(0.1), jxr.loads.Impulse((0.0, 0.0), 0.11)])
    force, torque = jxr.wrenches(acted, run.ts, run.states)
    for i, t in enumerate(np.asarray(run.ts)):
        pushed = push_of(t, (0.3, 0.1), 0.05, 0.2)
        arm = planar_rotation(float(run.states.q[i, 2])) @ np.array([0.0, 0.02])
        np.testing.assert_allclose(force[i], pushed - 0.1 * np.asarray(run.states.v[i, :2]), atol=1e-15)
        assert float(torque[i]) == pytest.approx(turned_left(arm) @ pushed, abs=1e-16)
    still = jxr.wrenches(grasp, 0.0, state)
    assert still[0].shape == (2,) and still[1].shape == () and not np.any(still[0])
    shafts = [a for a in jxr.plotting.poses(acted, run, times=[0.1], forces=True).axes[0].patches
              if type(a).__name__ == "FancyArrowPatch"]  # fmt: skip
    start, end = (np.array(p) for p in shafts[2]._posA_posB)
    arm = (start - 1e3 * np.asarray(run.states.q[2, :2])) / 1e3
    way = end - start
    np.testing.assert_allclose(way / np.linalg.norm(way), force[2] / np.linalg.norm(force[2]), atol=1e-12)
    assert arm[0] * force[2][1] - arm[1] * force[2][0] == pytest.approx(float(torque[2]), rel=1e-9)
    ball, on_floor = jxr.scenes.incline(slope=0.0)
    turned = ball.with_(load=lambda t, pose, twist: (jnp.array([1.0, 2.0, 3.0]), jnp.array([0.1, 0.2, 0.3])))
    both = jxr.wrenches(turned, 0.0, on_floor)
    np.testing.assert_allclose(np.concatenate(both), [1.0, 2.0, 3.0, 0.1, 0.2, 0.3], rtol=1e-15)


# --- payloads


def test_a_payload_adds_the_energy_of_a_body_on_its_link():
    """Kinetic p v^2/2 + I w^2/2 of the place where it is fixed, and its weight's potential."""
    gravity, p, at, inertia = np.array([0.3, -9.81]), 0.013, 0.05, 2e-6
    grasp, state = jxr.scenes.pivoted()
    grasp = grasp.with_(gravity=gravity)
    heavy = grasp.with_(fingers=grasp.fingers[0].with_payload(p, link=1, at=at, inertia=inertia))
    lengths = np.asarray(grasp.fingers[0].lengths)

    def place(q):
        turned = np.cumsum(q)
        along = np.stack([np.cos(turned), np.sin(turned)], axis=1)
        return lengths[0] * along[0] + at * along[1]

    moving = jxr.State(state.q, np.array([0.0, 1.3, -0.7]), state.s)
    q, v, h = np.asarray(state.q)[1:], np.asarray(moving.v)[1:], 1e-6
    speed = (place(q + h * v) - place(q - h * v)) / (2 * h)
    (k0, u0), (k1, u1) = jxr.energies(grasp, moving), jxr.energies(heavy, moving)
    assert float(k1 - k0) == pytest.approx(0.5 * p * speed @ speed + 0.5 * inertia * v.sum() ** 2, rel=1e-8)
    later = jxr.State(state.q + np.array([0.0, 0.2, 0.3]), moving.v, state.s)
    gained = float(jxr.energies(heavy, later)[1] - jxr.energies(grasp, later)[1]) - float(u1 - u0)
    assert gained == pytest.approx(-p * gravity @ (place(q + np.array([0.2, 0.3])) - place(q)), rel=1e-9)


def test_a_payload_in_space_is_a_point_of_its_link():
    grasp, state = runs.scene("pinch3d")
    p, at, own = 0.011, np.array([0.01, 0.03, -0.02]), np.diag([1e-6, 2e-6, 3e-6])
    heavy = grasp.with_(fingers=[grasp.fingers[0].with_payload(p, at=at, inertia=own), grasp.fingers[1]])
    v = np.zeros(12)
    v[6:9] = 0.5, -1.1, 0.7
    moving = jxr.State(state.q, v, state.s)
    finger = same_in_reference(grasp).fingers[0]
    q, h = np.asarray(state.q)[7:10], 1e-20
    placed = finger.place(q + 1j * h * v[6:9])
    point, turned = placed[0][2] + placed[1][2] @ at, placed[1][2]
    speed, rate = point.imag / h, turned.imag / h
    spin = rate @ turned.real.T
    w = turned.real.T @ np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
    gained = float(jxr.energies(heavy, moving)[0] - jxr.energies(grasp, moving)[0])
    assert gained == pytest.approx(0.5 * p * speed @ speed + 0.5 * w @ own @ w, rel=1e-10)


@pytest.mark.parametrize(
    "given",
    [{"mass": 0.0}, {"mass": 0.1, "link": 2}, {"mass": 0.1, "inertia": -1.0}, {"mass": 0.1, "at": (0, 1)}],
)
def test_payloads_that_there_are_not(given):
    with pytest.raises(ValueError, match=f"argument {list(given)[-1]}"):
        jxr.scenes.pivoted()[0].fingers[0].with_payload(**given)
