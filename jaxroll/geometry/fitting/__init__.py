"""Contours and surfaces through a caller's points. All of it is set-up, outside `jit`.

In the plane: `_clean_points` checks raw points and puts them in order, with the help of `_ordering` (an order
where there is none) and `_crossings` (does the polygon cross itself); `_smoothing` finds how much to smooth
them from the noise; `_contour_fit` makes a contour of them, and a report.

With a smallest radius `_limited_fit` makes it: `_band` finds an order along scattered points, `_rolled_line`
rolls discs along them, `_even_spline` and `_bounded_curve` fit a curve under the bound, and `_departures`
tells what was rounded. `_fit_report` is what is said of a fit, and `_measured` finds the noise.

In space: `_surface_fit` makes a surface of a cloud of points and a report (`_surface_report`), with normals
by `_surface_normals` and the least-squares problem for a scalar field by `_field_fit` and `_field_solve`.
With a smallest radius these are of `_scan`, `_scan_fit` and `_scan_verdict`: `_visibility` says which side of
a patch is out, `_indicator` what is inside, `_rolling` rolls balls.
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
