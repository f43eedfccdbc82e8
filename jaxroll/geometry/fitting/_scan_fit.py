r"""From a scan to one smooth closed surface whose radii of curvature are bounded from below. NumPy.

The steps: the scan is thinned (`_scan`), the body that it encloses found (`_indicator`), and a field of
B-splines fitted to the scan, to that body where the scan has holes, and loosely to the distance from it
elsewhere, so that the field has no other zeros (`_field_solve`). If the field's zero set is curved too much
anywhere, the scan or the surface is rolled by balls inside and outside (`_rolling`) and the field fitted
again to that, with larger balls until the curvature is met. It is looked at on a net over the whole zero set,
finer than the field's cells. `_surface_fit` is the door, and says when to refuse.
"""

import contextlib
import math
from dataclasses import dataclass, replace
from typing import cast

import jax.numpy as jnp
import numpy as np

from ..surfaces import ORDER, SplineSurface, surface_net, surface_values
from ._field_fit import Grid
from ._field_solve import FieldTargets, solved
from ._indicator import Body, enclosed
from ._rolling import rolled, RolledBody
from ._scan import normals_of_net, Scan, thinned_scan
from ._surface_measured import levels_at, measured

_FINE = 0.25  # width of the scan's cells, in smallest radii
_WAVE = 2.4  # shortest wavelength of smoothing, in smallest radii
_LADDER = 1.5  # ratio of the wavelengths that are tried
_CELLS = 2.5  # cells per wavelength
_PER_CELL = 2.5  # data per cell, along an axis, of a scan of
_DATA = 12_000  # points; more of smaller ones
_ROOM = 2.5  # cells between the points and the end of the grid
_MOST = 1_500_000  # most coefficients
_SLOPE, _LENGTH = 0.005, 0.3  # weight of the normals' term, and factor of the error along the normal in it
_AWAY, _HOLD = 1.5, 1e-4  # cells from the surface where the distance is asked for, and with what weight
_BRIDGE = 0.1  # weight of a hole's filling
_FINER = 60_000  # most coefficients for which shorter wavelengths are tried
_GAIN = 0.99  # a shorter wavelength must lower the error at points not used by 1 %
_SAMPLES = 3  # nodes of the net per cell
_CLIMBS, _CLIMBED = 5, 256  # steps to the largest curvature, from so many vertices
_NOISE = 0.02  # how far a point may reach into a ball that touches another one, in radii
_BALLS = 1.1  # radius of the first balls, in smallest radii: the fit to what was rolled is a little sharper
_LARGER = (1.03, 1.3)  # least and largest factor of the next balls
_ROUNDS = 6
_SPARSE = 0.5  # distance of neighbours, in smallest radii, from which balls may fall between them
# Points this many steps of the grid off the body that all enclose, and half a smallest radius, are left out
# if they are less than this share.
_OFF, _LOST = 2.5, 0.03
_TURNS = 4  # times that normals are turned round


@dataclass(frozen=True)
class Closed:
    """A smooth closed surface through a scan.

    Attributes:
        surface: The surface.
        wavelength: Wavelength of smoothing [m].
        scan: The scan as it was used; its last points fill holes, and lie on the body that the scan encloses.
        filled: Number of those points.
        rolled: Where balls of the smallest radius can touch the scan.
        vertices: Of a net on the surface [m], shape (n, 3).
        areas: That its vertices stand for [m^2].
        curvatures: Least and largest principal curvature anywhere [1/m].
        parts: Numbers of regions in which the field is negative and positive.
        reach: Farthest from a point of the scan that a place counts as covered [m].
        apart: Which of the given points were left out, shape (m,).
    """

    surface: SplineSurface
    wavelength: float
    scan: Scan
    filled: int
    rolled: RolledBody
    vertices: np.ndarray
    areas: np.ndarray
    curvatures: tuple[float, float]
    parts: tuple[int, int]
    reach: float
    apart: np.ndarray


def closed_through(points: np.ndarray, normals: np.ndarray | None, radius: float) -> Closed:
    """The smooth surface of points [m] whose radii of curvature shall be at least `radius` [m].

    Raises:
        ValueError: If the points are no scan of one body, or no ball of that radius fits into it.
    """
    from scipy.spatial import KDTree

    size = float(np.ptp(points, axis=0).max())
    if 2.0 * radius > size:
        raise ValueError(
            f"argument smallest_radius must leave room for a ball of that radius in a body of {size:.3g} m, "
            f"but was {radius:.3g} m"
        )
    scan, numbers = thinned_scan(points, normals, max(_FINE * radius, size / 400.0))
    body, scan = _body(scan, radius, given=normals is not None)
    off = KDTree(body.vertices).query(scan.points, workers=-1)[0] > max(_OFF * body.step, 0.5 * radius)
    share = float(np.mean(off[numbers[numbers >= 0]]))
    if 0.0 < share < _LOST:
        scan, numbers = scan.without(off, numbers)
        body, scan = _body(scan, radius, given=True)
    scan = scan.joined(0.5 * radius)
    apart = numbers < 0
    reach = max(3.0 * scan.spacing, 0.5 * radius)
    whole, filled = _filled(scan, body, reach)
    problem = _Problem(whole, filled, body)
    wavelength = _chosen(problem, points[~apart], radius)
    found, shape = _raised(problem, wavelength, points, numbers)
    if radius * shape.sharpest <= 1.0:
        finer = _finer(problem, wavelength, radius)
        other = None if finer is None else _raised(problem, finer, points, numbers)
        if finer and other and radius * other[1].sharpest <= 1.0:
            wavelength, (found, shape) = finer, other
    touched = _rolled(whole, radius)
    if radius * shape.sharpest > 1.0:
        wavelength = _WAVE * radius
        found, shape = _bent_less(problem, (found, shape), radius)
    return Closed(
        found, wavelength, whole, filled, touched, shape.vertices, shape.areas, shape.curvatures, shape.parts,
        reach, apart,
    )  # fmt: skip


def _raised(
    problem: "_Problem", wavelength: float, points: np.ndarray, numbers: np.ndarray
) -> tuple[SplineSurface, "_Shape"]:
    """The surface of one wavelength [m] through the points themselves, of which the scan has means."""
    found = problem.fitted(problem.whole, wavelength)
    levels = _levels(found, problem.whole, points, numbers)
    found = problem.fitted(problem.whole, wavelength, (found, levels))
    return found, _looked_at(found)


def _levels(surface: SplineSurface, whole: Scan, points: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Means of the surface's field [m] over the points that each point of the scan stands for."""
    used = numbers >= 0
    values, count = levels_at(surface, points[used]), len(whole.points)
    hits = np.bincount(numbers[used], minlength=count)
    sums = np.bincount(numbers[used], values, count)
    alone = levels_at(surface, whole.points)
    return np.where(hits > 0, sums / np.maximum(hits, 1), alone)


def _body(scan: Scan, radius: float, *, given: bool) -> tuple[Body, Scan]:
    """The body that a scan encloses, and the scan with no normal sure that contradicts it.

    Those that were not given are turned round.
    """
    step = max(_FINE * radius, 0.75 * scan.spacing)
    for _ in range(_TURNS):
        body = enclosed(scan, step)
        ahead, behind = (body.at(scan.points + side * body.step * scan.normals) for side in (1.0, -1.0))
        turned = ahead < behind
        if given or turned.mean() < 1e-3:
            break
        scan = replace(scan, normals=np.where(turned[:, None], -scan.normals, scan.normals))
    return body, replace(scan, sure=np.where(turned, 0.0, scan.sure))


def _filled(scan: Scan, body: Body, reach: float) -> tuple[Scan, int]:
    """The scan with points of the body's surface wherever it has none within `reach`, and their number."""
    from scipy.spatial import KDTree

    normals, areas = normals_of_net(body.vertices, body.triangles)
    far = KDTree(scan.points).query(body.vertices, workers=-1)[0] > reach
    net = Scan(body.vertices, normals, _BRIDGE * areas, np.ones(len(body.vertices)), scan.spacing)
    return scan.with_others(net.part(far)), int(far.sum())


def _bent_less(
    problem: "_Problem", first: tuple[SplineSurface, "_Shape"], radius: float
) -> tuple[SplineSurface, "_Shape"]:
    """A surface of the scan with radii of curvature of at least `radius` [m], if one is found.

    Balls roll on the scan, or on the net of the surface that was fitted last. A net is dense and smooth where
    a scan is sparse, but the first surface through sharp edges waves beside them. So where points are far
    apart, or the scan leads to none, both are tried, and what lies nearer to the scan is taken. Of a banana
    with 3000 points rolling the scan cuts off up to 26 mm, and one of ten such scans is refused; nets cut off
    1 mm. Of a box whose edges are sharp nets move the faces by 2 mm, the scan by 0.2 mm.
    """
    whole, tries = problem.whole, [_in_rounds(problem, first, radius, by_net=False)]
    if whole.spacing <= _SPARSE * radius and radius * tries[0][1].sharpest <= 1.0:
        return tries[0]
    with contextlib.suppress(ValueError):  # where no ball fits on the way, or no surface is left
        tries.append(_in_rounds(problem, first, radius, by_net=True))
    return min(tries, key=lambda one: (radius * one[1].sharpest > 1.0, _misfit(whole, one[1])))


def _in_rounds(
    problem: "_Problem", first: tuple[SplineSurface, "_Shape"], radius: float, *, by_net: bool
) -> tuple[SplineSurface, "_Shape"]:
    """The surface of the scan rolled by larger and larger balls, until it bends with `radius` [m]."""
    (found, shape), moved, balls = first, problem.whole, _BALLS * radius
    for _ in range(_ROUNDS):
        moved = _rounded_by_net(moved, shape, balls) if by_net else _rounded(problem.whole, balls)
        found = problem.fitted(moved, _WAVE * radius)
        shape = _looked_at(found)
        if radius * shape.sharpest <= 1.0:
            break
        balls *= float(np.clip(radius * shape.sharpest, *_LARGER))
    return found, shape


def _misfit(scan: Scan, shape: "_Shape") -> float:
    """Sum of the squares of the scan's distances from a surface, by area [m^4]."""
    from scipy.spatial import KDTree

    return float(np.sum(scan.areas * KDTree(shape.vertices).query(scan.points, workers=-1)[0] ** 2))


def _rounded(whole: Scan, radius: float) -> Scan:
    """The scan with its points where balls roll."""
    target = _rolled(whole, radius)
    return replace(whole, points=target.points, normals=target.normals)


def _rounded_by_net(scan: Scan, shape: "_Shape", radius: float) -> Scan:
    """The scan; where the surface fitted to it bends too much, points of that surface, rolled by balls."""
    from scipy.spatial import KDTree

    # Surfaces compute in single precision unless JAX is told otherwise; balls are rolled in double.
    places, normals, areas = (np.asarray(x, float) for x in (shape.vertices, shape.normals, shape.areas))
    net = Scan(places, normals, areas, np.ones(len(places)), scan.spacing)
    target = _rolled(net, radius)
    kept = target.free[KDTree(net.points).query(scan.points, workers=-1)[1]]
    new = replace(net, points=target.points, normals=target.normals).part(~target.free)
    return scan.part(kept).with_others(new)


def _rolled(whole: Scan, radius: float) -> RolledBody:
    """The scan rolled by balls.

    Raises:
        ValueError: If no ball fits.
    """
    found = rolled(whole, radius, _NOISE * radius)
    if found is None:
        raise ValueError(
            f"argument smallest_radius must leave room for balls of that radius inside and outside the "
            f"body, but of {radius:.4g} m none fits"
        )
    return found


@dataclass(frozen=True)
class _Problem:
    """A scan, the number of its points that fill holes, and the body it encloses."""

    whole: Scan
    filled: int
    body: Body

    def fitted(
        self, scan: Scan, wavelength: float, base: tuple[SplineSurface, np.ndarray] | None = None
    ) -> SplineSurface:
        """The surface through a scan of one wavelength [m].

        Args:
            scan: Its points may be means of many.
            wavelength: Of smoothing.
            base: A surface near the solution, and the mean of its field over those points that each point of
                the scan is the mean of: that lies below a convex surface, and is raised by as much.
        """
        step = wavelength / _CELLS
        levels = np.zeros(len(scan.points)) if base is None else base[1]
        width = step / _PER_CELL * min(1.0, len(scan.points) / _DATA)
        data, means = scan.averaged(width, levels)
        heights = 0.0 * means if base is None else levels_at(base[0], data.points) - means
        grid = _grid(self.whole.points, step)
        held, distances = _distances(grid, self.body)
        scale = wavelength / (2.0 * np.pi * step)
        zeros = np.zeros(len(held))
        targets = FieldTargets(
            np.concatenate([data.points, held]),
            np.concatenate([heights, distances]),
            np.concatenate([data.areas, zeros + _HOLD * step**2]),
            np.concatenate([data.normals, np.zeros_like(held)]),
            np.concatenate([_SLOPE * scale**2 * data.areas * data.sure, zeros]),
            _LENGTH,
        )
        start = np.zeros(grid.counts) if base is None else np.asarray(base[0].coefficients)
        found = solved(grid, targets, 3.0 / 16.0 * scale**5, start)
        return SplineSurface(found, grid.origin, step)


def _grid(points: np.ndarray, step: float) -> Grid:
    """A grid around the points with room on all sides.

    Raises:
        ValueError: If it has too many cells.
    """
    low, high = points.min(axis=0) - _ROOM * step, points.max(axis=0) + _ROOM * step
    cells = np.ceil((high - low) / step).astype(int)
    counts = (int(cells[0]) + ORDER - 1, int(cells[1]) + ORDER - 1, int(cells[2]) + ORDER - 1)
    if math.prod(counts) > _MOST:
        raise ValueError(
            f"argument smallest_radius must be larger for a body of {np.ptp(points, axis=0).max():.3g} m: "
            f"it asks for {' x '.join(map(str, cells))} cells"
        )
    return Grid(0.5 * (low + high) - 0.5 * step * cells, step, counts)


def _distances(grid: Grid, body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Every second node of the grid away from the body's surface, and its signed distance from it [m]."""
    from scipy.spatial import KDTree

    along = [
        grid.origin[k] + grid.step * np.arange(0, grid.counts[k] - ORDER + 2, 2, dtype=float)
        for k in range(3)
    ]
    nodes = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 3)
    distances = KDTree(body.vertices).query(nodes, workers=-1)[0]
    far = distances > _AWAY * grid.step
    return nodes[far], (distances * np.sign(body.at(nodes)))[far]


def _chosen(problem: _Problem, points: np.ndarray, radius: float) -> float:
    """The longest wavelength of a ladder [m] below which the error at points not used hardly falls.

    The ladder ends at 2.4 smallest radii; one rung more is for `_finer`.
    """
    size = float(np.ptp(points, axis=0).max())
    rungs = max(int(np.log(0.6 * size / (_WAVE * radius)) / np.log(_LADDER)), 0)
    ladder = _WAVE * radius * _LADDER ** np.arange(rungs, -1, -1.0)
    scores = [_score(problem, float(wavelength)) for wavelength in ladder]
    # All are tried: a few edges or points that lie off may hide from one rung what the next one gains.
    return float(ladder[np.argmax(np.array(scores) <= min(scores) / _GAIN)])


def _finer(problem: _Problem, wavelength: float, radius: float) -> float | None:
    """A shorter wavelength [m], if it still lowers the error at points not used.

    A surface that is smooth enough at 2.4 smallest radii may have bends that want 1.6.
    """
    finer = wavelength / _LADDER
    cells = np.prod(np.ptp(problem.whole.points, axis=0) * _CELLS / finer + 2.0 * _ROOM + ORDER)
    if wavelength > 1.01 * _WAVE * radius or cells > _FINER:
        return None
    return finer if _score(problem, finer) <= _GAIN * _score(problem, wavelength) else None


def _score(problem: _Problem, wavelength: float) -> float:
    """Error at every second point of the scan when the others are fitted, a sum of squares."""
    scan, held = problem.whole, len(problem.whole.points) - problem.filled
    # By lot: the scan is sorted by cells, so that every second point might be all of one side.
    drawn = np.random.default_rng(0).permutation(held)
    fitted, others = np.append(drawn[::2], np.arange(held, held + problem.filled)), drawn[1::2]
    surface = problem.fitted(scan.part(fitted), wavelength)
    misses = levels_at(surface, scan.points[others])
    return float(np.sum(scan.areas[others] * misses**2))


@dataclass(frozen=True)
class _Shape:
    """What `Closed` says of a surface."""

    vertices: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    curvatures: tuple[float, float]
    parts: tuple[int, int]

    @property
    def sharpest(self) -> float:
        """The largest curvature of either sign [1/m]."""
        return float(np.abs(self.curvatures).max())


def _looked_at(surface: SplineSurface) -> _Shape:
    """The whole zero set of a field, on a net of a third of its cells."""
    from scipy.ndimage import label

    values = surface_values(surface, _SAMPLES)
    vertices, triangles = surface_net(surface, _SAMPLES)
    if not len(triangles):
        raise ValueError("argument points must determine a closed surface, but the fit to them has none")
    feet, normals, curvatures = measured(surface, jnp.asarray(vertices))
    _, areas = normals_of_net(feet, triangles)
    sides = (values < 0.0, values > 0.0)
    parts = [cast(tuple[np.ndarray, int], label(side))[1] for side in sides]
    return _Shape(feet, normals, areas, _extremes(surface, feet, curvatures), (parts[0], parts[1]))


def _extremes(surface: SplineSurface, feet: np.ndarray, curvatures: np.ndarray) -> tuple[float, float]:
    """The least and the largest principal curvature [1/m], between the vertices of a net too.

    The search climbs from the vertices where either is most extreme, in steps that are halved.
    """
    if not np.all(np.isfinite(curvatures)):
        return np.nan, np.nan
    best = np.concatenate([np.argsort(curvatures[:, 0])[:_CLIMBED], np.argsort(-curvatures[:, 1])[:_CLIMBED]])
    which = np.repeat([0, 1], len(best) // 2)
    sign = 2.0 * which - 1.0
    places, values, each = feet[best], sign * curvatures[best, which], np.arange(len(best))
    step = 0.5 * float(surface.step) / _SAMPLES
    ways = np.concatenate([np.eye(3), -np.eye(3)])
    for _ in range(_CLIMBS):
        tried = (places[:, None] + step * ways).reshape(-1, 3)
        found, _, bends = measured(surface, jnp.asarray(tried))
        heights = sign[:, None] * bends.reshape(len(each), len(ways), 2)[each, :, which]
        chosen = each, np.argmax(heights, axis=1)
        higher = heights[chosen] > values
        places = np.where(higher[:, None], found.reshape(-1, len(ways), 3)[chosen], places)
        values = np.where(higher, heights[chosen], values)
        step *= 0.5
    return float(-values[which == 0].max()), float(values[which == 1].max())
