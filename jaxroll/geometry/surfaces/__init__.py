"""Surfaces with their Gauss frames.

- `_surface`: the contract, and surfaces made of another one (`MovedSurface`, `Hollow`).
- `_gauss`: the frame at one place, and what follows from it.
- `_surface_implicit`, `_surface_chart`: the two ways to give a surface, by a field of space or by two
  parameters.
- `_surface_closed_forms`: plane, sphere, ellipsoid and their like.
- `_surface_extruded`: cylinders over contours.
- `_surface_patch`: a chart through a grid of points; `_surface_spline`: a field of space. Both are made of
  the B-splines of `_tensor_bspline`.
- `_spread`: places spread evenly over a surface; `_net`: triangles of the zero set of a sampled
  field; `_spline_net`: those of a surface of splines.
"""

from ._gauss import approach as approach, Gauss3 as Gauss3, Principal as Principal, principal as principal
from ._net import net as net
from ._spline_net import surface_net as surface_net, surface_values as surface_values
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
from ._surface_spline import SplineSurface as SplineSurface, with_room as with_room
from ._tensor_bspline import ORDER as ORDER, UNIFORM as UNIFORM
