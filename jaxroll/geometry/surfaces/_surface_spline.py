"""A surface as the zero set of a field of quintic B-splines on a grid of space.

The field's derivatives at a point involve the 6 x 6 x 6 coefficients around its cell, which `_tensor_bspline`
sums with weights of each axis. `fitting` makes such fields from points; `_surface_implicit` makes a frame of
them.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import Sym3, unstack, Vec3
from ..._results import as_floats, as_positive
from ..._types import Given, Scalars
from ..._xla import once
from ._gauss import Gauss3
from ._surface_implicit import AbstractImplicit, Level, level_frame, spread_in_box
from ._tensor_bspline import block, contracted, ORDER, uniform

_ROOMY = 32  # along every axis, the number of coefficients of a field with room is a multiple of this


class SplineSurface(AbstractImplicit):
    r"""The zero set of $F = \sum c_{ijk} B_i(x) B_j(y) B_k(z)$, uniform quintic B-splines, $F < 0$ inside.

    Any shape, of any genus, has one chart-free coordinate: the point. `fit_surface` makes one from points.
    Differentiable with respect to all its arrays. Beyond the grid the last polynomials are continued, so that
    a run can see that a contact leaves it; far out they may come back to zero, and what is looked for from
    there (`near`, distances) begins at the grid.

    Args:
        coefficients: Shape (l, m, n), each at least 6; (l - 5) by (m - 5) by (n - 5) cells.
        origin: Corner of the first cell, shape (3,) [m].
        step: Width of the cells [m], positive.

    Raises:
        ValueError: If there are too few coefficients, or a number is not finite.

    Smoothness: four continuous derivatives; the shape operator has two.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> x = 0.01 * (np.arange(8) - 3.0)  # where the functions have their centres: the field is x itself
        >>> slope = np.broadcast_to(x[:, None, None], (8, 8, 8))
        >>> wall = jxr.geometry.SplineSurface(slope, (-0.01, -0.01, -0.01), 0.01)
        >>> abs(wall.normal((0.0, 0.004, 0.007))).round(12).tolist()
        [1.0, 0.0, 0.0]
    """

    coefficients: Float[Array, "l m n"]
    origin: Float[Array, "3"]
    step: Float[Array, ""]

    def __init__(self, coefficients: Given, origin: Given, step: Given) -> None:
        self.coefficients = as_floats("coefficients", coefficients, (None, None, None))
        self.origin = as_floats("origin", origin, (3,))
        self.step = as_positive("step", step)
        if min(self.coefficients.shape) < ORDER:
            raise ValueError(
                f"argument coefficients must have at least {ORDER} along every axis, "
                f"but had shape {self.coefficients.shape}"
            )

    @property
    def smoothness(self) -> float:
        return float(ORDER - 2)

    def derivatives(self, point: Vec3) -> Level:
        corner = Vec3(*unstack(self.origin))
        # Along each axis: the position in cells, and derivatives over `step`, so that they are per metre.
        cells = (point - corner).array() / self.step
        local = uniform(cells, self.coefficients.shape, self.step)
        near = block(self.coefficients, tuple(place.first for place in local))
        found = contracted(near, tuple(place.weights for place in local))
        gradient = Vec3(found[1, 0, 0], found[0, 1, 0], found[0, 0, 1])
        # `found[i, j, k]` is the derivative of order i in x, j in y and k in z.
        mixed = (found[1, 1, 0], found[1, 0, 1], found[0, 1, 1])
        hessian = Sym3(found[2, 0, 0], mixed[0], mixed[1], found[0, 2, 0], mixed[2], found[0, 0, 2])
        return once(Level(found[0, 0, 0], gradient, hessian))

    def start(self, point: Vec3) -> Scalars:
        # Where the continued polynomials come back to zero is no body, but Newton's steps would find one.
        held = zip(point, *self._corners(), strict=True)
        return super().start(Vec3(*(jnp.clip(x, low, high) for x, low, high in held)))

    def frame(self, at: Scalars) -> Gauss3:
        point = Vec3(*at)
        return level_frame(point, self.derivatives(point))

    def spread(self, count: int) -> Scalars:
        return spread_in_box(self, *self._corners(), count)

    def margins(self, at: Scalars) -> Scalars:
        """Distances [m] from the faces of the grid, beyond which the field is not known."""
        low, high = self._corners()
        return (*(Vec3(*at) - low), *(high - Vec3(*at)))

    def _corners(self) -> tuple[Vec3, Vec3]:
        """First and last corner of the grid."""
        low = Vec3(*unstack(self.origin))
        cells = (count - (ORDER - 1.0) for count in self.coefficients.shape)
        return low, low + Vec3(*(self.step * count for count in cells))

    def prepared(self) -> "SplineSurface":
        return self


def with_room(surface: SplineSurface) -> SplineSurface:
    """The same field with more coefficients: multiples of 32 along every axis.

    What reads a field near its surface is compiled for every shape of its grid, and most grids then have one.
    Beyond the grid the last polynomials are continued, as `SplineSurface` has it.
    """
    numbers = np.asarray(surface.coefficients)
    for axis, count in enumerate(numbers.shape):
        rows = np.moveaxis(numbers, axis, -1)
        rows = np.concatenate([rows, rows[..., -ORDER:] @ _continued(-count % _ROOMY)], axis=-1)
        numbers = np.moveaxis(rows, -1, axis)
    # A weak type, as Python's own numbers have it, would be another program.
    return SplineSurface(numbers, surface.origin, np.asarray(surface.step))


def _continued(count: int) -> np.ndarray:
    """Matrix from six numbers in a row to the `count` that follow on the quintic through them (Lagrange).

    Uniform B-splines whose coefficients lie on one quintic are one polynomial.
    """
    at, nodes = np.arange(ORDER, ORDER + count), np.arange(ORDER)
    others = [np.delete(nodes, i) for i in nodes]
    rows = [np.prod((at[:, None] - j) / (i - j), axis=1) for i, j in enumerate(others)]
    return np.array(rows)
