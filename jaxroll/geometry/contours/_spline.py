r"""A contour through data points, or near them: a spline of odd degree, differentiable in the points.

The spline $P(u)$ is fitted to points $p_i$ at parameters $u_i$ (`_bspline`), which are not known beforehand:
chord lengths come first, then parameters worked out of the fit before, for a fixed number of rounds
(`Spline.fitted`). The last fit is then tabulated over arclength (`_table`). `fitting` makes a `Spline` of
points in any state, and shares `chords`, `spline_basis` and `knot_count` in its choice of a smoothing
wavelength.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import Vec2
from ..._results import as_count, as_floats, check_flag, check_positive, concrete, shown
from ..._types import ByPrecision, Given
from ..._xla import at_once
from ._arclength import arclength_at, in_cells, rising_sums
from ._bspline import Basis, basis, interval_of, jet_of_pieces, jets, Pieces
from ._free_numbers import point_waves, wavy_shift
from ._given_points import check_extent, polygon_area, polygon_length
from ._table import AbstractTabulated, FEWEST_CELLS, Table, tabulated

# Exponents b of the curvature in the successive parameters, whose rate is about kappa^b: arclength (b = 0)
# twice, since chords of uneven length spoil the first fit's curvature, then nearly affine arclength. An open
# contour stays with arclength: nothing holds its end pieces from beyond. In a parameter that follows the
# curvature, 20 um of noise on points 3 mm apart bent them to 40 000 1/m, in arclength to 180.
_BENDS = (0.0, 0.0, 1.0 / 3.0)
# Curvature, as a share of that of a disc as long, below which a contour counts as straight in that parameter.
# Without it the parameter would stand still along straight lines.
_FLAT = 0.1
# Most entries of the matrix of all functions' values at all points; 2^24 doubles are 134 MB.
_LARGEST = 1 << 24
# How often the coefficients of a smoothing spline are refined, and how large the last step may be, relative
# to them. Each step leaves the same share of the error: after the third one its fourth power, 5e-10 and 1e-3.
_REFINED = 3
_LAST_STEP = ByPrecision(1e-7, 5e-3)
# Neighbours nearer than this share of the points' extent are one point: there the rounding of their chord's
# direction leaves curvatures off by 0.5 % (in single precision by their own size), and nearer by more.
# The second number is how many roundings of the largest coordinate count as one point, too.
_SAME, _ROUNDED = ByPrecision(1e-12, 1e-6), 4.0
# Five-point Gauss-Legendre on [-1, 1].
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


class Spline(AbstractTabulated):
    r"""A spline through ordered points, or near them, parametrised by arclength.

    Interpolating (`smoothing` = 0), it passes through every point. Its parameter is first the chord length,
    then the arclength of that fit, and last, if it is closed,
    $\int (\kappa^2 + 0.01\,\bar\kappa^2)^{1/6} ds$, nearly the affine arclength: knots gather where the
    contour bends, and a conic is trigonometric. Smoothing, it minimises
    $\frac1n\sum_i |P(u_i) - p_i|^2 + \frac{1}{L} (\ell/2\pi)^6 \int |P'''|^2 du$ over arclength, which halves
    a wiggle of wavelength $\ell$ = `smoothing` and leaves longer ones.

    Everything is differentiable with respect to `points`. The frame is read from a table over arclength
    (`table_error` bounds its error), built once per solve: `prepared()` builds it ahead of many.

    Args:
        points: Shape (n, 2) [m], in order, counter-clockwise round the body; a closed contour's first
            point is not repeated. At least `degree` + 1. `fit_contour` takes points in any state.
        closed: Whether the last point is followed by the first.
        smoothing: Wavelength $\ell$ [m]; 0 interpolates. `smoothing_for` finds it from the noise. At most
            some 800 distances of knots, 40 in single precision; a closed contour shrinks to a point by one
            longer than half of it.
        degree: 3, 5, 7 or 9. The contour has `degree` - 1 continuous derivatives; solvers of order 5
            and more want 5 or above.
        knots: How many knots the smoothing spline has, evenly among the points; None: at every point.
        origin: Number of the point at which s = 0.
        cells: Cells of the table. Static, as are `closed`, `degree`, `knots` and `origin`: changing one
            recompiles.

    Raises:
        ValueError: If there are too few points, two neighbours are the same to rounding (1e-12 of the
            points' extent, in single precision 1e-6), a closed contour runs clockwise, or a number is not
            finite, far too large or too small for a length. Too long a `smoothing` is refused with the
            table; a run whose points are traced is `unresolved`.

    Accuracy: an interpolating spline errs by $h^{p+1}$ in the point, $h^p$ in the tangent and $h^{p-1}$ in
    the curvature for degree $p$ and spacing $h$. 64 exact points of an ellipse of half axes 20 and 14 mm at
    equal eccentric angles, degree 5: 8e-11, 3e-9 and 2e-7, relative; at equal arclengths six times as
    much, and less again with degree 7. Uneven spacing costs most: $h$ is the widest. In single precision
    curvatures of some 60 points are right to 1e-4 and their derivatives in the points to some 1e-2, as the
    rounding of the points leaves them; curvatures of 256 points to some 1e-3, but near the ends of an open
    contour, where nothing holds them from beyond, they may be off by their own size.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> u = 2 * np.pi * np.arange(64) / 64
        >>> disc = jxr.Spline(0.01 * np.stack([np.cos(u), np.sin(u)], -1))
        >>> f"{disc.curvature(0.012):.4f} 1/m"
        '100.0000 1/m'
    """

    points: Float[Array, "n 2"]
    smoothing: Float[Array, ""] | None
    loop: bool = eqx.field(static=True)
    degree: int = eqx.field(static=True)
    knots: int | None = eqx.field(static=True)
    origin: int = eqx.field(static=True)
    cells: int = eqx.field(static=True)
    table: Table | None

    def __init__(
        self,
        points: Given,
        *,
        closed: bool = True,
        smoothing: Given = 0.0,
        degree: int = 5,
        knots: int | None = None,
        origin: int = 0,
        cells: int = 1024,
    ) -> None:
        self.points = as_floats("points", points, (None, 2))
        self.loop = check_flag("closed", closed)
        _check(self.points, self.loop, degree, origin)
        self.degree, self.origin = int(degree), int(origin)
        self.smoothing = _length(smoothing)
        self.knots = knot_count(knots, self.points.shape[0], degree)
        self.cells = as_count("cells", cells, least=FEWEST_CELLS)
        self.table = None

    @property
    def closed(self) -> bool:
        return self.loop

    @property
    def smoothness(self) -> float:
        return float(self.degree - 1)

    def fitted(self) -> tuple[Pieces, Array]:
        """The spline over its own parameter, and the parameters of the data (closed: and the first again)."""
        bends = _BENDS if self._interpolates and self.loop else (0.0, 0.0)

        # With `checkpoint`, reverse mode evaluates a round again instead of storing its intermediate values;
        # storing them takes longer to compile. Within a scan `prevent_cse` is not needed.
        @functools.partial(jax.checkpoint, prevent_cse=False)
        def again(u: Array, bend: Array) -> tuple[Array, tuple[Pieces, Array]]:
            pieces = self._fit(u)
            return self._reparametrised(pieces, u, bend), (pieces, u)

        # A round fits at the given parameters, then makes the next ones. The last round only fits: its new
        # parameters (of the exponent 0.0) are thrown away, so that `_fit` is compiled once.
        rounds = jnp.array((*bends, 0.0))
        _, fits = jax.lax.scan(again, chords(self.points, self.loop), rounds)
        return jax.tree.map(lambda x: x[-1], fits)

    def tabulate(self, cells: int) -> Table:
        # Cells of half a knot interval, two for each, so that five-point quadrature integrates the speed.
        pieces, u = self.fitted()
        coefficients = pieces.coefficients
        table, arcs = tabulated(_halves, coefficients, 2 * len(coefficients), closed=self.loop, cells=cells)
        if self.origin == 0:
            return table
        piece, local = interval_of(pieces.breaks, u[self.origin])
        begin = arclength_at(_speed, coefficients, arcs[::2], cell=piece, x=local)
        return eqx.tree_at(lambda t: t.start, table, -begin)

    def _why_not_finite(self) -> str:
        if self.smoothing is None:
            return super()._why_not_finite()
        was = f"but was {shown(self.smoothing)} m"
        length = polygon_length(np.asarray(self.points), closed=self.loop)
        if self.loop and float(self.smoothing) > 0.5 * length:
            return (
                f"argument smoothing must be at most half the length of a closed contour, {length:.3g} m, "
                f"which longer ones shrink to a point, {was}"
            )
        return (
            f"argument smoothing must be shorter for {self.knots or len(self.points)} knots as near to each "
            f"other, of whose equations it leaves nothing but rounding, {was}: fewer `knots` smooth as well"
        )

    def free_numbers(self) -> list[Any]:
        return [self.points]

    def preconditioner(self, size: float) -> np.ndarray:
        return point_waves(self.points.shape[0], closed=self.loop)

    def symmetrised(self) -> "Spline":
        count = self.points.shape[0]
        if not self.loop and 2 * self.origin != count - 1:
            raise ValueError(
                f"argument symmetric must be False unless an open spline's origin is its middle point, "
                f"but that is {self.origin} of {count}"
            )
        # The mirror image negates y and takes the points in reverse order about point number `origin`.
        partner = (2 * self.origin - np.arange(count)) % count
        return eqx.tree_at(lambda c: c.points, self, _mean_with_image(self.points, partner))

    def perturbed(self, rng: np.random.Generator) -> "Spline":
        points = np.asarray(self.points)
        return eqx.tree_at(lambda c: c.points, self, jnp.asarray(points + wavy_shift(points, rng)))

    @property
    def wavelength(self) -> Any:
        """Wavelength of `smoothing` [m]; 0 where it interpolates."""
        return 0.0 if self.smoothing is None else self.smoothing

    @property
    def _interpolates(self) -> bool:
        return self.smoothing is None and self.knots is None

    def _fit(self, u: Array) -> Pieces:
        """The spline through the points, or near them, at parameters u (closed: with the first one again)."""
        count = self.points.shape[0]
        functions = self._basis(u)
        if self._interpolates:
            values = functions.at_breaks() if self.loop else functions.matrix(u)
            return functions.pieces(jnp.linalg.solve(values, self.points))
        # Normal equations of least squares, with V the values and R the roughness:
        # (V^T V / n + (wavelength / 2 pi)^6 R / L) p = V^T points / n.
        # Where only `knots` is given, R is left out.
        values = functions.matrix(u[:count])
        right = values.T @ self.points / count
        if self.smoothing is None:
            return functions.pieces(jnp.linalg.solve(values.T @ values / count, right))
        weight = (self.smoothing / (2.0 * np.pi)) ** 6 / (u[-1] - u[0])
        return functions.pieces(_smoothed(functions, values, weight, right))

    def _reparametrised(self, pieces: Pieces, u: Array, bend: Array) -> Array:
        r"""New parameters of the data: $\int ((\kappa/\bar\kappa)^2 + \epsilon^2)^{b/2} ds$ along the fit.

        Here $b$ = `bend`, $\epsilon$ = `_FLAT`, and $\bar\kappa = 2\pi/L$ is the curvature of a disc as long.
        """
        places = 0.5 * (1.0 + _NODES)
        # Speed and curvature at five places of every interval between two data. Derivatives are in a piece's
        # own coordinate; `share` is how much of it passes along an interval of the data.
        if self.knots is None and self.loop:  # the data's intervals are the pieces
            _, rate, second = jets(pieces.coefficients, places)
            share = 1.0
        else:
            step = jnp.diff(u)[:, None]
            index, local = interval_of(pieces.breaks, u[:-1, None] + step * places[None, :])
            _, rate, second = jet_of_pieces(pieces.coefficients, index, local)
            share = step / jnp.diff(pieces.breaks)[index]
        square = rate.dot(rate)
        arc = share * jnp.sqrt(square)
        # kappa L / (2 pi). The weights add up to 2, as on [-1, 1], so that the sum of `arc` with them is 2 L.
        turns = rate.cross(second) / (square * jnp.sqrt(square)) * (jnp.sum(arc @ _WEIGHTS) / (4.0 * np.pi))
        density = arc * (_FLAT**2 + turns**2) ** (0.5 * bend)
        return rising_sums(density @ (0.5 * _WEIGHTS))

    def _basis(self, u: Array) -> Basis:
        return spline_basis(u, self.knots, self.degree, closed=self.loop)


def _smoothed(functions: Basis, values: Array, weight: Array, right: Array) -> Array:
    r"""The coefficients p of (V^T V / n + weight R) p = right; NaN where rounding leaves too few digits.

    R is large, but does not act on parabolas: rounded, it does, and $\epsilon (\ell/2\pi h)^6$ of the fit is
    noise, with $\ell$ the wavelength and h the distance of knots (1e-4 of a contour's size, for one as long
    as its contour at 500 knots). Applied as products of third derivatives its error is itself a bend, which
    hardly acts on parabolas: residuals worked out so refine the solution, three times to 1e-12.
    """
    count = values.shape[0]

    def applied(given: Array) -> Array:
        bends, back = jax.vjp(functions.bends, given)
        return values.T @ (values @ given) / count + weight * back(bends)[0]

    normal = values.T @ values / count + weight * functions.roughness()
    factors = jax.scipy.linalg.lu_factor(jax.lax.stop_gradient(normal))

    def step(apply: Callable[[Array], Array], given: Array, found: Array) -> Array:
        return jax.scipy.linalg.lu_solve(factors, given - apply(found))

    def solved(apply: Callable[[Array], Array], given: Array) -> Array:
        found = jax.scipy.linalg.lu_solve(factors, given)
        for _ in range(_REFINED - 1):
            found = found + step(apply, given, found)
        return found

    found = jax.lax.custom_linear_solve(applied, right, solved, symmetric=True)
    # The last step, out here, refines derivatives too. Its size cannot be an `aux` of the solve: JAX batches
    # that in every `vmap`, also where nothing differs, and `jax.jacfwd` wants one value for all directions.
    last = step(applied, right, found)
    found = found + last
    ratio = jax.lax.stop_gradient(jnp.max(jnp.abs(last)) / jnp.max(jnp.abs(found)))
    # NaN refuses the table.
    return jnp.where(ratio <= _LAST_STEP.of(found), found, jnp.nan)


def spline_basis(u: Array, knots: int | None, degree: int, *, closed: bool) -> Basis:
    """B-splines with knots at the data's parameters, or at `knots` places evenly among them."""
    if knots is None:
        return basis(u, degree, closed=closed)
    steps = u.shape[0] - 1
    places = jnp.linspace(0.0, steps, knots + 1 if closed else knots)
    return basis(jnp.interp(places, jnp.arange(steps + 1.0), u), degree, closed=closed)


def chords(points: Array, closed: bool) -> Array:
    """Cumulative chord lengths from zero; closed: with the chord back to the first point."""
    around = jnp.concatenate([points, points[:1]]) if closed else points
    chords = jnp.linalg.norm(jnp.diff(around, axis=0), axis=-1)
    return rising_sums(chords)


def _speed(coefficients: Array, piece: Array, x: Array) -> Array:
    """Arclength per unit of x [m] at places x in [0, 1] of pieces."""
    _, rate, _ = jet_of_pieces(coefficients, piece, x)
    return jnp.sqrt(rate.dot(rate))


def _halves(coefficients: Array, half: Array, x: Array) -> tuple[Vec2, Vec2, Vec2]:
    """Half pieces as the cells of a curve: points and two derivatives at x in [0, 1] of cells `half`."""
    point, rate, bend = jet_of_pieces(coefficients, half // 2, 0.5 * in_cells(half % 2, x))
    return point, rate * 0.5, bend * 0.25


@at_once
def _mean_with_image(xp: Any, points: Array, partner: np.ndarray) -> Array:
    """The mean of points and their mirror images, of which number i is that of point `partner[i]`."""
    flipped = points[partner] * xp.array([[1.0, -1.0]], points.dtype)
    return 0.5 * (points + flipped)


def _check(points: Array, closed: bool, degree: int, origin: int) -> None:
    """Raise unless the arguments make a contour; the points' places only where they are not traced."""
    if not isinstance(degree, int | np.integer) or degree not in (3, 5, 7, 9):
        raise ValueError(f"argument degree must be 3, 5, 7 or 9, but was {shown(degree)}")
    count = points.shape[0]
    check_enough(count, degree)
    whole = isinstance(origin, int | np.integer) and not isinstance(origin, bool)
    if not whole or not 0 <= origin < count:
        raise ValueError(
            f"argument origin must be the number of a point, below {count}, but was {shown(origin)}"
        )
    seen = concrete(points)
    if seen is None:
        return
    check_distinct(seen, closed)
    check_extent("points", seen)
    if closed and not (area := polygon_area(seen)) > 0.0:
        raise ValueError(
            f"argument points must run counter-clockwise, but the area on their left was {area:.3g} m^2"
        )


def _length(smoothing: Given) -> Array | None:
    """The smoothing wavelength [m], checked; None for zero, which interpolates."""
    wavelength = as_floats("smoothing", smoothing, ())
    seen = concrete(wavelength)
    return None if seen is not None and seen == 0 else check_positive("smoothing", wavelength)


def check_enough(count: int, degree: int) -> None:
    """Raise unless a spline of a degree can go through so many points."""
    if count < degree + 1:
        raise ValueError(
            f"argument points must have at least {degree + 1} points for degree {degree}, but had {count}"
        )


def check_distinct(points: np.ndarray, closed: bool) -> None:
    """Raise if a point follows itself, or does so to rounding, where the polygon has no direction."""
    # Lengths as shares of the largest coordinate, so that none overflows.
    far = float(np.abs(points).max(initial=np.finfo(points.dtype).tiny))
    shares = points / far
    following = np.roll(shares, -1, axis=0) if closed else shares[1:]
    steps = np.abs(shares[: len(following)] - following).max(axis=1)
    least = _SAME.of(points) * np.ptp(shares, axis=0).max()
    same = np.flatnonzero(steps <= max(least, _ROUNDED * np.finfo(points.dtype).eps))
    if same.size:
        step = far * float(steps[same[0]])
        raise ValueError(
            f"argument points must not repeat a point (a closed contour joins its ends itself), "
            f"but points {same[0]} and {(same[0] + 1) % len(points)} are the same"
            + (f" to rounding, {step:.3g} m apart" if step else "")
        )


def knot_count(knots: int | None, count: int, degree: int) -> int | None:
    """The number of knots asked for, checked; None for one at every point."""
    if count * (count if knots is None else 1) > _LARGEST:
        raise ValueError(
            f"argument points must be at most {math.isqrt(_LARGEST)} where each has a knot, "
            f"but were {count}; `knots=512` smooths more"
        )
    if knots is None:
        return None
    whole = isinstance(knots, int | np.integer) and not isinstance(knots, bool)
    if not whole or not degree + 1 <= knots <= count:
        raise ValueError(
            f"argument knots must lie between {degree + 1} and the number of points, {count}, "
            f"but was {shown(knots)}"
        )
    if count * knots > _LARGEST:
        raise ValueError(
            f"argument knots must be at most {_LARGEST // count} for {count} points, but was {knots}"
        )
    return int(knots)
