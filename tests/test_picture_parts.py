"""Pieces of pictures by hand-worked cases: what is shown, how far axes go, which words stand where."""

import contextlib
import dataclasses
from types import SimpleNamespace

import equinox as eqx
import jax
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import proj3d
from PIL import Image

import jaxroll as jxr
from jaxroll._mechanics import Coordinate
from jaxroll._motion import Energy
from jaxroll.plotting import (
    _animate,
    _animate3,
    _artists,
    _artists3,
    _contact_figure,
    _contours,
    _design_figure,
    _doors,
    _drawing3,
    _film,
    _fit_figure,
    _forces,
    _forces3,
    _gif,
    _loci_figure,
    _meshes,
    _outlines,
    _page,
    _page_parts,
    _page_plane,
    _panels,
    _panels3,
    _phase,
    _phase_one,
    _phase_parts,
    _pose,
    _poses3,
    _rays,
    _responses,
    _scene3,
    _style,
    _surface_fit_figure,
    _tags,
    _tubes,
    _views,
    _views3,
)
from jaxroll.plotting._motion3 import Motion3D
from jaxroll.plotting._outlines import _backed, _joined, Outline, OutlineSamples, sample
from tests.measures import programs
from tests.recorded import runs
from tests.subjects import stand_in_grasp

NAN = np.nan


def axes():
    return Figure().subplots()


def lines_of(ax):
    return [line.get_xydata() for line in ax.lines]


# Times and files of animations and pages.


def test_frames_are_the_saved_states_nearest_to_even_times_and_the_last():
    """The last but one is at least half a step before the end."""
    ts = 2.0 + np.array([0.0, 0.1, 0.25, 0.3, 0.55, 0.6, 1.0])
    assert _gif.nearest_rows(ts, 0.3).tolist() == [0, 3, 5, 6]
    even = 5.0 + np.linspace(0.0, 1.0, 21)
    assert _gif.nearest_rows(even, 0.35).tolist() == [0, 7, 14, 20]
    assert _gif.nearest_rows(even, 0.4).tolist() == [0, 8, 20]
    assert _gif.nearest_rows(even, 1.5).tolist() == [0, 20]
    assert _gif.nearest_rows(even[:1], 0.1).tolist() == [0]


def test_a_film_keeps_small_colours_exactly_and_what_is_nearly_white_is_white(tmp_path):
    """Its colours are those of the first, the middle and the last frame."""
    colours = [(200, 30, 40), (120, 120, 120), (30, 160, 60), (10, 10, 10), (40, 60, 190)]
    frames = [Image.new("RGB", (40, 30), colour) for colour in colours]
    for frame, grey in ((frames[0], 248), (frames[2], 240)):
        frame.paste((grey, grey, grey), (10, 0, 30, 20))
    frames[1].paste((0x12, 0x34, 0x56), (30, 20, 32, 22))
    path = tmp_path / "film.gif"
    _gif.write(path, frames, [40, 50, 60, 70, 900], ("#123456", "white"))
    seen, times = [], []
    with Image.open(path) as film:
        assert film.n_frames == 5 and film.info["loop"] == 0
        for k in range(5):
            film.seek(k)
            times.append(film.info["duration"])
            seen.append(np.asarray(film.convert("RGB"), int))
    assert times == [40, 50, 60, 70, 900]
    for k in (0, 2, 4):
        assert np.abs(seen[k][25, 2] - colours[k]).max() <= 4
    assert (seen[0][5, 20] == 255).all() and np.abs(seen[2][5, 20] - 240).max() <= 4
    # A colour that is to be kept is there, whatever the three frames show; black gets the nearest there is.
    assert tuple(seen[1][21, 31]) == tuple(seen[3][5, 5]) == (0x12, 0x34, 0x56)


@pytest.mark.parametrize(
    ("fps", "speed", "end", "delay", "rows"),
    [
        (25.0, 1.0, 0.4, 40, [0, 4, 8, 12, 16, 20, 24, 28, 32, 36, 40]),
        (3.0, 0.1, 0.4, 330, [0, 3, 7, 10, 13, 16, 20, 23, 26, 30, 33, 36, 40]),
        (1000.0, 5.0, 0.4, 20, [0, 10, 20, 30, 40]),
        (25.0, 0.5, 59 * 0.05 * 0.5, 50, None),
        (10.0, 2.0, 59 * 0.121 * 2.0, 130, None),
    ],
)
def test_an_animation_in_space_has_at_most_sixty_frames_of_whole_hundredths(fps, speed, end, delay, rows):
    ts = 1.0 + np.linspace(0.0, end, 41)
    found, held = _animate3._paced(ts, fps, speed)
    assert held == delay and found[-1] == 40
    if rows is not None:
        assert found.tolist() == rows
    wanted = 1.0 + 1e-3 * delay * speed * np.arange(len(found) - 1)
    assert np.abs(ts[found[:-1]] - wanted).max() <= 0.5 * end / 40 + 1e-9
    assert len(found) <= 60


def test_an_animation_shows_what_was_reached_until_a_time():
    run = runs.run("pivoted", ended="slipping")
    ts, rows = _animate._shown(run, None)
    assert rows.tolist() == list(range(8)) and ts.tolist() == np.asarray(run.ts)[:8].tolist()
    ts, rows = _animate._shown(run, float(run.ts[3]))
    assert rows.tolist() == [0, 1, 2, 3] and ts[-1] == run.ts[3]
    # As a caller writes a time, and as it was saved: 0.1 times 3, or in single precision.
    for until in (np.nextafter(float(run.ts[3]), 0.0), float(np.float32(run.ts[3])) - 1e-9):
        assert _animate._shown(run, until)[1].tolist() == [0, 1, 2, 3]
    assert _animate._shown(run, 9.0)[1].tolist() == list(range(8))
    with pytest.raises(ValueError, match="argument until must be at least the first saved time"):
        _animate._shown(run, -0.01)


@pytest.mark.parametrize(
    ("span", "frames", "step"),
    [
        (0.7, 8, 0.1),
        (7.5, 4, 2.5),
        (7.0, 3, 5.0),
        (12.0, 11, 2.0),
        (12.0, 4, 5.0),
        (30.0, 6, 10.0),
        (0.9, 2, 1.0),
        (30.0, 26, 2.0),
        (0.02, 21, 0.001),
    ],
)
def test_a_page_stands_at_the_least_round_step_that_leaves_few_enough(span, frames, step):
    ts = 3.0 + np.linspace(0.0, span, 401)
    rows = _page_parts.page_times(ts, frames)
    expected = np.append(np.arange(0.0, span - 0.5 * step, step), span)
    np.testing.assert_allclose(ts[rows] - 3.0, expected, atol=0.5 * span / 400 + 1e-12)
    assert len(rows) <= frames
    assert _page_parts.page_times(np.array([4.0, 4.0]), 5).tolist() == [0]


def test_paths_of_pages_end_in_html_and_pages_have_not_too_many_frames(tmp_path):
    assert _page_parts.checked_page(f"{tmp_path}/a/b.HTM", 5000) == (tmp_path / "a" / "b.HTM", 5000)
    with pytest.raises(ValueError, match="argument frames must leave at most 5000 frames"):
        _page_parts.checked_page("b.html", 5001)


def test_a_drawing_is_a_hundred_inches_wide_at_most():
    assert _doors._size("size", 100) == 100.0 and _doors._size("size", 1e-3) == 1e-3
    for size in (100.1, 0.0, -1.0):
        with pytest.raises(ValueError, match="argument size must be positive and at most 100"):
            _doors._size("size", size)


# Panels over time.


def panel(values, **more):
    return _panels.Panel("some forces", "$f$ [N]", np.array(values), **more)


def test_small_values_have_their_power_of_ten_on_the_label():
    for values, power in (([2.5e-4, -9.0e-4], -4), ([NAN, -3e-8], -8)):
        found = _panels.in_powers(panel(values))
        np.testing.assert_allclose(found.values, np.array(values) / 10.0**power, rtol=1e-12, equal_nan=True)
        assert found.label == f"$f$ [$10^{{{power}}}$ N]" and found.title == "some forces"
    for values in ([1.1e-3, 0.0], [-5.0, 2.0]):
        same = panel(values)
        assert _panels.in_powers(same) is same


def test_what_is_zero_but_for_rounding_is_said_to_be_zero_unless_it_should_be():
    found = _panels.in_powers(panel([0.9e-10, -0.2e-10]))
    assert (found.title, found.least, found.label) == ("some forces: zero", 1e-3, "$f$ [N]")
    assert _panels.in_powers(panel([0.0, 0.0])).least == 1e-3
    assert _panels.in_powers(panel([1.1e-10, 0.0])).label == "$f$ [$10^{-10}$ N]"
    left = _panels.in_powers(panel([0.9e-12, 0.0], left_over=True))
    assert left.label == "$f$ [$10^{-13}$ N]" and left.values[0] == pytest.approx(9.0) and left.least is None
    nothing = panel([0.0, 0.0], left_over=True)
    assert _panels.in_powers(nothing) is nothing


def test_a_tiny_grasp_is_not_told_to_have_no_forces():
    """Of micronewtons and links of 30 micrometres, rounding is a share of these."""
    assert _panels.in_powers(panel([0.9e-12, 0.0]), 1e-6).label == "$f$ [$10^{-13}$ N]"
    assert _panels.in_powers(panel([0.9e-16, 0.0]), 1e-6).title == "some forces: zero"
    bodies = [SimpleNamespace(mass=1e-8), SimpleNamespace(masses=np.array([2e-8, 1e-8])), SimpleNamespace()]
    grasp = SimpleNamespace(bodies=bodies, fingers=[SimpleNamespace(size=3e-5), SimpleNamespace(size=2e-5)])
    scales = _panels.scales_of(grasp, np.array([[NAN], [-2e-6]]))
    expected = {"N": 2e-6, "mm": 0.03, "mm/s": 0.03, "mN m": 6e-8, "mJ": 6e-8}
    assert scales == pytest.approx(expected, rel=1e-12)
    # Without any force its weight is what forces are beside.
    assert _panels.scales_of(grasp, np.zeros((2, 1)))["N"] == pytest.approx(9.81 * 4e-8)
    large = SimpleNamespace(bodies=[SimpleNamespace()], fingers=[SimpleNamespace(size=2.0)])
    assert set(_panels.scales_of(large, np.array([[1e6]])).values()) == {1.0}


def test_each_panel_is_seen_beside_the_scale_of_its_unit(monkeypatch):
    monkeypatch.setattr(_panels, "forces_of", lambda grasp, run: (np.zeros((2, 1)), None))
    monkeypatch.setattr(_panels, "scales_of", lambda grasp, normal: {"N": 1e-6, "mm/s": 1e-3})
    labels = ("$f$ [N]", "velocity [mm/s]", r"$\omega$ [rad/s]", "place")
    given = [_panels.Panel("it", label, np.array([5e-17, 0.0])) for label in labels]
    found = _panels.all_in_powers(SimpleNamespace(), SimpleNamespace(), given)
    assert [each.title for each in found] == ["it: zero"] * 4
    given = [_panels.Panel("it", label, np.array([5e-12, 0.0])) for label in labels]
    found = _panels.all_in_powers(SimpleNamespace(), SimpleNamespace(), given)
    assert [each.title for each in found] == ["it", "it", "it: zero", "it: zero"]


def test_contacts_far_apart_that_move_little_are_drawn_since_the_start():
    way = np.array([[0.0, 0.0], [1.0, -0.5], [NAN, NAN], [0.4, 0.2]])
    apart = _panels._contacts(way + [5.0, 8.9], "0")
    assert apart.label == "$s_i - s_i(0)$ [mm]" and apart.names == ("$s_1$", "$s_2$")
    np.testing.assert_allclose(apart.values, way, atol=1e-12, equal_nan=True)
    near = _panels._contacts(way + [5.0, 8.7], "0")
    assert near.label == "$s_i$ [mm]"
    np.testing.assert_array_equal(near.values, way + [5.0, 8.7])
    still = np.tile([5.0, 90.0], (3, 1))
    assert _panels._contacts(still, "0").label == "$s_i$ [mm]"


def test_what_is_left_over_is_said_to_be_rounding_by_its_own_scale():
    for value, words in ((-0.9e-13, "gap (rounding level)"), (-1.1e-13, "gap")):
        found = _panels.residual_panel("gap", "Q", [NAN, 7.0 * value], size=7.0, names=("a",))
        assert (found.title, found.label, found.names) == (words, "Q", ("a",))
        assert found.left_over and found.width == 0.8
    # The scale of the balance is the largest energy, kinetic and potential together.
    kinetic, potential = np.array([1.0, 2.0, NAN]), np.array([3.0, -5.0, NAN])
    for left, words in ((3.9e-13, "energy balance (rounding level)"), (4.1e-13, "energy balance")):
        energy = Energy(kinetic, potential, np.zeros(3), np.array([0.0, -left, NAN]))
        assert _panels.balance_panel(energy).title == words


def test_part_2_is_one_finger_of_two_joints_that_presses_on_a_pivoted_object():
    grasp = runs.scene("pivoted")[0]
    assert _panels._is_part_2(grasp) is True and _phase_one.has_one_direction(grasp) is True
    bare = grasp.with_(controller=None)
    assert not _panels._is_part_2(bare) and not _phase_one.has_one_direction(bare)


def test_a_panel_of_nearly_constant_values_does_not_magnify_their_last_digits():
    """Within a ten-thousandth of their size; else the values have some room below and above."""
    ts, reached = np.arange(3.0), np.array([True, True, False, True])

    def limits(*values, **more):
        ax = axes()
        _responses._draw(ax, ts, panel([*values[:2], NAN, values[2]], **more), reached)
        return ax

    np.testing.assert_allclose(limits(-5.0, -5.0, -5.0 + 4e-4).get_ylim(), [-5.5 + 2e-4, -4.5 + 2e-4])
    low, high = -5.0, -5.0 + 5e-4
    room = 0.08 * (high - low)
    np.testing.assert_allclose(limits(low, low, high).get_ylim(), [low - room, high + room], rtol=1e-9)
    assert len(limits(low, low, high).lines) == 1 and len(limits(0.0, 1.0, 2.0).lines) == 2
    assert limits(1e-12, 0.0, 0.0, least=1e-3).get_ylim() == (-1e-3, 1e-3)


def test_a_panel_has_room_for_its_legend_above_all_lines():
    ts, reached = np.arange(3.0), np.ones(3, bool)
    rows = {2: 1, 3: 1, 4: 2, 7: 3}
    for count, high in rows.items():
        ax = axes()
        names = tuple(f"line {k}" for k in range(count))
        _responses._draw(
            ax, ts, panel(np.outer([0.0, 1.0, 3.0], 1.0 + np.arange(count)), names=names), reached
        )
        top = 3.0 * count
        low, up = -0.08 * top, 1.08 * top
        np.testing.assert_allclose(ax.get_ylim(), [low, up + 0.17 * high * (up - low)])
        key = ax.get_legend()
        assert [text.get_text() for text in key.get_texts()] == list(names) and key._ncols == min(3, count)
        assert ax.get_xlim() == (0.0, 2.0)
    figure = Figure(figsize=(2.35, 1.5))  # as wide as a panel of three in a row
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    _responses._draw(ax, ts, panel(np.zeros((3, 3)), names=_panels.numbered("contact", 3)), reached)
    figure.draw_without_rendering()
    assert ax.get_legend().get_window_extent().x0 > 0.0 and ax.get_legend()._ncols == 2
    ax = axes()
    _responses._draw(ax, ts[1:2], panel([NAN, 4.0, NAN], names=("one",)), np.array([False, True, False]))
    assert ax.get_legend() is None and ax.lines[0].get_marker() == "o"
    np.testing.assert_array_equal(ax.lines[0].get_xydata(), [[1.0, 4.0]])


# Loci.


def test_a_locus_is_left_out_where_its_contact_all_but_rests():
    speed = np.array([0.0, 0.019, 0.021, 1.0, NAN, -0.5])
    assert _loci_figure._moving(3.0 * speed).tolist() == [False, False, True, True, False, False]
    assert not _loci_figure._moving(np.zeros(3)).any() and not _loci_figure._moving(np.full(2, NAN)).any()


def test_powers_of_ten_of_loci():
    label = r"$\tau$ [1/mm]"
    assert _loci_figure._powers(1e-3, label) == (1.0, label) and _loci_figure._powers(50.0, label)[0] == 1.0
    scale, told = _loci_figure._powers(9e-4, label)
    assert scale == pytest.approx(1e4) and told == r"$\tau$ [$10^{-4}$/mm]"
    values, unit = _loci_figure._in_powers(np.array([2e-9, NAN, -3e-9]))
    np.testing.assert_allclose(values, [2.0, NAN, -3.0], equal_nan=True)
    assert unit == "$10^{-9}$ m"
    values, unit = _loci_figure._in_powers(np.array([0.0, NAN]))
    assert unit == "m" and values[0] == 0.0
    assert _loci_figure._title("Torsion", 1, 2) == "Torsion, contact 2"
    assert _loci_figure._title("Torsion", 0, 1) == "Torsion"


def test_limits_of_loci_hold_most_of_the_way_and_zero():
    """Of 101 values from -20 to 80 those from -13 to 73 are within 85 %."""
    values, weights = np.arange(-20.0, 81.0), np.ones(101)
    limits = _loci_figure._limits
    mixed = np.random.default_rng(0).permutation(101)
    # No farther than three tenths of the margin, 0.35 of the range, beyond the last value.
    np.testing.assert_allclose(limits(values[mixed], weights, 0.1), [-20.0 - 9.03, 80.0 + 9.03])
    far = values.copy()
    far[[0, -1]] = -1e3, 2e3
    np.testing.assert_allclose(limits(far[mixed], weights, 0.1), [-13.0 - 30.1, 73.0 + 30.1])
    np.testing.assert_allclose(limits(far[mixed], weights, 40.0), [-53.0, 113.0])
    # What has no speed has no weight: a hundred places at 500 where the contact rests.
    slow = np.append(values, np.full(100, 500.0)), np.append(weights, np.zeros(100))
    np.testing.assert_allclose(limits(*slow, 0.1), [-29.03, 103.1])
    # Of one sign only, zero is the other end; what is not finite is left out.
    above, ones = np.append(np.arange(50.0, 61.0), [NAN, NAN]), np.ones(13)
    np.testing.assert_allclose(limits(above, ones, 0.1), [-6.3, 66.3])
    np.testing.assert_allclose(limits(-above, ones, 0.1), [-66.3, 6.3])
    np.testing.assert_allclose(limits(np.full(3, NAN), np.ones(3), 0.5), [-0.15, 0.15])


# Forces.


@pytest.mark.parametrize(
    ("peak", "newtons"), [(7.3, "5 N"), (4.9, "2 N"), (1.0, "1 N"), (2.0, "2 N"), (0.043, "0.02 N")]
)
def test_the_key_of_forces_is_a_round_one_that_is_not_above_the_largest(peak, newtons):
    ax = axes()
    ax.set(xlim=(-10.0, 90.0), ylim=(20.0, 60.0))
    forces = _forces.Arrows(np.zeros((1, 1, 2)), np.zeros((1, 1, 2)), False, 3.0, peak)
    patch = _forces.key(ax, forces)
    assert [text.get_text() for text in ax.texts] == [newtons]
    end = (-7.0 + 3.0 * float(newtons[:-2]), 59.0)
    np.testing.assert_allclose(patch._posA_posB, [(-7.0, 59.0), end])
    np.testing.assert_allclose(ax.texts[0].xy, end)
    none = _forces.Arrows(np.zeros((1, 1, 2)), np.zeros((1, 1, 2)), False, 0.0, 0.0)
    assert _forces.key(ax, none) is None and len(ax.texts) == 1


def test_forces_in_space_are_taken_at_some_times_with_where_their_load_acts():
    contacts = np.arange(24.0).reshape(2, 4, 3)
    load, at = 50.0 + np.arange(12.0).reshape(4, 3), np.arange(12.0).reshape(4, 3) / 9.0
    some = _forces3.Pushes(contacts, load, at).rows(np.array([3, 1]))
    np.testing.assert_array_equal(some.contacts, contacts[:, [3, 1]])
    np.testing.assert_array_equal(some.load, load[[3, 1]])
    np.testing.assert_array_equal(some.at, at[[3, 1]])
    assert some.peak == pytest.approx(np.linalg.norm(load[3]))
    alone = _forces3.Pushes(np.where(contacts > 22.0, NAN, contacts)).rows(np.array([3, 1]))
    assert alone.load is None and alone.peak == pytest.approx(np.linalg.norm([15.0, 16.0, 17.0]))


def test_the_longest_force_in_space_is_a_share_of_the_picture():
    """0.14 of the diagonal, 7, for 5 N; places are in millimetres."""
    scene = SimpleNamespace(on_object=[None], corners=np.array([[1.0, 1.0, 1.0], [3.0, 4.0, 7.0]]))
    contacts = np.array([[[9.0, 9.0, 9.0], [3.0, 0.0, -4.0], [1.0, 0.0, 0.0]]])
    found = _poses3.scaled(scene, _forces3.Pushes(contacts), np.array([1, 2]))
    assert found.scale == pytest.approx(0.14 * 7.0 / 5.0) and found.load is None
    np.testing.assert_allclose(found.contacts, 0.196 * contacts[:, 1:])
    load, at = np.array([[0.0, 0.0, 0.0], [0.0, 6.0, 8.0], [0.0, 1.0, 0.0]]), np.full((3, 3), 0.02)
    loaded = _poses3.scaled(scene, _forces3.Pushes(contacts, load, at), np.array([1, 2]))
    np.testing.assert_allclose(loaded.load, 0.098 * load[1:])
    np.testing.assert_allclose(loaded.at, 20.0 * np.ones((2, 3)))
    assert _poses3.scaled(scene, _forces3.Pushes(0.0 * contacts), np.array([0])).scale == 0.0
    for wrong in (contacts[:, :2], contacts[..., :2], contacts[[0, 0]], contacts[0]):
        with pytest.raises(ValueError, match=r"argument forces must have shape \(1, t, 3\)"):
            _poses3.scaled(scene, _forces3.Pushes(wrong), np.array([1, 2]))


def test_instants_are_counted_from_either_end():
    assert [_poses3.index(k, 3) for k in (-3, -1, 0, 2)] == [0, 2, 0, 2]
    for k in (3, -4):
        with pytest.raises(ValueError, match="argument at must be the number of one of 3 times"):
            _poses3.index(k, 3)


# Bodies in the plane.


def test_a_link_is_a_strip_with_round_ends():
    start, end, radius = np.array([1.0, 2.0]), np.array([4.0, 6.0]), 0.5
    corners = _artists._capsule(start, end, radius)
    along, across = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    first, second = corners[:13] - end, corners[13:] - start
    np.testing.assert_allclose(np.linalg.norm(np.concatenate([first, second]), axis=1), radius)
    turn = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 13)
    np.testing.assert_allclose(first @ along, radius * np.cos(turn), atol=1e-12)
    np.testing.assert_allclose(first @ across, radius * np.sin(turn), atol=1e-12)
    np.testing.assert_allclose(second, -first, atol=1e-12)


def test_a_picture_holds_all_that_is_drawn_at_any_time():
    ring = np.stack([np.linspace(-3.0, 4.0, 13), np.linspace(-1.0, 2.0, 13)], axis=1)
    shape = Outline((ring,), (ring,))
    still, moved = np.array([0.0, 0.0, 1.0, 0.0]), np.array([10.0, 20.0, 0.0, 1.0])
    seen = SimpleNamespace(
        body=shape,
        tips=(shape,),
        joints=[np.array([[[-30.0, 1.0], [0.0, 0.0]]])],
        guides=(np.array([[[0.0, -40.0], [1.0, 1.0]]]),),
        frames=(np.array([still]), np.array([still, moved])),
        radii=(None,),
    )
    # A quarter turn takes (x, y) to (-y, x): the upper right corner is at (10 + 1, 20 + 4).
    np.testing.assert_allclose(_artists.limits(seen), [[-36.0, -46.0], [17.0, 30.0]])
    np.testing.assert_allclose(_artists.limits(seen, 1.0), [[-31.0, -41.0], [12.0, 25.0]])
    np.testing.assert_allclose(_artists.limits(seen, 1.0, above=0.1), [[-31.0, -41.0], [12.0, 31.6]])
    seen.radii = (10.0,)  # the square at the base of such links is 30 mm wide
    np.testing.assert_allclose(_artists.limits(seen), [[-46.0, -56.0], [27.0, 40.0]])


@pytest.mark.parametrize(("size", "share"), [(1e-2, 0.2), (1.0, 6.0 / 80.0), (1e3, 0.036), (1e3, 0.02)])
def test_there_is_room_around_what_is_small_or_large(size, share):
    """The squares at bases of long links were cut off; what was small lay far from the edges."""
    ring = size * np.array([[-1.0, -1.0], [1.0, 1.0]])
    shape, still = Outline((ring,), (ring,)), np.array([[0.0, 0.0, 1.0, 0.0]])
    joints = [np.array([size * np.array([[-40.0, 0.0], [40.0, 0.0], [-10.0, 0.0]])])][: share != 0.02]
    guide = np.array([[[-40.0 * size, 0.0], [40.0 * size, 0.0]]])
    seen: Any = SimpleNamespace(body=shape, tips=(), joints=joints, guides=(guide,), frames=(still,))
    seen.radii = ()
    if joints:
        share = max(share, 1.6 * 0.045 * 65.0 / 80.0)
    low, high = _artists.limits(seen)
    np.testing.assert_allclose([-40.0 * size - low[0], high[0] - 40.0 * size], 80.0 * size * share)


@pytest.mark.parametrize("count", [1, 64, 130])
def test_states_are_placed_in_blocks_of_one_length(count):
    """So that pictures and films of any number of states share a program."""
    states = jax.tree.map(lambda a: np.resize(a, (count, *a.shape[1:])), runs.run("pinch").states)
    lengths = []

    def placed(some):
        lengths.append(len(some.s))
        return 2.0 * some.q, some.s

    q, s = _outlines.in_blocks(placed, states, length=64)
    np.testing.assert_array_equal(q, 2.0 * np.asarray(states.q))
    np.testing.assert_array_equal(s, states.s)
    assert lengths == [64] * -(-count // 64)


def test_a_picture_is_written_as_matplotlib_would_and_stays_as_it_was(tmp_path):
    figure = _style.Picture(3.0, 2.0)
    for ax in figure.subplots(1, 2):
        _style.tidy(ax, xlabel="place [mm]", ylabel="force [N]", title="A title")
    layout, dpi = figure.get_layout_engine(), figure.dpi
    for options in ({"dpi": 150}, {}, {"dpi": 90, "transparent": True}, {"bbox_inches": "tight"}):
        figure.savefig(tmp_path / "once.png", **options)
        assert figure.get_layout_engine() is layout and figure.dpi == dpi
        Figure.savefig(figure, tmp_path / "plain.png", **options)
        once, plain = (np.asarray(Image.open(tmp_path / f"{name}.png")) for name in ("once", "plain"))
        np.testing.assert_array_equal(once, plain)


def test_links_that_have_a_radius_are_drawn_with_it():
    """As runs and `link_clearance` take them; others are as wide as looks well."""
    wider = lambda grasp, i: eqx.tree_at(  # noqa: E731
        lambda g: g.fingers[i].link_radius, grasp, np.array(0.006), is_leaf=lambda x: x is None
    )
    grasp = wider(runs.scene("pinch")[0], 0)
    seen = _views.views(grasp, runs.run("pinch").states)
    made = _artists.Drawing(axes(), grasp, seen)
    made.show(0)
    wide, slim = (links[0].get_xy()[:-1] for links in made.links)
    np.testing.assert_allclose(wide, _artists._capsule(*seen.joints[0][0, :2], 6.0))
    assert 2.0 < 0.5 * np.linalg.norm(slim[0] - slim[12]) < 3.0
    grasp, _ = runs.scene("pinch3d")
    # How its bodies move has nothing to do with it.
    scene = _scene3.scene3(wider(grasp, 1), _views3.scene_motion(grasp, runs.run("pinch3d").states))
    np.testing.assert_array_equal(scene.radii, (None, 6.0))
    lowest = min(skeleton[..., 2].min() for skeleton in scene.skeletons)
    assert scene.thickness < 6.0 and scene.corners[0, 2] <= lowest - 6.0


def test_names_in_the_legend_count_contacts_and_fingers():
    assert [_artists._point_name(k) for k in (1, 2, 3, 4)] == [
        "contact point $P_1$",
        "contact points $P_1$, $P_2$",
        "contact points $P_i$",
        "contact points $P_i$",
    ]
    names = [_artists._centre_name(1, True), *(_artists._centre_name(k, False) for k in (2, 1, 3))]
    assert names == ["tip frame $O_{01}$", "finger centres $O_1$, $O_2$"] + 2 * ["finger centres $O_i$"]


def bezier(a, b, c, d, u):
    """By repeated halving of segments as de Casteljau did it, at shares u."""
    points = [a, b, c, d]
    while len(points) > 1:
        points = [p + u * (q - p) for p, q in zip(points[:-1], points[1:], strict=True)]
    return points[0]


@pytest.fixture(scope="module")
def framed_ellipse():
    """An ellipse, places on it, and its frames there."""
    contour, s = jxr.Ellipse(0.02, 0.01), np.linspace(-0.01, 0.05, 600)
    return contour, s, jax.jit(jax.vmap(contour.frame))(s)


@pytest.mark.parametrize("count", [0, 1, 256, 600])
def test_samples_of_a_contour_are_its_own_and_compile_once(count, caplog, framed_ellipse):
    contour, s, frames = framed_ellipse
    sample(contour, np.zeros(3))
    with jax.log_compiles():
        found = sample(contour, s[:count])
    assert programs(caplog) == []
    assert found.points.shape == found.tangents.shape == (count, 2) and found.curvatures.shape == (count,)
    wanted = 1e3 * np.stack([*frames.point], axis=1)[:count]
    np.testing.assert_allclose(found.points, wanted, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.curvatures, np.asarray(frames.curvature)[:count], rtol=1e-12)


def test_an_open_face_gets_a_back_that_leaves_it_aslant():
    """Half way between the face's own direction and the way into the body."""
    face = np.array([[1.0, 2.0], [3.0, 1.0], [4.0, 6.0]])
    tangents = np.array([[0.6, -0.8], [0.8, 0.6]])
    ring = _backed(face, tangents)
    inward = np.array([-0.8, 0.6])
    leave, enter = tangents[1] + inward, inward - tangents[0]
    leave, enter = leave / np.hypot(*leave), enter / np.hypot(*enter)
    u = np.arange(1, 40)[:, None] / 40.0
    arc = bezier(face[2], face[2] + 1.1 * leave, face[0] + 1.1 * enter, face[0], u)
    np.testing.assert_allclose(ring, np.concatenate([face, arc]), atol=1e-12)


def test_several_open_faces_are_joined_in_the_order_in_which_they_stand_round_the_body():
    u = np.linspace(-1.0, 1.0, 241)[:, None]
    middles, ways = (
        np.array([[0.0, -3], [5, 0], [0, 4], [-6, 0]]),
        np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]]),
    )
    faces = [[100.0, 7.0] + middle + 0.5 * u * way for middle, way in zip(middles, ways, strict=True)]
    found = _joined([faces[k] for k in (2, 0, 3, 1)])
    # From the left, which is a little below the middle of all: directions are counted from -180 degrees on.
    np.testing.assert_array_equal(found, np.concatenate([faces[k] for k in (3, 0, 1, 2)]))


def test_a_run_that_ended_says_how_at_the_time_where_it_did():
    run = runs.run("pivoted", ended="slipping")
    end = float(run.stats.t_end)
    assert _views.how_it_ended(run, end) == ": slipping" and _views.how_it_ended(run, end - 0.01) == ""
    assert _views.how_it_ended(runs.run("pivoted"), 9.0) == ""


# The geometry of one contact.


def sketched():
    return _contact_figure._Sketch(axes(), 2.0)


def arrows_of(sketch):
    return [np.array(patch._posA_posB) for patch in sketch.ax.patches]


def test_a_long_dimension_is_one_arrow_of_two_heads_beside_what_it_measures():
    sketch = sketched()
    start, end, aside = np.array([1.0, 2.0]), np.array([4.0, 6.0]), np.array([-1.6, 1.2])
    sketch.dimension(start, end, aside, text="$l$", colour="red")
    (arrow,) = arrows_of(sketch)
    np.testing.assert_allclose(arrow, [[-0.6, 3.2], [2.4, 7.2]])
    assert type(sketch.ax.patches[0].get_arrowstyle()).__name__ == "CurveFilledAB"
    # Its lines go 0.15 units, here 0.3, beyond.
    for line, point in zip(lines_of(sketch.ax), (start, end), strict=True):
        np.testing.assert_allclose(line, [point, point + 1.15 * aside])
    (tag,) = sketch.tags
    np.testing.assert_allclose(tag.at, [0.9, 5.2])
    assert (tag.text, tag.colour) == ("$l$", "red")


@pytest.mark.parametrize("length", [0.9, 0.0])
def test_a_short_dimension_has_its_arrows_outside(length):
    """Along itself, or across its lines where it has no length at all."""
    sketch, along, aside = sketched(), np.array([0.6, 0.8]), np.array([-1.6, 1.2])
    start = np.array([1.0, 2.0])
    sketch.tags.append("another")
    sketch.dimension(start, start + length * along, aside, text="$l$", colour="red")
    first = start + aside
    last = first + length * along
    before, after = arrows_of(sketch)
    np.testing.assert_allclose(before, [first - 1.2 * along, first])
    np.testing.assert_allclose(after, [last + 1.2 * along, last])
    np.testing.assert_allclose(lines_of(sketch.ax)[2], [first, last])
    assert sketch.tags[1] == "another"
    np.testing.assert_allclose(sketch.tags[0].at, 0.5 * (first + last))


def test_a_dimension_of_half_a_unit_vector_has_its_arrow_inside():
    sketch = sketched()
    sketch.dimension(np.zeros(2), np.array([1.01, 0.0]), np.array([0.0, 1.0]), text="", colour="red")
    assert len(sketch.ax.patches) == 1


def test_the_window_of_a_contact_is_neither_very_wide_nor_very_high():
    points = np.array([[0.0, 10.0], [4.0, 12.0]])
    np.testing.assert_allclose(_contact_figure._window(points, 1.0), [[-1.0, 9.0], [5.0, 13.0]])
    # At least 0.6 of its width high, and as wide as it is high.
    wide, high = np.array([[0.0, 0.0], [18.0, 2.0]]), np.array([[0.0, 0.0], [2.0, 18.0]])
    np.testing.assert_allclose(_contact_figure._window(wide, 1.0), [[-1.0, -5.0], [19.0, 7.0]])
    np.testing.assert_allclose(_contact_figure._window(high, 1.0), [[-9.0, -1.0], [11.0, 19.0]])


def contact(l_b0, l_b1, l_n0, l_n1):
    """Numbers of a contact whose tangent and normal are aslant, at (5, 3) mm; lengths in mm."""
    b, n, point = np.array([0.8, 0.6]), np.array([0.6, -0.8]), np.array([5e-3, 3e-3])
    lengths = {"l_b0": l_b0, "l_b1": l_b1, "l_n0": l_n0, "l_n1": l_n1}
    # The origins stand off the feet along the tangent.
    centre_0 = point - 1e-3 * (l_n0 * n + l_b0 * b)
    centre_1 = point + 1e-3 * (l_n1 * n + l_b1 * b)
    return SimpleNamespace(
        point=point,
        b_1=b,
        n_1=n,
        centre_0=centre_0,
        centre_1=centre_1,
        **{name: 1e-3 * length for name, length in lengths.items()},
    )


@pytest.mark.parametrize(
    ("lengths", "aside"),
    [
        # Origins behind along b by 4 or ahead by 9: the dimensions stand on the other side.
        ((4.0, -3.0, 7.0, 6.0), 2.2 + 0.8),
        ((1.0, 9.0, 7.0, 6.0), -(1.0 + 1.1)),
        ((-9.0, 2.0, 7.0, 6.0), -1.1),
        ((2.0, -9.0, -7.0, -6.0), 2.2 + 0.8),
    ],
)
def test_lengths_along_the_normal_stand_where_less_is_in_the_way(lengths, aside):
    at, sketch = contact(*lengths), sketched()
    l_b0, l_b1, l_n0, l_n1 = lengths
    _contact_figure._lengths(sketch, at)
    point, b, n = 1e3 * at.point, at.b_1, at.n_1
    feet = {"$P_0'$": point - l_n0 * n, "$P_1'$": point + l_n1 * n}
    tags = {tag.text: tag for tag in sketch.tags}
    for name, foot in feet.items():
        np.testing.assert_allclose(tags[name].at, foot)
    np.testing.assert_allclose(tags["$l_{n0}$"].at, 0.5 * (feet["$P_0'$"] + point) + aside * b)
    np.testing.assert_allclose(tags["$l_{n1}$"].at, 0.5 * (feet["$P_1'$"] + point) + aside * b)
    # Lengths along b stand beyond their feet, away from the contact.
    for name, foot, centre, away in (
        ("$l_{b0}$", feet["$P_0'$"], 1e3 * at.centre_0, -np.sign(l_n0)),
        ("$l_{b1}$", feet["$P_1'$"], 1e3 * at.centre_1, np.sign(l_n1)),
    ):
        np.testing.assert_allclose(tags[name].at, 0.5 * (foot + centre) + 2.1 * away * n)
    ends = sorted([-l_n0, l_n1, 0.0])
    normal, tangent = lines_of(sketch.ax)[:2]
    np.testing.assert_allclose(normal, [point + (ends[0] - 0.5) * n, point + (ends[-1] + 0.5) * n])
    np.testing.assert_allclose(tangent, [point - 3.2 * b, point + 3.2 * b])


def test_position_vectors_tangents_and_normals_start_where_they_belong():
    at = contact(1.0, 2.0, 7.0, 6.0)
    at.gamma_0, at.gamma_1 = np.array([7e-3, -1e-3]), at.point - at.centre_1
    at.n_0, at.b_0, at.misalignment = np.array([-0.6, 0.8]), np.array([0.0, 1.0]), 1.1e-3
    sketch = sketched()
    _contact_figure._vectors(sketch, at)
    on_tip, on_body = 1e3 * (at.centre_0 + at.gamma_0), 1e3 * at.point
    starts, ends = np.swapaxes(arrows_of(sketch), 0, 1)
    wanted = [1e3 * at.centre_0, 1e3 * at.centre_1, on_tip, on_body, on_tip, on_body]
    np.testing.assert_allclose(starts, wanted)
    steps = [1e3 * at.gamma_0, 1e3 * at.gamma_1, *(2.0 * v for v in (at.n_0, at.n_1, at.b_0, at.b_1))]
    np.testing.assert_allclose(ends - starts, steps)
    np.testing.assert_allclose(sketch.tags[0].at, starts[0] + 0.45 * steps[0])
    np.testing.assert_allclose(sketch.tags[1].at, starts[1] + 0.45 * steps[1])
    np.testing.assert_allclose([tag.at for tag in sketch.tags[2:]], ends[2:])
    assert [tag.size for tag in sketch.tags] == 6 * [11.0]
    at.misalignment = -0.9e-3
    alike = sketched()
    _contact_figure._vectors(alike, at)
    assert len(alike.tags) == 5 and "=" in alike.tags[-1].text
    np.testing.assert_allclose(arrows_of(alike)[-1], [on_body, on_body + 2.0 * at.b_1])
    at.misalignment = -1.1e-3
    _contact_figure._vectors(other := sketched(), at)
    assert len(other.tags) == 6


def test_values_of_a_contact_are_listed_in_their_units():
    at = contact(1.5, -2.25, 7.0, 6.5)
    at.s, at.psi_0, at.theta_1, at.kappa_0, at.kappa_1 = 4e-3, 0.5 * np.pi, -1e-9, 50.0, -12.345
    ax = axes()
    _contact_figure._list_values(ax, at)
    texts = [text.get_text() for text in ax.texts]
    assert texts[1::3] == ["4.00", "90.00", "0.00", "1.50", "−2.25", "7.00", "6.50", "50.00", "−12.35"] or (
        texts[1::3][-1] == "−12.34"
    )
    assert texts[2::3] == ["mm", "°", "°", "mm", "mm", "mm", "mm", "1/m", "1/m"]
    assert texts[::3][3:7] == ["$l_{b0}$", "$l_{b1}$", "$l_{n0}$", "$l_{n1}$"]
    assert [text.xyann[1] for text in ax.texts[::3]] == [-6.0 - 19.0 * k for k in range(9)]
    assert not ax.axison
    at.psi_0, at.theta_1 = -np.pi + 1e-5, -np.pi + 1e-3
    _contact_figure._list_values(other := axes(), at)
    assert [text.get_text() for text in other.texts][4:8:3] == ["180.00", "−179.94"]


def test_values_of_a_contact_of_any_size_have_digits_that_tell_them():
    """Of a finger of 0.1 mm lengths in mm, and curvatures in 1/m, have other decimals than of a gripper."""
    at = contact(1.5e-3, -2.25e-3, 7e-3, 6.5e-3)
    at.s, at.psi_0, at.theta_1, at.kappa_0, at.kappa_1 = 4e-6, 0.5 * np.pi, 0.0, 5e4, -12345.6
    _contact_figure._list_values(ax := axes(), at)
    small = ["0.00400", "90.00", "0.00", "0.00150", "−0.00225", "0.00700", "0.00650", "50000", "−12346"]
    assert [text.get_text() for text in ax.texts][1::3] == small
    sizes = (0.0, 0.004, -9999.0, 1e4, np.nan)
    assert [_contact_figure._decimals([x, 0.0]) for x in sizes] == [2, 5, 2, 0, 2]


# Contours and what was fitted.


@pytest.mark.parametrize(
    ("radius", "marks"),
    [(0.0110, range(0, 70, 10)), (0.0115, range(0, 70, 10)), (0.004, range(0, 25, 5))],
)
def test_arclengths_are_counted_round_a_closed_contour_up_to_some_room_before_its_start(radius, marks):
    """Once round are 69.1, 72.3 and 25.1 mm."""
    ax, circle = axes(), jxr.Circle(radius)
    _contours._count(ax, circle, tuple(map(float, circle.domain() or (0.0, 2.0 * np.pi * radius))))
    texts = [text.get_text() for text in ax.texts]
    assert texts == ["$s$ = 0", *(str(k) for k in marks[1:])]
    dots = ax.lines[0].get_xydata()
    np.testing.assert_allclose(np.linalg.norm(dots, axis=1), 1e3 * radius)
    for dot, text in zip(dots, ax.texts, strict=True):
        far = 17.0 if text.get_text() == "$s$ = 0" else 11.0
        np.testing.assert_allclose(text.xyann, far * dot / np.linalg.norm(dot), atol=1e-9)


def test_arclengths_of_an_open_contour_are_counted_from_end_to_end():
    ax = axes()
    _contours._count(ax, jxr.Line((-0.02, 0.011)), (-0.02, 0.0115))
    assert [text.get_text() for text in ax.texts] == ["−20", "−15", "−10", "−5", "$s$ = 0", "5", "10"]
    np.testing.assert_allclose(np.diff(ax.lines[0].get_xydata(), axis=0) ** 2 @ [1.0, 1.0], 25.0)


@pytest.mark.parametrize(
    ("length", "step"),
    [
        (6.5e-6, 1e-3),
        (7e-4, 0.1),
        (0.003, 0.5),
        (0.0062, 1.0),
        (0.012, 2.0),
        (0.13, 20.0),
        (0.4, 50.0),
        (0.55, 100.0),
        (1.2, 200.0),
        (3.1, 500.0),
        (31.0, 5000.0),
    ],
)
def test_arclengths_are_counted_in_round_steps_of_which_there_are_some_six(length, step):
    _contours._count(ax := axes(), jxr.Line((0.0, 40.0)), (0.0, length))
    marks = [float(text.get_text().removeprefix("$s$ = ")) for text in ax.texts]
    np.testing.assert_allclose(marks, np.arange(0.0, 1e3 * length * (1.0 + 1e-6), step), atol=1e-12)


def test_the_box_of_a_contour_holds_its_frame():
    ring = np.array([[-3.0, -2.0], [1.0, 0.5]])
    low, high = _contours._box(Outline((), (ring,)), 4.0, 0.25)
    assert low.tolist() == [-3.25, -2.25] and high.tolist() == [4.25, 4.25]
    low, high = _contours._box(Outline((), (ring + 10.0,)), 4.0, 0.25)
    assert low.tolist() == [-0.25, -0.25] and high.tolist() == [11.25, 10.75]


def curve(count):
    """A quarter of a circle of 5 mm, counter-clockwise, with curvatures that grow along it."""
    u = np.linspace(0.0, 0.5 * np.pi, count)
    points, along = 5.0 * np.stack([np.cos(u), np.sin(u)], -1), np.stack([-np.sin(u), np.cos(u)], -1)
    return OutlineSamples(points, along, 100.0 + 100.0 * u / u[-1])


def test_the_teeth_of_a_fit_stand_on_the_outside_as_long_as_the_curvature():
    """The longest tooth is 0.18 of the contour's size."""
    made, ax = curve(301), axes()
    points = made.points[::100] * 1.1
    _fit_figure._shape(ax, made, points, closed=False)
    tips, comb, contour, dots = lines_of(ax)
    grow = 1.0 + 0.18 * made.curvatures / 200.0
    np.testing.assert_allclose(tips, made.points * grow[:, None])
    teeth = np.linspace(0, 300, 150).astype(int)
    np.testing.assert_allclose(comb[::3], made.points[teeth])
    np.testing.assert_allclose(comb[1::3], tips[teeth])
    assert np.isnan(comb[2::3]).all() and not ax.patches
    np.testing.assert_array_equal(contour, made.points)
    np.testing.assert_array_equal(dots, points)
    assert [line.get_label() for line in ax.lines[1:]] == [
        "curvature, 200 1/m at most",
        "contour",
        "4 points",
    ]
    sizes = []
    for count in (249, 250):
        _fit_figure._shape(ax := axes(), made, np.zeros((count, 2)), closed=True)
        assert len(ax.patches) == 1
        sizes.append(ax.lines[-1].get_markersize())
    assert sizes == [3.0, 1.8]


def test_a_residual_is_positive_where_its_point_lies_outside():
    made, ax = curve(3), axes()
    off = 1e-3 * np.array([[2.0, 5.0], [-3.0 * 0.5**0.5, -3.0 * 0.5**0.5], [5.0, 7.0]])
    _fit_figure._miss(ax, np.array([0.001, 0.004, 0.007]), off, made)
    np.testing.assert_allclose(ax.lines[1].get_xydata(), [[1.0, 2.0], [4.0, -3.0], [7.0, 7.0]])
    stems = np.array(ax.collections[0].get_segments())
    np.testing.assert_allclose(stems, [[[1, 0], [1, 2]], [[4, 0], [4, -3]], [[7, 0], [7, 7]]], atol=1e-12)
    assert ax.get_title(loc="left").endswith("outward: 4.5 \N{MICRO SIGN}m rms")  # sqrt(62 / 3)
    seven = made._replace(curvatures=np.array([7.0]))
    _fit_figure._bend(ax := axes(), np.array([0.0, 0.01, 0.02]), made, np.array([0.01]), seven)
    np.testing.assert_allclose(ax.lines[1].get_xydata(), [[0.0, 100.0], [10.0, 150.0], [20.0, 200.0]])
    np.testing.assert_allclose(ax.lines[2].get_xydata(), [[10.0, 7.0]])


@pytest.mark.parametrize(
    ("longest", "step"), [(8.0, 2.0), (30.0, 5.0), (45.0, 10.0), (0.6, 0.1), (6.0, 1.0), (1.9e3, 500.0)]
)
def test_ticks_of_a_surface_have_one_round_step(longest, step):
    ticks = np.asarray(
        _surface_fit_figure._few(np.array([0.3 * longest, longest, 0.5])).tick_values(0, longest)
    )
    np.testing.assert_allclose(np.diff(ticks), step, rtol=1e-9)


def over_a_turned_label(label, number):
    """Whether a number lies over a label, whose box is upright again once the label is."""
    turn = np.deg2rad(label.get_rotation())
    label.set_rotation(0.0)
    box, other = label.get_window_extent(), number.get_window_extent()
    label.set_rotation(np.rad2deg(turn))
    x, y = np.subtract(np.mean(other.get_points(), axis=0), np.mean(box.get_points(), axis=0))
    along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    return abs(along) < 0.5 * (box.width + other.width) and abs(across) < 0.5 * (box.height + other.height)


@pytest.mark.parametrize(
    "size", [(180.0, 70.0, 36.0), (40.0, 180.0, 40.0), (40.0, 40.0, 160.0), (60.0, 70.0, 56.0)]
)
def test_axes_of_a_fitted_surface_are_labelled_beside_their_numbers_and_one_axes_hides_no_other(size):
    """Beside flat bodies "x [mm]" stood on a number, and the second view hid "z [mm]" of the first."""
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    corners = 0.5 * np.array(size) * np.array([[[1, -1, -1], [-1, 1, -1], [1, 1, 1]], [[-1, -1, 1]] * 3])
    for k, view in enumerate(_surface_fit_figure._VIEWS):
        ax = figure.add_subplot(1, 3, k + 1, projection="3d", computed_zorder=False)
        _surface_fit_figure._seen(ax, corners, view)
    figure.draw_without_rendering()
    for ax in figure.axes:
        assert not ax.patch.get_visible()
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            low, high = axis.get_view_interval()
            numbers = [tick.label1 for tick in axis.majorTicks if low < tick.get_loc() < high]
            assert numbers and not any(over_a_turned_label(axis.label, one) for one in numbers)


def test_a_histogram_leaves_out_the_farthest_and_shows_the_limits():
    values = np.append(np.arange(0.0, 1001.0), [NAN, np.inf])
    for limits, ends in (([], (5.0, 995.0)), ([-200.0, 300.0], (-200.0, 995.0)), ([2000.0], (5.0, 2000.0))):
        ax = axes()
        _surface_fit_figure._histogram(ax, values, limits, "red")
        assert len(ax.patches) == 60
        bars = [ax.patches[0].get_x(), ax.patches[-1].get_x() + ax.patches[-1].get_width()]
        np.testing.assert_allclose(bars, ends)
        assert [line.get_xdata()[0] for line in ax.lines] == limits
    same = axes()
    _surface_fit_figure._histogram(same, np.full(7, 3.0), [], "red")
    assert sum(bar.get_height() for bar in same.patches) == 7


@pytest.mark.parametrize(("peak", "bend"), [(120.0, 100.0), (250.0, 200.0), (700.0, 500.0), (50.0, 50.0)])
def test_the_bar_of_a_comb_is_a_round_curvature(peak, bend):
    ax = axes()
    ax.set(xlim=(-10.0, 90.0), ylim=(20.0, 70.0))
    _design_figure._scale_of_comb(ax, 0.3, peak)
    np.testing.assert_allclose(lines_of(ax), [[[-7.0, 73.0], [-7.0 + 0.3 * bend, 73.0]]])
    assert ax.get_xlim() == (-10.0, 90.0) and ax.get_ylim() == (20.0, 76.0)
    (text,) = ax.texts
    assert text.get_text() == rf"comb: $\kappa$ = {bend / 1e3:g} /mm"
    np.testing.assert_allclose(text.xy, (-7.0 + 0.3 * bend, 73.0))


def test_the_margin_of_a_design_is_cut_off_where_its_contour_is_nearly_flat():
    """Beyond six times the contour's reach, here 20 mm; on an ellipse radii go up to 400 mm."""
    t = np.linspace(0.0, 0.5 * np.pi, 20001)
    stretch = np.hypot(0.02 * np.sin(t), 0.001 * np.cos(t))
    s = np.append(0.0, np.cumsum(0.5 * (stretch[1:] + stretch[:-1]) * np.diff(t)))
    # Radius of curvature less the distance of the tangent from the middle.
    margin = stretch**3 / 2e-5 - 2e-5 / stretch
    ax, ends = axes(), np.array([0.0, s[-1]])
    _design_figure._margins(ax, [jxr.Ellipse(0.02, 0.001), jxr.Circle(0.01)], ends)
    flat, round_one, _ = ax.lines
    at, shown = flat.get_xdata(), flat.get_ydata()
    np.testing.assert_allclose(at, 1e3 * np.linspace(0.0, s[-1], 257))
    expected = 1e3 * np.interp(1e-3 * at, s, margin)
    np.testing.assert_allclose(shown, np.where(expected < 120.0, expected, NAN), atol=1e-3, equal_nan=True)
    assert np.isnan(shown).sum() > 100 and flat.get_label() == "before, -19.95 at least"
    np.testing.assert_allclose(round_one.get_ydata(), 0.0, atol=1e-9)
    assert np.isfinite(round_one.get_ydata()).all()


def test_the_margin_of_a_design_has_no_value_where_its_contour_is_not_convex():
    """A line has no curvature; a circle of two metres has little, and its margin is that of its middle."""
    ax = axes()
    tips = [jxr.Line((-0.1, 0.1)), jxr.Circle(2.0)]
    with pytest.warns(RuntimeWarning, match="All-NaN"):
        _design_figure._margins(ax, tips, np.array([-0.001, 0.001]))
    assert np.isnan(ax.lines[0].get_ydata()).all() and np.isfinite(ax.lines[1].get_ydata()).all()


def test_the_search_of_a_design_shows_every_start_and_which_was_chosen():
    history = np.array([[5.0, 3.0, np.inf], [4.0, 2.0, 1.0], [6.0, NAN, 2.0]])
    ax = axes()
    _design_figure._search(ax, history, 1)
    np.testing.assert_array_equal(
        [line.get_ydata() for line in ax.lines], [[5.0, 3.0, NAN], [4.0, 2.0, 1.0], [6.0, NAN, 2.0]]
    )
    assert all(line.get_xdata().tolist() == [1, 2, 3] for line in ax.lines)
    own, others = ax.lines[1], ax.lines[::2]
    assert own.get_color() == _design_figure._COLOURS[1] and own.get_linewidth() > others[0].get_linewidth()
    assert {line.get_color() for line in others} == {"#BBBBBB"} and own.get_zorder() > others[1].get_zorder()
    assert ax.get_title(loc="left") == "Search of 3 starts"
    _design_figure._search(ax := axes(), history[:1], 0)
    assert ax.get_title(loc="left") == "Search"


def test_a_run_of_several_has_its_own_colour_until_they_are_used_up():
    found = [_design_figure._colour(i) for i in range(6)]
    assert len(set(found[:5])) == 5 and found[5] == found[1]
    assert found[0] == _design_figure.CYCLE[4] and found[1:5] == list(_design_figure.CYCLE[:4])


# Labels.


def test_a_line_is_dotted_evenly_along_its_whole_length():
    """Three and four long: of seven, four dots are two and a third apart."""
    dots = _tags._dotted(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]]))
    np.testing.assert_allclose(dots, [[0.0, 0.0], [7 / 3, 0.0], [3.0, 5 / 3], [3.0, 4.0]])
    assert len(_tags._dotted(np.array([[0.0, 0.0], [0.1, 0.0]]))) == 2
    assert len(_tags._dotted(np.array([[0.0, 0.0], [1e6, 0.0]]))) == 20_000


def best(place=(50.0, 50.0), high=(100.0, 100.0), low=(0.0, 0.0), taken=((0.0, 0.0),), boxes=()):
    half, window = np.array([10.0, 5.0]), np.array([low, high])
    return _tags._best(np.array(place), half, window, np.array(taken), [np.array(box) for box in boxes])


def test_a_label_goes_to_the_first_free_place_nearby():
    """On a ring round its place, that the label's edge is three points away from, counter-clockwise."""
    for (shift, distance), angle in (
        (best(), 0.0),
        # Too near to the right border, then to the upper one too.
        (best(high=(55.0, 100.0)), 120.0),
        (best(high=(55.0, 54.0)), 195.0),
        (best(low=(45.0, 0.0)), 0.0),
        (best(low=(0.0, 52.0)), 75.0),
        # Another label covers what is to the right and above.
        (best(boxes=[[(50.0, 40.0), (90.0, 90.0)]]), 150.0),
    ):
        turn = np.radians(angle)
        np.testing.assert_allclose(shift, [13.0 * np.cos(turn), 8.0 * np.sin(turn)], atol=1e-9)
        assert distance == 3.0


def test_a_label_rather_goes_farther_than_over_a_line():
    """A dot under it costs as much as four points of distance."""
    u = np.linspace(0.0, 2.0 * np.pi, 400)
    ring = np.array([50.0, 50.0]) + np.stack([4.0 * np.cos(u), 4.0 * np.sin(u)], axis=1)
    shift, distance = best(taken=ring)
    assert distance == 5.5
    np.testing.assert_allclose(shift, [15.5, 0.0])


@pytest.mark.parametrize(
    ("dots", "off", "distance"),
    [(1, 4.0, 5.5), (1, 7.0, 3.0), (2, 7.0, 8.5), (3, 16.0, 3.0), (4, 16.0, 17.0)],
)
def test_a_dot_of_a_line_under_a_label_weighs_as_much_as_four_points_of_distance(dots, off, distance):
    """There is room to the right alone; dots are that far from the label's place."""
    taken = np.tile([50.0 + off, 50.5], (dots, 1))
    shift, found = best(low=(50.0, 44.5), high=(200.0, 55.5), taken=taken)
    assert found == distance
    np.testing.assert_allclose(shift, [distance + 10.0, 0.0])


# Bodies in space.


def test_a_tube_has_flat_strips_round_its_axis_that_face_outwards():
    start, along, radius = np.array([1.0, -2.0, 3.0]), np.array([6.0, -2.0, 3.0]), 0.5
    corners, normals = _tubes.tube_mesh(start, start + along, radius)
    axis = along / 7.0
    far = corners - start
    height = far @ axis
    np.testing.assert_allclose(np.linalg.norm(far - height[..., None] * axis, axis=-1), radius)
    assert height.min() == pytest.approx(0.0) and height.max() == pytest.approx(7.0)
    # Seven is three and a half times four radii: four pieces of fourteen strips of two triangles.
    np.testing.assert_allclose(np.unique(np.round(height, 9)), np.linspace(0.0, 7.0, 5))
    assert len(corners) == len(normals) == 4 * 28
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sizes = np.linalg.norm(areas, axis=1)
    np.testing.assert_allclose(areas / sizes[:, None], normals, atol=1e-12)
    assert sizes.sum() == pytest.approx(7.0 * 14 * 2.0 * radius * np.sin(np.pi / 14))
    nothing = _tubes.tube_mesh(start, start + 1e-10 * axis, radius)
    assert [part.shape for part in nothing] == [(0, 3, 3), (0, 3)]
    assert len(_tubes.tube_mesh(start, start + 1e-9 * axis, radius)[0]) == 28


def test_a_camera_stands_at_its_elevation_and_azimuth_with_a_light_to_its_upper_left():
    """From the y axis: x is to the left."""
    towards, light = _tubes.camera(0.0, 90.0)
    np.testing.assert_allclose(towards, [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(light, np.array([0.5, 1.0, 0.8]) / np.sqrt(1.89), atol=1e-12)
    towards, light = _tubes.camera(30.0, -60.0)
    three = 3.0**0.5
    np.testing.assert_allclose(towards, [three / 4, -0.75, 0.5], atol=1e-12)
    right, up = np.array([three / 2, 0.5, 0.0]), np.array([-0.25, three / 4, three / 2])
    np.testing.assert_allclose(light, (towards - 0.5 * right + 0.8 * up) / np.sqrt(1.89), atol=1e-12)


def test_light_is_ambient_diffuse_and_glossy():
    """Light and camera 90 degrees apart: half way between them gloss is whole."""
    light, towards = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    half = np.sqrt(0.5)
    normals = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [half, 0.0, half], [0.0, 0.6, 0.8]])
    found = _tubes.lit("#336699", normals, light, towards)
    base = np.array([0.2, 0.4, 0.6])
    np.testing.assert_allclose(found[:2], 0.66 * np.array([base, base]))
    shaded = (0.66 + 0.38 * half) * base
    np.testing.assert_allclose(found[2], shaded + 0.55 * (1.0 - shaded))
    shaded, gloss = (0.66 + 0.38 * 0.8) * base, 0.55 * (0.8 * half) ** 24
    np.testing.assert_allclose(found[3], shaded + gloss * (1.0 - shaded))
    checked = _tubes.chequered(found, np.array([0, 1, 0, 1]))
    np.testing.assert_allclose(checked, found * np.array([1.0, 0.93, 1.0, 0.93])[:, None])
    assert _tubes.shades("#336699", np.array([1, 0])) == [to_hex(0.93 * base), "#336699"]


def seeing(*normals):
    """A scene with one contact, whose normal was another one at other times than the middle one."""
    rows = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], normals[0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return SimpleNamespace(times=5, on_object=[SimpleNamespace(at=lambda i: (None, rows))])


@pytest.mark.parametrize(("across", "azimuth"), [(10.0, -52.0), (-40.0, -102.0), (100.0, -18.0)])
def test_the_camera_stands_aside_of_a_contacts_normal(across, azimuth):
    """By 62 degrees, to that side from which the usual azimuth, -58, is nearest."""
    angle = np.radians(across)
    normal = np.array([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.91**0.5])
    elevation, found = _scene3.looking(seeing(normal))
    assert elevation == 22.0 and found == pytest.approx(azimuth)


def test_the_camera_stands_as_usual_where_the_normal_is_nearly_vertical():
    for aside, usual in ((0.19, True), (0.21, False)):
        normal = np.array([0.6 * aside, 0.8 * aside, (1.0 - aside**2) ** 0.5])
        assert (_scene3.looking(seeing(normal)) == (22.0, -58.0)) is usual
    assert _scene3.looking(SimpleNamespace(times=5, on_object=[])) == (22.0, -58.0)


def motion():
    """Four times of two fingers with one contact on the second."""
    t = np.arange(4.0)[:, None]
    return {
        "body": t + np.arange(7.0),
        "tips": np.stack([t + 10.0 + np.arange(7.0), t + 20.0 + np.arange(7.0)]),
        "skeletons": [t[..., None] + np.ones((2, 3)), t[..., None] + np.zeros((3, 3))],
        **{name: t[None] + k + np.arange(3.0) for k, name in enumerate(_motion_names())},
    }


def _motion_names():
    return ("on_tip", "on_object", "out_of_tip", "out_of_object")


def test_a_motion_is_taken_at_some_of_its_times():
    whole = Motion3D(**motion())
    some = whole.at(np.array([3, 1]))
    assert whole.times == 4 and some.times == 2
    np.testing.assert_array_equal(some.body, whole.body[[3, 1]])
    for name in ("tips", *_motion_names()):
        np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[:, [3, 1]])
    for found, given in zip(some.skeletons, whole.skeletons, strict=True):
        np.testing.assert_array_equal(found, given[[3, 1]])


def test_times_that_any_part_of_a_motion_did_not_reach_are_left_out():
    given = motion()
    given["body"][0, 6] = given["tips"][1, 1, 2] = given["on_object"][0, 3, 1] = NAN
    reached, rows = Motion3D(**given).reached()
    assert rows.tolist() == [2] and reached.times == 1
    np.testing.assert_array_equal(reached.tips, given["tips"][:, 2:3])
    given["on_tip"][0, 2, 0] = np.inf
    with pytest.raises(ValueError, match="argument motion must hold at least one time that was reached"):
        Motion3D(**given).reached()


@pytest.mark.parametrize("name", ["body", "tips", *_motion_names(), "skeletons"])
def test_parts_of_a_motion_that_do_not_fit_are_named(name):
    given = motion()
    given[name] = [x[:, :, :2] for x in given[name]] if name == "skeletons" else given[name][..., :-1]
    with pytest.raises(ValueError, match=f"argument {name} must have shape"):
        Motion3D(**given)
    given["skeletons"] = motion()["skeletons"][:1]
    given[name] = motion()[name] if name != "skeletons" else given["skeletons"]
    with pytest.raises(ValueError, match="one entry for each of 2 fingers, but had 1"):
        Motion3D(**given)


# Pages in space and in the plane.


def test_the_shaft_of_a_force_ends_where_it_acts_with_two_barbs():
    """Of 7 N: across it stand barbs of 0.09 of its length, over the last 0.22 of it."""
    point, force = np.array([1.0, 2.0, 3.0]), np.array([2.0, -3.0, 6.0])
    aside = 0.63 * np.array([0.0, 2.0, 1.0]) / 5.0**0.5
    foot = point - 0.22 * force
    rows = [point - force, point, foot + aside, point, foot - aside, np.full(3, NAN)]
    np.testing.assert_allclose(_page._shaft(point, force), rows, equal_nan=True)
    np.testing.assert_allclose(_page._shaft(point, np.zeros(3))[:5], np.tile(point, (5, 1)))


def locus(count):
    """Points along x in a body that stands at (0, 10, 0), a quarter turn about z."""
    points = np.stack([np.arange(float(count)), *np.zeros((2, count))], axis=1)
    normals = np.tile([0.0, 0.6, 0.8], (count, 1))
    frames = np.tile([0.0, 10.0, 0.0, 0.5**0.5, 0.0, 0.0, 0.5**0.5], (count, 1))
    return _scene3.DrawnLocus(points, normals, frames, -1)


def test_a_locus_on_a_page_is_lifted_off_and_thinned_out():
    scene = SimpleNamespace(thickness=5.0)
    short = _page._path(scene, locus(400), 3)
    expected = np.array([[0.0, 10.0 + k, 0.0] for k in range(4)]) + 0.35 * np.array([-0.6, 0.0, 0.8])
    np.testing.assert_allclose(short, expected, atol=1e-12)
    long = _page._path(scene, locus(400), 399)
    some = np.floor(np.linspace(0, 399, 161) + 1e-9)
    np.testing.assert_allclose(long[:, 1], 10.0 + some)
    assert len(_page._path(scene, locus(3), 0)) == 1


def test_a_ring_on_a_page_lies_about_the_contact_of_its_time():
    scene = SimpleNamespace(thickness=5.0)
    ring = _page._ring(scene, locus(9), 4)
    assert len(ring) == 38 and np.isnan(ring[-1]).all()
    off = ring[:-1] - [0.0, 14.0, 0.0]
    np.testing.assert_allclose(off @ [-0.6, 0.0, 0.8], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), 7.5)
    np.testing.assert_allclose(ring[0], ring[36], atol=1e-9)
    np.testing.assert_allclose(np.sum(off[:-1] * off[1:], axis=1), 7.5**2 * np.cos(np.pi / 18))


def flat(vertices, faces):
    mesh = _scene3.Mesh(np.array(vertices, float), np.array(faces), np.zeros(len(faces), int))
    return SimpleNamespace(mesh=mesh, finger=-1)


def test_a_page_lets_planes_be_seen_through():
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert _page._flat(flat(corners, [[0, 1, 2], [0, 2, 3]]))
    # One corner raised a little, or more; and a body that is closed.
    for height, plane in ((0.03, True), (0.2, False)):
        assert _page._flat(flat([*corners[:3], [0, 1, height]], [[0, 1, 2], [0, 2, 3]])) is plane
    assert not _page._flat(
        flat([*corners[:2], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    )


def test_links_stand_once_in_the_legend_of_a_page_and_not_at_all_without_links():
    skeletons = [np.zeros((5, count, 3)) for count in (1, 3, 2)]
    found = [_page._limbs(SimpleNamespace(skeletons=skeletons), k) for k in range(3)]
    assert [part["showlegend"] for part in found] == [False, True, False]
    assert [part["mode"] for part in found] == ["markers", "lines+markers", "lines+markers"]
    assert [part["marker"]["size"] for part in found] == [0.1, 9, 9]


def test_a_page_fits_what_is_seen_of_a_scene_into_its_window():
    """From 30 degrees above the x axis: width is that along y, height that of z and x as seen."""
    corners = np.array([[-10.0, 0.0, 5.0], [30.0, 20.0, 35.0]])
    scene = SimpleNamespace(corners=corners, thickness=2.0)
    layout = _page._layout(scene, "Title", np.array([0.0, 0.5]), (30.0, 0.0))
    box = layout["scene"]
    ends = [[-13.0, 33.0], [-3.0, 23.0], [2.0, 38.0]]
    assert [box[f"{axis}axis"]["range"] for axis in "xyz"] == ends
    assert {box[f"{axis}axis"]["dtick"] for axis in "xyz"} == {10.0}
    spans = np.array([46.0, 26.0, 36.0])
    scale = min(2.3 / 26.0, 1.7 / (46.0 * 0.5 + 36.0 * 0.75**0.5))
    np.testing.assert_allclose([box["aspectratio"][axis] for axis in "xyz"], scale * spans)
    eye = [box["camera"]["eye"][axis] for axis in "xyz"]
    np.testing.assert_allclose(eye, 2.2 * np.array([0.75**0.5, 0.0, 0.5]), atol=1e-12)
    wide = SimpleNamespace(corners=np.array([[0.0, 0.0, 0.0], [1.0, 94.0, 1.0]]), thickness=2.0)
    box = _page._layout(wide, "", np.zeros(1), (30.0, 0.0))["scene"]
    assert box["aspectratio"]["y"] == pytest.approx(2.3)


def test_what_moves_on_a_page_of_the_plane_has_gaps_between_its_pieces():
    """Two fingers, the second of which touches; a quarter turn of the tip that rolled."""
    ring = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
    shape = Outline((ring,), (ring, ring + 5.0))
    still, turned = np.array([3.0, 4.0, 1.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])
    frames = [np.array([still, still]), np.array([still, still]), np.array([still, turned])]
    path = np.array([[1.0, 2.0], [3.0, 5.0], [9.0, 9.0]])
    seen = SimpleNamespace(
        joints=[np.array([[[0.0, 0], [0, 0]], [[1, 2], [3, 4]]]), np.array([[[0.0, 0]], [[7, 8]]])],
        body=shape,
        tips=(shape, shape),
        frames=frames,
        owners=(1,),
        rolled=((path, -path),),
        points=np.array([[[0.0, 0.0]], [[6.0, 7.0]]]),
    )
    shafts = SimpleNamespace(points=np.full((2, 1, 2), 2.0), vectors=np.array([[[0.0, 0.0]], [[1.0, -3.0]]]))
    links, body, _, second, rolled, points, pushes = _page_plane._moving(seen, shafts, 1)
    gap = [NAN, NAN]
    np.testing.assert_array_equal(links, [[1, 2], [3, 4], gap, [7, 8], gap])
    closed = [[0, 0], [1, 0], [0, 2], [0, 0], gap, [5, 5], [6, 5], [5, 7], [5, 5], gap]
    np.testing.assert_array_equal(body, np.array(closed) + [3.0, 4.0])
    np.testing.assert_array_equal(second, np.array(closed)[:, ::-1] * [-1.0, 1.0])
    np.testing.assert_array_equal(rolled, [[-2, 1], [-5, 3], gap, [2, 2], [0, -1], gap, gap])
    np.testing.assert_array_equal(points, [[6.0, 7.0]])
    np.testing.assert_array_equal(pushes, [[2, 2], [3, -1], gap])


# The picture of phases.


def pair(tip, face, **contact):
    """A grasp with one contact of two contours."""
    one = SimpleNamespace(**contact)
    return SimpleNamespace(contacts=[one], shapes=lambda given: (tip, face) if given is one else None)


def test_the_chapters_s_counts_from_the_contact_in_its_sense():
    contacts = [SimpleNamespace(s_object=0.01, sense=-1), SimpleNamespace(s_object=0.02, sense=1)]
    states = SimpleNamespace(s=np.array([[0.001, 0.003], [0.0, -0.004]]))
    found = _phase._chapter_s(SimpleNamespace(contacts=contacts), states)
    np.testing.assert_allclose(found, [[-0.009, 0.017], [-0.01, 0.024]])


def test_a_phase_picture_ends_where_either_contour_does():
    at = {"s_tip": 0.001, "s_object": 0.004}
    tip, wide = jxr.Line((-0.002, 0.003)), jxr.Line((-0.05, 0.05))
    rolled = 1e-3 * np.array([-3.5, -2.5, 0.0, 1.5, 2.5])
    grasp = pair(tip, wide, sense=-1, **at)
    assert _phase_one._inside(grasp, rolled).tolist() == [False, True, True, True, False]
    # The chapter's s = sense (s_object,0 - sigma).
    assert _phase._inside(grasp, 0, rolled - 0.004).tolist() == [False, True, True, True, False]
    turned = pair(tip, wide, sense=1, **at)
    assert _phase._inside(turned, 0, 0.004 - rolled).tolist() == [False, True, True, True, False]
    # A short object, from 2.4 mm to 5 mm.
    short = pair(wide, jxr.Line((0.0024, 0.005)), sense=-1, **at)
    assert _phase_one._inside(short, rolled).tolist() == [False, False, True, True, False]
    assert _phase._inside(short, 0, rolled - 0.004).tolist() == [False, False, True, True, False]


def test_energies_have_even_round_levels_round_all_of_them():
    levels = _phase_parts.energy_levels(np.array([[0.31, NAN], [9.68, 4.0]]), 16)
    np.testing.assert_allclose(np.diff(levels), 1.0, rtol=1e-9)
    assert levels[0] == 0.0 and levels[-1] == 10.0
    one = _phase_parts.energy_levels(np.full(3, 2.0), 16)
    assert one[0] <= 2.0 < one[-1] and len(one) > 1


@pytest.mark.parametrize(
    ("step", "count", "labels"),
    [(0.5, 11, ["0.0", "0.5", "1.0"]), (2.0, 12, ["0", "4", "8"]), (0.05, 3, ["0.00", "0.05", "0.10"])],
)
def test_the_bar_of_energies_names_every_level_or_every_second(step, count, labels):
    ax, levels = axes(), step * np.arange(count)
    ax.contourf(np.arange(2.0), np.arange(3.0), np.outer([0.0, 0.5, 1.0], [0.1, levels[-1]]), levels)
    bar = _phase_parts.energy_bar(ax, levels, "U")
    assert [text.get_text() for text in bar.ax.get_yticklabels()][:3] == labels
    assert len(bar.ax.get_yticklabels()) == (count if count <= 11 else count // 2)
    assert bar.ax.get_ylabel() == "U"


@pytest.mark.parametrize(
    ("levels", "labels", "unit"),
    [
        (3.698e-8 + 2e-11 * np.arange(3), ["3.698", "3.700", "3.702"], "$U$ [$10^{-8}$ mJ]"),
        (4.62e15 + 1e13 * np.arange(3), ["4.62", "4.63", "4.64"], "$U$ [$10^{15}$ mJ]"),
        (20000.0 * np.arange(3), ["0", "20000", "40000"], "$U$ [mJ]"),
    ],
)
def test_the_bar_of_tiny_and_of_huge_energies_has_their_power_of_ten_on_its_label(levels, labels, unit):
    ax = axes()
    ax.contourf(np.arange(2.0), np.arange(3.0), np.outer([0.0, 0.5, 1.0], [levels[0], levels[-1]]), levels)
    bar = _phase_parts.energy_bar(ax, levels, "$U$ [mJ]")
    assert [text.get_text() for text in bar.ax.get_yticklabels()] == labels
    assert bar.ax.get_ylabel() == unit


def test_the_picture_of_a_tiny_path_is_as_tiny_as_its_fingers():
    sized = lambda *sizes: SimpleNamespace(fingers=[SimpleNamespace(size=x) for x in sizes])  # noqa: E731
    assert _phase_parts.least_of(sized(1e-5, 4e-5), 5e-4) == pytest.approx(5e-7)
    assert _phase_parts.least_of(sized(0.02, 0.05), 5e-4) == 5e-4


def test_times_far_from_zero_are_told_apart():
    """As of a run from 1000 s to 1000.1 s: three digits would name all of its instants alike."""
    ts = np.array([1000.0, 1000.05, 1000.1])
    steps = _page_parts.controls(ts)["sliders"][0]["steps"]
    assert [step["label"] for step in steps] == ["1000", "1000.05", "1000.1"]
    ax = axes()
    _phase_parts.draw_path(ax, np.zeros((3, 2)), np.zeros((0, 2)), ts)
    assert [line.get_label() for line in ax.lines[1:]] == ["start, 1000 s", "end, 1000.1 s"]


@pytest.mark.parametrize("name", ["motion.gif", "grasp.html", "map.html"])
def test_a_film_or_a_page_that_cannot_be_written_is_refused_before_it_is_drawn(name, tmp_path):
    if name != "motion.gif":
        pytest.importorskip("plotly")
    (tmp_path / "file").write_text("")
    grid = jxr.Parameters.grid(a=[1.0, 2.0], b=[3.0, 4.0])
    grasp, run = runs.scene("pivoted")[0], runs.run("pivoted")
    write = {
        "motion.gif": lambda path: jxr.plotting.animate(grasp, run, path),
        "grasp.html": lambda path: jxr.plotting.page(grasp, run, path),
        "map.html": lambda path: jxr.plotting.map_page(grid, grid.a, path),
    }[name]
    for path in (tmp_path / "file" / name, tmp_path / f"{'n' * 300}{name}"):
        with pytest.raises(ValueError, match="argument path must name a file that can be written, but '"):
            write(path)


def test_titles_of_tall_poses_are_within_their_picture(tmp_path):
    grasp, state = runs.scene("pivoted")
    run = runs.run("pivoted")
    twice = jax.tree.map(lambda x: np.stack([x, x]), state)  # as after a short time: hardly anything moved
    still = eqx.tree_at(lambda run: (run.ts, run.states), run, (np.array([0.0, 0.1]), twice))
    figure = jxr.plotting.poses(grasp, still)
    figure.savefig(tmp_path / "poses.png", dpi=figure.dpi)
    for ax in figure.axes:
        above = figure.bbox.height - ax._left_title.get_window_extent().y1
        below = ax.xaxis.label.get_window_extent().y0 - figure.legends[0].get_window_extent().y1
        assert above > 0.0 and below > 0.0


def test_a_push_in_space_is_explained_where_it_acts_at_a_time_that_is_shown():
    grasp, _ = runs.scene("turntable")
    load = jxr.loads.Push((0.5, 0.2, -0.3), 0.08, 0.1)
    pushed = jxr.Grasp(grasp.object, grasp.fingers, grasp.contacts, load=load, gravity=grasp.gravity)
    run = runs.run("turntable")
    for times, told in (((0.0, 0.6), False), ((0.0, 0.1), True)):
        figure = jxr.plotting.poses(pushed, run, times=times, forces=True)
        names = [text.get_text() for text in figure.legends[0].get_texts()]
        assert ("load on the object" in names) == told


@pytest.mark.parametrize("size", [2.5, 4.0, 5.5, 8.0])
def test_the_legend_of_a_narrow_picture_in_space_is_within_it(size):
    grasp, _ = runs.scene("pinch3d")
    run = runs.run("pinch3d")
    motion = _views3.scene_motion(grasp, run.states)
    forces = _forces3.pushes(grasp, run, motion)
    forces = _forces3.Pushes(1e-9 * forces.contacts)  # a long number: the scale is for one newton
    figure = _poses3.snapshots3(grasp, motion, forces=forces, size=size)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert box.x0 >= 0.0 and box.x1 <= figure.bbox.width
    assert any("1 N as" in text.get_text() for text in legend.get_texts())


@pytest.mark.parametrize("size", [5.0, 5.3])
def test_the_legend_of_a_narrow_picture_with_a_load_covers_no_label(size):
    grasp, motion, _ = stand_in_grasp.stand_in(5)
    forces = _forces3.Pushes(np.ones((2, 5, 3)), np.ones((5, 3)), np.zeros((5, 3)))
    figure = _poses3.snapshots3(grasp, motion, forces=forces, size=size)
    figure.draw_without_rendering()
    (legend,), (ax,) = figure.legends, figure.axes
    assert legend.get_texts()[-1].get_text() == "load on the object"
    box = legend.get_window_extent()
    assert not any(box.overlaps(axis.label.get_window_extent()) for axis in (ax.xaxis, ax.yaxis, ax.zaxis))


def test_marks_of_late_times_do_not_meet():
    for start, span, most in ((0.0, 3.0, 12), (1000.0, 3.0, 4), (0.0, 0.0158, 4)):
        ax = axes()
        ax.plot(start + np.linspace(0.0, span, 7), np.zeros(7))
        _responses._thin(ax)
        low, high = ax.get_xlim()
        seen = [x for x in ax.get_xticks() if low <= x <= high]
        assert 3 <= len(seen) <= most


def test_a_frame_is_shown_no_longer_than_a_gif_can_say():
    assert _film.check_delay("fps", 0.002, 500.0) == 500.0
    with pytest.raises(
        ValueError, match="argument fps must show no frame for more than 655 s, but was 0.001"
    ):
        _film.check_delay("fps", 0.001, 1000.0)
    with pytest.raises(
        ValueError, match="argument speed must show no frame for more than 655 s, but was 1e-05"
    ):
        _animate3._paced(np.linspace(0.0, 3.0, 300), 25.0, 1e-5)
    with pytest.raises(ValueError, match="argument fps must show no frame"):
        _animate3._paced(np.linspace(0.0, 3.0, 300), 1e-3, 1.0)
    # Frames of one saved state are one frame of a GIF.
    with pytest.raises(ValueError, match="argument speed must show no frame for more than 655 s, but was 0"):
        _animate3._paced(np.array([0.0, 0.5]), 25.0, 2e-4)
    rows = np.array([0, 0, 0, 1, 1])
    _film.check_stays("speed", 0.5, rows, 218.0)
    with pytest.raises(ValueError, match="argument speed"):
        _film.check_stays("speed", 0.5, rows, 219.0)
    with pytest.raises(ValueError, match="argument speed"):  # the last one is held
        _film.check_stays("speed", 0.5, rows[2:], 654.0)


def test_the_clock_of_a_short_film_has_as_many_digits_as_it_needs():
    assert _film.clock_texts(np.array([0.0, 0.5, 12.345])) == ["t = 0.00 s", "t = 0.50 s", "t = 12.35 s"]
    assert _film.clock_texts(np.array([3.0, 3.0002])) == ["t = 3.00000 s", "t = 3.00020 s"]
    assert _film.clock_texts(np.array([0.0])) == ["t = 0.00 s"]
    assert _film.clock_texts(np.array([2e-3])) == ["t = 0.0020 s"]


def test_a_path_has_its_start_its_end_and_where_it_rests():
    ax = axes()
    path = np.array([[0.001, 0.002], [0.003, 0.007], [0.004, -0.001]])
    _phase_parts.draw_path(ax, path, np.array([[0.005, 0.006]]), np.array([0.25, 1.0, 2.5]))
    whole, start, end, rest = lines_of(ax)
    np.testing.assert_allclose(whole, 1e3 * path)
    np.testing.assert_allclose([start[0], end[0], rest[0]], [[1.0, 2.0], [4.0, -1.0], [5.0, 6.0]])
    labels = [line.get_label() for line in ax.lines]
    assert labels == ["path", "start, 0.25 s", "end, 2.5 s", "equilibrium"]
    filled = [line.get_markerfacecolor() for line in ax.lines[1:3]]
    assert filled == ["white", _phase_parts.CONTACT]
    _phase_parts.draw_path(ax := axes(), path, np.zeros((0, 2)), np.arange(3.0))
    assert len(ax.lines) == 3


def test_a_phase_picture_has_free_space_round_the_path_and_does_not_magnify_what_rests(monkeypatch):
    """A fifth of the longer side either way, and half a millimetre at least."""
    shown = []
    monkeypatch.setattr(_phase, "_levels", lambda ax, grasp, middle, half: shown.append((middle, half)))
    (grasp, state), run = runs.scene("pinch"), runs.run("pinch")
    starts = np.array([float(contact.s_object) for contact in grasp.contacts])
    senses = np.array([contact.sense for contact in grasp.contacts])
    start = senses * starts
    for size in (1.0, 1e-3):
        way = size * np.linspace(0.0, 1.0, 13)[:, None] * [0.004, -0.001]
        states = jxr.State(run.states.q, run.states.v, starts - senses * (start + way))
        _phase.phase(grasp, runs.without(run, states=states), rest=jxr.State(state.q, state.v, 0.0 * state.s))
    (middle, half), (still, least) = shown
    np.testing.assert_allclose(middle, start + [0.002, -0.0005], atol=1e-12)
    assert half == pytest.approx(0.7 * 0.004)
    np.testing.assert_allclose(still, start + [2e-6, -5e-7], atol=1e-12)
    assert least == 5e-4
    # Where no equilibrium is found there is none to show.
    ends = []

    def sought(given, state, t):
        ends.append((given, state, t))
        return SimpleNamespace(found=False, state=state)

    monkeypatch.setattr(_phase, "equilibrium", sought)
    states = jxr.State(run.states.q, run.states.v, starts - senses * (start + [0.02, 0.0] + way))
    figure = _phase.phase(grasp, runs.without(run, states=states))
    np.testing.assert_allclose(shown[2][0], start + [0.02 + 2e-6, -5e-7], atol=1e-12)
    assert len(figure.axes[0].lines) == 3
    assert ends[0][0] is grasp and ends[0][1] is run.last
    # Loads may be others than at the start.
    assert ends[0][2] is run.stats.t_end


# Whole drawings of made bodies.

RING = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])


def seen_twice():
    """Two instants of two fingers, the first with two links, the second a jaw; two contacts."""
    shape, other = Outline((RING,), (RING,)), Outline((2.0 * RING, -RING), (3.0 * RING,))
    still, moved = np.array([0.0, 0.0, 1.0, 0.0]), np.array([10.0, 20.0, 0.0, 1.0])
    path = np.array([[1.0, 2.0], [3.0, 5.0]])
    return SimpleNamespace(
        body=shape,
        tips=(other, shape),
        frames=(np.array([still, moved]), np.array([still, still + [1, 2, 0, 0]]), np.array([still, moved])),
        joints=[
            np.array([[[0.0, 0], [0, 0], [0, 0]], [[1, 2], [4, 6], [9, 6]]]),
            np.array([[[0.0, 0]], [[7, 8]]]),
        ],
        points=np.array([[[0.0, 0.0], [0.0, 0.0]], [[6.0, 7.0], [5.0, 3.0]]]),
        rolled=((path, 2.0 * path), (3.0 * path, 4.0 * path)),
        guides=(np.array([[[0.0, 0.0], [0.0, 0.0]], [[9.0, 6.0], [7.0, 8.0]]]),),
        owners=(1, 0),
        radii=(None, None),
    )


def drawing(load, **options):
    """A drawing of it at the second instant, with a load that pulls so at the two."""
    vectors = np.array([[[1.0, 0.0], [0.0, 0.0], load[0]], [[2.0, -1.0], [0.0, 0.0], load[1]]])
    points = np.arange(12.0).reshape(2, 3, 2)
    forces = _forces.Arrows(points, vectors, True, 1.0, 1.0)
    grasp = SimpleNamespace(object=None, fingers=[SimpleNamespace(size=0.01), SimpleNamespace(size=0.03)])
    made = _artists.Drawing(axes(), grasp, seen_twice(), **{"forces": forces, "traced": True} | options)
    made.show(1)
    return made


def test_all_of_a_grasp_is_drawn_where_it_is_at_an_instant():
    made = drawing([(0.0, 0.0), (0.0, 4.0)])
    turned = np.stack([10.0 - RING[:, 1], 20.0 + RING[:, 0]], axis=1)
    edges = [[edge.get_xydata() for edge in body.edges] for body in made.bodies]
    np.testing.assert_allclose(edges[0][0], turned)
    np.testing.assert_allclose(edges[1], [2.0 * RING + [1.0, 2.0], -RING + [1.0, 2.0]])
    np.testing.assert_allclose(made.bodies[1].fills[0].get_xy()[:3], 3.0 * RING + [1.0, 2.0])
    np.testing.assert_allclose(edges[2][0], turned)
    # The radius of the links is 0.045 of the tips' mean size, 20 mm.
    assert [len(links) for links in made.links] == [2, 0]
    for link, ends in zip(made.links[0], ([[1.0, 2], [4, 6]], [[4.0, 6], [9, 6]]), strict=True):
        np.testing.assert_allclose(link.get_xy()[:-1], _artists._capsule(*np.array(ends), 0.9))
    np.testing.assert_allclose(made.pins[0].get_xydata(), [[1.0, 2.0], [4.0, 6.0]])
    assert len(made.pins[1].get_xydata()) == 0
    square = 1.35 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    np.testing.assert_allclose(made.bases[0].get_xy()[:4], [1.0, 2.0] + square)
    assert [base.get_visible() for base in made.bases] == [True, False]
    np.testing.assert_allclose(made.guides[0].get_xydata(), [[9.0, 6.0], [7.0, 8.0]])
    np.testing.assert_allclose(made.centres.get_xydata(), [[9.0, 6.0], [7.0, 8.0]])
    np.testing.assert_allclose(made.origin.get_xydata(), [[10.0, 20.0]])
    np.testing.assert_allclose(made.points.get_xydata(), [[6.0, 7.0], [5.0, 3.0]])
    assert made.origin.get_marker() == "P" and len(made.dot.get_xydata()) == 0
    # The first contact is the second finger's; what has rolled lies on its body.
    path = np.array([[1.0, 2.0], [3.0, 5.0]])
    (first, on_object), (second, other) = ([line.get_xydata() for line in lines] for lines in made.stretches)
    place = lambda points: np.stack([10.0 - points[:, 1], 20.0 + points[:, 0]], axis=1)  # noqa: E731
    np.testing.assert_allclose(first, place(path))
    np.testing.assert_allclose(on_object, place(2.0 * path))
    np.testing.assert_allclose(second, 3.0 * path + [1.0, 2.0])
    np.testing.assert_allclose(other, place(4.0 * path))
    ends = [np.array(arrow._posA_posB) for arrow in made.arrows]
    np.testing.assert_allclose(ends, [[[6, 7], [8, 6]], [[8, 9], [8, 9]], [[10, 11], [10, 15]]])
    assert [arrow.get_visible() for arrow in made.arrows] == [True, False, True]
    colours = [to_hex(arrow.get_edgecolor()) for arrow in made.arrows]
    assert colours[0] == colours[1] == _artists.FORCE_COLOUR.lower() and colours[2] == "#7a4fb5"


def test_the_legend_of_a_drawing_names_what_is_drawn():
    names = [name for _, name in drawing([(0.0, 0.0), (0.0, 4.0)]).legend()]
    assert names == [
        "fingertip",
        "object",
        "fixed base",
        "contact points $P_1$, $P_2$",
        "finger centres $O_1$, $O_2$",
        "centre of mass $O_m$",
        "line $O_1O_2$",
        "rolled so far: as long on both bodies",
        "contact force on the object",
        "load on the object",
    ]
    # A load that pulls at no time has no arrow to explain; nor has what is not asked for.
    assert [name for _, name in drawing(np.zeros((2, 2))).legend()] == names[:-1]
    assert [name for _, name in drawing(np.zeros((2, 2)), forces=None).legend()] == names[:-2]
    bare = drawing(np.zeros((2, 2)), forces=None, traced=False)
    assert [name for _, name in bare.legend()] == names[:-3]
    assert all(len(line.get_xydata()) == 0 for pair in bare.stretches for line in pair)


def test_a_labelled_point_takes_room_and_is_in_the_window():
    sketch, at = sketched(), np.array([3.0, -1.0])
    sketch.dot(at, "$P$", "red", filled=True)
    sketch.dot(at, "$O$", "blue")
    assert [line.get_markerfacecolor() for line in sketch.ax.lines] == ["red", "white"]
    np.testing.assert_allclose(lines_of(sketch.ax), [[at], [at]])
    corners = sketch.lines[0] - at
    np.testing.assert_allclose(np.abs(corners), 0.12, atol=1e-12)
    np.testing.assert_allclose(np.sum(corners[:4], axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(corners[4:], [corners[0], corners[2]])
    assert [(tag.text, tag.colour) for tag in sketch.tags] == [("$P$", "red"), ("$O$", "blue")]
    np.testing.assert_array_equal(sketch.reach, [at, at])


def test_an_end_of_a_contour_that_is_a_mark_but_for_rounding_is_marked():
    ax, near = axes(), 1.0 - 1e-12
    _contours._count(ax, jxr.Line((-0.02, 0.01)), (-0.02 * near, 0.01 * near))
    assert [text.get_text() for text in ax.texts] == ["−20", "−15", "−10", "−5", "$s$ = 0", "5", "10"]


def test_a_film_of_one_frame_shows_it(tmp_path):
    path = tmp_path / "one.gif"
    _gif.write(path, [Image.new("RGB", (40, 30), (30, 160, 60))], [70], _gif.KEPT_COLOURS)
    with Image.open(path) as film:
        assert film.n_frames == 1 and film.size == (40, 30)
        assert np.abs(np.asarray(film.convert("RGB"), int) - [30, 160, 60]).max() <= 4


def test_contours_without_ends_are_drawn_where_they_were_touched():
    """And 0.3 of the mean size of the tips, 20 mm, beyond; whole if they have ends."""
    contacts = [
        jxr.Contact(0.004, 0.02),
        jxr.Contact(0.001, 0.05, finger=1, contour=1),
        jxr.Contact(-0.03, 0.09, finger=0, contour=1),
    ]
    line = jxr.Line()
    grasp = SimpleNamespace(
        contacts=contacts,
        object=SimpleNamespace(contours=(line, line, line)),
        fingers=[
            SimpleNamespace(tip=line, size=0.01),
            SimpleNamespace(tip=jxr.Line((-0.1, 0.2)), size=0.03),
        ],
    )
    sigmas = np.array([[-0.001, 0.002, 0.0], [0.003, 0.0, 0.001]])
    assert _outlines.starts_of(grasp) == [
        [[(0, 0.02, -1)], [(1, 0.05, -1), (2, 0.09, -1)], []],
        [[(0, 0.004, 1), (2, -0.03, 1)]],
        [[(1, 0.001, 1)]],
    ]
    body, first, second = _outlines.extents(grasp, sigmas)
    np.testing.assert_allclose(body, [(0.011, 0.027), (0.042, 0.096), (-0.006, 0.006)])
    np.testing.assert_allclose(first, [(-0.036, 0.013)])
    np.testing.assert_allclose(second, [(-0.1, 0.2)])


def test_rates_of_tangency_are_rounding_by_the_scale_of_a_sine():
    for value, words in ((0.9e-13, "tangency (rounding level)"), (1.1e-13, "tangency")):
        run = SimpleNamespace(energy=None, residuals=SimpleNamespace(tangency=np.array([[0.0], [value]])))
        found = _panels._last(run, ("contact 1",))
        assert (found.title, found.label, found.names) == (words, "sine [rad]", ("contact 1",))


def finger(joints, unit):
    return SimpleNamespace(joints=joints, labels=[SimpleNamespace(unit=unit)] * joints)


def test_what_has_moved_since_the_first_state_is_told_body_by_body():
    """A free object, a jaw and a finger; the first state was not reached."""
    q = np.arange(21.0).reshape(3, 7) ** 2
    q[0] = NAN
    states, there = SimpleNamespace(q=q, v=q + 1.0), np.array([False, True, True])
    run: Any = SimpleNamespace(ts=np.array([0.0, 0.25, 0.5]), states=states, reached=there)
    grasp = SimpleNamespace(sizes=(3, 1, 3), fingers=[finger(1, "m"), finger(3, "rad")])
    turned, path, jaw, arm = _panels._moved(grasp, run)
    then = r"0.25\,\mathrm{s}"
    assert turned.label == rf"$\theta - \theta({then})$ [rad]" and path.names[1] == f"$y - y({then})$"
    moved = q - q[1]
    np.testing.assert_array_equal(turned.values, moved[:, 2])
    np.testing.assert_array_equal(path.values, 1e3 * moved[:, :2])
    np.testing.assert_array_equal(jaw.values, 1e3 * moved[:, 3:4])
    np.testing.assert_array_equal(arm.values, moved[:, 4:])
    assert (jaw.title, jaw.label) == ("joint displacements of finger 1", f"$q - q({then})$ [mm]")
    assert (arm.title, arm.label) == ("joint angles of finger 2", f"$q - q({then})$ [rad]")
    assert jaw.names == ("$q_{11}$",) and arm.names == ("$q_{21}$", "$q_{22}$", "$q_{23}$")
    rates = _panels._joint_rates(grasp, run)
    assert [(p.title, p.label) for p in rates] == [
        ("joint rates of finger 1", r"$\dot{q}$ [mm/s]"),
        ("joint rates of finger 2", r"$\dot{q}$ [rad/s]"),
    ]
    np.testing.assert_array_equal(rates[0].values, 1e3 * (q[:, 3:4] + 1.0))
    np.testing.assert_array_equal(rates[1].values, q[:, 4:] + 1.0)
    pivoted = SimpleNamespace(sizes=(1, 0, 6), fingers=[finger(0, "rad"), finger(6, "rad")])
    assert [p.title for p in _panels._moved(pivoted, run)][::2] == [
        "rotation of the object",
        "joint angles of finger 2",
    ]
    (only,) = _panels._joint_rates(pivoted, run)
    np.testing.assert_array_equal(only.values, q[:, 1:] + 1.0)


@pytest.mark.parametrize(
    ("joints", "titles"),
    [(3, ["rate of joint 1", "rate of joint 2", "rate of joint 3"]), (4, ["joint rates"])],
)
def test_few_joints_of_one_finger_have_a_panel_each(joints, titles):
    v = np.arange(3.0 * (1 + joints)).reshape(3, -1)
    run = SimpleNamespace(states=SimpleNamespace(v=v))
    found = _panels._joint_rates(SimpleNamespace(sizes=(1, joints), fingers=[finger(joints, "rad")]), run)
    assert [p.title for p in found] == titles
    values = np.concatenate([np.reshape(p.values, (3, -1)) for p in found], axis=1)
    np.testing.assert_array_equal(values, v[:, 1:])
    (turning,) = _panels._object_rates(SimpleNamespace(sizes=(1, joints)), run)
    np.testing.assert_array_equal(turning.values, v[:, 0])
    turning, path = _panels._object_rates(SimpleNamespace(sizes=(3,)), run)
    np.testing.assert_array_equal(turning.values, v[:, 2])
    np.testing.assert_array_equal(path.values, 1e3 * v[:, :2])


# Triangles.


def solid(mesh, finger=0):
    frames = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (2, 1))
    return _scene3.Solid(mesh, frames, finger)


def test_both_sides_of_an_open_surface_are_lit_and_of_a_closed_one_is_seen_what_faces_the_camera():
    one = _scene3.Mesh(
        np.eye(3)[[2, 0, 1]] - [0.0, 0.0, 1.0], np.array([[0, 1, 2], [0, 2, 1]]), np.array([0, 1])
    )
    sheet = _scene3.Mesh(one.vertices, one.faces[:1], np.array([1]))
    normal = np.cross(*np.diff(sheet.vertices, axis=0))
    normal /= np.linalg.norm(normal)
    light = np.array([0.6, 0.0, 0.8])
    for sign in (1.0, -1.0):
        towards = sign * np.array([0.0, 0.6, 0.8])
        front = normal * np.sign(normal @ towards)
        for part, colour in ((0, _drawing3.TIP_BODY), (-1, _drawing3.OBJECT_BODY)):
            corners, colours = _drawing3._faces(solid(sheet, part), 1, towards, light)
            assert len(corners) == 1
            np.testing.assert_allclose(colours, 0.93 * _tubes.lit(colour, front[None], light, towards))
    box = _scene3.box_mesh(np.array([2.0, 4.0, 6.0]))
    corners, _ = _drawing3._faces(solid(box), 0, np.array([0.6, -0.48, 0.64]), light)
    middles = corners.mean(axis=1)
    assert len(corners) == 6
    assert np.isclose(middles, [1.0, -2.0, 3.0]).sum(axis=0).tolist() == [2, 2, 2]


def test_a_finger_has_a_tube_for_each_link_and_a_ball_at_each_joint_but_the_tip():
    joints = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 6.0]])
    towards = light = np.array([0.0, 0.0, 1.0])
    parts = _drawing3._limbs(joints, (0.5, 1.45), towards, light)
    assert len(parts) == 4
    for (corners, colours), centre in zip(parts[2:], joints[:2], strict=True):
        apart = np.linalg.norm(corners - centre, axis=-1)
        np.testing.assert_allclose(apart, 0.725)
        assert len(corners) == len(colours) and (corners[..., 2].mean(axis=1) > centre[2] - 0.15).all()
    assert np.linalg.norm(parts[0][0][..., :2], axis=-1).max() < 5.5 and parts[1][0][..., 2].max() == 6.0
    assert len(_drawing3._limbs(joints[:2], (0.5, 1.45), towards, light)) == 2
    assert _drawing3._limbs(joints[:1], (0.5, 1.45), towards, light) == []
    # What is seen of a tube is a little more than the half that faces the camera: 8 of 14 strips.
    whole, normals = _tubes.tube_mesh(joints[0], joints[1], 0.5)
    np.testing.assert_allclose(parts[0][0], whole[normals @ towards > -0.1])
    assert len(parts[0][0]) < len(whole)


def test_what_is_hidden_or_empty_asks_the_renderer_for_nothing():
    asked = []
    context = SimpleNamespace(restore=lambda: asked.append("restored"))
    renderer = SimpleNamespace(
        new_gc=lambda: context,
        _raster_depth=0,
        _rasterizing=False,
        draw_gouraud_triangles=lambda gc, points, colours, transform: asked.append((points, colours)),
    )
    ax = Figure().add_subplot(projection="3d")
    ax.set_proj_type("ortho")
    ax.M = ax.get_proj()
    many = _artists3.Triangles()
    ax.add_artist(many)
    many.set_clip_on(False)
    many.set_rasterized(False)
    many.draw(renderer)
    far = 0.01 * np.eye(3)
    many.corners = np.stack([far, far + 0.5])
    many.colours = np.array([[1.0, 0.0, 0.0, 0.3], [0.0, 1.0, 0.0, 0.3]])
    many.set_visible(False)
    many.draw(renderer)
    assert asked == []
    many.set_visible(True)
    many.draw(renderer)
    (points, colours), restored = asked
    assert restored == "restored" and points.shape == (2, 3, 2)
    # The first is farther from the camera, which stands at the corner (1, -1, 1); colours are opaque.
    x, y, depth = proj3d.proj_transform(*many.corners.mean(axis=1).T, ax.M)
    order = np.argsort(-np.asarray(depth))
    np.testing.assert_allclose(points.mean(axis=1), ax.transData.transform(np.stack([x, y], -1))[order])
    wanted = np.array([[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0]])[order]
    np.testing.assert_allclose(colours, np.repeat(wanted[:, None], 3, axis=1))


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_a_mesh_is_welded_alike_at_any_size(size):
    found = _scene3.mesh(jxr.geometry.Torus(3.0 * size, size), rows=7, columns=10)
    assert found.closed and found.vertices.shape == (70, 3) and found.faces.shape == (140, 3)


def test_patches_of_a_body_are_octants_about_its_own_middle():
    """A box far from the origin: its pattern is that of a box about it."""
    corners, faces = _scene3.mesh(jxr.geometry.Sphere(1.0), rows=8, columns=8).vertices, None
    faces = _scene3.mesh(jxr.geometry.Sphere(1.0), rows=8, columns=8).faces
    shift = np.array([7.0, -3.0, 11.0])
    found = _meshes._octants(_scene3.Mesh(corners + shift, faces, np.zeros(len(faces), int)))
    np.testing.assert_array_equal(found, (corners[faces].mean(axis=1) > 0.0).sum(axis=1) % 2)


def test_friction_in_space_is_that_of_either_sign_and_none_without_a_force(monkeypatch):
    normal = np.array([[2.0, -4.0], [0.0, 5.0]])
    tangential = np.array([[[3.0, 0.0, 4.0], [1.0, 2.0, 2.0]], [[1.0, 0.0, 0.0], [0.0, 6.0, 8.0]]])
    monkeypatch.setattr(_panels3, "forces_of", lambda grasp, run: (normal, tangential))
    pressed, along, ratio = _panels3._forces(None, None, ("contact 1", "contact 2"))
    np.testing.assert_array_equal(pressed.values, normal)
    np.testing.assert_allclose(along.values, [[5.0, 3.0], [1.0, 10.0]])
    np.testing.assert_allclose(ratio.values, [[2.5, 0.75], [NAN, 2.0]], equal_nan=True)


def test_joints_in_space_are_counted_past_those_of_other_fingers():
    """A finger of two joints, a stage without any, a finger with one, whose states have more numbers."""
    fingers = [SimpleNamespace(joints=joints) for joints in (2, 0, 1)]
    values = np.arange(30.0).reshape(3, 10)
    words = ("joint angles", "$q$", "$q_{{{0}{1}}}$")
    found = _panels3._joints(SimpleNamespace(fingers=fingers), values, (3, 2, 4, 1), words)
    assert [(p.title, p.names) for p in found] == [
        ("joint angles of finger 1", ("$q_{11}$", "$q_{12}$")),
        ("joint angles of finger 3", ("$q_{31}$",)),
    ]
    np.testing.assert_array_equal(found[0].values, values[:, 3:5])
    np.testing.assert_array_equal(found[1].values, values[:, 9:])
    (only,) = _panels3._joints(SimpleNamespace(fingers=fingers[:1]), values, (3, 2), words)
    assert only.title == "joint angles" and only.label == "$q$"


def test_rays_leave_a_body_where_its_surface_is():
    """A ball of 4.9 m: from near its surface there are 4 um one way, and the whole of it the other."""
    middle = np.array([0.3, -0.2, 0.5])
    big = jxr.geometry.Implicit(
        lambda x, y, z: (x - middle[0]) ** 2 + (y - middle[1]) ** 2 + (z - middle[2]) ** 2 - 4.9**2
    )
    axis = np.array([0.6, 0.0, 0.8])
    ways = np.stack([axis, -axis, [0.0, 1.0, 0.0]])
    near = _rays.radii(big, middle + (4.9 - 4e-6) * axis, ways)
    np.testing.assert_allclose(near, [4e-6, 9.8 - 4e-6, (2.0 * 4.9 * 4e-6 - 16e-12) ** 0.5], rtol=1e-8)
    off = np.array([1.0, 2.0, -0.5])
    along = ways @ off
    found = _rays.radii(big, middle + off, ways)
    np.testing.assert_allclose(found, -along + np.sqrt(along**2 + 4.9**2 - off @ off), rtol=1e-12)


def test_a_film_holds_its_last_frame(monkeypatch, tmp_path):
    """For a second and a half; of an MP4 the frame is written as often as that takes."""
    frames = [Image.new("RGB", (60, 40), (10 * k, 0, 0)) for k in range(3)]
    told = []
    monkeypatch.setattr(_film._gif, "write", lambda *given: told.append(given))
    _film.write_film(tmp_path / "a" / "film.GIF", frames, 40, ("white",))
    assert told == [(tmp_path / "a" / "film.GIF", frames, [40, 40, 1500], ("white",))]
    assert (tmp_path / "a").is_dir()
    shown = []

    class Writer:
        def __init__(self, fps, codec, **options):
            told.append((fps, codec))
            assert options == {"bitrate": -1, "extra_args": ["-crf", "20"]}

        @contextlib.contextmanager
        def saving(self, figure, path, dpi):
            self.figure = figure
            told.append((path, dpi))
            yield

        def grab_frame(self):
            (picture,) = self.figure.images
            shown.append(int(np.asarray(picture.get_array())[0, 0, 0]))
            assert (self.figure.bbox.size == (60, 40)).all()

    monkeypatch.setattr(_film, "FFMpegWriter", Writer)
    _film.write_film(tmp_path / "film.mp4", frames, 400)
    assert told[1:] == [(2.5, "h264"), (str(tmp_path / "film.mp4"), 100)]
    assert shown == [0, 10, 20, 20, 20, 20]


def test_an_mp4_asks_for_ffmpeg(monkeypatch):
    monkeypatch.setattr(_film.FFMpegWriter, "isAvailable", classmethod(lambda cls: False))
    assert _film.checked_path("a.GIF") == _film.Path("a.GIF")
    with pytest.raises(ValueError, match=r"argument path must end in .gif where there is no program ffmpeg"):
        _film.checked_path("a.MP4")
    monkeypatch.setattr(_film.FFMpegWriter, "isAvailable", classmethod(lambda cls: True))
    assert _film.checked_path("a.MP4") == _film.Path("a.MP4")
    assert _film.positive_numbers(fps=3, size=0.5) == (3.0, 0.5)


def test_a_run_is_played_as_fast_as_is_asked_unless_that_takes_too_many_frames(monkeypatch, tmp_path):
    """Times are those of the saved states; nothing is drawn here."""
    shown, told = [], []
    room = lambda seen, above: np.array([[0.0, above], [1.0, 2.0]])  # noqa: E731
    stage = SimpleNamespace(frame=lambda i, clock: (i, float(clock.split()[2])))
    monkeypatch.setattr(_animate, "views", lambda grasp, states: np.asarray(states.q))
    monkeypatch.setattr(_animate, "limits", room)
    monkeypatch.setattr(_animate, "_Stage", lambda *given, **options: shown.append((given, options)) or stage)
    monkeypatch.setattr(_animate, "write_film", lambda *given: shown.append(given))
    grasp, run = runs.scene("pivoted")[0], runs.run("pivoted")
    path = tmp_path / "motion.gif"

    def played(**options):
        shown.clear()
        options |= {"forces": False, "progress": lambda *given: told.append(given)}
        assert _animate.animate(grasp, run, path, **options) == path
        ((_, seen, forces), look), (_, frames, delay) = shown
        assert forces is None and look["corners"][0, 1] == 0.0
        at = np.searchsorted(run.ts, [t - 0.01 for _, t in frames])
        np.testing.assert_allclose(seen, np.asarray(run.states.q)[at])
        return [t for _, t in frames], delay, look["speed"], look["size"]

    # 0.6 s at once; at six times real time in five steps of 20 ms; in steps of 80 ms, saved every 50.
    assert played(fps=25.0, speed=1e6, size=2.0) == ([0.6], 40, 1e6, 2.0)
    assert played(fps=1000.0, speed=6.0) == ([0.0, 0.1, 0.25, 0.35, 0.5, 0.6], 20, 6.0, 5.5)
    assert played(fps=12.0, until=0.4)[:3] == ([0.0, 0.1, 0.15, 0.25, 0.3, 0.4], 80, 1.0)
    assert told == [(1, 1), *((k, 6) for k in range(1, 7)), *((k, 6) for k in range(1, 7))]
    with pytest.raises(ValueError, match="argument speed must leave at most 5000 frames, but asks for 5.4e"):
        played(fps=25.0, speed=0.6 / 0.04 / 5400.0)
    with pytest.raises(ValueError, match="argument speed must show no frame for more than 655 s, but was 5"):
        played(fps=0.1, speed=5e-5)


@pytest.mark.parametrize(("size", "above"), [(3.0, True), (5.5, False)])
def test_the_pace_of_a_film_keeps_clear_of_its_clock(size, above):
    """Over a narrow grasp it has a line of its own."""
    grasp, run = runs.scene("pivoted")[0], runs.run("pivoted")
    seen = _views.views(grasp, run.states)
    look = {"corners": _artists.limits(seen), "size": size, "speed": 0.5, "clock": "t = 0.60 s"}
    stage = _animate._Stage(grasp, seen, None, **look)
    clock, pace = (text.get_window_extent() for text in (stage.clock, stage.pace))
    assert (pace.y0 > clock.y1, pace.x0 > clock.x1) == (above, not above)
    assert pace.y1 < stage.ax.figure.bbox.height


def test_labels_stand_beside_their_places_with_a_line_to_them_where_they_are_far():
    """Three points and the label's own free space away, on an axes of two pixels to a point."""
    figure = Figure(figsize=(5.0, 4.0), dpi=144.0)
    ax = figure.subplots()
    ax.set(xlim=(0.0, 100.0), ylim=(0.0, 100.0))
    at, far = np.array([50.0, 50.0]), [np.array([[1.0, 1.0], [2.0, 1.0]])]
    _tags.put_tags(ax, [_tags.Tag("$P$", at, "red", 12.0), _tags.Tag("$O$", at, "blue")], far)
    first, second = ax.texts
    box = first.get_window_extent()
    np.testing.assert_allclose(first.xyann, [3.0 + 1.5 + 0.25 * box.width, 0.0], rtol=1e-6)
    assert not box.overlaps(second.get_window_extent()) and first.arrow_patch is None
    assert (first.get_color(), first.get_fontsize(), second.get_fontsize()) == ("red", 12.0, 10.0)
    assert tuple(first.xy) == (50.0, 50.0) and not first.get_in_layout()
    # Lines all round, closer than any label is wide: a dot of theirs weighs as much as four points.
    point = 2.0 * np.abs(np.diff(ax.transData.inverted().transform([[0.0, 0.0], [1.0, 1.0]]), axis=0))[0]
    u = np.linspace(-1.0, 1.0, 41)
    hidden = [at + 25.0 * point * [[-1.0, y], [1.0, y]] for y in u]
    _tags.put_tags(ax, [_tags.Tag("$Q$", at, "green")], hidden)
    *_, last = ax.texts
    assert np.abs(last.xyann).max() > 25.0 and last.arrow_patch is not None


def test_the_angle_of_an_object_is_its_last_coordinate():
    units = lambda *names: [SimpleNamespace(unit=name) for name in names]  # noqa: E731
    for given, expected in ((units("m", "m", "rad"), 2), (units("rad"), 0), (units("m"), 0)):
        run = SimpleNamespace(labels=SimpleNamespace(bodies=[("object", given), ("finger", units("rad"))]))
        assert _design_figure._angle_of_object(run) == expected
    assert _design_figure._angle_of_object(SimpleNamespace(labels=None)) == 0


def test_guides_lead_to_the_target_or_from_tip_to_tip():
    """Of a target that moves, or of a jaw, there is none to draw."""
    centres = [np.array([[1.0, 2.0], [3.0, 5.0]]), np.array([[7.0, 8.0], [9.0, 4.0]])]
    turning, sliding = SimpleNamespace(turns=True), SimpleNamespace(turns=False)

    def guides(law, *fingers):
        grasp = SimpleNamespace(controller=law, fingers=fingers)
        return _views._guides(grasp, centres[: len(fingers)])

    press = jxr.control.Press(0.5, 0.01, 0.006, target=(0.02, 0.1))
    first, second = guides(press, turning, sliding)
    np.testing.assert_allclose(first, [[[1.0, 2.0], [20.0, 100.0]], [[3.0, 5.0], [20.0, 100.0]]])
    np.testing.assert_allclose(second[1], [[9.0, 4.0], [20.0, 100.0]])
    (line,) = guides(None, turning, turning)
    np.testing.assert_allclose(line, [[[1.0, 2.0], [7.0, 8.0]], [[3.0, 5.0], [9.0, 4.0]]])
    moving = jxr.control.Press(0.5, 0.01, 0.006, target=lambda t: (t, 0.1))
    assert guides(None, turning, sliding) == guides(None, turning) == guides(moving, turning) == ()


def test_panels_of_a_grasp_are_as_wide_as_it_is_high_within_limits():
    """Two panels of a wide grasp and of a high one, in inches."""
    for corners, size in (
        ([[0.0, 0.0], [60.0, 40.0]], (4.2 * 2 + 0.6, 2.8 + 1.9 - 0.64)),
        ([[0.0, 0.0], [30.0, 40.0]], (4.2 * 2 + 0.6, 5.6 + 1.9 - 0.64)),
        ([[0.0, 0.0], [28.0, 40.0]], (3.92 * 2 + 0.6, 5.6 + 1.9 - 0.64)),
        ([[0.0, 0.0], [10.0, 40.0]], (6.8, 2.9 * 4.0 + 1.9 - 0.64)),
    ):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(_pose, "limits", lambda seen, above, corners=corners: np.array(corners))
            grasp = SimpleNamespace(object=None, fingers=[SimpleNamespace(size=0.01)])
            figure = _pose._side_by_side(grasp, seen_twice(), ["(a)", "(b)"])
        np.testing.assert_allclose(figure.get_size_inches(), size)
        first, second = figure.axes
        assert (first.get_ylabel(), second.get_ylabel()) == ("y [mm]", "")
        assert [ax.get_title(loc="left") for ax in figure.axes] == ["(a)", "(b)"]
        assert figure.legends[0]._ncols == 4 and second.get_xlim() == (0.0, corners[1][0])


def test_a_finger_of_one_link_stands_on_a_base():
    seen = seen_twice()
    seen.joints[0] = seen.joints[0][:, 1:]
    grasp = SimpleNamespace(object=None, fingers=[SimpleNamespace(size=0.01)])
    made = _artists.Drawing(axes(), grasp, seen)
    made.show(1)
    assert [base.get_visible() for base in made.bases] == [True, False] and len(made.links[0]) == 1
    assert "fixed base" in [name for _, name in made.legend()]
    seen.joints[0] = seen.joints[0][:, 1:]
    jaws = _artists.Drawing(axes(), grasp, seen)
    jaws.show(1)
    assert not any(base.get_visible() for base in jaws.bases)
    assert "fixed base" not in [name for _, name in jaws.legend()]


def test_forces_of_contacts_and_loads_act_where_they_have_their_torque(monkeypatch):
    """At two of four times; of two contacts the second is a caller's own, which is not drawn."""
    force = np.array([[9.0, 9.0], [0.0, -2.0], [9.0, 9.0], [3.0, 4.0]])
    torque = np.array([9.0, 0.06, 9.0, -0.1])
    f = np.array([[9.0, 9.0], [2.0, 9.0], [9.0, 9.0], [1.0, 9.0]])
    lam = np.array([[9.0, 9.0], [0.5, 9.0], [9.0, 9.0], [-1.0, 9.0]])
    picks = np.array([1, 3])
    touching = {0: SimpleNamespace(sense=-1)}
    monkeypatch.setattr(_forces, "rolling_contacts", lambda grasp: touching)
    monkeypatch.setattr(_forces, "acts", lambda grasp: True)
    monkeypatch.setattr(_forces, "wrenches", lambda grasp, ts, states: (states.q, torque[picks]))
    states = jxr.State(force, force, force)
    run = SimpleNamespace(ts=np.arange(4.0), states=states, multipliers=SimpleNamespace(f=f, lam=lam))
    along = np.array([[[1.0, 0.0]], [[0.6, 0.8]]])
    body = np.array([[10.0, 20.0, 1.0, 0.0], [30.0, 50.0, 1.0, 0.0]])
    seen = SimpleNamespace(points=np.array([[[1.0, 2.0]], [[3.0, 4.0]]]), tangents=along, frames=(body,))
    corners = np.array([[10.0, 10.0], [40.0, 50.0]])
    found = _forces.arrows(None, run, picks, seen, corners=corners)
    # The outward normals are (0, -1) and (0.8, -0.6); lambda acts against the tangents here.
    pushes = np.array([[[-0.5, 2.0], [0.0, -2.0]], [[0.6 - 0.8, 0.8 + 0.6], [3.0, 4.0]]])
    assert found.loaded and found.peak == pytest.approx(5.0)
    assert found.scale == pytest.approx(0.07 * 50.0 / 5.0)
    np.testing.assert_allclose(found.vectors, found.scale * pushes)
    np.testing.assert_array_equal(found.points[:, 0], seen.points[:, 0])
    # r x F is the torque, and r stands across F: 30 mm to the left; and 20 mm across (3, 4).
    np.testing.assert_allclose(found.points[:, 1], [[10.0 - 30.0, 20.0], [30.0 - 16.0, 50.0 + 12.0]])
    monkeypatch.setattr(_forces, "acts", lambda grasp: False)
    bare = _forces.arrows(None, run, picks, seen, corners=corners)
    assert bare.vectors.shape == (2, 1, 2) and not bare.loaded
    assert bare.peak == pytest.approx(np.hypot(0.5, 2.0))


def test_a_run_may_be_compared_with_none():
    figure = _design_figure.comparison([runs.run("pivoted")], ["alone"])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["alone"]
    assert figure.axes[1].get_ylabel() == "object turned by [rad]"
    for names in ([], ["a", "b"]):
        with pytest.raises(ValueError, match="argument names must have one for each of 1 runs"):
            _design_figure.comparison([runs.run("pivoted")], names)


def test_many_contacts_and_runs_are_told_apart_and_named_within_the_picture():
    run = runs.run("ring")
    many = eqx.tree_at(
        lambda r: (r.multipliers.f, r.multipliers.lam),
        run,
        tuple(np.tile(np.asarray(x)[:, :1], (1, 8)) for x in (run.multipliers.f, run.multipliers.lam)),
    )
    names = [f"a name of a run that is long, {k}" for k in range(4)]
    figure = _design_figure.comparison([many] * 4, names)
    figure.draw_without_rendering()
    (key,) = figure.legends
    looks = [line._unscaled_dash_pattern for line in key.get_lines()]
    assert len(set(map(str, looks[4:]))) == 8
    box = key.get_window_extent()
    assert box.x0 >= 0.0 and box.x1 <= figure.bbox.width
    ax, ts = axes(), np.arange(3.0)
    names = tuple(f"line {k}" for k in range(12))
    _responses._draw(ax, ts, panel(np.outer(ts, 1.0 + np.arange(12)), names=names), np.ones(3, bool))
    assert len({line.get_color() for line in ax.get_legend().get_lines()}) == 12


def test_a_run_that_was_lost_at_once_is_compared_without_a_line():
    whole = runs.run("pivoted")
    nothing = whole.states.q * np.nan, whole.multipliers.f * np.nan, np.asarray(0.0)
    lost = eqx.tree_at(lambda run: (run.states.q, run.multipliers.f, run.stats.t_end), whole, nothing)
    figure = _design_figure.comparison([lost, whole])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["before", "after", "ended early"]
    assert {line.get_label() for ax in figure.axes for line in ax.lines if len(line.get_xdata()) > 2} == {
        "after"
    }


def test_runs_in_space_are_compared_by_the_turn_of_their_object():
    """Places on surfaces are points on both of them: their changes are no length that was rolled."""
    run = runs.run("pinch3d")
    figure = _design_figure.comparison([run], ["alone"])
    turn, moved = figure.axes[:2]
    assert (turn.get_title(loc="left"), turn.get_ylabel()) == ("Turn of the object", "object turned by [rad]")
    assert moved.get_ylabel() == "object moved by [mm]"
    # The scalar part of the turn from one unit quaternion to another is their product, as vectors.
    q = np.asarray(run.states.q)[:, 3:7]
    (line,) = (line for line in turn.lines if len(line.get_xdata()) > 2)
    np.testing.assert_allclose(line.get_ydata(), 2.0 * np.arccos(np.clip(q @ q[0], -1.0, 1.0)), atol=1e-7)
    with pytest.raises(ValueError, match="run 'b' lives in the plane and 'a' in space"):
        _design_figure.comparison([run, runs.run("pivoted")], ["a", "b"])


def test_places_of_own_contacts_are_not_compared_as_lengths():
    """Of three places the first two are of a contact of one's own, whose units nobody knows."""
    run = runs.run("ring")
    places = [
        Coordinate("contact 0 s[0]", ""),
        Coordinate("contact 0 s[1]", ""),
        Coordinate("contact 1", "m"),
    ]
    labels = run.labels._replace(places=tuple(places))
    figure = _design_figure.comparison([dataclasses.replace(run, labels=labels)], ["alone"])
    (line,) = (line for line in figure.axes[0].lines if len(line.get_xdata()) > 2)
    s = np.asarray(run.states.s)
    np.testing.assert_allclose(line.get_ydata(), 1e3 * (s[:, 2] - s[0, 2]), atol=1e-12)
    assert line.get_linestyle() == "--"  # of the second contact


def test_a_picture_of_a_potential_has_no_value_off_either_pair_of_contours(monkeypatch):
    """The first contact ends where s1 is 3 mm, the second where s2 is -6 mm."""
    seen = []
    monkeypatch.setattr(_phase, "_potential", lambda grasp, s: 2.0 * s[..., 0] + 7.0 * s[..., 1])
    levels = lambda energy, about: seen.append((energy, about)) or np.linspace(-80.0, 80.0, 5)  # noqa: E731
    monkeypatch.setattr(_phase, "energy_levels", levels)
    wide, at = jxr.Line((-0.5, 0.5)), {"s_tip": 0.0, "s_object": 0.0, "sense": 1}
    first, second = SimpleNamespace(**at), SimpleNamespace(**at)
    shapes = {id(first): (wide, jxr.Line((-0.5, 0.003))), id(second): (wide, jxr.Line((-0.006, 0.5)))}
    grasp = SimpleNamespace(contacts=[first, second], shapes=lambda contact: shapes[id(contact)])
    ax = axes()
    _phase._levels(ax, grasp, np.array([0.002, -0.005]), 0.004)
    ((energy, about),) = seen
    s1, s2 = np.meshgrid(0.002 + np.linspace(-0.004, 0.004, 81), -0.005 + np.linspace(-0.004, 0.004, 81))
    # In millijoules; off by a trillionth of a metre, the ends themselves are there or not.
    clear = (np.abs(s1 - 0.003) > 1e-9) & (np.abs(s2 + 0.006) > 1e-9)
    expected = np.where((s1 < 0.003) & (s2 > -0.006), 1e3 * (2.0 * s1 + 7.0 * s2), NAN)
    np.testing.assert_allclose(energy[clear], expected[clear], rtol=1e-12, equal_nan=True)
    assert about == 16 and ax.get_aspect() == 1.0
    assert ax.figure.axes[1].get_ylabel() == "$U$ [mJ]" and len(ax.collections) == 2
    assert ax.dataLim.x0 >= -2.0 - 1e-9 and ax.dataLim.x1 <= 6.0 + 1e-9


def test_a_view_may_say_one_angle_and_leave_the_other():
    scene = SimpleNamespace(times=5, on_object=[])
    given = ((None, None, (22.0, -58.0)), (3.0, None, (3.0, -58.0)), (None, 0.0, (22.0, 0.0)))
    for elevation, azimuth, found in (*given, (0.0, 9.0, (0.0, 9.0))):
        assert _poses3.facing(scene, jxr.plotting.View(elevation, azimuth)) == found


@pytest.mark.parametrize(("radius", "look"), [(None, (0.5, 1.45)), (0.8, (0.8, 1.0))])
def test_pieces_of_a_link_as_near_as_the_tip_itself_go_where_the_tip_goes(radius, look):
    """Of an object before all of the finger; corners of the tip are sqrt(14) from its frame.

    Links that have a radius have joints as wide as they are.
    """
    towards = light = np.array([1.0, 0.0, 0.0])
    ahead = np.tile([10.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (2, 1))
    body = _scene3.Solid(_scene3.box_mesh(np.array([1.0, 1.0, 1.0])), ahead, -1)
    tip = solid(_scene3.box_mesh(np.array([2.0, 4.0, 6.0])))
    skeleton = np.array([[0.0, 0.0, -20.0], [0.0, 4.0, -10.0], [0.0, 0.0, 0.0]])
    scene = SimpleNamespace(
        solids=(body, tip), skeletons=[np.stack([skeleton + 50.0, skeleton])], thickness=0.5, radii=(radius,)
    )
    pieces = [corners for corners, _ in _drawing3._limbs(skeleton, look, towards, light)]
    near = np.concatenate(pieces)
    near = near[np.linalg.norm(near.mean(axis=1), axis=1) < 14.0**0.5]
    faces, _ = _drawing3._faces(tip, 1, towards, light)
    for nearer in (True, False):
        seen = SimpleNamespace(scene=scene, _nearer=lambda i, finger, way, nearer=nearer: nearer)
        behind, own, before = (part for part, _ in _drawing3.Drawing3.parts(seen, 1, towards, light))
        assert len(own) == 2 and len(behind) + len(before) == len(faces) + sum(map(len, pieces))
        expected = np.concatenate([faces, near]) if nearer else np.zeros((0, 3, 3))
        np.testing.assert_array_equal(before, expected)


def test_a_design_stands_in_its_own_part_of_the_figure():
    """Both contours on the left, margins above the search on the right."""
    figure = _design_figure.design(runs.designed())
    cells = [ax.get_subplotspec().get_topmost_subplotspec() for ax in figure.axes]
    assert [list(cell.colspan) for cell in cells] == [[0], [0], [1], [1]]
    assert [list(cell.rowspan) for cell in cells] == [[0, 1], [0, 1], [0], [1]]
    columns = [list(ax.get_subplotspec().colspan) for ax in figure.axes[:2]]
    assert columns == [[0], [1]]
