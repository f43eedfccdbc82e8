"""Mass, centre and inertia of the body within a contour, a surface or a mesh.

`_mass_properties` is the door. `_moments` has the integrals that all share; `_contour_moments`,
`_surface_moments` (closed forms and charts), `_level_moments` (implicit surfaces) and `_mesh_moments` walk
over the boundary.
"""

from ._mass_properties import mass_properties as mass_properties, MassProperties as MassProperties
