"""A caller's own curve or surface, by its points, against those that have closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from tests.measures import both_slopes, taylor_remainders
from tests.recorded import runs

A, B = 0.02, 0.014
TURN = 2.0 * np.pi


def ellipse(axes, u):
    return jnp.stack([axes[0] * jnp.cos(u), axes[1] * jnp.sin(u)])


def own(a=A, b=B, **options):
    curve = jax.tree_util.Partial(ellipse, jnp.stack([jnp.asarray(a), jnp.asarray(b)]))
    return jxr.Parametric(curve, (0.0, TURN), closed=True, **options)


def test_frame_of_a_curve_is_that_of_its_closed_form():
    s = jnp.linspace(-0.01, 0.12, 41)
    wanted, found = jxr.Ellipse(A, B), own()
    for name, close in (("point", 1e-12), ("tangent", 1e-11), ("curvature", 1e-6)):
        np.testing.assert_allclose(getattr(found, name)(s), getattr(wanted, name)(s), rtol=0, atol=close)
    error = found.table_error()
    assert error.point < 1e-15 and error.curvature < 1e-7
    assert found.closed and found.smoothness == np.inf


def test_origin_is_where_arclength_begins():
    turned = jxr.Parametric(lambda u: ellipse((A, B), u), (-3.0, TURN - 3.0), closed=True, origin=0.7)
    np.testing.assert_allclose(turned.point(0.0), ellipse((A, B), 0.7), rtol=0, atol=1e-15)
    low, high = turned.domain()
    np.testing.assert_allclose(high - low, own().domain()[1], rtol=1e-14)


def test_an_open_curve_is_the_catenary_that_it_follows():
    """Part 2's contour by x, which is no arclength: a run with it is that with the chapter's own."""
    c = 0.025

    def hanging(u):
        return jnp.stack([-c * (jnp.cosh(u / c) - 1.0), u])

    # The error of a coarse table is looked for between its ends alone, beyond which it goes on as a formula.
    rough = jxr.Parametric(hanging, (-0.005, 0.03), origin=0.0, cells=16)
    between = np.linspace(*rough.domain(), 1001)
    off = np.linalg.norm(rough.point(between) - jxr.Catenary(c).point(between), axis=1)
    assert rough.table_error().point == pytest.approx(off.max(), rel=0.1)
    mine = jxr.Parametric(hanging, (-0.03, 0.03), origin=0.0)
    s = np.linspace(-0.02, 0.02, 1001)
    np.testing.assert_allclose(mine.point(s), jxr.Catenary(c).point(s), rtol=0, atol=1e-15)
    grasp, state = runs.scene("pivoted")
    placed = grasp.with_tip(0, mine.moved((0.01, 0.0)).moved(angle=-0.5 * np.pi))
    ends = [jxr.simulate(each, state, 0.3, ts=1, rtol=1e-10).last.q for each in (grasp, placed)]
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-12)


def test_runs_batches_and_gradients_go_through_the_curve():
    """In its own arrays, through table and run: a Taylor test; a batch is its runs.

    A disc rolls down from the top of a fixed hill, which is the curve.
    """

    def turned(b):
        hill = jxr.Jaw(own(0.012, b, origin=0.0, cells=256))
        disc = jxr.FreeObject(jxr.Circle(0.01), 0.02, 1e-6)
        grasp = jxr.Grasp(disc, hill, jxr.Contact(0.0, 0.0), gravity=(-9.81, 0.0))
        start = jxr.State([0.022, 0.0, np.pi], np.array([0.0, 0.1, 10.0]), [0.0])
        return jxr.simulate(grasp, start, 0.05, ts=1).last.q[2]

    both = both_slopes(turned)
    value, *slopes = both(0.01)
    for slope in slopes:
        left = taylor_remainders(lambda b: both(b)[0], 0.01, 1.0, float(slope), (2e-4, 1e-4, 5e-5))
        np.testing.assert_allclose(np.log2(left[:-1] / left[1:]), 2.0, atol=0.1)
    many = np.asarray(jax.jit(jax.vmap(turned))(np.array([0.009, 0.01, 0.011])))
    np.testing.assert_allclose(many[1], value, rtol=0, atol=1e-9)
    assert np.ptp(many) > 1e-5


@pytest.mark.parametrize(
    ("asked", "wanted"),
    [
        (lambda: jxr.Parametric(3.0, (0.0, 1.0)), "argument function must be a function"),
        (lambda: jxr.Parametric(lambda u: u, (0.0, 1.0)), "argument function must give a point of shape"),
        (
            lambda: jxr.Parametric(lambda u: jxr.geometry.Vec2(u, u), (0.0, 1.0)),
            r"argument function must give a point of shape \(2,\), but gave Vec2",
        ),
        (lambda: jxr.Parametric(lambda u: ellipse((A, B), u), (1.0, 0.0)), "argument domain must be two"),
        (
            lambda: jxr.Parametric(lambda u: ellipse((A, B), u), (0.0, np.inf)),
            "argument domain must be finite",
        ),
        (lambda: own(origin=9.0), r"argument origin must lie within \[0, 6.28"),
        (lambda: own(smoothness=1), "argument smoothness must be a number of derivatives"),
        (lambda: own(smoothness=np.complex128(3)), "argument smoothness must be a number of derivatives"),
        (lambda: own(smoothness=10**400), "argument smoothness must be a number of derivatives"),
        (lambda: own(cells=2), "argument cells must be a whole number of at least"),
        (lambda: own(b=-B), "argument function must run counter-clockwise"),
        (
            lambda: jxr.Parametric(lambda u: 0.0 * ellipse((A, B), u), (0.0, TURN), closed=True),
            "argument function must run counter-clockwise",
        ),
        (
            lambda: jxr.Parametric(lambda u: ellipse((A, B), u), (0.0, 3.0), closed=True),
            "argument function must end where it began",
        ),
        (
            lambda: jxr.Parametric(
                lambda u: (1 + 1e-3 * jnp.sin(u / 2)) * ellipse((A, B), u), (0.0, TURN), closed=True
            ),
            "argument function must go on smoothly where it closes, .* by -0.00143 rad",
        ),
        (
            lambda: jxr.Parametric(lambda u: jnp.stack([jnp.log(u), u]), (-1.0, 1.0)),
            "argument function must give finite points",
        ),
        (
            lambda: jxr.Parametric(lambda u: jnp.stack([u**2, u**3]), (-1.0, 1.0)).point(0.0),
            "argument cells must be more|must have finite points",
        ),
    ],
)
def test_what_is_no_contour_is_refused_in_a_sentence(asked, wanted):
    with pytest.raises(ValueError, match=wanted) as caught:
        asked()
    assert "\n" not in str(caught.value)


def globe(r, u, v):
    """A ball with its poles on the x axis, off the way of a contact below."""
    return jnp.stack([r * jnp.sin(v), r * jnp.cos(v) * jnp.cos(u), r * jnp.cos(v) * jnp.sin(u)])


def chart(r):
    place = jax.tree_util.Partial(globe, jnp.asarray(r))
    return jxr.geometry.Chart(place, domain=((-np.pi, np.pi), (-1.5, 1.5)), periodic=(True, False))


def rolled(surface, r, **options):
    """Where a ball is that rolls down a plane along y, and a little along x."""
    body = jxr.FreeObject3(surface, 0.1, 0.4 * 0.1 * r**2)
    grasp = jxr.Grasp(body, jxr.Stage(jxr.Plane()), jxr.Contact3(), gravity=(0.05, 0.3, -9.81))
    below = jnp.array([0.0, 0.0, -1.0]) * r
    q = jnp.concatenate([-below, jnp.array([1.0, 0.0, 0.0, 0.0])])
    state = jxr.State(q, jnp.zeros(6), jnp.concatenate([jnp.zeros(3), surface.near(below)]))
    return jxr.simulate(grasp, state, 0.3, ts=1, **options).last.q


def test_a_surface_of_ones_own_rolls_as_the_ball_that_it_is():
    """A solid ball has 5/7 of the acceleration of what slides freely, and turns about one axis."""
    radius = 0.02
    end = rolled(chart(radius), radius, rtol=1e-12)
    x, y = way = 5 / 14 * 0.3**2 * np.array([0.05, 0.3])
    length = np.hypot(x, y)
    axis, half = np.array([-y, x, 0.0]) / length, 0.5 * length / radius
    np.testing.assert_allclose(end[:3], [*way, radius], rtol=0, atol=1e-12)
    np.testing.assert_allclose(end[3:], [np.cos(half), *np.sin(half) * axis], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_batches_and_gradients_go_through_a_surface_of_ones_own():
    """In its own array: the quaternion of a ball that has rolled a way y has turned by y / r."""
    turned = lambda r: rolled(chart(r), r)[3]  # noqa: E731
    way = 5 / 14 * 0.3**2 * np.hypot(0.05, 0.3)
    radii = np.array([0.018, 0.02, 0.022])
    found, slopes = jax.vmap(jax.value_and_grad(turned))(jnp.asarray(radii))
    np.testing.assert_allclose(found, np.cos(way / radii / 2), rtol=1e-7)
    np.testing.assert_allclose(slopes, np.sin(way / radii / 2) * way / radii**2 / 2, rtol=1e-5)


@pytest.mark.parametrize(
    ("function", "wanted"),
    [
        (3.0, "function must be a function from two numbers to a point"),
        (lambda u: (u, u, u), "function must be a function from two numbers to a point"),
        (lambda u, v: (u, v), r"function must give a point, three numbers or .* gave shapes \[\(\), \(\)\]"),
        (lambda u, v: jnp.stack([u, v]), r"gave shapes \[\(2,\)\]"),
    ],
)
def test_what_is_no_surface_is_refused_in_a_sentence(function, wanted):
    with pytest.raises(ValueError, match=wanted):
        jxr.geometry.Chart(function, domain=((0, 1), (0, 1)))


@pytest.mark.parametrize(("gap", "closes"), [(0.0, True), (2e-4, False)])
def test_a_closed_curve_closes_in_single_precision(gap, closes):
    """Where 2 pi is 1.7e-7 off, and the ends of a curve are as far apart as its points are off."""

    def egg():
        point = lambda u: 0.01 * jnp.array([(1.2 + gap * u) * jnp.cos(u), jnp.sin(u)])  # noqa: E731
        return jxr.Parametric(point, (0.0, 2.0 * np.pi), closed=True)

    with jax.enable_x64(False):
        if closes:
            assert float(egg().curvature(0.0)) == pytest.approx(120.0, rel=1e-4)
            return
        with pytest.raises(ValueError, match="end where it began"):
            egg()
