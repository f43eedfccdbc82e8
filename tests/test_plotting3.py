"""Pictures of grasps in space: meshes lie on their surfaces, and what is drawn is what moved."""

import dataclasses
import itertools
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from mpl_toolkits.mplot3d import proj3d
from PIL import Image
from scipy.spatial.transform import Rotation

from jaxroll import geometry, plotting
from jaxroll.plotting._animate3 import _paced, animate3
from jaxroll.plotting._artists3 import Triangles
from jaxroll.plotting._drawing3 import Drawing3
from jaxroll.plotting._forces3 import Pushes
from jaxroll.plotting._meshes import box_mesh, mesh
from jaxroll.plotting._motion3 import matrices, rotation_vectors
from jaxroll.plotting._poses3 import snapshots3, stage
from jaxroll.plotting._scene3 import looking, scene3
from jaxroll.plotting._style import LOCUS_OBJECT, LOCUS_TIP, Picture
from jaxroll.plotting._tubes import ball, camera, lit, tube_mesh
from tests.helpers import slow_among
from tests.subjects import stand_in_grasp

TURN = np.array([0.8, 0.2, -0.4, 0.4])


def bean(x, y, z):
    """A bent body that does not hold the origin; no ray from its middle meets it twice."""
    u, v, w = x - 0.05, y + 0.02 - 8.0 * (x - 0.05) ** 2, z
    return (u / 0.03) ** 2 + (v / 0.02) ** 2 + (w / 0.015) ** 2 - 1.0


def ring(u, v):
    """A torus as a chart."""
    radial = 0.03 + 0.01 * jnp.cos(v)
    return radial * jnp.cos(u), radial * jnp.sin(u), 0.01 * jnp.sin(v)


def tube():
    u, v = np.meshgrid(2 * np.pi * np.arange(32) / 32, np.linspace(0, 0.03, 8), indexing="ij")
    return geometry.Patch(np.stack([0.01 * np.cos(u), 0.01 * np.sin(u), v], -1), periodic=(True, False))


def splines(radius, step):
    """A ball far from the origin: the splines of a quadratic's samples are off by their own variance."""
    x = step * (np.arange(16) - 2.0 - 5.5)
    squares = sum(np.meshgrid(x**2, x**2, x**2, indexing="ij"))
    corner = np.array([0.1, 0.0, 0.0]) - 5.5 * step
    return geometry.SplineSurface(squares - radius**2 - 1.5 * step**2, corner, step)


WHOLE = ((0.0, 2 * np.pi), (0.0, 2 * np.pi))
BALL = 4.0 / 3.0 * np.pi
# Surface, and the volume within if it is known; it is None where the surface has an edge.
SURFACES = {
    "sphere": (geometry.Sphere(0.02), BALL * 0.02**3),
    "ellipsoid": (geometry.Ellipsoid(0.03, 0.02, 0.01), BALL * 6e-6),
    "superellipsoid": (geometry.Superellipsoid(0.03, 0.02, 0.01, exponent=4), 8 * 6e-6 * 0.8103),
    "torus": (geometry.Torus(0.03, 0.01), 2 * np.pi**2 * 0.03 * 0.01**2),
    "moved": (geometry.Ellipsoid(0.03, 0.02, 0.01).moved((0.1, 0.2, -0.3), 3.0 * TURN), BALL * 6e-6),
    "twice moved": (
        geometry.Torus(0.03, 0.01).moved((0.1, 0.0, 0.0), TURN).moved((0.0, 0.1, 0.0), TURN),
        2 * np.pi**2 * 0.03 * 0.01**2,
    ),
    "bean": (geometry.Implicit(bean), BALL * 9e-6),
    "splines": (splines(0.02, 0.005), BALL * 0.02**3),
    "chart": (geometry.Chart(ring, domain=WHOLE), 2 * np.pi**2 * 0.03 * 0.01**2),
    "patch": (tube(), None),
    "cylinder": (geometry.Cylinder(0.01), None),
    "hollow": (geometry.Hollow(geometry.Sphere(0.02)), -BALL * 0.02**3),
    "plane": (geometry.Plane().moved((0.0, 0.0, 0.1), TURN), None),
}


@pytest.mark.parametrize("name", slow_among(SURFACES, "splines", "patch", "bean"))
def test_a_mesh_lies_on_its_surface_and_faces_outwards(name):
    surface, volume = SURFACES[name]
    about = np.array([0.02, 0.01, 0.03])
    rows = 16 if name == "splines" else 48  # the nearest point of one takes a millisecond
    found = mesh(surface, rows=rows, columns=2 * rows, extent=0.02, about=about)
    middles = found.vertices[found.faces].mean(axis=1)
    # Both in one program.
    places = surface.near(np.concatenate([found.vertices, middles]))
    count = len(found.vertices)
    nearest, normals = np.asarray(surface.point(places))[:count], np.asarray(surface.normal(places))[count:]
    assert np.abs(nearest - found.vertices).max() < 1e-9
    outward = np.sum(normals * found.areas, axis=1) / np.linalg.norm(found.areas, axis=1)
    assert outward.min() > 0.9
    assert found.closed == (volume is not None) and len(found.checks) == len(found.faces)
    if volume is not None:
        within = np.sum(found.vertices[found.faces[:, 0]] * found.areas) / 6.0
        assert within == pytest.approx(volume, rel=0.01)


def test_endless_surfaces_are_drawn_about_a_point():
    plane = geometry.Plane().moved((0.0, 0.0, 0.1), TURN)
    about = np.asarray(plane.point(plane.near((0.3, 0.2, 0.0))))
    found = mesh(plane, extent=0.02, about=about)
    np.testing.assert_allclose(found.vertices.mean(axis=0), about, atol=1e-12)
    assert np.linalg.norm(found.areas, axis=1).sum() / 2 == pytest.approx(0.04**2)
    for word, extents in (("positive", (None, 0.0, -0.01)), ("finite", (np.inf, np.nan))):
        for extent in extents:
            with pytest.raises(ValueError, match=f"argument extent must be {word}"):
                mesh(plane, extent=extent)


def test_a_mesh_with_a_hole_or_a_turned_triangle_is_not_closed():
    found = mesh(geometry.Sphere(0.02), rows=6, columns=8)
    turned = found.faces.copy()
    turned[5] = turned[5, ::-1]
    assert found.closed
    assert not dataclasses.replace(found, faces=found.faces[1:]).closed
    assert not dataclasses.replace(found, faces=turned).closed


def test_a_box_is_closed_and_has_its_volume():
    box = box_mesh(np.array([0.06, 0.04, 0.02]))
    assert box.closed
    np.testing.assert_allclose(np.ptp(box.vertices, axis=0), [0.06, 0.04, 0.02])
    assert np.sum(box.vertices[box.faces[:, 0]] * box.areas) / 6 == pytest.approx(0.06 * 0.04 * 0.02)


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda x, y, z: x**2 + y**2 + z**2 + 1.0, "inside"),
        (lambda x, y, z: x**2 + y**2 - 0.01**2, "closed"),
    ],
)
def test_implicit_surfaces_that_cannot_be_drawn_say_so(function, words):
    with pytest.raises(ValueError, match=f"argument surface must .*{words}"):
        mesh(geometry.Implicit(function))


def test_rotations_agree_with_scipy():
    rng = np.random.default_rng(3)
    quaternions = rng.normal(size=(20, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    theirs = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]])
    np.testing.assert_allclose(matrices(quaternions), theirs.as_matrix(), atol=1e-14)
    angles = np.linspace(0.0, 3.0, 30)
    path = Rotation.from_rotvec(angles[:, None] * np.array([0.6, 0.0, 0.8])) * theirs[0]
    signs = np.where(np.arange(30) % 3, 1.0, -1.0)[:, None]
    found = rotation_vectors(signs * path.as_quat()[:, [3, 0, 1, 2]])
    np.testing.assert_allclose(found, angles[:, None] * np.array([0.6, 0.0, 0.8]), atol=1e-12)


def test_rotation_vectors_go_on_beyond_half_a_turn():
    angles = np.linspace(0.0, 6.0, 60)
    path = stand_in_grasp.quaternion_about((0.0, 0.6, 0.8), angles)
    path[40:] *= -1.0
    np.testing.assert_allclose(
        rotation_vectors(path), angles[:, None] * np.array([0.0, 0.6, 0.8]), atol=1e-12
    )


@pytest.fixture(scope="module")
def scene():
    """The stand-in: grasp, motion, times."""
    return stand_in_grasp.stand_in()


def world(pose, points):
    """Body-frame points in the world [mm], by scipy."""
    return 1e3 * (Rotation.from_quat(pose[[4, 5, 6, 3]]).apply(points) + pose[:3])


def drawn(figure, colour):
    """Positions of the lines of one colour that are drawn in full."""
    lines = [line for line in figure.axes[0].lines if line.get_color() == colour]
    return [np.array(line.get_data_3d()).T for line in lines[::2]]


@pytest.mark.parametrize("at", [-1, 30])
def test_both_loci_are_drawn_on_their_bodies_and_meet(scene, at):
    grasp, motion, _ = scene
    figure = snapshots3(grasp, motion, [at])
    row = at % motion.times
    on_tips, on_object = drawn(figure, LOCUS_TIP), drawn(figure, LOCUS_OBJECT)
    assert len(on_tips) == len(on_object) == 2
    for k, (on_tip, on_body) in enumerate(zip(on_tips, on_object, strict=True)):
        np.testing.assert_allclose(on_tip, world(motion.tips[k, row], motion.on_tip[k, : row + 1]), atol=1e-9)
        np.testing.assert_allclose(
            on_body, world(motion.body[row], motion.on_object[k, : row + 1]), atol=1e-9
        )
        np.testing.assert_allclose(on_tip[-1], on_body[-1], atol=1e-9)
        steps = [path[-1] - path[-2] for path in (on_tip, on_body)]
        assert np.linalg.norm(steps[0] - steps[1]) < 0.05 * np.linalg.norm(steps[0])


def test_a_picture_has_equal_scales_and_room_for_its_labels(scene, tmp_path):
    grasp, motion, _ = scene
    for k, (links, view) in enumerate(itertools.product((True, False), ((), (5.0, 10.0), (70.0, 120.0)))):
        figure = snapshots3(grasp, motion, titles=["at rest"], view=plotting.View(*view, links=links))
        ax = figure.axes[0]
        spans = np.ptp([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()], axis=1)
        shares = np.asarray(ax._box_aspect) / spans
        np.testing.assert_allclose(shares, shares[0], rtol=1e-12)
        figure.savefig(tmp_path / f"{k}.png")
        texts = [axis.label for axis in (ax.xaxis, ax.yaxis, ax.zaxis)] + figure.texts
        boxes = [text.get_window_extent() for text in texts] + [figure.legends[0].get_window_extent()]
        for box in boxes:
            assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
        with Image.open(tmp_path / f"{k}.png") as image:
            assert len(image.convert("RGB").getcolors(10**6)) > 500


def test_what_is_nearer_to_the_camera_is_drawn_last(scene):
    """Tips by their side of the tangent plane; a link by its depth, on whichever side its tip is."""
    grasp, motion, _ = scene
    skeletons = [motion.skeletons[0].copy(), motion.skeletons[1]]
    skeletons[0][:, :2, 1] *= -1.0  # the finger whose tip is at +y stands at -y
    drawn = scene3(grasp, dataclasses.replace(motion, skeletons=skeletons))
    _, (ax,) = stage(drawn, (10.0, 90.0), 5.0)
    tip, base = drawn.solids[1].frames[0, :3], drawn.skeletons[0][0, 0]
    for azimuth, (tip_in, base_in) in ((90.0, (2, 0)), (-90.0, (0, 2))):
        layers = [corners.mean(axis=1) for corners, _ in Drawing3(ax, drawn).parts(0, *camera(10.0, azimuth))]
        for point, layer in ((tip, tip_in), (base, base_in)):
            apart = [np.linalg.norm(corners - point, axis=1).min() for corners in layers]
            assert np.argmin(apart) == layer and min(apart) < 13.0
        assert np.linalg.norm(layers[1] - drawn.solids[0].frames[0, :3], axis=1).max() < 30.0


def test_a_tip_that_touches_nothing_is_before_or_behind_by_its_own_place(scene):
    """Not by that of its knee, which here is on the other side of the object."""
    grasp, motion, _ = scene
    skeletons = [motion.skeletons[0].copy(), motion.skeletons[1]]
    skeletons[0][:, 1, 1] *= -1.0
    drawn = scene3(grasp, dataclasses.replace(motion, skeletons=skeletons))
    drawn = dataclasses.replace(drawn, on_tips=(), on_object=())
    _, (ax,) = stage(drawn, (10.0, 90.0), 5.0)
    for azimuth, tip_in in ((90.0, 2), (-90.0, 0)):
        layers = [corners.mean(axis=1) for corners, _ in Drawing3(ax, drawn).parts(0, *camera(10.0, azimuth))]
        tip = drawn.solids[1].frames[0, :3]
        apart = [np.linalg.norm(corners - tip, axis=1).min(initial=np.inf) for corners in layers]
        assert np.argmin(apart) == tip_in and min(apart) < 13.0


def on_page(ax, points):
    """Where points [mm] are on the page, in inches from its lower left corner."""
    ax.apply_aspect()
    x, y, _ = proj3d.proj_transform(*points.T, ax.get_proj())
    return ax.transData.transform(np.stack([x, y], axis=-1)) / ax.figure.dpi


def test_a_picture_is_as_high_as_what_is_seen(scene):
    """Round the box of the axes there is as much room, for labels, legend and title, from everywhere."""
    drawn = scene3(*scene[:2])
    box = np.array(list(itertools.product(*drawn.corners.T)))
    rooms = []
    for view in ((5.0, 10.0), (22.0, -58.0), (70.0, 120.0)):
        figure, (ax,) = stage(drawn, view, 6.0)
        seen = on_page(ax, box)
        rooms.append([seen[:, 1].min(), figure.get_figheight() - seen[:, 1].max()])
    np.testing.assert_allclose(rooms, rooms[:1] * 3, atol=0.02)
    assert np.min(rooms) > 0.3


def test_the_light_is_above_the_left_shoulder_of_whoever_looks(scene):
    """On the page: the upper left of a ball is the brightest, wherever the camera stands."""
    drawn = scene3(*scene[:2])
    for view in ((5.0, 10.0), (22.0, -58.0), (-30.0, 200.0)):
        _, (ax,) = stage(drawn, view, 5.0)
        towards, light = camera(*view)
        corners, normals = ball(np.zeros(3), 10.0)
        shown = normals @ towards > 0.0
        seen = on_page(ax, corners.mean(axis=1)[shown]) - on_page(ax, np.zeros((1, 3)))
        bright = lit("#808080", normals[shown], light, towards)[:, 0]
        left, up = -seen[bright > np.quantile(bright, 0.9)].mean(axis=0) * [1.0, -1.0]
        assert left > 0.0 and up > 0.0


def test_the_camera_sees_the_first_contact_from_the_side(scene):
    _, azimuth = looking(scene3(scene[0], scene[1]))
    normal = world(scene[1].body[30], scene[1].on_object[0, 30:31])[0] - 1e3 * scene[1].body[30, :3]
    towards = np.array([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))])
    assert abs(towards @ normal[:2] / np.linalg.norm(normal[:2])) < 0.75


def test_forces_are_drawn_to_one_scale_onto_the_contacts(scene):
    grasp, motion, _ = scene
    forces = np.zeros((2, motion.times, 3))
    forces[0, :, 1], forces[1, :, 1] = -2.0, 1.0
    figure = snapshots3(grasp, motion, forces=Pushes(forces))
    artists = [a for a in figure.axes[0].artists + figure.axes[0].patches if hasattr(a, "ends")]
    assert all(a.get_mutation_scale() > 0.0 for a in artists)  # heads point where the arrow does
    arrows = [a.ends for a in artists][2:]
    pushes = [ends[1] - ends[0] for ends in arrows]
    np.testing.assert_allclose(pushes[0], -2.0 * pushes[1])
    assert pushes[0][1] < 0.0
    for k, ends in enumerate(arrows):
        np.testing.assert_allclose(ends[1], world(motion.body[-1], motion.on_object[k, -1:])[0])
    with pytest.raises(ValueError, match="argument forces must have shape"):
        snapshots3(grasp, motion, forces=Pushes(forces[:, 1:]))


def test_a_box_stands_for_its_faces(scene):
    _, motion, _ = scene
    faces = tuple(geometry.Plane().moved((0.0, 0.0, z)) for z in (0.01, -0.01))
    box = SimpleNamespace(surfaces=faces, outline=np.array([0.06, 0.04, 0.02]))
    grasp = SimpleNamespace(object=box, fingers=scene[0].fingers, contacts=scene[0].contacts)
    solids = scene3(grasp, motion).solids
    assert [s.finger for s in solids] == [-1, 0, 1]
    np.testing.assert_allclose(np.ptp(solids[0].mesh.vertices, axis=0), [60.0, 40.0, 20.0])


def test_an_animation_has_its_frames(scene, tmp_path):
    seen = []
    path = animate3(
        *scene, tmp_path / "sub" / "roll.gif", fps=10, speed=3.0, view=plotting.View(20.0, -40.0, 30.0),
        progress=lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    with Image.open(path) as image:
        assert image.n_frames == 6 and image.info["duration"] == 100
        first = np.asarray(image.convert("RGB"), int)
        image.seek(5)
        last = np.asarray(image.convert("RGB"), int)
    assert seen == [(k, 6) for k in range(1, 7)]
    assert (np.abs(first - last).max(axis=-1) > 40).mean() > 0.01


def test_long_animations_have_few_frames():
    for seconds, times in ((1.5, 61), (10.0, 301), (1000.0, 61)):
        rows, delay = _paced(np.linspace(0.0, seconds, times), 50.0, 1.0)
        assert 45 < len(rows) <= 60 and rows[-1] == times - 1
        assert delay * (len(rows) - 1) == pytest.approx(1e3 * seconds, rel=0.05)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"path": "motion.avi"}, "end in .gif or .mp4"),
        ({"fps": 0.0}, "argument fps must be positive"),
        ({"fps": "20"}, "argument fps must be a real number"),
        ({"speed": None}, "argument speed must be a real number"),
        ({"size": [5.0]}, "argument size must have shape"),
        ({"ts": np.zeros(3)}, "argument ts must have shape"),
    ],
)
def test_bad_arguments_of_an_animation(scene, change, words):
    grasp, motion, ts = scene
    with pytest.raises(ValueError, match=words):
        animate3(grasp, motion, **({"ts": ts, "path": "roll.gif"} | change))


def test_grasp_and_motion_must_belong_together(scene):
    grasp, motion, _ = scene
    with pytest.raises(ValueError, match="argument at must be the number of one of 61 times, but was 61"):
        snapshots3(grasp, motion, [61])
    fewer = dataclasses.replace(motion, tips=motion.tips[:1], skeletons=motion.skeletons[:1])
    with pytest.raises(ValueError, match="argument motion must have 2 tips, but had 1"):
        snapshots3(grasp, fewer)
    with pytest.raises(ValueError, match="argument on_tip must have shape"):
        dataclasses.replace(motion, on_tip=motion.on_tip[:, 1:])


def test_a_run_that_ended_early_is_drawn_as_far_as_it_came(scene, tmp_path):
    grasp, motion, ts = scene
    broken = {name: getattr(motion, name).copy() for name in ("body", "tips", "on_tip", "on_object")}
    broken["tips"][1, 31:], broken["on_tip"][:, 41:] = np.nan, np.nan
    cut = dataclasses.replace(motion, **broken)
    for wanted, found in zip(
        drawn(snapshots3(grasp, motion, [30]), LOCUS_TIP),
        drawn(snapshots3(grasp, cut), LOCUS_TIP),
        strict=True,
    ):
        np.testing.assert_array_equal(wanted, found)
    with Image.open(animate3(grasp, cut, ts, tmp_path / "cut.gif", fps=4)) as image:
        assert image.n_frames == 4
    broken["body"][:] = np.nan
    with pytest.raises(ValueError, match="at least one time that was reached"):
        snapshots3(grasp, dataclasses.replace(motion, **broken))


def test_a_tube_is_cut_into_pieces_of_four_radii():
    """Short pieces sort well by their depth; more of them than that would be drawn for nothing."""
    corners, normals = tube_mesh(np.zeros(3), np.array([0.0, 0.0, 10.5]), 1.0)
    heights = np.unique(np.round(corners[..., 2], 9))
    np.testing.assert_allclose(heights, [0.0, 3.5, 7.0, 10.5])
    np.testing.assert_allclose(np.linalg.norm(corners[..., :2], axis=-1), 1.0, rtol=1e-12)
    assert np.all(np.sum(normals * corners.mean(axis=1), axis=1) > 0.9)


def test_triangles_hide_what_is_behind_them_and_have_no_seams(tmp_path):
    """A red square of two triangles behind a blue one, whatever comes first; the camera looks down."""
    square = np.array([[[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0]], [[-1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]])
    low, high = (
        np.concatenate([c * square, np.full((2, 3, 1), z)], axis=-1) for c, z in ((1.0, 0.0), (0.5, 0.3))
    )
    red, blue = np.array([[1.0, 0.0, 0.0]] * 2), np.array([[0.0, 0.0, 1.0]] * 2)
    for order in ((0, 1, 2, 3), (3, 1, 2, 0)):
        figure = Picture(2.0, 2.0)
        ax = figure.add_subplot(projection="3d", computed_zorder=False)
        ax.set_axis_off()
        ax.set(xlim=(-1.0, 1.0), ylim=(-1.0, 1.0), zlim=(-1.0, 1.0))
        ax.view_init(90.0, -90.0)
        drawn = Triangles()
        drawn.corners, drawn.colours = (
            np.concatenate(pair)[list(order)] for pair in ((low, high), (red, blue))
        )
        ax.add_artist(drawn)
        figure.savefig(tmp_path / "squares.png", dpi=100)
        pixels = np.asarray(Image.open(tmp_path / "squares.png").convert("RGB"), int).reshape(-1, 3)
        counts = [
            int(np.sum(np.abs(pixels - colour).max(axis=1) < 3))
            for colour in 255 * np.array([red[0], blue[0]])
        ]
        # The blue square has half the width of the red one, of which it hides a quarter. Nothing is between
        # them and the white background but the pixels along both outlines.
        assert counts[0] > 3000 and 2.7 < counts[0] / counts[1] < 3.1
        assert np.sum(np.abs(pixels - 255).max(axis=1) > 2) - sum(counts) < 0.1 * sum(counts)
    figure.savefig(tmp_path / "squares.svg")
    assert (tmp_path / "squares.svg").read_text().count("<path") < 10  # a picture, not triangles one by one
