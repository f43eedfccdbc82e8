"""Bodies one by one: kinematics as derivatives of their pose, weight, defaults, names, refusals."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxroll as jxr
from jaxroll._linalg import Vec2, Vec3
from jaxroll._mechanics._entry import _guarded, compiled_for_many
from jaxroll._mechanics._stage import Turning

TIP, BALL = jxr.Circle(0.01), jxr.Sphere(0.01)
LINKS = [(0.0, 0.06, 0.01), (0.02, 0.05, 0.0)]
WEIGHT = {2: (0.3, -9.81), 3: (1.0, -2.0, -9.0)}


def finger3(**given):
    return jxr.Finger3(
        [(1, 2, 0), (0, 0, 1)],
        LINKS,
        [0.04, 0.03],
        BALL,
        base=(0.1, 0.2, 0.3),
        rotation=(1, 2, 3, 4),
        **given,
    )


def wavering(t):
    """A motion about no axis in particular."""
    return jnp.stack([0.1 * t, t * t, 0.3]), jnp.stack([1.0, 0.2 * t, jnp.sin(t), 0.4])


BODIES = {
    "finger": jxr.Finger([0.05, 0.07], [0.03, 0.02], TIP, base=(0.1, -0.2), centres=[0.01, 0.05]),
    "jaw": jxr.Jaw(TIP, 0.3, [0.2, 1.3], base=(0.1, 0.2), angle=0.4),
    "pivoted": jxr.PivotedObject(TIP, 1e-5, pivot=(0.1, 0.2), mass=0.04, centre=(0.01, -0.02)),
    "light": jxr.PivotedObject(TIP, 1e-5, pivot=(0.1, 0.2)),
    "free": jxr.FreeObject(TIP, 0.3, 2e-5),
    "finger in space": finger3(armature=[1e-6, 2e-6]),
    "free in space": jxr.FreeObject3(BALL, 0.3, [1e-5, 2e-5, 3e-5]),
    "stage": jxr.Stage(BALL, wavering, base=(0.1, 0.2, 0.3), rotation=(1, 2, 0, 3)),
}


def along(body, q, v):
    """The same body's origin, and its axes as columns, as a function of a time to move on at these rates."""
    rates = body.rates(q, v)

    def placed(s):
        pose = body.pose(tuple(a + s * b for a, b in zip(q, rates, strict=True)))
        if isinstance(pose.origin, Vec2):
            x, y = pose.turn(Vec2(1.0, 0.0)), pose.turn(Vec2(0.0, 1.0))
            return pose.origin.array(), jnp.stack([x.array(), y.array()], axis=1)
        return pose.origin.array(), jnp.stack([pose.x.array(), pose.y.array(), pose.z.array()], axis=1)

    return placed


@pytest.mark.parametrize("name", [name for name in BODIES if "finger" not in name])
def test_a_body_moves_as_its_pose_does_and_weighs_as_its_potential_says(name):
    body, rng = BODIES[name].prepared(), np.random.default_rng(2)
    q = tuple(map(jnp.asarray, rng.normal(size=body.positions)))
    if body.positions == 7:
        turn = np.array(q[3:]) / np.linalg.norm(q[3:])
        q = (*q[:3], *map(jnp.asarray, turn))
    v = tuple(map(jnp.asarray, rng.normal(size=body.freedoms)))
    plane = isinstance(body.pose(q).origin, Vec2)
    gravity = (Vec2 if plane else Vec3)(*map(jnp.asarray, WEIGHT[2 if plane else 3]))

    @jax.jit
    def found(q, v):
        motion, inertia = body.motion(q, v, gravity)
        still = tuple(0.0 * x for x in v)
        _, resting = body.motion(q, still, gravity)
        afloat = body.motion(q, still, None)[1].force
        spin, zero = body.placed(q)[1](v), jnp.zeros(())
        arrays = lambda x: x.array() if hasattr(x, "array") else jnp.asarray(x)  # noqa: E731
        twists = [
            (arrays(u.velocity), arrays(u.spin)) for u in (*motion.unit_twists, motion.twist, motion.bias)
        ]
        at = along(body, q, v)
        pose, rate = jax.jvp(at, (zero,), (zero + 1.0,))
        _, bend = jax.jvp(lambda s: jax.jvp(at, (s,), (zero + 1.0,))[1], (zero,), (zero + 1.0,))
        stored = lambda s: body.gravity_potential(  # noqa: E731
            tuple(a + s * b for a, b in zip(q, body.rates(q, v), strict=True)), gravity
        )
        slope = jax.grad(stored)(zero)
        return twists, arrays(spin), pose, rate, bend, slope, (resting.force, afloat), inertia.mass

    twists, spin, pose, rate, bend, slope, (force, afloat), mass = found(q, v)
    (*units, twist, bias), size = twists, 2 if plane else 3
    close = {"rtol": 1e-12, "atol": 1e-13}
    np.testing.assert_allclose(rate[0], twist[0], **close)
    np.testing.assert_allclose(rate[1], _turning(twist[1], pose[1]), **close)
    prescribed = getattr(body, "prescribed", False)
    if not prescribed:
        np.testing.assert_allclose(spin, twist[1], **close)
        for k in range(2):
            mixed = sum(np.asarray(u[k]) * x for u, x in zip(units, v, strict=True))
            np.testing.assert_allclose(mixed, twist[k], **close)
    else:
        assert not units and not np.any(spin)
    # The bias is the acceleration at constant velocities: of the origin, and of the spin.
    if name != "free in space":
        np.testing.assert_allclose(bend[0], bias[0], rtol=1e-11, atol=1e-12)
        turned = _turning(bias[1], pose[1]) + _turning(twist[1], _turning(twist[1], pose[1]))
        np.testing.assert_allclose(bend[1], turned, rtol=1e-11, atol=1e-12)
    assert not any(map(float, afloat))
    power = sum(float(f) * float(x) for f, x in zip(force, v, strict=True))
    np.testing.assert_allclose(slope, power, rtol=1e-11, atol=1e-15)
    rows = [len(row) for row in mass]
    assert rows == list(range(1, body.freedoms + 1)) and pose[1].shape == (size, size)


def _turning(spin, axes):
    """Rate of axes, as columns, that turn with a spin."""
    if np.ndim(spin) == 0:
        return float(spin) * np.array([[0.0, -1.0], [1.0, 0.0]]) @ axes
    return np.cross(np.asarray(spin), np.asarray(axes).T).T


def test_links_are_rods_in_the_plane_and_cylinders_in_space_unless_told_otherwise():
    rods = jxr.Finger([0.05, 0.07], [0.03, 0.02], TIP)
    np.testing.assert_allclose(rods.centres, [0.025, 0.035], rtol=1e-15)
    np.testing.assert_allclose(rods.inertias, [0.03 * 0.05**2 / 12.0, 0.02 * 0.07**2 / 12.0], rtol=1e-14)
    assert rods.base.tolist() == [0.0, 0.0] and float(rods.prepared().size) == pytest.approx(0.06, rel=1e-14)
    offsets = np.array([(0.0, 0.06, 0.03), (0.0, 0.0, 0.0), (0.02, 0.0, 0.0)])
    masses = np.array([0.04, 0.03, 0.02])
    cylinders = jxr.Finger3(np.eye(3), offsets, masses, BALL)
    np.testing.assert_allclose(cylinders.centres, 0.5 * offsets, rtol=1e-15)
    lengths = np.linalg.norm(offsets, axis=1)
    radius = 0.1 * lengths.mean()
    for offset, length, mass, tensor in zip(offsets, lengths, masses, cylinders.inertias, strict=True):
        e = offset / (length or 1.0)
        across = np.eye(3) - np.outer(e, e)
        # Of a cylinder, about its axis m r^2/2 and across it m (l^2/12 + r^2/4).
        wanted = mass * (length**2 / 12.0 + radius**2 / 4.0) * across + mass * radius**2 / 2.0 * np.outer(
            e, e
        )
        if not length:
            wanted = mass * radius**2 / 4.0 * np.eye(3)
        np.testing.assert_allclose(tensor, wanted, rtol=1e-13, atol=1e-20)
    np.testing.assert_allclose(jax.jit(lambda f: f.size)(cylinders), lengths.sum() / 3.0, rtol=1e-14)
    assert cylinders.turns and cylinders.joints == cylinders.freedoms == cylinders.positions == 3
    assert cylinders.rotation.tolist() == [1.0, 0.0, 0.0, 0.0] and cylinders.base.tolist() == [0.0, 0.0, 0.0]


def test_a_payload_is_one_body_with_its_link():
    """About their common centre, by Steiner's theorem in full."""
    rng = np.random.default_rng(4)
    finger, mass, at = finger3(), 0.07, rng.normal(size=3)
    own = 1e-5 * (lambda a: a @ a.T)(rng.normal(size=(3, 3)))
    heavy = finger.with_payload(mass, link=0, at=at, inertia=own)
    m, c = float(finger.masses[0]), np.array(finger.centres[0])
    centre = (m * c + mass * at) / (m + mass)
    steiner = lambda m, d: m * (d @ d * np.eye(3) - np.outer(d, d))  # noqa: E731
    tensor = np.array(finger.inertias[0]) + steiner(m, c - centre) + own + steiner(mass, at - centre)
    np.testing.assert_allclose(heavy.masses, [m + mass, 0.03], rtol=1e-15)
    np.testing.assert_allclose(heavy.centres, [centre, finger.centres[1]], rtol=1e-13)
    np.testing.assert_allclose(heavy.inertias, [tensor, finger.inertias[1]], rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(
        finger.with_payload(mass).centres[1],
        (0.03 * np.array(LINKS[1]) / 2 + mass * np.array(LINKS[1])) / 0.1,
        rtol=1e-13,
    )
    plane = BODIES["finger"].with_payload(0.02, link=0, at=0.04, inertia=3e-6)
    np.testing.assert_allclose(plane.masses, [0.05, 0.02], rtol=1e-15)
    np.testing.assert_allclose(plane.centres, [0.022, 0.05], rtol=1e-14)
    rod = 0.03 * 0.05**2 / 12.0
    np.testing.assert_allclose(plane.inertias[0], rod + 3e-6 + 0.03 * 0.012**2 + 0.02 * 0.018**2, rtol=1e-13)
    last = BODIES["finger"].with_payload(0.02)
    np.testing.assert_allclose(last.centres, [0.01, 0.06], rtol=1e-14)
    for bad in ({"link": 2}, {"link": -1}, {"mass": 0.0}, {"inertia": -1e-9}):
        with pytest.raises(ValueError, match=f"argument {next(iter(bad))} must"):
            BODIES["finger"].with_payload(**({"mass": 0.02} | bad))


def test_names_and_units_of_coordinates():
    told = lambda labels: [(each.name, each.unit) for each in labels]  # noqa: E731
    free = BODIES["free in space"]
    assert told(free.labels) == [*((x, "m") for x in "xyz"), *((x, "") for x in ("qw", "qx", "qy", "qz"))]
    spins = [(f"spin {x}", "rad/s") for x in "xyz"]
    assert told(free.velocity_labels) == [*((x, "m/s") for x in "xyz"), *spins]
    assert told(BODIES["free"].velocity_labels) == [("x", "m/s"), ("y", "m/s"), ("theta", "rad/s")]
    assert told(BODIES["pivoted"].labels) == [("theta", "rad")]
    assert told(BODIES["finger"].labels) == [("q[0]", "rad"), ("q[1]", "rad")]
    assert told(BODIES["finger in space"].velocity_labels) == [("q[0]", "rad/s"), ("q[1]", "rad/s")]
    assert told(BODIES["jaw"].labels) == [("q[0]", "m"), ("q[1]", "m")]
    assert told(BODIES["stage"].labels) == [("clock", "s")] and told(BODIES["stage"].velocity_labels) == []
    table = jxr.Stage(BALL)
    assert told(table.labels) == [] and (table.positions, table.freedoms, table.joints) == (0, 0, 0)
    assert not table.prescribed and BODIES["stage"].prescribed and not table.turns


def test_what_has_no_length_of_its_own_is_as_large_as_a_gripper():
    assert float(jxr.Stage(BALL).size) == float(BODIES["jaw"].size) == 0.05
    assert jxr.Jaw(TIP).mass == 1.0 and jxr.Jaw(TIP).joints == 0 and float(jxr.Jaw(TIP).angle) == 0.0
    (point,) = jxr.Stage(BALL, base=(0.1, 0.2, 0.3)).skeleton(())
    assert point.array().tolist() == [0.1, 0.2, 0.3]
    (point,) = BODIES["jaw"].skeleton((0.0, 0.0))
    assert point.array().tolist() == [0.1, 0.2]
    np.testing.assert_allclose(float(jxr.Stage(BALL).gravity_potential((), Vec3(1.0, 2.0, 3.0))), 0.0)


def test_joints_and_the_tip_are_the_skeleton():
    q = (0.3, -1.1)
    first = np.array([0.1, -0.2]) + 0.05 * np.array([np.cos(0.3), np.sin(0.3)])
    tip = first + 0.07 * np.array([np.cos(-0.8), np.sin(-0.8)])
    found = [p.array() for p in BODIES["finger"].prepared().skeleton(q)]
    np.testing.assert_allclose(found, [(0.1, -0.2), first, tip], rtol=1e-14)


def test_a_stage_moves_relative_to_its_base_and_a_fixed_one_rests():
    """Its frame is that of the motion, turned and moved as the base is."""
    stage, t, arm = BODIES["stage"], 0.7, np.array([0.3, -0.2, 0.5])
    of = lambda quaternion: Rotation.from_quat(np.array(quaternion)[[1, 2, 3, 0]])  # noqa: E731
    point, own = wavering(t)
    wanted = np.array([0.1, 0.2, 0.3]) + of([1, 2, 0, 3]).apply(np.array(point) + of(own).apply(arm))
    found = jax.jit(lambda t: stage.pose((t,)).place(Vec3(*map(jnp.asarray, arm))).array())(t)
    np.testing.assert_allclose(found, wanted, rtol=1e-13)
    fixed = jxr.Stage(BALL, base=(0.1, 0.2, 0.3), rotation=(1, 2, 0, 3))
    motion, inertia = fixed.motion((), (), None)
    wanted = np.array([0.1, 0.2, 0.3]) + of([1, 2, 0, 3]).apply(arm)
    np.testing.assert_allclose(motion.pose.place(Vec3(*map(jnp.asarray, arm))).array(), wanted, rtol=1e-13)
    for twist in (motion.twist, motion.bias):
        assert [*twist.velocity.array(), *twist.spin.array()] == 6 * [0.0]
    assert (inertia.mass, inertia.force, motion.unit_twists) == ((), (), ())
    assert float(jax.jit(lambda t: fixed.placed(())[1](()).array().sum() + t)(0.0)) == 0.0


def test_steady_rotation_keeps_its_axis_in_place():
    turn = Turning(2.0, axis=(0.0, 3.0, 4.0), centre=(0.1, 0.2, 0.3))
    for t in (0.0, 0.7):
        origin, quaternion = turn(jnp.asarray(t))
        wanted = [np.cos(t), 0.0, 0.6 * np.sin(t), 0.8 * np.sin(t)]
        np.testing.assert_allclose(quaternion, wanted, atol=1e-15)
    stage = jxr.Stage(BALL, turn)
    pose = stage.pose((jnp.asarray(0.7),))
    for along_axis in (0.0, 2.0):
        kept = np.array([0.1, 0.2, 0.3]) + along_axis * np.array([0.0, 0.6, 0.8])
        np.testing.assert_allclose(pose.place(Vec3(*map(jnp.asarray, kept))).array(), kept, rtol=1e-13)
    plain = Turning(2.0)
    np.testing.assert_allclose(plain(jnp.asarray(0.7))[1], [np.cos(0.7), 0.0, 0.0, np.sin(0.7)], rtol=1e-14)


REFUSED = {
    "two axes in line": (
        lambda: jxr.Jaw(TIP, 1.0, [0.3, 0.3 + 0.9e-6]),
        "argument directions must not be parallel",
    ),
    "two axes against each other": (
        lambda: jxr.Jaw(TIP, 1.0, [0.3, 0.3 - math.pi + 0.9e-6]),
        "argument directions must not be parallel",
    ),
    "three axes": (
        lambda: jxr.Jaw(TIP, 1.0, [0.1, 0.2, 0.3]),
        "argument directions must be at most 2 angles, but were 3",
    ),
    "limits that are one": (lambda: finger3(limits=[(0, 1), (1, 1)]), "argument limits must rise"),
    "a rotor's inertia": (lambda: finger3(armature=[1e-6, -1e-9]), "argument armature must not be negative"),
    "an axis of no length": (
        lambda: jxr.Finger3([(0, 0, 0)], LINKS[:1], [1.0], BALL),
        "argument axes must not be zero",
    ),
    "no links": (
        lambda: jxr.Finger([], [], TIP),
        "argument lengths must hold one link or more, but had none",
    ),
    "crooked inertia": (
        lambda: jxr.FreeObject3(BALL, 1.0, np.diag([1.0, 2.0, 3.0]) + 3.3e-9 * np.eye(3, k=1)),
        "argument inertia must be symmetric and positive definite",
    ),
    "inertia below zero": (
        lambda: jxr.FreeObject3(BALL, 1.0, [1.0, 1.0, -1e-9]),
        "argument inertia must be symmetric",
    ),
    "flat inertia": (
        lambda: jxr.FreeObject3(BALL, 1.0, [1.0, 1.0, 0.0]),
        "argument inertia must be symmetric",
    ),
    "a tip of space": (lambda: jxr.Finger([1.0], [1.0], BALL), "argument tip must be a contour"),
    "a tip of the plane": (lambda: jxr.Stage(TIP), "argument surface must be a surface"),
    "one part of a motion": (
        lambda: jxr.Stage(BALL, lambda t: (t, t, t)),
        "argument motion must return a position",
    ),
    "too many coordinates": (
        lambda: jxr.Stage(BALL, lambda t: ((t, t, t, t), (t, t, t, t))),
        "argument motion must return 3 coordinates and 4 of a quaternion",
    ),
    "a table of coordinates": (
        lambda: jxr.Stage(BALL, lambda t: (jnp.zeros((3, 1)), (t, t, t, t))),
        "argument motion must return 3 coordinates and 4 of a quaternion",
    ),
    "vectors as coordinates": (
        lambda: jxr.Stage(BALL, lambda t: ([jnp.zeros(2)] * 3, (t, t, t, t))),
        "argument motion must return 3 coordinates and 4 of a quaternion",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bodies_that_there_are_not(name):
    make, sentence = REFUSED[name]
    with pytest.raises(ValueError) as refused:
        make()
    assert str(refused.value).startswith(sentence)


def test_bodies_near_what_is_refused():
    assert jxr.Jaw(TIP, 1.0, [0.3, 0.3 + 1.1e-6]).joints == 2
    jxr.FreeObject3(BALL, 1.0, np.diag([1.0, 2.0, 3.0]) + 2.7e-9 * np.eye(3, k=1))
    finger3(limits=[(0.0, 1.0), (1.0, 1.0 + 1e-9)], armature=[0.0, 1e-6])
    np.testing.assert_array_equal(jxr.FreeObject3(BALL, 1.0, 2.0).inertia, 2.0 * np.eye(3))
    np.testing.assert_array_equal(
        jxr.FreeObject3(BALL, 1.0, [1.0, 2.0, 3.0]).inertia, np.diag([1.0, 2.0, 3.0])
    )
    given = jxr.Stage(BALL, lambda t: ([t, 2.0, jnp.ones(())], (1.0, 0.0, 0.0, t)))
    assert given.prescribed


def test_turned_inertia_is_symmetric_to_rounding_in_single_precision():
    """Of an ellipsoid, m/5 (b^2 + c^2) along its own axes, which are turned by SciPy's matrix."""
    axes, turn = np.array([0.02, 0.03, 0.025]), np.array([1.0, 0.2, 0.3, 0.4], np.float32)
    matrix = Rotation.from_quat(turn[[1, 2, 3, 0]]).as_matrix()
    mass = 4.0 / 3.0 * np.pi * 1000.0 * axes.prod()
    expected = matrix @ np.diag(0.2 * mass * ((axes**2).sum() - axes**2)) @ matrix.T
    given = matrix.astype(np.float32) @ np.float32(np.diag(np.diag(matrix.T @ expected @ matrix)))
    given = given @ matrix.T.astype(np.float32)
    assert abs(given - given.T).max() > 1e-9 * abs(given).max()
    body = jxr.FreeObject3(BALL, np.float32(mass), given)
    np.testing.assert_allclose(body.inertia, expected, rtol=1e-4, atol=1e-10)
    surface = jxr.Ellipsoid(*np.float32(axes)).moved(np.zeros(3, np.float32), turn)
    uniform = jxr.FreeObject3.uniform(surface, np.float32(1000.0))
    assert uniform.inertia.dtype == np.float32
    np.testing.assert_allclose(uniform.inertia, expected, rtol=1e-4, atol=1e-10)


def test_what_functions_of_a_grasp_look_at_before_they_are_compiled(scene):
    grasp, state = scene

    def asked(grasp, state, ts, other=0.0):
        return None

    door = _guarded(asked, lambda grasp, *args, **options: (args, options))
    (first, ts), named = door(grasp, state, [0, 1], other=math.nan)
    assert first is state and ts.tolist() == [0.0, 1.0] and ts.dtype == float and math.isnan(named["other"])
    assert door(grasp, state=state, ts=2)[1]["ts"] == 2.0
    assert door(grasp, state, 1.0, 2.0, "more")[0][-1] == "more"  # whose refusal is the compiled function's
    unfit = jxr.State(state.q[:2], state.v, state.s)
    unset = jxr.State(state.q, state.v.at[0].set(jnp.nan), state.s)
    many = jax.tree.map(lambda x: x[None], state)
    for bad, told in (
        (unfit, "state.q must have shape"),
        (unset, "state.v must be finite"),
        (3, "state must be a State"),
    ):
        for call in (lambda bad=bad: door(grasp, bad, 0.0), lambda bad=bad: door(grasp, ts=0.0, state=bad)):
            with pytest.raises(ValueError, match=f"argument {told}"):
                call()
    with pytest.raises(ValueError, match="argument state.q must have shape"):
        door(grasp, many, 0.0)
    for call in (lambda: door(grasp, state, math.inf), lambda: door(grasp, state, ts=[0.0, math.nan])):
        with pytest.raises(ValueError, match="argument ts must be finite"):
            call()
    with pytest.raises(ValueError, match="argument grasp must be a Grasp, but was 3"):
        door(3, state, 0.0)

    def several(grasp, states):
        return states.q

    rows = compiled_for_many(several)(grasp, jax.tree.map(lambda x: jnp.stack([x, jnp.nan * x]), state))
    np.testing.assert_array_equal(rows[0], state.q)
