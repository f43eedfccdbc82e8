r"""The two objects of the plane that users make: pivoted, and free.

What the equations of motion read of them is in `_plane_bodies`; those of space are in `_object3`.
"""

from collections.abc import Sequence
from typing import Any

from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._results import as_floats, as_positive, as_several, check_instance, check_positive
from .._types import Given
from ..geometry import AbstractContour, mass_properties
from ._body import Contours
from ._plane_bodies import AbstractFree, AbstractPivoted


def _as_contours(name: str, contours: Any) -> Contours:
    return as_several(name, contours, AbstractContour, "contours")


class PivotedObject(AbstractPivoted):
    r"""An object that turns about a fixed point $O_m$, the origin of its frame (Part 2, Fig. 4).

    Its one coordinate is the angle $\theta$.

    Args:
        contours: One contour or several, in the body frame.
        inertia: Moment about the pivot, in kg m^2.
        pivot: Shape (2,), position of the pivot in the world, in metres.
        mass: In kilograms; used by gravity alone, with `centre`. Default: no weight.
        centre: Shape (2,), centre of mass in the body frame, in metres.

    Raises:
        ValueError: If there is no contour, or a mass or inertia is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> jxr.PivotedObject(jxr.Circle(0.02), inertia=4e-6, pivot=(0.01, 0.05)).pivot.tolist()
        [0.01, 0.05]
    """

    contours: Contours = through(_as_contours)
    inertia: Float[Array, ""] = real(check=check_positive)
    pivot: Float[Array, "2"] = real(2)
    weight_moment: Float[Array, "2"] | None = real(2, optional=True)

    def __init__(
        self,
        contours: AbstractContour | Sequence[AbstractContour],
        inertia: Given,
        *,
        pivot: Given = (0.0, 0.0),
        mass: Given | None = None,
        centre: Given = (0.0, 0.0),
    ) -> None:
        self.contours = taken(self, "contours", contours)
        self.inertia = taken(self, "inertia", inertia)
        self.pivot = taken(self, "pivot", pivot)
        middle = as_floats("centre", centre, (2,))
        self.weight_moment = None
        if mass is not None:
            # The weight needs only the product of mass and centre: the first moment about the pivot.
            self.weight_moment = as_positive("mass", mass) * middle


class FreeObject(AbstractFree):
    r"""An object free in the plane; its frame sits at the centre of mass $O_m$ (Part 1, Fig. 1).

    Its coordinates are $(x, y, \theta)$, as in (12).

    Args:
        contours: One contour or several, in the body frame.
        mass: In kilograms.
        inertia: Moment about the centre of mass, in kg m^2.

    Raises:
        ValueError: If there is no contour, or a mass or inertia is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> float(jxr.FreeObject(jxr.Circle(0.02), mass=0.05, inertia=1e-5).mass)
        0.05
    """

    contours: Contours = through(_as_contours)
    mass: Float[Array, ""] = real(check=check_positive)
    inertia: Float[Array, ""] = real(check=check_positive)

    def __init__(
        self,
        contours: AbstractContour | Sequence[AbstractContour],
        mass: Given,
        inertia: Given,
    ) -> None:
        self.contours = taken(self, "contours", contours)
        self.mass = taken(self, "mass", mass)
        self.inertia = taken(self, "inertia", inertia)

    @classmethod
    def uniform(
        cls, contour: AbstractContour, density: Given, *, thickness: Given | None = None
    ) -> "FreeObject":
        """The plate of constant density that a closed contour outlines.

        The contour is shifted so that the centre of mass lies at the origin of the object's frame.

        Args:
            contour: Closed.
            density: Mass per area [kg/m^2]; with `thickness` [kg/m^3].
            thickness: Of the plate [m].

        Raises:
            ValueError: If the contour is not closed or crosses itself, or a number is not positive.

        Example:
            >>> import jaxroll as jxr
            >>> disc = jxr.FreeObject.uniform(jxr.Circle(0.02), density=1000.0, thickness=0.01)
            >>> f"{1e3 * disc.mass:.2f} g"
            '12.57 g'
        """
        check_instance("contour", contour, AbstractContour, "a contour")
        found = mass_properties(contour, density, thickness=thickness)
        return cls(contour.moved(-found.centre), found.mass, found.inertia)
