"""The model's ends: each has its code, and its time is a root, with the right derivative."""

from types import SimpleNamespace

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

import jaxroll as jxr
from jaxroll._integration._events import first_dip, watched
from jaxroll._integration._step import RollingStep
from jaxroll._linalg._plane import Vec2
from jaxroll.geometry import frenet
from tests.measures import both_ways
from tests.subjects.disc_on_a_hill import disc_on_a_hill
from tests.subjects.driven_plate import driven_plate
from tests.subjects.rolling_disc import on_slope

RTOL = 1e-10
SHIFT = 3.363e-3  # arclength of the object's contour at its vertex (80)-(81)


def ends(grasp, state, t1=0.6, **options):
    """One run to the end of the model, nothing saved on the way."""
    return jxr.simulate(grasp, state, t1, ts=1, rtol=RTOL, throw=False, **options)


def rubbing(grasp, friction):
    """The same grasp with a friction cone."""
    contact = grasp.contacts[0]
    return grasp.with_contacts(jxr.Contact(contact.s_tip, contact.s_object, friction=friction))


def test_within_a_step_its_ends_and_slopes_give_a_cubic():
    """Any cubic is found again, at any share of the step."""
    cubics = [np.polynomial.Polynomial(c) for c in ([1.0, -2.0, 3.0, 0.5], [0.3, 0.1, -4.0, 2.0])]
    t0, t1 = jnp.asarray(0.4), jnp.asarray(1.1)
    ends = [jnp.array([*(c(t) for c in cubics), *(c.deriv()(t) for c in cubics), 9.0]) for t in (0.4, 1.1)]
    step = SimpleNamespace(lay=SimpleNamespace(width=2))
    for share in (0.0, 0.25, 0.8, 1.0):
        found = RollingStep._within(step, t0, t1, *ends, jnp.asarray(share))
        np.testing.assert_allclose(found, [c(0.4 + 0.7 * share) for c in cubics], rtol=1e-13)


def test_friction_cone_is_left_when_the_forces_say_so():
    """Against splines through 301 forces of a run without limits."""
    (little, state), (much, _) = (disc_on_a_hill(reach=0.06, friction=mu) for mu in (0.12, 5.0))
    free = jxr.simulate(little, state, 0.2, ts=301, rtol=RTOL, events=(), record=("multipliers",))
    assert free.result == jxr.RESULTS.successful
    f, lam = (CubicSpline(free.ts, values[:, 0]) for values in (free.multipliers.f, free.multipliers.lam))
    when = brentq(lambda t: abs(lam(t)) - 0.12 * f(t), 0.01, 0.2)
    run = ends(little, state, t1=0.2)
    assert run.result == jxr.RESULTS.slipping
    assert abs(float(run.stats.t_end) - when) <= 1e-8
    at_end = jxr.multipliers(little, run.stats.t_end, run.last)
    assert abs(abs(at_end.lam[0]) / at_end.f[0] - 0.12) <= 1e-12
    assert ends(much, state, t1=0.2).result == jxr.RESULTS.successful


@pytest.mark.parametrize("slope", [0.5, -0.4])
def test_a_friction_cone_has_two_sides(slope):
    """Starts that need more friction than there is, to either side, end at once; a little more will do."""
    needed = np.tan(abs(slope)) / 3.0
    rolled = lambda share: ends(*on_slope(slope, friction=share * needed), t1=1e-5)  # noqa: E731
    short = rolled(0.999)
    assert short.result == jxr.RESULTS.slipping and float(short.stats.t_end) == 0.0
    assert rolled(1.01).result == jxr.RESULTS.successful


def fading(t, angles, rates, tips):
    """A force on the driven plate that fades and then pulls."""
    return (0.5 * (1.0 - t / 0.3) - 0.2 * rates[0],)


def test_contact_is_lost_when_its_force_is_zero():
    grasp, state = driven_plate()
    faded = grasp.with_(controller=fading)
    run = ends(faded, state)
    assert run.result == jxr.RESULTS.contact_lost
    assert 0.1 < float(run.stats.t_end) < 0.35
    assert abs(jxr.multipliers(faded, run.stats.t_end, run.last).f[0]) <= 1e-12
    # Where a pull is allowed the same run goes on; its force crosses zero at that time.
    on = jxr.simulate(faded, state, 0.4, ts=401, rtol=RTOL, events=("friction",), record=("multipliers",))
    when = brentq(CubicSpline(on.ts, on.multipliers.f[:, 0]), 0.1, 0.39)
    assert abs(float(run.stats.t_end) - when) <= 1e-8


def test_a_start_beyond_a_limit_ends_at_once():
    grasp, state = driven_plate()
    run = ends(grasp.with_(force=-10.0), state)
    assert run.result == jxr.RESULTS.contact_lost and float(run.stats.t_end) == 0.0
    assert np.isfinite(np.asarray(run.last.q)).all()
    assert int(run.stats.contact) == 0 and float(run.stats.margin) < -1.0
    assert ends(grasp.with_(force=-10.0), state, t1=1e-11).result == jxr.RESULTS.contact_lost


def shortened(grasp, low):
    """The pivoted scene on an object contour that ends at arclength `low`."""
    old = grasp.object.contours[0]
    domain = jnp.stack([jnp.asarray(low, float), jnp.asarray(0.02)])
    contour = jxr.Catenary(old.contour.a, domain).moved(old.offset, old.angle, origin=old.origin)
    return grasp.with_(contours=(contour,))


def ended(grasp, face, tip):
    """The pivoted scene on contours with these ends: of the object, and of the fingertip."""
    old, inner = grasp.object.contours[0], grasp.fingers[0].tip.contour
    ends = (face[0] - SHIFT, face[1] - SHIFT)
    face = jxr.Catenary(old.contour.a, ends).moved(old.offset, old.angle, origin=old.origin)
    pad = jxr.Catenary(inner.contour.a, tip).moved(inner.offset)
    return grasp.with_(contours=(face,)).with_tip(0, pad.moved((0.0, 0.0), -np.pi / 2))


@pytest.mark.parametrize(
    ("face", "tip"),
    [
        ((-0.003, 0.03), (-0.03, 0.03)),
        ((-0.03, 0.0005), (-0.03, 0.03)),
        ((-0.03, 0.03), (-0.03, 0.003)),
        ((-0.03, 0.03), (-0.0005, 0.03)),
    ],
)
def test_contour_ends_to_rounding(scene, face, tip):
    """Either end of either contour: the lower of the face and the upper of the tip, then, on the way back."""
    grasp, state = scene
    free = grasp.with_(damping=0.0)
    if 0.0005 in face or -0.0005 in tip:
        state = jxr.simulate(free, state, 0.3, ts=1, rtol=RTOL).last
        assert 0.003 < float(state.s[0]) < 0.006 and float(state.v[0]) < -1.0
    # A contact must start on its contours: it is counted from where this state has it.
    begun = state.s[0]
    free = free.with_contacts(jxr.Contact(-0.003 + begun, 0.003 - begun))
    run = ends(ended(free, face, tip), jxr.State(state.q, state.v, 0.0 * state.s), t1=2.0)
    assert run.result == jxr.RESULTS.contour_end
    places = (0.003 - (run.last.s[0] + begun), -0.003 + (run.last.s[0] + begun))
    left = [np.abs(np.subtract(pair, place)).min() for pair, place in zip((face, tip), places, strict=True)]
    assert min(left) <= 1e-15 and max(left) > 0.01


@jax.jit
def rolled_down(numbers, way, bar, t1):
    """A disc that rolls down until it slips or its hill ends, by its friction, its mass and that end.

    Time and state of its end, their derivative along a way, the gradient of a weighted sum, and the code.
    It is a single lane of a single one, which is no batch.
    """

    def reached(numbers):
        friction, mass, reach = numbers
        run = ends(*disc_on_a_hill(friction=friction, mass=mass, reach=reach), t1=t1)
        return jnp.concatenate([run.stats.t_end[None], run.last.q, run.last.v]), run.result._value

    def both_modes(numbers):
        values, push, code = jax.linearize(reached, numbers, has_aux=True)
        return values, push(way), jax.linear_transpose(push, numbers)(bar)[0], code

    return jax.tree.map(lambda x: x[0, 0], jax.vmap(jax.vmap(both_modes))(numbers[None, None]))


def slipping_disc(numbers, way, bar):
    """End and first coordinate of a disc that slips, by its friction and mass, and both derivatives."""
    given = ([*numbers, 0.03], [*way, 0.0], [*bar, *np.zeros(5)])
    values, along, slopes, _ = rolled_down(*map(jnp.array, given), 0.6)
    return values[:2], along[:2], slopes[:2]


def finger_at_an_end(numbers):
    """The pivoted scene, damped by the second number, at the contour's end that the first one is."""
    grasp, state = jxr.scenes.pivoted()
    run = ends(shortened(grasp.with_(damping=numbers[1]), numbers[0]), state, t1=2.0)
    return jnp.stack([run.stats.t_end, run.last.q[0]])


@pytest.mark.parametrize(
    ("program", "point", "sizes"),
    [
        (slipping_disc, (0.12, 0.05), (1e-4, 1e-4)),
        pytest.param(both_ways(finger_at_an_end), (-0.0065, 0.006), (6.5e-6, 1e-5), marks=pytest.mark.slow),
    ],
    ids=["slipping disc", "finger at an end"],
)
def test_gradient_of_the_event_time(program, point, sizes):
    """Both modes, in the limit and in a parameter of the motion, against central differences.

    The derivative of the last state is total: the event shifts as well.
    """
    point, ending = np.array(point), np.array([1.0, 0.0])
    along = lambda p, way: program(p, way, ending)[:2]  # noqa: E731
    reverse_of = lambda p: program(p, np.zeros(2), ending)[2]  # noqa: E731
    for way, found, step in zip(np.eye(2), reverse_of(point), sizes, strict=True):
        slopes = along(point, way)[1]
        np.testing.assert_allclose(slopes[0], found, rtol=1e-9)
        # Fourth-order differences: truncation and rounding both below 1e-7.
        values = np.array([along(point + k * step * way, way)[0] for k in (-2, -1, 1, 2)])
        differences = np.array([1.0, -8.0, 8.0, -1.0]) @ values / (12 * step)
        assert abs(slopes[0] / differences[0] - 1) <= 1e-6
        # At a contour's end the damping does not move it at all.
        np.testing.assert_allclose(slopes[1], differences[1], rtol=1e-5, atol=1e-9)
    if program is slipping_disc:  # a run that is lost at once ends then whatever its numbers are
        lost = np.array([0.002, point[1]])
        for way in np.eye(2):
            values, slopes = along(lost, way)
            assert values[0] == 0.0 and slopes[0] == 0.0 and not reverse_of(lost).any()
            assert abs(slopes[1]) <= 1e-16  # the start is closed to rounding, by the mass


def test_what_a_run_reached_has_a_gradient_though_the_rest_is_nan():
    """Forces, energies and residuals of a run that slips on its way: backwards as by differences."""

    def reached(mass):
        record = ("multipliers", "energy")
        options = {"ts": 13, "rtol": RTOL, "throw": False, "record": record}
        run = jxr.simulate(*disc_on_a_hill(mass=mass, friction=0.12), 0.3, **options)
        seen = jnp.isfinite(run.multipliers.f[:, 0])
        rows = [run.multipliers.f[:, 0], run.multipliers.lam[:, 0], 1e3 * run.energy.residual]
        rows += [1e3 * run.energy.kinetic, 1e3 * run.residuals.normal[:, 0]]
        return jnp.sum(jnp.where(seen, jnp.stack(rows), 0.0)), jnp.sum(seen)

    both, size = jax.jit(jax.value_and_grad(reached, has_aux=True)), 1e-4
    (_, seen), slope = both(0.05)
    near = [float(both(0.05 + k * size)[0][0]) for k in (-2, -1, 1, 2)]
    expected = (near[0] - 8 * near[1] + 8 * near[2] - near[3]) / (12 * size)
    assert 1 < seen < 13 and abs(slope / expected - 1) <= 1e-6


def test_gradients_of_lanes_are_those_of_single_runs():
    """Lanes of lanes, some of which end on a contour's end: in both modes, with one record at a time."""
    masses, reaches = jnp.array([0.04, 0.05]), jnp.array([0.01, 0.025, 0.005])
    weights = np.array([1.0, 1.0, 1.0, 1.0, 0.1, 0.1, 0.1])

    def found(mass, reach):
        run = ends(*disc_on_a_hill(mass=mass, reach=reach), t1=0.12)
        return jnp.sum(run.last.q + 0.1 * run.last.v) + run.stats.t_end, run.result._value

    over_both = lambda f, *rest: jax.vmap(jax.vmap(f, (None, 0, *rest)), (0, None, *rest))  # noqa: E731
    # A friction that always suffices.
    alone = lambda *numbers: rolled_down(np.array([9.0, *numbers]), np.zeros(3), weights, 0.12)[2:]  # noqa: E731
    each = [[alone(mass, reach) for reach in reaches] for mass in masses]
    expected = np.array([[slopes[1:] for slopes, _ in row] for row in each])
    codes = np.array([[int(code) for _, code in row] for row in each])
    assert len(np.unique(codes)) == 2 and (expected[codes > 0][:, 1] != 0).all()

    def both_modes(mass, reach, way):
        value, push, code = jax.linearize(found, mass, reach, has_aux=True)
        return value, push(*way), jax.linear_transpose(push, mass, reach)(1.0), code

    program = jax.jit(over_both(both_modes, None)).lower(masses, reaches, np.ones(2)).compile()
    for i, way in enumerate(np.eye(2)):
        _, along, slopes, ended = program(masses, reaches, way)
        # A row of `expected` holds the slopes in the mass and in the end.
        np.testing.assert_allclose(along, expected[..., i], rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(np.stack(slopes, axis=-1), expected, rtol=1e-6, atol=1e-12)
        np.testing.assert_array_equal(ended, codes)
    size = 1e-4
    near = [program(masses + k * size, reaches, np.ones(2))[0] for k in (-2, -1, 1, 2)]
    differences = np.tensordot([1.0, -8.0, 8.0, -1.0], near, 1) / (12 * size)
    np.testing.assert_allclose(differences, expected[..., 0], rtol=1e-5)
    # Records of all six runs, of x and its slope alone, would be larger than all that the program works with.
    records = masses.size * reaches.size * 4096 * 2 * 7 * masses.dtype.itemsize
    assert program.memory_analysis().temp_size_in_bytes < 0.75 * records


def test_every_lane_finds_its_event_in_few_steps(scene):
    """100 ends of the contour, down to where the contact hardly moves: no lane crawls, none misses."""
    grasp, state = scene
    lows = jnp.linspace(-0.0080, -0.0005, 100)
    runs = jax.jit(jax.vmap(lambda low: ends(shortened(grasp, low), state, t1=2.0)))(lows)
    assert (np.asarray(runs.result._value) == jxr.RESULTS.contour_end._value).all()
    assert np.asarray(runs.stats.rejected).max() <= 25
    np.testing.assert_allclose(0.003 - runs.last.s[:, 0], lows + 3.363e-3, rtol=0, atol=1e-15)


class Hollow(jxr.AbstractContour):
    """A user's contour: a concave arc, of 30 mm radius unless said otherwise."""

    radius: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(0.03))
    closed: bool = eqx.field(default=False, static=True)
    smoothness: float = eqx.field(default=float("inf"), static=True)

    def curve(self, s):
        angle = s / self.radius
        return Vec2(self.radius * (1.0 - jnp.cos(angle)), self.radius * jnp.sin(angle))

    def frame(self, s):
        return frenet(self.curve, s)

    def prepared(self):
        return self

    def domain(self):
        return None


def on_hollow(scene, hollow, spin):
    """The pivoted scene on a concave face, and its start there, with the object turning at a rate."""
    grasp, state = scene
    old = grasp.object.contours[0]
    changed = grasp.with_(contours=(hollow.moved(old.offset, old.angle, origin=old.origin),))
    turning = jxr.State(state.q, jnp.array([1.0, 0.0, 0.0]), state.s)
    grasp, start = jxr.close(changed, turning)
    return grasp, jxr.State(start.q, spin * start.v, start.s)


def relative_sum(grasp, run):
    """Sum of the curvatures where a run ended, by the size of either."""
    tip, face = grasp.shapes(grasp.contacts[0])
    bends = jnp.stack([tip.curvature(run.last.s[0] - 0.003), face.curvature(0.003 - run.last.s[0])])
    return jnp.sum(bends) / jnp.sum(jnp.abs(bends))


def test_curvature_sum_runs_out(scene):
    """On a concave face the fingertip flattens until it no longer rolls; the run says so."""
    hollow, start = on_hollow(scene, Hollow(), -40.0)
    run = ends(hollow, start, t1=1.0, events=())
    assert run.result == jxr.RESULTS.singular_contact
    assert abs(relative_sum(hollow, run)) < 2e-4


@pytest.mark.parametrize(
    ("excess", "code"), [(1.8e-4, jxr.RESULTS.singular_contact), (2.2e-4, jxr.RESULTS.successful)]
)
def test_a_ten_thousandth_of_a_curvature_is_none(scene, excess, code):
    """The relative sum is about half of what the face's radius exceeds the fingertip's by."""
    bend = scene[0].fingers[0].tip.curvature(-0.003)
    hollow, start = on_hollow(scene, Hollow((1.0 + excess) / bend), 0.0)
    run = ends(hollow, start, t1=1e-9, events=())
    assert run.result == code
    assert float(relative_sum(hollow, run)) == pytest.approx(excess / (2.0 + excess), rel=1e-6)


def rolled_into_a_hollow(grasp, start, numbers):
    """Code, time, and at the end: relative sum of curvatures, normal force, distance to the cone's sides."""
    spin, damping, force = numbers
    friction = 0.5
    scene = rubbing(grasp.with_(damping=damping, force=force), friction)
    run = ends(scene, jxr.State(start.q, spin * start.v, start.s), t1=1.0)
    at_end = jxr.multipliers(scene, run.stats.t_end, run.last)
    f, lam = at_end.f[0], at_end.lam[0]
    return run.result._value, run.stats.t_end, relative_sum(scene, run), f, friction * f - abs(lam)


def test_every_end_is_at_the_limit_that_its_code_names(scene):
    """Where the sum of curvatures runs out, forces have a pole: that is no lost contact, and no slip."""
    draw = np.random.default_rng(0).uniform
    numbers = (draw(-60.0, 60.0, 64), 10.0 ** draw(-4.0, -2.0, 64), 10.0 ** draw(-1.0, 1.0, 64))
    begun = on_hollow(scene, Hollow(), 1.0)
    batch = jax.jit(jax.vmap(lambda *row: rolled_into_a_hollow(*begun, row)))
    codes, when, left, f, cone = map(np.asarray, batch(*map(jnp.asarray, numbers)))
    singular = codes == jxr.RESULTS.singular_contact._value
    slips = codes == jxr.RESULTS.slipping._value
    fine = codes == jxr.RESULTS.successful._value
    assert (singular | slips | fine).all() and min(singular.sum(), slips.sum(), fine.sum()) >= 5
    assert (left[singular] < 1e-3).all() and (left[~singular] > 1e-3).all()
    later = slips & (when > 0)
    assert later.sum() >= 5 and (abs(cone[later]) <= 1e-8 * abs(f[later])).all()
    # Each lane ends on its own: what another one does changes nothing.
    others = batch(*(jnp.asarray(x).at[np.argmax(slips)].multiply(0.5) for x in numbers))
    assert others[1][np.argmax(slips)] != when[np.argmax(slips)]
    for x, same in zip((codes, when, left, f, cone), others, strict=True):
        np.testing.assert_array_equal(*(np.delete(each, np.argmax(slips)) for each in (x, same)))


class Tug(eqx.Module):
    """Control (75) whose force is pulled back for a moment."""

    depth: jax.Array
    when: jax.Array

    def __call__(self, t, angles, rates, tips):
        arm = tips[0].position - jnp.array([0.03, 0.105])
        left = 1.0 - self.depth * jnp.exp(-(((t - self.when) / 0.01) ** 2))
        return (-0.006 * rates[0] - 50.0 * left * tips[0].jacobian.T @ arm,)


def pulled(scene, depth, when, **options):
    """A run under one pull."""
    return jxr.simulate(scene[0].with_(controller=Tug(depth, when)), scene[1], 0.4, throw=False, **options)


@pytest.fixture(scope="module")
def pulls(scene):
    """48 pulls, some deep enough to lose the contact, some not, and the lowest of 500 forces of each."""
    draw = np.random.default_rng(1).uniform
    given = jnp.asarray(draw(0.9, 1.1, 48)), jnp.asarray(draw(0.1, 0.35, 48))
    options = {"ts": 500, "events": (), "record": ("multipliers",)}
    # One by one: a batch takes twice as long to compile.
    runs = [pulled(scene, *pull, **options) for pull in zip(*given, strict=True)]
    return given, np.array([np.min(run.multipliers.f) for run in runs])


@pytest.mark.parametrize(
    ("solver", "rtol"),
    [
        (None, 1e-8),
        pytest.param(jxr.Rosenbrock(), 1e-6, marks=pytest.mark.slow),
        pytest.param(diffrax.Heun(), 1e-4, marks=pytest.mark.slow),
        pytest.param(diffrax.Tsit5(), 1e-6, marks=pytest.mark.slow),
    ],
)
def test_a_force_that_falls_below_zero_and_rises_within_a_step_is_seen(scene, pulls, solver, rtol):
    """Against forces at many times of runs that nothing ends."""
    given, force = pulls
    run = lambda *pull: pulled(scene, *pull, ts=1, solver=solver, rtol=rtol).result._value  # noqa: E731
    lost = np.asarray(jax.jit(jax.vmap(run))(*given)) == jxr.RESULTS.contact_lost._value
    sure = abs(force) > 1e-3
    assert 10 <= lost.sum() <= 38 and sure.sum() >= 40
    np.testing.assert_array_equal(lost[sure], force[sure] < 0)


def swinging(numbers, t, angles, rates, tips):
    """The jaw is damped; the finger swings free, or is driven."""
    torque, damping = numbers
    return (-5.0 * rates[0], torque - damping * rates[1])


def swung(base, rate, numbers, t1, events=("penetration",)):
    """A run of a disc held by a round jaw, past which, or at which, a finger of 50 mm swings."""
    disc = jxr.PivotedObject(jxr.Circle(0.02), inertia=1e-5, pivot=(0.03, 0.1))
    holder = jxr.Jaw(jxr.Circle(0.01), 0.05, [0.0, 0.5 * np.pi], base=(0.0, 0.1))
    other = jxr.Finger([0.05], [0.045], jxr.Circle(0.008), base=base)
    controller = jax.tree_util.Partial(swinging, numbers)
    # The jaw touches the disc at its left.
    grasp = jxr.Grasp(disc, [holder, other], jxr.Contact(0.0, 0.02 * np.pi), controller=controller)
    state = jxr.State([0.0, 0.0, 0.0, np.pi - 0.6], rate * np.eye(4)[3], np.zeros(1))
    return ends(grasp, state, t1=t1, events=events)


def distance_of_centres(run, base):
    """From the disc's to that of the other finger's tip [m]: 28 mm where both circles touch."""
    angle = float(run.last.q[3])
    tip = np.asarray(base) + 0.05 * np.array([np.cos(angle), np.sin(angle)])
    return np.linalg.norm(tip - np.array([0.03, 0.1]))


def test_a_finger_that_passes_through_the_object_within_a_step_is_penetration():
    """It overlaps by half a millimetre for four milliseconds; one that keeps clear by that does not."""
    base, free = jnp.array([0.03 + 0.0275 + 0.05, 0.1]), jnp.zeros(2)
    through = swung(base, 40.0, free, 0.03)
    assert through.result == jxr.RESULTS.penetration
    assert abs(distance_of_centres(through, base) - 0.028) <= 2e-7
    apart = base + jnp.array([1e-3, 0.0])
    assert swung(apart, 40.0, free, 0.03).result == jxr.RESULTS.successful


def test_the_lowest_place_of_a_parabola_is_found_from_its_samples():
    times, draw = np.array([0.0, 0.15, 0.4, 0.65, 0.92, 1.0]), np.random.default_rng(0).uniform
    for place, depth in zip(draw(0.1, 0.95, 40), draw(-0.1, 0.1, 40), strict=True):
        values = [jnp.asarray(depth + 3.0 * (t - place) ** 2) for t in times]
        found = float(first_dip(times, values))
        if depth < 0:
            assert abs(found - place) <= 1e-12
        i = 1 + int(np.argmin(values[1:-1]))
        if depth > 0.26 * max(values[i - 1], values[i + 1]):  # not close beside its neighbours either
            assert found == np.inf


def test_a_dip_that_no_parabola_tells_shortens_the_step():
    """An ellipse that grazed lift-off: zero at a share of 0.799, and the parabola's lowest value is 2e-6."""
    times = np.array([0.0, 0.1475, 0.375, 0.465, 0.56486545, 0.65, 0.92465628, 1.0])
    margins = [1.107e-3, 6.685e-4, 2.441e-4, 1.426e-4, 6.530e-5, 2.462e-5, 1.529e-5, 3.739e-5]
    assert 0.79 <= float(first_dip(times, [jnp.asarray(m) for m in margins])) <= 0.81


def test_a_dip_before_the_end_of_a_step_that_ends_below_zero_rises_again():
    """Without one such a step is bracketed by its ends, which is quicker."""
    times = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    ask = lambda margins: float(first_dip(times, [jnp.asarray(m) for m in margins]))  # noqa: E731
    assert ask([1.0, 0.6, 0.3, 0.1, -0.2, -0.6]) == np.inf
    assert 0.1 < ask([1.0, -0.2, 0.6, 0.4, 0.1, -0.1]) < 0.4


def test_a_force_that_dips_is_seen_beside_the_near_end_of_a_contour():
    """A lift of a tenth of a second on a disc that rolls 20 mm: 54 of 101 were seen, but here 26."""

    def lost(moment, end):
        wall = jxr.Jaw(jxr.Line((-end, end)), angle=0.5 * jnp.pi)
        disc = jxr.FreeObject(jxr.Circle(0.01), 0.05, 2.5e-6)

        def load(t, pose, twist):
            return jnp.array([0.0, -0.05 * (1.0 - 1.2 * jnp.exp(-(((t - moment) / 0.05) ** 2)))]), 0.0

        grasp = jxr.Grasp(disc, wall, jxr.Contact(0.0, -0.005 * np.pi), load=load)
        start = jxr.State([0.0, 0.01, 0.0], [0.02, 0.0, -2.0], [0.0])
        run = jxr.simulate(*jxr.close(grasp, start, throw=False), 1.0, ts=1, throw=False)
        return run.result == jxr.RESULTS.contact_lost

    every = jax.jit(jax.vmap(lost, (0, None)))
    near, far = (int(np.sum(every(np.linspace(0.3, 0.7, 101), end))) for end in (0.025, 0.2))
    assert near >= far >= 50


def test_stages_beyond_a_step_or_beside_another_tell_nothing_of_dips_within_it():
    assert watched(np.array([0.0, 0.5, 1.2, 0.25, 1.0])).tolist() == [0, 3, 1, 4]
    assert watched(np.array([0.0, 0.5, 0.5, 1.0])).tolist() == [0, 2, 3]


class Blowing(eqx.Module):
    """A torque that grows without bound towards a moment: velocities diverge there, as its power says."""

    power: jax.Array
    moment: float = 0.1003

    def __call__(self, t, angles, rates, tips):
        ahead = self.moment - t
        return [jnp.array([0.0, 2e-6]) * jnp.sign(ahead) / jnp.abs(ahead) ** self.power - 0.005 * rates[0]]


@pytest.mark.parametrize("power", (1.0, 2.0))
def test_no_run_goes_on_through_a_moment_at_which_nothing_is_finite(scene, power):
    """diffrax alone would take a step of the smallest length whatever its error, and end it `successful`."""
    grasp, state = scene
    driven = grasp.with_(controller=Blowing(jnp.asarray(power)))
    run = jxr.simulate(driven, state, 0.2, ts=1, events=(), throw=False)
    assert run.result == jxr.RESULTS.step_collapsed
    assert abs(float(run.stats.t_end) - Blowing(0.0).moment) <= 1e-9
    assert np.isfinite(run.last.q).all() and np.isfinite(run.last.v).all()


def test_a_stretched_finger_is_a_singular_grasp():
    """Neither a straight finger nor a pivoted disc can move along their common line."""
    disc = jxr.PivotedObject(jxr.Circle(0.02), inertia=1e-5, pivot=(0.0, 0.16))
    finger = jxr.Finger([0.065, 0.065], [0.045, 0.040], jxr.Circle(0.01))
    grasp = jxr.Grasp(disc, finger, jxr.Contact())
    state = jxr.State(jnp.array([-jnp.pi / 2, jnp.pi / 2, 0.0]), jnp.zeros(3), jnp.zeros(1))
    run = jxr.simulate(grasp, state, 0.1, ts=1, throw=False)
    assert run.result == jxr.RESULTS.singular_contact
    assert np.isfinite(np.asarray(run.last.q)).all()


def test_a_finger_that_hits_the_object_elsewhere_is_penetration():
    base, driven = jnp.array([0.09, 0.1]), jnp.array([2e-4, 1e-4])
    run = swung(base, 0.1, driven, 2.0)
    assert run.result == jxr.RESULTS.penetration
    assert 0 <= 0.028 - distance_of_centres(run, base) <= 2e-7
    assert swung(base, 0.1, driven, 2.0, events=()).result == jxr.RESULTS.successful


def test_limits_that_are_off_leave_the_program_no_larger():
    grasp, state = disc_on_a_hill(gravity=None)

    def lines(grasp, **options):
        run = jax.make_jaxpr(lambda g, s: jxr.simulate(g, s, 1.0, ts=3, throw=False, **options))
        return len(str(run(grasp, state)).splitlines())

    off = lines(grasp, events=())
    assert off < lines(grasp) < lines(disc_on_a_hill(gravity=None, friction=0.3)[0])
    assert off == lines(grasp, events=("friction",))
    assert off < lines(grasp, events=(), record=("multipliers",))
    assert off < lines(grasp, events=(), record=("energy",))
    assert off < lines(grasp.with_(gravity=(0.0, -9.81)), events=())
