"""Surfaces with their Gauss frames.

`_surface` holds the contract, a surface placed elsewhere, and `_gauss` the frame; `_surface_implicit` and
`_surface_chart` are the two ways to give one, by a field of space or by two parameters.
`_surface_closed_forms` has spheres, ellipsoids and their like, `_surface_extruded` cylinders over contours.
`_surface_patch` is a chart through a grid of points and `_surface_spline` a field of space, both of the
B-splines of `_tensor_bspline`. `_spread` spreads places evenly over a surface.
"""

from ._gauss import approach as approach, Gauss3 as Gauss3, Principal as Principal, principal as principal
from ._spread import lattice as lattice
from ._surface import AbstractSurface as AbstractSurface, Hollow as Hollow, MovedSurface as MovedSurface
from ._surface_chart import AbstractChart as AbstractChart, Chart as Chart, Jet as Jet, jet as jet
from ._surface_closed_forms import (
    Cylinder as Cylinder,
    Ellipsoid as Ellipsoid,
    Plane as Plane,
    Sphere as Sphere,
    Superellipsoid as Superellipsoid,
    Torus as Torus,
)
from ._surface_extruded import Extruded as Extruded
from ._surface_implicit import (
    AbstractImplicit as AbstractImplicit,
    differentiated as differentiated,
    Implicit as Implicit,
    Level as Level,
    level_frame as level_frame,
    spread_in_box as spread_in_box,
)
from ._surface_patch import Patch as Patch
from ._surface_spline import SplineSurface as SplineSurface
from ._tensor_bspline import ORDER as ORDER, UNIFORM as UNIFORM
