"""Pictures of simulated grasps in space: what they show is what the run did."""

import jax
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import jaxroll as jxr
from jaxroll import plotting
from jaxroll.plotting._forces3 import pushes
from jaxroll.plotting._scene3 import scene3
from jaxroll.plotting._style import LOCUS_OBJECT, LOCUS_TIP
from jaxroll.plotting._views3 import scene_motion

# `pinch3d` takes half a minute to compile.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def pinch():
    """Part 3, a short run of it: grasp and run."""
    grasp, state = jxr.scenes.pinch3d()
    return grasp, jxr.simulate(grasp, state, t1=0.3, ts=31, record=("multipliers", "energy"))


@pytest.fixture(scope="module")
def table():
    """A ball on a turntable: grasp and run."""
    grasp, state = jxr.scenes.turntable()
    return grasp, jxr.simulate(grasp, state, t1=1.0, ts=21, record=("multipliers",))


@pytest.fixture(scope="module")
def flat():
    """A run in the plane."""
    grasp, state = jxr.scenes.pivoted()
    return grasp, jxr.simulate(grasp, state, t1=0.1, ts=3)


def rotations(quaternions):
    return Rotation.from_quat(np.array(quaternions)[:, [1, 2, 3, 0]])


def chain(finger, angles):
    """Joints and tip frame of a finger, by scipy."""
    points, turn = [np.array(finger.base)], Rotation.identity()
    for axis, offset, angle in zip(finger.axes, finger.offsets, angles, strict=True):
        turn = turn * Rotation.from_rotvec(float(angle) * np.array(axis))
        points.append(points[-1] + turn.apply(np.array(offset)))
    return np.array(points), turn


def test_the_motion_is_the_runs(pinch):
    grasp, run = pinch
    motion, q = scene_motion(grasp, run.states), np.asarray(run.states.q)
    np.testing.assert_allclose(motion.body[:, :3], q[:, :3], atol=1e-15)
    assert (rotations(motion.body[:, 3:]) * rotations(q[:, 3:7]).inv()).magnitude().max() < 1e-12
    for k in (0, 17, 30):
        for i, finger in enumerate(grasp.fingers):
            points, turn = chain(finger, q[k, 7 + 3 * i : 10 + 3 * i])
            np.testing.assert_allclose(motion.skeletons[i][k], points, atol=1e-14)
            np.testing.assert_allclose(motion.tips[i, k, :3], points[-1], atol=1e-14)
            assert (rotations(motion.tips[i, k : k + 1, 3:]) * turn.inv()).magnitude().max() < 1e-7


@pytest.mark.parametrize("scene", ["pinch", "table"])
def test_contact_points_and_normals_of_both_bodies_meet(scene, request):
    grasp, run = request.getfixturevalue(scene)
    motion = scene_motion(grasp, run.states)
    body = rotations(motion.body[:, 3:])
    for k, contact in enumerate(grasp.contacts):
        frames = motion.tips[contact.finger]
        tip = rotations(frames[:, 3:])
        on_tip = frames[:, :3] + tip.apply(motion.on_tip[k])
        on_object = motion.body[:, :3] + body.apply(motion.on_object[k])
        np.testing.assert_allclose(on_tip, on_object, atol=1e-13)
        opposed = tip.apply(motion.out_of_tip[k]) + body.apply(motion.out_of_object[k])
        np.testing.assert_allclose(opposed, 0.0, atol=1e-12)
        surface = grasp.object.surfaces[contact.surface]
        near = np.asarray(surface.point(surface.near(motion.on_object[k])))
        np.testing.assert_allclose(near, motion.on_object[k], atol=1e-12)


def test_drawn_forces_move_the_object(pinch):
    """Their sum is mass times acceleration of the object, which gravity does not pull here."""
    grasp, run = pinch
    motion = scene_motion(grasp, run.states)
    forces = pushes(grasp, run, motion).contacts
    inwards = -rotations(motion.body[:, 3:]).apply(motion.on_object[0])
    assert (np.sum(forces[0] * inwards, axis=-1) > 0.0).all()
    np.testing.assert_allclose(
        np.sum(forces**2, -1).T, run.multipliers.f**2 + np.sum(run.multipliers.lam**2, -1)
    )
    forces = forces.sum(axis=0)
    fine = jxr.simulate(grasp, run.last, t1=2e-3, ts=np.linspace(0, 2e-3, 3), rtol=1e-10)
    v = np.asarray(fine.states.v)[:, :3]
    found = float(grasp.object.mass) * (-3 * v[0] + 4 * v[1] - v[2]) / 2e-3
    assert np.abs(found).max() > 1e-3
    np.testing.assert_allclose(forces[-1], found, atol=1e-2 * np.abs(found).max())


def lines(figure, colour, panel=0):
    found = [line for line in figure.axes[panel].lines if line.get_color() == colour]
    return [np.array(line.get_data_3d()).T for line in found[::2]]


def test_poses_show_both_loci_up_to_their_time(pinch, tmp_path):
    grasp, run = pinch
    figure = plotting.poses(grasp, run, times=(0.1, 0.3), forces=True)
    assert [text.get_text() for text in figure.texts] == ["(a)  t = 0.1 s", "(b)  t = 0.3 s"]
    figure.savefig(tmp_path / "poses.png")
    for panel, count in ((0, 11), (1, 31)):
        for on_tip, on_body in zip(
            lines(figure, LOCUS_TIP, panel), lines(figure, LOCUS_OBJECT, panel), strict=True
        ):
            assert len(on_tip) == len(on_body) == count
            np.testing.assert_allclose(on_tip[-1], on_body[-1], atol=1e-9)
            assert np.ptp(on_tip, axis=0).max() > 1.0  # mm
    near = plotting.poses(grasp, run, view=plotting.View(10.0, 30.0, links=False)).axes[0]
    far = figure.axes[0]
    assert (near.elev, near.azim) == (10.0, 30.0) and np.ptp(near.get_xlim()) < np.ptp(far.get_xlim())


def test_one_pose_is_drawn(pinch):
    grasp, run = pinch
    figure = plotting.pose(grasp, jax.tree.map(lambda x: x[4], run.states))
    at = np.array(figure.axes[0].lines[-1].get_data_3d()).T  # the contact points
    motion = scene_motion(grasp, run.states)
    wanted = motion.body[4, :3] + rotations(motion.body[4:5, 3:]).apply(motion.on_object[:, 4])
    np.testing.assert_allclose(at, 1e3 * wanted, atol=1e-9)


def test_a_stage_is_a_patch_that_holds_the_whole_locus(table, tmp_path):
    grasp, run = table
    motion = scene_motion(grasp, run.states)
    scene = scene3(grasp, motion)
    ball, patch = scene.solids
    low, high = patch.mesh.vertices.min(axis=0), patch.mesh.vertices.max(axis=0)
    path = scene.on_tips[0].points
    assert (path[:, :2] > low[:2]).all() and (path[:, :2] < high[:2]).all()
    assert np.ptp(path, axis=0).max() < (high - low)[0] < 2.5 * np.ptp(path, axis=0).max()
    assert ball.frames[0, 2] == pytest.approx(50.0) and patch.frames[-1, 3] == pytest.approx(np.cos(1.0))
    names = [text.get_text() for text in plotting.poses(grasp, run).legends[0].get_texts()]
    assert "stage" in names and "fingertip" not in names
    with Image.open(plotting.animate(grasp, run, tmp_path / "a.gif", until=0.5, fps=10)) as image:
        assert image.n_frames == 6


def test_responses_in_space(pinch, tmp_path):
    grasp, run = pinch
    axes = {ax.get_title(loc="left"): ax for ax in plotting.responses(grasp, run, tmp_path).axes}

    def drawn(title):
        """Lines over time, without that at zero."""
        return np.array([line.get_ydata() for line in axes[title].lines if len(line.get_ydata()) == 31])

    q, v = np.asarray(run.states.q), np.asarray(run.states.v)
    np.testing.assert_allclose(drawn("Position of the object").T, 1e3 * (q[:, :3] - q[0, :3]))
    turned = Rotation.from_rotvec(drawn("Orientation of the object").T)
    assert (turned * rotations(q[:1, 3:7]) * rotations(q[:, 3:7]).inv()).magnitude().max() < 1e-12
    np.testing.assert_allclose(drawn("Joint angles of finger 2").T, q[:, 10:13] - q[0, 10:13])
    np.testing.assert_allclose(drawn("Joint rates of finger 1").T, v[:, 6:9])
    f, lam = np.asarray(run.multipliers.f), np.linalg.norm(run.multipliers.lam, axis=-1)
    np.testing.assert_allclose(drawn("Normal force").T, f)
    np.testing.assert_allclose(drawn("Tangential force").T, lam)
    np.testing.assert_allclose(drawn("Friction that rolling needs").T, lam / f)
    assert {"Normal gap (rounding level)", "Energy balance (rounding level)"} <= axes.keys()
    assert (tmp_path / "responses.png").stat().st_size > 50_000


def test_responses_of_a_stage_leave_out_its_clock(table):
    titles = [ax.get_title(loc="left") for ax in plotting.responses(*table).axes]
    assert not [title for title in titles if "oint" in title]


def test_loci_are_plotted_over_their_arclength(table, tmp_path):
    grasp, run = table
    found = jxr.loci(grasp, run)
    lengths, off, *rows = plotting.loci(grasp, run, tmp_path).axes
    names = ("normal_curvature", "geodesic_curvature", "geodesic_torsion", "torsion")
    for line, locus in zip(lengths.lines, (found.tip, found.object), strict=True):
        np.testing.assert_allclose(line.get_ydata(), 1e3 * locus.arclength[0])
    for ax, name in zip(rows, names, strict=True):
        power = float(ax.get_ylabel().split("{")[-1].split("}")[0]) if "^" in ax.get_ylabel() else 0.0
        for line, locus in zip(ax.lines, (found.tip, found.object), strict=False):
            np.testing.assert_allclose(line.get_xdata(), 1e3 * locus.arclength[0])
            wanted = 1e-3 * np.asarray(getattr(locus, name))[0] / 10.0**power
            np.testing.assert_allclose(line.get_ydata(), wanted, rtol=1e-12, atol=1e-12)
    assert off.get_title(loc="left").endswith("(rounding level)")
    ball = rows[0].lines[1].get_ydata()
    np.testing.assert_allclose(ball, 1.0 / 50.0, rtol=1e-9)  # 1/mm, of a ball of 50 mm
    assert (tmp_path / "loci.png").stat().st_size > 10_000


def test_a_page_of_a_run(pinch, tmp_path):
    pytest.importorskip("plotly")
    text = plotting.page(*pinch, tmp_path / "page.html", frames=3, title="In space").read_text()
    assert "In space" in text and "locus on the fingertip" in text


def test_pictures_of_a_run_that_ended_early(table, tmp_path):
    grasp, run = table
    states = jax.tree.map(lambda x: np.where(np.arange(21)[:, None] < 11, x, np.nan), run.states)
    cut = type(run)(
        run.ts, states, run.last, run.residuals, run.result, run.stats, run.multipliers, run.energy
    )
    figure = plotting.poses(grasp, cut)
    assert figure.texts[1].get_text() == "(b)  t = 0.5 s"
    with Image.open(plotting.animate(grasp, cut, tmp_path / "a.gif", fps=10)) as image:
        assert image.n_frames == 6


def test_what_a_kind_of_grasp_does_not_have_is_one_sentence(pinch, flat, tmp_path):
    grasp, run = pinch
    view = plotting.View(azimuth=10.0)
    cases = {
        "must live in the plane": [
            lambda: plotting.contours(grasp),
            lambda: plotting.phase(grasp, run),
        ],
        "must live in space": [
            lambda: plotting.loci(*flat),
        ],
        "argument view must be None for a grasp in the plane": [
            lambda: plotting.pose(flat[0], flat[1].last, view=view),
            lambda: plotting.poses(*flat, view=view),
            lambda: plotting.page(*flat, tmp_path / "page.html", view=view),
            lambda: plotting.animate(*flat, tmp_path / "a.gif", view=view),
        ],
        "argument ax must be None for a grasp in space": [
            lambda: plotting.pose(grasp, run.last, ax=plotting.responses(*flat).axes[0]),
        ],
    }
    for words, calls in cases.items():
        for call in calls:
            with pytest.raises(ValueError, match=words):
                call()
    bare = type(run)(run.ts, run.states, run.last, run.residuals, run.result, run.stats)
    with pytest.raises(ValueError, match="record="):
        plotting.poses(grasp, bare, forces=True)


def test_the_report_of_a_run_in_space(pinch):
    _, run = pinch
    q, text = np.asarray(run.states.q), str(run)
    angle = (rotations(q[-1:, 3:7]) * rotations(q[:1, 3:7]).inv()).magnitude()[0]
    assert f"turned by {angle:.4f} rad" in text and f"{1e3 * (q[-1, 1] - q[0, 1]):+.3f}" in text
    assert max(map(len, text.splitlines())) <= 100
