r"""A curve among data whose curvature nowhere exceeds a bound, by a sequence of quadratic problems.

The curve is displaced along its normals by $w(s)$, which changes its curvature to
$\kappa + w'' + \kappa^2 w$ in first order. Every round finds the feet of the data, with signed distances
$r_i$, and minimises

$$\sum_i \omega_i (r_i - w(s_i))^2 + \frac{n}{L} \Big(\frac{\ell}{2\pi}\Big)^6
  \int \big(\kappa + w'' + \kappa^2 w\big)'^2\, ds
  + \rho \sum_k d\big(\kappa_k + w''_k + \kappa_k^2 w_k\big)^2,$$

with $d$ the excess over the bound, taken at every node and halfway between. The first two terms are those of
a smoothing spline of wavelength $\ell$ (`Spline`), with curvature in the place of the third derivative, so
that an arc of a circle costs nothing. The weights $\omega_i = \min(1, (\delta/|r_i|)^3)$ leave points out
that the bound keeps the curve away from: a corner then does not pull on the sides beside it. Where that
leaves a stretch of the curve without points, a weak pull towards a rough line holds it; without it, the
cheapest curve would be any circle.

Written here because no library fits a curve with bounded curvature: smoothing splines bound an integral.
`_limited_fit` calls `bounded_curve`.
"""

from typing import Any, NamedTuple

import numpy as np

from ._even_spline import displacements, EvenSpline

_ROUNDS = 25  # most rounds; a round that moves the curve by less than a twentieth of the noise is the last
_NEWTON = 15  # most steps of Newton's method in one round
_TIGHT = 0.01  # share of the bound by which it may be passed at the price of one standard deviation
_DAMPING = 1e-9  # times the mean of the diagonal
_STRIDE = 0.3  # largest displacement in one round, as a share of the smallest radius
_FROZEN = 12  # rounds after which the weights of the points stay
_HELD = 0.03  # weight of the rough line, as a share of that of the points
_TAIL = 2.0  # distance, in standard deviations, beyond which a point counts less


class Bounded(NamedTuple):
    """A curve, the places u of the data's feet on it, and their signed distances (left is positive) [m]."""

    curve: EvenSpline
    feet: np.ndarray
    distances: np.ndarray

    def sharpest(self) -> float:
        """Largest absolute curvature [1/m], at sixteen places to an interval between nodes."""
        u = np.linspace(0.0, self.curve.pieces, 16 * self.curve.pieces + 1)
        return float(np.abs(self.curve.frames(u).curvature).max())


class _Places(NamedTuple):
    """Displacement and its second derivative in u at every node and halfway; differences between these."""

    value: Any
    second: Any
    difference: Any


def bounded_curve(
    points: np.ndarray,
    start: EvenSpline,
    *,
    line: np.ndarray,
    bound: float,
    noise: float,
    wavelength: float,
) -> Bounded:
    """The curve near `start` that lies among the points and bends no more than the bound [1/m].

    Args:
        points: Shape (n, 2) [m], in any order.
        start: A curve roughly among the points; the result has as many nodes.
        line: Shape (m, 2) [m], close places of a rough line that holds the curve where no points do.
        bound: Largest curvature [1/m], passed by about a percent where a corner pulls, by
            more where all points do.
        noise: Standard deviation of each coordinate [m], positive.
        wavelength: Of the wiggles to halve where the bound does not bind [m].
    """
    from scipy.spatial import KDTree  # set-up only: imported with the first use

    curve, places, weights, tree = start, _places(start), np.ones(len(points)), KDTree(line)
    for turn in range(_ROUNDS):
        feet = curve.feet(points)
        frame = curve.frames(feet)
        away = np.sum((points - frame.point) * frame.normal, axis=1)
        if turn < _FROZEN:
            # In the first rounds most points are far off: all count that are not much farther than most.
            tail = _TAIL * max(noise, float(np.median(np.abs(away))))
            weights = np.minimum(1.0, tail / np.maximum(np.abs(away), tail)) ** 3
        moved, way = _moved(curve, feet, away, weights, tree, places, bound, noise, wavelength)
        curve = moved.spread(len(start.nodes))
        if way < 0.05 * noise:
            break
    feet = curve.feet(points)
    frame = curve.frames(feet)
    return Bounded(curve, feet, np.sum((points - frame.point) * frame.normal, axis=1))


def _places(curve: EvenSpline) -> _Places:
    """The matrices that do not change from round to round."""
    from scipy.sparse import csr_matrix, identity

    pieces, closed = curve.pieces, curve.closed
    u = 0.5 * np.arange(2 * pieces if closed else 2 * pieces + 1)
    value, second = (displacements(u, pieces, closed=closed, order=k) for k in (0, 2))
    ahead = (np.arange(len(u)) + 1) % len(u)
    shift = csr_matrix((np.ones(len(u)), (np.arange(len(u)), ahead)), shape=(len(u), len(u)))
    difference = (shift - identity(len(u))).tocsr()
    return _Places(value, second, difference if closed else difference[:-1])


def _moved(
    curve: EvenSpline,
    feet: np.ndarray,
    away: np.ndarray,
    weights: np.ndarray,
    line: Any,
    places: _Places,
    bound: float,
    noise: float,
    wavelength: float,
) -> tuple[EvenSpline, float]:
    """The curve after one round, and the largest displacement of a node [m]."""
    from scipy.sparse import diags

    pieces, closed, share = curve.pieces, curve.closed, len(away) / curve.pieces
    nodes = curve.frames(0.5 * np.arange(places.value.shape[0]))
    spacing = float(np.mean(nodes.speed))
    bend = places.second / spacing**2 + diags(nodes.curvature**2) @ places.value
    at_data, at_nodes = displacements(feet, pieces, closed=closed), places.value[::2]
    aside = np.sum((line.data[line.query(curve.nodes)[1]] - curve.nodes) * nodes.normal[::2], axis=1)
    held = _HELD * share * np.minimum(1.0, _TAIL * noise / np.maximum(np.abs(aside), _TAIL * noise))
    # The integral of kappa'^2 over steps of half a spacing: sum of (difference / step)^2 times step.
    price = share / spacing * (wavelength / (2.0 * np.pi)) ** 6 / (0.5 * spacing)
    rise = places.difference @ bend
    form = at_data.T @ diags(weights) @ at_data + at_nodes.T @ diags(held) @ at_nodes
    form = form + price * (rise.T @ rise)
    pull = at_data.T @ (weights * away) + at_nodes.T @ (held * aside)
    pull = pull - price * (rise.T @ (places.difference @ nodes.curvature))
    rho = share * (noise / (_TIGHT * bound)) ** 2
    w = _minimum(form, pull, bend, nodes.curvature, bound, rho, closed=closed)
    way = at_nodes @ w
    longest = float(np.abs(way).max())
    way = way * min(1.0, _STRIDE / bound / max(longest, np.finfo(float).tiny))
    return EvenSpline(curve.nodes + way[:, None] * nodes.normal[::2], closed), longest


def _solved(matrix: Any, right: np.ndarray, *, closed: bool) -> np.ndarray:
    """The solution of a symmetric system whose unknowns are linked to their neighbours on the curve alone.

    The unknowns of a closed curve are taken from both sides of the first in turn, which keeps neighbours near
    each other all round.
    """
    from scipy.linalg import solveh_banded

    n, band = len(right), matrix.tocoo()
    rank = np.arange(n)
    rank = np.minimum(2 * rank, 2 * (n - rank) - 1) if closed else rank
    row, column = rank[band.row], rank[band.col]
    low = row >= column
    width = int(np.max(row - column))
    lower = np.zeros((width + 1, n))
    lower[(row - column)[low], column[low]] = band.data[low]
    turned = np.empty(n)
    turned[rank] = right
    return solveh_banded(lower, turned, lower=True)[rank]


def _minimum(
    form: Any, pull: np.ndarray, bend: Any, now: np.ndarray, bound: float, rho: float, *, closed: bool
) -> np.ndarray:
    """Coefficients w that minimise w.F w / 2 - w.g + rho/2 |excess|^2, by Newton's method with a line search.

    The excess of `now + bend w` over the bound is piecewise linear in w, so that the Hessian is that of the
    places where the bound is passed.
    """
    from scipy.sparse import diags, identity

    # A displacement that neither a point nor the bound sees is none.
    form = form + _DAMPING * float(form.diagonal().mean()) * identity(form.shape[0])

    def excess(w: np.ndarray) -> np.ndarray:
        after = now + bend @ w
        return after - np.clip(after, -bound, bound)

    def cost(w: np.ndarray) -> float:
        return float(0.5 * w @ (form @ w) - pull @ w + 0.5 * rho * np.sum(excess(w) ** 2))

    w = np.zeros(form.shape[0])
    value = cost(w)
    for _ in range(_NEWTON):
        over = excess(w)
        slope = form @ w - pull + rho * (bend.T @ over)
        hessian = form + rho * (bend.T @ diags((over != 0.0).astype(float)) @ bend)
        step = -_solved(hessian, slope, closed=closed)
        share = 1.0
        while (trial := cost(w + share * step)) > value + 1e-4 * share * (slope @ step) and share > 1e-4:
            share *= 0.5
        w, gain, value = w + share * step, value - trial, trial
        if gain <= 1e-9 * abs(value):
            break
    return w
