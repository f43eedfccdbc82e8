"""Contours and surfaces through a caller's points.

`_clean_points`, `_ordering` and `_crossings` check and order raw points, `_smoothing` says how much to
smooth them, `_contour_fit` makes a contour of them, and a report. `_surface_fit` makes a surface of a cloud
of points: normals by `_surface_normals`, a field of space by `_field_fit`.
"""

from ._clean_points import (
    clean_points as clean_points,
    CleanPoints as CleanPoints,
    metres_per as metres_per,
)
from ._contour_fit import Fit as Fit, fit_contour as fit_contour, FitReport as FitReport
from ._crossings import crossings as crossings
from ._smoothing import smoothing_for as smoothing_for
from ._surface_fit import fit_surface as fit_surface, SurfaceFit as SurfaceFit, SurfaceReport as SurfaceReport
