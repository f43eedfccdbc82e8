"""Control laws by themselves, from what is sensed: integral terms, samples, and what they refuse."""

import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial
from scipy.spatial.transform import Rotation

import jaxroll as jxr
from jaxroll._linalg import Twist2, Twist3, Vec2, Vec3
from jaxroll.control import Integral, Opposition, Press, Sampled
from jaxroll.control._carry import _turned
from jaxroll.control._sensing import Sensed, tip_of
from jaxroll.loads import as_load, Drag, Impulse, Push, Spring, total_wrench
from tests.subjects.driven_plate import driven_plate

EPS = np.finfo(float).eps
RNG = np.random.default_rng(11)


class Law(jxr.control.AbstractController):
    """A law with two numbers of memory, whose torques say what it was given."""

    def torques(self, t, fingers):
        return tuple(tuple(10.0 * i + j + t for j, _ in enumerate(f.angles)) for i, f in enumerate(fingers))

    def driven(self, t, fingers, memory):
        return self.torques(t + sum(memory), fingers), tuple(7.0 + m for m in memory or (1.0, 2.0))

    def potential(self, tips, angles):
        return 3.5

    def initial_memory(self, joints):
        return jnp.array([0.25, float(sum(joints))])

    def check(self, fingers, axes):
        if (fingers, axes) == (3, 3):
            raise ValueError("argument law must be for others")

    def check_freedoms(self, free):
        if free < 1:
            raise ValueError("argument law must have some")


def sensed(*joints, space=False):
    """Fingers with so many joints, everything of theirs drawn at random."""
    size, vec, twist = (3, Vec3, Twist3) if space else (2, Vec2, Twist2)
    draw = lambda: vec(*map(jnp.asarray, RNG.normal(size=size)))  # noqa: E731
    units = lambda k: tuple(twist(draw(), draw() if space else 1.0) for _ in range(k))  # noqa: E731
    return [Sensed(tuple(RNG.normal(size=k)), tuple(RNG.normal(size=k)), draw(), units(k)) for k in joints]


def moved(fingers, i, j, size):
    """The fingers after a small turn of one joint."""
    f = fingers[i]
    angles = tuple(a + size * (k == j) for k, a in enumerate(f.angles))
    new = Sensed(angles, f.rates, f.tip + f.unit_twists[j].velocity * size, f.unit_twists)
    return [new if k == i else each for k, each in enumerate(fingers)]


TASKS = {
    "x": lambda fs: np.mean([f.tip.x for f in fs]),
    "y": lambda fs: np.mean([f.tip.y for f in fs]),
    "z": lambda fs: np.mean([f.tip.z for f in fs]),
    "opening": lambda fs: np.linalg.norm((fs[1].tip - fs[0].tip).array()),
    "tilt": lambda fs: np.arctan2(*reversed((fs[1].tip - fs[0].tip).array())),
    "orientation_0": lambda fs: sum(fs[0].angles),
    "orientation_2": lambda fs: sum(fs[2].angles),
}


@pytest.mark.parametrize("space", [False, True])
def test_task_errors_and_their_slopes_for_three_fingers(space):
    names = [name for name in TASKS if name != ("tilt" if space else "z")]
    targets = dict(zip(names, (0.3, -0.2, 0.1, 0.7, 1.1, -0.4), strict=True))
    law, fingers, size = Integral(None, targets, 1.0), sensed(2, 1, 3, space=space), 1e-6
    for name, (value, slopes) in zip(names, law.measured(fingers), strict=True):
        np.testing.assert_allclose(value, TASKS[name](fingers) - targets[name], rtol=1e-12)
        assert [len(block) for block in slopes] == [2, 1, 3]
        for i, block in enumerate(slopes):
            for j, slope in enumerate(block):
                ahead, behind = (TASKS[name](moved(fingers, i, j, way * size)) for way in (1, -1))
                np.testing.assert_allclose(slope, (ahead - behind) / (2 * size), rtol=0, atol=2e-8)


def test_integral_terms_stand_beside_the_law_and_its_memory():
    fingers = sensed(2, 1)
    law = Integral(Law(), {"x": 0.3, "orientation_1": 0.1}, [5.0, 7.0])
    (ex, sx), (eo, so) = law.measured(fingers)
    assert law.initial_memory((2, 1)).tolist() == [0.25, 3.0, 0.0, 0.0]
    assert Integral(None, {"x": 0.3}, 1.0).initial_memory((2, 1)).tolist() == [0.0]
    assert law.potential((), ()) == 3.5
    flat = lambda us: [float(u) for block in us for u in block]  # noqa: E731
    np.testing.assert_allclose(flat(law.torques(0.5, fingers)), [0.5, 1.5, 10.5])
    # Without a memory that of the beginning: no integral yet.
    torques, rates = law.driven(0.5, fingers, ())
    np.testing.assert_allclose(flat(torques), [0.5, 1.5, 10.5])
    np.testing.assert_allclose(rates, [8.0, 9.0, ex, eo], rtol=1e-14)
    memory = (2.0, 3.0, -0.4, 0.6)
    torques, rates = law.driven(0.5, fingers, memory)
    drawn = np.array(flat(sx)) * 5.0 * -0.4 + np.array(flat(so)) * 7.0 * 0.6
    np.testing.assert_allclose(flat(torques), np.array([5.5, 6.5, 15.5]) - drawn, rtol=1e-13)
    np.testing.assert_allclose(rates, [9.0, 10.0, ex, eo], rtol=1e-14)
    torques, later = law.stepped(0.5, fingers, memory, 0.125)
    np.testing.assert_allclose(flat(torques), np.array([5.5, 6.5, 15.5]) - drawn, rtol=1e-13)
    wanted = [2.0 + 0.125 * 9.0, 3.0 + 0.125 * 10.0, -0.4 + 0.125 * ex, 0.6 + 0.125 * eo]
    np.testing.assert_allclose(later, wanted, rtol=1e-14)


REFUSED_TASKS = [
    ("opening", 1, 2, "argument targets must name what 1 finger can have, but had 'opening'"),
    ("tilt", 1, 2, "argument targets must name what 1 finger can have, but had 'tilt'"),
    ("orientation_2", 2, 2, "argument targets must name what 2 fingers can have, but had 'orientation_2'"),
    ("orientation_0", 0, 2, "argument targets must name what 0 fingers can have, but had 'orientation_0'"),
    ("z", 2, 2, "argument targets must name errors of a grasp of 2 axes, but had 'z'"),
    ("tilt", 2, 3, "argument targets must name errors of a grasp of 3 axes, but had 'tilt'"),
]


@pytest.mark.parametrize(("name", "fingers", "axes", "sentence"), REFUSED_TASKS)
def test_task_errors_that_a_grasp_cannot_have(name, fingers, axes, sentence):
    with pytest.raises(ValueError) as refused:
        Integral(None, {name: 0.1}, 1.0).check(fingers, axes)
    assert str(refused.value) == sentence


def test_task_errors_that_a_grasp_can_have():
    for name, fingers, axes in (("opening", 2, 3), ("tilt", 2, 2), ("z", 1, 3), ("orientation_1", 2, 2)):
        Integral(None, {name: 0.1}, 1.0).check(fingers, axes)
    both = Integral(Law(), {"x": 0.1, "y": 0.2}, 1.0)
    with pytest.raises(ValueError, match="argument law must be for others"):
        both.check(3, 3)
    both.check_freedoms(3)
    with pytest.raises(ValueError, match="argument law must have some"):
        both.check_freedoms(2)
    alone = Integral(None, {"x": 0.1, "y": 0.2}, 1.0)
    alone.check_freedoms(2)
    with pytest.raises(ValueError, match="argument targets must name at most 1 errors, as contacts leave"):
        alone.check_freedoms(1)


@pytest.mark.parametrize(
    "targets", [["x"], {"xx": 1.0}, {1: 1.0}, {"orientation_": 1.0}, {"orientation_a": 1.0}]
)
def test_names_of_task_errors_that_there_are_not(targets):
    with pytest.raises(ValueError, match=r"argument targets must (be a dict|have names among)"):
        Integral(None, targets, 1.0)


def test_samples_hold_torques_between_their_times():
    law, fingers = Sampled(Law(), 0.25, first=0.5), sensed(2, 1)
    flat = lambda us: [float(u) for block in us for u in block]  # noqa: E731
    assert law.initial_memory((2, 1)).tolist() == [0.25, 3.0, 0.0, 0.0, 0.0, 0.5]
    assert Sampled(None, 0.25).initial_memory((2, 1)).tolist() == [0.0, 0.0, 0.0, 0.0]
    memory = (0.1, 0.2, 4.0, 5.0, 6.0, 0.75)
    assert law.held(memory, (2, 1)) == ((4.0, 5.0), (6.0,))
    torques, rates = law.driven(0.6, fingers, memory)
    assert torques == ((4.0, 5.0), (6.0,)) and [float(x) for x in rates] == 6 * [0.0]
    torques, rates = law.driven(0.6, fingers, ())
    np.testing.assert_allclose(flat(torques), [0.6, 1.6, 10.6])
    assert rates == ()
    for t, due in ((0.75, True), (0.75 - 7.9 * EPS * 0.75, True), (0.75 - 17 * EPS, False), (0.9, True)):
        assert bool(law.due(jnp.asarray(t), memory)) is due
    for t, number in ((0.5, 0), (0.75, 1), (0.75 - 4 * EPS, 1), (0.74, 0), (1.3, 3)):
        assert float(law.number(jnp.asarray(t))) == number
    after = law.sample(0.75, fingers, memory, jnp.asarray(1.0))
    asked = 0.75 + 0.1 + 0.2
    later = [0.1 + 0.25 * 7.1, 0.2 + 0.25 * 7.2]
    np.testing.assert_allclose(after, [*later, asked, 1 + asked, 10 + asked, 1.0], rtol=1e-14)
    assert float(law.potential([Vec2(jnp.asarray(1.0), 2.0)], ())) == 0.0
    law.check_freedoms(1)
    for check in (lambda: law.check(3, 3), lambda: law.check_freedoms(0)):
        with pytest.raises(ValueError, match="argument law"):
            check()


def test_noise_is_drawn_for_angles_then_for_rates_with_the_key_of_the_sample():
    key = jax.random.key(5)
    law = Sampled(None, 0.25, angle_noise=0.5, rate_noise=2.0, key=key)
    assert law.noisy and not Sampled(None, 0.25, key=key).noisy
    drawn = np.array(jax.random.normal(jax.random.fold_in(key, 3), (6,), float))
    angles, rates = law.noise(jnp.asarray(3.0), 3)
    np.testing.assert_allclose(angles, 0.5 * drawn[:3], rtol=1e-15)
    np.testing.assert_allclose(rates, 2.0 * drawn[3:], rtol=1e-15)
    angles, rates = Sampled(None, 0.25, rate_noise=2.0, key=key).noise(jnp.asarray(3.0), 3)
    np.testing.assert_array_equal(angles, np.zeros(3))
    np.testing.assert_allclose(rates, 2.0 * drawn[3:], rtol=1e-15)
    for noise in ({"angle_noise": 0.0}, {"rate_noise": 0.0}):
        with pytest.raises(ValueError, match="argument key must be a key of jax.random where there is noise"):
            Sampled(None, 0.25, **noise).check(1, 2)
    Sampled(None, 0.25).check(1, 2)
    old = jax.random.PRNGKey(5)
    np.testing.assert_array_equal(Sampled(None, 0.25, key=old).key, law.key)
    for bad in (jnp.stack([old, old]), old.astype(int), 3, jax.random.split(key, 2)):
        with pytest.raises(ValueError, match="argument key must be one key of jax.random"):
            Sampled(None, 0.25, key=bad)
    # Of another kind the numbers would be read as a key of this one, or be too many.
    other = jax.random.key(5, impl="rbg")
    for bad in (other, jax.random.key_data(other)):
        with pytest.raises(ValueError, match="key of jax.random of the kind .* threefry2x32, but was"):
            Sampled(None, 0.25, key=bad)


@pytest.mark.parametrize("angle", [0.0, 0.5e-4, 0.99e-4, 1.01e-4, 2e-4, 1.3, 3.0])
def test_turns_are_those_of_scipy_however_small(angle):
    axis, vector = np.array([0.48, 0.6, -0.64]), np.array([0.7, -1.1, 0.4])
    found = _turned(Vec3(*map(jnp.asarray, vector)), Vec3(*map(jnp.asarray, angle * axis))).array()
    wanted = Rotation.from_rotvec(angle * axis).apply(vector)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-15)


def test_opposition_and_press_are_what_the_chapter_says():
    """(16), (17) and (75) in plain NumPy, for three fingers with numbers of their own."""
    fingers = sensed(2, 1, 3)
    tips = np.array([f.tip.array() for f in fingers])
    jacobians = [np.array([u.velocity.array() for u in f.unit_twists]) for f in fingers]
    damping, alpha, start = np.array([0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6]), np.array([0.7, -0.8, 0.9])
    law = Opposition(3.0, damping, alpha=alpha, start=start)
    press = Press(0.5, 0.04, 0.3, target=(0.2, -0.1))
    found = law.torques(0.0, fingers), press.torques(0.0, fingers)
    for i, f in enumerate(fingers):
        rates, turn = np.array(f.rates), sum(f.angles) - start[i]
        pull = 3.0 * (3 * tips[i] - tips.sum(axis=0))
        wanted = -damping[i] * rates - jacobians[i] @ pull - alpha[i] * turn
        np.testing.assert_allclose(np.array(found[0][i]), wanted, rtol=1e-12)
        wanted = -0.3 * rates - 0.5 / 0.04 * jacobians[i] @ (tips[i] - [0.2, -0.1])
        np.testing.assert_allclose(np.array(found[1][i]), wanted, rtol=1e-12)
    points, angles = [f.tip for f in fingers], [f.angles for f in fingers]
    turned = sum(a * (sum(q) - s) ** 2 for a, q, s in zip(alpha, angles, start, strict=True))
    pairs = sum(np.sum((tips[i] - tips[j]) ** 2) for i in range(3) for j in range(i))
    np.testing.assert_allclose(law.potential(points, angles), 1.5 * pairs + 0.5 * turned, rtol=1e-13)
    stored = 0.5 * 0.5 / 0.04 * np.sum((tips - [0.2, -0.1]) ** 2)
    np.testing.assert_allclose(press.potential(points, angles), stored, rtol=1e-13)
    for fingers_, axes in ((2, 2), (4, 2)):
        with pytest.raises(ValueError, match="argument start must have one angle for each of two fingers"):
            law.check(fingers_, axes)
    law.check(3, 2)
    press.check(1, 2)
    with pytest.raises(ValueError, match=r"argument target must have shape \(3\), as the grasp's points"):
        press.check(1, 3)
    for name in ("force", "radius"):
        numbers = {"force": 0.5, "radius": 0.04, "damping": 0.3} | {name: lambda t: 1.0 + t}
        moving = Press(**numbers, target=(0.2, -0.1))
        with pytest.raises(ValueError, match="argument controller must have numbers as force and radius"):
            _ = moving.stiffness
        assert float(moving.potential(points, angles)) == 0.0
        at = numbers | {name: 3.0}
        np.testing.assert_allclose(moving.at(2.0).stiffness, at["force"] / at["radius"])


def test_what_the_tip_of_a_finger_without_joints_is():
    plane, space = sensed(0), sensed(0, space=True)
    assert tip_of(plane[0]).jacobian.shape == (2, 0) and tip_of(space[0]).jacobian.shape == (3, 0)
    (finger,) = sensed(2, space=True)
    columns = [u.velocity.array() for u in finger.unit_twists]
    np.testing.assert_array_equal(tip_of(finger).jacobian, np.stack(columns, axis=1))


class Turned:
    """A pose in the plane."""

    def __init__(self, origin, angle):
        self.origin, self.way = Vec2(*map(jnp.asarray, origin)), (np.cos(angle), np.sin(angle))

    def turn(self, vector):
        c, s = self.way
        return Vec2(c * vector.x - s * vector.y, s * vector.x + c * vector.y)


def test_loads_are_their_formulas_on_an_object_that_moves():
    angle, at, velocity, spin = 0.6, np.array([0.3, -0.2]), np.array([0.5, 1.1]), -1.7
    pose, twist = Turned(at, angle), Twist2(Vec2(*map(jnp.asarray, velocity)), jnp.asarray(spin))
    body = types.SimpleNamespace(pose=pose, twist=twist)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    point, force = np.array([0.04, 0.07]), np.array([2.0, -3.0])
    arm = turn @ point
    about = lambda f: arm[0] * f[1] - arm[1] * f[0]  # noqa: E731
    push = Push(force, 0.5, 0.4, point=point)
    for t, share in (
        (0.4, 0.0),
        (0.5, 0.0),
        (0.6, np.sin(np.pi * 0.25) ** 2),
        (0.7, 1.0),
        (0.9, 0.0),
        (1.1, 0.0),
    ):
        found, torque = push.wrench(t, body)
        np.testing.assert_allclose(found.array(), share * force, atol=1e-14)
        np.testing.assert_allclose(torque, share * about(force), atol=1e-14)
    np.testing.assert_allclose(push.jumps, [0.5, 0.9], rtol=1e-15)
    assert Push(force, 0.5, 0.4).wrench(0.6, body)[1] is None
    found, torque = Drag(0.3, 0.05).wrench(0.0, body)
    np.testing.assert_allclose(found.array(), -0.3 * velocity, rtol=1e-15)
    np.testing.assert_allclose(torque, 0.05 * 1.7, rtol=1e-15)
    assert float(Drag(0.3).wrench(0.0, body)[1]) == 0.0
    anchor, rate = np.array([-0.1, 0.25]), velocity + spin * np.array([-arm[1], arm[0]])
    long = at + arm - anchor
    for length in (None, 0.2):
        spring = Spring(11.0, anchor, point=point, length=length, damping=0.7)
        wanted = -11.0 * (1.0 - (length or 0.0) / np.linalg.norm(long)) * long - 0.7 * rate
        found, torque = spring.wrench(0.0, body)
        np.testing.assert_allclose(found.array(), wanted, rtol=1e-14)
        np.testing.assert_allclose(torque, about(wanted), rtol=1e-14)
    bare, none = Spring(11.0, anchor).wrench(0.0, body)
    np.testing.assert_allclose(bare.array(), -11.0 * (at - anchor), rtol=1e-14)
    assert none is None
    blow = Impulse(force, 0.8, angular=0.9, point=point)
    hit, twisted = blow.impulse(body)
    np.testing.assert_allclose(hit.array(), force)
    np.testing.assert_allclose(twisted, 0.9 + about(force), rtol=1e-14)
    assert blow.jumps.tolist() == [0.8]
    assert float(Impulse(force, 0.8, angular=0.9).impulse(body)[1]) == 0.9
    assert Impulse(force, 0.8).impulse(body)[1] is None
    np.testing.assert_array_equal(blow.wrench(0.8, body)[0].array(), [0.0, 0.0])
    # Those that act all along add up; a blow is none of these.
    all_forces, torques = total_wrench([push, blow, Spring(11.0, anchor)], 0.7, body)
    np.testing.assert_allclose(all_forces.array(), force - 11.0 * (at - anchor), rtol=1e-14)
    np.testing.assert_allclose(torques, about(force), rtol=1e-14)
    assert total_wrench([Spring(11.0, anchor)], 0.7, body)[1] is None
    assert total_wrench([blow], 0.7, body) is None and total_wrench([], 0.7, body) is None


def test_loads_refuse_points_of_another_space():
    told = "argument load must have 3 numbers as {}, as the grasp's points have, but had 2"
    for load, field in ((Push((1.0, 0.0), 0.0, 1.0), "force"), (Spring(1.0, (0.0, 0.0)), "anchor")):
        load.check("load", 2)
        with pytest.raises(ValueError) as refused:
            load.check("load", 3)
        assert str(refused.value) == told.format(field)
    with pytest.raises(ValueError, match="had 2"):
        Impulse((1.0, 0.0), 0.0).check("load", 3)
    for bad in (lambda: Push((1.0,), 0.0, 1.0), lambda: Push((1.0, 0.0, 0.0, 0.0), 0.0, 1.0)):
        with pytest.raises(ValueError, match=r"must have shape \(2\) or \(3\)"):
            bad()
    with pytest.raises(ValueError, match=r"argument point must have shape \(2,\), but had shape \(3,\)"):
        Push((1.0, 0.0), 0.0, 1.0, point=(0.0, 0.0, 0.0))
    for impulse, angular, shape in (((1.0, 0.0), (1.0,), r"\(\)"), ((1.0, 0.0, 0.0), 1.0, r"\(3,\)")):
        with pytest.raises(ValueError, match=f"argument angular must have shape {shape}, but"):
            Impulse(impulse, 0.0, angular=angular)
    Impulse((1.0, 0.0, 0.0), 0.0, angular=(0.0, 0.0, 1.0))


def acted_on(space):
    """An object that moves, as a load sees it."""
    size = 3 if space else 2
    vec, number = (Vec3 if space else Vec2), jnp.asarray
    draw = lambda k: tuple(map(number, RNG.normal(size=k)))  # noqa: E731
    spin = vec(*draw(3)) if space else draw(1)[0]
    twist = (Twist3 if space else Twist2)(vec(*draw(size)), spin)
    pose = types.SimpleNamespace(origin=vec(*draw(size)))
    return types.SimpleNamespace(pose=pose, orientation=draw(4 if space else 1), twist=twist)


@pytest.mark.parametrize("space", [False, True])
def test_a_load_of_ones_own_is_given_place_and_motion_and_its_answer_is_looked_at(space):
    body, seen = acted_on(space), []
    plain = lambda x: np.asarray(x.array() if hasattr(x, "array") else x)  # noqa: E731

    def load(t, pose, twist):
        seen.append((t, pose, twist))
        return 2.0 * twist.velocity + pose.position, 3.0 * twist.spin

    force, torque = as_load(load).wrench(0.7, body)
    velocity, spin, origin = map(plain, (body.twist.velocity, body.twist.spin, body.pose.origin))
    np.testing.assert_allclose(plain(force), 2.0 * velocity + origin, rtol=1e-14)
    np.testing.assert_allclose(plain(torque), 3.0 * spin, rtol=1e-14)
    t, pose, _ = seen[0]
    assert float(t) == 0.7 and pose.orientation.shape == ((4,) if space else ())
    wanted = body.orientation if space else body.orientation[0]
    np.testing.assert_array_equal(
        np.asarray(as_load(load_of_orientation).wrench(0.7, body)[0].array())[0],
        np.ravel(np.asarray(wanted))[0],
    )
    shape = (3,) if space else (2,)
    for bad, told in (
        (lambda t, p, w: w.velocity, "a force and a torque, but returned"),
        (lambda t, p, w: (w.velocity, w.spin, w.spin), "a force and a torque, but returned"),
        (lambda t, p, w: (w.velocity[:1], w.spin), "a force and a torque of shapes"),
        (lambda t, p, w: (jnp.zeros(shape), jnp.zeros(5)), "a force and a torque of shapes"),
    ):
        with pytest.raises(ValueError, match=f"argument load must return {told}"):
            as_load(bad).wrench(0.7, body)
    push = Push(np.ones(shape), 0.0, 1.0)
    assert as_load(push) is push


def load_of_orientation(t, pose, twist):
    """As its force the first number of the orientation, in each coordinate."""
    return jnp.ravel(pose.orientation)[0] + 0.0 * twist.velocity, 0.0 * twist.spin


def test_loads_may_hold_a_key_of_jax_random():
    """As `jax.random.key` makes them, which are no numbers to JAX; the noise is that of the key's numbers."""
    grasp, state = driven_plate()
    key = jax.random.key(3)

    def noisy(key, t, pose, twist):
        now = jax.random.fold_in(key, jnp.floor(t / 0.01).astype(int))
        return jnp.zeros(2), 1e-4 * jax.random.normal(now, ())

    def end(load):
        run = jxr.simulate(grasp.with_(load=load), state, 0.008, ts=1)
        return np.asarray(run.last.q)

    plain = end(
        lambda t, pose, twist: (jnp.zeros(2), 1e-4 * jax.random.normal(jax.random.fold_in(key, 0), ()))
    )
    np.testing.assert_allclose(end(Partial(noisy, key)), plain, rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match="argument q must be a real number or an array of them"):
        jxr.State(key, key, key)
    with pytest.raises(ValueError, match="argument outcome must return arrays of real numbers"):
        jxr.adaptive_map(lambda p: key, jxr.Parameters.grid(x=[0.0, 1.0]))
