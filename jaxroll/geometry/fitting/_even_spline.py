r"""Quintic splines through nodes one unit of their parameter apart, and displacements along their normals.

All of it is set-up in NumPy and SciPy, with sparse matrices. A displacement $w(u) = \sum_j w_j \beta(u - j)$
is a sum of cardinal B-splines of degree 5, so that $w''$ is exact. `_bounded_curve` moves such a curve until
it lies among data, with its curvature bounded.
"""

import functools
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

_DEGREE = 5
_REACH = 3  # a cardinal B-spline of degree 5 differs from zero within three units of its middle
_BUMP = np.array([66.0, 26.0, 1.0, 1.0, 26.0]) / 120.0  # values of the B-spline at 0, 1, 2, -2, -1
_FINE = 16  # places per interval from which arclength is summed


class CurveFrames(NamedTuple):
    """A curve at places u: point and unit normal to the left (n, 2), curvature [1/m], speed |dP/du| [m]."""

    point: np.ndarray
    normal: np.ndarray
    curvature: np.ndarray
    speed: np.ndarray


@dataclass(frozen=True)
class EvenSpline:
    """A quintic spline through nodes (n, 2) at u = 0, 1, 2, ...; a closed one is periodic with period n."""

    nodes: np.ndarray
    closed: bool

    @property
    def pieces(self) -> int:
        return len(self.nodes) if self.closed else len(self.nodes) - 1

    @functools.cached_property
    def curve(self) -> Any:
        from scipy.interpolate import BSpline, make_interp_spline  # set-up only: imported with the first use

        n = len(self.nodes)
        if not self.closed:
            return make_interp_spline(np.arange(n), self.nodes, k=_DEGREE)
        # The nodes are the coefficients' convolution with a bump's values, (1, 26, 66, 26, 1) / 120.
        bump = np.zeros(n)
        bump[[0, 1, 2, -2, -1]] = _BUMP
        waves = np.fft.rfft(self.nodes, axis=0) / np.fft.rfft(bump)[:, None]
        coefficients = np.fft.irfft(waves, n=n, axis=0)[(np.arange(n + _DEGREE) - 2) % n]
        return BSpline(np.arange(-_DEGREE, n + _DEGREE + 1.0), coefficients, _DEGREE)

    def inside(self, u: np.ndarray) -> np.ndarray:
        """Places brought back to the curve: round a closed one, to the nearer end of an open one."""
        return np.mod(u, self.pieces) if self.closed else np.clip(u, 0.0, self.pieces)

    def frames(self, u: np.ndarray) -> CurveFrames:
        u = self.inside(u)
        rate, bend = self.curve(u, 1), self.curve(u, 2)
        speed = np.maximum(np.hypot(rate[:, 0], rate[:, 1]), np.finfo(float).tiny)
        normal = np.stack([-rate[:, 1], rate[:, 0]], axis=1) / speed[:, None]
        curvature = (rate[:, 0] * bend[:, 1] - rate[:, 1] * bend[:, 0]) / speed**3
        return CurveFrames(self.curve(u), normal, curvature, speed)

    def arclengths(self) -> tuple[np.ndarray, np.ndarray]:
        """Places u, `_FINE` to an interval, and the arclengths [m] from u = 0 to them."""
        u = np.linspace(0.0, self.pieces, _FINE * self.pieces + 1)
        speed = np.linalg.norm(self.curve(u, 1), axis=1)
        steps = 0.5 * (speed[1:] + speed[:-1]) / _FINE
        return u, np.concatenate([[0.0], np.cumsum(steps)])

    def spread(self, count: int) -> "EvenSpline":
        """The spline through so many points of this one, at equal distances."""
        u, along = self.arclengths()
        at = np.linspace(0.0, along[-1], count + 1)[:-1] if self.closed else np.linspace(0, along[-1], count)
        return EvenSpline(self.curve(np.interp(at, along, u)), self.closed)

    def feet(self, points: np.ndarray) -> np.ndarray:
        """Places u of the points of the curve nearest to some points, by Newton's method."""
        from scipy.spatial import KDTree

        places = np.linspace(0.0, self.pieces, 8 * self.pieces + 1)
        u = places[KDTree(self.curve(places)).query(points)[1]]
        for _ in range(3):
            frame = self.frames(u)
            away = points - frame.point
            # Along the tangent, which is the normal turned right.
            ahead = away[:, 0] * frame.normal[:, 1] - away[:, 1] * frame.normal[:, 0]
            inward = np.sum(away * frame.normal, axis=1)
            step = ahead / (np.maximum(1.0 - frame.curvature * inward, 0.1) * frame.speed)
            u = self.inside(u + np.clip(step, -0.2, 0.2))
        return u


def displacements(u: np.ndarray, pieces: int, *, closed: bool, order: int = 0) -> Any:
    """Sparse matrix from the coefficients of a displacement to a derivative of it in u, at places u.

    A closed curve of n pieces has n coefficients; an open one n + 5, of which five only matter near its ends.
    """
    from scipy.interpolate import BSpline
    from scipy.sparse import csr_matrix

    bump = BSpline.basis_element(np.arange(-_REACH, _REACH + 1.0), extrapolate=False)
    bump = bump.derivative(order) if order else bump
    cell = np.minimum(np.floor(u).astype(int), pieces - 1)
    columns, values = [], []
    for j in range(1 - _REACH, _REACH + 1):
        values.append(np.nan_to_num(bump(u - cell - j)))
        columns.append((cell + j) % pieces if closed else cell + j + _REACH - 1)
    rows = np.tile(np.arange(len(u)), 2 * _REACH)
    shape = (len(u), pieces if closed else pieces + _DEGREE)
    return csr_matrix((np.concatenate(values), (rows, np.concatenate(columns))), shape=shape)


def low_passed(nodes: np.ndarray, length: float, wavelength: float, *, closed: bool) -> np.ndarray:
    """Evenly spaced nodes without their wiggles: those of the wavelength are halved, shorter ones vanish.

    Between its ends, an open curve is taken less the line through them, and continued as an odd function.
    """
    n = len(nodes)
    if closed:
        waves = np.fft.rfft(nodes, axis=0)
        kept = 1.0 / (1.0 + (wavelength * np.arange(len(waves)) / length) ** 6)
        return np.fft.irfft(waves * kept[:, None], n=n, axis=0)
    share = np.linspace(0.0, 1.0, n)[:, None]
    line = (1.0 - share) * nodes[0] + share * nodes[-1]
    odd = np.concatenate([nodes - line, -(nodes - line)[-2:0:-1]])
    return line + low_passed(odd, 2.0 * length, wavelength, closed=True)[:n]
