"""What a sweep keeps of each run, by name, and maps of outcomes that are fine only where they must be.

`_measures_kept` has `measures`, a function for `keep` of `sweep` from names: the measures of `design`, and
others of a run's end, least force and energy. `_adaptive` has `adaptive_map`: any outcome over a grid, run at
few of its points, then near changes. `_cells` is its geometry: which cells are halved, and what the map holds
at points that were not run.
"""

from ._adaptive import adaptive_map as adaptive_map, AdaptiveMap as AdaptiveMap
from ._measures_kept import Measures as Measures, measures as measures, MEASURES_KEPT as MEASURES_KEPT
