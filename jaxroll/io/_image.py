"""Silhouettes out of greyscale images; the only file that imports scikit-image."""

from typing import Any

import numpy as np

from .._results import as_count, as_floats, shown
from ..geometry import polygon_area
from ._extra import missing
from ._outline import positive


def read_silhouette(
    image: Any, *, pixel: float, threshold: float | None = None, which: int = 0
) -> np.ndarray:
    """Points on the outline of a shape in a greyscale image, to a fraction of a pixel.

    Marching squares: where the grey value, linear between pixels, crosses the threshold. The origin is the
    middle of the lower left pixel, x to the right, y up.

    Args:
        image: Shape (rows, columns), row 0 at the top.
        pixel: Size of a pixel [m].
        threshold: Grey value of the outline; None: Otsu's, which parts the histogram best in two.
        which: Which shape, counting from the one of the largest area.

    Returns:
        Shape (n, 2) [m], counter-clockwise, the first point not repeated.

    Raises:
        ValueError: If there is no such outline, or the image's border cuts it.
        ImportError: Without the extra `cad`.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> y, x = np.mgrid[-20:21, -20:21]
        >>> disc = np.clip(10.5 - np.hypot(x, y), 0.0, 1.0)
        >>> points = jxr.io.read_silhouette(disc, pixel=1e-3, threshold=0.5)
        >>> f"{0.5 * np.ptp(points[:, 0]):.4f} m"
        '0.0100 m'
    """
    try:
        grey = np.asarray(image)
    except (TypeError, ValueError):
        raise ValueError(f"argument image must be grey values of one shape, but was {shown(image)}") from None
    if grey.ndim != 2 or min(grey.shape) < 2 or grey.dtype.kind not in "buif":
        raise ValueError(
            f"argument image must be grey values of shape (rows, columns), but was {grey.dtype} of "
            f"shape {grey.shape}"
        )
    grey = grey.astype(float)
    if not np.all(np.isfinite(grey)):
        raise ValueError("argument image must be finite, but had a value that is not")
    pixel, which = positive("pixel", pixel), as_count("which", which, least=0)
    if threshold is not None:
        threshold = float(as_floats("threshold", threshold, ()))
    # Shapes may be brighter or darker than what surrounds them: outlines run either way, and their areas have
    # either sign.
    found = sorted(_outlines(grey, threshold), key=lambda points: -abs(polygon_area(points)))
    if not 0 <= which < len(found):
        raise ValueError(
            f"argument which must be below the number of outlines, {len(found)}, but was {which}"
        )
    # Row 0 is at the top, while y points up.
    rows, columns = found[which].T
    points = pixel * np.stack([columns, grey.shape[0] - 1.0 - rows], axis=1)
    if np.any(points[0] != points[-1]):
        raise ValueError(
            f"argument image must show the whole shape, but the border cuts outline {which} from "
            f"{points[0].tolist()} to {points[-1].tolist()} m"
        )
    points = points[:-1]
    return points if polygon_area(points) > 0.0 else points[::-1]


def _outlines(grey: np.ndarray, threshold: float | None) -> list[np.ndarray]:
    """Lines of constant grey value, each of shape (n, 2) as row and column; Otsu's threshold by default."""
    try:
        from skimage.filters import threshold_otsu
        from skimage.measure import find_contours
    except ImportError:
        raise missing("scikit-image") from None
    level = float(threshold_otsu(grey)) if threshold is None else threshold
    return find_contours(grey, level)
