"""Shape only: contours as arclength-parametrised fields, with their Frenet frames.

`_contour` holds the contract and the frame by automatic differentiation, `_analytic` the curves
with closed forms, `_arclength` the arclength of curves that are not given by it, `_table` what a run
reads of any other field, `_spline` contours through points, `_penalty` how much to smooth them; `_points`,
`_ordering` and `_crossings` check raw points, `_fit` makes a contour of them, and a report. `_support` has
convex contours by their support function, `_neural` and `_neural_curvature` those of a small network
(`_network`), fitted to points by `_descent`.
"""

from ._analytic import Catenary as Catenary, Circle as Circle, Ellipse as Ellipse, Line as Line
from ._contour import (
    AbstractContour as AbstractContour,
    frenet as frenet,
    Frenet2 as Frenet2,
    Moved as Moved,
    tabled as tabled,
)
from ._crossings import crossings as crossings
from ._fit import Fit as Fit, fit_contour as fit_contour, FitReport as FitReport
from ._network import NetworkFit as NetworkFit, PeriodicNetwork as PeriodicNetwork
from ._neural import NeuralSupport as NeuralSupport
from ._neural_curvature import NeuralCurvature as NeuralCurvature
from ._penalty import smoothing_for as smoothing_for
from ._points import (
    clean_points as clean_points,
    CleanPoints as CleanPoints,
    metres_per as metres_per,
    polygon_area as polygon_area,
)
from ._spline import Spline as Spline
from ._support import AbstractSupport as AbstractSupport, SupportFunction as SupportFunction
from ._table import (
    AbstractTabulated as AbstractTabulated,
    from_frames as from_frames,
    Table as Table,
    TableError as TableError,
    tabulated as tabulated,
)
