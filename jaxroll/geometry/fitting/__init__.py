"""Contours and surfaces through a caller's points. All of it is set-up, outside `jit`.

In the plane: `_clean_points` checks raw points and puts them in order, with the help of `_ordering` (an order
where there is none) and `_crossings` (does the polygon cross itself); `_smoothing` finds how much to smooth
them from the noise; `_contour_fit` makes a contour of them, and a report.

In space: `_surface_fit` makes a surface of a cloud of points and a report, with normals by `_surface_normals`
and the least-squares problem for a scalar field by `_field_fit`.
"""

from ._clean_points import (
    clean_points as clean_points,
    CleanPoints as CleanPoints,
    metres_per as metres_per,
)
from ._contour_fit import Fit as Fit, fit_contour as fit_contour, FitReport as FitReport
from ._crossings import crossings as crossings
from ._measured import measured as measured
from ._smoothing import smoothing_for as smoothing_for
from ._surface_fit import fit_surface as fit_surface
from ._surface_report import (
    Region as Region,
    SurfaceFit as SurfaceFit,
    SurfaceReport as SurfaceReport,
)
