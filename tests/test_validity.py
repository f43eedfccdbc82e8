"""What is accurate in a range stays accurate, says no, or gives NaN beyond it: never a wrong number."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ellipeinc

import jaxroll as jxr
from jaxroll._integration._arguments import Numbers, sweeps
from jaxroll._xla._trigonometry import branch_free, inverse_sinh
from jaxroll.geometry import Ellipsoid, Superellipsoid, tabled
from tests.recorded import runs


@pytest.mark.parametrize(("a", "b", "cells"), [(0.07, 0.01, 1024), (0.01, 0.16, 8192), (1.0, 0.01, 262144)])
def test_flat_ellipses_stay_accurate(a, b, cells):
    """To 1e-9 of the circumference everywhere, the ends included; the integral is SciPy's."""
    ellipse = jxr.Ellipse(a, b)
    assert ellipse.cells == cells
    near = np.linspace(-5.0, 5.0, 101) * min(a, b) / max(a, b)
    u = np.sort(np.concatenate([np.linspace(0.0, 6.28, 401), near + np.pi, near + 0.5 * np.pi]))
    exact = b * ellipeinc(u, 1.0 - (a / b) ** 2)
    length = b * ellipeinc(2 * np.pi, 1.0 - (a / b) ** 2)
    # The ellipse is an argument: of constants XLA would work the whole table out while it compiles.
    ready = jax.jit(lambda e, s: (e.prepared().domain()[1], e.prepared().curve(s).array()))
    found, points = ready(ellipse, exact)
    assert abs(float(found) / length - 1.0) < 1e-12
    assert np.abs(points - np.stack([a * np.cos(u), b * np.sin(u)], -1)).max() < 1e-9 * length


def test_flatter_ellipses_are_refused():
    for a, b in ((1.0, 0.0099), (1e-6, 1.0)):
        with pytest.raises(ValueError, match="argument b must lie between a / 100 and 100 a"):
            jxr.Ellipse(a, b)
    with pytest.raises(ValueError, match="argument cells must be at least 4 times .* 400, but was 64"):
        jxr.Ellipse(0.1, 0.01, cells=64)
    with pytest.raises(ValueError, match="argument cells must be a whole number of at least 16"):
        jxr.Ellipse(0.1, 0.1, cells=4)


def test_traced_axes_beyond_the_table_give_no_number():
    point = jax.jit(lambda b: jxr.Ellipse(0.1, b, cells=64).point(0.01))
    assert np.isfinite(point(0.026)).all() and np.isnan(point(0.024)).all()


def test_a_table_refuses_what_it_does_not_resolve():
    """A corner sharper than its cells, a fold under tracing, a contour with NaN in it."""
    sharp = jxr.SupportFunction(0.01, [0.0, 0.0, 1.2499e-3], [0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="argument cells must be more than 1024 for a contour that bends so"):
        jxr.contact.locate(sharp, jxr.Circle(0.01))
    tip = jax.jit(lambda x: jxr.SupportFunction(0.01, x, jnp.zeros(3)).point(0.001))
    assert np.isfinite(tip(jnp.array([0.0, 0.0, 1e-3]))).all()
    assert np.isnan(tip(jnp.array([0.0, 0.0, 1.3e-3]))).all()
    with pytest.raises(ValueError, match="argument cells must be a whole number of at least 1200"):
        jxr.SupportFunction(0.01, np.zeros(300), np.zeros(300))


def test_a_fit_takes_as_many_cells_as_it_needs():
    """Points that go round the corners of a star, met exactly."""
    u = 2 * np.pi * np.arange(96) / 96
    r = 0.01 * (1.0 + 0.45 * np.cos(5 * u)) * (1.0 + 0.02 * np.random.default_rng(2).normal(size=96))
    found = jxr.fit_contour(np.stack([r * np.cos(u), r * np.sin(u)], -1), noise=0.0, ordered=True).contour
    assert found.cells == 4096
    assert np.isfinite(float(tabled(found).table.length))


def test_points_are_limited_where_each_has_a_knot():
    u = 2 * np.pi * np.arange(5000) / 5000
    points = 0.01 * np.stack([np.cos(u), np.sin(u)], -1)
    with pytest.raises(ValueError, match="argument points must be at most 4096 where each has a knot"):
        jxr.Spline(points)
    with pytest.raises(ValueError, match="argument knots must be at most 3355 for 5000 points"):
        jxr.Spline(points, knots=4000)


@pytest.mark.parametrize(
    "make",
    [
        lambda x: jxr.Circle(x),
        lambda x: jxr.Ellipse(x, x),
        lambda x: jxr.Catenary(x),
        lambda x: jxr.SupportFunction(x),
        lambda x: jxr.Sphere(x),
        lambda x: jxr.geometry.Cylinder(x),
        lambda x: jxr.Torus(2 * x, x),
        lambda x: jxr.Ellipsoid(x, x, x),
    ],
)
def test_lengths_have_bounds(make):
    for x in (1e-13, 1e10):
        with pytest.raises(ValueError, match="must lie between"):
            make(x)


TURN = 2.0 * np.pi * np.arange(128) / 128
RING = np.stack([np.cos(TURN), np.sin(TURN)], -1)


@pytest.mark.parametrize("size", [1e-200, 1e-20, 1e20, 1e200, 1e308])
@pytest.mark.parametrize(
    "make",
    [
        jxr.Spline,
        jxr.fit_contour,
        lambda points: jxr.fit_contour(points, ordered=False),
        lambda points: jxr.fit_contour(points, smallest_radius=0.01),
        lambda points: jxr.SupportFunction.through(points, terms=6),
        lambda points: jxr.NeuralSupport.through(points, key=jax.random.key(0)),
        lambda points: jxr.NeuralCurvature.through(points, key=jax.random.key(0)),
        jxr.geometry.smoothing_for,
        lambda points: jxr.geometry.fit_surface(np.pad(points, ((0, 0), (0, 1)))),
    ],
)
def test_points_are_as_far_apart_as_shapes_may_be_long(make, size):
    """Their squares would be infinite, or zero, in what libraries do with them."""
    with pytest.raises(ValueError, match="^argument points must extend over 1e-12 m or more, within 1e.09 m"):
        make(size * RING)


def test_closest_points_that_are_not_found_are_nan():
    """A needle: Newton's method arrives from some places; from the others it says so."""
    needle, ways = Ellipsoid(1.0, 1e-2, 1e-2), np.random.default_rng(0).normal(size=(64, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    found = np.asarray(needle.near(1.2 * ways * np.array([1.0, 1e-2, 1e-2])))
    arrived = np.isfinite(found).all(axis=1)
    assert 0 < arrived.sum() < 64
    level = ((found[arrived] / np.array([1.0, 1e-2, 1e-2])) ** 2).sum(axis=1)
    np.testing.assert_allclose(level, 1.0, rtol=1e-12)
    with pytest.raises(ValueError, match="argument exponent must be at least 2 and at most 32, but was 33"):
        Superellipsoid(0.1, 0.1, 0.1, 33)


@pytest.mark.parametrize("scale", [1e6, 1e9, 1e12, 1e15])
def test_large_angles_err_by_no_more_than_their_own_rounding(scale):
    angles = np.random.default_rng(0).uniform(-scale, scale, 20_000)
    exact = angles.astype(np.longdouble)
    slack = 1e-15 + np.spacing(np.abs(angles))
    sine, cosine = map(np.asarray, jax.jit(branch_free)(jnp.asarray(angles)))
    assert np.all(np.abs(sine - np.sin(exact)) <= slack) and np.all(np.abs(cosine - np.cos(exact)) <= slack)


def test_inverse_sinh_beyond_its_range_is_no_number():
    found = np.asarray(jax.vmap(inverse_sinh)(jnp.array([1e150, 1e160, -1e300])))
    np.testing.assert_allclose(found[0], np.arcsinh(1e150), rtol=1e-15)
    assert not np.isfinite(found[1:]).any()


def test_more_fingers_than_compile_are_refused():
    with pytest.raises(ValueError, match="argument count must be at most 60, since more .* but was 61"):
        jxr.scenes.ring(61)


def test_one_return_to_the_constraints_up_to_the_default_tolerance_and_two_beyond():
    """Gaps stay at rounding either way; a tolerance that is traced, and constant steps, have two."""
    numbers = lambda rtol: Numbers(0.0, 1.0, None, 1e-3, np.asarray(rtol), np.asarray(1e-9))  # noqa: E731
    asked = [
        sweeps(numbers(rtol), own_control=own) for rtol, own in ((1e-8, False), (2e-8, False), (1e-8, True))
    ]
    assert asked == [1, 2, 2]
    traced = []
    jax.jit(lambda rtol: traced.append(sweeps(Numbers(0.0, 1.0, None, 1e-3, rtol, rtol), False)))(1e-8)
    assert traced == [2]
    grasp, state = runs.scene("pivoted")  # where most is left is `tests/test_rolling_bodies.py`
    for rtol in (1e-8, 1e-4):
        run = jxr.simulate(grasp, state, 2.0, ts=31, rtol=rtol)
        left = run.residuals
        assert max(float(jnp.abs(x).max()) for x in (left.normal, left.tangential, left.tangency)) <= 1e-14


@pytest.mark.parametrize("scene", ["pivoted", "roller", pytest.param("turntable", marks=pytest.mark.slow)])
def test_single_precision_stays_single_where_double_is_allowed(scene):
    """Closed and run in its own precision, to its rounding where the double one is."""
    grasp, state = runs.scene(scene)
    single = lambda tree: jax.tree.map(lambda x: x.astype(jnp.float32), tree)  # noqa: E731
    small, start = jxr.close(single(grasp), single(state))
    run = jxr.simulate(small, start, 0.2, ts=31, rtol=1e-4)
    kinds = {leaf.dtype for leaf in jax.tree.leaves((start, run.states, run.residuals))}
    assert kinds == {jnp.dtype("float32")}
    wanted = jxr.simulate(grasp, state, 0.2, ts=31).states.q
    np.testing.assert_allclose(run.states.q, wanted, atol=1e-5)
