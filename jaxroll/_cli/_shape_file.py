"""Shapes from files of any kind: what `jaxroll fit` and `jaxroll pinch` begin with.

The file's ending says what it is: a drawing, a table of points of the plane or of space, a mesh, or a
photograph. Of a mesh either the surface or a section is fitted. The smallest radius of curvature, unless it
is given, is a tenth of the shape's least extent along its axes of inertia, which need not be x and y.

Reading comes before fitting: a file that was read in another unit than its own is a thousand times too large
or too small, which `size_told` says before any time is spent on it.
"""

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .. import io
from ..geometry import Fit, fit_contour, fit_surface, metres_per, SurfaceFit
from ..io._files import drawn
from ..io._paths import readable
from ..io._tables import first_numbers, table_width
from ._waiting import say

DRAWINGS, TABLES = (".svg", ".dxf"), (".csv", ".txt", ".dat", ".npy", ".xyz")
MESHES, PHOTOGRAPHS = (".stl", ".obj", ".ply", ".off"), (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
# Sizes [m] of what a hand may hold at all, and of what it is likely to hold; units in the order to try.
_HELD, _LIKELY = (2e-3, 2.0), (8e-3, 1.0)
_UNITS = ("m", "mm", "um", "in", "cm")
_SHARE = 0.1
# How many columns a table may have.
_WIDTHS = (2, 3, 6)
# Points whose least extent is at most this share of their largest are flat; steps as alike as this are even.
_FLAT, _EVEN = 1e-6, 1e-6
_AXES = "xyz"


@dataclass(frozen=True)
class ShapeOrder:
    """Which shape to make of a file.

    Attributes:
        file: Its name.
        unit: Of the numbers in it.
        radius: Smallest radius of curvature [m]; None: a tenth of the least extent along its own axes.
        pixel: Size of a photograph's pixel, or of one pixel of an SVG [m]; None: an SVG is in `unit`.
        section: Where to cut a mesh: the axis across which, and the place on it [m]; None for all of the
            mesh.
        which: Which outline of a drawing, a photograph or a section, counting from the largest; None: 0.
    """

    file: str
    unit: str
    radius: float | None
    pixel: float | None
    section: tuple[str, float] | None
    which: int | None = None


class ShapePoints(NamedTuple):
    """Points of a file, in order or not, in the plane or in space.

    Attributes:
        points: Shape (n, 2) or (n, 3) [m].
        normals: Those of a cloud, or None.
        faces: Those of a mesh, or None.
        outlines: How many outlines there were to choose from.
    """

    points: np.ndarray
    normals: np.ndarray | None = None
    faces: np.ndarray | None = None
    outlines: int = 1

    @property
    def extent(self) -> np.ndarray:
        """From end to end along each axis [m]."""
        return np.ptp(self.points, axis=0)


def read(asked: ShapeOrder) -> ShapePoints:
    """What a file holds.

    Raises:
        ValueError: If the file holds no points, or they lie on a line or in a plane of space.
    """
    _check_options(asked)
    found, path = _read(asked), Path(asked.file)
    _check_spread(found.points, path.name, table=path.suffix.lower() in TABLES)
    return found


def _check_options(asked: ShapeOrder) -> None:
    """Refuse options that are for files of another kind."""
    path = Path(asked.file)
    kind = path.suffix.lower()
    # By option: whether it was given, the kinds that it is for, and their name.
    taken = {
        "--pixel": (asked.pixel, (*PHOTOGRAPHS, ".svg"), "a photograph or an SVG"),
        "--section": (asked.section, MESHES, "a mesh"),
        "--which": (
            asked.which,
            DRAWINGS + PHOTOGRAPHS + (MESHES if asked.section is not None else ()),
            "a drawing, a photograph or a section",
        ),
    }
    for option, (given, kinds, what) in taken.items():
        if given is not None and kind not in kinds and kind in DRAWINGS + TABLES + MESHES + PHOTOGRAPHS:
            raise ValueError(
                f"argument {option} must be left out for all but {what}, but FILE was {path.name}"
            )


def _read(asked: ShapeOrder) -> ShapePoints:
    """The points of a file, by its kind."""
    path, kind = Path(asked.file), Path(asked.file).suffix.lower()
    if kind in PHOTOGRAPHS:
        if asked.pixel is None:
            raise ValueError("argument --pixel must be the size of a pixel in mm, but was not given")
        return ShapePoints(io.read_silhouette(_image(path), pixel=asked.pixel, which=asked.which or 0))
    if kind in DRAWINGS:
        # An SVG may be in a unit of its own, which is a pixel to it.
        scale = metres_per(asked.unit) if asked.pixel is None else asked.pixel
        points, count = drawn(readable(path), scale, asked.which or 0)
        return ShapePoints(points, outlines=count)
    if kind in MESHES:
        return _of_mesh(path, asked)
    if kind not in TABLES:
        known = ", ".join(DRAWINGS + TABLES + MESHES + PHOTOGRAPHS)
        raise ValueError(f"argument FILE must end in one of {known}, but was {path.name}")
    width = table_width(path)
    _check_width(path, width)
    # A scan with a bad number in z is no outline: what decides is how many columns there are.
    if kind == ".xyz" or width > 2:
        return ShapePoints(*_cloud(path, asked.unit))
    return ShapePoints(io.read_points(path, unit=asked.unit))


def _check_width(path: Path, width: int) -> None:
    """Refuse a table of other columns than x and y, x, y and z, or these with normals."""
    if width in (0, *_WIDTHS):  # a table without numbers is refused where it is read
        return
    line = "" if path.suffix.lower() == ".npy" else first_numbers(path)
    # Whole numbers between commas, twice as many as coordinates.
    halved = width % 2 == 0 and "," in line and "." not in line and ";" not in line
    hint = ""
    if halved:
        hint = "; if its commas are decimal marks, part the columns by semicolons or blanks"
    raise ValueError(
        "argument FILE must be a table of 2 columns (x, y), 3 (x, y, z) or 6 (x, y, z and outward normals), "
        f"but {path.name} has {width}{hint}"
    )


def _check_spread(points: np.ndarray, name: str, *, table: bool) -> None:
    """Refuse points that enclose nothing, and a table with a column that counts them."""
    if table and points.shape[1] == 3 and len(points) > 3:
        steps = np.diff(points, axis=0)
        even = np.abs(steps - steps[0]).max(axis=0) <= _EVEN * np.abs(steps[0])
        counts = np.flatnonzero(even & (steps[0] != 0.0))
        if len(counts):
            raise ValueError(
                "argument FILE must hold columns of coordinates alone, but column "
                f"{counts[0] + 1} of {name} counts its lines: leave that column out"
            )
    extents = _own_extents(points)
    if extents.min() > _FLAT * extents.max():
        return
    if points.shape[1] == 2:
        raise ValueError(f"argument FILE must hold points of an outline, but those of {name} lie on one line")
    constant = np.flatnonzero(np.ptp(points, axis=0) <= _FLAT * extents.max())
    which = f"column {constant[0] + 1}, which is constant" if len(constant) == 1 else "the column across it"
    advice = f": for an outline leave out {which}" if table else ""
    raise ValueError(
        f"argument FILE must hold points all round a body, but those of {name} lie in one plane{advice}"
    )


def smooth_shape(asked: ShapeOrder, outline: ShapePoints | None = None) -> Fit | SurfaceFit:
    """The smooth shape near what a file holds.

    Args:
        asked: Which shape to make of which file.
        outline: What `read` has of it. Default: it is read here.

    Raises:
        ValueError: If the file holds no points, or they are no one smooth shape.
    """
    points, normals, faces, _ = read(asked) if outline is None else outline
    radius = _radius(points) if asked.radius is None else asked.radius
    if points.shape[1] == 2:
        return fit_contour(points, smallest_radius=radius)
    return fit_surface(points, normals, faces=faces, smallest_radius=radius)


def size_told(asked: ShapeOrder, outline: ShapePoints) -> list[str]:
    """Lines about what was read: its size, which of several outlines it is, and a unit that is in doubt."""
    size = " x ".join(f"{1e3 * x:.4g}" for x in outline.extent)
    lines = [f"  size        {size} mm"]
    if outline.outlines > 1:
        last = outline.outlines - 1
        told = f"number {asked.which or 0} of {outline.outlines} was taken, from 0, the largest, to {last}"
        lines.append(f"  outline     {told}; --which N takes another")
    largest = float(outline.extent.max())
    if _HELD[0] <= largest <= _HELD[1]:
        return lines
    if asked.pixel is not None or Path(asked.file).suffix.lower() in PHOTOGRAPHS:
        return [*lines, "  beware      no hand holds what is of this size: is --pixel right?"]
    others = {unit: largest * metres_per(unit) / metres_per(asked.unit) for unit in _UNITS}
    likely = [
        f"--unit {unit}: {1e3 * x:.4g} mm" for unit, x in others.items() if _LIKELY[0] <= x <= _LIKELY[1]
    ]
    told = f" ({likely[0]} long)" if likely else ""
    return [*lines, f"  beware      no hand holds what is of this size: is --unit {asked.unit} right?{told}"]


def warn(lines: list[str]) -> None:
    """Say the lines after the size at once, before what takes long: the outline taken, a unit in doubt."""
    for line in lines[1:]:
        say(line.strip())


def _of_mesh(path: Path, asked: ShapeOrder) -> ShapePoints:
    """A surface or a section of a mesh; of a PLY that has points alone, these."""
    try:
        points, faces = io.read_mesh(path, unit=asked.unit)
    except ValueError:
        if path.suffix.lower() != ".ply" or asked.section is not None:
            raise
        return ShapePoints(*io.read_cloud(path, unit=asked.unit))
    if asked.section is None:
        return ShapePoints(points, faces=faces)
    axis, height = asked.section
    normal = np.eye(3)[_AXES.index(axis)]
    outlines = io.section(points, faces, origin=height * normal, normal=normal)
    which = asked.which or 0
    if which >= len(outlines):
        raise ValueError(
            f"argument --which must be below the number of outlines of the section, {len(outlines)}, but was "
            f"{which}"
        )
    return ShapePoints(outlines[which], outlines=len(outlines))


def _cloud(path: Path, unit: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Points of space with the normals in columns 4 to 6, where these are unit vectors."""
    with contextlib.suppress(ValueError):
        points, normals = io.read_cloud(path, unit=unit, normals=(3, 4, 5))
        if normals is not None and np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() < 1e-3:
            return points, normals
    return io.read_cloud(path, unit=unit)


def _radius(points: np.ndarray) -> float:
    """A share of the least extent of points, along their own axes."""
    return _SHARE * float(_own_extents(points).min())


def _own_extents(points: np.ndarray) -> np.ndarray:
    """From end to end [m] along the axes of inertia of points."""
    centred = points - points.mean(axis=0)
    return np.ptp(centred @ np.linalg.eigh(centred.T @ centred)[1], axis=0)


def _image(path: Path) -> np.ndarray:
    """The colours of a photograph's pixels as it is shown, with their opacity where the file has one."""
    from PIL import Image, ImageOps

    try:
        with Image.open(path) as file:
            # A camera that was held upright or upside down stores what it saw, and how that is to be turned.
            picture = ImageOps.exif_transpose(file)
            # Grey values of more than 8 bits, which "RGB" would cut off.
            if picture.mode.startswith(("I", "F")):
                grey = np.asarray(picture, float)
                return np.stack([grey, grey, grey], axis=-1)
            clear = picture.mode in ("RGBA", "LA", "PA", "RGBa", "La") or "transparency" in picture.info
            return np.asarray(picture.convert("RGBA" if clear else "RGB"))
    except (OSError, Image.DecompressionBombError) as error:
        raise ValueError(
            f"argument FILE must be a photograph, but {path.name} could not be read: {error}"
        ) from None
