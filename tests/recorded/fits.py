"""The numbers of fits to made-up points: what each option does, all fields of the report, the shape itself.

That a fit is near its data, within its bounds and right in what it says is for other tests, with other data.
Records tell what no bound notices: a smoothing a tenth stronger, a cell fewer, a region's other corner.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxroll.geometry import Fit, fit_contour, fit_surface, NeuralCurvature, NeuralSupport, SurfaceFit
from tests.oracles.scanned_bodies import superellipsoid_cloud
from tests.recorded.compare import described

# Numbers are compared at this of the largest of their list: searches end where they are good enough, those of
# scans at a residual of 1e-4. Shapes have no symmetries, in which rounding would choose.
RTOL, SCANS = 1e-4, 1e-3


def _noise(seed: int, shape: tuple[int, ...], size: float = 1e-4) -> np.ndarray:
    return size * np.random.default_rng(seed).normal(size=shape)


def _ring(count: int, lobes: float = 0.1, seed: int = 0, size: float = 1e-4) -> np.ndarray:
    """Noisy points in order round a ring with three lobes [m]."""
    angles = 2.0 * np.pi * np.arange(count) / count
    radii = 0.03 * (1.0 + lobes * np.cos(3.0 * angles))
    return np.stack([radii * np.cos(angles), 0.7 * radii * np.sin(angles)], axis=-1) + _noise(
        seed, (count, 2), size
    )


def _scattered(points: np.ndarray) -> np.ndarray:
    return np.random.default_rng(9).permutation(points)


def _polygon(corners: list[tuple[float, float]], step: float = 1e-3, *, closed: bool = True) -> np.ndarray:
    """Points evenly along the sides of a polygon [m]."""
    ends = np.array([*corners, *corners[:1]] if closed else corners)
    sides = [
        start
        + np.linspace(0.0, 1.0, int(np.linalg.norm(end - start) / step), endpoint=False)[:, None]
        * (end - start)
        for start, end in zip(ends[:-1], ends[1:], strict=True)
    ]
    return np.concatenate(sides if closed else [*sides, ends[-1:]])


# A quadrangle, all of whose corners differ.
_QUADRANGLE = [(0.0, 0.0), (0.042, 0.003), (0.037, 0.031), (-0.004, 0.026)]
# A plate with a fin that is thinner than the discs, and a notch narrower than they.
_FINNED = [
    (0.0, 0.0), (0.05, 0.0), (0.05, 0.02), (0.032, 0.02), (0.031, 0.04), (0.027, 0.04), (0.026, 0.02),
    (0.014, 0.02), (0.013, 0.009), (0.010, 0.009), (0.009, 0.02), (0.0, 0.02),
]  # fmt: skip
_BENT = [(0.0, 0.0), (0.03, 0.0), (0.03, 0.02), (0.05, 0.03)]


def _strays(points: np.ndarray) -> np.ndarray:
    """Four of the points moved away."""
    moved = points.copy()
    moved[[10, 47, 90, 91]] *= np.array([1.2, 0.85, 1.1, 1.1])[:, None]
    return moved


def _arc(count: int) -> np.ndarray:
    x = np.linspace(0.0, 0.05, count)
    return np.stack([x, 0.01 * np.sin(80.0 * x)], axis=-1) + _noise(4, (count, 2), 5e-5)


# Of one body, so that fits to clouds of it have grids of as many cells and share programs.
_HALF, _POWER = np.array([0.02, 0.016, 0.014]), 2.5


def _cloud(count: int) -> np.ndarray:
    rng = np.random.default_rng(count)
    cloud = superellipsoid_cloud(rng, tuple(_HALF), _POWER, count)
    return cloud + 1e-4 * rng.normal(size=cloud.shape)


def _torus(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and unit normals of a torus of radii 25 and 10 mm."""
    u, v = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, (2, count))
    normals = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=-1)
    rings = np.stack([np.cos(u), np.sin(u), 0.0 * u], axis=-1)
    return 0.025 * rings + 0.01 * normals + _noise(6, (count, 3)), normals


def _brick() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a brick, all of whose corners differ."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    lean = np.array([[1.0, 0.1, 0.05], [0.0, 1.0, 0.15], [0.08, 0.0, 1.0]])
    corners = (
        signs * np.array([0.02, 0.015, 0.0125]) @ lean * (1.0 + 0.04 * signs[:, :1] + 0.03 * signs[:, 1:2])
    )
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def _hollow() -> np.ndarray:
    """A cloud without its lower part, and with a patch missing at its side."""
    cloud = _cloud(3000)
    return cloud[(cloud[:, 2] > -0.011) & ~((cloud[:, 0] > 0.012) & (np.abs(cloud[:, 1]) < 0.005))]


def _stray_cloud() -> np.ndarray:
    cloud = _cloud(900)
    cloud[[3, 500, 800]] *= np.array([1.3, 1.25, 0.8])[:, None]
    return cloud


def _turned() -> SurfaceFit:
    """A twentieth of the normals point inwards."""
    points = _cloud(700)
    slopes = np.sign(points) * np.abs(points / _HALF) ** (_POWER - 1.0) / _HALF
    signs = np.where(np.arange(700) % 20 == 0, -1.0, 1.0)
    normals = (signs / np.linalg.norm(slopes, axis=1))[:, None] * slopes
    return fit_surface(points, normals, smallest_radius=0.008)


def _meshed() -> SurfaceFit:
    vertices, faces = _brick()
    return fit_surface(vertices, faces=faces, smallest_radius=0.005)


FITS: dict[str, Callable[[], Fit | SurfaceFit]] = {
    "contour": lambda: fit_contour(_ring(120)),
    "contour_scattered": lambda: fit_contour(_scattered(_ring(120))),
    "contour_clockwise_mm": lambda: fit_contour(1e3 * _ring(120)[::-1], unit="mm"),
    "contour_reversed": lambda: fit_contour(_ring(120), reverse=True),
    "contour_noise": lambda: fit_contour(_ring(120), noise=3e-4),
    "contour_smoothing": lambda: fit_contour(_ring(120), smoothing=1e-9),
    "contour_knots": lambda: fit_contour(_ring(120), knots=12),
    # Cross-validation of exact points would choose between smoothings that differ by rounding.
    "contour_exact": lambda: fit_contour(_ring(120, size=0.0), noise=0.0),
    "contour_open": lambda: fit_contour(_arc(120), closed=False),
    "contour_corners": lambda: fit_contour(_polygon(_QUADRANGLE, 1.138e-3)),
    "contour_support": lambda: fit_contour(_ring(120, 0.0, size=1e-5), field="support"),
    "contour_radius": lambda: fit_contour(_ring(120), smallest_radius=0.008),
    "contour_radius_corners": lambda: fit_contour(_polygon(_QUADRANGLE), smallest_radius=0.006),
    "contour_radius_finned": lambda: fit_contour(_polygon(_FINNED, 5e-4), smallest_radius=0.003),
    "contour_radius_strays": lambda: fit_contour(_strays(_ring(120)), smallest_radius=0.008),
    "contour_radius_open": lambda: fit_contour(
        _polygon(_BENT, closed=False), closed=False, smallest_radius=0.004
    ),
    "contour_radius_noise": lambda: fit_contour(_ring(120), smallest_radius=0.008, noise=2e-4),
    "surface": lambda: fit_surface(_cloud(500)),
    "surface_normals": lambda: fit_surface(*_torus(500)),
    "surface_smoothing": lambda: fit_surface(_cloud(500), smoothing=0.0115),
    "surface_noise": lambda: fit_surface(_cloud(500), noise=3e-4),
    "scan": lambda: fit_surface(_cloud(700), smallest_radius=0.008),
    "scan_holes": lambda: fit_surface(_hollow(), smallest_radius=0.008),
    "scan_strays": lambda: fit_surface(_stray_cloud(), smallest_radius=0.008),
    "scan_normals": _turned,
    "scan_mesh": _meshed,
}


# Those that take longest to no other end than the rest.
SLOW = ("scan_mesh", "scan_strays")
# Networks after a few steps of their descent: where it goes.
NETWORKS = {
    "curvature": lambda: NeuralCurvature.fit(_ring(40), key=jax.random.key(1), steps=3, harmonics=6, width=8),
    "support": lambda: NeuralSupport.fit(
        _ring(40, 0.0), key=jax.random.key(1), steps=3, harmonics=6, width=8
    ),
}


def of_network(name: str) -> Any:
    """A network's contour, and what its fit says of itself."""
    fit = NETWORKS[name]()
    s = np.linspace(*np.asarray(fit.field.domain()), 21)
    told = {
        field.name: getattr(fit, field.name) for field in dataclasses.fields(fit) if field.name != "field"
    }
    return described(told | {"points": fit.field.point(s), "curvatures": fit.field.curvature(s)})


@functools.cache
def made(name: str) -> Fit | SurfaceFit:
    """A fit, made once for its numbers and its picture."""
    return FITS[name]()


def numbers(name: str) -> Any:
    """A fit's report, its text, its feet and the numbers of its shape."""
    fit = made(name)
    found: dict[str, Any] = {"report": fit.report, "text": str(fit.report)}
    if isinstance(fit, SurfaceFit):
        shape = fit.surface
        found |= {"origin": shape.origin, "step": shape.step, "shape": shape.coefficients.shape}
        found["feet"] = fit.feet
        found["trusted"] = np.asarray(fit.trusted(fit.feet), float)
    else:
        s = np.linspace(*np.asarray(fit.contour.domain()), 41)
        points, curvatures = fit.contour.point(s), fit.contour.curvature(s)
        found |= {"domain": fit.contour.domain(), "points": points, "curvatures": curvatures}
        # Where the feet are: their arclengths begin anew where the contour does.
        found["feet"] = fit.contour.point(fit.feet)
    return described(found)
