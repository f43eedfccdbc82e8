"""What seldom happens: arguments that are seldom wrong, reports without names, progress on a terminal."""

import io
import math
import sys
import types
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll import _closures, _identify, _printing, design, geometry, plotting
from jaxroll.__main__ import _progress
from jaxroll._cli import _sweep_order
from jaxroll._integration import _report
from jaxroll._results import as_share
from jaxroll._saving import _named
from jaxroll._sweep._parameters import Parameters
from jaxroll.design import _minimise
from jaxroll.geometry.contours import _network_descent
from jaxroll.geometry.contours._given_points import numbers, polygon_area
from jaxroll.geometry.fitting import _surface_fit
from jaxroll.geometry.fitting._surface_fit import _lengths
from jaxroll.geometry.mass._moments import checked
from jaxroll.io import _outline, _svg, _tables
from jaxroll.plotting import _doors, _meshes, _motion3, _scene3, _style

TURN = 2.0 * np.pi * np.arange(40) / 40
ROUND = np.stack([0.01 * np.cos(TURN), 0.008 * np.sin(TURN)], axis=-1)


def traced(call):
    """What a function is told while JAX traces its argument."""
    return lambda: jax.jit(call)(1.0)


def field(step):
    return geometry.SplineSurface(jnp.ones((8, 8, 8)), jnp.zeros(3), step)


SEEN = SimpleNamespace(size=jnp.zeros(()))
REFUSED = {
    "a name with a digit first": (lambda: _sweep_order._range("1a", 2.0), "--set must name parameters as Py"),
    "a truth value": (lambda: _sweep_order._range("a", True), "--set must give a finite numbers"),
    "three tips": (lambda: jxr.scenes.pinch(tips=(jxr.Circle(0.01),) * 3), "tips must be .*, but was"),
    "a tube as thick as its wheel": (
        lambda: jxr.scenes.wheel(radius=0.1, tube=0.1),
        "tube must be smaller than radius, 0.1, but was 0.1",
    ),
    "a wheel that lies flat": (lambda: jxr.scenes.wheel(inclination=0.0), "inclination must lie"),
    "a wheel on its other side": (lambda: jxr.scenes.wheel(inclination=np.pi), "inclination must lie"),
    "a wheel that does not turn": (lambda: jxr.scenes.wheel(precession=0.0), "precession must not be zero"),
    "an object of one line": (
        lambda: jxr.scenes.pinch(object=jxr.FreeObject([jxr.Line()], 0.02, 1e-6)),
        "object must have two faces or one closed contour",
    ),
    "a roller of one line": (lambda: jxr.scenes.roller(jxr.Line()), "contour must be a closed contour"),
    "many cells": (lambda: jxr.Ellipse(0.02, 0.01, cells=10**9), "cells must be at most"),
    "one point again": (lambda: numbers("points", np.ones((5, 2)), 2), "points must not be one point again"),
    "two corners": (lambda: polygon_area(ROUND[:2]), "points must have at least 3 rows, but had 2"),
    "an open spline's middle": (
        lambda: jxr.Spline(ROUND[:9], closed=False, origin=2).symmetrised(),
        "symmetric must be False unless an open spline's origin is its middle point, but that is 2 of 9",
    ),
    "negative noise": (lambda: geometry.smoothing_for(ROUND, noise=-1.0), "noise must lie between 0 and"),
    "more noise than shape": (
        lambda: geometry.smoothing_for(ROUND, noise=0.11 * np.ptp(ROUND, axis=0).max()),
        "noise must lie between 0 and",
    ),
    "two measures of one name": (
        lambda: jxr.measures("result", "steps", result=lambda run: run.ts),
        "result must have another name, but a measure 'result' was asked for too",
    ),
    "noise of a surface": (
        lambda: _lengths(np.eye(3), None, -1e-6),
        "noise must lie between 0 and 0.1 m here, but was -1e-06",
    ),
    "moments that never settle": (lambda: checked(None, 0.5, SEEN), "still change by 5.0e-01 of themselves"),
    "a body without a volume": (
        lambda: checked(SEEN, 0.0, SEEN),
        "shape must have its normal outward, but the volume in this SimpleNamespace was 0 m",
    ),
    "a traced mesh": (
        traced(lambda x: geometry.mass_properties((x * jnp.eye(3), np.array([[0, 1, 2]])), 1.0).mass),
        "shape must be known before tracing where it is a mesh",
    ),
    "a traced spline of a surface": (
        traced(lambda x: geometry.mass_properties(field(x), 1.0).mass),
        "shape must be known before tracing unless in closed form, but was a SplineSurface",
    ),
    "points without end": (lambda: _outline.outline(jxr.Circle(1.0), 1e-19), "tolerance must need at most"),
    "grey values in rows of two lengths": (
        lambda: jxr.io.read_silhouette([[1, 2], [3]], pixel=1.0),
        "image must be grey values of one shape",
    ),
    "grey values of NaN": (
        lambda: jxr.io.read_silhouette(np.full((9, 9), np.nan), pixel=1.0),
        "image must be finite",
    ),
    "grey values beyond measure": (
        lambda: jxr.io.read_silhouette(1e200 * np.eye(9), pixel=1.0),
        "image must have values of at most 1e\\+100, but had one of 1e\\+200",
    ),
    "grey values all alike": (
        lambda: jxr.io.read_silhouette(np.ones((9, 9)), pixel=1.0),
        "image must show a shape, but its values, 1 to 1, are all alike",
    ),
    "grey values below the threshold": (
        lambda: jxr.io.read_silhouette(np.eye(9), pixel=1.0, threshold=5.0),
        "image must show a shape, but its values, 0 to 1, do not cross the threshold of 5",
    ),
    "a shape in an image's corner": (
        lambda: jxr.io.read_silhouette(np.pad([[1.0]], ((0, 8), (0, 8))), pixel=1.0),
        "image must show the whole shape, but the border cuts outline 0",
    ),
    "many frames": (lambda: _doors.check_frames("frames", 1e9), "frames must leave at most .* asks for 1e"),
    "a number for a surface": (
        lambda: _meshes._mesh(3, (8, 8), None, np.zeros(3)),
        "surface must be a surface that can be drawn",
    ),
    "a map in a text file": (
        lambda: plotting.map_page(Parameters.grid(a=[1.0, 2.0]), [1, 2], "map.txt"),
        "path must end in .html, but was 'map.txt'",
    ),
    "traced parameters": (
        traced(lambda x: Parameters(a=x)),
        "a must be a number or an array of numbers, but was .*: parameters are known before",
    ),
    "many rows": (
        lambda: Parameters.grid(a=np.arange(1e5), b=np.arange(1e5)),
        "must leave at most .* rows, but 10000000000 were asked for",
    ),
    "no tips": (
        lambda: jxr.io.load_hand("hand.urdf", {}),
        "tips must name one tip link or more, but named none",
    ),
    "no name": (lambda: _named("/"), "path must name a file, but was '/'"),
    "a traced share": (traced(lambda x: as_share("share", x)), "share must be known before tracing"),
    "a share of two": (lambda: as_share("share", 2.0), "share must be a number from 0 to 1"),
    "contours of two sizes": (
        lambda: design._shape_transform.as_batch([jxr.Spline(ROUND), jxr.Spline(ROUND[::2])]),
        "tip must be contours of one size",
    ),
    "more gains than errors": (
        lambda: eqx.tree_at(
            lambda c: c.gain, jxr.control.Integral(None, {"x": 0.0}, 1.0), jnp.ones(2)
        ).__check_init__(),
        "targets must name as many errors as there are gains, 2, but named 1",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_seldom_arguments_are_refused_in_one_sentence(name):
    call, words = REFUSED[name]
    with pytest.raises(ValueError, match=f"argument .*{words}"):
        call()


def test_what_a_run_of_ones_own_does_not_hold(scene, run):
    short = jax.tree.map(lambda x: x[:5] if jnp.ndim(x) and x.shape[0] == run.ts.size else x, run)
    cases = {
        "must be one run, but its states have shape": lambda: design.settling_time(
            jax.tree.map(lambda x: jnp.stack([x, x]), run)
        ),
        "a state for each of its times, one or more": lambda: design.settling_time(
            eqx.tree_at(lambda r: r.ts, run, run.ts[:3])
        ),
        "must hold forces for each of its": lambda: design.peak_force(
            eqx.tree_at(lambda r: r.multipliers, run, short.multipliers)
        ),
        "must hold real numbers as multipliers": lambda: design.peak_force(
            eqx.tree_at(lambda r: r.multipliers.f, run, run.multipliers.f.astype(int))
        ),
        "signal must hold numbers, NaN where there is none": lambda: design.settling_time(
            run, signal=jnp.full(run.ts.size, jnp.inf)
        ),
        "names must have one for each of 2 runs, but had 1": lambda: plotting.comparison(
            [run, run], names=["a"]
        ),
        "must have recorded their multipliers, but the run 'b' has none": lambda: plotting.comparison(
            [run, eqx.tree_at(lambda r: r.multipliers, run, None)], names=["a", "b"]
        ),
        "long enough to move time from 1 s, but was 1e-20": lambda: jxr.simulate(
            *scene, 2.0, t0=1.0, ts=3, dt0=1e-20
        ),
    }
    for words, call in cases.items():
        with pytest.raises(ValueError, match=words):
            call()


def test_parameters_are_compared_with_parameters_alone():
    one = Parameters.grid(a=[1.0, 2.0])
    assert (one == 3) is False and bool(one)


def test_orders_of_smoothness():
    spline = jxr.Spline(ROUND)
    endless = (
        jxr.Line(), jxr.Circle(0.01), jxr.Ellipse(0.02, 0.01), jxr.Catenary(0.01), jxr.Plane(),
        jxr.Sphere(0.01), geometry.Cylinder(0.01), jxr.Ellipsoid(0.03, 0.02, 0.01), jxr.Torus(0.03, 0.01),
        geometry.Superellipsoid(0.03, 0.02, 0.01, exponent=4.0),
    )  # fmt: skip
    assert all(shape.smoothness == math.inf for shape in endless)
    for exponent, order in ((2.5, 2.0), (3.0, 2.0), (3.5, 3.0)):
        assert geometry.Superellipsoid(0.03, 0.02, 0.01, exponent=exponent).smoothness == order
    assert spline.moved((0.1, 0.0)).smoothness == spline.smoothness == geometry.Extruded(spline).smoothness


def test_series_are_perturbed_less_and_less():
    """A term of order k changes the radius of curvature by k^2 - 1 times its size: it stays positive."""
    start = jxr.SupportFunction(0.01, np.zeros(40), np.zeros(40))
    moved = [start.perturbed(np.random.default_rng(seed)) for seed in range(200)]
    for name in ("cosines", "sines"):
        size = np.std([getattr(each, name) for each in moved], axis=0)
        np.testing.assert_allclose(size / size[0], np.arange(1.0, 41.0) ** -3, rtol=0.3)
    assert all(each.radius == start.radius for each in moved)
    assert not np.array_equal(moved[0].cosines, moved[0].sines)


def test_tables_have_as_many_columns_as_their_first_line_with_a_number(tmp_path):
    kinds = {"a.npy": np.zeros((4, 3)), "flat.npy": np.zeros(4)}
    for name, array in kinds.items():
        np.save(tmp_path / name, array)
    (tmp_path / "odd.npy").write_bytes(b"no array")
    (tmp_path / "a.csv").write_text("x,y\n# 3\n1,2\n")
    (tmp_path / "none.csv").write_text("x,y\n")
    names = ("a.npy", "flat.npy", "odd.npy", "a.csv", "none.csv")
    assert [_tables.table_width(tmp_path / name) for name in names] == [3, 0, 0, 2, 0]


def test_a_drawing_without_a_box_counts_pixels_of_an_inch():
    assert _svg._svg_scale({"width": "60mm"}, None) == 0.0254 / 96
    assert _svg._svg_scale({"width": "60mm", "viewBox": "0,0,30,30"}, None) == pytest.approx(2e-3)
    assert _svg._svg_scale({"width": "60"}, None) is None


def test_motions_that_do_not_fit_their_grasp():
    grasp = SimpleNamespace(fingers=(1, 2), contacts=(1, 2))
    for on_tip, times, words in ((3, 3, "2 contacts, but had 3"), (2, 0, "at least one time, but had none")):
        with pytest.raises(ValueError, match=f"argument motion must have {words}"):
            _scene3._matched(grasp, SimpleNamespace(tips=[0, 0], on_tip=[0] * on_tip, times=times))
    shapes = {"body": np.zeros((3, 7)), "tips": np.zeros((2, 3, 7)), "skeletons": ()}
    with pytest.raises(ValueError, match="skeletons must have one entry for each of 2 fingers, but had 0"):
        _motion3.Motion3D(**shapes, **dict.fromkeys(_motion3._AT_CONTACTS, np.zeros((2, 3, 3))))


def test_the_verdict_on_a_fitted_surface_names_what_speaks_against_it():
    """A bend sharper than waves of the smoothing have, or a point far off; a fit with neither is praised."""
    verdict = lambda bends, far, **more: _surface_fit._verdict(bends, 0.02, 1e-5, far, **more)[0]  # noqa: E731
    good = verdict((-50.0, 200.0), 5e-5)
    assert good == "the points lie 10 um rms from it, and it bends no more than its smoothing"
    sharp = verdict((-400.0, 200.0), 5e-5)
    assert sharp == "not to be trusted: it bends with a radius of 2.5 mm; give smallest_radius"
    far = verdict((-50.0, 200.0), 2e-3)
    assert far == "not to be trusted: a point is 2 mm off it; give smallest_radius"
    both = verdict((-50.0, 400.0), 2e-3)
    assert both.endswith("radius of 2.5 mm and a point is 2 mm off it; give smallest_radius")
    for degrees, told in (
        (57.0, good),
        (58.0, "not to be trusted: its normals are 58 degrees rms off those"),
    ):
        assert verdict((-50.0, 200.0), 5e-5, turned=np.radians(degrees)).startswith(told)


def test_arrays_are_told_by_what_they_hold():
    assert _printing._numbers(np.arange(40).reshape(4, 10) < 7) == "4 x 10, 7 true"
    assert _printing._numbers(np.full(30, np.nan)) == "30, none finite"
    assert _printing._numbers(np.where(np.arange(30) < 2, np.nan, 1.0)).endswith(", 2 not finite")


def test_reports_without_names_and_without_states():
    assert _report.joint_name(None, 3) == "joint 3" and _report.contact_name(None, 1) == "contact 1"
    assert _report._at_the_end(None, np.full((4, 3), np.nan), "at the end") == []


def test_progress_that_is_printed(capsys, monkeypatch):
    _network_descent._printed(25, 1.5e-3)
    _minimise._printed(10, 0.25, 1e-4)
    assert capsys.readouterr().out.splitlines() == [
        "step 25: loss 1.500e-03",
        "step 10: objective 0.25, limits passed by 1.0e-04",
    ]
    for terminal in (False, True):
        monkeypatch.setattr(sys, "stderr", said := io.StringIO())
        monkeypatch.setattr(said, "isatty", lambda terminal=terminal: terminal, raising=False)
        _progress(1, 2)
        _progress(2, 2)
        assert said.getvalue().count("Animating ... ") == 2 * terminal
        assert said.getvalue().rstrip().endswith("2 of 2 frames,") == terminal


def test_a_figure_is_shown_as_png():
    assert _style.Picture(1.0, 1.0)._repr_png_()[:4] == b"\x89PNG"


def test_an_identification_ends_with_the_cause():
    search, broken = jxr.RESULTS.undetermined, _identify._BROKEN[1]
    number = int(_identify.number_of(broken)[1])
    assert _identify._outcome(jxr.RESULTS.successful, number, told=True) == broken
    assert _identify._outcome(jxr.RESULTS.successful, 0, told=True) == jxr.RESULTS.successful
    assert _identify._outcome(jxr.RESULTS.successful, 0, told=False) == search


def test_ranges_of_toml():
    assert _sweep_order._range("a", 3).values == (3.0,)
    assert _sweep_order._range("a", [1, [2, 3.5]]).values == (1.0, (2.0, 3.5))


def test_variables_of_closures_that_have_no_value_yet():
    assert not _closures._full(types.CellType()) and _closures._full(types.CellType(0))
