"""Pictures are as they were when someone last looked at them, and show what they say.

Each figure is drawn once on small runs that are made by formulas, and compared with `tests/recorded`, artist
by artist. What can be worked out by hand is checked besides.
"""

import contextlib
import importlib.util

import jax
import numpy as np
import pytest
from mpl_toolkits.mplot3d import proj3d

from jaxroll import plotting
from jaxroll.plotting._artists3 import Arrow
from jaxroll.plotting._forces3 import pushes
from jaxroll.plotting._poses3 import facing, stage
from jaxroll.plotting._scene3 import scene3
from jaxroll.plotting._style import CONTACT, FINGER, FORCE_COLOUR, OBJECT
from jaxroll.plotting._views3 import scene_motion
from tests.recorded import compare, pictures, runs

NEEDS_PLOTLY = pytest.mark.skipif(importlib.util.find_spec("plotly") is None, reason="needs the extra viz")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[NEEDS_PLOTLY] * (name in pictures.PAGES)) for name in pictures.PICTURES],
)
def test_a_picture_is_as_recorded(name):
    compare.check(name, pictures.PICTURES[name]())


def test_a_difference_names_artist_and_property():
    figure = plotting.poses(runs.scene("pivoted")[0], runs.run("pivoted"))
    before = pictures.drawn(figure)
    figure.axes[1].lines[0].set_color("red")
    figure.axes[1].patches[0].set_zorder(7.0)
    figure.legends[0].get_texts()[0].set_text("another")
    told = compare.differences(pictures.drawn(figure), before)
    assert len(told) == 3 and all("t = 0.6 s" in line for line in told[1:])
    assert 'Legend 0 > entries > 0: is "another", was "fingertip"' in told[0]
    assert "Line2D 0 > colour" in told[1] + told[2] and "Polygon 0 > z-order: is 7.0" in told[1] + told[2]


def test_numbers_are_compared_at_the_scale_of_their_list():
    record = compare.described({"a": np.array([1.0, 1e-9]), "b": "t = 0.30 s", "c": 3, "d ±2": [5, 6]})
    near = compare.described({"a": np.array([1.0, 2e-9]), "b": "t = 0.31 s", "c": 3, "d ±2": [6, 5]})
    far = compare.described({"a": np.array([1.0, 1e-3]), "b": "t = 0.32 s", "c": 4, "d ±2": [9, 6]})
    assert compare.differences(near, record) == [] and len(compare.differences(far, record)) == 4
    long = np.sin(np.arange(500.0))
    swapped, one = long.copy(), long.copy()
    swapped[[200, 300]], one[123] = long[[300, 200]], 0.5
    for other in (swapped, one, long[:-1], np.where(np.arange(500) == 77, np.nan, long)):
        assert compare.differences(compare.described(other), compare.described(long))


def distance(points, line):
    """Of each point from a polyline."""
    a, b = line[:-1], line[1:]
    along = np.sum((points[:, None] - a) * (b - a), axis=-1) / np.maximum(
        np.sum((b - a) ** 2, axis=-1), 1e-12
    )
    feet = a + np.clip(along, 0.0, 1.0)[..., None] * (b - a)
    return np.linalg.norm(points[:, None] - feet, axis=-1).min(axis=1)


@pytest.mark.parametrize("name", ["pivoted", "pinch", "roller"])
def test_drawn_contours_meet_at_the_contact_points(name):
    ax = plotting.pose(*runs.scene(name)).axes[0]
    lines = {
        colour: [x.get_xydata() for x in ax.lines if x.get_color() == colour] for colour in (FINGER, OBJECT)
    }
    (points,) = [x.get_xydata() for x in ax.lines if x.get_markerfacecolor() == CONTACT]
    assert len(points) == len(runs.scene(name)[0].contacts)
    for drawn in lines.values():
        assert np.min([distance(points, line) for line in drawn], axis=0).max() < 0.01  # mm


def test_arrows_in_the_plane_have_the_directions_and_lengths_of_the_forces():
    """A roller between level plates: the upper one presses down on it, the lower one up."""
    grasp, _ = runs.scene("roller")
    run = runs.run("roller")
    ax = plotting.poses(grasp, run, times=(0.0,), forces=True).axes[0]
    upper, lower, key = [x._posA_posB for x in ax.patches if x.get_edgecolor()[:3] == pytest.approx(rgb())]
    newtons = float(next(x.get_text() for x in ax.texts if x.get_text().endswith(" N")).removesuffix(" N"))
    scale = np.linalg.norm(np.subtract(*key)) / newtons
    f, lam = (np.asarray(x)[0] for x in (run.multipliers.f, run.multipliers.lam))
    for (start, end), down, k in ((upper, -1.0, 0), (lower, 1.0, 1)):
        across, along = np.subtract(end, start) / scale
        assert along == pytest.approx(down * f[k]) and abs(across) == pytest.approx(lam[k])
        assert start == pytest.approx((0.0, 10.0 - 10.0 * down), abs=1e-6)


def rgb():
    from matplotlib.colors import to_rgb

    return to_rgb(FORCE_COLOUR)


def test_arrows_in_space_have_the_directions_and_lengths_of_the_forces():
    """A ball on a level table: the normal force points up, the other is as recorded in world axes."""
    grasp, state = runs.scene("turntable")
    run = runs.run("turntable")
    first = jax.tree.map(lambda x: x[:1], run.states)
    motion = scene_motion(grasp, first)
    (found,) = pushes(grasp, run, motion).contacts[0, :1]
    f, lam = np.asarray(run.multipliers.f)[0, 0], np.asarray(run.multipliers.lam)[0, 0]
    np.testing.assert_allclose(found, lam + f * np.array([0.0, 0.0, 1.0]), atol=1e-12)
    ax = plotting.poses(grasp, run, times=(0.0,), forces=True).axes[0]
    *_, drawn = [x.ends for x in ax.artists + ax.patches if isinstance(x, Arrow)]
    way = drawn[1] - drawn[0]
    np.testing.assert_allclose(way / np.linalg.norm(way), found / np.linalg.norm(found), atol=1e-9)


@pytest.mark.parametrize(
    "view", [None, pictures.VIEW, plotting.View(80.0, 10.0), plotting.View(-20.0, 200.0)]
)
@pytest.mark.parametrize("name", ["pinch3d", "rattleback", "turntable", "stand-in"])
def test_the_camera_keeps_all_bodies_in_view(name, view):
    view = plotting.View() if view is None else view
    if name == "stand-in":
        grasp, motion, _ = runs.stand_in()
    else:
        grasp = runs.scene(name)[0]
        motion = scene_motion(grasp, runs.run(name).states)
    scene = scene3(grasp, motion, links=view.links)
    figure, (ax,) = stage(scene, facing(scene, view), 5.0)
    cloud = [s.reshape(-1, 3) for s in scene.skeletons]
    cloud += [solid.at(i) for solid in scene.solids for i in range(scene.times)]
    ax.apply_aspect()
    x, y, _ = proj3d.proj_transform(*np.concatenate(cloud).T, ax.get_proj())
    shares = ax.transData.transform(np.stack([x, y], axis=-1)) / figure.bbox.size
    assert shares.min() > 0.02 and shares.max() < 0.98
    assert np.ptp(shares, axis=0).max() > 0.4  # and they fill it


@NEEDS_PLOTLY
def test_the_ring_of_a_page_lies_flat_about_the_contact():
    """On a level table under the ball, whose centre is above its middle."""
    import plotly.graph_objects as plotly

    made = []
    with contextlib.ExitStack() as stack:
        patch = stack.enter_context(pytest.MonkeyPatch.context())
        patch.setattr(plotly.Figure, "write_html", lambda figure, *args, **options: made.append(figure))
        grasp, state = runs.scene("turntable")
        run = runs.run("turntable")
        plotting.page(grasp, run, "grasp.html", frames=3)
    last = made[0].frames[-1].data
    at = [trace.name for trace in made[0].data].index("contact: ring in the tangent plane")
    ring = np.stack([last[at][axis] for axis in "xyz"], axis=-1)[:-1].astype(float)
    motion = scene_motion(grasp, run.states)
    body, on_object = motion.body[-1], motion.on_object[0, -1]
    assert np.ptp(ring, axis=0).max() > 10.0
    x, y, z = body[3:7][1:]
    w = body[3]
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    centre, out = 1e3 * (body[:3] + turn @ on_object), turn @ motion.out_of_object[0, -1]
    np.testing.assert_allclose((ring - centre) @ out, 0.0, atol=1e-4)
    radii = np.linalg.norm(ring - centre, axis=1)
    np.testing.assert_allclose(radii, radii[0], rtol=1e-5)
