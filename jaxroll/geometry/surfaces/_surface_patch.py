r"""A surface through a grid of points: a chart of quintic B-splines, $P(u, v) = \sum c_{ij} B_i(u) B_j(v)$.

The coefficients $c_{ij}$ are linear in the points: along one axis, then along the other, they are multiplied
by the inverse of the matrix of the functions' values at the nodes, a constant (`_tensor_bspline.axis`).
`prepared` keeps them for a run.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import Vec3
from ..._results import as_floats
from ..._types import Given, Scalars
from ..._xla import once
from ._surface_chart import AbstractChart, as_flags, Jet
from ._tensor_bspline import Axis, axis, block, contracted, ORDER


class Patch(AbstractChart):
    r"""A surface through a grid of points, $P(i, j) = p_{ij}$, by a tensor product of quintic B-splines.

    The parameters count grid steps: $u$ runs along the first axis of `points` and $v$ along the second, and
    $P_u \times P_v$ must point out of the body. Differentiable with respect to the points. Beyond an open
    end the last polynomials are continued.

    Args:
        points: Shape (m, n, 3) [m], m and n at least 6. A periodic axis does not repeat its first point.
        periodic: Whether u and v are periodic. Static.

    Raises:
        ValueError: If there are too few points, or they are not finite.

    Smoothness: four continuous derivatives; the shape operator has two.
    Accuracy: points regularly spaced on a smooth surface are met to $h^6$ in between, the normal to $h^5$ and
    the curvature to $h^4$.

    Example:
        >>> import jaxroll as jxr, numpy as np
        >>> u, v = np.meshgrid(2 * np.pi * np.arange(32) / 32, np.linspace(0, 0.03, 8), indexing="ij")
        >>> tube = jxr.geometry.Patch(
        ...     np.stack([0.01 * np.cos(u), 0.01 * np.sin(u), v], -1), periodic=(True, False)
        ... )
        >>> tube.principal_curvatures((3.3, 4.4))[0].round(2).tolist()
        [0.0, 100.0]
    """

    points: Float[Array, "m n 3"]
    periodic: tuple[bool, bool] = eqx.field(static=True)
    coefficients: Float[Array, "functions_u functions_v 3"] | None  # periodic: the first five again

    def __init__(self, points: Given, *, periodic: tuple[bool, bool] = (False, False)) -> None:
        self.points = as_floats("points", points, (None, None, 3))
        if min(self.points.shape[:2]) < ORDER:
            raise ValueError(
                f"argument points must have at least {ORDER} along both axes, "
                f"but had shape {self.points.shape}"
            )
        self.periodic = as_flags(periodic)
        self.coefficients = None

    @property
    def smoothness(self) -> float:
        return float(ORDER - 2)

    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        m, n = (
            float(count - (not loop)) for count, loop in zip(self.points.shape, self.periodic, strict=False)
        )
        return (0.0, m), (0.0, n)

    def derivatives(self, at: Scalars) -> Jet:
        # `found[i, j]` is the derivative of order i in u and j in v.
        places = zip(self._axes(), at, self.periodic, strict=True)
        u, v = (axis.local(jnp.asarray(x), closed=closed) for (axis, _), x, closed in places)
        found = contracted(block(self.read(), (u.first, v.first)), (u.weights, v.weights))
        parts = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
        return once(Jet(*(Vec3(*(found[i, j, k] for k in range(3))) for i, j in parts)))

    def _axes(self) -> list[tuple[Axis, np.ndarray]]:
        counts = self.points.shape[:2]
        return [axis(count, closed=closed) for count, closed in zip(counts, self.periodic, strict=True)]

    def read(self) -> Array:
        """The coefficients that `prepared` stored, or new ones."""
        if self.coefficients is not None:
            return self.coefficients
        coefficients = self.points
        for k, (closed, (_, solve)) in enumerate(zip(self.periodic, self._axes(), strict=True)):
            front = jnp.moveaxis(coefficients, k, 0)
            solved = jnp.tensordot(jnp.asarray(solve, front.dtype), front, axes=1)
            # Periodic: the first five follow again, so that the six at any place lie next to each other.
            again = [solved, solved[: ORDER - 1]] if closed else [solved]
            coefficients = jnp.moveaxis(jnp.concatenate(again), 0, k)
        return coefficients

    def prepared(self) -> "Patch":
        return eqx.tree_at(lambda p: p.coefficients, self, self.read(), is_leaf=lambda x: x is None)
