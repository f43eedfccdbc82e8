r"""Convex contours by their support function $h(\varphi)$, as a Fourier series.

The normal's angle $\varphi$ is the parameter. The point is $h n + h' n'$, the radius of curvature
$\rho = h + h'' = ds/d\varphi$. For a series, arclength $s(\varphi) = \int \rho\,d\varphi$ is a closed form,
so the table over arclength (`_table`) needs only its inverse (`_arclength`). Condition (41) for a fingertip
about its own origin is $h'' > 0$.

`SupportFunction` holds the series; `_neural_support` makes one of a network's samples. `fit_series` fits one
to points, on the host.
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import sincos, Vec2
from ..._results import (
    as_array,
    as_count,
    as_floats,
    as_length,
    computed_at_once,
    concrete,
    told_apart,
    traced,
)
from ..._types import Given
from ._arclength import parameters_reaching
from ._free_numbers import damping, PERTURBED
from ._given_points import check_extent, numbers
from ._table import AbstractTabulated, FEWEST_CELLS, from_frames, Table

# A support function with its first two derivatives, at normal angles of any shape.
Heights = tuple[Array, Array, Array]
_TURN = 2.0 * np.pi


class Series(eqx.Module):
    """A support function as its Fourier series; the attributes are those of `SupportFunction`."""

    radius: Float[Array, ""]
    cosines: Float[Array, " m"]
    sines: Float[Array, " m"]

    @property
    def density(self) -> int:
        """Points of a grid of normal angles: 16 or more to the shortest wave."""
        return 16 * (self.cosines.shape[0] + 4)

    def heights(self, angle: Array) -> Heights:
        """$h$, $h'$ and $h''$ [m] at normal angles [rad] of shape (n,)."""
        order, sin, cos = self._waves(angle)
        wave = cos @ self.cosines + sin @ self.sines
        first = cos @ (order * self.sines) - sin @ (order * self.cosines)
        second = cos @ (order**2 * self.cosines) + sin @ (order**2 * self.sines)
        return self.radius + wave, first, -second

    def bend(self, angle: Array) -> Array:
        """Second derivative $h''$ [m]."""
        return self.heights(angle)[2]

    def radius_of_curvature(self, angle: Array) -> Array:
        r"""$\rho = h + h''$ [m]."""
        height, _, second = self.heights(angle)
        return height + second

    def smallest_radius(self) -> Array:
        """Smallest radius of curvature [m]."""
        whole = (jnp.zeros_like(self.radius), _TURN * jnp.ones_like(self.radius))
        return smallest(self.radius_of_curvature, whole, self.density)

    def table(self, cells: int) -> Table:
        """Quintic table at uniform arclengths."""
        # A convex contour's circumference is 2 pi times its mean support (Cauchy).
        length = _TURN * self.radius
        targets = length * np.linspace(0.0, 1.0, cells + 1)
        # Newton's method for s(angle) = target begins at the inverse of s, interpolated on a grid.
        grid = jnp.linspace(0.0, _TURN, self.density + 1)
        start = jnp.interp(targets, self._progress(grid)[0], grid)
        angle = parameters_reaching(Series._progress, self, jax.lax.stop_gradient(start), targets)
        height, first, second = self.heights(angle)
        sin, cos = sincos(angle)
        point = Vec2(height * cos - first * sin, height * sin + first * cos)
        tangent = Vec2(-sin, cos)
        return from_frames(point.array(), tangent.array(), 1.0 / (height + second), length, closed=True)

    def _progress(self, angle: Array) -> tuple[Array, Array]:
        r"""Arclength $\int_0^\varphi \rho$ [m], in closed form, and $\rho$."""
        # h + h'' multiplies wave k by 1 - k^2, and integrating divides it by k.
        order, sin, cos = self._waves(angle)
        rate = 1.0 - order**2
        a, b = rate * self.cosines, rate * self.sines
        wave = sin @ (a / order) - cos @ (b / order) + jnp.sum(b / order)
        return self.radius * angle + wave, self.radius + cos @ a + sin @ b

    def _waves(self, angle: Array) -> tuple[np.ndarray, Array, Array]:
        """Orders k = 1 ... m, sin(k angle) and cos(k angle), shape (n, m)."""
        order = np.arange(1.0, self.cosines.shape[0] + 1.0)
        return order, *sincos(angle[:, None] * order[None, :])


def smallest(field: Callable[[Array], Array], ends: tuple[Array, Array], density: int) -> Array:
    """Smallest value of `field(angles)` between two angles [rad].

    The field is sampled at `density` places; a parabola through the least sample and its neighbours gives the
    angle of a minimum inside. The least value is there, or at an end, with which it then moves.
    """
    low, high = ends
    # Angles inside are held fixed in derivatives: at a minimum the field's derivative in its angle is zero.
    grid = jax.lax.stop_gradient(jnp.linspace(low, high, density))
    values = jax.lax.stop_gradient(field(grid))
    at = jnp.clip(jnp.argmin(values), 1, density - 2)
    before, here, after = values[at - 1], values[at], values[at + 1]
    # The vertex of a parabola through three equidistant values lies (before - after) / (2 bend) steps from
    # the middle. Where the three do not bend upwards the middle stays.
    bend = before - 2.0 * here + after
    step = 0.5 * (before - after) / jnp.where(bend > 0, bend, jnp.inf)
    # Beyond the neighbours there is no minimum inside: an end is the least. An angle that is beside that end
    # by rounding would be held fixed, and could be chosen in its place.
    vertex = grid[at] + jnp.where(jnp.abs(step) < 1.0, step, 0.0) * (grid[1] - grid[0])
    found = field(jnp.stack([low, high, grid[at], vertex]))
    # Not `min`, which shares the derivative out where two are equal.
    return found[jnp.argmin(found)]


class AbstractSupport(AbstractTabulated):
    r"""A closed convex contour by its support function $h(\varphi)$.

    The tangent with outward normal $n(\varphi) = (\cos\varphi, \sin\varphi)$ lies at the height $h$ from the
    body's origin and touches at $h\,n + h'\,n'$; the radius of curvature is $\rho = h + h'' = ds/d\varphi$.
    s = 0 lies where the normal is +x. To add one, give `series`.
    """

    @abc.abstractmethod
    def series(self, terms: int) -> Series:
        """The Fourier series of $h$, with `terms` harmonics or as many as it has."""

    @property
    def closed(self) -> bool:
        return True

    @property
    def smoothness(self) -> float:
        return float("inf")

    def support(self, angle: Given) -> Float[Array, "..."]:
        """Support function $h$ [m] at normal angles [rad] of shape (...)."""
        angle = as_array("angle", angle)
        return _heights(self, angle.ravel())[0].reshape(angle.shape)

    def smallest_radius(self) -> Float[Array, ""]:
        """Smallest radius of curvature [m]; negative where the contour folds."""
        return _smallest_radius(self)

    def margin(self, low: Given = 0.0, high: Given = _TURN) -> Float[Array, ""]:
        r"""Smallest $h''$ [m] between two normal angles [rad]: condition (41) holds where it is positive.

        Differentiable in the contour's numbers. Zero for a circle about the body's origin; the mean of $h''$
        over the whole contour is zero, so only on an interval can the margin be positive. The origin is the
        contour's own: for a `moved` contour, not the body's.
        """
        ends = as_floats("low", low, ()), as_floats("high", high, ())
        seen = concrete(ends[0]), concrete(ends[1])
        if seen[0] is not None and seen[1] is not None and not seen[0] <= seen[1] <= seen[0] + 1.001 * _TURN:
            least, was = told_apart(*seen)
            raise ValueError(
                f"argument high must be at most a turn above low, {least} rad, but was {was} rad"
            )
        return _margin(self, *ends)

    def tabulate(self, cells: int) -> Table:
        return self.series(max(64, cells // 8)).table(cells)


@eqx.filter_jit
def _heights(contour: AbstractSupport, angle: Array) -> Heights:
    return contour.series(128).heights(angle)


@eqx.filter_jit
def _smallest_radius(contour: AbstractSupport) -> Array:
    return contour.series(128).smallest_radius()


@eqx.filter_jit
def _margin(contour: AbstractSupport, low: Array, high: Array) -> Array:
    series = contour.series(128)
    return smallest(series.bend, (low, high), series.density)


class SupportFunction(AbstractSupport):
    r"""A closed convex contour by its support function, a Fourier series of the normal's angle.

    The tangent with outward normal $n(\varphi) = (\cos\varphi, \sin\varphi)$ lies at the height
    $$h(\varphi) = r + \sum_{k=1}^m a_k \cos k\varphi + b_k \sin k\varphi$$
    from the body's origin. It touches at $h\,n + h'\,n'$, where the radius of curvature is
    $\rho = h + h'' = ds/d\varphi$. So arclength is a closed form, the circumference is $2\pi r$, and
    $(a_1, b_1)$ is the contour's centre. s = 0 lies where the normal is +x.

    For a fingertip about its own origin, condition (41) is $h'' > 0$: `margin` gives the smallest $h''$.

    Args:
        radius: Mean radius $r$ [m], positive.
        cosines: $a_1 \dots a_m$, shape (m,), in metres.
        sines: $b_1 \dots b_m$, shape (m,), in metres.
        cells: Cells of the table over arclength that its frame is read from, 4 or more to a wave. Static.

    Raises:
        ValueError: If the shapes differ, the cells do not resolve the contour, or it folds: $\rho \le 0$
            somewhere.

    Accuracy: the table's, see `table_error`: point 1e-17 m, tangent 5e-13, curvature 5e-8 1/m for an
    ellipse with half axes of 10 and 7 mm.

    Example:
        >>> import jaxroll as jxr
        >>> rounded = jxr.SupportFunction(0.01, [0.0, 0.0, 1e-3], [0.0, 0.0, 0.0])
        >>> f"{rounded.curvature(0.0):.0f} 1/m"  # 1 / (r - 8 a_3)
        '500 1/m'
    """

    radius: Float[Array, ""]
    cosines: Float[Array, " m"]
    sines: Float[Array, " m"]
    cells: int = eqx.field(static=True)
    table: Table | None

    def __init__(
        self, radius: Given, cosines: Given = (0.0,), sines: Given = (0.0,), *, cells: int = 1024
    ) -> None:
        self.radius = as_length("radius", radius)
        self.cosines = as_floats("cosines", cosines, (None,))
        self.sines = as_floats("sines", sines, self.cosines.shape)
        waves = self.cosines.shape[0]
        self.cells = as_count("cells", cells, least=max(FEWEST_CELLS, 4 * waves))
        self.table = None
        check_convex("cosines", self)

    @classmethod
    def through(cls, points: Given, *, terms: int, cells: int = 1024) -> "SupportFunction":
        """The contour nearest to convex points, in least squares of their normal distances.

        Args:
            points: Shape (n, 2) [m], round the body in any order, n > 2 `terms`.
            terms: Number of harmonics m.
            cells: As for the class.

        Raises:
            ValueError: If there are too few points, they lie on one line, or the nearest series folds.

        Accuracy: spectral for exact points of a smooth contour: for an ellipse with half axes of 10 and 7 mm
        the largest error of $h$ is 0.08 um with 8 terms, 0.7 pm with 20.

        Example:
            >>> import jaxroll as jxr
            >>> tip = jxr.SupportFunction.through([[0.01, 0], [0, 0.01], [-0.01, 0], [0, -0.01]], terms=1)
            >>> f"{tip.radius:.4f} m"
            '0.0100 m'
        """
        data, terms = numbers("points", points, 2), as_count("terms", terms)
        if not 0 < 2 * terms < len(data):
            most = (len(data) - 1) // 2
            raise ValueError(f"argument terms must lie between 1 and {most} (by the points), but was {terms}")
        check_extent("points", data)
        spread = np.linalg.svd(data - data.mean(axis=0), compute_uv=False)
        if spread[1] <= 1e-9 * spread[0]:
            raise ValueError("argument points must lie round a body, but lie on one line")
        # In one array: the mean, then the cosines, then the sines.
        series, _ = fit_series(data, terms)
        return cls(series[0], series[1 : terms + 1], series[terms + 1 :], cells=cells)

    def series(self, terms: int) -> Series:
        return Series(self.radius, self.cosines, self.sines)

    def free_numbers(self) -> list[Any]:
        return [self.radius, self.cosines, self.sines]

    def preconditioner(self, size: float) -> np.ndarray:
        each = damping(self._orders())
        return np.diag(np.concatenate([[1.0], each, each]))

    def symmetrised(self) -> "SupportFunction":
        # The mirror image about the x axis has h(-phi): the mean of both is the even part.
        return eqx.tree_at(lambda c: c.sines, self, jnp.zeros_like(self.sines))

    def perturbed(self, rng: np.random.Generator) -> "SupportFunction":
        """Terms of the series changed by less and less, so that it stays convex."""
        # A term of order k changes the radius of curvature by k^2 - 1 times its size.
        size = PERTURBED * float(self.radius) / self._orders() ** 3
        wave = lambda: jnp.asarray(size * rng.standard_normal(len(size)))  # noqa: E731
        where = lambda c: (c.cosines, c.sines)  # noqa: E731
        return eqx.tree_at(where, self, (self.cosines + wave(), self.sines + wave()))

    def _orders(self) -> np.ndarray:
        return np.arange(1, 1 + self.cosines.shape[0])


def check_convex(name: str, contour: AbstractSupport) -> None:
    """Raise if a concrete support function folds."""
    if traced(contour):
        return
    # A constant contour may be made inside a traced function: its check is evaluated there and then.
    with computed_at_once():
        worst = float(contour.smallest_radius())
    if not worst > 0:
        raise ValueError(
            f"argument {name} must keep the radius of curvature positive, but its smallest was {worst:.3g} m"
        )


def _basis(angles: np.ndarray, terms: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values and two derivatives of 1, cos, sin: (..., 1 + 2 terms)."""
    order = np.arange(1, terms + 1)
    cos, sin = np.cos(angles[..., None] * order), np.sin(angles[..., None] * order)
    one = np.ones_like(angles)[..., None]
    value = np.concatenate([one, cos, sin], axis=-1)
    first = np.concatenate([0.0 * one, -order * sin, order * cos], axis=-1)
    second = np.concatenate([0.0 * one, -(order**2) * cos, -(order**2) * sin], axis=-1)
    return value, first, second


def fit_series(points: np.ndarray, terms: int) -> tuple[np.ndarray, np.ndarray]:
    r"""Fourier series (1 + 2 terms,) whose contour is nearest to `points`, and their normal angles.

    A point's signed distance is $d = \max_\varphi (p \cdot n(\varphi) - h(\varphi))$. At the maximum it does
    not depend on $\varphi$ to first order and is linear in the series, so solving for the series at fixed
    angles, then for the angles, is Gauss-Newton on the normal distances. It starts at the support function
    of the points themselves (of their convex hull). Inside, points are centred and scaled to size one.
    """
    centre = points.mean(axis=0)
    size = np.sqrt(np.mean(np.sum((points - centre) ** 2, axis=-1)))
    scaled = (points - centre) / size
    grid = np.linspace(0.0, _TURN, 16 * (terms + 32), endpoint=False)
    # p . n, shape (points, grid): its largest value over the points is their support function.
    reach = scaled @ np.stack([np.cos(grid), np.sin(grid)])
    values = _basis(grid, terms)[0]
    series, angles = np.linalg.lstsq(values, reach.max(axis=0))[0], np.zeros(len(points))
    for _ in range(60):
        # The foot: globally on the grid, then by Newton's method.
        angles = _feet(scaled, series, grid[np.argmax(reach - values @ series, axis=1)])
        normal = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        basis = _basis(angles, terms)[0]
        step = np.linalg.lstsq(basis, np.sum(scaled * normal, axis=-1) - basis @ series)[0]
        series = series + step
        if np.max(np.abs(step)) < 1e-14:
            break
    # Back to metres. A shift by c adds c . n to h, which is the first harmonic.
    series = size * series
    series[[1, terms + 1]] += centre
    return series, angles


def _feet(points: np.ndarray, series: np.ndarray, angles: np.ndarray) -> np.ndarray:
    r"""Normal angles of the contour's points nearest to `points` (of size one), from a guess.

    Newton's method on the distance $d(\varphi) = p \cdot n - h$: $d' = p \cdot n' - h'$,
    $d'' = -(p \cdot n + h'')$. Where $-d''$ is not above 1e-3, no maximum is near, and the angle stays.
    """
    for _ in range(4):
        basis = _basis(angles, len(series) // 2)
        height, first, second = (b @ series for b in basis)
        del height
        normal = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        along = points[:, 1] * normal[:, 0] - points[:, 0] * normal[:, 1]
        bend = np.sum(points * normal, axis=-1) + second
        angles = angles + np.where(bend > 1e-3, (along - first) / np.maximum(bend, 1e-3), 0.0)
    return angles
