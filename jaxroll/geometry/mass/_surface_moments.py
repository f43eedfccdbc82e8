r"""Volume, centre and second moments of the body within a closed surface.

Balls, ellipsoids and superellipsoids are Dirichlet's integrals, a torus has closed forms too. A chart is
integrated over its domain, $n\,\mathrm{d}A = P_u \times P_v\,\mathrm{d}u\,\mathrm{d}v$, by Gauss-Legendre's
rule on panels, which are halved until nothing changes. Any other implicit surface goes to `_level_moments`.
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._linalg import Pose3
from ..._results import traced
from ..._xla import at_once, quickly
from .._tabled import tabled
from ..surfaces import (
    AbstractChart,
    AbstractImplicit,
    AbstractSurface,
    Ellipsoid,
    MovedSurface,
    Patch,
    Sphere,
    Superellipsoid,
    Torus,
)
from ._level_moments import level_moments
from ._mesh_moments import times_enclosed
from ._moments import checked, difference, from_cones, Moments

# Points of Gauss-Legendre's rule along either side of a panel.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
# Panels along each parameter at first, and at most along the parameter that has more.
_PANELS, _MOST = 4, 128
# Panels are halved until the moments change by less than this, relative to their size.
_SETTLED = 1e-12
# Places that one call of the compiled program takes.
_BATCH = 4096
# Places asked how often a chart runs round them.
_ASKED = 12
# An edge shorter than this share of the surface's size is a pole.
_POLE = 1e-9


def surface_moments(surface: AbstractSurface) -> Moments:
    """Moments of the body within a closed surface; of closed forms differentiable in all numbers."""
    if isinstance(surface, MovedSurface):
        pose = surface.placed()
        return surface_moments(surface.surface).placed(_matrix(pose), surface.offset)
    if isinstance(surface, Sphere):
        return _rounded((surface.radius,) * 3, 2.0)
    if isinstance(surface, Ellipsoid | Superellipsoid):
        exponent = surface.exponent if isinstance(surface, Superellipsoid) else 2.0
        return _rounded((surface.a, surface.b, surface.c), exponent)
    if isinstance(surface, Torus):
        return _ring(surface.major, surface.minor)
    if traced(surface):
        kind = type(surface).__name__
        raise ValueError(
            f"argument shape must be known before tracing unless in closed form, but was a {kind}"
        )
    if isinstance(surface, AbstractChart):
        return _chart_moments(tabled(surface))
    if isinstance(surface, AbstractImplicit) and eqx.filter_eval_shape(surface.spread, 1) is not None:
        return level_moments(tabled(surface))
    kind = type(surface).__name__
    raise ValueError(f"argument shape must be a closed surface with known bounds, but was a {kind}")


def _matrix(pose: Pose3) -> Array:
    return jnp.stack([axis.array() for axis in (pose.x, pose.y, pose.z)], axis=1)


def _rounded(axes: tuple[Array, ...], exponent: float) -> Moments:
    r"""Of $|x/a|^p + |y/b|^p + |z/c|^p \le 1$, by Dirichlet's integral.

    Over the octant $\int x^{\alpha - 1} y^{\beta - 1} z^{\gamma - 1}$ of the unit body is
    $\Gamma(\alpha/p)\,\Gamma(\beta/p)\,\Gamma(\gamma/p) / (p^3\,\Gamma(1 + (\alpha + \beta + \gamma)/p))$.
    """
    gamma, p = math.gamma, exponent
    volume = 8.0 * gamma(1.0 / p) ** 3 / (p**3 * gamma(1.0 + 3.0 / p))
    second = 8.0 * gamma(3.0 / p) * gamma(1.0 / p) ** 2 / (p**3 * gamma(1.0 + 5.0 / p))
    return Moments(*_boxed(axes, volume, second))


@at_once
def _boxed(xp: Any, axes: tuple[Array, ...], volume: float, second: float) -> tuple[Array, Array, Array]:
    """Size, centre and spread of a body that takes these shares of a box and of its moments."""
    each = xp.stack(axes)
    box = xp.prod(each)
    return volume * box, xp.zeros(3, each.dtype), xp.diag(second * box * each**2)


def _ring(major: Array, minor: Array) -> Moments:
    return Moments(*_of_ring(major, minor))


@at_once
def _of_ring(xp: Any, major: Array, minor: Array) -> tuple[Array, Array, Array]:
    """Size, centre and spread."""
    volume = 2.0 * math.pi**2 * major * minor**2
    across, along = 0.5 * major**2 + 0.375 * minor**2, 0.25 * minor**2
    return volume, xp.zeros(3, volume.dtype), xp.diag(volume * xp.stack([across, across, along]))


def _chart_moments(chart: AbstractChart) -> Moments:
    """Moments by quadrature over the domain of a chart, on finer and finer panels."""
    ends = np.asarray([[float(end) for end in pair] for pair in chart.domain()])
    share = np.linspace(0.0, 1.0, 64)
    inside = [low + (high - low) * share for low, high in ends]
    whole, _ = _jets(chart, *(grid.ravel() for grid in np.meshgrid(*inside, indexing="ij")))
    _check_edges(chart, ends, inside, np.ptp(whole, axis=0).max())
    _check_once(chart, whole.reshape(64, 64, 3))
    # A patch is one polynomial in each cell of its grid: panels do not straddle its lines.
    counts = [_PANELS, _PANELS]
    if isinstance(chart, Patch):
        counts = [round(float(high - low)) for low, high in ends]
    # A patch of more cells than that is still refined once: the change is the estimate of the error.
    most = max(_MOST, 2 * max(counts))
    before, change = None, math.inf
    while max(counts) <= most:
        found = _on_panels(chart, ends, counts)
        if before is not None:
            change = difference(found, before)
        before = found
        if change <= _SETTLED:
            break
        counts = [2 * count for count in counts]
    assert before is not None
    return checked(before, change, chart)


def _on_panels(chart: AbstractChart, ends: np.ndarray, counts: list[int]) -> Moments:
    places, weights = zip(*(_rule(*pair) for pair in zip(ends, counts, strict=True)), strict=True)
    u, v = (grid.ravel() for grid in np.meshgrid(*places, indexing="ij"))
    points, areas = _jets(chart, u, v)
    about = points.mean(axis=0)
    cones = np.einsum("ni,ni->n", points - about, areas) * np.outer(*weights).ravel()
    return from_cones(points - about, cones, about)


def _rule(ends: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Places and weights of Gauss-Legendre's rule on equal panels between two ends."""
    width = (ends[1] - ends[0]) / count
    places = ends[0] + width * (np.arange(count)[:, None] + 0.5 * (1.0 + _NODES)[None, :])
    return places.ravel(), np.tile(0.5 * width * _WEIGHTS, count)


def _jets(chart: AbstractChart, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and area vectors of a chart, in batches of one length."""
    count = -(-len(u) // _BATCH) * _BATCH
    rows = [np.resize(x, count).reshape(-1, _BATCH) for x in (u, v)]
    found = [_evaluated(chart, *map(jnp.asarray, pair)) for pair in zip(*rows, strict=True)]
    points, areas = (np.concatenate([np.asarray(x) for x in part]) for part in zip(*found, strict=True))
    return points[: len(u)], areas[: len(u)]


@quickly
def _evaluated(chart: AbstractChart, u: Array, v: Array) -> tuple[Array, Array]:
    ready = chart.prepared()

    def one(u: Array, v: Array) -> tuple[Array, Array]:
        here = ready.derivatives((u, v))
        return here.point.array(), here.u.cross(here.v).array()

    return jax.vmap(one)(u, v)


def _check_edges(chart: AbstractChart, ends: np.ndarray, inside: list[np.ndarray], size: float) -> None:
    """Raise where a chart has an edge that is neither a seam of its period nor a pole."""
    for axis, loop in enumerate(chart.periodic):
        for end in () if loop else ends[axis]:
            along = [inside[0], inside[1]]
            along[axis] = np.full(64, end)
            edge, _ = _jets(chart, *along)
            if np.ptp(edge, axis=0).max() > _POLE * size:
                raise ValueError(
                    f"argument shape must be closed, but this {type(chart).__name__} has an edge at "
                    f"{'uv'[axis]} = {end:.4g}"
                )


def _check_once(chart: AbstractChart, points: np.ndarray) -> None:
    """Raise where a chart runs round its body more than once, by triangles between points on a grid.

    These are asked about places behind them, deeper than a chord lies below its arc. Most must say so: a few
    triangles of a coarse grid may cross others where the surface does not.
    """
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    triangles = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    along = np.cumsum(areas)
    asked = np.searchsorted(along, along[-1] * (np.arange(_ASKED) + 0.5) / _ASKED)
    below = triangles[asked].mean(axis=1) - 0.1 * normals[asked] / np.sqrt(areas[asked])[:, None]
    times = int(np.median(times_enclosed(below, triangles)))
    if times > 1:
        raise ValueError(
            "argument shape must be a surface that runs once round its body, but this "
            f"{type(chart).__name__} does so {times} times"
        )
