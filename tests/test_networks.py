"""Support functions and networks: closed forms, closure, arclength, gradients, refusals, fits."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll.geometry import frenet, PeriodicNetwork
from jaxroll.geometry.contours._support import _feet
from tests.measures import both_slopes, taylor_remainders

A, B = 0.01, 0.007
TURN = 2.0 * np.pi


def network(amplitude, harmonics=3):
    return PeriodicNetwork(harmonics, width=6, key=jax.random.key(3), amplitude=amplitude)


def test_a_network_has_the_features_that_its_docstring_tells():
    """k^-p cos(k phi) and k^-p sin(k phi) for k = 1 to 4, by default with p = 0: eight numbers in."""
    assert PeriodicNetwork(key=jax.random.key(0)).layers[0].in_features == 8


MADE = {
    "support": lambda: jxr.SupportFunction(0.01, [1e-3, 5e-4, 3e-4], [-2e-3, 0.0, 2e-4], cells=512),
    "neural support": lambda: jxr.NeuralSupport(network(0.2), 0.01, (1e-3, -2e-3), cells=512),
    "neural curvature": lambda: jxr.NeuralCurvature(network(40.0), 0.06, 0.3, (1e-3, 2e-3), cells=512),
}


@functools.cache
def field_named(name):
    return MADE[name]()


@pytest.fixture(scope="module", params=MADE)
def field(request):
    return field_named(request.param)


def ellipse(count, a=A, b=B):
    u = TURN * np.arange(count) / count
    return np.stack([a * np.cos(u), b * np.sin(u)], -1)


def bean(count):
    """39 mm long, hollow on one side."""
    u = TURN * np.arange(count) / count
    x, y = 0.0195 * np.cos(u), 0.012 * np.sin(u)
    return np.stack([x, y - 0.006 * np.cos(u) ** 2 + 15 * y * x**2 / 0.12], -1)


def height(angle, a=A, b=B):
    return np.sqrt((a * np.cos(angle)) ** 2 + (b * np.sin(angle)) ** 2)


@jax.jit
def by_autodiff(ready, s):
    return frenet(ready.curve, s), ready.frame(s)


def samples(field, count=997):
    return np.linspace(-0.01, float(field.domain()[1]) + 0.01, count)


def test_frame_is_autodiff_of_the_point_at_unit_speed(field):
    auto, read = by_autodiff(field.prepared(), samples(field))
    speed = np.hypot(auto.tangent.x, auto.tangent.y)
    np.testing.assert_allclose(speed, 1.0, atol=1e-10)
    np.testing.assert_allclose(auto.tangent.array(), read.tangent.array(), atol=1e-10)
    np.testing.assert_allclose(auto.curvature, read.curvature, rtol=1e-8, atol=1e-7)


def test_closes_and_turns_once_counter_clockwise(field):
    length = float(field.domain()[1])
    s = length * np.arange(4000) / 4000
    points, tangents = np.asarray(field.point(s)), np.asarray(field.tangent(s))
    np.testing.assert_allclose(field.point(length), points[0], atol=1e-15)
    np.testing.assert_allclose(field.curvature(s).mean() * length, TURN, rtol=1e-9)
    np.testing.assert_allclose(tangents.mean(axis=0), 0.0, atol=1e-10)
    area = 0.5 * length * np.mean(points[:, 0] * tangents[:, 1] - points[:, 1] * tangents[:, 0])
    assert area > 1e-4


def test_table_is_as_good_as_it_says(field):
    error = field.table_error()
    assert error.point < 1e-14
    assert error.tangent < 1e-9
    assert error.curvature < 1e-4


def test_the_run_never_sees_the_network(field):
    """The frame of a prepared field is one gather and arithmetic: as many operations for each."""
    program = jax.make_jaxpr(lambda f, s: f.frame(s))(field.prepared(), 0.01)
    count = [str(program).count(name) for name in ("gather", "tanh", "dot_general", "fft", "while")]
    assert count == [count[0], 0, 0, 0, 0]
    assert len(program.eqns) < 160


def test_a_constant_support_function_is_the_circle():
    field, circle = jxr.SupportFunction(0.01), jxr.Circle(0.01)
    s = samples(field)
    np.testing.assert_allclose(field.point(s), circle.point(s), atol=1e-16)
    np.testing.assert_allclose(field.curvature(s), 100.0, rtol=1e-8)
    assert float(field.margin()) == 0.0


def test_first_harmonic_shifts_and_arclength_is_the_integral():
    """Against the definition: h n + h' n' at the arclength that a quadrature of h + h'' gives."""
    field = field_named("support")
    angle = np.linspace(0.0, TURN, 20001)
    a, b = np.asarray(field.cosines), np.asarray(field.sines)
    k = np.arange(1, 4)[:, None]
    h = 0.01 + a @ np.cos(k * angle) + b @ np.sin(k * angle)
    slope = (b * [1, 2, 3]) @ np.cos(k * angle) - (a * [1, 2, 3]) @ np.sin(k * angle)
    half = np.linspace(0.0, TURN, 40001)
    rho = 0.01 + (a * [0, -3, -8]) @ np.cos(k * half) + (b * [0, -3, -8]) @ np.sin(k * half)
    s = np.concatenate([[0.0], np.cumsum(rho[:-2:2] + 4 * rho[1::2] + rho[2::2])]) * angle[1] / 6
    rho = rho[::2]
    n = np.stack([np.cos(angle), np.sin(angle)], -1)
    t = np.stack([-n[:, 1], n[:, 0]], -1)
    np.testing.assert_allclose(field.point(s), h[:, None] * n + slope[:, None] * t, atol=1e-14)
    np.testing.assert_allclose(field.normal(s), n, atol=1e-10)
    np.testing.assert_allclose(field.curvature(s), 1 / rho, rtol=1e-7)
    np.testing.assert_allclose(field.support(angle), h, rtol=1e-14)
    centre = jxr.SupportFunction(0.01, [3e-3], [4e-3]).point(0.0)
    np.testing.assert_allclose(centre, [0.013, 0.004], atol=1e-16)


def test_neural_support_is_the_network_s_own():
    """Against derivatives of the network by autodiff, which the field itself doesn't take."""
    field = field_named("neural support")

    def h(angle):
        across = field.centre[0] * jnp.cos(angle) + field.centre[1] * jnp.sin(angle)
        return field.radius * (1 + field.network(angle)) + across

    angle = jnp.linspace(0.0, TURN, 4001)
    value, slope, bend = (jax.jit(jax.vmap(f))(angle) for f in (h, jax.grad(h), jax.grad(jax.grad(h))))
    rho = np.asarray(value + bend)
    s = np.concatenate([[0.0], np.cumsum(0.5 * (rho[1:] + rho[:-1]))]) * float(angle[1])
    n = np.stack([np.cos(angle), np.sin(angle)], -1)
    t = np.stack([-n[:, 1], n[:, 0]], -1)
    points = np.asarray(value)[:, None] * n + np.asarray(slope)[:, None] * t
    np.testing.assert_allclose(field.point(s), points, atol=1e-8)
    np.testing.assert_allclose(field.curvature(s), 1 / rho, rtol=2e-5)
    np.testing.assert_allclose(float(field.smallest_radius()), rho.min(), rtol=1e-6)
    np.testing.assert_allclose(field.domain()[1], s[-1], rtol=1e-9)


def test_curvature_is_the_network_where_symmetry_closes_it():
    """A network of 2 phi alone has half a turn's symmetry: nothing is left to correct."""
    whole = network(30.0, harmonics=2)
    first = whole.layers[0].weight.at[:, jnp.array([0, 2])].set(0.0)
    field = jxr.NeuralCurvature(eqx.tree_at(lambda n: n.layers[0].weight, whole, first), 0.06, cells=512)
    phase = TURN * np.arange(256) / 256
    values = np.asarray(field.network.values(phase))
    assert np.ptp(values) > 1.0
    expected = (TURN + values - values.mean()) / 0.06
    np.testing.assert_allclose(field.curvature(0.06 * phase / TURN), expected, rtol=1e-7)
    assert float(field.closure()) < 1e-16


def test_closure_is_exact_for_wild_weights():
    field = field_named("neural curvature")
    values = np.asarray(field.network.values(TURN * np.arange(512) / 512))
    turned = TURN * np.arange(512) / 512 + np.cumsum(values - values.mean()) / 512
    assert abs(np.mean(np.exp(1j * turned))) > 0.01  # a gap of 0.6 mm without the correction
    assert float(field.closure()) < 1e-16
    assert float(np.min(field.curvature(samples(field)))) < 0.0


def heights(fit, angle):
    """h at angles, in NumPy."""
    k = np.arange(1, 1 + len(fit.cosines))[:, None] * angle
    return float(fit.radius) + np.asarray(fit.cosines) @ np.cos(k) + np.asarray(fit.sines) @ np.sin(k)


def test_ellipse_converges_spectrally():
    angle = np.linspace(0.0, TURN, 400)
    fits = [jxr.SupportFunction.through(ellipse(120), terms=m) for m in (4, 8, 12, 24)]
    errors = [np.abs(heights(fit, angle) - height(angle)).max() for fit in fits]
    # A factor of the same size for every four terms, then nothing but rounding.
    assert errors[0] < 1e-5
    assert all(low < 0.03 * high for high, low in zip(errors[:2], errors[1:3], strict=True))
    assert errors[3] < 1e-12
    s = samples(fits[3])
    exact = jxr.Ellipse(A, B)
    np.testing.assert_allclose(fits[3].point(s), exact.point(s), atol=1e-11)
    np.testing.assert_allclose(fits[3].curvature(s), exact.curvature(s), rtol=1e-6)


def test_fit_needs_no_order_and_averages_noise():
    rng = np.random.default_rng(0)
    points = rng.permutation(ellipse(400) + (0.05, -0.02)) + 1e-5 * rng.standard_normal((400, 2))
    fit = jxr.SupportFunction.through(points, terms=6)
    np.testing.assert_allclose([fit.cosines[0], fit.sines[0]], [0.05, -0.02], atol=5e-6)
    angle = np.linspace(0.0, TURN, 400)
    centred = np.asarray(fit.support(angle)) - 0.05 * np.cos(angle) + 0.02 * np.sin(angle)
    assert np.sqrt(np.mean((centred - height(angle)) ** 2)) < 4e-6


@pytest.mark.parametrize("radius", [2.0, 0.3, 5e-4])
def test_feet_on_a_circle_lie_in_the_directions_of_the_points(radius):
    """However near to the centre, where every direction is a foot: there the start is kept."""
    angles = TURN * np.arange(7) / 7
    points = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    np.testing.assert_allclose(_feet(points, np.array([1.0, 0.0, 0.0]), angles), angles, rtol=1e-12)


@pytest.mark.parametrize("name", ["support", "neural support"])
def test_margin_is_the_smallest_second_derivative(name):
    field = field_named(name)
    angle = np.linspace(0.4, 1.9, 1501)
    step = 1e-3
    bend = (field.support(angle + step) - 2 * field.support(angle) + field.support(angle - step)) / step**2
    np.testing.assert_allclose(float(field.margin(0.4, 1.9)), float(bend.min()), atol=1e-7)


def test_margin_of_a_shifted_circle_and_its_gradient():
    """h = r + a cos phi: h'' = -a cos phi, positive on the far side alone."""

    def margin(a):
        return jxr.SupportFunction(0.01, jnp.reshape(a, 1), [0.0]).margin(2.5, 3.5)

    np.testing.assert_allclose(margin(2e-3), -2e-3 * np.cos(2.5), rtol=1e-12)
    np.testing.assert_allclose(jax.grad(margin)(2e-3), -np.cos(2.5), rtol=1e-12)


@pytest.mark.parametrize("ends", [(0.3, 1.2), (-0.2, 1.7), (1.8, 2.5), (-2.9, -1.8), (1.0, 5.9)])
def test_margin_moves_with_the_end_at_which_it_lies(ends):
    """h = r + a cos phi + b cos 2 phi: the least h'' = -a cos phi - 4 b cos 2 phi, at an end or inside."""
    a, b = 2e-3, 1e-4
    bend = lambda x: -a * np.cos(x) - 4 * b * np.cos(2 * x)  # noqa: E731
    slope = lambda x: a * np.sin(x) + 8 * b * np.sin(2 * x)  # noqa: E731
    least = np.argmin([bend(ends[0]), bend(ends[1]), bend(np.linspace(*ends, 10001)[1:-1]).min()])
    wanted = [slope(ends[0]) if least == 0 else 0.0, slope(ends[1]) if least == 1 else 0.0]
    found = jax.grad(jxr.SupportFunction(0.01, [a, b], [0.0, 0.0]).margin, argnums=(0, 1))(*ends)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-15)


WHERE = {
    "support": (lambda f: f.cosines, lambda x: x.at[1].set(1e-3)),
    "neural support": (lambda f: f.network.layers[1].weight, lambda x: x.at[2, 3].set(1.0)),
    "neural curvature": (lambda f: f.network.layers[1].weight, lambda x: x.at[2, 3].set(1.0)),
}


@functools.cache
def probe(name):
    field, (where, _) = field_named(name), WHERE[name]
    coarse = eqx.tree_at(
        lambda f: f.radius if hasattr(f, "radius") else f.length, field, replace_fn=jnp.asarray
    )

    def value(x):
        frame = eqx.tree_at(where, coarse, x).tabulate(64).frame(jnp.asarray(0.0137))
        return frame.point.x / 0.01 + frame.tangent.y + frame.curvature / 100.0

    return value


@pytest.mark.parametrize("name", WHERE)
def test_gradient_through_the_table(name):
    where, direct = WHERE[name]
    x = where(field_named(name))
    direction = direct(jnp.zeros_like(x))
    # One program for the values and the derivative both ways.
    both = both_slopes(probe(name))
    value, (_, slope, gradient) = (lambda x: both(x, direction)[0]), both(x, direction)
    assert abs(slope) > 1e-4
    np.testing.assert_allclose(np.sum(np.asarray(gradient) * direction), slope, rtol=1e-10)
    steps = np.array([1e-1, 1e-2, 1e-3])
    left = taylor_remainders(value, x, direction, slope, steps)
    rates = np.log10(left[:-1] / left[1:])
    np.testing.assert_allclose(rates, 2.0, atol=0.25)
    central = (value(x + 1e-5 * direction) - value(x - 1e-5 * direction)) / 2e-5
    np.testing.assert_allclose(slope, central, rtol=1e-6, atol=1e-9)


def widened(field, size):
    """The field with its radius or its length times a number."""
    name = "length" if hasattr(field, "length") else "radius"
    return eqx.tree_at(lambda f: getattr(f, name), field, size * getattr(field, name))


def test_vmap_and_jit_without_wrappers(field):
    """Tables of other sizes, made and read in one program for a batch, against fields of these sizes."""
    sizes = np.array([0.9, 1.0, 2.0])
    point = lambda size: widened(field, size).tabulate(512).frame(size * 0.01).point.array()  # noqa: E731
    many = np.asarray(jax.jit(jax.vmap(point))(sizes))
    alone = [widened(field, size).point(size * 0.01) for size in sizes.tolist()]
    np.testing.assert_allclose(many, alone, rtol=0, atol=1e-15)
    assert many.shape == (3, 2) and np.ptp(many, axis=0).max() > 1e-4


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (
            lambda: jxr.SupportFunction(0.01, [0.0, 4e-3], [0.0, 0.0]),
            r"radius of curvature positive, .* -0.002 m",
        ),
        (lambda: jxr.SupportFunction(-0.01), "argument radius must be positive"),
        (lambda: jxr.SupportFunction(0.01, [0.0], [0.0, 0.0]), r"argument sines must have shape \(1\)"),
        (lambda: jxr.SupportFunction.through(ellipse(9), terms=5), "argument terms must lie between 1 and 4"),
        (lambda: jxr.SupportFunction.through(bean(200), terms=30), "argument radius must lie between"),
        (lambda: jxr.NeuralSupport(network(20.0), 0.01), "argument network must keep the radius"),
        (lambda: jxr.NeuralCurvature(network(1.0), 0.0), "argument length must be positive"),
        (lambda: PeriodicNetwork(activation="relu", key=jax.random.key(0)), "must be one of .*'relu'"),
        (lambda: PeriodicNetwork(0, key=jax.random.key(0)), "argument harmonics must be from 1 to 4096"),
        (lambda: jxr.NeuralSupport.through(ellipse(5), key=jax.random.key(0)), "more than 8 rows, but had 5"),
        (
            lambda: jxr.NeuralCurvature.through(ellipse(50)[::-1], key=jax.random.key(0)),
            "must run counter-clockwise",
        ),
    ],
)
def test_refusals(make, match):
    with pytest.raises(ValueError, match=match):
        make()


def test_folded_support_function_is_reported_while_tracing():
    """Under a transformation nothing can be raised: the smallest radius tells."""
    found = jax.vmap(
        lambda a: jxr.SupportFunction(0.01, jnp.stack([0.0 * a, a]), [0.0, 0.0]).smallest_radius()
    )
    np.testing.assert_allclose(found(jnp.array([1e-3, 4e-3])), [7e-3, -2e-3], rtol=1e-9)


def test_neural_support_fits_an_ellipse():
    seen = []
    fit = jxr.NeuralSupport.fit(
        ellipse(60) + (0.03, 0.01), key=jax.random.key(0), steps=75, progress=lambda *at: seen.append(at)
    )
    assert fit.rms < 1e-7
    assert fit.rms <= fit.largest < 5e-7
    assert [step for step, _ in seen] == [25, 50, 75]
    assert fit.loss_history.shape == (fit.steps + 1,)
    angle = np.linspace(0.0, TURN, 500)
    exact = height(angle) + 0.03 * np.cos(angle) + 0.01 * np.sin(angle)
    assert np.abs(np.asarray(fit.field.support(angle)) - exact).max() < 5e-7
    assert "um rms" in str(fit)


def test_neural_curvature_fits_a_bean_somewhere():
    """Few steps of a small network; how far the points are off is worked out anew."""
    seen, points = [], bean(80) + (0.03, 0.01)
    size = {"harmonics": 8, "width": 12, "depth": 1}
    fit = jxr.NeuralCurvature.fit(
        points, key=jax.random.key(0), steps=50, progress=lambda *at: seen.append(at), **size
    )
    assert fit.rms < 2e-5 and float(fit.field.closure()) < 1e-15
    assert [step for step, _ in seen] == [25, 50] and fit.loss_history.shape == (fit.steps + 1,)
    s = np.linspace(0.0, float(fit.field.length), 40001)
    far = np.hypot(*(np.asarray(fit.field.point(s))[:, None] - points[None]).transpose(2, 0, 1)).min(axis=0)
    np.testing.assert_allclose([fit.rms, fit.largest], [np.sqrt(np.mean(far**2)), far.max()], rtol=0.03)
    through = jxr.NeuralCurvature.through(points, key=jax.random.key(0), steps=50, **size)
    np.testing.assert_array_equal(through.point(s[::4000]), fit.field.point(s[::4000]))


@pytest.mark.slow
def test_neural_curvature_fits_an_ellipse_and_a_bean():
    for points, bound in ((ellipse(150), 1e-6), (bean(150), 1e-6)):
        fit = jxr.NeuralCurvature.fit(points, key=jax.random.key(0), steps=100)
        assert fit.rms < bound, fit
        s = np.linspace(0.0, float(fit.field.length), 4001)
        far = np.hypot(*(np.asarray(fit.field.point(s))[:, None] - points[None]).transpose(2, 0, 1)).min(
            axis=0
        )
        # Independent of the fit's own feet; the samples are 25 um apart.
        assert far.max() < 20e-6
        assert float(fit.field.closure()) < 1e-15


@pytest.mark.parametrize(("low", "high"), [(0.0, 7.0), (1.0, 0.5), (-3.0, 4.0)])
def test_a_margin_is_asked_for_within_one_turn(low, high):
    with pytest.raises(ValueError, match=r"argument high must be at most a turn above low, .* rad"):
        jxr.SupportFunction(0.01, [0.0, 1e-4], [0.0, 0.0]).margin(low, high)


def test_a_network_has_its_hidden_layers_and_a_last_one_of_its_amplitude():
    """From the cosines and sines of four harmonics through two layers of six to one number."""
    whole, half = (
        PeriodicNetwork(4, width=6, depth=2, amplitude=size, key=jax.random.key(3)) for size in (1.0, 0.5)
    )
    assert [layer.weight.shape for layer in whole.layers] == [(6, 8), (6, 6), (1, 6)]
    for k, share in enumerate((1.0, 1.0, 0.5)):
        np.testing.assert_allclose(half.layers[k].weight, share * whole.layers[k].weight)
        np.testing.assert_allclose(half.layers[k].bias, share * whole.layers[k].bias)
