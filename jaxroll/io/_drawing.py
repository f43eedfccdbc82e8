"""What drawings of both kinds, SVG and DXF, have in common: what is said where one cannot be read."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .._results import shown
from ._outline import chosen


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn whatever a library raises on a file that it cannot read into one sentence, a ValueError."""
    try:
        yield
    except Exception as error:
        raise ValueError(
            f"argument path must name a drawing, but {path.name} could not be read: {shown(str(error))}"
        ) from None


def drawn_outline(outlines: list[np.ndarray], which: int, path: Path) -> np.ndarray:
    """One outline of a drawing, counting from the largest."""
    return finite(chosen(outlines, which, f"outlines in {path.name}"), path)


def finite(points: np.ndarray, path: Path) -> np.ndarray:
    """The points, if all are finite."""
    if not np.all(np.isfinite(points)):
        raise ValueError(
            f"argument path must name an outline of finite points, but that of {path.name} is not"
        )
    return points


def without_outline(path: Path) -> ValueError:
    return ValueError(f"argument path must name a drawing with an outline, but {path.name} has none")


def check_scale(scale: float, stated: float | None, path: Path) -> None:
    """Raise where the drawing states a unit that differs from the caller's by more than rounding."""
    if stated is not None and abs(scale / stated - 1.0) > 1e-3:
        # Most programs that draw SVGs count in pixels, or in a unit of no name.
        remedy = f"; say that a pixel is {1e3 * stated:.6g} mm" if path.suffix.lower() == ".svg" else ""
        raise ValueError(
            f"argument unit must agree with {path.name}, which states that one unit is "
            f"{1e3 * stated:.6g} mm, but was {1e3 * scale:.6g} mm{remedy}"
        )
