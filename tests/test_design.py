"""Fingertips for condition (41): an analytic optimum, violating starts, limits that exclude it."""

import functools
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe

import jaxroll as jxr
from jaxroll._linalg._plane import Vec2
from jaxroll.design import _design, _fingertip, _minimise, Fair, Limits, optimise_fingertip
from jaxroll.design._descent import _direction, _learnt, Bfgs, Optax, Walk
from jaxroll.design._limits import check_interval, margins, sampled, soft_least
from jaxroll.design._minimise import minimise, Search
from jaxroll.geometry import Frenet2, PeriodicNetwork
from jaxroll.geometry.contours._free_numbers import wavy_shift
from tests.measures import programs
from tests.subjects.fingertips import INTERVAL, violating_points, within


def half_disc(x, centre, sharpness):
    """Squared distance from a centre, on the upper half of the unit disc."""
    return jnp.sum((x - centre) ** 2), jnp.stack([jnp.dot(x, x) - 1.0, -x[1]])


@pytest.mark.parametrize("options", [{}, {"in_turn": True}, {"optimiser": optax.lbfgs()}])
def test_minimiser_on_a_problem_by_hand(options):
    """Nearest points of a half disc: on its rim, in its corner, inside."""
    centres = jnp.array([[3.0, 4.0], [2.0, -1.0], [0.1, 0.2]])
    # Not `jnp.full`, of a weak type, with which the first chunk would be a program of its own.
    found = minimise(half_disc, jnp.asarray(np.full((3, 2), 0.1)), centres, steps=200, **options)
    nearest = [[0.6, 0.8], [1.0, 0.0], [0.1, 0.2]]
    np.testing.assert_allclose(found.search.best, nearest, atol=2e-7)
    assert bool(found.search.done.all()) and found.steps <= 200


def test_the_memory_of_a_method_begins_with_the_types_that_its_steps_return():
    """Of weak types, as it comes from optax, JAX would compile the steps once more after the first."""
    memory = Optax(optax.lbfgs()).fresh(jnp.ones(2))
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(memory))


def valley(x, data, sharpness):
    """Rosenbrock's function: a bent valley, with places that bend downwards."""
    return 100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2, -jnp.ones(1)


@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_descent_follows_a_bent_valley(mode):
    starts = jnp.array([[-1.2, 1.0], [0.0, 2.0], [3.0, -2.0]])
    found = minimise(valley, starts, jnp.zeros(3), steps=150, mode=mode)
    np.testing.assert_allclose(found.search.best, 1.0, atol=1e-6)


def test_a_step_into_nowhere_is_taken_back():
    nowhere = lambda x, data, sharpness: (jnp.sum(x - jnp.log(x)), -jnp.ones(1))  # noqa: E731
    found = minimise(nowhere, jnp.array([[1e-3, 5.0]]), jnp.zeros(1), steps=60)
    np.testing.assert_allclose(found.search.best, 1.0, atol=1e-6)
    rates = optax.adam(optax.exponential_decay(0.5, 20, 0.5))
    found = minimise(nowhere, jnp.array([[0.1, 3.0]]), jnp.zeros(1), steps=200, optimiser=rates)
    np.testing.assert_allclose(found.search.best, 1.0, atol=1e-2)


@eqx.filter_jit
def excess(limits, tip, pad):
    return limits.excess(sampled(tip, pad))


class Clothoid(jxr.AbstractContour):
    """A contour whose curvature is linear in arclength."""

    bend: jax.Array
    slope: jax.Array
    ends: jax.Array
    closed: bool = eqx.field(default=False, static=True)
    smoothness: float = eqx.field(default=float("inf"), static=True)

    def frame(self, s):
        angle = self.bend * s + 0.5 * self.slope * s * s
        # Where it passes does not matter here: every point is put at s along the x axis.
        zero = jnp.zeros_like(angle)
        return Frenet2(Vec2(zero + s, zero), Vec2(jnp.cos(angle), jnp.sin(angle)), self.bend + self.slope * s)

    def curve(self, s):
        return self.frame(s).point

    def prepared(self):
        return self

    def domain(self):
        return self.ends


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_limits_look_at_either_side(side):
    """Each bound on a contour with known curvatures, bent outwards and hollow, rising and falling."""
    ends, pad = (-0.01, 0.03), jnp.array([0.0, 0.02])
    contour = Clothoid(*map(jnp.asarray, (side * 50.0, side * 2e3, ends)))
    most = max(abs(50.0 + 2e3 * s) for s in ends)
    limits = Limits(size=0.02, length=0.05, radius=0.004, flat=0.05, steepness=500.0)
    found = excess(limits, contour, pad)
    assert sorted(found) == ["flat", "interval", "length", "radius", "size", "steepness"]
    np.testing.assert_allclose(found["interval"], [-0.5, -0.5])
    past = excess(limits, contour, jnp.array([-0.015, 0.035]))
    np.testing.assert_allclose(past["interval"], [0.1, 0.1])
    assert float(found["size"].max()) == pytest.approx(0.03 / 0.02 - 1.0)
    assert float(found["length"].max()) == pytest.approx(0.04 / 0.05 - 1.0)
    assert float(found["radius"].max()) == pytest.approx(most * 0.004 - 1.0)
    assert float(found["steepness"].max()) == pytest.approx(2e3 / 500.0 - 1.0)
    least = min(side * (50.0 + 2e3 * s) for s in (0.0, 0.02))
    assert float(found["flat"].max()) == pytest.approx(1.0 - least * 0.05)
    convex = excess(Limits(flat=None), contour, pad)["convex"]
    assert float(convex.max()) == pytest.approx(-least * 0.04)


def test_a_contour_through_the_centre_of_its_finger_has_derivatives_of_its_size():
    """At its vertex a catenary is as far from $O_i$ as nothing; elsewhere the distance has a derivative."""
    ends = 0.012 * np.array([-1.0, 1.0])
    size = lambda a: Limits(size=0.01).excess(sampled(jxr.Catenary(a, ends), 0.5 * ends))["size"]  # noqa: E731
    # a (cosh u - 1) and a u at the angle of arclength s = a sinh u: the distance squared is their sum.
    far = lambda a: np.hypot(np.hypot(a, 0.012) - a, a * np.arcsinh(0.012 / a)) / 0.01 - 1.0  # noqa: E731
    slopes = np.asarray(jax.jit(jax.jacrev(size))(0.02))
    assert slopes[128] == 0.0 and np.isfinite(slopes).all()
    assert float(slopes[0]) == pytest.approx((far(0.02 + 1e-6) - far(0.02 - 1e-6)) / 2e-6, rel=1e-6)


def test_the_contact_interval_stays_between_the_ends_of_an_open_contour():
    """A catenary shorter than its interval was found within a limit of 15 mm, with its ends exchanged."""
    tip = jxr.Catenary(1.0 / 40.0, (-0.012, 0.012)).moved((0.01, 0.0))
    for length, code in ((0.015, jxr.RESULTS.infeasible), (0.022, jxr.RESULTS.max_steps_reached)):
        limits = Limits(length=length, ahead=0.005, flat=0.2)
        design = optimise_fingertip(tip, (-0.01, 0.01), limits=limits, steps=60)
        assert design.result == code
    low, high = design.tip.domain()
    assert low <= -0.01 + 1e-8 and high >= 0.01 - 1e-8 and high - low <= 0.022 + 1e-8
    assert "limit on interval" in str(design)


def test_ellipse_has_the_analytic_optimum():
    """As long as allowed and as sharp at its ends: both limits fix both half axes."""
    length, radius = 0.1, 0.004
    limits = within(length=length, radius=radius)
    design = optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, limits=limits, steps=300)

    def perimeter(b):
        return 4 * b * ellipe(1 - radius / b)  # a^2 = radius b

    b = brentq(lambda b: perimeter(b) - length, 0.01, 0.03)
    np.testing.assert_allclose([design.tip.a, design.tip.b], [np.sqrt(radius * b), b], rtol=1e-6)
    assert design.result == jxr.RESULTS.successful and bool(design.holds[0])


@pytest.mark.slow
def test_every_violating_start_comes_to_hold():
    """20 seeds in one batch: a positive margin on the whole interval within 200 steps."""
    tips = [jxr.Spline(violating_points(seed), cells=128) for seed in range(20)]
    design = optimise_fingertip(tips, INTERVAL, steps=200, limits=Limits(size=0.02, radius=0.001, flat=0.1))
    assert np.all(np.asarray(design.before) < 0.0)
    assert design.history.shape[1] <= 200
    assert bool(design.holds.all())
    margins = jxr.stability.margin(design.tip, np.linspace(*INTERVAL, 65))
    np.testing.assert_allclose(margins.min(), design.after[design.chosen], rtol=1e-9)


def test_limits_that_exclude_it_end_with_a_code():
    """No contour 40 mm long keeps all its radii above 8 mm."""
    limits = within(length=0.04, radius=0.008)
    design = optimise_fingertip(jxr.Ellipse(0.01, 0.01), INTERVAL, limits=limits, steps=60)
    assert design.result == jxr.RESULTS.infeasible and not bool(design.holds[0])
    assert 0.1 < float(design.violation[0]) < 1.0 and np.isfinite(design.after[0])
    assert "passed by" in str(design)


@pytest.mark.slow
def test_support_function_and_symmetry():
    start = jxr.SupportFunction(0.01, [0.004, -0.001, 0.0, 0.0], [0.0, 0.0005, 0.0002, 0.0])
    design = optimise_fingertip(
        start, INTERVAL, limits=Limits(size=0.015, radius=0.002), symmetric=True, steps=60
    )
    assert float(design.before[0]) < 0.0 < float(design.after[0])
    assert np.all(np.asarray(design.tip.sines) == 0.0)


@pytest.mark.slow
def test_starts_that_are_not_given_are_variations():
    limits = Limits(length=0.1, radius=0.004, flat=None)
    design = optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, limits=limits, starts=4, steps=100)
    assert design.after.shape == (4,) and len(np.unique(design.before)) == 4
    assert bool(design.holds[design.chosen])
    inside = np.asarray(design.violation) <= 1e-7
    np.testing.assert_allclose(
        design.after[design.chosen], np.max(np.asarray(design.after)[inside]), rtol=1e-6
    )


def test_a_pad_stays_ahead_of_the_finger():
    """The best pad is as near to O as it may be, and as flat: both limits are met."""
    limits = within(size=0.03, radius=0.002, ahead=0.008, flat=0.05)
    design = optimise_fingertip(jxr.Ellipse(0.012, 0.012), (-0.001, 0.001), limits=limits, steps=200)
    a, b = float(design.tip.a), float(design.tip.b)
    np.testing.assert_allclose([a, b**2 / a], [0.008, 0.02 / 0.008 * 0.02], rtol=2e-2)


def test_goes_on_from_a_checkpoint(tmp_path, caplog):
    limits = within(length=0.1, radius=0.004)
    options = {"limits": limits, "checkpoint": tmp_path / "design.eqx"}
    optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, steps=20, **options)
    seen = []
    report = lambda step, value, violation: seen.append(step)  # noqa: E731
    with jax.log_compiles():
        whole = optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, steps=40, progress=report, **options)
    assert "jit(_advance)" not in programs(caplog)
    assert seen == [30, 40]
    straight = optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, steps=40, limits=limits)
    np.testing.assert_array_equal(whole.history, straight.history)


def test_a_checkpoint_is_of_one_search_alone(tmp_path):
    """Of another one with arrays of the same shapes it was taken for this one's."""
    limits = within(length=0.1, radius=0.004)
    search = functools.partial(optimise_fingertip, steps=10, checkpoint=tmp_path / "design")
    search(jxr.Ellipse(0.02, 0.01), INTERVAL, limits=limits)
    search(jxr.Ellipse(0.02, 0.01), INTERVAL, limits=limits, goal=jxr.design.Margin())
    for tip, options, name in [
        (jxr.Ellipse(0.03, 0.01), {"limits": limits}, "tip"),
        (jxr.Ellipse(0.02, 0.01), {"limits": within(length=0.2, radius=0.004)}, "limits"),
        (jxr.Ellipse(0.02, 0.01), {"limits": limits, "optimiser": optax.adam(0.1)}, "optimiser"),
        (jxr.Ellipse(0.02, 0.01), {"limits": limits, "goal": Fair(jxr.design.Margin())}, "goal"),
    ]:
        with pytest.raises(ValueError, match=f"^argument checkpoint must .* of one with another {name}$"):
            search(tip, INTERVAL, **options)


@pytest.mark.parametrize(
    ("tip", "options", "message"),
    [
        (jxr.Catenary(0.025), {}, "tip must have ends"),
        (jxr.Catenary(0.025, (-0.004, 0.004)), {}, "interval must lie on the contour"),
        (jxr.Ellipse(0.01, 0.02), {"symmetric": True}, "symmetric must be False"),
        ([jxr.Ellipse(0.01, 0.02), jxr.Circle(0.01)], {}, "contours of one kind"),
        (jxr.Ellipse(0.01, 0.02).prepared(), {}, "must not be prepared"),
        ("tip", {}, "one or more contours"),
        (jxr.Ellipse(0.01, 0.02), {"starts": 0}, "starts must be a whole number of at least 1"),
        (jxr.Ellipse(0.01, 0.02), {"starts": 10_001}, "starts must be .*10000, but was 10001"),
        (jxr.Ellipse(0.01, 0.02), {"mode": "both"}, "mode must be"),
    ],
)
def test_bad_arguments(tip, options, message):
    with pytest.raises(ValueError, match=message):
        optimise_fingertip(tip, INTERVAL, **options)


class Disc(jxr.AbstractContour):
    """A user's own disc of a fixed radius, whose centre a design may move."""

    radius: jax.Array
    centre: jax.Array
    closed, smoothness = True, float("inf")

    def curve(self, s):
        point = self.centre + self.radius * jnp.stack([jnp.cos(s / self.radius), jnp.sin(s / self.radius)])
        return Vec2(point[0], point[1])

    def domain(self):
        return 0.0, 2 * np.pi * self.radius

    def free_numbers(self):
        return [self.centre]

    def symmetrised(self):
        return eqx.tree_at(lambda c: c.centre, self, self.centre * jnp.array([1.0, 0.0]))

    def perturbed(self, rng):
        return eqx.tree_at(lambda c: c.centre, self, self.centre + jnp.array([1e-4, 0.0]))


def test_a_class_of_ones_own_is_designed_by_what_it_says_of_itself():
    """The margin of a disc about c is -c.n: the best one lies as far back as `ahead` lets it, in the middle.

    The radius stays, which would be a free number by default, and the other start is the one asked for.
    """
    radius, ahead = 0.01, 0.004
    start = Disc(jnp.asarray(radius), jnp.array([0.003, 0.001]))
    limits = Limits(ahead=ahead, flat=None)
    design = optimise_fingertip(start, INTERVAL, symmetric=True, limits=limits, starts=2, steps=100)
    assert type(design.tip) is Disc and float(design.tip.radius) == radius
    np.testing.assert_allclose(design.tip.centre, [ahead - radius, 0.0], atol=5e-6)
    np.testing.assert_allclose(design.before, [-0.003, -0.0031], rtol=1e-3)
    assert float(design.start.centre[1]) == 0.0 and bool(design.holds.all())


TRANSFORMED = {
    "series": jxr.SupportFunction(0.01, [1e-3, 0.0, 5e-4], [0.0, 2e-4, 0.0], cells=64),
    "ellipse": jxr.Ellipse(0.02, 0.014),
    "placed": jxr.Spline(violating_points(1), cells=64).moved((0.001, 0.0), 0.1),
    "own": Disc(jnp.asarray(0.01), jnp.array([0.003, 0.001])),
}


def test_a_transform_of_a_known_tip_is_made_while_others_are_traced():
    tip = TRANSFORMED["ellipse"]
    traced = lambda x: x * jxr.design.ShapeTransform(tip).start  # noqa: E731
    assert jax.eval_shape(traced, 1.0).shape == jxr.design.ShapeTransform(tip).start.shape


@pytest.mark.parametrize("kind", TRANSFORMED)
def test_transform_is_the_mathematics_that_it_tells(kind):
    """p = (size / 20) W x in the order of the fields, of which a contour is made; inverse and derivative."""
    tip = TRANSFORMED[kind]
    transform = jxr.design.ShapeTransform(tip)
    size, matrix, start = map(np.asarray, (transform.size, transform.matrix, transform.start))
    numbers = lambda contour: (contour.contour if kind == "placed" else contour).free_numbers()  # noqa: E731
    free = np.concatenate([np.ravel(leaf) for leaf in numbers(tip)])
    np.testing.assert_allclose(size * matrix @ start / 20.0, free, rtol=1e-11, atol=1e-16)
    whole = np.asarray(tip.point(np.linspace(*tip.domain(), 257)))
    np.testing.assert_allclose(size, np.sqrt(np.mean(np.sum(whole**2, axis=1))), rtol=1e-9)
    x, way = start + 0.05 * np.sin(np.arange(start.size) + 1.0), np.cos(np.arange(start.size))

    @jax.jit
    def told(x, way):
        """The contour of a vector, its vector, and the derivative of its numbers along a way."""
        contour, along = jax.jvp(lambda x: numbers(transform.contour(x)), (x,), (way,))
        return transform.contour(x), transform.unknowns(transform.contour(x)), contour, along

    contour, back, found, slope = told(x, way)
    assert jax.tree.structure(contour) == jax.tree.structure(tip)
    np.testing.assert_allclose(back, x, rtol=1e-9)
    for leaves, vector in ((found, x), (slope, way)):
        flat = np.concatenate([np.ravel(leaf) for leaf in leaves])
        np.testing.assert_allclose(flat, size * matrix @ vector / 20.0, rtol=1e-11, atol=1e-16)


def test_transform_keeps_the_mirror_image():
    transform = jxr.design.ShapeTransform(jxr.Spline(violating_points(2), cells=64), symmetric=True)
    x = jnp.sin(jnp.arange(48.0)) + transform.start
    points = np.asarray(transform.contour(x).points)
    np.testing.assert_allclose(points[(-np.arange(24)) % 24] * [1.0, -1.0], points, atol=1e-18)


class Bare(Disc):
    """A disc that says of itself what does not fit."""

    free: object = eqx.field(static=True, default=None)
    factors: object = eqx.field(static=True, default=None)

    def free_numbers(self):
        return self.free(self) if self.free else [self.centre]

    def preconditioner(self, size):
        return np.asarray(self.factors) if self.factors else np.eye(2)

    def symmetrised(self):
        return jxr.Circle(self.radius)


def bare(**said):
    return Bare(jnp.asarray(0.01), jnp.zeros(2), **said)


@pytest.mark.parametrize(
    ("asked", "wanted"),
    [
        (lambda t: t(3.0), "argument tip must be a contour"),
        (lambda t: t(jxr.Line()), "tip must have ends or be closed, but was an endless Line"),
        (lambda t: t(jxr.Ellipse(0.02, 0.01).prepared()), "tip must not be prepared"),
        (lambda t: jax.jit(lambda a: t(jxr.Circle(a)).start)(0.01), "tip must be known before tracing"),
        (lambda t: t(bare(free=lambda c: [])), "must have free numbers, .* but this Bare gave none"),
        (lambda t: t(bare(free=lambda c: [2.0 * c.centre])), "but this Bare gave others"),
        (lambda t: t(bare(factors=(1.0, 2.0))), r"preconditioner of shape \(2, 2\), but .* shape \(2,\)"),
        (lambda t: t(bare(factors=((1.0, 0.0), (0.0, 0.0)))), "must have an invertible preconditioner"),
        (lambda t: t(bare(), symmetric=True), "but that of this Bare was a Circle"),
        (lambda t: t(jxr.Ellipse(0.02, 0.01), symmetric=True), "symmetric must be False for a Ellipse"),
        (lambda t: t(jxr.Ellipse(0.02, 0.01), symmetric=1), "symmetric must be True or False"),
        (lambda t: t(jxr.Ellipse(0.02, 0.01)).contour(jnp.ones(3)), "x must have shape"),
        (lambda t: t(jxr.Ellipse(0.02, 0.01)).unknowns(jxr.Circle(0.01)), "contour must be of the given"),
        (
            lambda t: t(TRANSFORMED["series"]).unknowns(jxr.SupportFunction(0.01, [0.0])),
            "contour must have 7 free numbers, as the given one has, but had 3",
        ),
    ],
)
def test_what_cannot_be_transformed_is_told_in_a_sentence(asked, wanted):
    with pytest.raises(ValueError, match=wanted):
        asked(jxr.design.ShapeTransform)


def test_what_a_class_does_not_say_of_itself_has_a_default():
    disc = Disc(jnp.asarray(0.01), jnp.array([0.003, 0.001]))
    plain = Clothoid(jnp.asarray(50.0), jnp.asarray(2e3), jnp.array([-0.01, 0.03]))
    assert [leaf.shape for leaf in plain.free_numbers()] == [(), (), (2,)]
    sizes = np.sqrt([50.0**2, 2e3**2, 5e-4, 5e-4])
    np.testing.assert_allclose(plain.preconditioner(0.02), np.diag(sizes / 0.02), rtol=1e-12)
    np.testing.assert_allclose(disc.preconditioner(0.01), np.diag([np.sqrt(5e-6) / 0.01] * 2), rtol=1e-12)
    near = plain.perturbed(np.random.default_rng(0))
    assert 0.0 < abs(float(near.bend) / 50.0 - 1.0) < 0.6 and not near.closed
    assert disc.tabled() is disc and disc.prepared() is disc
    np.testing.assert_allclose(disc.curvature(0.01), 100.0, rtol=1e-12)
    with pytest.raises(ValueError, match="argument symmetric must be False for a Clothoid"):
        plain.symmetrised()


def test_a_perturbed_spline_is_moved_by_its_first_three_waves_each_less_than_the_one_before():
    """By some 15 % of its size; over many draws the height of a wave of order k goes as 1/k."""
    points, rng = violating_points(1), np.random.default_rng(0)
    shifts = np.stack([wavy_shift(points, rng) for _ in range(400)])
    size, moved = (np.sqrt(np.mean(np.sum(x**2, axis=-1))) for x in (points, shifts))
    assert 0.13 < moved / size < 0.18
    heights = np.sqrt(np.mean(np.abs(np.fft.rfft(shifts, axis=1)) ** 2, axis=(0, 2)))
    np.testing.assert_allclose(heights[2:4] / heights[1], [1 / 2, 1 / 3], rtol=0.1)
    assert heights[4:].max() < 1e-12 * heights[1]


def test_placed_contours_are_designed_as_what_they_place():
    points = violating_points(1)
    inner = jxr.Spline(points, cells=128)
    placed = inner.moved(offset=(0.001, 0.0), angle=np.pi)
    assert placed.free_numbers()[0] is inner.points and len(placed.free_numbers()) == 1
    np.testing.assert_array_equal(placed.preconditioner(0.01), inner.preconditioner(0.01))
    np.testing.assert_array_equal(placed.symmetrised().contour.points, inner.symmetrised().points)
    pair = [c.perturbed(np.random.default_rng(0)) for c in (placed, inner)]
    np.testing.assert_array_equal(pair[0].contour.points, pair[1].points)
    image = np.asarray(inner.symmetrised().points)
    np.testing.assert_allclose(image[(-np.arange(24)) % 24] * [1.0, -1.0], image, atol=1e-18)


@pytest.mark.slow
def test_a_curve_by_its_points_is_designed_by_the_arrays_of_its_function():
    """Not by its domain, which would open it: the disc found is closed."""
    curve = lambda c, u: 0.01 * jnp.stack([jnp.cos(u), jnp.sin(u)]) + c  # noqa: E731
    tip = jxr.Parametric(
        jax.tree_util.Partial(curve, jnp.array([0.003, 0.001])), (0.0, 2 * jnp.pi), closed=True, cells=64
    )
    design = optimise_fingertip(tip, INTERVAL, limits=Limits(ahead=0.004, flat=None), steps=150)
    np.testing.assert_allclose(design.tip.function.args[0][0], -0.006, atol=1e-6)
    np.testing.assert_array_equal(design.tip.span, tip.span)


@pytest.mark.parametrize("closed", [True, False])
def test_waves_along_points_are_divided_by_their_order_squared(closed):
    """Of a closed contour's sines and cosines, and of an open one's cosines, W's factors are known."""
    count, order = 24, 3
    points = np.stack([np.linspace(0.0, 0.02, count), np.linspace(0.0, 0.01, count) ** 2], -1)
    tip = jxr.Spline(violating_points(1) if closed else points, closed=closed)
    place = np.arange(count)
    wave = np.cos(np.pi * order * place * (2 / count if closed else 1 / (count - 1)))
    known = 2.0 / (1.0 + (order if closed else order / 2.0) ** 2)
    ends = np.where((place % (count - 1) > 0) | closed, 1.0, 0.5)
    weights = np.kron(wave * ends, [1, 0])
    np.testing.assert_allclose((tip.preconditioner(0.01) @ weights)[::2], known * wave, atol=1e-12)
    series = jxr.SupportFunction(0.01, np.zeros(3), np.zeros(3)).preconditioner(0.01)
    np.testing.assert_allclose(np.diag(series), [1.0, 1.0, 0.4, 0.2, 1.0, 0.4, 0.2])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["support", "curvature"])
def test_networks_are_designed_by_their_weights(kind):
    """A small network that begins near a circle ahead of O, which violates (41)."""
    size = {"width": 8, "depth": 1, "decay": 1.0, "key": jax.random.key(0)}
    if kind == "support":
        start = jxr.NeuralSupport(PeriodicNetwork(4, amplitude=0.05, **size), 0.01, (4e-3, 0.0), cells=256)
    else:
        start = jxr.NeuralCurvature(
            PeriodicNetwork(4, amplitude=10.0, **size), 0.063, centre=(4e-3, 0.0), cells=256
        )
    design = optimise_fingertip(start, INTERVAL, limits=Limits(size=0.02, radius=0.002), steps=60)
    assert float(design.before[0]) < 0.0 < float(design.after[0])
    assert bool(design.holds[0])


def test_a_step_is_downhill_and_four_units_long_at_most():
    """Where nothing is known the gradient, at most one long; else what the inverse Hessian makes of it."""
    nothing, known = np.zeros((2, 2)), np.array([[2.0, 0.5], [0.5, 1.0]])
    for slope in ([3.0, 4.0], [0.3, -0.4]):
        slope = np.array(slope)
        wanted = -slope / max(np.hypot(*slope), 1.0)
        np.testing.assert_allclose(_direction(jnp.asarray(nothing), jnp.asarray(slope)), wanted, rtol=1e-15)
        way = -known @ slope
        wanted = way * min(1.0, 4.0 / np.hypot(*way))
        np.testing.assert_allclose(_direction(jnp.asarray(known), jnp.asarray(slope)), wanted, rtol=1e-14)


def test_what_a_step_teaches_of_the_inverse_hessian():
    """The formula of Broyden, Fletcher, Goldfarb and Shanno; the first time from a multiple of one."""
    step, change = np.array([0.3, -0.2]), np.array([1.0, 0.4])
    along = step @ change
    left = np.eye(2) - np.outer(step, change) / along
    for before in (np.zeros((2, 2)), np.array([[2.0, 0.5], [0.5, 1.0]])):
        start = before if before.any() else np.eye(2) * along / (change @ change)
        wanted = left @ start @ left.T + np.outer(step, step) / along
        found = _learnt(*map(jnp.asarray, (before, step, change)))
        np.testing.assert_allclose(found, wanted, rtol=1e-13)
        np.testing.assert_allclose(found @ change, step, rtol=1e-13)
    known = jnp.array([[2.0, 0.5], [0.5, 1.0]])
    for share, useful in ((0.7e-10, False), (1.5e-10, True), (-1.0, False)):
        change = jnp.array([share, 1.0]) * 5.0
        assert bool(jnp.any(_learnt(known, jnp.array([3.0, 0.0]), change) != known)) == useful


def standing(**changes):
    """A walk whose next trial is half a unit off along (0.6, -0.8), where the slope promises 0.7 per unit."""
    walk = {"x": [1.0, 2.0], "cost": 3.0, "slope": [-0.1, 0.8], "trial": [1.3, 1.6], "share": 1.0}
    walk |= {"memory": [[0.4, 0.1], [0.1, 0.3]]} | changes
    return Walk(**{name: jnp.asarray(value, float) for name, value in walk.items()})


onwards = eqx.filter_jit(lambda walk, cost, slope: Bfgs().ahead(walk, cost, slope, None))
shorter = eqx.filter_jit(Bfgs()._shorter)
after_chunk = eqx.filter_jit(lambda search: _minimise._judged(Bfgs(), search))
with_point = eqx.filter_jit(_minimise._kept)


def ahead(walk, cost, slope=(-0.05, 0.3)):
    return onwards(walk, jnp.asarray(cost, float), jnp.asarray(slope, float))


def test_a_trial_is_taken_if_it_brings_a_ten_thousandth_of_what_was_promised():
    promise = -0.35
    for share, wanted in ((0.7e-4, False), (1.5e-4, True), (0.5, True), (-0.5, False)):
        walk, taken = ahead(standing(), 3.0 + share * promise)
        assert bool(taken) == wanted
        np.testing.assert_allclose(walk.x, [1.3, 1.6] if wanted else [1.0, 2.0])
    for cost, slope in ((np.nan, (0.0, 1.0)), (-np.inf, (0.0, 1.0)), (0.0, (np.nan, 1.0))):
        walk, taken = ahead(standing(), cost, slope)
        assert not taken and float(walk.cost) == 3.0
    again, taken = ahead(Bfgs().again(standing()), 7.0)
    assert taken and float(again.cost) == 7.0 and np.array_equal(again.x, [1.0, 2.0])
    np.testing.assert_array_equal(again.memory, standing().memory)  # nothing was learnt
    begun = Bfgs().begin(jnp.array([5.0, 6.0]))
    assert np.isinf(begun.cost) and np.array_equal(begun.trial, [5.0, 6.0]) and float(begun.share) == 1.0
    assert not begun.memory.any() and not begun.slope.any()


def test_after_a_trial_that_was_taken_the_next_step_is_that_of_what_was_learnt():
    walk, slope = standing(), np.array([-0.05, 0.3])
    found, _ = ahead(walk, 2.7, slope)
    way = np.array([0.3, -0.4])
    known = _learnt(walk.memory, jnp.asarray(way), jnp.asarray(slope - [-0.1, 0.8]))
    np.testing.assert_allclose(found.memory, known, rtol=1e-14)
    np.testing.assert_allclose(found.trial, np.array([1.3, 1.6]) - known @ slope, rtol=1e-14)
    np.testing.assert_array_equal(found.slope, slope)
    assert float(found.share) == 1.0 and float(found.cost) == 2.7
    # The slope along the step has fallen: nothing is learnt, and the next step is twice as long at least.
    bent, _ = ahead(walk, 2.5, (-0.2, 1.2))
    np.testing.assert_array_equal(bent.memory, walk.memory)
    usual = -np.asarray(walk.memory) @ [-0.2, 1.2]
    np.testing.assert_allclose(bent.trial - bent.x, usual / np.linalg.norm(usual), rtol=1e-14)


def test_a_step_onwards_is_as_long_as_asked_for_within_four_units_and_downhill():
    onward = lambda known, least: Bfgs()._onward(  # noqa: E731
        *map(jnp.asarray, (np.zeros(2), 1.0, np.array([0.0, 2.0]), np.array(known), least))
    )
    down = [[1.0, 0.0], [0.0, 0.25]]
    for least, wanted in ((0.0, 0.5), (0.3, 0.5), (3.0, 3.0), (9.0, 4.0)):
        np.testing.assert_allclose(onward(down, least).trial, [0.0, -wanted])
    up = onward([[1.0, 0.0], [0.0, -0.25]], 0.0)
    np.testing.assert_allclose(up.trial, [0.0, -1.0])
    assert not up.memory.any() and onward(down, 0.0).memory.any()
    still = Bfgs()._onward(*map(jnp.asarray, (np.ones(2), 1.0, np.zeros(2), np.array(down), 0.0)))
    np.testing.assert_array_equal(still.trial, np.ones(2))


def test_a_trial_that_was_not_taken_is_followed_by_one_at_the_bottom_of_a_parabola():
    """Of the cost at both ends and the slope at the first, but from a tenth to a half of the way."""
    promise = -0.35
    for rise, share in ((0.35, 0.25), (-0.1, 0.5), (5.0, 0.1), (np.nan, 0.1), (np.inf, 0.1)):
        found = shorter(standing(share=0.2), jnp.asarray(3.0 + rise), jnp.asarray(promise))
        assert float(found.share) == pytest.approx(0.2 * share)
        np.testing.assert_allclose(found.trial, [1.0 + 0.3 * share, 2.0 - 0.4 * share], rtol=1e-14)
        assert float(found.cost) == 3.0 and np.array_equal(found.memory, standing().memory)
    # A millionth of the first step is none: the gradient is followed.
    for share, spent in ((1.6e-5, False), (0.9e-5, True)):
        found = shorter(standing(share=share), jnp.asarray(8.0), jnp.asarray(promise))
        if spent:
            np.testing.assert_allclose(found.trial, [1.1, 1.2], rtol=1e-14)
            assert float(found.share) == 1.0 and not found.memory.any()
        else:
            assert float(found.share) == pytest.approx(0.1 * share) and found.memory.any()


def test_methods_of_optax_take_what_they_propose():
    """Plain descent; to where there is no number half of the way is taken back."""
    method = Optax(optax.with_extra_args_support(optax.sgd(0.5)))
    walk = Walk(*map(jnp.asarray, ([1.0, 2.0], 3.0, [0.0, 0.0], [1.4, 1.8], 1.0)), method.fresh(jnp.ones(2)))
    found, taken = method.ahead(walk, jnp.asarray(2.0), jnp.array([0.2, -1.0]), None)
    assert taken and float(found.cost) == 2.0
    np.testing.assert_allclose(found.x, [1.4, 1.8])
    np.testing.assert_allclose(found.trial, [1.3, 2.3])
    for cost, slope in ((np.nan, [0.2, -1.0]), (2.0, [np.inf, 1.0])):
        back, taken = method.ahead(walk, jnp.asarray(cost), jnp.asarray(slope), None)
        assert not taken and float(back.cost) == 3.0
        np.testing.assert_allclose(back.x, [1.0, 2.0])
        np.testing.assert_allclose(back.trial, [1.2, 1.9])


def a_search(**changes):
    """A search that has settled in the last chunk but one, with one limit of two that is kept."""
    start = Bfgs().begin(jnp.array([1.0, 2.0]))
    walk = eqx.tree_at(lambda w: w.memory, start, jnp.eye(2))
    found = {"value": 5.0, "excess": [-0.2, 1e-8], "multipliers": [0.5, 0.25], "weight": 20.0}
    found |= {"sharpness": 1.0, "best": [3.0, 4.0], "lowest": 4.0, "violation": 0.0, "last": 5.0}
    found |= {"passed": 1e-8, "calm": 1, "done": False} | changes
    return Search(walk=walk, **{name: jnp.asarray(np.asarray(value)) for name, value in found.items()})


def judged(**changes):
    return after_chunk(a_search(**changes))


def test_multipliers_and_weight_after_a_chunk():
    """Multipliers follow the slopes of the penalty; the weight grows where they alone do not bring it in."""
    found = judged(excess=[-0.2, 0.3], passed=0.4)
    np.testing.assert_allclose(found.multipliers, [0.0, 6.25])
    assert float(found.weight) == 60.0 and float(found.passed) == 0.3
    assert float(judged(excess=[-0.2, 0.3], passed=0.61).weight) == 20.0
    assert float(judged(excess=[-0.2, 0.3], passed=0.59).weight) == 60.0
    assert float(judged(excess=[0.3, -0.2], passed=0.4, weight=5e4).weight) == 1e5
    assert float(judged(excess=[0.3, -0.2], passed=0.4, weight=2e4).weight) == 6e4
    for worst, weight in ((0.7e-7, 20.0), (1.5e-7, 60.0)):
        assert float(judged(excess=[worst, -1.0], passed=0.0).weight) == weight
    assert float(judged(excess=[-0.2, -0.3]).passed) == 0.0
    np.testing.assert_allclose(judged(excess=[np.inf, -0.01]).multipliers, [0.0, 0.05])
    first = _minimise._begin(half_disc, Bfgs(), jnp.array([[1.0, 2.0]]), jnp.zeros((1, 2)))
    assert float(first.weight[0]) == 10.0 and first.excess.shape == (1, 2)
    assert all(np.isinf(x[0]) for x in (first.value, first.lowest, first.violation, first.last, first.passed))
    assert int(first.calm[0]) == 0 and not first.done[0] and not first.multipliers.any()


def test_a_search_has_settled_when_nothing_changed_in_two_chunks_within_the_limits():
    assert bool(judged().done) and bool(judged(done=True, calm=0).done)
    assert not judged(calm=0).done and int(judged(calm=0).calm) == 1
    for name in ("violation", "excess"):
        for size, done in ((0.7e-7, True), (1.5e-7, False)):
            assert bool(judged(**{name: [size, -1.0] if name == "excess" else size}).done) == done
    for away, calm in ((0.7 * 6e-9, 2), (1.5 * 6e-9, 0), (-0.7 * 6e-9, 2), (-1.5 * 6e-9, 0)):
        found = judged(last=5.0 + away)
        assert int(found.calm) == calm and bool(found.done) == (calm == 2) and float(found.last) == 5.0
        # What stands still forgets what it has learnt.
        assert bool(found.walk.memory.any()) == (calm == 0)
    for sharpness, then in ((0.4, 0.8), (0.6, 1.0), (1.0, 1.0)):
        found = judged(sharpness=sharpness)
        assert float(found.sharpness) == then and bool(found.done) == (sharpness == 1.0)


@pytest.mark.parametrize(
    ("was", "value", "excess", "better"),
    [
        ((4.0, 0.0), 3.0, -1.0, True),
        ((4.0, 0.0), 5.0, -1.0, False),
        ((4.0, 0.0), 3.0, 1e-3, False),
        ((4.0, 0.0), 3.0, 0.7e-7, True),
        ((4.0, 0.0), 3.0, 1.5e-7, False),
        ((4.0, 0.2), 5.0, 0.1, True),
        ((4.0, 0.2), 3.0, 0.3, False),
        ((4.0, 0.2), 3.0, 0.2, False),
        ((4.0, 1.5e-7), 5.0, 0.7e-7, True),
        ((4.0, 0.2), np.nan, -1.0, False),
        ((4.0, 0.0), -np.inf, -1.0, False),
    ],
)
def test_the_best_point_is_the_lowest_within_the_limits_or_the_one_nearest_to_them(
    was, value, excess, better
):
    search = a_search(lowest=was[0], violation=was[1])
    found = with_point(search, jnp.asarray(value), jnp.array([-2.0, excess]))
    np.testing.assert_array_equal(found.best, [1.0, 2.0] if better else [3.0, 4.0])
    assert float(found.lowest) == (value if better else was[0])
    assert float(found.violation) == (max(excess, 0.0) if better else was[1])


def test_a_search_takes_chunks_of_ten_steps_until_all_have_settled():
    """Sharpness begins at a twentieth and doubles to one; the multipliers are those of the chunk before."""
    sharp = lambda x, data, sharpness: (sharpness * (1.0 + jnp.sum(x) ** 2), -jnp.ones(1))  # noqa: E731
    found = minimise(sharp, jnp.array([[3.0, -1.0]]), jnp.zeros(1), steps=11)
    assert found.steps == 20 and found.history.shape == (1, 20)
    np.testing.assert_allclose(found.history[0, [9, 19]], [0.05, 0.1], rtol=1e-6)
    assert float(found.search.sharpness[0]) == pytest.approx(0.2)


def test_margins_go_on_through_flat_and_hollow_places():
    """Of a contour of size a, below a curvature of 1/(50 a) with the same value and slope, and bounded."""
    scale, least = 0.02, 1.0 / (50.0 * 0.02)
    bends = np.array([50.0, 1.1, 0.9, 0.0, -3.0, -1e6]) * [1.0, *[least] * 5]
    point, tangent = Vec2(0.003, -0.002), Vec2(0.6, 0.8)
    frames = Frenet2(point, tangent, jnp.asarray(bends))
    reach = 0.8 * 0.003 + 0.6 * 0.002  # along the outward normal (0.8, -0.6)
    below = (2.0 - 1.0 / (2.0 - bends[2:] / least)) / least
    wanted = np.concatenate([1.0 / bends[:2], below]) - reach
    np.testing.assert_allclose(margins(frames, scale), wanted, rtol=1e-12)


def test_the_smooth_least_of_some_values():
    values = np.array([0.3, 0.25, 0.9])
    wanted = -np.log(np.sum(np.exp(-20.0 * values))) / 20.0
    assert float(soft_least(jnp.asarray(values), 20.0)) == pytest.approx(wanted, rel=1e-12)
    assert float(soft_least(jnp.asarray(values) + 1e3, 20.0)) == pytest.approx(wanted + 1e3, rel=1e-12)


@pytest.mark.parametrize("interval", [(-0.03, 0.01), (0.0, 0.0401), (0.01, 0.01), (0.02, 0.01)])
def test_an_interval_rises_and_lies_on_its_contour(interval):
    """Ends included; on a closed contour it may lie anywhere, but is no longer than once round."""
    arc = jxr.Catenary(0.025, (-0.02, 0.04))
    with pytest.raises(ValueError, match="argument interval must (be increasing|lie on the contour)"):
        check_interval(arc, interval)
    np.testing.assert_array_equal(check_interval(arc, (-0.02, 0.04)), [-0.02, 0.04])
    disc = jxr.Circle(0.001)
    for round_ in ((-0.009, -0.003), (-0.001 * np.pi, 0.001 * np.pi)):
        np.testing.assert_array_equal(check_interval(disc, round_), round_)
    with pytest.raises(
        ValueError, match="^argument interval must be no longer than the contour, 0.00628319 m"
    ):
        check_interval(disc, (-4.0, 4.0))  # in millimetres


def test_in_which_words_a_limit_is_kept():
    assert [_design._kept(x) for x in (np.nan, 1.5e-7, 0.7e-7, -0.7e-4, -1.5e-4, -0.25)] == [
        "not finite",
        "passed by 1.5e-05 %",
        "met exactly",
        "met exactly",
        "kept, 0.015 % to spare",
        "kept, 25 % to spare",
    ]
    assert _design._figure_in_millimetres("size [m]", (0.1, -0.2)) == ("size [mm]", (100.0, -200.0))
    assert _design._figure_in_millimetres("force [N m]", (0.1, 0.2)) == ("force [N m]", (0.1, 0.2))


@pytest.mark.parametrize(
    ("violation", "done", "chosen", "result"),
    [
        ([0.0, 0.7e-7, 0.0, 0.3], [True, True, False, True], 1, "successful"),
        ([0.0, 1.5e-7, 0.0, 0.3], [True, True, False, True], 2, "max_steps_reached"),
        ([0.0, 1.0, 1.0, 0.3], [True, True, False, True], 0, "successful"),
        ([0.9, 0.5, 0.2, 0.3], [True, True, True, True], 2, "infeasible"),
    ],
)
def test_the_start_that_is_chosen(monkeypatch, violation, done, chosen, result):
    """The lowest within the limits; where none is, the one that passes them least."""
    lowest, merit = np.array([4.0, 1.0, 2.0, 0.5]), "rate [1/s]"
    circles = jax.vmap(jxr.Circle)(jnp.array([0.01, 0.02, 0.03, 0.04]))
    arrays, rest = eqx.partition(circles, eqx.is_inexact_array)

    def outcomes(problem, x, data):
        before = x == "start"
        figures = {"size [m]": jnp.arange(4.0) + before, merit: 10.0 * jnp.arange(1.0, 5.0) - 30.0 * before}
        return arrays, figures, {"length": jnp.arange(4.0) - 0.5}

    monkeypatch.setattr(_fingertip, "_outcomes", outcomes)
    goal = SimpleNamespace(merit=merit, reached=lambda figures: figures[merit] > 15.0)
    problem = SimpleNamespace(goal=goal, rest=rest, interval=jnp.zeros(2))
    search = SimpleNamespace(violation=np.array(violation), lowest=lowest, done=np.array(done), best="best")
    found = _fingertip._design(
        problem, "start", None, SimpleNamespace(search=search, history=np.zeros((4, 10)))
    )
    assert found.chosen == chosen and repr(found.result) == result
    assert list(found.figures) == [merit, "size [m]"]
    assert found.figures[merit] == (10.0 * (chosen + 1) - 30.0, 10.0 * (chosen + 1))
    assert found.parts == {"length": chosen - 0.5} and float(found.tip.radius) == 0.01 * (chosen + 1)
    inside = np.array(violation) <= 1e-7
    np.testing.assert_array_equal(found.holds, inside & (np.arange(4) > 0))
    np.testing.assert_array_equal(found.before, [-20.0, -10.0, 0.0, 10.0])


def test_limits_by_default_are_shares_of_the_first_start(monkeypatch):
    """Of its largest distance from O; and each start has its own size."""
    asked = []
    monkeypatch.setattr(
        _fingertip, "minimise", lambda problem, start, data, **rest: asked.append((problem, data, rest))
    )
    monkeypatch.setattr(_fingertip, "_design", lambda *args: None)
    tips = [jxr.Circle(0.01).moved((0.002, 0.0)), jxr.Circle(0.02).moved((0.001, 0.0))]
    optimise_fingertip(tips, INTERVAL)
    (problem, (arrays, sizes), rest) = asked[0]
    limits = problem.limits
    found = [float(x) for x in (limits.size, limits.radius, limits.ahead, limits.flat)]
    np.testing.assert_allclose(found, [0.012, 0.0012, 0.006, 0.1], rtol=1e-9)
    assert limits.length is None and limits.steepness is None and rest["in_turn"] is False
    np.testing.assert_allclose(sizes, np.hypot([0.01, 0.02], [0.002, 0.001]), rtol=5e-3)
