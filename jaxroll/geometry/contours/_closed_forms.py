"""Contours in closed form: line, circle, ellipse; the chapter's catenary is in `_catenary`.

Point and frame are written out (`AbstractContour.frame` would differentiate the point). The arclength of an
ellipse is an elliptic integral: its angle is read from a table of `_arclength`, and point and frame are
closed forms in that angle.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._linalg import sincos, unstack, Vec2
from ..._results import as_count, as_floats, as_length, concrete, shown
from ..._types import Given, Scalar, Scalars
from ..._xla import quickly
from ._arclength import ArclengthTable, invert, tabulate
from ._contour import AbstractContour
from ._frenet import Frenet2

Domain = tuple[float, float] | Float[Array, "2"] | None


def as_domain(domain: Domain) -> Array | None:
    """First and last arclength [m] as an array (2,), checked to be increasing; None stays None."""
    if domain is None:
        return None
    ends = as_floats("domain", domain, (2,))
    seen = concrete(ends)
    if seen is not None and not seen[0] < seen[1]:
        raise ValueError(f"argument domain must be increasing, but was {shown(seen)}")
    return ends


class Line(AbstractContour):
    """A straight edge through the body's origin, facing +x: the point is (0, s).

    Args:
        domain: First and last arclength [m]; None for an edge without ends.

    Raises:
        ValueError: If `domain` does not increase.

    Example:
        >>> import jaxroll as jxr
        >>> jxr.Line().point(0.3).tolist()
        [0.0, 0.3]
    """

    ends: Float[Array, "2"] | None

    def __init__(self, domain: Domain = None) -> None:
        self.ends = as_domain(domain)

    @property
    def closed(self) -> bool:
        return False

    @property
    def smoothness(self) -> float:
        return float("inf")

    def curve(self, s: Scalar) -> Vec2:
        return Vec2(jnp.zeros_like(s), s)

    def frame(self, s: Scalar) -> Frenet2:
        zero = jnp.zeros_like(s)
        return Frenet2(Vec2(zero, s), Vec2(zero, jnp.ones_like(s)), zero)

    def domain(self) -> Scalars | None:
        return unstack(self.ends)


class Circle(AbstractContour):
    """A circle about the body's origin; s = 0 lies on the +x axis.

    Args:
        radius: In metres, positive.

    Raises:
        ValueError: If the radius is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> float(jxr.Circle(0.01).curvature(0.0))
        100.0
    """

    radius: Float[Array, ""]

    def __init__(self, radius: Given) -> None:
        self.radius = as_length("radius", radius)

    @property
    def closed(self) -> bool:
        return True

    @property
    def smoothness(self) -> float:
        return float("inf")

    def curve(self, s: Scalar) -> Vec2:
        sin, cos = sincos(s / self.radius)
        return Vec2(self.radius * cos, self.radius * sin)

    def frame(self, s: Scalar) -> Frenet2:
        sin, cos = sincos(s / self.radius)
        point = Vec2(self.radius * cos, self.radius * sin)
        return Frenet2(point, Vec2(-sin, cos), 1.0 / self.radius)

    def domain(self) -> tuple[Scalar, Scalar]:
        return 0.0, 2.0 * np.pi * self.radius


# Cells of an ellipse's table, divided by the square of the ratio of its axes a / b. The cells must resolve
# the least radius of curvature, b^2 / a, whose share of the circumference falls as (b / a)^2. With the first
# number points are within 1e-9 of the circumference, with the second, the fewest allowed, within 2e-5.
_ACCURATE, _RESOLVED = 20.0, 4
# Fewest cells by default; fewest and most that a caller may ask for; largest ratio of the axes by default.
_USUAL, _FEWEST, _MOST, _FLATTEST = 1024, 16, 1 << 20, 100.0


def _ellipse_speed(axes: tuple[Scalar, Scalar], u: Scalar) -> Scalar:
    """Rate of the arclength with the eccentric angle u of the point (a cos u, b sin u)."""
    sin, cos = sincos(u)
    return jnp.sqrt((axes[0] * sin) ** 2 + (axes[1] * cos) ** 2)


class Ellipse(AbstractContour):
    r"""An ellipse about the body's origin; s = 0 lies on the +x axis.

    Its angle as a function of arclength comes from a differentiable table, built once per solve; tangent and
    curvature are exact at the point returned.

    Args:
        a: Half axis along x, in metres, positive.
        b: Half axis along y, in metres, positive; unless `cells` are given, at most 100 times `a`, and a
            hundredth of it at least.
        cells: Cells of the table. Static: changing it recompiles. Default: as many as keep points within 1e-9
            of the circumference, 1024 for axes of a ratio up to 7 (for 4 they are within 1e-12), and 262144
            for 100. Own cells are at least 4 times the square of the ratio, where the error is at most 2e-5;
            it falls as `cells`$^{-6}$.

    Raises:
        ValueError: If an axis is not a length, or the cells are too few. Axes that JAX traces get 1024 cells
            by default, and beyond a ratio of 16 a length of NaN: no run with it is successful.

    Example:
        >>> import jaxroll as jxr
        >>> f"{jxr.Ellipse(0.02, 0.01).curvature(0.0):.0f} 1/m"  # exact: a / b**2
        '200 1/m'
    """

    a: Float[Array, ""]
    b: Float[Array, ""]
    cells: int = eqx.field(static=True)
    table: ArclengthTable | None

    def __init__(self, a: Given, b: Given, *, cells: int | None = None) -> None:
        self.a, self.b = as_length("a", a), as_length("b", b)
        self.cells = self._enough(cells)
        self.table = None

    def _enough(self, cells: int | None) -> int:
        """Cells of the table, as given or as the axes ask; while JAX traces the axes, the default."""
        given = None if cells is None else as_count("cells", cells, least=_FEWEST)
        if given is not None and given > _MOST:
            raise ValueError(f"argument cells must be at most {_MOST}, but was {given}")
        a, b = concrete(self.a), concrete(self.b)
        if a is None or b is None:
            return _USUAL if given is None else given
        square = float(max(a / b, b / a)) ** 2
        if given is None and square > _FLATTEST**2 * (1.0 + 1e-12):
            raise ValueError(
                f"argument b must lie between a / {_FLATTEST:g} and {_FLATTEST:g} a for the arclength to be "
                f"accurate, but a was {a:g} m and b {b:g} m"
            )
        if given is not None and given < _RESOLVED * square:
            raise ValueError(
                f"argument cells must be at least {_RESOLVED} times the square of the ratio of the axes, "
                f"{_RESOLVED * square:.4g}, but was {given}"
            )
        # A power of two: few different numbers of cells, and so few programs to compile.
        return given or max(_USUAL, 1 << math.ceil(math.log2(_ACCURATE * square)))

    def angle(self, s: Scalar) -> Scalar:
        """The eccentric angle at arclength `s`."""
        table = self.arclengths()
        return invert(_ellipse_speed, (self.a, self.b), table, s)

    def arclengths(self) -> ArclengthTable:
        """The table of the eccentric angle over arclength."""
        return _arclengths(self) if self.table is None else self.table

    @property
    def closed(self) -> bool:
        return True

    @property
    def smoothness(self) -> float:
        return float("inf")

    def curve(self, s: Scalar) -> Vec2:
        sin, cos = sincos(self.angle(s))
        return Vec2(self.a * cos, self.b * sin)

    def frame(self, s: Scalar) -> Frenet2:
        sin, cos = sincos(self.angle(s))
        # dc/du and its length; kappa = a b / |dc/du|^3.
        direction = Vec2(-self.a * sin, self.b * cos)
        rate = 1.0 / jnp.sqrt(direction.dot(direction))
        return Frenet2(Vec2(self.a * cos, self.b * sin), direction * rate, self.a * self.b * rate**3)

    def prepared(self) -> "Ellipse":
        return eqx.tree_at(lambda e: e.table, self, self.arclengths(), is_leaf=lambda x: x is None)

    def domain(self) -> tuple[Scalar, Scalar]:
        return 0.0, self.arclengths().length


@quickly
def _arclengths(ellipse: Ellipse) -> ArclengthTable:
    table = tabulate(_ellipse_speed, (ellipse.a, ellipse.b), period=2.0 * np.pi, cells=ellipse.cells)
    # Axes may have been traced when the cells were chosen, or replaced since. If the cells are too few
    # for them, the length is NaN rather than inaccurate. The factor leaves room for rounding.
    longer, shorter = jnp.maximum(ellipse.a, ellipse.b), jnp.minimum(ellipse.a, ellipse.b)
    fine = _RESOLVED * longer * longer <= ellipse.cells * (1.0 + 1e-6) * shorter * shorter
    return eqx.tree_at(lambda t: t.length, table, jnp.where(fine, table.length, jnp.nan))
