r"""The body that a scan encloses: its indicator function by Poisson's equation. NumPy, SciPy.

With the indicator $\chi$, minus a half inside and a half outside, $\nabla\chi = n \delta_S$, so that
$\Delta\chi = \nabla\cdot\sum_i a_i n_i K(x - x_i)$ with a narrow kernel K (Kazhdan, Bolitho and Hoppe, 2006),
here on a periodic grid by Fourier's transform. It closes holes and missing bottoms, joins double sheets, and
says everywhere what is inside. `_scan_fit` fits the surface itself.
"""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from ..surfaces import net
from ._scan import Scan

_ROOM = 0.3  # room around the scan, of its largest extent: the periodic images must not disturb it
_NODES = 6e6  # most nodes of the grid
_SECOND = 0.05  # share of the scan that may lie on other bodies than the largest


@dataclass(frozen=True)
class Body:
    """A closed body on a grid.

    Attributes:
        values: Indicator at the nodes, negative inside.
        origin: First node [m], shape (3,).
        step: Distance of nodes [m].
        vertices: Of a net over its surface [m], shape (n, 3).
        triangles: Counter-clockwise seen from outside, shape (m, 3).
    """

    values: np.ndarray
    origin: np.ndarray
    step: float
    vertices: np.ndarray
    triangles: np.ndarray

    def at(self, points: np.ndarray) -> np.ndarray:
        """The indicator at points [m], shape (n,)."""
        return _linear(self.values, (points - self.origin) / self.step)


def enclosed(scan: Scan, step: float) -> Body:
    """The body that a scan encloses, without cavities.

    Args:
        scan: Points with normals.
        step: Distance of nodes [m]; more where the nodes would be too many.

    Raises:
        ValueError: If it encloses none, or more than one.
    """
    origin, step, shape = _box(scan.points, step)
    values = _potential(scan, origin, step, shape)
    values = values - np.median(_linear(values, (scan.points - origin) / step))
    values = _alone(values, scan, origin, step)
    vertices, triangles = net(values)
    return Body(values, origin, step, origin + step * vertices, triangles)


def _box(points: np.ndarray, step: float) -> tuple[np.ndarray, float, tuple[int, int, int]]:
    """Corner, step and numbers of nodes of a grid around the points, of sizes that are quick to transform."""
    from scipy.fft import next_fast_len

    low, high = points.min(axis=0), points.max(axis=0)
    room = _ROOM * float(np.max(high - low))
    size = high - low + 2.0 * room
    step = max(step, float(np.cbrt(np.prod(size) / _NODES)))
    shape: list[Any] = [next_fast_len(int(np.ceil(x / step)) + 1, real=True) for x in size]
    return 0.5 * (low + high) - 0.5 * step * (np.array(shape) - 1), step, (shape[0], shape[1], shape[2])


def _potential(scan: Scan, origin: np.ndarray, step: float, shape: tuple[int, int, int]) -> np.ndarray:
    """The indicator up to a constant: Poisson's equation by Fourier's transform."""
    from scipy.fft import irfftn, rfftn

    kernel = max(step, scan.spacing)  # standard deviation of K, a Gaussian
    waves = [2.0 * np.pi * np.fft.fftfreq(n, step) for n in shape[:2]]
    waves.append(2.0 * np.pi * np.fft.rfftfreq(shape[2], step))
    grid = np.meshgrid(*waves, indexing="ij", sparse=True)
    square = grid[0] ** 2 + grid[1] ** 2 + grid[2] ** 2
    square[0, 0, 0] = 1.0
    place = (scan.points - origin) / step
    found = np.zeros(square.shape, complex)
    for k in range(3):
        strength = scan.areas * scan.sure * scan.normals[:, k] / step**3
        found += grid[k] * np.asarray(rfftn(_splatted(place, strength, shape)))
    found *= -1j * np.exp(-0.5 * kernel**2 * square) / square
    return np.asarray(irfftn(found, shape))


def _corners(place: np.ndarray) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """First node of each place's cell, and the shift and weight of the cell's eight corners."""
    first = np.floor(place).astype(int)
    part = place - first
    corners = []
    for shift in np.indices((2, 2, 2)).reshape(3, -1).T:
        corners.append((shift, np.prod(np.where(shift, part, 1.0 - part), axis=1)))
    return first, corners


def _splatted(place: np.ndarray, values: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """Values at places shared among the eight nodes around each."""
    first, corners = _corners(place)
    found = np.zeros(int(np.prod(shape)))
    for shift, weight in corners:
        number = np.ravel_multi_index(tuple((first + shift).T), shape)
        found += np.bincount(number, weight * values, len(found))
    return found.reshape(shape)


def _linear(values: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Values at places by linear interpolation; beyond the grid those at its edge."""
    from scipy.ndimage import map_coordinates

    return map_coordinates(values, place.T, order=1, mode="nearest")


def _alone(values: np.ndarray, scan: Scan, origin: np.ndarray, step: float) -> np.ndarray:
    """Values with the largest body alone, its cavities filled.

    Raises:
        ValueError: If there is no body, or other bodies have too large a share of the scan.
    """
    from scipy.ndimage import binary_fill_holes, label

    numbers, count = cast(tuple[np.ndarray, int], label(values < 0.0))
    if count == 0:
        raise ValueError("argument points must enclose a body, but enclose none")
    # The share of the scan beside each body: the nodes inside next to a point.
    nodes = np.round((scan.points - scan.spacing * scan.normals - origin) / step).astype(int)
    nodes = np.clip(nodes, 0, np.array(values.shape) - 1)
    share = np.bincount(numbers[tuple(nodes.T)], scan.areas, count + 1)[1:] / scan.areas.sum()
    largest = int(np.argmax(share))
    others = float(share.sum() - share[largest])
    if others > _SECOND:
        raise ValueError(
            f"argument points must enclose one body, but {100.0 * others:.0f} % of them lie on "
            f"{count - 1} other{'s' * (count > 2)}"
        )
    body = np.asarray(binary_fill_holes(numbers == largest + 1))
    size = np.abs(values)
    return np.where(body, -np.maximum(size, 1e-9), np.maximum(size, 1e-9))
