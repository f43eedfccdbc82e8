"""Shape only: contours as arclength-parametrised fields, with their Frenet frames.

`_contour` holds the contract and the frame by automatic differentiation, `_analytic` the curves
with closed forms, `_arclength` the table for curves that are not given by arclength.
"""

from ._analytic import Catenary as Catenary, Circle as Circle, Ellipse as Ellipse, Line as Line
from ._contour import (
    AbstractContour as AbstractContour,
    frenet as frenet,
    Frenet2 as Frenet2,
    Moved as Moved,
)
