"""Robots in URDF and MJCF files, read by MuJoCo's compiler. No other file imports mujoco.

MuJoCo parses either format; what it is asked for is the tree of links and joints with all joints at zero, in
world axes. Explicit masses and inertias are taken as the file states them, before MuJoCo makes principal axes
of them: it refuses tensors that no real body has, and files of public hands hold some.

In URDF a link without `<inertial>` has no mass, whatever its collision shapes; in MJCF its mass comes from
its shapes, as the format has it.
"""

import contextlib
import os
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._results import shown
from ._extra import missing
from ._motors import bounds, joint_torques, left_out, rotors
from ._paths import as_path, readable
from ._urdf import followers, Inertial, plain_urdf, refuse_nan, stated_inertias, UnclearRobot

_KINDS = (".urdf", ".xml", ".mjcf")


@dataclass(frozen=True)
class RobotJoint:
    """A joint of a robot, at zero of all joints that move.

    Attributes:
        name: In the file.
        kind: 'hinge', 'slide', 'ball' or 'free'.
        link: Which link it moves, counted as in `Robot`.
        before: The joint that carries it, None for one on the base.
        anchor: Shape (3,), a point of its axis, in world axes [m].
        axis: Shape (3,), in world axes.
        limits: Smallest and largest angle [rad], infinite where there is no limit.
        torques: Smallest and largest torque [N m], likewise.
        damping: [N m s], that of its motors too.
        friction: Torque of dry friction [N m].
        stiffness: Of a spring at the joint [N m/rad].
        rest: Angle at which that spring is relaxed [rad].
        armature: Inertia of the rotor, as the joint feels it [kg m^2].
    """

    name: str
    kind: str
    link: int
    before: int | None
    anchor: np.ndarray
    axis: np.ndarray
    limits: tuple[float, float]
    torques: tuple[float, float]
    damping: float
    friction: float
    stiffness: float
    rest: float
    armature: float


@dataclass(frozen=True)
class RobotLink:
    """A link of a robot, at zero of all joints that move; in world axes.

    Attributes:
        name: In the file.
        parent: Which link it is fixed to, or joined to; itself for the base.
        carrier: The last joint on the way to it that moves, None for what is fixed to the base.
        origin: Shape (3,), of its frame [m].
        quaternion: Shape (4,), scalar first, of its frame's axes.
        mass: Its own [kg].
        centre: Shape (3,), its own centre of mass [m].
        inertia: Shape (3, 3), its own, about that centre [kg m^2].
        shapes: What it carries, by kind: a mesh as corners and triangles in the link's axes, a sphere or an
            ellipsoid as half axes, centre and quaternion in the link's axes.
    """

    name: str
    parent: int
    carrier: int | None
    origin: np.ndarray
    quaternion: np.ndarray
    mass: float
    centre: np.ndarray
    inertia: np.ndarray
    shapes: tuple[tuple[str, tuple[np.ndarray, ...]], ...]


@dataclass(frozen=True)
class Robot:
    """A tree of links, and what its file says besides.

    Attributes:
        links: The world first, then from the base outwards.
        joints: Those that move, from the base outwards.
        followers: Joints whose angle another one's gives, held or not.
        loops: Names of what closes a loop: two links that a file ties to each other, or two tendons.
        left_out: What the file says of its motion besides, one by one.
    """

    links: tuple[RobotLink, ...]
    joints: tuple[RobotJoint, ...]
    followers: tuple[str, ...]
    loops: tuple[str, ...]
    left_out: tuple[str, ...]


def _mujoco() -> Any:
    """The library mujoco, imported with the first use."""
    try:
        import mujoco
    except ImportError:
        raise missing("mujoco", "hands") from None
    return mujoco


def read_robot(
    path: str | Path, *, held: Mapping[str, float] | None = None, shapes_of: Collection[str] = ()
) -> Robot:
    """The tree of links and joints in a URDF or MJCF file.

    Args:
        path: A file that ends in .urdf, .xml or .mjcf.
        held: Joints that do not move, and where each is held [rad or m].
        shapes_of: Links whose meshes and balls are wanted; meshes of others are not read.

    Raises:
        ValueError: If the file cannot be read, or there is no such joint to be held.
        ImportError: Without the extra `hands`.
    """
    path, mujoco = readable(as_path(path, _KINDS), "a robot"), _mujoco()
    with _warning(mujoco, path):
        return _read(mujoco, path, dict(held or {}), shapes_of)


@contextlib.contextmanager
def _warning(mujoco: Any, path: Path) -> Iterator[None]:
    """MuJoCo's warnings as those of Python: by itself it writes them to a file in the working folder."""
    said: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
    for each in dict.fromkeys(said):
        warnings.warn(f"{path.name}: {each}", stacklevel=5)


def _read(mujoco: Any, path: Path, held: dict[str, float], shapes_of: Collection[str]) -> Robot:
    """The robot in a file."""
    try:
        spec, root = _parsed(mujoco, path, held, shapes_of)
        own = _own_inertias(mujoco, spec, None if root is None else stated_inertias(root))
        ties = [(e.type == mujoco.mjtEq.mjEQ_JOINT, e.name1) for e in spec.equalities if e.active]
        ties += [] if root is None else [(True, name) for name in followers(root)]
        _lighten(mujoco, spec, shapes_of)
        model = spec.compile()
    except UnclearRobot as error:
        raise ValueError(f"argument path must name a robot, but {path.name}: {error}") from None
    except (ValueError, ElementTree.ParseError) as error:
        said = str(error).replace(f"{path.resolve().parent}{os.sep}", "").splitlines()[0]
        raise ValueError(f"argument path must name a robot, but {path.name}: {shown(said)}") from None
    known = {model.joint(i).name: i for i in range(model.njnt)}
    if unknown := [name for name in held if name not in known]:
        raise ValueError(f"argument held must name joints of the file, but named {shown(unknown[0])}")
    for name, angle in held.items():
        _check_held(name, angle, _range(model, known[name]))
    data = mujoco.MjData(model)
    # Zero of every hinge and slide, but for those that are held; where a file measures a joint's angle from
    # elsewhere than its drawing (`ref`), this is not the drawing. Orientations stay as drawn.
    for name, i in known.items():
        if _kind(mujoco, model, i) in ("hinge", "slide"):
            data.qpos[model.jnt_qposadr[i]] = held.get(name, 0.0)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    moving = [i for name, i in known.items() if name not in held]
    joints, carriers = _joints(mujoco, model, data, moving)
    links = tuple(
        _link(mujoco, model, data, i, own.get(model.body(i).name), carriers[i], shapes_of)
        for i in range(model.nbody)
    )
    tied = tuple(dict.fromkeys(name for of_joint, name in ties if of_joint))
    _check_finite(path, links, joints)
    loops = tuple(name for of_joint, name in ties if not of_joint)
    return Robot(links, joints, tied, loops, left_out(mujoco, model, moving))


def _parsed(
    mujoco: Any, path: Path, held: Mapping[str, float], shapes_of: Collection[str]
) -> tuple[Any, ElementTree.Element | None]:
    """MuJoCo's description of the file, and what is in that if it is a URDF."""
    root = ElementTree.parse(path).getroot()
    described = root.tag.rpartition("}")[2] == "robot"
    if described:
        spec = mujoco.MjSpec.from_string(plain_urdf(root, path, held, shapes_of))
    else:
        refuse_nan(root)
        spec = mujoco.MjSpec.from_file(str(path))
        # Links that MuJoCo would make one body keep the inertias and names that the file gives them.
        spec.compiler.fusestatic = False
    for kind, parts in (("joint", spec.joints), ("link", spec.bodies)):
        taken = {part.name for part in parts}
        for i, part in enumerate(parts):
            if not part.name:
                names = (f"{kind}{i}{more}" for more in ("", *(f"_{k}" for k in range(len(parts)))))
                part.name = next(name for name in names if name not in taken)
    return spec, root if described else None


def _own_inertias(mujoco: Any, spec: Any, stated: Mapping[str, Inertial] | None) -> dict[str, Inertial]:
    """By link: mass, centre and tensor in the link's axes, where the file itself states them.

    Links whose inertia follows from their shapes are left out. Those that state one are given a ball's
    inertia in the description for MuJoCo, which thus neither checks nor changes their own. `stated` has what
    a URDF says; for an MJCF, where it is None, the description says it.
    """
    settings = spec.compiler
    changed = (settings.boundmass, settings.boundinertia, settings.balanceinertia, _damped(spec))
    if _inferred(mujoco, spec) or any(changed) or settings.settotalmass > 0.0:
        return {}  # as MuJoCo compiles them
    found, nothing = {}, (0.0, np.zeros(3), np.zeros((3, 3)))
    for body in spec.bodies:
        if body.name == "world" or not (body.explicitinertial or stated is not None):
            continue
        found[body.name] = _inertial(mujoco, spec, body) if stated is None else stated.get(body.name, nothing)
        body.explicitinertial, body.mass, body.inertia = True, 1.0, np.ones(3)
        body.ipos, body.iquat, body.fullinertia = np.zeros(3), (1.0, 0.0, 0.0, 0.0), (np.nan, *[0.0] * 5)
        body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    return found


def _inferred(mujoco: Any, spec: Any) -> bool:
    """Whether shapes give the inertia of links that state one, too."""
    return spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE


def _damped(spec: Any) -> bool:
    """Whether a joint has its spring and damping from its inertia, as MuJoCo works it out."""
    return any(np.any(np.asarray(joint.springdamper) > 0.0) for joint in spec.joints)


def _inertial(mujoco: Any, spec: Any, body: Any) -> Inertial:
    quaternion = np.array(body.iquat, float)
    if body.ialt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT:
        settings = spec.compiler
        found = spec.resolve_orientation(
            degree=settings.degree, sequence=settings.eulerseq, orientation=body.ialt
        )
        quaternion = np.array(found, float)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, quaternion / np.linalg.norm(quaternion))
    turn = turn.reshape(3, 3)
    tensor = np.diag(np.array(body.inertia, float))
    if not np.isnan(body.fullinertia[0]):
        xx, yy, zz, xy, xz, yz = body.fullinertia
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return float(body.mass), np.array(body.ipos, float), turn @ tensor @ turn.T


def _lighten(mujoco: Any, spec: Any, shapes_of: Collection[str]) -> None:
    """Leave out what a tree of links does not need: files of meshes, images, contacts, sensors."""
    heavy = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)
    stated = not _inferred(mujoco, spec)
    for geom in spec.geoms:
        geom.material = ""
        # Where the link states its inertia, a ball may stand for a mesh.
        if (
            geom.type in heavy
            and stated
            and geom.parent.explicitinertial
            and geom.parent.name not in shapes_of
        ):
            geom.type, geom.meshname, geom.hfieldname = mujoco.mjtGeom.mjGEOM_SPHERE, "", ""
            geom.size = np.full(3, 1e-3)
    for each in (*spec.sites, *spec.tendons):
        each.material = ""
    used = {geom.meshname for geom in spec.geoms}
    for each in (*spec.keys, *spec.sensors, *spec.pairs, *spec.excludes, *spec.equalities, *spec.skins):
        spec.delete(each)
    for each in (*spec.materials, *spec.textures, *(m for m in spec.meshes if m.name not in used)):
        spec.delete(each)


def _kind(mujoco: Any, model: Any, joint: int) -> str:
    return mujoco.mjtJoint(model.jnt_type[joint]).name.removeprefix("mjJNT_").lower()


def _range(model: Any, joint: int) -> tuple[float, float]:
    """Smallest and largest angle of a joint."""
    return bounds(model.jnt_range[joint], model.jnt_limited[joint])


def _check_held(name: str, angle: float, limits: tuple[float, float]) -> None:
    """Raise for a joint that is held out of its range, as by an angle in degrees."""
    low, high = limits
    beyond = 1e-6 * (high - low) if np.isfinite(high - low) else 0.0
    if not low - beyond <= angle <= high + beyond:
        raise ValueError(
            f"argument held[{shown(name)}] must be in the joint's range, {low:g} to {high:g}, but was "
            f"{shown(angle)}"
        )


def _check_finite(path: Path, links: Sequence[RobotLink], joints: Sequence[RobotJoint]) -> None:
    """Raise where a number of a link or a joint is none."""
    for each in (*links, *joints):
        numbers = [value for name, value in vars(each).items() if name not in ("limits", "torques", "shapes")]
        if not all(np.all(np.isfinite(x)) for x in numbers if isinstance(x, float | np.ndarray)):
            raise ValueError(
                f"argument path must name a robot of finite numbers, but {path.name} has others at "
                f"{shown(each.name)}"
            )


def _joints(
    mujoco: Any, model: Any, data: Any, moving: list[int]
) -> tuple[tuple[RobotJoint, ...], list[int | None]]:
    """Joints that move, from the base outwards, and the last one on the way to each body."""
    joints, carriers = [], []
    for body in range(model.nbody):
        carrier = carriers[model.body_parentid[body]] if body else None
        first = model.body_jntadr[body]
        for i in range(first, first + model.body_jntnum[body]):
            if i not in moving:
                continue
            dof = model.jnt_dofadr[i]
            rotor, brake = rotors(mujoco, model, i)
            joints.append(
                RobotJoint(
                    name=model.joint(i).name,
                    kind=_kind(mujoco, model, i),
                    link=body,
                    before=carrier,
                    anchor=data.xanchor[i].copy(),
                    axis=data.xaxis[i].copy(),
                    limits=_range(model, i),
                    torques=joint_torques(mujoco, model, i),
                    damping=_number(model.dof_damping[dof]) + brake,
                    friction=float(model.dof_frictionloss[dof]),
                    stiffness=_number(model.jnt_stiffness[i]),
                    rest=float(model.qpos_spring[model.jnt_qposadr[i]]),
                    armature=float(model.dof_armature[dof]) + rotor,
                )
            )
            carrier = len(joints) - 1
        carriers.append(carrier)
    return tuple(joints), carriers


def _number(value: Any) -> float:
    """The first of a polynomial's coefficients, or the one number there is."""
    return float(np.ravel(value)[0])


def _link(
    mujoco: Any,
    model: Any,
    data: Any,
    body: int,
    own: Inertial | None,
    carrier: int | None,
    shapes_of: Collection[str],
) -> RobotLink:
    turn, origin = data.xmat[body].reshape(3, 3).copy(), data.xpos[body].copy()
    if own is None:
        axes = data.ximat[body].reshape(3, 3)
        mass, centre = float(model.body_mass[body]), data.xipos[body].copy()
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
    else:
        mass, centre, inertia = own[0], origin + turn @ own[1], turn @ own[2] @ turn.T
    name, shapes = model.body(body).name, ()
    if name in shapes_of:
        first = model.body_geomadr[body]
        every = range(first, first + model.body_geomnum[body])
        # What touches, where anything does: the rest is for pictures.
        touching = [i for i in every if model.geom_contype[i] or model.geom_conaffinity[i]]
        each = (_shape(mujoco, model, i) for i in touching or every)
        shapes = tuple(shape for shape in each if shape is not None)
    parent, quaternion = int(model.body_parentid[body]), data.xquat[body].copy()
    return RobotLink(name, parent, carrier, origin, quaternion, mass, centre, inertia, shapes)


def _shape(mujoco: Any, model: Any, geom: int) -> tuple[str, tuple[np.ndarray, ...]] | None:
    """One shape of a link in the link's axes; None of a kind that has no smooth closed surface."""
    turn, size = np.zeros(9), model.geom_size[geom]
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    place = model.geom_pos[geom].copy()
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        corners = place + model.mesh_vert[start : start + count].astype(float) @ turn.reshape(3, 3).T
        start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        return "mesh", (corners, model.mesh_face[start : start + count].copy())
    if kind not in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        return None
    ball = kind == mujoco.mjtGeom.mjGEOM_SPHERE
    half = np.full(3, size[0]) if ball else size.copy()
    return "ball" if ball else "ellipsoid", (half, place, model.geom_quat[geom].copy())
