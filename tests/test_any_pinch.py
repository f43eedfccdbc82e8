"""Objects of any shape between two fingers, and the commands that begin with a file."""

import dataclasses
import re
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxroll as jxr
from jaxroll import _cli, stability
from jaxroll.__main__ import main
from jaxroll._cli import _pinch_command, ShapeOrder
from jaxroll._cli._shape_file import _check_spread, read, size_told, smooth_shape
from jaxroll.scenes import _any_pinch, _pinch_targets
from jaxroll.scenes._any_pinch import _turns
from tests.recorded import runs

ROUND = 2.0 * np.pi * np.arange(200) / 200
EGG = np.stack([35.0 * np.cos(ROUND) + 4.0 * np.cos(2.0 * ROUND), 20.0 * np.sin(ROUND)], axis=-1)


def off(grasp, state):
    """The largest gap or tangency."""
    left = jxr.residuals(grasp, state)
    return max(float(jnp.abs(part).max()) for part in (left.normal, left.tangential, left.tangency))


def test_an_ellipse_is_held_across_its_narrow_side_and_stays():
    grasp, state = jxr.scenes.pinch_object(jxr.FreeObject.uniform(jxr.Ellipse(0.02, 0.035), density=20.0))
    assert off(grasp, state) < 1e-12
    # The ends of the short axis: points of the object in its own frame.
    points = [grasp.object.contours[0].point(c.s_object) for c in grasp.contacts]
    np.testing.assert_allclose(np.sort(np.array(points)[:, 0]), [-0.02, 0.02], atol=1e-9)
    np.testing.assert_allclose(np.array(points)[:, 1], 0.0, atol=1e-9)
    # Three weights of pressing, along the line between both contacts, where it rests beside the start.
    found = stability.assess(grasp, state)
    np.testing.assert_allclose(found.equilibrium.state.q, state.q, atol=2e-3)
    force = found.equilibrium.multipliers.f
    np.testing.assert_allclose(force, 3.0 * 9.81 * float(grasp.object.mass), rtol=1e-3)
    assert np.max(np.real(found.rates)) < 1e-9


def test_an_object_is_turned_so_that_two_points_of_it_face_two_fingers():
    across, along = np.array([1.0, 2.0]), np.array([-3.0, 0.5])
    (turn,) = _turns(None, across, along)
    np.testing.assert_allclose(turn @ across / np.hypot(1.0, 2.0), along / np.hypot(3.0, 0.5))
    np.testing.assert_allclose(turn @ turn.T, np.eye(2), atol=1e-15)
    # In space by quarter turns, at first with the longest extent upright, as far as that may be.
    across, along, long = np.array([1.0, 2.0, 0.0]), np.array([-3.0, 0.5, 1.0]), np.array([0.0, 0.0, 1.0])
    turns = _turns(SimpleNamespace(inertia=(3.0, 2.0, 1.0)), across, along)
    ahead = along / np.linalg.norm(along)
    upright = np.array([0.0, 0.0, 1.0]) - ahead[2] * ahead
    wanted = upright / np.linalg.norm(upright)
    assert len(turns) == 4
    for turn in turns:
        np.testing.assert_allclose(turn @ across / np.sqrt(5.0), ahead)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(turn) > 0.0 and abs(turn @ long @ wanted) == pytest.approx(1.0)
        wanted = np.cross(ahead, wanted)


def test_a_hand_in_space_is_the_chapters_times_its_size():
    grasp, _ = runs.scene("pinch3d")
    for finger, own in zip(_any_pinch._chapter_hand3(2.0), grasp.fingers, strict=True):
        np.testing.assert_allclose(finger.offsets, 2.0 * np.asarray(own.offsets))
        np.testing.assert_allclose(finger.masses, 8.0 * np.asarray(own.masses))
        np.testing.assert_allclose(finger.base, 2.0 * np.asarray(own.base))
        assert float(finger.tip.radius) == 0.02


def test_joints_are_tried_within_their_ranges_and_within_a_turn():
    free, held = SimpleNamespace(limits=None), SimpleNamespace(limits=[(-0.5, 9.0), (-4.0, 1.0)])
    assert _any_pinch._ranges(free) == (-np.pi / 2, np.pi / 2)
    np.testing.assert_allclose(_any_pinch._ranges(held), [(-0.5, -np.pi), (np.pi, 1.0)])


@pytest.mark.parametrize("near", [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8)])
def test_a_frame_has_its_third_axis_as_near_as_may_be_and_turns_are_told_as_positions(near):
    first = np.array([0.0, 0.6, 0.8])
    frame = _any_pinch._frame(first, np.array(near))
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-15)
    assert np.linalg.det(frame) > 0.0
    np.testing.assert_allclose(frame[:, 0], first)
    across = np.array(near) - (np.array(near) @ first) * first
    np.testing.assert_allclose(frame[:, 2], across / np.linalg.norm(across), atol=1e-15)
    along = _any_pinch._frame(first, first)  # nothing is across: any third axis will do
    np.testing.assert_allclose(along.T @ along, np.eye(3), atol=1e-15)
    w, x, y, z = _any_pinch._as_positions(frame)
    turn = Rotation.from_quat([x, y, z, w]).as_matrix()
    np.testing.assert_allclose(turn, frame, atol=1e-12)
    place = np.array([0.1, -0.2, 0.3])
    points = np.array([[0.01, 0.02, 0.03], [-0.01, 0.0, 0.05]])
    at = _pinch_targets._in_world(points, points / 0.05, np.array([*place, w, x, y, z]))
    np.testing.assert_allclose(at, [place + points @ frame.T, points @ frame.T / 0.05], atol=1e-12)


def test_an_object_is_put_so_that_its_points_are_about_the_middle_of_the_hand():
    # 0.06 m apart, in a frame far off: the hand is twice the chapter's, whose middle is (27.5, 115) mm.
    points = np.array([[[0.32, 0.1], [0.38, 0.1]]])
    normals = np.array([[[-1.0, 0.0], [1.0, 0.0]]])
    pairs = SimpleNamespace(points=points, normals=normals, distance=np.array([0.06]))
    for (_, pose, order), ahead in zip(
        _any_pinch._placed(None, None, pairs, 0), (115, 115, 100), strict=False
    ):
        (x, y, angle), ends = pose, points[0, list(order)]
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        np.testing.assert_allclose(np.array([x, y]) + turn @ ends.mean(axis=0), [0.055, 2e-3 * ahead])
        np.testing.assert_allclose(turn @ (ends[1] - ends[0]), [0.06, 0.0], atol=1e-15)


@pytest.fixture(scope="module")
def pinched_disc():
    """A disc that two fingers of the chapter's kind pinch with 2 N: grasp and state."""
    body = jxr.FreeObject.uniform(jxr.Circle(0.015), density=20.0)
    return jxr.scenes.pinch_object(body, force=2.0)


def test_fingers_are_damped_as_their_own_inertia_asks(pinched_disc):
    """Each link's mass at a third of the square of the whole length: 47 % of what is critical."""
    grasp, state = pinched_disc
    centres = _any_pinch.tip_origins(grasp, np.asarray(state.q))
    stiffness = 2.0 / np.linalg.norm(centres[1] - centres[0])
    for finger, damping in zip(grasp.fingers, grasp.controller.damping, strict=True):
        length = float(np.sum(np.asarray(finger.lengths)))
        inertia = float(np.sum(np.asarray(finger.masses))) * length**2 / 3.0
        critical = 2.0 * np.sqrt(stiffness * length**2 * inertia)
        assert float(damping) == pytest.approx(0.235 * critical)


def test_fingers_of_ones_own_and_a_force():
    fingers = [
        jxr.Finger([0.08, 0.07], [0.03, 0.02], jxr.Circle(0.012), base=(x, 0.0)) for x in (-0.05, 0.05)
    ]
    body = jxr.FreeObject.uniform(jxr.Circle(0.015), density=20.0)
    grasp, state = jxr.scenes.pinch_object(body, fingers=fingers, force=2.0)
    assert off(grasp, state) < 1e-12
    assert [f.tip.radius for f in grasp.fingers] == [0.012, 0.012]
    np.testing.assert_allclose(jxr.multipliers(grasp, jnp.zeros(()), state).f, 2.0, rtol=1e-6)


def one_joint(tip):
    """An object, and two fingers of one joint each: their tips are on circles."""
    fingers = [jxr.Finger([0.06], [0.03], tip, base=(x, 0.0)) for x in (-0.03, 0.03)]
    return jxr.FreeObject.uniform(jxr.Ellipse(0.02, 0.035), density=20.0), fingers


def test_few_joints_are_put_where_both_tips_touch(monkeypatch):
    """Found at the first try: a posture nearby has both round tips apart as the object is wide."""
    tries = []
    monkeypatch.setattr(_any_pinch, "reach", lambda *a, **k: tries.append(1) or jxr.reach(*a, **k))
    body, fingers = one_joint(jxr.Circle(0.012))
    assert off(*jxr.scenes.pinch_object(body, fingers=fingers)) < 1e-12
    assert len(tries) == 1


@pytest.mark.parametrize("code", ["unreachable", "penetration"])
def test_tries_are_few_and_the_refusal_counts_them(code, monkeypatch):
    tries = []

    def failing(grasp, points, pose):
        tries.append(np.round(_pinch_targets._in_world(points, points, pose)[0], 9).tobytes())
        return SimpleNamespace(result=getattr(jxr.RESULTS, code), reason="finger 0: it is a stub")

    monkeypatch.setattr(_any_pinch, "reach", failing)
    body, fingers = one_joint(jxr.Ellipse(0.010, 0.012))
    with pytest.raises(ValueError) as refused:
        # So little friction that antipodal points are left.
        jxr.scenes.pinch_object(body, fingers=fingers, friction=1e-6)
    told = str(refused.value)
    assert (
        f"did not in {len(tries)} tries; at the last finger 0: it is a stub; round tips, or 2 joints" in told
    )
    # What the fingers cannot touch is not searched for again with the object's ends swapped.
    assert len(tries) <= 30
    assert (len(set(tries)) == len(tries)) == (code == "unreachable")


def test_what_is_beyond_a_fingers_length_is_found_by_arithmetic():
    _, fingers = one_joint(jxr.Circle(0.012))
    ends, angle = np.array([[-0.02, 0.0], [0.02, 0.0]]), np.array([0.3])
    assert _pinch_targets.out_of_reach(fingers, ends, np.array([0.0, 0.05, *angle])) == ""
    told = _pinch_targets.out_of_reach(fingers, ends, np.array([0.0, 0.12, *angle]))
    assert re.fullmatch(
        r"finger 0: a target is 0.11\d m from its base, and it reaches 0.0[78]\d+ m at most", told
    )


def test_what_cannot_be_held_is_said():
    body = jxr.FreeObject.uniform(jxr.Circle(0.015), density=20.0)
    short = [jxr.Finger([0.01, 0.01], [0.03, 0.02], jxr.Circle(0.002), base=(x, 0.0)) for x in (-1.0, 1.0)]
    with pytest.raises(ValueError, match="argument fingers must reach the object, but did not"):
        jxr.scenes.pinch_object(body, fingers=short)
    with pytest.raises(ValueError, match="argument fingers must be two fingers or more"):
        jxr.scenes.pinch_object(body, fingers=short[:1])
    with pytest.raises(ValueError, match="argument object must be a FreeObject or a FreeObject3"):
        jxr.scenes.pinch_object(jxr.Circle(0.01))


@pytest.mark.parametrize(
    ("unit", "told"),
    [
        ("mm", None),
        ("m", "beware      no hand holds what is of this size: is --unit m right? (--unit mm: 70 mm long)"),
        ("um", "beware      no hand holds what is of this size: is --unit um right? (--unit mm: 70 mm long)"),
    ],
)
def test_a_file_read_in_another_unit_than_its_own_is_told_before_it_is_fitted(unit, told, tmp_path):
    np.savetxt(tmp_path / "egg.csv", EGG, delimiter=",")
    order = ShapeOrder(str(tmp_path / "egg.csv"), unit, None, None, None)
    size, *beware = size_told(order, read(order))
    assert re.fullmatch(r"  size        [0-9.e+-]+ x [0-9.e+-]+ mm", size)
    assert [line.strip() for line in beware] == ([] if told is None else [told])


def perimeter(points):
    """Of a closed polygon."""
    return np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum()


def test_outlines_of_files_of_every_kind(tmp_path):
    """A table, a drawing, a photograph and a section of a mesh give one contour.

    What is read of drawing and mesh are points, close to each other, that are smoothed as those of the table.
    """
    np.savetxt(tmp_path / "egg.csv", EGG, delimiter=",")
    first = smooth_shape(ShapeOrder(str(tmp_path / "egg.csv"), "mm", 5e-3, None, None))
    assert first.report.radius >= 5e-3
    length = first.report.length
    jxr.io.write_outline(first.contour, tmp_path / "egg.svg", unit="mm")
    solid = jxr.io.write_stl(first.contour, tmp_path / "egg.stl", height=0.01)
    rows, columns = np.mgrid[0:260, 0:460]
    inside = ((columns - 230) / 175.0) ** 2 + ((rows - 130) / 100.0) ** 2 < 1.0
    from PIL import Image

    photograph = np.where(inside[..., None], (180, 60, 40), (230, 230, 225)).astype(np.uint8)
    Image.fromarray(photograph).save(tmp_path / "egg.png")
    drawn = read(ShapeOrder(str(tmp_path / "egg.svg"), "mm", 5e-3, None, None))
    assert perimeter(drawn.points) == pytest.approx(length, rel=2e-3)
    cut = read(ShapeOrder(str(solid), "mm", 5e-3, None, ("z", 5e-3)))
    assert perimeter(cut.points) == pytest.approx(length, rel=2e-3)
    seen = smooth_shape(ShapeOrder(str(tmp_path / "egg.png"), "mm", 5e-3, 2e-4, None))
    # Ramanujan's perimeter of the ellipse with half axes 35 and 20 mm.
    a, b = 0.035, 0.020
    h = ((a - b) / (a + b)) ** 2
    round_ = np.pi * (a + b) * (1.0 + 3.0 * h / (10.0 + np.sqrt(4.0 - 3.0 * h)))
    assert seen.report.length == pytest.approx(round_, rel=5e-3)


def test_a_cloud_and_a_mesh_are_fitted_with_their_normals_and_faces(monkeypatch):
    monkeypatch.setattr(_cli._shape_file, "fit_surface", lambda *args, **options: (args, options))
    points, normals, faces = np.diag([1.0, 2.0, 3.0]), np.eye(3), np.array([[0, 1, 2]])
    order = ShapeOrder("body.stl", "m", 0.1, None, None)
    args, options = smooth_shape(order, _cli._shape_file.ShapePoints(points, normals, faces))
    assert args[0] is points and args[1] is normals
    assert options == {"faces": faces, "smallest_radius": 0.1}


def test_a_pinched_object_is_pushed_across_the_line_between_the_tips(pinched_disc):
    grasp, state = pinched_disc
    pushed, size = _pinch_command._pushed(grasp, state)
    first, second = _any_pinch.tip_origins(grasp, np.asarray(state.q))
    push = np.asarray(pushed.load[0].force)
    # A share of what the fingers press with, 2 N along the line between their frames.
    assert size == pytest.approx(2.0 * _pinch_command._SHARE)
    assert np.linalg.norm(push) == pytest.approx(size) and abs(push @ (second - first)) < 1e-15


def test_of_several_outlines_the_report_says_which(tmp_path):
    big, small = "M 0,0 H 60 V 40 H 0 Z", "M 100,0 H 120 V 10 H 100 Z"
    file = tmp_path / "two.svg"
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="200mm" height="50mm" viewBox="0 0 200 50">'
    file.write_text(f'{head}<path d="{small}"/><path d="{big}"/></svg>')
    for which, size in ((None, "60 x 40 mm"), (1, "20 x 10 mm")):
        order = ShapeOrder(str(file), "mm", None, None, None, which)
        lines = size_told(order, read(order))
        assert lines[0].endswith(size)
        words = f"number {which or 0} of 2 was taken, from 0, the largest, to 1; --which N takes another"
        assert lines[1:] == [f"  outline     {words}"]
    with pytest.raises(
        ValueError, match="which must be below the number of outlines in two.svg, 2, but was 2"
    ):
        read(ShapeOrder(str(file), "mm", None, None, None, 2))


TABLES = {
    "planar": (
        np.pad(EGG, ((0, 0), (0, 1))),
        "lie in one plane: for an outline leave out column 3, which is con",
    ),
    "index": (
        np.insert(EGG, 0, np.arange(200), axis=1),
        "column 1 of table.csv counts its lines: leave that co",
    ),
    "tilted": (
        EGG @ np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]),
        "lie in one plane: for an outline leave out the",
    ),
    "four": (
        np.pad(EGG, ((0, 0), (0, 2)), constant_values=0.5),
        "3 (x, y, z) or 6 (x, y, z and outward normals), b",
    ),
    "one": (EGG[:, :1], "but table.csv has 1"),
    "a line": (EGG[:, :1] * np.array([1.0, 2.0]), "those of table.csv lie on one line"),
    "five with commas": ("1,2,3,4,5\n2,3,4,5,6\n", "but table.csv has 5"),
    "semicolons too": ("1,4;2;3;4\n2,3;4;5;6\n", "but table.csv has 4"),
    "decimal commas": (
        "-1,44,-1,08\n2,30,1,50\n",
        "has 4; if its commas are decimal marks, part the columns by s",
    ),
}


def test_a_ply_of_points_alone_is_a_cloud(tmp_path):
    points = np.random.default_rng(9).normal(size=(20, 3)).round(3)
    head = "ply\nformat ascii 1.0\nelement vertex 20\n" + "".join(f"property float {x}\n" for x in "xyz")
    rows = "\n".join(" ".join(f"{x:.3f}" for x in row) for row in points)
    (tmp_path / "cloud.ply").write_text(f"{head}end_header\n{rows}\n")
    order = ShapeOrder(str(tmp_path / "cloud.ply"), "mm", None, None, None)
    seen = _cli._shape_file._of_mesh(tmp_path / "cloud.ply", order)
    np.testing.assert_allclose(seen.points, 1e-3 * points, atol=1e-9)
    assert seen.normals is None and seen.faces is None
    for count, row in ((20, "nan 0.0 0.0"), (20, "0.0 inf 0.0"), (0, "")):
        text = head.replace("20", str(count)) + "end_header\n" + f"{row}\n" * count
        (tmp_path / "odd.ply").write_text(text)
        with pytest.raises(ValueError, match="argument path must name a file of finite vertices"):
            jxr.io.read_cloud(tmp_path / "odd.ply", unit="mm")
    # Points have no section, and what is no file of triangles is no cloud either.
    cut = ShapeOrder(str(tmp_path / "cloud.ply"), "mm", None, None, ("z", 0.0))
    (tmp_path / "cloud.off").write_text("OFF\n0 0 0\n")
    for name, which in (("cloud.ply", cut), ("cloud.off", order)):
        with pytest.raises(ValueError, match="argument path must name a file with triangles, but cloud"):
            _cli._shape_file._of_mesh(tmp_path / name, which)


def test_what_to_beware_of_is_said_before_the_work(monkeypatch):
    said = []
    monkeypatch.setattr(_cli._shape_file, "say", said.append)
    _cli._shape_file.warn(["  size        3 x 4 mm", "  outline     number 0", "  beware      of this"])
    assert said == ["outline     number 0", "beware      of this"]


@pytest.mark.parametrize("case", TABLES)
def test_a_table_of_no_shape_is_told_which_column_must_go(case, tmp_path):
    table, words = TABLES[case]
    file = tmp_path / "table.csv"
    if isinstance(table, str):
        file.write_text(table)
    else:
        np.savetxt(file, table, delimiter=",")
    with pytest.raises(ValueError, match=re.escape(words)) as refused:
        read(ShapeOrder(str(file), "mm", None, None, None))
    assert str(refused.value).startswith("argument FILE must ")
    assert ("decimal marks" in str(refused.value)) == (case == "decimal commas")


BAD = {
    "no file": (["fit", "none.csv"], "none.csv"),
    "another kind": (["fit", "text.doc"], "argument FILE must end in one of"),
    "photograph without a scale": (["fit", "flat.png"], "argument --pixel must be"),
    "section without a place": (["fit", "egg.stl", "--section", "w=3"], "must be an axis and a place"),
    "section of a table": (
        ["fit", "egg.csv", "--section", "z=3"],
        "argument --section must be left out for all",
    ),
    "pixel of a table": (
        ["fit", "egg.csv", "--pixel", "1"],
        "--pixel must be left out for all but a photograph or an SVG",
    ),
    "outline of a table": (
        ["pinch", "egg.csv", "--which", "1"],
        "--which must be left out for all but a draw",
    ),
    "radius of words": (["pinch", "egg.csv", "--smallest-radius", "big"], "but was big"),
    "a hand in the plane": (["pinch", "egg.csv", "--hand", "hand.urdf"], "argument --hand must be left out"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_does_not_fit_is_one_line(case, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    np.savetxt(tmp_path / "egg.csv", EGG, delimiter=",")
    (tmp_path / "flat.png").write_bytes(b"")
    (tmp_path / "text.doc").write_text("words")
    (tmp_path / "hand.urdf").write_text("<robot name='none'/>")
    arguments, words = BAD[case]
    assert main(arguments) == 2
    out, complaint = capfd.readouterr()
    assert out == ""
    assert words in complaint.splitlines()[-1]
    assert not list(tmp_path.glob("jaxroll-*"))


@pytest.mark.parametrize("written", [True, False])
@pytest.mark.parametrize("command", ["fit", "pinch"])
def test_each_file_has_a_folder_of_its_name_unless_nothing_is_written(
    command, written, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    np.savetxt(tmp_path / "egg.csv", EGG, delimiter=",")
    seen = []

    def ordered(asked, folder, timed):
        seen.append(folder)
        assert folder.is_dir()
        (folder / "fit.png").touch()
        return ["the report"] if command == "fit" else (["the report"], True)

    def refused(asked, folder, timed):
        seen.append(folder)
        raise ValueError("argument points must fit")

    monkeypatch.setattr(_cli, {"fit": "fitted", "pinch": "pinched"}[command], ordered if written else refused)
    assert main([command, "egg.csv"]) == (0 if written else 2)
    assert main([command, "egg.csv", "--out", "deep/out"]) == (0 if written else 2)
    assert [str(folder) for folder in seen] == [f"jaxroll-{command}-egg", "deep/out"]
    assert all(folder.exists() == written for folder in (*seen, tmp_path / "deep"))


@pytest.mark.slow
def test_jaxroll_pinch_writes_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    np.savetxt(tmp_path / "egg.csv", EGG, delimiter=",")
    folder = tmp_path / "out"
    assert main(["pinch", str(tmp_path / "egg.csv"), "--out", str(folder), "--seconds", "0.4"]) == 0
    text = capsys.readouterr().out
    assert "outcome     held for 0.4 s, " in text and "no gravity acts" in text
    names = {"fit.png", "poses.png", "responses.png", "motion.gif", "pinch.npz"}
    assert {path.name for path in folder.iterdir()} == names
    kept = jxr.load(folder / "pinch.npz")
    assert off(kept["grasp"], kept["state"]) < 1e-12
    assert str(kept["run"]).splitlines()[0] in text


def hand_file(path, ball="<collision><geometry><sphere radius='0.01'/></geometry></collision>"):
    """A hand of two fingers in space as URDF, tips of 10 mm; the first joint of the second has no range."""
    link = "<link name='{0}'><inertial><origin xyz='0 {1} 0'/><mass value='{2}'/>{3}</inertial>{4}</link>"
    inertia = "<inertia ixx='2e-5' iyy='4e-6' izz='2e-5' ixy='0' ixz='0' iyz='0'/>"
    parts = ["<robot name='two'><link name='palm'/>"]
    for side, x in (("l", -0.0275), ("r", 0.0275)):
        parent, places = "palm", [(x, 0.0), (0.0, 0.010), (0.0, 0.065)]
        for k, (axis, place) in enumerate(zip(("1 0 0", "0 0 1", "0 0 1"), places, strict=True)):
            name = f"{side}{k}"
            parts.append(link.format(name, 0.03, (0.015, 0.045, 0.04)[k], inertia, ""))
            ends = "<limit lower='-2.5' upper='2.5' effort='1' velocity='1'/>"
            kind = "continuous" if name == "r0" else "revolute"
            parts.append(
                f"<joint name='j{name}' type='{kind}'><parent link='{parent}'/><child link='{name}'/>"
                f"<origin xyz='{place[0]} {place[1]} 0'/><axis xyz='{axis}'/>"
                f"{'' if kind == 'continuous' else ends}</joint>"
            )
            parent = name
        parts.append(link.format(f"{side}tip", 0.0, 0.001, inertia.replace("e-", "e-1"), ball))
        parts.append(
            f"<joint name='e{side}' type='fixed'><parent link='{parent}'/><child link='{side}tip'/>"
            "<origin xyz='0 0.065 0'/></joint>"
        )
    path.write_text("\n".join([*parts, "</robot>"]))


def test_a_hand_without_tips_has_balls_of_10_mm(tmp_path):
    hand_file(tmp_path / "hand.urdf", ball="")
    hand, own = _pinch_command._hand(str(tmp_path / "hand.urdf"), flat=False)
    tips = [finger.tip for finger in _pinch_command._fingers(hand)]
    assert [(type(tip), float(tip.radius)) for tip in tips] == [(jxr.Sphere, 0.01)] * 2 and not own
    (line,) = _pinch_command._hand_told(hand, own)
    assert "its tips are balls of 10 mm" in line
    nothing = dataclasses.replace(hand, torques=(np.full((1, 2), np.inf),), damping=(), left_out=())
    assert _pinch_command._hand_told(nothing, True) == []
    more = dataclasses.replace(nothing, stiffness=(np.array([0.0, 0.1]),), left_out=("range of tendon 't'",))
    assert _pinch_command._hand_told(more, True) == [
        "  hand        its file's springs, range of tendon 't' not counted"
    ]


@pytest.mark.slow
@pytest.mark.optimised
def test_jaxroll_pinch_takes_a_hand_from_a_file(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("JAXROLL_CACHE", "off")
    rng = np.random.default_rng(0)
    u = rng.normal(size=(3000, 3))
    np.save(tmp_path / "egg.npy", [15.0, 25.0, 20.0] * u / np.linalg.norm(u, axis=1)[:, None])
    hand_file(tmp_path / "hand.urdf")
    folder = tmp_path / "out"
    words = [
        "pinch",
        str(tmp_path / "egg.npy"),
        "--hand",
        str(tmp_path / "hand.urdf"),
        "--smallest-radius",
        "5",
    ]
    assert main([*words, "--out", str(folder), "--seconds", "0.4", "--no-animation"]) == 0
    assert "outcome     held for 0.4 s, " in capsys.readouterr().out
    kept = jxr.load(folder / "pinch.npz")
    grasp, run = kept["grasp"], kept["run"]
    assert off(grasp, kept["state"]) < 1e-12
    # The hand's own tips and ranges; the push is across the line on which both tips press.
    assert [float(f.tip.surface.radius) for f in grasp.fingers] == [0.01, 0.01]
    np.testing.assert_allclose(grasp.fingers[0].limits, [[-2.5, 2.5]] * 3)
    assert float(grasp.fingers[1].limits[0, 1]) > 6.0
    axes = np.asarray(run.states.q)[0, :3]
    pushed = np.asarray(run.states.q)[:, :3] - axes
    assert np.abs(pushed).max() > 1e-5


OUTCOMES = {
    "at rest": (
        (0.0, 0.0, 0.0),
        "asymptotically_stable",
        r"held for 1 s, at rest at the end \(0 mm/s, 0 rad/s\)",
    ),
    "unstable": (
        (0.0, 0.0, 0.0),
        "unstable",
        r"at rest .*, but some small disturbance grows; a larger --seconds",
    ),
    "undamped": (
        (0.0, 0.0, 0.0),
        "undamped",
        ", but some small disturbance never dies out; a larger --seconds",
    ),
    "nowhere": (
        (0.0, 0.0, 0.0),
        "not_found",
        ", but no equilibrium was found near the start; a larger --sec",
    ),
    "moving": (
        (0.003, 0.004, 0.2),
        "neutral",
        r"still moving at the end \(5 mm/s, 0.2 rad/s\); a larger --sec",
    ),
    "in space": (
        (0.0, 0.0, 0.005, 0.0, 0.3, 0.4),
        None,
        r"still moving at the end \(5 mm/s, 0.5 rad/s\); a l",
    ),
}


@pytest.mark.parametrize("case", OUTCOMES)
def test_the_outcome_says_how_long_and_whether_at_rest(case):
    v, verdict, words = OUTCOMES[case]
    states = SimpleNamespace(q=np.zeros((3, len(v) + (len(v) == 6) + 5)), v=np.zeros((3, len(v) + 5)))
    states.v[-1, : len(v)] = v
    run = SimpleNamespace(result=jxr.RESULTS.successful, states=states, stats=SimpleNamespace(t_end=1.0))
    told = _pinch_command.outcome(run, None if verdict is None else getattr(stability.VERDICTS, verdict))
    assert re.search(words, told) and told.startswith("held for 1 s, ")


def test_a_column_that_counts_is_looked_for_in_longer_tables_of_space_alone():
    rng = np.random.default_rng(0)
    cloud = np.column_stack([np.arange(9.0), rng.normal(size=(9, 2))])
    with pytest.raises(ValueError, match="column 1 of egg counts its lines"):
        _check_spread(cloud, "egg", table=True)
    _check_spread(cloud, "egg", table=False)  # a cloud of a mesh's format has no other columns
    _check_spread(cloud[:, :2], "egg", table=True)  # points of a graph
    with pytest.raises(ValueError, match="counts its lines"):
        _check_spread(cloud[:4], "egg", table=True)
    with pytest.raises(ValueError) as error:  # three points are in one plane, whatever they count
        _check_spread(cloud[:3], "egg", table=True)
    assert "counts" not in str(error.value)


def cuboid(*sizes):
    """Points all over a box of these sizes, with all their mirror images; the corners are among them."""
    corners = np.stack(np.meshgrid(*[[-1.0, 1.0]] * len(sizes)), axis=-1).reshape(-1, len(sizes))
    inside = np.random.default_rng(0).uniform(size=(40, 1, len(sizes))) * corners
    return 0.5 * np.concatenate([corners, inside.reshape(-1, len(sizes))]) * np.array(sizes)


@pytest.mark.parametrize("extent", [(2.1e-3, True), (1.9e-3, False), (1.9, True), (2.1, False)])
def test_what_a_hand_may_hold_is_between_two_millimetres_and_two_metres(extent):
    size, fine = extent
    points = _cli._shape_file.ShapePoints(np.array([[0.0, 0.0], [0.3 * size, size]]))
    lines = size_told(ShapeOrder("body.csv", "mm", None, None, None), points)
    assert lines[0] == f"  size        {300 * size:.4g} x {1e3 * size:.4g} mm" and (len(lines) == 1) == fine


def test_an_svg_in_a_unit_of_its_own_is_read_by_its_pixel(tmp_path):
    """An icon of 24 units that is to be 60 mm wide: no unit is 2.5 mm."""
    file = tmp_path / "icon.svg"
    size = 'width="60mm" height="60mm" viewBox="0 0 24 24"'
    file.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {size}><rect width="8" height="6"/></svg>')
    with pytest.raises(ValueError, match="one unit is 2.5 mm, but was 1 mm; say that a pixel is 2.5 mm$"):
        read(ShapeOrder(str(file), "mm", None, None, None))
    order = ShapeOrder(str(file), "mm", None, 2.5e-3, None)
    assert read(order).extent == pytest.approx([20e-3, 15e-3])
    huge = _cli._shape_file.ShapePoints(np.array([[0.0, 0.0], [9.0, 9.0]]))
    assert size_told(order, huge)[-1].endswith("is --pixel right?")


@pytest.mark.parametrize(
    ("file", "unit", "size", "told"),
    [
        ("a.csv", "m", 15.0, "is --unit m right? (--unit mm: 15 mm long)"),
        ("a.csv", "mm", 0.5e-3, "is --unit mm right? (--unit m: 500 mm long)"),
        ("a.csv", "mm", 3.0, "is --unit mm right?"),
        ("a.csv", "um", 9e-6, "is --unit um right? (--unit mm: 9 mm long)"),
        ("a.csv", "um", 7e-6, "is --unit um right? (--unit in: 177.8 mm long)"),
        ("a.csv", "um", 0.9e-6, "is --unit um right? (--unit m: 900 mm long)"),
        ("a.csv", "um", 1.1e-6, "is --unit um right? (--unit in: 27.94 mm long)"),
        ("a.PNG", "mm", 3.0, "is --pixel right?"),
    ],
)
def test_another_unit_is_named_in_which_a_hand_is_likely_to_hold_it(file, unit, size, told):
    points = _cli._shape_file.ShapePoints(np.array([[0.0, 0.0], [0.3 * size, size]]))
    *_, last = size_told(ShapeOrder(file, unit, None, None, None), points)
    assert last == f"  beware      no hand holds what is of this size: {told}"


def test_the_smallest_radius_is_a_tenth_of_the_least_extent_along_the_points_own_axes():
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    points = cuboid(0.06, 0.03, 0.02) @ turn.T + 5.0
    assert _cli._shape_file._radius(points) == pytest.approx(2e-3, rel=1e-9)
    flat = cuboid(0.06, 0.03) @ np.array([[0.8, -0.6], [0.6, 0.8]]) - 2.0
    assert _cli._shape_file._radius(flat) == pytest.approx(3e-3, rel=1e-9)


@pytest.mark.parametrize(("thin", "fine"), [(0.7e-6, False), (1.5e-6, True)])
def test_points_enclose_something_if_they_are_a_millionth_as_thick_as_long(thin, fine):
    for sizes in ((1.0, thin), (1.0, 0.8, thin)):
        points = cuboid(*sizes)
        if fine:
            _check_spread(points, "egg", table=False)
            continue
        with pytest.raises(ValueError, match="lie on one line|lie in one plane$"):
            _check_spread(points, "egg", table=False)


@pytest.mark.parametrize(("uneven", "counts"), [(0.7e-6, True), (1.5e-6, False)])
def test_steps_that_count_are_alike_to_a_millionth(uneven, counts):
    points = np.random.default_rng(0).normal(size=(9, 3))
    points[:, 1] = 3.0 * np.arange(9) + 2.0
    points[5, 1] += 3.0 * uneven
    if not counts:
        return _check_spread(points, "egg", table=True)
    with pytest.raises(ValueError, match="column 2 of egg counts its lines"):
        _check_spread(points, "egg", table=True)


@pytest.mark.parametrize(
    ("length", "taken"), [(1.0009, True), (1.0011, False), (0.9991, True), (0.9989, False)]
)
def test_columns_of_unit_vectors_are_normals(length, taken, tmp_path):
    table = np.random.default_rng(0).normal(size=(6, 6))
    table[:, 3:] /= np.linalg.norm(table[:, 3:], axis=1)[:, None]
    table[2, 3:] *= length
    np.savetxt(tmp_path / "cloud.csv", table, delimiter=",", fmt="%.17g")
    points, normals = _cli._shape_file._cloud(tmp_path / "cloud.csv", "mm")
    np.testing.assert_allclose(points, 1e-3 * table[:, :3])
    assert (normals is not None) == taken


@pytest.mark.parametrize(
    ("option", "file"),
    [
        ({"pixel": 0.1}, "a.dxf"),
        ({"pixel": 0.1}, "a.stl"),
        ({"section": ("z", 0.0)}, "a.csv"),
        ({"section": ("z", 0.0)}, "a.png"),
        ({"which": 0}, "a.csv"),
        ({"which": 1}, "a.ply"),
    ],
)
def test_options_are_for_files_of_some_kinds(option, file):
    kept = {"pixel": None, "section": None, "which": None}
    name = next(iter(option))
    with pytest.raises(
        ValueError, match=f"argument --{name} must be left out for all but a .*, but FILE was"
    ):
        _cli._shape_file._check_options(ShapeOrder(file, "mm", None, **kept | option))
    fits = {"pixel": ("a.PNG", "a.tiff", "a.svg"), "section": ("a.obj",), "which": ("a.dxf", "a.jpg")}[name]
    for other in (*fits, "a.unknown"):
        _cli._shape_file._check_options(ShapeOrder(other, "mm", None, **kept | option))
    cut = kept | {"section": ("z", 0.0), "which": 1}
    _cli._shape_file._check_options(ShapeOrder("a.stl", "mm", None, **cut))


def test_a_section_across_an_axis_of_a_mesh(tmp_path):
    """At a height along it, in the plane of the two others; the outline that is asked for."""
    trimesh = pytest.importorskip("trimesh")
    boxes = [trimesh.creation.box((20, 30, 40)).apply_translation((x, 7, 9)) for x in (0, 50)]
    boxes[1].apply_scale(0.5)
    trimesh.util.concatenate(boxes).export(tmp_path / "two.stl")
    read_ = lambda cut, which: _cli._shape_file._of_mesh(  # noqa: E731
        tmp_path / "two.stl", ShapeOrder("two.stl", "mm", None, None, cut, which)
    )
    for which, size in ((None, (0.02, 0.03)), (1, (0.01, 0.015))):
        found = read_(("z", 0.008), which)
        np.testing.assert_allclose(sorted(found.extent), size, rtol=1e-6)
        assert found.outlines == 2
    np.testing.assert_allclose(sorted(read_(("x", 0.025), None).extent), (0.015, 0.02), rtol=1e-6)
    assert len(read_(None, None).faces) == 24
    with pytest.raises(
        ValueError, match="argument --which must be below the number of outlines .*, 2, but was 2"
    ):
        read_(("z", 0.008), 2)


@pytest.mark.parametrize(
    ("v", "still"),
    [
        ((0.9e-4, 0.0, 0.9e-2), True),
        ((0.0, -1.1e-4, 0.0), False),
        ((0.0, 0.0, 1.1e-2), False),
        ((0.8e-4, 0.8e-4, 0.0), False),
        ((0.0, 0.0, 0.9e-4, 0.0, 0.0, 0.9e-2), True),
        ((0.0, 0.0, 1.1e-4, 0.0, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0, 0.0, 0.0, 1.1e-2), False),
    ],
)
def test_an_object_is_at_rest_below_a_tenth_of_a_millimetre_a_second(v, still):
    """And below a hundredth of a radian a second; what its fingers do does not count."""
    in_space = len(v) == 6
    states = SimpleNamespace(q=np.zeros((3, len(v) + in_space + 2)), v=np.ones((3, len(v) + 2)))
    states.v[-1, : len(v)] = v
    run = SimpleNamespace(result=jxr.RESULTS.successful, states=states, stats=SimpleNamespace(t_end=0.25))
    told = _pinch_command.outcome(run, None)
    assert told.startswith("held for 0.25 s, ") and ("at rest at the end" in told) == still
    assert ("a larger --seconds" in told) == (not still)


@pytest.mark.parametrize(
    "line", [(3.0, 4.0), (-4.0, 3.0), (0.0, 0.0, 2.0), (1.0, 2.0, 3.0), (5.0, -1.0, 2.0)]
)
def test_a_push_is_across_the_line_between_the_tips(line):
    """In the plane across it; in space along the two axes most across it, of which neither is preferred."""
    line = np.array(line)
    found = _pinch_command._aside(line)
    assert np.linalg.norm(found) == pytest.approx(1.0) and abs(found @ line) < 1e-12
    n = line / np.linalg.norm(line)
    most = np.argsort(np.abs(n))[:-1]
    wanted = sum(np.eye(len(line))[i] - n[i] * n for i in most)
    np.testing.assert_allclose(found, wanted / np.linalg.norm(wanted), atol=1e-12)


def test_joints_without_a_range_turn_twice_either_way():
    finger = jxr.Finger3([(1, 0, 0), (0, 0, 1)], [(0, 0.06, 0)] * 2, [0.03, 0.01], jxr.Sphere(0.01))
    limits = jnp.array([[-jnp.inf, 0.3], [-0.2, jnp.inf]])
    found = _pinch_command._limited(finger, limits)
    np.testing.assert_allclose(found.limits, [[-4.0 * np.pi, 0.3], [-0.2, 4.0 * np.pi]])
