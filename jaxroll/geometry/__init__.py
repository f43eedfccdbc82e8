"""Shape only: contours as fields of arclength with Frenet frames, surfaces with Gauss frames.

`contours` has plane curves, `surfaces` their counterpart in space, `fitting` makes either from points, and
`mass` integrates over what they bound.
`_tabled` has what both have in common, `_contract` the check of shapes of a caller's own class,
`_traced_contract` that of those whose numbers JAX traces, and `_contract_errors` what both measure. Nothing
here knows of bodies, time or contact; `contact` reads the frames.
"""

from .._linalg import Sym3 as Sym3, Vec2 as Vec2, Vec3 as Vec3
from ._contract import (
    check_contour as check_contour,
    check_once_round as check_once_round,
    check_shape as check_shape,
    check_surface as check_surface,
    unchecked as unchecked,
)
from ._tabled import AbstractShape as AbstractShape, tabled as tabled
from ._traced_contract import keeps_contract as keeps_contract
from .contours import (
    AbstractContour as AbstractContour,
    AbstractSupport as AbstractSupport,
    AbstractTabulated as AbstractTabulated,
    ArclengthTable as ArclengthTable,
    as_it_is_resolved as as_it_is_resolved,
    Catenary as Catenary,
    Circle as Circle,
    Ellipse as Ellipse,
    frenet as frenet,
    Frenet2 as Frenet2,
    from_frames as from_frames,
    Line as Line,
    Moved as Moved,
    NetworkFit as NetworkFit,
    NeuralCurvature as NeuralCurvature,
    NeuralSupport as NeuralSupport,
    Parametric as Parametric,
    PeriodicNetwork as PeriodicNetwork,
    polygon_area as polygon_area,
    Spline as Spline,
    SupportFunction as SupportFunction,
    Table as Table,
    TableError as TableError,
    tabulated as tabulated,
)
from .fitting import (
    clean_points as clean_points,
    CleanPoints as CleanPoints,
    crossings as crossings,
    Fit as Fit,
    fit_contour as fit_contour,
    fit_surface as fit_surface,
    FitReport as FitReport,
    metres_per as metres_per,
    Region as Region,
    smoothing_for as smoothing_for,
    SurfaceFit as SurfaceFit,
    SurfaceReport as SurfaceReport,
)
from .mass import mass_properties as mass_properties, MassProperties as MassProperties
from .surfaces import (
    AbstractChart as AbstractChart,
    AbstractImplicit as AbstractImplicit,
    AbstractSurface as AbstractSurface,
    approach as approach,
    Chart as Chart,
    Cylinder as Cylinder,
    differentiated as differentiated,
    Ellipsoid as Ellipsoid,
    Extruded as Extruded,
    Gauss3 as Gauss3,
    Hollow as Hollow,
    Implicit as Implicit,
    Jet as Jet,
    jet as jet,
    Level as Level,
    level_frame as level_frame,
    MovedSurface as MovedSurface,
    Patch as Patch,
    Plane as Plane,
    Principal as Principal,
    principal as principal,
    Sphere as Sphere,
    SplineSurface as SplineSurface,
    spread_in_box as spread_in_box,
    Superellipsoid as Superellipsoid,
    Torus as Torus,
)
