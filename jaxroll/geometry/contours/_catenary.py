"""The chapter's contours (80)-(83), which are catenaries: curves whose arclength is known in closed form."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._linalg import unstack, Vec2
from ..._results import as_length, check_between
from ..._types import Given, Scalar, Scalars
from ..._xla import inverse_sinh
from ._closed_forms import as_domain, Domain
from ._contour import AbstractContour
from ._frenet import Frenet2


class Catenary(AbstractContour):
    r"""A catenary with its vertex at the body's origin, facing +x, as in (80)-(83).

    $c(s) = (a - \sqrt{a^2 + s^2},\; a\,\mathrm{asinh}(s/a))$ and $\kappa = a/(a^2 + s^2)$. The
    chapter's object has $a$ = 1/100 m and its fingertip 1/40 m, once $2$ in (81) is read as $s$
    and $s$ in (82) as $s^2$ (unit speed needs both).

    Args:
        a: Radius of curvature at the vertex, in metres, positive; at most 1000 m, since points have the
            rounding error of `a`.
        domain: First and last arclength [m]; None for a curve without ends.

    Raises:
        ValueError: If `a` is not positive or above 1000 m, or `domain` does not increase.

    Example:
        >>> import jaxroll as jxr
        >>> f"{jxr.Catenary(0.025).curvature(0.0):.0f} 1/m"
        '40 1/m'
    """

    a: Float[Array, ""]
    ends: Float[Array, "2"] | None

    def __init__(self, a: Given, domain: Domain = None) -> None:
        self.a = as_length("a", a)
        check_between("a", self.a, 1e-12, 1e3, unit=" m")
        self.ends = as_domain(domain)

    @property
    def closed(self) -> bool:
        return False

    @property
    def smoothness(self) -> float:
        return float("inf")

    def curve(self, s: Scalar) -> Vec2:
        root = jnp.sqrt(self.a**2 + s**2)
        return Vec2(self.a - root, self.a * inverse_sinh(s / self.a))

    def frame(self, s: Scalar) -> Frenet2:
        # The tangent is the derivative of the point, (-s / root, a / root), and kappa = a / (a^2 + s^2).
        square = self.a**2 + s**2
        root = jnp.sqrt(square)
        point = Vec2(self.a - root, self.a * inverse_sinh(s / self.a))
        return Frenet2(point, Vec2(-s / root, self.a / root), self.a / square)

    def domain(self) -> Scalars | None:
        return unstack(self.ends)
