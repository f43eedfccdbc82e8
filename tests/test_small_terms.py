"""What runs in other tests and is not looked at there: found by changes to the code that nothing noticed."""

import html
import types
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxroll as jxr
from jaxroll import plotting
from jaxroll._closures import opened
from jaxroll._fingerprint import fingerprint
from jaxroll._integration._step import RollingStep
from jaxroll._linalg import pose_at, unstack, Vec3
from jaxroll._why import _pairs
from jaxroll.contact import Touch3
from jaxroll.geometry.contours._neural_curvature import _Cloud, _residuals, _start
from jaxroll.plotting import _animate3
from jaxroll.plotting._forces3 import pushes
from jaxroll.plotting._loci_figure import _curves
from jaxroll.plotting._style import Picture
from jaxroll.plotting._views import _placed
from jaxroll.plotting._views3 import scene_motion
from tests.recorded import runs

STILL = pose_at(Vec3(0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def ball():
    """A ball on a slope, with its forces: grasp and run."""
    grasp, state = jxr.scenes.incline()
    return grasp, jxr.simulate(grasp, state, 0.1, ts=5, record=("multipliers",))


def test_responses_in_space_show_the_forces_of_the_run(ball):
    grasp, run = ball
    axes = {ax.get_ylabel(): ax for ax in plotting.responses(grasp, run).axes}
    along = np.linalg.norm(run.multipliers.lam, axis=-1)
    drawn = {
        "$f$ [N]": run.multipliers.f,
        r"$|\lambda|$ [N]": along,
        r"$|\lambda| / |f|$": along / run.multipliers.f,
    }
    for title, wanted in drawn.items():
        np.testing.assert_allclose(axes[title].lines[0].get_ydata(), np.asarray(wanted)[:, 0], rtol=1e-12)
    np.testing.assert_allclose(along / run.multipliers.f, 2.0 / 7.0 * np.tan(0.3), rtol=1e-9)


def test_forces_drawn_on_a_ball_and_its_weight_are_what_moves_it(ball):
    """Mass times acceleration, which on a slope is constant: by differences of the velocity."""
    grasp, run = ball
    mass, v = float(grasp.object.mass), np.asarray(run.states.v)[:, :3]
    forces = pushes(grasp, run, scene_motion(grasp, run.states)).contacts.sum(axis=0)
    wanted = mass * np.diff(v, axis=0) / np.diff(run.ts)[:, None]
    assert np.linalg.norm(wanted, axis=1).min() > 0.1  # N
    np.testing.assert_allclose((forces + mass * np.asarray(grasp.gravity))[1:], wanted, atol=1e-9)


def test_loci_of_a_contact_that_rests_have_axes_to_be_read():
    """No curvature is known there; nothing is divided by their length, and matplotlib has nothing to say."""
    names = ("normal_curvature", "geodesic_curvature", "geodesic_torsion", "torsion")
    still = {"arclength": np.zeros((1, 5)), "speed": np.zeros((1, 5))}
    locus = types.SimpleNamespace(**still, **dict.fromkeys(names, np.full((1, 5), np.nan)))
    axes = Picture(4.0, 6.0).subplots(4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _curves(axes, types.SimpleNamespace(tip=locus, object=locus), 0)
    for ax in axes:
        (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
        assert left == 0.0 < right < 10.0 and -10.0 < low < 0.0 < high < 10.0


def test_pairs_of_forces_are_those_of_each_contact():
    forces = types.SimpleNamespace(f=np.array([1.0, 2.0]), lam=np.array([[3.0, 0.0, 4.0], [0.0, 5.0, 12.0]]))
    assert _pairs(forces) == [(1.0, 5.0), (2.0, 13.0)]
    plane = types.SimpleNamespace(f=np.array([1.0, 2.0]), lam=np.array([-0.5, 0.25]))
    assert _pairs(plane) == [(1.0, 0.5), (2.0, 0.25)]


def test_flat_on_flat_has_no_curvature_and_is_a_number():
    flat = jxr.Plane()
    touch = Touch3(*(flat.frame(flat.settled(tuple(unstack(jnp.zeros(3))))) for _ in range(2)))
    assert float(jxr.Contact3(0, 0).curvature_margin((flat, flat), None, (STILL, STILL), touch)) == 0.0


def test_contact_points_are_drawn_on_the_object():
    """Where the object was turned and moved, by its pose and its contour."""
    grasp, run = runs.scene("pivoted")[0], runs.run("pivoted", times=3)
    points = np.asarray(_placed(grasp, run.states)[2])[:, 0]
    theta, face = np.asarray(run.states.q[:, 0]), grasp.object.contours[0]
    own = np.asarray(face.point(grasp.contacts[0].s_object - run.states.s[:, 0]))
    turned = np.stack(
        [
            np.cos(theta) * own[:, 0] - np.sin(theta) * own[:, 1],
            np.sin(theta) * own[:, 0] + np.cos(theta) * own[:, 1],
        ],
        axis=-1,
    )
    moved = points - turned
    np.testing.assert_allclose(moved - moved[0], 0.0, atol=1e-14)  # the pivot does not move
    assert np.abs(np.diff(turned, axis=0)).max() > 1e-4


def test_what_has_a_kind_of_numbers_and_none_of_them_is_told_apart_by_its_shape():
    forms = [jax.ShapeDtypeStruct(shape, np.float64) for shape in ((2,), (3,), (2,))]
    first, second, third = map(fingerprint, forms)
    assert first == third != second


def _kind(factor, offset):
    class Line:
        slope = factor

        def at(self, x):
            return self.slope * x + offset

        @staticmethod
        def none():
            return offset

        def __call__(self, x):
            return self.at(x)

    return Line


def test_a_law_that_holds_a_traced_number_is_told_by_the_globals_that_it_reads():
    """Those of a notebook grow with every cell: a sweep would be another one after the next."""
    space = {"gain": 1.0}
    exec("def law_with(x):\n    return lambda t, *joints: [gain * x]", space)

    def seen():
        found = []
        jax.eval_shape(lambda x: found.append(fingerprint(opened(space["law_with"](x)))), 1.0)
        return found[0]

    first = seen()
    space["other"] = object()
    assert seen() == first
    space["gain"] = 2.0
    assert seen() != first


def test_classes_of_ones_own_are_told_apart_by_their_methods_and_constants():
    """By what a sweep would compute with them: not by their name, and not by which class statement ran."""
    same, again, steeper, shifted = (fingerprint(_kind(*c)) for c in ((2, 1), (2, 1), (3, 1), (2, 0)))
    assert same == again and len({same, steeper, shifted}) == 3


def test_distances_of_points_from_the_curve_they_were_taken_from_are_small():
    """The start of a fit follows an ellipse to a thousandth of its size: so do the distances."""
    u = 2.0 * np.pi * np.arange(64) / 64
    points = np.stack([0.02 * np.cos(u), 0.014 * np.sin(u)], axis=-1)
    slope, at, places = _start(points)
    cloud = _Cloud(points=jnp.asarray(points), places=jnp.asarray(places))
    assert np.abs(jax.jit(_residuals)(jnp.asarray(slope), at, cloud)).max() * 8 < 2e-5


def test_an_animation_in_space_says_its_pace_and_its_time(ball, tmp_path, monkeypatch):
    said, real = [], _animate3.heading
    monkeypatch.setattr(
        _animate3, "heading", lambda figure, text, *a, **b: said.append(text) or real(figure, text, *a, **b)
    )
    plotting.animate(*ball, tmp_path / "ball.gif", fps=10, speed=0.5)
    assert "shown at 0.5 x real time" in said


def test_a_page_waits_to_be_played(ball, tmp_path):
    text = html.unescape(plotting.page(*ball, tmp_path / "ball.html", frames=2).read_text())
    assert '"displaylogo": false' in text


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_curvatures_of_two_ellipsoids_add_up_as_they_are_turned(angle):
    """At their poles, principal axes at an angle: the determinant of the sum over its size, by NumPy."""
    shapes = jxr.Ellipsoid(0.02, 0.01, 0.008), jxr.Ellipsoid(0.03, 0.012, 0.01)
    tip, body = (shape.frame((0.0, 0.0, z)) for shape, z in zip(shapes, (-0.008, 0.01), strict=True))
    turned = pose_at(Vec3(0.0, 0.0, 0.018), (np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)))
    bends = [np.diag([c / a**2, c / b**2]) for a, b, c in ((0.02, 0.01, 0.008), (0.03, 0.012, 0.01))]
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    whole = turn @ bends[0] @ turn.T + bends[1]
    wanted = np.linalg.det(whole) / sum(np.sum(bend**2) for bend in bends)
    found = jxr.Contact3(0, 0).curvature_margin(shapes, None, (turned, STILL), Touch3(tip, body))
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


@pytest.mark.parametrize("times", [None, np.arange(5)], ids=["none", "whole numbers"])
def test_a_run_whose_times_are_no_real_numbers_has_no_loci(ball, times):
    grasp, run = ball
    broken = eqx.tree_at(lambda run: run.ts, run, times)
    with pytest.raises(ValueError, match="argument trajectory must hold real numbers as ts, but had "):
        jxr.loci(grasp, broken)


@pytest.mark.parametrize(
    ("rolled", "carried", "leapt"),
    [
        # A long step, set right by a tenth of it; by all of it; and one that the projection took back.
        (5e-3, 5e-4, False),
        (5e-3, 5e-3, True),
        (5e-3, -5e-3, True),
        # Near where it was, a contact may be carried by 0.1 mm.
        (0.0, 5e-5, False),
        (0.0, 5e-4, True),
    ],
)
def test_a_contact_has_leapt_if_the_projection_carried_it_and_not_the_step(rolled, carried, leapt):
    """Two contacts after two coordinates and velocities: the second one stays where it is."""
    step = types.SimpleNamespace(lay=types.SimpleNamespace(form=types.SimpleNamespace(counts=(2, 2, 2))))
    before = np.array([0.3, 0.1, -0.2, 0.4, 2e-3, -1e-3])
    raw = before + np.array([1.0, 1.0, 1.0, 1.0, rolled, 0.0])
    after = raw + np.array([1.0, 1.0, 1.0, 1.0, carried, 0.0])
    assert bool(RollingStep._leapt(step, before, raw, after)) == leapt
