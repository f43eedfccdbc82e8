"""What robot files leave unsaid, say twice, or say of more than links and joints: told or refused."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxroll as jxr
from jaxroll.io._robot_file import read_robot

BALL = jxr.Sphere(0.01)
INERTIAL = '<inertial pos="0 0.01 0.02" mass="{}" diaginertia="1e-5 2e-5 2.5e-5"/>'


def mjcf(
    near='name="a"', far='name="b"', *, names=('name="near"', 'name="far"'), inner="", settings="", more=""
):
    """A finger of two links and joints."""
    first, second = INERTIAL.format(0.05), INERTIAL.format(0.03)
    tip = f'<body {names[1]} pos="0 0.01 0.05"><joint axis="0 1 0" {far}/>{second}{inner}</body>'
    body = f'<body {names[0]} pos="0.01 0 0"><joint axis="1 0 0" {near}/>{first}{tip}</body>'
    return (
        f'<mujoco><compiler angle="radian" autolimits="true" {settings}/><worldbody>{body}</worldbody>'
        f"{more}</mujoco>"
    )


def urdf(near="", far="", *, more="", attributes=""):
    """The same finger."""
    ends = '<limit lower="-1" upper="1.5" effort="2" velocity="1"/>'
    moments = '<inertia ixx="1e-5" iyy="2e-5" izz="2.5e-5" ixy="0" ixz="0" iyz="0"/>'
    link = f'<inertial><mass value="0.05"/>{moments}</inertial>'
    return (
        f'<robot name="r" {attributes}><link name="palm"/><link name="one">{link}</link>'
        f'<link name="two">{link}</link>'
        f'<joint name="a" type="revolute"><parent link="palm"/><child link="one"/>{near or ends}</joint>'
        f'<joint name="b" type="revolute"><parent link="one"/><child link="two"/>{far or ends}</joint>'
        f"{more}</robot>"
    )


def written(tmp_path, text, name="hand.xml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def compiled(text):
    return mujoco.MjModel.from_xml_string(text)


def inertias(robot):
    """Masses and principal moments of all links but the world."""
    return [[link.mass, *np.linalg.eigvalsh(link.inertia)] for link in robot.links[1:]]


def inertias_of(model):
    return np.column_stack([model.body_mass, np.sort(model.body_inertia)])[1:]


def test_parts_without_a_name_count_like_others(tmp_path):
    """Two links without a name had the inertia of the last one, and of two such joints one was dropped."""
    text = mjcf("", "", names=("", ""))
    robot = read_robot(written(tmp_path, text))
    assert [joint.name for joint in robot.joints] == ["joint0", "joint1"]
    assert [link.name for link in robot.links] == ["world", "link1", "link2"]
    np.testing.assert_allclose(inertias(robot), inertias_of(compiled(text)), rtol=1e-12)
    held = read_robot(written(tmp_path, mjcf("", 'name="joint0"')), held={"joint0_0": 0.3})
    assert [joint.name for joint in held.joints] == ["joint0"]


FUSED = '<body name="tip" pos="0 0 0.02" euler="0.3 0.2 0.1"><inertial pos="0 0 0" mass="0.02" \
diaginertia="1e-6 1e-6 1e-6"/></body>'
SETTINGS = {
    "links made one": ('fusestatic="true"', FUSED),
    "inertias from shapes": ('inertiafromgeom="true"', '<geom type="mesh" mesh="m"/>'),
    "inertias stated": ("", '<geom type="mesh" mesh="m"/>'),
}


@pytest.mark.parametrize("case", SETTINGS)
def test_inertias_are_those_of_the_compiler_whatever_its_settings(tmp_path, case):
    settings, inner = SETTINGS[case]
    mesh = '<asset><mesh name="m" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/></asset>'
    text = mjcf(inner=inner, settings=settings, more=mesh).replace(
        INERTIAL.format(0.05), INERTIAL.format(0.05) + '<geom size="0.02"/>'
    )
    robot, model = read_robot(written(tmp_path, text)), compiled(text)
    mass, wanted = sum(link.mass for link in robot.links), model.body_mass[1:].sum()
    assert mass == pytest.approx(wanted, rel=1e-6) and len(robot.joints) == 2
    if model.nbody == len(robot.links):
        np.testing.assert_allclose(inertias(robot), inertias_of(model), rtol=1e-6)


JOINTS = {
    "a spring that rests elsewhere": ('stiffness="0.4" springref="0.7"', "", {"stiffness": 0.4, "rest": 0.7}),
    "a spring by its time": ('springdamper="0.1 1"', "", None),
    "a motor with a range of signals": (
        "",
        '<motor joint="a" gear="-0.5" ctrlrange="-1 2" ctrllimited="true"/>',
        {"torques": (-1.0, 0.5)},
    ),
    "a motor with both ranges": (
        "",
        '<motor joint="a" ctrlrange="-1 2" ctrllimited="true" forcerange="-0.5 9" forcelimited="true"/>',
        {"torques": (-0.5, 2.0)},
    ),
    "a servo, whose signal is an angle": (
        "",
        '<position joint="a" kp="3" ctrlrange="-1 1" ctrllimited="true"/>',
        {"torques": (-np.inf, np.inf)},
    ),
}


@pytest.mark.parametrize("case", JOINTS)
def test_springs_and_motors_of_a_joint(tmp_path, case):
    joint, motor, wanted = JOINTS[case]
    text = mjcf(f'name="a" {joint}', more=f"<actuator>{motor}</actuator>")
    found = read_robot(written(tmp_path, text)).joints[0]
    if wanted is None:  # from the finger's inertia, which MuJoCo alone knows
        model = compiled(text)
        wanted = {
            "stiffness": np.ravel(model.jnt_stiffness[0])[0],
            "damping": np.ravel(model.dof_damping[0])[0],
        }
        assert min(wanted.values()) > 0.0
    for name, value in wanted.items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=1e-12)


@pytest.mark.skipif(
    not hasattr(compiled(mjcf()), "actuator_armature"), reason="no such files in this version"
)
def test_what_a_motor_adds_to_its_joint(tmp_path):
    more = '<actuator><motor joint="a" armature="0.001" damping="0.1" gear="3"/></actuator>'
    first, second = read_robot(written(tmp_path, mjcf(more=more))).joints
    np.testing.assert_allclose((first.armature, first.damping), (0.009, 0.9), rtol=1e-12)
    assert (second.armature, second.damping) == (0.0, 0.0)


TENDON = '<tendon><fixed name="t" {}><joint joint="a" coef="1"/><joint joint="b" coef="-1"/></fixed></tendon>'
LEFT_OUT = {
    "nothing": (mjcf(), ()),
    "a link that floats": (
        mjcf(names=('name="near"', 'name="far" gravcomp="1"')),
        ("gravity compensation of link 'far'",),
    ),
    "a tendon that only leads a motor": (mjcf(more=TENDON.format("")), ()),
    "a tendon with a spring and an end": (
        mjcf(more=TENDON.format('stiffness="3" range="-0.1 0.1" limited="true"')),
        ("stiffness and range of tendon 't'",),
    ),
    "water": (mjcf(more='<option density="1000"/>'), ("drag of a medium with density or viscosity",)),
    "oil": (mjcf(more='<option viscosity="0.1"/>'), ("drag of a medium with density or viscosity",)),
    "a motor of two joints": (
        mjcf(more=TENDON.format("") + '<actuator><motor name="m" tendon="t"/><motor joint="a"/></actuator>'),
        ("motor 'm', which drives no joint alone",),
    ),
}


@pytest.mark.parametrize("case", LEFT_OUT)
def test_what_no_finger_can_have_is_said(tmp_path, case):
    text, wanted = LEFT_OUT[case]
    hand = jxr.io.load_hand(written(tmp_path, text), BALL)
    assert hand.left_out == wanted
    assert hand.rest[0].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("ends", "wanted"), [('upper="1.2"', (0.0, 1.2)), ('lower="-0.3"', (-0.3, 0.0))])
def test_an_end_of_a_range_that_is_left_out_is_zero(tmp_path, ends, wanted):
    """As the format has it; the joint was without limits."""
    path = written(tmp_path, urdf(f'<limit {ends} effort="2" velocity="1"/>'), "hand.urdf")
    assert [joint.limits for joint in read_robot(path).joints] == [wanted, (-1.0, 1.5)]


XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
REFUSED = {
    "no range": (urdf(far="<axis xyz='0 1 0'/>"), "range of joint 'b' is from 0 to 0"),
    "a range the wrong way": (urdf('<limit lower="1" upper="-1"/>'), "range of joint 'a' is from 1 to -1"),
    "two joints of a name": (urdf().replace('"b"', '"a"'), "two joints named 'a'"),
    "a joint without a name": (urdf().replace('name="b"', ""), "it has a joint without a name"),
    "two links of a name": (urdf().replace('"two"', '"one"'), "two links named 'one'"),
    "a link apart": (urdf(more='<link name="lonely"/>'), "no joint carries its links 'palm' and 'lonely'"),
    "what xacro has to expand": (urdf(more="<xacro:finger/>", attributes=XACRO), "it holds xacro:finger"),
    "one that follows none": (urdf(far='<limit upper="1"/><mimic joint="c"/>'), "'b' follows 'c'"),
    "no number": (urdf().replace("2.5e-5", "nan"), "its inertia has izz='nan'"),
}


def test_inertias_of_a_urdf_are_turned_by_their_origins(tmp_path):
    """As the format has it: about fixed axes, roll first. Versions of MuJoCo leave the turn out."""
    origin = '<inertial><origin xyz="1 2 3" rpy="0.3 -0.4 0.5"/>'
    path = written(tmp_path, urdf().replace("<inertial>", origin), "hand.urdf")
    link = read_robot(path).links[-1]
    turn = Rotation.from_euler("xyz", (0.3, -0.4, 0.5)).as_matrix()
    np.testing.assert_allclose(link.inertia, turn @ np.diag([1e-5, 2e-5, 2.5e-5]) @ turn.T, rtol=1e-12)
    np.testing.assert_allclose(link.centre - link.origin, (1.0, 2.0, 3.0), rtol=1e-12)


def test_joints_that_follow_others_are_those_of_the_file(tmp_path):
    """Whether MuJoCo reads them or not."""
    far = '<limit lower="-1" upper="1"/><mimic joint="a" multiplier="0.5"/>'
    assert read_robot(written(tmp_path, urdf(far=far), "hand.urdf")).followers == ("b",)


@pytest.mark.skipif(int(mujoco.__version__.split(".")[0]) < 4, reason="this version does not warn of it")
def test_warnings_of_mujoco_leave_no_file_behind(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    more = '<link name="three"/><joint name="c" type="planar"><parent link="two"/><child link="three"/>'
    path = written(tmp_path, urdf(more=f'{more}<mimic joint="a"/></joint>'), "hand.urdf")
    with pytest.warns(UserWarning, match="hand.urdf: <mimic> on joint 'c'"):
        read_robot(path)
    assert [each.name for each in tmp_path.iterdir()] == ["hand.urdf"]
    assert mujoco.get_mju_user_warning() is None


@pytest.mark.parametrize("case", REFUSED)
def test_what_a_urdf_leaves_open_is_refused(tmp_path, case):
    text, said = REFUSED[case]
    assert text != urdf()
    with pytest.raises(ValueError, match="argument path must name a robot, but hand.urdf: ") as refused:
        read_robot(written(tmp_path, text, "hand.urdf"))
    assert said in str(refused.value)


def test_numbers_of_an_mjcf_file_are_numbers(tmp_path):
    with pytest.raises(ValueError, match="its joint has range='nan 1'"):
        read_robot(written(tmp_path, mjcf('name="a" range="nan 1"')))
    body = f'<body><joint damping="nan"/>{INERTIAL.format(0.1)}</body>'
    included = written(tmp_path, f"<mujocoinclude>{body}</mujocoinclude>", "part.xml")
    more = f'<worldbody><include file="{included.name}"/></worldbody>'
    with pytest.raises(ValueError, match="argument path must name a robot"):
        read_robot(written(tmp_path, mjcf(more=more)))


def test_joints_are_held_in_their_range(tmp_path):
    """An angle in degrees is out of it."""
    path = written(tmp_path, urdf(), "hand.urdf")
    with pytest.raises(
        ValueError, match=r"argument held\['a'\] must be in the joint's range, -1 to 1.5, but"
    ):
        read_robot(path, held={"a": 30.0})
    assert [joint.name for joint in read_robot(path, held={"a": 1.5}).joints] == ["b"]


@pytest.mark.parametrize("low, high", [(0.5, 1.5), (-1.5, -0.5)])
def test_a_joint_may_be_held_at_an_end_of_its_range_up_to_rounding(tmp_path, low, high):
    """Beyond it by a millionth of the range, on whichever side of zero that lies."""
    path = written(tmp_path, urdf(f'<limit lower="{low}" upper="{high}"/>'), "hand.urdf")
    beyond = 0.9e-6 * (high - low)
    for angle in (low, high, low - beyond, high + beyond):
        assert [joint.name for joint in read_robot(path, held={"a": angle}).joints] == ["b"]
    for angle in (low - 2.0 * beyond, high + 2.0 * beyond):
        with pytest.raises(ValueError, match=r"argument held\['a'\] must be in the joint's range"):
            read_robot(path, held={"a": angle})


def test_a_namespace_of_the_whole_file_changes_nothing(tmp_path):
    plain, spaced = urdf(), urdf(attributes='xmlns="http://example.org/urdf"')
    first, second = (read_robot(written(tmp_path, text, "hand.urdf")) for text in (plain, spaced))
    assert first.joints[0].limits == second.joints[0].limits == (-1.0, 1.5)
    np.testing.assert_array_equal(inertias(first), inertias(second))


@pytest.mark.parametrize("name", ["package://b/meshes/my tip.stl", "file:{0}/b/meshes/my tip.stl"])
@pytest.mark.parametrize("spelt", [str, lambda name: name.replace(" ", "%20")])
def test_a_mesh_is_that_of_its_package(tmp_path, name, spelt):
    """The robot's own package has one of the same name, which was taken."""
    trimesh = pytest.importorskip("trimesh")
    for package, size in (("a", 0.01), ("b", 0.02)):
        (tmp_path / package / "meshes").mkdir(parents=True)
        trimesh.creation.box((size, size, size)).export(tmp_path / package / "meshes" / "my tip.stl")
    (tmp_path / "a" / "urdf").mkdir()
    mesh = f'<mesh filename="{spelt(name.format(tmp_path))}"/>'
    solid = f'<collision><geometry>{mesh}</geometry></collision></link><joint name="a"'
    path = written(tmp_path / "a" / "urdf", urdf().replace('</link><joint name="a"', solid), "hand.urdf")
    ((_, (corners, _)),) = read_robot(path, shapes_of={"two"}).links[-1].shapes
    np.testing.assert_allclose(np.ptp(corners, axis=0), 0.02, rtol=1e-6)
