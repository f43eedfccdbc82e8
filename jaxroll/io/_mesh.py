"""Solids as triangle meshes, by trimesh; mapbox_earcut fills polygons. No other file imports the two."""

from pathlib import Path
from typing import Any

import numpy as np

from .._results import check_between, on_host, shown
from ..geometry import AbstractContour, check_contour, check_once_round, crossings, metres_per
from ._extra import missing
from ._outline import outline, positive
from ._paths import as_path, readable, writable

_KINDS = (".stl", ".obj", ".ply", ".off")
# Least and largest height of a solid [m]. STL holds single precision, in which a much lower solid would have
# no volume, and a much higher one no finite coordinates.
_HEIGHTS = (1e-9, 1e3)
# Vertices nearer to each other than this share of a mesh's extent are one.
_ALIKE = 1e-8


def _trimesh() -> Any:
    """The library trimesh, imported with the first use."""
    try:
        import trimesh
    except ImportError:
        raise missing("trimesh") from None
    return trimesh


def _triangles(points: np.ndarray) -> np.ndarray:
    """Triangles that fill a polygon, shape (m, 3): indices of its corners."""
    try:
        import mapbox_earcut
    except ImportError:
        raise missing("mapbox_earcut") from None
    ring = np.array([len(points)], np.uint32)
    return np.asarray(mapbox_earcut.triangulate_float64(points, ring), int).reshape(-1, 3)


@on_host
def write_stl(
    contour: AbstractContour,
    path: str | Path,
    *,
    height: float,
    unit: str = "mm",
    tolerance: float = 1e-6,
) -> Path:
    """Write the body within a closed contour as a solid of constant height, to print or to mill.

    The mesh is watertight, lies between z = 0 and `height`, and its volume is that of the outline's polygon
    times the height. STL holds single precision.

    Args:
        contour: Closed, and without self-intersections.
        path: A file that ends in .stl. Folders are made if need be.
        height: Of the solid [m], from 1e-9 to 1e3.
        unit: Of the numbers written; slicers take them for millimetres.
        tolerance: Largest distance [m] of the outline's straight pieces from the contour.

    Returns:
        The path.

    Raises:
        ValueError: If the contour is open or crosses itself, straight pieces within the tolerance would, or
            the contour lies so far out that single precision passes the tolerance, or an argument is out of
            range.
        ImportError: Without the extra `cad`.

    Example:
        >>> import jaxroll as jxr
        >>> jxr.io.write_stl(jxr.Circle(0.01), "disc.stl", height=0.005, tolerance=1e-5).name
        'disc.stl'
    """
    path, scale = as_path(path, (".stl",)), metres_per(unit)
    height = positive("height", height)
    check_between("height", height, *_HEIGHTS, unit=" m")  # before anything is worked out
    if not isinstance(contour, AbstractContour) or not contour.closed:
        raise ValueError(f"argument contour must be closed, but was {shown(contour)}")
    check_contour("contour", contour)
    check_once_round("contour", contour)
    trimesh, path = _trimesh(), writable(path)
    points = outline(contour, tolerance) / scale
    if len(crossings(points, closed=True)):
        raise ValueError(
            "argument tolerance must keep the outline's straight pieces from crossing each other, but was "
            f"{shown(tolerance)} m"
        )
    # Half of what the last binary digit of the largest coordinate is worth: by so much corners are moved.
    rounded = 0.5 * scale * float(np.spacing(np.float32(np.abs(points).max())))
    if rounded > tolerance:
        raise ValueError(
            f"argument tolerance must be at least {1.01 * rounded:.3g} m, as STL's single precision rounds a "
            f"contour that reaches this far from the origin, but was {shown(tolerance)} m"
        )
    solid = trimesh.creation.extrude_triangulation(points, _triangles(points), height / scale)
    if not solid.is_watertight or solid.volume <= 0.0:
        raise ValueError("argument contour must not cross itself, but its solid is not watertight")
    solid.export(str(path), file_type="stl")
    return path


def read_mesh(path: str | Path, *, unit: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [m] of shape (n, 3) and faces of shape (m, 3) of a mesh file: STL, OBJ, PLY, OFF.

    All solids and materials of a file are one mesh. Vertices in the same place are one, as where an STL or a
    texture repeats them, and those of no face are left out.

    Args:
        path: The file.
        unit: Of the numbers in the file: "m", "cm", "mm", "um" or "in".

    Returns:
        Vertices [m], and faces as the numbers of their three vertices.

    Raises:
        ValueError: If the file holds no triangles, or a vertex of theirs that is not finite.
        ImportError: Without the extra `cad`.

    Example:
        >>> import jaxroll as jxr
        >>> path = jxr.io.write_stl(jxr.Circle(0.01), "disc.stl", height=0.005, tolerance=1e-5)
        >>> vertices, faces = jxr.io.read_mesh(path, unit="mm")
        >>> [f"{x:.4f}" for x in vertices.max(axis=0)]
        ['0.0100', '0.0100', '0.0050']
    """
    scale, path = metres_per(unit), readable(as_path(path, _KINDS))
    loaded = _loaded(path)
    # Several solids or materials come as a scene of as many meshes.
    parts = [part for part in getattr(loaded, "geometry", {"": loaded}).values() if hasattr(part, "faces")]
    if not any(len(part.faces) for part in parts):
        raise ValueError(f"argument path must name a file with triangles, but {path.name} has none")
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    corners = np.concatenate(
        [start + np.asarray(part.faces, int) for start, part in zip(starts, parts, strict=False)]
    )
    vertices = np.concatenate([np.asarray(part.vertices, float) for part in parts])[corners.ravel()]
    kept, numbers = _alike(_finite(vertices, path))
    return scale * vertices[kept], numbers.reshape(-1, 3)


def read_ply_points(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Points of a PLY, shape (n, 3), in the file's own unit, and their normals if it has some."""
    cloud = _loaded(path)
    points = _finite(np.asarray(getattr(cloud, "vertices", np.zeros((0, 3))), float).reshape(-1, 3), path)
    # A dictionary of columns from a file of text, an array of records from a binary one.
    raw: Any = getattr(cloud, "metadata", {}).get("_ply_raw", {}).get("vertex", {}).get("data", {})
    named = raw if isinstance(raw, dict) else raw.dtype.names or ()
    if not {"nx", "ny", "nz"} <= set(named):
        return points, None
    return points, np.stack([np.asarray(raw[name], float).ravel() for name in ("nx", "ny", "nz")], axis=-1)


def _loaded(path: Path) -> Any:
    """What trimesh makes of a file as it stands.

    Its processing is left out: that drops vertices that are not finite, with their faces, and keeps apart
    those that differ in texture or normal alone.
    """
    trimesh = _trimesh()
    try:
        return trimesh.load(str(path), process=False)
    except Exception as error:  # whatever the library raises on what it cannot read
        raise ValueError(
            f"argument path must name a mesh, but {path.name} could not be read: {shown(str(error))}"
        ) from None


def _finite(vertices: np.ndarray, path: Path) -> np.ndarray:
    """The vertices, if there are any and all are finite."""
    if not len(vertices) or not np.all(np.isfinite(vertices)):
        raise ValueError(f"argument path must name a file of finite vertices, but {path.name} has others")
    return vertices


def _alike(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the points that repeat none before them, and for every point which of these it repeats."""
    extent = float(np.ptp(points, axis=0).max())
    cells = np.round((points - points.min(axis=0)) / (_ALIKE * extent or 1.0))
    order = np.lexsort(cells.T)  # stable: of points alike the first comes first
    fresh = np.append(True, np.any(np.diff(cells[order], axis=0) != 0.0, axis=1))
    firsts = order[fresh]
    kept = np.sort(firsts)
    numbers = np.empty(len(points), int)
    numbers[order] = np.searchsorted(kept, firsts)[np.cumsum(fresh) - 1]
    return kept, numbers


def spread_points(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points spread over a mesh, the same each time, and the outward normals of their triangles."""
    mesh = _trimesh().Trimesh(vertices, faces)
    points, triangles = _trimesh().sample.sample_surface(mesh, count, seed=0)
    return np.asarray(points), np.asarray(mesh.face_normals)[triangles]
