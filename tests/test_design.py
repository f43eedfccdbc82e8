"""Fingertips for condition (41): an analytic optimum, violating starts, limits that exclude it."""

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
from jaxroll.design import Limits, optimise_fingertip
from jaxroll.design._limits import sampled
from jaxroll.design._minimise import minimise
from jaxroll.geometry import Frenet2, PeriodicNetwork
from jaxroll.geometry.contours._free_numbers import wavy_shift
from tests.subjects.fingertips import INTERVAL, violating_points


def half_disc(x, centre, sharpness):
    """Squared distance from a centre, on the upper half of the unit disc."""
    return jnp.sum((x - centre) ** 2), jnp.stack([jnp.dot(x, x) - 1.0, -x[1]])


@pytest.mark.parametrize("options", [{}, {"in_turn": True}, {"optimiser": optax.lbfgs()}])
def test_minimiser_on_a_problem_by_hand(options):
    """Nearest points of a half disc: on its rim, in its corner, inside."""
    centres = jnp.array([[3.0, 4.0], [2.0, -1.0], [0.1, 0.2]])
    found = minimise(half_disc, jnp.full((3, 2), 0.1), centres, steps=200, **options)
    nearest = [[0.6, 0.8], [1.0, 0.0], [0.1, 0.2]]
    np.testing.assert_allclose(found.search.best, nearest, atol=2e-7)
    assert bool(found.search.done.all()) and found.steps <= 200


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
    found = limits.excess(sampled(contour, pad))
    assert sorted(found) == ["flat", "length", "radius", "size", "steepness"]
    assert float(found["size"].max()) == pytest.approx(0.03 / 0.02 - 1.0)
    assert float(found["length"].max()) == pytest.approx(0.04 / 0.05 - 1.0)
    assert float(found["radius"].max()) == pytest.approx(most * 0.004 - 1.0)
    assert float(found["steepness"].max()) == pytest.approx(2e3 / 500.0 - 1.0)
    least = min(side * (50.0 + 2e3 * s) for s in (0.0, 0.02))
    assert float(found["flat"].max()) == pytest.approx(1.0 - least * 0.05)
    convex = Limits(flat=None).excess(sampled(contour, pad))["convex"]
    assert float(convex.max()) == pytest.approx(-least * 0.04)


def test_ellipse_has_the_analytic_optimum():
    """As long as allowed and as sharp at its ends: both limits fix both half axes."""
    length, radius = 0.1, 0.004
    limits = Limits(length=length, radius=radius, flat=None)
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
    limits = Limits(length=0.04, radius=0.008, flat=None)
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
    limits = Limits(size=0.03, radius=0.002, ahead=0.008, flat=0.05)
    design = optimise_fingertip(jxr.Ellipse(0.012, 0.012), (-0.001, 0.001), limits=limits, steps=200)
    a, b = float(design.tip.a), float(design.tip.b)
    np.testing.assert_allclose([a, b**2 / a], [0.008, 0.02 / 0.008 * 0.02], rtol=2e-2)


def test_goes_on_from_a_checkpoint(tmp_path):
    limits = Limits(length=0.1, radius=0.004, flat=None)
    options = {"limits": limits, "checkpoint": tmp_path / "design.eqx"}
    optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, steps=20, **options)
    seen = []
    report = lambda step, value, violation: seen.append(step)  # noqa: E731
    whole = optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, steps=40, progress=report, **options)
    assert seen == [30, 40]
    straight = optimise_fingertip(jxr.Ellipse(0.02, 0.01), INTERVAL, steps=40, limits=limits)
    np.testing.assert_array_equal(whole.history, straight.history)


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
    "spline": jxr.Spline(violating_points(1), cells=64),
    "series": jxr.SupportFunction(0.01, [1e-3, 0.0, 5e-4], [0.0, 2e-4, 0.0], cells=64),
    "ellipse": jxr.Ellipse(0.02, 0.014),
    "placed": jxr.Spline(violating_points(1), cells=64).moved((0.001, 0.0), 0.1),
    "own": Disc(jnp.asarray(0.01), jnp.array([0.003, 0.001])),
}


@pytest.mark.parametrize("kind", TRANSFORMED)
def test_transform_is_the_mathematics_that_it_tells(kind):
    """p = (size / 20) W x in the order of the fields, its inverse, and its derivative against differences."""
    tip = TRANSFORMED[kind]
    transform = jxr.design.ShapeTransform(tip)
    inner = tip.contour if kind == "placed" else tip
    free = [np.ravel(leaf) for leaf in inner.free_numbers()]
    found = transform.size * transform.matrix @ transform.start / 20.0
    np.testing.assert_allclose(found, np.concatenate(free), rtol=1e-11, atol=1e-16)
    whole = np.asarray(tip.point(jnp.linspace(*tip.domain(), 257)))
    np.testing.assert_allclose(transform.size, np.sqrt(np.mean(np.sum(whole**2, axis=1))), rtol=1e-9)
    x = transform.start + 0.05 * jnp.sin(jnp.arange(transform.start.size) + 1.0)
    np.testing.assert_allclose(transform.unknowns(transform.contour(x)), x, rtol=1e-9)
    assert jax.tree.structure(transform.contour(x)) == jax.tree.structure(tip)

    def radius(x):
        return 1.0 / transform.contour(x).curvature(0.002)

    way = jnp.cos(jnp.arange(x.size))
    central = (radius(x + 1e-3 * way) - radius(x - 1e-3 * way)) / 2e-3
    np.testing.assert_allclose(jnp.vdot(jax.grad(radius)(x), way), central, rtol=1e-4, atol=1e-12)


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
    placed = inner.moved(offset=(0.001, 0.0), angle=0.1)
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
