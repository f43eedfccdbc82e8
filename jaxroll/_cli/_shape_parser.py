"""What `jaxroll fit` and `jaxroll pinch` take; JAX is not imported here, so that complaints come at once."""

import argparse
from collections.abc import Callable
from typing import Any

_FIT = "Fit a smooth contour or surface to a file, print a report, and write its picture and the shape."
_PINCH = (
    "Fit an object from a file, find where to hold it, pinch it, push it, print a report, and write figures: "
    "in the plane for drawings, tables of x and y, photographs and sections, in space for meshes and clouds. "
    "No gravity acts. The exit code is 0 if every contact held until the end, at rest or not: the report's "
    "outcome says which."
)
_FILE = (
    "a drawing (SVG, DXF), a table of points with two, three or six columns (CSV, TXT, DAT, NPY, XYZ), "
    "a mesh (STL, OBJ, PLY, OFF) or a photograph (PNG, JPEG, TIFF, BMP)"
)
# Units of files: those of `geometry`, which cannot be asked here without importing JAX.
FILE_UNITS = ("m", "cm", "mm", "um", "in")


def shape_parsers(commands: Any, number: Callable[..., Any], about: str) -> None:
    """Add both commands to a parser; `number` converts text within limits, `about` ends their help."""
    fit = commands.add_parser("fit", help=_FIT, description=_FIT, epilog=about)
    pinch = commands.add_parser("pinch", help=_PINCH, description=_PINCH, epilog=about)
    for name, parser in (("fit", fit), ("pinch", pinch)):
        parser.add_argument("file", metavar="FILE", help=_FILE)
        place = f"where to write (default: jaxroll-{name}-NAME, of NAME.ENDING)"
        parser.add_argument("--out", metavar="FOLDER", help=place)
        parser.add_argument("--unit", choices=FILE_UNITS, default="mm", help="of FILE (default: mm)")
        size = number(1e-6, 1e6)
        radius = "smallest radius of curvature [mm] (default: a tenth of the least extent along its axes of "
        radius += "inertia)"
        parser.add_argument("--smallest-radius", metavar="MM", type=size, help=radius)
        pixel = "of a photograph, or of an SVG in pixels: size of one [mm]"
        parser.add_argument("--pixel", metavar="MM", type=size, help=pixel)
        cut = "of a mesh: the section across an axis, such as z=12.5 [mm]"
        parser.add_argument("--section", metavar="AXIS=MM", type=_section(number), help=cut)
        which = "of several outlines in a drawing, photograph or section: from 0, the largest (default), on"
        parser.add_argument("--which", metavar="N", type=number(0, 1e6, int), help=which)
    pinch.add_argument("--hand", metavar="FILE", help="URDF or MJCF (default: the chapter's fingers)")
    numbers = {
        "density": (1000.0, "of the object [kg/m^3]"),
        "thickness": (20.0, "of an object of the plane [mm]"),
        "friction": (0.8, "coefficient of friction"),
        "seconds": (1.0, "to simulate"),
    }
    for name, (default, what) in numbers.items():
        told = f"{what} (default: {default:g})"
        pinch.add_argument(f"--{name}", metavar="X", type=number(1e-3, 1e5), default=default, help=told)
    press = "of the fingers [N] (default: three times what the object would weigh; no gravity acts)"
    pinch.add_argument("--force", metavar="N", type=number(1e-6, 1e6), help=press)
    pinch.add_argument("--no-animation", action="store_true", help="write no motion.gif")


def _section(number: Callable[..., Any]) -> Callable[[str], tuple[str, float]]:
    """A converter of text into an axis and a place on it [m]."""

    def convert(text: str) -> tuple[str, float]:
        axis, _, place = text.partition("=")
        if axis not in ("x", "y", "z") or not place:
            raise argparse.ArgumentTypeError(f"must be an axis and a place, such as z=12.5, but was {text}")
        return axis, 1e-3 * number(-1e6, 1e6)(place)

    return convert
