"""A stand-in for a spatial grasp: two balls roll on an ellipsoid that is moved about."""

from types import SimpleNamespace

import numpy as np

from jaxroll import geometry
from jaxroll.plotting._motion3 import matrices, Motion3D

AXES = np.array([0.030, 0.022, 0.018])
RADII = (0.012, 0.010)


def quaternion_product(left, right):
    """Hamilton's product of quaternions, scalar first."""
    a, u, b, v = left[..., :1], left[..., 1:], right[..., :1], right[..., 1:]
    dot = np.sum(u * v, axis=-1, keepdims=True)
    return np.concatenate([a * b - dot, a * v + b * u + np.cross(u, v)], axis=-1)


def quaternion_about(axis, angle):
    """Quaternions about a unit axis."""
    half = 0.5 * np.asarray(angle)[..., None]
    return np.concatenate([np.cos(half), np.sin(half) * np.asarray(axis)], axis=-1)


def ellipsoid_points(azimuth, latitude):
    """Points and outward normals."""
    ring = np.cos(latitude)
    unit = np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), np.sin(latitude)], axis=-1)
    normal = unit / AXES
    return AXES * unit, normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def rolled_orientations(radius, centres, normals):
    """Orientations of a ball that rolls: each small step turns it about the axis across the path."""
    found = [np.array([1.0, 0.0, 0.0, 0.0])]
    for step, normal in zip(np.diff(centres, axis=0), 0.5 * (normals[1:] + normals[:-1]), strict=True):
        spin = np.cross(normal, step) / radius
        size = np.linalg.norm(spin)
        found.append(quaternion_product(quaternion_about(spin / max(size, 1e-30), np.array(size)), found[-1]))
    return np.array(found)


def ball_on_ellipsoid(radius, azimuth, latitude):
    """Ball on the ellipsoid at rest: its centres, orientations and the contact in either frame."""
    points, normals = ellipsoid_points(azimuth, latitude)
    centres = points + radius * normals
    quaternions = rolled_orientations(radius, centres, normals)
    on_tip = -radius * np.einsum("tji,tj->ti", matrices(quaternions), normals)
    return centres, quaternions, on_tip, points


def two_link_arm(base, ends, lengths, bend):
    """Base, knee and end of a finger with two links; the knee lies towards `bend`."""
    along = ends - base
    reach = np.linalg.norm(along, axis=1, keepdims=True)
    a, b = lengths
    share = (reach**2 + a**2 - b**2) / (2.0 * reach)
    side = bend - along * (along @ bend)[:, None] / reach**2
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    knee = base + along / reach * share + side * np.sqrt(a**2 - share**2)
    return np.stack([np.broadcast_to(base, ends.shape), knee, ends], axis=1)


def stand_in(times=61):
    """The stand-in grasp, its motion and its times."""
    fine = 8 * (times - 1) + 1
    s = np.linspace(0.0, 1.0, fine)
    paths = (
        (1.9 + 0.9 * np.sin(2.2 * s), 0.15 + 0.45 * np.sin(3.1 * s)),
        (-1.5 + 0.7 * s, 0.1 - 0.5 * np.sin(2.6 * s)),
    )
    body = np.stack([0.006 * np.sin(3 * s), 0.004 * s, 0.08 + 0.005 * s], axis=-1)
    heading = quaternion_product(
        quaternion_about((0.0, 0.0, 1.0), 0.5 * s), quaternion_about((1.0, 0.0, 0.0), 0.3 * np.sin(2 * s))
    )
    tips, arms, on_tip, on_object = [], [], [], []
    for radius, path, y in zip(RADII, paths, (0.085, -0.085), strict=True):
        centres, quaternions, tip_point, point = ball_on_ellipsoid(radius, *path)
        world = body + np.einsum("tij,tj->ti", matrices(heading), centres)
        tips.append(np.concatenate([world, quaternion_product(heading, quaternions)], axis=-1)[::8])
        arms.append(
            two_link_arm(np.array([0.0, y, 0.0]), world[::8], (0.075, 0.065), np.array([0.0, y, 0.03]))
        )
        on_tip.append(tip_point[::8])
        on_object.append(point[::8])
    pose = np.concatenate([body, heading], axis=-1)[::8]
    on_tip, on_object = np.array(on_tip), np.array(on_object)
    out = [x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (on_tip, on_object / AXES**2)]
    motion = Motion3D(pose, np.array(tips), arms, on_tip, on_object, *out)
    grasp = SimpleNamespace(
        object=SimpleNamespace(surfaces=(geometry.Ellipsoid(*AXES),), outline=None),
        fingers=tuple(SimpleNamespace(tip=geometry.Sphere(radius)) for radius in RADII),
        contacts=tuple(SimpleNamespace(finger=i, surface=0) for i in range(2)),
    )
    return grasp, motion, np.linspace(0.0, 1.5, times)
