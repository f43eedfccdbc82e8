"""Contours and surfaces through a caller's points. All of it is set-up, outside `jit`.

In the plane: `_clean_points` checks raw points and puts them in order, with the help of `_ordering` (an order
where there is none) and `_crossings` (does the polygon cross itself); `_smoothing` finds how much to smooth
them from the noise; `_contour_fit` makes a contour of them, and a report.

With a smallest radius `_limited_fit` makes it: `_band` finds an order along scattered points, `_rolled_line`
rolls discs along them, `_even_spline` and `_bounded_curve` fit a curve under the bound, and `_departures`
tells what was rounded. `_fit_report` has what either way returns: the contour, and what is said of the fit.

In space: `_surface_fit` makes a surface of a cloud of points and a report (`_surface_report`), with normals
by `_surface_normals` and the least-squares problem for a scalar field by `_field_fit`; `_surface_measured`
finds feet, normals and curvatures. With a smallest radius `_scan_verdict` is the way in: `_scan` thins the
points, `_visibility` says which side of a patch is out, `_indicator` what is inside, `_rolling` rolls balls,
and `_scan_fit` fits the field, by `_field_solve`.
"""

from ._clean_points import (
    clean_points as clean_points,
    CleanPoints as CleanPoints,
    metres_per as metres_per,
)
from ._contour_fit import Fit as Fit, fit_contour as fit_contour, FitReport as FitReport
from ._crossings import crossings as crossings
from ._smoothing import smoothing_for as smoothing_for
from ._surface_fit import fit_surface as fit_surface
from ._surface_measured import measured as measured
from ._surface_report import (
    Region as Region,
    SurfaceFit as SurfaceFit,
    SurfaceReport as SurfaceReport,
)
