"""A contact of two contours as users make it: where it starts, and the checks of that.

`_rolling_contact` has its frames, gap and rows.
"""

from typing import Any

import numpy as np
from jaxtyping import Array, Float

from .._fields import real, taken, through
from .._results import check_between, check_positive, shown
from .._types import Given
from ..geometry import AbstractContour, check_contour
from ._contact import as_index
from ._rolling_contact import AbstractRolling, ContourPair


def _as_sense(name: str, sense: Any) -> int:
    whole = isinstance(sense, int | np.integer) and not isinstance(sense, bool)
    if not whole or sense not in (1, -1):
        raise ValueError(f"argument {name} must be 1 or -1, but was {shown(sense)}")
    return int(sense)


class Contact(AbstractRolling):
    r"""Where a fingertip starts touching the object.

    Args:
        s_tip: Arclength on the fingertip's contour at the start, in metres.
        s_object: Arclength on the object's contour at the start, in metres.
        finger: Which finger touches. Static.
        contour: Which of the object's contours is touched. Static.
        sense: +1 where the chapter's $s_i$ and $b_{0i}$ run along the object's contour, -1 where
            they run against it (its second finger). It decides only the signs in which the chapter's
            quantities are reported, of `multipliers`, `residuals`, `press_balance` and the like: a grasp and
            its mirror image with the other `sense` have the same. Static.
        friction: Coefficient $\mu$: a run ends where $|\lambda| > \mu f$. Default: no limit, no cost.

    Raises:
        ValueError: If an arclength is not one finite number, `finger` or `contour` is not a whole number from
            0 up, `sense` is neither, or `friction` is not positive.

    Example:
        >>> import jaxroll as jxr
        >>> float(jxr.Contact(0.001, 0.004, friction=0.5).s_object)
        0.004
    """

    s_tip: Float[Array, ""] = real()
    s_object: Float[Array, ""] = real()
    finger: int = through(as_index, static=True)
    contour: int = through(as_index, static=True)
    sense: int = through(_as_sense, static=True)
    friction: Float[Array, ""] | None = real(check=check_positive, optional=True)

    def __init__(
        self,
        s_tip: Given = 0.0,
        s_object: Given = 0.0,
        *,
        finger: int = 0,
        contour: int = 0,
        sense: int = 1,
        friction: Given | None = None,
    ) -> None:
        self.s_tip = taken(self, "s_tip", s_tip)
        self.s_object = taken(self, "s_object", s_object)
        self.finger = taken(self, "finger", finger)
        self.contour = taken(self, "contour", contour)
        self.sense = taken(self, "sense", sense)
        self.friction = taken(self, "friction", friction)

    def check(self, name: str, shapes: ContourPair) -> None:
        for shape in shapes:
            if not isinstance(shape, AbstractContour):
                raise ValueError(f"argument {name} must be between contours, but one was {shown(shape)}")
        self.check_shapes(name, shapes)
        for shape, (kind, s) in zip(shapes, self._starts(), strict=True):
            domain = None if shape.closed else shape.domain()
            if domain is not None:
                check_between(f"{name}.{kind}", s, *domain, unit=" m")

    def check_shapes(self, name: str, shapes: ContourPair) -> None:
        for shape, (kind, s) in zip(shapes, self._starts(), strict=True):
            check_contour(f"{name}.{kind}", shape, start=s)

    def _starts(self) -> tuple[tuple[str, Array], ...]:
        return ("s_tip", self.s_tip), ("s_object", self.s_object)
