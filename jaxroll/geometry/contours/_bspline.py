r"""B-splines of any odd degree, as polynomials per knot interval; differentiable in knots and coefficients.

A spline $P(u) = \sum_i p_i B_i(u)$ of degree $d$ is on every knot interval one polynomial of degree $d$ in
the interval's own coordinate $x \in [0, 1]$. `basis` works those polynomials out once from the knots, by the
recursion of Cox and de Boor on coefficients; evaluating is then a look-up and a sum of powers. `_spline`
solves for the coefficients $p_i$ (`Basis.matrix`, `Basis.roughness`) and reads the curve (`Pieces`);
`surfaces._tensor_bspline` multiplies the functions of several axes.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import Vec2


class Pieces(NamedTuple):
    """A planar spline: per knot interval, a polynomial in the interval's own coordinate in [0, 1]."""

    breaks: Float[Array, " pieces+1"]
    coefficients: Float[Array, "pieces order 2"]  # rising powers

    def curve(self, u: Array) -> Vec2:
        """Points at parameters `u` of any shape; beyond the ends, the last polynomial."""
        return jet_of_pieces(self.coefficients, *interval_of(self.breaks, u))[0]


def jet_of_pieces(coefficients: Array, index: Array, local: Array) -> tuple[Vec2, Vec2, Vec2]:
    """Point and two derivatives in the interval's coordinate, at places in intervals: any shape."""
    # Row k of the weights gives derivative k: sum_p weights[k, p] c_p.
    weights = powers(local, coefficients.shape[1]) @ derived(coefficients.shape[1])
    weights = weights.reshape(*local.shape, 3, -1)
    return _vectors(jnp.einsum("...kp,...pd->...kd", weights, coefficients[index]))


def jets(coefficients: Array, local: np.ndarray) -> tuple[Vec2, Vec2, Vec2]:
    """Point and two derivatives at the same places in every interval: shape (pieces, places)."""
    order = coefficients.shape[1]
    weights = (local[:, None] ** np.arange(order)) @ derived(order)
    return _vectors(jnp.einsum("lkp,ipd->ilkd", weights.reshape(len(local), 3, -1), coefficients))


def _vectors(found: Array) -> tuple[Vec2, Vec2, Vec2]:
    point, rate, bend = (Vec2(found[..., k, 0], found[..., k, 1]) for k in range(3))
    return point, rate, bend


def powers(x: Array, order: int) -> Array:
    """1, x, x^2, ... along a new last axis, each the product of two about half as high."""
    found = [jnp.ones_like(x), x]
    for k in range(2, order):
        found.append(found[k // 2] * found[k - k // 2])
    return jnp.stack(found, axis=-1)


@functools.cache
def derived(order: int) -> np.ndarray:
    """Matrix (order, 3 order) by which powers of x become weights of a polynomial's coefficients.

    The three blocks of columns are those for its value and its first and second derivative.
    """
    # d/dx x^j = j x^(j - 1): column j of `once` has j in row j - 1.
    once = np.diag(np.arange(1.0, order), 1)
    return np.concatenate([np.eye(order), once, once @ once], axis=1)


class Basis(NamedTuple):
    """B-spline basis: for every interval, which functions are not zero there, and their polynomials."""

    breaks: Float[Array, " pieces+1"]
    polynomials: Float[Array, "pieces order order"]  # interval, function, power
    functions: np.ndarray  # (pieces, order): which functions these are
    count: int

    def matrix(self, u: Float[Array, " data"]) -> Float[Array, "data functions"]:
        """Values of every function at parameters `u`."""
        index, local = interval_of(self.breaks, u)
        weights = powers(local, self.polynomials.shape[-1])
        return self._spread(index, jnp.sum(self.polynomials[index] * weights[:, None, :], axis=-1))

    def at_breaks(self) -> Float[Array, "pieces functions"]:
        """Values of every function where the intervals begin."""
        return self._spread(np.arange(self.polynomials.shape[0]), self.polynomials[..., 0])

    def _spread(self, index: Array | np.ndarray, values: Array) -> Array:
        """Values (n, order) of the functions on intervals `index`, put in their columns: (n, functions).

        Function k of interval i is function i + k, modulo the count where closed. It is placed by a mask and
        a sum, not by a scatter.
        """
        place = (np.arange(self.count)[None, :] - index[:, None]) % self.count
        here = place[:, None, :] == np.arange(values.shape[1])[None, :, None]
        return jnp.sum(jnp.where(here, values[:, :, None], 0.0), axis=1)

    def pieces(self, coefficients: Float[Array, "functions 2"]) -> Pieces:
        """The spline with these coefficients."""
        weights = coefficients[self.functions][:, :, None, :]
        return Pieces(self.breaks, jnp.sum(self.polynomials[..., None] * weights, axis=1))

    def bends(self, coefficients: Float[Array, "functions d"]) -> Float[Array, "pieces parts d"]:
        r"""Third derivatives, so weighted that their squares add up to $\int |P'''(u)|^2\,du$."""
        return jnp.einsum("iaq,iad->iqd", self._bends(), coefficients[self.functions])

    def roughness(self) -> Float[Array, "functions functions"]:
        r"""The quadratic form $\int |P'''(u)|^2\,du$."""
        local = self._bends()
        rows, columns = self.functions[:, :, None], self.functions[:, None, :]
        squares = jnp.einsum("iaq,ibq->iab", local, local)
        return jnp.zeros((self.count, self.count)).at[rows, columns].add(squares)

    def _bends(self) -> Float[Array, "pieces order parts"]:
        """`bends` of every function on every interval."""
        order = self.polynomials.shape[-1]
        # With u = u_i + step x: P'''(u) = p'''(x) / step^3 and du = step dx, so step^-5/2 in all. The third
        # derivative of x^p is p (p-1) (p-2) x^(p-3); the integral of x^m over [0, 1] is 1 / (m + 1).
        step = jnp.diff(self.breaks)
        power = np.arange(order)
        third = (self.polynomials * (power * (power - 1.0) * (power - 2.0))[None, None, :])[..., 3:]
        low = np.arange(order - 3.0)
        gram = 1.0 / (low[:, None] + low[None, :] + 1.0)
        root = np.linalg.cholesky(gram).astype(step.dtype)
        return jnp.einsum("iap,pq->iaq", third, root) / step[:, None, None] ** 2.5


def interval_of(breaks: Array, u: Array) -> tuple[Array, Array]:
    """Interval of every parameter, and the position in it as a fraction."""
    # The inner breaks that do not lie above u are counted. Bisection would be a loop in every evaluation, and
    # loops take long to compile. Beyond either end the count gives the first or the last interval.
    inner = jax.lax.stop_gradient(breaks[1:-1])
    index = jnp.sum(jax.lax.stop_gradient(u)[..., None] >= inner.reshape((1,) * u.ndim + (-1,)), axis=-1)
    low = breaks[index]
    return index, (u - low) / (breaks[index + 1] - low)


def basis(nodes: Float[Array, " nodes"], degree: int, *, closed: bool) -> Basis:
    """B-splines with knots at the nodes: periodic, or open with not-a-knot ends.

    Args:
        nodes: Increasing. Closed: with the first one repeated a period later.
        degree: Odd; at least `degree` + 1 functions are needed.
        closed: Whether the last node is the first.
    """
    # `count` functions need count + degree + 1 knots (open), or the knots of one period and `degree` more on
    # either side (closed).
    if closed:
        period, count = nodes[-1] - nodes[0], nodes.shape[0] - 1
        knots = jnp.concatenate([nodes[-degree - 1 : -1] - period, nodes, nodes[1 : degree + 1] + period])
    else:
        # Each end knot stands `degree` + 1 times. Not-a-knot: the (degree - 1) / 2 nodes next to either end
        # are no knots, which leaves as many functions as there are nodes.
        half, count = (degree + 1) // 2, nodes.shape[0]
        first, last = jnp.repeat(nodes[:1], degree + 1), jnp.repeat(nodes[-1:], degree + 1)
        knots = jnp.concatenate([first, nodes[half:-half], last])
    pieces = knots.shape[0] - 2 * degree - 1
    functions = (np.arange(pieces)[:, None] + np.arange(degree + 1)) % count
    breaks = knots[degree : degree + pieces + 1]
    return Basis(breaks, _polynomials(knots, degree, pieces), functions, count)


def _polynomials(knots: Array, degree: int, pieces: int) -> Array:
    r"""The recursion of Cox and de Boor, on the coefficients of polynomials in each interval's coordinate x.

    With knots $t_i$ and $w_{i,d}(u) = (u - t_i) / (t_{i+d} - t_i)$,
    $B_{i,d} = w_{i,d} B_{i,d-1} + (1 - w_{i+1,d}) B_{i+1,d-1}$. Row k of an interval is the function k of the
    `degree` + 1 that are not zero on it in the end; at lower degrees the first rows are still zero.
    """
    function = np.arange(degree + 1)
    degrees = np.arange(degree + 1)[:, None, None]
    near = knots[np.arange(pieces)[:, None] + function + degrees]
    begin, end = near[:1], near[1:]
    left, right = begin[..., degree:], end[:1, :, degree:]
    # On the interval [left, right], w = `at` + `slope` x. Where B_{i,d-1} is zero on it, its knots may
    # coincide: the width is then replaced by one, against a division by zero, and w by zero.
    lives = np.arange(degree)[:, None, None] + function >= degree
    width = jnp.where(lives, end - begin, 1.0)
    at = jnp.where(lives, (left - begin) / width, 0.0)
    slope = jnp.where(lives, (right - left) / width, 0.0)

    def raised(value: Array, line: tuple[Array, Array]) -> tuple[Array, None]:
        # w B: times x shifts the powers up by one. (1 - w) B = B - w B goes to the function before.
        at, slope = line
        rising = at[..., None] * value + slope[..., None] * _shifted(value, 2, 1)
        return rising + _shifted(value - rising, 1, -1), None

    # Degree zero: only the last function, one on the interval itself, is not zero there.
    constant = np.zeros((pieces, degree + 1, degree + 1))
    constant[:, degree, 0] = 1.0
    return jax.lax.scan(raised, jnp.asarray(constant, knots.dtype), (at, slope))[0]


def _shifted(value: Array, axis: int, by: int) -> Array:
    """An array moved along an axis by one place, up or down (`by` is 1 or -1), with zeros moved in."""
    pad = [(0, 0, 0)] * 3
    pad[axis] = (by, -by, 0)
    return jax.lax.pad(value, jnp.zeros((), value.dtype), pad)
