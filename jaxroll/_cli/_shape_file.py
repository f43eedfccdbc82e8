"""Shapes from files of any kind: what `jaxroll fit` and `jaxroll pinch` begin with.

The file's ending says what it is: a drawing, a table of points of the plane or of space, a mesh, or a
photograph. Of a mesh either the surface or a section is fitted. The smallest radius of curvature, unless it
is given, is a tenth of the shape's least extent.
"""

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import io
from ..geometry import Fit, fit_contour, fit_surface, SurfaceFit

DRAWINGS, TABLES = (".svg", ".dxf"), (".csv", ".txt", ".dat", ".npy", ".xyz")
MESHES, PHOTOGRAPHS = (".stl", ".obj", ".ply", ".off"), (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_SHARE = 0.1
_AXES = "xyz"


@dataclass(frozen=True)
class ShapeOrder:
    """Which shape to make of a file.

    Attributes:
        file: Its name.
        unit: Of the numbers in it.
        radius: Smallest radius of curvature [m]; None: a tenth of the least extent.
        pixel: Size of a photograph's pixel [m].
        section: Of a mesh, what to cut it across: an axis, and where [m]; None for all of it.
    """

    file: str
    unit: str
    radius: float | None
    pixel: float | None
    section: tuple[str, float] | None


def fitted(order: ShapeOrder) -> Fit | SurfaceFit:
    """The smooth shape near what a file holds.

    Raises:
        ValueError: If the file holds no points, or they are no one smooth shape.
    """
    path, kind = Path(order.file), Path(order.file).suffix.lower()
    if kind in PHOTOGRAPHS:
        if order.pixel is None:
            raise ValueError("argument --pixel must be the size of a pixel in mm, but was not given")
        return _contour(io.read_silhouette(_image(path), pixel=order.pixel), order)
    if kind in DRAWINGS:
        return _contour(io.read_points(path, unit=order.unit), order)
    if kind in MESHES:
        return _of_mesh(path, order)
    if kind not in TABLES:
        known = ", ".join(DRAWINGS + TABLES + MESHES + PHOTOGRAPHS)
        raise ValueError(f"argument FILE must end in one of {known}, but was {path.name}")
    try:
        points, normals = _cloud(path, order.unit)
    except ValueError:  # not three columns of numbers: then two, or the sentence that says why not
        return _contour(io.read_points(path, unit=order.unit), order)
    return _surface(points, order, normals=normals)


def _of_mesh(path: Path, order: ShapeOrder) -> Fit | SurfaceFit:
    """A surface or a section of a mesh; of a PLY that has points alone, the surface near these."""
    try:
        points, faces = io.read_mesh(path, unit=order.unit)
    except ValueError:
        if path.suffix.lower() != ".ply" or order.section is not None:
            raise
        points, normals = io.read_cloud(path, unit=order.unit)
        return _surface(points, order, normals=normals)
    if order.section is None:
        return _surface(points, order, faces=faces)
    axis, height = order.section
    normal = np.eye(3)[_AXES.index(axis)]
    return _contour(io.section(points, faces, origin=height * normal, normal=normal)[0], order)


def _cloud(path: Path, unit: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Points of space with the normals in columns 4 to 6, where these are unit vectors."""
    with contextlib.suppress(ValueError):
        points, normals = io.read_cloud(path, unit=unit, normals=(3, 4, 5))
        if normals is not None and np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() < 1e-3:
            return points, normals
    return io.read_cloud(path, unit=unit)


def _contour(points: np.ndarray, order: ShapeOrder) -> Fit:
    radius = _radius(points) if order.radius is None else order.radius
    return fit_contour(points, smallest_radius=radius)


def _surface(points: np.ndarray, order: ShapeOrder, *, normals: Any = None, faces: Any = None) -> SurfaceFit:
    radius = _radius(points) if order.radius is None else order.radius
    return fit_surface(points, normals, faces=faces, smallest_radius=radius)


def _radius(points: np.ndarray) -> float:
    """A tenth of the least extent of points, along their own axes."""
    centred = points - points.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1]
    return _SHARE * float(np.ptp(centred @ axes, axis=0).min())


def _image(path: Path) -> np.ndarray:
    """The colours of a photograph's pixels."""
    from PIL import Image

    try:
        with Image.open(path) as picture:
            return np.asarray(picture.convert("RGB"))
    except OSError as error:
        raise ValueError(
            f"argument FILE must be a photograph, but {path.name} could not be read: {error}"
        ) from None
