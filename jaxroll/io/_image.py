"""Silhouettes out of images, grey or in colour; the only file that imports scikit-image.

Of a photograph in colour, what surrounds the shape is known from the image's border: a colour that may change
across the image, as light does, by a polynomial of second degree. The distance of every pixel's colour from
it is an image of grey values again, dark outside the shape and bright within, however the shape is shaded.
"""

import os
from typing import Any

import numpy as np

from .._results import as_count, as_floats, on_host, shown
from ..geometry import polygon_area
from ._extra import missing
from ._outline import positive

_BLUR = 0.7  # standard deviation [pixels] by which a colour image is smoothed
_CONTRAST = 4.0  # least distance of a shape's colours from the background, in the border's own
_MOST = 1e100  # largest value in an image
_STEP = 1.0 / 255.0  # least distance that is not taken for zero, in the largest


@on_host
def read_silhouette(
    image: Any, *, pixel: float, threshold: float | None = None, which: int = 0
) -> np.ndarray:
    """Points on the outline of a shape in an image, to a fraction of a pixel.

    Marching squares: where the grey value, linear between pixels, crosses the threshold. The origin is the
    middle of the lower left pixel, x to the right, y up. Of a colour image the grey value is the distance of
    a pixel's colour from the background's, which is worked out from the image's border; of one that is
    transparent around the shape, it is the opacity. Noise of some pixels' length is left in the outline:
    `fit_contour` with a `smallest_radius` takes it out.

    Args:
        image: Shape (rows, columns), or (rows, columns, 3) or (rows, columns, 4) with red, green, blue and
            opacity, in any range; row 0 at the top.
        pixel: Size of a pixel [m].
        threshold: Grey value of the outline. None: Otsu's, which parts the histogram best in two, and midway
            between both where no pixel is; in colour half the distance that four fifths of the shape exceed,
            of an opacity the middle of its range.
        which: Which shape, counting from the one of the largest area.

    Returns:
        Shape (n, 2) [m], counter-clockwise, the first point not repeated.

    Raises:
        ValueError: If there is no such outline, the image's border cuts it, or nothing in a colour image
            differs from its border.
        ImportError: Without the extra `cad`.

    Accuracy: a shaded disc of 220 pixels before a background with a gradient, saved as JPEG of quality 80,
    is found within 0.8 pixels everywhere and 0.3 in the mean. The radius of a disc of 120 pixels before a
    clean background is found within 0.1 pixels where its edge is sharp or rises over 4, within 0.2 where over
    9, and 2 pixels too large where over 18.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> y, x = np.mgrid[-20:21, -20:21]
        >>> disc = np.clip(10.5 - np.hypot(x, y), 0.0, 1.0)
        >>> points = jxr.io.read_silhouette(disc, pixel=1e-3, threshold=0.5)
        >>> f"{0.5 * np.ptp(points[:, 0]):.4f} m"
        '0.0100 m'
    """
    if isinstance(image, str | os.PathLike):
        raise ValueError(
            "argument image must be the values of an image, such as matplotlib.image.imread reads, and no "
            f"path, but was {shown(image)}"
        )
    try:
        grey = np.asarray(image)
    except (TypeError, ValueError):
        raise ValueError(f"argument image must be grey values of one shape, but was {shown(image)}") from None
    shape, channels = grey.shape[:2], grey.shape[2] if grey.ndim == 3 else 1
    wanted = grey.ndim in (2, 3) and (grey.ndim == 2 or channels in (3, 4))
    if not wanted or min(shape) < 2 or grey.dtype.kind not in "buif":
        raise ValueError(
            "argument image must be grey values of shape (rows, columns), or colours of shape (rows, "
            f"columns, 3 or 4), but was {grey.dtype} of shape {grey.shape}"
        )
    grey = grey.astype(float)
    if not np.all(np.isfinite(grey)):
        raise ValueError("argument image must be finite, but had a value that is not")
    if np.abs(grey).max() > _MOST:  # squares of differences would overflow
        raise ValueError(
            f"argument image must have values of at most {_MOST:g}, but had one of {np.abs(grey).max():.3g}"
        )
    pixel, which = positive("pixel", pixel), as_count("which", which, least=0)
    if threshold is not None:
        threshold = float(as_floats("threshold", threshold, ()))
    if channels > 1:
        grey, level = _from_background(grey)
        threshold = level if threshold is None else threshold
    # Shapes may be brighter or darker than what surrounds them: outlines run either way, and their areas have
    # either sign.
    found = sorted(_outlines(grey, threshold), key=_area, reverse=True)
    if not found:
        why = "are all alike" if threshold is None else f"do not cross the threshold of {threshold:.6g}"
        raise ValueError(
            f"argument image must show a shape, but its values, {grey.min():.6g} to {grey.max():.6g}, {why}"
        )
    if which >= len(found):
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


def _area(points: np.ndarray) -> float:
    """The size of the area that an outline encloses; none for one that cuts the image's corner."""
    return abs(float(polygon_area(points))) if len(points) > 2 else 0.0


def _outlines(grey: np.ndarray, threshold: float | None) -> list[np.ndarray]:
    """Lines of constant grey value, each of shape (n, 2) as row and column; Otsu's threshold by default."""
    try:
        from skimage.measure import find_contours
    except ImportError:
        raise missing("scikit-image") from None
    return find_contours(grey, _parting(grey) if threshold is None else threshold)


def _from_background(colours: np.ndarray) -> tuple[np.ndarray, float]:
    """Distances of an image's colours from its background's, and the distance at which a shape begins.

    Args:
        colours: Shape (rows, columns, 3 or 4).
    """
    from scipy.ndimage import gaussian_filter  # imported with the first use

    if colours.shape[2] == 4:
        opacity = colours[..., 3]
        middle = float(0.5 * (opacity.min() + opacity.max()))
        # The corners of a window, or a pixel that is not quite opaque, are no shape.
        if float(np.median(opacity[_border(opacity.shape)])) < middle:
            return opacity, middle
        colours = colours[..., :3]
    # JPEG's noise is mostly in single pixels and in blocks of eight; this takes the former out.
    smooth = gaussian_filter(colours, sigma=(_BLUR, _BLUR, 0.0), mode="nearest")
    distances = np.linalg.norm(smooth - _background(smooth), axis=2)
    largest = float(distances.max())
    # Of a clean background the border's distances are rounding, or exactly zero: what is less than a grey
    # value of 8 bits is none.
    usual = max(float(np.median(distances[_border(distances.shape)])), _STEP * largest)
    level = _level(distances, usual) if largest > 0.0 else 0.0
    if 2.0 * level < _CONTRAST * usual or largest == 0.0:
        raise ValueError(
            "argument image must show a shape whose colour differs from the border's, but the largest "
            f"difference is {largest:.3g}, and along the border there is one of {usual:.3g}"
        )
    return distances, level


def _level(distances: np.ndarray, usual: float) -> float:
    """Half the distance that four fifths of the shape exceed: the distance at which the shape begins.

    Otsu's threshold finds the shape first, on a logarithmic scale, where its bright and dark parts are one
    group, and the background another. Where the background has no noise, Otsu's threshold takes soft edges
    and the traces that JPEG leaves along sharp ones for the shape too, and four fifths of that exceed too
    little. So long as the level is above where the shape was said to begin, it is found anew from the pixels
    that exceed the level.
    """
    begin = usual * float(np.expm1(_otsu(np.log1p(distances / usual))))
    while True:
        inside = distances[distances > begin]
        level = 0.5 * float(np.quantile(inside, 0.2)) if inside.size else 0.0
        if level <= begin:
            return level
        begin = level


def _border(shape: tuple[int, ...]) -> np.ndarray:
    """Where the outermost pixels of an image are: a fiftieth of its shorter side, at least one."""
    width = max(1, min(shape[:2]) // 50)
    rim = np.ones(shape[:2], bool)
    rim[width:-width, width:-width] = False
    return rim


def _background(colours: np.ndarray) -> np.ndarray:
    """A polynomial of second degree in row and column for every colour, fitted to the image's border.

    In three rounds pixels that lie off by more than three times the median lose their say: the shape may
    touch the border.
    """
    rows, columns = (np.linspace(-1.0, 1.0, n) for n in colours.shape[:2])
    y, x = np.meshgrid(rows, columns, indexing="ij")
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    rim = _border(colours.shape)
    matrix, seen, kept = terms[rim], colours[rim], np.ones(int(rim.sum()), bool)
    for _ in range(3):
        found = np.linalg.lstsq(matrix[kept], seen[kept], rcond=None)[0]
        off = np.linalg.norm(seen - matrix @ found, axis=1)
        kept = off <= 3.0 * np.median(off) + np.finfo(float).tiny
    return terms @ found


def _parting(grey: np.ndarray) -> float:
    """The grey value that parts pixels as Otsu's threshold does; midway where values are far apart there.

    Where no pixel has a value between the dark and the bright ones, as in a mask, Otsu's is that of the last
    dark one, and an outline there would run half a pixel beside the edge.
    """
    level, bin_width = _otsu(grey), float(np.ptp(grey)) / 256.0
    # Otsu's is the middle of one of 256 bins, all of which is dark.
    bright = grey > level + 0.5 * bin_width
    if bright.all() or not bright.any():
        return float(grey.max())
    light, dark = grey[bright], grey[~bright]
    if light.min() - dark.max() <= 2.0 * bin_width:  # values of all sizes, as in a photograph
        return level
    return float(np.clip(0.5 * (light.mean() + dark.mean()), dark.max(), light.min()))


def _otsu(values: np.ndarray) -> float:
    """Otsu's threshold, which parts a histogram best in two."""
    try:
        from skimage.filters import threshold_otsu
    except ImportError:
        raise missing("scikit-image") from None
    return float(threshold_otsu(values))
