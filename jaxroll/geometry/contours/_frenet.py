r"""The frame of a plane curve at one arclength: point, unit tangent and curvature, (8)-(10).

`frenet` differentiates the point automatically, for contours (`_contour`) that do not write their frame out.
`contact` reads a `Frenet2` of each of two contours.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from ..._linalg import Vec2
from ..._types import Scalar


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Frenet2:
    """Point, unit tangent and curvature of a contour at one arclength."""

    point: Vec2
    tangent: Vec2
    curvature: Scalar


def frenet(curve: Callable[[Scalar], Vec2], s: Scalar) -> Frenet2:
    r"""Frenet frame (8)-(10) of a unit-speed curve, by differentiating its point twice.

    $b = c'$, $\kappa = b \times b'$. The chapter prints $n = \kappa b'$ in (9) and $b = -\kappa n'$
    in (10); the right forms are $b' = \kappa n$ and $n' = -\kappa b$ ($n$ inward).
    """
    one = jnp.ones_like(s)

    # Forward over forward: one pass gives c, c' and c''. Reverse mode would need a pass per component.
    def derivative(u: Scalar) -> tuple[Vec2, Vec2]:
        return jax.jvp(curve, (u,), (one,))

    (point, tangent), (_, second) = jax.jvp(derivative, (s,), (one,))
    return Frenet2(point, tangent, tangent.cross(second))
