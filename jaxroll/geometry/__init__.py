"""Shape only: contours as fields of arclength with Frenet frames, surfaces with Gauss frames.

`_contour` holds the contract and the frame by automatic differentiation, `_analytic` the curves
with closed forms, `_arclength` the arclength of curves that are not given by it, `_table` what a run
reads of any other field, `_contract` the check of a caller's own, `_spline` contours through points,
`_penalty` how much to smooth them; `_points`, `_ordering` and `_crossings` check raw points, `_fit` makes a
contour of them, and a report. `_support` has convex contours by their support function, `_neural` and
`_neural_curvature` those of a small network (`_network`), fitted to points by `_descent`.

Of surfaces, `_surface` holds the contract and `_gauss` the frame; `_surface_implicit` and `_surface_chart`
the two ways to give one, by a field of space or by two parameters; `_surface_analytic` closed forms,
`_surface_extruded` cylinders over contours, `_surface_spread` places spread evenly over a surface,
`_surface_patch` a chart through a grid of points and `_surface_spline` a field, both of the B-splines of
`_tensor`; `_surface_fit` makes such a field of a cloud of points (`_surface_normals`, `_field_fit`).
"""

from ._analytic import Catenary as Catenary, Circle as Circle, Ellipse as Ellipse, Line as Line
from ._arclength import ArclengthTable as ArclengthTable
from ._contour import (
    AbstractContour as AbstractContour,
    frenet as frenet,
    Frenet2 as Frenet2,
    Moved as Moved,
    tabled as tabled,
)
from ._contract import (
    check_contour as check_contour,
    check_shape as check_shape,
    check_surface as check_surface,
)
from ._crossings import crossings as crossings
from ._fit import Fit as Fit, fit_contour as fit_contour, FitReport as FitReport
from ._gauss import approach as approach, Gauss3 as Gauss3, Principal as Principal, principal as principal
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
from ._surface import AbstractSurface as AbstractSurface
from ._surface_analytic import (
    Cylinder as Cylinder,
    Ellipsoid as Ellipsoid,
    Plane as Plane,
    Sphere as Sphere,
    Superellipsoid as Superellipsoid,
    Torus as Torus,
)
from ._surface_chart import AbstractChart as AbstractChart, Chart as Chart, Jet as Jet, jet as jet
from ._surface_extruded import Extruded as Extruded
from ._surface_fit import fit_surface as fit_surface, SurfaceFit as SurfaceFit, SurfaceReport as SurfaceReport
from ._surface_implicit import (
    AbstractImplicit as AbstractImplicit,
    differentiated as differentiated,
    Implicit as Implicit,
    Level as Level,
    level_frame as level_frame,
    spread_in_box as spread_in_box,
)
from ._surface_moved import Hollow as Hollow, MovedSurface as MovedSurface
from ._surface_patch import Patch as Patch
from ._surface_spline import SplineSurface as SplineSurface
from ._table import (
    AbstractTabulated as AbstractTabulated,
    from_frames as from_frames,
    Table as Table,
    TableError as TableError,
    tabulated as tabulated,
)
