"""Where two shapes are nearest: signed gap, closest points, second contacts.

Minima of the sampled distance (`_candidates`, `_samples3`) are refined by Newton's method and checked:
`_location` in the plane, `_location3` in space, with the equations of `_pair3`. `_answers` holds what both
return. `_clearance` is the check for overlap that a run makes where it watches for 'penetration', `_links`
that of links. `close` locates contacts with this if called with `locate=True`.
"""

from ._answers import (
    LocalMinima as LocalMinima,
    Location as Location,
    SurfaceLocation as SurfaceLocation,
    SurfaceMinima as SurfaceMinima,
)
from ._clearance import clearance as clearance, clearance3 as clearance3, TOLERANCE as TOLERANCE
from ._links import (
    chains_apart as chains_apart,
    links_apart as links_apart,
    links_clearance as links_clearance,
    links_clearance3 as links_clearance3,
)
from ._location import locate as locate
from ._location3 import locate_surfaces as locate_surfaces
