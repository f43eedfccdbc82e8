"""Points from files and outlines to files; the file's ending says which kind it is.

The readers and writers of `_tables`, `_svg` and `_dxf` work in the file's own unit; here their numbers are
converted from and to metres.
"""

from pathlib import Path
from typing import Any

import numpy as np

from .._results import as_count, check_flag, check_instance, on_host, shown
from ..geometry import AbstractContour, metres_per
from ._drawing import drawn_outline
from ._dxf import read_dxf, write_dxf
from ._mesh import read_ply_points
from ._outline import outline, positive
from ._paths import as_path, readable, writable
from ._svg import read_svg, write_svg
from ._tables import check_unit, read_csv, read_npy, write_csv

_READ = (".csv", ".txt", ".dat", ".npy", ".svg", ".dxf")
# Points along an outline of a drawing with curved pieces, unless a caller asks for others.
SAMPLES = 400
_CLOUDS = (".csv", ".txt", ".dat", ".xyz", ".npy", ".ply")
_WRITE = (".csv", ".npy", ".svg", ".dxf")


def read_points(
    path: str | Path,
    *,
    unit: str,
    pixel: float | None = None,
    which: int = 0,
    samples: int = SAMPLES,
    fill: bool = False,
    columns: tuple[int, int] = (0, 1),
) -> np.ndarray:
    """Points [m] of an outline in a file: CSV, TXT, DAT, NPY, SVG or DXF.

    Paths made of straight pieces give their corners, others `samples` points at equal distances; with `fill`
    both give all corners and about so many points between them. That is what `fit_contour` wants of a drawing
    with corners, and a `smallest_radius` to round them to. An SVG's y, which points down, is turned up. A
    drawing's own unit, or that behind the names at a table's head, `x [mm], y [mm]`, where one is stated,
    must agree with `unit`. What a drawing hides is left out, and what it shows without any paint, unless
    nothing has any; text and pictures are no outlines. Lines and curves whose ends meet, to a millionth of
    the drawing's size, are one outline, unless more than two meet at a place.

    Args:
        path: The file.
        unit: Of the numbers in the file: "m", "cm", "mm", "um" or "in"; in an SVG also "px", of size `pixel`.
        pixel: Size of a pixel [m] with `unit` "px"; the standard says 0.0254 / 96.
        which: SVG and DXF: which outline, counting from the largest.
        samples: SVG and DXF: number of points along an outline with curved pieces.
        fill: SVG and DXF: whether there are points along straight pieces too, and one at every corner.
        columns: Tables: the columns of x and y, counting from 0.

    Returns:
        Shape (n, 2), in metres, in the file's order; the first point of a drawing's closed outline is not
        repeated, that of a table where the table does so (`fit_contour` merges both).

    Raises:
        ValueError: If the file holds no such outline or a number that is not finite, or the units disagree.
        ImportError: If SVG or DXF is asked for without the extra `cad`.

    Example:
        >>> import jaxroll as jxr
        >>> path = jxr.io.write_outline(jxr.Circle(0.01), "disc.csv", unit="mm", tolerance=1e-5)
        >>> points = jxr.io.read_points(path, unit="mm")
        >>> f"{float(abs(points).max()):.4f} m"
        '0.0100 m'
    """
    path = readable(as_path(path, _READ))
    # "px" is a unit only where the size of a pixel is given, and pixels exist only in an SVG.
    kind = path.suffix.lower()
    unit = check_instance("unit", unit, str, "the name of a unit")
    if (unit == "px") != (pixel is not None) or (unit == "px" and kind != ".svg"):
        raise ValueError(
            f"argument pixel must be given with unit 'px' of an SVG and only there, but unit was "
            f"{shown(unit)} and pixel was {shown(pixel)} for {path.name}"
        )
    scale = positive("pixel", pixel) if unit == "px" else metres_per(unit)
    samples, which = as_count("samples", samples, least=6), as_count("which", which, least=0)
    chosen, fill = _columns("columns", columns, 2), check_flag("fill", fill)
    if kind in (".svg", ".dxf"):
        return drawn(path, scale, which, samples, fill=fill)[0]
    check_unit(path, chosen, unit)
    return scale * (read_npy if kind == ".npy" else read_csv)(path, chosen)


def drawn(
    path: Path, scale: float, which: int, samples: int = SAMPLES, *, fill: bool = False
) -> tuple[np.ndarray, int]:
    """One outline of a drawing, SVG or DXF [m], counting from the largest, and how many there are.

    The arguments are those of `read_svg`.
    """
    outlines = (read_svg if path.suffix.lower() == ".svg" else read_dxf)(path, scale, samples, fill=fill)
    return scale * drawn_outline(outlines, which, path), len(outlines)


def read_cloud(
    path: str | Path,
    *,
    unit: str,
    columns: tuple[int, int, int] = (0, 1, 2),
    normals: tuple[int, int, int] | None = None,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Points [m] of a scan in space, for `fit_surface`: CSV, TXT, DAT, XYZ or NPY, or a PLY without faces.

    Args:
        path: The file.
        unit: Of the coordinates in the file: "m", "cm", "mm", "um" or "in".
        columns: Tables: the columns of x, y and z, counting from 0.
        normals: Tables: the columns of the outward normals, if they are there.

    Returns:
        The points, shape (n, 3), in the file's order, and their normals of the same shape; None without. The
        normals of a PLY are its own, if it has some.

    Raises:
        ValueError: If the file holds no such points or a number that is not finite, or its head states
            another unit.
        ImportError: For a PLY without the extra `cad`.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> np.save("scan.npy", 20.0 * np.eye(3))
        >>> points, normals = jxr.io.read_cloud("scan.npy", unit="mm")
        >>> points.tolist(), normals
        ([[0.02, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.02]], None)
    """
    path, scale = readable(as_path(path, _CLOUDS)), metres_per(unit)
    chosen = _columns("columns", columns, 3)
    others = () if normals is None else _columns("normals", normals, 3)
    if path.suffix.lower() == ".ply":
        points, found = read_ply_points(path)
        return scale * points, found
    check_unit(path, chosen, unit)
    table = (read_npy if path.suffix.lower() == ".npy" else read_csv)(path, (*chosen, *others))
    return scale * table[:, :3], table[:, 3:] if others else None


@on_host
def write_outline(contour: AbstractContour, path: str | Path, *, unit: str, tolerance: float = 1e-6) -> Path:
    """Write a contour as points or as a drawing: CSV, NPY, SVG or DXF.

    Args:
        contour: Closed, or open with ends.
        path: The file; its ending says which kind. Folders are made if need be.
        unit: Of the numbers written: "m", "cm", "mm", "um" or "in". All but NPY state it themselves.
        tolerance: Largest distance [m] of the outline's straight pieces from the contour.

    Returns:
        The path.

    Raises:
        ValueError: If the contour has no ends, or an argument is out of range.
        ImportError: If DXF is asked for without the extra `cad`.

    Example:
        >>> import jaxroll as jxr
        >>> path = jxr.io.write_outline(jxr.Ellipse(0.02, 0.014), "ellipse.svg", unit="mm")
        >>> path.read_text().splitlines()[0][:24]
        '<svg xmlns="http://www.w'
    """
    path, scale = as_path(path, _WRITE), metres_per(unit)
    writable(path)
    points = outline(contour, tolerance) / scale
    kind = path.suffix.lower()
    if kind == ".svg":
        write_svg(path, points, scale, closed=contour.closed)
    elif kind == ".dxf":
        write_dxf(path, points, unit, closed=contour.closed)
    elif kind == ".npy":
        np.save(path, points)
    else:
        write_csv(path, points, unit)
    return path


def _columns(name: str, columns: Any, count: int) -> tuple[int, ...]:
    """The columns of the coordinates, if they are so many numbers from 0 on."""
    several = isinstance(columns, tuple | list) and len(columns) == count
    if not several or not all(isinstance(i, int) and not isinstance(i, bool) and i >= 0 for i in columns):
        many = {2: "two", 3: "three"}[count]
        raise ValueError(f"argument {name} must be {many} numbers from 0 on, but was {shown(columns)}")
    return tuple(columns)
