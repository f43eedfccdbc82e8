"""`io.load_hand`: fingers of URDF and MJCF files against MuJoCo's own dynamics of the same files."""

import re
from functools import partial
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxroll as jxr
from jaxroll._linalg import Vec3
from jaxroll.io import _hand, _robot_file

GRAVITY = (1.0, -2.0, -9.0)
JOINTS = (3, 2, 4)  # of each finger
BALL = jxr.Sphere(0.01)
# Earlier ones leave a URDF's moments of inertia in the link's axes, whatever the turn of their own frame, and
# find principal axes to 1e-7. What `load_hand` takes from a file is the same with all of them.
of_exact_mujoco = pytest.mark.skipif(
    tuple(map(int, mujoco.__version__.split(".")[:2])) < (3, 14), reason="an earlier MuJoCo is no measure"
)


def numbers(values):
    return " ".join(f"{x:.17g}" for x in np.ravel(values))


def random_links(seed):
    """Place, axis, and of two links fixed to each other mass, centre, turn and moments; finger by finger."""
    rng = np.random.default_rng(seed)
    frame = lambda size: (size * rng.normal(size=3), rng.uniform(-1.5, 1.5, size=3))  # noqa: E731
    body = lambda: (*frame(0.02), rng.uniform(0.01, 0.1), rng.uniform(2e-5, 3e-5, size=3))  # noqa: E731
    return [
        [(frame(0.05), rng.normal(size=3), body(), frame(0.01), body()) for _ in range(k)] for k in JOINTS
    ]


def as_urdf(fingers):
    """Origins by roll, pitch and yaw; every link carries a second one, the last of them the tip."""
    parts = ['<robot name="odd"><link name="palm"/>']

    def origin(at, turn):
        return f'<origin xyz="{numbers(at)}" rpy="{numbers(turn)}"/>'

    def link(name, at, turn, mass, moments):
        xx, yy, zz = moments
        tensor = f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="1e-6" ixz="-2e-6" iyz="3e-6"/>'
        inertial = f'{origin(at, turn)}<mass value="{mass}"/>{tensor}'
        solid = '<collision><geometry><mesh filename="package://gone/away.stl"/></geometry></collision>'
        parts.append(f'<link name="{name}"><inertial>{inertial}</inertial>{solid}</link>')

    for i, finger in enumerate(fingers):
        parent = "palm"
        for j, (place, axis, own, fixed, other) in enumerate(finger):
            link(f"l{i}{j}", *own)
            ends = '<limit lower="-1" upper="1.5" effort="0.7" velocity="3"/><dynamics damping="0.02"/>'
            parts.append(
                f'<joint name="j{i}{j}" type="revolute"><parent link="{parent}"/><child link="l{i}{j}"/>'
                f'{origin(*place)}<axis xyz="{numbers(axis)}"/>{ends}</joint>'
            )
            link(f"e{i}{j}", *other)
            parts.append(
                f'<joint name="f{i}{j}" type="fixed"><parent link="l{i}{j}"/><child link="e{i}{j}"/>'
                f"{origin(*fixed)}</joint>"
            )
            parent = f"l{i}{j}"
    return "\n".join([*parts, "</robot>"])


def as_mjcf(fingers, *, armature=0.0, ref=0.0):
    """The same by quaternions; bodies inside each other."""

    def place(at, turn):
        quaternion = np.roll(Rotation.from_euler("xyz", turn).as_quat(), 1)
        return f'pos="{numbers(at)}" quat="{numbers(quaternion)}"'

    def inertial(at, turn, mass, moments):
        turn = Rotation.from_euler("xyz", turn).as_matrix()
        t = turn @ (np.diag(moments) + [[0, 1e-6, -2e-6], [1e-6, 0, 3e-6], [-2e-6, 3e-6, 0]]) @ turn.T
        six = numbers([t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]])
        return f'<inertial pos="{numbers(at)}" mass="{mass}" fullinertia="{six}"/>'

    def body(i, j, links):
        (at, axis, own, fixed, other), *rest = links
        joint = (
            f'<joint name="j{i}{j}" axis="{numbers(axis)}" damping="0.02" armature="{armature}" ref="{ref}"'
        )
        joint += ' range="-1 1.5" actuatorfrcrange="-0.7 0.7"/>'
        end = f'<body name="e{i}{j}" {place(*fixed)}>{inertial(*other)}</body>'
        inner = body(i, j + 1, rest) if rest else ""
        return f'<body name="l{i}{j}" {place(*at)}>{joint}{inertial(*own)}{end}{inner}</body>'

    each = "".join(body(i, 0, finger) for i, finger in enumerate(fingers))
    return (
        f'<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="palm">{each}</body>'
        f"</worldbody></mujoco>"
    )


def motion(finger, q, v):
    """M, h, place and axes of the tip."""
    found, inertia = finger.motion(
        tuple(map(jnp.asarray, q)), tuple(map(jnp.asarray, v)), Vec3(*map(jnp.asarray, GRAVITY))
    )
    lower = inertia.mass
    mass = [[float(lower[max(i, j)][min(i, j)]) for j in range(len(q))] for i in range(len(q))]
    axes = np.stack([np.asarray(axis.array()) for axis in (found.pose.x, found.pose.y, found.pose.z)], -1)
    return np.array(mass), np.array(inertia.force), np.asarray(found.pose.origin.array()), axes


def of_mujoco(text, angles, rates):
    """M, h and the data of the whole hand, by MuJoCo alone."""
    spec = mujoco.MjSpec.from_string(text)
    spec.option.gravity = GRAVITY
    model = spec.compile()
    data = mujoco.MjData(model)
    for name in angles:
        data.qpos[model.joint(name).qposadr[0]] = angles[name]
        data.qvel[model.joint(name).dofadr[0]] = rates[name]
    mujoco.mj_forward(model, data)
    # Column by column, whose interface no version has changed.
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_mulM(model, data, column := np.zeros(model.nv), np.zeros(model.nv))
    for i in range(model.nv):
        mujoco.mj_mulM(model, data, column, np.eye(model.nv)[i])
        mass[:, i] = column
    return model, data, mass


def check_against_mujoco(hand, text, seed=0):
    rng = np.random.default_rng(seed)
    names = [name for joints in hand.joints for name in joints]
    angles = dict(zip(names, rng.uniform(-1.0, 1.5, len(names)), strict=True))
    rates = dict(zip(names, rng.normal(size=len(names)), strict=True))
    model, data, whole = of_mujoco(text, angles, rates)
    for finger, joints, tip in zip(hand.fingers, hand.joints, hand.tips, strict=True):
        at = [model.joint(name).dofadr[0] for name in joints]
        mass, force, origin, axes = motion(finger, [angles[n] for n in joints], [rates[n] for n in joints])
        wanted = whole[np.ix_(at, at)]
        np.testing.assert_allclose(mass, wanted, atol=1e-12 * np.abs(wanted).max())
        wanted = data.qfrc_bias[at]
        np.testing.assert_allclose(force, wanted, atol=1e-12 * np.abs(wanted).max())
        np.testing.assert_allclose(origin, data.body(tip).xpos, atol=1e-14)
        np.testing.assert_allclose(axes, data.body(tip).xmat.reshape(3, 3), atol=1e-13)


def written(tmp_path, text, name="hand.urdf"):
    path = tmp_path / name
    path.write_text(text)
    return path


def without_meshes(text):
    """MuJoCo, unlike `load_hand`, insists on all meshes."""
    return re.sub("<collision>.*?</collision>", "", text).replace(
        "</robot>", '<mujoco><compiler fusestatic="false"/></mujoco></robot>'
    )


@of_exact_mujoco
def test_a_hand_from_urdf_moves_as_in_mujoco(tmp_path):
    text = as_urdf(random_links(1))
    tips = {f"e{i}{k - 1}": BALL for i, k in enumerate(JOINTS)}
    hand = jxr.io.load_hand(written(tmp_path, text), tips)
    assert hand.tips == tuple(tips) and tuple(map(len, hand.joints)) == JOINTS
    check_against_mujoco(hand, without_meshes(text))
    assert hand.limits[1].tolist() == [[-1.0, 1.5]] * 2 and hand.torques[1].tolist() == [[-0.7, 0.7]] * 2
    assert hand.damping[2].tolist() == [0.02] * 4


@of_exact_mujoco
def test_the_same_hand_from_mjcf(tmp_path):
    """To the same fingers; then with rotors, and angles that are measured from elsewhere than the drawing."""
    links = random_links(1)
    tips = {f"e{i}{k - 1}": BALL for i, k in enumerate(JOINTS)}
    first = jxr.io.load_hand(written(tmp_path, as_urdf(links)), tips)
    text = as_mjcf(links)
    again = jxr.io.load_hand(written(tmp_path, text, "hand.xml"), tips)
    same = lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-13)  # noqa: E731
    for a, b in zip(first.fingers, again.fingers, strict=True):
        for name in ("axes", "offsets", "masses", "base", "centres", "inertias"):
            same(getattr(a, name), getattr(b, name))
    for name in ("limits", "torques", "damping"):
        same(np.concatenate(getattr(first, name)), np.concatenate(getattr(again, name)))
    text = as_mjcf(links, armature=3e-4, ref=0.4)
    moved = jxr.io.load_hand(written(tmp_path, text, "moved.xml"), tips)
    np.testing.assert_allclose(moved.fingers[2].armature, 3e-4)
    check_against_mujoco(moved, text)


def test_a_hand_is_placed_in_the_world_and_held_joints_are_part_of_the_palm(tmp_path):
    links = random_links(2)
    path = written(tmp_path, as_urdf(links))
    turn, shift = np.array([0.5, -0.5, 0.1, 0.7]), np.array([0.1, -0.2, 0.3])
    options = {"held": {"j20": 0.3, "j23": -0.4}}
    still = jxr.io.load_hand(path, {"e23": BALL}, **options)
    placed = jxr.io.load_hand(path, {"e23": BALL}, **options, position=shift, rotation=turn)
    whole = jxr.io.load_hand(path, {"e23": BALL})
    assert still.joints == (("j21", "j22"),)
    q, v = np.array([0.2, -0.7]), np.array([0.5, 0.8])
    mass, _, origin, axes = motion(still.fingers[0], q, v)
    all_mass, _, all_origin, all_axes = motion(whole.fingers[0], [0.3, *q, -0.4], [0.0, *v, 0.0])
    np.testing.assert_allclose(mass, all_mass[1:3, 1:3], rtol=1e-12)
    np.testing.assert_allclose(origin, all_origin, atol=1e-15)
    np.testing.assert_allclose(axes, all_axes, atol=1e-14)
    _, _, there, turned = motion(placed.fingers[0], q, v)
    world = Rotation.from_quat(np.roll(turn, -1)).as_matrix()
    np.testing.assert_allclose(there, shift + world @ origin, atol=1e-15)
    np.testing.assert_allclose(turned, world @ axes, atol=1e-14)


LINK = (
    "<inertial><mass value='{}'/><inertia ixx='{}' iyy='1e-5' izz='1e-5' ixy='0' ixz='0' iyz='0'/></inertial>"
)


def small_urdf(*joints, extra=""):
    """Joints as (name, type, parent, child); every child has the same inertia."""
    parts = ["<robot name='small'><link name='palm'/>"]
    for name, kind, parent, child in joints:
        parts.append(f"<link name='{child}'>{LINK.format(0.1, 1e-5)}</link>")
        ends = f"<parent link='{parent}'/><child link='{child}'/><axis xyz='0 1 0'/>"
        ends += "<limit lower='0' upper='1' effort='1' velocity='1'/>"
        parts.append(f"<joint name='{name}' type='{kind}'>{ends}</joint>")
    return "\n".join(parts) + extra + "</robot>"


HINGE = ("knuckle", "revolute", "palm", "finger")
REFUSED = {
    "a slide": (small_urdf(HINGE, ("slider", "prismatic", "finger", "tip")), "'slider' is a slide"),
    "a branch": (
        small_urdf(HINGE, ("a", "revolute", "finger", "one"), ("b", "revolute", "finger", "two")),
        "'knuckle' carries two joints",
    ),
    "a floating joint": (small_urdf(("loose", "floating", "palm", "finger")), "free joint"),
    "no joint": (small_urdf(("stuck", "fixed", "palm", "finger")), "joints that move"),
    "no mass at the end": (
        small_urdf(HINGE).replace("0.1'", "0'").replace("1e-5", "0"),
        "joint 'knuckle' moves none",
    ),
    "a moment below zero": (small_urdf(HINGE).replace("ixx='1e-05'", "ixx='-1e-5'"), "positive masses"),
    "no robot": ("<robot name='small'>", "hand.urdf: "),
    "two ends": (
        small_urdf(HINGE, ("a", "fixed", "finger", "one"), ("b", "fixed", "finger", "two")),
        "argument tips must be a dict",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_hand_is_refused_by_name(tmp_path, what):
    text, said = REFUSED[what]
    with pytest.raises(ValueError, match="argument ") as refused:
        jxr.io.load_hand(written(tmp_path, text), BALL)
    assert said in str(refused.value) and len(str(refused.value)) < 300


def test_joints_that_follow_others_are_refused_until_they_are_held(tmp_path):
    text = small_urdf(HINGE, ("follower", "revolute", "finger", "tip"))
    whole = text.replace(
        "name='follower' type='revolute'>", "name='follower' type='revolute'><mimic joint='knuckle'/>"
    )
    assert whole != text
    path = written(tmp_path, whole)
    with pytest.raises(ValueError, match="'follower' is tied to another part"):
        jxr.io.load_hand(path, BALL)
    assert jxr.io.load_hand(path, BALL, held={"follower": 0.2}).joints == (("knuckle",),)
    with pytest.raises(ValueError, match="argument held must name joints"):
        jxr.io.load_hand(path, BALL, held={"thumb": 0.0})


def test_links_without_mass_between_two_joints_count_for_nothing(tmp_path):
    """Two joints in one body, as MJCF has them, are two links, the first without mass."""
    body = '<body name="b" pos="0 0 0.1"><joint name="j" axis="1 0 0"/>'
    body += '<joint name="k" axis="0 1 0" pos="0 0 0.01"/>'
    body += '<inertial pos="0 0 0.03" mass="0.1" diaginertia="1e-5 2e-5 2e-5"/></body>'
    text = f"<mujoco><worldbody>{body}</worldbody></mujoco>"
    check_against_mujoco(jxr.io.load_hand(written(tmp_path, text, "two.xml"), BALL), text)


def with_shape(shape):
    """A finger whose tip, a link of its own, has a shape 30 mm along z."""
    solid = f"<collision><origin xyz='0 0 0.03'/><geometry>{shape}</geometry></collision></link>"
    joint = "\n<joint name='end'"
    return small_urdf(HINGE, ("end", "fixed", "finger", "tip")).replace(f"</link>{joint}", solid + joint)


def test_the_tip_of_a_file_is_taken_where_that_is_asked_for(tmp_path):
    path = written(tmp_path, with_shape("<sphere radius='0.012'/>"))
    surface = jxr.io.load_hand(path, "mesh").fingers[0].tip
    top = surface.point(surface.near(np.array([0.0, 0.0, 0.1])))
    np.testing.assert_allclose(top, (0.0, 0.0, 0.042), atol=1e-15)
    with pytest.raises(ValueError, match="argument tips must be surfaces where"):
        jxr.io.load_hand(written(tmp_path, with_shape("<box size='0.01 0.01 0.01'/>")), "mesh")
    # The tip's link has no shape, and its frame is elsewhere and turned: that of the finger's link is taken.
    start = "<origin xyz='0.001 0.002 0.003' rpy='0.3 -0.2 0.5'/>"
    bare = small_urdf(HINGE, ("end", "fixed", "finger", "tip")).replace("'fixed'>", f"'fixed'>{start}")
    solid = "<collision><origin xyz='0 0 0.03'/><geometry><sphere radius='0.012'/></geometry></collision>"
    moved = bare.replace("</link>\n<joint name='knuckle'", f"{solid}</link>\n<joint name='knuckle'")
    surface = jxr.io.load_hand(written(tmp_path, moved), "mesh").fingers[0].tip
    turn = Rotation.from_euler("xyz", (0.3, -0.2, 0.5))
    centre = turn.inv().apply((-0.001, -0.002, 0.027))
    for way in np.eye(3):
        point = surface.point(surface.near(centre + 0.05 * way))
        np.testing.assert_allclose(point, centre + 0.012 * way, atol=1e-14)


@pytest.mark.parametrize(
    "name", ["package://mine/meshes/tip.stl", "package://meshes/tip.stl", "meshes/tip.stl"]
)
@pytest.mark.parametrize("options", [{"smoothing": 0.02}, {"smallest_radius": 0.005}])
def test_what_is_fitted_is_the_mesh_of_the_tips_link(tmp_path, monkeypatch, name, options):
    """An odd body of flat faces, 30 mm along z: its corners and faces, or points with normals all over it."""
    trimesh = pytest.importorskip("trimesh")
    corners = np.random.default_rng(0).normal(size=(12, 3)) * np.array([0.01, 0.008, 0.012])
    (tmp_path / "meshes").mkdir()
    body = trimesh.convex.convex_hull(corners)
    body.export(tmp_path / "meshes" / "tip.stl")
    asked = []

    def fitted(points, normals=None, **given):
        asked.append((points - np.array([0.0, 0.0, 0.03]), normals, given))
        report = SimpleNamespace(doubts=(), curvature=(100.0, 100.0), smoothing=0.02)
        return SimpleNamespace(surface=jxr.geometry.Sphere(0.01), report=report)

    monkeypatch.setattr(_hand, "fit_surface", fitted)
    path = written(tmp_path, with_shape(f"<mesh filename='{name}'/>"))
    tip = jxr.io.load_hand(path, "mesh", **options).fingers[0].tip
    assert isinstance(tip, jxr.geometry.Sphere)
    ((points, normals, given),) = asked
    if "smallest_radius" in options:
        assert given.pop("smallest_radius") == 0.005 and set(given) == {"faces"}
        found = trimesh.Trimesh(points, given["faces"])
        np.testing.assert_allclose(
            np.unique(points.round(7), axis=0), np.unique(body.vertices.round(7), axis=0)
        )
        assert found.volume == pytest.approx(body.volume, rel=1e-5)
        return
    assert given == options and len(points) > 100
    heights = body.face_normals @ points.T - np.sum(body.face_normals * body.triangles[:, 0], axis=1)[:, None]
    assert np.abs(heights.max(axis=0)).max() < 1e-7  # on one face, and beyond none
    on = body.face_normals[np.argmax(heights, axis=0)]
    assert np.mean(np.sum(on * normals, axis=1) > 0.999) > 0.9


def test_a_tip_that_cannot_be_fitted_is_named(tmp_path, monkeypatch):
    trimesh = pytest.importorskip("trimesh")

    def refused(*args, **given):
        raise ValueError("argument smallest_radius must be smaller")

    monkeypatch.setattr(_hand, "fit_surface", refused)
    trimesh.creation.box((0.024, 0.020, 0.030)).export(tmp_path / "tip.stl")
    path = written(tmp_path, with_shape("<mesh filename='tip.stl'/>"))
    with pytest.raises(ValueError, match=r"argument smallest_radius must be smaller \(tip 'tip'\)"):
        jxr.io.load_hand(path, "mesh", smallest_radius=0.02)


UNTRUSTED = ("it encloses no body", "it bends with a radius of 1 mm")
SHARP = (-6000.0, 5000.0)


@pytest.mark.parametrize(
    ("doubts", "curvature", "smoothing", "refused"),
    [
        (UNTRUSTED, SHARP, None, True),
        (UNTRUSTED, SHARP, 0.004, True),
        (UNTRUSTED, (90.0, 110.0), None, True),
        # Who asks for a wavelength rounds corners off by it.
        (("a point is 1 mm off it",), (0.0, 300.0), 0.004, False),
        ((), (90.0, 110.0), None, False),
    ],
)
def test_a_mesh_with_sharp_edges_wants_a_smallest_radius(doubts, curvature, smoothing, refused):
    report = SimpleNamespace(doubts=doubts, curvature=curvature, smoothing=0.004)
    check = partial(_hand._check_smooth, SimpleNamespace(name="T"), report, _hand._Wish(smoothing, None))
    if not refused:
        check()
        return
    words = "argument smallest_radius must be given for .* edges or coarse faces, as that of tip 'T', but was"
    why = "None: .* not to be trusted, as it encloses no body and it bends with a radius of 1 mm"
    with pytest.raises(ValueError, match=f"{words} {why}"):
        check()


@pytest.mark.slow
def test_a_box_is_no_fingertip_and_a_divided_ball_is(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    path = written(tmp_path, with_shape("<mesh filename='tip.stl'/>"))
    trimesh.creation.icosphere(2, 0.01).export(tmp_path / "tip.stl")
    surface = jxr.io.load_hand(path, "mesh").fingers[0].tip
    assert np.asarray(surface.principal_curvatures(surface.near(np.array([0.0, 0.0, 0.04])))[0]) == (
        pytest.approx([100.0, 100.0], rel=0.15)
    )
    trimesh.creation.box((0.02,) * 3).export(tmp_path / "tip.stl")
    with pytest.raises(ValueError, match="argument smallest_radius must be given .* tip 'tip'"):
        jxr.io.load_hand(path, "mesh")


@pytest.mark.slow
def test_a_tip_is_fitted_to_the_mesh_of_its_link(tmp_path):
    """A ball of 4000 corners in a file beside, named as in a package: the same ball, in the tip's frame."""
    trimesh = pytest.importorskip("trimesh")
    u = np.random.default_rng(0).normal(size=(4000, 3))
    corners = 0.012 * u / np.linalg.norm(u, axis=1)[:, None]
    trimesh.convex.convex_hull(corners).export(tmp_path / "tip.stl")
    path = written(tmp_path, with_shape("<mesh filename='package://mine/tip.stl'/>"))
    surface = jxr.io.load_hand(path, "mesh", smoothing=0.02).fingers[0].tip
    ways = np.random.default_rng(1).normal(size=(20, 3))
    centre = np.array([0.0, 0.0, 0.03])
    rim = centre + 0.012 * ways / np.linalg.norm(ways, axis=1)[:, None]
    found = np.array([surface.point(surface.near(point)) for point in rim])
    np.testing.assert_allclose(np.linalg.norm(found - centre, axis=1), 0.012, atol=5e-5)


@pytest.mark.slow
def test_a_tip_is_fitted_with_a_smallest_radius(tmp_path):
    """A block whose edges are rounded off: its faces are kept, in the tip's frame, and the radius is met."""
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((0.024, 0.020, 0.030)).export(tmp_path / "tip.stl")
    path = written(tmp_path, with_shape("<mesh filename='package://mine/tip.stl'/>"))
    surface = jxr.io.load_hand(path, "mesh", smallest_radius=0.005).fingers[0].tip
    faces = np.array([[0.012, 0.0, 0.03], [0.0, -0.01, 0.03], [0.0, 0.0, 0.045]])
    found = np.array([surface.point(surface.near(point)) for point in faces])
    np.testing.assert_allclose(found, faces, atol=2e-4)
    ways = np.random.default_rng(1).normal(size=(200, 3))
    feet = surface.near(np.array([0.0, 0.0, 0.03]) + 0.012 * ways / np.linalg.norm(ways, axis=1)[:, None])
    assert np.abs(surface.principal_curvatures(feet)[0]).max() <= 1.0 / 0.005
    corner = surface.point(surface.near(np.array([0.012, 0.010, 0.045])))
    assert 0.002 < np.linalg.norm(corner - np.array([0.012, 0.010, 0.045])) < 0.006
    with pytest.raises(ValueError, match=r"argument smallest_radius must .*\(tip 'tip'\)"):
        jxr.io.load_hand(path, "mesh", smallest_radius=0.02)


def test_a_tip_has_one_kind_of_smoothing(tmp_path):
    path = written(tmp_path, with_shape("<sphere radius='0.012'/>"))
    with pytest.raises(ValueError, match="argument smoothing must be left out with smallest_radius"):
        jxr.io.load_hand(path, "mesh", smoothing=0.02, smallest_radius=0.01)
    with pytest.raises(ValueError, match="argument smallest_radius must be positive"):
        jxr.io.load_hand(path, "mesh", smallest_radius=-0.01)


def test_torques_are_limited_by_the_motors_of_a_joint_too(tmp_path):
    """Motors pull with their force times their gear, which may be negative."""
    body = '<body><joint name="j"/><geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.05"/></body>'
    motor = '<actuator><motor joint="j" gear="-2" forcerange="-0.1 0.3"/></actuator>'
    path = written(tmp_path, f"<mujoco><worldbody>{body}</worldbody>{motor}</mujoco>", "motor.xml")
    assert jxr.io.load_hand(path, BALL).torques[0].tolist() == [[-0.6, 0.2]]


def test_a_rotor_adds_to_the_mass_matrix_alone():
    links = [(0, 0.06, 0), (0, 0.06, 0)]
    bare = jxr.Finger3([(1, 0, 0), (0, 0, 1)], links, [0.03, 0.01], BALL)
    geared = jxr.Finger3([(1, 0, 0), (0, 0, 1)], links, [0.03, 0.01], BALL, armature=[1e-4, 2e-4])
    (mass, force, *_), (more, same, *_) = (motion(f, (0.3, -0.4), (1.0, 2.0)) for f in (bare, geared))
    np.testing.assert_allclose(more - mass, np.diag([1e-4, 2e-4]), atol=1e-18)
    np.testing.assert_array_equal(force, same)
    with pytest.raises(ValueError, match="argument armature must not be negative"):
        jxr.Finger3([(1, 0, 0), (0, 0, 1)], links, [0.03, 0.01], BALL, armature=[1e-4, -1e-4])
    assert eqx.tree_equal(bare.with_payload(0.01).armature, None)


ODD = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="palm">
<body name="near" pos="0.01 -0.02 0.03">
  <joint name="first" axis="1 0 0" range="-0.5 1.25" damping="0.02" frictionloss="0.03" stiffness="0.4"/>
  <inertial mass="0.05" pos="0 0.01 0.02" diaginertia="1e-5 2e-5 2.5e-5"/>
  <body name="far" pos="0 0.01 0.05">
    <joint name="second" axis="0 2 0" armature="1e-4"/>
    <inertial mass="0.03" pos="0.001 0.002 0.01" diaginertia="2e-6 3e-6 4e-6"/>
    <geom type="sphere" size="0.02" contype="0" conaffinity="0"/>
    <geom type="ellipsoid" size="0.008 0.009 0.012" pos="0.001 -0.002 0.02" quat="0.6 0.8 0 0"
      contype="{contype}" conaffinity="{conaffinity}"/>
  </body></body></body></worldbody><actuator>{motors}</actuator></mujoco>"""


def odd(tmp_path, contype=1, conaffinity=0, motors=""):
    text = ODD.format(contype=contype, conaffinity=conaffinity, motors=motors)
    return written(tmp_path, text, "odd.xml")


def test_what_a_file_says_of_its_joints(tmp_path):
    """Of one with all of it, and of one with a rotor alone, whose axis is brought to length one."""
    robot = _robot_file.read_robot(odd(tmp_path))
    first, second = robot.joints
    assert [link.name for link in robot.links] == ["world", "palm", "near", "far"]
    assert [(link.parent, link.carrier) for link in robot.links] == [(0, None), (0, None), (1, 0), (2, 1)]
    assert (first.name, first.kind, first.link, first.before) == ("first", "hinge", 2, None)
    assert (second.name, second.kind, second.link, second.before) == ("second", "hinge", 3, 0)
    assert (first.limits, first.torques) == ((-0.5, 1.25), (-np.inf, np.inf))
    assert (second.limits, second.torques) == ((-np.inf, np.inf), (-np.inf, np.inf))
    assert (first.damping, first.friction, first.stiffness, first.armature) == (0.02, 0.03, 0.4, 0.0)
    assert (second.damping, second.friction, second.stiffness, second.armature) == (0.0, 0.0, 0.0, 1e-4)
    np.testing.assert_allclose([first.anchor, second.anchor], [[0.01, -0.02, 0.03], [0.01, -0.01, 0.08]])
    np.testing.assert_allclose([first.axis, second.axis], np.eye(3)[:2])
    near, far = robot.links[2:]
    assert (near.mass, far.mass) == (0.05, 0.03) and far.shapes == ()
    np.testing.assert_allclose([near.centre, far.centre], [[0.01, -0.01, 0.05], [0.011, -0.008, 0.09]])
    np.testing.assert_allclose(near.inertia, np.diag([1e-5, 2e-5, 2.5e-5]))
    hand = jxr.io.load_hand(odd(tmp_path), BALL)
    assert hand.friction[0].tolist() == [0.03, 0.0] and hand.stiffness[0].tolist() == [0.4, 0.0]
    assert hand.damping[0].tolist() == [0.02, 0.0] and hand.tips == ("far",)
    np.testing.assert_allclose(hand.fingers[0].armature, [0.0, 1e-4])


def test_a_joint_that_is_held_is_turned_about_its_anchor(tmp_path):
    robot = _robot_file.read_robot(odd(tmp_path), held={"first": 0.3})
    (only,) = robot.joints
    assert only.name == "second" and only.before is None
    turned = Rotation.from_rotvec([0.3, 0.0, 0.0])
    np.testing.assert_allclose(only.anchor, [0.01, -0.02, 0.03] + turned.apply([0.0, 0.01, 0.05]))
    np.testing.assert_allclose(only.axis, turned.apply([0.0, 1.0, 0.0]), atol=1e-15)
    np.testing.assert_allclose(robot.links[3].quaternion, np.roll(turned.as_quat(), 1), atol=1e-15)


@pytest.mark.parametrize(("contype", "conaffinity", "touching"), [(1, 0, True), (0, 1, True), (0, 0, False)])
def test_the_shapes_of_a_link_are_those_that_touch_where_any_does(tmp_path, contype, conaffinity, touching):
    path = odd(tmp_path, contype, conaffinity)
    shapes = _robot_file.read_robot(path, shapes_of={"far"}).links[3].shapes
    assert [kind for kind, _ in shapes] == ["ellipsoid"] if touching else ["ball", "ellipsoid"]
    half, place, quaternion = shapes[-1][1]
    np.testing.assert_allclose(half, [0.008, 0.009, 0.012])
    np.testing.assert_allclose(place, [0.001, -0.002, 0.02])
    np.testing.assert_allclose(quaternion, [0.6, 0.8, 0.0, 0.0])
    if not touching:
        np.testing.assert_allclose(shapes[0][1][0], [0.02] * 3)
        with pytest.raises(ValueError, match="one mesh, ball or ellipsoid, but 'far' has 2"):
            jxr.io.load_hand(path, "mesh")
        return
    # Its foremost points along its own axes, which are turned about x.
    tip = jxr.io.load_hand(path, "mesh").fingers[0].tip
    for size, axis in zip(half, Rotation.from_quat([0.8, 0.0, 0.0, 0.6]).as_matrix().T, strict=True):
        point = tip.point(tip.near(place + 3.0 * size * axis))
        np.testing.assert_allclose(point, place + size * axis, atol=1e-12)


PULLS = '<motor joint="first" gear="3" forcerange="-0.1 0.2"/>'
MOTORS = {
    "two that pull together": (2 * PULLS, (-0.6, 1.2)),
    "one without a limit": (
        '<motor joint="first" forcerange="-0.1 0.2"/><motor joint="first"/>',
        (-np.inf, np.inf),
    ),
    "one of another joint": ('<motor joint="second" forcerange="-0.1 0.2"/>', (-np.inf, np.inf)),
    "none": ("", (-np.inf, np.inf)),
}


@pytest.mark.parametrize("case", MOTORS)
def test_motors_limit_the_torque_of_their_joint_if_all_are_limited(tmp_path, case):
    motors, wanted = MOTORS[case]
    found = _robot_file.read_robot(odd(tmp_path, motors=motors)).joints[0].torques
    np.testing.assert_allclose(found, wanted)
    strict = odd(tmp_path, motors=motors)
    strict.write_text(strict.read_text().replace('name="first"', 'name="first" actuatorfrcrange="-0.5 0.7"'))
    low, high = _robot_file.read_robot(strict).joints[0].torques
    assert (low, high) == (max(-0.5, wanted[0]), min(0.7, wanted[1]))


def joint(**changes):
    given = {"name": "j", "axis": np.array([0.0, 0.0, 1.0]), "anchor": np.array([1.0, 2.0, 3.0])}
    given |= {"armature": 0.0}
    return SimpleNamespace(**given | changes)


@pytest.mark.parametrize(
    ("mass", "moments", "fine"),
    [
        (0.0, (0.0, 0.0, 0.0), True),
        (0.1, (-0.7e-9, 0.5, 1.0), True),
        (0.1, (-1.5e-9, 0.5, 1.0), False),
        (-1e-9, (1.0, 1.0, 1.0), False),
        (np.nan, (1.0, 1.0, 1.0), False),
        (np.inf, (1.0, 1.0, 1.0), False),
        (0.1, (-1e-3, -2e-3, 0.0), False),
    ],
)
def test_masses_and_moments_are_not_below_zero_by_more_than_rounding(mass, moments, fine):
    turned = Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()
    check = lambda: _hand._check_inertia(joint(), mass, turned @ np.diag(moments) @ turned.T)  # noqa: E731
    if fine:
        return check()
    with pytest.raises(ValueError, match="what joint 'j' moves has"):
        check()


def test_moments_that_are_refused_are_told():
    with pytest.raises(ValueError, match=r"has 0.1 kg and moments \[-0.25, 0.5, 1.0\]"):
        _hand._check_inertia(joint(), 0.1, np.diag([0.5, -0.25, 1.0]))


@pytest.mark.parametrize(
    ("mass", "centre", "inertia", "armature", "fine"),
    [
        (0.1, (1.0, 2.0, 7.0), (1.0, 1.0, 0.0), 0.0, False),  # a rod along the axis
        (0.1, (1.0, 2.1, 7.0), (1.0, 1.0, 0.0), 0.0, True),
        (0.1, (1.1, 2.0, 7.0), (1.0, 1.0, 0.0), 0.0, True),
        (0.1, (1.0, 2.0, 7.0), (1.0, 1.0, 1e-9), 0.0, True),
        (0.0, (1.0, 2.0, 7.0), (1.0, 1.0, 0.0), 1e-9, True),
        (0.0, (2.0, 2.0, 7.0), (1.0, 1.0, 0.0), 0.0, False),
        (0.1, (1.0, 2.0, 7.0), (0.0, 0.0, -1e-3), 0.0, False),
    ],
)
def test_a_last_joint_moves_something(mass, centre, inertia, armature, fine):
    given = joint(armature=armature), mass, np.array(centre), np.diag(inertia)
    if fine:
        return _hand._check_last(*given)
    with pytest.raises(ValueError, match="joint 'j' moves none"):
        _hand._check_last(*given)


@pytest.mark.parametrize(("least", "added"), [(0.0, 2e-14), (0.7e-14, 2e-14), (1.5e-14, 0.0)])
def test_moments_are_made_positive_beyond_rounding(least, added):
    """Those of a rod, by two hundred-trillionths of the largest."""
    rod = np.diag([3.0, 2.0, 3.0 * least])
    np.testing.assert_allclose(_hand._definite(rod) - rod, 3.0 * added * np.eye(3), rtol=0.05, atol=1e-30)
    nothing = _hand._definite(np.zeros((3, 3)))
    np.testing.assert_allclose(nothing, 2e-30 * np.eye(3))
    odd = np.array([[3.0, 0.2, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(_hand._definite(odd)[0, 1], 0.1)


def test_links_of_one_joint_are_one_body():
    """By Steiner's rule about the common centre; without mass about the joint."""
    link = lambda mass, centre, moments, carrier: SimpleNamespace(  # noqa: E731
        mass=mass, centre=np.array(centre), inertia=np.diag(moments), carrier=carrier
    )
    links = [link(1.0, (0, 0, 0), (1, 2, 3), 0), link(3.0, (4, 0, 0), (10, 20, 30), 0)]
    links.append(link(9.0, (7, 7, 7), (5, 5, 5), 1))
    robot = SimpleNamespace(links=links, joints=[joint(), joint()])
    mass, centre, inertia = _hand._merged(robot, 0)
    assert mass == 4.0
    np.testing.assert_allclose(centre, [3.0, 0.0, 0.0])
    np.testing.assert_allclose(inertia, np.diag([11.0, 22.0 + 9.0 + 3.0, 33.0 + 9.0 + 3.0]))
    light = SimpleNamespace(links=[link(0.0, (0, 0, 0), (1, 2, 3), 0)], joints=[joint()])
    mass, centre, inertia = _hand._merged(light, 0)
    assert mass == 0.0 and centre.tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_allclose(inertia, np.diag([1.0, 2.0, 3.0]))


@pytest.mark.parametrize("tips", [{}, {"tip": 3}, "ball", 3, None])
def test_tips_are_surfaces_or_the_files_own(tips):
    with pytest.raises(ValueError, match="argument tips"):
        _hand._as_tips(tips)
    assert _hand._as_tips("mesh") == "mesh" and _hand._as_tips({"tip": BALL}) == {"tip": BALL}


@pytest.mark.parametrize("held", [3, [("j", 0.1)], {3: 0.1}, {"j": "far"}, {"j": np.nan}])
def test_held_joints_have_names_and_angles(held):
    with pytest.raises(ValueError, match="argument held"):
        _hand._as_held(held)
    assert _hand._as_held(None) == {} and _hand._as_held({"j": 1}) == {"j": 1.0}


@pytest.mark.parametrize("tips", [{"far": BALL, "near": BALL}, {"palm": BALL}, {"far": BALL, "none": BALL}])
def test_names_of_tips_are_of_last_links_one_for_each_finger(tmp_path, tips):
    with pytest.raises(ValueError, match="argument tips must name tip links of fingers, one for each"):
        jxr.io.load_hand(odd(tmp_path), tips)
