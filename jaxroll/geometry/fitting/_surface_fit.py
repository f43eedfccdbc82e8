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

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from threadpoolctl import threadpool_limits

from ..._results import (
    as_array,
    as_faces,
    as_floats,
    as_length,
    check_direction,
    check_length,
    on_host,
    shown,
)
from ..._types import Given
from ..contours import check_extent, check_finite_rows
from ..surfaces import SplineSurface, surface_values
from ._field_fit import AXES, DataRows, Grid, grid_around, normal_band, offsets, roughness_band, rows
from ._scan import normals_of_net, thinned_scan
from ._scan_verdict import fit_scan
from ._smoothing import check_alone
from ._surface_measured import angles, evenly, measured
from ._surface_normals import estimated, neighbourhoods, outward, volume_within
from ._surface_report import SurfaceFit, SurfaceReport

_CELLS = 2.5  # cells per wavelength of smoothing
_ROOM = 2.0  # cells between the points and the end of the grid
_SLOPE = 0.02  # weight of the normals' term against that of the points, for waves of the halved wavelength
_LENGTH = 0.1  # factor of the gradient's error along the normal; squared it is the weight, a hundredth
_PROBES = 2  # random vectors by which the trace of the influence matrix is estimated
_MANY = 50_000  # clouds of more points are thinned
_MEANS = 120  # cells of the thinning along the largest extent
_FAR = 5.0  # a point this many times farther away than is usual deserves a word
_TOLD = 4000  # normals, spread over the given ones, that tell which way these point
_ASTRAY = 1.0  # angle to given normals [rad] at which the surface and they do not belong together
_GAIN = 0.99  # a finer field must lower the estimated error by 1 %, or the coarser one is kept


@on_host
def fit_surface(
    points: Given,
    normals: Given | None = None,
    *,
    faces: Given | None = None,
    smallest_radius: float | None = None,
    smoothing: float | None = None,
    noise: float | None = None,
) -> SurfaceFit:
    r"""A smooth closed surface of any shape near scattered points: the zero set of a field of B-splines.

    Minimises, over quintic B-splines on a grid of cells of width $\ell / 2.5$,
    $$\int_S F^2 + \tfrac{1}{50} (\ell/2\pi)^2 |\nabla F - n|^2\,dA
    + \tfrac{3}{16} (\ell/2\pi)^5 \int |\mathrm{D}^3 F|^2\,dV,$$
    the first integral as a sum over the points, each with the area it stands for, the second exactly. It
    halves a wiggle of wavelength $\ell$ on the surface and leaves longer ones. The part of $\nabla F - n$
    along $n$ counts a hundredth: a field that is the distance would have to be rough, one that is a
    quadric need not. The linear system has a band; Cholesky's method takes seconds.

    With `smallest_radius` r, for scans: no principal curvature of the surface exceeds 1/r anywhere, which is
    looked at all over it. Holes, missing bottoms and open sides are closed smoothly. $\ell$ is the longest
    from 2.4 r up that predicts points not used as well as the shortest; it may be 1.6 r where that predicts
    them better still and keeps the bound. What a ball of radius r cannot touch
    from inside and from outside, edges and notches, is rounded off, and nothing else moved; parts thinner
    than 2 r are thickened, or rounded off where they are thinner than r. The report says how far and where,
    and `SurfaceFit.trusted` where the surface is known.

    Args:
        points: Shape (n, 3) [m], n at least 100, all over a closed surface; with `smallest_radius` it may
            have holes. With `faces` the vertices of a mesh, of which those of no face are left out; with
            both, four are enough.
        normals: Outward normals, shape (n, 3); None: of the faces, or from planes through neighbours, turned
            alike.
        faces: Triangles of a mesh, shape (m, 3): numbers of its vertices.
        smallest_radius: Of curvature [m]. Best somewhat smaller than that of the parts to be touched.
        smoothing: Wavelength $\ell$ [m], at most 100 times the largest extent of the points; None: by
            generalised cross-validation, or from `noise`. Not with `smallest_radius`, which chooses it.
        noise: Standard deviation of each coordinate [m], at most a tenth of the largest extent, where it is
            known and `smoothing` is not.

    Returns:
        `SurfaceFit`, with `surface` and `report`.

    Accuracy: 20 000 points 0.1 mm off an ellipsoid of half axes 20, 14 and 10 mm, nothing else given: 10 um
    in the point, 0.12 degrees in the normal and 0.6 % in both principal curvatures, at most. Quadrics are met
    without bias; elsewhere details shorter than $\ell$ are lost.

    Raises:
        ValueError: If the points are not finite, too few or in parts, a normal is zero, the given ones point
            into the body, `smoothing` or `noise` is out of range, or the grid is too fine for the
            memory. With `smallest_radius` also if the points enclose no body or more than one, too much of it
            is thinner than two radii, too little is covered by points, or the curvature cannot be met.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> u = np.random.default_rng(0).normal(size=(1000, 3))
        >>> fit = jxr.geometry.fit_surface(0.02 * u / np.linalg.norm(u, axis=1)[:, None], smoothing=0.02)
        >>> bool(np.all(np.abs(0.02 * fit.surface.principal_curvatures(fit.feet)[0] - 1) < 0.01))
        True
    """
    cloud = _cloud("points", points, 100 if faces is None or smallest_radius is None else 4)
    check_extent("points", cloud)
    triangles = None if faces is None else as_faces(faces, len(cloud))
    given = None if normals is None else _directions(normals, cloud, triangles)
    if smallest_radius is not None:
        radius = float(as_length("smallest_radius", smallest_radius))
        for name, value in (("smoothing", smoothing), ("noise", noise)):
            if value is not None:
                raise ValueError(
                    f"argument {name} must be left out with smallest_radius, but was {shown(value)}"
                )
        with _one_thread():
            return fit_scan(cloud, given, triangles, radius)
    if triangles is not None:
        used = np.unique(triangles)
        directions = normals_of_net(cloud, triangles)[0][used] if given is None else given[used]
        cloud = cloud[used]
        # Those of faces are turned outward, whichever way the faces run round.
        given = outward(cloud, directions, np.ones(len(used))) if given is None else directions
    if given is None:
        cloud = np.unique(cloud, axis=0)
    with _one_thread():
        return _smoothed(cloud, given, *_lengths(cloud, smoothing, noise))


def _lengths(
    cloud: np.ndarray, smoothing: Given | None, noise: Given | None
) -> tuple[float | None, float | None]:
    """The wavelength and the noise [m], of which one may be given, if they suit the extent of the points."""
    check_alone(noise, smoothing)
    size = float(np.ptp(cloud, axis=0).max())
    check_length("noise", noise, 0.1 * size)
    wavelength = None if smoothing is None else float(as_length("smoothing", smoothing))
    # In the cells of a much longer one the surface is so small that its curvature is lost in rounding.
    check_length("smoothing", wavelength, 100.0 * size)
    return wavelength, None if noise is None else float(np.asarray(noise))


def _one_thread() -> threadpool_limits:
    """Inside, BLAS keeps to one thread: on products as small as these others only wait for each other.

    The fit of a scan of 8 000 points took 26 s of processor time with two threads, 16 s with one.
    """
    return threadpool_limits(limits=1, user_api="blas")


def _smoothed(
    cloud: np.ndarray, given: np.ndarray | None, smoothing: float | None, noise: float | None
) -> SurfaceFit:
    """The fit of one wavelength, or of the one that cross-validation finds."""
    problem = _many(cloud, given) if len(cloud) > _MANY else _few(cloud, given)
    if smoothing is None:
        smoothing, surface = _chosen(problem, noise)
    else:
        surface = problem.solved(smoothing, np.zeros((0, len(problem.points))))[0]
    return _reported(surface, problem, smoothing, cloud, given)


def _few(cloud: np.ndarray, given: np.ndarray | None) -> "_Problem":
    """The problem of all points."""
    neighbours, areas = neighbourhoods(cloud)
    found = outward(cloud, estimated(cloud, neighbours), areas) if given is None else given
    return _Problem(cloud, found, areas)


def _many(cloud: np.ndarray, given: np.ndarray | None) -> "_Problem":
    """The problem of the means of a large cloud's points in small cells."""
    width = float(np.ptp(cloud, axis=0).max()) / _MEANS
    scan, _ = thinned_scan(cloud, given, width)
    return _Problem(scan.points, scan.normals, scan.areas)


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
        from scipy.linalg import cho_solve_banded

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
        factor = (_factor(band), True)
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


def _factor(band: np.ndarray) -> np.ndarray:
    """The triangular factor of the normal equations, which takes their place.

    Raises:
        ValueError: If the points leave some of the field open.
    """
    from scipy.linalg import cholesky_banded

    try:
        return cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
    except np.linalg.LinAlgError:
        raise ValueError(
            "argument points must tell the field of a surface, but they leave it open, as those do that lie "
            "exactly in a plane or on a line"
        ) from None


def _surface(grid: Grid, found: np.ndarray) -> SplineSurface:
    """The surface of a field from its unknowns in their order; the field is turned from cells into metres."""
    order = np.argsort(grid.strides)[::-1]  # slowest axis first, as the unknowns run
    block = found.reshape([grid.counts[k] for k in order])
    return SplineSurface(np.transpose(block, np.argsort(order)) * grid.step, grid.origin, grid.step)


def _scatter(right: np.ndarray, data: DataRows, around: np.ndarray, values: np.ndarray) -> None:
    """Add values of shape (n, 216), one for each function at each point, to the entries of their unknowns."""
    places = (data.base[:, None] + around[None, :]).ravel()
    right += np.bincount(places, values.ravel(), minlength=len(right))


def _chosen(problem: _Problem, noise: float | None) -> tuple[float, SplineSurface]:
    r"""The longest wavelength of a ladder below which the estimated error hardly falls, and its surface.

    From 0.56 of the largest extent on, each three quarters of the one before. The estimate is generalised
    cross-validation, $\overline{r^2} / (1 - \mathrm{tr}\,H/n)^2$, or with a known noise $\sigma$ that of
    Mallows, $\overline{r^2} + 2 \sigma^2\,\mathrm{tr}\,H/n$. A grid too fine for the memory ends the ladder.
    """
    size = float(np.ptp(problem.points, axis=0).max())
    probes = np.random.default_rng(0).choice([-1.0, 1.0], size=(_PROBES, len(problem.points)))
    best, chosen = np.inf, None
    for wavelength in size * 0.75 ** np.arange(2, 12):
        try:
            surface, square, used = problem.solved(wavelength, probes)
        except ValueError:
            if chosen is None:
                raise
            break
        score = square / (1.0 - used) ** 2 if noise is None else square + 2.0 * noise**2 * used
        if score > _GAIN * best:
            break
        best, chosen = score, (float(wavelength), surface)
    assert chosen is not None  # the first score is no larger than infinity
    return chosen


def _directions(normals: Given, cloud: np.ndarray, triangles: np.ndarray | None) -> np.ndarray:
    """The given normals scaled to length one, if they point out of the body, as far as some of them tell.

    Of a mesh those of vertices that no triangle has tell nothing.
    """
    given = _cloud("normals", normals, 1)
    if given.shape != cloud.shape:
        raise ValueError(f"argument normals must have shape {cloud.shape}, but had shape {given.shape}")
    check_direction("normals", jnp.asarray(given))
    unit = given / np.linalg.norm(given, axis=1, keepdims=True)
    used = np.arange(len(cloud)) if triangles is None else np.unique(triangles)
    some = used[:: -(-len(used) // _TOLD)]
    if volume_within(cloud[some], unit[some], neighbourhoods(cloud[some])[1]) < 0.0:
        raise ValueError(
            "argument normals must point out of the body, but on the whole they point into it; without them "
            "they are found from the points"
        )
    return unit


def _cloud(name: str, value: Given, least: int = 100) -> np.ndarray:
    """An argument as numbers of shape (n, 3), so many rows at least."""
    seen = np.asarray(as_array(name, value))
    if seen.ndim == 2 and seen.shape[1] == 3:
        check_finite_rows(name, seen)
    seen = np.asarray(as_floats(name, value, (None, 3)))
    if len(seen) < least:
        raise ValueError(f"argument {name} must have at least {least} rows, but had {len(seen)}")
    return np.asarray(seen, float)


def _reported(
    surface: SplineSurface,
    problem: _Problem,
    wavelength: float,
    cloud: np.ndarray,
    given: np.ndarray | None,
) -> SurfaceFit:
    """The fit with its report; `given` are the caller's normals, to be compared."""
    each = evenly(len(cloud))
    feet, normals, curvatures = measured(surface, jnp.asarray(cloud[each]))
    if not np.all(np.isfinite(curvatures)):
        raise ValueError("argument points must determine a surface, but the fit to them is not finite")
    distances = np.linalg.norm(feet - cloud[each], axis=1)
    cells = tuple(n - 5 for n in surface.coefficients.shape)
    curvature = (float(curvatures.min()), float(curvatures.max()))
    spacing = float(np.median(np.sqrt(problem.areas)))
    rms, largest = float(np.sqrt(np.mean(distances**2))), float(distances.max())
    turned = None if given is None else angles(normals, given[each])
    off = 0.0 if turned is None else turned[0]
    closed = _is_closed(surface)
    verdict, doubts = _verdict(curvature, wavelength, rms, largest, turned=off, closed=closed)
    report = SurfaceReport(
        points=len(cloud),
        area=float(problem.areas.sum()),
        smoothing=wavelength,
        cells=(cells[0], cells[1], cells[2]),
        step=float(surface.step),
        rms=rms,
        largest=largest,
        normals=turned,
        curvature=curvature,
        smoothness=surface.smoothness,
        verdict=verdict,
        doubts=doubts,
        reach=3.0 * spacing,
        tolerance=max(_FAR * rms, 1e-3 * wavelength),
    )
    return SurfaceFit(surface, jnp.asarray(cloud[each]), jnp.asarray(feet), report)


def _is_closed(surface: SplineSurface) -> bool:
    """Whether all faces of the grid are outside of the body."""
    values = surface_values(surface, 1)
    values[1:-1, 1:-1, 1:-1] = np.inf
    return bool(values.min() > 0.0)


def _verdict(
    curvature: tuple[float, float],
    wavelength: float,
    rms: float,
    largest: float,
    *,
    turned: float = 0.0,
    closed: bool = True,
) -> tuple[str, tuple[str, ...]]:
    """Whether a surface of one wavelength looks like its points, and what speaks against it, by clauses.

    `turned`: from given normals, rms [rad].
    """
    if turned > _ASTRAY:
        off = f"its normals are {np.degrees(turned):.3g} degrees rms off those given"
        doubts = (f"{off}, which do not all point out of one body",)
        return f"not to be trusted: {doubts[0]}; without them they are found from the points", doubts
    signs = [] if closed else ["it encloses no body"]
    # No wave that smoothing leaves is shorter than its wavelength by much; its sharpest bend has a radius
    # about that over 2 pi.
    sharpest = max(-curvature[0], curvature[1])
    if sharpest * wavelength > 2.0 * np.pi:
        signs.append(f"it bends with a radius of {1e3 / sharpest:.3g} mm")
    if largest > _FAR * rms and largest > 0.05 * wavelength:
        signs.append(f"a point is {1e3 * largest:.3g} mm off it")
    if not signs:
        return f"the points lie {1e6 * rms:.3g} um rms from it, and it bends no more than its smoothing", ()
    return f"not to be trusted: {' and '.join(signs)}; give smallest_radius", tuple(signs)
