"""Ends of surfaces, places spread over them, cylinders over contours, frames in one kernel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll._linalg._space import Vec3
from jaxroll._xla._one_kernel import one_kernel
from jaxroll.geometry import (
    Chart,
    Cylinder,
    Ellipsoid,
    Extruded,
    Implicit,
    Patch,
    Plane,
    Sphere,
    SplineSurface,
    Superellipsoid,
    tabled,
    Torus,
)

MAJOR, MINOR = 0.03, 0.011
OFFSET, TURN = (0.01, -0.02, 0.03), (0.5, -0.1, 0.7, 0.3)


def ring(u, v):
    out = MAJOR + MINOR * jnp.cos(v)
    return out * jnp.cos(u), out * jnp.sin(u), MINOR * jnp.sin(v)


def grid_of(chart, m, n):
    u, v = np.meshgrid(2 * np.pi * np.arange(m) / m, np.linspace(-1.0, 1.0, n), indexing="ij")
    return np.stack(np.broadcast_arrays(*chart(u, v)), -1)


def tube():
    """Round the ring, open across: 24 by 9 points."""
    return Patch(grid_of(ring, 24, 9), periodic=(True, False))


def wall():
    """The plane x = 0 as a field on a grid of 30 by 40 by 50 mm."""
    slope = np.broadcast_to(0.01 * (np.arange(8) - 3.0)[:, None, None], (8, 9, 10))
    return SplineSurface(slope, (-0.01, -0.02, -0.03), 0.01)


@jax.jit
def margins_at(surface, at):
    return surface.prepared().margins(at)


def margins(surface, at):
    return np.array(margins_at(surface, tuple(map(float, at))))


def test_margins_of_a_chart_are_metres():
    """Along the meridian MINOR times the angle; along the parallel its radius times the angle."""
    open_ = Chart(ring, domain=((0.0, 2.0), (-1.0, 1.0)))
    out = MAJOR + MINOR * np.cos(0.4)
    expected = [0.5 * out, 1.5 * out, 1.4 * MINOR, 0.6 * MINOR]
    np.testing.assert_allclose(margins(open_, (0.5, 0.4)), expected, rtol=1e-14)
    np.testing.assert_allclose(margins(open_.moved(OFFSET, TURN), (0.5, 0.4)), expected, rtol=1e-14)
    round_ = Chart(ring, domain=((0.0, 2 * np.pi), (-1.0, 1.0)), periodic=(True, False))
    np.testing.assert_allclose(margins(round_, (9.0, 1.2)), [2.2 * MINOR, -0.2 * MINOR], rtol=1e-13)
    assert margins(Chart(ring, domain=((0, 6.3), (0, 6.3)), periodic=(True, True)), (1, 2)).size == 0


@pytest.mark.parametrize("domain", [((1.0, 1.0), (0.0, 1.0)), ((0.0, 1.0), (2.0, -2.0))])
def test_a_chart_without_room_is_refused(domain):
    with pytest.raises(ValueError, match="argument domain must rise along u and along v, but was"):
        Chart(ring, domain=domain)


def test_margins_of_a_patch_of_a_field_and_of_none():
    np.testing.assert_allclose(margins(tube(), (5.3, 6.0)), [1.5 * MINOR, 0.5 * MINOR], rtol=1e-4)
    found = margins(wall(), (0.0, 0.005, -0.025))
    np.testing.assert_allclose(found, [0.01, 0.025, 0.005, 0.02, 0.015, 0.045], atol=1e-16)
    for surface in (Plane(), Sphere(0.01), Torus(MAJOR, MINOR), Sphere(0.01).moved(OFFSET)):
        assert margins(surface, (0.0, 0.0, 0.01)).size == 0


def test_margins_of_a_cylinder_over_a_contour():
    line = Extruded(jxr.Line((-0.01, 0.03)))
    np.testing.assert_allclose(margins(line, (0.005, 7.0)), [0.015, 0.025], atol=1e-16)
    assert margins(Extruded(jxr.Line()), (0.005, 7.0)).size == 0
    assert margins(Extruded(jxr.Circle(0.01)), (0.005, 7.0)).size == 0


def test_within_brings_coordinates_back():
    patch = tube()
    np.testing.assert_allclose(np.stack(patch.within((25.0, 9.5))), [1.0, 8.0], atol=1e-14)
    np.testing.assert_allclose(np.stack(patch.moved(OFFSET).within((-1.0, -3.0))), [23.0, 0.0], atol=1e-14)
    line = Extruded(jxr.Line((-0.01, 0.03)))
    np.testing.assert_allclose(np.stack(line.within((0.04, 9.0))), [0.03, 9.0], atol=1e-16)
    circle = Extruded(jxr.Circle(0.01))
    np.testing.assert_allclose(np.stack(circle.within((-0.01, 9.0))), [0.02 * np.pi - 0.01, 9.0], atol=1e-16)


def field(x, y, z):
    """A ring, and not star-shaped about the origin."""
    return jnp.sqrt((jnp.sqrt(x**2 + y**2) - MAJOR) ** 2 + z**2) - MINOR


# Half axes 50, 10 and 10 mm.
ECCENTRIC = np.sqrt(1.0 - 0.04)
PROLATE = 2 * np.pi * 1e-4 * (1.0 + 5.0 * np.arcsin(ECCENTRIC) / ECCENTRIC)
SPREAD = {
    "sphere": (Sphere(0.02), 4 * np.pi * 0.02**2),
    "torus": (Torus(MAJOR, MINOR), 4 * np.pi**2 * MAJOR * MINOR),
    "field": (Implicit(field, radius=0.042), 4 * np.pi**2 * MAJOR * MINOR),
    "ellipsoid": (Ellipsoid(0.05, 0.01, 0.01), PROLATE),
    "superellipsoid": (Superellipsoid(0.02, 0.02, 0.02, exponent=8), None),
    "chart": (Chart(ring, domain=((0, 6.3), (0, 6.3))).moved(OFFSET, TURN), 4 * np.pi**2 * MAJOR * MINOR),
    "patch": (tube(), None),
    "grid": (wall(), 0.04 * 0.05),
}


@pytest.mark.parametrize("name", SPREAD)
def test_places_spread_evenly(name):
    """On the surface, the nearest as far as on a lattice, and none much farther than others."""
    surface, area = SPREAD[name]

    @jax.jit
    def told(surface):
        """Places; of surfaces that are a level set their levels there, and of those with ends the margins."""
        at = jnp.stack(surface.prepared().spread(200), axis=-1)
        inner = getattr(surface, "surface", surface)
        level = lambda p: inner.derivatives(Vec3(*p)).value  # noqa: E731
        off = jax.vmap(level)(at) if surface.coordinates == 3 else jnp.zeros(200)
        return at, off, jax.vmap(lambda p: inner.prepared().margins(tuple(p)))(at)

    at, off, room = told(surface)
    assert at.shape == (200, surface.coordinates)
    points = np.asarray(surface.point(at))
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.eye(200)
    nearest = apart.min(axis=1)
    assert nearest.max() / nearest.min() < 2.5
    if area is not None:
        assert 0.7 < np.median(nearest) / np.sqrt(area / 200) < 1.1
    assert np.abs(off).max() < 1e-9
    assert all(np.all(np.asarray(m) >= 0) for m in room)


@pytest.mark.parametrize(
    "surface", [Plane(), Cylinder(0.01), Extruded(jxr.Circle(0.01)), Implicit(field), Plane().moved()]
)
def test_unbounded_surfaces_are_not_spread(surface):
    assert surface.spread(10) is None


def test_extruded_circle_is_the_cylinder():
    rod, exact = Extruded(jxr.Circle(0.012)), Cylinder(0.012)
    at = np.stack([np.linspace(-0.05, 0.1, 9), np.linspace(-1.0, 1.0, 9)], -1)
    points = rod.point(at)
    np.testing.assert_allclose(points[:, 2], at[:, 1], atol=0)
    np.testing.assert_allclose(rod.normal(at), exact.normal(points), atol=1e-14)
    np.testing.assert_allclose(rod.shape_operator(at), exact.shape_operator(points), atol=1e-11)
    first, _ = rod.forms(at)
    np.testing.assert_allclose(first, np.broadcast_to(np.eye(2), (9, 2, 2)), atol=1e-14)


def test_extruded_frame_by_differences():
    """Tangents, normal and its change against central differences of the points alone."""
    for contour in (jxr.Ellipse(0.03, 0.012), jxr.Spline(wavy())):
        bar = Extruded(contour)
        at = np.stack([np.linspace(0.0, 0.13, 40), np.linspace(-0.2, 0.2, 40)], -1)
        h = 1e-5
        ends = [[np.asarray(bar.point(at + s * h * e)) for s in (1, -1)] for e in np.eye(2)]
        along = [(ahead - behind) / (2 * h) for ahead, behind in ends]
        normal = np.cross(*along)
        normal /= np.linalg.norm(normal, axis=-1)[:, None]
        np.testing.assert_allclose(bar.normal(at), normal, atol=1e-6)
        turns = [(bar.normal(at + h * e) - bar.normal(at - h * e)) / (2 * h) for e in np.eye(2)]
        shape = np.asarray(bar.shape_operator(at))
        for turned, v in zip(turns, along, strict=True):
            np.testing.assert_allclose(np.einsum("...ij,...j", shape, v), turned, atol=2e-3)
        assert np.abs(shape).max() > 50.0


def wavy():
    u = 2 * np.pi * np.arange(24) / 24
    return (0.02 + 0.002 * np.cos(3 * u))[:, None] * np.stack([np.cos(u), 0.7 * np.sin(u)], -1)


def test_the_table_of_a_contour_serves_its_cylinder():
    """Built once, for the bare and for the placed cylinder; then a run reads no spline."""
    bar = Extruded(jxr.Spline(wavy()))
    ready = tabled(bar)
    assert ready.contour.table is not None and tabled(bar) is ready and tabled(ready) is ready
    placed = tabled(bar.moved(OFFSET, TURN))
    assert placed.surface.contour.table is not None
    assert tabled(Sphere(0.01)) is not None and tabled(Extruded(jxr.Circle(0.01))).contour.radius == 0.01
    np.testing.assert_allclose(bar.point((0.01, 0.02))[:2], bar.contour.point(0.01), atol=1e-16)


def test_start_of_an_endless_edge():
    np.testing.assert_allclose(Extruded(jxr.Line()).near((0.01, 0.3, -0.2)), [0.3, -0.2], atol=1e-14)
    with pytest.raises(ValueError, match="argument contour must be a contour"):
        Extruded(Sphere(0.01))


@pytest.mark.parametrize("name", ["patch", "grid", "extruded"])
@pytest.mark.parametrize("lanes", [1, 16])
def test_frames_fit_into_one_kernel(name, lanes):
    surface = {"patch": tube(), "grid": wall(), "extruded": tabled(Extruded(jxr.Spline(wavy())))}[name]

    def march(x, ready):
        def step(_, x):
            at = tuple(x[k] for k in range(ready.coordinates))
            frame = ready.frame(at)
            rate = ready.rate(at, frame.normal.cross(frame.point))
            return x + 1e-6 * jnp.stack(rate) + 1e-12 * sum(ready.margins(at), frame.shape.xx)

        return jax.lax.fori_loop(0, 5, step, x)

    ready = surface.prepared()
    many = jax.jit(jax.vmap(lambda x: one_kernel(march, x, ready)))
    x = jnp.broadcast_to(jnp.full(surface.coordinates, 3e-3), (lanes, surface.coordinates))
    assert many.lower(x).as_text().count('xla_cpu_small_call = "true"') == 1
    assert np.all(np.isfinite(many(x)))
