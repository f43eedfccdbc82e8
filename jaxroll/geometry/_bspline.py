"""B-splines of any odd degree as polynomials per knot interval: differentiable in knots and data."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra import Vec2


class Pieces(NamedTuple):
    """A planar spline: per knot interval, a polynomial in the interval's own coordinate in [0, 1]."""

    breaks: Float[Array, " pieces+1"]
    coefficients: Float[Array, "pieces order 2"]  # rising powers

    def curve(self, u: Array) -> Vec2:
        """Points at parameters `u` of any shape; beyond the ends, the last polynomial."""
        index, local = locate(self.breaks, u)
        rows = self.coefficients[index]
        x, y = rows[..., -1, 0], rows[..., -1, 1]
        for power in reversed(range(rows.shape[-2] - 1)):
            x, y = x * local + rows[..., power, 0], y * local + rows[..., power, 1]
        return Vec2(x, y)


class Basis(NamedTuple):
    """B-spline basis: on every interval the polynomials of those that live there, and their numbers."""

    breaks: Float[Array, " pieces+1"]
    polynomials: Float[Array, "pieces order order"]  # interval, function, power
    functions: Array  # (pieces, order): which functions these are
    count: int

    def matrix(self, u: Float[Array, " data"]) -> Float[Array, "data functions"]:
        """Values of every function at parameters `u`."""
        index, local = locate(self.breaks, u)
        rows = self.polynomials[index]
        value = rows[..., -1]
        for power in reversed(range(rows.shape[-1] - 1)):
            value = value * local[:, None] + rows[..., power]
        data = jnp.arange(u.shape[0])[:, None]
        return jnp.zeros((u.shape[0], self.count)).at[data, self.functions[index]].add(value)

    def pieces(self, coefficients: Float[Array, "functions 2"]) -> Pieces:
        """The spline with these coefficients."""
        return Pieces(self.breaks, jnp.einsum("ijp,ijd->ipd", self.polynomials, coefficients[self.functions]))

    def roughness(self) -> Float[Array, "functions functions"]:
        r"""The quadratic form $\int |P'''(u)|^2\,du$."""
        order = self.polynomials.shape[-1]
        step = jnp.diff(self.breaks)
        powers = jnp.arange(order)
        factor = (powers * (powers - 1) * (powers - 2)).astype(float)
        third = (self.polynomials * factor[None, None, :])[..., 3:]
        low = jnp.arange(order - 3)
        gram = 1.0 / (low[:, None] + low[None, :] + 1.0)
        local = jnp.einsum("iap,pq,ibq->iab", third, gram, third) / step[:, None, None] ** 5
        rows, columns = self.functions[:, :, None], self.functions[:, None, :]
        return jnp.zeros((self.count, self.count)).at[rows, columns].add(local)


def locate(breaks: Array, u: Array) -> tuple[Array, Array]:
    """Interval of every parameter, and the position in it as a fraction."""
    # Counting, not bisection: a loop in every evaluation is what took longest to compile.
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
    if closed:
        period, count = nodes[-1] - nodes[0], nodes.shape[0] - 1
        knots = jnp.concatenate([nodes[-degree - 1 : -1] - period, nodes, nodes[1 : degree + 1] + period])
    else:
        half, count = (degree + 1) // 2, nodes.shape[0]
        first, last = jnp.repeat(nodes[:1], degree + 1), jnp.repeat(nodes[-1:], degree + 1)
        knots = jnp.concatenate([first, nodes[half:-half], last])
    pieces = knots.shape[0] - 2 * degree - 1
    functions = (jnp.arange(pieces)[:, None] + jnp.arange(degree + 1)[None, :]) % count
    breaks = knots[degree : degree + pieces + 1]
    return Basis(breaks, _polynomials(knots, degree, pieces), functions, count)


def _polynomials(knots: Array, degree: int, pieces: int) -> Array:
    """The recursion of Cox and de Boor on polynomials in each interval's coordinate."""
    interval = degree + jnp.arange(pieces)[:, None]
    left, step = knots[interval], knots[interval + 1] - knots[interval]
    value = jnp.ones((pieces, 1, 1))
    for p in range(1, degree + 1):
        support = interval - (p - 1) + jnp.arange(p)[None, :]
        width = knots[support + p] - knots[support]
        at, slope = ((left - knots[support]) / width)[..., None], (step / width)[..., None]
        rising = _widened(at * value, 0) + _widened(slope * value, 1)
        falling = _widened(value, 0) - rising
        none = jnp.zeros((pieces, 1, p + 1))
        value = jnp.concatenate([falling, none], axis=1) + jnp.concatenate([none, rising], axis=1)
    return value


def _widened(polynomial: Array, shift: int) -> Array:
    """Room for one more power, times the coordinate to the power `shift`."""
    return jnp.pad(polynomial, ((0, 0), (0, 0), (shift, 1 - shift)))
