"""Shapes and motion of a spatial grasp put together, in millimetres."""

from dataclasses import dataclass, replace

import numpy as np

from .._mechanics import Grasp, Stage
from ..geometry import AbstractSurface
from ._meshes import box_mesh, endless, Mesh, mesh
from ._motion3 import Motion3D, placed, turned
from ._style import MM
from ._views import link_radii

# Half the width of an endless surface, over the size of what is bounded.
_BEYOND = 0.75
_DEFAULT_SIZE = 0.04
# Radius of the links, over the size of the tips.
_SLIM = 0.16
# Elevation and azimuth of the camera by default, and its angle from the normal of a contact, all in degrees.
_VIEW, _ASIDE = (22.0, -58.0), 62.0


@dataclass(frozen=True)
class Solid:
    """A rigid body to draw.

    Attributes:
        mesh: Its triangles in its own frame [mm].
        frames: Its poses, shape (t, 7), positions [mm].
        finger: Which finger it is the tip of; -1 for the object.
    """

    mesh: Mesh
    frames: np.ndarray
    finger: int

    def at(self, i: int) -> np.ndarray:
        """Its vertices in the world at instant i."""
        return placed(self.frames[i], self.mesh.vertices)


@dataclass(frozen=True)
class DrawnLocus:
    """The contact points on one surface, in its body's frame.

    Attributes:
        points: Shape (t, 3) [mm].
        normals: Outward unit normals, shape (t, 3).
        frames: Poses of the body, shape (t, 7), positions [mm].
        finger: Which finger's tip it lies on; -1 for the object.
    """

    points: np.ndarray
    normals: np.ndarray
    frames: np.ndarray
    finger: int

    def at(self, i: int, lift: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Points and normals in the world at instant i, the points lifted off the surface [mm]."""
        frame = self.frames[i]
        return placed(frame, self.points + lift * self.normals), turned(frame, self.normals)


@dataclass(frozen=True)
class Scene3:
    """All that is drawn of a spatial grasp.

    Attributes:
        solids: The object's, then the tips.
        skeletons: Points from base to tip for each finger, shape (t, points, 3) [mm].
        on_tips: For each contact its locus on the fingertip.
        on_object: For each contact its locus on the object.
        thickness: Radius of links that have none of their own [mm].
        corners: Least and largest coordinates at any time, shape (2, 3) [mm].
        tip_name: What the object touches is called: a fingertip or a stage.
        radii: Of each finger's links [mm]; None where they have none of their own.
    """

    solids: tuple[Solid, ...]
    skeletons: tuple[np.ndarray, ...]
    on_tips: tuple[DrawnLocus, ...]
    on_object: tuple[DrawnLocus, ...]
    thickness: float
    corners: np.ndarray
    tip_name: str
    radii: tuple[float | None, ...]

    @property
    def times(self) -> int:
        """How many instants there are."""
        return len(self.solids[0].frames)


def scene3(
    grasp: Grasp, motion: Motion3D, *, rows: int = 24, columns: int = 48, links: bool = True
) -> Scene3:
    """Meshes, frames and loci; without `links` a skeleton is its last point.

    Raises:
        ValueError: If grasp and motion do not belong together, or a surface cannot be drawn.
    """
    _matched(grasp, motion)
    body, tips = _scaled(motion.body), [_scaled(tip) for tip in motion.tips]
    shapes = _shapes(grasp, motion, (rows, columns))
    frames = [(body, -1)] * (len(shapes) - len(tips)) + [(tip, i) for i, tip in enumerate(tips)]
    solids = tuple(Solid(shape, *frame) for shape, frame in zip(shapes, frames, strict=True))
    on_tips, on_object = [], []
    for k, contact in enumerate(grasp.contacts):
        tip = contact.finger
        on_tips.append(DrawnLocus(MM * motion.on_tip[k], motion.out_of_tip[k], tips[tip], tip))
        on_object.append(DrawnLocus(MM * motion.on_object[k], motion.out_of_object[k], body, -1))
    first = 0 if links else -1
    skeletons = tuple(MM * skeleton[:, first:] for skeleton in motion.skeletons)
    sizes = [_size(s.mesh) for s in solids if s.finger >= 0 and s.mesh.closed] or [MM * _DEFAULT_SIZE]
    thickness = _SLIM * min(sizes)
    radii = link_radii(grasp)
    corners = _corners(solids, skeletons, max(thickness, *(radius or 0.0 for radius in radii)))
    loci, name = (tuple(on_tips), tuple(on_object)), tip_name(grasp)
    return Scene3(solids, skeletons, *loci, thickness, corners, name, radii)


def tip_name(grasp: Grasp) -> str:
    """What the object touches is called: a fingertip or a stage."""
    return "stage" if all(isinstance(finger, Stage) for finger in grasp.fingers) else "fingertip"


def looking(scene: Scene3) -> tuple[float, float]:
    """Elevation and azimuth, in degrees, of a camera that sees the first contact from the side."""
    normal = scene.on_object[0].at(scene.times // 2)[1][scene.times // 2] if scene.on_object else np.zeros(3)
    # Nearly vertical: every view shows the contact from the side.
    if np.hypot(*normal[:2]) < 0.2:
        return _VIEW
    # Along the normal one body would hide the other. Of the four views off to a side of it, from before and
    # from behind, the one nearest to the usual azimuth is taken.
    across = np.degrees(np.arctan2(normal[1], normal[0]))
    choices = across + np.array([_ASIDE, -_ASIDE, 180.0 - _ASIDE, 180.0 + _ASIDE])
    nearest = choices[np.argmin(np.abs(_within_a_turn(choices - _VIEW[1])))]
    return _VIEW[0], float(_within_a_turn(nearest))


def _within_a_turn(degrees: np.ndarray) -> np.ndarray:
    """The same directions, from -180 to 180 degrees."""
    return degrees - 360.0 * np.round(degrees / 360.0)


def _matched(grasp: Grasp, motion: Motion3D) -> None:
    fingers, contacts = len(grasp.fingers), len(grasp.contacts)
    if len(motion.tips) != fingers:
        raise ValueError(f"argument motion must have {fingers} tips, but had {len(motion.tips)}")
    if len(motion.on_tip) != contacts:
        raise ValueError(f"argument motion must have {contacts} contacts, but had {len(motion.on_tip)}")
    if not motion.times:
        raise ValueError("argument motion must have at least one time, but had none")


def _scaled(frames: np.ndarray) -> np.ndarray:
    return frames * np.array([MM, MM, MM, 1.0, 1.0, 1.0, 1.0])


def _shapes(grasp: Grasp, motion: Motion3D, counts: tuple[int, int]) -> list[Mesh]:
    """Meshes [mm] of the object, one for each surface or the box alone, then of the tips."""
    rows, columns = counts
    drawn: list[AbstractSurface | Mesh] = list(grasp.object.surfaces)
    places = _places([(0, c.surface) for c in grasp.contacts], motion.on_object)
    places |= _places([(1, c.finger) for c in grasp.contacts], motion.on_tip)
    keys = [(0, k) for k in range(len(drawn))]
    if grasp.object.outline is not None:
        drawn = [box_mesh(grasp.object.outline)]
        keys = [(0, 0)]
    drawn += [finger.tip for finger in grasp.fingers]
    keys += [(1, k) for k in range(len(grasp.fingers))]
    found = [
        shape if isinstance(shape, Mesh) or endless(shape) else mesh(shape, rows=rows, columns=columns)
        for shape in drawn
    ]
    size = max([_size(shape) for shape in found if isinstance(shape, Mesh)], default=_DEFAULT_SIZE)
    done = []
    for shape, key in zip(found, keys, strict=True):
        if not isinstance(shape, Mesh):
            points = places.get(key, np.zeros((1, 3)))
            low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
            extent = _BEYOND * size + 0.5 * float((high - low).max())
            shape = mesh(shape, rows=rows, columns=columns, extent=extent, about=0.5 * (low + high))
        done.append(replace(shape, vertices=MM * shape.vertices))
    return done


def _places(keys: list[tuple[int, int]], points: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    """All contact points on each surface."""
    return {
        key: np.concatenate([p for k, p in zip(keys, points, strict=True) if k == key]) for key in set(keys)
    }


def _size(shape: Mesh) -> float:
    return float(np.ptp(shape.vertices, axis=0).max())


def _corners(solids: tuple[Solid, ...], skeletons: tuple[np.ndarray, ...], margin: float) -> np.ndarray:
    cloud = [s.reshape(-1, 3) for s in skeletons]
    for solid in solids:
        # Forty instants bound the picture well enough: bodies move little between them.
        some = np.unique(np.linspace(0, len(solid.frames) - 1, 40).astype(int))
        cloud += [placed(frame, solid.mesh.vertices) for frame in solid.frames[some]]
    every = np.concatenate(cloud)
    every = every[np.isfinite(every).all(axis=1)]
    return np.stack([every.min(axis=0) - margin, every.max(axis=0) + margin])
