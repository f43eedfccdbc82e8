"""Shape only: contours as arclength-parametrised fields, with their Frenet frames.

`_contour` holds the contract and the frame by automatic differentiation, `_analytic` the curves
with closed forms, `_arclength` the arclength of curves that are not given by it, `_table` what a run
reads of any other field, `_spline` contours through points.
"""

from ._analytic import Catenary as Catenary, Circle as Circle, Ellipse as Ellipse, Line as Line
from ._contour import (
    AbstractContour as AbstractContour,
    frenet as frenet,
    Frenet2 as Frenet2,
    Moved as Moved,
    tabled as tabled,
)
from ._penalty import smoothing_for as smoothing_for
from ._spline import Spline as Spline
from ._table import (
    AbstractTabulated as AbstractTabulated,
    from_frames as from_frames,
    Table as Table,
    TableError as TableError,
    tabulated as tabulated,
)
