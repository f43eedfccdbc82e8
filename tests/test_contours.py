"""Every contour: closed forms against autodiff, Frenet's equations, placement, arclength."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ellipeinc

import jaxroll as jxr
from jaxroll.geometry import frenet
from jaxroll.geometry.contours._support import smallest
from tests.measures import both_slopes
from tests.recorded import runs

A, B = 0.02, 0.01
CONTOURS = {
    "line": jxr.Line(),
    "circle": jxr.Circle(0.01),
    "ellipse": jxr.Ellipse(A, B),
    "flat ellipse": jxr.Ellipse(0.005, 0.02),
    "catenary": jxr.Catenary(0.025),
    "moved": jxr.Catenary(0.025).moved((0.01, -0.02), 0.7, origin=0.003),
    "moved ellipse": jxr.Ellipse(A, B).moved((0.01, -0.02), -2.0),
}
S = np.linspace(-0.07, 0.09, 161)


@pytest.fixture(scope="module", params=CONTOURS)
def contour(request):
    return CONTOURS[request.param]


def all_along(function, s):
    """What a function of arclengths is at many of them, as many at a time as `S` has: for one program."""
    return np.concatenate([function(part) for part in s.reshape(-1, len(S))])


@jax.jit
def by_autodiff(contour, s):
    ready = contour.prepared()
    return frenet(ready.curve, s), ready.frame(s)


def test_closed_form_frame_is_autodiff_of_the_point(contour):
    """(8): the tangent is the derivative of the point; the curvature is that of the tangent."""
    auto, closed = by_autodiff(contour, jnp.asarray(S))
    scale = float(np.max(np.abs(closed.curvature))) + 1.0
    np.testing.assert_allclose(auto.point.array(), closed.point.array(), atol=1e-14)
    np.testing.assert_allclose(auto.tangent.array(), closed.tangent.array(), atol=1e-12)
    np.testing.assert_allclose(auto.curvature / scale, closed.curvature / scale, atol=1e-12)


def test_unit_speed_and_orthogonal_outward_normal(contour):
    t, n = contour.tangent(S), contour.normal(S)
    np.testing.assert_allclose(np.linalg.norm(t, axis=-1), 1.0, atol=1e-14)
    np.testing.assert_allclose(np.sum(t * n, axis=-1), 0.0, atol=1e-14)
    np.testing.assert_allclose(n, np.stack([t[:, 1], -t[:, 0]], -1), atol=0)


def test_frenet_equations_as_corrected(contour):
    """(9)-(10) right: b' = kappa n and n' = -kappa b with n inward, here by differences."""
    h = 2e-7
    inward = lambda s: -contour.normal(s)  # noqa: E731
    kappa = np.asarray(contour.curvature(S))[:, None]
    slope = lambda f: (np.asarray(f(S + h)) - np.asarray(f(S - h))) / (2 * h)  # noqa: E731
    size = 1.0 + np.max(np.abs(kappa))
    np.testing.assert_allclose(slope(contour.tangent) / size, kappa * inward(S) / size, atol=1e-7)
    np.testing.assert_allclose(slope(inward) / size, -kappa * contour.tangent(S) / size, atol=1e-7)


def test_closed_contours_run_counter_clockwise_once(contour):
    if not contour.closed:
        pytest.skip("open")
    low, high = contour.domain()
    s = np.linspace(float(low), float(high), 13 * len(S))
    points, curvatures = all_along(contour.point, s), all_along(contour.curvature, s)
    np.testing.assert_allclose(points[0], points[-1], atol=1e-14)
    x, y = (points - points.mean(axis=0)).T
    assert 0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) > 0
    turning = np.trapezoid(curvatures, s)
    np.testing.assert_allclose(turning, 2 * np.pi, rtol=1e-6)


@pytest.mark.parametrize(("a", "b"), [(A, B), (B, A), (0.02, 0.005), (0.01, 0.01)])
def test_ellipse_arclength_against_the_elliptic_integral(a, b):
    """To 1e-12 of the circumference; the integral is SciPy's."""
    ellipse = jxr.Ellipse(a, b)
    u = np.linspace(0.0, 2 * np.pi, 97)
    m = 1.0 - (a / b) ** 2
    exact = b * ellipeinc(u, m)
    length = exact[-1]
    np.testing.assert_allclose(float(ellipse.domain()[1]), length, rtol=1e-13)
    expected = np.stack([a * np.cos(u), b * np.sin(u)], -1)
    error = np.abs(all_along(ellipse.point, np.resize(exact, len(S)))[:97] - expected).max()
    assert error <= 1e-12 * length


def test_ellipse_table_converges_at_sixth_order():
    exact = CONTOURS["ellipse"]
    s = np.linspace(0.0, 0.09, len(S))
    cells = np.array([24, 96])
    errors = [
        np.abs(np.asarray(jxr.Ellipse(A, B, cells=int(n)).point(s) - exact.point(s))).max() for n in cells
    ]
    assert abs(np.polyfit(np.log(cells), np.log(errors), 1)[0] + 6.0) < 0.5


def test_ellipse_point_is_differentiable_in_its_axes():
    """Against central differences, in both modes."""
    both = both_slopes(lambda axes: jxr.Ellipse(*axes).point(0.013)[0])
    axes = np.array([A, B])
    point = lambda axes: float(both(axes)[0])  # noqa: E731
    steps = 1e-6 * np.diag(axes)
    slopes = [(point(axes + step) - point(axes - step)) / (2 * step.sum()) for step in steps]
    np.testing.assert_allclose(both(axes)[2], slopes, rtol=1e-8)
    np.testing.assert_allclose([both(axes, way)[1] for way in np.eye(2)], slopes, rtol=1e-8)


def test_chapter_contours_are_these_catenaries():
    """(80)-(83) as corrected, point by point, in the mirrored frame."""
    from tests.oracles.chapter_part2 import Part2

    grasp, _ = runs.scene("pivoted")
    mirror = np.array([1.0, -1.0])
    s = np.linspace(-0.01, 0.01, 41)
    printed = np.asarray(jax.jit(jax.vmap(Part2.object_contour))(s))
    np.testing.assert_allclose(grasp.object.contours[0].point(s), printed * mirror, atol=1e-15)
    printed = np.asarray(jax.jit(jax.vmap(Part2.tip_contour))(s))
    # The chapter's fingertip frame is left-handed after the mirror, and runs against our arclength.
    tip = grasp.fingers[0].tip
    turned = np.stack([-printed[:, 1], -printed[:, 0]], -1)
    np.testing.assert_allclose(tip.point(-s), turned, atol=1e-15)
    a, b = 1 / 100, 1 / 40
    face = grasp.object.contours[0]
    np.testing.assert_allclose(face.curvature(s), a / (a**2 + (s - 3.363e-3) ** 2), rtol=1e-14)
    np.testing.assert_allclose(tip.curvature(s), b / (b**2 + s**2), rtol=1e-14)


@pytest.mark.parametrize("shape", [(), S.shape, (2, 4)])
def test_public_shapes(contour, shape):
    s = np.zeros(shape)
    assert contour.point(s).shape == (*shape, 2)
    assert contour.curvature(s).shape == shape


def test_the_smallest_value_is_found_between_samples_the_outer_ones_included():
    @jax.jit
    def found(lowest, low, high):
        return smallest(lambda x: 3.0 + (x - lowest) ** 2, (low, high), 9)

    # A parabola through three of its samples is itself.
    for lowest in (0.03, 0.52, 0.97):
        assert float(found(lowest, 0.0, 1.0)) == pytest.approx(3.0, abs=1e-15)
