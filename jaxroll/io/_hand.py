r"""Real hands: fingers from a URDF or MJCF file.

`_robot_file` gives links and joints with all joints at zero, in world axes. A `Finger3` wants just that:
axes of joints, offsets from joint to joint, centres and inertias, in the axes that all its links share at
zero. These are chosen as the axes of the tip's link, so that the finger's tip frame is that link's frame, in
every pose. Links that no moving joint parts are one body: masses add up, and inertias about the common centre
of mass (Steiner), $I = \sum_k I_k + m_k (d_k^2 1 - d_k d_k^T)$.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._linalg import conjugate, quaternion_product, rotation as axes_of
from .._mechanics import Finger3
from .._printing import listed
from .._results import as_floats, as_positive, check_direction, check_instance, on_host, shown
from .._types import Given
from ..geometry import AbstractSurface, Ellipsoid, fit_surface, Sphere, SurfaceReport
from ._mesh import spread_points
from ._robot_file import read_robot, Robot, RobotJoint, RobotLink

# What stands for no mass and no inertia, which `Finger3` refuses: [kg], [kg m^2], and of the largest moment.
_NOTHING, _SHARE = 1e-30, 1e-14
_SPREAD = 6000  # points over a tip's mesh

Tips = AbstractSurface | Mapping[str, AbstractSurface] | Literal["mesh"]


class _Wish(NamedTuple):
    """What is asked of the fit to a tip's mesh [m]: one of the two, or neither."""

    smoothing: float | None
    smallest_radius: float | None


class Hand(eqx.Module):
    """The fingers of a hand, and what its file says of their joints beside: finger by finger, joint by joint.

    Limits, damping, friction and springs are no part of the fingers, whose own `limits` are None: a
    controller, an event or a designer may use them.

    Attributes:
        fingers: Each with its tip's surface, in the frame of its tip's link.
        tips: Name of each finger's tip link.
        joints: Names of each finger's joints, from the palm to the tip.
        limits: Of each finger, shape (k, 2): smallest and largest angle [rad]; infinite without a limit.
        torques: Likewise of the joint torques [N m].
        damping: Of each finger, shape (k,): damping of its joints [N m s].
        friction: Likewise the torque of dry friction [N m].
        stiffness: Likewise of springs at the joints [N m/rad].
        rest: Likewise the angles at which these springs are relaxed [rad].
        left_out: What the file says of the hand's motion besides, such as springs of tendons; nothing mostly.
    """

    __repr__ = listed

    fingers: tuple[Finger3, ...]
    tips: tuple[str, ...] = eqx.field(static=True)
    joints: tuple[tuple[str, ...], ...] = eqx.field(static=True)
    limits: tuple[Float[Array, "k 2"], ...]
    torques: tuple[Float[Array, "k 2"], ...]
    damping: tuple[Float[Array, " k"], ...]
    friction: tuple[Float[Array, " k"], ...]
    stiffness: tuple[Float[Array, " k"], ...]
    rest: tuple[Float[Array, " k"], ...]
    left_out: tuple[str, ...] = eqx.field(static=True)


@on_host
def load_hand(
    path: str | Path,
    tips: Tips,
    *,
    held: Mapping[str, float] | None = None,
    position: Given = (0.0, 0.0, 0.0),
    rotation: Given = (1.0, 0.0, 0.0, 0.0),
    smoothing: float | None = None,
    smallest_radius: float | None = None,
) -> Hand:
    """A hand from a URDF or MJCF file: fingers as `Finger3`, with the tips that are given.

    Every chain of revolute joints from the palm to a last link is a finger. The palm is what no joint moves,
    and is fixed in the world. Links that fixed joints join are one body. The tip's frame is that of the last
    link: of one that is fixed to the last link that moves, such as 'fingertip', if there is just one.

    Joints and links without a name are called as 'joint0' and 'link2', by their places in the file. What a
    URDF holds for other programs (`gazebo`, `transmission`, `ros2_control`) is not read.

    Args:
        path: A file that ends in .urdf, .xml or .mjcf.
        tips: A surface for every finger, about the origin of its tip's frame; or a dict of surfaces by the
            names of tip links, which leaves out the fingers it does not name; or 'mesh': the tip link's own
            shape, a ball or an ellipsoid as it is, a mesh as `geometry.fit_surface` fits it.
        held: Joints that do not move, by name, and at which angle [rad] (a sliding joint [m]): those of a
            wrist, one that follows another.
        position: Shape (3,), where the file's origin is in the world [m].
        rotation: Quaternion (scalar first) that turns the file's axes into the world's.
        smoothing: With 'mesh', the wavelength [m] of wiggles that are halved (see `geometry.fit_surface`).
            Default: as that chooses.
        smallest_radius: With 'mesh', the smallest radius of curvature [m] of the fit: edges of the mesh are
            rounded off by it and open sides closed. Wanted for meshes of flat faces and sharp edges, which
            are refused without; a finely divided mesh of a smooth tip needs none. Not with `smoothing`.

    Returns:
        A `Hand`: its fingers, ranges, torques, damping, friction and springs of their joints, and what else
        the file says of its motion.

    Raises:
        ValueError: If the file cannot be read; a joint that is not held slides, has more than one axis,
            carries two others, is tied to another or has no range that it could move in; a joint is held out
            of its range; a last link has no inertia; a tip cannot be told; or its mesh is none of a body that
            has such a radius, or has sharp edges without one.
        ImportError: Without the extra `hands`.

    Accuracy: mass matrices, biases and poses agree with MuJoCo's and Pinocchio's to 1e-14 of their size.

    Example:
        >>> import jaxroll as jxr
        >>> text = '''<mujoco><worldbody><body name="finger">
        ...   <joint name="knuckle" axis="1 0 0" range="-60 90"/>
        ...   <inertial mass="0.04" pos="0 0 0.03" diaginertia="1e-5 1e-5 1e-6"/>
        ... </body></worldbody></mujoco>'''
        >>> with open("one.xml", "w") as file:
        ...     _ = file.write(text)
        >>> hand = jxr.io.load_hand("one.xml", jxr.Sphere(0.01).moved((0.0, 0.0, 0.06)))
        >>> hand.joints, hand.limits[0].round(3).tolist()
        ((('knuckle',),), [[-1.047, 1.571]])
    """
    place = as_floats("position", position, (3,))
    turn = check_direction("rotation", as_floats("rotation", rotation, (4,)))
    given = _as_tips(tips)
    wish = _as_wish(smoothing, smallest_radius)
    still = _as_held(held)
    robot = read_robot(path, held=still)
    chains = _chains(robot)
    chosen = {link: chain for chain in chains if (link := _tip_link(robot, chain, given)) is not None}
    if isinstance(given, Mapping) and (unknown := set(given) - {robot.links[i].name for i in chosen}):
        raise ValueError(
            f"argument tips must name tip links of fingers, one for each, but named {shown(min(unknown))}"
        )
    surfaces = _surfaces(robot, chosen, given)
    if surfaces is None:
        bodies = [_last_body(robot, i) for i in chosen]
        wanted = {robot.links[j].name for body in bodies for j in body}
        links = read_robot(path, held=still, shapes_of=wanted).links
        surfaces = [_own_surface([links[j] for j in body], wish) for body in bodies]
    fingers = [
        _finger(robot, chain, link, surface, (place, turn))
        for (link, chain), surface in zip(chosen.items(), surfaces, strict=True)
    ]
    each = [[robot.joints[i] for i in chain] for chain in chosen.values()]
    of = lambda name: tuple(jnp.asarray([getattr(j, name) for j in joints]) for joints in each)  # noqa: E731
    return Hand(
        tuple(fingers),
        tuple(robot.links[i].name for i in chosen),
        tuple(tuple(joint.name for joint in joints) for joints in each),
        *(of(name) for name in ("limits", "torques", "damping", "friction", "stiffness", "rest")),
        left_out=robot.left_out,
    )


def _as_tips(tips: Any) -> Tips:
    if isinstance(tips, Mapping):
        for name, surface in tips.items():
            check_instance(f"tips[{shown(name)}]", surface, AbstractSurface, "a surface")
        if not tips:
            raise ValueError("argument tips must name one tip link or more, but named none")
        return dict(tips)
    if isinstance(tips, str) and tips == "mesh":
        return "mesh"
    return check_instance("tips", tips, AbstractSurface, "a surface, a dict of surfaces or 'mesh'")


def _as_wish(smoothing: Any, smallest_radius: Any) -> _Wish:
    """How meshes are to be fitted."""
    found = [
        None if value is None else float(as_positive(name, value))
        for name, value in (("smoothing", smoothing), ("smallest_radius", smallest_radius))
    ]
    if None not in found:
        raise ValueError(
            f"argument smoothing must be left out with smallest_radius, but was {shown(smoothing)}"
        )
    return _Wish(*found)


def _as_held(held: Any) -> dict[str, float]:
    if held is None:
        return {}
    if not isinstance(held, Mapping) or not all(isinstance(name, str) for name in held):
        raise ValueError(f"argument held must be a dict of names and angles, but was {shown(held)}")
    return {name: float(as_floats(f"held[{name!r}]", angle, ())) for name, angle in held.items()}


def _chains(robot: Robot) -> list[list[int]]:
    """Joints of every finger, from the palm to the tip."""
    moving = {joint.name for joint in robot.joints}
    tied = [*(name for name in robot.followers if name in moving), *robot.loops]
    if tied:
        raise ValueError(
            f"argument path must name a hand whose joints are independent, but {shown(tied[0])} is tied "
            f"to another part; `held` may fix a joint"
        )
    chains: dict[int | None, list[int]] = {}
    for i, joint in enumerate(robot.joints):
        if joint.kind != "hinge":
            raise ValueError(
                f"argument path must name a hand of revolute joints, but {shown(joint.name)} is a "
                f"{joint.kind} joint; `held` may fix one that slides"
            )
        if joint.before is not None and joint.before not in chains:
            branching = robot.joints[joint.before].name
            raise ValueError(
                f"argument path must name a hand of serial fingers, but {shown(branching)} carries two "
                f"joints or more; `held` may fix it"
            )
        chains[i] = [*([] if joint.before is None else chains.pop(joint.before)), i]
    if not chains:
        raise ValueError("argument path must name a hand with joints that move, but its file has none")
    return list(chains.values())


def _tip_link(robot: Robot, chain: Sequence[int], tips: Tips) -> int | None:
    """The link whose frame is the finger's tip frame; None for a finger that a dict leaves out."""
    last = [i for i, link in enumerate(robot.links) if link.carrier == chain[-1]]
    if isinstance(tips, Mapping):
        named = [i for i in last if robot.links[i].name in tips]
        if len(named) > 1:
            raise ValueError(
                f"argument tips must name one link of each finger, but named two, the second "
                f"{shown(robot.links[named[1]].name)}"
            )
        return named[0] if named else None
    ends = [i for i in last if not any(robot.links[j].parent == i for j in last if j != i)]
    if len(ends) > 1:
        raise ValueError(
            f"argument tips must be a dict that names the tip links, but was not, and joint "
            f"{shown(robot.joints[chain[-1]].name)} moves {len(ends)} that may be one"
        )
    return ends[0]


def _surfaces(robot: Robot, chosen: Mapping[int, Any], tips: Tips) -> list[AbstractSurface] | None:
    """The surface that is given for each finger's tip; None where the file has them."""
    if isinstance(tips, Mapping):
        return [tips[robot.links[i].name] for i in chosen]
    return [tips] * len(chosen) if isinstance(tips, AbstractSurface) else None


def _last_body(robot: Robot, tip: int) -> list[int]:
    """The tip's link, then those that it is fixed to, up to the one that the last joint moves."""
    body, parent = [tip], robot.links[tip].parent
    while robot.links[parent].carrier == robot.links[tip].carrier:
        body.append(parent)
        parent = robot.links[parent].parent
    return body


def _own_surface(body: Sequence[RobotLink], wish: _Wish) -> AbstractSurface:
    """The shape that a tip has in its file, in the frame of its link: of the first link that has any."""
    tip = body[0]
    link = next((link for link in body if link.shapes), tip)
    meshes = [shape for shape in link.shapes if shape[0] == "mesh"] or list(link.shapes)
    if len(meshes) != 1:
        raise ValueError(
            f"argument tips must be surfaces where a tip link has not one mesh, ball or ellipsoid, "
            f"but {shown(link.name)} has {len(meshes)}"
        )
    kind, arrays = meshes[0]
    if kind == "mesh":
        corners, faces = arrays
        surface: AbstractSurface = _fitted(link, corners, faces, wish)
    else:
        half, centre, quaternion = arrays
        a, b, c = (float(x) for x in half)
        surface = (Sphere(a) if kind == "ball" else Ellipsoid(a, b, c)).moved(centre, quaternion)
    if link is tip:
        return surface
    apart = (link.origin - tip.origin) @ _matrix(tip.quaternion)
    back = conjugate(_numbers(tip.quaternion))
    return surface.moved(apart, quaternion_product(back, _numbers(link.quaternion)))


def _fitted(link: RobotLink, corners: np.ndarray, faces: np.ndarray, wish: _Wish) -> AbstractSurface:
    """The smooth surface of a tip's mesh.

    Raises:
        ValueError: If there is none such, with the link's name.
    """
    if wish.smallest_radius is None:
        points, normals = spread_points(corners, faces, _SPREAD)
        fit = fit_surface(points, normals, smoothing=wish.smoothing)
        _check_smooth(link, fit.report, wish)
        return fit.surface
    try:
        return fit_surface(corners, faces=faces, smallest_radius=wish.smallest_radius).surface
    except ValueError as error:
        raise ValueError(f"{error} (tip {shown(link.name)})") from None


def _check_smooth(link: RobotLink, report: SurfaceReport, wish: _Wish) -> None:
    """Raise for the fit to a mesh of flat faces and sharp edges, which no wavelength of its own follows.

    Who chose a wavelength may have rounded off its corners by that: then only bends that are sharper than it
    count.
    """
    sharpest = max(-report.curvature[0], report.curvature[1])
    bent = sharpest * report.smoothing > 2.0 * np.pi
    if report.doubts and (wish.smoothing is None or bent):
        raise ValueError(
            f"argument smallest_radius must be given for a mesh with sharp edges or coarse faces, as that of "
            f"tip {shown(link.name)}, but was None: the surface fitted to it is not to be trusted, as "
            f"{' and '.join(report.doubts)}"
        )


def _finger(
    robot: Robot, chain: Sequence[int], tip: int, surface: AbstractSurface, placed: tuple[Array, Array]
) -> Finger3:
    """One finger, in the axes of its tip's link at zero."""
    joints = [robot.joints[i] for i in chain]
    link = robot.links[tip]
    turn = _matrix(link.quaternion)
    anchors = np.array([*(joint.anchor for joint in joints), link.origin])
    merged = [_merged(robot, i) for i in chain]
    for joint, (mass, _, inertia) in zip(joints, merged, strict=True):
        _check_inertia(joint, mass, inertia)
    _check_last(joints[-1], *merged[-1])
    place, rotation = placed
    inertias = np.array([turn.T @ _definite(inertia) @ turn for _, _, inertia in merged])
    armature = np.array([joint.armature for joint in joints])
    world = _matrix(np.asarray(rotation / jnp.linalg.norm(rotation)))
    return Finger3(
        [joint.axis @ turn for joint in joints],
        np.diff(anchors, axis=0) @ turn,
        [max(mass, _NOTHING) for mass, _, _ in merged],
        surface,
        base=np.asarray(place) + world @ anchors[0],
        rotation=quaternion_product(_numbers(rotation), _numbers(link.quaternion)),
        centres=np.array([centre for _, centre, _ in merged] - anchors[:-1]) @ turn,
        inertias=0.5 * (inertias + inertias.swapaxes(1, 2)),
        armature=armature if armature.any() else None,
    )


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    """Its columns are the axes that a unit quaternion turns the world's into."""
    return np.array([[float(c) for c in axis] for axis in axes_of(_numbers(quaternion))]).T


def _numbers(quaternion: Any) -> tuple[float, float, float, float]:
    w, x, y, z = (float(c) for c in quaternion)
    return w, x, y, z


def _merged(robot: Robot, carrier: int) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre and inertia of all links that one joint carries, as one body."""
    links = [link for link in robot.links if link.carrier == carrier]
    mass, inertia = sum(link.mass for link in links), np.zeros((3, 3))
    # Links without mass may have inertia all the same; where their centre is does not matter.
    centre = robot.joints[carrier].anchor
    if mass > 0.0:
        centre = np.sum([link.mass * link.centre for link in links], axis=0) / mass
    for link in links:
        d = link.centre - centre
        inertia += link.inertia + link.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, centre, inertia


def _check_inertia(joint: RobotJoint, mass: float, inertia: np.ndarray) -> None:
    """Raise for a mass or a moment below zero."""
    moments = np.linalg.eigvalsh(0.5 * (inertia + inertia.T))
    if not np.isfinite(mass) or not mass >= 0.0 or not moments[0] >= -1e-9 * abs(moments[-1]):
        raise ValueError(
            f"argument path must name a hand of positive masses and inertias, but what joint "
            f"{shown(joint.name)} moves has {mass:g} kg and moments {shown(moments)}"
        )


def _check_last(joint: RobotJoint, mass: float, centre: np.ndarray, inertia: np.ndarray) -> None:
    """Raise where a finger's last joint would move nothing: its mass matrix would be singular."""
    arm = np.cross(joint.axis, centre - joint.anchor)
    if not joint.axis @ inertia @ joint.axis + mass * arm @ arm + joint.armature > _NOTHING:
        raise ValueError(
            f"argument path must name a hand whose last links have inertia, but joint {shown(joint.name)} "
            f"moves none"
        )


def _definite(inertia: np.ndarray) -> np.ndarray:
    """An inertia with moments that are positive beyond rounding, as those of rods and points are not."""
    inertia = 0.5 * (inertia + inertia.T)
    moments = np.linalg.eigvalsh(inertia)
    least = _NOTHING + _SHARE * moments[-1]
    return inertia if moments[0] > least else inertia + 2.0 * least * np.eye(3)
