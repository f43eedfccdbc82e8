"""Points that a caller gives, checked and converted to NumPy's double precision: never traced by JAX."""

from typing import Any

import numpy as np

from ..._results import as_array, SHAPE_LENGTHS, shown, traced


def numbers(name: str, value: Any, width: int) -> np.ndarray:
    """An argument as finite concrete numbers of shape (any, width), in double precision on the host.

    Raises:
        ValueError: If it is traced, no numbers, of another shape, or not finite.
    """
    if traced(value):
        raise ValueError(
            f"argument {name} must be concrete numbers, but was traced: fit outside jit and grad"
        )
    try:
        as_array(name, value)
    except ValueError:
        raise ValueError(
            f"argument {name} must be numbers of shape (any, {width}), but was {shown(value)}"
        ) from None
    array = np.asarray(value, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != width:
        raise ValueError(f"argument {name} must have shape (any, {width}), but had shape {array.shape}")
    check_finite_rows(name, array)
    if len(array) > 1 and np.all(array == array[0]):
        raise ValueError(f"argument {name} must not be one point again and again, but was {shown(array[0])}")
    return array


def check_finite_rows(name: str, array: np.ndarray) -> None:
    """Raise with the first row that is not finite."""
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        raise ValueError(f"argument {name} must be finite, but row {bad[0]} was {array[bad[0]].tolist()}")


def check_extent(name: str, points: np.ndarray) -> None:
    """Raise unless points [m] extend over a length that a shape may have, and no farther from the origin.

    Fits take for granted that squares and higher powers of the points are finite and not zero.
    """
    with np.errstate(over="ignore"):
        size, far = float(np.ptp(points, axis=0).max()), float(np.abs(points).max())
    least, most = SHAPE_LENGTHS
    if not (size >= least and far <= most):
        raise ValueError(
            f"argument {name} must extend over {least:g} m or more, within {most:g} m of the origin, but "
            f"were {size:.3g} m long or wide and reached {far:.3g} m"
        )


def polygon_length(points: np.ndarray, *, closed: bool) -> float:
    """Length [m] of the line through points; closed: with the way back to the first one."""
    around = np.concatenate([points, points[:1]]) if closed else points
    return float(np.linalg.norm(np.diff(around, axis=0), axis=1).sum())


def polygon_area(points: np.ndarray) -> float:
    """Signed area of a polygon of at least three points; positive where it runs counter-clockwise.

    Example:
        >>> import numpy as np
        >>> import jaxroll as jxr
        >>> jxr.geometry.polygon_area(np.array([(0.0, 0.0), (2.0, 0.0), (0.0, 1.0)]))
        1.0
    """
    points = numbers("points", points, 2)
    if len(points) < 3:
        raise ValueError(f"argument points must have at least 3 rows, but had {len(points)}")
    x, y = (points - points.mean(axis=0)).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
