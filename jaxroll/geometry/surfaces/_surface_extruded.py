"""The general cylinder over a planar contour: what a contour of `contours` is in space.

Frame, domain and table are the contour's; the second coordinate is the height along z.
"""

import jax
import jax.numpy as jnp
import numpy as np

from ..._linalg import square, Vec3
from ..._results import shown
from ..._types import Scalars
from ..contours import AbstractContour
from ._gauss import Gauss3
from ._surface import AbstractSurface
from ._surface_chart import bounded

# Places along the contour at which a search for the closest point may begin.
_SEEDS = 64


class Extruded(AbstractSurface):
    r"""The cylinder over a planar contour: $P(s, z) = c(s) + z e_z$; the body's z axis is its direction.

    Its coordinates are the contour's arclength $s$ and the height $z$ [m]. With the contour's tangent $t$ and
    curvature $\kappa$, the outward normal is $n = t \times e_z$ and the shape operator $L = \kappa\,t t^T$.
    It has no ends along z, and those of its contour along s.

    Args:
        contour: In the body's x-y plane. Differentiable; its table, if it reads one, serves the surface.

    Raises:
        ValueError: If `contour` is not a contour.

    Smoothness and accuracy: those of the contour.

    Example:
        >>> import jaxroll as jxr
        >>> rod = jxr.geometry.Extruded(jxr.Circle(0.01))
        >>> rod.principal_curvatures((0.0, 0.3))[0].tolist()
        [0.0, 100.0]
    """

    contour: AbstractContour

    def __init__(self, contour: AbstractContour) -> None:
        if not isinstance(contour, AbstractContour):
            raise ValueError(f"argument contour must be a contour, but was {shown(contour)}")
        self.contour = contour

    @property
    def coordinates(self) -> int:
        return 2

    @property
    def smoothness(self) -> float:
        return self.contour.smoothness

    def frame(self, at: Scalars) -> Gauss3:
        # The contour's normal, its tangent turned right, is t x e_z. Only along t does the normal change.
        here = self.contour.frame(at[0])
        zero = jnp.zeros_like(here.tangent.x)
        out = here.tangent.right()
        tangent = Vec3(here.tangent.x, here.tangent.y, zero)
        point = Vec3(here.point.x, here.point.y, zero + at[1])
        return Gauss3(point, Vec3(out.x, out.y, zero), square(tangent) * here.curvature)

    def rate(self, at: Scalars, velocity: Vec3) -> Scalars:
        return self.basis(at)[0].dot(velocity), velocity.z

    def settled(self, at: Scalars) -> Scalars:
        return at

    def basis(self, at: Scalars) -> tuple[Vec3, Vec3]:
        tangent = self.contour.frame(at[0]).tangent
        zero = jnp.zeros_like(tangent.x)
        return Vec3(tangent.x, tangent.y, zero), Vec3(zero, zero, jnp.ones_like(zero))

    def start(self, point: Vec3) -> Scalars:
        ends = self.contour.domain()
        if ends is None:
            return jnp.zeros_like(point.x), point.z
        s = ends[0] + (ends[1] - ends[0]) * ((np.arange(_SEEDS) + 0.5) / _SEEDS)
        near = jax.vmap(self.contour.curve)(jnp.asarray(s, jnp.result_type(point.x)))
        best = jnp.argmin((near.x - point.x) ** 2 + (near.y - point.y) ** 2)
        return jnp.asarray(s)[best], point.z

    def margins(self, at: Scalars) -> Scalars:
        ends = self.contour.domain()
        if ends is None or self.contour.closed:
            return ()
        return at[0] - ends[0], ends[1] - at[0]

    def within(self, at: Scalars) -> Scalars:
        ends = self.contour.domain()
        return at if ends is None else (bounded(at[0], ends, self.contour.closed), at[1])
