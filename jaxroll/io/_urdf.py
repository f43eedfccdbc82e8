"""A URDF's text for MuJoCo's parser, and what that parser leaves unsaid.

MuJoCo takes a range with an end left out for none, where the format has that end at zero; it renames parts
that share a name, and passes over what it does not know. Here such files are completed or refused, by the
names in them. Joints that follow others and inertias are read here too: some versions of MuJoCo leave out the
former, and the turns of the latter's axes.
"""

import math
import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Mapping
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from .._results import shown

# Mass, centre and tensor about it, in the axes of a link.
Inertial = tuple[float, np.ndarray, np.ndarray]

# Parts of other programs, whose attributes no reader of a URDF knows.
_FOREIGN = ("gazebo", "transmission", "ros2_control", "mujoco")
_NAMES = ("name", "link", "joint", "filename")


class UnclearRobot(ValueError):
    """Why a file is none of a robot, in words that follow its name."""


def plain_urdf(
    root: ElementTree.Element, path: Path, held: Mapping[str, float], shapes_of: Collection[str]
) -> str:
    """The text of a URDF with ranges and files of meshes written out, without shapes that nobody asked for.

    Raises:
        UnclearRobot: If the file leaves open what robot it is.
    """
    for part in root.iter():
        if isinstance(part.tag, str):
            space, _, name = part.tag.rpartition("}")
            if "xacro" in space:
                raise UnclearRobot(f"it holds xacro:{name}, and has to be expanded by xacro before")
            part.tag = name
    for old in [part for part in root if part.tag in _FOREIGN]:
        root.remove(old)
    refuse_nan(root)
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    _check_names(root, joints)
    for name, joint in joints.items():
        if joint.get("type") in ("revolute", "prismatic") and name not in held:
            _complete_range(name, joint)
    for link in root.findall("link"):
        # Visual shapes count where there are no others, and only where shapes are asked for.
        drop = ["visual"] if link.findall("collision") else []
        if link.get("name") not in shapes_of:
            drop = ["visual", "collision"]
        for shape in [each for kind in drop for each in link.findall(kind)]:
            link.remove(shape)
    for mesh in root.iter("mesh"):
        mesh.set("filename", _mesh_file(path, mesh.get("filename", "")))
    settings = {"fusestatic": "false", "inertiafromgeom": "false", "strippath": "false"}
    settings |= {"discardvisual": "false"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", settings)
    return ElementTree.tostring(root, encoding="unicode")


def refuse_nan(root: ElementTree.Element) -> None:
    """Raise for an attribute with a NaN, which MuJoCo takes for one that is not given."""
    for part in root.iter():
        for name, value in part.attrib.items():
            if name not in _NAMES and "nan" in value.lower() and any(math.isnan(x) for x in _numbers(value)):
                raise UnclearRobot(f"its {part.tag} has {name}={shown(value)}")


def _numbers(text: str) -> list[float]:
    """The numbers of an attribute; none where it has words."""
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []


def _check_names(root: ElementTree.Element, joints: Mapping[str, ElementTree.Element]) -> None:
    """Raise where names are used twice, lead nowhere, or do not make one tree."""
    for kind in ("joint", "link"):
        names = [part.get("name", "") for part in root.findall(kind)]
        if not all(names):
            raise UnclearRobot(f"it has a {kind} without a name")
        if again := [name for i, name in enumerate(names) if name in names[:i]]:
            raise UnclearRobot(f"it has two {kind}s named {shown(again[0])}")
    for name, joint in joints.items():
        followed = joint.find("mimic")
        if followed is not None and followed.get("joint") not in joints:
            raise UnclearRobot(
                f"joint {shown(name)} follows {shown(followed.get('joint'))}, which it has not"
            )
    moved = {child.get("link") for joint in joints.values() for child in joint.findall("child")}
    roots = [link.get("name", "") for link in root.findall("link") if link.get("name") not in moved]
    if len(roots) > 1:
        raise UnclearRobot(f"no joint carries its links {shown(roots[0])} and {shown(roots[1])}")


def _complete_range(name: str, joint: ElementTree.Element) -> None:
    """Write the ends of a joint's range that are left out, which the format has as zero."""
    limit = joint.find("limit")
    if limit is None:
        limit = ElementTree.SubElement(joint, "limit")
    low, high = limit.get("lower", "0"), limit.get("upper", "0")
    ends = [*_numbers(low), *_numbers(high)]
    if len(ends) == 2 and not ends[0] < ends[1]:
        raise UnclearRobot(
            f"the range of joint {shown(name)} is from {low} to {high}; `held` may fix it, and one without "
            f"limits is of type continuous"
        )
    limit.set("lower", low)
    limit.set("upper", high)


def followers(root: ElementTree.Element) -> tuple[str, ...]:
    """Joints whose angle another one's gives."""
    return tuple(joint.get("name", "") for joint in root.findall("joint") if joint.find("mimic") is not None)


def stated_inertias(root: ElementTree.Element) -> dict[str, Inertial]:
    """Mass, centre and tensor of each link of a file that MuJoCo has read; zero without `inertial`."""
    return {link.get("name", ""): _stated(link.find("inertial")) for link in root.findall("link")}


def _stated(inertial: ElementTree.Element | None) -> Inertial:
    if inertial is None:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    part = lambda name: getattr(inertial.find(name), "attrib", {})  # noqa: E731
    place, six = part("origin"), {name: float(value) for name, value in part("inertia").items()}
    centre, (r, p, y) = (np.array(_numbers(place.get(name, "")) or [0.0] * 3) for name in ("xyz", "rpy"))
    about = lambda i, a: np.roll(np.roll(_turn(a), i, 0), i, 1)  # noqa: E731
    turn = about(2, y) @ about(1, p) @ about(0, r)
    xy, xz, yz = (six.get(name, 0.0) for name in ("ixy", "ixz", "iyz"))
    tensor = np.array([[six["ixx"], xy, xz], [xy, six["iyy"], yz], [xz, yz, six["izz"]]])
    return float(part("mass")["value"]), centre, turn @ tensor @ turn.T


def _turn(angle: float) -> np.ndarray:
    """A rotation about the first axis."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _mesh_file(path: Path, name: str) -> str:
    """Where a mesh lies: beside the file, in the package that is named, or below a folder above the file.

    The package's own folder goes before all others: two packages may well have a 'meshes/tip.stl' each.
    """
    name = name.removeprefix("file://").removeprefix("file:")
    package, _, rest = name.removeprefix("package://").partition("/")
    tries = [name] if "://" not in name else [f"{package}/{rest}", rest]
    folders = [path.resolve().parent, *path.resolve().parents]
    places = [folder / way(each) for way in (str, unquote) for each in tries for folder in folders]
    found = next((str(place) for place in places if place.is_file()), None)
    return found or os.path.join(path.resolve().parent, tries[-1])
