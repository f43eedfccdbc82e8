"""Figures of a pinch: what they show is what was simulated."""

import dataclasses
import decimal
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import jaxroll as jxr
from jaxroll.plotting._artists import limits
from jaxroll.plotting._contours import _name_contacts
from jaxroll.plotting._forces import arrows
from jaxroll.plotting._phase_one import check_potential, has_one_direction, phase_of_one
from jaxroll.plotting._phase_parts import on_contour
from jaxroll.plotting._responses import _DASHES, _dashes, _stretch
from jaxroll.plotting._views import views
from tests.recorded import runs
from tests.subjects.disc_between_jaws import disc_between_jaws


@pytest.fixture(scope="module")
def pinch():
    """The scene: grasp and closed state."""
    return runs.scene("pinch")


@pytest.fixture(scope="module")
def short():
    """A made run of 50 ms."""
    return runs.run("pinch", t1=0.05)


def test_responses_show_both_contacts_in_the_chapters_symbols(pinch, short):
    axes = jxr.plotting.responses(pinch[0], short).axes
    labels = [ax.get_ylabel() for ax in axes]
    names = [{text.get_text() for text in ax.get_legend().get_texts()} for ax in axes if ax.get_legend()]
    assert len(axes) == 15
    forces = ("$f_i$ [N]", r"$\lambda_i$ [N]", r"$\Delta f_i$ [N]", r"$\Delta\lambda_i$ [N]")
    assert {*forces, "$s_i - s_i(0)$ [mm]", "$U$ [mJ]"} <= set(labels)
    for wanted in ({"$f_1$", "$f_2$"}, {r"$\Delta N_1$", r"$\Delta N_2$", "$S_N$"}, {"$Q_1$", "$Q_2$"}):
        assert wanted in names
    drawn = np.array([line.get_ydata() for line in axes[labels.index(r"$\Delta f_i$ [N]")].lines[:2]]).T
    np.testing.assert_array_equal(drawn, jxr.pinch_balance(pinch[0], short.ts, short.states).delta_f)


def test_lines_that_lie_on_others_are_dashed():
    """Within a hundredth of the range that the panel shows, or of its least range."""
    t = np.linspace(0.0, 1.0, 11)
    lines = np.stack([t, t + 0.009, t + 0.005, t + 0.02, 1.0 - t], axis=1)
    assert [_dashes(lines, k, None) for k in range(5)] == ["-", _DASHES[0], _DASHES[1], "-", "-"]
    steady = np.stack([1.0 + 0.0 * t, 1.0009 + 0.0 * t, 1.002 + 0.0 * t], axis=1)
    assert [_dashes(steady, k, None) for k in range(3)] == ["-", _DASHES[0], "-"]
    assert [_dashes(steady, k, 1.0) for k in range(3)] == ["-", _DASHES[0], _DASHES[1]]
    assert _dashes(np.stack([t, t + np.where(t < 0.5, np.nan, 0.5)], axis=1), 1, None) == "-"


def test_time_is_stretched_only_where_the_rolling_is_over_early(pinch, short):
    still = dataclasses.replace(short, ts=short.ts.at[-1].set(2.0))
    scales = [jxr.plotting.responses(pinch[0], run).axes[0].get_xscale() for run in (short, still)]
    assert scales == ["linear", "function"]


def test_a_stretched_axis_has_ticks_in_every_decade():
    """Rolling that is over in 0.3 s of ten, or goes on."""
    ts = 2.0 + np.linspace(0.0, 10.0, 1001)
    ax = Figure().subplots()
    early = _stretch(ax, ts, np.minimum((ts - 2.0) / 0.3, 1.0)[:, None])
    assert early == pytest.approx(2.27, abs=0.011) and ax.get_xlim() == (2.0, 12.0)
    np.testing.assert_allclose(ax.get_xticks(), [2.0, 2.1, 2.3, 3.0, 5.0, 12.0])
    assert [label.get_text() for label in ax.get_xticklabels()] == ["2", "2.1", "2.3", "3", "5", "12"]
    # From the start to `early` it is as wide as from there to sinh(2 asinh(1)) = sqrt(8) times as far.
    places = ax.transScale.transform([(t, 0.0) for t in (2.0, early, 2.0 + (early - 2.0) * 8.0**0.5)])[:, 0]
    assert np.diff(places)[0] == pytest.approx(np.diff(places)[1]) and places[0] == 0.0
    ax = Figure().subplots()
    assert _stretch(ax, ts, ts[:, None]) is None and ax.get_xscale() == "linear"


def test_forces_drawn_accelerate_the_object():
    """The arrows, in newtons, add up to mass times acceleration by differences of the velocity."""
    grasp, state = disc_between_jaws()
    # All move along x, and are damped.
    state = jxr.State(state.q, np.array([0.1, 0.0, 0.0, 0.1, 0.1]), state.s)
    run = jxr.simulate(grasp, state, 0.05, record=("multipliers",))
    seen = views(grasp, run.states)
    drawn = arrows(grasp, run, np.arange(301), seen, corners=limits(seen))
    total = drawn.vectors.sum(axis=1) / drawn.scale
    wanted = float(grasp.object.mass) * np.gradient(run.states.v[:, :2], run.ts, axis=0)
    far = np.abs(total - wanted)[5:-5].max()
    assert far < 1e-3 * np.abs(wanted).max()
    assert np.linalg.norm(drawn.vectors, axis=-1).max() == pytest.approx(drawn.scale * drawn.peak)


def test_a_legend_names_forces_where_they_are_drawn(pinch, short):
    for forces in (True, False):
        figure = jxr.plotting.poses(pinch[0], short, times=(0.0,), forces=forces)
        names = [text.get_text() for text in figure.legends[0].get_texts()]
        assert ("contact force on the object" in names) == forces and "fingertip" in names


def test_forces_must_have_been_recorded(pinch, short, tmp_path):
    bare = dataclasses.replace(short, multipliers=None)
    for draw in (
        lambda: jxr.plotting.poses(pinch[0], bare, forces=True),
        lambda: jxr.plotting.animate(pinch[0], bare, tmp_path / "motion.gif", forces=True),
    ):
        with pytest.raises(ValueError, match="record=") as error:
            draw()
        assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_animation_ends_where_it_is_told(pinch, short, tmp_path):
    """Numbers may be those of any library."""
    seen = []
    path = jxr.plotting.animate(
        pinch[0],
        short,
        tmp_path / "motion.gif",
        fps=20,
        speed=0.1,
        until=decimal.Decimal("0.025"),
        size=3,
        progress=lambda done, total: seen.append((done, total)),
    )
    with Image.open(path) as image:
        assert image.n_frames == 6
    assert seen == [(k, 6) for k in range(1, 7)]
    with pytest.raises(ValueError, match="until"):
        jxr.plotting.animate(pinch[0], short, path, until=-1.0)


def test_phase_draws_the_path_and_the_equilibrium(pinch, short):
    grasp, state = pinch
    figure = jxr.plotting.phase(grasp, short, rest=state)
    path, start, end, rest = figure.axes[0].lines
    s = 1e3 * np.asarray(jxr.pinch_balance(grasp, short.ts, short.states).s)
    np.testing.assert_allclose(path.get_xydata(), s, atol=1e-12)
    for mark, point in ((start, s[0]), (end, s[-1]), (rest, (4.0, -3.0))):
        np.testing.assert_allclose(mark.get_xydata()[0], point, atol=1e-9)


def test_phase_refuses_other_grasps(scene, short, run):
    with pytest.raises(ValueError, match=r"argument trajectory.states.q must have shape \(3,\)"):
        jxr.plotting.phase(scene[0], short)
    with pytest.raises(ValueError, match=r"control\.Opposition"):
        jxr.plotting.phase(scene[0].with_(controller=None), run)
    for number in ({"force": lambda t: 0.5 + t}, {"target": jxr.commands.Steps([1.0], np.zeros((2, 2)))}):
        with pytest.raises(ValueError, match="of which there is no potential; .* holds it"):
            jxr.plotting.phase(scene[0].with_(**number), run)


def test_phase_of_one_direction_draws_the_path_downhill(scene):
    """Along it the energy that the levels show falls by what damping takes; the same for a sampled law."""
    grasp, state = scene
    run = jxr.simulate(grasp, state, 1.0, record=("multipliers", "energy"))
    figure = jxr.plotting.phase(grasp, run, rest=state)
    ax = figure.axes[0]
    path, start, end = ax.lines[:3]
    contact = grasp.contacts[0]
    s = 1e3 * contact.sense * (float(contact.s_object) - np.asarray(run.states.s)[:, 0])
    found = path.get_xydata()
    np.testing.assert_allclose(found[:, 0], s, atol=1e-12)
    np.testing.assert_allclose(np.gradient(s, np.asarray(run.ts))[120:-1], found[120:-1, 1], atol=0.05)
    np.testing.assert_allclose(start.get_xydata()[0], found[0])
    # Free space of a fifth either way, round the equilibrium too; it is at rest.
    goal = ax.lines[3].get_xydata()
    at_rest = 1e3 * contact.sense * float(contact.s_object - state.s[0])
    np.testing.assert_allclose(goal, [[at_rest, 0.0]], atol=1e-9)
    every = np.concatenate([found, goal])
    middle, half = 0.5 * (every.min(axis=0) + every.max(axis=0)), 0.7 * np.ptp(every, axis=0)
    np.testing.assert_allclose(
        [ax.get_xlim(), ax.get_ylim()], np.stack([middle - half, middle + half], axis=1)
    )
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["path", "start, 0 s", "end, 1 s", "equilibrium"]
    assert figure.axes[1].get_ylabel() == "$K + U$ [mJ]" and 8 <= len(ax.collections[0].levels) <= 18
    # The level that the picture has under the path is the run's own energy.
    filled = ax.collections[0]
    energy = 1e3 * np.asarray(run.energy.kinetic + run.energy.potential)
    for k in (60, 180, 300):
        inside = [i for i, each in enumerate(filled.get_paths()) if each.contains_point(found[k])]
        low, high = filled.levels[inside[-1]], filled.levels[inside[-1] + 1]
        assert low - 1e-3 <= energy[k] <= high + 1e-3
    sampled = grasp.with_(controller=jxr.control.Sampled(grasp.controller, 0.01))
    assert has_one_direction(sampled)
    check_potential(sampled)
    # What hardly moves is not magnified without end: half a millimetre, a millimetre per second either way.
    # As many states as above, the one of rest among them.
    start = (state.q, 1e-6 * run.states.v[60], state.s, np.zeros(2))
    rows = [np.tile(x, (len(s) + 1, 1)) for x in start]
    still = dataclasses.replace(run, ts=np.linspace(0.0, 1e-6, len(s) + 1), states=jxr.State(*rows))
    resting = phase_of_one(sampled, still, None).axes[0]
    np.testing.assert_allclose([np.ptp(resting.get_xlim()), np.ptp(resting.get_ylim())], [1.0, 2.0])
    # Where no equilibrium is known none is drawn.
    assert len(resting.lines) == len(ax.lines) - 1


@pytest.mark.parametrize(("apart", "sides"), [(8.0, (-8, 8)), (15.0, (0, 0))])
def test_names_of_contacts_stand_apart_where_a_tenth_of_the_axis_is_not_between_them(apart, sides):
    above, below = Figure().subplots(1, 2)
    below.set_xlim(0.0, 100.0)
    contacts = [SimpleNamespace(s_object=s) for s in (0.03, 0.03 + 1e-3 * apart)]
    grasp = SimpleNamespace(contacts=contacts, shapes=lambda contact: (None, jxr.Circle(0.02)))
    _name_contacts(above, below, grasp)
    assert [text.get_text() for text in below.texts] == ["$P_{1}$", "$P_{2}$"]
    assert [text.xyann for text in below.texts] == [(side, 11) for side in sides]
    np.testing.assert_allclose([text.xy[0] for text in below.texts], [30.0, 30.0 + apart])
    # In the upper picture inside the object, towards the middle of the circle.
    for text in above.texts:
        np.testing.assert_allclose(np.array(text.xyann) / 14.0, -np.array(text.xy) / 20.0, atol=1e-9)


def test_places_off_the_ends_of_a_contour_are_left_out():
    s = np.array([-2.0, -1.0, 0.5, 1.0, 1.5])
    assert on_contour(jxr.Line((-1.0, 1.0)), s).tolist() == [False, True, True, True, False]
    assert on_contour(jxr.Line(), s).all() and on_contour(jxr.Circle(0.1), s).all()
