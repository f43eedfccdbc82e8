"""What `jaxroll fit` does: a smooth contour or surface near what a file holds, with report and picture."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from .. import io, plotting
from .._saving import save
from ..geometry import Fit
from ._shape_file import read, ShapeOrder, size_told, smooth_shape, warn
from ._words import in_options

_OUTLINES = ("contour.csv", "contour.svg", "contour.dxf")


def fitted(asked: ShapeOrder, folder: Path, timed: Callable[[str], AbstractContextManager]) -> list[str]:
    """Fit, draw and write; returns the lines of the report, which is written too.

    Args:
        asked: Which shape to make of which file.
        folder: Where the files go.
        timed: Context that announces a piece of work and says how long it took.
    """
    with timed("Reading"):
        outline = read(asked)
    size = size_told(asked, outline)
    warn(size)
    with timed("Fitting"):
        found = smooth_shape(asked, outline)
    with timed("Drawing"):
        plotting.fit(found).savefig(folder / "fit.png", dpi=150)
    names, missing = ["fit.png"], []
    if isinstance(found, Fit):
        names.append(save(folder / "contour.npz", found.contour).name)
        for name in _OUTLINES:
            try:
                names.append(io.write_outline(found.contour, folder / name, unit="mm").name)
            except ImportError as error:
                missing.append(f"  no {name}: {error}")
    else:
        names.append(save(folder / "surface.npz", found.surface).name)
    report = in_options("\n".join([*size, f"{found.report}"]), "fit")
    (folder / "report.txt").write_text(f"{report}\n", encoding="utf-8")
    return [report, f"Files in {folder}:", "  " + ", ".join([*names, "report.txt"]), *missing]
