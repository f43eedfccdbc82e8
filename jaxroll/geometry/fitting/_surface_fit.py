r"""From a cloud of points to a smooth surface, with a report.

The surface is the zero set of a field $F$ of B-splines, which minimises the quadratic form of `fit_surface`'s
docstring. With the points' areas $a_i$, normals $n_i$ and gradients scaled by $G_i$ its normal equations are
$\sum_i a_i B_i B_i^T + (G_i \nabla B_i)^T G_i \nabla B_i + \text{roughness}$ times the coefficients
$= \sum_i (G_i \nabla B_i)^T G_i n_i$; `_field_fit` makes the matrix. Normals and areas come from
`_surface_normals`; the result is a `SplineSurface`.

Why $\frac{3}{16}(\ell/2\pi)^5$: a surface that is a plane with a wave of wavenumber k and height f wants
$F = -f \cos kx$ on the plane. The field through it of least $\int |\mathrm{D}^3 F|^2 dV$ costs
$\frac{16}{3} k^5 f^2/2$ per area, since $\int (k^2 + \zeta^2)^{-3} d\zeta/2\pi = \frac{3}{16} k^{-5}$; so at
$k = 2\pi/\ell$ roughness and distance weigh the same, and the fitted wave has half the height. (The normals
raise that by one per cent.)
"""

import math
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._linalg import Vec3
from ..._results import as_floats, as_length, check_direction, concrete, shown
from ..._types import Given
from ..surfaces import principal, SplineSurface
from ._field_fit import AXES, DataRows, Grid, grid_around, normal_band, offsets, roughness_band, rows
from ._surface_normals import estimated, neighbourhoods, outward

_CELLS = 2.5  # cells per wavelength of smoothing
_ROOM = 2.0  # cells between the points and the end of the grid
_SLOPE = 0.02  # weight of the normals' term against that of the points, for waves of the halved wavelength
_LENGTH = 0.1  # factor of the gradient's error along the normal; squared it is the weight, a hundredth
_PROBES = 2  # random vectors by which the trace of the influence matrix is estimated
_GAIN = 0.99  # a finer field must lower the estimated error by 1 %, or the coarser one is kept


@dataclass(frozen=True)
class SurfaceReport:
    """How a surface was made of points; prints as a table.

    Attributes:
        points: Number of points used.
        area: Of the surface, as the points cover it [m^2].
        smoothing: Wavelength [m] of the wiggles that were halved.
        cells: Numbers of cells of the grid.
        step: Width of a cell [m].
        rms: Root mean square distance of the points from the surface [m].
        largest: Largest such distance [m].
        normals: Root mean square and largest angle to the given normals [rad]; None without.
        curvature: Smallest and largest principal curvature at the points [1/m].
        smoothness: Continuous derivatives of the surface.
    """

    points: int
    area: float
    smoothing: float
    cells: tuple[int, int, int]
    step: float
    rms: float
    largest: float
    normals: tuple[float, float] | None
    curvature: tuple[float, float]
    smoothness: float

    def __str__(self) -> str:
        rows = {
            "points": f"{self.points} on {1e4 * self.area:.4g} cm^2",
            "smoothing": f"wavelength {1e3 * self.smoothing:.4g} mm",
            "grid": f"{' x '.join(map(str, self.cells))} cells of {1e3 * self.step:.3g} mm",
            "distance of points": f"{1e6 * self.rms:.3g} um rms, {1e6 * self.largest:.3g} um at most",
            "principal curvature": f"{self.curvature[0]:.4g} to {self.curvature[1]:.4g} 1/m",
            "smoothness": f"{self.smoothness:g} continuous derivatives",
        }
        if self.normals is not None:
            mean, most = (math.degrees(x) for x in self.normals)
            rows["angle to normals"] = f"{mean:.3g} deg rms, {most:.3g} deg at most"
        return "\n".join(f"{name:<20}{value}" for name, value in rows.items())


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SurfaceFit:
    """A surface made of points.

    Attributes:
        surface: The surface, differentiable in its own arrays.
        points: Shape (n, 3), the points used [m].
        feet: Shape (n, 3), places of the surface close to them; coordinates for its methods.
        report: `SurfaceReport`.
    """

    surface: SplineSurface
    points: Array
    feet: Array
    report: SurfaceReport = eqx.field(static=True)


def fit_surface(
    points: Given, normals: Given | None = None, *, smoothing: float | None = None, noise: float | None = None
) -> SurfaceFit:
    r"""A smooth closed surface of any shape near scattered points: the zero set of a field of B-splines.

    Minimises, over quintic B-splines on a grid of cells of width $\ell / 2.5$,
    $$\int_S F^2 + \tfrac{1}{50} (\ell/2\pi)^2 |\nabla F - n|^2\,dA
    + \tfrac{3}{16} (\ell/2\pi)^5 \int |\mathrm{D}^3 F|^2\,dV,$$
    the first integral as a sum over the points, each with the area it stands for, the second exactly. It
    halves a wiggle of wavelength $\ell$ on the surface and leaves longer ones. The part of $\nabla F - n$
    along $n$ counts a hundredth: a field that is the distance would have to be rough, one that is a
    quadric need not. The linear system has a band; Cholesky's method takes seconds.

    Args:
        points: Shape (n, 3) [m], n at least 100, all over a closed surface.
        normals: Outward normals, shape (n, 3); None: from planes through neighbours, turned alike.
        smoothing: Wavelength $\ell$ [m]; None: by generalised cross-validation, or from `noise`.
        noise: Standard deviation of each coordinate [m], where it is known and `smoothing` is not.

    Returns:
        `SurfaceFit`, with `surface` and `report`.

    Accuracy: 20 000 points 0.1 mm off an ellipsoid of half axes 20, 14 and 10 mm, nothing else given: 10 um
    in the point, 0.12 degrees in the normal and 0.6 % in both principal curvatures, at most. Quadrics are met
    without bias; elsewhere details shorter than $\ell$ are lost.

    Raises:
        ValueError: If the points are not finite, too few or in parts, a normal is zero, `smoothing` is no
            length, `noise` is negative, or the grid is too fine for the memory.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> u = np.random.default_rng(0).normal(size=(1000, 3))
        >>> fit = jxr.geometry.fit_surface(0.02 * u / np.linalg.norm(u, axis=1)[:, None], smoothing=0.02)
        >>> bool(np.all(np.abs(0.02 * fit.surface.principal_curvatures(fit.feet)[0] - 1) < 0.01))
        True
    """
    cloud = np.unique(_cloud("points", points), axis=0) if normals is None else _cloud("points", points)
    given = None if normals is None else _cloud("normals", normals)
    if given is not None and given.shape != cloud.shape:
        raise ValueError(f"argument normals must have shape {cloud.shape}, but had shape {given.shape}")
    deviation = None if noise is None else _deviation(noise)
    neighbours, areas = neighbourhoods(cloud)
    if given is None:
        directions = outward(cloud, estimated(cloud, neighbours), areas)
    else:
        check_direction("normals", jnp.asarray(given))
        directions = given / np.linalg.norm(given, axis=1, keepdims=True)
    problem = _Problem(cloud, directions, areas)
    wavelength = (
        _chosen(problem, deviation) if smoothing is None else float(as_length("smoothing", smoothing))
    )
    surface = problem.solved(wavelength, np.zeros((0, len(cloud))))[0]
    return _reported(surface, problem, wavelength, given is not None)


@dataclass(frozen=True)
class _Problem:
    """Points [m], unit normals and areas [m^2] that a field is fitted to, at any wavelength."""

    points: np.ndarray
    normals: np.ndarray
    areas: np.ndarray

    def solved(self, wavelength: float, probes: np.ndarray) -> tuple[SplineSurface, float, float]:
        r"""Fit the field of one wavelength [m].

        Args:
            wavelength: The wavelength $\ell$ of the waves to halve.
            probes: Shape (k, n), vectors of random signs z.

        Returns:
            The surface; the mean square of the points' distances from it [m^2]; and $\mathrm{tr}\,H / n$,
            where H maps the points' heights to those of the fit, estimated as the mean of $z^T H z / n$
            (Hutchinson).
        """
        from scipy.linalg import cho_solve_banded, cholesky_banded

        grid = grid_around(self.points, wavelength / _CELLS, _ROOM)
        scale = wavelength / (2.0 * np.pi * grid.step)
        data, around = rows(grid, self.points), offsets(grid)
        # Everything in cells: areas, and the wavelength over 2 pi, `scale`.
        value = self.areas / grid.step**2
        slope = _SLOPE * scale**2 * value
        # I - 0.9 n n^T: what is along the normal counts a tenth, its square a hundredth.
        flat = np.eye(3) - (1.0 - _LENGTH) * self.normals[:, :, None] * self.normals[:, None, :]
        band = normal_band(grid, data, value, np.sqrt(slope)[:, None, None] * flat)
        band += 3.0 / 16.0 * scale**5 * roughness_band(grid)
        factor = (cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False), True)
        # The right-hand side G^T G n: `flat` times itself takes n to a hundredth of n.
        right = np.zeros(band.shape[1])
        for k, axis in enumerate(AXES):
            pull = _LENGTH**2 * slope * self.normals[:, k]
            _scatter(right, data, around, data.field(axis) * pull[:, None])
        found = cho_solve_banded(factor, right, check_finite=False)
        functions = data.field((0, 0, 0))
        places = data.base[:, None] + around[None, :]
        near = found[places]
        lengths = np.linalg.norm([np.sum(data.field(axis) * near, axis=1) for axis in AXES], axis=0)
        # The weak term along the normal lets noise shorten the gradient everywhere. The zero set does not
        # depend on the scale of F, which is chosen so that the median gradient has length one, as that of a
        # distance.
        surface = _surface(grid, found / np.median(lengths))
        square = float(np.mean((grid.step * np.sum(functions * near, axis=1) / lengths) ** 2))
        # The distance of a point from the zero set is |F| / |grad F| to first order (above).
        used = 0.0
        for probe in probes:
            right = np.zeros(band.shape[1])
            _scatter(right, data, around, functions * (value * probe)[:, None])
            answer = cho_solve_banded(factor, right, check_finite=False)
            used += float(probe @ np.sum(functions * answer[places], axis=1)) / probes.size
        return surface, square, used


def _surface(grid: Grid, found: np.ndarray) -> SplineSurface:
    """The surface of a field from its unknowns in their order; the field is turned from cells into metres."""
    order = np.argsort(grid.strides)[::-1]  # slowest axis first, as the unknowns run
    block = found.reshape([grid.counts[k] for k in order])
    return SplineSurface(np.transpose(block, np.argsort(order)) * grid.step, grid.origin, grid.step)


def _scatter(right: np.ndarray, data: DataRows, around: np.ndarray, values: np.ndarray) -> None:
    """Add values of shape (n, 216), one for each function at each point, to the entries of their unknowns."""
    places = (data.base[:, None] + around[None, :]).ravel()
    right += np.bincount(places, values.ravel(), minlength=len(right))


def _chosen(problem: _Problem, noise: float | None) -> float:
    r"""The longest wavelength of a ladder below which the estimated error hardly falls.

    From 0.56 of the largest extent on, each three quarters of the one before. The estimate is generalised
    cross-validation, $\overline{r^2} / (1 - \mathrm{tr}\,H/n)^2$, or with a known noise $\sigma$ that of
    Mallows, $\overline{r^2} + 2 \sigma^2\,\mathrm{tr}\,H/n$. A grid too fine for the memory ends the ladder.
    """
    size = float(np.ptp(problem.points, axis=0).max())
    probes = np.random.default_rng(0).choice([-1.0, 1.0], size=(_PROBES, len(problem.points)))
    best, chosen = np.inf, size
    for wavelength in size * 0.75 ** np.arange(2, 12):
        try:
            _, square, used = problem.solved(wavelength, probes)
        except ValueError:
            break
        score = square / (1.0 - used) ** 2 if noise is None else square + 2.0 * noise**2 * used
        if score > _GAIN * best:
            break
        best, chosen = score, wavelength
    return float(chosen)


def _deviation(noise: Given) -> float:
    """The noise's standard deviation [m] as a number."""
    seen = concrete(as_floats("noise", noise, ()))
    if seen is None or seen < 0.0:
        raise ValueError(f"argument noise must be a known number from 0 up, but was {shown(noise)}")
    return float(seen)


def _cloud(name: str, value: Given) -> np.ndarray:
    """An argument as numbers of shape (n, 3), at least 100 rows."""
    seen = concrete(as_floats(name, value, (None, 3)))
    if seen is None:
        raise ValueError(f"argument {name} must be concrete numbers, but was traced: fitting is set-up")
    if len(seen) < 100:
        raise ValueError(f"argument {name} must have at least 100 rows, but had {len(seen)}")
    return np.asarray(seen, float)


def _reported(surface: SplineSurface, problem: _Problem, wavelength: float, given: bool) -> SurfaceFit:
    """The fit with its report; `given` says whether the normals are the caller's, to be compared."""
    points = jnp.asarray(problem.points)
    feet, normals, curvatures = (np.asarray(x) for x in _measured(surface, points))
    if not np.all(np.isfinite(curvatures)):
        raise ValueError("argument points must determine a surface, but the fit to them is not finite")
    distances = np.linalg.norm(feet - problem.points, axis=1)
    turned = np.arccos(np.clip(np.sum(normals * problem.normals, axis=1), -1.0, 1.0))
    cells = tuple(n - 5 for n in surface.coefficients.shape)
    report = SurfaceReport(
        points=len(points),
        area=float(problem.areas.sum()),
        smoothing=wavelength,
        cells=(cells[0], cells[1], cells[2]),
        step=float(surface.step),
        rms=float(np.sqrt(np.mean(distances**2))),
        largest=float(distances.max()),
        normals=(float(np.sqrt(np.mean(turned**2))), float(turned.max())) if given else None,
        curvature=(float(curvatures.min()), float(curvatures.max())),
        smoothness=surface.smoothness,
    )
    return SurfaceFit(surface, points, jnp.asarray(feet), report)


@jax.jit
def _measured(surface: SplineSurface, points: Array) -> tuple[Array, Array, Array]:
    """Feet [m], unit normals and both principal curvatures [1/m] of the surface near the points."""

    def one(point: Array) -> tuple[Array, Array, Array]:
        at = surface.settled(surface.settled(tuple(point)))
        frame = surface.frame(at)
        found = principal(frame)
        return Vec3(*at).array(), frame.normal.array(), jnp.stack([found.low, found.high])

    return jax.lax.map(one, points, batch_size=1024)
